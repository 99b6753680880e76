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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compiled, inlined
from jointid.models.robots.equations import ROOM, equations_of_motion
from jointid.models.robots.robot import Tree
from jointid.simulation.kernels.drive import CHATTERING, DIVERGED, FINISHED, Feedback, IntArray, control_any

NOT_POSITIVE = 4
"""How a simulation ended beside the ways of one joint: the mass matrix is not positive definite in a pose."""

_EVENTS = 200  # per part of a period; a physical robot has a handful
_HOLD = 1.0 + 1e-9  # of the Coulomb friction: what holds a mass, so that one at its limit is not decided by rounding
_ROOT = 1e-11  # of a step: where an event is located to
_CLOSER = 80  # evaluations of an event's guard at most
_PIVOTS = 50  # per mass; a handful is usual, least-index pivoting ends anyway
_INERTIA, _VISCOUS, _COULOMB, _OFFSET, _FORWARDS, _BACKWARDS, _RISE, _SPEED = range(8)


class Bodies(NamedTuple):
    """The numbers of a candidate.

    Attributes:
        inertials: (n, 10) of the links.
        rotors: (n,) the mass that each motor drives: its link, or the rotor of a flexible joint.
        masses: (masses, 8) see the module.
        springs: (n, 2) stiffness and damping; not read for rigid joints.
    """

    inertials: FloatArray
    rotors: IntArray
    masses: FloatArray
    springs: FloatArray


class Clock(NamedTuple):
    """When the controllers act.

    Attributes:
        lengths: (parts,) of a step of the clock, s.
        lags: (n, parts) how many of its steps ago the output that acts was put out.
        every: (n,) the period of each controller, in steps of the clock.
    """

    lengths: FloatArray
    lags: IntArray
    every: IntArray


class Controllers(NamedTuple):
    """The controllers: each of `Feedback`, with the joint as first axis, filled up with zeros to equal sizes."""

    A: FloatArray
    Bq: FloatArray
    F: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray
    limits: FloatArray
    gates: IntArray
    driven: FloatArray
    outputs: IntArray
    taps: IntArray


class Driven(NamedTuple):
    """What drives a robot beside the motion of its motors.

    Attributes:
        w: (n, elements, periods) answers of the controllers, as in `kernels.drive.run`, each of its own periods.
        post: (n, clock) what is added after the limits.
        before: (n,) torques that acted before the first period.
        far: (n,) positions of motors beyond which the loop counts as diverged.
    """

    w: FloatArray
    post: FloatArray
    before: FloatArray
    far: FloatArray


class Seen(NamedTuple):
    """What the controllers put out, filled by `run`.

    Attributes:
        command: (n, clock) the torque that acts, held between periods.
        tapped: (n, clock) the output behind its limit.
        cuts: (n, periods, elements) where limits and gates act; or (n, 0, 0).
    """

    command: FloatArray
    tapped: FloatArray
    cuts: NDArray[np.bool_]


class RobotTape(NamedTuple):
    """The pieces of a run, in each of which nothing happens, filled by `run`.

    Attributes:
        first: (clock * parts,) the piece that each part of a step of the clock begins with.
        lasting: (pieces,) s; or (0,), and nothing is kept.
        places: (pieces, masses) positions at its beginning.
        speeds: (pieces, masses) velocities at its beginning.
        begun: (pieces, masses) accelerations at its beginning.
        ended: (pieces, masses) accelerations at its end.
        directions: (pieces, masses) 1 or -1, 0 of a mass at rest.
        stopped: (pieces,) the mass whose event ended it, or -1.
    """

    first: IntArray
    lasting: FloatArray
    places: FloatArray
    speeds: FloatArray
    begun: FloatArray
    ended: FloatArray
    directions: FloatArray
    stopped: IntArray

    @classmethod
    def empty(cls, parts: int, pieces: int, masses: int) -> RobotTape:
        """Return one to be filled."""
        places, speeds, begun, ended, directions = (np.empty((pieces, masses)) for _ in range(5))
        whole = np.zeros(parts, dtype=np.int64), np.empty(pieces)
        return cls(*whole, places, speeds, begun, ended, directions, np.empty(pieces, dtype=np.int64))

    def until(self, parts: int, pieces: int) -> RobotTape:
        """Return what was filled of it."""
        kept = {name: getattr(self, name)[:pieces] for name in self._fields[1:]}
        return RobotTape(self.first[:parts], **kept)


