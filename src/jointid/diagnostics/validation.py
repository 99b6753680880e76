"""Validation as the paper does it: the direct test on the same record, the cross test on another one.

The torque of each axis is predicted (`record_prediction`) and compared with the measured one, ``||Y - Ys|| / ||Y||``.

What noise allows is what the same model leaves of another record when its parameters are free there. It predicts the
record where it adds less than that to the error of each axis, as the root of a difference of squares. A robot is also
compared with its nominal masses, rotors and springs, with friction fitted to the estimate's record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Paragraph, Table, common_facts
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parallel import one_thread
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.diagnostics.record_prediction import predict_joint, predict_robot
from jointid.estimation.problems.inverse_model import read_as
from jointid.estimation.result.estimate import Estimate, fingerprint, relative_error
from jointid.estimation.result.verdict import POOR_FIT, scale_verdict
from jointid.models.joints import ClosedLoop
from jointid.models.position_forces import Motion
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled
from jointid.simulation.controller_torque import compute_controller_torque

_LAGS = 40  # of the residual's autocorrelation
_NEGLIGIBLE = 0.01  # of the torque: a joint that adds less to the error predicts a record that has no noise
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
        bad = code not in (Prediction.OWN_RECORD, Prediction.PREDICTED)
        there = [axis for axis in self.axes if axis.prediction is code or not bad]
        left, least = _rms([a.filtered_error for a in there]), _rms_of_all([a.attainable_error for a in there])
        who = "robot" if worst.name else "joint"
        of = f" of {join([axis.name for axis in there])}" if bad and worst.name else ""
        share = f"it leaves {_format_share(left)} of the filtered torque{of}"
        share += "" if least is None else f", and one identified from it {_format_share(least)}"
        part = "controller, " * (self.method == "didim")
        said = {
            Prediction.OWN_RECORD: f"was identified from {self.record}: {share}; validate it on another record",
            Prediction.PREDICTED: f"predicts {self.record}: {share}",
            Prediction.NOT_COMPARED: f"predicts {self.record} as well as is said: {share}; how little a {who} can "
            "leave there could not be found",
            Prediction.NOT_AS_DECLARED: f"does not predict {self.record}: {share}; {part}channels or scales are not as "
            "declared there: identify it from this record, too, and see what is said of the fit",
            Prediction.ANOTHER_JOINT: f"does not predict {self.record} within its noise: {share}; its {part}load or "
            "friction differs there: identify it from this record, too, and compare both estimates",
        }[code]
        return Message(code, f"The {who} {said}", {"filtered_error": left, "attainable_error": least})

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    @property
    def comparison(self) -> Paragraph | None:
        """The estimate beside the nominal robot, in words; None without one."""
        mine, nominal = self.filtered_error, self.nominal_error
        if nominal is None:
            return None
        said, useful = f"The estimate leaves {_format_share(mine)} of this record", mine < (1.0 + _ALIKE) * nominal
        if math.isfinite(nominal):
            said += f", the nominal model {_format_share(nominal)}{'.' if useful else ': do not use it in its place.'}"
        else:
            said += "; the nominal model is unstable under these controllers: give each joint's rotor_inertia."
        return Paragraph(said, tone="good" if useful else "bad")

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer and the errors as a document; there are no further details."""
        del details
        first, what = self.axes[0], "robot" if self.axes[0].name else "joint"
        how = {
            "didim": "simulated from the reference",
            "drive_side": "simulated along the motor position",
        }.get(self.method, "computed from the measured position")
        test = f"{self.test} test on {self.record}, of the {what} identified from {self.identified_from}"
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        error = f"{100 * self.relative_error:.4f} % raw ({left_out}), {100 * self.filtered_error:.4f} % filtered"
        facts = (
            ("test", f"{test}; torque {how}"), *common_facts(self.resampled, first.transmission),
            ("torque error", error), *(("warning", warning) for warning in self.warnings),
        )  # fmt: skip
        blocks: list[Block] = [] if self.comparison is None else [self.comparison]
        blocks.append(Facts(facts))
        if first.name:
            rows = tuple(
                (
                    one.name,
                    *map(
                        _format_cell, (one.relative_error, one.filtered_error, one.attainable_error, one.nominal_error)
                    ),
                )
                for one in self.axes
            )
            header = ("joint", "raw, %", "filtered, %", "attainable, %", "nominal, %")
            blocks.append(Table(header, rows, "Error of the prediction, as a share of the measured signal"))
        return Document(self.sentence, tuple(blocks))


