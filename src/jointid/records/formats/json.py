"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.records.formats.stamps import Stamps, is_stamp
from jointid.records.formats.table import Found, Table, find_columns
from jointid.records.formats.text import find_encoding, open_text

_LONGEST = 2**28  # bytes of text
_DEEPEST = 64  # values within values


def read_json(path: Path) -> Table:
    """Read a list of records, a dictionary of columns, or a record on each line (.jsonl, .ndjson).

    Values within values go by their path, "joint.position" or "q[0]". Instants written as text are seconds since the
    first one, null is NaN; words, true and false are passed over.
    """
    found = Found(path)
    for name, value in _walk("", _parse(path)):
        array = _to_array(value)
        if isinstance(array, str):
            found.passed[name or "value"] = array
        elif isinstance(value, list):
            of_time = any(isinstance(cell, str) for cell in value)
            for column, view in find_columns(name or "value", array, found.passed).items():
                found.add(column, np.array(view), "s" if of_time else "")
        else:
            found.take(name or "value", array)
    return found.table()


def _parse(path: Path) -> Any:
    with open_text(path) as file:
        raw = file.read(_LONGEST + 1)
    if len(raw) > _LONGEST:
        raise RecordError(f"{path.name} has more than {_LONGEST} bytes of text; cut it into shorter files.")
    text, name = raw.decode(find_encoding(path, raw), "replace"), path.name.lower().removesuffix(".gz")
    try:
        if name.endswith((".jsonl", ".ndjson")):
            return [json.loads(line) for line in text.split("\n") if line.strip()]
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path.name} is no JSON ({short(str(error))}); log or copy it again.") from None


def _walk(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the values of a document with their paths; a list of records is a record of lists."""
    if depth > _DEEPEST:
        raise ValueError("values within values without end")
    if isinstance(value, dict) and len(value) > 1 and list(value) == [str(row) for row in range(len(value))]:
        value = list(value.values())  # a column of pandas, by its rows
    members: dict[str, Any] = {}
    filled = [one for one in value if one is not None] if isinstance(value, list) else []
    if isinstance(value, dict):
        members = {f"{name}.{key}" if name else key: member for key, member in value.items()}
    elif filled and all(isinstance(one, dict) for one in filled):
        for key in dict.fromkeys(key for one in filled for key in one):
            members[f"{name}.{key}" if name else key] = [None if one is None else one.get(key) for one in value]
    elif filled and all(isinstance(one, list) and one and isinstance(one[0], dict) for one in filled):
        for place in range(max(map(len, filled))):  # of records in each record, as of the motors of a robot
            cells = [None if one is None or place >= len(one) else one[place] for one in value]
            members[f"{name}[{place}]"] = cells
    else:
        yield name, value
    for key, member in members.items():
        yield from _walk(key, member, depth + 1)


def _to_array(value: Any) -> FloatArray | str:
    """Return a value or a list as numbers, or why it has none."""
    filled = [one for one in value if one is not None] if isinstance(value, list) else []
    try:
        if filled and all(isinstance(one, str) and is_stamp(one) for one in filled):
            cells = [one or "" for one in value]
            return Stamps.of(cells).seconds(cells)
        array = np.array(value, dtype=object)
        for cell in array.flat:
            if isinstance(cell, str | bool):
                return f"it holds {short(json.dumps(cell))}, which is no number"
        return np.where(array == None, np.nan, array).astype(np.float64)  # noqa: E711 - each of them
    except (ValueError, TypeError, OverflowError):
        return "its lists or its instants are not alike, or it holds more than numbers"
