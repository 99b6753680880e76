"""The robot file (TOML): the robot's model, its joints with their drives, and the record of all of them.

Every joint becomes a joint file of its own, of the tables that all share and of its own ones, so that channels, units,
transmissions and controllers mean, and are checked, as there. In the name of a column ``{joint}`` stands for the
joint's name, ``{axis}`` for its place in the file from 1, ``{index}`` for one less.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
import tomli_w
from pydantic import Field, ValidationError

from jointid.common import messages
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointFileError, JointidError, MethodError, RecordError
from jointid.common.files import write_whole
from jointid.common.messages import Progress, Says, silent
from jointid.common.settings import settings_of
from jointid.config.contents import JointFile
from jointid.config.loading import apply_changes, parse_toml, read_text
from jointid.config.robot_model import in_order, load_robot
from jointid.config.schema import CONSTANT, ControllerTable, FilteringTable, TransmissionTable
from jointid.config.schema_record import ChannelsTable, DriveTable, RecordTable
from jointid.config.table import Number, Positive, Table, Text, faults_of, keys_from, with_unit
from jointid.estimation.robots.identify import fit_robot
from jointid.estimation.robots.idim import RobotEstimate, RobotIDIM
from jointid.estimation.robots.torque_estimate import (
    RobotDIDIM,
    RobotDriveSideFit,
    RobotTorqueEstimate,
)
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.planning.robots.motions import JointLimits
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write_columns
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop, add_feed_forward

_UPRIGHT = 1e-3  # rad, that a base is off the upright and yet upright
_TURNS = 2 * math.pi  # rad

_OF_JOINT = (
    "rotor_inertia",
    "viscous",
    "coulomb",
    "offset",
    "viscous_backwards",
    "coulomb_backwards",
    "stribeck_force",
    "stribeck_speed",
)

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
        """Yield angles beyond a turn, which are degrees."""
        if any(abs(float(angle)) > _TURNS for angle in self.base):
            yield "base", f" is {self.base}, beyond a turn; expected roll, pitch and yaw in rad: convert the degrees."


@keys_from(JointSpring)
class JointSpringTable(Table):
    """joints.spring: between motor and link, and the friction beyond it."""


@keys_from(JointLimits)
class JointLimitsTable(Table):
    """joints.limits: what the joint may do in a test that is planned, behind its gear."""


@keys_from(RobotJoint, types={"spring": (JointSpringTable, None), "coupling": (NumbersByName, dict)})
class RobotJointTable(Table):
    """[[joints]]: one joint, in the order in which they are reported; what is left out is as the model says it."""

    decided_by: ClassVar = {"controller": "law"}

    name: Text = Field(description="of the joint in the model")
    torque_constant: with_unit(Positive, CONSTANT) | None = Field(  # type: ignore[valid-type]
        None, description=f"of the motor, as joint.torque_constant of a joint file; per A [{CONSTANT}]"
    )
    transmission: TransmissionTable | None = Field(None, description="its gear, as [transmission] of a joint file")
    controller: ControllerTable | None = Field(None, description="its law, as [controller] of a joint file")
    channels: ChannelsTable | None = Field(None, description="its channels, where they are not as [record.channels]")
    limits: JointLimitsTable | None = Field(None, description="what it may do in a test that is planned")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield nothing: what a joint may not be is seen beside what the model says of it."""
        yield from ()

    def joint(self, joint: RobotJoint) -> RobotJoint:
        """Return a joint of the model with what the table says of it."""
        given = self.settings("name", "torque_constant", "transmission", "controller", "channels", "limits")
        if self.spring is not None:
            given["spring"] = self.spring.build()
        return replace(joint, **given)


RobotMethod: TypeAlias = RobotIDIM | RobotDIDIM | RobotDriveSideFit
_METHODS: dict[str, type] = {"idim": RobotIDIM, "didim": RobotDIDIM, "drive_side": RobotDriveSideFit}


