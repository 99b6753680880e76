"""Linear model of a joint that moves in one direction.

While neither velocity changes its sign, Coulomb friction is constant, and the rest is linear::

    ZZ1 a1  + Fv1 v1  - K12 (q12 - q1) - F12 (v12 - v1) = tau
    ZZ2 a12 + Fv2 v12 + K12 (q12 - q1) + F12 (v12 - v1) + rate q12 = 0

A rigid joint has the first line alone, without the spring; of an elastic load (`springs.Spring`) a part of ZZ2 is
a third mass. `rate` is of a spring that carries the load
(`models.position_forces`), which acts on the motor's line of a rigid joint; a weight that turns is not linear.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.joints import Joint

ComplexArray: TypeAlias = NDArray[np.complex128]
Output: TypeAlias = Literal["motor_position", "motor_velocity", "load_position", "load_velocity"]

SNAP = 1e-6
"""Of a period: instants closer than this are the same, and a delay of nearly a whole number of periods is one."""

OUTPUTS: tuple[Output, ...] = ("motor_position", "motor_velocity", "load_position", "load_velocity")
"""The states of a flexible joint, in their order; a rigid one has the first two, an elastic load two more."""


def drive_matrices(
    inertia: Sequence[float], viscous: Sequence[float], springs: Sequence[tuple[float, float]], rate: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Matrices A, (states, states), and B, (states,), of the module's equation.

    Args:
        inertia: of the motor, of the load of a flexible joint, and of the swinging part of an elastic load.
        viscous: friction of each.
        springs: stiffness and damping between each and the next.
        rate: of a spring that carries the load.
    """
    count = len(inertia)
    ties, load = np.diff(np.eye(count), axis=0), min(count - 1, 1)
    K, D = (ties.T @ np.diag(one) @ ties for one in np.reshape(springs, (-1, 2)).T)
    K[load, load] += rate
    A, B, by = np.zeros((2 * count, 2 * count)), np.zeros(2 * count), np.array(inertia)[:, np.newaxis]
    A[::2, 1::2] = np.eye(count)
    A[1::2, ::2], A[1::2, 1::2] = -K / by, -(D + np.diag(viscous)) / by
    B[1] = 1.0 / inertia[0]
    return A, B


