"""The history of a search in closed loop: the simulations it took and the trace of its steps, problem after problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.parts import Iteration
from jointid.solvers.problem import Counted, Tally
from jointid.solvers.solution import Solution, Step
from jointid.solvers.solve import Solver, solve
from jointid.solvers.trust_region import TrustRegion


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """A problem and where a solver ended on it."""

    problem: ClosedLoopProblem
    solution: Solution


class History:
    """Counts the simulations of a search, and notes its steps.

    A search solves several problems: one record on one band after the other, with the motor at rest or moving.
    """

    def __init__(self, progress: Progress) -> None:
        self.progress, self.tally, self.trace = progress, Tally(), list[Iteration]()
        self._last: Counted | None = None

    def counted(self, problem: ClosedLoopProblem) -> Counted:
        """Return the problem with its evaluations counted; what was linearised last is not evaluated again."""
        if self._last is None or self._last.problem is not problem:
            self._last = Counted(problem, self.tally)
        return self._last

    def solve(self, problem: ClosedLoopProblem, solver: Solver[Counted], start: FloatArray) -> Solved:
        """Solve a problem, and note the steps."""
        size = problem.size or 1.0

        def watch(step: Step) -> None:
            self._note(problem, step, size)

        return Solved(problem, solve(self.counted(problem), solver, start, watch))

    def _note(self, problem: ClosedLoopProblem, step: Step, size: float) -> None:
        before = self.trace[-1] if self.trace else None
        change = largest = None
        if before is not None:
            change = abs(step.norm - before.residual_norm) / before.residual_norm if before.residual_norm else 0.0
            last = problem.vector(before.values)
            largest = float(np.max(np.abs(step.x - last) / np.where(step.x != 0.0, np.abs(step.x), 1.0)))
        number = len(self.trace)
        values = problem.values(step.x)
        self.trace.append(Iteration(number, values, step.norm, change, largest, step.evaluations))
        if number % 100 == 0 or number < 10:  # a simplex takes more than a thousand steps
            self.progress(f"iteration {number}: torque error {100 * step.norm / size:.4f} %")


def least_squares(problem: ClosedLoopProblem, tolerance: float) -> TrustRegion:
    """Return the solver of a closed loop: in units of the torque and of the start, the same in any units."""
    return TrustRegion(tolerance, size=problem.size)


def free_more(
    problem: ClosedLoopProblem, x: FloatArray, names: tuple[str, ...], tolerance: float, history: History
) -> Solved:
    """Go on by least squares with more of what surrounds the joint free.

    Args:
        problem: that was solved.
        x: (free,) where.
        names: of what is freed, see `nuisance_parameters`.
        tolerance: of the parameters and the criterion.
        history: of the search.

    Raises:
        MethodError: nothing around the joint has such a name, or one record cannot tell it.
    """
    if isinstance(names, str):
        raise MethodError(f'What is freed is a list of names; received "{names}": write free=("{names}",).')
    if "drive_gain" in names:
        raise MethodError(
            "One record cannot tell the drive_gain from the scale of the joint; free log_gain or a gain of the law, or "
            "identify from two records with a known mass between them."
        )
    wider = problem.freeing(*names)
    return history.solve(wider, least_squares(wider, tolerance), wider.vector(problem.values(x)))
