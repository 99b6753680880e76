"""Resample channels to a uniform clock, their update rate, or a controller's period.

Resampling is right where *samples* were taken at the stamps. If only the stamps jitter, use `sample_time` without a
time column instead; resampling would add the jitter to the samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting
from jointid.records.clock import Clock, measure_irregularity
from jointid.records.record import Channel, Irregularity, Resampled, Timing

Interpolation: TypeAlias = Literal["hold", "linear", "cubic"]

# Largest ratio of the new sample time to a channel's own: what aliases then was above 0.9 of its Nyquist frequency,
# where a joint leaves nothing.
_LOWER_RATE = 1.1
_ONE_INSTANT = 1e-6  # of a sample time
_LARGEST = 10**8  # samples of one channel
_SAME = 1e-6  # of a sample
_WHOLE = 1e-2  # how near to a whole number of samples counts as one
_CHANGES = 20  # fewer changes than this do not show a rhythm
_LONGEST_MEAN = 10_000  # values
_LONGEST = 10_000  # refreshes within which all channels must begin at one instant
_SAME_RATE = 1e-4  # two clocks whose rates differ by less than crystals do are one clock
_SHOWN = 25.0  # F of the jitter in a position, or of its absence, that decides: five standard deviations
_FEWEST_OF_SPLINE = 4  # samples
_MOST = 200  # periods to one log sample, or the other way round: more is a mistake

WELL_SEEN = 0.1
"""Share of a log's rate below which a position between two samples is known."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Resampling:
    """Rules by which channels are resampled to one uniform clock.

    A lower rate is refused: it needs a filter against aliasing, and `Filtering` has the one that torque and model go
    through alike. Nothing is extrapolated.

    An averaged channel is taken as the mean over the new periods, of values that are each the mean over their own.

    Example:
        >>> Resampling(1e-3, "cubic").held
        'hold'
    """

    sample_time: float = field(metadata=declare("time between samples of the record", unit="s", above=0))
    method: Interpolation = field(
        metadata=declare(
            "how a sampled channel is taken between its samples: the last one, a straight line, or the cubic spline "
            "through all of them, which is for positions"
        )
    )
    held: Interpolation = setting(
        "hold", "how a held channel is; what a controller holds is not interpolated unless it is asked for here"
    )
    longest_gap: int = setting(3, "samples that may be missing in a row; a longer gap is refused", at_least=0)

    def __post_init__(self) -> None:
        check_settings(self, RecordError)

    def method_for(self, timing: Timing) -> str:
        """Interpolation method for a channel's timing."""
        if timing is Timing.AVERAGED:
            return "mean"
        return self.held if timing is Timing.HELD else self.method


@dataclass(frozen=True, slots=True, eq=False)
class Stamped:
    """A channel as logged, at instants [s], (samples,), and its time column."""

    channel: Channel
    stamps: FloatArray
    clock: str


def resample_together(logged: Mapping[str, Stamped], how: Resampling) -> tuple[dict[str, Channel], float, Resampled]:
    """Resample channels to their common interval; return them, its start and a summary.

    The first instant is at the latest phase of the held channels, so that jitter does not skip or repeat a held value.
    It is relative to the first stamp of all.
    """
    zero = min((one.stamps[0] for one in logged.values()), default=0.0)  # of seconds since 1970 a float keeps too few
    logged = {name: replace(one, stamps=one.stamps - zero) for name, one in logged.items()}
    clocks = {one.clock: measure_irregularity(one.stamps) for one in logged.values() if one.stamps.size > 1}
    faults = [f for name, clock in clocks.items() for f in _clock_faults(name, clock, how)]
    faults += [f for name, one in logged.items() for f in _rate_faults(name, one, clocks, how)]
    if faults:
        raise RecordError(faults)
    ready = {}
    for name, one in logged.items():
        stamps, values = one.stamps, one.channel.values
        kept = np.concatenate([[True], (np.diff(stamps) != 0) | (np.diff(values) != 0)])
        ready[name] = replace(one, channel=replace(one.channel, values=values[kept]), stamps=stamps[kept])
    repeats = [name for name, one in ready.items() if np.any(np.diff(one.stamps) <= 0)]
    if repeats:
        said = " and ".join(repeats)
        raise RecordError(
            f"{said} has several values at one stamp, of which none can be left out; give sample_time without time if "
            "only the stamps are wrong."
        )
    T = how.sample_time
    first = max(one.stamps[0] + (T if one.channel.timing is Timing.AVERAGED else 0.0) for one in ready.values())
    last = min(one.stamps[-1] for one in ready.values())
    held = [one for one in ready.values() if how.method_for(one.channel.timing) == "hold"]
    begin = _find_beginning(first, held, T)
    samples = math.floor((last - begin) / T * (1 + 1e-12) + _ONE_INSTANT) + 1
    if not 2 <= samples <= _LARGEST:
        raise RecordError(
            f"The channels cover {max(last - begin, 0.0):g} s together, which is {max(samples, 0)} samples of {T:g} s; "
            f"expected 2 to {_LARGEST}: correct the sample time, or the time columns."
        )
    grid = begin + np.arange(samples) * T
    channels, methods = {}, {}
    for name, one in ready.items():
        methods[name] = how.method_for(one.channel.timing)
        values = _interpolate(one, np.minimum(grid, one.stamps[-1]), methods[name], T)
        held_on = one.channel.timing is not Timing.HELD or methods[name] == "hold"
        timing = one.channel.timing if held_on else Timing.SAMPLED  # of what is interpolated nothing is held
        channels[name] = replace(one.channel, values=values, sample_time=T, timing=timing)
    done = Resampled(T, methods, how.longest_gap, clocks, {name: one.clock for name, one in logged.items()})
    return channels, begin, done


