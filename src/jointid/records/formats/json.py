"""JSON lines: one object per line."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.table import Table, require_room
from jointid.records.formats.text import number_lines


def read_json(path: Path) -> Table:
    """Read the numbers of JSON lines (.jsonl, .ndjson); missing ones are NaN.

    Nested values are named by path, "joint.position" or "q[0]". Null is NaN; words, true and false are skipped.
    """
    table, rows = Table(source=path.name), 0
    columns: dict[str, array[float]] = {}
    for line in (line for _, line in number_lines(path) if line.strip()):
        require_room(path.name, len(columns) * rows, len(columns))
        for name, value in _leaves("", json.loads(line)):
            if type(value) not in (float, type(None)) and not (type(value) is int and abs(value) < 2**1024):
                table.passed[name] = "it holds more than numbers"
            elif name not in table.passed:
                values = columns.get(name) or columns.setdefault(name, array("d"))
                values.extend([math.nan] * (rows - len(values)))
                values.append(math.nan if value is None else value)
        rows += 1
        if any(len(values) > rows for values in columns.values()):
            raise RecordError(f"{path.name} has a value twice in line {rows}; give each name once.")
    for name, values in ((name, values) for name, values in columns.items() if name not in table.passed):
        values.extend([math.nan] * (rows - len(values)))
        table.add(name, np.frombuffer(values))
    return table


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield nested values by path."""
    if type(value) is dict:
        for key, member in value.items():
            yield from _leaves(f"{name}.{key}" if name else key, member)
    elif type(value) is list:
        for place, member in enumerate(value):
            yield from _leaves(f"{name}[{place}]", member)
    else:
        yield name, value
