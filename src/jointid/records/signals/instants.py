"""A channel as a controller reads it: at its own instants."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.record import Channel, Timing
from jointid.records.resampling import Interpolation

_SAME_RATE = 1e-4  # two clocks whose rates differ by less than crystals do are one clock
_MOST = 200  # periods to one log sample, or the other way round: more is a mistake


def at_period(
    channel: Channel, period: float, periods: int, name: str, interpolation: Interpolation | None = None
) -> FloatArray:
    """Return a channel at the controller's instants.

    A channel that is faster than the controller is picked. One that is slower is filled in: held until its next
    sample, by straight lines, or by Catmull-Rom's cubic, whose slope at a sample is half the difference of its
    neighbours; after the last sample it stays. What is not said follows from the channel: one that is sampled (as a
    reference is, unless it is declared held) gets lines.

    Raises:
        RecordError: neither of the two periods is a multiple of the other.
    """
    every, repeat = period_ratio(period, channel.sample_time, name)
    if interpolation is None:
        interpolation = "linear" if channel.timing is Timing.SAMPLED else "hold"
    if repeat == 1 or interpolation == "hold" or channel.values.size < 2:
        return np.asarray(np.repeat(channel.values[::every], repeat)[:periods])
    values, at = channel.values, np.minimum(np.arange(periods) / repeat, channel.values.size - 1)
    if interpolation == "linear":
        return np.asarray(np.interp(at, np.arange(values.size), values), dtype=np.float64)
    begin = np.minimum(at.astype(np.intp), values.size - 2)
    ends = np.concatenate([2 * values[:1] - values[1:2], values, 2 * values[-1:] - values[-2:-1]])
    before, first, second, after = (ends[begin + i] for i in range(4))
    t = at - begin
    straight, low, high = second - first, 0.5 * (second - before), 0.5 * (after - first)
    curve = (low - straight) * (1 - t) - (high - straight) * t
    return np.asarray(first + t * (straight + (1 - t) * curve))


def period_ratio(long: float, short: float, name: str) -> tuple[int, int]:
    """Return (every, repeat): how many of `short` make one `long`, or the other way round; one of them is 1."""
    ratio = long / short
    every, repeat = max(round(min(ratio, 1e9)), 1), max(round(min(1 / ratio, 1e9)), 1)
    if max(every, repeat) > _MOST or abs(ratio * repeat / every - 1) > _SAME_RATE:
        raise RecordError(
            f"The controller's period and the sample time of {name}, {long:.9g} s and {short:.9g} s, are not the same, "
            f"nor is one a multiple of the other up to {_MOST} times; correct the period, or resample the log."
        )
    return every, repeat
