"""What a joint has beyond pieces of lines, as the simulation in steps takes it (`simulation.kernels.stepped_drive`).

A law of friction or of a spring names its numbers here (`Friction.beyond`, `Spring.beyond`). Where a joint has any, its
motion is followed by Taylor series, in steps of a controlled error; all else is exact.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jointid.common.arrays import FloatArray

SPRING = ("cubic", "slider", "slips")
"""Cubic stiffness; stiffness and limit of what winds up beside the spring."""
LOAD = ("swing_share", "swing_stiffness", "swing_damping")
"""Share of an elastic load that swings on a spring of its own, its stiffness and its damping."""
SIDE = ("presliding", "drift", "fade", "per_torque")
"""Of the friction of one side: the displacement it winds up over; by how much the viscous and the Coulomb friction grow
per second; the share of the spring's torque."""


def beyond_pieces(spring: Mapping[str, float], motor: Mapping[str, float], load: Mapping[str, float]) -> FloatArray:
    """Return the numbers of a joint beyond its coefficients, (13,), 0 where it has none.

    Args:
        spring: by the names of `SPRING` and of `LOAD`.
        motor: by those of `SIDE`.
        load: the same.
    """
    of_spring = [spring.get(name, 0.0) for name in SPRING]
    winds_up, viscous, coulomb = ([side.get(name, 0.0) for side in (motor, load)] for name in SIDE[:3])
    swings = [spring.get(name, 0.0) for name in LOAD]
    return np.array([*of_spring, *winds_up, load.get("per_torque", 0.0), *viscous, *swings, *coulomb])


def swinging_part(beyond: FloatArray | None) -> tuple[float, float, float]:
    """Return share, stiffness and damping of what swings on a load; zeros of one that is rigid."""
    if beyond is None:
        return 0.0, 0.0, 0.0
    share, stiffness, damping = beyond[8:11].tolist()
    return share, stiffness, damping
