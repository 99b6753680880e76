"""Tables of a joint file and a robot file: `JOINT_FILE` and `ROBOT_FILE`.

A key is a setting of the class that uses it. This module declares the remaining keys and the conversion of tables to
values. [joint] and [[joints]] share their keys; a joint file has one axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from jointid.common.errors import JointFileError
from jointid.common.settings import Setting, add_settings_to_docstring, declare, setting
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, units_of
from jointid.config.declaration import Place, Reader, Table, fault_at, key, keys_of
from jointid.estimation.methods import CALLED, METHODS, MODELS, ROBOT, Method, MethodName, method_of
from jointid.models.controllers import FILTERS, LAWS, Controller
from jointid.models.friction import FRICTIONS, Friction
from jointid.models.limits import AxisLimits
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.models.robots.inertial import MassProperties, is_physical
from jointid.models.robots.robot import JointSpring, RobotJoint
from jointid.models.springs import SPRINGS, Spring
from jointid.records.clock import require_spans
from jointid.records.columns import Column
from jointid.records.drives import Drive
from jointid.records.formats import TextOptions, format_of
from jointid.records.record import Spans
from jointid.records.resampling import Resampling
from jointid.records.signals.filtering import Filtering

FeedForward: TypeAlias = Literal["none", "gravity", "inverse-model", "logged"]

Values: TypeAlias = dict[str, Any]
"""Values of a table by key, with defaults."""

_TURN = 2 * math.pi  # rad


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Source:
    """The file of the record, and how it is read; see `jointid.records.reading`."""

    file: str | None = setting(None, "path of the record, from the joint file's folder", accept=format_of)
    time: str | None = setting(
        None, "name of the time column; without it, and without a sample time, the column called t or time"
    )
    time_unit: str | None = setting(
        None, "unit of the time column; without it the one in its name, as in Time [ms], or s", choices=units_of("time")
    )
    sample_time: float | None = setting(
        None, "time between samples, where there is no time column; beside one the two must agree", unit="s", above=0
    )
    start: float | None = setting(None, "first instant to read, of the log's own clock", unit="s")
    stop: float | None = setting(None, "last instant to read, of the log's own clock", unit="s")
    torque: Literal["logged", "from_controller"] | None = setting(
        None,
        "whether the torque is a channel of the record, or is computed by the controller from the motor position; by "
        "default logged, for DIDIM from the controller if no torque channel is declared",
    )
    part: int | None = setting(
        None, "which part between jumps of the clock to read, counted from 1; 0 takes the longest", at_least=0
    )
    parts: Spans = setting((), "tests in one log, [begin, end] each, that begin anew", unit="s", accept=require_spans)
    leave_out: Spans = setting((), "[begin, end] each, whose samples do not count", unit="s", accept=require_spans)
    options: Mapping[str, Any] = field(default_factory=dict)  # of the format's reader
    resample: Resampling | None = setting(
        None,
        "uniform clock to which all channels are resampled, and the method; by default a jump of the clock is refused",
    )

    def __post_init__(self) -> None:
        if self.file is not None:
            format_of(self.file, **self.options)
        if self.parts and (self.start, self.stop, self.part) != (None, None, None):
            raise JointFileError("parts is given beside start, stop or part; leave parts, or the others, out.")


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Run:
    """One of several records that are identified together."""

    file: str = field(metadata=declare("path of the record, from the joint file's folder", accept=format_of))
    added_inertia: float = setting(
        0.0,
        "inertia that is added to the load in this record alone, on the load's side",
        unit="kg or kg m2",
        at_least=0,
        systems=MODELS,
    )
    own: tuple[str, ...] = setting(
        (),
        "names of parameters that this record does not share with the others; the motor's state at its first sample "
        "never is shared",
        systems=MODELS,
    )
    payload_mass: float | None = setting(
        None, "mass that the last link carries in this record, beside the robot's model [kg]", above=0, systems=ROBOT
    )
    payload_center: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "its centre of mass in the frame of the last link [m]",
        systems=ROBOT,
    )
    payload_inertia: tuple[float, float, float, float, float, float] = setting(
        6 * (0.0,),
        "its inertia xx, xy, xz, yy, yz, zz about that centre, along the axes of the last link [kg m2]",
        systems=ROBOT,
    )

    def __post_init__(self) -> None:
        stated = any((*self.payload_center, *self.payload_inertia))
        if (stated and self.payload_mass is None) or (self.payload and not is_physical(np.array(self.payload))):
            raise JointFileError(
                f"payload_inertia {list(self.payload_inertia)} with payload_mass = {self.payload_mass} is of no body; "
                "expected a mass, and principal moments not below 0, none above the sum of the others: correct them."
            )

    @property
    def payload(self) -> tuple[float, ...]:
        """Payload of a robot's last link for `Record.payload`; empty without a mass."""
        if self.payload_mass is None:
            return ()
        inertia = np.zeros((3, 3))
        inertia[np.triu_indices(3)] = self.payload_inertia
        body = MassProperties(self.payload_mass, np.array(self.payload_center), inertia + np.triu(inertia, 1).T)
        return tuple(map(float, body.inertial))


