"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.estimation.identify_log import LoopWindows, identify_log
from jointid.estimation.identify_record import identify_record
from jointid.estimation.identify_several import identify_several, require_distinct
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import Method
from jointid.estimation.outputs import fit_log, fit_outputs, state_position, state_scale
from jointid.estimation.problems.log_windows import Windowing, commanded, moves
from jointid.estimation.problems.several_records import RecordLayout, SeveralRecords
from jointid.estimation.record_warnings import ask_about_gains, check_robot_records, robot_record_warnings
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import Records, each_log, in_logs
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.unknown_timing import fit_unstated_timing
from jointid.estimation.windowed import joint_in_windows, robot_in_windows
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.checks import check_record
from jointid.records.chunks import InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop

LARGEST = 2**30
"""Bytes that the identification of a record may take at once; a longer record goes in windows."""

_OF_JOINT, _OF_ROBOT = 1700, 420  # bytes of a sample of a joint, and of a robot of one; checks take four times as much
_PARTS, _CHECKED = 3, 0.375  # windows in what may be taken at once; of a window of a joint, which is checked
_ROBOTS = Robot | RobotLoop | RobotDriveSide


def memory_of(record: object, model: object = None) -> int:
    """Return the bytes that the identification of a record, or of several, may take at once."""
    samples = [max((len(channel) for _, channel in one.items()), default=0) for one in _flat(record)]
    if isinstance(model, _ROBOTS):
        return _OF_ROBOT * len(model if isinstance(model, Robot) else model.robot) * sum(samples)
    return _OF_JOINT * sum(samples)


def _flat(record: object) -> list[Record]:
    """Return all records: of a joint, of several, of a robot's joints, or of these of several logs."""
    if isinstance(record, Record):
        return [record]
    return [one for each in record for one in _flat(each)] if isinstance(record, list | tuple) else []


@dataclass(frozen=True, slots=True)
class Planned:
    """How a record that would take more than `LARGEST` is identified.

    Attributes:
        part: of it, to be checked; None of several records and of a joint by IDIM, whose fit is not checked.
        windows: in which it is identified. said: that it is, in a sentence.
    """

    part: Record | tuple[Record, ...] | None
    windows: Windowing
    said: str


def plan_windows(
    record: object, model: object, method: Method | None, several: SeveralRecords | None = None
) -> Planned | None:
    """Return for a long record the part to check, the windows, and a sentence on them.

    The part is the first window with half the most travel or more. None of a record that is not long, of one that moves
    in less than two windows, and of what is not identified in windows.
    """
    needed = memory_of(record, model)
    if needed <= LARGEST or not _in_windows(record, model, method, several):
        return None
    robot = isinstance(model, _ROBOTS)
    logs = [list(log) for log in each_log(cast("Records", record))] if robot else [[one] for one in _flat(record)]
    samples = sum(max(len(channel) for one in log for _, channel in one.items()) for log in logs)
    step = InMemory(logs[0][0]).sample_time
    windows = Windowing(min(Windowing().length, step * samples * LARGEST / (_PARTS * needed)))

    length = windows.length if robot else _CHECKED * windows.length

    def divide(log: Sequence[Record], seconds: float) -> Iterator[tuple[Record, ...]]:
        chunks = (InMemory(one).chunks(round(seconds / step), 0) for one in log)
        return (tuple(one.record for one in piece) for piece in zip(*chunks, strict=False))

    if sum(any(map(moves, piece)) for log in logs for piece in divide(log, windows.length)) < 2:
        return None
    part: Record | tuple[Record, ...] | None = None
    checks = ""
    if len(logs) == 1 and (robot or _is_simulated(model, method)):
        enough = 0.5 * max(map(_travel, divide(logs[0], length)))
        first = next(one for one in divide(logs[0], length) if _travel(one) >= enough)
        checks = f", and checked in {length:.3g} s from {first[0].begin:.3g} s on"
        part = first if robot else first[0]
    whole = "record" if len(logs) == 1 else "records"
    said = f"the {samples} samples of the {whole} are identified in windows of {windows.length:.3g} s{checks}"
    return Planned(part, windows, said)


def _is_simulated(model: object, method: Method | None) -> bool:
    return isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None)


