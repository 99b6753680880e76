"""Faults of the record: signs, swapped channels, sample time, a motion as reference, too little motion.

A record that is too short, or moves in one direction only, fits many drives: Coulomb friction and offset are one number
then. An axis hardly moves if its friction holds it, or if its disturbances exceed the torque that the reference needs.
The controller of a motor at rest sees the whole reference as an error. That torque is simulated with an immovable mass:
a record with this torque is of an axis at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.common.text import join, number
from jointid.diagnostics.faults.fault import Explanation, Fault, Hypothesis, Meaning, Shown
from jointid.diagnostics.faults.forces import find_steps
from jointid.diagnostics.faults.loop_gain import LAW_GAIN, TORQUE_SCALE, say_times
from jointid.diagnostics.faults.numbers import VELOCITY_FILTER, number_fault
from jointid.diagnostics.hypothesis_fits import MORE, Fit, fit_flexible, follow
from jointid.diagnostics.model_free import OF_LAW, SHORTEST, compare_law, fit_law_changes
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.drive_side import grid_starts, motion_problem
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.base import log_delay
from jointid.models.controllers import FirstOrder, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import simulate
from jointid.simulation.loop_input import prepare
from jointid.simulation.prescribed import DriveSide
from jointid.uncertainty.verdict import Reason

_TIMES = (0.1, 0.125, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0)  # times the sample time: rates that drives log at
_BY_TIME = 0.6  # of the declared error: a sample time that is wrong by a factor spoils all of a fit
_FLEXIBLE = 2.0  # times: reduction of the residual by a mode; its parameters absorb a third of an unmodelled friction
_IMMOVABLE = 1e20  # kg or kg m2
_FEW_STEPS = 20.0  # of an encoder, in all: fewer are no motion to a controller that sees them
_AS_AT_REST = 0.15  # of the torque's scatter: so little is left where it is that of an axis at rest
_SAME_SIZE = 0.25  # so near to 1 is then its size
_GAINS = ("position_gain", "velocity_gain", "derivative_gain")
_FILTERS = (1e-3, 2e-3, 4e-3, 8e-3)  # s
_EXPLAINED, _MOST_LEFT, _ALIKE = 0.7, 0.15, 1.1  # of what the law leaves; of the torque; times the least
_SURE, _FAR_OFF = 4.0, 0.1  # deviations; of a number: a position between two samples pretends less
_LOST = 0.3  # of the torque, that is no response to the reference
_AS_LARGE = 0.5  # of what the reference would make at rest: axes that move make a sixth of it at most
_REMEDY = "record a larger or faster motion"
_LEAST = 1.0  # s of motion: a shorter record is not relied on
_FEWEST_STEPS = 10  # of a motion
_ROUGH = 0.15  # of a step: by so much the next one may differ
_SLOW, _COUNTS = 0.1, 8.0  # of a fast step, and times the smallest: a smaller step tells nothing
_MOST_PLACES = 20  # more are how the reference is made
_SAID = 3  # places
_BACK = 0.05  # of all the way: who goes back less moves one way only


def _invert_torque(declared: Hypothesis) -> Iterator[Hypothesis]:
    torque = declared.record.torque
    assert torque is not None
    inverted = {"torque": replace(torque, values=-torque.values)}
    yield replace(declared, record=declared.record.with_channels(inverted))


REFERENCE_SIGN = Fault("reference_sign", "sign of the reference")


def _explain_sign(*_: object) -> Iterator[Meaning]:
    yield TORQUE_SIGN, "the torque has the wrong sign (set record.channels.torque.sign = -1)", None
    yield REFERENCE_SIGN, "the reference has the wrong sign (set record.channels.reference.sign = -1)", None


TORQUE_SIGN = Fault(
    "torque_sign", "sign of the torque", correct=_invert_torque, meanings=_explain_sign,
)  # fmt: skip


def _swap_channels(declared: Hypothesis) -> Iterator[Hypothesis]:
    torque, reference = declared.record.torque, declared.record.reference
    assert torque is not None
    assert reference is not None
    if len(torque) == len(reference):
        swapped = {
            "torque": replace(torque, values=reference.values),
            "reference": replace(reference, values=torque.values),
        }
        yield replace(declared, record=declared.record.with_channels(swapped))


SWAPPED_CHANNELS = Fault(
    "swapped_channels", "swapped channels", correct=_swap_channels, clause="torque and reference are swapped"
)


def with_cutoffs(filtering: Filtering, factor: float) -> Filtering:
    """Return a resolved filtering with its cut-offs so many times as high."""
    assert filtering.cutoff is not None
    assert filtering.position_cutoff is not None
    return replace(filtering, cutoff=factor * filtering.cutoff, position_cutoff=factor * filtering.position_cutoff)


def _try_sample_times(declared: Hypothesis) -> Iterator[Hypothesis]:
    if getattr(declared.controller, "period", None) is not None:
        return  # a controller with a period of its own contradicts a wrong sample time before anything is simulated
    for factor in _TIMES:
        channels = {n: replace(c, sample_time=factor * c.sample_time) for n, c in declared.record.items()}
        yield replace(
            declared,
            record=declared.record.with_channels(channels),
            filtering=with_cutoffs(declared.filtering, 1 / factor),
            factor=factor,
        )


def _explain_sample_time(value: float | None, loop: ClosedLoop, _: Shown) -> Iterator[Meaning]:
    assert value is not None
    yield SAMPLE_TIME, f"the sample time is {say_times(value)} too {'short' if value > 1 else 'long'}", value
    if "velocity_gain" in numbers_of(loop.controller):
        # u = g (Kv e - v): with all velocities f times as large it is the law with Kv f times as large, and g f times
        # as small. Only filters and delays tell the two apart, hardly.
        yield LAW_GAIN, "position gain and torque (or velocity gain) are both off by that factor", None


SAMPLE_TIME = Fault(
    "sample_time", "sample time", correct=_try_sample_times, meanings=_explain_sample_time, must_leave=_BY_TIME
)


# Causes that are judged by a problem of their own


def _judge_motion(declared: Hypothesis, best: Fit | None, _: float) -> tuple[float | None, float] | None:
    """Return the residual if the reference is the motor's position; None if it cannot be.

    The motion of a flexible joint is prescribed then, and not compared at rest. Its residual is scaled to that of the
    other causes by the residuals of the best of them under both measures.
    """
    record, joint = declared.record, declared.loops[0].joint
    assert record.torque is not None
    moved = replace(record, motor_position=record.reference, load_position=None)
    try:
        if not isinstance(joint, FlexibleJoint):
            return None, identify_record(moved, joint, IDIM(), filtering=declared.filtering).fit.filtered_error
        delay = log_delay(None, record.torque.sample_time)
        problem = motion_problem(moved, DriveSide(joint), declared.filtering, joint.parameters, delay)
        start = grid_starts(problem, None)[0][0]
        solution = follow(problem, start, MORE)
    except (JointidError, np.linalg.LinAlgError):
        return None
    left = float(np.linalg.norm(solution.residual)) / problem.size
    if best is None or best.problem.measured.size != problem.measured.size:
        return None, left
    measured = best.problem.measured
    other, size = (problem.filter(one) for one in (measured - best.problem.torque(best.x), measured))
    return None, left * best.error * float(np.linalg.norm(size) / np.linalg.norm(other))


REFERENCE_IS_POSITION = Fault(
    "reference_is_position", "position as reference", judge=_judge_motion,
    clause="the channel given as the reference is the motor's actual position",
    # Its response is the controller's, too, which it explains whatever the controller does.
    more_than_responses=2.0, doubt="more than one thing is wrong with the controller",
)  # fmt: skip


def _judge_mode(declared: Hypothesis, _: Fit | None, least: float) -> tuple[float | None, float] | None:
    """Return the mode that explains a record of a rigid joint clearly better than any other cause; else None.

    The additional parameters absorb a part of other causes, so an equal residual is not enough.
    """
    rigid = declared.loops[0].joint
    if not isinstance(rigid, RigidJoint):
        return None
    loop = replace(declared.loops[0], joint=rigid.flexible)
    try:
        found = next(iter(fit_flexible((replace(declared, loops=(loop,)),), loop)), None)
    except (JointidError, np.linalg.LinAlgError):  # the other causes stand
        return None
    if found is None or found.error * _FLEXIBLE > least:
        return None
    values = found.values
    if not all(values[name] > 0 for name in ("motor_inertia", "load_inertia", "stiffness")):
        return None
    return FlexibleJoint.frequencies(values)["free_free"], found.error


_BY_LAW, _OFF = 0.1, 1.5  # of the torque; times: a factor that the law and the position show
FLEXIBLE = Fault(
    "flexible", "flexible joint", judge=_judge_mode,
    clause='the joint is flexible (model = "flexible"), with a mode near {value} Hz',
)  # fmt: skip

# Records with too little motion


def find_plain_cause(record: Record) -> Message | None:
    """Return a cause visible in the samples of torque and reference; None without one."""
    assert record.reference is not None
    if record.injected is not None:  # that moves the joint, too
        return None
    short = _check_length(record.reference, SHORTEST, "to tell what is wrong")
    return short or find_lost_samples(record) or find_steps(record)


def find_lost_samples(record: Record) -> Message | None:
    """Return the message of samples that are missing in a record without stamps; None where the motion shows none.

    There a smooth motion goes a whole number of its steps at once.
    """
    channel = record.reference or record.motor_position
    if channel is None or channel.values.size < 2 * _FEWEST_STEPS:
        return None
    if record.torque is not None and _roughness(channel) > _roughness(record.torque):
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
        jumps = (
            (np.abs(before) > least)
            & even
            & near
            & (lost >= 1.0)
            & (np.abs(after - before) < _ROUGH * (2.0 + lost) * np.abs(before))
        )
    (places,) = np.nonzero(jumps)
    if not 0 < places.size <= _MOST_PLACES:
        return None
    said = [f"about {lost[k]:.0f} at {number(channel.sample_time * (k + 2), 3)} s" for k in places[:_SAID]]
    more = f" and at {places.size - _SAID} more" if places.size > _SAID else ""
    clause = f"samples are missing in the record: {join(said)}{more}"
    clause += "; cut it there (record.start, record.stop), or log time stamps"
    cause = {"cause": LOST_SAMPLES.name, "value": float(lost[places].sum()), "error": None}
    return Message(Reason.CAUSE_FOUND, clause, {"causes": [cause]}, clause)


def _roughness(channel: Channel) -> float:
    """Return the usual change of a signal's steps over its usual step."""
    steps = np.diff(channel.values)
    moving = steps[steps != 0.0]
    size = float(np.median(np.abs(moving))) if moving.size else 0.0
    return float(np.median(np.abs(np.diff(moving)))) / size if size and moving.size > 1 else 0.0


