"""Recurrences, compiled: what a sampled law answers to given inputs, and the modes of a filter of many columns."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.compiled import compiled, inlined
from jointid.data.record import FloatArray

MODES = 4
"""Of the filter that is compiled: it has the order 8."""

Four: TypeAlias = tuple[float, float, float, float]

_NOTHING = 1e-200  # what falls below it is 0: near the smallest numbers many machines are a hundred times slower
_BLOCK = 16  # kept samples after which that is looked for


@inlined
def _four(values: FloatArray) -> Four:
    return values[0], values[1], values[2], values[3]


@inlined
def _let_go(states: FloatArray) -> None:
    """Take what is left of a signal that ended long ago for nothing."""
    for part in range(2):
        for i in range(MODES):
            for j in range(states.shape[2]):
                states[part, i, j] = states[part, i, j] if abs(states[part, i, j]) > _NOTHING else 0.0


@compiled
def add_modes(
    powers: FloatArray, weights: FloatArray, pushes: FloatArray, step: int, states: FloatArray, out: FloatArray
) -> None:
    """Move the modes of a filter from one kept sample to the next, and add what they say to each sample but the first.

    Args:
        powers: (2, MODES) real and imaginary part of what a mode is multiplied by from one kept sample to the next.
        weights: (2, MODES) of what a mode says: ``weights[0] * real - weights[1] * imaginary part``.
        pushes: (kept - 1, 2 MODES, columns) what the samples between add: real parts, then imaginary ones.
        step: 1 forwards, -1 backwards.
        states: (2, MODES, columns) at the first of the kept samples in that direction, then at the last.
        out: (kept, columns) is added to.

    One loop over the columns, whose every value is written once, as the compiler then keeps to vectors.
    """
    a, b, w, v = _four(powers[0]), _four(powers[1]), _four(weights[0]), _four(weights[1])
    real, imaginary = states[0], states[1]
    count = pushes.shape[0]
    for k in range(count):
        if k % _BLOCK == 0:
            _let_go(states)
        at = np.uint64(k if step > 0 else count - 1 - k)
        to = np.uint64(k + 1 if step > 0 else count - 1 - k)
        for j in range(out.shape[1]):
            r0, r1, r2, r3 = real[0, j], real[1, j], real[2, j], real[3, j]
            i0, i1, i2, i3 = imaginary[0, j], imaginary[1, j], imaginary[2, j], imaginary[3, j]
            s0, t0 = pushes[at, 0, j] + (a[0] * r0 - b[0] * i0), pushes[at, 4, j] + (b[0] * r0 + a[0] * i0)
            s1, t1 = pushes[at, 1, j] + (a[1] * r1 - b[1] * i1), pushes[at, 5, j] + (b[1] * r1 + a[1] * i1)
            s2, t2 = pushes[at, 2, j] + (a[2] * r2 - b[2] * i2), pushes[at, 6, j] + (b[2] * r2 + a[2] * i2)
            s3, t3 = pushes[at, 3, j] + (a[3] * r3 - b[3] * i3), pushes[at, 7, j] + (b[3] * r3 + a[3] * i3)
            real[0, j], real[1, j], real[2, j], real[3, j] = s0, s1, s2, s3
            imaginary[0, j], imaginary[1, j], imaginary[2, j], imaginary[3, j] = t0, t1, t2, t3
            first, second = w[0] * s0 - v[0] * t0 + (w[1] * s1 - v[1] * t1), w[2] * s2 - v[2] * t2
            out[to, j] += first + (second + (w[3] * s3 - v[3] * t3))


@compiled
def respond(
    starts: NDArray[np.int64],
    sources: NDArray[np.int64],
    weights: FloatArray,
    limits: FloatArray,
    gates: NDArray[np.int64],
    free: bool,
    z: FloatArray,
    inputs: FloatArray,
    excess: FloatArray,
    raw: FloatArray,
) -> None:
    """Fill `raw`, and `excess` unless it is given, period by period; `z` is overwritten by the last states.

    Args:
        starts: (phases, rows + 1) where each row of a phase begins among the weights; the rows are those of the
            elements, then those of the states.
        sources: (weights,) what a weight is of: the states, then the inputs, then the excesses.
        weights: (weights,) those that are not 0: a long delay is many states with one weight each.
        limits: (elements,) of the elements that are limits.
        gates: (elements,) the place of the limit a gate watches, negative for a limit.
        free: whether limits and gates act, so that the excess is found; else it is read.
        z: (states,).
        inputs: (periods, inputs).
        excess: (periods, elements) in, or out.
        raw: (periods, elements) out.
    """
    periods, width = inputs.shape
    phases, rows = starts.shape[0], starts.shape[1] - 1
    order, elements = z.size, limits.size
    now = np.zeros(order + width + elements)
    now[:order] = z
    new = np.zeros(order)
    for k in range(periods):
        phase = k % phases
        now[order : order + width] = inputs[k]
        for row in range(rows):
            total = 0.0
            for at in range(starts[phase, row], starts[phase, row + 1]):
                total += weights[at] * now[sources[at]]
            if row >= elements:
                new[row - elements] = total
                continue
            raw[k, row] = total
            if free:
                cut = 0.0
                if gates[row] >= 0:
                    if total * excess[k, gates[row]] < 0.0:
                        cut = -total
                elif abs(total) > limits[row]:
                    cut = np.copysign(limits[row], total) - total
                excess[k, row] = cut
            now[order + width + row] = excess[k, row]
        now[:order] = new
    z[:] = now[:order]
