"""Validation as the paper does it: the direct test on the same record, the cross test on another one.

The joint or robot is simulated, or its inverse model evaluated, and the torque of each axis compared with the measured
one, ``||Y - Ys|| / ||Y||``. Only what belongs to the record is estimated anew: the state at its first sample, and the
zero of a load encoder.

What noise allows is what the same model leaves of another record when its parameters are free there. It predicts the
record where it adds less than that to the error of each axis, as the root of a difference of squares. A robot is also
compared with its nominal masses, rotors and springs, with friction fitted to the estimate's record.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Facts, Table, common_facts
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message
from jointid.common.parallel import one_thread
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.estimation.methods.drive_side import DriveSideProblem, motion_problem
from jointid.estimation.problems.base import INITIAL_STATE, LOG_DELAY
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, with_torque
from jointid.estimation.problems.inverse_model import ENCODER_OFFSET, inverse_of_joint, read_as, through_window
from jointid.estimation.result.estimate import Estimate, fingerprint, law_fingerprint, relative_error
from jointid.estimation.result.verdict import POOR_FIT, scale_verdict
from jointid.estimation.starts.rigid_joint import fit_initial_state
from jointid.models.joints import ClosedLoop
from jointid.models.position_forces import Motion
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled
from jointid.simulation.controller_torque import compute_controller_torque
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome, require_success
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve

_LAGS = 40  # of the residual's autocorrelation
_NEGLIGIBLE = 0.01  # of the torque: a joint that adds less to the error predicts a record that has no noise
_ALIKE = 0.02  # of an error: two models whose errors differ by less are as good as each other
_SEARCH = LevenbergMarquardt(1e-5, 40)  # of the attainable error: far below its reported digits
_OTHER_LAW = "the controller is not that of the identification, which is right only if its gains were changed"


class Prediction(StrEnum):
    """Answers to whether an estimate predicts a record, as codes, the worst first."""

    NOT_AS_DECLARED = "not_as_declared"
    ANOTHER_JOINT = "another_joint"
    NOT_COMPARED = "not_compared"
    OWN_RECORD = "own_record"
    PREDICTED = "predicted"


@dataclass(frozen=True, slots=True, eq=False)
class ValidatedAxis:
    """Agreement of the signal that is predicted of one axis with a record.

    Attributes:
        name: of the joint in its robot; empty for a joint alone.
        unit: of the signal: N, N m, A or V; position_unit: of the motion, m or rad.
        measured, predicted: (samples,) raw signal.
        compared: (samples,) 0 at the borders, and where a method leaves out a motor that rests or turns round; else 1.
        relative_error: of the raw signal; a ratio.
        filtered_error: of the filtered and decimated signal, with the estimate's own filtering; a ratio.
        autocorrelation: (lags + 1,) of the filtered error, 1 at lag 0; a white one stays within `white_band`.
        rows: of the filtered error.
        motor: motion the error is plotted against: simulated under a controller, measured for the other methods.
        transmission: on whose `side` signal and motion are.
        attainable_error: `filtered_error` of the same model identified from this record; None in a direct test, and
            where none could be found.
        nominal_error: that of the nominal robot; infinite where it cannot be simulated, None where it says no masses.
    """

    in_json = "prediction autocorrelation white_band -motor"
    name: str
    unit: str
    position_unit: str
    measured: FloatArray
    predicted: FloatArray
    compared: FloatArray
    relative_error: float
    filtered_error: float
    autocorrelation: FloatArray
    rows: int
    motor: Motion
    transmission: Transmission | None = None
    attainable_error: float | None = None
    nominal_error: float | None = None

    @property
    def white_band(self) -> float:
        """Twice the standard deviation of an autocorrelation of white noise, ``2 / sqrt(rows)``."""
        return float(2 / np.sqrt(self.rows))

    @property
    def prediction(self) -> Prediction:
        """Whether the estimate predicts this axis of another record within its noise."""
        left, least = self.filtered_error, self.attainable_error
        if left > POOR_FIT and (least is None or least > POOR_FIT):
            return Prediction.NOT_AS_DECLARED
        if least is None:
            return Prediction.NOT_COMPARED
        within = math.sqrt(max(left**2 - least**2, 0.0)) <= max(least, _NEGLIGIBLE)
        return Prediction.PREDICTED if within else Prediction.ANOTHER_JOINT


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Documented):
    """Agreement of an estimate's prediction with a record, axis by axis.

    Errors without an axis are the root mean square of those of the axes; None where one has none.

    Attributes:
        test: "direct" on the record it was identified from, "cross" on another.
        method: name of the estimate's; "idim" evaluates the inverse model on the measured position, others simulate.
        record, identified_from: names of the records.
        sample_time: of the signals, seconds.
        borders: samples left out at each end of the relative error.
        axes: (n,) of each joint of a robot in order, or of the one joint.
        warnings: limits of the result, one sentence each.
        resampled: resampling of the record to a uniform clock; None where it was logged so.
    """

    in_json = "answer sentence relative_error filtered_error attainable_error nominal_error better"
    test: Literal["direct", "cross"]
    method: str
    record: str
    identified_from: str
    sample_time: float
    borders: tuple[int, int]
    axes: tuple[ValidatedAxis, ...]
    warnings: tuple[str, ...] = ()
    resampled: Resampled | None = None

    @property
    def relative_error(self) -> float:
        """Error of the raw signals."""
        return _rms([axis.relative_error for axis in self.axes])

    @property
    def filtered_error(self) -> float:
        """Error of the filtered signals."""
        return _rms([axis.filtered_error for axis in self.axes])

    @property
    def attainable_error(self) -> float | None:
        """Error of the same model identified from this record."""
        return _rms_of_all([axis.attainable_error for axis in self.axes])

    @property
    def nominal_error(self) -> float | None:
        """Error of the nominal robot."""
        return _rms_of_all([axis.nominal_error for axis in self.axes])

    @property
    def better(self) -> bool | None:
        """Whether the estimate predicts better than the nominal robot; None without one."""
        return None if self.nominal_error is None else self.filtered_error < self.nominal_error

    @property
    def answer(self) -> Message:
        """Whether the estimate predicts every axis of the record within its noise, and the remedy if not."""
        own, worst = self.test == "direct", min(self.axes, key=lambda axis: list(Prediction).index(axis.prediction))
        code = Prediction.OWN_RECORD if own else worst.prediction
        there = [a for a in self.axes if own or a.prediction is code]
        left, least = _rms([a.filtered_error for a in there]), _rms_of_all([a.attainable_error for a in there])
        of = f" of {join([axis.name for axis in there])}" if len(there) < len(self.axes) else ""
        share = f"it leaves {_format_share(left)} of the filtered torque{of}"
        share += "" if least is None else f", and one identified from it {_format_share(least)}"
        part = "controller, " * (self.method == "didim")
        anew = "there: identify it from this record, too, and compare both estimates"
        how, then = {
            Prediction.OWN_RECORD: ("was identified from", "validate it on another record"),
            Prediction.PREDICTED: ("predicts", ""),
            Prediction.NOT_COMPARED: ("predicts", "how little may be left there could not be found"),
            Prediction.NOT_AS_DECLARED: ("does not predict", f"{part}channels or scales are not as declared {anew}"),
            Prediction.ANOTHER_JOINT: ("does not predict", f"its {part}load or friction differs {anew}"),
        }[code]
        words = f"The {'robot' if worst.name else 'joint'} {how} {self.record}: {share}"
        values = {"filtered_error": left, "attainable_error": least}
        return Message(code, "; ".join(filter(None, (words, then))), values)

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer and the errors as a document; there are no further details."""
        del details
        first, nominal = self.axes[0], self.nominal_error
        how = {"didim": "simulated from the reference", "drive_side": "simulated along the motor position"}.get(
            self.method, "computed from the measured position"
        )
        test = f"{self.test} test on {self.record}, of what was identified from {self.identified_from}; torque {how}"
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        error = f"{100 * self.relative_error:.4f} % raw ({left_out}), {100 * self.filtered_error:.4f} % filtered"
        facts = [("test", test), *common_facts(self.resampled, first.transmission), ("torque error", error)]
        if nominal is not None:
            useful = "" if self.filtered_error < (1.0 + _ALIKE) * nominal else ": keep it in the place of the estimate"
            facts.append(("nominal model", f"{_format_share(nominal)} filtered{useful}"))
        facts += (("warning", warning) for warning in self.warnings)
        header, rows = ("joint", "raw, %", "filtered, %", "attainable, %", "nominal, %"), list[tuple[str, ...]]()
        for one in self.axes:
            shares = one.relative_error, one.filtered_error, one.attainable_error, one.nominal_error
            rows.append((one.name, *map(_format_cell, shares)))
        table = Table(header, tuple(rows), "Error of the prediction, as a share of the measured signal")
        return Document(self.sentence, (Facts(tuple(facts)), *([table] if first.name else [])))


