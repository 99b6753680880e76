"""Validation as the paper does it: the direct test on the same record, the cross test on another one.

The identified joint or robot is simulated, or its inverse model evaluated, and the torque of each axis compared with
the measured one, ``||Y - Ys|| / ||Y||``; in open loop the motor position. Only what belongs to the record is estimated
anew: the state at its first sample, and a load encoder's zero.

What noise allows is what the same model leaves of another record when its parameters are free there. It predicts the
record where it adds less than that to the error of each axis, as the root of a difference of squares. A robot is also
compared with its nominal masses, rotors and springs, with friction fitted to the estimate's record, and with bodies
near these that fit the estimate (`consistent`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Paragraph, Table, common_facts
from jointid.common.errors import JointidError, MethodError, extra
from jointid.common.messages import Message
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.estimation.problems.base import INITIAL_STATE, LOG_DELAY
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of, with_torque
from jointid.estimation.problems.inverse_model import idim_channels, motion_of
from jointid.estimation.problems.prescribed import (
    CURRENT_LAG,
    DriveSideProblem,
    OpenLoopProblem,
    motion_problem,
    position_problem,
)
from jointid.estimation.result.estimate import (
    Estimate,
    IdentifiedJoint,
    fingerprint,
    law_fingerprint,
    relative_error,
)
from jointid.estimation.starts.rigid_joint import fit_initial_state
from jointid.estimation.unknown_timing import read_as
from jointid.models.disturbances import EncoderOffset, effect_parameters
from jointid.models.joints import ClosedLoop
from jointid.models.position_forces import Motion
from jointid.models.robots.robot import Robot
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled
from jointid.records.signals.filtering import differentiate, lowpass
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import prepare
from jointid.simulation.prescribed import PARTS, DriveSide, OpenLoop
from jointid.simulation.simulated import require_success
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve
from jointid.uncertainty.verdict import POOR_FIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

_LAGS = 40  # of the residual's autocorrelation
_NEGLIGIBLE = 0.01  # of the torque: a joint that adds less to the error predicts a record that has no noise
_SEARCH = LevenbergMarquardt(1e-5, 40)  # of the attainable error: far below its reported digits
_ALIKE = 0.02  # of an error: two models whose errors differ by less are as good as each other


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
        unit: of the signal: N, N m, A or V, in open loop m or rad; position_unit: of the motion, m or rad.
        measured, predicted: (samples,) raw signal; in open loop the motor position without its drift.
        compared: (samples,) 0 at the borders, and where a method leaves out a motor that rests or turns round; else 1.
        relative_error: of the raw signal; a ratio.
        filtered_error: of the filtered and decimated signal, with the estimate's own filtering; a ratio.
        autocorrelation: (lags + 1,) of the filtered error, 1 at lag 0; a white one stays within `white_band`.
        rows: of the filtered error.
        motor: motion the error is plotted against: simulated under a controller, measured for the other methods.
        transmission: on whose `side` signal and motion are.
        tracking_error: ``||e - es|| / ||e||`` of the tracking error reference - position, where a controller was
            simulated and the record has a motor position to compare with; a ratio.
        tracking_rms: root mean square of ``e - es``, m or rad; None where `tracking_error` is.
        attainable_error: `filtered_error` of the same model identified from this record; None in a direct test, and
            where none could be found.
        nominal_error: that of the nominal robot; infinite where it cannot be simulated, None where it says no masses.
        body_error: that of bodies near the nominal ones; None without these, or if the record shows no spring.
    """

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
    tracking_error: float | None = None
    tracking_rms: float | None = None
    attainable_error: float | None = None
    nominal_error: float | None = None
    body_error: float | None = None

    @property
    def white_band(self) -> float:
        """Twice the standard deviation of an autocorrelation of white noise, ``2 / sqrt(rows)``."""
        return float(2 / np.sqrt(self.rows))

    @property
    def outside_band(self) -> float:
        """Share of the lags above 0 whose autocorrelation is outside the band; about 0.05 for a white residual."""
        return float(np.mean(np.abs(self.autocorrelation[1:]) > self.white_band))

    @property
    def prediction(self) -> Prediction:
        """Whether the estimate predicts this axis of another record within its noise."""
        left, least = self.filtered_error, self.attainable_error
        if left > POOR_FIT and (least is None or least > POOR_FIT):
            return Prediction.NOT_AS_DECLARED
        if least is None:
            return Prediction.NOT_COMPARED
        if math.sqrt(max(left**2 - least**2, 0.0)) <= max(least, _NEGLIGIBLE):
            return Prediction.PREDICTED
        return Prediction.ANOTHER_JOINT


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Documented):
    """Agreement of an estimate's prediction with a record, axis by axis.

    Errors without an axis are the root mean square of those of the axes; None where one has none.

    Attributes:
        test: "direct" on the record it was identified from, "cross" on another.
        method: name of the estimate's; "idim" evaluates the inverse model on the measured position, others simulate.
        record, identified_from: names of the records.
        channels: of the record that were used.
        sample_time: of the signals, seconds.
        compared: "torque", or "position" for an open loop.
        borders: samples left out at each end of the relative error.
        axes: (n,) of each joint of a robot in order, or of the one joint.
        initial: estimated motor state of a joint, for a simulation.
        simulations: of a joint that were run for the prediction.
        warnings: limits of the result, one sentence each.
        resampled: resampling of the record to a uniform clock; None where it was logged so.
    """

    test: Literal["direct", "cross"]
    method: str
    record: str
    identified_from: str
    channels: tuple[str, ...]
    sample_time: float
    compared: Literal["torque", "position"]
    borders: tuple[int, int]
    axes: tuple[ValidatedAxis, ...]
    initial: Initial | None = None
    simulations: int = 0
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
    def body_error(self) -> float | None:
        """Error of bodies near the nominal ones that fit the estimate."""
        return _rms_of_all([axis.body_error for axis in self.axes])

    @property
    def tracking_error(self) -> float | None:
        """Relative error of the simulated tracking error."""
        return _rms_of_all([axis.tracking_error for axis in self.axes])

    @property
    def better(self) -> bool | None:
        """Whether the estimate predicts better than the nominal robot; None without one."""
        return None if self.nominal_error is None else self.filtered_error < self.nominal_error

    @property
    def bodies_better(self) -> bool | None:
        """Whether bodies near the nominal ones predict better than these; None without them."""
        found, nominal = self.body_error, self.nominal_error
        return None if found is None or nominal is None else found < nominal

    @property
    def answer(self) -> Message:
        """Whether the estimate predicts every axis of the record within its noise, and the remedy if not."""
        code = Prediction.OWN_RECORD if self.test == "direct" else min(
            (axis.prediction for axis in self.axes), key=list(Prediction).index
        )  # fmt: skip
        bad = code not in (Prediction.OWN_RECORD, Prediction.PREDICTED)
        there = [axis for axis in self.axes if axis.prediction is code] if bad else list(self.axes)
        left, least = _rms([a.filtered_error for a in there]), _rms_of_all([a.attainable_error for a in there])
        who, signal = "robot" if self.axes[0].name else "joint", self.compared
        of = f"its filtered {signal}"
        if bad and self.axes[0].name:
            of = f"the filtered {signal} of {join([axis.name for axis in there])}"
        share = f"leaves {_format_share(left)} of {of}"
        allowed = "" if least is None else f", and one identified from it {_format_share(least)}"
        again = "identify it from this record, too, and"
        if code is Prediction.OWN_RECORD:
            words = f"The {who} was identified from {self.record} and {share}; validate it on another record"
        elif code is Prediction.NOT_AS_DECLARED:
            wrong = "controller, channels or scales are" if self.method == "didim" else "channels or scales are"
            words = f"The {who} does not predict {self.record}: it {share}{allowed}; {wrong} not as declared there"
            words += f": {again} see what is said of the fit"
        elif code is Prediction.NOT_COMPARED:
            words = f"The {who} {share} on {self.record}; how little a {who} can leave there could not be found"
        elif code is Prediction.PREDICTED:
            words = f"The {who} predicts {self.record}: it {share}{allowed}"
        else:
            words = f"The {who} does not predict {self.record} within its noise: it {share}{allowed}; the axis or its "
            words += f"controller is another one there: {again} compare both estimates"
        return Message(code, words, {"filtered_error": left, "attainable_error": least})

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    @property
    def comparison(self) -> Paragraph | None:
        """Estimate and bodies beside the nominal robot, in words; None without one."""
        mine, nominal, bodies = self.filtered_error, self.nominal_error, self.body_error
        if nominal is None:
            return None
        left, other = _format_share(mine), _format_share(nominal)
        if not math.isfinite(nominal):
            said = (
                f"The estimate leaves {left} of this record; the nominal model cannot be compared, since it is "
                "unstable under these controllers: give each joint's rotor_inertia, behind its gear."
            )
        elif abs(mine - nominal) < _ALIKE * nominal:
            said = f"The estimate predicts this record as well as the nominal model: {left} and {other}."
        elif mine < nominal:
            said = f"The estimate predicts this record better than the nominal model: {left} against {other}."
        else:
            said = f"The estimate predicts this record worse than the nominal model, {left} against {other}"
            said += ": do not use it in its place."
        if bodies is not None:
            how = "better" if self.bodies_better else "worse"
            said += f" Bodies near the nominal ones that fit the estimate predict {how} than these: "
            said += f"{_format_share(bodies)}."
        useful = min(mine, mine if bodies is None else bodies) < (1.0 + _ALIKE) * nominal
        return Paragraph(said, lead=True, tone="good" if useful else "bad")

    def plot(self) -> Figure:
        """Return measured and predicted signal and their error over time; see `jointid.figures.torque`."""
        import jointid

        return jointid.figures.torque(self)

    def to_dataframe(self) -> DataFrame:
        """Return measured and predicted signal of each axis and their difference over time as a pandas data frame.

        Raises:
            ExtraError: pandas is not installed.
        """
        pandas = extra("pandas", "dataframe", "A data frame")
        columns = dict[str, FloatArray]()
        for axis in self.axes:
            of = f"{axis.name}." if axis.name else ""
            columns |= {f"{of}measured": axis.measured, f"{of}predicted": axis.predicted}
            columns[f"{of}error"] = axis.measured - axis.predicted
        time = pandas.Index(self.sample_time * np.arange(self.axes[0].measured.size), name="time")
        frame: DataFrame = pandas.DataFrame(columns, index=time)
        return frame

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer, errors and whiteness as a document; there are no further details."""
        del details
        first, what = self.axes[0], "robot" if self.axes[0].name else "joint"
        how = {
            "didim": "simulated from the reference",
            "drive_side": "simulated along the motor position",
            "open_loop": "simulated under the torque",
        }.get(self.method, "computed from the measured position")
        test = f"{self.test} test on {self.record}, of the {what} identified from {self.identified_from}"
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        error = f"{100 * self.relative_error:.4f} % raw ({left_out}), {100 * self.filtered_error:.4f} % filtered"
        facts = [
            ("test", f"{test}; {self.compared} {how}"),
            *common_facts(self.resampled, first.transmission),
            (f"{self.compared} error", error),
        ]
        if self.tracking_error is not None:
            off = f"{100 * self.tracking_error:.4f} % away from the measured tracking error"
            each = (f"{number(a.tracking_rms, 3)} {a.position_unit}" for a in self.axes if a.tracking_rms is not None)
            off += f", {', '.join(each)} rms"
            facts.append(("tracking error", off))
        said = (
            f"{100 * np.mean([axis.outside_band for axis in self.axes]):.0f} % of {first.autocorrelation.size - 1} "
            f"autocorrelations of the filtered error outside +-{first.white_band:.3f} (5 % if it were white)"
        )
        facts += [("whiteness", said), *(("warning", warning) for warning in self.warnings)]
        blocks: list[Block] = [] if self.comparison is None else [self.comparison]
        return Document(self.sentence, (*blocks, Facts(tuple(facts)), *([axes_table([self])] if first.name else [])))


_COLUMNS: Mapping[str, Callable[[ValidatedAxis], float | None]] = {
    "raw, %": lambda axis: axis.relative_error,
    "filtered, %": lambda axis: axis.filtered_error,
    "attainable, %": lambda axis: axis.attainable_error,
    "nominal, %": lambda axis: axis.nominal_error,
    "bodies, %": lambda axis: axis.body_error,
    "tracking error off by, %": lambda axis: axis.tracking_error,
    "not white, % of lags": lambda axis: axis.outside_band,
}
"""The columns of a table of axes, each left out where no axis has it."""


def axes_table(checks: Sequence[Validation]) -> Table:
    """Return the errors of every axis of some validations; a column that none has is left out."""
    rows = [(check, axis) for check in checks for axis in check.axes]
    shown = {name: [get(axis) for _, axis in rows] for name, get in _COLUMNS.items()}
    shown = {name: values for name, values in shown.items() if any(value is not None for value in values)}
    named = [axis.name if len(checks) == 1 and axis.name else f"{c.test}, {c.record} {axis.name}" for c, axis in rows]
    cells = zip(*([_format_cell(value) for value in values] for values in shown.values()), strict=True)
    header = ("joint" if checks[0].axes[0].name else "test", *shown)
    title = "Error of the prediction, as a share of the measured signal"
    return Table(header, tuple((name.strip(), *row) for name, row in zip(named, cells, strict=True)), title)


def _format_cell(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{100 * share:.3g}" if math.isfinite(share) else "runs away"


def _format_share(share: float) -> str:
    return f"{number(100 * share, 3)} %"


def _rms(shares: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(shares))))


def _rms_of_all(shares: Sequence[float | None]) -> float | None:
    known = [share for share in shares if share is not None]
    return _rms(known) if len(known) == len(shares) else None


class _Predicted(NamedTuple):
    """A record beside its prediction: raw signals (samples, n), filtered ones (n, rows).

    The rows of a flexible joint's inverse model are those of two `equations`, one after the other.

    Attributes:
        motion: positions, velocities and accelerations of the motors, (samples, n).
        with_free: makes the filtered error, (n, rows), of the model with free parameters; None if that fails.
        compared: (samples, n) 0 where a motor's rest or reversal is left out; all ones when None.
        errors_of: makes the errors, (n,), of a robot near the nominal one, or of that; None of a joint.
    """

    channels: tuple[str, ...]
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
    errors_of: Callable[[Robot | None], FloatArray] | None = None
    initial: Initial | None = None
    simulations: int = 0
    warnings: tuple[str, ...] = ()


def validate(estimate: Estimate | IdentifiedJoint, record: Record | Sequence[Record]) -> Validation:
    """Compare an identified joint or robot with a record.

    Args:
        estimate: by any method; of a joint also one that was read back from a file.
        record: of a robot one of each joint, with the channels its method uses: that of the estimate for a direct
            test, or another for a cross test.

    Raises:
        RecordError: a channel is missing, or the record contradicts its description.
        MethodError: the joint or robot cannot be simulated on this record.
    """
    if isinstance(estimate, Estimate) and estimate.robot is not None:
        if not isinstance(record, Sequence):
            raise MethodError("The estimate of a robot is validated on a record of each joint; give them in order.")
        robot, records = estimate.robot.model, read_as(record, estimate.settings.timing)
        found = _predict_robot(estimate, records)
        method, source, prints = estimate.settings.method, estimate.data.record, estimate.data.fingerprints
        gear: Transmission | None = None
        axes = [(robot.names[k], robot.torque_unit(k), robot.position_unit(k), gear) for k in range(len(robot))]
    else:
        if isinstance(record, Sequence):
            raise MethodError("The estimate of a joint is validated on one record; validate it on each alone.")
        record.require(("torque",), "Validation")
        check_record(record)
        identified = estimate.identified if isinstance(estimate, Estimate) else estimate
        records, joint = read_as([record], identified.timing), identified.joint
        found = _predict_joint(identified, records[0])
        method, source, prints = identified.method, identified.record, identified.fingerprints
        length = POSITION_UNIT[joint.kind]
        assert record.torque is not None
        axes = [("", length if method == "open_loop" else record.torque.unit, length, joint.transmission)]
    torques = [one.torque.values for one in records if one.torque is not None]
    own = fingerprint(np.concatenate(torques)) in prints
    anew, nominal, bodies = None if own else found.with_free(), None, None
    if not own and isinstance(estimate, Estimate) and found.errors_of is not None:
        from jointid.estimation.robots.consistent import can_be_near, consistent_robot

        part = estimate.require_robot()
        nominal = found.errors_of(None) if part.model.has_masses else None
        if can_be_near(part.model) and all(spring.shown for spring in part.springs):
            bodies = found.errors_of(consistent_robot(estimate).robot)
    size = np.linalg.norm(found.whole, axis=1)
    rows, compared = found.error.shape[1] // found.equations, np.zeros(found.measured.shape)
    compared[found.borders[0] : len(compared) - found.borders[1]] = 1.0
    compared *= 1.0 if found.compared is None else found.compared
    loop, made = method == "didim", list[ValidatedAxis]()
    for k, (name, unit, length, gear) in enumerate(axes):
        measured, predicted = found.measured[:, k], found.predicted[:, k]
        off, off_rms = _compare_tracking(records[k], found, k) if loop else (None, None)
        made.append(
            ValidatedAxis(
                name, unit, length, measured, predicted, compared[:, k],
                relative_error(compared[:, k] * measured, compared[:, k] * predicted, found.borders),
                float(np.linalg.norm(found.error[k]) / size[k]), _autocorrelate(found.error[k, :rows]), rows,
                Motion(*(one[:, k] for one in found.motion)), gear, off, off_rms,
                *(
                    None if one is None else float(one[k])
                    for one in (None if anew is None else np.linalg.norm(anew, axis=1) / size, nominal, bodies)
                ),
            )
        )  # fmt: skip
    warnings = found.warnings
    if isinstance(estimate, Estimate) and not estimate.fit.converged:
        warnings += ("the search for the estimate did not settle: do not rely on it",)
    first = records[0]
    return Validation(
        "direct" if own else "cross", method, first.name, source,
        (*found.channels, *(("injected",) if first.injected is not None else ())), found.sample_time,
        "position" if method == "open_loop" else "torque", found.borders, tuple(made), found.initial,
        found.simulations, warnings, first.resampled,
    )  # fmt: skip


def _autocorrelate(error: FloatArray) -> FloatArray:
    centred = error - error.mean()
    power = float(centred @ centred) or 1.0
    lags = range(min(_LAGS, centred.size - 1) + 1)
    return np.array([float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in lags])


def _compare_tracking(record: Record, found: _Predicted, k: int) -> tuple[float | None, float | None]:
    """Return the relative error of an axis's simulated tracking error and its rms; None without a measured one."""
    reference, position, simulated = record.reference, record.motor_position, found.motion[0][:, k]
    if reference is None or position is None or {reference.sample_time, position.sample_time} != {found.sample_time}:
        return None, None
    size = min(len(reference), len(position), simulated.size)
    asked, was, is_ = reference.values[:size], position.values[:size], simulated[:size]
    return relative_error(asked - was, asked - is_, found.borders), float(np.sqrt(np.mean((was - is_) ** 2)))


