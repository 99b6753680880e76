"""Hunting: a limit cycle of integral action against stiction at rest.

While the axis sticks, the integral ramps the torque up until the friction gives way; the axis overshoots, and the ramp
reverses (B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30, 1994). Turning points are counted in the
longest rest of the reference: far apart, large against the torque in motion, and not decaying as ringing does. Cycles
longer than half of that rest are not detected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.record import Record

_RESTS = 1e-3  # of the greatest speed
_SETTLED = 0.3  # s after a stop
_LONGEST_MEAN = 0.02  # s that the torque is averaged over
_SWING = 0.25  # of the torque's scatter, that it turns by: noise and the ringing of a stop turn by less
_FEWEST = 4  # turning points in one rest
_SLOWEST = 0.05  # s between two: what turns faster is an oscillation of the loop
_LASTS = 0.6  # of the first half's swings, that those of the second are at least


@dataclass(frozen=True, slots=True)
class Hunting:
    """Sawtooth torque: its two levels, and the period in seconds."""

    low: float
    high: float
    period: float


def find_hunting(record: Record) -> Hunting | None:
    """Detect hunting in the longest rest; None without it.

    A record without torque and reference, or with an injection, gives None.
    """
    torque, reference = record.torque, record.reference
    if torque is None or reference is None or record.injected is not None or len(reference) < 2:
        return None
    speed = np.abs(np.gradient(reference.values, reference.sample_time))
    still = np.interp(torque.time, reference.time, (speed > _RESTS * np.max(speed)).astype(float)) == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    first, last = max(edges.reshape(-1, 2), key=lambda ends: ends[1] - ends[0], default=(0, 0))
    first += math.ceil(_SETTLED / torque.sample_time)
    over = max(round(_LONGEST_MEAN / torque.sample_time), 1)
    if last - first < over:
        return None
    seen = np.convolve(torque.values[first:last], np.full(over, 1.0 / over), mode="valid")
    turns = _turns(seen, _SWING * float(np.std(torque.values)))
    if len(turns) < _FEWEST:
        return None
    swings = np.abs(np.diff(seen[turns]))
    half = swings.size // 2
    apart = float(np.mean(np.diff(turns))) * torque.sample_time
    if apart < _SLOWEST or np.mean(swings[-half:]) < _LASTS * np.mean(swings[:half]):
        return None
    return Hunting(float(np.min(seen[turns])), float(np.max(seen[turns])), 2 * apart)


def _turns(values: FloatArray, swing: float) -> list[int]:
    """Indices at which values (samples,) turn by more than a swing."""
    found: list[int] = []
    low = high = sense = 0
    for k, value in enumerate(values):
        low, high = (k if value < values[low] else low), (k if value > values[high] else high)
        if sense >= 0 and values[high] - value > swing:
            found.append(high)
            low, sense = k, -1
        elif sense <= 0 and value - values[low] > swing:
            found.append(low)
            high, sense = k, 1
    return found[1:]
