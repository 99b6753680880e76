"""Simulation of a robot under its controllers along the references of its records.

Each joint has a controller of its own (`models.controllers`) and a record of its own, whose torque is a mean to know
the log and need not be there. A feed-forward torque is the record's injected signal: logged, or computed by
`add_feed_forward`.

At rest the controllers' torques hold the robot's weight, and friction holds none of it. In motion every shaft has the
velocity and the acceleration of its reference, and the controllers' torques are those that this takes: the reference
leads by what puts them out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.text import join, pluralise
from jointid.models.controllers import REFERENCE, Controller
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.linear import SNAP
from jointid.models.robots.robot import Robot, Tree
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Timing
from jointid.simulation.closed_loop import OUTCOMES, Outcome, first_state
from jointid.simulation.kernels.drive import Feedback, IntArray, SampledLoop
from jointid.simulation.kernels.engine import CUBIC, DAMPING, FREE, SLIDING, SLIPS, STATE, STIFFNESS
from jointid.simulation.loop_input import LoopInput, prepare, seen_torque, to_log
from jointid.simulation.plant import integrate, motion_of
from jointid.simulation.robot_numbers import SPRING_NUMBERS, MassNumbers, RobotNumbers, stribeck_share

FINE, COARSE = 0.5, 1.0
"""Rad of the fastest motion of the robot in one step: an error of some 1e-5 of the torque, and of some 1e-3."""

TORQUE_OF = {POSITION_UNIT[kind]: TORQUE_UNIT[kind] for kind in POSITION_UNIT}
"""Unit of a torque by the unit of the position it moves."""

_STEPS = 64  # per part of a period, at most that are chosen
_POSES = 5  # along the reference, at which the fastest motion is searched for
_ASTRAY = 0.5, 0.1  # of a reference's travel, and rad or m: a joint that is farther off does not follow
_SETTLING = 200  # of the iterations that find where the robot begins
_AT_REST = 1e-13  # of a position
_FIRST = 7  # instants of a reference, through which a cubic says how it moves
_NUDGE = 1e-3  # rad: a controller's stiffness is the slope over it


@dataclass(frozen=True, slots=True, eq=False)
class FirstSample:
    """How a robot moves at the first sample of what drives it: a closed loop, or a prescribed motion.

    Attributes:
        tree: parents, kinds, axes, rotations, origins, gravity, and joints from shafts (`models.robots.equations`).
        speeds, accelerations: (n,) of the shafts.
    """

    tree: Tree
    speeds: FloatArray
    accelerations: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RobotStart:
    """Initial state of a robot's simulation.

    Attributes:
        places, speeds: (masses,) of all masses.
        torques: (n,) that the motors put out, what is added behind the limits left out; None without an integrator,
            whose controllers put out what their own state says.
    """

    places: FloatArray
    speeds: FloatArray
    torques: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class RobotLoop:
    """A robot under its controllers.

    Attributes:
        robot: links, joints and gravity.
        controllers: one for each joint; each sees its motor's position alone, behind the gear. Where motors are coupled
            so are the references: of the shafts that the motors turn.
        in_motion: whether the records begin while the robot moves, each shaft as its reference does; else at rest.

    Raises:
        MethodError: there is not one controller for each joint.
    """

    robot: Robot
    controllers: tuple[Controller, ...]
    in_motion: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "controllers", tuple(self.controllers))
        if len(self.controllers) != len(self.robot.links):
            raise MethodError(
                f"A robot has a controller for each joint; received {len(self.controllers)} for "
                f"{pluralise(len(self.robot.links), 'joint')}: give one for each, in the order of the joints."
            )

    @property
    def loops(self) -> list[ClosedLoop]:
        """Each controller beside a rigid joint of its kind; no parameter of that is read."""
        each = zip(self.robot.links, self.controllers, strict=True)
        return [ClosedLoop(RigidJoint(link.kind), law) for link, law in each]


@dataclass(frozen=True, slots=True, eq=False)
class RobotInput(FirstSample):
    """Parameter-independent inputs of a robot's simulation; made by `prepare_robot`.

    Attributes:
        experiments: of each joint alone.
        clock: that their controllers share.
        sampled: controllers and inputs as the kernels read them.
        payload: (10,) inertial parameters of what the last link carries beside the candidate, or ().
    """

    experiments: tuple[LoopInput, ...]
    clock: RobotClock
    sampled: SampledLoop
    payload: tuple[float, ...] = ()

    def carrying(self, numbers: RobotNumbers) -> RobotNumbers:
        """Return a candidate with the payload."""
        if not self.payload:
            return numbers
        inertials = numbers.inertials.copy()
        inertials[-1] += self.payload
        return replace(numbers, inertials=inertials)

    def delayed(self, numbers: RobotNumbers) -> RobotInput:
        """Return the inputs with a candidate's delays of the torques."""
        if not numbers.delays.size:
            return self
        each = [one.delayed(float(late)) for one, (late,) in zip(self.experiments, numbers.delays, strict=True)]
        clock = common_clock(each, [""] * len(each))
        sampled = self.sampled._replace(lengths=clock.lengths, lags=clock.lags, every=clock.every)
        return replace(self, experiments=tuple(each), clock=clock, sampled=sampled)

    @property
    def references(self) -> FloatArray:
        """Commanded positions at the steps of the clock, (clock, n), held between the controllers' instants."""
        held = [self.clock.repeat(j, each.inputs[:, REFERENCE]) for j, each in enumerate(self.experiments)]
        return np.column_stack(held)