def _fill(keys: Mapping[str, Setting]) -> Callable[..., Values]:
    """Return a function that adds the defaults of keys to given values."""
    usual = {name: one.default for name, one in keys.items() if not one.required}
    return lambda **given: usual | given


# Controllers and filters

_INVERSES: Mapping[str, tuple[str, float, dict[str, Setting]]] = {
    "cascade": (
        "integral_gain", 1.0,
        key("integral_time", float, "integral time Tn of the velocity loop, 1 / integral_gain", unit="s", above=0),
    ),
    "first_order": (
        "time_constant", 0.5 / math.pi, key("cutoff", float, "1 / (2 pi time_constant)", unit="Hz", above=0)
    ),
}  # fmt: skip
"""For a law or filter: a key, its product with an inverse key, and that inverse key."""


def _variant(word: str, keys: Mapping[str, Setting], make: Callable[..., Any]) -> Table:
    """Return the table of a controller law or filter kind."""
    name, product, inverse = _INVERSES.get(word, ("", 1.0, {}))
    return Table({**keys, **inverse}, make, instead=dict.fromkeys(inverse, (name, product)))


def _make_filter(kind: str = "digital", **given: Any) -> Any:
    return FILTERS[kind](**given)


def _make_law(law: str = "cascade", side: Side = "motor", **given: Any) -> tuple[Controller, Side, float | None]:
    """Return a controller, the side of its numbers, and its declared gain."""
    made: Any = LAWS[law](**given)
    if made.period is not None:
        made.law(made.period)
    return made, side, given.get("gain")


_KIND = key("kind", str, "which filter", "digital", choices=tuple(FILTERS))
_FILTERS = {kind: _variant(kind, _KIND | keys_of(owner), _make_filter) for kind, owner in FILTERS.items()}
_FILTER = Table({}, shorthand="numerator", decided_by="kind", variants=_FILTERS)
_LAW = (
    key("law", str, "the controller's law", "cascade", choices=tuple(LAWS))
    | key("side", Side, "side of the transmission whose positions and torque the law's numbers are for", "motor")
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
    | keys_of(*map(method_of, METHODS))
)  # fmt: skip


def make_method(name: str, given: Mapping[str, Any], system: str) -> Method:
    """Create a method from the keys of [method]; refuse unsuitable keys."""
    made: Any = method_of(name)
    own = {one: value for one, value in given.items() if one != "name"}
    for one in own.keys() - keys_of(made, system=system):
        rest = f' is not for the method "{name}" of {CALLED[system]}: leave it out, or name another.'
        raise JointFileError(fault_at(("method", one), rest))
    method: Method = made(**own)
    return method


# Axes