@keys_from(*_METHODS.values(), types={"fixed": (NumbersByName, dict), "frequencies": (NumbersByName, dict)})
class RobotMethodTable(Table):
    """[method]: how the robot is identified; some keys are for some methods only."""

    name: Literal["idim", "didim", "drive_side"] | None = Field(
        None,
        description="idim, from motor positions and torques, didim, from torques and references, or drive_side, of "
        "flexible joints from motor positions and torques; without it idim where [record.channels] or a joint has a "
        "motor_position, and drive_side where a joint has a spring, too",
    )

    def method(self, measured: bool, flexible: bool) -> RobotMethod:
        """Return the method that is named, or, of records with motor positions or without, the one they are for.

        Raises:
            JointFileError: a key is of another method.
        """
        name = self.name or ("didim" if not measured else "drive_side" if flexible else "idim")
        given, own = self.settings("name"), {one.name for one in settings_of(_METHODS[name])}
        for key in given:
            if key not in own:
                raise JointFileError(f"method.{key} is a setting of another method than {name}; leave it out.")
        method: RobotMethod = _METHODS[name](**given)
        return method


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


@dataclass(frozen=True, slots=True, eq=False)
class RobotFile:
    """A robot file: the robot, and what is recorded of each of its joints.

    Attributes:
        robot: the model, with what the file says of its joints; gravity as the base stands.
        joints: the joint file of each joint: channels, transmission, controller.
        filtering: how signals are filtered.
        method: how the robot is identified: by IDIM, by DIDIM from torques and references, or on the drive side.
        feed_forward: what the drives are given beside the controllers' torque.
        limits: what each joint may do in a test that is planned.
        in_motion: whether the records begin while the robot moves.
        path: of the robot file.
        raw: its tables.
    """

    robot: Robot
    joints: tuple[JointFile, ...]
    filtering: Filtering
    method: RobotMethod
    feed_forward: FeedForward
    limits: tuple[JointLimits, ...]
    in_motion: bool
    path: Path
    raw: Mapping[str, Any] = field(repr=False)

    @classmethod
    def of(cls, tables: Mapping[str, Any], path: Path = Path("robot.toml")) -> Self:
        """Return what the tables of a robot file say.

        Args:
            tables: by name, as `tomllib` reads them.
            path: of the robot file.

        Raises:
            JointFileError: with one sentence for each fault, of the file or of the model that it names.
        """
        raw, faults = RobotFileTable.corrected(tables)
        try:
            said = RobotFileTable.model_validate(raw)
        except ValidationError as error:
            raise JointFileError([*faults, *faults_of(error)]) from None
        if faults:
            raise JointFileError(faults)
        robot = _robot(said, path.parent)
        method = said.method.method(_has_positions(raw), any(robot.flexible))
        return cls(
            robot,
            _joint_files(raw, robot, path, "didim" if isinstance(method, RobotDIDIM) else "idim"),
            said.filtering.build(),
            method,
            said.robot.feed_forward,
            tuple(JointLimits() if one.limits is None else one.limits.build() for one in said.joints),
            said.robot.in_motion,
            path,
            raw,
        )

    def records(self, path: str | os.PathLike[str] | None = None) -> tuple[Record, ...]:
        """Read the record of every joint.

        Args:
            path: of the record, instead of the one that the file names.

        Raises:
            RecordError: the file does not hold what the robot file says; each sentence names its joint.
        """
        return self._of_each(lambda file: file.record(path))

    def _of_each(self, read: Callable[[JointFile], Record]) -> tuple[Record, ...]:
        found, faults = list[Record](), dict[str, list[str]]()
        for file in self.joints:
            try:
                found.append(read(file))
            except RecordError as error:
                for fault in error.faults:
                    faults.setdefault(fault, []).append(str(file.name))
        if faults:
            whole = len(self.joints)
            raise RecordError([f if len(names) == whole else f"{', '.join(names)}: {f}" for f, names in faults.items()])
        return tuple(found)

    @property
    def loop(self) -> RobotLoop:
        """The robot under its controllers.

        Raises:
            MethodError: a joint has no controller.
        """
        missing = [file.name for file in self.joints if file.controller is None]
        if missing:
            raise MethodError(
                f"A robot is simulated under its controllers, and {', '.join(map(str, missing))} has none; add a "
                "controller to its [[joints]] table, or identify by idim from motor positions."
            )
        controllers = tuple(file.controller for file in self.joints if file.controller is not None)
        return RobotLoop(self.robot, controllers, self.in_motion)

    def driven(self, path: str | os.PathLike[str] | None = None, *, logged: bool = True) -> tuple[Record, ...]:
        """Read the records as `records` does, with the feed-forward that the file asks to compute.

        Args:
            path: of the record, instead of the one that the file names.
            logged: whether torques must be there, as to identify from; a simulation needs references alone.

        Raises:
            RecordError: see `records`.
            MethodError: the feed-forward needs references of one rate.
        """
        return self._fed_forward(self.records(path) if logged else self._of_each(lambda file: file.driving(path)))

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

    def to_identify(self, path: str | os.PathLike[str] | None = None, *, judged: bool = False) -> tuple[Record, ...]:
        """Read the records that `identify` takes: as `driven` does for a method that simulates, else as `records` does.

        Args:
            path: of the record, instead of the one that the file names.
            judged: whether the declared controllers are held against the torques as well. These are the controllers'
                and the feed-forward's, so a computed one is added where every joint has a controller and a reference.

        Raises:
            RecordError, MethodError: see `driven`.
        """
        if self._simulates:
            return self.driven(path)
        found = self.records(path)
        controlled = all(file.controller is not None for file in self.joints)
        whole = controlled and all(record.reference is not None for record in found)
        return self._fed_forward(found) if judged and whole else found

    def identify(
        self, records: Sequence[Record], *, progress: Progress = silent
    ) -> RobotEstimate | RobotTorqueEstimate:
        """Identify the robot by the method and the filtering of the file.

        Args:
            records: of each joint, as `to_identify` reads them.
            progress: is told how a search goes.

        Raises:
            RecordError, MethodError: see `jointid.identify`.
        """
        closing: Robot | RobotLoop | RobotDriveSide = self.loop if self._simulates else self.robot
        if isinstance(self.method, RobotDriveSideFit):
            closing = RobotDriveSide(self.robot)
        return fit_robot(records, closing, self.method, filtering=self.filtering, progress=progress)

    @property
    def _simulates(self) -> bool:
        """True if the method simulates the robot under its controllers."""
        return isinstance(self.method, RobotDIDIM) or (
            isinstance(self.method, RobotIDIM) and self.method.estimator == "iv"
        )

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
        for table, joint in zip(tables["joints"], self.robot.joints, strict=True):
            for name in _OF_JOINT:
                table[name] = getattr(joint, name)
                if table[name] is None:
                    del table[name]
        return tables


