"""The estimate: what `identify` returns, complete and frozen, in five named parts."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented
from jointid.common.errors import MethodError, RecordError
from jointid.estimation.result import shortcuts
from jointid.estimation.result.params import EstimatedParameter, Params
from jointid.estimation.result.record_fit import RecordFit, Windows
from jointid.estimation.several_records.heterogeneity import Agreement
from jointid.estimation.streaming.drift import DriftTest
from jointid.models.disturbances import Effect
from jointid.models.joints import Joint
from jointid.models.transmission import OtherSide, other_side
from jointid.records.signals.filtering import Filtering
from jointid.records.time_base.uniformity import Resampled
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.regression import Conditioning
from jointid.uncertainty.endogeneity_test import ChiSquareTest
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.residual_tests import ResidualReport
from jointid.uncertainty.verdict import StiffnessBound, Verdict

if TYPE_CHECKING:
    from pandas import DataFrame

    from jointid.records.record import Record

_PERIOD = 1e-4  # s, at which two controllers without one of their own are compared
_MOST = 64  # times that a position loop may be slower
_POOR = 0.15  # of the filtered torque: the EMPS axis leaves 0.045, the paper's 0.08


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


@dataclass(frozen=True, slots=True)
class IdentifiedJoint:
    """The part of an estimate that predicts a torque; it can be read back from a file.

    Attributes:
        method: its name, as in a joint file.
        joint: the model.
        loop: the closed loop, for DIDIM.
        values: every parameter of the joint, and of its effects, by name.
        filtering: resolved, as it was identified with.
        delay: seconds from the logged torque to the torque that acts.
        record: name of the record it was identified from.
        fingerprint: of that record's torque, see `fingerprint`.
        controller: fingerprint of the loop's controller, for DIDIM; see `law_fingerprint`.
        effects: torques beside the joint's own model; `values` has their parameters too.
    """

    method: str
    joint: Joint
    loop: ClosedLoop | None
    values: dict[str, float]
    filtering: Filtering
    delay: float
    record: str
    fingerprint: str
    controller: str = ""
    effects: tuple[Effect, ...] = ()


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


@dataclass(frozen=True, slots=True, eq=False)
class Estimate(Documented):
    """The result of an identification.

    Attributes:
        params: the parameters with their standard errors and correlation.
        fit: measured and predicted torque, errors, residual, and how the search went.
        checks: verdicts, identifiable combinations, tests, bounds, warnings.
        data: the record or records.
        settings: the model and the method, defaults filled in.

    Example:
        >>> import jointid as ji
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=100.0, kv=2000.0))
        >>> reference = ji.trapezoids(speeds=(0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> estimate = ji.identify(ji.simulated_record(loop, reference, truth, sample_time=1e-3), loop)
        >>> round(estimate.params["inertia"].value, 6), estimate.success
        (30.0, True)
    """

    params: Params
    fit: Fit
    checks: Checks
    data: Data
    settings: Settings

    @property
    def success(self) -> bool:
        """True if the search converged and no parameter of the joint is refused; the verdicts say more."""
        return self.fit.converged and all(p.value is not None for p in self.params if p.of_joint)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors of the free parameters, in the order of `params.names`."""
        return self.params.covariance

    @property
    def values(self) -> dict[str, float]:
        """The parameters of joint and effects by name, fixed ones included; a refused one is missing."""
        return {p.name: p.value for p in self.params if p.of_joint and p.value is not None}

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Return a parameter by its name or symbol; ``name@2`` is the second record's own."""
        return self.params[name]

    @property
    def other(self) -> OtherSide | None:
        """The other side of the transmission; None without one."""
        return other_side(self.settings.joint.transmission, self.data.torque_unit)

    @property
    def other_side(self) -> tuple[EstimatedParameter, ...]:
        """The parameters on the other side of the transmission, in the same order; none without one."""
        return self.params.on(self.other)

    @property
    def identified(self) -> IdentifiedJoint:
        """The part that predicts a torque, of another record, say.

        Raises:
            MethodError: a value is refused, without which no torque can be predicted.
        """
        refused = [p.name for p in self.params if p.of_joint and p.value is None]
        if refused:
            raise MethodError(
                f"{', '.join(refused)} cannot be told from this record, so this estimate predicts no torque; identify "
                "the joint as rigid."
            )
        settings, data = self.settings, self.data
        law = "" if settings.loop is None else law_fingerprint(settings.loop)
        return IdentifiedJoint(
            settings.method, settings.joint, settings.loop, self.values, settings.filtering, settings.delay,
            data.record, data.fingerprint, law, settings.effects,
        )  # fmt: skip

    def amended(self, **parts: Mapping[str, Any]) -> Estimate:
        """Return the estimate with some entries of its parts exchanged: ``amended(checks={"warnings": ()})``."""
        return replace(self, **{name: replace(getattr(self, name), **entries) for name, entries in parts.items()})

    def document(self, *, details: bool = False) -> Document:
        """Return the estimate as a document: table, combinations, errors, verdicts that did not pass, and warnings.

        Args:
            details: whether to add the verdicts that passed, all reasons, tests, effort and settings.
        """
        from jointid.estimation.result.summary import estimate_document

        return estimate_document(self, details=details)

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as JSON has it: what `jointid identify --json` writes, see docs/answers.md."""
        return shortcuts.to_dict(self)

    def to_dataframe(self) -> DataFrame:
        """Return the parameters as a pandas data frame: a row each, with value, standard error, interval and unit.

        Raises:
            ExtraError: pandas is not installed.
        """
        return shortcuts.to_dataframe(self)

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON, which other commands read; return the path.

        Raises:
            RecordError: the file cannot be written.
        """
        return shortcuts.save(self, path)

    @property
    def plot(self) -> shortcuts.Plots:
        """The figures: ``estimate.plot.torque()``, ``estimate.plot.residual(record)``."""
        return shortcuts.Plots(self)

    def report(self, record: Record, *, name: str = "", profiles: Sequence[str] | None = None) -> shortcuts.Report:
        """Return the report: one page with figures, see `jointid.report_estimate`.

        Args:
            record: that it was identified from.
            name: of the joint, for the title.
            profiles: quantities whose criterion is followed; all free parameters when None, none when empty.
        """
        return shortcuts.report(self, record, name=name, profiles=profiles)


def fingerprint(torque: FloatArray) -> str:
    """Return the SHA-256 of a torque's samples: two records with the same one are the same record."""
    return hashlib.sha256(np.ascontiguousarray(torque).tobytes()).hexdigest()


def law_fingerprint(loop: ClosedLoop) -> str:
    """Return the SHA-256 of a loop's controller at a fixed period: two loops with the same one have the same law."""
    slow = getattr(loop.controller, "position_period", None)  # a whole number of times as long, within bounds
    law = loop.controller.law(slow / min(max(round(slow / _PERIOD), 1), _MOST) if slow else _PERIOD)
    digest = hashlib.sha256()
    for array in (law.A, law.B, law.C, law.D, law.E, law.F, law.limits, np.array([law.period, law.delay])):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def relative_error(measured: FloatArray, predicted: FloatArray, borders: tuple[int, int]) -> float:
    """Return ``||measured - predicted|| / ||measured||`` with samples left out at both ends."""
    if sum(borders) >= measured.size:
        raise RecordError(
            f"Borders of {borders[0]} and {borders[1]} samples leave nothing of a record of {measured.size}; give "
            "smaller borders, or a longer record."
        )
    inside = slice(borders[0], measured.size - borders[1])
    return float(np.linalg.norm((measured - predicted)[inside]) / np.linalg.norm(measured[inside]))


def poor_fit(filtered_error: float) -> tuple[str, ...]:
    """Return a warning where a model leaves more of the torque unexplained than friction laws and noise usually do."""
    if filtered_error <= _POOR:
        return ()
    return (
        f"the model leaves {100 * filtered_error:.0f} % of the filtered torque unexplained, which is more than a right "
        "model does; check signs, units, the controller and its limit, and whether the joint is what it is said to be",
    )
