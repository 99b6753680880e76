"""The inverse dynamics of a robot's measured motion as one linear regression: all joints' rows at all instants.

Signals go the way of one joint's (`problems.inverse_model`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.estimation.problems.inverse_model import (
    SMEAR,
    Inverse,
    MeasuredMotion,
    motion_along,
    steady_weights,
    through_window,
    torque_and_positions,
)
from jointid.estimation.robots.numbers import RobotParameters
from jointid.models.joints import RigidJoint
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.checks import find_record_warnings, range_faults, scale_faults
from jointid.records.columns import finite_faults
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, find_noise_limit

Records: TypeAlias = Sequence[Record] | Sequence[Sequence[Record]]
"""The records of a robot's joints from one log, or those of several logs."""


def each_log(records: Records) -> tuple[Sequence[Record], ...]:
    """Return the records of each log.

    Raises:
        RecordError: there are none.
        MethodError: they are records of one log and of several.
    """
    if not records:
        raise RecordError("A robot is identified from the records of its joints; received none.")
    if isinstance(records[0], Record):
        require_one_log(records)
        return (cast("Sequence[Record]", records),)
    if not all(isinstance(log, Sequence) for log in records):
        raise MethodError("Of several logs the records of the joints are lists; received a single record among them.")
    return tuple(cast("Sequence[Sequence[Record]]", records))


def require_one_log(records: Sequence[object]) -> None:
    """Require records of one log.

    Raises:
        MethodError: there are records of several logs, or something else.
    """
    if not all(isinstance(record, Record) for record in records):
        raise MethodError(
            "The records of the joints of one log are needed here, and these are no records, or of several logs: give "
            "those of one log."
        )


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


def require_torques(robot: Robot, torques: Iterable[FloatArray]) -> None:
    """Raise a `MethodError` if the torque, (samples,), of a joint is 0 throughout."""
    dead = [joint.name for joint, torque in zip(robot.joints, torques, strict=True) if not np.any(torque)]
    if dead:
        raise MethodError(f"The torque of {', '.join(dead)} is 0 throughout; log it, or leave its joint out.")


def motion_of_robot(
    robot: Robot,
    records: Sequence[Record],
    filtering: Filtering,
    said: str = "IDIM of a robot",
    model: str = "rigid",
    smear: float = SMEAR,
) -> MeasuredMotion:
    """Return the motion of a robot and its motors' torques.

    Args:
        robot: whose coupling takes the motors' positions to the joints'.
        records: of each joint, with torque and motor position behind the gear, on one clock.
        filtering: of positions and rows.
        said: the method, in the words of an error.
        model: of the joints, whose cut-offs are taken where there are none: "rigid" or "flexible".
        smear: periods of the position filter on each side of a rest or a reversal that are left out with it.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: a torque is 0 throughout.
    """
    require_one_log(records)
    if len(records) != len(robot):
        raise RecordError(f"A robot of {len(robot)} joints needs as many records; received {len(records)}.")
    channels, positions = [], []
    for joint, link, record in zip(robot.joints, robot.links, records, strict=True):
        try:
            torque, (position,) = torque_and_positions(record, RigidJoint(link.kind), ("motor_position",), said)
        except RecordError as error:
            raise RecordError([f"{joint.name}: {fault}" for fault in error.faults]) from error
        faults = [*finite_faults("torque", torque.values), *finite_faults("motor_position", position)]
        if faults:
            raise RecordError([f"{joint.name}: {fault}" for fault in faults])
        channels.append(torque)
        positions.append(position)
    require_torques(robot, [channel.values for channel in channels])
    clocks = {round(channel.sample_time, 12) for channel in channels}
    if len(clocks) > 1:
        raise RecordError(
            f"The torques of the joints come every {', '.join(f'{one:g}' for one in sorted(clocks))} s; expected one "
            "sample time: resample them."
        )
    sample_time, size = channels[0].sample_time, min(map(len, positions))
    motors = np.column_stack([position[:size] for position in positions])
    resolved = filtering.resolve(sample_time, model, find_noise_limit(motors.T, sample_time))
    motion = motion_along(channels, motors, resolved)
    assert resolved.position_cutoff is not None
    moving = [steady_weights(each, resolved.position_cutoff, sample_time, smear, few=0.0)[1] for each in motion.v.T]
    joints = np.linalg.inv(robot.coupling).T
    measured = motion.torque
    q, v, a = motion.q @ joints, motion.v @ joints, motion.a @ joints
    if payload := records[-1].payload:  # its torque is known
        carried = inverse_columns(robot, q, v, a)[:, :, -len(SYMBOLS) - len(robot) : -len(robot)] @ payload
        measured = measured - through_window(carried[:, :, np.newaxis], resolved)[:, :, 0]
    return replace(motion, q=q, v=v, a=a, torque=measured, moving=np.column_stack(moving))


def inverse_of_robot(robot: Robot, parameters: RobotParameters) -> Inverse:
    """Return the inverse model of a robot of rigid joints."""

    def columns(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return parameters.columns(robot, q, v, a)

    def measure(records: Sequence[Record], filtering: Filtering) -> MeasuredMotion:
        return motion_of_robot(robot, records, filtering)

    return Inverse((*parameters.names, *(one.name for one in parameters.fixed)), len(robot), columns, measure)
