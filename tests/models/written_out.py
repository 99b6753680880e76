"""The laws of docs/controllers.md written out once more, sample by sample, with no code of jointid.

The bilinear rule is SciPy's, at a sampling frequency that is bent to be exact at one frequency; a filter is its
recurrence. Nothing here knows of states, elements or matrices.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import bilinear

from jointid.models.controllers import (
    PD,
    PID,
    Cascade,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
)

SETTLED = 4000  # periods of uniform motion before the first period: all filters here have forgotten by then


@dataclass(frozen=True)
class Sample:
    """What a law reads in a period."""

    reference: float = 0.0
    velocity: float = 0.0
    direction: float = 0.0
    injected: float = 0.0


def bent(numerator: list[float], denominator: list[float], frequency: float, T: float) -> tuple[Any, Any]:
    """The bilinear rule, exact at a frequency."""
    return bilinear(numerator, denominator, math.pi * frequency / math.tan(math.pi * frequency * T))


def coefficients(made: Any, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of a filter in powers of 1/z."""
    match made:
        case DigitalFilter():
            b, a = made.numerator, made.denominator
        case MovingAverage():
            b, a = np.full(made.samples, 1 / made.samples), [1.0]
        case FirstOrder():
            pole = math.exp(-T / made.time_constant) if made.time_constant else 0.0
            b, a = [1 - pole], [1.0, -pole]
        case SecondOrder():
            w = 2 * math.pi * made.frequency
            b, a = bent([1.0], [1 / w**2, 2 * made.damping / w, 1.0], made.frequency, T)
            if made.numerator_frequency is not None:
                w = 2 * math.pi * made.numerator_frequency
                zeros = [1 / w**2, 2 * made.numerator_damping / w, 1.0]
                c, d = bent([1.0], zeros, made.numerator_frequency, T)
                b = np.array(d) * b[0] / c[0]  # both have (1 + 1/z)^2 above, which cancels
        case Notch():
            w, width = 2 * math.pi * made.frequency, 2 * math.pi * made.bandwidth
            b, a = bent([1.0, made.depth * width, w**2], [1.0, width, w**2], made.frequency, T)
        case _:
            b, a = made, [1.0]
    return np.asarray(b, dtype=float), np.asarray(a, dtype=float)


class Recurrence:
    """``a0 y[k] = b0 x[k] + b1 x[k-1] + ... - a1 y[k-1] - ...``."""

    def __init__(self, made: Any, T: float, x: float) -> None:
        self.b, self.a = coefficients(made, T)
        total = float(np.sum(self.b) / np.sum(self.a))
        self.x = deque([x] * self.b.size, maxlen=self.b.size)
        self.y = deque([total * x] * (self.a.size - 1), maxlen=max(self.a.size - 1, 1))

    def __call__(self, x: float) -> float:
        self.x.appendleft(x)
        y = sum(b * one for b, one in zip(self.b, self.x, strict=True))
        y = (y - sum(a * one for a, one in zip(self.a[1:], self.y, strict=False))) / self.a[0]
        self.y.appendleft(y)
        return float(y)


class Late:
    """A signal later by a time: a straight line between two of its values."""

    def __init__(self, seconds: float, T: float, x: float) -> None:
        self.whole = math.floor(seconds / T)
        self.part = seconds / T - self.whole
        self.past = deque([x] * (self.whole + 2), maxlen=self.whole + 2)

    def __call__(self, x: float) -> float:
        self.past.appendleft(x)
        return (1 - self.part) * self.past[self.whole] + self.part * self.past[self.whole + 1]


