"""Joints as their loop sees them: sampled exactly under a torque that is held, and late (`models.linear.SampledDrive`).

Gravity that follows the position is left out: it is a weak spring, far below the frequencies at which margins are read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import SampledLaw
from jointid.models.linear import ComplexArray, LinearJoints, SampledDrive, discretise


@dataclass(frozen=True, slots=True, eq=False)
class SampledJoints:
    """Joints sampled for laws of one period and delay.

    Attributes:
        drive: of all joints, (joints, ...).
        period: seconds.
    """

    drive: SampledDrive
    period: float

    def response(self, hertz: FloatArray) -> ComplexArray:
        """Return the response of the sampled motor position to the law's torque, (joints, frequencies)."""
        z = np.exp(2j * math.pi * hertz * self.period)
        drive = self.drive
        found = np.empty((len(drive.transition), hertz.size), dtype=np.complex128)
        eye = np.eye(drive.transition.shape[1])
        for i, (transition, new, old) in enumerate(zip(drive.transition, drive.new, drive.old, strict=True)):
            driven = new + old / z[:, np.newaxis]
            found[i] = np.linalg.solve(z[:, np.newaxis, np.newaxis] * eye - transition, driven[..., np.newaxis])[
                :, 0, 0
            ]
        return np.asarray(found * z**-drive.whole)


def sample_joints(joints: LinearJoints, law: SampledLaw) -> SampledJoints:
    """Sample joints exactly, for a law."""
    return SampledJoints(discretise(joints.A, joints.B, law.period, law.delay), law.period)
