"""Base parameters: known groupings, whatever the scale, and as many as a published count."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.parameters import robot_parameters
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.robot import Link, Robot, RobotJoint
from jointid.simulation.plant import Numbers
from tests.estimation.robots.twin import torque_of
from tests.models.robots.trees import chain, inverse_dynamics, random_robot

DOWN = np.array([0.0, 0.0, -9.81])


def planar(length: float) -> Robot:
    """Two joints about horizontal parallel axes, a length apart."""
    flat = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    links = (Link("a", -1, rotation=flat), Link("b", 0, origin=np.array([length, 0.0, 0.0])))
    return Robot(links, (RobotJoint("p"), RobotJoint("q")), DOWN)


def sums_of(robot: Robot) -> dict[str, str]:
    """Return the sums that the parameters of links and rotors stand for, by the symbols that these begin with."""
    formulas = robot_parameters(robot).formulas(robot)
    return {one.split()[0]: one for one in formulas if one[0] in "mI"}


@pytest.mark.parametrize("length", [0.7, 7e-4, 700.0])
def test_two_links_group_as_in_the_textbook(length: float) -> None:
    """Khalil and Dombre 2002, example 9.2: the second mass goes into the first link by its distance."""
    said = sums_of(planar(length))
    square, once = f"{length**2:.4g}", f"{length:.4g}"
    assert set(said) == {"Izz1", "mx1", "my1", "Izz2", "mx2", "my2", "Ia2"}
    assert said["Izz2"] == "Izz2" and said["mx2"] == "mx2"
    assert [float(text) for text in said["mx1"].replace("mx1 + m2 * ", "").split()] == [float(once)]
    assert said["Izz1"].startswith("Izz1 + m2 * ") and said["Izz1"].endswith("+ Ia1")
    assert float(said["Izz1"].split()[4]) == pytest.approx(float(square), rel=1e-3)


def test_a_six_joint_arm_with_a_spherical_wrist_has_36_of_links() -> None:
    """Khalil and Dombre 2002, table 9.4: the Staubli RX-90 has 40 with its rotors, four of which are rotors'."""
    half, d3, r4 = np.pi / 2, 0.45, 0.45
    rows = [(0.0, 0.0, 0.0), (half, 0.0, 0.0), (0.0, d3, 0.0), (-half, 0.0, r4), (half, 0.0, 0.0), (-half, 0.0, 0.0)]
    links = []
    for k, (alpha, d, r) in enumerate(rows):  # modified Denavit and Hartenberg
        turn = np.array([[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]])
        links.append(Link(f"l{k}", k - 1, rotation=turn, origin=np.array([d, 0.0, 0.0]) + turn @ [0.0, 0.0, r]))
    robot = Robot(tuple(links), tuple(RobotJoint(f"j{k}") for k in range(6)), DOWN)
    base = sums_of(robot)
    assert sorted(one for one in base if one.startswith("Ia")) == ["Ia3", "Ia4", "Ia5", "Ia6"] and len(base) == 40


@pytest.mark.parametrize("seed", range(5))
def test_base_columns_and_parameters_give_the_torque(seed: int) -> None:
    robot = random_robot(seed)
    base = robot_parameters(robot, whole=False)
    q, v, a = np.random.default_rng(seed).normal(size=(3, 50, 6))
    columns = base.columns(robot, q, v, a)
    torque = torque_of(robot, q, v, a)
    assert columns @ base.group(Numbers.of(robot)) == pytest.approx(torque, rel=1e-7, abs=1e-7)
    rows = columns.reshape(300, -1)
    assert np.linalg.matrix_rank(rows / np.linalg.norm(rows, axis=0)) == rows.shape[1]


def test_the_rotor_of_a_slide_that_always_points_the_same_way_joins_its_mass_and_the_weight_its_offset() -> None:
    arm = chain(3)
    links = (
        replace(arm.links[0], kind="prismatic", axis=np.array([0.0, 0.0, 1.0]), rotation=np.eye(3)),
        *arm.links[1:],
    )
    robot = replace(arm, links=links)
    formulas = robot_parameters(robot).formulas(robot)
    assert {"offset1 + m1 * 9.810 + m2 * 9.810 + m3 * 9.810", "offset2", "offset3"} <= set(formulas)
    assert sums_of(robot)["m1"] == "m1 + m2 + m3 + Ia1"


def test_a_coupled_motor_turns_with_both_joints() -> None:
    arm = chain(3)
    joints = (*arm.joints[:2], replace(arm.joints[2], coupling={"joint1": 0.5}, rotor_inertia=2.0))
    robot = replace(arm, joints=joints)
    q, v, a = np.random.default_rng(3).normal(size=(3, 4, 3))
    standard = np.concatenate([robot.inertials.ravel(), robot.of_joints("rotor_inertia")])
    torque = inverse_columns(robot, q, v, a) @ standard
    motors = a @ robot.coupling.T
    rotors = motors * robot.of_joints("rotor_inertia")
    links = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    work = np.sum((torque - rotors) * (v @ robot.coupling.T), axis=1)  # a gear loses no power
    assert work == pytest.approx(np.sum(links * v, axis=1), rel=1e-10)
    base = robot_parameters(robot, whole=False)
    viscous = base.columns(robot, q, v, a)[:, 2, base.names.index(f"{robot.names[2]}.viscous")]
    assert viscous == pytest.approx(v[:, 2] + 0.5 * v[:, 1])
