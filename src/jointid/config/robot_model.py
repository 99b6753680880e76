"""A robot from URDF or MJCF: what MuJoCo's own parser makes of the file's links, joints and masses.

The file is not trusted: only what `model_file` keeps of it is compiled. Links that do not move against each other are
one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common import messages
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointFileError, MethodError, extra
from jointid.common.units import Kind
from jointid.config.model_file import (
    LEAST_MASS,
    MOST_JOINTS,
    clean_model,
    follow_ties,
    parse_model,
    read_model,
    strip_model,
)
from jointid.models.robots.inertial import MassProperties, change_frame
from jointid.models.robots.robot import Link, Robot, RobotJoint

_MOST_LINKS = 100  # without a mass, in one body


def load_robot(path: str | Path, locked: Mapping[str, float] = MappingProxyType({})) -> Robot:
    """Load a robot from a URDF or MJCF file.

    Args:
        path: of the file, at most 8 MiB.
        locked: by the names of joints that stand still their positions, rad or m. Joints tied to them, by <mimic> or
            by <equality>, stand still, too.

    Returns:
        Its joints in the file's order, as far as each link comes after its parent. Armature, damping and friction loss
        of MJCF, damping and friction of URDF are rotor inertia, viscous and Coulomb friction. A link for which the
        file says no mass, or one that no body can have, has none. `remarks` say what of the file is not used.

    Raises:
        JointFileError: the file cannot be read, or is no tree of joints that turn or slide on their own.
        ExtraError: MuJoCo is not installed.
    """
    path = Path(path)
    try:
        text = read_model(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error
    return read_robot(text, path.name, locked)


def read_robot(
    text: str, called: str = "the robot's model", locked: Mapping[str, float] = MappingProxyType({})
) -> Robot:
    """Return a robot from the text of a URDF or MJCF file; see `load_robot`.

    Args:
        text: XML.
        called: what sentences call it.
        locked: as of `load_robot`.
    """
    root = parse_model(text, called)
    kept, remarks = clean_model(root, called)
    order = [one.get("name", "") for one in root.iter("joint")]
    mujoco = extra("mujoco", "robots", "A robot's model")
    try:
        with _quiet(mujoco):
            model = mujoco.MjModel.from_xml_string(ET.tostring(kept, encoding="unicode"))
    except (ValueError, mujoco.FatalError, MemoryError) as error:
        reason = " ".join(str(error).split())[:300] or "it takes too much memory"
        raise JointFileError(f"{called} is no robot that MuJoCo reads ({reason}); correct it there.") from error
    try:
        with np.errstate(all="ignore"):  # what is too large is seen by the robot, which asks for finite numbers
            robot = _robot(mujoco, model, root.get("name") or root.get("model") or "robot", called)
    except MethodError as error:
        raise JointFileError(f"{called}: {error}") from error
    joints = [model.joint(number) for number in range(model.njnt)]
    still = follow_ties(root, locked, {one.name: float(one.qpos0[0]) for one in joints}, called)
    sprung = [n for n, one in zip(robot.names, joints, strict=True) if np.any(one.stiffness) and n not in still]
    if sprung:
        raise JointFileError(
            f"{called}: the joint {', '.join(sprung)} has a spring to its parent, which is not modelled; leave its "
            "stiffness out, or name it in robot.locked if it stands still."
        )
    if unknown := [name for name in locked if name not in robot.names]:
        raise JointFileError(f"robot.locked{messages.no_choice(unknown[0], robot.names)}")
    ordered = reorder_joints(lock_joints(robot, still), order)
    return replace(ordered, remarks=tuple(f"{called}: {one}" for one in remarks))


def carried_bodies(
    text: str, called: str, moving: Sequence[str], locked: Mapping[str, float] = MappingProxyType({})
) -> dict[str, dict[str, tuple[FloatArray, FloatArray]]]:
    """Return the bodies of the links that each moving joint of a URDF carries rigidly.

    Args:
        text: XML of the URDF.
        called: what sentences call it.
        moving: names of the joints that move; all others are fixed, or stand still.
        locked: as of `load_robot`.

    Returns:
        By the names of joint and link the pose of the link in the frame of the joint's own link, (4, 4), and its ten
        inertial parameters in its own frame, (10,).
    """
    whole = parse_model(text, called)
    root, _ = strip_model(whole, called)  # the remarks were made when the robot was read
    still = follow_ties(whole, locked, {}, called)
    links = {link.get("name"): link.find("inertial") for link in root.findall("link")}
    joints = root.findall("joint")

    def enter(link: str, pose: FloatArray) -> Iterator[tuple[str, tuple[FloatArray, FloatArray]]]:
        if (inertial := links.get(link)) is not None:
            yield link, (pose, _body_of_urdf(inertial))
        for joint in joints:
            if _named(joint, "parent") == link and joint.get("name") not in moving:
                moved = _pose_of_urdf(joint)
                if (at := still.get(str(joint.get("name")))) is not None:
                    axis = _vector(joint.find("axis"), "xyz", "1 0 0")
                    axis /= np.linalg.norm(axis)
                    slides = joint.get("type") == "prismatic"
                    moved = moved @ (_pose(np.eye(3), at * axis) if slides else _pose(_turn(at * axis), np.zeros(3)))
                yield from enter(_named(joint, "child"), pose @ moved)

    pairs = ((joint.get("name", ""), _named(joint, "child")) for joint in joints)
    return {name: dict(enter(child, np.eye(4))) for name, child in pairs if name in moving}


def _named(joint: ET.Element, end: str) -> str:
    """Return the name of the link at an end of a joint of a URDF."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _vector(element: ET.Element | None, key: str, usual: str = "0 0 0") -> FloatArray:
    return np.array([float(one) for one in (usual if element is None else element.get(key, usual)).split()])


