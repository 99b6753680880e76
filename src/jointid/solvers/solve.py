"""The verb `solve` and what it works on: a problem, as a solver sees it, its bounds, and where a solver ended.

A closed loop, a prescribed motion, a prescribed torque, or several records together are the same to a solver, and so
will be one joint and a robot of many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter


class Problem(Protocol):
    """A vector of free parameters in, the filtered, decimated residual (measured less predicted) out."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified, in the order of every vector and column, with their bounds."""

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,); large and finite where the candidate cannot be simulated."""

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free).

        The derivatives are all 0 where the candidate cannot be simulated.
        """


class InstrumentProblem(Problem, Protocol):
    """A problem with instruments: columns that go with the derivatives, but not with what disturbs the residual."""

    def instruments(self, x: FloatArray) -> FloatArray:
        """Return the instruments, (rows, free)."""


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Lower and upper bounds, each (parameters,)."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Bounds:
        """Return the bounds of parameters, in their order."""
        return cls(np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters]))

    @classmethod
    def none(cls, size: int) -> Bounds:
        """Return no bounds on so many parameters."""
        anywhere = np.full(size, np.inf)
        return cls(-anywhere, anywhere)

    def clip(self, x: FloatArray) -> FloatArray:
        """Return the nearest point within the bounds."""
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def reached(self, x: FloatArray, gap: float | FloatArray = 0.0) -> NDArray[np.bool_]:
        """Return which parameters are at a bound, or nearer to one than `gap`."""
        return np.asarray((x <= self.lower + gap) | (x >= self.upper - gap))

    def blocked(self, x: FloatArray, step: FloatArray) -> NDArray[np.bool_]:
        """Return which parameters are at a bound that a step would lead beyond."""
        return np.asarray(((x <= self.lower) & (step < 0)) | ((x >= self.upper) & (step > 0)))

    def around(self, x: FloatArray) -> Bounds:
        """Return the bounds on a step from a point."""
        return Bounds(self.lower - x, self.upper - x)

    def in_units(self, unit: FloatArray) -> Bounds:
        """Return the bounds on parameters that are divided by positive units."""
        return Bounds(self.lower / unit, self.upper / unit)


class Status(Enum):
    """Why a solver ended: a sentence, what to do next, and whether it is a good end."""

    STEP = ("the parameters changed by less than the tolerance", "", True)
    COST = ("the criterion changed by less than the tolerance", "", True)
    STEP_AND_COST = ("the criterion and the parameters changed by less than the tolerance", "", True)
    EXACT = ("the measurement is reproduced to rounding", "", True)
    EVALUATION_LIMIT = (
        "the limit on evaluations was reached",
        "allow more evaluations, or start from where it ended",
        False,
    )
    INTERRUPTED = (
        "it was interrupted",
        "let it run to its end; the answer is of what was read until then",
        False,
    )
    NO_DESCENT = (
        "no step lowers the criterion, and yet it is not flat there",
        "start elsewhere: the criterion cannot be evaluated, or jumps, beside where it ended",
        False,
    )
    STALLED = (
        "the steps go round in circles",
        "use the exact derivatives in place of the regressor, or start elsewhere",
        False,
    )
    NOT_EVALUABLE = (
        "the criterion cannot be evaluated at the start",
        "start elsewhere: with these parameters the model cannot be simulated",
        False,
    )

    def __init__(self, sentence: str, advice: str, converged: bool) -> None:
        self.sentence, self.advice, self.converged = sentence, advice, converged


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One accepted step.

    Attributes:
        x: the free parameters after it.
        norm: of the residual there.
        evaluations: of the problem up to then, in all that was solved with it.
    """

    x: FloatArray
    norm: float
    evaluations: int


Watch: TypeAlias = Callable[[Step], None]
"""Is told every step."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a solver ended.

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
        """Whether it is a good end."""
        return self.status.converged


_CHANGED = {
    Status.STEP: "the parameters",
    Status.COST: "the criterion",
    Status.STEP_AND_COST: "the criterion and the parameters",
}


def explain(status: Status, evaluations: int, tolerance: float) -> str:
    """Return why least squares ended, in a sentence with its numbers."""
    if status in _CHANGED:
        return f"converged: {_CHANGED[status]} changed by less than {100 * tolerance:g} %"
    return f"not converged after {evaluations} evaluations"


@dataclass(slots=True)
class Tally:
    """A count of evaluations, which several problems may share."""

    evaluations: int = 0


class Counted:
    """A problem that counts how often it is evaluated, and evaluates a point that is linearised again only once.

    Attributes:
        problem: that is evaluated.
        tally: where its evaluations are counted, with or without derivatives.
    """

    def __init__(self, problem: Problem, tally: Tally | None = None) -> None:
        self.problem, self.tally = problem, tally or Tally()
        self._last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None

    @classmethod
    def of(cls, problem: Problem) -> Counted:
        """Return a problem that counts: itself, if it does already."""
        return problem if isinstance(problem, cls) else cls(problem)

    @property
    def evaluations(self) -> int:
        """So far, of all problems that share the tally."""
        return self.tally.evaluations

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        self.tally.evaluations += 1
        return self.problem.residual(x)

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives, (rows, free)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self.tally.evaluations += 1
            self._last = (x.copy(), self.problem.linearised(x))
        return self._last[1]


_Solved_contra = TypeVar("_Solved_contra", bound=Problem, contravariant=True)
_Problem = TypeVar("_Problem", bound=Problem)


class Solver(Protocol[_Solved_contra]):
    """A way to the solution of a kind of problem, with its settings."""

    def solve(self, problem: _Solved_contra, start: FloatArray, watch: Watch) -> Solution:
        """Return where the solver ends from a start within the bounds."""


def solve(problem: _Problem, solver: Solver[_Problem], start: FloatArray, watch: Watch = lambda _: None) -> Solution:
    """Solve a problem from a start.

    Args:
        problem: what is solved; it stays as it is. One that is `Counted` goes on counting, and is not evaluated again
            where it was linearised last.
        solver: with its settings.
        start: (free,), brought within the bounds of the free parameters; (starts, free) for `Multistart`.
        watch: is told every step.
    """
    return solver.solve(problem, Bounds.of(problem.free).clip(np.asarray(start, dtype=np.float64)), watch)
