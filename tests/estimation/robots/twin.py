"""An arm of six joints, its motion and its records, exact but for noise."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.parameters import Parameter
from jointid.diagnostics.identify import identify
from jointid.estimation.methods import Method
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Link, Robot, RobotJoint, RobotLoop
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from tests.models.robots.trees import inverse_dynamics

Array = NDArray[np.float64]
SAMPLE_TIME = 2e-3
ROTORS = (2.0, 2.0, 1.0, 0.3, 0.3, 0.3)
VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.5, 1.2)
COULOMB = (7.0, 8.0, 5.0, 2.0, 2.0, 1.5)
OFFSETS = (0.5, -1.0, 0.3, 0.1, -0.2, 0.05)


def arm(count: int = 6) -> Robot:
    """Return six joints with the lengths and masses of a light arm of 20 kg, or the first of them, which take less."""
    half = np.pi / 2
    rows = [(0, 0, 0.09), (half, 0, 0.13), (0, 0.425, -0.12), (0, 0.39, 0.1), (half, 0, 0.095), (-half, 0, 0.08)]
    bodies = (  # mass, centre and size of each link
        (3.7, (0.0, -0.03, -0.01), (0.12, 0.12, 0.2)), (8.4, (0.2, 0.01, 0.03), (0.5, 0.12, 0.12)),
        (2.3, (0.18, 0.0, -0.02), (0.45, 0.1, 0.1)), (1.2, (0.0, 0.01, 0.02), (0.1, 0.1, 0.15)),
        (1.2, (0.0, -0.01, 0.02), (0.1, 0.1, 0.15)), (0.6, (0.01, 0.0, -0.02), (0.08, 0.1, 0.06)),
    )  # fmt: skip
    links = []
    for k, ((alpha, d, r), (mass, centre, size)) in enumerate(zip(rows, bodies, strict=True)):
        turn = np.array([[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]])
        square = np.array(size) ** 2
        inertial = MassProperties(mass, np.array(centre), np.diag(mass / 12 * (square.sum() - square))).inertial
        origin = np.array([d, 0.0, 0.0]) + turn @ np.array([0.0, 0.0, r])
        links.append(Link(f"link{k + 1}", k - 1, rotation=turn, origin=origin, inertial=inertial))
    joints = tuple(
        RobotJoint(f"joint{k + 1}", *numbers)
        for k, numbers in enumerate(zip(ROTORS, VISCOUS, COULOMB, OFFSETS, strict=True))
    )
    return Robot(tuple(links[:count]), joints[:count], name="arm")


def motion(seed: int, joints: int = 6, seconds: float = 10.0) -> tuple[Array, Array, Array]:
    """Return a sum of eight harmonics of 0.1 Hz for each joint: positions, velocities, accelerations."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds / SAMPLE_TIME) + 1)[:, np.newaxis] * SAMPLE_TIME
    q, v, a = (np.zeros((t.size, joints)) for _ in range(3))
    for k in range(1, 9):
        w = 2 * np.pi * 0.1 * k
        size, phase = random.uniform(0.2, 1.0, joints) / k, random.uniform(0, 2 * np.pi, joints)
        q += size * np.sin(w * t + phase)
        v += w * size * np.cos(w * t + phase)
        a -= w * w * size * np.sin(w * t + phase)
    return q, v, a


def torque_of(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Return the torques of motors of rigid joints with symmetric friction along a motion of the joints, (rows, n)."""
    coupling = robot.coupling
    velocity, acceleration = v @ coupling.T, a @ coupling.T
    links = inverse_dynamics(robot.tree, robot.inertials, q, v, a) @ np.linalg.inv(coupling)
    numbers = (robot.of_joints(name) for name in ("rotor_inertia", "viscous", "coulomb", "offset"))
    rotor, viscous, coulomb, offset = numbers
    return np.asarray(links + rotor * acceleration + viscous * velocity + coulomb * np.sign(velocity) + offset)


def records_of(robot: Robot, seed: int, noise: float = 0.0, share: float = 0.0) -> tuple[Record, ...]:
    """Return the record of each joint.

    The noise is white, of so many N m at the base and a tenth at the last joint, or a share of each torque.
    """
    q, v, a = motion(seed, len(robot))
    torque = torque_of(robot, q, v, a)
    sizes = noise * np.geomspace(1.0, 0.1, len(robot)) + share * torque.std(axis=0)
    torque += sizes * np.random.default_rng(seed + 500).normal(size=torque.shape)
    return logged(robot, q, torque, SAMPLE_TIME)


def logged(robot: Robot, q: Array, torque: Array, sample_time: float) -> tuple[Record, ...]:
    """Return the records of motors' torques and positions, (rows, n), for a motion of the joints."""
    columns = enumerate(zip(torque.T, robot.coupling @ q.T, strict=True))
    return tuple(
        Record(
            torque=Channel(tau, robot.torque_unit(k), sample_time),
            motor_position=Channel(position, robot.position_unit(k), sample_time),
        )
        for k, (tau, position) in columns
    )


def with_payload(robot: Robot, payload: Array) -> Robot:
    """Return a robot with a body, (10,) in the last link's frame, on its last link."""
    last = robot.links[-1]
    return replace(robot, links=(*robot.links[:-1], replace(last, inertial=last.inertial + payload)))


def identified(
    model: Robot | RobotLoop,
    records: Sequence[Record],
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
) -> Estimate:
    """Identify a robot without the checks."""
    return identify(records, model, method, filtering=filtering, parameters=parameters, checks=False)


def by_idim(
    model: Robot | RobotLoop,
    records: Sequence[Record],
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
) -> Any:
    """Return an estimate by IDIM, its names, values and covariance, and the parameters of any robot in their order."""
    estimate = identified(model, records, method or IDIM(), filtering=filtering)
    part = estimate.require_robot()
    covariance = estimate.covariance_of(part.names)
    return SimpleNamespace(
        estimate=estimate, names=part.names, values=part.values, covariance=covariance,
        parameters_of=part.parameters_of,
    )  # fmt: skip


def hide_spring(estimate: Estimate, joint: str) -> Estimate:
    """Return an estimate whose record does not show the spring of a joint."""
    name = f"{joint}.stiffness"
    refused = replace(estimate.rows[0], name=name, axis=joint, value=None, stderr=None, lower_bound=10.0)
    return replace(estimate, rows=(*(row for row in estimate.rows if row.name != name), refused))


def axis_errors(estimate: Estimate) -> np.ndarray:
    """Return the errors of the joints, in order."""
    return np.array([*estimate.fit.axis_errors.values()])
