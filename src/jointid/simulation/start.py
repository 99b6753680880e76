"""How a simulation begins, and how that depends on its parameters.

A joint's motor begins where it is said to be, or on its reference at rest, and the load hangs on it. At rest the
controllers' torques hold a robot's weight, and friction holds none of it. In motion every shaft has the velocity and
the acceleration of its reference, and the controllers' torques are those that this takes: the reference leads by what
puts them out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import POSITION, REFERENCE
from jointid.models.robots.robot import Tree
from jointid.simulation.loop_input import AxisInput, LoopInput
from jointid.simulation.plant import JointNumbers
from jointid.simulation.robot_numbers import (
    SPRING_NUMBERS,
    Bools,
    MassNumbers,
    NumberPlace,
    RobotNumbers,
    stribeck_share,
)

Numbers: TypeAlias = Any
"""Of a joint `plant.JointNumbers`, of a robot, which has a tree, `robot_numbers.RobotNumbers`."""
Keys: TypeAlias = Sequence[Any]
"""Parameters: of a joint their names, of a robot their places among the numbers."""

INITIAL = ("initial_position", "initial_velocity", "initial_torque")

_HARDLY = 0.01  # of the reference's largest speed: at less a friction has not wound up before the first sample
_SETTLING = 200  # of the iterations that find where the robot begins
_AT_REST = 1e-13  # of a position
_NUDGE = 1e-3  # rad: a controller's stiffness is the slope over it, and its state, which is linear, too
_SMALL = 1e-5  # of a number: differences of what balances at the first sample


@dataclass(frozen=True, slots=True)
class Initial:
    """Motor position and velocity at the first sample; None: on the reference, at rest.

    `torque` is the output of an integral there; None: its content is 0.
    """

    position: float | None = None
    velocity: float | None = None
    torque: float | None = None


class Start(NamedTuple):
    """The first state of a simulation.

    Attributes:
        places, speeds: (masses,) of all masses. wound: (masses,) the share of friction that is wound up, or the
            direction in which each slides.
        torques: (n,) that the motors put out, what is added behind the limits left out; None of a controller that puts
            out what its own state says.
        states: (n, states) of the controllers. before: (n,) torques that acted before the first period.
    """

    places: FloatArray
    speeds: FloatArray
    wound: FloatArray
    torques: tuple[float | None, ...]
    states: FloatArray
    before: FloatArray


class Slopes(NamedTuple):
    """Derivatives of a first state by parameters: of places and speeds, (masses, parameters), and states, (n, ...)."""

    places: FloatArray
    speeds: FloatArray
    states: FloatArray


def begin(experiment: LoopInput, numbers: Numbers, initial: Initial | None = None) -> Start:
    """Return the first state; of a robot as its records say, of a joint as it is said."""
    if experiment.tree is not None:
        steady, added = _steady(experiment, numbers), experiment.sampled.post[:, 0]
        places, load = steady.settle()
        speeds, holding = steady.all_speeds, load + steady.own_torques - added
        torques = tuple(float(t) if i else None for t, i in zip(holding, _integrates(experiment), strict=True))
        return _with_states(experiment, places, speeds, np.sign(speeds), numbers.motors, torques)
    initial = initial or Initial()
    position = float(experiment.axis.inputs[0, REFERENCE]) if initial.position is None else initial.position
    velocity = initial.velocity or 0.0
    sliding = wound_up(experiment.axis, velocity)
    places, speeds = joint_state(numbers, position, velocity, sliding)
    return _with_states(experiment, places, speeds, np.full(places.size, sliding), [0], (initial.torque,))


def _with_states(
    experiment: LoopInput, places: FloatArray, speeds: FloatArray, wound: FloatArray, motors: Sequence[int],
    torques: tuple[float | None, ...],
) -> Start:  # fmt: skip
    states, before = np.zeros((len(motors), experiment.sampled.feedback.A.shape[-1])), np.zeros(len(motors))
    for j, (each, motor) in enumerate(zip(experiment.axes, motors, strict=True)):
        own, first = first_state(each, float(places[motor]), float(speeds[motor]), torques[j])
        states[j, : own.size], before[j] = own, first + each.after_limit[0]
    return Start(places, speeds, wound, torques, states, before)


def first_state(axis: AxisInput, position: float, velocity: float, torque: float | None) -> tuple[FloatArray, float]:
    """Feedback states at the first period, (states,), and the torque before it."""
    law, integral = axis.feedback, axis.integral
    state = axis.state + axis.memory @ np.array([position, velocity])
    first = float(axis.feedforward[law.output, 0] + law.C[0, law.output] @ state)
    first += float(law.D[0, law.output, POSITION] * position)
    if integral is not None and torque is not None:
        state = state + integral * (torque - first)
        first = torque
    return state, min(max(first, -law.limit), law.limit)


def wound_up(axis: AxisInput, velocity: float) -> float:
    """Direction of a motion before the first sample, 0 if negligible."""
    reference = axis.inputs[:, REFERENCE]
    fastest = float(np.max(np.abs(np.diff(reference)), initial=0.0)) / axis.law.period
    return math.copysign(1.0, velocity) if abs(velocity) > _HARDLY * fastest > 0.0 else 0.0


def joint_state(
    numbers: JointNumbers, position: float, velocity: float, sliding: float
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of a joint's masses at rest or in steady motion.

    Presliding friction has not wound up at rest. What swings begins with the load.
    """
    joint, steady = numbers.joint, velocity if sliding or not numbers.joint.stepped else 0.0
    places, speeds = np.full((2, numbers.count), [[joint.hang(numbers.values, position, steady)], [velocity]])
    places[0] = position
    return places, speeds


