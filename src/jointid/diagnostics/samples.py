"""Causes that the samples of a record show by themselves: too little motion, samples that are missing, another scale.

A record that is too short, or moves in one direction only, fits many drives: Coulomb friction and offset are one number
then.
"""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import join, number, pluralise
from jointid.diagnostics.model_free import SHORTEST
from jointid.estimation.result.verdict import Reason
from jointid.records.checks import find_encoder_step
from jointid.records.record import Record

_FEW_STEPS = 20.0  # of an encoder, in all: fewer are no motion to a controller that sees them
_LEAST = 1.0  # s of motion: a shorter record is not relied on
_BACK = 0.05  # of all the way: who goes back less moves one way only
_FEWEST_STEPS = 10  # of a motion
_ROUGH = 0.15  # of a step: by so much the next one may differ
_SLOW, _COUNTS = 0.1, 8.0  # of a fast step, and times the smallest: a smaller step tells nothing
_MOST_PLACES = 20  # more are how the reference is made
_SAID = 3  # places
_OFF_FOR, _NOTHING = 0.25, 0.03  # s; of the torque's scatter: without a torque for so long, the drive is off
_RESTS, _NEAR_BY = 2e-3, 0.05  # of the largest speed and travel; of the travel
_MEAN, _VARIES = 21, 0.5  # samples; of the root mean square of an acceleration that is not one and the same
_JUMP = 10.0  # times the largest step but a few: no motor moves so far in a sample
_FEW_CHANGES, _AT_ONCE = 0.02, 5  # of the samples, at which a reference in steps changes; samples
_FEWEST_JUMPS = 12  # steps of an injected signal
_CLEAR_JUMP, _ROUNDED, _LARGE_JUMP = 10.0, 5, 0.03  # times the median and the least change; of the torque's scatter
_ALONE = 0.3  # of a step: so much the samples before and after it may change
_IDLE, _OFTEN, _AS_OFTEN = 1e-3, 0.02, 1 / 3  # of the greatest speed, of the samples, and as all over the record
_OWN = 0.5  # of their squares: so much of the steps is none of the reference's velocity, acceleration and direction


def find_plain_cause(record: Record) -> Message | None:
    """Return a cause visible in the samples of torque and reference; None without one."""
    if record.injected is not None:  # that moves the joint, too
        return None
    short = _check_length(record, SHORTEST, "to tell what is wrong")
    return short or find_broken_part(record) or find_profiled_steps(record) or find_steps(record)


def find_broken_part(record: Record) -> Message | None:
    """Return the message of a record whose motion is none of the joint's, all of it or a part; None without one."""
    return find_lost_samples(record) or find_parts_off(record) or find_new_zero(record) or find_standstill(record)


def find_too_short(record: Record) -> Message | None:
    """Return the message of a record that is too short for reliable values; None if it is long enough.

    Without a reversal a constant force replaces the Coulomb friction, and a short motion has few rows for many
    parameters.
    """
    return None if record.injected is not None else _check_length(record, _LEAST, "to rely on")


def _found(name: str, value: float | None, clause: str, **more: object) -> Message:
    cause = {"cause": name, "value": value, "error": None}
    return Message(Reason.CAUSE_FOUND, clause, {"causes": [cause], **more}, clause)


def _check_length(record: Record, needed: float, what_for: str) -> Message | None:
    if record.reference is None:
        return None
    change = np.diff(record.reference.values)
    (moving,) = np.nonzero(change)
    seconds = record.reference.sample_time * (change.size + 1 - moving[0]) if moving.size else 0.0
    there, back = float(np.sum(change[change > 0])), float(-np.sum(change[change < 0]))
    both_ways = min(there, back) > _BACK * max(there, back)
    if both_ways and seconds >= needed:
        return None
    lasts = f"it has {number(seconds, 2)} s of motion{'' if both_ways else ', one way only'}"
    clause = f"the record is too short {what_for}: {lasts}; {SHORTEST:g} s or more, both ways, would do"
    return Message(Reason.RECORD_TOO_SHORT, clause, {"seconds": seconds, "needed": SHORTEST}, clause)


