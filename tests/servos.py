"""Random rigid servos that rest for a part of the time; the log is cut out of a run: what was before is unknown."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

import jointid as ji

_LONGEST = 5  # samples from a command to where the motor is still held by it


@dataclass(frozen=True)
class Servo:
    """A servo, its log, and what is known of it."""

    record: ji.Record
    loop: ji.ClosedLoop
    truth: dict[str, float]
    velocity: float  # at the first sample, rad/s
    force: float = 0.0  # standard deviation of the force in its loop, N m


def servo(seed: int, moving: bool = False) -> Servo:
    """Return a servo whose log begins while it stands, or while it moves.

    Inertias from 1e-4 to 10 kg m2, P-P and P-PI, loops of 10 to 60 Hz at 1 and 4 kHz, delays of up to one and a half
    periods, Coulomb friction of 5 to 40 % of the torque of the ramps; noise on the log, and in two of three a coloured
    force of 1 to 6 % in the loop.
    """
    rng = np.random.default_rng([seed, 7])
    while True:
        found = _tried(rng, moving, force=seed % 3 != 0)
        if found is not None:
            return found


def _tried(rng: np.random.Generator, moving: bool, force: bool) -> Servo | None:
    inertia, period = 10 ** rng.uniform(-4, 1), float(rng.choice([1e-3, 2.5e-4]))
    pace, swing = rng.uniform(0.3, 1.0), 10 ** rng.uniform(-0.5, 1)
    bandwidth = 2 * math.pi * rng.uniform(10, 60)
    speeds = tuple(swing / pace * np.array([0.5, 1.0, 1.5]))
    acceleration = 10 * swing / pace**2 * rng.uniform(0.4, 1.0)
    torque = inertia * acceleration
    law = ji.controller.Cascade(
        position_gain=bandwidth * rng.uniform(0.1, 0.35),
        velocity_gain=inertia * bandwidth,
        integral_gain=float(rng.choice([0.0, 1.0])) * bandwidth * rng.uniform(0.05, 0.3),
        velocity_feedforward=float(rng.choice([0.0, 1.0])),
        delay=rng.uniform(0, 1.5) * period,
        limit=20 * torque,
        period=period,
    )
    reference = ji.excitation.trapezoids(
        speeds, acceleration, swing, period, rest=pace * rng.uniform(0.8, 2), duration=24.0
    )
    truth = {
        "inertia": inertia,
        "viscous": rng.uniform(0.05, 0.5) * torque / speeds[-1],
        "coulomb": rng.uniform(0.05, 0.4) * torque,
        "offset": rng.uniform(-0.1, 0.1) * torque,
    }
    loop = ji.ClosedLoop(ji.RigidJoint(kind="revolute"), law)
    pole = math.exp(-period * 2 * math.pi * rng.uniform(2, 30))
    disturbance = lfilter([1.0], [1.0, -pole], rng.standard_normal(reference.size))
    disturbance *= (rng.uniform(0.01, 0.06) if force else 0.0) * torque / disturbance.std()
    try:
        whole = ji.simulated_record(loop, reference, truth, sample_time=period, disturbance=disturbance)
    except ji.MethodError:  # the loop is not stable
        return None
    assert whole.torque is not None
    assert whole.motor_position is not None
    logged, velocity = whole.torque.values, np.diff(whole.motor_position.values) / period
    if np.abs(logged).max() > 8 * torque:
        return None
    at = np.arange(velocity.size) * period
    early = (at > 2.0) & (at < (4.0 if moving else 6.0))
    if moving:
        chosen = early & (np.abs(velocity) > 0.2 * speeds[0])
    else:
        commanded = np.concatenate([np.ones(_LONGEST), np.diff(reference) != 0])
        held = ~np.array([commanded[i : i + velocity.size] for i in range(_LONGEST + 1)]).any(axis=0)
        chosen = early & (velocity == 0) & held
    if not np.any(chosen):
        return None
    cut = int(rng.choice(np.flatnonzero(chosen)))
    noise = rng.uniform(0.005, 0.03) * torque * rng.standard_normal(logged.size - cut)
    record = ji.Record(
        torque=ji.Channel(logged[cut:] + noise, "N m", period, whole.torque.timing),
        reference=ji.Channel(reference[cut:], "rad", period),
    )
    return Servo(record, loop, truth, float(velocity[cut]), float(disturbance.std()))
