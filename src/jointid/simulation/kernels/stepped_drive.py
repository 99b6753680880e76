"""The simulation of a drive with smooth laws, by Taylor series of its motion, compiled.

A step is as long as the last coefficient of its series (`kernels.smooth_series`) allows, and none is made in vain.
What happens within one is a root of a polynomial, isolated as in `kernels.drive`: a mass that stops or comes loose, the
reversal from which a spring winds up anew, the spring's torque through 0.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.smooth import SmoothLaws
from jointid.simulation.kernels.drive import (
    CHATTERING,
    DIVERGED,
    FINISHED,
    TOO_STIFF,
    Drive,
    SampledLoop,
    Trace,
    control_any,
    mode_after,
)
from jointid.simulation.kernels.polynomial import ORDER, ROOM, SOUGHT, first_root
from jointid.simulation.kernels.smooth_series import (
    LOAD,
    MORE1,
    MOTOR,
    PUSH1,
    ROWS,
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

_TOLERANCE = 1e-9  # of the largest velocity so far: the last coefficient of a step
_BEFORE_LAST = 0.1  # of the last coefficient but one: as much counts, as a swing has but every other
_WINDING = 1e-9  # of a limit: the last coefficient of a share of it that is wound up
_SHORTEST = 1e-12  # of a period: a step below it shows a drive that is too stiff
_EVENTS = 1000  # per period; a physical drive has a handful
_WORK = 20  # steps a simulation may take, per period: bounds the time an absurd candidate can cost
_WOUND_UP = 1e-8  # of a limit: what is nearer to it than that, and so than steps can tell, is at it

# One row of the tape for each step: which part, how long, the modes in it, whether motor and load had just come loose,
# the state it began with, then the mass whose velocity its event took to zero (or -1) and its acceleration after that
# over the one before.
STEP_TAPE = 19


@inline_kernel
def _shorten(c: FloatArray, share: float) -> None:
    """Count time in a share of the step."""
    power = 1.0
    for k in range(1, TERMS + 1):
        power *= share
        for i in range(ROWS):
            c[i, k] *= power


@inline_kernel
def _share(c: FloatArray, fastest: float) -> float:
    """Return how much of the step its series holds for, from its last coefficients; 0 where they are no numbers."""
    last, before, wound = 0.0, 0.0, 0.0
    for i in (MOTOR, LOAD, SWINGING):
        last, before = max(last, abs(c[i, TERMS])), max(before, abs(c[i, TERMS - 1]))
    for i in (WOUND1, WOUND2, WOUND):
        wound = max(wound, abs(c[i, TERMS]))
    size = max(fastest, abs(c[1, 0]), abs(c[3, 0]), 1e-3 * max(abs(c[1, 1]), abs(c[3, 1])))
    error = max(max(last, _BEFORE_LAST * before) / (_TOLERANCE * size) if size > 0.0 else 0.0, wound / _WINDING)
    share = 1.0
    if not error <= 1.0:
        share = 0.95 * error ** (-1.0 / TERMS) if error < np.inf else 0.0
    return share


@inline_kernel
def series_value(c: FloatArray, row: int, t: float) -> float:
    """Return a series' value at a share of its step."""
    total = 0.0
    for k in range(TERMS, -1, -1):
        total = total * t + c[row, k]
    return total


@inline_kernel
def _clear(c: FloatArray, row: int, sign: float) -> bool:
    """Prove that a guard is positive throughout a step by its negative coefficients."""
    lowest = sign * c[row, 0]
    for k in range(1, TERMS + 1):
        lowest += min(sign * c[row, k], 0.0)
    return bool(lowest > 0.0)


