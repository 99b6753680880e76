"""The tables of a joint file and of a robot file: `JOINT_FILE` and `ROBOT_FILE`.

A key is a setting of the class that uses it. Here stand the keys of the file's own, and how tables become objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, replace
from typing import Any, Literal, TypeAlias

from jointid.common.errors import JointFileError
from jointid.common.settings import Setting, declare, setting
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind
from jointid.config.declaration import Place, Reader, Table, fault_at, key, keys_of, merge
from jointid.config.source import Run, Source
from jointid.estimation.methods.registry import CALLED, Method, MethodName, method_of, methods
from jointid.models.controllers import FILTERS, LAWS, Controller, Filter
from jointid.models.friction import FRICTIONS, find_friction
from jointid.models.limits import AxisLimits
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.models.robots.robot import JointSpring, RobotJoint
from jointid.models.springs import SPRINGS, find_spring
from jointid.records.columns import Column
from jointid.records.drives import Drive
from jointid.records.formats import TextOptions
from jointid.records.signals.filtering import Filtering

FeedForward: TypeAlias = Literal["none", "gravity", "inverse-model", "logged"]

_TURN = 2 * math.pi  # rad

_INVERSES: Mapping[str, tuple[str, float, dict[str, Setting]]] = {
    "cascade": (
        "integral_gain", 1.0,
        key("integral_time", float, "integral time Tn of the velocity loop, 1 / integral_gain", unit="s", above=0),
    ),
    "first_order": (
        "time_constant", 0.5 / math.pi, key("cutoff", float, "1 / (2 pi time_constant)", unit="Hz", above=0)
    ),
}  # fmt: skip
"""Of a law or a kind of filter a key that may be given by its inverse, the product of both, and the inverse."""


@dataclass(frozen=True, slots=True)
class StatedController:
    """A controller as a file states it.

    Attributes:
        law: on its own side; its gain is 1 where none is given.
        side: of the transmission, in whose positions and torque its numbers are.
        gain: that the file gives.
    """

    law: Controller
    side: Side
    gain: float | None


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """[parameters.inertia] and its like: what is known of one parameter; a bare number is a value."""

    value: float | None = setting(None, "what the parameter is fixed at")
    start: float | None = setting(None, "where the search begins")
    lower: float | None = setting(None, "lower bound", infinite=True)
    upper: float | None = setting(None, "upper bound", infinite=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTable:
    """Keys and tables of one axis, each valid by itself.

    Attributes:
        numbers: of the motor of a robot's joint, by the settings of `RobotJoint`.
        link: of its spring and its link's side, by the settings of `JointSpring`.
        channels: of the axis of a robot alone.
    """

    kind: Kind | None = setting(None, "how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] | None = setting(
        None, "one inertia, or two joined by a spring; without it rigid, of a robot flexible where there is a spring"
    )
    friction: str = setting("symmetric", "the friction's law", accept=find_friction, choices=tuple(FRICTIONS))
    spring: Any = setting(None, "the spring's law, of a flexible joint", accept=find_spring, choices=tuple(SPRINGS))
    name: str | None = setting(None, "what reports call the joint")
    torque_constant: float | None = setting(
        None,
        "of the motor or its amplifier, on the motor's side: takes a torque in A or V, and the output of a "
        "controller in A or V, to N m or N; a plain number is per A",
        unit="N/A, N m/A, N/V or N m/V",
        above=0,
    )
    transmission: Mapping[str, Any] | None = None
    gravity: Gravity | None = None
    ripple: PositionHarmonics | None = None
    controller: StatedController | None = None
    parameters: Mapping[str, ParameterTable] = field(default_factory=dict)
    limits: AxisLimits = field(default_factory=AxisLimits)
    zero: float = 0.0
    numbers: Mapping[str, Any] = field(default_factory=dict)
    link: Mapping[str, float] = field(default_factory=dict)
    channels: Mapping[str, Column] = field(default_factory=dict)
    method: Mapping[str, Any] = field(default_factory=dict)


def _require_angles(base: tuple[float, ...]) -> None:
    if any(abs(angle) > _TURN for angle in base):
        raise JointFileError(f"an angle is beyond a turn in {list(base)}; expected rad: convert the degrees.")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTable:
    """[robot]: its model, and how it stands."""

    model: str = setting(MISSING, "path of its URDF or MJCF file, from the robot file's folder")
    name: str | None = setting(None, "what reports call the robot; without it as the model does")
    base: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "roll, pitch and yaw of its base: about the fixed axes x, y and z of a world with z upwards [rad]",
        accept=_require_angles,
    )
    feed_forward: FeedForward = setting("none", "what the drives are given beside the controllers' torque")
    locked: Mapping[str, float] = field(
        default_factory=dict,
        metadata=declare(
            "by the names of joints of the model that stand still and that no log has, their positions [rad or m]",
        ),
    )
    in_motion: bool = setting(False, "whether the records begin while the robot moves, as its references do")


@dataclass(frozen=True, slots=True, kw_only=True)
class FileTable:
    """Tables of a file, each valid by itself.

    Attributes:
        together: names of what is identified beside the joint in several records.
        method: the keys of [method]; see `make_method`.
        texts: see `Reader.texts`.
    """

    axes: tuple[AxisTable, ...]
    robot: RobotTable | None = None
    source: Source = field(default_factory=Source)
    columns: Mapping[str, Column] = field(default_factory=dict)
    records: tuple[Run, ...] = ()
    together: tuple[str, ...] = ()
    drive: Drive = field(default_factory=Drive)
    filtering: Filtering = field(default_factory=Filtering)
    method: Mapping[str, Any] = field(default_factory=dict)
    texts: Mapping[Place, tuple[str, str]] = field(default_factory=dict)

    def place(self, number: int, *keys: int | str) -> Place:
        """Return the place of a key of an axis, as it stands in this file."""
        if self.robot is None:
            return keys
        return ("joints", number, *(keys[1:] if keys[:1] == ("joint",) else keys))


def read_tables(raw: Mapping[str, Any]) -> FileTable:
    """Read the tables of a joint file or a robot file.

    Args:
        raw: as `tomllib` reads them.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    reader = Reader()
    made: FileTable = reader.read_all(ROBOT_FILE if "robot" in raw else JOINT_FILE, raw)
    return replace(made, texts=reader.texts)


