"""Model of a joint for test design, and predicted intervals of tests.

The loop is simulated along the planned reference and injection at the rough parameters, and at others of their
interval. The derivatives J of the torque pass the identification's filter. With S the covariance of ``J' e``, e the
filtered torque error from noise::

    cov = (J' J)^-1  S  (J' J)^-1

S depends on the known noise (`Noise`):

- white noise on the logged torque, or a white force on the motor: S is the mean of ``(J' e)(J' e)'`` over simulated
  runs, since friction hides a force and the loop colours it. With one run it is approximated from the spectrum of e,
  which is fast enough for a search.
- the residual of a first record: it keeps its spectrum, and each interval is scaled as that record's reported interval
  relative to the one by spectrum. This includes repeatable errors.

The identification is the least squares of `DIDIM` with free initial position and, with an integral, torque. Bounds,
saturation most of the time, and failed searches are not predicted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import POSITION_UNIT, Parameter, Quantity
from jointid.common.text import number
from jointid.estimation.problems.simulated import ClosedLoopProblem, beginning_position, torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.limits import AxisLimits
from jointid.planning.designed import DesignedAxis
from jointid.planning.floor import least_deviation
from jointid.planning.plans import Family, Plan, families_in
from jointid.planning.predict import Goal, Noise, PredictedTest, find_maxima, find_undetermined
from jointid.records.record import Channel, Injection, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import to_log
from jointid.simulation.simulate import Simulation, require_success
from jointid.uncertainty.covariance import Influence, covariance_of

RUNS = 200
"""Runs of the loop with noise, from which its effect is known to 5 %."""

_JOINTS = 2  # of the interval, beside the one that is roughly known, in the search
_MORE_JOINTS = 20  # of the interval, at which the result is predicted
_LEAST = 0.2  # of an inertia or a stiffness that is drawn: less is no joint that was identified
_MORE = {"speed": 2.0, "acceleration": 2.0}  # of the present test's, in the place of limits that are not given


@dataclass(frozen=True, slots=True, eq=False)
class JointModel:
    """A roughly known joint in its loop.

    Attributes:
        loop: joint and controller.
        joints: values of every parameter, one mapping for each joint of the tolerance, the roughly known one first.
        disturbance: of every test.
        samples, sample_time: of a test and its log, s.
        filtering, parameters: of the identification.
        injection: whether the drive can add a signal.
        present: record of the existing test; empty without one.
    """

    needed = ("stroke", "speed", "acceleration", "torque")
    kept = ("stroke", "torque", "rms_torque")
    names = ("",)
    doubts = ()
    from_shafts = None
    loop: ClosedLoop
    joints: tuple[Mapping[str, float], ...]
    disturbance: Noise
    samples: int
    sample_time: float
    filtering: Filtering
    parameters: Mapping[str, Parameter]
    injection: bool
    present: tuple[Record, ...]

    @property
    def units(self) -> dict[str, str]:
        """Units of the free parameters, by name."""
        own = (self.parameters.get(p.name, p) for p in self.loop.joint.parameters)
        return {p.name: self.loop.joint.unit(p) for p in own if p.free}

    @property
    def noise(self) -> str:
        """The noise in words."""
        noise, unit = self.disturbance, self.loop.joint.force_unit
        parts = ["the residual of the present test"] * (noise.left is not None)
        parts += [f"white, {noise.log:.3g} {unit} on the log"] * bool(noise.log > 0)
        return " and ".join([*parts, *[f"a white force of {noise.force:.3g} {unit}"] * bool(noise.force > 0)])

    def roughly(self, _: Goal) -> JointModel:
        """Return the model with few joints, for the search."""
        return replace(self, joints=self.joints[: 1 + _JOINTS])

    def families(
        self, limits: Sequence[AxisLimits], goal: Goal, before: PredictedTest | None
    ) -> tuple[tuple[Family, ...], float | None]:
        """Families to search within limits, and the goal's least possible deviation."""
        (limit,), loop, values = limits, self.loop, self.joints[0]
        cutoff = self.filtering.resolve(self.sample_time, loop.joint.model).cutoff
        assert cutoff is not None
        highest = min(limit.highest or cutoff, cutoff)
        noise, samples = self.disturbance, self.samples
        floor = least_deviation(loop, values, noise, goal, limit, samples, self.sample_time, highest)
        flexible = loop.joint.model == "flexible"
        mode = FlexibleJoint.frequencies(values)["free_free"] if flexible else 0.5 * highest
        reached = {} if before is None else before.reached[0]
        sizes = {name: _MORE.get(name, 1.0) * size for name, size in reached.items()} | limit.stated
        low, high = (sizes.get(name, 0.0) for name in ("lower", "upper"))
        if limit.lower is None and limit.upper is not None:
            low = limit.upper - sizes["stroke"]
        elif limit.lower is None:  # the middle is the present test's
            low = 0.5 * (low + high - sizes["stroke"])
        room = replace(limit, **{name: sizes[name] for name in self.needed}, lower=low, upper=None)
        lines = () if floor is None else floor.lines
        families = families_in(room, highest, min(mode, 0.9 * highest), lines, injection=self.injection)
        return families, None if floor is None else floor.deviation

    def records(self, plan: Plan) -> tuple[Record, ...]:
        """Return a test as a record for the drive, without torque."""
        T, joint = self.sample_time, self.loop.joint
        values, *added = plan.play(np.asarray(np.arange(self.samples) * T))
        position, known = POSITION_UNIT[joint.kind], self.present[0] if self.present else None
        velocity = None
        if "reference_velocity" in self.loop.controller.channels:
            velocity = Channel(np.gradient(values, T), f"{position}/s", T)
        injected = None
        if added:
            signal = Channel(added[0], joint.force_unit, T, Timing.HELD)
            before = None if known is None else known.injected
            injected = Injection(signal) if before is None else replace(before, channel=signal)
        tap, commanded = Tap.COMMAND if known is None else known.tap, Channel(values, position, T)
        one = Record(reference=commanded, reference_velocity=velocity, injected=injected, tap=tap, name="test")
        return (one,)

    def describe(self, test: Sequence[Record], plan: Plan | None) -> str:
        """Return a test in words."""
        (record,), joint = test, self.loop.joint
        assert record.reference is not None
        motion, added = ("as given", "a signal") if plan is None else plan.family.words
        said = f"{motion}, {number(float(np.ptp(record.reference.values)), 3)} {POSITION_UNIT[joint.kind]} of travel"
        if record.injected is None:
            return said
        size = float(np.max(np.abs(record.injected.channel.values)))
        return f"{said}, with {added} of up to {number(size, 3)} {joint.force_unit} on the torque"

    def predict_plan(self, plan: Plan) -> Iterator[PredictedTest]:
        """Predict a test at every joint, roughly."""
        return self.predict(self.records(plan))

    def predict(self, test: Sequence[Record], runs: int = 1) -> Iterator[PredictedTest]:
        """Predict a test at every joint, the known one first, with noise.

        Args:
            test: a record without torque; a past record also serves, its torque is ignored.
            runs: number of simulations with noise; with 1 the spectrum is used.

        Raises:
            MethodError: the loop cannot be simulated.
            RecordError: the test lacks a channel that the controller reads.
        """
        problem, noise = self._pose(test[0]), self.disturbance
        free, reference = problem.free_joint, test[0].reference
        assert reference is not None
        names, own = tuple(p.name for p in free), len(free)
        wider = np.array([noise.wider.get(p.name, 1.0) for p in problem.free])
        for seed, values in enumerate(self.joints):
            x = _place(problem, values)
            run = require_success(problem.simulate(x))
            J = -problem.linearise(x)[1]
            errors = _draw_errors(problem, x, noise, runs, seed)
            matrix, left = _scatter(problem, J, errors), np.zeros(1)
            if noise.left is not None:
                left = np.resize(noise.left, len(J))
                matrix = matrix + Influence(J, left).stationary().matrix * np.outer(wider, wider)
            covariance = covariance_of(matrix[:own, :own])
            covariance.std[find_undetermined(J)[:own]] = np.inf
            size = math.sqrt(float(np.mean(left**2) + np.mean(np.square(errors or [np.zeros(1)]))))
            yield PredictedTest(
                names, {p.name: p.symbol for p in free}, self.units, {name: values[name] for name in names}, covariance,
                run.torque[np.newaxis], problem.sample_time, _find_joint_maxima(run, reference, size),
            )  # fmt: skip

    def _pose(self, test: Record) -> ClosedLoopProblem:
        """The identification problem of a test, with zero torque."""
        test.require(("reference",), "A test")
        unit, samples = self.loop.joint.force_unit, math.floor(test.duration / self.sample_time + 1e-9)
        torque = test.torque or Channel(np.zeros(samples), unit, self.sample_time, Timing.HELD)
        played = replace(test, torque=replace(torque, values=np.zeros(len(torque))))
        own = tuple(self.parameters.get(p.name, p) for p in self.loop.joint.parameters)
        return torque_problem(played, self.loop, self.filtering, own).keeping({"initial_velocity": 0.0})

    def axes(
        self, test: Sequence[Record], limits: Sequence[AxisLimits], given: Sequence[AxisLimits],
        reached: Sequence[Mapping[str, float]],
    ) -> tuple[DesignedAxis, ...]:  # fmt: skip
        """Return the loads of the axis in the test."""
        joint = self.loop.joint
        units = POSITION_UNIT[joint.kind], joint.force_unit
        return (DesignedAxis("", test[0], *units, joint.transmission, limits[0], given[0], reached[0]),)


