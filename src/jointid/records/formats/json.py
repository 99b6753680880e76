"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.records.formats.arrays import find_columns
from jointid.records.formats.stamps import Stamps, is_stamp
from jointid.records.formats.table import WIDEST, Table, describe_skips, require_unique_names
from jointid.records.formats.text import decode, read_bytes

_LONGEST = 2**28  # bytes of text
_DEEPEST = 64  # values within values


@dataclass(frozen=True, slots=True)
class Json:
    """JSON of records or of columns; .jsonl and .ndjson have a record on each line.

    Values within values go by their path, "joint.position" or "q[0]". The samples of a matrix run along its longer
    side. Instants written as text are seconds since the first one, null is NaN; words, true and false are passed over.
    """

    name: ClassVar[str] = "JSON"
    suffixes: ClassVar[tuple[str, ...]] = (".json", ".jsonl", ".ndjson")

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        columns, scalars = list[tuple[str, FloatArray]](), list[tuple[str, float]]()
        passed, units = dict[str, str](), dict[str, str]()
        for name, value in _walk(path, "", _parse(path)):
            array, found = _to_array(value), dict[str, FloatArray]()
            if isinstance(array, str):
                passed[name or "value"] = array
            elif isinstance(value, list):
                find_columns(name or "value", array, found, passed)
                columns += found.items()
                if any(isinstance(cell, str) for cell in value):
                    units[name or "value"] = "s"
            else:
                scalars.append((name or "value", float(array)))
        require_unique_names(path, [name for name, _ in (*columns, *scalars)])
        if len(columns) > WIDEST:
            raise RecordError(f"{path.name} has more than {WIDEST} columns; log fewer channels.")
        if not (columns or scalars):
            raise RecordError(
                f"{path.name} holds no numbers{describe_skips(passed)}; expected a list of records, a dictionary "
                "of columns, or a record on each line."
            )
        return Table(dict(columns), dict(scalars), path.name, units, passed)


def _parse(path: Path) -> Any:
    text, name = decode(path, read_bytes(path, _LONGEST)), path.name.lower().removesuffix(".gz")
    try:
        if name.endswith((".jsonl", ".ndjson")):
            return [json.loads(line) for line in text.split("\n") if line.strip()]
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path.name} is no JSON ({short(str(error))}); log or copy it again.") from None


def _walk(path: Path, name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the values of a document with their paths; a list of records is a record of lists."""
    if depth > _DEEPEST:
        raise RecordError(
            f"{path.name} holds values within values, more than {_DEEPEST} deep; log records or columns of numbers."
        )
    if isinstance(value, dict) and len(value) > 1 and list(value) == [str(row) for row in range(len(value))]:
        value = list(value.values())  # a column of pandas, by its rows
    members: list[tuple[str, Any]] = []
    filled = [one for one in value if one is not None] if isinstance(value, list) else []
    if isinstance(value, dict):
        members = [(f"{name}.{key}" if name else key, member) for key, member in value.items()]
    elif filled and all(isinstance(one, dict) for one in filled):
        for key in dict.fromkeys(key for one in filled for key in one):
            cells = [None if one is None else one.get(key) for one in value]
            members.append((f"{name}.{key}" if name else key, cells))
    elif filled and all(isinstance(one, list) and one and isinstance(one[0], dict) for one in filled):
        for place in range(max(map(len, filled))):  # of records in each record, as of the motors of a robot
            cells = [None if one is None or place >= len(one) else one[place] for one in value]
            members.append((f"{name}[{place}]", cells))
    else:
        yield name, value
    for key, member in members:
        yield from _walk(path, key, member, depth + 1)


def _to_array(value: Any) -> FloatArray | str:
    """Return a value or a list as numbers, or why it has none."""
    filled = [one for one in value if one is not None] if isinstance(value, list) else []
    if filled and all(isinstance(one, str) and is_stamp(one) for one in filled):
        cells = [one or "" for one in value]
        try:
            return Stamps.of(cells).seconds(cells)
        except ValueError:
            return "its instants are not written alike"
    try:
        array = np.array(value, dtype=object)
        for cell in array.flat:
            if isinstance(cell, str | bool):
                return f"it holds {short(json.dumps(cell))}, which is no number"
        return np.where(array == None, np.nan, array).astype(np.float64)  # noqa: E711 - each of them
    except (ValueError, TypeError, OverflowError):
        return "its lists differ in length, or hold more than numbers"
