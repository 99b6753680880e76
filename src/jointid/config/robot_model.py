"""A robot from URDF or MJCF: what MuJoCo's own parser makes of the file's links, joints and masses.

The file is not trusted. Of its elements and attributes only those that say where joints and masses are reach MuJoCo
(`_URDF`, `_MJCF`): no shape that is drawn, no mesh, no other file, no plugin. So a model is read without the meshes
beside it. Elements are counted before they are compiled. Links that do not move against each other are one.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from jointid.common.files import open_file
from jointid.common.text import short
from jointid.common.units import Kind
from jointid.models.robots.inertial import MassProperties, change_frame
from jointid.models.robots.robot import Link, Robot, RobotJoint

_LARGEST = 2**23  # bytes
_DEEPEST = 300  # elements in each other: the parser calls itself for each
_MOST_JOINTS = 100
_MOST_PARTS = 2000  # elements of a kind: MuJoCo's time grows with the square of their number
_LEAST_MASS = 1e-13  # kg and kg m2: given to links without a mass, as MuJoCo moves none without, and taken off again
_MOST_LINKS = 100  # without a mass, in one body
_ROUNDED = 1e-5  # of the largest principal moment of inertia, that others may be below it as of a flat body

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
    "geom": f"name class type size fromto mass density shellinertia group {_PLACED}",
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
_REFUSED = ("include", "attach", "replicate", "composite", "flexcomp", "freejoint")
_ONCE: Mapping[str, tuple[str, ...]] = {
    "link": ("inertial",),
    "body": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "dynamics", "limit"),
}
_NO_NUMBER = re.compile(r"(?i)(^|[\s,])[+-]?(nan|inf)")
_WORDS = ("name", "model", "class", "childclass", "link")  # attributes that are any text
_SHAPES = ("mesh", "hfield", "sdf")  # read from other files


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
    kept, remarks = _clean_model(root, called)
    order = [one.get("name", "") for one in root.iter("joint")]
    mujoco = extra("mujoco", "robots", "A robot's model")
    try:
        with _quiet(mujoco):
            model = mujoco.MjModel.from_xml_string(ET.tostring(kept, encoding="unicode"))
    except (ValueError, mujoco.FatalError, MemoryError) as error:
        reason = " ".join(str(error).split())[:300] or "it takes too much memory"
        raise JointFileError(f"{called} is no robot that MuJoCo reads ({reason}); correct it there.") from error
    if not 1 <= model.njnt <= _MOST_JOINTS:
        raise JointFileError(
            f"{called} has {model.njnt} joints that turn or slide; expected 1 to {_MOST_JOINTS}: check that it is the "
            "robot."
        )
    joints = {model.joint(number).name or f"joint{number + 1}": model.joint(number) for number in range(model.njnt)}
    still = _follow_ties(root, locked, {name: float(one.qpos0[0]) for name, one in joints.items()}, called)
    if sprung := [name for name, one in joints.items() if np.any(one.stiffness) and name not in still]:
        raise JointFileError(
            f"{called}: the joint {', '.join(sprung)} has a spring to its parent, which is not modelled; leave its "
            "stiffness out, or name it in robot.locked if it stands still."
        )
    if unknown := [name for name in locked if name not in joints]:
        raise JointFileError(f"robot.locked{messages.no_choice(unknown[0], joints)}")
    if joints.keys() <= still.keys():
        raise JointFileError(
            "Every joint of the model stands still; expected one that moves: take it out of robot.locked."
        )
    try:
        with np.errstate(all="ignore"):  # what is too large is seen by the robot, which asks for finite numbers
            robot = _robot(mujoco, model, root.get("name") or root.get("model") or "robot", still)
    except MethodError as error:
        raise JointFileError(f"{called}: {error}") from error
    return replace(reorder_joints(robot, order), remarks=tuple(f"{called}: {one}" for one in remarks))


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
    root, _ = _strip_model(whole, called)  # the remarks were made when the robot was read
    still = _follow_ties(whole, locked, {}, called)
    links = {link.get("name"): link.find("inertial") for link in root.findall("link")}
    joints = root.findall("joint")

    def enter(link: str, pose: FloatArray) -> Iterator[tuple[str, tuple[FloatArray, FloatArray]]]:
        if (inertial := links.get(link)) is not None:
            yield link, (pose, _body_of_urdf(inertial))
        for joint in joints:
            if _link_name(joint, "parent") == link and joint.get("name") not in moving:
                moved = _pose_of_urdf(joint)
                if (at := still.get(str(joint.get("name")))) is not None:
                    axis = _vector(joint.find("axis"), "xyz", "1 0 0")
                    axis /= np.linalg.norm(axis)
                    slides = joint.get("type") == "prismatic"
                    moved = moved @ (_pose(np.eye(3), at * axis) if slides else _pose(_turn(at * axis), np.zeros(3)))
                yield from enter(_link_name(joint, "child"), pose @ moved)

    pairs = ((joint.get("name", ""), _link_name(joint, "child")) for joint in joints)
    return {name: dict(enter(child, np.eye(4))) for name, child in pairs if name in moving}


def _link_name(joint: ET.Element, end: str) -> str:
    """Return the name of the link at an end of a joint of a URDF."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _vector(element: ET.Element | None, key: str, usual: str = "0 0 0") -> FloatArray:
    return np.array([float(one) for one in (usual if element is None else element.get(key, usual)).split()])


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


