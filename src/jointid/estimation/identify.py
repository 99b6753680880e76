"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.common.settings import Setting
from jointid.estimation.identify_log import Windowed, identify_log
from jointid.estimation.identify_record import identify_record
from jointid.estimation.identify_several import identify_several, require_distinct
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.outputs import fit_outputs, state_position, state_scale, state_timing
from jointid.estimation.problems.several_records import RecordLayout
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.regression import (
    Records,
    check_robot_records,
    each_log,
    robot_record_warnings,
)
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.windowed import require_windows
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide, RobotDriveSide
from jointid.simulation.loop_input import RobotLoop

LARGEST = 600_000
"""Samples of a joint's records that are identified at once, in about 1 GiB; of n joints 4/n times as many in all."""

WINDOW = 75_000
"""Samples of a window of such records, of which one is checked; of many joints fewer."""

_LONGEST = 60.0  # s of a window, unless it is given
_PARTS = 3  # windows in what is taken of n joints at once
_ROBOTS = Robot | RobotLoop | RobotDriveSide


def windows_of(
    record: object, model: Any, method: Method | None, several: Mapping[str, Any] | None = None
) -> float | None:
    """Return the seconds of a window of records of more than `LARGEST` samples; None of others.

    Records of several rates, and what is not identified in windows, have none either.
    """
    records, joints, most, loops = _flat(record), 1, float(LARGEST), [model]
    if isinstance(model, _ROBOTS):
        joints = len(model if isinstance(model, Robot) else model.robot)
        most = 4 * LARGEST / joints
    elif isinstance(model, Sequence):
        loops = [*model]
    lengths = [[len(channel) for _, channel in one.items()] for one in records]
    rates = {round(channel.sample_time, 12) for one in records for _, channel in one.items()}
    if sum(map(max, filter(None, lengths))) <= most or len(rates) != 1 or any(len({*one}) != 1 for one in lengths):
        return None
    try:
        for loop in loops:
            require_windows(loop, method, (several or {}).get("free", ()))
    except MethodError:
        return None
    return min(_LONGEST, rates.pop() * min(WINDOW, most / (_PARTS * joints)))


def _flat(record: object) -> list[Record]:
    """Return all records: of a joint, of several, of a robot's joints, or these of several logs."""
    if isinstance(record, Record):
        return [record]
    return [one for each in record for one in _flat(each)] if isinstance(record, list | tuple) else []


def fit(
    record: Record | Records | LongRecord,
    model: ClosedLoop | DriveSide | Joint | Sequence[ClosedLoop] | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: Mapping[str, Any] | None = None,
    windows: float | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Return the fit of a joint or a robot, without the checks; see `jointid.identify`."""
    if fault := Setting("", above=0.0, type=float, optional=True).fault(windows):
        raise MethodError(f"windows, in seconds,{fault}")
    filtering, known, layout = filtering or Filtering(), parameters or {}, None
    loops, warnings = tuple[ClosedLoop, ...](), tuple[str, ...]()
    if isinstance(model, _ROBOTS):
        if not isinstance(record, Sequence) or several:
            raise MethodError("A robot is identified from its joints' records; give these without `several`.")
        robot = model if isinstance(model, Robot) else model.robot
        require_friction(robot, known)
        check_robot_records(record, robot)
        if method is not None:
            method.require_settings_of("robot")
        logs = [[*log] for log in each_log(record)]
        loops = (*model.loops,) * len(logs) if isinstance(model, RobotLoop) else ()
        warnings = robot_record_warnings(record, robot)
    elif isinstance(record, Sequence):
        logs = [[one] for one in _flat(record)]
        if (
            len(logs) != len(record)
            or not isinstance(model, ClosedLoop | Sequence)
            or not isinstance(method, DIDIM | None)
        ):
            raise MethodError(
                "Several records are a list of records, identified by their loop: give a ClosedLoop, and DIDIM."
            )
        freed = method.free if isinstance(method, DIDIM) else ()
        layout = RecordLayout.of(len(logs), model, freed, several or {})
        loops = layout.loops
    elif not isinstance(record, Record):
        if not isinstance(model, ClosedLoop) or isinstance(method, IDIM) or several is not None:
            raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop and DIDIM.")
        require_windows(model, method)
        way = _in_windows(model, method, filtering, known)
        return identify_log([[record]], [way], (model,), filtering, windows or _LONGEST, progress)
    elif several is not None or isinstance(model, Sequence):
        raise MethodError(
            "What is of `several` records, and several loops, are of a list of records; received one: give them all."
        )
    else:
        loops = (model,) if isinstance(model, ClosedLoop) else ()
        logs = [[record]]

    def fit_all(read: Sequence[Record]) -> Estimate:
        each = [read[at : at + len(logs[0])] for at in range(0, len(read), len(logs[0]))]
        if layout is not None:
            require_distinct(read)
        if windows is not None:
            ways = [_in_windows(model, method, filtering, known)]
            if layout is not None:
                own = [layout.changes(known, k, acting=True) for k in range(len(loops))]
                ways = [_in_windows(loop, method, filtering, one) for loop, one in zip(loops, own, strict=True)]
            for way in ways:
                require_windows(way.model, method, (several or {}).get("free", ()))
            sources = [[InMemory(one) for one in log] for log in each]
            return identify_log(sources, ways, loops, filtering, windows, progress, layout)
        if layout is not None:
            return identify_several(read, layout, method, filtering, known, progress)
        return _at_once(model, each if len(each) > 1 else read, method, filtering, known, progress)

    def fit_timed(read: Sequence[Record]) -> Estimate:
        return state_scale(state_timing(fit_all(read), read), read)

    flat = [one for log in logs for one in log]
    if not loops or not isinstance(method, DIDIM | None):
        return fit_timed(flat).warn(*warnings)
    outputs = () if method is None else method.outputs
    return state_position(fit_outputs(flat, loops, outputs, fit_timed)).warn(*warnings)


def _in_windows(model: object, method: Method | None, filtering: Filtering, known: Mapping[str, Parameter]) -> Windowed:
    """Return how a window is identified."""

    def fit_window(records: Sequence[Record], progress: Progress) -> Estimate:
        # The first window of all begins as the model says, any other in motion.
        moving = isinstance(model, RobotLoop) and records[0].begin > 0
        under = replace(cast("RobotLoop", model), in_motion=True) if moving else model
        return _at_once(under, records, method, filtering, known, progress)

    return Windowed(fit_window, model, known)


def _at_once(
    model: Any,
    records: Records,
    method: Method | None,
    filtering: Filtering,
    known: Mapping[str, Parameter],
    progress: Progress,
) -> Estimate:
    """Return the fit of a joint's only record, or of a robot's logs.

    Raises:
        MethodError: the method does not fit the model.
    """
    if not isinstance(model, _ROBOTS):
        return identify_record(cast("Record", records[0]), model, method, filtering, known, progress)
    simulated = DriveSideFit if isinstance(model, RobotDriveSide) else DIDIM
    if not isinstance(model, Robot) and (method is None or isinstance(method, simulated)):
        return identify_simulated_robot(model, records, method, filtering=filtering, known=known, progress=progress)
    if not isinstance(model, RobotDriveSide) and isinstance(method, IDIM | None):
        return identify_robot(model, records, method, filtering=filtering, known=known)
    raise MethodError(
        f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM for a Robot, DIDIM for a RobotLoop, or "
        "DriveSideFit for a RobotDriveSide."
    )
