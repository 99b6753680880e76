"""The result of tuning, and its tables."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Code, Document, Documented, Facts, Heading, Paragraph, Table, common_facts
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.models.controllers import Controller, Notch
from jointid.models.linear import ComplexArray
from jointid.tuning.feedforward import FeedForward
from jointid.tuning.margins import Margins
from jointid.tuning.minimum_detectable_change import MinimumDetectableChange
from jointid.tuning.proposals import Tuning


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
        key: its name in a joint file's [controller]. formula: that gave it. unit: in the controller's own terms.
        before, after: in that unit, on the law's side.
    """

    key: str
    formula: str
    unit: str
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class ProposedNotch:
    """A notch that lets the loop be stiffer.

    Attributes:
        notch: its frequency and bandwidth in Hz, and depth.
        numerator, denominator: of the digital filter in powers of 1/z, at `period` seconds.
    """

    notch: Notch
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    period: float


@dataclass(frozen=True, slots=True, eq=False)
class Tuned(Documented):
    """Margins over the interval of an estimate, the proposed gains, and the smallest detectable change.

    Attributes:
        record: its name. model: "rigid" or "flexible". transmission: on whose `side` the joint is.
        settings: what was asked. interval: over which joints the worst is taken, in a sentence.
        present: the loop as it is. proposed: with other gains; None where none can be proposed.
        gains, notch: that are proposed. feedforward: in SI and in the drive's units.
        detectable: what change of the joint the same motion would tell.
        joint: response of the motor's velocity to the torque, in continuous time.
        notes: what the reader must know, a sentence each.
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
    detectable: MinimumDetectableChange
    joint: ResponseBand
    position_unit: str
    torque_unit: str
    notes: tuple[str, ...]

    def document(self, *, details: bool = False) -> Document:
        """Return the tables, before and after, and the notes; there are no further details."""
        del details
        worst = ("worst case over", self.interval)
        change = self.detectable.document()
        blocks: list[Block] = [Facts((worst, *common_facts(None, self.transmission))), self._margins()]
        blocks += [self._gains()] if self.gains else []
        blocks += [_notch(self.notch)] if self.notch is not None else []
        said = "now and proposed are in controller units, per unit of the controller's reference"
        blocks += [self._feedforward(), Paragraph(said), Heading(change.title), *change.blocks]
        blocks += [Facts(tuple(("note", note) for note in self.notes))] if self.notes else []
        return Document(f"Tuning for {self.record}, a {self.model} joint", tuple(blocks))

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
        rows = tuple((g.key, number(g.before), number(g.after), g.unit, g.formula) for g in self.gains)
        return Table(("gain", "now", "proposed", "unit", "formula"), rows, words=(0, 3, 4))

    def _feedforward(self) -> Table:
        drive = any(f.drive is not None for f in self.feedforward)
        rows = [
            (
                f.key, f"{f.formula} = {number(f.value)}", _two_sigma(f.std), f.unit, number(f.before), number(f.after),
                _two_sigma(f.after_std), *((number(f.drive), f.drive_unit) if drive else ()),
            )
            for f in self.feedforward
        ]  # fmt: skip
        header = (
            "feed-forward", "in SI", "2 sigma", "unit", "now", "proposed", "2 sigma",
            *(("drive", "unit") if drive else ()),
        )  # fmt: skip
        return Table(header, tuple(rows), words=(0, 3, 8))


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

    def listed(values: tuple[float, ...]) -> str:
        return ", ".join(f"{value:.10g}" for value in values)

    at = f"at {found.period:g} s:"
    caption = (
        f"notch of the torque: {number(one.frequency, 4)} Hz, {number(one.bandwidth, 4)} Hz wide, "
        f"{number(one.depth, 2)} left at its centre"
    )
    return Code(
        "    H(s) = (s^2 + depth b s + w^2) / (s^2 + b s + w^2), w = 2 pi frequency, b = 2 pi bandwidth, bilinear\n"
        f"    {at} numerator {listed(found.numerator)}\n"
        f"    {'':{len(at)}} denominator {listed(found.denominator)}",
        caption,
    )
