"""From TOML to a joint file and back."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jointid.common.errors import MethodError
from jointid.config.axis import build_axis
from jointid.config.file import File, file_of_axis
from jointid.config.tables import read_tables
from jointid.config.toml import edit, parse_change, parse_toml, read_text

_OF_AXIS = re.compile(r"^(\s*joint\.|(?=\s*method[.=]))")
"""Begins a change that is of a joint alone, where one is taken from a robot file."""


def load(
    path: str | os.PathLike[str], changes: Iterable[str] = (), *, axis: str | None = None, learn: bool = False
) -> File:
    """Load a joint file, or a robot file, which has the table [robot]; it is checked before anything runs.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``method.frequency=30``.
        axis: the joint of a robot file that is returned as a joint file, as if no other joint moved: with its own
            `method` and `gravity`. Changes of [method] and [joint] are then of this joint.
        learn: whether the gains of the controller, or all of it, may be missing; a missing gain is 1.

    Raises:
        JointFileError: the file, or the model of a robot that it names, cannot be read, is no TOML, or has faults;
            `faults` has a sentence for each.
        MethodError: the robot has no such joint.
        ExtraError: MuJoCo, which reads the model of a robot, is not installed.
    """
    return _load(read_text(Path(path)), Path(path), changes, axis, learn)


def loads(
    text: str,
    folder: str | os.PathLike[str] = ".",
    changes: Iterable[str] = (),
    *,
    axis: str | None = None,
    learn: bool = False,
) -> File:
    """Load a joint file, or a robot file, from its text; see `load`.

    Args:
        text: TOML.
        folder: from which the paths of the record and of a robot's model are taken.
        changes: as of `load`.
        axis: as of `load`.
        learn: as of `load`.
    """
    return _load(text, Path(folder) / "joint.toml", changes, axis, learn)


def dumps(file: File) -> str:
    """Return a joint file or a robot file as TOML, with the changes with which it was loaded; `loads` gives it back."""
    return edit(file.text, *file.changes)


def _load(text: str, path: Path, changes: Iterable[str], axis: str | None, learn: bool) -> File:
    raw = parse_toml(text)
    made = tuple(parse_change(_name_axis(change, raw, axis)) for change in changes)
    for change in made:
        change(raw)
    if learn and "robot" not in raw:
        raw.setdefault("controller", {})
    tables = read_tables(raw, learn=learn)
    if tables.robot is not None:
        from jointid.config.robot_file import robot_file

        file = robot_file(tables, path, axis)
    elif axis is not None:
        raise MethodError(f"{path} is a joint file, which has no axis {axis}; leave --axis out.")
    else:
        kind = tables.axes[0].kind
        assert kind is not None
        file = file_of_axis(tables, *build_axis(tables, 0, kind, tables.method, tables.columns, tables.drive), path)
    return replace(file, text=text, changes=made)


def _name_axis(change: str, raw: Mapping[str, Any], axis: str | None) -> str:
    """Return a change as one of the joint of a robot file that is taken alone."""
    joints = raw.get("joints")
    names = [one.get("name") for one in joints if isinstance(one, dict)] if isinstance(joints, list) else []
    return _OF_AXIS.sub(f"joints.{names.index(axis) + 1}.", change, count=1) if axis in names else change
