"""Covariance under stationary noise, by its spectrum in bands.

An estimate of linear equations errs by ``A n``, A its influences and n the noise, and leaves ``e = (I - J A) n``. With
the power s_b of n in a band b, the projection E_b on it, and w_b the band's degrees of freedom::

    cov = sum_b s_b A E_b A'
    E (e' E_a e) = sum_b M_ab s_b,      M_ab = (w_a - 2 tr A E_a J) [a = b] + tr (J' E_a J) (A E_b A')

Solving the second line for s_b >= 0 corrects for the degrees of freedom of the fit in each band (restricted likelihood,
Patterson and Thompson 1971). The bands are narrow, since the spectrum under a force in the loop rises towards 0, where
an offset and the total inertia are determined: four frequencies, then a quarter of the frequency, at most sqrt(rows).

**Degrees of freedom.** The power of a band is chi-square with M_bb degrees of freedom, so a deviation has those of
Satterthwaite (1946)::

    nu = 2 (h' s)^2 / var (h' s),      h_b = (A E_b A')_ii

These are few for a parameter that few frequencies determine. Half of Student's quantile then scales the deviation, so
that two deviations have the coverage of 2 sigma.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray

_FEWEST = 4  # frequencies of a band: eight degrees of freedom
_SHARE = 0.25  # of its frequency, that a band is wide
_LEFT = 1.0  # degrees of freedom that the fit leaves in a band, at least
_ROUNDING = 1e-13  # of the largest: a singular value that is none
_TWO_SIGMA = 0.9772498680518208  # of a normal distribution below two deviations


@dataclass(frozen=True, slots=True, eq=False)
class _Bands:
    """Quantities of one record by frequency band; of symmetric matrices the upper triangle, row by row.

    Attributes:
        influences: (bands, triangle) A E_b A'.
        asked: (bands, triangle), likewise of what is asked for.
        sensitivities: (bands, triangle) J' E_b J.
        left: (bands,) degrees of freedom, less twice what the fit takes.
        power: (bands,) of the residual.
    """

    influences: FloatArray
    asked: FloatArray
    sensitivities: FloatArray
    left: FloatArray
    power: FloatArray


def spectral_covariance(
    influences: FloatArray,
    J: FloatArray,
    error: FloatArray,
    parts: Sequence[slice],
    asked: FloatArray | None = None,
    spread: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance, (parameters, parameters), and Student's factors, (parameters,).

    Args:
        influences: (rows, parameters), A', of similar scale; or with a spread the instruments Z.
        J: (rows, parameters), the sensitivities of the prediction, scaled likewise.
        error: (rows,) the residual, in the order of time.
        parts: rows of each record, with their own spectra.
        asked: (rows, quantities), influences on the requested quantities, if not the estimate.
        spread: (parameters, parameters), of which the influences are ``Z spread'``.
    """
    bands = [_bands(influences, J, error, part, asked, spread) for part in parts]
    H = np.concatenate([b.influences for b in bands])
    sought = H if asked is None else np.concatenate([b.asked for b in bands])
    K = np.concatenate([b.sensitivities for b in bands])
    power = np.concatenate([b.power for b in bands])
    i, j = np.triu_indices(J.shape[1])
    M = (K * np.where(i == j, 1.0, 2.0)) @ H.T + np.diag(np.concatenate([b.left for b in bands]))
    freedom = np.maximum(np.diag(M), 1e-3)
    inverse = np.linalg.pinv(M, rcond=_ROUNDING)
    level = _solve_levels(inverse, M, power, freedom)
    size = J.shape[1] if asked is None else asked.shape[1]
    (i, j), covariance = np.triu_indices(size), np.empty((size, size))
    covariance[i, j] = covariance[j, i] = level @ sought
    answers = inverse.T @ sought[:, i == j]  # of each deviation squared, to the power of each band
    variance = 2.0 * (level**2 * freedom) @ answers**2
    known = variance > 0
    degrees = 2.0 * np.diag(covariance) ** 2 / np.where(known, variance, 1.0)
    from scipy.special import stdtrit

    return covariance, np.where(known, np.asarray(stdtrit(np.maximum(degrees, 1.0), _TWO_SIGMA) / 2.0), 1.0)


def _bands(
    Z: FloatArray, J: FloatArray, error: FloatArray, part: slice, asked: FloatArray | None, spread: FloatArray | None
) -> _Bands:
    rows = len(error[part])
    both = np.full(rows // 2 + 1, 2.0)  # in half a spectrum a frequency stands for two, but the first and an even last
    both[0] = 1.0
    both[-1] = 2.0 if rows % 2 else 1.0
    weight = np.sqrt(both / rows)

    def transform(signals: FloatArray) -> FloatArray:
        """Return half the spectra of signals, (signals, 2 frequencies), real parts beside imaginary ones."""
        columns = np.ascontiguousarray(signals[part].reshape(rows, -1).T)
        return np.asarray((weight * np.fft.rfft(columns)).view(np.float64))

    slopes, left = transform(J), transform(error)
    A = slopes if J is Z else transform(Z)
    A = A if spread is None else spread @ A
    taken = np.einsum("cf,cf->f", A, slopes).reshape(-1, 2).sum(axis=1)
    first = _borders(both - taken, rows)
    bands = [slice(*pair) for pair in zip(2 * first, [*(2 * first[1:]), A.shape[1]], strict=True)]

    def each(spectra: FloatArray) -> FloatArray:
        i, j = np.triu_indices(len(spectra))
        return np.array([spectra[:, band] @ spectra[:, band].T for band in bands])[:, i, j]

    own = each(A)
    return _Bands(
        own, own if asked is None else each(transform(asked)), each(slopes),
        np.add.reduceat(both - 2.0 * taken, first), np.add.reduceat(left[0] ** 2, 2 * first),
    )  # fmt: skip


def _borders(left: FloatArray, rows: int) -> NDArray[np.intp]:
    """First frequency of each band, for a number of residual degrees of freedom."""
    total, first = np.concatenate([[0.0], np.cumsum(left)]), [0]
    while True:
        k = first[-1]
        wide = max(_FEWEST, min(int(_SHARE * k), math.isqrt(rows)))
        after = min(k + wide, left.size)
        if total[after] < total[k] + _LEFT:
            after = max(after, int(total.searchsorted(total[k] + _LEFT)))
        if after + _FEWEST > left.size:  # what is left is the last band's
            return np.array(first)
        first.append(after)


def _solve_levels(inverse: FloatArray, M: FloatArray, power: FloatArray, freedom: FloatArray) -> FloatArray:
    """Solve for non-negative band levels, weighted by degrees of freedom."""
    from scipy.optimize import nnls

    found = inverse @ power
    if np.all(found >= 0.0):
        return np.asarray(found)
    scale = np.sqrt(freedom)
    unit = float(np.max(power)) or 1.0  # the solver has tolerances of its own
    try:
        found, _ = nnls(M / scale[:, np.newaxis], power / (unit * scale))
    except RuntimeError:  # too many iterations
        return power / freedom
    return np.asarray(unit * found)
