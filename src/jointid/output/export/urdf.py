"""URDF of a joint or robot; or a user's URDF, updated.

A joint has `dynamics`: `damping` and `friction` are its viscous and Coulomb friction, the same in both directions.
URDF has no spring and no constant force. A flexible joint is written as a rigid one with the sums of its two sides,
which holds far below its resonance.

A user's URDF keeps all but its `<inertial>` and `<dynamics>`. Links that are fixed to each other, as a tool to a wrist,
have one body in a robot. It is divided as in the URDF: with P the pseudo-inertias of the URDF's bodies, in the frame of
the first, each becomes ``T P T'``, where T maps their sum to the identified body. So each body is physically consistent
and near its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common.arrays import FloatArray
from jointid.config.robot_model import LARGEST, parse_model, read_robot
from jointid.config.toml import read_text
from jointid.models.robots.inertial import MassProperties, inertial_of, mass_properties, pseudo_inertia
from jointid.output.export.bodies import Body, Model, format_xml, robot_bodies, triple
from jointid.output.export.joint_model import identifier, number

_DOWN = np.array([0.0, 0.0, -9.81])  # gravity of URDF, which has no word for it
_FAR, _STRONG = "1000.0", "1000000000.0"  # limits in m and N that URDF asks for and nothing here knows
_LIMITS = "The limits are wider than any machine: URDF asks for them and nothing here knows them; write your own."
_THIN = 1e-9  # of a sum's second moments, so that a rod or a plate has a factor
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def urdf(
    source: Model,
    *,
    model: str | Path | None = None,
    locked: Mapping[str, float] = MappingProxyType({}),
) -> tuple[str, list[str]]:
    """Joint or robot as URDF, and its losses.

    `model`, the URDF that a robot was read from, is kept except for `<inertial>` and `<dynamics>`; `locked` are its
    joints that stand still, see `load_robot`.

    Raises:
        MethodError: URDF cannot have these numbers.
    """
    name = "" if source.alone is None else identifier(source.alone.name)
    robot = source.robot(name, rigid=True)
    lost, bodies = source.lost("coulomb", "law of the spring", "weight"), robot_bodies(robot)
    if np.any(robot.of_joints("rotor_inertia")):
        lost.append("the rotors' inertias")
    if model is not None:
        root, more = _replace(read_text(Path(model), LARGEST), bodies, locked)
        return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n', [*lost, *more]
    if not np.allclose(robot.gravity, _DOWN, atol=1e-3):
        lost.append("how the base stands, and gravity other than 9.81 m/s2: turn it where the model is used")
    names = {link.name for link in robot.links}
    base = next(name for name in ("base", *(f"base_{k}" for k in range(len(names) + 1))) if name not in names)
    root = ET.Element("robot", name=robot.name)
    ET.SubElement(root, "link", name=base)
    for body in bodies:
        _add(root, body, base if body.link.parent < 0 else bodies[body.link.parent].link.name)
    sliding = any(link.kind == "prismatic" for link in robot.links)
    return format_xml(root, [*source.remarks(lost), *([_LIMITS] if sliding else [])]), lost


def _add(root: ET.Element, body: Body, parent: str) -> None:
    """Add the link and the joint of a body."""
    link, element = body.link, ET.SubElement(root, "link", name=body.link.name)
    if body.solid is not None:
        _fill_inertial(ET.SubElement(element, "inertial"), body.solid)
    kind = "continuous" if link.kind == "revolute" else "prismatic"
    joint = ET.SubElement(root, "joint", name=body.joint, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=link.name)
    ET.SubElement(joint, "origin", xyz=triple(link.origin), rpy=triple(_angles(link.rotation)))
    ET.SubElement(joint, "axis", xyz=triple(link.axis))
    if link.kind == "prismatic":
        ET.SubElement(joint, "limit", lower=f"-{_FAR}", upper=_FAR, effort=_STRONG, velocity=_STRONG)
    ET.SubElement(joint, "dynamics", damping=number(body.damping), friction=number(body.friction))


def _fill_inertial(element: ET.Element, solid: MassProperties) -> None:
    """Fill an <inertial> with a body's numbers in its link's frame."""
    element.clear()
    ET.SubElement(element, "origin", xyz=triple(solid.centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=number(solid.mass))
    moments = map(number, solid.inertia[np.triu_indices(3)])
    ET.SubElement(element, "inertia", dict(zip(_MOMENTS, moments, strict=True)))


def _angles(rotation: FloatArray) -> FloatArray:
    """Roll, pitch and yaw about fixed axes; one of them is 0 at 90° pitch."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # there, others are the same rotation
        return np.asarray(Rotation.from_matrix(rotation).as_euler("xyz"))


def _replace(text: str, found: Sequence[Body], locked: Mapping[str, float]) -> tuple[ET.Element, list[str]]:
    """Replace bodies and friction in a URDF; return root and losses.

    Args:
        text: of the file.
        found: the robot's bodies.
        locked: positions of the joints that stand still, see `load_robot`.
    """
    _, carried = read_robot(text, "The robot's URDF", locked)
    root = parse_model(text, "The robot's URDF")
    inertials = {link.get("name"): link.find("inertial") for link in root.findall("link")}
    joints, lost = {joint.get("name"): joint for joint in root.findall("joint")}, list[str]()
    for body in found:
        shared = _share_body(body.link.inertial, carried[body.joint])
        for name, inertial in shared.items():
            element = inertials[name]
            assert element is not None  # or nothing would be shared with it
            _fill_inertial(element, mass_properties(inertial))
        if not shared:
            lost.append(f"the body of {body.link.name}, of which the URDF has no <inertial>")
        joint = joints[body.joint]
        dynamics = joint.find("dynamics")
        friction = {"damping": number(body.damping), "friction": number(body.friction)}
        (ET.SubElement(joint, "dynamics") if dynamics is None else dynamics).attrib.update(friction)
    return root, lost


def _share_body(inertial: FloatArray, carried: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, FloatArray]:
    """Distribute a body over its links, as inertial parameters in their frames.

    Args:
        inertial: (10,) of the body, in the frame of the first link.
        carried: by name the pose of a link in that frame, (4, 4), and its parameters, (10,).
    """
    placed = {name: pose @ pseudo_inertia(own) @ pose.T for name, (pose, own) in carried.items()}
    if not placed or not np.any(inertial):
        return {}
    whole, before = pseudo_inertia(inertial), sum(placed.values(), np.zeros((4, 4)))
    change = _factor(whole) @ np.linalg.inv(_factor(before))
    shared = {name: change @ one @ change.T for name, one in placed.items()}
    first = next(iter(shared))
    shared[first] += whole - sum(shared.values(), np.zeros((4, 4)))  # of rods and plates, and rounding
    back = {name: np.linalg.inv(pose) for name, (pose, _) in carried.items()}
    return {name: inertial_of(back[name] @ one @ back[name].T) for name, one in shared.items()}


def _factor(pseudo: FloatArray) -> FloatArray:
    """Return the upper factor U of a pseudo-inertia, (4, 4), ``U U'``."""
    thick = pseudo + _THIN * np.trace(pseudo[:3, :3]) * np.diag([1.0, 1.0, 1.0, 0.0])
    return np.asarray(np.linalg.cholesky(thick[::-1, ::-1])[::-1, ::-1])
