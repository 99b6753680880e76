"""Rules between the tables of a joint file: each yields what contradicts it, with its place."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial

from jointid.common import messages, units
from jointid.common.errors import Fault
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.text import join
from jointid.common.units import Kind
from jointid.config.quantities import Stated, misfit
from jointid.config.schema import KINDS, FileTable, MethodTable, ParameterTable, keys_of
from jointid.config.table import Place, refusal
from jointid.estimation.methods.registry import CALLED, METHODS, MODELS, ROBOT, method_of, methods
from jointid.estimation.problems.base import surrounding
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.limits import AxisLimits
from jointid.records.columns import known_units
from jointid.records.drives import Drive

_NEXT_TO_ZERO = 1e-200  # a bound that only excludes 0


def choose_method(file: FileTable, name: str | None, model: str) -> str | None:
    """Return the method: the one named, or the first whose needs are met, or None.

    DIDIM comes first, even where there is a motor position, which it does not read.

    Args:
        file: whose channels and controller there are.
        name: of the method, if the file names one.
        model: of the joint; IDIM of a flexible one needs the load's position too.
    """
    return name or next((one for one in _defaults() if not _lacking_places(file, one, model, None)), None)


def needed_channels(method: str, controller: Controller | None, model: str) -> tuple[str, ...]:
    """Return the names of the channels that a method reads; of a controller not known, only the reference."""
    return method_of(method).channels(model, controller)


def _defaults() -> tuple[str, ...]:
    """Return the names of the methods that a joint file need not name, the first choice first."""
    found = (method.name for method in methods() if method.default_for in (ClosedLoop, Joint))
    return tuple(dict.fromkeys(found))


def _law(file: FileTable) -> Controller | None:
    return None if file.controller is None else file.controller.controller()


def _lacking_places(file: FileTable, method: str, model: str, law: Controller | None) -> list[Place]:
    """Return the places of what a method needs and the file lacks."""
    missing: list[Place] = [
        ("record", "channels", name) for name in needed_channels(method, law, model) if name not in file.channel_names
    ]
    return [*missing, ("controller",)] if method_of(method).needs_controller and not file.controlled else missing


def _drive_faults(file: FileTable) -> Iterator[Fault]:
    """Yield the reason why the drive refuses its torque constant."""
    if not file.is_wrong("drive") and (refused := refusal(lambda: file.joint.drive(file.drive.build()))):
        yield file.fault(("drive",), refused)


def _force_faults(file: FileTable) -> Iterator[Fault]:
    """Yield gravity or ripple with the reason why the joint refuses it."""
    if file.is_wrong("joint"):
        return
    if refused := refusal(lambda: file.joint.joint(None, gravity=file.gravity)):
        yield file.fault(("gravity",), refused, "refused")
    elif refused := refusal(lambda: file.joint.joint(None, gravity=file.gravity, ripple=file.ripple)):
        yield file.fault(("ripple",), refused, "refused")


def _transmission_faults(file: FileTable) -> Iterator[Fault]:
    """Yield a lead of a revolute load, and sides without a transmission."""
    gear = file.transmission
    if gear is not None and gear.lead is not None and "prismatic" not in file.kinds:
        rest = f" is {gear.lead:g}, but the load is revolute; expected a ratio: give that."
        yield file.fault(("transmission", "lead"), rest)
    if file.geared:
        return
    named: dict[Place, str] = {("record", "channels", n): one.side for n, one in file.channels.items() if one.side}
    if file.controller and "side" in file.controller.given:
        named[("controller",)] = file.controller.side
    for place, side in named.items():
        rest = f' is "{side}", but nothing lies between motor and load: add a transmission, or leave it out.'
        yield file.fault((*place, "side"), rest)


def _channel_faults(file: FileTable) -> Iterator[Fault]:
    """Yield missing columns, misplaced settings and impossible units of the channels."""
    # Behind a transmission that is not right, a motor may move in any way.
    kinds = KINDS if file.is_wrong("transmission") else file.kinds
    drive = file.drive_of_joint
    for name, table in file.channels.items():
        place = ("record", "channels", name)
        if not table.column and drive is not None and drive.traces is None:
            rest = " is missing; expected text in quotes (name of the column in the record's file): add it, or give "
            yield file.fault((*place, "column"), f"{rest}drive.profile.", "missing")
        for fault in table.build().misplaced_faults(name):
            yield file.fault(place, fault.removeprefix(name))
        yield from _unit_faults(file, name, kinds)
    if "injected" in file.channels:
        pairs = {(_si_unit(file, "injected", kind), _si_unit(file, "torque", kind)) for kind in kinds}
        pair = pairs.pop() if len(pairs) == 1 else (None, None)
        # A force on one side of a screw and a torque on the other are both in SI.
        if None not in pair and len({unit in TORQUE_UNIT.values() or unit for unit in pair}) > 1:
            rest = f" is in {pair[0]}, but the torque in {pair[1]}: give both in one unit."
            yield file.fault(("record", "channels", "injected"), rest, "unit")


def _unit_faults(file: FileTable, name: str, kinds: Collection[Kind]) -> Iterator[Fault]:
    """Yield an impossible unit of a channel, or one that needs a missing number of the drive."""
    place, table = ("record", "channels", name), file.channels[name]
    moving = [_kind_of(file, name, kind) for kind in kinds]
    known = tuple(dict.fromkeys(unit for kind in moving for unit in known_units(name, kind)))
    stated = table.build().stated_unit(known)
    if stated is None:
        return
    if named := table.build().doubled_unit(known):
        rest = f' is "{table.unit}", but its column "{table.column}" names the unit "{named}"; expected one of them: '
        yield file.fault((*place, "unit"), f"{rest}leave unit out, or rename the column.")
    if stated not in known:
        remedy = messages.suggest(stated, known, "give one of them, and the gain that takes the column to it")
        rest = f' is in "{stated}"; expected one of {", ".join(known)}: {remedy}'
        yield file.fault((*place, "unit" if table.unit is not None else "column"), rest, "unit")
    elif file.drive_of_joint is not None and len(set(moving)) == 1:
        lack = _lacking_number(file, name, stated, moving[0])
        yield from () if lack is None else (file.fault(place, f' is in "{stated}", {lack}.', "unit"),)


def _torque_faults(file: FileTable) -> Iterator[Fault]:
    """Yield the contradictions to a torque from the controller."""
    if not file.computes_torque:
        return
    if "torque" in file.channels:
        yield file.fault(("record", "torque"), ' is "from_controller" beside a torque channel; keep one of them.')
    law = _law(file)
    channels = ("motor_position", *(("reference",) if law is None else law.channels))
    places: list[Place] = [("record", "channels", name) for name in channels if name not in file.channel_names]
    for place in [*places, *([] if file.controlled else [("controller",)])]:
        yield file.fault(place, ' is missing, but record.torque = "from_controller" needs it: add it.', "missing")


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
    if stated not in known or _lacking_number(file, channel, stated, moving):
        return None
    return (file.drive_of_joint or Drive()).resolve_unit(units.unit(stated), moving).si


def _kind_of(file: FileTable, channel: str, kind: Kind) -> Kind:
    """Return the kind of motion of a channel's side; with a lead the motor turns."""
    table = file.channels.get(channel)
    side = (file.drive_of_joint or Drive()).side(channel, None if table is None else table.build())
    return file.kind_of_side(side, kind)


