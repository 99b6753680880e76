"""The file of a robot's model, URDF or MJCF: which elements of its XML reach MuJoCo's parser.

The file is not trusted. Of its elements and attributes only those that say where joints and masses are are kept
(`_URDF`, `_MJCF`): no shape that is drawn, no mesh, no other file, no plugin. So a model is read without the meshes
beside it. Elements are counted before they are compiled.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from jointid.common.errors import JointFileError
from jointid.common.files import open_file
from jointid.common.text import short

_LARGEST = 2**23  # bytes
_DEEPEST = 300  # elements in each other: the parser calls itself for each
MOST_JOINTS = 100
_MOST_PARTS = 2000  # elements of a kind: MuJoCo's time grows with the square of their number
LEAST_MASS = 1e-13  # kg and kg m2: given to links without a mass, as MuJoCo moves none without, and taken off again
_ROUNDED = 1e-5  # of the largest principal moment of inertia, that others may be below it as of a flat body

_TURNED = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_PLACED = ("pos", *_TURNED)
_GEOM = ("name", "class", "type", "size", "fromto", "mass", "density", "shellinertia", "group", *_PLACED)
_JOINT = (
    "name",
    "class",
    "type",
    "axis",
    "pos",
    "ref",
    "damping",
    "armature",
    "frictionloss",
    "stiffness",
    "springdamper",
    "range",
    "limited",
)
_MJCF: Mapping[str, tuple[str, ...]] = {
    "mujoco": ("model",),
    "compiler": (
        "angle",
        "autolimits",
        "eulerseq",
        "inertiafromgeom",
        "inertiagrouprange",
        "balanceinertia",
        "settotalmass",
    ),
    "option": ("gravity",),
    "default": ("class",),
    "worldbody": (),
    "body": ("name", "childclass", *_PLACED),
    "frame": ("name", "childclass", *_PLACED),
    "inertial": ("mass", "diaginertia", "fullinertia", *_PLACED),
    "joint": _JOINT,
    "geom": _GEOM,
}
_URDF: Mapping[str, tuple[str, ...]] = {
    "robot": ("name",),
    "link": ("name",),
    "inertial": (),
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "dynamics": ("damping", "friction"),
    "limit": ("lower", "upper", "effort", "velocity"),
}
_REFUSED: Mapping[str, str] = {
    "include": "reads another file; write its content into this one",
    "attach": "reads another file; write its content into this one",
    "replicate": "repeats bodies; write them out",
    "composite": "is no rigid body; leave it out",
    "flexcomp": "is no rigid body; leave it out",
    "freejoint": "floats; expected joints that turn or slide on a fixed base: leave it out",
}
_ONCE: Mapping[str, tuple[str, ...]] = {
    "link": ("inertial",),
    "body": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "dynamics", "limit"),
}
_NO_NUMBER = re.compile(r"(?i)(^|[\s,])[+-]?(nan|inf)")
_WORDS = ("name", "model", "class", "childclass", "link")  # attributes that are any text
_SHAPES = ("mesh", "hfield", "sdf")  # read from other files


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
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()
    open_elements = 0

    def refuse_doctype(*_: object) -> None:
        raise JointFileError(f"{called} declares a DOCTYPE; expected plain URDF or MJCF: remove it.")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal open_elements
        open_elements += 1
        if name.startswith("xacro:"):
            raise JointFileError(
                f"{called} is a template for xacro; expected what that makes of it: run xacro on it first."
            )
        if open_elements > _DEEPEST:
            raise JointFileError(f"{called} has elements more than {_DEEPEST} deep in each other; is it a robot?")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal open_elements
        open_elements -= 1
        builder.end(name)

    parser.StartDoctypeDeclHandler, parser.StartElementHandler, parser.EndElementHandler = refuse_doctype, start, end
    try:
        parser.Parse(text.lstrip(), True)
    except (expat.ExpatError, ValueError) as error:
        raise JointFileError(f"{called} is no XML ({error}); expected URDF or MJCF: check the file.") from error
    return builder.close()


def clean_model(root: ET.Element, called: str) -> tuple[ET.Element, tuple[str, ...]]:
    """Return the elements for MuJoCo to compile, and remarks on the others.

    Args:
        root: of the model.
        called: what sentences call the model.

    Raises:
        JointFileError: the model is no tree of joints that turn or slide on their own, or is too large.
    """
    if root.tag not in ("robot", "mujoco"):
        raise JointFileError(f"{called} holds <{root.tag}>; expected <robot>, URDF, or <mujoco>, MJCF: check the file.")
    _state_meshes(root)
    _refuse_elements(root, called)
    kept, remarks = strip_model(root, called)
    _give_masses(kept)
    return kept, (*_unused_springs(root), *remarks)


def strip_model(root: ET.Element, called: str) -> tuple[ET.Element, tuple[str, ...]]:
    """Return the elements of joints and possible masses, and remarks on the others."""
    stripped = _filter_tree(root, _URDF if root.tag == "robot" else _MJCF)
    _require_few(root, stripped, called)
    for one in stripped.iter():
        for name, value in one.items():
            if name not in _WORDS and _NO_NUMBER.search(value):
                raise JointFileError(
                    f"{called}: {name} of <{one.tag}> is {short(value)}; expected finite numbers: correct it."
                )
    return stripped, (*_drop_repeats(stripped), *_forget_impossible(stripped))


def _state_meshes(root: ET.Element) -> None:
    """Write the type `mesh` of default classes into each shape."""
    classes = dict[str, bool]()

    def read(default: ET.Element, inherited: bool) -> None:
        own = [one for one in default.findall("geom") if "type" in one.attrib or _is_mesh(one)]
        name = default.get("class", "main")
        inherited = classes[name] = any(map(_is_mesh, own)) if own else classes.get(name, inherited)
        for one in own:
            for key in ("type", *_SHAPES) if _is_mesh(one) else ():
                one.attrib.pop(key, None)
        for inner in default.findall("default"):
            read(inner, inherited)

    def enter(body: ET.Element, usual: str) -> None:
        usual = body.get("childclass", usual)
        for one in body:
            if one.tag == "geom" and "type" not in one.attrib and classes.get(one.get("class", usual)):
                one.set("type", _SHAPES[0])
            elif one.tag in ("body", "frame"):
                enter(one, usual)

    for default in root.findall("default"):
        read(default, False)
    for world in root.findall("worldbody") if any(classes.values()) else ():
        enter(world, next(iter(classes)))


def _geoms(body: ET.Element) -> Iterator[ET.Element]:
    """Yield the shapes of a body, also those in its frames."""
    yield from body.findall("geom")
    for frame in body.findall("frame"):
        yield from _geoms(frame)


def _is_mesh(geom: ET.Element) -> bool:
    return geom.get("type") in _SHAPES or any(name in geom.attrib for name in _SHAPES)


def _refuse_elements(root: ET.Element, called: str) -> None:
    faults = []
    by_shapes = any(one.get("inertiafromgeom") == "true" for one in root.iter("compiler"))
    for one in root.iter():
        name = f"<{one.tag}>" + (f" {one.get('name')}" if one.get("name") else "")
        if one.tag in _REFUSED:
            faults.append(f"{called}: {name} {_REFUSED[one.tag]}.")
        elif one.tag == "joint" and one.get("type") in ("ball", "free", "floating", "planar"):
            kinds = "expected joints that turn or slide about one axis: write it as several joints, or leave it out"
            faults.append(f"{called}: {name} is of the type {one.get('type')}; {kinds}.")
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


def _filter_tree(element: ET.Element, allowed: Mapping[str, tuple[str, ...]]) -> ET.Element:
    """Return an element with its allowed attributes and children."""
    names = allowed[element.tag]
    found = ET.Element(element.tag, {name: value for name, value in element.items() if name in names})
    for child in element:
        if child.tag in allowed and not (child.tag == "geom" and (_is_mesh(child) or element.tag == "worldbody")):
            found.append(_filter_tree(child, allowed))
    return found


def _require_few(root: ET.Element, stripped: ET.Element, called: str) -> None:
    """Refuse a model of too many elements, ties or equal names of joints, before MuJoCo compiles it."""
    counts = Counter(one.tag for one in stripped.iter())
    ties = ("equality", "tendon", "mimic")
    counts["> or <".join(ties)] = sum(max(len(one), 1) for tag in ties for one in root.iter(tag))
    names = Counter(one.get("name") for one in stripped.iter("joint") if one.get("name"))
    faults = [
        f"{called} has {count} elements <{tag}> (at most {_MOST_PARTS}); expected a robot of at most {MOST_JOINTS} "
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
    least = repr(LEAST_MASS)
    for one in (*root.iter("link"), *root.iter("body")):
        inertial = one.find("inertial")
        if inertial is None or (reason := _impossible(inertial)) is None:
            continue
        if reason:
            yield f"{_where(root, one)} has {reason}, as no body can; its mass and inertia are taken as unknown"
        one.remove(inertial)
        if one.tag == "body":  # without it MuJoCo makes a mass of the shapes
            one.append(ET.Element("inertial", pos="0 0 0", mass=least, diaginertia=" ".join(3 * [least])))


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
    if moments is not None and (more := max(LEAST_MASS - low, excess + 1e-12 * high)) > 0.0:
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


def _give_masses(root: ET.Element) -> None:
    """Give MuJoCo's least mass to links and bodies without one."""
    least = repr(LEAST_MASS)
    for link in root.findall("link"):
        if link.find("inertial") is None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value=least)
            ET.SubElement(inertial, "inertia", ixx=least, iyy=least, izz=least, ixy="0", ixz="0", iyz="0")
    for body in root.iter("body"):
        if body.find("inertial") is None and body.find("geom") is None and body.find("frame") is None:
            ET.SubElement(body, "inertial", pos="0 0 0", mass=least, diaginertia=" ".join(3 * [least]))


def follow_ties(
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
    carried = _joints_below(root)
    tied_by = dict[str, tuple[dict[str, None], dict[str, None]]]()  # of each element the joints, and those to lock
    for tag, one, other, _ in ties:
        element, _, body = tag.partition(" ")
        tied = {one, other} if one else {*(carried.get(str(other), set()) ^ carried.get(body, set()))}
        if moving := sorted(name for name in tied if name and name not in still):
            joints, leaders = tied_by.setdefault(element, ({}, {}))
            joints |= dict.fromkeys(moving)
            leaders[str(other) if other in moving else moving[-1]] = None
    if tied_by:
        raise JointFileError(
            f"{called}: <{element}> ties {', '.join(joints)}; expected joints that move on their own: name those that "
            f"stand still in robot.locked, as locked = {{ {' = 0.0, '.join(leaders)} = 0.0 }}."
            for element, (joints, leaders) in tied_by.items()
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
