"""Flexible joints of robots from motor torques and motor positions, on twins whose controllers are not told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.robots.drive_side import identify_flexible_drive_side
from jointid.estimation.robots.flexible import FlexibleRobotFit
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import simulate_robot
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import Twin, six, two
from tests.simulation.test_robots import COUPLED, changed


def logged(
    twin: Twin,
    duration: float = 6.0,
    multisine: float = 0.004,
    level: float = 0.02,
    late: int = 0,
    first: int = 0,
    seed: int = 1,
) -> tuple[Record, ...]:
    """Return torques with noise, seen so many samples late, and motor positions; neither reference nor controller."""
    loop, asked = twin.loop(), twin.records(duration, seed=seed, multisine=multisine)
    run = simulate_robot(loop, asked)
    found = []
    for record, position in zip(recorded(loop, asked, level)[0], run.motor_position.T, strict=True):
        assert record.torque is not None
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


def identified(twin: Twin, records: tuple[Record, ...], **how: object) -> FlexibleRobotFit:
    return identify_flexible_drive_side(blank(twin.robot), records, **how)  # type: ignore[arg-type]


def inside(found: FlexibleRobotFit, twin: Twin) -> float:
    """Return the share of the robot's parameters whose truth is within two deviations."""
    parameters = found.fit.parameters
    truth = parameters.group(RobotNumbers.of(twin.robot))
    mine = ~np.array([place.is_of_record for place in parameters.places])
    return float(np.mean(np.abs((found.fit.values - truth) / found.fit.covariance.std)[mine] < 2.0))


def assert_springs(found: FlexibleRobotFit, twin: Twin, within: float) -> None:
    truth = RobotNumbers.of(twin.robot).springs
    for spring, stiffness in zip(found.springs, truth[truth[:, 0] > 0.0, 0], strict=True):
        assert spring.shown, spring
        assert spring.stiffness is not None and spring.deviation is not None
        assert abs(spring.stiffness - stiffness) < 3.5 * spring.deviation
        assert spring.stiffness == pytest.approx(stiffness, rel=within)


def test_springs_come_back_with_their_intervals() -> None:
    twin = two((12.0, 18.0))
    found = identified(twin, logged(twin))
    assert found.fit.converged
    assert_springs(found, twin, 0.02)
    assert inside(found, twin) > 0.85
    assert found.fit.value("log_delay")[0] == pytest.approx(0.0, abs=2e-5)


@pytest.mark.parametrize("late", [3, -2])
def test_a_log_that_is_late_is_told_from_damping(late: int) -> None:
    twin = two((12.0, 18.0))
    records = logged(twin, late=late)
    found = identified(twin, records)
    assert found.fit.value("log_delay")[0] == pytest.approx(late * 1e-3, abs=2e-5)
    assert_springs(found, twin, 0.02)
    assert inside(found, twin) > 0.85
    taken = identified(twin, records, delay=0.0)  # as if it were not
    assert "log_delay" not in taken.fit.names
    damping, deviation = taken.fit.value("joint1.damping")
    assert abs(damping - RobotNumbers.of(twin.robot).springs[0, 1]) > 5 * deviation
    assert inside(identified(twin, records, delay=late * 1e-3), twin) > 0.85


def test_a_record_that_begins_in_motion() -> None:
    twin = two((12.0, 18.0))
    found = identified(twin, logged(twin, duration=8.0, first=1500))
    assert "joint1.initial_link_velocity" in found.fit.names
    assert_springs(found, twin, 0.02)
    assert inside(found, twin) > 0.8


def test_a_robot_of_one_flexible_and_one_rigid_joint() -> None:
    for hertz in ((12.0, None), (None, 12.0)):
        twin = two(hertz)
        found = identified(twin, logged(twin))
        assert_springs(found, twin, 0.02)
        assert inside(found, twin) > 0.8


def test_springs_of_motors_that_are_coupled() -> None:
    twin = changed(two((12.0, 18.0)), *COUPLED)
    found = identified(twin, logged(twin))
    assert_springs(found, twin, 0.05)
    assert inside(found, twin) > 0.8


