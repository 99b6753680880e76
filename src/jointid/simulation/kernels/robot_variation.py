"""How the torques of a robot's run change with its parameters, by variation along the run's tape, compiled.

Along each step the deviations of all masses obey the linearised equations of `kernels.engine`::

    M da + C dv + K dq = G + B dtau

with M, C and K the derivatives of the links' inverse dynamics by acceleration, velocity and position, of springs and
viscous friction, and G the derivative of the equations by the parameters, negative: the regressor's columns for the
numbers of a link, and the factors of `kernels.variation` for those of a law. They are taken at the mean of a step, and
integrated by the implicit midpoint rule, of order 2. A mass at rest stays there. An event moves in time with the
velocity that it takes to zero, so there velocities jump (M. A. Aizerman and F. R. Gantmacher: On the stability of
periodic motions, Journal of Applied Mathematics and Mechanics 22, 1958)::

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
from jointid.simulation.kernels.drive import Feedback, IntArray, SampledLoop
from jointid.simulation.kernels.engine import (
    BEGIN,
    EVENT,
    INERTIA,
    LENGTH,
    MASS,
    PART,
    SLIDING,
    SPRING,
    STATE,
    WINDING,
    IndexArray,
    Plant,
)
from jointid.simulation.kernels.variation import (
    DAMP,
    DRAG,
    FACTORS,
    GAINS,
    HALF,
    LEFT,
    PULL,
    STIFF,
    TAKES,
    TURNS,
    WINDS,
    fill_factors,
    mean_motion,
)

OF_LINK, OF_MASS, OF_SPRING = range(3)
"""What a parameter is a number of: row of the inertials, the masses or the springs of a plant."""
OF_DELAY = 5
"""How much later than its law puts it out a joint's torque acts."""
OF_PUSH = 6
"""No number, but a torque that is added to a controller's output: its joint, and its row of the pushes."""


class Seeds(NamedTuple):
    """Derivatives of the numbers of a plant in the row that a parameter is of; 0 of a link's.

    Attributes:
        masses: (parameters, bands, MASS). springs: (parameters, pieces, SPRING).
        pushes: (pushes, clock) torques that are added to controllers' outputs.
    """

    masses: FloatArray
    springs: FloatArray
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
    laws: Feedback, j: int, phase: int, cut: FloatArray, moved: FloatArray, dz: FloatArray, fresh: FloatArray,
    raw: FloatArray, command: FloatArray,
) -> None:  # fmt: skip
    """Fill the change of a controller's output, and move the changes of its states."""
    A, Bq, F, C, D, E = laws.A[j], laws.Bq[j], laws.F[j], laws.C[j], laws.D[j], laws.E[j]
    output, elements, states, count = laws.output[j], cut.size, len(dz), moved.size
    for e in range(elements):
        for c in range(count):
            raw[e, c] = D[phase, e] * moved[c]
        for s in range(states):
            weight = C[phase, e, s]
            if weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * dz[s, c]
        for other in range(e):
            if cut[other] != 0.0 and E[phase, e, other] != 0.0:
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
            if cut[e] != 0.0 and F[phase, s, e] != 0.0:
                for c in range(count):
                    fresh[s, c] -= F[phase, s, e] * raw[e, c]
    for s in range(states):
        for c in range(count):
            dz[s, c] = fresh[s, c]
    for c in range(count):
        command[c] = 0.0 if cut[output] != 0.0 else raw[output, c]


