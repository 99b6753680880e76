"""Tests of a joint: what each tells and reaches, at the rough joint and at others of its interval.

The search uses a few joints, and the best test is then predicted at many more, so that none exceeds a limit.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.parameters import POSITION_UNIT, Parameter, Quantity
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.limits import AxisLimits, describe_excess, find_excess, units_of_limits
from jointid.planning.designed import DesignedAxis
from jointid.planning.floor import Floor, least_deviation
from jointid.planning.goals import Goal, parse_goal
from jointid.planning.plans import Family, Plan, Room, families_in, positions, torques
from jointid.planning.predict import RUNS, Noise, PredictedTest, planned_record, predict_joints, reach
from jointid.planning.search import MARGIN, Tried, judge
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel, InjectionPoint, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering

_JOINTS = 2  # of the interval, beside the one that is roughly known, in the search
_MORE_JOINTS = 20  # of the interval, at which the result is predicted
_LEAST = 0.2  # of an inertia or a stiffness that is drawn: less is no joint that was identified
_TELLS_MORE = 0.95  # of a deviation
_NEEDED = ("stroke", "speed", "acceleration", "torque")
_MORE = {"speed": 2.0, "acceleration": 2.0}  # of the present test's, in the place of limits that are not given
_OF_TRAVEL = 1e-6  # of the commanded travel: the step assumed of an unknown encoder


@dataclass(frozen=True, slots=True, eq=False)
class JointTests:
    """The search problem of a joint.

    Attributes:
        joints: values of every parameter, one mapping a joint that it may be; first the one that is roughly known.
        disturbance: of every test.
        goal: what the test is to tell.
        tap: where its torque will be logged.
        limits: that it keeps.
        room: ranges of the families; None where nothing is searched.
        at, in_torque: where a signal is added, and whether the log contains it, see `Injection`.
        injection: whether the drive can add a signal.
        given: the limits that were stated; the others are those of the present test.
        before: what the present test reaches; None without one.
        floor: of the goal; None where it is not known.
    """

    loop: ClosedLoop
    joints: tuple[Mapping[str, float], ...]
    disturbance: Noise
    goal: Goal
    samples: int
    sample_time: float
    tap: Tap
    filtering: Filtering
    parameters: Mapping[str, Parameter]
    limits: AxisLimits
    room: Room | None
    at: InjectionPoint = InjectionPoint.AFTER_LIMIT
    in_torque: bool = True
    injection: bool = True
    present: Record | None = None
    given: AxisLimits = field(default_factory=AxisLimits)
    before: Mapping[str, float] | None = None
    floor: Floor | None = None

    @property
    def families(self) -> tuple[Family, ...]:
        """Families to search."""
        assert self.room is not None
        return families_in(self.room, injection=self.injection)

    def plan(self, family: Family, u: Sequence[float]) -> Plan:
        """Return a family's test for numbers between 0 and 1."""
        assert self.room is not None
        return family.plan(u, self.room)

    @property
    def rough(self) -> JointTests:
        """The same at few joints, for the search."""
        return replace(self, joints=self.joints[: 1 + _JOINTS])

    @property
    def begin(self) -> tuple[Plan, ...]:
        """The present test as a first candidate, if it has the log's sample time and keeps the positions."""
        if self.present is None or find_excess(self.limits, _positions(self.present)):
            return ()
        reference, injected = self.present.reference, self.present.injected
        assert reference is not None
        rates = {reference.sample_time, *([] if injected is None else [injected.channel.sample_time])}
        if rates != {self.sample_time} or (injected is not None and not self.injection):
            return ()
        return (_plan_of(self.present),)

    def record(self, plan: Plan, times: int = 1) -> tuple[Record, ...]:
        """Return a test as a record for the drive, several times as long."""
        reference, injected = plan.play(times * self.samples, self.sample_time)
        how = {"at": self.at, "in_torque": self.in_torque, "tap": self.tap}
        return (planned_record(self.loop, reference, self.sample_time, injected, **how),)  # type: ignore[arg-type]

    def describe(self, plan: Plan) -> str:
        """Return a test in words."""
        joint = self.loop.joint
        return plan.describe(POSITION_UNIT[joint.kind], joint.force_unit)

    def try_plan(self, plan: Plan, *, margin: float = MARGIN, than: Tried | None = None) -> Tried:
        """Judge a test at every joint."""
        return self._judge(plan, self.record(plan)[0], margin, than)

    def take(self, motion: Sequence[Record]) -> Tried:
        """Judge a test of one's own, or a past record."""
        (test,) = motion
        return self._judge(_plan_of(test), self._with_torque(test))

    def _judge(self, plan: Plan, test: Record, margin: float = 1.0, than: Tried | None = None) -> Tried:
        each = self._predict(test, self.joints, runs=1)
        return judge(plan, each, len(self.joints), self.goal, (self.limits,), margin=margin, than=than)

    def _with_torque(self, test: Record) -> Record:
        """Return a test as one whose log has the torque's rate."""
        if test.torque is not None:
            return test
        zeros = np.zeros(math.floor(test.duration / self.sample_time + 1e-9))
        return replace(test, torque=Channel(zeros, self.loop.joint.force_unit, self.sample_time, Timing.HELD))

    def _predict(
        self,
        test: Record,
        joints: Sequence[Mapping[str, float]],
        encoders: tuple[float | None, float | None] = (None, None),
        runs: int = RUNS,
    ) -> Iterator[PredictedTest]:
        return predict_joints(
            self.loop, joints, test, self.disturbance, filtering=self.filtering, parameters=self.parameters,
            encoders=encoders, runs=runs,
        )  # fmt: skip

    def predict(self, test: Sequence[Record], plan: Plan | None = None) -> dict[str, PredictedTest]:
        """Predict the present test, a new one, the new one with encoders and, of a plan, for twice the time."""
        (record,), known, found = map(self._with_torque, test), self.joints[:1], dict[str, PredictedTest]()
        if self.present is not None:
            with contextlib.suppress(JointidError):  # one that does not tell every parameter
                (found["present"],) = self._predict(self.present, known)
        (found["proposed"],) = self._predict(record, known)
        logged = self.present or record
        assert logged.reference is not None
        step = _OF_TRAVEL * (float(np.ptp(logged.reference.values)) or 1.0)
        motor = find_encoder_step(logged.motor_position) or step
        (on_motor,) = self._predict(record, known, (motor, None))
        if any(on_motor.std[name] < _TELLS_MORE * std for name, std in found["proposed"].std.items()):
            found["with motor encoder"] = on_motor
        if isinstance(self.loop.joint, FlexibleJoint):
            load = find_encoder_step(logged.load_position) or motor
            (found["with load encoder"],) = self._predict(record, known, (None, load))
        if plan is not None:
            (found["twice the time"],) = self._predict(self.record(plan, 2)[0], known)
        return found

    def axes(self, test: Sequence[Record], tried: Tried, proposed: PredictedTest) -> tuple[DesignedAxis, ...]:
        """Return the loads of the axis in the test."""
        (record,), joint = test, self.loop.joint
        units = units_of_limits(q := POSITION_UNIT[joint.kind], joint.force_unit)
        return (
            DesignedAxis(
                "", record, proposed.torques[0], proposed.sample_time, q, joint.force_unit, joint.transmission,
                self.limits,
                tuple(name for name in self.limits.given if name not in self.given.given),
                {**_positions(record), **tried.reached[0]},
                tuple(describe_excess(self.given, self.before or {}, units)),
                FlexibleJoint.frequencies(self.joints[0]) if isinstance(joint, FlexibleJoint) else {},
            ),
        )  # fmt: skip

    @property
    def noise(self) -> str:
        """The noise in words."""
        noise, unit = self.disturbance, self.loop.joint.force_unit
        parts = [] if noise.left is None else ["the residual of the present test"]
        parts += [f"white, {noise.log:.3g} {unit} on the log"] if noise.log else []
        return " and ".join([*parts, *([f"a white force of {noise.force:.3g} {unit}"] if noise.force else [])])