def _predict_joint(identified: IdentifiedJoint, record: Record) -> _Predicted:
    if identified.loop is not None:
        return _simulate_loop(identified, identified.loop, record)
    if identified.method in ("drive_side", "open_loop"):
        return _simulate_along_motion(identified, record)
    assert record.torque is not None
    joint, filtering, effects = identified.joint, identified.filtering, identified.effects
    if joint.model == "flexible" and not any(isinstance(one, EncoderOffset) for one in effects):
        effects = (*effects, EncoderOffset())
    names = [p.name for p in (*joint.parameters, *effect_parameters(effects))]
    model = motion_of(record, identified.delay, filtering, joint, effects)
    values = np.array([identified.values.get(name, 0.0) for name in names])
    error, columns = model.decimate(filtering, record.torque.sample_time, values)
    whole = error + columns @ values
    own = fingerprint(record.torque.values) in identified.fingerprints
    zero = np.array([name == "encoder_offset" and not own for name in names])  # counted from elsewhere in each record
    step = np.linalg.lstsq(columns[:, zero], error, rcond=None)[0]
    values[zero] += step
    motor = model.motor
    return _Predicted(
        idim_channels(joint.model), record.torque.sample_time, filtering.borders, model.torque[0][:, np.newaxis],
        (model.columns[0] @ values)[:, np.newaxis], (error - columns[:, zero] @ step)[np.newaxis], whole[np.newaxis],
        [one[:, np.newaxis] for one in (motor.position, motor.velocity, motor.acceleration)],
        lambda: _fit_columns(columns, whole[np.newaxis]), equations=len(model.torque),
    )  # fmt: skip


