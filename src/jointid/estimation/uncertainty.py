"""How far an estimate may be off: sandwich covariances that survive a residual that is not white.

For estimates that solve ``Z' e(x) = 0`` with sensitivities J = -de/dx::

    cov = (Z' J)^-1  S  (J' Z)^-1

Z = J is least squares, Z = W the instruments of DIDIM. S, the covariance of Z' e, is estimated from the scores
``Z_t e_t`` themselves with the Bartlett kernel (Newey and West 1987), so neither autocorrelation of the residual,
which the low-pass makes even of white noise, nor rows of different accuracy have to be known. The bandwidth is
``ceil(4 (n / 100)^(2/9))`` rows on each side, their rule of thumb.

A fit pulls itself towards the rows that matter most, a few reversals for the Coulomb frictions, and the residual there
is smaller than the noise was. So every block of a bandwidth's length gets the residual it would have had if it had been
left out of the fit, ``(I - J_b (Z' J)^-1 Z_b')^-1 e_b``. What repeats with the motion is not noise, and is not covered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.data.record import FloatArray

_MOST = 2.0  # times its residual: what leaving a block out may make of it


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
    instants = rows // equations
    lags = min(bandwidth(instants), instants - 1)
    Z, J = ((matrix / norms).reshape(equations, instants, count) for matrix in (Z, J))
    spread = np.linalg.pinv(np.einsum("eti,etj->ij", Z, J))
    left_out = _left_out(Z, J, error.reshape(equations, instants), spread, max(lags, 1))
    scores = np.einsum("eti,et->ti", Z, left_out)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        together = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (lags + 1)) * (together + together.T)
    covariance = spread @ meat @ spread.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(std > 0, std, 1.0)
    return Covariance(std / norms, covariance / np.outer(scale, scale), lags)


def _left_out(Z: FloatArray, J: FloatArray, error: FloatArray, spread: FloatArray, length: int) -> FloatArray:
    """Return the residual, (equations, instants), each block had if it had been left out of the fit."""
    found = error.copy()
    count = Z.shape[2]
    for start in range(0, error.shape[1], length):
        block = slice(start, start + length)
        before = error[:, block].reshape(-1)
        pull = J[:, block].reshape(-1, count) @ spread @ Z[:, block].reshape(-1, count).T
        after = np.linalg.lstsq(np.eye(before.size) - pull, before, rcond=1e-6)[0]
        # A block that a parameter rests on alone, as the first does for the initial state, cannot be left out.
        if np.linalg.norm(after) <= _MOST * np.linalg.norm(before):
            found[:, block] = after.reshape(error.shape[0], -1)
    return found


def words(covariance: Covariance) -> str:
    """Return what the standard deviations are, in a sentence."""
    return (
        f"autocorrelation-robust (Newey-West over {covariance.bandwidth} rows on each side); what repeats with the "
        "motion, as on most real axes, is not covered"
    )
