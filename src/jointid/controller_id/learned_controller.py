"""A controller learned from a record, and its document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph, Table, common_facts
from jointid.common.text import in_words, join, number, sentence
from jointid.common.transmission import Transmission
from jointid.common.units import per
from jointid.controller_id.search import Rival
from jointid.controller_id.structures import Structure
from jointid.models.controllers import CONTROLLER_UNITS, Controller
from jointid.records.record import Resampled

_TUNED = ("_gain", "derivative_time")  # what the names of gains and their times end with


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


@dataclass(frozen=True, slots=True, eq=False)
class LearnedController(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        structure: of the law; its text is the description.
        numbers: those that were learned.
        correlation: of their errors, in that order.
        alternatives: structures that the record does not distinguish from it, the likeliest first.
        regression: share of the torque that a plain regression leaves, where that is so little as to exclude the law.
        kept: numbers that are as declared, and not from this record.
        rms: of the residual, in the torque's unit. share: of the torque's rms.
        torque_noise: standard deviation of the torque's error, in its unit. position_noise: of the position's.
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
    alternatives: tuple[Rival, ...]
    regression: float | None
    kept: Mapping[str, float]
    rms: float
    share: float
    torque_noise: float
    position_noise: float
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
    def sentence(self) -> str:
        """The law, and how well it gives the torque."""
        if self.regression is not None:
            return (
                f"The best law of the search, {self.structure}, leaves {100 * self.share:.2g} % of the torque, a "
                f"plain regression {100 * self.regression:.2g} %: the drive's law is another; declare it."
            )
        gains = [
            f"{in_words(one.name)} {number(one.value, 4)} {one.unit}".rstrip()
            for one in self._in_si()
            if one.name.endswith(_TUNED)
        ]
        found = f"the controller is {self.structure}, and leaves {100 * self.share:.2g} % of the torque."
        return sentence(f"{join(gains)}: {found}" if gains else found)

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
        """Numbers, other structures, and what was kept."""
        del details
        explanation = "± is 2 deviations, over all laws that the record does not distinguish"
        if (gain := getattr(self.controller, "gain", 1.0)) != 1.0:
            explanation += f"; the gain of the output is {number(gain)} {self.torque_unit}"
        rows = list[tuple[str, ...]]()
        for n in self._in_si():
            percent = number(100 * n.spread / abs(n.value), 2) if n.value else "-"
            rows.append((n.name, number(n.value, 6), number(n.spread, 2), n.unit, percent))
        others = [f"{one.structure}: {100 * one.apart:.2g} %" for one in self.alternatives]
        facts = [
            ("residual", f"{number(self.rms, 3)} {self.torque_unit} rms"),
            ("noise of the torque", f"{number(self.torque_noise, 2)} {self.torque_unit}"),
            ("noise of the position", f"{number(self.position_noise, 2)} {self.position_unit}"),
            *[("as declared, and not from this record", f"{name} = {value:g}") for name, value in self.kept.items()],
        ]
        blocks: list[Block] = [
            Facts((("record", self.record), *common_facts(self.resampled, None))),
            Table(("parameter in SI", "value", "±", "unit", "%"), tuple(rows), words=(0, 3)),
            Paragraph(explanation),
            Facts(tuple(facts)),
        ]
        if others:
            said = "Laws that the record does not distinguish from it, and by how much their torque differs:"
            blocks += [Paragraph(said), Listing(tuple(others))]
        return Document(self.sentence, tuple(blocks))


def _in_torque(unit: str, torque_unit: str) -> str:
    """Multiply a unit of `unit_of_number` by the controller's gain: "N s/m"."""
    above, stroke, below = unit.replace(CONTROLLER_UNITS, torque_unit).partition(" per ")
    return per(above, below) if stroke else above
