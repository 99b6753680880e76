"""Rules between the tables of a file: rules of one axis, each of which yields faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from jointid.common import messages, units
from jointid.common.errors import Fault, JointFileError, JointidError
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.text import join
from jointid.common.transmission import Transmission
from jointid.common.units import Kind
from jointid.config.declaration import (
    CONTRADICTION,
    EFFECTS,
    AxisTable,
    FileTable,
    ParameterTable,
    Place,
    fault_at,
    has_effects,
    refusal,
)
from jointid.config.quantities import misfit
from jointid.estimation.methods.registry import CALLED, METHODS, MODELS, ROBOT, Method, method_of, methods
from jointid.estimation.problems.base import surrounding
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.friction import find_friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.limits import AxisLimits
from jointid.models.springs import find_spring
from jointid.records.columns import Column, known_units
from jointid.records.drives import Drive
from jointid.records.record import InjectionPoint

_NEXT_TO_ZERO = 1e-200  # a bound that only excludes 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """Tables of one axis, with those that all axes share.

    Attributes:
        raw: the tables of a joint file that say the same, as they are written.
        kind: how the joint moves.
        columns: the channels of the axis.
        drive: with the torque constant.
        gear: the transmission.
        method: the keys of [method].
        number: of the axis of a robot file, from 0; None of a joint file.
        own: channels, and "method", that stand below its [[joints]] table and are not shared.
    """

    file: FileTable
    axis: AxisTable
    raw: Mapping[str, Any]
    kind: Kind
    columns: Mapping[str, Column]
    drive: Drive
    gear: Transmission | None
    method: Mapping[str, Any]
    number: int | None = None
    own: Collection[str] = ()

    def place(self, *keys: int | str) -> Place:
        """Return the place in the file of a key, as a joint file has it."""
        if self.number is None:
            return keys
        below = ("joints", self.number)
        match keys:
            case ("joint", *rest):
                return (*below, *rest)
            case ("record", "channels", str() as name, *rest) if name in self.own:
                return (*below, "channels", name, *rest)
            case ("record" | "drive" | "filtering", *_):
                return keys
            case ("method", *_) if "method" not in self.own:
                return keys
        return (*below, *keys)

    def fault(self, place: Place, rest: str, code: str = CONTRADICTION) -> Fault:
        """Return a fault at a place of a joint file, in the file that this was read from."""
        return fault_at(self.place(*place), rest, code)

    @property
    def model(self) -> str:
        """The joint's model, "rigid" or "flexible"."""
        return str(self.axis.model)

    @property
    def law(self) -> Controller | None:
        """The controller on its own side."""
        return self.axis.controller

    @property
    def law_side(self) -> str:
        """The side of the controller's numbers."""
        return str(self.raw.get("controller", {}).get("side", "motor"))

    def kind_of(self, side: str) -> Kind:
        """Return the kind of motion of a side."""
        return self.kind if self.gear is None or side == "load" else self.gear.motor

    def side_of(self, channel: str) -> Kind:
        """Return the kind of motion of a channel's side."""
        return self.kind_of(self.drive.side(channel, self.columns.get(channel)))

    @property
    def computes_torque(self) -> bool:
        """Whether the torque is computed from the controller and the motor position."""
        named = self.file.source.torque
        if named is not None or "torque" in self.columns or self.drive.traces is not None:
            return named == "from_controller"
        known = self.law is not None and "motor_position" in self.columns
        return known and self.method.get("name") in (None, "didim")

    @property
    def channel_names(self) -> Collection[str]:
        """Names of all channels of the file, and of those that the drive's profile may find."""
        computed = ["torque"] if self.computes_torque else []
        found = [*self.columns, *(self.drive.traces.channels if self.drive.traces else ()), *computed]
        return tuple(dict.fromkeys(found))

    def joint(self) -> Joint:
        """Return the joint, its torque in A or V where the torque's channel is.

        Raises:
            JointFileError: spring, friction, gravity and ripple do not go together.
        """
        own = self.axis
        if self.model == "rigid" and own.spring not in (None, "linear"):
            rest = f' is "{own.spring}", but a rigid joint has no spring; set joint.model = "flexible".'
            raise JointFileError(self.fault(("joint", "spring"), rest))
        friction = find_friction(own.friction)
        weight = own.gravity
        if weight is not None and self.gear is not None:
            weight = replace(weight, angle=weight.angle * self.gear.torque("load"))
        kind = self.kind if self.gear is None else self.gear.kind
        spring = find_spring(own.spring or "linear")

        common, flexible = (kind, friction, torque_unit(self), self.gear), self.model == "flexible"
        for place, forces, code in (
            (("joint", "friction"), (None, None), CONTRADICTION),
            (("gravity",), (weight, None), "refused"),
            (("ripple",), (weight, own.ripple), "refused"),
        ):
            try:
                joint = FlexibleJoint(*common, *forces, spring) if flexible else RigidJoint(*common, *forces)
            except JointidError as error:
                raise JointFileError(self.fault(place, f": {error}", code)) from error
        return joint


