"""Parameters: names of what is identified, with symbol, quantity, start and bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum


class Quantity(StrEnum):
    """The physical quantity of a parameter; its unit follows from the joint's kind and the torque's unit."""

    INERTIA = "inertia"
    VISCOUS = "viscous friction"
    FORCE = "force"
    STIFFNESS = "stiffness"
    COMPLIANCE = "compliance"
    FORCE_DRIFT = "force per time"
    VISCOUS_DRIFT = "viscous friction per time"
    POSITION = "position"
    VELOCITY = "velocity"
    TIME = "time"
    RATIO = "ratio"
    GAIN = "gain"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a joint, or of what surrounds it.

    Attributes:
        name: the field's term, as code and files say it.
        symbol: as tables and formulas say it.
        quantity: what it measures.
        free: whether it is identified; otherwise it keeps `start`.
        start: where the search begins, or the value that is kept; None lets the method find its own start.
        lower, upper: bounds on the value.
    """

    name: str
    symbol: str
    quantity: Quantity
    free: bool = True
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def fixed(self, value: float) -> Parameter:
        """Return this parameter kept at `value`."""
        return replace(self, free=False, start=float(value))
