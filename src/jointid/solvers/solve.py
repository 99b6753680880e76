"""The verb `solve`: a problem, its solution, and bounded least squares by Levenberg-Marquardt; and linear ones by QR.

Each step of the solver minimises the damped linear problem within the bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter

_DAMPING, _LEAST, _MOST = 1e-3, 1e-12, 1e12  # of the first step, in columns of norm 1; and its range
_EASIER, _HARDER = 0.1, 5.0  # factors on the damping after a step that went down, and one that did not
_SHORTER, _FARTHER = 0.25, 2.0  # factors on the reach of a step, likewise
_PATIENCE = 8  # steps that change less than the tolerance, or that are refused
_RESOLVED = 1.5e-8  # relative decrease of the criterion that rounding can hide: the root of the machine precision
_NEAREST = 1e-3  # of its reach: that of a step after many that failed
_CUT = 0.999  # of its reach: a step that the reach has cut
_IDLE = 1e-2  # of the residual
_THERE = 1e-2  # of a tolerance
_LARGEST = 1e140  # of a residual and its derivatives: those of a loop that runs away have no squares


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


_CHANGED = {Status.STEP: "the parameters", Status.COST: "the criterion"}


@dataclass(frozen=True, slots=True)
class LevenbergMarquardt:
    """Settings of bounded least squares by Levenberg-Marquardt.

    Attributes:
        tolerance: relative, on the criterion and the parameters.
        evaluations: at most, each with the derivatives.
        reach: (parameters,) how far one step may move each; as far as its bounds when None. A step far outside where
            the linear model holds may lower the error, and yet end where the torque depends on a parameter no more.
        worth: relative, of the criterion: a step of which the linear model promises less is not made, and nothing
            evaluated. For problems whose evaluations are dear; 0 makes every step.
        enough: norm of a residual that is as good as none, where the search is over.
    """

    tolerance: float = 1e-8
    evaluations: int = 60
    reach: FloatArray | None = None
    worth: float = 0.0
    enough: float = 0.0

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Run one descent; the trace begins with the start."""
        counted, bounds, x = Counted.of(problem), Bounds.of(problem.free), start
        before = counted.evaluations
        error, J = counted.linearise(x)
        trace, damping, used = [Step(x, float(np.linalg.norm(error)), counted.evaluations)], _DAMPING, 1
        message = ""
        usable = J.any() and _have_squares(error, J)
        status, reach, share, idle, refused = None if usable else Status.NOT_EVALUABLE, self.reach, 1.0, 0, 0
        while status is None and used < self.evaluations and trace[-1].norm > self.enough:
            norm = trace[-1].norm
            step = damped_step(error, J, bounds.shift_to(x, reach), damping, bounds.upper - bounds.lower)
            cut = reach is not None and bool(np.any(np.abs(step) >= _CUT * reach))
            worthless = self.worth > 0.0 and damping <= _DAMPING and not cut
            if worthless and _gain(norm, error + J @ step) <= self.worth:
                status = Status.COST
                message = (
                    f"converged: another step promises to lower the criterion by less than {100 * self.worth:.2g} %"
                )
                break
            after, slopes = counted.linearise(x + step)
            used += 1
            gained = _gain(norm, after) if _have_squares(after, slopes) else -math.inf
            refused = 0 if gained > 0.0 else refused + 1
            small = bool(np.all(np.abs(step) <= self.tolerance * np.abs(x)))
            if gained > 0.0:
                x, error, J = x + step, after, slopes
                trace.append(Step(x, float(np.linalg.norm(error)), counted.evaluations))
                watch(trace[-1])
            # A step that had to be damped or cut so much is short for another reason than that the end is near.
            if damping <= 1.0 and small and not cut:
                status = Status.STEP
            elif damping <= 1.0 and abs(gained) <= self.tolerance and not cut:
                status = Status.COST
            elif gained <= 0.0:
                # At the minimum only rounding decides whether the criterion rises; a harder damping changes nothing.
                limit = self.tolerance if refused < _PATIENCE else max(self.tolerance, _RESOLVED)
                if _at_minimum(bounds, x, error, J, limit / _THERE):
                    status, message = Status.COST, "converged: steps change the criterion by no more than rounding"
            if status is None and damping >= _MOST:
                status = Status.NO_DESCENT
            # Steps with a reach, long or short, that all change nothing have come to the end.
            idle = idle + 1 if reach is not None and abs(gained) <= self.tolerance else 0
            status = Status.COST if status is None and idle >= _PATIENCE else status
            if reach is not None and self.reach is not None:
                moved = float(np.max(np.abs(step) / self.reach))
                shorter = max(_SHORTER * min(moved, share), _NEAREST)
                share = min(_FARTHER * share, 1.0) if gained > 0.0 else shorter
                reach = share * self.reach
            damping = max(damping * _EASIER, _LEAST) if gained > 0.0 else damping * _HARDER
        enough = status is not Status.NOT_EVALUABLE and trace[-1].norm <= self.enough
        status = Status.COST if enough else status or Status.EVALUATION_LIMIT
        if enough:
            message = "converged: what is left is no more than the problem itself may err"
        message = message or explain(status, used, self.tolerance)
        return Solution(x, error, J, status, message, tuple(trace), counted.evaluations - before)


