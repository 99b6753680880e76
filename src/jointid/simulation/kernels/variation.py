"""The derivatives of a simulation by its parameters, along the steps of `kernels.engine`, compiled.

The run has left a tape of its steps. Along each the deviations of all masses obey linear equations::

    M da + C dv + K dq = G

with M, C and K the derivatives of the equations of motion by acceleration, velocity and position, and G, negative, by
the parameters and by the motors' torques. They are taken at the mean of the step. The masses of a joint then follow a
Taylor series of order 4; those of a tree the implicit midpoint rule, of order 2. What winds up has the derivative of
its closed form. A mass at rest stays there. An event moves in time with what it takes to zero, so velocities jump
(M. A. Aizerman and F. R. Gantmacher: On the stability of periodic motions, Journal of Applied Mathematics and
Mechanics 22, 1958)::

    dv+ = dv- + (a+ - a-) dv_i- / a_i-

A delay moves the edges of a torque, and each kicks the velocities by the difference of the accelerations. Controllers
are linear between limits, and where one acts its element follows the limit.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.robots.dynamics import regressor
from jointid.models.robots.equations import ROOM, linearised_equations, of_joints
from jointid.models.robots.robot import Tree
from jointid.simulation.kernels.drive_sensitivities import (
    MEMORY,
    NOTHING,
    OFTEN,
    POSITION,
    SCRATCH,
    aligned_zeros,
    begin_small,
    control_slopes,
    control_small,
)
from jointid.simulation.kernels.engine import place_force, spring_torque, winding
from jointid.simulation.kernels.tables import (
    BEGIN,
    COS,
    COULOMB,
    COULOMB_DRIFT,
    CUBIC,
    DAMPING,
    EVENT,
    FREE,
    HELD,
    INERTIA,
    LANES,
    LENGTH,
    MASS,
    MASSES,
    OFFSET,
    PART,
    PER_TORQUE,
    RATE,
    SIN,
    SLIDING,
    SLIPS,
    SPRINGS,
    STATE,
    STIFFNESS,
    VISCOUS,
    VISCOUS_DRIFT,
    WAVE,
    WHERE,
    WINDING,
    IndexArray,
    IntArray,
    Moved,
    Plant,
    SampledLoop,
    Seeds,
    Slopes,
)

# Rows of a joint's derivatives, LANES long: positions and velocities of the masses; the forces that are given on masses
# and in springs in the middle of a step, their rates, and what is wound up otherwise; how far the masses have gone.
_Q, _V, _GIVEN, _RATE, _GONE = (LANES * row for row in (0, 3, 6, 11, 21))
# Factors of a step: of each mass whether it moves, its drag and stiffness, how much of the torque that it carries it
# takes; of masses, then of springs, how the derivative of what is wound up enters the force, what of it is left at the
# end, what it gains with the place and with the rate of winding; of springs stiffness and damping, the torque and its
# rate.
_GOES, _DRAG, _STIFF, _TAKES, _HALF, _WINDS, _LEFT, _GAINS, _TURNS, _PULL, _DAMP, _PULLED, _GROWS = range(13)
_FACTORS = 13
# Rows of the mean motion of a step.
_PLACE, _SPEED, _CHANGE, _JERK = range(4)
_TURNING = 1e-9  # of the largest acceleration: a velocity that comes to 0 with less of its own hardly turns

Three: TypeAlias = tuple[float, float, float]


@inline_kernel
def _wind(f: FloatArray, i: int, w: float, way: float, x: float, rate: float, force: float) -> float:
    """Write the factors of what is wound up in a step; return that of its rate in the force, half way through."""
    f[_HALF, i], f[_WINDS, i], f[_LEFT, i], f[_GAINS, i], f[_TURNS, i] = 0.0, 0.0, 0.0, 0.0, 0.0
    if w == way:
        return 0.0
    half, left = math.exp(min(-0.5 * way * x * rate, 1.0)), math.exp(min(-way * x * rate, 1.0))
    slope = (way - w) * way
    f[_HALF, i], f[_WINDS, i], f[_LEFT, i] = force * half, force * slope * half * rate, left
    f[_GAINS, i], f[_TURNS, i] = slope * left * rate, slope * left * x
    return force * slope * half


@inline_kernel
def _mean_motion(tape: FloatArray, row: int, nd: int, mean: FloatArray) -> None:
    """Fill the means of positions, velocities, accelerations and their rates over a step, from its row and the next."""
    h, inverse, then = tape[row, LENGTH], 1.0 / tape[row, LENGTH], row + 1
    for i in range(nd):
        q, v = tape[row, STATE + i], tape[row, STATE + nd + i]
        q1, v1 = tape[then, STATE + i], tape[then, STATE + nd + i]
        middle = 0.5 * (q + q1) + 0.125 * h * (v - v1)
        mean[_PLACE, i], mean[_SPEED, i] = (q + 4.0 * middle + q1) / 6.0, (q1 - q) * inverse
        mean[_CHANGE, i] = (v1 - v) * inverse
        mean[_JERK, i] = (tape[row, STATE + 3 * nd + i] - tape[row, STATE + 2 * nd + i]) * inverse


@inline_kernel
def _fill_factors(
    masses: FloatArray, springs: FloatArray, pairs: IndexArray, carriers: IntArray, tape: FloatArray, row: int,
    mean: FloatArray, drive: FloatArray, time: float, first: int, f: FloatArray, k: FloatArray, later: FloatArray,
) -> None:  # fmt: skip
    """Fill the factors of a step, a row of the tape, and those of the numbers in the forces, with their rates.

    The second are taken as they are in the middle of the step, and change linearly in it. `first` is the column of the
    first spring among the factors.
    """
    nd, ns, h = masses.shape[0], pairs.shape[0], tape[row, LENGTH]
    modes, at, wound = STATE + 4 * nd, STATE + 5 * nd + ns, STATE + 6 * nd + 2 * ns
    for s in range(ns):
        one, two, piece, x = pairs[s, 0], pairs[s, 1], int(tape[row, at + nd + s]), first + s
        p, side = np.uint64(abs(piece)), (0.0 if piece == 0 else math.copysign(1.0, piece))
        e, de = mean[_PLACE, two] - mean[_PLACE, one], mean[_SPEED, two] - mean[_SPEED, one]
        dde = mean[_CHANGE, two] - mean[_CHANGE, one]
        w, way = tape[row, wound + nd + s], tape[row, modes + nd + s]
        slides, slips, damping = springs[s, p, SLIDING], springs[s, p, SLIPS], springs[s, p, DAMPING]
        half = winding(w, way, 0.5 * de * h, slides)
        turns = slides * (de - abs(de) * half)
        pull = springs[s, p, STIFFNESS] + 3.0 * springs[s, p, CUBIC] * e * e
        f[_PULLED, x] = side * springs[s, p, HELD] + spring_torque(
            springs[s, p, STIFFNESS], springs[s, p, CUBIC], damping, slips, e, de, half
        )
        f[_GROWS, x] = pull * de + damping * dde + slips * turns
        f[_WINDS, x], k[x, SLIDING] = 0.0, 0.0
        if slips > 0.0:
            k[x, SLIDING] = 0.5 * _wind(f, x, w, way, de * h, slides, slips) * de * h
        f[_PULL, x], f[_DAMP, x] = pull + f[_WINDS, x], damping
        k[x, STIFFNESS], k[x, DAMPING], k[x, CUBIC], k[x, SLIPS], k[x, HELD] = e, de, e * e * e, half, side
        later[x, STIFFNESS], later[x, DAMPING], later[x, CUBIC], later[x, SLIPS] = de, dde, 3.0 * e * e * de, turns
    for i in range(nd):
        mode, speed, rate, band = tape[row, modes + i], mean[_SPEED, i], mean[_CHANGE, i], np.uint64(tape[row, at + i])
        carried, grows = drive[i], 0.0
        if carriers[i] >= 0:
            carried, grows = f[_PULLED, first + carriers[i]], f[_GROWS, first + carriers[i]]
        way = math.copysign(1.0, speed) if mode == FREE else mode
        back, moves = (1 if way < 0.0 else 0), (1.0 if mode != 0.0 else 0.0)
        # A torque that goes through 0 within the step: the mean of its size, and of its sign.
        low, high = carried - 0.5 * h * grows, carried + 0.5 * h * grows
        sign, size = math.copysign(1.0, carried), abs(carried)
        if low * high < 0.0:
            sign, size = (abs(high) - abs(low)) / (high - low), (high * high + low * low) / (2.0 * abs(high - low))
        share, turns, winds, x = way, 0.0, masses[i, 0, WINDING], speed * h
        grip = masses[i, band, COULOMB + back] + masses[i, 0, COULOMB_DRIFT] * time + masses[i, 0, PER_TORQUE] * size
        f[_STIFF, i], k[i, WINDING] = 0.0, 0.0
        if winds > 0.0:
            share = winding(tape[row, wound + i], mode, 0.5 * x, winds)
            turns = winds * (speed - abs(speed) * share)
            gain = _wind(f, i, tape[row, wound + i], mode, x, winds, -grip)
            f[_STIFF, i], k[i, WINDING] = f[_WINDS, i], 0.5 * gain * x
        f[_GOES, i] = moves
        f[_DRAG, i] = masses[i, band, VISCOUS + back] + masses[i, 0, VISCOUS_DRIFT] * time
        f[_TAKES, i] = 1.0 + share * masses[i, 0, PER_TORQUE] * sign
        k[i, INERTIA], later[i, INERTIA], k[i, OFFSET] = -rate, -mean[_JERK, i], -1.0
        k[i, VISCOUS + back], later[i, VISCOUS + back] = -speed, -rate
        k[i, VISCOUS + 1 - back], later[i, VISCOUS + 1 - back] = 0.0, 0.0
        k[i, COULOMB + back], later[i, COULOMB + back] = -share, -turns
        k[i, COULOMB + 1 - back], later[i, COULOMB + 1 - back] = 0.0, 0.0
        k[i, VISCOUS_DRIFT], later[i, VISCOUS_DRIFT] = -speed * time, -(rate * time + speed)
        k[i, COULOMB_DRIFT], later[i, COULOMB_DRIFT] = -share * time, -(turns * time + share)
        k[i, PER_TORQUE], later[i, PER_TORQUE] = -share * size, -(turns * size + share * sign * grows)


@inline_kernel
def _fill_places(
    places: FloatArray, first: int, mean: FloatArray, f: FloatArray, k: FloatArray, later: FloatArray
) -> None:
    """Fill the factors of the numbers of forces that follow a position, and add the stiffness of these."""
    for force in range(places.shape[0]):
        i, x, wave = int(places[force, WHERE]), first + force, places[force, WAVE]
        place, speed = mean[_PLACE, i], mean[_SPEED, i]
        cos, sin = math.cos(wave * place), math.sin(wave * place)
        f[_STIFF, i] -= place_force(places[force, COS], places[force, SIN], places[force, RATE], wave, place)[1]
        k[x, COS], k[x, SIN], k[x, RATE] = -cos, -sin, -place
        later[x, COS], later[x, SIN], later[x, RATE] = speed * wave * sin, -speed * wave * cos, -speed


@inline_kernel
def _add_seeds(
    seeds: Seeds, row: int, band: int, to: int, winds: int, f: FloatArray, k: FloatArray, later: FloatArray,
    given: FloatArray, rate: FloatArray, turned: FloatArray,
) -> None:  # fmt: skip
    """Add what parameters change in a law; `winds` is the number of which something is wound up otherwise."""
    for e in range(seeds.begin[row, band], seeds.begin[row, band + 1]):
        number, c, value = seeds.numbers[e], seeds.columns[e], seeds.values[e]
        given[to, c] += k[row, number] * value
        rate[to, c] += later[row, number] * value
        if number == winds:
            turned[to, c] += f[_TURNS, row] * value


@compile_kernel
def _solve(A: FloatArray, rows: FloatArray) -> None:
    """Solve A x = rows in place by elimination with pivots; both are overwritten."""
    n = len(A)
    for k in range(n):
        at = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[at, k]):
                at = i
        if at != k:
            for j in range(n):
                A[k, j], A[at, j] = A[at, j], A[k, j]
            for c in range(rows.shape[1]):
                rows[k, c], rows[at, c] = rows[at, c], rows[k, c]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                for c in range(rows.shape[1]):
                    rows[i, c] -= factor * rows[k, c]
    for k in range(n - 1, -1, -1):
        share = 1.0 / A[k, k]
        for c in range(rows.shape[1]):
            rows[k, c] *= share
        for i in range(k):
            factor = A[i, k]
            if factor != 0.0:
                for c in range(rows.shape[1]):
                    rows[i, c] -= factor * rows[k, c]


@inline_kernel
def _three(of: FloatArray, row: int, begin: int) -> Three:
    """Return three numbers of a row, which then stay in registers."""
    return of[row, begin], of[row, begin + 1], of[row, begin + 2]


@inline_kernel
def _move(h: float, f: FloatArray, mobility: FloatArray, s: FloatArray) -> None:
    """Move the derivatives of a joint over a step: a Taylor series of their linear equation about its beginning.

    The loop is long on purpose, so that the compiler makes vectors of the lanes.
    """
    back, h2, h3, h4 = 0.5 * h, h * h / 2.0, h * h * h / 6.0, h * h * h * h / 24.0
    goes, drag, stiff, takes = _three(f, _GOES, 0), _three(f, _DRAG, 0), _three(f, _STIFF, 0), _three(f, _TAKES, 0)
    moves0, moves1, moves2 = goes[0] * mobility[0], goes[1] * mobility[1], goes[2] * mobility[2]
    pull0, pull1 = f[_PULL, MASSES], f[_PULL, MASSES + 1]
    damp0, damp1 = f[_DAMP, MASSES], f[_DAMP, MASSES + 1]
    for j in range(LANES):
        q0, q1, q2 = s[_Q + j], s[_Q + LANES + j], s[_Q + 2 * LANES + j]
        # A velocity that was not let begin does not come back.
        v0, v1, v2 = goes[0] * s[_V + j], goes[1] * s[_V + LANES + j], goes[2] * s[_V + 2 * LANES + j]
        # What is given at the beginning, from the middle of the step and its rate.
        r0, r1, r2 = s[_RATE + j], s[_RATE + LANES + j], s[_RATE + 2 * LANES + j]
        t0, t1 = s[_RATE + 3 * LANES + j], s[_RATE + 4 * LANES + j]
        g0, g1 = s[_GIVEN + j] - back * r0, s[_GIVEN + LANES + j] - back * r1
        g2 = s[_GIVEN + 2 * LANES + j] - back * r2
        d0, d1 = s[_GIVEN + 3 * LANES + j] - back * t0, s[_GIVEN + 4 * LANES + j] - back * t1
        # The derivatives of the velocities by time: the first, the second, the third, the fourth.
        near, far = pull0 * (q1 - q0) + damp0 * (v1 - v0) + d0, pull1 * (q2 - q1) + damp1 * (v2 - v1) + d1
        a0 = moves0 * (((stiff[0] * q0 - drag[0] * v0) + g0) + near)
        a1 = moves1 * (((stiff[1] * q1 - drag[1] * v1) + g1) + (far - takes[1] * near))
        a2 = moves2 * (((stiff[2] * q2 - drag[2] * v2) + g2) - takes[2] * far)
        near, far = pull0 * (v1 - v0) + damp0 * (a1 - a0) + t0, pull1 * (v2 - v1) + damp1 * (a2 - a1) + t1
        b0 = moves0 * (((stiff[0] * v0 - drag[0] * a0) + r0) + near)
        b1 = moves1 * (((stiff[1] * v1 - drag[1] * a1) + r1) + (far - takes[1] * near))
        b2 = moves2 * (((stiff[2] * v2 - drag[2] * a2) + r2) - takes[2] * far)
        near, far = pull0 * (a1 - a0) + damp0 * (b1 - b0), pull1 * (a2 - a1) + damp1 * (b2 - b1)
        c0 = moves0 * ((stiff[0] * a0 - drag[0] * b0) + near)
        c1 = moves1 * ((stiff[1] * a1 - drag[1] * b1) + (far - takes[1] * near))
        c2 = moves2 * ((stiff[2] * a2 - drag[2] * b2) - takes[2] * far)
        near, far = pull0 * (b1 - b0) + damp0 * (c1 - c0), pull1 * (b2 - b1) + damp1 * (c2 - c1)
        e0 = moves0 * ((stiff[0] * b0 - drag[0] * c0) + near)
        e1 = moves1 * ((stiff[1] * b1 - drag[1] * c1) + (far - takes[1] * near))
        e2 = moves2 * ((stiff[2] * b2 - drag[2] * c2) - takes[2] * far)
        m0, m1 = (h * v0 + h2 * a0) + (h3 * b0 + h4 * c0), (h * v1 + h2 * a1) + (h3 * b1 + h4 * c1)
        m2 = (h * v2 + h2 * a2) + (h3 * b2 + h4 * c2)
        s[_GONE + j], s[_GONE + LANES + j], s[_GONE + 2 * LANES + j] = m0, m1, m2
        s[_Q + j], s[_Q + LANES + j], s[_Q + 2 * LANES + j] = q0 + m0, q1 + m1, q2 + m2
        s[_V + j] = v0 + ((h * a0 + h2 * b0) + (h3 * c0 + h4 * e0))
        s[_V + LANES + j] = v1 + ((h * a1 + h2 * b1) + (h3 * c1 + h4 * e1))
        s[_V + 2 * LANES + j] = v2 + ((h * a2 + h2 * b2) + (h3 * c2 + h4 * e2))


@inline_kernel
def _move_tree(
    h: float, masses: FloatArray, pairs: IndexArray, f: FloatArray, M: FloatArray, K: FloatArray, C: FloatArray,
    left: FloatArray, rows: FloatArray, dq: FloatArray, dv: FloatArray, given: FloatArray, gone: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives of a tree over a step, by the implicit midpoint rule.

    The unknowns are the rates in its middle, those of the rotors behind springs first: each is tied to its link alone.
    """
    nd, n, count, half = len(dq), len(M), dq.shape[1], 0.5 * h
    last = nd - 1
    for i in range(nd):
        for j in range(nd):
            left[i, j] = 0.0
    for i in range(nd):
        inert, stiff, at = 2.0 / h * masses[i, 0, INERTIA], f[_STIFF, i], last - i
        left[at, at] = inert + f[_DRAG, i] - half * stiff
        for c in range(count):
            rows[at, c] = given[i, c] + inert * dv[i, c] + stiff * dq[i, c]
    for i in range(n):
        for j in range(n):
            inert, stiff = 2.0 / h * M[i, j], K[i, j]
            left[last - i, last - j] += inert + C[i, j] + half * stiff
            if inert != 0.0 or stiff != 0.0:  # not as of two arms on one base
                for c in range(count):
                    rows[last - i, c] += inert * dv[j, c] - stiff * dq[j, c]
    for s in range(len(pairs)):
        one, two, x = int(pairs[s, 0]), int(pairs[s, 1]), nd + s
        for i, other, push in ((one, two, 2.0 - f[_TAKES, one]), (two, one, -1.0)):
            stiff, tie = abs(push) * f[_PULL, x], abs(push) * (f[_DAMP, x] + half * f[_PULL, x])
            left[last - i, last - i] += tie
            left[last - i, last - other] -= tie
            for c in range(count):
                rows[last - i, c] += push * given[x, c] - stiff * (dq[i, c] - dq[other, c])
    for i in range(nd):
        if f[_GOES, i] == 0.0:
            for j in range(nd):
                left[last - i, j] = 1.0 if j == last - i else 0.0
            for c in range(count):
                rows[last - i, c] = 0.0
    _solve(left, rows)
    for i in range(nd):
        for c in range(count):
            mean = rows[last - i, c]
            gone[i, c] = h * mean
            dq[i, c] += h * mean
            dv[i, c] = f[_GOES, i] * (2.0 * mean - dv[i, c])


