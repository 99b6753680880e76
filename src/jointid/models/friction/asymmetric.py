"""``Fv+ v + Fc+`` forwards, ``Fv- v - Fc-`` backwards.

A constant offset adds to Fc+ and subtracts from Fc- alike, so it cannot be identified beside this law.
"""

from __future__ import annotations

from dataclasses import dataclass

from jointid.models.friction.law import Coefficient, Friction


@dataclass(frozen=True, slots=True)
class AsymmetricFriction(Friction):
    """Viscous and Coulomb friction, different in the two directions."""

    name = "asymmetric"
    label = "different in the two directions"
    contrast = "symmetric"
    coefficients = (
        Coefficient("viscous_forwards", "Fv", "viscous", ("forwards",), "+"),
        Coefficient("coulomb_forwards", "Fc", "coulomb", ("forwards",), "+"),
        Coefficient("viscous_backwards", "Fv", "viscous", ("backwards",), "-"),
        Coefficient("coulomb_backwards", "Fc", "coulomb", ("backwards",), "-"),
    )
