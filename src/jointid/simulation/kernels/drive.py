"""The exact simulation of one drive in its sampled loop, compiled.

Between two events the drive is linear and its torque is held, so a whole controller period is one affine map,
exact to rounding; each sliding, sticking and direction mode of the two masses has its own. Three layers make it fast:

1. the map, applied once a period;
2. a proof that no mass reversed, stuck or came loose inside the period: by chords in a few operations (`_glide`), or
   by parabolas in some forty (`_calm`);
3. where the proof fails, about one period in a hundred, an event solver (`_travel`): Taylor series of the motion,
   the first event isolated by the signs of its Bernstein coefficients, friction as a set (a mass at rest stays
   at rest while its Coulomb force can hold it).

A rigid joint is the same drive with no spring and a load that nothing pushes: the load sticks for ever.

State ``x`` = motor position, motor velocity, load position, load velocity. Functions pass numbers and tuples rather
than arrays: Numba counts references to an array at each call, with an atomic operation as dear as thirty others.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.control import SmallLaw, control_any, small_law
from jointid.simulation.kernels.polynomial import ORDER, ROOM, SOUGHT, first_root, value_at
from jointid.simulation.kernels.tables import CHATTERING, DIVERGED, FINISHED, TOO_STIFF, IntArray, SampledLoop, Trace

State: TypeAlias = tuple[float, float, float, float]

_MAP = 24  # one mode's map: five columns of four, then what its proofs need
# Longest Taylor step, as a fraction of 1/(fastest rate of the drive): the remainder of a series of the order `ORDER` is
# at most 30 times the rounding error.
STEP = 0.25
_EVENTS = 200  # per period; a physical drive has a handful
_PIECES = 4096  # Taylor steps per period at most: a drive faster than that is no drive under this controller
_WORK = 20  # Taylor steps a simulation may take, per period: bounds the time an absurd candidate can cost

_SPRING = 4  # row of the event solver's scratch after the states: the spring's force
_FACTOR = np.array([1.0 / math.factorial(i) for i in range(ORDER + 1)])


class Drive(NamedTuple):
    """One drive: the row of coefficients that `run` is given, friction per direction."""

    inertia1: float
    inertia2: float
    stiffness: float
    damping: float
    viscous1: float
    viscous1_back: float
    coulomb1: float
    coulomb1_back: float
    viscous2: float
    viscous2_back: float
    coulomb2: float
    coulomb2_back: float
    offset1: float  # constant forces the motor and the load work against
    offset2: float


class Motion(NamedTuple):
    """The drive in one mode, where it is linear; a mass at rest is one that no force can move."""

    mobility1: float
    mobility2: float
    viscous1: float
    viscous2: float
    force1: float
    force2: float


@inline_kernel
def motion(p: Drive, m1: int, m2: int) -> Motion:
    """Return the drive in one mode."""
    mobility1, viscous1, force1 = 0.0, 0.0, 0.0
    if m1 != 0:
        mobility1 = 1.0 / p.inertia1
        viscous1 = p.viscous1 if m1 > 0 else p.viscous1_back
        force1 = -p.offset1 - (p.coulomb1 if m1 > 0 else -p.coulomb1_back)
    mobility2, viscous2, force2 = 0.0, 0.0, 0.0
    if m2 != 0:
        mobility2 = 1.0 / p.inertia2
        viscous2 = p.viscous2 if m2 > 0 else p.viscous2_back
        force2 = -p.offset2 - (p.coulomb2 if m2 > 0 else -p.coulomb2_back)
    return Motion(mobility1, mobility2, viscous1, viscous2, force1, force2)


@inline_kernel
def drive_of(d: FloatArray) -> Drive:
    """Return the drive of a row of coefficients, (14,) or more."""
    return Drive(d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8], d[9], d[10], d[11], d[12], d[13])


@inline_kernel
def accelerate(p: Drive, f: Motion, v1: float, stretch: float, v2: float, s: float) -> tuple[float, float]:
    """Return the accelerations of both masses under a torque."""
    spring = p.stiffness * stretch + p.damping * (v2 - v1)
    a1 = (s + spring + f.force1 - f.viscous1 * v1) * f.mobility1
    return a1, (f.force2 - spring - f.viscous2 * v2) * f.mobility2


@inline_kernel
def _settle(p: Drive, x: State, s: float, mass: int) -> int:
    """Return the mode of a mass at rest: 0 while its Coulomb force can hold the push, else the push's direction."""
    spring = p.stiffness * (x[2] - x[0]) + p.damping * (x[3] - x[1])
    push, forwards, backwards = s - p.offset1 + spring, p.coulomb1, p.coulomb1_back
    if mass == 1:
        push, forwards, backwards = -p.offset2 - spring, p.coulomb2, p.coulomb2_back
    mode = 0
    if push > forwards:
        mode = 1
    elif push < -backwards:
        mode = -1
    return mode


