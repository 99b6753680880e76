"""Transmission between motor and load.

One ratio r, motor position per load position, describes it. Power passes without loss::

    q motor = r q load,        tau load = r tau motor

A record is *referred* to the joint's side when it is read: positions by their factor, torques by its inverse.

Gear losses appear in the friction: speed-dependent ones as viscous, constant ones as Coulomb friction. A loss
proportional to the transmitted torque is spread over these and the load inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from jointid.common import units
from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting

Side: TypeAlias = Literal["motor", "load"]

SIDES: tuple[Side, ...] = ("motor", "load")


@add_settings_to_docstring
@dataclass(frozen=True, slots=True, kw_only=True)
class Transmission:
    """A gear, belt or screw without loss, given by its ratio or lead.

    Raises:
        MethodError: not exactly one of ratio and lead is given, or a value is invalid.

    Example:
        >>> import jointid as ji
        >>> screw = ji.Transmission(load="prismatic", lead=0.010)
        >>> law = ji.controller.Cascade(position_gain=25.0, velocity_gain=0.02, ratio=screw.torque("motor"))
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic", transmission=screw), law)
        >>> print(screw)
        10 mm per turn, efficiency taken as 1; no record checks either; values are on the load side
    """

    in_json = "motor_per_load motor"
    load: units.Kind = field(metadata=declare("how the load moves"))
    ratio: float | None = setting(
        None,
        "travel of the motor for 1 of the load, where both turn or both slide: 100 for a gear 100:1; this or the lead",
        above=0,
    )
    lead: float | None = setting(
        None,
        "travel of the load for one turn of the motor, with a screw, a rack or a belt; the load is prismatic, the "
        "motor revolute",
        unit="m",
        above=0,
    )
    sign: int = setting(1, "-1 where motor and load count in opposite directions", only=(1, -1))
    side: Side = setting("load", "on which the joint is identified and reported, and on which its parameters are given")

    def __post_init__(self) -> None:
        check_settings(self)
        if (self.ratio is None) == (self.lead is None):
            raise MethodError(
                "A transmission has either a ratio (motor per load) or a lead (m per turn of the motor); received "
                f"ratio = {self.ratio} and lead = {self.lead}: give one of them."
            )
        if self.lead is not None and self.load == "revolute":
            raise MethodError("A lead is of a load that is prismatic; of a revolute one give the ratio.")

    @property
    def motor(self) -> units.Kind:
        """Kind of the motor's motion: revolute with a lead, else the load's."""
        return self.load if self.lead is None else "revolute"

    @property
    def motor_per_load(self) -> float:
        """Signed ratio r [rad/rad, m/m or rad/m]."""
        return self.sign * (self.ratio if self.ratio is not None else 2 * math.pi / (self.lead or 1.0))

    @property
    def kind(self) -> units.Kind:
        """Kind of motion on the identified side."""
        return self.kind_of(self.side)

    def kind_of(self, side: Side) -> units.Kind:
        """Return a side's kind of motion."""
        return self.load if side == "load" else self.motor

    def position(self, side: Side) -> float:
        """Factor from a position on that side to the joint's side."""
        return 1.0 / self.torque(side)

    def torque(self, side: Side) -> float:
        """Factor from a torque on that side to the joint's side."""
        if side == self.side:
            return 1.0
        return self.motor_per_load if side == "motor" else 1.0 / self.motor_per_load

    def __str__(self) -> str:
        """Return its description, in a sentence."""
        size = f"{self.ratio:g}:1" if self.ratio is not None else f"{1e3 * (self.lead or 0.0):g} mm per turn"
        turned = ", turned round" if self.sign < 0 else ""
        return f"{size}{turned}, efficiency taken as 1; no record checks either; values are on the {self.side} side"
