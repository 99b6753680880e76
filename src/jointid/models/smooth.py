"""Numbers of the smooth laws: what a friction or a spring has beside its lines.

A law of friction or of a spring states them (`Friction.smooth`, `Spring.smooth`). Where a joint has any, its motion is
integrated in steps of a stated error; all else is exact.
"""

from __future__ import annotations

from typing import NamedTuple


class SmoothFriction(NamedTuple):
    """Numbers of a smooth friction law on one side, beside its lines.

    Attributes:
        presliding: the displacement over which the Coulomb force winds up, m or rad; 0 of one that sticks.
        viscous_drift: by how much the viscous coefficient grows per second.
        coulomb_drift: by how much the Coulomb force grows per second.
        per_torque: the share of a torque that the Coulomb force grows by: on the load's side of the spring's, on the
            motor's of the motor's.
    """

    presliding: float = 0.0
    viscous_drift: float = 0.0
    coulomb_drift: float = 0.0
    per_torque: float = 0.0


class SmoothSpring(NamedTuple):
    """Numbers of a smooth spring, beside its line.

    Attributes:
        cubic: torque per cube of the deflection.
        slider: stiffness of what winds up beside the spring.
        slips: torque at which that slips.
        swing_share: share of an elastic load that swings on a spring of its own.
        swing_stiffness: of that spring.
        swing_damping: of that spring.
    """

    cubic: float = 0.0
    slider: float = 0.0
    slips: float = 0.0
    swing_share: float = 0.0
    swing_stiffness: float = 0.0
    swing_damping: float = 0.0
