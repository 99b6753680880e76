"""The simulation of masses in a chain under any law of friction and spring, by a Runge-Kutta method, compiled.

A joint whose laws are lines has affine maps (`kernels.drive`). All others are integrated here: the motor, the load, and
of an elastic load the part that swings, each tied to the next by a spring::

    J1 a1 = torque - offset1 - friction1 - places1 + T12
    J2 a2 = -offset2 - friction2 - places2 - T12 + T23
    J3 a3 = -T23

Between two events this is smooth, and integrated by the classical method of order 4. A step is a share of the time in
which the fastest part of the motion turns by one radian, so that the torque is within some 1e-5 of its peak.

What winds up over a displacement is a state w of its own, by the law of P. R. Dahl (Solid friction damping of
mechanical vibrations, AIAA Journal 14, 1976). With the direction d of the motion, and the displacement x since the
step began, it has a closed form, and is as exact as the motion::

    w' = (v - d v w) / s                w = d - (d - w0) exp(-d x / s)

The events are a mass that stops, one that comes loose, and a deflection that reverses where the spring has a slider.
The integrator locates them itself, so they do not lower its order.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.drive import (
    CHATTERING,
    DIVERGED,
    FINISHED,
    TOO_STIFF,
    SampledLoop,
    Trace,
    control_any,
)

# Columns of a mass: inertia, constant friction, viscous coefficients and Coulomb forces of both directions, the inverse
# of the displacement over which the latter wind up (0 of one that sticks), what both grow by per second, and what the
# second grow by per torque through the spring, of the motor per its own torque.
INERTIA, OFFSET, VISCOUS, VISCOUS_BACK, COULOMB, COULOMB_BACK, WINDING, VISCOUS_DRIFT, COULOMB_DRIFT, PER_TORQUE = (
    range(10)
)
MASS = 10
# Columns of a spring: stiffness, damping, cubic stiffness, limit of its slider, and the stiffness of that over it.
STIFFNESS, DAMPING, CUBIC, SLIPS, SLIDING = range(5)
SPRING = 5
# Columns of a force that follows a position: of its cosine, of its sine, of the position, phase per position, mass.
COS, SIN, RATE, WAVE, WHERE = range(5)

_MASSES = 3
_HELD = 2  # masses with friction: what swings has none
# Columns of the tape, a row for each step: its part and length, the kick of the motor by the torque's edge before it,
# the mass that stops at its end (or -1) with the acceleration then over that before; of the masses the mean positions,
# velocities, accelerations and rates of these, their modes, and what is wound up at the beginning; of the springs what
# is, and the directions in which they deflect.
PART, LENGTH, KICK, STOPPED, RATIO = range(5)
PLACE, SPEED, CHANGE, JERK, MODE, WOUND = (5 + _MASSES * i for i in range(6))
STRETCHED, WAY = WOUND + _MASSES, WOUND + 2 * _MASSES - 1
STEP_TAPE = WAY + _MASSES - 1

REACH = 0.3  # rad: how far the fastest part of the motion may turn in a step
_MANY = 4096.0  # steps of a part that show a drive that is too stiff
_WORK = 30.0  # rad that a simulation may take, per part: bounds the time an absurd candidate can cost
_EVENTS = 1000  # per period; a physical drive has a handful
_HOLD = 1.0 + 1e-9  # of the Coulomb force: what holds a mass, so that one at its limit is not decided by rounding
_AGAIN = 3  # times that the masses at rest are asked: what one does may move the other
_ROOT = 1e-12  # of a step: where an event is located to
_CLOSER = 80  # steps at most to locate it
_WOUND_UP = 1e-8  # of a limit: what is nearer to it than that is at it
_WINDS = 1e-4  # of a limit: where its winding up no longer shortens the steps
_STICKS = 30.0  # rad that a mass turns in a part on friction not wound up: above it cannot be told from Coulomb's


@inline_kernel
def winding(w: float, way: float, x: float, rate: float) -> float:
    """Return the wound-up share after a displacement, from `w` before it."""
    if w == way or rate == 0.0:
        return w
    return w - (way - w) * math.expm1(min(-way * x * rate, 1.0))


@inline_kernel
def _accelerate(
    masses: FloatArray, springs: FloatArray, places: FloatArray, mobility: FloatArray, modes: FloatArray,
    torque: float, time: float, q: FloatArray, v: FloatArray, w: FloatArray, a: FloatArray, push: FloatArray,
    grip: FloatArray,
) -> None:  # fmt: skip
    """Fill the accelerations, the push on each mass beside its Coulomb force, and the most that this force can be."""
    n, carried, spring = masses.shape[0], -torque, 0.0
    for i in range(n):
        force = -masses[i, OFFSET] - carried
        for j in range(places.shape[0]):
            if places[j, WHERE] == i:
                phase = places[j, WAVE] * q[i]
                force -= places[j, COS] * math.cos(phase) + places[j, SIN] * math.sin(phase) + places[j, RATE] * q[i]
        if i + 1 < n:
            e = q[i + 1] - q[i]
            spring = (springs[i, STIFFNESS] + springs[i, CUBIC] * e * e) * e + springs[i, DAMPING] * (v[i + 1] - v[i])
            spring += springs[i, SLIPS] * w[n + i]
            force += spring
        mode = modes[i]
        back = mode < 0.0 or (mode == 0.0 and force < 0.0)
        most = (
            (masses[i, COULOMB_BACK] if back else masses[i, COULOMB])
            + masses[i, COULOMB_DRIFT] * time
            + masses[i, PER_TORQUE] * abs(carried)
        )
        viscous = (masses[i, VISCOUS_BACK] if back else masses[i, VISCOUS]) + masses[i, VISCOUS_DRIFT] * time
        held = most * (w[i] if masses[i, WINDING] > 0.0 else mode)
        push[i], grip[i], carried = force, most, spring
        a[i] = (force - viscous * v[i] - held) * mobility[i] if mode != 0.0 else 0.0


@inline_kernel
def _settle(
    masses: FloatArray, modes: FloatArray, v: FloatArray, w: FloatArray, push: FloatArray, grip: FloatArray, loose: int
) -> bool:
    """Let masses at rest begin to move, or stay; return whether a mode has changed.

    One that has just come loose, `loose`, moves the way it is pushed.
    """
    changed = False
    for i in range(min(masses.shape[0], _HELD)):
        mode = modes[i]
        if v[i] != 0.0:
            continue
        if masses[i, WINDING] > 0.0:
            rest = push[i] - w[i] * grip[i]
            mode = math.copysign(1.0, rest) if rest != 0.0 else mode
        elif abs(push[i]) > _HOLD * grip[i] or i == loose:
            mode = math.copysign(1.0, push[i])
        else:
            mode = 0.0
        changed = changed or mode != modes[i]
        modes[i] = mode
    return changed


@inline_kernel
def _turn_sliders(springs: FloatArray, modes: FloatArray, v: FloatArray, a: FloatArray) -> None:
    """Set the directions of deflections at rest by their accelerations."""
    n = v.size
    for i in range(n - 1):
        if springs[i, SLIDING] > 0.0 and v[i + 1] == v[i] and modes[n + i] * (a[i + 1] - a[i]) < 0.0:
            modes[n + i] = -modes[n + i]


@inline_kernel
def _fastest_rate(
    masses: FloatArray, springs: FloatArray, places: FloatArray, mobility: FloatArray, modes: FloatArray,
    q: FloatArray, v: FloatArray, w: FloatArray, grip: FloatArray,
) -> float:  # fmt: skip
    """Return a bound in 1/s on how fast the motion changes by itself, or what acts on it changes with it."""
    n, square, rate = masses.shape[0], 0.0, 0.0
    for i in range(n):
        rate += max(masses[i, VISCOUS], masses[i, VISCOUS_BACK], 0.0) * mobility[i]
        left = abs(modes[i] - w[i])
        if masses[i, WINDING] > 0.0 and left > _WINDS:
            square += grip[i] * left * masses[i, WINDING] * mobility[i]
            rate += abs(v[i]) * masses[i, WINDING]
        if i + 1 < n:
            e, both = q[i + 1] - q[i], mobility[i] + mobility[i + 1]
            stiffness = springs[i, STIFFNESS] + max(3.0 * springs[i, CUBIC] * e * e, 0.0)
            left = abs(modes[n + i] - w[n + i])
            if springs[i, SLIDING] > 0.0 and left > _WINDS:
                stiffness += springs[i, SLIPS] * springs[i, SLIDING] * left
                rate += abs(v[i + 1] - v[i]) * springs[i, SLIDING]
            square += stiffness * both
            rate += springs[i, DAMPING] * both
    for j in range(places.shape[0]):
        i = int(places[j, WHERE])
        slope = abs(places[j, WAVE]) * (abs(places[j, COS]) + abs(places[j, SIN])) + abs(places[j, RATE])
        square += slope * mobility[i]
        rate += abs(places[j, WAVE] * v[i])
    return math.sqrt(square) + rate


@inline_kernel
def _guard(which: int, modes: FloatArray, v: FloatArray, push: FloatArray, grip: FloatArray) -> float:
    """Return a guard, positive until an event: a mass's speed, or what can hold it beyond its push; a spring's rate."""
    n = v.size
    if which >= n:
        return float(modes[which] * (v[which - n + 1] - v[which - n]))
    if modes[which] != 0.0:
        return float(modes[which] * v[which])
    return float(_HOLD * grip[which] - abs(push[which]))


@inline_kernel
def _find_first(
    springs: FloatArray, modes: FloatArray, h: float, v: FloatArray, a: FloatArray, push: FloatArray, grip: FloatArray,
    v1: FloatArray, a1: FloatArray, push1: FloatArray, grip1: FloatArray,
) -> tuple[int, float]:  # fmt: skip
    """Return the guard of the apparently first event in a step, and where: 1 if it shows at the end.

    Less than 1 is the bottom of a dip of a speed that is positive at both ends. No guard, -1, if there is no event.
    """
    n, first, found, at = v.size, 2.0, -1, 1.0
    for i in range(modes.size):
        if _HELD <= i < n or (i >= n and springs[i - n, SLIDING] == 0.0):
            continue
        start, end = _guard(i, modes, v, push, grip), _guard(i, modes, v1, push1, grip1)
        if end < 0.0 or (end == 0.0 and start > 0.0):
            place = start / (start - end)
            if place < first:
                first, found, at = place, i, 1.0
        elif i < n and modes[i] != 0.0 and start > 0.0:
            down, up = modes[i] * a[i] * h, modes[i] * a1[i] * h
            if down < 0.0 < up and min(start, end) < 0.15 * (up - down):
                # The cubic through both ends: where it is lowest, and how low.
                c2, c3 = 3.0 * (end - start) - 2.0 * down - up, 2.0 * (start - end) + down + up
                place = -down / (c2 + math.sqrt(max(c2 * c2 - 3.0 * c3 * down, 0.0)))
                lowest = start + place * (down + place * (c2 + place * c3))
                if 0.0 < place < 1.0 and lowest < 0.0 and place < first:
                    first, found, at = place, i, place
    return found, at


@inline_kernel
def _step(
    masses: FloatArray, springs: FloatArray, places: FloatArray, mobility: FloatArray, modes: FloatArray,
    torque: float, time: float, d: float, q: FloatArray, v: FloatArray, w: FloatArray, a: FloatArray,
    q1: FloatArray, v1: FloatArray, w1: FloatArray, a1: FloatArray, push1: FloatArray, grip1: FloatArray,
    second: FloatArray, third: FloatArray,
) -> None:  # fmt: skip
    """Fill where a step of `d` seconds leads, and the accelerations and forces there, in the modes of its beginning."""
    n = v.size
    for stage in range(4):
        for i in range(n):
            if stage == 0:
                q1[i], v1[i] = q[i] + 0.5 * d * v[i], v[i] + 0.5 * d * a[i]
            elif stage == 1:
                second[i] = a1[i]
                q1[i], v1[i] = q[i] + 0.5 * d * (v[i] + 0.5 * d * a[i]), v[i] + 0.5 * d * a1[i]
            elif stage == 2:
                third[i] = a1[i]
                q1[i], v1[i] = q[i] + d * (v[i] + 0.5 * d * second[i]), v[i] + d * a1[i]
            else:
                between = second[i] + third[i]
                q1[i] = q[i] + d * v[i] + d * d / 6.0 * (a[i] + between)
                v1[i] = v[i] + d / 6.0 * (a[i] + 2.0 * between + a1[i])
        for i in range(n):
            w1[i] = winding(w[i], modes[i], q1[i] - q[i], masses[i, WINDING])
            if i + 1 < n:
                e = (q1[i + 1] - q1[i]) - (q[i + 1] - q[i])
                w1[n + i] = winding(w[n + i], modes[n + i], e, springs[i, SLIDING])
        then = time + (0.5 * d if stage < 2 else d)
        _accelerate(masses, springs, places, mobility, modes, torque, then, q1, v1, w1, a1, push1, grip1)


@inline_kernel
def _write_row(
    row: FloatArray, modes: FloatArray, d: float, q: FloatArray, v: FloatArray, w: FloatArray, a: FloatArray,
    q1: FloatArray, v1: FloatArray, a1: FloatArray,
) -> None:  # fmt: skip
    """Write the motion of a step into its row of the tape."""
    n = v.size
    for i in range(n):
        middle = 0.5 * (q[i] + q1[i]) + 0.125 * d * (v[i] - v1[i])
        row[PLACE + i] = (q[i] + 4.0 * middle + q1[i]) / 6.0
        row[SPEED + i] = (q1[i] - q[i]) / d if d > 0.0 else v[i]
        row[CHANGE + i] = (v1[i] - v[i]) / d if d > 0.0 else a[i]
        row[JERK + i] = (a1[i] - a[i]) / d if d > 0.0 else 0.0
        row[MODE + i], row[WOUND + i] = modes[i], w[i]
        if i + 1 < n:
            row[STRETCHED + i], row[WAY + i] = w[n + i], modes[n + i]


@compile_kernel
def run(
    masses: FloatArray, springs: FloatArray, places: FloatArray, loop: SampledLoop, before: float, z: FloatArray,
    x: FloatArray, sliding: float, far: float, reach: float, trace: Trace,
) -> int:  # fmt: skip
    """Simulate one loop; fill the trace and return how it ended.

    Args:
        masses: (n, MASS) motor first; what winds up too fast to be told from Coulomb friction is made that.
        springs: (n - 1, SPRING) each between a mass and the next.
        places: (forces, 5) that follow a position.
        loop: what drives it.
        before: torque that acted before the first period.
        z: state of the feedback, overwritten.
        x: (4,) initial position and velocity of motor and load.
        sliding: 1 or -1 where friction is wound up at the first sample, the direction of the motion; else 0.
        far: a motor position above which the loop counts as diverged.
        reach: how far the fastest part of the motion may turn in a step, rad; `REACH` unless a test asks for less.
        trace: out; its tape is (rows, STEP_TAPE), of as many steps as it holds.
    """
    w_in, post, lengths, lags, feedback = loop.w, loop.post, loop.lengths, loop.lags, loop.feedback
    u, excess, counts = trace.u, trace.excess, trace.counts
    states, accelerations, tape = trace.states, trace.accelerations, trace.tape
    n, parts, periods = masses.shape[0], lengths.size, w_in.shape[1]
    q, v, a, push, grip = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    q1, v1, a1, push1, grip1 = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    w, w1, modes = np.zeros(2 * n - 1), np.zeros(2 * n - 1), np.ones(2 * n - 1)
    second, third, mobility = np.zeros(n), np.zeros(n), np.zeros(n)
    fresh, out, cut = np.empty(z.size), np.zeros(w_in.shape[0]), np.zeros(w_in.shape[0])
    period, longest = 0.0, 0.0
    for part in range(parts):
        period += lengths[part]
        longest = max(longest, lengths[part])
    for i in range(n):
        side = min(i, 1)  # what swings begins with the load
        q[i], v[i], mobility[i] = x[2 * side], x[2 * side + 1], 1.0 / masses[i, INERTIA]
        largest = max(masses[i, COULOMB], masses[i, COULOMB_BACK])
        if not math.sqrt(largest * masses[i, WINDING] * mobility[i]) * longest < _STICKS:
            masses[i, WINDING] = 0.0
        if masses[i, WINDING] > 0.0:
            w[i], modes[i] = sliding, (1.0 if v[i] >= 0.0 else -1.0)
        elif i < _HELD:
            modes[i] = 0.0 if v[i] == 0.0 else math.copysign(1.0, v[i])
    events, steps, clipped, status, k = 0, 0, 0, FINISHED, 0
    keep, loose, stopped, stopping = states.shape[0] > 0, -1, -1, 0.0
    _accelerate(masses, springs, places, mobility, modes, before, 0.0, q, v, w, a, push, grip)
    while k < periods and status == FINISHED:
        control_any(feedback, w_in, k, q[0], z, fresh, out, cut)
        u[k] = out[feedback.output]
        if excess.shape[0] > 0:
            assign(excess[k], cut)
        if cut[feedback.output] != 0.0:
            clipped += 1
        if not (abs(q[0]) <= far and abs(u[k]) < np.inf):
            status = DIVERGED
            break
        time, before_period = k * period, events
        for part in range(parts):
            source = k - lags[part]
            torque = u[source] + post[source] if source >= 0 else before
            left, begins, settles, last = lengths[part], True, True, a[0]
            while left > 0.0 and status == FINISHED:
                for _ in range(_AGAIN if settles else 0):
                    _accelerate(masses, springs, places, mobility, modes, torque, time, q, v, w, a, push, grip)
                    if not _settle(masses, modes, v, w, push, grip, loose):
                        break
                if settles:
                    _turn_sliders(springs, modes, v, a)
                if stopped >= 0 and counts[1] <= tape.shape[0]:
                    # Friction grows where a mass turns round, so the ratio is between 0 and 1; grazing leaves 0/0.
                    ratio = min(max(a[stopped] / stopping, 0.0), 1.0) if stopping != 0.0 else 0.0
                    tape[counts[1] - 1, STOPPED], tape[counts[1] - 1, RATIO] = stopped, ratio
                if begins and keep:
                    row = k * parts + part
                    for i in range(min(n, 2)):
                        states[row, 2 * i], states[row, 2 * i + 1], accelerations[row, i] = q[i], v[i], a[i]
                steps_left = left * _fastest_rate(masses, springs, places, mobility, modes, q, v, w, grip) / reach
                if not steps_left <= _MANY or steps * reach > _WORK * (periods * parts + 100):
                    status = TOO_STIFF
                    break
                h = left / max(math.ceil(steps_left), 1.0)
                settles, loose, stopped, event, dips, tries = False, -1, -1, -1, False, 0
                share, low, high, above, below, kept = 1.0, 0.0, 1.0, 0.0, 0.0, 0
                while True:
                    d = share * h
                    _step(
                        masses, springs, places, mobility, modes, torque, time, d, q, v, w, a, q1, v1, w1, a1, push1,
                        grip1, second, third,
                    )  # fmt: skip
                    steps += 1
                    tries += 1
                    if tries == 1:
                        event, place = _find_first(springs, modes, h, v, a, push, grip, v1, a1, push1, grip1)
                        if event < 0:
                            break
                        above, below = _guard(event, modes, v, push, grip), _guard(event, modes, v1, push1, grip1)
                        begins_at = not above > 0.0  # a guard that begins at 0 is divided by the time since
                        if begins_at and event < n:
                            above = modes[event] * a[event] * h
                        if place < 1.0:
                            share, dips = place, True
                            continue
                    else:
                        value = _guard(event, modes, v1, push1, grip1)
                        if dips and value > 0.0:  # a dip that the cubic has, but not the motion
                            event = -1
                            break
                        value = value / share if begins_at else value
                        if value > 0.0:
                            low, above = share, value
                            below = 0.5 * below if kept > 0 else below
                            kept = 1
                        else:
                            high, below = share, value
                            above = 0.5 * above if kept < 0 else above
                            kept = 0 if dips else -1
                        dips = False
                    if high - low <= _ROOT or below == 0.0 or tries > _CLOSER:
                        if share == high:
                            break
                        share = high
                        continue
                    # Between a guard that is positive and one that is not: the secant, its idle end halved (Illinois).
                    share = (low * below - high * above) / (below - above) if above > 0.0 else 0.5 * (low + high)
                    share = min(max(share, low + 0.3 * _ROOT), high - 0.3 * _ROOT)
                d, row = share * h, counts[1]
                if row < tape.shape[0]:
                    tape[row, PART], tape[row, LENGTH], tape[row, STOPPED] = k * parts + part, d, -1.0
                    tape[row, KICK] = last - a[0] if begins else 0.0
                    _write_row(tape[row], modes, d, q, v, w, a, q1, v1, a1)
                counts[1] += 1
                begins = False
                for i in range(n):
                    q[i], v[i], a[i], push[i], grip[i] = q1[i], v1[i], a1[i], push1[i], grip1[i]
                for i in range(modes.size):
                    w[i] = modes[i] if abs(modes[i] - w1[i]) < _WOUND_UP else w1[i]
                time += d
                left = 0.0 if share == 1.0 and h == left else left - d
                if event < 0:
                    continue
                events, settles = events + 1, True
                if event >= n:
                    modes[event] = -modes[event]
                elif modes[event] == 0.0:
                    loose = event
                else:
                    v[event] = 0.0
                    if masses[event, WINDING] == 0.0:
                        stopped, stopping, modes[event] = event, a[event], 0.0
                if events - before_period > _EVENTS:
                    status = CHATTERING
        k += 1
    counts[0], counts[2], counts[3] = events, k, min(clipped, k)
    return status