def load_robot_file(path: str | os.PathLike[str], changes: Iterable[str] = ()) -> RobotFile:
    """Load a robot file, checked completely.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``filtering.cutoff=5``.

    Raises:
        JointFileError: the file or the model that it names cannot be read, or has faults.
        ExtraError: MuJoCo, which reads the model, is not installed.
    """
    path = Path(path)
    return RobotFile.of(apply_changes(parse_toml(read_text(path)), changes), path)


def save_robot_file(file: RobotFile, path: str | os.PathLike[str]) -> None:
    """Write a robot file; a file that is there is replaced.

    Raises:
        RecordError: it cannot be written.
    """
    write_whole(path, tomli_w.dumps(file.tables()))


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
    ordered = in_order(model, names)
    if list(ordered.names) != names:
        raise JointFileError(
            f"joints lists {', '.join(names)}; expected each joint after the one that carries it: write them as "
            f"{', '.join(ordered.names)}."
        )
    down = -np.linalg.norm(ordered.gravity) * np.array([0.0, 0.0, 1.0])
    if any(said.robot.base) and np.linalg.norm(ordered.gravity - down) > _UPRIGHT * np.linalg.norm(down):
        raise JointFileError(
            f"robot.base turns the model, whose own gravity is turned already ({_three(ordered.gravity)} m/s2), as in "
            "an export of a robot on a turned base; expected one of both: leave base out, or set the model's gravity "
            "to 0 0 -9.81."
        )
    try:
        joints = tuple(table.joint(joint) for table, joint in zip(said.joints, ordered.joints, strict=True))
        turned = _base(said.robot.base).T @ ordered.gravity
        # A base that is written as 3.1416 hangs upside down: a trace of gravity sideways would be told by no record.
        turned = np.where(np.abs(turned) < _UPRIGHT * np.linalg.norm(turned), 0.0, turned)
        return replace(ordered, joints=joints, gravity=turned, name=said.robot.name or ordered.name)
    except JointidError as error:
        raise JointFileError(f"joints: {error}") from error


