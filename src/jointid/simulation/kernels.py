"""The exact simulation of one drive in its sampled loop, compiled.

Between two events the drive is linear and its torque is held, so a whole controller period is one affine map
``x+ = Phi x + G s + c``, exact to rounding; each sliding, sticking and direction mode of the two masses has its
own map. Three layers make it fast:

1. the map, applied once a period;
2. a proof that no mass reversed, stuck or came loose inside the period (`_calm`), a dozen operations;
3. where the proof fails, about one period in a hundred, an event solver (`_travel`): Taylor series of the motion,
   the first event isolated by the signs of its Bernstein coefficients, friction as a set (a mass at rest stays
   at rest while its Coulomb force can hold it).

A rigid joint is the same drive with no spring and a load that nothing pushes: the load sticks for ever.

State ``x`` = motor position, motor velocity, load position, load velocity. Every function called from `run` lives
in this file, because the cache on disk does not notice edits in another one.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.compiled import compiled, inlined
from jointid.data.record import FloatArray

IntArray: TypeAlias = NDArray[np.int64]

# One drive as the kernels see it: a row of coefficients, friction per direction.
M1, M2, K, F12 = 0, 1, 2, 3  # inertias, stiffness, damping of the spring
FV1P, FV1N, FC1P, FC1N = 4, 5, 6, 7  # motor friction: viscous and Coulomb, forwards and backwards
FV2P, FV2N, FC2P, FC2N = 8, 9, 10, 11  # load friction
OFFSET1, OFFSET2 = 12, 13  # constant forces the motor and the load work against
COEFFICIENTS = 14

# How a simulation ended.
FINISHED, DIVERGED, TOO_STIFF, CHATTERING = 0, 1, 2, 3

_MAP = 28  # one mode's map: Phi (columns), G, c, then the proof's four margins
_ORDER = 10  # of the Taylor series; with the step below, its remainder is under the rounding error
_STEP = 0.25  # longest Taylor step, as a fraction of 1/(fastest rate of the drive)
_DEPTH = 40  # of the halvings that isolate a root
_EVENTS = 200  # per period; a physical drive has a handful
_PIECES = 4096  # Taylor steps per period at most: a drive faster than that is no drive under this controller
_WORK = 20  # Taylor steps a simulation may take, per period: bounds the time an absurd candidate can cost


def _bernstein_table() -> FloatArray:
    n = _ORDER
    table = np.zeros((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(i + 1):
            table[i, j] = math.comb(i, j) / math.comb(n, j)
    return table


_BERNSTEIN = _bernstein_table()
_WEIGHT = np.arange(_ORDER + 1.0)
_RECIPROCAL = 1.0 / np.arange(1.0, _ORDER + 1.0)


@inlined
def _viscous(p: FloatArray, mass: int, mode: int) -> float:
    """Viscous coefficient of a mass moving in direction `mode`."""
    first = FV1P if mass == 0 else FV2P
    return p[first] if mode > 0 else p[first + 1]


@inlined
def _coulomb(p: FloatArray, mass: int, mode: int) -> float:
    """Coulomb force on a mass in `mode`, with its sign; 0 for a mass at rest, whose friction is what it must be."""
    first = FC1P if mass == 0 else FC2P
    if mode > 0:
        return p[first]
    return -p[first + 1] if mode < 0 else 0.0


@inlined
def _push(p: FloatArray, x: FloatArray, s: float, mass: int) -> float:
    """Force on a mass from everything but its own friction: `s` is the torque on the motor."""
    spring = p[K] * (x[2] - x[0]) + p[F12] * (x[3] - x[1])
    return s - p[OFFSET1] + spring if mass == 0 else -p[OFFSET2] - spring


@inlined
def _fastest_rate(p: FloatArray) -> float:
    """Bound in 1/s on how fast the drive's own motion can change: spring plus damping."""
    mobility = 1.0 / p[M1] + 1.0 / p[M2]
    viscous = max(abs(p[FV1P]), abs(p[FV1N])) / p[M1] + max(abs(p[FV2P]), abs(p[FV2N])) / p[M2]
    return math.sqrt(p[K] * mobility) + p[F12] * mobility + viscous


