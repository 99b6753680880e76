"""How far an estimate may be off: sandwich covariances that survive a residual that is not white.

For estimates that solve ``Z' e(x) = 0`` with sensitivities J = -de/dx::

    cov = (Z' J)^-1  S  (J' Z)^-1

Z = J is least squares, Z = W the instruments of DIDIM. S, the covariance of Z' e, is estimated from the scores
``Z_t e_t`` themselves with the Bartlett kernel (Newey and West 1987), so neither autocorrelation of the residual,
which the low-pass makes even of white noise, nor rows of different accuracy have to be known. The bandwidth is
``ceil(4 (n / 100)^(2/9))`` rows on each side, their rule of thumb. What repeats with the motion is not noise, and is
not covered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.data.record import FloatArray


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


def bandwidth(rows: int) -> int:
    """Return how many neighbouring rows may be correlated with one."""
    return math.ceil(4.0 * math.pow(rows / 100, 2 / 9))


def sandwich(Z: FloatArray, J: FloatArray, error: FloatArray, equations: int = 1) -> Covariance:
    """Return the autocorrelation-robust covariance (see the module).

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) what remains.
        equations: rows hold so many equations one after the other, which share their instants.
    """
    norms = np.linalg.norm(Z, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    rows, count = Z.shape
    scores = ((Z / norms) * error[:, np.newaxis]).reshape(equations, rows // equations, count).sum(axis=0)
    lags = min(bandwidth(len(scores)), len(scores) - 1)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        together = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (lags + 1)) * (together + together.T)
    spread = np.linalg.pinv((Z / norms).T @ (J / norms))
    covariance = rows / max(rows - count, 1) * spread @ meat @ spread.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(std > 0, std, 1.0)
    return Covariance(std / norms, covariance / np.outer(scale, scale), lags)


def words(covariance: Covariance) -> str:
    """Return what the standard deviations are, in a sentence."""
    return (
        f"autocorrelation-robust (Newey-West over {covariance.bandwidth} rows on each side); what repeats with the "
        "motion, as on most real axes, is not covered"
    )
