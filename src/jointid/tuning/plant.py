"""A joint as its loop sees it: linear while it moves one way, and sampled exactly under a torque that is held.

While neither velocity changes its sign Coulomb friction is a constant, and what is left is linear::

    ZZ1 a1  + Fv1 v1  - K12 (q12 - q1) - F12 (v12 - v1) = tau
    ZZ2 a12 + Fv2 v12 + K12 (q12 - q1) + F12 (v12 - v1) = 0

Gravity that follows the position is left out: it is a weak spring, far below the frequencies at which margins are read.
A controller's torque acts (d + f) periods after the position it follows from, d whole ones and a share f of one more,
and is held for a period, so that with Phi(t) = exp(A t) and G(t) the integral of Phi B until t::

    x[k+1] = Phi(T) x[k] + Phi((1-f) T) G(f T) u[k-d-1] + G((1-f) T) u[k-d]

is exact (Astrom and Wittenmark, Computer-Controlled Systems, section 2.3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.errors import MethodError
from jointid.data.record import FloatArray
from jointid.model.controllers import SampledLaw
from jointid.model.joints import FlexibleJoint, Joint

ComplexArray: TypeAlias = NDArray[np.complex128]
Output: TypeAlias = Literal["motor_position", "motor_velocity", "load_position", "load_velocity"]

_SNAP = 1e-6  # of a period: a delay so near to a whole number of them is one
_OUTPUTS: tuple[Output, ...] = ("motor_position", "motor_velocity", "load_position", "load_velocity")


@dataclass(frozen=True, slots=True, eq=False)
class LinearJoints:
    """Several joints of one model, linear.

    Attributes:
        A: (joints, states, states) of position and velocity of the motor, and of the load where there is a spring.
        B: (joints, states) of the torque.
    """

    A: FloatArray
    B: FloatArray

    @property
    def modes(self) -> FloatArray:
        """Frequency in Hz and damping ratio of the oscillating poles and zeros, (joints, 2, 2); empty without any.

        The first is that of the pole, motor and load against each other; the second of the zero, the load alone.
        """
        if self.A.shape[1] == 2:
            return np.zeros((len(self.A), 0, 2))
        poles = np.linalg.eigvals(self.A)
        last = np.take_along_axis(poles, np.argmax(np.abs(poles), axis=1)[:, np.newaxis], axis=1)[:, 0]
        rate = np.abs(last)
        load = np.sqrt(-self.A[:, 3, 2])
        pairs = [(rate, -last.real / rate), (load, -0.5 * self.A[:, 3, 3] / load)]
        return np.stack([np.column_stack([w / (2 * math.pi), ratio]) for w, ratio in pairs], axis=1)


def linear_joints(joint: Joint, candidates: Sequence[Mapping[str, float]]) -> LinearJoints:
    """Return joints as they are while they move: friction that differs with the direction gives two of each.

    Args:
        joint: the model.
        candidates: every parameter of it by name, one mapping for each joint.
    """
    ways = (0,) if joint.friction.symmetric else (0, 1)
    made = [
        _linear(joint.coefficients(values), way, isinstance(joint, FlexibleJoint))
        for values in candidates
        for way in ways
    ]
    return LinearJoints(np.array([A for A, _ in made]), np.array([B for _, B in made]))


def _linear(c: FloatArray, way: int, flexible: bool) -> tuple[FloatArray, FloatArray]:
    """Return the matrices of a drive (`Joint.coefficients`) that moves forwards (0) or backwards (1)."""
    motor, load, spring, damper, own, its = c[0], c[1], c[2], c[3], c[4 + way], c[8 + way]
    if not flexible:
        return np.array([[0.0, 1.0], [0.0, -own / motor]]), np.array([0.0, 1.0 / motor])
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-spring / motor, -(own + damper) / motor, spring / motor, damper / motor],
            [0.0, 0.0, 0.0, 1.0],
            [spring / load, damper / load, -spring / load, -(its + damper) / load],
        ]
    )
    return A, np.array([0.0, 1.0 / motor, 0.0, 0.0])


def frequency_response(
    joint: Joint, values: Mapping[str, float], hertz: FloatArray, output: Output = "motor_velocity"
) -> ComplexArray:
    """Return the response of a joint to its torque, in continuous time, while it moves one way (forwards).

    Args:
        joint: rigid or flexible; the load of a rigid one moves with the motor.
        values: every parameter of the joint by name, SI, on the joint's side.
        hertz: (frequencies,) positive.
        output: what answers: "motor_position", "motor_velocity", "load_position" or "load_velocity".

    Returns:
        (frequencies,) complex, in m, rad, m/s or rad/s per N or N m.

    Raises:
        MethodError: the output is not one of these, or a frequency is not positive.

    Example:
        >>> import numpy as np, jointid as ji
        >>> values = {"inertia": 2.0, "viscous": 0.0, "coulomb": 1.0, "offset": 0.0}
        >>> response = ji.frequency_response(ji.RigidJoint(), values, np.array([1.0]))
        >>> print(round(float(abs(response[0])), 6))  # 1 / (2 pi f J)
        0.079577
    """
    hertz = np.asarray(hertz, dtype=np.float64)
    if output not in _OUTPUTS or hertz.ndim != 1 or not np.all(hertz > 0):
        raise MethodError(
            f"A frequency response is of {', '.join(_OUTPUTS)} at a row of positive frequencies in Hz; received "
            f'"{output}" and {hertz}.'
        )
    made = linear_joints(joint, [values])
    A, B = made.A[0], made.B[0]
    s = 2j * math.pi * hertz
    states = np.linalg.solve(
        s[:, np.newaxis, np.newaxis] * np.eye(len(A)) - A, np.broadcast_to(B[:, np.newaxis], (hertz.size, len(B), 1))
    )
    return np.asarray(states[:, _OUTPUTS.index(output) % len(A), 0])


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
    first, into_first = _held(joints, share * law.period)
    then, into_then = _held(joints, (1.0 - share) * law.period)
    old = (then @ into_first[..., np.newaxis])[..., 0]
    return SampledJoints(then @ first, into_then, old, whole, share > 0.0, law.period)


def _held(joints: LinearJoints, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition over a time, and what a torque of 1 held for it adds, of every joint."""
    from scipy.linalg import expm

    count, order = joints.B.shape
    whole = np.zeros((count, order + 1, order + 1))
    whole[:, :order, :order], whole[:, :order, order] = joints.A * seconds, joints.B * seconds
    made = np.asarray(expm(whole), dtype=np.float64)
    return made[:, :order, :order], made[:, :order, order]
