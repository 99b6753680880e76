"""DIDIM of robots with flexible joints, on twins: springs that are shown, and one that is refused with its bound."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.robots.didim import RobotFit, search_robot
from jointid.models.robots.robot import JointSpring, RobotLoop
from jointid.simulation.plant import robot_with
from jointid.simulation.synthesis import simulate
from tests.estimates import beside_tables
from tests.estimation.robots.test_rigid_robots import deviations, recorded
from tests.estimation.robots.twin import identified as identified_robot
from tests.robots_plants import Twin, assert_springs, seven, six, stiffness_of, two
from tests.simulation.test_robots import COUPLED, RISING, changed


def identified(
    twin: Twin,
    duration: float = 6.0,
    multisine: float = 0.004,
    frequencies: dict[str, float] | None = None,
    level: float = 0.02,
) -> tuple[RobotFit, np.ndarray]:
    """Return what is found of a twin with noise, from a robot whose numbers say nothing; and the noise."""
    loop = twin.loop()
    records, noise = recorded(loop, twin.records(duration, multisine=multisine), level)
    joints = tuple(
        replace(
            j, rotor_inertia=1.0, viscous=0.0, coulomb=0.0, stribeck_force=0.0, spring=j.spring and JointSpring(1.0)
        )
        for j in twin.robot.joints
    )
    blank = replace(twin.robot.with_inertials(np.zeros((len(joints), 10))), joints=joints)
    settings = DIDIM(frequencies=frequencies or {}, evaluations=60)
    found = search_robot(RobotLoop(blank, loop.controllers), records, None, settings)
    return found, noise


@pytest.mark.slow
def test_a_record_without_noise_settles() -> None:
    """As everyone's first trial has none: the search is over where the simulation itself errs, soon."""
    twin = two((8.0, 25.0))
    found, _ = identified(twin, level=0.0)
    assert found.converged and found.iterations < 30
    assert max(found.relative_error) < 1e-6
    assert_springs(found, twin, 1e-4)


def test_springs_come_back_with_their_intervals() -> None:
    twin = two((12.0, 18.0))
    found, noise = identified(twin)
    assert found.converged
    assert found.problem.sigma[:, 0] == pytest.approx(np.std(noise, axis=0) * np.sqrt(2 * 60.0 * 1e-3), rel=0.15)
    assert np.mean(np.abs(deviations(found, twin)) < 2) > 0.85
    assert_springs(found, twin, 0.09, 3.0)
    for name in found.springs:
        stiffness, deviation = found.value(f"{name}.stiffness")
        assert deviation < 0.03 * stiffness
    same = replace(twin.loop(), robot=robot_with(twin.robot, found.problem.numbers(found.x)))
    again = simulate(same, twin.records(6.0, multisine=0.004))
    assert again.torque == pytest.approx(found.runs[0].torque, abs=1e-9)


def test_a_robot_of_one_flexible_and_one_rigid_joint() -> None:
    twin = two((12.0, None))
    found, _ = identified(twin, frequencies={"joint1": 15.0})
    assert_springs(found, twin, 0.01)
    assert "joint2.stiffness" not in found.parameters.names


@pytest.mark.slow
def test_springs_behind_friction_that_rises_towards_standstill() -> None:
    twin = changed(two((12.0, 18.0)), *RISING)
    found, _ = identified(twin)
    assert_springs(found, twin, 0.02)
    for joint, rise in (("joint1", 2.0), ("joint2", 0.8)):
        value, deviation = found.value(f"{joint}.stribeck_force")
        assert abs(value - rise) < 3 * deviation < 0.5 * rise
    value, deviation = found.value("joint1.stribeck_speed")
    assert abs(value - 0.1) < 3 * deviation < 0.05
    assert robot_with(twin.robot, found.problem.numbers(found.x)).joints[0].stribeck_speed == value
    assert np.mean(np.abs(deviations(found, twin)) < 2) > 0.85


@pytest.mark.slow
def test_springs_of_motors_that_are_coupled() -> None:
    twin = changed(two((12.0, 18.0)), *COUPLED)
    found, _ = identified(twin, frequencies={"joint1": 14.0, "joint2": 16.0})
    assert_springs(found, twin, 0.05)
    assert np.mean(np.abs(deviations(found, twin)) < 2) > 0.85


@pytest.mark.slow
def test_a_spring_that_is_not_shown_is_refused_with_its_bound() -> None:
    """A joint that is as good as rigid: no stiffness, but how stiff it is at least."""
    twin = two((12.0, 110.0))
    found, _ = identified(twin, frequencies={"joint1": 14.0, "joint2": 40.0})
    truth = stiffness_of(twin.robot)
    soft, stiff = found.springs.values()
    assert soft is None
    assert stiff is not None and 0.03 * truth[1] < stiff < truth[1]


@pytest.mark.slow
def test_a_rigid_robot_is_told_soon() -> None:
    """Springs asked of a robot without any: refused after two short searches, and no damping stands without them."""
    twin = two()
    loop = twin.loop()
    records, _ = recorded(loop, twin.records(4.0), 0.01)
    asked = tuple(replace(joint, spring=JointSpring(5e3)) for joint in twin.robot.joints)
    found = identified_robot(RobotLoop(replace(loop.robot, joints=asked), loop.controllers), records)
    assert found.fit.simulations <= 24
    told = found.summary(details=True)
    assert "design" in beside_tables(found)["next"]
    assert "leave the springs out of the robot file" in " ".join(told.split())
    assert "damping" not in told
    springs = [row for name, row in found.parameters.items() if name.endswith((".damping", ".stiffness"))]
    assert len(springs) == 4 and all(row.value is None and row.stderr is None for row in springs)


def test_a_descent_that_left_little_is_followed_from_where_it_is() -> None:
    """It had not ended: three starts of 12 simulations each were tried beside it, and none was taken."""
    found, _ = identified(two((8.0, 45.0)), 3.0)
    assert found.converged and found.iterations < 40


@pytest.mark.slow
@pytest.mark.parametrize(("twin", "duration"), [(six(True), 6.0), (seven(True), 10.0)], ids=["six", "seven"])
def test_six_and_seven_flexible_joints(twin: Twin, duration: float) -> None:
    """Of the seven, three modes are above those that the search begins with, and soft springs explain little."""
    found, _ = identified(twin, duration)
    assert found.converged
    assert np.mean(np.abs(deviations(found, twin)) < 2) > 0.9
    assert_springs(found, twin, 0.06)
