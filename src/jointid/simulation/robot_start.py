"""How a robot's simulation begins: at rest, or as its references move.

At rest the controllers' torques hold its weight, and friction holds none of it. In motion every shaft has the velocity
and the acceleration of its reference, and the controllers' torques are those that this takes: the reference leads by
what puts them out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import REFERENCE
from jointid.models.robots.robot import Tree
from jointid.simulation.closed_loop import first_state
from jointid.simulation.loop_input import LoopInput
from jointid.simulation.robot_numbers import SPRING_NUMBERS, MassNumbers, stribeck_share

if TYPE_CHECKING:
    from jointid.simulation.robot_numbers import RobotNumbers
    from jointid.simulation.robots import RobotInput

_SETTLING = 200  # of the iterations that find where the robot begins
_AT_REST = 1e-13  # of a position
_FIRST = 7  # instants of a reference, through which a cubic says how it moves
_NUDGE = 1e-3  # rad: a controller's stiffness is the slope over it


class FirstSample(Protocol):
    """How a robot stands at the first sample of what drives it: a closed loop, or a prescribed motion."""

    @property
    def tree(self) -> Tree:
        """Of the links."""

    @property
    def speeds(self) -> FloatArray:
        """Of the shafts, (n,)."""

    @property
    def accelerations(self) -> FloatArray:
        """Of the shafts, (n,)."""


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
