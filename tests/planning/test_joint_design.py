"""Tests that are designed: better than the one there is, within every limit, and written for a drive to play."""

import itertools
import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.paper.twin import SAMPLE_TIME, twin
from jointid.planning import search as search_module
from jointid.planning.designed import Design
from jointid.planning.floor import least_deviation
from jointid.planning.joints import JointModel
from jointid.planning.plans import Plan, families_in
from jointid.planning.predict import Noise, parse_goal
from jointid.planning.search import Objective, search
from jointid.simulation import excitation
from jointid.tuning.margins import joint_set
from tests.planning.planned import LOOP, TRUTH, T, planned_record, predict_test

AXIS = twin("L19", noise="white")
NOISE = Noise(log=AXIS.noise)
SHORT = 6000  # samples


def short_record() -> ji.Record:
    return planned_record(
        AXIS.loop, AXIS.record.reference.values[:SHORT], SAMPLE_TIME, AXIS.record.injected.channel.values[:SHORT]
    )


def count_trials(patched: pytest.MonkeyPatch) -> None:
    """Let every test that is tried take a second: as many on a slow machine as on a fast one."""
    ticks = itertools.count()
    patched.setattr(search_module, "search", partial(search, clock=lambda: float(next(ticks))))


@pytest.fixture(scope="module")
def designed() -> Design:
    with pytest.MonkeyPatch.context() as patched:
        count_trials(patched)
        return ji.design(
            AXIS.loop,
            values=AXIS.truth,
            noise={"log": AXIS.noise},
            goal="stiffness",
            record=short_record(),
            within=2.0,
            search_time=60.0,
        )


def test_it_is_told_in_numbers_and_files(designed: Design, tmp_path: Path) -> None:
    answer = json.loads(json.dumps(ji.to_dict(designed), allow_nan=False))
    assert answer["schema"] == "jointid.Design/2"
    assert answer["tests"]["proposed"]["std"]["stiffness"] == designed.proposed.std["stiffness"]
    paths = designed.write(tmp_path / "next")
    assert sorted(path.name for path in paths) == ["how-to-run.md", "test.csv"]
    columns = {"reference": ji.Column("reference", "m")}
    table = ji.read(tmp_path / "next" / "test.csv", columns, time="t", kind="prismatic")
    played = designed.records()[0].reference
    assert played is not None and table.reference.values == pytest.approx(played.values, abs=1e-12)
    fastest = np.abs(np.diff(played.values, 2)).max() / played.sample_time**2
    assert designed.axes[0].reached["acceleration"] == pytest.approx(fastest)
    assert len(designed.plot().axes) == 2


def test_without_a_record_a_test_keeps_limits_of_jerk_and_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    count_trials(monkeypatch)
    limits = ji.AxisLimits(lower=1.0, upper=2.5, speed=3.0, acceleration=20.0, jerk=400.0, torque=2.0)
    asked = {"values": TRUTH, "noise": {"log": 0.02}, "duration": 4.0, "sample_time": 1e-3, "limits": limits}
    found = ji.design(LOOP, search_time=30.0, **asked)
    (reached,) = (axis.reached for axis in found.axes)
    assert reached["lower"] >= 1.0 and reached["upper"] <= 2.5 and reached["jerk"] < 400.0 * 1.05
    assert found.axes[0].limits.stated["stroke"] == 1.5 and not found.passed
    assert found.present is None and found.floor is None
    outside = planned_record(LOOP, 0.8 + 0.5 * (1.0 - np.cos(np.arange(4000) * 4e-3)), 1e-3)
    assert ji.design(LOOP, motion=outside, **asked).passed


