"""What every search is, and what its runs come to: seconds, simulations, and whether they ended where the best did."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.problem import Array
from benchmarks.results import Solver
from jointid.estimation.problems.closed_loop import ClosedLoopProblem

SAME = 1e-3
"""Of the criterion: an end that is no further above the lowest one is the same minimum."""

Search = Callable[[ClosedLoopProblem, Array], tuple[Array, int]]
"""From a problem and a start to an end, and the simulations it took."""


def timed(search: Search, problem: ClosedLoopProblem, start: Array) -> tuple[float, int, float]:
    """Return seconds, simulations, and the share of the torque that is left, of one search."""
    begin = time.perf_counter()
    end, simulations = search(problem, start)
    took = time.perf_counter() - begin
    size = float(np.linalg.norm(problem.filter(problem.measured)))
    return took, simulations, float(np.linalg.norm(problem.residual(end))) / size


def summed(title: str, runs: list[tuple[float, int, float]], best: float, note: str = "") -> Solver:
    """Return what all runs of one search came to; `best` is the least share of the torque that any search left."""
    seconds, simulations, left = zip(*runs, strict=True)
    found = tuple(bool(share**2 <= (1 + SAME) * best**2) for share in left)
    return Solver(title, len(runs), seconds, simulations, left, found, note)
