"""The derivatives of a simulation by its parameters, along the steps of `kernels.engine`, compiled.

The run has left a tape of its steps. Within a step the variational equation is linear; its coefficients are taken at
the mean of the motion, where a Taylor series of order 4 follows a column of derivatives per parameter. What winds up
has the derivative of its closed form. At an event the forces go on where they were, so nothing changes, except where a
mass stops: the derivative of its velocity is scaled by the acceleration after over that before; and where a damper acts
on one side of an edge only: the accelerations' jump kicks the velocities as the time of the event moves. A delay moves
the edges of the torque, and each kicks the motor's velocity by the difference of the accelerations.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.drive import IntArray, SampledLoop
from jointid.simulation.kernels.drive_sensitivities import (
    LANES,
    MEMORY,
    NOTHING,
    OFTEN,
    POSITION,
    SCRATCH,
    Columns,
    Slopes,
    aligned_zeros,
    begin_small,
    control_slopes,
    control_small,
)
from jointid.simulation.kernels.engine import (
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
    LENGTH,
    MASS,
    OFFSET,
    PART,
    PER_TORQUE,
    RATE,
    SIN,
    SLIDING,
    SLIPS,
    SPRING,
    STATE,
    STIFFNESS,
    VISCOUS,
    VISCOUS_DRIFT,
    WAVE,
    WHERE,
    WINDING,
    IndexArray,
    Plant,
    place_force,
    spring_torque,
    winding,
)

_MASSES, _SPRINGS = 3, 2
# Rows of the derivatives, LANES long: positions and velocities of the masses, what is wound up of masses and springs,
# the torque, and what forces that follow a position give each mass, with its rate.
_Q, _V, _W, _TORQUE, _PLACED, _MOVES = (LANES * row for row in (0, 3, 6, 11, 12, 15))
_MASS_SEEDS, _SPRING_SEEDS = 18, 18 + _MASSES * MASS
_ROWS = _SPRING_SEEDS + _SPRINGS * SPRING
# Factors of a step: of each mass whether it moves, its drag and stiffness, how much of the torque that it carries it
# takes; of masses, then of springs, how the derivative of what is wound up enters the force, what of it is left at the
# end, what it gains with the place and with the rate of winding; of springs stiffness and damping, the torque and its
# rate.
GOES, DRAG, STIFF, TAKES, HALF, WINDS, LEFT, GAINS, TURNS, PULL, DAMP, PULLED, GROWS = range(13)
FACTORS = 13
# Rows of the mean motion of a step.
PLACE, SPEED, CHANGE, JERK = range(4)


Five: TypeAlias = tuple[float, float, float, float, float]


@inline_kernel
def _five(of: FloatArray, i: int, begin: int) -> Five:
    """Return five numbers of a row, which then stay in registers."""
    return of[i, begin], of[i, begin + 1], of[i, begin + 2], of[i, begin + 3], of[i, begin + 4]


@inline_kernel
def _by_five(k: Five, seeds: FloatArray, row: int, j: int) -> float:
    """Return the sum of five factors times five rows of derivatives, of one column."""
    at = row * LANES + j
    first = (k[0] * seeds[at] + k[1] * seeds[at + LANES]) + k[2] * seeds[at + 2 * LANES]
    return float(first + (k[3] * seeds[at + 3 * LANES] + k[4] * seeds[at + 4 * LANES]))


@inline_kernel
def _wind(f: FloatArray, i: int, w: float, way: float, x: float, rate: float, force: float) -> float:
    """Write the factors of what is wound up in a step; return that of its rate in the force, half way through."""
    f[HALF, i], f[WINDS, i], f[LEFT, i], f[GAINS, i], f[TURNS, i] = 0.0, 0.0, 0.0, 0.0, 0.0
    if w == way:
        return 0.0
    half, left = math.exp(min(-0.5 * way * x * rate, 1.0)), math.exp(min(-way * x * rate, 1.0))
    slope = (way - w) * way
    f[HALF, i], f[WINDS, i], f[LEFT, i] = force * half, force * slope * half * rate, left
    f[GAINS, i], f[TURNS, i] = slope * left * rate, slope * left * x
    return force * slope * half


@inline_kernel
def mean_motion(tape: FloatArray, row: int, nd: int, mean: FloatArray) -> None:
    """Fill the means of positions, velocities, accelerations and their rates over a step, from its row and the next."""
    h, inverse, then = tape[row, LENGTH], 1.0 / tape[row, LENGTH], row + 1
    for i in range(nd):
        q, v = tape[row, STATE + i], tape[row, STATE + nd + i]
        q1, v1 = tape[then, STATE + i], tape[then, STATE + nd + i]
        middle = 0.5 * (q + q1) + 0.125 * h * (v - v1)
        mean[PLACE, i], mean[SPEED, i] = (q + 4.0 * middle + q1) / 6.0, (q1 - q) * inverse
        mean[CHANGE, i] = (v1 - v) * inverse
        mean[JERK, i] = (tape[row, STATE + 3 * nd + i] - tape[row, STATE + 2 * nd + i]) * inverse


@inline_kernel
def fill_factors(
    masses: FloatArray, springs: FloatArray, pairs: IndexArray, carriers: IntArray, tape: FloatArray, row: int,
    mean: FloatArray,
    drive: FloatArray, time: float, first: int, f: FloatArray, k: FloatArray, later: FloatArray, ks: FloatArray,
    slater: FloatArray,
) -> None:  # fmt: skip
    """Fill the factors of a step, a row of the tape, and those of the numbers in the forces, with their rates.

    The second are taken as they are in the middle of the step, and change linearly in it. `first` is the column of the
    first spring among the factors.
    """
    nd, ns, h = masses.shape[0], pairs.shape[0], tape[row, LENGTH]
    modes, at, wound = STATE + 4 * nd, STATE + 5 * nd + ns, STATE + 6 * nd + 2 * ns
    for s in range(ns):
        one, two, piece = pairs[s, 0], pairs[s, 1], int(tape[row, at + nd + s])
        p, side = np.uint64(abs(piece)), (0.0 if piece == 0 else math.copysign(1.0, piece))
        e, de = mean[PLACE, two] - mean[PLACE, one], mean[SPEED, two] - mean[SPEED, one]
        dde = mean[CHANGE, two] - mean[CHANGE, one]
        w, way = tape[row, wound + nd + s], tape[row, modes + nd + s]
        slides, slips = springs[s, p, SLIDING], springs[s, p, SLIPS]
        half = winding(w, way, 0.5 * de * h, slides)
        turns = slides * (de - abs(de) * half)
        pull, damping, x = (
            springs[s, p, STIFFNESS] + 3.0 * springs[s, p, CUBIC] * e * e,
            springs[s, p, DAMPING],
            first + s,
        )
        f[PULLED, x] = side * springs[s, p, HELD] + spring_torque(
            springs[s, p, STIFFNESS], springs[s, p, CUBIC], damping, slips, e, de, half
        )
        f[GROWS, x] = pull * de + damping * dde + slips * turns
        f[WINDS, x], ks[s, SLIDING] = 0.0, 0.0
        if slips > 0.0:
            ks[s, SLIDING] = 0.5 * _wind(f, x, w, way, de * h, slides, slips) * de * h
        f[PULL, x], f[DAMP, x] = pull + f[WINDS, x], damping
        ks[s, STIFFNESS], ks[s, DAMPING], ks[s, CUBIC], ks[s, SLIPS], ks[s, HELD] = e, de, e * e * e, half, side
        slater[s, STIFFNESS], slater[s, DAMPING], slater[s, CUBIC] = de, dde, 3.0 * e * e * de
        slater[s, SLIPS] = turns
    for i in range(nd):
        mode, speed, rate, band = tape[row, modes + i], mean[SPEED, i], mean[CHANGE, i], np.uint64(tape[row, at + i])
        carried, grows = drive[i], 0.0
        if carriers[i] >= 0:
            carried, grows = f[PULLED, first + carriers[i]], f[GROWS, first + carriers[i]]
        way = math.copysign(1.0, speed) if mode == FREE else mode
        back, moves = (1 if way < 0.0 else 0), (1.0 if mode != 0.0 else 0.0)
        # A torque that goes through 0 within the step: the mean of its size, and of its sign.
        low, high = carried - 0.5 * h * grows, carried + 0.5 * h * grows
        sign, size = math.copysign(1.0, carried), abs(carried)
        if low * high < 0.0:
            sign, size = (abs(high) - abs(low)) / (high - low), (high * high + low * low) / (2.0 * abs(high - low))
        share, turns, winds, x = way, 0.0, masses[i, 0, WINDING], speed * h
        grip = masses[i, band, COULOMB + back] + masses[i, 0, COULOMB_DRIFT] * time + masses[i, 0, PER_TORQUE] * size
        f[STIFF, i], k[i, WINDING] = 0.0, 0.0
        if winds > 0.0:
            share = winding(tape[row, wound + i], mode, 0.5 * x, winds)
            turns = winds * (speed - abs(speed) * share)
            gain = _wind(f, i, tape[row, wound + i], mode, x, winds, -grip)
            f[STIFF, i], k[i, WINDING] = f[WINDS, i], 0.5 * gain * x
        f[GOES, i] = moves
        f[DRAG, i] = masses[i, band, VISCOUS + back] + masses[i, 0, VISCOUS_DRIFT] * time
        f[TAKES, i] = 1.0 + share * masses[i, 0, PER_TORQUE] * sign
        k[i, INERTIA], later[i, INERTIA], k[i, OFFSET] = -rate, -mean[JERK, i], -1.0
        k[i, VISCOUS + back], later[i, VISCOUS + back] = -speed, -rate
        k[i, VISCOUS + 1 - back], later[i, VISCOUS + 1 - back] = 0.0, 0.0
        k[i, COULOMB + back], later[i, COULOMB + back] = -share, -turns
        k[i, COULOMB + 1 - back], later[i, COULOMB + 1 - back] = 0.0, 0.0
        k[i, VISCOUS_DRIFT], later[i, VISCOUS_DRIFT] = -speed * time, -(rate * time + speed)
        k[i, COULOMB_DRIFT], later[i, COULOMB_DRIFT] = -share * time, -(turns * time + share)
        k[i, PER_TORQUE], later[i, PER_TORQUE] = -share * size, -(turns * size + share * sign * grows)


@inline_kernel
def _follow_places(places: FloatArray, dplaces: FloatArray, mean: FloatArray, f: FloatArray, s: FloatArray) -> None:
    """Write the derivatives of position-dependent forces on each mass, and add their stiffness."""
    for i in range(2 * _MASSES * LANES):
        s[_PLACED + i] = 0.0
    for force in range(places.shape[0]):
        i = int(places[force, WHERE])
        place, speed, wave = mean[PLACE, i], mean[SPEED, i], places[force, WAVE]
        cos, sin = math.cos(wave * place), math.sin(wave * place)
        cosine, sine, rate = places[force, COS], places[force, SIN], places[force, RATE]
        f[STIFF, i] -= place_force(cosine, sine, rate, wave, place)[1]
        for j in range(LANES):
            dcos, dsin, drate = dplaces[force, COS, j], dplaces[force, SIN, j], dplaces[force, RATE, j]
            s[_PLACED + i * LANES + j] -= cos * dcos + sin * dsin + place * drate
            s[_MOVES + i * LANES + j] -= speed * (wave * (cos * dsin - sin * dcos) + drate)


@inline_kernel
def _move(
    h: float, f: FloatArray, mobility: FloatArray, k: FloatArray, later: FloatArray, ks: FloatArray,
    slater: FloatArray, s: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives over a step: a Taylor series of their linear equation about its beginning.

    The loop is long on purpose, so that the compiler makes vectors of the lanes.
    """
    back, h2, h3, h4 = 0.5 * h, h * h / 2.0, h * h * h / 6.0, h * h * h * h / 24.0
    goes, drag, stiff, takes = _five(f, GOES, 0), _five(f, DRAG, 0), _five(f, STIFF, 0), _five(f, TAKES, 0)
    moves0, moves1, moves2 = goes[0] * mobility[0], goes[1] * mobility[1], goes[2] * mobility[2]
    pull, damp, held0, held1 = _five(f, PULL, 0), _five(f, DAMP, 0), ks[0, HELD], ks[1, HELD]
    half, winds, left = _five(f, HALF, 0), _five(f, WINDS, 0), _five(f, LEFT, 0)
    gains, turns = _five(f, GAINS, 0), _five(f, TURNS, 0)
    k0, k1, k2, k3, k4, k5 = (
        _five(k, 0, 0),
        _five(k, 0, 5),
        _five(k, 1, 0),
        _five(k, 1, 5),
        _five(k, 2, 0),
        _five(k, 2, 5),
    )
    l0, l1, l2, l3 = _five(later, 0, 0), _five(later, 0, 5), _five(later, 1, 0), _five(later, 1, 5)
    l4, l5, n0, n1 = _five(later, 2, 0), _five(later, 2, 5), _five(ks, 0, 0), _five(ks, 1, 0)
    o0, o1 = _five(slater, 0, 0), _five(slater, 1, 0)
    for j in range(LANES):
        q0, q1, q2 = s[_Q + j], s[_Q + LANES + j], s[_Q + 2 * LANES + j]
        # A velocity that was not let begin does not come back.
        v0, v1, v2 = goes[0] * s[_V + j], goes[1] * s[_V + LANES + j], goes[2] * s[_V + 2 * LANES + j]
        w0, w1, w3, w4 = s[_W + j], s[_W + LANES + j], s[_W + 3 * LANES + j], s[_W + 4 * LANES + j]
        # What is given in the middle of the step, its rate, and so what is at the beginning.
        r0 = (_by_five(l0, s, _MASS_SEEDS, j) + _by_five(l1, s, _MASS_SEEDS + 5, j)) + s[_MOVES + j]
        r1 = (_by_five(l2, s, _MASS_SEEDS + MASS, j) + _by_five(l3, s, _MASS_SEEDS + MASS + 5, j)) + s[
            _MOVES + LANES + j
        ]
        r2 = _by_five(l4, s, _MASS_SEEDS + 2 * MASS, j) + _by_five(l5, s, _MASS_SEEDS + 2 * MASS + 5, j)
        t0, t1 = _by_five(o0, s, _SPRING_SEEDS, j), _by_five(o1, s, _SPRING_SEEDS + SPRING, j)
        g0 = (_by_five(k0, s, _MASS_SEEDS, j) + _by_five(k1, s, _MASS_SEEDS + 5, j)) + (s[_PLACED + j] - back * r0)
        g1 = (_by_five(k2, s, _MASS_SEEDS + MASS, j) + _by_five(k3, s, _MASS_SEEDS + MASS + 5, j)) + (
            s[_PLACED + LANES + j] - back * r1
        )
        g2 = (_by_five(k4, s, _MASS_SEEDS + 2 * MASS, j) + _by_five(k5, s, _MASS_SEEDS + 2 * MASS + 5, j)) - back * r2
        g0 += (2.0 - takes[0]) * s[_TORQUE + j] + (half[0] * w0 - winds[0] * q0)
        g1 += half[1] * w1 - winds[1] * q1
        d0 = (_by_five(n0, s, _SPRING_SEEDS, j) - back * t0) + (half[3] * w3 - winds[3] * (q1 - q0))
        d1 = (_by_five(n1, s, _SPRING_SEEDS + SPRING, j) - back * t1) + (half[4] * w4 - winds[4] * (q2 - q1))
        d0 += held0 * s[(_SPRING_SEEDS + HELD) * LANES + j]
        d1 += held1 * s[(_SPRING_SEEDS + SPRING + HELD) * LANES + j]
        # The derivatives of the velocities by time: the first, the second, the third, the fourth.
        near, far = pull[3] * (q1 - q0) + damp[3] * (v1 - v0) + d0, pull[4] * (q2 - q1) + damp[4] * (v2 - v1) + d1
        a0 = moves0 * (((stiff[0] * q0 - drag[0] * v0) + g0) + near)
        a1 = moves1 * (((stiff[1] * q1 - drag[1] * v1) + g1) + (far - takes[1] * near))
        a2 = moves2 * (((stiff[2] * q2 - drag[2] * v2) + g2) - takes[2] * far)
        near, far = pull[3] * (v1 - v0) + damp[3] * (a1 - a0) + t0, pull[4] * (v2 - v1) + damp[4] * (a2 - a1) + t1
        b0 = moves0 * (((stiff[0] * v0 - drag[0] * a0) + r0) + near)
        b1 = moves1 * (((stiff[1] * v1 - drag[1] * a1) + r1) + (far - takes[1] * near))
        b2 = moves2 * (((stiff[2] * v2 - drag[2] * a2) + r2) - takes[2] * far)
        near, far = pull[3] * (a1 - a0) + damp[3] * (b1 - b0), pull[4] * (a2 - a1) + damp[4] * (b2 - b1)
        c0 = moves0 * ((stiff[0] * a0 - drag[0] * b0) + near)
        c1 = moves1 * ((stiff[1] * a1 - drag[1] * b1) + (far - takes[1] * near))
        c2 = moves2 * ((stiff[2] * a2 - drag[2] * b2) - takes[2] * far)
        near, far = pull[3] * (b1 - b0) + damp[3] * (c1 - c0), pull[4] * (b2 - b1) + damp[4] * (c2 - c1)
        e0 = moves0 * ((stiff[0] * b0 - drag[0] * c0) + near)
        e1 = moves1 * ((stiff[1] * b1 - drag[1] * c1) + (far - takes[1] * near))
        e2 = moves2 * ((stiff[2] * b2 - drag[2] * c2) - takes[2] * far)
        m0, m1 = (h * v0 + h2 * a0) + (h3 * b0 + h4 * c0), (h * v1 + h2 * a1) + (h3 * b1 + h4 * c1)
        m2 = (h * v2 + h2 * a2) + (h3 * b2 + h4 * c2)
        s[_Q + j], s[_Q + LANES + j], s[_Q + 2 * LANES + j] = q0 + m0, q1 + m1, q2 + m2
        s[_V + j] = v0 + ((h * a0 + h2 * b0) + (h3 * c0 + h4 * e0))
        s[_V + LANES + j] = v1 + ((h * a1 + h2 * b1) + (h3 * c1 + h4 * e1))
        s[_V + 2 * LANES + j] = v2 + ((h * a2 + h2 * b2) + (h3 * c2 + h4 * e2))
        s[_W + j] = left[0] * w0 + (gains[0] * m0 + turns[0] * s[(_MASS_SEEDS + WINDING) * LANES + j])
        s[_W + LANES + j] = left[1] * w1 + (gains[1] * m1 + turns[1] * s[(_MASS_SEEDS + MASS + WINDING) * LANES + j])
        s[_W + 3 * LANES + j] = left[3] * w3 + (
            gains[3] * (m1 - m0) + turns[3] * s[(_SPRING_SEEDS + SLIDING) * LANES + j]
        )
        s[_W + 4 * LANES + j] = left[4] * w4 + (
            gains[4] * (m2 - m1) + turns[4] * s[(_SPRING_SEEDS + SPRING + SLIDING) * LANES + j]
        )


