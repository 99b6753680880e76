"""How the tables of a joint file fit together: units to the joint, channels to the method, parameters to the model.

Each part has the function that says what is at fault and the one that makes use of what is not.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from jointid.common import messages, units
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.units import Kind
from jointid.config.draft import KINDS, Draft, table_at
from jointid.config.quantities import Stated, misfit
from jointid.config.schema import GravityTable, JointTable, MethodTable, ParameterTable, keys_of
from jointid.config.schema_record import ChannelTable
from jointid.config.table import refusal
from jointid.estimation.methods.registry import METHODS, MODELS, method_of, methods
from jointid.estimation.problems.base import surrounding
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.friction import FRICTIONS
from jointid.models.gravity import GRAVITY_PARAMETERS
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.springs import SPRINGS, LinearSpring
from jointid.planning.limits import AxisLimits
from jointid.records.columns import known_units
from jointid.records.drives import Drive

_NEXT_TO_ZERO = 1e-200
_BESIDE_LOAD = (
    " cannot be identified beside a constant load: torque and motor position only know the sum of both; give it a "
    "value, or leave [gravity] out."
)
_KNOWN = " is known, and not identified; give it a value, or change it in gravity.counterbalance."
_BESIDE_FRICTION = (
    " cannot be identified beside {} friction: a constant adds to the Coulomb force forwards and takes as much "
    'from it backwards, so the two cannot be told apart; give it a value, or set joint.friction = "symmetric".'
)


def choose_method(draft: Draft, name: str | None, model: str) -> str | None:
    """Return the method: the one named, or the first whose needs are met, or None.

    DIDIM comes first, even where there is a motor position, which it does not read.

    Args:
        draft: whose channels and controller there are.
        name: of the method, if the file names one.
        model: of the joint; IDIM of a flexible one needs the load's position too.
    """
    if name is not None:
        return name
    for default in _defaults():
        method = method_of(default, model)
        if (draft.controlled or not method.needs_controller) and set(method.channels(model)) <= set(draft.named):
            return default
    return None


def named_method(raw: Mapping[str, Any]) -> str | None:
    """Return the method that a joint file names, or that it has where it names none; None if that is not known."""
    draft = Draft.of(raw)
    return choose_method(draft, table_at(raw, "method").get("name"), draft.model or "rigid")


def needed_channels(method: str, controller: Controller | None, model: str) -> tuple[str, ...]:
    """Return the names of the channels that a method reads; of a controller not known, only the reference."""
    return method_of(method, model).channels(model, controller)


def _defaults() -> tuple[str, ...]:
    """Return the names of the methods that a joint file need not name, the first choice first."""
    found = (method.name for method in methods() if method.default_for in (ClosedLoop, Joint))
    return tuple(dict.fromkeys(found))


def method_faults(draft: Draft, table: MethodTable) -> Iterator[str]:
    """Yield what the method lacks, and settings that are not its own."""
    of_model = draft.model or "rigid"  # whose channels every model needs

    def lacking(method: str) -> list[str]:
        needed = needed_channels(method, draft.controller, of_model)
        missing = [f"record.channels.{name}" for name in needed if name not in draft.named]
        uncontrolled = method_of(method, of_model).needs_controller and not draft.controlled
        return [*missing, "controller"] if uncontrolled else missing

    name = choose_method(draft, table.name, of_model)
    if name is None:
        yield _no_method({method: lacking(method) for method in _defaults()}, draft, of_model)
    else:
        other = next(default for default in _defaults() if default != name)
        if of_model not in method_of(name, of_model).models:
            remedy = f'use method.name = "{other}", or set joint.model = {messages.either(_models_of(name))}'
            yield f'method.name is "{name}", which is not for a {of_model} joint: {remedy}.'
        for key in lacking(name):
            yield (
                f"{key} is missing, but {method_of(name, of_model).called(of_model)} needs it: add it, "
                f'or use method.name = "{other}", which needs only {_needs(other, of_model)}.'
            )
        if "estimator" in keys_of(method_of(name, of_model)) and table.estimator == "iv":
            for key in [key for key in lacking("didim") if key not in lacking(name)]:
                yield f'{key} is missing, but method.estimator = "iv" simulates the loop: add it, or use another.'
    for key, sentence in _not_its_own(table, name, draft.model):
        yield f"method.{key}{sentence}"


def _models_of(name: str, key: str | None = None) -> tuple[str, ...]:
    """Return the joint models that a method is for, or a key of it."""
    named = [method for method in methods() if method.name == name and (key is None or key in keys_of(method))]
    return tuple(model for method in named for model in method.models)


def _needs(method: str, model: str) -> str:
    made = method_of(method, model)
    *most, last = [*made.channels(model), *(["controller"] if made.needs_controller else [])]
    return f"{', '.join(most)} and {last}"


def _no_method(lacking: Mapping[str, list[str]], draft: Draft, model: str) -> str:
    """Return the sentence on a file that has what no method needs."""
    lacks = [f"{method_of(method, model).called(model)} lacks {' and '.join(keys)}" for method, keys in lacking.items()]
    rigid = choose_method(draft, None, "rigid") is not None
    remedy = "add what one of them lacks" + (', or set joint.model = "rigid"' if rigid else "")
    return f"method.name is missing, and no method can be chosen: {', '.join(lacks)}; {remedy}."


def _not_its_own(table: MethodTable, name: str | None, model: str | None) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on settings of the other model or method, or of a preset."""
    for key, value in table.given("name").items():
        owners = [owner for owner in METHODS if _models_of(owner, key)]
        owner = name if name in owners else owners[0]
        models = _models_of(owner, key)
        strange = name is not None and name not in owners
        title = method_of(owner, models[0]).title
        if strange and not {owner, name} <= set(_defaults()):
            remedy = f"leave it out, or use method.name = {messages.either(owners)}"
            yield key, f' is not for the method "{name}": {remedy}.'
        elif model is not None and model not in models:
            remedy = f'leave it out, or set joint.model = "{models[0]}"'
            yield key, f" is for {title} of a {models[0]} joint, but the joint is {model}: {remedy}."
        elif name is not None and strange:
            other = method_of(name, models[0]).title
            yield key, f' is for {title}, but the method is {other}: leave it out, or use method.name = "{owner}".'
        elif key in table.beside_preset():
            yield key, messages.beside_preset(value, str(table.preset))


