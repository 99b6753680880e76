"""The fit of a robot to its torques, and the fixed point of steps by the regressor of the simulated motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray, triangle
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds
from jointid.common.text import join
from jointid.estimation.outputs import CONSTANT
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.numbers import RobotParameters
from jointid.estimation.robots.problem import RobotProblem, RobotRuns, Run
from jointid.models.robots.robot import Robot
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.robot_drive_side import RobotDriveSideRun
from jointid.simulation.robot_numbers import robot_with
from jointid.simulation.robots import RobotRun
from jointid.uncertainty.covariance import Covariance, robust, with_measured_motion
from jointid.uncertainty.identifiability import find_separable

SETTLED = 0.02
"""Standard deviations: the largest change of a parameter that ends the search."""

NEAR = 0.2
"""Standard deviations: a change that ends the search where another one is to follow."""

_HALVINGS = 6  # of a step to a candidate that cannot be simulated


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
    run: RobotRun | RobotDriveSideRun | RobotRuns
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


@dataclass(frozen=True, slots=True, eq=False)
class FixedPoint:
    """End of the steps by the regressor of the simulated motion.

    Attributes:
        problem: as the last step weighed it.
        x: there. run: of that.
        iterations: that were made. converged: whether they settled.
    """

    problem: RobotProblem[Any]
    x: FloatArray
    run: Any
    iterations: int
    converged: bool

    @property
    def left(self) -> float:
        """Norm of the shares of the joints' filtered torques that are left."""
        problem = self.problem
        return float(np.linalg.norm(problem.norms(problem.error(self.run)) / problem.sizes))

    def fit(self) -> RobotFit:
        """Return the fit there."""
        slopes, regressor = self.problem.slopes(self.run, self.x), self.problem.regressor(self.run)
        return conclude(self.problem, self.x, self.run, slopes, regressor, self.iterations, self.converged)


def fixed_point(
    problem: RobotProblem[Run],
    x: FloatArray,
    run: Run,
    iterations: int,
    progress: Progress = lambda _: None,
    settled: float = SETTLED,
) -> FixedPoint:
    """Iterate with the regressor of the simulated motion from a valid start."""
    bounds, size, floor = Bounds.of(problem.free), problem.sizes, problem.floor
    arrived, made = False, 0
    # What no position shows never settles: the integral takes whatever is added.
    told = [not (problem.integrates and p.name.rpartition(".")[2] in CONSTANT) for p in problem.free]
    for number in range(iterations):
        error, W = problem.error(run), problem.regressor(run)
        problem, step, std = problem.step(W, error, floor, 1)
        share = problem.norms(error) / size
        progress(Detail(f"iteration {number}: torque error {100 * float(np.max(share)):.4f} % on the worst joint"))
        after = bounds.clip(x + step)
        arrived = bool(np.all((np.abs(after - x) <= settled * std)[told]))
        made = number + 1
        x, run = _take_step(problem, x, after, run)
        if arrived:
            break
    return FixedPoint(problem, x, run, made, arrived)


def conclude(
    problem: RobotProblem[Run],
    x: FloatArray,
    run: Run,
    J: FloatArray,
    Z: FloatArray,
    made: int,
    settled: bool,
) -> RobotFit:
    """Return the fit at an end, with the covariance of instruments Z, (rows, free), beside slopes J; both not weighted.

    Of least squares the instruments are the slopes.

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
    weighted = Z * weights[:, np.newaxis], J * weights[:, np.newaxis], error * weights
    covariance = robust(*weighted, equations=problem.sigma.size)
    if problem.motion_measured:
        covariance = with_measured_motion(covariance, *weighted, problem.sigma.size)
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
        triangle(weighted[1]),
    )


def _take_step(problem: RobotProblem[Run], x: FloatArray, after: FloatArray, run: Run) -> tuple[FloatArray, Run]:
    """Return the end of a step, halved until it can be simulated."""
    for _ in range(_HALVINGS):
        found = problem.run(after)
        if found.outcome is Outcome.FINISHED:
            return after, found
        after = 0.5 * (x + after)
    return x, run
