"""Tests of a record without a model of its joint.

The samples show too little motion, missing samples, a drive that is off. `compare_law` compares the logged torque with
that of the declared controller for the logged motor position: law, delay and gain of the log. If the law reproduces the
torque, `excludes` excludes other laws and logs, for any joint.

`find_unexplained_share` fits free linear responses. A linear loop answers its reference linearly, and Coulomb friction
is one more input of it, the sign of the velocity. A cause with a clearly larger residual does not explain everything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.common.text import join, number, pluralise
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import INJECTED, Controller
from jointid.models.joints import ClosedLoop
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import find_noise_limit, lowpass
from jointid.simulation.controller_torque import law_outputs
from jointid.simulation.loop_input import prepare, to_log
from jointid.uncertainty.covariance import Influence

_MEMORY = 0.3  # s, that a loop remembers
_SHORTEST = 2.0  # s of a record: a shorter one has fewer than two samples for each number of the responses

# The samples

_FEW_STEPS = 20.0  # of an encoder, in all: fewer are no motion to a controller that sees them
_LEAST = 1.0  # s of motion: a shorter record is not relied on
_BACK = 0.05  # of all the way: who goes back less moves one way only
_FEWEST_STEPS = 10  # of a motion
_ROUGH = 0.15  # of a step: by so much the next one may differ
_SLOW, _COUNTS = 0.1, 8.0  # of a fast step, and times the smallest: a smaller step shows nothing
_MOST_PLACES, _MOST_OF = 20, 0.01  # of the samples: more are how the reference is made
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
    """Cause visible in the samples of torque and reference; None without one."""
    if record.injected is not None:  # that moves the joint, too
        return None
    short = find_too_short(record, _SHORTEST, "to find what is wrong")
    return short or find_broken_part(record) or find_profiled_steps(record) or find_steps(record)


def find_broken_part(record: Record) -> Message | None:
    """Message on parts in which the drive is inactive; None without one."""
    return find_lost_samples(record) or find_parts_off(record) or find_new_zero(record) or find_standstill(record)


def _found(name: str, value: float | None, clause: str, **more: object) -> Message:
    cause = {"cause": name, "value": value, "error": None}
    return Message(Reason.CAUSE_FOUND, clause, {"causes": [cause], **more}, clause)


def offer(key: str, spans: Iterable[tuple[float, float]]) -> str:
    """Joint-file key that reads parts of the time, or leaves them out."""
    return f"record.{key} = {[[round(float(instant), 3) for instant in span] for span in spans]}"


def _offer_parts(record: Record, channel: Channel, jumps: Iterable[int]) -> str:
    """Joint-file key that reads a record in parts between jumps."""
    at, ends = record.on_clock(channel.time), [0, *(k + 1 for k in jumps), len(channel)]
    return offer("parts", [(at[first], at[end - 1]) for first, end in pairwise(ends)])


def find_too_short(record: Record, needed: float = _LEAST, what_for: str = "to rely on") -> Message | None:
    """Message on less motion than needed, s; None if there is enough.

    Without a reversal a constant force replaces the Coulomb friction, and a short motion has few rows for many
    parameters.
    """
    if record.injected is not None or record.reference is None:  # such a signal moves the joint, too
        return None
    change = np.diff(record.reference.values)
    (moving,) = np.nonzero(change)
    seconds = record.reference.sample_time * (change.size + 1 - moving[0]) if moving.size else 0.0
    there, back = float(np.sum(change[change > 0])), float(-np.sum(change[change < 0]))
    both_ways = min(there, back) > _BACK * max(there, back)
    if both_ways and seconds >= needed:
        return None
    lasts = f"it has {number(seconds, 2)} s of motion{'' if both_ways else ', one way only'}"
    clause = f"the record is too short {what_for}: {lasts}; {_SHORTEST:g} s or more, both ways, would do"
    return Message(Reason.RECORD_TOO_SHORT, clause, {"seconds": seconds, "needed": _SHORTEST}, clause)


def find_steps(record: Record) -> Message | None:
    """Message on an undeclared injected signal, if the torque has own steps.

    A step is a change in one sample between two without a change. Steps of a controller that is slower than the log,
    or of a stepped reference, correlate with the reference, and stop while it rests.
    """
    torque, reference = record.torque, record.reference
    assert torque is not None and reference is not None
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
    """Message on samples missing without stamps, or None: several steps at once."""
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
    if not 0 < places.size <= max(_MOST_PLACES, _MOST_OF * steps.size):
        return None
    at = record.on_clock(channel.time)
    said = [f"about {lost[k]:.0f} at {at[k + 2]:.12g} s" for k in places[:_SAID]]
    more = f" and at {places.size - _SAID} more" if places.size > _SAID else ""
    clause = f"samples are missing in the record: {join(said)}{more}; log time stamps"
    clause += "" if more else f", or read it in parts ({_offer_parts(record, channel, places + 2)})"
    return _found("lost_samples", float(lost[places].sum()), clause)


def _roughness(values: FloatArray) -> float:
    """Return the usual change of a signal's steps over its usual step."""
    steps = np.diff(values)
    moving = steps[steps != 0.0]
    size = float(np.median(np.abs(moving))) if moving.size else 0.0
    return float(np.median(np.abs(np.diff(moving)))) / size if size and moving.size > 1 else 0.0


