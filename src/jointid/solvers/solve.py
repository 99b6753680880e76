"""The verb `solve`: problems, solutions and several starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Bounds, Parameter

if TYPE_CHECKING:
    from jointid.solvers.bounded_least_squares import LevenbergMarquardt

_SAME = 1e-4  # of the criterion: two ends so near are one


class Problem(Protocol):
    """Maps free parameters to the filtered, decimated residual (measured less predicted)."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Identified parameters with bounds, in the order of vectors and columns."""

    def residual(self, x: FloatArray) -> FloatArray:
        """Residual, (rows,); large and finite where simulation fails."""

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual, (rows,), and derivatives, (rows, free); the latter 0 where simulation fails."""


class Status(Enum):
    """Why a solver ended."""

    STEP = "the parameters changed by less than the tolerance"
    COST = "the criterion changed by less than the tolerance"
    EXACT = "the measurement is reproduced to rounding"
    EVALUATION_LIMIT = "the limit on evaluations was reached"
    NO_DESCENT = "no step lowers the criterion, and yet it is not flat there"
    NOT_EVALUABLE = "the criterion cannot be evaluated at the start"

    @property
    def converged(self) -> bool:
        """Whether the solver succeeded."""
        return self in (Status.STEP, Status.COST, Status.EXACT)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One accepted step.

    Attributes:
        evaluations: of the problem up to then, in all that was solved with it.
    """

    x: FloatArray
    norm: float
    evaluations: int


Watch: TypeAlias = Callable[[Step], None]
"""Callback for every step."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of a solver.

    Attributes:
        x: the free parameters.
        residual: there, (rows,).
        jacobian: its derivatives, (rows, free).
        status: why it ended.
        message: the same with this solver's numbers, in a sentence.
        trace: the steps that led there.
        evaluations: of the problem.
        starts: how many starts led there, of how many.
    """

    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    status: Status
    message: str
    trace: tuple[Step, ...]
    evaluations: int
    starts: tuple[int, int] = (1, 1)

    @property
    def converged(self) -> bool:
        """Whether the solver succeeded."""
        return self.status.converged


@dataclass(slots=True)
class Tally:
    """An evaluation count that problems can share."""

    evaluations: int = 0


class Counted:
    """Wrapper that counts evaluations and caches the last linearised point.

    Attributes:
        tally: where its evaluations are counted, with or without derivatives.
    """

    def __init__(self, problem: Problem, tally: Tally | None = None) -> None:
        self.problem, self.tally = problem, tally or Tally()
        self._last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None

    @classmethod
    def of(cls, problem: Problem) -> Counted:
        """Wrap a problem, unless it counts already."""
        return problem if isinstance(problem, cls) else cls(problem)

    @property
    def evaluations(self) -> int:
        """Evaluations so far, of all problems that share the tally."""
        return self.tally.evaluations

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Identified parameters."""
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        self.tally.evaluations += 1
        return self.problem.residual(x)

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual, (rows,), and derivatives, (rows, free)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self.tally.evaluations += 1
            self._last = (x.copy(), self.problem.linearise(x))
        return self._last[1]

    def remember(self, x: FloatArray, residual: FloatArray, derivatives: FloatArray) -> None:
        """Cache the residual and derivatives at a point."""
        self._last = (x.copy(), (residual, derivatives))


def solve(problem: Problem, solver: LevenbergMarquardt, start: FloatArray, watch: Watch = lambda _: None) -> Solution:
    """Solve a problem from a start, or from several, and return the best end.

    Args:
        problem: left unchanged; a `Counted` one keeps its count and cache.
        solver: with its settings.
        start: (free,) or (starts, free), clipped to the bounds.
        watch: callback for every step.
    """
    counted, bounds = Counted.of(problem), Bounds.of(problem.free)
    before = counted.evaluations
    starts = np.atleast_2d(np.asarray(start, dtype=np.float64))
    ends = [solver.solve(counted, bounds.clip(x), watch) for x in starts]
    costs = [float(np.linalg.norm(end.residual)) ** 2 for end in ends]
    best = ends[int(np.argmin(costs))]
    same = sum(cost <= (1 + _SAME) * min(costs) for cost in costs)
    agreed = f" ({same} of {len(ends)} starts end there)" if len(ends) > 1 else ""
    used = counted.evaluations - before
    return replace(best, message=best.message + agreed, evaluations=used, starts=(same, len(ends)))
