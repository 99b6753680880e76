"""The derivatives of a simulation with smooth laws, exact, compiled: the tangent of its Taylor series.

A run has left a tape of its steps (`kernels.stepped_drive`). This makes the series of each step once more and, order by
order, those of a column of derivatives per parameter: every sum and product of `kernels.smooth_series` by the rules of
sum and product. At an event the forces go on where they were, so nothing changes, except where a velocity falls to
zero: its derivative is scaled by the acceleration after over that before. A delay moves the edges of the torque, and
each kicks the velocity, as in `kernels.drive_sensitivities`.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel, wide_vectors
from jointid.models.smooth import SmoothLaws
from jointid.simulation.kernels.drive import Drive, SampledLoop, Trace
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
from jointid.simulation.kernels.smooth_series import (
    CUBE,
    INVERSE,
    LOAD,
    MORE1,
    MORE2,
    MOTOR,
    ROWS,
    SQUARE,
    STATES,
    SWINGING,
    TERMS,
    TORQUE,
    WOUND,
    WOUND1,
    WOUND2,
    Known,
    Modes,
    fill_series,
)
from jointid.simulation.kernels.stepped_drive import accelerations_of, series_value, under_torque

# Rows of the scratch, LANES long, at constant places, so that the compiler sees that nothing overlaps: the state; its
# coefficients of one order; of that order the deflection, its rate, the spring's torque, by how much the load's Coulomb
# force is larger, what pulls an elastic load, and what products add to the spring's torque and to the pushes on motor
# and load; what winds up, a row recalled, the velocities of the order before, the torque, the viscous and Coulomb
# coefficients of motor and load in their directions; then the derivatives of the drive's numbers and of the smooth
# laws', relative ones (`_write_relative`), and what friction of motor and load is wound up to, of that order.
_S, _X, _E, _APART, _SPRING, _MORE, _PULL = (LANES * row for row in (0, 9, 18, 19, 20, 21, 22))
_BENT, _PUSHED1, _PUSHED2, _WINDS, _PAST = (LANES * row for row in (23, 24, 25, 26, 27))
_BEFORE1, _BEFORE2, _TORQUE, _VISCOUS1, _COULOMB1 = (LANES * row for row in (28, 29, 30, 31, 32))
_VISCOUS2, _COULOMB2, _DRIVE, _LAWS, _RELATIVE = (LANES * row for row in (33, 34, 35, 49, 63))
_OLD1, _OLD2, _SCRATCH = LANES * 69, LANES * 70, LANES * 71
# The derivatives of the laws' numbers, in the order of `SmoothLaws.numbers`.
_WINDS_OVER1, _DRIFT1, _FADE1, _PER_TORQUE1 = (_LAWS + LANES * row for row in range(4))
_WINDS_OVER2, _DRIFT2, _FADE2, _PER_TORQUE = (_LAWS + LANES * row for row in range(4, 8))
_CUBIC, _SLIDER, _SLIPS, _SHARE, _STIFFNESS3, _DAMPING3 = (_LAWS + LANES * row for row in range(8, 14))
_Q1, _V1, _Q2, _V2, _Q3, _V3 = (_X + LANES * row for row in range(6))
_STABLE = 3.0  # rad of a swing in one step: within it a series of this order does not make it grow
_PIECES = 1000  # of a step at most: what is faster parts from its neighbours at once
# Of the orders before, where a product needs them.
_OF_E, _OF_APART, _OF_MORE, _OF_STATE = 0, 1, 2, 3
_KEPT = 3 + STATES


@inline_kernel
def _keep(past: FloatArray, series: int, k: int, q: FloatArray, row: int) -> None:
    at = np.uint64(LANES * ((TERMS + 1) * series + k))
    for j in range(LANES):
        past[at + np.uint64(j)] = q[row + j]


@inline_kernel
def _add_product(q: FloatArray, to: int, past: FloatArray, series: int, k: int, factor: float) -> None:
    """Add to a row a factor times the derivatives' coefficient of order k."""
    at = np.uint64(LANES * ((TERMS + 1) * series + k))
    for j in range(LANES):
        q[_PAST + j] = past[at + np.uint64(j)]
    for j in range(LANES):
        q[to + j] += factor * q[_PAST + j]


