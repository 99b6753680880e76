"""The simulation of masses under any law of friction and spring, by a Runge-Kutta method, compiled.

The masses of a joint are its motor, its load, and of an elastic load the part that swings; those of a robot its links,
in a tree, then the rotors of its flexible joints. A spring ties two of them, and each motor drives one::

    M(q) a + h(q, v) = drive - offset - friction - places + springs

Without a tree M is a diagonal and h is 0. Of a rigid joint of a robot the rotor's inertia is on the diagonal of M; of a
flexible one the rotor is a mass that only its spring ties to the links (M. W. Spong: Modeling and control of elastic
joint robots, Journal of Dynamic Systems, Measurement, and Control 109, 1987). Where motors are coupled the position of
a link is that of the shaft that its motor turns, so that friction and springs are each one shaft's.

Between two events this is smooth, and integrated by a method of order 4 of E. J. Nyström's kind, whose two stages in
the middle of a step share one position (E. Hairer and others: Solving ordinary differential equations I, 1993, II.14).
A joint whose laws are lines in pieces has affine maps for whole parts of a period (`kernels.affine`). A step is a share
of the time in which the fastest part turns by one radian, so that a joint's torque is within some 1e-5 of its peak.

The events are a mass that stops, one that comes loose, a deflection that reverses where the spring has a slider, and
the edges of a friction's bands and of a spring's pieces. The integrator locates them itself, so they do not lower its
order. Masses that stand still are decided together: the accelerations minimise ``a' M a / 2 - f' a + sum Fc |a_i|``
over them, and least-index pivoting finds their modes (K. G. Murty: Note on a Bard-type scheme for solving the
complementarity problem, Opsearch 11, 1974), which ends for every positive definite M.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.robots.equations import ROOM, equations_of_motion
from jointid.models.robots.robot import Tree
from jointid.simulation import kernels
from jointid.simulation.kernels import FREE, STATE, IndexArray, IntArray, Path, Plant, SampledLoop, affine, laws
from jointid.simulation.kernels.affine import indices, table, vector
from jointid.simulation.kernels.control import control_any, small_law

REACH = 0.3  # rad: how far the fastest part of a joint's motion may turn in a step
_MANY = 1000.0  # rad of a part that show a drive that is too stiff
_WORK, _OF_LINES = 30.0, 4.0  # rad that a simulation may take, per part, beside maps: bounds an absurd candidate's time
_EVENTS = 1000  # per period; a physical drive has a handful
_HOLD = 1.0 + 1e-9  # of the Coulomb force: what holds a mass, so that one at its limit is not decided by rounding
_PIVOTS = 50  # per mass; a handful is usual, least-index pivoting ends anyway
_ROOT = 1e-12  # of a step: where an event is located to
_CLOSER = 80  # steps at most to locate it
_WOUND_UP = 1e-8  # of a limit: what is nearer to it than that is at it
_WINDS = 1e-4  # of a limit: where its winding up no longer shortens the steps
_STICKS = 30.0  # rad that a mass turns in a part on friction not wound up: above it cannot be told from Coulomb's


@inline_kernel
def tied(tree: Tree | None, pairs: IndexArray, s: int) -> Any:
    """Return the masses that a spring ties; of a joint neighbours."""
    return (np.uint64(s), np.uint64(s + 1)) if tree is None else (pairs[s, 0], pairs[s, 1])


@inline_kernel
def _read(x: FloatArray, i: float) -> float:
    """Return an element; i is compared as a number, so that the compiler does not take it for the index."""
    found, where = 0.0, float(i)
    for j in range(x.size):
        found = x[j] if j == where else found
    return found


@inline_kernel
def factorise(M: FloatArray, modes: FloatArray, left: FloatArray) -> bool:
    """Fill `left` with the factors of M, with the masses at rest held; False if that is not positive."""
    n = M.shape[0]
    for i in range(n):
        for j in range(i + 1):
            left[i, j] = M[i, j] if modes[i] != 0.0 and modes[j] != 0.0 else 0.0
        left[i, i] += 1.0 if modes[i] == 0.0 else 0.0
    for k in range(n):
        if not left[k, k] > 0.0:
            return False
        share = 1.0 / left[k, k]
        for i in range(k + 1, n):
            factor = left[i, k] * share
            for j in range(k + 1, i + 1):
                left[i, j] -= factor * left[j, k]
        left[k, k] = share
    return True


@inline_kernel
def solve(left: FloatArray, x: FloatArray) -> None:
    """Replace the forces on masses, 0 of those at rest, by their accelerations; `left` has the factors of M."""
    n = left.shape[0]
    for k in range(n):
        x[k] *= left[k, k]
        for i in range(k + 1, n):
            x[i] -= left[i, k] * x[k]
    for k in range(n - 1, -1, -1):
        for i in range(k):
            x[i] -= left[i, i] * left[k, i] * x[k]


@inline_kernel
def accelerate(
    mass: FloatArray, spring: FloatArray, places: FloatArray, pairs: IndexArray, carriers: IntArray, tree: Tree | None,
    M: FloatArray, left: FloatArray, bias: FloatArray, mobility: FloatArray, modes: FloatArray,
    drive: FloatArray, time: float, q: FloatArray, v: FloatArray, w: FloatArray, a: FloatArray, held: FloatArray,
    grip: FloatArray, pull: FloatArray, turned: FloatArray, changed: bool,
) -> bool:  # fmt: skip
    """Compute accelerations, and friction at rest with its limits; False if M is not positive definite.

    Of the links, which stand in a tree, M is the mass matrix with the rotors of rigid joints, `left` has its factors
    unless it or the modes have changed, and bias the torques that their motion takes; of other masses mobility is one
    over the inertia. Modes are the directions in which masses and deflections move, 0 of a mass at rest; the rows of
    masses and springs are those of their bands and pieces.
    """
    nd, links = q.size, 0 if tree is None else bias.size
    for i in range(nd):
        held[i] = drive[i] - mass[i, kernels.OFFSET]
    for i in range(links):
        held[i] -= bias[i]
    for j in range(places.shape[0]):
        force = laws.place_force(places, turned, j, _read(q, places[j, kernels.WHERE]))
        for i in range(nd):
            held[i] -= force if i == places[j, kernels.WHERE] else 0.0
    for s in range(pull.size):
        one, two = tied(tree, pairs, s)
        pull[s] = laws.spring_torque(spring, s, q[two] - q[one], v[two] - v[one], w[nd + s])
        held[one] += pull[s]
        held[two] -= pull[s]
    for i in range(nd):
        mode = modes[i]
        back = 1 if mode < 0.0 else 0  # known long before what pushes
        if mode == FREE or mode == 0.0:
            back = 1 if v[i] < 0.0 or (v[i] == 0.0 and held[i] < 0.0) else 0
        s = i - 1 if tree is None else carriers[i]
        carried = pull[np.uint64(s)] if s >= 0 else drive[i]
        grip[i], drag = laws.friction(mass, i, back, carried, time)
        held[i] -= grip[i] * (w[i] if mass[i, kernels.WINDING] > 0.0 else mode) + drag * v[i]
        a[i] = held[i] * (mobility[i] if i >= links else 1.0) if mode != 0.0 else 0.0
    positive = tree is None or not changed or factorise(M, modes, left)
    if tree is not None:
        solve(left, a[:links])
    for i in range(links):
        for j in range(links if modes[i] == 0.0 else 0):  # what the others' motion takes from what holds it
            held[i] -= M[i, j] * a[j]
    return positive


@inline_kernel
def settle(
    mass: FloatArray, modes: FloatArray, v: FloatArray, a: FloatArray, held: FloatArray, grip: FloatArray, turns: bool
) -> bool:
    """Let a mass at rest begin to move, or stay; return whether a mode has changed. `turns` lets what winds up turn."""
    for i in range(v.size):
        mode = modes[i]
        if v[i] != 0.0 or mode == FREE:
            continue
        if mass[i, kernels.WINDING] > 0.0:
            mode = -mode if turns and mode * a[i] < 0.0 else mode
        elif mode == 0.0 and abs(held[i]) >= _HOLD * grip[i] and held[i] != 0.0:
            mode = math.copysign(1.0, held[i])
        elif mode != 0.0 and mode * a[i] <= 0.0:
            mode = 0.0
        if mode != modes[i]:
            modes[i] = mode
            return True
    return False


@inline_kernel
def _enter(
    i: int, masses: FloatArray, springs: FloatArray, modes: FloatArray, at: IntArray, mass: FloatArray,
    spring: FloatArray, bounds: FloatArray,
) -> None:  # fmt: skip
    """Take the numbers and the bounds of the band that a mass's speed is in, or of the piece of a spring."""
    nd, low, high = masses.shape[0], -np.inf, np.inf
    if i >= nd:
        s, p = i - nd, abs(at[i])
        laws.take_piece(springs, s, at[i], spring)
        low = springs[s, p, kernels.BEGIN]
        high = springs[s, p + 1, kernels.BEGIN] if p + 1 < springs.shape[1] else np.inf
        if at[i] <= 0:
            low, high = -high, high if p == 0 else -low
    else:
        assign(mass[i], masses[i, at[i]])
        if modes[i] != FREE and mass[i, kernels.WINDING] == 0.0:
            low, high = masses[i, at[i] - 1, kernels.HIGH] if at[i] > 0 else -np.inf, mass[i, kernels.HIGH]
    bounds[i, 0], bounds[i, 1] = low, high