def method_keys(method: type[Method], system: str) -> tuple[str, ...]:
    """Return the keys of [method] for a method and a "rigid" or "flexible" joint or a "robot", without the name."""
    if system not in method.systems:
        return ()
    own = settings_of(method)
    settings = tuple(one.name for one in own if not one.setting.systems or system in one.setting.systems)
    if system in ROBOT:
        return settings
    return (*settings, *(EFFECTS if has_effects(method) else ()))


def choose_method(said: Declaration) -> str | None:
    """Return the method: the one named, or the first whose needs are met, or None.

    DIDIM comes first, even where there is a motor position, which it does not read.
    """
    name: str | None = said.method.get("name")
    return name or next((one for one in _defaults() if not _lacking_places(said, one, None)), None)


def _defaults() -> tuple[str, ...]:
    """Return the names of the methods that a joint file need not name, the first choice first."""
    found = (method.name for method in methods() if method.default_for in (ClosedLoop, Joint))
    return tuple(dict.fromkeys(found))


def _lacking_places(said: Declaration, method: str, law: Controller | None) -> list[Place]:
    """Return the places of what a method needs and the file lacks."""
    made = method_of(method)
    missing: list[Place] = [
        ("record", "channels", name) for name in made.channels(said.model, law) if name not in said.channel_names
    ]
    return [*missing, ("controller",)] if made.needs_controller and said.law is None else missing


def _side_faults(said: Declaration) -> Iterator[Fault]:
    """Yield sides without a transmission."""
    if said.gear is not None:
        return
    named: dict[Place, str] = {("record", "channels", n): one.side for n, one in said.columns.items() if one.side}
    if "side" in said.raw.get("controller", {}):
        named[("controller",)] = said.law_side
    for place, side in named.items():
        rest = f' is "{side}", but nothing lies between motor and load: add a transmission, or leave it out.'
        yield said.fault((*place, "side"), rest)


def _channel_faults(said: Declaration) -> Iterator[Fault]:
    """Yield missing columns, misplaced settings and impossible units of the channels."""
    for name, column in said.columns.items():
        place = ("record", "channels", name)
        if not column.column and said.drive.traces is None:
            rest = " is missing; expected text in quotes (name of the column in the record's file): add it, or give "
            yield said.fault((*place, "column"), f"{rest}drive.profile.", "missing")
        for fault in column.misplaced_faults(name):
            yield said.fault(place, fault.removeprefix(name))
        yield from _unit_faults(said, name, column)
    injected = said.columns.get("injected")
    if injected is None:
        return
    if injected.at == InjectionPoint.BEFORE_LIMIT and not injected.in_torque:
        rest = " is false, but a signal injected before the limit is in the controller's output: leave it out."
        yield said.fault(("record", "channels", "injected", "in_torque"), rest)
    pair = [_si_unit(said, name) for name in ("injected", "torque")]
    # A force on one side of a screw and a torque on the other are both in SI.
    if None not in pair and len({unit in TORQUE_UNIT.values() or unit for unit in pair}) > 1:
        rest = f" is in {pair[0]}, but the torque in {pair[1]}: give both in one unit."
        yield said.fault(("record", "channels", "injected"), rest, "unit")


def _unit_faults(said: Declaration, name: str, column: Column) -> Iterator[Fault]:
    """Yield an impossible unit of a channel, or one that needs a missing number of the drive."""
    place, moving = ("record", "channels", name), said.side_of(name)
    known = known_units(name, moving)
    stated = column.stated_unit(known)
    if stated is None:
        return
    if named := column.doubled_unit(known):
        rest = f' is "{column.unit}", but its column "{column.column}" names the unit "{named}"; expected one of them: '
        yield said.fault((*place, "unit"), f"{rest}leave unit out, or rename the column.")
    if stated not in known:
        remedy = messages.suggest(stated, known, "give one of them, and the gain that takes the column to it")
        rest = f' is in "{stated}"; expected one of {", ".join(known)}: {remedy}'
        yield said.fault((*place, "unit" if column.unit is not None else "column"), rest, "unit")
    elif lack := _lacking_number(said, name, stated):
        yield said.fault(place, f' is in "{stated}", {lack}.', "unit")


