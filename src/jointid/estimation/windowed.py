"""The models of windows: a joint or a robot that is simulated, and the inverse model of either.

Each takes the rows of a window from the code that takes those of a whole record: the loop of a joint
(`problems.closed_loop`), the inverse model of a joint or a robot (`problems.inverse_model`), and a robot that is
simulated (`robots.simulated`), whose window begins in motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.text import join
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.base import adjust_parameters
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    REST,
    Inverse,
    inverse_of_joint,
    read_as,
)
from jointid.estimation.problems.log_windows import NotSimulatedError, Seen, WindowModel
from jointid.estimation.problems.simulated import outcome_of, pose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.regression import inverse_of_robot
from jointid.estimation.robots.simulated import IdentifiedRobot, nominal_numbers
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import cut
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering, decimated_at, drop_ends
from jointid.simulation.controller_torque import seen_position
from jointid.simulation.drive_side import RobotDriveSide
from jointid.simulation.loop_input import RobotLoop, prepare
from jointid.simulation.simulate import Outcome
from jointid.uncertainty.resampling import Sums

_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_TOLD = 1e-4  # of the torque: less is never told
_RINGS = 10.0  # periods of its cut-off that the zero-phase filter rings


def commanded(record: Record) -> Channel | None:
    """Return the reference, or without one the motor position."""
    return record.motor_position if record.reference is None else record.reference


def travel(records: Sequence[Record]) -> float:
    """Return how far the axes are asked to move in a window, or what is injected varies, in sum."""
    asked = [commanded(one) if one.injected is None else one.injected.channel for one in records]
    return sum(float(np.sum(np.abs(np.diff(one.values)))) for one in asked if one is not None)


def moves(records: Sequence[Record]) -> bool:
    """Test whether a window has a motion or something injected, and no brake that holds a joint at a torque of 0."""
    braked = any(one.torque is not None and not np.any(one.torque.values) for one in records)
    return not braked and (travel(records) > 0 or any(one.injected is not None for one in records))


def _ringing(filtering: Filtering, sample_time: float) -> int:
    """Return how many samples a resolved filtering rings."""
    assert filtering.cutoff is not None
    return math.ceil(_RINGS / (filtering.cutoff * sample_time))


def _require_finished(outcome: Outcome, record: Record) -> None:
    if outcome is not Outcome.FINISHED:
        raise NotSimulatedError(
            f"The window that begins at {record.begin:.0f} s cannot be simulated, because {outcome.value}; check the "
            "controller and the start, or begin from another window."
        )


# A joint that is simulated


def loop_model(like: ClosedLoopProblem, *, whole: bool = False) -> WindowModel:
    """Return the loop of a joint, as it is compared with windows.

    Args:
        like: the problem of the window that is started from, which those of all others are like.
        whole: whether that is the only window.
    """

    def look(records: Sequence[Record], x: FloatArray) -> Seen | None:
        if not (whole or moves(records)):
            return None
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
        return remembers + _ringing(like.filtering, like.sample_time)

    return WindowModel(like.free, look, settling, problem=like)


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


# The inverse model of a joint or a robot


def inverse_model(
    inverse: Inverse, parameters: Sequence[Parameter], fit: Estimate, records: Sequence[Record]
) -> WindowModel:
    """Return an inverse model, as it is compared with windows.

    Args:
        inverse: its columns.
        parameters: of the columns.
        fit: of the window that is started from.
        records: of that window.
    """
    settings, free = fit.settings, np.array([p.free for p in parameters])
    kept, part = np.array([0.0 if p.free else p.start or 0.0 for p in parameters]), fit.robot

    def regress(records: Sequence[Record]) -> tuple[Seen, FloatArray]:
        motion = inverse.measure(read_as(records, settings.timing), settings.filtering)
        rows, keep = inverse.rows([motion]), motion.filtering.decimation
        assert keep is not None
        Y, poses = rows.by_equation(rows.Y), list(zip(motion.q.T, motion.v.T, strict=True))
        seen = Seen(Y, rows.W.reshape(*Y.shape, -1), Y, motion.rows_at(), len(motion.q), keep, poses)
        return seen, np.sqrt(np.mean(motion.v**2, axis=0))

    _, speeds = regress(records)

    def look(records: Sequence[Record], x: FloatArray) -> Seen | None:
        if not moves(records):
            return None
        found, speed = regress(records)
        if np.all(speed < REST * speeds):  # of rest
            return None
        values = kept.copy()
        values[free] = x
        return replace(found, error=found.error - found.J @ values, J=-found.J[..., free])

    def nominal(x: FloatArray, sums: Sums) -> FloatArray:
        # The robot's own masses, with the friction that fits best beside them.
        assert part is not None
        masses, step = part.parameters.inertial[free], part.nominal[free] - x
        friction = ~masses
        target = sums.b[friction] + sums.A[np.ix_(friction, masses)] @ step[masses]
        step[friction] = -np.linalg.lstsq(sums.A[np.ix_(friction, friction)], target, rcond=None)[0]
        return np.asarray(x + step)

    rings = _ringing(settings.filtering, fit.data.sample_time)
    identified = tuple(p for p in parameters if p.free)
    return WindowModel(identified, look, lambda *_: rings, motion_measured=True, nominal=nominal)


# A robot that is simulated


def robot_model(setup: RobotLoop | RobotDriveSide, part: IdentifiedRobot, filtering: Filtering) -> WindowModel:
    """Return a robot that is simulated, as it is compared with windows.

    Args:
        setup: the robot under its controllers, or along its motors' motion.
        part: what a window by itself told, with its parameters.
        filtering: resolved.
    """
    parameters, under = part.parameters, replace(setup, in_motion=True) if isinstance(setup, RobotLoop) else setup

    def look(records: Sequence[Record], x: FloatArray) -> Seen | None:
        if not moves(records):
            return None
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
        assert whole is not None
        first = whole.samples // (4 * whole.keep) * whole.keep
        later = look([cut(record, first, whole.samples) for record in records], x)
        if later is None:
            return first
        of_whole, of_later = np.intersect1d(whole.at - first, later.at, return_indices=True)[1:]
        apart = np.abs(whole.error[:, of_whole] - later.error[:, of_later])
        least = _TOLD * np.sqrt(np.mean(whole.measured**2, axis=1, keepdims=True))
        far = apart > np.maximum(_FORGOTTEN * np.max(apart, axis=1, keepdims=True), least)
        # What lies beside a window's end rings as long as what lies beside its beginning.
        rows = np.flatnonzero(np.any(far[:, later.at[of_later] < later.samples // 2], axis=0))
        return int(later.at[of_later][rows[-1]]) + later.keep if rows.size else later.keep

    def nominal(x: FloatArray, sums: Sums) -> FloatArray:
        del sums
        values = parameters.values(x)
        masses = parameters.group(nominal_numbers(part.model, parameters.numbers(values)))
        # What is of the record is as it was found.
        return parameters.to_search_variables(np.where(parameters.of_robot, masses, values))

    measured = isinstance(setup, RobotDriveSide)
    return WindowModel(parameters.parameters, look, settling, measured, nominal=nominal, searched=parameters)


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
    robot, refused, remedy = isinstance(model, Robot | RobotLoop | RobotDriveSide), [*free], "leave it out"
    if isinstance(method, IDIM) or (method is None and isinstance(model, Joint | Robot)):
        estimator = None if method is None else method.estimator
        if estimator in (None, "weighted" if robot else "ols"):
            return
        refused = [f"IDIM by {estimator}"]
    elif robot:
        refused += method.free if isinstance(method, DIDIM) else ()
    elif not isinstance(model, ClosedLoop) or not isinstance(method, DIDIM | None):
        refused = [f"{type(model).__name__} by {type(method).__name__}"]
    elif "drifting" in model.joint.friction.name:
        refused = [f"{model.joint.friction.name} friction, which follows the time from the first sample"]
        remedy = 'declare friction = "symmetric"'
    if refused:
        raise MethodError(f"Windows do not take {join(refused)}; {remedy}, or cut the record by start and stop.")


def model_of_windows(
    model: object, records: Sequence[Record], fit: Estimate, known: Mapping[str, Parameter]
) -> tuple[WindowModel, FloatArray]:
    """Return the model of all windows, and where its search starts.

    Args:
        model: of the joint or robot.
        records: of a window.
        fit: of that.
        known: changes to the parameters.
    """
    found, part, settings = {row.name: row for row in fit.params.rows}, fit.robot, fit.settings
    if fit.problem is not None:
        window = begin_window(fit.problem, records[0])
        return loop_model(window), window.vector({n: row.value for n, row in found.items() if row.value is not None})
    if part is not None and isinstance(model, RobotLoop | RobotDriveSide) and settings.method != "idim":
        x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
        return robot_model(model, part, settings.filtering), x
    if part is not None:
        inverse = inverse_of_robot(part.model, part.parameters)
        wanted = [
            known[name]  # what a bound held in a window may be off it in all of them
            if name in known and not row.free
            else replace(known.get(name) or Parameter(name, row.symbol, Quantity.RATIO), start=row.value, free=row.free)
            for name, row in found.items()
        ]
    else:
        zeros = ENCODER_OFFSET.name in found
        inverse = inverse_of_joint(settings.joint, settings.delay, zeros=zeros)
        wanted = [*adjust_parameters(settings.joint.parameters, known), *([ENCODER_OFFSET] if zeros else [])]
    whole = inverse_model(inverse, wanted, fit, records)
    return whole, np.array([found[p.name].value for p in whole.free], dtype=np.float64)
