"""``Fv v + Fc sign(v)``: the friction of (1) and (2) in the paper."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.models.friction.law import Coefficient, Friction


@dataclass(frozen=True, slots=True)
class SymmetricFriction(Friction):
    """Viscous and Coulomb friction, the same in both directions."""

    name = "symmetric"
    label = "the same in both directions"
    contrast = "asymmetric"
    coefficients = (Coefficient("viscous", "Fv", "viscous"), Coefficient("coulomb", "Fc", "coulomb"))
