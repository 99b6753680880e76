"""The robot file: its model, and an axis for each of its joints.

Each of [[joints]] is the table of a joint, with the further tables of a joint file below it. In the name of a column
``{joint}`` stands for the joint's name, ``{axis}`` for its place in the file from 1, ``{index}`` for one less.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common import messages
from jointid.common.errors import Fault, JointFileError, JointidError, MethodError
from jointid.common.parameters import Parameter
from jointid.common.text import join
from jointid.common.units import Kind
from jointid.config.building import axis_of, complete, joint_file, robot_method
from jointid.config.declaration import (
    AXIS_TABLES,
    AxisTable,
    FileTable,
    fault_at,
    keys_of,
    make_method,
)
from jointid.config.file import Axis, File, name_axes, resolve_place
from jointid.config.robot_model import load_robot, reorder_joints
from jointid.config.rules import Declaration, foreign_settings
from jointid.estimation.robots.numbers import name_in_robot
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.models.springs import ElasticLoad
from jointid.records.columns import Column

_UPRIGHT = 1e-3  # rad, that a base is off the upright and yet upright


def _declare_axis(file: FileTable, raw: Mapping[str, Any], number: int, kind: Kind, alone: bool = False) -> Declaration:
    """Declare one joint of a robot file: the tables that all share, channels by its name and place, its own.

    Args:
        file: what its tables say.
        raw: the tables as `tomllib` reads them.
        number: of the joint, from 0.
        kind: of the joint, as the model says it.
        alone: whether it is identified alone, by its own method.
    """
    axis, written = file.joints[number], raw["joints"][number]
    columns = {**file.columns, **axis.channels}
    drive = file.drive
    if drive.profile is not None:
        drive = replace(drive, axis=drive.axis or number + 1, joint=drive.joint or axis.name)
    # What a joint of a robot is identified by is not its own method, but says which channels must be there.
    name = "didim" if robot_method(file) == "didim" else "drive_side" if axis.model == "flexible" else "idim"
    method = dict(axis.method or {}) if alone else {}
    own = (*axis.channels, *(("method",) if method else ()))
    return complete(Declaration(
        file=file, axis=axis, raw={"joint": written, **{key: written[key] for key in AXIS_TABLES if key in written}},
        kind=kind, columns={key: _fill_placeholders(one, str(axis.name), number) for key, one in columns.items()},
        drive=drive, gear=None, method={"name": name, **method}, number=number, own=own,
    ))  # fmt: skip


def _fill_placeholders(column: Column, name: str, number: int) -> Column:
    """Return a column with the placeholders of its names replaced by name and number."""

    def filled(text: str) -> str:
        for stand_in, meant in {"{joint}": name, "{axis}": str(number + 1), "{index}": str(number)}.items():
            text = text.replace(stand_in, meant)
        return text

    return replace(column, column=filled(column.column), time=None if column.time is None else filled(column.time))


def robot_file(said: FileTable, raw: Mapping[str, Any], path: Path, axis: str | None = None) -> File:
    """Return a robot file, or the file of one of its joints alone.

    Args:
        said: what its tables say.
        raw: the tables as `tomllib` reads them.
        path: of the file.
        axis: name of the joint that is taken alone.

    Raises:
        JointFileError: with one sentence for each fault, of the file or of the model that it names.
        MethodError: the robot has no such joint.
    """
    assert said.robot is not None
    name = robot_method(said)
    if faults := [fault_at(("method", key), rest) for key, rest in foreign_settings(said.method, name, "robot")]:
        raise JointFileError(faults)
    bare = _robot(said, path.parent)
    axes = _axes(said, raw, bare)
    if axis is not None:
        return _alone(said, raw, bare, axis, path)
    _require_one_payload(said, path.parent)
    return File(
        axes=axes,
        robot=_with_numbers(said, bare, axes),
        method=make_method(name, said.method),
        filtering=said.filtering,
        parameters=_parameters(axes),
        feed_forward=said.robot.feed_forward,
        in_motion=said.robot.in_motion,
        model_path=path.parent / said.robot.model,
        locked=said.robot.locked or {},
        name=said.robot.name,
        runs=said.records,
        path=path,
    )


def _with_numbers(said: FileTable, bare: Robot, axes: Sequence[Axis]) -> Robot:
    """Return the robot with the numbers and laws of its joints."""
    each = list(zip(said.joints, bare.joints, axes, strict=True))
    faults = [
        fault_at(("joints", n, *place), rest)
        for n, (own, _, axis) in enumerate(each)
        for place, rest in _model_faults(own, axis)
    ]
    if faults:
        raise JointFileError(faults)
    if currents := {str(axis.name): axis.joint.torque_unit for axis in axes if axis.joint.torque_unit}:
        units = join(list(dict.fromkeys(currents.values())))
        raise MethodError(
            f"The torque of {join(list(currents))} is in {units}; the joints of a robot share inertias, so "
            f"expected N m or N: give each of these joints torque_constant (1.0 for parameters per {units})."
        )
    try:
        return replace(bare, joints=tuple(_joint(*one) for one in each))
    except JointidError as error:
        raise JointFileError(f"joints: {error}") from error


def _alone(said: FileTable, raw: Mapping[str, Any], model: Robot, name: str, path: Path) -> File:
    """Return the file of one joint, identified alone, as if no other joint moved.

    The method is that of `joints.method`, or that of the robot with default settings. Gravity is what
    `joints.gravity` says. Numbers of the [[joints]] table are starts of the parameters; that of a
    rigid joint's inertia is the rotor's with the links that it moves, all other joints at 0.
    """
    names = [str(one.name) for one in said.joints]
    if name not in names:
        raise MethodError(f"The axis{messages.no_choice(name, names)}")
    number = names.index(name)
    own = said.joints[number]
    file = joint_file(_declare_axis(said, raw, number, model.links[number].kind, alone=True), path)
    axis, parameters = file.axis, dict(file.parameters)
    rotor = float(own.numbers.get("rotor_inertia", model.joints[number].rotor_inertia))
    whole = model.axis_inertia(number) + rotor
    rigid = [(parameter, whole) for parameter in axis.joint.parameters if parameter.name == "inertia"]
    for parameter, start in (*rigid, *_stated_starts(own, axis)):
        known = parameters.get(parameter.name, parameter)
        unsaid = parameter.name not in parameters or known.start is None
        if unsaid and known.lower <= start <= known.upper:
            parameters[parameter.name] = replace(known, start=start)
    return replace(file, axes=(replace(axis, parameters=parameters),), parameters=parameters, runs=())


def _require_one_payload(said: FileTable, folder: Path) -> None:
    """Refuse a record that is listed with two payloads."""
    found = dict[Path, tuple[float, ...]]()
    for number, run in enumerate(said.records):
        if found.setdefault(resolve_place(folder / run.file), run.payload) != run.payload:
            rest = f' is "{run.file}", listed before with another payload; expected one: leave one of both out.'
            raise JointFileError(fault_at(("records", number, "file"), rest))


def _robot(said: FileTable, folder: Path) -> Robot:
    """Return the model with what the file says of its joints."""
    assert said.robot is not None
    names, locked = [str(one.name) for one in said.joints], said.robot.locked or {}
    if both := [name for name in names if name in locked]:
        raise JointFileError(f"robot.locked names {', '.join(both)} of [[joints]], which move; leave one of both out.")
    model = load_robot(folder / said.robot.model, locked)
    strange = [name for name in dict.fromkeys(names) if name not in model.names or names.count(name) > 1]
    missing = [name for name in model.names if name not in names]
    if strange or missing:
        raise JointFileError(
            f"joints has {', '.join(strange) or 'none'} too many and lacks {', '.join(missing) or 'none'}; expected "
            f"{', '.join(model.names)}, each once: name those that stand still in robot.locked, as "
            f"locked = {{ {' = 0.0, '.join(missing or model.names)} = 0.0 }}."
        )
    ordered = reorder_joints(model, names).turn(np.array([float(one.zero) for one in said.joints]))
    if list(ordered.names) != names:
        raise JointFileError(
            f"joints lists {', '.join(names)}; expected each joint after the one that carries it: write them as "
            f"{', '.join(ordered.names)}."
        )
    down = -np.linalg.norm(ordered.gravity) * np.array([0.0, 0.0, 1.0])
    if any(said.robot.base) and np.linalg.norm(ordered.gravity - down) > _UPRIGHT * np.linalg.norm(down):
        own = " ".join(f"{value:.4g}" for value in ordered.gravity)
        raise JointFileError(
            f"robot.base turns the model, whose own gravity is turned already ({own} m/s2), as in "
            "an export of a robot on a turned base; expected one of both: leave base out, or set the model's gravity "
            "to 0 0 -9.81."
        )
    turned = Rotation.from_euler("xyz", said.robot.base).as_matrix().T @ ordered.gravity
    # A base that is written as 3.1416 hangs upside down: no record would show a trace of gravity sideways.
    turned = np.where(np.abs(turned) < _UPRIGHT * np.linalg.norm(turned), 0.0, turned)
    return replace(ordered, gravity=turned, name=said.robot.name or ordered.name)


def _axes(said: FileTable, raw: Mapping[str, Any], robot: Robot) -> tuple[Axis, ...]:
    axes, faults = list[Axis](), dict[Fault, list[str]]()
    for number, (own, link) in enumerate(zip(said.joints, robot.links, strict=True)):
        if own.kind not in (None, link.kind):
            rest = f' is "{own.kind}", but the model says "{link.kind}": leave it out, or correct the model.'
            raise JointFileError(fault_at(("joints", number, "kind"), rest))
        try:
            axes.append(axis_of(_declare_axis(said, raw, number, link.kind)))
        except JointFileError as error:
            for fault in error.faults:
                of_axis = fault.place[:1] == ("joints",)
                faults[fault] = list(robot.names) if of_axis else [*faults.get(fault, ()), str(own.name)]
    for axis in axes:
        if axis.joint.transmission is not None and axis.joint.transmission.side == "motor":
            side = 'transmission.side is "motor"; all numbers of a robot are behind its gears: leave side out.'
            faults.setdefault(Fault(side), []).append(str(axis.name))
    for name, joints in _shared_columns(axes).items():
        shared = Fault(f"{name} is one column of several joints; give each one of its own, as with {{axis}}.")
        faults.setdefault(shared, []).extend(joints)
    if faults:
        raise JointFileError(name_axes(faults, len(robot)))
    return tuple(axes)


def _parameters(axes: Sequence[Axis]) -> dict[str, Parameter]:
    """Return values and bounds that the identification keeps, by the names of a robot's parameters."""
    found = dict[str, Parameter]()
    for axis in axes:
        known = {parameter.name: parameter for parameter in axis.joint.parameters}
        lines = {parameter.name for parameter in axis.joint.linear.parameters}
        for name, stated in axis.parameters.items():
            own = name_in_robot(str(axis.name), _OF_ROBOT.get(name, name))
            if name not in lines:
                found[own] = stated
            elif stated != replace(known[name], start=stated.start):
                # A start of lines is a number of the robot that is built, and no start of a search.
                found[own] = replace(stated, start=None) if stated.free else stated
    return found


