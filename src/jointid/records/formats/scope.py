"""TwinCAT Scope text export: channel properties, then a time column per group.

Groups of different sample times have their own time columns, and short ones end early. Layout: Beckhoff, TE13xx Scope
View manual, "Export to CSV".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
_LOOK = 200  # lines within which the channels are named
_TICKS = 10_000  # of a FILETIME (100 ns) in 1 ms
_FILETIME = re.compile(r"\d{17,18}")  # the years 1917 to 4769; what has less is ms since the start
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
        return dict(enumerate(self.rows.get(key, ()))).get(column, default)

    def name(self, column: int) -> str:
        """Return a channel's name and, in brackets, its unit if stated.

        The file does not say whether the values are scaled, so an unknown unit has to be declared.
        """
        names = [self.cell("Name", other) for group in self.groups for other in group[1:]]
        name = self.cell("Name" if len(set(names)) == len(names) and all(names) else "SymbolName", column)
        symbol = self.cell("Unit", column).partition("(")[0].strip()
        symbol = _SYMBOLS.get(symbol, symbol)
        factors = (self.cell(key, column, "1").replace(",", ".") for key in ("ScaleFactor", "Unit ScaleFactor"))
        if scaled := [factor for factor in factors if factor not in ("", "1")]:
            return f"{name} [{symbol or 'no unit'}, drawn times {' times '.join(scaled)}]"
        return f"{name} [{symbol}]" if symbol else name


def find_scope(lines: Sequence[str]) -> Scope | None:
    """Parse the header of an export; None for other text."""
    mark = lines[0][4:5] if lines and lines[0].startswith("Name") else ""
    split = [[cell.strip() for cell in line.split(mark)] for line in lines[:_LOOK]] if mark else []
    keys = [cells[0] for cells in split]
    if mark.isalnum() or not any(key in _OF_EXPORT for key in keys):
        return None
    top = max(i for i, key in enumerate(keys) if key == "Name")
    first = next((i for i in range(top, len(keys)) if keys[i] not in _ROWS), len(keys))
    rows = {keys[i]: split[i] for i in range(top, first)}
    # Beside a full header a channel may be called "Name" too: its other rows are then not their keys.
    is_key = [all(len(cells) <= c or cells[c] == key for key, cells in rows.items()) for c in range(len(rows["Name"]))]
    starts = [c for c, cell in enumerate(rows["Name"]) if cell == "Name" and is_key[c]]
    return Scope(mark, rows, tuple(map(range, starts, (*starts[1:], len(rows["Name"])))), first)


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
    try:
        values = _parse(scope, rows, point)
    except (ValueError, OverflowError) as error:
        raise RecordError(
            f'{path.name} has a cell that is no number with the decimal mark "{point}"; export it again.'
        ) from error
    clocks = {group.start: values[~np.isnan(values[:, group.start]), group.start] for group in scope.groups}
    alike = len({clock.tobytes() for clock in clocks.values()}) == 1
    table = Table(source=path.name)
    for group in scope.groups:
        numbers, first = values[: clocks[group.start].size, group.start : group.stop], scope.name(group[1])
        # Rows that repeat the one before are the export's padding.
        numbers = numbers[np.any(np.diff(numbers, axis=0, prepend=np.nan) != 0, axis=1)]
        step = np.median(np.diff(numbers[:, 0])) if len(numbers) > 1 else np.nan
        stated = scope.cell("SampleTime[ms]", group[1]).replace(",", ".")
        if not numbers.size or np.isnan(numbers).any() or (stated and abs(step / float(stated) - 1) > _OFF):
            raise RecordError(
                f'{path.name} has a row without a number of "{first}" or its time, or steps of {step:g} ms where a '
                f"sample is stated every {stated} ms; export it with a time column for each sample time."
            )
        clock = "time [ms]" if alike else f"time of {first.partition(' [')[0]} [ms]"
        if clock not in table.columns:
            table.add(clock, numbers[:, 0].copy())
        for index, column in enumerate(group[1:], start=1):
            table.add(scope.name(column), numbers[:, index].copy(), clock="" if alike else clock)
    return table


def _parse(scope: Scope, rows: Sequence[str], point: str) -> FloatArray:
    """Return the numbers of all columns, (rows, columns), NaN where a cell is empty.

    Raises:
        ValueError: a cell is no number.
    """
    values = np.full((len(rows), len(scope.rows["Name"])), np.nan)
    starts, firsts = [group.start for group in scope.groups], [cell.strip() for cell in rows[0].split(scope.delimiter)]
    stamps = (firsts[start] for start in starts if start < len(firsts))
    origin = min((int(cell) for cell in stamps if _FILETIME.fullmatch(cell)), default=0)
    for row, line in zip(values, rows, strict=True):
        for column, cell in enumerate(map(str.strip, line.split(scope.delimiter)[: row.size])):
            if cell and origin and column in starts:
                row[column] = (int(cell) - origin) / _TICKS  # as a float it would lose its last digits
            elif cell:
                row[column] = float(cell if point == "." else cell.replace(".", "?").replace(",", "."))
    return values
