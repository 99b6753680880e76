"""Compile the kernels beforehand.

``python -m jointid.simulation.warm_up`` compiles all of them, as the last step of an installation or of an image.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from operator import call

import numpy as np

from jointid.models.controllers import PD, Cascade
from jointid.models.friction import PreslidingFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import simulate_torque
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities


def warm_up(*, derivatives: bool = True) -> None:
    """Compile the simulation of a joint of straight lines, or load it from the cache.

    Kernels of other laws are compiled by the first joint that has one.

    Args:
        derivatives: also those of the derivatives.
    """
    compile_drive()
    if derivatives:
        compile_derivatives()


def compile_drive() -> None:
    """Compile the simulation of a joint of straight lines."""
    loop, values = _loop(RigidJoint("prismatic"))
    simulate_torque(loop, prepare(loop, _at_rest()), values)


def compile_derivatives() -> None:
    """Compile their derivatives by a call without a period."""
    from jointid.simulation.kernels import drive, drive_sensitivities
    from jointid.simulation.plant import pass_on

    lanes, none = drive_sensitivities.LANES, np.zeros(0)
    counts, modes = np.zeros(4, dtype=np.int64), np.zeros(0, dtype=np.int16)
    trace = drive.Trace(none, np.zeros((0, 1)), np.zeros((0, 4)), modes, np.zeros((0, drive.TAPE)), counts)
    start, law = np.zeros((4, lanes)), np.zeros((0, lanes))
    columns = drive_sensitivities.Columns(np.zeros((0, 1, 0)), 0, np.zeros(lanes), np.zeros((1, lanes)), start, law)
    slopes = drive_sensitivities.Slopes(np.zeros((lanes, 0)), np.zeros((0, 4, lanes)))
    loop = pass_on(np.zeros((1, 1, 0)), 1.0)
    drive_sensitivities.follow(loop, 0.0, trace, 0, np.ones(14), np.zeros((14, lanes)), columns, slopes)


def compile_smooth_laws() -> None:
    """Compile the simulation and the derivatives of other laws."""
    loop, values = _loop(FlexibleJoint("prismatic", friction=PreslidingFriction()))
    values["offset"] = 0.0  # else it would leave the range of its reference, and there would be no derivatives
    simulate_sensitivities(loop, prepare(loop, _at_rest(sample_time=1e-3)), values, ["motor_inertia"])


def compile_robot() -> None:
    """Compile the simulation of a robot, its derivatives and its regressor."""
    from jointid.models.robots.base_parameters import base_parameters
    from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint
    from jointid.simulation.robot_numbers import RobotNumbers, all_places
    from jointid.simulation.robot_sensitivities import differentiate_torques
    from jointid.simulation.robots import RobotLoop, prepare_robot, run_robot

    body = np.array([1.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.1])
    links = tuple(Link(f"link{i}", i - 1, inertial=body) for i in range(2))
    joints = (RobotJoint("one", 0.1), RobotJoint("two", 0.1, spring=JointSpring(1e3, 1.0)))
    robot = Robot(links, joints)
    loop = RobotLoop(robot, (PD(position_gain=100.0, derivative_gain=2.0),) * 2)
    run = run_robot(prepare_robot(loop, (_at_rest("rad", 1e-3),) * 2), RobotNumbers.of(robot), keep=True)
    differentiate_torques(run, all_places(run.numbers))
    base_parameters(replace(robot, joints=(joints[0], RobotJoint("two", 0.1))))


def _loop(joint: Joint) -> tuple[ClosedLoop, dict[str, float]]:
    values = dict.fromkeys((parameter.name for parameter in joint.parameters), 1.0)
    return ClosedLoop(joint, Cascade(position_gain=1.0, velocity_gain=1.0)), values


def _at_rest(unit: str = "m", sample_time: float = 1.0) -> Record:
    return Record(reference=Channel(np.zeros(10), unit, sample_time))


def main() -> None:
    """Compile all kernels, in two processes."""
    with ProcessPoolExecutor(2) as pool:
        tuple(pool.map(call, (compile_robot, compile_drive, compile_derivatives, compile_smooth_laws)))


if __name__ == "__main__":
    main()
