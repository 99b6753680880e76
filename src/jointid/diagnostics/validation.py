"""Validation as the paper does it: the direct test on the same record, the cross test on another one.

The identified joint is simulated (DIDIM) or its inverse model evaluated (IDIM), and the torque compared with the
measured one, ``||Y - Ys|| / ||Y||``. Only the motor's state at the first sample is estimated anew.

What noise allows is what the same model leaves of another record when its parameters are free there. The joint predicts
the record where it adds less than that to the error, as the root of a difference of squares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Literal, NamedTuple, overload

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Facts, common_facts
from jointid.common.errors import JointidError, MethodError, extra
from jointid.common.messages import Message
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of, with_torque
from jointid.estimation.problems.inverse_model import idim_channels, motion_of
from jointid.estimation.result.estimate import (
    Estimate,
    IdentifiedJoint,
    fingerprint,
    law_fingerprint,
    relative_error,
)
from jointid.estimation.starts.rigid_joint import fit_initial_state
from jointid.models.disturbances import effect_parameters
from jointid.models.joints import ClosedLoop
from jointid.models.position_forces import Motion
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled
from jointid.simulation.closed_loop import Initial, Simulation
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulated import require_success
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import solve
from jointid.uncertainty.verdict import POOR_FIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from jointid.diagnostics.robots.validation import RobotValidation

_LAGS = 40  # of the residual's autocorrelation
_NEGLIGIBLE = 0.01  # of the torque: a joint that adds less to the error predicts a record that has no noise
_TOLERANCE, _EVALUATIONS = 1e-5, 40  # of the attainable error: far below its reported digits


class Prediction(StrEnum):
    """Answers to whether a joint predicts a record, as codes."""

    PREDICTED = "predicted"
    ANOTHER_JOINT = "another_joint"
    NOT_AS_DECLARED = "not_as_declared"
    OWN_RECORD = "own_record"
    NOT_COMPARED = "not_compared"


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Documented):
    """Agreement of an estimate's predicted torque with a record.

    Attributes:
        test: "direct" on the record it was identified from, "cross" on another.
        method: "didim" simulates the loop; "idim" evaluates the inverse model on the measured position.
        record, identified_from: names of the records.
        channels: of the record that were used.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V; position_unit: of the motion: m or rad.
        measured, predicted: (samples,) raw torque.
        borders: samples left out at each end of the relative error.
        relative_error: of the raw torque; a ratio.
        filtered_error: of the filtered and decimated torque, with the estimate's own filtering; a ratio.
        attainable_error: the same of a joint identified from this record; None in a direct test, and where none is.
        autocorrelation: (lags + 1,) of the filtered torque error, 1 at lag 0; a white one stays within `white_band`.
        rows: of the filtered torque error.
        motor: motion the error is plotted against: simulated for DIDIM, measured for IDIM.
        transmission: on whose `side` torque and motion are.
        tracking_error: ``||e - es|| / ||e||`` of the tracking error reference - position, where the record has a
            motor position to compare with; a ratio.
        initial: estimated motor state, for a simulation.
        simulations: number run for the prediction.
        warnings: limits of the result, one sentence each.
        resampled: resampling of the record to a uniform clock; None where it was logged so.
    """

    test: Literal["direct", "cross"]
    method: str
    record: str
    identified_from: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    position_unit: str
    measured: FloatArray
    predicted: FloatArray
    borders: tuple[int, int]
    relative_error: float
    filtered_error: float
    autocorrelation: FloatArray
    rows: int
    motor: Motion
    transmission: Transmission | None = None
    tracking_error: float | None = None
    initial: Initial | None = None
    simulations: int = 0
    warnings: tuple[str, ...] = ()
    resampled: Resampled | None = None
    attainable_error: float | None = None

    @property
    def white_band(self) -> float:
        """Twice the standard deviation of an autocorrelation of white noise, ``2 / sqrt(rows)``."""
        return float(2 / np.sqrt(self.rows))

    @property
    def outside_band(self) -> float:
        """Share of the lags above 0 whose autocorrelation is outside the band; about 0.05 for a white residual."""
        return float(np.mean(np.abs(self.autocorrelation[1:]) > self.white_band))

    @property
    def answer(self) -> Message:
        """Whether the joint predicts the record within its noise, and the remedy if not."""
        left, least = self.filtered_error, self.attainable_error
        share = f"leaves {_format_share(left)} of its filtered torque"
        values = {"filtered_error": left, "attainable_error": least}
        if self.test == "direct":
            words = f"The joint was identified from {self.record} and {share}; that it predicts another record is shown"
            return Message(Prediction.OWN_RECORD, f"{words} by that record only: validate it on one", values)
        allowed = "" if least is None else f", and one identified from it {_format_share(least)}"
        if left > POOR_FIT and (least is None or least > POOR_FIT):
            wrong = "controller, channels or scales are" if self.method == "didim" else "channels or scales are"
            words = f"The joint does not predict {self.record}: it {share}{allowed}; {wrong} not as declared there"
            words += ": identify it from this record, too, and see what is said of the fit"
            return Message(Prediction.NOT_AS_DECLARED, words, values)
        if least is None:
            words = f"The joint {share} on {self.record}; how little a joint can leave there could not be found"
            return Message(Prediction.NOT_COMPARED, words, values)
        if math.sqrt(max(left**2 - least**2, 0.0)) <= max(least, _NEGLIGIBLE):
            return Message(Prediction.PREDICTED, f"The joint predicts {self.record}: it {share}{allowed}", values)
        words = f"The joint does not predict {self.record} within its noise: it {share}{allowed}; the axis or its "
        words += "controller is another one there: identify it from this record, too, and compare both estimates"
        return Message(Prediction.ANOTHER_JOINT, words, values)

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    def plot(self) -> Figure:
        """Return measured, predicted and error torque over time, of matplotlib; see `jointid.figures.torque`."""
        import jointid

        return jointid.figures.torque(self)

    def to_dataframe(self) -> DataFrame:
        """Return measured and predicted torque and their difference over time as a pandas data frame.

        Raises:
            ExtraError: pandas is not installed.
        """
        pandas = extra("pandas", "dataframe", "A data frame")
        time = pandas.Index(self.sample_time * np.arange(self.measured.size), name="time")
        columns = {"measured": self.measured, "predicted": self.predicted, "error": self.measured - self.predicted}
        frame: DataFrame = pandas.DataFrame(columns, index=time)
        return frame

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer, errors and whiteness as a document; there are no further details."""
        del details
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        how = "simulated from the reference" if self.method == "didim" else "computed from the measured position"
        what = f"{self.test} test on {self.record}, of the joint identified from {self.identified_from}; torque {how}"
        raw, filtered = 100 * self.relative_error, 100 * self.filtered_error
        facts = [
            ("test", what),
            *common_facts(self.resampled, self.transmission),
            ("torque error", f"{raw:.4f} % raw ({left_out}), {filtered:.4f} % filtered"),
        ]
        if self.tracking_error is not None:
            off = f"{100 * self.tracking_error:.4f} % away from the measured tracking error"
            facts.append(("tracking error", off))
        said = (
            f"{100 * self.outside_band:.0f} % of {self.autocorrelation.size - 1} autocorrelations of the filtered "
            f"error outside +-{self.white_band:.3f} (5 % if it were white)"
        )
        return Document(
            self.sentence, (Facts((*facts, ("whiteness", said), *(("warning", w) for w in self.warnings))),)
        )


