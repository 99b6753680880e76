"""Bounded least squares by Levenberg and Marquardt's steps, each of them exact within the bounds.

Every step is the minimum of the damped linear problem inside the bounds (SciPy's bounded-variable least squares on the
small triangular factor). A trust region reflects at a bound: where a Coulomb friction belongs on its bound of 0, as
where a real friction law is not that of the model, it creeps towards it for a hundred evaluations; this takes ten.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.solve import Bounds, Counted, Problem, Solution, Status, Step, Watch, explain

_DAMPING, _LEAST, _MOST = 1e-3, 1e-12, 1e12  # of the first step, in columns of norm 1; and its range
_EASIER, _HARDER = 0.1, 5.0  # factors on the damping after a step that went down, and one that did not
_IDLE = 1e-2  # of the residual


@dataclass(frozen=True, slots=True)
class LevenbergMarquardt:
    """Settings of bounded least squares by Levenberg-Marquardt.

    Attributes:
        tolerance: relative, on the criterion and the parameters.
        evaluations: at most, each with the derivatives.
    """

    tolerance: float = 1e-8
    evaluations: int = 60

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Return where one descent ends; the trace begins with the start."""
        counted, bounds, x = Counted.of(problem), Bounds.of(problem.free), start
        before = counted.evaluations
        error, J = counted.linearised(x)
        trace, damping, used = [Step(x, float(np.linalg.norm(error)), counted.evaluations)], _DAMPING, 1
        status = None if J.any() else Status.NOT_EVALUABLE
        while status is None and used < self.evaluations:
            norm = trace[-1].norm
            step = _step(error, J, bounds.around(x), damping)
            after, slopes = counted.linearised(x + step)
            used += 1
            gained = 1.0 - (float(np.linalg.norm(after)) / norm) ** 2 if norm else 0.0
            small = bool(np.all(np.abs(step) <= self.tolerance * np.abs(x)))
            if gained > 0.0:
                x, error, J = x + step, after, slopes
                trace.append(Step(x, float(np.linalg.norm(error)), counted.evaluations))
                watch(trace[-1])
            # A step that had to be damped so much is short for another reason than that the end is near.
            if damping <= 1.0 and small:
                status = Status.STEP
            elif damping <= 1.0 and abs(gained) <= self.tolerance:
                status = Status.COST
            elif damping >= _MOST:
                status = Status.NO_DESCENT
            damping = max(damping * _EASIER, _LEAST) if gained > 0.0 else damping * _HARDER
        status = status or Status.EVALUATION_LIMIT
        message = explain(status, used, self.tolerance)
        return Solution(x, error, J, status, message, tuple(trace), counted.evaluations - before)


def _step(error: FloatArray, J: FloatArray, room: Bounds, damping: float) -> FloatArray:
    """Return what minimises ``||e + J s||^2 + damping ||D s||^2`` within bounds, D the norms of the columns."""
    from scipy.optimize import lsq_linear

    norms = np.linalg.norm(J, axis=0)
    # What moves nothing, from bound to bound, is not moved.
    idle = norms * np.where(norms > 0, room.upper - room.lower, 0.0) <= _IDLE * np.linalg.norm(error)
    J, norms = np.where(idle, 0.0, J), np.where(idle, 1.0, norms)
    Q, R = np.linalg.qr(J / norms)
    matrix = np.vstack([R, np.sqrt(damping) * np.eye(norms.size)])
    target = np.concatenate([-Q.T @ error, np.zeros(norms.size)])
    found = lsq_linear(matrix, target, (room.lower * norms, room.upper * norms), method="bvls")
    return room.clip(found.x / norms)
