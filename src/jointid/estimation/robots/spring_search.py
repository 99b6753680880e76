"""The search of a robot's springs: how far one goes, where it has led, and from where it is begun again.

The torque error of all joints is made least by Levenberg and Marquardt's steps with derivatives by variation. The
joints weigh by their errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Progress
from jointid.estimation.robots.didim import RobotFit, conclude, joint_sizes
from jointid.estimation.robots.problem import RobotProblem
from jointid.estimation.starts.robot_springs import Start, StartOfSprings
from jointid.simulation.robots import RobotOutcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Step, solve
from jointid.uncertainty.covariance import white

_COMMON = 11.25, 16.875, 25.3125  # Hz of all springs, where the first search leads nowhere
_TRIED = 6  # evaluations from each of them
_FALLING = 0.7  # of its error before a step: a search that is on its way
_POOR = 0.1  # of a joint's filtered torque: an error that is more than noise
FIRST = 12  # evaluations, after which springs are looked for in what was found: with springs most searches are over
OFF = 1e-3  # of the stiffest, on a logarithmic scale: a spring that is not at its bound
_EXACT = 1e-6  # of the torques: an error that the simulation itself may have
_TWO = 2.0  # standard deviations of an interval


class Aim(NamedTuple):
    """How far a search goes: its tolerance, and what a step is to promise, shares of the criterion."""

    tolerance: float
    worth: float


ROUGH, CLOSE = Aim(3e-2, 1e-2), Aim(1e-3, 1e-4)
"""With the first sizes of the joints' errors, and with better ones."""


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where searches have led, one after the other.

    Attributes:
        problem: as the last of them weighed it. solution: of that. made: evaluations of all.
        reach: see `Start`.
        run: at the end, where the last search has made it. finer: whether the problem simulates finer than the search
            did, so that what is known of the end is only nearly so.
    """

    problem: RobotProblem[Any]
    solution: Solution
    made: int
    reach: FloatArray
    run: Any = None
    finer: bool = False

    def of(self, problem: RobotProblem[Any]) -> End:
        """Return the end as one of a problem that is simulated finer."""
        finer = problem.roughly() is not problem
        return replace(self, problem=problem.weighted(self.problem.sigma), run=None, finer=finer)

    def linearised(self) -> tuple[FloatArray, FloatArray]:
        """Return the error, (rows,), and its derivatives, (rows, free), not weighted."""
        weights = self.problem.weights(self.solution.residual.size)
        return self.solution.residual / weights, self.solution.jacobian / weights[:, np.newaxis]

    def reweighted(self) -> RobotProblem[Any]:
        """Return the problem with the sizes of the errors that are left."""
        error, slopes = self.linearised()
        return self.problem.weighted(joint_sizes(self.problem, error, slopes.shape[1], least_error(self.problem)))

    @property
    def norm(self) -> float:
        """Of the weighted error that is left."""
        return float(np.linalg.norm(self.solution.residual))

    @property
    def may_show(self) -> bool:
        """Whether a longer search may find a spring: of one its compliance is above two deviations, off its end."""
        x, known = self.solution.x, white(self.solution.jacobian, self.solution.residual)
        return any(
            parameter.symbol == "stiffness" and 0.0 < std < 1.0 / _TWO and value < parameter.upper - OFF
            for parameter, std, value in zip(self.problem.free, known.std, x, strict=True)
        )

    @property
    def is_falling(self) -> bool:
        """Whether the last step lowered the error by much, so that the search is on its way."""
        trace = self.solution.trace
        return len(trace) > 1 and trace[-1].norm < _FALLING * trace[-2].norm

    @property
    def is_poor(self) -> bool:
        """Whether much of a joint's torque is left."""
        error, _ = self.linearised()
        left, seen = (self.problem.by_joint(rows) for rows in (error, self.problem.decimated(self.problem.measured)))
        return bool(np.any(np.linalg.norm(left, axis=1) > _POOR * np.linalg.norm(seen, axis=1)))

    def fit(self) -> RobotFit | None:
        """Return the fit; None where the robot cannot be simulated there."""
        x = self.solution.x
        run = self.run or self.problem.run(x)
        if run.outcome is not RobotOutcome.FINISHED:
            return None
        J = -self.linearised()[1]
        return conclude(self.problem, x, run, J, J, self.made, self.solution.converged, least_error(self.problem))


def least_error(problem: RobotProblem[Any]) -> float:
    """Return the norm of an error that no joint's is smaller than."""
    seen = problem.by_joint(problem.decimated(problem.measured))
    return _EXACT * float(np.max(np.linalg.norm(seen, axis=1)))


def begin_search(
    problem: RobotProblem[Any],
    start: StartOfSprings,
    hertz: Mapping[str, float],
    without: float,
    evaluations: int,
    progress: Progress,
) -> End:
    """Return where the first search leads, from these frequencies, Hz, and from others where that leads nowhere.

    That is where it creeps, or where much of a joint's torque is left; not where it is more than the robot of rigid
    joints left, `without`, which may have no springs. A robot split into wrong rotors may look best on wrong
    frequencies. Of 200 random robots four did, and all came down from one frequency of all springs.
    """
    first = min(FIRST, evaluations)
    best = search(problem, start.begin(start.values(hertz)), ROUGH, first, progress)
    over = not best.is_poor if best.solution.converged else best.is_falling
    if over or best.norm > without:
        return best
    made, chosen = best.made, None
    for frequency in (f for f in _COMMON if f < start.stiff):
        begun = start.begin(start.all_at(frequency))
        other = search(problem, begun, ROUGH, min(_TRIED, evaluations), progress)
        made += other.made
        if other.norm < best.norm:
            best, chosen = other, begun
    if chosen is not None and not best.solution.converged:
        # From its start once more: a search that goes on from an end begins with long steps, and may leave the way.
        best = search(problem, chosen, ROUGH, first, progress)
        made += best.made
    return replace(best, made=made)


def search(problem: RobotProblem[Any], start: Start | End, aim: Aim, evaluations: int, progress: Progress) -> End:
    """Return where a search of the least torque error ends, from a start or from where another ended."""

    def watch(step: Step) -> None:
        progress(f"{step.evaluations} simulations: weighted torque error {step.norm:.6g}")

    kept = _LowestRun(problem)
    counted, made, x = Counted(kept), 0, start.solution.x if isinstance(start, End) else start.x
    if isinstance(start, End):
        made = start.made
        if not start.finer:
            error, slopes = start.linearised()
            weights = problem.weights(error.size)
            counted.remember(x, error * weights, slopes * weights[:, np.newaxis])
    exact = least_error(problem) / float(np.max(problem.sigma))
    solver = LevenbergMarquardt(aim.tolerance, evaluations, start.reach, aim.worth, exact)
    found = solve(counted, solver, x, watch)
    return End(problem, found, made + found.evaluations, start.reach, kept.run_at(found.x))


class _LowestRun:
    """A problem that keeps the run of the least error: where a search ends it was simulated already."""

    def __init__(self, problem: RobotProblem[Any]) -> None:
        self.problem, self.free = problem, problem.free
        self._norm, self._x, self._run = math.inf, np.empty(0), None

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,)."""
        return self.problem.residual(x)

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free)."""
        run, error, J = self.problem.linearised_run(x)
        norm = float(np.linalg.norm(error))
        if norm < self._norm:
            self._norm, self._x, self._run = norm, x.copy(), run
        return error, J

    def run_at(self, x: FloatArray) -> Any:
        """Return the run at a point, None if it is not the one that was kept."""
        return self._run if np.array_equal(x, self._x) else None
