"""A robot as URDF and MJCF: its tree, masses, and what each language holds of its drives."""

from __future__ import annotations

import math
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.consistent import MISFIT, consistent_robot
from jointid.models.robots.inertial import is_physical, mass_properties
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.output.export.joint_model import number
from jointid.output.export.robots import format_xml, require_timestep

_DOWN = np.array([0.0, 0.0, -9.81])  # gravity of URDF, which has no word for it
_FAR, _STRONG = "1000.0", "1000000000.0"  # limits that URDF asks for and nothing here knows
_MOST_NAMES = 4
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
            raise MethodError(
                f"No bodies near those of the model fit the estimate: the nearest are {found.misfit:.3g} standard "
                f"deviations off, rms; expected at most {MISFIT:g}. Correct the model or the record; furthest off: "
                f"{join(found.worst[:_MOST_NAMES])}."
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


def robot_urdf(robot: Robot) -> tuple[str, tuple[str, ...]]:
    """Return a robot as URDF, and its losses."""
    lost, robot = _lost(robot), _simplify(robot)
    if np.any(robot.of_joints("rotor_inertia")):
        lost.append("the rotors' inertias")
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


def robot_mjcf(robot: Robot, *, timestep: float | None = None) -> tuple[str, tuple[str, ...]]:
    """Return a robot as MJCF, and its losses; without a time step, in s, it is MuJoCo's own."""
    require_timestep(timestep)
    lost, robot = _lost(robot), _simplify(robot)
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian")
    steps = {} if timestep is None else {"timestep": number(timestep)}
    ET.SubElement(root, "option", steps | {"gravity": _numbers(robot.gravity)})
    bodies = {-1: ET.SubElement(root, "worldbody")}
    for i, (link, joint) in enumerate(zip(robot.links, robot.joints, strict=True)):
        place = {"pos": _numbers(link.origin), "xyaxes": _numbers(link.rotation[:, :2].T)}
        body = bodies[i] = ET.SubElement(bodies[link.parent], "body", {"name": link.name, **place})
        if link.inertial[0] > 0:
            solid = mass_properties(link.inertial)
            moments = {"fullinertia": _numbers(solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}
            place = {"pos": _numbers(solid.centre), "mass": number(solid.mass)}
            ET.SubElement(body, "inertial", place | moments)
        drive = {
            "armature": number(joint.rotor_inertia),
            "damping": number(joint.viscous),
            "frictionloss": number(joint.coulomb),
        }
        kind = "hinge" if link.kind == "revolute" else "slide"
        ET.SubElement(body, "joint", {"name": joint.name, "type": kind, "axis": _numbers(link.axis), **drive})
    return format_xml(root, [f"{robot.name}: written by jointid", *_comments(lost)]), tuple(lost)


def _lost(robot: Robot) -> list[str]:
    """Return the losses common to both languages."""
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
    if any(robot.flexible):
        lost.append("the springs of the joints; the friction behind them stands with that of the motors")
    return lost


def _simplify(robot: Robot) -> Robot:
    """Return a robot whose joints are rigid, with the friction of both sides, the same in both directions."""

    def simple(joint: RobotJoint) -> RobotJoint:
        sides = [""] if joint.spring is None else ["motor_", "load_"]
        each = np.array([joint.law.directions(joint.values, side) for side in sides])
        viscous, coulomb = 0.5 * np.sum(each.reshape(-1, 2, 2), axis=(0, 2))
        return RobotJoint(
            joint.name, joint.rotor_inertia, float(viscous), float(coulomb), joint.constant_torque,
            coupling=joint.coupling,
        )  # fmt: skip

    return replace(robot, joints=tuple(map(simple, robot.joints)))


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
