"""From TOML to a joint file and back."""

from __future__ import annotations

import copy
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomlkit

from jointid.common.errors import JointFileError, MethodError
from jointid.common.settings import settings_of
from jointid.config.axis_units import keys_of_controller, table_at, translate_gains
from jointid.config.building import declare_joint, joint_file, robot_method
from jointid.config.declaration import TIMES, read_tables
from jointid.config.file import File
from jointid.config.rules import choose_method
from jointid.config.toml import apply_changes, parse_toml, read_text
from jointid.models.controllers import LAWS

_MOST = 1000  # keys of a table, records of a file


def load(
    path: str | os.PathLike[str],
    changes: Iterable[str] = (),
    *,
    axis: str | None = None,
    method: str | None = None,
    filtering: str | None = None,
    friction: str | None = None,
) -> File:
    """Load a joint file, or a robot file, which has the table [robot]; it is checked completely.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``method.frequency=30``.
        axis: the joint of a robot file that is returned as a joint file, as if no other joint moved: with its own
            `method` and `gravity`, and with its numbers as starts. Changes of [method] are then of its own method.
        method: its name, whatever the file and the changes say; another one than the file's comes with its default
            settings.
        filtering: a preset, likewise.
        friction: the name of a law, likewise, of a robot for every joint.

    Raises:
        JointFileError: the file, or the model of a robot that it names, cannot be read, is no TOML, or has faults;
            `faults` has a sentence for each.
        ExtraError: MuJoCo, which reads the model of a robot, is not installed.
    """
    path = Path(path)
    choices = {"method": method, "filtering": filtering, "friction": friction}
    return _file(parse_toml(read_text(path)), path, changes, axis, **choices)


def load_joint(
    path: str | os.PathLike[str],
    changes: Iterable[str] = (),
    *,
    what: str = "This work",
    axis: str | None = None,
    **choices: str | None,
) -> File:
    """Load a joint file, or one joint of a robot file, for work on a single joint.

    Args:
        path: as of `load`.
        changes: as of `load`.
        what: the work, the beginning of the sentence.
        axis: as of `load`.
        choices: `method`, `filtering` and `friction`, as of `load`.

    Raises:
        JointFileError: see `load`.
        MethodError: it is a robot file, and no axis is named.
    """
    path = Path(path)
    if axis is None and "robot" in parse_toml(read_text(path)):  # before the changes and choices of one joint
        raise _robot_error(path, what)
    return require_joint(load(path, changes, axis=axis, **choices), what)


def require_joint(file: File, what: str) -> File:
    """Return a file that is a joint's.

    Args:
        file: as `load` returns it.
        what: the work that is not done with a robot, the beginning of the sentence.

    Raises:
        MethodError: it is a robot file.
    """
    if file.robot is None:
        return file
    raise _robot_error(file.path, what)


def _robot_error(path: Path, what: str) -> MethodError:
    return MethodError(f"{what} takes one joint, and {path} is a robot file; name one of its joints by --axis.")


def load_to_learn(path: str | os.PathLike[str], changes: Iterable[str] = (), axis: str | None = None) -> File:
    """Load a joint file whose controller, or gains, may be missing, to learn them.

    The keys of [controller], such as the gain of the drive's chain, are kept; a missing gain of the loop is 1.

    Args:
        path: as of `load`.
        changes: as of `load`.
        axis: as of `load`; the gains of a robot's controllers need to be there.

    Raises:
        JointFileError: see `load`.
    """
    path, changes = Path(path), list(changes)
    if axis is not None:
        return load_joint(path, changes, what="Learning a controller", axis=axis)
    raw = parse_toml(read_text(path))
    tables = apply_changes(raw, changes)
    said = table_at(tables, "controller")
    if "robot" in tables or not isinstance(tables.get("controller", {}), dict):
        return require_joint(_file(raw, path, changes), "Learning a controller")
    law = said.get("law", "cascade")
    kind: Any = LAWS.get(law) if isinstance(law, str) else None  # mypy does not take a type for something with a hash
    required = [one for one in settings_of(kind) if one.required] if kind else []
    written = keys_of_controller(tables)
    known = written | {TIMES[key][0] for key in written if key in TIMES}
    stand_ins = [f"controller.{one.name}=1.0" for one in required if one.type is float and one.name not in known]
    law_said = ["controller.law=cascade"] if law == "cascade" else []
    file = file_of(apply_changes(raw, [*law_said, *stand_ins, *changes]), path)
    return replace(file, axes=(replace(file.axis, said=known.intersection(file.axis.said)),))


