"""Bring channels that are logged more often than they are updated to their own rate, and to a common beginning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.record import Channel

_SAME = 1e-6  # of a sample
_WHOLE = 1e-2  # how near to a whole number of samples counts as one
_CHANGES = 20  # fewer changes than this do not show a rhythm
_LONGEST = 10_000  # refreshes within which all channels must begin at one instant


@dataclass(frozen=True, slots=True)
class _Rhythm:
    """The samples at which a channel is new: phase, phase + every, ..."""

    period: float
    every: int = 1
    phase: int = 0

    def begins(self, time: float) -> int | None:
        """Return the sample at that time [s], if it is a new one."""
        sample = round(time / self.period)
        new = abs(time / self.period - sample) < _SAME * max(sample, 1) and (sample - self.phase) % self.every == 0
        return sample if new else None


def align_updates(
    logged: Mapping[str, Channel], update_times: Mapping[str, float | None]
) -> tuple[dict[str, Channel], float]:
    """Return the channels, each at its own update rate from the first instant on at which all are new; that instant.

    Args:
        logged: the channels as logged, by name.
        update_times: time between updates [s], by channel; None, or none, where every sample is new.

    Raises:
        RecordError: a channel does not change at the rate that is declared, or no instant is new to all.
    """
    rhythms, faults = {}, list[str]()
    for name, channel in logged.items():
        every, phase, update_time = 1, 0, update_times.get(name)
        if update_time is not None:
            what = f"{name} ({channel.source})"
            every, phase, wrong = find_updates(what, channel.values, channel.sample_time, update_time)
            faults += wrong
        rhythms[name] = _Rhythm(channel.sample_time, every, phase)
    if faults:
        raise RecordError(faults)
    if all(rhythm.every == 1 for rhythm in rhythms.values()):
        return dict(logged), 0.0
    slowest = max(rhythms.values(), key=lambda rhythm: rhythm.every * rhythm.period)
    for count in range(_LONGEST):
        time = (slowest.phase + count * slowest.every) * slowest.period
        first = {name: rhythm.begins(time) for name, rhythm in rhythms.items()}
        if all(sample is not None for sample in first.values()):
            return {name: _from(one, first[name] or 0, rhythms[name].every) for name, one in logged.items()}, time
        if time > min(channel.duration for channel in logged.values()):
            break
    slow = ", ".join(f"{n} every {r.every} samples from sample {r.phase} on" for n, r in rhythms.items() if r.every > 1)
    raise RecordError(f"The channels are never refreshed at one instant ({slow}); leave one of them out.")


def _from(channel: Channel, first: int, every: int) -> Channel:
    return replace(channel, values=channel.values[first::every], sample_time=channel.sample_time * every)


def find_updates(name: str, values: FloatArray, period: float, update_time: float) -> tuple[int, int, list[str]]:
    """Return (every, phase, faults): a value is refreshed at samples phase, phase + every, ...

    Args:
        name: what the sentences call the values.
        values: (samples,) as logged.
        period: time between samples [s].
        update_time: time between refreshes [s], as declared.
    """
    ratio = update_time / period
    every = round(min(ratio, 1e9))
    if every < 1 or abs(ratio / every - 1) > _WHOLE:
        return (
            1,
            0,
            [
                f"{name} has an update time of {update_time:g} s, which is {ratio:.4g} of its samples of {period:g} s; "
                "expected a whole number of them: correct one of the two."
            ],
        )
    changes = np.flatnonzero(np.diff(values)) + 1
    if changes.size == 0:
        return every, 0, []
    phases = np.bincount(changes % every, minlength=every)
    phase = int(np.argmax(phases))
    wrong = changes[changes % every != phase]
    if wrong.size:
        fault = (
            f"{name} is said to be refreshed every {every} samples, but {wrong.size} of its {changes.size} changes "
            f"come between, the first at sample {wrong[0]}; correct update_time, or leave it out."
        )
        return every, phase, [fault]
    rhythm = update_interval(values)
    if rhythm > every:
        fault = (
            f"{name} is said to be refreshed every {every} samples, but changes only every {rhythm}; set update_time = "
            f"{rhythm * period:g}."
        )
        return every, phase, [fault]
    return every, phase, []


def update_interval(values: FloatArray) -> int:
    """Return the number of samples after which, and only then, a signal (samples,) changes; 1 if no such number."""
    changes = np.flatnonzero(np.diff(values))
    return int(np.gcd.reduce(np.diff(changes))) if changes.size >= _CHANGES else 1
