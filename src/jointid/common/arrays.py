"""The type of every array of numbers in the package, the scaling of columns, and memory that is used again."""

from __future__ import annotations

import math
import threading
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]

_LINE = 64  # bytes of a cache line: rows of vectors begin with one
_WASTE = 4  # times what is needed: more is given back


def column_norms(columns: FloatArray) -> FloatArray:
    """Return the length of each column, (columns,), and 1 for a column of zeros: what columns are divided by.

    A regressor's columns differ by powers of ten, as their units do; divided by their lengths they have the least
    condition number that a scaling can give them, to within the root of their count (van der Sluis 1969).

    Args:
        columns: (rows, columns).
    """
    norms = np.linalg.norm(columns, axis=0)
    return np.where(norms > 0, norms, 1.0)


_BLOCK = 800  # rows, which with a few columns are too few for a linear algebra library to use threads


def triangle(columns: FloatArray) -> FloatArray:
    """Return the triangle R of ``columns = Q R``, (columns, columns) or as many rows as there are.

    A tall matrix is factorised in blocks of rows, and then the triangles of the blocks: as accurate, and no work for
    threads. On a machine that has other work they take a hundred times as long as the factorisation does.

    Demmel, Grigori, Hoemmen, Langou: Communication-optimal parallel and sequential QR and LU factorizations,
    SIAM J. Sci. Comput. 34 (2012), A206-A239.

    Args:
        columns: (rows, columns).
    """
    blocks, width = columns.shape[0] // _BLOCK, columns.shape[1]
    if blocks < 2 or width == 0 or 2 * width > _BLOCK:
        return np.asarray(np.linalg.qr(columns, mode="r"))
    whole = blocks * _BLOCK
    stacked = columns[:whole].reshape(blocks, _BLOCK, width)
    triangles = np.asarray(np.linalg.qr(stacked, mode="r")).reshape(-1, width)
    return triangle(np.vstack([triangles, columns[whole:]]))


class Room(threading.local):
    """Arrays by name, each thread its own; what one holds is lost as soon as its name is asked for again.

    A megabyte that is fresh from the system costs a page fault for every four kilobytes, together as long as a
    simulation takes to fill them.
    """

    def __init__(self) -> None:
        self._bytes: dict[str, NDArray[np.uint8]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
        """Return an array of undefined content that begins with a line of the cache.

        Args:
            name: of its use.
            shape: of the array.
            dtype: of its elements.
        """
        size = math.prod(shape) * np.dtype(dtype).itemsize
        held = self._bytes.get(name)
        if held is None or not size <= held.size <= _WASTE * (size + _LINE):
            held = self._bytes[name] = _aligned(size)
        return held[:size].view(dtype).reshape(shape)


class Fresh:
    """Arrays in memory of their own."""

    def array(self, name: str, shape: tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
        """Return an array of undefined content; the name does not matter."""
        return np.empty(shape, dtype)


def _aligned(size: int) -> NDArray[np.uint8]:
    room = np.empty(size + _LINE, dtype=np.uint8)
    first = -room.ctypes.data % _LINE
    return room[first : first + size]
