"""A period of a sampled law and of its derivatives, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.simulation.kernels.tables import Feedback

NOTHING = 1e-200  # below it is 0: near the smallest numbers there are, many machines are a hundred times slower
OFTEN = 64  # periods after which that is checked
_LINE = 8  # numbers of a cache line


class SmallLaw(NamedTuple):
    """A feedback of one element, one phase and two states at most, as numbers, which stay in registers."""

    a00: float
    a01: float
    a10: float
    a11: float
    b0: float
    b1: float
    c0: float
    c1: float
    f0: float
    f1: float
    d: float
    limit: float


@inline_kernel
def small_law(feedback: Feedback, nz: int) -> SmallLaw:
    """Return a feedback of two states at most as numbers, filled up with zeros."""
    A, b, c, f = np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.zeros(2)
    for i in range(nz):
        b[i], c[i], f[i] = feedback.Bq[0, 0, i], feedback.C[0, 0, 0, i], feedback.F[0, 0, i, 0]
        for j in range(nz):
            A[i, j] = feedback.A[0, 0, i, j]
    d, limit = feedback.D[0, 0, 0], feedback.limits[0, 0]
    return SmallLaw(A[0, 0], A[0, 1], A[1, 0], A[1, 1], b[0], b[1], c[0], c[1], f[0], f[1], d, limit)


@inline_kernel
def control_any(
    feedback: Feedback, joint: int, w: FloatArray, k: int, q: float, z: FloatArray, new: FloatArray, out: FloatArray,
    cut: FloatArray,
) -> None:  # fmt: skip
    """Evaluate a joint's law: write what its elements put out and what limits and gates took; move its states.

    At its limit an element puts out that limit to the last bit: the derivatives ask whether it is there.
    """
    phase, nz = k % feedback.A.shape[1], z.shape[1]
    for i in range(cut.size):
        value = w[joint, i, k] + feedback.D[joint, phase, i] * q
        for j in range(nz):
            value += feedback.C[joint, phase, i, j] * z[joint, j]
        for j in range(i):
            value += feedback.E[joint, phase, i, j] * cut[j]
        out[i], cut[i] = value, 0.0
        if feedback.gates[joint, i] >= 0:
            if value * cut[feedback.gates[joint, i]] < 0.0:
                out[i], cut[i] = 0.0, -value
        elif abs(value) > feedback.limits[joint, i]:
            out[i] = math.copysign(feedback.limits[joint, i], value)
            cut[i] = out[i] - value
    for i in range(nz):
        value = feedback.Bq[joint, phase, i] * q
        if feedback.driven.shape[1] > 0:
            value += feedback.driven[joint, k, i]
        for j in range(nz):
            value += feedback.A[joint, phase, i, j] * z[joint, j]
        for j in range(cut.size):
            value += feedback.F[joint, phase, i, j] * cut[j]
        new[i] = value
    for i in range(nz):
        z[joint, i] = new[i]


@compile_kernel
def control_slopes(
    laws: Feedback, axis: int, own: int, cut: FloatArray, moved: FloatArray, dz: FloatArray, fresh: FloatArray,
    raw: FloatArray, taken: FloatArray, explicit: FloatArray, first: int, dlimits: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Write the derivatives of the output of any law in a period of its own, and move those of its states, `dz`.

    Where a limit acts its value follows the limit alone, and where a gate is closed nothing passes. `moved` are those
    of the motor's position, `cut` is what limits and gates take away; `fresh`, `raw` and `taken` are scratch.
    """
    phase, elements, states, count = own % laws.A.shape[1], cut.size, len(dz), moved.size
    A, F, C, E = laws.A[axis, phase], laws.F[axis, phase], laws.C[axis, phase], laws.E[axis, phase]
    for e in range(elements):
        for c in range(count):
            raw[e, c] = laws.D[axis, phase, e] * moved[c]
        for i in range(explicit.shape[2]):
            raw[e, first + i] += explicit[own, e, i]
        for s in range(states):
            weight = C[e, s]
            if weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * dz[s, c]
        for other in range(e):
            weight = E[e, other]
            if cut[other] != 0.0 and weight != 0.0:
                for c in range(count):
                    raw[e, c] += weight * taken[other, c]
        if cut[e] != 0.0:
            sign = -math.copysign(1.0, cut[e]) if laws.gates[axis, e] < 0 else 0.0
            for c in range(count):
                taken[e, c] = sign * dlimits[e, c] - raw[e, c]
        if e == laws.output[axis]:
            for c in range(count):
                out[c] = raw[e, c] + (taken[e, c] if cut[e] != 0.0 else 0.0)
    for s in range(states):
        for c in range(count):
            fresh[s, c] = laws.Bq[axis, phase, s] * moved[c]
        for other in range(states):
            weight = A[s, other]
            if weight != 0.0:
                for c in range(count):
                    fresh[s, c] += weight * dz[other, c]
        for e in range(elements):
            weight = F[s, e]
            if cut[e] != 0.0 and weight != 0.0:
                for c in range(count):
                    fresh[s, c] += weight * taken[e, c]
    for s in range(states):
        assign(dz[s], fresh[s])


@inline_kernel
def aligned_zeros(size: int) -> FloatArray:
    """Return so many zeros that begin with a line of the cache, as every row of a wide vector then does."""
    room = np.zeros(size + _LINE)
    first = (-(room.ctypes.data // 8)) % _LINE
    return room[first : first + size]
