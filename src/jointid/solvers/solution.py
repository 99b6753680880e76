"""Where a solver ended, and why: `Solution`, its `Status`, and the steps that led there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from jointid.common.arrays import FloatArray


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


def unwatched(_: Step) -> None:
    """Ignore a step."""


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
