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
back within a step is found by the cubic through its ends; a resting mass that comes loose and rests again
within one step is not.

Masses are the links, in their order, then the rotors of flexible joints. Where motors are coupled a link's position is
that of the shaft that its motor turns, ``C q``, so that friction and springs are each one shaft's
(`models.robots.equations`). What holds a mass at rest, or slows it as it slides, is its grip.

Friction and springs are the laws of a joint (`models.friction`, `models.springs`). In a band of the speed, or a piece
of the deflection, a law is a line; coming to its edge is an event, as is the reversal from which something winds up.
What winds up over a displacement s towards the direction d of the motion is a function of the displacement alone::

    w = d - (d - w0) exp(-d (x - x0) / s)            with w0 and x0 of the last reversal

so that the method keeps its order. Guards are numbered: of every mass, of the upper and of the lower edge of its band,
then of the outer and of the inner edge of every spring's piece, of its rate and of its torque.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
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
# Columns: of masses, of bands, of pieces and of bends.
INERTIA, OFFSET, PRESLIDING, VISCOUS_DRIFT, COULOMB_DRIFT, PER_TORQUE = range(6)
HIGH, FORWARDS, BACKWARDS, COULOMB = range(4)
BEGIN, TORQUE, STIFFNESS, DAMPING = range(4)
CUBIC, SLIDER, SLIPS = range(3)
BAND, WOUND, SINCE, PIECE, STRETCHED, TURNED, RATE, SIGN = range(8)
"""Rows of where the laws are, (8, masses), or (0, 0) where every law is one line: the band of a mass's speed, what its
friction was wound up to at the last reversal and the position then; of a spring its piece, negative where the
deflection is, what its slider was wound up to at its last reversal and the deflection then, the direction in which it
deflects, and that of its torque; of a rigid joint in its place the torque of the motor."""


class Bodies(NamedTuple):
    """The numbers of a candidate.

    Attributes:
        inertials: (n, 10) of the links.
        rotors: (n,) the mass that each motor drives: its link, or the rotor of a flexible joint.
        masses: (masses, 6) inertia of the rotor (0 for the link of a flexible joint), constant friction, and the
            numbers of `SmoothFriction`.
        bands: (masses, bands, 4) the speed at which a band ends, infinity for the last, then viscous friction forwards
            and backwards, and Coulomb friction.
        pieces: (n, pieces, 4) of springs, see `springs.Piece`; the deflection at which those begin that a spring has
            not is infinity. Not read for rigid joints.
        bends: (n, 3) cubic stiffness of springs, stiffness and limit of their sliders.
        rests: (masses,) which friction may hold at rest.
    """

    inertials: FloatArray
    rotors: IntArray
    masses: FloatArray
    bands: FloatArray
    pieces: FloatArray
    bends: FloatArray
    rests: NDArray[np.bool_]


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


class Driven(NamedTuple):
    """Inputs of a robot beside the motion of its motors.

    Attributes:
        w: (n, elements, periods) answers of the controllers, as in `kernels.drive.run`, each of its own periods.
        post: (n, clock) what is added after the limits.
        before: (n,) torques that acted before the first period.
        far: (n,) positions of motors above which the loop counts as diverged.
    """

    w: FloatArray
    post: FloatArray
    before: FloatArray
    far: FloatArray


class Seen(NamedTuple):
    """Output of the controllers, filled by `run`.

    Attributes:
        command: (n, clock) the torque that acts, held between periods.
        cuts: (n, periods, elements) where limits and gates act; or (n, 0, 0).
    """

    command: FloatArray
    cuts: NDArray[np.bool_]


