"""The derivatives of a simulation by its parameters, along the steps of `kernels.engine`, compiled.

The run has left a tape of its steps. Along each the deviations of all masses obey linear equations::

    M da + C dv + K dq = G

with M, C and K the derivatives of the equations of motion by acceleration, velocity and position, and G, negative, by
the parameters and by the motors' torques. They are taken at both ends of the step, about its mean motion, and followed
by the implicit midpoint rule; of a joint, and where motors are moved, by three composed to order 4 (H. Yoshida:
Construction of higher order symplectic integrators, Physics Letters A 150, 1990). What winds up has the derivatives of
its steps, by complex numbers. A mass at rest stays there. An event moves in time with what it takes to zero, so
velocities jump (M. A. Aizerman and F. R. Gantmacher: On the stability of periodic motions, Journal of Applied
Mathematics and Mechanics 22, 1958)::

    dv+ = dv- + (a+ - a-) dv_i- / a_i-

A delay moves the edges of a torque, and each kicks the velocities by the difference of the accelerations. Controllers
are linear between limits, and where one acts its element follows the limit.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.robots.dynamics import regressor
from jointid.models.robots.equations import ROOM, linearised_equations, to_shafts
from jointid.models.robots.robot import Tree
from jointid.simulation import kernels
from jointid.simulation.kernels import FREE, STATE, IndexArray, IntArray, Path, Plant, SampledLoop, Seeds, affine, laws
from jointid.simulation.kernels.affine import indices, table, vector
from jointid.simulation.kernels.control import NOTHING, OFTEN, control_slopes, small_law
from jointid.simulation.kernels.engine import factorise, solve, tied

# Factors of a step: of each mass whether it moves, its drag and stiffness, how much of the torque that it carries it
# takes; of springs stiffness and damping; of both the force of what winds up, whole, first and last, its stiffness, how
# its derivative enters the force, and that of its end by the law's numbers, by what was wound up, and by the way gone.
_GOES, _DRAG, _STIFF, _TAKES, _PULL, _DAMP, _FIRST, _LAST, _WINDS, _ENTERS, _TURNS = range(11)
_WOUND, _GONE = kernels.MASS, kernels.MASS + 1  # further numbers of a law that winds up
_PLACE, _SPEED, _CHANGE = range(3)  # rows of the motion
_WHOLE, _COMPOSED = np.ones(1), np.array([1.0, -(2.0 ** (1 / 3)), 1.0]) / (2.0 - 2.0 ** (1 / 3))  # parts of a step
_SMALL = 1e-30j  # of a complex step: its square is nothing beside any value
_TURNING = 1e-9  # of the largest acceleration: a velocity that comes to 0 with less of its own hardly turns


@inline_kernel
def _mean_motion(tape: FloatArray, row: int, nd: int, mean: FloatArray, change: FloatArray) -> None:
    """Fill the means of positions, velocities and accelerations over a step, and by how much they change in it."""
    h, then = tape[row, kernels.LENGTH], row + 1
    for i in range(nd):
        q, v, a = tape[row, STATE + i], tape[row, STATE + nd + i], tape[row, STATE + 2 * nd + i]
        q1, v1, a1 = tape[then, STATE + i], tape[then, STATE + nd + i], tape[row, STATE + 3 * nd + i]
        change[_PLACE, i], change[_SPEED, i], change[_CHANGE, i] = q1 - q, v1 - v, a1 - a
        mean[_PLACE, i] = 0.5 * (q + q1) - h / 12.0 * (v1 - v)
        mean[_SPEED, i], mean[_CHANGE, i] = (q1 - q) / h, (v1 - v) / h


@inline_kernel
def _stretch(d: FloatArray, tree: Tree | None, pairs: IndexArray, nd: int, x: int, c: int) -> float:
    """Return a derivative of a mass's place, or of a spring's deflection."""
    if x < nd:
        return float(d[x, c])
    one, two = tied(tree, pairs, x - nd)
    return float(d[two, c] - d[one, c])


@inline_kernel
def _fill_factors(
    masses: FloatArray, springs: FloatArray, places: FloatArray, tree: Tree | None, pairs: IndexArray,
    carriers: IntArray, tape: FloatArray, row: int, mean: FloatArray, change: FloatArray, drive: FloatArray,
    time: float, own: FloatArray, law: NDArray[Any] | None, torque: FloatArray, f: FloatArray, k: FloatArray,
) -> None:  # fmt: skip
    """Fill the factors of a step, a row of the tape, and the partials of the forces by their numbers at both ends.

    Partials have rows for masses, springs and places as the step begins, then as many as it ends. The scratch `law` is
    None where nothing winds up.
    """
    nd, ns, h, half = mean.shape[1], torque.size, tape[row, kernels.LENGTH], k.shape[0] // 2
    mass, spring = own[:nd], own[nd:]
    modes, at, wound = STATE + 4 * nd, STATE + 5 * nd + ns, STATE + 6 * nd + 2 * ns
    for i in range(nd):
        assign(mass[i], masses[i, int(tape[row, at + i])])
    for s in range(ns):
        laws.take_piece(springs, s, int(tape[row, at + nd + s]), spring)
    for values in (f, k):
        for i in range(values.shape[0]):
            for j in range(values.shape[1]):
                values[i, j] = 0.0
    for end in range(2):
        side = end - 0.5
        for s in range(ns):
            (one, two), x, to, piece = tied(tree, pairs, s), nd + s, end * half + nd + s, tape[row, at + nd + s]
            speed, way, begun = mean[_SPEED, two] - mean[_SPEED, one], tape[row, modes + nd + s], wound + nd + s
            w = tape[row, begun] if law is None else laws.wind(spring, s, way, speed, 0.5 * h, tape[row, begun])
            w += side * (tape[row + 1, begun] - tape[row, begun])
            e = mean[_PLACE, two] - mean[_PLACE, one] + side * (change[_PLACE, two] - change[_PLACE, one])
            de = speed + side * (change[_SPEED, two] - change[_SPEED, one])
            torque[s] = laws.spring_torque(spring, s, e, de, w)
            f[_PULL, x] += 0.5 * laws.spring_partials(spring, s, e, de, w, k, to)
            f[_DAMP, x] = spring[s, kernels.DAMPING]
            k[to, kernels.HELD] = 0.0 if piece == 0.0 else math.copysign(1.0, piece)
            f[_FIRST + end, x] = spring[s, kernels.SLIPS]
        for i in range(nd):
            mode, speed, to = tape[row, modes + i], mean[_SPEED, i], end * half + i
            way = math.copysign(1.0, speed) if mode == FREE else mode
            back, share, then = 1 if way < 0.0 else 0, way, time + end * h
            carried = torque[np.uint64(carriers[i])] if carriers[i] >= 0 else drive[i]
            grip, drag = laws.friction(mass, i, back, carried, then)
            k[to, kernels.INERTIA] = -mean[_CHANGE, i] - side * change[_CHANGE, i]
            if law is not None and mass[i, kernels.WINDING] > 0.0:
                f[_FIRST + end, i] = -grip
                share = laws.wind(mass, i, mode, speed, 0.5 * h, tape[row, wound + i])
                share += side * (tape[row + 1, wound + i] - tape[row, wound + i])
            speed += side * change[_SPEED, i]
            f[_GOES, i] = 1.0 if mode != 0.0 else 0.0
            f[_DRAG, i] += 0.5 * drag
            f[_TAKES, i] += 0.5 * (1.0 - laws.friction_partials(mass, i, back, share, speed, carried, then, k, to))
        for j in range(places.shape[0]):
            i, to = int(places[j, kernels.WHERE]), (end + 1) * half - places.shape[0] + j
            f[_STIFF, i] += 0.5 * laws.place_partials(places, j, mean[_PLACE, i] + side * change[_PLACE, i], k, to)
    if law is None:
        return
    for x in range(nd + ns):
        way, w = tape[row, modes + x], tape[row, wound + x]
        if f[_FIRST, x] == 0.0 or w == way:
            continue  # nothing winds up, or it is
        assign(law[0], own[x])
        law[0, _WOUND], law[0, _GONE] = w, h * _stretch(mean.T, tree, pairs, nd, x, _SPEED)
        for n in range(kernels.WINDING, _GONE + 1):  # by complex steps
            law[0, n] += _SMALL
            speed = law[0, _GONE] * (1.0 / h)
            middle = laws.wind(law, 0, way, speed, 0.5 * h, law[0, _WOUND]).imag / _SMALL.imag
            f[_TURNS + n, x] = laws.wind(law, 0, way, speed, h, law[0, _WOUND]).imag / _SMALL.imag
            law[0, n] -= _SMALL
            k[x, n], k[x + half, n] = k[x, n] + f[_FIRST, x] * middle, k[x + half, n] + f[_LAST, x] * middle
        f[_ENTERS, x], f[_WINDS, x] = 0.5 * (k[x, _WOUND] + k[x + half, _WOUND]), k[x, _GONE] + k[x + half, _GONE]
        f[_STIFF if x < nd else _PULL, x] += f[_WINDS, x]


@inline_kernel
def _add_seeds(
    seeds: Seeds, row: int, band: int, to: int, f: FloatArray, k: FloatArray, G: FloatArray, dw: FloatArray
) -> None:
    """Add what parameters change in a law: in the middle of the step, from its beginning to its end, and wound up."""
    then = row + k.shape[0] // 2
    for e in range(seeds.begin[row, band], seeds.begin[row, band + 1]):
        number, c, value = seeds.numbers[e], seeds.columns[e], seeds.values[e]
        G[0, to, c] += 0.5 * (k[row, number] + k[then, number]) * value
        G[1, to, c] += (k[then, number] - k[row, number]) * value
        if number >= kernels.WINDING:
            dw[to, c] += f[_TURNS + number, row] * value


@inline_kernel
def _flush(values: FloatArray) -> None:
    """Set what is next to nothing to 0."""
    for i in range(values.size):
        values[i] = values[i] if abs(values[i]) > NOTHING else 0.0


@inline_kernel
def _join(tree: Tree | None, pairs: IndexArray, f: FloatArray, K: FloatArray, C: FloatArray, G: FloatArray) -> None:
    """Add masses and springs to stiffness, damping and inputs; friction may carry a torque."""
    nd = len(K)
    for i in range(nd):
        K[i, i] -= f[_STIFF, i]
        C[i, i] += f[_DRAG, i]
    for s in range(f.shape[1] - nd):
        (one, two), pull, damp = tied(tree, pairs, s), f[_PULL, nd + s], f[_DAMP, nd + s]
        for to, weight in ((one, 1.0), (two, -f[_TAKES, two])):  # the far mass carries its torque
            K[to, one] += weight * pull
            K[to, two] -= weight * pull
            C[to, one] += weight * damp
            C[to, two] -= weight * damp
            for order in range(2):
                for c in range(G.shape[2]):
                    G[order, to, c] += weight * G[order, nd + s, c]


@inline_kernel
def _move(
    h: float, late: float, f: FloatArray, M: FloatArray, K: FloatArray, C: FloatArray, G: FloatArray,
    left: FloatArray, rows: FloatArray, dq: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives over a time by the implicit midpoint rule, its middle a share of the step after the step's.

    The mean velocities are found by elimination, the last mass
    first: the rotor of a robot is tied to its link alone.
    """
    nd, count = M.shape[0], dq.shape[1]
    for i in range(nd):
        goes = f[_GOES, i]
        for c in range(count):
            rows[i, c] = goes * (G[0, i, c] + late * G[1, i, c])
        for j in range(nd):
            inert, stiff = goes * f[_GOES, j] * 2.0 / h * M[i, j], goes * K[i, j]
            left[i, j] = inert + f[_GOES, j] * (goes * C[i, j] + 0.5 * h * stiff)
            for c in range(count if inert != 0.0 or stiff != 0.0 else 0):  # not as of two arms on one base
                rows[i, c] += inert * dv[j, c] - stiff * dq[j, c]
        left[i, i] += 1.0 - goes
    for k in range(nd - 1, -1, -1):
        for i in range(k):
            factor = left[i, k] / left[k, k]
            for j in range(k if factor != 0.0 else 0):
                left[i, j] -= factor * left[k, j]
            for c in range(count if factor != 0.0 else 0):
                rows[i, c] -= factor * rows[k, c]
    for k in range(nd):
        for i in range(k):
            factor = left[k, i]
            for c in range(count if factor != 0.0 else 0):
                rows[k, c] -= factor * rows[i, c]
        share = 1.0 / left[k, k]
        for c in range(count):
            rows[k, c] *= share
            dq[k, c] += h * rows[k, c]
            dv[k, c] = 2.0 * rows[k, c] - f[_GOES, k] * dv[k, c]  # one that was not let begin does not come back


