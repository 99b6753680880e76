"""Twenty-one mistakes a user makes in telling of his drive, on two axes and on four more that nothing was tuned on.

The truth is the package's own simulation: noise inside the loop and on the log, and what no model of the package has, a
friction that rises towards standstill and a ripple along the way, so that the right loop leaves a few percent. A
mistake is made in the record, in what is declared, or in the truth, where the declaration is what a user leaves out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, TypeAlias

import numpy as np

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.common.transmission import Transmission
from jointid.diagnostics.find_causes import explain_failure, find_causes
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import PD, PID, Cascade, Controller, FirstOrder
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record

AxisName: TypeAlias = Literal["rigid", "flexible", "direct", "screw", "fast", "table", "lift"]

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
    """A geared rigid axis under P-PI, the paper's flexible axis under P-P, a direct drive under PD; and four more."""
    if name in _OTHERS:
        return _OTHERS[name]()
    if name == "direct":
        direct = PD(
            position_gain=900.0,
            derivative_gain=18.0,
            gain=1.3,
            limit=60.0,
            velocity_filter=FirstOrder(1e-3),
            delay=0.5e-3,
        )
        values = {"inertia": 0.12, "viscous": 0.25, "coulomb": 0.9, "offset": 0.1}
        reference = trapezoids((1.0, 2.0, 4.0), 30.0, 1.5, RATE, duration=9.0)
        return Axis(RigidJoint("revolute"), direct, values, reference, 0.05, 0.3, 0.05, 0.02)
    if name == "rigid":
        gear = Transmission(load="revolute", ratio=50.0)
        law = Cascade(
            position_gain=25.0,
            velocity_gain=2.1,
            integral_gain=60.0,
            gain=0.4,
            limit=120.0,
            velocity_filter=FirstOrder(0.8e-3),
            delay=0.5e-3,
            ratio=50.0,
        )
        values = {"inertia": 8.0, "viscous": 25.0, "coulomb": 40.0, "offset": 6.0}
        reference = trapezoids((0.3, 0.7, 1.2), 6.0, 1.0, RATE, duration=10.0)
        return Axis(RigidJoint("revolute", transmission=gear), law, values, reference, 1.5, 0.05, 2.0, 1.0)
    truth = {
        "motor_inertia": 50.0, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 9.2e5, "damping": 160.0,
        "load_inertia": 45.0, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": -3.16,
    }  # fmt: skip
    law = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15065188, limit=1e3)
    reference = trapezoids((0.042, 0.083, 0.125), 2.5, 0.05, RATE, duration=10.0)
    joint = FlexibleJoint("prismatic", transmission=Transmission(load="prismatic", ratio=10.0))
    return Axis(joint, law, truth, reference, 1.0, 5e-3, 8.0, 1.0)


def _screw() -> Axis:
    """A stiff screw under P-PI at 1 kHz."""
    law = Cascade(
        position_gain=40.0,
        velocity_gain=0.09,
        integral_gain=60.0,
        gain=0.55,
        limit=1e4,
        velocity_filter=FirstOrder(0.5e-3),
        delay=0.5e-3,
        ratio=500.0,
    )
    joint = RigidJoint("prismatic", transmission=Transmission(load="prismatic", ratio=500.0))
    values = {"inertia": 80.0, "viscous": 400.0, "coulomb": 260.0, "offset": 0.0}
    reference = trapezoids((0.05, 0.2, 0.3), 3.0, 0.15, RATE, duration=8.0)
    return Axis(joint, law, values, reference, 5.0, 0.02, 6.0, 3.0)


def _fast() -> Axis:
    """A soft P-P cascade at 4 kHz behind an 80:1 gear."""
    law = Cascade(
        position_gain=12.0,
        velocity_gain=0.033,
        gain=1.7,
        limit=1e3,
        velocity_filter=FirstOrder(1e-3),
        delay=0.25e-3,
        ratio=80.0,
    )
    joint = RigidJoint("revolute", transmission=Transmission(load="revolute", ratio=80.0))
    values = {"inertia": 3.0, "viscous": 12.0, "coulomb": 25.0, "offset": -4.0}
    reference = trapezoids((0.4, 0.9, 1.6), 9.0, 1.0, 2.5e-4, duration=8.0)
    return Axis(joint, law, values, reference, 1.0, 0.07, 1.5, 1.0, rate=2.5e-4)


