"""Samples at rest or at a reversal, at which sticking friction does not follow ``Fc sign(v)``."""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray

REST = 0.02
"""Of the root mean square speed: a mass slower than that ..."""

_LONG = 3  # ... for so many samples rests, or sticks as it turns round
_REACH = 3  # samples on each side that the window smears a rest over
SAID = 0.02  # of a record: a larger share of rest is said
_REST_LONG = 20  # samples in a row that are a rest before filtered positions
SMEAR = 0.6  # of the position filter's period: from there on the errors of a filtered step add up to 0
_FEW = 0.1  # of the moving samples: if less were left without reversals, these stay


def moving_weights(velocity: FloatArray, long: int = _LONG, reach: int = _REACH) -> FloatArray:
    """Return 0 for the samples at which a mass rests, and 1 for the others.

    Args:
        velocity: (samples,).
        long: samples in a row that are a rest.
        reach: samples on each side that count with it.
    """
    speed = np.abs(velocity)
    slow = speed < REST * float(np.sqrt(np.mean(speed**2)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]])))
    weights = np.ones(speed.size)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start >= long:
            weights[max(start - reach, 0) : end + reach] = 0.0
    return weights


def turning_weights(velocity: FloatArray, reach: int = _REACH) -> FloatArray:
    """Return 0 for the samples about each at which a mass turns round, and 1 for the others.

    The sign of a filtered velocity changes some samples before or after the mass did, so rows there are off by up to
    twice the Coulomb friction, every time alike: far more than the noise of many a record.

    Args:
        velocity: (samples,).
        reach: samples on each side.
    """
    sign = np.sign(velocity)
    weights = np.ones(sign.size)
    for after in np.flatnonzero(sign[1:] != sign[:-1]) + 1:
        weights[max(after - reach, 0) : after + reach] = 0.0
    return weights


def steady_weights(
    velocity: FloatArray, cutoff: float, sample_time: float, smear: float = SMEAR, few: float = _FEW
) -> tuple[FloatArray, FloatArray]:
    """Return 0 for the samples at which a mass rests, else 1; and the same with those about reversals.

    At a reversal the acceleration jumps by the Coulomb friction. The position filter smears the jump, which looks like
    inertia: at 30 Hz it was 14 % of an inertia, and as much as half a sample of timing.

    Args:
        velocity: (samples,) of positions filtered with this cut-off.
        cutoff: Hz.
        sample_time: s.
        smear: periods of the filter on each side that are left out.
        few: share of the moving samples; if less were left without reversals, these stay.
    """
    reach = math.ceil(smear / (cutoff * sample_time))
    moving = moving_weights(velocity, max(_REST_LONG, 4 * reach), reach)
    steady = moving * turning_weights(velocity, reach)
    return moving, moving if np.mean(steady) < few * np.mean(moving) else steady
