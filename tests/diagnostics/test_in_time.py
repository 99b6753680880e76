"""A force for a part of the time, where no fault is named; another encoder, an encoder off its centre, a weight."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics import search
from jointid.diagnostics.search import find_part
from jointid.estimation.result.verdict import Reason, Subject
from studies import healthy, robot_mistakes
from tests.estimates import beside_tables, faults_of
from tests.frozen.cases import faulty, robot

STEP, BEGIN, END = 1e-3, 3.0, 3.8  # s, of the log and of a push
LOOP = ji.ClosedLoop(
    ji.RigidJoint("revolute"), ji.controller.Cascade(position_gain=25.0, velocity_gain=2.0, integral_gain=2.0)
)
LAW = ji.controller.Cascade(position_gain=20.0, velocity_gain=0.5)
TRUTH = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.3, "offset": 0.05}


def pushed(size: float) -> ji.Record:
    """Return the record of a joint that is pushed by so much, N m, from 3 to 3.8 s."""
    reference = ji.excitation.trapezoids((1.0, 2.0, 4.0), 40.0, 2.0, STEP, duration=8.0)
    time = STEP * np.arange(reference.size)
    push = np.where((time > BEGIN) & (time < END), size * np.sin(np.pi * (time - BEGIN) / (END - BEGIN)) ** 2, 0.0)
    noise = 0.01 * np.random.default_rng(1).standard_normal(time.size)
    return ji.simulated_record(LOOP, reference, TRUTH, sample_time=STEP, disturbance=push, torque_noise=noise)


@pytest.mark.parametrize("size", [pytest.param(0.2, marks=pytest.mark.slow), -0.3])
def test_a_push_is_found_in_its_part_of_the_time_and_no_fault_is_named(size: float) -> None:
    record = pushed(size).without("motor_position")
    found = ji.identify(record, LOOP)
    (loop,) = (one for one in found.checks if one.name is Subject.LOOP)
    assert (loop.passed, loop.code) == (False, Reason.MISFIT_IN_PART)
    assert BEGIN - 0.1 < loop.values["begin"] < loop.values["end"] < END + 0.1
    assert not (found.answer.reliable or found.diagnosis.axes[0].faults.findings)
    assert ji.diagnose(record, LOOP).summary().count("does not follow the model") == 1  # once
    left_out = tuple(map(tuple, json.loads(beside_tables(found)["next"].partition(" = ")[2].partition(")")[0])))
    assert ji.identify(replace(record, left_out=left_out), LOOP).answer.reliable


def test_a_push_that_the_fit_follows_is_found_too() -> None:
    (loop,) = faulty("a_push", "rigid").about(Subject.LOOP)  # from 1.7 to 2.3 s
    assert loop.code is Reason.MISFIT_IN_PART and 1.6 < loop.values["begin"] < loop.values["end"] < 2.4


@pytest.mark.slow
def test_the_checks_of_a_long_record_read_its_beginning_and_diagnose_reads_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.diagnostics.identify._PERIODS", 2500)
    plain = pushed(0.0).without("motor_position")
    found = ji.identify(plain, LOOP)
    assert "2.5 s" in found.warnings[-1] and found.diagnosis.torques.time[-1] < BEGIN
    for whole in (ji.identify(plain, LOOP, checks="whole").diagnosis, ji.diagnose(plain, LOOP)):
        assert whole.torques.time[-1] > 7.0
    (loop,) = ji.identify(pushed(0.2).without("motor_position"), LOOP).about(Subject.LOOP)
    assert loop.code is Reason.MISFIT_IN_PART  # which is seen in all of the record
    assert all(2.2 < robot(2, False, way, 1).diagnosis.torques.time[-1] < 3.0 for way in ("loop", "inverse"))


@pytest.mark.slow
def test_a_fault_that_no_correction_lowers_is_not_dropped_beside_a_weaker_friction(monkeypatch: Any) -> None:
    record, find = pushed(0.0).without("motor_position"), search._find
    stuck = lambda found, test: (find(found, test)[0], find(found, test)[1] if test.fault.of_model else found)  # noqa: E731
    monkeypatch.setattr(search, "_find", stuck)
    wrong = replace(LOOP, controller=replace(LOOP.controller, velocity_gain=2.2))
    estimate = ji.identify(record, wrong, checks=False)
    faults = faults_of(estimate, record)
    assert all(one.test.fault.of_model for one in faults.findings) and 0.0 < faults.explained < 0.5
    monkeypatch.undo()
    monkeypatch.setattr(search, "find_unexplained_share", lambda *_: 0.01 * estimate.fit.filtered_error)
    (vague,) = faults_of(estimate, record).reasons  # which explains most, but leaves more than free responses
    assert vague.code == Reason.NO_CAUSE_FOUND and vague.values["explained"] > 0.5


@pytest.mark.slow
def test_noise_that_comes_back_is_no_part() -> None:
    plain = pushed(0.0).without("motor_position")
    found = ji.identify(plain, LOOP)
    assert found.answer.reliable and found.diagnosis.axes[0].near is None
    for speed, near in ((75.0, pytest.approx(75.0 / (2 * np.pi), rel=0.02)), (7.0, None)):  # too slow for a spectrum
        wave = replace(plain.torque, values=plain.torque.values + 0.1 * np.sin(speed * plain.torque.time))
        assert ji.identify(plain.with_channels({"torque": wave}), LOOP).diagnosis.axes[0].near == near
    sweep = healthy.drive(20006, 8.0, "white force")  # whose fast end the axis does not follow
    assert ji.identify(sweep.record, sweep.loop).answer.reliable
    time = STEP * np.arange(8000)
    white = np.random.default_rng(0).standard_normal(time.size)
    leaned = (time > 2.0) & (time < 2.8)
    basis = (1.0 + 2.0 * leaned[:, np.newaxis]) / np.linalg.norm(1.0 + 2.0 * leaned)
    assert find_part(white, basis, time) is None
    assert find_part(white * (1.0 + 9.0 * (np.sin(2 * np.pi * time) > 0.7)), basis, time) is None
    pushed_too = white + 10.0 * leaned  # half of which the parameter follows
    found = find_part(pushed_too - basis @ (basis.T @ pushed_too), basis, time)
    assert (found.values["begin"], found.values["end"]) == pytest.approx((2.0, 2.8), abs=0.01)


def identified(travel, eccentric=0.0, on_load=False, gap=0.0, weight=0.0, law=LAW):
    """Return the estimate of two masses with a faulty encoder or spring, or whose log is without a weight."""
    reference = ji.excitation.trapezoids((travel / 2, travel, 2 * travel), 20 * travel, travel, STEP, duration=6.0)
    h, torques, logged, (q1, q2, w1, w2, before) = STEP / 10, list[float](), list[float](), (0.0,) * 5
    for asked in reference.tolist():
        read = q1 + eccentric * float(np.sin(q1 + 0.4) - np.sin(0.4))
        torques.append(0.5 * (20.0 * (asked - (q2 if on_load else read)) - (read - before) / STEP))
        logged.append(torques[-1] - weight * float(np.sin(q2)))
        before = read
        for _ in range(10):
            wound = q1 - q2 - np.clip(q1 - q2, -gap, gap)
            spring = 30.0 * wound + 0.01 * (w1 - w2) * (wound != 0.0)
            w1 += h * (torques[-1] - spring - 0.01 * w1) / 0.006
            w2 += h * (spring - 0.01 * w2 - weight * np.sin(q2)) / 0.006
            w1, w2 = (np.sign(w) * max(abs(w) - h * 0.03 / 0.006, 0.0) for w in (w1, w2))
            q1, q2 = q1 + h * w1, q2 + h * w2
    torque = np.array(logged) + 0.01 * float(np.std(logged)) * np.random.default_rng(0).standard_normal(len(torques))
    record = ji.Record(ji.Channel(torque, "N m", STEP), reference=ji.Channel(reference, "rad", STEP))
    return ji.identify(record, ji.ClosedLoop(ji.FlexibleJoint("revolute"), law))


@pytest.mark.slow
def test_no_torque_reacts_before_its_law() -> None:
    same = ji.controller.PD(position_gain=10.0, derivative_gain=0.5, reference_velocity="none")
    (loop,) = (one for one in identified(2.0, on_load=True, law=same).checks if one.name is Subject.LOOP)
    assert (loop.passed, loop.code) == (False, Reason.NO_CAUSE_FOUND)


@pytest.mark.parametrize(("code", "size", "travel", "wrong"), [
    ("", 0.0, 2.0, {}), pytest.param("eccentric_encoder", 0.03, 8.0, {"eccentric": 0.03}, marks=pytest.mark.slow),
    pytest.param("eccentric_encoder", 0.03, 2.0, {"eccentric": 0.03}, marks=pytest.mark.slow),
    pytest.param("unlogged_gravity", 0.1, 2.0, {"weight": 0.1}, marks=pytest.mark.slow),
    pytest.param("load_encoder", 1.0, 2.0, {"on_load": True}, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_faulty_encoder_and_a_log_without_a_weight_are_named(code, size, travel, wrong):
    estimate = identified(travel, **wrong)
    found = [(one.test.name, one.test.size) for one in estimate.diagnosis.axes[0].faults.findings]
    assert found == [(code, pytest.approx(size, rel=0.25))][: len(wrong)] and (wrong or estimate.answer.reliable)
    assert estimate["stiffness"].interval[0] < 30.0 < estimate["stiffness"].interval[1]


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "code"), [(3e-3, "backlash"), (0.03, "")])
def test_play_at_the_horn_is_backlash_or_something_else(gap: float, code: str) -> None:
    (loop, *_) = (one for one in identified(2.0, gap=gap).checks if one.name is Subject.LOOP)
    assert loop.passed is False and loop.values.get("suspect", "") == code
    assert code or loop.code == Reason.NO_CAUSE_FOUND


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_robot_that_is_leaned_on_has_no_other_fault(seed: int) -> None:
    assert robot_mistakes.judge(seed, "contact")[0] == ("misfit_in_part", 2)
