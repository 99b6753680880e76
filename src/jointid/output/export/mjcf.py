"""MJCF, MuJoCo's XML: bodies, springs in series, friction and control laws.

The motor of a joint with a spring is a body beside the link, with the spring as a tendon between their joints. The
`stiffness` of a MuJoCo joint is a spring between a body and its parent, parallel to the actuator. A joint in series
with a spring needs two: here both stand on the same parent, so that each side keeps the friction of its own velocity,
and a fixed tendon of the length q12 - q1 is spring and damper.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.text import number as shown
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import RobotJoint
from jointid.models.springs import Piece
from jointid.output.export.bodies import (
    Body,
    Model,
    format_xml,
    friction_of_sides,
    require_timestep,
    robot_bodies,
    solid_of,
    triple,
)
from jointid.output.export.joint_model import JointModel, PDLaw, identifier, in_steps, number

Control = Literal["torque", "pd"]

_STEPS = 200  # of the simulation in a period of the free-free mode, at least
_LONGEST = 2.5e-4  # s, of a step
_MUJOCO_STEP = 2e-3  # s, where none is written
_NOTHING = MassProperties(1e-9, np.zeros(3), 1e-11 * np.eye(3))  # of a rotor: MuJoCo moves none without mass
_SMALL = 1e-6  # of the motor's inertia, that its body has in a joint alone: how hard friction holds follows from it
# As hard as MuJoCo solves it: with its own numbers what holds the joint creeps, and the torque of the twin's closed
# loop errs by 32 % instead of 0.4 % (steps of 0.25 ms).
_HARD = {"solreffriction": "-1 -200000", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


def mjcf(model: Model, *, timestep: float | None = None, control: Control = "torque") -> tuple[str, list[str]]:
    """Return a joint or a robot as MJCF, and its losses.

    Args:
        model: the joint or the robot.
        timestep: of the simulation in s; without it MuJoCo's own, of a joint alone a whole part of the record's sample
            time, at most 0.25 ms and a 200th of the free-free mode's period.
        control: "torque": an actuator takes the motor's torque; "pd": actuators take position, velocity and torque of
            the law ``kp (q_des - q) + kd (dq_des - dq) + tau_ff``, which needs a controller that is such a law.

    Raises:
        MethodError: the time step is not positive, there is no such law, or MuJoCo cannot have these numbers.
    """
    require_timestep(timestep)
    if control not in ("torque", "pd"):
        raise MethodError(f'The control of MJCF is "torque" or "pd"; received "{control}".')
    alone = model.alone
    robot = model.robot("load" if alone is not None and alone.flexible else "motor")
    lost = model.lost("spring", "coulomb", "constant", "rate", "weight")
    if alone is not None:
        timestep = timestep or _step(alone, robot.joints[0])
    root = ET.Element("mujoco", model=robot.name if alone is None else identifier(alone.name))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    options = {} if timestep is None else {"timestep": number(timestep)}
    options |= {"integrator": "implicitfast"} if alone is not None or any(robot.flexible) else {}
    ET.SubElement(root, "option", options | {"gravity": triple(robot.gravity)})
    placed = {-1: ET.SubElement(root, "worldbody")}
    tendons, drive, sensors = (ET.Element(tag) for tag in ("tendon", "actuator", "sensor"))
    for i, (body, joint) in enumerate(zip(robot_bodies(robot, springs=True), robot.joints, strict=True)):
        parent, moved = placed[body.link.parent], body
        if joint.spring is not None:
            moved = _motor_of(body, joint, alone)
            _add_spring(tendons, "spring" if alone is not None else f"{joint.name}_spring", moved.joint, joint)
        # MuJoCo numbers positions in the order of the bodies: of a joint alone the motor's is the first.
        order = dict.fromkeys((moved, body) if alone is not None else (body, moved))
        added = {one: _add_body(parent, one, hard=alone is not None and one.friction != 0.0) for one in order}
        placed[i] = added[body]
        if alone is not None or model.laws or control != "torque":
            law = model.laws[i] if model.laws else None
            lost += _add_servo(drive, added[moved], joint.name, law, control, timestep or _MUJOCO_STEP, alone)
    if alone is not None:
        _add_constants(drive, sensors, alone)
        pieces = _pieces(robot.joints[0])
        if any(p.damping != pieces[-1].damping and after.deflection > p.deflection for p, after in pairwise(pieces)):
            lost.append("a gap in which nothing damps: the damper of a MuJoCo tendon acts there, too")
        if any(mass.coulomb for mass in alone.masses.values()):
            lost.append("true sticking: MuJoCo's friction creeps where it should hold")
    root.extend(element for element in (tendons, drive, sensors) if len(element))
    lost = [*dict.fromkeys(lost)]
    lines = model.remarks(lost)
    return format_xml(root, lines if alone is None else [*lines, *_how_to_drive(alone, control)]), lost


def _step(alone: JointModel, joint: RobotJoint) -> float:
    """Return the time step of a joint alone, s."""
    sample_time, longest = alone.estimate.data.sample_time, _LONGEST
    if pieces := _pieces(joint):
        stiffest = alone.values | {"stiffness": max(piece.stiffness for piece in pieces)}
        longest = min(longest, 1 / (_STEPS * FlexibleJoint.frequencies(stiffest)["free_free"]))
    return sample_time / math.ceil(sample_time / longest)


def _pieces(joint: RobotJoint) -> Sequence[Piece]:
    """Pieces of the spring for positive deflection; none of a rigid joint.

    Raises:
        MethodError: a piece has no stiffness and never ends, or ends before it begins.
    """
    spring = joint.spring
    if spring is None:
        return ()
    found = spring.law.in_pieces.pieces(joint.values)
    begins = [piece.deflection for piece in found]
    if not all(map(math.isfinite, begins)) or begins != sorted(begins):
        raise MethodError(
            f"A piece of this {spring.law.name} spring never ends, or ends before it begins: identify again."
        )
    return found


def _motor_of(body: Body, joint: RobotJoint, alone: JointModel | None) -> Body:
    """Motor of a flexible joint, as a body beside its link."""
    name, solid, inertia = f"{joint.name}_motor", _NOTHING, joint.rotor_inertia
    if alone is not None:
        name, solid, inertia = "motor", solid_of(alone.kind, _SMALL * inertia), (1 - _SMALL) * inertia
    viscous, coulomb = friction_of_sides(joint)[0].tolist()
    return Body(replace(body.link, name=name), name, solid, viscous, coulomb, inertia)


def _add_body(parent: ET.Element, body: Body, *, hard: bool) -> ET.Element:
    """Add a body with one joint; `hard` sets MuJoCo's hardest constraints."""
    link, solid = body.link, body.solid
    place = {"pos": triple(link.origin), "xyaxes": triple(link.rotation[:, :2].T)}
    element = ET.SubElement(parent, "body", {"name": link.name, **place})
    if solid is not None:
        moments = {"fullinertia": triple(solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}
        ET.SubElement(element, "inertial", {"pos": triple(solid.centre), "mass": number(solid.mass)} | moments)
    moves = {"type": "hinge" if link.kind == "revolute" else "slide", "axis": triple(link.axis)}
    held = {"armature": number(body.armature), "damping": number(body.damping), "frictionloss": number(body.friction)}
    ET.SubElement(element, "joint", {"name": body.joint, **moves, **held, **(_HARD if hard else {})})
    return element


def _add_spring(tendons: ET.Element, name: str, motor: str, joint: RobotJoint) -> None:
    """Add the spring between motor and link as parallel tendons.

    A tendon does not pull within its `springlength`. Each piece of a spring has a tendon that begins at its deflection
    and adds its increase of stiffness.
    """
    assert joint.spring is not None
    before = 0.0
    for i, piece in enumerate(_pieces(joint), 1):
        more, slack = piece.stiffness - before, piece.deflection
        if more < 0:
            raise MethodError(
                f"MJCF has no spring that becomes softer, and the stiffness falls from {shown(before)} to "
                f"{shown(piece.stiffness)}; simulate it by jointid simulate."
            )
        before = piece.stiffness
        if more or i == 1:
            springs = {"name": name if i == 1 else f"{name}_{i}", "stiffness": number(more)}
            springs["damping"] = number(joint.spring.damping if i == 1 else 0.0)
            springs["springlength"] = triple((-slack, slack)) if slack else "0"
            tendon = ET.SubElement(tendons, "fixed", springs)
            ET.SubElement(tendon, "joint", joint=joint.name, coef="1")
            ET.SubElement(tendon, "joint", joint=motor, coef="-1")


def _add_servo(
    drive: ET.Element,
    body: ET.Element,
    name: str,
    law: PDLaw | None,
    control: Control,
    step: float,
    alone: JointModel | None,
) -> list[str]:
    """Add actuators of a motor's body; return the losses (`step` in s).

    Raises:
        MethodError: there is no law for this control.
    """
    moved = body.find("joint")
    assert moved is not None
    joint = {"joint": moved.attrib["name"]}
    prefix, gear, seconds = f"{name}_", 1.0, 0.0
    if alone is not None:  # its gear and delay, and its constant forces, which the limit does not count
        prefix, gear, seconds = "", alone.gear, alone.estimate.settings.delay
    if control == "pd" and law is None:
        raise MethodError(
            'The control "pd" takes a law of position and velocity; add a controller with the law "pd", "pid" or '
            '"cascade", or use the control "torque".'
        )
    seconds = law.command_delay if control == "pd" and law is not None else seconds
    (steps, lost), limit = in_steps(seconds, step), math.inf if law is None else law.limit
    # A sample that is due exactly now may be missed by rounding.
    held = {"delay": number((steps - 1e-3) * step), "nsample": str(steps + 1)} if steps else {}
    if control == "torque" or law is None:
        bounds = {} if limit == math.inf else {"forcerange": triple((-limit / abs(gear), limit / abs(gear)))}
        ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint, "gear": number(gear), **bounds, **held})
        return lost
    kp, kd = law.stiffness, law.damping
    affine = {**joint, "gaintype": "fixed", "biastype": "affine", **held}
    for controlled, gain, bias in (("position", kp, (0.0, -kp, 0.0)), ("velocity", kd * law.share, (0.0, 0.0, -kd))):
        gains = {"gainprm": number(gain), "biasprm": triple(bias)}
        ET.SubElement(drive, "general", {"name": f"{prefix}{controlled}", **affine, **gains})
    ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint})
    if limit < math.inf:
        constant = 0.0 if alone is None else _constants(alone)["motor"][0]
        moved.set("actuatorfrcrange", triple((-limit - constant, limit - constant)))
    return [*lost, *law.lost]


