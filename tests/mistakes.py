"""Twenty-one mistakes a user makes in telling of his drive, on two axes and on three more that nothing was tuned on.

The truth is the package's own simulation: noise inside the loop and on the log, and what no model of the package has, a
friction that rises towards standstill and a ripple along the way, so that the right loop leaves a few percent. A
mistake is made in the record, in what is declared, or in the truth, where the declaration is what a user leaves out.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal, TypeAlias

import numpy as np

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.diagnostics.explain import explain_failure, find_causes
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import PD, PID, Cascade, Controller, FirstOrder
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.records import chunks
from tests.edits import Edit, changes, declares, has, log, slower, swap

AxisName: TypeAlias = Literal["rigid", "flexible", "direct", "screw", "fast", "lift"]

RATE = 1e-3  # s


@dataclass(frozen=True)
class Axis:
    """A drive, and what it is asked to do."""

    joint: Joint
    controller: Any  # one of the laws
    values: Mapping[str, float]
    reference: FloatArray
    ripple: float  # of the friction, in the torque's unit
    period: float  # of the ripple, m or rad
    noise: float  # standard deviation of a force inside the loop, white
    log_noise: float
    rate: float = RATE  # s, of loop and log


@cache
def axis(name: AxisName) -> Axis:
    """A geared rigid axis under P-PI, the paper's flexible axis under P-P, a direct drive under PD; and three more."""
    if name in _OTHERS:
        return _OTHERS[name]()
    if name == "direct":
        direct = PD(
            position_gain=900.0, derivative_gain=18.0, gain=1.3, limit=60.0, velocity_filter=FirstOrder(1e-3),
            delay=0.5e-3,
        )  # fmt: skip
        values = {"inertia": 0.12, "viscous": 0.25, "coulomb": 0.9, "offset": 0.1}
        reference = ji.excitation.trapezoids((1.0, 2.0, 4.0), 30.0, 1.5, RATE, duration=9.0)
        return Axis(RigidJoint("revolute"), direct, values, reference, 0.05, 0.3, 0.05, 0.02)
    if name == "rigid":
        gear = ji.Transmission(load="revolute", ratio=50.0)
        law = Cascade(
            position_gain=25.0, velocity_gain=2.1, integral_gain=60.0, gain=0.4, limit=120.0,
            velocity_filter=FirstOrder(0.8e-3), delay=0.5e-3, ratio=50.0,
        )  # fmt: skip
        values = {"inertia": 8.0, "viscous": 25.0, "coulomb": 40.0, "offset": 6.0}
        reference = ji.excitation.trapezoids((0.3, 0.7, 1.2), 6.0, 1.0, RATE, duration=10.0)
        return Axis(RigidJoint("revolute", transmission=gear), law, values, reference, 1.5, 0.05, 2.0, 1.0)
    truth = {
        "motor_inertia": 50.0, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 9.2e5, "damping": 160.0,
        "load_inertia": 45.0, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": -3.16,
    }  # fmt: skip
    law = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15065188, limit=1e3)
    reference = ji.excitation.trapezoids((0.042, 0.083, 0.125), 2.5, 0.05, RATE, duration=10.0)
    joint = FlexibleJoint("prismatic", transmission=ji.Transmission(load="prismatic", ratio=10.0))
    return Axis(joint, law, truth, reference, 1.0, 5e-3, 8.0, 1.0)


def _screw() -> Axis:
    """A stiff screw under P-PI at 1 kHz."""
    law = Cascade(
        position_gain=40.0, velocity_gain=0.09, integral_gain=60.0, gain=0.55, limit=1e4,
        velocity_filter=FirstOrder(0.5e-3), delay=0.5e-3, ratio=500.0,
    )  # fmt: skip
    joint = RigidJoint("prismatic", transmission=ji.Transmission(load="prismatic", ratio=500.0))
    values = {"inertia": 80.0, "viscous": 400.0, "coulomb": 260.0, "offset": 0.0}
    reference = ji.excitation.trapezoids((0.05, 0.2, 0.3), 3.0, 0.15, RATE, duration=8.0)
    return Axis(joint, law, values, reference, 5.0, 0.02, 6.0, 3.0)


