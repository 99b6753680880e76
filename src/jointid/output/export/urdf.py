"""URDF, the robot description of ROS: of a joint, of a robot, or the user's own with other bodies and frictions.

A joint has `dynamics`: `damping` and `friction` are its viscous and Coulomb friction, the same in both directions.
There is no spring in URDF, and no constant force: a flexible joint is written as the rigid one that it is far below its
resonance, the sums of its two sides.

A URDF of the user's own keeps every byte but its `<inertial>` and `<dynamics>`. Links that are fixed to each other, as
a tool to a wrist, have one body in a robot. It is shared among them as they had it: with P the pseudo-inertias of the
URDF's bodies, in the frame of the first, every one becomes ``T P T'``, where T takes their sum to the body that was
found. So each is a body that can be, near its own.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.config.robot_model import carried_bodies, read_model
from jointid.models.robots.inertial import inertial_of, mass_properties, pseudo_inertia
from jointid.output.export.bodies import Body, Model, format_xml, robot_bodies, triple
from jointid.output.export.joint_model import identifier, number

_DOWN = np.array([0.0, 0.0, -9.81])  # gravity of URDF, which has no word for it
_FAR, _STRONG = "1000.0", "1000000000.0"  # limits in m and N that URDF asks for and nothing here knows
_LIMITS = "The limits are wider than any machine: URDF asks for them and nothing here knows them; write your own."
_THIN = 1e-9  # of a sum's second moments, so that a rod or a plate has a factor
_TAG = re.compile(rb"<(?:\"[^\"]*\"|'[^']*'|[^\"'>])*>")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_UPPER = np.triu_indices(3)


def urdf(
    source: Model,
    *,
    model: str | os.PathLike[str] | None = None,
    locked: Mapping[str, float] = MappingProxyType({}),
) -> tuple[str, list[str]]:
    """Return a joint or a robot as URDF, which has no laws, and its losses.

    With the URDF that a robot was read from as `model`, it is that file with other `<inertial>` and `<dynamics>`;
    `locked` are its joints that stand still, see `load_robot`.

    Raises:
        MethodError: URDF cannot have these numbers.
    """
    name = "" if source.alone is None else identifier(source.alone.name)
    robot = source.robot(name, rigid=True)
    lost, bodies = source.lost("coulomb", "law of the spring", "weight"), robot_bodies(robot)
    if np.any(robot.of_joints("rotor_inertia")):
        lost.append("the rotors' inertias")
    if model is not None:
        text, more = _replace(read_model(model), robot.names, bodies, locked)
        return text, [*lost, *more]
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
        inertial = ET.SubElement(element, "inertial")
        ET.SubElement(inertial, "origin", xyz=triple(body.solid.centre), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=number(body.solid.mass))
        moments = map(number, body.solid.inertia[_UPPER])
        ET.SubElement(inertial, "inertia", dict(zip(_MOMENTS, moments, strict=True)))
    kind = "continuous" if link.kind == "revolute" else "prismatic"
    joint = ET.SubElement(root, "joint", name=body.joint, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=link.name)
    ET.SubElement(joint, "origin", xyz=triple(link.origin), rpy=triple(_angles(link.rotation)))
    ET.SubElement(joint, "axis", xyz=triple(link.axis))
    if link.kind == "prismatic":
        ET.SubElement(joint, "limit", lower=f"-{_FAR}", upper=_FAR, effort=_STRONG, velocity=_STRONG)
    ET.SubElement(joint, "dynamics", damping=number(body.damping), friction=number(body.friction))


def _angles(rotation: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw about the fixed axes x, y and z; where pitch is 90 deg, the yaw is 0."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-12:
        return np.array([math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])


def _replace(
    raw: bytes, names: Sequence[str], found: Sequence[Body], locked: Mapping[str, float]
) -> tuple[str, list[str]]:
    """Return a URDF with a robot's bodies and friction, and what it lacks.

    Args:
        raw: the bytes of the file.
        names: of the robot's joints.
        found: its bodies.
        locked: positions of the joints that stand still, see `load_robot`.
    """
    text = raw.decode("utf-8")
    carried = carried_bodies(text.removeprefix("\ufeff"), "The robot's URDF", tuple(names), locked)
    bodies, lost = dict[str, FloatArray](), list[str]()
    for body in found:
        shared = _share_body(body.link.inertial, carried[body.joint])
        bodies |= shared
        if not shared:
            lost.append(f"the body of {body.link.name}, of which the URDF has no <inertial>")
    inertials = {name: _inertial(body) for name, body in bodies.items()}
    dynamics = {
        body.joint: f'<dynamics damping="{number(body.damping)}" friction="{number(body.friction)}"/>' for body in found
    }
    data, end, parts = text.encode(), 0, list[bytes]()
    for begin, stop, new in sorted(_places(data, inertials, dynamics)):
        parts += [data[end:begin], new.encode()]
        end = stop
    return b"".join([*parts, data[end:]]).decode(), lost


def _share_body(inertial: FloatArray, carried: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, FloatArray]:
    """Return the ten inertial parameters of each of the links, in its own frame, whose sum is a body.

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


def _inertial(body: FloatArray) -> str:
    solid = mass_properties(body)
    centre = triple(solid.centre)
    moments = " ".join(f'{name}="{number(one)}"' for name, one in zip(_MOMENTS, solid.inertia[_UPPER], strict=True))
    return (
        f'<inertial><origin xyz="{centre}" rpy="0 0 0"/><mass value="{number(solid.mass)}"/>'
        f"<inertia {moments}/></inertial>"
    )


def _places(data: bytes, inertials: Mapping[str, str], dynamics: Mapping[str, str]) -> Iterator[tuple[int, int, str]]:
    """Yield each replacement: its first byte, the byte behind its last, and the new text."""
    parser, offset = expat.ParserCreate("utf-8"), len(data) - len(data.removeprefix(b"\xef\xbb\xbf").lstrip())
    above, spans = list[tuple[str, str, int]](), dict[tuple[str, str, str], list[tuple[int, int]]]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        above.append((tag, attributes.get("name", ""), offset + parser.CurrentByteIndex))

    def end(tag: str) -> None:
        _, _, begin = above.pop()
        last = _TAG.match(data, begin)
        if last is None or not last.group().endswith(b"/>"):
            last = _TAG.match(data, offset + parser.CurrentByteIndex)
        assert last is not None
        if len(above) == 2:
            owner, name, _ = above[-1]
            spans.setdefault((owner, name, tag), []).append((begin, last.end()))

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data[offset:], True)
    for name, text in inertials.items():
        yield (*spans["link", name, "inertial"][0], text)
    for name, text in dynamics.items():
        if there := spans.get(("joint", name, "dynamics")):
            yield (*there[0], text)
            continue
        own = [one for (owner, of, _), each in spans.items() if (owner, of) == ("joint", name) for one in each]
        begin, stop = max(own)
        before = data[:begin]
        yield stop, stop, f"{before[len(before.rstrip()) :].decode()}{text}"
