"""Flexible joints of robots from motor torques and motor positions, on twins whose controllers are not told."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.parameters import Parameter, Quantity
from jointid.diagnostics.diagnosis import diagnose_robot
from jointid.diagnostics.validation import Prediction
from jointid.estimation.robots.didim import RobotFit, search_robot
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.records.record import Channel, Record
from jointid.simulation.plant import OF_RECORD, Numbers
from jointid.simulation.synthesis import simulate
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.twin import axis_errors
from tests.robots_plants import Twin, assert_springs, six, stiffness_of, two
from tests.simulation.test_robots import COUPLED, RISING, changed

SPEEDS = tuple({"stribeck_speed": one["stribeck_speed"]} for one in RISING)


def logged(
    twin: Twin,
    duration: float = 3.5,
    multisine: float = 0.004,
    level: float = 0.02,
    late: int = 0,
    first: int = 0,
    seed: int = 1,
) -> tuple[Record, ...]:
    """Return torques with noise, seen so many samples late, and motor positions; neither reference nor controller."""
    loop, asked = twin.loop(), twin.records(duration, seed=seed, multisine=multisine)
    run = simulate(loop, asked)
    found = []
    for record, position in zip(recorded(loop, asked, level)[0], run.motor_position.T, strict=True):
        torque = replace(record.torque, values=np.roll(record.torque.values, late)[first:])
        unit = "rad" if record.torque.unit == "N m" else "m"
        found.append(Record(torque=torque, motor_position=Channel(position[first:], unit, torque.sample_time)))
    return tuple(found)


def blank(robot: Robot) -> Robot:
    """Return a robot whose numbers say nothing."""
    joints = tuple(
        RobotJoint(
            joint.name, rotor_inertia=1.0, coupling=joint.coupling, spring=JointSpring(1.0) if joint.spring else None
        )
        for joint in robot.joints
    )
    return replace(robot.with_inertials(np.zeros((len(robot), 10))), joints=joints)


def identified(twin: Twin, records: tuple[Record, ...], **how: object) -> RobotFit:
    settings = ji.DriveSideFit(**how)  # type: ignore[arg-type]
    return search_robot(blank(twin.robot), records, None, settings)


def inside(found: RobotFit, twin: Twin) -> float:
    """Return the share of the robot's parameters whose truth is within two deviations."""
    parameters = found.parameters
    truth = parameters.group(Numbers.of(twin.robot))
    mine = ~np.array([place.name in OF_RECORD for place in parameters.places])
    return float(np.mean(np.abs((found.values - truth) / found.covariance.std)[mine] < 2.0))


@pytest.mark.slow
def test_springs_come_back_with_their_intervals() -> None:
    twin = two((12.0, 18.0))
    found = identified(twin, logged(twin))
    assert found.converged
    assert_springs(found, twin, 0.02, 3.5)
    assert inside(found, twin) > 0.85
    assert found.value("log_delay")[0] == pytest.approx(0.0, abs=2e-5)


@pytest.mark.parametrize("late", [3, pytest.param(-2, marks=pytest.mark.slow)])
def test_a_log_that_is_late_is_told_from_damping(late: int) -> None:
    twin = two((12.0, 18.0))
    records = logged(twin, late=late)
    found = identified(twin, records, frequencies=hertz(twin))
    assert found.value("log_delay")[0] == pytest.approx(late * 1e-3, abs=2e-5)
    assert_springs(found, twin, 0.02, 3.5)
    assert inside(found, twin) > 0.85
    given = identified(twin, records, frequencies=hertz(twin), log_delay=late * 1e-3)
    assert "log_delay" not in given.parameters.names
    assert inside(given, twin) > 0.85


def test_a_known_delay_that_counts_from_a_timing_that_nobody_stated_is_searched() -> None:
    """By half a sample for a sampled torque, which a robot's answer covers, and springs do not notice."""
    twin = two((12.0, 18.0))
    unstated = [replace(one, torque=replace(one.torque, stated=False)) for one in logged(twin) if one.torque]
    settings = ji.DriveSideFit(log_delay=1.5e-3, frequencies=hertz(twin))
    found = ji.identify(unstated, blank(twin.robot), settings, checks=False)
    row = found["log_delay"]
    assert row.free and row.value is not None and row.stderr is not None
    assert abs(row.value) < 2e-5
    assert row.stderr >= 0.25e-3
    assert any("log_delay, which makes up for" in one for one in found.warnings)


