"""Joints and robots of two joints whose friction grows with the torque, and their records, empty and loaded."""

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import PD
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.position_forces import Gravity
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Link, Robot, RobotJoint, RobotLoop
from jointid.records.record import Channel, Record
from jointid.simulation.synthesis import simulate, simulated_record

LOADED = FRICTIONS["load-dependent"]
LAWS = PD(position_gain=900.0, derivative_gain=60.0), PD(position_gain=400.0, derivative_gain=20.0)
_NOISE = 0.3  # N m
_SIZES = {"viscous": (2.0, 0.8), "coulomb": (3.0, 1.2), "offset": (0.1, -0.05), "rotor_inertia": (0.4, 0.15)}


def _motion(rng: np.random.Generator, duration: float) -> FloatArray:
    """Return a reference over a radian either way, from rest: five waves from 0.15 Hz on."""
    t = np.arange(round(1e3 * duration)) * 1e-3
    waves = [rng.uniform(-1, 1) / k * np.sin(2 * np.pi * 0.15 * k * t) for k in range(1, 6)]
    motion = np.sum(waves, axis=0) * np.clip(2 * t, 0.0, 1.0) ** 2
    return np.asarray(motion / np.max(np.abs(motion)))


def _with_noise(record: Record, rng: np.random.Generator) -> Record:
    assert record.torque is not None
    values = record.torque.values
    return replace(record, torque=replace(record.torque, values=values + _NOISE * rng.standard_normal(values.size)))


def hanging_joint(seed: int) -> tuple[ClosedLoop, Record, dict[str, float]]:
    """Return a joint that lifts a link, its record of 8 s, and its numbers."""
    rng = np.random.default_rng(seed)
    joint = RigidJoint("revolute", LOADED, gravity=Gravity("link"))
    truth = {"inertia": 0.9, "viscous": 2.0, "coulomb": 3.0, "friction_per_torque": rng.uniform(0.04, 0.15)}
    truth |= {"offset": 0.2, "gravity_cos": 10.0, "gravity_sin": 0.5}
    loop = ClosedLoop(joint, LAWS[0])
    record = simulated_record(loop, _motion(rng, 8.0), truth, sample_time=1e-3)
    return loop, _with_noise(record, rng), truth


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """An arm of two joints that lift.

    Attributes:
        robot: with its numbers. logs: records of its joints, empty, then with a payload.
    """

    robot: Robot
    logs: tuple[tuple[Record, ...], tuple[Record, ...]]

    @property
    def loop(self) -> RobotLoop:
        """The arm under its controllers."""
        return RobotLoop(self.robot, LAWS)

    @property
    def plain(self) -> RobotLoop:
        """The same with symmetric friction."""
        joints = (replace(joint, friction=None, numbers={}) for joint in self.robot.joints)
        return RobotLoop(replace(self.robot, joints=tuple(joints)), LAWS)


def lifting_arm(seed: int, duration: float = 5.0) -> Arm:
    """Return an arm with its records, of which the second has a payload of 3 kg."""
    rng = np.random.default_rng(seed)
    bodies = [
        MassProperties(mass, np.array([x, 0.0, 0.0]), np.diag([0.2, 1.0, 1.0]) * inertia).inertial
        for mass, x, inertia in ((4.0, 0.2, 0.06), (2.0, 0.15, 0.02), (3.0, 0.35, 0.002))
    ]
    links = (
        Link("upper", -1, axis=np.array([0.0, 1.0, 0.0]), inertial=bodies[0]),
        Link("lower", 0, axis=np.array([0.0, 1.0, 0.0]), origin=np.array([0.4, 0.0, 0.0]), inertial=bodies[1]),
    )
    shares = [{"friction_per_torque": float(rng.uniform(0.04, 0.15))} for _ in links]
    joints = tuple(
        RobotJoint(link.name, **{name: both[k] for name, both in _SIZES.items()}, friction=LOADED, numbers=shares[k])  # type: ignore[arg-type]
        for k, link in enumerate(links)
    )
    robot, logs = Robot(links, joints), []
    for payload in ((), tuple(map(float, bodies[2]))):
        driven = [Record(reference=Channel(_motion(rng, duration), "rad", 1e-3), payload=payload) for _ in links]
        made = simulate(RobotLoop(robot, LAWS), driven).records(driven)
        logs.append(tuple(_with_noise(one, rng) for one in made))
    return Arm(robot, (logs[0], logs[1]))