@inline_kernel
def _hang(
    q: FloatArray, to: int, past: FloatArray, k: int, c: FloatArray, places: FloatArray, turns: FloatArray,
    dplaces: FloatArray, side: int,
) -> None:  # fmt: skip
    """Subtract the derivatives of position-dependent forces on a side from a row."""
    at = 2 * side
    for n in range(places.shape[0]):
        if places[n, 4] != side:
            continue
        for what in range(3):
            value = c[at, k] if what == 2 else turns[n, what, k]
            for j in range(LANES):
                q[_PAST + j] = dplaces[n, what, j]
            for j in range(LANES):
                q[to + j] -= value * q[_PAST + j]
        _add_product(q, to, past, _OF_STATE + at, k, -places[n, 2])
        for i in range(k + 1):
            slope = places[n, 3] * (places[n, 1] * turns[n, 0, i] - places[n, 0] * turns[n, 1, i])
            _add_product(q, to, past, _OF_STATE + at, k - i, -slope)


@inline_kernel
def _wind(
    q: FloatArray, past: FloatArray, wound: int, of_rate: int, rate_row: int, direction: int, k: int, c: FloatArray,
    speed: float, relative: int,
) -> None:  # fmt: skip
    """Write the next order of what winds up, at a speed of its own over a rate: a velocity, or the deflection's."""
    for j in range(LANES):
        q[_WINDS + j] = q[rate_row + j]
    for i in range(k + 1):
        velocity = c[of_rate - _OF_STATE, i] if of_rate != _OF_APART else c[LOAD, i] - c[MOTOR, i]
        _add_product(q, _WINDS, past, of_rate, i, -direction * c[wound, k - i])
        _add_product(q, _WINDS, past, _OF_STATE + wound, k - i, -direction * velocity)
    factor, share = speed * INVERSE[k + 1], c[wound, k + 1]
    for j in range(LANES):
        q[_X + wound * LANES + j] = factor * q[_WINDS + j] + q[_RELATIVE + relative * LANES + j] * share
    for j in range(LANES):
        q[_S + wound * LANES + j] += q[_X + wound * LANES + j]


