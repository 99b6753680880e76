"""A joint's masses as bodies in space, as URDF and MJCF have them.

An identification knows inertias about, or masses along, an axis. A body has more, which does not move the joint: a mass
for an inertia, where its centre is, inertias about the other axes. They are filled in so that what is known comes out
exactly. A joint that turns does so about -y, which lifts a body that lies along x; one that slides does so along x,
where weight does nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from jointid.common.errors import MethodError
from jointid.models.parameters import TORQUE_UNIT
from jointid.output.export.joint_model import JointModel, Mass, Weight
from jointid.output.export.naming import number, xml_comment

AXES = {"revolute": "0 -1 0", "prismatic": "1 0 0"}
GRAVITY = 9.81  # m/s2, along -z; what a link weighs does not depend on it, see `body_of`
_GYRATION = 0.1  # m, of a body whose mass nothing tells
_ROUND = 1e-4  # of a mass, in m2: inertias of a body that does not turn


@dataclass(frozen=True, slots=True)
class Body:
    """A body: mass in kg, its centre (x, y, z) in m, one inertia about every axis through it in kg m2."""

    mass: float
    centre: tuple[float, float, float]
    inertia: float


def body_of(mass: Mass, kind: str, weight: Weight | None = None) -> Body:
    """Return a body that moves like a mass, and weighs what its link does.

    A link that turns has ``gMX = m g X`` and ``gMY = -m g Z`` for its centre (X, 0, Z) at the zero of the position.
    Only these products are known; the mass m is chosen so that the centre's own share of the inertia is at most half.
    """
    if kind == "prismatic":
        return Body(mass.inertia, (0.0, 0.0, 0.0), _ROUND * mass.inertia)
    x, z = (
        (0.0, 0.0)
        if weight is None
        else (weight.cos / GRAVITY, -math.copysign(1.0, weight.angle) * weight.sin / GRAVITY)
    )
    moment = x * x + z * z
    total = max(mass.inertia / _GYRATION**2, 2.0 * moment / mass.inertia)
    return Body(total, (x / total, 0.0, z / total), mass.inertia - moment / total)


def require_mechanical(model: JointModel, language: str) -> None:
    """Raise a `MethodError` if a language of bodies and joints cannot hold these numbers."""
    if model.torque_unit not in TORQUE_UNIT.values():
        raise MethodError(
            f"{language} is in N and N m, and the torque of this joint is in {model.torque_unit}; give the channel of "
            "the torque its gain (N or N m per ampere or volt) in the joint file, and identify again."
        )
    sizes = {"damping": model.damping}
    for name, mass in (("motor", model.motor), ("load", model.load)):
        if mass is not None:
            sizes |= {f"the viscous friction of the {name}": mass.viscous}
    negative = [f"{name} is {value:g}" for name, value in sizes.items() if value < 0]
    if negative:
        raise MethodError(f"{language} has no negative friction, and {' and '.join(negative)}; identify again.")


def lost_weight(weight: Weight | None) -> tuple[str, ...]:
    """Return the sentence on a weight that no body has because its angle is not the joint's; or none."""
    if weight is None or not weight.turns or abs(weight.angle) == 1.0:
        return ()
    return (
        f"the link's weight: it turns by {weight.angle:g} rad per unit of this position, and a body by 1; export the "
        "load side of a [transmission]",
    )


def borne(weight: Weight | None) -> Weight | None:
    """Return the weight of a link that turns with the joint; None where a body has no such weight."""
    return None if weight is None or lost_weight(weight) else weight


def inertial(body: Body, *, urdf: bool) -> ET.Element:
    """Return the element `inertial` of one of the two languages."""
    element = ET.Element("inertial")
    centre = " ".join(number(value) for value in body.centre)
    if urdf:
        ET.SubElement(element, "origin", xyz=centre, rpy="0 0 0")
        ET.SubElement(element, "mass", value=number(body.mass))
        zero, inertia = "0.0", number(body.inertia)
        ET.SubElement(element, "inertia", ixx=inertia, ixy=zero, ixz=zero, iyy=inertia, iyz=zero, izz=inertia)
    else:
        attributes = {"pos": centre, "mass": number(body.mass), "diaginertia": " ".join([number(body.inertia)] * 3)}
        element.attrib.update(attributes)
    return element


def document(root: ET.Element, remarks: list[str]) -> str:
    """Return XML text, with the remarks as comments at the head of its root."""
    for place, line in enumerate(remarks):
        root.insert(place, ET.Comment(f" {xml_comment(line)} "))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