def judge_jitter(
    logged: Mapping[str, Channel], clocks: Mapping[str, Clock]
) -> tuple[Resampling | None, tuple[str, ...], str]:
    """Return how channels whose stamps jitter are resampled, time columns of uniform samples, and a remark.

    No channel is resampled where no position follows the stamps of its own clock.

    A position x that was sampled at instants off by d from a uniform clock is x(t + d), so the third differences of x
    follow those of d v, with v its velocity. Where only the stamps jitter they do not.
    """
    told = {
        name: follows
        for name in ("motor_position", "load_position", "reference")
        if name in logged and name in clocks
        if (follows := _follows_stamps(logged[name].values, clocks[name])) is not None
    }
    name = max(told, key=lambda one: told[one], default=None)
    clock = max(clocks.values(), key=lambda one: one.jitter) if name is None else clocks[name]
    assert clock.sample_time is not None and clock.stamps is not None
    steps = np.abs(np.diff(clock.stamps) / clock.sample_time - 1)
    said = (
        f'the time column "{clock.column}" jitters by up to {clock.jitter:.1%} of the sample time of '
        f"{clock.sample_time:g} s ({np.sqrt(np.mean(steps**2)):.1%} rms), most after sample {int(np.argmax(steps))}: "
    )
    if not any(told.values()):
        return None, (), f"{said}the samples are taken as uniform, since no position follows that jitter"
    how = Resampling(min(c.sample_time or math.inf for c in clocks.values()), "cubic")
    words = f"{said}{name} follows its stamps, so that all channels are resampled by them (cubic)"
    of_stamps = {clocks[one].column for one, follows in told.items() if follows}
    uniform = tuple({clocks[one].column: None for one in told if clocks[one].column not in of_stamps})
    others = "".join(f', those of "{column}" as uniform samples' for column in uniform)
    return how, uniform, words + others


def _follows_stamps(values: FloatArray, clock: Clock) -> bool | None:
    """Test whether a position (samples,) was sampled at its stamps; None if it does not tell."""
    period, stamps = clock.sample_time, clock.stamps
    if period is None or stamps is None or values.size != stamps.size or stamps.size < _CHANGES:
        return None
    off = stamps - stamps[0] - period * np.arange(stamps.size)
    x, moved = np.diff(np.column_stack([values, off * np.gradient(values, period)]), 3, axis=0).T
    size = float(moved @ moved)
    share = float(moved @ x) / size if size else 0.0
    if not size or max(share, 1.0 - share) ** 2 * size <= _SHOWN * float(np.mean((x - share * moved) ** 2)):
        return None
    return share > 0.5


def _clock_faults(name: str, clock: Irregularity, how: Resampling) -> list[str]:
    faults = []
    if clock.backward:
        faults.append(
            f'The time column "{name}" runs backward {clock.backward} time{"s" if clock.backward > 1 else ""}, so that '
            "the order of its samples is in doubt; cut the record there, or give sample_time without time if only the "
            "stamps are wrong."
        )
    if clock.longest_gap > how.longest_gap:
        faults.append(
            f'The time column "{name}" leaves out {clock.longest_gap} samples in a row (at most {how.longest_gap} are '
            f"bridged); cut the record there, or set longest_gap = {clock.longest_gap}."
        )
    return faults


def _rate_faults(name: str, one: Stamped, clocks: Mapping[str, Irregularity], how: Resampling) -> list[str]:
    if one.clock not in clocks:
        return [f"{name} has a single sample, between which and others nothing can be taken; log more of it."]
    own = clocks[one.clock].sample_time
    if one.channel.timing is Timing.AVERAGED or how.sample_time <= _LOWER_RATE * own or own <= 0:
        return []
    return [
        f"{name} has a sample every {own:g} s, and resampled to {how.sample_time:g} s what is fast in it would alias; "
        f"give a sample time of at most {own:g} s: [filtering] then filters and decimates torque and model alike."
    ]


