"""Digital filters in a drive's loop: of the measured velocity, and of the torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from jointid.common.errors import MethodError

Coefficients: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
"""Numerator and denominator in powers of 1/z."""


class Filter(Protocol):
    """The interface of a filter."""

    def coefficients(self, period: float) -> Coefficients:
        """Return ``b0, b1, ...`` and ``a0, a1, ...`` at a period."""


@dataclass(frozen=True, slots=True)
class DigitalFilter:
    """``H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...)``; the default passes everything."""

    numerator: tuple[float, ...] = (1.0,)
    denominator: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numerator", tuple(float(b) for b in self.numerator))
        object.__setattr__(self, "denominator", tuple(float(a) for a in self.denominator))
        finite = all(map(math.isfinite, (*self.numerator, *self.denominator)))
        if not self.numerator or not self.denominator or self.denominator[0] == 0.0 or not finite:
            raise MethodError(
                f"A digital filter needs a numerator, and a denominator that does not start with 0, of finite numbers; "
                f"received {self.numerator} / {self.denominator}."
            )

    def coefficients(self, period: float) -> Coefficients:
        """Return them as they are, whatever the period."""
        return self.numerator, self.denominator


@dataclass(frozen=True, slots=True)
class MovingAverage:
    """The mean of the last `samples` values: ``H(z) = (1 + z^-1 + ... + z^-(n-1)) / n``."""

    samples: int

    def __post_init__(self) -> None:
        if isinstance(self.samples, bool) or not isinstance(self.samples, int) or not 1 <= self.samples <= 1000:
            raise MethodError(f"A moving average takes 1 to 1000 samples, a whole number; received {self.samples}.")

    def coefficients(self, period: float) -> Coefficients:
        """Return the weights, all alike."""
        return (1.0 / self.samples,) * self.samples, (1.0,)


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """A low-pass of first order: ``y[k] = p y[k-1] + (1 - p) x[k]``, ``p = exp(-T / time_constant)``.

    The pole is that of ``1 / (1 + time_constant s)``, sampled. A time constant of 0 passes everything.
    """

    time_constant: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.time_constant) and self.time_constant >= 0):
            raise MethodError(f"A filter's time constant is 0 s or more; received {self.time_constant}.")

    def coefficients(self, period: float) -> Coefficients:
        """Return the filter at a period."""
        pole = math.exp(-period / self.time_constant) if self.time_constant else 0.0
        return (1.0 - pole,), (1.0, -pole)


@dataclass(frozen=True, slots=True)
class SecondOrder:
    """A filter of second order, as drives parametrise it: a low-pass, or with a numerator of its own any biquad.

    It is::

        H(s) = (s^2/wn^2 + 2 dn s/wn + 1) / (s^2/wd^2 + 2 dd s/wd + 1)

    brought to the period by the bilinear rule, which is exact at the denominator's frequency (and the numerator's, each
    at its own). Without a numerator its polynomial is 1.

    Attributes:
        frequency: wd / 2 pi, Hz, below half the sampling frequency.
        damping: dd, positive.
        numerator_frequency: wn / 2 pi, Hz; None for a low-pass.
        numerator_damping: dn.
    """

    frequency: float
    damping: float = math.sqrt(0.5)
    numerator_frequency: float | None = None
    numerator_damping: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.frequency, self.damping, self.numerator_frequency or 1.0, 1.0 + self.numerator_damping)
        if not all(math.isfinite(number) and number > 0 for number in numbers):
            raise MethodError(
                "A filter of second order has positive frequencies and damping, and a numerator's damping above -1; "
                f"received {self.frequency} Hz, {self.damping}, {self.numerator_frequency} Hz and "
                f"{self.numerator_damping}."
            )

    def coefficients(self, period: float) -> Coefficients:
        """Return the filter at a period.

        Raises:
            MethodError: a frequency is not below half the sampling frequency.
        """
        below = _polynomial(self.frequency, self.damping, period)
        above = np.array([1.0, 2.0, 1.0])
        if self.numerator_frequency is not None:
            above = _polynomial(self.numerator_frequency, self.numerator_damping, period)
        return tuple(map(float, above / below[0])), tuple(map(float, below / below[0]))


@dataclass(frozen=True, slots=True)
class Notch:
    """A band-stop: ``H(s) = (s^2 + depth b s + w^2) / (s^2 + b s + w^2)``, b = 2 pi bandwidth, by the bilinear rule.

    Attributes:
        frequency: w / 2 pi, Hz: the centre, exact in the sampled filter.
        bandwidth: Hz between the points where a notch of depth 0 passes 71 %.
        depth: what is left at the centre, as a share; 0 stops it completely.
    """

    frequency: float
    bandwidth: float
    depth: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.frequency, self.bandwidth, self.depth))) or not (
            self.frequency > 0 and self.bandwidth > 0 and self.depth >= 0
        ):
            raise MethodError(
                "A notch has a positive frequency and bandwidth, and a depth of 0 or more; received "
                f"{self.frequency} Hz, {self.bandwidth} Hz, {self.depth}."
            )

    def coefficients(self, period: float) -> Coefficients:
        """Return the filter at a period.

        Raises:
            MethodError: the frequency is not below half the sampling frequency.
        """
        damping = 0.5 * self.bandwidth / self.frequency
        biquad = SecondOrder(self.frequency, damping, self.frequency, self.depth * damping)
        return biquad.coefficients(period)


def _polynomial(frequency: float, damping: float, period: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return ``s^2/w^2 + 2 d s/w + 1`` by the bilinear rule, times ``(1 + z^-1)^2``, exact at its own frequency."""
    if frequency * period >= 0.5:
        raise MethodError(
            f"A filter at {frequency:g} Hz does not exist at a period of {period:g} s, whose half sampling frequency "
            f"is {0.5 / period:g} Hz; lower it, or correct the period."
        )
    slope = 1.0 / math.tan(math.pi * frequency * period)  # of s/w at that frequency
    square, line = slope * slope, 2.0 * damping * slope
    return np.array([square + line + 1.0, 2.0 - 2.0 * square, square - line + 1.0])


def as_filter(value: Filter | Sequence[float]) -> Filter:
    """Return a filter; a bare sequence is its numerator."""
    return DigitalFilter(tuple(value)) if isinstance(value, Sequence) else value