class RobotTape(NamedTuple):
    """The pieces of a run, in each of which nothing happens, filled by `run`.

    Attributes:
        first: (clock * parts,) the piece that each part of a step of the clock begins with.
        lasting: (pieces,) s; or (0,), and nothing is kept.
        places: (pieces, masses) positions at its beginning.
        speeds: (pieces, masses) velocities at its beginning.
        initial_acceleration: (pieces, masses).
        final_acceleration: (pieces, masses).
        directions: (pieces, masses) 1 or -1, 0 of a mass at rest.
        laws: (pieces, 8, masses) where the laws are; or (pieces, 0, 0).
        stopped: (pieces,) the guard whose event ended it, of a mass its number; or -1.
    """

    first: IntArray
    lasting: FloatArray
    places: FloatArray
    speeds: FloatArray
    initial_acceleration: FloatArray
    final_acceleration: FloatArray
    directions: FloatArray
    laws: FloatArray
    stopped: IntArray

    @classmethod
    def empty(cls, parts: int, pieces: int, bodies: Bodies) -> RobotTape:
        """Return one to be filled."""
        places, speeds, started, ended, directions = (np.empty((pieces, len(bodies.masses))) for _ in range(5))
        laws = np.empty((pieces, *shape_of_laws(bodies)))
        whole = np.zeros(parts, dtype=np.int64), np.empty(pieces)
        return cls(*whole, places, speeds, started, ended, directions, laws, np.empty(pieces, dtype=np.int64))

    def until(self, parts: int, pieces: int) -> RobotTape:
        """Return the filled part."""
        kept = {name: getattr(self, name)[:pieces] for name in self._fields[1:]}
        return RobotTape(self.first[:parts], **kept)


def shape_of_laws(bodies: Bodies) -> tuple[int, int]:
    """Return the shape of the laws' states."""
    in_pieces = bodies.bands.shape[1] > 1 or bodies.pieces.shape[1] > 1
    smooth = bool(np.any(bodies.masses[:, PRESLIDING:]) or np.any(bodies.bends))
    return (8, len(bodies.masses)) if in_pieces or smooth else (0, 0)


class State(NamedTuple):
    """The motion at an instant.

    Attributes:
        q: (masses,) positions. v: velocities. a: accelerations.
        held: (masses,) what friction holds in those that rest.
        grip: (masses,) what friction can hold.
        spring: (n,) torques of the springs.
        guard: (guards,) what is positive until an event.
        slope: (guards,) rate of each guard, 0 where it is not known.
    """

    q: FloatArray
    v: FloatArray
    a: FloatArray
    held: FloatArray
    grip: FloatArray
    spring: FloatArray
    guard: FloatArray
    slope: FloatArray


class Room(NamedTuple):
    """Scratch of the integrator.

    Attributes:
        still: (n,) zeros. links: (n, ROOM) of `equations`.
        M: (n, n) mass matrix of the links. L: its root, with one over the diagonal.
        bias: (n,) torques of the links. push: (masses,) beside torque and grip.
        order: (2, n) links that slide, and where the rows of L begin. slopes: (2, masses) accelerations of the stages.
    """

    still: FloatArray
    links: FloatArray
    M: FloatArray
    L: FloatArray
    bias: FloatArray
    push: FloatArray
    order: IntArray
    slopes: FloatArray


@inline_kernel
def wound_up(wound: float, since: float, direction: float, x: float, over: float) -> float:
    """Return the wound-up share at a position, from the last reversal."""
    return direction - (direction - wound) * math.exp(-direction * (x - since) / over)


@compile_kernel
def _load_laws(
    bodies: Bodies, laws: FloatArray, modes: FloatArray, time: float, q: FloatArray, v: FloatArray, grip: FloatArray,
    springs: FloatArray, push: FloatArray,
) -> None:  # fmt: skip
    """Add friction and springs of nonlinear laws to the push on the masses, and fill their grip."""
    rotors, masses, bands, pieces, bends = bodies.rotors, bodies.masses, bodies.bands, bodies.pieces, bodies.bends
    for i in range(push.size):
        band = int(laws[BAND, i])
        viscous = bands[i, band, BACKWARDS if v[i] < 0.0 else FORWARDS] + masses[i, VISCOUS_DRIFT] * time
        push[i] -= viscous * v[i] + masses[i, OFFSET]
        grip[i] = bands[i, band, COULOMB] + masses[i, COULOMB_DRIFT] * time
    for i in range(rotors.size):
        r = rotors[i]
        if r == i:
            grip[i] += masses[i, PER_TORQUE] * abs(laws[SIGN, i])
            continue
        e, rate, piece = q[r] - q[i], v[r] - v[i], int(abs(laws[PIECE, i]))
        spring = pieces[i, piece, STIFFNESS] * e + pieces[i, piece, DAMPING] * rate + bends[i, CUBIC] * e * e * e
        if piece > 0:
            begins = pieces[i, piece, TORQUE] - pieces[i, piece, STIFFNESS] * pieces[i, piece, BEGIN]
            spring += math.copysign(1.0, laws[PIECE, i]) * begins
        if bends[i, SLIDER] > 0.0:
            over = bends[i, SLIPS] / bends[i, SLIDER]
            spring += bends[i, SLIPS] * wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
        grip[i] += masses[i, PER_TORQUE] * laws[SIGN, i] * spring
        springs[i] = spring
        push[i] += spring
        push[r] -= spring
    for i in range(push.size):
        if masses[i, PRESLIDING] > 0.0:  # it holds nothing at rest, and is a spring behind a reversal
            push[i] -= grip[i] * wound_up(laws[WOUND, i], laws[SINCE, i], modes[i], q[i], masses[i, PRESLIDING])
            grip[i] = 0.0


