"""Covariances of an estimate with a coloured residual.

For estimates that solve ``Z' e(x) = 0`` with sensitivities J = -de/dx::

    cov = (Z' J)^-1  S  (J' Z)^-1

Z = J is least squares, Z = W the instruments of DIDIM. S, the covariance of Z' e, is estimated from the scores
``Z_t e_t`` with the Bartlett kernel (Newey and West 1987), robust against autocorrelation and unequal variance. The
bandwidth is ``ceil(4 (n / 100)^(2/9))`` rows on each side, their rule of thumb.

Influential rows, such as a few reversals for the Coulomb frictions, have residuals smaller than the noise. Therefore
every block of a bandwidth's length gets its leave-out residual, ``(I - J_b (Z' J)^-1 Z_b')^-1 e_b``.
`position_dependent_error` covers errors that repeat with the motion.

The short bandwidth smears the spectrum over several hertz: with a loop that rings at 10 Hz, 91 % of the 2-sigma
intervals of the twin's viscous frictions hold the truth. A covariance by spectrum (`spectral`) assumes stationarity.
`robust` takes the larger of both in every direction; 94-98 % then do. A residual that grows with the frequency, as that
of a differentiated position, would be smeared to low ones: it is made white before (`prewhiten`).

Sums over time are formed within each record. The textbook's covariance, ``s^2 (J' J)^-1``, is kept for comparison
(`white`).

A model error repeats with the motion and does not average out over a long record, but changes with frequency.
`band_deviations` sums the scores over bands with equal shares of the residual; their spread is the sensitivity of the
estimate to the choice of band. `with_bands` reports the larger deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.parallel import in_threads
from jointid.uncertainty.spectral import spectral_covariance

_BANDS = 8  # of frequency, whose scores are compared
_BLUE = 0.1  # correlation of neighbouring rows, below 0, from which a residual grows with the frequency
_MOST = 2.0  # times its residual: what leaving a block out may make of it
_SINGULAR = 1e-10  # of the largest: a direction whose variance is rounding
_LOST = 1e-6  # of the largest: a direction that a block of rows determines alone


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """Covariance of the errors of an estimate.

    Attributes:
        std: (parameters,) standard deviations.
        correlation: (parameters, parameters).
        bandwidth: rows on each side whose correlation was taken in.
    """

    std: FloatArray
    correlation: FloatArray
    bandwidth: int

    @property
    def matrix(self) -> FloatArray:
        """The covariances themselves, (parameters, parameters)."""
        return np.asarray(np.outer(self.std, self.std) * self.correlation)

    def std_of(self, weights: FloatArray) -> float:
        """Standard deviation of a weighted sum of the parameters, weights (parameters,)."""
        weighted = np.asarray(weights) * self.std
        return math.sqrt(max(float(weighted @ self.correlation @ weighted), 0.0))

    def append_constants(self, count: int) -> Covariance:
        """Return the covariance with `count` more parameters that are fixed: without deviation or correlation."""
        size = self.std.size
        correlation = np.eye(size + count)
        correlation[:size, :size] = self.correlation
        return Covariance(np.append(self.std, np.zeros(count)), correlation, self.bandwidth)


def covariance_of(matrix: FloatArray, lags: int, scale: FloatArray | float = 1.0) -> Covariance:
    """Build a `Covariance` from a matrix, (parameters, parameters).

    Args:
        matrix: of the parameters, or of the scaled ones.
        lags: rows on each side with accounted correlation.
        scale: (parameters,) factors that the matrix includes.
    """
    std = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    positive = np.where(std > 0, std, 1.0)
    return Covariance(std / scale, matrix / np.outer(positive, positive), lags)


def white(J: FloatArray, error: FloatArray) -> Covariance:
    """Covariance for a white residual, ``s^2 (J' J)^-1``.

    Args:
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual; ``s^2 = ||error||^2 / (rows - parameters)``.
    """
    norms = column_norms(J)
    variance = float(error @ error) / max(error.size - J.shape[1], 1)
    R = np.linalg.qr(J / norms, mode="r")  # of J' J only the square of its condition number would be left
    inverse = np.linalg.pinv(R)
    return covariance_of(variance * inverse @ inverse.T, 0, norms)


def bandwidth(rows: int) -> int:
    """Return how many neighbouring rows may be correlated with one."""
    return math.ceil(4.0 * math.pow(rows / 100, 2 / 9))


def sandwich(
    Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1, series: Sequence[int] | None = None
) -> Covariance:
    """Autocorrelation-robust covariance (see the module).

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual.
        equations: number of simultaneous equations, stacked.
        series: rows of each record, stacked.
    """
    parts = _parts(len(Z), series)
    widths = [min(bandwidth(n), n - 1) for n in ((part.stop - part.start) // equations for part in parts)]

    def meat(Z: FloatArray, J: FloatArray, spread: FloatArray) -> FloatArray:
        found = np.zeros_like(spread)
        for part, lags in zip(parts, widths, strict=True):
            instants = (part.stop - part.start) // equations
            block = np.tile(np.arange(instants) // max(lags, 1), equations)
            left_out = residual_left_out(Z[part], J[part], error[part], spread, block)
            scores = (Z[part] * left_out[:, np.newaxis]).reshape(equations, instants, Z.shape[1])
            found += bartlett_sum(np.sum(scores, axis=0), lags)
        return found

    return scaled_sandwich(Z, J, meat, max(widths))


def scaled_sandwich(
    Z: FloatArray, J: FloatArray, meat: Callable[[FloatArray, FloatArray, FloatArray], FloatArray], lags: int
) -> Covariance:
    """Return ``(Z' J)^-1 S (J' Z)^-1``, computed with Z and J scaled by Z's norms.

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        meat: function of the scaled Z, J and the inverse of their product; returns S, (parameters, parameters).
        lags: rows on each side with accounted correlation.
    """
    norms, Z, J = _scale(Z, J)
    spread = np.asarray(np.linalg.pinv(Z.T @ J), dtype=np.float64)
    return covariance_of(spread @ meat(Z, J, spread) @ spread.T, lags, norms)


def _scale(Z: FloatArray, J: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the norms of instruments, and these and the sensitivities divided by them: one array in least squares."""
    norms = column_norms(Z)
    scaled = Z / norms
    return norms, scaled, scaled if J is Z else J / norms


def bartlett_sum(scores: FloatArray, lags: int) -> FloatArray:
    """Covariance, (parameters, parameters), of a sum of autocorrelated scores.

    Args:
        scores: (neighbours, parameters), or (neighbours, families, parameters) of independent families.
        lags: correlated neighbours on each side, with Bartlett's weights.
    """
    families, count = math.prod(scores.shape[1:-1]), scores.shape[-1]
    rows, found = scores.reshape(len(scores) * families, count), np.zeros((count, count))
    for lag in range(lags + 1):
        apart = lag * families
        together = rows[apart:].T @ rows[: len(rows) - apart]
        found += together if lag == 0 else (1 - lag / (lags + 1)) * (together + together.T)
    return found


def _parts(rows: int, series: Sequence[int] | None) -> list[slice]:
    """Return the rows of each record."""
    ends = np.cumsum(series or [rows])
    return [slice(int(end) - n, int(end)) for end, n in zip(ends, series or [rows], strict=True)]


def by_spectrum(Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None) -> Covariance:
    """Covariance for a stationary residual, by its spectrum (see `spectral`).

    Arguments as for `sandwich`, in order of time. The deviations include Student's factor.
    """
    norms, Z, J = _scale(Z, J)
    spread = np.asarray(np.linalg.pinv(Z.T @ J), dtype=np.float64)
    matrix, factor = spectral_covariance(Z, J, error, _parts(len(Z), series), spread=spread)
    return covariance_of(matrix * np.outer(factor, factor), len(Z), norms)


def stationary(Z: FloatArray, J: FloatArray, error: FloatArray) -> Covariance:
    """Covariance that noise of the error's spectrum causes in given equations.

    ``S = sum_f S(f) Z(f)' Z(f)*`` without correction for the fit. Arguments as for `sandwich`, in order of time. The
    periodogram is averaged over sqrt(rows) neighbours, without the mean.
    """

    def meat(Z: FloatArray, _: FloatArray, spread: FloatArray) -> FloatArray:
        used = int(np.sum(np.any(Z != 0.0, axis=0)))
        spectrum, both = smoothed_spectrum(error, max(len(Z) - used, 1))
        return sum_over_frequencies(Z, np.concatenate([spectrum[:1], both * spectrum])) / len(Z)

    return scaled_sandwich(Z, J, meat, len(Z))


def smoothed_spectrum(signal: FloatArray, degrees: int, rows: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Smoothed spectrum of a signal with `degrees` of freedom, or the sum of those of columns, and multiplicities.

    Both are (rows // 2,), without the mean; of more `rows` than samples the signal is 0 in the others. The periodogram
    is averaged over sqrt(rows) neighbours.
    """
    from scipy.fft import rfft  # of columns, and of a length with large prime factors, in half of NumPy's time

    rows = rows or len(signal)
    periodogram = np.sum(np.abs(rfft(signal.reshape(len(signal), -1), rows, axis=0)[1:]) ** 2, axis=1) / degrees
    half = min(max(math.isqrt(rows) // 2, 1), periodogram.size - 1)
    padded = np.pad(periodogram, half, "reflect")
    both = np.full(periodogram.size, 2.0)
    both[-1] = 2.0 if rows % 2 else 1.0
    return np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid"), both


def sum_over_frequencies(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Return ``sum_f w(f) X(f)* X(f)'``, (columns, columns).

    Args:
        columns: (samples, columns), whose transform is X.
        weights: (samples // 2 + 1,) of each frequency.
    """
    spectra = np.fft.rfft(columns, axis=0)
    return np.asarray(np.real((weights[:, np.newaxis] * spectra.conj()).T @ spectra))


def robust(
    Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None, equations: int = 1
) -> Covariance:
    """Return the larger of `sandwich` and `by_spectrum` in every direction.

    Each equation of one record has its own spectrum; `sandwich` covers their correlation.
    """
    own = [len(Z) // equations] * equations if equations > 1 else series
    ways: tuple[Callable[[], Covariance], ...] = (
        lambda: sandwich(*prewhiten(Z, J, error, own), equations, series),
        lambda: by_spectrum(Z, J, error, own),
    )
    return larger(*in_threads(lambda way: way(), ways))


def prewhiten(
    Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return equations of the same estimate with a white residual, where it grows with the frequency.

    With the autoregression F of a series of rows, ``(F^-T Z)' (F e) = Z' e``, and likewise with J: the sums of scores
    are the same, and scores nearly independent (Andrews and Monahan 1992). F has the order `bandwidth`.
    """
    from scipy import linalg, signal

    for part in _parts(len(Z), series):
        own, rows = error[part], part.stop - part.start
        lagged = np.array([own[: rows - lag] @ own[lag:] for lag in range(min(bandwidth(rows), rows - 1) + 1)])
        if lagged.size > 1 and lagged[1] < -_BLUE * lagged[0]:
            law = np.concatenate([[1.0], -linalg.solve_toeplitz(lagged[:-1], lagged[1:])])
            Z, J, error = Z.copy(), J.copy(), error.copy()
            Z[part] = signal.lfilter([1.0], law, Z[part][::-1], axis=0)[::-1]
            J[part], error[part] = signal.lfilter(law, [1.0], J[part], axis=0), signal.lfilter(law, [1.0], own)
    return Z, J, error


def larger(first: Covariance, second: Covariance) -> Covariance:
    """Return the smallest covariance above both.

    In the parameters in which the first is the identity and the second diagonal, take the larger diagonal.
    """
    std = np.where(first.std > 0, first.std, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (first.correlation + first.correlation.T))
    kept = values > _SINGULAR * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    other = whiten.T @ (second.matrix / np.outer(std, std)) @ whiten
    sizes, directions = np.linalg.eigh(0.5 * (other + other.T))
    factor = root @ directions * np.sqrt(np.maximum(sizes, 1.0))
    found = covariance_of(factor @ factor.T, first.bandwidth)
    return replace(found, std=found.std * std)


def residual_left_out(
    Z: FloatArray, J: FloatArray, error: FloatArray, spread: FloatArray, block: NDArray[np.intp]
) -> FloatArray:
    """Leave-out residual, (rows,), of each block of rows.

    ``(I - J_b S Z_b')^-1 = I + J_b (I - S Z_b' J_b)^-1 S Z_b'`` needs small inverses only.

    Z, J and error as for `sandwich`; `spread`, (parameters, parameters), is the inverse of Z' J, and `block`, (rows,),
    the block index of each row.
    """
    sorts = bool(np.any(block[1:] < block[:-1]))
    order: NDArray[np.intp] | slice = np.argsort(block, kind="stable") if sorts else slice(None)
    Z, slopes, before, block = Z[order], J[order], error[order], block[order]
    first = np.flatnonzero(np.diff(block, prepend=block[0] - 1))

    def add_blocks(rows: FloatArray) -> FloatArray:
        return np.add.reduceat(rows, first)

    shares = _products(Z, slopes, first)
    scores = add_blocks(Z * before[:, np.newaxis])
    moved = np.linalg.pinv(np.eye(len(spread)) - spread @ shares, _LOST) @ (spread @ scores[..., np.newaxis])
    rows = np.diff(first, append=len(block))
    after = before + np.einsum("ij,ij->i", slopes, np.repeat(moved[..., 0], rows, axis=0))
    # A block that a parameter rests on alone, as the first does for the initial state, cannot be left out.
    kept = np.repeat(add_blocks(after**2) <= _MOST**2 * add_blocks(before**2), rows)
    found = np.empty_like(error)
    found[order] = np.where(kept, after, before)
    return found


def _products(Z: FloatArray, J: FloatArray, first: NDArray[np.intp]) -> FloatArray:
    """Return ``Z_b' J_b`` of each block, (blocks, parameters, parameters).

    Blocks of equal length are multiplied together.
    """
    lengths = np.diff(first, append=len(Z))
    found = np.empty((len(first), Z.shape[1], J.shape[1]))
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        rows = first[same][:, np.newaxis] + np.arange(length)
        found[same] = Z[rows].transpose(0, 2, 1) @ J[rows]
    return found


def with_bands(
    covariance: Covariance, Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1
) -> Covariance:
    """Raise the deviations of a covariance to `band_deviations`."""
    return replace(covariance, std=np.maximum(covariance.std, band_deviations(Z, J, error, equations)))


def band_deviations(Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1) -> FloatArray:
    """Standard deviations from scores by frequency band, (parameters,); see `sandwich`."""
    influences, norms = _influences_by_frequency(Z, J, error, equations)
    energy = np.cumsum(np.sum(np.abs(np.fft.rfft(error.reshape(equations, -1), axis=1)) ** 2, axis=0))
    edges = np.searchsorted(energy, energy[-1] * np.arange(1, _BANDS) / _BANDS)
    # A line of the spectrum may fill several bands, of which all but one are then empty.
    sums = np.add.reduceat(influences, np.unique(np.append(0, edges)), axis=0)
    # The sum over all bands is what the estimate made 0, so one of them is not free.
    return np.asarray(np.sqrt(_BANDS / (_BANDS - 1) * np.sum(sums**2, axis=0)) / norms)


def _influences_by_frequency(
    Z: FloatArray, J: FloatArray, error: FloatArray, equations: int
) -> tuple[FloatArray, FloatArray]:
    """Return the influence of each frequency, (frequencies, parameters), times the norms of the columns, and these."""
    norms = column_norms(Z)
    columns = np.fft.rfft((Z / norms).reshape(equations, -1, Z.shape[1]), axis=1)
    spectrum = np.fft.rfft(error.reshape(equations, -1), axis=1)
    scores = np.sum(np.real(np.conj(columns) * spectrum[..., np.newaxis]), axis=0) * (2 * equations / error.size)
    return scores @ np.linalg.pinv((Z / norms).T @ (J / norms)).T, norms


def with_measured_motion(
    covariance: Covariance, Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1
) -> Covariance:
    """Widen the deviations of an estimate along a measured motion for a force in the loop.

    The loop answers to a force d, so columns along the measured motion contain it: the scores ``J' e`` have a mean,
    which falls where the force and not the reference moves the motor. Their sum over all frequencies is 0 by the
    estimate, so the bias is of the size of the largest partial sum::

        b = max over F of |(Z' J)^-1  sum over f <= F of Re(Z(f)* e(f))|,    std^2 -> std^2 + b^2

    It is exact to first order where the force moves the motor above F alone, the reference below F alone. Noise on the
    log alone has partial sums, too (a Brownian bridge): it widens the deviations by a factor of 1.35 on the average.

    Args:
        covariance: of the estimate.
        Z: (rows, parameters), the weighted sensitivities.
        J: (rows, parameters), the sensitivities of the prediction, along the measured motion.
        error: (rows,) the residual.
        equations: number of simultaneous equations, stacked.
    """
    influences, norms = _influences_by_frequency(Z, J, error, equations)
    bias = np.max(np.abs(np.cumsum(influences, axis=0)), axis=0) / norms
    return replace(covariance, std=np.hypot(covariance.std, bias))


def rising_scores(J: FloatArray, error: FloatArray, ends: FloatArray) -> FloatArray:
    """Return the scores ``J' e`` from frequency 0 up to each of some others, (ends, parameters).

    Of parts of a record they add up to those of the whole, from which `with_measured_motion` has its bias.

    Args:
        J: (equations, rows, parameters), the derivatives.
        error: (equations, rows), the residual.
        ends: shares of the Nyquist frequency.
    """
    scores = np.sum(np.real(np.conj(np.fft.rfft(J, axis=1)) * np.fft.rfft(error, axis=1)[..., np.newaxis]), axis=0)
    scores[1:] *= 2.0
    if error.shape[1] % 2 == 0:
        scores[-1] *= 0.5
    last = np.floor(ends * (len(scores) - 1)).astype(np.intp)
    return np.asarray(np.cumsum(scores, axis=0)[last] / error.shape[1])
