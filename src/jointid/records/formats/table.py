"""Table of named columns and single numbers, which every file format reads and writes."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import Field, dataclass, field, replace
from enum import Flag, auto
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short, shown

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
            column = np.array(values, dtype=np.float64)
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

    def list_columns(self, wanted: str) -> str:
        """Return the names of the columns, quoted; of very many, those most like the one that was wanted."""
        names = list(self.columns)
        close = names if len(names) <= _LISTED else difflib.get_close_matches(wanted, names, _LISTED, cutoff=0.0)
        rest = f" and {len(names) - len(close)} more" if len(close) < len(names) else ""
        return (", ".join(f'"{short(name, _QUOTED)}"' for name in close) or "none") + rest

    def take(self, names: Iterable[str]) -> Table:
        """Return the table with the columns of these names alone, in their order.

        Raises:
            RecordError: there is no such column.
        """
        names = list(names)
        missing = [name for name in names if name not in self.columns]
        if missing:
            why = f" ({self.passed[missing[0]]})" if missing[0] in self.passed else ""
            raise RecordError(
                f'{self.source} has no column "{shown(missing[0])}"{why}; it has {self.list_columns(missing[0])}.'
            )
        return replace(self, columns={name: self.columns[name] for name in names})


class Holds(Flag):
    """Contents that a file can hold beside columns of one length."""

    NOTHING = 0
    SCALARS = auto()
    UNITS = auto()
    LENGTHS = auto()  # columns that differ in length
    CLOCKS = auto()  # which column is the time of which


class Format(Protocol):
    """A file format: a frozen dataclass whose fields are the options of its reader.

    Attributes:
        name: what messages call the format.
        suffixes: the endings of its files, in lower case, with the dot.
        holds: what of a table beside its columns has a place in such a file.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    holds: ClassVar[Holds]
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def read(self, path: Path) -> Table:
        """Read the whole file.

        Raises:
            RecordError: the file is not of this format, or is damaged.
            OSError: the file cannot be opened.
        """
        ...

    def write(self, path: Path, table: Table) -> None:
        """Write `table` so that `read` gives it back to the last bit, without the units if the format has no place.

        Raises:
            RecordError: the format cannot hold this table.
            OSError: the file cannot be written.
        """
        ...

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return the name of a column as a file of this format can hold it: itself, or one that is like it.

        Args:
            name: of the column.
            others: names that stand beside it.
        """
        ...


class Block(Protocol):
    """Neighbouring rows of a file, not read until they are asked for."""

    @property
    def rows(self) -> int:
        """Count of rows, 1 or more."""
        ...

    def table(self, rows: int | None = None) -> Table:
        """Read them, or the first so many.

        Raises:
            RecordError: a row is damaged; the sentence names its line.
        """
        ...


@runtime_checkable
class Streamed(Protocol):
    """A format whose files can be read from front to back in bounded memory."""

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many; the last block may have fewer. One is read before the next is asked for.

        A column that is shorter than others ends early, and is not in the blocks behind its end.

        Raises:
            RecordError: the file is not of this format.
            WholeError: this file has no rows one after the other.
            OSError: the file cannot be opened.
        """
        ...


class NotStreamedError(RecordError):
    """A file that can only be read whole was to be read in chunks."""


@dataclass(frozen=True, slots=True)
class MemoryBlock:
    """Rows that are already in memory; a `Block`."""

    held: Table

    @property
    def rows(self) -> int:
        """Count of rows."""
        return max(values.size for values in self.held.columns.values())

    def table(self, rows: int | None = None) -> Table:
        """Return all, or the first so many."""
        return replace(self.held, columns={name: values[:rows] for name, values in self.held.columns.items()})
