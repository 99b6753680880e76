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
_TWO_SIGMA = 0.9772498680518208  # of a normal distribution below two deviations


@dataclass(frozen=True, slots=True, eq=False)
class _Bands:
    """Quantities of one record by frequency band.

    Attributes:
        influences: (bands, parameters, parameters) A E_b A'.
        asked: (bands, parameters, parameters), likewise of what is asked for.
        sensitivities: (bands, parameters, parameters) J' E_b J.
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
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance, (parameters, parameters), and Student's factors, (parameters,).

    Args:
        influences: (rows, parameters), A', of similar scale.
        J: (rows, parameters), the sensitivities of the prediction, scaled likewise.
        error: (rows,) the residual, in the order of time.
        parts: rows of each record, with their own spectra.
        asked: (rows, parameters), influences on the requested quantities, if not the estimate.
    """
    others = [None if asked is None else asked[part] for part in parts]
    bands = [_bands(influences[part], J[part], error[part], other) for part, other in zip(parts, others, strict=True)]
    H = np.concatenate([b.influences for b in bands])
    sought = np.concatenate([b.asked for b in bands])
    K = np.concatenate([b.sensitivities for b in bands])
    power = np.concatenate([b.power for b in bands])
    M = np.einsum("aij,bji->ab", K, H, optimize=True) + np.diag(np.concatenate([b.left for b in bands]))
    freedom = np.maximum(np.diag(M), 1e-3)
    level = _solve_levels(M, power, freedom)
    covariance = np.einsum("b,bij->ij", level, sought)
    own = np.einsum("bii->bi", sought)
    answers = np.linalg.lstsq(M.T, own, rcond=None)[0]  # of each deviation squared, to the power of each band
    variance = 2.0 * (level**2 * freedom) @ answers**2
    known = variance > 0
    degrees = 2.0 * np.diag(covariance) ** 2 / np.where(known, variance, 1.0)
    from scipy.special import stdtrit

    return covariance, np.where(known, np.asarray(stdtrit(np.maximum(degrees, 1.0), _TWO_SIGMA) / 2.0), 1.0)


def _bands(influences: FloatArray, J: FloatArray, error: FloatArray, asked: FloatArray | None) -> _Bands:
    rows = error.size
    both = np.full(rows // 2 + 1, 2.0)  # in half a spectrum a frequency stands for two, but the first and an even last
    both[0] = 1.0
    both[-1] = 2.0 if rows % 2 else 1.0
    weight = np.sqrt(both / rows)[:, np.newaxis]

    def transform(signals: FloatArray) -> NDArray[np.complex128]:
        return np.asarray(weight * np.fft.rfft(signals.reshape(rows, -1), axis=0))

    A, slopes, left = (transform(signals) for signals in (influences, J, error))
    taken = np.real(np.sum(A.conj() * slopes, axis=1))
    first = _borders(both - taken, rows)

    def each(columns: NDArray[np.complex128]) -> FloatArray:
        products = [np.real(part.conj().T @ part) for part in np.split(columns, first[1:])]
        return np.array(products)

    freedom = np.add.reduceat(both - 2.0 * taken, first)
    power = np.add.reduceat(np.abs(left[:, 0]) ** 2, first)
    own = each(A)
    return _Bands(own, own if asked is None else each(transform(asked)), each(slopes), freedom, power)


def _borders(left: FloatArray, rows: int) -> NDArray[np.intp]:
    """First frequency of each band, for a number of residual degrees of freedom."""
    total, first = np.concatenate([[0.0], np.cumsum(left)]), [0]
    while True:
        k = first[-1]
        wide = max(_FEWEST, min(int(_SHARE * k), math.isqrt(rows)))
        after = max(k + wide, int(np.searchsorted(total, total[k] + _LEFT)))
        if after + _FEWEST > left.size:  # what is left is the last band's
            return np.array(first)
        first.append(after)


def _solve_levels(M: FloatArray, power: FloatArray, freedom: FloatArray) -> FloatArray:
    """Solve for non-negative band levels, weighted by degrees of freedom."""
    from scipy.optimize import nnls

    scale = np.sqrt(freedom)
    unit = float(np.max(power)) or 1.0  # the solver has tolerances of its own
    try:
        found, _ = nnls(M / scale[:, np.newaxis], power / (unit * scale))
    except RuntimeError:  # too many iterations
        return power / freedom
    return np.asarray(unit * found)