def _format_cell(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{100 * share:.3g}" if math.isfinite(share) else "runs away"


def _format_share(share: float) -> str:
    return f"{number(100 * share, 3)} %" if math.isfinite(share) else "runs away,"


def _rms(shares: Sequence[float] | FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(shares))))


def _rms_of_all(shares: Sequence[float | None]) -> float | None:
    known = [share for share in shares if share is not None]
    return _rms(known) if len(known) == len(shares) else None


@one_thread()
def validate(estimate: Estimate, record: Record | Sequence[Record]) -> Validation:
    """Compare an identified joint or robot with a record.

    Args:
        estimate: by any method; of a joint also one that was read back from a file.
        record: of a robot one of each joint, with the channels its method uses: that of the estimate for a direct
            test, or another for a cross test.

    Raises:
        RecordError: a channel is missing, or the record contradicts its description.
        MethodError: the joint or robot cannot be simulated on this record.
    """
    records = _take_records(estimate, record)
    found, joints = predict_records(estimate, records), len(records)
    if estimate.robot is None:
        joint = estimate.settings.joint
        axes = [("", "" if records[0].torque is None else records[0].torque.unit, POSITION_UNIT[joint.kind])]
        gear: Transmission | None = joint.transmission
    else:
        robot, gear = estimate.robot.model, None
        axes = [(robot.names[k], robot.torque_unit(k), robot.position_unit(k)) for k in range(joints)]
    torques = [one.torque.values for one in records if one.torque is not None]
    own = fingerprint(np.concatenate(torques)) in estimate.data.fingerprints
    size = np.linalg.norm(found.whole, axis=1)
    anew = None if own else found.with_free()
    attainable = [None] * joints if anew is None else (np.linalg.norm(anew, axis=1) / size).tolist()
    nominal = [None] * joints
    if not own and found.nominal_errors is not None and estimate.require_robot().model.has_masses:
        nominal = found.nominal_errors().tolist()
    compared = np.zeros(found.measured.shape)
    compared[found.borders[0] : len(compared) - found.borders[1]] = 1.0
    compared *= 1.0 if found.compared is None else found.compared
    shown, told = compared * found.measured, compared * found.predicted
    made = tuple(
        ValidatedAxis(
            *axis, found.measured[:, k], found.predicted[:, k], compared[:, k],
            relative_error(shown[:, k], told[:, k], found.borders),
            float(np.linalg.norm(found.error[k]) / size[k]), _autocorrelate(found.error[k]), found.error.shape[1],
            Motion(*(one[:, k] for one in found.motion)), gear, attainable[k], nominal[k],
        )
        for k, axis in enumerate(axes)
    )  # fmt: skip
    unsettled = "the search for the estimate did not settle: do not rely on it"
    warnings = (*found.warnings, *([] if estimate.fit.converged else [unsettled]))
    warnings += (scale_verdict(()).said,) if any(one.computed for one in records) else ()
    return Validation(
        "direct" if own else "cross", estimate.settings.method, records[0].name, estimate.data.record,
        found.sample_time, found.borders, made, warnings, records[0].resampled,
    )  # fmt: skip