@inline_kernel
def fastest_rate(p: Drive) -> float:
    """Bound in 1/s on how fast the drive's own motion can change: spring plus damping."""
    mobility = 1.0 / p.inertia1 + 1.0 / p.inertia2
    viscous1 = max(abs(p.viscous1), abs(p.viscous1_back)) / p.inertia1
    viscous2 = max(abs(p.viscous2), abs(p.viscous2_back)) / p.inertia2
    return math.sqrt(p.stiffness * mobility) + p.damping * mobility + viscous1 + viscous2


@compile_kernel
def _fill_map(m: FloatArray, b: int, c: FloatArray, p: Drive, m1: int, m2: int, h: float) -> None:
    """Write the map of one mode over `h` seconds at m[b:], column by column, and the margins of its proofs.

    A column is what the motion adds to the positions, and its final velocities, when it starts from a unit of motor
    velocity, stretch or load velocity, or from rest under a unit of torque or the constant forces.
    """
    f, pieces = motion(p, m1, m2), max(math.ceil(fastest_rate(p) * h / STEP), 1)
    free = Motion(f.mobility1, f.mobility2, f.viscous1, f.viscous2, 0.0, 0.0)
    for column in range(5):
        v1, v2 = 1.0 if column == 0 and m1 != 0 else 0.0, 1.0 if column == 2 and m2 != 0 else 0.0
        begin = 1.0 if column == 1 else 0.0
        x = 0.0, v1, begin, v2
        for _ in range(pieces):
            fill_series(c, p, f if column == 4 else free, x, 1.0 if column == 3 else 0.0, h / pieces, False, False)
            x = value_at(c, 0, 1.0), value_at(c, 1, 1.0), value_at(c, 2, 1.0), value_at(c, 3, 1.0)
        at = b + 4 * column
        m[at], m[at + 1], m[at + 2], m[at + 3] = x[0], x[1], x[2] - begin, x[3]
    bend1, bend2, growth = _margins(p, f, m1, m2, h)
    m[b + 20], m[b + 21] = bend1 * growth, bend2 * growth
    m[b + 22], m[b + 23] = (bend1, bend2) if growth == 1.0 else (np.inf, np.inf)


@inline_kernel
def _margins(p: Drive, f: Motion, m1: int, m2: int, h: float) -> tuple[float, float, float]:
    """Return how far what must stay positive can bend from its chord in a period, per root energy; and its growth.

    While the torque is held, the energy of the rates of change, E = M1 a1^2 + M2 a2^2 + K (v2 - v1)^2, can only
    fall (its root grows by at most `growth` where a candidate has negative viscous friction), so it bounds every
    second derivative over the period by its value at the start; a function stays within h^2/8 max|f''| of its chord.
    The root energy is sqrt(M1 E), so that a change of the torque changes it by no more than itself.
    """
    root1, root2 = math.sqrt(p.inertia1), math.sqrt(p.inertia2)
    shared = math.sqrt(p.stiffness) + p.damping * (1.0 / root1 + 1.0 / root2)
    bend1 = (abs(f.viscous1) / root1 + shared) / p.inertia1  # of the motor's velocity
    bend2 = (abs(f.viscous2) / root2 + shared) / p.inertia2  # of the load's velocity
    push1 = p.stiffness / root2 + p.damping * bend2  # of the push on a motor at rest
    push2 = p.stiffness / root1 + p.damping * bend1  # of the push on a load at rest
    lowest = min(f.viscous1 * f.mobility1, f.viscous2 * f.mobility2, 0.0)
    growth = math.exp(min(-lowest * h, 50.0))
    bend = h * h / 8.0 / root1
    return bend * (bend1 if m1 != 0 else push1), bend * (bend2 if m2 != 0 else push2), growth


