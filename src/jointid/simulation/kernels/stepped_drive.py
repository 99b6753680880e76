"""The simulation of a drive with smooth laws, in steps whose error is controlled, compiled.

A cubic or hysteretic spring, friction that winds up over a displacement, that grows with the torque through the spring
or changes with time, a force that follows the position: none has an affine map (`kernels.drive`). So the motion is
integrated by the pair of orders 5 and 4 of J. R. Dormand and P. J. Prince (A family of embedded Runge-Kutta formulae,
Journal of Computational and Applied Mathematics 6, 1980), whose difference bounds the error of a step. Between two
events the laws are smooth, and the events are located: a mass that stops or comes loose, as in `kernels.drive`, the
reversals from which friction or spring wind up anew, and the torque of the spring through 0. A guard is positive until
its event; where one is negative at the end of a step, or at the bottom of a dip between both ends, the step is made
shorter, to the guard's root.

What winds up over a displacement follows a law of P. R. Dahl (Solid friction damping of mechanical vibrations, AIAA
Journal 14, 1976), which is integrated in closed form, as a function of the displacement since the last reversal: with
the force ``F0`` there, the limit ``L`` and the stiffness ``k``, in the direction ``d``::

    F(x) = d L + (F0 - d L) exp(-k |x - x0| / L)

State ``y`` = position and velocity of the motor, of the load, and of the part of an elastic load that swings, which
follows the load with a spring and a damper of its own, without friction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compiled, inlined
from jointid.simulation.kernels.drive import (
    CHATTERING,
    DIVERGED,
    FINISHED,
    TOO_STIFF,
    Drive,
    Feedback,
    IntArray,
    control_any,
    drive_of,
)

_TOLERANCE = 1e-9  # of the largest velocity so far: the error of one step
_FIRST = 0.05  # of the time in which the drive's own motion changes: the first step
_TURN = 1.0  # rad of a force that follows the position: a longer step might miss one
_EVENTS = 1000  # per period; a physical drive has a handful
_WORK = 20  # steps a simulation may take, per period: bounds the time an absurd candidate can cost
_NEAR, _DIPS = 1e-2, 12  # of a guard's ends: a cubic may err by less; steps to the bottom of a dip
_ROOT = 1e-13  # of a step: where an event is located to
_STATES = 6
_GUARDS = 6  # of motor, load, reversing spring, spring's torque; of motor and load the other way while they rest


class _Beyond(NamedTuple):
    """What the laws have beyond lines: the row of numbers that `run` is given."""

    cubic: float
    slope: float
    limit: float
    soft1: float
    soft2: float
    loss: float
    drift1: float
    drift2: float
    share: float
    stiffness2: float
    damping2: float
    fade1: float
    fade2: float


class _State(NamedTuple):
    """Positions and velocities of motor and load, and of what swings on an elastic one."""

    q1: float
    v1: float
    q2: float
    v2: float
    q3: float
    v3: float


class _Modes(NamedTuple):
    """Directions of motor, load, the spring's rate and its torque (0: at rest), and what each winds up from.

    Of motor, load and spring: the force, or the share of the Coulomb force, at the last reversal, and where that was.
    """

    motor: int
    load: int
    rate: int
    torque: int
    wound1: float
    from1: float
    wound2: float
    from2: float
    wound: float
    since: float


@inlined
def _wound(direction: int, begun: float, way: float) -> float:
    """Return what is wound up, of a limit of 1, after a way in its own length since `begun`."""
    return direction + (begun - direction) * math.exp(-min(max(direction * way, 0.0), 700.0))


@inlined
def _spring(p: Drive, b: _Beyond, m: _Modes, s: _State) -> tuple[float, float]:
    """Return the torque of spring and damper, and the slope of the first over the deflection."""
    e = s.q2 - s.q1
    torque = (p.stiffness + b.cubic * e * e) * e + p.damping * (s.v2 - s.v1)
    slope = p.stiffness + 3.0 * b.cubic * e * e
    if b.slope > 0.0:
        wound = _wound(m.rate, m.wound, (e - m.since) * b.slope / b.limit)
        torque += b.limit * wound
        slope += b.slope * (1.0 - m.rate * wound)
    return torque, slope


@inlined
def _pull(b: _Beyond, s: _State) -> float:
    """Return the torque by which the part of an elastic load that swings pulls the rest of it."""
    return b.stiffness2 * (s.q3 - s.q2) + b.damping2 * (s.v3 - s.v2) if b.share > 0.0 else 0.0


@inlined
def _held_back(places: FloatArray, side: int, q: float) -> float:
    """Return the force on a side that follows its position."""
    force = 0.0
    for i in range(places.shape[0]):
        if places[i, 4] == side:
            phase = places[i, 3] * q
            force += places[i, 0] * math.cos(phase) + places[i, 1] * math.sin(phase) + places[i, 2] * q
    return force


@inlined
def _friction(
    mode: int, v: float, viscous: float, viscous_back: float, coulomb: float, back: float, soft: float, wound: float,
    since: float, q: float,
) -> float:  # fmt: skip
    """Return the friction of a mass in motion."""
    held = coulomb if mode > 0 else -back
    if soft > 0.0:
        held = (coulomb if mode > 0 else back) * _wound(mode, wound, (q - since) / soft)
    return (viscous if mode > 0 else viscous_back) * v + held


@inlined
def _pushes(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, s: _State, torque: float
) -> tuple[float, float, float]:
    """Return what pushes motor and load but their friction, and the spring's torque."""
    spring, _ = _spring(p, b, m, s)
    motor = torque - p.offset1 + spring - _held_back(places, 0, s.q1)
    return motor, -p.offset2 - spring + _pull(b, s) - _held_back(places, 1, s.q2), spring


