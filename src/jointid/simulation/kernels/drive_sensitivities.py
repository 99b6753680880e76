"""The derivatives of a simulation by its parameters, exact, compiled: the tangent of the maps of `kernels`.

A run has left its states, its modes and a tape of the pieces of the periods in which something happened. This follows
it once more with a column of derivatives per parameter. Within a piece the drive is linear, so a column moves by the
map of its mode, and is pushed by what its parameter changes in that map (the Fréchet derivative of the exponential,
by Taylor series). At an event:

- where a velocity falls to zero its derivative is scaled by the acceleration after over that before: less than 1
  where the mass turns round, 0 where it sticks (the time of the event moves, and the slopes differ on its two sides);
- where a mass comes loose nothing changes, since its acceleration begins at zero; where a step of the torque tears it
  loose, the time is the controller's and does not move;
- a delay moves the edges of the torque, so each edge kicks the velocity by the difference of the accelerations.

All that the loop over the periods goes on from is one array, with rows of a constant
length: only then the compiler knows that nothing overlaps, and keeps to vector instructions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.control import NOTHING, OFTEN, SmallLaw, aligned_zeros, control_slopes, small_law
from jointid.simulation.kernels.drive import (
    STEP,
    Drive,
    Motion,
    State,
    accelerate,
    drive_of,
    fastest_rate,
    fill_series,
    motion,
)
from jointid.simulation.kernels.polynomial import ORDER, ROOM, value_at
from jointid.simulation.kernels.tables import LANES, IntArray, Moved, SampledLoop, Slopes, Trace

_INPUTS = 5  # of a map: motor velocity, stretch, load velocity, torque, constant forces
_WIDE = 4 * LANES  # of the derivatives of a state

# Rows of the scratch, LANES long: derivatives of the state, what parameters change in the map, the derivatives of the
# torque that acts, of a Taylor series, of two states of the law, and of its output; then what parameters change in
# the output; last those of stiffness and damping, of the inertias, and of viscous coefficient and constant
# force of the motor and of the load in the modes they are in: beside what is written, where the compiler sees that
# nothing overlaps.
_S, _T, _DS, _W, _Z, _OUT, _EXPLICIT = (LANES * row for row in (0, 4, 8, 9, 12, 14, 15))
_SPRING, _INERTIA, _SIDE, _SCRATCH = (LANES * row for row in (16, 18, 20, 24))


@compile_kernel
def _propagate(
    q: FloatArray, c: FloatArray, p: Drive, f: Motion, m1: int, m2: int, steady: float, x: State, s: float, h: float,
    seeds: FloatArray,
) -> State:  # fmt: skip
    """Move one piece of a motion, and its derivatives in the scratch, over `h` seconds; return the motion's end.

    The constant forces act for a `steady` of 1; it is 0 for the response to anything else. Derivatives follow the
    Taylor series of the motion, term by term.
    """
    back1, back2, way1, way2 = 1 if m1 < 0 else 0, 1 if m2 < 0 else 0, -steady * m1, -steady * m2
    h1, h2 = h * f.mobility1, h * f.mobility2
    drag1, drag2 = f.viscous1 * h1, f.viscous2 * h2
    moves1, moves2 = 1.0 if m1 != 0 else 0.0, 1.0 if m2 != 0 else 0.0
    fill_series(c, p, f, x, s, h, False, False)
    for j in range(LANES):
        q[_SIDE + j], q[_SIDE + 2 * LANES + j] = seeds[4 + back1, j], seeds[8 + back2, j]
        q[_SIDE + LANES + j] = way1 * seeds[6 + back1, j] - steady * seeds[12, j]
        q[_SIDE + 3 * LANES + j] = way2 * seeds[10 + back2, j] - steady * seeds[13, j]
    for j in range(LANES):
        dv1, dv2 = moves1 * q[_S + LANES + j], moves2 * q[_S + 3 * LANES + j]
        q[_W + LANES + j] = q[_S + 2 * LANES + j] - q[_S + j]
        q[_W + j], q[_W + 2 * LANES + j] = dv1, dv2
        q[_S + LANES + j], q[_S + 3 * LANES + j] = dv1, dv2
    first = 1.0
    for k in range(1, ORDER + 1):
        # What waits for the term before is added last: from one term to the next there is a chain of three operations.
        share = 1.0 / k
        v1, stretch, v2 = c[1, k - 1], c[2, k - 1] - c[0, k - 1], c[3, k - 1]
        apart, new1, new2, moved, to1, to2 = v2 - v1, c[1, k], c[3, k], h * share, h1 * share, h2 * share
        slow1, slow2 = drag1 * share, drag2 * share
        for j in range(LANES):
            dv1, dstretch, dv2 = q[_W + j], q[_W + LANES + j], q[_W + 2 * LANES + j]
            dapart = dv2 - dv1
            dpull = p.damping * dapart + p.stiffness * dstretch
            given = q[_SPRING + j] * stretch + q[_SPRING + LANES + j] * apart
            push1 = (given + first * (q[_DS + j] + q[_SIDE + LANES + j])) - q[_SIDE + j] * v1
            push2 = (first * q[_SIDE + 3 * LANES + j] - q[_SIDE + 2 * LANES + j] * v2) - given
            next1 = to1 * dpull + ((to1 * push1 - q[_INERTIA + j] * new1) - slow1 * dv1)
            next2 = ((to2 * push2 - q[_INERTIA + LANES + j] * new2) - slow2 * dv2) - to2 * dpull
            q[_S + j] += moved * dv1
            q[_S + LANES + j] += next1
            q[_S + 2 * LANES + j] += moved * dv2
            q[_S + 3 * LANES + j] += next2
            q[_W + j], q[_W + LANES + j], q[_W + 2 * LANES + j] = next1, moved * dapart, next2
        first = 0.0
    return value_at(c, 0, 1.0), value_at(c, 1, 1.0), value_at(c, 2, 1.0), value_at(c, 3, 1.0)


@compile_kernel
def _fill(
    q: FloatArray, c: FloatArray, h: float, p: Drive, mode: int, b: int, phi: FloatArray, M: FloatArray,
    seeds: FloatArray,
) -> None:  # fmt: skip
    """Write the map of a mode over `h` seconds at phi[b], and its derivatives at M[b], one input after the other."""
    m1, m2 = mode // 3 - 1, mode % 3 - 1
    f, pieces = motion(p, m1, m2), max(math.ceil(fastest_rate(p) * h / STEP), 1)
    free = Motion(f.mobility1, f.mobility2, f.viscous1, f.viscous2, 0.0, 0.0)
    for i in range(_INPUTS):
        q[:_SPRING] = 0.0
        v1, v2 = 1.0 if i == 0 and m1 != 0 else 0.0, 1.0 if i == 2 and m2 != 0 else 0.0
        begin, steady = 1.0 if i == 1 else 0.0, 1.0 if i == 4 else 0.0
        x = 0.0, v1, begin, v2
        for _ in range(pieces):
            x = _propagate(q, c, p, f if i == 4 else free, m1, m2, steady, x, 1.0 if i == 3 else 0.0, h / pieces, seeds)
        phi[b, 4 * i], phi[b, 4 * i + 1], phi[b, 4 * i + 2], phi[b, 4 * i + 3] = x[0], x[1], x[2] - begin, x[3]
        assign(M[b, _WIDE * i : _WIDE * (i + 1)], q[_S : _S + _WIDE])


@inline_kernel
def _push(q: FloatArray, M: FloatArray, b: int, v1: float, stretch: float, v2: float, s: float) -> None:
    """Write what the parameters change in the map of a part, for the motion there is."""
    m = np.uint64(b)  # Numba looks for negative indices among the signed
    for i in range(_WIDE):
        moved = (M[m, 4 * _WIDE + i] + M[m, i] * v1) + M[m, _WIDE + i] * stretch
        q[_T + i] = (moved + M[m, 2 * _WIDE + i] * v2) + M[m, 3 * _WIDE + i] * s


@inline_kernel
def _step(
    q: FloatArray, phi: FloatArray, M: FloatArray, b: int, v1: float, stretch: float, v2: float, s: float
) -> None:
    """Move the derivatives over a part in which nothing happened."""
    p00, p01, p02, p03 = phi[b, 0], phi[b, 1], phi[b, 2], phi[b, 3]
    p10, p11, p12, p13 = phi[b, 4], phi[b, 5], phi[b, 6], phi[b, 7]
    p20, p21, p22, p23 = phi[b, 8], phi[b, 9], phi[b, 10], phi[b, 11]
    g0, g1, g2, g3 = phi[b, 12], phi[b, 13], phi[b, 14], phi[b, 15]
    _push(q, M, b, v1, stretch, v2, s)
    for j in range(LANES):
        a0, a1, a2, a3 = q[_S + j], q[_S + LANES + j], q[_S + 2 * LANES + j], q[_S + 3 * LANES + j]
        a, d = a2 - a0, q[_DS + j]
        q[_S + j] = ((((q[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
        q[_S + LANES + j] = (((q[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
        q[_S + 2 * LANES + j] = ((((q[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
        q[_S + 3 * LANES + j] = (((q[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d


@inline_kernel
def _write_output(q: FloatArray, at: np.uint64, du: FloatArray) -> None:
    """Write the derivatives of the law's output."""
    for j in range(LANES):
        du[at, j] = q[_OUT + j]


