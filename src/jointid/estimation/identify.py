"""From a record, several, or a log too long for memory, to a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import Setting
from jointid.estimation.identify_pieces import identify_records, identify_windows, require_distinct
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method, Task, default_method
from jointid.estimation.outputs import state_position, state_scale, state_timing, torques_of
from jointid.estimation.problems.base import adjust_parameters
from jointid.estimation.problems.inverse_model import Records, each_log
from jointid.estimation.problems.pieces import travel
from jointid.estimation.problems.several_records import RecordLayout
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.robots.idim import identify_robot
from jointid.estimation.robots.numbers import require_friction
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.windowed import require_windows
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.checks import check_record, find_encoder_lag, find_record_warnings, range_faults, scale_faults
from jointid.records.chunks import InMemory, LongRecord, cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide, RobotDriveSide
from jointid.simulation.loop_input import RobotLoop

LARGEST = 600_000
"""Samples of a joint's records that are identified at once, in about 1 GiB; of n joints 4/n times as many in all."""

WINDOW = 75_000
"""Samples of a window of such records, of which one is checked; of many joints fewer."""

_LONGEST = 60.0  # s of a window, unless it is given
_SHARED = ("added_inertia", "own", "free")  # what several records are given
_PARTS = 3  # windows in what is taken of n joints at once


def _robot_of(model: Any) -> Robot | None:
    """Return the robot that is modelled; None of a joint, or of several loops."""
    return model if isinstance(model, Robot) else getattr(model, "robot", None)


def _most(model: Any) -> tuple[float, int]:
    """Return the samples that are identified at once, and the number of joints."""
    robot = _robot_of(model)
    return (LARGEST, 1) if robot is None else (4 * LARGEST / len(robot), len(robot))


def is_long(record: object, model: Any) -> bool:
    """Test whether records of one rate have more than `LARGEST` samples; see there."""
    records = _flat(record)
    lengths = [{len(channel) for _, channel in one.items()} for one in records]
    rates = {round(channel.sample_time, 12) for one in records for _, channel in one.items()}
    alike = len(rates) == 1 and all(len(one) == 1 for one in lengths)
    return alike and sum(max(one) for one in lengths) > _most(model)[0]


def windows_of(
    record: object, model: Any, method: Method | None, several: Mapping[str, Any] | None = None
) -> float | None:
    """Return the seconds of a window of long records; None of others, and of what is not identified in windows."""
    if not is_long(record, model):
        return None
    try:
        for loop in model if isinstance(model, Sequence) else [model]:
            require_windows(loop, method, (several or {}).get("free", ()))
    except MethodError:
        return None
    most, joints = _most(model)
    sample_time = next(channel.sample_time for one in _flat(record) for _, channel in one.items())
    return min(_LONGEST, sample_time * min(WINDOW, most / (_PARTS * joints)))


def part_of(records: Sequence[Record], model: Any) -> Sequence[Record]:
    """Return records of a joint, or of a robot's joints; of long ones the window in which they move most."""
    if not is_long(records, model):
        return records
    most, joints = _most(model)
    size, samples = int(min(WINDOW, most / (_PARTS * joints))), min(len(channel) for _, channel in records[0].items())
    windows = [[cut(one, first, first + size) for one in records] for first in range(0, samples - size + 1, size)]
    return max(windows, key=travel)


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
    filtering, known = filtering or Filtering(), parameters or {}
    fit_piece = partial(_fit_piece, method, filtering)
    if not isinstance(record, Record | Sequence):
        if not isinstance(model, ClosedLoop) or isinstance(method, IDIM) or several is not None:
            raise MethodError("A long record is identified by simulating its loop; give a ClosedLoop and DIDIM.")
        require_windows(model, method)
        return identify_windows(
            [[record]], [(model, known)], fit_piece, (model,), filtering, windows or _LONGEST, progress
        )
    logs, loops, layout = _logs_of(record, model, method, known, several)
    read, by_loop = [one for log in logs for one in log], bool(loops) and isinstance(method, DIDIM | None)
    robot = _robot_of(model)
    warnings = () if robot is None else _robot_warnings(logs, robot)
    if by_loop:
        read = torques_of(read, loops, method.outputs if isinstance(method, DIDIM) else ())
    each = [read[at : at + len(logs[0])] for at in range(0, len(read), len(logs[0]))]
    if len(logs) > 1 and robot is None:
        require_distinct(read)
    if windows is not None:
        models: list[tuple[Any, Mapping[str, Parameter]]] = [(model, known)]
        if layout is not None:
            models = [(loop, layout.changes(known, k, acting=True)) for k, loop in enumerate(loops)]
        for one, _ in models:
            require_windows(one, method, (several or {}).get("free", ()))
        sources = [[InMemory(one) for one in log] for log in each]
        found = identify_windows(sources, models, fit_piece, loops, filtering, windows, progress, layout)
    elif layout is not None:
        found = identify_records(read, layout, known, fit_piece, progress)
    else:
        found = fit_piece(model, each if len(each) > 1 else read, known, progress)
    found = state_scale(state_timing(found, read), read).warn(*warnings)
    return state_position(found) if by_loop else found


