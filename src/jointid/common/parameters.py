"""Identified parameters: name, symbol, quantity, unit, start and bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.units import Kind

POSITION_UNIT: Mapping[str, str] = {"prismatic": "m", "revolute": "rad"}
TORQUE_UNIT: Mapping[str, str] = {"prismatic": "N", "revolute": "N m"}


class Quantity(StrEnum):
    """The physical quantity of a parameter, which determines its unit."""

    INERTIA = "inertia"
    VISCOUS = "viscous friction"
    FORCE = "force"
    STIFFNESS = "stiffness"
    CUBIC_STIFFNESS = "stiffness per position squared"
    FORCE_RATE = "force per position"
    COMPLIANCE = "compliance"
    FORCE_DRIFT = "force per time"
    VISCOUS_DRIFT = "viscous friction per time"
    POSITION = "position"
    VELOCITY = "velocity"
    TIME = "time"
    RATIO = "ratio"
    GAIN = "gain"


ADDED = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.FORCE, Quantity.VISCOUS_DRIFT, Quantity.FORCE_DRIFT)
"""Quantities of which a joint without a spring has the sum of both sides."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a joint or its surroundings.

    Attributes:
        name: the field's term, as code and files say it.
        symbol: as tables and formulas say it.
        free: whether it is identified; otherwise it keeps `start`.
        start: where the search begins, or the value that is kept; None lets the method find its own start.
    """

    name: str
    symbol: str
    quantity: Quantity
    free: bool = True
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def fix(self, value: float) -> Parameter:
        """Return this parameter kept at `value`."""
        return replace(self, free=False, start=float(value))


def unit_of(quantity: Quantity, kind: Kind, torque_unit: str) -> str:
    """Return the unit of a quantity for a joint's kind and torque unit.

    With torque in A or V, inertias and other parameters are per ampere or volt.
    """
    position = POSITION_UNIT[kind]
    inertia = {"N": "kg", "N m": "kg m2"}.get(torque_unit, f"{torque_unit} s2/{position}")
    return {
        Quantity.INERTIA: inertia,
        Quantity.VISCOUS: f"{torque_unit} s/{position}",
        Quantity.FORCE: torque_unit,
        Quantity.STIFFNESS: f"{torque_unit}/{position}",
        Quantity.CUBIC_STIFFNESS: f"{torque_unit}/{position}3",
        Quantity.FORCE_RATE: f"{torque_unit}/{position}",
        Quantity.COMPLIANCE: f"{position}/({torque_unit})" if " " in torque_unit else f"{position}/{torque_unit}",
        Quantity.FORCE_DRIFT: f"{torque_unit}/s",
        Quantity.VISCOUS_DRIFT: f"{torque_unit} s/{position} per s",
        Quantity.POSITION: position,
        Quantity.VELOCITY: f"{position}/s",
        Quantity.TIME: "s",
        Quantity.RATIO: "1",
        Quantity.GAIN: "as declared",
    }[quantity]


def adjust_parameters(parameters: Iterable[Parameter], changes: Mapping[str, Parameter]) -> tuple[Parameter, ...]:
    """Replace the parameters named in `changes`."""
    wrong = [name for name, change in changes.items() if not isinstance(change, Parameter)]
    if wrong:
        raise MethodError(
            f"A change of {', '.join(wrong)} is a Parameter; received {changes[wrong[0]]!r}: take the joint's own and "
            "use its fix(value), or dataclasses.replace."
        )
    parameters = tuple(parameters)
    names = [parameter.name for parameter in parameters]
    unknown = [name for name in changes if name not in names]
    if unknown:
        raise MethodError(f"No parameter is called {', '.join(unknown)}; this model has {', '.join(names)}.")
    return tuple(changes.get(parameter.name, parameter) for parameter in parameters)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Lower and upper bounds, each (parameters,)."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Bounds:
        """Return the bounds of parameters, in their order."""
        return cls(np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters]))

    @classmethod
    def infinite(cls, size: int) -> Bounds:
        """Unbounded parameters."""
        anywhere = np.full(size, np.inf)
        return cls(-anywhere, anywhere)

    def clip(self, x: FloatArray) -> FloatArray:
        """Return the nearest point within the bounds."""
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def find_active(self, x: FloatArray, gap: float | FloatArray = 0.0) -> NDArray[np.bool_]:
        """Test which parameters are within `gap` of a bound."""
        return np.asarray((x <= self.lower + gap) | (x >= self.upper - gap))

    def find_blocking(self, x: FloatArray, step: FloatArray) -> NDArray[np.bool_]:
        """Test which parameters are at a bound and step outwards."""
        return np.asarray(((x <= self.lower) & (step < 0)) | ((x >= self.upper) & (step > 0)))

    def shift_to(self, x: FloatArray) -> Bounds:
        """Bounds on a step from a point."""
        return Bounds(self.lower - x, self.upper - x)

    def within(self, reach: FloatArray | None) -> Bounds:
        """Tighten bounds on a step to a step limit, if given."""
        return self if reach is None else Bounds(np.maximum(self.lower, -reach), np.minimum(self.upper, reach))

    def in_units(self, unit: FloatArray) -> Bounds:
        """Bounds in units of positive scale factors."""
        return Bounds(self.lower / unit, self.upper / unit)