@inlined
def _accelerations(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, s: _State, time: float, torque: float
) -> tuple[float, float, float]:
    """Return the accelerations of motor and load, and of what swings on it."""
    push1, push2, spring = _pushes(p, b, places, m, s, torque)
    a1, a2 = 0.0, 0.0
    if m.motor != 0:
        drift, more = b.drift1 * time, b.fade1 * time
        drag = _friction(
            m.motor, s.v1, p.viscous1 + drift, p.viscous1_back + drift, p.coulomb1 + more, p.coulomb1_back + more,
            b.soft1, m.wound1, m.from1, s.q1,
        )  # fmt: skip
        a1 = (push1 - drag) / p.inertia1
    if m.load != 0:
        drift, more = b.drift2 * time, b.fade2 * time + b.loss * m.torque * spring
        drag = _friction(
            m.load, s.v2, p.viscous2 + drift, p.viscous2_back + drift, p.coulomb2 + more, p.coulomb2_back + more,
            b.soft2, m.wound2, m.from2, s.q2,
        )  # fmt: skip
        a2 = (push2 - drag) / ((1.0 - b.share) * p.inertia2)
    return a1, a2, -_pull(b, s) / (b.share * p.inertia2) if b.share > 0.0 else 0.0


@inlined
def _state(y: FloatArray) -> _State:
    return _State(y[0], y[1], y[2], y[3], y[4], y[5])


@inlined
def _slopes(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, y: FloatArray, time: float, torque: float, k: FloatArray
) -> None:
    """Write how fast the state changes into `k`."""
    s = _state(y)
    a1, a2, a3 = _accelerations(p, b, places, m, s, time, torque)
    k[0], k[1], k[2], k[3], k[4], k[5] = s.v1, a1, s.v2, a2, s.v3, a3


@compiled
def _step(
    p: Drive,
    b: _Beyond,
    places: FloatArray,
    m: _Modes,
    y: FloatArray,
    k: FloatArray,
    new: FloatArray,
    time: float,
    h: float,
    torque: float,
) -> tuple[float, float]:
    """Write the state after `h` seconds into `new` and the slopes of the stages into `k`; return both errors.

    These are of the velocities, and of the positions: of the lower of both orders, over one step.
    """
    _slopes(p, b, places, m, y, time, torque, k[0])
    for i in range(_STATES):
        new[i] = y[i] + h * (1 / 5 * k[0, i])
    _slopes(p, b, places, m, new, time + 1 / 5 * h, torque, k[1])
    for i in range(_STATES):
        new[i] = y[i] + h * (3 / 40 * k[0, i] + 9 / 40 * k[1, i])
    _slopes(p, b, places, m, new, time + 3 / 10 * h, torque, k[2])
    for i in range(_STATES):
        new[i] = y[i] + h * (44 / 45 * k[0, i] - 56 / 15 * k[1, i] + 32 / 9 * k[2, i])
    _slopes(p, b, places, m, new, time + 4 / 5 * h, torque, k[3])
    for i in range(_STATES):
        new[i] = y[i] + h * (
            19372 / 6561 * k[0, i] - 25360 / 2187 * k[1, i] + 64448 / 6561 * k[2, i] - 212 / 729 * k[3, i]
        )
    _slopes(p, b, places, m, new, time + 8 / 9 * h, torque, k[4])
    for i in range(_STATES):
        new[i] = y[i] + h * (
            9017 / 3168 * k[0, i]
            - 355 / 33 * k[1, i]
            + 46732 / 5247 * k[2, i]
            + 49 / 176 * k[3, i]
            - 5103 / 18656 * k[4, i]
        )
    _slopes(p, b, places, m, new, time + h, torque, k[5])
    for i in range(_STATES):
        new[i] = y[i] + h * (
            35 / 384 * k[0, i] + 500 / 1113 * k[2, i] + 125 / 192 * k[3, i] - 2187 / 6784 * k[4, i] + 11 / 84 * k[5, i]
        )
    _slopes(p, b, places, m, new, time + h, torque, k[6])
    fast, far = 0.0, 0.0
    for i in range(_STATES):
        error = abs(h * (
            71 / 57600 * k[0, i] - 71 / 16695 * k[2, i] + 71 / 1920 * k[3, i] - 17253 / 339200 * k[4, i]
            + 22 / 525 * k[5, i] - 1 / 40 * k[6, i]
        ))  # fmt: skip
        fast, far = (max(fast, error), far) if i % 2 else (fast, max(far, error))
    return fast, far


