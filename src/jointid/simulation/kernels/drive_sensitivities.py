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
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.drive import SmallLaw, observe
from jointid.simulation.kernels.tables import LANES, Feedback, IntArray, Moved, SampledLoop, Slopes, Trace

Motion: TypeAlias = tuple[float, float, float, float, float]


_ORDER = 11  # of the Taylor series
_STEP = 0.25  # longest Taylor step, as a fraction of 1/(fastest rate of the drive)
_LINE = 8  # numbers of a cache line
_INPUTS = 5  # of a map: motor velocity, stretch, load velocity, torque, constant forces
NOTHING = 1e-200  # below it is 0: near the smallest numbers there are, many machines are a hundred times slower
OFTEN = 64  # periods after which that is checked
_WIDE = 4 * LANES  # of the derivatives of a state
_FACTOR = np.array([1.0 / math.factorial(i) for i in range(_ORDER + 1)])

# Rows of the scratch, LANES long: derivatives of the state, what parameters change in the map, the derivatives of the
# torque that acts, of a Taylor series, of two states of the law, of its output and its limit; then what parameters
# change in the output; last those of stiffness and damping, of the inertias, and of viscous coefficient and constant
# force of the motor and of the load in the modes they are in: beside what is written, where the compiler sees that
# nothing overlaps.
_S, _T, _DS, _W, _Z, _OUT, _LIMIT, _EXPLICIT = (LANES * row for row in (0, 4, 8, 9, 12, 14, 15, 16))
POSITION, MEMORY = _S, _Z  # of the motor, the first of the state; of a law of two states
_SPRING, _INERTIA, _SIDE, SCRATCH = (LANES * row for row in (17, 19, 21, 25))


@compile_kernel
def _propagate(
    q: FloatArray, h: float, mode: int, steady: float, s: float, motion: Motion, spring: FloatArray, side: FloatArray,
    dside: FloatArray,
) -> Motion:  # fmt: skip
    """Move one piece of a motion, and its derivatives in the scratch, over `h` seconds; return the motion.

    A motion is what the motor has travelled, its velocity, the stretch, what the load has travelled, its velocity.
    `steady` is 1 where the constant forces act and 0 for the response to anything else.
    """
    one, two = mode // 3, mode % 3
    K, F = spring[0], spring[1]
    h1, h2 = h * side[0, 0, one], h * side[1, 0, two]
    drag1, drag2 = side[0, 1, one] * h1, side[1, 1, two] * h2
    d1, v1, stretch, d2, v2 = motion
    moves1, moves2 = 1.0 if h1 > 0.0 else 0.0, 1.0 if h2 > 0.0 else 0.0
    for j in range(LANES):
        q[_SIDE + j], q[_SIDE + LANES + j] = dside[0, 0, one, j], dside[0, 1, one, j]
        q[_SIDE + 2 * LANES + j], q[_SIDE + 3 * LANES + j] = dside[1, 0, two, j], dside[1, 1, two, j]
    for j in range(LANES):
        dv1, dv2 = moves1 * q[_S + LANES + j], moves2 * q[_S + 3 * LANES + j]
        q[_W + LANES + j] = q[_S + 2 * LANES + j] - q[_S + j]
        q[_W + j], q[_W + 2 * LANES + j] = dv1, dv2
        q[_S + LANES + j], q[_S + 3 * LANES + j] = dv1, dv2
    end1, end2, end = v1, v2, stretch
    first = 1.0
    for k in range(1, _ORDER + 1):
        # What waits for the term before is added last: from one term to the next there is a chain of three operations.
        apart = v2 - v1
        pull = K * stretch + F * apart
        new1 = h1 * pull + (h1 * (first * (s + steady * side[0, 2, one])) - drag1 * v1)
        new2 = (h2 * (first * steady * side[1, 2, two]) - drag2 * v2) - h2 * pull
        moved, rate, steadily = h * _FACTOR[k], _FACTOR[k], first * steady
        for j in range(LANES):
            dv1, dstretch, dv2 = q[_W + j], q[_W + LANES + j], q[_W + 2 * LANES + j]
            dapart = dv2 - dv1
            dpull = F * dapart + K * dstretch
            given = q[_SPRING + j] * stretch + q[_SPRING + LANES + j] * apart
            push1 = ((given + first * q[_DS + j]) + steadily * q[_SIDE + LANES + j]) - q[_SIDE + j] * v1
            push2 = (steadily * q[_SIDE + 3 * LANES + j] - q[_SIDE + 2 * LANES + j] * v2) - given
            to1 = h1 * dpull + ((h1 * push1 - q[_INERTIA + j] * new1) - drag1 * dv1)
            to2 = ((h2 * push2 - q[_INERTIA + LANES + j] * new2) - drag2 * dv2) - h2 * dpull
            q[_S + j] += moved * dv1
            q[_S + LANES + j] += rate * to1
            q[_S + 2 * LANES + j] += moved * dv2
            q[_S + 3 * LANES + j] += rate * to2
            q[_W + j], q[_W + LANES + j], q[_W + 2 * LANES + j] = to1, h * dapart, to2
        d1 += moved * v1
        d2 += moved * v2
        end += moved * apart
        end1 += rate * new1
        end2 += rate * new2
        v1, v2, stretch = new1, new2, h * apart
        first = 0.0
    return d1, end1, end, d2, end2


