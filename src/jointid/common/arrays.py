"""Array types, column scaling and reusable buffers."""

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


_BLOCK = 800  # rows, which with a few columns are too few for a linear algebra library to use threads


def triangle(columns: FloatArray) -> FloatArray:
    """Return the factor R of ``columns = Q R``, computed in blocks of rows.

    Blocks are as accurate as one factorisation, and keep BLAS from starting threads, which are slow on a busy machine.
    Demmel, Grigori, Hoemmen, Langou: Communication-optimal parallel and sequential QR and LU factorizations,
    SIAM J. Sci. Comput. 34 (2012), A206-A239.
    """
    blocks, width = columns.shape[0] // _BLOCK, columns.shape[1]
    if blocks < 2 or width == 0 or 2 * width > _BLOCK:
        return np.asarray(np.linalg.qr(columns, mode="r"))
    whole = blocks * _BLOCK
    stacked = columns[:whole].reshape(blocks, _BLOCK, width)
    triangles = np.asarray(np.linalg.qr(stacked, mode="r")).reshape(-1, width)
    return triangle(np.vstack([triangles, columns[whole:]]))


def orthonormal_basis(columns: FloatArray, lost: float, largest: float | None = None) -> FloatArray:
    """Return an orthonormal basis, (rows, rank), of columns that may be collinear.

    Args:
        columns: (rows, columns).
        lost: relative tolerance; smaller singular values of the normalised columns count as 0.
        largest: reference singular value instead of the largest; the columns are then not normalised.
    """
    columns = columns / column_norms(columns) if largest is None else columns
    _, sizes, vectors = np.linalg.svd(triangle(columns), full_matrices=False)
    kept = sizes > lost * (np.max(sizes, initial=0.0) if largest is None else largest)
    found = columns @ (vectors[kept].T / sizes[kept])
    # Directions of small singular values are orthogonal to rounding over that value: a step of Newton's squares it.
    return np.asarray(found @ (1.5 * np.eye(found.shape[1]) - 0.5 * found.T @ found))


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
