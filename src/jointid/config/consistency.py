"""Consistency of the tables of a joint file: units, channels of the method, parameters of the model."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial

from jointid.common import messages, units
from jointid.common.errors import Fault
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.text import join
from jointid.common.units import Kind
from jointid.config.quantities import Stated, misfit
from jointid.config.schema import (
    KINDS,
    ChannelTable,
    FileTable,
    MethodTable,
    ParameterTable,
    keys_of,
)
from jointid.config.table import Place, refusal
from jointid.estimation.methods.registry import CALLED, METHODS, MODELS, ROBOT, method_of, methods
from jointid.estimation.problems.base import surrounding
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.limits import AxisLimits
from jointid.models.springs import LinearSpring
from jointid.records.columns import known_units
from jointid.records.drives import Drive

_NEXT_TO_ZERO = 1e-200
_NOT_FREE = " is not identified in this joint, beside friction and load as declared; give it a value."


def find_contradictions(file: FileTable) -> Iterator[Fault]:
    """Yield contradictions between the tables of a joint file."""
    if not file.is_wrong("drive") and (refused := refusal(lambda: file.joint.drive(file.drive.build()))):
        yield file.fault(("drive",), refused)
    if not file.is_wrong("joint"):
        yield from (file.fault((table,), rest, "refused") for table, rest in _refusals(file))
    yield from _transmission_faults(file)
    yield from _channel_faults(file)
    yield from _method_faults(file)
    yield from _parameter_faults(file)
    yield from _record_faults(file)
    yield from _limit_faults(file)


def choose_method(file: FileTable, name: str | None, model: str) -> str | None:
    """Return the method: the one named, or the first whose needs are met, or None.

    DIDIM comes first, even where there is a motor position, which it does not read.

    Args:
        file: whose channels and controller there are.
        name: of the method, if the file names one.
        model: of the joint; IDIM of a flexible one needs the load's position too.
    """
    if name is not None:
        return name
    for default in _defaults():
        method = method_of(default)
        if (file.controlled or not method.needs_controller) and set(method.channels(model)) <= set(file.channel_names):
            return default
    return None


def needed_channels(method: str, controller: Controller | None, model: str) -> tuple[str, ...]:
    """Return the names of the channels that a method reads; of a controller not known, only the reference."""
    return method_of(method).channels(model, controller)


def _defaults() -> tuple[str, ...]:
    """Return the names of the methods that a joint file need not name, the first choice first."""
    found = (method.name for method in methods() if method.default_for in (ClosedLoop, Joint))
    return tuple(dict.fromkeys(found))


def _law(file: FileTable) -> Controller | None:
    return None if file.controller is None else file.controller.controller()


def _method_faults(file: FileTable) -> Iterator[Fault]:
    """Yield missing channels of the method, and settings of other methods."""
    if file.is_wrong("method"):
        return
    table = file.method
    of_model = file.model or "rigid"  # whose channels every model needs

    def lacking(method: str) -> list[Place]:
        needed = needed_channels(method, _law(file), of_model)
        missing: list[Place] = [("record", "channels", name) for name in needed if name not in file.channel_names]
        uncontrolled = method_of(method).needs_controller and not file.controlled
        return [*missing, ("controller",)] if uncontrolled else missing

    name = choose_method(file, table.name, of_model)
    if name is None:
        rest = _describe_missing_method({method: lacking(method) for method in _defaults()}, of_model)
        yield file.fault(("method", "name"), rest, "missing")
    else:
        other = next(default for default in _defaults() if default != name)
        for place in lacking(name):
            needing = method_of(name).describe(of_model)
            yield file.fault(
                place,
                f" is missing, but {needing} needs it: add it, "
                f'or use method.name = "{other}", which needs only {_needs(other, of_model)}.',
                "missing",
            )
        if "estimator" in keys_of(method_of(name), of_model) and table.estimator == "iv":
            rest = ' is missing, but method.estimator = "iv" simulates the loop: add it, or use another.'
            for place in [place for place in lacking("didim") if place not in lacking(name)]:
                yield file.fault(place, rest, "missing")
    for key, sentence in foreign_settings(table, name, file.model):
        yield file.fault(("method", key), sentence)
    yield from _free_faults(("method", "free"), table.free, file)


def _systems_of(name: str, key: str) -> tuple[str, ...]:
    """Return the models of a joint, and "robot", that a key of a method is for."""
    return tuple(system for system in (*MODELS, *ROBOT) if key in keys_of(method_of(name), system))


def _needs(method: str, model: str) -> str:
    made = method_of(method)
    return join([*made.channels(model), *(["controller"] if made.needs_controller else [])])


def _describe_missing_method(lacking: Mapping[str, list[Place]], model: str) -> str:
    """Return the rest of the sentence on a file without a possible method."""
    lacks = [
        f"{method_of(method).describe(model)} lacks {' and '.join(map(messages.dot_path, keys))}"
        for method, keys in lacking.items()
    ]
    return f" is missing, and no method can be chosen: {', '.join(lacks)}; add what one of them lacks."


def foreign_settings(table: MethodTable, name: str | None, system: str | None) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on settings of another system, method or preset.

    Args:
        table: [method].
        name: of the method, if the file names one.
        system: "rigid" or "flexible" for a joint, "robot"; None where that is not known.
    """
    of_robot = system in ROBOT
    if of_robot and name is not None and system not in method_of(name).systems:
        yield "name", messages.no_choice(name, [one.name for one in methods() if system in one.systems])
        return
    for key, value in table.settings("name").items():
        owners = [owner for owner in METHODS if _systems_of(owner, key)]
        owner = name if name in owners else owners[0]
        systems = _systems_of(owner, key)
        strange = name is not None and name not in owners
        title = method_of(owner).title
        if strange and not {owner, name} <= set(_defaults()):
            yield key, f' is not for the method "{name}": leave it out, or use method.name = {messages.either(owners)}.'
        elif system is not None and system not in systems:
            other = "this is a robot" if of_robot else f"the joint is {system}"
            yield key, f" is for {title} of {CALLED[systems[0]]}, but {other}: leave it out."
        elif name is not None and strange:
            other = method_of(name).title
            yield key, f' is for {title}, but the method is {other}: leave it out, or use method.name = "{owner}".'
        elif key in table.beside_preset():
            yield key, messages.beside_preset(value, str(table.preset))


