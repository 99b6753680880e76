"""Slow, independent reference simulator for tests: event-driven, error-controlled, no code of jointid.

What it solves
--------------
Two masses (motor q1, v1; load q12, v12) with e = q12 - q1, de = v12 - v1:

    inertia1 a1  = tau - offset - f1(v1)  + stiffness e + damping de
    inertia2 a12 = - load_offset - f2(v12) - stiffness e - damping de - gravity(q12)
    f(v) = fv_pos v + fc_pos for v > 0;  fv_neg v - fc_neg for v < 0;  for v = 0 anything in [-fc_neg, fc_pos]
    that keeps the mass at rest, else the bound it moves against.

    gravity(q) = cos cos(angle q) + sin sin(angle q) + rate q

A spring in pieces: where |e| is in the piece that begins at e0 with torque t0, the link's force is
sign(e) (t0 + stiffness (|e| - e0)) + damping de, with that piece's stiffness and damping.

A friction that is another at low speed adds to f(v), in the direction of v, straight lines over |v| between the given
points, and what it is at the last of them beyond; at rest it adds to the bounds what it is at 0.

A rigid joint is the motor alone, and gravity acts on it.  The law runs at t_k = k T:

    u_lin[k] = w[k] + C z[k] + D q1(t_k);   u[k] = clip(u_lin[k], -limit, limit);   s[k] = u[k] + post[k]
    z[k+1]   = A z[k] + Bq q1(t_k) + Be (u[k] - u_lin[k])

and the motor feels s delayed: tau(t) = s[k] for t in [t_k + delay, t_{k+1} + delay), and s_before until then.

How
---
Time is cut at every controller instant and torque switch.  Inside a cut each mass has a mode: +1, -1 (it
slides that way) or 0 (it rests).  With the modes held the equations are smooth, so DOP853 integrates them
*past* any event, with dense output.  The guards (velocity of a sliding mass; distance of the force on a
resting mass from either end of its cone) and their derivatives are sampled on that output and every dip
between two samples is minimised, so that a double crossing inside one step is not missed.  The earliest
crossing is polished by re-integrating up to it (no interpolation error remains), a stopped mass gets a
velocity of exactly 0, and its mode is decided again.

A guard may start within rounding of its threshold: a mass just released, two masses stopping together, an
event at the very end of the last cut.  It then has to clear a tolerance (EVENT_TOLERANCE of the natural size)
before its zero counts, and until it has, only minus the tolerance counts.

Positions are integrated as displacements since the last cut and e is carried on its own: nothing is lost to
the difference of two large numbers, and a mass at rest keeps its position to the last bit.

Accuracy
--------
Tolerances are scale-free: `rtol`, and `atol` times the velocity and displacement that the largest force seen
so far gives the total inertia in one period.  Powers of 2 as units of mass, length, time change no bit.
Measured on random_case seeds 0 to 99: rtol 2.5e-14 with atol 1e-15, or half the steps, change u by at most
1e-12 of its peak and no mode or event; a step 15 times smaller finds the same events (seeds 0 to 59); matrix
exponentials from instant to instant, given the events, give the same states to 2e-13 (seeds 0 to 19).
The floor is rounding in the law, about |D q1| * 2e-16: choose an origin near the motion.  Where a guard only
touches its threshold the number of events may differ by rounding; the states then differ by rounding too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Force = Callable[[Array], Any]

Kind = Literal["stick", "reverse", "move"]
Case = tuple["Plant", "Law", "Array", "Array", float, float, float, "Array"]

SAMPLES_PER_STEP = 12  # of the guards, on the dense output of one integrator step
EVENT_TOLERANCE = 1e-13  # of the natural force or velocity: within it a piece starts on the threshold
EVENTS_PER_CUT = 60  # more than this between two torque switches is a fault of this file, not physics


@dataclass(frozen=True)
class Plant:
    """Motor and load; pairs are (positive motion, negative motion), >= 0; inertia2 None is a rigid joint."""

    inertia1: float
    fv1: tuple[float, float] = (0.0, 0.0)
    fc1: tuple[float, float] = (0.0, 0.0)
    offset: float = 0.0
    inertia2: float | None = None
    fv2: tuple[float, float] = (0.0, 0.0)
    fc2: tuple[float, float] = (0.0, 0.0)
    load_offset: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    gravity: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # cos, sin, rate, angle
    pieces: tuple[tuple[float, float, float, float], ...] = ()  # e0, t0, stiffness, damping; else one from 0
    more1: tuple[tuple[float, float], ...] = ()  # speed, friction that the motor has beside; the first speed is 0
    more2: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Law:
    """Normal form of the controller: A (nz, nz), Bq, Be, C, z0 (nz,), D and limit scalars; nz may be 0."""

    A: Array
    Bq: Array
    Be: Array
    C: Array
    D: float
    limit: float
    z0: Array


@dataclass(frozen=True)
class Result:
    """What happened at the controller instants t_k = k T, and every change of mode.

    u: (n,) law's output after the limit, before `post`.
    x: (n, 4) q1, v1, q12, v12 at t_k; (n, 2) for a rigid joint.
    mode: (n, 2) of -1, 0, +1 just after t_k (with the torque that acts from t_k on); rigid: column 1 is 0.
    events: (time, mass, kind) in order; mass 1 motor, 2 load; "stick": slid, now rests; "reverse": slid, now
    slides
        the other way; "move": rested, now slides (also where the torque jumps).  A mass released within
        rounding of the place where it stopped appears with both events, at times that agree to rounding.
    """

    u: Array
    x: Array
    mode: NDArray[np.int64]
    events: list[tuple[float, int, Kind]]


@dataclass(frozen=True)
class _Guard:
    """A smooth function of the state that is positive while `mass` may keep its mode."""

    mass: int
    value: Force
    slope: Force
    tolerance: float
    to: int  # mode after firing: +-1 for a release; 0 for "decide by the force" (a sliding mass has stopped)


class _Joint:
    """The plant between two cuts: state, modes, constant torque."""

    def __init__(
        self, plant: Plant, x0: Array, period: float, rtol: float, atol: float, max_step: float | None
    ) -> None:
        self.rigid = plant.inertia2 is None
        self.inertia = (plant.inertia1, math.inf if plant.inertia2 is None else plant.inertia2)
        self.fv = (plant.fv1, plant.fv2)
        # The rigid joint's absent load is a mass that always rests and pulls on nothing.
        self.fc = (plant.fc1, (math.inf, math.inf) if self.rigid else plant.fc2)
        self.more = (plant.more1 or ((0.0, 0.0),), plant.more2 or ((0.0, 0.0),))
        self.band = [0, 0]
        self.offset = (plant.offset, 0.0 if self.rigid else plant.load_offset)
        self.gravity, self.heavy = plant.gravity, 0 if self.rigid else 1
        linear = (0.0, 0.0, 0.0, 0.0) if self.rigid else (0.0, 0.0, plant.stiffness, plant.damping)
        self.pieces = plant.pieces or (linear,)
        self.total = plant.inertia1 + (plant.inertia2 or 0.0)

        self.q = [float(x0[0]), 0.0 if self.rigid else float(x0[2])]
        self.v = [float(x0[1]), 0.0 if self.rigid else float(x0[3])]
        self.e = 0.0 if self.rigid else self.q[1] - self.q[0]
        self.piece = 0  # the spring's: 0, 1, ... for e > 0 and 0, -1, ... for e < 0
        for i, (begin, *_) in enumerate(self.pieces):
            self.piece = i * int(np.sign(self.e)) if abs(self.e) >= begin else self.piece
        self.mode = [int(np.sign(v)) for v in self.v]
        for mass in (0, 1):
            self.band[mass] = sum(speed <= abs(self.v[mass]) for speed, _ in self.more[mass][1:])
        self.tau = 0.0
        self.force_size = 0.0
        self.period, self.rtol, self.atol = period, rtol, atol
        self.max_step = min(period, 0.25 / self.fastest_rate()) if max_step is None else max_step

    def fastest_rate(self) -> float:
        """Largest |eigenvalue|, 1/s, with both masses sliding; holding one only makes the other slower."""
        rates = [1e-3 / self.period]
        for i in range(2):
            for j in range(2):
                stiffness, damping = (max(piece[k] for piece in self.pieces) for k in (2, 3))
                steep = [max(abs(self.line(mass, k)[2]) for k in range(len(self.more[mass]))) for mass in (0, 1)]
                viscous = self.fv[0][i] + steep[0], self.fv[1][j] + steep[1]
                a = sliding_matrix(self.inertia, viscous, stiffness, damping)
                rates.append(float(np.abs(np.linalg.eigvals(a)).max()))
        return max(rates)

    # Physics. `y` is (d1, v1, d12, v12), d since the start of the piece; it may be (4,) or (4, many).

    def link(self, y: Any) -> Any:
        begin, torque, stiffness, damping = self.pieces[abs(self.piece)]
        side = float(np.sign(self.piece))
        return side * torque + stiffness * (self.e - side * begin + (y[2] - y[0])) + damping * (y[3] - y[1])

    def net(self, mass: int, y: Any) -> Any:
        """Force on a mass without its friction."""
        link = self.link(y)
        net = self.tau - self.offset[0] + link if mass == 0 else -self.offset[1] - link
        return net - self.weight(self.q[mass] + y[2 * mass]) if mass == self.heavy else net

    def weight(self, q: Any) -> Any:
        cos, sin, rate, angle = self.gravity
        return cos * np.cos(angle * q) + sin * np.sin(angle * q) + rate * q if any(self.gravity) else 0.0

    def acceleration(self, mass: int, y: Any) -> Any:
        mode = self.mode[mass]
        if mode == 0:
            return 0.0 * y[1]
        side = 0 if mode > 0 else 1
        speed, more, slope = self.line(mass, self.band[mass])
        friction = self.fv[mass][side] * y[2 * mass + 1] + mode * (self.fc[mass][side] + more)
        friction = friction + slope * (y[2 * mass + 1] - mode * speed)
        return (self.net(mass, y) - friction) / self.inertia[mass]

    def line(self, mass: int, band: int) -> tuple[float, float, float]:
        """Speed at which a band of the friction begins, what is added to it there, and its slope over the speed."""
        speed, more = self.more[mass][band]
        if band + 1 == len(self.more[mass]):
            return speed, more, 0.0
        further, there = self.more[mass][band + 1]
        return speed, more, (there - more) / (further - speed)

    def net_rate(self, mass: int, y: Any) -> Any:
        """d(net)/dt on a mass at rest: tau is constant in a piece, so only the other mass changes it."""
        other = 1 - mass
        _, _, stiffness, damping = self.pieces[abs(self.piece)]
        return stiffness * y[2 * other + 1] + damping * self.acceleration(other, y)

    def derivative(self, _t: float, y: Array) -> list[float]:
        state = y.tolist()
        return [
            state[1] if self.mode[0] else 0.0,
            self.acceleration(0, state),
            state[3] if self.mode[1] else 0.0,
            self.acceleration(1, state),
        ]

    # Natural sizes: the largest force so far, and what it gives the total inertia in one period.

    def set_torque(self, tau: float) -> None:
        self.tau = tau
        finite = [f for pair in self.fc for f in pair if math.isfinite(f)]
        spring = abs(self.link((0.0, 0.0, 0.0, 0.0)))
        weight = abs(self.weight(self.q[self.heavy]))
        self.force_size = max(self.force_size, abs(tau), *(abs(o) for o in self.offset), *finite, spring, weight)

    @property
    def velocity_size(self) -> float:
        # The share of the speed matters only without any force: it keeps the tolerances above zero.
        return max(self.force_size * self.period / self.total, 1e-3 * max(abs(v) for v in self.v))

    # Modes.

    def decide(self, mass: int) -> int:
        """Mode of a mass at zero velocity; on the edge of its cone it rests until its guard sees it leave."""
        force = self.net(mass, (0.0, self.v[0], 0.0, self.v[1]))
        up, down = (bound + self.more[mass][0][1] for bound in self.fc[mass])
        edge = EVENT_TOLERANCE * self.force_size
        # A mass that a guard has just released is on the edge: it must not stick again by rounding.
        if force > up + edge or (self.mode[mass] > 0 and force > up - edge):
            return 1
        if force < -down - edge or (self.mode[mass] < 0 and force < -down + edge):
            return -1
        return 0

    def guards(self) -> list[_Guard]:
        found: list[_Guard] = []
        for mass in (0,) if self.rigid else (0, 1):
            if self.mode[mass]:
                found.append(self.slide_guard(mass))
                for to in (self.band[mass] - 1, self.band[mass] + 1):
                    if 0 <= to < len(self.more[mass]):
                        found.append(self.band_guard(mass, to))
            else:
                found += [self.cone_guard(mass, 1), self.cone_guard(mass, -1)]
        for to in (self.piece - 1, self.piece + 1):
            if abs(to) < len(self.pieces):
                found.append(self.edge_guard(to))
        return found

    def edge_guard(self, to: int) -> _Guard:
        """The deflection stays on this side of the edge to the piece `to`."""
        up = to - self.piece
        outer = max(self.piece, to, key=abs)
        edge = float(np.sign(outer)) * self.pieces[abs(outer)][0]

        def value(y: Array) -> Any:
            return up * (edge - (self.e + (y[2] - y[0])))

        def slope(y: Array) -> Any:
            return -up * (y[3] - y[1])

        return _Guard(2, value, slope, EVENT_TOLERANCE * self.velocity_size * self.period, to)

    def band_guard(self, mass: int, to: int) -> _Guard:
        """The speed stays on this side of the edge to the band `to`."""
        mode, up = self.mode[mass], to - self.band[mass]
        edge = self.more[mass][max(to, self.band[mass])][0]

        def value(y: Array) -> Any:
            return up * (edge - mode * y[2 * mass + 1])

        def slope(y: Array) -> Any:
            return -up * mode * self.acceleration(mass, y)

        return _Guard(3 + mass, value, slope, EVENT_TOLERANCE * self.velocity_size, to)

    def slide_guard(self, mass: int) -> _Guard:
        mode = self.mode[mass]

        def value(y: Array) -> Any:
            return mode * y[2 * mass + 1]

        def slope(y: Array) -> Any:
            return mode * self.acceleration(mass, y)

        return _Guard(mass, value, slope, EVENT_TOLERANCE * self.velocity_size, 0)

    def cone_guard(self, mass: int, sign: int) -> _Guard:
        bound = self.fc[mass][0 if sign > 0 else 1] + self.more[mass][0][1]

        def value(y: Array) -> Any:
            return bound - sign * self.net(mass, y)

        def slope(y: Array) -> Any:
            return -sign * self.net_rate(mass, y)

        return _Guard(mass, value, slope, EVENT_TOLERANCE * self.force_size, sign)

    # Integration.

    def integrate(self, duration: float, dense: bool) -> Any:
        start = np.array([0.0, self.v[0], 0.0, self.v[1]])
        velocity = self.atol * self.velocity_size
        solution = solve_ivp(
            self.derivative,
            (0.0, duration),
            start,
            method="DOP853",
            dense_output=dense,
            first_step=min(duration, self.max_step),
            max_step=self.max_step,
            rtol=self.rtol,
            atol=[velocity * self.period, velocity, velocity * self.period, velocity],
        )
        if not solution.success:
            raise RuntimeError(f"DOP853 failed: {solution.message}")
        return solution

    def accept(self, y: Array) -> None:
        """Take `y` as the new state; it is exactly 0 for a resting mass."""
        d1, v1, d12, v12 = (float(value) for value in y)
        self.q[0] += d1
        self.q[1] += d12
        self.e += d12 - d1
        self.v = [v1, v12]
        for mass in (0, 1):
            # Only a mass that never cleared the tolerance after its release can come out backwards.
            if self.v[mass] * self.mode[mass] < 0.0:
                self.v[mass] = 0.0

    def first_event(self, solution: Any) -> tuple[float, float, _Guard] | None:
        """Time of the earliest failing guard, the level it passes there, and the guard."""
        knots = solution.t
        fractions = np.arange(SAMPLES_PER_STEP) / SAMPLES_PER_STEP
        times = np.append((knots[:-1, None] + np.diff(knots)[:, None] * fractions).ravel(), knots[-1])
        states = solution.sol(times)
        states[:, -1] = solution.y[:, -1]
        hits = [
            (*crossing, guard)
            for guard in self.guards()
            if (crossing := _first_crossing(guard, times, states, solution.sol)) is not None
        ]
        return min(hits, key=lambda hit: hit[0], default=None)

    def polish(self, time: float, level: float, guard: _Guard, duration: float) -> tuple[float, Array]:
        """Newton on the event time with the state integrated, not interpolated."""
        y = np.array([0.0, self.v[0], 0.0, self.v[1]])
        if time <= 0.0:
            return 0.0, y
        for attempt in range(4):
            y = self.integrate(time, dense=False).y[:, -1]
            slope = float(guard.slope(y))
            move = (float(guard.value(y)) - level) / slope if slope < 0.0 else 0.0
            # A touch (slope about 0) is located as well as it can be; a long move would leave the bracket.
            if attempt == 3 or abs(move) <= 1e-15 * time or abs(move) > 1e-6 * self.period:
                break
            if not 0.0 < time - move <= duration:
                break
            time -= move
        return time, y

    def advance(self, start: float, duration: float, tau: float, log: list[tuple[float, int, Kind]]) -> None:
        """Go through one cut of constant torque; `start` only stamps the events."""
        self.begin(start, tau, log)
        elapsed = 0.0
        for _ in range(EVENTS_PER_CUT):
            left = duration - elapsed
            if left <= 1e-15 * self.period or self.mode == [0, 0]:
                return
            solution = self.integrate(left, dense=True)
            event = self.first_event(solution)
            if event is None:
                self.accept(solution.y[:, -1])
                return
            time, level, guard = event
            time, y = self.polish(time, level, guard, left)
            self.accept(y)
            elapsed += time
            if guard.mass == 2:
                self.piece = guard.to
                self.begin(start + elapsed, tau, log)  # a damper that begins to act pushes at once
                continue
            if guard.mass > 2:
                self.band[guard.mass - 3] = guard.to
                continue
            before = self.mode[guard.mass]
            if guard.to:
                self.mode[guard.mass] = guard.to
            else:
                self.v[guard.mass] = 0.0
                self.mode[guard.mass] = 0  # decide() must not take it for a mass just released
                self.mode[guard.mass] = self.decide(guard.mass)
            self.record(start + elapsed, guard.mass, before, log)
        raise RuntimeError(f"more than {EVENTS_PER_CUT} events between t = {start} and {start + duration}")

    def begin(self, start: float, tau: float, log: list[tuple[float, int, Kind]]) -> None:
        """Let the torque jump: a mass at rest may start, one that has just come to rest may stay."""
        self.set_torque(tau)
        for mass in (0,) if self.rigid else (0, 1):
            if self.v[mass] == 0.0:
                before = self.mode[mass]
                self.mode[mass] = self.decide(mass)
                self.record(start, mass, before, log)

    def record(self, time: float, mass: int, before: int, log: list[tuple[float, int, Kind]]) -> None:
        after = self.mode[mass]
        if after == 0 and before != 0:
            log.append((time, mass + 1, "stick"))
        elif after != before:
            log.append((time, mass + 1, "reverse" if before else "move"))


def _first_crossing(
    guard: _Guard, times: Array, states: Array, dense: Callable[[float], Array]
) -> tuple[float, float] | None:
    """Earliest time at which the guard fails, and the level it passes there; dips between samples count."""
    values: Array = np.asarray(guard.value(states))
    slopes: Array = np.asarray(guard.slope(states)) + 0.0 * values
    dips = (slopes[:-1] < 0.0) & (slopes[1:] > 0.0)
    if values[1:].min() > 0.0 and not dips.any():
        return None

    def value(t: float) -> float:
        return float(guard.value(dense(t)))

    def slope(t: float) -> float:
        return float(guard.slope(dense(t)))

    def root(function: Callable[[float], float], left: float, right: float) -> float:
        # A sample and the dense output at its time may differ in the last bit, so the sign is asked again.
        if function(left) * function(right) > 0.0:
            return right
        return float(brentq(function, left, right, xtol=1e-16 * (times[-1] + right), rtol=1e-15, maxiter=200))

    armed = bool(values[0] > guard.tolerance)
    for j in range(1, len(times)):
        left, right = float(times[j - 1]), float(times[j])
        threshold = 0.0 if armed else -guard.tolerance
        crossed = values[j] <= threshold
        if not crossed and dips[j - 1]:
            right = root(slope, left, right)
            crossed = value(right) <= threshold
        if crossed:
            if armed:
                return root(value, left, right), 0.0
            if slopes[j - 1] > 0.0:  # between two samples it cleared the tolerance and came back
                top = root(slope, left, right)
                if value(top) > guard.tolerance:
                    return root(value, top, right), 0.0
            # Not at `left`: near a touch that would undo the event which led here, and so on for ever.
            return root(lambda t: value(t) + guard.tolerance, left, right), -guard.tolerance
        armed = armed or bool(values[j] > guard.tolerance)
    return None


def split_delay(delay: float, period: float) -> tuple[int, float]:
    """Whole periods and the remaining fraction, 0 <= fraction < 1, of a delay; rounding is no fraction."""
    whole = math.floor(delay / period + 1e-9)
    fraction = delay / period - whole
    return whole, 0.0 if fraction < 1e-9 else fraction


def simulate(
    plant: Plant,
    law: Law,
    w: Array,
    post: Array,
    T: float,
    delay: float,
    s_before: float,
    x0: Array,
    *,
    rtol: float = 1e-12,
    atol: float = 1e-13,
    max_step: float | None = None,
) -> Result:
    """Simulate the sampled loop of the module docstring.

    w, post: (n,) reference's part of the torque and the signal added after the limit.
    T, delay: seconds; delay >= 0, any fraction or multiple of T.
    s_before: what went to the drive before k = 0.
    x0: (4,) q1, v1, q12, v12, or (2,) for a rigid joint, at t_0.
    rtol: of DOP853.  atol: multiple of the velocity (and, times T, displacement) that the largest force seen
    so far gives the total inertia in one T.  max_step: s; by default T or 0.25 / (fastest rate of the plant).
    """
    n = len(w)
    if len(post) != n or delay < 0.0 or len(x0) != (2 if plant.inertia2 is None else 4):
        raise ValueError("post must be as long as w, delay >= 0, x0 as long as the plant's state")
    joint = _Joint(plant, np.asarray(x0, dtype=float), T, rtol, atol, max_step)
    whole, fraction = split_delay(delay, T)
    A, Bq, Be, C = (np.asarray(part, dtype=float) for part in (law.A, law.Bq, law.Be, law.C))
    z = np.array(law.z0, dtype=float)
    u, s = np.empty(n), np.empty(n)
    x, mode = np.empty((n, 4)), np.zeros((n, 2), dtype=np.int64)
    events: list[tuple[float, int, Kind]] = []

    def drive(k: int) -> float:
        return float(s[k]) if k >= 0 else s_before

    for k in range(n):
        x[k] = joint.q[0], joint.v[0], joint.q[1], joint.v[1]
        wanted = float(w[k]) + float(C @ z) + law.D * joint.q[0]
        u[k] = min(max(wanted, -law.limit), law.limit)
        s[k] = u[k] + post[k]
        z = A @ z + Bq * joint.q[0] + Be * (u[k] - wanted)

        torques = [(drive(k - whole - 1), 0.0, fraction)] if fraction else []
        torques.append((drive(k - whole), fraction, 1.0))
        for part, (tau, begin, end) in enumerate(torques):
            start = (k + begin) * T
            if part == 0:
                joint.begin(start, tau, events)
                mode[k] = joint.mode
                if k == n - 1:
                    break
            joint.advance(start, (end - begin) * T, tau, events)
    return Result(u, x[:, :2] if joint.rigid else x, mode, events)


# Random loops -----------------------------------------------------------------------------------------------


def sliding_matrix(
    inertia: tuple[float, float],
    fv: tuple[float, float],
    stiffness: float,
    damping: float,
    load_rests: bool = False,
) -> Array:
    """d(state)/dt = A state for (q1, v1, q12, v12), both masses sliding, or the load held."""
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[1] = np.array([-stiffness, -damping - fv[0], stiffness, damping]) / inertia[0]
    if not load_rests and math.isfinite(inertia[1]):
        a[2, 3] = 1.0
        a[3] = np.array([stiffness, damping, -stiffness, -damping - fv[1]]) / inertia[1]
    return a


def loop_radius(plant: Plant, law: Law, T: float, delay: float, load_rests: bool = False) -> float:
    """Spectral radius of the sampled loop without Coulomb friction and limit, the load sliding or held."""
    inertia = (plant.inertia1, math.inf if plant.inertia2 is None else plant.inertia2)
    fv = (sum(plant.fv1) / 2, sum(plant.fv2) / 2)
    load_rests = load_rests or plant.inertia2 is None
    a = sliding_matrix(inertia, fv, plant.stiffness, plant.damping, load_rests)
    size = 2 if load_rests else 4
    a, b = a[:size, :size], np.eye(size)[:, 1] / plant.inertia1

    def hold(duration: float) -> tuple[Array, Array]:
        block = np.zeros((size + 1, size + 1))
        block[:size, :size], block[:size, size] = a * duration, b * duration
        block = expm(block)
        return block[:size, :size], block[:size, size]

    whole, fraction = split_delay(delay, T)
    phi_old, gamma_old = hold(fraction * T)
    phi_new, gamma_new = hold((1.0 - fraction) * T)
    nz, past = len(law.z0), whole + 1
    # State: x, s[k-1] .. s[k-past], z; the input of the row below is s[k] itself.
    total = size + past + nz
    output = np.zeros(total)
    output[0], output[size + past :] = law.D, law.C
    loop = np.zeros((total, total))

    def tap(lag: int) -> Array:
        return output if lag == 0 else np.eye(total)[size + lag - 1]

    loop[:size, :size] = phi_new @ phi_old
    loop[:size] += np.outer(phi_new @ gamma_old, tap(whole + 1)) + np.outer(gamma_new, tap(whole))
    for lag in range(past):
        loop[size + lag] = tap(lag)
    loop[size + past :, size + past :] = law.A
    loop[size + past :, 0] = law.Bq
    return float(np.abs(np.linalg.eigvals(loop)).max())


def rest_to_rest(n: int, rng: np.random.Generator) -> Array:
    """Trapezoidal-velocity moves between +-1 with rests of 35 to 80 samples, (n,), starting with a rest."""
    position, pieces, count = 0.0, [], 0
    while count < n:
        rest = np.full(int(rng.integers(35, 80)), position)
        goal = float(rng.uniform(0.4, 1.0)) * (-1.0 if position > 0.0 else 1.0)
        steps, ramp = int(rng.integers(60, 110)), rng.uniform(0.2, 0.5)
        speed = np.interp(np.arange(1, steps + 1) / steps, [0.0, ramp, 1.0 - ramp, 1.0], [0.0, 1.0, 1.0, 0.0])
        pieces += [rest, position + (goal - position) * np.cumsum(speed) / speed.sum()]
        position = goal
        count += len(rest) + steps
    return np.concatenate(pieces)[:n]


def multisine(n: int, rng: np.random.Generator) -> Array:
    """Two to four sines of 40 to 200 samples a period, below 1 together, switched on for one part, (n,)."""
    k = np.arange(n)
    periods = rng.uniform(40.0, 200.0, int(rng.integers(2, 5)))
    sizes = periods / periods.max() / len(periods)
    wave = sum(size * np.sin(2.0 * np.pi * (k / p + rng.random())) for p, size in zip(periods, sizes, strict=True))
    begin, length = rng.uniform(0.0, 0.5) * n, rng.uniform(0.3, 0.5) * n
    return np.asarray(wave * np.clip(np.minimum(k - begin, begin + length - k) / 40.0, 0.0, 1.0))


def random_plant(rng: np.random.Generator, unit: float, acceleration: float) -> Plant:
    """A joint whose friction is 0.15 to 1.2 of its inertial force; `unit` scales time (1 for T = 1 ms)."""
    rigid = rng.random() < 0.3
    asymmetric = rng.random() < 0.5
    inertia1 = 10.0 ** rng.uniform(-4.0, 2.0)
    inertia2 = 0.0 if rigid else inertia1 * 10.0 ** rng.uniform(-0.7, 0.7)
    total = inertia1 + inertia2
    share = 1.0 if rigid else rng.uniform(0.25, 0.75)
    coulomb = total * acceleration * rng.uniform(0.15, 1.2)
    viscous = total * rng.uniform(0.3, 4.0) / unit

    def pair(size: float) -> tuple[float, float]:
        other = size * rng.uniform(0.6, 1.6) if asymmetric else size
        return float(size), float(other)

    fv1, fc1 = pair(viscous * share), pair(coulomb * share)
    offset = float(rng.uniform(-0.6, 0.6) * min(fc1))
    if rigid:
        return Plant(inertia1, fv1, fc1, offset)
    fv2, fc2 = pair(viscous * (1.0 - share)), pair(coulomb * (1.0 - share))
    load_offset = float(rng.uniform(-0.6, 0.6) * min(fc2) * (rng.random() < 0.5))
    omega, reduced = 2.0 * np.pi * rng.uniform(10.0, 60.0) / unit, inertia1 * inertia2 / total
    damping = 2.0 * 10.0 ** rng.uniform(-2.3, -0.8) * omega * reduced
    return Plant(inertia1, fv1, fc1, offset, inertia2, fv2, fc2, load_offset, omega**2 * reduced, damping)


def random_law(
    rng: np.random.Generator, total: float, omega: float, T: float, q0: float
) -> Callable[[float, Array, Array], tuple[Law, Array]]:
    """One of three kinds of law: make(gain, r, dr) -> (law without limit, w); gain < 1 weakens the loop."""
    kind = int(rng.integers(3))
    damping, alpha = rng.uniform(0.6, 1.1), rng.uniform(0.0, 0.7)
    reset, unwind = rng.uniform(0.1, 0.3), rng.uniform(0.2, 1.0)
    feedforward = float(rng.random() < 0.7)

    def make(gain: float, r: Array, dr: Array) -> tuple[Law, Array]:
        width = omega * gain
        position_gain, derivative_gain = total * width**2, 2.0 * damping * total * width
        w = position_gain * r + feedforward * derivative_gain * dr
        b = (1.0 - alpha) / T
        # z: the last position and the filtered velocity before it.
        a, bq, c = (
            np.array([[0.0, 0.0], [-b, alpha]]),
            np.array([1.0, b]),
            np.array([derivative_gain * b, -derivative_gain * alpha]),
        )
        if kind == 0:  # PD on the filtered difference
            return Law(a, bq, np.zeros(2), c, -position_gain - derivative_gain * b, math.inf, np.array([q0, 0.0])), w
        if kind == 1:  # cascade P-P; velocity: mean of the last two differences; z: the last two positions
            a, c = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([0.0, derivative_gain / (2.0 * T)])
            law = Law(
                a,
                np.array([1.0, 0.0]),
                np.zeros(2),
                c,
                -position_gain - derivative_gain / (2.0 * T),
                math.inf,
                np.full(2, q0),
            )
            return law, w
        # PID whose integrator is pulled back by what the limit cut off; w has the integral of r.
        integral_gain = reset * position_gain * width * T
        a = np.block([[a, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
        bq, be, c = np.append(bq, -integral_gain), np.array([0.0, 0.0, unwind]), np.append(c, 1.0)
        law = Law(a, bq, be, c, -position_gain - derivative_gain * b, math.inf, np.array([q0, 0.0, 0.0]))
        return law, w + integral_gain * (np.cumsum(r) - r)

    return make


def random_case(seed: int) -> Case:
    """A stable loop that slides, sticks and reverses: (plant, law, w, post, T, delay, s_before, x0).

    30 % rigid; half with friction that differs by direction; 400 to 600 periods of 1 ms (0.1 to 10 ms in 40 %
    of the cases); the limit low enough to be reached in 40 %; delay 0, a fraction, exactly one, or up to 2.6
    periods.
    """
    for attempt in range(20):
        case = draw_case(np.random.default_rng([seed, attempt]))
        if case is not None:
            return case
    raise RuntimeError(f"seed {seed}: no stable loop in 20 draws")


def draw_case(rng: np.random.Generator) -> Case | None:
    """One draw of random_case, or None where no gain makes the loop stable (delay, little damping)."""
    unit = 10.0 ** rng.uniform(-1.0, 1.0) if rng.random() < 0.4 else 1.0
    T, n = 1e-3 * unit, int(rng.integers(400, 601))
    stroke = 10.0 ** rng.uniform(-2.0, 1.0)
    plant = random_plant(rng, unit, acceleration=4.0 * stroke / (80.0 * T) ** 2)
    total = plant.inertia1 + (plant.inertia2 or 0.0)
    delays = [0.0, rng.uniform(0.05, 0.95), 1.0, rng.uniform(1.0, 2.6)]
    delay = T * float(rng.choice(delays, p=[0.3, 0.3, 0.1, 0.3]))

    origin = stroke * rng.uniform(-1.0, 1.0)
    r = origin + stroke * (rest_to_rest(n, rng) * 0.5 + multisine(n, rng) * rng.uniform(0.1, 0.5))
    dr = np.diff(r, prepend=r[0]) / T
    q0 = float(r[0])
    make = random_law(rng, total, 2.0 * np.pi * rng.uniform(8.0, 25.0) / unit, T, q0)
    for attempt in range(25):
        law, w = make(0.85**attempt, r, dr)
        radius = max(loop_radius(plant, law, T, delay, load_rests) for load_rests in (False, True))
        # A radius of 0.998 settles in 500 periods: slower than that is not a servo loop.
        if radius < 0.998:
            break
    else:
        return None

    inertial = total * np.abs(np.diff(r, 2)).max() / T**2
    friction = max(plant.fc1) + (0.0 if plant.inertia2 is None else max(plant.fc2))
    load = friction + abs(plant.offset) + abs(plant.load_offset)
    limit = load * 1.1 + inertial * rng.uniform(0.1, 0.5) if rng.random() < 0.4 else 8.0 * (load + inertial)
    law = Law(law.A, law.Bq, law.Be, law.C, law.D, float(limit), law.z0)

    post = np.zeros(n)
    k = int(rng.integers(20, 60))
    while k < n:
        height = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.8) * (friction + inertial)
        post[k : k + int(rng.integers(8, 20))] = height
        k += int(rng.integers(60, 130))
    if rng.random() < 0.3:
        post += 0.05 * friction * rng.standard_normal(n)
    s_before = float(plant.offset + rng.uniform(-0.8, 0.8) * min(plant.fc1))

    x0 = np.array([q0, 0.0])
    if plant.inertia2 is not None:
        stretch = rng.uniform(-0.5, 0.5) * min(plant.fc2) - plant.load_offset
        x0 = np.array([q0, 0.0, q0 + stretch / plant.stiffness, 0.0])
    if rng.random() < 0.3:
        x0[1::2] = rng.uniform(-0.3, 0.3) * stroke / (80.0 * T)
    return plant, law, w, post, T, float(delay), s_before, x0
