"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

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
from jointid.estimation.outputs import fit_log, fit_outputs, state_position, state_scale
from jointid.estimation.problems.log_windows import Windowing, moves
from jointid.estimation.problems.several_records import RecordLayout, SeveralRecords
from jointid.estimation.record_warnings import ask_about_gains, check_robot_records, robot_record_warnings
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import Records, each_log, in_logs
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.unknown_timing import fit_unstated_timing
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide, OpenLoop
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop

LARGEST = 2**32
"""Bytes that the identification of one record and its checks may take at once; a longer record goes in windows."""

_PER_SAMPLE = 7000  # bytes of each joint, where the checks search for a cause; without a misfit 1000


def memory_of(record: Record) -> int:
    """Return the bytes that the identification of a record by simulation and its checks may take."""
    return _PER_SAMPLE * max(len(channel) for _, channel in record.items())


def plan_windows(record: object, model: object, method: Method | None) -> tuple[Record, Windowing, str] | None:
    """Return for a record above `LARGEST` the part to check, the windows, and a sentence on what it takes.

    The part is the first with half the most travel or more. None of a record below, of one that moves in less than two
    windows, and of what is not identified in windows.
    """
    if not (isinstance(record, Record) and isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None)):
        return None
    sizes = {len(channel) for _, channel in record.items()}
    needed = memory_of(record)
    both = method is not None and len(method.outputs) > 1  # weighted beside a fit of the whole
    if needed <= LARGEST or both or len(sizes) > 1 or record.reference is None or model.joint.friction.follows_time:
        return None
    source = InMemory(record)
    # The checks take several times as much as a fit.
    longest, checked = (source.sample_time * LARGEST / (share * _PER_SAMPLE) for share in (3, 8))
    windows = Windowing(min(Windowing().length, longest))
    length = min(checked, windows.length)

    def divide(seconds: float) -> Iterator[Record]:
        return (piece.record for piece in source.chunks(round(seconds / source.sample_time), 0))

    if sum(map(moves, divide(windows.length))) < 2:
        return None
    enough = 0.5 * max(map(_travel, divide(length)))
    part = next(part for part in divide(length) if _travel(part) >= enough)
    said = (
        f"at once, the {max(sizes)} samples of the record would take up to {needed / 1e9:.1f} GB of memory: they are "
        f"identified in windows of {windows.length:.3g} s, and checked in {length:.3g} s from {part.begin:.3g} s on"
    )
    return part, windows, said


def _travel(record: Record) -> float:
    asked = record.reference if record.injected is None else record.injected.channel
    assert asked is not None
    return float(np.sum(np.abs(np.diff(asked.values))))


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
    outputs = method.outputs if isinstance(method, DIDIM) else ()
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
        layout = RecordLayout.of(len(record), model, settings)

        def fit_together(each: Sequence[Record]) -> FitResult:
            return state_scale(identify_several(each, model, settings, method, filtering, parameters, progress), each)

        def fit_alone(number: int, each: Sequence[Record]) -> FitResult:
            known = layout.changes(parameters or {}, number, acting=False)
            return identify_record(
                each[0], layout.loops[number], method, filtering=filtering, parameters=known, progress=progress
            )

        return fit_outputs(record, layout.loops, outputs, fit_together, fit_alone)
    if several is not None:
        raise MethodError("SeveralRecords is about a list of records; received one record: give a list of them.")
    if isinstance(record, Record) and windows is None:
        if isinstance(model, Sequence):
            raise MethodError("One record has one loop; received a list: give the loop, or a list of records.")
        return _fit_single(record, model, method, filtering, parameters, progress)
    if not isinstance(model, ClosedLoop):
        raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop, with the controller.")

    def fit_windows(source: LongRecord) -> FitResult:
        return identify_log(source, model, windows or Windowing(), method, filtering, parameters, progress)

    def fit_whole(_: int, records: Sequence[Record]) -> FitResult:
        return identify_record(records[0], model, method, filtering=filtering, parameters=parameters, progress=progress)

    if isinstance(record, Record):
        return fit_outputs(
            [record], [model], outputs, lambda one: state_scale(fit_windows(InMemory(one[0])), one), fit_whole
        )
    return fit_log(record, model, outputs, fit_windows)


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
        found = state_position(fit_outputs([record], [model], () if method is None else method.outputs, fit_timed))
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
        logs = in_logs(read, records) if len(read) == len(every) else read
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
    return fit_outputs(every, loops, outputs, fit_timed, of_log=len(robot.links))