@inline_kernel
def _watch(
    spring: FloatArray, tree: Tree | None, pairs: IndexArray, modes: FloatArray, bounds: FloatArray, q: FloatArray,
    v: FloatArray, held: FloatArray, grip: FloatArray, guards: FloatArray,
) -> None:  # fmt: skip
    """Fill the guards, each positive until its event, and infinite without one.

    First those of masses, a speed or what can hold one beyond its push; of springs, the rates of deflections; then as
    many for the bounds of bands and pieces.
    """
    nd, every = v.size, guards.size // 2
    for i in range(nd):
        mode = modes[i]
        room = mode * v[i] if mode != 0.0 else _HOLD * grip[i] - abs(held[i])
        guards[i] = room if mode != FREE else np.inf
        guards[every + i] = min(mode * v[i] - bounds[i, 0], bounds[i, 1] - mode * v[i])
    for s in range(every - nd):
        i, (one, two) = nd + s, tied(tree, pairs, s)
        guards[i] = modes[i] * (v[two] - v[one]) if spring[s, kernels.WINDING] > 0.0 else np.inf
        guards[every + i] = min(q[two] - q[one] - bounds[i, 0], bounds[i, 1] - (q[two] - q[one]))


@inline_kernel
def _find_first(
    modes: FloatArray, h: float, guards: FloatArray, ends: FloatArray, a: FloatArray, a1: FloatArray, known: int,
    dips: bool,
) -> tuple[int, float]:  # fmt: skip
    """Return the guard of the apparently first event, and where: 1 if it shows at the end.

    Less than 1 is the bottom of a dip, on demand, of a speed that is positive at both ends. No guard, -1, if there is
    no event but a known one.
    """
    first, found, where = 2.0, -1, 1.0
    for i in range(guards.size):
        start, end = guards[i], ends[i]
        if i != known and (end < 0.0 or (end == 0.0 and start > 0.0)) and start / (start - end) < first:
            first, found = start / (start - end), i
    for i in range(a.size):
        start, end = guards[i], ends[i]
        if dips and i != known and modes[i] != 0.0 and 0.0 <= start < np.inf and (end > 0.0 or end == start):
            down, up = modes[i] * a[i] * h, modes[i] * a1[i] * h
            # The cubic through both ends: where it is lowest, and how low. It may rise before, as from rest.
            c2, c3 = 3.0 * (end - start) - 2.0 * down - up, 2.0 * (start - end) + down + up
            square = c2 * c2 - 3.0 * c3 * down
            falls = up > 0.0 and (start > 0.0 or down > 0.0) and square > 0.0
            if falls and min(start, end) < 0.15 * (up + abs(down)):
                place = -down / (c2 + math.sqrt(square))
                lowest = start + place * (down + place * (c2 + place * c3))
                if 0.0 < place < 1.0 and lowest < 0.0 and place < first:
                    first, found, where = place, i, place
    return found, where