def find_steps(record: Record) -> Message | None:
    """Return the message of an undeclared injected signal, if the torque has steps of its own; else None.

    A step is a change in one sample between two without a change. Steps of a controller that is slower than the log,
    or of a stepped reference, correlate with the reference, and stop while it rests.
    """
    torque, reference = record.torque, record.reference
    assert torque is not None
    assert reference is not None
    signed = np.diff(torque.values)
    change = np.abs(signed)
    if record.injected is not None or change.size < 2 * _FEWEST_JUMPS or not np.any(change):
        return None
    rounding = float(np.min(change[change > 0]))
    bound = max(_CLEAR_JUMP * float(np.median(change)), _ROUNDED * rounding, _LARGE_JUMP * float(np.std(torque.values)))
    here = change[1:-1]
    steps = (here > bound) & (np.maximum(change[:-2], change[2:]) < _ALONE * here)
    velocity = np.gradient(reference.values, reference.sample_time)
    asked = np.column_stack([velocity, np.gradient(velocity), np.sign(velocity)])
    asked = np.column_stack([np.interp(torque.time, reference.time, one)[1:-2] for one in asked.T])
    rests = np.abs(asked[:, 0]) < _IDLE * np.max(np.abs(velocity))
    count = int(np.sum(steps))
    stop_with_it = np.mean(rests) > _OFTEN and np.mean(steps[rests]) < _AS_OFTEN * np.mean(steps)
    if count < _FEWEST_JUMPS or stop_with_it:
        return None
    sizes, by = signed[1:-1][steps], asked[steps] / np.maximum(np.max(np.abs(asked), axis=0), np.finfo(float).tiny)
    own = sizes - by @ np.linalg.lstsq(by, sizes, rcond=None)[0]
    if own @ own < _OWN * (sizes @ sizes):
        return None
    said = "a signal is injected that is not declared (channel injected): the torque makes"
    return _found("injected", count, f"{said} {pluralise(count, 'step')} that the reference does not ask for")


def find_lost_samples(record: Record) -> Message | None:
    """Return the message of samples that are missing in a record without stamps; None where the motion shows none.

    There a smooth motion goes a whole number of its steps at once.
    """
    channel = record.reference or record.motor_position
    if channel is None or channel.values.size < 2 * _FEWEST_STEPS:
        return None
    if record.torque is not None and _roughness(channel.values) > _roughness(record.torque.values):
        return None  # which is no motion
    steps = np.diff(channel.values)
    before, here, after = steps[1:-3], steps[2:-2], steps[3:-1]
    with np.errstate(all="ignore"):
        times = 2.0 * here / (before + after)
        smooth = _ROUGH * np.minimum(np.abs(before), np.abs(after))
        even = (np.abs(before - steps[:-4]) < smooth) & (np.abs(after - steps[4:]) < smooth)
        lost = np.round(times) - 1.0
        # Between the samples that are missing the steps change as on either side.
        near = np.abs(times - lost - 1.0) < _ROUGH * (1.0 + lost)
        # Slow steps of a rounded position are few counts, and any of them may be twice the one before.
        sizes = np.sort(np.abs(steps[steps != 0.0]))
        least = max(_SLOW * float(sizes[int(0.9 * sizes.size)]), _COUNTS * float(sizes[0])) if sizes.size else 0.0
        alike = np.abs(after - before) < _ROUGH * (2.0 + lost) * np.abs(before)
        (places,) = np.nonzero((np.abs(before) > least) & even & near & (lost >= 1.0) & alike)
    if not 0 < places.size <= _MOST_PLACES:
        return None
    said = [f"about {lost[k]:.0f} at {number(channel.sample_time * (k + 2), 3)} s" for k in places[:_SAID]]
    more = f" and at {places.size - _SAID} more" if places.size > _SAID else ""
    clause = f"samples are missing in the record: {join(said)}{more}"
    clause += " from the first that was read; cut it there (record.start, record.stop), or log time stamps"
    return _found("lost_samples", float(lost[places].sum()), clause)


def _roughness(values: FloatArray) -> float:
    """Return the usual change of a signal's steps over its usual step."""
    steps = np.diff(values)
    moving = steps[steps != 0.0]
    size = float(np.median(np.abs(moving))) if moving.size else 0.0
    return float(np.median(np.abs(np.diff(moving)))) / size if size and moving.size > 1 else 0.0