def find_too_short(record: Record) -> Message | None:
    """Return the message of a record that is too short for reliable values; None if it is long enough.

    Without a reversal a constant force replaces the Coulomb friction, and a short motion has few rows for many
    parameters.
    """
    if record.reference is None or record.injected is not None:
        return None
    return _check_length(record.reference, _LEAST, "to rely on")


def _check_length(reference: Channel, needed: float, what_for: str) -> Message | None:
    change = np.diff(reference.values)
    (moving,) = np.nonzero(change)
    seconds = reference.sample_time * (change.size + 1 - moving[0]) if moving.size else 0.0
    there, back = float(np.sum(change[change > 0])), float(-np.sum(change[change < 0]))
    both_ways = min(there, back) > _BACK * max(there, back)
    if both_ways and seconds >= needed:
        return None
    if seconds >= needed:
        clause = f"the record has motion one way only, which is too little {what_for}; there and back would do"
    else:
        lasts = f"it has {number(seconds, 2)} s of motion{'' if both_ways else ', one way only'}"
        clause = f"the record is too short {what_for}: {lasts}; {SHORTEST:g} s or more, both ways, would do"
    return Message(Reason.RECORD_TOO_SHORT, clause, {"seconds": seconds, "needed": SHORTEST}, clause)


def find_torque_scale(record: Record, loop: ClosedLoop) -> Message | None:
    """Return the factor of a torque beside that of the law for the motor's position; None near 1, or without both.

    The mechanics have no part in it, and a signal that is added to the torque keeps its own scale.
    """
    law = compare_law(record, loop)
    if law is None or law.left_in_time > _BY_LAW or not law.gain > 0 or max(law.gain, 1 / law.gain) < _OFF:
        return None
    size = "large" if law.gain > 1 else "small"
    clause = f"the torque is {say_times(law.gain)} too {size} for the declared law and the logged motor position"
    words = f"{clause}: check its unit, its torque constant and its side of the gear, and the gains of the law"
    cause = {"cause": "torque_scale", "value": law.gain, "error": law.left_in_time}
    return Message(Reason.CAUSE_FOUND, words, {"causes": [cause], "declared_error": None}, clause)