def _gain(norm: float, after: FloatArray) -> float:
    """Relative decrease of the criterion from a residual's norm to another residual."""
    return 1.0 - (float(np.linalg.norm(after)) / norm) ** 2 if norm else 0.0


def _have_squares(*arrays: FloatArray) -> bool:
    """Test whether arrays are numbers that can be squared and summed."""
    return all(bool(np.all(np.abs(array) < _LARGEST)) for array in arrays)


def damped_step(
    error: FloatArray, J: FloatArray, room: Bounds, damping: float = 0.0, widths: FloatArray | float = math.inf
) -> FloatArray:
    """Minimise ``||e + J s||^2 + damping ||D s||^2`` within bounds, D the column norms.

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


def _at_minimum(bounds: Bounds, x: FloatArray, error: FloatArray, J: FloatArray, tolerance: float) -> bool:
    """Test whether the possible gain is within rounding of the tolerance."""
    moving = ~bounds.find_blocking(x, -(J.T @ error))
    columns = J[:, moving] / column_norms(J[:, moving])
    step = np.linalg.lstsq(columns, error, rcond=1e-12)[0]
    return bool(np.sum((columns @ step) ** 2) < _THERE * tolerance * max(float(error @ error), 1e-300))


def explain(status: Status, evaluations: int, tolerance: float) -> str:
    """Return why least squares ended, in a sentence with its numbers."""
    if status in _CHANGED:
        return f"converged: {_CHANGED[status]} changed by less than {100 * tolerance:g} %"
    return f"not converged after {evaluations} evaluations"


def solve(problem: Problem, solver: LevenbergMarquardt, start: FloatArray, watch: Watch = lambda _: None) -> Solution:
    """Solve a problem from a start.

    Args:
        problem: left unchanged; a `Counted` one keeps its count and cache.
        solver: with its settings.
        start: (free,), clipped to the bounds.
        watch: callback for every step.
    """
    return solver.solve(problem, Bounds.of(problem.free).clip(start), watch)


# Linear least squares by QR

_RANK = 1e-10  # of the largest: a normalised singular value below this is a parameter nothing excites


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


def conditioning(W: FloatArray, values: FloatArray) -> Conditioning:
    """Return the condition numbers of a regressor, (rows, parameters), at estimates, (parameters,)."""
    norms = np.linalg.norm(W, axis=0)
    R, scale = np.asarray(np.linalg.qr(W / norms, mode="r")), np.where(values == 0.0, 1.0, np.abs(values))
    return Conditioning(*(float(np.linalg.cond(R * by)) for by in (norms, 1.0, norms * scale)))


def least_squares(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Solve ``Y = W x`` by QR with column scaling; return x, (parameters,).

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
    norms = np.linalg.norm(columns, axis=0)
    idle = [name for name, norm in zip(names, norms, strict=True) if not norm > 0]
    if idle:
        raise MethodError(
            f"Nothing in this record excites {', '.join(idle)}; fix {'it' if len(idle) == 1 else 'them'}, or use a "
            "motion that moves at several speeds, both ways; if it does, correct units, gains and sides of the loop."
        )
