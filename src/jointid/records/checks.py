"""Checks of a record for faults and limitations."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.units import unit, units_of
from jointid.records.columns import finite_faults
from jointid.records.record import Channel, InjectionPoint, Record, Tap
from jointid.records.resampling import update_interval
from jointid.records.signals.filtering import lowpass

_LIMIT_SHARE = 0.5  # largest share of samples at the torque limit, which simulations of the loop have, too
# Share of the samples that may exceed the limit: peaks of a signal declared to be injected after it. The public
# EMPS record with pulses has 14 of 24,841: its pulses pass the limit, though its report adds them after it.
_EXCESS_SHARE = 1e-3
_AT_LIMIT = 1e-3  # tolerance of a torque at the limit, as a share of it: the resolution of a ten-bit log
# Impossible speed of a servo-driven joint: ten times that of a fast linear motor, and 950,000 rpm. A share of the
# samples must exceed it, since a step in the reference is no high speed.
_FASTEST, _SHARE_OF_FAST_SAMPLES = {"m": 50.0, "rad": 1e5}, 0.01
_FOLLOWS = 0.95  # smallest correlation of two signals whose ratio is meaningful
_RATIO_BAND = (0.5, 2.0)  # of motor position to reference, that a controller can explain; outside, one is mis-scaled
_DROOP = 0.1  # smallest motion over reference of a servo without integral under gravity; less is a wrong unit
_BY_DEVIATION = 0.995  # share of the torque's variance that the deviation from the reference and its rate explain
_BETTER = 0.5  # largest ratio of its residual to that of reference and rate, as evidence for the deviation
_RATIO_TOLERANCE = 0.1  # relative distance of a ratio from a unit's factor within which that unit is named
_SLOWEST_SAMPLE = 0.1  # s: below 10 samples a second
_BEYOND = 3.0  # largest travel of a position, in ranges of the model's limits
_GEAR_TOLERANCE = 0.02  # likewise for a gear ratio
_LATE = 0.9  # largest share of a lag in the encoders' difference: 0.3 % in motorbench, 41 % in the paper's twin
_GRAIN = 1e-12  # of the travel: closer values differ by rounding only
_MULTIPLE = 0.05  # of a step: tolerance of its multiples
_MOSTLY = 0.95  # share of the positions that are such multiples
_PARTS = 5  # most steps in the smallest gap: an axis that never rests may skip some
_SLOW = 0.04  # of the sampling frequency: below are the motions of a joint, above is noise
_FEWEST_SAMPLES = 100
_FEWEST_BOUNCES, _NEAR_ZERO = 10, 0.02  # of a torque that lost its sign, and how near to 0, as a share of its largest
# Ranges of a channel's largest number, in SI, and of its sample time: wider than any sensor's, while sums of squares
# do not overflow.
_NUMBERS, _TIMES = (1e-30, 1e30), (1e-9, 1e6)


def check_record(record: Record, *, limit: float | None = None, side: str | None = None) -> None:
    """Check that a record matches its declaration and allows identification.

    Args:
        record: the logged signals.
        limit: the controller's torque limit, in the record's unit; None skips the check.
        side: transmission side of the record's torque and the limit; None without a transmission.
    """
    faults = [f for name, c in record.items() for f in finite_faults(name, c.values)]
    if not faults:  # the other checks need finite numbers
        faults += [*scale_faults(record), *still_faults(record), *_rate_faults(record)]
        faults += [] if limit is None else limit_faults(record, limit, side)
    if faults:
        raise RecordError(faults)


def range_faults(position: Channel, limits: tuple[float, float]) -> Iterator[str]:
    """Yield the fault of a position far outside its joint's limits.

    Args:
        position: of the joint, behind its gear.
        limits: of the joint's model, in the position's unit.
    """
    travel, room = float(np.ptp(position.values)), limits[1] - limits[0]
    if travel > _BEYOND * room > 0:
        yield (
            f"The position travels {travel:.3g} {position.unit} within limits of {limits[0]:.3g} to {limits[1]:.3g} "
            f'{position.unit}; give its unit ("deg" of degrees), its gain, the side of its gear, or other limits.'
        )


def _rate_faults(record: Record) -> Iterator[str]:
    """Yield the fault of a sample rate too low for joint dynamics."""
    judged = record.torque or record.motor_position
    if judged is not None and (period := judged.sample_time) > _SLOWEST_SAMPLE:
        yield (
            f"The record has a sample every {period:.3g} s (at most {_SLOWEST_SAMPLE:g} s expected): it shows nothing "
            "of a joint's dynamics; log faster, or check the unit of the time column."
        )


def still_faults(record: Record) -> Iterator[str]:
    """Yield the faults of a constant torque or reference."""
    asked = record.reference if record.injected is None else None
    for name, channel in (("torque", record.torque), ("reference", asked)):
        if channel is not None and np.ptp(channel.values) == 0:
            yield (
                f"The {name} stays at {channel.values[0]:g} {channel.unit}: there is nothing to identify; record a "
                f"motion, or check which column is the {name}."
            )


def limit_faults(record: Record, limit: float, side: str | None = None) -> Iterator[str]:
    """Yield the fault of a torque at or above the controller's limit.

    The known injection is subtracted first.

    Args:
        record: without a torque there is no fault.
        limit: positive, in the unit of the record's torque.
        side: see `check_record`.
    """
    torque, injected = record.torque, record.injected
    if torque is None:
        return
    size = torque.values
    if injected is not None and injected.in_torque and injected.at is InjectionPoint.AFTER_LIMIT:
        size = size - np.interp(torque.time, injected.channel.time, injected.channel.values)
    size = np.abs(size)
    # Measured currents carry noise, and filters overshoot: only the command itself never passes the limit.
    passes = record.tap is Tap.COMMAND and float(np.mean(size > limit * (1 + _AT_LIMIT))) > _EXCESS_SHARE
    share = float(np.mean(size >= limit * (1 - _AT_LIMIT)))
    if passes or share > _LIMIT_SHARE:
        yield (
            f"The torque reaches {size.max():g} {torque.unit}{'' if side is None else f' on the {side} side'}, and is "
            f"at its limit of {limit:g} {torque.unit} or above in {share:.1%} of the samples (at most "
            f"{_LIMIT_SHARE:.1%} expected, none above); check limit, unit and gain, or record a slower motion."
        )


@np.errstate(over="ignore", invalid="ignore")  # a wrong column may hold any number
def scale_faults(record: Record) -> list[str]:
    """Faults of signals with an implausible unit, sign or side."""
    reference, motor, velocity = record.reference, record.motor_position, record.reference_velocity
    faults = list[str]()
    for name, channel in record.items():
        largest, time, unit = float(np.max(np.abs(channel.values), initial=0.0)), channel.sample_time, channel.unit
        steps = np.abs(np.diff(channel.values, append=channel.values[-1]))
        speed = float(np.quantile(steps, 1 - _SHARE_OF_FAST_SAMPLES)) / time
        if (largest and not _NUMBERS[0] <= largest <= _NUMBERS[1]) or not _TIMES[0] <= time <= _TIMES[1]:
            faults.append(
                f"{name} is {largest:.3g} {unit} at most, with a sample every {time:.3g} s (expected {_NUMBERS[0]:g} "
                f"to {_NUMBERS[1]:g}, and {_TIMES[0]:g} to {_TIMES[1]:g} s); check unit, gain and time column."
            )
        elif name in ("reference", "motor_position") and speed > _FASTEST.get(unit, math.inf):
            faults.append(
                f"{name} moves at {speed:.3g} {unit}/s and travels {np.ptp(channel.values):.3g} {unit}: it is not in "
                f"{unit}; give its unit, or its gain, and check the sample time."
            )
    if faults:
        return faults  # products of such numbers overflow or underflow
    if reference is not None and motor is not None and not _droops(record.torque, reference, motor):
        faults += _ratio_faults("motor_position", motor, "reference", reference)
    if reference is not None and velocity is not None and len(reference) > 1:
        slope = np.gradient(reference.values, reference.sample_time)
        derivative = Channel(slope, velocity.unit, reference.sample_time)
        faults += _ratio_faults("reference_velocity", velocity, "the derivative of reference", derivative)
    return faults


def _droops(torque: Channel | None, reference: Channel, motor: Channel) -> bool:
    """Test whether load torque pulls a servo without integral off its reference."""
    if torque is None or len(torque) < _FEWEST_SAMPLES or np.ptp(torque.values) == 0:
        return False
    asked, is_ = (np.interp(torque.time, one.time, one.values) for one in (reference, motor))
    if not _DROOP * np.std(asked) < np.std(is_) < _RATIO_BAND[0] * np.std(asked):
        return False
    left, gains = [], []
    for signal in (asked - is_, asked):
        columns = np.column_stack([signal, np.gradient(signal), np.ones(len(torque))])
        (gain, *_), rest, _, _ = np.linalg.lstsq(columns, torque.values, rcond=None)
        left.append(float(np.sum(rest)))
        gains.append(gain)
    if not (gains[0] > 0 and left[0] < (1 - _BY_DEVIATION) * torque.values.var() * len(torque)):
        return False
    ratio, alike = float(np.std(is_) / np.std(asked)), map(unit, units_of(unit(motor.unit).dimension))
    units = (factor for one in alike for factor in (one.factor, 1 / one.factor))
    gear = abs(ratio * round(1 / ratio) - 1) < _GEAR_TOLERANCE
    # A torque that the reference explains as well is no evidence against a wrong unit or gear.
    return left[0] < _BETTER * left[1] or not (gear or any(abs(ratio * one - 1) < _RATIO_TOLERANCE for one in units))


def _ratio_faults(name: str, channel: Channel, other_name: str, other: Channel) -> Iterator[str]:
    x, y = np.interp(channel.time, other.time, other.values), channel.values
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return
    x, y = x - x.mean(), y - y.mean()
    x_size, y_size, product = float(np.linalg.norm(x)), float(np.linalg.norm(y)), float(x @ y)
    if not abs(product) >= _FOLLOWS * x_size * y_size > 0:
        return
    if product < 0:
        yield f"{name} runs against {other_name}; turn the sign of one of them round."
    ratio = y_size / x_size
    if not _RATIO_BAND[0] <= ratio <= _RATIO_BAND[1]:
        yield (
            f"{name} is {ratio:.4g} times {other_name}, and should equal it; check units and gains, or give the gear "
            "between them as transmission.ratio, and the side of each channel."
        )


def find_record_warnings(record: Record, channels: Collection[str]) -> tuple[str, ...]:
    """Return warnings on the channels of a record, one sentence each."""
    notes, torque = [*record.remarks], record.torque
    if torque is not None and "torque" in channels and (every := update_interval(torque.values)) > 1:
        notes.append(
            f"the torque changes only every {every} samples: it is logged more often than it is refreshed; give its "
            f"channel sample_time = {every * torque.sample_time:g}, or it is read up to that much too late"
        )
    if torque is not None and "torque" in channels and (turns := _count_bounces(torque.values)) >= _FEWEST_BOUNCES:
        notes.append(
            f"the torque turns back at 0 {turns} times and never passes it: log it with its sign, which is lost"
        )
    return tuple(notes)


def _count_bounces(values: FloatArray) -> int:
    """Count how often a signal of one sign turns back next to 0, less how often it stays there."""
    size = values if values.min() >= 0 else -values
    inner, near = size[1:-1], _NEAR_ZERO * float(size.max())
    turns = np.count_nonzero((inner < size[:-2]) & (inner < size[2:]) & (inner <= near))
    return int(turns - np.count_nonzero((inner == 0) & (size[2:] == 0))) if size.min() >= 0 else 0


def find_encoder_lag(record: Record) -> tuple[str, float] | None:
    """Return the late encoder and its lag [s]; None if negligible."""
    motor, load = record.motor_position, record.load_position
    if motor is None or load is None or len(motor) < _FEWEST_SAMPLES:
        return None
    T = motor.sample_time
    seen = np.interp(motor.time, load.time, load.values)
    position, difference = lowpass(np.column_stack([motor.values, motor.values - seen]), _SLOW / T, T).T
    velocity = np.gradient(position, T)
    velocity, difference = velocity - velocity.mean(), difference - difference.mean()
    size, total = float(velocity @ velocity), float(difference @ difference)
    if size == 0.0 or total == 0.0:
        return None
    lag = float(velocity @ difference) / size
    return ("load_position" if lag > 0 else "motor_position", abs(lag)) if lag**2 * size > _LATE * total else None


def find_encoder_step(channel: Channel | None) -> float | None:
    """Return the quantisation step of a channel in its unit, or None."""
    if channel is None:
        return None
    values = np.sort(channel.values) - channel.values.min()
    gaps = np.diff(values)
    gaps = gaps[gaps > _GRAIN * values[-1]]
    for parts in range(1, _PARTS + 1) if gaps.size else ():
        step = float(gaps.min()) / parts
        if np.mean(np.abs(values / step - np.round(values / step)) < _MULTIPLE) >= _MOSTLY:
            return step
    return None
