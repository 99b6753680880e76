"""How the torques of a robot's run change with its parameters, by variation along the run's tape, compiled.

Along each piece of the tape the deviations of all masses obey the linearised equations of `kernels.robot_loop`::

    M da + C dv + K dq = G + B dtau

with M, C and K the derivatives of the links' inverse dynamics by acceleration, velocity and position, of springs and
viscous friction, and G the derivative of the equations by the parameters, negative: the regressor's columns for the
numbers of a link. They are taken at the middle of a piece, and integrated by the implicit midpoint rule, of order 2. A
mass at rest stays there. An event moves in time with the velocity that it takes to zero, so there velocities jump
(M. A. Aizerman and F. R. Gantmacher: On the stability of periodic motions, Journal of Applied Mathematics and Mechanics
22, 1958)::

    dv+ = dv- + (a+ - a-) dv_i- / a_i-

The controllers are linear between limits, and where one acts its element does not change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.robots.dynamics import regressor
from jointid.models.robots.equations import ROOM, linearised_equations, of_joints
from jointid.models.robots.robot import Tree
from jointid.simulation.kernels.drive import IntArray
from jointid.simulation.kernels.robot_loop import (
    BACKWARDS,
    BAND,
    BEGIN,
    COULOMB,
    COULOMB_DRIFT,
    CUBIC,
    DAMPING,
    FORWARDS,
    INERTIA,
    OFFSET,
    PER_TORQUE,
    PIECE,
    PRESLIDING,
    RATE,
    SIGN,
    SINCE,
    SLIDER,
    SLIPS,
    STIFFNESS,
    STRETCHED,
    TORQUE,
    TURNED,
    VISCOUS_DRIFT,
    WOUND,
    Bodies,
    Clock,
    Controllers,
    RobotTape,
    wound_up,
)

OF_LINK, OF_MASS, OF_SPRING = range(3)
"""What a parameter is a number of: row of the inertials, the masses or the springs."""
OF_DELAY = 5
"""How much later than its law puts it out a joint's torque acts."""
OF_PUSH = 6
"""No number, but a torque that is added to a controller's output: its joint, and its row of the pushes."""


class Seeds(NamedTuple):
    """Derivatives of the numbers of `Bodies` in the row that a parameter is of; 0 of a link's.

    Attributes:
        mass: (parameters, 6). bands: (parameters, bands, 4).
        pieces: (parameters, pieces, 4). bends: (parameters, 3).
        pushes: (pushes, clock) torques that are added to controllers' outputs.
    """

    mass: FloatArray
    bands: FloatArray
    pieces: FloatArray
    bends: FloatArray
    pushes: FloatArray


class Moved(NamedTuple):
    """Derivatives at the first sample.

    Attributes:
        dq: (masses, parameters) of the positions.
        dv: (masses, parameters) of the velocities.
        dz: (n, states, parameters) of the controllers' states.
        before: (n, parameters) of the torques before the first period.
    """

    dq: FloatArray
    dv: FloatArray
    dz: FloatArray
    before: FloatArray


_TURNING = 1e-9  # of the largest acceleration: a velocity that comes to 0 with less of its own hardly turns


@compile_kernel
def _solve(A: FloatArray, rows: FloatArray) -> None:
    """Solve A x = rows in place by elimination with pivots; both are overwritten."""
    n = len(A)
    for k in range(n):
        at = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[at, k]):
                at = i
        if at != k:
            for j in range(n):
                A[k, j], A[at, j] = A[at, j], A[k, j]
            for c in range(rows.shape[1]):
                rows[k, c], rows[at, c] = rows[at, c], rows[k, c]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                for c in range(rows.shape[1]):
                    rows[i, c] -= factor * rows[k, c]
    for k in range(n - 1, -1, -1):
        share = 1.0 / A[k, k]
        for c in range(rows.shape[1]):
            rows[k, c] *= share
        for i in range(k):
            factor = A[i, k]
            if factor != 0.0:
                for c in range(rows.shape[1]):
                    rows[i, c] -= factor * rows[k, c]


