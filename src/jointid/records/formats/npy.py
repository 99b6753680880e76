"""NumPy files (.npy): a record array or a plain matrix, never objects.

Rows are at known offsets, which makes chunks fast.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from types import SimpleNamespace
from typing import IO, Any, ClassVar

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.table import WIDEST, Block, Holds, Table, require_place, require_size, split_rows

_VERSIONS = ((1, 0), (2, 0), (3, 0))
_HEADER, _REST = 2**16, 2**8  # characters of the header, for more than a thousand columns, and of its other entries


@dataclass(frozen=True, slots=True)
class Npy:
    """NumPy's .npy: a record array or a matrix with one row per sample.

    Matrix columns are numbered from "1".
    """

    name: ClassVar[str] = "NPY"
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)
    holds: ClassVar[Holds] = Holds.NOTHING

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        layout = _read_layout(path)
        require_size(path, layout.rows * layout.columns)
        return layout.read(0, layout.rows)

    def write(self, path: Path, table: Table) -> None:
        """Write a record array of float64 fields; scalars are refused."""
        require_place(table, self.name, self.holds)
        array = np.empty(table.rows, dtype=[(name, "<f8") for name in table.columns])
        if (size := len(repr(array.dtype.descr))) > _HEADER - _REST:
            raise RecordError(
                f"The names of {len(table.columns)} columns take {size} characters, and at most {_HEADER - _REST} are "
                "read from a .npy file; choose columns, or write a .parquet file."
            )
        for name, values in table.columns.items():
            array[name] = values
        with path.open("wb") as file:
            # Into a file NumPy writes by C, and does not hear that the disk was full when the last bytes went out.
            np.save(SimpleNamespace(write=file.write), array, allow_pickle=False)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return any non-empty name; see `Format.legal_name`."""
        return name or "_"

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many."""
        layout = _read_layout(path)
        require_size(path, min(rows, layout.rows) * layout.columns)
        yield from split_rows(layout.rows, rows, layout.read)


@dataclass(frozen=True, slots=True)
class _Layout:
    """Offset, type and count of the rows of a file."""

    path: Path
    begin: int
    row: np.dtype[Any]
    rows: int

    @property
    def columns(self) -> int:
        return len(self.row.names or ())

    def read(self, first: int, count: int) -> Table:
        # Not mapped into memory: what is mapped counts as memory in use until somebody else asks for it.
        with self.path.open("rb") as file:
            file.seek(self.begin + first * self.row.itemsize)
            array = np.fromfile(file, dtype=self.row, count=count)
        return Table({name: array[name] for name in self.row.names or ()}, source=self.path.name)


def _read_layout(path: Path) -> _Layout:
    """Read the layout; refuse files that cannot be read by rows."""
    size = path.stat().st_size
    with path.open("rb") as file:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what Python's parser says of a damaged header on the side
                shape, by_column, dtype = _read_header(file)
        except (ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError) as error:
            said = str(error).partition("\n")[0] or type(error).__name__  # NumPy's advice is for programmers
            raise RecordError(f"{path.name} is no .npy file ({said}); write it by numpy.save.") from None
        begin = file.tell()
    wide = shape[1] * dtype.itemsize if len(shape) == 2 else 0
    if 0 < wide <= size and shape[1] > WIDEST:
        raise RecordError(
            f"{path.name} has {shape[1]} columns (at most {WIDEST} are read); is it a matrix that lies on its side? "
            "Write a row for each sample."
        )
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
    return _Layout(path, begin, row, int(shape[0]))


def _read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, column-major flag and element type.

    Raises:
        ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError: invalid header.
    """
    version = np.lib.format.read_magic(file)
    if version not in _VERSIONS:
        raise ValueError(f"its version is {version[0]}.{version[1]}")
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file, _HEADER)
    shape, by_column, dtype = np.lib.format.read_array_header_2_0(file, _HEADER)
    if version == (3, 0) and dtype.names:  # as 2.0, but for names in UTF-8
        dtype.names = tuple(name.encode("latin-1").decode() for name in dtype.names)
    return shape, by_column, dtype