def joint_model(
    model: Estimate | ClosedLoop,
    present: tuple[Record, ...],
    times: tuple[int, float],
    *,
    values: Mapping[str, float] | None,
    noise: Noise | None,
    within: float | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    injection: bool,
    seed: int,
) -> JointModel:
    """Model a joint for test design; see `jointid.design`."""
    covariance, loop = None, model if isinstance(model, ClosedLoop) else model.settings.loop
    if isinstance(model, Estimate) and loop is not None and present:
        covariance = model.covariance_of([p.name for p in model.rows if p.free and p.of_joint]).matrix
        values, noise, filtering = model.values, noise or Noise.of(model, present[0]), model.settings.filtering
        free = {p.name for p in model.rows if p.free}
        parameters = {p.name: p.fix(values[p.name]) for p in loop.joint.parameters if p.name not in free}
    if loop is None or values is None or noise is None:
        raise MethodError(
            "A joint's test needs an estimate by DIDIM and its record, or a loop with values and noise; give these."
        )
    rows = [p for p in ((parameters or {}).get(p.name, p) for p in loop.joint.parameters) if p.free]
    if within is not None:
        covariance = np.diag([(0.005 * within * values[p.name]) ** 2 for p in rows])
    joints = (dict(values), *_draw(values, rows, covariance, _MORE_JOINTS, seed))
    return JointModel(loop, joints, noise, *times, filtering or Filtering(), parameters or {}, injection, present)


