"""The tables of a joint file and of a robot file: `JOINT_FILE` and `ROBOT_FILE`.

A key is a setting of the class that uses it. Here stand the keys of the file's own, and how tables become objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, Literal, TypeAlias

from jointid.common.errors import JointFileError
from jointid.common.settings import Declared, setting
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind
from jointid.config.declaration import Place, Reader, Table, fault_at, key, key_error, keys_of, merge
from jointid.config.source import Run, Source, Together
from jointid.estimation.methods.registry import CALLED, Method, MethodName, method_of, methods
from jointid.models.controllers import FILTERS, LAWS, Controller, Filter, as_filter
from jointid.models.disturbances import Drift
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

_JOINT, _ROBOT = "rigid", "robot"  # systems of settings
_TURN = 2 * math.pi  # rad
_EFFECTS = ("harmonics", "period", "drift")  # keys of [method] for the effects of a regression
_FILTERINGS: Mapping[str, Callable[[], Filtering]] = {
    "default": Filtering,
    "published": Filtering.published,
}


Instead: TypeAlias = tuple[str, str, str, Callable[[float, float], float]]
"""The key that another one gives; meaning and unit of the other, and what computes the key, with the position gain."""

_DERIVATIVE: Instead = (
    "derivative_gain", "derivative time Td: derivative_gain = position_gain x derivative_time", "s",
    lambda time, gain: gain * time,
)  # fmt: skip
INSTEAD: Mapping[str, Mapping[str, Instead]] = {
    "cascade": {"integral_time": (
        "integral_gain", "integral time Tn of the velocity loop, 1 over its integral gain", "s",
        lambda time, _: 1.0 / time,
    )},
    "pd": {"derivative_time": _DERIVATIVE},
    "pid": {"derivative_time": _DERIVATIVE, "integral_time": (
        "integral_gain", "integral time Ti: integral_gain = position_gain / integral_time", "s",
        lambda time, gain: gain / time,
    )},
    "first_order": {"cutoff": (
        "time_constant", "1 / (2 pi time_constant)", "Hz", lambda hertz, _: 0.5 / (math.pi * hertz),
    )},
    "second_order": {"cutoff": ("frequency", "its frequency", "Hz", lambda hertz, _: hertz)},
}  # fmt: skip
"""By each law and each kind of filter, and by its name, the keys in other words."""


@dataclass(frozen=True, slots=True)
class StatedController:
    """A controller as a file states it.

    Attributes:
        law: on its own side; its gain is 1 where none is given.
        side: of the transmission, in whose positions and torque its numbers are.
        keys: that the file gives, and the settings that they say in other words.
    """

    law: Controller
    side: Side
    keys: frozenset[str]


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
    method: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTable:
    """[robot]: its model, and how it stands."""

    model: str = setting(MISSING, "path of its URDF or MJCF file, from the robot file's folder")
    name: str | None = setting(None, "what reports call the robot; without it as the model does")
    base: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "roll, pitch and yaw of its base: about the fixed axes x, y and z of a world with z upwards [rad]",
        expected="a list of three numbers",
    )
    feed_forward: FeedForward = setting("none", "what the drives are given beside the controllers' torque")
    locked: Mapping[str, float] = setting(
        None,
        "by the names of joints of the model that stand still and that no log has, their positions [rad or "
        "m]; or a list of such joints, which stand at 0",
        expected="a table of numbers, or a list of joints",
    )
    in_motion: bool = setting(False, "whether the records begin while the robot moves, as its references do")

    def __post_init__(self) -> None:
        if any(abs(angle) > _TURN for angle in self.base):
            rest = f" is {list(self.base)}, beyond a turn; expected roll, pitch and yaw in rad: convert the degrees."
            raise key_error("base", rest)


@dataclass(frozen=True, slots=True, kw_only=True)
class FileTable:
    """Tables of a file, each valid by itself.

    Attributes:
        method: the keys of [method]; see `make_method`.
        texts: see `Reader.texts`.
    """

    axes: tuple[AxisTable, ...]
    robot: RobotTable | None = None
    source: Source = field(default_factory=Source)
    columns: Mapping[str, Column] = field(default_factory=dict)
    records: tuple[Run, ...] = ()
    together: Together = field(default_factory=Together)
    drive: Drive = field(default_factory=Drive)
    filtering: Filtering = field(default_factory=Filtering)
    method: Mapping[str, Any] = field(default_factory=dict)
    texts: Mapping[Place, tuple[str, str]] = field(default_factory=dict)

    def place(self, number: int, *keys: int | str) -> Place:
        """Return the place of a key of an axis, as it stands in this file."""
        if self.robot is None:
            return keys
        return ("joints", number, *(keys[1:] if keys[0] == "joint" else keys))


def read_tables(raw: Mapping[str, Any]) -> FileTable:
    """Read the tables of a joint file or a robot file.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    robot, reader = raw.get("robot"), Reader()
    if isinstance(robot, dict) and isinstance(still := robot.get("locked"), list):
        raw = {**raw, "robot": {**robot, "locked": {name: 0.0 for name in still if isinstance(name, str)}}}
    made: FileTable = reader.read_all(JOINT_FILE if robot is None else ROBOT_FILE, raw)
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