def _in_windows(record: object, model: object, method: Method | None, several: SeveralRecords | None) -> bool:
    """Test whether these records, model and method can be identified in windows."""
    records = _flat(record)
    clocks = {round(channel.sample_time, 12) for one in records for _, channel in one.items()}
    sizes = [{len(channel) for _, channel in one.items()} for one in records]
    if len(clocks) != 1 or any(len(size) != 1 for size in sizes):
        return False
    robot = isinstance(model, _ROBOTS)
    if isinstance(method, IDIM) and (method.effects or method.estimator not in (None, "weighted" if robot else "ols")):
        return False  # which needs all rows at once
    if (several and several.free) or (isinstance(method, DIDIM) and method.free and not isinstance(record, Record)):
        return False
    if robot:
        return not isinstance(record, Record)
    if isinstance(record, Record) and (isinstance(method, IDIM) or (method is None and isinstance(model, Joint))):
        return isinstance(model, ClosedLoop | Joint)
    each = model if isinstance(model, Sequence) else [model]
    loops = [one for one in each if isinstance(one, ClosedLoop)]
    simulated = len(loops) == len(each) and all(_is_simulated(one, method) for one in loops)
    asked = all(one.reference is not None for one in records)
    return simulated and asked and not any(one.joint.friction.follows_time for one in loops)


def _travel(records: Sequence[Record]) -> float:
    asked = [commanded(one) if one.injected is None else one.injected.channel for one in records]
    return sum(float(np.sum(np.abs(np.diff(one.values)))) for one in asked if one is not None)


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
) -> FitResult:
    """Return the fit of a joint or a robot, without the checks; see `jointid.identify`."""
    if isinstance(model, _ROBOTS):
        if isinstance(record, Record):
            raise MethodError(
                "A robot is identified from the record of each of its joints; received one: give them all."
            )
        if not isinstance(record, Sequence) or several:
            raise MethodError(
                "A robot is identified from the records of its joints, without SeveralRecords; give the records alone."
            )
        found = fit_robot(
            record, model, method, filtering=filtering, parameters=parameters, windows=windows, progress=progress
        )
        robot = model if isinstance(model, Robot) else model.robot
        return replace(found, after=robot_record_warnings(record, robot))
    outputs = method.outputs if isinstance(method, DIDIM) else ()
    if isinstance(record, Sequence):
        if not all(isinstance(one, Record) for one in record):
            raise MethodError("Several records of a joint are a list of records; received something else in it.")
        record = cast("Sequence[Record]", record)
        if not isinstance(model, ClosedLoop | Sequence):
            raise MethodError(
                "Several records are identified by simulating their loop; give a ClosedLoop, with the controller."
            )
        settings = several or SeveralRecords()
        if windows is None and isinstance(method, DIDIM):
            settings = replace(settings, free=tuple(dict.fromkeys((*settings.free, *method.free))))
        layout = RecordLayout.of(len(record), model, settings)

        def fit_together(each: Sequence[Record]) -> FitResult:
            if windows is not None:
                require_distinct(each)
                windowed = LoopWindows.of_several(layout, settings.own, method, filtering, parameters)
                return state_scale(identify_log([[InMemory(one)] for one in each], windowed, windows, progress), each)
            return state_scale(identify_several(each, model, settings, method, filtering, parameters, progress), each)

        return fit_outputs(record, layout.loops, outputs, fit_together)
    if several is not None:
        raise MethodError("SeveralRecords is about a list of records; received one record: give a list of them.")
    if isinstance(record, Record):
        if isinstance(model, Sequence):
            raise MethodError("One record has one loop; received a list: give the loop, or a list of records.")
        return _fit_single(record, model, method, filtering, parameters, windows, progress)
    if not isinstance(model, ClosedLoop):
        raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop, with the controller.")
    windowed = LoopWindows.of(model, method, filtering, parameters)
    return fit_log(
        record, model, outputs, lambda log: identify_log([[log]], [windowed], windows or Windowing(), progress)
    )


def _fit_single(
    record: Record,
    model: ClosedLoop | DriveSide | Joint,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    windows: Windowing | None,
    progress: Progress,
) -> FitResult:
    """Return the fit of one record, at once or in windows."""
    asked = ask_about_gains(model.controller, record.reference) if isinstance(model, ClosedLoop) else None
    if asked is not None:
        progress(asked)

    def fit_single(records: Sequence[Record]) -> FitResult:
        if windows is None:
            return identify_record(
                records[0], model, method, filtering=filtering, parameters=parameters, progress=progress
            )
        windowed = joint_in_windows(model, method, filtering, parameters)
        check_record(records[0])
        return identify_log([[InMemory(records[0])]], [windowed], windows, progress)

    def fit_timed(records: Sequence[Record]) -> FitResult:
        return state_scale(fit_unstated_timing(records, fit_single), records)

    if isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None):
        outputs = () if method is None else method.outputs
        found = state_position(fit_outputs([record], [model], outputs, fit_timed))
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
    windows: Windowing | None = None,
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
        logs = in_logs(read, records) if len(read) == len(every) else read
        if windows is not None:
            sources = [[InMemory(one) for one in log] for log in each_log(logs)]
            windowed = robot_in_windows(model, method, filtering or Filtering(), known)
            return identify_log(sources, [windowed] * len(sources), windows, progress)
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
    loops = model.loops * (len(every) // len(robot.links))
    outputs = () if method is None else method.outputs
    return fit_outputs(every, loops, outputs, fit_timed)
