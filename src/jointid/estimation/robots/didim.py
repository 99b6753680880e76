"""DIDIM of a robot of rigid joints: all parameters from the motors' torques and the commanded references alone.

The robot is simulated under its controllers at the current parameters, and the regressor W of the simulated motion
gives the next change of the parameters, by least squares over the joints' filtered errors, each divided by its size::

    tau - tau_sim = W dx

in the residual form of M. Gautier, A. Janot and P.-O. Vandanjon (A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Transactions on Control Systems Technology 21, 2013). The measurement's noise
does not reach W, which so acts as instruments for the derivatives J of the torques; the covariance is theirs, robust to
autocorrelation (`uncertainty.covariance`), with J by variation.

The search begins at what the inverse model finds on a motion that the records imply (`rigid_robot_start`). The column
of Coulomb friction is that of the direction of sliding, but of the velocity's sign where it is now 0 or less: a mass
without it never rests, and a fixed point with a negative one would stay. Viscous and Coulomb friction are not let below
0.

Friction that is not linear in its parameters, and free delays of the torques, are searched from there (`laws`). Where
no delay is declared, that search begins at the fixed point of several delays that leaves the least torque error.

Valid for rigid joints, or below about a fifth of the first resonance; the robot at rest at the first sample, or moving
as its references do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.robots.fit import NEAR, SETTLED, FixedPoint, RobotFit, fixed_point
from jointid.estimation.robots.laws import search_laws
from jointid.estimation.robots.numbers import (
    add_delays,
    apply_constraints,
    find_free_delays,
    robot_parameters,
    with_delays,
)
from jointid.estimation.robots.problem import EXACT, RobotLoopProblem, add_problems, robot_problem
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.inverse_controller import command_of, reconstructed_position
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.record import Channel, Record, Timing
from jointid.records.signals.filtering import (
    Filtering,
    apply_window,
    differentiate_twice,
    lowpass,
    settle,
    window_torque,
)
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.robot_sensitivities import columns_of
from jointid.simulation.robots import MassMotion, RobotLoop, RobotRun


def identify_rigid_robot(
    loop: RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    *,
    offsets: bool = True,
    iterations: int = 30,
    evaluations: int = 60,
    settled: float = SETTLED,
    known: Mapping[str, Parameter] | None = None,
    free: Sequence[str] = (),
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
        evaluations: simulations with derivatives, at most, of each descent to laws that are not linear.
        settled: the largest change of a parameter that ends them, standard deviations.
        known: values and bounds to keep, by name; see `apply_constraints`.
        free: of the delays of the torques, see `find_free_delays`.
        progress: receives each iteration.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, or nothing can be simulated at the start.
    """
    known, logs, robot = known or {}, each_log(records), loop.robot.rigid
    late = find_free_delays(loop, free)
    settled = settled if robot.linear.joints == robot.joints and not late else NEAR

    def pose(of: Robot, under: RobotLoop, freed: Sequence[int]) -> list[RobotLoopProblem]:
        under = replace(under, robot=of)
        parameters = add_delays(apply_constraints(robot_parameters(of, offsets=offsets), known), under, freed)
        return [robot_problem(under, log, parameters, filtering) for log in logs]

    def search(under: RobotLoop) -> FixedPoint:
        parts = pose(robot.linear, under, ())
        x, run = rigid_robot_start(parts[0], replace(under, robot=robot.linear), logs[0])
        if len(parts) == 1:
            return fixed_point(parts[0], x, run, iterations, progress, settled)
        problem = add_problems(parts)
        runs = problem.run(x)
        if runs.outcome is not Outcome.FINISHED:
            raise MethodError(
                "The robot cannot be simulated along all logs from the start that the first gives: "
                f"{runs.outcome.value}. Name a livelier record first."
            )
        return fixed_point(problem, x, runs, iterations, progress, settled)

    undeclared = [j for j in late if not numbers_of(loop.controllers[j]).get(DELAY)]
    tried = [with_delays(loop, dict.fromkeys(undeclared, delay)) for delay in DELAYS] if undeclared else [loop]
    ends, failures = list[tuple[FixedPoint, RobotLoop]](), list[MethodError]()
    for under in tried:
        try:
            ends.append((search(under), under))
        except MethodError as error:  # no robot is stable with such a delay
            failures.append(error)
    if not ends:
        raise failures[0]
    end, near = min(ends, key=lambda one: one[0].left) if len(ends) > 1 else ends[0]
    freed = partial(pose, under=near, freed=late)
    laws = partial(search_laws, known=known, evaluations=evaluations, progress=progress, delays=bool(late))
    return laws(robot, end.fit(), lambda of: add_problems(freed(of)))


_REWEIGHTINGS = 2


def rigid_robot_start(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record]
) -> tuple[FloatArray, RobotRun]:
    """Return the start of a search and its simulation: the inverse model on the motion that the controllers saw.

    Where a controller cannot be turned round, the commanded motion is taken. A start of regular inertias is not tried:
    M(q) of one may not be positive definite in a pose.
    """
    failures = []
    for name, make in (("inversion", _reconstructed_motion), ("reference", _commanded_motion)):
        try:
            torques, positions = make(problem, loop, records)
        except MethodError as error:
            failures.append(str(error))
            continue
        x = _regress(problem, torques, positions)
        run = problem.run(x)
        if run.outcome is Outcome.FINISHED:
            return x, run
        failures.append(f"at the {name} start {run.outcome.value}.")
    alone = ", in SI units and not in a drive's whole numbers," if any(one.computed for one in records) else ","
    raise MethodError(
        "The robot cannot be simulated where its search begins: "
        + " ".join(failures)
        + f" Check the controllers' gains{alone} and their period where "
        "they run faster than the log, the signs and units of torques and references, and the joints' places."
    )


def _reconstructed_motion(
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
    return problem.measured, problem.experiment.references[clock.log_index // clock.lengths.size]


def _regress(problem: RobotLoopProblem, torques: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the inverse model's weighted estimate on a motion, within bounds."""
    sample_time, cutoff = problem.sample_time, problem.filtering.position_cutoff
    assert cutoff is not None
    n, each_loop = torques.shape[1], problem.experiment.experiments
    smooth = lowpass(positions, cutoff, sample_time)
    each = [differentiate_twice(column, sample_time) for column in smooth.T]
    velocity, acceleration = (np.column_stack([pair[i] for pair in each]) for i in range(2))
    motion = MassMotion(smooth, velocity, acceleration, np.sign(settle(velocity)))
    parameters = problem.parameters
    rotors = parameters.base.rotors
    columns = columns_of(problem.tree, parameters.base, parameters.places, motion, rotors)
    held = [Channel(torques[:, j], "N m", sample_time, Timing.HELD) for j in range(n)]  # its unit is not read
    seen = np.column_stack(
        [window_torque(channel, each.law.delay) for channel, each in zip(held, each_loop, strict=True)]
    )
    borders = slice(*(50, len(seen) - 50) if len(seen) > 500 else (0, len(seen)))
    Y = problem.decimate(seen[borders])
    W = problem.decimate_columns([(own, apply_window(values)[borders]) for own, values in columns])
    floor = EXACT * float(np.linalg.norm(Y))
    return Bounds.of(problem.free).clip(problem.step(W, Y, floor, _REWEIGHTINGS)[1])