@inline_kernel
def _load_lines(
    rotors: IntArray, masses: FloatArray, bands: FloatArray, pieces: FloatArray, plain: bool, bias: FloatArray,
    q: FloatArray, v: FloatArray, M: FloatArray, push: FloatArray, grip: FloatArray,
) -> None:  # fmt: skip
    """Add rotors to the mass matrix, and fill pushes and grip where all laws are plain lines; else the links' alone.

    What is inlined takes arrays: Numba counts references to all arrays of a tuple, which would take half of the time.
    """
    for i in range(push.size):
        push[i] = 0.0
        if plain:
            push[i] = -bands[i, 0, BACKWARDS if v[i] < 0.0 else FORWARDS] * v[i] - masses[i, OFFSET]
            grip[i] = bands[i, 0, COULOMB]
    for i in range(bias.size):
        push[i] -= bias[i]
        r = rotors[i]
        if r == i:
            M[i, i] += masses[i, INERTIA]
        elif plain:
            spring = pieces[i, 0, STIFFNESS] * (q[r] - q[i]) + pieces[i, 0, DAMPING] * (v[r] - v[i])
            push[i] += spring
            push[r] -= spring


@compile_kernel
def load_forces(
    tree: Tree, bodies: Bodies, laws: FloatArray, modes: FloatArray, time: float, at: State, room: Room
) -> None:
    """Fill the mass matrix, what pushes every mass beside motor torque and grip, its grip and the springs' torques."""
    n = bodies.rotors.size
    equations_of_motion(tree, bodies.inertials, at.q[:n], at.v[:n], room.still, room.links, room.M, room.bias)
    _load_lines(
        bodies.rotors, bodies.masses, bodies.bands, bodies.pieces, laws.size == 0, room.bias, at.q, at.v, room.M,
        room.push, at.grip,
    )  # fmt: skip
    if laws.size > 0:
        _load_laws(bodies, laws, modes, time, at.q, at.v, at.grip, at.spring, room.push)


@compile_kernel
def _watch_laws(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State) -> None:
    """Fill the guards of edges, reversals and torques of laws that are not one line each."""
    nd, n, guard, slope, masses, bands = modes.size, bodies.rotors.size, at.guard, at.slope, bodies.masses, bodies.bands
    q, v, a = at.q, at.v, at.a
    pieces, bends, rotors, spring = bodies.pieces, bodies.bends, bodies.rotors, at.spring
    for k in range(nd, guard.size):
        guard[k], slope[k] = 1.0, 0.0
    for i in range(nd):
        band = int(laws[BAND, i])
        if masses[i, PRESLIDING] > 0.0:
            guard[i], slope[i] = modes[i] * v[i], modes[i] * a[i]
        if modes[i] != 0.0 and bodies.rests[i]:
            if bands[i, band, HIGH] < np.inf:
                guard[nd + i], slope[nd + i] = bands[i, band, HIGH] - modes[i] * v[i], -modes[i] * a[i]
            if band > 0:
                low = bands[i, band - 1, HIGH]
                guard[2 * nd + i], slope[2 * nd + i] = modes[i] * v[i] - low, modes[i] * a[i]
    for i in range(n):
        r, first = rotors[i], 3 * nd + i
        if r == i:
            continue
        e, rate, turns = q[r] - q[i], v[r] - v[i], a[r] - a[i]
        piece = int(abs(laws[PIECE, i]))
        if piece == 0 and pieces.shape[1] > 1:  # either side
            side = math.copysign(1.0, e)
            guard[first], slope[first] = pieces[i, 1, BEGIN] - side * e, -side * rate
        elif piece > 0:
            side = math.copysign(1.0, laws[PIECE, i])
            if piece + 1 < pieces.shape[1]:
                guard[first], slope[first] = pieces[i, piece + 1, BEGIN] - side * e, -side * rate
            guard[first + n], slope[first + n] = side * e - pieces[i, piece, BEGIN], side * rate
        if not guard[first] < np.inf:
            guard[first], slope[first] = 1.0, 0.0
        if bends[i, SLIDER] > 0.0:
            guard[first + 2 * n], slope[first + 2 * n] = laws[RATE, i] * rate, laws[RATE, i] * turns
        if masses[i, PER_TORQUE] > 0.0:
            guard[first + 3 * n] = laws[SIGN, i] * spring[i]


