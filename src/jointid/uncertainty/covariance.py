"""How far an estimate may be off: sandwich covariances that survive a residual that is not white.

For estimates that solve ``Z' e(x) = 0`` with sensitivities J = -de/dx::

    cov = (Z' J)^-1  S  (J' Z)^-1

Z = J is least squares, Z = W the instruments of DIDIM. S, the covariance of Z' e, is estimated from the scores
``Z_t e_t`` themselves with the Bartlett kernel (Newey and West 1987), so neither autocorrelation of the residual,
which the low-pass makes even of white noise, nor rows of different accuracy have to be known. The bandwidth is
``ceil(4 (n / 100)^(2/9))`` rows on each side, their rule of thumb.

A fit pulls itself towards the rows that matter most, a few reversals for the Coulomb frictions, and the residual there
is smaller than the noise was. So every block of a bandwidth's length gets the residual it would have had if it had been
left out of the fit, ``(I - J_b (Z' J)^-1 Z_b')^-1 e_b``. What repeats with the motion is not noise, and is not covered
here: `repeatable` measures it and widens.

A bandwidth so short smears the residual's spectrum over several hertz. Where a loop rings at 10 Hz and a parameter is
told by what happens at 10 Hz, half of that is missed: of 2-sigma intervals of the twin's viscous frictions 91 % hold
the truth. A stationary residual's covariance is known much better from its spectrum S, at all lags (`stationary`)::

    S_Z = sum_f S(f) Z(f)' Z(f)*

but no residual is known to be stationary, so of the two the larger is taken, in every direction (`robust`): 94-98 %
then do.

Rows of several records, one after the other, are series of their own: what is summed over time is summed within each,
and the sums are added.

The textbook's covariance, ``s^2 (J' J)^-1``, is kept beside it (`white`): where the two differ, the residual is not
white, or not as large everywhere, and only the robust one is honest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.messages import Message

_MOST = 2.0  # times its residual: what leaving a block out may make of it
_SINGULAR = 1e-10  # of the largest: a direction whose variance is rounding
_LOST = 1e-6  # of the largest: a direction that a block of rows tells alone
_DIFFERENT = 1.25  # a ratio of deviations that chance does not make of a white residual: it stays within about 10 %


class Dependence(StrEnum):
    """What a residual is not."""

    NOT_INDEPENDENT = "not_independent"


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """What is known of the errors of an estimate.

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


def covariance_of(matrix: FloatArray, lags: int) -> Covariance:
    """Return a matrix of covariances, (parameters, parameters), as deviations and correlations.

    `lags` are the rows on each side whose correlation was taken in.
    """
    std = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(std > 0, std, 1.0)
    return Covariance(std, matrix / np.outer(scale, scale), lags)


