"""A robot without its controllers: the record prescribes how its motors move, and the torques that it takes follow.

What the controllers are does not matter then; the record needs the motors' positions instead. The links of flexible
joints are simulated, hung on springs whose other ends move as the motors did; of a rigid joint the link is its motor::

    M(q) a + h(q, v) + Fv2 v + Fc2 sign(v) = K (qm - q) + D (vm - v)              the links of flexible joints
    Jm am + Fv1 vm + Fc1 sign(vm) + offset + K (qm - q) + D (vm - v) = tau        their motors
    Ia am + Fv vm + Fc sign(vm) + offset + (M(q) a + h(q, v))_i = tau             motors of rigid joints

The kernel of the closed loop serves as it is (`kernels.robot_loop`): each motor is so heavy that nothing moves it but
a torque that gives it its own acceleration, which is held in each part of a sample. Where it then is at the parts' ends
is right to the fourth order, by the velocity ``v - h^2/12 v''`` there: what the straight line through velocities takes
from a curved motion (Euler and Maclaurin) is put back. Sticking, sliding and reversing of the links are as in the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Robot, Tree
from jointid.simulation.kernels.robot_loop import Clock, Controllers, Driven, RobotTape, Seen
from jointid.simulation.prescribed import part_means, spline_of
from jointid.simulation.robot_numbers import Bools, MassNumbers, NumberOf, NumberPlace, RobotNumbers
from jointid.simulation.robot_sensitivities import columns_of, seeds_of, slopes_at_start
from jointid.simulation.robot_start import places_at_start, speeds_at_start
from jointid.simulation.robots import MassMotion, RobotOutcome, choose_steps, outcome_of

PARTS = 1
"""Of a sample: with one the torque of a twin of six joints whose modes are at 8 to 30 Hz errs by 1e-5 at 1 kHz."""

_HEAVY = 1e18  # kg m2 of a motor that is moved: a robot of 1e3 N m moves it by 1e-12 rad in a minute
_HELD = 1e6  # kg m2 of one in a step's choice, which asks for numbers of one size
_STEPS = 64  # of a part, at most
_MORE = 2  # pieces per step, at most, beside a thousand


@dataclass(frozen=True, slots=True)
class RobotDriveSide:
    """A robot whose motors move as the record says, whatever their controllers: from motor positions to torques.

    Attributes:
        robot: links, joints and gravity.
    """

    robot: Robot


@dataclass(frozen=True, eq=False)
class MotorMotion:
    """The motion of a robot's motors, prescribed.

    Attributes:
        tree: of the links, as `RobotInput` has it.
        step: s of a part.
        position, velocity: (parts + 1, n) at the ends of the parts.
        joined: (parts + 1, n) the velocities that the held accelerations join (see the module).
        direction: (parts, n) of the velocity, 1 or -1, mean over each part; filtered as the positions are where the
            torques are, too.
        speeds, accelerations: (n,) at the first sample.
    """

    tree: Tree
    step: float
    position: FloatArray
    velocity: FloatArray
    joined: FloatArray
    direction: FloatArray
    speeds: FloatArray
    accelerations: FloatArray

    @cached_property
    def held(self) -> FloatArray:
        """Accelerations that are held in the parts, (parts, n)."""
        return np.diff(self.joined, axis=0) / self.step

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
    home = positions[0]
    spline = spline_of(positions - home, sample_time)
    step = sample_time / parts
    edges = np.arange((len(positions) - 1) * parts + 1) * step
    velocity, acceleration = spline.derivative()(edges), spline.derivative(2)(edges[:1])
    joined = velocity - step**2 / 12.0 * spline.derivative(3)(edges)
    if resting is not None:
        joined[0, resting] = velocity[0, resting] = acceleration[0, resting] = 0.0
    position = np.asarray(spline(edges) + home)
    return MotorMotion(robot.tree, step, position, velocity, joined, _direction(velocity), velocity[0], acceleration[0])


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
        torque: (parts, n), means over the parts. tape: of the simulation, empty unless it was kept.
    """

    prescribed: MotorMotion
    numbers: RobotNumbers
    outcome: RobotOutcome
    start: FloatArray
    motion: MassMotion
    torque: FloatArray
    tape: RobotTape