@compile_kernel
def _shift_edges(
    masses: FloatArray, rotors: IndexArray, delays: IntArray, tape: FloatArray, last: int, row: int,
    jumps: NDArray[np.bool_], M: FloatArray, left: FloatArray, kicks: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Add to the velocities what later edges of the torques, as a step begins, take from them.

    An edge of one motor's torque is all that changes in the equation of the mass that it drives, which may come loose.
    It lies between the last step before and the first that lasts.
    """
    n, nd = len(M), len(masses)
    after, before, modes = STATE + 2 * nd, STATE + 3 * nd, STATE + 4 * nd
    for i in range(n):
        held = tape[row, modes + i] == 0.0
        for j in range(n):
            left[i, j] = M[i, j] if not held else 0.0
        left[i, i] += 1.0 if held else masses[i, 0, INERTIA]
    for d in range(len(delays)):
        c, j, r = delays[d, 0], delays[d, 1], rotors[delays[d, 1]]
        for i in range(n):
            kicks[i, d] = 0.0
        if jumps[j] and r >= n:
            dv[r, c] -= tape[row, after + r] - tape[last, before + r]
        elif jumps[j] and tape[row, modes + r] != 0.0:
            for i in range(n):
                kicks[r, d] -= left[r, i] * (tape[row, after + i] - tape[last, before + i])
    _solve(left, kicks)
    for d in range(len(delays)):
        for i in range(n):
            dv[i, delays[d, 0]] += kicks[i, d]


@compile_kernel
def _add_moved_links(
    rotors: IndexArray, ends: IndexArray, f: FloatArray, ties: IntArray, M: FloatArray, C: FloatArray, K: FloatArray,
    h: float, whole: float, dq: FloatArray, gone: FloatArray, bent: FloatArray, gained: FloatArray,
    moved_links: FloatArray,
) -> None:  # fmt: skip
    """Add what the links' changes of position, rate and velocity gained in a piece of h s add to the motors' torques.

    A motor feels them by its spring, or, of a rigid joint, by the links that hang on others. What velocities gained
    before the event that ended the piece is `bent`.
    """
    axes, count = rotors.size, dq.shape[1]
    for i in range(axes):
        for j in range(axes):
            link = ends[j]
            if rotors[j] == link or (rotors[i] != ends[i] and i != j):  # moved as prescribed, or on another's spring
                continue
            inert = M[i, j] / whole if rotors[i] == ends[i] else 0.0
            damping = (C[i, j] if ties[i] < 0 else -f[_DAMP, ties[i]]) / whole
            stiffness = h / whole * (K[i, j] if ties[i] < 0 else -f[_PULL, ties[i]])
            for c in range(count):
                middle = dq[link, c] - 0.5 * gone[link, c] - h / 12.0 * bent[link, c]
                moved_links[i, c] += inert * gained[link, c] + damping * gone[link, c] + stiffness * middle


@inline_kernel
def _pass_event(
    tape: FloatArray, row: int, nd: int, pairs: IndexArray, seeds: Seeds, springs: int, dq: FloatArray, dv: FloatArray,
    lead: FloatArray,
) -> None:  # fmt: skip
    """Change the velocities at the event that ended a step: by `lead`, s, it comes earlier."""
    event, every, after, before = int(tape[row, EVENT]), nd + len(pairs), STATE + 2 * nd, STATE + 3 * nd
    modes, then, moves, count = STATE + 4 * nd, row + 1, False, dq.shape[1]
    if event < nd and tape[row, modes + event] != 0.0:
        largest, slowing = 0.0, tape[row, before + event]
        for i in range(nd):
            largest = max(largest, abs(tape[row, before + i]))
        moves = abs(slowing) > _TURNING * largest
        for c in range(count if moves else 0):
            lead[c] = dv[event, c] / slowing
    elif event >= every + nd:  # the damper may act on one side of the edge only
        s, at = event - every - nd, modes + event
        one, two = pairs[s, 0], pairs[s, 1]
        rate = tape[then, STATE + nd + two] - tape[then, STATE + nd + one]
        moves = rate != 0.0
        old, new = tape[row, at], tape[then, at]
        edge, side = int(max(abs(old), abs(new))), math.copysign(1.0, old + new)
        for c in range(count if moves else 0):
            lead[c] = (dq[two, c] - dq[one, c]) / rate
        for e in range(seeds.begin[springs + s, edge], seeds.begin[springs + s, edge + 1] if moves else 0):
            if seeds.numbers[e] == BEGIN:
                lead[seeds.columns[e]] -= side * seeds.values[e] / rate
    for i in range(nd if moves else 0):
        jump = tape[then, after + i] - tape[row, before + i]
        for c in range(count):
            dv[i, c] += jump * lead[c]


@compile_kernel
def follow(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, torques_before: FloatArray,
    torques: FloatArray, excess: FloatArray, tape: FloatArray, seeds: Seeds, moved: Moved, slopes: Slopes,
) -> None:  # fmt: skip
    """Fill the derivatives of a finished run; of a joint there are `LANES` parameters.

    Args:
        plant: of `kernels.engine.run`, as the run left it.
        tree: the same.
        inertials: the same.
        loop: the same.
        torques_before: the same.
        torques: (axes, clock) what it wrote.
        excess: the same.
        tape: the same, its filled rows.
        seeds: how the numbers of the plant depend on the parameters.
        moved: how its first state and the controllers do.
        slopes: out.
    """
    masses, springs, places, pairs, rotors, carriers = plant
    lags, every, post, lengths, laws = loop.lags, loop.every, loop.post, loop.lengths, loop.feedback
    command, states, moved_links, dz = slopes.command, slopes.states, slopes.links, moved.dz
    n, nd, ns, axes, count = len(inertials), len(masses), len(pairs), len(torques), moved.dq.shape[1]
    parts, steps, states_of_law, elements = lags.shape[1], torques.shape[1], dz.shape[1], excess.shape[2]
    controlled, prescribed = command.shape[2] > 0, moved_links.shape[1] > 0
    md, ms = (MASSES, SPRINGS) if tree is None else (nd, ns)
    every_row, last_row = md + ms, len(tape) - 1
    begin, end = 2 * md, 2 * md + 3 * every_row
    s = aligned_zeros((end + md) * count)
    x = s.reshape((end + md, count))
    dq, dv, given, rate = x[:md], x[md:begin], x[begin : begin + every_row], x[begin + every_row : end - every_row]
    turned, gone, dw, dtau = x[end - every_row : end], x[end:], np.zeros((every_row, count)), np.zeros((axes, count))
    lead, gained, bent = np.zeros(count), np.zeros((md, count)), np.zeros((md, count))
    fresh, raw, taken = np.zeros((states_of_law, count)), np.zeros((elements, count)), np.zeros((elements, count))
    mean, drive, mobility = np.zeros((4, md)), np.zeros(md), np.zeros(md)
    f, k, later = (
        np.zeros((_FACTORS, every_row)),
        np.zeros((every_row + len(places), MASS)),
        np.zeros((every_row + len(places), MASS)),
    )
    room, Y, M, K, C = np.zeros((n, ROOM)), np.zeros((n, 10 * n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    of_links, left, rows = np.zeros((n, 10 * n)), np.zeros((md, md)), np.zeros((md, count))
    kicks, of_edge, jumps = np.zeros((n, len(seeds.delays))), np.zeros((n, n)), np.zeros(axes, dtype=np.bool_)
    ties, ends = np.full(axes, -1), rotors.copy()
    for i in range(nd):
        mobility[i] = 1.0 / masses[i, 0, INERTIA]
        assign(dq[i], moved.dq[i])
        assign(dv[i], moved.dv[i])
    for i in range(ns if prescribed else 0):
        for j in range(axes):
            for side in range(2):
                if pairs[i, side] == rotors[j]:
                    ties[j], ends[j] = md + i, pairs[i, 1 - side]
    # A joint's law of two states at most has numbers that stay in registers.
    small = tree is None and controlled and states_of_law <= 2 and laws.D.size == 1
    scratch = aligned_zeros(SCRATCH)
    law = begin_small(scratch, laws, states_of_law if small else 0, dz[0], moved.limits[0, :, :LANES])
    limit = laws.limits[0, 0]
    period, row = np.sum(lengths), 1
    for step in range(steps):
        if step % OFTEN == 0:
            for i in range(2 * md * count):
                s[i] = s[i] if abs(s[i]) > NOTHING else 0.0
            for i in range(2 * LANES):
                scratch[MEMORY + i] = scratch[MEMORY + i] if abs(scratch[MEMORY + i]) > NOTHING else 0.0
        for j in range(axes if controlled else 0):
            own = step // every[j]
            if step % every[j] != 0:  # this controller holds
                assign(command[j, step], command[j, step - 1])
                continue
            if small:
                assign(scratch[POSITION : POSITION + LANES], dq[0])
                control_small(scratch, law, torques[0, step], limit, moved.explicit[0], moved.first, step, command[0])
            else:
                control_slopes(
                    laws, j, own, excess[j, own], dq[rotors[j]], dz[j], fresh, raw, taken, moved.explicit[j],
                    moved.first, moved.limits[j], command[j, step],
                )  # fmt: skip
        for i in range(len(seeds.pushes)):
            j = seeds.pushes[i, 1]
            if step % every[j] == 0:  # one that holds has it from its last period
                command[j, step, seeds.pushes[i, 0]] += seeds.pushed[i, step]
        time = step * period
        for part in range(parts):
            at = step * parts + part
            for i in range(min(nd, 2) if len(states) > 0 else 0):
                assign(states[at, 2 * i], dq[i])
                assign(states[at, 2 * i + 1], dv[i])
            if row >= last_row:
                return
            for j in range(axes):
                source = step - lags[j, part]
                jumps[j] = source != (step - lags[j, part - 1] if part > 0 else step - 1 - lags[j, parts - 1])
                drive[rotors[j]] = torques[j, source] + post[j, source] if source >= 0 else torques_before[j]
                if controlled:
                    assign(dtau[j], command[j, max(source, 0)])
            last, edge = row - 1, len(seeds.delays) > 0 and row > 1
            while tape[row, PART] == at:
                if row >= last_row:
                    return
                h = tape[row, LENGTH]
                for i in range(nd if prescribed else 0):
                    for c in range(count):
                        gained[i, c], gone[i, c] = -dv[i, c], 0.0
                if h > 0.0:
                    _mean_motion(tape, row, nd, mean)
                    if tree is not None:
                        place, speed, turn = mean[_PLACE, :n], mean[_SPEED, :n], mean[_CHANGE, :n]
                        linearised_equations(tree, inertials, place, speed, turn, room, M, K, C)
                    if edge:
                        _shift_edges(masses, rotors, seeds.delays, tape, last, row, jumps, M, of_edge, kicks, dv)
                        edge = False
                    _fill_factors(
                        masses, springs, pairs, carriers, tape, row, mean, drive, time + 0.5 * h, md, f, k, later
                    )
                    _fill_places(places, every_row, mean, f, k, later)
                    for i in range(begin * count, end * count):
                        s[i] = 0.0
                    bands = STATE + 5 * nd + ns
                    for i in range(nd):
                        _add_seeds(seeds, i, int(tape[row, bands + i]), i, WINDING, f, k, later, given, rate, turned)
                        if f[_HALF, i] != 0.0 or f[_WINDS, i] != 0.0:
                            for c in range(count):
                                given[i, c] += f[_HALF, i] * dw[i, c] - f[_WINDS, i] * dq[i, c]
                    for spring in range(ns):
                        i, piece = md + spring, int(abs(tape[row, bands + nd + spring]))
                        one, two = pairs[spring, 0], pairs[spring, 1]
                        _add_seeds(seeds, i, piece, i, SLIDING, f, k, later, given, rate, turned)
                        if f[_HALF, i] != 0.0 or f[_WINDS, i] != 0.0:
                            for c in range(count):
                                stretched = dq[two, c] - dq[one, c]
                                given[i, c] += f[_HALF, i] * dw[i, c] - f[_WINDS, i] * stretched
                    for i in range(len(places)):
                        _add_seeds(seeds, every_row + i, 0, int(places[i, WHERE]), -1, f, k, later, given, rate, turned)
                    for j in range(axes if controlled else 0):
                        r = rotors[j]
                        for c in range(count):
                            given[r, c] += (2.0 - f[_TAKES, r]) * dtau[j, c]
                    if tree is None:
                        _move(h, f, mobility, s)
                    else:
                        if len(seeds.links) > 0 and len(tree.joints) > 0:
                            joints = tree.joints
                            regressor(
                                tree, of_joints(joints, place), of_joints(joints, speed), of_joints(joints, turn),
                                of_links,
                            )  # fmt: skip
                            for c in range(10 * n):
                                assign(Y[:, c], of_joints(joints.T, of_links[:, c]))
                        elif len(seeds.links) > 0:
                            regressor(tree, place, speed, turn, Y)
                        for e in range(len(seeds.links)):
                            for i in range(n):
                                given[i, seeds.links[e, 0]] -= Y[i, 10 * seeds.links[e, 1] + seeds.links[e, 2]]
                        _move_tree(h, masses, pairs, f, M, K, C, left, rows, dq, dv, given, gone)
                    for i in range(nd):
                        if masses[i, 0, WINDING] > 0.0:
                            for c in range(count):
                                dw[i, c] = f[_LEFT, i] * dw[i, c] + (f[_GAINS, i] * gone[i, c] + turned[i, c])
                    for spring in range(ns):
                        i, one, two = md + spring, pairs[spring, 0], pairs[spring, 1]
                        if springs[spring, 0, SLIDING] > 0.0 or f[_TURNS, i] != 0.0:
                            for c in range(count):
                                stretched = gone[two, c] - gone[one, c]
                                dw[i, c] = f[_LEFT, i] * dw[i, c] + (f[_GAINS, i] * stretched + turned[i, c])
                time += h
                for i in range(nd if prescribed else 0):
                    for c in range(count):
                        bent[i, c] = gained[i, c] + dv[i, c]
                if tape[row, EVENT] >= 0.0:
                    _pass_event(tape, row, nd, pairs, seeds, md, dq, dv, lead)
                if prescribed:
                    for i in range(nd):
                        for c in range(count):
                            gained[i, c] += dv[i, c]
                    _add_moved_links(
                        rotors, ends, f, ties, M, C, K, h, lengths[part], dq, gone, bent, gained, moved_links[:, at]
                    )
                row += 1
