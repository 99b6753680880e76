"""Resample channels to a uniform clock, their update rate, or a controller's period.

Resampling is right where *samples* were taken at the stamps. If only the stamps jitter, use `sample_time` without a
time column instead; resampling would add the jitter to the samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting
from jointid.common.text import pluralise
from jointid.records.clock import Clock, measure_irregularity
from jointid.records.record import Channel, Irregularity, Resampled, Timing

Interpolation: TypeAlias = Literal["hold", "linear", "cubic"]

# Largest ratio of the new sample time to a channel's own: what aliases then was above 0.9 of its Nyquist frequency,
# where a joint leaves nothing.
_LOWER_RATE = 1.1
_ONE_INSTANT = 1e-6  # of a sample time
_LARGEST = 10**8  # samples of one channel
_FEWEST_ROWS = 3  # with a number, of a column that is empty between
_WHOLE = 1e-2  # how near to a whole number of samples counts as one
_CHANGES = 20  # fewer changes than this do not show a rhythm
_LONGEST_MEAN = 10_000  # values
_LONGEST = 10_000  # samples within which all channels must begin at one instant
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
class Signal:
    """A channel as logged, and its clock; `picked` if it has a number in some rows of its time column alone."""

    channel: Channel
    clock: Clock
    picked: bool = False

    @property
    def name_of_clock(self) -> str:
        """Name of the time column, with the channel's own if it has some of its rows."""
        own = self.channel.source.partition(": ")[2]
        return f"{self.clock.column}, {own}" if self.picked else self.clock.column

    def straighten(self) -> Signal:
        """Return the signal at instants on the straight line through its stamps."""
        return replace(self, clock=replace(self.clock, stamps=self.clock.straightened(), jitter=0.0))


def bring_together(
    signals: Mapping[str, Signal], how: Resampling | None, tolerance: float
) -> tuple[dict[str, Channel], float, Resampled | None, tuple[str, ...]]:
    """Bring signals to a common beginning at their own rates, or resample them to one rate.

    Args:
        signals: by channel.
        how: rules of resampling; None keeps each rate if uniform clocks begin together and have a common instant.
        tolerance: within which two instants are one, as a share of the shortest sample time.

    Returns:
        The channels, the first instant from the first stamp of all [s], what was resampled, and remarks.
    """
    remarks = list[str]()
    if how is None and any(one.clock.jitter for one in signals.values()):
        how, signals, said = _judge_jitter(signals)
        remarks.append(said)
    if how is None:
        if (aligned := _align(signals, tolerance)) is not None:
            return *aligned, None, tuple(remarks)
        how = Resampling(min(one.clock.sample_time for one in signals.values()), "linear")
        remarks.append(f"the channels begin apart: they are resampled to {how.sample_time:g} s (linear)")
    return *resample_together(signals, how), tuple(remarks)


def _align(signals: Mapping[str, Signal], tolerance: float) -> tuple[dict[str, Channel], float] | None:
    """Cut channels to their first common instant; None without one, or of clocks that begin apart."""
    if not signals:
        return {}, 0.0
    begins = {name: one.clock.beginning for name, one in signals.items()}
    first, near = min(begins.values()), tolerance * min(one.clock.sample_time for one in signals.values())
    whole = [begins[name] for name, one in signals.items() if not one.picked]
    slowest = max(signals, key=lambda name: signals[name].clock.sample_time)
    if max(whole, default=first) - min(whole, default=first) > near:
        return None
    for count in range(min(_LONGEST, len(signals[slowest].channel))):
        time = begins[slowest] + count * signals[slowest].clock.sample_time
        late = {name: (time - begins[name]) / one.clock.sample_time for name, one in signals.items()}
        if all(n > -0.5 and abs(n - round(n)) * signals[name].clock.sample_time <= near for name, n in late.items()):
            cut = {
                name: replace(one.channel, values=one.channel.values[round(late[name]) :])
                for name, one in signals.items()
            }
            return cut, time - first
    return None


