"""Joints as their loop sees them: sampled exactly under a torque that is held.

Gravity that follows the position is left out: it is a weak spring, far below the frequencies at which margins are read.
A controller's torque acts (d + f) periods after the position it follows from, d whole ones and a share f of one more,
and is held for a period, so that with Phi(t) = exp(A t) and G(t) the integral of Phi B until t::

    x[k+1] = Phi(T) x[k] + Phi((1-f) T) G(f T) u[k-d-1] + G((1-f) T) u[k-d]

is exact (Astrom and Wittenmark, Computer-Controlled Systems, section 2.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.data.record import FloatArray
from jointid.model.controllers import SampledLaw
from jointid.model.linear import ComplexArray, LinearJoints, held

_SNAP = 1e-6  # of a period: a delay so near to a whole number of them is one


@dataclass(frozen=True, slots=True, eq=False)
class SampledJoints:
    """Joints as a law of one period and delay sees them (the module's equation).

    Attributes:
        transition: (joints, states, states), of a period.
        new: (joints, states) of the torque u[k - whole]. old: of the one before it.
        whole: periods of delay. partial: whether there is a share of one more.
        period: seconds.
    """

    transition: FloatArray
    new: FloatArray
    old: FloatArray
    whole: int
    partial: bool
    period: float

    @property
    def waiting(self) -> int:
        """How many torques that were put out are still to act, or acting, when the next is evaluated."""
        return self.whole + self.partial

    def response(self, hertz: FloatArray) -> ComplexArray:
        """Return what the sampled motor position answers to the law's torque, (joints, frequencies)."""
        z = np.exp(2j * math.pi * hertz * self.period)
        found = np.empty((len(self.transition), hertz.size), dtype=np.complex128)
        eye = np.eye(self.transition.shape[1])
        late = z**-self.whole
        for i, (transition, new, old) in enumerate(zip(self.transition, self.new, self.old, strict=True)):
            driven = new + old / z[:, np.newaxis]
            found[i] = np.linalg.solve(z[:, np.newaxis, np.newaxis] * eye - transition, driven[..., np.newaxis])[
                :, 0, 0
            ]
        return np.asarray(found * late)


def sampled_joints(joints: LinearJoints, law: SampledLaw) -> SampledJoints:
    """Return joints as a law sees them, exactly."""
    late = law.delay / law.period
    whole = math.floor(late + _SNAP)
    share = max(late - whole, 0.0)
    share = 0.0 if share < _SNAP else share
    first, into_first = held(joints.A, joints.B, share * law.period)
    then, into_then = held(joints.A, joints.B, (1.0 - share) * law.period)
    old = (then @ into_first[..., np.newaxis])[..., 0]
    return SampledJoints(then @ first, into_then, old, whole, share > 0.0, law.period)
