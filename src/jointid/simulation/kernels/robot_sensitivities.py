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
from jointid.common.compiled import assign, compiled, inlined
from jointid.models.robots.dynamics import regressor
from jointid.models.robots.equations import ROOM, linearised_equations, of_joints
from jointid.models.robots.robot import Tree
from jointid.simulation.kernels.drive import IntArray
from jointid.simulation.kernels.robot_loop import Bodies, Clock, Controllers, RobotTape

OF_LINK, OF_MASS, OF_SPRING = range(3)
"""What a parameter is a number of: row of the inertials, the masses or the springs."""


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


@compiled
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
            for c in range(rows.shape[1]):
                rows[i, c] -= factor * rows[k, c]


@inlined
def _control(
    laws: Controllers, j: int, phase: int, cut: NDArray[np.bool_], moved: FloatArray, dz: FloatArray,
    fresh: FloatArray, raw: FloatArray, command: FloatArray, tapped: FloatArray,
) -> None:  # fmt: skip
    """Fill the change of a controller's output and of the one behind its limit, and move the changes of its states."""
    A, Bq, F, C, D, E = laws.A[j], laws.Bq[j], laws.F[j], laws.C[j], laws.D[j], laws.E[j]
    output, tap = laws.outputs[j], laws.taps[j]
    elements, states, count = cut.size, len(dz), moved.size
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
        tapped[c] = 0.0 if cut[tap] else raw[tap, c]


@inlined
def _rests(masses: FloatArray, i: int) -> bool:
    """Return True of a mass that may rest."""
    return bool(masses[i, 2] + masses[i, 6] > 0.0)


@inlined
def _share(masses: FloatArray, i: int, v: float) -> float:
    """Return the share of its rise that a friction has at a speed."""
    return math.exp(-((v / masses[i, 7]) ** 2)) if masses[i, 7] > 0.0 else 0.0


@inlined
def _steepness(masses: FloatArray, i: int, v: float) -> float:
    """Return how a friction that rises towards standstill changes with the velocity; negative, of no other."""
    if not masses[i, 6] > 0.0:
        return 0.0
    return float(-2.0 * abs(v) / masses[i, 7] ** 2 * masses[i, 6] * _share(masses, i, v))