@inline_kernel
def _begin(
    masses: FloatArray, springs: FloatArray, pairs: IndexArray, links: int, mobility: FloatArray, longest: float,
    q: FloatArray, v: FloatArray, w: FloatArray, modes: FloatArray, at: IntArray,
) -> None:  # fmt: skip
    """Fill modes, bands and pieces at the first sample."""
    nd = v.size
    for i in range(nd):
        largest, modes[i] = max(masses[i, 0, kernels.COULOMB], masses[i, 0, kernels.COULOMB_BACK]), FREE
        sticks = math.sqrt(largest * masses[i, 0, kernels.WINDING] * mobility[i]) * longest
        for band in range(masses.shape[1]):
            if links == 0 and not sticks < _STICKS:
                masses[i, band, kernels.WINDING] = 0.0
            grows = masses[i, band, kernels.COULOMB_DRIFT] != 0.0 or masses[i, band, kernels.PER_TORQUE] > 0.0
            if grows or max(masses[i, band, kernels.COULOMB], masses[i, band, kernels.COULOMB_BACK]) > 0.0:
                modes[i] = 0.0
        if masses[i, 0, kernels.WINDING] > 0.0:
            modes[i] = math.copysign(1.0, v[i])
        else:
            w[i] = 0.0
            modes[i] = math.copysign(1.0, v[i]) if modes[i] == 0.0 and v[i] != 0.0 else modes[i]
            while modes[i] != FREE and abs(v[i]) > masses[i, at[i], kernels.HIGH]:
                at[i] += 1
    for s in range(pairs.shape[0]):
        e, rate = q[pairs[s, 1]] - q[pairs[s, 0]], v[pairs[s, 1]] - v[pairs[s, 0]]
        modes[nd + s] = math.copysign(1.0, rate)
        for p in range(1, springs.shape[1]):
            if abs(e) > springs[s, p, kernels.BEGIN]:
                at[nd + s] = p if e > 0.0 else -p


