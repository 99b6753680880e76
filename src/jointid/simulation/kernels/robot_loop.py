"""The simulation of a robot in its sampled loops, compiled: joints that are coupled, each rigid or flexible.

The torques are held between the controllers' instants. A rigid joint has its rotor's inertia on the diagonal of the
mass matrix; of a flexible one the rotor is a mass of its own, which only its spring ties to the links (M. W. Spong:
Modeling and control of elastic joint robots, Journal of Dynamic Systems, Measurement, and Control 109, 1987)::

    (M(q) + diag(Ia)) a + h(q, v) + Fv v + Fc sign(v) + offset = tau                        rigid
    M(q) a + h(q, v) + Fv2 v + Fc2 sign(v) = K (qm - q) + D (vm - v)                        flexible, links
    Jm am + Fv1 vm + Fc1 sign(vm) + offset + K (qm - q) + D (vm - v) = tau                  flexible, rotors

Between two events this is smooth, and integrated by the classical method of Runge and Kutta, of order 4, in equal steps
of each part of a period. Its error falls with the fourth power of the step; nothing here is exact, as it is for one
joint (`kernels.drive`), since no affine map describes links that turn.

Events are located by the integrator itself, so they do not lower the order. A mass that stops, or at which the torques
change, is decided together with all others that stand still: sliding one way or the other, or resting. The
accelerations minimise ``a' M a / 2 - f' a + sum Fc |a_i|`` over the masses that stand still, which has one minimum;
its modes are found by least-index pivoting (K. G. Murty: Note on a Bard-type scheme for solving the complementarity
problem, Opsearch 11, 1974), which ends for every positive definite M. A velocity that only touches 0 and comes
back within a step is looked for by the cubic through its ends; a resting mass that comes loose and rests again
within one step is not.

Masses are the links, in their order, then the rotors of flexible joints. Where motors are coupled a link's position is
that of the shaft that its motor turns, ``C q``, so that friction and springs are each one shaft's
(`models.robots.equations`). Coefficients of masses are rows of inertia (of a rotor; 0 for the link of a flexible
joint), viscous, Coulomb and constant friction, of viscous friction what is added forwards, and backwards, and of
Coulomb friction what is added towards standstill, FS of ``FS exp(-(v / vS)^2)``, and vS. A Coulomb friction of two
sizes is one of their mean and a constant friction. What holds a mass at rest, or slows it as it slides, is its grip.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compiled, inlined
from jointid.models.robots.equations import ROOM, equations_of_motion
from jointid.simulation.kernels.drive import CHATTERING, DIVERGED, FINISHED, Feedback, IntArray, control_any

NOT_POSITIVE = 4
"""How a simulation ended beside the ways of one joint: the mass matrix is not positive definite in a pose."""

_EVENTS = 200  # per part of a period; a physical robot has a handful
_HOLD = 1.0 + 1e-9  # of the Coulomb friction: what holds a mass, so that one at its limit is not decided by rounding
_ROOT = 1e-11  # of a step: where an event is located to
_CLOSER = 80  # evaluations of an event's guard at most
_PIVOTS = 50  # per mass; a handful is usual, least-index pivoting ends anyway
_INERTIA, _VISCOUS, _COULOMB, _OFFSET, _FORWARDS, _BACKWARDS, _RISE, _SPEED = range(8)


@inlined
def load_forces(
    parents: IntArray, kinds: IntArray, axes: FloatArray, rotations: FloatArray, origins: FloatArray,
    gravity: FloatArray, joints: FloatArray, inertials: FloatArray, rotors: IntArray, masses: FloatArray,
    springs: FloatArray,
    q: FloatArray, v: FloatArray, still: FloatArray, room: FloatArray, M: FloatArray, bias: FloatArray,
    push: FloatArray, grip: FloatArray,
) -> None:  # fmt: skip
    """Fill the mass matrix of the links, what pushes every mass beside motor torque and grip, and its grip."""
    n = parents.size
    equations_of_motion(
        parents, kinds, axes, rotations, origins, gravity, joints, inertials, q[:n], v[:n], still, room, M, bias
    )  # fmt: skip
    for i in range(push.size):
        viscous = masses[i, _VISCOUS] + masses[i, _BACKWARDS if v[i] < 0.0 else _FORWARDS]
        push[i] = -viscous * v[i] - masses[i, _OFFSET]
        grip[i] = masses[i, _COULOMB]
        if masses[i, _RISE] > 0.0:
            part = v[i] / masses[i, _SPEED]
            grip[i] += masses[i, _RISE] * math.exp(-part * part)
    for i in range(n):
        push[i] -= bias[i]
        r = rotors[i]
        if r == i:
            M[i, i] += masses[i, _INERTIA]
        else:
            spring = springs[i, 0] * (q[r] - q[i]) + springs[i, 1] * (v[r] - v[i])
            push[i] += spring
            push[r] -= spring


@inlined
def accelerate(
    M: FloatArray, L: FloatArray, push: FloatArray, grip: FloatArray, torque: FloatArray, rotors: IntArray,
    masses: FloatArray, modes: FloatArray, links: IntArray, a: FloatArray, held: FloatArray,
) -> bool:  # fmt: skip
    """Fill the accelerations in given modes, and what friction holds in masses that rest; False if M is not positive.

    M is (n, n), L of its shape (its root, with one over the diagonal) and links, (n,), are scratch; push and grip,
    (masses,), are of `load_forces`, torque, (n,), of the motors, rotors, (n,), the mass each acts on; masses is
    (masses, 8), and modes, (masses,), the direction in which each slides, 0 of one that rests. Out are a and held,
    (masses,).
    """
    n, free = torque.size, 0
    for i in range(push.size):
        a[i], held[i] = 0.0, push[i] - modes[i] * grip[i]
    for i in range(n):
        held[rotors[i]] += torque[i]
        if modes[i] != 0.0:
            links[free] = i
            free += 1
    for i in range(n, push.size):
        if modes[i] != 0.0:
            a[i] = held[i] / masses[i, _INERTIA]
    for x in range(free):
        i = links[x]
        total = held[i]
        for y in range(x):
            cell = M[i, links[y]]
            for k in range(y):
                cell -= L[x, k] * L[y, k]
            L[x, y] = cell * L[y, y]
            total -= L[x, y] * a[links[y]]
        pivot = M[i, i]
        for k in range(x):
            pivot -= L[x, k] * L[x, k]
        if not pivot > 0.0:
            return False
        L[x, x] = 1.0 / math.sqrt(pivot)
        a[i] = total * L[x, x]
    for x in range(free - 1, -1, -1):
        total = a[links[x]]
        for y in range(x + 1, free):
            total -= L[y, x] * a[links[y]]
        a[links[x]] = total * L[x, x]
    if free < n:
        for i in range(n):
            if modes[i] == 0.0:
                for j in range(n):
                    held[i] -= M[i, j] * a[j]
    return True


@compiled
def settle(
    M: FloatArray, L: FloatArray, push: FloatArray, grip: FloatArray, torque: FloatArray, rotors: IntArray,
    masses: FloatArray, v: FloatArray, modes: FloatArray, links: IntArray, a: FloatArray, held: FloatArray,
) -> bool:  # fmt: skip
    """Decide which masses that stand still rest and which way the others begin to slide; arguments of `accelerate`."""
    for _ in range(_PIVOTS * push.size):
        if not accelerate(M, L, push, grip, torque, rotors, masses, modes, links, a, held):
            return False
        changed = False
        for i in range(push.size):
            if v[i] != 0.0 or not grip[i] > 0.0:
                continue
            if modes[i] == 0.0 and abs(held[i]) >= _HOLD * grip[i]:
                modes[i], changed = math.copysign(1.0, held[i]), True
            elif modes[i] != 0.0 and modes[i] * a[i] <= 0.0:
                modes[i], changed = 0.0, True
            if changed:
                break
        if not changed:
            break
    return True


@compiled
def _step(
    parents: IntArray, kinds: IntArray, axes: FloatArray, rotations: FloatArray, origins: FloatArray,
    gravity: FloatArray, joints: FloatArray, inertials: FloatArray, rotors: IntArray, masses: FloatArray,
    springs: FloatArray,
    torque: FloatArray, h: float, q: FloatArray, v: FloatArray, a: FloatArray, modes: FloatArray, still: FloatArray,
    room: FloatArray, M: FloatArray, L: FloatArray, bias: FloatArray, push: FloatArray, grip: FloatArray,
    links: IntArray, slopes: FloatArray,
    q1: FloatArray, v1: FloatArray, a1: FloatArray, held1: FloatArray,
) -> bool:  # fmt: skip
    """Fill where one step of the method leads, and the forces and accelerations there, in the modes of its start."""
    for stage in range(4):
        for i in range(q.size):
            if stage == 0:
                q1[i], v1[i] = q[i] + 0.5 * h * v[i], v[i] + 0.5 * h * a[i]
            elif stage == 1:
                slopes[0, i] = a1[i]
                q1[i], v1[i] = q[i] + 0.5 * h * v[i] + 0.25 * h * h * a[i], v[i] + 0.5 * h * a1[i]
            elif stage == 2:
                slopes[1, i] = a1[i]
                q1[i], v1[i] = q[i] + h * v[i] + 0.5 * h * h * slopes[0, i], v[i] + h * a1[i]
            else:
                between = slopes[0, i] + slopes[1, i]
                q1[i] = q[i] + h * v[i] + h * h / 6.0 * (a[i] + between)
                v1[i] = v[i] + h / 6.0 * (a[i] + 2.0 * between + a1[i])
        load_forces(
            parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
            q1, v1, still, room, M, bias, push, grip,
        )  # fmt: skip
        if not accelerate(M, L, push, grip, torque, rotors, masses, modes, links, a1, held1):
            return False
    return True


@compiled
def _guard(i: int, masses: FloatArray, modes: FloatArray, v: FloatArray, held: FloatArray) -> float:
    """Return what is positive until a mass stops, or comes loose."""
    holds = masses[i, _COULOMB] + masses[i, _RISE]
    if not holds > 0.0:
        return 1.0
    return modes[i] * v[i] if modes[i] != 0.0 else _HOLD * holds - abs(held[i])


@compiled
def _earliest(
    masses: FloatArray, modes: FloatArray, h: float, v: FloatArray, a: FloatArray, held: FloatArray,
    v1: FloatArray, a1: FloatArray, held1: FloatArray,
) -> tuple[int, float]:  # fmt: skip
    """Return the mass that seems to have the first event in a step, and where: 1 if its guard is negative at the end.

    Less than 1 is the bottom of a dip of a velocity that is positive at both ends. No mass, -1, if there is no event.
    """
    first, mass, at = 2.0, -1, 1.0
    for i in range(modes.size):
        end = _guard(i, masses, modes, v1, held1)
        start = _guard(i, masses, modes, v, held)
        if end <= 0.0:
            place = start / (start - end)
            if place < first:
                first, mass, at = place, i, 1.0
        elif modes[i] != 0.0 and masses[i, _COULOMB] + masses[i, _RISE] > 0.0:
            down, up = modes[i] * a[i] * h, modes[i] * a1[i] * h
            if down < 0.0 < up and min(start, end) < 0.15 * (up - down):
                # The cubic through both ends: where it is lowest, and how low.
                c2, c3 = 3.0 * (end - start) - 2.0 * down - up, 2.0 * (start - end) + down + up
                root = c2 * c2 - 3.0 * c3 * down
                place = -down / (c2 + math.sqrt(max(root, 0.0)))
                lowest = start + place * (down + place * (c2 + place * c3))
                if 0.0 < place < 1.0 and lowest < 0.0 and place < first:
                    first, mass, at = place, i, place
    return mass, at


@compiled
def _advance(
    parents: IntArray, kinds: IntArray, axes: FloatArray, rotations: FloatArray, origins: FloatArray,
    gravity: FloatArray, joints: FloatArray, inertials: FloatArray, rotors: IntArray, masses: FloatArray,
    springs: FloatArray,
    torque: FloatArray, length: float, steps: int, q: FloatArray, v: FloatArray, a: FloatArray, held: FloatArray,
    modes: FloatArray, still: FloatArray, room: FloatArray, M: FloatArray, L: FloatArray, bias: FloatArray,
    push: FloatArray, grip: FloatArray,
    links: IntArray, slopes: FloatArray, q1: FloatArray, v1: FloatArray, a1: FloatArray, held1: FloatArray,
    lasting: FloatArray, places: FloatArray, speeds: FloatArray, begun: FloatArray, ended: FloatArray,
    directions: FloatArray, stopped: IntArray, counts: IntArray,
) -> int:  # fmt: skip
    """Move all masses through a part of a period, from settled modes; write its pieces, and return how it ended.

    The state, forces, accelerations and modes are left as they are at the end, under the torques until then.
    """
    events, nd = 0, q.size
    share = length / steps
    for _share in range(steps):
        left = share
        while left > 0.0:
            h, mass = left, -1
            if not _step(
                parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs, torque,
                h,
                q, v, a, modes, still, room, M, L, bias, push, grip, links, slopes, q1, v1, a1, held1,
            ):  # fmt: skip
                return NOT_POSITIVE
            mass, at = _earliest(masses, modes, h, v, a, held, v1, a1, held1)
            if mass >= 0 and at < 1.0:  # a dip that the cubic has: whether the motion has it, too
                if not _step(
                    parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
                    torque,
                    at * h, q, v, a, modes, still, room, M, L, bias, push, grip, links, slopes, q1, v1, a1, held1,
                ):  # fmt: skip
                    return NOT_POSITIVE
                if _guard(mass, masses, modes, v1, held1) > 0.0:
                    h, mass = at * h, -1
            high = at
            for _other in range(nd + 1):
                if mass < 0:
                    break
                # Between a guard that is positive and one that is not: of a velocity by Newton's steps, to a little
                # beyond the root, of others by the secant, its idle end halved (Illinois). A guard that begins at 0 is
                # divided by the time since, and has the secant.
                low, above = 0.0, _guard(mass, masses, modes, v, held)
                begins = not above > 0.0
                if begins:
                    above = modes[mass] * a[mass] * h if modes[mass] != 0.0 else 0.0
                below = _guard(mass, masses, modes, v1, held1)
                below = below / high if begins else below
                kept, last = 0, high
                if not above > 0.0:
                    high = 0.0
                for _closer in range(_CLOSER):
                    slope = modes[mass] * a1[mass] * h if not begins else 0.0
                    if not high - low > _ROOT or below == 0.0 or (last == high and 0.0 < -below < -_ROOT * slope):
                        break
                    place = (low * below - high * above) / (below - above)
                    if slope < 0.0:
                        root = last - modes[mass] * v1[mass] / slope + 0.3 * _ROOT
                        place = root if low < root < high else place
                    place = min(max(place, low + 0.1 * _ROOT), high - 0.1 * _ROOT)
                    if not _step(
                        parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
                        torque,
                        place * h, q, v, a, modes, still, room, M, L, bias, push, grip, links, slopes,
                        q1, v1, a1, held1,
                    ):  # fmt: skip
                        return NOT_POSITIVE
                    value, last = _guard(mass, masses, modes, v1, held1), place
                    value = value / place if begins else value
                    if value > 0.0:
                        low, above = place, value
                        below = 0.5 * below if kept > 0 else below
                        kept = 1
                    else:
                        high, below = place, value
                        above = 0.5 * above if kept < 0 else above
                        kept = -1
                if last != high and not _step(
                    parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
                    torque,
                    high * h, q, v, a, modes, still, room, M, L, bias, push, grip, links, slopes, q1, v1, a1, held1,
                ):  # fmt: skip
                    return NOT_POSITIVE
                other = -1
                for i in range(nd):
                    if i != mass and _guard(i, masses, modes, v1, held1) <= 0.0 < _guard(i, masses, modes, v, held):
                        other = i
                        break
                if other < 0 or high == 0.0:
                    break
                mass = other
            taken = h if mass < 0 else high * h
            row = counts[1]
            if lasting.size > 0:
                if row >= lasting.size:
                    return CHATTERING
                lasting[row], stopped[row] = taken, mass
                for i in range(nd):
                    places[row, i], speeds[row, i], begun[row, i] = q[i], v[i], a[i]
                    ended[row, i], directions[row, i] = a1[i], modes[i]
            counts[1] += 1
            for i in range(nd):
                q[i], v[i], a[i], held[i] = q1[i], v1[i], a1[i], held1[i]
            left = 0.0 if mass < 0 and h == left else left - taken
            if mass >= 0:
                events += 1
                counts[0] += 1
                if events > _EVENTS:
                    return CHATTERING
                if modes[mass] != 0.0:
                    v[mass], modes[mass] = 0.0, 0.0
                    load_forces(
                        parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
                        q, v, still, room, M, bias, push, grip,
                    )  # fmt: skip
                if not settle(M, L, push, grip, torque, rotors, masses, v, modes, links, a, held):
                    return NOT_POSITIVE
    return FINISHED


@compiled
def run(
    parents: IntArray, kinds: IntArray, axes: FloatArray, rotations: FloatArray, origins: FloatArray,
    gravity: FloatArray, joints: FloatArray, inertials: FloatArray, rotors: IntArray, masses: FloatArray,
    springs: FloatArray,
    lengths: FloatArray, lags: IntArray, every: IntArray, steps: int, z: FloatArray,
    A: FloatArray, Bq: FloatArray, F: FloatArray, C: FloatArray, D: FloatArray, E: FloatArray,
    limits: FloatArray, gates: IntArray, driven: FloatArray, outputs: IntArray, taps: IntArray,
    w: FloatArray, post: FloatArray, before: FloatArray, q: FloatArray, v: FloatArray, far: FloatArray,
    command: FloatArray, tapped: FloatArray, cuts: NDArray[np.bool_],
    first: IntArray, lasting: FloatArray, places: FloatArray, speeds: FloatArray, begun: FloatArray,
    ended: FloatArray, directions: FloatArray, stopped: IntArray, counts: IntArray,
) -> int:  # fmt: skip
    """Simulate a robot; fill what is out and return how it ended.

    The arguments, those that belong together in a line::

        parents, kinds, axes, rotations, origins, gravity, joints, inertials: of the links (`models.robots.equations`).
        rotors: (n,) the mass that each motor drives: its link, or the rotor of a flexible joint.
        masses: (masses, 8) inertia of the rotor, viscous, Coulomb and constant friction, what viscous friction has more
            forwards, and backwards, and what Coulomb friction rises by below a speed, and that speed.
        springs: (n, 2) stiffness and damping; not read for rigid joints.
        lengths: (parts,) of a step of the clock. lags: (n, parts) how many of its steps ago the output that acts was
            put out. every: (n,) the period of each controller, in steps of the clock.
        steps: of the integrator in each part.
        z: (n, states) of the controllers, overwritten.
        A, Bq, F, C, D, E, limits, gates, driven, outputs, taps: of `Feedback`, with the joint as first axis, filled up
            with zeros to equal sizes.
        w: (n, elements, periods) as in `kernels.drive.run`, each of its own periods; post: (n, clock), before: (n,)
        too.
        q, v: (masses,) initial state, overwritten.
        far: (n,) positions of motors beyond which the loop counts as diverged.
        command, tapped: (n, clock) out, the torque that acts, and the output behind its limit; held between periods.
        cuts: (n, periods, elements) out, where limits and gates act; or (n, 0, 0).
        first: (clock * parts,) out, the piece that each part begins with.
        lasting, stopped: (rows,) out, the duration of a piece, and the mass whose event ended it or -1; or (0,).
        places, speeds, begun, ended, directions: (rows, masses) out: positions, velocities and accelerations a piece
            begins with, accelerations it ends with, and its modes.
        counts: (3,) out: events, pieces, steps of the clock simulated.
    """
    n, nd, parts = parents.size, q.size, lengths.size
    room = np.empty((n, ROOM))
    still, bias, torque = np.zeros(n), np.empty(n), np.empty(n)
    M, L, push, links = np.empty((n, n)), np.empty((n, n)), np.empty(nd), np.empty(n, dtype=np.int64)
    grip = np.empty(nd)
    a, held, modes, slopes = np.empty(nd), np.empty(nd), np.empty(nd), np.empty((2, nd))
    q1, v1, a1, held1 = np.empty(nd), np.empty(nd), np.empty(nd), np.empty(nd)
    nz, elements = z.shape[1], w.shape[1]
    new, out, cut = np.empty(nz), np.zeros(elements), np.zeros(elements)
    for i in range(nd):
        if masses[i, _COULOMB] + masses[i, _RISE] > 0.0:
            modes[i] = 0.0 if v[i] == 0.0 else math.copysign(1.0, v[i])
        else:
            modes[i] = 1.0
    load_forces(
        parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs,
        q, v, still, room, M, bias, push, grip,
    )  # fmt: skip
    for k in range(command.shape[1]):
        for j in range(n):
            if k % every[j] != 0:  # this controller holds
                command[j, k], tapped[j, k] = command[j, k - 1], tapped[j, k - 1]
                continue
            own, position = k // every[j], q[rotors[j]]
            law = Feedback(
                A[j], Bq[j], F[j], C[j], D[j], E[j], limits[j], gates[j], driven[j], outputs[j], taps[j]
            )  # fmt: skip
            control_any(law, w[j], own, position, z[j], new, out, cut)
            command[j, k] = out[outputs[j]]
            tapped[j, k] = out[taps[j]]
            if cuts.shape[1] > 0:
                for i in range(elements):
                    cuts[j, own, i] = cut[i] != 0.0
            if not (abs(position) <= far[j] and abs(command[j, k]) < np.inf):
                return DIVERGED
        for part in range(parts):
            for j in range(n):
                source = k - lags[j, part]
                torque[j] = command[j, source] + post[j, source] if source >= 0 else before[j]
            if not settle(M, L, push, grip, torque, rotors, masses, v, modes, links, a, held):
                return NOT_POSITIVE
            first[k * parts + part] = counts[1]
            status = _advance(
                parents, kinds, axes, rotations, origins, gravity, joints, inertials, rotors, masses, springs, torque,
                lengths[part], steps, q, v, a, held, modes, still, room, M, L, bias, push, grip, links, slopes,
                q1, v1, a1, held1, lasting, places, speeds, begun, ended, directions, stopped, counts,
            )  # fmt: skip
            if status != FINISHED:
                return status
        counts[2] = k + 1
    return FINISHED