def test_a_record_that_begins_in_motion() -> None:
    twin = two((12.0, 18.0))
    found = identified(twin, logged(twin, duration=5.0, first=1500), frequencies=hertz(twin))
    assert "joint1.initial_link_velocity" in found.parameters.names
    assert_springs(found, twin, 0.02, 3.5)
    assert inside(found, twin) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("hertz", "off"), [((12.0, None), 0.02), ((None, 12.0), 0.02), ((12.0, 18.0), 0.05)])
def test_springs_beside_a_rigid_joint_and_of_motors_that_are_coupled(hertz: Any, off: float) -> None:
    twin = two(hertz) if None in hertz else changed(two(hertz), *COUPLED)
    found = identified(twin, logged(twin))
    assert_springs(found, twin, off, 3.5)
    assert inside(found, twin) > 0.8


@pytest.mark.slow
def test_friction_that_rises_towards_standstill() -> None:
    twin = changed(two((12.0, 18.0)), *RISING)
    slow = changed(replace(twin, robot=blank(twin.robot)), *SPEEDS).robot
    found = search_robot(slow, logged(twin), None, ji.DriveSideFit())
    assert_springs(found, twin, 0.02, 3.5)
    for joint, rise in (("joint1", 2.0), ("joint2", 0.8)):
        value, deviation = found.value(f"{joint}.stribeck_force")
        assert abs(value - rise) < 3 * deviation < 0.7 * rise  # a third wider for a force in the loop


@pytest.mark.slow
def test_six_joints_are_found() -> None:
    """Modes from 8 to 28 Hz behind their motors; that of the last at 73 Hz, above the filter, is known worse."""
    twin = six(True)
    found = identified(twin, logged(twin, duration=6.0))
    assert found.converged
    truth = stiffness_of(twin.robot)
    for name, stiffness in zip([*found.springs][:5], truth[:5], strict=True):
        assert found.value(f"{name}.stiffness")[0] == pytest.approx(stiffness, rel=3e-3)
    assert inside(found, twin) > 0.88


@pytest.mark.slow
def test_a_spring_that_the_record_does_not_show_is_refused() -> None:
    twin = two((12.0, 18.0))
    stiff = replace(twin.robot.joints[1], spring=JointSpring(3e6, 10.0, 0.3, 0.4))
    twin = replace(twin, robot=replace(twin.robot, joints=(twin.robot.joints[0], stiff)))
    first, second = identified(twin, logged(twin)).springs.values()
    assert first is None
    assert second is not None and 1e4 < second < 3e6


@pytest.mark.slow
def test_the_answer_is_held_against_another_record() -> None:
    twin = replace(two((12.0, 18.0)), home=np.array([1.6, -2.3]))  # far from 0
    heavier = twin.robot.with_inertials(1.3 * np.array([link.inertial for link in twin.robot.links]))
    known = {"joint1.offset": Parameter("offset", "offset", Quantity.FORCE).fix(twin.robot.joints[0].offset)}
    estimate = ji.identify(logged(twin), heavier, ji.DriveSideFit(), parameters=known)
    row = estimate["joint1.offset"]
    assert (row.free, row.value, row.stderr, row.axis) == (False, known[row.name].start, None, "joint1")
    assert np.all(axis_errors(estimate) < 0.02)
    assert min(estimate.fit.nominal_errors.values()) > 0.05
    assert estimate.settings.method == "drive_side"
    assert estimate["log_delay"].unit == "s"
    held = ji.validate(estimate, logged(twin, seed=4))
    assert held.filtered_error < held.nominal_error
    assert held.answer.code is Prediction.PREDICTED
    assert all(axis.filtered_error < 0.03 for axis in held.axes)
    told = diagnose_robot(estimate, logged(twin))
    assert told.explained
    assert told.method == "drive_side"


@pytest.mark.slow
def test_where_links_are_at_first_is_no_merit_of_an_estimate() -> None:
    """In a record that begins in motion: a robot that is right leaves as little, there and elsewhere."""
    twin = two((12.0, 18.0))
    begun = logged(twin, duration=8.0, first=1500)
    estimate = ji.identify(begun, twin.robot, ji.DriveSideFit(frequencies=hertz(twin)))
    assert np.all(axis_errors(estimate) < 0.015)
    nominal = np.array([*estimate.fit.nominal_errors.values()])
    assert np.all(nominal < 1.1 * axis_errors(estimate))
    held = ji.validate(estimate, logged(twin, duration=7.0, seed=4, first=1500))
    assert all(axis.filtered_error < 0.02 for axis in held.axes)


def hertz(twin: Twin) -> Mapping[str, float]:
    return dict(zip(twin.robot.names, (14.0, 20.0), strict=True))
