"""Tables of columns, common to all formats, and bounds on their size."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short

WHOLE = 2**30
"""Most bytes of numbers of a table, 1 GiB: 13 columns of 10 million rows. Reading may take twice that."""

WIDEST = 10_000
"""Most columns of a table, each of which is a separate array; no drive logs so many."""

TIME_NAME = re.compile(r"(?:t|time)\s*(?:[\[(].*[\])])?", re.IGNORECASE)
"""Name of a column that is the time by default."""

STAMP_NAME = re.compile(r"(?:t|time|timestamps?|stamps?|zeit)\s*(?:[\[(].*[\])])?", re.IGNORECASE)
"""Name of a column that is recognised as time in an inspected file, or in a log of several files."""

_FEW = 3  # skipped columns that a sentence names
_QUOTED = 100  # characters of a name
_LISTED = 20  # columns that a message lists; some MAT files have thousands
_WIDEST_MATRIX = 1000  # most columns of a matrix; a wider one is a picture
_REAL, _INSTANTS = "fiub", "mM"  # NumPy kinds that are converted to numbers
_KINDS = {"U": "text", "S": "text", "c": "complex numbers"}  # kinds that are not


@dataclass(slots=True, eq=False)
class Table:
    """The numbers of one file, by name.

    Attributes:
        columns: name -> values of shape (samples,), in file order, read-only, NaN for missing
            numbers; the columns of one file can differ in length.
        source: the file's name, for reports and errors.
        units: name -> unit of a column in the file's spelling, if stated.
        passed: name -> reason for skipping this content.
        clocks: name of a column -> name of its time column, in a file with several clocks.
        numbers: number of values of all columns.

    Raises:
        RecordError: a column is not one-dimensional, or is empty.
    """

    columns: dict[str, FloatArray] = field(default_factory=dict)
    source: str = ""
    units: dict[str, str] = field(default_factory=dict)
    passed: dict[str, str] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    numbers: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        given, self.columns = self.columns, {}
        for name, values in given.items():
            self.add(name, values if not values.flags.writeable else values.copy())

    def take(self, name: str, array: np.ndarray[Any, Any], unit: str = "") -> None:
        """Add the columns of an array, or the reason for skipping it."""
        require_room(self.source, self.numbers + array.size * len(array.dtype.names or " "))
        for column, view in find_columns(name, array, self.passed).items():
            self.add(column, to_numbers(view), unit)

    def add(self, name: str, values: FloatArray, unit: str = "", clock: str = "") -> None:
        """Add a column, which becomes read-only; the caller must not change it."""
        if name in self.columns:
            raise RecordError(f"{self.source} has more than one column called {name!r}; rename them.")
        values = np.asarray(values, dtype=np.float64)
        if values.ndim != 1 or values.size == 0:
            raise RecordError(f'Column "{name}" has shape {values.shape}; give a non-empty array of one dimension.')
        values.flags.writeable = False
        self.columns[name] = values
        self.numbers += values.size
        require_room(self.source, self.numbers, len(self.columns))
        self.units |= {name: unit} if unit else {}
        self.clocks |= {name: clock} if clock else {}

    def require_numbers(self) -> Table:
        """Return the table if it holds numbers.

        Raises:
            RecordError: the table is empty.
        """
        if not self.columns:
            listed = "; ".join(f"{name!r}: {why}" for name, why in list(self.passed.items())[:_FEW])
            said = f" ({listed})" if listed else ""
            raise RecordError(f"{self.source} holds no numbers{said}; log the signals as columns of numbers.")
        return self

    def list_columns(self) -> str:
        """List the first column names, quoted."""
        names = list(self.columns)
        rest = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return (", ".join(f'"{short(name, _QUOTED)}"' for name in names[:_LISTED]) or "none") + rest

    def explain_missing(self, names: Iterable[str]) -> str:
        """Return the known reasons for missing columns, in brackets."""
        known = [self.passed[name] for name in names if name in self.passed]
        return f" ({'; '.join(known)})" if known else ""

    @property
    def rows(self) -> int:
        """Number of rows of the longest column."""
        return max((values.size for values in self.columns.values()), default=0)


def join_tables(tables: Iterable[Table]) -> Table:
    """Concatenate tables; drop columns that are not in all of them."""
    every, numbers = list[Table](), 0
    for table in tables:
        every.append(table)
        numbers += table.numbers
        require_room(table.source, numbers)
    if len(every) == 1:
        return every[0]
    shared = [name for name in every[0].columns if all(name in table.columns for table in every)]
    joined = replace(every[0], columns={}, passed={name: why for table in every for name, why in table.passed.items()})
    joined.clocks = {name: clock for name, clock in every[0].clocks.items() if clock in shared}
    for name in shared:
        joined.add(name, np.concatenate([table.columns[name] for table in every]))
    return joined


def find_columns(name: str, array: np.ndarray[Any, Any], passed: dict[str, str]) -> dict[str, np.ndarray[Any, Any]]:
    """Return an array's columns as views by name, or a reason.

    Samples are along the longest axis, the first one of a square. Axes of length 1 are ignored: an array 1 x 1 x N is
    a column. A record array gives "name.field". The columns of an unnamed matrix are "1", "2", ...
    """
    if array.dtype.names:
        parts = ((f"{name}.{part}" if name else part, array[part]) for part in array.dtype.names)
        return {column: view for part in parts for column, view in find_columns(*part, passed).items()}
    sides = [size for size in array.shape if size != 1]
    is_number = array.dtype.kind in _REAL + _INSTANTS
    is_wide = len(sides) == 2 and min(sides) > (_WIDEST_MATRIX if name else WIDEST)
    if not is_number or 0 in sides or len(sides) > 2 or is_wide:
        shape = f"it has the shape {array.shape}" if array.size else "it is empty"
        passed[name or "the array"] = shape if is_number else f"it holds {_KINDS.get(array.dtype.kind, 'objects')}"
        return {}
    if len(sides) < 2:
        return {name or "1": array.reshape(-1)}
    matrix = array.reshape(sides)
    channels = matrix if sides[1] > sides[0] else matrix.T
    return {f"{name}[{k}]" if name else str(k + 1): channel for k, channel in enumerate(channels)}


def to_numbers(values: np.ndarray[Any, Any], first: np.ndarray[Any, Any] | None = None) -> FloatArray:
    """Convert values to numbers, instants and durations to seconds."""
    if values.dtype.kind not in _INSTANTS:
        return values.astype(np.float64)
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)] if first is None else first
        values = values - (known.ravel()[0] if known.size else np.datetime64(0, "s"))
    return np.asarray(values / np.timedelta64(1, "s"), dtype=np.float64)


def require_room(source: str, numbers: int, columns: int = 0) -> None:
    """Refuse a file that declares too many numbers or columns."""
    if 8 * numbers > WHOLE or columns > WIDEST:
        raise RecordError(
            f"{source} declares {8 * numbers / 2**30:.3g} GiB of numbers, or {columns} columns (at most 1 GiB and "
            f"{WIDEST} are read); log fewer channels, or read it in chunks with jointid identify --window."
        )
