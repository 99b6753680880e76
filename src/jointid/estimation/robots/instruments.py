"""The instruments of a robot's IDIM-IV: the columns on the motion that its closed loop makes of the references.

The robot is simulated under its controllers with the values found last, and goes through the filters as the measured
motion does; what is in the record's noise is not in these columns [Janot, Vandanjon and Gautier 2014].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.methods.linear import Instruments
from jointid.estimation.robots.regression import RobotMotion, base_rows, motion_of_robot
from jointid.models.robots.base_parameters import BaseParameters
from jointid.models.robots.friction_terms import Friction, friction_terms
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.record import Channel, Record
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import RobotLoop, RobotOutcome, prepare_robot, run_robot, simulation_of

_COLUMNS = {
    Friction.VISCOUS: 1,
    Friction.COULOMB: 2,
    Friction.OFFSET: 3,
    Friction.FORWARDS: 4,
    Friction.BACKWARDS: 5,
    Friction.RISE: 6,
}
"""Of `RobotNumbers.masses`."""


def robot_instruments(
    loop: RobotLoop, records: Sequence[Record], base: BaseParameters, motion: RobotMotion
) -> Instruments:
    """Return a function from the parameters to the columns on the simulated motion.

    Args:
        loop: robot and controllers, at rest or in motion at the first sample; springs are not read.
        records: of each joint, with reference, torque and motor position.
        base: of the robot.
        motion: that was measured; rows at which its motors rest or turn round are left out of both.

    Raises:
        RecordError: a record lacks a channel that its controller reads, or a clock does not divide the controllers'.
        MethodError: controllers or logs share no clock.
    """
    loop.robot.require_lines("IDIM of a robot takes")
    rigid = replace(loop.robot, joints=tuple(replace(joint, spring=None) for joint in loop.robot.joints))
    experiment, size = prepare_robot(replace(loop, robot=rigid), records), len(motion.q)

    def columns(values: FloatArray) -> FloatArray:
        run = run_robot(experiment, _numbers(rigid, base, values), keep=True)
        if run.outcome is not RobotOutcome.FINISHED:
            raise MethodError(
                f"The instruments of IV come from a simulation, but with these values {run.outcome.value}; check the "
                "controllers' gains, or use another estimator."
            )
        made = []
        for record, position in zip(records, simulation_of(run).motor_position.T, strict=True):
            assert record.motor_position is not None
            whole = np.pad(position[:size], (0, max(size - position.size, 0)), "edge")
            unit = record.motor_position.unit
            made.append(replace(record, motor_position=Channel(whole, unit, motion.sample_time)))
        moved = motion_of_robot(rigid, made, motion.filtering)
        return base_rows(rigid, base, replace(moved, moving=motion.moving)).W

    return columns


def _numbers(robot: Robot, base: BaseParameters, values: FloatArray) -> RobotNumbers:
    """Return a robot with base parameters and friction, each base parameter in the first of its sum."""
    n = len(robot)
    standard = np.zeros((len(SYMBOLS) + 1) * n)
    standard[base.chosen] = values[: len(base)]
    links, rotors = standard[:-n].reshape(n, -1), standard[-n:]
    numbers = RobotNumbers.of(robot)
    masses = np.zeros_like(numbers.masses)
    masses[:, 0], masses[:, 7] = rotors, numbers.masses[:, 7]
    for term, value in zip(friction_terms(robot), values[len(base) :], strict=True):
        # Instruments need not be perfect.
        masses[term.joint, _COLUMNS[term.number]] = value if term.number is Friction.OFFSET else max(value, 0.0)
    return replace(numbers, inertials=links, masses=masses)