def find_parts_off(record: Record) -> Message | None:
    """Message on parts with the drive off, or None.

    The axis stands there without torque, although motion past it, both ways, shows a load larger than friction.
    """
    torque, motor = record.torque, record.motor_position
    if torque is None or motor is None or torque.values.shape != motor.values.shape:
        return None
    u, T, size = torque.values, torque.sample_time, max(round(_OFF_FOR / torque.sample_time), 1)
    counts, at = record.counts(u.size, T), record.on_clock(np.append(torque.time, torque.duration))
    q = np.convolve(motor.values, np.ones(_MEAN) / _MEAN, "same")
    v = np.gradient(q, T)
    a, travel = np.gradient(v, T), float(np.ptp(motor.values))
    off = list[tuple[float, float]]()
    for first in range(0, u.size - size + 1, size):
        part = slice(first, first + size)
        moved = np.ptp(motor.values[part]) > _RESTS * travel
        if moved or not np.any(counts[part]) or np.sqrt(np.mean(u[part] ** 2)) > _NOTHING * np.std(u):
            continue
        here = np.abs(q - np.mean(motor.values[part])) < _NEAR_BY * travel
        passes = here & (np.abs(v) > _RESTS * np.max(np.abs(v)))
        if _pulls(u[passes], np.sign(v[passes]), a[passes], 0.1 * float(np.std(u))):
            begin = off.pop()[0] if off and at[first] <= off[-1][1] + 2 * _OFF_FOR else at[first]
            off.append((begin, at[part.stop]))
    if not off:
        return None
    parts = join([f"from {begin:.12g} to {end:.12g} s" for begin, end in off[:_SAID]])
    clause = f"the drive is off {parts}: the axis stands there without a torque where a load pulls at it; leave that "
    clause += f"out ({offer('leave_out', [(begin - _OFF_FOR, end + _OFF_FOR) for begin, end in off])})"
    return _found("drive_off", sum(end - begin for begin, end in off), clause, parts=off)


def _pulls(torque: FloatArray, way: FloatArray, acceleration: FloatArray, least: float) -> bool:
    """Test for a direction-independent torque that exceeds friction."""
    known = acceleration.size and np.std(acceleration) > _VARIES * np.sqrt(np.mean(acceleration**2))
    if not known or min(np.sum(way > 0.0), np.sum(way < 0.0)) < _MEAN:
        return False  # at an end of the travel the inertia looks like a load
    columns = np.column_stack([np.ones(way.size), way, acceleration])
    pull, friction, _ = np.linalg.lstsq(columns, torque, rcond=None)[0]
    return bool(abs(pull) > max(abs(friction), least))


def find_new_zero(record: Record) -> Message | None:
    """Message on positions that jump together, as their zero is set anew."""
    motor, reference = record.motor_position, record.reference
    if motor is None or reference is None or motor.values.shape != reference.values.shape:
        return None
    steps, asked = np.diff(motor.values), np.diff(reference.values)
    usual = float(np.sort(np.abs(steps))[-_SAID - 1]) if steps.size > _SAID else 0.0
    (places,) = np.nonzero((np.abs(steps) > _JUMP * usual) & (np.abs(asked - steps) < _ROUGH * np.abs(steps)))
    if not usual > 0.0 or not places.size:
        return None
    at = record.on_clock(motor.time)
    said = join([f"by {number(float(steps[k]), 3)} {motor.unit} at {at[k + 1]:.12g} s" for k in places])
    clause = f"reference and motor position jump together {said}: a new zero was set there; read the record in parts "
    clause += f"({_offer_parts(record, motor, places)})"
    return _found("new_zero", float(steps[places[0]]), clause)


