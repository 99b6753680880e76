"""Friction laws: one file each, and the table that everything else finds them by.

To add a law within the engine's form: write its file beside `asymmetric`, and its line in `FRICTIONS`.
"""

from __future__ import annotations

from collections.abc import Mapping

from jointid.common.errors import MethodError
from jointid.models.friction.asymmetric import AsymmetricFriction
from jointid.models.friction.law import DIRECTIONS, PARTS, Coefficient, Direction, Directions, Friction, Part
from jointid.models.friction.symmetric import SymmetricFriction

__all__ = [
    "DIRECTIONS",
    "FRICTIONS",
    "PARTS",
    "AsymmetricFriction",
    "Coefficient",
    "Direction",
    "Directions",
    "Friction",
    "Part",
    "SymmetricFriction",
    "friction_named",
]

FRICTIONS: Mapping[str, type[Friction]] = {
    law.name: law
    for law in (
        SymmetricFriction,
        AsymmetricFriction,
    )
}
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
