"""DIDIM of a robot of rigid joints: all parameters from the motors' torques and the commanded references alone.

The robot is simulated under its controllers at the current parameters, and the regressor W of the simulated motion
gives the next change of the parameters, by least squares over the joints' filtered errors, each divided by its size::

    tau - tau_sim = W dx

in the residual form of M. Gautier, A. Janot and P.-O. Vandanjon (A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Transactions on Control Systems Technology 21, 2013). The measurement's noise
does not reach W, which so acts as instruments for the derivatives J of the torques; the covariance is theirs, robust to
autocorrelation (`uncertainty.covariance`), with J by variation.

The search begins at what the inverse model finds on a motion that the records imply (`starts.rigid_robot`). The column
of Coulomb friction is that of the direction of sliding, but of the velocity's sign where it is now 0 or less: a mass
without it never rests, and a fixed point with a negative one would stay. Viscous and Coulomb friction are not let below
0.

Valid for rigid joints, or below about a fifth of the first resonance; the robot at rest at the first sample, or moving
as its references do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.estimation.robots.numbers import RobotParameters, apply_constraints, robot_parameters
from jointid.estimation.robots.problem import RobotProblem, RobotRuns, Run, add_problems, robot_problem
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.rigid_robot import rigid_robot_start
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import (
    Filtering,
)
from jointid.simulation.robot_drive_side import RobotDriveSideRun
from jointid.simulation.robot_numbers import robot_with
from jointid.simulation.robots import RobotLoop, RobotOutcome, RobotRun
from jointid.uncertainty.covariance import Covariance, robust

SETTLED = 0.02
"""Standard deviations: the largest change of a parameter that ends the search."""

_HALVINGS = 6  # of a step to a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RobotFit:
    """The fit of a robot to the records of its joints.

    Attributes:
        parameters: what they are. values: (parameters,) of them. covariance: of their errors.
        sigma: (n,) sizes of the joints' filtered errors, N m or N.
        relative_error: (n,) of the filtered torques, a share each.
        iterations: that were made. converged: whether they settled.
        run: at the values.
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
    information: FloatArray

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


def identify_rigid_robot(
    loop: RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    *,
    offsets: bool = True,
    iterations: int = 30,
    settled: float = SETTLED,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = lambda _: None,
) -> RobotFit:
    """Identify a robot of rigid joints from torques and references; positions in the records are not read.

    Args:
        loop: the robot, of which the links' places and gravity are read, but no inertial number nor spring, and its
            controllers.
        records: one for each joint, with torque and reference, of one log; or those of several logs.
        filtering: that torques and columns go through alike.
        offsets: whether each motor has a constant torque that is identified, too.
        iterations: at most.
        settled: the largest change of a parameter that ends them, standard deviations.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives each iteration.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, or nothing can be simulated at the start.
    """
    loop.robot.require_lines("DIDIM of a robot takes")
    robot = replace(loop.robot, joints=tuple(replace(joint, spring=None) for joint in loop.robot.joints))
    loop = replace(loop, robot=robot)
    parameters = apply_constraints(robot_parameters(robot, offsets=offsets), known or {})
    logs = each_log(records)
    parts = [robot_problem(loop, log, parameters, filtering) for log in logs]
    x, run = rigid_robot_start(parts[0], loop, logs[0])
    if len(parts) == 1:
        return fixed_point(parts[0], x, run, iterations, progress, settled)
    problem = add_problems(parts)
    runs = problem.run(x)
    if runs.outcome is not RobotOutcome.FINISHED:
        raise MethodError(
            f"The robot cannot be simulated along all logs from the start that the first gives: {runs.outcome.value}. "
            "Name a livelier record first."
        )
    return fixed_point(problem, x, runs, iterations, progress, settled)


def fixed_point(
    problem: RobotProblem[Run],
    x: FloatArray,
    run: Run,
    iterations: int,
    progress: Progress = lambda _: None,
    settled: float = SETTLED,
) -> RobotFit:
    """Iterate with the regressor of the simulated motion from a valid start."""
    bounds, size, floor = Bounds.of(problem.free), problem.sizes, problem.floor
    arrived, made = False, 0
    for number in range(iterations):
        error, W = problem.error(run), problem.regressor(run)
        step, std, left = problem.step(W, error)
        problem = problem.reweight(left, x.size, floor)
        step, std, left = problem.step(W, error)
        share = problem.norms(error) / size
        progress(f"iteration {number}: torque error {100 * float(np.max(share)):.4f} % on the worst joint")
        after = bounds.clip(x + step)
        arrived = bool(np.all(np.abs(after - x) <= settled * std))
        made = number + 1
        x, run = _take_step(problem, x, after, run)
        if arrived:
            break
    return conclude(problem, x, run, problem.slopes(run, x), problem.regressor(run), made, arrived)


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
    """
    error = problem.error(run)
    problem = problem.reweight(error, x.size)
    weights = problem.weights(error.size)
    covariance = robust(
        Z * weights[:, np.newaxis], J * weights[:, np.newaxis], error * weights, equations=problem.sigma.size
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
        np.asarray(np.linalg.qr(J * weights[:, np.newaxis], mode="r")),
    )


def _take_step(problem: RobotProblem[Run], x: FloatArray, after: FloatArray, run: Run) -> tuple[FloatArray, Run]:
    """Return the end of a step, halved until it can be simulated."""
    for _ in range(_HALVINGS):
        found = problem.run(after)
        if found.outcome is RobotOutcome.FINISHED:
            return after, found
        after = 0.5 * (x + after)
    return x, run