class State(NamedTuple):
    """Positions, velocities and accelerations of all masses, and what friction holds in those that rest."""

    q: FloatArray
    v: FloatArray
    a: FloatArray
    held: FloatArray


class Room(NamedTuple):
    """Scratch of the integrator.

    Attributes:
        still: (n,) zeros. links: (n, ROOM) of `equations`.
        M: (n, n) mass matrix of the links. L: its root, with one over the diagonal.
        bias: (n,) torques of the links. push: (masses,) beside torque and grip. grip: (masses,).
        order: (n,) links that slide. slopes: (2, masses) accelerations of the stages.
    """

    still: FloatArray
    links: FloatArray
    M: FloatArray
    L: FloatArray
    bias: FloatArray
    push: FloatArray
    grip: FloatArray
    order: IntArray
    slopes: FloatArray


@inlined
def load_forces(tree: Tree, bodies: Bodies, q: FloatArray, v: FloatArray, room: Room) -> None:
    """Fill the mass matrix of the links, what pushes every mass beside motor torque and grip, and its grip."""
    n, rotors, masses, springs = bodies.rotors.size, bodies.rotors, bodies.masses, bodies.springs
    M, push, grip = room.M, room.push, room.grip
    equations_of_motion(tree, bodies.inertials, q[:n], v[:n], room.still, room.links, M, room.bias)
    for i in range(push.size):
        viscous = masses[i, _VISCOUS] + masses[i, _BACKWARDS if v[i] < 0.0 else _FORWARDS]
        push[i] = -viscous * v[i] - masses[i, _OFFSET]
        grip[i] = masses[i, _COULOMB]
        if masses[i, _RISE] > 0.0:
            part = v[i] / masses[i, _SPEED]
            grip[i] += masses[i, _RISE] * math.exp(-part * part)
    for i in range(n):
        push[i] -= room.bias[i]
        r = rotors[i]
        if r == i:
            M[i, i] += masses[i, _INERTIA]
        else:
            spring = springs[i, 0] * (q[r] - q[i]) + springs[i, 1] * (v[r] - v[i])
            push[i] += spring
            push[r] -= spring


@inlined
def accelerate(
    bodies: Bodies, room: Room, torque: FloatArray, modes: FloatArray, a: FloatArray, held: FloatArray
) -> bool:
    """Fill the accelerations in given modes, and what friction holds in masses that rest; False if M is not positive.

    Args:
        bodies: of which the rotors and their inertias are read.
        room: with the mass matrix, push and grip of `load_forces`.
        torque: (n,) of the motors.
        modes: (masses,) the direction in which each slides, 0 of one that rests.
        a: (masses,) out.
        held: (masses,) out.
    """
    rotors, M, L, push, grip, links = bodies.rotors, room.M, room.L, room.push, room.grip, room.order
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
            a[i] = held[i] / bodies.masses[i, _INERTIA]
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
    bodies: Bodies, room: Room, torque: FloatArray, v: FloatArray, modes: FloatArray, a: FloatArray, held: FloatArray
) -> bool:
    """Decide which masses that stand still rest and which way the others begin to slide; arguments of `accelerate`."""
    push, grip = room.push, room.grip
    for _ in range(_PIVOTS * push.size):
        if not accelerate(bodies, room, torque, modes, a, held):
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
    tree: Tree, bodies: Bodies, torque: FloatArray, h: float, now: State, modes: FloatArray, room: Room, ahead: State
) -> bool:
    """Fill where one step of the method leads, and the forces and accelerations there, in the modes of its start."""
    q, v, a, slopes = now.q, now.v, now.a, room.slopes
    q1, v1, a1 = ahead.q, ahead.v, ahead.a
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
        load_forces(tree, bodies, q1, v1, room)
        if not accelerate(bodies, room, torque, modes, a1, ahead.held):
            return False
    return True