def _constants(model: JointModel) -> dict[str, tuple[float, float]]:
    """Constant force on each mass, and its increase with position."""
    forces, (constant, _, _, rate) = {name: (mass.force, 0.0) for name, mass in model.masses.items()}, model.weight
    carried = [*forces][-1]
    return forces | {carried: (forces[carried][0] + constant, rate)}


def _add_constants(drive: ET.Element, sensors: ET.Element, model: JointModel) -> None:
    """Add constant forces of a single joint, and sensors of its masses."""
    for joint, (constant, rate) in _constants(model).items():
        if constant or rate:
            affine = {"gaintype": "fixed", "gainprm": "0", "biastype": "affine"}
            bias = {"biasprm": triple((-constant, -rate, 0.0))}
            ET.SubElement(drive, "general", {"name": f"constant_{joint}", "joint": joint, **affine, **bias})
        ET.SubElement(sensors, "jointpos", name=f"{joint}_position", joint=joint)
        ET.SubElement(sensors, "jointvel", name=f"{joint}_velocity", joint=joint)


def _how_to_drive(model: JointModel, control: Control) -> Iterator[str]:
    """Yield remarks on how to drive and include a MuJoCo model."""
    transmission, position = model.joint.transmission, POSITION_UNIT[model.kind]
    if control == "pd":
        yield f"Controls: position in {position}, velocity in {position}/s, and torque in {model.torque_unit} beside."
    else:
        unit = model.torque_unit if transmission is None else TORQUE_UNIT[transmission.motor]
        yield f"The control of the actuator torque is the motor's own torque in {unit}; the others want no control."
    if model.flexible:
        yield "In a robot, motor and load are both children of the link before; the load is the link."
