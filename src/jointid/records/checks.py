"""Check a record, one sentence for each fault; and warn of what limits its use."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.units import unit, units_of
from jointid.records.columns import finite_faults
from jointid.records.record import Channel, InjectionPoint, Record, Tap
from jointid.records.resampling import update_interval
from jointid.records.signals.encoder import find_quantum
from jointid.records.signals.filtering import lowpass

LIMIT_SHARE = 0.01
"""Share of the samples that may stand at the torque limit: a few peaks cost little information."""

BEYOND_SHARE = 1e-3
"""Share of the samples that may lie beyond the limit: peaks of a signal declared to be injected after it.

The public EMPS record with pulses has 14 of 24,841: its pulses pass the limit, though its report adds them after it.
"""

AT_LIMIT = 1e-3
"""Distance from the limit that counts as at it, as a share of the limit: the resolution of a ten-bit log."""

FASTEST = {"m": 50.0, "rad": 1e5}
"""Speed in SI that no servo-driven joint keeps up: ten times that of a fast linear motor, and 950,000 rpm."""

LONGEST = {"m": 1e3}
"""Travel in SI that no joint has; a revolute joint may turn for ever."""

SHARE_OF_FAST_SAMPLES = 0.01
"""Speed is judged by what this share of the samples exceeds: a step in the reference is no high speed."""

FOLLOWS = 0.95
"""Correlation from which one signal is taken to follow another, so that their ratio means something."""

RATIO_BAND = (0.5, 2.0)
"""Ratios of motor position to reference that a controller can explain; outside, one is scaled wrongly."""

RATIO_TOLERANCE = 0.1
"""Relative distance of a ratio from a unit's factor within which that unit is named."""

ROUNDING = 0.01
"""Share of a torque's rms that its rounding may be: the EMPS axis leaves 4 % for other reasons."""

LATE = 0.9
"""Share of the encoders' difference that a lag may be: of motorbench it is 0.3 %, of the paper's twin 41 %."""

FEWEST_STEPS = 30.0
"""Steps of an encoder that a moving axis passes in one sample, rms: with 16 of them, rounding leaves 4 to 9 %."""

_SLOW = 0.04  # of the sampling frequency: where a joint moves, and noise does not
_FEWEST_SAMPLES = 100


def check_record(
    record: Record, *, limit: float | None = None, limit_share: float = LIMIT_SHARE, side: str | None = None
) -> None:
    """Check that a record is what it is declared to be, and that a joint can be identified from it.

    Args:
        record: the record.
        limit: the controller's torque limit, in the unit of the record's torque; None does not check it.
        limit_share: share of the samples that may stand at the limit.
        side: of a transmission, on which the record's torque and the limit are told; None without one.

    Raises:
        RecordError: with one sentence for each fault found.
    """
    faults = [f for name, c in record.items() for f in finite_faults(name, c.values, c.time)]
    if not faults:  # of numbers that are none, nothing more can be said
        faults += [*scale_faults(record), *still_faults(record)]
        faults += [] if limit is None else limit_faults(record, limit, limit_share, side)
    if faults:
        raise RecordError(faults)


def still_faults(record: Record) -> list[str]:
    """Return the faults of a record in which nothing happens: a constant torque, a constant reference."""
    faults = []
    if record.torque is not None and np.ptp(record.torque.values) == 0:
        faults.append(
            f"The torque is {record.torque.values[0]:g} {record.torque.unit} in every sample: there is "
            "nothing to identify; check which column is the torque."
        )
    if record.reference is not None and record.injected is None and np.ptp(record.reference.values) == 0:
        faults.append(
            f"The reference stays at {record.reference.values[0]:g} {record.reference.unit}: the joint was "
            "not asked to move; record a motion, or check which column is the reference."
        )
    return faults