@inline_kernel
def _take_seeds(
    dmasses: FloatArray, dsprings: FloatArray, tape: FloatArray, row: int, at: int, masses: int, pairs: int,
    taken: IntArray, s: FloatArray,
) -> None:  # fmt: skip
    """Write the derivatives of the numbers in the bands and pieces of a step where the loop over columns reads them."""
    for i in range(masses + pairs):
        now = int(abs(tape[row, at + i]))
        if now == taken[i]:
            continue
        taken[i] = now
        if i < masses:
            begin = (_MASS_SEEDS + i * MASS) * LANES
            assign(s[begin : begin + MASS * LANES], dmasses[i, now].reshape(-1))
        else:
            begin = (_SPRING_SEEDS + (i - masses) * SPRING) * LANES
            assign(s[begin : begin + SPRING * LANES], dsprings[i - masses, now].reshape(-1))


@inline_kernel
def _pass_event(
    tape: FloatArray, row: int, masses: FloatArray, pairs: IndexArray, dsprings: FloatArray, s: FloatArray
) -> None:
    """Change the derivatives at the event that ended a step, from its row and the next."""
    nd, event, then = masses.shape[0], int(tape[row, EVENT]), row + 1
    every = nd + pairs.shape[0]
    after, before, modes = STATE + 2 * nd, STATE + 3 * nd, STATE + 4 * nd
    if event < nd and tape[row, modes + event] != 0.0 and masses[event, 0, WINDING] == 0.0:
        # Friction grows where a mass turns round, so the ratio is between 0 and 1; grazing leaves 0/0.
        slowing = tape[row, before + event]
        ratio = min(max(tape[then, after + event] / slowing, 0.0), 1.0) if slowing != 0.0 else 0.0
        for j in range(LANES):
            s[_V + event * LANES + j] *= ratio
    elif event >= every + nd:
        spring, at = event - every - nd, modes + event
        one, two, old, new = pairs[spring, 0], pairs[spring, 1], tape[row, at], tape[then, at]
        edge, side = int(max(abs(old), abs(new))), math.copysign(1.0, old + new)
        rate = tape[then, STATE + nd + two] - tape[then, STATE + nd + one]
        for j in range(LANES if rate != 0.0 else 0):
            moved = s[_Q + two * LANES + j] - s[_Q + one * LANES + j]
            lead = (moved - side * dsprings[spring, edge, BEGIN, j]) / rate
            for i in range(nd):
                s[_V + i * LANES + j] += (tape[then, after + i] - tape[row, before + i]) * lead