@inline_kernel
def _positive(start: float, slope: float, end: float, margin: float) -> bool:
    """Prove that a function is positive between two non-negative ends.

    It differs from the parabola with the same ends and first slope by at most h^3/6 max|f'''| t^2 (1 - t), t from 0
    to 1. `slope` is h f', and `margin` h^3/6 max|f'''|.
    """
    return start >= 0.0 and end >= 0.0 and 2.0 * start + slope >= margin


@inline_kernel
def _stays(
    mode: int, v: float, slope: float, end: float, forwards: float, backwards: float, push: float, rate: float,
    push_end: float, margin: float,
) -> bool:  # fmt: skip
    """Prove that a mass goes on in its mode: the velocity keeps its sign, or the push stays within the cone."""
    if mode != 0:
        return mode * end > 0.0 and _positive(mode * v, mode * slope, mode * end, margin)
    return _positive(forwards - push, -rate, forwards - push_end, margin) and _positive(
        backwards + push, rate, backwards + push_end, margin
    )


@inline_kernel
def _calm(
    p: Drive, f: Motion, bend1: float, bend2: float, x: State, y: State, s: float, m1: int, m2: int, h: float
) -> tuple[bool, float]:
    """Prove that a period from `x` to `y` under a held torque `s` has no event; return that and the root energy at `x`.

    The root energy is sqrt(M1 E), a torque (see `_margins`); that of the rates of the rates bounds third derivatives
    as that of the rates bounds second ones. False means "not proved".
    """
    x0, x1, x2, x3 = x
    y0, y1, y2, y3 = y
    apart = x3 - x1
    spring, end = p.stiffness * (x2 - x0) + p.damping * apart, p.stiffness * (y2 - y0) + p.damping * (y3 - y1)
    a1, a2 = accelerate(p, f, x1, x2 - x0, x3, s)
    slope = p.stiffness * apart + p.damping * (a2 - a1)  # of the spring's force
    j1 = (slope - f.viscous1 * a1) * f.mobility1
    j2 = (-slope - f.viscous2 * a2) * f.mobility2
    root = math.sqrt(p.inertia1 * (p.inertia1 * a1 * a1 + p.inertia2 * a2 * a2 + p.stiffness * apart * apart))
    third = math.sqrt(p.inertia1 * (p.inertia1 * j1 * j1 + p.inertia2 * j2 * j2 + p.stiffness * (a2 - a1) ** 2))
    third *= 4.0 / 3.0 * h
    push1, push2, rate = s - p.offset1, -p.offset2, slope * h
    calm = _stays(
        m1, x1, a1 * h, y1, p.coulomb1, p.coulomb1_back, push1 + spring, rate, push1 + end, bend1 * third
    ) and _stays(m2, x3, a2 * h, y3, p.coulomb2, p.coulomb2_back, push2 - spring, -rate, push2 - end, bend2 * third)
    return calm, root


