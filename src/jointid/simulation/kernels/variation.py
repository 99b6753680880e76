"""The derivatives of a simulation by its parameters, along the steps of `kernels.engine`, compiled.

The run has left a tape of its steps. Within a step the variational equation is linear; its coefficients are taken at
the mean of the motion, where a Taylor series of order 4 follows a column of derivatives per parameter. What winds up
has the derivative of its closed form. At an event the forces go on where they were, so nothing changes, except where a
mass stops: the derivative of its velocity is scaled by the acceleration after over that before. A delay moves the edges
of the torque, and each kicks the motor's velocity by the difference of the accelerations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel, wide_vectors
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
    COULOMB_BACK,
    COULOMB_DRIFT,
    CUBIC,
    DAMPING,
    INERTIA,
    JERK,
    KICK,
    LENGTH,
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
    STIFFNESS,
    STOPPED,
    STRETCHED,
    VISCOUS,
    VISCOUS_BACK,
    VISCOUS_DRIFT,
    WAVE,
    WAY,
    WHERE,
    WINDING,
    WOUND,
    winding,
)

_MASSES = 3
_TERMS = 4  # the order of the series


class Seeds(NamedTuple):
    """Derivatives of the numbers of a run.

    Attributes:
        masses: (n, MASS, columns). springs: (n - 1, SPRING, columns). places: (forces, 5, columns).
    """

    masses: FloatArray
    springs: FloatArray
    places: FloatArray


@inline_kernel
def _take(mean: FloatArray, change: FloatArray, factor: float, rate: float, column: FloatArray) -> None:
    """Subtract a column with a factor that changes at a rate."""
    for j in range(LANES):
        mean[j] -= factor * column[j]
        change[j] -= rate * column[j]


@inline_kernel
def _begin_winding(
    w: float, way: float, x: float, rate: float, force: float, drate: FloatArray, dw: FloatArray, place: FloatArray,
    given: FloatArray,
) -> float:  # fmt: skip
    """Add the derivatives of what is wound up half way through a step, times a force; return how it follows the place.

    `place` are the derivatives of the place that the step begins at.
    """
    if w == way:
        return 0.0
    left = math.exp(min(-0.5 * way * x * rate, 1.0))
    slope = (way - w) * left * way
    for j in range(LANES):
        given[j] += force * (left * dw[j] + slope * (0.5 * x * drate[j] - rate * place[j]))
    return force * slope * rate


@inline_kernel
def _end_winding(
    w: float, way: float, x: float, rate: float, drate: FloatArray, moved: FloatArray, dw: FloatArray
) -> None:
    """Move the derivatives of what is wound up over a step, in which those of the place have moved."""
    left = math.exp(min(-way * x * rate, 1.0)) if w != way else 0.0
    slope = (way - w) * left * way
    for j in range(LANES):
        dw[j] = left * dw[j] + slope * (rate * moved[j] + x * drate[j])


@inline_kernel
def _move(
    masses: FloatArray, springs: FloatArray, places: FloatArray, dmasses: FloatArray, dsprings: FloatArray,
    dplaces: FloatArray, row: FloatArray, torque: float, time: float, dtorque: FloatArray, q: FloatArray, v: FloatArray,
    w: FloatArray, room: FloatArray, factors: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives of positions, velocities and of what is wound up over a step, a row of the tape.

    What the parameters change in the forces is taken as it is in the middle, with its rate of change.
    """
    n, h = masses.shape[0], row[LENGTH]
    carried, grows, spring, spring_rate = torque, 0.0, 0.0, 0.0
    for i in range(n):
        given, later, start = room[i], room[_MASSES + i], room[6 * _MASSES + i]
        mode, speed, rate, place = row[MODE + i], row[SPEED + i], row[CHANGE + i], row[PLACE + i]
        viscous_in, coulomb_in = (VISCOUS_BACK, COULOMB_BACK) if mode < 0.0 else (VISCOUS, COULOMB)
        moves = 1.0 if mode != 0.0 else 0.0
        for j in range(LANES):
            v[i, j] = moves * v[i, j]  # a velocity that was not let begin does not come back
            start[j] = q[i, j]
        # A torque that goes through 0 within the step: the mean of its size, and of its sign.
        low, high = carried - 0.5 * h * grows, carried + 0.5 * h * grows
        sign, size = math.copysign(1.0, carried), abs(carried)
        if low * high < 0.0:
            sign, size = (abs(high) - abs(low)) / (high - low), (high * high + low * low) / (2.0 * abs(high - low))
        grip = masses[i, coulomb_in] + masses[i, COULOMB_DRIFT] * time + masses[i, PER_TORQUE] * size
        share, turns, stiff, x, winds = mode, 0.0, 0.0, speed * h, masses[i, WINDING]
        if winds > 0.0:
            share = winding(row[WOUND + i], mode, 0.5 * x, winds)
            turns = winds * (speed - abs(speed) * share)
        lossy, jerk, inertia = share * masses[i, PER_TORQUE] * sign, row[JERK + i], dmasses[i, INERTIA]
        viscous, coulomb, loss = dmasses[i, viscous_in], dmasses[i, coulomb_in], dmasses[i, PER_TORQUE]
        offset, drift, fade = dmasses[i, OFFSET], dmasses[i, VISCOUS_DRIFT], dmasses[i, COULOMB_DRIFT]
        pushed, losing = (1.0 - lossy if i == 0 else 0.0), turns * size + share * sign * grows
        for j in range(LANES):
            friction = speed * (viscous[j] + time * drift[j]) + share * (coulomb[j] + time * fade[j] + size * loss[j])
            given[j] = (pushed * dtorque[j] - offset[j]) - (rate * inertia[j] + friction)
            change = rate * (viscous[j] + time * drift[j]) + turns * (coulomb[j] + time * fade[j])
            later[j] = -(jerk * inertia[j] + change) - (speed * drift[j] + share * fade[j] + losing * loss[j])
        if winds > 0.0:
            stiff = _begin_winding(row[WOUND + i], mode, x, winds, -grip, dmasses[i, WINDING], w[i], start, given)
        factors[0, i] = moves / masses[i, INERTIA]
        factors[1, i] = masses[i, viscous_in] + masses[i, VISCOUS_DRIFT] * time
        factors[2, i], factors[3, i] = stiff, 1.0 + lossy
        if i + 1 < n:
            drawn, pulled, apart = room[2 * _MASSES + i], room[3 * _MASSES + i], room[4 * _MASSES + i]
            e, de, dde = row[PLACE + i + 1] - place, row[SPEED + i + 1] - speed, row[CHANGE + i + 1] - rate
            w0, way, slides, slips = row[STRETCHED + i], row[WAY + i], springs[i, SLIDING], springs[i, SLIPS]
            half = winding(w0, way, 0.5 * de * h, slides)
            turns = slides * (de - abs(de) * half)
            pull = springs[i, STIFFNESS] + 3.0 * springs[i, CUBIC] * e * e
            spring = (springs[i, STIFFNESS] + springs[i, CUBIC] * e * e) * e + springs[i, DAMPING] * de + slips * half
            spring_rate = pull * de + springs[i, DAMPING] * dde + slips * turns
            stiffness, damping, cubic = dsprings[i, STIFFNESS], dsprings[i, DAMPING], dsprings[i, CUBIC]
            limit = dsprings[i, SLIPS]
            for j in range(LANES):
                drawn[j] = (e * stiffness[j] + de * damping[j]) + (e * e * e * cubic[j] + half * limit[j])
                pulled[j] = (de * stiffness[j] + dde * damping[j]) + (3.0 * e * e * de * cubic[j] + turns * limit[j])
                apart[j] = q[i + 1, j] - q[i, j]
            if slips > 0.0:
                pull += _begin_winding(w0, way, de * h, slides, slips, dsprings[i, SLIDING], w[n + i], apart, drawn)
            factors[4, i] = pull
        carried, grows = spring, spring_rate
    for k in range(places.shape[0]):
        i = int(places[k, WHERE])
        place, speed, wave = row[PLACE + i], row[SPEED + i], places[k, WAVE]
        cos, sin = math.cos(wave * place), math.sin(wave * place)
        factors[2, i] -= wave * (places[k, SIN] * cos - places[k, COS] * sin) + places[k, RATE]
        given, later = room[i], room[_MASSES + i]
        _take(given, later, cos, -wave * speed * sin, dplaces[k, COS])
        _take(given, later, sin, wave * speed * cos, dplaces[k, SIN])
        _take(given, later, place, speed, dplaces[k, RATE])
    # Of the series, at the beginning of the step: a term's positions and velocities, and the accelerations of the next.
    power = 1.0
    for term in range(1, _TERMS + 1):
        mean, rate = (1.0, -0.5 * h) if term == 1 else (0.0, 1.0 if term == 2 else 0.0)
        for i in range(n):
            given, later, tq, tv, nv = (
                room[i],
                room[_MASSES + i],
                room[4 * _MASSES + i],
                room[5 * _MASSES + i],
                room[7 * _MASSES + i],
            )
            for j in range(LANES):
                if term == 1:
                    tq[j], tv[j] = q[i, j], v[i, j]
                nv[j] = (mean * given[j] + rate * later[j]) + factors[2, i] * tq[j] - factors[1, i] * tv[j]
        for i in range(n - 1):
            drawn, pulled = room[2 * _MASSES + i], room[3 * _MASSES + i]
            pull, damping, passes = factors[4, i], springs[i, DAMPING], factors[3, i + 1]
            a, b = 4 * _MASSES + i, 5 * _MASSES + i
            for j in range(LANES):
                force = pull * (room[a + 1, j] - room[a, j]) + damping * (room[b + 1, j] - room[b, j])
                force += mean * drawn[j] + rate * pulled[j]
                room[7 * _MASSES + i, j] += force
                room[7 * _MASSES + i + 1, j] -= passes * force
        power *= h / term
        for i in range(n):
            tq, tv, nv = room[4 * _MASSES + i], room[5 * _MASSES + i], room[7 * _MASSES + i]
            mobility = factors[0, i]
            for j in range(LANES):
                tq[j] = tv[j]
                tv[j] = mobility * nv[j]
                q[i, j] += power * tq[j]
                v[i, j] += power * tv[j]
    for i in range(n):
        start, moved = room[6 * _MASSES + i], room[4 * _MASSES + i]
        for j in range(LANES):
            moved[j] = q[i, j] - start[j]
        if masses[i, WINDING] > 0.0:
            x = row[SPEED + i] * h
            _end_winding(row[WOUND + i], row[MODE + i], x, masses[i, WINDING], dmasses[i, WINDING], moved, w[i])
    for i in range(n - 1):
        if springs[i, SLIPS] > 0.0:
            apart, x = room[i], (row[SPEED + i + 1] - row[SPEED + i]) * h
            for j in range(LANES):
                apart[j] = room[4 * _MASSES + i + 1, j] - room[4 * _MASSES + i, j]
            _end_winding(
                row[STRETCHED + i], row[WAY + i], x, springs[i, SLIDING], dsprings[i, SLIDING], apart, w[n + i]
            )
    if row[STOPPED] >= 0.0:
        for j in range(LANES):
            v[int(row[STOPPED]), j] *= row[RATIO]


