"""Result of tuning, with tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import ERROR, LEVEL, LOAD, MEASURED, OTHERS, SIMULATED, panels, styled
from jointid.common.document import Block, Code, Document, Documented, Facts, Paragraph, Table, common_facts
from jointid.common.text import in_words, join, number
from jointid.common.transmission import Transmission
from jointid.models.controllers import CONTROLLER_UNITS, Controller, Notch
from jointid.models.linear import ComplexArray
from jointid.tuning.margins import Margins
from jointid.tuning.proposals import FeedForward, Tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALLEST = 1e-3  # loop gain that is shown
_REACH = 2.5  # of the Nyquist plot, about its origin
_FAR = 3.0  # times a gain: a larger change is set in steps


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


@dataclass(frozen=True, slots=True)
class Gain:
    """A gain of the controller.

    Attributes:
        key: its name in a joint file's [controller]. formula: that gave it.
        before, after, unit: in the law's units.
    """

    key: str
    formula: str
    before: float
    after: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Tuned(Documented):
    """Margins over an estimate's interval, and proposed gains.

    Attributes:
        record: its name. model: "rigid" or "flexible". transmission: on whose `side` the joint is.
        settings: what was asked. interval: over which joints the worst is taken, in a sentence.
        present: the loop as it is. proposed: with other gains; None where none can be proposed.
        gains: that are proposed. notch: that is proposed with them, if one is.
        numerator, denominator: of the notch's digital filter in powers of 1/z, at `period` seconds.
        feedforward: in SI and in the drive's units.
        joint: (frequencies,) response of the motor's velocity to the torque, at the frequencies of the present loop.
        notes: what the reader must know, a sentence each.
        doubts: why the loop may be another one than the declared, a clause each.
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
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    period: float
    feedforward: tuple[FeedForward, ...]
    joint: ComplexArray
    position_unit: str
    torque_unit: str
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence of the gains to set and of the margin nearest to its requirement."""
        present, asked = self.present.worst, self.settings
        gains = [
            f"{in_words(gain.key)} from {number(gain.before, 4)} to {number(gain.after, 4)} {gain.unit}"
            for gain in self.gains
        ]
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
        if self.proposed is None:
            margin = f"is {margin}"
        else:
            margin = f"goes from {margin} to {number(degree * getattr(self.proposed.worst, name), 3)}"
        changes = [gain.after / gain.before for gain in self.gains if gain.before]
        far = any(not 1 / _FAR <= change <= _FAR for change in changes)
        steps = " Set the gains in steps: a lag of the drive that is not declared is in no margin." if far else ""
        return f"{advice}: in the worst case the {name} margin {margin}{unit} ({least} required).{steps}"

    def to_document(self, *, details: bool = False) -> Document:
        """Tables before and after, with notes."""
        del details
        joint, worst = ("joint", f"{self.model}, of {self.record}"), ("worst case over", self.interval)
        blocks: list[Block] = [Facts((joint, worst, *common_facts(None, self.transmission))), *self.proposal()]
        blocks.append(self._tabulate_feedforward())
        if any(
            CONTROLLER_UNITS in unit
            for unit in (*(f.shown_in for f in self.feedforward), *(g.unit for g in self.gains))
        ):
            gain = number(getattr(self.present.controller, "gain", 1.0))
            blocks.append(
                Paragraph(f"one of the {CONTROLLER_UNITS} is {gain} {self.torque_unit} (gain of [controller])")
            )
        return Document(self.sentence, (*blocks, Facts(tuple(("note", note) for note in self.notes))))

    def proposal(self) -> tuple[Block, ...]:
        """Present and proposed margins, gains and notch."""
        gains = (self._tabulate_gains(),) if self.gains else ()
        return self._tabulate_margins(), *gains, *(() if self.notch is None else (self._write_notch(self.notch),))

    @styled
    def plot(self) -> Figure:
        """Draw joint response, open loop and Nyquist diagram at the estimate.

        The circle about -1 is the required distance.
        """
        figure, (response, nyquist, gain, phase) = panels([325] * 4, 2)
        response.plot(self.present.hertz, np.abs(self.joint), color=LOAD)
        title = f"{self.record}: the {self.model} joint"
        velocity = f"motor velocity per torque [{self.position_unit}/s per {self.torque_unit}]"
        response.set(xlabel="frequency [Hz]", ylabel=velocity, title=title, xscale="log", yscale="log")
        loops = [("as it is", self.present, MEASURED)]
        loops += [("proposed", self.proposed, SIMULATED)] if self.proposed is not None else []
        for name, loop, colour in loops:
            gain.plot(loop.hertz, np.abs(loop.response), color=colour, label=name)
            phase.plot(loop.hertz, np.degrees(np.unwrap(np.angle(loop.response))), color=colour)
            nyquist.plot(loop.response.real, loop.response.imag, color=colour)
        angle, modulus, reach = np.linspace(0, 2 * math.pi, 200), self.settings.modulus, 0.5 * (_REACH + 1)
        nyquist.plot(-1 + modulus * np.cos(angle), modulus * np.sin(angle), color=OTHERS[-1], linewidth=0.75)
        nyquist.plot([-1.0], [0.0], color=ERROR, marker="o", label=f"-1, distance {modulus:g}")
        nyquist.set(xlabel="real part of the loop [1]", ylabel="imaginary part of the loop [1]")
        nyquist.set(xlim=(-_REACH, 1.0), ylim=(-reach, reach), aspect="equal")
        gain.axhline(1.0, **LEVEL)
        gain.set(xlabel="frequency [Hz]", ylabel="loop gain [1]", xscale="log", yscale="log")
        gain.set_ylim(_SMALLEST, 2 * max(float(np.abs(loop.response).max()) for _, loop, _ in loops))
        phase.axhline(-180.0, **LEVEL)
        phase.set(xlabel="frequency [Hz]", ylabel="loop phase [degrees]", xscale="log")
        return figure

    def _tabulate_margins(self) -> Table:
        header = ("margins", "gain", "dB", "reduction", "phase deg", "delay ms", "distance from -1", "crossover Hz")
        rows = []
        for name, loop in (("as it is", self.present), ("proposed", self.proposed)):
            if loop is not None:
                rows.append((f"{name}, at the estimate", *_write_margins(loop.estimate), "-"))
                rows.append((f"{name}, worst case", *_write_margins(loop.worst), number(loop.crossover, 3)))
        asked = self.settings.asked
        rows.append(("required", *_write_margins(Margins(*asked))[:4], "-", number(asked[-1], 3), "-"))
        return Table(header, tuple(rows))

    def _tabulate_gains(self) -> Table:
        rows = [(gain.key, number(gain.before), number(gain.after), gain.unit, gain.formula) for gain in self.gains]
        return Table(("gain", "now", "proposed", "unit", "formula"), tuple(rows), words=(0, 3, 4))

    def _tabulate_feedforward(self) -> Table:
        rows = []
        for one in self.feedforward:
            shown = number(one.before), number(one.after), _write_interval(one.after_std), one.shown_in
            rows.append((one.key, f"{one.formula} = {number(one.value)}", _write_interval(one.std), one.unit, *shown))
        header = ("feed-forward", "in SI", "2 sigma", "unit", "now", "proposed", "2 sigma", "unit")
        return Table(header, tuple(rows), words=(0, 3, 7))

    def _write_notch(self, notch: Notch) -> Code:
        numerator, denominator = (", ".join(f"{v:.10g}" for v in row) for row in (self.numerator, self.denominator))
        caption = (
            f"notch of the torque: {number(notch.frequency, 4)} Hz, {number(notch.bandwidth, 4)} Hz wide, "
            f"{number(notch.depth, 2)} left at its centre"
        )
        return Code(
            "    H(s) = (s^2 + depth b s + w^2) / (s^2 + b s + w^2), w = 2 pi frequency, b = 2 pi bandwidth, bilinear\n"
            f"    numerator at {self.period:g} s: {numerator}\n    denominator: {denominator}",
            caption,
        )


def _write_margins(margins: Margins) -> tuple[str, ...]:
    """Return gain, gain in dB, reduction, phase, delay and distance."""
    if not margins.stable:
        return ("not stable", *("-",) * 5)
    gain, phase = 20 * math.log10(margins.gain), math.degrees(margins.phase)
    sizes = margins.gain, gain, margins.reduction, phase, 1e3 * margins.delay, margins.modulus
    return tuple("any" if math.isinf(size) else number(size, 3) for size in sizes)


def _write_interval(std: float | None) -> str:
    return "fixed" if std is None else number(2 * std, 2)