def _fit_columns(columns: FloatArray, whole: FloatArray) -> FloatArray:
    """Residual of a weighted fit of columns, (n, rows); weights come from a first fit."""
    left = whole
    for _ in range(min(len(whole), 2)):
        weights = np.repeat(1.0 / np.maximum(np.linalg.norm(left, axis=1), 1e-300), whole.shape[1])
        fitted = np.linalg.lstsq(columns * weights[:, np.newaxis], whole.ravel() * weights, rcond=None)[0]
        left = whole - (columns @ fitted).reshape(whole.shape)
    return left


def _simulate_loop(identified: IdentifiedJoint, loop: ClosedLoop, record: Record) -> _Predicted:
    assert record.torque is not None
    record.require(loop.channels, "Validation of a DIDIM estimate")
    experiment = prepare(loop, record)
    measured = record.torque.values[: experiment.samples]
    around = with_torque(INITIAL_STATE, experiment, measured)
    free = ClosedLoopProblem((*loop.joint.parameters, *around), measured, identified.filtering, loop, experiment)
    problem = free.keeping({p.name: identified.values[p.name] for p in loop.joint.parameters})
    x, runs = fit_initial_state(problem)
    run = require_success(problem.simulate(x))
    other_law = (
        "the controller is not the one the joint was identified under; that is right only if its gains were changed"
    )
    return _predict_by(
        problem, free.keeping({"initial_velocity": problem.values(x)["initial_velocity"]}), x, run.torque,
        [run.motor_position, run.motor_velocity, run.motor.acceleration], loop.channels,
    )._replace(
        initial=initial_of(problem.values(x)), simulations=runs + 1,
        warnings=() if identified.controller in ("", law_fingerprint(loop)) else (other_law,),
    )  # fmt: skip