@dataclass
class Written:
    """A law, as its page has it.

    `free` leaves limits out and keeps the integral: so a law is brought to its first period by uniform motion.
    """

    law: Cascade | PD
    T: float
    first: Sample
    q: float
    free: bool = True
    I: float = 0.0  # noqa: E741
    k: int = 0
    command: float = 0.0
    parts: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        law, T, r, rv = self.law, self.T, self.first.reference, self.first.velocity
        self.n = round(getattr(law, "position_period", None) / T) if getattr(law, "position_period", None) else 1
        self.parts = {"r": Late(law.reference_delay, T, r)}
        self.parts["direction"] = Late(law.reference_delay, T, self.first.direction)
        self.parts["rv"] = Late(law.reference_delay, T, rv)
        self.parts["v"], self.parts["vr"] = (Recurrence(law.velocity_filter, T, 0.0) for _ in range(2))
        for i, one in enumerate(law.torque_filters):
            self.parts[f"f{i}"] = Recurrence(one, T, 0.0)
        self.last = {"q": self.q, "r": r, "r_slow": [r] * self.n, "dr": 0.0}

    def __call__(self, now: Sample, q: float) -> float:
        """The torque of a period."""
        law, T, parts, last = self.law, self.T, self.parts, self.last
        r = parts["r"](now.reference)
        v = parts["v"]((q - last["q"]) / T)
        dr = (r - last["r"]) / T
        vr = parts["vr"](dr)
        rv = parts["rv"](now.velocity)
        if isinstance(law, Cascade):
            into, u = self._cascade(r, rv, v, q)
        else:
            wanted = {"difference": vr, "channel": rv, "none": 0.0}[law.reference_velocity]
            u, into = law.position_gain * (r - q) + law.derivative_gain * (wanted - v), T * (r - q)
            u += law.integral_gain * self.I if isinstance(law, PID) else 0.0
        last["q"], last["r"] = q, r
        m = self._filtered(law.gain * (u + self._fed(now, dr)) + now.injected)
        limit = math.inf if self.free else law.limit * law.gain
        y = min(max(m, -limit), limit)
        if not self.free and getattr(law, "integral_gain", 0.0):
            self._integrate(into, m, y)
        self.k += 1
        return y

    def _cascade(self, r: float, rv: float, v: float, q: float) -> tuple[float, float]:
        law = self.law
        assert isinstance(law, Cascade)
        if (self.k - round(law.position_offset / self.T)) % self.n == 0:
            fed = (r - self.last["r_slow"][-1]) / (self.n * self.T)
            fed = rv if law.reference_velocity == "channel" else fed
            self.command = law.position_gain * (r - q) + law.velocity_feedforward * fed
        self.last["r_slow"] = [r, *self.last["r_slow"][:-1]]
        w = self.command if self.free else min(max(self.command, -law.velocity_limit), law.velocity_limit)
        return self.T * (w - v), law.velocity_gain * (w - v + law.integral_gain * self.I)

    def _integrate(self, into: float, m: float, y: float) -> None:
        law: Any = self.law
        weight = law.gain * law.integral_gain * (law.velocity_gain if isinstance(law, Cascade) else 1.0)
        if law.anti_windup == "hold" and into * (m - y) > 0:
            into = 0.0
        if law.anti_windup == "track":
            into += (y - m) / weight
        self.I += into

    def _fed(self, now: Sample, dr: float) -> float:
        law = self.law
        ddr = (dr - self.last["dr"]) / self.T
        self.last["dr"] = dr
        direction = self.parts["direction"](now.direction)
        fed = law.acceleration_feedforward * ddr + law.viscous_feedforward * dr
        return fed + law.coulomb_feedforward * direction + law.constant_feedforward

    def _filtered(self, m: float) -> float:
        for i in range(len(self.law.torque_filters)):
            m = self.parts[f"f{i}"](m)
        return m


def begun(law: Cascade | PD, T: float, first: Sample, slope: float, q: float, speed: float) -> Written:
    """Return a law after uniform motion up to its first period."""
    made = Written(law, T, first, q, k=-SETTLED)
    for k in range(-SETTLED, 0):
        made(replace(first, reference=first.reference + slope * k * T, injected=0.0), q + speed * k * T)
    made.free = False
    return made
