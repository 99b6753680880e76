"""The history of a search in closed loop: the simulations it took and the trace of its steps, problem after problem."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.parts import Iteration
from jointid.solvers.solve import Counted, Solution, Solver, Step, Tally, solve
from jointid.solvers.trust_region import TrustRegion

MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed


class Solved(NamedTuple):
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
            last = None
            if self.trace:
                before = self.trace[-1]
                last = problem.vector(before.values), before.residual_norm
            number = self.note(problem, step.x, step.norm, last, np.where(step.x != 0.0, np.abs(step.x), 1.0))
            if number % 100 == 0 or number < 10:  # a simplex takes more than a thousand steps
                self.progress(f"iteration {number}: torque error {100 * step.norm / size:.4f} %")

        return Solved(problem, solve(self.counted(problem), solver, start, watch))

    def note(
        self,
        problem: ClosedLoopProblem,
        x: FloatArray,
        norm: float,
        before: tuple[FloatArray, float] | None,
        scales: FloatArray,
        gain_scale: float = 1.0,
    ) -> int:
        """Add a line to the trace, and return its number.

        Args:
            problem: that is being solved.
            x: (free,) where.
            norm: of the residual there.
            before: the same of the step before, if there was one.
            scales: what changes of the first parameters are measured against; those of the others do not count.
            gain_scale: see `Iteration`.
        """
        change = step = None
        if before is not None:
            change = abs(norm - before[1]) / before[1] if before[1] else 0.0
            step = float(np.max(np.abs(x - before[0])[: scales.size] / scales))
        number = len(self.trace)
        self.trace.append(Iteration(number, problem.values(x), norm, change, step, self.tally.evaluations, gain_scale))
        return number


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