def _fast() -> Axis:
    """A soft P-P cascade at 4 kHz behind an 80:1 gear."""
    law = Cascade(
        position_gain=12.0, velocity_gain=0.033, gain=1.7, limit=1e3, velocity_filter=FirstOrder(1e-3), delay=0.25e-3,
        ratio=80.0,
    )  # fmt: skip
    joint = RigidJoint("revolute", transmission=ji.Transmission(load="revolute", ratio=80.0))
    values = {"inertia": 3.0, "viscous": 12.0, "coulomb": 25.0, "offset": -4.0}
    reference = ji.excitation.trapezoids((0.4, 0.9, 1.6), 9.0, 1.0, 2.5e-4, duration=8.0)
    return Axis(joint, law, values, reference, 1.0, 0.07, 1.5, 1.0, rate=2.5e-4)


def _lift() -> Axis:
    """A PID at 1 kHz behind a 200:1 gear, with much friction."""
    law = PID(
        position_gain=0.25, derivative_gain=0.00625, integral_gain=6.0, gain=60.0, limit=1e5,
        velocity_filter=FirstOrder(1.5e-3), delay=1e-3, ratio=200.0,
    )  # fmt: skip
    joint = RigidJoint("prismatic", transmission=ji.Transmission(load="prismatic", ratio=200.0))
    values = {"inertia": 60.0, "viscous": 300.0, "coulomb": 160.0, "offset": 20.0}
    reference = ji.excitation.trapezoids((0.1, 0.25, 0.4), 2.5, 0.2, RATE, duration=8.0)
    return Axis(joint, law, values, reference, 8.0, 0.02, 6.0, 3.0)


_OTHERS: Mapping[str, Callable[[], Axis]] = {"screw": _screw, "fast": _fast, "lift": _lift}


def run(made: Axis, controller: Controller, joint: Joint | None = None, seed: int = 1) -> ji.Record:
    """The record of the axis under a controller, as its drive logs it."""
    rng = np.random.default_rng(seed)
    reference = made.reference
    speed = np.gradient(reference, made.rate)
    slow = np.exp(-((speed / (0.05 * np.max(np.abs(speed)))) ** 2)) * np.sign(speed)
    coulomb = sum(v for n, v in made.values.items() if "coulomb" in n)
    force = -0.15 * coulomb * slow + made.ripple * np.sin(2 * math.pi * reference / made.period)
    return ji.simulated_record(
        ClosedLoop(joint or made.joint, controller), reference, made.values, sample_time=made.rate,
        disturbance=force + made.noise * rng.standard_normal(reference.size),
        torque_noise=made.log_noise * rng.standard_normal(reference.size), name="drive",
    )  # fmt: skip


def varied(made: Axis, seed: int) -> Axis:
    """The same axis with every parameter of the joint, and every gain, up to 30 % more or less."""
    rng = np.random.default_rng([seed, 7])

    def other(value: float) -> float:
        return float(value * math.exp(rng.uniform(-0.26, 0.26)))

    gains = [
        n for n in ("position_gain", "velocity_gain", "derivative_gain", "integral_gain") if hasattr(made.controller, n)
    ]
    law = replace(made.controller, **{n: other(getattr(made.controller, n)) for n in gains})
    return replace(made, controller=law, values={n: other(v) for n, v in made.values.items()})


Told: TypeAlias = tuple[ji.Record, ClosedLoop]


@dataclass(frozen=True)
class Mistake:
    """One mistake, or several at once.

    Attributes:
        name: in words.
        right: causes one of which must be named.
        edits: what is made of the drive, of its log and of what is declared, one after the other.
        said: words that must be there.
    """

    name: str
    right: frozenset[str]
    edits: tuple[Edit, ...]
    said: str = ""

    def make(self, made: Axis, seed: int) -> Told:
        """Return the record of an axis as it is read, and the loop as it is declared."""
        return told(made, seed, *self.edits)


