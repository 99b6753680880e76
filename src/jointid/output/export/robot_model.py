"""A robot as URDF and MJCF: its tree, masses, and what each language holds of its drives."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.config.model_file import read_model
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.consistent import MISFIT, consistent_robot
from jointid.models.robots.inertial import is_physical, mass_properties
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.models.springs import Piece
from jointid.output.export.joint_model import number
from jointid.output.export.pd_law import PDLaw
from jointid.output.export.robots import Control, add_servo, add_spring, format_xml, require_timestep
from jointid.output.export.urdf_in_place import replace_in_urdf

_DOWN = np.array([0.0, 0.0, -9.81])  # gravity of URDF, which has no word for it
_FAR, _STRONG = "1000.0", "1000000000.0"  # limits that URDF asks for and nothing here knows
_MOST_NAMES = 4
_MUJOCO_STEP = 2e-3  # s, where none is written
_NOTHING = {"pos": "0 0 0", "mass": "1e-9", "diaginertia": "1e-11 1e-11 1e-11"}  # MuJoCo moves no body without mass
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_UPPER = np.triu_indices(3)


def read_robot_model(model: Robot | Estimate) -> tuple[Robot, str]:
    """Return a robot to write, and a note on it: of an estimate bodies near the nominal ones that fit it.

    Raises:
        MethodError: the search of the estimate did not settle, no bodies fit it, or no body can have a link's inertial
            parameters.
    """
    note = ""
    if not isinstance(model, Robot):
        if not model.fit.converged:
            raise MethodError(
                "The search did not settle, so there is nothing to export; identify the robot to see what it leaves, "
                "or allow more by method.iterations, of springs method.evaluations."
            )
        found = consistent_robot(model)
        if found.misfit > MISFIT:
            worst = found.worst[:_MOST_NAMES]
            links = dict(zip(found.robot.names, (link.name for link in found.robot.links), strict=True))
            resisting = join([*dict.fromkeys(links[model.params[name].axis] for name in worst)])
            raise MethodError(
                f"No bodies near those of the model fit the estimate: the nearest are {found.misfit:.3g} standard "
                f"deviations off, rms; expected at most {MISFIT:g}. Correct the model of {resisting} or the record; "
                f"furthest off: {join(worst)}."
            )
        model = found.robot
        note = (
            f"Bodies near those of the model that fit the estimate to {found.misfit:.2g} of its deviations, rms; the "
            f"mass matrix is positive in 1000 random poses, {found.least_inertia:.3g} at the least."
        )
    impossible = [link.name for link in model.links if not is_physical(link.inertial)]
    if impossible:
        raise MethodError(
            f"No body can have the inertial parameters of {', '.join(impossible)}; write the consistent robot of an "
            "estimate."
        )
    return model, note


def robot_urdf(
    robot: Robot,
    laws: Sequence[PDLaw | None] = (),
    *,
    model: str | os.PathLike[str] | None = None,
    locked: Mapping[str, float] = MappingProxyType({}),
) -> tuple[str, tuple[str, ...]]:
    """Return a robot as URDF, which has no laws, and its losses.

    With the URDF that it was read from as `model`, it is that file with other `<inertial>` and `<dynamics>`; `locked`
    are its joints that stand still, see `load_robot`.
    """
    del laws
    lost, robot = losses_of_drives(robot), replace(robot, joints=simplify_joints(robot))
    if np.any(robot.of_joints("rotor_inertia")):
        lost.append("the rotors' inertias")
    if model is not None:
        raw = read_model(model)
        text, more = replace_in_urdf(raw, robot, locked, lambda joint: (joint.viscous, joint.coulomb))
        return text, (*lost, *more)
    if not np.allclose(robot.gravity, _DOWN, atol=1e-3):
        lost.append("how the base stands, and gravity other than 9.81 m/s2: turn it where the model is used")
    root = ET.Element("robot", name=robot.name)
    ET.SubElement(root, "link", name=_base_name(robot))
    for link, joint in zip(robot.links, robot.joints, strict=True):
        body = ET.SubElement(root, "link", name=link.name)
        if link.inertial[0] > 0:
            solid, inertial = mass_properties(link.inertial), ET.SubElement(body, "inertial")
            ET.SubElement(inertial, "origin", xyz=_numbers(solid.centre), rpy="0 0 0")
            ET.SubElement(inertial, "mass", value=number(solid.mass))
            moments = dict(zip(_MOMENTS, map(number, solid.inertia[_UPPER]), strict=True))
            ET.SubElement(inertial, "inertia", moments)
        kind = "continuous" if link.kind == "revolute" else "prismatic"
        found = ET.SubElement(root, "joint", name=joint.name, type=kind)
        ET.SubElement(found, "parent", link=_base_name(robot) if link.parent < 0 else robot.links[link.parent].name)
        ET.SubElement(found, "child", link=link.name)
        ET.SubElement(found, "origin", xyz=_numbers(link.origin), rpy=_numbers(_angles(link.rotation)))
        ET.SubElement(found, "axis", xyz=_numbers(link.axis))
        if link.kind == "prismatic":
            ET.SubElement(found, "limit", lower=f"-{_FAR}", upper=_FAR, effort=_STRONG, velocity=_STRONG)
        ET.SubElement(found, "dynamics", damping=number(joint.viscous), friction=number(joint.coulomb))
    return format_xml(root, [f"{robot.name}: written by jointid", *_comments(lost)]), tuple(lost)


def robot_mjcf(
    robot: Robot,
    laws: Sequence[PDLaw | None] = (),
    *,
    timestep: float | None = None,
    control: Control = "torque",
) -> tuple[str, tuple[str, ...]]:
    """Return a robot as MJCF, and its losses; without a time step, in s, it is MuJoCo's own.

    The motor of a joint with a spring is a body beside the link, on the same parent, and the spring a tendon between
    their joints, as of a joint alone (`robots.mjcf`).
    """
    require_timestep(timestep)
    lost = losses_of_drives(robot, springs=True)
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian")
    steps = {} if timestep is None else {"timestep": number(timestep)}
    steps |= {"integrator": "implicitfast"} if any(robot.flexible) else {}
    ET.SubElement(root, "option", steps | {"gravity": _numbers(robot.gravity)})
    bodies = {-1: ET.SubElement(root, "worldbody")}
    tendons, drive = ET.Element("tendon"), ET.Element("actuator")
    taken = {one for link, joint in zip(robot.links, robot.joints, strict=True) for one in (link.name, joint.name)}
    for i, (link, joint) in enumerate(zip(robot.links, robot.joints, strict=True)):
        place = {"pos": _numbers(link.origin), "xyaxes": _numbers(link.rotation[:, :2].T)}
        body = bodies[i] = ET.SubElement(bodies[link.parent], "body", {"name": link.name, **place})
        if link.inertial[0] > 0:
            solid = mass_properties(link.inertial)
            moments = {"fullinertia": _numbers(solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}
            at = {"pos": _numbers(solid.centre), "mass": number(solid.mass)}
            ET.SubElement(body, "inertial", at | moments)
        kind = {"type": "hinge" if link.kind == "revolute" else "slide", "axis": _numbers(link.axis)}
        armature = {"armature": number(joint.rotor_inertia)}
        motor, *behind = ({"damping": number(fv), "frictionloss": number(fc)} for fv, fc in _lines(joint))
        moved = ET.SubElement(
            body, "joint", {"name": joint.name, **kind, **(behind[0] if behind else armature | motor)}
        )
        if joint.spring is not None:
            name, spring = f"{joint.name}_motor", joint.spring
            while name in taken:
                name += "_"
            taken.add(name)
            rotor = ET.SubElement(bodies[link.parent], "body", {"name": name, **place})
            ET.SubElement(rotor, "inertial", _NOTHING)
            moved = ET.SubElement(rotor, "joint", {"name": name, **kind, **armature, **motor})
            whole = spring.law.linear or spring.law.stepped
            pieces = [Piece(0.0, 0.0, spring.stiffness, 0.0)] if whole else spring.law.pieces(joint.values)
            unit = "N m/rad" if link.kind == "revolute" else "N/m"
            add_spring(tendons, f"{joint.name}_spring", name, joint.name, pieces, spring.damping, unit)
        if laws or control != "torque":
            step, law = timestep or _MUJOCO_STEP, laws[i] if laws else None
            lost += add_servo(drive, moved, f"{joint.name}_", law, control, step)
    root.extend(element for element in (tendons, drive) if len(element))
    lost = [*dict.fromkeys(lost)]
    return format_xml(root, [f"{robot.name}: written by jointid", *_comments(lost)]), tuple(lost)


def losses_of_drives(robot: Robot, *, springs: bool = False) -> list[str]:
    """Return the losses of the drives in a language that has springs in series, or not."""
    lost = []
    if any(joint.offset for joint in robot.joints):
        lost.append("the constant parts of the motors' torques")
    uneven = [joint.name for joint in robot.joints if joint.asymmetric]
    if uneven:
        lost.append(f"that the friction of {', '.join(uneven)} is another backwards; what is written is the mean")
    rising = [joint.name for joint in robot.joints if joint.motor.get("stribeck_force")]
    if rising:
        lost.append(f"what the friction of {', '.join(rising)} rises by towards standstill")
    smooth = [(joint.name, joint.law) for joint in robot.joints if joint.law.stepped]
    lost += [f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in smooth]
    if not np.array_equal(robot.coupling, np.eye(len(robot))):
        lost.append("the coupling of the motors; rotors and friction are those of the motors, at the joints")
    sprung = [(joint.name, joint.spring.law) for joint in robot.joints if joint.spring is not None]
    if springs:
        lost += [f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in sprung if law.stepped]
    elif sprung:
        lost.append("the springs of the joints; the friction behind them stands with that of the motors")
    return lost


def simplify_joints(robot: Robot) -> tuple[RobotJoint, ...]:
    """Return the joints of a robot as rigid ones, with the friction of both sides, the same in both directions."""

    def simple(joint: RobotJoint) -> RobotJoint:
        viscous, coulomb = np.sum(_lines(joint), axis=0)
        return RobotJoint(
            joint.name, joint.rotor_inertia, float(viscous), float(coulomb), joint.constant_torque,
            coupling=joint.coupling,
        )  # fmt: skip

    return tuple(map(simple, robot.joints))


def _lines(joint: RobotJoint) -> FloatArray:
    """Return viscous and Coulomb friction of each side, (sides, 2), the mean of both directions."""
    sides = [""] if joint.spring is None else ["motor_", "load_"]
    each = np.array([joint.law.directions(joint.values, side) for side in sides])
    return np.asarray(0.5 * np.sum(each.reshape(-1, 2, 2), axis=2))


def _comments(lost: list[str]) -> list[str]:
    return [f"left out: {one}" for one in lost]


def _base_name(robot: Robot) -> str:
    names = {link.name for link in robot.links}
    return next(name for name in ("base", *(f"base_{k}" for k in range(len(names) + 1))) if name not in names)


def _numbers(values: FloatArray) -> str:
    return " ".join(map(number, np.ravel(values)))


def _angles(rotation: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw about the fixed axes x, y and z; where pitch is 90 deg, the yaw is 0."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-12:
        return np.array([math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])
