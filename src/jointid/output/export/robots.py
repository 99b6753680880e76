"""URDF and MJCF: a joint's masses as bodies in space.

An identification knows inertias about, or masses along, an axis. A body has more, which does not move the joint: a mass
for an inertia, where its centre is, inertias about the other axes. They are filled in so that what is known comes out
exactly. A joint that turns does so about -y, which lifts a body that lies along x; one that slides does so along x,
where weight does nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal
from xml.etree import ElementTree as ET

from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import number as shown
from jointid.models.friction import PreslidingFriction
from jointid.models.joints import FlexibleJoint
from jointid.models.springs import Piece
from jointid.output.export.joint_model import (
    JointModel,
    Mass,
    Weight,
    effects_left_out,
    friction_left_out,
    identifier,
    number,
    one_line,
    remarks,
    ripple_left_out,
    spring_left_out,
)
from jointid.output.export.pd_law import PDLaw

Control = Literal["torque", "pd"]

_AXES = {"revolute": "0 -1 0", "prismatic": "1 0 0"}
_GRAVITY = 9.81  # m/s2, along -z; what a link weighs does not depend on it, see `_body_of`
_GYRATION = 0.1  # m, of a body whose mass nothing tells
_ROUND = 1e-4  # of a mass, in m2: inertias of a body that does not turn

_FAR = 1e3  # m: URDF asks a sliding joint for limits, and an identification knows none
_STRONG = 1e9

_STEPS = 200  # of the simulation in a period of the free-free mode, at least
_LONGEST = 2.5e-4  # s, of a step
_SAMPLE_TIME = 1e-3  # s, where the record's own is not known
_SMALL = 1e-6  # of the motor's inertia, that its body has: MuJoCo moves none without
# As hard as MuJoCo solves it: with its own numbers what holds the joint creeps, and the torque of the twin's closed
# loop errs by 32 % instead of 0.4 % (steps of 0.25 ms).
_HARD = {"solreffriction": "-1 -200000", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


def urdf(model: JointModel) -> tuple[str, tuple[str, ...]]:
    """Return a joint as URDF, the robot description of ROS, and its losses.

    One joint with its `dynamics`: `damping` and `friction` are its viscous and Coulomb friction, the same in both
    directions. There is no spring in it, and no constant force: a flexible joint is written as the rigid one that it is
    far below its resonance, the sums of its two sides.

    Raises:
        MethodError: URDF cannot have these numbers.
    """
    require_mechanical(model, "URDF")
    (mass, constant, lost), weight = rigid_sums(model), model.weight
    if constant:
        lost.append(f"a constant force of {shown(constant)} {model.torque_unit}")
    if weight is not None and weight.rate:
        lost.append("the spring of the counterbalance")
    lost += [
        *friction_left_out(model), *ripple_left_out(model), *_lost_weight(weight), *effects_left_out(model),
    ]  # fmt: skip

    name = identifier(model.name)
    root = ET.Element("robot", name=name)
    ET.SubElement(root, "link", name="base")
    body = _body_of(mass, model.kind, _borne(weight))
    inertial = ET.SubElement(ET.SubElement(root, "link", name="load"), "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(*body.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=number(body.mass))
    zero, inertia = "0.0", number(body.inertia)
    ET.SubElement(inertial, "inertia", ixx=inertia, ixy=zero, ixz=zero, iyy=inertia, iyz=zero, izz=inertia)
    joint = ET.SubElement(root, "joint", name=name, type="continuous" if model.kind == "revolute" else "prismatic")
    ET.SubElement(joint, "parent", link="base")
    ET.SubElement(joint, "child", link="load")
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=_AXES[model.kind])
    how = "The mass and its centre are chosen; inertia about the axis and weight are what was identified."
    if model.kind == "prismatic":
        far = {"lower": number(-_FAR), "upper": number(_FAR)}
        ET.SubElement(joint, "limit", far | {"effort": number(_STRONG), "velocity": number(_STRONG)})
        how = "The limits are wider than any machine: URDF asks for them and nothing here knows them; write your own."
    ET.SubElement(joint, "dynamics", damping=number(mass.viscous), friction=number(mass.coulomb))
    return format_xml(root, [*remarks(model, lost), how]), tuple(lost)


def mjcf(
    model: JointModel, *, timestep: float | None = None, control: Control = "torque"
) -> tuple[str, tuple[str, ...]]:
    """Return a joint as MJCF, MuJoCo's XML, and its losses.

    Motor and load are two bodies beside each other, with the spring as a tendon between their joints. The `stiffness`
    of a MuJoCo joint is a spring between a body and its parent, parallel to the actuator. A joint in series with a
    spring needs two: here both joints stand on the same parent, so that each side keeps the friction of its own
    velocity, and a fixed tendon of the length q12 - q1 is spring and damper.

    Args:
        model: the joint.
        timestep: of the simulation in s; without it a whole part of the record's sample time, at most 0.25 ms and a
            200th of the free-free mode's period.
        control: "torque": an actuator takes the motor's torque; "pd": actuators take position, velocity and torque of
            the law ``kp (q_des - q) + kd (dq_des - dq) + tau_ff``, which needs a controller that is such a law.

    Raises:
        MethodError: the time step is not positive, there is no such law, or MuJoCo cannot have these numbers.
    """
    require_timestep(timestep)
    step = timestep or _step(model)
    require_mechanical(model, "MJCF")
    lost = [
        *friction_left_out(model), *spring_left_out(model), *ripple_left_out(model), *_lost_weight(model.weight),
        *effects_left_out(model),
    ]  # fmt: skip
    sticks = not isinstance(model.joint.friction, PreslidingFriction)
    if sticks and any(mass.coulomb for mass in model.masses.values()):
        lost.append("true sticking: MuJoCo's friction creeps where it should hold")

    root = ET.Element("mujoco", model=identifier(model.name))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = f"0 0 {number(-_GRAVITY)}"
    ET.SubElement(root, "option", timestep=number(step), integrator="implicitfast", gravity=gravity)
    world = ET.SubElement(root, "worldbody")
    motor, load, weight = model.motor, model.load, _borne(model.weight)
    if load is None:
        world.append(_body("motor", model.kind, motor, _body_of(motor, model.kind, weight)))
    else:
        small = Mass(_SMALL * motor.inertia, motor.directions)
        rotor = (1 - _SMALL) * motor.inertia
        world.append(_body("motor", model.kind, motor, _body_of(small, model.kind), rotor))
        world.append(_body("load", model.kind, load, _body_of(load, model.kind, weight)))
        pieces = model.pieces or (Piece(0.0, 0.0, model.stiffness, model.damping),)
        unit = f"{model.torque_unit}/{model.position_unit}"
        add_spring(ET.SubElement(root, "tendon"), "spring", "motor", "load", pieces, model.damping, unit)
        if any(p.damping != model.damping and after.deflection > p.deflection for p, after in pairwise(model.pieces)):
            lost.append("a gap in which nothing damps: the damper of a MuJoCo tendon acts there, too")
    drive = ET.SubElement(root, "actuator")
    moved = next(one for one in world.iter("joint") if one.get("name") == "motor")
    constant = model.friction_shift + (weight.constant if weight is not None and load is None else 0.0)
    lost += add_servo(
        drive, moved, "", model.law, control, step, gear=model.gear, delay=model.delay, constant=constant
    )  # fmt: skip
    _add_constants(drive, model)
    sensors = ET.SubElement(root, "sensor")
    for name in model.masses:
        ET.SubElement(sensors, "jointpos", name=f"{name}_position", joint=name)
        ET.SubElement(sensors, "jointvel", name=f"{name}_velocity", joint=name)
    return format_xml(root, [*remarks(model, lost), *_how_to_drive(model, control)]), tuple(lost)


def require_timestep(timestep: float | None) -> None:
    """Raise a `MethodError` if a time step is not positive, or too long."""
    if timestep is not None and not 0 < timestep < 1:
        raise MethodError(f"A time step is a positive number of seconds below 1; received {timestep}.")


def add_spring(
    tendons: ET.Element, name: str, motor: str, load: str, pieces: Sequence[Piece], damping: float, unit: str
) -> None:
    """Add the spring between two joints as tendons beside each other.

    A tendon does not pull within its `springlength`: one that begins with each piece of a spring, as stiff as the piece
    is more than the one before, makes all of them.
    """
    before = 0.0
    for i, piece in enumerate(pieces, 1):
        more, slack = piece.stiffness - before, piece.deflection
        if more < 0:
            raise MethodError(
                f"MJCF has no spring that becomes softer, and the stiffness falls from {shown(before)} to "
                f"{shown(piece.stiffness)} {unit}; simulate it by jointid simulate."
            )
        before = piece.stiffness
        length = _numbers(-slack, slack) if slack else "0"
        if not more and i > 1:
            continue
        springs = {"name": name if i == 1 else f"{name}_{i}", "stiffness": number(more)}
        springs |= {"damping": number(damping if i == 1 else 0.0), "springlength": length}
        tendon = ET.SubElement(tendons, "fixed", springs)
        ET.SubElement(tendon, "joint", joint=load, coef="1")
        ET.SubElement(tendon, "joint", joint=motor, coef="-1")


def add_servo(
    drive: ET.Element,
    moved: ET.Element,
    prefix: str,
    law: PDLaw | None,
    control: str,
    step: float,
    *,
    gear: float = 1.0,
    delay: float = 0.0,
    constant: float = 0.0,
) -> list[str]:
    """Add the actuators of a joint of MuJoCo, and return a sentence for each loss.

    Args:
        drive: the element of all actuators.
        moved: the joint of the motor.
        prefix: of the actuators' names.
        law: of the controller; None where none is known.
        control: "torque" or "pd".
        step: of the simulation, s, of which a delay is a number.
        gear: from the motor's own torque to the joint.
        delay: s, from a torque to its effect.
        constant: force of other actuators on the joint, which the limit does not count.

    Raises:
        MethodError: there is no such control, or no law for it.
    """
    if control not in ("torque", "pd"):
        raise MethodError(f'The control of MJCF is "torque" or "pd"; received "{control}".')
    if control == "pd" and law is None:
        raise MethodError(
            'The control "pd" takes a law of position and velocity, and none is declared; add a controller with the '
            'law "pd", "pid" or "cascade", or use the control "torque".'
        )
    joint = {"joint": str(moved.get("name"))}
    late = 0.0 if law is None else law.command_delay
    seconds = delay if control == "torque" else late
    steps, lost = round(seconds / step), list[str]()
    if abs(steps * step - seconds) > 1e-9:
        lost.append(f"a part of the delay of {1e3 * seconds:.4g} ms: {steps} steps of {1e3 * step:.4g} ms are written")
    # A sample that is due exactly now may be missed by rounding.
    held = {"delay": number((steps - 1e-3) * step), "nsample": str(steps + 1)} if steps else {}
    limit = math.inf if law is None else law.limit
    if control == "torque" or law is None:
        bounds = {} if limit == math.inf else {"forcerange": _numbers(-limit / abs(gear), limit / abs(gear))}
        ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint, "gear": number(gear), **bounds, **held})
        return lost
    kp, kd = law.stiffness, law.damping
    affine = {**joint, "gaintype": "fixed", "biastype": "affine", **held}
    for name, gain, bias in (("position", kp, (0.0, -kp, 0.0)), ("velocity", kd * law.share, (0.0, 0.0, -kd))):
        gains = {"gainprm": number(gain), "biasprm": _numbers(*bias)}
        ET.SubElement(drive, "general", {"name": f"{prefix}{name}", **affine, **gains})
    ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint})
    if limit < math.inf:
        moved.set("actuatorfrcrange", _numbers(-limit - constant, limit - constant))
    if law.delay:
        lost.append(f"the delay of {1e3 * law.delay:.4g} ms from position to torque: commands alone are late")
    return [*lost, *law.lost]


def _step(model: JointModel) -> float:
    sample_time, longest = model.sample_time or _SAMPLE_TIME, _LONGEST
    if model.stiffest > 0:
        stiffest = FlexibleJoint.frequencies(model.values | {"stiffness": model.stiffest})
        longest = min(longest, 1 / (_STEPS * stiffest["free_free"]))
    return sample_time / math.ceil(sample_time / longest)


def _body(name: str, kind: str, mass: Mass, body: _Body, armature: float = 0.0) -> ET.Element:
    """Return a body of MuJoCo on the world with its one joint."""
    element = ET.Element("body", name=name)
    inertia = {"mass": number(body.mass), "diaginertia": _numbers(*[body.inertia] * 3)}
    ET.SubElement(element, "inertial", {"pos": _numbers(*body.centre), **inertia})
    moves = {"name": name, "type": "hinge" if kind == "revolute" else "slide", "axis": _AXES[kind]}
    if armature:
        moves["armature"] = number(armature)
    moves |= {"damping": number(mass.viscous), "frictionloss": number(mass.coulomb)}
    ET.SubElement(element, "joint", moves | (_HARD if mass.coulomb else {}))
    return element


def _add_constants(element: ET.Element, model: JointModel) -> None:
    """Add the constant forces."""
    weight, load = model.weight, model.load
    forces = {"motor": (model.friction_shift, 0.0)} | ({} if load is None else {"load": (load.shift, 0.0)})
    if weight is not None:
        carried = "motor" if load is None else "load"
        forces[carried] = (forces[carried][0] + weight.constant, weight.rate)
    for joint, (constant, rate) in forces.items():
        if constant or rate:
            bias = {"biastype": "affine", "biasprm": _numbers(-constant, -rate) + " 0"}
            affine = {"gaintype": "fixed", "gainprm": "0", **bias}
            ET.SubElement(element, "general", {"name": f"constant_{joint}", "joint": joint, **affine})


def _how_to_drive(model: JointModel, control: Control) -> list[str]:
    """Return the remarks on how to drive a model of MuJoCo and to build it in."""
    transmission = model.joint.transmission
    unit = model.torque_unit if transmission is None else TORQUE_UNIT[transmission.motor]
    lines = [f"The control of the actuator torque is the motor's own torque in {unit}; the others want no control."]
    if control == "pd":
        of_law = (model.position_unit, f"{model.position_unit}/s", model.torque_unit)
        lines = [
            f"Controls: position in {of_law[0]}, velocity in {of_law[1]}, both of the commands, and torque in "
            f"{of_law[2]} beside the law; all are of this side."
        ]
    if model.flexible:
        lines.append(
            "In a robot, motor and load are both children of the link before; the load is the link, and the motor is "
            f"beside it. Free-free mode {shown(model.mode)} Hz."
        )
    if model.kind == "revolute":
        lines.append("Masses and centres are chosen; inertia about the axis and weight are what was identified.")
    return lines


@dataclass(frozen=True, slots=True)
class _Body:
    """A body: mass in kg, its centre (x, y, z) in m, one inertia about every axis through it in kg m2."""

    mass: float
    centre: tuple[float, float, float]
    inertia: float


def _body_of(mass: Mass, kind: str, weight: Weight | None = None) -> _Body:
    """Return a body with the inertia of a mass and the weight of its link.

    A link that turns has ``gMX = m g X`` and ``gMY = -m g Z`` for its centre (X, 0, Z) at the zero of the position.
    Only these products are known; the mass m is chosen so that the centre's own share of the inertia is at most half.
    """
    if kind == "prismatic":
        return _Body(mass.inertia, (0.0, 0.0, 0.0), _ROUND * mass.inertia)
    x, z = (
        (0.0, 0.0)
        if weight is None
        else (weight.cos / _GRAVITY, -math.copysign(1.0, weight.angle) * weight.sin / _GRAVITY)
    )
    moment = x * x + z * z
    total = max(mass.inertia / _GYRATION**2, 2.0 * moment / mass.inertia)
    return _Body(total, (x / total, 0.0, z / total), mass.inertia - moment / total)


def rigid_sums(model: JointModel) -> tuple[Mass, float, list[str]]:
    """Return a joint as one mass without a spring, the constant force on it, and a sentence on the spring it lost."""
    motor, load, weight = model.motor, model.load, model.weight
    constant = model.friction_shift + (0.0 if weight is None else weight.constant)
    if load is None:
        return motor, constant, []
    forwards, backwards, coulomb, coulomb_back = (
        one + other for one, other in zip(motor.directions, load.directions, strict=True)
    )
    assert model.spring is not None
    spring = model.spring.describe({p.name: f"{shown(p.value)} {p.unit}" for p in model.parameters})
    lost = (
        f"the spring of {spring} and its damping; inertia and friction are the sums of both sides, "
        f"which hold below about a fifth of {shown(model.mode)} Hz"
    )
    mass = Mass(motor.inertia + load.inertia, (forwards, backwards, coulomb, coulomb_back))
    return mass, constant + load.shift, [lost]


def require_mechanical(model: JointModel, language: str) -> None:
    """Raise a `MethodError` if a language of bodies and joints cannot hold these numbers."""
    if model.torque_unit not in TORQUE_UNIT.values():
        raise MethodError(
            f"{language} is in N and N m, and the torque of this joint is in {model.torque_unit}; give the channel of "
            "the torque its gain (N or N m per ampere or volt) in the joint file, and identify again."
        )
    sizes = {"damping": model.damping}
    sizes |= {f"the viscous friction of the {name}": mass.viscous for name, mass in model.masses.items()}
    negative = [f"{name} is {value:g}" for name, value in sizes.items() if value < 0]
    if negative:
        raise MethodError(f"{language} has no negative friction, and {' and '.join(negative)}; identify again.")


def _lost_weight(weight: Weight | None) -> tuple[str, ...]:
    """Return the sentence on a weight that no body has because its angle is not the joint's; or none."""
    if weight is None or not weight.turns or abs(weight.angle) == 1.0:
        return ()
    return (
        f"the link's weight: it turns by {weight.angle:g} rad per unit of this position, and a body by 1; export the "
        "load side of a [transmission]",
    )


def _borne(weight: Weight | None) -> Weight | None:
    """Return the weight of a link that turns with the joint; None where a body has no such weight."""
    return None if weight is None or _lost_weight(weight) else weight


def _numbers(*values: float) -> str:
    return " ".join(number(value) for value in values)


def format_xml(root: ET.Element, lines: list[str]) -> str:
    """Return XML text, with lines as comments at the head of its root: no two hyphens in a row, and none at an end."""
    for place, line in enumerate(lines):
        comment = re.sub(r"-(?=-)", "- ", one_line(line)).removesuffix("-").rstrip()
        root.insert(place, ET.Comment(f" {comment} "))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
