"""What every peer simulates: one flexible joint, one motion, one digital law; 25 s at 1 kHz.

Joint, motion and law are those of the measuring stick, which lies beside the real records and outside the
project; they are written here anew, so that everything but the comparison with C runs without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = (
    "motor_inertia", "motor_viscous", "motor_coulomb", "stiffness", "damping", "load_inertia", "load_viscous",
    "load_coulomb",
)  # fmt: skip
"""The parameters, in the order of every array of them."""

TRUTH = np.array([70.2, 92.0, 10.0, 8e5, 126.0, 34.8, 110.0, 10.4])
"""Theirs: kg, N s/m, N, N/m, N s/m, kg, N s/m, N."""

PERIOD = 1e-3
"""Seconds for which a torque is held."""

SAMPLES = 25_000

_SPEED, _ACCELERATION, _TRAVEL, _DWELL = 0.2, 1.0, 0.2, 0.5  # m/s, m/s2, m, s
_PULSE, _WIDTH, _FIRST, _APART, _LAST = 80.0, 15, 350, (180, 420), 200  # N, then samples


@dataclass(frozen=True, slots=True)
class Law:
    """A digital law: ``torque = clip(feedforward - kp q - kd v, limit)``, evaluated every period and held.

    The velocity is that of the backward difference d: ``v = memory v' + now d + before d'``, primes a period ago.

    Attributes:
        position_gain, derivative_gain: N/m and N s/m.
        memory, now, before: of the velocity's filter.
        limit: N.
        fed: whether the reference's velocity is fed forward through derivative_gain.
    """

    position_gain: float
    derivative_gain: float
    memory: float
    now: float
    before: float
    limit: float
    fed: bool


STICK = Law(1.4e6, 15_000.0, 0.3, 0.7, 0.0, 1e3, True)
"""A stiff PD law with the reference's velocity and a filter of first order."""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A law and what it is driven with, (samples,) each.

    Attributes:
        law: of the controller.
        reference, reference_velocity: m, m/s.
        pulse: N, added before the limit.
    """

    law: Law
    reference: Array
    reference_velocity: Array
    pulse: Array

    @property
    def feedforward(self) -> Array:
        """What of the torque does not depend on the motion, before the limit, N."""
        fed = self.law.derivative_gain * self.reference_velocity if self.law.fed else 0.0
        return np.asarray(self.law.position_gain * self.reference + fed + self.pulse)

    @property
    def samples(self) -> int:
        """How many periods are simulated."""
        return self.reference.size

    def first(self, samples: int) -> Loop:
        """Return the beginning of the same loop."""
        cut = slice(samples)
        return replace(
            self,
            reference=self.reference[cut],
            reference_velocity=self.reference_velocity[cut],
            pulse=self.pulse[cut],
        )

    def controller(self) -> Callable[[int, float], float]:
        """Return the law as a function of period and position, to be called once every period, in order."""
        law, w = self.law, self.feedforward.tolist()
        memory, now, earlier = law.memory, law.now / PERIOD, law.before / PERIOD
        last, velocity, moved = float(self.reference[0]), 0.0, 0.0

        def torque(period: int, position: float) -> float:
            nonlocal last, velocity, moved
            velocity = memory * velocity + now * (position - last) + earlier * moved
            last, moved = position, position - last
            wanted = float(w[period]) - law.position_gain * position - law.derivative_gain * velocity
            return min(max(wanted, -law.limit), law.limit)

        return torque


def loop_of(law: Law, samples: int = SAMPLES) -> Loop:
    """Return the problem: trapezoids of 0.2 m there and back, and pulses of 80 N and 15 ms of alternating sign."""
    reference, velocity = _trapezoids(samples)
    return Loop(law, reference, velocity, _pulses(samples))


def _trapezoids(samples: int) -> tuple[Array, Array]:
    ramp, cruise = _SPEED / _ACCELERATION, _TRAVEL / _SPEED - _SPEED / _ACCELERATION
    time = np.arange(samples) * PERIOD
    whole = 2 * ramp + cruise + _DWELL
    stroke = np.floor(time / whole)
    t = np.clip(time - stroke * whole - _DWELL / 2, 0.0, 2 * ramp + cruise)
    left = 2 * ramp + cruise - t
    position = np.where(
        t < ramp,
        0.5 * _ACCELERATION * t**2,
        np.where(left > ramp, _SPEED * (t - ramp / 2), _TRAVEL - 0.5 * _ACCELERATION * left**2),
    )
    forth = stroke % 2 == 0
    velocity = np.minimum(_SPEED, _ACCELERATION * np.minimum(t, left))
    return np.where(forth, position, _TRAVEL - position), np.where(forth, velocity, -velocity)


def _pulses(samples: int) -> Array:
    random = np.random.default_rng(1)
    pulse, at, sign = np.zeros(samples), _FIRST, 1.0
    while at < samples - _LAST:
        pulse[at : at + _WIDTH] = sign * _PULSE
        at, sign = at + int(random.integers(*_APART)), -sign
    return pulse
