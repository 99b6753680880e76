"""The parts of a record that are kept from a fit, so that what it predicts of them can be judged.

Parts of equal length would hold all that a motion shows in a few of them, where an axis rests or glides for most of a
record: half of the cut is by time, half by how much the torque changes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem

PARTS, TIMES = 24, 3
"""Parts of a record, at most, and fits, each without every third of them."""

FEWEST = 8 * PARTS
"""Rows that a record must have to be cut."""


def cut(problem: ClosedLoopProblem) -> NDArray[np.intp] | None:
    """Return the part that each row of a problem's residual is in, (rows,), from 0; None where there are too few rows.

    There are fewer parts where all that changes does so within a few rows.
    """
    torque = problem.filtered(problem.measured)
    change = np.square(np.diff(torque, prepend=torque[0]))
    rows = change.size
    if rows < FEWEST:
        return None
    share = 0.5 / rows + 0.5 * change / (float(np.sum(change)) or 1.0)
    place = np.minimum((np.cumsum(share) - 0.5 * share) * PARTS, PARTS - 1).astype(np.intp)
    return np.unique(place, return_inverse=True)[1]


def squares_of(error: FloatArray, parts: NDArray[np.intp], least: float = 0.0) -> FloatArray:
    """Return the sum of the squares of an error, (rows,), in each part, (parts,), with `least` added to each."""
    return np.asarray(np.bincount(parts, weights=error**2) + least)


def mean_logarithm(squares: FloatArray, others: FloatArray) -> tuple[float, float]:
    """Return the mean, and its standard error, of the logarithms of sums of squares over others, (parts,)."""
    seen = (squares > 0) & (others > 0)
    ratio = np.log(squares[seen] / others[seen])
    if ratio.size < 2:
        return 0.0, 0.0
    return float(np.mean(ratio)), float(np.std(ratio, ddof=1)) / math.sqrt(ratio.size)
