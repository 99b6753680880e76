"""Hunting: an axis at rest whose torque saws up and down, as an integral drives it against a friction that sticks.

While the axis sticks, the integral of what it stands off winds the torque up in a ramp until the friction gives way;
the axis slips beyond where it should be, and the next ramp goes the other way (B. Armstrong-Helouvry, P. Dupont,
C. Canudas de Wit, Automatica 30, 1994). So turning points are counted in the longest rest of the reference: far apart,
a good share of the torque of the motion, and not dying away as the ringing after a stop does. A cycle that is longer
than half of that rest is not seen.
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
    """Torque that saws between two levels, in its unit, and the time in seconds from one turn up to the next."""

    low: float
    high: float
    period: float


def find_hunting(record: Record) -> Hunting | None:
    """Return how an axis hunts in the longest of its rests; None where it does not, or rests nowhere.

    Args:
        record: whatever its channels are; without torque and reference, or with a signal injected, nothing is told.
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
    """Return where values, (samples,), turn by more than a swing; without the first, where they may begin."""
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
