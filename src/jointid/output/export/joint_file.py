"""The joint file with the identified values filled in: what `identify` and `simulate` read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from jointid.common.errors import JointFileError, MethodError
from jointid.common.parameters import Parameter
from jointid.config import File, dumps, loads, with_paths, with_table
from jointid.config.serialise import parameter_table
from jointid.output.export.bodies import Model
from jointid.output.export.joint_model import JointModel, interval, number

_STARTS = "jointid simulate takes these starts."


def joint_file(
    model: Model,
    *,
    file: File | None = None,
    values: Literal["start", "fixed"] = "start",
    folder: Path | None = None,
) -> tuple[str, list[str]]:
    """Return the joint file of an estimate with its values, and a sentence for each value that it does not have.

    Args:
        model: the joint.
        file: the joint file it was identified with; its text, comments too, is kept but for [parameters].
        values: "start": where the next search begins; "fixed": what is kept.
        folder: where it will stand, from which the paths of its records lead to the same files; the same folder where
            None.

    Raises:
        MethodError: there are no such values, there is no joint file to fill in, or it has its numbers on the other
            side.
        JointFileError: the joint file cannot be read any more, or cannot say this.
    """
    assert model.alone is not None
    alone = model.alone
    if values not in ("start", "fixed"):
        raise MethodError(f'The values of a joint file are "start" or "fixed"; received "{values}".')
    file = _require_same_joint(file, alone)
    kept: dict[str, Parameter] = {}  # what the file says something of; what was fixed in it stays as it is
    refused: list[str] = []
    outside: list[str] = []
    for declared, found in zip(file.joint.parameters, alone.parameters, strict=True):
        known, value = file.parameters.get(declared.name, declared), found.value
        if known.free and value is None:
            refused.append(declared.name)
        elif known.free and value is not None and not known.lower <= value <= known.upper:
            outside.append(f"{declared.name}, which is outside its bounds: {interval(found)}")
        elif known.free:
            kept[declared.name] = replace(known, free=values == "start", start=value)
            continue
        if declared.name in file.parameters:
            kept[declared.name] = known
    lost = [f"what the record does not tell: {', '.join(refused)}"] if refused else []
    lost += [*outside, *alone.effects_lost]

    head = [*alone.remarks(lost), *([_STARTS] if values == "start" else [])]
    symbols = {p.name: p for p in file.joint.parameters}
    lines = [f"{name} = {_toml(p, symbols[name])}" for name, p in kept.items()]
    written = "\n".join(["[parameters]", *(f"# {line}" for line in head), *lines, ""])
    before = file.path.parent
    made = with_paths(_fill_in(file, written), before, before if folder is None else folder)
    loads(made)  # which refuses what could not be read again
    return made, lost


def _require_same_joint(file: File | None, model: JointModel) -> File:
    if file is None:
        raise MethodError(
            "A joint file is made from the one the joint was identified with, which has its record and controller; "
            'give it as export(..., "joint-file", file=load(...)).'
        )
    transmission = model.joint.transmission
    if file.joint != model.joint or (transmission is not None and model.side != transmission.side):
        raise MethodError(
            "The joint file is of another joint than the estimate, or of the other side of its transmission; give the "
            "one it was identified with, and leave the side out."
        )
    return file


def _fill_in(file: File, written: str) -> str:
    """Return the file's text with new parameters; written anew if it was loaded with changes, or changed since."""
    try:
        text = with_table(file.path.read_text(encoding="utf-8-sig"), written)
        if replace(loads(text), parameters=file.parameters) == file:
            return text
    except (OSError, JointFileError):  # it is a joint of a robot file, or changed since
        pass
    return with_table(dumps(file), written)


def _toml(parameter: Parameter, model: Parameter) -> str:
    table = parameter_table(parameter, model)
    if not isinstance(table, dict):
        return number(table)
    return f"{{ {', '.join(f'{key} = {number(value)}' for key, value in table.items())} }}"
