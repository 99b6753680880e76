"""Linear least squares by QR, and instrumental variables.

Instrumental variables solve ``Z' e = 0`` with instruments Z that are uncorrelated with the disturbance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds
from jointid.solvers.solve import Counted, InstrumentProblem, Solution, Status, Step, Watch

_RANK = 1e-10  # of the largest: a normalised singular value below this is a parameter nothing excites
_TOLERANCE = 0.05  # of the deviations
_WHOLE = 6  # steps; then halves of them, since where a direction flips they may go round in circles
_LONGEST = 0.3  # of a parameter that keeps its sign: the longest step


@dataclass(frozen=True, slots=True)
class Conditioning:
    """The condition number of a regressor, by three definitions.

    Attributes:
        raw: of the columns as they are; depends on the units.
        normalised: of the columns divided by their norms.
        scaled: of the columns multiplied by the estimates: what each parameter contributes to the torque.
    """

    raw: float
    normalised: float
    scaled: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The least-squares solution of ``Y = W x``.

    Attributes:
        values: (parameters,) the solution.
        std: (parameters,) standard deviations, for a white residual of `sigma`.
        residual: (rows,) Y - W x.
        sigma: standard deviation of the residual.
        relative_error: ``||Y - W x|| / ||Y||``, a ratio.
        conditioning: of W.
    """

    values: FloatArray
    std: FloatArray
    residual: FloatArray
    sigma: float
    relative_error: float
    conditioning: Conditioning


def least_squares(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> Fit:
    """Solve ``Y = W x`` by QR with column scaling.

    Args:
        W: (rows, parameters).
        Y: (rows,).
        names: of the parameters, for the error.

    The variance of the residual is ``||Y - W x||^2 / (r - b)`` for r rows and b parameters. (The EMPS report takes
    the sample variance, r - 1: a relative difference of (b - 1) / 2r in the deviations, 0.06 % there.)
    """
    rows, count = W.shape
    values, norms, R = _solve(W, Y, names)
    residual = Y - W @ values
    sigma = float(np.linalg.norm(residual) / np.sqrt(rows - count))
    spread = np.linalg.norm(np.linalg.inv(R), axis=1) / norms
    error = float(np.linalg.norm(residual) / np.linalg.norm(Y))
    scale = np.where(values == 0.0, 1.0, np.abs(values))
    conditioning = Conditioning(*(float(np.linalg.cond(R * by)) for by in (norms, 1.0, norms * scale)))
    return Fit(values, sigma * spread, residual, sigma, error, conditioning)


def solution(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Solution of `least_squares`, parameters only, (parameters,)."""
    return _solve(W, Y, names)[0]


def _solve(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the solution, the column norms and the triangle of the scaled columns."""
    rows, count = W.shape
    if rows <= count:
        raise MethodError(
            f"{rows} filtered samples cannot determine {count} parameters; use a longer record or decimate less."
        )
    refuse_idle(W, names)
    norms = np.linalg.norm(W, axis=0)
    Q, R = np.linalg.qr(W / norms)
    _, sizes, directions = np.linalg.svd(R)  # the triangle of columns of norm 1 has their singular values
    if not sizes[-1] > _RANK * sizes[0]:
        involved = [name for name, share in zip(names, directions[-1], strict=True) if abs(share) > 1e-3]
        raise MethodError(
            f"{', '.join(involved)} cannot be distinguished in this record (their columns are collinear); fix one of "
            "them."
        )
    return np.linalg.solve(R, Q.T @ Y) / norms, norms, R


def refuse_idle(columns: FloatArray, names: tuple[str, ...]) -> None:
    """Refuse columns (rows, parameters) of zeros; the sentence names the parameters."""
    norms = np.linalg.norm(columns, axis=0)
    idle = [name for name, norm in zip(names, norms, strict=True) if not norm > 0]
    if idle:
        raise MethodError(
            f"Nothing in this record excites {', '.join(idle)}; fix {'it' if len(idle) == 1 else 'them'}, or use a "
            "motion that moves at several speeds, both ways; if it does, correct units, gains and sides of the loop."
        )


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
        """Solve within the bounds; parameters at a bound stay there."""
        counted, bounds, x, trace = Counted.of(problem), Bounds.of(problem.free), start, list[Step]()
        before, status = counted.evaluations, Status.EVALUATION_LIMIT
        error, J = counted.linearise(x)
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
            error, J = counted.linearise(x)
            trace.append(Step(x, float(np.linalg.norm(error)), counted.evaluations))
            watch(trace[-1])
        message = status.sentence if status.converged else f"not converged: {status.sentence}"
        used = counted.evaluations - before
        return InstrumentalSolution(x, error, J, status, message, tuple(trace), used, moving=moving, instruments=Z)

    def _step(
        self, bounds: Bounds, x: FloatArray, error: FloatArray, J: FloatArray, Z: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return a limited step, (free,), and the parameters that it moves."""
        moving = ~self.kept & (np.linalg.norm(Z, axis=0) > 0) & (np.linalg.norm(J, axis=0) > 0)
        while True:
            step = np.zeros(x.size)
            step[moving] = -projection(Z[:, moving], J[:, moving]) @ error
            outwards = bounds.find_blocking(x, step)
            if not np.any(outwards):
                break
            moving &= ~outwards
        near = self.signed & (x != 0)  # at a bound of 0 there is no sign to keep
        far = float(np.max(np.abs(step[near]) / np.abs(x[near]), initial=0.0))
        return step * min(1.0, _LONGEST / max(far, 1e-300)), moving


def projection(Z: FloatArray, J: FloatArray) -> FloatArray:
    """Return ``(Z' J)^-1 Z'``, (parameters, rows), computed with scaled columns.

    A parameter with a zero column has a row of zeros.
    """
    of_Z, of_J = column_norms(Z), column_norms(J)
    scaled = np.linalg.pinv((Z / of_Z).T @ (J / of_J)) @ (Z / of_Z).T
    return np.asarray(scaled / of_J[:, np.newaxis])