def _table() -> Axis:
    """A flexible direct drive under PD at 2 kHz."""
    law = PD(
        position_gain=350.0,
        derivative_gain=8.0,
        gain=1.3,
        limit=60.0,
        velocity_filter=FirstOrder(0.6e-3),
        delay=0.25e-3,
    )
    values = {
        "motor_inertia": 0.05, "motor_viscous": 0.1, "motor_coulomb": 0.3, "stiffness": 900.0, "damping": 0.25,
        "load_inertia": 0.05, "load_viscous": 0.1, "load_coulomb": 0.2, "offset": 0.05,
    }  # fmt: skip
    reference = trapezoids((1.0, 2.0, 4.0), 30.0, 1.5, 5e-4, duration=6.0)
    return Axis(FlexibleJoint("revolute"), law, values, reference, 0.02, 0.3, 0.02, 0.01, rate=5e-4)


def _lift() -> Axis:
    """A PID at 1 kHz behind a 200:1 gear, with much friction."""
    law = PID(
        position_gain=0.25,
        derivative_gain=0.00625,
        integral_gain=6.0,
        gain=60.0,
        limit=1e5,
        velocity_filter=FirstOrder(1.5e-3),
        delay=1e-3,
        ratio=200.0,
    )
    joint = RigidJoint("prismatic", transmission=Transmission(load="prismatic", ratio=200.0))
    values = {"inertia": 60.0, "viscous": 300.0, "coulomb": 160.0, "offset": 20.0}
    reference = trapezoids((0.1, 0.25, 0.4), 2.5, 0.2, RATE, duration=8.0)
    return Axis(joint, law, values, reference, 8.0, 0.02, 6.0, 3.0)


_OTHERS: Mapping[str, Callable[[], Axis]] = {"screw": _screw, "fast": _fast, "table": _table, "lift": _lift}