@compile_kernel
def _fill(
    q: FloatArray, h: float, rate: float, mode: int, b: int, phi: FloatArray, M: FloatArray, spring: FloatArray,
    side: FloatArray, dside: FloatArray,
) -> None:  # fmt: skip
    """Write the map of a mode over `h` seconds at phi[b], and its derivatives at M[b], one input after the other."""
    one, two = mode // 3, mode % 3
    pieces = max(math.ceil(rate * h / _STEP), 1)
    for i in range(_INPUTS):
        q[:_SPRING] = 0.0
        v1 = 1.0 if i == 0 and side[0, 0, one] > 0.0 else 0.0
        v2 = 1.0 if i == 2 and side[1, 0, two] > 0.0 else 0.0
        motion = 0.0, v1, 1.0 if i == 1 else 0.0, 0.0, v2
        for _ in range(pieces):
            motion = _propagate(
                q, h / pieces, mode, 1.0 if i == 4 else 0.0, 1.0 if i == 3 else 0.0, motion, spring, side, dside
            )
        phi[b, 4 * i], phi[b, 4 * i + 1] = motion[0], motion[1]
        phi[b, 4 * i + 2], phi[b, 4 * i + 3] = motion[3], motion[4]
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
    """Do what `control_small` and `_step` do, at once, while the mode lasts and no limit cuts; return the next period.

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
            d = (law.d * a0 + q[_EXPLICIT + j]) + z0
            a = a2 - a0
            q[_S + j] = ((((q[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
            q[_S + LANES + j] = (((q[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
            q[_S + 2 * LANES + j] = ((((q[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
            q[_S + 3 * LANES + j] = (((q[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d
            q[_Z + j] = law.b0 * a0 + (law.own * z0 + z1)
            q[_Z + LANES + j] = law.b1 * a0 + law.other * z0
            q[_OUT + j] = d
        _write_output(q, at, du)
        k += 1
    return k


@inline_kernel
def _acceleration(side: FloatArray, mass: int, m: int, force: float, v: float) -> float:
    """Return the acceleration of a mass in a mode under the torque and the spring's force."""
    return (force + side[mass, 2, m] - side[mass, 1, m] * v) * side[mass, 0, m]


@compile_kernel
def _through_events(
    q: FloatArray, part: int, row: int, s: float, tape: FloatArray, rows: int, spring: FloatArray, side: FloatArray,
    dside: FloatArray,
) -> int:  # fmt: skip
    """Move the derivatives through the pieces of a part with events, from a row of the tape; return the next row."""
    while row < rows and tape[row, 0] == part:
        one, two = int(tape[row, 2]) + 1, int(tape[row, 3]) + 1
        motion = tape[row, 4], tape[row, 5], tape[row, 6] - tape[row, 4], tape[row, 6], tape[row, 7]
        if tape[row, 1] > 0.0:
            motion = _propagate(q, tape[row, 1], 3 * one + two, 1.0, s, motion, spring, side, dside)
        mass = int(tape[row, 8])
        if mass >= 0:
            _, v1, stretch, _, v2 = motion
            force = spring[0] * stretch + spring[1] * (v2 - v1)
            push, v, m = (s + force, v1, one) if mass == 0 else (-force, v2, two)
            before = _acceleration(side, mass, m, push, v)
            after = _acceleration(side, mass, int(tape[row, 9]) + 1, push, v)
            # Friction grows where a mass turns round, so the ratio is between 0 and 1; grazing leaves 0/0.
            ratio = min(max(after / before, 0.0), 1.0) if before != 0.0 else 0.0
            at = _S + (LANES if mass == 0 else 3 * LANES)
            for j in range(LANES):
                q[at + j] *= ratio
        row += 1
    return row


