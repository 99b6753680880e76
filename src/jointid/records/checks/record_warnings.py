"""Warnings on a valid record: coarse rounding, a slow update rate, an encoder that lags."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import lowpass
from jointid.records.signals.unwrap import find_quantum
from jointid.records.time_base.update_rate import update_interval

ROUNDING = 0.01
"""Share of a torque's rms that its rounding may be: the EMPS axis leaves 4 % for other reasons."""

LATE = 0.9
"""Share of the encoders' difference that a lag may be: of motorbench it is 0.3 %, of the paper's twin 41 %."""

FEWEST_STEPS = 30.0
"""Steps of an encoder that a moving axis passes in one sample, rms: with 16 of them, rounding leaves 4 to 9 %."""

_SLOW = 0.04  # of the sampling frequency: where a joint moves, and noise does not
_FEWEST_SAMPLES = 100


def find_record_warnings(record: Record, channels: Collection[str]) -> tuple[str, ...]:
    """Return the warnings on the channels that were read, one sentence each.

    A value that is rounded to steps of q has an error of q / sqrt(12) rms, and a torque that is refreshed every n
    samples is late by half of n more than its timing says. A late encoder differs from the other by its lag times the
    velocity, as a spring with viscous friction behind it does: where that is nearly all, no stiffness is seen.

    Args:
        record: what was logged.
        channels: names of those that were read.
    """
    notes: list[str] = []
    for name, channel in record.items():
        if name in channels:
            notes += _update_warnings(name, channel)
            notes += _rounding_warnings(name, channel)
    if {"motor_position", "load_position"} <= set(channels):
        notes += _lag_warnings(record)
    return tuple(notes)


def _lag_warnings(record: Record) -> Iterator[str]:
    """Yield a warning where a lag of one encoder explains nearly all of their difference."""
    motor, load = record.motor_position, record.load_position
    if motor is None or load is None or len(motor) < _FEWEST_SAMPLES:
        return
    T = motor.sample_time
    seen = np.interp(motor.time, load.time, load.values)
    position, difference = lowpass(np.column_stack([motor.values, motor.values - seen]), _SLOW / T, T).T
    velocity = np.gradient(position, T)
    velocity, difference = velocity - velocity.mean(), difference - difference.mean()
    size, total = float(velocity @ velocity), float(difference @ difference)
    if size == 0.0 or total == 0.0:
        return
    lag = float(velocity @ difference) / size
    share = lag**2 * size / total
    if share > LATE:
        late, early = ("load_position", "motor_position") if lag > 0 else ("motor_position", "load_position")
        yield (
            f"{share:.0%} of the difference of motor_position and load_position is as if {late} were "
            f"{1e3 * abs(lag):.2g} ms later than {early}: a spring is hidden behind it, and a stiffness from both "
            "encoders is not to be trusted"
        )


def _update_warnings(name: str, channel: Channel) -> Iterator[str]:
    every = update_interval(channel.values) if name == "torque" else 1
    if every > 1:
        yield (
            f"the {name} changes only every {every} samples: it is logged more often than it is refreshed; give its "
            f"channel update_time = {every * channel.sample_time:g}, or it is read up to that much too late"
        )


def _rounding_warnings(name: str, channel: Channel) -> Iterator[str]:
    step = find_quantum(channel.values) if name in ("torque", "motor_position", "load_position") else None
    if step is None:
        return
    if name == "torque":
        error, size = step / math.sqrt(12), float(np.std(channel.values))
        if error > ROUNDING * size:
            yield (
                f"the torque comes in steps of {step:.3g} {channel.unit}, {step / size:.1%} of its rms about its mean: "
                f"rounding alone leaves {error / size:.1%} of it"
            )
        return
    moved = np.diff(channel.values) / step
    moving = moved[moved != 0]
    passed = float(np.sqrt(np.mean(moving**2))) if moving.size else 0.0
    if passed < FEWEST_STEPS:
        yield (
            f"{name} comes in steps of {step:.3g} {channel.unit}, of which it passes {passed:.2g} in a sample where it "
            "moves (rms): its derivatives, and what a controller makes of it, are coarse"
        )
