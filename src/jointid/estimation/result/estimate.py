"""The answer of an identification: complete, frozen, ready to print."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.text import aligned
from jointid.estimation.result.estimated import EstimatedParameter, OnBothSides, known_on_other_side
from jointid.estimation.result.table_rows import bound_line, known_line, parameter_row, shown
from jointid.models.disturbances import Effect
from jointid.models.joints import Joint
from jointid.models.transmission import transmission_lines
from jointid.records.signals import Filtering
from jointid.records.time_base.uniformity import Resampled, resampled_lines
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.regression import Conditioning
from jointid.uncertainty.endogeneity_test import ChiSquareTest
from jointid.uncertainty.identifiability import Identifiability, Known
from jointid.uncertainty.residual_tests import ResidualReport
from jointid.uncertainty.verdict import StiffnessBound, Verdict

_PERIOD = 1e-4  # s, at which two controllers without one of their own are compared
_MOST = 64  # times that a position loop may be slower
_POOR = 0.15  # of the filtered torque: the EMPS axis leaves 0.045, the paper's 0.08

MethodName: TypeAlias = Literal["didim", "idim", "drive_side", "open_loop"]


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
    """What of an estimate is needed to predict a torque: it can be read back from a file.

    Attributes:
        method: "didim" or "idim".
        joint: the model.
        loop: the closed loop, for DIDIM.
        values: every parameter of the joint, and of its effects, by name.
        filtering: resolved, as it was identified with.
        delay: seconds from the logged torque to the torque that acts.
        record: name of the record it was identified from.
        fingerprint: of that record's torque, see `fingerprint`.
        controller: fingerprint of the loop's controller, for DIDIM; see `law_fingerprint`.
        effects: what the torque holds beside the joint's own model; `values` has their parameters too.
    """

    method: MethodName
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
class Estimate(OnBothSides):
    """What an identification found, and how.

    Attributes:
        method: "didim" or "idim"; variant: how it was run, in words.
        joint: the model. loop: the closed loop, when the method simulated one.
        parameters: in the order of the model, then what surrounds it.
        channels: of the record, that were read.
        record: its name.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V.
        measured, predicted: (samples,) raw torque, and what the model says it should have been.
        borders: samples left out at each end of the error below.
        relative_error: ``||measured - predicted|| / ||measured||`` of the raw torque, borders left out; a ratio.
        filtered_error: the same of the filtered and decimated torque: what was minimised.
        rows: filtered samples that were fitted.
        conditioning: of the regressor, for a linear regression.
        initial: the motor's state at the first sample, for a simulation.
        filtering: as used, defaults filled in.
        trace: every iteration.
        simulations: that were run, all of them, those for derivatives and deviations included.
        stop: why it ended, in a sentence; converged: whether that is a good end.
        intervals: what the standard deviations are, in a sentence.
        warnings: what the reader must know, one sentence each.
        fingerprint: of the record's torque, so that it is known again.
        delay: seconds from the logged torque to the torque that acts, as declared, or as found where it was free.
        correlation: of the errors of the free parameters, in their order: all of them, or the joint's, which come
            first; empty where it is not known.
        tests: of what the method takes for granted.
        verdicts: on the solver, the fit, what remains, and what the record tells, one question each.
        known: which parameters and combinations the record tells, and how well.
        residuals: what the model leaves of the torque.
        resampled: how the record's samples were brought to a uniform clock, None where they were logged so.
        bounds: how soft the spring may be where its stiffness is refused, by the load's share of the inertia.
        effects: what the torque holds beside the joint's own model; their parameters follow the joint's.
        compared: "torque", or "position" where an open loop is compared by it: then measured, predicted and the errors
            are of the motor position, without its drift.
    """

    method: MethodName
    variant: str
    joint: Joint
    loop: ClosedLoop | None
    parameters: tuple[EstimatedParameter, ...]
    channels: tuple[str, ...]
    record: str
    sample_time: float
    torque_unit: str
    measured: FloatArray
    predicted: FloatArray
    borders: tuple[int, int]
    relative_error: float
    filtered_error: float
    rows: int
    conditioning: Conditioning | None
    initial: Initial | None
    filtering: Filtering
    trace: tuple[Iteration, ...]
    simulations: int
    stop: str
    converged: bool
    intervals: str
    warnings: tuple[str, ...] = field(default=())
    fingerprint: str = ""
    delay: float = 0.0
    correlation: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    tests: tuple[ChiSquareTest, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    known: Identifiability | None = None
    residuals: ResidualReport | None = None
    bounds: tuple[StiffnessBound, ...] = ()
    resampled: Resampled | None = None
    effects: tuple[Effect, ...] = ()
    compared: Literal["torque", "position"] = "torque"

    def total(self, names: Sequence[str]) -> tuple[float, float]:
        """Return a sum of parameters, by name or symbol, and its standard deviation, with their correlation."""
        free = [p.name for p in self.parameters if p.free]
        found = [self[name] for name in names]
        uncertain = [p for p in found if p.std is not None]
        std = np.array([p.std for p in uncertain], dtype=np.float64)
        chosen = [free.index(p.name) for p in uncertain]
        known = max(chosen, default=0) < len(self.correlation)
        together = self.correlation[np.ix_(chosen, chosen)] if known else np.eye(len(chosen))
        total = sum(self.values[p.name] for p in found)
        return total, float(np.sqrt(max(float(std @ together @ std), 0.0)))

    @property
    def identified(self) -> IdentifiedJoint:
        """What of it is needed to predict a torque.

        Raises:
            MethodError: a value is refused, without which no torque can be predicted.
        """
        refused = [p.name for p in self.parameters if p.of_joint and p.value is None]
        if refused:
            raise MethodError(
                f"{', '.join(refused)} cannot be told from this record, so this estimate predicts no torque; identify "
                "the joint as rigid."
            )
        law = "" if self.loop is None else law_fingerprint(self.loop)
        found, filtering = self.values, self.filtering
        return IdentifiedJoint(
            self.method, self.joint, self.loop, found, filtering, self.delay, self.record, self.fingerprint, law,
            self.effects,
        )  # fmt: skip

    @property
    def values(self) -> dict[str, float]:
        """The parameters of joint and effects by name, fixed ones included; a refused one is missing."""
        return {p.name: p.value for p in self.parameters if p.of_joint and p.value is not None}

    @property
    def iterations(self) -> int:
        """How many steps were taken."""
        return max(len(self.trace) - 1, 0)

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Return a parameter by its name or symbol."""
        for parameter in self.parameters:
            if name in (parameter.name, parameter.symbol):
                return parameter
        raise KeyError(name)

    def __str__(self) -> str:
        """Return the table, with method, residual and warnings."""
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        lines = [
            f"{self.joint.model.capitalize()} joint, {self.variant}, of {self.record}",
            f"read: {', '.join(self.channels)}",
            *resampled_lines(self.resampled),
            *transmission_lines(self.joint.transmission),
            "",
            self._table(),
            "",
            f"{self.compared} error".ljust(13) + f" {100 * self.relative_error:.4f} % raw ({left_out}), "
            f"{100 * self.filtered_error:.4f} % filtered ({self.rows} rows)",
        ]
        if self.conditioning is not None:
            c = self.conditioning
            lines.append(
                f"conditioning  {c.raw:.6g} raw, {c.normalised:.4g} normalised, {c.scaled:.4g} scaled by the parameters"
            )
        if self.simulations:
            lines.append(f"effort        {self.iterations} iterations, {self.simulations} simulations")
        lines += [f"stopped       {self.stop}", f"intervals     {self.intervals}"]
        if self.known is not None and self.known.physical:
            lines += ["", "known together", *self._known_together(self.known.physical)]
        if self.bounds:
            lines += ["", "K12 is at least, by the load's share of the inertia (95 %, lightly damped mode)"]
            lines += [bound_line(bound, self["stiffness"].unit, self.other) for bound in self.bounds]
        if self.verdicts:
            lines += ["", "verdicts", *map(str, self.verdicts), ""]
        lines += [f"test          {test.name}: {test.sentence}" for test in self.tests]
        lines += [f"warning       {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def _table(self) -> str:
        """Return the table of the parameters; with a transmission, beside what they are on its other side."""
        header, right = (
            ("symbol", "parameter", "value", "2 sigma", "sigma %", "unit"),
            (False, False, *[True] * 3, False),
        )
        rows = [parameter_row(p) for p in self.parameters]
        if self.other is None:
            return aligned(header, rows, right)
        there = [(shown(p), p.unit) for p in self.other_side]
        wider = [(*row, *cells) for row, cells in zip(rows, there, strict=True)]
        return aligned((*header, f"{self.other.side} side", "unit"), wider, (*right, True, False))

    def _known_together(self, physical: Sequence[Known]) -> list[str]:
        """Return a line for each combination."""
        there = known_on_other_side(physical, self.other) or (None,) * len(physical)
        return [known_line(known, other, self.other) for known, other in zip(physical, there, strict=True)]


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
