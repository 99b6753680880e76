"""Controller numbers in the drive's name, unit and transmission side."""

from __future__ import annotations

import math
from dataclasses import dataclass

_LETTERS = {"position_gain": "Kv", "velocity_gain": "Kp", "integral_time": "Tn"}
"""The letters of a drive's cascade."""


def name_in_words(name: str, *, cascade: bool) -> str:
    """Return a number's name with the letter that drives use for it: "position gain Kv"."""
    letter = _LETTERS.get(name.rpartition(" ")[2]) if cascade else None
    return " ".join(filter(None, (name.replace("_", " "), letter)))


@dataclass(frozen=True, slots=True)
class DriveNumber:
    """A drive's representation of one number of a law.

    Attributes:
        number: of the law, as `jointid.models.controllers.numbers_of` has it.
        name: in the drive: the same, integral_time for an integral gain, or a parameter's own.
        unit: in which the drive shows it.
        factor: what the number is multiplied by; of an inverse one, what is divided by it.
        inverse: whether the drive shows a time for a gain.
        declared: what the joint file says, in that unit; None where it says nothing.
    """

    number: str
    name: str
    unit: str
    factor: float
    inverse: bool = False
    declared: float | None = None

    @property
    def tells_more(self) -> bool:
        """Whether it adds a conversion or a declared value."""
        return self.inverse or self.factor != 1.0 or self.declared is not None

    def of(self, value: float) -> float:
        """Convert a value to the drive's."""
        if self.inverse:
            return self.factor / value if value else math.inf
        return self.factor * value
