"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.stamps import Stamps, is_stamp
from jointid.records.formats.table import Found, Table, find_columns, require_width
from jointid.records.formats.text import find_encoding, open_text

_LONGEST = 2**28  # bytes of text


def read_json(path: Path) -> Table:
    """Read a list of records, a dictionary of columns, or a record on each line (.jsonl, .ndjson).

    Values within values go by their path, "joint.position" or "q[0]". Instants written as text are seconds since the
    first one, null is NaN; words, true and false are passed over.
    """
    with open_text(path) as file:
        raw = file.read(_LONGEST + 1)
    if len(raw) > _LONGEST:
        raise RecordError(f"{path.name} has more than {_LONGEST} bytes of text; cut it into shorter files.")
    text, found = raw.decode(find_encoding(path, raw), "replace"), Found(path)
    by_lines = path.name.lower().removesuffix(".gz").endswith((".jsonl", ".ndjson"))
    _take(found, "", [json.loads(line) for line in text.split("\n") if line.strip()] if by_lines else json.loads(text))
    return found.table()


def _take(found: Found, name: str, value: Any) -> None:
    """Add the columns of a document by their paths; a list of records is a record of lists."""
    if isinstance(value, dict) and len(value) > 1 and list(value) == [str(row) for row in range(len(value))]:
        value = list(value.values())  # a column of pandas, by its rows
    if isinstance(value, dict):
        for key, member in value.items():
            _take(found, f"{name}.{key}" if name else key, member)
    elif isinstance(value, list) and any(isinstance(one, dict) for one in value):
        columns = dict[str, list[Any]]()
        for row, one in enumerate(value):
            for path, leaf in _leaves(name, one):
                if path not in columns:
                    require_width(found.path, len(columns) + 1)
                    columns[path] = []
                if len(columns[path]) > row:
                    raise RecordError(f"{found.path.name} has two values called {path!r} in a record; rename one.")
                columns[path] += [*[None] * (row - len(columns[path])), leaf]
        for path, cells in columns.items():
            _take_column(found, path, cells + [None] * (len(value) - len(cells)))
    else:
        _take_column(found, name or "value", value)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of a record with their paths."""
    if isinstance(value, dict):
        for key, member in value.items():
            yield from _leaves(f"{name}.{key}" if name else key, member)
    elif isinstance(value, list):
        for place, member in enumerate(value):
            yield from _leaves(f"{name}[{place}]", member)
    else:
        yield name, value


def _take_column(found: Found, name: str, value: Any) -> None:
    cells = np.array(value, dtype=object)
    filled = [cell for cell in cells.flat if cell is not None]
    of_time = bool(filled) and all(isinstance(cell, str) and is_stamp(cell) for cell in filled)
    try:
        if of_time:
            texts = [cell or "" for cell in value]
            array = Stamps.of(texts).seconds(texts)
        elif any(isinstance(cell, str | bool) for cell in filled):
            raise ValueError
        else:
            array = np.where(cells == None, np.nan, cells).astype(np.float64)  # noqa: E711 - each of them
    except (ValueError, TypeError, OverflowError):
        found.passed[name] = "it holds more than numbers, or lists or instants that are not alike"
        return
    if not isinstance(value, list):
        found.take(name, array)
        return
    for column, view in find_columns(name, array, found.passed).items():
        found.add(column, np.array(view), "s" if of_time else "")
