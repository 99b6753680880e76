"""The answer of learning a controller: the law, its numbers with intervals, its rivals, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.common.text import aligned, number
from jointid.models.controllers import Controller
from jointid.models.transmission import Transmission
from jointid.records.time_base.uniformity import Resampled, resampled_lines


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
class LearnedLoop:
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

    def __str__(self) -> str:
        """Return the tables, and what the record cannot tell."""
        rows = [(n.name, number(n.value, 6), number(2 * n.std, 2), _percent(n)) for n in self.numbers]
        lines = [f"{self.record}: {self.words}"]
        lines += resampled_lines(self.resampled)
        if self.equivalent:
            lines.append(f"the same law: {'; '.join(self.equivalent)}")
        lines += ["", aligned(("number", "value", "2 sigma", "%"), rows, (False, True, True, True)), ""]
        lines.append(
            f"residual {number(self.rms, 3)} {self.torque_unit} rms, {100 * self.share:.2g} % of the torque; errors of "
            f"the torque {number(self.torque_noise, 2)} {self.torque_unit}, of the position "
            f"{number(self.position_noise, 2)} {self.position_unit}; heard up to {number(self.band, 3)} Hz"
        )
        if self.alternatives:
            others = [
                (one.words, f"{one.worse:+.1f}", f"{100 * one.apart:.2g}", "yes" if one.alike else "no")
                for one in self.alternatives
            ]
            header = ("other structure", "criterion", "torque apart, %", "alike")
            lines += ["", aligned(header, others, (False, True, True, False))]
        return "\n".join([*lines, "", *self.sentences])


def _percent(one: LearnedNumber) -> str:
    return number(200 * one.std / abs(one.value), 2) if one.value else "-"