def read_model(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a model's file.

    Raises:
        JointFileError: it cannot be opened, or is larger than a model is.
    """
    path = Path(path)
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise JointFileError(f"{path} cannot be opened ({reason}); check the path.") from error
    if len(raw) > _LARGEST:
        raise JointFileError(f"{path} has more than {_LARGEST} bytes; expected a URDF or MJCF file: is it a mesh?")
    return raw


def parse_model(text: str, called: str) -> ET.Element:
    """Return the root element, with names as they are written: those of a namespace with its prefix.

    Raises:
        JointFileError: the text is no XML, declares a DOCTYPE, which can declare entities, or is of xacro.
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
    level, depth = [root], 0
    while level := [child for one in level for child in one]:
        depth += 1
        if any(one.tag.startswith("xacro:") for one in level):
            raise JointFileError(f"{called} is a template for xacro; expected what xacro makes of it: run it first.")
        if depth >= _DEEPEST:
            raise JointFileError(f"{called} has elements more than {_DEEPEST} deep in each other; is it a robot?")
    return root


def _clean_model(root: ET.Element, called: str) -> tuple[ET.Element, tuple[str, ...]]:
    """Return the elements for MuJoCo to compile, and remarks on the others.

    Args:
        root: of the model.
        called: what sentences call the model.

    Raises:
        JointFileError: the model is no tree of joints that turn or slide on their own, or is too large.
    """
    if root.tag not in ("robot", "mujoco"):
        raise JointFileError(f"{called} holds <{root.tag}>; expected <robot>, URDF, or <mujoco>, MJCF: check the file.")
    _refuse_elements(root, called)
    kept, remarks = _strip_model(root, called)
    bound = ET.SubElement(kept if root.tag == "mujoco" else ET.SubElement(kept, "mujoco"), "compiler")
    bound.attrib.update(boundmass=repr(_LEAST_MASS), boundinertia=repr(_LEAST_MASS))
    return kept, (*_unused_springs(root), *remarks)


def _strip_model(root: ET.Element, called: str) -> tuple[ET.Element, tuple[str, ...]]:
    """Return the elements of joints and possible masses, and remarks on the others."""
    stripped = _filter_tree(root, _URDF if root.tag == "robot" else _MJCF, _has_mass_by_shapes(root))
    _require_few(root, stripped, called)
    for one in stripped.iter():
        for name, value in one.items():
            if name not in _WORDS and _NO_NUMBER.search(value):
                raise JointFileError(
                    f"{called}: {name} of <{one.tag}> is {short(value)}; expected finite numbers: correct it."
                )
    return stripped, (*_drop_repeats(stripped), *_forget_impossible(stripped))


def _has_mass_by_shapes(root: ET.Element) -> bool:
    return any(one.get("inertiafromgeom") == "true" for one in root.iter("compiler"))


def _geoms(body: ET.Element) -> Iterator[ET.Element]:
    """Yield the shapes of a body, also those in its frames."""
    yield from body.findall("geom")
    for frame in body.findall("frame"):
        yield from _geoms(frame)


def _is_mesh(geom: ET.Element) -> bool:
    return geom.get("type") in _SHAPES or any(name in geom.attrib for name in _SHAPES)


def _refuse_elements(root: ET.Element, called: str) -> None:
    faults = []
    by_shapes = _has_mass_by_shapes(root)
    for one in root.iter():
        name = f"<{one.tag}>" + (f" {one.get('name')}" if one.get("name") else "")
        free = one.tag == "joint" and one.get("type") in ("ball", "free", "floating", "planar")
        if free or one.tag in _REFUSED:
            said = f"{name} is of the type {one.get('type')}" if free else f"{name} is not read"
            faults.append(
                f"{called}: {said}; expected rigid bodies, written out, and joints that turn or slide about one axis."
            )
        elif one.tag == "body" and (by_shapes or one.find("inertial") is None) and any(map(_is_mesh, _geoms(one))):
            more = " and leave inertiafromgeom out" if by_shapes else ""
            faults.append(
                f"{called}: the mass of {name} follows from a mesh, which is not read; add <inertial> to it{more}."
            )
    if faults:
        raise JointFileError(dict.fromkeys(faults))


def _unused_springs(root: ET.Element) -> Iterator[str]:
    """Yield a remark on each tendon that is a spring between joints."""
    for tendon in (one for tendons in root.findall("tendon") for one in tendons.findall("fixed")):
        if tendon.get("stiffness") is not None:
            joints = " and ".join(str(one.get("joint")) for one in tendon.findall("joint"))
            yield f"the spring of the tendon between {joints} is not used"


def _filter_tree(element: ET.Element, allowed: Mapping[str, str], by_shapes: bool, weighs: bool = False) -> ET.Element:
    """Return an element with its allowed attributes and children; of shapes those from which a body has its mass."""
    names = allowed[element.tag].split()
    found = ET.Element(element.tag, {name: value for name, value in element.items() if name in names})
    for child in element:
        if child.tag in allowed and (child.tag != "geom" or weighs):
            shaped = by_shapes or child.find("inertial") is None if child.tag == "body" else weighs
            found.append(_filter_tree(child, allowed, by_shapes, shaped or child.tag == "default"))
    return found


def _require_few(root: ET.Element, stripped: ET.Element, called: str) -> None:
    """Refuse a model of too many elements, ties or equal names of joints, before MuJoCo compiles it."""
    counts = Counter(one.tag for one in stripped.iter())
    ties = ("equality", "tendon", "mimic")
    counts["> or <".join(ties)] = sum(max(len(one), 1) for tag in ties for one in root.iter(tag))
    names = Counter(one.get("name") for one in stripped.iter("joint") if one.get("name"))
    faults = [
        f"{called} has {count} elements <{tag}> (at most {_MOST_PARTS}); expected a robot of at most {_MOST_JOINTS} "
        "joints: leave out what is not part of it."
        for tag, count in counts.items()
        if count > _MOST_PARTS
    ]
    twice = [str(name) for name, count in names.items() if count > 1]
    if twice:
        faults.append(f"{called} has several joints called {', '.join(twice[:5])}; give each a name of its own.")
    if faults:
        raise JointFileError(faults)


def _drop_repeats(root: ET.Element) -> Iterator[str]:
    """Drop all but the first of elements that an element has once; yield a remark on each."""
    for parent, once in _ONCE.items():
        for one in root.iter(parent):
            for tag in once:
                for extra_one in one.findall(tag)[1:]:
                    one.remove(extra_one)
                    yield f"{_where(root, one)} has <{tag}> more than once; the first is used"


def _forget_impossible(root: ET.Element) -> Iterator[str]:
    """Drop the inertial parameters that no body can have; yield a remark on each, but those that are all 0.

    Where links are is enough to identify a robot, so a wrong mass is no reason to refuse a model.
    """
    for one in (*root.iter("link"), *root.iter("body")):
        inertial = one.find("inertial")
        if inertial is None or (reason := _impossible(inertial)) is None:
            continue
        if reason:
            yield f"{_where(root, one)} has {reason}, as no body can; its mass and inertia are taken as unknown"
        one.remove(inertial)


def _impossible(inertial: ET.Element) -> str | None:
    """Return the impossible part of inertial parameters, empty if all are 0; None if MuJoCo takes or reports them.

    Moments of URDF that are none but for rounding, as of a rod or a plate, are corrected.
    """
    of_urdf, moments = inertial.find("mass"), inertial.find("inertia")
    said = inertial.get("mass") if of_urdf is None else of_urdf.get("value")
    if inertial.get("mass") is None and (missing := [n for n in ("mass", "inertia") if inertial.find(n) is None]):
        return f"an <inertial> without <{missing[0]}>"
    if moments is not None:
        numbers = [moments.attrib.setdefault(name, "0") for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    else:
        numbers = (inertial.get("fullinertia") or inertial.get("diaginertia") or "").split()
    try:
        mass, values = float(said or "nan"), np.array([float(one) for one in numbers])
    except ValueError:
        return None
    if mass <= 0.0:
        return f"a mass of {mass:g} kg" if mass or values.any() else ""
    if values.size not in (3, 6):
        return None
    xx, yy, zz, xy, xz, yz = np.append(values, np.zeros(6 - values.size))
    low, middle, high = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    excess = high - low - middle
    if max(-low, excess) > _ROUNDED * abs(high):
        return f"principal moments of inertia of {low:.4g}, {middle:.4g}, {high:.4g} kg m2"
    if moments is not None and (more := max(_LEAST_MASS - low, excess + 1e-12 * high)) > 0.0:
        for name, value in zip(("ixx", "iyy", "izz"), (xx, yy, zz), strict=True):
            moments.set(name, repr(float(value + more)))
    return None


def _where(root: ET.Element, element: ET.Element) -> str:
    """Return an element's name, with that of its link, body or joint."""
    if element.get("name"):
        return f"{element.tag} {element.get('name')}"
    for owner in root.iter():
        if element in owner and owner is not root:
            return f"<{element.tag}> of {_where(root, owner)}"
    return f"a {element.tag}"


def _follow_ties(
    root: ET.Element, locked: Mapping[str, float], initial: Mapping[str, float], called: str
) -> dict[str, float]:
    """Return the positions of the locked joints, and of those that ties then hold.

    Raises:
        JointFileError: a tie is left between joints that move.
    """
    still = dict(locked)
    ties = list(_ties(root))
    for _tie in ties:  # one may hold the leader of another
        for _, follower, leader, polynomial in ties:
            if follower and (leader is None or leader in still):
                moved = 0.0 if leader is None else still[leader] - initial.get(leader, 0.0)
                value = initial.get(follower, 0.0) + float(np.polynomial.polynomial.polyval(moved, polynomial))
                still.setdefault(follower, value)
    carried, faults = _joints_below(root), dict[str, dict[str, None]]()
    for tag, one, other, _ in ties:
        element, _, body = tag.partition(" ")
        tied = {one, other} if one else {*(carried.get(str(other), set()) ^ carried.get(body, set()))}
        moving = sorted(name for name in tied if name and name not in still)
        faults.setdefault(element, {}).update(dict.fromkeys(moving))
    if any(faults.values()):
        raise JointFileError(
            f"{called}: <{element}> ties {', '.join(joints)}; expected joints that move on their own: name those that "
            f"stand still in robot.locked, as locked = {{ {next(iter(joints))} = 0.0 }}."
            for element, joints in faults.items()
            if joints
        )
    return still


def _ties(root: ET.Element) -> Iterator[tuple[str, str | None, str | None, list[float]]]:
    """Yield ties: the element, the joint that follows and the one that leads, with the coefficients of its polynomial.

    Of a tie of two bodies, sites or tendons no joint follows; the element is then named with the one, and the other
    leads. Ties that MJCF does not activate are none.
    """
    fixed = {joint.get("name") for joint in root.iter("joint") if joint.get("type") == "fixed"}
    try:
        for joint in root.iter("joint"):
            for mimic in joint.findall("mimic") if joint.get("name") not in fixed else ():
                numbers = [float(mimic.get("offset", 0.0)), float(mimic.get("multiplier", 1.0))]
                leader = mimic.get("joint")
                yield "mimic", joint.get("name"), None if leader in fixed else leader, numbers
        for tie in (one for equality in root.iter("equality") for one in equality if one.get("active") != "false"):
            if tie.tag == "joint":
                numbers = [float(one) for one in tie.get("polycoef", "0 1").split()]
                yield "equality", tie.get("joint1"), tie.get("joint2"), numbers
                continue
            kind = next((kind for kind in ("site", "tendon") if f"{kind}1" in tie.attrib), "")
            first, second = (" ".join([kind, tie.get((kind or "body") + k, "")]).strip() for k in "12")
            yield f"{tie.tag} {first}", None, second or "world", []
    except ValueError as error:
        raise JointFileError(f"A tie of joints has a number that is none ({error}); correct it.") from error


def _joints_below(root: ET.Element) -> dict[str, set[str]]:
    """Return by the names of bodies, sites and tendons the joints that carry or pull them."""
    found: dict[str, set[str]] = {"world": set()}
    for tendon in (one for tendons in root.findall("tendon") for one in tendons):
        found[f"tendon {tendon.get('name')}"] = {str(one.get("joint")) for one in tendon.findall("joint")}

    def enter(body: ET.Element, above: set[str]) -> None:
        own = above | {joint.get("name", "a joint without a name") for joint in body.findall("joint")}
        found.update({f"site {site.get('name')}": own for site in body.findall("site")} | {body.get("name", ""): own})
        for child in body.findall("body"):
            enter(child, own)

    for world in root.findall("worldbody"):
        for body in world.findall("body"):
            enter(body, set())
    return found


@contextmanager
def _quiet(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo's warnings, of a mass that it cannot simulate, from the terminal and from a log in this folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _robot(mujoco: Any, model: Any, name: str, still: Mapping[str, float]) -> Robot:
    """Return the robot of a model; a link whose joint stands still is one with the link that carries it."""
    links, joints = list[Link](), list[RobotJoint]()
    placed = {0: (-1, np.eye(3), np.zeros(3))}  # of each body: the link it is part of, and where in its frame
    for number in range(1, model.nbody):
        carrier, rotation, origin = placed[int(model.body_parentid[number])]
        origin = origin + rotation @ model.body_pos[number]
        rotation = rotation @ _matrix(model.body_quat[number])
        body = model.body(number).name or f"link{number}"
        first, count = int(model.body_jntadr[number]), int(model.body_jntnum[number])
        for place in range(first, first + count):
            joint = _joint(model, place)
            kind: Kind = "revolute" if model.jnt_type[place] == mujoco.mjtJoint.mjJNT_HINGE else "prismatic"
            anchor, axis = model.jnt_pos[place].copy(), model.jnt_axis[place] / np.linalg.norm(model.jnt_axis[place])
            # In a position of 0 a link is where it is drawn, less the position that is drawn.
            moved = still.get(joint.name, 0.0) - float(model.qpos0[model.jnt_qposadr[place]])
            origin = origin + rotation @ anchor
            if kind == "revolute":
                rotation = rotation @ _turn(axis * moved)
            else:
                origin = origin + rotation @ axis * moved
            if joint.name in still:
                origin = origin - rotation @ anchor
                continue
            joints.append(joint)
            low, high = map(float, model.jnt_range[place])
            limits = (low, high) if model.jnt_limited[place] else None
            called = body if place == first + count - 1 else f"{body} {place - first + 1}"
            links.append(Link(called, carrier, kind, axis, rotation, origin, limits=limits))
            carrier, rotation, origin = len(links) - 1, np.eye(3), -anchor
        placed[number] = (carrier, rotation, origin)
        if carrier >= 0:
            here = links[carrier]
            inertial = here.inertial + change_frame(_body(model, number), rotation, origin)
            links[carrier] = replace(here, inertial=inertial)
    return Robot(tuple(links), tuple(joints), np.array(model.opt.gravity), name)


def _joint(model: Any, number: int) -> RobotJoint:
    name, dof = model.joint(number).name or f"joint{number + 1}", int(model.jnt_dofadr[number])
    armature, damping, loss = (
        float(np.ravel(values[dof])[0]) for values in (model.dof_armature, model.dof_damping, model.dof_frictionloss)
    )
    return RobotJoint(name, armature, damping, loss)


def _body(model: Any, number: int) -> FloatArray:
    """Return the inertial parameters of a body in its own frame, (10,); what is only MuJoCo's least is none."""
    mass, moments = float(model.body_mass[number]), model.body_inertia[number]
    if mass <= _MOST_LINKS * _LEAST_MASS:  # links that do not move against each other are one body
        return np.zeros(10)
    axes = _matrix(model.body_iquat[number])
    inertia = axes @ np.diag(np.where(moments <= 2 * _LEAST_MASS, 0.0, moments)) @ axes.T
    return MassProperties(mass, model.body_ipos[number].copy(), inertia).inertial


def _matrix(quaternion: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_quat(quaternion, scalar_first=True).as_matrix())


def _turn(vector: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


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
