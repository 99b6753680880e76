"""The drive side: motors that move as the record says, and the torques that this takes, whatever the controllers are.

The record needs the motors' positions. The links of flexible joints are simulated, hung on springs whose other ends
move as the motors did; of a rigid joint the link is its motor, and the torque its inverse model::

    M(q) a + h(q, v) + Fv2 v + Fc2 sign(v) = K (qm - q) + D (vm - v)              the links of flexible joints
    Jm am + Fv1 vm + Fc1 sign(vm) + offset + K (qm - q) + D (vm - v) = tau        their motors
    Ia am + Fv vm + Fc sign(vm) + offset + (M(q) a + h(q, v))_i = tau             motors of rigid joints

A joint is a robot of one axis without a tree. The links are simulated as in the loop (`kernels.engine`): each motor is
so heavy that nothing moves it but a torque that gives it its own acceleration, which is held in each part of a sample.
Where it then is at the parts' ends is right to the fourth order, by the velocity ``v - h^2/12 v''`` there: what the
straight line through velocities takes from a curved motion (Euler and Maclaurin) is put back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.joints import Joint
from jointid.models.position_forces import Motion
from jointid.models.robots.robot import Robot, Tree
from jointid.simulation.derivatives import columns_of
from jointid.simulation.kernels.tables import STATE, IntArray, Moved, Slopes
from jointid.simulation.plant import HEAVY, pack_seeds
from jointid.simulation.robot_numbers import Bools, NumberOf
from jointid.simulation.simulate import (
    OUTCOMES,
    STEPS,
    MassMotion,
    Outcome,
    choose_steps,
    integrate,
    motion_of,
    pass_on,
)
from jointid.simulation.start import Keys, Numbers, Steady, joint_slopes, joint_state

PARTS = 4
"""Of a sample of a joint: with 2 a viscous friction of loads that stick errs by 2e-3 instead of 1e-3."""
PARTS_OF_ROBOT = 1
"""Of a sample: with one the torque of a twin of six joints whose modes are at 8 to 30 Hz errs by 1e-5 at 1 kHz."""
LOAD_STATE = ("initial_load_position", "initial_load_velocity")
"""The state of a joint's load at the first sample, beside where steady motion has it."""

_DEGREE = 7  # of the spline, odd: a cubic's second derivative errs by 3 % at a tenth of the sampling frequency
_HELD = 1e6  # kg m2 of one in a step's choice, which asks for numbers of one size