def test_no_plan_comes_below_the_floor() -> None:
    limits, hertz = ji.AxisLimits(stroke=0.2, rms_torque=50.0), 60.0
    for name in ("stiffness", "motor_viscous - load_viscous", "motor_inertia"):
        goal = parse_goal(name, {p.name: AXIS.loop.joint.unit(p) for p in AXIS.loop.joint.parameters})
        floor = least_deviation(
            AXIS.loop, AXIS.truth, NOISE, goal, limits, samples=SHORT, sample_time=SAMPLE_TIME, cutoff=hertz
        )
        assert floor is not None and floor.deviation is not None and floor.power.sum() > 0
        at = SHORT, SAMPLE_TIME
        motions = (
            excitation.trapezoids((0.05,), 0.5, 0.19, SAMPLE_TIME, duration=SHORT * SAMPLE_TIME),
            excitation.multisine(*at, 0.08, 0.3, 2.0, tilt=2.0),
        )
        signals = excitation.sines(*at, (16.5, 29.8), (25.0, 60.0)), excitation.multisine(*at, 40.0, 8.0, 40.0), None
        for (k, reference), injected in itertools.product(enumerate(motions), signals):
            test = planned_record(AXIS.loop, reference, SAMPLE_TIME, injected)
            told = predict_test(AXIS.loop, AXIS.truth, test, NOISE, filtering=ji.Filtering(cutoff=hertz), runs=60)
            size = math.sqrt(float(np.mean(told.torques**2)))
            assert told.std_of(goal.weights) * max(size / 50.0, 1.0) > floor.deviation, (name, k)


def test_the_lines_of_the_floor_are_the_peaks_of_its_powers() -> None:
    goal = parse_goal("motor_viscous - load_viscous", {"motor_viscous": "N s/m", "load_viscous": "N s/m"})
    floor = least_deviation(
        AXIS.loop, AXIS.truth, Noise(force=AXIS.noise), goal, ji.AxisLimits(stroke=0.2, rms_torque=50.0), samples=SHORT,
        sample_time=SAMPLE_TIME, cutoff=60.0,
    )  # fmt: skip
    modes = ji.FlexibleJoint.frequencies(AXIS.truth)
    strong = [f for f, size in floor.lines if size > 0.1]
    assert strong == pytest.approx([modes["motor_locked"], modes["free_free"]], rel=0.03)


def test_the_floor_knows_what_the_sampled_loop_leaves_of_a_force() -> None:
    floor = least_deviation(
        AXIS.loop, AXIS.truth, NOISE, parse_goal("stiffness", {"stiffness": "N/m"}), ji.AxisLimits(rms_torque=50.0),
        samples=SHORT, sample_time=SAMPLE_TIME, cutoff=60.0,
    )  # fmt: skip
    law = AXIS.loop.controller.law(SAMPLE_TIME)
    sampled = joint_set(AXIS.loop.joint, [AXIS.truth], law)
    left = np.interp(floor.hertz, sampled.hertz, np.abs(1 / (1 + sampled.response(law)[0])))
    np.testing.assert_allclose(floor.sensitivity, left, rtol=0.01)


WIDE = ji.AxisLimits(lower=0.0, stroke=0.3, speed=0.2, acceleration=2.0, torque=300.0)


def test_a_limit_that_is_passed_counts_before_anything_else() -> None:
    limits = ji.AxisLimits(stroke=0.1, torque=300.0)
    families = families_in(WIDE, 60.0, 29.5, ((30.0, 1.0),))
    model = JointModel(AXIS.loop, (AXIS.truth,), NOISE, SHORT, SAMPLE_TIME, ji.Filtering(), {}, True, ())
    asked = Objective(model, parse_goal("all", model.units), (limits,), families)
    far, near = [0.9, 0.9, 0.9, 0.5, 0.83, 0.0], [0.9, 0.9, 0.9, 0.5, 0.4, 0.0]
    by_added = {one.added: one for one in families if one.motion == "trapezoids"}
    wide = asked.try_plan(Plan(by_added["sines"], (*far, 0.8, 0.8, 0.6)))
    narrow = asked.try_plan(Plan(by_added["nothing"], tuple(near)))
    assert wide.over > 1.1 and narrow.over == 0.0
    assert narrow.rank < wide.rank
    assert wide.score < narrow.score
    clocks = [map(float, itertools.count()) for _ in range(2)]
    first, again = (list(search(asked, 30.0, lambda _: None, seed=3, clock=one.__next__)) for one in clocks)
    assert [one.plan for one in first] == [one.plan for one in again]
    assert all(later.rank < before.rank for before, later in itertools.pairwise(first))
    # On a slow machine the time is over before anything was simulated.
    calls, whole = itertools.count(), Objective.try_plan
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            Objective, "try_plan",
            lambda asked, plan: replace(whole(asked, plan), over=math.inf if next(calls) < 3 else 0.0),
        )  # fmt: skip
        late = itertools.count(0, 100)
        found = list(search(asked, 30.0, lambda _: None, seed=3, clock=lambda: float(next(late))))
    assert math.isfinite(found[-1].over)


