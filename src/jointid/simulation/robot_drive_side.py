"""A robot without its controllers: the record prescribes how its motors move, and the torques that it takes follow.

What the controllers are does not matter then; the record needs the motors' positions instead. The links of flexible
joints are simulated, hung on springs whose other ends move as the motors did; of a rigid joint the link is its motor::

    M(q) a + h(q, v) + Fv2 v + Fc2 sign(v) = K (qm - q) + D (vm - v)              the links of flexible joints
    Jm am + Fv1 vm + Fc1 sign(vm) + offset + K (qm - q) + D (vm - v) = tau        their motors
    Ia am + Fv vm + Fc sign(vm) + offset + (M(q) a + h(q, v))_i = tau             motors of rigid joints

The motors move as those of one joint do (`simulation.prescribed`). Sticking, sliding and reversing of the links are as
in the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Robot
from jointid.simulation.closed_loop import OUTCOMES, Outcome
from jointid.simulation.kernels.engine import STATE
from jointid.simulation.plant import HEAVY, motion_of, move_motors, pass_on
from jointid.simulation.prescribed import motion_at_edges, part_means
from jointid.simulation.robot_numbers import Bools, MassNumbers, NumberOf, NumberPlace, RobotNumbers
from jointid.simulation.robot_sensitivities import columns_of, seeds_of, slopes_at_start
from jointid.simulation.robots import FirstSample, MassMotion, choose_steps, places_at_start, speeds_at_start

PARTS = 1
"""Of a sample: with one the torque of a twin of six joints whose modes are at 8 to 30 Hz errs by 1e-5 at 1 kHz."""

_HELD = 1e6  # kg m2 of one in a step's choice, which asks for numbers of one size
_STEPS = 64  # of a part, at most


@dataclass(frozen=True, slots=True)
class RobotDriveSide:
    """A robot whose motors move as the record says, whatever their controllers: from motor positions to torques.

    Attributes:
        robot: links, joints and gravity.
    """

    robot: Robot


@dataclass(frozen=True, eq=False)
class MotorMotion(FirstSample):
    """The motion of a robot's motors, prescribed.

    Attributes:
        step: s of a part.
        position, velocity: (parts + 1, n) at the ends of the parts.
        joined: (parts + 1, n) the velocities that the held accelerations join (see the module).
        direction: (parts, n) of the velocity, 1 or -1, mean over each part; filtered as the positions are where the
            torques are, too.
    """

    step: float
    position: FloatArray
    velocity: FloatArray
    joined: FloatArray
    direction: FloatArray

    def begin(self, parts: int) -> MotorMotion:
        """Return the motion in the first parts."""
        edges = {name: getattr(self, name)[: parts + 1] for name in ("position", "velocity", "joined")}
        return replace(self, direction=self.direction[:parts], **edges)


def prescribe_motion(
    robot: Robot, positions: FloatArray, sample_time: float, resting: Bools | None = None, parts: int = PARTS
) -> MotorMotion:
    """Return the motion of motors through sampled positions, by an interpolating spline.

    Args:
        robot: whose motors they are.
        positions: (samples, n) of the shafts that the motors turn, smooth at the scale of a sample: filtered.
        sample_time: s.
        resting: (n,) which motors rest at the first sample: what is left of their velocity there is rounding, with
            which a link would slide.
        parts: of a sample.
    """
    step = sample_time / parts
    position, velocity, acceleration, joined = motion_at_edges(positions, sample_time, parts)
    if resting is not None:
        joined[0, resting] = velocity[0, resting] = acceleration[0, resting] = 0.0
    return MotorMotion(robot.tree, velocity[0], acceleration[0], step, position, velocity, joined, _direction(velocity))


def _direction(velocity: FloatArray) -> FloatArray:
    """Return the mean sign of velocities over each part, (parts, n), where they run straight from end to end."""
    before, after = velocity[:-1], velocity[1:]
    size = np.abs(before) + np.abs(after)
    turned = (np.abs(after) - np.abs(before)) * np.sign(after) / np.where(size > 0.0, size, 1.0)
    return np.where(before * after < 0.0, turned, np.sign(before + after))


@dataclass(frozen=True, slots=True, eq=False)
class RobotDriveSideRun:
    """The torques that one candidate takes along the motors' motion.

    Attributes:
        prescribed: the motors' motion. numbers: of the candidate.
        outcome: how the simulation of the links ended; if it did not finish all else is 0.
        start: (masses,) positions at the beginning, in steady motion.
        motion: of all masses, means over the parts, (parts, masses).
        torque: (parts, n), means over the parts. command: (n, parts + 1) what the heavy motors are moved by.
        tape: of the simulation.
    """

    prescribed: MotorMotion
    numbers: RobotNumbers
    outcome: Outcome
    start: FloatArray
    motion: MassMotion
    torque: FloatArray
    command: FloatArray
    tape: FloatArray


def run_drive_side(prescribed: MotorMotion, numbers: RobotNumbers) -> RobotDriveSideRun:
    """Simulate the links under a prescribed motion of the motors; never raises for a candidate's sake: see its outcome.

    The integrator takes as many steps as keep the fastest motion below 0.5 rad a step.
    """
    n, masses, parts = numbers.rotors.size, len(numbers.masses), len(prescribed.direction)
    moved, tape, command = _with_heavy_motors(numbers), np.zeros((0, STATE)), np.zeros((n, parts + 1))
    start, speeds = np.zeros(masses), np.zeros(masses)
    outcome = Outcome.INVALID
    if numbers.possible(len(prescribed.position) * prescribed.step):
        links = prescribed.position[:: max(len(prescribed.position) // 5, 1)]
        taken = choose_steps(prescribed.tree, links, prescribed.step, _with_heavy_motors(numbers, _HELD))
        outcome = Outcome.FINISHED if taken <= _STEPS else Outcome.TOO_STIFF
    if outcome is Outcome.FINISHED:
        speeds, stiff = speeds_at_start(prescribed, numbers), np.full(n, -np.inf)
        start, _ = places_at_start(prescribed, numbers, prescribed.position[0], stiff)
        speeds[numbers.rotors] = prescribed.joined[0]
        places = start.copy()
        if numbers.beside.size:
            places[:n] += numbers.beside[:, 0]
            speeds[:n] += numbers.beside[:, 1]
        found = move_motors(
            moved.plant, prescribed.tree, moved.inertials, prescribed.joined, prescribed.step, places, speeds, taken
        )
        outcome, tape, command = OUTCOMES[found.status], found.tape, found.command
    if outcome is not Outcome.FINISHED:
        nothing = np.zeros((parts, masses))
        return RobotDriveSideRun(
            prescribed, numbers, outcome, start, MassMotion(nothing, nothing, nothing, nothing), nothing[:, :n],
            command, tape,
        )  # fmt: skip
    motion = _motion(prescribed, numbers, tape)
    torque = _torque(prescribed, numbers, motion)
    return RobotDriveSideRun(prescribed, numbers, outcome, start, motion, torque, command, tape)


def differentiate_drive_side(run: RobotDriveSideRun, places: Sequence[NumberPlace]) -> FloatArray:
    """Return how the torques change because the links move otherwise, (parts, n, parameters), by variation.

    Beside that a number acts where it stands in its motor's equation: `columns_of` the run's motion.

    Args:
        run: that finished.
        places: of the parameters.
    """
    from jointid.simulation.kernels.drive_sensitivities import Moved, Slopes
    from jointid.simulation.kernels.variation import follow

    prescribed, numbers, count = run.prescribed, _with_heavy_motors(run.numbers), len(places)
    n, parts = numbers.rotors.size, len(prescribed.direction)
    dq, dv = np.zeros((len(numbers.masses), count)), np.zeros((len(numbers.masses), count))
    of_robot = [c for c, place in enumerate(places) if place.of in (NumberOf.LINK, NumberOf.MASS, NumberOf.SPRING)]
    dq[:, of_robot], _ = slopes_at_start(
        prescribed, run.numbers, run.start, np.zeros(n), tuple(places[c] for c in of_robot)
    )
    for c, place in enumerate(places):
        if place.of is NumberOf.BESIDE:
            (dv if place.column else dq)[place.row, c] = 1.0
    found = np.zeros((n, parts + 1, count))
    moved = Moved(dq, dv, np.zeros((n, 0, count)), np.zeros((n, 0, 1, 0)), count, np.zeros((n, 1, count)))
    follow(
        numbers.plant, prescribed.tree, numbers.inertials, pass_on(run.command[:, np.newaxis], prescribed.step),
        np.zeros(n), run.command, np.zeros((n, 0, 1)), run.tape, seeds_of(prescribed.tree, numbers, places), moved,
        Slopes(np.zeros((n, parts + 1, 0)), np.zeros((0, 4, count)), found),
    )  # fmt: skip
    return found[:, :parts].transpose(1, 0, 2)


def moves_links(place: NumberPlace, numbers: RobotNumbers) -> bool:
    """Test whether a number changes how the links move: those of the motors do not, nor any without a spring."""
    of_motor = place.of is NumberOf.MASS and place.row in numbers.rotors
    return not of_motor and place.of is not NumberOf.LOG and bool(np.any(numbers.flexible))


def _with_heavy_motors(numbers: RobotNumbers, heavy: float = HEAVY) -> RobotNumbers:
    """Return the robot with motors so heavy that they follow the prescribed motion."""
    masses = numbers.masses.copy()
    masses[numbers.rotors] = 0.0
    masses[numbers.rotors, 0] = heavy
    return replace(numbers, masses=masses)


def _motion(prescribed: MotorMotion, numbers: RobotNumbers, tape: FloatArray) -> MassMotion:
    """Return the motion of all masses, means over the parts.

    The load moves even a heavy motor a little, and the link goes with it: positions of motors are those of the
    simulation, so that springs are stretched by what they are, and only accelerations are as prescribed.
    """
    places, speeds, *_ = motion_of(tape, len(numbers.masses), len(prescribed.position))
    position, velocity = part_means(places, speeds, prescribed.step)
    acceleration = np.diff(speeds, axis=0) / prescribed.step
    direction = np.sign(velocity)
    rotors = numbers.rotors
    direction[:, rotors] = prescribed.direction
    acceleration[:, rotors] = np.diff(prescribed.velocity, axis=0) / prescribed.step
    return MassMotion(position, velocity, acceleration, direction)


def _torque(prescribed: MotorMotion, numbers: RobotNumbers, motion: MassMotion) -> FloatArray:
    places = tuple(
        NumberPlace(of, int(row), int(column))
        for of in (NumberOf.LINK, NumberOf.MASS, NumberOf.SPRING)
        for row, column in np.argwhere(numbers.arrays[of] != 0.0)
        if of is not NumberOf.MASS or column != MassNumbers.SPEED  # the share of the rise has it
    )
    values = np.array([place.read(numbers) for place in places])
    each = columns_of(prescribed.tree, numbers, places, motion, numbers.rotors)
    return np.column_stack([columns @ values[own] for own, columns in each])
