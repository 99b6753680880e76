"""Arrays of any shape as columns: the samples run along the longest side."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray

REAL = "fiub"
"""Kinds of NumPy's types that are real numbers."""

READ = REAL + "mM"
"""Kinds of NumPy's types that become numbers: instants and durations, too."""

WIDEST_MATRIX = 1000
"""Columns of a matrix; one that is wider is a picture."""

_KINDS = {"S": "text", "U": "text", "O": "objects", "c": "complex numbers", "V": "records"}


class Sides(NamedTuple):
    """Samples and channels of an array.

    Attributes:
        turned: whether the samples run along the second of its sides that are longer than 1.
    """

    rows: int
    width: int
    turned: bool = False

    def names(self, name: str) -> tuple[str, ...]:
        """Return the names of the columns: `name`, or "name[0]", "name[1]", ..."""
        return (name,) if self.width == 1 else tuple(f"{name}[{index}]" for index in range(self.width))


def find_sides(shape: tuple[int, ...], *, square_turned: bool = False) -> Sides | str:
    """Find the samples of an array, or say why it has none.

    Sides of one number do not count: an array 1 x 1 x N is a column. Of a square matrix the samples run along the first
    side, unless `square_turned`.
    """
    sides = [size for size in shape if size != 1]
    if 0 in sides:
        return "it is empty"
    if len(sides) > 2:
        return f"it has {len(sides)} dimensions"
    if len(sides) < 2:
        return Sides(math.prod(sides), 1)
    if min(sides) > WIDEST_MATRIX:
        return f"it is a matrix of {sides[0]} x {sides[1]}"
    turned = sides[1] > sides[0] or (square_turned and sides[0] == sides[1])
    return Sides(max(sides), min(sides), turned)


def skip_reason(dtype: np.dtype[Any]) -> str | None:
    """Reason to pass over values of a type; None for those that become numbers."""
    return None if dtype.kind in READ else f"it holds {_KINDS.get(dtype.kind, 'no numbers')}"


def find_columns(name: str, array: np.ndarray[Any, Any], found: dict[str, FloatArray], passed: dict[str, str]) -> None:
    """Add the columns of an array to `found`, shape (samples,) each, or the reason to `passed`."""
    if array.dtype.names:
        for part in array.dtype.names:
            find_columns(f"{name}.{part}", array[part], found, passed)
        return
    sides = skip_reason(array.dtype) or find_sides(array.shape)
    if isinstance(sides, str):
        passed[name] = sides
        return
    matrix = to_numbers(array).reshape([size for size in array.shape if size != 1] or [1])
    columns = [matrix] if sides.width == 1 else matrix if sides.turned else matrix.T
    found.update(zip(sides.names(name), columns, strict=True))


def to_numbers(values: np.ndarray[Any, Any], first: np.ndarray[Any, Any] | None = None) -> FloatArray:
    """Return values as numbers; instants as seconds since the `first` one, durations as seconds."""
    if values.dtype.kind not in "mM":
        return values.astype(np.float64)
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)] if first is None else first
        values = values - (known.ravel()[0] if known.size else np.datetime64(0, "s"))
    seconds = values / np.timedelta64(1, "s")
    return np.asarray(seconds, dtype=np.float64)