def _simulate_along_motion(identified: IdentifiedJoint, record: Record) -> _Predicted:
    """Predict the torque along the motor's motion, or the motor's motion under the torque, with the log's own delay."""
    joint, filtering, values = identified.joint, identified.filtering, identified.values
    free: DriveSideProblem | OpenLoopProblem
    if identified.method == "drive_side":
        log = LOG_DELAY.fix(-identified.delay), CURRENT_LAG.fix(values.get(CURRENT_LAG.name, 0.0))
        free = motion_problem(record, DriveSide(joint), filtering, joint.parameters, log)
    else:
        free = position_problem(record, OpenLoop(joint), filtering, joint.parameters, LOG_DELAY.fix(-identified.delay))
    problem = free.keeping({p.name: values[p.name] for p in joint.parameters})
    found = solve(problem, _SEARCH, problem.vector({})) if problem.free else None
    x = np.zeros(0) if found is None else found.x
    predicted, _, finished = problem.simulate(x, ())
    if not finished:
        raise MethodError("The joint cannot be simulated along this record; check its motor position and torque.")
    if isinstance(problem, DriveSideProblem):
        position, velocity = problem.motion.position[::PARTS], problem.motion.velocity[::PARTS]
    else:
        assert record.motor_position is not None and filtering.position_cutoff is not None
        position = lowpass(record.motor_position.values, filtering.position_cutoff, problem.sample_time)
        velocity = differentiate(position, problem.sample_time)
    size, moving = problem.measured.size, getattr(problem, "weights", None)
    motion = [one[:size] for one in (position, velocity, differentiate(velocity, problem.sample_time))]
    return _predict_by(problem, free, x, predicted, motion, DriveSide(joint).channels)._replace(
        compared=None if moving is None else moving[:, np.newaxis],
        simulations=1 + (0 if found is None else found.evaluations),
    )


