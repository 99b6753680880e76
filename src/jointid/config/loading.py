"""Conversion of TOML to joint files and back."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from jointid.common import units
from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.common.files import write_whole
from jointid.common.parameters import POSITION_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.text import show
from jointid.common.transmission import SIDES, Side
from jointid.config import toml
from jointid.config.axis import Axis, build_axis
from jointid.config.declaration import BARE
from jointid.config.file import File
from jointid.config.tables import read_tables
from jointid.config.toml import Tables, edit, move_paths, parse_change, parse_toml, relocate_path, replace_table
from jointid.models.controllers import FILTERS, LAWS, Controller, numbers_of, unit_of_number
from jointid.records.inspection import Inspection

_WORDS: Mapping[type, dict[str, str]] = {
    **{made: {"kind": kind} for kind, made in FILTERS.items()},
    **{made: {"law": law} for law, made in LAWS.items()},
}
"""Key and value that select the class of a table."""

_OF_AXIS = re.compile(r"^(\s*joint\.|(?=\s*method[.=]))")
"""Start of a change that applies to one joint taken from a robot file."""

_ASKED = """
[joint]
kind = "{kind}"
# Not in the log: remove the marks of what the axis has, and replace the question marks by its numbers.
# model = "flexible"                  # two inertias joined by a spring; without it "rigid", one inertia
# torque_constant = "? N m/A"         # of the motor; without it a torque in A gives all values per A
# [transmission]                      # then a channel of the load, not the motor, has side = "load"
# {through}
# [controller]
# law = "{law}"
# position_gain = "? 1/s"             # of a pd "? N m/rad"
# velocity_gain = "? N m s/rad"       # or "? A s/rad"; of a pd derivative_gain
# integral_time = "? ms"              # of a pd none
# velocity_filter = {{ kind = "first_order", time_constant = "? ms" }}
"""


def load(path: str | os.PathLike[str], changes: Iterable[str] = (), *, axis: str | None = None) -> File:
    """Load and check a joint file or a robot file (table [robot]).

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before the check, each as ``method.frequency=30``.
        axis: a joint of a robot file, to be returned as a joint file with the other joints at rest. It has its own
            `method` and `gravity`. Changes of [method] and [joint] then apply to this joint.

    Raises:
        JointFileError: the file, or a robot's model, cannot be read, is no TOML, or has faults;
            `faults` has a sentence for each.
        MethodError: the robot has no such joint.
        JointidError: MuJoCo, which reads the model of a robot, is not installed.
    """
    return _load(toml.read_text(Path(path)), Path(path), changes, axis=axis)


def loads(text: str, folder: str | os.PathLike[str] = ".", changes: Iterable[str] = (), **choices: Any) -> File:
    """Load a joint file or robot file from its text; see `load`.

    Args:
        text: TOML.
        folder: base of relative paths of the record and of a robot's model.
        changes: see `load`.
        choices: further arguments of `load`.
    """
    return _load(text, Path(folder) / "joint.toml", changes, **choices)


def dumps(file: File) -> str:
    """Return a loaded file with its changes as TOML; inverse of `loads`."""
    return edit(file.text, *file.changes)


def _load(text: str, path: Path, changes: Iterable[str] = (), *, axis: str | None = None) -> File:
    raw = parse_toml(text)
    made = tuple(parse_change(_name_axis(change, raw, axis)) for change in changes)
    for change in made:
        change(raw)
    file, axes = read_tables(raw)
    shared = {"filtering": file["filtering"], "path": path, "text": text, "changes": made}
    if file["robot"] is not None:
        from jointid.config.robot_file import build_joint_of_robot, build_robot

        if axis is None:
            return File(**build_robot(file, axes, path.parent), runs=file["records"], **shared)
        alone, method = build_joint_of_robot(file, axes, path.parent, axis)
    elif axis is not None:
        raise MethodError(f"{path} is a joint file, which has no axis {axis}; leave --axis out.")
    else:
        alone, method = build_axis(axes[0], axes[0]["kind"], file["method"])
        shared |= {"runs": file["records"], "together": file["together"]}
    return File(axes=(alone,), method=method, parameters=alone.parameters, name=alone.name, **shared)


def _name_axis(change: str, raw: Mapping[str, Any], axis: str | None) -> str:
    """Address a change to the joint taken from a robot file."""
    joints = raw.get("joints")
    names = [one.get("name") for one in joints if isinstance(one, dict)] if isinstance(joints, list) else []
    return _OF_AXIS.sub(f"joints.{names.index(axis) + 1}.", change, count=1) if axis in names else change


def parameter_table(parameter: Parameter, model: Parameter) -> dict[str, Any] | float:
    """Return [parameters.name] for a changed parameter; a bare number if possible."""
    bounds = {key: getattr(parameter, key) for key in ("lower", "upper")}
    table = {key: float(value) for key, value in bounds.items() if value != getattr(model, key)}
    if parameter.free:
        return table if parameter.start is None else {"start": float(parameter.start), **table}
    value = float(parameter.start or 0.0)
    return {"value": value, **table} if table else value


def save_with_controller(
    file: File, controller: Controller, path: Path, record: str | os.PathLike[str] | None = None
) -> None:
    """Write a joint file with its [controller] replaced, the rest kept.

    Comments are kept. Relative paths of records are adapted to the new folder. A given record replaces the
    declared one.

    Raises:
        RecordError: the file cannot be written.
    """

    def name(tables: Tables) -> None:
        if record is not None and not file.runs:
            place = relocate_path(os.fspath(record), Path.cwd(), path.parent)
            tables.setdefault("record", {})["file"] = place

    changes = replace_table(controller_text(controller, file.axis)), move_paths(file.path.parent, path.parent), name
    write_whole(path, edit(file.text, *changes))


def controller_text(controller: Controller, axis: Axis | None = None) -> str:
    """Return the table [controller] of a class in `LAWS` as TOML.

    The transmission and the torque constant of the file's axis are not repeated, and units are comments.

    Raises:
        JointFileError: a joint file cannot express the controller, or its side of the transmission.
    """
    gear = None if axis is None else axis.joint.transmission
    seen: dict[Side, float] = {"motor": 1.0} if gear is None else {side: gear.torque(side) for side in SIDES}
    ratio = getattr(controller, "ratio", 1.0)
    side = next((side for side, through in seen.items() if through == ratio), None)
    if "law" not in _WORDS.get(type(controller), {}) or side is None:
        raise JointFileError(
            f"A joint file has no word for the controller {type(controller).__name__} behind a ratio of {ratio:g}; "
            f"give a cascade, a PD or a PID, of one of the ratios {', '.join(f'{one:g}' for one in seen.values())}."
        )
    table = {key: value for key, value in _plain(controller).items() if key not in ("ratio", "gain", "output")}
    plain = 1.0 if axis is None else replace(axis.units, side=side).plain_gain
    if (gain := getattr(controller, "gain", 1.0)) != plain:
        table["gain"] = gain
    if side != "motor":
        table["side"] = side
    text = tomlkit.dumps({"controller": table})
    if axis is None:
        return text
    force, position = axis.joint.force_unit, POSITION_UNIT[axis.joint.kind]
    names = {f"{name.rpartition('.')[2]} = {value!r}": name for name, value in numbers_of(controller).items()}
    units = {line: unit_of_number(controller, name, position, force) for line, name in names.items()}
    return "".join(f"{line}  # {unit}\n" if (unit := units.get(line)) else f"{line}\n" for line in text.splitlines())


def _plain(value: Any) -> Any:
    """Convert a value to TOML types; omit defaults of filters and controllers."""
    if type(value) in _WORDS:
        found: dict[str, Any] = {**_WORDS[type(value)]}
        for one in settings_of(type(value)):  # type: ignore[arg-type]
            plain, key = _plain(getattr(value, one.name)), (one.name, one.unit)
            if plain is not None and (one.required or plain != _plain(one.default)):
                found[one.name] = f"{plain!r} {one.unit}" if key in BARE and plain > BARE[key][0] else plain
        return found
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def describe_log(found: Inspection, file: str, axis: str | None, proposed: Mapping[str, str | None]) -> str:
    """Draft a joint file for an inspected log, with comments on unknown data.

    `file` is the log's path from the joint file's folder, `axis` the number or name of one of several. `proposed` are
    the columns of channels where no profile knows them, None if unknown.
    """
    log, said = found.recognised, {units.normalise_unit(one.unit or "") for one in found.channels}
    slides = not said.isdisjoint(units.units_of("length")) and said.isdisjoint(units.units_of("angle"))
    if log is None:
        names = ", ".join(show(channel.name) for channel in found.channels)
        about, law = f"# No profile of a drive knows these columns: {names}.\n\n", "cascade"
        text = tomlkit.dumps({"record": {"file": file}}) + "\n[record.channels]\n"
        for name, column in proposed.items():
            text += f"{'' if column else '# '}{name} = {{ column = {tomlkit.item(column or '?').as_string()} }}\n"
    else:
        named = [one for one in log.axes if axis in (None, one.name, str(one.place.get("axis")))]
        if len(named) != 1:
            raise RecordError(f"{found.file} has the axes {', '.join(show(one.name) for one in log.axes)}: name one.")
        channels, place = named[0].channels, {key: one for key, one in named[0].place.items() if key != "index"}
        record = {"file": file, **_clock(found, {*channels.values()})}
        seen: Any = (column := proposed.get("torque")) and {"channels": {"torque": {"column": column}}}
        record |= {} if "torque" in channels else seen or {"torque": "from_controller"}
        about = "".join(f"# {line}\n" for line in (log.sentence, *log.profile.assumed)) + "\n"
        law = log.profile.law or "cascade"
        text = tomlkit.dumps({"record": record, "drive": {"profile": log.profile.name, **place}})
    kind, through = ("prismatic", 'lead = "? mm"') if slides else ("revolute", "ratio = ?")
    return f"{about}{text}{_ASKED.format(kind=kind, through=through, law=law)}"


def _clock(found: Inspection, read: Collection[str]) -> dict[str, Any]:
    """Return the keys of [record] for several or restarting clocks of the columns to read."""
    times = {one.time: one.sample_time for one in found.channels if one.name in read and one.time and one.sample_time}
    if len(times) > 1:
        return {"resample": {"sample_time": float(f"{min(times.values()):.3g}"), "method": "linear"}}
    return {"part": 0} if any(one.stalls for one in found.channels if one.name in times) else {}
