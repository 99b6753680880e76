"""Derivatives of a robot's logged torques by its parameters, by variation (`kernels.robot_sensitivities`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.record import Tap
from jointid.simulation.closed_loop import first_state
from jointid.simulation.loop_input import to_log
from jointid.simulation.robot_numbers import NumberOf, NumberPlace, RobotNumbers, stribeck_share
from jointid.simulation.robot_start import FirstSample, controllers_at, weigh
from jointid.simulation.robots import RobotRun

_SMALL = 1e-7  # rad: differences of the load
_NUDGE = 1e-3  # rad: differences of a controller's state, which is linear


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
    moved = kernels.Moved(dq, np.zeros_like(dq), dz, before)
    kernels.differentiate_run(
        experiment.tree, numbers.bodies, clock.timing, laws, run.cuts, tape, rows, moved, command, tapped,
        np.zeros((n, 0, 0)),
    )  # fmt: skip
    found = []
    for j, each in enumerate(experiment.experiments):
        seen = tapped[j] if through and each.tap is Tap.COMMAND else command[j]
        found.append(to_log(each, clock.own(j, seen, each.periods))[: clock.samples])
    return found


def _at_start(run: RobotRun, places: tuple[NumberPlace, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of positions, controllers' states and torques at the first sample.

    Of `robot_start.begin`: ``load(q) + own = torque(qm)`` where the law has no integral, ``qm`` the reference where it
    has; ``K (qm - q) = load(q)``.
    """
    experiment, numbers = run.experiment, run.numbers
    n, rotors = numbers.rotors.size, numbers.rotors
    motors, speeds = run.start[rotors], experiment.speeds
    integrates = np.array([each.integral is not None for each in experiment.experiments])
    states = np.zeros((n, experiment.laws.A.shape[-1], 3))  # at the start, further, with more torque
    for j, each in enumerate(experiment.experiments):
        for i, (at, torque) in enumerate(((0.0, 0.0), (_NUDGE, 0.0), (0.0, 1.0))):
            state, _ = first_state(each, motors[j] + at, speeds[j], torque if integrates[j] else None)
            states[j, : state.size, i] = state
    slope = controllers_at(experiment, motors)[1]
    soft = np.where(integrates | (slope >= 0.0), 0.0, 1.0 / np.where(slope == 0.0, -1.0, slope))
    dq, load = slopes_at_start(experiment, numbers, run.start, soft, places)
    of_motor = dq[rotors]
    by_place, by_torque = (states[:, :, 1] - states[:, :, 0]) / _NUDGE, states[:, :, 2] - states[:, :, 0]
    dz = by_place[:, :, np.newaxis] * of_motor[:, np.newaxis]
    dz += by_torque[:, :, np.newaxis] * np.where(integrates[:, np.newaxis], load, 0.0)[:, np.newaxis]
    return dq, dz, load


def slopes_at_start(
    first: FirstSample, numbers: RobotNumbers, start: FloatArray, soft: FloatArray, places: tuple[NumberPlace, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the positions in steady motion, and of the motors' torques there.

    Args:
        first: how the robot moves.
        numbers: of the robot.
        start: (masses,) positions.
        soft: (n,) how far a torque of 1 moves each motor; 0 of one that does not give way.
        places: of the parameters.

    Returns:
        (masses, parameters) and (n, parameters).
    """
    n, rotors, count = numbers.rotors.size, numbers.rotors, len(places)
    motors, links, speeds = start[rotors], start[:n], first.speeds
    compliance = np.where(numbers.flexible, 1.0 / np.where(numbers.flexible, numbers.springs[:, 0], 1.0), 0.0)
    here = weigh(first, numbers, links)
    shifted = [weigh(first, numbers, links + _SMALL * unit) for unit in np.eye(n)]
    turning = np.column_stack([(there - here) / _SMALL for there in shifted])
    direct, own, stretched = (np.zeros((n, count)) for _ in range(3))
    for c, place in enumerate(places):
        if place.of is NumberOf.LINK:
            unit = replace(numbers, inertials=np.zeros_like(numbers.inertials))
            unit.inertials[place.row, place.column] = 1.0
            direct[:, c] = weigh(first, unit, links)
        elif place.of is NumberOf.MASS:
            joint = int(np.flatnonzero(rotors == place.row)[0]) if place.row in rotors else place.row
            v = float(speeds[joint])
            one_way = v * (v < 0.0 if place.column == 5 else v >= 0.0)
            rise = float(stribeck_share(numbers.masses[place.row], np.array(v))) * np.sign(v)
            effects = first.accelerations[joint], v, np.sign(v), 1.0, one_way, one_way, rise
            (own if place.row == rotors[joint] else direct)[joint, c] = effects[place.column]
        elif place.column == 0:
            stretched[place.row, c] = (motors - links)[place.row]
    moved = turning @ (soft[:, np.newaxis] * own + compliance[:, np.newaxis] * stretched) + direct
    load = np.linalg.solve(np.eye(n) - turning * (soft - compliance), moved)
    dq = np.zeros((start.size, count))
    of_motor = soft[:, np.newaxis] * (load + own)
    dq[:n] = of_motor - compliance[:, np.newaxis] * (load - stretched)
    dq[rotors] = of_motor
    return dq, load + own
