"""A record beside the prediction of an identified joint or robot.

The joint or robot is simulated, or its inverse model evaluated. Only what belongs to the record is estimated anew: the
state at its first sample, and a load encoder's zero. Beside it the same model with free parameters is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.estimation.methods.drive_side import DriveSideProblem, motion_problem
from jointid.estimation.problems.base import INITIAL_STATE, LOG_DELAY
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, with_torque
from jointid.estimation.problems.inverse_model import ENCODER_OFFSET, inverse_of_joint, through_window
from jointid.estimation.result.estimate import Estimate, law_fingerprint
from jointid.estimation.starts.rigid_joint import fit_initial_state
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import differentiate
from jointid.simulation.closed_loop import require_success
from jointid.simulation.loop_input import prepare
from jointid.simulation.prescribed import PARTS, DriveSide
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve

_SEARCH = LevenbergMarquardt(1e-5, 40)  # of the attainable error: far below its reported digits


class Predicted(NamedTuple):
    """A record beside its prediction: raw signals (samples, n), filtered ones (n, rows).

    The rows of a flexible joint's inverse model are those of two `equations`, one after the other.

    Attributes:
        motion: positions, velocities and accelerations of the motors, (samples, n).
        with_free: returns the error, (n, rows), that the model with free parameters leaves; None if that fails.
        compared: (samples, n) 0 where a motor's rest or reversal is left out; all ones when None.
        nominal_errors: makes the errors, (n,), of the nominal robot; None of a joint.
    """

    sample_time: float
    borders: tuple[int, int]
    measured: FloatArray
    predicted: FloatArray
    error: FloatArray
    whole: FloatArray
    motion: Sequence[FloatArray]
    with_free: Callable[[], FloatArray | None]
    compared: FloatArray | None = None
    equations: int = 1
    nominal_errors: Callable[[], FloatArray] | None = None
    warnings: tuple[str, ...] = ()


def predict_joint(estimate: Estimate, record: Record) -> Predicted:
    """Predict the record of a joint.

    Raises:
        RecordError: a channel is missing.
        MethodError: a value is refused, or the joint cannot be simulated on this record.
    """
    known, settings = estimate.require_values(), estimate.settings
    if settings.loop is not None:
        return _simulate_loop(estimate, settings.loop, record)
    if settings.method == "drive_side":
        return _simulate_along_motion(estimate, record)
    assert record.torque is not None
    joint, filtering = settings.joint, settings.filtering
    inverse = inverse_of_joint(joint, settings.delay, zeros=joint.model == "flexible")
    motion = inverse.measure([record], filtering)
    raw = inverse.columns_along(motion)
    values, rows = np.array([known.get(name, 0.0) for name in inverse.names]), inverse.rows([motion], [raw])
    columns, whole = rows.W, rows.Y
    error = whole - columns @ values
    zero = np.array([name == ENCODER_OFFSET.name for name in inverse.names])  # counted from elsewhere in each record
    step = np.linalg.lstsq(columns[:, zero], error, rcond=None)[0]
    values[zero] += step
    predicted = through_window(raw[:, :1], filtering) @ values
    return Predicted(
        record.torque.sample_time, filtering.borders, motion.torque[:, :1],
        predicted, (error - columns[:, zero] @ step)[np.newaxis], whole[np.newaxis],
        [one[:, :1] for one in (motion.q, motion.v, motion.a)],
        lambda: _fit_columns(columns, whole[np.newaxis]), equations=raw.shape[1],
    )  # fmt: skip


def _fit_columns(columns: FloatArray, whole: FloatArray) -> FloatArray:
    """Return what a weighted fit of columns leaves of (n, rows); weights come from a first fit."""
    left = whole
    for _ in range(min(len(whole), 2)):
        weights = np.repeat(1.0 / np.maximum(np.linalg.norm(left, axis=1), 1e-300), whole.shape[1])
        fitted = np.linalg.lstsq(columns * weights[:, np.newaxis], whole.ravel() * weights, rcond=None)[0]
        left = whole - (columns @ fitted).reshape(whole.shape)
    return left


def _simulate_loop(estimate: Estimate, loop: ClosedLoop, record: Record) -> Predicted:
    assert record.torque is not None
    record.require(loop.channels, "Validation of a DIDIM estimate")
    experiment = prepare(loop, record)
    measured = record.torque.values[: experiment.samples]
    around = with_torque(INITIAL_STATE, experiment, measured)
    free = ClosedLoopProblem((*loop.joint.parameters, *around), measured, estimate.settings.filtering, loop, experiment)
    problem = free.keeping({p.name: estimate.values[p.name] for p in loop.joint.parameters})
    x, _ = fit_initial_state(problem)
    run = require_success(problem.simulate(x))
    other_law = (
        "the controller is not the one the joint was identified under; that is right only if its gains were changed"
    )
    return _predict_by(
        problem, free.keeping({"initial_velocity": problem.values(x)["initial_velocity"]}), x, run.torque,
        [run.motor_position, run.motor_velocity, run.motor.acceleration],
    )._replace(
        warnings=() if estimate.controller_sha256 in ("", law_fingerprint(loop)) else (other_law,),
    )  # fmt: skip


def _simulate_along_motion(estimate: Estimate, record: Record) -> Predicted:
    """Predict the torque along the motor's motion, with the log's own delay."""
    joint, filtering, values = estimate.settings.joint, estimate.settings.filtering, estimate.require_values()
    delay = LOG_DELAY.fix(-estimate.settings.delay)
    free = motion_problem(record, DriveSide(joint), filtering, joint.parameters, delay)
    problem = free.keeping({p.name: values[p.name] for p in joint.parameters})
    found = solve(problem, _SEARCH, problem.vector({})) if problem.free else None
    x = np.zeros(0) if found is None else found.x
    predicted, _, finished = problem.simulate(x, ())
    if not finished:
        raise MethodError("The joint cannot be simulated along this record; check its motor position and torque.")
    position, velocity = problem.motion.position[::PARTS], problem.motion.velocity[::PARTS]
    size = problem.measured.size
    motion = [one[:size] for one in (position, velocity, differentiate(velocity, problem.sample_time))]
    return _predict_by(problem, free, x, predicted, motion)._replace(
        compared=problem.weights[:, np.newaxis],
    )


def _predict_by(
    problem: ClosedLoopProblem | DriveSideProblem,
    free: ClosedLoopProblem | DriveSideProblem,
    x: FloatArray,
    predicted: FloatArray,
    motion: Sequence[FloatArray],
) -> Predicted:
    """Return the prediction of a problem whose joint is known, beside the same problem with a `free` one."""
    measured = problem.measured
    error, whole = problem.filter(np.column_stack([measured - predicted, measured])).T

    def fit_anew() -> FloatArray | None:
        found = _search(free, free.vector(problem.values(x)))
        return None if found is None else found.residual[np.newaxis]

    return Predicted(
        problem.sample_time, problem.filtering.borders, measured[:, np.newaxis], predicted[:, np.newaxis],
        error[np.newaxis], whole[np.newaxis], [one[:, np.newaxis] for one in motion], fit_anew,
    )  # fmt: skip


def _search(problem: Any, start: FloatArray) -> Solution | None:
    """Return the solution of a search; None if it fails."""
    try:
        with np.errstate(all="ignore"):  # a loop that runs away
            return solve(problem, _SEARCH, start)
    except (JointidError, np.linalg.LinAlgError):
        return None


def predict_robot(estimate: Estimate, records: Sequence[Record]) -> Predicted:
    """Predict the records of a robot's joints.

    Raises:
        MethodError: the robot cannot be simulated along these records.
    """
    from jointid.estimation.robots.numbers import robot_parameters
    from jointid.estimation.robots.regression import inverse_of_robot
    from jointid.estimation.robots.simulated import errors_of, nominal_numbers, problem_of
    from jointid.simulation.robots import motion_at

    part, filtering = estimate.require_robot(), estimate.settings.filtering
    robot, coupling = part.model, part.model.coupling.T
    if estimate.settings.method == "idim":
        inverse = inverse_of_robot(robot, part.parameters)
        motion = inverse.measure(records, filtering)
        columns = inverse.columns_along(motion)
        rows = inverse.rows([motion], [columns])
        return Predicted(
            motion.sample_time, motion.filtering.borders, motion.torque,
            columns @ part.values, rows.by_equation(rows.Y - rows.W @ part.values), rows.by_equation(rows.Y),
            [one @ coupling for one in (motion.q, motion.v, motion.a)],
            lambda: _fit_columns(rows.W, rows.by_equation(rows.Y)), motion.moving,
            nominal_errors=lambda: rows.relative_errors(part.nominal),
        )  # fmt: skip
    numbers = part.numbers()
    problem: Any = problem_of(part.setup, records, robot_parameters(robot), filtering)
    run = problem.run_of(numbers)
    if run is None:
        what = "references" if part.has_controllers else "motor positions"
        raise MethodError(f"The robot that was identified cannot be simulated along this record; check its {what}.")
    if part.has_controllers:
        moved = motion_at(run, problem.experiment.clock.log_index)
        path = [one[:, numbers.rotors] for one in (moved.position, moved.velocity, moved.acceleration)]
    else:
        path = [one @ coupling for one in (problem.motion.q, problem.motion.v, problem.motion.a)]
    error = problem.error(run)

    def fit_anew() -> FloatArray | None:
        parameters = problem.parameters
        base = replace(parameters.base, log=numbers.log)
        free, left = replace(problem, parameters=replace(parameters, base=base)), error
        x = parameters.to_search_variables(parameters.group(run.numbers))
        for _ in range(2):  # each axis weighted by its error: of the estimate, then of a first search
            free = free.reweight(left, 0)
            found = _search(free, x)
            if found is None:
                return None
            x, left = found.x, found.residual / free.weights(error.size)
        return np.asarray(problem.by_joint(left))

    return Predicted(
        problem.sample_time, problem.filtering.borders, problem.measured, problem.predict(run),
        problem.by_joint(error), problem.by_joint(problem.filtered_torque), path, fit_anew,
        None if part.has_controllers else problem.motion.moving,
        nominal_errors=lambda: errors_of(problem, nominal_numbers(robot, numbers)),
    )  # fmt: skip