@inline_kernel
def _watch(
    rests: NDArray[np.bool_], modes: FloatArray, v: FloatArray, a: FloatArray, held: FloatArray, grip: FloatArray,
    guard: FloatArray, slope: FloatArray,
) -> None:  # fmt: skip
    """Fill what is positive until a mass stops or comes loose, and how fast it changes; 1 where friction holds none."""
    for i in range(modes.size):
        guard[i], slope[i] = 1.0, 0.0
        if rests[i] and modes[i] != 0.0:
            guard[i], slope[i] = modes[i] * v[i], modes[i] * a[i]
        elif rests[i]:
            guard[i] = _HOLD * grip[i] - abs(held[i])


@inline_kernel
def _turn(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State, i: int) -> None:
    """Let the friction of a mass wind up the other way."""
    over = bodies.masses[i, PRESLIDING]
    laws[WOUND, i] = wound_up(laws[WOUND, i], laws[SINCE, i], modes[i], at.q[i], over)
    laws[SINCE, i], modes[i] = at.q[i], -modes[i]


@inline_kernel
def _turn_slider(bodies: Bodies, laws: FloatArray, at: State, i: int) -> None:
    """Let the slider of a spring wind up the other way."""
    e, over = at.q[bodies.rotors[i]] - at.q[i], bodies.bends[i, SLIPS] / bodies.bends[i, SLIDER]
    laws[STRETCHED, i] = wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
    laws[TURNED, i], laws[RATE, i] = e, -laws[RATE, i]


@compile_kernel
def _align(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State) -> None:
    """Turn the laws of masses and springs that reverse from standstill.

    Forces go on where they were, so no acceleration changes.
    """
    for i in range(modes.size):
        way = at.v[i] if at.v[i] != 0.0 else at.a[i]
        if bodies.masses[i, PRESLIDING] > 0.0 and modes[i] * way < 0.0:
            _turn(bodies, laws, modes, at, i)
    for i in range(bodies.rotors.size):
        r = bodies.rotors[i]
        if r == i:
            continue
        rate = at.v[r] - at.v[i]
        way = rate if rate != 0.0 else at.a[r] - at.a[i]
        if bodies.bends[i, SLIDER] > 0.0 and laws[RATE, i] * way < 0.0:
            _turn_slider(bodies, laws, at, i)
        if laws[SIGN, i] * at.spring[i] < 0.0:
            laws[SIGN, i] = -laws[SIGN, i]


@compile_kernel
def _begin_laws(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State) -> None:
    """Fill where the laws are at the first sample: friction is wound up where a mass moves, no slider is."""
    rests = bodies.rests
    for i in range(modes.size):
        laws[BAND, i], laws[SINCE, i], laws[WOUND, i] = 0.0, at.q[i], 0.0 if at.v[i] == 0.0 else modes[i]
        if rests[i]:
            while abs(at.v[i]) > bodies.bands[i, int(laws[BAND, i]), HIGH]:
                laws[BAND, i] += 1.0
    for i in range(bodies.rotors.size):
        r = bodies.rotors[i]
        e, rate = at.q[r] - at.q[i], at.v[r] - at.v[i]
        laws[PIECE, i], laws[STRETCHED, i], laws[TURNED, i] = 0.0, 0.0, e
        laws[RATE, i], laws[SIGN, i] = math.copysign(1.0, rate), math.copysign(1.0, e)
        for k in range(1, bodies.pieces.shape[1] if r != i else 0):
            if abs(e) > bodies.pieces[i, k, BEGIN]:
                laws[PIECE, i] = math.copysign(float(k), e)


