"""The torque that every peer is judged by: event-driven, by SciPy's DOP853 at a relative tolerance of 1e-12.

Every held period is integrated on its own; a mass that comes to rest, and one whose Coulomb force gives way, is an
event, and the integration starts again behind it. It shares nothing with the package's own simulation. The measuring
stick has a reference of the same kind for its own law; both are compared where it is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.problem import PERIOD, TRUTH, Array, Loop

_TOLERANCE, _ABSOLUTE = 1e-12, 1e-15
_LONGEST = PERIOD / 4  # of a step: what is looked for between its ends may not hide inside it
_MOST = 40  # events within a period


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The torque, (samples,) in N, and how many stops, starts and reversals there were."""

    torque: Array
    events: int

    @property
    def peak(self) -> float:
        """Largest torque, N."""
        return float(np.max(np.abs(self.torque)))

    def error(self, torque: Array) -> float:
        """Return the largest difference of a torque from this one, as a share of the peak."""
        worst = np.max(np.abs(torque - self.torque[: torque.size]))
        return float(worst) / self.peak if np.isfinite(worst) else math.inf


def reference_of(loop: Loop, parameters: Array = TRUTH) -> Reference:
    """Integrate a loop with its events; about 10 s for 25,000 periods."""
    joint = _Joint(parameters)
    controller, torque, events = loop.controller(), np.empty(loop.samples), 0
    start = float(loop.reference[0])
    x = np.array([start, 0.0, start, 0.0])
    for period in range(loop.samples):
        torque[period] = controller(period, x[0])
        x, located = joint.held(x, torque[period])
        events += located
    return Reference(torque, events)


class _Joint:
    """Two masses under Coulomb friction; `moving` is -1, 0 or 1 for each."""

    def __init__(self, parameters: Array) -> None:
        self.m1, self.v1, self.c1, self.k, self.d, self.m2, self.v2, self.c2 = (float(p) for p in parameters)
        self.coulomb = (self.c1, self.c2)
        self.moving = [0, 0]

    def push(self, mass: int, x: Array, torque: float) -> float:
        """Return the force on a mass but for its own friction."""
        spring = self.k * (x[2] - x[0]) + self.d * (x[3] - x[1])
        return float(torque + spring if mass == 0 else -spring)

    def decide(self, mass: int, x: Array, torque: float) -> None:
        """Let a mass that stands still go where its Coulomb force cannot hold the push on it."""
        push = self.push(mass, x, torque)
        self.moving[mass] = 0 if abs(push) <= self.coulomb[mass] else int(np.sign(push))

    def held(self, x: Array, torque: float) -> tuple[Array, int]:
        """Return the state a period later, and the events in between."""
        from scipy.integrate import solve_ivp

        for mass in (0, 1):
            if x[2 * mass + 1] == 0.0:
                self.decide(mass, x, torque)
        left, located = PERIOD, 0
        while left > 0 and any(self.moving):
            found: Any = solve_ivp(
                self._rates(torque), (0.0, left), x, "DOP853", rtol=_TOLERANCE, atol=_ABSOLUTE,
                events=[self._event(mass, torque) for mass in (0, 1)], max_step=_LONGEST,
            )  # fmt: skip
            x, left = found.y[:, -1].copy(), left - found.t[-1]
            hit = [mass for mass in (0, 1) if found.t_events[mass].size]
            if not hit:
                break
            located += 1
            for mass in hit:
                x[2 * mass + 1] = 0.0
                self.decide(mass, x, torque) if self.moving[mass] else self._release(mass, x, torque)
            if located > _MOST:
                raise RuntimeError(f"The reference met more than {_MOST} events within a period.")
        return x, located

    def _release(self, mass: int, x: Array, torque: float) -> None:
        # Where its force just gives way the push equals it to rounding: the mass must not stick again.
        self.moving[mass] = int(np.sign(self.push(mass, x, torque)))

    def _rates(self, torque: float) -> Callable[[float, Array], tuple[float, ...]]:
        s1, s2 = self.moving

        def rates(_t: float, x: Array) -> tuple[float, ...]:
            a1 = (self.push(0, x, torque) - self.v1 * x[1] - s1 * self.c1) / self.m1 if s1 else 0.0
            a2 = (self.push(1, x, torque) - self.v2 * x[3] - s2 * self.c2) / self.m2 if s2 else 0.0
            return x[1] if s1 else 0.0, a1, x[3] if s2 else 0.0, a2

        return rates

    def _event(self, mass: int, torque: float) -> Callable[[float, Array], float]:
        sign, limit = self.moving[mass], self.coulomb[mass]

        def stops(t: float, x: Array) -> float:
            return float(sign * x[2 * mass + 1]) if t > 0.0 else 1.0  # it may begin at rest

        def gives(_t: float, x: Array) -> float:
            return limit - abs(self.push(mass, x, torque))

        event: Any = stops if sign else gives
        event.terminal, event.direction = True, -1
        return event  # type: ignore[no-any-return]