@compiled
def _rates(p: FloatArray, m1: int, m2: int) -> FloatArray:
    """The matrix A of x' = A x + b in one mode; a mass at rest has zero rows, so it stands exactly still."""
    a = np.zeros((4, 4))
    if m1 != 0:
        a[0, 1] = 1.0
        a[1, 0] = -p[K] / p[M1]
        a[1, 1] = -(_viscous(p, 0, m1) + p[F12]) / p[M1]
        a[1, 2] = p[K] / p[M1]
        a[1, 3] = p[F12] / p[M1]
    if m2 != 0:
        a[2, 3] = 1.0
        a[3, 0] = p[K] / p[M2]
        a[3, 1] = p[F12] / p[M2]
        a[3, 2] = -p[K] / p[M2]
        a[3, 3] = -(_viscous(p, 1, m2) + p[F12]) / p[M2]
    return a


@compiled
def _fill_map(out: FloatArray, p: FloatArray, m1: int, m2: int, h: float) -> None:
    """Write the map of one mode over `h` seconds, and the margins of its proof (see `_calm`)."""
    a = _rates(p, m1, m2)
    doublings = 0
    step = h
    while _fastest_rate(p) * step > _STEP and doublings < 60:
        step *= 0.5
        doublings += 1
    phi = np.eye(4)
    integral = np.eye(4)  # of exp(A t) over the step, divided by the step
    term = np.eye(4)
    for order in range(1, _ORDER + 5):
        term = _product(a, term) * (step / order)
        phi += term
        integral += term / (order + 1)
    integral *= step
    for _ in range(doublings):
        integral = integral + _product(phi, integral)
        phi = _product(phi, phi)
    f1 = -(p[OFFSET1] + _coulomb(p, 0, m1)) / p[M1] if m1 != 0 else 0.0
    f2 = -(p[OFFSET2] + _coulomb(p, 1, m2)) / p[M2] if m2 != 0 else 0.0
    g = 1.0 / p[M1] if m1 != 0 else 0.0
    for i in range(4):
        for j in range(4):
            out[4 * j + i] = phi[i, j]
        out[16 + i] = integral[i, 1] * g
        out[20 + i] = integral[i, 1] * f1 + integral[i, 3] * f2
    _fill_margins(out, p, m1, m2, h)


@compiled
def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    out = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j] + a[i, 3] * b[3, j]
    return out


@compiled
def _fill_margins(out: FloatArray, p: FloatArray, m1: int, m2: int, h: float) -> None:
    """Write what `_calm` needs: the square of the most a quantity can bend away from its chord, per unit of power.

    While the torque is held, the energy of the rates of change, E = (M1 a1^2 + M2 a2^2 + K (v2 - v1)^2), can only
    fall (it grows by at most `growth` where a candidate has negative viscous friction), so it bounds every second
    derivative over the period by its value at the start; a function stays within h^2/8 max|f''| of its chord.
    """
    viscous1 = abs(_viscous(p, 0, m1))
    viscous2 = abs(_viscous(p, 1, m2))
    root1, root2 = math.sqrt(p[M1]), math.sqrt(p[M2])
    shared = math.sqrt(p[K]) + p[F12] * (1.0 / root1 + 1.0 / root2)
    bend1 = (viscous1 / root1 + shared) / p[M1]  # of the motor's velocity
    bend2 = (viscous2 / root2 + shared) / p[M2]  # of the load's velocity
    push1 = p[K] / root2 + p[F12] * bend2  # of the push on a motor at rest
    push2 = p[K] / root1 + p[F12] * bend1  # of the push on a load at rest
    lowest = min(min(p[FV1P], p[FV1N]) / p[M1], min(p[FV2P], p[FV2N]) / p[M2], 0.0)
    growth = math.exp(min(-lowest * h, 50.0))
    bend = h * h / 8.0 * growth
    out[24] = bend * (bend1 if m1 != 0 else push1)
    out[25] = bend * (bend2 if m2 != 0 else push2)
    out[26] = growth