@inline_kernel
def accelerate(
    rotors: IntArray, masses: FloatArray, M: FloatArray, L: FloatArray, push: FloatArray, links: IntArray,
    torque: FloatArray, modes: FloatArray, grip: FloatArray, a: FloatArray, held: FloatArray,
) -> bool:  # fmt: skip
    """Fill accelerations and holding forces in given modes; False if M is not positive.

    Args:
        rotors: (n,) of `Bodies`.
        masses: of `Bodies`, of which the rotors' inertias are read.
        M: (n, n) of `load_forces`.
        L: (n, n) scratch: its root, with one over the diagonal.
        push: (masses,) of `load_forces`.
        links: (2, n) scratch: which links slide, and where the rows of their root begin.
        torque: (n,) of the motors.
        modes: (masses,) the direction in which each slides, 0 of one that rests.
        grip: (masses,) of `load_forces`.
        a: (masses,) out.
        held: (masses,) out.
    """
    n, free = torque.size, 0
    for i in range(push.size):
        a[i], held[i] = 0.0, push[i] - modes[i] * grip[i]
    for i in range(n):
        held[rotors[i]] += torque[i]
        if modes[i] != 0.0:
            links[0, free], links[1, free] = i, 0
            free += 1
    for i in range(n, push.size):
        if modes[i] != 0.0:
            a[i] = held[i] / masses[i, INERTIA]
    for x in range(free):
        i = links[0, x]
        total, begin = held[i], 0
        while begin < x and M[i, links[0, begin]] == 0.0:  # as of two arms on one base
            begin += 1
        links[1, x] = begin
        for y in range(begin, x):
            cell = M[i, links[0, y]]
            for k in range(max(begin, links[1, y]), y):
                cell -= L[x, k] * L[y, k]
            L[x, y] = cell * L[y, y]
            total -= L[x, y] * a[links[0, y]]
        pivot = M[i, i]
        for k in range(begin, x):
            pivot -= L[x, k] * L[x, k]
        if not pivot > 0.0:
            return False
        L[x, x] = 1.0 / math.sqrt(pivot)
        a[i] = total * L[x, x]
    for x in range(free - 1, -1, -1):
        total = a[links[0, x]] * L[x, x]
        a[links[0, x]] = total
        for y in range(links[1, x], x):
            a[links[0, y]] -= L[x, y] * total
    if free < n:
        for i in range(n):
            if modes[i] == 0.0:
                for j in range(n):
                    held[i] -= M[i, j] * a[j]
    return True


@compile_kernel
def settle(bodies: Bodies, room: Room, torque: FloatArray, modes: FloatArray, at: State) -> bool:
    """Set the modes of standing masses, at rest or sliding either way; arguments of `accelerate`."""
    push, v, a, held, grip, rests = room.push, at.v, at.a, at.held, at.grip, bodies.rests
    rotors, masses, M, L, order = bodies.rotors, bodies.masses, room.M, room.L, room.order
    for _ in range(_PIVOTS * push.size):
        if not accelerate(rotors, masses, M, L, push, order, torque, modes, grip, a, held):
            return False
        changed = False
        for i in range(push.size):
            if v[i] != 0.0 or not rests[i]:
                continue
            if modes[i] == 0.0 and abs(held[i]) >= _HOLD * grip[i] and held[i] != 0.0:
                modes[i], changed = math.copysign(1.0, held[i]), True
            elif modes[i] != 0.0 and modes[i] * a[i] <= 0.0:
                modes[i], changed = 0.0, True
            if changed:
                break
        if not changed:
            break
    return True


@compile_kernel
def _step(
    tree: Tree, bodies: Bodies, laws: FloatArray, torque: FloatArray, time: float, h: float, now: State,
    modes: FloatArray, room: Room, ahead: State,
) -> bool:  # fmt: skip
    """Fill where one step of the method leads, and the forces and accelerations there, in the modes of its start."""
    q, v, a, slopes = now.q, now.v, now.a, room.slopes
    q1, v1, a1, held1, grip1, springs1 = ahead.q, ahead.v, ahead.a, ahead.held, ahead.grip, ahead.spring
    inertials, rotors, masses, bands, pieces = (
        bodies.inertials,
        bodies.rotors,
        bodies.masses,
        bodies.bands,
        bodies.pieces,
    )
    still, links, M, L, bias, push, order = room.still, room.links, room.M, room.L, room.bias, room.push, room.order
    n, plain, rests, guard, slope = rotors.size, laws.size == 0, bodies.rests, ahead.guard, ahead.slope
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
        equations_of_motion(tree, inertials, q1[:n], v1[:n], still, links, M, bias)
        _load_lines(rotors, masses, bands, pieces, plain, bias, q1, v1, M, push, grip1)
        if not plain:
            _load_laws(bodies, laws, modes, time + (0.5 * h if stage < 2 else h), q1, v1, grip1, springs1, push)
        if not accelerate(rotors, masses, M, L, push, order, torque, modes, grip1, a1, held1):
            return False
    _watch(rests, modes, v1, a1, held1, grip1, guard, slope)
    if not plain:
        _watch_laws(bodies, laws, modes, ahead)
    return True


