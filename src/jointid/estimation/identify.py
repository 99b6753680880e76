"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.estimation.identify_log import identify_log
from jointid.estimation.identify_record import identify_record
from jointid.estimation.identify_several import identify_several, require_distinct
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM, identify_robot
from jointid.estimation.methods.registry import Method
from jointid.estimation.outputs import fit_outputs, state_position, state_scale
from jointid.estimation.problems.log_windows import Windowing, commanded
from jointid.estimation.problems.several_records import RecordLayout, SeveralRecords
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import (
    Records,
    check_robot_records,
    each_log,
    in_logs,
    robot_record_warnings,
)
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.unknown_timing import fit_unstated_timing
from jointid.estimation.windowed import (
    joint_in_windows,
    loop_in_windows,
    records_in_windows,
    robot_in_windows,
)
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

_PARTS, _CHECKED = 3, 0.375  # windows in what may be taken at once; of a window of a joint, which is checked
_ROBOTS = Robot | RobotLoop | RobotDriveSide


@dataclass(frozen=True, slots=True)
class Planned:
    """How records of more than `LARGEST` samples are identified.

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
    """Return for a long record the part to check, the windows, and a sentence on them; None of another.

    Records that windows do not identify are none either.

    The part is the first with half the most travel or more.
    """
    records, robot = _flat(record), isinstance(model, _ROBOTS)
    samples = sum(max((len(channel) for _, channel in one.items()), default=0) for one in records)
    share = samples / LARGEST
    if isinstance(model, _ROBOTS):
        share *= len(model if isinstance(model, Robot) else model.robot) / 4
    if share <= 1.0 or not _in_windows(records, model, method, several):
        return None
    step = InMemory(records[0]).sample_time
    logs = [list(log) for log in each_log(cast("Records", record))] if robot else [[one] for one in records]
    samples //= len(logs[0])
    windows = Windowing(min(Windowing().length, step * samples / (_PARTS * share)))
    part: Record | tuple[Record, ...] | None = None
    checks = ""
    if len(logs) == 1 and (robot or (isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None))):
        length = round((1.0 if robot else _CHECKED) * windows.length / step)
        chunks = (InMemory(one).chunks(length, 0) for one in logs[0])
        pieces = [tuple(one.record for one in piece) for piece in zip(*chunks, strict=False)]
        enough = 0.5 * max(map(_travel, pieces))
        first = next(one for one in pieces if _travel(one) >= enough)
        checks = f", and checked in {length * step:.3g} s from {first[0].begin:.3g} s on"
        part = first if robot else first[0]
    whole = "record" if len(logs) == 1 else "records"
    said = f"the {samples} samples of the {whole} are identified in windows of {windows.length:.3g} s{checks}"
    return Planned(part, windows, said)


def _flat(record: object) -> list[Record]:
    """Return all records: of a joint, of several, of a robot's joints, or these of several logs."""
    if isinstance(record, Record):
        return [record]
    return [one for each in record for one in _flat(each)] if isinstance(record, list | tuple) else []


def _in_windows(
    records: Sequence[Record], model: object, method: Method | None, several: SeveralRecords | None
) -> bool:
    """Test whether these records, model and method can be identified in windows."""
    one_rate = len({round(channel.sample_time, 12) for one in records for _, channel in one.items()}) == 1
    if not one_rate or any(len({len(channel) for _, channel in one.items()}) != 1 for one in records):
        return False
    robot, free = isinstance(model, _ROBOTS), isinstance(method, DIDIM) and method.free and len(records) > 1
    if free or (several and several.free):
        return False
    if isinstance(method, IDIM) and method.estimator not in (None, "weighted" if robot else "ols"):
        return False  # which needs all rows at once
    if robot or (len(records) == 1 and (isinstance(method, IDIM) or (method is None and isinstance(model, Joint)))):
        return True
    loops = list(model) if isinstance(model, Sequence) else [model]
    simulated = isinstance(method, DIDIM | None) and all(one.reference is not None for one in records)
    return simulated and all(isinstance(one, ClosedLoop) and not one.joint.friction.follows_time for one in loops)


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
        record = cast("Sequence[Record]", record)
        if not isinstance(model, ClosedLoop | Sequence) or isinstance(method, IDIM | DriveSideFit):
            raise MethodError("Several records are identified by simulating their loop; give a ClosedLoop and DIDIM.")
        settings = several or SeveralRecords()
        if windows is None and isinstance(method, DIDIM):
            settings = replace(settings, free=tuple(dict.fromkeys((*settings.free, *method.free))))
        layout = RecordLayout.of(len(record), model, settings)

        def fit_together(each: Sequence[Record]) -> Estimate:
            require_distinct(each)
            if windows is not None:
                windowed = records_in_windows(layout, method, filtering, parameters)
                return identify_log([[InMemory(one)] for one in each], windowed, windows, progress)
            return identify_several(each, layout, method, filtering, parameters, progress)

        return fit_outputs(record, layout.loops, outputs, lambda each: state_scale(fit_together(each), each))
    if several is not None or isinstance(model, Sequence):
        raise MethodError("SeveralRecords and several loops are of a list of records; received one: give them all.")
    if not isinstance(record, Record):
        if not isinstance(model, ClosedLoop):
            raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop.")
        long = loop_in_windows(model, method, filtering, parameters)
        return identify_log([[record]], [long], windows or Windowing(), progress)

    def fit_single(records: Sequence[Record]) -> Estimate:
        if windows is None:
            return identify_record(records[0], model, method, filtering, parameters, progress)
        each = joint_in_windows(model, method, filtering, parameters)
        check_record(records[0])
        return identify_log([[InMemory(records[0])]], [each], windows, progress)

    if isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None):
        return state_position(fit_outputs([record], [model], outputs, _in_time(fit_single)))
    return _in_time(fit_single)([record])


def _in_time(fit: Callable[[Sequence[Record]], Estimate]) -> Callable[[Sequence[Record]], Estimate]:
    """Return the fit of records whose torques may have no stated timing, or may be computed."""
    return lambda records: state_scale(fit_unstated_timing(records, fit), records)


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
    every = [record for log in each_log(records) for record in log]

    def of_logs(read: Sequence[Record]) -> Estimate:
        logs = in_logs(read, records) if len(read) == len(every) else read
        if windows is not None:
            sources = [[InMemory(one) for one in log] for log in each_log(logs)]
            windowed = robot_in_windows(model, method, filtering or Filtering(), known)
            return identify_log(sources, [windowed] * len(sources), windows, progress)
        simulated = DriveSideFit if isinstance(model, RobotDriveSide) else DIDIM
        if isinstance(model, RobotLoop | RobotDriveSide) and (method is None or isinstance(method, simulated)):
            return identify_simulated_robot(model, logs, method, filtering=filtering, known=known, progress=progress)
        if isinstance(model, Robot | RobotLoop) and isinstance(method, IDIM | None):
            return identify_robot(model, logs, method, filtering=filtering, known=known)
        raise MethodError(
            f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM for a Robot, DIDIM for a "
            "RobotLoop, or DriveSideFit for a RobotDriveSide."
        )

    fit_timed = _in_time(of_logs)
    if not isinstance(model, RobotLoop) or not isinstance(method, DIDIM | None):
        return fit_timed(every)
    loops = model.loops * (len(every) // len(robot.links))
    return fit_outputs(every, loops, () if method is None else method.outputs, fit_timed)
