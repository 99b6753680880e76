"""How the tables of a joint file fit together: units to the joint, channels to the method, parameters to the model.

Each part has the function that says what is at fault and the one that makes use of what is not.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial

from jointid.common import messages
from jointid.config.mechanics import GravityTable, JointTable
from jointid.config.schema import CLOSINGS, OF_IDIM, MethodTable, ParameterTable, RunTable
from jointid.config.table import refusal
from jointid.estimation.methods.inverse_model import idim_channels
from jointid.estimation.problems.nuisance_parameters import surrounding
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.friction import FRICTIONS
from jointid.models.gravity import GRAVITY_PARAMETERS
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter

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
_OTHER = {"didim": "idim", "idim": "didim", "drive_side": "didim", "open_loop": "didim"}


def choose_method(name: str | None, channels: Collection[str], controlled: bool, model: str) -> str | None:
    """Return the method: the one named, or the first whose needs are met, or None.

    DIDIM comes first, even where there is a motor position, which it does not read.

    Args:
        name: of the method, if the file names one.
        channels: names of the channels there are.
        controlled: whether the controller is known.
        model: of the joint; IDIM of a flexible one needs the load's position too.
    """
    if name is not None:
        return name
    if controlled and {"torque", "reference"} <= set(channels):
        return "didim"
    return "idim" if set(idim_channels(model)) <= set(channels) else None


def needed_channels(method: str, controller: Controller | None, model: str) -> tuple[str, ...]:
    """Return the names of the channels that a method reads; of a controller not known, only the reference."""
    if method == "idim":
        return idim_channels(model)
    if method in CLOSINGS:
        return "torque", "motor_position"
    return ("torque", *(("reference",) if controller is None else controller.channels))


def method_faults(
    table: MethodTable, channels: Collection[str], controller: Controller | None, controlled: bool, model: str | None
) -> Iterator[str]:
    """Yield what the method lacks, and settings that are not its own.

    Args:
        table: what the file says of the method.
        channels: names of the channels there are.
        controller: the controller, if it is right.
        controlled: whether the controller is known.
        model: of the joint, if that is known; else what is missing for every model is said.
    """
    of_model = model or "rigid"  # whose channels every model needs

    def lacking(method: str) -> list[str]:
        missing = [f"record.channels.{n}" for n in needed_channels(method, controller, of_model) if n not in channels]
        return missing if controlled or method != "didim" else [*missing, "controller"]

    name = choose_method(table.name, channels, controlled, of_model)
    if name is None:
        yield _no_method({method: lacking(method) for method in ("didim", "idim")}, channels, controlled, of_model)
    else:
        other = _OTHER[name]
        for key in lacking(name):
            yield (
                f"{key} is missing, but {_called(name, of_model)} needs it: add it, "
                f'or use method.name = "{other}", which needs only {_needs(other, of_model)}.'
            )
        if name == "idim" and table.estimator == "iv":
            for key in [key for key in lacking("didim") if key not in lacking(name)]:
                yield f'{key} is missing, but method.estimator = "iv" simulates the loop: add it, or use another.'
    for key, sentence in _not_its_own(table, name, model):
        yield f"method.{key}{sentence}"


def _called(method: str, model: str) -> str:
    """Return what a sentence on a method's needs calls it: those of IDIM are the model's."""
    if method in CLOSINGS:
        return f"the {method.replace('_', ' ')} method"
    return "IDIM of a flexible joint" if (method, model) == ("idim", "flexible") else method.upper()


def _needs(method: str, model: str) -> str:
    *most, last = idim_channels(model) if method == "idim" else ("torque", "reference", "controller")
    return f"{', '.join(most)} and {last}"


def _no_method(lacking: Mapping[str, list[str]], channels: Collection[str], controlled: bool, model: str) -> str:
    """Return the sentence on a file that has what no method needs."""
    lacks = [f"{_called(method, model)} lacks {' and '.join(keys)}" for method, keys in lacking.items()]
    rigid = choose_method(None, channels, controlled, "rigid") is not None
    remedy = "add what one of them lacks" + (', or set joint.model = "rigid"' if rigid else "")
    return f"method.name is missing, and no method can be chosen: {', '.join(lacks)}; {remedy}."


def _not_its_own(table: MethodTable, name: str | None, model: str | None) -> Iterator[tuple[str, str]]:
    """Yield the key and the rest of the sentence on settings of the other model or method, or of a preset."""
    for key, value in table.given("name").items():
        own = table.model_of(key)
        if key in OF_IDIM:
            if name not in (None, "idim"):
                other = "DIDIM" if name == "didim" else f'"{name}"'
                yield key, f' is for IDIM, but the method is {other}: leave it out, or use method.name = "idim".'
        elif name in CLOSINGS or (table.of_closing(key) and name is not None):
            others = [method for method in ("didim", *CLOSINGS) if table.is_of(key, method)]
            if name not in others:
                remedy = f"leave it out, or use method.name = {messages.either(others)}"
                yield key, f' is not for the method "{name}": {remedy}.'
        elif None not in (own, model) and own != model:
            remedy = f'leave it out, or set joint.model = "{own}"'
            yield key, f" is for DIDIM of a {own} joint, but the joint is {model}: {remedy}."
        elif name == "idim":
            yield key, ' is for DIDIM, but the method is IDIM: leave it out, or use method.name = "didim".'
        elif key in table.beside_preset():
            yield key, messages.beside_preset(value, str(table.preset))


def gravity_refusal(joint: JointTable, gravity: GravityTable | None) -> str | None:
    """Return the rest of the sentence on a gravity that this joint cannot have."""
    return refusal(lambda: joint.joint(None, gravity=gravity))


def record_faults(
    joint: JointTable | None,
    gravity: GravityTable | None,
    controller: Controller | None,
    controlled: bool,
    runs: Mapping[int, RunTable],
) -> Iterator[str]:
    """Yield names of own parameters that the model does not have, and numbers that the controller cannot have.

    Args:
        joint: whose parameters, if that is known.
        gravity: of its load.
        controller: the law, if it is known and right.
        controlled: whether there is one, right or not.
        runs: the records that are right in themselves, by their place.
    """
    for place, run in runs.items():
        path = messages.dot_path(["records", place])
        known = () if joint is None else tuple(p.name for p in joint.joint(None, gravity=gravity).parameters)
        for name in run.own:
            if joint is not None and name not in known:
                otherwise = "leave it out"
                yield (
                    f'{path}.own names "{name}", which is no parameter of this model; expected some of '
                    f"{', '.join(known)}: {messages.suggest(name, known, otherwise)}"
                )
        if run.controller and not controlled:
            yield f"{path}.controller changes a controller that the file does not have: add [controller]."
        elif controller is not None and (refused := _no_change(controller, run.controller)):
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


def parameter_faults(
    joint: JointTable, gravity: GravityTable | None, tables: Mapping[str, ParameterTable], bare: Collection[str]
) -> Iterator[str]:
    """Yield parameters that the model does not have, and values that they cannot have.

    Args:
        joint: whose parameters.
        gravity: of its load.
        tables: what the file says of each, by name.
        bare: names of those given by a bare number.
    """
    known = {parameter.name: parameter for parameter in joint.joint(None, gravity=gravity).parameters}
    for name, table in tables.items():
        path = messages.dot_path(["parameters", name])
        if name not in known:
            yield path + _no_parameter(name, joint, gravity, known)
            continue
        for key, sentence in _misgiven(known[name], table, joint, gravity):
            yield path + (f".{key}" if key and name not in bare else "") + sentence


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
    for key, choices in (("model", ("rigid", "flexible")), ("friction", FRICTIONS)):
        for choice in choices:
            other: Joint = joint.model_copy(update={key: choice}).joint(None, gravity=None)
            if name in [parameter.name for parameter in other.parameters]:
                remedy = f'leave it out, or set joint.{key} = "{choice}".'
    for load, names in GRAVITY_PARAMETERS.items():
        if gravity is None and name in names:
            remedy = f'leave it out, or set gravity.load = "{load}".'
    model = f"a {joint.model} joint with {joint.friction} friction"
    return f" is not known for {model}; expected one of {', '.join(known)}: {remedy}"
