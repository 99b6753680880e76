"""Joint file with identified values, as `identify` and `simulate` read it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from jointid.common.errors import MethodError
from jointid.config import File, dumps, edit, loads, move_paths, replace_table
from jointid.config.loading import parameter_table
from jointid.output.export.bodies import Model
from jointid.output.export.joint_model import number


def joint_file(
    model: Model,
    *,
    file: File | None = None,
    values: Literal["start", "fixed"] = "start",
    folder: Path | None = None,
) -> tuple[str, list[str]]:
    """Joint file of an estimate, and a sentence per missing value.

    Args:
        model: the joint.
        file: the joint file it was identified with; its text, comments too, is kept but for [parameters].
        values: "start", for the next search, or "fixed".
        folder: where it will stand; the paths of its records are changed accordingly. None: the same folder.

    Raises:
        MethodError: there are no such values, there is no joint file to fill in, or it has its numbers on the other
            side.
        JointFileError: the joint file cannot be read any more, or cannot express this.
    """
    assert model.alone is not None
    alone, gear = model.alone, model.alone.joint.transmission
    if values not in ("start", "fixed"):
        raise MethodError(f'The values of a joint file are "start" or "fixed"; received "{values}".')
    if file is None or file.joint != alone.joint or (gear is not None and alone.side != gear.side):
        raise MethodError(
            "A joint file is made from the one the joint was identified with; give that one, as "
            'export(..., "joint-file", file=load(...)), and leave the side out.'
        )
    refused, outside, lines = list[str](), list[str](), list[str]()
    for declared, found in zip(file.joint.parameters, alone.parameters, strict=True):
        known, value = file.parameters.get(declared.name, declared), found.value
        stated = declared.name in file.parameters  # what was fixed in it stays as it is
        if known.free and value is None:
            refused.append(declared.name)
        elif known.free and value is not None and not known.lower <= value <= known.upper:
            outside.append(f"{declared.name}, which is outside its bounds: {found} {found.unit}")
        elif known.free:
            known, stated = replace(known, free=values == "start", start=value), True
        if stated:
            lines.append(f"{declared.name} = {_toml(parameter_table(known, declared))}")
    lost = [f"what the record does not show: {', '.join(refused)}"] * bool(refused) + outside
    written = "\n".join(["[parameters]", *(f"# {line}" for line in alone.remarks(lost)), *lines, ""])
    before = file.path.parent
    made = edit(dumps(file), replace_table(written), move_paths(before, before if folder is None else folder))
    loads(made)  # which refuses what could not be read again
    return made, lost


def _toml(table: dict[str, float] | float) -> str:
    if not isinstance(table, dict):
        return number(table)
    return f"{{ {', '.join(f'{key} = {number(value)}' for key, value in table.items())} }}"