@compile_kernel
def follow(
    plant: Plant, dmasses: FloatArray, dsprings: FloatArray, dplaces: FloatArray, loop: SampledLoop, before: float,
    u: FloatArray, excess: FloatArray, tape: FloatArray, columns: Columns, slopes: Slopes,
) -> None:  # fmt: skip
    """Fill the derivatives as `kernels.drive_sensitivities.follow` does, of a joint's run of `kernels.engine`.

    Args:
        plant: of the run, as it left it.
        dmasses: (masses, bands, MASS, columns) derivatives of its masses.
        dsprings: (springs, pieces, SPRING, columns) of its springs.
        dplaces: (forces, 5, columns) of its forces that follow a position.
        loop: what drove the run.
        before: torque that acted before its first period.
        u: (periods,) that acted.
        excess: (periods, elements) what limits and gates took away.
        tape: its steps.
        columns: of what else depends on the parameters.
        slopes: out.
    """
    masses, springs, places, pairs, _, carriers = plant
    lengths, lags, feedback, post = loop.lengths, loop.lags[0], loop.feedback, loop.post[0]
    explicit, first_explicit, ddelay, dlimits = columns.explicit, columns.first_explicit, columns.delay, columns.limits
    S, Z, du, dstates = columns.start, columns.memory, slopes.u, slopes.states
    n, parts, nz, elements = masses.shape[0], lengths.size, feedback.A.shape[2], feedback.limits.size
    s, scratch = aligned_zeros(_ROWS * LANES), aligned_zeros(SCRATCH)
    f, k, later = np.zeros((FACTORS, _MASSES + _SPRINGS)), np.zeros((_MASSES, MASS)), np.zeros((_MASSES, MASS))
    ks, slater, mean = np.zeros((_SPRINGS, SPRING)), np.zeros((_SPRINGS, SPRING)), np.zeros((4, _MASSES))
    taken, drive, mobility = np.full(_MASSES + _SPRINGS, -1), np.zeros(_MASSES), np.zeros(_MASSES)
    for i in range(n):
        mobility[i] = 1.0 / masses[i, 0, INERTIA]
    z, e = np.zeros((2 * nz, LANES)), np.zeros((elements, LANES))
    for i in range(nz):
        assign(z[i], Z[i])
    small = nz <= 2 and feedback.D.size == 1
    law = begin_small(scratch, feedback, nz if small else 0, Z, dlimits)
    for i in range(n):  # what swings begins with the load
        assign(s[_Q + i * LANES : _Q + (i + 1) * LANES], S[2 * min(i, 1)])
        assign(s[_V + i * LANES : _V + (i + 1) * LANES], S[2 * min(i, 1) + 1])
    period, row, last, limit, at_bands = 0.0, 1, before, feedback.limits[0, 0], STATE + 5 * n + springs.shape[0]
    for part in range(parts):
        period += lengths[part]
    for at in range(u.size):
        if at % OFTEN == 0:
            for i in range(_TORQUE):
                s[i] = s[i] if abs(s[i]) > NOTHING else 0.0
            for i in range(2 * LANES):
                scratch[MEMORY + i] = scratch[MEMORY + i] if abs(scratch[MEMORY + i]) > NOTHING else 0.0
        for j in range(LANES):
            scratch[POSITION + j] = s[_Q + j]
        if small:
            control_small(scratch, law, u[at], limit, explicit, first_explicit, at, du)
        else:
            control_slopes(scratch, z, e, feedback, excess, explicit, first_explicit, dlimits, at, du)
        time = at * period
        for part in range(parts):
            place, source = at * parts + part, at - lags[part]
            drive[0] = u[source] + post[source] if source >= 0 else before
            for j in range(LANES):
                s[_TORQUE + j] = du[j, max(source, 0)]
            if dstates.shape[0] > 0:
                for i in range(min(n, 2)):
                    assign(dstates[place, 2 * i], s[_Q + i * LANES : _Q + (i + 1) * LANES])
                    assign(dstates[place, 2 * i + 1], s[_V + i * LANES : _V + (i + 1) * LANES])
            if drive[0] != last and row < tape.shape[0]:
                kick = tape[row - 1, STATE + 3 * n] - tape[row, STATE + 2 * n]
                for j in range(LANES):
                    s[_V + j] += kick * ddelay[j]
            last = drive[0]
            while row + 1 < tape.shape[0] and tape[row, PART] == place:
                h = tape[row, LENGTH]
                if h > 0.0:
                    _take_seeds(dmasses, dsprings, tape, row, at_bands, n, springs.shape[0], taken, s)
                    mean_motion(tape, row, n, mean)
                    fill_factors(
                        masses, springs, pairs, carriers, tape, row, mean, drive, time + 0.5 * h, _MASSES, f, k, later,
                        ks, slater,
                    )  # fmt: skip
                    if places.shape[0] > 0:
                        _follow_places(places, dplaces, mean, f, s)
                    _move(h, f, mobility, k, later, ks, slater, s)
                if tape[row, EVENT] >= 0.0:
                    _pass_event(tape, row, masses, pairs, dsprings, s)
                time += h
                row += 1