def _torque_faults(said: Declaration) -> Iterator[Fault]:
    """Yield the contradictions to a torque from the controller."""
    if not said.computes_torque:
        return
    if "torque" in said.columns:
        yield said.fault(("record", "torque"), ' is "from_controller" beside a torque channel; keep one of them.')
    channels = ("motor_position", *(("reference",) if said.law is None else said.law.channels))
    places: list[Place] = [("record", "channels", name) for name in channels if name not in said.channel_names]
    for place in [*places, *([] if said.law is not None else [("controller",)])]:
        yield said.fault(place, ' is missing, but record.torque = "from_controller" needs it: add it.', "missing")


def torque_unit(said: Declaration) -> str | None:
    """Return "A" or "V" for a torque in the drive's own units, None for one in N or N m."""
    unit = _si_unit(said, "torque")
    return None if unit in TORQUE_UNIT.values() else unit


def _si_unit(said: Declaration, channel: str) -> str | None:
    """Return the unit in which a channel is logged, made SI; None if it cannot be."""
    column, moving = said.columns.get(channel), said.side_of(channel)
    known = known_units(channel, moving)
    stated = None if column is None else column.stated_unit(known)
    if stated is None and channel == "injected":
        torque = _si_unit(said, "torque")
        return torque if torque is None or torque in known else known[0]
    if stated is None:
        return known[0]
    if stated not in known or _lacking_number(said, channel, stated):
        return None
    return said.drive.resolve_unit(units.unit(stated), moving).si


def _lacking_number(said: Declaration, channel: str, unit: str) -> str | None:
    """Return the end of the sentence on a unit for which a number of the drive is missing."""
    of_load, geared = channel == "load_position", said.gear is not None and said.gear.geared
    try:
        said.drive.resolve_unit(units.unit(unit), said.side_of(channel), of_load=of_load, geared=geared)
    except units.UnitError as error:
        return str(error)
    return None


def _method_faults(said: Declaration) -> Iterator[Fault]:
    """Yield missing channels of the method, and settings of other methods."""
    name, model, law = choose_method(said), said.model, said.law
    if name is None:
        needs = " and ".join(f"{method_of(one).describe(model)} needs {_needs(one, model)}" for one in _defaults())
        rest = f" is missing, and no method can be chosen: {needs}; add what one of them lacks."
        yield said.fault(("method", "name"), rest, "missing")
    else:
        lacking = dict.fromkeys(_lacking_places(said, name, law), method_of(name).describe(model))
        if said.method.get("estimator") == "iv":
            lacking = dict.fromkeys(_lacking_places(said, "didim", law), 'method.estimator = "iv"') | lacking
        other = next(default for default in _defaults() if default != name)
        for place, needing in lacking.items():
            rest = f" is missing, but {needing} needs it: add it, or use method.name = "
            yield said.fault(place, f'{rest}"{other}", which needs only {_needs(other, model)}.', "missing")
    for key, sentence in foreign_settings(said.method, name, model):
        yield said.fault(("method", key), sentence)
    yield from _free_faults(("method", "free"), said.method.get("free", ()), said)


def _needs(method: str, model: str) -> str:
    made = method_of(method)
    return join([*made.channels(model), *(["controller"] if made.needs_controller else [])])


