"""Tests that are designed: better than the one there is, within every limit, and written for a drive to play."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli import main
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.limits import AxisLimits, find_excess
from jointid.output.json import to_dict
from jointid.paper.twin import JOINT_FILE, SAMPLE_TIME, twin
from jointid.planning import search as search_module
from jointid.planning.designed import Design
from jointid.planning.floor import least_deviation
from jointid.planning.goals import parse_goal
from jointid.planning.joint_tests import JointTests
from jointid.planning.plans import (
    Family,
    Plan,
    Room,
    families_in,
    sines,
    torque_lines,
    torque_sines,
    trapezoids,
)
from jointid.planning.predict import Noise, find_maxima, planned_record, predict_test
from jointid.planning.search import search
from jointid.records.record import Tap
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write
from jointid.simulation import excitation
from jointid.tuning.margins import joint_set

AXIS = twin("L19", noise="white")
NOISE = Noise(log=AXIS.noise)
SHORT = 6000  # samples
T = 1e-3
PLAIN = ClosedLoop(
    RigidJoint("revolute"), ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, integral_gain=30.0)
)
PLAIN_VALUES = {"inertia": 0.04, "viscous": 0.05, "coulomb": 0.1, "offset": 0.02}


def short_record() -> ji.Record:
    assert AXIS.record.reference is not None and AXIS.record.injected is not None
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
            noise=NOISE,
            goal="stiffness",
            record=short_record(),
            within=2.0,
            search_time=250.0,
        )


@pytest.mark.slow
def test_it_tells_more_than_the_one_there_is_and_keeps_the_limits(designed: Design) -> None:
    assert designed.present is not None
    assert designed.proposed.std["stiffness"] < 0.7 * designed.present.std["stiffness"]
    assert designed.floor is not None
    assert designed.floor < designed.proposed.std["stiffness"]
    assert not designed.passed
    assert set(designed.axes[0].limits.given) == {"stroke", "torque", "rms_torque"}
    told = designed.proposed
    found = find_maxima(told.motion, told.reference, told.motion.torque, told.sample_time)
    assert not find_excess(designed.axes[0].limits, found)
    assert designed.tests["twice the time"] is not None and designed.tests["with load encoder"] is not None
    assert designed.tests["twice the time"].std["stiffness"] < told.std["stiffness"]
    assert designed.tests["with load encoder"].std["stiffness"] < told.std["stiffness"]
    assert designed.tests["with motor encoder"] is not None  # the noise is of the log, which an encoder does not read
    assert designed.tests["with motor encoder"].std["stiffness"] < 0.5 * told.std["stiffness"]
    assert told.reference[-1] == pytest.approx(told.reference[-2], abs=1e-8)  # it ends at rest


def test_it_is_told_in_numbers_and_files(designed: Design, tmp_path: Path) -> None:
    answer = json.loads(json.dumps(to_dict(designed), allow_nan=False))
    assert answer["schema"] == "jointid.Design/2"
    assert answer["tests"]["proposed"]["std"]["stiffness"] == designed.proposed.std["stiffness"]
    paths = designed.write(tmp_path / "next")
    assert sorted(path.name for path in paths) == ["how-to-run.md", "test.csv"]
    table = ji.read(
        tmp_path / "next" / "test.csv", {"reference": ji.Column("reference", "m")}, time="t", kind="prismatic"
    )
    assert table.reference is not None
    assert table.reference.values == pytest.approx(designed.proposed.reference, abs=1e-12)
    assert len(designed.plot().axes) == 3


def test_a_test_is_designed_without_a_record_from_limits_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    count_trials(monkeypatch)
    loop, values = PLAIN, PLAIN_VALUES
    limits = AxisLimits(stroke=2.0, speed=3.0, acceleration=20.0, jerk=400.0, torque=2.0)
    found = ji.design(
        loop,
        values=values,
        noise=Noise(log=0.02),
        limits=limits,
        duration=4.0,
        sample_time=1e-3,
        search_time=60.0,
    )
    assert found.present is None and "with load encoder" not in found.tests and found.floor is None
    assert not found.passed
    jerk = np.max(np.abs(np.diff(found.proposed.reference, 3))) / 1e-9
    assert jerk < 400.0 * 1.05


def test_a_reference_stays_between_the_positions_that_are_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    count_trials(monkeypatch)
    loop, values = PLAIN, PLAIN_VALUES
    limits = AxisLimits(lower=1.0, upper=2.5, speed=3.0, acceleration=20.0, torque=2.0)
    asked = {"values": values, "noise": Noise(log=0.02), "duration": 4.0, "sample_time": 1e-3, "limits": limits}
    found = ji.design(loop, search_time=30.0, **asked)  # type: ignore[call-overload]
    assert found.axes[0].reached["lower"] >= 1.0 and found.axes[0].reached["upper"] <= 2.5
    assert found.axes[0].limits.given["stroke"] == 1.5 and not found.passed
    outside = planned_record(loop, 0.8 + 0.5 * (1.0 - np.cos(np.arange(4000) * 4e-3)), 1e-3)
    told = ji.design(loop, motion=outside, **asked)  # type: ignore[call-overload]
    assert told.passed


def test_no_plan_comes_below_the_floor() -> None:
    """Of tests that keep the axis moving, as the floor has it."""
    limits, hertz = AxisLimits(stroke=0.2, rms_torque=50.0), 60.0
    for name in ("stiffness", "motor_viscous - load_viscous", "motor_inertia"):
        goal = parse_goal(name, {p.name: AXIS.loop.joint.unit(p) for p in AXIS.loop.joint.parameters})
        floor = least_deviation(
            AXIS.loop, AXIS.truth, NOISE, goal, limits, samples=SHORT, sample_time=SAMPLE_TIME, cutoff=hertz
        )
        assert floor is not None and floor.deviation is not None and floor.power.sum() > 0
        for motion, added in itertools.product(
            (trapezoids((0.05,), 0.5, 0.19), sines(0.08, 0.3, 2.0)),
            (torque_lines((16.5, 29.8), (25.0, 60.0)), torque_sines(40.0, 8.0, 40.0), None),
        ):
            reference, injected = Plan(motion, added).play(SHORT, SAMPLE_TIME)
            test = planned_record(AXIS.loop, reference, SAMPLE_TIME, injected)
            told = predict_test(AXIS.loop, AXIS.truth, test, NOISE, filtering=Filtering(cutoff=hertz), runs=60)
            size = math.sqrt(float(np.mean(told.motion.torque**2)))
            assert told.std_of(goal.weights) * max(size / 50.0, 1.0) > floor.deviation, (name, motion, added)


def test_the_lines_of_the_floor_are_the_peaks_of_its_powers() -> None:
    """What is told of the two viscous frictions is told at antiresonance and resonance, not between them."""
    goal = parse_goal("motor_viscous - load_viscous", {"motor_viscous": "N s/m", "load_viscous": "N s/m"})
    floor = least_deviation(
        AXIS.loop, AXIS.truth, Noise(force=AXIS.noise), goal, AxisLimits(stroke=0.2, rms_torque=50.0), samples=SHORT,
        sample_time=SAMPLE_TIME, cutoff=60.0,
    )  # fmt: skip
    modes = FlexibleJoint.frequencies(AXIS.truth)
    strong = [f for f, size in floor.lines if size > 0.1]
    assert strong == pytest.approx([modes["motor_locked"], modes["free_free"]], rel=0.03)


def test_the_floor_knows_what_the_sampled_loop_leaves_of_a_force() -> None:
    floor = least_deviation(
        AXIS.loop, AXIS.truth, NOISE, parse_goal("stiffness", {"stiffness": "N/m"}), AxisLimits(rms_torque=50.0),
        samples=SHORT, sample_time=SAMPLE_TIME, cutoff=60.0,
    )  # fmt: skip
    law = AXIS.loop.controller.law(SAMPLE_TIME)
    sampled = joint_set(AXIS.loop.joint, [AXIS.truth], law)
    left = np.interp(floor.hertz, sampled.hertz, np.abs(1 / (1 + sampled.response(law)[0])))
    np.testing.assert_allclose(floor.sensitivity, left, rtol=0.01)


def test_a_limit_that_is_passed_counts_before_anything_else() -> None:
    own = predict_test(AXIS.loop, AXIS.truth, short_record(), NOISE, runs=5)
    found = find_maxima(own.motion, own.reference, own.motion.torque, SAMPLE_TIME)
    limits = AxisLimits(stroke=0.1, torque=300.0)
    room = Room(0.1, 2 * found["speed"], 2 * found["acceleration"], 300.0, None, 0.0, 0.1, 60.0, 29.5)
    goal = parse_goal("all", own.units)
    asked = JointTests(
        AXIS.loop, (AXIS.truth,), NOISE, goal, SHORT, SAMPLE_TIME, Tap.COMMAND, Filtering(), {}, limits, room
    )
    wide = asked.try_plan(Plan(trapezoids((0.1,), 1.0, 0.15), torque_sines(150.0, 10.0, 40.0)))
    narrow = asked.try_plan(Plan(trapezoids((0.1,), 1.0, 0.05)))
    assert wide.over == pytest.approx(1.5 / 0.97, rel=0.01)
    assert narrow.over == 0.0
    assert narrow.rank < wide.rank
    assert wide.score < narrow.score
    ticks = itertools.count()
    first = list(search(asked, [], 30.0, lambda _: None, seed=3, clock=lambda: float(next(ticks))))
    ticks = itertools.count()
    again = list(search(asked, [], 30.0, lambda _: None, seed=3, clock=lambda: float(next(ticks))))
    assert [asked.describe(one.plan) for one in first] == [asked.describe(one.plan) for one in again]
    assert all(later.rank < before.rank for before, later in itertools.pairwise(first))
    # On a slow machine the time is over before anything was simulated.
    calls, whole = itertools.count(), JointTests.try_plan
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            JointTests, "try_plan",
            lambda asked, plan: replace(whole(asked, plan), over=math.inf if next(calls) < 3 else 0.0),
        )  # fmt: skip
        late = itertools.count(0, 100)
        found = list(search(asked, [], 30.0, lambda _: None, seed=3, clock=lambda: float(next(late))))
    assert math.isfinite(found[-1].over)


def test_every_generator_plays_what_it_says() -> None:
    samples, T = 8000, 1e-3
    wave = torque_sines(10.0, 5.0, 40.0).play(samples, T)
    assert np.max(np.abs(wave)) == pytest.approx(10.0)
    spectrum = np.abs(np.fft.rfft(wave))
    hertz = np.fft.rfftfreq(samples, T)
    assert np.sum(spectrum[(hertz < 4.0) | (hertz > 41.0)] ** 2) < 0.01 * np.sum(spectrum**2)
    lines = torque_lines((7.0, 19.0), (2.0, 1.0)).play(samples, T)
    amplitude = 2 * np.abs(np.fft.rfft(lines)) / samples
    assert amplitude[np.argmin(np.abs(hertz - 7.0))] == pytest.approx(2.0, rel=0.05)
    trapezoid = trapezoids((0.2,), 1.0, 0.1, rest=0.1, smoothing=0.05).play(samples, T)
    acceleration = np.diff(trapezoid, 2) / T**2
    assert np.max(np.abs(acceleration)) == pytest.approx(1.0, rel=0.02)
    assert np.max(np.abs(np.diff(acceleration))) / T < 21.0
    assert trapezoid[-1] == pytest.approx(trapezoid[-3], abs=1e-12)
    assert Family("trapezoids", "lines").size == 8
    smaller = trapezoids((0.2,), 1.0, 0.1, rest=0.1, start=3.0).scale(0.5).play(samples, T)
    np.testing.assert_allclose(smaller, trapezoids((0.1,), 0.5, 0.05, rest=0.1, start=3.0).play(samples, T), atol=1e-12)
    room = Room(1.0, 1.0, 1.0, 1.0, None, 0.0, 20.0, 60.0, 30.0, ((30.0, 1.0),))
    for family in (one for one in families_in(room) if one.added != "nothing"):
        for share in (0.0, 0.5, 1.0):
            added = family.plan([share] * family.size, room).added
            assert added is not None
            power = np.abs(np.fft.rfft(added.play(samples, T))) ** 2
            assert np.sum(power[(hertz < 19.0) | (hertz > 61.0)]) < 0.02 * np.sum(power), (family, share)


@pytest.mark.slow
def test_the_command_plans_from_a_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis = twin("L19")
    write(replace(axis.record, motor_position=None, load_position=None), tmp_path / "record.csv")
    (tmp_path / "joint.toml").write_text(f'{JOINT_FILE}[limits]\nspeed = "300 mm/s"\nwindup = 0.5\n')
    with pytest.raises(SystemExit) as ended:
        main([
            "design", str(tmp_path / "joint.toml"), "-q", "--goal", "stiffness", "--search-time", "6", "--out",
            str(tmp_path / "next"), "--json", str(tmp_path / "next.json"), "--set", "limits.windup=0.001",
        ])  # fmt: skip
    assert ended.value.code == 0
    assert (tmp_path / "next" / "test.csv").exists()
    answer = json.loads((tmp_path / "next.json").read_text())
    assert answer["axes"][0]["limits"]["windup"] == 0.001  # the option's, not the file's
    assert answer["axes"][0]["limits"]["speed"] == pytest.approx(0.3)
    assert answer["axes"][0]["reached"]["windup"] < 0.001
    with pytest.raises(SystemExit) as ended:
        main([
            "design", str(tmp_path / "joint.toml"), "-q", "--goal", "stiffness", "--motion",
            str(tmp_path / "next" / "test.csv"), "--json", str(tmp_path / "own.json"), "--set",
            "limits.stroke=0.01",
        ])  # fmt: skip
    assert ended.value.code == 0
    own = json.loads((tmp_path / "own.json").read_text())
    told, again = (one["tests"]["proposed"]["std"]["stiffness"] for one in (answer, own))
    assert again == pytest.approx(told, rel=1e-6)  # the same test, read back


@pytest.mark.slow
def test_a_past_record_is_predicted_as_the_joint_file_reads_it(
    emps_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joint = Path(__file__).parents[2] / "examples" / "emps" / "joint.toml"
    given = ["design", str(joint), "--record", str(emps_path), "-q", "--json", str(tmp_path / "told.json")]
    with pytest.raises(SystemExit) as ended:
        main([*given, "--motion", str(emps_path.with_name("DATA_EMPS_PULSES.mat"))])
    assert ended.value.code == 0
    assert "Beware" not in capsys.readouterr().out  # the limits of the present test are not those of another
    tests = json.loads((tmp_path / "told.json").read_text())["tests"]
    assert tests["proposed"]["std"]["inertia"] < 0.8 * tests["present"]["std"]["inertia"]
    (tmp_path / "spoiled.csv").write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit) as ended:
        main([*given, "--motion", str(tmp_path / "spoiled.csv")])
    assert ended.value.code == 2


@pytest.mark.slow
def test_a_test_stays_where_the_present_one_is_and_begins_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """An axis that begins at 1.2 rad, holds a weight, logs its reference at a quarter of the rate, injects early."""
    count_trials(monkeypatch)
    loop = ClosedLoop(
        RigidJoint("revolute", gravity=ji.Gravity("constant")),
        ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, integral_gain=30.0),
    )
    values = {"inertia": 0.04, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0, "gravity_constant": -0.8}
    values = {p.name: values.get(p.name, -0.8) for p in loop.joint.parameters}
    slow = 1.2 + excitation.trapezoids((0.5, 1.0), 8.0, 1.0, 4e-3, duration=4.0)
    torque = ji.Channel(np.zeros(4000), "N m", 1e-3)
    present = replace(planned_record(loop, slow, 4e-3), torque=torque)
    found = ji.design(loop, values=values, noise=Noise(log=0.01), record=present, within=4.0, search_time=80.0)
    assert not found.passed
    assert found.proposed.reference.min() > 1.19
    assert found.proposed.reference.max() < 2.21
    assert found.proposed.sample_time == 1e-3
    assert found.axes[0].reached["acceleration"] < 20.0  # by the rate of the reference itself
    held = [values[p.name] for p in loop.joint.parameters if "gravity" in p.name]
    assert found.proposed.motion.torque[0] == pytest.approx(held[0], rel=0.2)  # and not from 0
    assert " of " not in found.axes[0].cell("speed"), "it is not limited"


def test_a_record_of_another_rate_is_predicted_as_it_was_logged(tmp_path: Path) -> None:
    """Its reference every 4 ms beside a torque every 1 ms, and beside it the same at 1 ms: nearly one motion."""
    reference = excitation.trapezoids((0.05, 0.1), 1.0, 0.15, 4e-3, duration=6.0)
    fine = np.interp(np.arange(6000) * 1e-3, np.arange(reference.size) * 4e-3, reference)
    torque = ji.Channel(np.zeros(6000), "N", 1e-3)
    coarse = replace(planned_record(AXIS.loop, reference, 4e-3), torque=torque)
    told, same = (
        ji.design(AXIS.loop, values=AXIS.truth, noise=NOISE, record=short_record(), motion=motion)
        for motion in (coarse, planned_record(AXIS.loop, fine, 1e-3))
    )
    assert "twice the time" not in told.tests and told.floor is None
    assert told.proposed.std["motor_inertia"] == pytest.approx(same.proposed.std["motor_inertia"], rel=0.5)
    assert told.axes[0].reached["speed"] == pytest.approx(same.axes[0].reached["speed"], rel=0.2)
    assert not told.axes[0].limits.given  # those of the present test are not those of another
    drawn = [line for axes in told.plot().axes[:2] for line in axes.lines]
    assert [line.get_xdata()[-1] for line in drawn] == pytest.approx([6.0, 6.0], abs=0.01)
    told.write(tmp_path)
    assert "a row every 4" in (tmp_path / "how-to-run.md").read_text()
    assert "torque" not in (tmp_path / "test.csv").read_text().splitlines()[0]  # there is none yet


def test_behind_a_gear_the_page_says_whose_numbers_they_are(tmp_path: Path) -> None:
    gear = ji.Transmission(load="revolute", ratio=100.0)
    law = ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, ratio=gear.torque("motor"))
    loop = ClosedLoop(RigidJoint("revolute", transmission=gear), law)
    values = {"inertia": 400.0, "viscous": 500.0, "coulomb": 10.0, "offset": 2.0}
    reference = excitation.trapezoids((0.02, 0.05), 0.3, 0.02, T, duration=4.0)
    added = 5.0 * np.sign(np.sin(np.arange(4000) * 0.05))
    motion = planned_record(loop, reference, T, added)
    found = ji.design(loop, values=values, noise=Noise(log=2.0), record=motion, motion=motion)
    found.write(tmp_path)
    page = (tmp_path / "how-to-run.md").read_text()
    assert "100 times" in page and "0.01 times" in page and 'side = "load" }' in page
