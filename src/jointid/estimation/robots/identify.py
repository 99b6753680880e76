"""The identification of a robot: the method follows from what moves it, as for a joint."""

from __future__ import annotations

from collections.abc import Sequence

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import Method
from jointid.estimation.robots.idim import RobotEstimate, identify_robot
from jointid.estimation.robots.torque_estimate import (
    RobotTorqueEstimate,
    identify_robot_drive_side,
    identify_robot_from_torques,
)
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop


def fit_robot(
    records: Sequence[Record],
    model: Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> RobotEstimate | RobotTorqueEstimate:
    """Return the estimate of a robot; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model.
    """
    robot = model if isinstance(model, Robot) else model.robot
    if method is not None:
        method.require_settings_of("robot")
    if isinstance(method, IDIM) and method.effects:
        raise MethodError("IDIM.effects are of a joint, and this is a robot; leave them out.")
    if isinstance(model, RobotDriveSide) and isinstance(method, DriveSideFit | None):
        return identify_robot_drive_side(robot, records, method, filtering=filtering, progress=progress)
    if isinstance(model, RobotLoop) and isinstance(method, DIDIM | None):
        return identify_robot_from_torques(model, records, method, filtering=filtering, progress=progress)
    if isinstance(model, Robot | RobotLoop) and isinstance(method, IDIM | None):
        loop = model if isinstance(model, RobotLoop) else None
        return identify_robot(robot, records, method, filtering=filtering, loop=loop)
    raise MethodError(
        f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM for a Robot, DIDIM for a "
        "RobotLoop, or DriveSideFit for a RobotDriveSide."
    )
