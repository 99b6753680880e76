"""A drive that runs faster than its log, and whose period is not declared: its law is simulated at the log's rate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.analysis import rebuild_problem
from jointid.diagnostics.changes import PERIOD, list_variants
from jointid.diagnostics.search import _list_late
from jointid.diagnostics.suspects import AxisFaults
from jointid.estimation.result.verdict import Subject
from jointid.models.controllers import PD, Cascade, FirstOrder
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Channel, Record, Timing
from jointid.records.resampling import at_period
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import faults_of, identify
from tests.faster_drives import CASCADE, LOG, RIGID, SERVO, drive


def _checked(record: Record, loop: ClosedLoop) -> tuple[AxisFaults, float]:
    """Return the faults of a record, and the inertia that is identified from it."""
    estimate = identify(record, loop)
    return faults_of(estimate, record, most=1), estimate["inertia"].value


@pytest.mark.parametrize("times", [2, pytest.param(8, marks=pytest.mark.slow)])
def test_a_drive_that_runs_faster_than_its_log_is_named(times: int) -> None:
    check, value = _checked(*drive(CASCADE, times, noise=0.05))
    first = check.findings[0]
    assert first.test.fault is PERIOD
    assert first.test.size == pytest.approx(1.0, abs=0.2)
    assert first.value == pytest.approx(1e-3 / times)
    assert str(check.reasons[0]).startswith(f"the controller runs faster than the log, at {times} kHz")
    assert f"declare its period, {1 / times:g} ms" in str(check.reasons[0])
    corrected = value + first.changes["inertia"].by
    assert abs(corrected - RIGID["inertia"]) < min(2e-3 * RIGID["inertia"], abs(value - RIGID["inertia"]))


@pytest.mark.slow
def test_what_the_log_leaves_open_of_the_reference_is_tried_both_ways() -> None:
    check, _ = _checked(*drive(SERVO, 8, noise=0.05))
    first = check.findings[0]
    assert 'interpolation = "cubic"' in str(check.reasons[0])
    assert first.value <= 0.25e-3


@pytest.mark.parametrize("law", [CASCADE, SERVO])
def test_a_drive_that_runs_at_the_rate_of_its_log_is_not_blamed(law: Cascade | PD) -> None:
    check, _ = _checked(*drive(law, 1, noise=0.05))
    assert PERIOD not in [one.test.fault for one in check.findings]
    assert not any(one.law for one in check.suspected)


def test_a_declared_period_is_not_doubted() -> None:
    record, loop = drive(CASCADE, 8)
    declared = replace(loop, controller=replace(CASCADE, delay=LOG / 8, period=LOG / 8))
    estimate = identify(record, declared)
    for law, doubted in ((declared, False), (loop, True)):
        variants = list_variants(law.controller, record, LOG, law.controller.period or LOG)
        assert any(first.fault is PERIOD for first, *_ in variants) is doubted
    assert faults_of(estimate, record).as_declared


def _filled_in(way: str, law: Cascade | PD = CASCADE) -> tuple[Record, ClosedLoop]:
    """Return the log of a drive of 8 kHz whose reference is filled in by a way, and its loop without the way."""
    times = 8
    fine, joint = LOG / times, RigidJoint("revolute")
    commands = trapezoids((0.4, 0.8, 1.2), 8.0, 0.6, LOG, duration=6.0)
    log = Channel(commands, "rad", LOG, Timing.SAMPLED)
    controller = replace(law, delay=fine, period=fine, interpolation=way)
    reference = at_period(log, fine, times * commands.size, "reference", controller.interpolation)
    record = simulated_record(ClosedLoop(joint, controller), reference, RIGID, sample_time=fine, name="drive")
    noise = 0.05 * np.random.default_rng(1).standard_normal(commands.size)
    torque = replace(record.torque, values=record.torque.values[::times] + noise, sample_time=LOG)
    shown = replace(record, torque=torque, reference=log, motor_position=None, load_position=None)
    return shown, ClosedLoop(joint, replace(controller, interpolation=None))


@pytest.mark.parametrize(("law", "way"), [(CASCADE, "hold"), pytest.param(SERVO, "cubic", marks=pytest.mark.slow)])
def test_a_reference_that_is_filled_in_otherwise_is_named(law: Cascade | PD, way: str) -> None:
    record, loop = _filled_in(way, law)
    estimate = ji.identify(record, loop)
    row = estimate["inertia"]
    assert abs(row.value - RIGID["inertia"]) > 2 * row.stderr
    assert not estimate.answer.reliable
    assert f'declare interpolation = "{way}"' in str(estimate.answer)
    declared = replace(loop, controller=replace(loop.controller, interpolation=way))
    right = ji.identify(record, declared)
    assert right.answer.reliable
    assert abs(right["inertia"].value - RIGID["inertia"]) < 3 * right["inertia"].stderr


def _late(coarse: int = 1, behind: int = 0, **late: Any) -> tuple[Record, ClosedLoop, Cascade]:
    """Log of a late drive, `behind` its stamps, its loop and its law; setpoints come every `coarse` samples."""
    law = replace(CASCADE, **({"period": LOG, "delay": LOG} | late))
    setpoints = trapezoids((0.4, 0.8, 1.2), 8.0, 0.6, coarse * LOG, duration=6.0)
    loop = ClosedLoop(RigidJoint("revolute"), law)
    tap = "measured" if "delay" in late else "command"
    record = simulated_record(loop, np.repeat(setpoints, coarse), RIGID, sample_time=LOG, name="drive", tap=tap)
    noise = 0.05 * np.random.default_rng(1).standard_normal(record.torque.values.size)
    torque = replace(record.torque, values=np.roll(record.torque.values, behind) + noise)
    shown = replace(record, torque=torque, motor_position=None, load_position=None)
    return shown, replace(loop, controller=replace(CASCADE, period=LOG, delay=LOG)), law


@pytest.mark.parametrize(("late", "time"), [
    ({"torque_filters": (FirstOrder(2e-3),), "behind": 1}, "2.01 ms, and its log is 1.00 ms late"),
    *(pytest.param(*one, marks=pytest.mark.slow) for one in [
        ({"reference_average": 8e-3}, "8.00 ms"), ({"torque_filters": (FirstOrder(2e-3),)}, "2.01 ms"),
        ({"torque_filters": (FirstOrder(8e-4),), "behind": -1}, "0.814 ms, and its log is 1.0 ms early"),
        ({"delay": 3e-3}, "3.00 ms"), ({"reference_delay": 2e-3}, "2.00 ms late"),
    ]),
])  # fmt: skip
def test_a_mean_a_lag_and_a_dead_time_are_named_with_their_time(late: dict[str, Any], time: str) -> None:
    record, loop, law = _late(**late)
    (found,) = ji.identify(record, loop).about(Subject.LOOP)
    assert f" {time}: declare {next(iter(late))}" in found.words
    assert found.values["alike"] == ["log_delay"] * ("reference_delay" in late)  # as late as its log
    right = ji.identify(record, replace(loop, controller=law), ji.DIDIM(free=("log_delay",) * ("behind" in late)))
    assert right.answer.reliable
    assert abs(right["inertia"].value - RIGID["inertia"]) < 3 * right["inertia"].stderr


def test_a_lag_of_more_than_4_ms_is_no_current_loop() -> None:
    record, loop, _ = _late(torque_filters=(FirstOrder(8e-3),))
    laws = _list_late(*rebuild_problem(identify(record, loop), record), 4e-3)
    assert laws and not any("torque_filters" in law.remedy for law, _ in laws)


def test_a_reference_that_is_filled_in_as_declared_and_a_coarse_one_that_is_held_are_not_blamed() -> None:
    for record, loop in (_filled_in("linear"), _late(coarse=4)[:2]):
        assert faults_of(identify(record, loop), record).as_declared


@pytest.mark.slow
def test_what_moves_a_value_by_less_than_a_thousandth_is_in_its_interval() -> None:
    record, loop = drive(CASCADE, 10, noise=1e-4)
    found = ji.identify(record, replace(loop, controller=replace(CASCADE, period=1e-4, delay=1e-4)))
    inertia = found["inertia"]
    assert abs(inertia.value - RIGID["inertia"]) > 5 * inertia.stderr
    assert inertia.interval[0] < RIGID["inertia"] < inertia.interval[1]
    assert found.answer.reliable
