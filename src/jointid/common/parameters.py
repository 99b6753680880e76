"""Identified parameters: name, symbol, quantity, unit, start and bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.units import Kind

POSITION_UNIT: Mapping[str, str] = {"prismatic": "m", "revolute": "rad"}
TORQUE_UNIT: Mapping[str, str] = {"prismatic": "N", "revolute": "N m"}
_INERTIAS: Mapping[str, str] = {"N": "kg", "N m": "kg m2"}


class Quantity(StrEnum):
    """The physical quantity of a parameter.

    Attributes:
        unit: with {f} for the torque unit and {q} for the position unit.
        power: exponent of the transmission ratio in the conversion to the other side.
    """

    INERTIA = "inertia", "{f} s2/{q}", 2
    VISCOUS = "viscous friction", "{f} s/{q}", 2
    FORCE = "force", "{f}", 1
    STIFFNESS = "stiffness", "{f}/{q}", 2
    CUBIC_STIFFNESS = "stiffness per position squared", "{f}/{q}3", 4
    FORCE_RATE = "force per position", "{f}/{q}", 2
    COMPLIANCE = "compliance", "{q}/{f}", -2
    FORCE_DRIFT = "force per time", "{f}/s", 1
    VISCOUS_DRIFT = "viscous friction per time", "{f} s/{q} per s", 2
    POSITION = "position", "{q}", -1
    VELOCITY = "velocity", "{q}/s", -1
    TIME = "time", "s", 0
    RATIO = "ratio", "1", 0
    GAIN = "gain", "as declared", 0

    unit: str
    power: int

    def __new__(cls, words: str, unit: str, power: int) -> Self:
        """Create a member from its words, unit and power."""
        made = str.__new__(cls, words)
        made._value_, made.unit, made.power = words, unit, power
        return made


ADDED = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.FORCE, Quantity.VISCOUS_DRIFT, Quantity.FORCE_DRIFT)
"""Quantities that add over both sides in a joint without a spring."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a joint or its surroundings.

    Attributes:
        name: the field's term, used in code and files.
        symbol: used in tables and formulas.
        free: whether it is identified; otherwise it is fixed at `start`.
        start: initial or fixed value; None lets the method choose its initial value.
    """

    name: str
    symbol: str
    quantity: Quantity
    free: bool = True
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def fix(self, value: float) -> Parameter:
        """Return this parameter fixed at `value`."""
        return replace(self, free=False, start=float(value))


def unit_of(quantity: Quantity, kind: Kind, torque_unit: str) -> str:
    """Return a quantity's unit for a joint's kind and torque unit.

    With torque in A or V, inertias and other parameters are per ampere or volt.
    """
    if quantity is Quantity.INERTIA and torque_unit in _INERTIAS:
        return _INERTIAS[torque_unit]
    if quantity is Quantity.COMPLIANCE and " " in torque_unit:
        torque_unit = f"({torque_unit})"
    return quantity.unit.format(f=torque_unit, q=POSITION_UNIT[kind])


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Lower and upper bounds, each (parameters,)."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Bounds:
        """Return the bounds of parameters, in their order."""
        return cls(np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters]))

    def clip(self, x: FloatArray) -> FloatArray:
        """Return the nearest point within the bounds."""
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def shift_to(self, x: FloatArray, longest: FloatArray | float = math.inf) -> Bounds:
        """Bounds on a step from a point, no longer than `longest`."""
        return Bounds(np.maximum(self.lower - x, -longest), np.minimum(self.upper - x, longest))


def find_active_bounds(free: Sequence[Parameter], x: FloatArray, error: FloatArray, J: FloatArray) -> dict[str, float]:
    """Return the bounds that hold free parameters, by name.

    A descent ends a little inside of a bound. The tolerance is a millionth of the value, or, since a bound may be 0, of
    the change that would move the residual by all of its size, if that is more.

    Args:
        free: the parameters.
        x: (free,) their values.
        error: (rows,) residual there.
        J: (rows, free) its derivatives, of either sign.
    """
    norms = np.linalg.norm(J, axis=0)
    size = np.maximum(np.abs(x), np.linalg.norm(error) / np.where(norms > 0, norms, np.inf))
    bounds, near = Bounds.of(free), 1e-6 * size  # of a parameter's size: how near to a bound is at it
    held = {p.name: p.upper for p, at in zip(free, x >= bounds.upper - near, strict=True) if at}
    return held | {p.name: p.lower for p, at in zip(free, x <= bounds.lower + near, strict=True) if at}
