"""Slow, independent reference for smooth laws: DOP853, the laws in rate form, every event located.

What winds up is a state here as in the kernel, ``z' = (v - |v| z) / s``; its closed form over a
displacement is a test of its own. Directions are held
between events, so that what is integrated is smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jointid.models.friction import SmoothFriction
from jointid.models.springs import SmoothSpring
from tests.simulation.oracle import Law, Plant, split_delay


@dataclass(frozen=True)
class Smooth:
    """What a plant of the oracle has beyond pieces."""

    cubic: float = 0.0
    slider: float = 0.0
    slips: float = 0.0
    presliding: tuple[float, float] = (0.0, 0.0)
    per_torque: float = 0.0
    drift: tuple[float, float] = (0.0, 0.0)
    fade: tuple[float, float] = (0.0, 0.0)
    swings: tuple[float, float, float] = (0.0, 0.0, 0.0)  # share of the load, its stiffness and damping
    ripple: tuple[tuple[int, float, float, float], ...] = ()  # mass, rad per position, of the cosine and the sine

    @property
    def laws(self) -> tuple[SmoothFriction, SmoothFriction, SmoothSpring]:
        """As the kernel takes it: of motor, load and spring."""
        motor, load = (SmoothFriction(self.presliding[i], self.drift[i], self.fade[i]) for i in (0, 1))
        spring = SmoothSpring(self.cubic, self.slider, self.slips, *self.swings)
        return motor, load._replace(per_torque=self.per_torque), spring

    @property
    def places(self) -> np.ndarray:
        """The ripple as the kernel takes it."""
        rows = [[cos, sin, 0.0, wave, float(mass)] for mass, wave, cos, sin in self.ripple]
        return np.array(rows).reshape(-1, 5)


class _Motion:
    """Positions and velocities, what friction and spring are wound up to; and directions."""

    def __init__(self, plant: Plant, more: Smooth, x0: np.ndarray) -> None:
        assert plant.inertia2 is not None
        self.p, self.more, self.time, self.torque = plant, more, 0.0, 0.0
        share = more.swings[0]
        self.inertia = plant.inertia1, (1.0 - share) * plant.inertia2, share * plant.inertia2
        self.y = np.array([*x0, 0.0, 0.0, 0.0, *x0[2:]])
        self.y[4:6] = [float(np.sign(x0[2 * i + 1])) if more.presliding[i] else 0.0 for i in (0, 1)]
        self.mode = [int(np.sign(v)) or int(soft > 0) for v, soft in zip(x0[1::2], more.presliding, strict=True)]
        self.rate, self.sign = 1, 1

    def spring(self, y: np.ndarray) -> float:
        e = y[2] - y[0]
        return float(self.p.stiffness * e + self.more.cubic * e**3 + self.p.damping * (y[3] - y[1]) + y[6])

    def push(self, mass: int, y: np.ndarray) -> float:
        spring = self.spring(y)
        held = sum(
            cos * math.cos(wave * y[2 * mass]) + sin * math.sin(wave * y[2 * mass])
            for side, wave, cos, sin in self.more.ripple
            if side == mass
        )
        if mass == 0:
            return float(self.torque - self.p.offset + spring - held)
        return float(-self.p.load_offset - spring + self.pull(y) - held)

    def pull(self, y: np.ndarray) -> float:
        share, stiffness, damping = self.more.swings
        return float(stiffness * (y[7] - y[2]) + damping * (y[8] - y[3])) if share else 0.0

    def bound(self, mass: int, t: float, y: np.ndarray, direction: int) -> float:
        coulomb = (self.p.fc1, self.p.fc2)[mass][0 if direction > 0 else 1] + self.more.fade[mass] * t
        return coulomb + (self.more.per_torque * self.sign * self.spring(y) if mass == 1 else 0.0)

    def acceleration(self, mass: int, t: float, y: np.ndarray) -> float:
        mode = self.mode[mass]
        if mode == 0:
            return 0.0
        viscous = (self.p.fv1, self.p.fv2)[mass][0 if mode > 0 else 1] + self.more.drift[mass] * t
        wound = y[4 + mass] if self.more.presliding[mass] else mode
        friction = viscous * y[2 * mass + 1] + wound * self.bound(mass, t, y, mode)
        return (self.push(mass, y) - friction) / self.inertia[mass]

    def slopes(self, t: float, y: np.ndarray) -> list[float]:
        winding = [
            y[2 * i + 1] * (1.0 - self.mode[i] * y[4 + i]) / soft if soft else 0.0
            for i, soft in enumerate(self.more.presliding)
        ]
        de = y[3] - y[1]
        slider = self.more.slider * de * (1.0 - self.rate * y[6] / self.more.slips) if self.more.slider else 0.0
        swings = [y[8], -self.pull(y) / self.inertia[2]] if self.inertia[2] else [0.0, 0.0]
        return [y[1], self.acceleration(0, t, y), y[3], self.acceleration(1, t, y), *winding, slider, *swings]

    def guards(self) -> list[tuple[str, int]]:
        found = [("slide" if self.mode[mass] else "cone", mass) for mass in (0, 1)]
        found += [("rate", 0)] if self.more.slider else []
        return found + ([("sign", 0)] if self.more.per_torque else [])

    def value(self, guard: tuple[str, int], t: float, y: np.ndarray) -> float:
        kind, mass = guard
        if kind == "slide":
            return float(self.mode[mass] * y[2 * mass + 1])
        if kind == "cone":
            push = self.push(mass, y)
            return min(self.bound(mass, t, y, 1) - push, self.bound(mass, t, y, -1) + push)
        return float(self.rate * (y[3] - y[1])) if kind == "rate" else self.sign * self.spring(y)

    def settle(self) -> None:
        """Take the directions of what stands still, or stands at 0, from where it is pushed."""
        if self.more.per_torque and self.sign * self.spring(self.y) < 0.0:
            self.sign = -self.sign
        for mass in (0, 1):
            if self.y[2 * mass + 1] != 0.0:
                continue
            push = self.push(mass, self.y)
            if self.more.presliding[mass]:
                rest = push - self.y[4 + mass] * self.bound(mass, self.time, self.y, self.mode[mass])
                self.mode[mass] = int(np.sign(rest)) or self.mode[mass]
            else:
                over = push > self.bound(mass, self.time, self.y, 1)
                self.mode[mass] = 1 if over else (-1 if push < -self.bound(mass, self.time, self.y, -1) else 0)

    def advance(self, duration: float, torque: float) -> None:
        self.torque = torque
        end = self.time + duration
        self.settle()
        while end - self.time > 1e-14 * duration:
            watched = self.guards()

            def event(guard: tuple[str, int]):
                def value(t: float, y: np.ndarray) -> float:
                    return self.value(guard, t, y) + 1e-300

                value.terminal, value.direction = True, -1.0
                return value

            size = max(1e-6, float(np.max(np.abs(self.y[1:4:2]))))
            run = solve_ivp(
                self.slopes, (self.time, end), self.y, "DOP853", events=[event(guard) for guard in watched],
                rtol=1e-11, max_step=0.1 * duration,
                atol=[1e-13 * size] * 4 + [1e-12, 1e-12, 1e-12 * max(self.more.slips, 1.0)] + [1e-13 * size] * 2,
            )  # fmt: skip
            self.time, self.y = float(run.t[-1]), run.y[:, -1].copy()
            for guard, found in zip(watched, run.t_events, strict=True):
                if run.status == 1 and len(found):
                    self.after(*guard)

    def after(self, kind: str, mass: int) -> None:
        if kind == "rate":
            self.rate = -self.rate
        elif kind == "sign":
            self.sign = -self.sign
        elif kind == "cone":
            self.mode[mass] = 1 if self.push(mass, self.y) > 0 else -1
        else:
            self.y[2 * mass + 1] = 0.0
            self.settle()


def simulate(
    plant: Plant, more: Smooth, law: Law, w: np.ndarray, post: np.ndarray, T: float, delay: float, before: float,
    x0: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the controller's output, (n,), and the states at its instants, (n, 4)."""
    motion, z = _Motion(plant, more, x0), np.array(law.z0, dtype=float)
    whole, fraction = split_delay(delay, T)
    u, x = np.zeros(len(w)), np.zeros((len(w), 4))
    for k in range(len(w)):
        q = motion.y[0]
        raw = float(w[k] + law.C @ z + law.D * q)
        u[k] = float(np.clip(raw, -law.limit, law.limit))
        z = law.A @ z + law.Bq * q + law.Be * (u[k] - raw)
        x[k] = motion.y[:4]
        for share, lag in ((fraction, whole + 1), (1.0 - fraction, whole)):
            if share > 0.0:
                motion.advance(share * T, u[k - lag] + post[k - lag] if k >= lag else before)
    return u, x


def windup(x: np.ndarray) -> float:
    """Return the largest deflection of states, (n, 4)."""
    return float(np.max(np.abs(x[:, 2] - x[:, 0]))) or math.nan
