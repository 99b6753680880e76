"""The identification of a robot: the method follows from what moves it, as for a joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.estimation.robots.idim import RobotEstimate, RobotIDIM, identify_robot
from jointid.estimation.robots.torque_estimate import (
    RobotDIDIM,
    RobotDriveSideFit,
    RobotTorqueEstimate,
    identify_robot_drive_side,
    identify_robot_from_torques,
)
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop

RobotMethod: TypeAlias = RobotIDIM | RobotDIDIM | RobotDriveSideFit


def fit_robot(
    records: Sequence[Record],
    model: Robot | RobotLoop | RobotDriveSide,
    method: object = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> RobotEstimate | RobotTorqueEstimate:
    """Return the estimate of a robot; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model.
    """
    robot = model if isinstance(model, Robot) else model.robot
    if isinstance(model, RobotDriveSide) and isinstance(method, RobotDriveSideFit | None):
        return identify_robot_drive_side(robot, records, method, filtering=filtering, progress=progress)
    if isinstance(model, RobotLoop) and isinstance(method, RobotDIDIM | None):
        return identify_robot_from_torques(model, records, method, filtering=filtering, progress=progress)
    if isinstance(model, Robot | RobotLoop) and isinstance(method, RobotIDIM | None):
        loop = model if isinstance(model, RobotLoop) else None
        return identify_robot(robot, records, method, filtering=filtering, loop=loop)
    raise MethodError(
        f"{type(method).__name__} is not for a {type(model).__name__}; use RobotIDIM for a Robot, RobotDIDIM for a "
        "RobotLoop, or RobotDriveSideFit for a RobotDriveSide."
    )