def run_drive_side(prescribed: MotorMotion, numbers: RobotNumbers) -> RobotDriveSideRun:
    """Simulate the links under a prescribed motion of the motors; never raises for a candidate's sake: see its outcome.

    The integrator takes as many steps as keep the fastest motion below 0.5 rad a step.
    """
    from jointid.simulation.kernels import robot_loop

    n, masses, parts = numbers.rotors.size, len(numbers.masses), len(prescribed.held)
    moved = _with_heavy_motors(numbers)
    start, speeds = np.zeros(masses), np.zeros(masses)
    outcome, tape = RobotOutcome.INVALID, RobotTape.empty(0, 0, moved.bodies)
    if numbers.possible(len(prescribed.position) * prescribed.step):
        links = prescribed.position[:: max(len(prescribed.position) // 5, 1)]
        taken = choose_steps(prescribed.tree, links, prescribed.step, _with_heavy_motors(numbers, _HELD))
        outcome = RobotOutcome.FINISHED if taken <= _STEPS else RobotOutcome.TOO_STIFF
    if outcome is RobotOutcome.FINISHED:
        speeds, stiff = speeds_at_start(prescribed, numbers), np.full(n, -np.inf)
        start, _ = places_at_start(prescribed, numbers, prescribed.position[0], stiff)
        speeds[numbers.rotors] = prescribed.joined[0]
        places = start.copy()
        if numbers.beside.size:
            places[:n] += numbers.beside[:, 0]
            speeds[:n] += numbers.beside[:, 1]
        tape = RobotTape.empty(parts + 1, _MORE * (parts + 1) * taken + 1000, moved.bodies)
        # One more part follows the last one, so that its end is on the tape, too.
        asked = _HEAVY * np.vstack([prescribed.held, prescribed.held[-1:]]).T[:, np.newaxis]
        command, counts = np.zeros((n, parts + 1)), np.zeros(3, dtype=np.int64)
        driven = Driven(np.ascontiguousarray(asked), np.zeros((n, parts + 1)), np.zeros(n), np.full(n, np.inf))
        seen = Seen(command, np.zeros((n, 0, 0), dtype=np.bool_))
        status = robot_loop.run(
            prescribed.tree, moved.bodies, _timing(n, prescribed.step), taken, _passing(n), driven, np.zeros((n, 0)),
            places, speeds, seen, tape, counts,
        )  # fmt: skip
        outcome, tape = outcome_of(status), tape.until(parts + 1, int(counts[1]))
    if outcome is not RobotOutcome.FINISHED:
        nothing = np.zeros((parts, masses))
        return RobotDriveSideRun(
            prescribed, numbers, outcome, start, MassMotion(nothing, nothing, nothing, nothing), nothing[:, :n], tape
        )
    motion = _motion(prescribed, numbers, tape)
    return RobotDriveSideRun(prescribed, numbers, outcome, start, motion, _torque(prescribed, numbers, motion), tape)


def differentiate_drive_side(run: RobotDriveSideRun, places: Sequence[NumberPlace]) -> FloatArray:
    """Return how the torques change because the links move otherwise, (parts, n, parameters), by variation.

    Beside that a number acts where it stands in its motor's equation: `columns_of` the run's motion.

    Args:
        run: that finished.
        places: of the parameters.
    """
    from jointid.simulation.kernels import robot_sensitivities as kernels

    prescribed, numbers, tape, count = run.prescribed, _with_heavy_motors(run.numbers), run.tape, len(places)
    n, parts = numbers.rotors.size, len(prescribed.held)
    dq, dv = np.zeros((len(numbers.masses), count)), np.zeros((len(numbers.masses), count))
    of_robot = [c for c, place in enumerate(places) if place.of in (NumberOf.LINK, NumberOf.MASS, NumberOf.SPRING)]
    rows = np.array([(NumberOf.MASS, numbers.rotors[0], 3)] * count, dtype=np.int64).reshape(-1, 3)  # moves nothing
    for c in of_robot:
        rows[c] = places[c].of, places[c].row, places[c].column
    moving = tuple(places[c] for c in of_robot)
    dq[:, of_robot], _ = slopes_at_start(prescribed, run.numbers, run.start, np.zeros(n), moving)
    for c, place in enumerate(places):
        if place.of is NumberOf.BESIDE:
            (dv if place.column else dq)[place.row, c] = 1.0
    found = np.zeros((n, parts + 1, count))
    at_start = kernels.Moved(dq, dv, np.zeros((n, 0, count)), np.zeros((n, count)))
    kernels.differentiate_run(
        prescribed.tree, numbers.bodies, _timing(n, prescribed.step), _passing(n), np.zeros((n, 0, 0), dtype=np.bool_),
        tape, rows, seeds_of(numbers, places), at_start, np.zeros((n, parts + 1, 0)), found,
    )  # fmt: skip
    return found[:, :parts].transpose(1, 0, 2)


def moves_links(place: NumberPlace, numbers: RobotNumbers) -> bool:
    """Test whether a number changes how the links move: those of the motors do not, nor any without a spring."""
    of_motor = place.of is NumberOf.MASS and place.row in numbers.rotors
    return not of_motor and place.of is not NumberOf.LOG and bool(np.any(numbers.flexible))


def _timing(n: int, step: float) -> Clock:
    """Return the clock of controllers that each act in one part of a step."""
    return Clock(np.array([step]), np.zeros((n, 1), dtype=np.int64), np.ones(n, dtype=np.int64))


def _passing(n: int) -> Controllers:
    """Return controllers that pass their input on, without feedback."""
    first = np.zeros(n, dtype=np.int64)
    return Controllers(
        A=np.zeros((n, 1, 0, 0)),
        Bq=np.zeros((n, 1, 0)),
        F=np.zeros((n, 1, 0, 1)),
        C=np.zeros((n, 1, 1, 0)),
        D=np.zeros((n, 1, 1)),
        E=np.zeros((n, 1, 1, 1)),
        limits=np.full((n, 1), np.inf),
        gates=np.full((n, 1), -1),
        driven=np.zeros((n, 0, 0)),
        outputs=first,
    )


def _with_heavy_motors(numbers: RobotNumbers, heavy: float = _HEAVY) -> RobotNumbers:
    """Return the robot with motors so heavy that they follow the prescribed motion."""
    masses = numbers.masses.copy()
    masses[numbers.rotors] = 0.0
    masses[numbers.rotors, 0] = heavy
    return replace(numbers, masses=masses)


def _motion(prescribed: MotorMotion, numbers: RobotNumbers, tape: RobotTape) -> MassMotion:
    """Return the motion of all masses, means over the parts.

    The load moves even a heavy motor a little, and the link goes with it: positions of motors are those of the
    simulation, so that springs are stretched by what they are, and only accelerations are as prescribed.
    """
    places, speeds = tape.places[tape.first], tape.speeds[tape.first]
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