def record_faults(draft: Draft) -> Iterator[str]:
    """Yield names of own parameters that the model does not have, and numbers that the controller cannot have."""
    known = None if draft.parts is None else [parameter.name for parameter in draft.parts.parameters]
    for place, run in draft.runs.items():
        path = messages.dot_path(["records", place])
        for name in run.own:
            if known is not None and name not in known:
                yield (
                    f'{path}.own names "{name}", which is no parameter of this model; expected some of '
                    f"{', '.join(known)}: {messages.suggest(name, known, 'leave it out')}"
                )
        if run.controller and not draft.controlled:
            yield f"{path}.controller changes a controller that the file does not have: add [controller]."
        elif draft.controller is not None and (refused := _no_change(draft.controller, run.controller)):
            yield f"{path}.controller{refused}"


def _no_change(controller: Controller, numbers: Mapping[str, float]) -> str | None:
    """Return the rest of the sentence on numbers that a controller does not have, or cannot have."""
    known = (*numbers_of(controller), "period")
    for name in numbers:
        if name not in known:
            return f".{messages.dot_path([name])}{messages.unknown(name, known)}"
    return refusal(lambda: with_numbers(controller, numbers))


def free_faults(key: str, names: Collection[str], controller: Controller | None) -> Iterator[str]:
    """Yield names of what nothing around the joint is called, or what cannot be freed of this controller."""
    if controller is None:
        return
    for name in names:
        if refused := refusal(partial(surrounding, name, controller)):
            yield f"{key}{refused}"


def parameter_faults(draft: Draft) -> Iterator[str]:
    """Yield parameters that the model does not have, and values that they cannot have."""
    if draft.parts is None or draft.joint is None:
        return
    known = {parameter.name: parameter for parameter in draft.parts.parameters}
    for name, table in draft.parameters.items():
        path = messages.dot_path(["parameters", name])
        if name not in known:
            yield path + _no_parameter(name, draft.joint, draft.gravity, known)
            continue
        for key, sentence in _misgiven(known[name], table, draft.joint, draft.gravity):
            yield path + (f".{key}" if key and name not in draft.bare else "") + sentence


def change_parameter(parameter: Parameter, table: ParameterTable) -> Parameter:
    """Return a parameter of the model with what the file says of it; of two bounds the tighter one holds."""
    lower, upper = _bounds(parameter, table)
    free = table.value is None and (parameter.free if table.free is None else table.free)
    start = next((given for given in (table.value, table.start, parameter.start) if given is not None), None)
    return replace(parameter, free=free, start=start, lower=lower, upper=upper)


