"""Friction laws within the engine's form: piecewise linear in velocity, with own coefficients in each direction.

Forwards ``Fv+ v + Fc+``, backwards ``Fv- v - Fc-``. Being piecewise linear in velocity lets the simulation be exact;
being linear in its parameters lets a regression estimate them (`columns`). At standstill the Coulomb force is a set:
any force within its bounds keeps the mass at rest.

A law states which parameters its coefficients are (`coefficients`); everything else follows from that table. To add
one, write its class below, and its name in `FRICTIONS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

Directions: TypeAlias = tuple[float, float, float, float]
"""Viscous coefficient forwards and backwards, Coulomb force forwards and backwards (both positive)."""

Part: TypeAlias = Literal["viscous", "coulomb"]
Direction: TypeAlias = Literal["forwards", "backwards"]

PARTS: tuple[Part, ...] = ("viscous", "coulomb")
DIRECTIONS: tuple[Direction, ...] = ("forwards", "backwards")

_QUANTITY: Mapping[Part, Quantity] = {"viscous": Quantity.VISCOUS, "coulomb": Quantity.FORCE}


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One parameter of a friction law, and where it acts.

    Attributes:
        name: of the parameter, after the side's prefix. A name that ends in a direction is the other direction's on the
            far side of a gear that reverses the motion.
        symbol: of the parameter, before the side's index. sign: after it.
        part: "viscous" or "coulomb".
        directions: in which it acts, "forwards", "backwards" or both.
    """

    name: str
    symbol: str
    part: Part
    directions: tuple[Direction, ...] = DIRECTIONS
    sign: str = ""


@dataclass(frozen=True, slots=True)
class Friction:
    """A friction law; it is frozen, as a joint is looked up by what it is made of.

    Attributes:
        name: in the joint file, the JSON answers and on the command line.
        label: on the web page.
        contrast: name of the law it is compared with when methods are held side by side.
        coefficients: its parameters, in their order; each part has at most one in each direction.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    contrast: ClassVar[str]
    coefficients: ClassVar[tuple[Coefficient, ...]]

    def named(self, part: Part, direction: Direction) -> str | None:
        """Return the name of a coefficient, None where the law has none there (it is 0)."""
        return next((c.name for c in self.coefficients if c.part == part and direction in c.directions), None)

    def depends_on_direction(self, part: Part) -> bool:
        """Return True if the forwards and backwards coefficients of this part are different parameters."""
        return self.named(part, "forwards") != self.named(part, "backwards")

    @property
    def offset_identifiable(self) -> bool:
        """True if an offset is identifiable beside this law.

        A constant force adds to Fc+ and subtracts from Fc- alike: beside two Coulomb parameters it is not.
        """
        return len(self.constant()) < len(DIRECTIONS)

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return the law's parameters, with `prefix` before the names and `index` after Fv and Fc."""
        return tuple(
            Parameter(f"{prefix}{c.name}", f"{c.symbol}{index}{c.sign}", _QUANTITY[c.part], lower=0.0)
            for c in self.coefficients
        )

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return the regressor of the law's parameters, shape (samples, parameters)."""
        return np.stack([_column(c, velocity) for c in self.coefficients]).T

    def directions(self, values: Mapping[str, float], prefix: str = "") -> Directions:
        """Return the coefficients for both directions of motion, 0 where the law has none."""
        a, b, c, d = _slots(self)
        return (
            values[prefix + a] if a else 0.0,
            values[prefix + b] if b else 0.0,
            values[prefix + c] if c else 0.0,
            values[prefix + d] if d else 0.0,
        )

    def mean(self, part: Part, prefix: str = "") -> dict[str, float]:
        """Return the weights, by parameter, whose sum is the mean of a part over both directions."""
        return {f"{prefix}{c.name}": 0.5 * len(c.directions) for c in self.coefficients if c.part == part}

    def constant(self, prefix: str = "") -> dict[str, float]:
        """Return the weights, by parameter, whose sum is the constant force in the law; none where it has none."""
        half = {"forwards": 0.5, "backwards": -0.5}
        one_way = [c for c in self.coefficients if c.part == "coulomb" and len(c.directions) == 1]
        return {f"{prefix}{c.name}": half[c.directions[0]] for c in one_way}


@cache
def _slots(law: Friction) -> tuple[str | None, ...]:
    """Return the names of a law's coefficients, in the order of `Directions`; every simulation asks for them."""
    return tuple(law.named(part, direction) for part in PARTS for direction in DIRECTIONS)


def _column(one: Coefficient, velocity: FloatArray) -> FloatArray:
    """Return the regressor column of a coefficient, (samples,)."""
    if len(one.directions) == 2:
        return velocity if one.part == "viscous" else np.sign(velocity)
    forwards = one.directions == ("forwards",)
    moving = velocity > 0 if forwards else velocity < 0
    return np.asarray((velocity if one.part == "viscous" else 1.0 if forwards else -1.0) * moving)


@dataclass(frozen=True, slots=True)
class SymmetricFriction(Friction):
    """Viscous and Coulomb friction, the same in both directions: ``Fv v + Fc sign(v)``, (1) and (2) of the paper."""

    name = "symmetric"
    label = "the same in both directions"
    contrast = "asymmetric"
    coefficients = (Coefficient("viscous", "Fv", "viscous"), Coefficient("coulomb", "Fc", "coulomb"))


@dataclass(frozen=True, slots=True)
class AsymmetricFriction(Friction):
    """Viscous and Coulomb friction, different in the two directions.

    A constant offset adds to Fc+ and subtracts from Fc- alike, so it cannot be identified beside this law.
    """

    name = "asymmetric"
    label = "different in the two directions"
    contrast = "symmetric"
    coefficients = (
        Coefficient("viscous_forwards", "Fv", "viscous", ("forwards",), "+"),
        Coefficient("coulomb_forwards", "Fc", "coulomb", ("forwards",), "+"),
        Coefficient("viscous_backwards", "Fv", "viscous", ("backwards",), "-"),
        Coefficient("coulomb_backwards", "Fc", "coulomb", ("backwards",), "-"),
    )


FRICTIONS: Mapping[str, type[Friction]] = {law.name: law for law in (SymmetricFriction, AsymmetricFriction)}
"""Every friction law by its name in the joint file."""


def friction_named(name: str) -> Friction:
    """Return the friction law of that name.

    Raises:
        MethodError: the law is not piecewise linear in velocity, or not known.
    """
    if name not in FRICTIONS:
        raise MethodError(
            f'Friction "{name}" cannot be simulated exactly: only laws that are piecewise linear in velocity can; '
            f"use {' or '.join(FRICTIONS)}."
        )
    return FRICTIONS[name]()