def find_parts_off(record: Record) -> Message | None:
    """Return the message of parts in which the drive is off: without torque, the axis stands where a load pulls.

    The pull is told by motion past that place, both ways. Friction could hold it if it were larger.
    """
    torque, motor = record.torque, record.motor_position
    if torque is None or motor is None or torque.values.shape != motor.values.shape:
        return None
    u, T, size = torque.values, torque.sample_time, max(round(_OFF_FOR / torque.sample_time), 1)
    q = np.convolve(motor.values, np.ones(_MEAN) / _MEAN, "same")
    v = np.gradient(q, T)
    a, travel = np.gradient(v, T), float(np.ptp(motor.values))
    off = list[tuple[float, float]]()
    for first in range(0, u.size - size + 1, size):
        part = slice(first, first + size)
        if np.ptp(motor.values[part]) > _RESTS * travel or np.sqrt(np.mean(u[part] ** 2)) > _NOTHING * np.std(u):
            continue
        here = np.abs(q - np.mean(motor.values[part])) < _NEAR_BY * travel
        passes = here & (np.abs(v) > _RESTS * np.max(np.abs(v)))
        if _pulls(u[passes], np.sign(v[passes]), a[passes], 0.1 * float(np.std(u))):
            begin = off.pop()[0] if off and off[-1][1] == first * T else first * T
            off.append((begin, part.stop * T))
    if not off:
        return None
    parts = join([f"from {number(begin, 3)} to {number(end, 3)} s" for begin, end in off[:_SAID]])
    clause = f"the drive is off {parts} from the first sample that was read: the axis stands there without a torque "
    clause += "where a load pulls at it; identify a part without them (record.start, record.stop)"
    return _found("drive_off", sum(end - begin for begin, end in off), clause, parts=off)


def _pulls(torque: FloatArray, way: FloatArray, acceleration: FloatArray, least: float) -> bool:
    """Test whether a torque past a place has a part, above the least and the friction, that neither way makes."""
    known = acceleration.size and np.std(acceleration) > _VARIES * np.sqrt(np.mean(acceleration**2))
    if not known or min(np.sum(way > 0.0), np.sum(way < 0.0)) < _MEAN:
        return False  # at an end of the travel the inertia looks like a load
    columns = np.column_stack([np.ones(way.size), way, acceleration])
    pull, friction, _ = np.linalg.lstsq(columns, torque, rcond=None)[0]
    return bool(abs(pull) > max(abs(friction), least))


def find_new_zero(record: Record) -> Message | None:
    """Return the message of positions whose zero is set within the record, as by homing: they jump together."""
    motor, reference = record.motor_position, record.reference
    if motor is None or reference is None or motor.values.shape != reference.values.shape:
        return None
    steps, asked = np.diff(motor.values), np.diff(reference.values)
    usual = float(np.sort(np.abs(steps))[-_SAID - 1]) if steps.size > _SAID else 0.0
    (places,) = np.nonzero((np.abs(steps) > _JUMP * usual) & (np.abs(asked - steps) < _ROUGH * np.abs(steps)))
    if not usual > 0.0 or not places.size:
        return None
    jumps = [(number(float(steps[k]), 3), number(motor.sample_time * (k + 1), 3)) for k in places]
    said = join([f"by {size} {motor.unit} at {instant} s" for size, instant in jumps])
    clause = f"reference and motor position jump together {said} from the first sample that was read: a new zero was "
    clause += "set there; identify a part without it (record.start, record.stop)"
    return _found("new_zero", float(steps[places[0]]), clause)


def find_profiled_steps(record: Record) -> Message | None:
    """Return the message of a reference in steps that the torque does not follow at once: a profile is behind it."""
    reference, torque = record.reference, record.torque
    if reference is None or torque is None or torque.values.shape != reference.values.shape:
        return None
    (places,) = np.nonzero(np.diff(reference.values))
    changes = np.abs(np.diff(torque.values))
    if not _SAID <= places.size < _FEW_CHANGES * changes.size:
        return None
    after = [float(np.max(changes[k : k + _AT_ONCE])) for k in places]
    if np.median(after) > np.quantile(changes, 1.0 - _FEW_CHANGES):
        return None
    clause = "the reference comes in steps that the torque does not follow at once: the drive makes a profile of them; "
    return _found("profiled_steps", None, clause + "log the setpoint behind its profile as the reference")


def find_standstill(record: Record) -> Message | None:
    """Return the message of a motor that hardly moves; None where it does, or where its position is not logged.

    Beside the reference its travel would say nothing: that may be in other units, or another channel.
    """
    motor, reference = record.motor_position, record.reference
    if record.injected is not None or motor is None or reference is None:  # a signal moves the joint, too
        return None
    moved, step = float(np.ptp(motor.values)), find_encoder_step(motor)
    steps = moved / step if step else 0.0
    if steps > _FEW_STEPS or (moved and not step):
        return None
    asked = f"{number(float(np.ptp(reference.values)), 2)} {reference.unit}"
    clause = f"the axis hardly moves: the motor moves by {number(moved, 2)} {motor.unit}, {steps:.0f} steps of its "
    clause += f"encoder, where {asked} are asked; record a larger or faster motion"
    return Message(Reason.HARDLY_MOVES, clause, {}, clause)
