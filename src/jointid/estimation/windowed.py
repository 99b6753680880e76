"""The models of windows: the loop of a joint, and a robot that is simulated, whose window begins in motion.

Each takes the rows of a window from the problem that takes those of a whole record (`problems.closed_loop`,
`problems.simulated`). The inverse model needs no windows: its rows are few (`problems.inverse_model`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.estimation.problems.pieces import Model, NotSimulatedError, Seen, commanded
from jointid.estimation.problems.simulated import outcome_of, pose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.simulated import IdentifiedRobot
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimated_at, drop_ends
from jointid.simulation.controller_torque import seen_position
from jointid.simulation.drive_side import RobotDriveSide
from jointid.simulation.loop_input import RobotLoop, prepare
from jointid.simulation.simulate import Outcome

_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_TOLD = 1e-4  # of the torque: less is never told
_RINGS = 10.0  # periods of its cut-off that the zero-phase filter rings


def _require_finished(outcome: Outcome, record: Record) -> None:
    if outcome is not Outcome.FINISHED:
        raise NotSimulatedError(
            f"The window that begins at {record.begin:.0f} s cannot be simulated, because {outcome.value}; check the "
            "controller and the start, or begin from another window."
        )


# A joint that is simulated


def loop_model(like: ClosedLoopProblem, *, whole: bool = False) -> Model:
    """Return the loop of a joint, as it is compared with windows.

    Args:
        like: the problem of the window that is started from, which those of all others are like.
        whole: whether that is the only window.
    """

    def look(records: Sequence[Record], x: FloatArray) -> Seen:
        problem = like if whole else begin_window(like, records[0])
        torque, response, columns = problem.sensitivities(x)
        _require_finished(response.outcome, records[0])
        experiment = problem.axis
        position = experiment.inputs[experiment.clock.log_index // experiment.clock.lengths.size, REFERENCE]
        return Seen(
            problem.filter_error(torque, response)[0][np.newaxis],
            -problem.filter(columns)[np.newaxis],
            problem.filter(problem.measured)[np.newaxis],
            problem.kept,
            problem.measured.size,
            problem.filtering.decimation or 1,
            [(position, np.gradient(position, experiment.sample_time))],
            response.at_limit,
            (problem.measured, torque),
        )

    def settling(records: Sequence[Record], x: FloatArray) -> int:
        # A beginning that is off by the window's whole torque and speed, as no window's is, must show in no later
        # sample of the torque by more than a hundredth; the filter looks at what lies beside a window.
        other = begin_window(like, records[0], disturbed=1.0)
        apart = np.abs(like.torque(x) - other.torque(x)) > _FORGOTTEN * float(np.std(like.measured))
        remembers = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
        assert like.filtering.cutoff is not None
        return remembers + math.ceil(_RINGS / (like.filtering.cutoff * like.sample_time))

    return Model(like.free, look, settling, problem=like)


def begin_window(like: ClosedLoopProblem, record: Record, disturbed: float = 0.0) -> ClosedLoopProblem:
    """Return the problem of a window that is like another one's, with its own state at the first sample.

    Args:
        like: the problem of another window.
        record: the window.
        disturbed: by how much its beginning is to be wrong, as a share of the window's torque and speed.
    """
    assert record.torque is not None
    experiment = prepare(like.loop, record)
    problem = replace(like, measured=record.torque.values[: experiment.clock.samples], experiment=experiment, seen=None)
    # What an integral holds is one constant along the log, and no window's own.
    seen = None if experiment.axis.law.integrates else seen_position(record, like.loop)
    torque = float(problem.filter(problem.measured)[0])  # a single sample has all of the noise
    inputs, period = experiment.axis.inputs, experiment.axis.law.period
    velocity = float(inputs[1, REFERENCE] - inputs[0, REFERENCE]) / period
    torque += disturbed * float(np.std(problem.measured))
    velocity += disturbed * float(np.std(np.diff(inputs[:, REFERENCE]))) / period
    position = beginning_position(replace(problem, measured=np.full(1, torque)), velocity)
    if seen is not None and record.motor_position is not None:
        shown = seen.torque(record.motor_position.values)[: experiment.clock.samples]
        problem = replace(problem, seen=seen, measured=shown)
    return problem.keeping({"initial_position": position, "initial_velocity": velocity, "initial_torque": torque})


# A robot that is simulated


def robot_model(setup: RobotLoop | RobotDriveSide, part: IdentifiedRobot, filtering: Filtering) -> Model:
    """Return a robot that is simulated, as it is compared with windows.

    Args:
        setup: the robot under its controllers, or along its motors' motion.
        part: what a window by itself told, with its parameters.
        filtering: resolved.
    """
    parameters, under = part.parameters, replace(setup, in_motion=True) if isinstance(setup, RobotLoop) else setup

    def look(records: Sequence[Record], x: FloatArray) -> Seen:
        problem = replace(pose_robot(under, records, parameters, filtering), parameters=parameters)
        runs = problem.run(x)
        _require_finished(outcome_of(runs), records[0])
        error = problem.by_joint(problem.error(runs))
        samples, keep = len(problem.measured), filtering.decimation
        assert keep is not None
        at = decimated_at(-(-samples // keep), samples, filtering)
        if error.shape[1] < at.size:  # the torque is computed from positions
            at = drop_ends(at, filtering, samples)
        poses = [one.values[:samples] for one in map(commanded, records) if one is not None]
        return Seen(
            error,
            -problem.slopes(runs, x).reshape(*error.shape, -1),
            problem.by_joint(problem.filtered_torque),
            at,
            samples,
            keep,
            [(pose, np.gradient(pose, problem.sample_time)) for pose in poses],
        )

    def settling(records: Sequence[Record], x: FloatArray) -> int:
        # The number of samples after which two beginnings agree.
        whole = look(records, x)
        first = whole.samples // (4 * whole.keep) * whole.keep
        later = look([cut(record, first, whole.samples) for record in records], x)
        of_whole, of_later = np.intersect1d(whole.at - first, later.at, return_indices=True)[1:]
        apart = np.abs(whole.error[:, of_whole] - later.error[:, of_later])
        least = _TOLD * np.sqrt(np.mean(whole.measured**2, axis=1, keepdims=True))
        far = apart > np.maximum(_FORGOTTEN * np.max(apart, axis=1, keepdims=True), least)
        # What lies beside a window's end rings as long as what lies beside its beginning.
        rows = np.flatnonzero(np.any(far[:, later.at[of_later] < later.samples // 2], axis=0))
        return int(later.at[of_later][rows[-1]]) + later.keep if rows.size else later.keep

    return Model(parameters.parameters, look, settling, motion_measured=isinstance(setup, RobotDriveSide))


# How a window is taken for all of them


def require_windows(model: object, method: Method | None, free: Sequence[str] = ()) -> None:
    """Refuse what needs all rows at once, or the time from the first sample, and so is not identified in windows.

    Args:
        model: of a joint or a robot.
        method: of one window.
        free: what is free around several records.

    Raises:
        MethodError: of what is asked for something needs them.
    """
    refused, remedy = [*free], "leave it out"
    if isinstance(model, Joint | Robot) or isinstance(method, IDIM):
        refused = ["the inverse model, whose rows fit in memory"]
    elif isinstance(model, RobotLoop | RobotDriveSide):
        refused += method.free if isinstance(method, DIDIM) else ()
    elif not isinstance(model, ClosedLoop) or not isinstance(method, DIDIM | None):
        refused = [f"{type(model).__name__} by {type(method).__name__}"]
    elif "drifting" in model.joint.friction.name:
        refused = [f"{model.joint.friction.name} friction, which follows the time from the first sample"]
        remedy = 'declare friction = "symmetric"'
    if refused:
        raise MethodError(f"Windows do not take {join(refused)}; {remedy}, or cut the record by start and stop.")


def model_of_windows(model: object, records: Sequence[Record], fit: Estimate) -> tuple[Model, FloatArray]:
    """Return the model of all windows, and where its search starts.

    Args:
        model: of the joint's loop, or of the robot.
        records: of a window.
        fit: of that.
    """
    part = fit.robot
    if fit.problem is not None:
        window, found = begin_window(fit.problem, records[0]), fit.params.rows
        return loop_model(window), window.vector({row.name: row.value for row in found if row.value is not None})
    assert part is not None and isinstance(model, RobotLoop | RobotDriveSide)
    x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
    return robot_model(model, part, fit.settings.filtering), x