def told(made: Axis, seed: int, *edits: Edit) -> Told:
    """Return the record and the declared loop of an axis after edits."""
    law = made.controller
    one = SimpleNamespace(axis=made, seed=seed, law=law, declared=law, model=made.joint, edits=[], record=None)
    for edit in edits:
        edit(one)
    record = one.record or run(made, one.law, seed=seed)
    for change in one.edits:
        record = change(record)
    return record, ClosedLoop(one.model, one.declared)


def without_mistake(made: Axis, seed: int = 1) -> Told:
    """The record of the axis, and its loop as it is."""
    return told(made, seed)


def _mistake(name: str, right: str, *edits: Edit, said: str = "") -> Mistake:
    return Mistake(name, frozenset(right.split()), edits, said)


def _twice(name: str) -> Edit:
    return declares(**{name: lambda one: 2 * getattr(one.law, name)})


def _swapped(first: str, second: str) -> Edit:
    return declares(**{
        first: lambda one: getattr(one.law, second),
        second: lambda one: getattr(one.law, first),
    })  # fmt: skip


def give_position_as_reference(record: ji.Record) -> ji.Record:
    assert record.reference is not None
    assert record.motor_position is not None
    step = 1e-6 * float(np.ptp(record.reference.values))
    encoded = step * np.round(record.motor_position.values / step)
    return record.with_channels({"reference": replace(record.reference, values=encoded)})


def _gear_forgotten(one: Any) -> None:
    ratio = one.model.transmission.motor_per_load
    if one.law.ratio == 1.0:  # the same loop, told on the motor's side
        one.law = replace(one.law, ratio=ratio, velocity_gain=one.law.velocity_gain / ratio**2)
    one.declared = replace(one.law, ratio=1.0)


_DEGREES = log("reference", lambda x: 180 / math.pi * x)
_AHEAD = has(velocity_feedforward=1.0), declares(velocity_feedforward=0.0)
_LATE = has(delay=2e-3), declares(delay=0.0)

MISTAKES = (
    _mistake("torque twice as large", "torque_scale", log("torque", lambda x: 2.0 * x)),
    _mistake("torque ten times as large", "torque_scale", log("torque", lambda x: 10.0 * x)),
    _mistake("torque fifty times as small", "torque_scale", log("torque", lambda x: 1 / 50 * x)),
    _mistake("torque turned round", "torque_sign", log("torque", np.negative)),
    _mistake("reference in degrees", "reference_scale", _DEGREES),
    _mistake("reference in mm", "reference_scale", log("reference", lambda x: 1000.0 * x)),
    _mistake("reference turned round", "reference_sign", log("reference", np.negative)),
    _mistake("torque and reference swapped", "swapped_channels", changes(swap)),
    _mistake("actual position as reference", "reference_is_position", changes(give_position_as_reference)),
    _mistake("position_gain and velocity_gain swapped", "swapped_gains", _swapped("position_gain", "velocity_gain")),
    _mistake("position_gain twice as large", "position_gain", _twice("position_gain")),
    _mistake("velocity_gain twice as large", "law_gain", _twice("velocity_gain")),
    _mistake("torque constant said twice", "torque_constant", lambda it: log("torque", lambda x: it.law.gain * x)(it)),
    _mistake("integral forgotten", "integral_gain", has(integral_gain=60.0), declares(integral_gain=0.0)),
    _mistake(
        "velocity filter forgotten", "velocity_filter",
        has(velocity_filter=FirstOrder(4e-3)), declares(velocity_filter=(1.0,)),
    ),
    _mistake("sample time twice as long", "sample_time", slower(2.0)),
    _mistake("sample time ten times as long", "sample_time", slower(10.0)),
    _mistake("wrong side of the gear", "gear_side", _gear_forgotten),
    _mistake("velocity feed-forward forgotten", "velocity_feedforward", *_AHEAD),
    _mistake("delay forgotten", "delay", *_LATE),
    _mistake("period forgotten", "period", has(period=lambda one: one.axis.rate / 8), declares(period=None)),
)  # fmt: skip