@inline_kernel
def _control(
    laws: Controllers, j: int, phase: int, cut: NDArray[np.bool_], moved: FloatArray, dz: FloatArray,
    fresh: FloatArray, raw: FloatArray, command: FloatArray,
) -> None:  # fmt: skip
    """Fill the change of a controller's output, and move the changes of its states."""
    A, Bq, F, C, D, E = laws.A[j], laws.Bq[j], laws.F[j], laws.C[j], laws.D[j], laws.E[j]
    output, elements, states, count = laws.outputs[j], cut.size, len(dz), moved.size
    for e in range(elements):
        for c in range(count):
            raw[e, c] = D[phase, e] * moved[c]
        for s in range(states):
            weight = C[phase, e, s]
            if weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * dz[s, c]
        for other in range(e):
            if cut[other] and E[phase, e, other] != 0.0:
                for c in range(count):
                    raw[e, c] -= E[phase, e, other] * raw[other, c]
    for s in range(states):
        for c in range(count):
            fresh[s, c] = Bq[phase, s] * moved[c]
        for other in range(states):
            weight = A[phase, s, other]
            if weight != 0.0:
                for c in range(count):
                    fresh[s, c] += weight * dz[other, c]
        for e in range(elements):
            if cut[e] and F[phase, s, e] != 0.0:
                for c in range(count):
                    fresh[s, c] -= F[phase, s, e] * raw[e, c]
    for s in range(states):
        for c in range(count):
            dz[s, c] = fresh[s, c]
    for c in range(count):
        command[c] = 0.0 if cut[output] else raw[output, c]


@inline_kernel
def _winding(wound: float, since: float, way: float, x: float, over: float) -> tuple[float, float]:
    """Return the derivatives of the wound-up share by its value at the last reversal and by its displacement."""
    faded = math.exp(-way * (x - since) / over)
    return faded, -(way - wound) * faded * way * (x - since) / (over * over)


@compile_kernel
def spring_torque(bodies: Bodies, laws: FloatArray, q: FloatArray, v: FloatArray, i: int) -> float:
    """Return the torque of a spring."""
    e, rate, piece = q[bodies.rotors[i]] - q[i], v[bodies.rotors[i]] - v[i], int(abs(laws[PIECE, i]))
    torque = bodies.pieces[i, piece, STIFFNESS] * e + bodies.pieces[i, piece, DAMPING] * rate
    if piece > 0:
        begins = bodies.pieces[i, piece, TORQUE] - bodies.pieces[i, piece, STIFFNESS] * bodies.pieces[i, piece, BEGIN]
        torque += math.copysign(1.0, laws[PIECE, i]) * begins
    torque += bodies.bends[i, CUBIC] * e * e * e
    if bodies.bends[i, SLIDER] > 0.0:
        over = bodies.bends[i, SLIPS] / bodies.bends[i, SLIDER]
        torque += bodies.bends[i, SLIPS] * wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
    return float(torque)


@compile_kernel
def _carried(bodies: Bodies, laws: FloatArray, q: FloatArray, v: FloatArray, i: int) -> float:
    """Return the size of the torque that friction grows with: the spring's, of a rigid joint the motor's."""
    if bodies.rotors[i] == i:
        return float(abs(laws[SIGN, i]))
    return float(laws[SIGN, i] * spring_torque(bodies, laws, q, v, i))


@compile_kernel
def _grip(bodies: Bodies, laws: FloatArray, q: FloatArray, v: FloatArray, i: int, time: float) -> float:
    """Return the Coulomb force of a mass."""
    grip = bodies.bands[i, int(laws[BAND, i]), COULOMB] + bodies.masses[i, COULOMB_DRIFT] * time
    if bodies.masses[i, PER_TORQUE] > 0.0:
        grip += bodies.masses[i, PER_TORQUE] * _carried(bodies, laws, q, v, i)
    return float(grip)


