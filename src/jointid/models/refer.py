"""Refer an estimate from one side of a transmission to the other.

With r the motor's position per position of the load, and power the same on both sides (`data.transmission`), the
motor's ``tau motor = J a + Fv v + Fc sign(v) + offset`` is on the load::

    tau load = r tau motor,    q motor = r q load
    tau load = r^2 J a + r^2 Fv v + |r| Fc sign(v) + r offset

Stiffness and damping go with r^2, a compliance with its inverse. Where r is negative, forwards is backwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common.transmission import Side, Transmission
from jointid.models.parameters import TORQUE_UNIT, Quantity, unit_of

_POWERS: Mapping[Quantity, int] = {
    Quantity.INERTIA: 2,
    Quantity.VISCOUS: 2,
    Quantity.VISCOUS_DRIFT: 2,
    Quantity.STIFFNESS: 2,
    Quantity.COMPLIANCE: -2,
    Quantity.FORCE: 1,
    Quantity.FORCE_DRIFT: 1,
    Quantity.POSITION: -1,
    Quantity.VELOCITY: -1,
}
"""Of the ratio from one side to the other; what is not here is the same on both."""

_TURNED = (
    "offset", "force_drift", "cosine", "_position", "_velocity", "initial_torque", "gravity_constant", "gravity_cos",
    "gravity_sin", "counterbalance_constant", "counterbalance_cos", "counterbalance_sin",
)  # fmt: skip
"""Ends of the names of what changes its sign with the direction; all else is odd in the motion, or a size."""


@dataclass(frozen=True, slots=True)
class OtherSide:
    """From the side a joint is identified on to the other one.

    Attributes:
        transmission: between them.
        torque_unit: in which the joint's parameters are: N, N m, A or V.
    """

    transmission: Transmission
    torque_unit: str

    @property
    def side(self) -> Side:
        """Which side it is."""
        return self.transmission.other

    @property
    def ratio(self) -> float:
        """Factor from a torque of the joint's side to the other side."""
        return self.transmission.position(self.side)

    def name(self, name: str) -> str:
        """Return the name of the parameter that is on this side what `name` is on the other: forwards is backwards."""
        if self.ratio > 0:
            return name
        for one, other in (("forwards", "backwards"), ("backwards", "forwards")):
            if name.endswith(one):
                return name.removesuffix(one) + other
        return name

    def unit(self, unit: str) -> str:
        """Return the unit of a quantity there, from its unit here."""
        quantity = self._quantity(unit)
        kind = self.transmission.kind_of(self.side)
        own = TORQUE_UNIT[kind] if self.torque_unit in TORQUE_UNIT.values() else self.torque_unit
        return unit if quantity is None else unit_of(quantity, kind, own)

    def factor(self, name: str, unit: str) -> float:
        """Return the factor from a value of that name and unit to the other side."""
        quantity = self._quantity(unit)
        size = abs(self.ratio) ** (0 if quantity is None else _POWERS.get(quantity, 0))
        return -size if self.ratio < 0 and name.endswith(_TURNED) else size

    def _quantity(self, unit: str) -> Quantity | None:
        """Return the quantity of a unit of this side: each has one of its own."""
        kind = self.transmission.kind
        return next((q for q in Quantity if unit_of(q, kind, self.torque_unit) == unit), None)


def other_side(transmission: Transmission | None, torque_unit: str) -> OtherSide | None:
    """Return the other side of a joint's transmission; None without one."""
    return None if transmission is None else OtherSide(transmission, torque_unit)
