"""Tables of columns and scalars, common to all formats, and bounds on what a file may hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short

WHOLE = 2**30
"""Bytes of numbers that are read at once, 1 GiB: 13 columns of 10 million rows; reading them may take twice that."""

WIDEST = 10_000
"""Columns that are read of a text or a matrix: no drive logs so many, and each is an array of its own."""

PIECES = 2**40
"""Bytes of numbers that are read in chunks, 1 TiB: more than a year of 4 columns at 1 kHz."""

TIME_NAME = re.compile(r"(?:t|time)\s*(?:[\[(].*[\])])?", re.IGNORECASE)
"""Name by which a column is taken for the time without being named as such."""

STAMP_NAME = re.compile(r"(?:t|time|timestamps?|stamps?|zeit)\s*(?:[\[(].*[\])])?", re.IGNORECASE)
"""Name by which a column of a log is recognised as its time, in a file of several or where a file is looked over."""

_NUMBER = 8  # bytes of a number in memory
_FEW = 3  # things passed over that a sentence names
_STEPS = ("KiB", "MiB", "GiB", "TiB", "PiB")
_QUOTED = 100  # characters of a name
_LISTED = 20  # columns that a message lists; some MAT files have thousands


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The numbers of one file, by name.

    Attributes:
        columns: name -> values of shape (samples,), in file order, read-only, NaN where the file has no
            number; the columns of one file can differ in length.
        scalars: name -> single number, where the format keeps such (a MAT file's gains, say).
        source: the file's name, for reports and errors.
        units: name -> unit of a column, as the file spells it, where the format keeps such and the file has one.
        passed: name -> why it was not read, of what looks like a column and is none.
        clocks: name of a column -> that of its own time column, where the file has several clocks.

    Raises:
        RecordError: a column is not one-dimensional, or holds nothing.
    """

    columns: Mapping[str, FloatArray]
    scalars: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    passed: Mapping[str, str] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        columns: dict[str, FloatArray] = {}
        for name, values in self.columns.items():
            column = np.asarray(values, dtype=np.float64)
            if column.flags.writeable or column.base is not None:  # what somebody else may change
                column = np.array(column)
            if column.ndim != 1 or column.size == 0:
                raise RecordError(f'Column "{name}" has shape {column.shape}; give a non-empty array of one dimension.')
            column.flags.writeable = False
            columns[name] = column
        scalars = {name: float(value) for name, value in self.scalars.items()}
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "scalars", MappingProxyType(scalars))
        units = {name: unit for name, unit in self.units.items() if name in columns}
        object.__setattr__(self, "units", MappingProxyType(units))
        object.__setattr__(self, "passed", MappingProxyType(dict(self.passed)))

    def list_columns(self) -> str:
        """List the first column names, quoted."""
        names = list(self.columns)
        rest = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return (", ".join(f'"{short(name, _QUOTED)}"' for name in names[:_LISTED]) or "none") + rest

    def explain_missing(self, names: Iterable[str]) -> str:
        """Return in brackets why columns of these names are not there, as far as it is known."""
        known = [self.passed[name] for name in names if name in self.passed]
        return f" ({'; '.join(known)})" if known else ""

    @property
    def rows(self) -> int:
        """Count of rows: the length of the longest column."""
        return max((values.size for values in self.columns.values()), default=0)

    def cut(self, first: int, last: int) -> Table:
        """Return the rows from the first up to the last."""
        return replace(self, columns={name: values[first:last] for name, values in self.columns.items()})


def join_tables(tables: Sequence[Table]) -> Table:
    """Concatenate tables; a column missing in a later one ends there."""
    first = tables[0]
    if len(tables) == 1:
        return first
    parts = {name: [table.columns[name] for table in tables if name in table.columns] for name in first.columns}
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    for values in joined.values():
        values.flags.writeable = False  # nobody else has them
    return replace(first, columns=joined)