@compile_kernel
def _by_spring(bodies: Bodies, laws: FloatArray, seeds: Seeds, q: FloatArray, v: FloatArray, i: int, c: int) -> float:
    """Return the derivative of a spring's torque by one of its numbers, the motion held."""
    r = bodies.rotors[i]
    e, rate = q[r] - q[i], v[r] - v[i]
    piece = int(abs(laws[PIECE, i]))
    own, line = seeds.pieces[c, piece], bodies.pieces[i, piece]
    torque = own[STIFFNESS] * e + own[DAMPING] * rate
    if piece > 0:
        begins = own[TORQUE] - own[STIFFNESS] * line[BEGIN] - line[STIFFNESS] * own[BEGIN]
        torque += math.copysign(1.0, laws[PIECE, i]) * begins
    torque += seeds.bends[c, CUBIC] * e * e * e
    slider, slips = bodies.bends[i, SLIDER], bodies.bends[i, SLIPS]
    if slider > 0.0:
        over = slips / slider
        u = wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
        _, longer = _winding(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
        dover = seeds.bends[c, SLIPS] / slider - over * seeds.bends[c, SLIDER] / slider
        torque += seeds.bends[c, SLIPS] * u + slips * longer * dover
    return float(torque)


@compile_kernel
def _over_edge(
    bodies: Bodies, tape: RobotTape, seeds: Seeds, parameters: IntArray, piece: int, event: int, dq: FloatArray,
    turned: FloatArray,
) -> float:  # fmt: skip
    """Fill by how much a deflection comes nearer to the edge of its piece, and return how fast it goes over it."""
    n, nd = bodies.rotors.size, bodies.masses.shape[0]
    laws, i = tape.laws[piece], (event - 3 * nd) % n
    outer, r, now = event < 3 * nd + n, bodies.rotors[i], laws[PIECE, i]
    e, rate = (
        tape.places[piece + 1, r] - tape.places[piece + 1, i],
        tape.speeds[piece + 1, r] - tape.speeds[piece + 1, i],
    )
    side = math.copysign(1.0, now if now != 0.0 else e)
    edge = int(abs(now)) + (1 if outer else 0)
    for c in range(turned.size):
        own = seeds.pieces[c, edge, BEGIN] if parameters[c, 0] == OF_SPRING and parameters[c, 1] == i else 0.0
        turned[c] = side * (dq[r, c] - dq[i, c]) - own
    return float(side * rate)


@compile_kernel
def _turn(
    bodies: Bodies, tape: RobotTape, seeds: Seeds, parameters: IntArray, piece: int, dq: FloatArray, wound: FloatArray,
    since: FloatArray, stretched: FloatArray, stretch_since: FloatArray,
) -> None:  # fmt: skip
    """Update the derivatives of wound-up shares at a reversal."""
    n, nd, count = bodies.rotors.size, bodies.masses.shape[0], dq.shape[1]
    laws, after = tape.laws[piece], tape.laws[piece + 1]
    for i in range(nd):
        way, over = tape.directions[piece, i], bodies.masses[i, PRESLIDING]
        if over > 0.0 and tape.directions[piece + 1, i] != way:
            x = tape.places[piece + 1, i]
            slope = (1.0 - way * wound_up(laws[WOUND, i], laws[SINCE, i], way, x, over)) / over
            faded, longer = _winding(laws[WOUND, i], laws[SINCE, i], way, x, over)
            for c in range(count):
                own = seeds.mass[c, PRESLIDING] if parameters[c, 0] == OF_MASS and parameters[c, 1] == i else 0.0
                wound[i, c] = faded * wound[i, c] + slope * (dq[i, c] - since[i, c]) + longer * own
                since[i, c] = dq[i, c]
    for i in range(n):
        r, way = bodies.rotors[i], laws[RATE, i]
        if bodies.bends[i, SLIDER] > 0.0 and after[RATE, i] != way:
            e, over = (
                tape.places[piece + 1, r] - tape.places[piece + 1, i],
                bodies.bends[i, SLIPS] / bodies.bends[i, SLIDER],
            )
            slope = (1.0 - way * wound_up(laws[STRETCHED, i], laws[TURNED, i], way, e, over)) / over
            faded, longer = _winding(laws[STRETCHED, i], laws[TURNED, i], way, e, over)
            for c in range(count):
                own = 0.0
                if parameters[c, 0] == OF_SPRING and parameters[c, 1] == i:
                    own = (seeds.bends[c, SLIPS] - over * seeds.bends[c, SLIDER]) / bodies.bends[i, SLIDER]
                moved = dq[r, c] - dq[i, c]
                stretched[i, c] = faded * stretched[i, c] + slope * (moved - stretch_since[i, c]) + longer * own
                stretch_since[i, c] = moved


@compile_kernel
def _shift_edges(
    bodies: Bodies, parameters: IntArray, tape: RobotTape, last: int, piece: int, jumps: NDArray[np.bool_],
    M: FloatArray, left: FloatArray, kicks: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Add to the velocities what later edges of the torques, as a piece begins, take from them.

    An edge of one motor's torque is all that changes in the equation of the mass that it drives, which may come loose.
    It lies between the last piece before and the first piece that lasts.
    """
    rotors, masses, rests, n, d = bodies.rotors, bodies.masses, bodies.rests, len(M), 0
    directions, after, before = tape.directions[piece], tape.initial_acceleration, tape.final_acceleration
    for i in range(n):
        held = rests[i] and directions[i] == 0.0
        for j in range(n):
            left[i, j] = M[i, j] if not held else 0.0
        left[i, i] += 1.0 if held else (masses[i, INERTIA] if rotors[i] == i else 0.0)
    for c in range(len(parameters)):
        if parameters[c, 0] != OF_DELAY:
            continue
        j, r = parameters[c, 1], rotors[parameters[c, 1]]
        for i in range(n):
            kicks[i, d] = 0.0
        if jumps[j] and r != j:
            dv[r, c] -= after[piece, r] - before[last, r]
        elif jumps[j] and not (rests[r] and directions[r] == 0.0):
            for i in range(n):
                kicks[j, d] -= left[j, i] * (after[piece, i] - before[last, i])
        d += 1
    _solve(left, kicks)
    d = 0
    for c in range(len(parameters)):
        if parameters[c, 0] == OF_DELAY:
            for i in range(n):
                dv[i, c] += kicks[i, d]
            d += 1


@compile_kernel
def _add_moved_links(
    rotors: IntArray, stiff: FloatArray, damped: FloatArray, M: FloatArray, Cv: FloatArray, K: FloatArray, h: float,
    whole: float,
    dq: FloatArray, rate: FloatArray, gained: FloatArray, moved_links: FloatArray,
) -> None:  # fmt: skip
    """Add what the links' changes of position, rate and velocity gained in a piece of h s add to the motors' torques.

    A motor feels them by its spring, or, of a rigid joint, by the links that hang on others.
    """
    n, count = rotors.size, dq.shape[1]
    share = h / whole
    for i in range(n):
        for j in range(n):
            if rotors[j] == j or (rotors[i] != i and i != j):  # it is moved as prescribed, or on another's spring
                continue
            inert = M[i, j] / whole if rotors[i] == i else 0.0
            damping = share * (Cv[i, j] if rotors[i] == i else -damped[i])
            stiffness = share * (K[i, j] if rotors[i] == i else -stiff[i])
            for c in range(count):
                middle = dq[j, c] - 0.5 * h * rate[j, c]
                moved_links[i, c] += inert * gained[j, c] + damping * rate[j, c] + stiffness * middle


@compile_kernel
def differentiate_run(
    tree: Tree, bodies: Bodies, clock: Clock, controllers: Controllers, cuts: NDArray[np.bool_], tape: RobotTape,
    parameters: IntArray, seeds: Seeds, moved: Moved, command: FloatArray, moved_links: FloatArray,
) -> None:  # fmt: skip
    """Fill the derivatives of the torques, step of the clock by step.

    Args:
        tree: of `kernels.robot_loop.run`, as the run had it.
        bodies: the same.
        clock: the same.
        controllers: the same.
        cuts: what it wrote.
        tape: the same.
        parameters: (parameters, 3) what each is a number of, in which row and column.
        seeds: how the numbers of that row depend on it.
        moved: derivatives at the beginning, overwritten.
        command: (n, clock, parameters) out; or (n, clock, 0) of motors that are moved, whatever it takes.
        moved_links: (n, parts of all steps, parameters) out, mean over each: what the links' change of motion adds to
            the torque that a prescribed motion takes of a motor; or (n, 0, 0).
    """
    rotors, masses, joints, plain = bodies.rotors, bodies.masses, tree.joints, tape.laws.shape[1] == 0
    bands, springs, rests = bodies.bands, bodies.pieces, bodies.rests
    own_mass, own_bands, own_pieces = seeds.mass, seeds.bands, seeds.pieces
    lags, every, dq, dv, dz = clock.lags, clock.every, moved.dq, moved.dv, moved.dz
    before = moved.before
    first, lasting, places, speeds = tape.first, tape.lasting, tape.places, tape.speeds
    started, ended = tape.initial_acceleration, tape.final_acceleration
    directions, stopped = tape.directions, tape.stopped
    n, nd, count = rotors.size, len(dq), len(parameters)
    parts, steps, pieces = lags.shape[1], command.shape[1], lasting.size
    dtau, rows, other = np.zeros((n, count)), np.zeros((n, count)), np.zeros((nd, count))
    controlled, prescribed, gained = command.shape[2] > 0, moved_links.shape[1] > 0, np.zeros((n, count))
    turned, fresh, raw = np.zeros(count), np.zeros((dz.shape[1], count)), np.zeros((cuts.shape[2], count))
    q, v, a = np.zeros(nd), np.zeros(nd), np.zeros(nd)
    place, speed, turn, room, coupled = q[:n], v[:n], a[:n], np.empty((n, ROOM)), joints.shape[0] > 0  # of the links
    M, K, Cv, left, Y = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, 10 * n))
    of_links = np.zeros(Y.shape if coupled else (0, 0))
    pull, alone, tie = np.zeros(n), np.zeros(n), np.zeros(n)
    # Of masses the viscous coefficient, what the Coulomb force is multiplied with, its size, and what winding up adds
    # to their stiffness; of springs the stiffness, the damping, and the share of their torque that pushes the link.
    viscous, sliding, winds = np.zeros(nd), np.zeros(nd), np.zeros(nd)
    stiff, damped, passed = np.zeros(n), np.zeros(n), np.ones(n)
    # Derivatives of what was wound up at the last reversal, and of the place.
    smooth = 0 if plain else nd
    wound, since = np.zeros((smooth, count)), np.zeros((smooth, count))
    stretched, stretch_since = np.zeros((min(smooth, n), count)), np.zeros((min(smooth, n), count))
    for c in range(count):
        for i in range(smooth):
            since[i, c] = dq[i, c]
        for i in range(min(smooth, n)):
            stretch_since[i, c] = dq[rotors[i], c] - dq[i, c]
    period, time = np.sum(clock.lengths), 0.0
    linked, delays = False, 0
    for c in range(count):
        linked = linked or parameters[c, 0] == OF_LINK
        delays += parameters[c, 0] == OF_DELAY
    kicks, jumps = np.zeros((n, delays)), np.zeros(n, dtype=np.bool_)
    for k in range(steps):
        for j in range(n):
            own = k // every[j]
            if not controlled:
                break
            if k % every[j] != 0:  # this controller holds
                command[j, k] = command[j, k - 1]
                continue
            for c in range(count):
                turned[c] = dq[rotors[j], c]
            _control(
                controllers, j, own % controllers.A.shape[1], cuts[j, own], turned, dz[j], fresh, raw, command[j, k],
            )  # fmt: skip
            for c in range(count):
                if parameters[c, 0] == OF_PUSH and parameters[c, 1] == j:
                    command[j, k, c] += seeds.pushes[parameters[c, 2], k]
        time = k * period
        for part in range(parts):
            at = k * parts + part
            if at >= first.size:
                return
            end = first[at + 1] if at + 1 < first.size else pieces
            for j in range(n):
                source = k - lags[j, part]
                jumps[j] = source != (k - lags[j, part - 1] if part > 0 else k - 1 - lags[j, parts - 1])
                for c in range(count if controlled else 0):
                    dtau[j, c] = command[j, source, c] if source >= 0 else before[j, c]
            whole, edge = np.sum(lasting[first[at] : end]), delays > 0 and first[at] > 0
            for piece in range(first[at], end):
                if piece + 1 >= pieces:
                    return
                h = lasting[piece]
                for i in range(n if prescribed else 0):
                    for c in range(count):
                        gained[i, c] = 0.0
                if h > 0.0:
                    for i in range(nd):
                        q0, q1, v0, v1 = places[piece, i], places[piece + 1, i], speeds[piece, i], speeds[piece + 1, i]
                        q[i] = 0.5 * (q0 + q1) + 0.125 * h * (v0 - v1)
                        v[i] = 0.5 * (v0 + v1) + 0.125 * h * (started[piece, i] - ended[piece, i])
                        a[i] = 0.5 * (started[piece, i] + ended[piece, i])
                    linearised_equations(tree, bodies.inertials, place, speed, turn, room, M, K, Cv)
                    if edge:
                        _shift_edges(bodies, parameters, tape, first[at] - 1, piece, jumps, M, left, kicks, dv)
                        edge = False
                    # G, and what the motors do.
                    if linked and coupled:
                        regressor(
                            tree, of_joints(joints, place), of_joints(joints, speed), of_joints(joints, turn), of_links
                        )
                        for c in range(10 * n):
                            assign(Y[:, c], of_joints(joints.T, of_links[:, c]))
                    elif linked:
                        regressor(tree, place, speed, turn, Y)
                    for i in range(nd):
                        for c in range(count):
                            other[i, c] = 0.0
                    for j in range(n):
                        for c in range(count):
                            other[rotors[j], c] = dtau[j, c]
                    at_middle = time + 0.5 * h
                    laws = tape.laws[piece]
                    for i in range(nd):
                        band = 0 if plain else int(laws[BAND, i])
                        viscous[i] = bands[i, band, FORWARDS if v[i] >= 0.0 else BACKWARDS]
                        viscous[i] += masses[i, VISCOUS_DRIFT] * at_middle
                        sliding[i] = directions[piece, i] if rests[i] else np.sign(v[i])
                        winds[i] = 0.0
                    for i in range(n):
                        r = rotors[i]
                        if r == i:
                            continue
                        which = 0 if plain else int(abs(laws[PIECE, i]))
                        stiff[i], damped[i] = springs[i, which, STIFFNESS], springs[i, which, DAMPING]
                        if not plain:
                            e = q[r] - q[i]
                            stiff[i] += 3.0 * bodies.bends[i, CUBIC] * e * e
                            if bodies.bends[i, SLIDER] > 0.0:
                                over = bodies.bends[i, SLIPS] / bodies.bends[i, SLIDER]
                                u = wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
                                stiff[i] += bodies.bends[i, SLIDER] * (1.0 - laws[RATE, i] * u)
                    for i in range(smooth):
                        if masses[i, PRESLIDING] > 0.0:
                            way, over = directions[piece, i], masses[i, PRESLIDING]
                            sliding[i] = wound_up(laws[WOUND, i], laws[SINCE, i], way, q[i], over)
                            grip = _grip(bodies, laws, q, v, i, at_middle)
                            slope = grip * (1.0 - way * sliding[i]) / over
                            faded, longer = _winding(laws[WOUND, i], laws[SINCE, i], way, q[i], over)
                            winds[i] = slope
                            for c in range(count):
                                own = 0.0
                                if parameters[c, 0] == OF_MASS and parameters[c, 1] == i:
                                    own = own_mass[c, PRESLIDING]
                                other[i, c] += slope * since[i, c] - grip * (faded * wound[i, c] + longer * own)
                    for i in range(n):
                        passed[i] = 1.0
                        if not plain and rotors[i] == i:
                            passed[i] -= sliding[i] * masses[i, PER_TORQUE] * np.sign(laws[SIGN, i])
                            for c in range(count):
                                other[i, c] -= (1.0 - passed[i]) * dtau[i, c]
                        elif not plain:
                            passed[i] -= sliding[i] * masses[i, PER_TORQUE] * laws[SIGN, i]
                            if bodies.bends[i, SLIDER] > 0.0:
                                e, over = q[rotors[i]] - q[i], bodies.bends[i, SLIPS] / bodies.bends[i, SLIDER]
                                u = wound_up(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
                                slope = bodies.bends[i, SLIDER] * (1.0 - laws[RATE, i] * u)
                                faded, _ = _winding(laws[STRETCHED, i], laws[TURNED, i], laws[RATE, i], e, over)
                                for c in range(count):
                                    torque = bodies.bends[i, SLIPS] * faded * stretched[i, c]
                                    torque -= slope * stretch_since[i, c]
                                    other[rotors[i], c] -= torque
                                    other[i, c] += passed[i] * torque
                    for c in range(count):
                        kind, row, which = parameters[c, 0], parameters[c, 1], parameters[c, 2]
                        if kind == OF_LINK:
                            for i in range(n):
                                other[i, c] -= Y[i, 10 * row + which]
                        elif kind == OF_MASS:
                            band = 0 if plain else int(laws[BAND, row])
                            drag = own_bands[c, band, FORWARDS if v[row] >= 0.0 else BACKWARDS]
                            drag += own_mass[c, VISCOUS_DRIFT] * at_middle
                            holds = own_bands[c, band, COULOMB] + own_mass[c, COULOMB_DRIFT] * at_middle
                            if own_mass[c, PER_TORQUE] != 0.0:
                                holds += own_mass[c, PER_TORQUE] * _carried(bodies, laws, q, v, row)
                            inert = own_mass[c, INERTIA] * a[row] + own_mass[c, OFFSET]
                            other[row, c] -= inert + drag * v[row] + sliding[row] * holds
                        else:
                            r = rotors[row]
                            if plain:
                                torque = own_pieces[c, 0, STIFFNESS] * (q[r] - q[row])
                                torque += own_pieces[c, 0, DAMPING] * (v[r] - v[row])
                            else:
                                torque = _by_spring(bodies, laws, seeds, q, v, row, c)
                            other[r, c] -= torque
                            other[row, c] += passed[row] * torque
                    # The rotors of flexible joints are eliminated: each is tied to its link alone.
                    half = 0.5 * h
                    for i in range(n):
                        M[i, i] += masses[i, INERTIA] if rotors[i] == i else 0.0
                        Cv[i, i] += viscous[i]
                        K[i, i] += winds[i]
                        pull[i], alone[i], tie[i] = 0.0, 1.0, 0.0
                        if rotors[i] != i:
                            K[i, i] += passed[i] * stiff[i]
                            Cv[i, i] += passed[i] * damped[i]
                    for i in range(n):
                        for c in range(count):
                            rows[i, c] = other[i, c]
                        for j in range(n):
                            left[i, j] = 2.0 / h * M[i, j] + Cv[i, j] + half * K[i, j]
                            inert, pulls = 2.0 / h * M[i, j], K[i, j]
                            if inert == 0.0 and pulls == 0.0:  # as of two arms on one base
                                continue
                            for c in range(count):
                                rows[i, c] += inert * dv[j, c] - pulls * dq[j, c]
                        r = rotors[i]
                        if r == i:
                            continue
                        stiffness, damping = stiff[i], damped[i]
                        tie[i] = damping + half * stiffness
                        alone[i] = 2.0 / h * masses[r, INERTIA] + viscous[r] + tie[i] + half * winds[r]
                        inert = 2.0 / h * masses[r, INERTIA]
                        resting = rests[r] and directions[piece, r] == 0.0
                        pull[i] = 0.0 if resting else tie[i] / alone[i]
                        for c in range(count):
                            rows[i, c] += passed[i] * stiffness * dq[r, c]
                            other[r, c] += inert * dv[r, c] - stiffness * (dq[r, c] - dq[i, c]) - winds[r] * dq[r, c]
                            rows[i, c] += passed[i] * pull[i] * other[r, c]
                        left[i, i] -= passed[i] * pull[i] * tie[i]
                    for i in range(n):
                        if rests[i] and directions[piece, i] == 0.0:
                            for j in range(n):
                                left[i, j] = 1.0 if i == j else 0.0
                            for c in range(count):
                                rows[i, c] = 0.0
                    _solve(left, rows)
                    for i in range(n):
                        r = rotors[i]
                        if r != i:
                            moves = 0.0 if rests[r] and directions[piece, r] == 0.0 else 1.0
                            for c in range(count):
                                x = moves * (other[r, c] + tie[i] * rows[i, c]) / alone[i]
                                dq[r, c] += h * x
                                dv[r, c] = 2.0 * x - dv[r, c]
                        for c in range(count):
                            dq[i, c] += h * rows[i, c]
                            dv[i, c] = 2.0 * rows[i, c] - dv[i, c]
                    for i in range(nd):
                        if rests[i] and directions[piece, i] == 0.0:
                            for c in range(count):
                                dv[i, c] = 0.0
                    for i in range(n if prescribed else 0):
                        for c in range(count):
                            gained[i, c] += 2.0 * (dv[i, c] - rows[i, c])
                time += h
                event = stopped[piece]
                largest, slowing = 0.0, 0.0
                for i in range(nd if event >= 0 else 0):
                    largest = max(largest, abs(ended[piece, i]))
                if 0 <= event < nd and directions[piece, event] != 0.0:
                    slowing = ended[piece, event]
                    for c in range(count):
                        turned[c] = dv[event, c]
                    if abs(slowing) <= _TURNING * largest:
                        slowing = 0.0
                elif 3 * nd <= event < 3 * nd + 2 * n:  # the damper may act on one side of the edge only
                    slowing = _over_edge(bodies, tape, seeds, parameters, piece, event, dq, turned)
                if slowing != 0.0:
                    for c in range(count):
                        turned[c] /= slowing
                    for i in range(nd):
                        jump = started[piece + 1, i] - ended[piece, i]
                        for c in range(count):
                            dv[i, c] += jump * turned[c]
                            if prescribed and i < n:
                                gained[i, c] += jump * turned[c]
                if not plain:
                    _turn(bodies, tape, seeds, parameters, piece, dq, wound, since, stretched, stretch_since)
                if prescribed:
                    _add_moved_links(rotors, stiff, damped, M, Cv, K, h, whole, dq, rows, gained, moved_links[:, at])
