"""The parts of an estimate: its fit, its checks, the data it is from, and the settings it was made with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from jointid.common.arrays import FloatArray
from jointid.estimation.result.agreement import Agreement
from jointid.estimation.result.drift import DriftTest
from jointid.estimation.result.params import EstimatedParameter
from jointid.models.disturbances import Effect
from jointid.models.joints import Joint
from jointid.records.record import Resampled
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.regression import Conditioning
from jointid.uncertainty.endogeneity_test import ChiSquareTest
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.residual_tests import ResidualReport
from jointid.uncertainty.verdict import StiffnessBound, Verdict


@dataclass(frozen=True, slots=True)
class Iteration:
    """One line of the trace.

    Attributes:
        number: 0 is the start.
        values: of the parameters, by name.
        residual_norm: of the filtered torque error at these values.
        change: relative change of the residual norm since the last iteration; None at the start.
        step: largest relative change of a parameter since the last iteration; None at the start.
        simulations: so far.
        gain_scale: factor on the simulated controller's gains.
    """

    number: int
    values: dict[str, float]
    residual_norm: float
    change: float | None
    step: float | None
    simulations: int
    gain_scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How well the model reproduces the torque, and what it took to find out.

    Attributes:
        measured, predicted: (samples,) raw torque, and that of the model; of several records one after the other; empty
            for a log that is too long for memory.
        borders: samples left out at each end of the raw error.
        relative_error: ``||measured - predicted|| / ||measured||`` of the raw torque, borders left out; a ratio.
        filtered_error: the same of the filtered and decimated torque: what was minimised.
        rows: filtered samples that were fitted.
        compared: "torque", or "position" where an open loop is compared by it: then measured, predicted and the errors
            are of the motor position, without its drift.
        residuals: tests of the filtered error: whiteness, repetition with the motion.
        conditioning: of the regressor, for a linear regression.
        initial: the motor's state at the first sample, for a simulation.
        trace: every iteration.
        simulations: that were run, all of them, those for derivatives and deviations included.
        passes: over the whole of a long log.
        at_limit: share of the controller's periods at its limit, in a long log.
        stop: why the search ended, in a sentence; converged: whether that is a good end.
        interrupted: True if the last pass over a long log was: the estimate is of its beginning.
    """

    measured: FloatArray
    predicted: FloatArray
    borders: tuple[int, int]
    relative_error: float
    filtered_error: float
    rows: int
    simulations: int
    stop: str
    converged: bool
    compared: Literal["torque", "position"] = "torque"
    residuals: ResidualReport | None = None
    conditioning: Conditioning | None = None
    initial: Initial | None = None
    trace: tuple[Iteration, ...] = ()
    passes: int = 0
    at_limit: float = 0.0
    interrupted: bool = False

    @property
    def iterations(self) -> int:
        """Steps that were taken."""
        return max(len(self.trace) - 1, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """What speaks for the estimate and what against it.

    Attributes:
        verdicts: on the solver, the fit, the residual, identifiability, bounds, stiffness; one question each.
        known: which parameters and combinations the record determines, and how well.
        tests: of the method's assumptions.
        bounds: lower bounds of a refused stiffness, by the load's share of the inertia.
        repeatable: the part of the residual that repeats with the motion, in a long log.
        agreement: whether several records, each by itself, agree.
        drift: whether the segments of a long log agree.
        warnings: one sentence each.
    """

    verdicts: tuple[Verdict, ...] = ()
    known: Identifiability | None = None
    tests: tuple[ChiSquareTest, ...] = ()
    bounds: tuple[StiffnessBound, ...] = ()
    repeatable: Repeatable | None = None
    agreement: Agreement | None = None
    drift: DriftTest | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RecordFit:
    """One of several records: what it says by itself, and how well the common model reproduces it.

    Attributes:
        name: of the record; fingerprint: of its torque.
        loop: joint and controller it was logged under.
        channels: that were read.
        added_inertia: known, on the load, on top of what is shared.
        alone: estimated from this record by itself: all that is free in it, in the units of the answer, without
            the added inertia, so that records can be compared.
        values: every parameter of the joint as it is in this record, the added inertia included.
        initial: the motor's state at the first sample.
        level: the residual that remains of it by itself, rms over its degrees of freedom: its rows are weighted by
            the inverse.
        repeatable: what of the residual it leaves by itself repeats with the motion.
        sample_time, filtering, rows: of its torque; how it was filtered; how many rows it gave.
        measured, predicted: (samples,) raw torque, and that of the common model.
        resampled: how its samples were brought to a uniform clock, None where they were logged so.
        relative_error, filtered_error: norm of the error of the common model over that of the torque, raw with the
            borders left out, and filtered; alone_error: the filtered one of the record by itself.
    """

    name: str
    fingerprint: str
    loop: ClosedLoop
    channels: tuple[str, ...]
    added_inertia: float
    alone: tuple[EstimatedParameter, ...]
    values: Mapping[str, float]
    initial: Initial
    level: float
    repeatable: Repeatable
    sample_time: float
    filtering: Filtering
    rows: int
    measured: FloatArray
    predicted: FloatArray
    relative_error: float
    filtered_error: float
    alone_error: float
    resampled: Resampled | None = None


@dataclass(frozen=True, slots=True)
class Windows:
    """The windows in which a long log was identified.

    Attributes:
        count: that were fitted; still: in which nothing was asked of the axis, and which were left out.
        length: seconds of each. settling: seconds simulated before and after each window, and not fitted.
        duration: seconds from the first to the last fitted row.
    """

    count: int
    still: int
    length: float
    settling: float
    duration: float


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """The record, or records, that were identified from.

    Attributes:
        record: its name; of several, all names.
        channels: that were read.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V.
        fingerprint: of the torque, see `fingerprint`.
        resampled: how the samples were brought to a uniform clock, None where they were logged so.
        records: each of several records by itself; empty for one record.
        windows: how a long log was cut; None for a record.
    """

    record: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    fingerprint: str = ""
    resampled: Resampled | None = None
    records: tuple[RecordFit, ...] = ()
    windows: Windows | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """The model and the method, defaults filled in.

    Attributes:
        method: its name, as in a joint file; variant: how it was run, in words.
        joint: the model. loop: the closed loop, when the method simulated one.
        filtering: as used.
        delay: seconds from the logged torque to the torque that acts, as declared, or as found where it was free.
        effects: torques beside the joint's own model; their parameters follow the joint's.
        weighting: of the rows of several records, in words.
    """

    method: str
    variant: str
    joint: Joint
    loop: ClosedLoop | None
    filtering: Filtering
    delay: float = 0.0
    effects: tuple[Effect, ...] = ()
    weighting: str = ""