@inline_kernel
def _locate_first(
    p: Drive, b: SmoothLaws, m: Modes, known: Known, c: FloatArray, roots: FloatArray
) -> tuple[float, int]:
    """Return when the first event is (2.0: not in this step), in steps, and its guard.

    Guards 0 and 1 are of the motor, 2 and 3 of the load: the first of both also where it moves and may stop, else a
    rest that it leaves forwards and backwards. Guard 4 is of the spring's rate, 5 of its torque.
    """
    first, which = 2.0, -1
    for guard in range(6):
        mode, beginning, row, other, constant = 1, 0, 0, -1, 0.0
        if guard < 4:
            mass, direction = guard // 2, 1 - 2 * (guard % 2)
            mode, beginning = (m.motor, known.motor) if mass == 0 else (m.load, known.load)
            if mode != 0:
                if direction < 0:
                    continue
                row, sign, out = 1 + 2 * mass, float(mode), beginning
                if beginning == 2 and mode * c[row, 2] <= 0.0:  # came loose at the edge but is pushed back
                    if first > 0.0:
                        first, which = 0.0, guard
                    continue
            else:
                row, sign, out = PUSH1 + mass, float(-direction), int(beginning == direction)
                constant = p.coulomb1 if direction > 0 else p.coulomb1_back
                if mass == 1:
                    constant = p.coulomb2 if direction > 0 else p.coulomb2_back
                other = MORE1 + mass
        elif guard == 4:
            if b.spring.slider == 0.0:
                continue
            row, other, sign, out = LOAD, MOTOR, float(m.rate), known.rate
        else:
            if b.load.per_torque == 0.0:
                continue
            row, sign, out = TORQUE, float(m.torque), known.torque
        if other < 0 and out == 0 and _clear(c, row, sign):
            continue
        more = 0.0 if other < 0 else (1.0 if guard < 4 else -sign)
        for k in range(TERMS + 1):
            roots[SOUGHT, k] = sign * c[row, k] + (more * c[other, k] if other >= 0 else 0.0)
        for k in range(TERMS + 1, ORDER + 1):
            roots[SOUGHT, k] = 0.0
        roots[SOUGHT, 0] += constant
        for _ in range(out):  # what is 0 at the start by construction is divided out
            for k in range(ORDER):
                roots[SOUGHT, k] = roots[SOUGHT, k + 1]
            roots[SOUGHT, ORDER] = 0.0
        moment = first_root(roots)
        if moment < first:
            first, which = moment, guard
    return first, which


@inline_kernel
def under_torque(d: FloatArray, b: SmoothLaws, torque: float) -> Drive:
    """Return the drive of coefficients, with the motor's Coulomb force under a torque."""
    more = b.motor.per_torque * abs(torque)
    return Drive(d[0], d[1], d[2], d[3], d[4], d[5], d[6] + more, d[7] + more, d[8], d[9], d[10], d[11], d[12], d[13])


@inline_kernel
def _push(p: Drive, b: SmoothLaws, places: FloatArray, y: FloatArray, mass: int, torque: float) -> tuple[float, float]:
    """Return the push on a mass without its friction, and the spring's torque."""
    e = y[2] - y[0]
    spring = (p.stiffness + b.spring.cubic * e * e) * e + p.damping * (y[3] - y[1]) + b.spring.slips * y[WOUND]
    push = torque - p.offset1 + spring
    if mass == 1:
        push = -p.offset2 - spring
        if b.spring.swing_share > 0.0:
            push += b.spring.swing_stiffness * (y[4] - y[2]) + b.spring.swing_damping * (y[5] - y[3])
    for j in range(places.shape[0]):
        if places[j, 4] == mass:
            q = y[2 * mass]
            phase = places[j, 3] * q
            push -= places[j, 0] * math.cos(phase) + places[j, 1] * math.sin(phase) + places[j, 2] * q
    return push, spring


@inline_kernel
def _bounds(p: Drive, b: SmoothLaws, mass: int, spring: float, time: float) -> tuple[float, float]:
    """Return the Coulomb force of a mass, forwards and backwards."""
    more = b.motor.coulomb_drift * time if mass == 0 else b.load.coulomb_drift * time + b.load.per_torque * abs(spring)
    forwards, backwards = (p.coulomb1, p.coulomb1_back) if mass == 0 else (p.coulomb2, p.coulomb2_back)
    return forwards + more, backwards + more


@inline_kernel
def _settle(
    p: Drive, b: SmoothLaws, places: FloatArray, mode: int, y: FloatArray, mass: int, time: float, torque: float
) -> int:
    """Return the mode of a mass at rest: 0 while friction can hold it, else the way it is pushed."""
    push, spring = _push(p, b, places, y, mass, torque)
    forwards, backwards = _bounds(p, b, mass, spring, time)
    soft = b.motor.presliding if mass == 0 else b.load.presliding
    new = 0
    if soft > 0.0:
        rest = push - y[WOUND1 + mass] * (forwards if mode > 0 else backwards)
        new = 1 if rest > 0.0 else (-1 if rest < 0.0 else mode)
    elif push > forwards:
        new = 1
    elif push < -backwards:
        new = -1
    return new


@inline_kernel
def accelerations_of(
    p: Drive, b: SmoothLaws, places: FloatArray, m: Modes, y: FloatArray, time: float, torque: float
) -> tuple[float, float]:
    """Return the accelerations of motor and load."""
    found1, found2 = 0.0, 0.0
    for mass in range(2):
        mode = m.motor if mass == 0 else m.load
        if mode == 0:
            continue
        push, spring = _push(p, b, places, y, mass, torque)
        forwards, backwards = _bounds(p, b, mass, spring, time)
        soft = b.motor.presliding if mass == 0 else b.load.presliding
        held = (forwards if mode > 0 else backwards) * (y[WOUND1 + mass] if soft > 0.0 else mode)
        if mass == 0:
            viscous = (p.viscous1 if mode > 0 else p.viscous1_back) + b.motor.viscous_drift * time
            found1 = (push - viscous * y[1] - held) / p.inertia1
        else:
            viscous = (p.viscous2 if mode > 0 else p.viscous2_back) + b.load.viscous_drift * time
            found2 = (push - viscous * y[3] - held) / ((1.0 - b.spring.swing_share) * p.inertia2)
    return found1, found2


