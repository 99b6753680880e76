"""DIDIM of a robot of rigid joints: all parameters from the motors' torques and the commanded references alone.

The robot is simulated under its controllers at the current parameters, and the regressor W of the simulated motion
gives the next change of the parameters, by least squares over the joints' filtered errors, each divided by its size::

    tau - tau_sim = W dx

in the residual form of M. Gautier, A. Janot and P.-O. Vandanjon (A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Transactions on Control Systems Technology 21, 2013). The measurement's noise
does not reach W, which so acts as instruments for the derivatives J of the torques; the covariance is theirs, robust to
autocorrelation (`uncertainty.covariance`), with J by variation.

The search begins at what the inverse model finds on the motion that the controllers must have seen to put out the
logged torques. Where one of them cannot be turned round, on the commanded motion. A start of regular inertias is not
tried: M(q) of one may not be positive definite in a pose. The column of Coulomb friction is that of the direction of
sliding, but of the velocity's sign where it is now 0 or less: a mass without it never rests, and a fixed point with a
negative one would stay. Viscous and Coulomb friction are not let below 0.

Valid for rigid joints, or below about a fifth of the first resonance; the robot at rest at the first sample, or moving
as its references do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Bounds
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.robots.numbers import RobotParameters, robot_parameters
from jointid.estimation.robots.problem import RobotLoopProblem, RobotProblem, Run, robot_problem
from jointid.estimation.starts.inverse_controller import command_of, reconstructed_position
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.record import Channel, Record, Timing
from jointid.records.signals.filtering import (
    Filtering,
    apply_window,
    differentiate_twice,
    lowpass,
    window_torque,
)
from jointid.simulation.robot_columns import columns_of
from jointid.simulation.robot_drive_side import RobotDriveSideRun
from jointid.simulation.robot_numbers import robot_with
from jointid.simulation.robots import MassMotion, RobotLoop, RobotOutcome, RobotRun
from jointid.uncertainty.covariance import Covariance, robust

SETTLED = 0.02
"""Standard deviations: the largest change of a parameter that ends the search."""

_EXACT = 1e-6  # of the torques: an error that the simulation itself may have
_HALVINGS = 6  # of a step to a candidate that cannot be simulated
_REWEIGHTINGS = 3  # of a start
_SINGULAR = 1e-9  # of columns of norm 1: the least singular value of what a record tells


@dataclass(frozen=True, slots=True, eq=False)
class RobotFit:
    """What was identified of a robot from the records of its joints.

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
    run: RobotRun | RobotDriveSideRun
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
    records: Sequence[Record],
    filtering: Filtering | None = None,
    *,
    offsets: bool = True,
    iterations: int = 30,
    settled: float = SETTLED,
    progress: Progress = lambda _: None,
) -> RobotFit:
    """Identify a robot of rigid joints from torques and references; positions in the records are not read.

    Args:
        loop: the robot, of which the links' places and gravity are read, but no inertial number nor spring, and its
            controllers.
        records: one for each joint, with torque and reference, of one log.
        filtering: that torques and columns go through alike.
        offsets: whether each motor has a constant torque that is identified, too.
        iterations: at most.
        settled: the largest change of a parameter that ends them, standard deviations.
        progress: is told each iteration.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, or nothing can be simulated at the start.
    """
    robot = replace(loop.robot, joints=tuple(replace(joint, spring=None) for joint in loop.robot.joints))
    loop = replace(loop, robot=robot)
    parameters = robot_parameters(robot, offsets=offsets)
    problem = robot_problem(loop, records, parameters, filtering)
    x, run = start_of(problem, loop, records, progress)
    return fixed_point(problem, x, run, iterations, progress, settled)


def fixed_point(
    problem: RobotProblem[Run],
    x: FloatArray,
    run: Run,
    iterations: int,
    progress: Progress = lambda _: None,
    settled: float = SETTLED,
) -> RobotFit:
    """Return where steps by the regressor of the simulated motion lead to, from a start that could be simulated."""
    bounds, size, floor = Bounds.of(problem.free), problem.sizes, problem.floor
    arrived, made = False, 0
    for number in range(iterations):
        error, W = problem.error(run), problem.regressor(run)
        step, std, left = _step(problem, W, error)
        problem = problem.weighted(joint_sizes(problem, left, x.size, floor))
        step, std, left = _step(problem, W, error)
        share = problem.norms(error) / size
        progress(f"iteration {number}: torque error {100 * float(np.max(share)):.4f} % on the worst joint")
        after = bounds.clip(x + step)
        arrived = bool(np.all(np.abs(after - x) <= settled * std))
        made = number + 1
        x, run = _moved(problem, x, after, run)
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
    problem = problem.weighted(joint_sizes(problem, error, x.size, problem.floor))
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


def joint_sizes(problem: RobotProblem[Run], left: FloatArray, count: int, floor: float) -> FloatArray:
    """Return the sizes of the joints' errors, (n,), of a residual that so many parameters left."""
    rows = problem.by_joint(left)
    degrees = max(rows.size - count, 1) / rows.size
    least = floor / math.sqrt(rows.shape[1])
    return np.asarray(np.maximum(np.sqrt(np.mean(rows**2, axis=1) / degrees), least))


