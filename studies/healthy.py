"""Healthy flexible drives of wide variety: how often the intervals hold, and what is said of them.

Every drive is simulated with the model it is identified with, from torque and reference alone, by `jointid.identify` as
a user calls it. Noise is on the log, or a force on the motor inside the loop, white or coloured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError

MOTIONS = ("trapezoid", "s-curve", "sweep", "multisine")
NOISES = ("log", "white force", "coloured force")
_SLOWEST_LOOP, _FASTEST_LOOP = 4.0, 30.0  # Hz, of the velocity loop


@dataclass(frozen=True)
class Drive:
    """A drive, its log, and what is known of it."""

    record: ji.Record
    loop: ji.ClosedLoop
    truth: dict[str, float]
    about: dict[str, Any]


def drive(seed: int, longest: float = 60.0, noise: str = "") -> Drive:
    """Return a seeded drive, with a noise of its own unless one of `NOISES` is given.

    Free-free modes of 8 to 60 Hz, loads of 15 to 85 % of the inertia, damping of 0.5 to 5 %, Coulomb friction of 5 to
    30 % of the torque of the ramps; P-P, P-PI and PID of 4 to 30 Hz at 1 and 4 kHz; trapezoids, S-curves, sweeps and
    multisines of 2 to `longest` seconds, half of them with injected pulses.
    """
    rng = np.random.default_rng([seed, 18])
    while True:
        found = _drawn(rng, longest, noise)
        if found is not None:
            return found


def _drawn(rng: np.random.Generator, longest: float, given: str) -> Drive | None:
    inertia, share = 10 ** rng.uniform(-3, 1.5), rng.uniform(0.15, 0.85)
    mode, ratio = (
        10 ** rng.uniform(math.log10(8), math.log10(60)),
        10 ** rng.uniform(math.log10(0.005), math.log10(0.05)),
    )
    reduced, pulsation = inertia * share * (1 - share), 2 * math.pi * mode
    period = float(rng.choice([1e-3, 2.5e-4]))
    duration = 2.0 * (longest / 2.0) ** rng.uniform()
    motion, drawn = str(rng.choice(MOTIONS)), str(rng.choice(NOISES))
    noise = given or drawn
    speed, acceleration = 10 ** rng.uniform(-0.5, 1), 10 ** rng.uniform(1, 2.3)
    reference = _reference(rng, motion, speed, acceleration, period, duration)
    if motion in MOTIONS[2:]:
        acceleration = float(np.quantile(np.abs(np.diff(reference, 2)), 0.98)) / period**2
    torque = inertia * acceleration
    coulomb, viscous = rng.uniform(0.05, 0.3) * torque, rng.uniform(0.02, 0.2) * torque / speed
    own = rng.uniform(0.2, 0.8)
    truth = {
        "motor_inertia": inertia * (1 - share),
        "motor_viscous": own * viscous,
        "motor_coulomb": own * coulomb,
        "stiffness": reduced * pulsation**2,
        "damping": 2 * ratio * reduced * pulsation,
        "load_inertia": inertia * share,
        "load_viscous": (1 - own) * viscous,
        "load_coulomb": (1 - own) * coulomb,
        "offset": rng.uniform(-0.1, 0.1) * torque,
    }
    law, name = _law(rng, inertia, period, torque)
    loop = ji.ClosedLoop(ji.FlexibleJoint(kind="revolute"), law)
    pulses = rng.uniform() < 0.5
    known = ji.excitation.pulses(reference.size, period, 0.5 * torque, 0.4 / mode, 0.5, 0) if pulses else None
    try:
        clean = ji.simulated_record(loop, reference, truth, sample_time=period, injected=known)
        assert clean.torque is not None
        level = float(np.std(clean.torque.values))
        size = level * rng.uniform(0.005, 0.05)
        if float(np.abs(clean.torque.values).max()) > 8 * torque:
            return None
        white = rng.standard_normal(reference.size)
        if noise == "log":
            extra: dict[str, Any] = {"torque_noise": size * white}
        else:
            if noise == "coloured force":
                white = lfilter([1.0], [1.0, -math.exp(-period * 2 * math.pi * rng.uniform(2, 30))], white)
            extra = {"disturbance": size * white / white.std()}
        record = ji.simulated_record(loop, reference, truth, sample_time=period, injected=known, **extra)
    except MethodError:  # the loop is not stable
        return None
    about = {
        "mode": mode, "share": share, "ratio": ratio, "period": period, "duration": duration, "motion": motion,
        "noise": noise, "size": size / level, "law": name, "pulses": pulses,
    }  # fmt: skip
    return Drive(record.without("motor_position", "load_position"), loop, truth, about)


def _reference(
    rng: np.random.Generator, motion: str, speed: float, acceleration: float, period: float, duration: float
) -> FloatArray:
    time = np.arange(math.floor(duration / period)) * period
    if motion in MOTIONS[:2]:
        travel = speed * (speed / acceleration + rng.uniform(0.1, 0.4))
        moved = ji.excitation.trapezoids(
            (0.4 * speed, 0.7 * speed, speed),
            acceleration,
            travel,
            period,
            rest=rng.uniform(0, 0.15),
            duration=duration,
        )
        if motion == "trapezoid":
            return moved
        jerk = max(round(rng.uniform(0.1, 0.6) * speed / acceleration / period), 2)
        return np.asarray(lfilter(np.full(jerk, 1 / jerk), [1.0], moved))
    highest = rng.uniform(5, 15)
    if motion == "sweep":
        phase = 2 * math.pi * (0.3 * time + (highest - 0.3) * time**2 / (2 * duration))
        rate = 0.3 + (highest - 0.3) * time / duration
        shape = np.sin(phase) / rate
    else:
        base = max(0.2, 1 / duration)
        lines = base * np.arange(1, math.floor(highest / base) + 1)
        shape = sum(np.sin(2 * math.pi * f * time + rng.uniform(0, 2 * math.pi)) / f for f in lines)
    begun = np.minimum(time / 0.3, 1.0)
    shape = shape * begun**3 * (10 - 15 * begun + 6 * begun**2)  # from rest, without a jump of the acceleration
    return np.asarray(shape * speed / (np.abs(np.diff(shape)).max() / period))


def _law(rng: np.random.Generator, inertia: float, period: float, torque: float) -> tuple[Any, str]:
    bandwidth = 2 * math.pi * _SLOWEST_LOOP * (_FASTEST_LOOP / _SLOWEST_LOOP) ** rng.uniform()
    name = str(rng.choice(["P-P", "P-PI", "PID"]))
    delay, limit = float(rng.choice([0.0, 1.0])) * period, 50 * torque
    if name == "PID":
        slow = bandwidth * rng.uniform(0.3, 0.6)
        law: Any = ji.controller.PID(
            position_gain=inertia * bandwidth * slow,
            derivative_gain=inertia * bandwidth,
            integral_gain=inertia * bandwidth * slow**2 * rng.uniform(0.02, 0.2),
            limit=limit, delay=delay, period=period,
        )  # fmt: skip
        return law, name
    law = ji.controller.Cascade(
        position_gain=bandwidth * rng.uniform(0.1, 0.35),
        velocity_gain=inertia * bandwidth,
        integral_gain=bandwidth * rng.uniform(0.05, 0.3) if name == "P-PI" else 0.0,
        velocity_feedforward=float(rng.choice([0.0, 1.0])),
        limit=limit, delay=delay, period=period,
    )  # fmt: skip
    return law, name


@dataclass(frozen=True)
class Said:
    """What was said of a drive: whether its stiffness is given, the verdict on its loop, and errors in deviations."""

    given: bool
    loop: str
    z: dict[str, float]


def judge(seed: int, longest: float = 60.0, noise: str = "") -> Said:
    """Identify a drive and compare."""
    axis = drive(seed, longest, noise)
    try:
        found = ji.identify(axis.record, axis.loop)
    except JointidError:
        return Said(False, "", {})
    rows = {row.name: row for row in found.rows if row.name in axis.truth}
    known = {n: (r.value, r.stderr) for n, r in rows.items() if r.value is not None and r.stderr}
    loop = ["failed" if one.passed is False else "" for one in found.checks if one.name == "loop"]
    z = {name: (value - axis.truth[name]) / std for name, (value, std) in known.items()}
    return Said(rows["stiffness"].value is not None, loop[0] if loop else "", z)