@pytest.mark.slow
def test_six_joints_are_placed_one_after_the_other() -> None:
    """Modes from 8 to 28 Hz behind their motors; that of the last at 73 Hz, above the filter, is known worse."""
    twin, said = six(True), list[str]()
    found = identified(twin, logged(twin, duration=10.0), progress=said.append)
    assert [line.split(":")[0] for line in said if "swings" in line][:2] == ["joint1", "joint2"]
    assert found.fit.converged
    truth = RobotNumbers.of(twin.robot).springs[:, 0]
    for spring, stiffness in zip(found.springs[:5], truth[:5], strict=True):
        assert spring.stiffness == pytest.approx(stiffness, rel=3e-3)
    assert inside(found, twin) > 0.88


def test_a_spring_that_the_record_does_not_show_is_refused() -> None:
    twin = two((12.0, 18.0))
    stiff = replace(twin.robot.joints[1], spring=JointSpring(3e6, 10.0, 0.3, 0.4))
    twin = replace(twin, robot=replace(twin.robot, joints=(twin.robot.joints[0], stiff)))
    first, second = identified(twin, logged(twin)).springs
    assert first.shown
    assert not second.shown
    assert 1e4 < second.at_least < 3e6


def test_the_answer_is_held_against_another_record() -> None:
    twin = two((12.0, 18.0))
    heavier = twin.robot.with_inertials(1.3 * np.array([link.inertial for link in twin.robot.links]))
    estimate = ji.identify_robot_drive_side(heavier, logged(twin), ji.RobotDriveSideFit(frequencies=hertz(twin)))
    assert np.all(estimate.joint_errors < 0.02)
    assert np.all(estimate.nominal_errors > 0.05)
    text = estimate.document().text()
    assert "drive side of a robot, from motor torques and motor positions" in text
    assert estimate.rows["log_delay"]["unit"] == "s"
    held = ji.validate_robot_torques(estimate, logged(twin, duration=5.0, seed=4))
    assert held.better
    assert np.all(held.joint_errors < 0.03)
    told = ji.diagnose_robot(estimate, logged(twin))
    assert told.explained
    assert "log_delay" not in {one.name for joint in told.joints for one in joint.parameters}


def hertz(twin: Twin) -> Mapping[str, float]:
    return dict(zip(twin.robot.names, (14.0, 20.0), strict=True))


def test_faults_are_said() -> None:
    twin = two((12.0, 18.0))
    records = logged(twin, duration=2.0)
    rigid = replace(twin.robot, joints=tuple(replace(joint, spring=None) for joint in twin.robot.joints))
    with pytest.raises(MethodError, match="No joint of this robot has a spring"):
        identify_flexible_drive_side(rigid, records)
    with pytest.raises(MethodError, match="joint2 has none: give one in Hz"):
        identify_flexible_drive_side(twin.robot, records, frequencies={"joint1": 12.0})
    with pytest.raises(MethodError, match=r'A name in frequencies is "joint3"; expected'):
        identify_flexible_drive_side(twin.robot, records, frequencies={**hertz(twin), "joint3": 12.0})
    with pytest.raises(ji.RecordError, match="motor_position"):
        identify_flexible_drive_side(twin.robot, [replace(record, motor_position=None) for record in records])
    with pytest.raises(
        MethodError, match="swing behind their motors from 4 Hz on, and the torques are filtered at 3 Hz"
    ):
        identify_flexible_drive_side(twin.robot, records, Filtering(cutoff=3.0))
    dead = [replace(r, torque=replace(r.torque, values=0 * r.torque.values)) for r in records[1:] if r.torque]
    with pytest.raises(MethodError, match="The torque of joint2 is 0 throughout"):
        identify_flexible_drive_side(twin.robot, [records[0], *dead])
    still = [replace(r, motor_position=replace(r.motor_position, values=0 * r.motor_position.values)) for r in records]  # type: ignore[type-var,union-attr]
    with pytest.raises(MethodError):
        identify_flexible_drive_side(twin.robot, still)