def _record_faults(file: FileTable) -> Iterator[Fault]:
    """Yield unknown parameters and impossible controller numbers of the records."""
    joint, controller = known_joint(file), _law(file)
    known = None if joint is None else [parameter.name for parameter in joint.parameters]
    for number, run in enumerate(file.records):
        place = ("records", number)
        for name in run.own:
            if known is not None and name not in known:
                yield file.fault(
                    (*place, "own"),
                    f' names "{name}", which is no parameter of this model; expected some of '
                    f"{', '.join(known)}: {messages.suggest(name, known, 'leave it out')}",
                    "unknown",
                )
        if run.controller and not file.controlled:
            yield file.fault(
                (*place, "controller"), " changes a controller that the file does not have: add [controller]."
            )
        elif controller is not None and (refused := _describe_refused_numbers(controller, run.controller)):
            yield file.fault((*place, "controller"), refused)
    yield from _free_faults(("together", "free"), file.together.free, file)


def _describe_refused_numbers(controller: Controller, numbers: Mapping[str, float]) -> str | None:
    """Return the rest of the sentence on unknown or refused numbers of a controller."""
    known = (*numbers_of(controller), "period")
    for name in numbers:
        if name not in known:
            return f".{messages.dot_path([name])}{messages.describe_unknown_name(name, known)}"
    return refusal(lambda: with_numbers(controller, numbers))


def _free_faults(place: Place, names: Collection[str], file: FileTable) -> Iterator[Fault]:
    """Yield names that cannot be identified beside the joint: unknown ones, or those of other controllers."""
    controller = _law(file)
    if controller is None:
        return
    for name in names:
        if refused := refusal(partial(surrounding, name, controller)):
            yield file.fault(place, refused, "refused")


def _refusals(file: FileTable) -> Iterator[tuple[str, str]]:
    """Yield gravity or ripple with the reason why the joint refuses it."""
    if refused := refusal(lambda: file.joint.joint(None, gravity=file.gravity)):
        yield "gravity", refused
    elif refused := refusal(lambda: file.joint.joint(None, gravity=file.gravity, ripple=file.ripple)):
        yield "ripple", refused


def known_joint(file: FileTable) -> Joint | None:
    """Return the joint with its gravity and ripple; None if one of these tables is wrong."""
    if any(map(file.is_wrong, ("joint", "gravity", "ripple"))) or any(_refusals(file)):
        return None
    return file.joint.joint(None, gravity=file.gravity, ripple=file.ripple)


def _parameter_faults(file: FileTable) -> Iterator[Fault]:
    """Yield unknown parameters and impossible values."""
    joint = known_joint(file)
    if joint is None:
        return
    known = {parameter.name: parameter for parameter in joint.parameters}
    for name, table in file.parameters.items():
        place = ("parameters", name)
        if name not in known:
            yield file.fault(place, _describe_unknown_key(name, file, known), "unknown")
            continue
        # A parameter that is a bare number has no keys.
        keys = set(table.given) - {"value"}
        for key, rest in _value_faults(known[name], table):
            yield file.fault((*place, key) if key and keys else place, rest)


