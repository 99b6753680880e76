"""The fit of a robot to its torques by descents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray, triangle
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Quantity
from jointid.common.text import join
from jointid.estimation.descent import ROUGH
from jointid.estimation.outputs import CONSTANT
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.numbers import RobotParameters
from jointid.estimation.robots.problem import AnyRun, RobotProblem, RobotRuns
from jointid.models.robots.robot import Robot
from jointid.simulation.drive_side import DriveSideRun
from jointid.simulation.robot_numbers import robot_with
from jointid.simulation.simulate import Outcome, Run
from jointid.solvers.bounded_least_squares import LevenbergMarquardt, damped_step
from jointid.solvers.solve import Counted, Solution, Step, solve
from jointid.uncertainty.covariance import Covariance, Influence, white
from jointid.uncertainty.identifiability import find_separable

if TYPE_CHECKING:
    from jointid.estimation.starts.robot_springs import StartOfSprings

_SETTLED = 0.3  # of the noise of a row, squared: a step that changes all rows by less ends the search of rigid joints
_WEIGHED = 2  # solutions for the first step, each with the sizes of the errors that the one before leaves
_HALVINGS = 6  # of a step to a candidate that cannot be simulated

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
_TURNS, _STEADY = 4, 0.4  # descents with new sizes of the joints' errors, and their change that asks for no other


@dataclass(frozen=True, slots=True, eq=False)
class RobotFit:
    """The fit of a robot to the records of its joints.

    Attributes:
        parameters: what they are. values: (parameters,) of them. covariance: of their errors.
        sigma: (n,) sizes of the joints' filtered errors, N m or N.
        relative_error: (n,) of the filtered torques, a share each.
        iterations: that were made. converged: whether they settled.
        run: at the values. slopes: (rows, free) of its filtered torques by what is searched, not weighted.
        springs: a verdict for each flexible joint; of one that is refused, and of its joint's two sides, no interval is
            to be believed.
        information: (parameters, parameters) triangle R, of which ``R' R`` is the information on what is searched, for
            white errors. Beside it the covariance has lost what is known of the sum of two that are not known.
    """

    parameters: RobotParameters
    values: FloatArray
    covariance: Covariance
    sigma: FloatArray
    relative_error: FloatArray
    iterations: int
    converged: bool
    run: Run | DriveSideRun | RobotRuns
    slopes: FloatArray
    information: FloatArray
    springs: tuple[SpringVerdict, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.parameters.names

    def robot(self, robot: Robot) -> Robot:
        """Return a robot with what was found: the same torques, but grouped numbers stand in the one that is kept.

        A Coulomb friction that is another backwards is one of both directions and an offset.

        Args:
            robot: that was identified; its places, names and gravity are taken.

        Raises:
            MethodError: a rotor's inertia, with what is grouped with it, was found negative.
        """
        return robot_with(robot, self.run.numbers)

    def value(self, name: str) -> tuple[float, float]:
        """Return a parameter and its standard deviation."""
        at = self.names.index(name)
        return float(self.values[at]), float(self.covariance.std[at])


def conclude(
    problem: RobotProblem[AnyRun], x: FloatArray, run: AnyRun, J: FloatArray, made: int, settled: bool
) -> RobotFit:
    """Return the fit at an end, with the slopes J, (rows, free), not weighted.

    Raises:
        MethodError: a friction that grows with the torque is not told from others; see `find_separable`.
    """
    apart = zip(problem.parameters.names, find_separable(J), strict=True)
    together = [name for name, separable in apart if not separable]
    if any(name.endswith("friction_per_torque") for name in together):
        raise MethodError(
            f"The records do not tell {join(together)} apart: where the torque never brakes, a share of it scales them "
            "all. Identify records with other known loads in one fit, or brake harder."
        )
    error = problem.error(run)
    problem = problem.reweight(error, x.size)
    weights = problem.weights(error.size)
    slopes = J * weights[:, np.newaxis]
    influence = Influence(slopes, error * weights, equations=problem.sigma.size)
    covariance = influence.robust()
    if problem.motion_measured:
        covariance = influence.widen_for_motion(covariance)
    names, std = problem.parameters.names, covariance.std
    if untold := [n for n, s in zip(names, std, strict=True) if n.endswith(f".{DELAY}") and not 2.0 * s < DELAYS[-1]]:
        raise MethodError(
            f"The records do not tell {join(untold)}: two standard deviations are more than {1e3 * DELAYS[-1]:g} ms. "
            "Move faster, record longer, or state the delay in [controller] and do not free it."
        )
    of_values = np.where(problem.parameters.logarithmic, problem.parameters.values(x), 1.0)
    return RobotFit(
        problem.parameters,
        problem.parameters.values(x),
        replace(covariance, std=covariance.std * of_values),
        problem.sigma,
        problem.norms(error) / problem.sizes,
        made,
        settled,
        run,
        J,
        triangle(slopes),
    )


def require_finished(run: Run | DriveSideRun | RobotRuns) -> None:
    """Refuse a fit where the robot cannot be simulated."""
    if run.outcome is not Outcome.FINISHED:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {run.outcome.value}. Record a livelier motion, "
            "name a livelier log first, leave out springs of stiff joints, or declare simpler laws."
        )


def _halve(problem: RobotProblem[AnyRun], x: FloatArray, step: FloatArray, run: AnyRun) -> tuple[FloatArray, AnyRun]:
    """Return the end of a step, halved until it can be simulated."""
    for _ in range(_HALVINGS):
        found = problem.run(x + step)
        if found.outcome is Outcome.FINISHED:
            return x + step, found
        step = 0.5 * step
    return x, run


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

    def fit(self, made: int) -> RobotFit:
        """Return the fit after so many evaluations.

        Raises:
            MethodError: the robot cannot be simulated there.
        """
        x = self.solution.x
        run = self.problem.run(x)
        require_finished(run)
        J = -self.linearise()[1]
        return conclude(self.problem, x, run, J, made, self.solution.converged)


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

    def settle(self, problem: RobotProblem[Any], x: FloatArray) -> RobotFit:
        """Take Gauss-Newton steps from values of rigid joints until they settle, each joint by the size of its error.

        Raises:
            MethodError: the robot cannot be simulated there, or the records do not determine its parameters.
        """
        bounds, run, settled = Bounds.of(problem.free), problem.run(x), False
        J = np.zeros((problem.filtered_torque.size, x.size))
        # What no position shows never settles: the integral takes whatever is added.
        told = [not (problem.integrates and p.name.rpartition(".")[2] in CONSTANT) for p in problem.free]
        while run.outcome is Outcome.FINISHED and not settled and self.made < self.evaluations:
            error, J = problem.error(run), problem.slopes(run, x)
            self.made += 1
            for _ in range(1 if self.made > 1 else _WEIGHED):
                weights = problem.weights(error.size)
                slopes = J * weights[:, np.newaxis]
                step = damped_step(error * weights, -slopes, bounds.shift_to(x))
                problem = problem.reweight(error - J @ step, x.size)
            settled = float(np.sum((slopes @ np.where(told, step, 0.0)) ** 2)) <= _SETTLED
            share = problem.norms(error) / problem.sizes
            self.progress(Detail(f"{self.made}: torque error {100 * float(np.max(share)):.4f} % on the worst joint"))
            x, run = _halve(problem, x, step, run)
        require_finished(run)
        return conclude(problem, x, run, J, self.made, settled)

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
        found = solve(counted, ROUGH, x, self._watch)
        self.made += found.evaluations
        return End(problem, found, reach)

    def finish(self, problem: RobotProblem[Any], end: End) -> End:
        """Descend to the full tolerance, with the joints' errors estimated anew until these settle."""
        end = self.from_end(end.reweight(), end, _CLOSE).of(problem)
        for _ in range(_TURNS):
            weighed = end.reweight()
            end = self.from_end(weighed, end, (_FINE, _LAST / end.solution.residual.size))
            change = np.log(end.reweight().sigma / weighed.sigma)
            if not end.solution.converged or np.all(np.abs(change) < _STEADY):
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
