"""The tables of a joint file and of a robot file, and the one reader of them.

A key is a setting of the class that uses it (`jointid.common.settings`), which declares type, unit, bounds, default and
words. `JOINT_FILE` and `ROBOT_FILE` say which tables there are; a fault is a sentence with place and code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from typing import Any, Literal, TypeAlias, get_args, get_origin

import numpy as np

from jointid.common import messages
from jointid.common.errors import Fault, FaultsError, JointFileError, JointidError
from jointid.common.settings import Declared, Setting, setting, settings_of
from jointid.common.transmission import Transmission
from jointid.common.units import Kind, units_of
from jointid.config.quantities import is_quantity, list_units, misfit, to_si
from jointid.config.source import Run, Source, Together
from jointid.estimation.methods.registry import Method, MethodName, method_of, methods
from jointid.models.controllers import FILTERS, LAWS, Controller, DigitalFilter, Filter, StateSpaceController, as_filter
from jointid.models.disturbances import Drift
from jointid.models.friction import FRICTIONS, find_friction
from jointid.models.limits import AxisLimits
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.models.robots.inertial import MassProperties, is_physical
from jointid.models.robots.robot import JointSpring, RobotJoint
from jointid.models.springs import SPRINGS, find_spring
from jointid.records.columns import Column
from jointid.records.drives import Drive
from jointid.records.formats import TextOptions, format_of
from jointid.records.signals.filtering import Filtering

Place: TypeAlias = tuple[int | str, ...]
"""Keys and indices that lead to a value."""

FeedForward: TypeAlias = Literal["none", "gravity", "inverse-model", "logged"]

CONTRADICTION = "contradiction"
"""Code of a fault of values that are right by themselves."""

EFFECTS = ("harmonics", "period", "drift")
"""The keys of [method] for the effects of a regression."""

FILTERINGS: Mapping[str, Callable[[], Filtering]] = {
    "default": Filtering,
    "published": Filtering.published,
}
"""The presets of [filtering]."""

_MOST = 10**9  # of what is counted
_TURN = 2 * math.pi  # rad
_WRONG: Any = object()  # stands for a value that has a fault


def fault_at(place: Place, rest: str, code: str = CONTRADICTION) -> Fault:
    """Return a fault whose sentence begins with its place."""
    return Fault(f"{messages.dot_path(place)}{rest}", place, code)


def key_error(key: str, rest: str, code: str = CONTRADICTION) -> JointFileError:
    """Return the error of a key, for whoever makes its table."""
    return JointFileError(fault_at((key,), rest, code))


def refusal(make: Callable[..., object], *arguments: object) -> str | None:
    """Return the rest of the sentence with which `make` refuses; None if it does not."""
    try:
        make(*arguments)
    except JointidError as error:
        return f": {error}"
    return None


# Tables


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A table of a file.

    Attributes:
        keys: the declaration of each.
        make: takes the values that are given, by key. The places of a `JointFileError` of it begin in the table.
        shorthand: the key whose value may be written instead of the table.
        decided_by: the key that says which of `variants` the table is.
    """

    keys: Mapping[str, Declared]
    make: Callable[..., Any] = dict
    shorthand: str = ""
    decided_by: str = ""
    variants: Mapping[str, Table] = field(default_factory=dict)


def keys_of(*owners: Any, without: Collection[str] = ()) -> dict[str, Declared]:
    """Return the keys that are settings of classes; one of several is described once for each."""
    found: dict[str, list[Declared]] = {}
    for owner in owners:
        for one in settings_of(owner):
            if one.name not in without:
                found.setdefault(one.name, []).append(one)
    return {name: _merge(same) for name, same in found.items()}


def _merge(same: list[Declared]) -> Declared:
    """Return one declaration of a setting that several classes have; its default is that of all, or none."""
    help_text = "; ".join(dict.fromkeys(one.setting.help for one in same))
    merged = replace(same[0], setting=replace(same[0].setting, help=help_text))
    return merged if len({str(one.default) for one in same}) == 1 else replace(merged, default=None, optional=True)


def _keys(**declared: tuple[Any, str]) -> dict[str, Declared]:
    """Return keys from their types and words."""
    return {name: Declared(name, kind, True, None, Setting(text)) for name, (kind, text) in declared.items()}


def _require(one: Declared) -> Declared:
    return replace(one, default=MISSING, optional=False)


