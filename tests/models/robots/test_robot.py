"""What a robot refuses to be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from tests.models.robots.trees import chain

ARM = chain()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"parent": 1}, "a link before it"),
        ({"axis": np.array([0.0, 0.0, 2.0])}, "length 2; expected 1"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "orthogonal matrix"),
        ({"origin": np.array([0.0, np.nan, 0.0])}, "expected finite numbers"),
        ({"kind": "ball"}, '"revolute" or "prismatic"'),
        ({"name": ARM.links[0].name}, "Two links are called"),
    ],
)
def test_links_that_are_refused(change: dict[str, Any], says: str) -> None:
    links = (ARM.links[0], replace(ARM.links[1], **change), ARM.links[2])
    with pytest.raises(MethodError, match=says):
        replace(ARM, links=links)


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ({"viscous": -1.0}, "joint b: viscous is -1.*; expected a number, 0 or more"),
        ({"offset": float("inf")}, "joint b: offset is inf"),
        ({"spring": JointSpring(1e4)}, "has a spring, but no rotor_inertia"),
        ({"stribeck_force": 2.0}, "has a stribeck_force, but no stribeck_speed"),
    ],
)
def test_joints_that_are_refused(numbers: dict[str, Any], says: str) -> None:
    with pytest.raises(MethodError, match=says):
        RobotJoint("b", **numbers)


def test_couplings_that_are_refused() -> None:
    first, second, third = ARM.joints
    with pytest.raises(MethodError, match="the joints are joint0, joint1, joint2"):
        replace(ARM, joints=(replace(first, coupling={"d": 1.0}), second, third))
    tied = (replace(first, coupling={"joint1": 1.0}), replace(second, coupling={"joint0": 1.0}), third)
    with pytest.raises(MethodError, match="a joint that no motor moves"):
        replace(ARM, joints=tied)


def test_a_coupled_wrist() -> None:
    joints = (*ARM.joints[:2], replace(ARM.joints[2], coupling={"joint1": -0.5}))
    assert replace(ARM, joints=joints).coupling.tolist() == [[1, 0, 0], [0, 1, 0], [0, -0.5, 1]]


def test_as_many_joints_as_links() -> None:
    with pytest.raises(MethodError, match="2 joints and 3 links"):
        Robot(ARM.links, ARM.joints[:2])


def test_a_joint_whose_spring_does_not_give_keeps_the_friction_behind_it() -> None:
    joint = RobotJoint("one", 0.1, 1.0, 2.0, coulomb_backwards=2.5, spring=JointSpring(1e3, viscous=3.0, coulomb=0.5))
    stiff = joint.rigid
    assert (stiff.viscous, stiff.viscous_backwards, stiff.coulomb, stiff.coulomb_backwards) == (4.0, None, 2.5, 3.0)
    assert stiff.values["viscous_backwards"] == 4.0
