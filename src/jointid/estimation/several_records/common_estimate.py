"""The answer of several records identified together: what they share, what is each one's own, whether they agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jointid.common.arrays import FloatArray
from jointid.common.text import aligned, number
from jointid.estimation.result.estimated import EstimatedParameter, OnBothSides
from jointid.estimation.result.table_rows import shown
from jointid.estimation.several_records.heterogeneity import Agreement
from jointid.models.joints import Joint
from jointid.models.transmission import transmission_lines
from jointid.records.signals import Filtering
from jointid.records.time_base.uniformity import Resampled, resampled_lines
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.position_dependent_error import Repeatable


@dataclass(frozen=True, slots=True, eq=False)
class RecordShare:
    """One of the records.

    Attributes:
        name: of the record; fingerprint: of its torque.
        loop: joint and controller it was logged under.
        channels: that were read.
        added_inertia: known, on the load, on top of what is shared.
        parameters: those of its own, by their plain names.
        alone: what the record says by itself: everything that is free in it, in the units of the answer and without
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
    parameters: tuple[EstimatedParameter, ...]
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


@dataclass(frozen=True, slots=True, eq=False)
class CommonEstimate(OnBothSides):
    """What several records say of one joint together.

    Attributes:
        joint: the model.
        torque_unit: in which its parameters are: that of the torque that acts.
        parameters: that records share; their deviations are widened where the records disagree.
        records: one by one, with what is their own.
        names: of all free parameters, those of record k as ``name@k``.
        correlation: of their errors, in that order.
        agreement: whether the records, each by itself, agree.
        simulations: that were run, all of them.
        stop: why it ended, in a sentence; converged: whether that is a good end.
        weighting: what the rows were weighted by, in words.
        intervals: what the deviations are, in a sentence.
        warnings: what the reader must know, one sentence each.
    """

    joint: Joint
    torque_unit: str
    parameters: tuple[EstimatedParameter, ...]
    records: tuple[RecordShare, ...]
    names: tuple[str, ...]
    correlation: FloatArray
    agreement: Agreement
    simulations: int
    stop: str
    converged: bool
    weighting: str
    intervals: str
    warnings: tuple[str, ...] = field(default=())

    @property
    def values(self) -> dict[str, float]:
        """The parameters that records share, by name, fixed ones included."""
        return {p.name: p.value for p in self.parameters if p.value is not None}

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Return a parameter by its name or symbol; ``name@2`` is the second record's own."""
        plain, _, which = name.partition("@")
        among = self.records[int(which) - 1].parameters if which else self.parameters
        for parameter in among:
            if plain in (parameter.name, parameter.symbol):
                return parameter
        raise KeyError(name)

    def __str__(self) -> str:
        """Return the tables, with residuals and warnings."""
        lines = [f"{self.joint.model.capitalize()} joint, {len(self.records)} records together, DIDIM by least squares"]
        lines += transmission_lines(self.joint.transmission)
        for k, record in enumerate(self.records, 1):
            unit = next(p.unit for p in self.parameters + record.parameters if p.name.endswith("inertia"))
            more = f", {number(record.added_inertia)} {unit} added to the load" if record.added_inertia else ""
            lines.append(f"record {k}: {record.name}{more}; read: {', '.join(record.channels)}")
            lines += resampled_lines(record.resampled)
        own = [(k, p) for k, record in enumerate(self.records, 1) for p in record.parameters]
        lines += ["", self._shared(), ""]
        lines += [_own(own), ""] if own else []
        lines += [self._residuals(), ""]
        lines += [f"agreement     {self.agreement}", f"effort        {self.simulations} simulations"]
        lines += [f"stopped       {self.stop}", f"weighting     {self.weighting}", f"intervals     {self.intervals}"]
        lines += [f"warning       {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def _shared(self) -> str:
        """Return the table of what is shared, beside what each record says by itself."""
        alone = [{p.name: p for p in record.alone} for record in self.records]
        tests = {p.name: p for p in self.agreement.parameters}
        there: list[tuple[str, ...]] = [(shown(p), p.unit) for p in self.other_side]
        rows = []
        for p, beside in zip(self.parameters, there or [()] * len(self.parameters), strict=True):
            test = tests.get(p.name)
            rows.append(
                (
                    *_cells(p),
                    *(_beside(each.get(p.name)) for each in alone),
                    f"{test.p_value:.2g}" if test else "-",
                    number(test.between, 2) if test else "-",
                    *beside,
                )
            )
        heads = [f"{k} alone" for k in range(1, len(self.records) + 1)]
        more = () if self.other is None else (f"{self.other.side} side", "unit")
        header = ("symbol", "parameter", "value", "2 sigma", "unit", *heads, "p", "between", *more)
        right = (False, False, True, True, False, *(True for _ in heads), True, True, *((True, False) if more else ()))
        return aligned(header, rows, right)

    def _residuals(self) -> str:
        rows = [
            (
                str(k),
                f"{100 * r.relative_error:.4f}",
                f"{100 * r.filtered_error:.4f}",
                f"{100 * r.alone_error:.4f}",
                str(r.rows),
            )
            for k, r in enumerate(self.records, 1)
        ]
        header = ("record", "error % raw", "filtered", "filtered, alone", "rows")
        return aligned(header, rows, (False, True, True, True, True))


def _own(own: list[tuple[int, EstimatedParameter]]) -> str:
    rows = [(str(k), *_cells(p)) for k, p in own]
    header = ("record", "symbol", "parameter", "value", "2 sigma", "unit")
    return aligned(header, rows, (False, False, False, True, True, False))


def _cells(p: EstimatedParameter) -> tuple[str, str, str, str, str]:
    spread = number(2 * p.std, 2) if p.std is not None else "fixed"
    return p.symbol, p.name.replace("_", " "), number(p.value), spread, p.unit


def _beside(p: EstimatedParameter | None) -> str:
    if p is None or p.value is None or p.std is None:
        return "-"
    return f"{number(p.value)} +- {number(2 * p.std, 2)}"