def find_profiled_steps(record: Record) -> Message | None:
    """Message on reference steps that the torque does not follow at once."""
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
    """Message on a motor that hardly moves, whatever its reference, or None."""
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


# The declared law

_LATEST = 8  # samples: the largest delay, either way, of the torque
_PARTS = 4  # of a sample: the steps of the delay
_BORDER = 20  # samples at each end that are not compared
_BETTER = 0.8  # of the residual: a delay must reduce it to this
_LAGS = 8  # samples of reference and position in a free law
_OF_LAW = 0.03  # of a torque: what a controller which holds leaves along the logged position, at most
_BEYOND_NOISE = 2.0  # times what any law leaves: the declared one is not what the drive runs
_GAIN = 0.03  # off 1
_LEAVES = 0.1  # of the torque: more is not what rounding leaves
_MORE = 1.15  # times what any law leaves of it
_BESIDE, _LARGE = 0.01, 0.5  # of the torque, left beside a factor that is off 1 by less: such a factor leaves noise
_LATE = 0.25  # samples: no more is no delay
_A_QUARTER, _SURELY = 0.25, 3.0  # of a change, with so many deviations: a record that has less of it excludes it


class Agreement(StrEnum):
    """How a declared law agrees with logged torque and motor position."""

    HOLDS = "loop_as_declared"
    DIFFERS = "law_differs"
    SCALED = "law_scaled"
    LATE = "law_late"


@dataclass(frozen=True, slots=True)
class LawOnPosition:
    """Logged torque and that of the declared law, for the motor position.

    Attributes:
        left: residual as a share of the torque about its mean.
        gain: factor on the law's torque.
        late: delay of the logged torque in addition to the declared one, s; 0 if no shift of more than a quarter of a
            sample explains clearly more.
        left_in_time: residual share with that delay corrected.
        noise: residual share of a free linear law of the last samples of reference and position, which is noise.
    """

    left: float
    gain: float
    late: float
    left_in_time: float
    noise: float

    @property
    def holds(self) -> bool:
        """Whether the declared law reproduces the logged torque."""
        return not self.late and abs(self.gain - 1.0) < _GAIN and self.left < max(_OF_LAW, _BEYOND_NOISE * self.noise)

    @property
    def agreement(self) -> Message:
        """Message whether the declared law reproduces the logged torque, of code `Agreement`."""
        left = f"({number(100 * self.left, 2)} % of the torque is left)"
        code, said = Agreement.HOLDS, f"the declared law makes the torque of the motor's position {left}"
        if self.late and self.left_in_time < 2 * _LEAVES:
            way = f"{number(1e3 * abs(self.late), 2)} ms {'later' if self.late > 0 else 'earlier'}"
            code, said = Agreement.LATE, f"the torque is {way} than the declared law makes it of the motor's position: "
            said += "check the delay, and which instant a logged value stands for (timing)"
        elif self.left > max(_BESIDE if _GAIN < abs(self.gain - 1) < _LARGE else _LEAVES, _MORE * self.noise):
            code = Agreement.DIFFERS
            said = f"the declared law does not make the torque of the motor's position {left}: "
            said += "jointid learn-controller learns the law, unless the torque's unit, a sign or a clock is wrong"
        elif abs(self.gain - 1) > max(_GAIN, self.left):
            code, what = Agreement.SCALED, "sign" if self.gain < 0 else "unit or gain"
            said = f"the torque is {number(self.gain, 4)} times what the declared law makes of the motor's position: "
            said += f"the torque's {what}, or the law's last gain, is not as declared"
        return Message(code, said)


