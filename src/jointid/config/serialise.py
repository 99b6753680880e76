"""A controller and a parameter as the tables of a joint file: what is at its default is left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from typing import Any

import numpy as np

from jointid.common.errors import JointFileError
from jointid.common.parameters import Parameter
from jointid.common.transmission import SIDES, Transmission
from jointid.models.controllers import FILTERS, LAWS, Controller, DigitalFilter

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
    if type(value) in _KINDS:
        return {"kind": _KINDS[type(value)], **settings(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, str) else value