@compile_kernel
def _watch_again(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State) -> None:
    """Fill the guards of a state whose modes have changed."""
    _watch(bodies.rests, modes, at.v, at.a, at.held, at.grip, at.guard, at.slope)
    if laws.size > 0:
        _watch_laws(bodies, laws, modes, at)


@compile_kernel
def _earliest(h: float, now: State, ahead: State) -> tuple[int, float]:
    """Return the guard of the apparently first event in a step, and where: 1 if negative at the end.

    Less than 1 is the bottom of a dip of one that is positive at both ends. No guard, -1, if there is no event.
    """
    first, found, at = 2.0, -1, 1.0
    guard, slope, guard1, slope1 = now.guard, now.slope, ahead.guard, ahead.slope
    for i in range(guard.size):
        end, start = guard1[i], guard[i]
        if end <= 0.0:
            place = start / (start - end)
            if place < first:
                first, found, at = place, i, 1.0
        else:
            down, up = slope[i] * h, slope1[i] * h
            if down < 0.0 < up and min(start, end) < 0.15 * (up - down):
                # The cubic through both ends: where it is lowest, and how low.
                c2, c3 = 3.0 * (end - start) - 2.0 * down - up, 2.0 * (start - end) + down + up
                root = c2 * c2 - 3.0 * c3 * down
                place = -down / (c2 + math.sqrt(max(root, 0.0)))
                lowest = start + place * (down + place * (c2 + place * c3))
                if 0.0 < place < 1.0 and lowest < 0.0 and place < first:
                    first, found, at = place, i, place
    return found, at


@compile_kernel
def _go_over(bodies: Bodies, laws: FloatArray, modes: FloatArray, at: State, event: int) -> None:
    """Let a law go over an edge, a mass stop, or what winds up turn; one that comes loose is settled with all."""
    nd, n = modes.size, bodies.rotors.size
    if event < nd:
        if bodies.masses[event, PRESLIDING] > 0.0:
            _turn(bodies, laws, modes, at, event)
            at.v[event] = 0.0
        elif modes[event] != 0.0:
            at.v[event], modes[event] = 0.0, 0.0
    elif event < 2 * nd:
        laws[BAND, event - nd] += 1.0
    elif event < 3 * nd:
        laws[BAND, event - 2 * nd] -= 1.0
    else:
        i, which = (event - 3 * nd) % n, (event - 3 * nd) // n
        if which == 0:
            e = at.q[bodies.rotors[i]] - at.q[i]
            laws[PIECE, i] += math.copysign(1.0, laws[PIECE, i] if laws[PIECE, i] != 0.0 else e)
        elif which == 1:
            laws[PIECE, i] -= math.copysign(1.0, laws[PIECE, i])
        elif which == 2:
            _turn_slider(bodies, laws, at, i)
        else:
            laws[SIGN, i] = -laws[SIGN, i]


