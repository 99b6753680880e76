"""The way down a criterion with exact derivatives, within bounds, from several starts.

Levenberg-Marquardt in which every step is the exact minimum of the damped linear problem inside the bounds (SciPy's
bounded-variable least squares on the small triangular factor). SciPy's own trust region reflects at a bound: where a
Coulomb friction belongs on its bound of 0, as where a real friction law is not that of the model, it creeps towards it
for a hundred evaluations; this takes ten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.progress import Progress
from jointid.models.parameters import Parameter
from jointid.solvers.criterion import Criterion

_EVALUATIONS = 60  # of one descent
_DAMPING, _LEAST, _MOST = 1e-3, 1e-12, 1e12  # of the first step, in columns of norm 1; and its range
_EASIER, _HARDER = 0.1, 5.0  # factors on the damping after a step that went down, and one that did not
_IDLE = 1e-2  # of the residual
_THERE = 1e-2  # of a tolerance
_SAME = 1e-4  # of the criterion: two ends so near are one


@dataclass(frozen=True, slots=True, eq=False)
class Bottom:
    """Where a descent ended.

    Attributes:
        x: the free parameters.
        error: residual there, (rows,); J: its derivatives, (rows, free).
        evaluations: of the criterion with its derivatives, all starts together.
        stop: why it ended, in a sentence; converged: whether that is a good end.
        path: the parameters at every step of the best descent; norms: of the residual there.
    """

    x: FloatArray
    error: FloatArray
    J: FloatArray
    evaluations: int
    stop: str
    converged: bool
    path: tuple[FloatArray, ...]
    norms: tuple[float, ...]


def arrived(free: Sequence[Parameter], x: FloatArray, error: FloatArray, J: FloatArray, tolerance: float) -> bool:
    """Whether a start could gain so much less than the tolerance that a step from there would only follow rounding.

    Args:
        free: parameters, with their bounds.
        x: (free,) the start.
        error: (rows,) residual there.
        J: (rows, free) its derivatives.
        tolerance: relative, on the criterion.
    """
    lower, upper = (np.array([getattr(p, side) for p in free]) for side in ("lower", "upper"))
    slope = J.T @ error
    moving = ~(((x <= lower) & (slope > 0)) | ((x >= upper) & (slope < 0)))
    columns = J[:, moving] / np.maximum(np.linalg.norm(J[:, moving], axis=0), 1e-300)
    step = np.linalg.lstsq(columns, error, rcond=1e-12)[0]
    return bool(np.sum((columns @ step) ** 2) < _THERE * tolerance * max(float(error @ error), 1e-300))


def descend(criterion: Criterion, starts: Sequence[FloatArray], tolerance: float, progress: Progress) -> Bottom:
    """Go down from each start; return the lowest end, with how many of the starts led there.

    Args:
        criterion: what is minimised, within the bounds of its free parameters.
        starts: (free,) each.
        tolerance: relative, on the criterion and the parameters.
        progress: is told the residual of each step.
    """
    ends = [_descended(criterion, x, tolerance, progress) for x in starts]
    best = min(ends, key=lambda end: end.norms[-1])
    same = sum(end.norms[-1] ** 2 <= (1 + _SAME) * best.norms[-1] ** 2 for end in ends)
    agreed = f" ({same} of {len(ends)} starts end there)" if len(ends) > 1 else ""
    evaluations = sum(end.evaluations for end in ends)
    return Bottom(
        best.x, best.error, best.J, evaluations, best.stop + agreed, best.converged, best.path, best.norms
    )  # fmt: skip


def _descended(criterion: Criterion, x: FloatArray, tolerance: float, progress: Progress) -> Bottom:
    lower, upper = (np.array([getattr(p, side) for p in criterion.free]) for side in ("lower", "upper"))
    x = np.minimum(np.maximum(x, lower), upper)
    error, J = criterion.linearised(x)
    path, norms, damping, reason = [x], [float(np.linalg.norm(error))], _DAMPING, ""
    evaluations = 1
    while not reason and evaluations < _EVALUATIONS:
        step = _step(error, J, lower - x, upper - x, damping)
        after, slopes = criterion.linearised(x + step)
        evaluations += 1
        gained = 1.0 - (float(np.linalg.norm(after)) / norms[-1]) ** 2 if norms[-1] else 0.0
        small = bool(np.all(np.abs(step) <= tolerance * np.abs(x)))
        if gained > 0.0:
            x, error, J = x + step, after, slopes
            path.append(x)
            norms.append(float(np.linalg.norm(error)))
            progress(f"iteration {len(path) - 1}: residual {norms[-1]:.6g}")
        # A step that had to be damped so much is short for another reason than that the end is near.
        if damping <= 1.0 and small:
            reason = "the parameters"
        elif damping <= 1.0 and abs(gained) <= tolerance:
            reason = "the criterion"
        elif damping >= _MOST:
            break
        damping = max(damping * _EASIER, _LEAST) if gained > 0.0 else damping * _HARDER
    stop = f"converged: {reason} changed by less than {100 * tolerance:g} %"
    return Bottom(
        x, error, J, evaluations, stop if reason else f"not converged after {evaluations} evaluations", bool(reason),
        tuple(path), tuple(norms),
    )  # fmt: skip


def _step(error: FloatArray, J: FloatArray, lower: FloatArray, upper: FloatArray, damping: float) -> FloatArray:
    """Return what minimises ``||e + J s||^2 + damping ||D s||^2`` within bounds, D the norms of the columns."""
    from scipy.optimize import lsq_linear

    norms = np.linalg.norm(J, axis=0)
    # What moves nothing, from bound to bound, is not moved.
    idle = norms * np.where(norms > 0, upper - lower, 0.0) <= _IDLE * np.linalg.norm(error)
    J, norms = np.where(idle, 0.0, J), np.where(idle, 1.0, norms)
    Q, R = np.linalg.qr(J / norms)
    matrix = np.vstack([R, np.sqrt(damping) * np.eye(norms.size)])
    target = np.concatenate([-Q.T @ error, np.zeros(norms.size)])
    found = lsq_linear(matrix, target, (lower * norms, upper * norms), method="bvls")
    return np.asarray(np.minimum(np.maximum(found.x / norms, lower), upper))