def change_parameter(parameter: Parameter, table: ParameterTable) -> Parameter:
    """Return a parameter of the model with the file's value and the tighter bounds."""
    lower, upper = _bounds(parameter, table)
    free = table.value is None and (parameter.free if table.free is None else table.free)
    start = next((given for given in (table.value, table.start, parameter.start) if given is not None), None)
    return replace(parameter, free=free, start=start, lower=lower, upper=upper)


def _bounds(parameter: Parameter, table: ParameterTable) -> tuple[float, float]:
    lower = parameter.lower if table.lower is None else max(table.lower, parameter.lower)
    upper = parameter.upper if table.upper is None else min(table.upper, parameter.upper)
    return lower, upper


def _value_faults(parameter: Parameter, table: ParameterTable) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on impossible values of a parameter."""
    if not parameter.free and table.value is None:
        yield "", _NOT_FREE
        return
    lower, upper = _bounds(parameter, table)
    if not lower < upper:
        if table.upper is not None:
            yield "upper", f" is {table.upper:g}; expected more than {_open(lower):g}: raise it."
        else:
            yield "lower", f" is {lower:g}; expected less than {upper:g}: lower it."
        return
    for key in ("value", "start"):
        number = getattr(table, key)
        if number is not None and not lower <= number <= upper:
            yield key, f" is {number:g}; expected {_range(lower, upper)}: correct it, or its bounds."


def _range(lower: float, upper: float) -> str:
    if upper == math.inf:
        return f"{lower:g} or more" if lower == _open(lower) else "more than 0"
    return f"{upper:g} or less" if lower == -math.inf else f"a number from {_open(lower):g} to {upper:g}"


def _open(lower: float) -> float:
    """Return the bound as shown: 0 for a tiny one that only excludes 0."""
    return 0.0 if 0.0 < lower < _NEXT_TO_ZERO else lower


def _describe_unknown_key(name: str, file: FileTable, known: Collection[str]) -> str:
    """Return the rest of the sentence on a parameter that this model does not have."""
    joint = file.joint
    model = f"a {joint.model} joint with {joint.friction} friction"
    model += "" if joint.spring == LinearSpring.name else f" and a {joint.spring} spring"
    remedy = messages.suggest(name, known, "leave it out, or declare the law that has it")
    return f" is not known for {model}; expected one of {', '.join(known)}: {remedy}"


def _channel_faults(file: FileTable) -> Iterator[Fault]:
    """Yield missing columns, misplaced settings, impossible units, and torques in different units."""
    # Behind a transmission that is not right, a motor may move in any way.
    kinds = KINDS if file.is_wrong("transmission") else file.kinds
    drive = file.drive_of_joint
    for name, table in file.channels.items():
        if not table.column and drive is not None and drive.traces is None:
            yield file.fault(
                ("record", "channels", name, "column"),
                " is missing; expected text in quotes (name of the column in the record's file): add it, or give "
                "drive.profile.",
                "missing",
            )
        for fault in table.build().misplaced_faults(name):
            yield file.fault(("record", "channels", name), fault.removeprefix(name))
        yield from _unit_faults(file, name, table, kinds)
    if file.computes_torque:
        if "torque" in file.channels:
            yield file.fault(("record", "torque"), ' is "from_controller" beside a torque channel; keep one of them.')
        channels = ("motor_position", *(("reference",) if (law := _law(file)) is None else law.channels))
        places: list[Place] = [("record", "channels", name) for name in channels if name not in file.channel_names]
        for place in [*places, *([] if file.controlled else [("controller",)])]:
            yield file.fault(place, ' is missing, but record.torque = "from_controller" needs it: add it.', "missing")
    if "injected" in file.channels:
        pairs = {(_si_unit(file, "injected", kind), _si_unit(file, "torque", kind)) for kind in kinds}
        pair = pairs.pop() if len(pairs) == 1 else (None, None)
        # A force on one side of a screw and a torque on the other are both in SI.
        if None not in pair and len({unit in TORQUE_UNIT.values() or unit for unit in pair}) > 1:
            rest = f" is in {pair[0]}, but the torque in {pair[1]}: give both in one unit."
            yield file.fault(("record", "channels", "injected"), rest, "unit")


def _unit_faults(file: FileTable, name: str, table: ChannelTable, kinds: Collection[Kind]) -> Iterator[Fault]:
    """Yield an impossible unit of a channel, or one that needs a missing number of the drive."""
    place = ("record", "channels", name)
    moving = [_kind_of(file, name, kind) for kind in kinds]
    known = tuple(dict.fromkeys(unit for kind in moving for unit in known_units(name, kind)))
    stated = table.build().stated_unit(known)
    if stated is None:
        return
    if named := table.build().doubled_unit(known):
        yield file.fault(
            (*place, "unit"),
            f' is "{table.unit}", but its column "{table.column}" names the unit "{named}"; '
            "expected one of them: leave unit out, or rename the column.",
        )
    if stated not in known:
        key, says = ("unit", "is") if table.unit is not None else ("column", "names the unit")
        yield file.fault((*place, key), f' {says} "{stated}"{_misfit(stated, known)}', "unit")
    elif file.drive_of_joint is not None and len(set(moving)) == 1:
        lack = _lacking(file, name, stated, moving[0])
        yield from () if lack is None else (file.fault(place, f' is in "{stated}", {lack}.', "unit"),)


def torque_unit(file: FileTable, kind: Kind) -> str | None:
    """Return "A" or "V" for a torque in the drive's own units, None for one in N or N m."""
    unit = _si_unit(file, "torque", kind)
    return None if unit in TORQUE_UNIT.values() else unit