def test_every_family_plays_within_its_ranges() -> None:
    samples = 8000
    time, hertz = np.arange(samples) * T, np.fft.rfftfreq(samples, T)
    room = ji.AxisLimits(lower=0.0, stroke=1.0, speed=1.0, acceleration=1.0, jerk=20.0, torque=1.0, lowest=20.0)
    families = families_in(room, 60.0, 30.0, ((30.0, 1.0),))
    kinds = itertools.product(("trapezoids", "sines"), ("nothing", "sines", "lines"))
    assert {(one.motion, one.added) for one in families} == set(kinds)
    for family, share in itertools.product(families, (0.0, 0.5, 1.0)):
        plan = Plan(family, (share,) * family.size)
        reference, *added = plan.play(time)
        assert reference.min() > 0.0 and reference.max() < 1.0
        if family.motion == "trapezoids":
            acceleration = np.diff(reference, 2) / T**2
            assert np.max(np.abs(acceleration)) < 1.02 and np.max(np.abs(np.diff(acceleration))) / T < 21.0
            assert reference[-1] == pytest.approx(reference[-3], abs=1e-12)
        for signal in added:
            assert np.max(np.abs(signal)) < 1.0 + 1e-9
            power = np.abs(np.fft.rfft(signal)) ** 2
            assert np.sum(power[(hertz < 19.0) | (hertz > 61.0)]) < 0.02 * np.sum(power), (family, share)
        smaller = plan.scale(0.5).play(time)
        np.testing.assert_allclose(smaller[0] - smaller[0][0], 0.5 * (reference - reference[0]), atol=1e-12)


@pytest.mark.slow
def test_a_test_stays_where_the_present_one_is_and_begins_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    count_trials(monkeypatch)
    loop = ji.ClosedLoop(
        ji.RigidJoint("revolute", gravity=ji.Gravity("constant")),
        ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, integral_gain=30.0),
    )
    values = {"inertia": 0.04, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0, "gravity_constant": -0.8}
    values = {p.name: values.get(p.name, -0.8) for p in loop.joint.parameters}
    slow = 1.2 + excitation.trapezoids((0.5, 1.0), 8.0, 1.0, 4e-3, duration=4.0)
    torque = ji.Channel(np.zeros(4000), "N m", 1e-3)
    present = replace(planned_record(loop, slow, 4e-3), torque=torque)
    found = ji.design(loop, values=values, noise={"log": 0.01}, record=present, within=4.0, search_time=80.0)
    assert not found.passed
    assert found.axes[0].reached["lower"] > 1.19 and found.axes[0].reached["upper"] < 2.21
    assert found.proposed.sample_time == 1e-3
    assert found.axes[0].reached["acceleration"] < 20.0  # by the rate of the reference itself
    held = [values[p.name] for p in loop.joint.parameters if "gravity" in p.name]
    assert found.proposed.torques[0, 0] == pytest.approx(held[0], rel=0.2)  # and not from 0
    assert " of " not in found.axes[0].cell("speed"), "it is not limited"
