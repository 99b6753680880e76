"""How far an estimate may be off because the model is: the scores of the residual by bands of frequency.

Neighbouring rows tell of noise. What a model lacks - a friction that is no Coulomb's, a current loop, a second mode -
repeats with the motion and is as large at the end of a long record as at its beginning; but it changes with
frequency. So the scores ``Z' e`` are summed over bands of frequency that hold equal shares of the residual, and the
spread of these sums says what the estimate owes to the choice of the band. The larger of both deviations is reported:
with noise alone they agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.uncertainty.covariance import Covariance

BANDS = 8


def with_bands(covariance: Covariance, Z: FloatArray, J: FloatArray, error: FloatArray) -> Covariance:
    """Return a covariance whose deviations are no smaller than those by bands of frequency.

    Args:
        covariance: by rows, see `uncertainty.sandwich`.
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities.
        error: (rows,) what remains.
    """
    return replace(covariance, std=np.maximum(covariance.std, band_deviations(Z, J, error)))


def band_deviations(Z: FloatArray, J: FloatArray, error: FloatArray) -> FloatArray:
    """Return standard deviations from the scores by bands of frequency, (parameters,)."""
    norms = column_norms(Z)
    rows = error.size
    spectrum = np.fft.rfft(error)
    energy = np.cumsum(np.abs(spectrum) ** 2)
    scores = np.real(np.conj(np.fft.rfft(Z / norms, axis=0)) * spectrum[:, np.newaxis]) * (2 / rows)
    edges = np.searchsorted(energy, energy[-1] * np.arange(1, BANDS) / BANDS)
    sums = np.add.reduceat(scores, np.concatenate([[0], np.maximum.accumulate(edges)]), axis=0)
    spread = np.linalg.pinv((Z / norms).T @ (J / norms))
    influences = sums @ spread.T
    # The sum over all bands is what the estimate made 0, so one of them is not free.
    return np.asarray(np.sqrt(BANDS / (BANDS - 1) * np.sum(influences**2, axis=0)) / norms)


def band_words() -> str:
    """Return what these deviations cover, in a sentence."""
    return f"or, where it is larger, the spread over {BANDS} bands of frequency, which shows what the model lacks"
