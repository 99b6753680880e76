"""The highest cut-off at which the noise of measured positions does not pull an identified inertia.

Second differences of positions raise white noise with the fourth power of the frequency, so its share of the
acceleration grows with the fifth power of the cut-off, whatever the sampling frequency is. Least squares takes that
share off the inertia. At 5 kHz, with positions in steps of 1e-4 rad, a cut-off of 4 % of the rate took a third.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, default_cutoffs, lowpass

_PULL = 1e-4  # of the acceleration's power that noise may be, and thereby of an inertia that it may take
_SEEN = 10.0  # times its noise: an octave of the acceleration that is motion
_MARGIN = 2.0  # times the highest frequency of the motion, which no noise takes away
_NOISE = 0.1  # of the sampling frequency: above it no default lets motion pass, and noise is measured
_PARTS = 4  # of the record, whose spectra are averaged
_FEWEST = 256  # samples: of fewer no spectrum is averaged


def find_noise_limit(positions: Iterable[FloatArray], sample_time: float, derivative: int = 2) -> float:
    """Return the highest cut-off that the noise of positions allows, Hz; infinite where they have none.

    The limit is where noise makes 1e-4 of the power of a derivative, of the position for which that is lowest. That
    of the acceleration, along which a joint is identified, is never below twice the highest octave in which any
    acceleration is ten times its noise.

    Args:
        positions: (samples,) each, raw, of one clock.
        sample_time: s.
        derivative: of the position with respect to time, 2 or more.
    """
    from scipy.signal import welch

    allowed, needed = math.inf, 0.0
    for position in positions:
        if position.size < _FEWEST:
            continue
        size = (position.size - 2) // _PARTS
        frequency, power = welch(np.diff(position, 2) / sample_time**2, 1 / sample_time, nperseg=size)
        frequency, power = frequency[1:], power[1:]
        shape = (2 * np.sin(np.pi * frequency * sample_time) / sample_time) ** 4
        above = frequency >= _NOISE / sample_time
        noise = float(np.median(power[above] / shape[above])) * shape
        power, noise = power * shape ** (derivative / 2 - 1), noise * shape ** (derivative / 2 - 1)
        sums = np.cumsum(np.column_stack([np.zeros((2, 1)), [power, noise]]), axis=1)
        low, high = (np.searchsorted(frequency, frequency * factor) for factor in (0.5**0.5, 2**0.5))
        octave, octave_noise = sums[:, high] - sums[:, low]
        clear = octave > _SEEN * octave_noise
        top = int(np.argmax(octave / np.maximum(octave_noise, 1e-300)))
        lost = np.flatnonzero(~clear[top:])
        last = top + (int(lost[0]) if lost.size else power.size - top)
        if last == top:  # it hardly moves
            continue
        needed = max(needed, _MARGIN * float(frequency[last - 1]))
        motion = float(sums[0, last] - sums[1, last])
        share = np.flatnonzero(sums[1, 1:] > _PULL * motion)
        allowed = min(allowed, float(frequency[share[0]]) if share.size else math.inf)
    return max(allowed, needed) if derivative == 2 else allowed


def noise_limit_of_computed(records: Iterable[Record], sample_time: float) -> float:
    """Return the limit of the positions that torques are computed from, Hz; infinite where all torques were logged."""
    positions = (one.motor_position.values for one in records if one.computed and one.motor_position is not None)
    return find_noise_limit(positions, sample_time)


def lowpass_below_noise(values: FloatArray, limit: float, sample_time: float) -> FloatArray:
    """Filter signals, (samples, ...), by `lowpass` up to a limit of `find_noise_limit`, if that is below Nyquist."""
    return lowpass(values, limit, sample_time) if limit < 0.5 / sample_time else values


def describe_noise_limit(filtering: Filtering, limit: float, sample_time: float, model: str) -> tuple[str, ...]:
    """Return a sentence where a stated cut-off is too wide for the noise of positions.

    Args:
        filtering: resolved.
        limit: of `find_noise_limit`.
        sample_time: s.
        model: of the joint, "rigid" or "flexible".
    """
    cutoff = filtering.cutoff
    assert cutoff is not None
    default = default_cutoffs(sample_time, model)[1]
    if cutoff <= limit * (1 + 1e-9) or limit >= default:
        return ()
    why = f"noise or steps of the positions pull an inertia if they pass above {number(limit, 3)} Hz"
    return (f"filtering.cutoff is {number(cutoff, 3)} Hz, and {why}: lower filtering.cutoff to that",)
