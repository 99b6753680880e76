"""Compile the kernels beforehand.

``python -m jointid.simulation.warm_up`` compiles all of them, as the last step of an installation or of an image.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from operator import call

import numpy as np

from jointid.common.parameters import POSITION_UNIT
from jointid.models.controllers import PD, Cascade
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.robots.robot import RobotLoop
from jointid.models.springs import Spring
from jointid.records.record import Channel, Record
from jointid.simulation.derivatives import differentiate
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, names_of
from jointid.simulation.simulate import run_loop

RIGID = RigidJoint("revolute")
_AT_REST = {unit: Record(reference=Channel(np.zeros(10), unit, 1e-3)) for unit in POSITION_UNIT.values()}


def warm_up(joint: Joint = RIGID, *, derivatives: bool = True) -> None:
    """Compile a joint's simulation (by default linear laws), or load the cache.

    Args:
        joint: whose kernels to compile. Lines and smooth laws, and each number of masses of the latter, have their own.
        derivatives: also those of the derivatives.
    """
    loop = ClosedLoop(joint, Cascade(position_gain=1.0, velocity_gain=1.0))
    # Under a force it would leave the range of its reference, and there would be no derivatives.
    forces = ("offset", "gravity", "counterbalance", "harmonic", "load_harmonic")
    values = {name: 0.5 * (not name.startswith(forces)) for name in names_of(joint)}
    run = run_loop(prepare(loop, _AT_REST[POSITION_UNIT[joint.kind]]), Numbers.of_joint(joint, values), keep=True)
    if derivatives:
        differentiate(run, run.numbers.not_zero())


def compile_robot() -> None:
    """Compile the simulation of a robot, its derivatives and its regressor."""
    from jointid.models.robots.base_parameters import inverse_columns
    from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint

    body = np.array([1.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.1])
    joints = RobotJoint("one", 0.1), RobotJoint("two", 0.1, spring=JointSpring(1e3, 1.0))
    robot = Robot(tuple(Link(f"link{i}", i - 1, inertial=body) for i in range(2)), joints)
    loop = RobotLoop(robot, (PD(position_gain=100.0, derivative_gain=2.0),) * 2)
    run = run_loop(prepare(loop, (_AT_REST["rad"],) * 2), Numbers.of(robot), keep=True)
    differentiate(run, run.numbers.not_zero())
    inverse_columns(robot, *np.zeros((3, 2, 2)))


def main() -> None:
    """Compile all kernels, in two processes."""
    winds, springs = Friction("presliding"), (Spring(), Spring("elastic-load"))
    flexible = (FlexibleJoint("revolute", friction=winds, spring=spring) for spring in springs)
    joints: tuple[Joint, ...] = (RIGID, RigidJoint("revolute", friction=winds), *flexible)
    with ProcessPoolExecutor(2) as pool:
        tuple(pool.map(call, (compile_robot, *(partial(warm_up, joint) for joint in joints))))


if __name__ == "__main__":
    main()
