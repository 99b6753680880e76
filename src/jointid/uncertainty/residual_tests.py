"""Tests of the residual: whiteness, coupling to other axes.

**Whiteness.** The low-pass correlates even white noise. Therefore the spectrum between 0 and 95 % of the cut-off is
taken as that of a signal sampled at twice that frequency, white where the noise is. Its autocorrelations at lags 1 to
20 are tested together::

    Q = sum_h (sum_t e_t e_t-h)^2 / (sum_t e_t^2 e_t-h^2)        chi-square with 20 degrees of freedom

This is the Ljung-Box test for unequal variances (Diebold 1986; Lobato, Nankervis and Savin 2001).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.uncertainty.position_dependent_error import Repeatable

_INSIDE = 0.95  # of the cut-off: the filter is flat up to there
_LAGS = 20
_ROWS_PER_LAG = 4  # at least
_LEVEL = 0.05
_SHIFTS = 200  # of other axes against the residual: enough for a 95 % quantile
_BY_CHANCE = 0.95  # quantile of what is explained where there is no coupling
_APART = 0.05  # of the record: shifts by less still see the same motion


@dataclass(frozen=True, slots=True)
class Whiteness:
    """A test of the residual's autocorrelation within the filter's pass band.

    Attributes:
        p_value: how often white noise gives as much.
    """

    statistic: float
    lags: int
    p_value: float

    @property
    def white(self) -> bool:
        """True if nothing speaks against white noise, at 5 %."""
        return self.p_value > _LEVEL

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        verdict = "is white as far as this record tells" if self.white else "is not white"
        how = f"Q = {self.statistic:.1f} of {self.lags} lags, p = {self.p_value:.2g}"
        return f"within the pass band the residual {verdict} ({how})"


@dataclass(frozen=True, slots=True)
class ResidualReport:
    """Tests of the residual torque.

    Attributes:
        whiteness: within the pass band; None where the record is too short.
        repeatable: the part of it that repeats with the motion; None where the motion was not given.
    """

    whiteness: Whiteness | None
    repeatable: Repeatable | None


def whiteness(error: FloatArray, sample_time: float, cutoff: float) -> Whiteness | None:
    """Test the autocorrelation of a residual (see the module); None with too few rows.

    Args:
        error: (rows,) filtered and decimated residual.
        sample_time: seconds between rows.
        cutoff: Hz, of the filter.
    """
    from scipy.stats import chi2

    e = _within(error, sample_time, cutoff)
    if e.size < _ROWS_PER_LAG * _LAGS or not np.any(e):
        return None
    products = [e[lag:] * e[:-lag] for lag in range(1, _LAGS + 1)]
    statistic = float(sum(np.sum(p) ** 2 / np.sum(p**2) for p in products))
    return Whiteness(statistic, _LAGS, float(chi2.sf(statistic, _LAGS)))


def _within(error: FloatArray, sample_time: float, cutoff: float) -> FloatArray:
    """Resample a residual to its pass band."""
    spectrum = np.fft.rfft(error - error.mean())
    highest = min(_INSIDE * cutoff, 0.5 / sample_time)
    # The last frequency is left out, which at half the sampling frequency has no phase.
    kept = min(math.floor(highest * error.size * sample_time), spectrum.size - 2)
    if kept < 1:
        return np.zeros(0)
    return np.asarray(np.fft.irfft(spectrum[: kept + 1], 2 * kept + 1))


@dataclass(frozen=True, slots=True)
class Coupling:
    """Share of a residual's variance that is correlated with other axes.

    Attributes:
        explained: share, 0 to 1.
        by_chance: share that is explained, in 95 of 100 cases, where there is no coupling.
    """

    explained: float
    by_chance: float

    @property
    def seen(self) -> bool:
        """True if more is explained than by chance."""
        return self.explained > self.by_chance


def coupling(residual: FloatArray, motion: FloatArray) -> Coupling:
    """Share of a residual that other axes' motion explains, by least squares.

    Circular shifts of the motion keep both spectra and give the 95 % quantile by chance; the F test would need a white
    residual.

    Args:
        residual: (rows,) of the filtered torque.
        motion: (rows, columns) of the other axes, filtered alike.
    """
    from scipy.fft import irfft, rfft  # of a length with large prime factors, in half of NumPy's time

    left = residual - residual.mean()
    Q = orthonormal_basis(motion - motion.mean(axis=0), 1e-10)
    total = float(left @ left)
    if total == 0.0 or Q.shape[1] == 0:
        return Coupling(0.0, 1.0)
    apart = max(int(_APART * left.size), 1)
    shifts = np.unique(np.linspace(apart, left.size - apart, _SHIFTS).astype(np.int64))
    products = rfft(Q, axis=0) * rfft(left).conj()[:, np.newaxis]
    shares = np.sum(irfft(products, left.size, axis=0)[shifts] ** 2, axis=1) / total
    return Coupling(float(np.sum((Q.T @ left) ** 2)) / total, float(np.quantile(shares, _BY_CHANCE)))
