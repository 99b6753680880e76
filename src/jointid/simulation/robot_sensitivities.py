"""Derivatives of a robot's logged torques by its parameters, by variation (`kernels.robot_sensitivities`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.record import Tap
from jointid.simulation.closed_loop import first_state
from jointid.simulation.loop_input import as_logged
from jointid.simulation.robot_start import controllers_at, weigh
from jointid.simulation.robots import RobotInput, RobotNumbers, RobotRun

_SMALL = 1e-7  # rad: differences of the load
_NUDGE = 1e-3  # rad: differences of a controller's state, which is linear


class NumberOf(IntEnum):
    """What a parameter is a number of: a row of `RobotNumbers`."""

    LINK = 0
    MASS = 1
    SPRING = 2


@dataclass(frozen=True, slots=True)
class NumberPlace:
    """The place of a parameter among a candidate's numbers.

    Attributes:
        of: whose rows. row: which. column: of it.
    """

    of: NumberOf
    row: int
    column: int

    @property
    def is_friction(self) -> bool:
        """Whether it is a friction, a constant torque, or a spring's damping: no inertia and no stiffness."""
        return self.of is not NumberOf.LINK and self.column != 0

    def read(self, numbers: RobotNumbers) -> float:
        """Return the number."""
        return float((numbers.inertials, numbers.masses, numbers.springs)[self.of][self.row, self.column])


def with_values(numbers: RobotNumbers, places: tuple[NumberPlace, ...], values: FloatArray) -> RobotNumbers:
    """Return a candidate with other numbers in these places."""
    arrays = [numbers.inertials.copy(), numbers.masses.copy(), numbers.springs.copy()]
    for place, value in zip(places, values, strict=True):
        arrays[place.of][place.row, place.column] = value
    return replace(numbers, inertials=arrays[0], masses=arrays[1], springs=arrays[2])


def differentiate_torque(run: RobotRun, places: tuple[NumberPlace, ...]) -> FloatArray:
    """Return the derivatives of the torques as the log shows them, (samples, n, parameters).

    Args:
        run: that finished, and whose tape was kept.
        places: of the parameters.

    Of order 2 in the pieces of the tape: against differences of whole runs some 1e-3 of the largest.
    """
    return np.stack(differentiate_torques(run, places), axis=1)


def differentiate_torques(run: RobotRun, places: tuple[NumberPlace, ...]) -> list[FloatArray]:
    """Return what `differentiate_torque` does, joint by joint, (samples, parameters) each: no more is copied."""
    from jointid.simulation.kernels import robot_sensitivities as kernels

    experiment, numbers, tape = run.experiment, run.numbers, run.tape
    clock, n, laws = experiment.clock, numbers.rotors.size, experiment.laws
    rows = np.array([(place.of, place.row, place.column) for place in places], dtype=np.int64).reshape(-1, 3)
    dq, dz, before = _at_start(run, places)
    through = any(each.tap is Tap.COMMAND for each in experiment.experiments) and bool(
        np.any(laws.outputs != laws.taps)
    )
    command = np.zeros((n, clock.steps, len(places)))
    tapped = np.zeros(command.shape if through else (n, 0, 0))
    kernels.differentiate_run(
        *experiment.tree, numbers.inertials, numbers.rotors, numbers.masses, numbers.springs, clock.lags, clock.every,
        *laws.matrices, laws.outputs, laws.taps, run.cuts,
        tape.first, tape.lasting, tape.places, tape.speeds, tape.begun, tape.ended, tape.directions, tape.stopped,
        rows, dq, dz, before, command, tapped,
    )  # fmt: skip
    found = []
    for j, each in enumerate(experiment.experiments):
        seen = tapped[j] if through and each.tap is Tap.COMMAND else command[j]
        found.append(as_logged(each, clock.own(j, seen, each.periods))[: clock.samples])
    return found