def _variant(word: str, keys: Mapping[str, Declared], owner: Callable[..., Any]) -> Table:
    """Return the table of a law or of a kind of filter, with the keys that say others in other words."""
    known, instead = dict(keys), INSTEAD.get(word, {})
    for name, (gives, means, unit, _) in instead.items():
        known |= key(name, float, means, unit=unit, above=0)
        known[gives] = replace(keys[gives], default=None) if keys[gives].required else keys[gives]

    def make(**given: Any) -> Any:
        stated = frozenset(given)
        for name, (gives, _, _, compute) in instead.items():
            if (name in given and gives in given) or (keys[gives].required and not {name, gives} & given.keys()):
                raise key_error(gives, f" and {name} say the same; expected one of them.", "missing")
            if name in given:
                given[gives] = compute(given.pop(name), given.get("position_gain", 1.0))
        return owner(stated | given.keys(), **given)

    return Table(known, make)


def _join_keys(variants: Mapping[str, Table]) -> dict[str, Declared]:
    """Return the keys of all variants as documentation shows them: each with the variants that have it."""
    found: dict[str, list[Declared]] = {}
    for word, table in variants.items():
        for name, one in table.keys.items():
            told = one.setting.help if name == "kind" else f"of {word}: {one.setting.help}"
            shown = replace(one, setting=replace(one.setting, help=told), default=None, optional=True)
            found.setdefault(name, []).append(shown)
    return {name: merge(same) for name, same in found.items()}


def _make_filter(_: object, kind: str = "digital", **given: Any) -> Filter | tuple[float, ...]:
    """Return a filter; of one that has a numerator only, that."""
    numerator: tuple[float, ...] = given.get("numerator", ())
    made: Filter = FILTERS[kind](**given)
    return numerator if [*given] == ["numerator"] else made


def _make_law(stated: frozenset[str], law: str = "cascade", side: Side = "motor", **given: Any) -> StatedController:
    """Return a controller on its own side, checked at its period where there is one."""
    if len({len(row) for row in given.get("A", ())}) > 1:
        raise key_error("A", " has rows of several lengths; expected n rows of n numbers: complete them.")
    if "torque_filters" in given:
        given["torque_filters"] = tuple(map(as_filter, given["torque_filters"]))
    made: Any = LAWS[law](**given)
    if made.period is not None:
        made.law(made.period)
    return StatedController(made, side, stated)


_KIND = key("kind", str, "which filter", "digital", choices=tuple(FILTERS))
_FILTERS = {kind: _variant(kind, _KIND | keys_of(owner), _make_filter) for kind, owner in FILTERS.items()}
_FILTER = Table(_join_keys(_FILTERS), shorthand="numerator", decided_by="kind", variants=_FILTERS)
_LAW = (
    key("law", str, "the controller's law", "cascade", choices=tuple(LAWS))
    | key("side", Side, "of the transmission, in whose positions and torque the law's numbers are", "motor")
)  # fmt: skip
_INPUTS = "reference, reference_velocity, position"
_STATES = (
    key("A", tuple[tuple[float, ...], ...], "how the states go on: n rows of n numbers", MISSING)
    | key("B", Mapping[str, tuple[float, ...]],
          f"how each input moves the states: n numbers for {_INPUTS} and excess, which is what the limit cut off; one "
          "that is left out is 0", MISSING)
    | key("C", tuple[float, ...], "output row: n numbers", MISSING)
    | key("D", Mapping[str, float],
          f"direct gain of each input: a number for {_INPUTS}, usually negative; one that is left out is 0", MISSING)
)  # fmt: skip


def _law_table(law: str) -> Table:
    keys = _LAW | keys_of(LAWS[law], without=("ratio",))
    if law == "state_space":
        del keys["reference_delay"]
        return _variant(law, keys | _STATES, _make_law)
    keys["velocity_filter"] = replace(keys["velocity_filter"], type=_FILTER)
    keys["torque_filters"] = replace(keys["torque_filters"], type=tuple[_FILTER, ...])  # type: ignore[valid-type]
    return _variant(law, keys, _make_law)


_CONTROLLER = Table({}, decided_by="law", variants={law: _law_table(law) for law in LAWS})


# Filtering and method


def _make_filtering(preset: str | None = None, **given: Any) -> Filtering:
    if preset is not None and given:
        raise key_error(next(iter(given)), f' stands beside preset = "{preset}", which sets it: leave one of them out.')
    return Filtering(**given) if preset is None else _FILTERINGS[preset]()


def _make_method(**given: Any) -> dict[str, Any]:
    if ("period" in given) != (given.get("harmonics", 0) > 0):
        rest = " and harmonics stand together: the period of the first harmonic in m or rad, and how many there are."
        raise key_error("period", rest)
    return given