Columns: TypeAlias = list[tuple[IntArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class DriveSide:
    """A joint under prescribed motor motion: from motor position to torque.

    Attributes:
        joint: rigid, or flexible: then the load, which the record does not show, is simulated.
    """

    joint: Joint

    def __post_init__(self) -> None:
        self.joint.require_linear("The drive side takes")
        if self.joint.ripple is not None and self.joint.ripple.side == "load":
            raise MethodError(
                "The drive side takes a joint without a ripple on the load's side; received one that has it: identify "
                'by the method "didim".'
            )

    @property
    def channels(self) -> tuple[str, ...]:
        """Required channels of a record."""
        return ("torque", "motor_position")


@dataclass(frozen=True, slots=True)
class RobotDriveSide:
    """A robot whose motors move as the record says, whatever their controllers: from motor positions to torques.

    Attributes:
        robot: links, joints and gravity.
    """

    robot: Robot


@dataclass(frozen=True, slots=True, eq=False)
class PrescribedMotion:
    """The motion of motors at the edges of the parts of its samples.

    Attributes:
        tree: of the links; None of a joint.
        speeds, accelerations: (n,) at the first edge.
        step: seconds from edge to edge.
        position, velocity: (edges, n) of the shafts that the motors turn.
        joined: (edges, n) the velocities that the held accelerations join (see the module).
        direction: (parts, n) of the velocity, 1 or -1, mean over each part; filtered as the positions are where the
            torques are, too.
    """

    tree: Tree | None
    speeds: FloatArray
    accelerations: FloatArray
    step: float
    position: FloatArray
    velocity: FloatArray
    joined: FloatArray
    direction: FloatArray

    def begin(self, parts: int) -> PrescribedMotion:
        """Return the motion in the first parts."""
        edges = {name: getattr(self, name)[: parts + 1] for name in ("position", "velocity", "joined")}
        return replace(self, direction=self.direction[:parts], **edges)


def prescribe(
    position: FloatArray, sample_time: float, parts: int, tree: Tree | None = None, resting: Bools | bool = False
) -> PrescribedMotion:
    """Return the motion of motors through sampled positions, by an interpolating spline.

    Args:
        position: (samples, n) of the shafts that the motors turn, smooth at the scale of a sample: filtered where the
            encoder is coarse.
        sample_time: s.
        parts: of a sample.
        tree: of a robot's links.
        resting: (n,) which motors rest at the first sample: what is left of their velocity there is rounding, with
            which a link would slide.
    """
    from scipy.interpolate import make_interp_spline

    home, step = position[0], sample_time / parts  # far from zero a spline would lose digits of its derivatives
    spline = make_interp_spline(np.arange(len(position)) * sample_time, position - home, _DEGREE)
    edges = np.arange((len(position) - 1) * parts + 1) * step
    velocity, acceleration = (np.asarray(spline.derivative(order)(edges)) for order in (1, 2))
    joined = velocity - step**2 / 12.0 * np.asarray(spline.derivative(3)(edges))
    still = np.broadcast_to(resting, home.shape)
    joined[0, still] = velocity[0, still] = acceleration[0, still] = 0.0
    direction = _mean_direction(velocity)
    return PrescribedMotion(
        tree, velocity[0], acceleration[0], step, np.asarray(spline(edges) + home), velocity, joined, direction
    )


def _mean_direction(velocity: FloatArray) -> FloatArray:
    """Return the mean sign of velocities over each part, (parts, n), where they run straight from end to end."""
    before, after = velocity[:-1], velocity[1:]
    size = np.abs(before) + np.abs(after)
    turned = (np.abs(after) - np.abs(before)) * np.sign(after) / np.where(size > 0.0, size, 1.0)
    return np.where(before * after < 0.0, turned, np.sign(before + after))


@dataclass(frozen=True, slots=True, eq=False)
class DriveSideRun:
    """The torques that one candidate takes along the motors' motion.

    Attributes:
        prescribed: the motors' motion. numbers: of the candidate.
        outcome: how the simulation of the links ended; if it did not finish all else is 0.
        start: (masses,) positions at the beginning, in steady motion.
        motion: of all masses, means over the parts, (parts, masses).
        torque: (parts, n), means over the parts. command: (n, parts + 1) what the heavy motors are moved by.
        tape: of the simulation.
    """

    prescribed: PrescribedMotion
    numbers: Any
    outcome: Outcome
    start: FloatArray
    motion: MassMotion
    torque: FloatArray
    command: FloatArray
    tape: FloatArray

    def columns(self, keys: Keys) -> Columns:
        """Return the columns of the motors' equations on the motion, by axis: whose they are, (parts, own)."""
        return _columns(self.prescribed, self.numbers, keys, self.motion)


def run_drive_side(prescribed: PrescribedMotion, numbers: Numbers) -> DriveSideRun:
    """Simulate the links under a prescribed motion of the motors; never raises for a candidate's sake: see its outcome.

    The integrator takes as many steps as keep the fastest motion of a robot below 0.5 rad a step.
    """
    parts, n = prescribed.direction.shape
    heavy, tape, command, taken = numbers.with_heavy_motors(HEAVY), np.zeros((0, STATE)), np.zeros((n, parts + 1)), 0
    masses = numbers.count
    start, outcome = np.zeros(masses), Outcome.INVALID
    if numbers.possible(len(prescribed.position) * prescribed.step):
        outcome = Outcome.FINISHED
        if prescribed.tree is not None:
            links = prescribed.position[:: max(len(prescribed.position) // 5, 1)]
            taken = choose_steps(prescribed.tree, links, prescribed.step, numbers.with_heavy_motors(_HELD))
            outcome = outcome if taken <= STEPS else Outcome.TOO_STIFF
    if outcome is Outcome.FINISHED:
        start, places, speeds = _begin(prescribed, numbers)
    if outcome is Outcome.FINISHED and len(heavy.plant.pairs):
        held = np.diff(prescribed.joined, axis=0) / prescribed.step
        # One more part follows the last one, so that its end is on the tape, too.
        torques = HEAVY * np.vstack([held, held[-1:]]).T[:, np.newaxis]
        status, command, _, tape, _ = integrate(
            heavy.plant, prescribed.tree, heavy.inertials, pass_on(torques, prescribed.step), np.zeros(n),
            np.full(n, np.inf), np.zeros((n, 0)), places, speeds, np.sign(speeds), keep=True, steps=taken,
        )  # fmt: skip
        outcome = OUTCOMES[status]
    nothing = np.zeros((parts, masses))
    motion, torque = MassMotion(nothing, nothing, nothing, nothing), nothing[:, :n]
    if outcome is Outcome.FINISHED:
        motion = _mean_motion(prescribed, numbers, tape)
        keys, values = numbers.not_zero()
        each = _columns(prescribed, numbers, keys, motion)
        torque = np.column_stack([columns @ values[own] for own, columns in each])
    return DriveSideRun(prescribed, numbers, outcome, start, motion, torque, command, tape)


def differentiate_drive_side(run: DriveSideRun, keys: Keys) -> FloatArray:
    """Return how the torques change because the links move otherwise, (parts, n, parameters), by variation.

    Beside that a number acts where it stands in its motor's equation: `DriveSideRun.columns`.

    Args:
        run: that finished.
        keys: names or places of the parameters.
    """
    from jointid.simulation.kernels.variation import follow

    prescribed, heavy, count = run.prescribed, run.numbers.with_heavy_motors(HEAVY), len(keys)
    parts, n = prescribed.direction.shape
    if not count or not len(run.tape):
        return np.zeros((parts, n, count))
    dq, dv = _slopes_at_start(run, keys)
    found = np.zeros((n, parts + 1, count))
    moved = Moved(dq, dv, np.zeros((n, 0, count)), np.zeros((n, 0, 1, 0)), count, np.zeros((n, 1, count)))
    plant = heavy.plant
    seeds = pack_seeds(plant, heavy.blocks(keys), links=heavy.links(keys))
    follow(
        plant, prescribed.tree, heavy.inertials, pass_on(run.command[:, np.newaxis], prescribed.step), np.zeros(n),
        run.command, np.zeros((n, 0, 1)), run.tape, seeds, moved,
        Slopes(np.zeros((n, parts + 1, 0)), np.zeros((0, 4, count)), found),
    )  # fmt: skip
    return found[:, :parts].transpose(1, 0, 2)


def moves_links(key: Any, numbers: Numbers) -> bool:
    """Test whether a number changes how the links move: those of the motors do not, nor any without a spring."""
    if hasattr(numbers, "joint"):
        return numbers.count > 1 and not key.startswith(("motor_", "offset", "log_"))
    of_motor = key.of is NumberOf.MASS and key.row in numbers.rotors
    return not of_motor and key.of is not NumberOf.LOG and bool(np.any(numbers.flexible))


def _steady(prescribed: PrescribedMotion, numbers: Numbers) -> Steady:
    return Steady(
        prescribed.tree, prescribed.speeds, prescribed.accelerations, numbers, prescribed.position[0]
    )  # fmt: skip


def _begin(prescribed: PrescribedMotion, numbers: Numbers) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the positions of steady motion, and positions and velocities of all masses at the first edge."""
    if prescribed.tree is not None:
        steady = _steady(prescribed, numbers)
        start, _ = steady.settle()
        places, speeds, n = start.copy(), steady.all_speeds, numbers.rotors.size
        speeds[numbers.rotors] = prescribed.joined[0]
        if numbers.beside.size:
            places[:n] += numbers.beside[:, 0]
            speeds[:n] += numbers.beside[:, 1]
        return start, places, speeds
    start, speeds = joint_state(numbers, float(prescribed.position[0, 0]), float(prescribed.speeds[0]), 1.0)
    speeds[0] = prescribed.joined[0, 0]
    beside = [numbers.values.get(name, 0.0) for name in LOAD_STATE]
    places = start.copy()
    places[1:] += beside[0]
    speeds[1:] += beside[1]
    return start, places, speeds


def _slopes_at_start(run: DriveSideRun, keys: Keys) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the first positions and velocities, (masses, keys) each."""
    prescribed, numbers = run.prescribed, run.numbers
    dq, dv = np.zeros((2, numbers.count, len(keys)))
    if prescribed.tree is not None:
        dq[:], _ = _steady(prescribed, numbers).slopes(run.start, keys)
        for c, place in enumerate(keys):
            if place.of is NumberOf.BESIDE:
                (dv if place.column else dq)[place.row, c] = 1.0
        return dq, dv
    position, velocity = float(prescribed.position[0, 0]), float(prescribed.speeds[0])
    dq[:, : len(keys)], dv[:, : len(keys)] = joint_slopes(numbers, keys, position, velocity, 1.0)
    for c, key in enumerate(keys):
        if key in LOAD_STATE:
            (dq, dv)[LOAD_STATE.index(str(key))][1:, c] = 1.0
    return dq, dv


def _mean_motion(prescribed: PrescribedMotion, numbers: Numbers, tape: FloatArray) -> MassMotion:
    """Return the motion of all masses, means over the parts.

    The load moves even a heavy motor a little, and the link goes with it: positions of motors are those of the
    simulation, so that springs are stretched by what they are, and only accelerations are as prescribed.
    """
    places, speeds = prescribed.position, prescribed.velocity
    if len(tape):
        places, speeds, *_ = motion_of(tape, numbers.count, len(prescribed.position))
    step, motors = prescribed.step, numbers.motors
    position = 0.5 * (places[:-1] + places[1:]) - step / 12 * np.diff(speeds, axis=0)
    velocity, acceleration = np.diff(places, axis=0) / step, np.diff(speeds, axis=0) / step
    direction = np.sign(velocity)
    direction[:, motors] = prescribed.direction
    acceleration[:, motors] = np.diff(prescribed.velocity, axis=0) / step
    return MassMotion(position, velocity, acceleration, direction)


def _columns(prescribed: PrescribedMotion, numbers: Numbers, keys: Keys, motion: MassMotion) -> Columns:
    """Return the columns of the motors' equations, by axis: whose they are, and (parts, own)."""
    if prescribed.tree is not None:
        return columns_of(prescribed.tree, numbers, tuple(keys), motion, numbers.rotors)
    joint, names = numbers.joint, [p.name for p in numbers.joint.parameters]
    own = np.array([i for i, key in enumerate(keys) if key in names], dtype=np.int64)
    motor, *load = (Motion(*(one[:, i] for one in motion[:3])) for i in range(numbers.count))
    columns = joint.regressor(motor, load[0] if load else None)[0]
    friction = _mean_friction(joint, prescribed.velocity[:, 0])
    columns[:, 1 : 1 + friction.shape[1]] = friction
    return [(own, columns[:, [names.index(str(keys[i])) for i in own]])]


def _mean_friction(joint: Joint, velocity: FloatArray) -> FloatArray:
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
