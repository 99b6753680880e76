"""MJCF, MuJoCo's XML: bodies of a joint or a robot with springs in series, friction, and the laws of controllers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import number as shown
from jointid.models.friction import PreslidingFriction
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Robot
from jointid.models.springs import Piece
from jointid.output.export.bodies import (
    GRAVITY,
    Body,
    format_xml,
    friction_of_sides,
    joint_body,
    losses_of_drives,
    require_mechanical,
    require_timestep,
    robot_bodies,
    triple,
)
from jointid.output.export.joint_model import JointModel, identifier, number, remarks
from jointid.output.export.pd_law import PDLaw

Control = Literal["torque", "pd"]

_STEPS = 200  # of the simulation in a period of the free-free mode, at least
_LONGEST = 2.5e-4  # s, of a step
_MUJOCO_STEP = 2e-3  # s, where none is written
_SMALL = 1e-6  # of the motor's inertia, that its body has: MuJoCo moves none without
_NOTHING = MassProperties(1e-9, np.zeros(3), 1e-11 * np.eye(3))  # likewise of a rotor beside a robot's link
# As hard as MuJoCo solves it: with its own numbers what holds the joint creeps, and the torque of the twin's closed
# loop errs by 32 % instead of 0.4 % (steps of 0.25 ms).
_HARD = {"solreffriction": "-1 -200000", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
_SOFT: Mapping[str, str] = MappingProxyType({})


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
    lost = model.lost("friction", "spring", "weight")
    sticks = not isinstance(model.joint.friction, PreslidingFriction)
    if sticks and any(mass.coulomb for mass in model.masses.values()):
        lost.append("true sticking: MuJoCo's friction creeps where it should hold")

    root = ET.Element("mujoco", model=identifier(model.name))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = _row(0.0, 0.0, -GRAVITY)
    ET.SubElement(root, "option", timestep=number(step), integrator="implicitfast", gravity=gravity)
    world = ET.SubElement(root, "worldbody")
    motor, load, weight, kind = model.motor, model.load, model.weight, model.kind
    if load is None:
        bodies = [joint_body("motor", kind, motor, weight)]
    else:
        small = joint_body("motor", kind, replace(motor, inertia=_SMALL * motor.inertia))
        rotor = replace(small, armature=(1 - _SMALL) * motor.inertia)
        bodies = [rotor, joint_body("load", kind, load, weight)]
    moved, *_ = [_add_body(world, body, _HARD if body.friction else _SOFT)[1] for body in bodies]
    if load is not None:
        pieces = model.pieces or (Piece(0.0, 0.0, model.stiffness, model.damping),)
        unit = f"{model.torque_unit}/{model.position_unit}"
        _add_spring(ET.SubElement(root, "tendon"), "spring", "motor", "load", pieces, model.damping, unit)
        if any(p.damping != model.damping and after.deflection > p.deflection for p, after in pairwise(model.pieces)):
            lost.append("a gap in which nothing damps: the damper of a MuJoCo tendon acts there, too")
    drive = ET.SubElement(root, "actuator")
    constant = model.friction_shift + (weight.constant if weight is not None and load is None else 0.0)
    lost += _add_servo(
        drive, moved, "", model.law, control, step, gear=model.gear, delay=model.delay, constant=constant
    )  # fmt: skip
    _add_constants(drive, model)
    sensors = ET.SubElement(root, "sensor")
    for name in model.masses:
        ET.SubElement(sensors, "jointpos", name=f"{name}_position", joint=name)
        ET.SubElement(sensors, "jointvel", name=f"{name}_velocity", joint=name)
    return format_xml(root, [*remarks(model, lost), *_how_to_drive(model, control)]), tuple(lost)


def robot_mjcf(
    robot: Robot,
    laws: Sequence[PDLaw | None] = (),
    *,
    timestep: float | None = None,
    control: Control = "torque",
) -> tuple[str, tuple[str, ...]]:
    """Return a robot as MJCF, and its losses; without a time step, in s, it is MuJoCo's own.

    The motor of a joint with a spring is a body beside the link, on the same parent, and the spring a tendon between
    their joints, as of a joint alone (`mjcf`).
    """
    require_timestep(timestep)
    lost = losses_of_drives(robot, springs=True)
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian")
    steps = {} if timestep is None else {"timestep": number(timestep)}
    steps |= {"integrator": "implicitfast"} if any(robot.flexible) else {}
    ET.SubElement(root, "option", steps | {"gravity": triple(robot.gravity)})
    placed = {-1: ET.SubElement(root, "worldbody")}
    tendons, drive = ET.Element("tendon"), ET.Element("actuator")
    taken = {one for link, joint in zip(robot.links, robot.joints, strict=True) for one in (link.name, joint.name)}
    for i, (body, joint) in enumerate(zip(robot_bodies(robot, springs=True), robot.joints, strict=True)):
        parent, spring = placed[body.link.parent], joint.spring
        placed[i], moved = _add_body(parent, body)
        if spring is not None:
            name = f"{joint.name}_motor"
            while name in taken:
                name += "_"
            taken.add(name)
            (viscous, coulomb), _ = friction_of_sides(joint).tolist()
            rotor = Body(replace(body.link, name=name), name, _NOTHING, viscous, coulomb, joint.rotor_inertia)
            _, moved = _add_body(parent, rotor)
            whole = spring.law.linear or spring.law.stepped
            pieces = [Piece(0.0, 0.0, spring.stiffness, 0.0)] if whole else spring.law.pieces(joint.values)
            unit = "N m/rad" if body.link.kind == "revolute" else "N/m"
            _add_spring(tendons, f"{joint.name}_spring", name, joint.name, pieces, spring.damping, unit)
        if laws or control != "torque":
            step, law = timestep or _MUJOCO_STEP, laws[i] if laws else None
            lost += _add_servo(drive, moved, f"{joint.name}_", law, control, step)
    root.extend(element for element in (tendons, drive) if len(element))
    lost = [*dict.fromkeys(lost)]
    lines = [f"{robot.name}: written by jointid", *(f"left out: {one}" for one in lost)]
    return format_xml(root, lines), tuple(lost)


def _add_body(parent: ET.Element, body: Body, friction: Mapping[str, str] = _SOFT) -> tuple[ET.Element, ET.Element]:
    """Add a body with its one joint, and return both; `friction` says how hard the joint is held."""
    link, solid = body.link, body.solid
    place = {"pos": triple(link.origin), "xyaxes": triple(link.rotation[:, :2].T)}
    element = ET.SubElement(parent, "body", {"name": link.name, **place})
    if solid is not None:
        moments = {"fullinertia": triple(solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}
        ET.SubElement(element, "inertial", {"pos": triple(solid.centre), "mass": number(solid.mass)} | moments)
    moves = {"type": "hinge" if link.kind == "revolute" else "slide", "axis": triple(link.axis)}
    held = {"armature": number(body.armature), "damping": number(body.damping), "frictionloss": number(body.friction)}
    return element, ET.SubElement(element, "joint", {"name": body.joint, **moves, **held, **friction})


def _add_spring(
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
        length = _row(-slack, slack) if slack else "0"
        if not more and i > 1:
            continue
        springs = {"name": name if i == 1 else f"{name}_{i}", "stiffness": number(more)}
        springs |= {"damping": number(damping if i == 1 else 0.0), "springlength": length}
        tendon = ET.SubElement(tendons, "fixed", springs)
        ET.SubElement(tendon, "joint", joint=load, coef="1")
        ET.SubElement(tendon, "joint", joint=motor, coef="-1")


def _add_servo(
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
        bounds = {} if limit == math.inf else {"forcerange": _row(-limit / abs(gear), limit / abs(gear))}
        ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint, "gear": number(gear), **bounds, **held})
        return lost
    kp, kd = law.stiffness, law.damping
    affine = {**joint, "gaintype": "fixed", "biastype": "affine", **held}
    for name, gain, bias in (("position", kp, (0.0, -kp, 0.0)), ("velocity", kd * law.share, (0.0, 0.0, -kd))):
        gains = {"gainprm": number(gain), "biasprm": _row(*bias)}
        ET.SubElement(drive, "general", {"name": f"{prefix}{name}", **affine, **gains})
    ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint})
    if limit < math.inf:
        moved.set("actuatorfrcrange", _row(-limit - constant, limit - constant))
    if law.delay:
        lost.append(f"the delay of {1e3 * law.delay:.4g} ms from position to torque: commands alone are late")
    return [*lost, *law.lost]


def _step(model: JointModel) -> float:
    sample_time, longest = model.data.sample_time, _LONGEST
    if model.stiffest > 0:
        stiffest = FlexibleJoint.frequencies(model.values | {"stiffness": model.stiffest})
        longest = min(longest, 1 / (_STEPS * stiffest["free_free"]))
    return sample_time / math.ceil(sample_time / longest)


def _add_constants(element: ET.Element, model: JointModel) -> None:
    """Add the constant forces."""
    weight, load = model.weight, model.load
    forces = {"motor": (model.friction_shift, 0.0)} | ({} if load is None else {"load": (load.shift, 0.0)})
    if weight is not None:
        carried = "motor" if load is None else "load"
        forces[carried] = (forces[carried][0] + weight.constant, weight.rate)
    for joint, (constant, rate) in forces.items():
        if constant or rate:
            bias = {"biastype": "affine", "biasprm": _row(-constant, -rate) + " 0"}
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


def _row(*values: float) -> str:
    return triple(np.array(values))