@compiled
def _add_moved_links(
    rotors: IntArray, springs: FloatArray, M: FloatArray, Cv: FloatArray, K: FloatArray, h: float, whole: float,
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
            damping = share * (Cv[i, j] if rotors[i] == i else -springs[i, 1])
            stiffness = share * (K[i, j] if rotors[i] == i else -springs[i, 0])
            for c in range(count):
                middle = dq[j, c] - 0.5 * h * rate[j, c]
                moved_links[i, c] += inert * gained[j, c] + damping * rate[j, c] + stiffness * middle


@compiled
def differentiate_run(
    tree: Tree, bodies: Bodies, clock: Clock, laws: Controllers, cuts: NDArray[np.bool_], tape: RobotTape,
    parameters: IntArray, moved: Moved, command: FloatArray, tapped: FloatArray, moved_links: FloatArray,
) -> None:  # fmt: skip
    """Fill the derivatives of the torques, step of the clock by step.

    Args:
        tree: of `kernels.robot_loop.run`, as the run had it.
        bodies: the same.
        clock: the same.
        laws: the same.
        cuts: what it wrote.
        tape: the same.
        parameters: (parameters, 3) what each is a number of, in which row and column.
        moved: derivatives at the beginning, overwritten.
        command: (n, clock, parameters) out; or (n, clock, 0) of motors that are moved, whatever it takes.
        tapped: the same as command, or (n, 0, 0) where it is the same.
        moved_links: (n, parts of all steps, parameters) out, mean over each: what the links' change of motion adds to
            the torque that a prescribed motion takes of a motor; or (n, 0, 0).
    """
    rotors, masses, springs, joints = bodies.rotors, bodies.masses, bodies.springs, tree.joints
    lags, every, dq, dv, dz = clock.lags, clock.every, moved.dq, moved.dv, moved.dz
    before = moved.before
    first, lasting, places, speeds = tape.first, tape.lasting, tape.places, tape.speeds
    begun, ended, directions, stopped = tape.begun, tape.ended, tape.directions, tape.stopped
    n, nd, count = rotors.size, len(dq), len(parameters)
    parts, steps, pieces = lags.shape[1], command.shape[1], lasting.size
    dtau, rows, other = np.zeros((n, count)), np.zeros((n, count)), np.zeros((nd, count))
    controlled, prescribed, gained = command.shape[2] > 0, moved_links.shape[1] > 0, np.zeros((n, count))
    turned, fresh, raw = np.zeros(count), np.zeros((dz.shape[1], count)), np.zeros((cuts.shape[2], count))
    nothing = np.zeros(count)
    q, v, a = np.zeros(nd), np.zeros(nd), np.zeros(nd)
    place, speed, turn, room, coupled = q[:n], v[:n], a[:n], np.empty((n, ROOM)), joints.shape[0] > 0  # of the links
    M, K, Cv, left, Y = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, 10 * n))
    of_links = np.zeros(Y.shape if coupled else (0, 0))
    pull, alone, tie = np.zeros(n), np.zeros(n), np.zeros(n)
    linked = False
    for c in range(count):
        linked = linked or parameters[c, 0] == OF_LINK
    for k in range(steps):
        for j in range(n):
            own = k // every[j]
            if not controlled:
                break
            if k % every[j] != 0:  # this controller holds
                command[j, k] = command[j, k - 1]
                if tapped.shape[1] > 0:
                    tapped[j, k] = tapped[j, k - 1]
                continue
            for c in range(count):
                turned[c] = dq[rotors[j], c]
            _control(
                laws, j, own % laws.A.shape[1], cuts[j, own], turned, dz[j], fresh, raw, command[j, k],
                tapped[j, k] if tapped.shape[1] > 0 else nothing,
            )  # fmt: skip
        for part in range(parts):
            at = k * parts + part
            if at >= first.size:
                return
            end = first[at + 1] if at + 1 < first.size else pieces
            for j in range(n):
                source = k - lags[j, part]
                for c in range(count if controlled else 0):
                    dtau[j, c] = command[j, source, c] if source >= 0 else before[j, c]
            whole = np.sum(lasting[first[at] : end])
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
                        v[i] = 0.5 * (v0 + v1) + 0.125 * h * (begun[piece, i] - ended[piece, i])
                        a[i] = 0.5 * (begun[piece, i] + ended[piece, i])
                    linearised_equations(tree, bodies.inertials, place, speed, turn, room, M, K, Cv)
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
                    for c in range(count):
                        kind, row, which = parameters[c, 0], parameters[c, 1], parameters[c, 2]
                        if kind == OF_LINK:
                            for i in range(n):
                                other[i, c] -= Y[i, 10 * row + which]
                        elif kind == OF_MASS:
                            if which == 0:
                                other[row, c] -= a[row]
                            elif which == 1 or which == (4 if v[row] >= 0.0 else 5):
                                other[row, c] -= v[row]
                            elif which == 2 or which == 6:
                                sliding = directions[piece, row] if _rests(masses, row) else np.sign(v[row])
                                other[row, c] -= sliding * (_share(masses, row, v[row]) if which == 6 else 1.0)
                            elif which == 3:
                                other[row, c] -= 1.0
                        else:
                            r = rotors[row]
                            stretch = v[r] - v[row] if which == 1 else q[r] - q[row]
                            other[r, c] -= stretch
                            other[row, c] += stretch
                    # The rotors of flexible joints are eliminated: each is tied to its link alone.
                    half = 0.5 * h
                    for i in range(n):
                        M[i, i] += masses[i, 0] if rotors[i] == i else 0.0
                        Cv[i, i] += masses[i, 1] + masses[i, 4 if v[i] >= 0.0 else 5] + _steepness(masses, i, v[i])
                        pull[i], alone[i], tie[i] = 0.0, 1.0, 0.0
                        if rotors[i] != i:
                            K[i, i] += springs[i, 0]
                            Cv[i, i] += springs[i, 1]
                    for i in range(n):
                        for c in range(count):
                            rows[i, c] = other[i, c]
                        for j in range(n):
                            left[i, j] = 2.0 / h * M[i, j] + Cv[i, j] + half * K[i, j]
                            inert, stiff = 2.0 / h * M[i, j], K[i, j]
                            for c in range(count):
                                rows[i, c] += inert * dv[j, c] - stiff * dq[j, c]
                        r = rotors[i]
                        if r == i:
                            continue
                        stiffness, damping = springs[i, 0], springs[i, 1]
                        tie[i] = damping + half * stiffness
                        alone[i] = 2.0 / h * masses[r, 0] + masses[r, 1] + masses[r, 4 if v[r] >= 0.0 else 5] + tie[i]
                        alone[i] += _steepness(masses, r, v[r])
                        inert = 2.0 / h * masses[r, 0]
                        resting = _rests(masses, r) and directions[piece, r] == 0.0
                        pull[i] = 0.0 if resting else tie[i] / alone[i]
                        for c in range(count):
                            rows[i, c] += stiffness * dq[r, c]
                            other[r, c] += inert * dv[r, c] - stiffness * (dq[r, c] - dq[i, c])
                            rows[i, c] += pull[i] * other[r, c]
                        left[i, i] -= pull[i] * tie[i]
                    for i in range(n):
                        if _rests(masses, i) and directions[piece, i] == 0.0:
                            for j in range(n):
                                left[i, j] = 1.0 if i == j else 0.0
                            for c in range(count):
                                rows[i, c] = 0.0
                    _solve(left, rows)
                    for i in range(n):
                        r = rotors[i]
                        if r != i:
                            for c in range(count):
                                x = 0.0
                                if pull[i] != 0.0:
                                    x = (other[r, c] + tie[i] * rows[i, c]) / alone[i]
                                dq[r, c] += h * x
                                dv[r, c] = 2.0 * x - dv[r, c]
                        for c in range(count):
                            dq[i, c] += h * rows[i, c]
                            dv[i, c] = 2.0 * rows[i, c] - dv[i, c]
                    for i in range(nd):
                        if _rests(masses, i) and directions[piece, i] == 0.0:
                            for c in range(count):
                                dv[i, c] = 0.0
                    for i in range(n if prescribed else 0):
                        for c in range(count):
                            gained[i, c] += 2.0 * (dv[i, c] - rows[i, c])
                event = stopped[piece]
                if event >= 0 and directions[piece, event] != 0.0:
                    largest = 0.0
                    for i in range(nd):
                        largest = max(largest, abs(ended[piece, i]))
                    slowing = ended[piece, event]
                    if abs(slowing) > _TURNING * largest:
                        for c in range(count):
                            turned[c] = dv[event, c] / slowing
                        for i in range(nd):
                            jump = begun[piece + 1, i] - ended[piece, i]
                            for c in range(count):
                                dv[i, c] += jump * turned[c]
                                if prescribed and i < n:
                                    gained[i, c] += jump * turned[c]
                if prescribed:
                    _add_moved_links(rotors, springs, M, Cv, K, h, whole, dq, rows, gained, moved_links[:, at])
