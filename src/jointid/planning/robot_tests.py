"""Tests of a robot: what each motion tells and reaches.

Of a motion q the columns W(q) of base parameters and friction say what a test will tell: with white noise of deviation
s_k on the log of joint k's torque the errors of all parameters have the covariance of::

    M = sum_k W_k' W_k / s_k^2,      cov = M^-1

The goal of all parameters is D-optimal, the largest log det M [Swevers et al. 1997]; no units and no choice of base
parameters enter it. The motions are Fourier series (`robot_motions`). Of joints with springs a multisine about the mode
of rotor against link is added. Under its controllers the robot is simulated, with derivatives by variation; torques and
the intervals of the springs are those of the simulation.

Obstacles, and the robot's own body, are not known here: play the motion slowly first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join, number
from jointid.diagnostics.axis_torques import torques_of_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.estimation.robots.consistent import mass_matrix_at
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.problem import robot_problem
from jointid.estimation.robots.regression import motion_of_robot
from jointid.estimation.robots.simulated import SimulatedRobot, nominal_numbers, parameter_units
from jointid.models.limits import AxisLimits
from jointid.models.robots.base_parameters import base_parameters, inverse_columns, standard_values
from jointid.models.robots.friction_terms import Friction, friction_columns, friction_terms
from jointid.models.robots.robot import Robot
from jointid.planning.designed import DesignedAxis
from jointid.planning.goals import ALL, Goal, parse_goal
from jointid.planning.predict import PEAKS, PredictedTest
from jointid.planning.robot_motions import Motions, complete
from jointid.planning.search import MARGIN, Tried, judge
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation import excitation
from jointid.simulation.closed_loop import require_success
from jointid.simulation.robot_numbers import MassNumbers, RobotNumbers, robot_with
from jointid.simulation.robots import (
    RobotLoop,
    RobotSimulation,
    add_feed_forward,
    prepare_robot,
    run_robot,
    simulation_of,
)
from jointid.uncertainty.covariance import Covariance, covariance_of

MotionOfJoints: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Positions, velocities and accelerations of the joints, (instants, n) each."""

NOISE = 0.01
"""Of each joint's torque in motions drawn at random: the predicted noise without a first record."""

_HARMONICS = (4, 6, 8)
_INSTANTS = 160  # of a period, at which columns are taken in the search
_USUAL = 20  # random motions
_FOR_MODES = 0.2  # of speed and acceleration, kept for the multisine where there are springs
_ABOUT = (0.6, 1.6)  # of a mode's frequency: the band of the multisine
_LINES = 20
_TOLD = 2.0  # deviations that a value is off 0, to be a scale of its own
_DRAWN, _SIMULATED = 20, 6  # robots that it may be, by the equations and under the controllers
_LEAST = 0.2  # of a number that is drawn: less is no robot that somebody declared
_SINGULAR = 1e-10  # of the largest: a direction that is not determined


@dataclass(frozen=True, slots=True)
class RobotPlan:
    """A motion of the family with these numbers, about its first pose made smaller by a factor."""

    motions: Motions
    numbers: tuple[float, ...]
    factor: float = 1.0

    def scale(self, factor: float) -> RobotPlan:
        """Return the motion with smaller travel."""
        return replace(self, factor=factor * self.factor)

    def play(self, time: FloatArray) -> MotionOfJoints:
        """Return positions, velocities and accelerations of the joints, (instants, n) each."""
        numbers = np.array(self.numbers)
        q, v, a = self.motions.play(numbers, time)
        first = self.motions.play(numbers, np.zeros(1))[0]
        return first + self.factor * (q - first), self.factor * v, self.factor * a


