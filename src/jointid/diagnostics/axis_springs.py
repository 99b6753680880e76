"""Bounds on a robot's stiffnesses behind which the links may swing.

A joint with a spring is taken as a joint alone, under its own controller and along its own reference, with the inertia
that it feels in the mean pose. There a part of its link swings on a spring of its own, at a few multiples of the mode.
What that changes is compared with the residual of the joint's torque, beside the columns of the robot's parameters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.check_loop import bound_second_mode
from jointid.diagnostics.faults.springs import SECOND_MODE
from jointid.diagnostics.faults.trials import vary_mechanics
from jointid.diagnostics.search_state import SearchState, TestResults
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.robots.equations import ROOM, equations_of_motion
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_numbers import MassNumbers, RobotNumbers
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.position_dependent_error import cells


def bound_second_modes(
    part: SimulatedRobot, setup: RobotLoop, records: Sequence[Record], filtering: Filtering, torques: AxisTorques,
    known: Mapping[str, tuple[float, str]],
) -> list[Message | None]:  # fmt: skip
    """Return of each joint how much stiffer its spring is behind a link that swings; None where that is little.

    Args:
        part: the robot, with its numbers.
        setup: the robot under its controllers.
        records: of each joint.
        filtering: of the torques.
        torques: of the record.
        known: deviations and symbols of the parameters, by name.
    """
    numbers, found = part.numbers(), list[Message | None]()
    for k, (name, record) in enumerate(zip(setup.robot.names, records, strict=True)):
        found.append(None)
        std, symbol = known.get(f"{name}.stiffness", (None, ""))
        if std is None or not numbers.flexible[k]:
            continue
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # a loop that is unstable without the others
            loop = ClosedLoop(FlexibleJoint(setup.robot.links[k].kind), setup.controllers[k])
            problem = torque_problem(record, loop, filtering, loop.joint.parameters)
            x = problem.vector(_values_alone(problem, setup, numbers, k, torques))
            own = torques.own[k][:, np.any(torques.own[k], axis=0)]
            shapes = tuple(vary_mechanics(problem, x, [SECOND_MODE]))
            where = partial(cells, torques.position[k], torques.velocity[k])
            results = TestResults(torques.error[k], own, shapes, (), where, list)
            found[k] = bound_second_mode(SearchState(problem, x), results, {"stiffness": std}, symbol)
    return found


def _values_alone(
    problem: ClosedLoopProblem, setup: RobotLoop, numbers: RobotNumbers, axis: int, torques: AxisTorques
) -> dict[str, float]:
    """Return the parameters of a joint alone, with the inertia that it feels in the mean pose."""
    n = len(setup.robot)
    M, still = np.empty((n, n)), np.zeros(n)
    pose = np.mean(torques.position, axis=1)
    equations_of_motion(setup.robot.tree, numbers.inertials, pose, still, still, np.empty((n, ROOM)), M, np.empty(n))
    link, motor = numbers.masses[axis], numbers.masses[numbers.rotors[axis]]
    return {
        "motor_inertia": motor[MassNumbers.INERTIA], "motor_viscous": motor[MassNumbers.VISCOUS],
        "motor_coulomb": motor[MassNumbers.COULOMB], "stiffness": numbers.springs[axis, 0],
        "damping": numbers.springs[axis, 1], "load_inertia": float(M[axis, axis]) + link[MassNumbers.INERTIA],
        "load_viscous": link[MassNumbers.VISCOUS], "load_coulomb": link[MassNumbers.COULOMB],
        "initial_position": float(problem.experiment.inputs[0, REFERENCE]),
    }  # fmt: skip