@compile_kernel
def _advance(
    tree: Tree, bodies: Bodies, laws: FloatArray, torque: FloatArray, time: float, length: float,
    steps: int, now: State, modes: FloatArray, room: Room, ahead: State, tape: RobotTape, counts: IntArray,
) -> int:  # fmt: skip
    """Move all masses through a part of a period, from settled modes; write its pieces, and return how it ended.

    The state, forces, accelerations and modes are left as they are at the end, under the torques until then.
    """
    q, v, a, held, grip = now.q, now.v, now.a, now.held, now.grip
    q1, v1, a1, held1, grip1 = ahead.q, ahead.v, ahead.a, ahead.held, ahead.grip
    events, nd = 0, q.size
    _watch_again(bodies, laws, modes, now)
    share = length / steps
    for step in range(steps):
        left = share
        while left > 0.0:
            h, event = left, -1
            here = time + (step + 1) * share - left
            if not _step(tree, bodies, laws, torque, here, h, now, modes, room, ahead):
                return NOT_POSITIVE
            event, at = _earliest(h, now, ahead)
            if event >= 0 and at < 1.0:  # a dip that the cubic has: whether the motion has it, too
                if not _step(tree, bodies, laws, torque, here, at * h, now, modes, room, ahead):
                    return NOT_POSITIVE
                if ahead.guard[event] > 0.0:
                    h, event = at * h, -1
            high = at
            for _other in range(now.guard.size + 1):
                if event < 0:
                    break
                # Between a guard that is positive and one that is not: by Newton's steps, to a little behind the root,
                # where its slope is known, else by the secant, its idle end halved (Illinois). A guard that begins at
                # 0 is divided by the time since, and has the secant.
                low, above = 0.0, now.guard[event]
                begins = not above > 0.0
                if begins:
                    above = now.slope[event] * h
                below = ahead.guard[event]
                below = below / high if begins else below
                kept, last = 0, high
                if not above > 0.0:
                    high = 0.0
                for _closer in range(_CLOSER):
                    slope = ahead.slope[event] * h if not begins else 0.0
                    if not high - low > _ROOT or below == 0.0 or (last == high and 0.0 < -below < -_ROOT * slope):
                        break
                    place = (low * below - high * above) / (below - above)
                    if slope < 0.0:
                        root = last - ahead.guard[event] / slope + 0.3 * _ROOT
                        place = root if low < root < high else place
                    place = min(max(place, low + 0.1 * _ROOT), high - 0.1 * _ROOT)
                    if not _step(tree, bodies, laws, torque, here, place * h, now, modes, room, ahead):
                        return NOT_POSITIVE
                    value, last = ahead.guard[event], place
                    value = value / place if begins else value
                    if value > 0.0:
                        low, above = place, value
                        below = 0.5 * below if kept > 0 else below
                        kept = 1
                    else:
                        high, below = place, value
                        above = 0.5 * above if kept < 0 else above
                        kept = -1
                if last != high and not _step(tree, bodies, laws, torque, here, high * h, now, modes, room, ahead):
                    return NOT_POSITIVE
                other = -1
                for i in range(now.guard.size):
                    if i != event and ahead.guard[i] <= 0.0 < now.guard[i]:
                        other = i
                        break
                if other < 0 or high == 0.0:
                    break
                event = other
            taken = h if event < 0 else high * h
            row = counts[1]
            if tape.lasting.size > 0:
                if row >= tape.lasting.size:
                    return CHATTERING
                tape.lasting[row], tape.stopped[row] = taken, event
                for i in range(nd):
                    tape.places[row, i], tape.speeds[row, i], tape.initial_acceleration[row, i] = q[i], v[i], a[i]
                    tape.final_acceleration[row, i], tape.directions[row, i] = a1[i], modes[i]
                for i in range(laws.shape[0]):
                    assign(tape.laws[row, i], laws[i])
            counts[1] += 1
            for i in range(nd):
                q[i], v[i], a[i], held[i], grip[i] = q1[i], v1[i], a1[i], held1[i], grip1[i]
            assign(now.spring, ahead.spring)
            assign(now.guard, ahead.guard)
            assign(now.slope, ahead.slope)
            left = 0.0 if event < 0 and h == left else left - taken
            if event >= 0:
                events += 1
                counts[0] += 1
                if events > _EVENTS:
                    return CHATTERING
                loose = event < nd and modes[event] == 0.0
                _go_over(bodies, laws, modes, now, event)
                if not loose:
                    load_forces(tree, bodies, laws, modes, time + (step + 1) * share - left, now, room)
                if not settle(bodies, room, torque, modes, now):
                    return NOT_POSITIVE
                if laws.size > 0:
                    _align(bodies, laws, modes, now)
                _watch_again(bodies, laws, modes, now)
    return FINISHED