def explain_on_position(record: Record, loop: ClosedLoop, shown: Shown) -> tuple[float, tuple[Explanation, ...]]:
    """Compare the logged torque with that of the law along the motor position.

    Return the residual of the declared law, and the changes that leave far less. The mechanics have no part in it.
    Small changes may be those of a position that is unknown between two samples.
    """
    law: Any = loop.controller
    declared = fit_law_changes(record, loop, ())
    if not declared or declared[0].left < OF_LAW:
        return 0.0, ()
    numbers = numbers_of(law)
    gains = {name: value for name, value in numbers.items() if name in _GAINS and value}
    times = _FILTERS if getattr(law, "velocity_filter", None) == (1.0,) else ()
    others = [with_numbers(law, {name: 2.0 * value}) for name, value in gains.items()]
    others += [replace(law, velocity_filter=FirstOrder(time)) for time in times]
    fits = fit_law_changes(record, loop, others)
    if not fits:  # the record does not show another law
        return declared[0].left, ()
    none, scale, *changes = fits
    found = [(TORQUE_SCALE, 1.0 + scale.size, scale)]
    found += [(number_fault(name), v * (1 + c.size), c) for (name, v), c in zip(gains.items(), changes, strict=False)]
    filters = [(time, one) for time, one in zip(times, changes[len(gains) :], strict=True) if one.size > 0.0]
    if filters:  # that of a time whose size is as given
        time, one = min(filters, key=lambda pair: pair[1].left)
        found.append((VELOCITY_FILTER, time * one.size, one))
    least = min(one.left for _, _, one in found)
    if least > min(_EXPLAINED * none.left, _MOST_LEFT):
        return none.left, ()
    said = (
        Explanation(cause, words, number, one.left)
        for fault, value, one in sorted(found, key=lambda each: each[2].left)
        if one.left < _ALIKE * least and value > 0 and abs(one.size) > max(_SURE * one.std, _FAR_OFF)
        for cause, words, number in fault.explain(value, loop, shown)
    )
    return none.left, tuple(said)