@compile_kernel
def follow(
    masses: FloatArray,
    springs: FloatArray,
    places: FloatArray,
    seeds: Seeds,
    loop: SampledLoop,
    before: float,
    trace: Trace,
    columns: Columns,
    slopes: Slopes,
) -> None:
    """Fill the derivatives as `kernels.drive_sensitivities.follow` does, of a run of `kernels.engine`.

    Args:
        masses: of the run, as it left them.
        springs: of the run.
        places: of the run.
        seeds: their derivatives.
        loop: what drove the run.
        before: torque that acted before its first period.
        trace: what it left behind, with the tape of the whole run.
        columns: of what else depends on the parameters.
        slopes: out.
    """
    wide_vectors()
    lengths, lags, feedback, post = loop.lengths, loop.lags, loop.feedback, loop.post
    u, excess, tape = trace.u, trace.excess, trace.tape
    explicit, first_explicit, ddelay, dlimits = columns.explicit, columns.first_explicit, columns.delay, columns.limits
    S, Z, du, dstates = columns.start, columns.memory, slopes.u, slopes.states
    n, parts, nz, elements = masses.shape[0], lengths.size, feedback.A.shape[1], feedback.limits.size
    q, v, w = np.zeros((n, LANES)), np.zeros((n, LANES)), np.zeros((2 * n - 1, LANES))
    room, factors = np.zeros((8 * _MASSES, LANES)), np.zeros((5, _MASSES))
    dtorque, scratch = np.zeros(LANES), aligned_zeros(SCRATCH)
    z, e = np.zeros((2 * nz, LANES)), np.zeros((elements, LANES))
    for i in range(nz):
        assign(z[i], Z[i])
    small = nz <= 2 and feedback.D.size == 1
    law = begin_small(scratch, feedback, nz if small else 0, Z, dlimits)
    for i in range(n):  # what swings begins with the load
        assign(q[i], S[2 * min(i, 1)])
        assign(v[i], S[2 * min(i, 1) + 1])
    period, row = 0.0, 0
    for part in range(parts):
        period += lengths[part]
    for k in range(u.size):
        if k % OFTEN == 0:
            for i in range(n):
                for j in range(LANES):
                    q[i, j] = q[i, j] if abs(q[i, j]) > NOTHING else 0.0
                    v[i, j] = v[i, j] if abs(v[i, j]) > NOTHING else 0.0
            for i in range(2 * n - 1):
                for j in range(LANES):
                    w[i, j] = w[i, j] if abs(w[i, j]) > NOTHING else 0.0
            for i in range(2 * LANES):
                scratch[MEMORY + i] = scratch[MEMORY + i] if abs(scratch[MEMORY + i]) > NOTHING else 0.0
        for j in range(LANES):
            scratch[POSITION + j] = q[0, j]
        if small:
            control_small(scratch, law, u[k], feedback.limits[0], explicit, first_explicit, k, du)
        else:
            control_slopes(scratch, z, e, feedback, excess, explicit, first_explicit, dlimits, k, du)
        time = k * period
        for part in range(parts):
            at, source = k * parts + part, k - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            for j in range(LANES):
                dtorque[j] = du[j, max(source, 0)]
            if dstates.shape[0] > 0:
                for i in range(min(n, 2)):
                    assign(dstates[at, 2 * i], q[i])
                    assign(dstates[at, 2 * i + 1], v[i])
            while row < tape.shape[0] and tape[row, PART] == at:
                for j in range(LANES):
                    v[0, j] += tape[row, KICK] * ddelay[j]
                half = time + 0.5 * tape[row, LENGTH]
                _move(
                    masses, springs, places, seeds.masses, seeds.springs, seeds.places, tape[row], torque, half,
                    dtorque, q, v, w, room, factors,
                )  # fmt: skip
                time += tape[row, LENGTH]
                row += 1