@inlined
def _guards(
    p: Drive,
    b: _Beyond,
    places: FloatArray,
    m: _Modes,
    y: FloatArray,
    rates: FloatArray,
    time: float,
    torque: float,
    guards: FloatArray,
    slopes: FloatArray,
) -> None:
    """Write what is positive until an event happens, and how fast it changes; `rates` are those of the state."""
    s = _state(y)
    push1, push2, spring = _pushes(p, b, places, m, s, torque)
    _, slope = _spring(p, b, m, s)
    a1, a2, a3 = rates[1], rates[3], rates[5]
    rate = slope * (y[3] - y[1]) + p.damping * (a2 - a1)
    pulled = b.stiffness2 * (y[5] - y[3]) + b.damping2 * (a3 - a2) if b.share > 0.0 else 0.0
    for i in range(_GUARDS):
        guards[i], slopes[i] = 1.0, 0.0
    if m.motor != 0:
        guards[0], slopes[0] = m.motor * y[1], m.motor * a1
    else:
        more = b.fade1 * time
        guards[0], slopes[0] = p.coulomb1 + more - push1, b.fade1 - rate
        guards[4], slopes[4] = p.coulomb1_back + more + push1, b.fade1 + rate
    if m.load != 0:
        guards[1], slopes[1] = m.load * y[3], m.load * a2
    else:
        more, growth = b.fade2 * time + b.loss * m.torque * spring, b.fade2 + b.loss * m.torque * rate
        guards[1], slopes[1] = p.coulomb2 + more - push2, growth + rate - pulled
        guards[5], slopes[5] = p.coulomb2_back + more + push2, growth - rate + pulled
    if b.slope > 0.0:
        guards[2], slopes[2] = m.rate * (y[3] - y[1]), m.rate * (a2 - a1)
    if b.loss > 0.0:
        guards[3], slopes[3] = m.torque * spring, m.torque * rate


@inlined
def _dip(start: float, slope: float, end: float, last: float, h: float) -> float:
    """Return where in (0, 1) the cubic through both ends, with their slopes, is lowest and near 0; 1.0: nowhere."""
    b, c = slope * h, last * h
    if not (start >= 0.0 and end >= 0.0 and b < 0.0 < c):
        return 1.0
    cubic, square = 2.0 * (start - end) + b + c, 3.0 * (end - start) - 2.0 * b - c
    # The lower of both turning points, without a cancellation.
    root = math.sqrt(max(square * square - 3.0 * cubic * b, 0.0))
    at = -b / (square + root) if square + root > 0.0 else 0.5
    if not 0.0 < at < 1.0:
        return 1.0
    lowest = ((cubic * at + square) * at + b) * at + start
    return at if lowest < _NEAR * max(start, end) else 1.0


