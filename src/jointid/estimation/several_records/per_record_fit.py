"""Each of several records by itself: a start for the fit of all of them, the level of its residual, what it says alone.

By itself a record is fitted as it will be with the others, by bounded least squares with the exact Jacobian, from what
its own identification found; only the gain of its drive, which no record tells alone, is kept at 1. Its residual gives
the weights of its rows in the fit of all records, and in another one of itself (`whitened`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import Problem
from jointid.estimation.problems.several_records import at_rows, several, whitening
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.descent import reason
from jointid.models.parameters import TORQUE_UNIT
from jointid.solvers.criterion import Criterion
from jointid.solvers.levenberg_marquardt import arrived
from jointid.uncertainty.covariance import bandwidth
from jointid.uncertainty.position_dependent_error import Repeatable, Uncertainty, cells, uncertainty

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

_TOLERANCE, _EVALUATIONS = 1e-10, 100
_NOTHING_LEFT = 1e-6  # of the torque: a residual below it is rounding, and no level


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where a descent ended.

    Attributes:
        x: the free parameters there.
        error, J: the residual and its derivatives, (rows,) and (rows, free).
        stop: why, in a sentence; converged: whether that is a good end.
        evaluations: it took.
    """

    x: FloatArray
    error: FloatArray
    J: FloatArray
    stop: str
    converged: bool
    evaluations: int


@dataclass(frozen=True, slots=True, eq=False)
class BySelf:
    """One record fitted by itself.

    Attributes:
        problem: what was solved, per torque of the log.
        end: its solution, in rows that are weighted.
        error: (rows,) its residual, not weighted.
        level: rms of the residual over its degrees of freedom.
        weights: taps of the filter that the rows go through.
        uncertainty: of the solution.
        repeatable: what of the residual repeats with the motion.
        simulations: that this took.
    """

    problem: Problem
    end: End
    error: FloatArray
    level: float
    weights: FloatArray
    uncertainty: Uncertainty
    repeatable: Repeatable
    simulations: int

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, the fixed ones too."""
        return self.problem.values(self.end.x)

    def acting(self, gain: float) -> dict[str, float]:
        """Return them with those of the joint per torque that acts, which is so many times the log's."""
        own = {p.name for p in self.problem.loop.joint.parameters}
        return {n: gain * v if n in own else v for n, v in self.values.items()} | {"drive_gain": gain}


def by_itself(problem: Problem, values: Mapping[str, float]) -> BySelf:
    """Fit one record, all of its rows weighing the same.

    Args:
        problem: of the record.
        values: where to begin, by name.
    """
    lower, upper = bounds(problem)
    end = descended(problem, np.clip(problem.vector(values), lower, upper))
    level = float(np.linalg.norm(end.error)) / math.sqrt(max(end.error.size - end.x.size, 1))
    judged, level = _judged(problem, end), max(level, _nothing(problem))
    weights = np.array([1.0 / level])
    return BySelf(problem, end, end.error, level, weights, judged, judged.repeatable, end.evaluations + 1)


def whitened(one: BySelf) -> BySelf:
    """Fit a record again, its rows weighted by the spectrum of its residual; one that leaves nothing stays as it is."""
    if one.level <= _nothing(one.problem):
        return one
    weights = whitening(one.error, one.level, bandwidth(one.error.size))
    end = descended(several([one.problem]).weighing([weights]), one.end.x)
    error, judged, used = one.problem.residual(end.x), _judged(one.problem, end), end.evaluations + 2
    return replace(one, end=end, error=error, weights=weights, uncertainty=judged, simulations=one.simulations + used)


def _nothing(problem: Problem) -> float:
    """Return the level of a residual that is as good as none."""
    return _NOTHING_LEFT * float(np.sqrt(np.mean(problem.filtered(problem.measured) ** 2)))


def _judged(problem: Problem, end: End) -> Uncertainty:
    where, joint = cells(*at_rows(problem, problem.simulate(end.x))), problem.loop.joint
    unit = joint.torque_unit or TORQUE_UNIT[joint.kind]
    return uncertainty(end.J, end.J, end.error, where, [p.name for p in problem.free], unit)


def starts(estimates: Sequence[Estimate]) -> list[dict[str, float]]:
    """Return the values each record starts from; one that it refused is another record's.

    Raises:
        MethodError: a parameter is refused by all of them.
    """
    every = [{p.name: p.value for p in e.params if p.value is not None} for e in estimates]
    anywhere = {name: value for each in reversed(every) for name, value in each.items()}
    lost = [p.name for p in estimates[0].params if p.name not in anywhere]
    if lost:
        raise MethodError(
            f"No record by itself tells {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [anywhere | each for each in every]


def bounds(criterion: Criterion) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper bounds of the free parameters, each (free,)."""
    return np.array([p.lower for p in criterion.free]), np.array([p.upper for p in criterion.free])


def descended(criterion: Criterion, x: FloatArray) -> End:
    """Go down from x by bounded least squares with the exact Jacobian."""
    from scipy.optimize import least_squares

    walk = _Walk(criterion)
    error, J = walk.residual(x), walk.jacobian(x)
    if arrived(criterion.free, x, error, J, _TOLERANCE):
        return End(x, error, J, *reason(2, 1, _TOLERANCE), walk.evaluations)

    def step(intermediate_result: OptimizeResult) -> None:
        at = intermediate_result.x
        if arrived(criterion.free, at, walk.residual(at), walk.jacobian(at), _TOLERANCE):
            raise StopIteration

    end = least_squares(
        walk.residual, x, walk.jacobian, bounds(criterion), x_scale="jac", xtol=_TOLERANCE, ftol=_TOLERANCE, gtol=None,
        max_nfev=_EVALUATIONS, callback=step,
    )  # fmt: skip
    stop, converged = reason(end.status, end.nfev, _TOLERANCE)
    return End(np.asarray(end.x), np.asarray(end.fun), np.asarray(end.jac), stop, converged, walk.evaluations)


class _Walk:
    """A criterion that, asked for both residual and derivatives at one point, is evaluated once, and counted."""

    def __init__(self, criterion: Criterion) -> None:
        self.criterion, self.evaluations = criterion, 0
        self._last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None

    def residual(self, x: FloatArray) -> FloatArray:
        return self._linearised(x)[0]

    def jacobian(self, x: FloatArray) -> FloatArray:
        return self._linearised(x)[1]

    def _linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._last is None or not np.array_equal(self._last[0], x):
            self.evaluations += 1
            self._last = (x.copy(), self.criterion.linearised(x))
        return self._last[1]