def compare_law(record: Record, loop: ClosedLoop) -> LawOnPosition | None:
    """Compare logged and law's torque for the motor position; None without both.

    The initial value of the integral and a constant torque are free. The position follows a cubic spline between two
    samples of the log. Torques are compared up to the frequency that the noise of the position allows: a law
    differentiates that noise, and a controller that is as declared has not seen it.
    """
    if (followed := _follow(record, loop)) is None:
        return None
    logged, made, see = followed
    assert record.torque is not None
    columns, inside = np.column_stack([made, np.ones(logged.size)]), _select_rows(record, logged.size)

    def at(late: float) -> tuple[float, FloatArray]:
        """Residual of the torque, and the weights, with the law delayed."""
        whole = math.floor(late)
        before, share = inside - whole, late - whole
        return _regress(logged[inside], (1 - share) * columns[before] + share * columns[before - 1])

    left, weights = at(0.0)
    near = min(range(-_LATEST, _LATEST + 1), key=lambda late: at(late)[0])
    shifts = np.clip(near + np.arange(-_PARTS, _PARTS + 1) / _PARTS, -_LATEST, _LATEST)
    late = float(min(shifts, key=lambda late: at(late)[0]))
    in_time, scaled = at(late)
    if in_time > _BETTER * left or abs(late) <= _LATE:
        late, in_time, scaled = 0.0, left, weights
    noise = _regress_on_past(record, logged, see)
    return LawOnPosition(left, float(scaled[0]), late * record.torque.sample_time, in_time, noise)


def excludes(record: Record, loop: ClosedLoop, controller: Controller, late: float = 0.0, gain: float = 0.0) -> bool:
    """Test whether a record excludes another law or log.

    The difference of logged and law's torque is regressed on the change by the other law or log. The coefficient is 0
    as declared and 1 with the change; below a quarter it is excluded. The initial value of the integral and a constant
    torque are free. Of the log are `late`, its delay in s, and `gain`, less 1.
    """
    own, other = _follow(record, loop), _follow(record, replace(loop, controller=controller))
    if own is None or other is None or record.torque is None:
        return False
    (logged, made, _), at = own, np.arange(min(len(own[1]), len(other[1])))
    later = (1.0 + gain) * np.interp(at - late / record.torque.sample_time, at, other[1][: at.size, 0])
    columns = np.column_stack([later - made[: at.size, 0], made[: at.size, 1:], np.ones(at.size)])
    inside = _select_rows(record, at.size)
    left, columns = (logged - made[:, 0])[inside], columns[inside]
    sizes = column_norms(columns)
    if np.ptp(columns[:, 0]) == 0.0:
        return False
    weights = np.linalg.lstsq(columns / sizes, left, rcond=None)[0]
    std = Influence(columns / sizes, left - columns / sizes @ weights).robust().std
    return bool(abs(weights[0]) + _SURELY * std[0] < _A_QUARTER * sizes[0])


def _select_rows(record: Record, samples: int, border: int = _BORDER) -> NDArray[np.intp]:
    """Return the indices of the torque samples that count, without the ends."""
    assert record.torque is not None
    found = np.flatnonzero(record.counts(samples, record.torque.sample_time))
    return found[(found >= border) & (found < samples - border)]


def _follow(
    record: Record, loop: ClosedLoop
) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]] | None:
    """Logged torque, (samples,), law's torques, (samples, columns), and filter of both.

    None without a motor position, or for a law that cannot follow it.
    """
    torque = record.torque
    if record.motor_position is None or record.reference is None or torque is None or record.computed:
        return None
    try:
        made = law_outputs(record.motor_position, prepare(loop, record).axis)
    except JointidError:
        return None
    position, count = record.motor_position, min(torque.values.size, len(made))
    limit = find_noise_limit([position.values], position.sample_time)
    see = partial(lowpass, cutoff=limit, sample_time=torque.sample_time)
    if count < 4 * _BORDER or not np.all(np.isfinite(made)) or np.ptp(torque.values) == 0 or np.ptp(made[:, 0]) == 0:
        return None
    return see(torque.values[:count]), see(made[:count]), see


