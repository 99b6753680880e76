"""Result of tuning, with tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import LEVEL, MEASURED, SIMULATED, panels, styled
from jointid.common.document import Block, Document, Documented, Facts, Paragraph, Table, common_facts
from jointid.common.text import in_words, join, number
from jointid.common.transmission import Transmission
from jointid.models.controllers import Controller, Notch
from jointid.models.linear import ComplexArray
from jointid.tuning.margins import Margins
from jointid.tuning.proposals import Gain, Tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALLEST = 1e-3  # loop gain that is shown


@dataclass(frozen=True, slots=True, eq=False)
class LoopMargins:
    """A loop and its margins.

    Attributes:
        controller: its law. estimate: margins at the estimate. worst: each the smallest over the interval.
        crossover: Hz, the highest frequency at which the loop's gain is 1, over the interval.
        hertz, response: (frequencies,) of the loop cut open at the torque, at the estimate.
    """

    controller: Controller
    estimate: Margins
    worst: Margins
    crossover: float
    hertz: FloatArray
    response: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class Tuned(Documented):
    """Margins over an estimate's interval, and proposed gains.

    Attributes:
        record: its name. model: "rigid" or "flexible". transmission: on whose `side` the joint is.
        settings: what was asked. interval: over which joints the worst is taken, in a sentence.
        present: the loop as it is. proposed: with other gains; None where none can be proposed.
        gains: that are proposed. notch: that is proposed with them, if one is.
        feedforward: of the reference.
        notes: what the reader must know, a sentence each.
        doubts: why joint or loop may be others, a clause each.
    """

    record: str
    model: str
    transmission: Transmission | None
    settings: Tuning
    interval: str
    present: LoopMargins
    proposed: LoopMargins | None
    gains: tuple[Gain, ...]
    notch: Notch | None
    feedforward: tuple[Gain, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence of the gains to set and of the margin nearest to its requirement."""
        present, asked = self.present.worst, self.settings
        gains = [f"{in_words(g.key)} from {number(g.before, 4)} to {number(g.after, 4)} {g.unit}" for g in self.gains]
        if self.notch is not None:
            gains.append(f"a notch at {number(self.notch.frequency, 3)} Hz")
        beware = f"Beware: {join(self.doubts)}. " if self.doubts else ""
        advice = f"{beware}Set {join(gains)}" if gains else f"{beware}No gains are proposed"
        if not present.stable:
            return f"{advice}: in the worst case of the estimate's interval the present loop is not stable."
        required = {"gain": asked.gain_margin, "phase": math.radians(asked.phase_margin), "modulus": asked.modulus}
        name = min(required, key=lambda one: getattr(present, one) / required[one])
        unit, degree = (" degrees", math.degrees(1.0)) if name == "phase" else ("", 1.0)
        margin, least = (number(degree * one, 3) for one in (getattr(present, name), required[name]))
        moved = f"is {margin}"
        if self.proposed is not None:
            moved = f"goes from {margin} to {number(degree * getattr(self.proposed.worst, name), 3)}"
        return f"{advice}: in the worst case the {name} margin {moved}{unit} ({least} required)."

    def to_document(self, *, details: bool = False) -> Document:
        """Tables before and after, with notes."""
        del details
        joint, worst = ("joint", f"{self.model}, of {self.record}"), ("worst case over", self.interval)
        blocks: list[Block] = [Facts((joint, worst, *common_facts(None, self.transmission))), *self.proposal()]
        blocks.append(_tabulate("feed-forward", self.feedforward))
        return Document(self.sentence, (*blocks, Facts(tuple(("note", note) for note in self.notes))))

    def proposal(self) -> tuple[Block, ...]:
        """Present and proposed margins, gains and notch."""
        blocks: list[Block] = [self._tabulate_margins(), *([_tabulate("gain", self.gains)] if self.gains else [])]
        if (notch := self.notch) is not None:
            sizes = number(notch.frequency, 4), number(notch.bandwidth, 4), number(notch.depth, 2)
            blocks.append(Paragraph("notch of the torque: {} Hz, {} Hz wide, {} left at its centre".format(*sizes)))
        return tuple(blocks)

    @styled
    def plot(self) -> Figure:
        """Draw the open loops at the estimate."""
        figure, (gain, phase) = panels([325] * 2, title=f"{self.record}: the {self.model} joint")
        loops = [("as it is", self.present, MEASURED)]
        loops += [("proposed", self.proposed, SIMULATED)] if self.proposed is not None else []
        for name, loop, colour in loops:
            gain.plot(loop.hertz, np.abs(loop.response), color=colour, label=name)
            phase.plot(loop.hertz, np.degrees(np.unwrap(np.angle(loop.response))), color=colour)
        gain.axhline(1.0, **LEVEL)
        gain.set(xlabel="frequency [Hz]", ylabel="loop gain [1]", xscale="log", yscale="log")
        gain.set_ylim(_SMALLEST, 2 * max(float(np.abs(loop.response).max()) for _, loop, _ in loops))
        phase.axhline(-180.0, **LEVEL)
        phase.set(xlabel="frequency [Hz]", ylabel="loop phase [degrees]", xscale="log")
        return figure

    def _tabulate_margins(self) -> Table:
        header = ("margins", "gain", "reduction", "phase deg", "delay ms", "distance from -1", "crossover Hz")
        rows = []
        for name, loop in (("as it is", self.present), ("proposed", self.proposed)):
            if loop is not None:
                rows.append((f"{name}, at the estimate", *_write_margins(loop.estimate), "-"))
                rows.append((f"{name}, worst case", *_write_margins(loop.worst), number(loop.crossover, 3)))
        asked = self.settings.asked
        rows.append(("required", *_write_margins(Margins(*asked))[:3], "-", number(asked[-1], 3), "-"))
        return Table(header, tuple(rows))


def _write_margins(margins: Margins) -> tuple[str, ...]:
    """Return gain, reduction, phase, delay and distance."""
    if not margins.stable:
        return ("not stable", *("-",) * 4)
    sizes = margins.gain, margins.reduction, math.degrees(margins.phase), 1e3 * margins.delay, margins.modulus
    return tuple("any" if math.isinf(size) else number(size, 3) for size in sizes)


def _tabulate(title: str, gains: tuple[Gain, ...]) -> Table:
    """Return gains or feed-forwards as a table."""
    rows = []
    for one in gains:
        spread = "-" if one.std is None else number(2 * one.std, 2)
        rows.append((one.key, number(one.before), number(one.after), spread, one.unit, one.formula))
    return Table((title, "now", "proposed", "2 sigma", "unit", "formula"), tuple(rows), words=(0, 4, 5))