def _make_file(record: tuple[Source, Mapping[str, Column]] = (Source(), {}), **given: Any) -> FileTable:
    """Return a file; a joint file is one of one axis."""
    if "joint" in given:
        tables = {name: given.pop(name) for name in AXIS_TABLES if name in given}
        given["joints"] = (AxisTable(**{"model": "rigid", **given.pop("joint"), **tables}),)
    return FileTable(axes=given.pop("joints"), source=record[0], columns=record[1], **given)


def _make_record(channels: Mapping[str, Column] | None = None, **given: Any) -> tuple[Source, Mapping[str, Column]]:
    options = {name: given.pop(name) for name in keys_of(TextOptions) if name in given}
    return Source(**given, options=options), channels or {}


# Controllers and filters


def _variant(word: str, keys: Mapping[str, Setting], make: Callable[..., Any]) -> Table:
    """Return the table of a law or of a kind of filter."""
    name, product, inverse = _INVERSES.get(word, ("", 1.0, {}))
    return Table({**keys, **inverse}, make, instead=dict.fromkeys(inverse, (name, product)))


def _join_keys(variants: Mapping[str, Table]) -> dict[str, Setting]:
    """Return the keys of all variants as documentation shows them: each with the variants that have it."""
    found: dict[str, list[Setting]] = {}
    for word, table in variants.items():
        for name, one in table.keys.items():
            told = one.help if name == "kind" else f"of {word}: {one.help}"
            shown = replace(one, help=told, default=None, optional=True)
            found.setdefault(name, []).append(shown)
    return {name: merge(same) for name, same in found.items()}


def _make_filter(kind: str = "digital", **given: Any) -> Filter:
    made: Filter = FILTERS[kind](**given)
    return made


def _make_law(law: str = "cascade", side: Side = "motor", **given: Any) -> StatedController:
    """Return a controller on its own side, checked at its period where there is one."""
    made: Any = LAWS[law](**given)
    if made.period is not None:
        made.law(made.period)
    return StatedController(made, side, given.get("gain"))


_KIND = key("kind", str, "which filter", "digital", choices=tuple(FILTERS))
_FILTERS = {kind: _variant(kind, _KIND | keys_of(owner), _make_filter) for kind, owner in FILTERS.items()}
_FILTER = Table(_join_keys(_FILTERS), shorthand="numerator", decided_by="kind", variants=_FILTERS)
_LAW = (
    key("law", str, "the controller's law", "cascade", choices=tuple(LAWS))
    | key("side", Side, "of the transmission, in whose positions and torque the law's numbers are", "motor")
)  # fmt: skip


def _law_table(law: str) -> Table:
    keys = _LAW | keys_of(LAWS[law], without=("ratio",))
    keys["velocity_filter"] = replace(keys["velocity_filter"], type=_FILTER)
    keys["torque_filters"] = replace(keys["torque_filters"], type=tuple[_FILTER, ...])  # type: ignore[valid-type]
    return _variant(law, keys, _make_law)


_CONTROLLER = Table({}, decided_by="law", variants={law: _law_table(law) for law in LAWS})


# Methods


_METHOD = Table(
    key("name", MethodName,
        "by which method; without it that of a joint is didim if the record has what it needs, else idim; "
        "that of a robot is didim without a motor_position, drive_side with one and a spring, else idim")
    | keys_of(*methods())
)  # fmt: skip


