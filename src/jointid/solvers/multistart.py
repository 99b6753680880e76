"""The lowest of the ends that several starts lead to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.solve import Counted, Problem, Solution, Solver, Watch

_SAME = 1e-4  # of the criterion: two ends so near are one


@dataclass(frozen=True, slots=True)
class Multistart:
    """One solver, begun at several starts.

    Attributes:
        solver: of one start.
    """

    solver: Solver[Problem]

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Return the lowest end of several starts, (starts, free), and how many of them led there."""
        counted = Counted.of(problem)
        before = counted.evaluations
        ends = [self.solver.solve(counted, x, watch) for x in np.atleast_2d(start)]
        costs = [float(np.linalg.norm(end.residual)) ** 2 for end in ends]
        best = ends[int(np.argmin(costs))]
        same = sum(cost <= (1 + _SAME) * min(costs) for cost in costs)
        agreed = f" ({same} of {len(ends)} starts end there)" if len(ends) > 1 else ""
        used = counted.evaluations - before
        return replace(best, message=best.message + agreed, evaluations=used, starts=(same, len(ends)))
