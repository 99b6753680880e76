"""The objects of a joint file as the tables it writes: what is at its default is left out."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, replace
from typing import Any

import numpy as np

from jointid.common.errors import JointFileError, MethodError
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.settings import settings_of
from jointid.common.transmission import SIDES, Transmission
from jointid.config.quantities import Stated
from jointid.config.schema import FILTERINGS
from jointid.estimation.methods.registry import Method, method_of
from jointid.models.controllers import FILTERS, LAWS, Controller, DigitalFilter
from jointid.models.disturbances import Drift
from jointid.models.friction import FRICTIONS
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.records.drives import Drive
from jointid.records.resampling import Resampling
from jointid.records.signals.filtering import Filtering

_KINDS: Mapping[type, str] = {made: kind for kind, made in FILTERS.items()}
_LAWS: Mapping[type, str] = {made: law for law, made in LAWS.items()}


def settings(made: Any, *without: str) -> dict[str, Any]:
    """Return the non-default fields of a dataclass as TOML, without those named."""
    found = {}
    for field in fields(made):
        value = _plain(getattr(made, field.name))
        if field.name not in without and value is not None and value != _plain(_default(field)):
            found[field.name] = value
    return found


def joint_table(joint: Joint, name: str | None) -> dict[str, Any]:
    """Return [joint]."""
    frictions = [word for word, law in FRICTIONS.items() if type(joint.friction) is law]
    if not frictions:
        law = type(joint.friction).__name__
        raise JointFileError(f"A joint file has no word for the friction {law}; use {' or '.join(FRICTIONS)}.")
    kind = joint.kind if joint.transmission is None else joint.transmission.load
    table = {"kind": kind, "model": joint.model, "friction": frictions[0]}
    if isinstance(joint, FlexibleJoint) and not joint.spring.linear:
        table["spring"] = joint.spring.name
    return table if name is None else {**table, "name": name}


def gravity_table(gravity: Gravity | None, transmission: Transmission | None) -> dict[str, Any]:
    """Return [gravity]; its angle is that of the load, whatever the side."""
    if gravity is None:
        return {}
    angle = gravity.angle if transmission is None else gravity.angle / transmission.torque("load")
    balance = settings(gravity.counterbalance)
    return settings(replace(gravity, angle=angle), "counterbalance") | ({"counterbalance": balance} if balance else {})


def controller_table(
    controller: Controller, transmission: Transmission | None = None, torque_per_unit: float | None = None
) -> dict[str, Any]:
    """Return [controller]; its gain only where it is not the torque constant of the file it goes to."""
    law = _LAWS.get(type(controller))
    if law is None:
        raise JointFileError(
            f"A joint file has no word for the controller {type(controller).__name__}; give a StateSpaceController."
        )
    ratio: float = getattr(controller, "ratio", 1.0)
    seen = {"motor": 1.0} if transmission is None else {side: transmission.torque(side) for side in SIDES}
    sides = [side for side, through in seen.items() if through == ratio]
    if not sides:
        raise JointFileError(
            f"The controller's ratio is {ratio:g}; expected one of {', '.join(f'{r:g}' for r in seen.values())}, as "
            "its joint's transmission has it."
        )
    side = {} if sides[0] == "motor" else {"side": sides[0]}
    gain: float = getattr(controller, "gain", 1.0)
    through = 1.0 if transmission is None or sides[0] == "motor" else abs(transmission.motor_per_load)
    said = {} if gain == (1.0 if torque_per_unit is None else torque_per_unit * through) else {"gain": gain}
    return {"law": law, **settings(controller, "ratio", "gain"), **said, **side}


def torque_constant(drive: Drive, joint: Joint) -> dict[str, Any]:
    """Return the torque constant as a key of [joint]."""
    if drive.torque_constant is not None:
        return {"torque_constant": drive.torque_constant}
    kind = joint.kind if joint.transmission is None else joint.transmission.motor
    per_volt = drive.torque_per_volt
    return {} if per_volt is None else {"torque_constant": f"{per_volt!r} {TORQUE_UNIT[kind]}/V"}


def restore_units(tables: dict[str, Any], stated: Mapping[str, Stated]) -> dict[str, Any]:
    """Return tables with unchanged numbers written with their original units."""
    written = copy.deepcopy(tables)
    for path, number in stated.items():
        *above, key = path.split(".")
        table: Any = written
        for name in above:
            table = table.get(name) if isinstance(table, dict) else None
        if not isinstance(table, dict):
            continue
        gain, value = key, float(number)
        if key == "integral_time":  # the position gain may already stand in its own words
            proportional = tables["controller"].get("position_gain", math.nan) if table["law"] == "pid" else 1.0
            gain, value = "integral_gain", proportional / value
        if _same(table.get(gain), value):
            del table[gain]
            table[key] = number.text
    return written


def _same(value: Any, number: float) -> bool:
    """Return True for that number, or a text with it in SI."""
    return value == number or (isinstance(value, str) and value.split(maxsplit=1)[:1] == [repr(number)])


def filtering_table(filtering: Filtering) -> dict[str, Any]:
    """Return [filtering]."""
    presets = [name for name, made in FILTERINGS.items() if name != "default" and filtering == made()]
    return {"preset": presets[0]} if presets else settings(filtering)


def method_table(method: Method, model: str) -> dict[str, Any]:
    """Return [method] for a joint of that model."""
    made = method_of(method.name)
    if type(method) is not made:  # it would be read back as the other one
        raise JointFileError(f"A joint file has no word for {type(method).__name__}; use {made.__name__}.")
    try:
        method.require_settings_of(model)
    except MethodError as error:
        raise JointFileError(str(error)) from error
    words = {one.name: one.setting.none for one in settings_of(made) if one.setting.none}
    given = {name: word for name, word in words.items() if getattr(method, name) is None}
    effects = getattr(method, "effects", ())
    found: dict[str, Any] = {}
    for effect in effects:
        match effect:
            case PositionHarmonics(side="motor") if "harmonics" not in found and "drift" not in found:
                found |= {"harmonics": effect.harmonics, "period": effect.period}
            case Drift(side="motor") if "drift" not in found:
                found["drift"] = effect.of
            case _:
                raise JointFileError(
                    "A joint file has words for one PositionHarmonics, then one Drift, both on the motor's side; "
                    f"received {', '.join(map(repr, effects))}."
                )
    return {"name": method.name, **settings(method, "effects"), **given, **found}


def parameter_table(parameter: Parameter, model: Parameter) -> dict[str, Any] | float:
    """Return [parameters.name] for a parameter that is `model`'s, changed; a bare number where that is all."""
    bounds = {key: getattr(parameter, key) for key in ("lower", "upper")}
    table = {key: float(value) for key, value in bounds.items() if value != getattr(model, key)}
    if parameter.free:
        return table if parameter.start is None else {"start": float(parameter.start), **table}
    value = float(parameter.start or 0.0)
    return {"value": value, **table} if table else value


def _default(field: Field[Any]) -> Any:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return None if field.default is MISSING else field.default


def _plain(value: Any) -> Any:
    """Return a value as TOML has it."""
    if isinstance(value, DigitalFilter):  # without its denominator it would be read as a mere numerator
        return {"numerator": list(value.numerator), "denominator": list(value.denominator)}
    if isinstance(value, Resampling) or type(value) in _KINDS:
        kind = _KINDS.get(type(value))
        return {**({} if kind is None else {"kind": kind}), **settings(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, str) else value
