"""The kernel of a filter in second-order sections."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel

_NOTHING = 1e-200  # what falls below it is 0: near the smallest numbers many machines are a hundred times slower
_OFTEN = 256  # samples between two looks for such states


@compile_kernel
def filter_rows(sections: FloatArray, state: FloatArray, rows: FloatArray, step: int) -> None:
    """Filter columns, (samples, columns), in place: by a `step` of 1 forwards, of -1 backwards.

    Sections are four as `scipy.signal.sosfilt` takes them, `state`, (8, columns), initial, then final. Columns are
    innermost: a compiler filters several at once.
    """
    samples, columns = rows.shape
    a0, a1, a2, _, a3, a4 = sections[0]
    b0, b1, b2, _, b3, b4 = sections[1]
    c0, c1, c2, _, c3, c4 = sections[2]
    d0, d1, d2, _, d3, d4 = sections[3]
    z0, z1, z2, z3, z4, z5, z6, z7 = state[0], state[1], state[2], state[3], state[4], state[5], state[6], state[7]
    for first in range(0, samples, _OFTEN):
        state *= np.abs(state) > _NOTHING
        for k in range(first, min(first + _OFTEN, samples)):
            n = np.uint64(k if step > 0 else samples - 1 - k)  # Numba looks for negative indices among the signed
            for c in range(columns):
                x = rows[n, c]
                y = a0 * x + z0[c]
                z0[c], z1[c] = (a1 * x + z1[c]) - a3 * y, a2 * x - a4 * y
                x = b0 * y + z2[c]
                z2[c], z3[c] = (b1 * y + z3[c]) - b3 * x, b2 * y - b4 * x
                y = c0 * x + z4[c]
                z4[c], z5[c] = (c1 * x + z5[c]) - c3 * y, c2 * x - c4 * y
                x = d0 * y + z6[c]
                z6[c], z7[c] = (d1 * y + z7[c]) - d3 * x, d2 * y - d4 * x
                rows[n, c] = x
