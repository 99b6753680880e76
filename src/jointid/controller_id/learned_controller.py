"""A controller learned from a record, and its document."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from jointid.common.arrays import FloatArray
from jointid.common.document import (
    Block,
    Document,
    Documented,
    Facts,
    Listing,
    Paragraph,
    Table,
    common_facts,
)
from jointid.common.messages import Message
from jointid.common.text import join, number, pluralise, sentence
from jointid.common.transmission import Transmission
from jointid.controller_id.limitations import LimitationCode
from jointid.controller_id.structures import Structure
from jointid.models.controllers import CONTROLLER_UNITS, Cascade, Controller, in_torque
from jointid.models.controllers.drive_numbers import DriveNumber, name_in_words
from jointid.records.record import Resampled

_TUNED = ("_gain", "integral_time", "derivative_time")  # what the names of gains and their times end with


@dataclass(frozen=True, slots=True)
class LearnedNumber:
    """One number of the law.

    Attributes:
        name: as `jointid.models.controllers.numbers_of` has it; "integral" is what an integral holds at the first
            sample, in controller units.
        value: in the law's units.
        std: standard deviation, if this law is the drive's.
        unit: of the value; "" for a number without.
        lower, upper: ends of the interval: 2 deviations either way, in this law and in all that the record does not
            distinguish from it and that have the same number.
    """

    name: str
    value: float
    std: float
    unit: str = ""
    lower: float = math.nan
    upper: float = math.nan

    @property
    def spread(self) -> float:
        """Distance from the value to the further end of its interval."""
        return max(self.upper - self.value, self.value - self.lower)


@dataclass(frozen=True, slots=True)
class Alternative:
    """A structure that was compared with the chosen one.

    Attributes:
        controller: with the numbers that fit best.
        worse: difference of the criterion (Schwarz's); above 10 the chosen one is as good as certain.
        apart: rms difference of the two torques, as a share of the torque's rms.
        alike: True if the record does not distinguish it from the chosen one.
    """

    structure: Structure
    controller: Controller
    worse: float
    apart: float
    alike: bool


@dataclass(frozen=True, slots=True, eq=False)
class LearnedController(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        structure: of the law; its text is the description.
        numbers: those that were learned.
        correlation: of their errors, in that order.
        alternatives: other structures, the likeliest first.
        limitations: what the record leaves open about the law, by `LimitationCode`.
        rms: of the residual, in the torque's unit. share: of the torque's rms.
        torque_noise: standard deviation of the torque's error, in its unit. position_noise: of the position's.
        band: highest informative frequency (the torque exceeds the noise there), Hz.
        residual: (samples,) logged less predicted torque, 0 in the samples that are left out.
        torque_unit, position_unit: of the record.
        record: name of it.
        transmission: between the motor and the units of the law, None where there is none.
        resampled: how the record's samples were brought to a uniform clock, None where they were logged so.
        in_drive: the numbers as the drive shows them, beside what was declared; see `beside`.
        regression_share: of the torque's rms, what a plain regression on reference and position leaves of it.
    """

    controller: Controller
    structure: Structure
    numbers: tuple[LearnedNumber, ...]
    correlation: FloatArray
    alternatives: tuple[Alternative, ...]
    limitations: tuple[Message, ...]
    rms: float
    share: float
    torque_noise: float
    position_noise: float
    band: float
    residual: FloatArray
    torque_unit: str
    position_unit: str
    record: str
    transmission: Transmission | None
    resampled: Resampled | None = None
    in_drive: tuple[NumberInDrive, ...] = ()
    regression_share: float = math.nan

    def beside(self, shown: Iterable[DriveNumber]) -> LearnedController:
        """Add the numbers as the drive shows them; `shown` is what `Axis.drive_numbers` of a file returns."""
        return replace(self, in_drive=numbers_in_drive(self.numbers, shown))

    def __getitem__(self, name: str) -> LearnedNumber:
        """Return a number by its name."""
        for one in self.numbers:
            if one.name == name:
                return one
        raise KeyError(name)

    @property
    def alike(self) -> tuple[Alternative, ...]:
        """Structures that the record does not distinguish from the chosen one."""
        return tuple(one for one in self.alternatives if one.alike)

    @property
    def interrupted(self) -> bool:
        """Whether the search was interrupted."""
        return any(one.code is LimitationCode.INTERRUPTED for one in self.limitations)

    @property
    def another_law(self) -> bool:
        """Whether a plain regression is so much better as to exclude this law."""
        return any(one.code is LimitationCode.ANOTHER_LAW for one in self.limitations)

    def _others(self) -> Iterator[Block]:
        """Yield the indistinguishable laws and the number of rejected ones."""
        if self.alike:
            yield Paragraph("Laws that the record does not distinguish from it, and by how much their torque differs:")
            yield Listing(tuple(f"{one.structure}: {100 * one.apart:.2g} %" for one in self.alike))
        others = [one for one in self.alternatives if not one.alike]
        if others:
            near = min(others, key=lambda one: one.apart)
            yield Paragraph(
                f"{pluralise(len(others), 'other law')} {'was' if len(others) == 1 else 'were'} tried and ruled out; "
                f"the nearest is {near.structure}, whose torque differs by {100 * near.apart:.2g} %."
            )

    @property
    def sentence(self) -> str:
        """The law, and how well it gives the torque."""
        if self.another_law:
            return next(str(one) for one in self.limitations if one.code is LimitationCode.ANOTHER_LAW)
        shown = [(one.name, one.value, one.unit) for one in self.in_drive]
        shown = shown or [(n.name, by * n.value, unit) for n in self.numbers for by, unit in (self._in_si(n),)]
        cascade = isinstance(self.controller, Cascade)
        gains = [
            f"{name_in_words(name, cascade=cascade)} {number(value, 4)} {unit}".rstrip()
            for name, value, unit in shown
            if name.endswith(_TUNED)
        ]
        found = f"the controller is {self.structure}, and leaves {100 * self.share:.2g} % of the torque."
        said = sentence(f"{join(gains)}: {found}" if gains else found)
        if self.alike:
            said += f" The record does not distinguish it from {pluralise(len(self.alike), 'other structure')}."
        return said

    def _in_si(self, n: LearnedNumber) -> tuple[float, str]:
        """Return the factor to SI and the unit there."""
        if CONTROLLER_UNITS not in n.unit:
            return 1.0, n.unit
        return getattr(self.controller, "gain", 1.0), in_torque(n.unit, self.torque_unit)

    def to_document(self, *, details: bool = False) -> Document:
        """Numbers, other structures and limitations."""
        del details
        facts = common_facts(self.resampled, None)
        noise = (
            f"; noise of the torque {number(self.torque_noise, 2)} {self.torque_unit}, of the position "
            f"{number(self.position_noise, 2)} {self.position_unit}"
        )
        residual = (
            f"residual {number(self.rms, 3)} {self.torque_unit} rms, {100 * self.share:.2g} % of the torque"
            f"{'' if self.another_law else noise}; informative up to {number(self.band, 3)} Hz"
        )
        elsewhere = (LimitationCode.INDISTINGUISHABLE, LimitationCode.ANOTHER_LAW)
        left_open = [one for one in self.limitations if one.code not in elsewhere]
        gain, rows = getattr(self.controller, "gain", 1.0), []
        explanation = "± is 2 deviations"
        if self.alike:
            others = pluralise(len(self.alike), "other law")
            explanation += f"; it spans {others} that the record does not distinguish from this one"
        if gain != 1.0:
            explanation += f"; [controller] has gain = {number(gain)} {self.torque_unit}"
        for n in self.numbers:
            factor, unit = self._in_si(n)
            percent = number(100 * n.spread / abs(n.value), 2) if n.value else "-"
            rows.append((n.name, number(factor * n.value, 6), number(factor * n.spread, 2), unit, percent))
        blocks: list[Block] = [
            Facts(
                (("record", self.record), *(([("nearest", str(self.structure))]) if self.another_law else []), *facts)
            ),
            *([drive_table(self.in_drive)] if self.in_drive else []),
            Table(("parameter in SI", "value", "±", "unit", "%"), tuple(rows), words=(0, 3)),
            Paragraph(explanation),
            Paragraph(residual),
            *self._others(),
            Listing(tuple(map(str, left_open))),
        ]
        return Document(self.sentence, tuple(blocks))


@dataclass(frozen=True, slots=True)
class NumberInDrive:
    """One learned number in the drive's unit.

    Attributes:
        name: of it in the drive, as integral_time for an integral gain.
        value: in the drive's unit.
        declared: what the joint file says, in that unit; None where it says nothing.
    """

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    declared: float | None = None

    @property
    def spread(self) -> float:
        """Distance from the value to the further end of its interval."""
        return max(self.upper - self.value, self.value - self.lower)

    @property
    def difference(self) -> float | None:
        """Relative deviation from the declared value; None if none is declared."""
        return self.value / self.declared - 1.0 if self.declared else None


def numbers_in_drive(learned: Sequence[LearnedNumber], shown: Iterable[DriveNumber]) -> tuple[NumberInDrive, ...]:
    """Convert learned numbers to the drive's; empty if the drive shows them unchanged.

    Args:
        learned: the numbers.
        shown: conversion to the drive's numbers.
    """
    known = {one.number: one for one in shown}
    both = [(one, to) for one in learned if (to := known.get(one.name))]
    if not any(to.tells_more for _, to in both):
        return ()
    found = []
    for one, to in both:
        ends = sorted((to.of(one.lower), to.of(one.upper)))
        if to.inverse and not one.lower > 0:  # the interval of the gain holds 0, that of the time no end
            ends = [to.of(one.upper), math.inf] if one.upper > 0 else [-math.inf, math.inf]
        found.append(NumberInDrive(to.name, to.of(one.value), ends[0], ends[1], to.unit, to.declared))
    return tuple(found)


def drive_table(numbers: tuple[NumberInDrive, ...]) -> Table:
    """Table of the drive's numbers beside the declared ones."""
    compared = any(one.declared is not None for one in numbers)
    header = ("in the drive", "learned", "±", "unit", *(("declared", "differs by") if compared else ()))
    rows = []
    for one in numbers:
        beside: tuple[str, ...] = ()
        if compared:
            differs = "-" if one.difference is None else f"{100 * one.difference:+.2g} %"
            beside = ("-" if one.declared is None else f"{one.declared:.6g}", differs)
        rows.append((one.name, number(one.value, 5), number(one.spread, 2), one.unit, *beside))
    return Table(header, tuple(rows), words=(0, 3))
