"""Settings of the tuning: required margins and confidences."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError


@dataclass(frozen=True, slots=True)
class Tuning:
    """Settings of `tune`: what the proposed loop keeps in the worst case.

    Attributes:
        gain_margin: ratio by which the loop's gain may still grow, or fall, before it is unstable; 2 is 6 dB.
        phase_margin: degrees.
        modulus: smallest distance of the response from -1: the largest sensitivity is its inverse.
        confidence: with which the interval of the estimate holds all its parameters together.
        notch: whether a notch may be proposed.
        false_alarm, power: of the smallest detectable change, see `detectable`.
        seed: of the joints that are drawn in the interval.
    """

    gain_margin: float = 2.0
    phase_margin: float = 45.0
    modulus: float = 0.5
    confidence: float = 0.95
    notch: bool = True
    false_alarm: float = 0.01
    power: float = 0.9
    seed: int = 0

    def __post_init__(self) -> None:
        faults = [f"gain_margin = {self.gain_margin}"] * (not 1 <= self.gain_margin < math.inf)
        faults += [f"phase_margin = {self.phase_margin} degrees"] * (not 0 <= self.phase_margin < 90)
        faults += [f"modulus = {self.modulus}"] * (not 0 < self.modulus < 1)
        faults += [f"confidence = {self.confidence}"] * (not 0 < self.confidence < 1)
        faults += [f"false_alarm = {self.false_alarm}"] * (not 0 < self.false_alarm < 1)
        faults += [f"power = {self.power}"] * (not 0.5 <= self.power < 1)
        if faults:
            raise MethodError(
                "A gain margin is 1 or more, a phase margin from 0 to 90 degrees, the distance from -1, the confidence "
                "and the false-alarm rate are between 0 and 1, and the power is from 0.5 to 1; received "
                f"{', '.join(faults)}."
            )

    @property
    def asked(self) -> FloatArray:
        """The least margins, in the order of `margins.NAMES`; of the delay none is asked."""
        return np.array([self.gain_margin, self.gain_margin, math.radians(self.phase_margin), 0.0, self.modulus])
