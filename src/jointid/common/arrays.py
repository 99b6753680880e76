"""The type of every array of numbers in the package, and the scaling of columns."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]


def column_norms(columns: FloatArray) -> FloatArray:
    """Return the length of each column, (columns,), and 1 for a column of zeros: what columns are divided by.

    A regressor's columns differ by powers of ten, as their units do; divided by their lengths they have the least
    condition number that a scaling can give them, to within the root of their count (van der Sluis 1969).

    Args:
        columns: (rows, columns).
    """
    norms = np.linalg.norm(columns, axis=0)
    return np.where(norms > 0, norms, 1.0)
