"""What surrounds a joint, identified with it; seeds are fixed once and never retuned."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import Cascade, FirstOrder, Notch, SecondOrder, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER
from tests.faults import Fault, line_7, problem, setting, solved

RIGID = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


def rigid_record(loop: ClosedLoop) -> Record:
    reference = trapezoids((0.1, 0.2), 2.0, 0.1, 1e-3, duration=3.6)
    return simulated_record(loop, reference, RIGID, sample_time=1e-3)


@pytest.mark.slow
def test_a_rigid_joint_is_identified_with_the_delay_of_its_loop() -> None:
    declared = ClosedLoop(RigidJoint("prismatic"), replace(CONTROLLER, limit=1e3))
    actual = replace(declared, controller=replace(declared.controller, delay=0.3e-3))  # type: ignore[type-var]
    estimate = identify(rigid_record(actual), declared, DIDIM(free=("delay",)))
    assert estimate["delay"].value == pytest.approx(0.3e-3, rel=1e-4)
    assert estimate["delay"].unit == "s"
    assert not estimate["delay"].of_joint
    assert "delay" not in estimate.values
    assert estimate.settings.delay == estimate["delay"].value
    assert estimate.settings.loop.controller.law(1e-3).delay == estimate["delay"].value
    for name, value in RIGID.items():
        assert estimate.values[name] == pytest.approx(value, rel=1e-5)


@pytest.mark.slow
def test_a_flexible_joint_is_identified_with_gains_and_delay() -> None:
    where = setting("L19", brief=True)
    made = problem(where, Fault(line_7), None)
    record = replace(where.record, torque=replace(where.record.torque, values=made.measured))
    estimate = identify(record, where.loop, DIDIM(frequency=30.0, free=("position_gain", "velocity_gain", "delay")))
    for name, value in (where.truth | line_7(where.loop)).items():
        assert estimate[name].value == pytest.approx(value, rel=1e-4), name
    assert estimate.fit.relative_error < 1e-5


def test_the_log_s_own_gain_and_delay_are_found() -> None:
    where = setting("L19", brief=True)
    wrong = Fault(log_gain=1.03, log_shift=1)
    made = problem(where, wrong, None).freeing("log_gain", "log_delay")
    found = dict(zip((p.name for p in made.free), solved(made, where), strict=True))
    assert found["log_gain"] == pytest.approx(1.03, rel=1e-5)
    assert found["log_delay"] == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.slow
def test_torque_alone_finds_the_delay_of_the_real_axis(emps: Record, emps_pulses: Record) -> None:
    """Its motor answers 0.2 to 0.3 ms after the log; from torque alone that takes the pulses, and the gains free."""
    loop = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
    pulsed = identify(emps_pulses, loop, DIDIM(free=("position_gain", "velocity_gain", "delay")))["delay"]
    assert pulsed.value == pytest.approx(0.31e-3, abs=0.02e-3)
    assert pulsed.stderr == pytest.approx(0.08e-3, rel=0.2)
    plain = identify(emps, loop, DIDIM(free=("delay",)))["delay"]
    assert float(plain.value or 0.0) < 2 * float(plain.stderr or 0.0)


@pytest.mark.parametrize(
    ("name", "declared"),
    [
        ("torque_filters.0.frequency", 400.0),  # of 490 Hz, beside the 500 Hz beyond which there is none
        ("torque_filters.1.numerator_damping", -0.1), ("velocity_filter.time_constant", 1.6e-3),
        ("reference_delay", 1.6e-3), ("integral_gain", 16.0), ("gain", 0.8),
    ],
)  # fmt: skip
def test_any_number_of_a_law_is_found_from_beside(name: str, declared: float) -> None:
    """Also where the search's steps would leave what a law can have."""
    true = Cascade(
        position_gain=40.0,
        velocity_gain=6000.0,
        integral_gain=20.0,
        velocity_filter=FirstOrder(2e-3),
        torque_filters=(Notch(490.0, 60.0, 0.2), SecondOrder(300.0, 0.7, 200.0, 0.1)),
        reference_delay=2e-3,
        velocity_feedforward=0.8,
    )
    values = {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    reference = trapezoids((0.06, 0.12), 0.8, 0.1, 1e-3, duration=4.0)
    noise = np.random.default_rng(0).standard_normal(reference.size)
    loop = ClosedLoop(RigidJoint("prismatic"), true)
    record = simulated_record(loop, reference, values, sample_time=1e-3, torque_noise=noise)
    wrong = ClosedLoop(RigidJoint("prismatic"), with_numbers(true, {name: declared}))
    estimate = identify(record, wrong, DIDIM(free=(name,)))
    found = estimate[name]
    assert abs((found.value or 0.0) - numbers_of(true)[name]) <= 4 * (found.stderr or 0.0)
    assert estimate.values["inertia"] == pytest.approx(100.0, rel=5e-3)
