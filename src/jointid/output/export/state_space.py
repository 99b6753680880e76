"""Linear part of a joint as state space, for python-control and MATLAB.

With the motor's position and velocity, and the load's, as states and the torque tau as input::

    ZZ1 a1  = tau - Fv1 v1 - K12 (q1 - q12) - F12 (v1 - v12)
    ZZ2 a12 =     - Fv2 v12 + K12 (q1 - q12) + F12 (v1 - v12) - rate q12

`rate` is of a spring that carries the load (`models.position_forces`). A rigid joint has the first line alone, without
the spring. Coulomb friction, a weight that turns and constant forces are left out: it describes motion that does not
reverse, about a steady one.
"""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np

from jointid.common.errors import MethodError, extra
from jointid.common.transmission import Side
from jointid.estimation.result.estimate import Estimate
from jointid.models.linear import OUTPUTS, discretise, drive_matrices
from jointid.output.export.bodies import Model
from jointid.output.export.joint_model import JointModel

_MOST = 1000  # periods of delay: each is a state
_HEADER = 116  # bytes of text at the head of a .mat file, where SciPy writes the date


def linear_part(model: JointModel, period: float | None = None, delay: float = 0.0) -> dict[str, Any]:
    """Linear part of a joint, from torque to positions and velocities.

    It has the matrices of ``x' = A x + B u, y = C x + D u`` and the names of its `states` and `outputs`.
    With a period, in s, it is sampled with a zero-order hold on the torque, exact at the samples (`models.linear`),
    which acts after the delay, in s. Each delayed torque is a state, ``torque_1`` the newest.

    Raises:
        MethodError: a value is refused, no joint can have it, the spring is not linear, or a time is out of range.
    """
    model.joint.require_linear("A state space takes", spring_alone=True)
    masses, values, (_, _, _, rate) = model.masses.values(), model.values, model.weight
    A, b = drive_matrices(
        [mass.inertia for mass in masses], [mass.viscous for mass in masses],
        [(values.get("stiffness", 0.0), values.get("damping", 0.0))] * (len(masses) - 1), rate,
    )  # fmt: skip
    order, B, waiting = len(A), b[:, np.newaxis], 0
    if period is not None:
        if not 0 < period < math.inf or not 0 <= delay <= _MOST * period:
            raise MethodError(
                f"A state space is sampled with a positive period and a delay from 0 to {_MOST} of them; received "
                f"{period} s and {delay} s."
            )
        made = discretise(A, b, period, delay)
        waiting = made.waiting
        A, B = np.zeros((order + waiting, order + waiting)), np.zeros((order + waiting, 1))
        A[:order, :order] = made.transition
        for lag, column in ((made.whole, made.new), (made.whole + 1, made.old)):
            if lag == 0:
                B[:order, 0] = column
            elif lag <= waiting:
                A[:order, order + lag - 1] = column
        if waiting:
            B[order, 0] = 1.0
            A[order + 1 :, order:-1] = np.eye(waiting - 1)
    names = tuple(f"torque_{i + 1}" for i in range(waiting))
    C, D = np.eye(order, order + waiting), np.zeros((order, 1))
    states: tuple[str, ...] = (*OUTPUTS[:order], *names)
    return {"A": A, "B": B, "C": C, "D": D, "states": states, "outputs": states[:order]}


def state_space(
    estimate: Estimate, *, side: Side | None = None, period: float | None = None, delay: float = 0.0
) -> Any:
    """Linear part as `control.StateSpace`, from torque to positions and velocities.

    Args:
        estimate: of a joint, see `export`.
        side: of a transmission, for torque and motion; by default the identified side.
        period: s, to sample it with a zero-order hold on the torque; without it the system is continuous.
        delay: s, from a sample of the torque to its effect. Each delayed torque is a state.

    Raises:
        MethodError: a value is refused, no joint can have it, there is no such side, or a time is out of range.
        JointidError: python-control is not there.
    """
    control = extra("control", "models", "A state space")
    part = linear_part(JointModel.of(estimate, "joint").on(side), period, delay)
    names = {key: list(part[key]) for key in ("states", "outputs")}
    return control.ss(*(part[name] for name in "ABCD"), 0 if period is None else period, inputs=["torque"], **names)


def state_space_file(
    model: Model, *, period: float | None = None, delay: float | None = None
) -> tuple[bytes, list[str]]:
    """Bytes of a .mat file of the state space, and its losses.

    `period` and `delay`, in s, are by default those of the record and of the identification.

    Raises:
        MethodError: see `linear_part`.
    """
    from scipy.io import savemat

    assert model.alone is not None
    alone, settings = model.alone, model.alone.estimate.settings
    period = alone.estimate.data.sample_time if period is None else period
    delay = settings.delay if delay is None else delay
    lost = alone.lost("spring", "rate")
    remarks = model.remarks(lost, bodies=False)
    sampled = {"period": period, "delay": delay, **linear_part(alone, period, delay)}
    beside = {"motor_torque_to_input": alone.gear, "remarks": "\n".join(remarks)}
    made: Any = io.BytesIO()  # which SciPy takes as a file, whatever its types say
    savemat(made, {"continuous": linear_part(alone), "sampled": sampled, **beside})
    head = remarks[0].encode("ascii", "replace")[:_HEADER].ljust(_HEADER)
    return head + made.getvalue()[_HEADER:], lost