def prepare_robot(loop: RobotLoop, records: Sequence[Record]) -> RobotInput:
    """Prepare the inputs of a robot's simulation from a record of each joint.

    Args:
        loop: robot and controllers.
        records: one for each joint, of one log: its reference, and what is injected; see `jointid.Record`.

    Raises:
        RecordError: a channel that a controller reads is missing, or a clock does not divide the controllers'.
        MethodError: there is not one record for each joint, or controllers or logs share no clock.
    """
    robot = loop.robot
    if len(records) != len(robot.links):
        raise MethodError(
            f"A robot is simulated from a record of each joint; received {len(records)} for "
            f"{pluralise(len(robot.links), 'joint')}: give one for each, in the order of the joints."
        )
    alone = [
        prepare(ClosedLoop(RigidJoint("prismatic" if kind else "revolute"), controller), record)
        for kind, controller, record in zip(robot.tree.kinds, loop.controllers, records, strict=True)
    ]
    clock = common_clock(alone, robot.names)
    after_limit = np.stack([clock.repeat(j, each.after_limit) for j, each in enumerate(alone)])
    laws, feedforward = pack_laws(alone)
    sampled = SampledLoop(clock.lengths, clock.lags, clock.every, laws, feedforward, after_limit)
    motion = np.array([reference_motion(each) if loop.in_motion else (0.0, 0.0) for each in alone]).T.copy()
    payload = records[-1].payload
    return RobotInput(robot.tree, motion[0], motion[1], tuple(alone), clock, sampled, payload)


@dataclass(frozen=True, slots=True, eq=False)
class RobotRun:
    """One candidate's run.

    Attributes:
        experiment: it was driven with. numbers: of the candidate.
        outcome: how it ended. finished: share of the experiment that was simulated. events: that were located.
        before: (n,) torques that acted before the first period. command: (n, clock) those that act.
        start: (masses,) positions at the beginning.
        excess: (n, periods, elements) what limits and gates take away; tape: its steps. Both are empty unless they were
            kept.
    """

    experiment: RobotInput
    numbers: RobotNumbers
    outcome: Outcome
    finished: float
    events: int
    before: FloatArray
    command: FloatArray
    start: FloatArray
    excess: FloatArray
    tape: FloatArray

    @property
    def torque(self) -> FloatArray:
        """The torques as the log shows them, (samples, n)."""
        experiment, found = self.experiment, []
        for j, each in enumerate(experiment.experiments):
            command = experiment.clock.own(j, self.command[j], each.periods)
            found.append(to_log(each, seen_torque(each, command))[: experiment.clock.samples])
        return np.column_stack(found)


