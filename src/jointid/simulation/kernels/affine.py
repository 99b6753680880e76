"""The affine maps of a joint whose laws are lines in pieces, how far it glides by them, and the derivatives, compiled.

While no mass stops or comes loose, and no law goes over an edge, such a joint is linear, and its torque is held over a
part of a period. A part is then one affine map, exact to rounding. Each sliding, sticking and direction mode of the two
masses, in each band of their speeds and piece of their spring, has its own. A map is applied where chords prove that
nothing happens in between. `kernels.engine` goes through the other parts, about one in a thousand, step by step.

The state is motor position, motor velocity, load position, load velocity; a rigid joint has a load that nothing pushes.
Functions pass numbers and tuples rather than arrays, as these stay in registers.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import Any, TypeAlias

import numpy as np
from numba import config, extending, types
from numba.core import cgutils
from numba.np import arrayobj
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, inline_kernel
from jointid.simulation import kernels
from jointid.simulation.kernels import LANES, IntArray, SampledLoop, Seeds
from jointid.simulation.kernels.control import SmallLaw, control_any

State: TypeAlias = tuple[float, float, float, float]
Bounds: TypeAlias = tuple[float, float, float, float, float, float]

INPUTS = 5  # of a map: motor velocity, stretch, load velocity, torque, constant forces
MODES = 9  # of two masses in a band each and their spring in a piece
_ORDER = 10  # of the series of the motion
_STRIDE = 0.25  # rad of the fastest motion in a series: its remainder is at most 30 times the rounding error
_HELD = 1e-300  # what a cone without width holds: nothing that is pushed
_STEP = 1e-30j  # of numbers whose derivatives are taken: its square is nothing beside any rate
WIDE = 4 * LANES  # derivatives of a state

# Rows of the scratch, LANES long: derivatives of motor position, motor velocity, load position and load velocity; what
# parameters change in the map of these; derivatives of two states of the law, and of the torque; then what parameters
# change in the law's output.
_S, _T, _Z, _D, _EXPLICIT, SCRATCH = (LANES * row for row in (0, 4, 8, 10, 11, 12))


def _lower(context: Any, builder: Any, signature: Any, sizes: Any) -> Any:
    element = context.get_value_type(signature.return_type.dtype)
    array, width = context.make_array(signature.return_type)(context, builder), context.get_abi_sizeof(element)
    memory, width = builder.alloca(element, reduce(builder.mul, sizes)), context.get_constant(types.intp, width)
    memory.align = 64  # bytes of a cache line
    cgutils.memset(builder, memory, reduce(builder.mul, sizes, width), 0)  # type: ignore
    strides = [builder.mul(width, columns) for columns in sizes[1:]]
    arrayobj.populate_array(array, memory, [*sizes], [*strides, width], width, None)  # type: ignore
    return array._getvalue()


def _on_stack(kind: Any, dimensions: int = 1, dtype: type = np.float64) -> Any:
    def vector_of(_: Any, size: Any) -> tuple[Any, Any]:
        return types.Array(kind, 1, "C")(size), _lower

    def table_of(_: Any, rows: Any, columns: Any) -> tuple[Any, Any]:
        return types.Array(kind, 2, "C")(rows, columns), _lower

    make: Any = vector_of if dimensions == 1 else table_of
    return (lambda *sizes: np.zeros(sizes, dtype)) if config.DISABLE_JIT else extending.intrinsic(make)  # type: ignore


vector, table, indices = _on_stack(types.float64), _on_stack(types.float64, 2), _on_stack(types.int64, dtype=np.int64)
"""Zeros on the stack, not on the heap: LLVM keeps them in registers where it knows their number and each index."""
_complex_table = _on_stack(types.complex128, 2, np.complex128)


def _widen(_: Any) -> tuple[Any, Any]:
    def lower(context: Any, builder: Any, *_: Any) -> Any:
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # their own `add` takes no values
        return context.get_dummy_value()

    return types.void(), lower


wide_vectors: Any = (lambda: None) if config.DISABLE_JIT else extending.intrinsic(_widen)  # type: ignore
"""Let a function use whole vectors, as those it inlines must ask, too: of 512 bits LLVM by itself takes halves."""


@inline_kernel
def read_state(q: FloatArray, v: FloatArray) -> State:
    """Return the state of one or two masses."""
    return (q[0], v[0], q[1], v[1]) if q.size > 1 else (q[0], v[0], q[0], 0.0)


@inline_kernel
def write_state(x: State, q: FloatArray, v: FloatArray) -> None:
    """Write the state of one or two masses."""
    q[0], v[0] = x[0], x[1]
    if q.size > 1:
        q[1], v[1] = x[2], x[3]


@inline_kernel
def fill_rates(
    mass: FloatArray, spring: FloatArray, m1: int, m2: int, share1: float, share2: float, torque: float,
    rates: FloatArray,
) -> None:  # fmt: skip
    """Write the accelerations of motor and load by each input, (2, INPUTS).

    They are linear in the joint's numbers but for the inertias: shares are one over these, and 0 of a mass at rest. The
    torque is 1; or 0 where the numbers are derivatives.
    """
    stiffness, damping = spring[0, kernels.STIFFNESS], spring[0, kernels.DAMPING]
    back1, back2, held = int(m1 <= 0), int(m2 <= 0), spring[0, kernels.HELD]
    viscous1, force1 = mass[0, kernels.VISCOUS + back1], (2 * back1 - 1) * mass[0, kernels.COULOMB + back1]
    viscous2, force2 = mass[1, kernels.VISCOUS + back2], (2 * back2 - 1) * mass[1, kernels.COULOMB + back2]
    force1, force2 = force1 - mass[0, kernels.OFFSET] + held, force2 - mass[1, kernels.OFFSET] - held
    rates[0, 0], rates[0, 1], rates[0, 2] = -(viscous1 + damping) * share1, stiffness * share1, damping * share1
    rates[0, 3], rates[0, 4] = torque * share1, force1 * share1
    rates[1, 0], rates[1, 1], rates[1, 2] = damping * share2, -stiffness * share2, -(viscous2 + damping) * share2
    rates[1, 3], rates[1, 4] = 0.0, force2 * share2


@inline_kernel
def flow(rates: FloatArray, h: float, x: State, s: float, steady: float) -> State:
    """Return the state after `h` seconds in a mode, by a Taylor series; constant forces act for a `steady` of 1."""
    x0, x1, x2, x3 = x
    v1, stretch, v2, first = x1, x2 - x0, x3, 1.0
    for k in range(1, _ORDER + 1):
        share = h / k
        push1, push2 = first * (rates[0, 3] * s + rates[0, 4] * steady), first * (rates[1, 4] * steady)
        x0, x2, apart = x0 + share * v1, x2 + share * v2, v2 - v1
        a1 = rates[0, 0] * v1 + rates[0, 1] * stretch + (rates[0, 2] * v2 + push1)
        a2 = rates[1, 0] * v1 + rates[1, 1] * stretch + (rates[1, 2] * v2 + push2)
        v1, stretch, v2, first = share * a1, share * apart, share * a2, 0.0
        x1, x3 = x1 + v1, x3 + v2
    return x0, x1, x2, x3


@inline_kernel
def _fill_bends(mass: FloatArray, spring: FloatArray, m1: int, m2: int, h: float, bends: FloatArray) -> None:
    """Write how far what must stay positive can bend from its chord in a part, per root energy; and its growth.

    While the torque is held, the energy of the rates of change, E = M1 a1^2 + M2 a2^2 + K (v2 - v1)^2, can only
    fall (its root grows by at most `growth` where a candidate has negative viscous friction), so it bounds every
    second derivative over the part by its value at the start; a function stays within h^2/8 max|f''| of its chord.
    The root energy is sqrt(M1 E), so that a change of the torque changes it by no more than itself.
    """
    inertia1, inertia2 = mass[0, kernels.INERTIA], mass[1, kernels.INERTIA]
    stiffness, damping = spring[0, kernels.STIFFNESS], spring[0, kernels.DAMPING]
    root1, root2 = math.sqrt(inertia1), math.sqrt(inertia2)
    viscous1, viscous2 = mass[0, kernels.VISCOUS + int(m1 <= 0)], mass[1, kernels.VISCOUS + int(m2 <= 0)]
    shared = math.sqrt(stiffness) + damping * (1.0 / root1 + 1.0 / root2)
    bend1 = (abs(viscous1) / root1 + shared) / inertia1  # of the motor's velocity
    bend2 = (abs(viscous2) / root2 + shared) / inertia2  # of the load's velocity
    push1 = stiffness / root2 + damping * bend2  # of the push on a motor at rest
    push2 = stiffness / root1 + damping * bend1  # of the push on a load at rest
    growth = math.exp(min(-min(viscous1 / inertia1, viscous2 / inertia2, 0.0) * h, 50.0))
    bend = h * h / 8.0 / root1 * growth if m1 != 0 or m2 != 0 else 0.0  # where nothing moves, nothing bends
    bends[0], bends[1] = bend * (bend1 if m1 != 0 else push1), bend * (bend2 if m2 != 0 else push2)
    bends[2], bends[3] = growth, bend * (abs(m1) / root1 + abs(m2) / root2)  # the last of the deflection


@inline_kernel
def unit_move(rates: FloatArray, m1: int, m2: int, i: int, h: float) -> State:
    """Return by how much a unit of an input changes the positions in `h` seconds, and the velocities at their end."""
    begin, torque, steady = 1.0 if i == 1 else 0.0, 1.0 if i == 3 else 0.0, 1.0 if i == 4 else 0.0
    v1, v2 = 1.0 if i == 0 and m1 != 0 else 0.0, 1.0 if i == 2 and m2 != 0 else 0.0
    rate = math.sqrt(abs(rates[0, 1]) + abs(rates[1, 1])) + abs(rates[0, 0]) + abs(rates[1, 2])
    pieces = max(math.ceil(rate * h / _STRIDE), 1)
    x = flow(rates, h / pieces, (0.0, v1, begin, v2), torque, steady)
    for _ in range(1, pieces):
        x = flow(rates, h / pieces, x, torque, steady)
    return x[0], x[1], x[2] - begin, x[3]


@inline_kernel
def _ways(mode: int) -> tuple[int, int]:
    """Return the directions in which the masses move in a mode."""
    return mode % MODES // 3 - 1, mode % 3 - 1


@inline_kernel
def enter_mode(
    bands: int, pieces: int, mass: FloatArray, spring: FloatArray, modes: FloatArray, at: IntArray, v: FloatArray,
    loose: float, lengths: FloatArray, filled: IntArray, rates: FloatArray, moves: FloatArray,
    bends: FloatArray,
) -> int:  # fmt: skip
    """Return the index of the mode of two masses, and compute its maps at its first use.

    There are 9 for each band of the motor, those for each of the load, and all for each piece, negative ones first. A
    mass that no friction holds moves on as it does, at rest `loose`. Filled are `rates`, (modes, 2, INPUTS),
    accelerations of motor and load by each input; `moves`, (modes * parts, INPUTS, 4), see `unit_move`; and `bends`,
    (modes * parts, 4).
    """
    one, two, where = modes[0], modes[1] if v.size > 1 else 0.0, at[0]
    if one == kernels.FREE:
        one = math.copysign(1.0, v[0]) if v[0] != 0.0 else loose
    if two == kernels.FREE:
        two = math.copysign(1.0, v[1]) if v[1] != 0.0 else loose
    if v.size > 1:
        where += bands * (at[1] + bands * (at[2] + pieces - 1))
    mode = int(MODES * where + 3.0 * one + two) + 4
    if filled[mode]:
        return mode
    m1, m2 = _ways(mode)
    share1, share2 = abs(m1) / mass[0, kernels.INERTIA], abs(m2) / mass[1, kernels.INERTIA]
    fill_rates(mass, spring, m1, m2, share1, share2, 1.0, rates[mode])
    for part in range(lengths.size):
        b = mode * lengths.size + part
        _fill_bends(mass, spring, m1, m2, lengths[part], bends[b])
        for i in range(INPUTS):
            x = unit_move(rates[mode], m1, m2, i, lengths[part])
            moves[b, i, 0], moves[b, i, 1], moves[b, i, 2], moves[b, i, 3] = x
    filled[mode] = 1
    return mode


@inline_kernel
def _bounds(bounds: FloatArray) -> Bounds:
    """Return the least and the largest speeds of motor and load, and deflection; a mass in motion does not turn."""
    if bounds.shape[0] == 1:
        return max(bounds[0, 0], 0.0), bounds[0, 1], 0.0, np.inf, -np.inf, np.inf
    slowest1, slowest2 = max(bounds[0, 0], 0.0), max(bounds[1, 0], 0.0)
    return slowest1, bounds[0, 1], slowest2, bounds[1, 1], bounds[2, 0], bounds[2, 1]


@inline_kernel
def _inside(start: float, end: float, low: float, high: float) -> float:
    """Return the room that a chord leaves between bounds."""
    return min(min(start, end) - low, high - max(start, end))


@inline_kernel
def _move(m: FloatArray, b: int, x: State, s: float) -> State:
    """Return the state at the end of a part under a held torque; this comes last, as it is known last."""
    at, stretch = np.uint64(b), x[2] - x[0]  # Numba looks for negative indices among the signed
    y0 = ((x[0] + (m[at, 0, 0] * x[1] + m[at, 2, 0] * x[3])) + (m[at, 4, 0] + m[at, 1, 0] * stretch)) + m[at, 3, 0] * s
    y1 = ((m[at, 0, 1] * x[1] + m[at, 2, 1] * x[3]) + (m[at, 4, 1] + m[at, 1, 1] * stretch)) + m[at, 3, 1] * s
    y2 = ((x[2] + (m[at, 0, 2] * x[1] + m[at, 2, 2] * x[3])) + (m[at, 4, 2] + m[at, 1, 2] * stretch)) + m[at, 3, 2] * s
    y3 = ((m[at, 0, 3] * x[1] + m[at, 2, 3] * x[3]) + (m[at, 4, 3] + m[at, 1, 3] * stretch)) + m[at, 3, 3] * s
    return y0, y1, y2, y3


@inline_kernel
def _stays(
    mass: FloatArray, spring: FloatArray, bounds: Bounds, bends: FloatArray, b: int, m1: int, m2: int, x: State,
    y: State, s: float, root: float,
) -> bool:  # fmt: skip
    """Return whether nothing happens in a part, by its root energy, see `_fill_bends`; False means "not proved"."""
    slowest1, fastest1, slowest2, fastest2, low, high = bounds
    stretch, after, at = x[2] - x[0], y[2] - y[0], np.uint64(b)
    room1, room2 = _inside(m1 * x[1], m1 * y[1], slowest1, fastest1), _inside(m2 * x[3], m2 * y[3], slowest2, fastest2)
    if m1 == 0 or m2 == 0:  # one at rest stays in its cone
        stiffness, damping, held = spring[0, kernels.STIFFNESS], spring[0, kernels.DAMPING], spring[0, kernels.HELD]
        pull = held + stiffness * stretch + damping * (x[3] - x[1])
        end = held + stiffness * after + damping * (y[3] - y[1])
        least, most = min(pull, end), max(pull, end)
        if m1 == 0:
            push, grip, back = s - mass[0, kernels.OFFSET], mass[0, kernels.COULOMB], mass[0, kernels.COULOMB_BACK]
            room1 = _HELD + min(grip - (push + most), back + (push + least))
        if m2 == 0:
            push, grip, back = mass[1, kernels.OFFSET], mass[1, kernels.COULOMB], mass[1, kernels.COULOMB_BACK]
            room2 = _HELD + min(grip + (push + least), back - (push + most))
    inside = _inside(stretch, after, low, high) > bends[at, 3] * root
    return bool(room1 > bends[at, 0] * root and room2 > bends[at, 1] * root and inside)


@inline_kernel
def _root_energy(mass: FloatArray, spring: FloatArray, r: FloatArray, mode: int, x: State, s: float) -> float:
    """Return the root energy of the rates of change as a part begins, see `_fill_bends`."""
    a, stretch, apart = np.uint64(mode), x[2] - x[0], x[3] - x[1]
    inertia, load, stiffness = mass[0, kernels.INERTIA], mass[1, kernels.INERTIA], spring[0, kernels.STIFFNESS]
    a1 = (r[a, 0, 0] * x[1] + r[a, 0, 1] * stretch) + (r[a, 0, 2] * x[3] + r[a, 0, 3] * s) + r[a, 0, 4]
    a2 = (r[a, 1, 0] * x[1] + r[a, 1, 1] * stretch) + (r[a, 1, 2] * x[3] + r[a, 1, 4])
    return math.sqrt(inertia * (inertia * a1 * a1 + load * a2 * a2 + stiffness * apart * apart))


@inline_kernel
def _follow_chords(
    mass: FloatArray, spring: FloatArray, bounds: Bounds, law: SmallLaw, m: FloatArray, bends: FloatArray, mode: int,
    states: FloatArray, kept: NDArray[np.int16], lag: int, before: float, w: FloatArray, post: FloatArray,
    u: FloatArray, excess: FloatArray, x: State, z: tuple[float, float], root: float, last: float, k: int,
) -> tuple[int, int, State, tuple[float, float]]:  # fmt: skip
    """Simulate from period `k` while chords show that nothing happens.

    Return the first period of which that is not shown, where the controller has already run; how often it was at its
    limit; and both states. A chord needs the root energy: `root` bounds it in a period before under the torque `last`,
    and it grows by at most the change of the torque. For a torque that acts over whole periods, and a controller with
    at most two states.
    """
    begin, clipped, (m1, m2) = k, 0, _ways(mode)
    a00, a01, a10, a11, b0, b1, c0, c1, cut0, cut1, d, limit = law
    z0, z1 = z
    root = root if bends[mode, 2] == 1.0 else np.inf  # what grows is bounded over one period alone
    while k < w.size:
        at = np.uint64(k)
        raw = command = (w[at] + (c0 * z0 + c1 * z1)) + d * x[0]  # the position comes last, as it is known last
        next0 = (a00 * z0 + a01 * z1) + b0 * x[0]
        next1 = (a10 * z0 + a11 * z1) + b1 * x[0]
        if not abs(raw) <= limit:  # a branch: the limit stays out of the chain of operations from state to state
            command = min(max(raw, -limit), limit)
            cut, clipped = command - raw, clipped + 1
            next0, next1 = next0 + cut0 * cut, next1 + cut1 * cut
            if excess.shape[0] > 0:
                excess[at, 0] = cut
        z0, z1 = next0, next1
        u[at] = command
        s = before
        if lag == 0:
            s = command + post[at]
        elif k >= lag:
            s = u[np.uint64(k - lag)] + post[np.uint64(k - lag)]
        if states.shape[0] > 0:
            states[at, 0], states[at, 1], states[at, 2], states[at, 3] = x
        y = _move(m, mode, x, s)
        root, last = root + abs(s - last), s
        if not _stays(mass, spring, bounds, bends, mode, m1, m2, x, y, s, root):
            break
        x = y
        k += 1
    for i in range(begin, k if states.shape[0] > 0 else begin):
        kept[i] = mode
    return k, clipped, x, (z0, z1)


@inline_kernel
def ride(
    mass: FloatArray, spring: FloatArray, bounds: FloatArray, loop: SampledLoop, law: SmallLaw, small: bool,
    before: float, far: float, rates: FloatArray, moves: FloatArray, bends: FloatArray, mode: int, states: FloatArray,
    kept: NDArray[np.int16], q: FloatArray, v: FloatArray, z: FloatArray, fresh: FloatArray,
    cut: FloatArray, u: FloatArray, excess: FloatArray, counts: IntArray, k: int, part: int,
) -> tuple[int, int]:  # fmt: skip
    """Simulate on by maps while nothing happens; return the period, and its part, in which something may.

    The controller has run in that period. A small law, of which the torque acts over whole periods, goes along chords.
    """
    post, lags, output = loop.post[0], loop.lags[0], loop.output[0]
    x, root, s, nothing, keep = read_state(q, v), np.inf, 0.0, True, states.shape[0] > 0
    m1, m2 = _ways(mode)
    memory, within = (z[0, 0] if z.shape[1] > 0 else 0.0, z[0, 1] if z.shape[1] > 1 else 0.0), _bounds(bounds)
    while nothing and k < u.size:
        if small:
            k, clipped, x, memory = _follow_chords(
                mass, spring, within, law, moves, bends, mode, states, kept, lags[0], before, loop.w[0, 0], post, u,
                excess, x, memory, root, s, k,
            )  # fmt: skip
            counts[3] += clipped
        elif part == 0:
            u[k] = control_any(loop, 0, k, x[0], z, fresh, cut)
            if excess.shape[0] > 0:
                assign(excess[k], cut)
            counts[3] += 1 if cut[output] != 0.0 else 0
        if not (k < u.size and abs(x[0]) <= far and abs(u[k]) < np.inf):
            break
        while nothing and part < lags.size:
            at, source = k * lags.size + part, k - lags[part]
            s = u[source] + post[source] if source >= 0 else before
            if keep:
                kept[at] = mode
                states[at, 0], states[at, 1], states[at, 2], states[at, 3] = x
            here, root = mode * lags.size + part, _root_energy(mass, spring, rates, mode, x, s)
            y = _move(moves, here, x, s)
            nothing = _stays(mass, spring, within, bends, here, m1, m2, x, y, s, root)
            if nothing:
                x, part = y, part + 1
        if nothing:
            k, part = k + 1, 0
    write_state(x, q, v)
    for i in range(z.shape[1] if small else 0):
        z[0, i] = memory[1] if i > 0 else memory[0]
    return k, part


# The derivatives: a column moves by the map of its mode, and is pushed by what its parameter changes in that map. All
# that the loop over the periods goes on from is one array, with rows of a constant length: only then the compiler knows
# that nothing overlaps, and keeps to vector instructions.


@inline_kernel
def fill_tangent(
    masses: FloatArray, springs: FloatArray, seeds: Seeds, mode: int, lengths: FloatArray, rates: FloatArray,
    moves: FloatArray, moved: FloatArray,
) -> None:  # fmt: skip
    """Fill the maps of a mode, and their derivatives by LANES parameters by a complex step.

    Filled are `moves`, as by `enter_mode`, and `moved`, (modes * parts, INPUTS * 4 * LANES).
    """
    (m1, m2), nd, (where, band), bands = _ways(mode), masses.shape[0], (mode // MODES, 0), masses.shape[1]
    dmass, dspring = table(2 * LANES, kernels.MASS), table(LANES, kernels.MASS)
    bent, slopes = _complex_table(2, INPUTS), table(2, INPUTS)
    share1, share2 = abs(m1) / masses[0, 0, kernels.INERTIA], abs(m2) / masses[nd - 1, 0, kernels.INERTIA]
    for i in range(nd + springs.shape[0]):
        piece = where - springs.shape[1] + 1
        where, band = where // bands, where % bands if i < nd else abs(piece)
        for e in range(seeds.begin[i, band], seeds.begin[i, band + 1]):
            number, c, value = seeds.numbers[e], seeds.columns[e], seeds.values[e]
            if i < nd:
                dmass[2 * c + i, number] = value
            else:
                dspring[c, number] = -value if number == kernels.HELD and piece < 0 else value
    for c in range(LANES):
        fill_rates(dmass[2 * c :], dspring[c:], m1, m2, share1, share2, 0.0, slopes)
        for i in range(INPUTS):
            slope1 = slopes[0, i] - dmass[2 * c, kernels.INERTIA] * share1 * rates[mode, 0, i]
            slope2 = slopes[1, i] - dmass[2 * c + 1, kernels.INERTIA] * share2 * rates[mode, 1, i]
            bent[0, i], bent[1, i] = rates[mode, 0, i] + _STEP * slope1, rates[mode, 1, i] + _STEP * slope2
        for part in range(lengths.size):
            for i in range(INPUTS):
                x, b = unit_move(bent, m1, m2, i, lengths[part]), mode * lengths.size + part
                for row in range(4):
                    moves[b, i, row], moved[b, i * WIDE + row * LANES + c] = x[row].real, x[row].imag / _STEP.imag


@inline_kernel
def _read(s: FloatArray, dq: FloatArray, dv: FloatArray) -> None:
    """Read the derivatives of the state of one or two masses into the scratch."""
    two = dq.shape[0] > 1
    for c in range(LANES):
        s[_S + c], s[_S + LANES + c] = dq[0, c], dv[0, c]
        s[_S + 2 * LANES + c], s[_S + 3 * LANES + c] = dq[1, c] if two else dq[0, c], dv[1, c] if two else 0.0


@inline_kernel
def _write(s: FloatArray, dq: FloatArray, dv: FloatArray) -> None:
    """Write them back."""
    for i in range(dq.shape[0]):
        for c in range(LANES):
            dq[i, c], dv[i, c] = s[_S + 2 * i * LANES + c], s[_S + (2 * i + 1) * LANES + c]


@inline_kernel
def _step(s: FloatArray, m: FloatArray, moved: FloatArray, b: int, states: FloatArray, at: int, torque: float) -> None:
    """Move the derivatives over a part in which nothing happened."""
    wide_vectors()
    own, v1, stretch, v2 = np.uint64(b), states[at, 1], states[at, 2] - states[at, 0], states[at, 3]
    for i in range(WIDE):  # what the parameters change in the map, for the motion there is
        change = (moved[own, 4 * WIDE + i] + moved[own, i] * v1) + moved[own, WIDE + i] * stretch
        s[_T + i] = (change + moved[own, 2 * WIDE + i] * v2) + moved[own, 3 * WIDE + i] * torque
    p00, p01, p02, p03 = m[b, 0, 0], m[b, 0, 1], m[b, 0, 2], m[b, 0, 3]
    p10, p11, p12, p13 = m[b, 1, 0], m[b, 1, 1], m[b, 1, 2], m[b, 1, 3]
    p20, p21, p22, p23 = m[b, 2, 0], m[b, 2, 1], m[b, 2, 2], m[b, 2, 3]
    g0, g1, g2, g3 = m[b, 3, 0], m[b, 3, 1], m[b, 3, 2], m[b, 3, 3]
    for j in range(LANES):
        a0, a1, a2, a3 = s[_S + j], s[_S + LANES + j], s[_S + 2 * LANES + j], s[_S + 3 * LANES + j]
        a, d = a2 - a0, s[_D + j]
        s[_S + j] = ((((s[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
        s[_S + LANES + j] = (((s[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
        s[_S + 2 * LANES + j] = ((((s[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
        s[_S + 3 * LANES + j] = (((s[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d


@inline_kernel
def cross_slopes(
    s: FloatArray, m: FloatArray, moved: FloatArray, b: int, states: FloatArray, at: int, torque: float,
    dtorque: FloatArray, dq: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives over a part in which nothing happened, with those of the torque."""
    _read(s, dq, dv)
    for c in range(LANES):
        s[_D + c] = dtorque[c]
    _step(s, m, moved, b, states, at, torque)
    _write(s, dq, dv)


