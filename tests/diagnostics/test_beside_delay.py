"""A delay that nobody declared is found from afar, and never stands for a filter, a gain or a spring unsaid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.faults.record import find_torque_scale
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import PD, FirstOrder
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.simulation.synthesis import simulated_record
from jointid.uncertainty.verdict import Reason, Subject
from tests.estimates import identify

LOG, LATE = 4e-3, 8.3e-3  # s
TRUE = {"inertia": 0.05, "viscous": 0.1, "coulomb": 0.3, "offset": 0.0}
DECLARED = ClosedLoop(
    RigidJoint("revolute"),
    PD(position_gain=20.0, derivative_gain=1.0, reference_velocity="none", period=1e-3, interpolation="hold"),
)


def logged(fastest: float = 20.0, noise: float = 0.03, seed: int = 1, **changes: object) -> Record:
    """Return a noisy log of 4 s under the declared law with changes, whose reference has sines up to a frequency."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 4.0, LOG)
    hertz = np.geomspace(0.3, fastest, 12)
    sines = np.sin(2 * np.pi * np.outer(time, hertz) + rng.uniform(0, 2 * np.pi, 12)) / hertz
    reference = np.minimum(time, 1.0) * sines.sum(axis=1) * 0.2
    drives = replace(DECLARED, controller=replace(DECLARED.controller, **changes))  # type: ignore[type-var]
    record = simulated_record(drives, reference, TRUE, sample_time=LOG)
    assert record.torque is not None
    torque = record.torque.values
    seen = torque + noise * torque.std() * rng.standard_normal(torque.size)
    return replace(record, torque=replace(record.torque, values=seen))


def free_delay(record: Record) -> ji.Estimate:
    return identify(record, DECLARED, DIDIM(free=("delay",)), checks=True)


def loop_reason(estimate: ji.Estimate) -> tuple[str, dict[str, object]]:
    verdict = next(one for one in estimate.checks.verdicts if one.subject is Subject.LOOP)
    return str(verdict.reasons[0].code), dict(verdict.reasons[0].values)


def test_a_delay_of_eight_periods_is_found_and_nothing_else_explains_the_record() -> None:
    found = free_delay(logged(delay=LATE))
    late, known = found["delay"].value, found["delay"].deviation
    assert late is not None
    assert known is not None
    assert abs(late - LATE) < 3e-4
    code, values = loop_reason(found)
    assert code == Reason.LOOP_AS_DECLARED
    assert values["not_the_delay"] == ["velocity_filter", "torque_filter", "derivative_gain", "flexible"]
    assert found.answer.reliable


@pytest.mark.slow
def test_a_filter_that_was_taken_for_a_delay_is_named_and_its_shift_is_in_the_intervals() -> None:
    found = free_delay(logged(velocity_filter=FirstOrder(6e-3)))
    code, values = loop_reason(found)
    assert code == Reason.LOOP_NOT_AS_DECLARED
    assert values["suspect"] == "velocity_filter"
    [said] = [one for one in found.checks.warnings if "than the delay of" in one]
    assert said.startswith("a velocity filter of 5.")
    assert "explains the record better" in said
    delay, inertia = found["delay"], found["inertia"]
    assert delay.value is not None
    assert delay.deviation is not None
    assert 2 * delay.deviation > 0.99 * delay.value  # there may be none
    assert inertia.value is not None
    assert inertia.deviation is not None
    assert abs(inertia.value - TRUE["inertia"]) < 2 * inertia.deviation


def test_a_delay_that_may_be_none_is_not_compared() -> None:
    found = free_delay(logged(fastest=1.0, noise=0.2))
    assert "not_the_delay" not in loop_reason(found)[1]
    assert not any("the delay of" in one for one in found.checks.warnings)


def test_a_torque_of_another_scale_is_named_by_the_law_and_the_motor_position() -> None:
    record = logged(noise=0.01, fastest=3.0)
    assert record.torque is not None
    assert find_torque_scale(record, DECLARED) is None
    ninth = replace(record, torque=replace(record.torque, values=record.torque.values / 9))
    said = find_torque_scale(ninth, DECLARED)
    assert said is not None
    assert said.values["causes"][0]["cause"] == "torque_scale"
    assert abs(9 * said.values["causes"][0]["value"] - 1) < 0.1