_NUMBERS = keys_of(RobotJoint, without=("spring", "coupling"))
_AS_MOTOR = {"inertia": "rotor_inertia", "viscous_forwards": "viscous", "coulomb_forwards": "coulomb"}
"""Parameters of a joint that have another name as a number of a robot's motor."""

_OF_ROBOT = {"inertia": "rotor_inertia", "motor_inertia": "rotor_inertia"}
"""Parameters of a joint that have another name among the parameters of a robot."""

_OF_SPRING = {name: name.removeprefix("load_") for name in ("stiffness", "damping", "load_viscous", "load_coulomb")}
"""Parameters of a joint that are numbers of a robot's spring."""


def _starts(axis: Axis) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return starts of an axis's parameters: of the motor, of the spring, and beside these the laws' own."""
    motor, spring, numbers = dict[str, float](), dict[str, float](), dict[str, float]()
    for name, parameter in axis.parameters.items():
        own = name.removeprefix("motor_")
        own = _AS_MOTOR.get(own, own)
        if parameter.start is None:
            continue
        if own in _NUMBERS:
            motor[own] = float(parameter.start)
        elif own in _OF_SPRING:
            spring[_OF_SPRING[own]] = float(parameter.start)
        else:
            numbers[name] = float(parameter.start)
    return motor, spring, numbers


def _stated_starts(own: AxisTable, axis: Axis) -> Iterator[tuple[Parameter, float]]:
    """Yield parameters of a joint with the numbers of its table, the inverse of `_starts`."""
    numbers = dict(own.numbers)
    for name in ("viscous", "coulomb"):
        if name in numbers:
            numbers.setdefault(f"{name}_backwards", numbers[name])
    for parameter in axis.joint.parameters:
        name = parameter.name.removeprefix("motor_")
        of_spring = _OF_SPRING.get(parameter.name.removesuffix("_forwards").removesuffix("_backwards"))
        given = numbers.get(_AS_MOTOR.get(name, name)) if of_spring is None else own.link.get(of_spring)
        if given is not None and parameter.name != "inertia":
            yield parameter, float(given)


def _joint(own: AxisTable, joint: RobotJoint, axis: Axis) -> RobotJoint:
    """Return a joint of the model with the file's numbers and laws."""
    motor, spring, numbers = _starts(axis)
    given: dict[str, Any] = {**own.numbers, **motor}
    friction = axis.joint.friction
    if friction.stepped:
        given["friction"] = friction
    if friction.name.startswith("asymmetric") and not {"viscous_backwards", "coulomb_backwards"} & set(given):
        given["viscous_backwards"] = given.get("viscous", joint.viscous)
    if isinstance(axis.joint, FlexibleJoint):
        given["spring"] = JointSpring(**{**own.link, **spring}, law=axis.joint.spring)
    return replace(joint, **given, numbers=numbers)