def _find_beginning(first: float, held: list[Stamped], T: float) -> float:
    """First instant from `first` on at the latest phase of held stamps.

    Jittering stamps of period T fill an arc of the circle t mod T; an instant at its end is after each sample and
    before the next.
    """
    if not held:
        return first
    phases = np.unique(np.concatenate([(one.stamps - first) % T for one in held]))
    wide = np.diff(phases, append=phases[0] + T)
    phase = float(phases[np.argmax(wide)])
    return first + (phase if T - phase > _ONE_INSTANT * T else 0.0)


def _interpolate(one: Stamped, grid: FloatArray, method: str, T: float) -> FloatArray:
    stamps, values = one.stamps, one.channel.values
    if method == "hold":
        behind = np.searchsorted(stamps, grid + _ONE_INSTANT * T, side="right") - 1
        return np.asarray(values[behind])
    if method == "linear":
        return np.asarray(np.interp(grid, stamps, values))
    if method == "cubic":
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(stamps, values)(grid))
    sums = np.concatenate([[0.0], np.cumsum(values[1:] * np.diff(stamps))])
    return np.asarray((np.interp(grid, stamps, sums) - np.interp(grid - T, stamps, sums)) / T)


@dataclass(frozen=True, slots=True)
class _Rhythm:
    """Samples at which a channel is refreshed: phase, phase + every, ..."""

    channel: Channel
    every: int = 1
    phase: int = 0

    def begins(self, time: float) -> int | None:
        """Sample index at a time [s], if refreshed there."""
        samples = time / self.channel.sample_time
        sample = round(samples)
        new = abs(samples - sample) < _SAME * max(sample, 1) and (sample - self.phase) % self.every == 0
        return sample if new else None

    def decimate(self, first: int) -> Channel:
        """Decimate a channel to its own rate, from a refreshed sample on."""
        one = self.channel
        return replace(one, values=one.values[first :: self.every], sample_time=one.sample_time * self.every)


def align_updates(
    logged: Mapping[str, Channel], rows: Mapping[str, NDArray[np.bool_]]
) -> tuple[dict[str, Channel], float]:
    """Decimate channels to the rows at which they are refreshed; return them and the first common instant.

    A channel without rows, (samples,), is refreshed at every sample; those of others are equally far apart.
    """
    rhythms = {}
    for name, channel in logged.items():
        phase, following = np.flatnonzero(rows[name])[:2].tolist() if name in rows else (0, 1)
        rhythms[name] = _Rhythm(channel, following - phase, phase)
    if all(rhythm.every == 1 for rhythm in rhythms.values()):
        return dict(logged), 0.0
    slowest = max(rhythms.values(), key=lambda rhythm: rhythm.every * rhythm.channel.sample_time)
    for count in range(_LONGEST):
        time = (slowest.phase + count * slowest.every) * slowest.channel.sample_time
        first = {name: rhythm.begins(time) for name, rhythm in rhythms.items()}
        if all(sample is not None for sample in first.values()):
            return {name: rhythm.decimate(first[name] or 0) for name, rhythm in rhythms.items()}, time
        if time > min(channel.duration for channel in logged.values()):
            break
    slow = ", ".join(f"{n} every {r.every} samples from sample {r.phase} on" for n, r in rhythms.items() if r.every > 1)
    raise RecordError(f"The channels are never refreshed at one instant ({slow}); leave one of them out.")


def find_refreshes(what: str, channel: Channel, update_time: float) -> NDArray[np.bool_]:
    """Return the rows, (samples,), at which a channel is refreshed, less often than it is logged.

    Raises:
        RecordError: its values change at other instants.
    """
    period, ratio = channel.sample_time, update_time / channel.sample_time
    every = round(min(ratio, len(channel)))
    if every < 1 or abs(ratio / every - 1) > _WHOLE or 2 * every > len(channel):
        raise RecordError(
            f"{what} has an update time of {update_time:g} s, which is {ratio:.4g} of its {len(channel)} samples of "
            f"{period:g} s; expected a whole number of them, and two refreshes: correct one of the two."
        )
    changes = np.flatnonzero(np.diff(channel.values)) + 1
    phase = int(np.argmax(np.bincount(changes % every, minlength=every)))
    wrong, longer = changes[changes % every != phase], update_interval(channel.values)
    if wrong.size:
        raise RecordError(
            f"{what} is said to be refreshed every {every} samples, but {wrong.size} of its {changes.size} changes "
            f"come between, the first at sample {wrong[0]}; correct update_time, or leave it out."
        )
    if longer > every:
        raise RecordError(
            f"{what} is said to be refreshed every {every} samples, but changes only every {longer}; set update_time = "
            f"{longer * period:g}."
        )
    return np.asarray(np.arange(len(channel)) % every == phase)


