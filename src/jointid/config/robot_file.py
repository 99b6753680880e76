"""The robot file (TOML): the robot's model, its joints with their drives, and the record of all of them.

Each of [[joints]] is the table of a joint, with the further tables of a joint file below it. Together with the tables
that all joints share it is checked as a joint file. In the name of a column ``{joint}`` stands for the joint's name,
``{axis}`` for its place in the file from 1, ``{index}`` for one less.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from pydantic import Field, ValidationError

from jointid.common import messages
from jointid.common.arrays import FloatArray
from jointid.common.errors import Fault, JointFileError, JointidError, MethodError, RecordError
from jointid.common.messages import Progress, Says, ignore_progress
from jointid.common.parameters import Parameter
from jointid.common.settings import settings_of
from jointid.common.units import Kind
from jointid.config.contents import JointFile
from jointid.config.robot_model import load_robot, reorder_joints
from jointid.config.schema import (
    ControllerTable,
    FileTable,
    FilteringTable,
    GravityTable,
    JointTable,
    LimitsTable,
    MethodTable,
    ParameterTable,
    RippleTable,
    TransmissionTable,
    keys_of,
)
from jointid.config.schema_record import ChannelsTable, ChannelTable, DriveTable, RecordTable, Run, Source
from jointid.config.table import Number, Positive, Table, Text, accept_by, fault_at, faults_of, keys_from
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import ROBOT
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import FlexibleJoint
from jointid.models.limits import ROBOT_LIMITS, AxisLimits
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.models.springs import SPRINGS, ElasticLoad, find_spring
from jointid.records.formats import Table as RecordedTable
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write_columns
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop, add_feed_forward

_UPRIGHT = 1e-3  # rad, that a base is off the upright and yet upright
_TURNS = 2 * math.pi  # rad

FeedForward: TypeAlias = Literal["none", "gravity", "inverse-model", "logged"]
Angles = Annotated[list[Number], Field(min_length=3, max_length=3), Says("a list of three numbers")]
NumbersByName = Annotated[dict[str, Number], Says("a table of numbers by names")]


class RobotTable(Table):
    """[robot]: its model, and how it stands."""

    model: Text = Field(description="path of its URDF or MJCF file, from the robot file's folder")
    name: Text | None = Field(None, description="what reports call the robot; without it as the model does")
    base: Angles = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="roll, pitch and yaw of its base: about the fixed axes x, y and z of a world with z upwards [rad]",
    )
    feed_forward: FeedForward = Field("none", description="what the drives are given beside the controllers' torque")
    in_motion: bool = Field(False, description="whether the records begin while the robot moves, as its references do")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield angles above a turn, which are degrees."""
        if any(abs(float(angle)) > _TURNS for angle in self.base):
            yield "base", f" is {self.base}, beyond a turn; expected roll, pitch and yaw in rad: convert the degrees."