@cache
def table_of(kind: Any) -> Table | None:
    """Return the table by which values of a type are written; None for a type of single values."""
    if isinstance(kind, Table):
        return kind
    if not isinstance(kind, type) or get_origin(kind) is not None or not hasattr(kind, "__dataclass_fields__"):
        return None
    keys = keys_of(kind)
    return Table(keys, kind) if keys else None


def table_of_items(kind: Any) -> Table | None:
    """Return the table of each item of a list, or of each value of a mapping; None for other types."""
    arguments = get_args(kind)
    return table_of(arguments[0 if get_origin(kind) is tuple else -1]) if arguments else None


# The record


def _make_record(channels: Mapping[str, Column] | None = None, **given: Any) -> tuple[Source, Mapping[str, Column]]:
    """Return the file of the record with the options of its format, and the channels."""
    options = {key: given.pop(key) for key in keys_of(TextOptions) if key in given}
    source = Source(**given, options=options)
    if source.file is not None and source.files:
        raise key_error("files", f' stands beside file = "{source.file}"; keep one of them.')
    if source.offsets and len(source.offsets) != len(source.files):
        said = f"{len(source.offsets)} numbers for {len(source.files)} files"
        raise key_error("offsets", f" has {said}; give one for each file, or none.")
    for file in filter(None, (source.file, *source.files)):
        if refused := refusal(lambda name: format_of(name, **options), file):
            raise key_error("files" if source.files else "file", refused)
    return source, channels or {}


_MOTION = Table(keys_of(Column, without=("tap", "at", "in_torque")), Column)
_CHANNELS = Table(
    _keys(
        torque=(Table(keys_of(Column, without=("at", "in_torque")), Column), "motor torque or force"),
        reference=(_MOTION, "commanded position, motor side"),
        reference_velocity=(_MOTION, "commanded velocity"),
        motor_position=(_MOTION, "motor encoder"),
        load_position=(_MOTION, "load encoder"),
        injected=(Table(keys_of(Column, without=("tap",)), Column), "known signal added to the controller's output"),
    )
)
_RECORD = Table(
    keys_of(Source, TextOptions) | _keys(channels=(_CHANNELS, "where the channels are found")), _make_record
)
_DRIVE = Table(keys_of(Drive, without=("torque_constant", "torque_per_volt")), Drive)


# The joint


def _make_transmission(**given: Any) -> dict[str, Any]:
    if "lead_unit" in given and "lead" not in given:
        raise key_error("lead_unit", " is there without a lead: leave it out.")
    return given


_TRANSMISSION = Table(
    keys_of(Transmission, without=("load",))
    | {"lead_unit": Declared("lead_unit", str, False, "m", Setting("unit of the lead", choices=units_of("length")))},
    _make_transmission,
)


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """[parameters.inertia] and its like: what is known of one parameter; a bare number is a value."""

    value: float | None = setting(None, "what the parameter is fixed at")
    start: float | None = setting(None, "where the search begins")
    lower: float | None = setting(None, "lower bound", infinite=True, expected="a number, inf or -inf")
    upper: float | None = setting(None, "upper bound", infinite=True, expected="a number, inf or -inf")
    free: bool | None = setting(None, "whether the parameter is identified")

    def __post_init__(self) -> None:
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            rest = f" is {self.lower:g}; expected less than upper = {self.upper:g}: exchange them."
            raise key_error("lower", rest)
        if self.value is not None and self.free:
            rest = f" is true beside value = {self.value:g}, which would fix it; write start = {self.value:g}."
            raise key_error("free", rest)
        if self.value is not None and self.start is not None:
            rest = " stands beside value; keep value to fix the parameter, or start to identify it."
            raise key_error("start", rest)
        if self.value is None and self.free is False:
            rest = " is missing; a parameter that is not free needs the value that it keeps: add it."
            raise key_error("value", rest)


