"""The result of learning a controller: the law, its numbers with intervals, its alternatives and its limitations."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph, Table, common_facts
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.controller_id.structures import Structure
from jointid.models.controllers import Controller
from jointid.records.record import Resampled


class Equivalence(StrEnum):
    """Another form of the same equation, its gains combined otherwise."""

    PD = auto()
    PD_ON_DIFFERENCE = auto()
    VISCOUS_FEEDFORWARD = auto()
    PID_ON_DIFFERENCE = auto()
    REFERENCE_VELOCITY_WEIGHT = auto()


class LimitationCode(StrEnum):
    """What a record leaves open about the controller."""

    NO_INTEGRAL = auto()
    LIMIT_NOT_REACHED = auto()
    ANTI_WINDUP_NOT_TESTED = auto()
    TORQUE_FILTER_HIDDEN = auto()
    DELAY_NOT_VISIBLE = auto()
    TORQUE_LOGGED_LATE = auto()
    PERIOD_UNCERTAIN = auto()
    INTERPOLATION_ASSUMED = auto()
    INDISTINGUISHABLE = auto()
    AS_DECLARED = auto()


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
        structure: of the law.
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
class LearnedLoop(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        structure: of the law; its text is the description.
        numbers: those that were learned.
        correlation: of their errors, in that order.
        equivalent: forms of the same equation, by `Equivalence`, and structures with the same torque to rounding.
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
    """

    controller: Controller
    structure: Structure
    numbers: tuple[LearnedNumber, ...]
    correlation: FloatArray
    equivalent: tuple[Message | Structure, ...]
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
    def alike(self) -> tuple[Alternative, ...]:
        """The structures that the record does not distinguish from the chosen one."""
        return tuple(one for one in self.alternatives if one.alike)

    @property
    def equivalent_laws(self) -> tuple[str, ...]:
        """The descriptions of the equivalent laws."""
        return tuple(map(str, self.equivalent))

    def document(self, *, details: bool = False) -> Document:
        """Return the numbers, the other structures, and what the record cannot tell; there are no further details."""
        del details
        facts = common_facts(self.resampled, None)
        if self.equivalent:
            facts = (*facts, ("equivalent laws", "; ".join(self.equivalent_laws)))
        numbers = tuple((n.name, number(n.value, 6), number(2 * n.std, 2), _percent(n)) for n in self.numbers)
        residual = (
            f"residual {number(self.rms, 3)} {self.torque_unit} rms, {100 * self.share:.2g} % of the torque; noise of "
            f"the torque {number(self.torque_noise, 2)} {self.torque_unit}, of the position "
            f"{number(self.position_noise, 2)} {self.position_unit}; informative up to {number(self.band, 3)} Hz"
        )
        others = tuple(
            (str(one.structure), f"{one.worse:+.1f}", f"{100 * one.apart:.2g}", "yes" if one.alike else "no")
            for one in self.alternatives
        )
        header = ("other structure", "criterion difference", "torque difference, %", "indistinguishable")
        blocks: list[Block] = [
            *([Facts(facts)] if facts else []),
            Table(("parameter", "value", "2 sigma", "%"), numbers),
            Paragraph(residual),
            *([Table(header, others, words=(0, 3))] if others else []),
            *([Listing(tuple(map(str, self.limitations)))] if self.limitations else []),
        ]
        return Document(f"{self.record}: {self.structure}", tuple(blocks))


def _percent(one: LearnedNumber) -> str:
    return number(200 * one.std / abs(one.value), 2) if one.value else "-"
