"""What a robot refuses to be."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.models.friction import Friction
from jointid.models.robots.robot import JointSpring, RobotJoint
from tests.models.robots.trees import chain, inverse_dynamics

ARM = chain()


def test_a_coupled_wrist() -> None:
    joints = (*ARM.joints[:2], replace(ARM.joints[2], coupling={"joint1": -0.5}))
    assert replace(ARM, joints=joints).coupling.tolist() == [[1, 0, 0], [0, 1, 0], [0, -0.5, 1]]


def test_a_joint_whose_spring_does_not_give_keeps_the_friction_behind_it() -> None:
    joint = RobotJoint("one", 0.1, 1.0, 2.0, coulomb_backwards=2.5, spring=JointSpring(1e3, viscous=3.0, coulomb=0.5))
    stiff = joint.rigid
    assert (stiff.viscous, stiff.viscous_backwards, stiff.coulomb, stiff.coulomb_backwards) == (4.0, None, 2.5, 3.0)
    assert stiff.values["viscous_backwards"] == 4.0
    numbers = {"motor_presliding_distance": 1e-3, "load_presliding_distance": 3e-3, "load_coulomb_backwards": 0.75}
    laws = Friction("asymmetric-presliding"), {**numbers, "load_friction_per_torque": 0.1}
    found = replace(joint, friction=Friction(f"{laws[0].name}-load-dependent"), numbers=laws[1]).rigid
    assert found.numbers == {"coulomb_backwards": 3.25, "presliding_distance": 2e-3, "friction_per_torque": 0.1}


def test_a_turned_robot_moves_as_the_robot_at_shifted_positions() -> None:
    sliding = replace(ARM.links[2], kind="prismatic")
    robot = replace(ARM, links=(*ARM.links[:2], sliding, *ARM.links[3:]))
    random = np.random.default_rng(1)
    zeros, (q, v, a) = random.normal(size=3), random.normal(size=(3, 5, 3))
    turned = robot.turn(zeros)
    expected = inverse_dynamics(robot.tree, robot.inertials, q + zeros, v, a)
    assert inverse_dynamics(turned.tree, turned.inertials, q, v, a) == pytest.approx(expected, rel=1e-9, abs=1e-9)