def _take_records(estimate: Estimate, record: Record | Sequence[Record]) -> Sequence[Record]:
    """Return a record of each axis with the timing of the identification; a torque that lacks is computed.

    Raises:
        MethodError: there are not as many as axes.
        RecordError: a record contradicts its description.
    """
    loops: Sequence[ClosedLoop | None] = [estimate.settings.loop]
    if estimate.robot is not None:
        loops = getattr(getattr(estimate.robot, "setup", None), "loops", [None] * len(estimate.robot.model))
    given = [*record] if isinstance(record, Sequence) else [record]
    if len(given) != len(loops) or not all(isinstance(one, Record) for one in given):
        raise MethodError(f"Validation takes a record of each of {len(loops)} joints, in order; received {len(given)}.")
    for k, (one, loop) in enumerate(zip(given, loops, strict=True)):
        if one.torque is None and one.motor_position is not None and loop is not None:
            given[k] = compute_controller_torque(one, loop)
        if estimate.robot is None:
            given[k].require(("torque",), "Validation")
            check_record(given[k])
    return read_as(given, estimate.settings.timing)


def _autocorrelate(error: FloatArray) -> FloatArray:
    centred = error - error.mean()
    power = float(centred @ centred) or 1.0
    lags = range(min(_LAGS, centred.size - 1) + 1)
    return np.array([float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in lags])


