"""MJCF, MuJoCo's XML: bodies with springs in series, friction, and the laws of controllers.

The motor of a joint with a spring is a body beside the link, with the spring as a tendon between their joints. The
`stiffness` of a MuJoCo joint is a spring between a body and its parent, parallel to the actuator. A joint in series
with a spring needs two: here both stand on the same parent, so that each side keeps the friction of its own velocity,
and a fixed tendon of the length q12 - q1 is spring and damper.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT
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
from jointid.output.export.joint_model import JointModel, identifier, number
from jointid.output.export.pd_law import PDLaw

Control = Literal["torque", "pd"]

_STEPS = 200  # of the simulation in a period of the free-free mode, at least
_LONGEST = 2.5e-4  # s, of a step
_MUJOCO_STEP = 2e-3  # s, where none is written
_NOTHING = MassProperties(1e-9, np.zeros(3), 1e-11 * np.eye(3))  # of a rotor: MuJoCo moves none without mass
_SMALL = 1e-6  # of the motor's inertia, that its body has in a joint alone: how hard friction holds follows from it
# As hard as MuJoCo solves it: with its own numbers what holds the joint creeps, and the torque of the twin's closed
# loop errs by 32 % instead of 0.4 % (steps of 0.25 ms).
_HARD = {"solreffriction": "-1 -200000", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
_SOFT: Mapping[str, str] = MappingProxyType({})


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
    pieces = [_pieces(joint) for joint in robot.joints]
    if alone is not None:
        timestep = timestep or _step(alone, pieces[0])
    lost = model.lost("spring", "coulomb", "constant", "rate", "weight")
    root = ET.Element("mujoco", model=robot.name if alone is None else identifier(alone.name))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    options = {} if timestep is None else {"timestep": number(timestep)}
    options |= {"integrator": "implicitfast"} if alone is not None or any(robot.flexible) else {}
    ET.SubElement(root, "option", options | {"gravity": triple(robot.gravity)})
    placed = {-1: ET.SubElement(root, "worldbody")}
    tendons, drive, sensors = (ET.Element(tag) for tag in ("tendon", "actuator", "sensor"))
    taken = {one for link, joint in zip(robot.links, robot.joints, strict=True) for one in (link.name, joint.name)}
    for i, (body, joint) in enumerate(zip(robot_bodies(robot, springs=True), robot.joints, strict=True)):
        moved, parent = body, placed[body.link.parent]
        if joint.spring is not None:
            name = "motor" if alone is not None else _free_name(f"{joint.name}_motor", taken)
            (viscous, coulomb), _ = friction_of_sides(joint).tolist()
            solid, inertia = _NOTHING, joint.rotor_inertia
            if alone is not None:
                solid, inertia = solid_of(alone.kind, _SMALL * inertia), (1 - _SMALL) * inertia
            moved = Body(replace(body.link, name=name), name, solid, viscous, coulomb, inertia)
            unit = "N m/rad" if body.link.kind == "revolute" else "N/m"
            spring = "spring" if alone is not None else f"{joint.name}_spring"
            _add_spring(tendons, spring, name, joint.name, pieces[i], joint.spring.damping, unit)
        # MuJoCo numbers positions in the order of the bodies: of a joint alone the motor's is the first.
        for one in dict.fromkeys((moved, body) if alone is not None else (body, moved)):
            element, held = _add_body(parent, one, _HARD if alone is not None and one.friction else _SOFT)
            if one is body:
                placed[i] = element
            if one is moved:
                driven = held
        law = model.laws[i] if model.laws else None
        if alone is not None or model.laws or control != "torque":
            prefix = "" if alone is not None else f"{joint.name}_"
            lost += _add_servo(drive, driven, prefix, law, control, timestep or _MUJOCO_STEP, alone)
    if alone is not None:
        _add_constants(drive, sensors, alone)
        lost += _losses_of_mujoco(alone, pieces[0])
    root.extend(element for element in (tendons, drive, sensors) if len(element))
    lost = [*dict.fromkeys(lost)]
    lines = model.remarks(lost)
    return format_xml(root, lines if alone is None else [*lines, *_how_to_drive(alone, control)]), lost


def _free_name(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _pieces(joint: RobotJoint) -> Sequence[Piece]:
    """Return one side of the spring in pieces; none of a rigid joint.

    Raises:
        MethodError: a piece has no stiffness and never ends, or ends before it begins.
    """
    spring = joint.spring
    if spring is None:
        return ()
    if spring.law.linear or spring.law.stepped:
        return (Piece(0.0, 0.0, spring.stiffness, spring.damping),)
    found = spring.law.pieces(joint.values)
    begins = [piece.deflection for piece in found]
    if not all(map(math.isfinite, begins)) or begins != sorted(begins):
        raise MethodError(
            f"The pieces of this {spring.law.name} spring begin at {', '.join(map(shown, begins))}; expected pieces "
            "that follow each other: identify again."
        )
    return found


def _losses_of_mujoco(model: JointModel, pieces: Sequence[Piece]) -> Iterator[str]:
    damped = pieces and pieces[-1].damping
    if any(p.damping != damped and after.deflection > p.deflection for p, after in pairwise(pieces)):
        yield "a gap in which nothing damps: the damper of a MuJoCo tendon acts there, too"
    if any(mass.coulomb for mass in model.masses.values()):
        yield "true sticking: MuJoCo's friction creeps where it should hold"


def _add_body(parent: ET.Element, body: Body, friction: Mapping[str, str]) -> tuple[ET.Element, ET.Element]:
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
        if not more and i > 1:
            continue
        springs = {"name": name if i == 1 else f"{name}_{i}", "stiffness": number(more)}
        length = triple((-slack, slack)) if slack else "0"
        springs |= {"damping": number(damping if i == 1 else 0.0), "springlength": length}
        tendon = ET.SubElement(tendons, "fixed", springs)
        ET.SubElement(tendon, "joint", joint=load, coef="1")
        ET.SubElement(tendon, "joint", joint=motor, coef="-1")


def _add_servo(
    drive: ET.Element,
    moved: ET.Element,
    prefix: str,
    law: PDLaw | None,
    control: Control,
    step: float,
    alone: JointModel | None,
) -> list[str]:
    """Add the actuators of a joint of MuJoCo, and return a sentence for each loss.

    Args:
        drive: the element of all actuators.
        moved: the joint of the motor.
        prefix: of the actuators' names.
        law: of the controller; None where none is known.
        control: of the joint, see `mjcf`.
        step: of the simulation, s, of which a delay is a number.
        alone: the joint, if it is alone: its gear, delay, and constant forces, which the limit does not count.

    Raises:
        MethodError: there is no law for this control.
    """
    gear, delay = (1.0, 0.0) if alone is None else (alone.gear, alone.estimate.settings.delay)
    joint, late, limit = {"joint": str(moved.get("name"))}, 0.0, math.inf
    if law is not None:
        late, limit = law.command_delay, law.limit
    elif control == "pd":
        raise MethodError(
            'The control "pd" takes a law of position and velocity, and none is declared; add a controller with the '
            'law "pd", "pid" or "cascade", or use the control "torque".'
        )
    seconds = delay if control == "torque" else late
    steps, lost = round(seconds / step), list[str]()
    if abs(steps * step - seconds) > 1e-9:
        lost.append(f"a part of the delay of {1e3 * seconds:.4g} ms: {steps} steps of {1e3 * step:.4g} ms are written")
    # A sample that is due exactly now may be missed by rounding.
    held = {"delay": number((steps - 1e-3) * step), "nsample": str(steps + 1)} if steps else {}
    if control == "torque" or law is None:
        bounds = {} if limit == math.inf else {"forcerange": triple((-limit / abs(gear), limit / abs(gear)))}
        ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint, "gear": number(gear), **bounds, **held})
        return lost
    kp, kd = law.stiffness, law.damping
    affine = {**joint, "gaintype": "fixed", "biastype": "affine", **held}
    for name, gain, bias in (("position", kp, (0.0, -kp, 0.0)), ("velocity", kd * law.share, (0.0, 0.0, -kd))):
        gains = {"gainprm": number(gain), "biasprm": triple(bias)}
        ET.SubElement(drive, "general", {"name": f"{prefix}{name}", **affine, **gains})
    ET.SubElement(drive, "motor", {"name": f"{prefix}torque", **joint})
    if limit < math.inf:
        constant = 0.0 if alone is None else _constants(alone)["motor"][0]
        moved.set("actuatorfrcrange", triple((-limit - constant, limit - constant)))
    if law.delay:
        lost.append(f"the delay of {1e3 * law.delay:.4g} ms from position to torque: commands alone are late")
    return [*lost, *law.lost]


def _step(model: JointModel, pieces: Sequence[Piece]) -> float:
    sample_time, longest = model.estimate.data.sample_time, _LONGEST
    if pieces:
        stiffest = max(piece.stiffness for piece in pieces)
        longest = min(
            longest, 1 / (_STEPS * FlexibleJoint.frequencies(model.values | {"stiffness": stiffest})["free_free"])
        )
    return sample_time / math.ceil(sample_time / longest)


def _constants(model: JointModel) -> dict[str, tuple[float, float]]:
    """Return the constant force on each mass, and how it grows with the position."""
    weight = model.weight
    forces = {name: (mass.force, 0.0) for name, mass in model.masses.items()}
    carried = [*forces][-1]
    return forces | {carried: (forces[carried][0] + weight.constant, weight.rate)}


def _add_constants(drive: ET.Element, sensors: ET.Element, model: JointModel) -> None:
    """Add the constant forces of a joint alone, and the sensors of its masses."""
    for joint, (constant, rate) in _constants(model).items():
        if constant or rate:
            bias = {"biastype": "affine", "biasprm": triple((-constant, -rate, 0.0))}
            affine = {"gaintype": "fixed", "gainprm": "0", **bias}
            ET.SubElement(drive, "general", {"name": f"constant_{joint}", "joint": joint, **affine})
        ET.SubElement(sensors, "jointpos", name=f"{joint}_position", joint=joint)
        ET.SubElement(sensors, "jointvel", name=f"{joint}_velocity", joint=joint)


def _how_to_drive(model: JointModel, control: Control) -> Iterator[str]:
    """Yield the remarks on how to drive a model of MuJoCo and to build it in."""
    transmission, position = model.joint.transmission, model.position_unit
    unit = model.torque_unit if transmission is None else TORQUE_UNIT[transmission.motor]
    if control == "pd":
        yield (
            f"Controls: position in {position}, velocity in {position}/s, both of the commands, and torque in "
            f"{model.torque_unit} beside the law; all are of this side."
        )
    else:
        yield f"The control of the actuator torque is the motor's own torque in {unit}; the others want no control."
    if model.flexible:
        yield (
            "In a robot, motor and load are both children of the link before; the load is the link, and the motor is "
            f"beside it. Free-free mode {shown(model.mode)} Hz."
        )
