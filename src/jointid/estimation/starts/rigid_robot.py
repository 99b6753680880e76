"""The start for a robot of rigid joints: its inverse model on a motion that the records imply.

That is the motion that the controllers must have seen to put out the logged torques; where one of them cannot be turned
round, the commanded motion. A start of regular inertias is not tried: M(q) of one may not be positive definite in a
pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.robots.problem import EXACT, RobotLoopProblem
from jointid.estimation.starts.inverse_controller import command_of, reconstructed_position
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Channel, Record, Timing
from jointid.records.signals.filtering import apply_window, differentiate_twice, lowpass, settle, window_torque
from jointid.simulation.robot_sensitivities import columns_of
from jointid.simulation.robots import MassMotion, RobotLoop, RobotOutcome, RobotRun

_REWEIGHTINGS = 3


def rigid_robot_start(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record]
) -> tuple[FloatArray, RobotRun]:
    """Return the start of a search and its simulation: the inverse model on the motion that the controllers saw."""
    failures = []
    for name, make in (("inversion", _reconstructed_motion), ("reference", _commanded_motion)):
        try:
            torques, positions = make(problem, loop, records)
        except MethodError as error:
            failures.append(str(error))
            continue
        x = _regress(problem, torques, positions)
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
    x = np.zeros(len(parameters.places))
    for _ in range(_REWEIGHTINGS):
        x, _, left = problem.step(W, Y)
        problem = problem.reweight(left, x.size, floor)
    return Bounds.of(problem.free).clip(x)
