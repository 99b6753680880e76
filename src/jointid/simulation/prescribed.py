"""A joint without its controller: the drive side.

The motor's motion is prescribed, the load is simulated, and the motor torque follows, independent
of the controller; the record needs the motor's position::

    0   = ZZ2 a12 + Fv2 v12 + Fc2 sign(v12) + K12 (q12 - q1) + F12 (v12 - v1)
    tau = ZZ1 a1  + Fv1 v1  + Fc1 sign(v1)  + K12 (q1 - q12) + F12 (v1 - v12) + offset

The load is simulated as in the loop (`kernels.engine`): the motor is so heavy that nothing moves it but a torque that
gives it its own acceleration, which is held in each part of a sample. Where it then is at the parts' ends is right to
the fourth order, by the velocity ``v - h^2/12 v''`` there: what the straight line through velocities takes from a
curved motion (Euler and Maclaurin) is put back. On the paper's axis with components up to 60 Hz at 1 kHz the torque
error is below 1e-5 (tests/simulation/test_drive_side.py). A rigid joint's torque is its inverse model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.joints import FlexibleJoint, Joint
from jointid.simulation.sensitivities import start_slope

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

    from jointid.simulation.kernels.engine import Plant
    from jointid.simulation.plant import Integrated

PARTS = 4  # of a sample: with 2 a viscous friction of loads that stick errs by 2e-3 instead of 1e-3
_DEGREE = 7  # of the spline, odd: a cubic's second derivative errs by 3 % at a tenth of the sampling frequency
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
        position, velocity: (edges,).
        joined: (edges,) the velocities that the held accelerations join (see the module).
    """

    step: float
    position: FloatArray
    velocity: FloatArray
    joined: FloatArray

    @property
    def mean_position(self) -> FloatArray:
        """Mean over each part, (edges - 1,)."""
        return part_means(self.position, self.velocity, self.step)[0]

    def from_rest(self) -> PrescribedMotion:
        """Return the motion with no velocity at the first sample."""
        velocity, joined = self.velocity.copy(), self.joined.copy()
        velocity[0] = joined[0] = 0.0
        return replace(self, velocity=velocity, joined=joined)


def prescribed_motion(position: FloatArray, sample_time: float, parts: int = PARTS) -> PrescribedMotion:
    """Return the motion through sampled positions, by an interpolating spline.

    Args:
        position: (samples,), smooth at the scale of a sample: filtered where the encoder is coarse.
        sample_time: seconds.
        parts: of a sample.
    """
    step = sample_time / parts
    edges, velocity, _, joined = motion_at_edges(position, sample_time, parts)
    return PrescribedMotion(step, edges, velocity, joined)