_MOTION = Table(keys_of(Column, without=("tap", "at", "in_torque")), Column)
_CHANNELS = Table(
    key("torque", Table(keys_of(Column, without=("at", "in_torque")), Column), "motor torque or force")
    | key("reference", _MOTION, "position setpoint, motor side")
    | key("reference_velocity", _MOTION, "velocity setpoint")
    | key("motor_position", _MOTION, "motor encoder")
    | key("load_position", _MOTION, "load encoder")
    | key("injected", Table(keys_of(Column, without=("tap",)), Column), "known signal added to the controller's output")
)
_OF_PARAMETER = (
    key("value", float, "what the parameter is fixed at")
    | key("start", float, "where the search begins")
    | key("lower", float, "lower bound", infinite=True)
    | key("upper", float, "upper bound", infinite=True)
)
_PARAMETER = Table(_OF_PARAMETER, _fill(_OF_PARAMETER), shorthand="value")
_PERIOD = key("period", float, "of the first harmonic, on the side that is reported [m or rad]", MISSING, above=0)
_OF_JOINT = (
    key("kind", Kind, "how the joint moves: m and N, or rad and N m")
    | key("model", Literal["rigid", "flexible"],
          "one inertia, or two joined by a spring; without it rigid, of a robot flexible where there is a spring")
    | key("friction", str, "the friction's law", "symmetric", accept=Friction, choices=tuple(FRICTIONS))
    | key("spring", str, "the spring's law, of a flexible joint", accept=Spring, choices=tuple(SPRINGS))
    | key("name", str, "what reports call the joint")
    | key("torque_constant", float,
          "torque per ampere or volt of motor and amplifier, on the motor's side; of a logged torque and of the "
          "controller's output; a plain number is per A", unit="N/A, N m/A, N/V or N m/V", above=0)
)  # fmt: skip
AXIS_TABLES = (
    key("transmission", Table(keys_of(Transmission, without=("load",))), "what lies between motor and load")
    | key("gravity", Gravity, "weight of the load")
    | key("ripple", Table(keys_of(PositionHarmonics) | _PERIOD, PositionHarmonics),
          "force that repeats with the position")
    | key("controller", _CONTROLLER, "the controller's law, if it is known")
    | key("parameters", Mapping[str, _PARAMETER], "values, starts and bounds of parameters, by name", {})  # type: ignore[valid-type]
    | key("limits", AxisLimits, "limits of the axis in a planned test", AxisLimits())
)  # fmt: skip
"""Tables of an axis: at top level of a joint file, in [[joints]] of a robot file."""

_ALONE = (
    key("channels", _CHANNELS, "its channels, where they are not as [record.channels]", {})
    | key("method", _METHOD, "method by which the joint is identified alone", {})
)  # fmt: skip
_make_axis = _fill(_OF_JOINT | AXIS_TABLES | _ALONE)


def _make_robot_axis(spring: Mapping[str, Any] | None = None, **given: Any) -> Values:
    """Return the values of [[joints]], flexible if it has a spring."""
    numbers = {name: given.pop(name) for name in keys_of(RobotJoint, without=("spring",)) if name in given}
    link = dict(spring or {})
    if spring is not None:
        given = {"model": "flexible", **given, "spring": link.pop("law", "linear")}
    return _make_axis(**{"model": "rigid", "zero": 0.0} | given, numbers=numbers, link=link)


_SPRING_LAW = {"law": replace(_OF_JOINT["spring"], name="law")}
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
    | _ALONE,
    _make_robot_axis,
)  # fmt: skip


# Files


def _require_angles(base: tuple[float, ...]) -> None:
    if any(abs(angle) > _TURN for angle in base):
        raise JointFileError(f"an angle exceeds a turn in {list(base)}; expected rad: convert the degrees.")


