"""Descents of a robot to the least weighted torque error, one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Quantity
from jointid.estimation.descent import roughly
from jointid.estimation.robots.fit import RobotFit, conclude
from jointid.estimation.robots.problem import RobotProblem
from jointid.simulation.closed_loop import Outcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Step, solve
from jointid.uncertainty.covariance import white

if TYPE_CHECKING:
    from jointid.estimation.starts.robot_springs import StartOfSprings

UNSEEN = 2.0
"""Standard deviations: a compliance of less is not shown."""

OFF = 1e-3
"""Of the stiffest, on a logarithmic scale: a spring that is not at its bound."""

_COMMON = 11.25, 16.875, 25.3125  # Hz of all springs, where the first descent leads nowhere
_FIRST, _TRIED = 12, 6  # evaluations of a rough descent, mostly enough; and of those from other frequencies
_ROUGH, _CLOSE = (3e-2, 1e-2), (1e-3, 1e-4)  # tolerance, and what a step is to promise: shares of the criterion
_FINE = 3e-5  # tolerance at last
_LAST = 0.1  # of the sum of squares in units of the noise, a step's worth there: all parameters move by 0.3 deviations
_FALLING = 0.7  # of its error before a step: a descent that is on its way
_POOR = 0.1  # of a joint's filtered torque: an error that is more than noise
_TURNS, _SETTLED = 4, 0.4  # descents with new sizes of the joints' errors, and their change that asks for no other


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """The end of a descent.

    Attributes:
        problem: as the descent weighed it.
        solution: of that.
        reach: (free,) how far one step may move each parameter.
        finer: whether the problem simulates finer than the descent did, so that what is known of the end is only nearly
            so.
    """

    problem: RobotProblem[Any]
    solution: Solution
    reach: FloatArray
    finer: bool = False

    def of(self, problem: RobotProblem[Any]) -> End:
        """Return the end as one of a problem that is simulated finer."""
        finer = problem.roughly() is not problem
        return replace(self, problem=problem.with_sigma(self.problem.sigma), finer=finer)

    def linearise(self) -> tuple[FloatArray, FloatArray]:
        """Return the error, (rows,), and its derivatives, (rows, free), not weighted."""
        weights = self.problem.weights(self.solution.residual.size)
        return self.solution.residual / weights, self.solution.jacobian / weights[:, np.newaxis]

    def reweight(self) -> RobotProblem[Any]:
        """Return the problem with the sizes of the errors that are left."""
        error, slopes = self.linearise()
        return self.problem.reweight(error, slopes.shape[1])

    @property
    def norm(self) -> float:
        """Of the weighted error that is left."""
        return float(np.linalg.norm(self.solution.residual))

    @property
    def may_show(self) -> bool:
        """Whether a longer search may find a spring: of one its compliance is above two deviations, off its end."""
        x, known = self.solution.x, white(self.solution.jacobian, self.solution.residual)
        return any(
            parameter.quantity is Quantity.STIFFNESS and 0.0 < std < 1.0 / UNSEEN and value < parameter.upper - OFF
            for parameter, std, value in zip(self.problem.free, known.std, x, strict=True)
        )

    @property
    def leads_on(self) -> bool:
        """Whether the descent is on its way, or has ended with little of each joint's torque left."""
        trace = self.solution.trace
        if not self.solution.converged:
            return len(trace) > 1 and trace[-1].norm < _FALLING * trace[-2].norm
        left = self.problem.norms(self.linearise()[0])
        return not np.any(left > _POOR * self.problem.sizes)

    def fit(self, made: int) -> RobotFit | None:
        """Return the fit after so many evaluations; None where the robot cannot be simulated there."""
        x = self.solution.x
        run = self.problem.run(x)
        if run.outcome is not Outcome.FINISHED:
            return None
        J = -self.linearise()[1]
        return conclude(self.problem, x, run, J, J, made, self.solution.converged)