@inline_kernel
def _glide(
    q: FloatArray, law: SmallLaw, phi: FloatArray, M: FloatArray, mode: int, k: int, end: int, limit: float,
    states: FloatArray, modes: NDArray[np.int16], u: FloatArray, post: FloatArray, explicit: FloatArray,
    first_explicit: int, du: FloatArray,
) -> int:  # fmt: skip
    """Do what `control_slopes` and `_step` do, at once, while the mode lasts and no limit cuts; return the next period.

    Nearly all periods are of this kind. One loop whose every value is written once: a machine keeps it in vectors, and
    no value waits in memory.
    """
    p00, p01, p02, p03 = phi[mode, 0], phi[mode, 1], phi[mode, 2], phi[mode, 3]
    p10, p11, p12, p13 = phi[mode, 4], phi[mode, 5], phi[mode, 6], phi[mode, 7]
    p20, p21, p22, p23 = phi[mode, 8], phi[mode, 9], phi[mode, 10], phi[mode, 11]
    g0, g1, g2, g3 = phi[mode, 12], phi[mode, 13], phi[mode, 14], phi[mode, 15]
    while k < end and modes[k] == mode and abs(u[k]) < limit:
        at = np.uint64(k)
        for i in range(explicit.shape[2]):
            q[_EXPLICIT + first_explicit + i] = explicit[at, 0, i]
        v1, stretch, v2, s = states[at, 1], states[at, 2] - states[at, 0], states[at, 3], u[at] + post[at]
        _push(q, M, mode, v1, stretch, v2, s)
        for j in range(LANES):
            a0, a1, a2, a3 = q[_S + j], q[_S + LANES + j], q[_S + 2 * LANES + j], q[_S + 3 * LANES + j]
            z0, z1 = q[_Z + j], q[_Z + LANES + j]
            d = (law.d * a0 + q[_EXPLICIT + j]) + (law.c0 * z0 + law.c1 * z1)
            a = a2 - a0
            q[_S + j] = ((((q[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
            q[_S + LANES + j] = (((q[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
            q[_S + 2 * LANES + j] = ((((q[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
            q[_S + 3 * LANES + j] = (((q[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d
            q[_Z + j] = law.b0 * a0 + (law.a00 * z0 + law.a01 * z1)
            q[_Z + LANES + j] = law.b1 * a0 + (law.a10 * z0 + law.a11 * z1)
            q[_OUT + j] = d
        _write_output(q, at, du)
        k += 1
    return k


@compile_kernel
def _through_events(
    q: FloatArray, c: FloatArray, part: int, row: int, s: float, tape: FloatArray, rows: int, p: Drive,
    seeds: FloatArray,
) -> int:  # fmt: skip
    """Move the derivatives through the pieces of a part with events, from a row of the tape; return the next row."""
    while row < rows and tape[row, 0] == part:
        m1, m2, mass, after = int(tape[row, 2]), int(tape[row, 3]), int(tape[row, 8]), int(tape[row, 9])
        x, f = (tape[row, 4], tape[row, 5], tape[row, 6], tape[row, 7]), motion(p, m1, m2)
        if tape[row, 1] > 0.0:
            x = _propagate(q, c, p, f, m1, m2, 1.0, x, s, tape[row, 1], seeds)
        if mass >= 0:
            then = motion(p, after if mass == 0 else m1, after if mass == 1 else m2)
            slowing = accelerate(p, f, x[1], x[2] - x[0], x[3], s)[mass]
            goes_on = accelerate(p, then, x[1], x[2] - x[0], x[3], s)[mass]
            # Friction grows where a mass turns round, so the ratio is between 0 and 1; grazing leaves 0/0.
            ratio = min(max(goes_on / slowing, 0.0), 1.0) if slowing != 0.0 else 0.0
            at = _S + (LANES if mass == 0 else 3 * LANES)
            for j in range(LANES):
                q[at + j] *= ratio
        row += 1
    return row


@compile_kernel
def follow(
    loop: SampledLoop,
    before: float,
    trace: Trace,
    rows: int,
    drive: FloatArray,
    seeds: FloatArray,
    delays: IntArray,
    moved: Moved,
    slopes: Slopes,
) -> None:
    """Fill LANES columns of derivatives of a finished run.

    Args:
        loop: what drove the run.
        before: torque that acted before its first period.
        trace: what it left behind.
        rows: of the tape that are filled.
        drive: (14,) of `kernels.drive.run`.
        seeds: (14, columns) derivatives of the drive's coefficients.
        delays: (some, 2) columns of the controller's delay, and 0.
        moved: how the first state and the controller depend on the parameters.
        slopes: out.
    """
    lengths, lags, feedback, post = loop.lengths, loop.lags[0], loop.feedback, loop.post[0]
    u, excess, states, modes, tape = trace.u, trace.excess, trace.states, trace.modes, trace.tape
    explicit, first_explicit, dlimits = moved.explicit[0], moved.first, moved.limits[0]
    Z, du, dstates = moved.dz[0], slopes.command[0], slopes.states
    n, parts, nz, elements = u.size, lengths.size, feedback.A.shape[2], feedback.limits.size
    p, c = drive_of(drive), np.zeros(ROOM)
    phi = np.empty((9 * parts, 4 * _INPUTS))
    M = aligned_zeros(9 * parts * _INPUTS * _WIDE).reshape((9 * parts, _INPUTS * _WIDE))
    filled = np.zeros(9 * parts, dtype=np.bool_)
    q, scratch, fresh = aligned_zeros(_SCRATCH), aligned_zeros(_SCRATCH), np.zeros((nz, LANES))
    raw, taken = np.zeros((elements, LANES)), np.zeros((elements, LANES))
    for one in (q, scratch):
        for i in range(2):
            for j in range(LANES):
                one[_INERTIA + i * LANES + j] = seeds[i, j] / drive[i]
                one[_SPRING + i * LANES + j] = seeds[2 + i, j]
    for i in range(2):
        assign(q[_S + 2 * i * LANES : _S + (2 * i + 1) * LANES], moved.dq[i])
        assign(q[_S + (2 * i + 1) * LANES : _S + (2 * i + 2) * LANES], moved.dv[i])
    small = nz <= 2 and feedback.D.size == 1  # one phase, one element
    law, limit, dz = small_law(feedback, nz if small else 0), feedback.limits[0, 0], Z
    if small:
        dz = q[_Z : _Z + nz * LANES].reshape((nz, LANES))
        for i in range(nz):
            assign(dz[i], Z[i])
    delayed = delays.shape[0] > 0
    keep = dstates.shape[0] > 0
    plain = small and parts == 1 and lags[0] == 0 and not keep and not delayed
    row, last = 0, before
    k = 0
    while k < n:
        if k % OFTEN == 0:
            for i in range(_WIDE):
                q[_S + i] = q[_S + i] if abs(q[_S + i]) > NOTHING else 0.0
            for i in range(2 * LANES):
                q[_Z + i] = q[_Z + i] if abs(q[_Z + i]) > NOTHING else 0.0
        if plain and abs(u[k]) < limit and (row >= rows or tape[row, 0] > k):
            mode = int(modes[k])
            end = min(k - k % OFTEN + OFTEN, n)
            if row < rows:
                end = min(end, int(tape[row, 0]))
            if not filled[mode]:
                filled[mode] = True
                _fill(scratch, c, lengths[0], p, mode, mode, phi, M, seeds)
            k = _glide(q, law, phi, M, mode, k, end, limit, states, modes, u, post, explicit, first_explicit, du)
            continue
        control_slopes(
            feedback, 0, k, excess[k], q[_S : _S + LANES], dz, fresh, raw, taken, explicit, first_explicit, dlimits,
            du[k],
        )  # fmt: skip
        for part in range(parts):
            at = k * parts + part
            x0, x1, x2, x3 = states[at, 0], states[at, 1], states[at, 2], states[at, 3]
            mode = int(modes[at])
            source = k - lags[part]
            s = u[source] + post[source] if source >= 0 else before
            origin = np.uint64(max(source, 0))
            for j in range(LANES):
                q[_DS + j] = du[origin, j]
            if keep:
                for i in range(4):
                    for j in range(LANES):
                        dstates[at, i, j] = q[_S + i * LANES + j]
            if delayed and s != last:
                was = 1 if x1 > 0.0 else (-1 if x1 < 0.0 else 0)
                kick = accelerate(p, motion(p, was, 0), x1, x2 - x0, x3, last)[0]
                kick -= accelerate(p, motion(p, mode // 3 - 1, 0), x1, x2 - x0, x3, s)[0]
                for i in range(delays.shape[0]):
                    q[_S + LANES + delays[i, 0]] += kick
            last = s
            if row < rows and tape[row, 0] == at:
                row = _through_events(q, c, at, row, s, tape, rows, p, seeds)
            else:
                b = 9 * part + mode
                if not filled[b]:
                    filled[b] = True
                    _fill(scratch, c, lengths[part], p, mode, b, phi, M, seeds)
                _step(q, phi, M, b, x1, x2 - x0, x3, s)
        k += 1