@inline_kernel
def fill_series(c: FloatArray, p: Drive, f: Motion, x: State, s: float, h: float, loose1: bool, loose2: bool) -> None:
    """Fill c[state, order] with the Taylor series of the motion over a step of `h`, time counted in steps.

    A mass that has just come loose (`loose`) has, exactly, no velocity and no acceleration: rounding must not
    give it one, or the sign of the motion that follows would be noise.
    """
    h1, h2 = h * f.mobility1, h * f.mobility2
    stiff1, stiff2, damp1, damp2 = p.stiffness * h1, p.stiffness * h2, p.damping * h1, p.damping * h2
    drag1, drag2 = f.viscous1 * h1, f.viscous2 * h2
    force1, force2 = (s + f.force1) * h1, f.force2 * h2
    c[0, 0], c[2, 0] = x[0], x[2]
    stretch, v1, v2 = x[2] - x[0], x[1], x[3]
    for k in range(ORDER + 1):
        apart = v2 - v1
        c[1, k], c[3, k] = v1 * _FACTOR[k], v2 * _FACTOR[k]
        c[_SPRING, k] = (p.stiffness * stretch + p.damping * apart) * _FACTOR[k]
        if k < ORDER:
            c[0, k + 1], c[2, k + 1] = v1 * (h * _FACTOR[k + 1]), v2 * (h * _FACTOR[k + 1])
        v1 = ((force1 + stiff1 * stretch) - drag1 * v1) + damp1 * apart
        v2 = ((force2 - stiff2 * stretch) - drag2 * v2) - damp2 * apart
        stretch = h * apart
        force1, force2 = 0.0, 0.0
        if k == 0:
            v1, v2 = 0.0 if loose1 else v1, 0.0 if loose2 else v2


@inline_kernel
def _locate_first(c: FloatArray, p: Drive, s: float, modes: IntArray, known: IntArray) -> tuple[float, int, int]:
    """Return when the first event is (2.0: not in this step), in steps, its mass, and the mode that comes loose to.

    A sliding mass stops when its velocity falls to zero; one at rest comes loose when the push on it leaves its cone,
    forwards or backwards. `known` counts the leading coefficients of a velocity that are zero by construction, or is
    the direction of the edge of its cone where a mass is at rest: these are divided out, so that the root at the start
    is not found again.
    """
    first, which, loose = 2.0, 0, 0
    for guard in range(4):
        mass, direction = guard // 2, 1 - 2 * (guard % 2)
        mode, row = modes[mass], 1 + 2 * mass
        if mode == -direction:
            continue
        if mode != 0 and known[mass] == 2 and mode * c[row, 2] <= 0.0:  # came loose, but is pushed back: never moved
            first, which, loose = 0.0, mass, 0
            break
        out, constant, sign = known[mass], 0.0, float(mode)
        if mode == 0:
            out, row, sign = int(known[mass] == direction), _SPRING, float(direction if mass == 1 else -direction)
            push, forwards, backwards = s - p.offset1, p.coulomb1, p.coulomb1_back
            if mass == 1:
                push, forwards, backwards = -p.offset2, p.coulomb2, p.coulomb2_back
            constant = (forwards if direction > 0 else backwards) - direction * push
        for i in range(ORDER + 1):
            c[SOUGHT, i] = sign * c[row, i]
        c[SOUGHT, 0] += constant
        for _ in range(out):  # at the edge only a push that grows leads out
            for i in range(ORDER):
                c[SOUGHT, i] = c[SOUGHT, i + 1]
            c[SOUGHT, ORDER] = 0.0
        moment = first_root(c)
        if moment < first:
            first, which, loose = moment, mass, direction if mode == 0 else 0
    return first, which, loose