@inline_kernel
def _go_on(
    event: int, mass: FloatArray, pairs: IndexArray, modes: FloatArray, bounds: FloatArray, at: IntArray,
    q: FloatArray, v: FloatArray, held: FloatArray,
) -> None:  # fmt: skip
    """Change what an event changes: a mass stops, turns or comes loose, a slider turns, a law goes over an edge."""
    nd = v.size
    if event >= modes.size:
        i = event - modes.size
        value = modes[i] * _read(v, i) if i < nd else _read(q, pairs[i - nd, 1]) - _read(q, pairs[i - nd, 0])
        at[i] += 1 if bounds[i, 1] - value < value - bounds[i, 0] else -1
    elif event >= nd:
        modes[event] = -modes[event]
    elif modes[event] == 0.0:
        modes[event] = math.copysign(1.0, _read(held, event))
    else:
        modes[event] = -modes[event] if mass[event, kernels.WINDING] > 0.0 else 0.0


@inline_kernel
def _write_row(
    row: FloatArray, part: int, d: float, event: int, modes: FloatArray, at: IntArray, q: FloatArray, v: FloatArray,
    w: FloatArray, a: FloatArray, a1: FloatArray,
) -> None:  # fmt: skip
    """Write a step into its row of the tape."""
    nd, every = q.size, w.size
    row[kernels.PART], row[kernels.LENGTH], row[kernels.EVENT] = part, d, event
    for i in range(nd):
        row[STATE + i], row[STATE + nd + i] = q[i], v[i]
        row[STATE + 2 * nd + i], row[STATE + 3 * nd + i] = a[i], a1[i]
    begin = STATE + 4 * nd
    for i in range(every):
        row[begin + i], row[begin + every + i], row[begin + 2 * every + i] = modes[i], at[i], w[i]


