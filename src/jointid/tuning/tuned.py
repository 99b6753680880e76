"""Result of tuning, with tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import (
    BAND,
    ERROR,
    LEVEL,
    LOAD,
    MEASURED,
    OTHERS,
    SIMULATED,
    Charted,
    panels,
)
from jointid.common.document import (
    Block,
    Code,
    Document,
    Documented,
    Facts,
    Paragraph,
    Table,
    common_facts,
)
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.models.controllers import CONTROLLER_UNITS, Cascade, Controller, Notch, in_torque
from jointid.models.controllers.drive_numbers import name_in_words
from jointid.models.linear import ComplexArray
from jointid.tuning.margins import Margins
from jointid.tuning.proposals import FeedForward, Tuning

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SMALLEST = 1e-3  # loop gain that is shown
_REACH = 2.5  # of the Nyquist plot, about its origin
_FAR = 3.0  # times a gain: a larger change is set in steps


@dataclass(frozen=True, slots=True, eq=False)
class ResponseBand:
    """A response over an interval of joints.

    Attributes:
        hertz: (frequencies,). nominal: (frequencies,) of the estimate.
        size: (2, frequencies) its smallest and largest size. phase: (2, frequencies) likewise, rad, without jumps.
    """

    hertz: FloatArray
    nominal: ComplexArray
    size: FloatArray
    phase: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopMargins:
    """A loop and its margins.

    Attributes:
        controller: its law. estimate: margins at the estimate. worst: each the smallest over the interval.
        crossover: Hz, the highest frequency at which the loop's gain is 1, over the interval.
        response: of the loop cut open at the torque.
    """

    controller: Controller
    estimate: Margins
    worst: Margins
    crossover: float
    response: ResponseBand


@dataclass(frozen=True, slots=True)
class Gain:
    """A gain of the controller.

    Attributes:
        key: its name in a joint file's [controller]. formula: that gave it. unit: of the law's own numbers.
        before, after: in that unit, on the law's side.
        in_drive: its name, before, after and unit as the drive shows them; the same where it shows nothing else.
    """

    key: str
    formula: str
    unit: str
    before: float
    after: float
    in_drive: tuple[str, float, float, str]


@dataclass(frozen=True, slots=True)
class ProposedNotch:
    """A notch that allows a stiffer loop.

    Attributes:
        notch: its frequency and bandwidth in Hz, and depth.
        numerator, denominator: of the digital filter in powers of 1/z, at `period` seconds.
    """

    notch: Notch
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    period: float


@dataclass(frozen=True, slots=True, eq=False)
class Tuned(Charted, Documented):
    """Margins over an estimate's interval, and proposed gains.

    Attributes:
        record: its name. model: "rigid" or "flexible". transmission: on whose `side` the joint is.
        settings: what was asked. interval: over which joints the worst is taken, in a sentence.
        present: the loop as it is. proposed: with other gains; None where none can be proposed.
        gains, notch: that are proposed. feedforward: in SI and in the drive's units.
        joint: response of the motor's velocity to the torque, in continuous time.
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
    notch: ProposedNotch | None
    feedforward: tuple[FeedForward, ...]
    joint: ResponseBand
    position_unit: str
    torque_unit: str
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence of the gains to set and of the margin nearest to its requirement."""
        present, asked = self.present.worst, self.settings
        cascade = isinstance(self.present.controller, Cascade)
        gains = [
            f"{name_in_words(name, cascade=cascade)} from {number(before, 4)} to {number(after, 4)} {unit}".rstrip()
            for name, before, after, unit in (gain.in_drive for gain in self.gains)
        ]
        if self.notch is not None:
            gains.append(f"a notch at {number(self.notch.notch.frequency, 3)} Hz")
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
        far = any(
            not 1 / _FAR <= after / before <= _FAR for _, before, after, _ in (g.in_drive for g in self.gains) if before
        )
        steps = " Set the gains in steps: a lag of the drive that is not declared is in no margin." if far else ""
        return f"{advice}: in the worst case the {name} margin {margin}{unit} ({least} required).{steps}"

    def to_document(self, *, details: bool = False) -> Document:
        """Tables before and after, with notes."""
        del details
        worst = ("worst case over", self.interval)
        joint = ("joint", f"{self.model}, of {self.record}")
        blocks: list[Block] = [Facts((joint, worst, *common_facts(None, self.transmission))), *self.proposal()]
        blocks.append(self._feedforward())
        units = [f.in_drive[-1] for f in self.feedforward] + [g.in_drive[-1] for g in self.gains]
        if any(CONTROLLER_UNITS in one for one in units):
            gain = number(getattr(self.present.controller, "gain", 1.0))
            said = f"one of the {CONTROLLER_UNITS} is {gain} {self.torque_unit} (gain of [controller])"
            blocks.append(Paragraph(said))
        notes = Facts(tuple(("note", note) for note in self.notes))
        return Document(self.sentence, (*blocks, notes))

    def proposal(self) -> tuple[Block, ...]:
        """Present and proposed margins, gains and notch."""
        gains = (self._gains(),) if self.gains else ()
        return self._margins(), *gains, *(() if self.notch is None else (_notch(self.notch),))

    def draw(self) -> Figure:
        """Draw joint response, open loop and Nyquist diagram.

        Bands show the interval of the estimate; the circle about -1 is the required distance.
        """
        figure, (response, nyquist, gain, phase) = panels([325] * 4, 2)
        _draw_size(response, self.joint, LOAD)
        title = f"{self.record}: the {self.model} joint"
        velocity = f"motor velocity per torque [{self.position_unit}/s per {self.torque_unit}]"
        response.set(xlabel="frequency [Hz]", ylabel=velocity, title=title, xscale="log", yscale="log")
        loops = [("as it is", self.present, MEASURED)]
        loops += [("proposed", self.proposed, SIMULATED)] if self.proposed is not None else []
        for name, loop, colour in loops:
            found = loop.response
            _draw_size(gain, found, colour, name)
            turned = np.unwrap(np.angle(found.nominal))
            # As its band is: whole turns are no part of a phase.
            turns = np.round((0.5 * (found.phase[0, 0] + found.phase[1, 0]) - turned[0]) / (2 * math.pi))
            low, high = np.degrees(found.phase)
            phase.fill_between(found.hertz, low, high, color=colour, **BAND)
            phase.plot(found.hertz, np.degrees(turned + 2 * math.pi * turns), color=colour)
            nyquist.plot(found.nominal.real, found.nominal.imag, color=colour)
        angle, modulus, reach = np.linspace(0, 2 * math.pi, 200), self.settings.modulus, 0.5 * (_REACH + 1)
        nyquist.plot(-1 + modulus * np.cos(angle), modulus * np.sin(angle), color=OTHERS[-1], linewidth=0.75)
        nyquist.plot([-1.0], [0.0], color=ERROR, marker="o", label=f"-1, distance {modulus:g}")
        nyquist.set(xlabel="real part of the loop [1]", ylabel="imaginary part of the loop [1]")
        nyquist.set(xlim=(-_REACH, 1.0), ylim=(-reach, reach), aspect="equal")
        gain.axhline(1.0, **LEVEL)
        gain.set(xlabel="frequency [Hz]", ylabel="loop gain [1]", xscale="log", yscale="log")
        gain.set_ylim(_SMALLEST, 2 * max(float(loop.response.size.max()) for _, loop, _ in loops))
        phase.axhline(-180.0, **LEVEL)
        phase.set(xlabel="frequency [Hz]", ylabel="loop phase [degrees]", xscale="log")
        return figure

    def _margins(self) -> Table:
        header = ("margins", "gain", "dB", "reduction", "phase deg", "delay ms", "distance from -1", "crossover Hz")
        rows = [
            _row("as it is, at the estimate", self.present.estimate),
            _row("as it is, worst case", self.present.worst, self.present),
        ]
        if self.proposed is not None:
            rows.append(_row("proposed, at the estimate", self.proposed.estimate))
            rows.append(_row("proposed, worst case", self.proposed.worst, self.proposed))
            asked = self.settings
            rows.append(
                ("required", number(asked.gain_margin, 3), f"{20 * math.log10(asked.gain_margin):.1f}",
                 number(asked.gain_margin, 3), number(asked.phase_margin, 3), "-", number(asked.modulus, 3), "-")
            )  # fmt: skip
        return Table(header, tuple(rows))

    def _gains(self) -> Table:
        shown = [gain.in_drive for gain in self.gains]
        scale = getattr(self.present.controller, "gain", 1.0)
        si = []
        for g, (_, _, after, _) in zip(self.gains, shown, strict=True):
            by, unit = (scale, in_torque(g.unit, self.torque_unit)) if CONTROLLER_UNITS in g.unit else (1.0, g.unit)
            text = f"{g.key} {number(by * g.before)}, {number(by * g.after)} {unit}"
            si.append("" if number(g.after) == number(after) else text)
        beside = any(si)  # what is simulated, where the drive shows another number
        rows = tuple(
            (name, number(before), number(after), unit, *((plain or "as shown",) if beside else ()), gain.formula)
            for gain, plain, (name, before, after, unit) in zip(self.gains, si, shown, strict=True)
        )
        header = ("gain", "now", "proposed", "unit", *(("in SI",) if beside else ()), "formula")
        return Table(header, rows, words=(0, *range(3, len(header))))

    def _feedforward(self) -> Table:
        drive = any(f.drive is not None for f in self.feedforward)
        rows = []
        for f in self.feedforward:
            before, after, std, unit = f.in_drive
            in_counts = (number(f.drive), f.drive_unit) if drive else ()
            beside = number(before), number(after), _two_sigma(std), unit
            rows.append((f.key, f"{f.formula} = {number(f.value)}", _two_sigma(f.std), f.unit, *beside, *in_counts))
        header = (
            "feed-forward", "in SI", "2 sigma", "unit", "now", "proposed", "2 sigma", "unit",
            *(("drive", "unit") if drive else ()),
        )  # fmt: skip
        return Table(header, tuple(rows), words=(0, 3, 7, 9))


def _draw_size(axes: Axes, found: ResponseBand, colour: str, name: str = "") -> None:
    axes.fill_between(found.hertz, found.size[0], found.size[1], color=colour, **BAND)
    axes.plot(found.hertz, np.abs(found.nominal), color=colour, label=name or None)


def _row(name: str, margins: Margins, loop: LoopMargins | None = None) -> tuple[str, ...]:
    if not margins.stable:
        return (name, "not stable", *("-",) * 6)
    decibel = "any" if math.isinf(margins.gain) else f"{20 * math.log10(margins.gain):.1f}"
    return (
        name, _size(margins.gain), decibel, _size(margins.reduction), _size(math.degrees(margins.phase)),
        _size(1e3 * margins.delay), number(margins.modulus, 3), "-" if loop is None else number(loop.crossover, 3),
    )  # fmt: skip


def _size(value: float) -> str:
    return "any" if math.isinf(value) else number(value, 3)


def _two_sigma(std: float | None) -> str:
    return "fixed" if std is None else number(2 * std, 2)


def _notch(found: ProposedNotch) -> Code:
    one = found.notch

    def join_numbers(values: tuple[float, ...]) -> str:
        return ", ".join(f"{value:.10g}" for value in values)

    at = f"at {found.period:g} s:"
    caption = (
        f"notch of the torque: {number(one.frequency, 4)} Hz, {number(one.bandwidth, 4)} Hz wide, "
        f"{number(one.depth, 2)} left at its centre"
    )
    return Code(
        "    H(s) = (s^2 + depth b s + w^2) / (s^2 + b s + w^2), w = 2 pi frequency, b = 2 pi bandwidth, bilinear\n"
        f"    {at} numerator {join_numbers(found.numerator)}\n"
        f"    {'':{len(at)}} denominator {join_numbers(found.denominator)}",
        caption,
    )
