"""Positions as an encoder counts them: unwrapped, and the step that a signal is rounded to."""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.record import Channel

SAFE_STEP = 0.4
"""Share of a wrap that one sample may move: from a half on, forwards and backwards cannot be told apart."""

_WHOLE = 1e-2  # how near to a whole number of samples, or of steps, counts as one
_GRAIN = 1e-12  # of the travel: what is nearer than this is one value that was computed twice
_MULTIPLE = 0.05  # of a step: how far a position may be from a multiple of it
_MOSTLY = 0.95  # of the positions that are such multiples
_PARTS = 5  # steps that the smallest gap may be: an axis that never rests may skip some


def unwrap(values: FloatArray, wrap: float) -> FloatArray:
    """Return a position that wraps round as one that does not, (samples,); each step is taken the short way."""
    steps = np.diff(values)
    return np.asarray(values - wrap * np.concatenate([[0.0], np.cumsum(np.round(steps / wrap))]))


def wrap_faults(name: str, values: FloatArray, wrap: float) -> list[str]:
    """Return the faults of raw values, (samples,), that do not fit their wrap, or move too fast to be unwrapped."""
    span = float(np.ptp(values))
    if span > wrap * (1 + _WHOLE):
        return [f"{name} spans {span:g}, more than its wrap of {wrap:g}; correct the wrap, or leave it out."]
    steps = np.abs(np.diff(unwrap(values, wrap)))
    fast = np.flatnonzero(steps > SAFE_STEP * wrap)
    if fast.size == 0:
        return []
    return [
        f"{name} moves by {steps[fast[0]] / wrap:.2f} of its wrap of {wrap:g} after sample {fast[0]} (at most "
        f"{SAFE_STEP:g} can be told from a move backwards); log it more often, or correct the wrap."
    ]


def find_quantum(values: FloatArray) -> float | None:
    """Return the step that values (samples,) are rounded to; None where they are not, or too finely to be told."""
    grain = float(np.ptp(values)) * _GRAIN
    if not (math.isfinite(grain) and grain > 0):
        return None
    distinct = np.unique(np.round((values - values.min()) / grain))
    gaps = np.diff(distinct)
    step = float(gaps.min())
    # Euclid's algorithm; a grain more or less in the step must not become a hundredth of it in the widest gap.
    while gaps.max() <= _WHOLE * step**2:
        rest = np.abs(gaps - np.round(gaps / step) * step)
        if rest.max() <= _WHOLE * step:
            return step * grain
        step = float(rest[rest > _WHOLE * step].min())
    return None


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
        if np.mean(np.abs(values / step - np.round(values / step)) < _MULTIPLE) >= _MOSTLY:
            return step
    return None
