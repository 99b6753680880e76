"""A period of a sampled law and of its derivatives, compiled."""

from __future__ import annotations

import math
from typing import TypeAlias

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, inline_kernel
from jointid.simulation.kernels import IntArray, SampledLoop

SmallLaw: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float, float, float]

NOTHING = 1e-200  # below it is 0: near the smallest numbers there are, many machines are a hundred times slower
OFTEN = 64  # periods after which that is checked


@inline_kernel
def small_law(loop: SampledLoop, nz: int) -> SmallLaw:
    """Return a law of one element, one phase and two states at most as numbers, which stay in registers.

    In this order: A by rows, what the position adds to the states, C, what the limit adds, D, and the limit. Of less
    than two states it is filled up with zeros.
    """
    A, b, c, f = loop.A[0, 0], loop.Bq[0, 0], loop.C[0, 0, 0], loop.F[0, 0]
    d, limit = loop.D[0, 0, 0], loop.limits[0, 0]
    if nz == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, d, limit
    if nz == 1:
        return A[0, 0], 0.0, 0.0, 0.0, b[0], 0.0, c[0], 0.0, f[0, 0], 0.0, d, limit
    return A[0, 0], A[0, 1], A[1, 0], A[1, 1], b[0], b[1], c[0], c[1], f[0, 0], f[1, 0], d, limit


@inline_kernel
def control_any(
    loop: SampledLoop, joint: int, k: int, q: float, z: FloatArray, new: FloatArray, cut: FloatArray
) -> float:
    """Evaluate a joint's law: return what it puts out, write what limits and gates took, and move its states.

    At its limit an element puts out that limit to the last bit: the derivatives ask whether it is there.
    """
    phase, nz = k % loop.A.shape[1] if loop.A.shape[1] > 1 else 0, z.shape[1]  # a division takes as long as the rest
    acts = 0.0
    for i in range(cut.size):
        value = loop.w[joint, i, k]
        for j in range(nz):
            value += loop.C[joint, phase, i, j] * z[joint, j]
        for j in range(i):
            value += loop.E[joint, phase, i, j] * cut[j]
        value += loop.D[joint, phase, i] * q  # the position comes last, as it is known last
        out, cut[i] = value, 0.0
        if loop.gates[joint, i] >= 0:
            if value * cut[loop.gates[joint, i]] < 0.0:
                out, cut[i] = 0.0, -value
        elif abs(value) > loop.limits[joint, i]:
            out = math.copysign(loop.limits[joint, i], value)
            cut[i] = out - value
        acts = out if i == loop.output[joint] else acts
    for i in range(nz):
        value = loop.Bq[joint, phase, i] * q
        if loop.driven.shape[1] > 0:
            value += loop.driven[joint, k, i]
        for j in range(nz):
            value += loop.A[joint, phase, i, j] * z[joint, j]
        for j in range(cut.size):
            value += loop.F[joint, phase, i, j] * cut[j]
        new[i] = value
    for i in range(nz):
        z[joint, i] = new[i]
    return acts


@inline_kernel
def _add(weight: float, rows: FloatArray, row: int, to: FloatArray, at: int) -> None:
    """Add a weighted row of derivatives to another."""
    for c in range(rows.shape[1] if weight != 0.0 else 0):
        to[at, c] += weight * rows[row, c]


@inline_kernel
def control_slopes(
    loop: SampledLoop, axis: int, own: int, step: int, excess: FloatArray, motor: int, dq: FloatArray, dzs: FloatArray,
    fresh: FloatArray, raw: FloatArray, taken: FloatArray, explicit: FloatArray, columns: IntArray, dlimits: FloatArray,
    command: FloatArray,
) -> None:  # fmt: skip
    """Write the derivatives of the output of any law in a period of its own, and move those of its states, `dzs`.

    Where a limit acts its value follows the limit alone, and where a gate is closed nothing passes. `dq` are those of
    the masses' positions, `excess` is what limits and gates take away; `fresh`, `raw` and `taken` are scratch.
    """
    elements, count, dz, output, phases = raw.shape[0], raw.shape[1], dzs[axis], loop.output[axis], loop.A.shape[1]
    phase, states = own % phases if phases > 1 else 0, dz.shape[0]
    for e in range(elements):
        for c in range(count):
            raw[e, c] = loop.D[axis, phase, e] * dq[motor, c]
        for i in range(columns.size):
            raw[e, columns[i]] += explicit[axis, own, e, i]
        for s in range(states):
            _add(loop.C[axis, phase, e, s], dz, s, raw, e)
        for other in range(e):
            _add(loop.E[axis, phase, e, other] if excess[axis, own, other] != 0.0 else 0.0, taken, other, raw, e)
        cut = excess[axis, own, e]
        sign = -math.copysign(1.0, cut) if loop.gates[axis, e] < 0 else 0.0
        for c in range(count if cut != 0.0 else 0):
            taken[e, c] = sign * dlimits[axis, e, c] - raw[e, c]
        for c in range(count if e == output else 0):
            command[axis, step, c] = raw[e, c] + (taken[e, c] if cut != 0.0 else 0.0)
    for s in range(states):
        for c in range(count):
            fresh[s, c] = loop.Bq[axis, phase, s] * dq[motor, c]
        for other in range(states):
            _add(loop.A[axis, phase, s, other], dz, other, fresh, s)
        for e in range(elements):
            _add(loop.F[axis, phase, s, e] if excess[axis, own, e] != 0.0 else 0.0, taken, e, fresh, s)
    for s in range(states):
        assign(dz[s], fresh[s])