def joint_tests(
    loop: ClosedLoop,
    values: Mapping[str, float],
    noise: Noise,
    *,
    goal: str,
    limits: AxisLimits,
    samples: int,
    sample_time: float,
    present: Record | None,
    covariance: FloatArray | None,
    within: float | None,
    filtering: Filtering,
    parameters: Mapping[str, Parameter],
    injection: bool,
    seed: int,
    searched: bool,
) -> JointTests:
    """Pose the tests of a joint whose values are roughly known; see `jointid.design`.

    `present` is the test there is already, `within` the percent that each value may be off, in the place of the
    `covariance` of the free parameters, `searched` whether limits are needed for a search.
    """
    free = [p for p in (parameters.get(p.name, p) for p in loop.joint.parameters) if p.free]
    wanted = parse_goal(goal, {p.name: loop.joint.unit(p) for p in free})
    if within is not None:
        covariance = np.diag([(0.005 * within * values[p.name]) ** 2 for p in free])
    joints = (dict(values), *_draw(values, free, covariance, _MORE_JOINTS, seed))
    tap = Tap.COMMAND if present is None else present.tap
    common = loop, joints, noise, wanted, samples, sample_time, tap, filtering, parameters
    if not searched:
        return JointTests(*common, limits, None, present=present, given=limits)
    before = None if present is None else reach(loop, values, present, noise, filtering, parameters)
    whole = _complete(limits, before)
    resolved = filtering.resolve(sample_time, loop.joint.model)
    assert resolved.cutoff is not None
    highest = min(whole.highest or resolved.cutoff, resolved.cutoff)
    floor = least_deviation(loop, values, noise, wanted, whole, samples, sample_time, highest)
    flexible = isinstance(loop.joint, FlexibleJoint)
    mode = FlexibleJoint.frequencies(values)["free_free"] if flexible else 0.5 * highest
    sizes = {name: _MORE.get(name, 1.0) * size for name, size in (before or {}).items()} | whole.given
    room = Room(
        **{name: sizes[name] for name in _NEEDED}, jerk=whole.jerk, low=_lowest(whole, sizes["stroke"], present),
        lowest=min(whole.lowest, highest), highest=highest, mode=min(mode, 0.9 * highest),
        lines=() if floor is None else floor.lines,
    )  # fmt: skip
    added = None if present is None else present.injected
    how = (InjectionPoint.AFTER_LIMIT, True) if added is None else (added.at, added.in_torque)
    return JointTests(*common, whole, room, *how, injection, present, limits, before, floor)