_OF_ROBOT = (
    key("model", str, "path of its URDF or MJCF file, from the robot file's folder", MISSING)
    | key("name", str, "what reports call the robot; without it as the model does")
    | key("base", tuple[float, float, float],
          "roll, pitch and yaw of its base: about the fixed axes x, y and z of a world with z upwards [rad]",
          (0.0, 0.0, 0.0), accept=_require_angles)
    | key("feed_forward", FeedForward, "torque that the drives add to the controllers' output", "none")
    | key("locked", Mapping[str, float],
          "positions of the model's joints that stand still and that no log has, by name [rad or m]", {})
    | key("in_motion", bool, "whether the records begin while the robot moves, as its references do", False)
)  # fmt: skip


def _make_record(channels: Mapping[str, Column] | None = None, **given: Any) -> tuple[Source, Mapping[str, Column]]:
    options = {name: given.pop(name) for name in keys_of(TextOptions) if name in given}
    return Source(**given, options=options), channels or {}


_SHARED = (
    key("record", Table(keys_of(Source, TextOptions) | key("channels", _CHANNELS, "where the channels are found"),
                        _make_record), "the file of the record, and its channels", (Source(), {}))
    | key("drive", Table(keys_of(Drive, without=("torque_constant", "torque_per_volt")), Drive),
          "profile and units of the drive", Drive())
    | key("filtering", Filtering, "how signals are filtered", Filtering())
    | key("method", _METHOD, "how the joint is identified", {})
)  # fmt: skip


def _runs(system: str) -> dict[str, Setting]:
    run: Any = Table(keys_of(Run, system=system), Run)
    return key("records", tuple[run, ...], "records that are identified together", ())


def _make_file(**given: Any) -> Values:
    return {"robot": None, "together": (), **_fill(_SHARED | _runs("robot"))(**given)}


def _make_joint_file(joint: Values, **given: Any) -> Values:
    """Return a joint file's values in the form of a robot file's."""
    tables = {name: given.pop(name) for name in AXIS_TABLES if name in given}
    return _make_file(**given, joints=(_make_axis(**{"model": "rigid"} | joint, **tables),))


_FREE = key("free", tuple[str, ...], "names of further numbers to identify, of controller, filters or delays", ())
JOINT_FILE = Table(
    key("joint", Table(_OF_JOINT | {"kind": replace(_OF_JOINT["kind"], default=MISSING, optional=False)}),
        "what is identified", MISSING)
    | AXIS_TABLES
    | _SHARED
    | _runs("rigid")
    | key("together", Table(_FREE, lambda free=(): free), "how several records are identified together"),
    _make_joint_file,
)  # fmt: skip
"""The tables of a joint file."""

ROBOT_FILE = Table(
    key("robot", Table(_OF_ROBOT, _fill(_OF_ROBOT)), "the robot's model", MISSING)
    | key("joints", tuple[_ROBOT_JOINT, ...], "the joints", MISSING)  # type: ignore[valid-type]
    | _SHARED
    | _runs("robot"),
    _make_file,
)
"""The tables of a robot file."""


def read_tables(raw: Mapping[str, Any]) -> tuple[Values, tuple[Values, ...]]:
    """Convert a file's tables to values of the file and its axes.

    All faults are reported at once. Each axis also contains shared values: source, drive, records and channels of the
    file, numbers given with a unit (`Reader.texts`), and `at`, which returns the place of a key.
    """
    reader = Reader()
    file: Values = reader.read_all(ROBOT_FILE if "robot" in raw else JOINT_FILE, raw)
    source, columns = file["record"]
    shared = {"source": source, "drive": file["drive"], "records": file["records"], "texts": reader.texts}

    def place(number: int) -> Callable[..., Place]:
        """Return an axis's place function; keys of [joint] move to [[joints]]."""
        if file["robot"] is None:
            return lambda *keys: keys
        return lambda *keys: ("joints", number, *(keys[1:] if keys[:1] == ("joint",) else keys))

    axes = enumerate(file["joints"])
    return file, tuple(shared | one | {"channels": {**columns, **one["channels"]}, "at": place(i)} for i, one in axes)
