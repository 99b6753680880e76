"""The fit of a robot to its torques by descents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray, triangle
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Quantity
from jointid.common.text import join
from jointid.estimation.descent import ROUGH, History
from jointid.estimation.outputs import CONSTANT
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.problems.simulated import Runs, Simulated, outcome_of
from jointid.estimation.result.verdict import SpringVerdict
from jointid.estimation.robots.numbers import RobotParameters
from jointid.models.robots.robot import Robot
from jointid.simulation.plant import Numbers, robot_with
from jointid.simulation.simulate import Outcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt, damped_step
from jointid.solvers.solve import Solution
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
        problem: that was solved, weighted by the joints' filtered errors.
        x: (free,) what is searched, at the end.
        runs: there.
        slopes: (rows, free) of their filtered torques by what is searched, not weighted.
        covariance: of the errors of `values`.
        relative_error: (n,) of the filtered torques, a share each.
        iterations: that were made.
        converged: whether they settled.
        springs: a verdict for each flexible joint; of one that is refused, and of its joint's two sides, no interval is
            to be believed.
    """

    problem: Simulated
    x: FloatArray
    runs: Runs
    slopes: FloatArray
    covariance: Covariance
    relative_error: FloatArray
    iterations: int
    converged: bool
    springs: tuple[SpringVerdict, ...] = ()

    @property
    def parameters(self) -> RobotParameters:
        """Parameters of the identified problem."""
        return self.problem.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.parameters.names

    @property
    def values(self) -> FloatArray:
        """The parameters, (parameters,)."""
        return self.parameters.values(self.x)

    @property
    def numbers(self) -> Numbers:
        """Numbers of the robot that was found."""
        return self.parameters.numbers(self.values)

    @property
    def information(self) -> FloatArray:
        """Triangle R, (free, free), of which ``R' R`` is the information on what is searched, for white errors.

        Beside it the covariance has lost what is known of the sum of two that are not known.
        """
        return triangle(self.slopes * self.problem.weights(len(self.slopes))[:, np.newaxis])

    def robot(self, robot: Robot) -> Robot:
        """Return a robot with what was found: the same torques, but grouped numbers stand in the one that is kept.

        A Coulomb friction that is another backwards is one of both directions and an offset.

        Args:
            robot: that was identified; its places, names and gravity are taken.

        Raises:
            MethodError: a rotor's inertia, with what is grouped with it, was found negative.
        """
        return robot_with(robot, self.numbers)

    def value(self, name: str) -> tuple[float, float]:
        """Return a parameter and its standard deviation."""
        at = self.names.index(name)
        return float(self.values[at]), float(self.covariance.std[at])


