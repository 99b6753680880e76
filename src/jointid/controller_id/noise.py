"""Noise of the logged torque and position.

A law applied to a *logged* position responds to that position's error n. With G the law's response from position to
torque, the residual of the true law is ``w - G n``, w the error of the logged torque, with the spectrum::

    S = a + b |G|^2 R

a belongs to the white torque error, b and R, its size and shape, to the position error. The numbers of a law minimise
``sum over f of |E|^2 / S`` with its own S, E the residual's transform: maximum likelihood of errors in variables
(Pintelon and Schoukens 2012, ch. 9). A fixed S would reward filters that suppress the noise.

Frequencies at which torque or position do not exceed their noise are excluded, since a filter could fit the noise
there. They are determined before any law, as a wrong one would exclude the frequencies at which it is wrong: all laws
are linear in reference, its direction, position and injection, up to the limit, with short memory except integrals. A
regression of the torque on long stretches of their past leaves little but noise (Zhu 2001, Multivariable System
Identification for Process Control, ch. 6).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.controller_id.structures import SLOWER
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE

_LOW, _EVEN = 40, 100  # frequencies a law's response is worked out at: in octaves, and evenly: filters end in zeros
_BINS = 160  # of the averaged periodogram
_FLOOR = 1e-4  # of the torque: no log is taken to be truer
_STEPS = 30
_SMOOTHED = 21  # samples over which a position is, before it is rounded again
_PARTS = (0.25, 0.5, 0.75)  # of a step
_LEAST = 0.1  # of white noise
_NOISIER = 4.0  # times the rounding: an error of another kind
_BEYOND = 1.3  # times what is seen of the position's error it may be

_PAST = 48  # samples of reference and position: a notch of 10 Hz at 1 kHz rings as long
_BESIDE = 24  # samples of what passes the torque's filter only
_IMAGES = 3  # samples of what a slower position loop makes of slow signals: near its rate, where it holds nothing
_LOUDER = 4.0  # times the noise, in power: the rest shows the noise, not the law
_ROWS = 4096  # samples whose columns are in memory at a time
_DEPENDENT = 1e-12  # of the largest singular value: what is below is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """The spectrum of a law's residual (the module's equations).

    Attributes:
        torque: a, variance of the torque's error.
        position: b, variance of the position's error.
        informative: (frequencies,) 1 where torque and position exceed their noise, else 0: these are left out.
    """

    torque: float
    position: float
    informative: FloatArray

    def weights(self, response: FloatArray) -> FloatArray:
        """Return ``1 / sqrt(S)`` for given |G|; 0 where excluded."""
        return np.asarray(self.informative / np.sqrt(self.torque + self.position * response**2))

    @property
    def rows(self) -> float:
        """Independent values in a whitened residual."""
        return 2.0 * float(np.count_nonzero(self.informative))


@dataclass(frozen=True, slots=True, eq=False)
class PositionError:
    """Error of a logged position, independent of the law.

    Attributes:
        shape: (frequencies,) root of its spectrum, relative to white noise of the same variance.
        most: bound of its variance. Without it a residual of the law would count as an error of the position, which
            would reward the law for reacting to the position.
        variance: of its quantisation; 0 if unknown.
        power: (bands,) of the logged position itself.
    """

    shape: FloatArray
    most: float
    variance: float
    power: FloatArray


def position_response(
    response: Callable[[FloatArray], NDArray[np.complex128]], sample_time: float, samples: int, rate: int
) -> FloatArray:
    """|G| from logged position error to logged torque.

    A law faster than the log sees cubic splines; the cardinal one has the spectrum::

        C(f) = sinc(f T)^4 / (1 - 2/3 sin^2(pi f T))

    T the log's sample time (Unser 1999, IEEE Signal Processing Magazine 16(6)). The torque's samples alias the images:
    ``G(f) = sum over m of C(f + m / T) G_law(f + m / T)``. A biased |G| would favour or penalise all fast laws.

    `response` is the law's at frequencies in Hz, and `rate` its periods per sample of the log.
    """

    def cardinal(turns: FloatArray) -> FloatArray:
        return np.asarray(np.sinc(turns) ** 4 / (1.0 - 2.0 / 3.0 * np.sin(np.pi * turns) ** 2))

    shares = _points(samples) * 0.5
    total = np.zeros(shares.size, dtype=np.complex128)
    for m in range(-(rate // 2), rate - rate // 2):
        at = shares + m
        weight = np.ones(shares.size) if rate == 1 else sum(cardinal(at + n * rate) for n in range(-2, 3))
        found = response(np.abs(at) / sample_time)
        total += weight * np.where(at < 0, found.conj(), found)
    return np.interp(np.linspace(0.0, 1.0, samples // 2 + 1), _points(samples), np.abs(total))


@cache
def _points(size: int) -> FloatArray:
    return np.unique(np.concatenate([np.geomspace(2.0 / size, 1.0, _LOW), np.linspace(0.0, 1.0, _EVEN + 1)[1:]]))


def estimate_noise(
    power: FloatArray, response: FloatArray, torque: float, most: float, informative: FloatArray
) -> Noise:
    """Fit the noise by Whittle's likelihood of a residual, ``sum(log(S) + I/S)``.

    `power`, (frequencies,), is the residual's periodogram I, `response` |G| times the shape of the position's error;
    `torque` is the mean square of the logged torque, and `most` bounds the variance of the position's error.
    """
    from scipy.optimize import lsq_linear

    seen, gains, floor = band_means(power), band_means(response**2), _FLOOR**2 * torque
    spectrum = np.maximum(seen, floor)
    for _ in range(_STEPS):
        columns = np.column_stack([np.ones_like(gains), gains]) / spectrum[:, np.newaxis]
        scale = column_norms(columns)  # a law may not look at the position at all
        bounds = np.array([floor, 0.0]) * scale, np.array([np.inf, most]) * scale
        a, b = lsq_linear(columns / scale, seen / spectrum, bounds, method="bvls").x / scale
        before, spectrum = spectrum, a + b * gains
        if np.max(np.abs(np.log(spectrum / before))) < 1e-6:
            break
    return Noise(float(a), float(b), informative)


def position_error(position: FloatArray, step: float | None) -> PositionError:
    """Estimate the error of a logged position.

    Quantisation at constant speed is a spectral line, so it is repeated on the smoothed position at several offsets.
    Without a visible step, or on a noisier position, the error is white, bounded by the quietest quarter of the
    spectrum.
    `step` is that of its encoder.
    """
    from scipy.signal import savgol_filter

    power = band_power(position - np.linspace(position[0], position[-1], position.size))
    quietest = float(np.quantile(power[power.size // 8 :], 0.25))
    white = PositionError(np.ones(position.size // 2 + 1), _BEYOND * quietest, 0.0, power)
    if step is None:
        return white
    steps = savgol_filter((position - position[0]) / step, _SMOOTHED, 3)
    moved = steps + np.array(_PARTS)[:, np.newaxis]
    rounding = np.mean(np.abs(np.fft.rfft(np.round(moved) - moved, axis=1)) ** 2, axis=0) / position.size
    bands, wide = band_means(rounding), band_widths(rounding.size)
    mean = float(wide @ bands) / float(np.sum(wide))
    if quietest > _NOISIER * mean * step**2:  # the log's digits are finer than what it was read from
        return white
    shape = np.sqrt(spread_bands(np.maximum(bands / mean, _LEAST), position.size))
    variance = mean * step**2
    return PositionError(shape, _BEYOND * variance, variance, power)


def band_power(signal: FloatArray) -> FloatArray:
    """Windowed, averaged periodogram of a signal, (bands,)."""
    return band_means(np.abs(np.fft.rfft(np.hanning(signal.size) * signal)) ** 2 / (signal.size * 0.375))


def band_widths(size: int) -> NDArray[np.intp]:
    """Number of frequencies per band of a real transform, without the first."""
    return np.asarray(np.diff(np.unique(np.linspace(1, size, _BINS + 1).astype(np.intp))), dtype=np.intp)


def band_means(values: FloatArray) -> FloatArray:
    """Means over bands, (bands,), from the second frequency on."""
    wide = band_widths(values.size)
    return np.asarray(np.add.reduceat(values, 1 + np.cumsum(wide) - wide) / wide)


def spread_bands(values: FloatArray, samples: int) -> FloatArray:
    """Spread values of bands to all frequencies of a real transform."""
    spread = np.repeat(values, band_widths(samples // 2 + 1))
    return np.concatenate([spread[:1], spread])


def informative_frequencies(
    inputs: FloatArray, torque: FloatArray, added: FloatArray, kept: FloatArray, error: PositionError
) -> tuple[FloatArray, FloatArray]:
    """Informative frequencies (1, else 0), and the torque that no law explains.

    Frequencies where the position does not exceed its quantisation count only if they show in the torque: if the
    controller saw the same quantisation, or a slower position loop makes images there.

    `inputs`, (samples, INPUTS), are of a law as fast as the log; `torque`, (samples,), is without what was `added`
    after the limit, which remains visible in a late log; `kept` is 1 where the torque is within the limit, else 0.
    """
    r, q = (inputs[:, i] - inputs[0, REFERENCE] for i in (REFERENCE, POSITION))
    asked = [np.ones((r.size, 1)), np.cumsum(r - q)[:, np.newaxis], *_signal_and_past(r), *_images(_difference(r))]
    beside = (inputs[:, DIRECTION], inputs[:, INJECTED], added)
    asked += [_lagged_columns(one, _BESIDE) for one in beside if np.any(one)]
    explained, unexplained = _regress(asked, [*_signal_and_past(q), *_images(r - q)], torque, kept)
    shown, left = band_power(explained), band_power(unexplained)
    loud = band_power(torque - torque.mean()) > _LOUDER * left
    loud &= (error.power > _LOUDER * error.variance * band_means(error.shape**2)) | (shown > _LOUDER * left)
    informative = spread_bands(np.asarray(loud, dtype=np.float64), torque.size)
    informative[0] = 1.0
    return informative, unexplained


def _regress(
    asked: list[FloatArray], seen: list[FloatArray], torque: FloatArray, kept: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Torque explained by the position, and residual, scaled for degrees of freedom.

    Columns are processed in blocks of a few thousand samples, to bound memory.
    """
    every = [*asked, *seen]
    ends = np.cumsum([one.shape[1] for one in every])
    root = np.zeros((0, ends[-1] + 1))
    for at in range(0, torque.size, _ROWS):
        part = slice(at, at + _ROWS)
        rows = np.column_stack([*(one[part] for one in every), torque[part]]) * kept[part, np.newaxis]
        root = np.asarray(np.linalg.qr(np.vstack([root, rows]), mode="r"))
    norms = column_norms(root[:, :-1])
    gains, _, rank, _ = np.linalg.lstsq(root[:, :-1] / norms, root[:, -1], rcond=_DEPENDENT)
    shares = [one @ own for one, own in zip(every, np.split(gains / norms, ends[:-1]), strict=True)]
    counted = float(np.sum(kept))
    left = (torque - np.sum(shares, axis=0)) * kept * np.sqrt(counted / max(counted - int(rank), 1.0))
    return np.asarray(np.sum(shares[len(asked) :], axis=0)), np.asarray(left)


def _images(signal: FloatArray) -> list[FloatArray]:
    """Images of a signal in a slower position loop, by modulation."""
    parts = np.arange(1, max(SLOWER) // 2 + 1)[:, np.newaxis] / max(SLOWER)
    turns = np.exp(2j * np.pi * parts * np.arange(signal.size))
    return [_lagged_columns(signal * part, _IMAGES) for turn in turns for part in (turn.real, turn.imag)]


def _signal_and_past(signal: FloatArray) -> list[FloatArray]:
    """Columns that span a signal and its past, conditioned by second differences."""
    change = _difference(signal)
    return [signal[:, np.newaxis], change[:, np.newaxis], _lagged_columns(_difference(change), _PAST)]


def _difference(signal: FloatArray) -> FloatArray:
    return np.diff(signal, prepend=signal[:1])


def _lagged_columns(signal: FloatArray, samples: int) -> NDArray[np.float64]:
    """A signal and its past, (its samples, samples + 1), initially constant."""
    led = np.concatenate([np.full(samples, signal[0]), signal])
    return np.lib.stride_tricks.sliding_window_view(led, samples + 1)