@compiled
def _guard(i: int, masses: FloatArray, modes: FloatArray, at: State) -> float:
    """Return what is positive until a mass stops, or comes loose."""
    holds = masses[i, _COULOMB] + masses[i, _RISE]
    if not holds > 0.0:
        return 1.0
    return modes[i] * at.v[i] if modes[i] != 0.0 else _HOLD * holds - abs(at.held[i])


@compiled
def _earliest(masses: FloatArray, modes: FloatArray, h: float, now: State, ahead: State) -> tuple[int, float]:
    """Return the mass that seems to have the first event in a step, and where: 1 if its guard is negative at the end.

    Less than 1 is the bottom of a dip of a velocity that is positive at both ends. No mass, -1, if there is no event.
    """
    first, mass, at = 2.0, -1, 1.0
    for i in range(modes.size):
        end = _guard(i, masses, modes, ahead)
        start = _guard(i, masses, modes, now)
        if end <= 0.0:
            place = start / (start - end)
            if place < first:
                first, mass, at = place, i, 1.0
        elif modes[i] != 0.0 and masses[i, _COULOMB] + masses[i, _RISE] > 0.0:
            down, up = modes[i] * now.a[i] * h, modes[i] * ahead.a[i] * h
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
    tree: Tree, bodies: Bodies, torque: FloatArray, length: float, steps: int, now: State, modes: FloatArray,
    room: Room, ahead: State, tape: RobotTape, counts: IntArray,
) -> int:  # fmt: skip
    """Move all masses through a part of a period, from settled modes; write its pieces, and return how it ended.

    The state, forces, accelerations and modes are left as they are at the end, under the torques until then.
    """
    q, v, a, held = now.q, now.v, now.a, now.held
    v1, a1, masses = ahead.v, ahead.a, bodies.masses
    events, nd = 0, q.size
    share = length / steps
    for _share in range(steps):
        left = share
        while left > 0.0:
            h, mass = left, -1
            if not _step(tree, bodies, torque, h, now, modes, room, ahead):
                return NOT_POSITIVE
            mass, at = _earliest(masses, modes, h, now, ahead)
            if mass >= 0 and at < 1.0:  # a dip that the cubic has: whether the motion has it, too
                if not _step(tree, bodies, torque, at * h, now, modes, room, ahead):
                    return NOT_POSITIVE
                if _guard(mass, masses, modes, ahead) > 0.0:
                    h, mass = at * h, -1
            high = at
            for _other in range(nd + 1):
                if mass < 0:
                    break
                # Between a guard that is positive and one that is not: of a velocity by Newton's steps, to a little
                # beyond the root, of others by the secant, its idle end halved (Illinois). A guard that begins at 0 is
                # divided by the time since, and has the secant.
                low, above = 0.0, _guard(mass, masses, modes, now)
                begins = not above > 0.0
                if begins:
                    above = modes[mass] * a[mass] * h if modes[mass] != 0.0 else 0.0
                below = _guard(mass, masses, modes, ahead)
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
                    if not _step(tree, bodies, torque, place * h, now, modes, room, ahead):
                        return NOT_POSITIVE
                    value, last = _guard(mass, masses, modes, ahead), place
                    value = value / place if begins else value
                    if value > 0.0:
                        low, above = place, value
                        below = 0.5 * below if kept > 0 else below
                        kept = 1
                    else:
                        high, below = place, value
                        above = 0.5 * above if kept < 0 else above
                        kept = -1
                if last != high and not _step(tree, bodies, torque, high * h, now, modes, room, ahead):
                    return NOT_POSITIVE
                other = -1
                for i in range(nd):
                    if i != mass and _guard(i, masses, modes, ahead) <= 0.0 < _guard(i, masses, modes, now):
                        other = i
                        break
                if other < 0 or high == 0.0:
                    break
                mass = other
            taken = h if mass < 0 else high * h
            row = counts[1]
            if tape.lasting.size > 0:
                if row >= tape.lasting.size:
                    return CHATTERING
                tape.lasting[row], tape.stopped[row] = taken, mass
                for i in range(nd):
                    tape.places[row, i], tape.speeds[row, i], tape.begun[row, i] = q[i], v[i], a[i]
                    tape.ended[row, i], tape.directions[row, i] = a1[i], modes[i]
            counts[1] += 1
            for i in range(nd):
                q[i], v[i], a[i], held[i] = ahead.q[i], v1[i], a1[i], ahead.held[i]
            left = 0.0 if mass < 0 and h == left else left - taken
            if mass >= 0:
                events += 1
                counts[0] += 1
                if events > _EVENTS:
                    return CHATTERING
                if modes[mass] != 0.0:
                    v[mass], modes[mass] = 0.0, 0.0
                    load_forces(tree, bodies, q, v, room)
                if not settle(bodies, room, torque, v, modes, a, held):
                    return NOT_POSITIVE
    return FINISHED


