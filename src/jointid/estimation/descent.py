"""Descents to the least torque error: one run of the solver each, counted and reported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Step, Tally, solve
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty

_WORTH = 1e-2  # of the tolerance: a step of a closed loop that promises less is not made


def least_squares(tolerance: float, evaluations: int = 60) -> LevenbergMarquardt:
    """Return the solver of a closed loop."""
    return LevenbergMarquardt(tolerance, evaluations, worth=_WORTH * tolerance)


ROUGH = least_squares(1e-5, 30)
"""The solver of a rough descent."""

GLANCE = least_squares(1e-5, 8)
"""The solver of a first look, which only tells good starts from bad ones."""

_CLEARLY = 25.0  # times the residual's variance: the first rows of a filter without a lag vary more than the others ...
_FIRST, _OUT = 10, 5.0  # rows; times the median size, which one in a hundred of ten rows of noise exceeds
_SURELY = 2.0  # ... and robust standard deviations of that velocity


class Solved(NamedTuple):
    """The end of a descent.

    Attributes:
        problem: the problem that was solved.
        solution: where the solver ended.
    """

    problem: ClosedLoopProblem
    solution: Solution

    @property
    def x(self) -> FloatArray:
        """The free parameters, (free,)."""
        return self.solution.x

    @property
    def values(self) -> dict[str, float]:
        """All parameters by name."""
        return self.problem.values(self.solution.x)

    @property
    def norm(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.solution.residual))

    def with_starts(self, starts: tuple[int, int]) -> Solved:
        """Return the end with another count of the starts that led there, and of all."""
        return self._replace(solution=replace(self.solution, starts=starts))


class History:
    """The simulations of a search that solves several problems, one after the other."""

    def __init__(self, progress: Progress) -> None:
        self.progress, self.tally = progress, Tally()
        self._last: Counted | None = None
        self._starts, self._best = 0, math.inf

    def count_evaluations(self, problem: ClosedLoopProblem) -> Counted:
        """Return the problem with counted evaluations; it remembers the last point that was linearised."""
        if self._last is None or self._last.problem is not problem:
            self._last = Counted(problem, self.tally)
        return self._last

    def solve(self, problem: ClosedLoopProblem, solver: LevenbergMarquardt, start: FloatArray) -> Solved:
        """Descend from a start, and report the steps."""
        size = problem.size or 1.0
        self._starts += 1

        def watch(step: Step) -> None:
            error = step.norm / size
            which = f"start {self._starts}, " if self._starts > 1 else ""
            best = f" (best so far {100 * self._best:.4f} %)" if which and error > self._best else ""
            self._best = min(self._best, error)
            self.progress(Detail(f"{which}torque error {100 * error:.4f} %{best}"))

        return Solved(problem, solve(self.count_evaluations(problem), solver, start, watch))

    def finish(self, rough: Solved, tolerance: float) -> Solved:
        """Descend from the end of a rough descent to the full tolerance."""
        return self.solve(rough.problem, least_squares(tolerance), rough.x)


def descend(problem: ClosedLoopProblem, start: FloatArray, tolerance: float) -> Solution:
    """Descend by least squares, neither reported nor counted."""
    return solve(problem, least_squares(tolerance), start)


def free_more(solved: Solved, names: tuple[str, ...], tolerance: float, history: History) -> Solved:
    """Go on by least squares with more of the joint's surroundings free, see `surrounding`.

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
    wider = solved.problem.freeing(*names)
    return history.solve(wider, least_squares(tolerance), wider.vector(solved.values))


def begins_badly(solved: Solved) -> bool:
    """Test whether the first rows of a residual stand out of the others."""
    size = np.abs(solved.solution.residual)
    return bool(np.max(size[:_FIRST]) > _OUT * np.median(size))


def or_moving(
    resting: Solved, problem: ClosedLoopProblem, values: Mapping[str, float], tolerance: float, history: History
) -> Solved:
    """Descend with the motor moving at the first sample, and return the better of both answers.

    Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so no
    descent leads from one to the other. The torque that was held before the first sample, for the delay of the drive,
    is not in the log; it pushes a motor that moves, and is then a part of that velocity.

    Args:
        resting: the end with the motor at rest.
        problem: the same with the motor moving.
        values: where its descent begins.
        tolerance: of the descent.
        history: of the search.
    """
    moving = history.solve(problem, least_squares(tolerance), problem.vector(values))
    if not is_significant(resting, moving, history):
        return resting
    return moving.with_starts(resting.solution.starts)


def is_significant(resting: Solved, moving: Solved, history: History) -> bool:
    """Test whether a first velocity explains more torque than noise, and is above two robust standard deviations.

    A residual is correlated as a rule, and a motor that slips before it sticks changes where it stands for the rest of
    the record: the gain alone would invent a motion.
    """
    before, after = resting.norm**2, moving.norm**2
    if before - after <= _CLEARLY * before / resting.solution.residual.size:
        return False
    problem, (x, J) = moving.problem, (moving.x, -moving.solution.jacobian)
    names = [p.name for p in problem.free]
    if "initial_velocity" not in names:
        return True
    history.tally.evaluations += 1
    known = uncertainty(Influence(J, moving.solution.residual), problem.cells(problem.simulate(x)), problem.torque_unit)
    at = names.index("initial_velocity")
    return bool(abs(x[at]) > _SURELY * known.covariance.std[at])
