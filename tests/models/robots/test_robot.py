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
    ("joint", "says"),
    [
        (RobotJoint("b", viscous=-1.0), "viscous of the joint b is -1; expected 0 or more"),
        (RobotJoint("b", spring=JointSpring(1e4)), "positive stiffness and rotor inertia"),
        (RobotJoint("b", coupling={"d": 1.0}), "the joints are joint0, b, joint2"),
        (RobotJoint("b", coupling={"joint0": 1.0}), "a joint that no motor moves"),
    ],
)
def test_joints_that_are_refused(joint: RobotJoint, says: str) -> None:
    first = replace(ARM.joints[0], coupling={"b": 1.0} if "joint0" in joint.coupling else {})
    with pytest.raises(MethodError, match=says):
        replace(ARM, joints=(first, joint, ARM.joints[2]))


def test_a_coupled_wrist() -> None:
    joints = (*ARM.joints[:2], replace(ARM.joints[2], coupling={"joint1": -0.5}))
    assert replace(ARM, joints=joints).coupling.tolist() == [[1, 0, 0], [0, 1, 0], [0, -0.5, 1]]


def test_as_many_joints_as_links() -> None:
    with pytest.raises(MethodError, match="2 joints and 3 links"):
        Robot(ARM.links, ARM.joints[:2])