@compile_kernel
def _move_derivatives(
    q: FloatArray, past: FloatArray, p: Drive, b: SmoothLaws, places: FloatArray, dplaces: FloatArray, m: Modes,
    time: float, h: float, c: FloatArray, turns: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives of the state over a step whose own series is filled.

    The two loops over the lanes are long on purpose: one that is short is unrolled, and then not made of vectors.
    """
    wide_vectors()
    back1, back2 = int(m.motor < 0), int(m.load < 0)
    viscous1 = (p.viscous1_back if back1 else p.viscous1) + b.motor.viscous_drift * time
    viscous2 = (p.viscous2_back if back2 else p.viscous2) + b.load.viscous_drift * time
    coulomb1, coulomb2 = p.coulomb1_back if back1 else p.coulomb1, p.coulomb2_back if back2 else p.coulomb2
    moves1, moves2 = 1.0 if m.motor != 0 else 0.0, 1.0 if m.load != 0 else 0.0
    mobility1, mobility2 = moves1 * h / p.inertia1, moves2 * h / ((1.0 - b.spring.swing_share) * p.inertia2)
    swings = h / (b.spring.swing_share * p.inertia2) if b.spring.swing_share > 0.0 else 0.0
    hangs = 1.0 if b.spring.swing_share > 0.0 else 0.0
    lossy, faster1, faster2 = b.load.per_torque * m.torque, b.motor.viscous_drift * h, b.load.viscous_drift * h
    soft1, soft2, winds = b.motor.presliding > 0.0, b.load.presliding > 0.0, b.spring.slider > 0.0
    follows, begins = places.shape[0] > 0, b.spring.slider == 0.0 and b.spring.slips > 0.0
    remembers = soft1 or soft2 or winds or follows
    bends = False
    for j in range(LANES):
        bends = bends or q[_CUBIC + j] != 0.0
    for j in range(LANES):  # a velocity that was not let begin does not come back
        q[_S + MOTOR * LANES + j] *= moves1
        q[_S + LOAD * LANES + j] *= moves2
    # What is wound up stays so, whatever it came from; its series would not hold for the long step that follows.
    winds1, winds2 = 1.0 if c[WOUND1, 0] != m.motor else 0.0, 1.0 if c[WOUND2, 0] != m.load else 0.0
    winds3 = 1.0 if c[WOUND, 0] != m.rate or b.spring.slider == 0.0 else 0.0
    for j in range(LANES):
        q[_S + WOUND1 * LANES + j] *= winds1
        q[_S + WOUND2 * LANES + j] *= winds2
        q[_S + WOUND * LANES + j] *= winds3
    for j in range(STATES * LANES):
        q[_X + j] = q[_S + j]
    for j in range(LANES):
        q[_BENT + j], q[_PUSHED1 + j], q[_PUSHED2 + j], q[_BEFORE1 + j], q[_BEFORE2 + j] = 0.0, 0.0, 0.0, 0.0, 0.0
        q[_VISCOUS1 + j], q[_COULOMB1 + j] = q[_DRIVE + (4 + back1) * LANES + j], q[_DRIVE + (6 + back1) * LANES + j]
        q[_VISCOUS2 + j], q[_COULOMB2 + j] = q[_DRIVE + (8 + back2) * LANES + j], q[_DRIVE + (10 + back2) * LANES + j]
    before1, before2 = 0.0, 0.0
    for k in range(TERMS):
        inverse = INVERSE[k + 1]
        first, grows = (1.0 if k == 0 else 0.0), (time if k == 0 else (h if k == 1 else 0.0))
        e, v1, v2, spring = c[2, k] - c[0, k], c[MOTOR, k], c[LOAD, k], c[TORQUE, k] * m.torque
        apart, wound, wound1, wound2 = v2 - v1, c[WOUND, k], c[WOUND1, k], c[WOUND2, k]
        e2, apart2 = c[4, k] - c[2, k], c[5, k] - v2
        cube = (c[CUBE, k] if b.spring.cubic != 0.0 else _cube_term(c, k)) if bends else 0.0
        if b.spring.cubic != 0.0:
            for j in range(LANES):
                q[_E + j], q[_BENT + j] = q[_Q2 + j] - q[_Q1 + j], 0.0
            _keep(past, _OF_E, k, q, _E)
            for i in range(k + 1):
                _add_product(q, _BENT, past, _OF_E, k - i, 3.0 * b.spring.cubic * c[SQUARE, i])
        for j in range(LANES):
            de, da = q[_Q2 + j] - q[_Q1 + j], q[_V2 + j] - q[_V1 + j]
            given = q[_DRIVE + 2 * LANES + j] * e + q[_DRIVE + 3 * LANES + j] * apart
            winding = b.spring.slips * q[_X + WOUND * LANES + j] + q[_SLIPS + j] * wound
            early = ((given + winding) + (q[_CUBIC + j] * cube + q[_BENT + j])) + p.stiffness * de
            torque = early + p.damping * da
            fades = q[_FADE2 + j] * grows + q[_PER_TORQUE + j] * spring
            de2, da2 = q[_Q3 + j] - q[_Q2 + j], q[_V3 + j] - q[_V2 + j]
            given2 = q[_STIFFNESS3 + j] * e2 + q[_DAMPING3 + j] * apart2
            q[_APART + j], q[_SPRING + j], q[_MORE + j] = da, torque, fades + lossy * torque
            q[_OLD1 + j], q[_OLD2 + j] = q[_X + WOUND1 * LANES + j], q[_X + WOUND2 * LANES + j]
            q[_PULL + j] = hangs * (given2 + b.spring.swing_stiffness * de2 + b.spring.swing_damping * da2)
        if remembers:
            _keep(past, _OF_APART, k, q, _APART)
            for i in range(STATES):
                _keep(past, _OF_STATE + i, k, q, _X + i * LANES)
            for j in range(LANES):
                q[_PUSHED1 + j], q[_PUSHED2 + j] = 0.0, 0.0
            if follows:
                _hang(q, _PUSHED1, past, k, c, places, turns, dplaces, 0)
                _hang(q, _PUSHED2, past, k, c, places, turns, dplaces, 1)
            if soft1:
                if k > 0:
                    _add_product(q, _PUSHED1, past, _OF_STATE + WOUND1, k - 1, -c[MORE1, 1])
                _wind(q, past, WOUND1, _OF_STATE + MOTOR, _V1, m.motor, k, c, h / b.motor.presliding, 3)
            if soft2:
                _keep(past, _OF_MORE, k, q, _MORE)
                for i in range(k + 1):
                    _add_product(q, _PUSHED2, past, _OF_STATE + WOUND2, k - i, -c[MORE2, i])
                    _add_product(q, _PUSHED2, past, _OF_MORE, k - i, -c[WOUND2, i])
                _wind(q, past, WOUND2, _OF_STATE + LOAD, _V2, m.load, k, c, h / b.load.presliding, 4)
            if winds:
                _wind(q, past, WOUND, _OF_APART, _APART, m.rate, k, c, h * b.spring.slider / b.spring.slips, 5)
        if begins:  # a slider without stiffness: of the first order in it, nothing is wound up
            for j in range(LANES):
                wound_up = h / b.spring.slips * inverse * apart * q[_SLIDER + j]
                q[_X + WOUND * LANES + j] = wound_up
                q[_S + WOUND * LANES + j] += wound_up
        # How the Coulomb force, its growth, what is wound up and what the load's torque adds count in the drag.
        holds1, grown1, stores1 = float(m.motor * first), float(m.motor * grows), 0.0
        holds2, stores2, adds2 = float(m.load * first), 0.0, float(m.load)
        if soft1:
            holds1, stores1 = wound1, c[MORE1, 0] + coulomb1
            grown1 = time * wound1 + (h * c[WOUND1, k - 1] if k > 0 else 0.0)
        if soft2:
            holds2, stores2, adds2 = wound2, coulomb2, 0.0
        factor1, factor2, factor3, moved = mobility1 * inverse, mobility2 * inverse, swings * inverse, h * inverse
        rate1, rate2, rate3 = moves1 * c[MOTOR, k + 1], moves2 * c[LOAD, k + 1], c[SWINGING, k + 1]
        for j in range(LANES):
            # What waits for the order before is added last.
            old1, old2, old3, torque, pull = q[_V1 + j], q[_V2 + j], q[_V3 + j], q[_SPRING + j], q[_PULL + j]
            drift1, drift2 = q[_DRIFT1 + j], q[_DRIFT2 + j]
            given1 = first * (q[_TORQUE + j] - q[_DRIVE + 12 * LANES + j]) - (q[_VISCOUS1 + j] + drift1 * time) * v1
            given1 -= (h * before1) * drift1 + (holds1 * q[_COULOMB1 + j] + grown1 * q[_FADE1 + j])
            given1 = factor1 * given1 - q[_RELATIVE + j] * rate1
            later1 = (q[_PUSHED1 + j] - stores1 * q[_OLD1 + j]) - faster1 * q[_BEFORE1 + j]
            given2 = -first * q[_DRIVE + 13 * LANES + j] - (q[_VISCOUS2 + j] + drift2 * time) * v2
            given2 -= (h * before2) * drift2 + holds2 * q[_COULOMB2 + j]
            given2 = factor2 * given2 - q[_RELATIVE + LANES + j] * rate2
            later2 = (q[_PUSHED2 + j] - stores2 * q[_OLD2 + j]) - faster2 * q[_BEFORE2 + j]
            new1 = (given1 + factor1 * (later1 - viscous1 * old1)) + factor1 * torque
            new2 = (given2 + factor2 * (later2 - viscous2 * old2)) + factor2 * ((pull - adds2 * q[_MORE + j]) - torque)
            new3 = -factor3 * pull - q[_RELATIVE + 2 * LANES + j] * rate3
            q[_Q1 + j], q[_V1 + j], q[_Q2 + j], q[_V2 + j] = moved * old1, new1, moved * old2, new2
            q[_Q3 + j], q[_V3 + j], q[_BEFORE1 + j], q[_BEFORE2 + j] = moved * old3, new3, old1, old2
        for j in range(6 * LANES):
            q[_S + j] += q[_X + j]
        before1, before2 = v1, v2


@inline_kernel
def _cube_term(c: FloatArray, k: int) -> float:
    """Return the coefficient of order k of the deflection's cube."""
    total = 0.0
    for i in range(k + 1):
        for n in range(k - i + 1):
            total += (c[2, i] - c[0, i]) * (c[2, n] - c[0, n]) * (c[2, k - i - n] - c[0, k - i - n])
    return float(total)


@inline_kernel
def _write_relative(p: Drive, b: SmoothLaws, q: FloatArray) -> None:
    """Write the relative derivatives of what divides: inertias of motor, load and what swings, and what winds up."""
    for j in range(LANES):
        inertia2, share = q[_DRIVE + LANES + j] / p.inertia2, q[_SHARE + j]
        slope, limit = q[_SLIDER + j], q[_SLIPS + j]
        q[_RELATIVE + j] = q[_DRIVE + j] / p.inertia1
        # A share that is just beginning moves with the load on its spring; without one the load has lost it.
        lost = (
            0.0
            if b.spring.swing_share == 0.0 and b.spring.swing_stiffness + b.spring.swing_damping > 0.0
            else share / (1.0 - b.spring.swing_share)
        )
        q[_RELATIVE + LANES + j] = inertia2 - lost
        q[_RELATIVE + 2 * LANES + j] = inertia2 + (share / b.spring.swing_share if b.spring.swing_share > 0.0 else 0.0)
        q[_RELATIVE + 3 * LANES + j] = -q[_WINDS_OVER1 + j] / b.motor.presliding if b.motor.presliding > 0.0 else 0.0
        q[_RELATIVE + 4 * LANES + j] = -q[_WINDS_OVER2 + j] / b.load.presliding if b.load.presliding > 0.0 else 0.0
        q[_RELATIVE + 5 * LANES + j] = (
            slope / b.spring.slider - limit / b.spring.slips if b.spring.slider > 0.0 else 0.0
        )


@inline_kernel
def _fastest_rate(p: Drive, b: SmoothLaws, places: FloatArray, m: Modes, y: FloatArray) -> float:
    """Bound in 1/s on the rates of the motion, also of hardly moving masses."""
    mobility1, mobility2 = 1.0 / p.inertia1, 1.0 / ((1.0 - b.spring.swing_share) * p.inertia2)
    e, both = y[2] - y[0], mobility1 + mobility2
    stiffness = p.stiffness + max(3.0 * b.spring.cubic * e * e, 0.0) + b.spring.slider * abs(1.0 - m.rate * y[WOUND])
    rate = math.sqrt(max(stiffness, 0.0) * both) + p.damping * both
    rate += max(p.viscous1, p.viscous1_back) * mobility1 + max(p.viscous2, p.viscous2_back) * mobility2
    if b.spring.swing_share > 0.0:
        other = mobility2 + 1.0 / (b.spring.swing_share * p.inertia2)
        rate += math.sqrt(b.spring.swing_stiffness * other) + b.spring.swing_damping * other
    if b.motor.presliding > 0.0 and y[WOUND1] != m.motor:
        left = abs(1.0 - m.motor * y[WOUND1])
        rate += (
            math.sqrt(max(p.coulomb1, p.coulomb1_back) * left / b.motor.presliding * mobility1)
            + abs(y[MOTOR]) / b.motor.presliding
        )
    if b.load.presliding > 0.0 and y[WOUND2] != m.load:
        left = abs(1.0 - m.load * y[WOUND2])
        rate += (
            math.sqrt(max(p.coulomb2, p.coulomb2_back) * left / b.load.presliding * mobility2)
            + abs(y[LOAD]) / b.load.presliding
        )
    for n in range(places.shape[0]):
        slope = abs(places[n, 3]) * (abs(places[n, 0]) + abs(places[n, 1])) + abs(places[n, 2])
        rate += math.sqrt(slope * max(mobility1, mobility2))
    return rate


@inline_kernel
def _modes(tape: FloatArray, row: int) -> Modes:
    return Modes(int(tape[row, 2]), int(tape[row, 3]), int(tape[row, 4]), int(tape[row, 5]))


@compile_kernel
def follow_steps(
    loop: SampledLoop,
    before: float,
    trace: Trace,
    drive: FloatArray,
    seeds: FloatArray,
    b: SmoothLaws,
    dlaws: FloatArray,
    places: FloatArray,
    dplaces: FloatArray,
    columns: Columns,
    slopes: Slopes,
) -> None:
    """Fill the derivatives as `kernels.drive_sensitivities.follow` does, of a run with smooth laws.

    Args:
        loop: what drove the run.
        before: torque that acted before its first period.
        trace: what it left behind, with the tape of the whole run.
        drive: (14,) of `kernels.stepped_drive.run`.
        seeds: (14, columns) derivatives of the drive's coefficients.
        b: of `kernels.stepped_drive.run`.
        dlaws: (14, columns) their derivatives, in the order of `SmoothLaws.numbers`.
        places: of `kernels.stepped_drive.run`.
        dplaces: (forces, 3, columns) their derivatives.
        columns: of what else depends on the parameters.
        slopes: out.
    """
    lengths, lags, feedback, post = loop.lengths, loop.lags, loop.feedback, loop.post
    u, excess, tape = trace.u, trace.excess, trace.tape
    explicit, first_explicit, ddelay, dlimits = columns.explicit, columns.first_explicit, columns.delay, columns.limits
    S, Z, du, dstates = columns.start, columns.memory, slopes.u, slopes.states
    wide_vectors()
    n, parts, nz, elements = u.size, lengths.size, feedback.A.shape[1], feedback.limits.size
    p = under_torque(drive, b, before)
    c, turns = np.zeros((ROWS, TERMS + 1)), np.zeros((places.shape[0], 2, TERMS + 2))
    q, past, scratch = aligned_zeros(_SCRATCH), np.zeros(_KEPT * (TERMS + 1) * LANES), aligned_zeros(SCRATCH)
    z, e = np.zeros((2 * nz, LANES)), np.zeros((elements, LANES))
    for i in range(nz):
        assign(z[i], Z[i])
    small = nz <= 2 and feedback.D.size == 1
    law = begin_small(scratch, feedback, nz if small else 0, Z, dlimits)
    for i in range(seeds.shape[0]):
        assign(q[_DRIVE + i * LANES : _DRIVE + (i + 1) * LANES], seeds[i])
    for i in range(dlaws.shape[0]):
        assign(q[_LAWS + i * LANES : _LAWS + (i + 1) * LANES], dlaws[i])
    _write_relative(p, b, q)
    for i in range(6 if b.spring.swing_share > 0.0 else 4):  # what swings begins with the load
        assign(q[_S + i * LANES : _S + (i + 1) * LANES], S[i if i < 4 else i - 2])
    delayed, last = False, before
    for j in range(LANES):
        delayed = delayed or ddelay[j] != 0.0
    m = Modes(0, 0, 1, 1)
    if tape.shape[0] > 0 and (
        tape[0, 9] != 0.0 or b.motor.presliding > 0.0
    ):  # it moves as the first torque begins to act
        m = Modes(int(tape[0, 2]), 0, 1, 1)
    y, keep, period, row = np.empty(STATES), dstates.shape[0] > 0, np.sum(lengths), 0
    for k in range(n):
        if k % OFTEN == 0:
            for i in range(STATES * LANES):
                q[_S + i] = q[_S + i] if abs(q[_S + i]) > NOTHING else 0.0
            for i in range(2 * LANES):
                scratch[MEMORY + i] = scratch[MEMORY + i] if abs(scratch[MEMORY + i]) > NOTHING else 0.0
        for j in range(LANES):
            scratch[POSITION + j] = q[_S + j]
        if small:
            control_small(scratch, law, u[k], feedback.limits[0], explicit, first_explicit, k, du)
        else:
            control_slopes(scratch, z, e, feedback, excess, explicit, first_explicit, dlimits, k, du)
        time = k * period
        for part in range(parts):
            at, source = k * parts + part, k - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            previous, p = p, under_torque(drive, b, torque)
            lossy = b.motor.per_torque * math.copysign(1.0, torque)
            for j in range(LANES):
                q[_TORQUE + j] = du[j, max(source, 0)]
                more = q[_PER_TORQUE1 + j] * abs(torque) + lossy * q[_TORQUE + j]
                q[_DRIVE + 6 * LANES + j] = seeds[6, j] + more
                q[_DRIVE + 7 * LANES + j] = seeds[7, j] + more
            if keep:
                for i in range(4):
                    for j in range(LANES):
                        dstates[at, i, j] = q[_S + i * LANES + j]
            if delayed and torque != last and row < tape.shape[0]:
                now = _modes(tape, row)
                was, _ = accelerations_of(previous, b, places, m, tape[row, 8:17], time, last)
                becomes, _ = accelerations_of(p, b, places, now, tape[row, 8:17], time, torque)
                for j in range(LANES):
                    q[_S + MOTOR * LANES + j] += (was - becomes) * ddelay[j]
            last = torque
            while row < tape.shape[0] and tape[row, 0] == at:
                h = tape[row, 1]
                m = _modes(tape, row)
                known = Known(2 if tape[row, 6] > 0.0 else 0, 2 if tape[row, 7] > 0.0 else 0, 0, 0)
                if h > 0.0:
                    for i in range(STATES):
                        y[i] = tape[row, 8 + i]
                    # A step that the run's own series holds for may be long for what its derivatives set going.
                    pieces = math.ceil(_fastest_rate(p, b, places, m, y) * h / _STABLE)
                    if not pieces <= _PIECES:
                        du[:] = np.inf
                        return
                    h /= pieces
                    for piece in range(pieces):
                        fill_series(p, b, places, m, known, y, time, torque, h, c, turns)
                        _move_derivatives(q, past, p, b, places, dplaces, m, time, h, c, turns)
                        known = Known(0, 0, 0, 0)
                        time += h
                        for i in range(STATES if piece + 1 < pieces else 0):
                            y[i] = series_value(c, i, 1.0)
                mass = int(tape[row, 17])
                if mass >= 0:
                    for j in range(LANES):
                        q[_S + (1 + 2 * mass) * LANES + j] *= tape[row, 18]
                row += 1
