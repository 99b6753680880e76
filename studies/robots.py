"""Random robots identified by DIDIM from no start: whether the search ends at the noise.

Each seed makes a serial robot of 2 to 7 joints, a quarter of them prismatic, with bodies, rotors, friction,
controllers, motion and noise at random; of flexible robots some joints, at least one, have a spring and the motion a
multisine. What DIDIM is given is the geometry and the controllers: masses, rotors, friction and springs are wiped out.

The search is at the noise if no joint's filtered error is more than 5 % above that of the noise alone. What 2 sigma
hold is counted over all parameters but those at a bound and of joints whose spring is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.estimation.parameters import mass_matrix_at
from jointid.estimation.problems.simulated import pose_robot
from jointid.estimation.robots.didim import RobotFit, search_robot
from jointid.models.controllers import PD, PID, Cascade
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint, RobotLoop
from jointid.records.record import Channel, Record
from jointid.simulation.plant import OF_RECORD, Numbers
from jointid.simulation.simulate import Outcome, Simulation
from jointid.simulation.synthesis import simulate

_AT_NOISE = 1.05  # times the noise: what a joint's filtered error may be
_LOST = 0.5  # of a joint's travel: a tracking error that no drive is run with
_POSES = 40


@dataclass(frozen=True, slots=True)
class Drives:
    """A robot under its controllers, and what its drives logged: of each joint a record, and the noise in it."""

    loop: RobotLoop
    records: tuple[Record, ...]
    noise: FloatArray

    @property
    def unknown(self) -> RobotLoop:
        """The loop, of which no number but the geometry is known."""
        joints = tuple(
            RobotJoint(joint.name, rotor_inertia=1.0, spring=JointSpring(1.0) if joint.spring else None)
            for joint in self.loop.robot.joints
        )
        robot = self.loop.robot
        return RobotLoop(
            replace(robot.with_inertials(np.zeros((len(robot), 10))), joints=joints), self.loop.controllers
        )


def drives(seed: int, flexible: bool) -> Drives | None:
    """Return the drives of a seed; None where their loops are not stable, as no robot is run."""
    random = np.random.default_rng([seed, int(flexible)])
    robot = _rigid(random, int(random.integers(2, 8)))
    n, period = len(robot), float(random.choice([1e-3, 2e-3]))
    t: FloatArray = np.arange(round(random.uniform(6.0, 12.0) / period), dtype=np.float64) * period
    revolute = np.array([link.kind == "revolute" for link in robot.links])
    travel = np.where(revolute, random.uniform(0.5, 1.6, n), random.uniform(0.15, 0.5, n))
    home = np.where(revolute, random.uniform(-1.5, 1.5, n), random.uniform(-0.2, 0.2, n))
    q = home + _motion(t, random, travel)
    links = [mass_matrix_at(robot.tree, robot.inertials, pose) for pose in q[:: t.size // _POSES]]
    masses = np.array(links) + np.diag(robot.of_joints("rotor_inertia"))
    about = np.mean(np.diagonal(masses, axis1=1, axis2=2), axis=0)
    # What a motor feels where the other joints give way is less than where they hold: gains are for what lies between.
    felt = np.sqrt(about / np.max(np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2), axis=0))
    hertz = random.uniform(3.0, 8.0, n)
    if flexible:
        modes = np.where(random.random(n) < 0.6, random.uniform(8.0, 30.0, n), np.nan)
        if np.all(np.isnan(modes)):
            modes[random.integers(n)] = random.uniform(8.0, 30.0)
        robot = _with_springs(robot, about, modes, random)
        hertz = np.where(np.isnan(modes), hertz, np.minimum(hertz, 0.35 * modes))
        sizes = random.uniform(0.7, 2.0, n) * np.where(revolute, 0.004, 0.0015)
        q += _multisine(t, random, sizes)
    laws = tuple(_law(random, inertia, 2 * math.pi * f) for inertia, f in zip(felt, hertz, strict=True))
    units = ["rad" if turns else "m" for turns in revolute]
    asked = [Record(reference=Channel(column, unit, period)) for column, unit in zip(q.T, units, strict=True)]
    loop = RobotLoop(robot, laws)
    run = simulate(loop, asked)
    if run.outcome is not Outcome.FINISHED or not _holds(run, q, travel):
        return None
    noise = random.standard_normal(run.torque.shape)
    if random.random() < 0.5:  # coloured
        pole = math.exp(-2 * math.pi * random.uniform(2.0, 30.0) * period)
        noise = lfilter([1.0], [1.0, -pole], noise, axis=0)
    level = float(10 ** random.uniform(-2.3, -1.3))
    noise *= level * np.std(run.torque, axis=0) / np.std(noise, axis=0)
    logged = replace(run, torque=run.torque + noise).records(asked)
    return Drives(loop, logged, noise)


def _rigid(random: np.random.Generator, n: int) -> Robot:
    """Return a serial robot whose links grow lighter outwards, as no two joints of it are alike."""
    links, joints = [], []
    for i in range(n):
        size, length = random.uniform(0.5, 1.0) * 0.75**i, random.uniform(0.1, 0.45)
        masses, points = 10 * size * random.dirichlet(np.ones(8)), random.normal(0.0, 0.35 * length, (8, 3))
        points += random.normal(0.0, 0.3 * length, 3)
        mass = float(masses.sum())
        centre = masses @ points / mass
        apart = points - centre
        inertia = np.einsum("i,ijk->jk", masses, np.sum(apart**2, axis=1)[:, None, None] * np.eye(3)) - np.einsum(
            "i,ij,ik->jk", masses, apart, apart
        )
        turn = Rotation.from_euler("xyz", random.choice([-0.5, 0.0, 0.5], 3) * math.pi + random.normal(0, 0.1, 3))
        direction = random.normal(size=3)
        links.append(
            Link(
                f"link{i + 1}", i - 1, "prismatic" if random.random() < 0.25 else "revolute",
                rotation=turn.as_matrix(), origin=length * direction / np.linalg.norm(direction),
                inertial=MassProperties(mass, centre, inertia).inertial,
            )
        )  # fmt: skip
        joints.append(RobotJoint(f"joint{i + 1}", rotor_inertia=1.0))
    bare = Robot(tuple(links), tuple(joints), name="random")
    poses = random.uniform(-1.5, 1.5, (_POSES, n))
    about = np.mean([np.diag(mass_matrix_at(bare.tree, bare.inertials, pose)) for pose in poses], axis=0)
    made = []
    for i, inertia in enumerate(about):
        rotor = inertia * random.uniform(0.3, 2.0)
        whole = inertia + rotor
        made.append(
            RobotJoint(
                f"joint{i + 1}", rotor, whole * random.uniform(0.5, 4.0), whole * random.uniform(0.5, 5.0),
                whole * random.normal(0.0, 0.5),
            )
        )  # fmt: skip
    return replace(bare, joints=tuple(made))


def _with_springs(robot: Robot, about: FloatArray, modes: FloatArray, random: np.random.Generator) -> Robot:
    """Return the robot with springs that swing rotor against link at these frequencies, Hz, the other joints stiff."""
    joints = []
    for joint, inertia, hertz in zip(robot.joints, about, modes, strict=True):
        if not math.isnan(hertz):
            link = max(inertia - joint.rotor_inertia, 0.05 * inertia)
            both, w = joint.rotor_inertia * link / (joint.rotor_inertia + link), 2 * math.pi * hertz
            beyond, damping = random.uniform(0.2, 0.5), 2 * random.uniform(0.01, 0.06) * both * w
            spring = JointSpring(both * w * w, damping, beyond * joint.viscous, beyond * joint.coulomb)
            own = (1 - beyond) * joint.viscous, (1 - beyond) * joint.coulomb
            joints.append(replace(joint, viscous=own[0], coulomb=own[1], spring=spring))
        else:
            joints.append(joint)
    return replace(robot, joints=tuple(joints))


def _law(random: np.random.Generator, inertia: float, w: float) -> PD | PID | Cascade:
    """Return a law of this bandwidth, rad/s, about an inertia."""
    damping, kind = random.uniform(0.7, 1.1), random.integers(3)
    if kind == 0:
        return PD(position_gain=inertia * w * w, derivative_gain=2 * damping * inertia * w)
    if kind == 1:
        integral = inertia * w**3 * random.uniform(0.02, 0.1)
        return PID(position_gain=inertia * w * w, derivative_gain=2 * damping * inertia * w, integral_gain=integral)
    velocity = 2 * damping * inertia * w
    return Cascade(position_gain=w / (2 * damping), velocity_gain=velocity, integral_gain=0.1 * w)


def _motion(t: FloatArray, random: np.random.Generator, travel: FloatArray) -> FloatArray:
    """Return eight harmonics for each joint, (samples, n), at rest at the first sample."""
    w = 2 * math.pi * random.uniform(0.08, 0.14) * np.arange(1, 9)
    waves = np.sin(t[:, None, None] * w + random.uniform(0, 2 * math.pi, (travel.size, 8))) / w
    q = np.sum(waves * random.uniform(0.2, 1.0, waves.shape[1:]), axis=2)
    q -= q[0]
    x = np.clip(t / 0.6, 0, 1)
    return np.asarray(q * travel / np.max(np.abs(q), axis=0) * (x**3 * (10 - 15 * x + 6 * x * x))[:, None])


def _multisine(t: FloatArray, random: np.random.Generator, sizes: FloatArray) -> FloatArray:
    """Return 24 sines between 3 and 35 Hz for each joint, (samples, n), of these sizes."""
    out = np.zeros((t.size, sizes.size))
    for j, size in enumerate(sizes):
        f = 3.0 + np.arange(24) * 1.35 + 0.05 * j
        wave = np.sin(2 * math.pi * np.outer(t, f) + random.uniform(0, 2 * math.pi, f.size)) @ (f[0] / f)
        out[:, j] = size * wave / np.std(wave) * np.clip(t / 0.6, 0, 1) ** 2
    return out


def _holds(run: Simulation, q: FloatArray, travel: FloatArray) -> bool:
    """True of loops that follow, and do not ring up."""
    error = np.abs(run.motor_position[: len(q)] - q[: len(run.motor_position)])
    first, second = (np.max(part, axis=0) for part in np.array_split(error, 2))
    return bool(np.all(error.max(axis=0) < _LOST * travel) and np.all(second < 3 * first))


@dataclass(frozen=True)
class Found:
    """What was found of a robot.

    Attributes:
        settled: whether the search had. left: the largest error of a joint, times the noise.
        z: errors in deviations, of parameters not at 0.
    """

    settled: bool = False
    left: float = math.inf
    z: tuple[float, ...] = ()

    @property
    def at_noise(self) -> bool:
        """True if the search ended at the noise."""
        return self.settled and self.left <= _AT_NOISE


def judge(seed: int, flexible: bool) -> Found | None:
    """Identify the robot of a seed from torques and references."""
    made = drives(seed, flexible)
    if made is None:
        return None
    refused = tuple[str, ...]()
    try:
        fit = search_robot(made.unknown, made.records)
        refused = tuple(f"{name}." for name, least in fit.springs.items() if least is not None)
    except JointidError:
        return Found()
    truth = fit.parameters.group(Numbers.of(made.loop.robot))
    free = np.array([one.lower < value for one, value in zip(fit.parameters.parameters, fit.values, strict=True)])
    free &= ~np.array([name.startswith(refused) for name in fit.parameters.names])
    free &= ~np.array([place.name in OF_RECORD for place in fit.parameters.places])
    std = np.maximum(fit.covariance.std, 1e-300)
    return Found(fit.converged, _left(made, fit), tuple(((fit.values - truth) / std)[free].tolist()))


def _left(made: Drives, fit: RobotFit) -> float:
    """Return the largest filtered error of a joint, times that of the noise alone."""
    problem = pose_robot(made.loop, made.records, fit.parameters)
    noise = [problem.log.decimate_joint(j, one) for j, one in enumerate(made.noise[: len(problem.measured)].T)]
    left = problem.left_by(fit.problem.numbers(fit.x)) * problem.sizes
    return float(np.max(left / np.linalg.norm(noise, axis=1)))
