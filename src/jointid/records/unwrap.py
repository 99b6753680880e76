"""What logging does to a signal: a counter that wraps round, values logged again before they are refreshed, steps."""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray

SAFE_STEP = 0.4
"""Share of a wrap that one sample may move: from a half on, forwards and backwards cannot be told apart."""

_WHOLE = 1e-2  # how near to a whole number of samples, or of steps, counts as one
_GRAIN = 1e-12  # of the travel: what is nearer than this is one value that was computed twice
_CHANGES = 20  # fewer changes than this do not show a rhythm


def unwrapped(values: FloatArray, wrap: float) -> FloatArray:
    """Return a position that wraps round as one that does not, (samples,); each step is taken the short way."""
    steps = np.diff(values)
    return np.asarray(values - wrap * np.concatenate([[0.0], np.cumsum(np.round(steps / wrap))]))


def wrap_faults(name: str, values: FloatArray, wrap: float) -> list[str]:
    """Return the faults of raw values, (samples,), that do not fit their wrap, or move too fast to be unwrapped."""
    span = float(np.ptp(values))
    if span > wrap * (1 + _WHOLE):
        return [f"{name} spans {span:g}, more than its wrap of {wrap:g}; correct the wrap, or leave it out."]
    steps = np.abs(np.diff(unwrapped(values, wrap)))
    fast = np.flatnonzero(steps > SAFE_STEP * wrap)
    if fast.size == 0:
        return []
    return [
        f"{name} moves by {steps[fast[0]] / wrap:.2f} of its wrap of {wrap:g} after sample {fast[0]} (at most "
        f"{SAFE_STEP:g} can be told from a move backwards); log it more often, or correct the wrap."
    ]


def refreshed(name: str, values: FloatArray, period: float, update_time: float) -> tuple[int, int, list[str]]:
    """Return (every, phase, faults): a value is refreshed at samples phase, phase + every, ...

    Args:
        name: what the sentences call the values.
        values: (samples,) as logged.
        period: time between samples [s].
        update_time: time between refreshes [s], as declared.
    """
    ratio = update_time / period
    every = round(min(ratio, 1e9))
    if every < 1 or abs(ratio / every - 1) > _WHOLE:
        return (
            1,
            0,
            [
                f"{name} has an update time of {update_time:g} s, which is {ratio:.4g} of its samples of {period:g} s; "
                "expected a whole number of them: correct one of the two."
            ],
        )
    changes = np.flatnonzero(np.diff(values)) + 1
    if changes.size == 0:
        return every, 0, []
    phases = np.bincount(changes % every, minlength=every)
    phase = int(np.argmax(phases))
    wrong = changes[changes % every != phase]
    if wrong.size:
        fault = (
            f"{name} is said to be refreshed every {every} samples, but {wrong.size} of its {changes.size} changes "
            f"come between, the first at sample {wrong[0]}; correct update_time, or leave it out."
        )
        return every, phase, [fault]
    rhythm = changing_every(values)
    if rhythm > every:
        fault = (
            f"{name} is said to be refreshed every {every} samples, but changes only every {rhythm}; set update_time = "
            f"{rhythm * period:g}."
        )
        return every, phase, [fault]
    return every, phase, []


def changing_every(values: FloatArray) -> int:
    """Return the number of samples after which, and only then, a signal (samples,) changes; 1 if no such number."""
    changes = np.flatnonzero(np.diff(values))
    return int(np.gcd.reduce(np.diff(changes))) if changes.size >= _CHANGES else 1


def quantum(values: FloatArray) -> float | None:
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