_PRESET = key("preset", Literal[*_FILTERINGS], "all of it at once, in place of the other keys")
_FILTERING = Table(_PRESET | keys_of(Filtering), _make_filtering)
_METHOD = Table(
    key("name", MethodName,
        "by which method; without it that of a joint is didim if the record has what it needs, else idim; "
        "that of a robot is didim without a motor_position, drive_side with one and a spring, else idim")
    | key("harmonics", int, "of idim: harmonics of the force over the motor position", 0, at_least=0)
    | key("period", float, "of idim: of the first harmonic, on the side that is reported; needed beside harmonics "
          "[m or rad]", above=0)
    | key("drift", Literal["force", "viscous", "both"], "of idim: what changes linearly in time")
    | keys_of(*methods(), without=("period",)),
    _make_method,
)  # fmt: skip


def method_keys(method: type[Method], system: str = "") -> set[str]:
    """Return the keys of [method] for a method, of a "rigid" or "flexible" joint or a "robot"; of all without it."""
    own: Any = method
    effects = "effects" in {one.name for one in fields(own)} and system != _ROBOT
    return {"name", *keys_of(method, system=system), *(_EFFECTS if effects else ())}


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
    for one in given.keys() - method_keys(made, system):
        rest = f' is not for the method "{name}" of {CALLED[system]}: leave it out, or name another.'
        raise JointFileError(fault_at(("method", one), rest))
    own = {one: value for one, value in given.items() if one not in ("name", *_EFFECTS)}
    ripple = (PositionHarmonics(given["period"], given["harmonics"]),) if "period" in given else ()
    drift = (Drift(given["drift"]),) if "drift" in given else ()
    if ripple or drift:
        own["effects"] = (*ripple, *drift)
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

_RECORD = Table(keys_of(Source, TextOptions) | key("channels", _CHANNELS, "where the channels are found"), _make_record)
_DRIVE = Table(keys_of(Drive, without=("torque_constant", "torque_per_volt")), Drive)
_SHARED = (
    key("record", _RECORD, "the file of the record, and its channels")
    | key("drive", _DRIVE, "whose traces they are, and its own units")
    | key("filtering", _FILTERING, "how signals are filtered")
    | key("method", _METHOD, "how the joint is identified")
)


def _runs(system: str) -> dict[str, Declared]:
    run: Any = Table(keys_of(Run, system=system), Run)
    return key("records", tuple[run, ...], "records that are identified together")


_OF_JOINT = keys_of(AxisTable)
_REQUIRED_KIND = {"kind": replace(_OF_JOINT["kind"], default=MISSING, optional=False)}
JOINT_FILE = Table(
    key("joint", Table(_OF_JOINT | _REQUIRED_KIND), "what is identified", MISSING)
    | AXIS_TABLES
    | _SHARED
    | _runs(_JOINT)
    | key("together", Together, "how several records are identified together"),
    _make_file,
)
"""The tables of a joint file."""


def _make_spring(law: str = "linear", **given: float) -> tuple[str, dict[str, float]]:
    if given and "stiffness" not in given:
        raise key_error("stiffness", " is missing beside the spring's other numbers: add it.", "missing")
    return law, given


def _make_robot_axis(spring: tuple[str, dict[str, float]] | None = None, **given: Any) -> AxisTable:
    """Return the axis of [[joints]], flexible if it has a spring."""
    numbers = {name: given.pop(name) for name in keys_of(RobotJoint, without=("spring",)) if name in given}
    law, link = (None, {}) if spring is None else spring
    model: Any = given.pop("model", None) or ("rigid" if spring is None else "flexible")
    return AxisTable(**given, spring=law, link=link, model=model, numbers=numbers)


_STIFFNESS = key("stiffness", float, "of the spring, where a search begins, unless joints.parameters says it "
                 "[N m/rad or N/m]", above=0)  # fmt: skip
_SPRING_LAW = {"law": replace(_OF_JOINT["spring"], name="law", type=str)}
_SPRING = Table(_SPRING_LAW | keys_of(JointSpring) | _STIFFNESS, _make_spring, shorthand="law")
_ROBOT_JOINT = Table(
    _OF_JOINT
    | keys_of(RobotJoint)
    | key("name", str, "of the joint in the model", MISSING)
    | key("zero", float, "position of the model's joint where its logged position is 0 [rad or m]; the model is turned",
          0.0)
    | AXIS_TABLES
    | key("spring", _SPRING, "between motor and link; without it the joint is rigid")
    | key("channels", _CHANNELS, "its channels, where they are not as [record.channels]")
    | key("method", _METHOD, "as which the joint is identified alone"),
    _make_robot_axis,
)  # fmt: skip
ROBOT_FILE = Table(
    key("robot", RobotTable, "the robot's model", MISSING)
    | key("joints", tuple[_ROBOT_JOINT, ...], "the joints", MISSING)  # type: ignore[valid-type]
    | _SHARED
    | _runs(_ROBOT),
    _make_file,
)
"""The tables of a robot file."""
