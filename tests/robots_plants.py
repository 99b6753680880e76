"""Twins of robots of 2, 6 and 7 joints: links, rotors, friction, springs, controllers and motions.

The 6 joints have the lengths and masses of the public description of a UR5, the 7 those of a common arm of that many
joints, rounded. Rotors, friction and springs are made up (seen behind the gear).
"""

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.robots.didim import RobotFit
from jointid.models.controllers import PD
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint, RobotLoop
from jointid.records.record import Channel, Record
from jointid.simulation.plant import Numbers, Place

GRAVITY = np.array([0.0, 0.0, -9.81])
Z = (0.0, 0.0, 1.0)


def turned(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return a rotation about fixed x, then y, then z."""
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def inertial(mass: float, centre: tuple[float, float, float], about: tuple[float, float, float]) -> FloatArray:
    """Return the ten numbers of a body from its mass, its centre and its principal inertias there."""
    c = np.array(centre)
    inertia = np.diag(about) + mass * ((c @ c) * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), *inertia[np.triu_indices(3)]])


@dataclass(frozen=True)
class Twin:
    """A robot, how it is driven, and what its joints have."""

    robot: Robot
    home: FloatArray
    travel: FloatArray
    inertia: FloatArray  # about each joint, rotor included: the gains are made of it
    bandwidth: FloatArray  # Hz

    def loop(self, slower: float = 1.0) -> RobotLoop:
        """Return the robot under PD controllers of damping 0.9, `slower` times slower than usual."""
        w = 2 * np.pi * self.bandwidth / slower
        gains = zip(self.inertia * w**2, 1.8 * self.inertia * w, strict=True)
        return RobotLoop(self.robot, tuple(PD(position_gain=kp, derivative_gain=kd) for kp, kd in gains))

    def records(
        self, duration: float = 10.0, seed: int = 1, sample_time: float = 1e-3, multisine: float = 0.0
    ) -> tuple[Record, ...]:
        """Return records of references: eight harmonics of 0.1 Hz, begun at rest, and a multisine of 3 to 35 Hz."""
        t: FloatArray = np.arange(round(duration / sample_time), dtype=np.float64) * sample_time
        q = self.home + motion(t, seed, self.travel)
        if multisine:
            rng = np.random.default_rng(seed + 1000)
            for j in range(self.home.size):
                f = 3.0 + np.arange(24) * 1.35 + 0.05 * j
                phase = rng.uniform(0, 2 * np.pi, f.size)
                wave = np.sin(2 * np.pi * np.outer(t, f) + phase) @ (f[0] / f)
                q[:, j] += multisine * wave / np.std(wave) * np.clip(t / 0.6, 0, 1) ** 2
        return tuple(Record(reference=Channel(column, "rad", sample_time)) for column in q.T)


def motion(t: FloatArray, seed: int, travel: FloatArray) -> FloatArray:
    """Return a motion of as many joints as there are travels, (samples, n), 0 and at rest at the first sample."""
    rng, w = np.random.default_rng(seed), 2 * np.pi * 0.1 * np.arange(1, 9)
    q = np.zeros((t.size, travel.size))
    for j, size in enumerate(travel):
        a, b = rng.uniform(-1, 1, (2, w.size))
        wave = np.sin(np.outer(t, w)) @ (a / w) - (np.cos(np.outer(t, w)) - 1) @ (b / w)
        q[:, j] = wave * size / np.max(np.abs(wave))
    x = np.clip(t / 0.6, 0, 1)
    return q * (x**3 * (10 - 15 * x + 6 * x * x))[:, np.newaxis]


def serial(
    axes: list[tuple[float, float, float]],
    origins: list[tuple[float, float, float]],
    rotations: list[FloatArray],
    inertials: list[FloatArray],
    joints: list[RobotJoint],
) -> Robot:
    """Return a chain of revolute joints."""
    links = tuple(
        Link(f"link{i + 1}", i - 1, "revolute", np.array(axis), rotations[i], np.array(origins[i]), inertials[i])
        for i, axis in enumerate(axes)
    )
    return Robot(links, tuple(joints), GRAVITY)


def joints(
    rotors: list[float], viscous: list[float], coulomb: list[float], hertz: list[float | None], held: list[float]
) -> list[RobotJoint]:
    """Return joints; those with a frequency have a spring that swings its rotor so against the held link.

    60 % of the viscous friction and 70 % of the Coulomb friction are then the motor's, the rest the link's; the springs
    are damped by 3 %. A rigid joint has no frequency.
    """
    made = []
    for i, frequency in enumerate(hertz):
        spring = None
        if frequency is not None:
            w = 2 * math.pi * frequency
            spring = JointSpring(held[i] * w * w, 0.06 * held[i] * w, 0.4 * viscous[i], 0.3 * coulomb[i])
        shares = (1.0, 1.0) if spring is None else (0.6, 0.7)
        own = shares[0] * viscous[i], shares[1] * coulomb[i]
        made.append(RobotJoint(f"joint{i + 1}", rotors[i], *own, spring=spring))
    return made


def two(hertz: tuple[float | None, float | None] = (None, None)) -> Twin:
    """Return two joints that turn about horizontal axes, one on the other."""
    bodies = [inertial(4.0, (0.0, 0.0, 0.2), (0.06, 0.06, 0.01)), inertial(2.0, (0.03, 0.0, 0.15), (0.02, 0.02, 0.004))]
    made = joints([0.8, 0.3], [3.0, 1.2], [4.0, 1.5], list(hertz), [0.8, 0.3])
    axes, still = [(0.0, 1.0, 0.0), (0.0, 1.0, 0.0)], [np.eye(3), np.eye(3)]
    robot = serial(axes, [(0.0, 0.0, 0.3), (0.0, 0.0, 0.4)], still, bodies, made)
    return Twin(robot, np.array([0.4, -0.3]), np.array([0.9, 1.2]), np.array([1.7, 0.4]), np.array([6.0, 8.0]))


_UR5_HERTZ = (8.0, 10.0, 14.0, 20.0, 25.0, 30.0)


def six(flexible: bool | tuple[bool, ...] = False) -> Twin:
    """Return the six joints, rigid, flexible, or some of them flexible."""
    which = flexible if isinstance(flexible, tuple) else (flexible,) * 6
    h = math.pi / 2
    axes = [Z, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), Z, (0.0, 1.0, 0.0)]
    origins = [
        (0.0, 0.0, 0.089159), (0.0, 0.13585, 0.0), (0.0, -0.1197, 0.425), (0.0, 0.0, 0.39225), (0.0, 0.093, 0.0),
        (0.0, 0.0, 0.09465),
    ]  # fmt: skip
    rotations = [np.eye(3), turned(0, h, 0), np.eye(3), turned(0, h, 0), np.eye(3), np.eye(3)]
    bodies = [
        inertial(3.7, (0.0, 0.0, 0.0), (0.0103, 0.0103, 0.00666)),
        inertial(8.393, (0.0, 0.0, 0.28), (0.2269, 0.2269, 0.0151)),
        inertial(2.275, (0.0, 0.0, 0.25), (0.0494, 0.0494, 0.0041)),
        inertial(1.219, (0.0, 0.01, 0.0), (0.1112, 0.1112, 0.2194)),
        inertial(1.219, (0.0, 0.0, 0.01), (0.1112, 0.1112, 0.2194)),
        inertial(0.1879, (0.0, 0.05, 0.0), (0.0171, 0.0171, 0.0338)),
    ]
    hertz = [f if on else None for f, on in zip(_UR5_HERTZ, which, strict=True)]
    made = joints(
        [2.0, 2.0, 1.0, 0.3, 0.3, 0.3], [8.0, 8.0, 5.0, 1.5, 1.5, 1.2], [7.0, 8.0, 5.0, 2.0, 2.0, 1.5], hertz,
        [2.0, 2.5, 1.0, 0.3, 0.3, 0.1],
    )  # fmt: skip
    return Twin(
        serial(axes, origins, rotations, bodies, made),
        np.array([0.0, -1.2, 1.2, -0.5, 0.6, 0.0]),
        np.array([1.5, 0.7, 1.0, 1.5, 1.5, 2.0]),
        np.array([5.0, 6.0, 2.5, 0.8, 0.75, 0.33]),
        np.array([6.0, 6.0, 7.0, 10.0, 10.0, 10.0]),
    )


def seven(flexible: bool = False) -> Twin:
    """Return the seven joints, whose axes are turned by a right angle each."""
    h = math.pi / 2
    rotations = [turned(angle, 0, 0) for angle in (0, -h, h, h, -h, h, h)]
    origins = [
        (0.0, 0.0, 0.333), (0.0, 0.0, 0.0), (0.0, -0.316, 0.0), (0.0825, 0.0, 0.0), (-0.0825, 0.384, 0.0),
        (0.0, 0.0, 0.0), (0.088, 0.0, 0.0),
    ]  # fmt: skip
    bodies = [
        inertial(4.97, (0.004, 0.002, -0.15), (0.12, 0.12, 0.009)),
        inertial(3.2, (-0.003, -0.09, 0.02), (0.03, 0.01, 0.03)),
        inertial(3.23, (0.027, 0.04, -0.066), (0.03, 0.03, 0.01)),
        inertial(3.59, (-0.053, 0.104, 0.027), (0.03, 0.02, 0.035)),
        inertial(1.23, (-0.012, 0.041, -0.038), (0.03, 0.025, 0.008)),
        inertial(1.67, (0.06, -0.014, -0.011), (0.004, 0.006, 0.008)),
        inertial(0.74, (0.01, 0.004, 0.062), (0.012, 0.01, 0.005)),
    ]
    hertz: list[float | None] = [9.0, 10.0, 12.0, 14.0, 20.0, 24.0, 30.0] if flexible else [None] * 7
    made = joints(
        [0.8, 0.8, 0.6, 0.6, 0.3, 0.3, 0.3], [6.0, 6.0, 4.0, 4.0, 1.5, 1.5, 1.2], [5.0, 5.0, 4.0, 4.0, 1.5, 1.5, 1.0],
        hertz, [0.8, 0.8, 0.6, 0.6, 0.3, 0.3, 0.1],
    )  # fmt: skip
    return Twin(
        serial([Z] * 7, origins, rotations, bodies, made),
        np.array([0.0, 0.2, 0.0, -1.6, 0.0, 1.7, 0.5]),
        np.array([1.2, 0.8, 1.2, 0.8, 1.2, 1.0, 1.2]),
        np.array([1.9, 2.4, 1.2, 1.2, 0.35, 0.35, 0.31]),
        np.array([6.0, 6.0, 7.0, 7.0, 10.0, 10.0, 10.0]),
    )


def all_places(numbers: Numbers) -> tuple[Place, ...]:
    """Return the places of every number that a robot has: of the joints, then of the links."""
    own = [Place(i, name) for i, of in enumerate(numbers.values) for name in of if name != "load_offset"]
    links = [Place(i, symbol) for i in range(len(numbers.joints)) for symbol in SYMBOLS]
    return (*(place for place in own if place in numbers), *links)


def with_springs(numbers: Numbers, factor: float) -> Numbers:
    """Return a robot with other stiffnesses and dampings."""
    own = [Place(int(i), name) for i in np.flatnonzero(numbers.flexible) for name in ("stiffness", "damping")]
    return numbers.with_values(own, [factor * numbers[place] for place in own])


def stiffness_of(robot: Robot) -> FloatArray:
    """Return the stiffnesses of a robot's springs, (n,); 0 of rigid joints."""
    return np.array([0.0 if joint.spring is None else joint.spring.stiffness for joint in robot.joints])


def assert_springs(found: RobotFit, twin: Twin, within: float, deviations: float = np.inf) -> None:
    """The spring of every flexible joint is shown, within a share of its stiffness and some deviations of it."""
    truth = stiffness_of(twin.robot)
    for (name, least), stiffness in zip(found.springs.items(), truth[truth > 0.0], strict=True):
        value, deviation = found.value(f"{name}.stiffness")
        assert least is None, name
        assert abs(value - stiffness) < min(within * stiffness, deviations * deviation), name
