"""Units of a joint's parameters, and changes to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeAlias

from jointid.common import units
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

__all__ = ["POSITION_UNIT", "TORQUE_UNIT", "Kind", "Parameter", "Quantity", "adjusted", "unit_of"]

Kind: TypeAlias = units.Kind

POSITION_UNIT: Mapping[str, str] = {"prismatic": "m", "revolute": "rad"}
TORQUE_UNIT: Mapping[str, str] = {"prismatic": "N", "revolute": "N m"}


def unit_of(quantity: Quantity, kind: Kind, torque_unit: str) -> str:
    """Return the unit of a quantity for a joint of that kind whose torque is kept in `torque_unit`.

    In N and N m the inertias come in kg and kg m2; in the drive's own A or V everything comes per ampere or volt.
    """
    position = POSITION_UNIT[kind]
    inertia = {"N": "kg", "N m": "kg m2"}.get(torque_unit, f"{torque_unit} s2/{position}")
    return {
        Quantity.INERTIA: inertia,
        Quantity.VISCOUS: f"{torque_unit} s/{position}",
        Quantity.FORCE: torque_unit,
        Quantity.STIFFNESS: f"{torque_unit}/{position}",
        Quantity.COMPLIANCE: f"{position}/({torque_unit})" if " " in torque_unit else f"{position}/{torque_unit}",
        Quantity.FORCE_DRIFT: f"{torque_unit}/s",
        Quantity.VISCOUS_DRIFT: f"{torque_unit} s/{position} per s",
        Quantity.POSITION: position,
        Quantity.VELOCITY: f"{position}/s",
        Quantity.TIME: "s",
        Quantity.RATIO: "1",
        Quantity.GAIN: "as declared",
    }[quantity]


def adjusted(parameters: Iterable[Parameter], changes: Mapping[str, Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters with those named in `changes` replaced.

    Raises:
        MethodError: a name is not one of the parameters; the sentence lists them.
    """
    wrong = [name for name, change in changes.items() if not isinstance(change, Parameter)]
    if wrong:
        raise MethodError(
            f"A change of {', '.join(wrong)} is a Parameter; received {changes[wrong[0]]!r}: take the joint's own and "
            "use its fixed(value), or dataclasses.replace."
        )
    parameters = tuple(parameters)
    names = [parameter.name for parameter in parameters]
    unknown = [name for name in changes if name not in names]
    if unknown:
        raise MethodError(f"No parameter is called {', '.join(unknown)}; this model has {', '.join(names)}.")
    return tuple(changes.get(parameter.name, parameter) for parameter in parameters)
