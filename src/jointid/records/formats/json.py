"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.stamps import find_stamps, is_stamp
from jointid.records.formats.table import Table, require_room
from jointid.records.formats.text import open_text

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
    table = Table(source=path.name)
    if path.name.lower().removesuffix(".gz").endswith((".jsonl", ".ndjson")):
        _take_rows(table, "", (json.loads(line) for line in raw.split(b"\n") if line.strip()))
    else:
        _take(table, "", json.loads(raw))
    return table


def _take(table: Table, name: str, value: Any) -> None:
    """Add the columns of a document by their paths; a list of records is a record of lists."""
    match value:
        case dict():
            for key, member in value.items():
                _take(table, f"{name}.{key}" if name else key, member)
        case list() if any(type(one) is dict for one in value):
            _take_rows(table, name, value)
        case _:
            _take_cells(table, name or "value", value)


def _take_rows(table: Table, name: str, rows: Iterable[Any]) -> None:
    columns, count = dict[str, list[Any]](), 0
    for count, one in enumerate(rows, start=1):
        for path, leaf in _leaves(name, one):
            if path not in columns:
                columns[path] = []
                require_room(table.source, count * len(columns), len(columns))
            columns[path].extend([None] * (count - 1 - len(columns[path])))
            columns[path][count - 1 :] = [leaf]
    for path, cells in columns.items():
        _take_cells(table, path or "value", cells + [None] * (count - len(cells)))


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of a record with their paths."""
    match value:
        case dict():
            for key, member in value.items():
                yield from _leaves(f"{name}.{key}" if name else key, member)
        case list():
            for place, member in enumerate(value):
                yield from _leaves(f"{name}[{place}]", member)
        case _:
            yield name, value


def _take_cells(table: Table, name: str, cells: Any) -> None:
    array = np.array(cells, dtype=object)
    kinds = {type(cell) for cell in array.flat if cell is not None}
    try:
        if kinds == {str} and all(is_stamp(cell) for cell in cells if cell):
            texts = [cell or "" for cell in cells]
            table.take(name, find_stamps(texts).seconds(texts), "s")
        elif kinds <= {int, float}:
            table.take(name, array.astype(np.float64))  # null becomes NaN
        else:
            raise ValueError(kinds)
    except (ValueError, OverflowError):
        table.passed[name] = "it holds more than numbers, or lists or instants that are not alike"