def _regress_on_past(record: Record, logged: FloatArray, see: Callable[[FloatArray], FloatArray]) -> float:
    """Residual share of a filtered torque regressed on past signals."""
    from scipy.linalg import toeplitz

    assert record.torque is not None
    time = record.torque.time[: logged.size]
    seen = {name: np.interp(time, one.time, one.values) for name, one in record.items()}
    r, q = seen["reference"], seen["motor_position"]
    more = [seen[name] for name in ("reference_velocity", "injected") if name in seen]
    total, *signals = see(np.column_stack([np.cumsum(r - q), r - q, np.gradient(q), *more])).T
    late = (toeplitz(one, np.full(_LAGS, one[0])) for one in signals)
    inside = _select_rows(record, r.size, 0)
    return _regress(logged[inside], np.column_stack([total, np.ones(r.size), *late])[inside])[0]


def _regress(seen: FloatArray, columns: FloatArray) -> tuple[float, FloatArray]:
    """Residual share of a signal about its mean, and least-squares weights."""
    sizes = column_norms(columns)
    products = columns.T @ columns / np.outer(sizes, sizes)
    weights = np.linalg.lstsq(products, columns.T @ seen / sizes, rcond=None)[0] / sizes
    rest, whole = float(np.linalg.norm(seen - columns @ weights)), float(np.linalg.norm(seen - seen.mean()))
    return rest / whole if whole else math.inf, weights


# Free responses

_STANDS = 1e-9  # of the greatest velocity
_RIDGE = 1e-10  # of a column's square: responses between samples of a filtered signal are nearly the same


def find_unexplained_share(problem: ClosedLoopProblem, reference: FloatArray) -> float:
    """Share of the torque without linear response to reference or injected signal.

    Products of lagged signals follow from those of one lag less: only the ends of the runs of rows differ.
    """
    from scipy.signal import fftconvolve

    filtering, T = problem.filtering, problem.sample_time
    torque, at = filtering.decimate(problem.measured, T), problem.log.kept // (filtering.decimation or 1)
    if reference.size != problem.measured.size:  # logged at a rate of its own
        time = np.arange(problem.measured.size) * (reference.size / problem.measured.size)
        reference = np.interp(time, np.arange(reference.size), reference)
    velocity = np.gradient(reference)
    moving = np.abs(velocity) > _STANDS * np.max(np.abs(velocity))
    inputs = [np.gradient(velocity), velocity, np.sign(np.where(moving, velocity, 0.0))]
    added = problem.axis.inputs[:, INJECTED] + problem.axis.after_limit
    if np.any(added):
        inputs.append(to_log(problem.axis, added))
    seen = filtering.decimate(np.column_stack(inputs), T)
    seen /= column_norms(seen)
    (size, count), lags = seen.shape, min(math.ceil(_MEMORY / (T * reference.size / torque.size)), torque.size)
    rows, width = at.size, count * lags + 1
    if rows < 2 * width:
        return 0.0
    counts = np.zeros((size, 1))
    counts[at] = 1.0
    targets = counts * np.column_stack([seen, np.ones(size), torque])
    first = fftconvolve(targets[:, np.newaxis], seen[::-1, :, np.newaxis], axes=0)[size - 1 : size - 1 + lags]
    late, ends = np.concatenate([np.zeros((lags, count)), seen]), np.flatnonzero(np.diff(counts[:, 0], 1, -1, 0.0, 0.0))
    edges = [((-1.0) ** k, late[end : lags + end][::-1]) for k, end in enumerate(ends)]
    products = np.empty((lags, count, lags, count))
    products[0] = first[:, :, :count].transpose(2, 0, 1)
    for lag in range(lags - 1):
        products[lag + 1, :, 0] = first[lag + 1, :, :count]
        change = sum(sign * edge[lag, :, np.newaxis, np.newaxis] * edge[:-1] for sign, edge in edges)
        products[lag + 1, :, 1:] = products[lag, :, :-1] + change
    normal = np.pad(products.reshape(width - 1, width - 1), (0, 1), constant_values=rows)
    normal[-1, :-1] = normal[:-1, -1] = first[:, :, count].ravel()
    sizes = np.sqrt(np.diag(normal))
    normal = normal / np.outer(sizes, sizes) + _RIDGE * np.eye(width)
    weights = np.linalg.solve(normal, np.append(first[:, :, -1], targets[:, -1].sum()) / sizes) / sizes
    response = np.sum(fftconvolve(seen, weights[:-1].reshape(lags, count), axes=0)[:size], axis=1) + weights[-1]
    left = float(np.linalg.norm((torque - response)[at]) / np.linalg.norm(torque[at]))
    return left * math.sqrt(rows / (rows - width))