def _format_share(share: float) -> str:
    return f"{number(100 * share, 3)} %"


@overload
def validate(estimate: Estimate | IdentifiedJoint, record: Record) -> Validation: ...


@overload
def validate(estimate: Estimate | IdentifiedJoint, record: Sequence[Record]) -> RobotValidation: ...


def validate(estimate: Estimate | IdentifiedJoint, record: Record | Sequence[Record]) -> Validation | RobotValidation:
    """Compare an identified joint or robot with a record.

    Args:
        estimate: new or, of a joint, read back from a file.
        record: with the channels its method uses: that of the estimate for a direct test of a joint, or another for a
            cross test. Of a robot another record of each joint; the nominal robot is compared with it, too.

    Raises:
        RecordError: a channel is missing, or the record contradicts its description.
        MethodError: the loop cannot be simulated on this record, the estimate of a joint is of the drive side or the
            open loop, or the record is the own one of a robot's estimate.
    """
    if isinstance(estimate, Estimate) and estimate.robot is not None:
        from jointid.diagnostics.robots.validation import validate_robot

        if not isinstance(record, Sequence):
            raise MethodError("The estimate of a robot is validated on a record of each joint; give them in order.")
        return validate_robot(estimate, record)
    if isinstance(record, Sequence):
        raise MethodError("The estimate of a joint is validated on one record; validate it on each alone.")
    record.require(("torque",), "Validation")
    check_record(record)
    identified = estimate.identified if isinstance(estimate, Estimate) else estimate
    if identified.method in ("drive_side", "open_loop"):
        raise MethodError(
            "A validation simulates the closed loop of a DIDIM estimate or evaluates the inverse model of an IDIM one; "
            f'this estimate is of the method "{identified.method}": identify the other record too, and compare values.'
        )
    if identified.loop is None:
        return _validate_inverse_model(identified, record)
    return _validate_simulation(identified, identified.loop, record)