# The prediction


class Predicted(NamedTuple):
    """A record beside its prediction: raw signals (samples, n), filtered ones (n, rows).

    The rows of a flexible joint's inverse model are those of two equations, one after the other.

    Attributes:
        motion: positions, velocities and accelerations of the motors, (samples, n).
        with_free: returns the error, (n, rows), that the model with free parameters leaves; None if that fails.
        compared: (samples, n) 0 where a motor's rest or reversal is left out; all ones when None.
        nominal_errors: returns the errors, (n,), of the nominal robot; None of a joint.
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
    nominal_errors: Callable[[], FloatArray] | None = None
    warnings: tuple[str, ...] = ()


def predict_records(estimate: Estimate, records: Sequence[Record]) -> Predicted:
    """Predict the record of a joint, or those of a robot's joints.

    Raises:
        RecordError: a channel is missing.
        MethodError: a value is refused, or the joint or robot cannot be simulated along these records.
    """
    if estimate.robot is not None and estimate.settings.method != "idim":
        return _simulate_robot(estimate, records)
    if estimate.settings.loop is not None:
        return _simulate_loop(estimate, estimate.settings.loop, records[0])
    if estimate.settings.method == "drive_side":
        return _simulate_along_motion(estimate, records[0])
    return _evaluate_inverse_model(estimate, records)


def _evaluate_inverse_model(estimate: Estimate, records: Sequence[Record]) -> Predicted:
    settings, part = estimate.settings, estimate.robot
    if part is None:
        known = estimate.require_values()
        inverse = inverse_of_joint(settings.joint, settings.delay, zeros=settings.joint.model == "flexible")
        values = np.array([known.get(name, 0.0) for name in inverse.names])
    else:
        from jointid.estimation.robots.regression import inverse_of_robot

        inverse, values = inverse_of_robot(part.model, part.parameters), part.values.copy()
    motion, axes = inverse.measure(records, settings.filtering), inverse.driven
    raw = inverse.columns_along(motion)
    rows = inverse.rows([motion], [raw])
    own = np.array([name == ENCODER_OFFSET.name for name in inverse.names])  # counted from elsewhere in each record
    values[own] += np.linalg.lstsq(rows.W[:, own], rows.Y - rows.W @ values, rcond=None)[0]
    whole, error = (one.reshape(axes, -1) for one in (rows.Y, rows.Y - rows.W @ values))
    moved = motion.q, motion.v, motion.a
    return Predicted(
        motion.sample_time, motion.filtering.borders, motion.torque[:, :axes],
        through_window(raw[:, :axes], motion.filtering) @ values, error, whole,
        [one[:, :1] if part is None else one @ part.model.coupling.T for one in moved],
        lambda: _fit_columns(rows.W, whole), None if part is None else motion.moving,
        None if part is None else lambda: rows.relative_errors(part.nominal),
    )  # fmt: skip


def _fit_columns(columns: FloatArray, whole: FloatArray) -> FloatArray:
    """Return the residual of a weighted fit of columns to (n, rows); weights come from a first fit."""
    left = whole
    for _ in range(min(len(whole), 2)):
        weights = np.repeat(1.0 / np.maximum(np.linalg.norm(left, axis=1), 1e-300), whole.shape[1])
        fitted = np.linalg.lstsq(columns * weights[:, np.newaxis], whole.ravel() * weights, rcond=None)[0]
        left = whole - (columns @ fitted).reshape(whole.shape)
    return left


def _simulate_loop(estimate: Estimate, loop: ClosedLoop, record: Record) -> Predicted:
    assert record.torque is not None
    record.require(loop.channels, "Validation")
    known, experiment = estimate.require_values(), prepare(loop, record)
    measured = record.torque.values[: experiment.clock.samples]
    around = with_torque(INITIAL_STATE, experiment.axis, measured)
    free = ClosedLoopProblem((*loop.joint.parameters, *around), measured, estimate.settings.filtering, loop, experiment)
    problem = free.keeping({p.name: known[p.name] for p in loop.joint.parameters})
    x, _ = fit_initial_state(problem)
    run, motor = require_success(problem.simulate(x)), {"initial_velocity": problem.values(x)["initial_velocity"]}
    motion = [run.motor_position, run.motor_velocity, run.motor.acceleration]
    same = estimate.controller_sha256 in ("", law_fingerprint(loop))
    found = _predict_by(problem, free.keeping(motor), x, run.torque, motion)
    return found._replace(warnings=() if same else (_OTHER_LAW,))


def _simulate_along_motion(estimate: Estimate, record: Record) -> Predicted:
    """Predict the torque along the motor's motion, with the log's own delay."""
    joint, filtering, values = estimate.settings.joint, estimate.settings.filtering, estimate.require_values()
    delay = LOG_DELAY.fix(-estimate.settings.delay)
    free = motion_problem(record, DriveSide(joint), filtering, joint.parameters, delay)
    problem = free.keeping({p.name: values[p.name] for p in joint.parameters})
    x = solve(problem, _SEARCH, problem.vector({})).x if problem.free else np.zeros(0)
    run, moved = problem.run(x), problem.log.motion
    if run.outcome is not Outcome.FINISHED:
        raise MethodError("The joint cannot be simulated along this record; check its motor position and torque.")
    motion = [one[:, 0] for one in (moved.q, moved.v, moved.a)]
    return _predict_by(problem, free, x, problem.predict(x), motion)._replace(compared=moved.moving)


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


def _simulate_robot(estimate: Estimate, records: Sequence[Record]) -> Predicted:
    from jointid.estimation.problems.simulated import pose_robot
    from jointid.estimation.robots.numbers import robot_parameters
    from jointid.estimation.robots.regression import require_one_log
    from jointid.estimation.robots.simulated import errors_of, nominal_numbers
    from jointid.simulation.simulate import motion_at

    require_one_log(records)
    part = estimate.require_robot()
    robot, numbers = part.model, part.numbers()
    problem: Any = pose_robot(part.setup, records, robot_parameters(robot), estimate.settings.filtering)
    runs = problem.run_of(numbers)
    if runs is None:
        what = "references" if part.has_controllers else "motor positions"
        raise MethodError(f"The robot that was identified cannot be simulated along this record; check its {what}.")
    (run,) = runs
    if part.has_controllers:
        moved = motion_at(run, problem.log.experiment.clock.log_index)
        path = [one[:, numbers.rotors] for one in (moved.position, moved.velocity, moved.acceleration)]
    else:
        path = [one @ robot.coupling.T for one in (problem.log.motion.q, problem.log.motion.v, problem.log.motion.a)]
    error = problem.error(runs)

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
        problem.sample_time, problem.filtering.borders, problem.measured, problem.predict(runs),
        problem.by_joint(error), problem.by_joint(problem.filtered_torque), path, fit_anew,
        None if part.has_controllers else problem.log.motion.moving,
        nominal_errors=lambda: errors_of(problem, nominal_numbers(robot, numbers)),
    )  # fmt: skip
