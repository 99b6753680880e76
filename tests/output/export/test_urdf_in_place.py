"""An exported URDF is the user's own with other bodies and frictions."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import jointid as ji
from jointid.models.robots.inertial import is_physical

pytest.importorskip("mujoco")

TEXT = """<?xml version="1.0" encoding="utf-8"?>
<!-- the arm's own <inertial> is a guess: ä -->
<robot name="arm" xmlns:xacro="http://ros.org/xacro">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base_link"><visual><geometry><mesh filename="package://arm/base.dae"/></geometry></visual></link>
  <joint name="shoulder" type="revolute">
    <parent link="base_link"/><child link="upper"/>
    <origin xyz="0 0 0.2" rpy="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" effort="150" velocity="3.14"/>
    <dynamics damping='0.0'
      friction="0.0"></dynamics>
    <safety_controller k_velocity="20"/>
  </joint>
  <link name="upper">
    <visual name="a > b"><geometry><cylinder radius="0.06" length="0.4"/></geometry></visual>
    <inertial>
      <!-- from a drawing --><mass value="4"/><origin xyz="0.01 0 0.2" rpy="0.1 0.2 0.3"/>
      <inertia ixx="0.06" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.01"/>
    </inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
  <joint name="elbow" type="continuous">
    <origin xyz="0 0 0.4"/>
    <parent link="upper"/>
    <child link="lower"/>
    <axis xyz="0 1 0"/>
  </joint>
  <link name="lower"><inertial><mass value="2"/><origin xyz="0 0 0.15"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial></link>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/>
    <origin xyz="0 0.05 0.3" rpy="0 1.2 0"/></joint>
  <link name="tool"><inertial><mass value="0.7"/><origin xyz="0.04 0 0"/>
    <inertia ixx="0.002" ixy="0" ixz="0.0001" iyy="0.002" iyz="0" izz="0.001"/></inertial></link>
  <joint name="finger" type="prismatic"><parent link="tool"/><child link="left"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" effort="10" velocity="1"/></joint>
  <link name="left"><inertial><mass value="0.1"/><origin xyz="0 0.01 0"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <gazebo reference="tool"><mu1>0.9</mu1></gazebo>
</robot>
"""
LOCKED = {"finger": 0.03}


def others(text: str) -> list[tuple[str, dict[str, str]]]:
    """The elements of a URDF that are no part of an <inertial> and no <dynamics>."""
    root = ET.fromstring(text)
    for link in root.findall("link"):
        link[:] = [one for one in link if one.tag != "inertial"]
    return [(one.tag, one.attrib) for one in root.iter() if one.tag != "dynamics"]


def exported(path: Path, factor: float) -> tuple[str, ji.robots.Robot]:
    """Return the URDF of an arm whose bodies are other ones, and that arm."""
    path.write_bytes(TEXT.encode())
    robot = ji.robots.load_robot(path, LOCKED)
    turn = np.eye(10)
    turn[4:, 4:] *= factor
    links = tuple(replace(link, inertial=factor * turn @ link.inertial) for link in robot.links)
    joints = tuple(replace(joint, viscous=2.0 + k, coulomb=0.5) for k, joint in enumerate(robot.joints))
    changed = replace(robot, links=links, joints=joints)
    return ji.export(changed, "urdf", model=path, locked=LOCKED).text, changed


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_bodies_and_friction_are_replaced_and_nothing_else(factor: float, tmp_path: Path) -> None:
    text, changed = exported(tmp_path / "arm.urdf", factor)
    assert others(text) == others(TEXT.partition("?>")[2])
    (tmp_path / "found.urdf").write_bytes(text.encode())
    found = ji.robots.load_robot(tmp_path / "found.urdf", LOCKED)
    # MuJoCo 3.2 rounds the principal axes of a body at 1e-8 kg m2, where two principal moments are close.
    np.testing.assert_allclose(found.inertials, changed.inertials, rtol=1e-9, atol=1e-7)
    assert found.of_joints("viscous").tolist() == [2.0, 3.0] and found.of_joints("coulomb").tolist() == [0.5, 0.5]
    # The tool and the finger keep their part of what is fixed together.
    masses = [float(one) for one in re.findall(r'mass value="([^"]*)"', text)]
    assert masses == pytest.approx([4.0 * factor, 2.0 * factor, 0.7 * factor, 0.1 * factor], rel=0.2)


def test_every_body_of_those_that_are_fixed_together_can_be(tmp_path: Path) -> None:
    text, _ = exported(tmp_path / "arm.urdf", 1.6)
    apart = text.replace('name="flange" type="fixed"', 'name="flange" type="continuous"')
    (tmp_path / "apart.urdf").write_bytes(apart.encode())
    links = ji.robots.load_robot(tmp_path / "apart.urdf").links
    assert len(links) == 4 and all(is_physical(link.inertial) and link.inertial[0] > 0.0 for link in links)
