"""Simulation of a candidate joint or robot under its controllers.

All run in `kernels.engine`; piecewise linear joints are advanced by affine maps between events.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.models.position_forces import Motion
from jointid.models.robots.robot import Tree
from jointid.records.record import Channel, Record, Timing
from jointid.simulation import kernels
from jointid.simulation.kernels import FREE, PART, STATE, IntArray, Path, Plant, SampledLoop
from jointid.simulation.loop_input import LoopInput
from jointid.simulation.plant import Numbers
from jointid.simulation.start import Initial, Start, begin

FINE, COARSE = 0.5, 1.0
"""Rad of the fastest motion of the robot in one step: an error of some 1e-5 of the torque, and of some 1e-3."""

STEPS = 64
"""Of a robot per part of a period, at most that are chosen."""
_TORQUE_OF = {POSITION_UNIT[kind]: TORQUE_UNIT[kind] for kind in POSITION_UNIT}  # unit by that of the position
_POSES = 5  # along the reference, at which the fastest motion is searched for
_MORE, _TAPED = 2, 1000  # rows of a tape per step and part, and beside these


class Outcome(StrEnum):
    """Outcome of a simulation; its value is the sentence to print."""

    FINISHED = "the simulation finished"
    DIVERGED = "the loop diverged: it is unstable under its controllers"
    TOO_STIFF = "the motion is too fast for the period of controllers or log to be worth simulating"
    CHATTERING = "a joint started and stopped more often within one period than a real one can"
    NOT_POSITIVE = "its mass matrix is not positive definite in a pose that it reached: no robot has such inertias"
    INVALID = (
        "an inertia or the Coulomb friction is not positive, friction at rest or at the end of the record is less than "
        "nothing, a Stribeck speed is 0, the torques of a spring's pieces do not rise, something winds up over less "
        "than nothing, a share of the torque or of the load is 1 or more, or a value is not a number"
    )


def require_success(run: Simulation, of_what: str = "The simulation") -> Simulation:
    """Return a run that finished.

    Raises:
        MethodError: it failed; the sentence states progress and reason.
    """
    if run.outcome is not Outcome.FINISHED:
        raise MethodError(
            f"{of_what} stopped after {100 * run.finished:.1f} % of the record because {run.outcome.value}; check the "
            "controller's gains and the parameters' values."
        )
    return run


class MassMotion(NamedTuple):
    """The motion of all masses at some instants.

    Attributes:
        position, velocity, acceleration: (samples, masses) of a joint's motor and load; of a robot's links, where
            motors are coupled of the shafts that these turn, then of the rotors of flexible joints.
        direction: (samples, masses) in which each slides: 1 or -1, 0 of one at rest. Without Coulomb friction, that of
            its velocity.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    direction: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One candidate's run.

    Attributes:
        experiment: it was driven with. numbers: of the candidate.
        plant: masses and springs as the kernels read them.
        start: its first state.
        outcome: how it ended.
        command: (n, clock) torques that act, the last held after a failure.
        excess: (n, periods, elements) what limits and gates take away; tape: its steps. Both are empty unless they were
            kept.
        path: of a joint of lines in pieces, kept with the tape.
        counts: (4,) events, rows of the tape, steps of the clock, and those at a limit.
    """

    experiment: LoopInput
    numbers: Numbers
    plant: Plant
    start: Start
    outcome: Outcome
    command: FloatArray
    excess: FloatArray
    tape: FloatArray
    path: Path | None
    counts: IntArray

    @property
    def carried(self) -> Numbers:
        """The numbers, with the payload of a robot."""
        return self.numbers.carrying(self.experiment.payload)

    @property
    def finished(self) -> float:
        """Share of the experiment that was simulated."""
        return int(self.counts[2]) / self.experiment.clock.steps

    @property
    def events(self) -> int:
        """Reversals, stops and starts that were located."""
        return int(self.counts[0])

    @property
    def at_limit(self) -> float:
        """Share of the periods in which a controller was at its limit."""
        return int(self.counts[3]) / max(int(self.counts[2]), 1)

    @property
    def torque(self) -> FloatArray:
        """Logged torques, (samples, n); (samples,) for a joint."""
        shown = self.experiment.to_log(self.command)
        return shown if self.experiment.tree is not None else shown[:, 0]


def run_loop(
    experiment: LoopInput,
    numbers: Numbers,
    initial: Initial | None = None,
    *,
    keep: bool = False,
    steps: int | None = None,
    stride: float = FINE,
    room: Room | None = None,
) -> Run:
    """Simulate one candidate; invalid numbers give an outcome, not an exception.

    Args:
        experiment: inputs of the loop, from `prepare`.
        numbers: of the candidate.
        initial: state of a joint's motor at the first sample.
        keep: also the tape, and where limits act.
        steps: of a robot's integrator per part of a step of the clock; None for as many as keep the fastest motion
            within a stride.
        stride: rad.
        room: memory for the tape.
    """
    carried = numbers.carrying(experiment.payload)
    plant, taken, outcome = carried.plant, steps or 0, Outcome.INVALID
    if carried.possible(plant, experiment.clock.steps * float(np.sum(experiment.clock.lengths))):
        outcome, experiment = Outcome.FINISHED, experiment.delayed(numbers)
        if experiment.tree is not None and steps is None:
            clock, inertials = experiment.clock, carried.inertials
            longest = float(np.max(clock.lengths))
            taken = choose_steps(experiment.tree, experiment.references, longest, plant, inertials)
            # What is too stiff is so whatever the stride: a search that goes by long steps ends where short ones do.
            outcome = outcome if taken <= STEPS else Outcome.TOO_STIFF
            taken = math.ceil(taken * FINE / stride)
    n, elements, _ = experiment.sampled.w.shape
    still, start = np.zeros(numbers.count), None
    if outcome is Outcome.FINISHED:
        start = begin(experiment, carried, initial)
        outcome = outcome if np.all(np.isfinite([start.places, start.speeds])) else Outcome.INVALID
    if start is None or outcome is not Outcome.FINISHED:
        nowhere = Start(still, still, still, (None,) * n, np.zeros((n, 0)), np.zeros(n))
        none, counts = np.zeros((n, 0, elements)), np.zeros(4, np.int64)
        nothing = np.zeros((n, experiment.clock.steps)), none, np.zeros((0, STATE)), None, counts
        return Run(experiment, numbers, plant, nowhere, outcome, *nothing)
    far = experiment.far + np.abs(start.places[numbers.motors])
    outcome, command, excess, tape, path, counts = integrate(
        plant, experiment.tree, carried.inertials, experiment.sampled, start.before, far, start.states, start.places,
        start.speeds, start.wound, keep=keep, straight=numbers.straight, steps=taken, room=room,
    )  # fmt: skip
    return Run(experiment, numbers, plant, start, outcome, command, excess, tape, path, counts)


def integrate(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, before: FloatArray, far: FloatArray,
    z: FloatArray, place: FloatArray, speed: FloatArray, wound: FloatArray, *, keep: bool, straight: bool = False,
    steps: int = 0, room: Room | None = None,
) -> tuple[Outcome, FloatArray, FloatArray, FloatArray, Path | None, IntArray]:  # fmt: skip
    """Run `kernels.engine`; keep its tape on demand, in a room's memory.

    Returns how it ended, then command, excess, tape, path and counts as `Run` has them.

    The arguments are those of `kernels.engine.run`; `straight` for a piecewise linear joint. Steps are those of the
    integrator in the longest part of a step of the clock; 0 lets each choose its length.
    """
    from jointid.simulation.kernels import affine, engine

    axes, clock = loop.post.shape
    parts, (_, elements, periods) = loop.lengths.size, loop.w.shape
    array: Any = room.array if room is not None else lambda _, *of: np.empty(*of)
    command = np.empty((axes, clock))  # never in a room: it may be an answer
    excess = array("excess", (axes, periods if keep else 0, elements))
    excess[:] = 0.0
    path = None
    if straight:
        bands, pieces, followed = plant.masses.shape[1], 2 * plant.springs.shape[1] - 1, clock * parts if keep else 0
        rates = np.zeros((affine.MODES * bands ** len(place) * pieces ** len(plant.pairs), 2, affine.INPUTS))
        maps = len(rates) * parts
        path = Path(
            array("states", (followed, 4)), array("modes", (followed,), np.int16), rates,
            np.empty((maps, affine.INPUTS, 4)), np.empty((maps, 4)),
            array("pushes", (maps if keep else 0, affine.INPUTS * affine.WIDE)),
        )  # fmt: skip
    rows = (clock // 8 if straight else _MORE * clock * parts * max(steps, 1)) + _TAPED if keep else 0
    rate, reach = (steps / float(np.max(loop.lengths)), 1.0) if steps else (0.0, engine.REACH)
    while True:
        tape = array("tape", (rows, STATE + 7 * len(plant.masses) + 3 * len(plant.pairs)))
        counts, joint = np.zeros(4, np.int64), None if straight or tree is not None else (0.0,) * len(place)
        status = engine.run(
            plant, tree, inertials, loop, before, far, z.copy(), joint, place, speed, None if straight else wound, rate,
            reach, command, excess, tape, path, counts,
        )  # fmt: skip
        if not keep or counts[1] <= rows:  # else joints that turn round and stick all the time
            break
        rows = int(counts[1])
    done = int(counts[2])
    if status != kernels.FINISHED:
        command[:, done:] = command[:, done - 1 : done] if done else 0.0
        for j, every in enumerate(loop.every):
            excess[j, -(-done // int(every)) :] = 0.0
        for signal in (command, excess, path.states[: done * parts]) if path else (command, excess):  # overflow
            np.nan_to_num(signal, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return tuple(Outcome)[status], command, excess, tape[: counts[1]], path, counts


def pass_on(torques: FloatArray, step: float) -> SampledLoop:
    """Wrap given torques, (joints, parts), as laws of period `step`, s."""
    joints, parts = torques.shape
    none, zero = np.zeros((joints, 1, 0)), np.zeros((joints, 1, 1))
    lags, first = np.zeros((joints, 1), dtype=np.int64), np.zeros(joints, dtype=np.int64)
    return SampledLoop(
        np.array([step]), lags, first + 1, np.zeros((joints, 1, 0, 0)), none, none[..., np.newaxis],
        none[:, np.newaxis], zero, zero[..., np.newaxis], zero[:, 0] + np.inf, lags - 1, none[:, :0], first,
        np.ascontiguousarray(torques)[:, np.newaxis], np.zeros((joints, parts)),
    )  # fmt: skip


def motion_of(tape: FloatArray, masses: int, parts: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Positions, velocities, accelerations and modes at each part's start, (parts, masses)."""
    first = np.flatnonzero(np.diff(tape[:, PART], prepend=-1.0))[:parts]
    position, velocity, acceleration, modes = (
        np.take(tape[:, STATE + i * masses : STATE + (i + 1) * masses], first, 0) for i in (0, 1, 2, 4)
    )
    return position, velocity, acceleration, modes


