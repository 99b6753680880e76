"""Warnings on the record of an estimate: faults of the log, gains that look swapped."""

from __future__ import annotations

import math

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.text import number
from jointid.estimation.result.parts import EstimateParts
from jointid.estimation.robots.regression import Records, each_log
from jointid.models.controllers import Cascade, Controller
from jointid.models.robots.robot import Robot
from jointid.records.checks import find_record_warnings, range_faults, scale_faults
from jointid.records.record import Channel, Record


def record_warnings(record: Record, estimate: EstimateParts) -> tuple[str, ...]:
    """Return warnings on the record of an estimate, one sentence each."""
    return find_record_warnings(record, estimate.data.channels)


def robot_record_warnings(records: Records, robot: Robot) -> tuple[str, ...]:
    """Return warnings on the records of a robot's joints, one sentence each, which names its joint."""
    found = (
        f"{name}: {said}"
        for log in each_log(records)
        for name, record in zip(robot.names, log, strict=False)
        for said in find_record_warnings(record, record.channels)
    )
    return tuple(dict.fromkeys(found))


def check_robot_records(records: Records, robot: Robot) -> None:
    """Check the units and scales of the records of a robot's joints, also by the limits of its model.

    Raises:
        RecordError: one cannot be in its units; each sentence names its joint.
    """
    back = np.linalg.inv(robot.coupling)
    faults = []
    for log in each_log(records):
        for k, (name, record) in enumerate(zip(robot.names, log, strict=False)):
            faults += [f"{name}: {said}" for said in scale_faults(record)]
            limits, alone = robot.links[k].limits, np.count_nonzero(back[k]) == 1
            position = record.motor_position or record.reference
            if limits is not None and alone and position is not None:
                faults += [f"{name}: {said}" for said in range_faults(position, limits)]
    if faults:
        raise RecordError(dict.fromkeys(faults))


_EVERY = 0.01  # s: a rounded reference is accelerated in every one of its own samples
_STEADY = 0.02  # of the greatest acceleration
_OFTEN = 0.2  # of the samples are steady, or a lag is no sign
_FAR, _NEAR = 0.25, 0.15  # of the travel: so far behind is no drive, and much nearer the other gain has to bring it


def ask_about_gains(controller: Controller | None, reference: Channel | None) -> str | None:
    """Return a question about gains that look swapped; None where they do not.

    A position loop without feed-forward follows its reference like a first-order lag whose time constant is 1 /
    position_gain. The gains are questioned if the axis would be far from a steady reference, and near it with the
    velocity gain in that place. A reference that is never steady, as a multisine, shows nothing of this.

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
