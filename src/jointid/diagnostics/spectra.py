"""Spectra of the measured signal, of the predicted one, and of their difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError

_PARTS = 8  # of the record, each as long as a window; windows overlap by half
_LONGEST = 8192  # samples of a window: a finer resolution adds nothing for a joint
_SHORTEST = 64


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """One-sided amplitude spectral densities, averaged over windows (Welch 1967).

    Attributes:
        frequency: (lines,) Hz, 0 left out.
        measured, predicted, error: (lines,) in the signal's unit per square root of Hz.
        resolution: Hz between two lines.
    """

    frequency: FloatArray
    measured: FloatArray
    predicted: FloatArray
    error: FloatArray
    resolution: float


def estimate_spectra(measured: FloatArray, predicted: FloatArray, sample_time: float) -> Spectra:
    """Return the spectra of a measured and a predicted signal, and of their difference.

    Args:
        measured: (samples,).
        predicted: (samples,) at the same instants.
        sample_time: seconds.

    Raises:
        RecordError: the signals are too short for a spectrum, or are not of one length.
    """
    from scipy.signal import welch

    if measured.shape != predicted.shape or measured.size < 2 * _SHORTEST:
        raise RecordError(
            f"Spectra need two signals of one length, {2 * _SHORTEST} samples or more; received {measured.size} and "
            f"{predicted.size}: use a longer record."
        )
    wanted = min(max(measured.size // _PARTS, _SHORTEST), _LONGEST)
    window = 1 << (wanted.bit_length() - 1)
    densities = []
    for signal in (measured, predicted, measured - predicted):
        frequency, power = welch(signal, 1.0 / sample_time, nperseg=window, detrend="constant")
        densities.append(np.sqrt(power[1:]))
    measured_, predicted_, error = densities
    return Spectra(frequency[1:], measured_, predicted_, error, float(frequency[1]))
