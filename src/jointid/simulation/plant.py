"""The numbers of a joint for `kernels.engine`: its masses, its springs, and the forces that follow a position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.joints import Joint
from jointid.models.smooth import SmoothFriction, SmoothLaws

_IMAGINARY = 1e-30  # a complex step: its square is nothing beside any value


class Plant(NamedTuple):
    """Numbers of a joint, in the columns of `kernels.engine`.

    Attributes:
        masses: (n, MASS) of the motor, of the load, and of the part of an elastic load that swings.
        springs: (n - 1, SPRING) each between a mass and the next.
        places: (forces, 5) gravity and ripple.
    """

    masses: FloatArray
    springs: FloatArray
    places: FloatArray

    def is_possible(self, duration: float) -> bool:
        """Test for positive masses, and for springs and friction that are never negative."""
        if not all(np.all(np.isfinite(one)) for one in self):
            return False
        inertia, _, _, _, coulomb, coulomb_back, winding, _, drift, per_torque = self.masses.T
        fades = np.minimum(drift, 0.0) * duration
        holds = np.all((drift >= 0) | (np.minimum(coulomb, coulomb_back) + fades >= 0)) and np.all(winding >= 0)
        sliding = self.springs[:, 3:]
        return bool(
            holds and np.all(inertia > 0) and np.all((per_torque >= 0) & (per_torque < 1)) and np.all(sliding >= 0)
            and np.all(self.springs[:, :2] >= 0)
        )  # fmt: skip


def plant_of(joint: Joint, values: Mapping[str, Any]) -> Plant:
    """Return the numbers of a joint whose laws are not lines; complex ones of complex values."""
    laws = joint.smooth(values)
    assert laws is not None
    return plant_of_numbers(joint.coefficients(values), laws, joint.places(values), joint.model == "flexible")


def plant_of_numbers(drive: FloatArray, laws: SmoothLaws, places: FloatArray, flexible: bool) -> Plant:
    """Return the numbers from the coefficients of a joint, (14,), and what its laws have beside their lines."""
    spring = laws.spring
    if np.real(spring.swing_share) < 0.0:
        drive = np.full(drive.shape, math.nan)
    masses, springs = [_mass(drive[0], drive[12], drive[4:8], laws.motor)], []
    if flexible:
        slides = spring.slider / spring.slips if spring.slips != 0.0 else (math.nan if spring.slider != 0.0 else 0.0)
        springs.append([drive[2], drive[3], spring.cubic, spring.slips, slides])
        load, share = drive[1], spring.swing_share
        if np.real(share) > 0.0 or spring.swing_stiffness + spring.swing_damping == 0.0:
            load = (1.0 - share) * load  # a share that is just beginning moves with the load on its spring
        masses.append(_mass(load, drive[13], drive[8:12], laws.load))
        if np.real(share) > 0.0:
            springs.append([spring.swing_stiffness, spring.swing_damping, 0.0, 0.0, 0.0])
            masses.append(_mass(share * drive[1], 0.0, np.zeros(4), SmoothFriction()))
    return Plant(np.array(masses), np.array(springs).reshape(-1, 5), places)


def seeds_of(joint: Joint, values: Mapping[str, float], name: str) -> Plant:
    """Return the derivatives of the numbers by a parameter, by a complex step."""
    moved = plant_of(joint, {**values, name: complex(values[name], _IMAGINARY)})
    return Plant(*(np.imag(one) / _IMAGINARY for one in moved))


def _mass(inertia: Any, offset: Any, friction: FloatArray, smooth: SmoothFriction) -> list[Any]:
    """Return the row of a mass, of its lines and of what its friction has beside them."""
    winding = 1.0 / smooth.presliding if smooth.presliding != 0.0 else 0.0
    drifts = smooth.viscous_drift, smooth.coulomb_drift
    return [inertia, offset, *friction, winding, *drifts, smooth.per_torque]
