"""Direct and cross test of the paper: the same or another record.

The torque of each axis is compared with the measured one, ``||Y - Ys|| / ||Y||``. Only what belongs to the record is
estimated anew: the state at its first sample, and the zero of a load encoder. An estimate predicts the record if it
adds less than the attainable error to that of each axis, as the root of a difference of squares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
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
from jointid.estimation.methods import method_of
from jointid.estimation.methods.drive_side import motion_problem
from jointid.estimation.parameters import LOG_DELAY, robot_parameters
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    inverse_of_joint,
    inverse_of_robot,
    require_one_log,
    through_window,
)
from jointid.estimation.problems.simulated import outcome_of, pose_robot, torque_problem
from jointid.estimation.result.estimate import Estimate, fingerprint, law_fingerprint, relative_error
from jointid.estimation.result.verdict import POOR_FIT, scale_check
from jointid.estimation.rigid_starts import fit_initial_state
from jointid.estimation.robots.simulated import nominal_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled, takes_record
from jointid.simulation.controller_torque import compute_controller_torque
from jointid.simulation.simulate import Outcome, motion_at
from jointid.solvers.solve import LevenbergMarquardt, solve

_NEGLIGIBLE = 0.01  # of the torque: a joint that adds less to the error predicts a record that has no noise
_OTHER_LAW = "the controller is not that of the identification, which is right only if its gains were changed"
_SEARCH = LevenbergMarquardt(1e-5, 40)  # of the attainable error: far below its reported digits


class Prediction(StrEnum):
    """Answers to whether an estimate predicts a record, as codes."""

    NOT_PREDICTED = "not_predicted"
    OWN_RECORD = "own_record"
    PREDICTED = "predicted"


_SAID = {
    Prediction.NOT_PREDICTED: (
        "does not predict",
        "; load, friction, channels or the controller differ there: identify it from this record, too, and compare "
        "both estimates",
    ),
    Prediction.OWN_RECORD: ("was identified from", "; validate it on another record"),
    Prediction.PREDICTED: ("predicts", ""),
}
"""What a joint does with the record, and why or what next."""


@dataclass(frozen=True, slots=True, eq=False)
class ValidatedAxis:
    """Agreement of one axis's predicted signal with a record.

    Attributes:
        name: of the joint in its robot; empty for a joint alone.
        unit: of the signal: N, N m, A or V; position_unit: of the motion, m or rad.
        measured, predicted: (samples,) raw signal.
        compared: (samples,) 0 at the borders, and where a method leaves out a motor that rests or reverses; else 1.
        position, velocity: (samples,) of the motor: simulated under a controller, measured for the other methods.
        relative_error: of the raw signal; a ratio.
        filtered_error: of the filtered and decimated signal, with the estimate's own filtering; a ratio.
        attainable_error: `filtered_error` of the same model fitted to this record; None in a direct test, and infinite
            where that fails.
        nominal_error: that of the nominal robot; infinite if it cannot be simulated, None without nominal masses.
    """

    in_json = "prediction -position -velocity"
    name: str
    unit: str
    position_unit: str
    measured: FloatArray
    predicted: FloatArray
    compared: FloatArray
    position: FloatArray
    velocity: FloatArray
    relative_error: float
    filtered_error: float
    attainable_error: float | None = None
    nominal_error: float | None = None

    @property
    def prediction(self) -> Prediction:
        """Whether the estimate predicts this axis of another record within its noise."""
        left, least = self.filtered_error, self.attainable_error
        if least is None:
            return Prediction.OWN_RECORD
        within = math.sqrt(max(left**2 - least**2, 0.0)) <= max(least, _NEGLIGIBLE)
        return Prediction.PREDICTED if within and least <= POOR_FIT else Prediction.NOT_PREDICTED


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Documented):
    """Agreement of an estimate's prediction with a record, axis by axis.

    Errors of the whole are the root mean square of those of the axes; None if one is missing.

    Attributes:
        test: "direct" on the record it was identified from, "cross" on another.
        method: of the estimate; one without a simulation evaluates the inverse model at the measured position.
        record, identified_from: names of the records.
        sample_time: of the signals, seconds.
        borders: samples left out at each end of the relative error.
        axes: (n,) of each joint of a robot in order, or of the one joint.
        warnings: limits of the result, one sentence each.
        resampled: resampling of the record to a uniform clock; None if it was logged so.
        transmission: of a joint, on whose `side` signal and motion are.
    """

    in_json = "answer sentence relative_error filtered_error attainable_error nominal_error"
    test: Literal["direct", "cross"]
    method: str
    record: str
    identified_from: str
    sample_time: float
    borders: tuple[int, int]
    axes: tuple[ValidatedAxis, ...]
    warnings: tuple[str, ...] = ()
    resampled: Resampled | None = None
    transmission: Transmission | None = None

    @property
    def relative_error(self) -> float:
        """Error of the raw signals."""
        return _rms([axis.relative_error for axis in self.axes]) or 0.0

    @property
    def filtered_error(self) -> float:
        """Error of the filtered signals."""
        return _rms([axis.filtered_error for axis in self.axes]) or 0.0

    @property
    def attainable_error(self) -> float | None:
        """Error of the same model fitted to this record."""
        return _rms([axis.attainable_error for axis in self.axes])

    @property
    def nominal_error(self) -> float | None:
        """Error of the nominal robot."""
        return _rms([axis.nominal_error for axis in self.axes])

    @property
    def answer(self) -> Message:
        """Whether the estimate predicts every axis within its noise; else a remedy."""
        bad = [axis for axis in self.axes if axis.prediction is Prediction.NOT_PREDICTED]
        code, there = bad[0].prediction if bad else self.axes[0].prediction, bad or self.axes
        left, least = _rms([a.filtered_error for a in there]), _rms([a.attainable_error for a in there])
        of = f" of {join([axis.name for axis in there])}" if len(there) < len(self.axes) else ""
        how, then = _SAID[code]
        words = f"The {'robot' if self.axes[0].name else 'joint'} {how} {self.record}: it leaves {_share(left)} of the "
        words += f"filtered torque{of}" + ("" if least is None else f", and one fitted to it {_share(least)}")
        return Message(code, words + then, {"filtered_error": left, "attainable_error": least})

    def to_document(self, *, details: bool = False) -> Document:
        """Answer and errors as a document; there are no further details."""
        del details
        ways = {"loop": "simulated from the reference", "motion": "simulated along the motor position"}
        how = ways.get(method_of(self.method).simulates, "computed from the measured position")
        test = f"{self.test} test on {self.record}, of what was identified from {self.identified_from}; torque {how}"
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        error = f"{100 * self.relative_error:.4f} % raw ({left_out}), {100 * self.filtered_error:.4f} % filtered"
        facts = [("test", test), *common_facts(self.resampled, self.transmission), ("torque error", error)]
        facts += [("nominal model", f"{_share(self.nominal_error)} filtered")] * (self.nominal_error is not None)
        facts += [("warning", warning) for warning in self.warnings]
        header, rows = ("joint", "raw, %", "filtered, %", "attainable, %", "nominal, %"), list[tuple[str, ...]]()
        for one in self.axes:
            shares = one.relative_error, one.filtered_error, one.attainable_error, one.nominal_error
            rows.append((one.name, *(_share(share).removesuffix(" %") for share in shares)))
        table = Table(header, tuple(rows), "Error of the prediction, as a share of the measured signal")
        return Document(f"{self.answer}.", (Facts(tuple(facts)), *([table] if self.axes[0].name else [])))


def _share(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{number(100 * share, 3)} %" if math.isfinite(share) else "runs away"


def _rms(shares: Sequence[float | None]) -> float | None:
    known = [share for share in shares if share is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) == len(shares) else None


@one_thread
@takes_record
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
    records, settings = _take_records(estimate, record), estimate.settings
    robot = None if estimate.robot is None else estimate.robot.model
    by_motion = not settings.simulates and (robot is not None or settings.loop is None)
    found = (_evaluate_inverse_model if by_motion else _simulate)(estimate, records)
    torques = [one.torque for one in records if one.torque is not None]
    own = fingerprint(np.concatenate([torque.values for torque in torques])) in estimate.data.fingerprints
    axes = [("", torques[0].unit, POSITION_UNIT[settings.joint.kind])] if robot is None else [
        (name, robot.torque_unit(k), robot.position_unit(k)) for k, name in enumerate(robot.names)
    ]  # fmt: skip
    size, unknown = np.linalg.norm(found.whole, axis=1), [None if own else math.inf for _ in axes]
    anew = None if own else found.fit_anew()
    attainable = unknown if anew is None else (np.linalg.norm(anew, axis=1) / size).tolist()
    nominal = [None for _ in axes] if own or found.nominal_errors is None else found.nominal_errors().tolist()
    errors = (np.linalg.norm(found.error, axis=1) / size).tolist()
    compared = np.zeros(found.measured.shape)
    compared[found.borders[0] : len(compared) - found.borders[1]] = 1.0
    compared *= found.compared
    shown, told = compared * found.measured, compared * found.predicted
    made = tuple(
        ValidatedAxis(
            *axis, found.measured[:, k], found.predicted[:, k], compared[:, k], found.position[:, k],
            found.velocity[:, k], relative_error(shown[:, k], told[:, k], found.borders), errors[k], attainable[k],
            nominal[k],
        )
        for k, axis in enumerate(axes)
    )  # fmt: skip
    warnings = [scale_check(()).words] if any(one.computed for one in records) else []
    if settings.loop is not None and estimate.controller_sha256 != law_fingerprint(settings.loop):
        warnings.append(_OTHER_LAW)
    return Validation(
        "direct" if own else "cross", settings.method, records[0].name, estimate.data.record, found.sample_time,
        found.borders, made, tuple(warnings), records[0].resampled,
        None if robot is not None else settings.joint.transmission,
    )  # fmt: skip


def _take_records(estimate: Estimate, record: Record | Sequence[Record]) -> Sequence[Record]:
    """Return a record of each axis; a torque that lacks is computed.

    Raises:
        MethodError, RecordError: there are not as many as axes, or one contradicts its description.
    """
    loops: Sequence[ClosedLoop | None] = [estimate.settings.loop]
    if estimate.robot is not None:
        loops = getattr(getattr(estimate.robot, "setup", None), "loops", [None] * len(estimate.robot.model))
    given = [*record] if isinstance(record, Sequence) else [record]
    if len(given) != len(loops):
        raise MethodError(f"Validation takes a record of each of {len(loops)} joints, in order; received {len(given)}.")
    for k, (one, loop) in enumerate(zip(given, loops, strict=True)):
        if one.torque is None and one.motor_position is not None and loop is not None:
            given[k] = compute_controller_torque(one, loop)
        if estimate.robot is None:
            given[k].require(("torque",), "Validation")
            check_record(given[k])
    return given


# The prediction


class _Predicted(NamedTuple):
    """A record and its prediction: raw, (samples, n), and filtered, (n, rows).

    The rows of a flexible joint's inverse model are those of two equations, one after the other.

    Attributes:
        error, whole: filtered, of the prediction and of the measured signal.
        fit_anew: returns the error, (n, rows), that the model with free parameters leaves; None if that fails.
        compared: (samples, n) 0 where a motor's rest or reversal is left out; 1 of a loop.
        nominal_errors: returns the errors, (n,), of the nominal robot; None without one.
    """

    sample_time: float
    borders: tuple[int, int]
    measured: FloatArray
    predicted: FloatArray
    error: FloatArray
    whole: FloatArray
    position: FloatArray
    velocity: FloatArray
    fit_anew: Callable[[], FloatArray | None]
    compared: FloatArray | float = 1.0
    nominal_errors: Callable[[], FloatArray] | None = None


def _evaluate_inverse_model(estimate: Estimate, records: Sequence[Record]) -> _Predicted:
    settings, part = estimate.settings, estimate.robot
    if part is None:
        known = estimate.require_values()
        inverse = inverse_of_joint(settings.joint, settings.delay)
        values = np.array([known.get(name, 0.0) for name in inverse.parameters.names])
    else:
        inverse, values = inverse_of_robot(part.model, part.parameters), part.values.copy()
    motion, axes = inverse.measure(records, settings.filtering).read_as(settings.timing), inverse.driven
    raw = inverse.columns(motion)
    rows = inverse.rows([motion], [raw])
    own = np.array([name == ENCODER_OFFSET.name for name in rows.names])  # counted from elsewhere in each record
    values[own] += np.linalg.lstsq(rows.W[:, own], rows.Y - rows.W @ values, rcond=None)[0]
    whole, error = (one.reshape(axes, -1) for one in (rows.Y, rows.Y - rows.W @ values))

    def fit_anew() -> FloatArray:
        left = whole
        for _ in range(min(axes, 2)):  # each axis weighted by its error: of nothing, then of a first fit
            by = np.repeat(1.0 / np.maximum(np.linalg.norm(left, axis=1), 1e-300), whole.shape[1])
            fitted = np.linalg.lstsq(rows.W * by[:, np.newaxis], rows.Y * by, rcond=None)[0]
            left = (rows.Y - rows.W @ fitted).reshape(whole.shape)
        return left

    q, v = (one[:, :1] if part is None else one @ part.model.coupling.T for one in (motion.q, motion.v))
    found = _Predicted(
        motion.sample_time, motion.filtering.borders, motion.torque[:, :axes],
        through_window(raw[:, :axes], motion.filtering) @ values, error, whole, q, v, fit_anew,
    )  # fmt: skip
    if part is None:
        return found
    given = np.array([row.nominal for row in estimate.rows], dtype=np.float64)
    nominal = partial(rows.relative_errors, given) if part.model.has_masses else None
    return found._replace(compared=motion.moving, nominal_errors=nominal)


def _simulate(estimate: Estimate, records: Sequence[Record]) -> _Predicted:
    """Predict torques under the controllers or along the motors' motion."""
    settings, part, nominal, compared = estimate.settings, estimate.robot, None, 1.0
    problem: Any
    free: Any
    if part is None:
        joint, known, (record,) = settings.joint, estimate.require_values(), records
        values = {p.name: known[p.name] for p in joint.parameters}
        if settings.loop is not None:
            free = torque_problem(record, settings.loop, settings.filtering, joint.parameters)
            problem = free.keeping(values)
            x = fit_initial_state(problem)
            free = free.keeping({"initial_velocity": problem.values(x)["initial_velocity"]})
        else:  # with the log's own delay
            delay = LOG_DELAY.fix(-settings.delay)
            free = motion_problem([record], joint, settings.filtering, joint.parameters, delay)
            problem = free.keeping(values)
            x = solve(problem, _SEARCH, problem.vector({})).x if problem.free else np.zeros(0)
        runs, start = problem.run(x), free.vector(problem.values(x))
    else:
        require_one_log(records)
        robot, numbers = part.model, part.numbers()
        problem = pose_robot(part.setup, records, robot_parameters(robot), settings.filtering)
        runs, parameters = problem.run_of(numbers), problem.parameters
        base = parameters.base.with_record(numbers, (LOG_DELAY.name,))
        free = replace(problem, parameters=replace(parameters, base=base))
        start = parameters.to_search_variables(parameters.group(runs[0].numbers if runs else numbers))
        nominal = partial(problem.left_by, nominal_numbers(robot, numbers)) if robot.has_masses else None
    if runs is None or outcome_of(runs) is not Outcome.FINISHED:
        what = "motor positions and torques" if problem.log.motion_measured else "references"
        raise MethodError(f"What was identified cannot be simulated along this record; check its {what}.")
    (run,), error, log = runs, problem.error(runs), problem.log
    if log.motion_measured:
        path, speed = (one[:: log.parts] for one in (log.prescribed.position, log.prescribed.velocity))
        compared = log.motion.moving
    else:
        moved = motion_at(run, log.experiment.clock.log_index)
        path, speed = (one[:, run.numbers.motors] for one in (moved.position, moved.velocity))
        compared = log.counts[:, np.newaxis]

    def fit_anew() -> FloatArray | None:
        weighted, x, left = free, start, error
        # Each axis is weighted by its error: of the estimate, then of a first search.
        for _ in range(min(len(records), 2)):
            weighted = weighted.reweight(left, 0)
            try:
                with np.errstate(all="ignore"):  # a loop that runs away
                    found = solve(weighted, _SEARCH, x)
            except (JointidError, np.linalg.LinAlgError):
                return None
            x, left = found.x, found.residual / weighted.weigh(np.ones(error.size))
        return np.asarray(problem.by_joint(left))

    return _Predicted(
        problem.sample_time, problem.filtering.borders, log.measured, problem.predict(runs), problem.by_joint(error),
        problem.by_joint(problem.filtered_torque), path, speed, fit_anew, compared, nominal,
    )  # fmt: skip