@dataclass(frozen=True, slots=True, eq=False)
class MassMotion:
    """The motion of all masses at instants of the log.

    Attributes:
        position, velocity, acceleration: (samples, masses) of the links, where motors are coupled of the shafts that
            these turn, then of the rotors of flexible joints.
        direction: (samples, masses) in which each slides: 1 or -1, 0 of one at rest. Without Coulomb friction, that of
            its velocity.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    direction: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RobotSimulation:
    """One run of a robot, at the log's instants; after a failure everything is held.

    Attributes:
        torque: (samples, n) as the records' torque channels would show them.
        outcome, finished, events: see `RobotRun`.
        sample_time: of the log, s.
        motor_position, motor_velocity: (samples, n). link_position, link_velocity: (samples, n).
        motion: at the instants at which each torque of the first joint begins to act, where its equation holds exactly.
    """

    torque: FloatArray
    outcome: Outcome
    finished: float
    events: int
    sample_time: float
    motor_position: FloatArray
    motor_velocity: FloatArray
    link_position: FloatArray
    link_velocity: FloatArray
    motion: MassMotion

    def records(self, driven: Sequence[Record]) -> tuple[Record, ...]:
        """Return the records that drove the run, with its torques and motor positions as drives would log them."""
        made = []
        for record, torque, position in zip(driven, self.torque.T, self.motor_position.T, strict=True):
            assert record.reference is not None
            unit = record.reference.unit
            logged = Channel(torque, TORQUE_OF[unit], self.sample_time, Timing.HELD, "simulated")
            moved = Channel(position, unit, self.sample_time, source="simulated")
            made.append(replace(record, torque=logged, motor_position=moved))
        return tuple(made)


def run_robot(
    experiment: RobotInput,
    numbers: RobotNumbers,
    *,
    keep: bool = False,
    steps: int | None = None,
    stride: float = FINE,
) -> RobotRun:
    """Run one candidate, and `keep` its tape and where limits act; other arguments are those of `simulate`.

    Without steps they are as many as keep the fastest motion within a stride, rad, each.
    """
    possible = numbers.possible(experiment.clock.steps * float(np.sum(experiment.clock.lengths)))
    experiment = experiment.delayed(numbers) if possible else experiment
    clock, n, masses = experiment.clock, len(experiment.experiments), len(numbers.masses)
    carried, sampled = experiment.carrying(numbers), experiment.sampled
    states, elements = sampled.feedback.A.shape[-1], sampled.w.shape[1]
    start, before, outcome = np.zeros(masses), np.zeros(n), Outcome.INVALID
    taken = 1 if steps is None else steps
    if possible:
        outcome = Outcome.FINISHED
        if steps is None:
            taken = choose_steps(experiment.tree, experiment.references, float(np.max(clock.lengths)), carried)
            # What is too stiff is so whatever the stride: a search that goes by long steps ends where short ones do.
            outcome = outcome if taken <= _STEPS else Outcome.TOO_STIFF
            taken = math.ceil(taken * FINE / stride)
    if outcome is not Outcome.FINISHED:
        nothing = np.zeros((n, clock.steps)), start, np.zeros((n, 0, elements)), np.zeros((0, STATE))
        return RobotRun(experiment, numbers, outcome, 0.0, 0, before, *nothing)
    began = begin(experiment, carried)
    start, state = began.places, np.zeros((n, states))
    for j, each in enumerate(experiment.experiments):
        motor = numbers.rotors[j]
        own, torque = first_state(each, start[motor], began.speeds[motor], began.torques[j])
        state[j, : own.size], before[j] = own, torque + each.after_limit[0]
    far = np.array([each.far for each in experiment.experiments]) + np.abs(start[numbers.rotors])
    found = integrate(
        carried.plant, experiment.tree, carried.inertials, sampled, before, far, state, start, began.speeds,
        np.sign(began.speeds), keep=keep, steps=taken,
    )  # fmt: skip
    finished = int(found.counts[2]) / clock.steps
    return RobotRun(
        experiment, numbers, OUTCOMES[found.status], finished, int(found.counts[0]), before, found.command, start,
        found.excess, found.tape,
    )  # fmt: skip


def simulation_of(run: RobotRun) -> RobotSimulation:
    """Return a run whose tape was kept, at the log's instants."""
    clock, rotors, joints = run.experiment.clock, run.numbers.rotors, run.experiment.tree.joints
    n = rotors.size
    seen, started = motion_at(run, clock.log_index), motion_at(run, clock.torque_index[0])
    position, velocity = (x[:, :n] @ joints.T if joints.size else x[:, :n] for x in (seen.position, seen.velocity))
    return RobotSimulation(
        run.torque, run.outcome, run.finished, run.events, clock.sample_time,
        seen.position[:, rotors], seen.velocity[:, rotors], position, velocity, started,
    )  # fmt: skip