@inline_kernel
def _begin_part(
    p: Drive, b: SmoothLaws, places: FloatArray, m: Modes, y: FloatArray, time: float, torque: float
) -> tuple[Modes, Known]:
    """Return modes and known guards at the beginning of a part."""
    motor, load, rate, sign = m.motor, m.load, m.rate, m.torque
    if y[1] == 0.0:
        motor = _settle(p, b, places, motor, y, 0, time, torque)
    _, spring = _push(p, b, places, y, 1, torque)
    sign = -sign if sign * spring < 0.0 else sign
    if y[3] == 0.0:
        load = _settle(p, b, places, load, y, 1, time, torque)
    still = y[3] == y[1]
    if b.spring.slider > 0.0 and still:
        a1, a2 = accelerations_of(p, b, places, Modes(motor, load, rate, sign), y, time, torque)
        rate = -rate if rate * (a2 - a1) < 0.0 else rate
    known1, known2 = int(motor != 0 and y[1] == 0.0), int(load != 0 and y[3] == 0.0)
    return Modes(motor, load, rate, sign), Known(known1, known2, int(still), 0)


@inline_kernel
def _after(
    p: Drive, b: SmoothLaws, places: FloatArray, m: Modes, known: Known, y: FloatArray, which: int, time: float,
    torque: float, tape: FloatArray, taped: int,
) -> tuple[Modes, Known]:  # fmt: skip
    """Return the modes after the event of a guard, and what is then known; a velocity that fell to 0 is 0."""
    motor, load, rate, sign = m.motor, m.load, m.rate, m.torque
    known1, known2, known3, known4 = known.motor, known.load, known.rate, known.torque
    if which == 4:
        rate, known3 = -rate, 1
    elif which == 5:
        sign, known4 = -sign, 1
    else:
        mass, loose = which // 2, 1 - 2 * (which % 2)
        mode, known_mass, soft = (motor, known1, b.motor.presliding) if mass == 0 else (load, known2, b.load.presliding)
        back = known_mass == 2
        stopped = mode != 0 and not back
        if stopped:
            y[1 + 2 * mass] = 0.0
        if soft > 0.0:
            mode, known_mass = -mode, 1
        else:
            mode, known_mass = mode_after(
                mode, loose if mode == 0 else 0, back, _settle(p, b, places, mode, y, mass, time, torque)
            )
        if mass == 0:
            motor, known1 = mode, known_mass
        else:
            load, known2 = mode, known_mass
        if stopped and taped >= 0:
            new = Modes(motor, load, rate, sign)
            before = accelerations_of(p, b, places, m, y, time, torque)[mass]
            after = accelerations_of(p, b, places, new, y, time, torque)[mass]
            tape[taped, 17] = mass
            # Friction grows where a mass turns round, so the ratio is between 0 and 1; grazing leaves 0/0.
            tape[taped, 18] = min(max(after / before, 0.0), 1.0) if before != 0.0 else 0.0
    return Modes(motor, load, rate, sign), Known(known1, known2, known3, known4)


@inline_kernel
def _advance(b: SmoothLaws, m: Modes, c: FloatArray, t: float, y: FloatArray) -> None:
    """Write the state after a share of a step; complete what is nearly wound up."""
    for i in range(STATES):
        if (
            (4 <= i <= 5 and b.spring.swing_share == 0.0)
            or (i == WOUND1 and b.motor.presliding == 0.0)
            or (i == WOUND2 and b.load.presliding == 0.0)
        ):
            continue
        y[i] = series_value(c, i, t)
    for i in (WOUND1, WOUND2, WOUND):
        direction = m.motor if i == WOUND1 else (m.load if i == WOUND2 else m.rate)
        if abs(y[i] - direction) < _WOUND_UP:
            y[i] = direction


@inline_kernel
def _note(row: FloatArray, part: int, h: float, m: Modes, known: Known, y: FloatArray) -> None:
    """Write a step into its row of the tape."""
    row[0], row[1], row[2], row[3], row[4], row[5] = part, h, m.motor, m.load, m.rate, m.torque
    row[6], row[7], row[17], row[18] = known.motor == 2, known.load == 2, -1.0, 0.0
    for i in range(STATES):
        row[8 + i] = y[i]


