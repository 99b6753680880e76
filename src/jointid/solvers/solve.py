"""`solve`: bounded least squares by Levenberg-Marquardt, and linear ones by QR."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter

Linear: TypeAlias = tuple[FloatArray, FloatArray]
"""Residual, (rows,), and derivatives, (rows, free)."""

_DAMPING, _LEAST, _MOST = 1e-3, 1e-12, 1e12  # of the first step, in columns of norm 1; and its range
_EASIER, _HARDER = 0.1, 5.0  # factors on the damping after a step that went down, and one that did not
_SHORTER, _FARTHER, _NEAREST = 0.25, 2.0, 1e-3  # factors on the reach of a step, likewise; and its least
_PATIENCE = 8  # steps that change less than the tolerance
_RESOLVED = 1.5e-8  # relative decrease of the criterion that rounding can hide: the root of the machine precision
_FEW = 10  # evaluations that show where a search leads
_CUT = 0.999  # of its reach: a step that the reach has cut
_IDLE = 1e-2  # of the residual
_SAME = 0.1  # of what a linear model missed, and of a step: so far a kink explains it
_HELD = 1e4  # times the residual: what leaving a kink costs
_RANK = 1e-10  # of the largest: a normalised singular value below this is a parameter nothing excites
_LARGEST = 1e140  # of a residual and its derivatives: those of a loop that runs away have no squares


class Problem(Protocol):
    """Maps free parameters to the filtered, decimated residual (measured less predicted)."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Identified parameters with bounds, in the order of vectors and columns."""

    def linearise(self, x: FloatArray) -> Linear:
        """Residual, (rows,), and derivatives, (rows, free); large and 0 on failure."""


class Status(Enum):
    """Why a solver ended, as a sentence for its numbers."""

    STEP = "converged: the parameters changed by less than {tolerance:g} %"
    COST = "converged: the criterion changed by less than {tolerance:g} %"
    WORTH = "converged: another step promises to lower the criterion by less than {worth:.2g} %"
    KINK = "converged: along the kink of the criterion a step promises to lower it by less than {tolerance:g} %"
    ROUNDING = "converged: steps change the criterion by no more than rounding"
    ENOUGH = "converged: what is left is no more than the problem itself may err"
    EXACT = "the torque is reproduced to rounding"
    EVALUATION_LIMIT = "not converged after {evaluations} evaluations"
    NO_DESCENT = "not converged: no step lowers the criterion after {evaluations} evaluations"
    NOT_EVALUABLE = "not converged: the criterion cannot be evaluated at the start"

    @property
    def converged(self) -> bool:
        """Whether the solver succeeded."""
        return self not in (Status.EVALUATION_LIMIT, Status.NO_DESCENT, Status.NOT_EVALUABLE)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of a solver.

    Attributes:
        x: the free parameters.
        residual, jacobian: there, (rows,), and its derivatives, (rows, free).
        status: why it ended. message: the same with the solver's numbers.
        trace: norms of the residual, at the start and after each step that was made.
        evaluations: of the problem.
        starts: how many starts led there, of how many.
    """

    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    status: Status
    message: str
    trace: tuple[float, ...]
    evaluations: int
    starts: tuple[int, int] = (1, 1)


@dataclass(slots=True, eq=False)
class Counted:
    """Wrapper that counts evaluations and caches the last linearised point.

    Attributes:
        problem: that is evaluated; another one may follow it.
        evaluations: of all of them, with or without derivatives.
    """

    problem: Any = None
    evaluations: int = 0
    _last: tuple[Any, FloatArray, Linear] | None = None

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Identified parameters."""
        return tuple(self.problem.free)

    def linearise(self, x: FloatArray) -> Linear:
        """Residual, (rows,), and derivatives, (rows, free)."""
        last = self._last
        if last is None or last[0] is not self.problem or not np.array_equal(last[1], x):
            self.evaluations += 1
            last = self._last = (self.problem, x.copy(), self.problem.linearise(x))
        return last[2]

    def remember(self, x: FloatArray, residual: FloatArray, derivatives: FloatArray) -> None:
        """Cache the residual and derivatives at a point."""
        self._last = (self.problem, x.copy(), (residual, derivatives))


