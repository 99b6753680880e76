"""TwinCAT Scope text export: channel properties, then columns by group.

Groups of different sample times have their own time columns, and short ones end early. Layout: Beckhoff, TE13xx Scope
View manual, "Export to CSV".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats.table import Table

_ROWS = frozenset({
    "Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "VariableSize", "SymbolBased", "IndexGroup", "IndexOffset",
    "SymbolName", "NetID", "NetId", "Port", "Offset", "ScaleFactor", "BitMask", "Unit", "Unit ScaleFactor",
    "Unit Offset", "StartTime", "EndTime",
})  # fmt: skip
_OF_EXPORT = ("Starttime of export", "StartRecord", "SampleTime[ms]", "SymbolName", "Data-Type")
_LOOK = 200  # most lines of the header
_TICKS = 10_000  # of a FILETIME (100 ns) in 1 ms
_FILETIME = re.compile(r"\d{17,18}")  # the years 1917 to 4769; shorter numbers are ms since the start
_OFF = 0.1  # of the sample time: tolerance of the time column's step
_SYMBOLS = {"°": "deg", "°/s": "deg/s", "1/min": "rpm"}


def is_scope(lines: Sequence[str]) -> bool:
    """Test for the header of an export."""
    mark = lines[0][4:5] if lines and lines[0].startswith("Name") else ""
    keys = [line.partition(mark)[0].strip() for line in lines[:_LOOK]] if mark else []
    return not mark.isalnum() and any(key in _OF_EXPORT for key in keys)


def read_scope(path: Path, lines: Sequence[str], decimal: str | None = None) -> Table:
    """Read an export, each column with its own clock.

    Times are in ms, FILETIMEs relative to the first. `Offset` is for display only. `decimal` is detected if None.
    """
    mark = lines[0][4]
    head = [[cell.strip() for cell in line.split(mark)] for line in lines[:_LOOK]]
    top = max(i for i, cells in enumerate(head) if cells[0] == "Name")
    first = next((i for i in range(top, len(head)) if head[i][0] not in _ROWS), len(head))
    said, width = {cells[0]: cells for cells in head[top:first]}, len(head[top])
    # A channel may be called "Name", too; its other header rows then differ from their keys.
    is_key = [all(len(cells) <= c or cells[c] == key for key, cells in said.items()) for c in range(width)]
    starts = [c for c, cell in enumerate(said["Name"]) if cell == "Name" and is_key[c]]
    groups = list(map(range, starts, (*starts[1:], width)))
    rows = [line for line in lines[first:] if line.rstrip(f" {mark}") != "EOF"]
    if not rows or mark == " " or not groups or any(len(group) < 2 for group in groups):
        raise RecordError(
            f"{path.name} has blanks between its columns, a time column without channels or no row; export it with "
            "tabs or semicolons, and with a time column for each channel or each sample time."
        )
    point = decimal or ("," if mark != "," and any("," in row for row in rows) else ".")
    try:
        values = _parse(rows, mark, width, starts, point)
    except (ValueError, OverflowError) as error:
        raise RecordError(
            f'{path.name} has a cell that is no number with the decimal mark "{point}"; export it again.'
        ) from error
    clocks = [values[~np.isnan(values[:, start]), start] for start in starts]
    alike = len({clock.tobytes() for clock in clocks}) == 1
    # Symbol names distinguish channels with equal names.
    names = [cell for group in groups for cell in said["Name"][group[1] : group.stop]]
    naming = "Name" if len(set(names)) == len(names) and all(names) else "SymbolName"
    table = Table(source=path.name)
    for group, clock in zip(groups, clocks, strict=True):
        described = [{key: cells[c] for key, cells in said.items() if c < len(cells)} for c in group[1:]]
        numbers, called = values[: clock.size, group.start : group.stop], [_name(one, naming) for one in described]
        # The export pads short columns by repeating the last row.
        numbers = numbers[np.any(np.diff(numbers, axis=0, prepend=np.nan) != 0, axis=1)]
        step = np.median(np.diff(numbers[:, 0])) if len(numbers) > 1 else np.nan
        stated = step
        with suppress(ValueError):
            stated = float(described[0].get("SampleTime[ms]", "").replace(",", ".")) or step
        if not numbers.size or np.isnan(numbers).any() or abs(step - stated) > _OFF * stated:
            raise RecordError(
                f'{path.name} has a row without a number of "{called[0]}" or its time, or steps of {step:g} ms where a '
                f"sample is stated every {stated} ms; export it with a time column for each sample time."
            )
        time = "time [ms]" if alike else f"time of {called[0].partition(' [')[0]} [ms]"
        if time not in table.columns:
            table.add(time, numbers[:, 0].copy())
        for index, name in enumerate(called, start=1):
            table.add(name, numbers[:, index].copy(), clock="" if alike else time)
    return table


def _name(said: Mapping[str, str], naming: str) -> str:
    """Return a channel's name with its stated unit in brackets.

    The file does not say whether the values are scaled, so an unknown unit has to be declared.
    """
    name, symbol = said.get(naming, ""), said.get("Unit", "").partition("(")[0].strip()
    symbol = _SYMBOLS.get(symbol, symbol)
    factors = (said.get(key, "1").replace(",", ".") for key in ("ScaleFactor", "Unit ScaleFactor"))
    if scaled := [factor for factor in factors if factor not in ("", "1")]:
        return f"{name} [{symbol or 'no unit'}, drawn times {' times '.join(scaled)}]"
    return f"{name} [{symbol}]" if symbol else name


def _parse(rows: Sequence[str], mark: str, width: int, starts: Sequence[int], point: str) -> FloatArray:
    """Return all numbers, (rows, columns), with NaN for empty cells; words are a ValueError."""
    values, stamps = np.full((len(rows), width), np.nan), dict(enumerate(map(str.strip, rows[0].split(mark))))
    origin = min((int(stamps[c]) for c in starts if _FILETIME.fullmatch(stamps.get(c, ""))), default=0)
    for row, line in zip(values, rows, strict=True):
        for column, cell in enumerate(map(str.strip, line.split(mark)[:width])):
            if cell and origin and column in starts:
                row[column] = (int(cell) - origin) / _TICKS  # a float would lose the last digits
            elif cell:
                row[column] = float(cell if point == "." else cell.replace(".", "?").replace(",", "."))
    return values