_PARAMETER = Table(keys_of(ParameterTable), ParameterTable, shorthand="value")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointKeys:
    """Keys of [joint], which [[joints]] of a robot file has, too."""

    kind: Kind | None = setting(None, "how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] | None = setting(
        None,
        "one inertia, or two joined by a spring; without it rigid, of a robot flexible where there is a spring",
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


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTable(JointKeys):
    """Keys and tables of one axis, each valid by itself.

    Attributes:
        numbers: of the motor of a robot's joint, by the settings of `RobotJoint`.
        link: of its spring and its link's side, by the settings of `JointSpring`.
        channels: of the axis of a robot alone.
    """

    transmission: Mapping[str, Any] | None = None
    gravity: Gravity | None = None
    ripple: PositionHarmonics | None = None
    controller: Controller | None = None
    parameters: Mapping[str, ParameterTable] = field(default_factory=dict)
    limits: AxisLimits = field(default_factory=AxisLimits)
    zero: float = 0.0
    numbers: Mapping[str, Any] = field(default_factory=dict)
    link: Mapping[str, float] = field(default_factory=dict)
    channels: Mapping[str, Column] = field(default_factory=dict)
    method: Mapping[str, Any] | None = None


# The controller


TIMES: Mapping[str, tuple[str, Callable[[float, float], float]]] = {
    "integral_time": ("integral_gain", lambda time, gain: gain / time),
    "derivative_time": ("derivative_gain", lambda time, gain: gain * time),
}
"""Gain of each time, with the function that computes it from the time and the proportional gain."""

_MEANT = {
    ("cascade", "integral_time"): "integral time Tn of the velocity loop, 1 over its integral gain",
    ("pd", "derivative_time"): "derivative time Td: derivative_gain = position_gain x derivative_time",
    ("pid", "derivative_time"): "derivative time Td: derivative_gain = position_gain x derivative_time",
    ("pid", "integral_time"): "integral time Ti: integral_gain = position_gain / integral_time",
}
_CUTOFFS = {"first_order": "time_constant", "second_order": "frequency"}  # what a cut-off of the filter gives


@dataclass(frozen=True, slots=True)
class FilterKeys:
    """Keys of a filter beside those of its kind."""

    kind: Literal[*FILTERS] | None = setting(  # type: ignore[valid-type]
        None, "which filter; it may be left out where the other keys are those of one kind alone"
    )
    cutoff: float | None = setting(
        None,
        "of first_order: 1 / (2 pi time_constant), in place of it; of second_order: its frequency",
        unit="Hz",
        above=0,
    )


def _filter_keys() -> dict[str, Declared]:
    """Return the keys of all kinds of filters, each optional."""
    found: dict[str, list[Declared]] = {}
    kinds: Mapping[str, Any] = FILTERS
    for kind, owner in kinds.items():
        for one in settings_of(owner):
            told = replace(one.setting, help=f"of {kind}: {one.setting.help}")
            found.setdefault(one.name, []).append(replace(one, setting=told, default=None, optional=True))
    return keys_of(FilterKeys) | {name: _merge(same) for name, same in found.items()}


def _make_filter(kind: str | None = None, **given: Any) -> Filter | tuple[float, ...]:
    """Return a filter of the named kind, or of the one with the given keys; only its numerator if that is all."""
    kinds = [one for one in ([kind] if kind else FILTERS) if not any(_misfits_of_filter(one, given))]
    if len(kinds) == 1:
        made: Filter = FILTERS[kinds[0]](**_with_cutoff(kinds[0], given))
        return made.numerator if isinstance(made, DigitalFilter) and [*given] == ["numerator"] else made
    if kind is None:
        raise key_error("kind", messages.missing(messages.either(kinds or FILTERS), "which filter"))
    foreign, lacking = _misfits_of_filter(kind, given)
    if foreign:
        raise key_error(foreign[0], f' is no key of the kind "{kind}"; leave it out.')
    raise key_error(lacking[0], f' is missing of the kind "{kind}": add it.')


def _misfits_of_filter(kind: str, given: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return the surplus and the missing keys of a kind of filter."""
    needed = {one.name: one.default is MISSING or one.name == "numerator" for one in fields(FILTERS[kind])}
    known = _with_cutoff(kind, given)
    return [k for k in known if k not in needed], [k for k, must in needed.items() if must and k not in known]


def _with_cutoff(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given settings, with a cut-off as the setting of that kind of filter."""
    found, name = dict(given), _CUTOFFS.get(kind)
    if name is not None and name not in found and "cutoff" in found:
        cutoff = found.pop("cutoff")
        found[name] = 1.0 / (2.0 * math.pi * cutoff) if name == "time_constant" else cutoff
    return found


_FILTER = Table(_filter_keys(), _make_filter, shorthand="numerator")


@dataclass(frozen=True, slots=True)
class LawKeys:
    """Keys of [controller] beside those of its law."""

    law: str = setting(MISSING, "the controller's law", choices=tuple(LAWS))
    side: Literal["motor", "load"] = setting(
        "motor", "of the transmission, in whose positions and torque the law's numbers are"
    )


@dataclass(frozen=True, slots=True)
class StateSpaceKeys:
    """Keys of a law in state space."""

    A: tuple[tuple[float, ...], ...] = setting(
        MISSING, "how the states go on: n rows of n numbers", expected="a list of rows, each a list of numbers"
    )
    B: Mapping[str, tuple[float, ...]] = setting(
        MISSING,
        "how each input moves the states: n numbers for reference, reference_velocity, position and excess, which is "
        "what the limit cut off; one that is left out is 0",
        expected="a table of lists of numbers",
    )
    C: tuple[float, ...] = setting(MISSING, "output row: n numbers", expected="a list of numbers")
    D: Mapping[str, float] = setting(
        MISSING,
        "direct gain of each input: a number for reference, reference_velocity and position, usually negative; one "
        "that is left out is 0",
        expected="a table of numbers",
    )


def _law_table(law: str) -> Table:
    """Return the table of a law, with the times that say its gains."""
    if law == "state_space":
        return Table(
            keys_of(LawKeys, StateSpaceKeys, StateSpaceController, without=("ratio", "reference_delay")), _make_law
        )
    keys = keys_of(LawKeys, LAWS[law], without=("ratio",))
    filters = keys["torque_filters"]
    words = replace(filters.setting, expected="a list of filters, each a table or the list of a numerator")
    keys["velocity_filter"] = replace(keys["velocity_filter"], type=_FILTER)
    keys["torque_filters"] = replace(filters, type=tuple[_FILTER, ...], setting=words)  # type: ignore[valid-type]
    for (of, time), meaning in _MEANT.items():
        if of == law:
            gain = keys[TIMES[time][0]]
            keys[time] = Declared(time, float, True, None, Setting(meaning, unit="s", above=0))
            keys[gain.name] = replace(gain, default=None if gain.required else gain.default)
    return Table(keys, _make_law)


def _make_law(law: str, side: str = "motor", **given: Any) -> Controller:
    """Return a controller on its own side, checked at its period where there is one."""
    del side
    for time, (name, gain) in TIMES.items():
        if {time, name} <= given.keys():
            rest = f" = {given[time]:g} s stands beside {name}, which says the same: leave one out."
            raise key_error(time, rest)
        if time in given:
            given[name] = gain(given.pop(time), given["position_gain"] if law != "cascade" else 1.0)
    for one in keys_of(LAWS[law]).values():
        if one.required and one.name not in given:  # which may have been a time
            raise key_error(one.name, _lacks(one), "missing")
    if "torque_filters" in given:
        given["torque_filters"] = tuple(map(as_filter, given["torque_filters"]))
    if "A" in given and len(lengths := {len(row) for row in given["A"]}) > 1:
        rest = f" has rows of {' and '.join(map(str, lengths))} numbers; expected rows of one length: complete them."
        raise key_error("A", rest)
    made: Any = LAWS[law](**given)
    if made.period is not None:
        made.law(made.period)
    controller: Controller = made
    return controller


_CONTROLLER = Table({}, decided_by="law", variants={law: _law_table(law) for law in LAWS})


# Filtering and method


def _make_filtering(preset: str | None = None, **given: Any) -> Filtering:
    if preset is None:
        return Filtering(**given)
    for key in given:
        raise key_error(key, f' stands beside preset = "{preset}", which sets it: leave one of them out.')
    return FILTERINGS[preset]()


@dataclass(frozen=True, slots=True)
class FilteringKeys:
    """Keys of [filtering] beside the filtering's own."""

    preset: Literal["default", "published"] | None = setting(None, "all of it at once, in place of the other keys")


_FILTERING = Table(keys_of(FilteringKeys, Filtering), _make_filtering)


@dataclass(frozen=True, slots=True)
class MethodKeys:
    """Keys of [method] beside the methods' own."""

    name: MethodName | None = setting(
        None,
        "by which method; without it that of a joint is didim if the record has what it needs, else idim; "
        "that of a robot is didim without a motor_position, drive_side with one and a spring, else idim",
    )
    harmonics: int = setting(0, "of idim: harmonics of the force over the motor position", at_least=0)
    period: float | None = setting(
        None,
        "of idim: of the first harmonic, on the side that is reported; needed beside harmonics [m or rad]",
        above=0,
    )
    drift: Literal["force", "viscous", "both"] | None = setting(None, "of idim: what changes linearly in time")


def _make_method(**given: Any) -> dict[str, Any]:
    if ("period" in given) != (given.get("harmonics", 0) > 0):
        rest = " and harmonics stand together: the period of the first harmonic in m or rad, and how many there are."
        raise key_error("period", rest)
    return given


METHOD = Table(keys_of(MethodKeys) | keys_of(*methods(), without=("period",)), _make_method)
"""[method], with the settings of every method; see `make_method`."""


def has_effects(method: type[Method]) -> bool:
    """True if a method takes effects, whose keys are `EFFECTS`."""
    made: Any = method
    return "effects" in {field.name for field in fields(made)}


def make_method(name: str, given: Mapping[str, Any]) -> Method:
    """Return the method of that name with the keys of [method]."""
    made: Any = method_of(name)
    own = {key: value for key, value in given.items() if key not in ("name", *EFFECTS)}
    own |= {one.name: None for one in settings_of(made) if one.setting.none and own.get(one.name) == one.setting.none}
    if has_effects(made):
        ripple = (PositionHarmonics(given["period"], given["harmonics"]),) if "period" in given else ()
        own["effects"] = (*ripple, *((Drift(given["drift"]),) if "drift" in given else ()))
    method: Method = made(**own)
    return method


# A robot


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
            said = f" is {list(self.base)}, beyond a turn; expected roll, pitch and yaw in rad: convert the degrees."
            raise key_error("base", said)


@dataclass(frozen=True, slots=True)
class SpringKeys:
    """Keys of the spring of a robot's joint beside its numbers; a bare word is its law."""

    law: str = setting("linear", "the spring's law", accept=find_spring, choices=tuple(SPRINGS))
    stiffness: float | None = setting(
        None, "of the spring, where a search begins, unless joints.parameters says it [N m/rad or N/m]", above=0
    )


def _make_spring(law: str = "linear", **given: float) -> tuple[str, dict[str, float]]:
    if given and "stiffness" not in given:
        raise key_error("stiffness", " is missing beside the spring's other numbers: add it.")
    return law, given


@dataclass(frozen=True, slots=True)
class RobotJointKeys:
    """Keys of [[joints]] that a joint file does not have."""

    name: str = setting(MISSING, "of the joint in the model")
    zero: float = setting(
        0.0, "position of the model's joint where its logged position is 0 [rad or m]; the model is turned"
    )


def _make_robot_axis(spring: tuple[str, dict[str, float]] | None = None, **given: Any) -> AxisTable:
    """Return the axis of [[joints]], flexible if it has a spring."""
    numbers = {key: given.pop(key) for key in keys_of(RobotJoint, without=("spring",)) if key in given}
    law, link = (None, {}) if spring is None else spring
    model: Any = given.pop("model", None) or ("rigid" if spring is None else "flexible")
    return AxisTable(**given, spring=law, link=link, model=model, numbers=numbers)


@dataclass(frozen=True, slots=True)
class PayloadKeys:
    """Keys of [[records]] in a robot file: what the last link carries."""

    payload_mass: float | None = setting(
        None, "of what the last link carries in this record beside the robot's model [kg]", above=0
    )
    payload_center: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "its centre of mass in the frame of the last link [m]", expected="a list of three numbers"
    )
    payload_inertia: tuple[float, float, float, float, float, float] = setting(
        6 * (0.0,),
        "its inertia xx, xy, xz, yy, yz, zz about that centre, along the axes of the last link [kg m2]",
        expected="a list of six numbers",
    )


def _make_robot_run(file: str, **given: Any) -> Run:
    """Return a record with the ten inertial parameters of `Record.payload`."""
    said = PayloadKeys(**given)
    if said.payload_mass is None:
        if given:
            raise key_error("payload_mass", " is missing beside its centre or inertia: add it.", "missing")
        return Run(file)
    inertia = np.zeros((3, 3))
    inertia[np.triu_indices(3)] = said.payload_inertia
    body = MassProperties(said.payload_mass, np.array(said.payload_center), inertia + np.triu(inertia, 1).T)
    payload = tuple(map(float, body.inertial))
    if not is_physical(np.array(payload)):
        rest = f" is {list(said.payload_inertia)}, which no body has; expected principal moments not below 0, "
        raise key_error("payload_inertia", f"{rest}none above the sum of the others: correct it.")
    return Run(file, payload=payload)


# Files


@dataclass(frozen=True, slots=True, kw_only=True)
class FileTable:
    """Tables of a file, each valid by itself.

    Attributes:
        method: the keys of [method]; see `make_method`.
    """

    joints: tuple[AxisTable, ...]
    robot: RobotTable | None = None
    source: Source = field(default_factory=Source)
    columns: Mapping[str, Column] = field(default_factory=dict)
    records: tuple[Run, ...] = ()
    together: Together = field(default_factory=Together)
    drive: Drive = field(default_factory=Drive)
    filtering: Filtering = field(default_factory=Filtering)
    method: Mapping[str, Any] = field(default_factory=dict)


def _make_file(record: tuple[Source, Mapping[str, Column]] = (Source(), {}), **given: Any) -> FileTable:
    """Return a file; a joint file is one of one axis."""
    source, columns = record
    if "joints" not in given:
        tables = {key: given.pop(key) for key in AXIS_TABLES if key in given}
        joint = given.pop("joint")
        given["joints"] = (AxisTable(**{"model": "rigid", **joint, **tables}),)
    return FileTable(source=source, columns=columns, **given)


_RIPPLE = keys_of(PositionHarmonics)
_PERIOD = replace(
    _RIPPLE["period"], setting=Setting("of the first harmonic, on the side that is reported [m or rad]", above=0)
)
AXIS_TABLES = _keys(
    transmission=(_TRANSMISSION, "what lies between motor and load"),
    gravity=(Gravity, "what its load weighs, if that matters"),
    ripple=(
        Table(_RIPPLE | {"period": _PERIOD}, PositionHarmonics),
        "a force that comes back with the position, if there is one",
    ),
    controller=(_CONTROLLER, "the controller's law, if it is known"),
    parameters=(Mapping[str, _PARAMETER], "what is known of the parameters, by name"),  # type: ignore[valid-type]
    limits=(AxisLimits, "what the axis may do in a test that is planned"),
)
"""Tables of an axis: of a joint file at its top, of a robot file below [[joints]]."""

_SHARED = _keys(
    record=(_RECORD, "the file of the record, and its channels"),
    drive=(_DRIVE, "whose traces they are, and its own units"),
    filtering=(_FILTERING, "how signals are filtered"),
    method=(METHOD, "how the joint is identified"),
)
_JOINT_KEYS = keys_of(JointKeys)
JOINT_FILE = Table(
    {
        "joint": _require(
            _keys(joint=(Table(_JOINT_KEYS | {"kind": _require(_JOINT_KEYS["kind"])}), "what is identified"))["joint"]
        ),
        **AXIS_TABLES,
        **_SHARED,
        **_keys(
            records=(tuple[Run, ...], "records that are identified together"),
            together=(Together, "how several records are identified together"),
        ),
    },
    _make_file,
)
"""The tables of a joint file."""

_SPRING = Table(keys_of(SpringKeys) | keys_of(JointSpring, without=("stiffness",)), _make_spring, shorthand="law")
_ROBOT_JOINT = Table(
    _JOINT_KEYS
    | keys_of(RobotJoint, without=("spring",))
    | keys_of(RobotJointKeys)
    | AXIS_TABLES
    | _keys(
        spring=(_SPRING, "between motor and link; without it the joint is rigid"),
        channels=(_CHANNELS, "its channels, where they are not as [record.channels]"),
        method=(METHOD, "as which the joint is identified alone"),
    ),
    _make_robot_axis,
)
_RUN = Table({"file": keys_of(Run)["file"]} | keys_of(PayloadKeys), _make_robot_run)
ROBOT_FILE = Table(
    {
        **{
            name: _require(one)
            for name, one in _keys(
                robot=(RobotTable, "the robot's model"),
                joints=(tuple[_ROBOT_JOINT, ...], "the joints"),  # type: ignore[valid-type]
            ).items()
        },
        **_SHARED,
        **_keys(records=(tuple[_RUN, ...], "logs that are identified together")),  # type: ignore[valid-type]
    },
    _make_file,
)
"""The tables of a robot file."""


# Reading


def read_tables(raw: Mapping[str, Any]) -> FileTable:
    """Read the tables of a joint file or a robot file.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    robot = raw.get("robot")
    if isinstance(robot, dict) and isinstance(still := robot.get("locked"), list):
        at_zero = {name: 0.0 for name in still if isinstance(name, str)}
        raw = {**raw, "robot": {**robot, "locked": at_zero}}
    said: FileTable = read_as(JOINT_FILE if robot is None else ROBOT_FILE, raw)
    return said


def read_as(kind: Any, raw: Mapping[str, Any]) -> Any:
    """Make an object of the tables of a file.

    Args:
        kind: a `Table`, or a dataclass whose settings are its keys.
        raw: the tables as `tomllib` reads them.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    reader, table = Reader(), table_of(kind)
    assert table is not None
    made = reader.read(table, raw)
    if reader.faults:
        raise JointFileError(dict.fromkeys(reader.faults))
    return made


class Reader:
    """Reads tables, and keeps a sentence for each fault."""

    def __init__(self) -> None:
        self.faults = list[Fault]()

    def read(self, table: Table, raw: object, place: Place = ()) -> Any:
        """Make an object of a table; the result is meaningless where it has a fault."""
        if not isinstance(raw, dict):
            if not table.shorthand:
                return self._refuse(place, messages.describe_unexpected_value(raw, "a table"), "table")
            value = self.value(table.keys[table.shorthand], raw, place, beside=", or a table")
            return self._make(table, {table.shorthand: value}, place)
        if table.variants:
            word = raw.get(table.decided_by)
            if not isinstance(word, str) or word not in table.variants:
                lacks = messages.missing(messages.either(table.variants), "which of them it is")
                rest = lacks if word is None else messages.no_choice(word, table.variants)
                return self._refuse((*place, table.decided_by), rest, "choice")
            table = table.variants[word]
        unknown = [key for key in raw if key not in table.keys]
        for key in unknown:
            expected = f"one of {', '.join(table.keys)}: {messages.suggest(key, table.keys, 'leave it out')}"
            self._refuse((*place, key), f" is not a known key; expected {expected}", "unknown")
        given = {
            key: self.value(table.keys[key], value, (*place, key)) for key, value in raw.items() if key in table.keys
        }
        for one in () if unknown else table.keys.values():  # which may be a misspelt one
            if one.required and one.name not in given:
                given[one.name] = self._refuse((*place, one.name), _lacks(one), "missing")
        return _WRONG if unknown else self._make(table, given, place)

    def _make(self, table: Table, given: Mapping[str, Any], place: Place) -> Any:
        if any(value is _WRONG for value in given.values()):
            return _WRONG
        try:
            return table.make(**given)
        except JointidError as error:
            inner = [fault for fault in error.faults if fault.place] if isinstance(error, FaultsError) else []
            before = f"{messages.dot_path(place)}." if place else ""
            self.faults += [Fault(f"{before}{fault}", (*place, *fault.place), fault.code) for fault in inner]
            return _WRONG if inner else self._refuse(place, f": {error}")

    def value(self, one: Declared, raw: Any, place: Place, beside: str = "") -> Any:
        """Return a value of a key as its declaration has it."""
        if (table := table_of(one.type)) is not None:
            return self.read(table, raw, place)
        if (below := table_of_items(one.type)) is not None:
            return self._values(one, below, raw, place)
        found = raw
        try:
            if one.type is float and isinstance(raw, str) and is_quantity(raw) and list_units(one.setting.unit):
                if fault := misfit(raw, one.setting.unit):
                    return self._refuse(place, fault, "unit")
                found = to_si(raw, one.setting.unit)
            found = found if one.setting.none and raw == one.setting.none else _convert(one, found)
        except (ValueError, OverflowError):
            return self._refuse_value(one, raw, place, beside)
        refused = None if one.setting.accept is None else refusal(one.setting.accept, found)
        return found if refused is None else self._refuse(place, refused, "refused")

    def _values(self, one: Declared, below: Table, raw: Any, place: Place) -> Any:
        """Return the tables of a list, or by their names."""
        if get_origin(one.type) is not tuple:
            if not isinstance(raw, dict):
                return self._refuse(place, messages.describe_unexpected_value(raw, "a table"), "value")
            named = {name: self.read(below, value, (*place, name)) for name, value in raw.items()}
            return _WRONG if any(value is _WRONG for value in named.values()) else named
        if not isinstance(raw, list) or (one.required and not raw):
            return self._refuse_value(one, raw, place)
        made = [self.read(below, value, (*place, number)) for number, value in enumerate(raw)]
        return _WRONG if any(value is _WRONG for value in made) else tuple(made)

    def _refuse(self, place: Place, rest: str, code: str = CONTRADICTION) -> Any:
        self.faults.append(fault_at(place, rest, code))
        return _WRONG

    def _refuse_value(self, one: Declared, raw: object, place: Place, beside: str = "") -> Any:
        if one.choices and one.setting.accept is None:
            return self._refuse(place, messages.no_choice(raw, one.choices), "value")
        return self._refuse(place, messages.describe_unexpected_value(raw, one.expected + beside), "value")


def _lacks(one: Declared) -> str:
    """Return the rest of the sentence on a missing key."""
    return messages.missing(one.expected, one.setting.description)


def _convert(one: Declared, raw: Any) -> Any:
    """Return a value of TOML as the setting's type has it.

    Raises:
        ValueError: it is not of that type, or out of its bounds.
    """
    if one.type in (float, int, bool) or (one.choices and one.setting.accept is None):
        if one.fault(raw) is not None or (one.type is int and abs(raw) > _MOST):
            raise ValueError
        return float(raw) if one.type is float else raw
    if one.type == tuple[float, ...] and raw == [] and not one.setting.expected:
        raise ValueError
    return _convert_parts(str if one.choices else one.type, raw)


def _convert_parts(kind: Any, raw: Any) -> Any:
    """Return a text, or a list or a table of texts or numbers, as a type has it.

    Raises:
        ValueError: it is none.
    """
    if kind is Any:
        return raw
    arguments = get_args(kind)
    if get_origin(kind) is tuple and isinstance(raw, list):
        if arguments[-1] is Ellipsis:
            return tuple(_convert_parts(arguments[0], one) for one in raw)
        return tuple(_convert_parts(inner, one) for inner, one in zip(arguments, raw, strict=True))
    if get_origin(kind) is Mapping and isinstance(raw, dict):
        return {name: _convert_parts(arguments[1], one) for name, one in flatten_keys(raw).items()}
    fits = {
        str: isinstance(raw, str) and raw != "",
        float: isinstance(raw, int | float) and not isinstance(raw, bool) and math.isfinite(raw),
        int: isinstance(raw, int) and not isinstance(raw, bool) and 0 <= raw <= _MOST,
    }
    if not fits.get(kind, False):
        raise ValueError
    return float(raw) if kind is float else raw


def flatten_keys(table: Any) -> Any:
    """Return nested tables as one with dotted names: TOML nests ``filter.depth = 0.1``."""
    if not isinstance(table, dict):
        return table
    found: dict[str, Any] = {}
    for key, below in table.items():
        inner = {f".{name}": one for name, one in flatten_keys(below).items()} if isinstance(below, dict) else {}
        found |= {f"{key}{name}": one for name, one in inner.items()} if inner else {key: below}
    return found


# Documentation


@dataclass(frozen=True, slots=True)
class FileKey:
    """A key of a file, for documentation and forms.

    Attributes:
        place: its path; ``<name>`` stands for any name.
        declared: type, unit, bounds, default and words.
        kind: what decides the table that it is in, where a key holds one of several: the law of a controller.
    """

    place: str
    declared: Declared
    kind: str = ""


def list_keys(owner: Table = JOINT_FILE, place: str = "", kind: str = "") -> Iterator[FileKey]:
    """Yield the keys of a table, each before those below it."""
    for word, table in owner.variants.items() or [(kind, owner)]:
        for name, one in table.keys.items():
            at, below = f"{place}{name}", table_of(one.type) or table_of_items(one.type)
            yield FileKey(at, one, word)
            if get_origin(one.type) is Mapping:
                at = f"{at}.<name>"
                item = replace(one, name="<name>", type=get_args(one.type)[1], default=None)
                yield FileKey(at, item, word)
            if below is not None:
                yield from list_keys(below, f"{at}.", word)