@inline_kernel
def _travel(
    c: FloatArray, p: Drive, x: FloatArray, modes: IntArray, known: IntArray, s: float, h: float, tape: FloatArray,
    row: int, part: int,
) -> tuple[int, int]:  # fmt: skip
    """Move `x` and its modes over `h` seconds under a held torque `s` with every event located.

    Return events and Taylor steps. The number of events is negative when there are more than a physical drive can have.
    Each step is a row of the tape, from `row` on, as far as it goes. For `known` see `_locate_first`.
    """
    longest, events, steps, done = STEP / fastest_rate(p), 0, 0, 0.0
    for mass in range(2):
        known[mass] = 1 if modes[mass] != 0 and x[1 + 2 * mass] == 0.0 else 0
    while done < h and events >= 0:
        remaining = h - done
        pieces = max(math.ceil(remaining / longest), 1)
        step = remaining / pieces
        loose1, loose2 = modes[0] != 0 and known[0] == 2, modes[1] != 0 and known[1] == 2
        fill_series(c, p, motion(p, modes[0], modes[1]), (x[0], x[1], x[2], x[3]), s, step, loose1, loose2)
        first, mass, loose = _locate_first(c, p, s, modes, known)
        t, taped, mode = min(first, 1.0), row + steps, modes[mass]
        steps += 1
        if taped < tape.shape[0]:
            tape[taped, 0], tape[taped, 1], tape[taped, 2], tape[taped, 3] = part, t * step, modes[0], modes[1]
            tape[taped, 4], tape[taped, 5], tape[taped, 6], tape[taped, 7] = x[0], x[1], x[2], x[3]
            tape[taped, 8], tape[taped, 9] = -1.0, 0.0
        back = t == 0.0 and mode != 0 and known[mass] == 2  # came loose, and is pushed back at once
        if t > 0.0:
            for i in range(4):
                x[i] = value_at(c, i, t)
            done = h if pieces == 1 and t == 1.0 else done + t * step
            known[0], known[1] = 0, 0
        if first <= 1.0:
            stopped = mode != 0 and not back
            if stopped:
                x[1 + 2 * mass] = 0.0
            settled = _settle(p, (x[0], x[1], x[2], x[3]), s, mass)
            modes[mass], known[mass] = settled, abs(settled)
            if mode == 0:
                modes[mass], known[mass] = loose, 2
            elif back or settled == mode:  # stopped where rounding says it may go on: at rest, at that edge of its cone
                modes[mass], known[mass] = 0, mode
            if stopped and taped < tape.shape[0]:
                tape[taped, 8], tape[taped, 9] = mass, modes[mass]
            events = events + 1 if events < _EVENTS else -1
    return events, steps