def resample_together(signals: Mapping[str, Signal], how: Resampling) -> tuple[dict[str, Channel], float, Resampled]:
    """Resample channels to their common interval; return them, its start and a summary.

    The first instant is at the latest phase of the held channels, so that jitter does not skip or repeat a held value.
    It is relative to the first stamp of all.
    """
    zero = min((one.clock.stamps[0] for one in signals.values()), default=0.0)  # seconds since 1970 leave few digits
    signals = {
        name: replace(one, clock=replace(one.clock, stamps=one.clock.stamps - zero)) for name, one in signals.items()
    }
    clocks = {
        one.name_of_clock: measure_irregularity(one.clock.stamps)
        for one in signals.values()
        if one.clock.stamps.size > 1
    }
    faults = [f for name, clock in clocks.items() for f in _clock_faults(name, clock, how)]
    faults += [f for name, one in signals.items() for f in _rate_faults(name, one, clocks, how)]
    if faults:
        raise RecordError(faults)
    ready, repeats = dict[str, tuple[Channel, FloatArray]](), list[str]()
    for name, one in signals.items():
        stamps, values = one.clock.stamps, one.channel.values
        kept = np.concatenate([[True], (np.diff(stamps) != 0) | (np.diff(values) != 0)])
        ready[name] = (replace(one.channel, values=values[kept]), stamps[kept])
        repeats += [name] if np.any(np.diff(stamps[kept]) <= 0) else []
    if repeats:
        raise RecordError(
            f"{' and '.join(repeats)} has several values at one stamp, of which none can be left out; give sample_time "
            "without time if only the stamps are wrong."
        )
    T = how.sample_time
    first = max(stamps[0] + (T if one.timing is Timing.AVERAGED else 0.0) for one, stamps in ready.values())
    last = min(stamps[-1] for _, stamps in ready.values())
    begin = _find_beginning(first, [at for one, at in ready.values() if how.method_for(one.timing) == "hold"], T)
    samples = math.floor((last - begin) / T * (1 + 1e-12) + _ONE_INSTANT) + 1
    if not 2 <= samples <= _LARGEST:
        raise RecordError(
            f"The channels cover {max(last - begin, 0.0):g} s together, which is {max(samples, 0)} samples of {T:g} s; "
            f"expected 2 to {_LARGEST}: correct the sample time, or the time columns."
        )
    grid = begin + np.arange(samples) * T
    channels, methods = {}, {}
    for name, (channel, stamps) in ready.items():
        methods[name] = how.method_for(channel.timing)
        values = _interpolate(channel.values, stamps, np.minimum(grid, stamps[-1]), methods[name], T)
        held_on = channel.timing is not Timing.HELD or methods[name] == "hold"
        timing = channel.timing if held_on else Timing.SAMPLED  # of what is interpolated nothing is held
        channels[name] = replace(channel, values=values, sample_time=T, timing=timing)
    done = Resampled(T, methods, how.longest_gap, clocks, {name: one.name_of_clock for name, one in signals.items()})
    return channels, begin, done


def _judge_jitter(signals: Mapping[str, Signal]) -> tuple[Resampling | None, dict[str, Signal], str]:
    """Return the resampling of channels with jittering stamps, the signals at straight stamps, and a remark.

    No channel is resampled where no position follows the stamps of its own clock.

    A position x that was sampled at instants off by d from a uniform clock is x(t + d), so the third differences of x
    follow those of d v, with v its velocity. Where only the stamps jitter they do not.
    """
    told = {
        name: follows
        for name in ("motor_position", "load_position", "reference")
        if name in signals and signals[name].clock.jitter and not signals[name].picked
        if (follows := _follows_stamps(signals[name])) is not None
    }
    name = max(told, key=lambda one: told[one], default=max(signals, key=lambda one: signals[one].clock.jitter))
    clock = signals[name].clock
    steps = np.abs(np.diff(clock.stamps) / clock.sample_time - 1)
    said = (
        f'the time column "{clock.column}" jitters by up to {clock.jitter:.1%} of the sample time of '
        f"{clock.sample_time:g} s ({np.sqrt(np.mean(steps**2)):.1%} rms), most after sample {int(np.argmax(steps))}: "
    )
    of_stamps = {signals[one].clock.column for one, follows in told.items() if follows}
    if not of_stamps:
        straight = {name: one.straighten() if one.clock.jitter else one for name, one in signals.items()}
        return None, straight, f"{said}the samples are taken as uniform, since no position follows that jitter"
    how = Resampling(min(one.clock.sample_time for one in signals.values() if one.clock.jitter), "cubic")
    uniform = dict.fromkeys(column for one in told if (column := signals[one].clock.column) not in of_stamps)
    made = {name: one.straighten() if one.clock.column in uniform else one for name, one in signals.items()}
    others = "".join(f', those of "{column}" as uniform samples' for column in uniform)
    return how, made, f"{said}{name} follows its stamps, so that all channels are resampled by them (cubic){others}"


