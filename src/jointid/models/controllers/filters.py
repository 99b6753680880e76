"""Digital filters of measured velocity and torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting

_LONGEST = 1000  # numbers of a polynomial, as many as a moving average may take

Coefficients: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
"""Numerator and denominator in powers of 1/z."""


class Filter(Protocol):
    """The interface of a filter."""

    def coefficients(self, period: float) -> Coefficients:
        """Return ``b0, b1, ...`` and ``a0, a1, ...`` at a period."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DigitalFilter:
    """``H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...)``; the default passes everything."""

    numerator: tuple[float, ...] = setting((1.0,), "b0, b1, ... in powers of 1/z")
    denominator: tuple[float, ...] = setting((1.0,), "a0, a1, ... in powers of 1/z; without it 1")

    def __post_init__(self) -> None:
        object.__setattr__(self, "numerator", tuple(float(b) for b in self.numerator))
        object.__setattr__(self, "denominator", tuple(float(a) for a in self.denominator))
        numbers, sizes = (*self.numerator, *self.denominator), (len(self.numerator), len(self.denominator))
        finite = all(map(math.isfinite, numbers))
        if not (finite and min(sizes) > 0 and max(sizes) <= _LONGEST and self.denominator[0] != 0.0):
            raise MethodError(
                f"A digital filter needs a numerator, and a denominator that does not start with 0, of finite numbers, "
                f"{_LONGEST} at most; received {sizes[0]} and {sizes[1]}, {numbers[:3]}, ...: correct them."
            )

    def coefficients(self, period: float) -> Coefficients:
        """Numerator and denominator, independent of the period."""
        return self.numerator, self.denominator


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class MovingAverage:
    """The mean of the last `samples` values: ``H(z) = (1 + z^-1 + ... + z^-(n-1)) / n``."""

    samples: int = field(metadata=declare("samples of which the mean is taken", at_least=1, at_most=1000))

    def __post_init__(self) -> None:
        check_settings(self)

    def coefficients(self, period: float) -> Coefficients:
        """Equal weights."""
        return (1.0 / self.samples,) * self.samples, (1.0,)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class FirstOrder:
    """A low-pass of first order: ``y[k] = p y[k-1] + (1 - p) x[k]``, ``p = exp(-T / time_constant)``.

    The pole is that of ``1 / (1 + time_constant s)``, sampled. A time constant of 0 passes everything.
    """

    time_constant: float = field(metadata=declare("time constant of its pole", unit="s", at_least=0))

    def __post_init__(self) -> None:
        check_settings(self)

    def coefficients(self, period: float) -> Coefficients:
        """Return the filter at a period."""
        pole = math.exp(-period / self.time_constant) if self.time_constant else 0.0
        return (1.0 - pole,), (1.0, -pole)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class SecondOrder:
    """Second-order filter, as drives parametrise it: a low-pass or any biquad.

    It is::

        H(s) = (s^2/wn^2 + 2 dn s/wn + 1) / (s^2/wd^2 + 2 dd s/wd + 1)

    brought to the period by the bilinear rule, which is exact at the denominator's frequency (and the numerator's, each
    at its own). Without a numerator its polynomial is 1.
    """

    frequency: float = field(
        metadata=declare("frequency wd / 2 pi of its poles, below half the sampling frequency", unit="Hz", above=0)
    )
    damping: float = setting(math.sqrt(0.5), "damping dd of its poles; without it 0.7071, as Butterworth's", above=0)
    numerator_frequency: float | None = setting(
        None, "frequency wn / 2 pi of its zeros; without it a low-pass", unit="Hz", above=0
    )
    numerator_damping: float = setting(0.0, "damping dn of its zeros; without it 0", above=-1)

    def __post_init__(self) -> None:
        check_settings(self)

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


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Notch:
    """A band-stop: ``H(s) = (s^2 + depth b s + w^2) / (s^2 + b s + w^2)``, b = 2 pi bandwidth, by the bilinear rule."""

    frequency: float = field(metadata=declare("centre w / 2 pi, below half the sampling frequency", unit="Hz", above=0))
    bandwidth: float = field(
        metadata=declare("width, between the points where a notch of depth 0 passes 71 %", unit="Hz", above=0)
    )
    depth: float = setting(0.0, "what is left at its centre, as a share; without it 0", at_least=0)

    def __post_init__(self) -> None:
        check_settings(self)

    def coefficients(self, period: float) -> Coefficients:
        """Return the filter at a period.

        Raises:
            MethodError: the frequency is not below half the sampling frequency.
        """
        damping = 0.5 * self.bandwidth / self.frequency
        biquad = SecondOrder(self.frequency, damping, self.frequency, self.depth * damping)
        return biquad.coefficients(period)


def _polynomial(frequency: float, damping: float, period: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Second-order polynomial by the bilinear rule, times ``(1 + z^-1)^2``.

    It is exact at its own frequency.
    """
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


FILTERS: Mapping[str, type[Any]] = {
    "digital": DigitalFilter,
    "moving_average": MovingAverage,
    "first_order": FirstOrder,
    "second_order": SecondOrder,
    "notch": Notch,
}
"""The filters there are, by the word for their kind."""