def motion_at(run: RobotRun, parts: IntArray) -> MassMotion:
    """Return the motion as these parts of the clock's steps begin; the tape must have been kept."""
    clock, masses = run.experiment.clock, len(run.start)
    done = round(run.finished * clock.steps) * clock.lengths.size
    if not done or not len(run.tape):
        held = np.tile(run.start, (parts.size, 1))
        return MassMotion(held, 0.0 * held, 0.0 * held, 0.0 * held)
    at = np.minimum(parts, done - 1)
    position, velocity, acceleration, modes = (values[at] for values in motion_of(run.tape, masses, done))
    found = MassMotion(position, velocity, acceleration, np.where(modes == FREE, np.sign(velocity), modes))
    for values in (found.position, found.velocity, found.acceleration):
        np.nan_to_num(values, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return found


def reference_motion(each: LoopInput) -> tuple[float, float]:
    """Return velocity and acceleration of a joint's reference at its first sample."""
    reference = each.inputs[:_FIRST, REFERENCE]
    cubic = np.polyfit(np.arange(reference.size) * each.law.period, reference - reference[0], 3)
    return float(cubic[2]), float(2.0 * cubic[1])


def friction_at(numbers: RobotNumbers, speeds: FloatArray) -> FloatArray:
    """Return the friction of all masses at their velocities, (masses,)."""
    masses = numbers.masses
    viscous = masses[:, 1] + np.where(speeds < 0.0, masses[:, 5], masses[:, 4])
    grip = masses[:, 2] + masses[:, 6] * stribeck_share(masses, speeds)
    return np.asarray(viscous * speeds + grip * np.sign(speeds) + masses[:, 3])


def controllers_at(experiment: RobotInput, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the torques of controllers without memory of a load at positions of the motors, and their slopes, (n,)."""
    torques = np.array(
        [
            [first_state(each, at, speed, None)[1] for at in (place, place + _NUDGE)]
            for each, place, speed in zip(experiment.experiments, places, experiment.speeds, strict=True)
        ]
    )
    return torques[:, 0], (torques[:, 1] - torques[:, 0]) / _NUDGE


def begin(experiment: RobotInput, numbers: RobotNumbers) -> RobotStart:
    """Return all positions at the first sample, and the torques that integrators hold.

    A law with an integral holds the load on the reference; one without is off by the torque over its gain. Springs are
    stretched by the load.
    """
    references = experiment.references[0]
    speeds = speeds_at_start(experiment, numbers)
    of_motors = own_torques(experiment, numbers)
    at_reference, slope = controllers_at(experiment, references)
    asked = at_reference + experiment.sampled.post[:, 0]
    integrates = np.array([each.integral is not None for each in experiment.experiments])
    soft = np.where(integrates | (slope >= 0.0), -np.inf, slope)
    places, load = places_at_start(experiment, numbers, references, soft, of_motors - asked)
    holding = load + of_motors - experiment.sampled.post[:, 0]
    return RobotStart(places, speeds, tuple(float(t) if i else None for t, i in zip(holding, integrates, strict=True)))


def speeds_at_start(first: FirstSample, numbers: RobotNumbers) -> FloatArray:
    """Return the velocities of all masses in steady motion, (masses,): of a link that of its motor."""
    speeds = np.zeros(len(numbers.masses))
    speeds[: numbers.rotors.size], speeds[numbers.rotors] = first.speeds, first.speeds
    return speeds


def places_at_start(
    first: FirstSample, numbers: RobotNumbers, motors: FloatArray, soft: FloatArray, beside: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the positions of all masses in steady motion, (masses,), and the load on each motor, (n,).

    Args:
        first: how the robot moves.
        numbers: of the robot.
        motors: (n,) where the motors stand without a torque.
        soft: (n,) the torque that moves each by 1 from there, negative; minus infinity of one that does not give way.
        beside: (n,) torque of each motor beside the load.
    """
    n, rotors = numbers.rotors.size, numbers.rotors
    free, load = motors, np.zeros(n)
    for _ in range(_SETTLING):
        load = spring_torques(first, numbers, link_torques(first, numbers, motors - deflections(numbers, load)))
        after = free + (load + beside) / soft
        moved = float(np.max(np.abs(after - motors)))
        motors = after
        if moved <= _AT_REST * (1.0 + float(np.max(np.abs(motors)))):
            break
    places = np.zeros(len(numbers.masses))
    places[:n], places[rotors] = motors - deflections(numbers, load), motors
    return places, load


def spring_torques(first: FirstSample, numbers: RobotNumbers, links: FloatArray) -> FloatArray:
    """Return the torques through the springs in steady motion, of rigid joints the motors' beside `own_torques`, (n,).

    Args:
        first: how the robot moves.
        numbers: of the robot.
        links: (n,) the torques that the links take. Friction may grow with what is carried.
    """
    n = numbers.rotors.size
    own = np.where(numbers.flexible, 0.0, own_torques(first, numbers))
    friction = friction_at(numbers, speeds_at_start(first, numbers))[:n]
    # At rest friction may carry any part of the load; it is taken to carry nothing.
    carried = links + own + np.where(numbers.flexible & (first.speeds != 0.0), friction, 0.0)
    lost = numbers.masses[:n, MassNumbers.PER_TORQUE] * np.sign(first.speeds)
    return np.asarray(carried / (1.0 - lost * np.sign(carried)) - own)


def own_torques(first: FirstSample, numbers: RobotNumbers) -> FloatArray:
    """Return the torques of the rotors' own inertia and friction in the first motion, (n,)."""
    own = friction_at(numbers, speeds_at_start(first, numbers))[numbers.rotors]
    return np.asarray(numbers.masses[numbers.rotors, 0] * first.accelerations + own)


def deflections(numbers: RobotNumbers, torques: FloatArray) -> FloatArray:
    """Return how far torques deflect the springs, (n,); 0 of rigid joints."""
    stiffness = np.where(numbers.flexible, numbers.springs[:, 0], np.inf)
    found = np.asarray(torques / stiffness)
    for i, (_, law) in enumerate(numbers.laws):
        if law is not None and not law.linear:
            found[i] = law.deflection(dict(zip(SPRING_NUMBERS, numbers.springs[i], strict=True)), float(torques[i]))
    return found


def link_torques(experiment: FirstSample, numbers: RobotNumbers, places: FloatArray) -> FloatArray:
    """Return the torques that the links take at positions of their shafts, as they move at the first sample, (n,)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n = places.size
    found, M, room = np.empty(n), np.empty((n, n)), np.empty((n, ROOM))
    motion = places, experiment.speeds, experiment.accelerations
    equations_of_motion(experiment.tree, numbers.inertials, *motion, room, M, found)
    return found


def choose_steps(tree: Tree, references: FloatArray, length: float, numbers: RobotNumbers) -> int:
    """Return the steps of a time of this length that keep the robot's fastest motion within 0.5 rad each.

    Args:
        tree: of the links.
        references: (samples, n) where the shafts are about.
        length: s.
        numbers: of the robot.
    """
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n, rotors = numbers.rotors.size, numbers.rotors
    still, room = np.zeros(n), np.empty((n, ROOM))
    size, fastest = len(numbers.masses), 0.0
    rise, below, over = numbers.masses[:, MassNumbers.RISE : MassNumbers.PRESLIDING + 1].T
    steep = np.where(below > 0.0, rise / np.where(below > 0.0, below, 1.0), 0.0)  # some share less than the steepest
    # What winds up is a spring, twice as stiff behind a reversal as where it is not wound up.
    winding = np.where(over > 0.0, 2.0 * numbers.masses[:, MassNumbers.COULOMB] / np.where(over > 0.0, over, 1.0), 0.0)
    springs = np.diag(winding)
    dampers = np.diag(numbers.masses[:, 1] + np.max(numbers.masses[:, 4:6], axis=1) + steep)
    plant = numbers.plant
    for spring, i in enumerate(np.flatnonzero(numbers.flexible)):
        both = np.zeros(size)
        both[i], both[rotors[i]] = 1.0, -1.0
        # A cubic spring is four times as stiff where the cube carries as much as the line.
        stiffest = np.max(plant.springs[spring], axis=0)
        stiffness = stiffest[STIFFNESS] * (4.0 if stiffest[CUBIC] > 0.0 else 1.0)
        springs += (stiffness + 2.0 * stiffest[SLIPS] * stiffest[SLIDING]) * np.outer(both, both)
        dampers += stiffest[DAMPING] * np.outer(both, both)
    for pose in references[:: max(len(references) // _POSES, 1)]:
        M = np.zeros((size, size))
        links = np.empty((n, n))
        equations_of_motion(tree, numbers.inertials, pose, still, still, room, links, np.empty(n))
        M[:n, :n] = links
        M[np.diag_indices(size)] += numbers.masses[:, 0]
        lowest = float(np.linalg.eigvalsh(0.5 * (M + M.T))[0])
        if not lowest > 0.0:  # the kernel says of it what is to be said
            continue
        each = [np.abs(np.linalg.eigvals(np.linalg.solve(M, matrix))) for matrix in (springs, dampers)]
        fastest = max(fastest, math.sqrt(float(np.max(each[0]))), float(np.max(each[1])))
    return max(math.ceil(length * fastest / FINE), 1)


def add_feed_forward(
    loop: RobotLoop, records: Sequence[Record], kind: Literal["gravity", "inverse-model"] = "inverse-model"
) -> tuple[Record, ...]:
    """Return the records with the torque of the robot's model along the references injected before the limits.

    Args:
        loop: robot and controllers; the model is the robot with its own numbers, links and rotors without springs.
        records: one for each joint, with references at one rate.
        kind: the weight alone, or the whole inverse model without Coulomb friction.

    Raises:
        MethodError: a record has no reference, or references differ in rate or length.
    """
    from jointid.models.robots.dynamics import inverse_dynamics

    channels = [record.reference for record in records]
    if any(channel is None for channel in channels) or len({(c.sample_time, len(c)) for c in channels if c}) != 1:
        raise MethodError("A feed-forward is computed from references of one rate and one length; give one per joint.")
    numbers, given = RobotNumbers.of(loop.robot), [channel for channel in channels if channel]
    sample_time = given[0].sample_time
    q = np.column_stack([channel.values for channel in given])
    v = np.gradient(q, sample_time, axis=0)
    a = np.gradient(v, sample_time, axis=0)
    if kind == "gravity":
        v, a = np.zeros_like(q), np.zeros_like(q)
    joints = np.linalg.inv(loop.robot.coupling)  # the references are those of the shafts
    motion = (np.ascontiguousarray(x @ joints.T) for x in (q, v, a))
    torque = inverse_dynamics(loop.robot.tree, numbers.inertials, *motion)
    torque = torque @ joints
    of_motor, n = numbers.masses[numbers.rotors], len(loop.robot.links)
    both = of_motor + np.where(numbers.flexible[:, np.newaxis], numbers.masses[:n], 0.0)
    viscous = both[:, 1] + np.where(v < 0.0, both[:, 5], both[:, 4])
    torque += of_motor[:, 0] * a + viscous * v + of_motor[:, 3]
    units = [TORQUE_UNIT["prismatic" if prismatic else "revolute"] for prismatic in loop.robot.tree.kinds]
    return tuple(
        replace(
            record,
            injected=Injection(
                Channel(torque[:, j], units[j], sample_time, Timing.HELD, "computed"), InjectionPoint.BEFORE_LIMIT
            ),
        )
        for j, record in enumerate(records)
    )


def tracking_errors(records: Sequence[Record], run: RobotSimulation) -> dict[int, float]:
    """Return how far each joint that does not follow its reference gets off it, by its place, rad or m.

    One follows that stays within half of its reference's travel, and 0.1 rad or m: a loop may be slow, and a weight may
    pull it down, but a joint without gains falls.
    """
    at, found = np.arange(len(run.motor_position)) * run.sample_time, {}
    for j, record in enumerate(records):
        if record.reference is not None:
            reference = np.interp(at, record.reference.time, record.reference.values)
            off = float(np.max(np.abs(run.motor_position[:, j] - reference)))
            if off > _ASTRAY[0] * np.ptp(reference) + _ASTRAY[1]:
                found[j] = off
    return found


_FINEST = 16  # steps of the shortest period, at most: the time of a simulation grows with them


@dataclass(frozen=True, slots=True, eq=False)
class RobotClock:
    """The clock of a robot's controllers.

    Attributes:
        steps: that are simulated.
        lengths: (parts,) s, of a step: in none does a torque change.
        lags: (n, parts) how many steps ago the output that acts there was put out, or a later one that is held.
        every: (n,) steps of each controller's period.
        sample_time: of the log, s.
        log_index: (samples,) which of all parts, step after step, begin at the log's instants.
        torque_index: (n, samples) those at which the newest torque of each joint, as the log shows it, begins to act.
    """

    steps: int
    lengths: FloatArray
    lags: IntArray
    every: IntArray
    sample_time: float
    log_index: IntArray
    torque_index: IntArray

    @property
    def samples(self) -> int:
        """Of the log."""
        return self.log_index.size

    def repeat(self, joint: int, values: FloatArray) -> FloatArray:
        """Return values of a controller's periods at every step of the clock, (steps,)."""
        return np.repeat(values, self.every[joint])[: self.steps]

    def own(self, joint: int, values: FloatArray, periods: int) -> FloatArray:
        """Return values of every step at a controller's own periods, (periods, ...), the last one held."""
        every = int(self.every[joint])
        if every == 1 and len(values) == periods:
            return values
        return np.asarray(values[np.minimum(np.arange(periods) * every, (len(values) - 1) // every * every)])


def common_clock(alone: Sequence[LoopInput], names: Sequence[str]) -> RobotClock:
    """Return the clock of controllers that were prepared each alone.

    Raises:
        MethodError: logs differ in rate or length, or the periods have no common step that is worth simulating.
    """
    sample_time = alone[0].sample_time
    periods = np.array([each.law.period for each in alone])
    lasts = np.array([each.periods for each in alone]) * periods
    longest = max(float(np.max(periods)), sample_time)
    other = [
        name
        for name, each, last in zip(names, alone, lasts, strict=True)
        if abs(each.sample_time - sample_time) > SNAP * sample_time or abs(last - lasts[0]) > (1 + SNAP) * longest
    ]
    if other:
        raise MethodError(
            f"A robot is simulated along one log; the records of {join(other)} differ from that of {names[0]} in "
            "sample time or length: give all joints the same."
        )
    shortest = min(float(np.min(periods)), sample_time)
    ratios = np.array([*periods, sample_time]) / shortest
    finest = (n for n in range(1, _FINEST + 1) if np.allclose(n * ratios, np.round(n * ratios), rtol=SNAP, atol=0.0))
    step = next((shortest / n for n in finest), None)
    if step is None:
        said = join([f"{name} {1e3 * period:.6g} ms" for name, period in zip(names, periods, strict=True)])
        raise MethodError(
            f"A robot's controllers share a clock, of which each period is so many steps; received {said}, and no step "
            f"of a {_FINEST}th of the shortest or more divides them: correct the periods."
        )
    every = np.array([round(period / step) for period in periods], dtype=np.int64)
    late = np.array([each.law.delay / step for each in alone])
    whole = np.floor(late + SNAP)
    within = np.where(late - whole < SNAP, 0.0, late - whole)
    cuts = [0.0]
    for cut in sorted(within):
        if cut - cuts[-1] > SNAP:
            cuts.append(float(cut))
    lengths = np.diff([*cuts, 1.0]) * step
    lags = (whole[:, np.newaxis] + (np.array(cuts) < within[:, np.newaxis] - SNAP)).astype(np.int64)
    steps, parts = int(min(each.periods * n for each, n in zip(alone, every, strict=True))), len(cuts)
    samples = min(each.samples for each in alone)
    at = np.arange(samples) * round(sample_time / step)
    newest = np.argmin(lags, axis=1)
    started = [
        np.minimum(at // every[j] * every[j] + lags[j, newest[j]], steps - 1) * parts + newest[j]
        for j in range(len(alone))
    ]
    return RobotClock(steps, lengths, lags, every, sample_time, at * parts, np.array(started))


def pack_laws(alone: Sequence[LoopInput]) -> tuple[Feedback, FloatArray]:
    """Return the controllers filled up to equal sizes, and their answers to everything but the positions.

    States that are filled up stay 0, as elements do; the answers are (n, elements, periods), each of its own periods.
    """
    kernels = [each.kernel for each in alone]
    phases = math.lcm(*(kernel.A.shape[1] for kernel in kernels))
    longest = max(each.periods for each in alone) if any(kernel.driven.size for kernel in kernels) else 0

    def repeat(name: str) -> NDArray[Any]:
        return _fill_up(
            [np.concatenate([own] * (phases // len(own))) for (own,) in (getattr(k, name) for k in kernels)]
        )

    A, Bq, F, C, D, E = map(repeat, ("A", "Bq", "F", "C", "D", "E"))
    limits = _fill_up([kernel.limits[0] for kernel in kernels], math.inf)
    gates = _fill_up([kernel.gates[0] for kernel in kernels], -1)
    driven = _fill_up([kernel.driven[0] for kernel in kernels], 0.0, (longest, 0))
    output = np.concatenate([kernel.output for kernel in kernels])
    return Feedback(A, Bq, F, C, D, E, limits, gates, driven, output), _fill_up([each.feedforward for each in alone])


def _fill_up(arrays: Sequence[NDArray[Any]], beyond: float = 0.0, least: tuple[int, ...] = ()) -> NDArray[Any]:
    """Return arrays in one, each filled up to the sizes of the largest."""
    sizes = np.max([array.shape for array in arrays] + ([least] if least else []), axis=0)
    whole = np.full((len(arrays), *sizes), beyond, dtype=arrays[0].dtype)
    for one, own in zip(whole, arrays, strict=True):
        one[tuple(slice(size) for size in own.shape)] = own
    return whole
