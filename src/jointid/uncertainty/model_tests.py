"""Model tests: residual whiteness, flexible against rigid, least squares against instruments.

**Whiteness.** The low-pass correlates even white noise. Therefore the spectrum between 0 and 95 % of the cut-off is
taken as that of a signal sampled at twice that frequency, white where the noise is. Its autocorrelations at lags 1 to
20 are tested together::

    Q = sum_h (sum_t e_t e_t-h)^2 / (sum_t e_t^2 e_t-h^2)        chi-square with 20 degrees of freedom

This is the Ljung-Box test for unequal variances (Diebold 1986; Lobato, Nankervis and Savin 2001).

**Flexible against rigid.** The compliance of a rigid joint, 0, lies on a boundary, and load share and damping are
undefined there, so the usual quantiles of the likelihood-ratio test do not hold. Their distribution is simulated. About
the rigid fit the residual is ``r + J a + E b, b >= 0``, with J its derivatives by the rigid parameters and E by the
extra one at the boundary (such as the compliance at a load share). The statistic is the reduction of the sum of squares
over the variance of the remainder, for the best of several E if the share is unknown. The draws turn the signs of
blocks of the larger model's residual (wild bootstrap, Liu 1988), over time and over stretches of the motion; the larger
p-value counts, so that repeatable errors are not taken for a spring. E should have the whole friction on the motor's
side, or a compliance also delays the friction at reversals.

**Least squares against instruments** (Durbin, Wu, Hausman 1978). Both agree for a true model except for noise. A model
error separates them, and so do columns that are correlated with the error. The other solution is a step away,

    d = (Z' J)^-1 Z' e = ((Z' J)^-1 Z' - (J' J)^-1 J') n

*Endogeneity* of IDIM's columns is tested by whether d is significant. On a good encoder quantisation alone makes
significant shifts below 0.05 deviations. Therefore d is compared with its own covariance and a tenth of the deviations
of least squares, ``T = d' (cov(d) + 0.01 cov(x))^-1 d``, which is conservative. *A second solution*, whose columns are
those of the simulated motion, covers model error: where a parameter's d exceeds two of its deviations, d is added to
its deviation. A model error that moves both solutions alike is not detected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms, orthonormal_basis
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.uncertainty.covariance import (
    INTERVAL,
    LEVEL,
    ROUNDING,
    Covariance,
    Influence,
    bandwidth,
    bartlett_sum,
    covariance_of,
    larger,
)
from jointid.uncertainty.position_dependent_error import Cells, Uncertainty

_LAGS = 20

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
        return self.p_value > LEVEL

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        verdict = "is white as far as this record shows" if self.white else "is not white"
        how = f"Q = {self.statistic:.1f} of {self.lags} lags, p = {self.p_value:.2g}"
        return f"within the pass band the residual {verdict} ({how})"


def whiteness(error: FloatArray, sample_time: float, cutoff: float) -> Whiteness | None:
    """Test the autocorrelation of a residual; None with too few rows.

    Args:
        error: (rows,) filtered and decimated residual.
        sample_time: seconds between rows.
        cutoff: Hz, of the filter.
    """
    from scipy.stats import chi2

    e = _within(error / (np.max(np.abs(error)) or 1.0), sample_time, cutoff)  # squares of rounding are 0
    if e.size < 4 * _LAGS or not np.any(e):
        return None
    products = [e[lag:] * e[:-lag] for lag in range(1, _LAGS + 1)]
    statistic = float(sum(np.sum(p) ** 2 / np.sum(p**2) for p in products))
    return Whiteness(statistic, _LAGS, float(chi2.sf(statistic, _LAGS)))


def _within(error: FloatArray, sample_time: float, cutoff: float) -> FloatArray:
    """Resample a residual to its pass band."""
    spectrum = np.fft.rfft(error - error.mean())
    highest = min(0.95 * cutoff, 0.5 / sample_time)  # of the cut-off: the filter is flat up to there
    # The last frequency is left out, which at half the sampling frequency has no phase.
    kept = min(math.floor(highest * error.size * sample_time), spectrum.size - 2)
    if kept < 1:
        return np.zeros(0)
    return np.asarray(np.fft.irfft(spectrum[: kept + 1], 2 * kept + 1))


def fit_whitener(residual: FloatArray) -> Filter:
    """Filter that whitens a residual, for signals (rows,) or (rows, columns).

    It is the prediction error of an autoregressive model of order 16, by Yule and Walker, of the residual with 1 % of
    its variance added as white noise.
    """
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    rows = residual.size
    order = min(16, rows // 4)  # of the autoregressive model
    products = np.array([residual[lag:] @ residual[: rows - lag] for lag in range(order + 1)]) / rows
    if not products[0] > 0:
        return lambda signals: signals
    products[0] *= 1 + 1e-2  # white: a stop band is not to be blown up
    weights = solve_toeplitz(products[:-1], products[1:])
    scale = math.sqrt(products[0] - weights @ products[1:])
    taps = np.concatenate([[1.0], -weights]) / scale
    return lambda signals: np.asarray(lfilter(taps, [1.0], signals, axis=0))


def flexible_against_rigid(
    residual: FloatArray,
    J: FloatArray,
    extra: Sequence[FloatArray],
    where: Cells | None = None,
    fitted: float | None = None,
    *,
    draws: int = 1999,
) -> Message:
    """Test whether a non-negative extra direction explains more than chance.

    The code says whether the record asks for the "flexible" model, at 1 %, or the "rigid" one will do. The values are
    the ``statistic``, the reduction of the sum of squares over the variance of the remainder; the ``p_value``; and what
    the sum of squares ``gained``, as a share.

    Args:
        residual: (rows,) of the rigid fit, in the order of time.
        J: (rows, rigid), its derivatives by the rigid parameters.
        extra: alternatives, (rows, 1) each: derivative by the parameter that is 0 at the boundary.
        where: the rows' cells, to account for repeatable errors.
        fitted: sum of squares of a flexible fit, in place of the linear one.
        draws: of the signs.
    """
    Q, E = orthonormal_basis(J, ROUNDING), np.hstack(extra)
    beside = E - Q @ (Q.T @ E)
    sizes = column_norms(beside)
    beside = np.where(sizes > ROUNDING * np.linalg.norm(E, axis=0), beside / sizes, 0.0)  # else rounding, or no number
    degrees = max(residual.size - J.shape[1] - 1, 1)
    rigid = float(residual @ residual - np.sum((Q.T @ residual) ** 2))
    amounts = np.maximum(-(beside.T @ residual), 0.0)
    best = int(np.argmax(amounts))
    found = float(amounts[best] ** 2) if fitted is None else max(rigid - fitted, 0.0)
    statistic = found / max((rigid - found) / degrees, 1e-300)
    left = residual + beside[:, best] * amounts[best] - Q @ (Q.T @ residual)
    whole = Influence(np.column_stack([J, beside[:, best]]), left)

    blocks = {"time": np.arange(residual.size) // (3 * bandwidth(residual.size))}
    if where is not None:
        blocks["place"] = np.unique(where.stretch, return_inverse=True)[1].reshape(-1)
    p_values = dict[str, float]()
    for over, block in blocks.items():
        drawn = _draw_statistics(whole.residual_left_out(block), block, Q, beside, degrees, draws)
        p_values[over] = float(1 + np.sum(drawn >= statistic)) / (draws + 1)
    least_certain = max(p_values, key=lambda over: p_values[over])
    p_value, gained = p_values[least_certain], found / rigid if rigid > 0 else 0.0
    flexible = p_value <= 0.01  # a smaller p-value of a rigid joint says that it is flexible
    words = (
        f"the record {'supports' if flexible else 'does not support'} the flexible model, which reduces the sum of "
        f"squares by {number(100 * gained, 2)} % (statistic {number(statistic, 3)}, p = {p_value:.2g} by the "
        f"residual's signs over {least_certain})"
    )
    values = {"statistic": statistic, "p_value": p_value, "gained": gained}
    return Message("flexible" if flexible else "rigid", words, values)


def _draw_statistics(
    noise: FloatArray, block: NDArray[np.intp], Q: FloatArray, beside: FloatArray, degrees: int, draws: int
) -> FloatArray:
    """Statistics of noise with random block signs, (draws,)."""
    count = int(block.max()) + 1
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(draws, count))
    of_rigid, of_extra = np.zeros((count, Q.shape[1])), np.zeros((count, beside.shape[1]))
    np.add.at(of_rigid, block, Q * noise[:, np.newaxis])
    np.add.at(of_extra, block, beside * noise[:, np.newaxis])
    remaining = float(noise @ noise) - np.sum((signs @ of_rigid) ** 2, axis=1)
    gains = np.max(np.maximum(-(signs @ of_extra), 0.0) ** 2, axis=1)
    return np.asarray(gains / np.maximum((remaining - gains) / degrees, 1e-300))


def durbin_wu_hausman(W: FloatArray, Y: FloatArray, Z: FloatArray, equations: int = 1) -> float:
    """p-value of the difference between least squares and instruments.

    Args:
        W: (rows, parameters) the columns.
        Y: (rows,) the torque.
        Z: (rows, parameters) the instruments.
        equations: number of simultaneous equations, stacked.
    """
    from scipy.special import chdtrc

    W, Z = W / column_norms(W), Z / column_norms(Z)
    sizes = np.linalg.svd(W - Z @ np.linalg.lstsq(Z, W, rcond=None)[0], compute_uv=False)
    degrees = int(np.sum(sizes > max(1e-3 * sizes[0], ROUNDING)))  # smaller directions are not counted
    if degrees == 0:
        return 1.0
    least = Influence(W, Y - W @ np.linalg.lstsq(W, Y, rcond=None)[0], equations=equations)
    shift, noise = second_solution(Z, least)
    spread = noise.matrix + 0.1**2 * least.by_time().matrix  # deviations of least squares: a smaller shift is none
    return float(chdtrc(degrees, shift @ np.linalg.pinv(spread, hermitian=True) @ shift))


def second_solution(Z: FloatArray, least: Influence) -> tuple[FloatArray, Covariance]:
    """Shift from least squares to instruments, (parameters,), and its covariance by noise.

    Args:
        Z: (rows, parameters), the instruments.
        least: the equations of least squares, with one record's residual.
    """
    between = replace(least, instruments=Z).matrix - least.matrix
    instants = least.error.size // least.equations
    scores = np.sum((between * least.error).T.reshape(least.equations, instants, -1), axis=0)
    near = covariance_of(bartlett_sum(scores, bandwidth(instants)))
    return between @ least.error, larger(near, least.by_spectrum(between))


def widened_to_second(
    known: Uncertainty, Z: FloatArray, J: FloatArray, error: FloatArray, inside: NDArray[np.bool_]
) -> Uncertainty:
    """Widen an uncertainty to cover the solution by instruments (see the module).

    Args:
        known: of least squares.
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual of least squares.
        inside: (parameters,) which are not at a bound; the others stay.
    """
    shift, noise = np.zeros(inside.size), np.zeros(inside.size)
    shift[inside], covariance = second_solution(Z[:, inside], Influence(J[:, inside], error))
    noise[inside] = covariance.std
    significant = np.abs(shift) > INTERVAL * noise
    return known.widened_by(np.where(significant, shift, 0.0)) if np.any(significant) else known
