"""URDF: one joint with its `dynamics`; there is no spring in it, and no constant force.

`damping` and `friction` are one joint's viscous and Coulomb friction, the same in both directions. A flexible joint is
written as the rigid one that it is far below its resonance: the sums of its two sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar
from xml.etree import ElementTree as ET

from jointid.common.text import number as shown
from jointid.common.transmission import Side
from jointid.models.joints import frequencies
from jointid.output.export.bodies import AXES, body_of, borne, document, inertial, lost_weight, require_mechanical
from jointid.output.export.joint_model import JointModel, Mass
from jointid.output.export.naming import identifier, number
from jointid.output.export.provenance import effects_left_out, friction_shift, remarks, uneven_viscous

_FAR = 1e3  # m: URDF asks a sliding joint for limits, and an identification knows none
_STRONG = 1e9


@dataclass(frozen=True, slots=True)
class Urdf:
    """URDF, the robot description of ROS."""

    name: ClassVar[str] = "urdf"
    described: ClassVar[str] = "ROS: one joint with damping and friction, without the spring"
    suffixes: ClassVar[tuple[str, ...]] = (".urdf",)
    side: ClassVar[Side | None] = "load"

    def lost(self, model: JointModel) -> tuple[str, ...]:
        """Return a sentence for each part of the joint that the text does not have."""
        weight, load, lost = model.weight, model.load, []
        if load is not None:
            mode = shown(frequencies(model.values)["free_free"])
            lost.append(
                f"the spring of {shown(model.stiffness)} {model.torque_unit}/{model.position_unit} and its damping; "
                f"inertia and friction are the sums of both sides, which hold below about a fifth of {mode} Hz"
            )
        constant = friction_shift(model) + (0.0 if load is None else load.shift)
        constant += 0.0 if weight is None else weight.constant
        if constant:
            lost.append(f"a constant force of {shown(constant)} {model.torque_unit}")
        if weight is not None and weight.rate:
            lost.append("the spring of the counterbalance")
        return (*lost, *uneven_viscous(model), *lost_weight(weight), *effects_left_out(model))

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            MethodError: URDF cannot have these numbers.
        """
        require_mechanical(model, "URDF")
        mass, name = _whole(model), identifier(model.name)
        root = ET.Element("robot", name=name)
        ET.SubElement(root, "link", name="base")
        link = ET.SubElement(root, "link", name="load")
        link.append(inertial(body_of(mass, model.kind, borne(model.weight)), urdf=True))
        joint = ET.SubElement(root, "joint", name=name, type="continuous" if model.kind == "revolute" else "prismatic")
        ET.SubElement(joint, "parent", link="base")
        ET.SubElement(joint, "child", link="load")
        ET.SubElement(joint, "origin", xyz="0 0 0", rpy="0 0 0")
        ET.SubElement(joint, "axis", xyz=AXES[model.kind])
        if model.kind == "prismatic":
            far = {"lower": number(-_FAR), "upper": number(_FAR)}
            ET.SubElement(joint, "limit", far | {"effort": number(_STRONG), "velocity": number(_STRONG)})
        ET.SubElement(joint, "dynamics", damping=number(mass.viscous), friction=number(mass.coulomb))
        return document(root, [*remarks(model, self.lost(model)), *_how(model)])


def _whole(model: JointModel) -> Mass:
    """Return the sums of both sides, or the one mass of a rigid joint."""
    motor, load = model.motor, model.load
    if load is None:
        return motor
    forwards, backwards, coulomb, coulomb_back = (
        one + other for one, other in zip(motor.directions, load.directions, strict=True)
    )
    return Mass(motor.inertia + load.inertia, (forwards, backwards, coulomb, coulomb_back))


def _how(model: JointModel) -> list[str]:
    if model.kind == "prismatic":
        return [
            "The limits are wider than any machine: URDF asks for them and nothing here knows them; write your own."
        ]
    return ["The mass and its centre are chosen; inertia about the axis and weight are what was identified."]