def _validate_inverse_model(identified: IdentifiedJoint, record: Record) -> Validation:
    assert record.torque is not None
    joint, filtering, sample_time = identified.joint, identified.filtering, record.torque.sample_time
    model = motion_of(record, identified.delay, filtering, joint, identified.effects)
    values = np.array([identified.values[p.name] for p in (*joint.parameters, *effect_parameters(identified.effects))])
    error, columns = model.decimate(filtering, sample_time, values)
    whole, _ = model.decimate(filtering, sample_time, np.zeros_like(values))
    torques = _Torques(model.torque[0], model.columns[0] @ values, error, whole, equations=len(model.torque))
    least = whole - columns @ np.linalg.lstsq(columns, whole, rcond=None)[0]
    return _describe(identified, record, idim_channels(joint.model), torques, model.motor, lambda: least)


def _validate_simulation(identified: IdentifiedJoint, loop: ClosedLoop, record: Record) -> Validation:
    assert record.torque is not None
    record.require(loop.channels, "Validation of a DIDIM estimate")
    fixed = tuple(p.fix(identified.values[p.name]) for p in loop.joint.parameters)
    experiment = prepare(loop, record)
    measured = record.torque.values[: experiment.samples]
    around = with_torque(INITIAL_STATE, experiment, measured)
    problem = ClosedLoopProblem((*fixed, *around), measured, identified.filtering, loop, experiment)
    x, runs = fit_initial_state(problem)
    run = require_success(problem.simulate(x))
    error, whole = problem.filter(np.column_stack([measured - run.torque, measured])).T
    motor = Motion(run.motor_position, run.motor_velocity, run.motor.acceleration)
    other_law = (
        "the controller is not the one the joint was identified under; that is right only if its gains were changed"
    )
    return replace(
        _describe(
            identified,
            record,
            loop.channels,
            _Torques(measured, run.torque, error, whole),
            motor,
            lambda: _fit_anew(problem, problem.values(x)),
        ),
        tracking_error=_compare_tracking(record, run, identified.filtering.borders),
        initial=initial_of(problem.values(x)),
        simulations=runs + 1,
        warnings=() if identified.controller in ("", law_fingerprint(loop)) else (other_law,),
    )


def _fit_anew(problem: ClosedLoopProblem, values: Mapping[str, float]) -> FloatArray | None:
    """Return the filtered error, (rows,), with the joint's parameters free; None if the solution fails."""
    joint, around = problem.joint.parameters, problem.parameters[len(problem.joint.parameters) :]
    free = replace(problem, parameters=(*joint, *around)).keeping({"initial_velocity": values["initial_velocity"]})
    try:
        with np.errstate(all="ignore"):  # a loop that runs away
            return solve(free, LevenbergMarquardt(_TOLERANCE, _EVALUATIONS), free.vector(values)).residual
    except (JointidError, np.linalg.LinAlgError):
        return None


class _Torques(NamedTuple):
    """Raw torques, (samples,); filtered difference `error` and measured torque `whole`, (rows,) of each equation."""

    measured: FloatArray
    predicted: FloatArray
    error: FloatArray
    whole: FloatArray
    equations: int = 1


def _describe(
    identified: IdentifiedJoint,
    record: Record,
    channels: Sequence[str],
    torques: _Torques,
    motor: Motion,
    fit_anew: Callable[[], FloatArray | None],
) -> Validation:
    assert record.torque is not None
    borders, rows = identified.filtering.borders, torques.error.size // torques.equations
    own = fingerprint(record.torque.values) in identified.fingerprints
    size, anew = float(np.linalg.norm(torques.whole)), None if own else fit_anew()
    centred = torques.error[:rows] - torques.error[:rows].mean()
    power = float(centred @ centred) or 1.0
    lags = min(_LAGS, rows - 1)
    return Validation(
        test="direct" if own else "cross",
        method=identified.method,
        record=record.name,
        identified_from=identified.record,
        resampled=record.resampled,
        channels=(*channels, *(("injected",) if record.injected is not None else ())),
        sample_time=record.torque.sample_time,
        torque_unit=record.torque.unit,
        position_unit=POSITION_UNIT[identified.joint.kind],
        measured=torques.measured,
        predicted=torques.predicted,
        borders=borders,
        relative_error=relative_error(torques.measured, torques.predicted, borders),
        filtered_error=float(np.linalg.norm(torques.error)) / size,
        attainable_error=None if anew is None else float(np.linalg.norm(anew)) / size,
        autocorrelation=np.array([float(centred[lag:] @ centred[: rows - lag]) / power for lag in range(lags + 1)]),
        rows=rows,
        motor=motor,
        transmission=identified.joint.transmission,
    )


def _compare_tracking(record: Record, run: Simulation, borders: tuple[int, int]) -> float | None:
    """Return the relative error of the simulated tracking error; None without a measured one at the same rate."""
    reference, position = record.reference, record.motor_position
    if reference is None or position is None or position.sample_time != run.sample_time:
        return None
    if reference.sample_time != run.sample_time:
        return None
    size = min(len(reference), len(position), run.motor_position.size)
    asked = reference.values[:size]
    return relative_error(asked - position.values[:size], asked - run.motor_position[:size], borders)