def _turn(vector: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _pose(rotation: FloatArray, origin: FloatArray) -> FloatArray:
    """Return a pose as a matrix, (4, 4)."""
    return np.block([[rotation, origin[:, np.newaxis]], [np.zeros((1, 3)), np.ones((1, 1))]])


def _pose_of_urdf(element: ET.Element) -> FloatArray:
    """Return the pose that the <origin> of an element says, (4, 4)."""
    origin = element.find("origin")
    return _pose(Rotation.from_euler("xyz", _vector(origin, "rpy")).as_matrix(), _vector(origin, "xyz"))


def _body_of_urdf(inertial: ET.Element) -> FloatArray:
    """Return the ten inertial parameters that an <inertial> says, (10,)."""
    pose, mass, moments = _pose_of_urdf(inertial), inertial.find("mass"), inertial.find("inertia")
    assert mass is not None and moments is not None
    xx, xy, xz, yy, yz, zz = (float(moments.get(k, 0.0)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    about = pose[:3, :3] @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ pose[:3, :3].T
    return MassProperties(float(mass.get("value", 0.0)), pose[:3, 3], about).inertial


def lock_joints(robot: Robot, locked: Mapping[str, float]) -> Robot:
    """Return a robot whose named joints stand still: each of their links is one with the link that carries it.

    Args:
        robot: with all joints.
        locked: position of each, rad or m, by its name.

    Raises:
        JointFileError: no joint is left.
    """
    if not locked:
        return robot
    links, joints = list[Link](), list[RobotJoint]()
    placed = {-1: (-1, np.eye(3), np.zeros(3))}  # of each link: the one that it is part of, and where in its frame
    for number, (link, joint) in enumerate(zip(robot.links, robot.joints, strict=True)):
        parent, turn, shift = placed[link.parent]
        rotation, origin = turn @ link.rotation, shift + turn @ link.origin
        if joint.name not in locked:
            links.append(replace(link, parent=parent, rotation=rotation, origin=origin))
            joints.append(joint)
            placed[number] = (len(links) - 1, np.eye(3), np.zeros(3))
            continue
        if link.kind == "revolute":
            rotation = rotation @ Rotation.from_rotvec(link.axis * locked[joint.name]).as_matrix()
        else:
            origin = origin + rotation @ link.axis * locked[joint.name]
        placed[number] = (parent, rotation, origin)
        if parent >= 0:
            inertial = links[parent].inertial + change_frame(link.inertial, rotation, origin)
            links[parent] = replace(links[parent], inertial=inertial)
    if not links:
        raise JointFileError(
            "Every joint of the model stands still; expected one that moves: take it out of robot.locked."
        )
    return replace(robot, links=tuple(links), joints=tuple(joints))


@contextmanager
def _quiet(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo's warnings, of a mass that it cannot simulate, from the terminal and from a log in this folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _robot(mujoco: Any, model: Any, name: str, called: str) -> Robot:
    links, joints = list[Link](), list[RobotJoint]()
    placed = {0: (-1, np.eye(3), np.zeros(3))}  # of each body: the link it is part of, and where in its frame
    for number in range(1, model.nbody):
        carrier, rotation, origin = placed[int(model.body_parentid[number])]
        origin = origin + rotation @ model.body_pos[number]
        rotation = rotation @ _matrix(mujoco, model.body_quat[number])
        body = model.body(number).name or f"link{number}"
        first, count = int(model.body_jntadr[number]), int(model.body_jntnum[number])
        for joint in range(first, first + count):
            kind: Kind = "revolute" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else "prismatic"
            anchor, axis = model.jnt_pos[joint].copy(), model.jnt_axis[joint] / np.linalg.norm(model.jnt_axis[joint])
            origin, back = origin + rotation @ anchor, -float(model.qpos0[model.jnt_qposadr[joint]])
            if kind == "revolute":
                rotation = rotation @ _rotation_about(mujoco, axis, back)
            else:
                origin = origin + rotation @ axis * back
            joints.append(_joint(model, joint))
            last = joint == first + count - 1
            low, high = map(float, model.jnt_range[joint])
            called_link = body if last else f"{body} {joint - first + 1}"
            links.append(
                Link(
                    called_link,
                    carrier,
                    kind,
                    axis,
                    rotation,
                    origin,
                    limits=(low, high) if model.jnt_limited[joint] else None,
                )
            )
            carrier, rotation, origin = len(links) - 1, np.eye(3), -anchor
        placed[number] = (carrier, rotation, origin)
        if carrier >= 0:
            here = links[carrier]
            inertial = here.inertial + change_frame(_body(mujoco, model, number), rotation, origin)
            links[carrier] = replace(here, inertial=inertial)
    if not 1 <= len(links) <= MOST_JOINTS:
        raise JointFileError(
            f"{called} has {len(links)} joints that turn or slide; expected 1 to {MOST_JOINTS}: check that "
            "it is the robot."
        )
    return Robot(tuple(links), tuple(joints), np.array(model.opt.gravity), name)


def _joint(model: Any, number: int) -> RobotJoint:
    name, dof = model.joint(number).name or f"joint{number + 1}", int(model.jnt_dofadr[number])
    armature, damping, loss = (
        float(np.ravel(values[dof])[0]) for values in (model.dof_armature, model.dof_damping, model.dof_frictionloss)
    )
    return RobotJoint(name, armature, damping, loss)


def _body(mujoco: Any, model: Any, number: int) -> FloatArray:
    """Return the inertial parameters of a body in its own frame, (10,); what is only MuJoCo's least is none."""
    mass, moments = float(model.body_mass[number]), model.body_inertia[number]
    if mass <= _MOST_LINKS * LEAST_MASS:  # links that do not move against each other are one body
        return np.zeros(10)
    axes = _matrix(mujoco, model.body_iquat[number])
    inertia = axes @ np.diag(np.where(moments <= 2 * LEAST_MASS, 0.0, moments)) @ axes.T
    return MassProperties(mass, model.body_ipos[number].copy(), inertia).inertial


def _matrix(mujoco: Any, quaternion: FloatArray) -> FloatArray:
    found = np.empty(9)
    mujoco.mju_quat2Mat(found, quaternion / np.linalg.norm(quaternion))
    return found.reshape(3, 3)


def _rotation_about(mujoco: Any, axis: FloatArray, angle: float) -> FloatArray:
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return _matrix(mujoco, quaternion)


def reorder_joints(robot: Robot, names: Sequence[str]) -> Robot:
    """Return a robot with its joints in the given order, parents before children."""
    rank = {name: place for place, name in enumerate(dict.fromkeys(names))}
    chosen = list(_sort_links(robot, [rank.get(name, len(rank)) for name in robot.names]))
    place = {-1: -1} | {old: new for new, old in enumerate(chosen)}
    links = tuple(replace(robot.links[old], parent=place[robot.links[old].parent]) for old in chosen)
    return replace(robot, links=links, joints=tuple(robot.joints[old] for old in chosen))


def _sort_links(robot: Robot, ranks: list[int]) -> Iterator[int]:
    left, there = sorted(range(len(robot)), key=lambda i: ranks[i]), {-1}
    while left:
        following = next(i for i in left if robot.links[i].parent in there)
        left.remove(following)
        there.add(following)
        yield following
