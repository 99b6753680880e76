"""A robot from URDF or MJCF, parsed by MuJoCo.

The file is not trusted. Only elements and attributes of joints and masses (`_URDF`, `_MJCF`) reach MuJoCo: no visual
shape, mesh, other file or plugin. A model is therefore read without its meshes. Elements are counted before they are
compiled. Links that do not move relative to each other are merged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common import messages
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointFileError, MethodError, extra
from jointid.common.units import Kind
from jointid.config.toml import read_text
from jointid.models.limits import AxisLimits
from jointid.models.robots.inertial import MassProperties, change_frame
from jointid.models.robots.robot import Link, Robot, RobotJoint

LARGEST = 2**23  # bytes
_DEEPEST = 300  # levels of nested elements: the parser is recursive
_MOST_JOINTS = 100
_MOST_PARTS = 5000  # elements that are compiled: MuJoCo's time grows with the square of their number
_LEAST_MASS = 1e-13  # kg and kg m2: MuJoCo requires a mass of moving links; it is removed afterwards
_ROUNDED = 1e-5  # tolerance on principal moments, relative to the largest: those of flat bodies are rounded

_PLACED = "pos quat axisangle xyaxes zaxis euler"
_MJCF: Mapping[str, str] = {
    "mujoco": "model",
    "compiler": "angle autolimits eulerseq inertiafromgeom inertiagrouprange balanceinertia settotalmass",
    "option": "gravity",
    "default": "class",
    "worldbody": "",
    "body": f"name childclass {_PLACED}",
    "frame": f"name childclass {_PLACED}",
    "inertial": f"mass diaginertia fullinertia {_PLACED}",
    "joint": "name class type axis pos ref damping armature frictionloss stiffness springdamper range limited",
    "geom": f"name class type size fromto mesh hfield mass density shellinertia group {_PLACED}",
}
_URDF: Mapping[str, str] = {
    "robot": "name",
    "link": "name",
    "inertial": "",
    "origin": "xyz rpy",
    "mass": "value",
    "inertia": "ixx ixy ixz iyy iyz izz",
    "joint": "name type",
    "parent": "link",
    "child": "link",
    "axis": "xyz",
    "dynamics": "damping friction",
    "limit": "lower upper effort velocity",
}
_ONCE = ("inertial", "origin", "mass", "inertia", "parent", "child", "axis", "dynamics", "limit")  # once per parent
_REFUSED = ("include", "attach", "replicate", "composite", "flexcomp")
_TIED: Mapping[str, str] = {"joint": "joint", "site": "site", "tendon": "fixed"}  # element type by attribute of a tie
_FREE = ("ball", "free", "floating", "planar")

Carried = Mapping[str, tuple[FloatArray, FloatArray]]
"""Pose of each body in a link's frame, (4, 4), and its inertial parameters, (10,), by body name."""


def load_robot(path: str | Path, locked: Mapping[str, float] = MappingProxyType({})) -> Robot:
    """Load a robot from a URDF or MJCF file.

    Args:
        path: of the file, at most 8 MiB.
        locked: positions of locked joints by name, rad or m. Joints that are coupled by <mimic> or <equality> must be
            locked.

    Returns:
        Its joints in the file's order, but each link after its parent. Armature, damping and friction loss of MJCF,
        damping and friction of URDF are rotor inertia, viscous and Coulomb friction. A link has no mass if the file
        declares none or an impossible one; `remarks` name the latter.

    Raises:
        JointFileError: the file cannot be read, or is no tree of independent hinge and slide joints.
        JointidError: MuJoCo is not installed.
    """
    return read_robot(read_text(Path(path), LARGEST), Path(path).name, locked)[0]


