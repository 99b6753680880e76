"""Robots written after public URDF and MJCF files, with what such files have: each is read, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from jointid.common.errors import JointFileError
from jointid.config.robot_model import read_robot

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")


@dataclass(frozen=True)
class Model:
    """A file, and what is to be read: joints in order with their links' masses, and the beginnings of remarks."""

    text: str
    masses: dict[str, float]
    locked: dict[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    tied: bool = False
    """Whether it is refused where no joint is locked."""


SOLID = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/>'
ZERO = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
MESH = '<visual><geometry><mesh filename="{}" scale="1 1 1"/></geometry><material name="grey"/></visual>'


def mass(value: float | str, inertia: str = SOLID, origin: str = '<origin xyz="0.1 0 0.05"/>') -> str:
    return f'<inertial>{origin}<mass value="{value}"/>{inertia}</inertial>'


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = '<axis xyz="0 0 1"/>') -> str:
    limit = '<limit lower="-3" upper="3" effort="50" velocity="2"/>' if kind in ("revolute", "prismatic") else ""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.2 0 0.1" rpy="0 0.3 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limit if "<limit" not in inside else ""}{inside}</joint>'


def urdf(*parts: str, head: str = 'name="arm"') -> str:
    return f"<robot {head}>{''.join(parts)}</robot>"


def arm(size: int = 2, first: str = "", **own: str) -> str:
    """Return the links and joints of an arm on "base", with what some links have in place of a mass of 2 kg."""
    names = ["base", *(f"l{k}" for k in range(1, size + 1))]
    links = [link("base", first), *(link(name, own.get(name, mass(2))) for name in names[1:])]
    return "".join([*links, *(joint(f"j{k}", names[k - 1], names[k]) for k in range(1, size + 1))])


def fingers(follows: str = "") -> str:
    """Return two fingers on a hand that is fixed to l2."""
    other = f'<axis xyz="0 -1 0"/>{follows}'
    return (
        link("hand", mass(0.7)) + joint("wrist", "l2", "hand", "fixed", "")
        + link("left", mass(0.1)) + link("right", mass(0.1))
        + joint("finger1", "hand", "left", "prismatic", '<axis xyz="0 1 0"/>')
        + joint("finger2", "hand", "right", "prismatic", other)
    )  # fmt: skip


def body(name: str, joints: str, inside: str = "", inertial: str = 'mass="2" diaginertia="0.1 0.2 0.25"') -> str:
    own = f'<inertial pos="0.1 0 0" {inertial}/>' if inertial else ""
    return f'<body name="{name}" pos="0.2 0 0.1">{joints}{own}{inside}</body>'


def mjcf(world: str, beside: str = "", before: str = '<compiler angle="radian" meshdir="assets"/>') -> str:
    assets = '<asset><mesh name="link0" file="C:\\meshes\\link0.stl"/><material name="grey" rgba=".5 .5 .5 1"/></asset>'
    return f'<mujoco model="arm">{before}{assets}<worldbody><light pos="0 0 3"/>{world}</worldbody>{beside}</mujoco>'


def claw(joint_class: str = "") -> str:
    """Return an arm with two fingers, each of a driver and a spring link, in MJCF."""
    sides = "".join(
        body(f"{side}_driver", f'<joint name="{side}_driver" axis="1 0 0"/>',
             body(f"{side}_spring", f'<joint name="{side}_spring" axis="1 0 0" {joint_class}/>',
                  f'<site name="{side}_pad"/>', 'mass="0.05" diaginertia="1e-4 1e-4 1e-4"'),
             'mass="0.1" diaginertia="1e-4 1e-4 1e-4"')
        for side in ("left", "right")
    )  # fmt: skip
    return body("upper", '<joint name="j1" axis="0 0 1"/>', body("lower", '<joint name="j2" axis="0 1 0"/>', sides))


CLAW_LOCKED = {"left_driver": 0.2, "right_driver": 0.2, "left_spring": 0.0, "right_spring": 0.0}
COUPLED = '<joint joint1="left_driver" joint2="right_driver" polycoef="0 1 0 0 0"/>'

