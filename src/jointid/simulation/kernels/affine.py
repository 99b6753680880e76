"""The affine maps of a joint whose laws are straight lines, and how far it glides by them, compiled.

While no mass stops or comes loose such a joint is linear, and its torque is held over a part of a period. A part is
then one affine map, exact to rounding; each sliding, sticking and direction mode of the two masses has its own. A map
is applied where chords prove that nothing happens in between. `kernels.engine` goes through the other parts, about one
in a thousand, step by step.

The state is motor position, motor velocity, load position, load velocity; a rigid joint has a load that nothing pushes.
Functions pass numbers and tuples rather than arrays: Numba counts references to an array at each call, with an atomic
operation as dear as thirty others.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.control import SmallLaw, control_any
from jointid.simulation.kernels.tables import (
    COULOMB,
    COULOMB_BACK,
    DAMPING,
    FREE,
    INERTIA,
    OFFSET,
    STIFFNESS,
    VISCOUS,
    VISCOUS_BACK,
    IntArray,
    SampledLoop,
)

State: TypeAlias = tuple[float, float, float, float]

INPUTS = 5  # of a map: motor velocity, stretch, load velocity, torque, constant forces
MODES = 9
_ORDER = 10  # of the series of the motion
_STRIDE = 0.25  # rad of the fastest motion in a series: its remainder is at most 30 times the rounding error
_HELD = 1e-300  # what a cone without width holds: nothing that is pushed


class Drive(NamedTuple):
    """The numbers of a joint, friction and constant force of motor and load."""

    inertia1: float
    inertia2: float
    stiffness: float
    damping: float
    viscous1: float
    viscous1_back: float
    coulomb1: float
    coulomb1_back: float
    offset1: float
    viscous2: float
    viscous2_back: float
    coulomb2: float
    coulomb2_back: float
    offset2: float


@inline_kernel
def drive_of(mass: FloatArray, spring: FloatArray) -> Drive:
    """Return the joint of masses and springs in their first bands and pieces."""
    inertia2, stiffness, damping = 1.0, 0.0, 0.0
    viscous2, viscous2_back, coulomb2, coulomb2_back, offset2 = 0.0, 0.0, 0.0, 0.0, 0.0
    if mass.shape[0] > 1:
        inertia2, stiffness, damping = mass[1, INERTIA], spring[0, STIFFNESS], spring[0, DAMPING]
        viscous2, viscous2_back, offset2 = mass[1, VISCOUS], mass[1, VISCOUS_BACK], mass[1, OFFSET]
        coulomb2, coulomb2_back = mass[1, COULOMB], mass[1, COULOMB_BACK]
    return Drive(
        mass[0, INERTIA], inertia2, stiffness, damping, mass[0, VISCOUS], mass[0, VISCOUS_BACK], mass[0, COULOMB],
        mass[0, COULOMB_BACK], mass[0, OFFSET], viscous2, viscous2_back, coulomb2, coulomb2_back, offset2,
    )  # fmt: skip


@inline_kernel
def read_state(q: FloatArray, v: FloatArray) -> State:
    """Return the state of one or two masses."""
    return (q[0], v[0], q[1], v[1]) if q.size > 1 else (q[0], v[0], q[0], 0.0)


@inline_kernel
def write_state(x: State, q: FloatArray, v: FloatArray) -> None:
    """Write the state of one or two masses."""
    q[0], v[0] = x[0], x[1]
    if q.size > 1:
        q[1], v[1] = x[2], x[3]


@inline_kernel
def fill_rates(p: Drive, m1: int, m2: int, share1: float, share2: float, torque: float, rates: FloatArray) -> None:
    """Write the accelerations of motor and load by each input, (2, INPUTS).

    They are linear in the joint's numbers but for the inertias: shares are one over these, and 0 of a mass at rest. The
    torque is 1; or 0 where the numbers are derivatives.
    """
    viscous1, force1 = (p.viscous1, -p.coulomb1) if m1 > 0 else (p.viscous1_back, p.coulomb1_back)
    viscous2, force2 = (p.viscous2, -p.coulomb2) if m2 > 0 else (p.viscous2_back, p.coulomb2_back)
    rates[0, 0], rates[0, 1], rates[0, 2] = -(viscous1 + p.damping) * share1, p.stiffness * share1, p.damping * share1
    rates[0, 3], rates[0, 4] = torque * share1, (force1 - p.offset1) * share1
    rates[1, 0], rates[1, 1], rates[1, 2] = p.damping * share2, -p.stiffness * share2, -(viscous2 + p.damping) * share2
    rates[1, 3], rates[1, 4] = 0.0, (force2 - p.offset2) * share2


@inline_kernel
def flow(rates: FloatArray, h: float, x: State, s: float, steady: float) -> State:
    """Return the state after `h` seconds in a mode, by a Taylor series; constant forces act for a `steady` of 1."""
    x0, x1, x2, x3 = x
    v1, stretch, v2, first = x1, x2 - x0, x3, 1.0
    for k in range(1, _ORDER + 1):
        share = h / k
        push1, push2 = first * (rates[0, 3] * s + rates[0, 4] * steady), first * (rates[1, 4] * steady)
        x0, x2, apart = x0 + share * v1, x2 + share * v2, v2 - v1
        a1 = rates[0, 0] * v1 + rates[0, 1] * stretch + (rates[0, 2] * v2 + push1)
        a2 = rates[1, 0] * v1 + rates[1, 1] * stretch + (rates[1, 2] * v2 + push2)
        v1, stretch, v2, first = share * a1, share * apart, share * a2, 0.0
        x1, x3 = x1 + v1, x3 + v2
    return x0, x1, x2, x3


@inline_kernel
def _fill_bends(p: Drive, m1: int, m2: int, h: float, bends: FloatArray) -> None:
    """Write how far what must stay positive can bend from its chord in a part, per root energy; and its growth.

    While the torque is held, the energy of the rates of change, E = M1 a1^2 + M2 a2^2 + K (v2 - v1)^2, can only
    fall (its root grows by at most `growth` where a candidate has negative viscous friction), so it bounds every
    second derivative over the part by its value at the start; a function stays within h^2/8 max|f''| of its chord.
    The root energy is sqrt(M1 E), so that a change of the torque changes it by no more than itself.
    """
    root1, root2 = math.sqrt(p.inertia1), math.sqrt(p.inertia2)
    viscous1, viscous2 = p.viscous1 if m1 > 0 else p.viscous1_back, p.viscous2 if m2 > 0 else p.viscous2_back
    shared = math.sqrt(p.stiffness) + p.damping * (1.0 / root1 + 1.0 / root2)
    bend1 = (abs(viscous1) / root1 + shared) / p.inertia1  # of the motor's velocity
    bend2 = (abs(viscous2) / root2 + shared) / p.inertia2  # of the load's velocity
    push1 = p.stiffness / root2 + p.damping * bend2  # of the push on a motor at rest
    push2 = p.stiffness / root1 + p.damping * bend1  # of the push on a load at rest
    growth = math.exp(min(-min(viscous1 / p.inertia1, viscous2 / p.inertia2, 0.0) * h, 50.0))
    bend = h * h / 8.0 / root1 * growth if m1 != 0 or m2 != 0 else 0.0  # where nothing moves, nothing bends
    bends[0], bends[1] = bend * (bend1 if m1 != 0 else push1), bend * (bend2 if m2 != 0 else push2)
    bends[2] = growth


@inline_kernel
def unit_move(rates: FloatArray, m1: int, m2: int, i: int, h: float) -> State:
    """Return by how much a unit of an input changes the positions in `h` seconds, and the velocities at their end."""
    begin, torque, steady = 1.0 if i == 1 else 0.0, 1.0 if i == 3 else 0.0, 1.0 if i == 4 else 0.0
    v1, v2 = 1.0 if i == 0 and m1 != 0 else 0.0, 1.0 if i == 2 and m2 != 0 else 0.0
    rate = math.sqrt(abs(rates[0, 1]) + abs(rates[1, 1])) + abs(rates[0, 0]) + abs(rates[1, 2])
    pieces = max(math.ceil(rate * h / _STRIDE), 1)
    x = flow(rates, h / pieces, (0.0, v1, begin, v2), torque, steady)
    for _ in range(1, pieces):
        x = flow(rates, h / pieces, x, torque, steady)
    return x[0], x[1], x[2] - begin, x[3]


@compile_kernel
def fill_mode(
    p: Drive, mode: int, lengths: FloatArray, rates: FloatArray, moves: FloatArray, bends: FloatArray
) -> None:
    """Fill what `glide` and `ride` read of a mode.

    These are `rates`, (MODES, 2, INPUTS), accelerations of motor and load by each input; `moves`, (parts * MODES,
    INPUTS, 4), see `unit_move`; and `bends`, (parts * MODES, 3).
    """
    m1, m2 = mode // 3 - 1, mode % 3 - 1
    fill_rates(p, m1, m2, abs(m1) / p.inertia1, abs(m2) / p.inertia2, 1.0, rates[mode])
    for part in range(lengths.size):
        b = part * MODES + mode
        _fill_bends(p, m1, m2, lengths[part], bends[b])
        for i in range(INPUTS):
            x = unit_move(rates[mode], m1, m2, i, lengths[part])
            moves[b, i, 0], moves[b, i, 1], moves[b, i, 2], moves[b, i, 3] = x


@inline_kernel
def enter_mode(
    p: Drive, modes: FloatArray, v: FloatArray, loose: float, lengths: FloatArray, filled: NDArray[np.bool_],
    rates: FloatArray, moves: FloatArray, bends: FloatArray,
) -> int:  # fmt: skip
    """Return the number of the mode of two masses, and fill what is read of it when it is met.

    One that no friction holds moves on as it does, at rest `loose`.
    """
    m1, m2 = modes[0], modes[1] if v.size > 1 else 0.0
    if m1 == FREE:
        m1 = math.copysign(1.0, v[0]) if v[0] != 0.0 else loose
    if m2 == FREE:
        m2 = math.copysign(1.0, v[1]) if v[1] != 0.0 else loose
    mode = int(3.0 * m1 + m2) + 4
    if not filled[mode]:
        filled[mode] = True
        fill_mode(p, mode, lengths, rates, moves, bends)
    return mode


@inline_kernel
def _rooms(
    p: Drive, m1: int, m2: int, s: float, spring: float, end: float, room1: float, room2: float
) -> tuple[float, float]:
    """Return the rooms of masses in motion, which are given, and of those at rest in their cones, at both ends."""
    least, most = min(spring, end), max(spring, end)
    if m1 == 0:
        room1 = _HELD + min(p.coulomb1 - (s - p.offset1 + most), p.coulomb1_back + (s - p.offset1 + least))
    if m2 == 0:
        room2 = _HELD + min(p.coulomb2 + (p.offset2 + least), p.coulomb2_back - (p.offset2 + most))
    return room1, room2


@inline_kernel
def _cross(
    p: Drive, r: FloatArray, m: FloatArray, bends: FloatArray, mode: int, part: int, x: State, s: float
) -> tuple[bool, float, State]:
    """Return whether nothing happens in a part under a held torque, the root energy as it begins, and its end.

    See `_fill_bends`. False means "not proved".
    """
    m1, m2, a, b = mode // 3 - 1, mode % 3 - 1, np.uint64(mode), np.uint64(part * MODES + mode)
    x0, v1, x2, v2 = x
    stretch, apart = x2 - x0, v2 - v1
    a1 = (r[a, 0, 0] * v1 + r[a, 0, 1] * stretch) + (r[a, 0, 2] * v2 + r[a, 0, 3] * s) + r[a, 0, 4]
    a2 = (r[a, 1, 0] * v1 + r[a, 1, 1] * stretch) + (r[a, 1, 2] * v2 + r[a, 1, 4])
    y0 = (x0 + (m[b, 0, 0] * v1 + m[b, 2, 0] * v2)) + ((m[b, 4, 0] + m[b, 1, 0] * stretch) + m[b, 3, 0] * s)
    y1 = (m[b, 0, 1] * v1 + m[b, 2, 1] * v2) + ((m[b, 4, 1] + m[b, 1, 1] * stretch) + m[b, 3, 1] * s)
    y2 = (x2 + (m[b, 0, 2] * v1 + m[b, 2, 2] * v2)) + ((m[b, 4, 2] + m[b, 1, 2] * stretch) + m[b, 3, 2] * s)
    y3 = (m[b, 0, 3] * v1 + m[b, 2, 3] * v2) + ((m[b, 4, 3] + m[b, 1, 3] * stretch) + m[b, 3, 3] * s)
    spring, end = p.stiffness * stretch + p.damping * apart, p.stiffness * (y2 - y0) + p.damping * (y3 - y1)
    root = math.sqrt(p.inertia1 * (p.inertia1 * a1 * a1 + p.inertia2 * a2 * a2 + p.stiffness * apart * apart))
    room1, room2 = _rooms(p, m1, m2, s, spring, end, min(m1 * v1, m1 * y1), min(m2 * v2, m2 * y3))
    return room1 > bends[b, 0] * root and room2 > bends[b, 1] * root, root, (y0, y1, y2, y3)


@inline_kernel
def _follow_chords(
    p: Drive, law: SmallLaw, m: FloatArray, bends: FloatArray, mode: int, states: FloatArray, kept: NDArray[np.int16],
    lag: int, before: float, w: FloatArray, post: FloatArray, u: FloatArray, excess: FloatArray, x: State,
    z: tuple[float, float], bound: float, last: float, k: int,
) -> tuple[int, int, State, tuple[float, float]]:  # fmt: skip
    """Simulate from period `k` while chords show that nothing happens.

    Return the first period that is left to `_cross`, where the controller has already run; how often it was at its
    limit; and both states. A chord needs the root energy: `bound` bounds it in a period before under the torque `last`,
    and it grows by at most the change of the torque. For a torque that acts over whole periods, and a controller with
    at most two states.
    """
    begin, clipped, m1, m2 = k, 0, mode // 3 - 1, mode % 3 - 1
    a00, a01, a10, a11, b0, b1, c0, c1, cut0, cut1, d, limit = law
    x0, x1, x2, x3 = x
    z0, z1 = z
    p00, p10, p20, p30 = m[mode, 0, 0], m[mode, 0, 1], m[mode, 0, 2], m[mode, 0, 3]
    p01, p11, p21, p31 = m[mode, 1, 0], m[mode, 1, 1], m[mode, 1, 2], m[mode, 1, 3]
    p02, p12, p22, p32 = m[mode, 2, 0], m[mode, 2, 1], m[mode, 2, 2], m[mode, 2, 3]
    g0, g1, g2, g3 = m[mode, 3, 0], m[mode, 3, 1], m[mode, 3, 2], m[mode, 3, 3]
    f0, f1, f2, f3 = m[mode, 4, 0], m[mode, 4, 1], m[mode, 4, 2], m[mode, 4, 3]
    chord1, chord2 = bends[mode, 0], bends[mode, 1]
    bound = bound if bends[mode, 2] == 1.0 else np.inf  # what grows is bounded over one period alone
    resting, keep = m1 == 0 or m2 == 0, states.shape[0] > 0
    # Velocities in the direction of their mode are positive while nothing happens.
    d1, d2 = -1.0 if m1 < 0 else 1.0, -1.0 if m2 < 0 else 1.0
    x1, p00, p20, p11, p31, g1, f1 = d1 * x1, d1 * p00, d1 * p20, d1 * p11, d2 * p31, d1 * g1, d1 * f1
    x3, p02, p22, p12, p30, g3, f3 = d2 * x3, d2 * p02, d2 * p22, d1 * d2 * p12, d1 * d2 * p30, d2 * g3, d2 * f3
    stretch = x2 - x0
    while k < w.size:
        at = np.uint64(k)  # Numba looks for negative indices among the signed
        raw = (w[at] + d * x0) + (c0 * z0 + c1 * z1)
        command = raw
        next0 = b0 * x0 + (a00 * z0 + a01 * z1)
        next1 = b1 * x0 + (a10 * z0 + a11 * z1)
        if not abs(raw) <= limit:  # a branch: the limit stays out of the chain of operations from state to state
            command = min(max(raw, -limit), limit)
            cut, clipped = command - raw, clipped + 1
            next0, next1 = next0 + cut0 * cut, next1 + cut1 * cut
            if excess.shape[0] > 0:
                excess[at, 0] = cut
        z0, z1 = next0, next1
        u[at] = command
        s = before
        if lag == 0:
            s = command + post[at]
        elif k >= lag:
            s = u[np.uint64(k - lag)] + post[np.uint64(k - lag)]
        if keep:
            states[at, 0], states[at, 1] = x0, d1 * x1
            states[at, 2], states[at, 3] = x2, d2 * x3
        y0 = (x0 + (p00 * x1 + p02 * x3)) + ((f0 + p01 * stretch) + g0 * s)
        y1 = (p10 * x1 + p12 * x3) + ((f1 + p11 * stretch) + g1 * s)
        y2 = (x2 + (p20 * x1 + p22 * x3)) + ((f2 + p21 * stretch) + g2 * s)
        y3 = (p30 * x1 + p32 * x3) + ((f3 + p31 * stretch) + g3 * s)
        bound += abs(s - last)
        last = s
        room1, room2 = min(x1, y1), min(x3, y3)
        if resting:
            spring = p.stiffness * stretch + p.damping * (d2 * x3 - d1 * x1)
            end = p.stiffness * (y2 - y0) + p.damping * (d2 * y3 - d1 * y1)
            room1, room2 = _rooms(p, m1, m2, s, spring, end, room1, room2)
        if not (room1 > chord1 * bound and room2 > chord2 * bound):
            break
        x0, x1, x2, x3 = y0, y1, y2, y3
        stretch = y2 - y0
        k += 1
    for i in range(begin, k if keep else begin):
        kept[i] = mode
    return k, clipped, (x0, d1 * x1, x2, d2 * x3), (z0, z1)


@inline_kernel
def glide(
    p: Drive, law: SmallLaw, rates: FloatArray, moves: FloatArray, bends: FloatArray, mode: int, states: FloatArray,
    kept: NDArray[np.int16], lag: int, before: float, far: float, w: FloatArray, post: FloatArray, u: FloatArray,
    excess: FloatArray, q: FloatArray, v: FloatArray, z: FloatArray, counts: IntArray, k: int,
) -> int:  # fmt: skip
    """Simulate from period `k` on by maps while nothing happens; return the period in which something may.

    The controller has run in that period. For a torque that acts over whole periods, and a controller with at most two
    states.
    """
    x, bound, s, nothing = read_state(q, v), np.inf, 0.0, True
    memory = z[0, 0] if z.shape[1] > 0 else 0.0, z[0, 1] if z.shape[1] > 1 else 0.0
    while nothing:
        k, clipped, x, memory = _follow_chords(
            p, law, moves, bends, mode, states, kept, lag, before, w, post, u, excess, x, memory, bound, s, k
        )
        counts[3] += clipped
        if not (k < u.size and abs(x[0]) <= far and abs(u[k]) < np.inf):
            break
        s = u[k - lag] + post[k - lag] if k >= lag else before
        nothing, bound, y = _cross(p, rates, moves, bends, mode, 0, x, s)
        if states.shape[0] > 0:
            kept[k] = mode
        if nothing:
            x, k = y, k + 1
    write_state(x, q, v)
    for i in range(z.shape[1]):
        z[0, i] = memory[1] if i > 0 else memory[0]
    return k


@compile_kernel
def ride(
    p: Drive, loop: SampledLoop, before: float, far: float, rates: FloatArray, moves: FloatArray, bends: FloatArray,
    mode: int, states: FloatArray, kept: NDArray[np.int16], q: FloatArray, v: FloatArray, z: FloatArray,
    fresh: FloatArray, out: FloatArray, cut: FloatArray, u: FloatArray, excess: FloatArray, counts: IntArray, k: int,
    part: int,
) -> tuple[int, int]:  # fmt: skip
    """Do the same as `glide` under any controller, and for a torque that acts in any part of a period."""
    feedback, post, lags, output = loop.feedback, loop.post[0], loop.lags[0], loop.feedback.output[0]
    x, keep, nothing = read_state(q, v), states.shape[0] > 0, True
    while nothing and k < u.size:
        if part == 0:
            control_any(feedback, 0, loop.w, k, x[0], z, fresh, out, cut)
            u[k] = out[output]
            if excess.shape[0] > 0:
                assign(excess[k], cut)
            counts[3] += 1 if cut[output] != 0.0 else 0
        if not (abs(x[0]) <= far and abs(u[k]) < np.inf):
            break
        while nothing and part < lags.size:
            at, source = k * lags.size + part, k - lags[part]
            s = u[source] + post[source] if source >= 0 else before
            if keep:
                kept[at] = mode
                states[at, 0], states[at, 1], states[at, 2], states[at, 3] = x
            nothing, _, y = _cross(p, rates, moves, bends, mode, part, x, s)
            if nothing:
                x, part = y, part + 1
        if nothing:
            k, part = k + 1, 0
    write_state(x, q, v)
    return k, part