@compile_kernel
def run(
    tree: Tree, bodies: Bodies, clock: Clock, steps: int, controllers: Controllers, driven: Driven, z: FloatArray,
    q: FloatArray, v: FloatArray, seen: Seen, tape: RobotTape, counts: IntArray,
) -> int:  # fmt: skip
    """Simulate a robot; fill what is out and return how it ended.

    Args:
        tree: of the links.
        bodies: numbers of the candidate.
        clock: of the controllers.
        steps: of the integrator in each part of a step of the clock.
        controllers: of the joints.
        driven: what drives them.
        z: (n, states) of the controllers, overwritten.
        q: (masses,) initial positions, overwritten.
        v: (masses,) initial velocities, overwritten.
        seen: out.
        tape: out.
        counts: (3,) out: events, pieces, steps of the clock simulated.
    """
    n, nd, parts = bodies.rotors.size, q.size, clock.lengths.size
    rotors, every, lags, w = bodies.rotors, clock.every, clock.lags, driven.w
    command, cuts = seen.command, seen.cuts
    torque, modes = np.empty(n), np.empty(nd)
    M, L, order = np.empty((n, n)), np.empty((n, n)), np.empty((2, n), dtype=np.int64)
    room = Room(np.zeros(n), np.empty((n, ROOM)), M, L, np.empty(n), np.empty(nd), order, np.empty((2, nd)))
    laws = np.zeros(tape.laws.shape[1:])
    guards = nd if laws.size == 0 else 3 * nd + 4 * n
    states = np.zeros((2, 5, nd)), np.zeros((2, n)), np.zeros((2, 2, guards))
    now = State(q, v, states[0][0, 2], states[0][0, 3], states[0][0, 4], states[1][0], states[2][0, 0], states[2][0, 1])
    ahead = State(
        states[0][1, 0], states[0][1, 1], states[0][1, 2], states[0][1, 3], states[0][1, 4], states[1][1],
        states[2][1, 0], states[2][1, 1],
    )  # fmt: skip
    period = np.sum(clock.lengths)
    nz, elements = z.shape[1], w.shape[1]
    new, out, cut = np.empty(nz), np.zeros(elements), np.zeros(elements)
    masses, rests = bodies.masses, bodies.rests
    for i in range(nd):
        modes[i] = 1.0
        if rests[i]:
            modes[i] = 0.0 if v[i] == 0.0 else math.copysign(1.0, v[i])
        elif masses[i, PRESLIDING] > 0.0:
            modes[i] = math.copysign(1.0, v[i])
    loaded = False  # whether a friction follows the torque of a motor
    if laws.size > 0:
        _begin_laws(bodies, laws, modes, now)
        for i in range(n):
            loaded = loaded or (rotors[i] == i and masses[i, PER_TORQUE] > 0.0)
    load_forces(tree, bodies, laws, modes, 0.0, now, room)
    for k in range(command.shape[1]):
        for j in range(n):
            if k % every[j] != 0:  # this controller holds
                command[j, k] = command[j, k - 1]
                continue
            own, position = k // every[j], q[rotors[j]]
            c = controllers
            law = Feedback(
                c.A[j], c.Bq[j], c.F[j], c.C[j], c.D[j], c.E[j], c.limits[j], c.gates[j], c.driven[j], c.outputs[j],
            )  # fmt: skip
            control_any(law, w[j], own, position, z[j], new, out, cut)
            command[j, k] = out[controllers.outputs[j]]
            if cuts.shape[1] > 0:
                for i in range(elements):
                    cuts[j, own, i] = cut[i] != 0.0
            if not (abs(position) <= driven.far[j] and abs(command[j, k]) < np.inf):
                return DIVERGED
        time = k * period
        for part in range(parts):
            for j in range(n):
                source = k - lags[j, part]
                torque[j] = command[j, source] + driven.post[j, source] if source >= 0 else driven.before[j]
                if loaded and rotors[j] == j:
                    laws[SIGN, j] = torque[j]
            if loaded:
                load_forces(tree, bodies, laws, modes, time, now, room)
            if not settle(bodies, room, torque, modes, now):
                return NOT_POSITIVE
            if laws.size > 0:
                _align(bodies, laws, modes, now)
            tape.first[k * parts + part] = counts[1]
            status = _advance(
                tree, bodies, laws, torque, time, clock.lengths[part], steps, now, modes, room, ahead,
                tape, counts,
            )  # fmt: skip
            time += clock.lengths[part]
            if status != FINISHED:
                return status
        counts[2] = k + 1
    return FINISHED