@inline_kernel
def _fastest_rate(
    mass: FloatArray, spring: FloatArray, places: FloatArray, tree: Tree | None, pairs: IndexArray,
    mobility: FloatArray, modes: FloatArray, q: FloatArray, v: FloatArray, w: FloatArray, grip: FloatArray,
) -> float:  # fmt: skip
    """Return a bound in 1/s on how fast the motion changes by itself, or what acts on it changes with it."""
    nd, square, rate = q.size, 0.0, 0.0
    for i in range(nd):
        rate += max(abs(mass[i, kernels.VISCOUS]), abs(mass[i, kernels.VISCOUS_BACK])) * mobility[i]
        tangent = abs(laws.wind_up(mass, i, modes[i], modes[i], w[i])[0])
        if tangent > _WINDS * mass[i, kernels.WINDING]:
            square += grip[i] * tangent * mobility[i]
            rate += abs(laws.wind_up(mass, i, modes[i], v[i], w[i])[1])
    for s in range(w.size - nd):
        one, two = tied(tree, pairs, s)
        e, both = q[two] - q[one], mobility[one] + mobility[two]
        stiffness = spring[s, kernels.STIFFNESS] + max(3.0 * spring[s, kernels.CUBIC] * e * e, 0.0)
        left = abs(modes[nd + s] - w[nd + s])
        if spring[s, kernels.WINDING] > 0.0 and left > _WINDS:
            stiffness += spring[s, kernels.SLIPS] * spring[s, kernels.WINDING] * left
            rate += abs(v[two] - v[one]) * spring[s, kernels.WINDING]
        square += stiffness * both
        rate += spring[s, kernels.DAMPING] * both
    for j in range(places.shape[0]):
        i, wave = int(places[j, kernels.WHERE]), abs(places[j, kernels.WAVE])
        slope = wave * (abs(places[j, kernels.COS]) + abs(places[j, kernels.SIN])) + abs(places[j, kernels.RATE])
        square += slope * mobility[i]
        rate += wave * abs(_read(v, i))
    return math.sqrt(square) + rate


