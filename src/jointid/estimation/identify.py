"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.estimation.identify_log import Windowed, identify_log
from jointid.estimation.identify_record import identify_record
from jointid.estimation.identify_several import identify_several, require_distinct
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.outputs import fit_outputs, state_position, state_scale, state_timing
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.problems.several_records import RecordLayout, SeveralRecords
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import (
    Records,
    check_robot_records,
    each_log,
    in_logs,
    robot_record_warnings,
)
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.windowed import require_windows
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.checks import check_record
from jointid.records.chunks import InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop

LARGEST = 600_000
"""Samples of a joint's records that are identified at once, in about 1 GiB; of n joints 4/n times as many in all."""

WINDOW = 75_000
"""Samples of a window of such records, of which one is checked; of many joints fewer."""

_PARTS = 3  # windows in what is taken of n joints at once
_ROBOTS = Robot | RobotLoop | RobotDriveSide


def windows_of(
    record: object, model: Any, method: Method | None, several: SeveralRecords | None = None
) -> Windowing | None:
    """Return the windows of records of more than `LARGEST` samples; None of others.

    Records of several rates, and what is not identified in windows, have none either.
    """
    records, joints, most = _flat(record), 1, float(LARGEST)
    if isinstance(model, _ROBOTS):
        joints = len(model if isinstance(model, Robot) else model.robot)
        most = 4 * LARGEST / joints
    channels = [channel for one in records for _, channel in one.items()]
    if sum(max((len(channel) for _, channel in one.items()), default=0) for one in records) <= most:
        return None
    if len({round(one.sample_time, 12) for one in channels}) != 1:
        return None
    if any(len({len(channel) for _, channel in one.items()}) != 1 for one in records):
        return None
    try:
        if isinstance(model, _ROBOTS) or isinstance(record, Record):
            require_windows(model, method)
        else:
            _require_windows_of(_layout(cast("Sequence[Record]", record), model, method, several), method, several)
    except MethodError:
        return None
    length = min(WINDOW, most / (_PARTS * joints))
    return Windowing(min(Windowing().length, channels[0].sample_time * length))


def _flat(record: object) -> list[Record]:
    """Return all records: of a joint, of several, of a robot's joints, or these of several logs."""
    if isinstance(record, Record):
        return [record]
    return [one for each in record for one in _flat(each)] if isinstance(record, list | tuple) else []


def _layout(
    records: Sequence[Record], model: Any, method: Method | None, several: SeveralRecords | None
) -> RecordLayout:
    """Return what several records of a joint share.

    Raises:
        MethodError: they are not identified by simulating a loop, or the lists about them are not as long.
    """
    if not isinstance(model, ClosedLoop | Sequence) or isinstance(method, IDIM | DriveSideFit):
        raise MethodError("Several records are identified by simulating their loop; give a ClosedLoop and DIDIM.")
    settings = several or SeveralRecords()
    free = (*settings.free, *(method.free if isinstance(method, DIDIM) else ()))
    return RecordLayout.of(len(records), model, replace(settings, free=tuple(dict.fromkeys(free))))


