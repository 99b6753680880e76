"""What a robot refuses to be."""

from __future__ import annotations

from dataclasses import replace

from jointid.models.robots.robot import JointSpring, RobotJoint
from tests.models.robots.trees import chain

ARM = chain()


def test_a_coupled_wrist() -> None:
    joints = (*ARM.joints[:2], replace(ARM.joints[2], coupling={"joint1": -0.5}))
    assert replace(ARM, joints=joints).coupling.tolist() == [[1, 0, 0], [0, 1, 0], [0, -0.5, 1]]


def test_a_joint_whose_spring_does_not_give_keeps_the_friction_behind_it() -> None:
    joint = RobotJoint("one", 0.1, 1.0, 2.0, coulomb_backwards=2.5, spring=JointSpring(1e3, viscous=3.0, coulomb=0.5))
    stiff = joint.rigid
    assert (stiff.viscous, stiff.viscous_backwards, stiff.coulomb, stiff.coulomb_backwards) == (4.0, None, 2.5, 3.0)
    assert stiff.values["viscous_backwards"] == 4.0
