"""Resampling to a uniform clock, update rate or controller period.

Resampling is correct if *samples* were taken at the stamps. If only the stamps jitter, use `sample_time` without a
time column instead; resampling would add the jitter to the samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting
from jointid.records.clock import CLOCK_TOLERANCE, Clock, fit_line
from jointid.records.columns import POSITIONS
from jointid.records.record import Channel, Resampled, Timing

Interpolation: TypeAlias = Literal["hold", "linear", "cubic"]
Between: TypeAlias = Interpolation | Literal["spline"]

# Largest ratio of the new sample time to a channel's own: only content above 0.9 of its Nyquist frequency aliases,
# where a joint has none.
_LOWER_RATE = 1.1
_ONE_INSTANT = 1e-6  # of a sample time
_LARGEST = 10**8  # samples of one channel
_WHOLE = 1e-2  # tolerance of a whole number of samples
_CHANGES = 20  # fewest changes that define an update interval
_LONGEST_MEAN = 10_000  # values
_SAME_RATE = 1e-4  # relative difference of two rates below which they are equal, as of crystals
_SHOWN = 25.0  # F statistic, five standard deviations, at which a position decides on jitter
_MOST = 200  # largest ratio of controller period and sample time, or inverse


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Resampling:
    """Rules for resampling channels to one uniform clock.

    A lower rate is refused: it needs an anti-aliasing filter, and `Filtering` applies the same one to torque and
    model. Nothing is extrapolated.

    A held channel stays held. An averaged channel becomes the mean over each new period, weighted by the overlap with
    its own periods.

    Example:
        >>> Resampling(1e-3, "cubic").longest_gap
        3
    """

    sample_time: float = field(metadata=declare("time between samples of the record", unit="s", above=0))
    method: Interpolation = field(
        metadata=declare(
            "how a sampled channel is taken between its samples: the last one, a straight line, or the cubic spline "
            "through all of them, which is for positions"
        )
    )
    longest_gap: int = setting(3, "samples that may be missing in a row; a longer gap is refused", at_least=0)

    def __post_init__(self) -> None:
        check_settings(self, RecordError)


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """A channel as logged, with its clock.

    Attributes:
        wrap: wrap of a position in the channel's unit; 0 without one.
        remarks: on corrections.
    """

    channel: Channel
    clock: Clock
    wrap: float = 0.0
    remarks: tuple[str, ...] = ()


def bring_together(
    signals: Mapping[str, Signal], how: Resampling | None
) -> tuple[dict[str, Channel], float, Resampled | None, tuple[str, ...]]:
    """Align signals at their own rates, or resample them to one rate.

    Args:
        signals: by channel.
        how: rules of resampling; None keeps each rate if uniform clocks share an instant.

    Returns:
        The channels, their start relative to the earliest stamp [s], a summary of resampling, and remarks.
    """
    remarks = list[str]()
    if how is None and any(one.clock.jitter for one in signals.values()):
        how, signals, said = _judge_jitter(signals)
        remarks.append(said)
    if how is None:
        if (aligned := _align(signals)) is not None:
            return *aligned, None, tuple(remarks)
        how = Resampling(min(one.clock.sample_time for one in signals.values()), "linear")
        remarks.append(f"the channels have no common instant: they are resampled to {how.sample_time:g} s (linear)")
    return *resample_together(signals, how), tuple(remarks)


def _align(signals: Mapping[str, Signal]) -> tuple[dict[str, Channel], float] | None:
    """Cut channels to the latest beginning, or return None."""
    if not signals:
        return {}, 0.0
    begins = {name: float(one.clock.stamps[0] - fit_line(one.clock.stamps)[1][0]) for name, one in signals.items()}
    periods = {name: one.clock.sample_time for name, one in signals.items()}
    near, latest = CLOCK_TOLERANCE * min(periods.values()), max(begins.values())
    late = {name: (latest - begin) / periods[name] for name, begin in begins.items()}
    if any(abs(n - round(n)) * periods[k] > near or n >= signals[k].channel.values.size for k, n in late.items()):
        return None
    kept = {name: one.channel.values[round(late[name]) :] for name, one in signals.items()}
    ends = [periods[name] * values.size for name, values in kept.items()]
    end = min(ends) if any(map(round, late.values())) else math.inf  # clocks with different starts end differently
    cut = {n: values[: math.ceil(min(end / periods[n], values.size) - _WHOLE)] for n, values in kept.items()}
    return {n: replace(one.channel, values=cut[n]) for n, one in signals.items()}, latest - min(begins.values())


def resample_together(signals: Mapping[str, Signal], how: Resampling) -> tuple[dict[str, Channel], float, Resampled]:
    """Resample channels to their common interval; return start and summary, too.

    The start is at the latest phase of the held channels, so that jitter does not skip or repeat a held value. It is
    relative to the earliest stamp [s].
    """
    zero = min((one.clock.stamps[0] for one in signals.values()), default=0.0)  # seconds since 1970 leave few digits
    T, faults, off, gaps = how.sample_time, list[str](), dict[str, FloatArray](), dict[str, int]()
    stamps = {name: one.clock.stamps - zero for name, one in signals.items()}
    for name, one in signals.items():
        period, deviations, left_out = fit_line(stamps[name])
        off.setdefault(one.clock.column, deviations / period)
        gaps.setdefault(one.clock.column, int(np.count_nonzero(left_out)))
        longest, averaged = int(left_out.max()), one.channel.timing is Timing.AVERAGED
        lower = not averaged and _LOWER_RATE * period < T
        if lower or longest > how.longest_gap or np.any(np.diff(stamps[name]) <= 0):
            faults.append(
                f"{name} has a sample every {period:g} s, and leaves out up to {longest}; resampled to {T:g} s "
                f"it must not alias; expected stamps that run forward and leave out {how.longest_gap} at most: cut "
                "the record, set longest_gap, give a shorter sample time ([filtering] decimates torque and model "
                "alike), or sample_time without time if only the stamps are wrong."
            )
    if faults:
        raise RecordError(list(dict.fromkeys(faults)))
    always = {Timing.AVERAGED: "mean", Timing.HELD: "hold"}
    methods = {name: always.get(one.channel.timing, how.method) for name, one in signals.items()}
    first = max(at[0] + (T if methods[name] == "mean" else 0.0) for name, at in stamps.items())
    last = min(at[-1] for at in stamps.values())
    begin = _find_beginning(first, [at for name, at in stamps.items() if methods[name] == "hold"], T)
    samples = math.floor((last - begin) / T * (1 + 1e-12) + _ONE_INSTANT) + 1
    if not 2 <= samples <= _LARGEST:
        raise RecordError(
            f"The channels cover {max(last - begin, 0.0):g} s together, which is {max(samples, 0)} samples of {T:g} s; "
            f"expected 2 to {_LARGEST}: correct the sample time, or the time columns."
        )
    grid, channels = begin + np.arange(samples) * T, dict[str, Channel]()
    for name, at in stamps.items():
        values = _interpolate(signals[name].channel.values, at, np.minimum(grid, at[-1]), methods[name], T)
        channels[name] = replace(signals[name].channel, values=values, sample_time=T)
    largest = max(float(np.max(np.abs(one))) for one in off.values())
    rms = max(float(np.sqrt(np.mean(one**2))) for one in off.values())
    return channels, begin, Resampled(T, methods, largest, rms, sum(gaps.values()))


def _judge_jitter(signals: Mapping[str, Signal]) -> tuple[Resampling | None, dict[str, Signal], str]:
    """Decide on resampling jittering channels; return rules, signals and a remark.

    Channels are resampled only if a position follows the stamps of its clock; other stamps are straightened.
    """
    jittering = [one.clock for one in signals.values() if one.clock.jitter]
    late = dict[str, bool]()
    for one in (signals[name] for name in POSITIONS if name in signals):
        if one.clock.jitter and (follows := _follows_stamps(one)) is not None:
            late[one.clock.column] = follows or late.get(one.clock.column, False)
    resampled = any(late.values())
    straight = dict(signals)
    for name, one in signals.items():
        if one.clock.jitter and not late.get(one.clock.column, resampled):
            straight[name] = replace(
                one, clock=replace(one.clock, stamps=one.clock.stamps - fit_line(one.clock.stamps)[1], jitter=0.0)
            )
    how = Resampling(min(clock.sample_time for clock in jittering), "cubic") if resampled else None
    names = " and ".join(f'"{column}"' for column in dict.fromkeys(clock.column for clock in jittering))
    does = "a position follows them, so that all channels are resampled by them (cubic)"
    said = f"the stamps of {names} jitter by up to {max(clock.jitter for clock in jittering):.1%} of the sample time: "
    return how, straight, said + (does if resampled else "no position follows them, and the samples count as uniform")


def _follows_stamps(one: Signal) -> bool | None:
    """Test whether a position was sampled at its stamps; None if undecided.

    A position x sampled with deviations d from a uniform clock is x(t + d). The third differences of x are then
    correlated with those of d v, where v is the velocity. They are not if only the stamps jitter.
    """
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


def _find_beginning(first: float, held: Sequence[FloatArray], T: float) -> float:
    """Return the first instant after `first` at the latest held phase.

    Jittering stamps of period T fill an arc of the circle t mod T. An instant at the arc's end lies between all
    samples of one period and of the next.
    """
    if not held:
        return first
    phases = np.unique(np.concatenate([(stamps - first) % T for stamps in held]))
    wide = np.diff(phases, append=phases[0] + T)
    phase = float(phases[np.argmax(wide)])
    return first + (phase if T - phase > _ONE_INSTANT * T else 0.0)


def _interpolate(values: FloatArray, stamps: FloatArray, grid: FloatArray, method: str, T: float = 1.0) -> FloatArray:
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


def update_interval(values: FloatArray) -> int:
    """Number of samples between changes of a signal (samples,); 1 if irregular."""
    changes = np.flatnonzero(np.diff(values))
    return int(np.gcd.reduce(np.diff(changes))) if changes.size >= _CHANGES else 1


def default_interpolation(channel: Channel) -> Interpolation:
    """Default interpolation of a channel; one with repeated values is held."""
    return "linear" if channel.timing is Timing.SAMPLED and update_interval(channel.values) == 1 else "hold"


def at_period(channel: Channel, period: float, periods: int, name: str, way: Between | None = None) -> FloatArray:
    """Resample a channel to the controller's instants, (periods,).

    A faster channel is decimated. A slower one is held, or interpolated by lines, Catmull-Rom cubics or a cubic
    spline; the last value is kept. The default follows from the channel's timing; sampled channels get lines. A
    measured position that a controller differentiates needs the spline: the slope of a line is half a sample late.
    Channels with values that are not finite are interpolated linearly.
    """
    every, repeat = period_ratio(period, channel.sample_time, name)
    way = way or default_interpolation(channel)
    values, samples = channel.values, np.arange(float(channel.values.size))
    if repeat == 1 or way == "hold" or values.size < 2:
        return np.asarray(np.repeat(values[::every], repeat)[:periods])
    at = np.minimum(np.arange(periods) / repeat, values.size - 1)
    if way == "cubic" and np.all(np.isfinite(values)):
        from scipy.interpolate import CubicHermiteSpline

        return np.asarray(CubicHermiteSpline(samples, values, np.gradient(values))(at))
    return _interpolate(values, samples, at, "cubic" if way == "spline" and np.all(np.isfinite(values)) else "linear")


def running_mean(values: FloatArray, periods: float, slope: float) -> FloatArray:
    """Return the mean of the last `periods` values, (samples,).

    The oldest value has a fractional weight; earlier ones follow `slope` per sample. A constant's mean is exact.

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
