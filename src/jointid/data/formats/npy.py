"""NumPy's own files (.npy): named columns of one record array, or a plain matrix; numbers only, never objects.

Nothing else is read as fast, or as easily in pieces: a row is at a known place in the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.errors import RecordError
from jointid.data.formats.table import Table


@dataclass(frozen=True, slots=True)
class Npy:
    """NumPy's .npy: a record array, whose fields are the columns, or a matrix with a row for each sample.

    The columns of a matrix are called by their numbers, from "1".
    """

    name: ClassVar[str] = "NPY"
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        layout = _layout(path)
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

    def blocks(self, path: Path, rows: int) -> Iterator[Rows]:
        """Yield so many rows after so many."""
        layout = _layout(path)
        for first in range(0, layout.rows, rows):
            yield Rows(path, layout, first, min(rows, layout.rows - first))


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the rows of a file begin, what one is made of, and how many there are."""

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


def _layout(path: Path) -> _Layout:
    """Return how a file is laid out; one that could not be read row by row, or is no .npy, is refused."""
    with path.open("rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, by_column, dtype = read(file)
        except ValueError as error:
            raise RecordError(f"{path.name} is no .npy file ({error}); write it by numpy.save.") from None
        begin = file.tell()
    if dtype.names is None and len(shape) == 2 and not by_column and dtype.kind in "fiu":
        row = np.dtype([(str(i), dtype) for i in range(1, shape[1] + 1)])
    elif dtype.names and len(shape) == 1 and all(dtype[name].kind in "fiu" for name in dtype.names):
        row = dtype
    else:
        raise RecordError(
            f"{path.name} holds {dtype} of shape {shape}; expected a record array of numbers, or a matrix of "
            "numbers in C order with a row for each sample."
        )
    rows = (path.stat().st_size - begin) // row.itemsize
    if rows < shape[0] or not shape[0]:
        raise RecordError(f"{path.name} should hold {shape[0]} rows and has {rows}; log or copy it again.")
    return _Layout(begin, row, int(shape[0]))
