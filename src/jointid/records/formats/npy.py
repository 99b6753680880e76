"""NumPy's own files (.npy): named columns of one record array, or a plain matrix; numbers only, never objects.

Nothing else is read as fast, or as easily in chunks: a row is at a known place in the file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, ClassVar

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.table import Holds, Table

_VERSIONS = ((1, 0), (2, 0), (3, 0))


@dataclass(frozen=True, slots=True)
class Npy:
    """NumPy's .npy: a record array, whose fields are the columns, or a matrix with a row for each sample.

    The columns of a matrix are called by their numbers, from "1".
    """

    name: ClassVar[str] = "NPY"
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)
    holds: ClassVar[Holds] = Holds.NOTHING

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        layout = _read_layout(path)
        return Rows(path, layout, 0, layout.rows).table()

    def write(self, path: Path, table: Table) -> None:
        """Write a record array, a field of eight bytes for each column. Scalars have no place in it."""
        if table.scalars:
            raise RecordError(f"NPY has no place for the scalars {', '.join(table.scalars)}; write a .mat file.")
        if len({values.size for values in table.columns.values()}) != 1:
            lengths = ", ".join(f"{name} {values.size}" for name, values in table.columns.items())
            raise RecordError(f"NPY has columns of one length; got {lengths or 'no column'}.")
        size = next(iter(table.columns.values())).size
        array = np.empty(size, dtype=[(name, "<f8") for name in table.columns])
        for name, values in table.columns.items():
            array[name] = values
        with path.open("wb") as file:
            np.save(file, array, allow_pickle=False)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return the name, which can be any but none; see `Format.legal_name`."""
        return name or "_"

    def blocks(self, path: Path, rows: int) -> Iterator[Rows]:
        """Yield so many rows after so many."""
        layout = _read_layout(path)
        for first in range(0, layout.rows, rows):
            yield Rows(path, layout, first, min(rows, layout.rows - first))


@dataclass(frozen=True, slots=True)
class _Layout:
    """Offset, type and count of the rows of a file."""

    begin: int
    row: np.dtype[Any]
    rows: int


@dataclass(frozen=True, slots=True)
class Rows:
    """Neighbouring rows of a file; a `Block`."""

    path: Path
    layout: _Layout
    first: int
    rows: int

    def table(self, rows: int | None = None) -> Table:
        """Read all, or the first so many."""
        count, row = self.rows if rows is None else min(rows, self.rows), self.layout.row
        # Not mapped into memory: what is mapped counts as memory in use until somebody else asks for it.
        with self.path.open("rb") as file:
            file.seek(self.layout.begin + self.first * row.itemsize)
            array = np.fromfile(file, dtype=row, count=count)
        names = row.names or ()
        return Table({name: array[name].astype(np.float64) for name in names}, source=self.path.name)


def _read_layout(path: Path) -> _Layout:
    """Return how a file is laid out; one that could not be read row by row, or is no .npy, is refused."""
    size = path.stat().st_size
    with path.open("rb") as file:
        try:
            shape, by_column, dtype = _read_header(file)
        except (ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError) as error:
            said = str(error).partition("\n")[0] or type(error).__name__  # NumPy's advice is for programmers
            raise RecordError(f"{path.name} is no .npy file ({said}); write it by numpy.save.") from None
        begin = file.tell()
    wide = shape[1] * dtype.itemsize if len(shape) == 2 else 0
    if dtype.names is None and 0 < wide <= size and not by_column and dtype.kind in "fiu":
        row = np.dtype([(str(i), dtype) for i in range(1, shape[1] + 1)])
    elif dtype.names and len(shape) == 1 and all(dtype[name].kind in "fiu" for name in dtype.names):
        row = dtype
    else:
        raise RecordError(
            f"{path.name} holds {dtype} of shape {shape}; expected a record array of numbers, or a matrix of "
            "numbers in C order with a row for each sample."
        )
    rows = (size - begin) // row.itemsize
    if rows < shape[0] or shape[0] <= 0:
        raise RecordError(f"{path.name} should hold {shape[0]} rows and has {rows}; log or copy it again.")
    return _Layout(begin, row, int(shape[0]))


def _read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return the shape, True if columns come one after the other, and the type of a number or a row.

    Raises:
        ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError: it is no header; NumPy's parser.
    """
    version = np.lib.format.read_magic(file)
    if version not in _VERSIONS:
        raise ValueError(f"its version is {version[0]}.{version[1]}")
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    shape, by_column, dtype = np.lib.format.read_array_header_2_0(file)
    if version == (3, 0) and dtype.names:  # as 2.0, but for names in UTF-8
        dtype.names = tuple(name.encode("latin-1").decode() for name in dtype.names)
    return shape, by_column, dtype
