"""Excitation signals for identification."""

import math
from collections.abc import Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError


def trapezoids(
    speeds: Sequence[float],
    acceleration: float,
    travel: float,
    sample_time: float,
    rest: float = 0.0,
    duration: float | None = None,
) -> FloatArray:
    """Reference back and forth at each speed, with trapezoidal velocity.

    Inertia shows in the ramps, viscous friction in the difference between speeds, Coulomb friction in the
    difference between directions; a rest makes the joint stick.

    Args:
        speeds: of the plateaus, m/s or rad/s.
        acceleration: of the ramps, m/s2 or rad/s2.
        travel: of one way, m or rad; a way too short for its speed has a triangular velocity.
        sample_time: seconds.
        rest: seconds of standstill before each way.
        duration: seconds in all, repeating or cutting the sequence; one sequence when None.

    Returns:
        Positions, shape (samples,), starting at 0.

    Raises:
        MethodError: a speed, the acceleration, the travel or the sample time is not positive.

    Example:
        >>> trapezoids([1.0], acceleration=2.0, travel=1.0, sample_time=0.5).round(2).tolist()
        [0.0, 0.25, 0.75, 1.0, 0.75, 0.25]
    """
    if not speeds or min(*speeds, acceleration, travel, sample_time) <= 0 or rest < 0:
        raise MethodError(
            "Trapezoids need positive speeds, acceleration, travel and sample time, and a rest of 0 or more; received "
            f"{list(speeds)}, {acceleration}, {travel}, {sample_time} and {rest}."
        )
    parts = []  # seconds of each, and position, velocity and acceleration as it begins
    for way, speed in ((way, speed) for speed in speeds for way in (1.0, -1.0)):
        peak, start = min(speed, math.sqrt(acceleration * travel)), 0.0 if way > 0.0 else travel
        ramp = peak / acceleration
        ramped = 0.5 * peak * ramp
        parts.append((rest, start, 0.0, 0.0))
        parts.append((ramp, start, 0.0, way * acceleration))
        parts.append((travel / peak - ramp, start + way * ramped, way * peak, 0.0))
        parts.append((ramp, start + way * (travel - ramped), way * peak, -way * acceleration))
    lengths, position, velocity, change = np.array(parts).T
    ends = np.cumsum(lengths)
    samples = math.floor((duration or float(ends[-1])) / sample_time + 1e-9)
    time = np.arange(samples) * sample_time % ends[-1]
    at = np.minimum(np.searchsorted(ends, time, side="right"), ends.size - 1)
    since = time - (ends - lengths)[at]
    return np.asarray(position[at] + velocity[at] * since + 0.5 * change[at] * since**2)


def pulses(samples: int, sample_time: float, height: float, width: float, every: float, seed: int) -> FloatArray:
    """Rectangular pulses of alternating sign at irregular times.

    Args:
        samples: how many.
        sample_time: seconds.
        height: of a pulse, N or N m.
        width: of a pulse, seconds.
        every: mean seconds from one pulse to the next; each gap is drawn from half of it to one and a half.
        seed: of the draw; the same seed gives the same pulses.

    Returns:
        Shape (samples,).
    """
    random = np.random.default_rng(seed)
    signal = np.zeros(samples)
    long, start, sign = max(round(width / sample_time), 1), every, 1.0
    while start < samples * sample_time:
        first = round(start / sample_time)
        signal[first : first + long] = sign * height
        sign, start = -sign, start + every * random.uniform(0.5, 1.5)
    return signal


def multisine(
    samples: int,
    sample_time: float,
    amplitude: float,
    lowest: float,
    highest: float,
    *,
    lines: int = 20,
    tilt: float = 0.0,
) -> FloatArray:
    """Sum of sines at harmonics of the whole length, with Schroeder's phases.

    Args:
        samples: how many.
        sample_time: seconds.
        amplitude: the largest value.
        lowest: of the frequencies, Hz.
        highest: of them, Hz.
        lines: how many frequencies at most, evenly apart on a logarithmic scale.
        tilt: exponent of the frequency by which the amplitudes fall: 0 for equal amplitudes, 2 for a position with
            equal accelerations.

    Returns:
        Shape (samples,), beginning and ending at 0.

    Raises:
        MethodError: the frequencies are not positive and rising, or the highest is no signal of that sample time.
    """
    _require_band(lowest, highest, sample_time)
    length = samples * sample_time
    wanted = np.geomspace(max(lowest, 1 / length), highest, max(lines, 1))
    frequencies = np.unique(np.maximum(np.round(wanted * length), 1.0)) / length
    signal = _sum_sines(samples, sample_time, frequencies, frequencies**-tilt)
    signal = (signal - signal[0]) * _ramp_ends(samples, min(1 / lowest, 0.1 * length) / sample_time)
    largest = float(np.max(np.abs(signal)))
    return np.asarray(amplitude * signal / largest) if largest > 0 else signal


def sines(samples: int, sample_time: float, frequencies: Sequence[float], amplitudes: Sequence[float]) -> FloatArray:
    """Faded sines of given frequencies and amplitudes, with Schroeder's phases.

    Args:
        samples: how many.
        sample_time: seconds.
        frequencies: Hz.
        amplitudes: of each.

    Returns:
        Shape (samples,), beginning and ending at 0, over the period of the slowest.
    """
    f, sizes = np.asarray(frequencies, dtype=np.float64), np.asarray(amplitudes, dtype=np.float64)
    _require_band(float(f.min()), float(f.max()), sample_time)
    return _ramp_ends(samples, 1 / (float(f.min()) * sample_time)) * _sum_sines(samples, sample_time, f, sizes)


def smooth(reference: FloatArray, sample_time: float, seconds: float) -> FloatArray:
    """Average a reference over `seconds`, which limits its jerk.

    A drive calls it jerk limit, or S-curve: the jerk is at most the change of the acceleration over those seconds.

    Args:
        reference: (samples,).
        sample_time: seconds.
        seconds: of the average; nothing is changed by less than a sample.
    """
    width = round(seconds / sample_time)
    if width < 2:
        return reference
    padded = np.concatenate([np.full(width - 1, reference[0]), reference])
    summed = np.cumsum(np.concatenate([[0.0], padded]))
    return np.asarray((summed[width:] - summed[:-width]) / width)


def _sum_sines(samples: int, sample_time: float, frequencies: FloatArray, sizes: FloatArray) -> FloatArray:
    shares = sizes**2 / np.sum(sizes**2)
    schroeder = -2 * math.pi * np.cumsum(np.cumsum(shares) - shares)
    time = np.arange(samples) * sample_time
    return np.asarray(np.sin(2 * math.pi * np.outer(time, frequencies) + schroeder) @ sizes)


def _ramp_ends(samples: int, over: float) -> FloatArray:
    """Factor that fades in and out over `over` samples."""
    at = np.arange(samples, dtype=np.float64)
    ramp = np.clip(np.minimum(at, at[::-1]) / over, 0.0, 1.0)
    return np.asarray(ramp * ramp * (3 - 2 * ramp))


def _require_band(lowest: float, highest: float, sample_time: float) -> None:
    if not (0 < lowest <= highest < 0.5 / sample_time):
        raise MethodError(
            f"Frequencies rise from above 0 to below half of the sampling frequency, {0.5 / sample_time:g} Hz; "
            f"received {lowest:g} to {highest:g} Hz."
        )
