"""The answer of learning a controller: the law, its numbers with intervals, its rivals, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph, Table, common_facts
from jointid.common.text import number
from jointid.models.controllers import Controller
from jointid.models.transmission import Transmission
from jointid.records.time_base.uniformity import Resampled


@dataclass(frozen=True, slots=True)
class LearnedNumber:
    """One number of the law.

    Attributes:
        name: as `jointid.models.controllers.numbers_of` has it; "integral" is what an integral holds at the first
            sample, in controller units.
        value: in the law's units.
        std: standard deviation.
    """

    name: str
    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Alternative:
    """A structure that was weighed against the one that was chosen.

    Attributes:
        words: what it is.
        controller: with the numbers that fit best.
        worse: how much larger its criterion is; 10 is as good as certain.
        apart: by how much the torques of the two differ, in rms, as a share of the torque's rms.
        alike: whether the record does not tell it from the one that was chosen.
    """

    words: str
    controller: Controller
    worse: float
    apart: float
    alike: bool


@dataclass(frozen=True, slots=True, eq=False)
class LearnedLoop(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        words: its structure.
        numbers: those that were learned.
        correlation: of their errors, in that order.
        equivalent: names of laws that are the same equation.
        alternatives: other structures, the likeliest first.
        sentences: what the record cannot tell, and what must be known to use the law.
        rms: of the residual, in the torque's unit. share: of the torque's rms.
        torque_noise: standard deviation of the torque's error, in its unit. position_noise: of the position's.
        band: highest frequency at which the torque was louder than the noise, Hz.
        residual: (samples,) logged less predicted torque, 0 in the samples that are left out.
        torque_unit, position_unit: of the record.
        record: name of it.
        transmission: between the motor and the units of the law, None where there is none.
        resampled: how the record's samples were brought to a uniform clock, None where they were logged so.
    """

    controller: Controller
    words: str
    numbers: tuple[LearnedNumber, ...]
    correlation: FloatArray
    equivalent: tuple[str, ...]
    alternatives: tuple[Alternative, ...]
    sentences: tuple[str, ...]
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
    def alike(self) -> tuple[Alternative, ...]:
        """Structures that the record does not tell from the one that was chosen."""
        return tuple(one for one in self.alternatives if one.alike)

    def document(self, *, details: bool = False) -> Document:
        """Return the numbers, the other structures, and what the record cannot tell; there are no further details."""
        del details
        facts = common_facts(self.resampled, None)
        if self.equivalent:
            facts = (*facts, ("same law", "; ".join(self.equivalent)))
        numbers = tuple((n.name, number(n.value, 6), number(2 * n.std, 2), _percent(n)) for n in self.numbers)
        residual = (
            f"residual {number(self.rms, 3)} {self.torque_unit} rms, {100 * self.share:.2g} % of the torque; errors of "
            f"the torque {number(self.torque_noise, 2)} {self.torque_unit}, of the position "
            f"{number(self.position_noise, 2)} {self.position_unit}; heard up to {number(self.band, 3)} Hz"
        )
        others = tuple(
            (one.words, f"{one.worse:+.1f}", f"{100 * one.apart:.2g}", "yes" if one.alike else "no")
            for one in self.alternatives
        )
        header = ("other structure", "criterion", "torque apart, %", "alike")
        blocks: list[Block] = [
            *([Facts(facts)] if facts else []),
            Table(("number", "value", "2 sigma", "%"), numbers),
            Paragraph(residual),
            *([Table(header, others, words=(0, 3))] if others else []),
            *([Listing(self.sentences)] if self.sentences else []),
        ]
        return Document(f"{self.record}: {self.words}", tuple(blocks))


def _percent(one: LearnedNumber) -> str:
    return number(200 * one.std / abs(one.value), 2) if one.value else "-"