def _lacking_number(file: FileTable, channel: str, unit: str, kind: Kind) -> str | None:
    """Return the end of the sentence on a unit for which a number of the drive is missing."""
    drive, of_load = file.drive_of_joint or Drive(), channel == "load_position"
    geared = file.transmission is not None and file.transmission.geared
    try:
        drive.resolve_unit(units.unit(unit), kind, of_load=of_load, geared=geared)
    except units.UnitError as error:
        return str(error)
    return None


def _method_faults(file: FileTable) -> Iterator[Fault]:
    """Yield missing channels of the method, and settings of other methods."""
    if file.is_wrong("method"):
        return
    table, model, law = file.method, file.model or "rigid", _law(file)  # whose channels every model needs
    name = choose_method(file, table.name, model)
    if name is None:
        needs = " and ".join(f"{method_of(one).describe(model)} needs {_needs(one, model)}" for one in _defaults())
        rest = f" is missing, and no method can be chosen: {needs}; add what one of them lacks."
        yield file.fault(("method", "name"), rest, "missing")
    else:
        lacking = _lacking_places(file, name, model, law)
        other = next(default for default in _defaults() if default != name)
        for place in lacking:
            rest = f" is missing, but {method_of(name).describe(model)} needs it: add it, or use method.name = "
            yield file.fault(place, f'{rest}"{other}", which needs only {_needs(other, model)}.', "missing")
        if "estimator" in keys_of(method_of(name), model) and table.estimator == "iv":
            rest = ' is missing, but method.estimator = "iv" simulates the loop: add it, or use another.'
            for place in _lacking_places(file, "didim", model, law):
                yield from () if place in lacking else (file.fault(place, rest, "missing"),)
    for key, sentence in foreign_settings(table, name, file.model):
        yield file.fault(("method", key), sentence)
    yield from _free_faults(("method", "free"), table.free, file)


def _systems_of(name: str, key: str) -> tuple[str, ...]:
    """Return the models of a joint, and "robot", that a key of a method is for."""
    return tuple(system for system in (*MODELS, *ROBOT) if key in keys_of(method_of(name), system))