def _three(values: FloatArray) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def _base(angles: list[float]) -> FloatArray:
    """Return the rotation of the base's frame to the world's."""
    (a, b, c), (x, y, z) = np.cos(angles), np.sin(angles)
    roll = np.array([[1, 0, 0], [0, a, -x], [0, x, a]])
    pitch = np.array([[b, 0, y], [0, 1, 0], [-y, 0, b]])
    return np.asarray(np.array([[c, -z, 0], [z, c, 0], [0, 0, 1]]) @ pitch @ roll)


def _joint_files(raw: Mapping[str, Any], robot: Robot, path: Path, method: str) -> tuple[JointFile, ...]:
    files, faults = list[JointFile](), dict[str, list[str]]()
    for place, (table, link) in enumerate(zip(raw["joints"], robot.links, strict=True)):
        try:
            files.append(JointFile.of(_tables_of_joint(raw, table, link.kind, place, method), path))
        except JointFileError as error:
            for fault in error.faults:
                faults.setdefault(fault, []).append(table["name"])
    for file in files:
        if file.joint.transmission is not None and file.joint.transmission.side == "motor":
            side = 'transmission.side is "motor"; all numbers of a robot are behind its gears: leave side out.'
            faults.setdefault(side, []).append(str(file.name))
    for name, joints in _shared_columns(files).items():
        faults.setdefault(f"all read {name}; give each joint a column of its own, as with {{axis}}.", []).extend(joints)
    if faults:
        shared = {fault: len(names) == len(robot) for fault, names in faults.items()}
        raise JointFileError([one if shared[one] else f"{', '.join(names)}: {one}" for one, names in faults.items()])
    return tuple(files)


def _shared_columns(files: Sequence[JointFile]) -> dict[str, list[str]]:
    """Return which channels are one column of several joints, and of which."""
    found: dict[str, list[str]] = {}
    for file in files:
        for channel, column in file.columns.items():
            if column.column and file.drive.traces is None:
                found.setdefault(f'{channel} from "{column.column}"', []).append(str(file.name))
    return {name: joints for name, joints in found.items() if len(joints) > 1}


def _has_positions(raw: Mapping[str, Any]) -> bool:
    """True if a motor's position is a channel, or a joint has no controller, without which there is one method only."""
    shared = "motor_position" in raw.get("record", {}).get("channels", {})
    return shared or any("motor_position" in t.get("channels", {}) or "controller" not in t for t in raw["joints"])


def _tables_of_joint(
    raw: Mapping[str, Any], table: Mapping[str, Any], kind: str, place: int, method: str
) -> dict[str, Any]:
    """Return the joint file of one joint: its channels by its name and place, and its own tables."""
    record, drive = dict(raw.get("record", {})), dict(raw.get("drive", {}))
    channels = {**record.get("channels", {}), **table.get("channels", {})}
    record["channels"] = _named(channels, table["name"], place)
    if "profile" in drive:
        drive.setdefault("axis", place + 1)
    own = {name: table[name] for name in ("transmission", "controller") if name in table}
    joint = {"kind": kind, "name": table["name"]}
    if "torque_constant" in table:
        joint["torque_constant"] = table["torque_constant"]
    # What a joint of a robot is identified by is not its own method, but says which channels must be there.
    return {"joint": joint, "record": record, "drive": drive, "method": {"name": method}} | own


def _named(value: Any, name: str, place: int) -> Any:
    """Return names of columns with the joint's own in place of what stands for it."""
    if isinstance(value, dict):
        return {key: _named(one, name, place) for key, one in value.items()}
    if not isinstance(value, str):
        return value
    for pattern, meant in (("{joint}", name), ("{axis}", str(place + 1)), ("{index}", str(place))):
        value = value.replace(pattern, meant)
    return value