@inlined
def _root_energy(p: FloatArray, x0: float, x1: float, x2: float, x3: float, s: float, m1: int, m2: int) -> float:
    """Root of the energy of the rates of change (see `_fill_margins`)."""
    spring = p[K] * (x2 - x0) + p[F12] * (x3 - x1)
    f1 = s - p[OFFSET1] + spring - _viscous(p, 0, m1) * x1 - _coulomb(p, 0, m1) if m1 != 0 else 0.0
    f2 = -p[OFFSET2] - spring - _viscous(p, 1, m2) * x3 - _coulomb(p, 1, m2) if m2 != 0 else 0.0
    return math.sqrt(f1 * f1 / p[M1] + f2 * f2 / p[M2] + p[K] * (x3 - x1) ** 2)


@inlined
def _room(forwards: float, backwards: float, start: float, end: float) -> float:
    """Least distance of the push on a mass at rest from the edges of its cone, at both ends of a period."""
    return min(forwards - max(start, end), min(start, end) + backwards)


@inlined
def _calm(
    p: FloatArray,
    m: FloatArray,
    x0: float,
    x1: float,
    x2: float,
    x3: float,
    y0: float,
    y1: float,
    y2: float,
    y3: float,
    s: float,
    m1: int,
    m2: int,
) -> bool:
    """Prove that a period from state `x` to `y` under a held torque `s` has no event; False means "not proved"."""
    root = _root_energy(p, x0, x1, x2, x3, s, m1, m2)
    start, end = p[K] * (x2 - x0) + p[F12] * (x3 - x1), p[K] * (y2 - y0) + p[F12] * (y3 - y1)
    room1, room2 = min(m1 * x1, m1 * y1), min(m2 * x3, m2 * y3)
    if m1 == 0:
        room1 = _room(p[FC1P], p[FC1N], s - p[OFFSET1] + start, s - p[OFFSET1] + end)
    if m2 == 0:
        room2 = _room(p[FC2P], p[FC2N], -p[OFFSET2] - start, -p[OFFSET2] - end)
    if (m1 != 0 and room1 <= 0.0) or (m2 != 0 and room2 <= 0.0):
        return False
    # A rigid joint's load rests in a cone of no width and nothing pushes it: no room, and no bend, is enough.
    return room1 >= m[24] * root and room2 >= m[25] * root


