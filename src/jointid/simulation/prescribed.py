"""A joint without its controller: the drive side.

The motor's motion is prescribed, the load is simulated, and the motor torque follows, independent
of the controller; the record needs the motor's position::

    0   = ZZ2 a12 + Fv2 v12 + Fc2 sign(v12) + K12 (q12 - q1) + F12 (v12 - v1)
    tau = ZZ1 a1  + Fv1 v1  + Fc1 sign(v1)  + K12 (q1 - q12) + F12 (v1 - v12) + offset

The load hangs on a spring and a damper from a moving point, which is equivalent to a fixed point and the force
``K12 q1 + F12 v1``. So the kernels serve with the load as first mass and a wall as second. They hold forces, so each
sample is cut into `PARTS` with the force ``mean(s) - h^2/12 s''``, which corrects for curvature. On the paper's axis
with components up to 60 Hz at 1 kHz the torque error is 6e-6, twenty times less than without
(tests/simulation/test_drive_side.py). A rigid joint's torque is its inverse model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models.joints import FlexibleJoint, Joint
from jointid.simulation.sensitivities import (
    coefficient_seeds,
    gravity_slope,
    start_slope,
    taped_rows,
)

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

    from jointid.simulation.kernels.drive import SampledLoop

PARTS = 4  # of a sample
_WALL = 1e200  # a Coulomb force that nothing overcomes, and whose square is still a number
_DEGREE = 7  # of the spline, odd: a cubic's second derivative errs by 3 % at a tenth of the sampling frequency
_PUSHING = ("stiffness", "damping")  # what the motor's motion pushes the load by
LOAD_STATE = ("initial_load_position", "initial_load_velocity")
"""The load's state at the first sample, beside where steady motion has it."""


@dataclass(frozen=True, slots=True)
class DriveSide:
    """A joint under prescribed motor motion: from motor position to torque.

    Attributes:
        joint: rigid, or flexible: then the load, which the record does not show, is simulated.
    """

    joint: Joint

    def __post_init__(self) -> None:
        self.joint.require_linear("The drive side takes")
        self.joint.require_no_ripple("The drive side takes", 'identify by the method "didim"', "load")

    @property
    def channels(self) -> tuple[str, ...]:
        """Required channels of a record."""
        return ("torque", "motor_position")


@dataclass(frozen=True, slots=True, eq=False)
class PrescribedMotion:
    """A motor's motion at the edges of the parts of its samples.

    Attributes:
        step: seconds from edge to edge.
        position, velocity, acceleration: (edges,).
        mean_position: (edges - 1,) mean over each part.
    """

    step: float
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    mean_position: FloatArray

    @property
    def pushes(self) -> tuple[FloatArray, FloatArray]:
        """Force on the load per unit of stiffness and of damping, in each part."""
        bend = self.step / 12
        by_stiffness = self.mean_position - bend * np.diff(self.velocity)
        by_damping = np.diff(self.position) / self.step - bend * np.diff(self.acceleration)
        return by_stiffness, by_damping


def prescribed_motion(position: FloatArray, sample_time: float, parts: int = PARTS) -> PrescribedMotion:
    """Return the motion through sampled positions, by an interpolating spline.

    Args:
        position: (samples,), smooth at the scale of a sample: filtered where the encoder is coarse.
        sample_time: seconds.
        parts: of a sample.
    """
    home = position[0]  # far from zero a spline would lose the digits that its derivatives need
    spline = spline_of(position - home, sample_time)
    edges = np.arange((position.size - 1) * parts + 1) * (sample_time / parts)
    integral = spline.antiderivative()(edges)
    return PrescribedMotion(
        sample_time / parts,
        np.asarray(spline(edges) + home),
        np.asarray(spline.derivative()(edges)),
        np.asarray(spline.derivative(2)(edges)),
        np.asarray(np.diff(integral) * (parts / sample_time) + home),
    )


def spline_of(position: FloatArray, sample_time: float) -> BSpline:
    """Interpolating spline through positions, (samples, ...), with accurate second derivative.

    Args:
        position: from home, smooth at the scale of a sample.
        sample_time: seconds.
    """
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(np.arange(len(position)) * sample_time, position, _DEGREE)