@compile_kernel
def run(
    drive: FloatArray,
    b: SmoothLaws,
    places: FloatArray,
    loop: SampledLoop,
    before: float,
    z: FloatArray,
    x: FloatArray,
    sliding: float,
    far: float,
    trace: Trace,
) -> int:
    """Simulate one loop; fill the trace and return how it ended.

    Args:
        drive: (14,) the coefficients, as in `kernels.drive.run`.
        b: what the laws have beside their lines.
        places: (forces, 5) that follow a position, each as gravity in `kernels.drive.run`, on the side in the last
            column: 0 for the motor's.
        loop: what drives it.
        before: torque that acted before the first period.
        z: state of the feedback, overwritten.
        x: (4,) initial state, overwritten.
        sliding: 1 or -1 where friction is wound up at the first sample, the direction of the motion; else 0.
        far: a motor position above which the loop counts as diverged.
        trace: out; its tape is (rows, STEP_TAPE), of as many steps as it holds.
    """
    w, post, lengths, lags, feedback = loop.w, loop.post, loop.lengths, loop.lags, loop.feedback
    u, excess, counts = trace.u, trace.excess, trace.counts
    states, accelerations, tape = trace.states, trace.accelerations, trace.tape
    n, parts = w.shape[1], lengths.size
    p = under_torque(drive, b, before)
    y, c, roots = np.zeros(STATES), np.zeros((ROWS, TERMS + 1)), np.empty(ROOM)
    turns = np.zeros((places.shape[0], 2, TERMS + 2))
    assign(y[:4], x)
    if b.spring.swing_share > 0.0:
        assign(y[4:6], x[2:])  # what swings moves with the load
    y[WOUND1], y[WOUND2] = (sliding if b.motor.presliding > 0.0 else 0.0), (sliding if b.load.presliding > 0.0 else 0.0)
    first, second = (1 if x[1] >= 0.0 else -1), (1 if x[3] >= 0.0 else -1)
    m = Modes(
        first if x[1] != 0.0 or b.motor.presliding > 0.0 else 0,
        second if x[3] != 0.0 or b.load.presliding > 0.0 else 0, 1,
        1 if p.stiffness * (x[2] - x[0]) >= 0.0 else -1,
    )  # fmt: skip
    fresh, out, cut = np.empty(z.size), np.zeros(w.shape[0]), np.zeros(w.shape[0])
    events, steps, clipped, status, fastest = 0, 0, 0, FINISHED, 0.0
    keep = states.shape[0] > 0
    period = np.sum(lengths)
    i = 0
    while i < n and status == FINISHED:
        control_any(feedback, w, i, y[0], z, fresh, out, cut)
        u[i] = out[feedback.output]
        if excess.shape[0] > 0:
            assign(excess[i], cut)
        if cut[feedback.output] != 0.0:
            clipped += 1
        if not (abs(y[0]) <= far and abs(u[i]) < np.inf):
            status = DIVERGED
            break
        time, before_period = i * period, events
        for part in range(parts):
            source = i - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            p = under_torque(drive, b, torque)
            m, known = _begin_part(p, b, places, m, y, time, torque)
            if keep:
                row = i * parts + part
                assign(states[row], y[:4])
                accelerations[row] = accelerations_of(p, b, places, m, y, time, torque)
            left = lengths[part]
            while left > 0.0 and status == FINISHED:
                h = left
                fill_series(p, b, places, m, known, y, time, torque, h, c, turns)
                share = _share(c, fastest)
                while share == 0.0 and h > _SHORTEST * period:  # above the largest number
                    h *= 0.1
                    fill_series(p, b, places, m, known, y, time, torque, h, c, turns)
                    share = _share(c, fastest)
                if share < 1.0:
                    _shorten(c, share)
                    h *= share
                steps += 1
                if (h < left and h < _SHORTEST * period) or steps > _WORK * n + 10_000:
                    status = TOO_STIFF
                    break
                moment, which = _locate_first(p, b, m, known, c, roots)
                t = min(moment, 1.0)
                taped = steps - 1 if steps <= tape.shape[0] else -1
                if taped >= 0:
                    _note(tape[taped], i * parts + part, t * h, m, known, y)
                if t > 0.0:
                    _advance(b, m, c, t, y)
                    known = Known(0, 0, 0, 0)
                    time += t * h
                    left = 0.0 if t == 1.0 and h == left else left - t * h
                    fastest = max(fastest, abs(y[1]), abs(y[3]))
                if moment <= 1.0:
                    events += 1
                    m, known = _after(p, b, places, m, known, y, which, time, torque, tape, taped)
                    if events - before_period > _EVENTS:
                        status = CHATTERING
        i += 1
    assign(x, y[:4])
    counts[0], counts[1], counts[2], counts[3] = events, steps, i, min(clipped, i)
    return status
