"""TwinCAT Scope text export: channel properties, then a time column per group.

Groups of different sample times have their own time columns, and short ones end early. Layout: Beckhoff, TE13xx Scope
View manual, "Export to CSV".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.records.formats.table import Found, Table

if TYPE_CHECKING:
    from jointid.records.formats.text import Line

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
        starts: of each group, the number of its time column.
        first: the first line of numbers among those of the file.
    """

    delimiter: str
    rows: Mapping[str, Sequence[str]]
    starts: tuple[int, ...]
    first: int

    def groups(self) -> Iterator[range]:
        """Yield the columns of each group, time first."""
        for start, end in zip(self.starts, (*self.starts[1:], len(self.rows["Name"])), strict=True):
            yield range(start, end)

    def cell(self, key: str, column: int, default: str = "") -> str:
        """Return a row's entry for a column."""
        cells = self.rows.get(key, ())
        return cells[column] if column < len(cells) else default


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
    return Scope(mark, rows, tuple(starts), first)


def read_scope(path: Path, scope: Scope, lines: Sequence[Line], decimal: str | None = None) -> Table:
    """Read an export, each column with its own clock.

    Times are in ms, FILETIMEs relative to the first. `Offset` is for display only. None detects the decimal mark.
    """
    file, names = path.name, _name_channels(path.name, scope)
    rows = [line for line in lines[scope.first :] if line.text.rstrip(f" {scope.delimiter}") != "EOF"]
    if not rows:
        raise RecordError(f"{file} has no row of numbers below its channels; export it again.")
    point = decimal or ("," if scope.delimiter != "," and any("," in row.text for row in rows) else ".")
    values = _parse(file, scope, rows, point)
    clocks = {group.start: values[~np.isnan(values[:, group.start]), group.start] for group in scope.groups()}
    alike = len({clock.tobytes() for clock in clocks.values()}) == 1
    found = Found(path)
    for group in scope.groups():
        numbers, first = values[: clocks[group.start].size, group.start : group.stop], names[group[1]]
        if not numbers.size or np.isnan(numbers).any():
            raise RecordError(f'{file} has a row without a number of "{first}" or its time; leave it out.')
        # Rows that repeat the one before are the export's padding.
        numbers = numbers[np.concatenate([[True], np.any(np.diff(numbers, axis=0) != 0, axis=1)])]
        _check_step(file, numbers[:, 0], scope.cell("SampleTime[ms]", group[1]), first)
        clock = "time [ms]" if alike else f"time of {first.partition(' [')[0]} [ms]"
        if clock not in found.columns:
            found.add(clock, numbers[:, 0])
        for index, column in enumerate(group[1:], start=1):
            found.add(names[column], numbers[:, index], clock="" if alike else clock)
    return found.table()


def _name_channels(file: str, scope: Scope) -> dict[int, str]:
    """Channel names by column, with units in brackets."""
    if scope.delimiter == " " or not scope.starts or any(len(group) < 2 for group in scope.groups()):
        raise RecordError(
            f"{file} has blanks between its columns, or a time column without channels; export it with tabs or "
            "semicolons, and with a time column for each channel or each sample time."
        )
    channels = [column for group in scope.groups() for column in group[1:]]
    for said in ("Name", "SymbolName"):
        names = {column: scope.cell(said, column) for column in channels}
        if len(set(names.values())) == len(channels) and all(names.values()):
            return {column: name + _bracket_unit(scope, column) for column, name in names.items()}
    raise RecordError(f"{file} has two channels of one name, or one without; rename them in the scope.")


def _bracket_unit(scope: Scope, column: int) -> str:
    """A channel's unit in brackets, if stated.

    The file does not say whether the values are scaled, so an unknown unit has to be declared.
    """
    symbol = scope.cell("Unit", column).partition(" (")[0].strip()
    symbol = "" if symbol.startswith("(") else _SYMBOLS.get(symbol, symbol)
    factors = [scope.cell(key, column, "1").replace(",", ".") or "1" for key in ("ScaleFactor", "Unit ScaleFactor")]
    scaled = [factor for factor in factors if factor != "1"]
    if scaled:
        return f" [{symbol or 'no unit'}, drawn times {' times '.join(scaled)}]"
    return f" [{symbol}]" if symbol else ""


def _parse(file: str, scope: Scope, rows: Sequence[Line], point: str) -> FloatArray:
    """Return the numbers of all columns, (rows, columns), NaN where a cell is empty."""
    firsts = rows[0].text.split(scope.delimiter)
    stamps = [firsts[start].strip() for start in scope.starts if start < len(firsts)]
    origin = min((int(cell) for cell in stamps if cell.isdecimal() and len(cell) in _FILETIME), default=0)
    values = np.full((len(rows), len(scope.rows["Name"])), math.nan)
    for index, row in enumerate(rows):
        for column, cell in zip(range(values.shape[1]), map(str.strip, row.text.split(scope.delimiter)), strict=False):
            try:
                if cell and origin and column in scope.starts:
                    # A FILETIME has 18 digits, and a float 16: the difference is taken before.
                    values[index, column] = (int(cell) - origin) / _TICKS
                elif cell:
                    values[index, column] = float(cell if point == "." else cell.replace(".", "?").replace(",", "."))
            except (ValueError, OverflowError):
                raise RecordError(
                    f'{file}: line {row.number} holds "{short(cell)}", where a number with the decimal mark "{point}" '
                    "was expected; export it again, or delete that line."
                ) from None
    return values


def _check_step(file: str, time: FloatArray, stated: str, name: str) -> None:
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