@keys_from(JointSpring, without=("stiffness",))
class JointSpringTable(Table):
    """joints.spring: between motor and link, with the link's friction; a bare word is its law."""

    shorthand = "law"

    law: Annotated[Text, accept_by(find_spring)] = Field(
        "linear", description="the spring's law", json_schema_extra={"enum": list(SPRINGS)}
    )
    stiffness: Positive | None = Field(
        None, description="of the spring, where a search begins, unless joints.parameters says it [N m/rad or N/m]"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of numbers without a stiffness."""
        if self.stiffness is None and self.model_fields_set - {"law"}:
            yield "stiffness", self.lacks("stiffness")


class _OneOfJoints(JointTable):
    """One of [[joints]] as [joint] of a joint file."""

    heading: ClassVar = "joints"


@keys_from(RobotJoint, without=("spring",), types={"coupling": (NumbersByName, dict)})
class RobotJointTable(JointTable):
    """[[joints]]: one joint, in the order in which they are reported; what is left out is as the model says it."""

    decided_by: ClassVar = {"controller": "law"}

    name: Text = Field(description="of the joint in the model")
    kind: Kind | None = Field(None, description="how the joint moves, as the model says it")  # type: ignore[assignment]
    model: Literal["rigid", "flexible"] | None = Field(  # type: ignore[assignment]
        None, description="as joint.model of a joint file; without it flexible where there is a spring"
    )
    spring: JointSpringTable | None = Field(  # type: ignore[assignment]
        None, description="between motor and link; without it the joint is rigid"
    )
    transmission: TransmissionTable | None = Field(None, description="its gear, as [transmission] of a joint file")
    gravity: GravityTable | None = Field(None, description="as [gravity] of a joint file")
    ripple: RippleTable | None = Field(None, description="as [ripple] of a joint file")
    controller: ControllerTable | None = Field(None, description="its law, as [controller] of a joint file")
    parameters: dict[str, ParameterTable] = Field(
        default_factory=dict, description="what is known of its parameters, as [parameters] of a joint file"
    )
    channels: ChannelsTable | None = Field(None, description="its channels, where they are not as [record.channels]")
    limits: LimitsTable | None = Field(None, description="what it may do in a test that is planned")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield nothing: what a joint may not be is seen beside what the model says of it."""
        yield from ()

    @property
    def flexible(self) -> bool:
        """Whether the joint has a spring."""
        return self.spring is not None if self.model is None else self.model == "flexible"

    def table(self, kind: Kind) -> JointTable:
        """Return [joint] of a joint file that says the same."""
        said: dict[str, Any] = {"kind": kind, "model": "flexible" if self.flexible else "rigid"}
        if self.spring is not None:
            said["spring"] = self.spring.law
        own = self.given_values(*said, "spring")
        return _OneOfJoints.model_construct(
            **said, **{n: getattr(self, n) for n in own if n in JointTable.model_fields}
        )


RobotMethod: TypeAlias = IDIM | DIDIM | DriveSideFit
_METHODS: dict[str, type[RobotMethod]] = {"idim": IDIM, "didim": DIDIM, "drive_side": DriveSideFit}


@keys_from(
    *_METHODS.values(), systems=ROBOT, types={"fixed": (NumbersByName, dict), "frequencies": (NumbersByName, dict)}
)
class RobotMethodTable(Table):
    """[method]: how the robot is identified; some keys are for some methods only."""

    name: Literal["idim", "didim", "drive_side"] | None = Field(
        None,
        description="idim, from motor positions and torques, didim, from torques and references, or drive_side, of "
        "flexible joints from motor positions and torques; without it idim where [record.channels] or a joint has a "
        "motor_position, and drive_side where a joint has a spring, too",
    )

    def chosen(self, measured: bool, flexible: bool) -> str:
        """Return the method that is named, or, of records with motor positions or without, the one they are for."""
        return self.name or ("didim" if not measured else "drive_side" if flexible else "idim")

    def method(self, name: str) -> RobotMethod:
        """Return the method of that name with these settings.

        Raises:
            JointFileError: a key is of another method.
        """
        given, own = self.settings("name"), keys_of(_METHODS[name], "robot")
        for key in given:
            if key not in own:
                rest = f" is a setting of another method than {name}; leave it out."
                raise JointFileError(fault_at(("method", key), rest, "unknown"))
        return _METHODS[name](**given)


class RobotFileTable(Table):
    """A robot file."""

    robot: RobotTable = Field(description="the robot's model")
    record: RecordTable = Field(default_factory=RecordTable, description="the file of the record, and its channels")
    drive: DriveTable = Field(default_factory=DriveTable, description="whose traces they are, and its own units")
    filtering: FilteringTable = Field(default_factory=FilteringTable, description="how signals are filtered")
    method: RobotMethodTable = Field(default_factory=RobotMethodTable, description="how the robot is identified")
    joints: Annotated[list[RobotJointTable], Field(min_length=1), Says("one [[joints]] table for each joint")] = Field(
        description="the joints"
    )

    @property
    def method_name(self) -> str:
        """Name of the given method, or of the default one for the channels."""
        # A joint without a controller leaves one method only.
        measured = self.record.channels.motor_position is not None or any(
            one.controller is None or (one.channels is not None and one.channels.motor_position is not None)
            for one in self.joints
        )
        return self.method.chosen(measured, any(one.flexible for one in self.joints))

    def table(self, number: int, kind: Kind) -> FileTable:
        """Return the joint file of one joint: the tables that all share, channels by its name and place, its own.

        Args:
            number: of the joint, from 0.
            kind: of the joint.
        """
        own = self.joints[number]
        channels = self.record.channels.given_values() | ({} if own.channels is None else own.channels.given_values())
        named = {channel: _fill_placeholders(table, own.name, number) for channel, table in channels.items()}
        record = self.record.model_copy(update={"channels": ChannelsTable().model_copy(update=named)})
        axis = {} if self.drive.profile is None or "axis" in self.drive.model_fields_set else {"axis": number + 1}
        # What a joint of a robot is identified by is not its own method, but says which channels must be there.
        method = "didim" if self.method_name == "didim" else "drive_side" if own.flexible else "idim"
        return FileTable.model_construct(
            joint=own.table(kind),
            record=record,
            drive=self.drive.model_copy(update=axis),
            method=MethodTable.model_construct(name=method),
            filtering=self.filtering,
            limits=own.limits or LimitsTable(),
            **{name: getattr(own, name) for name in _OF_JOINT_FILE if name in own.model_fields_set},
        )


_OF_JOINT_FILE = ("transmission", "gravity", "ripple", "controller", "parameters")
"""Tables of a joint file that are below [[joints]] in a robot file."""


def _fill_placeholders(table: ChannelTable, name: str, number: int) -> ChannelTable:
    """Return a channel with the placeholders of its texts replaced by name and number."""
    own = {"{joint}": name, "{axis}": str(number + 1), "{index}": str(number)}
    texts = {key: value for key, value in table.given_values().items() if isinstance(value, str)}
    for stand_in, meant in own.items():
        texts = {key: text.replace(stand_in, meant) for key, text in texts.items()}
    return table.model_copy(update=texts)


@dataclass(frozen=True, slots=True, eq=False)
class RobotFile:
    """A robot file: the robot, and what is recorded of each of its joints.

    Attributes:
        model: the robot, with what the file says of its joints; gravity as the base stands.
        joints: the joint file of each joint: channels, transmission, controller.
        filtering: how signals are filtered.
        method: how the robot is identified: by IDIM, by DIDIM from torques and references, or on the drive side.
        feed_forward: what the drives are given beside the controllers' torque.
        stated_limits: what each joint may do in a test that is planned, as its table says.
        in_motion: whether the records begin while the robot moves.
        unmodelled: sentences on what the joints have and the model of a robot has not, which every verb refuses.
        path: of the robot file.
        raw: its tables.
    """

    model: Robot
    joints: tuple[JointFile, ...]
    filtering: Filtering
    method: RobotMethod
    feed_forward: FeedForward
    stated_limits: tuple[LimitsTable, ...]
    in_motion: bool
    unmodelled: tuple[str, ...]
    path: Path
    raw: Mapping[str, Any] = field(repr=False)

    @classmethod
    def of(cls, tables: Mapping[str, Any], path: Path = Path("robot.toml")) -> Self:
        """Build a robot file from its tables.

        Args:
            tables: by name, as `tomllib` reads them.
            path: of the robot file.

        Raises:
            JointFileError: with one sentence for each fault, of the file or of the model that it names.
        """
        said = read_robot_tables(tables)
        bare, method = _robot(said, path.parent), said.method.method(said.method_name)
        files = _joint_files(said, bare, path)
        each = list(zip(said.joints, bare.joints, files, strict=True))
        unmodelled = [
            f"joints.{n + 1}{rest}" for n, (own, _, file) in enumerate(each) for rest in _model_faults(own, file)
        ]
        try:
            robot = bare if unmodelled else replace(bare, joints=tuple(_joint(*one) for one in each))
        except JointidError as error:
            raise JointFileError(f"joints: {error}") from error
        return cls(
            robot,
            files,
            said.filtering.build(),
            method,
            said.robot.feed_forward,
            tuple(one.limits or LimitsTable() for one in said.joints),
            said.robot.in_motion,
            tuple(unmodelled),
            path,
            tables,
        )

    @property
    def robot(self) -> Robot:
        """The robot.

        Raises:
            MethodError: a joint has a law, or a number, that the model of a robot has not.
        """
        if self.unmodelled:
            raise MethodError("\n".join(self.unmodelled))
        return self.model

    @property
    def limits(self) -> tuple[AxisLimits, ...]:
        """Limits of each joint in a test that is planned.

        Raises:
            MethodError: a limit is given that the plan of a robot's motion does not keep.
        """
        for number, table in enumerate(self.stated_limits):
            for name in table.model_fields_set - set(ROBOT_LIMITS):
                raise MethodError(
                    f"joints.{number + 1}.limits.{name} is not kept by the plan of a robot's motion; expected "
                    f"{', '.join(sorted(ROBOT_LIMITS))}: leave it out."
                )
        return tuple(table.build() for table in self.stated_limits)

    def joint_file(self, name: str) -> JointFile:
        """Return the joint file of one joint, identified alone, as if no other joint moved.

        The method has its default settings. Gravity is what `joints.gravity` says. Numbers of the [[joints]] table are
        starts of the parameters; but the rotor's inertia is none of a rigid joint's, which includes the links.

        Args:
            name: of the joint.

        Raises:
            MethodError: the robot has no such joint.
        """
        names = [str(file.name) for file in self.joints]
        if name not in names:
            raise MethodError(f"The axis{messages.no_choice(name, names)}")
        number = names.index(name)
        file, own = self.joints[number], read_robot_tables(self.raw).joints[number]
        parameters = dict(file.parameters)
        for parameter, start in _stated_starts(own, file):
            known = parameters.get(parameter.name, parameter)
            unsaid = parameter.name not in parameters or known.start is None
            if unsaid and known.lower <= start <= known.upper:
                parameters[parameter.name] = replace(known, start=start)
        return replace(file, parameters=parameters)

    def records(self, path: str | os.PathLike[str] | None = None) -> tuple[Record, ...]:
        """Read the record of every joint, from one reading of the file.

        Args:
            path: of the record, instead of the one that the file names.

        Raises:
            RecordError: the file does not hold what the robot file says; each sentence names its joint.
        """
        return self._of_each(path, JointFile.record_of)

    def _of_each(
        self, path: str | os.PathLike[str] | None, cut: Callable[[JointFile, RecordedTable, str], Record]
    ) -> tuple[Record, ...]:
        path = self.joints[0].record_path(path)
        table = self.source.read(path, self.path.parent)
        found, faults = list[Record](), dict[Fault, list[str]]()
        for file in self.joints:
            try:
                found.append(cut(file, table, Path(path).stem))
            except RecordError as error:
                for fault in error.faults:
                    faults.setdefault(fault, []).append(str(file.name))
        if faults:
            raise RecordError(_by_joints(faults, len(self.joints)))
        return tuple(found)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Records that the file lists: none, as those of a robot are named one by one."""
        return ()

    @property
    def source(self) -> Source:
        """The file of the record, and how it is read."""
        return self.joints[0].source

    def inputs(self, record: Path | None = None) -> tuple[Path, ...]:
        """Return the files that are read: the model, and the record that the file names or that takes its place."""
        return (self.path.parent / self.raw["robot"]["model"], *self.joints[0].inputs(record))

    def record_path(self, path: str | os.PathLike[str] | None = None) -> str | os.PathLike[str]:
        """Return the path of the record; see `JointFile.record_path`."""
        return self.joints[0].record_path(path)

    @property
    def loop(self) -> RobotLoop:
        """The robot under its controllers.

        Raises:
            MethodError: a joint has no controller.
        """
        missing = [file.name for file in self.joints if file.controller is None]
        if missing:
            raise MethodError(
                f"A robot is simulated under its controllers; without one: {', '.join(map(str, missing))}. Add a "
                "controller to the [[joints]] table, or identify by idim from motor positions."
            )
        controllers = tuple(file.controller for file in self.joints if file.controller is not None)
        return RobotLoop(self.robot, controllers, self.in_motion)

    def driving(self, path: str | os.PathLike[str] | None = None) -> tuple[Record, ...]:
        """Read what drives a simulation: references, and the feed-forward that the file asks to compute.

        Args:
            path: of the record, instead of the one that the file names.

        Raises:
            RecordError: see `records`.
            MethodError: the feed-forward needs references of one rate.
        """
        return self._fed_forward(self._of_each(path, JointFile.driving_of))

    def _fed_forward(self, found: tuple[Record, ...]) -> tuple[Record, ...]:
        injected = [
            str(file.name) for file, record in zip(self.joints, found, strict=True) if record.injected is not None
        ]
        if self.feed_forward == "logged" and len(injected) < len(found):
            raise RecordError(
                'robot.feed_forward is "logged", and not every joint has an injected channel; declare one for each in '
                "[record.channels]."
            )
        if self.feed_forward in ("gravity", "inverse-model") and injected:
            raise RecordError(
                f'robot.feed_forward is "{self.feed_forward}", and {", ".join(injected)} has an injected channel too; '
                'expected one of both: leave the channel out, or take "logged".'
            )
        if self.feed_forward in ("gravity", "inverse-model"):
            return add_feed_forward(self.loop, found, self.feed_forward)
        return found

    def record(self, path: str | os.PathLike[str] | None = None, *, judged: bool = False) -> tuple[Record, ...]:
        """Read the records for `identify`, with a computed feed-forward if the method simulates.

        Args:
            path: of the record, instead of the one that the file names.
            judged: whether the declared controllers are held against the torques as well. These are the controllers'
                and the feed-forward's, so a computed one is added where every joint has a controller and a reference.

        Raises:
            RecordError, MethodError: see `records`, `driving`.
        """
        found = self.records(path)
        controlled = all(file.controller is not None for file in self.joints)
        whole = controlled and all(record.reference is not None for record in found)
        return self._fed_forward(found) if self._simulates or (judged and whole) else found

    def identify(
        self,
        records: Sequence[Record] | Sequence[Sequence[Record]],
        progress: Progress = ignore_progress,
        *,
        checks: bool = True,
    ) -> Estimate:
        """Identify the robot by the method and the filtering of the file.

        Args:
            records: of each joint, as `record` reads them; or those of several logs, identified in one fit.
            progress: is called with the state of a search.
            checks: whether to check the estimate.

        Raises:
            RecordError, MethodError: see `jointid.identify`.
        """
        self.robot.require_lines("An identification of a robot takes")
        return identify(
            records, self.setup, self.method, filtering=self.filtering, parameters=self.parameters, checks=checks,
            progress=progress,
        )  # fmt: skip

    def identify_together(self, paths: Sequence[Path], progress: Progress = ignore_progress) -> Estimate:
        """Identify the robot from several records in one fit.

        Args:
            paths: of the records.
            progress: is called with the state of a search.

        Raises:
            RecordError, MethodError: see `jointid.identify`.
        """
        return self.identify([self.record(path) for path in paths], progress)

    @property
    def setup(self) -> Robot | RobotLoop | RobotDriveSide:
        """The robot as its method takes it: alone, under its controllers, or along its motors' motion."""
        if isinstance(self.method, DriveSideFit):
            return RobotDriveSide(self.robot)
        return self.loop if self._simulates else self.robot

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Values and bounds that the identification keeps, by the names of a robot's parameters."""
        found = dict[str, Parameter]()
        for file in self.joints:
            known = {parameter.name: parameter for parameter in file.joint.parameters}
            for name, stated in file.parameters.items():
                own = name.removeprefix("motor_")
                own = _OF_ROBOT.get(name, own)
                if stated != replace(known[name], start=stated.start):
                    # A start is a number of the robot that is built, and no start of a search.
                    found[f"{file.name}.{own}"] = replace(stated, start=None) if stated.free else stated
        return found

    @property
    def _simulates(self) -> bool:
        """True if the method simulates the robot under its controllers."""
        return isinstance(self.method, DIDIM) or (isinstance(self.method, IDIM) and self.method.estimator == "iv")

    def write(self, records: Sequence[Record], path: str | os.PathLike[str]) -> None:
        """Write one record of each joint into a file that `records` reads; channels without a column as JOINT.CHANNEL.

        Raises:
            RecordError: the file cannot be written, or would not be read back.
        """
        table: dict[str, FloatArray] = {}
        for file, record in zip(self.joints, records, strict=True):
            for name, values in file.columns_to_write(record).items():
                own = f"{file.name}.{name}" if name in record.channels and name not in file.column_names else name
                table[own] = values
        write_columns(table, path, **self.joints[0].source.options)

    def tables(self) -> dict[str, Any]:
        """Return the tables that say the same, with the numbers of this robot's joints."""
        tables = copy.deepcopy(dict(self.raw))
        if self.unmodelled:  # the model has not what the tables say
            return tables
        for table, joint in zip(tables["joints"], self.model.joints, strict=True):
            stated = {name: getattr(joint, name) for name in _NUMBERS}
            table.update({name: number for name, number in stated.items() if number is not None})
        return tables


def read_robot_tables(tables: Mapping[str, Any]) -> RobotFileTable:
    """Return the tables of a robot file, each right in itself.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    raw, faults = RobotFileTable.correct_keys(tables)
    try:
        said = RobotFileTable.model_validate(raw)
    except ValidationError as error:
        raise JointFileError([*faults, *faults_of(error)]) from None
    if faults:
        raise JointFileError(faults)
    return said


def _robot(said: RobotFileTable, folder: Path) -> Robot:
    """Return the model with what the file says of its joints."""
    model, names = load_robot(folder / said.robot.model), [one.name for one in said.joints]
    unknown = [
        f"joints.{k + 1}.name{messages.no_choice(n, model.names)}" for k, n in enumerate(names) if n not in model.names
    ]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        unknown.append(f"joints lists {', '.join(twice)} twice; expected every joint once: leave one out.")
    missing = [name for name in model.names if name not in names]
    if missing and not unknown:
        unknown = [
            f"joints lacks {', '.join(missing)}; expected every joint of {said.robot.model}: add [[joints]] tables."
        ]
    if unknown:
        raise JointFileError(unknown)
    ordered = reorder_joints(model, names)
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
    turned = _base(said.robot.base).T @ ordered.gravity
    # A base that is written as 3.1416 hangs upside down: no record would show a trace of gravity sideways.
    turned = np.where(np.abs(turned) < _UPRIGHT * np.linalg.norm(turned), 0.0, turned)
    return replace(ordered, gravity=turned, name=said.robot.name or ordered.name)


def _base(angles: list[float]) -> FloatArray:
    """Return the rotation of the base's frame to the world's."""
    (a, b, c), (x, y, z) = np.cos(angles), np.sin(angles)
    roll = np.array([[1, 0, 0], [0, a, -x], [0, x, a]])
    pitch = np.array([[b, 0, y], [0, 1, 0], [-y, 0, b]])
    return np.asarray(np.array([[c, -z, 0], [z, c, 0], [0, 0, 1]]) @ pitch @ roll)


def _joint_files(said: RobotFileTable, robot: Robot, path: Path) -> tuple[JointFile, ...]:
    files, faults = list[JointFile](), dict[Fault, list[str]]()
    for number, (own, link) in enumerate(zip(said.joints, robot.links, strict=True)):
        if own.kind not in (None, link.kind):
            rest = f' is "{own.kind}", but the model says "{link.kind}": leave it out, or correct the model.'
            raise JointFileError(fault_at(("joints", number, "kind"), rest))
        try:
            files.append(JointFile.of_table(said.table(number, link.kind), path))
        except JointFileError as error:
            for fault in error.faults:
                if fault.place and fault.place[0] in _OF_JOINT_FILE:
                    rest = fault.removeprefix(messages.dot_path(fault.place))
                    faults[fault_at(("joints", number, *fault.place), rest, fault.code)] = list(robot.names)
                else:
                    faults.setdefault(fault, []).append(own.name)
    for file in files:
        if file.joint.transmission is not None and file.joint.transmission.side == "motor":
            side = 'transmission.side is "motor"; all numbers of a robot are behind its gears: leave side out.'
            faults.setdefault(Fault(side), []).append(str(file.name))
    for name, joints in _shared_columns(files).items():
        shared = Fault(f"{name} is one column of several joints; give each one of its own, as with {{axis}}.")
        faults.setdefault(shared, []).extend(joints)
    if faults:
        raise JointFileError(_by_joints(faults, len(robot)))
    return tuple(files)


def _by_joints(faults: Mapping[Fault, Sequence[str]], count: int) -> list[Fault]:
    """Return sentences, each after the names of its joints where it is not of all."""
    return [
        f if len(names) == count else Fault(f"{', '.join(names)}: {f}", f.place, f.code) for f, names in faults.items()
    ]


_NUMBERS = [one.name for one in settings_of(RobotJoint) if one.name not in ("spring", "coupling")]
_AS_MOTOR = {"inertia": "rotor_inertia", "viscous_forwards": "viscous", "coulomb_forwards": "coulomb"}
"""Parameters of a joint that have another name as a number of a robot's motor."""

_OF_ROBOT = {
    "load_viscous": "link_viscous",
    "load_coulomb": "link_coulomb",
    "inertia": "rotor_inertia",
    "motor_inertia": "rotor_inertia",
}
"""Parameters of a joint that have another name among the parameters of a robot."""

_OF_SPRING = {name: name.removeprefix("load_") for name in ("stiffness", "damping", "load_viscous", "load_coulomb")}
"""Parameters of a joint that are numbers of a robot's spring."""


def _starts(file: JointFile) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return starts of a joint file's parameters: of the motor, of the spring, and beside these the laws' own."""
    motor, spring, numbers = dict[str, float](), dict[str, float](), dict[str, float]()
    for name, parameter in file.parameters.items():
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


def _stated_starts(own: RobotJointTable, file: JointFile) -> Iterator[tuple[Parameter, float]]:
    """Yield parameters of a joint with the numbers of its table, the inverse of `_starts`."""
    numbers = own.settings()
    for part in ("viscous", "coulomb"):
        if part in numbers:
            numbers.setdefault(f"{part}_backwards", numbers[part])
    spring = {} if own.spring is None else own.spring.settings("law")
    for parameter in file.joint.parameters:
        name = parameter.name.removeprefix("motor_")
        of_spring = _OF_SPRING.get(parameter.name.removesuffix("_forwards").removesuffix("_backwards"))
        given = numbers.get(_AS_MOTOR.get(name, name)) if of_spring is None else spring.get(of_spring)
        if given is not None and parameter.name != "inertia":
            yield parameter, float(given)


def _joint(own: RobotJointTable, joint: RobotJoint, file: JointFile) -> RobotJoint:
    """Return a joint of the model with the file's numbers and laws."""
    motor, spring, numbers = _starts(file)
    given = {name: value for name, value in own.settings().items() if name in (*_NUMBERS, "coupling")} | motor
    friction = file.joint.friction
    if friction.stepped:
        given["friction"] = friction
    if friction.name.startswith("asymmetric") and not {"viscous_backwards", "coulomb_backwards"} & set(given):
        given["viscous_backwards"] = given.get("viscous", joint.viscous)
    if isinstance(file.joint, FlexibleJoint):
        stated = {} if own.spring is None else own.spring.settings("law")
        given["spring"] = JointSpring(**stated | spring, law=file.joint.spring)
    return replace(joint, **given, numbers=numbers)


def _model_faults(own: RobotJointTable, file: JointFile) -> Iterator[str]:
    """Yield the rest of a sentence on unsupported tables, and on missing numbers of the laws."""
    motor, excess, numbers = _starts(file)
    friction, spring = file.joint.friction.name, getattr(file.joint, "spring", None)
    if "load_inertia" in file.parameters:
        yield ".parameters.load_inertia is that of the robot's links; leave it out, or change the model of the robot."
    if friction.endswith("stribeck") and own.stribeck_speed is None and "stribeck_speed" not in motor:
        yield ".stribeck_speed is missing; expected the speed below which friction rises: add it."
    if spring is not None and "stiffness" not in excess and (own.spring is None or own.spring.stiffness is None):
        yield ".spring.stiffness is missing; expected a positive number (where a search begins): add it."
    if isinstance(spring, ElasticLoad):
        yield f'.spring is "{spring.name}"; in a robot what swings is a link of its own: add a link with a spring.'
    if file.joint.gravity is not None:
        yield ".gravity is that of the masses of the robot's model; leave it out."
    if file.joint.ripple is not None:
        yield ".ripple is not simulated with a robot; leave it out."
    elif not isinstance(spring, ElasticLoad):
        known = {one.name for one in file.joint.linear.parameters} | set(numbers)
        for name in [one.name for one in file.joint.parameters if one.name not in known]:
            force, rises, _ = name.partition("stribeck_")  # friction rises towards standstill where its force is given
            if not rises or f"{force}stribeck_force" in numbers:
                yield f".parameters.{name} is missing; expected a number of the joint's laws: add it."


def _shared_columns(files: Sequence[JointFile]) -> dict[str, list[str]]:
    """Return channels that share a column, with the names of their joints."""
    found: dict[str, list[str]] = {}
    for file in files:
        for channel, column in file.columns.items():
            if column.column and file.drive.traces is None:
                found.setdefault(f'{channel} from "{column.column}"', []).append(str(file.name))
    return {name: joints for name, joints in found.items() if len(joints) > 1}