def update_interval(values: FloatArray) -> int:
    """Number of samples between changes of a signal (samples,); 1 if irregular."""
    changes = np.flatnonzero(np.diff(values))
    return int(np.gcd.reduce(np.diff(changes))) if changes.size >= _CHANGES else 1


def default_interpolation(channel: Channel) -> Interpolation:
    """Return the interpolation of a slow channel for which none is declared: one that repeats its values is held."""
    return "linear" if channel.timing is Timing.SAMPLED and update_interval(channel.values) == 1 else "hold"


def at_period(
    channel: Channel, period: float, periods: int, name: str, interpolation: Interpolation | None = None
) -> FloatArray:
    """Resample a channel to the controller's instants.

    A faster channel is decimated. A slower one is held, or interpolated by lines or Catmull-Rom cubics; the last value
    stays. The default follows from the channel's timing; a sampled one gets lines.
    """
    every, repeat = period_ratio(period, channel.sample_time, name)
    if interpolation is None:
        interpolation = default_interpolation(channel)
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


def position_at_period(position: Channel, period: float, periods: int) -> FloatArray:
    """Resample a measured position to the controller's instants, (periods,).

    Between the samples of a slower log it follows the cubic spline through all of them. A law differentiates it, and
    the slope of a line is that of half a sample earlier. The last value stays. Values that are not finite stay as they
    are, with lines between the others.
    """
    _, repeat = period_ratio(period, position.sample_time, "motor_position")
    if repeat == 1 or position.values.size < _FEWEST_OF_SPLINE or not np.all(np.isfinite(position.values)):
        return at_period(position, period, periods, "motor_position")
    from scipy.interpolate import CubicSpline

    at = np.minimum(np.arange(periods) / repeat, position.values.size - 1)
    return np.asarray(CubicSpline(np.arange(position.values.size), position.values)(at))


def fill_in(channel: Channel, every: int, period: float, interpolation: Interpolation) -> Channel:
    """Return a channel that repeats each value `every` times at a shorter period, its values filled in."""
    (changes,) = np.nonzero(np.diff(channel.values))
    phase = int(changes[0] + 1) % every if changes.size else 0
    points = np.concatenate([channel.values[:1] if phase else [], channel.values[phase::every]])
    slow = replace(channel, values=points, sample_time=every * channel.sample_time)
    repeat = period_ratio(period, channel.sample_time, "reference")[1]
    early = repeat * (every - phase if phase else 0)  # of the first setpoint, before the record
    filled = at_period(slow, period, early + repeat * channel.values.size, "reference", interpolation)
    return replace(channel, values=filled[early:], sample_time=channel.sample_time / repeat)


def running_mean(values: FloatArray, periods: float, slope: float) -> FloatArray:
    """Return the mean of the last `periods` values (samples,), as many rounded up of which the first has a part.

    Before the first sample they moved by `slope` per sample. At rest the mean is at rest to the last bit.

    Raises:
        RecordError: the mean is over more than 10,000 values.
    """
    if periods <= 1:
        return values
    if periods > _LONGEST_MEAN:
        raise RecordError(
            f"The reference is averaged over {periods:.6g} of the controller's periods; expected {_LONGEST_MEAN} at "
            "most: correct reference_average."
        )
    weights = np.ones(math.ceil(periods - _WHOLE))
    weights[-1] -= max(weights.size - periods, 0.0)
    weights /= weights.sum()
    steps = np.concatenate([np.full(weights.size, slope), np.diff(values)])
    moved = np.cumsum(np.convolve(steps, weights, "valid")[1:])
    first = values[0] - slope * float(weights @ np.arange(weights.size))
    return np.concatenate([[first], first + moved])


def period_ratio(long: float, short: float, name: str) -> tuple[int, int]:
    """Return (every, repeat) between two periods; one of them is 1."""
    ratio = long / short
    every, repeat = max(round(min(ratio, 1e9)), 1), max(round(min(1 / ratio, 1e9)), 1)
    if max(every, repeat) > _MOST or abs(ratio * repeat / every - 1) > _SAME_RATE:
        raise RecordError(
            f"The controller's period and the sample time of {name}, {long:.9g} s and {short:.9g} s, are not the same, "
            f"nor is one a multiple of the other up to {_MOST} times; correct the period, or resample the log."
        )
    return every, repeat