def find_standstill(record: Record, loop: ClosedLoop) -> Message | None:
    """Return the message of an axis that hardly moves, by its motor's position or its torque; else None."""
    if record.injected is not None:  # that moves the joint, too
        return None
    return _check_motor(record) or _check_torque(record, loop)


def find_lost_motion(record: Record, loop: ClosedLoop, unexplained: float) -> Message | None:
    """Return the message of a motion that is too small beside the disturbances of the axis; else None."""
    both = None if record.injected is not None else _torque_at_rest(record, loop, integral=False)
    if both is None or unexplained < _LOST or np.std(both[0]) < _AS_LARGE * np.std(both[1]):
        return None
    return _state_standstill(
        f"the reference travels {_travel(record)} in all, and {number(100 * unexplained, 2)} % of the torque is no "
        "response to it"
    )


def _check_motor(record: Record) -> Message | None:
    motor = record.motor_position
    if motor is None:
        return None
    # Beside the reference its travel would say nothing: that may be in other units, or another channel.
    moved, step = float(np.ptp(motor.values)), find_encoder_step(motor)
    steps = moved / step if step else 0.0
    if steps > _FEW_STEPS or (moved and not step):
        return None
    counted = f", {steps:.0f} steps of its encoder," if steps else ""
    return _state_standstill(
        f"the motor moves by {number(moved, 2)} {motor.unit}{counted} where {_travel(record)} are asked"
    )


