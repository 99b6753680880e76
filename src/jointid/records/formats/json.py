"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

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
    _take(found, "", _parse(path), 0)
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


def _take(found: Found, name: str, value: Any, depth: int) -> None:
    """Add the values of a document by their paths; a list of records is a record of lists."""
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
        _take_leaf(found, name or "value", value, filled)
    for path, member in members.items():
        _take(found, path, member, depth + 1)


def _take_leaf(found: Found, name: str, value: Any, filled: list[Any]) -> None:
    of_time = bool(filled) and all(isinstance(one, str) and is_stamp(one) for one in filled)
    try:
        if of_time:
            cells = [one or "" for one in value]
            array = Stamps.of(cells).seconds(cells)
        else:
            objects = np.array(value, dtype=object)
            if any(isinstance(cell, str | bool) for cell in objects.flat):
                raise ValueError
            array = np.where(objects == None, np.nan, objects).astype(np.float64)  # noqa: E711 - each of them
    except (ValueError, TypeError, OverflowError):
        found.passed[name] = "it holds more than numbers, or lists or instants that are not alike"
        return
    if not isinstance(value, list):
        found.take(name, array)
        return
    for column, view in find_columns(name, array, found.passed).items():
        found.add(column, np.array(view), "s" if of_time else "")
