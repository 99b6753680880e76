"""From TOML to a joint file and back."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from jointid.common.errors import MethodError
from jointid.config.declaration import keys_of
from jointid.config.file import File, joint_file
from jointid.config.tables import INSTEAD, method_keys, read_tables
from jointid.config.toml import Change, edit, parse_change, parse_toml, put, read_text
from jointid.estimation.methods.registry import METHODS, method_of
from jointid.models.controllers import LAWS


def load(
    path: str | os.PathLike[str],
    changes: Iterable[str] = (),
    *,
    axis: str | None = None,
    method: str | None = None,
    friction: str | None = None,
    learn: bool = False,
    what: str = "",
) -> File:
    """Load a joint file, or a robot file, which has the table [robot]; it is checked before anything runs.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``method.frequency=30``.
        axis: the joint of a robot file that is returned as a joint file, as if no other joint moved: with its own
            `method` and `gravity`, and with its numbers as starts. Changes of [method] are then of its own method.
        method: its name, whatever the file and the changes say. Settings of [method] are kept if the file names no
            other method and this one has them.
        friction: the name of a law, of a robot for every joint, whatever the file and the changes say.
        learn: whether the gains of the controller, or all of it, may be missing; a missing gain is 1.
        what: the work, the beginning of a sentence, if it is for a single joint.

    Raises:
        JointFileError: the file, or the model of a robot that it names, cannot be read, is no TOML, or has faults;
            `faults` has a sentence for each.
        MethodError: the robot has no such joint, or none is named for work on a single one.
        ExtraError: MuJoCo, which reads the model of a robot, is not installed.
    """
    path = Path(path)
    return _load(read_text(path), path, changes, axis, method, friction, learn, what)


def loads(text: str, folder: str | os.PathLike[str] = ".", changes: Iterable[str] = (), **choices: Any) -> File:
    """Load a joint file, or a robot file, from its text; see `load`.

    Args:
        text: TOML.
        folder: from which the paths of the record and of a robot's model are taken.
        changes: as of `load`.
        choices: further arguments of `load`.
    """
    return _load(text, Path(folder) / "joint.toml", changes, **choices)


def dumps(file: File) -> str:
    """Return a joint file or a robot file as TOML, with the changes with which it was loaded; `loads` gives it back."""
    return edit(file.text, *file.changes)


def _load(
    text: str,
    path: Path,
    changes: Iterable[str] = (),
    axis: str | None = None,
    method: str | None = None,
    friction: str | None = None,
    learn: bool = False,
    what: str = "",
) -> File:
    """Return the file of a text with changes; see `load`."""
    tables = parse_toml(text)
    if what and axis is None and "robot" in tables:  # before the choices of one joint
        raise MethodError(f"{what} takes one joint, and {path} is a robot file; name one of its joints by --axis.")
    joints = tables.get("joints")
    names = [one.get("name") for one in joints if isinstance(one, dict)] if isinstance(joints, list) else []
    below = ["joints", str(names.index(axis) + 1)] if "robot" in tables and axis in names else []
    first, last = list[Change](), list[Change]()
    if method is not None:
        first.append(partial(_keep_settings, path=[*below, "method"], method=method))
        last.append(partial(put, path=[*below, "method", "name"], value=method))
    if friction is not None:
        laws = [["joints", str(number + 1)] for number in range(len(names))] or [["joint"]]
        last += [partial(put, path=[*law, "friction"], value=friction) for law in laws]
    own = (".".join([*below, one]) if re.match(r"method[.=]", one) else one for one in changes)
    every = [*first, *map(parse_change, own), *last]
    for change in every:
        change(tables)
    stand_ins = _stand_ins(tables) if learn else {}
    if stand_ins:
        tables["controller"] = {**tables.get("controller", {}), **stand_ins}
    file = replace(_file(tables, path, axis), text=text, changes=tuple(every))
    if not stand_ins:
        return file
    units = replace(file.axis.units, keys=file.axis.units.keys - stand_ins.keys())
    return replace(file, axes=(replace(file.axis, units=units),))


def _file(raw: Mapping[str, Any], path: Path, axis: str | None) -> File:
    """Return the file of its tables."""
    tables = read_tables(raw)
    if tables.robot is not None:
        from jointid.config.robot_file import robot_file

        return robot_file(tables, path, axis)
    if axis is not None:
        raise MethodError(f"{path} is a joint file, which has no axis {axis}; leave --axis out.")
    return joint_file(tables, path)


def _keep_settings(tables: Any, path: list[str], method: str) -> None:
    """Keep the settings of [method] that a method has."""
    for name in path[:-1]:
        tables = tables[int(name) - 1] if name.isdecimal() else tables[name]
    old = tables.get("method", {})
    kept = method_keys(method_of(method)) if method in METHODS else set()
    own = isinstance(old, dict) and old.get("name", method) == method
    tables["method"] = {name: value for name, value in old.items() if name in kept} if own else {}


def _stand_ins(raw: Mapping[str, Any]) -> dict[str, float]:
    """Return 1.0 for each gain that the law of [controller] needs and does not have."""
    given = raw.get("controller", {})
    if "robot" in raw or not isinstance(given, dict) or not isinstance(law := given.get("law", "cascade"), str):
        return {}
    known = {*given, *(gives for name, (gives, *_) in INSTEAD.get(law, {}).items() if name in given)}
    needed = keys_of(LAWS[law]).values() if law in LAWS else ()
    return {one.name: 1.0 for one in needed if one.required and one.type is float and one.name not in known}
