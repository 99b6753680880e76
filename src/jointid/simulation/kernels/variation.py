"""The derivatives of a simulation by its parameters, along the steps of `kernels.engine`, compiled.

The run has left a tape of its steps. Within a step the variational equation is linear; its coefficients are taken at
the mean of the motion, where a Taylor series of order 4 follows a column of derivatives per parameter. What winds up
has the derivative of its closed form. At an event the forces go on where they were, so nothing changes, except where a
mass stops: the derivative of its velocity is scaled by the acceleration after over that before. A delay moves the edges
of the torque, and each kicks the motor's velocity by the difference of the accelerations.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.drive import SampledLoop, Trace
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
    CHANGE,
    COS,
    COULOMB,
    COULOMB_DRIFT,
    CUBIC,
    DAMPING,
    INERTIA,
    JERK,
    KICK,
    LENGTH,
    MASS,
    MODE,
    OFFSET,
    PART,
    PER_TORQUE,
    PLACE,
    RATE,
    RATIO,
    SIN,
    SLIDING,
    SLIPS,
    SPEED,
    SPRING,
    STIFFNESS,
    STOPPED,
    STRETCHED,
    VISCOUS,
    VISCOUS_DRIFT,
    WAVE,
    WAY,
    WHERE,
    WINDING,
    WOUND,
    winding,
)
from jointid.simulation.plant import Plant

_MASSES, _SPRINGS = 3, 2
# Rows of the derivatives, LANES long: positions and velocities of the masses, what is wound up of masses and springs,
# the torque, and what forces that follow a position give each mass, with its rate.
_Q, _V, _W, _TORQUE, _PLACED, _MOVES = (LANES * row for row in (0, 3, 6, 11, 12, 15))
_MASS_SEEDS, _SPRING_SEEDS = 18, 18 + _MASSES * MASS
_ROWS = _SPRING_SEEDS + _SPRINGS * SPRING
# Factors of a step: of each mass whether it moves, its mobility, drag and stiffness, how much of the spring's force it
# takes; of masses, then of springs, how the derivative of what is wound up enters the force, what of it is left at the
# end, what it gains with the place and with the rate of winding; last the stiffness and damping of springs.
_GOES, _MOBILITY, _DRAG, _STIFF, _TAKES, _HALF, _WINDS, _LEFT, _GAINS, _TURNS, _PULL, _DAMP = range(12)
_FACTORS = 12


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
    f[_HALF, i], f[_WINDS, i], f[_LEFT, i], f[_GAINS, i], f[_TURNS, i] = 0.0, 0.0, 0.0, 0.0, 0.0
    if w == way:
        return 0.0
    half, left = math.exp(min(-0.5 * way * x * rate, 1.0)), math.exp(min(-way * x * rate, 1.0))
    slope = (way - w) * way
    f[_HALF, i], f[_WINDS, i], f[_LEFT, i] = force * half, force * slope * half * rate, left
    f[_GAINS, i], f[_TURNS, i] = slope * left * rate, slope * left * x
    return force * slope * half


@inline_kernel
def _fill_factors(
    masses: FloatArray, springs: FloatArray, row: FloatArray, torque: float, time: float, f: FloatArray, k: FloatArray,
    later: FloatArray, ks: FloatArray, slater: FloatArray,
) -> None:  # fmt: skip
    """Fill the factors of a step, a row of the tape, and those of the numbers in the forces, with their rates.

    The second are taken as they are in the middle of the step, and change linearly in it.
    """
    n, h = masses.shape[0], row[LENGTH]
    carried, grows, spring, change = torque, 0.0, 0.0, 0.0
    for i in range(n):
        mode, speed, rate = row[MODE + i], row[SPEED + i], row[CHANGE + i]
        back, moves = (1 if mode < 0.0 else 0), (1.0 if mode != 0.0 else 0.0)
        # A torque that goes through 0 within the step: the mean of its size, and of its sign.
        low, high = carried - 0.5 * h * grows, carried + 0.5 * h * grows
        sign, size = math.copysign(1.0, carried), abs(carried)
        if low * high < 0.0:
            sign, size = (abs(high) - abs(low)) / (high - low), (high * high + low * low) / (2.0 * abs(high - low))
        share, turns, winds, x = mode, 0.0, masses[i, WINDING], speed * h
        grip = masses[i, COULOMB + back] + masses[i, COULOMB_DRIFT] * time + masses[i, PER_TORQUE] * size
        f[_STIFF, i], k[i, WINDING] = 0.0, 0.0
        if winds > 0.0:
            share = winding(row[WOUND + i], mode, 0.5 * x, winds)
            turns = winds * (speed - abs(speed) * share)
            gain = _wind(f, i, row[WOUND + i], mode, x, winds, -grip)
            f[_STIFF, i], k[i, WINDING] = f[_WINDS, i], 0.5 * gain * x
        f[_GOES, i], f[_MOBILITY, i] = moves, moves / masses[i, INERTIA]
        f[_DRAG, i] = masses[i, VISCOUS + back] + masses[i, VISCOUS_DRIFT] * time
        f[_TAKES, i] = 1.0 + share * masses[i, PER_TORQUE] * sign
        k[i, INERTIA], later[i, INERTIA], k[i, OFFSET] = -rate, -row[JERK + i], -1.0
        k[i, VISCOUS + back], later[i, VISCOUS + back] = -speed, -rate
        k[i, VISCOUS + 1 - back], later[i, VISCOUS + 1 - back] = 0.0, 0.0
        k[i, COULOMB + back], later[i, COULOMB + back] = -share, -turns
        k[i, COULOMB + 1 - back], later[i, COULOMB + 1 - back] = 0.0, 0.0
        k[i, VISCOUS_DRIFT], later[i, VISCOUS_DRIFT] = -speed * time, -(rate * time + speed)
        k[i, COULOMB_DRIFT], later[i, COULOMB_DRIFT] = -share * time, -(turns * time + share)
        k[i, PER_TORQUE], later[i, PER_TORQUE] = -share * size, -(turns * size + share * sign * grows)
        if i + 1 < n:
            e, de, dde = row[PLACE + i + 1] - row[PLACE + i], row[SPEED + i + 1] - speed, row[CHANGE + i + 1] - rate
            w, way, slides, slips = row[STRETCHED + i], row[WAY + i], springs[i, SLIDING], springs[i, SLIPS]
            half = winding(w, way, 0.5 * de * h, slides)
            turns = slides * (de - abs(de) * half)
            pull = springs[i, STIFFNESS] + 3.0 * springs[i, CUBIC] * e * e
            spring = (springs[i, STIFFNESS] + springs[i, CUBIC] * e * e) * e + springs[i, DAMPING] * de + slips * half
            change = pull * de + springs[i, DAMPING] * dde + slips * turns
            gain = _wind(f, _MASSES + i, w, way, de * h, slides, slips) if slips > 0.0 else 0.0
            f[_PULL, i], f[_DAMP, i] = pull + f[_WINDS, _MASSES + i], springs[i, DAMPING]
            ks[i, STIFFNESS], ks[i, DAMPING], ks[i, CUBIC], ks[i, SLIPS] = e, de, e * e * e, half
            slater[i, STIFFNESS], slater[i, DAMPING], slater[i, CUBIC] = de, dde, 3.0 * e * e * de
            slater[i, SLIPS], ks[i, SLIDING] = turns, 0.5 * gain * de * h
        carried, grows = spring, change


@inline_kernel
def _follow_places(
    masses: FloatArray, places: FloatArray, dplaces: FloatArray, row: FloatArray, f: FloatArray, s: FloatArray
) -> None:
    """Write the derivatives of position-dependent forces on each mass, and add their stiffness."""
    for i in range(2 * _MASSES * LANES):
        s[_PLACED + i] = 0.0
    for force in range(places.shape[0]):
        i = int(places[force, WHERE])
        place, speed, wave = row[PLACE + i], row[SPEED + i], places[force, WAVE]
        cos, sin = math.cos(wave * place), math.sin(wave * place)
        f[_STIFF, i] -= wave * (places[force, SIN] * cos - places[force, COS] * sin) + places[force, RATE]
        for j in range(LANES):
            dcos, dsin, drate = dplaces[force, COS, j], dplaces[force, SIN, j], dplaces[force, RATE, j]
            s[_PLACED + i * LANES + j] -= cos * dcos + sin * dsin + place * drate
            s[_MOVES + i * LANES + j] -= speed * (wave * (cos * dsin - sin * dcos) + drate)


@inline_kernel
def _move(
    h: float, f: FloatArray, k: FloatArray, later: FloatArray, ks: FloatArray, slater: FloatArray, s: FloatArray
) -> None:
    """Move the derivatives over a step: a Taylor series of their linear equation about its beginning.

    The loop is long on purpose, so that the compiler makes vectors of the lanes.
    """
    back, h2, h3, h4 = 0.5 * h, h * h / 2.0, h * h * h / 6.0, h * h * h * h / 24.0
    goes, mobility, drag, stiff = _five(f, _GOES, 0), _five(f, _MOBILITY, 0), _five(f, _DRAG, 0), _five(f, _STIFF, 0)
    takes, pull, damp = _five(f, _TAKES, 0), _five(f, _PULL, 0), _five(f, _DAMP, 0)
    half, winds, left = _five(f, _HALF, 0), _five(f, _WINDS, 0), _five(f, _LEFT, 0)
    gains, turns = _five(f, _GAINS, 0), _five(f, _TURNS, 0)
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
        # The derivatives of the velocities by time: the first, the second, the third, the fourth.
        near, far = pull[0] * (q1 - q0) + damp[0] * (v1 - v0) + d0, pull[1] * (q2 - q1) + damp[1] * (v2 - v1) + d1
        a0 = mobility[0] * (((stiff[0] * q0 - drag[0] * v0) + g0) + near)
        a1 = mobility[1] * (((stiff[1] * q1 - drag[1] * v1) + g1) + (far - takes[1] * near))
        a2 = mobility[2] * (((stiff[2] * q2 - drag[2] * v2) + g2) - takes[2] * far)
        near, far = pull[0] * (v1 - v0) + damp[0] * (a1 - a0) + t0, pull[1] * (v2 - v1) + damp[1] * (a2 - a1) + t1
        b0 = mobility[0] * (((stiff[0] * v0 - drag[0] * a0) + r0) + near)
        b1 = mobility[1] * (((stiff[1] * v1 - drag[1] * a1) + r1) + (far - takes[1] * near))
        b2 = mobility[2] * (((stiff[2] * v2 - drag[2] * a2) + r2) - takes[2] * far)
        near, far = pull[0] * (a1 - a0) + damp[0] * (b1 - b0), pull[1] * (a2 - a1) + damp[1] * (b2 - b1)
        c0 = mobility[0] * ((stiff[0] * a0 - drag[0] * b0) + near)
        c1 = mobility[1] * ((stiff[1] * a1 - drag[1] * b1) + (far - takes[1] * near))
        c2 = mobility[2] * ((stiff[2] * a2 - drag[2] * b2) - takes[2] * far)
        near, far = pull[0] * (b1 - b0) + damp[0] * (c1 - c0), pull[1] * (b2 - b1) + damp[1] * (c2 - c1)
        e0 = mobility[0] * ((stiff[0] * b0 - drag[0] * c0) + near)
        e1 = mobility[1] * ((stiff[1] * b1 - drag[1] * c1) + (far - takes[1] * near))
        e2 = mobility[2] * ((stiff[2] * b2 - drag[2] * c2) - takes[2] * far)
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


@compile_kernel
def follow(
    masses: FloatArray, springs: FloatArray, places: FloatArray, seeds: Plant, loop: SampledLoop, before: float,
    trace: Trace, columns: Columns, slopes: Slopes,
) -> None:  # fmt: skip
    """Fill the derivatives as `kernels.drive_sensitivities.follow` does, of a run of `kernels.engine`.

    Args:
        masses: of the run, as it left them.
        springs: of the run.
        places: of the run.
        seeds: their derivatives: (3, MASS, columns), (2, SPRING, columns) and (forces, 5, columns), 0 of what is not
            there.
        loop: what drove the run.
        before: torque that acted before its first period.
        trace: what it left behind, with the tape of the whole run.
        columns: of what else depends on the parameters.
        slopes: out.
    """
    lengths, lags, feedback, post = loop.lengths, loop.lags, loop.feedback, loop.post
    u, excess, tape = trace.u, trace.excess, trace.tape
    explicit, first_explicit, ddelay, dlimits = columns.explicit, columns.first_explicit, columns.delay, columns.limits
    S, Z, du, dstates = columns.start, columns.memory, slopes.u, slopes.states
    n, parts, nz, elements = masses.shape[0], lengths.size, feedback.A.shape[1], feedback.limits.size
    s, scratch = aligned_zeros(_ROWS * LANES), aligned_zeros(SCRATCH)
    f, k, later = np.zeros((_FACTORS, _MASSES + _SPRINGS)), np.zeros((_MASSES, MASS)), np.zeros((_MASSES, MASS))
    ks, slater = np.zeros((_SPRINGS, SPRING)), np.zeros((_SPRINGS, SPRING))
    assign(s[_MASS_SEEDS * LANES : _SPRING_SEEDS * LANES], seeds.masses.reshape(-1))
    assign(s[_SPRING_SEEDS * LANES :], seeds.springs.reshape(-1))
    z, e = np.zeros((2 * nz, LANES)), np.zeros((elements, LANES))
    for i in range(nz):
        assign(z[i], Z[i])
    small = nz <= 2 and feedback.D.size == 1
    law = begin_small(scratch, feedback, nz if small else 0, Z, dlimits)
    for i in range(n):  # what swings begins with the load
        assign(s[_Q + i * LANES : _Q + (i + 1) * LANES], S[2 * min(i, 1)])
        assign(s[_V + i * LANES : _V + (i + 1) * LANES], S[2 * min(i, 1) + 1])
    period, row = 0.0, 0
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
            control_small(scratch, law, u[at], feedback.limits[0], explicit, first_explicit, at, du)
        else:
            control_slopes(scratch, z, e, feedback, excess, explicit, first_explicit, dlimits, at, du)
        time = at * period
        for part in range(parts):
            place, source = at * parts + part, at - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            for j in range(LANES):
                s[_TORQUE + j] = du[j, max(source, 0)]
            if dstates.shape[0] > 0:
                for i in range(min(n, 2)):
                    assign(dstates[place, 2 * i], s[_Q + i * LANES : _Q + (i + 1) * LANES])
                    assign(dstates[place, 2 * i + 1], s[_V + i * LANES : _V + (i + 1) * LANES])
            while row < tape.shape[0] and tape[row, PART] == place:
                step, half = tape[row], time + 0.5 * tape[row, LENGTH]
                for j in range(LANES):
                    s[_V + j] += step[KICK] * ddelay[j]
                _fill_factors(masses, springs, step, torque, half, f, k, later, ks, slater)
                if places.shape[0] > 0:
                    _follow_places(masses, places, seeds.places, step, f, s)
                _move(step[LENGTH], f, k, later, ks, slater, s)
                if step[STOPPED] >= 0.0:
                    for j in range(LANES):
                        s[_V + int(step[STOPPED]) * LANES + j] *= step[RATIO]
                time += step[LENGTH]
                row += 1