@inline_kernel
def _shift_edges(
    rotors: IndexArray, delays: IntArray, tape: FloatArray, last: int, row: int, jumps: IntArray,
    f: FloatArray, M: FloatArray, left: FloatArray, push: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Add to the velocities what later edges of the torques, as a step begins, take from them.

    An edge of one motor's torque is all that changes in the equation of the mass that it drives, which may come loose.
    It lies between the last step before and the first that lasts.
    """
    nd = len(dv)
    after, before = STATE + 2 * nd, STATE + 3 * nd
    for d in range(len(delays)):
        c, j, r = delays[d, 0], delays[d, 1], rotors[delays[d, 1]]
        if not jumps[j] or f[_GOES, r] == 0.0:
            continue
        for i in range(nd):
            push[i] = 0.0
        for i in range(nd):
            push[r] += M[r, i] * (tape[row, after + i] - tape[last, before + i])
        factorise(M, tape[row, STATE + 4 * nd : STATE + 5 * nd], left)
        solve(left, push)
        for i in range(nd):
            dv[i, c] -= push[i]


@inline_kernel
def _pass_event(
    tape: FloatArray, row: int, nd: int, pairs: IndexArray, heavy: IndexArray, M: FloatArray, seeds: Seeds,
    dq: FloatArray, dv: FloatArray, lead: FloatArray, jump: FloatArray,
) -> None:  # fmt: skip
    """Change the velocities at the event that ended a step: by `lead`, s, it comes earlier.

    The jump of a heavy mass is lost in its rounding, and is what those that it carries make it.
    """
    event, every, after, before = int(tape[row, kernels.EVENT]), nd + len(pairs), STATE + 2 * nd, STATE + 3 * nd
    modes, then, moves, count = STATE + 4 * nd, row + 1, False, dq.shape[1]
    if event < nd and tape[row, modes + event] != 0.0:
        largest, slowing = 0.0, tape[row, before + event]
        for i in range(nd):
            largest = max(largest, abs(tape[row, before + i]))
        moves = abs(slowing) > _TURNING * largest
        for c in range(count if moves else 0):
            lead[c] = dv[event, c] / slowing
    elif event >= every + nd:  # the damper may act on one side of the edge only
        s, at = event - every - nd, modes + event
        one, two = pairs[s, 0], pairs[s, 1]
        rate = tape[then, STATE + nd + two] - tape[then, STATE + nd + one]
        moves = rate != 0.0
        old, new = tape[row, at], tape[then, at]
        edge, side = int(max(abs(old), abs(new))), math.copysign(1.0, old + new)
        for c in range(count if moves else 0):
            lead[c] = (dq[two, c] - dq[one, c]) / rate
        for e in range(seeds.begin[nd + s, edge], seeds.begin[nd + s, edge + 1] if moves else 0):
            if seeds.numbers[e] == kernels.BEGIN:
                lead[seeds.columns[e]] -= side * seeds.values[e] / rate
    for i in range(nd):
        jump[i] = tape[then, after + i] - tape[row, before + i]
    for r in heavy:
        jump[r] = 0.0
    for r in heavy:
        push = 0.0
        for i in range(nd):
            push += M[r, i] * jump[i]
        jump[r] = -push / M[r, r]
    for i in range(nd if moves else 0):
        for c in range(count):
            dv[i, c] += jump[i] * lead[c]


@partial(compile_kernel, _nrt=False)
def follow(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, joint: tuple[float, ...] | None,
    torques_before: FloatArray, torques: FloatArray, excess: FloatArray, tape: FloatArray, path: Path | None,
    wound: NDArray[Any] | None, seeds: Seeds, first_q: FloatArray, first_v: FloatArray, dz: FloatArray,
    explicit: FloatArray, columns: IntArray, dlimits: FloatArray, command: FloatArray, states: FloatArray,
    speeds: FloatArray,
) -> None:  # fmt: skip
    """Fill the derivatives of a finished run by n parameters; LANES of a joint of straight lines.

    Arguments of `kernels.engine.run` are as the run left them, `torques`, (axes, clock), what it wrote, the tape its
    filled rows. `wound`, (1, MASS + 2), is scratch for what winds up. Of a joint of straight lines it is None, and what
    needs it is not compiled. The seeds say how the plant's numbers depend on the parameters. Derivatives that are
    given: `first_q` and `first_v`, (masses, n), of the first positions and velocities; `dz`, (axes, states, n), of the
    controllers' states, overwritten; `dlimits`, (axes, elements, n); and `explicit`, (axes, periods, elements, some),
    of the controllers' elements, the motion and what limits take away held, by the parameters of some `columns`.

    Filled are `command`, (axes, clock, n), of the torques that act, or (axes, clock, 0) of motors that are moved;
    `states`, (parts of all steps, 4, n), of position and velocity of two masses as each begins, or (0, 4, n); and
    `speeds`, (axes, parts of all steps, n), of the velocities of motors that are moved, or (axes, 0, n).
    """
    affine.wide_vectors()
    masses, springs, places, pairs, rotors, carriers = plant
    lags, every, post, lengths = loop.lags, loop.every, loop.post, loop.lengths
    nd, ns = (len(masses), len(pairs)) if joint is None else (len(joint), len(joint) - 1)
    n, axes, count = len(inertials), len(torques), first_q.shape[1]
    parts, steps, elements, forces, last_row = lags.shape[1], torques.shape[1], excess.shape[2], nd + ns, len(tape) - 1
    controlled, heavy = command.shape[2] > 0, rotors[: rotors.size if speeds.shape[1] > 0 else 0]
    G, rows = table(2 * forces, count).reshape((2, forces, count)), table(nd, count)
    dq, dv, dw, acts = table(nd, count), table(nd, count), table(forces, count), indices(axes)
    lead, kicks = vector(count), vector(nd)
    fresh, raw, taken = table(dz.shape[1], count), table(elements, count), table(elements, count)
    mean, change, drive, numbers = table(3, nd), table(3, nd), vector(nd), table(forces, kernels.MASS + 1)
    torque, f = vector(ns), table(_TURNS + _GONE + 1, forces)
    k, room, Y = table(2 * (forces + len(places)), _GONE + 1), table(n, ROOM), table(n, 10 * n)
    M, K, C, left = table(nd, nd), table(nd, nd), table(nd, nd), table(nd, nd)
    turns = _WHOLE if controlled and tree is not None else _COMPOSED
    jumps, period = indices(axes), 0.0
    if path is not None:
        kept, modes, rates, moves, _, pushes = path
        filled, in_lanes = indices(rates.shape[0]), vector(affine.SCRATCH)
        small = dz.shape[1] <= 2 and loop.D.size == 1 and loop.driven.shape[1] == 0
        law = small_law(loop, dz.shape[1] if small else 0)
        plain = small and len(states) + len(seeds.delays) == 0
    for part in range(parts):
        period += lengths[part]
    for i in range(nd):
        assign(dq[i], first_q[i])
        assign(dv[i], first_v[i])
    row, step, at_band = 1, 0, STATE + 5 * nd + ns
    while step < steps:
        if step % OFTEN == 0:
            for values in (dq.reshape(-1), dv.reshape(-1), dz.reshape(-1)):
                _flush(values)
        if path is not None and plain:
            mode, taped = int(modes[step * parts]), row < last_row
            then = int(tape[row, kernels.PART]) // parts if taped else steps
            if filled[mode] and then != step and abs(torques[0, step]) < loop.limits[0, 0]:
                end = min(step - step % OFTEN + OFTEN, then)
                step = affine.glide_slopes(
                    in_lanes, law, moves, pushes, mode, step, end, lags[0], torques_before[0], kept, torques[0],
                    post[0], explicit[0], columns, dq, dv, dz[0], command[0],
                )  # fmt: skip
                continue
        for j in range(axes if controlled else 0):
            own = step // every[j]
            if step % every[j] != 0:  # this controller holds
                assign(command[j, step], command[j, step - 1])
                continue
            control_slopes(
                loop, j, own, step, excess, rotors[j], dq, dz, fresh, raw, taken, explicit, columns, dlimits, command
            )  # fmt: skip
        time = step * period
        for part in range(parts):
            at = step * parts + part
            for i in range(min(nd, 2) if len(states) > 0 else 0):
                assign(states[at, 2 * i], dq[i])
                assign(states[at, 2 * i + 1], dv[i])
            torque_before = drive[0]
            for j in range(heavy.size):
                assign(speeds[j, at], dv[heavy[j]])
            for j in range(axes):
                source = step - lags[j, part]
                jumps[j] = int(source != (step - lags[j, part - 1] if part > 0 else step - 1 - lags[j, parts - 1]))
                drive[rotors[j]] = torques[j, source] + post[j, source] if source >= 0 else torques_before[j]
                acts[j] = max(source, 0)
            last, edge = row - 1, len(seeds.delays) > 0 and at > 0
            if path is not None:
                stepped, mode, s = row < last_row and tape[row, kernels.PART] == at, int(modes[at]), drive[0]
                jump = (s - torque_before) * rates[mode, 0, 3]
                if kept[at, 1] == 0.0:  # an edge may tear it loose
                    jump = tape[row, STATE + 2 * nd] if stepped else 0.0
                for d in range(len(seeds.delays) if edge and s != torque_before else 0):
                    dv[0, seeds.delays[d, 0]] -= jump
                edge = False
                if not filled[mode]:
                    filled[mode] = 1
                    affine.fill_tangent(masses, springs, seeds, mode, lengths, rates, moves, pushes)
                if not stepped:
                    tangent = mode * parts + part
                    affine.cross_slopes(in_lanes, moves, pushes, tangent, kept, at, s, command[0, acts[0]], dq, dv)
            while row < last_row and tape[row, kernels.PART] == at:
                h = tape[row, kernels.LENGTH]
                if h > 0.0:
                    _mean_motion(tape, row, nd, mean, change)
                    for i in range(nd):
                        for j in range(nd):
                            M[i, j], K[i, j], C[i, j] = 0.0, 0.0, 0.0
                    if tree is not None:
                        place, speed, turn = mean[_PLACE, :n], mean[_SPEED, :n], mean[_CHANGE, :n]
                        linearised_equations(tree, inertials, place, speed, turn, room, M, K, C)
                    for i in range(nd):
                        M[i, i] += masses[i, 0, kernels.INERTIA]
                    _fill_factors(
                        masses, springs, places, tree, pairs, carriers, tape, row, mean, change, drive, time, numbers,
                        wound, torque, f, k,
                    )  # fmt: skip
                    if edge:
                        _shift_edges(rotors, seeds.delays, tape, last, row, jumps, f, M, left, kicks, dv)
                        edge = False
                    for i in range(forces):
                        for c in range(count):
                            G[0, i, c], G[1, i, c] = 0.0, 0.0
                        for c in range(count if f[_FIRST, i] != 0.0 else 0):
                            gone, w = _stretch(dq, tree, pairs, nd, i, c), dw[i, c]
                            G[0, i, c] = f[_ENTERS, i] * w - f[_WINDS, i] * gone
                            dw[i, c] = f[_TURNS + _WOUND, i] * w - f[_TURNS + _GONE, i] * gone
                        _add_seeds(seeds, i, int(abs(tape[row, at_band + i])), i, f, k, G, dw)
                    for i in range(len(places)):
                        _add_seeds(seeds, forces + i, 0, int(places[i, kernels.WHERE]), f, k, G, dw)
                    for j in range(axes if controlled else 0):
                        r = rotors[j]
                        for c in range(count):
                            G[0, r, c] += (2.0 - f[_TAKES, r]) * command[j, acts[j], c]
                    if tree is not None and len(seeds.links) > 0:
                        regressor(tree, room, Y)
                        to_shafts(tree.joints, Y.T, room)
                    for e in range(len(seeds.links)):
                        for i in range(n):
                            G[0, i, seeds.links[e, 0]] -= Y[i, 10 * seeds.links[e, 1] + seeds.links[e, 2]]
                    _join(tree, pairs, f, K, C, G)
                    share = -0.5
                    for i in range(turns.size):
                        _move(h * turns[i], share + 0.5 * turns[i], f, M, K, C, G, left, rows, dq, dv)
                        share += turns[i]
                    for i in range(forces):
                        for c in range(count if f[_FIRST, i] != 0.0 else 0):
                            dw[i, c] += f[_TURNS + _GONE, i] * _stretch(dq, tree, pairs, nd, i, c)
                time += h
                if tape[row, kernels.EVENT] >= 0.0:
                    _pass_event(tape, row, nd, pairs, heavy, M, seeds, dq, dv, lead, kicks)
                row += 1
        step += 1
