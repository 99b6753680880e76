"""Drive side: torques for the recorded motion of motors, independent of controllers.

The record needs the motors' positions. The links of flexible joints are simulated, hung on springs whose other ends
move as the motors did; of a rigid joint the link is its motor, and the torque its inverse model::

    M(q) a + h(q, v) + Fv2 v + Fc2 sign(v) = K (qm - q) + D (vm - v)              the links of flexible joints
    Jm am + Fv1 vm + Fc1 sign(vm) + offset + K (qm - q) + D (vm - v) = tau        their motors
    Ia am + Fv vm + Fc sign(vm) + offset + (M(q) a + h(q, v))_i = tau             motors of rigid joints

A joint is a robot of one axis without a tree. The links are simulated as in the loop (`kernels.engine`): each motor is
so heavy that only a torque for its prescribed acceleration moves it, which is held in each part of a sample. Positions
at the parts' ends are accurate to fourth order with the velocity ``v - h^2/12 v''`` there, which corrects the linear
interpolation of the velocity (Euler and Maclaurin).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Tree
from jointid.simulation import kernels
from jointid.simulation.derivatives import columns_of
from jointid.simulation.kernels import STATE, IntArray
from jointid.simulation.plant import HEAVY, LOAD_STATE, LOG_DELAY, Bools, Numbers, Place
from jointid.simulation.simulate import STEPS, MassMotion, Outcome, choose_steps, integrate, motion_of, pass_on
from jointid.simulation.start import Steady

PARTS = 4
"""Of a sample of a joint: with 2 a viscous friction of loads that stick errs by 2e-3 instead of 1e-3."""
PARTS_OF_ROBOT = 1
"""Of a sample: with one the torque of a twin of six joints whose modes are at 8 to 30 Hz errs by 1e-5 at 1 kHz."""

_DEGREE = 7  # of the spline, odd: a cubic's second derivative errs by 3 % at a tenth of the sampling frequency
_HELD = 1e6  # kg m2 of one in a step's choice, which asks for numbers of one size


@dataclass(frozen=True, slots=True, eq=False)
class PrescribedMotion:
    """Motion of motors at the edges of their samples' parts.

    Attributes:
        tree: of the links; None of a joint.
        accelerations: (n,) at the first edge.
        step: seconds from edge to edge.
        position, velocity: (edges, n) of the shafts that the motors turn.
        joined: (edges, n) velocities between which the acceleration is held (see the module).
        direction: (parts, n) of the velocity, 1 or -1, mean over each part; filtered like the positions if the torques
            are, too.
    """

    tree: Tree | None
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
    """Interpolate the motion of motors through sampled positions by a spline.

    Args:
        position: (samples, n) of the shafts that the motors turn, smooth at the scale of a sample: filtered where the
            encoder is coarse.
        sample_time: s.
        parts: of a sample.
        tree: of a robot's links.
        resting: (n,) which motors rest at the first sample. Their velocity there is set to 0: rounding would let a link
            slide.
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
    return PrescribedMotion(tree, acceleration[0], step, np.asarray(spline(edges) + home), velocity, joined, direction)


def _mean_direction(velocity: FloatArray) -> FloatArray:
    """Mean sign of linearly interpolated velocities over each part, (parts, n)."""
    before, after = velocity[:-1], velocity[1:]
    size = np.abs(before) + np.abs(after)
    turned = (np.abs(after) - np.abs(before)) * np.sign(after) / np.where(size > 0.0, size, 1.0)
    return np.where(before * after < 0.0, turned, np.sign(before + after))


@dataclass(frozen=True, slots=True, eq=False)
class DriveSideRun:
    """Torques of one candidate along the motors' motion.

    Attributes:
        prescribed: the motors' motion. numbers: of the candidate.
        outcome: how the simulation of the links ended; if it did not finish all else is 0.
        start: (masses,) positions at the beginning, in steady motion.
        motion: of all masses, means over the parts, (parts, masses).
        torque: (parts, n), means over the parts. command: (n, parts + 1) torques that move the heavy motors.
        tape: of the simulation.
    """

    prescribed: PrescribedMotion
    numbers: Numbers
    outcome: Outcome
    start: FloatArray
    motion: MassMotion
    torque: FloatArray
    command: FloatArray
    tape: FloatArray

    def columns(self, keys: Sequence[Place]) -> list[tuple[IntArray, FloatArray]]:
        """Columns of the motors' equations by axis: parameter indices, and (parts, own)."""
        return columns_of(self.prescribed.tree, self.numbers, keys, self.motion, self.numbers.motors)


