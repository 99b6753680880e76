"""Robot model for test design: parameters, alternatives within tolerance, and noise.

The columns W(q) of base parameters and friction along a motion q predict the accuracy. With white noise of deviation
s_k on the log of joint k's torque the covariance of all parameters is::

    M = sum_k W_k' W_k / s_k^2,      cov = M^-1

The goal of all parameters is D-optimal, the largest log det M [Swevers et al. 1997]; no units and no choice of base
parameters enter it. The motions are Fourier series (`plans`). Of joints with springs a multisine about the mode of
rotor against link is added. Under its controllers the robot is simulated, with derivatives by variation; torques and
the intervals of the springs are those of the simulation.

Obstacles, and the robot's own body, are not known here: play the motion slowly first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.diagnostics.axis_torques import torques_of_robot
from jointid.estimation.parameters import Parameters, mass_matrix_at, robot_parameters
from jointid.estimation.problems.inverse_model import measure_motion
from jointid.estimation.problems.simulated import pose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.bodies import consistent_robot
from jointid.estimation.robots.simulated import nominal_numbers
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.planning.designed import DesignedAxis
from jointid.planning.plans import Plan, Series
from jointid.planning.predict import ALL, Goal, PredictedTest, find_maxima, find_undetermined
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation import excitation
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, Place, robot_with
from jointid.simulation.simulate import Simulation, require_success, run_loop
from jointid.simulation.synthesis import add_feed_forward
from jointid.uncertainty.covariance import covariance_of

Motion: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Positions, velocities and accelerations of the joints, (instants, n) each."""

FeedForward: TypeAlias = Literal["none", "gravity", "inverse-model"]

_NOISE = 0.01  # of each joint's torque in random motions: the noise that is assumed without a first record
_HARMONICS = (4, 6, 8)
_INSTANTS = 160  # of a period, at which columns are taken in the search
_USUAL = np.array([1.0, 1.0, 4.0])[:, np.newaxis, np.newaxis]  # rad or m, per s and s2: of positions and derivatives
_FOR_MODES = 0.2  # of speed and acceleration, kept for the multisine where there are springs
_ABOUT = (0.6, 1.6)  # of a mode's frequency: the band of the multisine
_LINES = 20
_DRAWN, _SIMULATED = 20, 6  # robots that it may be, by the equations and under the controllers
_OF_MASS = {"inertia": 0, "viscous": 1, "coulomb": 2, "offset": 3, "viscous_forwards": 4, "viscous_backwards": 5}
_OF_MASS |= {"stribeck_force": 6, "coulomb_forwards": 2, "coulomb_backwards": 2}  # both as one
_OF_SPRING = ("stiffness", "damping")
_LEAST = 0.2  # of a number that is drawn: less is no robot that somebody declared