@dataclass(frozen=True, slots=True, eq=False)
class RobotTests:
    """The search problem of a robot.

    Attributes:
        robot: as it is roughly known.
        loop: it under its controllers, for a test by DIDIM; None for one by IDIM.
        limits: that each joint keeps; of given ones alone where nothing is searched.
        given: those that were stated.
        noise_sizes: (n,) standard deviation of white noise on the log of each torque.
        noise: that in words.
        assumed: whether nothing is known of the noise.
        first: what a first record says; None without one.
        drawn: robots that it may be, beside the one that is roughly known.
        simulated: whether candidates are simulated under the controllers, and not by the equations alone.
        begin: first candidates: none, since a first record is no series.
    """

    robot: Robot
    loop: RobotLoop | None
    model: _Regressor
    goal: Goal
    limits: tuple[AxisLimits, ...]
    given: tuple[AxisLimits, ...]
    samples: int
    sample_time: float
    noise_sizes: FloatArray
    noise: str
    assumed: bool
    first: FirstRecord | None
    filtering: Filtering | None
    feed_forward: Literal["none", "gravity", "inverse-model"]
    drawn: tuple[_Regressor, ...] = ()
    simulated: bool = True
    begin: ClassVar[tuple[RobotPlan, ...]] = ()

    @property
    def families(self) -> tuple[Motions, ...]:
        """Families to search: series of several lengths."""
        share = 1.0 - _FOR_MODES if any(self.robot.flexible) else 1.0
        period = self.samples * self.sample_time
        return tuple(Motions(self.limits, period, harmonics, share) for harmonics in _HARMONICS)

    def plan(self, family: Motions, u: Sequence[float]) -> RobotPlan:
        """Return a family's test for numbers between 0 and 1."""
        return RobotPlan(family, tuple(u))

    @property
    def rough(self) -> RobotTests:
        """The same by the equations of a rigid robot, for the search, where they tell the goal."""
        simulated = self.loop is not None and self.goal.name != ALL
        return replace(self, simulated=simulated, drawn=() if simulated else self.drawn)

    def record(self, plan: RobotPlan) -> tuple[Record, ...]:
        """Return a test as a record of each joint."""
        q, _, _ = plan.play(np.asarray(np.arange(self.samples) * self.sample_time))
        if any(self.robot.flexible):
            q = q + _multisines(self.robot, _modes(self.robot, q), self.limits, self.samples, self.sample_time)
        return references(self.robot, q, self.sample_time)

    def describe(self, plan: RobotPlan | None) -> str:
        """Return a test in words."""
        if plan is None:
            return "the references as given"
        modes = " with multisines about the modes" if any(self.robot.flexible) else ""
        count, lasts = plan.motions.harmonics, number(plan.motions.period, 3)
        return f"a Fourier series of {count} harmonics of every joint, {lasts} s long{modes}"

    def try_plan(self, plan: RobotPlan, *, margin: float = MARGIN, than: Tried | None = None) -> Tried:
        """Judge a motion, by the equations of a rigid robot or simulated."""
        if self.simulated:
            return self._judge(plan, self._predict(self.record(plan)), margin, than)
        motion = plan.play(np.linspace(0.0, plan.motions.period, _INSTANTS, endpoint=False))
        each = self._apply_equations(motion, plan.motions.period / _INSTANTS, self.samples / _INSTANTS)
        return self._judge(plan, each, margin, than)

    def take(self, motion: Sequence[Record]) -> Tried:
        """Judge a motion of one's own, or that of a past record."""
        return self._judge(None, self._predict(motion))

    def _judge(
        self, plan: RobotPlan | None, each: Iterator[PredictedTest], margin: float = 1.0, than: Tried | None = None
    ) -> Tried:
        return judge(plan, each, 1 + len(self.drawn), self.goal, self.limits, margin=margin, than=than)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Clauses on what is not known: a friction that nothing states is missing in the torque."""
        numbers = RobotNumbers.of(self.robot)
        slides = np.any(numbers.masses[:, 1:] != 0.0, axis=1)
        without = [n for k, n in enumerate(self.robot.names) if not (slides[k] or slides[numbers.rotors[k]])]
        if not without:
            return ()
        return (
            f"the torque is without the friction of {join(without)}, which nothing states: give viscous and coulomb, "
            "or a first record",
        )

    def predict(self, test: Sequence[Record], plan: RobotPlan | None = None) -> dict[str, PredictedTest]:
        """Predict the first record's motion and the new one."""
        del plan  # a series has one period
        found: dict[str, PredictedTest] = {}
        if (first := self.first) is not None:
            known = references(self.robot, first.motion[0], first.sample_time)
            found["present"] = next(self._predict(known, first.motion))
        return found | {"proposed": next(self._predict(test))}

    def axes(self, test: Sequence[Record], tried: Tried, proposed: PredictedTest) -> tuple[DesignedAxis, ...]:
        """Return the loads of each joint in the test."""
        modes = _modes(self.robot, differentiate_references(self.robot, test)[0])
        return tuple(
            DesignedAxis(
                name, test[k], proposed.torques[k], proposed.sample_time, self.robot.position_unit(k),
                self.robot.torque_unit(k), None, self.limits[k],
                tuple(one for one in self.limits[k].stated if one not in self.given[k].stated and one != "stroke"),
                tried.reached[k], (), {"mode": modes[name]} if name in modes else {},
            )
            for k, name in enumerate(self.robot.names)
        )  # fmt: skip

    def _predict(self, test: Sequence[Record], motion: MotionOfJoints | None = None) -> Iterator[PredictedTest]:
        """Predict a test of each robot, by the equations of a rigid one or, under its controllers, simulated.

        The drives are given the feed-forward of the robot that is roughly known.
        """
        assert test[0].reference is not None
        motion, step = motion or differentiate_references(self.robot, test), test[0].reference.sample_time
        if self.loop is None:
            yield from self._apply_equations(motion, step)
            return
        driven = test if self.feed_forward == "none" else add_feed_forward(self.loop, test, self.feed_forward)
        for one in (self.robot, *(drawn.robot for drawn in self.drawn)):
            yield self._simulate(replace(self.loop, robot=one), driven, motion, step)

    def _apply_equations(self, motion: MotionOfJoints, step: float, times: float = 1.0) -> Iterator[PredictedTest]:
        """Predict a motion whose instants each stand for several samples."""
        columns = self.model.columns(*motion)
        covariance = _covariance((columns / self.noise_sizes[:, np.newaxis]).reshape(-1, columns.shape[2]), times)
        for one in (self.model, *self.drawn):
            torque = columns @ one.values
            reached = _maxima(*motion, step, torque, self.noise_sizes, {})
            yield _predicted(self.model.names, self.model.units, one.values, covariance, torque, step, reached)

    def _simulate(
        self, loop: RobotLoop, driven: Sequence[Record], motion: MotionOfJoints, step: float
    ) -> PredictedTest:
        """Predict a test by DIDIM from a run under the controllers.

        Rows that are filtered and thinned hold white noise of the part of its power that passes, so each of them tells
        as much as the samples that it stands for.
        """
        parameters = robot_parameters(loop.robot)
        kept = run_robot(prepare_robot(loop, driven), RobotNumbers.of(loop.robot), keep=True)
        run = require_success(simulation_of(kept), "The robot's motion")
        problem = robot_problem(loop, run.records(driven), parameters, self.filtering)
        values = parameters.group(kept.numbers)
        J = problem.slopes(kept, values)
        assert problem.filtering.decimation is not None
        weights = problem.with_sigma(self.noise_sizes / math.sqrt(problem.filtering.decimation)).weights(len(J))
        units = parameter_units(loop.robot, parameters)
        speeds = (motion[1], run.motor_velocity, run.link_velocity)
        windup = np.abs(run.motor_position - run.link_position @ loop.robot.coupling.T).max(axis=0)
        more = {
            "speed": np.max([np.abs(one).max(axis=0) for one in speeds], axis=0),
            "windup": np.where(loop.robot.flexible, windup, np.nan),
        }
        reached = _maxima(*motion, step, run.torque, self.noise_sizes, more)
        return _predicted(
            parameters.names, [units[name] for name in parameters.names], values,
            _covariance(J * weights[:, np.newaxis]), run.torque, step, reached, run,
        )  # fmt: skip


