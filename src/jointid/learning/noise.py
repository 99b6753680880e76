"""What a logged torque and a logged position are off by, and residuals made white by it.

A law that is applied to a *logged* position sees that position's error n, too. With the law's response G from position
to torque, the residual of the true law is ``w - G n``, w the error of the logged torque, and its spectrum::

    S = a + b |G|^2

a of the torque's error and b of the position's, both white: the colour of the residual is the law's own. The numbers
of a law are those that minimise ``sum over f of |E|^2 / S`` with the S of that very law, E the residual's transform:
the maximum likelihood of errors in variables (Pintelon and Schoukens 2012, ch. 9). An S that did not move with the
law would reward every filter that keeps the noise from the prediction, the true one or not.

An encoder's rounding is white only roughly, and a filter can be bent to fit what is left of it. So the frequencies are
left out at which the torque itself is not louder than the noise: there the record tells of the noise, not of the law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from jointid.common.errors import MethodError
from jointid.data.record import FloatArray

POINTS = 96  # frequencies a law's response is worked out at
_BINS = 160  # of the averaged periodogram
_LOUDER = 4.0  # times the noise, in power: what is not tells of the noise, not of the law
_FLOOR = 1e-4  # of the torque: no log is taken to be truer
_STEPS = 30
_QUIET = 14  # bands of a position's spectrum, of which one is the quietest
_QUIETER = 1.5  # times as much power a white noise has as its quietest band, at most


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """The spectrum of what a law leaves (the module's equations).

    Attributes:
        torque: a, variance of the torque's error.
        position: b, variance of the position's error.
        heard: (frequencies,) 1 where the torque is louder than the noise, else 0: what is not is left out.
    """

    torque: float
    position: float
    heard: FloatArray

    def weights(self, response: FloatArray) -> FloatArray:
        """Return ``1 / sqrt(S)`` at the frequencies of the real transform, given |G| there; 0 where left out."""
        with np.errstate(over="ignore"):  # a candidate that reacts beyond all numbers weighs nothing
            return np.asarray(self.heard / np.sqrt(self.torque + self.position * response**2))

    @property
    def rows(self) -> float:
        """Independent numbers that are left in a whitened residual."""
        return 2.0 * float(np.sum(self.heard))


def grid(sample_time: float, size: int) -> FloatArray:
    """Return the frequencies at which a law's response is worked out, Hz: from a record's lowest to half its rate."""
    return _points(size) * 0.5 / sample_time


def spread(response: FloatArray, size: int) -> FloatArray:
    """Return a response known on `grid` at all frequencies of a real transform of `size` samples."""
    return np.interp(_shares(size), _points(size), response)


def smoothed(size: int) -> FloatArray:
    """Return what cubic splines through noisy samples leave of the noise at the frequencies of a real transform.

    ``sinc(f T)^4 / (1 - 2/3 sin^2(pi f T))``, the cardinal cubic spline's (Unser 1999, IEEE Signal Processing Magazine
    16(6)); the images above half the rate are left out.
    """
    turn = 0.5 * np.pi * _shares(size)
    return np.asarray(np.sinc(0.5 * _shares(size)) ** 4 / (1.0 - 2.0 / 3.0 * np.sin(turn) ** 2))


@cache
def _points(size: int) -> FloatArray:
    return np.asarray(np.geomspace(2.0 / size, 1.0, POINTS))


@cache
def _shares(size: int) -> FloatArray:
    """Return the frequencies of a real transform, as shares of half the sampling frequency."""
    return np.linspace(0.0, 1.0, size // 2 + 1)


def noise_of(
    error: FloatArray, response: FloatArray, torque: FloatArray, kept: FloatArray, most: float = math.inf
) -> Noise:
    """Return the noise that explains a residual.

    Args:
        error: (samples,) the residual, 0 where it is left out.
        response: |G| of the law at the frequencies of its real transform.
        torque: (samples,) logged.
        kept: (samples,) 1 where the residual counts, else 0.
        most: variance of the position's error at most, see `quietest`.

    Raises:
        MethodError: the residual, or the response, is beyond all numbers.
    """
    size, share = error.size, float(np.mean(kept))
    with np.errstate(over="ignore", invalid="ignore"):
        seen, gains = _averaged(np.abs(np.fft.rfft(error)) ** 2 / (size * share)), _averaged(response**2)
        power = float(np.mean(seen)) * float(np.mean(gains))
    if not math.isfinite(power):
        raise MethodError(
            "No law that is searched for gives this record's torque: the best one runs away. Check units, signs and "
            "sides of torque, reference and motor_position, or declare the law."
        )
    a, b = _two_sources(seen, gains, _FLOOR**2 * float(np.mean(torque**2)), most)
    signal = _averaged(np.abs(np.fft.rfft(np.hanning(size) * (torque - torque.mean()))) ** 2 / (size * 0.375))
    loud = signal > _LOUDER * np.maximum(a + b * gains, seen)
    heard = np.repeat(loud, np.diff(_edges(response.size))).astype(np.float64)
    return Noise(a, b, np.concatenate([[1.0], heard]))


def quietest(position: FloatArray) -> float:
    """Return the power of a logged position at the frequency where it is least: its error is not larger.

    Where a law leaves more than its noise, the rest must not be taken for an error of the position: one that is too
    large rewards a law for reacting to it.
    """
    flat = position - np.linspace(position[0], position[-1], position.size)
    window = np.hanning(position.size)
    power = np.abs(np.fft.rfft(window * flat)) ** 2 / (position.size * 0.375)
    edges = np.linspace(power.size // 8, power.size, _QUIET + 1).astype(np.intp)
    return _QUIETER * float(np.min(np.add.reduceat(power, edges[:-1]) / np.diff(edges)))


def everything(variance: float, samples: int) -> Noise:
    """Return white noise of the torque that leaves nothing out."""
    return Noise(variance, 0.0, np.ones(samples // 2 + 1))


def _edges(size: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(1, size, _BINS + 1).astype(np.intp))


def _averaged(values: FloatArray) -> FloatArray:
    edges = _edges(values.size)
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


def _two_sources(seen: FloatArray, gains: FloatArray, floor: float, most: float) -> tuple[float, float]:
    """Return (a, b) of the largest Whittle likelihood, ``sum log S + I / S``, by scoring; both at least 0."""
    from scipy.optimize import nnls

    spectrum = np.maximum(seen, floor)
    a, b = floor, 0.0
    for step in range(_STEPS):
        columns = np.column_stack([np.ones_like(gains), gains]) / spectrum[:, np.newaxis]
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)  # a law may not look at the position at all
        found = nnls(columns / scale, seen / spectrum)[0] / scale
        if found[1] > most:
            weights = columns[:, 0]
            found = np.array([weights @ (seen / spectrum - most * columns[:, 1]) / (weights @ weights), most])
        a, b = max(float(found[0]), floor), float(found[1])
        new = a + b * gains
        if step and np.max(np.abs(np.log(new / spectrum))) < 1e-6:
            break
        spectrum = new
    return a, b