@dataclass(frozen=True, slots=True)
class LevenbergMarquardt:
    """Settings of bounded least squares by Levenberg-Marquardt.

    Attributes:
        tolerance, evaluations: relative, on criterion and parameters; at most, each with the derivatives.
        reach: (parameters,) largest change of each per step; far away one may have no effect.
        worth: relative: a step with a smaller predicted decrease of the criterion is not evaluated; 0 makes every step.
        enough, poor: norms of the residual at which the search ends, and from which on it ends after a few evaluations.
        admits: whether a step may lead to a point; else the point is not evaluated, and the step refused.
    """

    tolerance: float = 1e-8
    evaluations: int = 60
    reach: FloatArray | float = math.inf
    worth: float = 0.0
    enough: float = 0.0
    poor: float = math.inf
    admits: Callable[[FloatArray], bool] = lambda _: True


def solve(
    problem: Problem, solver: LevenbergMarquardt, start: FloatArray, watch: Callable[[float], None] = lambda _: None
) -> Solution:
    """Solve a problem from a start; its trace begins there.

    Args:
        problem: left unchanged; a `Counted` one keeps its count and cache.
        solver: the settings.
        start: (free,), clipped to the bounds.
        watch: callback for every step, which gets the norm of the residual.
    """
    counted = problem if isinstance(problem, Counted) else Counted(problem)
    bounds = Bounds.of(problem.free)
    x, before, widths = bounds.clip(start), counted.evaluations, bounds.upper - bounds.lower
    error, J = counted.linearise(x)
    trace, damping, used = [float(np.linalg.norm(error))], _DAMPING, 1
    status = None if J.any() and math.isfinite(_gain(1.0, error, J)) else Status.NOT_EVALUABLE
    share, idle, limit, largest = 1.0, 0, max(solver.tolerance, _RESOLVED), np.zeros(x.size)
    while status is None and trace[-1] > solver.enough:
        if used >= (solver.evaluations if trace[-1] < solver.poor else min(solver.evaluations, _FEW)):
            break
        norm, reach = trace[-1], share * solver.reach
        room = bounds.shift_to(x, reach)
        # A parameter that a vanishing law no longer determines is not moved; its deviation is more than its value.
        largest = np.maximum(largest, sizes := np.linalg.norm(J, axis=0))
        told = np.where((sizes > _RESOLVED * largest) | (sizes * np.abs(x) > norm / math.sqrt(error.size)), J, 0.0)
        step = damped_step(error, told, room, damping, widths)
        cut = (taken := float(np.max(np.abs(step) / reach))) >= _CUT
        if solver.worth > 0.0 and damping <= _DAMPING and not cut and _gain(norm, error + J @ step) <= solver.worth:
            status = Status.WORTH
            break
        after = counted.linearise(x + step) if solver.admits(x + step) else (np.full(1, math.inf), J)
        used, gained = used + 1, _gain(norm, *after)
        # Where the least lies at a kink, shorter steps only creep towards it.
        crossed = damping > 1.0 and not cut and -math.inf < gained <= 0.0 and used < solver.evaluations
        kink = _find_kink((error, J), step, after) if crossed else None
        if kink is not None:
            to, along = kink[2] * step, damped_step(*kink[:2], room, 0.0, widths)
            if _gain(norm, error + J @ along) <= solver.tolerance and np.all(np.abs(along) < _CUT * reach):
                status = Status.KINK
                break
            step = to + min(_HARDER / damping, 1.0) * (along - to)
            after = counted.linearise(x + step)
            used, gained = used + 1, _gain(norm, *after)
        small = bool(np.all(np.abs(step) <= solver.tolerance * np.abs(x)))
        if gained > 0.0:
            x, (error, J) = x + step, after
            trace.append(float(np.linalg.norm(error)))
            watch(trace[-1])
        # A step that had to be damped or cut so much is short for another reason than that the end is near.
        if damping <= 1.0 and not cut and (small or abs(gained) <= solver.tolerance):
            status = Status.STEP if small else Status.COST
        # At the minimum only rounding decides whether the criterion rises; a harder damping changes nothing.
        elif gained <= 0.0 and _gain(norm, error + J @ damped_step(error, told, bounds.shift_to(x))) < limit:
            status = Status.ROUNDING
        # Steps, long or short, that change nothing, with none between them that does, have come to the end.
        idle = 0 if gained > solver.tolerance else idle + (abs(gained) <= solver.tolerance)
        if status is None and (idle >= _PATIENCE or damping >= _MOST):
            status = Status.COST if idle >= _PATIENCE else Status.NO_DESCENT
        share = min(_FARTHER * share, 1.0) if gained > 0.0 else max(_SHORTER * taken * share, _NEAREST)
        damping = max(damping * _EASIER, _LEAST) if gained > 0.0 else damping * _HARDER
    enough = status is not Status.NOT_EVALUABLE and trace[-1] <= solver.enough
    status = Status.ENOUGH if enough else status or Status.EVALUATION_LIMIT
    message = status.value.format(tolerance=100 * solver.tolerance, worth=100 * solver.worth, evaluations=used)
    return Solution(x, error, J, status, message, tuple(trace), counted.evaluations - before)


