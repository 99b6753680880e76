"""Fit of one record, several, or a log too long for memory.

DIDIM reproduces the logged torque, or the motor position. The position is compared as the torque that the declared
controller outputs for it (`simulation.controller_torque`), so search, intervals and checks are those of a logged
torque.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import Setting
from jointid.common.text import number
from jointid.estimation.methods import Method, Task, default_method
from jointid.estimation.parameters import LOG_DELAY, adjust_parameters, require_friction
from jointid.estimation.pieces import GAIN, identify_records, identify_windows, lay_out, travel
from jointid.estimation.problems.inverse_model import Records, each_log, require_one_log
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.result.verdict import Reason, Subject, check_of, scale_check
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.checks import check_record, find_encoder_lag, find_record_warnings, range_faults, scale_faults
from jointid.records.chunks import InMemory, LongRecord, cut
from jointid.records.record import CHANNELS, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.controller_torque import compute_controller_torque

LARGEST = 600_000
"""Samples of all joints' records that are identified at once, in about 1 GiB for a joint; longer ones go in windows."""

WINDOW = 60_000
"""Samples of a window of such a record, of which one is checked."""

_LONGEST = 60.0  # s of a window, unless it is given
_CONSTANT = ("offset", "gravity_constant", "coulomb_forwards", "coulomb_backwards")  # includes a constant torque


def is_long(records: Sequence[Record]) -> bool:
    """Test for records of one clock with more than `LARGEST` samples."""
    clocks = {(len(channel), round(channel.sample_time, 12)) for one in records for _, channel in one.items()}
    return len(clocks) == 1 and min(clocks)[0] * len(records) > LARGEST


def windows_of(
    record: object, model: object, method: Method | None, several: Mapping[str, Any] | None = None
) -> float | None:
    """Window length of a long record, or of those of a robot, s; None if inapplicable."""
    log = _one_log(record, model)
    if not all(isinstance(one, Record) for one in log) or _refuse_windows(log, model, method, several):
        return None
    return min(_LONGEST, next(channel.sample_time for _, channel in log[0].items()) * WINDOW) if is_long(log) else None


def _one_log(record: Any, model: object) -> list[Any]:
    """Records of one log, a joint's alone or those of a robot's joints; none for several logs."""
    each = record if hasattr(model, "robot") and isinstance(record, list | tuple) else [record]
    return [] if any(isinstance(one, Sequence) for one in each) else list(each)


def part_of(record: Record) -> Record:
    """The record, or the window of a long one with most motion."""
    if not is_long([record]):
        return record
    samples = min(len(channel) for _, channel in record.items())
    parts = (cut(record, first, first + WINDOW) for first in range(0, samples - WINDOW + 1, WINDOW))
    return max(parts, key=lambda part: travel([part]))


def _refuse_windows(log: Sequence[Any], model: Any, method: Method | None, several: object) -> str:
    """Reason against windows, in a sentence; empty if there is none."""
    if not log or several or not hasattr(model, "loops") or not (method is None or method.simulates == "loop"):
        return (
            "Windows are of one log of a joint or robot under its loop: give its controllers and DIDIM, or leave "
            "windows out."
        )
    joints = [one.model for one in model.robot.joints] if hasattr(model, "robot") else [model.joint]
    computed = "motor_position" in getattr(method, "outputs", ()) or any(getattr(one, "computed", False) for one in log)
    known = [one for one in log if getattr(one, "columns", True) and "drive" not in getattr(one, "settings", ())]
    named = [getattr(one, "columns", None) or getattr(one, "record", one).channels for one in known]
    if hasattr(model, "robot") and (computed or any("torque" not in names for names in named)):
        return "Windows of a robot reproduce logged torques, not motor positions: log them, or leave windows out."
    if drifting := next((joint.friction.name for joint in joints if "drifting" in joint.friction.name), ""):
        return f'Windows take no {drifting} friction, which follows time: declare "symmetric", or cut by start, stop.'
    return ""