def loads(text: str, folder: str | os.PathLike[str] = ".", changes: Iterable[str] = (), **choices: str | None) -> File:
    """Load a joint file, or a robot file, from its text; see `load`.

    Args:
        text: TOML.
        folder: from which the paths of the record and of a robot's model are taken.
        changes: as of `load`.
        choices: `method`, `filtering` and `friction`, as of `load`.
    """
    return _file(parse_toml(text), Path(folder) / "joint.toml", changes, **choices)


def _file(
    tables: Mapping[str, Any],
    path: Path,
    changes: Iterable[str] = (),
    axis: str | None = None,
    method: str | None = None,
    filtering: str | None = None,
    friction: str | None = None,
) -> File:
    """Return the file of some tables with changes; see `load`."""
    changes = list(changes)
    number = None if axis is None else _number_of(tables, axis)
    if number is not None:
        (tables, changes), method = _with_method_of_axis(tables, changes, number, method), None
    changed = apply_changes(tables, changes)
    is_robot = "robot" in changed
    # A change may bring the controller by which the file's own method is known, but not that method's name.
    if method is not None and method != _method_name(changed | {"method": tables.get("method", {})}):
        tables = {**tables, "method": {"name": method}}
    if filtering is not None:
        tables = {**tables, "filtering": {"preset": filtering}}
    joints = changed.get("joints")
    count = len(joints) if isinstance(joints, list) else 0
    laws = [f"joints.{k + 1}.friction" for k in range(count)] if is_robot else ["joint.friction"]
    chosen = [("method.name", method), ("filtering.preset", filtering), *((key, friction) for key in laws)]
    last = [f"{key}={json.dumps(choice)}" for key, choice in chosen if choice is not None]
    return file_of(apply_changes(tables, [*changes, *last]), path, axis)


def file_of(tables: Mapping[str, Any], path: Path = Path("joint.toml"), axis: str | None = None) -> File:
    """Return the file of some tables.

    Args:
        tables: by name, as `tomllib` reads them.
        path: of the file.
        axis: as of `load`.

    Raises:
        JointFileError: with one sentence for each fault, of the file or of the model that it names.
    """
    if crowded := list(_size_faults(tables)):  # each of so many would be a sentence
        raise JointFileError(crowded)
    raw = translate_gains(tables)
    said = read_tables(raw)
    if said.robot is not None:
        from jointid.config.robot_file import robot_file

        return replace(robot_file(said, raw, path, axis), tables=tables)
    if axis is not None:
        raise MethodError(f"{path} is a joint file, which has no axis {axis}; leave --axis out.")
    return replace(joint_file(declare_joint(said, raw), path), tables=tables)


def _size_faults(raw: Mapping[str, Any], where: str = "The joint file") -> Iterator[str]:
    """Yield tables with too many keys, and lists with too many tables."""
    if len(raw) > _MOST:
        yield f"{where} has {len(raw)} keys; expected at most {_MOST}: is it another kind of file?"
        return
    for key, value in raw.items():
        if isinstance(value, dict):
            yield from _size_faults(value, key)
        elif isinstance(value, list) and len(value) > _MOST and isinstance(value[0], dict):
            yield f"{key} lists {len(value)} tables; expected at most {_MOST}: split the joint file."


def _number_of(tables: Mapping[str, Any], axis: str) -> int | None:
    """Return the number of an axis, from 0; None where the tables have none of that name."""
    joints = tables.get("joints")
    names = [one.get("name") for one in joints if isinstance(one, dict)] if isinstance(joints, list) else []
    return names.index(axis) if "robot" in tables and axis in names else None


def _with_method_of_axis(
    tables: Mapping[str, Any], changes: list[str], number: int, method: str | None
) -> tuple[Mapping[str, Any], list[str]]:
    """Return tables and changes with [method] moved to one axis; another method has its default settings."""
    below, tables = f"joints.{number + 1}.", copy.deepcopy(dict(tables))
    changes = [f"{below}{one}" if re.match(r"method[.=]", one) else one for one in changes]
    if method is None:
        return tables, changes
    own = tables["joints"][number]
    if not isinstance(own.get("method"), dict) or own["method"].get("name") != method:
        own["method"] = {"name": method}
    return tables, [*changes, f'{below}method.name="{method}"']


def _method_name(tables: Mapping[str, Any]) -> str | None:
    """Return the file's method, or the default one; None of a file with faults."""
    try:
        raw = translate_gains(tables)
        said = read_tables(raw)
        return choose_method(declare_joint(said, raw)) if said.robot is None else robot_method(said)
    except JointFileError:
        return None


def dumps(file: File) -> str:
    """Return a joint file or a robot file as TOML; `loads` gives it back.

    Without its comments, and with the changes with which it was loaded.
    """
    return tomlkit.dumps(file.tables)