def foreign_settings(given: Mapping[str, Any], name: str | None, system: str) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on settings of another system or method.

    Args:
        given: keys of [method].
        name: of the method, if there is one.
        system: "rigid" or "flexible" for a joint, "robot".
    """
    if system in ROBOT and name is not None and system not in method_of(name).systems:
        yield "name", messages.no_choice(name, [one.name for one in methods() if system in one.systems])
        return
    for key in given.keys() - {"name"}:
        owners = [one for one in METHODS if any(key in method_keys(method_of(one), each) for each in (*MODELS, *ROBOT))]
        if name is not None and name not in owners:
            yield key, f' is not for the method "{name}": leave it out, or use method.name = {messages.either(owners)}.'
        elif not any(key in method_keys(method_of(one), system) for one in ([name] if name else owners)):
            yield key, f" is not for {CALLED[system]}: leave it out."


def _free_faults(place: Place, names: Collection[str], said: Declaration) -> Iterator[Fault]:
    """Yield names that cannot be identified beside the joint: unknown ones, or those of other controllers."""
    law = said.law
    for name in names if law is not None else ():
        if law is not None and (refused := refusal(partial(surrounding, name, law))):
            yield said.fault(place, refused, "refused")


def _parameter_faults(said: Declaration) -> Iterator[Fault]:
    """Yield unknown parameters and impossible values."""
    known = {parameter.name: parameter for parameter in said.joint().parameters}
    for name, stated in said.axis.parameters.items():
        place = ("parameters", name)
        if name not in known:
            remedy = messages.suggest(name, known, "leave it out, or declare the law that has it")
            rest = f" is no parameter of this joint; expected one of {', '.join(known)}: {remedy}"
            yield said.fault(place, rest, "unknown")
            continue
        is_table = isinstance(said.raw["parameters"][name], dict)
        for key, rest in _value_faults(known[name], stated):
            yield said.fault((*place, key) if key and is_table else place, rest)


def change_parameter(parameter: Parameter, stated: ParameterTable) -> Parameter:
    """Return a parameter of the model with the file's value and the tighter bounds."""
    lower, upper = _bounds(parameter, stated)
    free = stated.value is None and (parameter.free if stated.free is None else stated.free)
    start = next((given for given in (stated.value, stated.start, parameter.start) if given is not None), None)
    return replace(parameter, free=free, start=start, lower=lower, upper=upper)


def _bounds(parameter: Parameter, stated: ParameterTable) -> tuple[float, float]:
    lower = parameter.lower if stated.lower is None else max(stated.lower, parameter.lower)
    upper = parameter.upper if stated.upper is None else min(stated.upper, parameter.upper)
    return lower, upper


def _value_faults(parameter: Parameter, stated: ParameterTable) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on impossible values of a parameter."""
    if not parameter.free and stated.value is None:
        yield "", " is not identified in this joint, beside friction and load as declared; give it a value."
        return
    lower, upper = _bounds(parameter, stated)
    least = 0.0 if 0.0 < lower < _NEXT_TO_ZERO else lower
    if not lower < upper:
        key = "lower" if stated.upper is None else "upper"
        yield key, f" leaves no room between {least:g} and {upper:g}: correct the bounds."
        return
    for key, number in (("value", stated.value), ("start", stated.start)):
        if number is not None and not lower <= number <= upper:
            expected = f"a number from {least:g} to {upper:g}" if least == lower or upper < math.inf else "more than 0"
            yield key, f" is {number:g}; expected {expected}: correct it, or its bounds."


def _record_faults(said: Declaration) -> Iterator[Fault]:
    """Yield unknown parameters and impossible controller numbers of the records."""
    known = [parameter.name for parameter in said.joint().parameters]
    for number, run in enumerate(said.file.records if said.number is None else ()):
        place = ("records", number)
        for name in set(run.own) - {*known}:
            remedy = messages.suggest(name, known, "leave it out")
            rest = f' names "{name}", no parameter of this model; expected some of {", ".join(known)}: {remedy}'
            yield said.fault((*place, "own"), rest, "unknown")
        law = said.law
        if run.controller and law is None:
            rest = " changes a controller that the file does not have: add [controller]."
            yield said.fault((*place, "controller"), rest)
        elif law is not None and (unknown := run.controller.keys() - (numbers := {*numbers_of(law), "period"})):
            rest = f" has {join(sorted(unknown))}; expected some of {join(sorted(numbers))}."
            yield said.fault((*place, "controller"), rest)
        elif law is not None and (refused := refusal(partial(with_numbers, law, run.controller))):
            yield said.fault((*place, "controller"), refused)
    yield from _free_faults(("together", "free"), said.file.together.free, said)


def _limit_faults(said: Declaration) -> Iterator[Fault]:
    """Yield limits in impossible units, and a limit on the spring of a rigid joint."""
    moving = said.kind if said.gear is None else said.gear.kind
    torque = torque_unit(said) or TORQUE_UNIT[moving]
    for one in settings_of(AxisLimits):
        text = said.raw.get("limits", {}).get(one.name)
        declared = torque if "torque" in one.name else one.setting.unit
        if isinstance(text, str) and (fault := misfit(text, declared, moving)):
            yield said.fault(("limits", one.name), fault, "unit")
    if said.model == "rigid" and said.axis.limits.windup is not None:
        yield said.fault(("limits", "windup"), " is that of a spring, and a rigid joint has none: leave it out.")


RULES: tuple[Callable[[Declaration], Iterator[Fault]], ...] = (
    _side_faults,
    _channel_faults,
    _torque_faults,
    _method_faults,
    _parameter_faults,
    _record_faults,
    _limit_faults,
)
"""What the tables of a file have to agree on."""
