"""MuJoCo's MJCF: motor and load as two bodies beside each other, with the spring as a tendon between their joints.

The `stiffness` of a MuJoCo joint is a spring between a body and its parent, parallel to the actuator. A joint in series
with a spring needs two: here both joints stand on the same parent, so that each side keeps the friction of its own
velocity, and a fixed tendon of the length q12 - q1 is spring and damper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar
from xml.etree import ElementTree as ET

from jointid.common.errors import MethodError
from jointid.common.text import number as shown
from jointid.common.transmission import Side
from jointid.models.joints import frequencies
from jointid.models.parameters import TORQUE_UNIT
from jointid.output.export.bodies import (
    AXES,
    GRAVITY,
    Body,
    body_of,
    borne,
    document,
    inertial,
    lost_weight,
    require_mechanical,
)
from jointid.output.export.joint_model import JointModel, Mass
from jointid.output.export.naming import identifier, number
from jointid.output.export.provenance import effects_left_out, friction_shift, remarks, uneven_viscous

_STEPS = 200  # of the simulation in a period of the free-free mode, at least
_LONGEST = 2.5e-4  # s, of a step
_SAMPLE_TIME = 1e-3  # s, where the record's own is not known
_SMALL = 1e-6  # of the motor's inertia, that its body has: MuJoCo moves none without
# As hard as MuJoCo solves it: with its own numbers what holds the joint creeps, and the torque of the twin's closed
# loop errs by 32 % instead of 0.4 % (steps of 0.25 ms).
_HARD = {"solreffriction": "-1 -200000", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


@dataclass(frozen=True, slots=True)
class Mjcf:
    """MJCF, MuJoCo's own XML.

    Attributes:
        timestep: of the simulation in s; without it a whole part of the record's sample time, at most 0.25 ms and a
            200th of the free-free mode's period.

    Raises:
        MethodError: the time step is not positive.
    """

    timestep: float | None = None

    name: ClassVar[str] = "mjcf"
    described: ClassVar[str] = "MuJoCo: two bodies, a spring between, friction of each"
    suffixes: ClassVar[tuple[str, ...]] = (".xml", ".mjcf")
    side: ClassVar[Side | None] = "load"

    def __post_init__(self) -> None:
        if self.timestep is not None and not 0 < self.timestep < 1:
            raise MethodError(f"A time step is a positive number of seconds below 1; received {self.timestep}.")

    def lost(self, model: JointModel) -> tuple[str, ...]:
        """Return a sentence for each part of the joint that the text does not have."""
        lost = [*uneven_viscous(model), *lost_weight(model.weight), *effects_left_out(model)]
        if any(mass is not None and mass.coulomb for mass in (model.motor, model.load)):
            lost.append("true sticking: MuJoCo's friction creeps where it should hold")
        return tuple(lost)

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            MethodError: MuJoCo cannot have these numbers.
        """
        require_mechanical(model, "MJCF")
        root = ET.Element("mujoco", model=identifier(model.name))
        ET.SubElement(root, "compiler", angle="radian", autolimits="true")
        gravity = f"0 0 {number(-GRAVITY)}"
        ET.SubElement(
            root, "option", timestep=number(self._step(model)), integrator="implicitfast", gravity=gravity
        )  # fmt: skip
        world = ET.SubElement(root, "worldbody")
        motor, load, weight = model.motor, model.load, borne(model.weight)
        if load is None:
            world.append(_body("motor", model.kind, motor, body_of(motor, model.kind, weight)))
        else:
            small = Mass(_SMALL * motor.inertia, motor.directions)
            rotor = (1 - _SMALL) * motor.inertia
            world.append(_body("motor", model.kind, motor, body_of(small, model.kind), rotor))
            world.append(_body("load", model.kind, load, body_of(load, model.kind, weight)))
            root.append(_spring(model))
        root.append(_actuators(model))
        sensors = ET.SubElement(root, "sensor")
        for name in ("motor", "load")[: 1 if load is None else 2]:
            ET.SubElement(sensors, "jointpos", name=f"{name}_position", joint=name)
            ET.SubElement(sensors, "jointvel", name=f"{name}_velocity", joint=name)
        return document(root, [*remarks(model, self.lost(model)), *_how(model)])

    def _step(self, model: JointModel) -> float:
        if self.timestep is not None:
            return self.timestep
        sample_time, longest = model.sample_time or _SAMPLE_TIME, _LONGEST
        if model.stiffness > 0:
            longest = min(longest, 1 / (_STEPS * frequencies(model.values)["free_free"]))
        return sample_time / math.ceil(sample_time / longest)


def _body(name: str, kind: str, mass: Mass, body: Body, armature: float = 0.0) -> ET.Element:
    """Return a body on the world with its one joint."""
    element = ET.Element("body", name=name)
    element.append(inertial(body, urdf=False))
    moves = {"name": name, "type": "hinge" if kind == "revolute" else "slide", "axis": AXES[kind]}
    if armature:
        moves["armature"] = number(armature)
    moves |= {"damping": number(mass.viscous), "frictionloss": number(mass.coulomb)}
    ET.SubElement(element, "joint", moves | (_HARD if mass.coulomb else {}))
    return element


def _spring(model: JointModel) -> ET.Element:
    element = ET.Element("tendon")
    between = {"stiffness": number(model.stiffness), "damping": number(model.damping), "springlength": "0"}
    spring = ET.SubElement(element, "fixed", {"name": "spring", **between})
    ET.SubElement(spring, "joint", joint="load", coef="1")
    ET.SubElement(spring, "joint", joint="motor", coef="-1")
    return element


def _actuators(model: JointModel) -> ET.Element:
    """Return the motor, whose control is the torque, and what pushes without being asked."""
    element, weight, load = ET.Element("actuator"), model.weight, model.load
    ET.SubElement(element, "motor", name="torque", joint="motor", gear=number(model.gear))
    forces = {"motor": (friction_shift(model), 0.0)} | ({} if load is None else {"load": (load.shift, 0.0)})
    if weight is not None:
        carried = "motor" if load is None else "load"
        forces[carried] = (forces[carried][0] + weight.constant, weight.rate)
    for joint, (constant, rate) in forces.items():
        if constant or rate:
            bias = f"{number(-constant)} {number(-rate)} 0"
            affine = {"gaintype": "fixed", "gainprm": "0", "biastype": "affine", "biasprm": bias}
            ET.SubElement(element, "general", {"name": f"constant_{joint}", "joint": joint, **affine})
    return element


def _how(model: JointModel) -> list[str]:
    """Return the remarks on how to drive the model and to build it in."""
    transmission = model.joint.transmission
    unit = model.torque_unit if transmission is None else TORQUE_UNIT[transmission.motor]
    lines = [f"The control of the actuator torque is the motor's own torque in {unit}; the others want no control."]
    if model.flexible:
        lines.append(
            "In a robot, motor and load are both children of the link before; the load is the link, and the motor is "
            f"beside it. Free-free mode {shown(frequencies(model.values)['free_free'])} Hz."
        )
    if model.kind == "revolute":
        lines.append("Masses and centres are chosen; inertia about the axis and weight are what was identified.")
    return lines