def motion_at_edges(
    position: FloatArray, sample_time: float, parts: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and accelerations at the edges of parts, and what held accelerations join.

    The positions, (samples, ...), are those of `PrescribedMotion`, as are the results, (edges, ...).
    """
    home, step = position[0], sample_time / parts  # far from zero a spline would lose digits of its derivatives
    spline = spline_of(position - home, sample_time)
    edges = np.arange((len(position) - 1) * parts + 1) * step
    velocity = np.asarray(spline.derivative()(edges))
    joined = velocity - step**2 / 12.0 * np.asarray(spline.derivative(3)(edges))
    return np.asarray(spline(edges) + home), velocity, np.asarray(spline.derivative(2)(edges)), joined


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
    inertia, prefix = ("motor_inertia", "motor_") if joint.model == "flexible" else ("inertia", "")
    own = [inertia, *(p.name for p in joint.friction.parameters(prefix, "")), "offset"]
    columns = np.column_stack([acceleration, mean_friction(joint, motion.velocity), np.ones(acceleration.size)])
    if joint.gravity is not None and joint.model == "rigid":
        own += [p.name for p in joint.gravity.parameters]
        columns = np.column_stack([columns, joint.gravity.columns(motion.mean_position)])
    if joint.ripple is not None:
        own += [p.name for p in joint.ripple.parameters]
        columns = np.column_stack([columns, joint.ripple.columns_at(motion.mean_position)])
    torque = columns @ np.array([values[name] for name in own])
    derivatives = np.zeros((torque.size, len(names)))
    for name in set(own).intersection(names):
        derivatives[:, names.index(name)] = columns[:, own.index(name)]
    if not isinstance(joint, FlexibleJoint):
        return DriveSideRun(torque, derivatives, None, None, values[inertia] > 0)
    load = _Load.simulate(joint, motion, values)
    if load is None:
        nothing = np.zeros(motion.position.size)
        return DriveSideRun(0 * torque, 0 * derivatives, nothing, nothing, False)
    kept = [i for i, name in enumerate(names) if name not in own]
    spring, slopes = load.spring([names[i] for i in kept])
    derivatives[:, kept] = slopes
    return DriveSideRun(torque + spring, derivatives, load.states[:, 2], load.states[:, 3], True)


@dataclass(frozen=True, slots=True, eq=False)
class _Load:
    """A simulated load.

    Attributes:
        plant: motor and load, as the engine left them.
        run: of the engine.
        states: (edges, 4) positions and velocities of motor and load.
    """

    joint: FlexibleJoint
    motion: PrescribedMotion
    values: Mapping[str, float]
    plant: Plant
    run: Integrated
    states: FloatArray

    @classmethod
    def simulate(cls, joint: FlexibleJoint, motion: PrescribedMotion, values: Mapping[str, float]) -> _Load | None:
        """Simulate the load; None for impossible values or too fast dynamics."""
        from jointid.simulation.kernels.drive import FINISHED
        from jointid.simulation.plant import heavy_plant, is_possible, motion_of, move_motors

        plant, edges = heavy_plant(joint, values), motion.position.size
        if not (values["motor_inertia"] > 0 and is_possible(plant, edges * motion.step)):
            return None
        start, joined = _start(joint, motion, values), motion.joined[:, np.newaxis]
        run = move_motors(plant, None, np.zeros((0, 10)), joined, motion.step, start[::2], start[1::2])
        if run.status != FINISHED:
            return None
        position, velocity, *_ = motion_of(run.tape, 2, edges)
        return cls(joint, motion, values, plant, run, np.stack([position, velocity], axis=2).reshape(edges, 4))

    def spring(self, names: list[str]) -> tuple[FloatArray, FloatArray]:
        """Force of spring and damper on the motor, (parts,), and derivatives, (parts, names)."""
        apart = self.states[:, :2] - self.states[:, 2:]
        stretch, slip = part_means(apart[:, 0], apart[:, 1], self.motion.step)
        stiffness, damping = self.values["stiffness"], self.values["damping"]
        force = stiffness * stretch + damping * slip
        if not names:
            return force, np.zeros((stretch.size, 0))
        moved, moved_velocity = self._differentiate(names).swapaxes(0, 1)
        moved, moved_slip = part_means(moved, moved_velocity, self.motion.step)
        slopes = -stiffness * moved - damping * moved_slip
        for name, column in (("stiffness", stretch), ("damping", slip)):
            if name in names:
                slopes[:, names.index(name)] += column
        return force, slopes

    def _differentiate(self, names: list[str]) -> FloatArray:
        """Derivatives of the load's position and velocity at the edges, (edges, 2, names)."""
        from jointid.simulation.kernels.drive_sensitivities import LANES, Moved, Slopes
        from jointid.simulation.kernels.variation import follow
        from jointid.simulation.plant import NO_LINKS, heavy_plant, pack_seeds, pass_on, plant_seeds

        if len(names) > LANES:
            return np.dstack([self._differentiate(names[:LANES]), self._differentiate(names[LANES:])])
        edges, start, own = len(self.states), np.zeros((4, LANES)), {p.name for p in self.joint.parameters}
        for j, name in enumerate(names):
            if name in own:
                start[:, j] = start_slope(lambda at: _start(self.joint, self.motion, at), self.values, name)
            else:
                start[2 + LOAD_STATE.index(name), j] = 1.0
        values = {name: self.values[name] for name in own}
        seeds = pack_seeds(self.plant, None, plant_seeds(partial(heavy_plant, self.joint), values, names))
        states, none = np.empty((edges, 4, LANES)), np.zeros((1, 0, LANES))
        explicit, limits = np.zeros((1, edges, 1, 0)), np.zeros((1, 1, LANES))
        moved = Moved(start[[0, 2]], start[[1, 3]], none, explicit, LANES, limits)
        loop = pass_on(self.run.command[:, np.newaxis], self.motion.step)
        follow(
            self.plant, None, NO_LINKS[0], loop, np.zeros(1), self.run.command, self.run.excess, self.run.tape, seeds,
            moved, Slopes(np.zeros((1, edges, 0)), states, NO_LINKS),
        )  # fmt: skip
        return states[:, 2:, : len(names)]


def _start(joint: FlexibleJoint, motion: PrescribedMotion, values: Mapping[str, float]) -> FloatArray:
    """First state of motor and load, (4,): the load moves with the motor, plus `LOAD_STATE`."""
    steady = joint.start(values, float(motion.position[0]), float(motion.velocity[0]))
    steady[1] = motion.joined[0]
    steady[2:] += [values.get(name, 0.0) for name in LOAD_STATE]
    return steady