class Descents:
    """Descents to the least weighted torque error, with the evaluations of all counted.

    Args:
        evaluations: at most, of each.
        progress: receives the steps.
    """

    def __init__(self, evaluations: int, progress: Progress) -> None:
        self.evaluations, self.progress, self.made = evaluations, progress, 0

    def begin(
        self, problem: RobotProblem[Any], start: StartOfSprings, hertz: Mapping[str, float], without: float
    ) -> End:
        """Descend from these frequencies, Hz, and from others if that fails; return the best end.

        A descent fails if it creeps or leaves much of a joint's torque unexplained. Others are not tried if it leaves
        more than the rigid robot, `without`, which may have no springs. A robot split into wrong rotors may look best
        on wrong frequencies. Of 200 random robots four did, and all came down from one frequency of all springs.
        """
        best = self.from_start(problem, start, start.values(hertz))
        if best.leads_on or best.norm > without:
            return best
        chosen = None
        for frequency in (f for f in _COMMON if f < start.stiff):
            values = start.all_at(frequency)
            other = self.from_start(problem, start, values, _TRIED)
            if other.norm < best.norm:
                best, chosen = other, values
        if chosen is not None and not best.solution.converged:
            # From its start once more: from an end the first steps would be long, and may leave the way.
            best = self.from_start(problem, start, chosen)
        return best

    def from_start(
        self, problem: RobotProblem[Any], start: StartOfSprings, values: FloatArray, evaluations: int = _FIRST
    ) -> End:
        """Descend roughly from values of all parameters."""
        x = problem.parameters.to_search_variables(values)
        return self._descend(Counted(problem), x, start.reach(values), _ROUGH, min(evaluations, self.evaluations))

    def follow(self, problem: RobotProblem[Any], values: FloatArray, reach: FloatArray) -> End:
        """Descend from a start as the search of one joint's laws does, away from bounds, (parameters,) each.

        Where a bound takes the effect of other parameters away, as a slider without stiffness, steps of Levenberg and
        Marquardt would end there.
        """
        x, counted = problem.parameters.to_search_variables(values), Counted(problem)
        found = solve(counted, roughly(problem), x, self._watch)
        self.made += found.evaluations
        return End(problem, found, reach)

    def finish(self, problem: RobotProblem[Any], end: End) -> End:
        """Descend to the full tolerance, with the joints' errors estimated anew until these settle."""
        end = self.from_end(end.reweight(), end, _CLOSE).of(problem)
        for _ in range(_TURNS):
            weighed = end.reweight()
            end = self.from_end(weighed, end, (_FINE, _LAST / end.solution.residual.size))
            change = np.log(end.reweight().sigma / weighed.sigma)
            if not end.solution.converged or np.all(np.abs(change) < _SETTLED):
                break
        return end

    def from_end(self, problem: RobotProblem[Any], end: End, aim: tuple[float, float]) -> End:
        """Descend from where another descent ended, with other weights."""
        counted, x = Counted(problem), end.solution.x
        if not end.finer:
            error, slopes = end.linearise()
            weights = problem.weights(error.size)
            counted.remember(x, error * weights, slopes * weights[:, np.newaxis])
        return self._descend(counted, x, end.reach, aim, self.evaluations)

    def _descend(
        self, counted: Counted, x: FloatArray, reach: FloatArray, aim: tuple[float, float], evaluations: int
    ) -> End:
        problem = counted.problem
        assert isinstance(problem, RobotProblem)
        (tolerance, worth), exact = aim, problem.floor / float(np.max(problem.sigma))
        found = solve(counted, LevenbergMarquardt(tolerance, evaluations, reach, worth, exact), x, self._watch)
        self.made += found.evaluations
        return End(problem, found, reach)

    def _watch(self, step: Step) -> None:
        self.progress(Detail(f"{step.evaluations} simulations: weighted torque error {step.norm:.6g}"))