def _needs(method: str, model: str) -> str:
    made = method_of(method)
    return join([*made.channels(model), *(["controller"] if made.needs_controller else [])])


def foreign_settings(table: MethodTable, name: str | None, system: str | None) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on settings of another system or method.

    Args:
        table: [method].
        name: of the method, if the file names one.
        system: "rigid" or "flexible" for a joint, "robot"; None where that is not known.
    """
    if system in ROBOT and name is not None and system not in method_of(name).systems:
        yield "name", messages.no_choice(name, [one.name for one in methods() if system in one.systems])
        return
    for key in table.settings("name"):
        owners = [owner for owner in METHODS if _systems_of(owner, key)]
        systems = _systems_of(name if name in owners else owners[0], key)
        if name is not None and name not in owners:
            yield key, f' is not for the method "{name}": leave it out, or use method.name = {messages.either(owners)}.'
        elif system is not None and system not in systems:
            yield key, f" is for {CALLED[systems[0]]}, and this is {CALLED[system]}: leave it out."


def _free_faults(place: Place, names: Collection[str], file: FileTable) -> Iterator[Fault]:
    """Yield names that cannot be identified beside the joint: unknown ones, or those of other controllers."""
    controller = _law(file)
    for name in names:
        if controller is not None and (refused := refusal(partial(surrounding, name, controller))):
            yield file.fault(place, refused, "refused")


def _known_parameters(file: FileTable) -> dict[str, Parameter] | None:
    """Return the joint's parameters by their names; None if one of its tables is wrong."""
    if any(map(file.is_wrong, ("joint", "gravity", "ripple"))) or any(_force_faults(file)):
        return None
    joint = file.joint.joint(None, gravity=file.gravity, ripple=file.ripple)
    return {parameter.name: parameter for parameter in joint.parameters}


def _parameter_faults(file: FileTable) -> Iterator[Fault]:
    """Yield unknown parameters and impossible values."""
    known = _known_parameters(file)
    for name, table in file.parameters.items() if known is not None else ():
        place = ("parameters", name)
        if known is None or name not in known:
            remedy = messages.suggest(name, known or (), "leave it out, or declare the law that has it")
            rest = f" is no parameter of this joint; expected one of {', '.join(known or ())}: {remedy}"
            yield file.fault(place, rest, "unknown")
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
        yield "", " is not identified in this joint, beside friction and load as declared; give it a value."
        return
    lower, upper = _bounds(parameter, table)
    least = 0.0 if 0.0 < lower < _NEXT_TO_ZERO else lower
    if not lower < upper:
        key = "lower" if table.upper is None else "upper"
        yield key, f" leaves no room between {least:g} and {upper:g}: correct the bounds."
        return
    for key in ("value", "start"):
        number = getattr(table, key)
        if number is not None and not lower <= number <= upper:
            expected = f"a number from {least:g} to {upper:g}" if least == lower or upper < math.inf else "more than 0"
            yield key, f" is {number:g}; expected {expected}: correct it, or its bounds."


def _record_faults(file: FileTable) -> Iterator[Fault]:
    """Yield unknown parameters and impossible controller numbers of the records."""
    known, controller = _known_parameters(file), _law(file)
    for number, run in enumerate(file.records):
        place = ("records", number)
        for name in () if known is None else set(run.own) - known.keys():
            remedy = messages.suggest(name, known or (), "leave it out")
            rest = f' names "{name}", no parameter of this model; expected some of {", ".join(known or ())}: {remedy}'
            yield file.fault((*place, "own"), rest, "unknown")
        if run.controller and not file.controlled:
            rest = " changes a controller that the file does not have: add [controller]."
            yield file.fault((*place, "controller"), rest)
        elif controller is not None:
            numbers = (*numbers_of(controller), "period")
            unknown = [name for name in run.controller if name not in numbers]
            if unknown:
                rest = f".{messages.dot_path(unknown[:1])}{messages.describe_unknown_name(unknown[0], numbers)}"
                yield file.fault((*place, "controller"), rest)
            elif refused := refusal(partial(with_numbers, controller, run.controller)):
                yield file.fault((*place, "controller"), refused)
    yield from _free_faults(("together", "free"), file.together.free, file)


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


RULES: tuple[Callable[[FileTable], Iterator[Fault]], ...] = (
    _drive_faults,
    _force_faults,
    _transmission_faults,
    _channel_faults,
    _torque_faults,
    _method_faults,
    _parameter_faults,
    _record_faults,
    _limit_faults,
)
"""What the tables of a joint file have to agree on."""


def find_contradictions(file: FileTable) -> Iterator[Fault]:
    """Yield contradictions between the tables of a joint file."""
    for rule in RULES:
        yield from rule(file)