@inline_kernel
def _glide(
    resting: bool, p: Drive, law: SmallLaw, lag: int, before: float, w: FloatArray, post: FloatArray, u: FloatArray,
    excess: FloatArray, states: FloatArray, m: FloatArray, b: int, m1: int, m2: int, z: tuple[float, float], x: State,
    bound: float, last: float, k: int,
) -> tuple[int, int, State, tuple[float, float]]:  # fmt: skip
    """Simulate from period `k` while a chord shows that nothing happens; `resting` if a mass stands still.

    Return the first period that is left to `_calm`, where the controller has already run; how often it was at its
    limit; and both states. A chord needs the root energy (see `_calm`): `bound` bounds it in a period before under the
    torque `last`, and it grows by at most the change of the torque. For a torque that acts over whole periods, and a
    controller with at most two states.
    """
    x0, x1, x2, x3 = x
    p00, p10, p20, p30 = m[b], m[b + 1], m[b + 2], m[b + 3]
    p01, p11, p21, p31 = m[b + 4], m[b + 5], m[b + 6], m[b + 7]
    p02, p12, p22, p32 = m[b + 8], m[b + 9], m[b + 10], m[b + 11]
    g0, g1, g2, g3 = m[b + 12], m[b + 13], m[b + 14], m[b + 15]
    f0, f1, f2, f3 = m[b + 16], m[b + 17], m[b + 18], m[b + 19]
    chord1, chord2 = (m[b + 22], m[b + 23]) if m1 != 0 or m2 != 0 else (0.0, 0.0)  # where nothing moves, nothing bends
    # Velocities in the direction of their mode are positive while nothing happens.
    d1, d2 = -1.0 if m1 < 0 else 1.0, -1.0 if m2 < 0 else 1.0
    x1, p00, p20, p11, p31, g1, f1 = d1 * x1, d1 * p00, d1 * p20, d1 * p11, d2 * p31, d1 * g1, d1 * f1
    x3, p02, p22, p12, p30, g3, f3 = d2 * x3, d2 * p02, d2 * p22, d1 * d2 * p12, d1 * d2 * p30, d2 * g3, d2 * f3
    keep = states.shape[0] > 0
    clipped = 0
    stretch = x2 - x0
    while k < w.size:
        at = np.uint64(k)  # Numba looks for negative indices among the signed
        raw = (w[at] + law.d * x0) + (law.c0 * z[0] + law.c1 * z[1])
        command = raw
        z0 = law.b0 * x0 + (law.a00 * z[0] + law.a01 * z[1])
        z1 = law.b1 * x0 + (law.a10 * z[0] + law.a11 * z[1])
        if not abs(raw) <= law.limit:  # a branch: the limit stays out of the chain of operations from state to state
            command = min(max(raw, -law.limit), law.limit)
            z0, z1, clipped = z0 + law.f0 * (command - raw), z1 + law.f1 * (command - raw), clipped + 1
            if excess.shape[0] > 0:
                excess[at, 0] = command - raw
        z = z0, z1
        u[at] = command
        s = before
        if lag == 0:
            s = command + post[at]
        elif k >= lag:
            s = u[np.uint64(k - lag)] + post[np.uint64(k - lag)]
        if keep:
            states[at, 0], states[at, 1], states[at, 2], states[at, 3] = x0, d1 * x1, x2, d2 * x3
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
            least, most = min(spring, end), max(spring, end)
            # A cone without width holds what nothing pushes: the load of a rigid joint.
            if m1 == 0:
                room1 = 1e-300 + min(p.coulomb1 - (s - p.offset1 + most), p.coulomb1_back + (s - p.offset1 + least))
            if m2 == 0:
                room2 = 1e-300 + min(p.coulomb2 + (p.offset2 + least), p.coulomb2_back - (p.offset2 + most))
        if not (room1 > chord1 * bound and room2 > chord2 * bound):
            break
        x0, x1, x2, x3 = y0, y1, y2, y3
        stretch = y2 - y0
        k += 1
    return k, clipped, (x0, d1 * x1, x2, d2 * x3), z