def white(J: FloatArray, error: FloatArray) -> Covariance:
    """Return the covariance of least squares whose residual is white, ``s^2 (J' J)^-1``.

    Args:
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) what remains; ``s^2 = ||error||^2 / (rows - parameters)``.
    """
    norms = column_norms(J)
    variance = float(error @ error) / max(error.size - J.shape[1], 1)
    R = np.linalg.qr(J / norms, mode="r")  # of J' J only the square of its condition number would be left
    inverse = np.linalg.pinv(R)
    found = covariance_of(variance * inverse @ inverse.T, 0)
    return Covariance(found.std / norms, found.correlation, 0)


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
        error: (rows,) what remains.
        equations: rows hold so many equations one after the other, which share their instants.
        series: rows of each record, where several stand one after the other.
    """
    norms = column_norms(Z)
    Z, J = Z / norms, J / norms
    spread = np.asarray(np.linalg.pinv(Z.T @ J), dtype=np.float64)
    parts = _parts(len(Z), series)
    widths = [min(bandwidth(n), n - 1) for n in ((part.stop - part.start) // equations for part in parts)]
    meat = np.zeros_like(spread)
    for part, lags in zip(parts, widths, strict=True):
        meat += _over_time(Z[part], J[part], error[part], spread, equations, lags)
    found = covariance_of(spread @ meat @ spread.T, max(widths))
    return Covariance(found.std / norms, found.correlation, max(widths))


def _over_time(
    Z: FloatArray, J: FloatArray, error: FloatArray, spread: FloatArray, equations: int, lags: int
) -> FloatArray:
    """Return one record's share of the covariance of Z' e, with so many lags, (parameters, parameters)."""
    rows, count = Z.shape
    instants = rows // equations
    block = np.tile(np.arange(instants) // max(lags, 1), equations)
    left_out = residual_left_out(Z, J, error, spread, block)
    scores = np.sum((Z * left_out[:, np.newaxis]).reshape(equations, instants, count), axis=0)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        together = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (lags + 1)) * (together + together.T)
    return np.asarray(meat)


def _parts(rows: int, series: Sequence[int] | None) -> list[slice]:
    """Return the rows of each record."""
    ends = np.cumsum(series or [rows])
    return [slice(int(end) - n, int(end)) for end, n in zip(ends, series or [rows], strict=True)]


def stationary(Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None) -> Covariance:
    """Return the covariance for a residual that is stationary, by its spectrum (see the module).

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) what remains, in the order of time. Its periodogram is averaged over sqrt(rows) neighbours, the
            mean left out, which a fit of an offset takes away.
        series: rows of each record, where several stand one after the other; each has a spectrum of its own.
    """
    norms = column_norms(Z)
    Z, J = Z / norms, J / norms
    spread = np.linalg.pinv(Z.T @ J)
    meat = sum(_by_spectrum(Z[part], error[part]) for part in _parts(len(Z), series))
    found = covariance_of(spread @ meat @ spread.T, len(Z))
    return Covariance(found.std / norms, found.correlation, len(Z))


def _by_spectrum(Z: FloatArray, error: FloatArray) -> FloatArray:
    """Return one record's share of the covariance of Z' e by its residual's spectrum, (parameters, parameters)."""
    rows, count = len(Z), int(np.sum(np.any(Z != 0.0, axis=0)))
    half = max(math.isqrt(rows) // 2, 1)
    periodogram = np.abs(np.fft.rfft(error)[1:]) ** 2 / max(rows - count, 1)
    half = min(half, periodogram.size - 1)
    padded = np.pad(periodogram, half, "reflect")
    spectrum = np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
    spectrum = np.concatenate([spectrum[:1], spectrum])
    # Half a spectrum: every frequency but the first, and the last of an even number of rows, stands for two.
    both = np.full(spectrum.size, 2.0)
    both[[0, -1]] = 1.0, 2.0 if rows % 2 else 1.0
    seen = np.fft.rfft(Z, axis=0)
    return np.asarray(np.real(((both * spectrum)[:, np.newaxis] * seen.conj()).T @ seen) / rows)


def robust(Z: FloatArray, J: FloatArray, error: FloatArray, series: Sequence[int] | None = None) -> Covariance:
    """Return the larger of `sandwich` and `stationary`, in every direction.

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) what remains, in the order of time.
        series: rows of each record, where several stand one after the other.
    """
    return larger(sandwich(Z, J, error, series=series), stationary(Z, J, error, series))


def larger(first: Covariance, second: Covariance) -> Covariance:
    """Return the smallest covariance of its kind above both: in every direction that tells them apart the larger.

    In the parameters in which the first is the identity and the second diagonal, the larger of the two diagonals. No
    weighted sum of the parameters is then known better than either says.
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
    return Covariance(found.std * std, found.correlation, first.bandwidth)


def residual_left_out(
    Z: FloatArray, J: FloatArray, error: FloatArray, spread: FloatArray, block: NDArray[np.intp]
) -> FloatArray:
    """Return the residual, (rows,), that each block of rows had if it had been left out of the fit.

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) what remains.
        spread: (parameters, parameters), the inverse of Z' J.
        block: (rows,) the number of each row's block.

    The small matrix of ``(I - J_b S Z_b')^-1 = I + J_b (I - S Z_b' J_b)^-1 S Z_b'`` is inverted: a block may be long.
    """
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=block[order[0]] - 1))
    Z, slopes, before = Z[order], J[order], error[order]

    def summed(rows: FloatArray) -> FloatArray:
        return np.add.reduceat(rows, first)

    shares = np.empty((len(first), *spread.shape))  # Z_b' J_b
    for i, column in enumerate(slopes.T):
        shares[:, :, i] = summed(Z * column[:, np.newaxis])
    told = summed(Z * before[:, np.newaxis])
    moved = _inverses(np.eye(len(spread)) - spread @ shares) @ (spread @ told[..., np.newaxis])
    rows = np.diff(first, append=len(order))
    after = before + np.sum(slopes * np.repeat(moved[..., 0], rows, axis=0), axis=1)
    # A block that a parameter rests on alone, as the first does for the initial state, cannot be left out.
    kept = np.repeat(summed(after**2) <= _MOST**2 * summed(before**2), rows)
    found = error.copy()
    found[order[kept]] = after[kept]
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

    This asks more than whether the residual is white within the filter's pass band (`residuals.Whiteness`), and can
    differ from it: rows that are closer than the band needs are correlated, and rows at reversals are louder.

    The rule: a robust deviation at least 1.25 times the white one, or at most that share of it. Chance alone keeps
    the ratio of a white residual's within about 10 % at the rows of a usual record.
    """
    ratios = robust.std / np.where(naive.std > 0, naive.std, np.inf)
    off = [(name, ratio) for name, ratio in zip(names, ratios, strict=True) if _differs(float(ratio))]
    if not off:
        return None
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in off)
    said = (
        "row by row the residual is not independent noise of one size, which asks more than whiteness within the pass "
        f"band: the robust deviations are these times those that such noise would give: {listed}"
    )
    return Message(Dependence.NOT_INDEPENDENT, said, {"ratios": {name: float(ratio) for name, ratio in off}})


def _differs(ratio: float) -> bool:
    return ratio > 0 and not 1 / _DIFFERENT < ratio < _DIFFERENT


def words(covariance: Covariance) -> str:
    """Return what the standard deviations are, in a sentence."""
    return (
        f"autocorrelation-robust (Newey-West over {covariance.bandwidth} rows on each side); what repeats with the "
        "motion, as on most real axes, is not covered"
    )
