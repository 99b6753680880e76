"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.estimation.identify_log import identify_log
from jointid.estimation.identify_record import identify_record
from jointid.estimation.identify_several import identify_several
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import Method
from jointid.estimation.outputs import fit_outputs, state_scale
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.problems.several_records import SeveralRecords
from jointid.estimation.record_warnings import ask_about_gains, check_robot_records, robot_record_warnings
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import Records, each_log, in_logs
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.unknown_timing import fit_unstated_timing
from jointid.models.joints import ClosedLoop, Joint, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide, OpenLoop
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop


def fit(
    record: Record | Records | LongRecord,
    model: ClosedLoop | DriveSide | OpenLoop | Joint | Sequence[ClosedLoop] | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: SeveralRecords | None = None,
    windows: Windowing | None = None,
    progress: Progress = ignore_progress,
) -> FitResult:
    """Return the fit of a joint or a robot, without the checks; see `jointid.identify`."""
    if isinstance(model, Robot | RobotLoop | RobotDriveSide):
        if isinstance(record, Record):
            raise MethodError(
                "A robot is identified from the record of each of its joints; received one: give them all."
            )
        if not isinstance(record, Sequence) or several or windows:
            raise MethodError(
                "A robot is identified from the records of its joints, without SeveralRecords or windows; give the "
                "records alone."
            )
        found = fit_robot(record, model, method, filtering=filtering, parameters=parameters, progress=progress)
        robot = model if isinstance(model, Robot) else model.robot
        return replace(found, after=robot_record_warnings(record, robot))
    single = isinstance(record, Record) and windows is None
    if isinstance(method, DIDIM) and method.outputs and not single:
        raise MethodError(
            "The outputs of DIDIM are chosen for one record; received several, or windows: leave outputs out, or "
            "compute the torques by compute_controller_torque."
        )
    if isinstance(record, Sequence):
        if not all(isinstance(one, Record) for one in record):
            raise MethodError("Several records of a joint are a list of records; received something else in it.")
        record = cast("Sequence[Record]", record)
        if windows is not None:
            raise MethodError("Several records are identified whole; give one record or log, or leave out windows.")
        if not isinstance(model, ClosedLoop | Sequence):
            raise MethodError(
                "Several records are identified by simulating their loop; give a ClosedLoop, with the controller."
            )
        settings = several or SeveralRecords()
        return state_scale(identify_several(record, model, settings, method, filtering, parameters, progress), record)
    if several is not None:
        raise MethodError("SeveralRecords is about a list of records; received one record: give a list of them.")
    if isinstance(record, Record) and windows is None:
        if isinstance(model, Sequence):
            raise MethodError("One record has one loop; received a list: give the loop, or a list of records.")
        return _fit_single(record, model, method, filtering, parameters, progress)
    if not isinstance(model, ClosedLoop):
        raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop, with the controller.")
    source = InMemory(record) if isinstance(record, Record) else record
    return identify_log(source, model, windows or Windowing(), method, filtering, parameters, progress)


def _fit_single(
    record: Record,
    model: ClosedLoop | DriveSide | OpenLoop | Joint,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    progress: Progress,
) -> FitResult:
    """Return the fit of one record."""
    asked = ask_about_gains(model.controller, record.reference) if isinstance(model, ClosedLoop) else None
    if asked is not None:
        progress(asked)

    def fit_single(records: Sequence[Record]) -> FitResult:
        return identify_record(records[0], model, method, filtering=filtering, parameters=parameters, progress=progress)

    def fit_timed(records: Sequence[Record]) -> FitResult:
        return state_scale(fit_unstated_timing(records, fit_single), records)

    if isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None):
        found = fit_outputs([record], [model], () if method is None else method.outputs, fit_timed)
    else:
        found = fit_timed([record])
    return found if asked is None else replace(found, before=(asked, *found.before))


def fit_robot(
    records: Records,
    model: Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> FitResult:
    """Return the fit of a robot, without the checks; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model.
    """
    known, robot = parameters or {}, model if isinstance(model, Robot) else model.robot
    require_friction(robot, known)
    check_robot_records(records, robot)
    if method is not None:
        method.require_settings_of("robot")
    if isinstance(method, IDIM) and method.effects:
        raise MethodError("IDIM.effects are of a joint, and this is a robot; leave them out.")

    def of_logs(read: Sequence[Record]) -> FitResult:
        logs = in_logs(read, records)
        if isinstance(model, RobotDriveSide) and isinstance(method, DriveSideFit | None):
            return identify_simulated_robot(model, logs, method, filtering=filtering, known=known, progress=progress)
        if isinstance(model, RobotLoop) and isinstance(method, DIDIM | None):
            return identify_simulated_robot(model, logs, method, filtering=filtering, known=known, progress=progress)
        if isinstance(model, Robot | RobotLoop) and isinstance(method, IDIM | None):
            return identify_robot(model, logs, method, filtering=filtering, known=known)
        raise MethodError(
            f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM for a Robot, DIDIM for a "
            "RobotLoop, or DriveSideFit for a RobotDriveSide."
        )

    every = [record for log in each_log(records) for record in log]

    def fit_timed(read: Sequence[Record]) -> FitResult:
        return state_scale(fit_unstated_timing(read, of_logs), read)

    if not isinstance(model, RobotLoop) or not isinstance(method, DIDIM | None):
        return fit_timed(every)
    axes = zip(robot.links, model.controllers, strict=True)
    loops = [ClosedLoop(RigidJoint(link.kind), law) for link, law in axes] * (len(every) // len(robot.links))
    return fit_outputs(every, loops, () if method is None else method.outputs, fit_timed)
