"""Gauss-Newton iteration, with derivatives or a regressor in their place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.regression import solution
from jointid.solvers.solve import Counted, Problem, Solution, Status, Step, Watch

_ROUNDING = 1e-10  # of the measurement: an error this small is rounding
_PATIENCE = 8  # iterations without a better one: an approximate Jacobian may well go round in circles


class Iterate(Protocol):
    """An iterate: parameters, residual and reference norm."""

    @property
    def x(self) -> FloatArray:
        """The free parameters."""

    @property
    def residual(self) -> FloatArray:
        """There, (rows,)."""

    @property
    def jacobian(self) -> FloatArray:
        """Derivatives of the residual, (rows, free)."""

    @property
    def norm(self) -> float:
        """Of the residual."""

    @property
    def scales(self) -> FloatArray:
        """Sizes of the first parameters; changes of the others do not count."""

    @property
    def evaluable(self) -> bool:
        """Whether the iteration can continue from here."""


_Iterate = TypeVar("_Iterate", bound=Iterate)


@dataclass(frozen=True, slots=True, eq=False)
class Ended(Generic[_Iterate]):
    """Final iterate and reason for stopping.

    Attributes:
        change: of the residual's norm in the last step, or foreseen for the next one, a share of it.
        step: the largest of a parameter, a share of its scale.
    """

    at: _Iterate
    status: Status
    change: float
    step: float


@dataclass(frozen=True, slots=True)
class GaussNewton:
    """Settings of Gauss-Newton.

    Attributes:
        tolerance: of the residual's norm, a share of it.
        step_tolerance: of every parameter, a share of its scale.
        iterations: at most.
        foreseen: whether the change that the next step would make is asked, which saves making it, or that of the last.
        worst: a step is halved while it leaves more than so many times the residual before it; with an approximate
            Jacobian, a little more is no reason to turn back.
        halvings: at most, of one step.
        size: norm of the measurement, of which the residual may be rounding; 0 does not ask.
    """

    tolerance: float = 1e-8
    step_tolerance: float = 1e-8
    iterations: int = 30
    foreseen: bool = False
    worst: float = 1.0
    halvings: int = 8
    size: float = 0.0

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Iterate exact steps; bounds are ignored."""
        counted, trace = Counted.of(problem), list[Step]()
        before, names = counted.evaluations, tuple(p.name for p in problem.free)

        def evaluate(x: FloatArray) -> _Point:
            return _Point(x, *counted.linearise(x))

        def step(at: _Point) -> FloatArray:
            return at.x - solution(at.jacobian, at.residual, names)

        def note(after: _Point, _: _Point) -> None:
            trace.append(Step(after.x, after.norm, counted.evaluations))
            watch(trace[-1])

        end = self.iterate(evaluate, evaluate(start), step, note)
        used, at = counted.evaluations - before, end.at
        return Solution(at.x, at.residual, at.jacobian, end.status, self.explain(end), tuple(trace), used)

    def iterate(
        self,
        evaluate: Callable[[FloatArray], _Iterate],
        at: _Iterate,
        step: Callable[[_Iterate], FloatArray],
        note: Callable[[_Iterate, _Iterate], None],
    ) -> Ended[_Iterate]:
        """Repeat a step until convergence; otherwise return the best iterate.

        Args:
            evaluate: parameters in, an iterate out.
            at: initial iterate.
            step: from an iterate to the next parameters.
            note: callback with every iterate and its predecessor.
        """
        best, since, change, largest = at, 0, np.inf, np.inf
        status = Status.EVALUATION_LIMIT
        for _ in range(self.iterations):
            if not at.evaluable:
                return Ended(at, Status.NOT_EVALUABLE, change, largest)
            if self._exact(at):
                break
            x = step(at)
            if self.foreseen:
                move = x - at.x
                norm = float(np.linalg.norm(at.residual + at.jacobian @ move))
                change, largest = abs(norm - at.norm) / at.norm, _largest(move, at.scales)
                if self._small(change, largest):
                    return Ended(at, Status.STEP_AND_COST, change, largest)
            before, at = at, self._advance(evaluate, at, x)
            note(at, before)
            change, largest = abs(at.norm - before.norm) / before.norm, _largest(at.x - before.x, at.scales)
            best, since = (at, 0) if at.norm < best.norm else (best, since + 1)
            if not self._exact(at) and self._small(change, largest):
                return Ended(at, Status.STEP_AND_COST, change, largest)
            if since >= _PATIENCE:
                status = Status.STALLED
                break
        if not best.evaluable:
            status = Status.NOT_EVALUABLE
        return Ended(best, Status.EXACT if self._exact(best) else status, change, largest)

    def explain(self, end: Ended[_Iterate]) -> str:
        """Return why it ended, in a sentence with its numbers."""
        if end.status is Status.EXACT:
            return end.status.sentence
        if not end.status.converged:
            return f"not converged: {end.status.sentence}"
        changed = "would change" if self.foreseen else "changed"
        return (
            f"converged: the residual {changed} by {100 * end.change:.1g} % (limit {100 * self.tolerance:g} %) and no "
            f"parameter by more than {100 * end.step:.1g} % (limit {100 * self.step_tolerance:g} %)"
        )

    def _advance(self, evaluate: Callable[[FloatArray], _Iterate], at: _Iterate, x: FloatArray) -> _Iterate:
        """Step to `x`, halved while evaluation fails or the residual grows too much."""
        after = evaluate(x)
        for _ in range(self.halvings):
            if after.evaluable and after.norm <= self.worst * at.norm:
                break
            after = evaluate(0.5 * (after.x + at.x))
        return after

    def _exact(self, at: Iterate) -> bool:
        """Test whether the residual is within rounding."""
        return at.norm <= _ROUNDING * self.size

    def _small(self, change: float, step: float) -> bool:
        return change <= self.tolerance and step <= self.step_tolerance


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray

    @property
    def norm(self) -> float:
        return float(np.linalg.norm(self.residual))

    @property
    def scales(self) -> FloatArray:
        return np.where(self.x != 0.0, np.abs(self.x), 1.0)

    @property
    def evaluable(self) -> bool:
        return bool(self.jacobian.any())


def _largest(move: FloatArray, scales: FloatArray) -> float:
    return float(np.max(np.abs(move[: scales.size]) / scales))