def read_robot(
    text: str, called: str = "the robot's model", locked: Mapping[str, float] = MappingProxyType({})
) -> tuple[Robot, Mapping[str, Carried]]:
    """Parse URDF or MJCF; return the robot and each joint's bodies."""
    root = parse_model(text, called)
    locked = _fix_bases(root, called, locked)
    by_shapes = any(one.get("inertiafromgeom") == "true" for one in root.iter("compiler"))
    kept = _filter_tree(root, _URDF if root.tag == "robot" else _MJCF, by_shapes)
    ties = sum(len(one) + 1 for tag in ("equality", "mimic") for one in root.iter(tag))
    if (count := ties + sum(1 for _ in kept.iter())) > _MOST_PARTS:
        raise JointFileError(
            f"{called} has {count} elements of links and joints; expected a robot, of at most {_MOST_PARTS}: remove "
            "what belongs to other things."
        )
    compiler = ET.SubElement(kept if root.tag == "mujoco" else ET.SubElement(kept, "mujoco"), "compiler")
    compiler.attrib.update(boundmass=repr(_LEAST_MASS), boundinertia=repr(_LEAST_MASS), fusestatic="false")
    mujoco = extra("mujoco", "robots", "A robot's model")
    try:
        remarks = tuple(f"{called}: {one}" for one in (*_forget_impossible(kept), *_name_meshes(root, by_shapes)))
        with ExitStack() as after, np.errstate(all="ignore"):  # a robot asks for finite numbers
            after.callback(mujoco.set_mju_user_warning, mujoco.get_mju_user_warning())
            mujoco.set_mju_user_warning(lambda _: None)  # neither on the terminal nor in a log file
            text = ET.tostring(kept, encoding="unicode").replace("><", ">\n<")
            model = mujoco.MjModel.from_xml_string(text)
            _require_free(root, model, locked, called)
            if not 0 < (moving := model.njnt - len(locked)) <= _MOST_JOINTS:
                raise JointFileError(f"{called}: {moving} joints move; expected 1 to {_MOST_JOINTS}: see robot.locked.")
            stated = {one.get("name", ""): one.find("limit") for one in kept.iter("joint")}
            robot, carried = _build(mujoco, model, root.get("name") or root.get("model") or "robot", locked, stated)
    except (ValueError, MethodError, mujoco.FatalError, MemoryError) as error:
        reason = " ".join(_name_element(text, str(error)).split())[:300] or "it takes too much memory"
        raise JointFileError(f"{called} is no robot that MuJoCo reads ({reason}); correct it there.") from error
    return replace(reorder_joints(robot, [one.get("name", "") for one in root.iter("joint")]), remarks=remarks), carried


def parse_model(text: str, called: str) -> ET.Element:
    """Return the root element of a model; names keep their namespace prefix.

    Raises:
        JointFileError: the text is no URDF or MJCF, or declares a DOCTYPE, which can declare entities.
    """

    def refuse_doctype(*_: object) -> None:
        raise JointFileError(f"{called} declares a DOCTYPE; expected plain URDF or MJCF: remove it.")

    builder, parser = ET.TreeBuilder(), expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(text.lstrip(), True)
    except (expat.ExpatError, ValueError) as error:
        raise JointFileError(f"{called} is no XML ({error}); expected URDF or MJCF: check the file.") from error
    root = builder.close()
    if root.tag not in ("robot", "mujoco"):
        raise JointFileError(f"{called} holds <{root.tag}>; expected <robot>, URDF, or <mujoco>, MJCF: check the file.")
    level, depth = [root], 0
    while level := [child for one in level for child in one]:
        depth += 1
        if depth >= _DEEPEST:
            raise JointFileError(f"{called} has elements more than {_DEEPEST} deep in each other; is it a robot?")
    return root