def motion_at(run: Run, parts: IntArray) -> MassMotion:
    """Motion at the start of given parts; needs the tape."""
    clock, masses = run.experiment.clock, run.start.places.size
    done = int(run.counts[2]) * clock.lengths.size
    if not done or not len(run.tape):
        held = np.tile(run.start.places, (parts.size, 1))
        return MassMotion(held, 0.0 * held, 0.0 * held, 0.0 * held)
    at = np.minimum(parts, done - 1)
    if run.path is not None:  # accelerations are those just after torques change
        post, path, rates = run.experiment.sampled.post[0], run.path, run.path.rates[:, :masses].T
        states, mode = np.take(path.states, at, 0), path.modes[at].astype(np.int64)
        source = at // clock.lengths.size - clock.lags[0, at % clock.lengths.size]
        torque = np.where(source >= 0, (run.command[0] + post)[np.maximum(source, 0)], run.start.before[0])
        inputs = states[:, 1], states[:, 2] - states[:, 0], states[:, 3], torque, np.ones(1)
        acceleration = np.asarray(sum(x * np.take(rate, mode, 1) for x, rate in zip(inputs, rates, strict=True))).T
        way = mode[:, np.newaxis] // np.array([3, 1])[:masses] % 3 - 1.0  # of 9 modes each
        return MassMotion(states[:, ::2][:, :masses], states[:, 1::2][:, :masses], acceleration, way)
    position, velocity, acceleration, modes = (values[at] for values in motion_of(run.tape, masses, done))
    found = MassMotion(position, velocity, acceleration, np.where(modes == FREE, np.sign(velocity), modes))
    for values in found[:3]:
        np.nan_to_num(values, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """One run at the log's instants; after a failure everything is held.

    Arrays are (samples, n) of a robot, and (samples,) of a joint.

    Attributes:
        torque: as the records' torque channels would show them.
        outcome: how the run ended. finished: share of the experiment that was simulated.
        events: reversals, stops and starts that were located.
        at_limit: share of the periods in which a controller was at its limit.
        sample_time: of the log, s.
        push: torque on each motor by controller and injection, before the delay, whatever the log shows.
        motor_position, motor_velocity: of the motors.
        load_position, load_velocity: of the links of a robot; of a joint's load, None for a rigid joint.
        motion: of all masses at the instants at which each torque of the first axis begins to act, where its equation
            ``torque = regressor . parameters`` holds exactly.
    """

    torque: FloatArray
    outcome: Outcome
    finished: float
    events: int
    at_limit: float
    sample_time: float
    push: FloatArray
    motor_position: FloatArray
    motor_velocity: FloatArray
    load_position: FloatArray | None
    load_velocity: FloatArray | None
    motion: MassMotion

    @classmethod
    def of(cls, run: Run) -> Simulation:
        """Return a run that was kept."""
        experiment, clock = run.experiment, run.experiment.clock
        seen, started = motion_at(run, clock.log_index)[:2], motion_at(run, clock.torque_index[0])
        put_out = (run.command + experiment.sampled.post)[:, clock.log_index // clock.lengths.size].T
        if experiment.tree is None:
            push, motors = put_out[:, 0], [(x[:, 0]) for x in seen]
            loads = [x[:, 1] if x.shape[1] > 1 else None for x in seen]
        else:
            n, joints = len(experiment.axes), experiment.tree.joints
            push, motors = put_out, [x[:, run.numbers.motors] for x in seen]
            loads = [x[:, :n] @ joints.T if joints.size else x[:, :n] for x in seen]
        return cls(
            run.torque, run.outcome, run.finished, run.events, run.at_limit, clock.sample_time, push, motors[0],
            motors[1], loads[0], loads[1], started,
        )  # fmt: skip

    @property
    def motor(self) -> Motion:
        """Motion of a joint's motor, at the instants of `motion`."""
        return Motion(*(one[:, 0] for one in self.motion[:3]))

    @property
    def load(self) -> Motion | None:
        """Motion of a joint's load; None for a rigid joint."""
        return None if self.load_position is None else Motion(*(one[:, 1] for one in self.motion[:3]))

    def records(self, driven: Sequence[Record], force: str | None = None) -> tuple[Record, ...]:
        """The driving records with simulated torques and positions, as drives log them.

        Args:
            driven: a record of each joint. That of a single joint also has the position of its load.
            force: unit of the torques, if it is not that of the joint's kind.
        """
        made, alone = [], self.torque.ndim == 1
        for j, record in enumerate(driven):
            assert record.reference is not None
            unit = record.reference.unit
            timing = Timing.HELD if record.torque is None else record.torque.timing

            def channel(values: FloatArray, unit: str = unit, timing: Timing = Timing.SAMPLED, j: int = j) -> Channel:
                return Channel(values if alone else values[:, j], unit, self.sample_time, timing, "simulated")

            load = None if self.load_position is None or not alone else channel(self.load_position)
            torque = channel(self.torque, force or _TORQUE_OF[unit], timing)
            moved = channel(self.motor_position)
            made.append(replace(record, torque=torque, motor_position=moved, load_position=load))
        return tuple(made)


def choose_steps(tree: Tree, references: FloatArray, length: float, plant: Plant, inertials: FloatArray) -> int:
    """Steps per `length`, s, that keep a robot's fastest motion along references, (samples, n), within 0.5 rad."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n, size, poses = len(inertials), len(plant.masses), references[:: max(len(references) // _POSES, 1)]
    still, room, links = np.zeros(n), np.empty((n, ROOM)), np.empty((n, n))
    whole = plant.masses[:, -1]
    # What winds up is a spring, twice as stiff behind a reversal as where it is not wound up.
    springs = np.diag(2.0 * whole[:, kernels.COULOMB] * whole[:, kernels.WINDING])
    dampers = np.diag(np.max(np.abs(plant.masses[..., kernels.VISCOUS : kernels.VISCOUS_BACK + 1]), axis=(1, 2)))
    for pair, pieces in zip(plant.pairs.astype(int), plant.springs, strict=True):
        both = np.zeros(size)
        both[pair] = 1.0, -1.0
        # A cubic spring is four times as stiff where the cube carries as much as the line.
        stiffest = np.max(pieces, axis=0)
        stiffness = stiffest[kernels.STIFFNESS] * (4.0 if stiffest[kernels.CUBIC] > 0.0 else 1.0)
        springs += (stiffness + 2.0 * stiffest[kernels.SLIPS] * stiffest[kernels.WINDING]) * np.outer(both, both)
        dampers += stiffest[kernels.DAMPING] * np.outer(both, both)
    masses = np.tile(np.diag(plant.masses[:, 0, kernels.INERTIA]), (len(poses), 1, 1))
    for M, pose in zip(masses, poses, strict=True):
        equations_of_motion(tree, inertials, pose, still, still, room, links, np.empty(n), False)
        M[:n, :n] += links
    inertia, axes = np.linalg.eigh(masses)
    sound = inertia[:, 0] > 0.0  # of the others the kernel says what is to be said
    white = axes[sound] / np.sqrt(inertia[sound])[:, np.newaxis]
    each = (white.swapaxes(1, 2) @ matrix @ white for matrix in (springs, dampers))
    stiff, damped = (float(np.max(np.linalg.eigvalsh(one), initial=0.0)) for one in each)
    return max(math.ceil(length * max(math.sqrt(stiff), damped) / FINE), 1)