def _gain(norm: float, after: FloatArray, *slopes: FloatArray) -> float:
    """Relative decrease of the criterion; minus infinity for overflow or NaN."""
    if not all(bool(np.all(np.abs(array) < _LARGEST)) for array in (after, *slopes)):
        return -math.inf
    return 1.0 - (float(np.linalg.norm(after)) / norm) ** 2 if norm else 0.0


def _find_kink(here: Linear, step: FloatArray, there: Linear) -> tuple[FloatArray, FloatArray, float] | None:
    """Return residual and derivatives with a row that holds steps to a kink, and how far a refused step lies before it.

    Friction that begins to slip adds ``u max(n s - d, 0)`` to the residual of a step s, and ``u n`` to its derivatives.
    None where the derivatives determine no step: the kink would choose what no row does.
    """
    (error, J), jump = here, there[1] - here[1]
    turned, missed = jump @ step, there[0] - error - J @ step
    square = float(turned @ turned)
    beyond = float(turned @ missed) / square if 0.0 < square < math.inf else 0.0  # of the step; half, if it is a curve
    unlike = np.linalg.norm(missed - beyond * turned)
    shown = unlike <= _SAME * np.linalg.norm(missed) and abs(beyond - 0.5) > _SAME and 0.0 < beyond <= 1.0 + _SAME
    if not shown or np.linalg.matrix_rank(J / column_norms(J)) < step.size:
        return None
    before, held = max(1.0 - beyond, 0.0), _HELD * float(np.linalg.norm(error))
    return np.append(error, -held * before), np.vstack([J, held / square * (turned @ jump)]), before


def damped_step(
    error: FloatArray, J: FloatArray, room: Bounds, damping: float = 0.0, widths: FloatArray | float = math.inf
) -> FloatArray:
    """Minimise ``||e + J s||^2 + damping ||D s||^2`` within bounds.

    Args:
        error: (rows,).
        J: its derivatives, (rows, free).
        room: bounds of the step.
        damping: factor of the penalty.
        widths: (free,) distances between the bounds of each parameter.
    """
    from scipy.optimize import lsq_linear

    norms = np.linalg.norm(J, axis=0)
    # What moves nothing, from bound to bound, is not moved.
    idle = norms * np.where(norms > 0, widths, 0.0) <= _IDLE * np.linalg.norm(error)
    J, norms = np.where(idle, 0.0, J), np.where(idle, 1.0, norms)
    triangle = np.asarray(np.linalg.qr(np.column_stack([J / norms, error]), mode="r"))[: norms.size]
    matrix = np.vstack([triangle[:, :-1], np.sqrt(damping) * np.eye(norms.size)])
    target = np.concatenate([-triangle[:, -1], np.zeros(norms.size)])
    found = lsq_linear(matrix, target, (room.lower * norms, room.upper * norms), method="bvls")
    return room.clip(found.x / norms)


def least_squares(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Solve ``Y = W x`` by QR with column scaling; x, (parameters,).

    Args:
        W: (rows, parameters).
        Y: (rows,).
        names: of the parameters, for the error.

    Raises:
        MethodError: the rows are too few, or do not determine the parameters.
    """
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
    return np.asarray(np.linalg.solve(R, Q.T @ Y) / norms)


def refuse_idle(columns: FloatArray, names: tuple[str, ...]) -> None:
    """Refuse columns (rows, parameters) of zeros; the sentence names the parameters."""
    idle = [name for name, own in zip(names, columns.T, strict=True) if not np.linalg.norm(own) > 0]
    if idle:
        raise MethodError(
            f"Nothing in this record excites {', '.join(idle)}; fix {'it' if len(idle) == 1 else 'them'}, or use a "
            "motion that moves at several speeds, both ways; if it does, correct units, gains and sides of the loop."
        )