def conclude(problem: Simulated, x: FloatArray, runs: Runs, J: FloatArray, made: int, settled: bool) -> RobotFit:
    """Return the fit at an end, with the slopes J, (rows, free), not weighted.

    Raises:
        MethodError: the robot cannot be simulated there, or explains none of the torque; or a friction that grows with
            the torque is not told from others, see `find_separable`.
    """
    if (outcome := outcome_of(runs)) is not Outcome.FINISHED:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {outcome.value}. Record a livelier motion, "
            "name a livelier log first, leave out springs of stiff joints, or declare simpler laws."
        )
    error = problem.error(runs)
    left = problem.norms(error) / problem.sizes
    if np.all(left > 1.0):
        raise MethodError(
            f"The search ended at a robot that leaves {100 * float(np.min(left)):.3g} % or more of the torque of every "
            "joint, more than one without any torque: check units and signs, or record a livelier motion."
        )
    names, scales = problem.parameters.names, problem.parameters.scales(x)
    together = [name for name, separable in zip(names, find_separable(J), strict=True) if not separable]
    if any(name.endswith("friction_per_torque") for name in together):
        raise MethodError(
            f"The records do not tell {join(together)} apart: where the torque never brakes, a share of it scales them "
            "all. Identify records with other known loads in one fit, or brake harder."
        )
    problem = problem.reweight(error, x.size)
    weights = problem.weights(error.size)
    influence = Influence(J * weights[:, np.newaxis], error * weights, equations=problem.sigma.size)
    covariance = influence.robust()
    if problem.motion_measured:
        covariance = influence.widen_for_motion(covariance)
    known = zip(names, covariance.std, strict=True)
    if untold := [n for n, s in known if n.endswith(f".{DELAY}") and not 2.0 * s < DELAYS[-1]]:
        raise MethodError(
            f"The records do not tell {join(untold)}: two standard deviations are more than {1e3 * DELAYS[-1]:g} ms. "
            "Move faster, record longer, or state the delay in [controller] and do not free it."
        )
    covariance = replace(covariance, std=covariance.std * scales)
    return RobotFit(problem, x, runs, J, covariance, left, made, settled)


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

    problem: Simulated
    solution: Solution
    reach: FloatArray
    finer: bool = False

    def of(self, problem: Simulated) -> End:
        """Return the end as one of a problem that is simulated finer."""
        finer = problem.roughly() is not problem
        return replace(self, problem=replace(problem, sigma=self.problem.sigma), finer=finer)

    def linearise(self) -> tuple[FloatArray, FloatArray]:
        """Return the error, (rows,), and its derivatives, (rows, free), not weighted."""
        weights = self.problem.weights(self.solution.residual.size)
        return self.solution.residual / weights, self.solution.jacobian / weights[:, np.newaxis]

    def reweight(self) -> Simulated:
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
            MethodError: see `conclude`.
        """
        x = self.solution.x
        return conclude(self.problem, x, self.problem.run(x), -self.linearise()[1], made, self.solution.converged)


class Descents(History):
    """Descents to the least weighted torque error, with the evaluations of all counted.

    Args:
        evaluations: at most, of each.
        progress: receives the steps.
    """

    def __init__(self, evaluations: int, progress: Progress) -> None:
        super().__init__(progress)
        self.evaluations = evaluations

    def begin(self, problem: Simulated, start: StartOfSprings, hertz: Mapping[str, float], without: float) -> End:
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

    def settle(self, problem: Simulated, x: FloatArray) -> RobotFit:
        """Take Gauss-Newton steps from values of rigid joints until they settle, each joint by the size of its error.

        Raises:
            MethodError: the robot cannot be simulated there, or the records do not determine its parameters.
        """
        bounds, runs, settled = Bounds.of(problem.free), problem.run(x), False
        J, first = np.zeros((problem.filtered_torque.size, x.size)), True
        # What no position shows never settles: the integral takes whatever is added.
        told = [not (problem.integrates and p.name.rpartition(".")[2] in CONSTANT) for p in problem.free]
        while outcome_of(runs) is Outcome.FINISHED and not settled and self.tally.evaluations < self.evaluations:
            error, J = problem.error(runs), problem.slopes(runs, x)
            self.tally.evaluations += 1
            for _ in range(_WEIGHED if first else 1):
                weights = problem.weights(error.size)
                slopes = J * weights[:, np.newaxis]
                step = damped_step(error * weights, -slopes, bounds.shift_to(x))
                problem, first = problem.reweight(error - J @ step, x.size), False
            settled = float(np.sum((slopes @ np.where(told, step, 0.0)) ** 2)) <= _SETTLED
            share = float(np.max(problem.norms(error) / problem.sizes))
            self.progress(Detail(f"{self.tally.evaluations}: torque error {100 * share:.4f} % on the worst joint"))
            x, runs = _halve(problem, x, step, runs)
        return conclude(problem, x, runs, J, self.tally.evaluations, settled)

    def from_start(
        self, problem: Simulated, start: StartOfSprings, values: FloatArray, evaluations: int = _FIRST
    ) -> End:
        """Descend roughly from values of all parameters."""
        x = problem.parameters.to_search_variables(values)
        return self._descend(problem, x, problem.parameters.reach(values), _ROUGH, min(evaluations, self.evaluations))

    def follow(self, problem: Simulated, start: Mapping[str, float]) -> End:
        """Descend roughly from values by name as the search of one joint's laws does, away from bounds.

        Where a bound takes the effect of other parameters away, as a slider without stiffness, steps of Levenberg and
        Marquardt would end there.
        """
        problem, parameters = problem.roughly(), problem.parameters
        values = np.array([start[name] for name in parameters.names])
        found = self.report(problem, ROUGH, parameters.to_search_variables(values))
        return End(problem, found, parameters.reach(values))

    def refine(self, problem: Simulated, end: End) -> End:
        """Descend to the full tolerance, with the joints' errors estimated anew until these settle."""
        end = self.from_end(end.reweight(), end, _CLOSE).of(problem)
        for _ in range(_TURNS):
            weighed = end.reweight()
            end = self.from_end(weighed, end, (_FINE, _LAST / end.solution.residual.size))
            change = np.log(end.reweight().sigma / weighed.sigma)
            if not end.solution.converged or np.all(np.abs(change) < _STEADY):
                break
        return end

    def from_end(self, problem: Simulated, end: End, aim: tuple[float, float]) -> End:
        """Descend from where another descent ended, with other weights."""
        x = end.solution.x
        if not end.finer:
            error, slopes = end.linearise()
            weights = problem.weights(error.size)
            self.count_evaluations(problem).remember(x, error * weights, slopes * weights[:, np.newaxis])
        return self._descend(problem, x, end.reach, aim, self.evaluations)

    def _descend(
        self, problem: Simulated, x: FloatArray, reach: FloatArray, aim: tuple[float, float], evaluations: int
    ) -> End:
        (tolerance, worth), exact = aim, problem.floor / float(np.max(problem.sigma))
        solver = LevenbergMarquardt(tolerance, evaluations, reach, worth, exact)
        return End(problem, self.report(problem, solver, x), reach)


def _halve(problem: Simulated, x: FloatArray, step: FloatArray, runs: Runs) -> tuple[FloatArray, Runs]:
    """Return the end of a step, halved until it can be simulated."""
    for _ in range(_HALVINGS):
        found = problem.run(x + step)
        if outcome_of(found) is Outcome.FINISHED:
            return x + step, found
        step = 0.5 * step
    return x, runs
