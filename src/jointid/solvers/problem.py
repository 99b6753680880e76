"""A problem, as a solver sees it: free parameters in, a residual and its derivatives out.

A closed loop, a prescribed motion, a prescribed torque, or several records together are the same to it, and so will
be one joint and a robot of many.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