def _fix_bases(root: ET.Element, called: str, locked: Mapping[str, float]) -> dict[str, float]:
    """Fix locked free joints, return the other locked ones; refuse generated elements."""
    left = dict(locked)
    for parent in tuple(root.iter()):
        for one in tuple(parent):
            is_free = one.tag == "freejoint" or (one.tag == "joint" and one.get("type") in _FREE)
            name = one.get("name") or parent.get("name") or ""
            if is_free and name in locked:
                left.pop(name, None)
                one.set("type", "fixed")
                if root.tag == "mujoco":
                    parent.remove(one)
            elif is_free or one.tag in _REFUSED or one.tag.startswith("xacro:"):
                also = f", or declare robot.locked = {{ {messages.format_value(name)} = 0.0 }}" if is_free else ""
                raise JointFileError(
                    f"{called}: <{one.tag}> {name} is not read; expected rigid bodies, written out, and joints that "
                    f"turn or slide about one axis: write them so{also}."
                )
    return left


def _filter_tree(element: ET.Element, allowed: Mapping[str, str], by_shapes: bool, weighs: bool = False) -> ET.Element:
    """Copy an element with allowed attributes and children, and shapes with mass.

    The first of duplicate elements counts. A body whose mass follows from a mesh has none.
    """
    weighs = weighs and not any(one.tag == "geom" and one.get("mesh") for one in element)
    names = allowed[element.tag].split()
    found = ET.Element(element.tag, {name: value for name, value in element.items() if name in names})
    for child in element:
        repeated = child.tag in _ONCE and found.find(child.tag) is not None
        if child.tag in allowed and not repeated and (child.tag != "geom" or weighs):
            shaped = by_shapes or child.find("inertial") is None if child.tag == "body" else weighs
            found.append(_filter_tree(child, allowed, by_shapes, shaped or child.tag == "default"))
    return found


def _name_meshes(root: ET.Element, by_shapes: bool) -> Iterator[str]:
    """Yield a remark on each MJCF body with a mesh's mass."""
    for body in root.iter("body"):
        if (by_shapes or body.find("inertial") is None) and any(one.get("mesh") for one in body.findall("geom")):
            yield f"the mass of body {body.get('name', '')} follows from a mesh, which is not read: it is unknown"


def _forget_impossible(root: ET.Element) -> Iterator[str]:
    """Drop impossible masses and friction of URDF; yield remarks.

    Identification needs the geometry only, so a wrong mass is no reason to refuse a model, nor is an undeclared parent
    link "world".
    """
    for one in root.iter("link"):
        inertial = one.find("inertial")
        if inertial is not None and not _is_possible(inertial):
            stated = {value for part in inertial for value in part.attrib.values() if part.tag != "origin"}
            if not stated or any(value.strip("+-0.eE ") for value in stated):
                yield f"link {one.get('name')} has a mass or an inertia as no body can; both are taken as unknown"
            one.remove(inertial)
    links = {one.get("name") for one in root.iter("link")}
    for joint in tuple(root.iter("joint")):
        for dynamics in joint.iter("dynamics"):
            for name in [name for name, value in dynamics.items() if value.strip().startswith("-")]:
                del dynamics.attrib[name]
                yield f"joint {joint.get('name')} has a negative {name}, which is taken as unknown"
        for link in (end.get("link") for end in (*joint.iter("parent"), *joint.iter("child"))):
            if link == "world" and link not in links:
                links.add(ET.SubElement(root, "link", name=link).get("name"))
            elif link not in links:
                raise MethodError(f"joint {joint.get('name')} names the link {link}, which it has not")