@dataclass(frozen=True, slots=True, eq=False)
class RobotModel:
    """A roughly known robot.

    Attributes:
        robots: robots of the tolerance, the roughly known one first.
        base: its parameters by the equations of rigid joints.
        loop: the roughly known one under its controllers, for a test by DIDIM; None for one by IDIM.
        samples, sample_time: of a test and its log, s.
        filtering: of the identification.
        feed_forward: of its drives.
        present: references of the existing test; empty without one.
        sizes: (n,) standard deviation of white noise on the log of each torque.
        guessed: whether `sizes` are guessed.
        instants: number of instants at which a search evaluates a series; None if it plays whole tests.
    """

    needed = ("lower", "upper", "speed")
    kept = needed
    robots: tuple[Robot, ...]
    base: Parameters
    loop: RobotLoop | None
    samples: int
    sample_time: float
    filtering: Filtering | None
    feed_forward: FeedForward
    present: tuple[Record, ...]
    sizes: FloatArray
    guessed: bool
    instants: int | None = None

    @property
    def robot(self) -> Robot:
        """The roughly known robot."""
        return self.robots[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.names

    @property
    def from_shafts(self) -> FloatArray:
        """Positions of the joints from those of the motors, (n, n)."""
        return np.asarray(np.linalg.inv(self.robot.coupling))

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters that a test is identified for, by name."""
        parameters = self.base if self.loop is None else robot_parameters(self.robot)
        return dict(zip(parameters.names, parameters.units(self.robot), strict=True))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Clauses on unknowns: joints without stated friction, missing in the torque."""
        of_whole = [(joint.name, joint.rigid.values.items()) for joint in self.robot.joints]
        without = [name for name, own in of_whole if not any(value for of, value in own if of != "inertia")]
        said = f"the torque is without the friction of {', '.join(without)}, which nothing states"
        return (f"{said}: give viscous and coulomb, or a first record",) if without else ()

    def roughly(self, goal: Goal) -> RobotModel:
        """Approximate the model: rigid equations, or one robot for a single goal."""
        if self.loop is not None and goal.name != ALL:
            return replace(self, robots=self.robots[:1])
        return replace(self, loop=None, instants=_INSTANTS)

    def families(
        self, limits: Sequence[AxisLimits], _goal: Goal, _before: PredictedTest | None
    ) -> tuple[tuple[Series, ...], None]:
        """Series of several numbers of harmonics within limits, and no floor."""
        share = 1.0 - _FOR_MODES if any(self.robot.flexible) else 1.0
        period = self.samples * self.sample_time
        return tuple(Series(tuple(limits), period, harmonics, share) for harmonics in _HARMONICS), None

    @property
    def noise(self) -> str:
        """The noise in words."""
        said = "white, " + ", ".join(number(float(one), 3) for one in self.sizes)
        return f"{said}: a guess, {100 * _NOISE:g} % of each joint's usual torque" if self.guessed else said

    def records(self, plan: Plan) -> tuple[Record, ...]:
        """Records of a test, one per joint, with multisines about the modes."""
        q, *_ = plan.play(np.asarray(np.arange(self.samples) * self.sample_time))
        if any(self.robot.flexible):
            assert isinstance(plan.family, Series)
            q = q + self._multisines(find_modes(self.robot, q), plan.family.limits)
        return references(self.robot, q, self.sample_time)

    def describe(self, test: Sequence[Record], plan: Plan | None) -> str:
        """Return a test in words."""
        if plan is None:
            return "the references as given"
        motion, added = plan.family.words
        modes = f" with {added}" if any(self.robot.flexible) else ""
        return f"{motion}, {number(test[0].duration, 3)} s long{modes}"

    def predict_plan(self, plan: Plan) -> Iterator[PredictedTest]:
        """Predict a test of each robot, by rigid-body equations or simulation."""
        if self.instants is None:
            yield from self.predict(self.records(plan))
            return
        period = self.samples * self.sample_time
        q, v, a = plan.play(np.linspace(0.0, period, self.instants, endpoint=False))
        yield from self._apply_equations((q, v, a), period / self.instants)

    def predict(self, test: Sequence[Record], _runs: int = 1) -> Iterator[PredictedTest]:
        """Predict a test of each robot, the roughly known one first.

        All drives have the feed-forward of the roughly known robot. White noise needs no runs.
        """
        assert test[0].reference is not None
        motion, step = differentiate_references(self.robot, test), test[0].reference.sample_time
        if self.loop is None:
            yield from self._apply_equations(motion, step)
            return
        driven = test if self.feed_forward == "none" else add_feed_forward(self.loop, test, self.feed_forward)
        for one in self.robots:
            yield self._simulate(replace(self.loop, robot=one), driven, motion, step)

    def axes(
        self, test: Sequence[Record], limits: Sequence[AxisLimits], given: Sequence[AxisLimits],
        reached: Sequence[Mapping[str, float]],
    ) -> tuple[DesignedAxis, ...]:  # fmt: skip
        """Return the loads of each joint in the test."""
        names, robot = enumerate(self.names), self.robot
        units = [(robot.position_unit(k), robot.torque_unit(k)) for k in range(len(robot))]
        return tuple(DesignedAxis(n, test[k], *units[k], None, limits[k], given[k], reached[k]) for k, n in names)

    def columns(self, motion: Motion) -> FloatArray:
        """Columns of a rigid robot's torques at instants, (instants, n, parameters)."""
        return self.base.columns(self.robot, *motion)

    def _apply_equations(self, motion: Motion, step: float) -> Iterator[PredictedTest]:
        """Predict a motion whose instants may each stand for several samples."""
        columns = self.columns(motion)
        weights = math.sqrt(step / self.sample_time) / self.sizes
        J = (columns * weights[:, np.newaxis]).reshape(-1, columns.shape[2])
        units = replace(self, loop=None).units
        for robot in self.robots:
            values = self.base.group(Numbers.of(robot.rigid))
            torque = columns @ values
            reached = find_maxima((motion[0],), (motion[1],), motion[2], torque, step, self.sizes)
            yield _predicted(units, values, J, torque, step, reached)

    def _simulate(self, loop: RobotLoop, driven: Sequence[Record], motion: Motion, step: float) -> PredictedTest:
        """Predict a test by DIDIM from a run under the controllers.

        Filter and decimation pass only a part of white noise's power, so each row has the information of the samples
        that it replaces.
        """
        parameters = robot_parameters(loop.robot)
        kept = run_loop(prepare(loop, driven), Numbers.of(loop.robot), keep=True)
        run = require_success(Simulation.of(kept), "The robot's motion")
        problem = pose_robot(loop, run.records(driven), parameters, self.filtering)
        values = parameters.group(kept.numbers)
        J = problem.log.slopes(kept, problem.parameters.keys)
        assert problem.filtering.decimation is not None
        sizes = self.sizes[:, np.newaxis] / math.sqrt(problem.filtering.decimation)
        assert run.load_position is not None and run.load_velocity is not None
        windup = np.abs(run.motor_position - run.load_position @ loop.robot.coupling.T).max(axis=0)
        q, v, a = motion
        reached = find_maxima(
            (q,), (v, run.motor_velocity, run.load_velocity), a, run.torque, step, self.sizes,
            np.where(loop.robot.flexible, windup, np.nan),
        )  # fmt: skip
        return _predicted(self.units, values, replace(problem, sigma=sizes).weigh(J), run.torque, step, reached)

    def _multisines(self, modes: Mapping[str, float], limits: Sequence[AxisLimits]) -> FloatArray:
        """Multisines about the mode of each flexible joint, within limits, (samples, n)."""
        samples, T = self.samples, self.sample_time
        added = np.zeros((samples, len(limits)))
        for k, limit in enumerate(limits):
            if (mode := modes.get(self.names[k])) is None:
                continue
            high = min(_ABOUT[1] * mode, 0.4 / T)
            low = min(_ABOUT[0] * mode, 0.5 * high)
            wave = excitation.multisine(samples, T, 1.0, low, high, lines=_LINES, tilt=2.0)
            wave = np.roll(wave, k)  # no two joints alike
            wave[:k] = 0.0
            speed = np.gradient(wave, T)
            assert limit.upper is not None and limit.lower is not None
            sizes = ((limit.speed, speed), (limit.acceleration, np.gradient(speed, T)))
            most = [_FOR_MODES * size / float(np.max(np.abs(one))) for size, one in sizes if size is not None]
            added[:, k] = min(*most, 0.01 * (limit.upper - limit.lower)) * wave
        return added


def robot_model(
    model: Estimate | Robot | RobotLoop,
    records: tuple[Record, ...],
    times: tuple[int, float],
    *,
    loop: RobotLoop | None,
    noise: FloatArray | None,
    within: float | None,
    filtering: Filtering | None,
    feed_forward: FeedForward,
    seed: int,
) -> RobotModel:
    """Model a robot for test design; see `jointid.design`."""
    present: tuple[Record, ...] = ()
    if isinstance(model, Estimate):
        part = model.require_robot()
        if model.settings.simulates == "loop" and isinstance(part.setup, RobotLoop):
            loop = loop or part.setup
        robot = _identified_robot(model, loop)
        if records:
            present, left = _read_first(model, records)
            noise = left if noise is None else noise
    elif records:
        raise MethodError("The records of a robot are read with its estimate; give the estimate in place of the robot.")
    else:
        loop, robot = (loop, model) if isinstance(model, Robot) else (model, model.robot)
    if any(robot.flexible) and loop is None:
        raise MethodError(
            "The intervals of springs are predicted under the controllers, and there are none; give every joint its "
            "controller, or leave the springs out."
        )
    if loop is None:
        robot.require_linear("IDIM of a robot takes", "give every joint its controller")
    loop = None if loop is None else replace(loop, robot=robot)
    drawn = () if not within else tuple(_draw_robots(robot, within, _SIMULATED if loop is not None else _DRAWN, seed))
    base, sizes = robot_parameters(robot.rigid, whole=False), np.ones(len(robot)) if noise is None else noise
    found = RobotModel((robot, *drawn), base, loop, *times, filtering, feed_forward, present, sizes, noise is None)
    if noise is None:
        q, v, a = np.random.default_rng(seed).standard_normal((3, _INSTANTS, len(robot))) * _USUAL
        torque = found.columns((q, v, a)) @ base.group(Numbers.of(robot.rigid))
        found = replace(found, sizes=_NOISE * np.sqrt(np.mean(torque**2, axis=0)))
    return found


def differentiate_references(robot: Robot, test: Sequence[Record]) -> Motion:
    """Positions, velocities and accelerations of the joints along motor references."""
    shafts = [one.reference for one in test if one.reference is not None]
    q = np.column_stack([one.values for one in shafts]) @ np.linalg.inv(robot.coupling).T
    v = np.gradient(q, shafts[0].sample_time, axis=0)
    return q, v, np.gradient(v, shafts[0].sample_time, axis=0)


def references(robot: Robot, q: FloatArray, sample_time: float) -> tuple[Record, ...]:
    """References of the motors for a motion of the joints, (samples, n)."""
    shafts = np.ascontiguousarray((q @ robot.coupling.T).T)
    channels = (Channel(one, robot.position_unit(k), sample_time, source="planned") for k, one in enumerate(shafts))
    return tuple(Record(reference=one, name="test") for one in channels)


def find_modes(robot: Robot, q: FloatArray) -> dict[str, float]:
    """Natural frequency (Hz) of each flexible joint's rotor against its link.

    The inertia is the mean along the motion. The other shafts are held, since springs act on shafts.
    """
    poses, tree, bodies = q[:: max(len(q) // 20, 1)] @ robot.coupling.T, robot.tree, robot.inertials
    about = np.mean([np.diag(mass_matrix_at(tree, bodies, one)) for one in poses], axis=0)
    found = {}
    for k, joint in enumerate(robot.joints):
        if joint.spring is not None:
            # Of a link of which nothing is known a twentieth of what swings is the link's.
            link = max(float(about[k]), joint.rotor_inertia / 19.0)
            inertia = joint.rotor_inertia * link / (joint.rotor_inertia + link)
            found[joint.name] = math.sqrt(joint.spring.stiffness / inertia) / (2.0 * math.pi)
    return found


def _predicted(
    units: Mapping[str, str], values: FloatArray, J: FloatArray, torque: FloatArray, step: float,
    reached: tuple[Mapping[str, float], ...],
) -> PredictedTest:  # fmt: skip
    """Predict intervals of least squares on rows of unit noise deviation."""
    norms, names = column_norms(J), tuple(units)
    inverse = np.linalg.pinv(np.linalg.qr(J / norms, mode="r"))
    covariance = covariance_of(inverse @ inverse.T, norms)
    covariance.std[find_undetermined(J)] = np.inf
    symbols, rough = {name: name for name in names}, dict(zip(names, map(float, values), strict=True))
    return PredictedTest(names, symbols, units, rough, covariance, np.ascontiguousarray(torque.T), step, reached)


def _read_first(estimate: Estimate, records: Sequence[Record]) -> tuple[tuple[Record, ...], FloatArray]:
    """Motion of a first record as references, and its white noise, (n,).

    The noise has the power of the estimate's residual in the band of the filter.
    """
    torques, robot = torques_of_robot(estimate, records), estimate.require_robot().model
    left = np.array([np.sqrt(np.mean(e[s] ** 2)) for e, s in zip(torques.error, torques.seen, strict=True)])
    present = tuple(records)
    if estimate.settings.simulates != "loop":
        motion = measure_motion(robot, records, estimate.settings.filtering)
        present = references(robot, motion.q, motion.sample_time)
    assert present[0].reference is not None
    # White noise has in the band the share 2 cutoff / rate of its power.
    return present, left * np.sqrt(0.5 / (present[0].reference.sample_time * torques.cutoff))


def _identified_robot(estimate: Estimate, loop: RobotLoop | None) -> Robot:
    """Physically consistent robot of an estimate; nominal bodies if there is none."""
    part = estimate.require_robot()
    try:
        robot = consistent_robot(estimate).robot
    except MethodError:  # a spring is not shown, or a link has no mass: friction is known nevertheless
        robot = robot_with(part.model, nominal_numbers(part.model, part.numbers()))
    return robot if loop is None or robot.flexible == loop.robot.flexible else loop.robot  # IDIM knows no springs


def _draw_robots(robot: Robot, within: float, count: int, seed: int) -> Iterator[Robot]:
    """Yield robots whose parameters deviate independently, with 2 sigma of `within` percent."""
    rng, numbers = np.random.default_rng([seed, 1]), Numbers.of(robot)

    def factors(*shape: int) -> FloatArray:
        return np.maximum(1.0 + 0.005 * within * rng.standard_normal(shape), _LEAST)

    for k in range(count):
        masses = factors(numbers.count, 1 + max(_OF_MASS.values()))
        # Nothing moves a prediction as a mode does: the first two robots have the softest and the stiffest springs.
        ends = {0: max(1.0 - 0.01 * within, _LEAST), 1: 1.0 + 0.01 * within}
        springs = np.full((len(robot), 2), ends[k]) if k in ends else factors(len(robot), 2)
        drawn = {Place(i, name): by for i, two in enumerate(springs) for name, by in zip(_OF_SPRING, two, strict=True)}
        for (i, side), several in zip(numbers.sides, masses, strict=True):
            names = [Place(i, f"{side}{name}" if (side, name) != ("motor_", "offset") else name) for name in _OF_MASS]
            drawn |= zip(names, several[[*_OF_MASS.values()]], strict=True)
        own = [place for place in drawn if place in numbers]
        moved = numbers.with_values(own, [numbers[place] * drawn[place] for place in own])
        yield robot_with(robot, replace(moved, inertials=numbers.inertials * factors(len(robot), 1)))