def _predict_by(
    problem: ClosedLoopProblem | DriveSideProblem | OpenLoopProblem,
    free: ClosedLoopProblem | DriveSideProblem | OpenLoopProblem,
    x: FloatArray,
    predicted: FloatArray,
    motion: Sequence[FloatArray],
    channels: tuple[str, ...],
) -> _Predicted:
    """Return the prediction of a problem whose joint is known, beside the same problem with a `free` one."""
    measured = problem.measured
    error, whole = problem.filter(np.column_stack([measured - predicted, measured])).T

    def fit_anew() -> FloatArray | None:
        found = _search(free, free.vector(problem.values(x)))
        return None if found is None else found.residual[np.newaxis]

    return _Predicted(
        channels, problem.sample_time, problem.filtering.borders, measured[:, np.newaxis], predicted[:, np.newaxis],
        error[np.newaxis], whole[np.newaxis], [one[:, np.newaxis] for one in motion], fit_anew,
    )  # fmt: skip


def _search(problem: Any, start: FloatArray) -> Solution | None:
    """Return the solution of a search; None if it fails."""
    try:
        with np.errstate(all="ignore"):  # a loop that runs away
            return solve(problem, _SEARCH, start)
    except (JointidError, np.linalg.LinAlgError):
        return None


def _predict_robot(estimate: Estimate, records: Sequence[Record]) -> _Predicted:
    from jointid.estimation.robots.idim import InverseModelRobot
    from jointid.estimation.robots.numbers import robot_parameters
    from jointid.estimation.robots.regression import base_columns, base_rows, motion_of_robot, relative_errors
    from jointid.estimation.robots.simulated import SimulatedRobot, errors_of, nominal_numbers, problem_of
    from jointid.simulation.robot_numbers import RobotNumbers
    from jointid.simulation.robots import motion_at

    part, filtering = estimate.require_robot(), estimate.settings.filtering
    robot, coupling = part.model, part.model.coupling.T
    if isinstance(part, InverseModelRobot):
        motion = motion_of_robot(robot, records, filtering)
        columns = base_columns(robot, part.base, motion)
        rows = base_rows(robot, part.base, motion, columns)

        return _Predicted(
            ("torque", "motor_position"), motion.sample_time, motion.filtering.borders, motion.torque,
            columns @ part.values, rows.by_equation(rows.Y - rows.W @ part.values), rows.by_equation(rows.Y),
            [one @ coupling for one in (motion.q, motion.v, motion.a)],
            lambda: _fit_columns(rows.W, rows.by_equation(rows.Y)), motion.moving,
            errors_of=lambda near: relative_errors(
                rows, part.nominal if near is None else part.base.with_friction(near)
            ),
        )  # fmt: skip
    assert isinstance(part, SimulatedRobot)
    numbers = part.numbers()
    problem: Any = problem_of(part.setup, records, robot_parameters(robot), filtering)
    run = problem.run_of(numbers)
    if run is None:
        what = "references" if part.has_controllers else "motor positions"
        raise MethodError(f"The robot that was identified cannot be simulated along this record; check its {what}.")
    if part.has_controllers:
        moved, channels = motion_at(run, problem.experiment.clock.log_index), ("torque", "reference")
        path = [one[:, numbers.rotors] for one in (moved.position, moved.velocity, moved.acceleration)]
    else:
        channels = "torque", "motor_position"
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

    return _Predicted(
        channels, problem.sample_time, problem.filtering.borders, problem.measured, problem.predict(run),
        problem.by_joint(error), problem.by_joint(problem.filtered_torque), path, fit_anew,
        None if part.has_controllers else problem.motion.moving,
        errors_of=lambda near: errors_of(
            problem,
            nominal_numbers(robot, numbers) if near is None else replace(RobotNumbers.of(near), log=numbers.log),
        ),
    )  # fmt: skip