def _logs_of(
    record: Record | Records,
    model: Any,
    method: Method | None,
    known: Mapping[str, Parameter],
    several: Mapping[str, Any] | None,
) -> tuple[list[list[Record]], tuple[ClosedLoop, ...], RecordLayout | None]:
    """Return the records of each log, the loop of each, and what several records of a joint share.

    Raises:
        RecordError, MethodError: records, model and method do not belong together.
    """
    if (robot := _robot_of(model)) is not None:
        if isinstance(record, Record) or several:
            raise MethodError("A robot is identified from its joints' records; give these without `several`.")
        require_friction(robot, known)
        _check_robot_records(record, robot)
        if method is not None:
            method.require_settings_of("robot")
        logs = [[*log] for log in each_log(record)]
        return logs, (*model.loops,) * len(logs) if isinstance(model, RobotLoop) else (), None
    if isinstance(record, Record):
        if several is not None or isinstance(model, Sequence):
            raise MethodError("Several loops, and `several`, are of a list of records; received one: give all.")
        return [[record]], (model,) if isinstance(model, ClosedLoop) else (), None
    logs, of_loops = [[one] for one in record if isinstance(one, Record)], isinstance(model, ClosedLoop | Sequence)
    asked = any(name not in _SHARED or (any(v) if np.iterable(v) else v) for name, v in (several or {}).items())
    alike = isinstance(model, Joint) and isinstance(method, IDIM | None) and not asked
    if not logs or len(logs) != len(record) or not (alike or (of_loops and isinstance(method, DIDIM | None))):
        raise MethodError(
            "Several records are a list of records, identified by their loop, or by IDIM if they share all parameters: "
            "give a ClosedLoop and DIDIM, or the joint without `several`."
        )
    if alike:
        return logs, (), None
    layout = RecordLayout.of(len(logs), model, method.free if isinstance(method, DIDIM) else (), several or {})
    return logs, layout.loops, layout


def _fit_piece(
    method: Method | None,
    filtering: Filtering,
    model: Any,
    records: Records,
    known: Mapping[str, Parameter],
    progress: Progress,
) -> Estimate:
    """Return the fit of a joint's records, or of a robot's logs.

    Raises:
        MethodError: the method does not fit the model.
    """
    if _robot_of(model) is None:
        first, *others = _flat(records)
        return identify_record(first, model, method, filtering, known, progress, others)
    simulated = DriveSideFit if isinstance(model, RobotDriveSide) else DIDIM
    if not isinstance(model, Robot) and (method is None or isinstance(method, simulated)):
        return identify_simulated_robot(model, records, method, filtering=filtering, known=known, progress=progress)
    if not isinstance(model, RobotDriveSide) and isinstance(method, IDIM | None):
        return identify_robot(model, records, method, filtering=filtering, known=known)
    raise MethodError(
        f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM for a Robot, DIDIM for a RobotLoop, or "
        "DriveSideFit for a RobotDriveSide."
    )


def identify_record(
    record: Record,
    model: ClosedLoop | DriveSide | Joint,
    method: Method | None = None,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
    others: Sequence[Record] = (),
) -> Estimate:
    """Return the fit of a joint to one record, or by IDIM to others, too; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model, or an inertia is not positive.
    """
    loop = model if isinstance(model, ClosedLoop) else None
    joint = model.joint if isinstance(model, ClosedLoop | DriveSide) else model
    chosen = method or default_method(model)()
    wanted = adjust_parameters(joint.parameters, parameters or {})
    for one in (record, *others):
        check_record(one)
    _require_fit(chosen, joint, loop)
    fit = chosen.identify(Task(record, joint, loop, wanted, filtering or Filtering(), progress, tuple(others)))
    said = [note for one in (record, *others) for note in find_record_warnings(one, fit.data.channels)]
    for p in wanted:
        if p.quantity is Quantity.INERTIA and p.free and fit.values.get(p.name, 1.0) <= 0:
            raise MethodError(
                f"The record gives {p.name} = {fit.values[p.name]:.4g}, which no joint has: the torque or the motion "
                "has the wrong sign (turn record.channels.torque.sign round), or they do not belong together"
                f"{''.join(f'; {note}' for note in said)}."
            )
    if others:
        torques = [one.torque.values for one in (record, *others) if one.torque is not None]
        fit = replace(fit, data=replace(fit.data, fingerprint="", logs=tuple(map(fingerprint, torques))))
    if {"motor_position", "load_position"} <= set(fit.data.channels):
        fit = replace(fit, checks=replace(fit.checks, encoder_lag=find_encoder_lag(record)))
    return replace(fit, record=None if others else record).warn(*dict.fromkeys(said))


def _require_fit(method: Method, joint: Joint, loop: ClosedLoop | None) -> None:
    """Refuse a method that does not fit the joint or lacks its controller."""
    if method.needs_controller and loop is None:
        raise MethodError(
            f"{method.title} simulates the closed loop, so it needs the controller; give a ClosedLoop, or use IDIM "
            "with a motor_position."
        )
    method.require_settings_of(joint.model)
    if not method.needs_controller:
        joint.require_linear(f"{method.title} takes")
    if method.name == "drive_side":
        DriveSide(joint)  # which says what it does not take


def _robot_warnings(logs: Sequence[Sequence[Record]], robot: Robot) -> tuple[str, ...]:
    """Return warnings on the records of a robot's joints, one sentence each, which names its joint."""
    found = (
        f"{name}: {said}"
        for log in logs
        for name, record in zip(robot.names, log, strict=False)
        for said in find_record_warnings(record, record.channels)
    )
    return tuple(dict.fromkeys(found))


def _check_robot_records(records: Records, robot: Robot) -> None:
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