@inline_kernel
def glide_slopes(
    s: FloatArray, law: SmallLaw, m: FloatArray, moved: FloatArray, mode: int, k: int, end: int, lags: IntArray,
    before: float, states: FloatArray, u: FloatArray, post: FloatArray, explicit: FloatArray, columns: IntArray,
    dq: FloatArray, dv: FloatArray, dz: FloatArray, du: FloatArray,
) -> int:  # fmt: skip
    """Do what `control_slopes` and `cross_slopes` do, at once, in a mode, while no limit cuts.

    Return the next period. Nearly all periods are of this kind.
    """
    wide_vectors()
    a00, a01, a10, a11, b0, b1, c0, c1, _, _, direct, limit = law
    parts, b = lags.size, mode * lags.size
    _read(s, dq, dv)
    for i in range(dz.shape[0]):
        for c in range(LANES):
            s[_Z + i * LANES + c] = dz[i, c]
    while k < end and abs(u[k]) < limit:
        at = np.uint64(k)  # Numba looks for negative indices among the signed
        for i in range(columns.size):
            s[_EXPLICIT + columns[i]] = explicit[at, 0, i]
        for j in range(LANES):
            a0, z0, z1 = s[_S + j], s[_Z + j], s[_Z + LANES + j]
            s[_D + j] = (direct * a0 + s[_EXPLICIT + j]) + (c0 * z0 + c1 * z1)
            s[_Z + j], s[_Z + LANES + j] = b0 * a0 + (a00 * z0 + a01 * z1), b1 * a0 + (a10 * z0 + a11 * z1)
        for j in range(LANES):
            du[at, j] = s[_D + j]
        for part in range(parts):
            source = k - lags[part]
            acts, torque = np.uint64(max(source, 0)), u[source] + post[source] if source >= 0 else before
            for j in range(LANES):
                s[_D + j] = du[acts, j]
            _step(s, m, moved, b + part, states, k * parts + part, torque)
        k += 1
    _write(s, dq, dv)
    for i in range(dz.shape[0]):
        for c in range(LANES):
            dz[i, c] = s[_Z + i * LANES + c]
    return k