def run_drive_side(prescribed: PrescribedMotion, numbers: Numbers) -> DriveSideRun:
    """Simulate links under prescribed motion; a candidate's failure is the outcome.

    The integrator takes as many steps as keep the fastest motion of a robot below 0.5 rad a step.
    """
    parts, n = prescribed.direction.shape
    heavy, tape, command, taken = replace(numbers, heavy=HEAVY), np.zeros((0, STATE)), np.zeros((n, parts + 1)), 0
    masses, plant = numbers.count, heavy.plant
    start, outcome = np.zeros(masses), Outcome.INVALID
    if numbers.possible(numbers.plant, len(prescribed.position) * prescribed.step):
        outcome = Outcome.FINISHED
        if prescribed.tree is not None:
            links, held = prescribed.position[:: max(len(prescribed.position) // 5, 1)], replace(numbers, heavy=_HELD)
            taken = choose_steps(prescribed.tree, links, prescribed.step, held.plant, numbers.inertials)
            outcome = outcome if taken <= STEPS else Outcome.TOO_STIFF
    if outcome is Outcome.FINISHED:
        start, places, speeds = _begin(prescribed, numbers)
    if outcome is Outcome.FINISHED and len(plant.pairs):
        accelerations = np.diff(prescribed.joined, axis=0) / prescribed.step
        # One more part follows the last one, so that its end is on the tape, too.
        torques = HEAVY * np.vstack([accelerations, accelerations[-1:]]).T
        outcome, command, _, tape, _, _ = integrate(
            plant, prescribed.tree, numbers.inertials, pass_on(torques, prescribed.step), np.zeros(n),
            np.full(n, np.inf), np.zeros((n, 0)), places, speeds, np.sign(speeds), keep=True, steps=taken,
        )  # fmt: skip
    nothing = np.zeros((parts, masses))
    motion, torque = MassMotion(nothing, nothing, nothing, nothing), nothing[:, :n]
    if outcome is Outcome.FINISHED:
        motion = _mean_motion(prescribed, numbers, tape)
        keys = numbers.not_zero()
        values = np.array([numbers[key] for key in keys])
        each = columns_of(prescribed.tree, numbers, keys, motion, numbers.motors)
        torque = np.column_stack([columns @ values[own] for own, columns in each])
    return DriveSideRun(prescribed, numbers, outcome, start, motion, torque, command, tape)


def differentiate_drive_side(run: DriveSideRun, keys: Sequence[Place]) -> FloatArray:
    """Torque derivatives by link-moving parameters, (parts, n, parameters), by variation.

    The small motion of the heavy motors gives the torques. Other numbers act only in their motor's equation, see
    `DriveSideRun.columns`.

    Args:
        run: that finished.
        keys: parameters, see `moves_links`.
    """
    from jointid.simulation.kernels.variation import follow

    prescribed, heavy, count = run.prescribed, replace(run.numbers, heavy=HEAVY), len(keys)
    parts, n = prescribed.direction.shape
    if not count or not len(run.tape):
        return np.zeros((parts, n, count))
    plant, speeds, none = heavy.plant, np.zeros((n, parts + 1, count)), np.zeros((n, 0, count))
    joint = (0.0,) * heavy.count if prescribed.tree is None else None
    follow(
        plant, prescribed.tree, heavy.inertials, pass_on(run.command, prescribed.step), joint, np.zeros(n), run.command,
        np.zeros((n, 0, 1)), run.tape, None, np.zeros((1, kernels.MASS + 2), np.complex128), heavy.seeds(plant, keys),
        *_slopes_at_start(run, keys), none, np.zeros((n, 0, 1, 0)), np.zeros(0, np.int64), np.zeros((n, 1, count)),
        np.zeros((n, parts + 1, 0)), np.zeros((0, 4, count)), speeds,
    )  # fmt: skip
    return -HEAVY / prescribed.step * np.diff(speeds, axis=1).transpose(1, 0, 2)


def moves_links(key: Place, numbers: Numbers) -> bool:
    """Test whether a number changes the motion of the links."""
    of_motor = key.side == "motor_" or key.name in ("offset", LOG_DELAY) or not numbers.flexible[key.axis]
    return bool(np.any(numbers.flexible)) and (key.of_link or not of_motor)


def _steady(prescribed: PrescribedMotion, numbers: Numbers) -> Steady:
    free, speeds = prescribed.position[0], prescribed.velocity[0]
    return Steady(numbers, free, speeds, prescribed.accelerations, prescribed.tree)


def _begin(prescribed: PrescribedMotion, numbers: Numbers) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Steady positions, and positions and velocities of masses at the first edge."""
    steady = _steady(prescribed, numbers)
    start, _ = steady.settle()
    places, speeds = start.copy(), steady.of_masses(steady.speeds)
    for (motor, *behind), values, speed in zip(numbers.rows, numbers.values, prescribed.joined[0], strict=True):
        speeds[motor] = speed
        places[behind] += values.get(LOAD_STATE[0], 0.0)
        speeds[behind] += values.get(LOAD_STATE[1], 0.0)
    return start, places, speeds


def _slopes_at_start(run: DriveSideRun, keys: Sequence[Place]) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the first positions and velocities, (masses, keys) each."""
    dq, _ = _steady(run.prescribed, run.numbers).slopes(run.start, keys)
    dv = np.zeros_like(dq)
    for c, key in enumerate(keys):
        if key.name in LOAD_STATE:
            (dq, dv)[LOAD_STATE.index(key.name)][run.numbers.rows[key.axis][1:], c] = 1.0
    return dq, dv


def _mean_motion(prescribed: PrescribedMotion, numbers: Numbers, tape: FloatArray) -> MassMotion:
    """Return the motion of all masses, means over the parts.

    The load moves even a heavy motor a little, and the link with it. Motor positions are therefore those of the
    simulation, which gives consistent deflections of the springs; only accelerations are as prescribed.
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