@compiled
def _locate(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, y: FloatArray, k: FloatArray, new: FloatArray, time: float,
    h: float, torque: float, which: int, start: float, end: float, guards: FloatArray, slopes: FloatArray,
) -> float:  # fmt: skip
    """Return the share of a step after which a guard is 0: the secant that keeps its bracket, and halves it in turn."""
    low, high, below, above = 0.0, 1.0, end, max(start, 0.0)
    for count in range(100):
        at = low + (high - low) * above / (above - below) if count % 3 < 2 else 0.5 * (low + high)
        if not low < at < high:
            at = 0.5 * (low + high)
        _step(p, b, places, m, y, k, new, time, at * h, torque)
        _guards(p, b, places, m, new, k[6], time + at * h, torque, guards, slopes)
        if guards[which] < 0.0:
            high, below = at, guards[which]
        else:
            low, above = at, guards[which]
        if high - low <= _ROOT or guards[which] == 0.0:
            break
    return high


@compiled
def _bottom(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, y: FloatArray, k: FloatArray, new: FloatArray, time: float,
    h: float, torque: float, which: int, dip: float, guards: FloatArray, slopes: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Return a share of a step at which a guard is below 0, or lowest, near where its cubic is; and the guard there."""
    low, high, at, value = 0.0, 1.0, dip, 1.0
    for _ in range(_DIPS):
        _step(p, b, places, m, y, k, new, time, at * h, torque)
        _guards(p, b, places, m, new, k[6], time + at * h, torque, guards, slopes)
        value = guards[which]
        if value < 0.0:
            break
        if slopes[which] < 0.0:
            low = at
        else:
            high = at
        at = 0.5 * (low + high)
    return at, value


@inlined
def _turned(b: _Beyond, m: _Modes, y: FloatArray, mass: int, mode: int) -> _Modes:
    """Return the modes after a mass took another; what its friction is wound up to is kept."""
    motor, load = m.motor, m.load
    wound1, from1, wound2, from2 = m.wound1, m.from1, m.wound2, m.from2
    if mass == 0:
        if b.soft1 > 0.0:
            wound1, from1 = _wound(motor, wound1, (y[0] - from1) / b.soft1), y[0]
        motor = mode
    else:
        if b.soft2 > 0.0:
            wound2, from2 = _wound(load, wound2, (y[2] - from2) / b.soft2), y[2]
        load = mode
    return _Modes(motor, load, m.rate, m.torque, wound1, from1, wound2, from2, m.wound, m.since)


@inlined
def _reversed(b: _Beyond, m: _Modes, y: FloatArray, rate: int) -> _Modes:
    """Return the modes after the spring began to wind up the other way."""
    e = y[2] - y[0]
    wound = _wound(m.rate, m.wound, (e - m.since) * b.slope / b.limit)
    return _Modes(m.motor, m.load, rate, m.torque, m.wound1, m.from1, m.wound2, m.from2, wound, e)


@inlined
def _through(m: _Modes, torque: int) -> _Modes:
    """Return the modes after the spring's torque went through 0."""
    return _Modes(m.motor, m.load, m.rate, torque, m.wound1, m.from1, m.wound2, m.from2, m.wound, m.since)


@compiled
def _settled(p: Drive, b: _Beyond, places: FloatArray, m: _Modes, y: FloatArray, time: float, torque: float) -> _Modes:
    """Return the modes of what stands still for a moment: held, or the way it is pushed."""
    s = _state(y)
    _, _, spring = _pushes(p, b, places, m, s, torque)
    if b.loss > 0.0 and m.torque * spring < 0.0:
        m = _through(m, -m.torque)
    push1, push2, spring = _pushes(p, b, places, m, s, torque)
    fade1, more = b.fade1 * time, b.fade2 * time + b.loss * abs(spring)
    for mass in range(2):
        if y[1 + 2 * mass] != 0.0:
            continue
        push, forwards, backwards = push1, p.coulomb1 + fade1, p.coulomb1_back + fade1
        soft, mode, wound, since, q = b.soft1, m.motor, m.wound1, m.from1, y[0]
        if mass == 1:
            push, forwards, backwards = push2, p.coulomb2 + more, p.coulomb2_back + more
            soft, mode, wound, since, q = b.soft2, m.load, m.wound2, m.from2, y[2]
        new = 0
        if soft > 0.0:
            share = _wound(mode, wound, (q - since) / soft)
            rest = push - share * (forwards if mode > 0 else backwards)
            new = 1 if rest > 0.0 else (-1 if rest < 0.0 else mode)
        elif push > forwards:
            new = 1
        elif push < -backwards:
            new = -1
        if new != mode:
            m = _turned(b, m, y, mass, new)
    if b.slope > 0.0 and y[3] == y[1]:
        a1, a2, _ = _accelerations(p, b, places, m, _state(y), time, torque)
        if m.rate * (a2 - a1) < 0.0:
            m = _reversed(b, m, y, -m.rate)
    return m


@compiled
def run(
    drive: FloatArray,
    beyond: FloatArray,
    places: FloatArray,
    lengths: FloatArray,
    lags: IntArray,
    z: FloatArray,
    feedback: Feedback,
    w: FloatArray,
    post: FloatArray,
    before: float,
    x: FloatArray,
    sliding: float,
    far: float,
    u: FloatArray,
    tapped: FloatArray,
    states: FloatArray,
    accelerations: FloatArray,
    counts: IntArray,
) -> int:
    """Simulate one loop; fill `u`, `tapped`, `states` and `accelerations` and return how it ended.

    Args:
        drive: (14,) the coefficients, as in `kernels.drive.run`.
        beyond: (13,) a cubic stiffness; stiffness and limit of what a spring has that winds up, after Dahl; lengths
            over which the Coulomb friction of motor and load winds up (0: it sticks); the load's friction per torque
            through the spring; by how much the viscous coefficients of motor and load rise per second; the share of the
            load that swings on a spring of its own, its stiffness and damping; by how much the Coulomb friction of
            motor and load rises per second.
        places: (forces, 5) that follow a position, each as gravity in `kernels.drive.run`, on the side in the last
            column: 0 for the motor's.
        lengths: of the parts of a period, as there.
        lags: of the torque in each, as there.
        z: state of the feedback, overwritten.
        feedback: the controller.
        w: response of its elements to its reference, as there.
        post: what is added after the limit.
        before: torque that acted before the first period.
        x: (4,) initial state, overwritten.
        sliding: 1 or -1 where friction is wound up at the first sample, the direction of the motion; else 0.
        far: a motor position beyond which the loop counts as diverged.
        u: (periods,) out, the torque that acts.
        tapped: out, as there.
        states: out, as there.
        accelerations: (periods * parts, 2) out, of motor and load, just after the torque of each part begins to act; or
            (0, 2).
        counts: (4,) out: events, steps, periods simulated, periods at the limit.
    """
    n, parts = w.shape[1], lengths.size
    p = drive_of(drive)
    b = _Beyond(
        beyond[0], beyond[1], beyond[2], beyond[3], beyond[4], beyond[5], beyond[6], beyond[7],
        beyond[8], beyond[9], beyond[10], beyond[11], beyond[12],
    )  # fmt: skip
    mobility = 1.0 / p.inertia1 + 1.0 / p.inertia2
    rate = math.sqrt((p.stiffness + b.slope) * mobility) + p.damping * mobility + 1.0 / np.max(lengths)
    if b.share > 0.0:
        mobility2 = 1.0 / ((1.0 - b.share) * p.inertia2) + 1.0 / (b.share * p.inertia2)
        rate += math.sqrt(b.stiffness2 * mobility2) + b.damping2 * mobility2
    finest = float(np.max(np.abs(places[:, 3]))) if places.shape[0] > 0 else 0.0
    y, new, k = np.zeros(_STATES), np.zeros(_STATES), np.zeros((7, _STATES))
    y[:4] = x
    if b.share > 0.0:
        y[4:] = x[2:]  # what swings moves with the load
    first, second = (1 if x[1] >= 0.0 else -1), (1 if x[3] >= 0.0 else -1)
    spring = p.stiffness * (x[2] - x[0])
    m = _Modes(
        first if x[1] != 0.0 or b.soft1 > 0.0 else 0, second if x[3] != 0.0 or b.soft2 > 0.0 else 0, 1,
        1 if spring >= 0.0 else -1, sliding, x[0], sliding, x[2], 0.0, x[2] - x[0],
    )  # fmt: skip
    guards, slopes, ends, lasts = np.zeros(_GUARDS), np.zeros(_GUARDS), np.zeros(_GUARDS), np.zeros(_GUARDS)
    fresh, raw, cut = np.empty(z.size), np.zeros(w.shape[0]), np.zeros(w.shape[0])
    events, steps, clipped, status = 0, 0, 0, FINISHED
    fastest, wanted = 0.0, float(_FIRST / rate)
    keep = states.shape[0] > 0
    period = np.sum(lengths)
    i = 0
    while i < n and status == FINISHED:
        control_any(feedback, w, i, y[0], z, fresh, raw, cut)
        u[i] = raw[feedback.output] + cut[feedback.output]
        if tapped.size > 0:
            tapped[i] = raw[feedback.tap] + cut[feedback.tap]
        if cut[feedback.tap] != 0.0:
            clipped += 1
        if not (abs(y[0]) <= far and abs(u[i]) < np.inf):
            status = DIVERGED
            break
        time, before_part = i * period, events
        for part in range(parts):
            source = i - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            m = _settled(p, b, places, m, y, time, torque)
            if keep:
                row = i * parts + part
                a1, a2, _ = _accelerations(p, b, places, m, _state(y), time, torque)
                states[row] = y[:4]
                accelerations[row, 0], accelerations[row, 1] = a1, a2
            left = lengths[part]
            while left > 0.0 and status == FINISHED:
                if wanted * fastest * finest > _TURN:
                    wanted = _TURN / (fastest * finest)
                h = left if wanted >= left else (wanted if wanted >= 0.5 * left else min(wanted, 0.5 * left))
                fast, away = _step(p, b, places, m, y, k, new, time, h, torque)
                steps += 1
                scale = max(fastest, abs(new[1]), abs(new[3]), 1e-3 * h * max(abs(k[0, 1]), abs(k[0, 3])))
                error = max(fast, away * rate) / (_TOLERANCE * scale) if scale > 0.0 else 0.0
                if not error <= 1.0:
                    shorter = 0.9 * error**-0.2 if error < np.inf else 0.1
                    wanted = h * max(shorter, 0.1)
                    if wanted < 1e-12 * period or steps > _WORK * n + 10_000:
                        status = TOO_STIFF
                    continue
                _guards(p, b, places, m, y, k[0], time, torque, guards, slopes)
                _guards(p, b, places, m, new, k[6], time + h, torque, ends, lasts)
                share, which = 1.0, -1
                for guard in range(_GUARDS):
                    if ends[guard] < 0.0:
                        start, end = guards[guard], ends[guard]
                        at = _locate(p, b, places, m, y, k, new, time, h, torque, guard, start, end, slopes, lasts)
                        _step(p, b, places, m, y, k, new, time, h, torque)
                        _guards(p, b, places, m, y, k[0], time, torque, guards, slopes)
                        _guards(p, b, places, m, new, k[6], time + h, torque, ends, lasts)
                        if which < 0 or at < share:
                            share, which = at, guard
                dip, dipped = 1.0, -1
                for guard in range(_GUARDS):
                    lowest = _dip(guards[guard], slopes[guard], ends[guard], lasts[guard], h)
                    if lowest < dip:
                        dip, dipped = lowest, guard
                bottom = 2.0
                if dip < share:
                    start = guards[dipped]
                    bottom, end = _bottom(p, b, places, m, y, k, new, time, h, torque, dipped, dip, ends, lasts)
                    if end < 0.0:
                        at = _locate(
                            p, b, places, m, y, k, new, time, bottom * h, torque, dipped, start, end, slopes, lasts
                        )
                        share, which = at * bottom, dipped
                if share < 1.0 or bottom < 1.0:
                    _step(p, b, places, m, y, k, new, time, share * h, torque)
                elif which < 0:
                    wanted = h * min(max(0.9 * max(error, 1e-10) ** -0.2, 0.3), 5.0)
                for j in range(_STATES):
                    y[j] = new[j]
                time += share * h
                left = 0.0 if share == 1.0 and h == left else left - share * h
                fastest = max(fastest, abs(y[1]), abs(y[3]))
                if which >= 0:
                    events += 1
                    m = _after(p, b, places, m, y, which, time, torque)
                    if events - before_part > _EVENTS:
                        status = CHATTERING
                if steps > _WORK * n + 10_000:
                    status = TOO_STIFF
        i += 1
    x[:] = y[:4]
    counts[0], counts[1], counts[2], counts[3] = events, steps, i, min(clipped, i)
    return status


@compiled
def _after(
    p: Drive, b: _Beyond, places: FloatArray, m: _Modes, y: FloatArray, which: int, time: float, torque: float
) -> _Modes:
    """Return the modes after the event of a guard; a velocity that fell to 0 is 0."""
    if which == 2:
        m = _reversed(b, m, y, -m.rate)
    elif which == 3:
        m = _through(m, -m.torque)
    else:
        mass = which % 4
        mode, soft = (m.motor, b.soft1) if mass == 0 else (m.load, b.soft2)
        if mode == 0:
            m = _turned(b, m, y, mass, 1 if which < 2 else -1)
        else:
            y[1 + 2 * mass] = 0.0
            m = _turned(b, m, y, mass, -mode) if soft > 0.0 else _settled(p, b, places, m, y, time, torque)
    return m