def differences(numbers: Numbers, keys: Keys, of: Callable[[Numbers], FloatArray]) -> FloatArray:
    """Return the derivatives of a function of the numbers, (..., keys); 0 by keys that are none of them."""
    here = of(numbers)
    found = np.zeros((*here.shape, len(keys)))
    for c, key in enumerate(keys):
        if (both := numbers.neighbours(key, _SMALL)) is not None:
            found[..., c] = (of(both[1]) - of(both[0])) / both[2]
    return found


def joint_slopes(numbers: JointNumbers, names: Keys, position: float, velocity: float, sliding: float) -> FloatArray:
    """Return the derivatives of positions and velocities of a joint's masses, (2, masses, names)."""

    def state(other: JointNumbers) -> FloatArray:  # of a share of 0 the upper one swings
        return np.array(joint_state(other, position, velocity, sliding))[:, : numbers.count]

    return differences(numbers, names, state)


def start_slopes(experiment: LoopInput, numbers: Numbers, start: Start, keys: Keys) -> Slopes:
    """Return the derivatives of the first state by parameters."""
    if experiment.tree is not None:
        return _slopes_of_robot(experiment, numbers, start, keys)
    return _slopes_of_joint(experiment.axis, numbers, start, keys)


def _slopes_of_joint(axis: AxisInput, numbers: JointNumbers, start: Start, names: Sequence[str]) -> Slopes:
    """By differences; at rest on straight lines all but the motor's own state leaves it where it is."""
    position, velocity, sliding = float(start.places[0]), float(start.speeds[0]), float(start.wound[0])
    straight, (torque,) = numbers.joint.straight, start.torques
    moving = names if velocity != 0.0 or not straight else [""] * len(names)
    places, speeds = joint_slopes(numbers, moving, position, velocity, sliding)
    states = np.zeros((1, start.states.shape[1], len(names)))
    for j, name in enumerate(names):
        if name in INITIAL:
            by = np.array(INITIAL) == name
            if by[1] and velocity == 0.0:  # the drag of steady motion jumps there
                speeds[:, j] = 1.0
            elif not by[2]:  # affine on one side of 0 where all laws are lines
                step = (1.0 if straight else _SMALL) * (by[0] + by[1] * 0.5 * velocity)
                moved = joint_state(numbers, position + by[0] * step, velocity + by[1] * step, sliding)
                here = joint_state(numbers, position, velocity, sliding)
                places[:, j], speeds[:, j] = ((b - a) / step for a, b in zip(here, moved, strict=True))
            more = None if torque is None else torque + by[2]
            high, low = (first_state(axis, position + x * by[0], velocity + x * by[1], t)[0]
                         for x, t in ((1.0, more), (0.0, torque)))  # fmt: skip
            states[0, :, j] = high - low
    return Slopes(places, speeds, states)


