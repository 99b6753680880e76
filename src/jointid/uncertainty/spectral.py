"""What a stationary noise makes of an estimate, by its spectrum in bands, and how well that is known.

Of linear equations an estimate errs by ``A n``, A its influences and n the noise, and leaves ``e = (I - J A) n``. With
the power s_b of n in a band b, the projection E_b on it, and w_b the band's degrees of freedom::

    cov = sum_b s_b A E_b A'
    E (e' E_a e) = sum_b M_ab s_b,      M_ab = (w_a - 2 tr A E_a J) [a = b] + tr (J' E_a J) (A E_b A')

The s_b >= 0 that meet the second line are free of what the fit took out of a band (Patterson and Thompson 1971 call it
restricted likelihood), which is most of the slowest ones. These bands are narrow, because under a force in the loop the
spectrum rises towards 0, where an offset and the sum of the inertias are told: four frequencies, then a quarter of the
frequency, and no more than sqrt(rows).

**How well it is known.** The power of a band is chi-square of M_bb degrees of freedom, so a deviation has those of
Satterthwaite (1946)::

    nu = 2 (h' s)^2 / var (h' s),      h_b = (A E_b A')_ii

few where a parameter is told by a few frequencies: its interval is Student's. Two deviations hold the truth as often as
2 sigma of a normal error would if they are multiplied with half of Student's quantile.
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
    """What there is in each band of frequency of one record.

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
    """Return the covariance, (parameters, parameters), and Student's factor of each deviation, (parameters,).

    Args:
        influences: (rows, parameters), A'; about as large for one parameter as for another.
        J: (rows, parameters), the sensitivities of the prediction, scaled likewise.
        error: (rows,) the residual, in the order of time.
        parts: rows of each record, whose spectra are their own.
        asked: (rows, parameters), the influences on what is asked for, if that is not the estimate.
    """
    others = [None if asked is None else asked[part] for part in parts]
    bands = [_bands(influences[part], J[part], error[part], other) for part, other in zip(parts, others, strict=True)]
    H = np.concatenate([b.influences for b in bands])
    sought = np.concatenate([b.asked for b in bands])
    K = np.concatenate([b.sensitivities for b in bands])
    power = np.concatenate([b.power for b in bands])
    M = np.einsum("aij,bji->ab", K, H, optimize=True) + np.diag(np.concatenate([b.left for b in bands]))
    freedom = np.maximum(np.diag(M), 1e-3)
    level = _solved(M, power, freedom)
    covariance = np.einsum("b,bij->ij", level, sought)
    own = np.einsum("bii->bi", sought)
    answers = np.linalg.lstsq(M.T, own, rcond=None)[0]  # of each deviation squared, to the power of each band
    variance = 2.0 * (level**2 * freedom) @ answers**2
    known = variance > 0
    degrees = 2.0 * np.diag(covariance) ** 2 / np.where(known, variance, 1.0)
    return covariance, np.where(known, _students_factor(degrees), 1.0)


def _bands(influences: FloatArray, J: FloatArray, error: FloatArray, asked: FloatArray | None) -> _Bands:
    rows = error.size
    both = np.full(rows // 2 + 1, 2.0)  # in half a spectrum a frequency stands for two, but the first and an even last
    both[0] = 1.0
    both[-1] = 2.0 if rows % 2 else 1.0
    weight = np.sqrt(both / rows)[:, np.newaxis]

    def transformed(signals: FloatArray) -> NDArray[np.complex128]:
        return np.asarray(weight * np.fft.rfft(signals.reshape(rows, -1), axis=0))

    A, slopes, left = (transformed(signals) for signals in (influences, J, error))
    taken = np.real(np.sum(A.conj() * slopes, axis=1))
    first = _borders(both - taken, rows)

    def each(columns: NDArray[np.complex128]) -> FloatArray:
        products = [np.real(part.conj().T @ part) for part in np.split(columns, first[1:])]
        return np.array(products)

    freedom = np.add.reduceat(both - 2.0 * taken, first)
    power = np.add.reduceat(np.abs(left[:, 0]) ** 2, first)
    own = each(A)
    return _Bands(own, own if asked is None else each(transformed(asked)), each(slopes), freedom, power)


def _borders(left: FloatArray, rows: int) -> NDArray[np.intp]:
    """Return the first frequency of each band, of which the fit leaves so many degrees of freedom each."""
    total, first = np.concatenate([[0.0], np.cumsum(left)]), [0]
    while True:
        k = first[-1]
        wide = max(_FEWEST, min(int(_SHARE * k), math.isqrt(rows)))
        after = max(k + wide, int(np.searchsorted(total, total[k] + _LEFT)))
        if after + _FEWEST > left.size:  # what is left is the last band's
            return np.array(first)
        first.append(after)


def _solved(M: FloatArray, power: FloatArray, freedom: FloatArray) -> FloatArray:
    """Return the levels of the bands, none negative, each equation weighing by its degrees of freedom."""
    from scipy.optimize import nnls

    scale = np.sqrt(freedom)
    unit = float(np.max(power)) or 1.0  # the solver has tolerances of its own
    try:
        found, _ = nnls(M / scale[:, np.newaxis], power / (unit * scale))
    except RuntimeError:  # too many iterations
        return power / freedom
    return np.asarray(unit * found)


def _students_factor(degrees: FloatArray) -> FloatArray:
    """Return what two deviations are multiplied with to hold as much as two of a normal distribution do."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(degrees, 1.0), _TWO_SIGMA) / 2.0)