@compile_kernel
def run(
    drive: FloatArray,
    loop: SampledLoop,
    before: float,
    z: FloatArray,
    x: FloatArray,
    far: float,
    trace: Trace,
) -> int:
    """Simulate one loop; fill the trace and return how it ended.

    Args:
        drive: (14,) coefficients: inertias, stiffness, damping; viscous forwards, backwards, Coulomb forwards,
            backwards of the motor, then of the load; constant force the motor works against, and the load.
        loop: what drives it, the one joint.
        before: torque that acted before the first period.
        z: (1, nz) state of the controller's feedback; may be overwritten.
        x: (4,) initial state, overwritten.
        far: a motor position above which the loop counts as diverged.
        trace: out.
    """
    w, post, lengths, lags, feedback = loop.w, loop.post[0], loop.lengths, loop.lags[0], loop.feedback
    u, excess, counts = trace.u, trace.excess, trace.counts
    states, modes, tape = trace.states, trace.modes, trace.tape
    n, parts, nz = w.shape[2], lengths.size, z.shape[1]
    p = drive_of(drive)
    part_length = 0.0
    for part in range(parts):
        part_length = max(part_length, lengths[part])
    if part_length * fastest_rate(p) > _PIECES * STEP:
        return TOO_STIFF
    maps = np.empty(parts * 9 * _MAP)
    filled = np.zeros(9, dtype=np.bool_)
    c, going, known = np.empty(ROOM), np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    new, out, cut = np.empty(nz), np.zeros(w.shape[1]), np.zeros(w.shape[1])
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    m1 = 0 if x1 == 0.0 else (1 if x1 > 0.0 else -1)
    m2 = 0 if x3 == 0.0 else (1 if x3 > 0.0 else -1)
    keep = states.shape[0] > 0
    events, steps, clipped = 0, 0, 0
    status = FINISHED
    alone = feedback.D.size == 1 and feedback.driven.shape[1] == 0  # one phase, one element
    simple = parts == 1 and nz <= 2 and alone
    law, sole, memory = small_law(feedback, nz if simple else 0), w[0, 0], (0.0, 0.0)
    if simple and nz > 0:
        memory = z[0, 0], z[0, nz - 1] if nz > 1 else 0.0
    bound, last = np.inf, 0.0
    k = 0
    while k < n and status == FINISHED:
        if simple:
            start, started = (x0, x1, x2, x3), k
            mode = 3 * m1 + m2 + 4
            b = mode * _MAP
            if not filled[mode]:
                filled[mode] = True
                _fill_map(maps, b, c, p, m1, m2, lengths[0])
            resting = m1 == 0 or m2 == 0
            k, limited, start, memory = _glide(
                resting, p, law, lags[0], before, sole, post, u, excess, states, maps, b, m1, m2, memory, start, bound,
                last, k,
            )  # fmt: skip
            x0, x1, x2, x3 = start
            clipped += limited
            if keep:
                modes[started:k] = mode
            if k == n:
                break
        else:
            control_any(feedback, 0, w, k, x0, z, new, out, cut)
            u[k] = out[feedback.output[0]]
            if excess.shape[0] > 0:
                assign(excess[k], cut)
            if cut[feedback.output[0]] != 0.0:
                clipped += 1
        if not (abs(x0) <= far and abs(u[k]) < np.inf):
            status = DIVERGED
            break
        for part in range(parts):
            if keep:
                row = k * parts + part
                states[row, 0], states[row, 1], states[row, 2], states[row, 3] = x0, x1, x2, x3
            source = k - lags[part]
            s = u[source] + post[source] if source >= 0 else before
            if x1 == 0.0:
                m1 = _settle(p, (x0, x1, x2, x3), s, 0)
            if x3 == 0.0:
                m2 = _settle(p, (x0, x1, x2, x3), s, 1)
            mode = 3 * m1 + m2 + 4
            if keep:
                modes[k * parts + part] = mode
            if not filled[mode]:
                filled[mode] = True
                for other in range(parts):
                    _fill_map(maps, (9 * other + mode) * _MAP, c, p, m1, m2, lengths[other])
            b = (9 * part + mode) * _MAP
            y0, y1, y2, y3 = x0, 0.0, x2, 0.0
            for column, size in enumerate((x1, x2 - x0, x3, s, 1.0)):
                at = b + 4 * column
                y0, y1 = y0 + maps[at] * size, y1 + maps[at + 1] * size
                y2, y3 = y2 + maps[at + 2] * size, y3 + maps[at + 3] * size
            f = motion(p, m1, m2)
            last = s
            calm, bound = _calm(
                p, f, maps[b + 20], maps[b + 21], (x0, x1, x2, x3), (y0, y1, y2, y3), s, m1, m2, lengths[part]
            )
            if calm:
                x0, x1, x2, x3 = y0, y1, y2, y3
            else:
                bound = np.inf
                x[0], x[1], x[2], x[3], going[0], going[1] = x0, x1, x2, x3, m1, m2
                found, used = _travel(c, p, x, going, known, s, lengths[part], tape, steps, k * parts + part)
                x0, x1, x2, x3, m1, m2 = x[0], x[1], x[2], x[3], going[0], going[1]
                events += max(found, 0)
                steps += used
                if found < 0:
                    status = CHATTERING
                elif steps > _WORK * n + 10_000:
                    status = TOO_STIFF
        k += 1
    x[0], x[1], x[2], x[3] = x0, x1, x2, x3
    counts[0], counts[1], counts[2], counts[3] = events, steps, k, min(clipped, k)
    return status
