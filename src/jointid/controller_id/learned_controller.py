"""A controller learned from a record, and its document."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum, auto

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
from jointid.common.text import in_words, join, number, pluralise, sentence
from jointid.common.transmission import Transmission
from jointid.common.units import per
from jointid.controller_id.structures import Structure
from jointid.models.controllers import CONTROLLER_UNITS, Controller
from jointid.records.record import Resampled


class LimitationCode(StrEnum):
    """Properties of the controller that a record does not determine."""

    LIMIT_NOT_REACHED = auto()
    AS_DECLARED = auto()
    ANOTHER_LAW = auto()


_TUNED = ("_gain", "derivative_time")  # what the names of gains and their times end with


@dataclass(frozen=True, slots=True)
class LearnedNumber:
    """One number of the law.

    Attributes:
        name: as `jointid.models.controllers.numbers_of` has it; "integral" is what an integral
            holds at the first sample, in controller units.
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
    """A structure that the record does not distinguish from the chosen one.

    Attributes:
        controller: with the numbers that fit best.
        worse: difference of the criterion (Schwarz's), at most 10.
        apart: rms difference of the two torques, as a share of the torque's rms.
    """

    structure: Structure
    controller: Controller
    worse: float
    apart: float


@dataclass(frozen=True, slots=True, eq=False)
class LearnedController(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        structure: of the law; its text is the description.
        numbers: those that were learned.
        correlation: of their errors, in that order.
        alternatives: structures that the record does not distinguish from it, the likeliest first.
        limitations: what the record leaves open about the law, by `LimitationCode`.
        rms: of the residual, in the torque's unit. share: of the torque's rms.
        torque_noise: standard deviation of the torque's error, in its unit. position_noise: of the position's.
        band: highest informative frequency (the torque exceeds the noise there), Hz.
        residual: (samples,) logged less predicted torque, 0 in the samples that are left out.
        torque_unit, position_unit: of the record.
        record: name of it.
        transmission: between the motor and the units of the law, None where there is none.
        resampled: how the record's samples were brought to a uniform clock, None where they were logged so.
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

    def __getitem__(self, name: str) -> LearnedNumber:
        """Return a number by its name."""
        for one in self.numbers:
            if one.name == name:
                return one
        raise KeyError(name)

    @property
    def another_law(self) -> bool:
        """Whether a plain regression is so much better as to exclude this law."""
        return any(one.code is LimitationCode.ANOTHER_LAW for one in self.limitations)

    @property
    def sentence(self) -> str:
        """The law, and how well it gives the torque."""
        if self.another_law:
            return next(str(one) for one in self.limitations if one.code is LimitationCode.ANOTHER_LAW)
        gains = [
            f"{in_words(one.name)} {number(one.value, 4)} {one.unit}".rstrip()
            for one in self._in_si()
            if one.name.endswith(_TUNED)
        ]
        found = f"the controller is {self.structure}, and leaves {100 * self.share:.2g} % of the torque."
        said = sentence(f"{join(gains)}: {found}" if gains else found)
        if self.alternatives:
            said += f" The record does not distinguish it from {pluralise(len(self.alternatives), 'other structure')}."
        return said

    def _in_si(self) -> tuple[LearnedNumber, ...]:
        """Return the numbers in SI."""
        gain: float = getattr(self.controller, "gain", 1.0)
        found = list[LearnedNumber]()
        for n in self.numbers:
            scaled = CONTROLLER_UNITS in n.unit
            by, unit = (gain, _in_torque(n.unit, self.torque_unit)) if scaled else (1.0, n.unit)
            found.append(LearnedNumber(n.name, by * n.value, by * n.std, unit, by * n.lower, by * n.upper))
        return tuple(found)

    def to_document(self, *, details: bool = False) -> Document:
        """Numbers, other structures and limitations."""
        del details
        noise = (
            f"; noise of the torque {number(self.torque_noise, 2)} {self.torque_unit}, of the position "
            f"{number(self.position_noise, 2)} {self.position_unit}"
        )
        residual = (
            f"residual {number(self.rms, 3)} {self.torque_unit} rms, {100 * self.share:.2g} % of the torque"
            f"{'' if self.another_law else noise}; informative up to {number(self.band, 3)} Hz"
        )
        left_open = [one for one in self.limitations if one.code is not LimitationCode.ANOTHER_LAW]
        explanation = "± is 2 deviations"
        if self.alternatives:
            others = pluralise(len(self.alternatives), "other law")
            explanation += f"; it spans {others} that the record does not distinguish from this one"
        if (gain := getattr(self.controller, "gain", 1.0)) != 1.0:
            explanation += f"; [controller] has gain = {number(gain)} {self.torque_unit}"
        blocks: list[Block] = [
            Facts((("record", self.record), *common_facts(self.resampled, None))),
            _tabulate("parameter in SI", self._in_si()),
            Paragraph(explanation),
            Paragraph(residual),
        ]
        if self.alternatives:
            blocks += [
                Paragraph("Laws that the record does not distinguish from it, and by how much their torque differs:"),
                Listing(tuple(f"{one.structure}: {100 * one.apart:.2g} %" for one in self.alternatives)),
            ]
        return Document(self.sentence, (*blocks, Listing(tuple(map(str, left_open)))))


def _tabulate(title: str, numbers: tuple[LearnedNumber, ...]) -> Table:
    rows = list[tuple[str, ...]]()
    for one in numbers:
        percent = number(100 * one.spread / abs(one.value), 2) if one.value else "-"
        rows.append((one.name, number(one.value, 6), number(one.spread, 2), one.unit, percent))
    return Table((title, "value", "±", "unit", "%"), tuple(rows), words=(0, 3))


def _in_torque(unit: str, torque_unit: str) -> str:
    """Multiply a unit of `unit_of_number` by the controller's gain: "N s/m"."""
    above, stroke, below = unit.replace(CONTROLLER_UNITS, torque_unit).partition(" per ")
    return per(above, below) if stroke else above
