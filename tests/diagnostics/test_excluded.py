"""What the motor position proves of a controller and its log, and what is then not named as a cause."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.changes import Case
from jointid.diagnostics.explain import list_cases
from jointid.diagnostics.model_free import compare_law, excludes
from jointid.models.controllers import Cascade
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import faults_of

LAW = Cascade(position_gain=100.0, velocity_gain=4000.0, velocity_filter=(0.5, 0.5))
LOOP = ClosedLoop(RigidJoint("prismatic", Friction()), LAW)
WOUND = {"inertia": 30.0, "viscous": 80.0, "coulomb": 20.0, "presliding_distance": 1e-2, "offset": -1.0}
PLAIN = {"inertia": 30.0, "viscous": 80.0, "coulomb": 20.0, "offset": -1.0}


def logged(joint: RigidJoint, values: dict[str, float], law: Cascade = LAW, gain=1.0, seconds=4.0) -> Record:
    """Return a log of torque, noise of 0.3 N on it, reference and motor position."""
    reference = trapezoids((0.05, 0.1, 0.2), 2.0, 0.1, 1e-3, duration=seconds)
    record = simulated_record(ClosedLoop(joint, law), reference, values, sample_time=1e-3)
    noise = 0.3 * np.random.default_rng(1).standard_normal(reference.size)
    return record.with_channels({"torque": replace(record.torque, values=gain * record.torque.values + noise)})


@pytest.mark.slow
def test_a_law_that_the_motor_position_proves_is_not_blamed_for_the_mechanics() -> None:
    record = logged(RigidJoint("prismatic", Friction("presliding")), WOUND, seconds=8.0)
    loop = ClosedLoop(RigidJoint("prismatic", Friction("stribeck")), LAW)  # a wrong law of friction
    faults = faults_of(ji.identify(record, loop, checks=False), record)
    names = {fault.name for one in faults.findings for fault in (one.test.fault, *one.test.alike)}
    assert not {"velocity_gain", "position_gain", "delay", "period", "log_gain", "log_delay"} & names


@pytest.mark.parametrize(
    ("law", "gain"), [(replace(LAW, velocity_gain=4080.0), 1.0), (replace(LAW, position_gain=100.2), 1.0), (LAW, 1.02)]
)
def test_a_fault_that_the_motor_position_shows_is_not_excluded(law: Cascade, gain: float) -> None:
    record = logged(LOOP.joint, PLAIN, law, gain)
    assert compare_law(record, LOOP).holds  # within the 3 % that it may be off
    assert not excludes(record, LOOP, law, gain=gain - 1.0)
    assert excludes(logged(LOOP.joint, PLAIN), LOOP, law, gain=gain - 1.0)


def test_what_no_record_tells_from_a_fault_moves_the_values_by_its_own_size() -> None:
    record = logged(LOOP.joint, PLAIN, gain=1.05).without("motor_position")
    first, *_ = faults_of(found := ji.identify(record, LOOP, checks=False), record).findings
    assert first.test.alike and found["inertia"].value + first.changes["inertia"].by == pytest.approx(30.0, abs=0.1)


def test_a_log_that_is_late_is_excluded_as_the_motor_position_shows() -> None:
    record = logged(LOOP.joint, PLAIN)
    assert excludes(record, LOOP, LAW, late=5e-4)
    late = np.interp(record.torque.time - 2e-4, record.torque.time, record.torque.values)
    assert not excludes(record.with_channels({"torque": replace(record.torque, values=late)}), LOOP, LAW, late=2e-4)
    assert not excludes(record.without("motor_position"), LOOP, LAW, late=5e-4)


@pytest.mark.slow
def test_a_gross_cause_must_make_the_torque_of_the_motor_position() -> None:
    record = logged(LOOP.joint, PLAIN)

    def names(record: Record) -> set[str]:
        found = list_cases(Case(record, LOOP, ji.Filtering().resolve(1e-3, "rigid")))
        return {case.change.name for case in found if case.change is not None}

    gross = {"position_gain", "swapped_gains", "torque_sign"}
    assert gross | {"delay"} <= names(record.without("motor_position"))
    assert (gross | {"delay"}) & names(record) == {"delay"}  # behind the log
    assert gross <= names(record.with_channels({"torque": replace(record.torque, values=10.0 * record.torque.values)}))
    slow = replace(record.reference, values=record.reference.values[::4], sample_time=4e-3)
    assert not {"swapped_channels"} & names(record.with_channels({"reference": slow}))
