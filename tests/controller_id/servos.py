"""Random servos whose velocity is a weighted difference of up to eight positions, and their records."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import PD
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.excitation import trapezoids

_PERIOD = 1e-3
_SAMPLES = 8_000
_NOISE = 1e-3  # of the torque's rms
_CLOSE = (
    1e-2  # of the torque's rms: two laws whose torque differs by less are one; wrong ones are some 2 % apart or more
)


@dataclass(frozen=True, slots=True, eq=False)
class TapsTwin:
    """A servo with a weighted difference, and its record.

    Attributes:
        taps: weights of the last differences of the position.
        controller: the law.
        values: of the joint.
        record: with reference, torque and motor position.
        seen: (samples,) the position that the law read.
        inside: whether the encoder rounds what the law reads.
    """

    taps: tuple[float, ...]
    controller: PD
    values: dict[str, float]
    record: Record
    seen: FloatArray
    inside: bool


def taps_twin(seed: int) -> TapsTwin:
    """Return a random servo whose velocity is a weighted difference, and its record.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 18])
    while True:
        made = _random_twin(rng, seed % 2 == 1)
        if made is not None:
            return made


def _random_twin(rng: np.random.Generator, inside: bool) -> TapsTwin | None:
    inertia, travel = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-1, 0.5)
    taps = _taps(rng)
    inner = 2 * math.pi * math.exp(rng.uniform(math.log(8), math.log(30)))
    outer = inner / rng.uniform(2.5, 5.0)
    controller = PD(
        position_gain=inertia * inner * outer,
        derivative_gain=inertia * inner,
        velocity_filter=taps,
        reference_velocity="difference" if rng.random() < 0.6 else "none",
    )
    reference = _reference(rng, travel)
    size = inertia * travel
    values = {"inertia": inertia, "viscous": 0.0, "coulomb": size * rng.uniform(0.3, 2.0)}
    values["offset"] = values["coulomb"] * rng.uniform(-0.3, 0.3)
    step = travel * 10 ** rng.uniform(-6.5, -5.0)
    torque, position = _drive(controller, taps, reference, values, step if inside else 0.0)
    if not np.all(np.isfinite(torque)) or np.max(np.abs(position - reference)) > 0.5 * travel or _rings(torque):
        return None
    torque = torque + _NOISE * float(np.std(torque)) * rng.standard_normal(torque.size)
    logged = np.round(position / step) * step
    record = Record(
        torque=Channel(torque, "N", _PERIOD, Timing.HELD, "twin"),
        reference=Channel(reference, "m", _PERIOD, Timing.SAMPLED, "twin"),
        motor_position=Channel(logged, "m", _PERIOD, Timing.SAMPLED, "twin"),
        name="twin",
    )
    return TapsTwin(taps, controller, values, record, logged if inside else position, inside)


def _taps(rng: np.random.Generator) -> tuple[float, ...]:
    """Return weights of 1 to 8 differences: all alike, of a least-squares line, at random, or with some negative."""
    n, kind = int(rng.integers(1, 9)), int(rng.integers(4))
    weights = [
        np.ones(n),
        np.arange(1, n + 1) * np.arange(n, 0, -1),
        rng.uniform(0.1, 1.0, n),
        rng.uniform(-0.3, 1.0, n) + 0.3,
    ][kind].astype(np.float64)
    return tuple(map(float, weights / weights.sum()))


def _reference(rng: np.random.Generator, travel: float) -> FloatArray:
    speeds = tuple(travel * rng.uniform(0.3, 2.5, 3))
    reference = trapezoids(speeds, travel * rng.uniform(4.0, 12.0), travel, _PERIOD, 0.1, _SAMPLES * _PERIOD)
    window = np.hanning(2 * int(rng.integers(5, 30)) + 1)
    padded = np.pad(reference, window.size // 2, mode="edge")
    return np.asarray(np.convolve(padded, window / window.sum(), "valid"))


def _drive(
    law: PD, taps: tuple[float, ...], reference: FloatArray, values: dict[str, float], step: float
) -> tuple[FloatArray, FloatArray]:
    """Return torque and position: a mass with Coulomb friction, exact, whose law reads a rounded position."""
    mass, friction, offset = values["inertia"], values["coulomb"], values["offset"]
    q, v = float(reference[0]), 0.0
    tracked = law.reference_velocity == "difference"
    differences, before_q, before_r = [0.0] * len(taps), q, q
    torque, position = np.empty(reference.size), np.empty(reference.size)
    for k, r in enumerate(map(float, reference)):
        read = round(q / step) * step if step else q
        moved = read - before_q - (r - before_r if tracked else 0.0)
        before_q, before_r = read, r
        differences = [moved / _PERIOD, *differences[:-1]]
        speed = sum(h * d for h, d in zip(taps, differences, strict=True))
        u = law.position_gain * (r - read) - law.derivative_gain * speed
        torque[k], position[k] = u, q
        if not math.isfinite(u) or abs(q) > 1e3:
            return np.full(reference.size, math.nan), position
        q, v = _move(q, v, u - offset, friction, mass)
    return torque, position


def _move(q: float, v: float, force: float, friction: float, mass: float) -> tuple[float, float]:
    """Return position and velocity a period later."""
    left = _PERIOD
    while left > 0.0:
        if v == 0.0:
            if abs(force) <= friction:
                return q, 0.0
            a = (force - math.copysign(friction, force)) / mass
            return q + 0.5 * a * left**2, a * left
        a = (force - math.copysign(friction, v)) / mass
        stop = -v / a if a * v < 0 else math.inf
        if stop >= left:
            return q + v * left + 0.5 * a * left**2, v + a * left
        q, v, left = q + 0.5 * v * stop, 0.0, left - stop
    return q, v


def _rings(torque: FloatArray) -> bool:
    return float(np.std(np.diff(torque)[-1500:])) > 3 * float(np.std(np.diff(torque)[:5000]))