@inlined
def _first_root(c: FloatArray, stack: FloatArray, ends: FloatArray) -> float:
    """Return the first root in (0, 1] of the polynomial sum c[i] t^i; 2.0 if there is none.

    The signs of its Bernstein coefficients bound the number of roots: none changes, no root; one change, one
    root. Otherwise the interval is halved, left half first. A start below zero is a root at 0.
    """
    n = _ORDER
    start, slope = c[0], c[1]
    if start < 0.0:
        return 0.0
    total, size, slopes, slope_size = slope, abs(slope), 0.0, 0.0
    for i in range(2, _ORDER + 1):
        total += c[i]
        size += abs(c[i])
        slopes += _WEIGHT[i] * c[i]
        slope_size += _WEIGHT[i] * abs(c[i])
    if start + 0.5 * (total - size) > 0.0 or slope + 0.5 * (slopes - slope_size) >= 0.0:
        return 2.0  # positive throughout, or rising throughout
    if slope + 0.5 * (slopes + slope_size) < 0.0:  # falling throughout: one root or none
        if start + total >= 0.0:
            return 2.0
        # The root of the leading parabola starts Newton a step ahead.
        return _refine(c, 0.0, 1.0, 2.0 * start / (math.sqrt(max(slope * slope - 4.0 * start * c[2], 0.0)) - slope))
    top = 0
    ends[0, 0], ends[0, 1] = 0.0, 1.0
    for i in range(n + 1):
        value = 0.0
        for j in range(i + 1):
            value += _BERNSTEIN[i, j] * c[j]
        stack[0, i] = value
    while top >= 0:
        changes = 0
        sign = 1.0
        for i in range(n + 1):
            if stack[top, i] * sign < 0.0:
                changes += 1
                sign = -sign
        if changes == 0:
            top -= 1
            continue
        low, high = ends[top, 0], ends[top, 1]
        if changes == 1:
            return _refine(c, low, high, 0.5 * (low + high))
        if top == _DEPTH - 1 or high - low < 1e-12:  # two roots within rounding: it touches zero and comes back
            top -= 1
            continue
        middle = 0.5 * (low + high)
        for i in range(n + 1):  # de Casteljau: the left half goes above, the right half stays, reversed
            stack[top + 1, i] = stack[top, 0]
            for j in range(n - i):
                stack[top, j] = 0.5 * (stack[top, j] + stack[top, j + 1])
        for i in range((n + 1) // 2):
            stack[top, i], stack[top, n - i] = stack[top, n - i], stack[top, i]
        ends[top, 0], ends[top, 1] = middle, high
        ends[top + 1, 0], ends[top + 1, 1] = low, middle
        top += 1
    return 2.0


@inlined
def _refine(c: FloatArray, low: float, high: float, guess: float) -> float:
    """Return the only sign change of the polynomial in (low, high]: Newton, kept inside a shrinking bracket."""
    t = guess if low < guess < high else 0.5 * (low + high)
    for _ in range(100):
        value = c[_ORDER]
        slope = 0.0
        for i in range(1, _ORDER + 1):
            slope = slope * t + value
            value = value * t + c[_ORDER - i]
        if value < 0.0:
            high = t
        else:
            low = t
        new = t - value / slope if slope != 0.0 else t + 1.0
        if abs(new - t) <= 1e-9:  # Newton squares the error: the next step would be under the rounding
            return min(max(new, low), high)
        t = new if low < new < high else 0.5 * (low + high)
        if high - low <= 1e-16:
            break
    return t


@inlined
def _settled(p: FloatArray, push: float, mass: int) -> int:
    """Return the mode of a mass at rest: 0 while its Coulomb force can hold the push, else the push's direction."""
    first = FC1P if mass == 0 else FC2P
    if push > p[first]:
        return 1
    return -1 if push < -p[first + 1] else 0


@inlined
def _series(
    c: FloatArray, p: FloatArray, x: FloatArray, s: float, m1: int, m2: int, h: float, loose1: bool, loose2: bool
) -> None:
    """Fill c[state, order] with the Taylor series of the motion over a step of `h`, time counted in steps.

    A mass that has just come loose (`loose`) has, exactly, no velocity and no acceleration: rounding must not
    give it one, or the sign of the motion that follows would be noise.
    """
    for i in range(4):
        c[i, 0] = x[i]
    moves1, moves2 = float(abs(m1)), float(abs(m2))
    mobility1, mobility2 = moves1 / p[M1], moves2 / p[M2]
    fv1, fv2 = _viscous(p, 0, m1), _viscous(p, 1, m2)
    force1 = s - p[OFFSET1] - _coulomb(p, 0, m1)
    force2 = -p[OFFSET2] - _coulomb(p, 1, m2)
    for k in range(_ORDER):
        spring = p[K] * (c[2, k] - c[0, k]) + p[F12] * (c[3, k] - c[1, k])
        step = h * _RECIPROCAL[k]
        c[0, k + 1] = c[1, k] * (step * moves1)
        c[2, k + 1] = c[3, k] * (step * moves2)
        c[1, k + 1] = (force1 + spring - fv1 * c[1, k]) * (step * mobility1)
        c[3, k + 1] = (force2 - spring - fv2 * c[3, k]) * (step * mobility2)
        force1 = 0.0
        force2 = 0.0
        if k == 0 and loose1:
            c[1, 1] = 0.0
        if k == 0 and loose2:
            c[3, 1] = 0.0


@inlined
def _next_event(
    c: FloatArray,
    g: FloatArray,
    stack: FloatArray,
    ends: FloatArray,
    p: FloatArray,
    s: float,
    mass: int,
    mode: int,
    known: int,
) -> tuple[float, int]:
    """Return when a mass has its next event (2.0: not in this step), in steps, and the mode it may come loose to.

    `known` counts the leading coefficients that are zero by construction: a mass that starts from rest, or one at
    the very edge of its cone; they are divided out, so that the root at the start is not found again.
    """
    if mode != 0:
        velocity = 1 + 2 * mass
        size = 0.0
        for i in range(_ORDER + 1):
            g[i] = mode * c[velocity, i]
            size += abs(g[i])
        if known == 0:
            if 2.0 * g[0] > size:  # too fast to stop within the step
                return 2.0, 0
        else:
            if known == 2 and g[2] <= 0.0:  # came loose at the edge but is pushed back: it never moved
                return 0.0, 0
            _divide_out(g, known)
        return _first_root(g, stack, ends), 0
    first = FC1P if mass == 0 else FC2P
    sign = 1.0 if mass == 0 else -1.0  # of the spring's force
    size = 0.0
    for i in range(_ORDER + 1):
        c[4, i] = sign * (p[K] * (c[2, i] - c[0, i]) + p[F12] * (c[3, i] - c[1, i]))
        size += abs(c[4, i])
    size -= abs(c[4, 0])
    c[4, 0] += s - p[OFFSET1] if mass == 0 else -p[OFFSET2]
    best, loose = 2.0, 0
    for direction in (1, -1):
        room = (p[first] if direction > 0 else p[first + 1]) - direction * c[4, 0]
        if room > size and direction != known:
            continue
        for i in range(1, _ORDER + 1):
            g[i] = -direction * c[4, i]
        g[0] = room
        if direction == known:  # at the edge: only a push that grows leads out
            _divide_out(g, 1)
        moment = _first_root(g, stack, ends)
        if moment < best:
            best, loose = moment, direction
    return best, loose


@inlined
def _divide_out(g: FloatArray, known: int) -> None:
    """Divide a polynomial by t^known."""
    for i in range(_ORDER + 1 - known):
        g[i] = g[i + known]
    for i in range(_ORDER + 1 - known, _ORDER + 1):
        g[i] = 0.0


@inlined
def _travel(
    p: FloatArray,
    x: FloatArray,
    modes: IntArray,
    s: float,
    h: float,
    longest: float,
    c: FloatArray,
    g: FloatArray,
    stack: FloatArray,
    ends: FloatArray,
) -> tuple[int, int]:
    """Move `x` over `h` seconds under a held torque `s` with every event located; return events and Taylor steps.

    The number of events is negative when there are more than a physical drive can have.
    """
    m1 = _settled(p, _push(p, x, s, 0), 0) if x[1] == 0.0 else modes[0]
    m2 = _settled(p, _push(p, x, s, 1), 1) if x[3] == 0.0 else modes[1]
    known1 = 1 if m1 != 0 and x[1] == 0.0 else 0
    known2 = 1 if m2 != 0 and x[3] == 0.0 else 0
    events, steps = 0, 0
    done = 0.0
    while done < h:
        remaining = h - done
        pieces = 1 if remaining <= longest else math.ceil(remaining / longest)
        step = remaining / pieces
        steps += 1
        _series(c, p, x, s, m1, m2, step, m1 != 0 and known1 == 2, m2 != 0 and known2 == 2)
        t1, loose1 = _next_event(c, g, stack, ends, p, s, 0, m1, known1)
        t2, loose2 = _next_event(c, g, stack, ends, p, s, 1, m2, known2)
        t = min(t1, t2, 1.0)
        if t > 0.0:
            for i in range(4):
                value = c[i, _ORDER]
                for j in range(_ORDER - 1, -1, -1):
                    value = value * t + c[i, j]
                x[i] = value
            done = h if pieces == 1 and t == 1.0 else done + t * step
            known1, known2 = 0, 0
        if t1 <= 1.0 and t1 <= t2:
            m1, known1 = _after_event(p, x, s, 0, m1, loose1, known1)
            events += 1
        elif t2 <= 1.0:
            m2, known2 = _after_event(p, x, s, 1, m2, loose2, known2)
            events += 1
        if events > _EVENTS:
            events = -1
            break
    modes[0] = m1
    modes[1] = m2
    return events, steps


@inlined
def _after_event(
    p: FloatArray, x: FloatArray, s: float, mass: int, mode: int, loose: int, known: int
) -> tuple[int, int]:
    """Return the mode of a mass after its event, and what is then known of it (see `_next_event`)."""
    if mode == 0:
        return loose, 2
    if known == 2:  # came loose and was pushed back at once: at rest, at that edge of its cone
        return 0, mode
    x[1 + 2 * mass] = 0.0
    after = _settled(p, _push(p, x, s, mass), mass)
    if after == mode:  # stopped where rounding says it may go on: at rest, at that edge of its cone
        return 0, mode
    return after, 1 if after != 0 else 0


@inlined
def _small_law(A: FloatArray, Bq: FloatArray, Be: FloatArray, C: FloatArray, nz: int) -> tuple[float, ...]:
    """Return the coefficients of a feedback of at most two states as scalars, which stay in registers."""
    if nz == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if nz == 1:
        return C[0], 0.0, A[0, 0], 0.0, 0.0, 0.0, Bq[0], 0.0, Be[0], 0.0
    return C[0], C[1], A[0, 0], A[0, 1], A[1, 0], A[1, 1], Bq[0], Bq[1], Be[0], Be[1]


@inlined
def _acting(command: float, lag: int, u: FloatArray, post: FloatArray, before: float, k: int) -> float:
    """Return the torque that acts in period `k`, where `command` is computed."""
    if lag == 0:
        return command + post[k]
    return u[k - lag] + post[k - lag] if k >= lag else before


@compiled
def _rest(
    p: FloatArray,
    lag: int,
    z: FloatArray,
    A: FloatArray,
    Bq: FloatArray,
    Be: FloatArray,
    C: FloatArray,
    D: float,
    limit: float,
    w: FloatArray,
    post: FloatArray,
    before: float,
    x: FloatArray,
    k: int,
    u: FloatArray,
    states: FloatArray,
) -> tuple[int, int]:
    """Simulate from period `k` while both masses stand still; return as `_glide`."""
    n, nz = w.size, z.size
    c0, c1, a00, a01, a10, a11, b0, b1, e0, e1 = _small_law(A, Bq, Be, C, nz)
    z0 = z[0] if nz > 0 else 0.0
    z1 = z[1] if nz > 1 else 0.0
    spring = p[K] * (x[2] - x[0])
    held = -p[FC2N] <= -p[OFFSET2] - spring <= p[FC2P]
    lowest, highest = p[OFFSET1] - spring - p[FC1N], p[OFFSET1] - spring + p[FC1P]
    keep = states.shape[0] > 0
    clipped = 0
    q = x[0]
    while held and k < n:
        raw = (w[k] + (c0 * z0 + c1 * z1)) + D * q
        command = min(max(raw, -limit), limit)
        if not lowest <= _acting(command, lag, u, post, before, k) <= highest:
            break
        u[k] = command
        if keep:
            states[k, 0], states[k, 1], states[k, 2], states[k, 3] = q, x[1], x[2], x[3]
        z0, z1 = (a00 * z0 + a01 * z1) + b0 * q, (a10 * z0 + a11 * z1) + b1 * q
        if command != raw:
            clipped += 1
            z0 += e0 * (command - raw)
            z1 += e1 * (command - raw)
        k += 1
    if nz > 0:
        z[0] = z0
    if nz > 1:
        z[1] = z1
    return k, clipped


@compiled
def _glide(
    p: FloatArray,
    m: FloatArray,
    m1: int,
    m2: int,
    lag: int,
    z: FloatArray,
    A: FloatArray,
    Bq: FloatArray,
    Be: FloatArray,
    C: FloatArray,
    D: float,
    limit: float,
    w: FloatArray,
    post: FloatArray,
    before: float,
    x: FloatArray,
    k: int,
    u: FloatArray,
    states: FloatArray,
) -> tuple[int, int]:
    """Simulate from period `k` while nothing happens; return the first period not simulated, and those at the limit.

    `_calm` with its energy replaced by a running bound: the root of the energy grows by at most
    |change of torque| / sqrt(M1) a period, three operations. For a torque that acts over whole periods, and a
    controller with at most two states.
    """
    n, nz = w.size, z.size
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    p00, p10, p20, p30 = m[0], m[1], m[2], m[3]
    p01, p11, p21, p31 = m[4], m[5], m[6], m[7]
    p02, p12, p22, p32 = m[8], m[9], m[10], m[11]
    p03, p13, p23, p33 = m[12], m[13], m[14], m[15]
    g0, g1, g2, g3 = m[16], m[17], m[18], m[19]
    f0, f1, f2, f3 = m[20], m[21], m[22], m[23]
    bend1, bend2, growth = m[24], m[25], m[26]
    c0, c1, a00, a01, a10, a11, b0, b1, e0, e1 = _small_law(A, Bq, Be, C, nz)
    z0 = z[0] if nz > 0 else 0.0
    z1 = z[1] if nz > 1 else 0.0
    mobility = 1.0 / math.sqrt(p[M1]) if m1 != 0 else 0.0
    keep = states.shape[0] > 0
    resting = m1 == 0 or m2 == 0
    d1, d2 = float(m1), float(m2)
    start1, start2 = d1 * x1, d2 * x3
    least1, least2 = 1e-300 * abs(d1), 1e-300 * abs(d2)  # a mass that moves must not stand at either end
    clipped = 0
    bound = np.inf  # evaluated exactly in the first period
    last = 0.0
    while k < n:
        raw = (w[k] + (c0 * z0 + c1 * z1)) + D * x0
        command = min(max(raw, -limit), limit)
        s = _acting(command, lag, u, post, before, k)
        y0 = ((p00 * x0 + p01 * x1) + (p02 * x2 + (p03 * x3 + f0))) + g0 * s
        y1 = ((p10 * x0 + p11 * x1) + (p12 * x2 + (p13 * x3 + f1))) + g1 * s
        y2 = ((p20 * x0 + p21 * x1) + (p22 * x2 + (p23 * x3 + f2))) + g2 * s
        y3 = ((p30 * x0 + p31 * x1) + (p32 * x2 + (p33 * x3 + f3))) + g3 * s
        bound = bound * growth + abs(s - last) * mobility
        last = s
        end1, end2 = d1 * y1, d2 * y3
        room1, room2 = min(start1, end1), min(start2, end2)
        if resting:
            spring, end = p[K] * (x2 - x0) + p[F12] * (x3 - x1), p[K] * (y2 - y0) + p[F12] * (y3 - y1)
            if m1 == 0:
                room1 = _room(p[FC1P], p[FC1N], s - p[OFFSET1] + spring, s - p[OFFSET1] + end)
            if m2 == 0:
                room2 = _room(p[FC2P], p[FC2N], -p[OFFSET2] - spring, -p[OFFSET2] - end)
        if not (room1 >= bend1 * bound + least1 and room2 >= bend2 * bound + least2):
            bound = growth * _root_energy(p, x0, x1, x2, x3, s, m1, m2)
            if not (room1 >= bend1 * bound + least1 and room2 >= bend2 * bound + least2):
                break
        start1, start2 = end1, end2
        u[k] = command
        if keep:
            states[k, 0], states[k, 1], states[k, 2], states[k, 3] = x0, x1, x2, x3
        z0, z1 = (a00 * z0 + a01 * z1) + b0 * x0, (a10 * z0 + a11 * z1) + b1 * x0
        if command != raw:
            clipped += 1
            z0 += e0 * (command - raw)
            z1 += e1 * (command - raw)
        x0, x1, x2, x3 = y0, y1, y2, y3
        k += 1
    x[0], x[1], x[2], x[3] = x0, x1, x2, x3
    if nz > 0:
        z[0] = z0
    if nz > 1:
        z[1] = z1
    return k, clipped


@compiled
def run(
    p: FloatArray,
    lengths: FloatArray,
    lags: IntArray,
    z: FloatArray,
    A: FloatArray,
    Bq: FloatArray,
    Be: FloatArray,
    C: FloatArray,
    D: float,
    limit: float,
    w: FloatArray,
    post: FloatArray,
    before: float,
    x: FloatArray,
    far: float,
    u: FloatArray,
    states: FloatArray,
    counts: IntArray,
) -> int:
    """Simulate one loop; fill `u` and `states` and return how it ended.

    Args:
        p: (COEFFICIENTS,) the drive.
        lengths: (parts,) seconds of each part of a controller period, first to last.
        lags: (parts,) how many periods ago the torque that acts in each part was computed.
        z: (nz,) state of the controller's feedback, overwritten.
        A: (nz, nz) of the feedback ``u = clip(w + C z + D q)``, ``z+ = A z + Bq q + Be (u - before clipping)``.
        Bq: (nz,), from the position.
        Be: (nz,), from what the limit cut off.
        C: (nz,).
        D: direct gain from the position.
        limit: of the controller's output.
        w: (periods,) response of the controller to its reference and to what is added before the limit.
        post: (periods,) what is added after the limit.
        before: torque that acted before the first period.
        x: (4,) initial state, overwritten.
        far: a motor position beyond which the loop counts as diverged.
        u: (periods,) out, controller output after its limit.
        states: (periods * parts, 4) out, states at the start of every part; or (0, 4).
        counts: (4,) out: events, Taylor steps, periods simulated, periods at the limit.
    """
    n, parts, nz = w.size, lengths.size, z.size
    maps = np.empty(parts * 9 * _MAP)
    filled = np.zeros(9, dtype=np.bool_)
    c = np.empty((5, _ORDER + 1))
    g = np.empty(_ORDER + 1)
    stack = np.empty((_DEPTH, _ORDER + 1))
    ends = np.empty((_DEPTH, 2))
    new = np.empty(nz)
    modes = np.empty(2, dtype=np.int64)
    modes[0] = 0 if x[1] == 0.0 else (1 if x[1] > 0.0 else -1)
    modes[1] = 0 if x[3] == 0.0 else (1 if x[3] > 0.0 else -1)
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    longest = _STEP / _fastest_rate(p)
    if np.max(lengths) > _PIECES * longest:
        return TOO_STIFF
    keep = states.shape[0] > 0
    events, steps, clipped = 0, 0, 0
    status = FINISHED
    k = 0
    while k < n and status == FINISHED:
        m1, m2 = modes[0], modes[1]
        if parts == 1 and nz <= 2:
            x[0], x[1], x[2], x[3] = x0, x1, x2, x3
            if m1 == 0 and m2 == 0:
                k, limited = _rest(p, lags[0], z, A, Bq, Be, C, D, limit, w, post, before, x, k, u, states)
            else:
                mode = 3 * m1 + m2 + 4
                m = maps[mode * _MAP : (mode + 1) * _MAP]
                if not filled[mode]:
                    filled[mode] = True
                    _fill_map(m, p, m1, m2, lengths[0])
                k, limited = _glide(p, m, m1, m2, lags[0], z, A, Bq, Be, C, D, limit, w, post, before, x, k, u, states)
                x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
            clipped += limited
            if k == n:
                break
        if not abs(x0) <= far:
            status = DIVERGED
            break
        raw = w[k] + D * x0
        for i in range(nz):
            raw += C[i] * z[i]
        command = min(max(raw, -limit), limit)
        for i in range(nz):
            value = Bq[i] * x0 + Be[i] * (command - raw)
            for j in range(nz):
                value += A[i, j] * z[j]
            new[i] = value
        for i in range(nz):
            z[i] = new[i]
        if command != raw:
            clipped += 1
        u[k] = command
        for part in range(parts):
            if keep:
                row = k * parts + part
                states[row, 0], states[row, 1], states[row, 2], states[row, 3] = x0, x1, x2, x3
            source = k - lags[part]
            s = u[source] + post[source] if source >= 0 else before
            m1, m2 = modes[0], modes[1]
            mode = 3 * m1 + m2 + 4
            if not filled[mode]:
                filled[mode] = True
                for other in range(parts):
                    _fill_map(
                        maps[(9 * other + mode) * _MAP : (9 * other + mode + 1) * _MAP],
                        p,
                        m1,
                        m2,
                        lengths[other],
                    )
            m = maps[(9 * part + mode) * _MAP : (9 * part + mode + 1) * _MAP]
            y0 = ((m[0] * x0 + m[4] * x1) + (m[8] * x2 + (m[12] * x3 + m[20]))) + m[16] * s
            y1 = ((m[1] * x0 + m[5] * x1) + (m[9] * x2 + (m[13] * x3 + m[21]))) + m[17] * s
            y2 = ((m[2] * x0 + m[6] * x1) + (m[10] * x2 + (m[14] * x3 + m[22]))) + m[18] * s
            y3 = ((m[3] * x0 + m[7] * x1) + (m[11] * x2 + (m[15] * x3 + m[23]))) + m[19] * s
            if _calm(p, m, x0, x1, x2, x3, y0, y1, y2, y3, s, m1, m2):
                x0, x1, x2, x3 = y0, y1, y2, y3
            else:
                x[0], x[1], x[2], x[3] = x0, x1, x2, x3
                found, used = _travel(p, x, modes, s, lengths[part], longest, c, g, stack, ends)
                x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
                events += max(found, 0)
                steps += used
                if found < 0:
                    status = CHATTERING
                elif steps > _WORK * n + 10_000:
                    status = TOO_STIFF
        k += 1
    x[0], x[1], x[2], x[3] = x0, x1, x2, x3
    counts[0], counts[1], counts[2], counts[3] = events, steps, k, clipped
    return status