def fit(
    record: Record | Records | LongRecord,
    model: Any,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: Mapping[str, Any] | None = None,
    windows: float | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Fit a joint or a robot, without checks; see `jointid.identify`."""
    if fault := Setting("", above=0.0, type=float, optional=True).fault(windows):
        raise MethodError(f"windows, in seconds,{fault}")
    filtering, known, listed = filtering or Filtering(), parameters or {}, isinstance(record, list | tuple)
    log = _one_log(record, model)
    streamed = not all(isinstance(one, Record) for one in log)
    windows = windows or (_LONGEST if streamed else None)
    if windows is not None and (said := _refuse_windows(log, model, method, several)):
        raise MethodError(said)
    given: Any = record if listed else [record]
    every = [one for each in given for one in (each if hasattr(each, "__len__") else [each]) if hasattr(one, "items")]
    samples = sum(max((len(channel) for _, channel in one.items()), default=0) for one in every)
    if samples > LARGEST and windows is None and (method is None or method.simulates):
        progress(f"{samples:,} samples are identified at once, in about {samples / LARGEST:.2g} GiB or more")
    if isinstance(model, Robot | RobotLoop):
        if not listed or several:
            raise MethodError("A robot is identified from a list of its joints' records, without `several`: give that.")
        return _fit_robot(record, model, method or default_method(model), filtering, known, windows, progress)
    if listed:
        return _fit_records(record, model, method, filtering, known, several or {}, progress)
    if several is not None or isinstance(model, Sequence):
        raise MethodError("Several loops, and `several`, are of a list of records; received one: give all.")
    read, method = [] if streamed else log, method or default_method(model)
    if isinstance(model, ClosedLoop) and method.simulates == "loop":
        read = torques_of(read, [model] * len(read), method.outputs)

    def fit_alone(records: Sequence[Record], _: bool = False) -> Estimate:
        return identify_record(records[0], model, method, filtering, known, progress)

    logs = [InMemory(one) for one in read] or log
    found = fit_alone(read) if windows is None else identify_windows(logs, model, fit_alone, windows, progress)
    return state_scale(state_timing(found, read), read)


def _fit_records(
    records: Any,
    model: Any,
    method: Method | None,
    filtering: Filtering,
    known: Mapping[str, Parameter],
    several: Mapping[str, Any],
    progress: Progress,
) -> Estimate:
    """Fit a joint to several records, under their loops or by IDIM.

    Raises:
        RecordError, MethodError: records, model and method do not belong together.
    """
    shared = "added_inertia", "own", "free"
    asked = any(name not in shared or (any(v) if np.iterable(v) else v) for name, v in several.items())
    plain = isinstance(model, Joint | ClosedLoop) and not asked
    alike = plain and (method or default_method(model)).stacks
    by_loop = isinstance(model, ClosedLoop | Sequence) and (method is None or method.simulates == "loop")
    if not (records and all(isinstance(one, Record) for one in records) and (alike or by_loop)):
        raise MethodError(
            "Records are what `ji.read` returns, several a list, identified by their loop, or without it if they share "
            "all parameters: give a ClosedLoop and DIDIM, or leave out `several`."
        )
    marks = [fingerprint(one.torque.values) for one in records if one.torque is not None]
    if len({*marks}) < len(marks):
        raise MethodError("Two of the records are the same: name another file.")
    if alike:
        found = identify_record(records[0], model, method, filtering, known, progress, records[1:])
        return state_scale(state_timing(found, records), records)
    own: Any = method or default_method(model if isinstance(model, ClosedLoop) else model[0])
    layout = lay_out(len(records), model, own.free, several)
    own = replace(own, free=tuple(name for name in layout.free if name != GAIN))
    read = torques_of(records, layout.loops, own.outputs)
    alone = partial(identify_record, method=own, filtering=filtering, progress=progress)
    return state_scale(identify_records(read, layout, known, alone, progress), read)


def _fit_robot(
    record: Any, model: Any, method: Method, filtering: Filtering, known: Mapping[str, Parameter],
    windows: float | None, progress: Progress,
) -> Estimate:  # fmt: skip
    """Fit a robot to its joints' records, of one log or several."""
    robot: Robot = model.robot
    require_friction(robot, known)
    logs = () if record and not any(isinstance(one, Record | Sequence) for one in record) else each_log(record)
    _check_robot_records(logs, robot)
    method.require_settings_of("robot")
    if type(model) not in method.robots:
        raise MethodError(
            f"{type(method).__name__} is not for a {type(model).__name__}; use IDIM or DriveSideFit for "
            "a Robot, or DIDIM for a RobotLoop."
        )
    if method.simulates == "loop":
        logs = tuple(torques_of(log, model.loops, method.outputs) for log in logs)

    def fit_alone(records: Sequence[Record], in_motion: bool) -> Estimate:
        _check_robot_records([records], robot)
        moving = replace(model, in_motion=in_motion or model.in_motion)
        return method.identify_robot(moving, [records], filtering, known, progress)

    read = [one for log in logs for one in log]
    if windows is None:
        found = method.identify_robot(model, logs, filtering, known, progress)
    else:
        found = identify_windows([InMemory(one) for one in read] or record, model, fit_alone, windows, progress)
    notes = dict[str, dict[str, None]]()
    for name, one in (pair for log in logs for pair in zip(robot.names, log, strict=False)):
        for note in find_record_warnings(one, one.channels):
            notes.setdefault(note, {})[name] = None
    warnings = (f"{', '.join(names)}: {note}" for note, names in notes.items())
    return state_scale(state_timing(found, read), read).warn(*warnings)


def identify_record(
    record: Record,
    model: ClosedLoop | Joint,
    method: Method | None = None,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
    others: Sequence[Record] = (),
) -> Estimate:
    """Fit a joint to one record (IDIM: several); see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model, or an inertia is not positive.
    """
    loop = model if isinstance(model, ClosedLoop) else None
    joint: Any = getattr(model, "joint", model)
    chosen = method or default_method(model)
    wanted = adjust_parameters(joint.parameters, parameters or {})
    for one in (record, *others):
        check_record(one)
    chosen.require_settings_of(joint.model)
    if chosen.simulates != "loop":
        joint.require_linear(f"{chosen.title} takes")
    elif loop is None:
        raise MethodError(
            f"{chosen.title} simulates the closed loop, so it needs the controller; add [controller] or use "
            "learn-controller (in Python give a ClosedLoop), or use IDIM with a motor_position."
        )
    fit = chosen.identify(Task(record, joint, loop, wanted, filtering or Filtering(), progress, tuple(others)))
    said = [note for one in (record, *others) for note in find_record_warnings(one, fit.data.channels)]
    for p in wanted:
        if p.quantity is Quantity.INERTIA and p.free and fit.values.get(p.name, 1.0) <= 0:
            raise MethodError(
                f"The record gives {p.name} = {fit.values[p.name]:.4g}, which no joint has: the torque or the motion "
                "has the wrong sign (reverse record.channels.torque.sign), or they do not belong together"
                f"{''.join(f'; {note}' for note in said)}."
            )
    if {"motor_position", "load_position"} <= {*fit.data.channels} and (lag := find_encoder_lag(record)) is not None:
        late = f"{lag[0]} seems {number(1e3 * lag[1], 2)} ms late, which hides the spring"
        hidden = {"parameters": ["stiffness", "damping"], "lag": lag[1]}
        check = check_of(Subject.ENCODERS, False, Reason.ENCODER_LAG, late, hidden, f"correct the stamps of {lag[0]}")
        fit = replace(fit, checks=(*fit.checks, check))
    return replace(fit, records=() if others else (record,)).warn(*dict.fromkeys(said))


def _check_robot_records(logs: Sequence[Sequence[Record]], robot: Robot) -> None:
    """Check units and scales of a robot's records, also by its limits.

    Raises:
        RecordError: one cannot be in its units; each sentence names its joint.
    """
    back, faults = np.linalg.inv(robot.coupling), list[str]()
    for log in logs:
        require_one_log(log)
        if len(log) != len(robot):
            raise RecordError(f"A log of a robot has a record of each joint, {len(robot)}; received {len(log)}.")
        for k, (name, record) in enumerate(zip(robot.names, log, strict=False)):
            faults += [f"{name}: {said}" for said in scale_faults(record)]
            limits, alone = robot.links[k].limits, np.count_nonzero(back[k]) == 1
            position = record.motor_position or record.reference
            if limits.lower is not None and limits.upper is not None and alone and position is not None:
                faults += [f"{name}: {said}" for said in range_faults(position, (limits.lower, limits.upper))]
    if faults:
        raise RecordError(dict.fromkeys(faults))


# The torque that is reproduced


def torques_of(records: Sequence[Record], loops: Sequence[ClosedLoop], outputs: Sequence[str]) -> list[Record]:
    """Records with the torque to reproduce: logged, or from the motor position.

    `outputs` is "torque" or "motor_position", or empty for the torque if it is logged, else the position.

    Raises:
        RecordError: a record lacks a requested output.
    """
    logged = any(record.torque is not None for record in records)
    if tuple(outputs) == ("torque",) or (not outputs and logged):
        return list(records)
    return [compute_controller_torque(record, loop) for record, loop in zip(records, loops, strict=True)]


def state_scale(fit: Estimate, records: Sequence[Record]) -> Estimate:
    """Add a check of undetermined scales to a fit of computed torques.

    A fixed parameter other than 0 that is a part of the torque, or a known torque beside the controller's output,
    determines the common factor of controller and joint. The content of an integral at the first sample is unknown, and
    with it a constant torque: the parameters that include it lose their values.
    """
    computed = [(one, one.torque, one.computed_by) for one in records if one.computed_by and one.torque]
    if not computed:
        return fit
    rows = [row for row in fit.rows if row.of_joint]
    known = [row.name for row in rows if not row.free and row.value and row.unit.startswith(("N", "kg", "A", "V"))]
    if any(  # large enough beside the controller's output to determine a scale
        record.injected is not None and np.std(record.injected.channel.values) > 0.05 * np.std(torque.values)
        for record, torque, _ in computed
    ):
        known.append("the injected signal")
    integral = any(law.law(torque.sample_time).integrates for _, torque, law in computed)
    parts = {row.name: row.name.rpartition(".")[2].removeprefix("motor_").removeprefix("load_") for row in rows}
    lost = tuple(row.name for row in rows if integral and row.free and parts[row.name] in _CONSTANT)
    freed = any(not row.of_joint and row.free and row.name == "gain" for row in fit.rows)
    if freed and not known:
        raise MethodError(
            "From positions alone the controller's gain is one with the scale of the joint; expected a known inertia, "
            "friction or stiffness, or an injected torque: fix one of them, or keep the gain."
        )
    checks = (*fit.checks, scale_check(known, lost, identified=freed))
    read = {*fit.data.channels, "motor_position", *(name for *_, law in computed for name in law.channels)}
    data = replace(fit.data, channels=tuple(name for name in CHANNELS if name in read - {"torque"}))
    return replace(fit, checks=checks, data=data)


def state_timing(fit: Estimate, records: Sequence[Record]) -> Estimate:
    """Widen the drive side's delay by half a sample for unstated timing.

    Another reading of the torque, held or sampled, changes that delay by half a sample and nothing else. For DIDIM both
    are the same: a controller's output is the same at its stamp and until its next period.
    """
    stated = all(one.torque.stated for one in records if one.torque is not None)
    if stated or fit.settings.simulates != "motion":
        return fit
    more = 0.25 * fit.data.sample_time  # half of it in two deviations
    rows = tuple(
        replace(row, stderr=float(np.hypot(row.stderr, more))) if row.name == LOG_DELAY.name and row.stderr else row
        for row in fit.rows
    )
    return replace(fit, rows=rows).warn(
        "it is not stated whether the torque is held or sampled: log_delay, which makes up for the difference, is "
        "estimated, counts from a held torque, and its interval covers half a sample; state timing of its channel"
    )
