"""Covariances of an estimate that hold where the residual is not white.

For estimates that solve ``Z' e(x) = 0`` with sensitivities J = -de/dx::

    cov = (Z' J)^-1  S  (J' Z)^-1

Z = J is least squares, Z = W the instruments of DIDIM. S, the covariance of Z' e, is estimated from the scores
``Z_t e_t`` themselves with the Bartlett kernel (Newey and West 1987), so neither autocorrelation of the residual,
which the low-pass makes even of white noise, nor rows of different accuracy have to be known. The bandwidth is
``ceil(4 (n / 100)^(2/9))`` rows on each side, their rule of thumb.

A fit pulls itself towards the rows that matter most, a few reversals for the Coulomb frictions, and the residual there
is smaller than the noise was. So every block of a bandwidth's length gets the residual it would have had if it had been
left out of the fit, ``(I - J_b (Z' J)^-1 Z_b')^-1 e_b``. What repeats with the motion is not noise, and is not covered
here: `position_dependent_error` measures it and widens.

A bandwidth so short smears the residual's spectrum over several hertz. Where a loop rings at 10 Hz and a parameter is
determined by what happens at 10 Hz, half of that is missed: of 2-sigma intervals of the twin's viscous frictions 91 %
hold the truth. A stationary residual's covariance is known much better from its spectrum, at all lags (`spectral`),
but no residual is known to be stationary, so of the two the larger is taken, in every direction (`robust`): 94-98 %
then do.

Rows of several records, one after the other, are series of their own: what is summed over time is summed within each,
and the sums are added.

The textbook's covariance, ``s^2 (J' J)^-1``, is kept beside it (`white`): where the two differ, the residual is not
white, or not as large everywhere, and only the robust one is honest.

Neighbouring rows show noise. What a model lacks - a friction that is no Coulomb's, a current loop, a second mode -
repeats with the motion and is as large at the end of a long record as at its beginning; but it changes with
frequency. So `band_deviations` sums the scores over bands of frequency that hold equal shares of the residual; the
spread of these sums is what the estimate owes to the choice of the band. The larger of both deviations is reported
(`with_bands`): with noise alone they agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.messages import Message
from jointid.uncertainty.spectral import spectral_covariance

_BANDS = 8  # of frequency, whose scores are compared
_MOST = 2.0  # times its residual: what leaving a block out may make of it
_SINGULAR = 1e-10  # of the largest: a direction whose variance is rounding
_LOST = 1e-6  # of the largest: a direction that a block of rows determines alone
_DIFFERENT = 1.25  # a ratio of deviations that chance does not make of a white residual: it stays within about 10 %


class Dependence(StrEnum):
    """Properties of white noise that a residual lacks."""

    NOT_INDEPENDENT = "not_independent"


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
        """Return the standard deviation of a weighted sum of the parameters, weights (parameters,)."""
        weighted = np.asarray(weights) * self.std
        return math.sqrt(max(float(weighted @ self.correlation @ weighted), 0.0))


def covariance_of(matrix: FloatArray, lags: int, scale: FloatArray | float = 1.0) -> Covariance:
    """Return a matrix of covariances, (parameters, parameters), as deviations and correlations.

    Args:
        matrix: of the parameters, or of the scaled ones.
        lags: rows on each side whose correlation was taken in.
        scale: (parameters,) what the parameters were multiplied with.
    """
    std = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    positive = np.where(std > 0, std, 1.0)
    return Covariance(std / scale, matrix / np.outer(positive, positive), lags)


def white(J: FloatArray, error: FloatArray) -> Covariance:
    """Return the covariance of least squares whose residual is white, ``s^2 (J' J)^-1``.

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
    """Return the autocorrelation-robust covariance (see the module).

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual.
        equations: rows hold so many equations one after the other, which share their instants.
        series: rows of each record, where several stand one after the other.
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
    """Return ``(Z' J)^-1 S (J' Z)^-1``, computed with the columns of Z and J divided by the lengths of Z's.

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        meat: S, (parameters, parameters), from Z and J as they were divided and the inverse of their product.
        lags: rows on each side whose correlation is taken in.
    """
    norms = column_norms(Z)
    Z, J = Z / norms, J / norms
    spread = np.asarray(np.linalg.pinv(Z.T @ J), dtype=np.float64)
    return covariance_of(spread @ meat(Z, J, spread) @ spread.T, lags, norms)


def bartlett_sum(scores: FloatArray, lags: int) -> FloatArray:
    """Return the covariance, (parameters, parameters), of the sum of scores that are correlated with neighbours.

    Args:
        scores: (neighbours, parameters), or (neighbours, families, parameters) of families that are independent.
        lags: neighbours on each side that are correlated with one, with Bartlett's weights.
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
    """Return the covariance for a residual that is stationary, by its spectrum in bands (see `spectral`).

    The arguments are those of `sandwich`, the residual in the order of time. The deviations are Student's: two of them
    hold as much as two of a normal error would.
    """
    norms = column_norms(Z)
    spread = np.linalg.pinv((Z / norms).T @ (J / norms))
    matrix, factor = spectral_covariance((Z / norms) @ spread.T, J / norms, error, _parts(len(Z), series))
    return covariance_of(matrix * np.outer(factor, factor), len(Z), norms)


def stationary(Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None) -> Covariance:
    """Return what an error of this spectrum would make of other equations than those that left it.

    ``S = sum_f S(f) Z(f)' Z(f)*``; what a fit took out of the spectrum is not allowed for. The arguments are those of
    `sandwich`, the error in the order of time. Its periodogram is averaged over sqrt(rows) neighbours, the mean left
    out, which a fit of an offset takes away; every series has its own spectrum.
    """

    def meat(Z: FloatArray, _: FloatArray, spread: FloatArray) -> FloatArray:
        found = np.zeros_like(spread)
        for part in _parts(len(Z), series):
            columns = Z[part]
            used = int(np.sum(np.any(columns != 0.0, axis=0)))
            spectrum, both = smoothed_spectrum(error[part], max(len(columns) - used, 1))
            found += sum_over_frequencies(columns, np.concatenate([spectrum[:1], both * spectrum])) / len(columns)
        return found

    return scaled_sandwich(Z, J, meat, len(Z))


def smoothed_spectrum(signal: FloatArray, degrees: int) -> tuple[FloatArray, FloatArray]:
    """Return the spectrum of a signal of so many degrees of freedom, and how many frequencies each value stands for.

    Both are (samples // 2,), the mean left out. The periodogram is averaged over sqrt(samples) neighbours. In half a
    spectrum every frequency stands for two, but the last of an even number of samples.
    """
    periodogram = np.abs(np.fft.rfft(signal)[1:]) ** 2 / degrees
    half = min(max(math.isqrt(signal.size) // 2, 1), periodogram.size - 1)
    padded = np.pad(periodogram, half, "reflect")
    both = np.full(periodogram.size, 2.0)
    both[-1] = 2.0 if signal.size % 2 else 1.0
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
    """Return the larger of `sandwich` and `by_spectrum` in every direction; the arguments are theirs.

    The spectrum of each of several equations of one record is its own: what they share is seen by `sandwich` alone.
    """
    own = [len(Z) // equations] * equations if equations > 1 else series
    return larger(sandwich(Z, J, error, equations, series), by_spectrum(Z, J, error, own))


def larger(first: Covariance, second: Covariance) -> Covariance:
    """Return the smallest covariance of its kind above both: the larger in every direction that distinguishes them.

    In the parameters in which the first is the identity and the second diagonal, the larger of the two diagonals. No
    weighted sum of the parameters is then known better than by either.
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
    """Return the residual, (rows,), that each block of rows had if it had been left out of the fit.

    Beside the arguments of `sandwich`, `spread` is the inverse of Z' J, (parameters, parameters), and `block`, (rows,),
    the number of each row's block.

    The small matrix of ``(I - J_b S Z_b')^-1 = I + J_b (I - S Z_b' J_b)^-1 S Z_b'`` is inverted: a block may be long.
    """
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=block[order[0]] - 1))
    Z, slopes, before = Z[order], J[order], error[order]

    def summed(rows: FloatArray) -> FloatArray:
        return np.add.reduceat(rows, first)

    shares = _products(Z, slopes, first)
    told = summed(Z * before[:, np.newaxis])
    moved = _inverses(np.eye(len(spread)) - spread @ shares) @ (spread @ told[..., np.newaxis])
    rows = np.diff(first, append=len(order))
    after = before + np.einsum("ij,ij->i", slopes, np.repeat(moved[..., 0], rows, axis=0))
    # A block that a parameter rests on alone, as the first does for the initial state, cannot be left out.
    kept = np.repeat(summed(after**2) <= _MOST**2 * summed(before**2), rows)
    found = error.copy()
    found[order[kept]] = after[kept]
    return found


def _products(Z: FloatArray, J: FloatArray, first: NDArray[np.intp]) -> FloatArray:
    """Return ``Z_b' J_b`` of each block of rows, (blocks, parameters, parameters), by where the blocks begin.

    Blocks of the same length, which are all but a few, are multiplied at once.
    """
    lengths = np.diff(first, append=len(Z))
    found = np.empty((len(first), Z.shape[1], J.shape[1]))
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        rows = first[same][:, np.newaxis] + np.arange(length)
        found[same] = Z[rows].transpose(0, 2, 1) @ J[rows]
    return found


def _inverses(matrices: FloatArray) -> FloatArray:
    """Return pseudo-inverses, (matrices, n, n); of a matrix far from singular the inverse, which costs a tenth."""
    try:
        found = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrices, rcond=_LOST))
    condition = np.linalg.norm(matrices, axis=(1, 2)) * np.linalg.norm(found, axis=(1, 2))  # not below the true one
    near = ~(condition < 1 / _LOST)
    found[near] = np.linalg.pinv(matrices[near], rcond=_LOST)
    return np.asarray(found)


def different(names: Sequence[str], naive: Covariance, robust: Covariance) -> Message | None:
    """Return a message on the parameters whose deviation a white residual would misjudge, or None.

    This asks more than whether the residual is white within the filter's pass band (`residual_tests.Whiteness`), and
    can differ from it: rows that are closer than the band needs are correlated, and rows at reversals are louder.

    The rule: a robust deviation at least 1.25 times the white one, or at most that share of it. Chance alone keeps
    the ratio of a white residual's within about 10 % at the rows of a usual record.
    """
    ratios = map(float, robust.std / np.where(naive.std > 0, naive.std, np.inf))
    off = {
        name: ratio
        for name, ratio in zip(names, ratios, strict=True)
        if ratio > 0 and not 1 / _DIFFERENT < ratio < _DIFFERENT
    }
    if not off:
        return None
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in off.items())
    said = (
        "row by row the residual is not independent noise of one size, which asks more than whiteness within the pass "
        f"band: the robust deviations are these times those that such noise would give: {listed}"
    )
    return Message(Dependence.NOT_INDEPENDENT, said, {"ratios": off})


def words(covariance: Covariance) -> str:
    """Return how these standard deviations were obtained, in a sentence."""
    return (
        f"autocorrelation-robust (Newey-West over {covariance.bandwidth} rows on each side); what repeats with the "
        "motion, as on most real axes, is not covered"
    )


def with_bands(
    covariance: Covariance, Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1
) -> Covariance:
    """Return a covariance whose deviations are no smaller than `band_deviations` of the same arguments."""
    return replace(covariance, std=np.maximum(covariance.std, band_deviations(Z, J, error, equations)))


def band_deviations(Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1) -> FloatArray:
    """Return standard deviations from the scores by bands of frequency, (parameters,), of what `sandwich` takes."""
    norms = column_norms(Z)
    columns = np.fft.rfft((Z / norms).reshape(equations, -1, Z.shape[1]), axis=1)
    spectrum = np.fft.rfft(error.reshape(equations, -1), axis=1)
    each = np.real(np.conj(columns) * spectrum[..., np.newaxis])
    energy = np.cumsum(np.sum(np.abs(spectrum) ** 2, axis=0))
    scores = np.sum(each, axis=0) * (2 * equations / error.size)
    edges = np.searchsorted(energy, energy[-1] * np.arange(1, _BANDS) / _BANDS)
    sums = np.add.reduceat(scores, np.concatenate([[0], np.maximum.accumulate(edges)]), axis=0)
    spread = np.linalg.pinv((Z / norms).T @ (J / norms))
    influences = sums @ spread.T
    # The sum over all bands is what the estimate made 0, so one of them is not free.
    return np.asarray(np.sqrt(_BANDS / (_BANDS - 1) * np.sum(influences**2, axis=0)) / norms)


def band_words() -> str:
    """Return what these deviations cover, in a sentence."""
    return f"or, where it is larger, the spread over {_BANDS} bands of frequency, which shows what the model lacks"