PAIRS = (
    _mistake(
        "torque twice as large, position_gain twice as large", "torque_scale law_gain position_gain sample_time",
        _twice("position_gain"), log("torque", lambda x: 2.0 * x),
    ),
    _mistake(
        "reference in degrees, position_gain twice as large", "reference_scale position_gain",
        _twice("position_gain"), _DEGREES,
    ),
    _mistake("delay forgotten, velocity_gain twice as large", "delay law_gain", *_LATE, _twice("velocity_gain")),
    _mistake(
        "feed-forward forgotten, torque twice as large", "velocity_feedforward torque_scale",
        *_AHEAD, log("torque", lambda x: 2.0 * x),
    ),
)  # fmt: skip
"""Two mistakes at once, with the causes of which one must be named where any is.

A geared axis under a cascade can have them all.
"""

_OF_PD = {
    "position_gain and velocity_gain swapped": _mistake(
        "position_gain and derivative_gain swapped", "swapped_gains", _swapped("position_gain", "derivative_gain")
    ),
    "velocity_gain twice as large": _mistake(
        "derivative_gain twice as large", "derivative_gain", _twice("derivative_gain")
    ),
    "velocity feed-forward forgotten": _mistake(
        "velocity of the reference forgotten", "velocity_feedforward", declares(reference_velocity="none")
    ),
}


def mistakes_of(made: Axis) -> tuple[Mistake, ...]:
    """The twenty mistakes as its law and its transmission can have them."""
    law, instead = made.controller, dict[str, Mistake]()
    if not hasattr(law, "velocity_gain"):
        instead |= _OF_PD
    if getattr(law, "integral_gain", 0.0):
        forgotten = _mistake("integral forgotten", "integral_gain", declares(integral_gain=0.0))
        instead["integral forgotten"] = forgotten
    elif not hasattr(law, "integral_gain"):
        tenth = declares(position_gain=lambda one: one.law.position_gain / 10)
        instead["integral forgotten"] = _mistake("position_gain ten times as small", "position_gain", tenth)
    if made.joint.transmission is None:
        instead["wrong side of the gear"] = _mistake("sample time four times as long", "sample_time", slower(4.0))
    return tuple(instead.get(one.name, one) for one in MISTAKES)


def without_positions(record: ji.Record) -> ji.Record:
    """The record with torque and reference alone, as most drives log it."""
    return record.without(*(n for n in ("motor_position", "load_position") if getattr(record, n) is not None))


def cut(record: ji.Record, seconds: float) -> ji.Record:
    """The first seconds of a record's motion."""
    assert record.reference is not None
    begin = int(np.flatnonzero(np.diff(record.reference.values))[0])
    return chunks.cut(record, begin, begin + round(seconds / record.reference.sample_time))


def _side_forgotten(one: Any) -> None:
    log("reference", lambda x: 1 / abs(one.model.transmission.motor_per_load) * x)(one)


def other_ratio(one: Any) -> None:
    """The reference is logged on the load, torque and controller are the motor's: all that the ratio takes over."""
    gear = one.model.transmission
    log("torque", lambda x: 0.1 * x)(one)
    one.model = replace(one.model, transmission=replace(gear, ratio=gear.motor_per_load / 10))
    one.declared = replace(one.declared, ratio=one.declared.ratio / 10)


