"""NumPy files (.npy): a record array or a plain matrix, never objects.

Rows are at known offsets, which makes chunks fast.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tokenize import TokenError
from types import SimpleNamespace
from typing import IO, Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
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

_VERSIONS = ((1, 0), (2, 0), (3, 0))
_HEADER, _REST = 2**16, 2**8  # characters of the header, for more than a thousand columns, and of its other entries


@dataclass(frozen=True, slots=True)
class Npy:
    """NumPy's .npy: a record array, or a matrix whose longer side are the samples.

    Matrix columns are numbered from "1". Sides of one number do not count. Fields of text are passed over.
    """

    name: ClassVar[str] = "NPY"
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        layout = _read_layout(path)
        require_size(path, layout.rows * layout.columns)
        return layout.read(0, layout.rows)

    def write(self, path: Path, table: Table) -> None:
        """Write a record array of float64 fields; scalars are refused."""
        require_one_length(table, self.name)
        require_no_scalars(table, self.name)
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

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many."""
        layout = _read_layout(path)
        require_size(path, min(rows, layout.rows) * layout.columns)
        yield from split_rows(layout.rows, rows, layout.read)


@dataclass(frozen=True, slots=True)
class _Layout:
    """Offset, type and count of the samples of a file.

    Attributes:
        row: of a sample, or of a number where each channel follows the one before.
        names: of the columns.
        planes: how many channels follow one another; 1 where the numbers of a sample are together.
        passed: see `Table`.
    """

    path: Path
    begin: int
    row: np.dtype[Any]
    rows: int
    names: tuple[str, ...]
    planes: int = 1
    passed: Mapping[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> int:
        return len(self.names)

    def read(self, first: int, count: int) -> Table:
        found: dict[str, FloatArray] = {}
        for plane in range(self.planes):
            values, origin = self._load(plane, first, count), self._load(plane, 0, 1)
            if self.row.names is None:
                numbers = to_numbers(values, origin).reshape(count, -1)
                found |= zip(self.names[plane:] if self.planes > 1 else self.names, numbers.T, strict=False)
            for name in self.row.names or ():
                if name not in self.passed:
                    numbers = to_numbers(values[name], origin[name]).reshape(count, -1)
                    found |= zip(_field_names(name, values[name].shape[1:]), numbers.T, strict=True)
        return Table(found, source=self.path.name, passed=self.passed)

    def _load(self, plane: int, first: int, count: int) -> np.ndarray[Any, Any]:
        # Not mapped into memory: what is mapped counts as memory in use until somebody else asks for it.
        with self.path.open("rb") as file:
            file.seek(self.begin + (plane * self.rows + first) * self.row.itemsize)
            return np.fromfile(file, dtype=self.row, count=count)


def _field_names(name: str, shape: tuple[int, ...]) -> list[str]:
    width = math.prod(shape)
    return [name] if not shape else [f"{name}[{index}]" for index in range(width)]


def _read_layout(path: Path) -> _Layout:
    """Read the layout; refuse files that hold no numbers."""
    size = path.stat().st_size
    with path.open("rb") as file:
        try:
            shape, by_column, dtype = read_header(file)
        except HEADER_ERRORS as error:
            said = str(error).partition("\n")[0] or type(error).__name__  # NumPy's advice is for programmers
            raise RecordError(f"{path.name} is no .npy file ({said}); write it by numpy.save.") from None
        begin = file.tell()
    layout = _lay_out(path, begin, shape, by_column, dtype)
    if layout is None:
        raise RecordError(
            f"{path.name} holds {dtype} of shape {shape}; expected a record array of numbers, or a matrix of numbers "
            "whose longer side are the samples."
        )
    if layout.columns > WIDEST:
        raise RecordError(
            f"{path.name} has {layout.columns} columns (at most {WIDEST} are read); log fewer channels, or write them "
            "to several files."
        )
    stored = (size - begin) // (layout.row.itemsize * layout.planes)
    if stored < layout.rows:
        raise RecordError(f"{path.name} should hold {layout.rows} samples and has {stored}; log or copy it again.")
    return layout


def _lay_out(path: Path, begin: int, shape: tuple[int, ...], by_column: bool, dtype: np.dtype[Any]) -> _Layout | None:
    """Return the layout of the array of a header; None without numbers."""
    if not all(type(size) is int and size > 0 for size in shape) or dtype.hasobject or dtype.itemsize == 0:
        return None
    sides = [size for size in shape if size != 1]
    if dtype.names:
        names, passed = list[str](), dict[str, str]()
        for name in dtype.names:
            base, inner = dtype[name].subdtype or (dtype[name], ())
            if why := skip_reason(base):
                passed[name] = why
            elif math.prod(inner) > WIDEST:
                passed[name] = f"its rows are arrays of {math.prod(inner)} numbers"
            else:
                names += _field_names(name, inner)
        readable = len(sides) < 2 and names
        return _Layout(path, begin, dtype, math.prod(sides), tuple(names), 1, passed) if readable else None
    if skip_reason(dtype) or len(sides) > 2:
        return None
    # A matrix by columns lies in the file as its transpose does by rows.
    rows, width, turned = max(sides, default=1), math.prod(sides) // max(sides, default=1), sides != sorted(sides)[::-1]
    numbered = tuple(str(number) for number in range(1, min(width, WIDEST + 1) + 1))
    if width > 1 and (turned != by_column or width > WIDEST):
        return _Layout(path, begin, dtype, rows, numbered, width)
    return _Layout(path, begin, np.dtype((dtype, (width,))) if width > 1 else dtype, rows, numbered)


HEADER_ERRORS = (ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError)
"""What reading a damaged header raises."""


def read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, column-major flag and element type.

    Raises:
        ValueError, TypeError, SyntaxError, TokenError, MemoryError, RecursionError: invalid header.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what Python's parser says of a damaged header on the side
        version = np.lib.format.read_magic(file)
        if version not in _VERSIONS:
            raise ValueError(f"its version is {version[0]}.{version[1]}")
        if version == (1, 0):
            return np.lib.format.read_array_header_1_0(file, _HEADER)
        shape, by_column, dtype = np.lib.format.read_array_header_2_0(file, _HEADER)
        if version == (3, 0) and dtype.names:  # as 2.0, but for names in UTF-8
            dtype.names = tuple(name.encode("latin-1").decode() for name in dtype.names)
        return shape, by_column, dtype