@compile_kernel
def _shift_edges(
    masses: FloatArray, rotors: IndexArray, parameters: IntArray, tape: FloatArray, last: int, row: int,
    jumps: NDArray[np.bool_], M: FloatArray, left: FloatArray, kicks: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Add to the velocities what later edges of the torques, as a step begins, take from them.

    An edge of one motor's torque is all that changes in the equation of the mass that it drives, which may come loose.
    It lies between the last step before and the first that lasts.
    """
    n, nd, d = len(M), len(masses), 0
    after, before, modes = STATE + 2 * nd, STATE + 3 * nd, STATE + 4 * nd
    for i in range(n):
        held = tape[row, modes + i] == 0.0
        for j in range(n):
            left[i, j] = M[i, j] if not held else 0.0
        left[i, i] += 1.0 if held else masses[i, 0, INERTIA]
    for c in range(len(parameters)):
        if parameters[c, 0] != OF_DELAY:
            continue
        j, r = parameters[c, 1], rotors[parameters[c, 1]]
        for i in range(n):
            kicks[i, d] = 0.0
        if jumps[j] and r != j:
            dv[r, c] -= tape[row, after + r] - tape[last, before + r]
        elif jumps[j] and tape[row, modes + r] != 0.0:
            for i in range(n):
                kicks[j, d] -= left[j, i] * (tape[row, after + i] - tape[last, before + i])
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
    rotors: IndexArray, f: FloatArray, ties: IntArray, M: FloatArray, Cv: FloatArray, K: FloatArray, h: float,
    whole: float, dq: FloatArray, rate: FloatArray, gained: FloatArray, moved_links: FloatArray,
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
            damping = share * (Cv[i, j] if ties[i] < 0 else -f[DAMP, ties[i]])
            stiffness = share * (K[i, j] if ties[i] < 0 else -f[PULL, ties[i]])
            for c in range(count):
                middle = dq[j, c] - 0.5 * h * rate[j, c]
                moved_links[i, c] += inert * gained[j, c] + damping * rate[j, c] + stiffness * middle


@inline_kernel
def _lead_to_event(
    tape: FloatArray, row: int, nd: int, pairs: IndexArray, dsprings: FloatArray, parameters: IntArray,
    dq: FloatArray, dv: FloatArray, turned: FloatArray,
) -> bool:  # fmt: skip
    """Fill by how much the event that ended a step comes earlier, s; False of one whose time is the same."""
    event, every, before, modes = int(tape[row, EVENT]), nd + pairs.shape[0], STATE + 3 * nd, STATE + 4 * nd
    moves = False
    if event < nd and tape[row, modes + event] != 0.0:
        largest = 0.0
        for i in range(nd):
            largest = max(largest, abs(tape[row, before + i]))
        moves = abs(tape[row, before + event]) > _TURNING * largest
        for c in range(turned.size if moves else 0):
            turned[c] = dv[event, c] / tape[row, before + event]
    elif event >= every + nd:  # the damper may act on one side of the edge only
        s, at, then = event - every - nd, modes + event, row + 1
        one, two = pairs[s, 0], pairs[s, 1]
        rate = tape[then, STATE + nd + two] - tape[then, STATE + nd + one]
        moves = rate != 0.0
        old, new = tape[row, at], tape[then, at]
        edge, side = int(max(abs(old), abs(new))), math.copysign(1.0, old + new)
        for c in range(turned.size if moves else 0):
            own = dsprings[c, edge, BEGIN] if parameters[c, 0] == OF_SPRING and parameters[c, 1] == s else 0.0
            turned[c] = (dq[two, c] - dq[one, c] - side * own) / rate
    return moves


@compile_kernel
def differentiate_run(
    tree: Tree, inertials: FloatArray, plant: Plant, loop: SampledLoop, torques_before: FloatArray,
    torques: FloatArray, excess: FloatArray, tape: FloatArray, parameters: IntArray, seeds: Seeds, moved: Moved,
    command: FloatArray, moved_links: FloatArray,
) -> None:  # fmt: skip
    """Fill the derivatives of the torques, step of the clock by step.

    Args:
        tree: of `kernels.engine.run`, as the run had it.
        inertials: the same.
        plant: the same.
        loop: the same.
        torques_before: the same.
        torques: (n, clock) what it wrote.
        excess: the same.
        tape: the same, its filled rows.
        parameters: (parameters, 3) what each is a number of, in which row and column.
        seeds: how the numbers of that row depend on it.
        moved: derivatives at the beginning, overwritten.
        command: (n, clock, parameters) out; or (n, clock, 0) of motors that are moved, whatever it takes.
        moved_links: (n, parts of all steps, parameters) out, mean over each: what the links' change of motion adds to
            the torque that a prescribed motion takes of a motor; or (n, 0, 0).
    """
    masses, springs, _, pairs, rotors, carriers = plant
    lags, every, post, lengths, laws = loop.lags, loop.every, loop.post, loop.lengths, loop.feedback
    dq, dv, dz, before, joints = moved.dq, moved.dv, moved.dz, moved.before, tree.joints
    n, nd, ns, count = len(inertials), len(dq), len(pairs), len(parameters)
    parts, steps, rows_of_tape = lags.shape[1], command.shape[1], tape.shape[0]
    modes, bands = STATE + 4 * nd, STATE + 5 * nd + ns
    # Of the links the changes of rates in the middle of a step; of all masses what is given.
    dtau, rows, other, rates = np.zeros((n, count)), np.zeros((n, count)), np.zeros((nd, count)), np.zeros((nd, count))
    dw, gained, turned = np.zeros((nd + ns, count)), np.zeros((n, count)), np.zeros(count)
    controlled, prescribed, coupled = command.shape[2] > 0, moved_links.shape[1] > 0, joints.shape[0] > 0
    fresh, raw = np.zeros((dz.shape[1], count)), np.zeros((excess.shape[2], count))
    mean, drive, room, Y = np.zeros((4, nd)), np.zeros(nd), np.empty((n, ROOM)), np.zeros((n, 10 * n))
    q, v, a = mean[0], mean[1], mean[2]
    place, speed, turn, of_links = q[:n], v[:n], a[:n], np.zeros(Y.shape if coupled else (0, 0))
    M, K, Cv, left = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    f, k_mass, later = np.zeros((FACTORS, nd + ns)), np.zeros((nd, MASS)), np.zeros((nd, MASS))
    k_spring, slater = np.zeros((ns, SPRING)), np.zeros((ns, SPRING))
    pull, alone, tie, ties = np.zeros(n), np.ones(n), np.zeros(n), np.full(n, -1)
    for s in range(ns):
        ties[pairs[s, 0]] = nd + s
    period, linked, delays, row = np.sum(lengths), False, 0, 1
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
            assign(turned, dq[rotors[j]])
            _control(laws, j, own % laws.A.shape[1], excess[j, own], turned, dz[j], fresh, raw, command[j, k])
            for c in range(count):
                if parameters[c, 0] == OF_PUSH and parameters[c, 1] == j:
                    command[j, k, c] += seeds.pushes[parameters[c, 2], k]
        time = k * period
        for part in range(parts):
            at = k * parts + part
            if row + 1 >= rows_of_tape:
                return
            for j in range(n):
                source = k - lags[j, part]
                jumps[j] = source != (k - lags[j, part - 1] if part > 0 else k - 1 - lags[j, parts - 1])
                drive[rotors[j]] = torques[j, source] + post[j, source] if source >= 0 else torques_before[j]
                for c in range(count if controlled else 0):
                    dtau[j, c] = command[j, source, c] if source >= 0 else before[j, c]
            last, edge = row - 1, delays > 0 and row > 1
            while tape[row, PART] == at:
                if row + 1 >= rows_of_tape:
                    return
                h = tape[row, LENGTH]
                for i in range(n if prescribed else 0):
                    for c in range(count):
                        gained[i, c] = 0.0
                if h > 0.0:
                    mean_motion(tape, row, nd, mean)
                    linearised_equations(tree, inertials, place, speed, turn, room, M, K, Cv)
                    if edge:
                        _shift_edges(masses, rotors, parameters, tape, last, row, jumps, M, left, kicks, dv)
                        edge = False
                    if linked and coupled:
                        regressor(
                            tree, of_joints(joints, place), of_joints(joints, speed), of_joints(joints, turn), of_links
                        )
                        for c in range(10 * n):
                            assign(Y[:, c], of_joints(joints.T, of_links[:, c]))
                    elif linked:
                        regressor(tree, place, speed, turn, Y)
                    fill_factors(
                        masses, springs, pairs, carriers, tape, row, mean, drive, time + 0.5 * h, nd, f, k_mass, later,
                        k_spring, slater,
                    )  # fmt: skip
                    # What is given: the motors' torques, what is wound up, and what the parameters change in the laws.
                    for i in range(nd):
                        half, winds = f[HALF, i], f[STIFF, i]
                        for c in range(count):
                            other[i, c] = half * dw[i, c] - winds * dq[i, c]
                    for j in range(n):
                        r = rotors[j]
                        for c in range(count):
                            other[r, c] += (2.0 - f[TAKES, r]) * dtau[j, c]
                    for s in range(ns):
                        one, two, half, winds = pairs[s, 0], pairs[s, 1], f[HALF, nd + s], f[WINDS, nd + s]
                        if half != 0.0 or winds != 0.0:
                            for c in range(count):
                                torque = half * dw[nd + s, c] - winds * (dq[two, c] - dq[one, c])
                                other[two, c] -= torque
                                other[one, c] += (2.0 - f[TAKES, one]) * torque
                    for c in range(count):
                        kind, of, which = parameters[c, 0], parameters[c, 1], parameters[c, 2]
                        if kind == OF_LINK:
                            for i in range(n):
                                other[i, c] -= Y[i, 10 * of + which]
                        elif kind == OF_MASS:
                            band = int(tape[row, bands + of])
                            for number in range(MASS):
                                other[of, c] += k_mass[of, number] * seeds.masses[c, band, number]
                        elif kind == OF_SPRING:
                            one, two, torque = pairs[of, 0], pairs[of, 1], 0.0
                            now = int(abs(tape[row, bands + nd + of]))
                            for number in range(BEGIN):
                                torque += k_spring[of, number] * seeds.springs[c, now, number]
                            other[two, c] -= torque
                            other[one, c] += (2.0 - f[TAKES, one]) * torque
                    # The rotors of flexible joints are eliminated: each is tied to its link alone.
                    half = 0.5 * h
                    for i in range(n):
                        M[i, i] += masses[i, 0, INERTIA]
                        Cv[i, i] += f[DRAG, i]
                        K[i, i] -= f[STIFF, i]
                        pull[i], alone[i], tie[i] = 0.0, 1.0, 0.0
                        if ties[i] >= 0:
                            K[i, i] += (2.0 - f[TAKES, i]) * f[PULL, ties[i]]
                            Cv[i, i] += (2.0 - f[TAKES, i]) * f[DAMP, ties[i]]
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
                        if ties[i] < 0:
                            continue
                        r, stiffness, passed = rotors[i], f[PULL, ties[i]], 2.0 - f[TAKES, i]
                        tie[i] = f[DAMP, ties[i]] + half * stiffness
                        alone[i] = 2.0 / h * masses[r, 0, INERTIA] + f[DRAG, r] + tie[i] - half * f[STIFF, r]
                        inert, winds = 2.0 / h * masses[r, 0, INERTIA], f[STIFF, r]
                        pull[i] = 0.0 if tape[row, modes + r] == 0.0 else tie[i] / alone[i]
                        for c in range(count):
                            rows[i, c] += passed * stiffness * dq[r, c]
                            other[r, c] += inert * dv[r, c] - stiffness * (dq[r, c] - dq[i, c]) + winds * dq[r, c]
                            rows[i, c] += passed * pull[i] * other[r, c]
                        left[i, i] -= passed * pull[i] * tie[i]
                    for i in range(n):
                        if tape[row, modes + i] == 0.0:
                            for j in range(n):
                                left[i, j] = 1.0 if i == j else 0.0
                            for c in range(count):
                                rows[i, c] = 0.0
                    _solve(left, rows)
                    for i in range(n):
                        r, moves = rotors[i], 0.0 if tape[row, modes + rotors[i]] == 0.0 else 1.0
                        for c in range(count):
                            rates[i, c] = rows[i, c]
                            if r != i:
                                rates[r, c] = moves * (other[r, c] + tie[i] * rows[i, c]) / alone[i]
                    for i in range(nd):
                        moves = 0.0 if tape[row, modes + i] == 0.0 else 1.0
                        for c in range(count):
                            dq[i, c] += h * rates[i, c]
                            dv[i, c] = moves * (2.0 * rates[i, c] - dv[i, c])
                        if masses[i, 0, WINDING] > 0.0:
                            for c in range(count):
                                dw[i, c] = f[LEFT, i] * dw[i, c] + f[GAINS, i] * h * rates[i, c]
                                if parameters[c, 0] == OF_MASS and parameters[c, 1] == i:
                                    dw[i, c] += f[TURNS, i] * seeds.masses[c, 0, WINDING]
                    for s in range(ns):
                        one, two, x = pairs[s, 0], pairs[s, 1], nd + s
                        for c in range(count if springs[s, 0, SLIDING] > 0.0 else 0):
                            dw[x, c] = f[LEFT, x] * dw[x, c] + f[GAINS, x] * h * (rates[two, c] - rates[one, c])
                            if parameters[c, 0] == OF_SPRING and parameters[c, 1] == s:
                                dw[x, c] += f[TURNS, x] * seeds.springs[c, 0, SLIDING]
                    for i in range(n if prescribed else 0):
                        for c in range(count):
                            gained[i, c] += 2.0 * (dv[i, c] - rows[i, c])
                time += h
                if tape[row, EVENT] >= 0.0 and _lead_to_event(
                    tape, row, nd, pairs, seeds.springs, parameters, dq, dv, turned
                ):
                    for i in range(nd):
                        jump = tape[row + 1, STATE + 2 * nd + i] - tape[row, STATE + 3 * nd + i]
                        for c in range(count):
                            dv[i, c] += jump * turned[c]
                            if prescribed and i < n:
                                gained[i, c] += jump * turned[c]
                if prescribed:
                    _add_moved_links(rotors, f, ties, M, Cv, K, h, lengths[part], dq, rows, gained, moved_links[:, at])
                row += 1