def _model_faults(own: AxisTable, axis: Axis) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield place and rest of a sentence on unsupported tables, and on missing numbers of the laws."""
    motor, excess, numbers = _starts(axis)
    friction, spring = axis.joint.friction.name, getattr(axis.joint, "spring", None)
    if "load_inertia" in axis.parameters:
        yield ("parameters", "load_inertia"), " is that of the robot's links; leave it out, or change the model."
    if friction.endswith("stribeck") and not {"stribeck_speed"} & {*own.numbers, *motor}:
        yield ("stribeck_speed",), " is missing; expected the speed below which friction rises: add it."
    if spring is not None and not {"stiffness"} & {*own.link, *excess}:
        yield ("spring", "stiffness"), " is missing; expected a positive number (where a search begins): add it."
    if isinstance(spring, ElasticLoad):
        yield ("spring",), f' is "{spring.name}"; what swings is a link of its own: add a link with a spring.'
    if axis.joint.gravity is not None:
        yield ("gravity",), " is that of the masses of the robot's model; leave it out."
    if axis.joint.ripple is not None:
        yield ("ripple",), " is not simulated with a robot; leave it out."
    elif not isinstance(spring, ElasticLoad):
        known = {one.name for one in axis.joint.linear.parameters} | set(numbers)
        for name in [one.name for one in axis.joint.parameters if one.name not in known]:
            force, rises, _ = name.partition("stribeck_")  # friction rises towards standstill where its force is given
            if not rises or f"{force}stribeck_force" in numbers:
                yield ("parameters", name), " is missing; expected a number of the joint's laws: add it."


def _shared_columns(axes: Sequence[Axis]) -> dict[str, list[str]]:
    """Return channels that share a column, with the names of their joints."""
    found: dict[str, list[str]] = {}
    for axis in axes:
        for channel, column in axis.columns.items():
            if column.column and axis.drive.traces is None:
                found.setdefault(f'{channel} from "{column.column}"', []).append(str(axis.name))
    return {name: joints for name, joints in found.items() if len(joints) > 1}