def _follows_stamps(one: Signal) -> bool | None:
    """Test whether a position was sampled at its stamps; None if it does not tell."""
    values, period, stamps = one.channel.values, one.clock.sample_time, one.clock.stamps
    if stamps.size < _CHANGES:
        return None
    off = stamps - stamps[0] - period * np.arange(stamps.size)
    x, moved = np.diff(np.column_stack([values, off * np.gradient(values, period)]), 3, axis=0).T
    size = float(moved @ moved)
    share = float(moved @ x) / size if size else 0.0
    if not size or max(share, 1.0 - share) ** 2 * size <= _SHOWN * float(np.mean((x - share * moved) ** 2)):
        return None
    return share > 0.5


def _clock_faults(name: str, clock: Irregularity, how: Resampling) -> list[str]:
    if not clock.backward and clock.longest_gap <= how.longest_gap:
        return []
    bridge = "" if clock.backward else f" set longest_gap = {clock.longest_gap},"
    return [
        f'The time column "{name}" steps back {pluralise(clock.backward, "time")} and leaves out up to '
        f"{clock.longest_gap} samples in a row (at most {how.longest_gap} are bridged); cut the record there,{bridge} "
        "or give sample_time without time if only the stamps are wrong."
    ]


def _rate_faults(name: str, one: Signal, clocks: Mapping[str, Irregularity], how: Resampling) -> list[str]:
    if one.name_of_clock not in clocks:
        return [f"{name} has a single sample, between which and others nothing can be taken; log more of it."]
    own = clocks[one.name_of_clock].sample_time
    if one.channel.timing is Timing.AVERAGED or how.sample_time <= _LOWER_RATE * own or own <= 0:
        return []
    return [
        f"{name} has a sample every {own:g} s, and resampled to {how.sample_time:g} s what is fast in it would alias; "
        f"give a sample time of at most {own:g} s: [filtering] then filters and decimates torque and model alike."
    ]


def _find_beginning(first: float, held: Sequence[FloatArray], T: float) -> float:
    """First instant from `first` on at the latest phase of held stamps.

    Jittering stamps of period T fill an arc of the circle t mod T; an instant at its end is after each sample and
    before the next.
    """
    if not held:
        return first
    phases = np.unique(np.concatenate([(stamps - first) % T for stamps in held]))
    wide = np.diff(phases, append=phases[0] + T)
    phase = float(phases[np.argmax(wide)])
    return first + (phase if T - phase > _ONE_INSTANT * T else 0.0)


def _interpolate(values: FloatArray, stamps: FloatArray, grid: FloatArray, method: str, T: float) -> FloatArray:
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


def find_filled_rows(values: FloatArray, *, resampled: bool) -> NDArray[np.bool_] | None:
    """Return the rows, (samples,), with a number in a column but not in others; None if those are a fault.

    Args:
        values: the column, (samples,), with NaN where it is empty.
        resampled: whether the channel comes to a new clock; else the rows have to be equally far apart.
    """
    filled = ~np.isnan(values)
    rows = np.flatnonzero(filled)
    if rows.size < _FEWEST_ROWS or (longest := int(np.diff(rows).max())) == 1:
        return None
    ends = max(rows[0] + 1, values.size - rows[-1]) <= longest
    return filled if ends and (resampled or np.all(np.diff(rows) == longest)) else None


def find_refreshes(what: str, values: FloatArray, period: float, update_time: float) -> NDArray[np.bool_]:
    """Return the rows, (samples,), at which a column is refreshed, less often than it is logged.

    Raises:
        RecordError: its values change at other instants.
    """
    every = round(min(update_time / period, values.size))
    if every < 1 or abs(update_time / period / every - 1) > _WHOLE or 2 * every > values.size:
        raise RecordError(
            f"{what} has an update time of {update_time:g} s, and {values.size} samples of {period:g} s; expected a "
            "whole number of them, and two refreshes: correct one of the two."
        )
    changes = np.flatnonzero(np.diff(values)) + 1
    phase = int(np.argmax(np.bincount(changes % every, minlength=every)))
    wrong, longer = changes[changes % every != phase], update_interval(values)
    if wrong.size or longer > every:
        said = f"{wrong.size} of its {changes.size} changes come between; correct update_time, or leave it out"
        if longer > every:
            said = f"its changes are {longer} samples apart; give update_time = {longer * period:g}"
        raise RecordError(f"{what} is said to be refreshed every {every} samples, but {said}.")
    return np.asarray(np.arange(values.size) % every == phase)


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
