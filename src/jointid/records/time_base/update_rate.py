"""Channels that are logged more often than they are refreshed, brought to their own rate, and to a common beginning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from jointid.records.record import Channel
from jointid.records.unwrap import refreshed

_SAME = 1e-6  # of a sample
_LONGEST = 10_000  # refreshes within which all channels must begin at one instant


@dataclass(frozen=True, slots=True)
class Refreshed:
    """A channel as logged, and the time between its refreshes [s], None where every sample is new."""

    channel: Channel
    update_time: float | None = None


@dataclass(frozen=True, slots=True)
class _Rhythm:
    """A channel is new at its samples phase, phase + every, ..."""

    period: float
    every: int = 1
    phase: int = 0

    def begins(self, time: float) -> int | None:
        """Return the sample at that time [s], if it is a new one."""
        sample = round(time / self.period)
        new = abs(time / self.period - sample) < _SAME * max(sample, 1) and (sample - self.phase) % self.every == 0
        return sample if new else None


def begun_together(logged: Mapping[str, Refreshed]) -> tuple[dict[str, Channel], float, list[str]]:
    """Return the channels, each at its own rate from the first instant on at which all are new; that instant; faults.

    Where a value is refreshed is found from where it changes.
    """
    rhythms, faults = {}, list[str]()
    for name, one in logged.items():
        every, phase = 1, 0
        if one.update_time is not None:
            what = f"{name} ({one.channel.source})"
            every, phase, wrong = refreshed(what, one.channel.values, one.channel.sample_time, one.update_time)
            faults += wrong
        rhythms[name] = _Rhythm(one.channel.sample_time, every, phase)
    channels = {name: one.channel for name, one in logged.items()}
    if faults or all(rhythm.every == 1 for rhythm in rhythms.values()):
        return channels, 0.0, faults
    slowest = max(rhythms.values(), key=lambda rhythm: rhythm.every * rhythm.period)
    for count in range(_LONGEST):
        time = (slowest.phase + count * slowest.every) * slowest.period
        first = {name: rhythm.begins(time) for name, rhythm in rhythms.items()}
        if all(sample is not None for sample in first.values()):
            begun = {name: _from(channels[name], first[name] or 0, rhythms[name].every) for name in channels}
            return begun, time, []
        if time > min(channel.duration for channel in channels.values()):
            break
    slow = ", ".join(f"{n} every {r.every} samples from sample {r.phase} on" for n, r in rhythms.items() if r.every > 1)
    return channels, 0.0, [f"The channels are never refreshed at one instant ({slow}); leave one of them out."]


def _from(channel: Channel, first: int, every: int) -> Channel:
    return replace(channel, values=channel.values[first::every], sample_time=channel.sample_time * every)