@inline_kernel
def begin_small(q: FloatArray, feedback: Feedback, nz: int, Z: FloatArray, dlimits: FloatArray) -> SmallLaw:
    """Write the first derivatives of the states of a law of two at most and of its limit; return that law."""
    law, seen = observe(feedback, nz, 0, 0.0)
    for i in range(seen.shape[1]):
        for j in range(LANES):
            q[_Z + j] += seen[0, i] * Z[i, j]
            q[_Z + LANES + j] += seen[1, i] * Z[i, j]
    assign(q[_LIMIT : _LIMIT + LANES], dlimits[0])
    return law


@inline_kernel
def control_small(
    q: FloatArray, law: SmallLaw, u: float, limit: float, explicit: FloatArray, first_explicit: int, at: int,
    du: FloatArray,
) -> None:  # fmt: skip
    """Write the derivatives of the output u of a law of two states at most, and move those of its states."""
    row = np.uint64(at)
    saturated = 0.0 if abs(u) < limit else math.copysign(1.0, u)
    for i in range(explicit.shape[2]):
        q[_EXPLICIT + first_explicit + i] = explicit[at, 0, i]
    if saturated == 0.0:
        for j in range(LANES):
            position, z0, z1 = q[_S + j], q[_Z + j], q[_Z + LANES + j]
            q[_OUT + j] = (law.d * position + q[_EXPLICIT + j]) + z0
            q[_Z + j] = law.b0 * position + (law.own * z0 + z1)
            q[_Z + LANES + j] = law.b1 * position + law.other * z0
    else:
        for j in range(LANES):
            position, z0, z1 = q[_S + j], q[_Z + j], q[_Z + LANES + j]
            raw = (law.d * position + q[_EXPLICIT + j]) + z0
            out = saturated * q[_LIMIT + j]
            cut = out - raw
            q[_Z + j] = (law.b0 * position + law.e0 * cut) + (law.own * z0 + z1)
            q[_Z + LANES + j] = (law.b1 * position + law.e1 * cut) + law.other * z0
            q[_OUT + j] = out
    _write_output(q, row, du)