def _si_unit(file: FileTable, channel: str, kind: Kind) -> str | None:
    """Return the unit in which a channel is logged, made SI; None if it cannot be."""
    table, moving = file.channels.get(channel), _kind_of(file, channel, kind)
    known = known_units(channel, moving)
    stated = table.build().stated_unit(known) if table else None
    if stated is None and channel == "injected":
        torque = _si_unit(file, "torque", kind)
        return torque if torque is None or torque in known else known[0]
    if stated is None:
        return known[0]
    if stated not in known or _lacking(file, channel, stated, moving):
        return None
    return (file.drive_of_joint or Drive()).resolve_unit(units.unit(stated), moving).si


def _kind_of(file: FileTable, channel: str, kind: Kind) -> Kind:
    """Return the kind of motion of a channel's side; with a lead the motor turns."""
    table = file.channels.get(channel)
    side = (file.drive_of_joint or Drive()).side(channel, None if table is None else table.build())
    return file.kind_of_side(side, kind)


def _lacking(file: FileTable, channel: str, unit: str, kind: Kind) -> str | None:
    """Return the end of the sentence on a unit for which a number of the drive is missing."""
    geared = file.transmission is not None and file.transmission.geared
    try:
        (file.drive_of_joint or Drive()).resolve_unit(
            units.unit(unit), kind, of_load=channel == "load_position", geared=geared
        )
    except units.UnitError as error:
        return str(error)
    return None


def _misfit(unit: str, known: Collection[str]) -> str:
    """Return the end of the sentence on a unit that a channel cannot have."""
    expected = f"expected one of {', '.join(known)}"
    try:
        dimension = units.unit(unit).dimension
    except units.UnitError:
        otherwise = "give one of them, and the gain that takes the column to it"
        return f", which is not known; {expected}: {messages.suggest(unit, known, otherwise)}"
    return f", a unit of {dimension}; {expected}: give one of them."


def _limit_faults(file: FileTable) -> Iterator[Fault]:
    """Yield limits in impossible units, and a limit on the spring of a rigid joint."""
    if file.is_wrong("joint") or file.is_wrong("transmission"):
        return
    gear, kind = file.transmission, file.joint.kind
    moving = kind if gear is None else file.kind_of_side(gear.side, kind)
    torque = torque_unit(file, kind) or TORQUE_UNIT[moving]
    for one in settings_of(AxisLimits):
        number = getattr(file.limits, one.name)
        declared = torque if "torque" in one.name else one.setting.unit
        if isinstance(number, Stated) and (fault := misfit(number.text, declared, moving)):
            yield file.fault(("limits", one.name), fault, "unit")
    if file.model == "rigid" and file.limits.windup is not None:
        yield file.fault(("limits", "windup"), " is that of a spring, and a rigid joint has none: leave it out.")


def _transmission_faults(file: FileTable) -> Iterator[Fault]:
    """Yield a lead of a revolute load, and sides without a transmission."""
    transmission = file.transmission
    if transmission is not None and transmission.lead is not None and "prismatic" not in file.kinds:
        yield file.fault(
            ("transmission", "lead"),
            f" is {transmission.lead:g}, but the load is revolute; expected a ratio: give that.",
        )
    if file.geared:
        return
    named: dict[Place, str] = {("record", "channels", n): one.side for n, one in file.channels.items() if one.side}
    if file.controller and "side" in file.controller.given:
        named[("controller",)] = file.controller.side
    for place, side in named.items():
        rest = f' is "{side}", but nothing lies between motor and load: add a transmission, or leave it out.'
        yield file.fault((*place, "side"), rest)