def part_means(position: FloatArray, velocity: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Means of position and rate over parts, (parts, ...) each, from values at the edges; `step` in s."""
    middle = 0.5 * (position[:-1] + position[1:]) - step / 12 * np.diff(velocity, axis=0)
    return middle, np.diff(position, axis=0) / step


def mean_friction(joint: Joint, velocity: FloatArray) -> FloatArray:
    """Columns of the motor's friction, averaged over parts, (parts, parameters).

    Velocity is linear within a part, so a reversal splits it.
    """
    before, after = velocity[:-1], velocity[1:]
    size = np.abs(before) + np.abs(after)
    share = np.where(before * after < 0, np.abs(after) / np.where(size > 0, size, 1.0), 1.0)[:, np.newaxis]
    # Away from a reversal the mean of a linear column is that of the middle, within the direction of the part.
    middle = joint.friction.columns(0.5 * (before + after))
    reversed_ = joint.friction.columns(0.5 * before) * (1 - share) + joint.friction.columns(0.5 * after) * share
    return np.where(share < 1.0, reversed_, middle)


@dataclass(frozen=True, slots=True, eq=False)
class DriveSideRun:
    """Mean torque of each part, and its derivatives.

    Attributes:
        torque: (parts,).
        derivatives: (parts, names).
        load_position, load_velocity: (parts + 1,) at the edges; None for a rigid joint.
        finished: False for values that no joint has, or a load too fast to be simulated; all else is then 0.
    """

    torque: FloatArray
    derivatives: FloatArray
    load_position: FloatArray | None
    load_velocity: FloatArray | None
    finished: bool


def simulate_drive_side(
    joint: Joint, motion: PrescribedMotion, values: Mapping[str, float], names: tuple[str, ...] = ()
) -> DriveSideRun:
    """Simulate the load under a prescribed motion; return the motor torque.

    Args:
        joint: rigid or flexible.
        motion: of the motor.
        values: every parameter of the joint by name; optionally those of `LOAD_STATE`.
        names: parameters, and entries of `LOAD_STATE`, to differentiate by.
    """
    acceleration = np.diff(motion.velocity) / motion.step
    friction = mean_friction(joint, motion.velocity)
    inertia, prefix = ("motor_inertia", "motor_") if joint.model == "flexible" else ("inertia", "")
    own = [inertia, *(p.name for p in joint.friction.parameters(prefix, "")), "offset"]
    columns = np.column_stack([acceleration, friction, np.ones(acceleration.size)])
    if joint.gravity is not None and joint.model == "rigid":
        own += [p.name for p in joint.gravity.parameters]
        columns = np.column_stack([columns, joint.gravity.columns(motion.mean_position)])
    if joint.ripple is not None:
        own += [p.name for p in joint.ripple.parameters]
        columns = np.column_stack([columns, joint.ripple.columns_at(motion.mean_position)])
    torque = columns @ np.array([values[name] for name in own])
    derivatives = np.zeros((torque.size, len(names)))
    for i, name in enumerate(names):
        if name in own:
            derivatives[:, i] = columns[:, own.index(name)]
    if not isinstance(joint, FlexibleJoint):
        return DriveSideRun(torque, derivatives, None, None, values[inertia] > 0)
    load = _Load.simulate(joint, motion, values)
    if load is None:
        nothing = np.zeros(motion.position.size)
        return DriveSideRun(0 * torque, 0 * derivatives, nothing, nothing, False)
    kept = [i for i, name in enumerate(names) if name not in own]
    spring, slopes = load.spring([names[i] for i in kept])
    derivatives[:, kept] = slopes
    return DriveSideRun(torque + spring, derivatives, load.states[:, 0], load.states[:, 1], True)


@dataclass(frozen=True, slots=True, eq=False)
class _Load:
    """A simulated load: states at the edges, and data for derivatives.

    Attributes:
        drive: (14,) the coefficients of the kernels.
        gravity: (5,) those of the load's gravity, as if it were the motor's, or None.
        push: (edges,) the force held in each part; one more part follows the last edge.
        states: (edges, 4) as the kernel left them: load position and velocity, and those of the wall.
        modes, tape: as the kernel left them; taped: rows of the tape.
    """

    joint: FlexibleJoint
    motion: PrescribedMotion
    values: Mapping[str, float]
    drive: FloatArray
    gravity: FloatArray | None
    push: FloatArray
    states: FloatArray
    modes: NDArray[np.int16]
    tape: FloatArray
    taped: int

    @classmethod
    def simulate(cls, joint: FlexibleJoint, motion: PrescribedMotion, values: Mapping[str, float]) -> _Load | None:
        """Simulate the load; None for impossible values or too fast dynamics."""
        from jointid.simulation.kernels import drive as kernels

        whole = joint.gravity_coefficients(values)
        drive, gravity = _drive(joint, values), None if whole is None else np.array([*whole[:4], 0.0])
        possible = np.all(np.isfinite(drive)) and min(drive[2:4]) >= 0 and drive[6] + drive[7] >= 0
        if not (possible and values["motor_inertia"] > 0 and drive[0] > 0):
            return None
        by_stiffness, by_damping = motion.pushes
        push = values["stiffness"] * by_stiffness + values["damping"] * by_damping
        push = np.append(push, push[-1])
        n, rows = push.size, taped_rows(motion.position.size)
        none = np.zeros(0)
        while True:
            states, modes, tape = np.empty((n, 4)), np.empty(n, dtype=np.int16), np.empty((rows, kernels.TAPE))
            trace = kernels.Trace(
                np.empty(n), np.empty((0, 1)), states, modes, np.empty((0, 2)), tape, np.zeros(4, dtype=np.int64)
            )
            status = kernels.run(
                drive, _sampled_loop(motion.step, push), float(push[0]), none, _start(joint, motion, values), math.inf,
                trace, kernels.NO_GRAVITY if gravity is None else gravity, kernels.NO_SEGMENTS,
            )  # fmt: skip
            steps = int(trace.counts[1])
            if status != kernels.FINISHED:
                return None
            if steps <= rows:  # else a load that turns round and sticks all the time
                break
            rows = steps
        return cls(joint, motion, values, drive, gravity, push, states, modes, tape, steps)

    def spring(self, names: list[str]) -> tuple[FloatArray, FloatArray]:
        """Force of spring and damper on the motor, (parts,), and derivatives, (parts, names)."""
        from jointid.simulation.kernels.drive_sensitivities import LANES

        stretch, slip = part_means(self.states[:, 0], self.states[:, 1], self.motion.step)
        stretch = self.motion.mean_position - stretch
        slip = np.diff(self.motion.position) / self.motion.step - slip
        stiffness, damping = self.values["stiffness"], self.values["damping"]
        if not names:
            return stiffness * stretch + damping * slip, np.zeros((stretch.size, 0))
        # What enters the push comes last in a block.
        order = sorted(range(len(names)), key=lambda i: names[i] in _PUSHING)
        blocks = (order[i : i + LANES] for i in range(0, len(order), LANES))
        followed = np.concatenate([self._differentiate([names[i] for i in block]) for block in blocks], axis=2)
        moved, moved_velocity = np.moveaxis(followed[:, :, np.argsort(order)], 1, 0)
        moved, moved_slip = part_means(moved, moved_velocity, self.motion.step)
        slopes = -stiffness * moved - damping * moved_slip
        for name, column in zip(_PUSHING, (stretch, slip), strict=True):
            if name in names:
                slopes[:, names.index(name)] += column
        return stiffness * stretch + damping * slip, slopes

    def _differentiate(self, names: list[str]) -> FloatArray:
        """Derivatives of position and velocity at the edges, (edges, 2, names).

        Parameters of the push come last.
        """
        from jointid.simulation.kernels import drive as kernels
        from jointid.simulation.kernels import drive_sensitivities as sensitivity_kernels

        width, n = sensitivity_kernels.LANES, self.push.size
        seeds, weights, start = np.zeros((14, width)), np.zeros((3, width)), np.zeros((4, width))
        pushes, own = dict(zip(_PUSHING, self.motion.pushes, strict=True)), [p.name for p in self.joint.parameters]
        explicit, by_name = [], coefficient_seeds(lambda at: _drive(self.joint, at), own)
        for j, name in enumerate(names):
            if name in LOAD_STATE:
                start[LOAD_STATE.index(name), j] = 1.0
                continue
            seeds[:, j] = by_name[name]
            weights[:, j] = gravity_slope(self.joint, name)
            start[:, j] = start_slope(lambda at: _start(self.joint, self.motion, at), self.values, name)
            if name in pushes:
                explicit.append(np.append(pushes[name], pushes[name][-1]))
        states = np.empty((n, 4, width))
        explained = np.column_stack([np.zeros((n, 0)), *explicit])[:, np.newaxis]
        columns = sensitivity_kernels.Columns(
            explained, len(names) - len(explicit), np.zeros(width), np.zeros((1, width)), start, np.zeros((0, width))
        )
        trace = kernels.Trace(
            self.push, np.empty((0, 1)), self.states, self.modes, np.empty((0, 2)), self.tape,
            np.zeros(4, dtype=np.int64),
        )  # fmt: skip
        slopes = sensitivity_kernels.Slopes(np.empty((width, n)), states)
        sensitivity_kernels.follow(
            _sampled_loop(self.motion.step, self.push), float(self.push[0]), trace, self.taped, self.drive, seeds,
            columns, slopes, kernels.NO_GRAVITY if self.gravity is None else self.gravity, weights, kernels.NO_SEGMENTS,
            np.zeros((0, kernels.SEGMENT, width)),
        )  # fmt: skip
        return states[:, :2, : len(names)]


def _sampled_loop(step: float, push: FloatArray) -> SampledLoop:
    """Return a force that is held in each part, as the kernels take it."""
    from jointid.simulation.kernels.drive import NO_FEEDBACK, SampledLoop

    lags = np.zeros(1, dtype=np.int64)
    return SampledLoop(np.array([step]), lags, NO_FEEDBACK, push[np.newaxis], np.zeros(push.size))


def _drive(joint: FlexibleJoint, values: Mapping[str, float]) -> FloatArray:
    """The load on its spring, fixed to a wall, for the kernels."""
    whole = joint.coefficients(values)
    return np.array([whole[1], 1.0, *whole[2:4], *whole[8:12], 0.0, 0.0, _WALL, _WALL, whole[13], 0.0])


def _start(joint: FlexibleJoint, motion: PrescribedMotion, values: Mapping[str, float]) -> FloatArray:
    """Initial kernel state: the load moves with the motor, plus `LOAD_STATE`."""
    steady = joint.start(values, float(motion.position[0]), float(motion.velocity[0]))[2:]
    beside = np.array([values.get(name, 0.0) for name in LOAD_STATE])
    return np.append(steady + beside, [0.0, 0.0])
