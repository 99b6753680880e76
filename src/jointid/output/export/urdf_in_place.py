"""A URDF of the user's own with other bodies and frictions: its `<inertial>` and `<dynamics>`, and no other byte.

Links that are fixed to each other, as a tool to a wrist, have one body in a robot. It is shared among them as they had
it: with P the pseudo-inertias of the URDF's bodies, in the frame of the first, every one becomes ``T P T'``, where T
takes their sum to the body that was found. So each is a body that can be, near its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from xml.parsers import expat

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.config.robot_model import carried_bodies
from jointid.models.robots.inertial import inertial_of, mass_properties, pseudo_inertia
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.output.export.joint_model import number

_THIN = 1e-9  # of a sum's second moments, so that a rod or a plate has a factor
_TAG = re.compile(rb"<(?:\"[^\"]*\"|'[^']*'|[^\"'>])*>")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def replace_in_urdf(
    raw: bytes, robot: Robot, locked: Mapping[str, float], friction: Callable[[RobotJoint], tuple[float, float]]
) -> tuple[str, list[str]]:
    """Return a URDF with a robot's bodies and friction, and what it lacks.

    Args:
        raw: the bytes of the file.
        robot: with joints of the file.
        locked: positions of the joints that stand still, see `load_robot`.
        friction: viscous and Coulomb friction of a joint.
    """
    text = raw.decode("utf-8")
    carried = carried_bodies(text.removeprefix("\ufeff"), "The robot's URDF", robot.names, locked)
    bodies, lost = dict[str, FloatArray](), list[str]()
    for link, joint in zip(robot.links, robot.joints, strict=True):
        found = share_body(link.inertial, carried[joint.name])
        bodies |= found
        if not found:
            lost.append(f"the body of {link.name}, of which the URDF has no <inertial>")
    inertials = {name: _inertial(body) for name, body in bodies.items()}
    dynamics = {joint.name: _dynamics(*friction(joint)) for joint in robot.joints}
    data, end, parts = text.encode(), 0, list[bytes]()
    for begin, stop, new in sorted(_places(data, inertials, dynamics)):
        parts += [data[end:begin], new.encode()]
        end = stop
    return b"".join([*parts, data[end:]]).decode(), lost


def share_body(inertial: FloatArray, carried: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, FloatArray]:
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
    centre = " ".join(map(number, solid.centre))
    moments = " ".join(
        f'{name}="{number(one)}"' for name, one in zip(_MOMENTS, solid.inertia[np.triu_indices(3)], strict=True)
    )
    return (
        f'<inertial><origin xyz="{centre}" rpy="0 0 0"/><mass value="{number(solid.mass)}"/>'
        f"<inertia {moments}/></inertial>"
    )


def _dynamics(viscous: float, coulomb: float) -> str:
    return f'<dynamics damping="{number(viscous)}" friction="{number(coulomb)}"/>'


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