@compiled
def run(
    tree: Tree, bodies: Bodies, clock: Clock, steps: int, laws: Controllers, driven: Driven, z: FloatArray,
    q: FloatArray, v: FloatArray, seen: Seen, tape: RobotTape, counts: IntArray,
) -> int:  # fmt: skip
    """Simulate a robot; fill what is out and return how it ended.

    Args:
        tree: of the links.
        bodies: numbers of the candidate.
        clock: of the controllers.
        steps: of the integrator in each part of a step of the clock.
        laws: the controllers.
        driven: what drives them.
        z: (n, states) of the controllers, overwritten.
        q: (masses,) initial positions, overwritten.
        v: (masses,) initial velocities, overwritten.
        seen: out.
        tape: out.
        counts: (3,) out: events, pieces, steps of the clock simulated.
    """
    n, nd, parts = bodies.rotors.size, q.size, clock.lengths.size
    masses, rotors, every, lags, w = bodies.masses, bodies.rotors, clock.every, clock.lags, driven.w
    command, tapped, cuts = seen.command, seen.tapped, seen.cuts
    torque, modes = np.empty(n), np.empty(nd)
    M, L, push, grip = np.empty((n, n)), np.empty((n, n)), np.empty(nd), np.empty(nd)
    room = Room(
        np.zeros(n), np.empty((n, ROOM)), M, L, np.empty(n), push, grip, np.empty(n, dtype=np.int64), np.empty((2, nd))
    )
    a, held = np.empty(nd), np.empty(nd)
    now, ahead = State(q, v, a, held), State(np.empty(nd), np.empty(nd), np.empty(nd), np.empty(nd))
    nz, elements = z.shape[1], w.shape[1]
    new, out, cut = np.empty(nz), np.zeros(elements), np.zeros(elements)
    for i in range(nd):
        if masses[i, _COULOMB] + masses[i, _RISE] > 0.0:
            modes[i] = 0.0 if v[i] == 0.0 else math.copysign(1.0, v[i])
        else:
            modes[i] = 1.0
    load_forces(tree, bodies, q, v, room)
    for k in range(command.shape[1]):
        for j in range(n):
            if k % every[j] != 0:  # this controller holds
                command[j, k], tapped[j, k] = command[j, k - 1], tapped[j, k - 1]
                continue
            own, position = k // every[j], q[rotors[j]]
            law = Feedback(
                laws.A[j], laws.Bq[j], laws.F[j], laws.C[j], laws.D[j], laws.E[j], laws.limits[j], laws.gates[j],
                laws.driven[j], laws.outputs[j], laws.taps[j],
            )  # fmt: skip
            control_any(law, w[j], own, position, z[j], new, out, cut)
            command[j, k] = out[laws.outputs[j]]
            tapped[j, k] = out[laws.taps[j]]
            if cuts.shape[1] > 0:
                for i in range(elements):
                    cuts[j, own, i] = cut[i] != 0.0
            if not (abs(position) <= driven.far[j] and abs(command[j, k]) < np.inf):
                return DIVERGED
        for part in range(parts):
            for j in range(n):
                source = k - lags[j, part]
                torque[j] = command[j, source] + driven.post[j, source] if source >= 0 else driven.before[j]
            if not settle(bodies, room, torque, v, modes, a, held):
                return NOT_POSITIVE
            tape.first[k * parts + part] = counts[1]
            status = _advance(
                tree, bodies, torque, clock.lengths[part], steps, now, modes, room, ahead, tape, counts
            )  # fmt: skip
            if status != FINISHED:
                return status
        counts[2] = k + 1
    return FINISHED