def _format_cell(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{100 * share:.3g}" if math.isfinite(share) else "runs away"


def _format_share(share: float) -> str:
    return f"{number(100 * share, 3)} %"


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
    settings, source, prints = estimate.settings, estimate.data.record, estimate.data.fingerprints
    if estimate.robot is not None:
        if not (isinstance(record, Sequence) and all(isinstance(one, Record) for one in record)):
            raise MethodError("The estimate of a robot is validated on one log: give a record of each joint, in order.")
        robot, setup = estimate.robot.model, getattr(estimate.robot, "setup", None)
        if len(record) != len(robot):
            raise MethodError(
                f"A robot of {len(robot)} joints is validated with as many records; received {len(record)}: give one "
                "of each joint, in order."
            )
        given = _with_torques(record, getattr(setup, "loops", [None] * len(robot)))
        records = read_as(given, settings.timing)
        found = predict_robot(estimate, records)
        gear: Transmission | None = None
        axes = [(robot.names[k], robot.torque_unit(k), robot.position_unit(k), gear) for k in range(len(robot))]
    else:
        if isinstance(record, Sequence):
            raise MethodError("The estimate of a joint is validated on one record; validate it on each alone.")
        (record,) = _with_torques([record], [settings.loop])
        record.require(("torque",), "Validation")
        check_record(record)
        records, joint = read_as([record], settings.timing), settings.joint
        found = predict_joint(estimate, records[0])
        length = POSITION_UNIT[joint.kind]
        assert record.torque is not None
        axes = [("", record.torque.unit, length, joint.transmission)]
    torques = [one.torque.values for one in records if one.torque is not None]
    own = fingerprint(np.concatenate(torques)) in prints
    anew, nominal = None if own else found.with_free(), None
    if not own and found.nominal_errors is not None:
        nominal = found.nominal_errors() if estimate.require_robot().model.has_masses else None
    size = np.linalg.norm(found.whole, axis=1)
    rows, compared = found.error.shape[1] // found.equations, np.zeros(found.measured.shape)
    compared[found.borders[0] : len(compared) - found.borders[1]] = 1.0
    compared *= 1.0 if found.compared is None else found.compared
    made = list[ValidatedAxis]()
    for k, (name, unit, length, gear) in enumerate(axes):
        measured, predicted = found.measured[:, k], found.predicted[:, k]
        made.append(
            ValidatedAxis(
                name, unit, length, measured, predicted, compared[:, k],
                relative_error(compared[:, k] * measured, compared[:, k] * predicted, found.borders),
                float(np.linalg.norm(found.error[k]) / size[k]), _autocorrelate(found.error[k, :rows]), rows,
                Motion(*(one[:, k] for one in found.motion)), gear,
                *(
                    None if one is None else float(one[k])
                    for one in (None if anew is None else np.linalg.norm(anew, axis=1) / size, nominal)
                ),
            )
        )  # fmt: skip
    first = records[0]
    warnings = found.warnings
    if not estimate.fit.converged:
        warnings += ("the search for the estimate did not settle: do not rely on it",)
    warnings += (scale_verdict(()).said,) if any(one.computed for one in records) else ()
    return Validation(
        "direct" if own else "cross", settings.method, first.name, source,
        found.sample_time, found.borders, tuple(made), warnings, first.resampled,
    )  # fmt: skip


def _with_torques(records: Sequence[Record], loops: Sequence[ClosedLoop | None]) -> list[Record]:
    """Add the controllers' torques to records without a logged torque."""
    return [
        one if one.torque is not None or one.motor_position is None or loop is None
        else compute_controller_torque(one, loop)
        for one, loop in zip(records, loops, strict=True)
    ]  # fmt: skip


def _autocorrelate(error: FloatArray) -> FloatArray:
    centred = error - error.mean()
    power = float(centred @ centred) or 1.0
    lags = range(min(_LAGS, centred.size - 1) + 1)
    return np.array([float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in lags])
