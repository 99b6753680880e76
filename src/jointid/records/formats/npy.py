"""NumPy files (.npy): a record array or a plain matrix, never objects; a piece is read when it is asked for."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.arrays import skip_reason, to_numbers
from jointid.records.formats.table import (
    WIDEST,
    Block,
    Table,
    require_no_scalars,
    require_one_length,
    require_size,
    split_rows,
)

HEADER = 2**16
"""Characters of the header of an array, for more than a thousand columns."""

_REST = 2**8  # characters of it beside the names of the columns


@dataclass(frozen=True, slots=True)
class Npy:
    """NumPy's .npy: a record array, or a matrix whose longer side are the samples.

    Matrix columns are numbered from "1". Sides of one number do not count. Fields of text are passed over.
    """

    name: ClassVar[str] = "NPY"
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        columns = _Columns.of(path)
        require_size(path, columns.rows * len(columns.views))
        return columns.read(0, columns.rows)

    def write(self, path: Path, table: Table) -> None:
        """Write a record array of float64 fields; scalars are refused."""
        require_one_length(table, self.name)
        require_no_scalars(table, self.name)
        array = np.empty(table.rows, dtype=[(name, "<f8") for name in table.columns])
        if (size := len(repr(array.dtype.descr))) > HEADER - _REST:
            raise RecordError(
                f"The names of {len(table.columns)} columns take {size} characters, and at most {HEADER - _REST} are "
                "read from a .npy file; choose columns, or write a .parquet file."
            )
        for name, values in table.columns.items():
            array[name] = values
        with path.open("wb") as file:
            # Into a file NumPy writes by C, and does not hear that the disk was full when the last bytes went out.
            np.save(SimpleNamespace(write=file.write), array, allow_pickle=False)

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many."""
        columns = _Columns.of(path)
        require_size(path, min(rows, columns.rows) * len(columns.views))
        yield from split_rows(columns.rows, rows, columns.read)


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns of a memory-mapped file.

    Attributes:
        views: (rows,) each, by name.
        passed: see `Table`.
    """

    path: Path
    rows: int
    views: dict[str, np.ndarray[Any, Any]]
    passed: dict[str, str]

    @classmethod
    def of(cls, path: Path) -> _Columns:
        """Open a file; refuse one that holds no numbers."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what Python's parser says of a damaged header on the side
            array: np.ndarray[Any, Any] = np.lib.format.open_memmap(path, mode="r", max_header_size=HEADER)
        samples = array.reshape([size for size in array.shape if size != 1] or [1])
        views, passed = dict[str, np.ndarray[Any, Any]](), dict[str, str]()
        if array.dtype.names and samples.ndim == 1:
            for name in array.dtype.names:
                field = samples[name]
                if why := skip_reason(field.dtype):
                    passed[name] = why
                elif field.ndim == 1:
                    views[name] = field
                elif (width := math.prod(field.shape[1:])) > WIDEST:
                    passed[name] = f"its rows are arrays of {width} numbers"
                else:
                    views |= {f"{name}[{k}]": one for k, one in enumerate(field.reshape(len(field), -1).T)}
        elif samples.ndim <= 2 and not skip_reason(array.dtype):
            channels = samples.T if samples.ndim == 2 and len(samples) >= samples.shape[1] else np.atleast_2d(samples)
            _require_narrow(path, len(channels))
            views = {str(number): one for number, one in enumerate(channels, start=1)}
        if not (views and array.size):
            raise RecordError(
                f"{path.name} holds {array.dtype} of shape {array.shape}; expected a record array of numbers, or a "
                "matrix of numbers whose longer side are the samples."
            )
        _require_narrow(path, len(views))
        return cls(path, max(samples.shape), views, passed)

    def read(self, first: int, count: int) -> Table:
        """Read so many rows; instants count from that of the file's first row."""
        found = {name: to_numbers(view[first : first + count], view[:1]) for name, view in self.views.items()}
        return Table(found, source=self.path.name, passed=self.passed)


def _require_narrow(path: Path, columns: int) -> None:
    if columns > WIDEST:
        raise RecordError(
            f"{path.name} has {columns} columns (at most {WIDEST} are read); log fewer channels, or write them to "
            "several files."
        )
