"""Spectra and frequency response of an estimate.

Spectra are those of the measured and the predicted torque, and of their difference. The response is that from the
motor's torque to the velocities of the joint's two sides, of the linear part (`models.linear`), moving forwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.parameters import POSITION_UNIT
from jointid.estimation.result.estimate import Estimate
from jointid.models.linear import OUTPUTS, frequency_response

_PARTS = 8  # of the record, each as long as a window of the spectra; windows overlap by half
_LONGEST = 8192  # samples of a window: a finer resolution adds nothing for a joint
_SHORTEST = 64
_LINES = 400  # of the response
_LOWEST = 0.1  # Hz
_ABOVE = 3.0  # times the fastest of the three frequencies, at least


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of an identified joint.

    Attributes:
        frequency: (lines,) Hz.
        sides: whose velocity it is: of the motor, and for a flexible joint of the load.
        magnitude: (sides, lines) of the velocity per torque.
        phase: (sides, lines) degrees.
        unit: of the magnitude.
        modes: Hz by name, of a flexible joint; see `FlexibleJoint.frequencies`.
    """

    frequency: FloatArray
    sides: tuple[str, ...]
    magnitude: FloatArray
    phase: FloatArray
    unit: str
    modes: Mapping[str, float]


def estimate_spectra(measured: FloatArray, predicted: FloatArray, sample_time: float) -> tuple[FloatArray, ...]:
    """Return frequencies, Hz, and the spectra there of a measured and a predicted signal, and of their difference.

    These are one-sided amplitude spectral densities, averaged over windows (Welch 1967), (lines,) in the signal's unit
    per square root of Hz.

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
    signals = np.stack([measured, predicted, measured - predicted])
    frequency, power = welch(signals, 1.0 / sample_time, nperseg=window, detrend="constant")
    return frequency[1:], *np.sqrt(power[:, 1:])  # 0 left out


def compute_response(estimate: Estimate) -> FrequencyResponse:
    """Return the frequency response of an estimate.

    Raises:
        MethodError: a parameter of the joint is not identifiable.
    """
    joint, values, modes = estimate.settings.joint, estimate.require_values(), estimate.frequencies
    highest = max(0.5 / estimate.data.sample_time, _ABOVE * max(modes.values(), default=0.0))
    grid = np.geomspace(_LOWEST, highest, _LINES)
    frequency = np.unique(np.concatenate([grid, [f for f in modes.values() if f > _LOWEST]]))
    sides = ("motor", "load")[: 2 if joint.model == "flexible" else 1]
    outputs = OUTPUTS[1 : 2 * len(sides) : 2]  # the velocities
    found = np.stack([frequency_response(joint, values, frequency, output) for output in outputs])
    phase = np.degrees(np.unwrap(np.angle(found), axis=1))
    torque_unit = f"({own})" if " " in (own := estimate.data.torque_unit) else own
    unit = f"({POSITION_UNIT[joint.kind]}/s)/{torque_unit}"
    return FrequencyResponse(frequency, sides, np.abs(found), phase, unit, modes)
