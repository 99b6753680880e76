"""The kernel of a sampled law in periods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel


@compile_kernel
def respond(
    starts: NDArray[np.int32],
    sources: NDArray[np.int32],
    weights: FloatArray,
    limits: FloatArray,
    gates: NDArray[np.int64],
    free: bool,
    z: FloatArray,
    inputs: FloatArray,
    excess: FloatArray,
    raw: FloatArray,
) -> None:
    """Compute `raw`, and `excess` unless given, by period from state `z`.

    Args:
        starts: (phases * rows + 1,) of a sparse matrix, whose rows are the elements, then the states, of each phase.
        sources: (weights,) its columns: states, then inputs, then excesses.
        weights: (weights,) its values.
        limits: (elements,) values of the limits.
        gates: (elements,) index of the limit that a gate watches, negative for a limit.
        free: whether limits and gates act and `excess` is computed.
        z: (states,).
        inputs: (periods, inputs).
        excess: (periods, elements) in, or out.
        raw: (periods, elements) out.
    """
    elements, order = limits.size, z.size
    rows, known = elements + order, order + inputs.shape[1]
    now, new = np.zeros(known + elements), np.zeros(rows)
    assign(now[:order], z)
    for k in range(len(inputs)):
        first = k * rows % (starts.size - 1)
        assign(now[order:known], inputs[k])
        for row in range(rows):
            total = 0.0
            for at in range(starts[first + row], starts[first + row + 1]):
                total += weights[at] * now[sources[at]]
            new[row] = total
            if row < elements:
                if free:
                    cut = 0.0
                    if gates[row] >= 0:
                        if total * excess[k, gates[row]] < 0.0:
                            cut = -total
                    elif abs(total) > limits[row]:
                        cut = np.copysign(limits[row], total) - total
                    excess[k, row] = cut
                now[known + row] = excess[k, row]
        assign(raw[k], new[:elements])
        assign(now[:order], new[elements:])
