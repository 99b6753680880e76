"""A controller and a parameter as the text of a joint file: what is at its default is left out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from jointid.common.errors import JointFileError, RecordError
from jointid.common.files import write_whole
from jointid.common.parameters import POSITION_UNIT, Parameter
from jointid.common.text import number
from jointid.common.transmission import SIDES, Transmission
from jointid.config.file import File
from jointid.config.toml import edit, move_paths, name_record, relocate_path, replace_table
from jointid.models.controllers import CONTROLLER_UNITS, FILTERS, LAWS, Controller, numbers_of, unit_of_number
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import Joint

_KINDS: Mapping[type, str] = {made: kind for kind, made in FILTERS.items()}
_LAWS: Mapping[type, str] = {made: law for law, made in LAWS.items()}


def parameter_table(parameter: Parameter, model: Parameter) -> dict[str, Any] | float:
    """Return [parameters.name] for a parameter that is `model`'s, changed; a bare number where that is all."""
    bounds = {key: getattr(parameter, key) for key in ("lower", "upper")}
    table = {key: float(value) for key, value in bounds.items() if value != getattr(model, key)}
    if parameter.free:
        return table if parameter.start is None else {"start": float(parameter.start), **table}
    value = float(parameter.start or 0.0)
    return {"value": value, **table} if table else value


def save_with_controller(
    file: File, controller: Controller, path: Path, record: str | os.PathLike[str] | None = None
) -> None:
    """Write a joint file with its [controller] another one; all else of its text, comments too, stays as it is.

    But for the paths of records: in another folder they lead to the same files from there.

    Args:
        file: the joint file.
        controller: what takes the place of the one there.
        path: to write to; a file that is there is replaced.
        record: the record that the file is to name, instead of the one it names.

    Raises:
        JointFileError: the file cannot be written.
    """
    changes = [replace_table(learned_text(file, controller)), move_paths(file.path.parent, path.parent)]
    if record is not None and not file.runs:
        changes.append(name_record(relocate_path(os.fspath(record), Path.cwd(), path.parent)))
    try:
        write_whole(path, edit(file.text, *changes))
    except RecordError as error:
        raise JointFileError(error.faults) from error


def controller_text(
    controller: Controller,
    transmission: Transmission | None = None,
    torque_per_unit: float | None = None,
    joint: Joint | None = None,
    shown: Iterable[DriveNumber] = (),
) -> str:
    """Return the table [controller] of a joint file as TOML.

    Args:
        controller: any of the laws there are.
        transmission: between the joint and the controller, if there is one.
        torque_per_unit: the torque constant of the joint file, which a gain need not say again.
        joint: whose units stand beside the gains, as comments; without it none do.
        shown: how the drive shows the numbers, which stands there, too.

    Raises:
        JointFileError: a joint file has no word for the controller, or for its side of the transmission.
    """
    seen = {"motor": 1.0} if transmission is None else {side: transmission.torque(side) for side in SIDES}
    law, ratio = _LAWS.get(type(controller)), getattr(controller, "ratio", 1.0)
    side = next((side for side, through in seen.items() if through == ratio), None)
    if law is None or side is None:
        raise JointFileError(
            f"A joint file has no word for the controller {type(controller).__name__} behind a ratio of {ratio:g}; "
            f"give a StateSpaceController, and one of the ratios {', '.join(f'{one:g}' for one in seen.values())}."
        )
    gain = getattr(controller, "gain", 1.0)
    through = 1.0 if transmission is None or side == "motor" else abs(transmission.motor_per_load)
    table = {"law": law, **_settings(controller)}
    table = {key: value for key, value in table.items() if key not in ("ratio", "gain")}
    if gain != (1.0 if torque_per_unit is None else torque_per_unit * through):
        table["gain"] = gain
    if side != "motor":
        table["side"] = side
    text = tomlkit.dumps({"controller": table})
    return text if joint is None else _with_units(text, controller, joint, {one.number: one for one in shown})


def learned_text(file: File, controller: Controller) -> str:
    """Return [controller] as TOML for a joint file whose controller was learned: units, and what the drive shows."""
    axis = file.axis
    shown = axis.drive_numbers(controller)
    return controller_text(controller, axis.joint.transmission, axis.torque_per_unit, axis.joint, shown)


def _with_units(text: str, controller: Controller, joint: Joint, shown: Mapping[str, DriveNumber]) -> str:
    """Return the lines of a controller, with units and the drive's numbers as comments."""
    law = numbers_of(controller)

    def name_unit(name: str, value: float) -> str:
        unit = unit_of_number(controller, name, POSITION_UNIT[joint.kind], joint.force_unit)
        there = shown.get(name)
        if there is None or not there.unit:
            return unit
        if there.factor == 1.0 and not (there.inverse or there.per):
            return there.unit
        in_si = "" if CONTROLLER_UNITS in unit else f"{unit}; "
        other = "" if there.name.endswith(name) else f"{there.name} "
        return f"{in_si}{other}{number(there.of(value, law), 4)} {there.unit} in the drive" if value else unit

    units = {f"{name.rpartition('.')[2]} = {value!r}": name_unit(name, value) for name, value in law.items()}
    return "".join(
        f"{line}{f'  # {units[line]}' if units.get(line) else ''}\n" for line in text.rstrip("\n").split("\n")
    )


def _settings(made: Any) -> dict[str, Any]:
    """Return the non-default fields of a dataclass as TOML."""
    found = {}
    for field in fields(made):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        value = _plain(getattr(made, field.name))
        if value is not None and (default is MISSING or value != _plain(default)):
            found[field.name] = value
    return found


def _plain(value: Any) -> Any:
    """Return a value as TOML has it."""
    if type(value) in _KINDS:
        return {"kind": _KINDS[type(value)], **_settings(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, str) else value