def _is_possible(inertial: ET.Element) -> bool:
    """Test whether inertial parameters are physical; correct rounded ones in place."""
    weight, moments = inertial.find("mass"), inertial.find("inertia")
    if weight is None or moments is None:
        return False
    numbers = [moments.attrib.setdefault(name, "0") for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    try:
        mass, (xx, xy, xz, yy, yz, zz) = float(weight.get("value", "nan")), map(float, numbers)
        low, middle, high = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    except (ValueError, np.linalg.LinAlgError):
        return True
    excess = high - low - middle
    possible = bool(mass > 0.0 and max(-low, excess) <= _ROUNDED * abs(high)) or math.isnan(mass)
    if possible and (more := max(_LEAST_MASS - low, excess + 1e-12 * high)) > 0.0:
        for name, value in zip(("ixx", "iyy", "izz"), (xx, yy, zz), strict=True):
            moments.set(name, repr(float(value + more)))
    return possible


def _name_element(text: str, reason: str) -> str:
    """Name the joint, link or body at an error's line of the text."""
    *_, line = "0", *re.findall(r", line (\d+)", reason)
    before = "".join(text.splitlines()[: int(line)])
    *_, (tag, name) = ("", ""), *re.findall(r'<(joint|link|body)\b(?:[^>]*? name="([^"]*)")?', before)
    return reason.replace(f", line {line}", f" of {tag} {name}" if name else "")


def _require_free(root: ET.Element, model: Any, locked: Mapping[str, float], called: str) -> None:
    """Refuse coupled or sprung moving joints, and unknown locked joints."""
    joints = {one.name or f"joint{k + 1}": one for k, one in enumerate(map(model.joint, range(model.njnt)))}
    if unknown := [name for name in locked if name not in joints]:
        raise JointFileError(f"robot.locked{messages.no_choice(unknown[0], joints)}")
    named = {one.get("name"): one for one in root.iter("joint")}
    for name, follows in ((name, each.get("joint")) for name, one in named.items() for each in one.findall("mimic")):
        if follows not in named:
            raise MethodError(f"joint {name} follows {follows}, which is no joint")
    tied = {name for names in _ties(root) for name in names}
    moving = {name: one for name, one in joints.items() if name not in locked}
    if bound := [name for name, one in moving.items() if name in tied or np.any(one.stiffness)]:
        raise JointFileError(
            f"{called}: {', '.join(bound)} are tied to other joints, or have springs to their parents; expected joints "
            "that move on their own: name those that stand still, as "
            f"robot.locked = {{ {messages.format_value(bound[0])} = 0.0 }}, or change the model."
        )


def _ties(root: ET.Element) -> Iterator[set[str]]:
    """Yield the joints that each constraint couples.

    Two bodies, sites or tendons couple the joints between them. Inactive MJCF constraints are ignored.
    """
    parents = {child: parent for parent in root.iter() for child in parent}
    named = {(one.tag, one.get("name")): one for one in root.iter()}

    def find_joints(tag: str, name: str | None) -> set[str]:
        at, found = named.get((tag, name)), set[str]()
        while at is not None:
            found |= {str(joint.get("joint") or joint.get("name")) for joint in at.findall("joint")}
            at = parents.get(at)
        return found

    for joint in (one for one in root.iter("joint") if one.get("type") != "fixed"):
        for mimic in joint.findall("mimic"):
            yield {joint.get("name", ""), mimic.get("joint", "")}
    for tie in (one for equality in root.iter("equality") for one in equality if one.get("active") != "false"):
        key, tag = next(((key, tag) for key, tag in _TIED.items() if f"{key}1" in tie.attrib), ("body", "body"))
        first, second = tie.get(f"{key}1"), tie.get(f"{key}2")
        yield {*filter(None, (first, second))} if key == "joint" else find_joints(tag, first) ^ find_joints(tag, second)


def _build(
    mujoco: Any, model: Any, name: str, still: Mapping[str, float], stated: Mapping[str, ET.Element | None]
) -> tuple[Robot, Mapping[str, Carried]]:
    """Return the robot of a model and its stated limits, and the bodies of each joint.

    A body with a locked joint is merged with its parent link.
    """
    links, joints, carried = list[Link](), list[RobotJoint](), dict[str, dict[str, tuple[FloatArray, FloatArray]]]()
    placed = {0: (-1, np.eye(3), np.zeros(3))}  # link of each body, and its pose in the link's frame
    for number in range(1, model.nbody):
        carrier, rotation, origin = placed[int(model.body_parentid[number])]
        origin = origin + rotation @ model.body_pos[number]
        rotation = rotation @ Rotation.from_quat(model.body_quat[number], scalar_first=True).as_matrix()
        body = model.body(number).name or f"link{number}"
        first, count = int(model.body_jntadr[number]), int(model.body_jntnum[number])
        for place in range(first, first + count):
            numbers = (model.dof_armature, model.dof_damping, model.dof_frictionloss)
            rotor, damping, loss = (float(np.ravel(one[int(model.jnt_dofadr[place])])[0]) for one in numbers)
            joint = RobotJoint(model.joint(place).name or f"joint{place + 1}", rotor, damping, loss)
            kind: Kind = "revolute" if model.jnt_type[place] == mujoco.mjtJoint.mjJNT_HINGE else "prismatic"
            anchor, axis = model.jnt_pos[place].copy(), model.jnt_axis[place] / np.linalg.norm(model.jnt_axis[place])
            # The model is drawn at qpos0, so that position is subtracted.
            moved = still.get(joint.name, 0.0) - float(model.qpos0[model.jnt_qposadr[place]])
            origin = origin + rotation @ anchor
            if kind == "revolute":
                rotation = rotation @ Rotation.from_rotvec(axis * moved).as_matrix()
            else:
                origin = origin + rotation @ axis * moved
            if joint.name in still:
                origin = origin - rotation @ anchor
                continue
            joints.append(joint)
            carried[joint.name] = {}
            limits = _limits(model, place, stated.get(joint.name))
            called = body if place == first + count - 1 else f"{body} {place - first + 1}"
            links.append(Link(called, carrier, kind, axis, rotation, origin, limits=limits))
            carrier, rotation, origin = len(links) - 1, np.eye(3), -anchor
        placed[number] = (carrier, rotation, origin)
        if carrier >= 0 and np.any(own := _body(model, number)):
            inertial = links[carrier].inertial + change_frame(own, rotation, origin)
            links[carrier] = replace(links[carrier], inertial=inertial)
            pose = np.block([[rotation, origin[:, np.newaxis]], [np.zeros((1, 3)), np.ones((1, 1))]])
            carried[joints[carrier].name][body] = pose, own
    return Robot(tuple(links), tuple(joints), np.array(model.opt.gravity), name), carried


def _limits(model: Any, number: int, stated: ET.Element | None) -> AxisLimits:
    """Return a joint's limits; a speed or an effort of 0 is none."""
    low, high = map(float, model.jnt_range[number])
    limits = AxisLimits(low, high) if model.jnt_limited[number] and low < high else AxisLimits()
    sizes = {} if stated is None else {"speed": stated.get("velocity", "0"), "torque": stated.get("effort", "0")}
    return replace(limits, **{name: float(size) for name, size in sizes.items() if 0.0 < float(size) < math.inf})


def _body(model: Any, number: int) -> FloatArray:
    """Return a body's inertial parameters, (10,); MuJoCo's minima count as 0."""
    mass, moments = float(model.body_mass[number]), model.body_inertia[number]
    if mass <= 2 * _LEAST_MASS:
        return np.zeros(10)
    axes = Rotation.from_quat(model.body_iquat[number], scalar_first=True).as_matrix()
    inertia = axes @ np.diag(np.where(moments <= 2 * _LEAST_MASS, 0.0, moments)) @ axes.T
    return MassProperties(mass, model.body_ipos[number].copy(), inertia).inertial


def reorder_joints(robot: Robot, names: Sequence[str]) -> Robot:
    """Return a robot with joints in the given order, parents first."""
    rank = {name: place for place, name in enumerate(dict.fromkeys(names))}
    left = sorted(range(len(robot)), key=lambda i: rank.get(robot.names[i], len(rank)))
    place = {-1: -1}
    while left:
        following = next(i for i in left if robot.links[i].parent in place)
        left.remove(following)
        place[following] = len(place) - 1
    chosen = [old for old in place if old >= 0]
    links = tuple(replace(robot.links[old], parent=place[robot.links[old].parent]) for old in chosen)
    return replace(robot, links=links, joints=tuple(robot.joints[old] for old in chosen))
