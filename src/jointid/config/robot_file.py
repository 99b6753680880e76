"""The robot file (TOML): the robot's model, its joints with their drives, and the record of all of them.

Each of [[joints]] is the table of a joint, with the further tables of a joint file below it. Together with the tables
that all joints share it is checked as a joint file. In the name of a column ``{joint}`` stands for the joint's name,
``{axis}`` for its place in the file from 1, ``{index}`` for one less.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common import messages
from jointid.common.errors import Fault, JointFileError, JointidError, MethodError
from jointid.common.parameters import Parameter
from jointid.common.settings import Declared, setting, settings_of
from jointid.common.text import join
from jointid.common.units import Kind
from jointid.config.file import Axis, FeedForward, File, axis_of, joint_file_of, name_axes, resolve_place
from jointid.config.robot_model import load_robot, reorder_joints
from jointid.config.rules import foreign_settings
from jointid.config.schema import (
    ChannelsTable,
    ChannelTable,
    DriveTable,
    FileTable,
    FilteringTable,
    JointTable,
    MethodTable,
    RecordTable,
)
from jointid.config.source import Run
from jointid.config.table import Reader, Table, fault_at, part, required
from jointid.estimation.robots.numbers import name_in_robot
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.inertial import MassProperties, is_physical
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.models.springs import SPRINGS, ElasticLoad, find_spring

_UPRIGHT = 1e-3  # rad, that a base is off the upright and yet upright
_TURNS = 2 * math.pi  # rad


class RobotTable(Table):
    """[robot]: its model, and how it stands."""

    model: str = required("path of its URDF or MJCF file, from the robot file's folder")
    name: str | None = setting(None, "what reports call the robot; without it as the model does")
    base: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "roll, pitch and yaw of its base: about the fixed axes x, y and z of a world with z upwards [rad]",
        expected="a list of three numbers",
    )
    feed_forward: FeedForward = setting("none", "what the drives are given beside the controllers' torque")
    locked: Mapping[str, float] = part(
        dict,
        "by the names of joints of the model that stand still and that no log has, their positions [rad or "
        "m]; or a list of such joints, which stand at 0",
        expected="a table of numbers, or a list of joints",
    )
    in_motion: bool = setting(False, "whether the records begin while the robot moves, as its references do")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield angles above a turn, which are degrees."""
        if any(abs(angle) > _TURNS for angle in self.base):
            said = f" is {list(self.base)}, beyond a turn; expected roll, pitch and yaw in rad: convert the degrees."
            yield "base", said