@partial(compile_kernel, _nrt=False)
def run(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, before: FloatArray, far: FloatArray,
    z: FloatArray, joint: tuple[float, ...] | None, place: FloatArray, speed: FloatArray, wound: FloatArray | None,
    rate: float, reach: float, command: FloatArray, excess: FloatArray, tape: FloatArray, path: Path | None,
    counts: IntArray,
) -> int:  # fmt: skip
    """Simulate one candidate; fill what is out and return how it ended.

    Args:
        plant: its numbers; what of a joint winds up too fast to be told from Coulomb friction is made that.
        tree: of the first masses; None of a joint.
        inertials: (links, 10) of the tree, or (0, 10).
        loop: what drives it.
        before: (axes,) torques that acted before the first period.
        far: (axes,) motor positions above which a loop counts as diverged.
        z: (axes, states) of the controllers, overwritten.
        joint: of one without a path a number for each mass: only how many is read, at compile time. None of others.
        place: (masses,) initial positions.
        speed: (masses,) initial velocities.
        wound: (masses,) initially wound-up shares of friction; None of a joint of straight lines. What needs it is then
            not compiled.
        rate: how fast the fastest part of the motion turns, rad/s; 0 to ask that of the masses alone in each step.
        reach: how far it may turn in a step, rad.
        command: (axes, clock) out: torques that act, held between periods.
        excess: (axes, periods, elements) out: what limits and gates took away; or (axes, 0, elements).
        tape: (rows, columns) out, of as many steps as it holds; of a joint of straight lines, of the parts that no map
            crosses, and a last one of no length where each ends.
        path: out, of a joint of straight lines.
        counts: (4,) out: events, rows of the tape, steps of the clock that were simulated, those at a limit.
    """
    masses, springs, places, pairs, motors, carriers = plant
    post, lengths, lags, every, elements = loop.post, loop.lengths, loop.lags, loop.every, loop.w.shape[1]
    nd, ns = (masses.shape[0], pairs.shape[0]) if joint is None else (len(joint), len(joint) - 1)
    axes, outputs, nw = motors.size, loop.output, nd + ns
    links, parts, clock = inertials.shape[0], lengths.size, command.shape[1]
    q, v, a, held, grip, drive = vector(nd), vector(nd), vector(nd), vector(nd), vector(nd), vector(nd)
    q1, v1, a1, held1, grip1, between = vector(nd), vector(nd), vector(nd), vector(nd), vector(nd), vector(nd)
    mean, pull, w, w1, guards, ends = vector(nd), vector(ns), vector(nw), vector(nw), vector(2 * nw), vector(2 * nw)
    modes, mobility, at, bounds = vector(nw), vector(nd), indices(nw), table(nw, 2)
    turned, link_room = table(places.shape[0], 3), table(links, ROOM)
    mass, spring = table(max(nd, 2), kernels.MASS + 1), table(max(ns, 1), kernels.MASS)
    M, coupling, bias, still = table(links, links), table(links, links), vector(links), vector(links)
    fresh, cut = vector(z.shape[1]), vector(elements)
    period, longest, coupled = 0.0, 0.0, tree is not None  # whether a torque moves more than its motor
    for part in range(parts):
        period += lengths[part]
        longest = max(longest, lengths[part])
    mass[1, kernels.INERTIA] = 1.0  # the maps of a rigid joint have a load that nothing pushes
    for i in range(nd):
        assign(mass[i], masses[i, 0])
        mobility[i] = 1.0 / mass[i, kernels.INERTIA] if i >= links else 0.0
        coupled = coupled or (carriers[i] < 0 and mass[i, kernels.PER_TORQUE] > 0.0)
    for i in range(nd):
        q[i], v[i] = place[i], speed[i]
        if wound is not None:
            w[i] = wound[i]
    _begin(masses, springs, pairs, links, mobility, longest, q, v, w, modes, at)
    varies = places.shape[0] > 0  # how fast the motion changes by itself, between two events
    for i in range(nd + ns):
        _enter(i, masses, springs, modes, at, mass, spring, bounds)
        numbers = mass[i] if i < nd else spring[i - nd]
        varies = varies or numbers[kernels.WINDING] > 0.0 or (i >= nd and numbers[kernels.CUBIC] != 0.0)
    if tree is not None:
        equations_of_motion(tree, inertials, q[:links], v[:links], still, link_room, M, bias, False)
        for i in range(links):
            M[i, i] += mass[i, kernels.INERTIA]
    events, steps, rows, k, part, fastest, work, status, changed = 0, 0, 1, 0, 0, rate, _WORK, kernels.FINISHED, True
    if path is not None:  # maps of lines in pieces, and a law of one element, one phase and two states, which glides
        states, kept_modes, rates, moves, bends, _ = path
        work, maps, bands, pieces = _OF_LINES, rates.shape[0], masses.shape[1], springs.shape[1]
        filled = indices(maps)
        small = parts == 1 and z.shape[1] <= 2 and loop.D.size == 1 and loop.driven.shape[1] == 0
        law = small_law(loop, z.shape[1] if small else 0)
        fastest = _fastest_rate(mass, spring, places, tree, pairs, mobility, modes, q, v, w, grip)
        status = kernels.FINISHED if longest * fastest <= _MANY else kernels.TOO_STIFF
    if tape.shape[0] > 0:
        _write_row(tape[0], -1, 0.0, -1, modes, at, q, v, w, a, a)
    while k < clock and status == kernels.FINISHED:
        limited = False
        if path is not None:
            mode = affine.enter_mode(
                bands, pieces, mass, spring, modes, at, v, 0.0, lengths, filled, rates, moves, bends
            )
            k, part = affine.ride(
                mass, spring, bounds, loop, law, small, before[0], far[0], rates, moves, bends, mode, states,
                kept_modes, q, v, z, fresh, cut, command[0], excess[0], counts, k, part,
            )  # fmt: skip
            if k == clock:
                break
        for j in range(axes):
            motor = np.uint64(0) if tree is None else motors[j]
            if wound is not None:
                if every[j] > 1 and k % every[j] != 0:  # this controller holds
                    command[j, k] = command[j, k - 1]
                else:
                    own = k // every[j] if every[j] > 1 else k
                    command[j, k] = control_any(loop, j, own, q[motor], z, fresh, cut)
                    if excess.shape[1] > 0:
                        assign(excess[j, own], cut)
                limited = limited or cut[outputs[j]] != 0.0
            if not (abs(q[motor]) <= far[j] and abs(command[j, k]) < np.inf):
                status = kernels.DIVERGED
        if status != kernels.FINISHED:
            break
        counts[3] += 1 if limited else 0
        time, before_period = k * period, events
        first, end = (part, part + 1) if path is not None else (0, parts)
        for part in range(first, end):
            for j in range(axes):
                source, motor = k - lags[j, part], np.uint64(0) if tree is None else motors[j]
                torque = command[j, source] + post[j, source] if source >= 0 else before[j]
                a[motor] += (torque - drive[motor]) * mobility[motor]  # all that changes, unless a mass settles
                drive[motor] = torque
            left, h, settles = lengths[part], 0.0, coupled or k == 0 or path is not None
            for i in range(nd):
                settles = settles or modes[i] == 0.0 or v[i] == 0.0
            while left > 0.0 and status == kernels.FINISHED:
                for j in range(places.shape[0]):
                    laws.turn_place(places, j, _read(q, places[j, kernels.WHERE]), turned)
                for turn in range(_PIVOTS * nd if settles else 0):
                    if not accelerate(
                        mass, spring, places, pairs, carriers, tree, M, coupling, bias, mobility, modes, drive, time,
                        q, v, w, a, held, grip, pull, turned, changed,
                    ):  # fmt: skip
                        status = kernels.NOT_POSITIVE
                        break
                    changed = settle(mass, modes, v, a, held, grip, turn <= nd)
                    if not changed:
                        break
                for s in range(ns):  # a deflection at rest goes where its ends accelerate to
                    one, two = tied(tree, pairs, s)
                    turns = settles and v[two] == v[one] and modes[nd + s] * (a[two] - a[one]) < 0.0
                    if turns and spring[s, kernels.WINDING] > 0.0:
                        modes[nd + s] = -modes[nd + s]
                if rate == 0.0 and (settles or (varies and left > h) or fastest == 0.0):
                    fastest = _fastest_rate(mass, spring, places, tree, pairs, mobility, modes, q, v, w, grip)
                steps_left = left * fastest / reach * (1.0 - _ROOT)
                if not left * fastest <= _MANY or (rate == 0.0 and steps * reach > work * (clock * parts + 100)):
                    status = kernels.TOO_STIFF
                if status != kernels.FINISHED:
                    break
                if path is not None:
                    mode = affine.enter_mode(
                        bands, pieces, mass, spring, modes, at, v, 1.0, lengths, filled, rates, moves, bends
                    )
                    if left == lengths[part] and kept_modes.size > 0:  # in which it begins to move
                        kept_modes[k * parts + part] = mode
                h = left / math.ceil(steps_left) if steps_left > 1.0 else left
                known, dips, looks, tries = -1, False, True, 0
                share, low, high, above, below, kept = 1.0, 0.0, 1.0, 0.0, 0.0, 0
                if settles:  # else they are as the step before has left them
                    _watch(spring, tree, pairs, modes, bounds, q, v, held, grip, guards)
                while True:
                    d = share * h
                    for i in range(nd):
                        v1[i], a1[i], between[i] = v[i], a[i], -a[i]
                    for stage in range(0 if path is None else 3, 4):
                        gone, onward = 0.5 * d if stage < 2 else d, stage != 1
                        if path is not None:
                            moved = affine.flow(rates[mode], d, affine.read_state(q, v), drive[0], 1.0)
                            affine.write_state(moved, q1, v1)
                        if wound is not None:
                            for i in range(nd):
                                if stage < 3:
                                    mean[i] = v[i] + 0.5 * gone * (a[i] if stage == 0 else between[i])
                                    between[i] += a1[i]
                                    v1[i] = v[i] + gone * a1[i]
                                else:
                                    mean[i] = v[i] + d / 6.0 * (a[i] + between[i])
                                    v1[i] = v[i] + d / 6.0 * (a[i] + 2.0 * between[i] + a1[i])
                                q1[i] = q[i] + gone * mean[i] if onward else q1[i]
                            for i in range(nd if onward else 0):
                                if mass[i, kernels.WINDING] > 0.0:
                                    w1[i] = laws.wind(mass, i, modes[i], mean[i], gone, w[i])
                            for s in range(ns if onward else 0):
                                one, two = tied(tree, pairs, s)
                                x = nd + s
                                if spring[s, kernels.WINDING] > 0.0:
                                    w1[x] = laws.wind(spring, s, modes[x], mean[two] - mean[one], gone, w[x])
                        if tree is not None:
                            equations_of_motion(
                                tree, inertials, q1[:links], v1[:links], still, link_room, M, bias, not onward
                            )
                            for i in range(links if onward else 0):
                                M[i, i] += mass[i, kernels.INERTIA]
                        if not accelerate(
                            mass, spring, places, pairs, carriers, tree, M, coupling, bias, mobility, modes, drive,
                            time + gone, q1, v1, w1, a1, held1, grip1, pull, turned, onward,
                        ):  # fmt: skip
                            status = kernels.NOT_POSITIVE if M[0, 0] == M[0, 0] else kernels.DIVERGED  # no number
                            break
                    if status != kernels.FINISHED:
                        break
                    steps += 1
                    tries += 1
                    _watch(spring, tree, pairs, modes, bounds, q1, v1, held1, grip1, ends)
                    if looks:  # at first, and where an event is located, since another may come before
                        found, where = _find_first(modes, d, guards, ends, a, a1, known, tries == 1)
                        if found < 0 or tries > _CLOSER:
                            break
                        known, looks, dips, low, high, kept = found, False, where < 1.0, 0.0, share, 0
                        above, below = _read(guards, known), _read(ends, known)
                        if dips:
                            share = where
                            continue
                    elif _read(ends, known) > 0.0:
                        if dips:  # the cubic dips, but not the motion
                            known, looks, dips = -1, True, False
                            continue
                        below *= 0.5 if kept > 0 else 1.0
                        low, above, kept = share, _read(ends, known), 1
                    else:
                        above *= 0.5 if kept < 0 else 1.0
                        high, below, kept, dips = share, _read(ends, known), 0 if dips else -1, False
                    if high - low <= _ROOT or below == 0.0 or tries > _CLOSER:
                        share, looks = high, True
                        continue
                    # Between a guard that is positive and one that is not: the secant, its idle end halved (Illinois).
                    share = (low * below - high * above) / (below - above) if above > 0.0 else 0.5 * (low + high)
                    share = min(max(share, low + 0.3 * _ROOT), high - 0.3 * _ROOT)
                if status != kernels.FINISHED:
                    break
                if rows < tape.shape[0]:
                    _write_row(tape[rows], k * parts + part, d, known, modes, at, q, v, w, a, a1)
                rows += 1
                for i in range(nd):
                    q[i], v[i], a[i] = q1[i], v1[i] if i != float(known) else 0.0, a1[i]
                    held[i], grip[i] = held1[i], grip1[i]
                for i in range(nd + ns):
                    w[i] = modes[i] if abs(modes[i] - w1[i]) < _WOUND_UP else w1[i]
                for i in range(guards.size):
                    guards[i] = ends[i]
                time += d
                left = 0.0 if share == 1.0 and h == left else left - d
                settles = changed = known >= 0
                if settles:
                    events += 1
                    _go_on(known, mass, pairs, modes, bounds, at, q, v, held)
                    if known >= nd + ns:
                        _enter(known - nd - ns, masses, springs, modes, at, mass, spring, bounds)
                    if events - before_period > _EVENTS:
                        status = kernels.CHATTERING
            if path is not None:
                if rows < tape.shape[0]:
                    _write_row(tape[rows], k * parts + part, 0.0, -1, modes, at, q, v, w, a, a)
                rows += 1
        part = part + 1 if path is not None and part + 1 < parts else 0
        k += 1 if status == kernels.FINISHED and part == 0 else 0
    counts[0], counts[1], counts[2] = events, rows, k
    return status
