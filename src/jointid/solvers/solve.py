"""Solve a problem: one verb for every solver."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.bounds import Bounds
from jointid.solvers.problem import Problem
from jointid.solvers.solution import Solution, Watch, unwatched

_Solved_contra = TypeVar("_Solved_contra", bound=Problem, contravariant=True)
_Problem = TypeVar("_Problem", bound=Problem)


class Solver(Protocol[_Solved_contra]):
    """A way to the solution of a kind of problem, with its settings."""

    def solve(self, problem: _Solved_contra, start: FloatArray, watch: Watch) -> Solution:
        """Return where the solver ends from a start within the bounds."""


def solve(problem: _Problem, solver: Solver[_Problem], start: FloatArray, watch: Watch = unwatched) -> Solution:
    """Solve a problem from a start.

    Args:
        problem: what is solved; it stays as it is. One that is `Counted` goes on counting, and is not evaluated again
            where it was linearised last.
        solver: with its settings.
        start: (free,), brought within the bounds of the free parameters; (starts, free) for `Multistart`.
        watch: is told every step.
    """
    return solver.solve(problem, Bounds.of(problem.free).clip(np.asarray(start, dtype=np.float64)), watch)