def _bounds(parameter: Parameter, table: ParameterTable) -> tuple[float, float]:
    lower = parameter.lower if table.lower is None else max(table.lower, parameter.lower)
    upper = parameter.upper if table.upper is None else min(table.upper, parameter.upper)
    return lower, upper


def _misgiven(
    parameter: Parameter, table: ParameterTable, joint: JointTable, gravity: GravityTable | None
) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on what a parameter cannot be given."""
    if not parameter.free and table.value is None:
        constant_load = gravity is not None and gravity.load == "constant"
        beside = _BESIDE_LOAD if constant_load else _BESIDE_FRICTION.format(joint.friction)
        yield "", beside if parameter.name == "offset" else _KNOWN
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
    """Return the bound that is meant: one that no number of interest is below says that 0 itself is excluded."""
    return 0.0 if 0.0 < lower < _NEXT_TO_ZERO else lower


def _no_parameter(name: str, joint: JointTable, gravity: GravityTable | None, known: Collection[str]) -> str:
    """Return the rest of the sentence on a parameter that this model does not have."""
    remedy = messages.suggest(name, known, "leave it out")
    for key, choices in (("model", MODELS), ("friction", FRICTIONS), ("spring", SPRINGS)):
        # Last of all, and so told, the one that is most like what is declared, else that of the fewest parameters.
        like = [choice for choice in choices if key == "friction" and choice.startswith(joint.friction)]
        for choice in (*reversed(list(choices)), *like):
            changed = joint.model_copy(update={key: choice})
            if any(changed.faults()):
                continue
            other: Joint = changed.joint(None, gravity=None)
            if name in [parameter.name for parameter in other.parameters]:
                remedy = f'leave it out, or set joint.{key} = "{choice}".'
    for load, names in GRAVITY_PARAMETERS.items():
        if gravity is None and name in names:
            remedy = f'leave it out, or set gravity.load = "{load}".'
    if name.removeprefix("load_").startswith("harmonic_"):
        remedy = "leave it out, or set ripple.period."
    model = f"a {joint.model} joint with {joint.friction} friction"
    model += "" if joint.spring == LinearSpring.name else f" and a {joint.spring} spring"
    return f" is not known for {model}; expected one of {', '.join(known)}: {remedy}"


def channel_faults(draft: Draft) -> Iterator[str]:
    """Yield channels without a column, or with settings or units that are not theirs, and torques that differ."""
    # Behind a transmission that is not right, a motor may move in any way.
    kinds = KINDS if draft.geared and not draft.transmission else draft.kinds
    for name, table in draft.channels.items():
        if table.column is None and draft.drive is not None and draft.drive.traces is None:
            yield (
                f"record.channels.{name}.column is missing; expected text in quotes (name of the column in the "
                "record's file): add it, or give drive.profile."
            )
        yield from (f"record.channels.{fault}" for fault in table.build().misplaced_faults(name))
        yield from _unit_faults(draft, name, table, kinds)
    if "injected" in draft.channels:
        pairs = {(_si_unit(draft, "injected", kind), _si_unit(draft, "torque", kind)) for kind in kinds}
        pair = pairs.pop() if len(pairs) == 1 else (None, None)
        # A force on one side of a screw and a torque on the other are both in SI.
        if None not in pair and len({unit in TORQUE_UNIT.values() or unit for unit in pair}) > 1:
            yield f"record.channels.injected is in {pair[0]}, but the torque in {pair[1]}: give both in one unit."


def _unit_faults(draft: Draft, name: str, table: ChannelTable, kinds: Collection[Kind]) -> Iterator[str]:
    """Yield a unit that a joint of none of these kinds can have, or for which a number of the drive is missing."""
    moving = [_kind_of(draft, name, kind) for kind in kinds]
    known = tuple(dict.fromkeys(unit for kind in moving for unit in known_units(name, kind)))
    stated = table.build().stated_unit(known)
    if stated is None:
        return
    if named := table.build().doubled_unit(known):
        yield (
            f'record.channels.{name}.unit is "{table.unit}", but its column "{table.column}" names the unit "{named}"; '
            "expected one of them: leave unit out, or rename the column."
        )
    if stated not in known:
        where = "unit is" if table.unit is not None else "column names the unit"
        yield f'record.channels.{name}.{where} "{stated}"{_misfit(name, stated, known, kinds, moving)}'
    elif draft.drive is not None and len(set(moving)) == 1:
        lack = _lacking(draft, name, stated, moving[0])
        yield from () if lack is None else (f'record.channels.{name} is in "{stated}", {lack}.',)


def torque_unit(draft: Draft, kind: Kind) -> str | None:
    """Return "A" or "V" for a torque in the drive's own units, None for one in N or N m."""
    unit = _si_unit(draft, "torque", kind)
    return None if unit in TORQUE_UNIT.values() else unit