def _predicted(
    names: Sequence[str], units: Sequence[str], values: FloatArray, covariance: Covariance, torque: FloatArray,
    step: float, reached: tuple[Mapping[str, float], ...], run: RobotSimulation | None = None,
) -> PredictedTest:  # fmt: skip
    """Return the prediction of a robot's test from its torques, (samples, n); a symbol is the name."""
    symbols, of_each = dict(zip(names, names, strict=True)), dict(zip(names, units, strict=True))
    rough = dict(zip(names, map(float, values), strict=True))
    torques = np.ascontiguousarray(torque.T)
    return PredictedTest("test", tuple(names), symbols, of_each, rough, covariance, torques, step, reached, run)


def differentiate_references(robot: Robot, test: Sequence[Record]) -> MotionOfJoints:
    """Return positions, velocities and accelerations of the joints along references of the motors."""
    shafts = [one.reference for one in test if one.reference is not None]
    q = np.column_stack([one.values for one in shafts]) @ np.linalg.inv(robot.coupling).T
    v = np.gradient(q, shafts[0].sample_time, axis=0)
    return q, v, np.gradient(v, shafts[0].sample_time, axis=0)


def robot_tests(
    robot: Robot,
    loop: RobotLoop | None,
    goal: str,
    limits: Sequence[AxisLimits] | None,
    *,
    samples: int,
    sample_time: float,
    noise: FloatArray | None,
    first: FirstRecord | None,
    filtering: Filtering | None,
    feed_forward: Literal["none", "gravity", "inverse-model"],
    seed: int,
    motion: Sequence[Record] | None,
    within: float | None = None,
) -> RobotTests:
    """Pose the tests of a robot that is roughly known; see `jointid.design`.

    `first` is what a first record says, `motion` a test of one's own in the place of a search, `within` the percent
    that each number of the robot may be off.
    """
    if any(robot.flexible) and loop is None:
        raise MethodError(
            "The intervals of springs are predicted under the controllers, and there are none; give every joint its "
            "controller, or leave the springs out."
        )
    given = tuple(limits) if limits is not None else (AxisLimits(),) * len(robot)
    if len(given) != len(robot):
        raise MethodError(f"A robot of {len(robot)} joints has as many limits; received {len(given)}.")
    if motion is not None and (any(one.reference is None for one in motion) or len(motion) != len(robot)):
        played = sum(one.reference is not None for one in motion)
        raise MethodError(
            f"The motion of a robot has the reference of each joint; received {played} for {len(robot)} "
            "joints: give one for each, in the order of the joints."
        )
    model = _Regressor.of(robot)
    units = dict(zip(model.names, model.units, strict=True))
    if loop is not None:
        units = parameter_units(robot, robot_parameters(robot))
    drawn = () if not within else _draw_robots(robot, within, _SIMULATED if loop is not None else _DRAWN, seed)
    kept = given if motion is not None else complete(given, None if first is None else first.motion, robot.names)
    if noise is not None:
        sizes, said = noise, f"white, as stated: {', '.join(number(float(one), 3) for one in noise)}"
    elif first is not None:
        sizes, said = first.noise, "white, as the first record's residual"
    else:
        family = Motions(kept, samples * sample_time, _HARMONICS[-1])
        motions = _draw_motions(family, seed) if motion is None else [differentiate_references(robot, motion)]
        usual = np.array([model.torque(*one) for one in motions])
        sizes = NOISE * np.sqrt(np.mean(usual**2, axis=(0, 1)))
        said = f"white, {100 * NOISE:g} % of each joint's usual torque"
    return RobotTests(
        robot, loop, model, parse_goal(goal, units), kept, given, samples, sample_time, sizes, said,
        noise is None and first is None, first, filtering, feed_forward, drawn,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class FirstRecord:
    """Noise and motion of a first record, as a design takes them.

    Attributes:
        noise: (n,) deviation of white noise on each joint's log that has as much in the band of the filter as the
            estimate left.
        motion: positions, velocities and accelerations of the joints, (samples, n) each; of a test by DIDIM those of
            the references.
        sample_time: s.
    """

    noise: FloatArray
    motion: MotionOfJoints
    sample_time: float

    @property
    def duration(self) -> float:
        """Of the record, s."""
        return len(self.motion[0]) * self.sample_time


def first_record(estimate: Estimate, records: Sequence[Record]) -> FirstRecord:
    """Summarise a record and its estimate for the next test.

    Args:
        estimate: of the robot.
        records: of each joint, that it was identified from.

    Raises:
        RecordError, MethodError: as of the identification.
    """
    torques, robot = torques_of_robot(estimate, records), estimate.require_robot().model
    left = np.array([np.sqrt(np.mean(e[s] ** 2)) for e, s in zip(torques.error, torques.seen, strict=True)])
    if estimate.settings.method != "didim":
        found = motion_of_robot(robot, records, estimate.settings.filtering)
        motion, sample_time = (found.q, found.v, found.a), found.sample_time
    else:
        assert records[0].reference is not None
        motion, sample_time = differentiate_references(robot, records), records[0].reference.sample_time
    # White noise has in the band the share 2 cutoff / rate of its power.
    return FirstRecord(left * np.sqrt(0.5 / (sample_time * torques.cutoff)), motion, sample_time)


@dataclass(frozen=True, slots=True, eq=False)
class _Regressor:
    """Columns of a rigid robot's torques, and its own parameters.

    Attributes:
        robot: as it is roughly known.
        names, units, values: of its base parameters, then of its friction, as IDIM tells it.
        chosen: see `BaseParameters`.
    """

    robot: Robot
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    chosen: NDArray[np.intp]

    @classmethod
    def of(cls, robot: Robot) -> _Regressor:
        base = base_parameters(robot)
        values = base.with_friction(robot)
        terms = friction_terms(robot)
        for i, term in enumerate(terms):
            spring = robot.joints[term.joint].spring
            if spring is not None and term.number is not Friction.OFFSET and term.number is not Friction.RISE:
                values[len(base) + i] += spring.coulomb if term.number is Friction.COULOMB else spring.viscous
        units = (*base.units, *(term.unit(robot) for term in terms))
        return cls(robot, (*base.names, *(term.name(robot) for term in terms)), units, values, base.chosen)

    def columns(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the columns at instants, (instants, n, parameters)."""
        links = inverse_columns(self.robot, q, v, a)[:, :, self.chosen]
        return np.concatenate([links, friction_columns(self.robot, v)], axis=2)

    def torque(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the nominal robot's torques, (instants, n)."""
        return np.asarray(self.columns(q, v, a) @ self.values)


def _covariance(J: FloatArray, times: float = 1.0) -> Covariance:
    """Return the covariance of least squares on rows of deviation 1 that are there several times.

    Where a combination is not determined, every deviation is infinite; a parameter without effect has an infinite one.
    """
    norms = np.linalg.norm(J, axis=0)
    seen = norms > 0.0
    found = Covariance(np.full(J.shape[1], np.inf), np.eye(J.shape[1]))
    R = np.linalg.qr(J[:, seen] / norms[seen], mode="r")
    sizes = np.linalg.svd(R, compute_uv=False)
    if sizes.size and sizes[-1] > _SINGULAR * sizes[0]:
        inverse = np.linalg.inv(R)
        own = covariance_of(inverse @ inverse.T / times, norms[seen])
        found.std[seen] = own.std
        found.correlation[np.ix_(seen, seen)] = own.correlation
    return found


def _draw_motions(family: Motions, seed: int) -> Iterator[MotionOfJoints]:
    """Yield random motions, whose torques say what noise is usual."""
    rng, instants = np.random.default_rng(seed), np.linspace(0.0, family.period, _INSTANTS, endpoint=False)
    for _ in range(_USUAL):
        yield RobotPlan(family, tuple(rng.uniform(size=family.size))).play(instants)


def _maxima(
    q: FloatArray, v: FloatArray, a: FloatArray, sample_time: float, torque: FloatArray, noise: FloatArray,
    more: dict[str, FloatArray],
) -> tuple[Mapping[str, float], ...]:  # fmt: skip
    """Return the maxima of the limited quantities of each joint, the torques with noise, and `more` in their place."""
    each = {
        "lower": q.min(axis=0),
        "upper": q.max(axis=0),
        "stroke": np.ptp(q, axis=0),
        "speed": np.abs(v).max(axis=0),
        "acceleration": np.abs(a).max(axis=0),
        "jerk": np.abs(np.diff(a, axis=0)).max(axis=0) / sample_time,
        "torque": np.abs(torque).max(axis=0) + PEAKS * noise,
        "rms_torque": np.sqrt(np.mean(torque**2, axis=0) + noise**2),
    } | more
    rows = ({name: float(sizes[k]) for name, sizes in each.items()} for k in range(len(noise)))
    return tuple({name: size for name, size in row.items() if not math.isnan(size)} for row in rows)


def references(robot: Robot, q: FloatArray, sample_time: float) -> tuple[Record, ...]:
    """Return a motion of the joints, (samples, n), as references of the motors."""
    shafts = q @ robot.coupling.T
    return tuple(
        Record(
            reference=Channel(np.ascontiguousarray(one), robot.position_unit(k), sample_time, source="planned"),
            name="test",
        )
        for k, one in enumerate(shafts.T)
    )


def _draw_robots(robot: Robot, within: float, count: int, seed: int) -> tuple[_Regressor, ...]:
    """Return robots whose bodies, rotors, frictions and springs are each off by a factor of its own.

    Args:
        robot: as it is roughly known.
        within: percent, 2 sigma of the factors.
        count: of robots.
        seed: of the draws.
    """
    rng, numbers = np.random.default_rng([seed, 1]), RobotNumbers.of(robot)

    def factors(*shape: int) -> FloatArray:
        return np.maximum(1.0 + 0.005 * within * rng.standard_normal(shape), _LEAST)

    found = []
    for k in range(count):
        masses, springs = numbers.masses.copy(), numbers.springs.copy()
        masses[:, : MassNumbers.RISE + 1] *= factors(len(masses), MassNumbers.RISE + 1)
        # Nothing moves a prediction as a mode does: the first two robots have the softest and the stiffest springs.
        ends = {0: max(1.0 - 0.01 * within, _LEAST), 1: 1.0 + 0.01 * within}
        springs[:, :2] *= ends[k] if k in ends else factors(len(robot), 2)
        bodies = numbers.inertials * factors(len(robot), 1)
        one = robot_with(robot, replace(numbers, inertials=bodies, masses=masses, springs=springs))
        found.append(_Regressor.of(one))
    return tuple(found)


def combine_with_nominal(part: IdentifiedRobot) -> Robot:
    """Return the robot near the nominal one with what an estimate found: bodies, rotors, friction and springs.

    What the records hardly determine keeps its nominal value: with n the nominal parameters, P the squares of what they
    may be off and C the covariance of the estimate x, the parameters are ``n + P (P + C)^-1 (x - n)``.
    """
    prior = part.model
    try:
        sums = part.sums(prior)
    except MethodError:  # a spring is not shown: friction is known nevertheless
        return robot_with(prior, nominal_numbers(prior, part.numbers())) if isinstance(part, SimulatedRobot) else prior
    A = np.hstack([sums.of_standard, sums.of_others])
    least = np.concatenate([np.full(10 * len(prior), -np.inf), np.zeros(len(prior)), sums.least])
    x = np.concatenate([standard_values(prior), sums.others])
    nominal = A @ x
    significant = np.where(np.abs(sums.values) > _TOLD * sums.covariance.std, sums.values, 0.0)
    wide = nominal**2 + significant**2 + 1e-30
    scale = np.sqrt(wide)
    shares = sums.covariance.matrix / np.outer(scale, scale)
    moved = scale * np.linalg.solve(np.eye(scale.size) + shares, (sums.values - nominal) / scale)
    x = np.maximum(x + np.linalg.pinv(A) @ moved, least)
    bodies, rotors, others = np.split(x, [10 * len(prior), 11 * len(prior)])
    try:
        return sums.robot(bodies.reshape(-1, 10), rotors, others)
    except MethodError:
        return prior


def _modes(robot: Robot, q: FloatArray) -> dict[str, float]:
    """Return the frequency of each flexible joint's rotor against its link, the others held, along a motion, Hz.

    Springs are the shafts', so what is held is the other shafts: of coupled motors a link then moves others with it.
    """
    poses, joints = q[:: max(len(q) // 20, 1)], np.linalg.inv(robot.coupling)
    bare = replace(robot, joints=tuple(replace(one, rotor_inertia=0.0, spring=None) for one in robot.joints))
    about = np.mean([np.diag(joints.T @ mass_matrix_at(bare, one) @ joints) for one in poses], axis=0)
    found = {}
    for k, joint in enumerate(robot.joints):
        if joint.spring is not None:
            # Of a link of which nothing is known a twentieth of what swings is the link's.
            link = max(float(about[k]), joint.rotor_inertia / 19.0)
            inertia = joint.rotor_inertia * link / (joint.rotor_inertia + link)
            found[joint.name] = math.sqrt(joint.spring.stiffness / inertia) / (2.0 * math.pi)
    return found


def _multisines(
    robot: Robot, modes: dict[str, float], limits: Sequence[AxisLimits], samples: int, sample_time: float
) -> FloatArray:
    """Return multisines about the mode of each flexible joint, (samples, n), within the range kept for them.

    Sines of equal acceleration; the positions that they take are a part of the margin that motions keep to their ends.
    """
    added = np.zeros((samples, len(limits)))
    for k, joint in enumerate(robot.joints):
        if joint.name not in modes:
            continue
        low, high = (share * modes[joint.name] for share in _ABOUT)
        high = min(high, 0.4 / sample_time)
        wave = excitation.multisine(samples, sample_time, 1.0, min(low, 0.5 * high), high, lines=_LINES, tilt=2.0)
        wave = np.roll(wave, k)  # no two joints alike
        wave[:k] = 0.0
        speed = np.gradient(wave, sample_time)
        limit, most = limits[k], [math.inf]
        assert limit.speed is not None
        assert limit.upper is not None
        assert limit.lower is not None
        most.append(_FOR_MODES * limit.speed / float(np.max(np.abs(speed))))
        most.append(0.01 * (limit.upper - limit.lower))
        if limit.acceleration is not None:
            most.append(_FOR_MODES * limit.acceleration / float(np.max(np.abs(np.gradient(speed, sample_time)))))
        added[:, k] = min(most) * wave
    return added
