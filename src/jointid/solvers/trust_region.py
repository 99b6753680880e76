"""Bounded least squares by SciPy's trust region (Branch, Coleman and Li 1999), and a stop that knows rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.solvers.solve import Bounds, Counted, Problem, Solution, Status, Step, Watch, explain

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

_THERE = 1e-2  # of a tolerance
_STATUS = {-2: Status.COST, 2: Status.COST, 3: Status.STEP, 4: Status.STEP_AND_COST}


@dataclass(frozen=True, slots=True)
class TrustRegion:
    """Settings of bounded least squares by a trust region.

    Attributes:
        tolerance: relative, on the parameters, and on the criterion unless `cost_tolerance` says otherwise.
        evaluations: at most, of the residual.
        cost_tolerance: relative, on the criterion.
        eager: whether every point that is tried is linearised, which also says when a step could gain no more than
            rounding; otherwise only a point that is accepted is, which is cheaper where many are refused.
        size: of the residual, which is searched in units of it, and every parameter in units of its start: then the
            search is the same in any units. None searches in the problem's own.
    """

    tolerance: float = 1e-8
    evaluations: int = 60
    cost_tolerance: float | None = None
    eager: bool = True
    size: float | None = None

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Return where one descent within the bounds ends; from where nothing can be evaluated there is none."""
        from scipy.optimize import least_squares

        counted, bounds, trace = Counted.of(problem), Bounds.of(problem.free), list[Step]()
        before, unit, size = counted.evaluations, np.ones(start.size), self.size or 1.0
        error, J = counted.linearised(start)
        status = None if J.any() else Status.NOT_EVALUABLE
        if self.eager and status is None and arrived(bounds, start, error, J, self.tolerance):
            status = Status.COST
        if status is not None:
            message = explain(status, 1, self.tolerance)
            return Solution(start, error, J, status, message, (), counted.evaluations - before)
        if self.size is not None:
            unit = _units(start, error, J)

        def residual(y: FloatArray) -> FloatArray:
            return (counted.linearised(y * unit)[0] if self.eager else counted.residual(y * unit)) / size

        def jacobian(y: FloatArray) -> FloatArray:
            return counted.linearised(y * unit)[1] * (unit / size)

        def step(intermediate_result: OptimizeResult) -> None:
            at = np.asarray(intermediate_result.x * unit)
            norm = size * math.sqrt(2 * float(intermediate_result.cost))
            trace.append(Step(at, norm, counted.evaluations))
            watch(trace[-1])
            if self.eager and arrived(bounds, at, *counted.linearised(at), self.tolerance):
                raise StopIteration

        scaled = bounds.in_units(unit)
        found = least_squares(
            residual, start / unit, jacobian, (scaled.lower, scaled.upper), x_scale="jac", xtol=self.tolerance,
            ftol=self.cost_tolerance or self.tolerance, gtol=None, max_nfev=self.evaluations, callback=step,
        )  # fmt: skip
        x, error, J = (np.asarray(part) for part in (found.x * unit, found.fun * size, found.jac * (size / unit)))
        status = _STATUS.get(int(found.status), Status.EVALUATION_LIMIT)
        message = explain(status, int(found.nfev), self.tolerance)
        return Solution(x, error, J, status, message, tuple(trace), counted.evaluations - before)


def arrived(bounds: Bounds, x: FloatArray, error: FloatArray, J: FloatArray, tolerance: float) -> bool:
    """Whether so much less than the tolerance could be gained that a step would only follow rounding.

    Args:
        bounds: of the parameters.
        x: (free,) where.
        error: (rows,) residual there.
        J: (rows, free) its derivatives.
        tolerance: relative, on the criterion.
    """
    moving = ~bounds.blocked(x, -(J.T @ error))
    columns = J[:, moving] / column_norms(J[:, moving])
    step = np.linalg.lstsq(columns, error, rcond=1e-12)[0]
    return bool(np.sum((columns @ step) ** 2) < _THERE * tolerance * max(float(error @ error), 1e-300))


def _units(x: FloatArray, error: FloatArray, J: FloatArray) -> FloatArray:
    """Return the size of every parameter: its start, or where that is 0 what moves the residual by itself."""
    norms = np.linalg.norm(J, axis=0)
    sizes = float(np.linalg.norm(error)) / np.where(norms > 0, norms, np.inf)
    return np.where(x != 0.0, np.abs(x), np.where(sizes > 0, sizes, 1.0))