class JointSpringTable(Table):
    """joints.spring: between motor and link, with the link's friction; a bare word is its law."""

    of = (JointSpring,)
    shorthand = "law"

    law: str = setting("linear", "the spring's law", accept=find_spring, choices=tuple(SPRINGS))
    stiffness: float | None = setting(
        None,
        "of the spring, where a search begins, unless joints.parameters says it [N m/rad or N/m]",
        above=0,
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of numbers without a stiffness."""
        if self.stiffness is None and set(self.given) - {"law"}:
            yield "stiffness", self.lacks("stiffness")


class RobotJointTable(JointTable):
    """[[joints]]: one joint, in the order in which they are reported; what is left out is as the model says it."""

    of = (RobotJoint,)

    name: str = required("of the joint in the model")
    kind: Kind | None = setting(None, "how the joint moves, as the model says it")  # type: ignore[assignment]
    model: Literal["rigid", "flexible"] | None = setting(  # type: ignore[assignment]
        None, "as joint.model of a joint file; without it flexible where there is a spring"
    )
    spring: JointSpringTable | None = setting(  # type: ignore[assignment]
        None, "between motor and link; without it the joint is rigid"
    )
    zero: float = setting(
        0.0, "position of the model's joint where its logged position is 0 [rad or m]; the model is turned"
    )
    channels: ChannelsTable | None = setting(None, "its channels, where they are not as [record.channels]")

    @classmethod
    def declare(cls) -> dict[str, Declared]:
        """Return the keys of the joint, and the tables that it may have as a joint file has them."""
        return super().declare() | {name: FileTable.declared()[name] for name in (*_OF_JOINT_FILE, "limits", "method")}

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield nothing: what a joint may not be is seen beside what the model says of it."""
        yield from ()

    @property
    def flexible(self) -> bool:
        """Whether the joint has a spring."""
        return self.spring is not None if self.model is None else self.model == "flexible"

    def table(self, kind: Kind) -> JointTable:
        """Return [joint] of a joint file that says the same."""
        own = {key: value for key, value in self.given.items() if key in JointTable.declared()}
        own |= {"kind": kind, "model": "flexible" if self.flexible else "rigid"}
        return JointTable(own if self.spring is None else own | {"spring": self.spring.law})


class RobotRunTable(Table):
    """[[records]]: one of several logs that are identified together, and what the last link carries in it."""

    file: str = required("path of the record, from the robot file's folder")
    payload_mass: float | None = setting(
        None, "of what the last link carries in this record beside the robot's model [kg]", above=0
    )
    payload_center: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "its centre of mass in the frame of the last link [m]",
        expected="a list of three numbers",
    )
    payload_inertia: tuple[float, float, float, float, float, float] = setting(
        6 * (0.0,),
        "its inertia xx, xy, xz, yy, yz, zz about that centre, along the axes of the last link [kg m2]",
        expected="a list of six numbers",
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of a payload without a mass, or that no body can have."""
        if self.payload_mass is None and (any(self.payload_center) or any(self.payload_inertia)):
            yield "payload_mass", self.lacks("payload_mass")
        elif self.payload and not is_physical(np.array(self.payload)):
            said = f" is {list(self.payload_inertia)}, which no body has; expected principal moments that are not "
            yield "payload_inertia", f"{said}negative, none above the sum of the others: correct it."

    @property
    def payload(self) -> tuple[float, ...]:
        """The ten inertial parameters of `Record.payload`."""
        if self.payload_mass is None:
            return ()
        inertia = np.zeros((3, 3))
        inertia[np.triu_indices(3)] = self.payload_inertia
        whole = inertia + inertia.T - np.diag(np.diag(inertia))
        body = MassProperties(self.payload_mass, np.array(self.payload_center), whole)
        return tuple(map(float, body.inertial))


class RobotFileTable(Table):
    """A robot file."""

    robot: RobotTable = required("the robot's model")
    record: RecordTable = part(RecordTable, "the file of the record, and its channels")
    records: tuple[RobotRunTable, ...] = setting((), "logs that are identified together")
    drive: DriveTable = part(DriveTable, "whose traces they are, and its own units")
    filtering: FilteringTable = part(FilteringTable, "how signals are filtered")
    method: MethodTable = part(MethodTable, "how the robot is identified")
    joints: tuple[RobotJointTable, ...] = required("the joints", expected="one [[joints]] table for each joint")

    @property
    def method_name(self) -> str:
        """Name of the given method, or of the default one for the channels."""
        if self.method.name is not None:
            return self.method.name
        shared, controlled = self.record.channels, all(one.controller is not None for one in self.joints)
        own = [one.channels for one in self.joints if one.channels is not None]
        logged = any(one.torque is not None for one in (shared, *own)) or self.drive.profile is not None
        if controlled and not logged and self.record.torque != "logged":
            return "didim"  # of the motor positions
        # A joint without a controller leaves one method only.
        measured = self.record.channels.motor_position is not None or any(
            one.controller is None or (one.channels is not None and one.channels.motor_position is not None)
            for one in self.joints
        )
        return "didim" if not measured else "drive_side" if any(one.flexible for one in self.joints) else "idim"

    def table(self, number: int, kind: Kind, *, alone: bool = False) -> FileTable:
        """Return the joint file of one joint: the tables that all share, channels by its name and place, its own.

        Args:
            number: of the joint, from 0.
            kind: of the joint.
            alone: whether it is identified alone, by its own method.
        """
        own = self.joints[number]
        channels = self.record.channels.given | ({} if own.channels is None else own.channels.given)
        named = {channel: _fill_placeholders(table, own.name, number) for channel, table in channels.items()}
        place: dict[str, Any] = {} if self.drive.profile is None else {"axis": number + 1, "joint": own.name}
        # What a joint of a robot is identified by is not its own method, but says which channels must be there.
        name = "didim" if self.method_name == "didim" else "drive_side" if own.flexible else "idim"
        alone = alone and "method" in own.given
        method = own.method.given if alone else {}
        table = FileTable(
            {
                "joint": own.table(kind),
                "record": RecordTable({**self.record.given, "channels": ChannelsTable(named)}),
                "drive": DriveTable(place | self.drive.given),
                "method": MethodTable({**method, "name": method.get("name") or name}),
                "filtering": self.filtering,
                "limits": own.limits,
                **{name: own.given[name] for name in _OF_JOINT_FILE if name in own.given},
            }
        )
        said = ("method",) if alone else ()
        return table.as_axis(number, (*said, *(() if own.channels is None else own.channels.given)))


_OF_JOINT_FILE = ("transmission", "gravity", "ripple", "controller", "parameters")
"""Tables of a joint file that are below [[joints]] in a robot file."""

_TABLES = (*_OF_JOINT_FILE, "spring", "channels", "limits", "method")
"""All tables below [[joints]]."""


def _fill_placeholders(table: ChannelTable, name: str, number: int) -> ChannelTable:
    """Return a channel with the placeholders of its texts replaced by name and number."""
    filled = dict(table.given)
    for stand_in, meant in {"{joint}": name, "{axis}": str(number + 1), "{index}": str(number)}.items():
        texts = {key: value for key, value in filled.items() if type(value) is str}
        filled |= {key: text.replace(stand_in, meant) for key, text in texts.items()}
    return type(table)(filled)


def read_robot_file(tables: Mapping[str, Any], path: Path, axis: str | None = None) -> File:
    """Return a robot file; see `jointid.config.file_of`."""
    said = read_robot_tables(tables)
    name = said.method_name
    if faults := [fault_at(("method", key), rest) for key, rest in foreign_settings(said.method, name, "robot")]:
        raise JointFileError(faults)
    bare, method = _robot(said, path.parent), said.method.method(name)
    axes = _axes(said, bare)
    if axis is not None:
        return replace(_alone(said, bare, axis, path), tables=tables)
    _require_one_payload(said.records, path.parent)
    return File(
        axes=axes,
        robot=_with_numbers(said, bare, axes),
        method=method,
        filtering=said.filtering.build(),
        parameters=_parameters(axes),
        feed_forward=said.robot.feed_forward,
        in_motion=said.robot.in_motion,
        model_path=path.parent / said.robot.model,
        locked=dict(said.robot.locked),
        name=said.robot.name,
        runs=tuple(Run(one.file, payload=one.payload) for one in said.records),
        path=path,
        tables=tables,
    )


def _with_numbers(said: RobotFileTable, bare: Robot, axes: Sequence[Axis]) -> Robot:
    """Return the robot with the numbers and laws of its joints."""
    each = list(zip(said.joints, bare.joints, axes, strict=True))
    faults = [
        fault_at(("joints", n, *place), rest) for n, (own, _, axis) in enumerate(each)
        for place, rest in _model_faults(own, axis)
    ]  # fmt: skip
    if currents := {str(axis.name): axis.joint.torque_unit for axis in axes if axis.joint.torque_unit}:
        units = join(list(dict.fromkeys(currents.values())))
        faults.append(Fault(
            f"The torque of {join(list(currents))} is in {units}; the joints of a robot share inertias, so "
            f"expected N m or N: give each of these joints torque_constant (1.0 for parameters per {units})."
        ))  # fmt: skip
    if faults:
        raise JointFileError(faults)
    try:
        return replace(bare, joints=tuple(_joint(*one) for one in each))
    except JointidError as error:
        raise JointFileError(f"joints: {error}") from error


def _alone(said: RobotFileTable, model: Robot, name: str, path: Path) -> File:
    """Return the file of one joint, identified alone, as if no other joint moved.

    The method is that of `joints.method`, or that of the robot with default settings. Gravity is what
    `joints.gravity` says. Numbers of the [[joints]] table are starts of the parameters; that of a
    rigid joint's inertia is the rotor's with the links that it moves, all other joints at 0.

    Args:
        said: the tables.
        model: the robot as its model says.
        name: of the joint.
        path: of the file.

    Raises:
        MethodError: the robot has no such joint.
    """
    names = [one.name for one in said.joints]
    if name not in names:
        raise MethodError(f"The axis{messages.no_choice(name, names)}")
    number = names.index(name)
    own, kind = said.joints[number], model.links[number].kind
    file = joint_file_of(said.table(number, kind, alone=True), path)
    axis, parameters = file.axis, dict(file.parameters)
    rotor = float(own.given.get("rotor_inertia", model.joints[number].rotor_inertia))
    whole = model.axis_inertia(number) + rotor
    rigid = [(parameter, whole) for parameter in axis.joint.parameters if parameter.name == "inertia"]
    for parameter, start in (*rigid, *_stated_starts(own, axis)):
        known = parameters.get(parameter.name, parameter)
        unsaid = parameter.name not in parameters or known.start is None
        if unsaid and known.lower <= start <= known.upper:
            parameters[parameter.name] = replace(known, start=start)
    return replace(file, axes=(replace(axis, parameters=parameters),), parameters=parameters)


def read_robot_tables(tables: Mapping[str, Any]) -> RobotFileTable:
    """Return the tables of a robot file, each right in itself.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    robot = tables.get("robot")
    if isinstance(robot, dict) and isinstance(still := robot.get("locked"), list):
        at_zero = {name: 0.0 for name in still if isinstance(name, str)}
        tables = {**tables, "robot": {**robot, "locked": at_zero}}
    reader = Reader()
    said: RobotFileTable = reader.read(RobotFileTable, tables)
    reader.require()
    return said


def _require_one_payload(runs: Sequence[RobotRunTable], folder: Path) -> None:
    """Refuse a record that is listed with two payloads."""
    found = dict[Path, tuple[float, ...]]()
    for number, run in enumerate(runs):
        if found.setdefault(resolve_place(folder / run.file), run.payload) != run.payload:
            rest = f' is "{run.file}", listed before with another payload; expected one: leave one of both out.'
            raise JointFileError(fault_at(("records", number, "file"), rest))


def _robot(said: RobotFileTable, folder: Path) -> Robot:
    """Return the model with what the file says of its joints."""
    names = [one.name for one in said.joints]
    if both := [name for name in names if name in said.robot.locked]:
        raise JointFileError(f"robot.locked names {', '.join(both)} of [[joints]], which move; leave one of both out.")
    model = load_robot(folder / said.robot.model, said.robot.locked)
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


def _axes(said: RobotFileTable, robot: Robot) -> tuple[Axis, ...]:
    axes, faults = list[Axis](), dict[Fault, list[str]]()
    for number, (own, link) in enumerate(zip(said.joints, robot.links, strict=True)):
        if own.kind not in (None, link.kind):
            rest = f' is "{own.kind}", but the model says "{link.kind}": leave it out, or correct the model.'
            raise JointFileError(fault_at(("joints", number, "kind"), rest))
        try:
            axes.append(axis_of(said.table(number, link.kind)))
        except JointFileError as error:
            for fault in error.faults:
                of_axis = fault.place[:1] == ("joints",)
                faults[fault] = list(robot.names) if of_axis else [*faults.get(fault, ()), own.name]
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


_NUMBERS = [one.name for one in settings_of(RobotJoint) if one.name not in ("spring", "coupling")]
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


def _stated_starts(own: RobotJointTable, axis: Axis) -> Iterator[tuple[Parameter, float]]:
    """Yield parameters of a joint with the numbers of its table, the inverse of `_starts`."""
    numbers = own.settings(*_TABLES)
    for name in ("viscous", "coulomb"):
        if name in numbers:
            numbers.setdefault(f"{name}_backwards", numbers[name])
    spring = {} if own.spring is None else own.spring.settings("law")
    for parameter in axis.joint.parameters:
        name = parameter.name.removeprefix("motor_")
        of_spring = _OF_SPRING.get(parameter.name.removesuffix("_forwards").removesuffix("_backwards"))
        given = numbers.get(_AS_MOTOR.get(name, name)) if of_spring is None else spring.get(of_spring)
        if given is not None and parameter.name != "inertia":
            yield parameter, float(given)


def _joint(own: RobotJointTable, joint: RobotJoint, axis: Axis) -> RobotJoint:
    """Return a joint of the model with the file's numbers and laws."""
    motor, spring, numbers = _starts(axis)
    given = {name: value for name, value in own.settings(*_TABLES).items() if name in (*_NUMBERS, "coupling")} | motor
    friction = axis.joint.friction
    if friction.stepped:
        given["friction"] = friction
    if friction.name.startswith("asymmetric") and not {"viscous_backwards", "coulomb_backwards"} & set(given):
        given["viscous_backwards"] = given.get("viscous", joint.viscous)
    if isinstance(axis.joint, FlexibleJoint):
        stated = {} if own.spring is None else own.spring.settings("law")
        given["spring"] = JointSpring(**stated | spring, law=axis.joint.spring)
    return replace(joint, **given, numbers=numbers)


def _model_faults(own: RobotJointTable, axis: Axis) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield place and rest of a sentence on unsupported tables, and on missing numbers of the laws."""
    motor, excess, numbers = _starts(axis)
    friction, spring = axis.joint.friction.name, getattr(axis.joint, "spring", None)
    if "load_inertia" in axis.parameters:
        yield ("parameters", "load_inertia"), " is that of the robot's links; leave it out, or change the model."
    if friction.endswith("stribeck") and own.stribeck_speed is None and "stribeck_speed" not in motor:
        yield ("stribeck_speed",), " is missing; expected the speed below which friction rises: add it."
    if spring is not None and "stiffness" not in excess and (own.spring is None or own.spring.stiffness is None):
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
