"""Instrumental variables: solve ``Z' e = 0`` with instruments Z that what disturbs the residual e cannot reach."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.solvers.solve import Bounds, Counted, InstrumentProblem, Solution, Status, Step, Watch

_TOLERANCE = 0.05  # of the deviations
_WHOLE = 6  # steps; then halves of them, since where a direction flips they may go round in circles
_LONGEST = 0.3  # of a parameter that keeps its sign: the longest step

Deviations: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Instruments, derivatives and residual in, what the deviations of the parameters are, (parameters,), out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InstrumentalSolution(Solution):
    """The solution of ``Z' e = 0``.

    Attributes:
        moving: (free,) those that were solved for, the others being kept or at a bound.
        instruments: Z, (rows, free).
    """

    moving: NDArray[np.bool_]
    instruments: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentalVariables:
    """Settings of Newton's steps on the estimating equations of instrumental variables.

    Attributes:
        deviations: of the parameters; it ends where a step moves none by more than 5 % of its own.
        kept: (free,) parameters that are left where they start.
        signed: (free,) parameters whose sign must not change: a step moves none of them by more than 30 %.
        iterations: at most.
    """

    deviations: Deviations
    kept: NDArray[np.bool_]
    signed: NDArray[np.bool_]
    iterations: int = 25

    def solve(self, problem: InstrumentProblem, start: FloatArray, watch: Watch) -> InstrumentalSolution:
        """Return the solution within the bounds; a parameter that a step would lead beyond its bound stays there."""
        counted, bounds, x, trace = Counted.of(problem), Bounds.of(problem.free), start, list[Step]()
        before, status = counted.evaluations, Status.EVALUATION_LIMIT
        error, J = counted.linearised(x)
        while True:
            Z = problem.instruments(x)
            step, moving = self._step(bounds, x, error, J, Z)
            if not moving.any() and not trace:
                status = Status.NOT_EVALUABLE
            if status is not Status.EVALUATION_LIMIT or len(trace) == self.iterations:
                break
            step *= 0.5 if len(trace) >= _WHOLE else 1.0
            after = bounds.clip(x + step)
            spread = self.deviations(Z[:, moving], J[:, moving], error)
            if np.all(np.abs(after - x)[moving] <= _TOLERANCE * spread):
                status = Status.STEP
            x = after
            error, J = counted.linearised(x)
            trace.append(Step(x, float(np.linalg.norm(error)), counted.evaluations))
            watch(trace[-1])
        message = status.sentence if status.converged else f"not converged: {status.sentence}"
        used = counted.evaluations - before
        return InstrumentalSolution(x, error, J, status, message, tuple(trace), used, moving=moving, instruments=Z)

    def _step(
        self, bounds: Bounds, x: FloatArray, error: FloatArray, J: FloatArray, Z: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return a step, (free,), no longer than is allowed, and the parameters that it moves."""
        moving = ~self.kept & (np.linalg.norm(Z, axis=0) > 0) & (np.linalg.norm(J, axis=0) > 0)
        while True:
            step = np.zeros(x.size)
            step[moving] = -projection(Z[:, moving], J[:, moving]) @ error
            outwards = bounds.blocked(x, step)
            if not np.any(outwards):
                break
            moving &= ~outwards
        near = self.signed & (x != 0)  # at a bound of 0 there is no sign to keep
        far = float(np.max(np.abs(step[near]) / np.abs(x[near]), initial=0.0))
        return step * min(1.0, _LONGEST / max(far, 1e-300)), moving


def projection(Z: FloatArray, J: FloatArray) -> FloatArray:
    """Return ``(Z' J)^-1 Z'``, (parameters, rows), with columns of one size: their units differ by powers of ten."""
    of_Z, of_J = np.linalg.norm(Z, axis=0), np.linalg.norm(J, axis=0)
    scaled = np.linalg.pinv((Z / of_Z).T @ (J / of_J)) @ (Z / of_Z).T
    return np.asarray(scaled / of_J[:, np.newaxis])
