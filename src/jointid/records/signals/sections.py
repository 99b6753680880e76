"""The kernel of a filter in second-order sections."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel

_NOTHING = 1e-200  # what falls below it is 0: near the smallest numbers many machines are a hundred times slower
_OFTEN = 512  # samples between two looks for such states


@compile_kernel
def filter_rows(sections: FloatArray, state: FloatArray, rows: FloatArray, step: int) -> None:
    """Filter columns in place.

    Args:
        sections: (sections, 6) as `scipy.signal.sosfilt` takes them.
        state: (sections, 2, columns) initial, then final.
        rows: (samples, columns).
        step: 1 forwards, -1 backwards.
    """
    samples, columns = rows.shape
    for k in range(samples):
        n = k if step > 0 else samples - 1 - k
        for s in range(sections.shape[0]):
            if k % _OFTEN == 0:
                state[s] *= np.abs(state[s]) > _NOTHING
            b0, b1, b2, _, a1, a2 = sections[s]
            for c in range(columns):
                x = rows[n, c]
                y = b0 * x + state[s, 0, c]
                state[s, 0, c] = b1 * x - a1 * y + state[s, 1, c]
                state[s, 1, c] = b2 * x - a2 * y
                rows[n, c] = y
