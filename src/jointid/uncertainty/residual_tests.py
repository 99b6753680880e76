"""Test of the residual: whiteness; and the filter that makes it white.

The low-pass correlates even white noise. Therefore the spectrum between 0 and 95 % of the cut-off is
taken as that of a signal sampled at twice that frequency, white where the noise is. Its autocorrelations at lags 1 to
20 are tested together::

    Q = sum_h (sum_t e_t e_t-h)^2 / (sum_t e_t^2 e_t-h^2)        chi-square with 20 degrees of freedom

This is the Ljung-Box test for unequal variances (Diebold 1986; Lobato, Nankervis and Savin 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray

_INSIDE = 0.95  # of the cut-off: the filter is flat up to there
_LAGS = 20
_ROWS_PER_LAG = 4  # at least
_LEVEL = 0.05
_ORDER, _FLOOR = 16, 1e-2  # of the autoregressive model; of its variance, white: a stop band is not to be blown up

Filter: TypeAlias = Callable[[FloatArray], FloatArray]


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


def fit_whitener(residual: FloatArray) -> Filter:
    """Return the filter that makes a residual nearly white, of signals (rows,) or (rows, columns) alike.

    It is the prediction error of an autoregressive model of order 16, by Yule and Walker, of the residual with 1 % of
    its variance added as white noise.
    """
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    rows = residual.size
    order = min(_ORDER, rows // 4)
    products = np.array([residual[lag:] @ residual[: rows - lag] for lag in range(order + 1)]) / rows
    if not products[0] > 0:
        return lambda signals: signals
    products[0] *= 1 + _FLOOR
    weights = solve_toeplitz(products[:-1], products[1:])
    scale = math.sqrt(products[0] - weights @ products[1:])
    taps = np.concatenate([[1.0], -weights]) / scale
    return lambda signals: np.asarray(lfilter(taps, [1.0], signals, axis=0))
