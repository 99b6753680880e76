"""Gains that look swapped, as the numbers of a joint file and the reference alone show it, without a simulation.

A position loop without feed-forward follows its reference like a first-order lag whose time constant is 1 /
position_gain. Where the axis would be far from a reference that rests or moves steadily, and near it with the velocity
gain in that place, the two are asked about. A reference that never does either, as a multisine, shows nothing of this.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.text import number
from jointid.models.controllers import Cascade, Controller
from jointid.records.record import Channel

_EVERY = 0.01  # s: a rounded reference is accelerated in every one of its own samples
_STEADY = 0.02  # of the greatest acceleration
_OFTEN = 0.2  # of the samples are steady, or a lag is no sign
_FAR, _NEAR = 0.25, 0.15  # of the travel: so far behind is no drive, and much nearer the other gain has to bring it


def ask_about_gains(controller: Controller | None, reference: Channel | None) -> str | None:
    """Return a question about gains that look swapped; None where they do not.

    Args:
        controller: as it is declared.
        reference: of the record.
    """
    if not isinstance(controller, Cascade) or controller.velocity_feedforward or reference is None:
        return None
    lag = _lag(reference, controller.position_gain)
    other = _lag(reference, controller.velocity_gain)
    if not (lag > _FAR and other < _NEAR):
        return None
    return (
        f"position_gain is {number(controller.position_gain, 3)} 1/s, with which the axis would stay "
        f"{100 * lag:.0f} % of its travel away from where the reference rests or moves steadily; with velocity_gain in "
        f"its place it would be {number(100 * other, 1)} %: are the two swapped? position_gain is of the position "
        "loop, a drive's Kv, velocity_gain of the velocity loop, its Kp"
    )


def _lag(reference: Channel, gain: float) -> float:
    """Return the rms lag error at constant speed, as a share of the travel."""
    from scipy.signal import lfilter  # takes a while, and most commands need none

    every = max(round(_EVERY / reference.sample_time), 1)
    values = reference.values[::every] - reference.values[0]
    bent, travel = np.abs(np.diff(values, 2)), float(np.ptp(values))
    if not (bent.size and gain > 0 and np.isfinite(travel) and travel > 0):
        return math.nan
    steady = np.concatenate([[False], bent < _STEADY * np.max(bent), [False]])
    if np.mean(steady) < _OFTEN:
        return math.nan
    kept = math.exp(-gain * every * reference.sample_time)
    away = values - lfilter([1.0 - kept], [1.0, -kept], values)
    return float(np.sqrt(np.mean(away[steady] ** 2))) / travel
