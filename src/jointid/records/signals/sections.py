"""The kernel of a filter in second-order sections."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel, inline_kernel

LANES, STEPS = 8, 8
"""Columns of an array that is filtered, as in a vector of 512 bits; its rows are a multiple of the steps."""
_NOTHING = 1e-200  # what falls below it is 0: near the smallest numbers many machines are a hundred times slower
_OFTEN = 32 * STEPS * LANES  # numbers between two looks for such states


@inline_kernel
def _filter_steps(
    sections: FloatArray, state: FloatArray, rows: FloatArray, out: FloatArray, at: int, columns: int
) -> None:
    """Filter some samples; a compiler unrolls their loop first, and then turns that over columns into vectors."""
    a0, a1, a2, _, a3, a4 = sections[0]
    b0, b1, b2, _, b3, b4 = sections[1]
    c0, c1, c2, _, c3, c4 = sections[2]
    d0, d1, d2, _, d3, d4 = sections[3]
    end = rows.size - at
    for c in range(columns):
        z0, z1, z2, z3 = state[c], state[LANES + c], state[2 * LANES + c], state[3 * LANES + c]
        z4, z5, z6, z7 = state[4 * LANES + c], state[5 * LANES + c], state[6 * LANES + c], state[7 * LANES + c]
        for i in range(0, STEPS * LANES, LANES):
            x = rows[np.uint64(at + i + c)]  # Numba looks for negative indices among the signed
            y = a0 * x + z0
            z0, z1 = (a1 * x + z1) - a3 * y, a2 * x - a4 * y
            x = b0 * y + z2
            z2, z3 = (b1 * y + z3) - b3 * x, b2 * y - b4 * x
            y = c0 * x + z4
            z4, z5 = (c1 * x + z5) - c3 * y, c2 * x - c4 * y
            x = d0 * y + z6
            z6, z7 = (d1 * y + z7) - d3 * x, d2 * y - d4 * x
            out[np.uint64(end - LANES - i + c)] = x
        state[c], state[LANES + c], state[2 * LANES + c], state[3 * LANES + c] = z0, z1, z2, z3
        state[4 * LANES + c], state[5 * LANES + c], state[6 * LANES + c], state[7 * LANES + c] = z4, z5, z6, z7


@compile_kernel
def filter_reversed(sections: FloatArray, state: FloatArray, rows: FloatArray, out: FloatArray, columns: int) -> None:
    """Filter one column, or all, of flat rows, (samples, LANES), and write them in reverse order.

    Sections are four as `scipy.signal.sosfilt` takes them, `state`, (8 LANES,), initial, then final.
    """
    for at in range(0, rows.size, STEPS * LANES):
        if at % _OFTEN == 0:
            state *= np.abs(state) > _NOTHING
        _filter_steps(sections, state, rows, out, at, columns)
