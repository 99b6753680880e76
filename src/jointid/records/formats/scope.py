"""TwinCAT Scope text export: channel properties, then a time column per group.

Groups of different sample times have their own time columns, and short ones end early. Layout: Beckhoff, TE13xx Scope
View manual, "Export to CSV".
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.records.formats.table import Table
from jointid.records.formats.text import Line, TextFile, point_rows

_ROWS = frozenset({
    "Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "VariableSize", "SymbolBased", "IndexGroup", "IndexOffset",
    "SymbolName", "NetID", "NetId", "Port", "Offset", "ScaleFactor", "BitMask", "Unit", "Unit ScaleFactor",
    "Unit Offset", "StartTime", "EndTime",
})  # fmt: skip
_OF_EXPORT = ("Starttime of export", "StartRecord", "SampleTime[ms]", "SymbolName", "Data-Type")
_LOOK = 200  # lines within which the channels are named
_LENGTHS = 32  # different ones of groups: all rows are gone through for each
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


def find_scope(text: TextFile) -> Scope | None:
    """Parse the header of an export; None for other text."""
    lines = text.lines[:_LOOK]
    if not lines or not lines[0].text.startswith("Name") or len(lines[0].text) < len("Name_"):
        return None
    mark = lines[0].text[len("Name")]
    split = [[cell.strip() for cell in line.text.split(mark)] for line in lines]
    keys = [cells[0] for cells in split]
    if mark.isalnum() or not any(key in _OF_EXPORT for key in keys):
        return None
    top = max(i for i, key in enumerate(keys) if key == "Name")
    first = next((i for i in range(top, len(keys)) if keys[i] not in _ROWS), len(keys))
    rows = {keys[i]: split[i] for i in range(top, first)}
    named = rows["Name"]
    starts = [c for c, cell in enumerate(named) if cell == "Name"]
    # Beside a full header a channel may be called "Name" too: its other rows are then not their keys.
    starts = [c for c in starts if all(len(cells) <= c or cells[c] == key for key, cells in rows.items())]
    return Scope(mark, rows, tuple(starts), first)


def read_scope(text: TextFile, scope: Scope, decimal: str | None = None) -> Table:
    """Read an export, each column with its own clock.

    Times are in ms, FILETIMEs relative to the first. `Offset` is for display only. None detects the decimal mark.
    """
    names, rows = _channel_names(text.name, scope), _number_rows(text, scope)
    point = decimal or ("," if scope.delimiter != "," and any("," in row.text for row in rows) else ".")
    numbers = _Numbers(text.name, rows, scope, point)
    values: dict[int, FloatArray] = {}
    for count, columns in _sort_by_length(numbers, scope).items():
        values |= numbers.columns(columns, count)
    made: dict[str, FloatArray] = {}
    clocks: dict[str, str] = {}
    alike = len({values[start].tobytes() for start in scope.starts}) == 1
    for group in scope.groups():
        repeated = np.all([np.diff(values[column]) == 0 for column in group], axis=0)  # the export's padding
        kept = np.concatenate([[True], ~repeated])
        time, channels = values[group.start][kept], {names[c]: values[c][kept] for c in group[1:]}
        first = names[group[1]]
        _check_step(text.name, time, scope.cell("SampleTime[ms]", group[1]), first)
        clock = "time [ms]" if alike else f"time of {first.partition(' [')[0]} [ms]"
        made |= {clock: time, **channels}
        clocks |= {} if alike else dict.fromkeys(channels, clock)
    return Table(made, source=text.name, clocks=clocks)


def _sort_by_length(numbers: _Numbers, scope: Scope) -> dict[int, list[int]]:
    """Group columns by row count, to be read together."""
    found: dict[int, list[int]] = {}
    for group in scope.groups():
        found.setdefault(numbers.count(group.start), []).extend(group)
        if len(found) > _LENGTHS:
            raise RecordError(
                f"{numbers.file} has more than {_LENGTHS} groups of channels of different lengths; export fewer "
                "channels at once."
            )
    return found


def _number_rows(text: TextFile, scope: Scope) -> list[Line]:
    if scope.delimiter == " ":
        raise RecordError(
            f"{text.name} was exported with blanks between its columns, which also stand for what is missing; export "
            "it with tabs or semicolons."
        )
    if not scope.starts or any(len(group) < 2 for group in scope.groups()):
        raise RecordError(
            f'{text.name} has a time column without channels in its row "Name"; export it with a time column for each '
            "channel, or for each sample time."
        )
    rows = text.lines[scope.first :]
    if rows and rows[-1].text.rstrip(f" {scope.delimiter}") == "EOF":
        rows = rows[:-1]
    if not rows:
        raise RecordError(f"{text.name} has no row of numbers below its channels; export it again.")
    return rows


def _channel_names(file: str, scope: Scope) -> dict[int, str]:
    """Channel names by column, with units in brackets."""
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


@dataclass(frozen=True, slots=True)
class _Numbers:
    """Rows of an export as text, with cells cached once split."""

    file: str
    rows: Sequence[Line]
    scope: Scope
    point: str
    cells: dict[int, list[str]] = field(default_factory=dict)

    def count(self, column: int) -> int:
        """Number of leading rows of a group that have a time."""
        return bisect_left(range(len(self.rows)), True, key=lambda row: not self._cell(row, column))

    def columns(self, wanted: Sequence[int], count: int) -> dict[int, FloatArray]:
        """Return the numbers of some columns, shape (count,) each."""
        if count == 0:
            channel = self.scope.cell("Name", wanted[1])
            raise RecordError(f'{self.file} has no number of the channel "{channel}"; leave it out of the export.')
        plain, mark = point_rows(self.rows[:count], self.point), self.scope.delimiter
        try:
            values = np.loadtxt(plain, delimiter=mark, usecols=wanted, comments=None, ndmin=2)
            found = dict(zip(wanted, values.T, strict=True))
            starts = sorted(set(self.scope.starts) & set(wanted)) if (origin := self._origin) else []
            if starts:
                # A FILETIME has 18 digits, and a float 16: the difference is taken before.
                ticks = np.loadtxt(plain, dtype=np.int64, delimiter=mark, usecols=starts, comments=None, ndmin=2)
                found |= dict(zip(starts, ((ticks - origin) / _TICKS).T, strict=True))
        except (ValueError, IndexError, OverflowError):
            raise RecordError(self._damage(wanted, count)) from None
        return found

    @property
    def _origin(self) -> int:
        """First FILETIME; 0 for times in ms."""
        firsts = [cell for start in self.scope.starts if (cell := self._cell(0, start)).isdecimal()]
        return min([int(cell) for cell in firsts if len(cell) in _FILETIME], default=0)

    def _cell(self, row: int, column: int) -> str:
        if row not in self.cells:
            self.cells[row] = self.rows[row].text.split(self.scope.delimiter)
        cells = self.cells[row]
        return cells[column].strip() if column < len(cells) else ""

    def _damage(self, wanted: Sequence[int], count: int) -> str:
        """Describe the first cell without a number."""
        for row in range(count):
            for column in wanted:
                cell = self._cell(row, column)
                try:
                    float(cell.replace(".", "?").replace(",", ".") if self.point == "," else cell)
                except ValueError:
                    holds = f'"{short(cell)}"' if cell else "nothing"
                    return (
                        f"{self.file}: line {self.rows[row].number}, cell {column + 1} holds {holds}, where a number "
                        f'with the decimal mark "{self.point}" was expected; export it again, or delete that line.'
                    )
        return f"{self.file} has rows that are no numbers; export it again."