MODELS = {
    "an industrial arm with meshes of packages": Model(
        urdf(
            link("world"),
            joint("fix", "world", "base", "fixed", ""),
            arm(6, MESH.format("package://arm_description/meshes/base.stl") + mass(4)),
            link("tool0"),
            joint("flange", "l6", "tool0", "fixed", '<axis xyz="0 0 0"/>'),
            '<transmission name="t1"><joint name="j1"><hardwareInterface>x</hardwareInterface></joint></transmission>',
            '<gazebo reference="l1"><selfCollide>true</selfCollide></gazebo>',
        ),
        {f"j{k}": 2.0 for k in range(1, 7)},
    ),
    "masses of zero": Model(
        urdf(arm(3, l1=mass(0, ZERO), l2=mass(3, ZERO), l3=mass("0.0"))),
        {"j1": 0.0, "j2": 3.0, "j3": 0.0},
        remarks=("link l3",),
    ),
    "a gripper of which a finger follows the other": Model(
        urdf(arm(2), fingers('<mimic joint="finger1"/>')),
        {"j1": 2.0, "j2": 2.9},
        {"finger1": 0.02, "finger2": 0.02},
        tied=True,
    ),
    "an arm of MJCF with classes, meshes and actuators": Model(
        mjcf(
            body(
                "l1",
                '<joint name="j1" class="arm"/>',
                '<geom class="visual" mesh="link0"/>' + body("l2", '<joint name="j2"/>', '<geom mesh="link0"/>'),
            )
            + '<geom type="plane" size="1 1 1"/><camera name="c"/>',
            '<actuator><general name="a1" joint="j1"/></actuator><keyframe><key qpos="0 0"/></keyframe>'
            '<contact><exclude body1="l1" body2="l2"/></contact><sensor><jointpos joint="j1"/></sensor>',
            '<default><default class="arm"><joint axis="0 1 0" damping="1"/></default><default class="visual">'
            '<geom type="mesh" contype="0"/></default></default>',
        ),
        {"j1": 2.0, "j2": 2.0},
    ),
    "a gripper of MJCF whose drivers are tied, with springs in its links": Model(
        mjcf(claw('stiffness="0.05"'), f"<equality>{COUPLED}</equality>"),
        {"j1": 2.0, "j2": 2.3},
        CLAW_LOCKED,
        tied=True,
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_after_public_ones_is_read(name: str) -> None:
    model = MODELS[name]
    robot, _ = read_robot(model.text, "arm", model.locked)
    found = dict(zip(robot.names, robot.inertials[:, 0], strict=True))
    assert list(robot.names) == list(model.masses)
    assert found == pytest.approx(model.masses, abs=1e-12)
    assert np.isfinite(robot.inertials).all()
    assert len(robot.remarks) == len(model.remarks)
    for remark, begins in zip(robot.remarks, model.remarks, strict=True):
        assert remark.startswith(f"arm: {begins}")
    if model.tied:
        with pytest.raises(JointFileError):
            read_robot(model.text, "arm")


@pytest.mark.parametrize(
    ("inertial", "weighs", "remarks"),
    [
        (mass(2, SOLID.replace('0.2"', '0.7"').replace("0.25", "0.8")), 2.0, 0),  # of a plate, 0.1 + 0.7 < 0.8
        (mass(2, SOLID.replace("0.25", "0.3000001")), 2.0, 0),
        (mass(2, SOLID.replace('0.1"', '0"').replace("0.25", "0.2")), 2.0, 0),  # of a rod
        (mass(2, '<inertia ixx="0.1" iyy="0.2" izz="0.25"/>'), 2.0, 0),
        ('<inertial><mass value="2"/></inertial>', 0.0, 1),
        ('<inertial><inertia ixx="much"/></inertial>', 0.0, 1),
        ("<inertial/>", 0.0, 1),
    ],
)
def test_inertias_that_are_rounded_or_lack_a_part(inertial: str, weighs: float, remarks: int) -> None:
    robot, _ = read_robot("\n" + urdf(arm(1, l1=inertial)), "arm")
    assert robot.inertials[0][0] == pytest.approx(weighs)
    assert len(robot.remarks) == remarks