def run(made: Axis, controller: Controller, joint: Joint | None = None, seed: int = 1) -> Record:
    """The record of the axis under a controller, as its drive logs it."""
    rng = np.random.default_rng(seed)
    reference = made.reference
    speed = np.gradient(reference, made.rate)
    slow = np.exp(-((speed / (0.05 * np.max(np.abs(speed)))) ** 2)) * np.sign(speed)
    coulomb = sum(v for n, v in made.values.items() if "coulomb" in n)
    force = -0.15 * coulomb * slow + made.ripple * np.sin(2 * math.pi * reference / made.period)
    return simulated_record(
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


Told: TypeAlias = tuple[Record, ClosedLoop]


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    Attributes:
        name: in words.
        right: causes one of which must be named.
        make: from an axis to its record as it is read, and the loop as it is declared.
        said: words that must be there.
    """

    name: str
    right: frozenset[str]
    make: Callable[[Axis, int], Told]
    said: str = ""


Edit: TypeAlias = Callable[[Record, ClosedLoop], Told]
"""What a mistake makes of a record and a declaration, be they right or wrong already."""


def _of(edit: Edit) -> Callable[[Axis, int], Told]:
    return lambda made, seed: edit(*without_mistake(made, seed))


def _scale(channel: str, factor: float) -> Edit:
    def edit(record: Record, loop: ClosedLoop) -> Told:
        one = getattr(record, channel)
        return record.with_channels({channel: replace(one, values=factor * one.values)}), loop

    return edit


def _scaled(channel: str, factor: float) -> Callable[[Axis, int], Told]:
    return _of(_scale(channel, factor))


def _swap_channels(record: Record, loop: ClosedLoop) -> Told:
    assert record.torque is not None
    assert record.reference is not None
    swapped = {
        "torque": replace(record.torque, values=record.reference.values),
        "reference": replace(record.reference, values=record.torque.values),
    }
    return record.with_channels(swapped), loop


def without_mistake(made: Axis, seed: int = 1) -> Told:
    """The record of the axis, and its loop as it is."""
    return run(made, made.controller, seed=seed), ClosedLoop(made.joint, made.controller)


def _give_position_as_reference(record: Record, loop: ClosedLoop) -> Told:
    assert record.reference is not None
    assert record.motor_position is not None
    step = 1e-6 * float(np.ptp(record.reference.values))
    encoded = step * np.round(record.motor_position.values / step)
    wrong = replace(record.reference, values=encoded)
    return record.with_channels({"reference": wrong}), loop


def _declare(**numbers: Any) -> Edit:
    """A mistake in what is declared; a function of the axis' controller stands for a number of it."""

    def edit(record: Record, loop: ClosedLoop) -> Told:
        law: Any = loop.controller
        changes = {n: v(law) if callable(v) else v for n, v in numbers.items()}
        return record, replace(loop, controller=replace(law, **changes))

    return edit


def _declared(**numbers: Any) -> Callable[[Axis, int], Told]:
    return _of(_declare(**numbers))


def _left_out(**numbers: Any) -> Callable[[Axis, int], Told]:
    """What the drive has, and the declaration has not; 0 of it, unless a pair says what."""

    def make(made: Axis, seed: int) -> Told:
        pairs = {n: v(made) if callable(v) else v for n, v in numbers.items()}
        pairs = {n: v if isinstance(v, tuple) else (v, 0.0) for n, v in pairs.items()}
        true = replace(made.controller, **{n: v[0] for n, v in pairs.items()})
        declared = replace(made.controller, **{n: v[1] for n, v in pairs.items()})
        return run(made, true, seed=seed), ClosedLoop(made.joint, declared)

    return make


def _constant_twice(made: Axis, seed: int) -> Told:
    return _scaled("torque", made.controller.gain)(made, seed)


def _time(factor: float) -> Edit:
    def edit(record: Record, loop: ClosedLoop) -> Told:
        timed = {n: replace(c, sample_time=factor * c.sample_time) for n, c in record.items()}
        return record.with_channels(timed), loop

    return edit


def _sample_time(factor: float) -> Callable[[Axis, int], Told]:
    return _of(_time(factor))


def _gear_forgotten(made: Axis, seed: int) -> Told:
    gear = made.joint.transmission
    assert gear is not None
    ratio = gear.motor_per_load
    law = made.controller
    if law.ratio == 1.0:  # the same loop, told on the motor's side
        law = replace(law, ratio=ratio, velocity_gain=law.velocity_gain / ratio**2)
    return run(made, law, seed=seed), ClosedLoop(made.joint, replace(law, ratio=1.0))


SCALE = frozenset({"torque_scale"})

MISTAKES = (
    Mistake("torque twice as large", SCALE, _scaled("torque", 2.0)),
    Mistake("torque ten times as large", SCALE, _scaled("torque", 10.0)),
    Mistake("torque fifty times as small", SCALE, _scaled("torque", 1 / 50)),
    Mistake("torque turned round", frozenset({"torque_sign"}), _scaled("torque", -1.0)),
    Mistake("reference in degrees", frozenset({"reference_scale"}), _scaled("reference", 180 / math.pi)),
    Mistake("reference in mm", frozenset({"reference_scale"}), _scaled("reference", 1000.0)),
    Mistake("reference turned round", frozenset({"reference_sign"}), _scaled("reference", -1.0)),
    Mistake("torque and reference swapped", frozenset({"swapped_channels"}), _of(_swap_channels)),
    Mistake("actual position as reference", frozenset({"reference_is_position"}), _of(_give_position_as_reference)),
    Mistake(
        "position_gain and velocity_gain swapped",
        frozenset({"swapped_gains"}),
        _declared(position_gain=lambda c: c.velocity_gain, velocity_gain=lambda c: c.position_gain),
    ),
    Mistake(
        "position_gain twice as large",
        frozenset({"position_gain"}),
        _declared(position_gain=lambda c: 2 * c.position_gain),
    ),
    Mistake(
        "velocity_gain twice as large", frozenset({"law_gain"}), _declared(velocity_gain=lambda c: 2 * c.velocity_gain)
    ),
    Mistake("torque constant said twice", frozenset({"torque_constant"}), _constant_twice),
    Mistake("integral forgotten", frozenset({"integral_gain"}), _left_out(integral_gain=60.0)),
    Mistake(
        "velocity filter forgotten",
        frozenset({"velocity_filter"}),
        _left_out(velocity_filter=(FirstOrder(4e-3), (1.0,))),
    ),
    Mistake("sample time twice as long", frozenset({"sample_time"}), _sample_time(2.0)),
    Mistake("sample time ten times as long", frozenset({"sample_time"}), _sample_time(10.0)),
    Mistake("wrong side of the gear", frozenset({"gear_side"}), _gear_forgotten),
    Mistake(
        "velocity feed-forward forgotten", frozenset({"velocity_feedforward"}), _left_out(velocity_feedforward=1.0)
    ),
    Mistake("delay forgotten", frozenset({"delay"}), _left_out(delay=2e-3)),
    Mistake("period forgotten", frozenset({"period"}), _left_out(period=lambda made: (made.rate / 8, None))),
)


_TWICE = _declare(position_gain=lambda c: 2 * c.position_gain)
_AHEAD, _LATE = _left_out(velocity_feedforward=1.0), _left_out(delay=2e-3)


def _pair(name: str, causes: set[str], *makes: Any) -> Mistake:
    """Two mistakes at once; the first is made with the record unless it is an edit, too."""
    first, *edits = makes

    def make(made: Axis, seed: int) -> Told:
        told: Told = first(made, seed)
        for edit in edits:
            told = edit(*told)
        return told

    return Mistake(name, frozenset(causes), make)


PAIRS = (
    _pair(
        "torque twice as large, position_gain twice as large",
        {"torque_scale", "law_gain", "position_gain"},
        _of(_TWICE),
        _scale("torque", 2.0),
    ),
    _pair(
        "reference in degrees, position_gain twice as large",
        {"reference_scale", "position_gain"},
        _of(_TWICE),
        _scale("reference", 180 / math.pi),
    ),
    _pair(
        "delay forgotten, velocity_gain twice as large",
        {"delay", "law_gain"},
        _LATE,
        _declare(velocity_gain=lambda c: 2 * c.velocity_gain),
    ),
    _pair(
        "feed-forward forgotten, torque twice as large",
        {"velocity_feedforward", "torque_scale"},
        _AHEAD,
        _scale("torque", 2.0),
    ),
)
"""Two mistakes at once, with the causes of which one must be named where any is.

A geared axis under a cascade can have them all.
"""


def mistakes_of(made: Axis) -> tuple[Mistake, ...]:
    """The twenty mistakes as its law and its transmission can have them."""
    law = made.controller
    instead: dict[str, Mistake] = {}
    if not hasattr(law, "velocity_gain"):
        instead |= {
            "position_gain and velocity_gain swapped": Mistake(
                "position_gain and derivative_gain swapped",
                frozenset({"swapped_gains"}),
                _declared(position_gain=lambda c: c.derivative_gain, derivative_gain=lambda c: c.position_gain),
            ),
            "velocity_gain twice as large": Mistake(
                "derivative_gain twice as large",
                frozenset({"derivative_gain"}),
                _declared(derivative_gain=lambda c: 2 * c.derivative_gain),
            ),
            "velocity feed-forward forgotten": Mistake(
                "velocity of the reference forgotten",
                frozenset({"velocity_feedforward"}),
                _declared(reference_velocity="none"),
            ),
        }
    if getattr(law, "integral_gain", 0.0):
        forgotten = Mistake("integral forgotten", frozenset({"integral_gain"}), _declared(integral_gain=0.0))
        instead["integral forgotten"] = forgotten
    elif not hasattr(law, "integral_gain"):
        instead["integral forgotten"] = Mistake(
            "position_gain ten times as small",
            frozenset({"position_gain"}),
            _declared(position_gain=lambda c: c.position_gain / 10),
        )
    if made.joint.transmission is None:
        instead["wrong side of the gear"] = Mistake(
            "sample time four times as long", frozenset({"sample_time"}), _sample_time(4.0)
        )
    return tuple(instead.get(one.name, one) for one in MISTAKES)


def without_positions(record: Record) -> Record:
    """The record with torque and reference alone, as most drives log it."""
    return record.without(*(n for n in ("motor_position", "load_position") if getattr(record, n) is not None))


def cut(record: Record, seconds: float) -> Record:
    """The first seconds of a record's motion."""
    assert record.reference is not None
    begin = int(np.flatnonzero(np.diff(record.reference.values))[0])
    end = begin + round(seconds / record.reference.sample_time)
    return record.with_channels({n: replace(c, values=c.values[begin:end]) for n, c in record.items()})


def _too_short(made: Axis, seed: int) -> Told:
    record, loop = without_mistake(made, seed)
    return cut(without_positions(record), 0.6), loop


def _side_forgotten(made: Axis, seed: int) -> Told:
    gear = made.joint.transmission
    assert gear is not None
    record, loop = _scaled("reference", 1 / abs(gear.motor_per_load))(made, seed)
    return without_positions(record), loop


def _other_ratio(made: Axis, seed: int) -> Told:
    """The reference is logged on the load, torque and controller are the motor's: all that the ratio takes over."""
    gear = made.joint.transmission
    assert gear is not None
    record = _scaled("torque", 0.1)(made, seed)[0]
    joint = replace(made.joint, transmission=replace(gear, ratio=gear.motor_per_load / 10))
    return without_positions(record), ClosedLoop(joint, replace(made.controller, ratio=made.controller.ratio / 10))


def _seconds_for_milliseconds(made: Axis, seed: int) -> Told:
    record, loop = _declared(integral_gain=lambda c: c.integral_gain / 1000)(made, seed)
    return without_positions(record), loop


def pulsed(made: Axis, seed: int, share: float = 1.0, held: float = 0.02) -> Record:
    """The record of an axis with a signal injected, three levels held for some time, that is not logged."""
    rng = np.random.default_rng([seed, 3])
    size, each = made.reference.size, round(held / made.rate)
    quiet = run(made, made.controller, seed=seed)
    assert quiet.torque is not None
    levels = np.repeat(rng.choice([-1.0, 0.0, 1.0], size // each + 1), each)[:size]
    record = simulated_record(
        ClosedLoop(made.joint, made.controller), made.reference, made.values, sample_time=made.rate,
        injected=share * float(np.std(quiet.torque.values)) * levels,
        disturbance=made.noise * rng.standard_normal(size), torque_noise=made.log_noise * rng.standard_normal(size),
        name="drive",
    )  # fmt: skip
    return replace(record, injected=None)


def _pulses(made: Axis, seed: int) -> Told:
    return without_positions(pulsed(made, seed)), ClosedLoop(made.joint, made.controller)


def _smooth(made: Axis, seed: int) -> Told:
    """A friction that is a hyperbolic tangent of the velocity, under a cascade without a delay; integrated here."""
    rng, law, values, T = np.random.default_rng([seed, 5]), made.controller, made.values, made.rate
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
    record = without_positions(run(made, law, seed=seed))
    assert record.torque is not None
    logged = replace(record.torque, values=torque + made.log_noise * rng.standard_normal(size))
    return record.with_channels({"torque": logged}), ClosedLoop(made.joint, replace(law, delay=0.0))


_GEARED = (
    Mistake("side of the reference forgotten", frozenset({"gear_side"}), _side_forgotten, 'side = "load"'),
    Mistake("gear ratio ten times as small", frozenset({"reference_scale"}), _other_ratio),
)
MORE = (
    Mistake("half a second of motion", frozenset({"record_too_short"}), _too_short, "the record is too short"),
    Mistake("pulses not declared", frozenset({"injected"}), _pulses, "channel injected"),
)
_INTEGRAL = Mistake("integral time in ms, in s", frozenset({"integral_gain"}), _seconds_for_milliseconds, "1000 times")
SMOOTH = Mistake("friction smooth in the velocity", frozenset({"presliding"}), _smooth)


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


def tell(record: Record, loop: ClosedLoop) -> tuple[tuple[str, ...], str]:
    """What `jointid identify` says is wrong: the causes that its first sentence names, and that sentence."""
    try:
        estimate = ji.identify(record, loop)
    except JointidError as error:
        causes = find_causes(record, loop)
        if causes.nearest or not causes.found:
            return (), str(error)
        return _codes(causes.message), str(explain_failure(error, record, loop))
    verdict, said = estimate.checks.verdicts[-1], str(estimate.answer)
    if verdict.good is not False or verdict.reasons[0].brief not in said:
        return (), said
    return _codes(verdict.reasons[0]), said


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