def require_no_scalars(table: Table, target: str) -> None:
    """Refuse scalars, which `target` cannot hold."""
    if table.scalars:
        raise RecordError(f"{target} has no place for the scalars {', '.join(table.scalars)}; write a .mat file.")


def require_one_length(table: Table, target: str) -> None:
    """Refuse unequal columns, which `target` cannot hold."""
    if len({values.size for values in table.columns.values()}) != 1:
        lengths = ", ".join(f"{name} {values.size}" for name, values in table.columns.items())
        raise RecordError(f"{target} has columns of one length; got {lengths or 'no column'}.")


class Format(Protocol):
    """A file format: a frozen dataclass of reader options.

    Attributes:
        suffixes: the endings of its files, in lower case, with the dot.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def read(self, path: Path) -> Table:
        """Read the whole file.

        Raises:
            RecordError: the file is not of this format, or is damaged.
            OSError: the file cannot be opened.
        """


@runtime_checkable
class Written(Protocol):
    """A format that tables are written in."""

    def write(self, path: Path, table: Table) -> None:
        """Write `table` so that `read` restores it exactly, except unsupported units.

        Raises:
            RecordError: the format cannot hold this table.
            OSError: the file cannot be written.
        """


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a file, read on demand.

    Attributes:
        rows: how many, 1 or more.
        read: the function that reads so many of them, from the first on.
    """

    rows: int
    read: Callable[[int], Table]

    def table(self, rows: int | None = None) -> Table:
        """Read all or the first `rows` rows.

        Raises:
            RecordError: a row is damaged; the sentence names its line.
        """
        return self.read(self.rows if rows is None else min(rows, self.rows))


def split_rows(total: int, rows: int, read: Callable[[int, int], Table]) -> Iterator[Block]:
    """Yield blocks of `rows` rows of a file with random access.

    `read` takes the first row and the count.
    """
    for first in range(0, total, rows):
        yield Block(min(rows, total - first), partial(read, first))


@runtime_checkable
class Streamed(Protocol):
    """A format that can be read in bounded memory."""

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield blocks of `rows` rows, each read before the next.

        Short columns are absent from blocks behind their end.

        Raises:
            RecordError: the file is not of this format, or has no consecutive rows.
            OSError: the file cannot be opened.
        """


def require_file(path: Path) -> None:
    """Refuse a path without content."""
    if "\0" in str(path):
        raise RecordError(f"{path} is no path: it holds a zero byte; correct it.")
    size = path.stat().st_size
    if path.is_dir():
        return
    if not path.is_file():
        raise RecordError(f"{path} is a pipe or a device; write what it gives to a file, and name that.")
    if size == 0:
        raise RecordError(f"{path.name} is empty (0 bytes); log or copy it again.")


def require_size(path: Path, numbers: int, limit: int = WHOLE) -> None:
    """Refuse a file that declares too many numbers."""
    if numbers * _NUMBER > limit:
        advice = (
            "log fewer channels, or read it in chunks with jointid identify --window"
            if limit == WHOLE
            else "cut it into shorter files"
        )
        raise RecordError(
            f"{path.name} declares {format_size(numbers * _NUMBER)} of numbers, and at most {format_size(limit)} are "
            f"read; {advice}."
        )


def format_size(count: int) -> str:
    """Return a number of bytes in words."""
    if count < 1024:
        return f"{count} bytes"
    value, step = float(count), -1
    while value >= 1024 and step < len(_STEPS) - 1:
        value, step = value / 1024, step + 1
    return f"{value:.3g} {_STEPS[step]}" if value < 1000 else f"{value:.0f} {_STEPS[step]}"


def require_unique_names(path: Path, names: list[str]) -> None:
    """Refuse duplicate column names."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise RecordError(f"{path.name} has more than one column called {name!r}; rename them.")
        seen.add(name)


def describe_skips(passed: Mapping[str, str]) -> str:
    """List skipped items with reasons, in brackets."""
    listed = "; ".join(f"{name!r}: {why}" for name, why in list(passed.items())[:_FEW])
    return f" ({listed})" if listed else ""
