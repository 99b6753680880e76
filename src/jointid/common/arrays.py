"""Array types, column scaling, orthonormal bases and reusable buffers."""

from __future__ import annotations

import math
import threading
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]

_LINE = 64  # bytes of a cache line, to which buffers are aligned


def column_norms(columns: FloatArray) -> FloatArray:
    """Column norms, (columns,), with 1 for zero columns.

    Dividing by them gives the least condition number that scaling can, within the root of the number of columns
    (van der Sluis 1969).
    """
    norms = np.linalg.norm(columns, axis=0)
    return np.where(norms > 0, norms, 1.0)


def orthonormal_basis(columns: FloatArray, lost: float) -> FloatArray:
    """Return an orthonormal basis, (rows, rank), of columns that may be collinear.

    Args:
        columns: (rows, columns).
        lost: relative tolerance; smaller singular values of the normalised columns count as 0.
    """
    basis, sizes, _ = np.linalg.svd(columns / column_norms(columns), full_matrices=False)
    return np.asarray(basis[:, sizes > lost * np.max(sizes, initial=0.0)])


class Room(threading.local):
    """Reusable buffers by name, separate for each thread."""

    def __init__(self) -> None:
        self._bytes: dict[str, NDArray[np.uint8]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
        """Return an uninitialised, cache-aligned array, invalidating the previous one of that name."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        held = self._bytes.get(name)
        if held is None or not size <= held.size <= 4 * (size + _LINE):  # larger ones are given back
            room = np.empty(size + _LINE, dtype=np.uint8)
            first = -room.ctypes.data % _LINE
            held = self._bytes[name] = room[first : first + size]
        return held[:size].view(dtype).reshape(shape)