# A robot


@dataclass(frozen=True, slots=True, eq=False)
class Steady:
    """A robot as it moves at the first sample of what drives it: a closed loop, or a prescribed motion.

    Attributes:
        tree: of the links.
        speeds, accelerations: (n,) of the shafts.
        numbers: of the robot.
        free: (n,) where the motors stand without a torque.
        pushed: (n,) the torques on the motors there.
        soft: (n,) the torque that moves each by 1 from there, negative; minus infinity of one that does not give way.
        all_speeds: (masses,) in steady motion: of a link that of its motor. friction: (masses,) at these.
        own_torques: (n,) of the rotors' own inertia and friction.
    """

    tree: Tree | None
    speeds: FloatArray
    accelerations: FloatArray
    numbers: RobotNumbers
    free: FloatArray
    pushed: FloatArray | float = 0.0
    soft: FloatArray | float = -math.inf
    all_speeds: FloatArray = field(init=False)
    friction: FloatArray = field(init=False)
    own_torques: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        masses, rotors, speeds = self.numbers.masses, self.numbers.rotors, np.zeros(self.numbers.count)
        speeds[: self.speeds.size], speeds[rotors] = self.speeds, self.speeds
        viscous = masses[:, 1] + np.where(speeds < 0.0, masses[:, 5], masses[:, 4])
        grip = masses[:, 2] + masses[:, 6] * stribeck_share(masses, speeds)
        friction = np.asarray(viscous * speeds + grip * np.sign(speeds) + masses[:, 3])
        object.__setattr__(self, "all_speeds", speeds)
        object.__setattr__(self, "friction", friction)
        object.__setattr__(self, "own_torques", masses[rotors, 0] * self.accelerations + friction[rotors])

    def load(self, links: FloatArray) -> FloatArray:
        """Return the torques through the springs, of rigid joints the motors' beside `own_torques`, (n,).

        Args:
            links: (n,) positions. Friction may grow with what is carried; at rest it may carry any part of the load,
                and is taken to carry nothing.
        """
        from jointid.models.robots.equations import ROOM, equations_of_motion

        numbers, n = self.numbers, links.size
        taken, M, room = np.empty(n), np.empty((n, n)), np.empty((n, ROOM))
        assert self.tree is not None
        equations_of_motion(self.tree, numbers.inertials, links, self.speeds, self.accelerations, room, M, taken)
        own = np.where(numbers.flexible, 0.0, self.own_torques)
        carried = taken + own + np.where(numbers.flexible & (self.speeds != 0.0), self.friction[:n], 0.0)
        lost = numbers.masses[:n, MassNumbers.PER_TORQUE] * np.sign(self.speeds)
        return np.asarray(carried / (1.0 - lost * np.sign(carried)) - own)

    def deflections(self, torques: FloatArray) -> FloatArray:
        """Return how far torques deflect the springs, (n,); 0 of rigid joints."""
        numbers = self.numbers
        found = np.asarray(torques / np.where(numbers.flexible, numbers.springs[:, 0], np.inf))
        for i, (_, law) in enumerate(numbers.laws):
            if law is not None and not law.linear:
                found[i] = law.deflection(dict(zip(SPRING_NUMBERS, numbers.springs[i], strict=True)), float(torques[i]))
        return found

    def places(self, load: FloatArray) -> FloatArray:
        """Return the positions of all masses, (masses,), under loads on the motors, (n,)."""
        motors, found = self.free + (load + self.own_torques - self.pushed) / self.soft, np.zeros(self.numbers.count)
        found[: motors.size], found[self.numbers.rotors] = motors - self.deflections(load), motors
        return found

    def settle(self) -> tuple[FloatArray, FloatArray]:
        """Return the positions of all masses, (masses,), and the load on each motor, (n,)."""
        motors, load = self.free, np.zeros(self.free.size)
        for _ in range(_SETTLING):
            load = self.load(motors - self.deflections(load))
            before, motors = motors, self.places(load)[self.numbers.rotors]
            if float(np.max(np.abs(motors - before))) <= _AT_REST * (1.0 + float(np.max(np.abs(motors)))):
                break
        return self.places(load), load

    def slopes(self, start: FloatArray, places: Sequence[NumberPlace]) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the positions, (masses, parameters), and of the motors' torques, (n, parameters).

        The load that is in balance moves with the numbers: ``dL = (1 - G_L)^-1 G_p`` where it is ``L = G(L, p)``.

        Args:
            start: (masses,) positions.
            places: of the parameters.
        """
        n = self.speeds.size
        load = self.load(start[:n])

        def balance(steady: Steady, load: FloatArray) -> FloatArray:
            where = steady.places(load)
            return np.concatenate([steady.load(where[:n]), where, load + steady.own_torques])

        step = _SMALL * np.diag(np.maximum(np.abs(load), 1.0))
        by_load = np.column_stack(
            [(balance(self, load + one) - balance(self, load - one)) / (2.0 * np.max(one)) for one in step]
        )
        by_number = differences(self.numbers, places, lambda other: balance(replace(self, numbers=other), load))
        moved = by_number + by_load @ np.linalg.solve(np.eye(n) - by_load[:n], by_number[:n])
        return moved[n:-n], moved[-n:]


def _controllers_at(experiment: LoopInput, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the torques of controllers without memory of a load at positions of the motors, and their slopes, (n,)."""
    torques = np.array(
        [
            [first_state(each, at, speed, None)[1] for at in (place, place + _NUDGE)]
            for each, place, speed in zip(experiment.axes, places, experiment.speeds, strict=True)
        ]
    )
    return torques[:, 0], (torques[:, 1] - torques[:, 0]) / _NUDGE


