"""Linear recurrences, compiled: the response of a sampled state-space system."""

from __future__ import annotations

from jointid.common.compiled import compiled
from jointid.data.record import FloatArray


@compiled
def respond(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: FloatArray, inputs: FloatArray, out: FloatArray
) -> None:
    """Fill ``out[k] = C z + D inputs[k]``, ``z+ = A z + B inputs[k]``; `z` is overwritten by the last state."""
    samples, width = inputs.shape
    order = z.size
    new = z.copy()
    for k in range(samples):
        value = 0.0
        for i in range(order):
            value += C[i] * z[i]
        for j in range(width):
            value += D[j] * inputs[k, j]
        out[k] = value
        for i in range(order):
            total = 0.0
            for j in range(order):
                total += A[i, j] * z[j]
            for j in range(width):
                total += B[i, j] * inputs[k, j]
            new[i] = total
        for i in range(order):
            z[i] = new[i]
