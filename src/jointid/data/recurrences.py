"""Recurrences with limits inside, compiled: what a sampled law answers to given inputs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.compiled import compiled
from jointid.data.record import FloatArray


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