def _pulse(one: Any) -> None:
    """A signal is injected, three levels held for 20 ms, and not logged."""
    made, rng = one.axis, np.random.default_rng([one.seed, 3])
    size, each = made.reference.size, round(0.02 / made.rate)
    quiet = run(made, made.controller, seed=one.seed)
    assert quiet.torque is not None
    levels = np.repeat(rng.choice([-1.0, 0.0, 1.0], size // each + 1), each)[:size]
    one.record = ji.simulated_record(
        ClosedLoop(made.joint, made.controller), made.reference, made.values, sample_time=made.rate,
        injected=float(np.std(quiet.torque.values)) * levels,
        disturbance=made.noise * rng.standard_normal(size), torque_noise=made.log_noise * rng.standard_normal(size),
        name="drive",
    ).without("injected")  # fmt: skip


def _smooth(one: Any) -> None:
    """A friction that is a hyperbolic tangent of the velocity, under a cascade without a delay; integrated here."""
    made: Axis = one.axis
    rng, law, values, T = np.random.default_rng([one.seed, 5]), made.controller, made.values, made.rate
    steps, size, ratio = 20, made.reference.size, law.ratio
    width = 0.02 * float(np.max(np.abs(np.gradient(made.reference, T))))
    kept = math.exp(-T / law.velocity_filter.time_constant)
    force, torque = made.noise * rng.standard_normal(size), np.zeros(size)
    before = q = float(made.reference[0])
    v = filtered = integral = 0.0

    def accelerated(u: float, speed: float) -> float:
        friction = values["viscous"] * speed + values["coulomb"] * math.tanh(speed / width) + values["offset"]
        return (u - friction) / values["inertia"]

    for k in range(size):
        filtered, before = kept * filtered + (1 - kept) * (q - before) / T, q
        slip = law.position_gain * (made.reference[k] - q) - filtered
        torque[k] = ratio**2 * law.gain * law.velocity_gain * (slip + law.integral_gain * integral)
        integral += T * slip
        for _ in range(steps):
            half = v + T / steps / 2 * accelerated(torque[k] + force[k], v)
            v, q = v + T / steps * accelerated(torque[k] + force[k], half), q + T / steps * half
    torque += made.log_noise * rng.standard_normal(size)
    log("torque", lambda _: torque)(one)
    one.declared = replace(law, delay=0.0)


_BARE = changes(without_positions)
MORE = (
    _mistake("half a second of motion", "record_too_short", _BARE, changes(lambda record: cut(record, 0.6))),
    _mistake("pulses not declared", "injected", _pulse, _BARE),
)
_GEARED = (
    _mistake("side of the reference forgotten", "gear_side", _side_forgotten, _BARE, said='side = "load"'),
    _mistake("gear ratio ten times as small", "reference_scale", other_ratio, _BARE),
)
_MILLISECONDS = declares(integral_gain=lambda one: one.law.integral_gain / 1000)
_INTEGRAL = _mistake("integral time in ms, in s", "integral_gain", _MILLISECONDS, _BARE)
SMOOTH = _mistake("friction smooth in the velocity", "presliding", _smooth, _BARE)


def more_mistakes_of(made: Axis) -> tuple[Mistake, ...]:
    """Further mistakes that its law and its transmission can have, and a friction that no model has and is none."""
    law = made.controller
    smooth = isinstance(law, Cascade) and isinstance(made.joint, RigidJoint)
    return (
        *MORE,
        *(_GEARED if made.joint.transmission is not None and law.ratio != 1.0 else ()),
        *((_INTEGRAL,) if getattr(law, "integral_gain", 0.0) else ()),
        *((SMOOTH,) if smooth else ()),
    )


_OF_SENSITIVITIES = {
    "gain": "law_gain", "velocity_gain": "law_gain", "log_gain": "torque_scale", "position_gain": "position_gain",
    "delay": "delay", "velocity_filter.time_constant": "velocity_filter",
}  # fmt: skip
"""The cause that a fault found by its sensitivity is."""


def tell(record: ji.Record, loop: ClosedLoop) -> tuple[tuple[str, ...], str]:
    """What `jointid identify` says is wrong: the causes that its first sentence names, and that sentence."""
    try:
        estimate = ji.identify(record, loop)
    except ji.JointidError as error:
        causes = find_causes(record, loop)
        if causes.nearest or not causes.found:
            return (), str(error)
        return _codes(causes.message), str(explain_failure(error, record, loop, print))
    found, said = next(one for one in estimate.checks if one.name == estimate.checks[-1].name), str(estimate.answer)
    if found.passed is not False or found.brief not in said:
        return (), said
    return _codes(found), said


def is_misled(mistake: Mistake, named: tuple[str, ...]) -> bool:
    """Whether only wrong causes are named."""
    return bool(named) and not mistake.right & set(named)


def _codes(reason: Message) -> tuple[str, ...]:
    """The causes that a reason names."""
    values = reason.values
    if "causes" in values:
        return tuple(one["cause"] for one in values["causes"])
    if reason.code is Reason.RECORD_TOO_SHORT:
        return (str(reason.code),)
    if "suspect" not in values:
        return ()
    names = (values["suspect"], *values["alike"])
    return tuple(_OF_SENSITIVITIES.get(name, name) for name in names)
