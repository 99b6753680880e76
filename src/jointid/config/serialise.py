"""A controller and a parameter as the text of a joint file: what is at its default is left out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from jointid.common.errors import JointFileError, RecordError
from jointid.common.files import write_whole
from jointid.common.parameters import POSITION_UNIT, Parameter
from jointid.common.transmission import SIDES
from jointid.config.axis import Axis
from jointid.config.file import File
from jointid.config.toml import edit, move_paths, name_record, relocate_path, replace_table
from jointid.models.controllers import FILTERS, LAWS, Controller, numbers_of, unit_of_number

_WORDS: Mapping[type, dict[str, str]] = {
    **{made: {"kind": kind} for kind, made in FILTERS.items()},
    **{made: {"law": law} for law, made in LAWS.items()},
}
"""What says of a table of which class it is."""


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
    changes = [replace_table(controller_text(controller, file.axis)), move_paths(file.path.parent, path.parent)]
    if record is not None and not file.runs:
        changes.append(name_record(relocate_path(os.fspath(record), Path.cwd(), path.parent)))
    try:
        write_whole(path, edit(file.text, *changes))
    except RecordError as error:
        raise JointFileError(error.faults) from error


def controller_text(controller: Controller, axis: Axis | None = None) -> str:
    """Return the table [controller] of a joint file as TOML.

    Args:
        controller: any of the laws there are.
        axis: of the file, whose transmission and torque constant the law need not say again, and in whose units its
            numbers are: these stand beside them as comments.

    Raises:
        JointFileError: a joint file has no word for the controller, or for its side of the transmission.
    """
    gear = None if axis is None else axis.joint.transmission
    seen = {"motor": 1.0} if gear is None else {side: gear.torque(side) for side in SIDES}
    ratio = getattr(controller, "ratio", 1.0)
    side = next((side for side, through in seen.items() if through == ratio), None)
    if "law" not in _WORDS.get(type(controller), {}) or side is None:
        raise JointFileError(
            f"A joint file has no word for the controller {type(controller).__name__} behind a ratio of {ratio:g}; "
            f"give a StateSpaceController, and one of the ratios {', '.join(f'{one:g}' for one in seen.values())}."
        )
    table = {key: value for key, value in _plain(controller).items() if key not in ("ratio", "gain")}
    through = 1.0 if gear is None or side == "motor" else abs(gear.motor_per_load)
    constant = None if axis is None else axis.units.constant
    if (gain := getattr(controller, "gain", 1.0)) != (1.0 if constant is None else constant * through):
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
    """Return a value as TOML has it; of a filter or a controller what is not at its default."""
    if type(value) in _WORDS:
        found: dict[str, Any] = {**_WORDS[type(value)]}
        for field in fields(value):
            default = field.default if field.default_factory is MISSING else field.default_factory()
            plain = _plain(getattr(value, field.name))
            if plain is not None and (default is MISSING or plain != _plain(default)):
                found[field.name] = plain
        return found
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, str) else value