def _integrates(experiment: LoopInput) -> Bools:
    return np.array([each.integral is not None for each in experiment.axes])


def _steady(experiment: LoopInput, numbers: RobotNumbers) -> Steady:
    """Return the robot as its records begin.

    A law with an integral holds the load on the reference; one without is off by the torque over its gain. Springs are
    stretched by the load.
    """
    references = np.array([each.inputs[0, REFERENCE] for each in experiment.axes])
    at_reference, slope = _controllers_at(experiment, references)
    soft = np.where(_integrates(experiment) | (slope >= 0.0), -np.inf, slope)
    pushed = at_reference + experiment.sampled.post[:, 0]
    return Steady(
        experiment.tree, experiment.speeds, experiment.accelerations, numbers, references, pushed, soft
    )  # fmt: skip


def _slopes_of_robot(
    experiment: LoopInput, numbers: RobotNumbers, start: Start, places: Sequence[NumberPlace]
) -> Slopes:
    """Of ``load(q) + own = torque(qm)`` without an integral, with one qm the reference; ``K (qm - q) = load(q)``."""
    steady, motors, integrates = _steady(experiment, numbers), start.places[numbers.rotors], _integrates(experiment)
    # States of the controllers: at the start, further, with more torque.
    states = np.zeros((*start.states.shape, 3))
    for j, each in enumerate(experiment.axes):
        for i, (at, torque) in enumerate(((0.0, 0.0), (_NUDGE, 0.0), (0.0, 1.0))):
            state, _ = first_state(each, motors[j] + at, steady.speeds[j], torque if integrates[j] else None)
            states[j, : state.size, i] = state
    dq, load = steady.slopes(start.places, places)
    by_place, by_torque = (states[:, :, 1] - states[:, :, 0]) / _NUDGE, states[:, :, 2] - states[:, :, 0]
    dz = by_place[:, :, np.newaxis] * dq[numbers.rotors][:, np.newaxis]
    dz += by_torque[:, :, np.newaxis] * np.where(integrates[:, np.newaxis], load, 0.0)[:, np.newaxis]
    return Slopes(dq, np.zeros_like(dq), dz)
