"""TwinCAT Scope text export: channel properties, then a time column per group.

Groups of different sample times have their own time columns, and short ones end early. Layout: Beckhoff, TE13xx Scope
View manual, "Export to CSV".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats.table import Found, Table

_ROWS = frozenset({
    "Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "VariableSize", "SymbolBased", "IndexGroup", "IndexOffset",
    "SymbolName", "NetID", "NetId", "Port", "Offset", "ScaleFactor", "BitMask", "Unit", "Unit ScaleFactor",
    "Unit Offset", "StartTime", "EndTime",
})  # fmt: skip
_OF_EXPORT = ("Starttime of export", "StartRecord", "SampleTime[ms]", "SymbolName", "Data-Type")
_LOOK = 200  # lines within which the channels are named
_TICKS = 10_000  # of a FILETIME (100 ns) in 1 ms
_FILETIME = (17, 18)  # digits of one: the years 1917 to 4769; what has less is ms since the start
_OFF = 0.1  # of the sample time, that the time column's step may differ from it
_SYMBOLS = {"°": "deg", "°/s": "deg/s", "1/min": "rpm"}


@dataclass(frozen=True, slots=True)
class Scope:
    """Header of an export.

    Attributes:
        rows: by their keys, the cells of each row that says something of the channels; those of the time columns too.
        groups: the columns of each, the time first.
        first: the first line of numbers among those of the file.
    """

    delimiter: str
    rows: Mapping[str, Sequence[str]]
    groups: tuple[range, ...]
    first: int

    def cell(self, key: str, column: int, default: str = "") -> str:
        """Return a row's entry for a column."""
        cells = self.rows.get(key, ())
        return cells[column] if column < len(cells) else default

    def name(self, column: int) -> str:
        """Return a channel's name and, in brackets, its unit if stated.

        The file does not say whether the values are scaled, so an unknown unit has to be declared.
        """
        names = [self.cell("Name", other) for group in self.groups for other in group[1:]]
        name = self.cell("Name" if len(set(names)) == len(names) and all(names) else "SymbolName", column)
        symbol = self.cell("Unit", column).partition(" (")[0].strip()
        symbol = "" if symbol.startswith("(") else _SYMBOLS.get(symbol, symbol)
        factors = (self.cell(key, column, "1").replace(",", ".") for key in ("ScaleFactor", "Unit ScaleFactor"))
        if scaled := [factor for factor in factors if factor not in ("", "1")]:
            return f"{name} [{symbol or 'no unit'}, drawn times {' times '.join(scaled)}]"
        return f"{name} [{symbol}]" if symbol else name


def find_scope(lines: Sequence[str]) -> Scope | None:
    """Parse the header of an export; None for other text."""
    if not lines or not lines[0].startswith("Name") or len(lines[0]) < len("Name_"):
        return None
    mark = lines[0][len("Name")]
    split = [[cell.strip() for cell in line.split(mark)] for line in lines[:_LOOK]]
    keys = [cells[0] for cells in split]
    if mark.isalnum() or not any(key in _OF_EXPORT for key in keys):
        return None
    top = max(i for i, key in enumerate(keys) if key == "Name")
    first = next((i for i in range(top, len(keys)) if keys[i] not in _ROWS), len(keys))
    rows = {keys[i]: split[i] for i in range(top, first)}
    starts = [c for c, cell in enumerate(rows["Name"]) if cell == "Name"]
    # Beside a full header a channel may be called "Name" too: its other rows are then not their keys.
    starts = [c for c in starts if all(len(cells) <= c or cells[c] == key for key, cells in rows.items())]
    groups = tuple(map(range, starts, (*starts[1:], len(rows["Name"]))))
    return Scope(mark, rows, groups, first)


def read_scope(path: Path, scope: Scope, lines: Sequence[str], decimal: str | None = None) -> Table:
    """Read an export, each column with its own clock.

    Times are in ms, FILETIMEs relative to the first. `Offset` is for display only. None detects the decimal mark.
    """
    rows = [line for line in lines[scope.first :] if line.rstrip(f" {scope.delimiter}") != "EOF"]
    if not rows or scope.delimiter == " " or not scope.groups or any(len(group) < 2 for group in scope.groups):
        raise RecordError(
            f"{path.name} has blanks between its columns, a time column without channels or no row; export it with "
            "tabs or semicolons, and with a time column for each channel or each sample time."
        )
    point = decimal or ("," if scope.delimiter != "," and any("," in row for row in rows) else ".")
    values = _parse(path.name, scope, rows, point)
    clocks = {group.start: values[~np.isnan(values[:, group.start]), group.start] for group in scope.groups}
    alike = len({clock.tobytes() for clock in clocks.values()}) == 1
    found = Found(path)
    for group in scope.groups:
        numbers, first = values[: clocks[group.start].size, group.start : group.stop], scope.name(group[1])
        if not numbers.size or np.isnan(numbers).any():
            raise RecordError(f'{path.name} has a row without a number of "{first}" or its time; leave it out.')
        # Rows that repeat the one before are the export's padding.
        numbers = numbers[np.concatenate([[True], np.any(np.diff(numbers, axis=0) != 0, axis=1)])]
        _check_step(path.name, numbers[:, 0], scope.cell("SampleTime[ms]", group[1]), first)
        clock = "time [ms]" if alike else f"time of {first.partition(' [')[0]} [ms]"
        if clock not in found.columns:
            found.add(clock, numbers[:, 0])
        for index, column in enumerate(group[1:], start=1):
            found.add(scope.name(column), numbers[:, index], clock="" if alike else clock)
    return found.table()


def _parse(file: str, scope: Scope, rows: Sequence[str], point: str) -> FloatArray:
    """Return the numbers of all columns, (rows, columns), NaN where a cell is empty."""
    values = np.full((len(rows), len(scope.rows["Name"])), math.nan)
    starts, firsts = [group.start for group in scope.groups], rows[0].split(scope.delimiter)
    stamps = [firsts[start].strip() for start in starts if start < len(firsts)]
    origin = min((int(cell) for cell in stamps if cell.isdecimal() and len(cell) in _FILETIME), default=0)
    try:
        for row, line in zip(values, rows, strict=True):
            for column, cell in enumerate(map(str.strip, line.split(scope.delimiter)[: row.size])):
                if cell and origin and column in starts:
                    row[column] = (int(cell) - origin) / _TICKS  # as a float it would lose its last digits
                elif cell:
                    row[column] = float(cell if point == "." else cell.replace(".", "?").replace(",", "."))
    except (ValueError, OverflowError) as error:
        raise RecordError(
            f'{file} has a cell that is no number with the decimal mark "{point}"; export it again.'
        ) from error
    return values


def _check_step(file: str, time: FloatArray, stated: str, name: str) -> None:
    """Refuse a channel whose sample time is not the step of the time column before it."""
    try:
        expected = float(stated.replace(",", "."))
    except ValueError:
        return  # the row is not there
    step = float(np.median(np.diff(time))) if time.size > 1 else expected
    if abs(step - expected) > _OFF * expected:
        raise RecordError(
            f'{file}: the channel "{name}" has a sample every {expected:g} ms, and the column before it steps by '
            f"{step:g}; export it with a time column for each channel, or for each sample time."
        )