def _draw(
    values: Mapping[str, float], free: Sequence[Parameter], covariance: FloatArray | None, count: int, seed: int
) -> list[dict[str, float]]:
    """Draw joints from the interval, within the parameters' bounds, if known."""
    if covariance is None:
        return []
    rng = np.random.default_rng([seed, 1])
    drawn = []
    for row in rng.multivariate_normal(np.zeros(len(free)), covariance, size=count, method="eigh"):
        one = dict(values)
        for p, by in zip(free, map(float, row), strict=True):
            least = _LEAST * values[p.name] if p.quantity in (Quantity.INERTIA, Quantity.STIFFNESS) else p.lower
            one[p.name] = min(max(values[p.name] + by, least), p.upper)
        drawn.append(one)
    return drawn


def _find_joint_maxima(run: Simulation, reference: Channel, noise: float) -> tuple[dict[str, float], ...]:
    """Return the maxima of a joint's test."""
    motor, load, speeds = run.motor_position, run.load_position, (run.motor_velocity, run.load_velocity)
    windup = None if load is None else np.max(np.abs(load - motor), keepdims=True)
    positions = [one[:, np.newaxis] for one in (reference.values, motor, load) if one is not None]
    velocities = [one[:, np.newaxis] for one in speeds if one is not None]
    acceleration = np.diff(positions[0], 2, axis=0) / reference.sample_time**2
    torque = run.torque[:, np.newaxis]
    return find_maxima(positions, velocities, acceleration, torque, reference.sample_time, noise, windup)


def _place(problem: ClosedLoopProblem, values: Mapping[str, float]) -> FloatArray:
    """Free parameters of a joint that starts at rest."""
    held = _holding_torque(problem.loop, values, float(problem.axis.inputs[0, REFERENCE]))
    position = beginning_position(problem, torque=held)
    around = {"initial_position": position, "initial_velocity": 0.0, "initial_torque": held}
    return problem.vector({**values, **around})


def _holding_torque(loop: ClosedLoop, values: Mapping[str, float], position: float) -> float:
    """Torque that holds a joint at rest at a position."""
    gravity, ripple, offset = loop.joint.gravity, loop.joint.ripple, values.get("offset", 0.0)
    here, forces = np.array([position]), list[tuple[FloatArray, tuple[Parameter, ...]]]()
    forces += [] if gravity is None else [(gravity.columns(here)[0], gravity.parameters)]
    forces += [] if ripple is None else [(ripple.columns(here)[0], ripple.parameters)]
    return offset + sum(float(columns @ [values[p.name] for p in own]) for columns, own in forces)


def _scatter(problem: ClosedLoopProblem, J: FloatArray, errors: Sequence[FloatArray]) -> FloatArray:
    """Covariance of free parameters, (free, free), from noisy runs or one spectrum."""
    if len(errors) == 1:
        return Influence(J, problem.filter(errors[0])).stationary().matrix
    norms = column_norms(J)
    inverse = np.linalg.pinv((J / norms).T @ (J / norms))
    weights = (J / norms) @ inverse.T / norms  # (rows, free): what an error of the torque does to each parameter
    moved = np.array([problem.filter(one) @ weights for one in errors]).reshape(-1, J.shape[1])
    return np.asarray(moved.T @ moved / max(len(moved), 1))


def _draw_errors(problem: ClosedLoopProblem, x: FloatArray, noise: Noise, runs: int, seed: int) -> list[FloatArray]:
    """Draw the raw torque noise of each run, (samples,); none without noise."""
    if noise.log == noise.force == 0.0:
        return []
    experiment, quiet = problem.axis, problem.torque(x)

    def error(number: int) -> FloatArray:
        rng = np.random.default_rng([seed, number])
        added = noise.log * rng.standard_normal(quiet.size)
        if noise.force > 0:
            force = noise.force * rng.standard_normal(experiment.after_limit.size)
            forced = experiment.push(force)
            run = problem.torque(x, lambda _: forced)
            # The log shows what the loop does about the force, and not the force itself.
            added = added + run - quiet - to_log(experiment, forced.shown - experiment.shown)
        return added

    return in_threads(error, range(runs))