def fit(
    record: Record | Records | LongRecord,
    model: ClosedLoop | DriveSide | Joint | Sequence[ClosedLoop] | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: SeveralRecords | None = None,
    windows: Windowing | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Return the fit of a joint or a robot, without the checks; see `jointid.identify`."""
    filtering, parameters = filtering or Filtering(), parameters or {}
    if isinstance(model, _ROBOTS):
        if not isinstance(record, Sequence) or several:
            raise MethodError(
                "A robot is identified from the records of its joints, without SeveralRecords; give the records alone."
            )
        found = fit_robot(
            record, model, method, filtering=filtering, parameters=parameters, windows=windows, progress=progress
        )
        return found.warn(*robot_record_warnings(record, model if isinstance(model, Robot) else model.robot))
    outputs = method.outputs if isinstance(method, DIDIM) else ()
    if isinstance(record, Sequence):
        if not all(isinstance(one, Record) for one in record):
            raise MethodError("Several records of a joint are a list of records; received something else in it.")
        layout = _layout(cast("Sequence[Record]", record), model, method, several)

        def fit_together(each: Sequence[Record]) -> Estimate:
            require_distinct(each)
            if windows is None:
                return state_scale(identify_several(each, layout, method, filtering, parameters, progress), each)
            _require_windows_of(layout, method, several)
            windowed = [
                _of_joint(loop, method, filtering, layout.changes(parameters, k, acting=True))
                for k, loop in enumerate(layout.loops)
            ]
            logs = [[InMemory(one)] for one in each]
            return state_scale(identify_log(logs, windowed, windows, progress, layout), each)

        return fit_outputs(cast("Sequence[Record]", record), layout.loops, outputs, fit_together)
    if several is not None or isinstance(model, Sequence):
        raise MethodError("SeveralRecords and several loops are of a list of records; received one: give them all.")
    if not isinstance(record, Record):
        if not isinstance(model, ClosedLoop) or isinstance(method, IDIM):
            raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop and DIDIM.")
        require_windows(model, method)
        joint = _of_joint(model, method, filtering, parameters)
        return identify_log([[record]], [joint], windows or Windowing(), progress)

    def fit_single(records: Sequence[Record]) -> Estimate:
        if windows is None:
            return identify_record(records[0], model, method, filtering, parameters, progress)
        require_windows(model, method)
        check_record(records[0])
        joint = _of_joint(model, method, filtering, parameters)
        return identify_log([[InMemory(records[0])]], [joint], windows, progress)

    if isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None):
        return state_position(fit_outputs([record], [model], outputs, _in_time(fit_single)))
    return _in_time(fit_single)([record])


def _require_windows_of(layout: RecordLayout, method: Method | None, several: SeveralRecords | None) -> None:
    """Refuse several records that are not identified in windows."""
    for loop in layout.loops:
        require_windows(loop, method, () if several is None else several.free)


def _of_joint(
    model: ClosedLoop | DriveSide | Joint,
    method: Method | None,
    filtering: Filtering,
    parameters: Mapping[str, Parameter],
) -> Windowed:
    """Return how a window of a joint is identified."""

    def fit_window(records: Sequence[Record], progress: Progress) -> Estimate:
        return identify_record(records[0], model, method, filtering, parameters, progress)

    return Windowed(fit_window, model, filtering, parameters)


def _in_time(fit: Callable[[Sequence[Record]], Estimate]) -> Callable[[Sequence[Record]], Estimate]:
    """Return the fit of records whose torques may have no stated timing, or may be computed."""
    return lambda records: state_scale(state_timing(fit(records), records), records)


def fit_robot(
    records: Records,
    model: Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    windows: Windowing | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Return the fit of a robot, without the checks; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model.
    """
    known, robot = parameters or {}, model if isinstance(model, Robot) else model.robot
    require_friction(robot, known)
    check_robot_records(records, robot)
    if method is not None:
        method.require_settings_of("robot")
    every, filtering = [record for log in each_log(records) for record in log], filtering or Filtering()

    def fit_once(under: Robot | RobotLoop | RobotDriveSide, logs: Records, progress: Progress) -> Estimate:
        simulated = DriveSideFit if isinstance(under, RobotDriveSide) else DIDIM
        if isinstance(under, RobotLoop | RobotDriveSide) and (method is None or isinstance(method, simulated)):
            return identify_simulated_robot(under, logs, method, filtering=filtering, known=known, progress=progress)
        if isinstance(under, Robot | RobotLoop) and isinstance(method, IDIM | None):
            return identify_robot(under, logs, method, filtering=filtering, known=known)
        raise MethodError(
            f"{type(method).__name__} is not for a {type(under).__name__}; use IDIM for a Robot, DIDIM for a "
            "RobotLoop, or DriveSideFit for a RobotDriveSide."
        )

    def fit_window(records: Sequence[Record], progress: Progress) -> Estimate:
        # The first window of all begins as the model says, any other in motion.
        moving = isinstance(model, RobotLoop) and records[0].begin > 0
        return fit_once(replace(cast("RobotLoop", model), in_motion=True) if moving else model, records, progress)

    def of_logs(read: Sequence[Record]) -> Estimate:
        logs = in_logs(read, records) if len(read) == len(every) else read
        if windows is None:
            return fit_once(model, logs, progress)
        require_windows(model, method)
        sources = [[InMemory(one) for one in log] for log in each_log(logs)]
        return identify_log(sources, [Windowed(fit_window, model, filtering, known)], windows, progress)

    fit_timed = _in_time(of_logs)
    if not isinstance(model, RobotLoop) or not isinstance(method, DIDIM | None):
        return fit_timed(every)
    loops = model.loops * (len(every) // len(robot.links))
    return fit_outputs(every, loops, () if method is None else method.outputs, fit_timed)