def _plan_of(test: Record) -> Plan:
    """Return a record as a plan: its tables of positions and of what is added."""
    if test.reference is None:
        raise MethodError("A test of your own has a reference; give the position that the axis is to follow.")
    added = None if test.injected is None else torques(test.injected.channel.values)
    return Plan(positions(test.reference.values), added)


def _positions(test: Record) -> dict[str, float]:
    """Extreme positions of a test's reference."""
    assert test.reference is not None
    return {"lower": float(test.reference.values.min()), "upper": float(test.reference.values.max())}


def _complete(limits: AxisLimits, before: Mapping[str, float] | None) -> AxisLimits:
    """Complete the limits from what the present test reaches."""
    missing = [name for name in _NEEDED if name not in limits.given]
    if before is None and missing:
        raise MethodError(
            f"Without a test there is already, a search needs limits of {', '.join(_NEEDED)}; give those of "
            f"{', '.join(missing)}, too."
        )
    kept = ("stroke", "torque", "rms_torque")
    return replace(limits, **{n: size for n, size in (before or {}).items() if n in kept and n not in limits.given})


def _lowest(limits: AxisLimits, stroke: float, present: Record | None) -> float:
    """Return the end of the stroke from which it is reckoned; without positions the middle is the present test's."""
    if limits.lower is not None:
        return limits.lower
    if limits.upper is not None:
        return limits.upper - stroke
    seen = {"lower": 0.0, "upper": 0.0} if present is None else _positions(present)
    return 0.5 * (seen["lower"] + seen["upper"] - stroke)


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