def _si_unit(draft: Draft, channel: str, kind: Kind) -> str | None:
    """Return the unit in which a channel is logged, made SI; None if it cannot be."""
    table, moving = draft.channels.get(channel), _kind_of(draft, channel, kind)
    known = known_units(channel, moving)
    stated = table.build().stated_unit(known) if table else None
    if stated is None and channel == "injected":
        torque = _si_unit(draft, "torque", kind)
        return torque if torque is None or torque in known else known[0]
    if stated is None:
        return known[0]
    if stated not in known or _lacking(draft, channel, stated, moving):
        return None
    return (draft.drive or Drive()).resolve_unit(units.unit(stated), moving).si


def _kind_of(draft: Draft, channel: str, kind: Kind) -> Kind:
    """Return how a channel's side of a joint moves whose load is of that kind: with a lead the motor turns."""
    table, transmission = draft.channels.get(channel), draft.transmission
    side = (draft.drive or Drive()).side(channel, None if table is None else table.build())
    return "revolute" if transmission and transmission.lead is not None and side == "motor" else kind


def _lacking(draft: Draft, channel: str, unit: str, kind: Kind) -> str | None:
    """Return the end of the sentence on a unit for which a number of the drive is missing."""
    geared = draft.transmission is not None and draft.transmission.geared
    try:
        (draft.drive or Drive()).resolve_unit(units.unit(unit), kind, of_load=channel == "load_position", geared=geared)
    except units.UnitError as error:
        return str(error)
    return None


def _misfit(channel: str, unit: str, known: Collection[str], kinds: Collection[Kind], moving: Collection[Kind]) -> str:
    """Return the end of the sentence on a unit that a channel cannot have; its side may move otherwise than a joint."""
    expected = f"expected one of {', '.join(known)}"
    try:
        dimension = units.unit(unit).dimension
    except units.UnitError:
        otherwise = "give one of them, and the gain that takes the column to it"
        return f", which is not known; {expected}: {messages.suggest(unit, known, otherwise)}"
    fitting = [kind for kind in TORQUE_UNIT if kind not in kinds and unit in known_units(channel, kind)]
    remedy = "".join(f', or set joint.kind = "{kind}"' for kind in fitting)
    if set(moving) != set(kinds) and any(unit in known_units(channel, kind) for kind in kinds):
        remedy = ', or set side = "load"'
    return f", a unit of {dimension}; {expected}: give one of them{remedy}."


def limit_faults(draft: Draft) -> Iterator[str]:
    """Yield limits in units that the side they are of does not have, and one of a spring that is not there."""
    if draft.limits is None or len(draft.kinds) > 1 or (draft.geared and draft.transmission is None):
        return
    gear, (kind,) = draft.transmission, draft.kinds
    turning = gear is not None and gear.lead is not None and gear.side == "motor"
    moving: Kind = "revolute" if turning else kind
    torque = torque_unit(draft, kind) or TORQUE_UNIT[moving]
    for one in settings_of(AxisLimits):
        number = getattr(draft.limits, one.name)
        declared = torque if "torque" in one.name else one.setting.unit
        if isinstance(number, Stated) and (fault := misfit(number.text, declared, moving)):
            yield f"limits.{one.name}{fault}"
    if draft.model == "rigid" and draft.limits.windup is not None:
        yield "limits.windup is that of a spring, and a rigid joint has none: leave it out."


def transmission_faults(draft: Draft) -> Iterator[str]:
    """Yield that a load of these kinds has no lead, and sides that are named where there is no transmission."""
    transmission = draft.transmission
    if transmission is not None and transmission.lead is not None and "prismatic" not in draft.kinds:
        yield (
            f"transmission.lead is {transmission.lead:g}, but the load is revolute; expected a ratio: give that, "
            'or set joint.kind = "prismatic".'
        )
    if draft.geared:
        return
    named = {f"record.channels.{name}": table.side for name, table in draft.channels.items() if table.side}
    if draft.law and "side" in draft.law.model_fields_set:
        named["controller"] = draft.law.side
    for table, side in named.items():
        yield f'{table}.side is "{side}", but nothing lies between motor and load: add [transmission], or leave it out.'
