"""The loop of a sampled law and of joints under it: its response where it is cut open, and whether it is stable.

The loop is cut at the torque: ``L(z) = -F(z) P(z)``, F the law's answer to the motor position and P the joint's sampled
one. Limits do not act. A law whose parts run at several rates has no single response: L then has its part at the
frequency itself, and the images that the slower loop makes of it are left out; its stability is exact all the same,
over a whole cycle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models.controllers import POSITION, SampledLaw
from jointid.models.linear import ComplexArray
from jointid.tuning.plant import SampledJoints


def loop_response(law: SampledLaw, position: ComplexArray, hertz: FloatArray) -> ComplexArray:
    """Return L of several joints, (joints, frequencies).

    Args:
        law: the controller's, as the joint sees it.
        position: (joints, frequencies) what the joints' sampled positions answer, `SampledJoints.response`.
        hertz: (frequencies,) up to half the sampling frequency.
    """
    feedback, _ = law.split()
    return np.asarray(-feedback.feedback(hertz) * position)


def spectral_radius(law: SampledLaw, joints: SampledJoints) -> FloatArray:
    """Return the size of the closed loops' largest eigenvalue over a cycle, (joints,); stable below 1."""
    (feedback, _), drive = law.split(), joints.drive
    reaching = _states_reaching_torque(feedback)
    order, states, waiting = int(np.sum(reaching)), drive.transition.shape[1], drive.waiting
    size = states + order + waiting
    cycle = np.broadcast_to(np.eye(size), (len(drive.transition), size, size))
    for phase in range(law.phases):
        A, B = feedback.A[phase][np.ix_(reaching, reaching)], feedback.B[phase, reaching, POSITION]
        C, D = feedback.C[phase, law.output, reaching], feedback.D[phase, law.output, POSITION]
        step = np.zeros((len(drive.transition), size, size))
        torque = np.zeros(size)  # of the period, from all states
        torque[0], torque[states : states + order] = D, C
        step[:, :states, :states] = drive.transition
        for late, into in ((drive.whole, drive.new), (drive.whole + 1, drive.old)):
            if late == 0:
                step[:, :states] += into[..., np.newaxis] * torque
            elif late <= waiting:
                step[:, :states, states + order + late - 1] += into
        step[:, states : states + order, 0], step[:, states : states + order, states : states + order] = B, A
        if waiting:
            step[:, states + order] = torque
            for i in range(1, waiting):
                step[:, states + order + i, states + order + i - 1] = 1.0
        cycle = step @ cycle
    return np.asarray(np.max(np.abs(np.linalg.eigvals(cycle)), axis=1))


def _states_reaching_torque(law: SampledLaw) -> NDArray[np.bool_]:
    """Return which states reach the torque: an integral of no weight may grow without effect."""
    reaching = np.any(law.C[:, law.output] != 0.0, axis=0)
    edges = np.any(law.A != 0.0, axis=0)  # (to, from)
    while not np.array_equal(more := reaching | (reaching @ edges), reaching):
        reaching = more
    return np.asarray(reaching)