def _check_torque(record: Record, loop: ClosedLoop) -> Message | None:
    both = _torque_at_rest(record, loop)
    if both is None:
        return None
    torque, at_rest = both
    size = float(np.linalg.norm(torque - torque.mean()))
    # Where the motor stands is not known, and an integral sums that up.
    columns = np.column_stack([at_rest, np.ones(torque.size), np.linspace(0.0, 1.0, torque.size)])
    share = np.linalg.lstsq(columns, torque, rcond=None)[0]
    left = float(np.linalg.norm(torque - columns @ share))
    if not (left < _AS_AT_REST * size and abs(share[0] - 1.0) < _SAME_SIZE):
        return None
    moved = max(abs(float(share[0]) - 1.0), left / size)
    words = (
        f"with the motor at rest the controller would make all of this torque but {number(100 * left / size, 2)} %, "
    )
    words += f"so that it moves {number(100 * moved, 2)} % at most of the {_travel(record)} that are asked"
    return _state_standstill(words)


def _torque_at_rest(record: Record, loop: ClosedLoop, *, integral: bool = True) -> tuple[FloatArray, FloatArray] | None:
    """Return the torque, and the simulated one with the motor at rest, (samples,) each; None if that fails.

    Without `integral` the law has none: at rest it grows without bound.
    """
    law: Any = loop.controller
    law = law if integral or not getattr(law, "integral_gain", 0.0) else replace(law, integral_gain=0.0)
    joint = loop.joint.rigid if isinstance(loop.joint, FlexibleJoint) else loop.joint
    still = ClosedLoop(joint, law)
    values = dict.fromkeys((p.name for p in joint.parameters), 0.0) | {"inertia": _IMMOVABLE}
    try:
        with np.errstate(all="ignore"):
            at_rest = simulate(still, prepare(still, record), values).torque
    except JointidError:
        return None
    assert record.torque is not None
    count = min(at_rest.size, record.torque.values.size)
    torque, at_rest = record.torque.values[:count], at_rest[:count]
    return (torque, at_rest) if np.all(np.isfinite(at_rest)) and np.ptp(torque) and np.ptp(at_rest) else None


def _travel(record: Record) -> str:
    assert record.reference is not None
    return f"{number(float(np.ptp(record.reference.values)), 2)} {record.reference.unit}"


def _state_standstill(words: str) -> Message:
    clause = f"the axis hardly moves: {words}; {_REMEDY}"
    return Message(Reason.HARDLY_MOVES, clause, {}, clause)


LOST_SAMPLES = Fault("lost_samples", "samples that are missing")

FAULTS = (
    TORQUE_SIGN, REFERENCE_SIGN, SWAPPED_CHANNELS, SAMPLE_TIME, LOST_SAMPLES, REFERENCE_IS_POSITION, FLEXIBLE,
)  # fmt: skip
