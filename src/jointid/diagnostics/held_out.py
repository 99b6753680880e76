"""The parts of a record that are kept from a fit, so that what it foretells of them can be judged.

Parts of equal length would hold all that a motion shows in a few of them, where an axis rests or glides for most of a
record: half of the cut is by time, half by how much the torque changes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.estimation.problems.closed_loop import ClosedLoopProblem

PARTS, TIMES = 24, 3
"""Parts of a record, and fits, each without every third of them."""

FEWEST = 8 * PARTS
"""Rows that a record must have to be cut."""


def cut(problem: ClosedLoopProblem) -> NDArray[np.intp] | None:
    """Return the part that each row of a problem's residual is in, (rows,); None where there are too few."""
    torque = problem.filtered(problem.measured)
    change = np.square(np.diff(torque, prepend=torque[0]))
    rows = change.size
    if rows < FEWEST:
        return None
    share = 0.5 / rows + 0.5 * change / (float(np.sum(change)) or 1.0)
    return np.asarray(np.minimum((np.cumsum(share) - 0.5 * share) * PARTS, PARTS - 1), dtype=np.intp)
