"""The step of an encoder, read off the positions it logged."""

from __future__ import annotations

import numpy as np

from jointid.records.record import Channel

_WHOLE = 0.05  # of a step: how far a position may be from a multiple of it
_MOSTLY = 0.95  # of the positions that are such multiples
_PARTS = 5  # steps that the smallest gap may be: an axis that never rests may skip some


def find_encoder_step(channel: Channel | None) -> float | None:
    """Return the step of the encoder that a position was read from, in its unit; None where none is to be seen.

    The smallest gap between two positions is a small whole number of steps, of which all other positions are multiples.
    """
    if channel is None:
        return None
    values = np.sort(channel.values) - channel.values.min()
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-12 * values[-1]]
    if not gaps.size:
        return None
    for parts in range(1, _PARTS + 1):
        step = float(gaps.min()) / parts
        if np.mean(np.abs(values / step - np.round(values / step)) < _WHOLE) >= _MOSTLY:
            return step
    return None