def _step(problem: RobotProblem[Run], W: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weighted least-squares step, its standard deviations for white errors, and what it leaves, (rows,)."""
    from jointid.common.compiled import triangle_of

    weights = problem.weights(error.size)
    weighted = W * weights[:, np.newaxis]
    norms = column_norms(weighted)
    idle = [
        name for name, norm in zip(problem.parameters.names, np.linalg.norm(weighted, axis=0), strict=True) if norm == 0
    ]
    both = np.zeros((norms.size + 1, norms.size + 1))
    triangle_of(np.column_stack([weighted / norms, error * weights]), both)
    R, target = both[:-1, :-1], both[:-1, -1]
    _, sizes, directions = np.linalg.svd(R)
    if idle or sizes[-1] < _SINGULAR * sizes[0]:
        names = idle or [problem.parameters.names[i] for i in np.flatnonzero(np.abs(directions[-1]) > 0.2)]
        raise MethodError(
            f"The records do not tell {', '.join(names)} apart, or not at all; expected a motion that excites all "
            "parameters: move all joints, at several speeds and both ways."
        )
    step = np.linalg.solve(R, target) / norms
    std = np.linalg.norm(np.linalg.inv(R), axis=1) / norms
    return step, std, error - W @ step


def _moved(problem: RobotProblem[Run], x: FloatArray, after: FloatArray, run: Run) -> tuple[FloatArray, Run]:
    """Return where a step leads, halved while it cannot be simulated there."""
    for _ in range(_HALVINGS):
        found = problem.run(after)
        if found.outcome is RobotOutcome.FINISHED:
            return after, found
        after = 0.5 * (x + after)
    return x, run


def start_of(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record], progress: Progress
) -> tuple[FloatArray, RobotRun]:
    """Return where a search begins and the run there: the inverse model on the motion that the controllers saw."""
    failures = []
    for name, make in (("inversion", _seen_motion), ("reference", _commanded_motion)):
        try:
            torques, positions = make(problem, loop, records)
        except MethodError as error:
            failures.append(str(error))
            continue
        x = _regressed(problem, torques, positions)
        run = problem.run(x)
        if run.outcome is RobotOutcome.FINISHED:
            return x, run
        failures.append(f"at the {name} start {run.outcome.value}.")
    raise MethodError(
        "The robot cannot be simulated where its search begins: "
        + " ".join(failures)
        + " Check the controllers' gains, and their period where they run faster than the log, "
        "the signs and units of torques and references, and the joints' places."
    )


def _seen_motion(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record]
) -> tuple[FloatArray, FloatArray]:
    """Return the motors' torques and the positions that the controllers must have seen, (samples, n) each."""
    measured, references = _commanded_motion(problem, loop, records)
    found, samples = [], len(measured)
    for j, (link, controller, record) in enumerate(zip(loop.robot.links, loop.controllers, records, strict=True)):
        if problem.experiment.experiments[j].repeat > 1:  # the log shows each output of this slow controller many times
            found.append((measured[:, j], references[:, j]))
            continue
        joint = RigidJoint(link.kind)
        alone = torque_problem(record, ClosedLoop(joint, controller), problem.filtering, joint.parameters)
        found.append((command_of(alone)[:samples], reconstructed_position(alone)[:samples]))
    torques, positions = (np.column_stack([pair[i] for pair in found]) for i in range(2))
    return torques, positions


def _commanded_motion(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record]
) -> tuple[FloatArray, FloatArray]:
    """Return the motors' torques and the references, (samples, n) each."""
    del loop, records
    clock = problem.experiment.clock
    return problem.measured, problem.experiment.references[clock.looked // clock.lengths.size]


def _regressed(problem: RobotLoopProblem, torques: FloatArray, positions: FloatArray) -> FloatArray:
    """Return what the inverse model finds on a motion, within bounds, the joints weighing by their errors."""
    sample_time, cutoff = problem.sample_time, problem.filtering.position_cutoff
    assert cutoff is not None
    n, each_loop = torques.shape[1], problem.experiment.experiments
    smooth = lowpass(positions, cutoff, sample_time)
    each = [differentiate_twice(column, sample_time) for column in smooth.T]
    velocity, acceleration = (np.column_stack([pair[i] for pair in each]) for i in range(2))
    motion = MassMotion(smooth, velocity, acceleration, np.sign(velocity))
    parameters = problem.parameters
    rotors = parameters.base.rotors
    columns = columns_of(problem.tree, parameters.base, parameters.places, motion, rotors)
    held = [Channel(torques[:, j], "N m", sample_time, Timing.HELD) for j in range(n)]  # its unit is not read
    seen = np.column_stack(
        [window_torque(channel, each.law.delay) for channel, each in zip(held, each_loop, strict=True)]
    )
    borders = slice(*(50, len(seen) - 50) if len(seen) > 500 else (0, len(seen)))
    Y = problem.decimated(seen[borders])
    W = problem.decimated_columns([(own, apply_window(values)[borders]) for own, values in columns])
    floor = _EXACT * float(np.linalg.norm(Y))
    x = np.zeros(len(parameters.places))
    for _ in range(_REWEIGHTINGS):
        x, _, left = _step(problem, W, Y)
        problem = problem.weighted(joint_sizes(problem, left, x.size, floor))
    return Bounds.of(problem.free).clip(x)
