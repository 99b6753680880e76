"""The answer of a long record: one joint for all of it, each of its stretches beside it, and whether it drifts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import aligned, number
from jointid.estimation.result.estimate import IdentifiedJoint, law_fingerprint
from jointid.estimation.result.estimated import EstimatedParameter, OnBothSides, known_on_other_side
from jointid.estimation.result.table_rows import known_line, parameter_row
from jointid.estimation.streaming.segments import Drift, Stretch
from jointid.models.joints import Joint
from jointid.models.transmission import transmission_lines
from jointid.records.signals import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.position_dependent_error import Repeatable

_SHOWN = 2.0  # deviations that a trend has at least to be printed as one


@dataclass(frozen=True, slots=True, eq=False)
class LongEstimate(OnBothSides):
    """What a long record says of a joint.

    Attributes:
        joint: the model. loop: joint and controller, as declared, or with what was identified of it.
        torque_unit: of the torque.
        parameters: of the joint, then what else was free; those are means over the record, where it drifts.
        correlation: of the errors of the free parameters, in their order.
        known: which parameters and combinations the record tells, and how well.
        repeatable: what of the residual repeats with the motion.
        drift: what its stretches say by themselves, and whether they agree.
        record: its name. channels: that were read. sample_time: of them, seconds.
        window, settling: seconds that count in a window, and that are simulated on each side of it and do not.
        windows: that were counted. still: in which nothing was asked of the axis, and which were left out.
        duration: seconds from the first to the last row that counts.
        rows: filtered samples that were fitted.
        filtered_error: what is left of the filtered torque; a ratio.
        filtering: as used, defaults filled in.
        at_limit: share of the controller's periods at its limit.
        passes: over the whole record. simulations: of windows, with derivatives.
        stop: why it ended, in a sentence; converged: whether that is a good end.
        interrupted: whether the last pass was, and the answer is of the record's beginning.
        intervals: what the deviations are, in a sentence.
        warnings: what the reader must know, one sentence each.
    """

    joint: Joint
    loop: ClosedLoop
    torque_unit: str
    parameters: tuple[EstimatedParameter, ...]
    correlation: FloatArray
    known: Identifiability
    repeatable: Repeatable
    drift: Drift
    record: str
    channels: tuple[str, ...]
    sample_time: float
    window: float
    settling: float
    windows: int
    still: int
    duration: float
    rows: int
    filtered_error: float
    filtering: Filtering
    at_limit: float
    passes: int
    simulations: int
    stop: str
    converged: bool
    interrupted: bool
    intervals: str
    warnings: tuple[str, ...] = field(default=())

    @property
    def values(self) -> dict[str, float]:
        """The parameters of the joint by name, fixed ones included."""
        return {p.name: p.value for p in self.parameters if p.of_joint and p.value is not None}

    @property
    def identified(self) -> IdentifiedJoint:
        """What of it is needed to predict a torque, of another record, say."""
        delay = self.loop.controller.law(self.sample_time).delay
        return IdentifiedJoint(
            "didim", self.joint, self.loop, self.values, self.filtering, delay, self.record, "",
            law_fingerprint(self.loop),
        )  # fmt: skip

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Return a parameter by its name or symbol."""
        for parameter in self.parameters:
            if name in (parameter.name, parameter.symbol):
                return parameter
        raise KeyError(name)

    def __str__(self) -> str:
        """Return the tables, with the error and the warnings."""
        still = f", {self.still} without motion left out" if self.still else ""
        lines = [
            f"{self.joint.model.capitalize()} joint, DIDIM in windows, of {self.record}",
            f"read: {', '.join(self.channels)}",
            *transmission_lines(self.joint.transmission),
            "",
            aligned(
                ("symbol", "parameter", "value", "2 sigma", "sigma %", "unit"),
                [parameter_row(p) for p in self.parameters],
                (False, False, *[True] * 3, False),
            ),
        ]
        if self.known.physical:
            there = known_on_other_side(self.known.physical, self.other) or (None,) * len(self.known.physical)
            lines += ["", "known together"]
            lines += [known_line(k, o, self.other) for k, o in zip(self.known.physical, there, strict=True)]
        if self.drift.stretches:
            lines += [
                "",
                "each stretch by itself, +- 2 sigma to compare them by; what all of them err alike is not in it",
            ]
            lines += [self._stretches()]
        lines += [
            "",
            f"torque error  {100 * self.filtered_error:.4f} % filtered ({self.rows} rows)",
            f"windows       {self.windows} of {self.window:g} s, and {self.settling:g} s at either end{still}; "
            f"{number(self.duration / 3600, 3)} h",
            f"effort        {self.passes} times over the whole, {self.simulations} windows simulated",
            f"stopped       {self.stop}",
            f"intervals     {self.intervals}",
            f"residual      {self.repeatable}",
            f"drift         {self.drift_sentence}",
            *(f"told          {sentence}" for sentence in self.known.sentences),
            *(f"warning       {warning}" for warning in self.warnings),
        ]
        return "\n".join(lines)

    @property
    def drift_sentence(self) -> str:
        """Whether the joint stays what it is, and what of it changes."""
        judged = self.drift.agreement
        if judged is None or judged.p_value is None:
            return "not looked at: the record has too few windows for two stretches"
        count = len(self.drift.stretches)
        if not judged.differs:
            return f"no parameter changes by more than its intervals allow over {count} stretches"
        units = {p.name: p.unit for p in self.parameters}
        trends = {t.name: t for t in self.drift.trends}
        said = []
        for name in self.drift.names:
            t, scatter = trends[name], judged[name]
            line = (
                f", {number(t.per_hour, 3)} +- {number(2 * t.std, 2)} {units[name]} per hour"
                if abs(t.per_hour) > _SHOWN * t.std
                else ", without a trend"
            )
            said.append(f"{name} by {number(scatter.between, 2)} {units[name]} rms (p = {scatter.p_value:.2g}{line})")
        listed = "; ".join(said) or "none by itself, all of them together"
        return f"between {count} stretches parameters change by more than their intervals allow: {listed}"

    def _stretches(self) -> str:
        """Return the table of the stretches: each parameter of the joint, with two deviations."""
        shown = [p for p in self.parameters if p.free]
        header = ("from h", "to h", *(f"{p.symbol} {p.unit}" for p in shown), "error %")
        rows = [self._stretch(s, [p.name for p in shown]) for s in self.drift.stretches]
        return aligned(header, rows, tuple(np.ones(len(header), dtype=bool)))

    @staticmethod
    def _stretch(s: Stretch, names: list[str]) -> tuple[str, ...]:
        told = {n: f"{number(s.values[n], 4)} +- {number(2 * s.std[n], 2)}" for n in s.values}
        cells = (told.get(n, "not told") for n in names)
        return f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}", *cells, f"{100 * s.filtered_error:.2f}"