def hold_torque(A: FloatArray, B: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Transition over a time, and the effect of a held unit torque.

    Args:
        A: (..., states, states).
        B: (..., states).
        seconds: 0 or more.
    """
    from scipy.linalg import expm

    order = A.shape[-1]
    both = np.zeros((*A.shape[:-2], order + 1, order + 1))
    both[..., :order, :order], both[..., :order, order] = A * seconds, B * seconds
    made = np.asarray(expm(both), dtype=np.float64)
    return made[..., :order, :order], made[..., :order, order]


@dataclass(frozen=True, slots=True, eq=False)
class SampledDrive:
    """Sampled drive under a held torque with a delay of m+f periods.

    Exact (Astrom and Wittenmark, Computer-Controlled Systems, section 2.3; Franklin, Powell and Workman, Digital
    Control of Dynamic Systems, section 4.3), with Phi(t) = exp(A t) and G(t) the integral of Phi B until t::

        x[k+1] = Phi(T) x[k] + Phi((1-f) T) G(f T) u[k-m-1] + G((1-f) T) u[k-m]

    Attributes:
        transition: (..., states, states), Phi(T).
        new: (..., states) of u[k-m]. old: of the one before it.
        whole: m. partial: whether f, between 0 and 1, is not 0.
    """

    transition: FloatArray
    new: FloatArray
    old: FloatArray
    whole: int
    partial: bool

    @property
    def waiting(self) -> int:
        """Number of earlier commands that act at a sample or after it."""
        return self.whole + self.partial

    def of(self, chosen: slice) -> SampledDrive:
        """Select drives along the first axis."""
        return replace(self, transition=self.transition[chosen], new=self.new[chosen], old=self.old[chosen])


def discretise(A: FloatArray, B: FloatArray, period: float, delay: float) -> SampledDrive:
    """Discretise a drive under a held torque, exactly at the samples.

    Args:
        A: (..., states, states).
        B: (..., states).
        period: seconds, positive.
        delay: seconds from a sample of the torque to its effect, 0 or more.
    """
    whole = math.floor(delay / period + SNAP)
    late = max(delay - whole * period, 0.0)
    late = late if late > SNAP * period else 0.0
    first, into_first = hold_torque(A, B, late)
    then, into_then = hold_torque(A, B, period - late)
    return SampledDrive(then @ first, into_then, (then @ into_first[..., np.newaxis])[..., 0], whole, late > 0.0)


def sampled_position(drive: SampledDrive, turned: ComplexArray) -> ComplexArray:
    """Response of positions to the torque m periods earlier, (drives, points).

    With p = z - 1 and M = Phi - I it is ``adj(p I - M) (new + old / z) / det(p I - M)``: both polynomials of p, from
    Faddeev and Leverrier's recursion, for all points at once, where solving point by point takes ten times as long.
    The powers of p keep the digits that those of z, nearly 1 at the frequencies of a drive, would lose.

    Args:
        drive: with one axis of drives before the states.
        turned: (points,) of w T i, the logarithm of z.
    """
    order = drive.transition.shape[-1]
    unit = np.eye(order)
    M = drive.transition - unit
    p, later = np.expm1(turned), np.exp(-turned)
    N = np.broadcast_to(unit, M.shape)
    above = np.zeros((len(M), turned.size), dtype=np.complex128)
    below = np.ones_like(above)
    for k in range(1, order + 1):
        new, old = (np.einsum("js,js->j", N[:, 0], B)[:, np.newaxis] for B in (drive.new, drive.old))
        above = above * p + new + old * later
        MN = M @ N
        c = -np.trace(MN, axis1=1, axis2=2) / k
        below = below * p + c[:, np.newaxis]
        N = MN + c[:, np.newaxis, np.newaxis] * unit
    return np.asarray(above / below)


@dataclass(frozen=True, slots=True, eq=False)
class LinearJoints:
    """Several joints of one model, linear.

    Attributes:
        A: (joints, states, states) of position and velocity of the motor, and of the load of a flexible joint.
        B: (joints, states) of the torque.
    """

    A: FloatArray
    B: FloatArray

    @property
    def modes(self) -> FloatArray:
        """Frequencies, Hz, and damping ratios, (joints, 2, 2); empty without oscillating modes.

        The first is that of the pole, motor and load against each other; the second of the zero, the load alone.
        """
        if self.A.shape[1] == 2:
            return np.zeros((len(self.A), 0, 2))
        poles = np.linalg.eigvals(self.A)
        last = np.take_along_axis(poles, np.argmax(np.abs(poles), axis=1)[:, np.newaxis], axis=1)[:, 0]
        rate = np.abs(last)
        load = np.sqrt(np.abs(self.A[:, 3, 2]))
        pairs = [(rate, -last.real / rate), (load, -0.5 * self.A[:, 3, 3] / load)]
        return np.stack([np.column_stack([w / (2 * math.pi), ratio]) for w, ratio in pairs], axis=1)


def linear_joints(joint: Joint, candidates: Sequence[Mapping[str, float]]) -> LinearJoints:
    """Linear models of moving joints; direction-dependent friction gives two of each.

    Args:
        joint: the model.
        candidates: every parameter of it by name, one mapping for each joint.
    """
    ways = (0, 1) if joint.friction.two_ways else (0,)  # forwards, backwards
    made = []
    for values in candidates:
        share = values.get("swinging_share", 0.0)
        inertia = [values[f"{side}inertia"] for side in joint.sides]
        inertia[1:] = [part * one for one in inertia[1:] for part in ((1.0 - share, share) if share else (1.0,))]
        ties = [(values[f"{of}stiffness"], values[f"{of}damping"]) for of in ("", "swinging_")[: len(inertia) - 1]]
        rate = 0.0 if joint.gravity is None else joint.gravity.coefficients(values)[3]
        for way in ways:
            viscous = [joint.friction.directions(values, side)[way] for side in joint.sides]
            made.append(drive_matrices(inertia, (*viscous, 0.0)[: len(inertia)], ties, rate))
    return LinearJoints(np.array([A for A, _ in made]), np.array([B for _, B in made]))


def frequency_response(
    joint: Joint, values: Mapping[str, float], hertz: FloatArray, output: Output = "motor_velocity"
) -> ComplexArray:
    """Continuous frequency response of a joint to torque, moving one way.

    Args:
        joint: rigid or flexible; the load of a rigid one moves with the motor.
        values: every parameter of the joint by name, SI, on the joint's side.
        hertz: (frequencies,) positive.
        output: the signal: "motor_position", "motor_velocity", "load_position" or "load_velocity".

    Returns:
        (frequencies,) complex, in m, rad, m/s or rad/s per N or N m.

    Raises:
        MethodError: the output is not one of these, or a frequency is not positive.

    Example:
        >>> import numpy as np, jointid as ji
        >>> from jointid.models.linear import frequency_response
        >>> values = {"inertia": 2.0, "viscous": 0.0, "coulomb": 1.0, "offset": 0.0}
        >>> response = frequency_response(ji.RigidJoint("prismatic"), values, np.array([1.0]))
        >>> print(round(float(abs(response[0])), 6))  # 1 / (2 pi f J)
        0.079577
    """
    hertz = np.asarray(hertz, dtype=np.float64)
    if output not in OUTPUTS or hertz.ndim != 1 or not np.all(hertz > 0):
        raise MethodError(
            f"A frequency response is of {', '.join(OUTPUTS)} at a row of positive frequencies in Hz; received "
            f'"{output}" and {hertz}.'
        )
    made = linear_joints(joint, [values])
    systems = 2j * math.pi * hertz[:, np.newaxis, np.newaxis] * np.eye(made.A.shape[1]) - made.A[0]
    states = np.linalg.solve(systems, np.tile(made.B[0][:, np.newaxis], (hertz.size, 1, 1)))[..., 0]
    return np.asarray(states[:, OUTPUTS.index(output) % states.shape[1]])