def _at_start(run: RobotRun, places: tuple[NumberPlace, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of positions, controllers' states and torques at the first sample.

    Of `robot_start.begin`: ``load(q) + own = torque(qm)`` where the law has no integral, ``qm`` the reference where it
    has; ``K (qm - q) = load(q)``.
    """
    experiment, numbers = run.experiment, run.numbers
    n, rotors, count = numbers.rotors.size, numbers.rotors, len(places)
    motors, links, speeds = run.start[rotors], run.start[:n], experiment.speeds
    integrates = np.array([each.integral is not None for each in experiment.experiments])
    states = np.zeros((n, experiment.laws.A.shape[-1], 3))  # at the start, further, with more torque
    for j, each in enumerate(experiment.experiments):
        for i, (at, torque) in enumerate(((0.0, 0.0), (_NUDGE, 0.0), (0.0, 1.0))):
            state, _ = first_state(each, motors[j] + at, speeds[j], torque if integrates[j] else None)
            states[j, : state.size, i] = state
    slope = controllers_at(experiment, motors)[1]
    soft = np.where(integrates | (slope >= 0.0), 0.0, 1.0 / np.where(slope == 0.0, -1.0, slope))
    compliance = np.where(numbers.flexible, 1.0 / np.where(numbers.flexible, numbers.springs[:, 0], 1.0), 0.0)
    here = weigh(experiment, numbers, links)
    shifted = [weigh(experiment, numbers, links + _SMALL * unit) for unit in np.eye(n)]
    turning = np.column_stack([(there - here) / _SMALL for there in shifted])
    direct, own, stretched = (np.zeros((n, count)) for _ in range(3))
    for c, place in enumerate(places):
        if place.of is NumberOf.LINK:
            unit = replace(numbers, inertials=np.zeros_like(numbers.inertials))
            unit.inertials[place.row, place.column] = 1.0
            direct[:, c] = weigh(experiment, unit, links)
        elif place.of is NumberOf.MASS:
            joint = int(np.flatnonzero(rotors == place.row)[0]) if place.row in rotors else place.row
            v = float(speeds[joint])
            one_way = v * (v < 0.0 if place.column == 5 else v >= 0.0)
            effects = experiment.accelerations[joint], v, np.sign(v), 1.0, one_way, one_way
            (own if place.row == rotors[joint] else direct)[joint, c] = effects[place.column]
        elif place.column == 0:
            stretched[place.row, c] = (motors - links)[place.row]
    moved = turning @ (soft[:, np.newaxis] * own + compliance[:, np.newaxis] * stretched) + direct
    load = np.linalg.solve(np.eye(n) - turning * (soft - compliance), moved)
    dq = np.zeros((run.start.size, count))
    of_motor = soft[:, np.newaxis] * (load + own)
    dq[:n] = of_motor - compliance[:, np.newaxis] * (load - stretched)
    dq[rotors] = of_motor
    by_place, by_torque = (states[:, :, 1] - states[:, :, 0]) / _NUDGE, states[:, :, 2] - states[:, :, 0]
    dz = by_place[:, :, np.newaxis] * of_motor[:, np.newaxis]
    dz += by_torque[:, :, np.newaxis] * np.where(integrates[:, np.newaxis], load + own, 0.0)[:, np.newaxis]
    return dq, dz, load + own


def all_places(experiment: RobotInput, numbers: RobotNumbers) -> tuple[NumberPlace, ...]:
    """Return the places of every number that a robot has: masses, then springs, then links."""
    n = len(experiment.experiments)
    masses = [
        NumberPlace(NumberOf.MASS, row, column)
        for row in range(len(numbers.masses))
        for column in ((0, 2, 3, 4, 5) if np.any(numbers.masses[row, 4:]) else range(4))
        if row in numbers.rotors or column in (1, 2)
    ]
    springs = [
        NumberPlace(NumberOf.SPRING, int(i), column) for i in np.flatnonzero(numbers.flexible) for column in (0, 1)
    ]
    links = [NumberPlace(NumberOf.LINK, row, column) for row in range(n) for column in range(10)]
    return (*masses, *springs, *links)