def limit_faults(record: Record, limit: float, limit_share: float = LIMIT_SHARE, side: str | None = None) -> list[str]:
    """Return the faults of a torque that stands at the controller's limit, or goes beyond it.

    What is known to be added after the limit is taken off the torque first.

    Args:
        record: the record; without a torque there is no fault.
        limit: largest torque the controller can ask for, positive, in the unit of the record's torque.
        limit_share: share of the samples that may stand at the limit.
        side: see `check_record`.
    """
    if not limit > 0:
        return [f"The torque limit is a positive number; got {limit:g}."]
    if record.torque is None:
        return []
    unit_name, output = record.torque.unit, record.torque.values
    injected = record.injected
    if injected is not None and injected.in_torque and injected.at is InjectionPoint.AFTER_LIMIT:
        output = output - np.interp(record.torque.time, injected.channel.time, injected.channel.values)
    size, here = np.abs(output), "" if side is None else f" on the {side} side"
    # Measured currents carry noise, and filters overshoot: only the command itself never passes the limit.
    beyond = float(np.mean(size > limit * (1 + AT_LIMIT)))
    if record.tap is Tap.COMMAND and beyond > BEYOND_SHARE:
        return [
            f"The torque reaches {size.max():g} {unit_name}{here}, beyond the controller's limit of {limit:g} "
            f"{unit_name}{here and ' there'}; check the limit, and the torque's unit and gain."
        ]
    share = float(np.mean(size >= limit * (1 - AT_LIMIT)))
    if share <= limit_share:
        return []
    return [
        f"The torque stands at its limit of {limit:g} {unit_name}{here} in {share:.1%} of the samples (at most "
        f"{limit_share:.1%} expected), where it says little of the joint; record a slower motion."
    ]


@np.errstate(over="ignore", invalid="ignore")  # a wrong column can hold any number, the largest too
def scale_faults(record: Record) -> list[str]:
    """Return the faults of signals that cannot have the unit, or the sign, that they are declared to have."""
    faults = []
    reference, motor, velocity = record.reference, record.motor_position, record.reference_velocity
    if reference is not None:
        faults += _size_faults("reference", reference)
    if motor is not None:
        faults += _size_faults("motor_position", motor)
    if reference is not None and motor is not None:
        faults += _ratio_faults("motor_position", motor, "reference", reference)
    if reference is not None and velocity is not None and len(reference) > 1:
        slope = np.gradient(reference.values, reference.sample_time)
        derivative = Channel(slope, velocity.unit, reference.sample_time)
        faults += _ratio_faults("reference_velocity", velocity, "the derivative of reference", derivative)
    return faults


def _size_faults(name: str, position: Channel) -> list[str]:
    """Return the fault of a position that moves faster or farther than a joint can."""
    if len(position) < 2:
        return []
    steps = np.abs(np.diff(position.values))
    speed = float(np.quantile(steps, 1 - SHARE_OF_FAST_SAMPLES)) / position.sample_time
    travel = float(np.ptp(position.values))
    if speed > FASTEST.get(position.unit, math.inf):
        fact = f"{name} moves at {speed:.3g} {position.unit}/s (at most {FASTEST[position.unit]:g} expected)"
    elif travel > LONGEST.get(position.unit, math.inf):
        fact = f"{name} travels {travel:.3g} {position.unit} (at most {LONGEST[position.unit]:g} expected)"
    else:
        return []
    return [f"{fact}: it is not in {position.unit}; give its unit, or its gain, and check the sample time."]


def _ratio_faults(name: str, channel: Channel, other_name: str, other: Channel) -> list[str]:
    """Return the faults of two signals that should agree, follow each other, and differ in sign or scale."""
    x, y = np.interp(channel.time, other.time, other.values), channel.values
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return []
    x, y = x - x.mean(), y - y.mean()
    x_size, y_size, product = float(np.linalg.norm(x)), float(np.linalg.norm(y)), float(x @ y)
    if not abs(product) >= FOLLOWS * x_size * y_size > 0:
        return []
    ratio = math.copysign(y_size / x_size, product)
    faults = []
    if ratio < 0:
        faults.append(f"{name} runs against {other_name}; give one of them sign = -1.")
    if not RATIO_BAND[0] <= abs(ratio) <= RATIO_BAND[1]:
        hint = _unit_hint(abs(ratio), name, other_name, channel.unit)
        faults.append(f"{name} is {abs(ratio):.4g} times {other_name}, and should equal it{hint}.")
    return faults


def _unit_hint(ratio: float, name: str, other_name: str, declared: str) -> str:
    """Return what a ratio of two signals says of their units, and what to do."""
    for entry in map(unit, units_of(unit(declared).dimension)):
        for suspect, factor in ((name, 1 / entry.factor), (other_name, entry.factor)):
            if factor != 1 and abs(ratio / factor - 1) < RATIO_TOLERANCE:
                return f", as if {suspect} were in {entry.name} and read as {entry.si}; check both units"
    return "; check both units, and give the gain of the one that is off"


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
