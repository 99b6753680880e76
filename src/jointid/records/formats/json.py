"""JSON of records or of columns, and files of a record on each line."""

from __future__ import annotations

import json
from collections.abc import Iterator
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
        _take(table, "", [json.loads(line) for line in raw.split(b"\n") if line.strip()])
    else:
        _take(table, "", json.loads(raw))
    return table


def _take(table: Table, name: str, value: Any) -> None:
    """Add the columns of a document by their paths; a list of records is a record of lists."""
    if type(value) is dict:
        for key, member in value.items():
            _take(table, f"{name}.{key}" if name else key, member)
    elif type(value) is list and any(type(one) is dict for one in value):
        columns = dict[str, list[Any]]()
        for row, one in enumerate(value):
            for path, leaf in _leaves(name, one):
                if path not in columns:
                    columns[path] = [None] * len(value)
                    require_room(table.source, len(value) * len(columns), len(columns))
                columns[path][row] = leaf
        for path, cells in columns.items():
            _take_cells(table, path or "value", cells)
    else:
        _take_cells(table, name or "value", value)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of a record with their paths."""
    if type(value) is dict:
        inner = [(f"{name}.{key}" if name else key, member) for key, member in value.items()]
    elif type(value) is list:
        inner = [(f"{name}[{place}]", member) for place, member in enumerate(value)]
    else:
        yield name, value
        return
    for path, member in inner:
        yield from _leaves(path, member)


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