@compile_kernel
def control_slopes(
    laws: Feedback, axis: int, own: int, cut: FloatArray, moved: FloatArray, dz: FloatArray, fresh: FloatArray,
    raw: FloatArray, taken: FloatArray, explicit: FloatArray, first: int, dlimits: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Write the derivatives of the output of any law in a period of its own, and move those of its states, `dz`.

    Where a limit acts its value follows the limit alone, and where a gate is closed nothing passes. `moved` are those
    of the motor's position, `cut` is what limits and gates take away; `fresh`, `raw` and `taken` are scratch.
    """
    phase, elements, states, count = own % laws.A.shape[1], cut.size, len(dz), moved.size
    A, F, C, E = laws.A[axis, phase], laws.F[axis, phase], laws.C[axis, phase], laws.E[axis, phase]
    for e in range(elements):
        for c in range(count):
            raw[e, c] = laws.D[axis, phase, e] * moved[c]
        for i in range(explicit.shape[2]):
            raw[e, first + i] += explicit[own, e, i]
        for s in range(states):
            weight = C[e, s]
            if weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * dz[s, c]
        for other in range(e):
            weight = E[e, other]
            if cut[other] != 0.0 and weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * taken[other, c]
        if cut[e] != 0.0:
            sign = -math.copysign(1.0, cut[e]) if laws.gates[axis, e] < 0 else 0.0
            for c in range(count):
                taken[e, c] = sign * dlimits[e, c] - raw[e, c]
        if e == laws.output[axis]:
            for c in range(count):
                out[c] = raw[e, c] + (taken[e, c] if cut[e] != 0.0 else 0.0)
    for s in range(states):
        for c in range(count):
            fresh[s, c] = laws.Bq[axis, phase, s] * moved[c]
        for other in range(states):
            weight = A[s, other]
            if weight != 0.0:
                for c in range(count):
                    fresh[s, c] += weight * dz[other, c]
        for e in range(elements):
            weight = F[s, e]
            if cut[e] != 0.0 and weight != 0.0:
                for c in range(count):
                    fresh[s, c] += weight * taken[e, c]
    for s in range(states):
        assign(dz[s], fresh[s])


@inline_kernel
def _fill_modes(drive: FloatArray, seeds: FloatArray, side: FloatArray, dside: FloatArray) -> None:
    """Write a drive by the modes of its masses, and the derivatives of that.

    The first is (mass 2, what 3, mode 3): mobility, viscous coefficient and constant force going backwards, at rest,
    forwards; the second, of the last two, (mass 2, what 2, mode 3, columns).
    """
    for mass in range(2):
        for mode, back, sign in ((0, 1, 1.0), (2, 0, -1.0)):
            viscous, coulomb, offset = 4 + 4 * mass + back, 6 + 4 * mass + back, 12 + mass
            side[mass, 0, mode], side[mass, 1, mode] = 1.0 / drive[mass], drive[viscous]
            side[mass, 2, mode] = sign * drive[coulomb] - drive[offset]
            for j in range(LANES):
                dside[mass, 0, mode, j] = seeds[viscous, j]
                dside[mass, 1, mode, j] = sign * seeds[coulomb, j] - seeds[offset, j]


@inline_kernel
def _rate(drive: FloatArray, side: FloatArray) -> float:
    """Bound in 1/s on how fast a drive's own motion can change."""
    inverse1, inverse2 = side[0, 0, 2], side[1, 0, 2]
    rate = math.sqrt(drive[2] * (inverse1 + inverse2)) + drive[3] * (inverse1 + inverse2)
    rate += max(abs(side[0, 1, 0]), abs(side[0, 1, 2])) * inverse1
    rate += max(abs(side[1, 1, 0]), abs(side[1, 1, 2])) * inverse2
    return rate


@inline_kernel
def aligned_zeros(size: int) -> FloatArray:
    """Return so many zeros that begin with a line of the cache, as every row of a wide vector then does."""
    room = np.zeros(size + _LINE)
    first = (-(room.ctypes.data // 8)) % _LINE
    return room[first : first + size]


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
    side, dside, spring = np.zeros((2, 3, 3)), np.zeros((2, 2, 3, LANES)), drive[2:4]
    _fill_modes(drive, seeds, side, dside)
    rate = _rate(drive, side)
    phi = np.empty((9 * parts, 4 * _INPUTS))
    M = aligned_zeros(9 * parts * _INPUTS * _WIDE).reshape((9 * parts, _INPUTS * _WIDE))
    filled = np.zeros(9 * parts, dtype=np.bool_)
    q, scratch, fresh = aligned_zeros(SCRATCH), aligned_zeros(SCRATCH), np.zeros((nz, LANES))
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
    law, limit = begin_small(q, feedback, nz if small else 0, Z, dlimits), feedback.limits[0, 0]
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
                _fill(scratch, lengths[0], rate, mode, mode, phi, M, spring, side, dside)
            k = _glide(q, law, phi, M, mode, k, end, limit, states, modes, u, post, explicit, first_explicit, du)
            continue
        if small:
            control_small(q, law, u[k], limit, explicit, first_explicit, k, du)
        else:
            control_slopes(
                feedback, 0, k, excess[k], q[_S : _S + LANES], Z, fresh, raw, taken, explicit, first_explicit, dlimits,
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
                force = spring[0] * (x2 - x0) + spring[1] * (x3 - x1)
                was = 1 + (1 if x1 > 0.0 else (-1 if x1 < 0.0 else 0))
                kick = _acceleration(side, 0, was, last + force, x1)
                kick -= _acceleration(side, 0, mode // 3, s + force, x1)
                for i in range(delays.shape[0]):
                    q[_S + LANES + delays[i, 0]] += kick
            last = s
            if row < rows and tape[row, 0] == at:
                row = _through_events(q, at, row, s, tape, rows, spring, side, dside)
            else:
                b = 9 * part + mode
                if not filled[b]:
                    filled[b] = True
                    _fill(scratch, lengths[part], rate, mode, b, phi, M, spring, side, dside)
                _step(q, phi, M, b, x1, x2 - x0, x3, s)
        k += 1
