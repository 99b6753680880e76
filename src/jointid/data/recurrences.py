"""Recurrences, compiled: what a sampled law answers to given inputs, and the modes of a filter of many columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.compiled import compiled
from jointid.data.record import FloatArray

_NOTHING = (
    1e-200  # what falls below it is 0: near the smallest numbers there are, many machines are a hundred times slower
)


@compiled
def add_modes(
    powers: FloatArray,
    weights: FloatArray,
    pushes: FloatArray,
    step: int,
    states: FloatArray,
    out: FloatArray,
) -> None:
    """Move the modes of a filter from one kept sample to the next, and add what they say to each sample but the first.

    Args:
        powers: (2, modes) real and imaginary part of what a mode is multiplied by from one kept sample to the next.
        weights: (2, modes) of what a mode says: ``weights[0] * real - weights[1] * imaginary part``.
        pushes: (kept - 1, 2 modes, columns) what the samples between add: real parts, then imaginary ones.
        step: 1 forwards, -1 backwards.
        states: (2, modes, columns) at the first of the kept samples in that direction, then at the last.
        out: (kept, columns) is added to.
    """
    count, modes, columns = pushes.shape[0], powers.shape[1], out.shape[1]
    for k in range(count):
        at = k if step > 0 else count - 1 - k
        to = at + 1 if step > 0 else at
        for i in range(modes):
            for j in range(columns):
                real, imaginary = states[0, i, j], states[1, i, j]
                real = real if abs(real) > _NOTHING else 0.0
                imaginary = imaginary if abs(imaginary) > _NOTHING else 0.0
                new = pushes[at, i, j] + (powers[0, i] * real - powers[1, i] * imaginary)
                imaginary = pushes[at, modes + i, j] + (powers[1, i] * real + powers[0, i] * imaginary)
                states[0, i, j], states[1, i, j] = new, imaginary
                out[to, j] += weights[0, i] * new - weights[1, i] * imaginary


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
