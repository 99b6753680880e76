"""Friction laws: viscous and Coulomb, the same in both directions or not.

Both are piecewise linear in velocity, which is what lets the simulation be exact, and linear in their parameters,
which is what lets a regression estimate them (`columns`). At standstill the Coulomb force is a set: whatever
within its bounds keeps the mass at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.parameters import Parameter, Quantity

Directions: TypeAlias = tuple[float, float, float, float]
"""Viscous coefficient forwards and backwards, Coulomb force forwards and backwards (both positive)."""


class Friction(Protocol):
    """What a joint asks of a friction law; it is frozen, as a joint is looked up by what it is made of."""

    @property
    def symmetric(self) -> bool:
        """Whether an offset can be told apart from the friction."""

    def parameters(self, prefix: str, index: str) -> tuple[Parameter, ...]:
        """Return the law's parameters, with `prefix` before the names and `index` after Fv and Fc."""

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return the regressor of the law's parameters, shape (samples, parameters)."""

    def directions(self, values: Mapping[str, float], prefix: str) -> Directions:
        """Return the coefficients for both directions of motion."""


@dataclass(frozen=True, slots=True)
class SymmetricFriction:
    """``Fv v + Fc sign(v)``: the friction of (1) and (2) in the paper."""

    @property
    def symmetric(self) -> bool:
        """True: the same in both directions."""
        return True

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return viscous and Coulomb friction."""
        return (
            Parameter(f"{prefix}viscous", f"Fv{index}", Quantity.VISCOUS, lower=0.0),
            Parameter(f"{prefix}coulomb", f"Fc{index}", Quantity.FORCE, lower=0.0),
        )

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return v and sign(v), shape (samples, 2)."""
        return np.stack([velocity, np.sign(velocity)]).T

    def directions(self, values: Mapping[str, float], prefix: str = "") -> Directions:
        """Return Fv, Fv, Fc, Fc."""
        viscous, coulomb = values[f"{prefix}viscous"], values[f"{prefix}coulomb"]
        return viscous, viscous, coulomb, coulomb


@dataclass(frozen=True, slots=True)
class AsymmetricFriction:
    """``Fv+ v + Fc+`` forwards, ``Fv- v - Fc-`` backwards.

    A constant offset adds to Fc+ and takes from Fc- alike, so it cannot be identified beside this law.
    """

    @property
    def symmetric(self) -> bool:
        """False: an offset is already part of the law."""
        return False

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return viscous and Coulomb friction forwards, then backwards."""
        return tuple(
            Parameter(f"{prefix}{name}_{word}", f"{symbol}{index}{sign}", quantity, lower=0.0)
            for word, sign in (("forwards", "+"), ("backwards", "-"))
            for name, symbol, quantity in (
                ("viscous", "Fv", Quantity.VISCOUS),
                ("coulomb", "Fc", Quantity.FORCE),
            )
        )

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return v and 1 where it is forwards, v and -1 where it is backwards, shape (samples, 4)."""
        forwards, backwards = velocity > 0, velocity < 0
        return np.stack([velocity * forwards, 1.0 * forwards, velocity * backwards, -1.0 * backwards]).T

    def directions(self, values: Mapping[str, float], prefix: str = "") -> Directions:
        """Return Fv+, Fv-, Fc+, Fc-."""
        return (
            values[f"{prefix}viscous_forwards"],
            values[f"{prefix}viscous_backwards"],
            values[f"{prefix}coulomb_forwards"],
            values[f"{prefix}coulomb_backwards"],
        )