def make_method(name: str, given: Mapping[str, Any], system: str) -> Method:
    """Return the method of that name with the keys of [method].

    Args:
        name: of the method.
        given: the keys.
        system: "rigid" or "flexible" for a joint, "robot".

    Raises:
        JointFileError: a key is of another method or system.
    """
    made: Any = method_of(name)
    own = {one: value for one, value in given.items() if one != "name"}
    for one in own.keys() - keys_of(made, system=system):
        rest = f' is not for the method "{name}" of {CALLED[system]}: leave it out, or name another.'
        raise JointFileError(fault_at(("method", one), rest))
    method: Method = made(**own)
    return method


# Files


_MOTION = Table(keys_of(Column, without=("tap", "at", "in_torque")), Column)
_CHANNELS = Table(
    key("torque", Table(keys_of(Column, without=("at", "in_torque")), Column), "motor torque or force")
    | key("reference", _MOTION, "commanded position, motor side")
    | key("reference_velocity", _MOTION, "commanded velocity")
    | key("motor_position", _MOTION, "motor encoder")
    | key("load_position", _MOTION, "load encoder")
    | key("injected", Table(keys_of(Column, without=("tap",)), Column), "known signal added to the controller's output")
)
_PERIOD = key("period", float, "of the first harmonic, on the side that is reported [m or rad]", MISSING, above=0)
_PARAMETER = Table(keys_of(ParameterTable), ParameterTable, shorthand="value")
AXIS_TABLES = (
    key("transmission", Table(keys_of(Transmission, without=("load",))), "what lies between motor and load")
    | key("gravity", Gravity, "what its load weighs, if that matters")
    | key("ripple", Table(keys_of(PositionHarmonics) | _PERIOD, PositionHarmonics),
          "a force that comes back with the position, if there is one")
    | key("controller", _CONTROLLER, "the controller's law, if it is known")
    | key("parameters", Mapping[str, _PARAMETER], "what is known of the parameters, by name")  # type: ignore[valid-type]
    | key("limits", AxisLimits, "what the axis may do in a test that is planned")
)  # fmt: skip
"""Tables of an axis: of a joint file at its top, of a robot file below [[joints]]."""

_SHARED = (
    key("record", Table(keys_of(Source, TextOptions) | key("channels", _CHANNELS, "where the channels are found"),
                        _make_record), "the file of the record, and its channels")
    | key("drive", Table(keys_of(Drive, without=("torque_constant", "torque_per_volt")), Drive),
          "whose traces they are, and its own units")
    | key("filtering", Filtering, "how signals are filtered")
    | key("method", _METHOD, "how the joint is identified")
)  # fmt: skip


def _runs(system: str) -> dict[str, Setting]:
    run: Any = Table(keys_of(Run, system=system), Run)
    return key("records", tuple[run, ...], "records that are identified together")


_FREE = key("free", tuple[str, ...], "names of what surrounds the joint and is identified too", ())
_OF_JOINT = keys_of(AxisTable)
_KIND_OF_JOINT = {"kind": replace(_OF_JOINT["kind"], default=MISSING, optional=False)}
JOINT_FILE = Table(
    key("joint", Table(_OF_JOINT | _KIND_OF_JOINT), "what is identified", MISSING)
    | AXIS_TABLES
    | _SHARED
    | _runs("rigid")
    | key("together", Table(_FREE, lambda free=(): free), "how several records are identified together"),
    _make_file,
)
"""The tables of a joint file."""


def _make_robot_axis(spring: Mapping[str, Any] | None = None, **given: Any) -> AxisTable:
    """Return the axis of [[joints]], flexible if it has a spring."""
    numbers = {name: given.pop(name) for name in keys_of(RobotJoint, without=("spring",)) if name in given}
    if spring is not None:
        link = {name: value for name, value in spring.items() if name != "law"}
        given = {"model": "flexible", **given, "spring": spring.get("law", "linear"), "link": link}
    return AxisTable(**{"model": "rigid"} | given, numbers=numbers)


_SPRING_LAW = {"law": replace(_OF_JOINT["spring"], name="law", type=str)}
_OF_SPRING = keys_of(JointSpring)
_STIFFNESS = {"stiffness": replace(_OF_SPRING["stiffness"], default=None, optional=True)}
_ROBOT_JOINT = Table(
    _OF_JOINT
    | keys_of(RobotJoint)
    | key("name", str, "of the joint in the model", MISSING)
    | key("zero", float, "position of the model's joint where its logged position is 0 [rad or m]; the model is turned",
          0.0)
    | AXIS_TABLES
    | key("spring", Table(_SPRING_LAW | _OF_SPRING | _STIFFNESS, shorthand="law"),
          "between motor and link; without it the joint is rigid")
    | key("channels", _CHANNELS, "its channels, where they are not as [record.channels]")
    | key("method", _METHOD, "as which the joint is identified alone"),
    _make_robot_axis,
)  # fmt: skip
ROBOT_FILE = Table(
    key("robot", RobotTable, "the robot's model", MISSING)
    | key("joints", tuple[_ROBOT_JOINT, ...], "the joints", MISSING)  # type: ignore[valid-type]
    | _SHARED
    | _runs("robot"),
    _make_file,
)
"""The tables of a robot file."""
