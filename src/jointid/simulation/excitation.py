"""Excitation: motions and signals that make a joint show its parameters."""

from __future__ import annotations

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
    """Return a reference that goes there and back at each speed in turn, with trapezoidal velocity.

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
    ways = [_way(speed, acceleration, travel) for speed in speeds for _ in range(2)]
    lengths = np.array([rest + length for _, _, length in ways])
    total = float(lengths.sum())
    samples = math.floor((duration or total) / sample_time + 1e-9)
    time = np.arange(samples) * sample_time % total
    ends = np.cumsum(lengths)
    index = np.minimum(np.searchsorted(ends, time, side="right"), len(ways) - 1)
    position = np.empty(samples)
    for i, (peak, ramp, length) in enumerate(ways):
        chosen = index == i
        local = np.clip(time[chosen] - (ends[i] - lengths[i]) - rest, 0.0, length)
        left = length - local
        moved = np.where(
            local < ramp,
            0.5 * acceleration * local**2,
            np.where(left < ramp, travel - 0.5 * acceleration * left**2, 0.5 * peak * ramp + peak * (local - ramp)),
        )
        position[chosen] = moved if i % 2 == 0 else travel - moved
    return position


def _way(speed: float, acceleration: float, travel: float) -> tuple[float, float, float]:
    """Return the speed reached on one way, and how long its ramp and the whole take."""
    peak = min(speed, math.sqrt(acceleration * travel))
    ramp = peak / acceleration
    return peak, ramp, ramp + travel / peak


def pulses(samples: int, sample_time: float, height: float, width: float, every: float, seed: int) -> FloatArray:
    """Return short rectangular pulses of alternating sign at irregular times: they ring a flexible joint.

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
    long = max(round(width / sample_time), 1)
    start, sign = every, 1.0
    while start < samples * sample_time:
        first = round(start / sample_time)
        signal[first : first + long] = sign * height
        sign = -sign
        start += every * random.uniform(0.5, 1.5)
    return signal
