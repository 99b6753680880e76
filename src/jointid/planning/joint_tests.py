"""Tests of a joint: what each tells and reaches, at the rough joint and at others of its interval.

A test is simulated with noise at several joints; its objective is the mean, its maxima the largest. The search uses a
few joints, and the best test is then simulated at many more, so that none exceeds a limit.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.parameters import POSITION_UNIT, Parameter, Quantity
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.limits import AxisLimits, describe_excess, find_excess, units_of_limits
from jointid.planning.designed import DesignedAxis
from jointid.planning.encoders import choose_encoder_steps
from jointid.planning.goals import Goal, parse_goal
from jointid.planning.plans import Family, Plan, Room, families_in, positions, torques
from jointid.planning.predict import (
    Noise,
    PredictedTest,
    RoughPrediction,
    planned_record,
    predict_roughly,
    predict_test,
    reach,
)
from jointid.planning.search import ASTRAY, MARGIN, Tried, largest, worst_excess
from jointid.records.record import Channel, InjectionPoint, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering

_JOINTS = 2  # of the interval, beside the one that is roughly known, in the search
_MORE_JOINTS = 20  # of the interval, at which the result is simulated
_LEAST = 0.2  # of an inertia or a stiffness that is drawn: less is no joint that was identified
_TELLS_MORE = 0.95  # of a deviation
_CLEARLY = 0.02  # of a score: other joints change it by as much
_NEEDED = ("stroke", "speed", "acceleration", "torque")
_MORE = {"speed": 2.0, "acceleration": 2.0}


@dataclass(frozen=True, slots=True, eq=False)
class JointTests:
    """The search problem of a joint.

    Attributes:
        joints: values of every parameter, one mapping a joint that it may be; first the one that is roughly known.
        goal: what the test is to tell.
        tap: where its torque will be logged.
        limits: that it keeps.
        room: ranges of the families; None where nothing is searched.
        at, in_torque: where a signal is added, and whether the log contains it, see `Injection`.
        injection: whether the drive can add a signal.
        given: the limits that were stated; the others are those of the present test.
        before: what the present test reaches; None without one.
        floor: of the goal; None where it is not known.
        encoder: steps of the encoders that are predicted beside the test, m or rad.
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
    encoder: float | None = None

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

    def record(self, plan: Plan, samples: int | None = None) -> tuple[Record, ...]:
        """Return a test as a record for the drive."""
        reference, injected = plan.play(samples or self.samples, self.sample_time)
        return (
            planned_record(
                self.loop, reference, self.sample_time, injected, at=self.at, in_torque=self.in_torque, tap=self.tap
            ),
        )

    def longer(self, plan: Plan) -> tuple[Record, ...] | None:
        """Return the test for twice the time."""
        return self.record(plan, 2 * self.samples)

    def describe(self, plan: Plan) -> str:
        """Return a test in words."""
        joint = self.loop.joint
        return plan.describe(POSITION_UNIT[joint.kind], joint.force_unit)

    def try_plan(self, plan: Plan, *, margin: float = MARGIN, than: Tried | None = None) -> Tried:
        """Evaluate a test at every joint; if it clearly loses at the first one, the others are skipped."""
        (test,) = self.record(plan)
        scores, most = [], tuple[Mapping[str, float], ...]()
        tried = Tried(plan, ASTRAY, ({},), math.inf)
        predictions = self._predict_roughly(test)
        for values in self.joints:
            try:
                with np.errstate(all="ignore"):
                    one = next(predictions)
            except (JointidError, np.linalg.LinAlgError):
                return replace(tried, score=ASTRAY, over=math.inf)
            scores.append(self.goal.score(one.covariance, one.names, values))
            most = largest([most or ({},), (one.reached,)])
            tried = Tried(plan, float(np.mean(scores)), most, worst_excess((self.limits,), most, margin))
            if than is not None and tried.rank > (than.rank[0], than.score + _CLEARLY):
                break
        return tried

    def take(self, motion: Sequence[Record]) -> Tried:
        """Evaluate a test of one's own, or a past record."""
        (test,) = motion
        if test.reference is None:
            raise MethodError("A test of your own has a reference; give the position that the axis is to follow.")
        each = self._predict_roughly(self._with_torque(test))
        return Tried(_plan_of(test), 0.0, largest((one.reached,) for one in each), 0.0)

    def find_deviations(self, test: Sequence[Record]) -> list[FloatArray]:
        """Return the deviations of the parameters in a test at each joint of the interval, the known one first."""
        if len(self.joints) == 1:
            return []
        each = self._predict_roughly(self._with_torque(*test))
        found = [np.sqrt(np.diag(next(each).covariance))]
        try:
            found.extend(np.sqrt(np.diag(one.covariance)) for one in each)
        except JointidError:  # of one of them nothing is known
            found.append(np.full_like(found[0], np.inf))
        return found

    @property
    def assumed(self) -> bool:
        """Whether the noise is a guess: it is stated, or that of a record."""
        return False

    @property
    def doubts(self) -> tuple[str, ...]:
        """Clauses on what is not known: none, since every value is given."""
        return ()

    def _with_torque(self, test: Record) -> Record:
        """Return a test as one whose log has the torque's rate."""
        if test.torque is not None:
            return test
        zeros = np.zeros(math.floor(test.duration / self.sample_time + 1e-9))
        return replace(test, torque=Channel(zeros, self.loop.joint.force_unit, self.sample_time, Timing.HELD))

    def _predict_roughly(self, test: Record) -> Iterator[RoughPrediction]:
        return predict_roughly(
            self.loop, self.joints, test, self.disturbance, filtering=self.filtering, parameters=self.parameters
        )

    def _predict(
        self, test: Record, motor_encoder: float | None = None, load_encoder: float | None = None
    ) -> PredictedTest:
        return predict_test(
            self.loop, self.joints[0], test, self.disturbance, filtering=self.filtering, parameters=self.parameters,
            motor_encoder=motor_encoder, load_encoder=load_encoder,
        )  # fmt: skip

    def predict(self, test: Sequence[Record], longer: Sequence[Record] | None) -> dict[str, PredictedTest]:
        """Predict the present test, a new one, and the new one with encoders and for twice the time."""
        (record,), found = map(self._with_torque, test), dict[str, PredictedTest]()
        if self.present is not None:
            with contextlib.suppress(JointidError):  # one that does not tell every parameter
                found["present"] = self._predict(self.present)
        found["proposed"] = proposed = self._predict(record)
        motor, load = choose_encoder_steps(record if self.present is None else self.present, self.encoder)
        on_motor = self._predict(record, motor_encoder=motor)
        if any(on_motor.std[name] < _TELLS_MORE * std for name, std in proposed.std.items()):
            found["with motor encoder"] = on_motor
        if isinstance(self.loop.joint, FlexibleJoint):
            found["with load encoder"] = self._predict(record, load_encoder=load)
        if longer is not None:
            found["twice the time"] = self._predict(longer[0])
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

    @property
    def least(self) -> float | None:
        """Standard deviation of the goal below which no motion comes; None where it is not known."""
        return None if self.floor is None or math.isnan(self.floor.deviation) else self.floor.deviation


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
    tap: Tap,
    filtering: Filtering,
    parameters: Mapping[str, Parameter],
    encoder: float | None,
    injection: bool,
    seed: int,
    searched: bool,
) -> JointTests:
    """Pose the tests of a joint whose values are roughly known; see `jointid.design`.

    `present` is the test there is already, `within` the percent that each value may be off, in the place of the
    `covariance`, `searched` whether limits are needed for a search.
    """
    free = [p for p in (parameters.get(p.name, p) for p in loop.joint.parameters) if p.free]
    wanted = parse_goal(goal, {p.name: loop.joint.unit(p) for p in free})
    if within is not None:
        covariance = np.diag([(0.005 * within * values[p.name]) ** 2 for p in free])
    draws = _draw(values, free, covariance, _MORE_JOINTS, seed)
    common = loop, (dict(values), *draws), noise, wanted, samples, sample_time, tap, filtering, parameters
    if not searched:
        return JointTests(*common, limits, None, present=present, given=limits, encoder=encoder)
    before = None if present is None else reach(loop, values, present, noise, filtering, parameters)
    whole, found = _complete(limits, before)
    resolved = filtering.resolve(sample_time, loop.joint.model)
    assert resolved.cutoff is not None
    highest = min(whole.highest or resolved.cutoff, resolved.cutoff)
    floor = _floor(loop, values, noise, wanted, whole, samples, sample_time, highest)
    flexible = isinstance(loop.joint, FlexibleJoint)
    mode = FlexibleJoint.frequencies(values)["free_free"] if flexible else 0.5 * highest
    # Twice the speed and acceleration of the present test take the place of limits that are not given.
    sizes = {name: whole.given.get(name, _MORE.get(name, 1.0) * found[name]) for name in _NEEDED}
    seen = np.zeros(1) if present is None or present.reference is None else present.reference.values
    low = 0.5 * float(seen.min() + seen.max() - sizes["stroke"])
    if whole.lower is not None or whole.upper is not None:
        low = whole.lower if whole.lower is not None else whole.stated["upper"] - sizes["stroke"]
    lines = () if floor is None else floor.lines
    lowest, mode = min(whole.lowest, highest), min(mode, 0.9 * highest)
    room = Room(**sizes, jerk=whole.jerk, low=low, lowest=lowest, highest=highest, mode=mode, lines=lines)
    added = None if present is None else present.injected
    how = (InjectionPoint.AFTER_LIMIT, True) if added is None else (added.at, added.in_torque)
    return JointTests(*common, whole, room, *how, injection, present, limits, before, floor, encoder)


def _plan_of(test: Record) -> Plan:
    """Return a record as a plan: its tables of positions and of what is added."""
    assert test.reference is not None
    added = None if test.injected is None else torques(test.injected.channel.values)
    return Plan(positions(test.reference.values), added)


def _positions(test: Record) -> dict[str, float]:
    """Extreme positions of a test's reference."""
    assert test.reference is not None
    return {"lower": float(test.reference.values.min()), "upper": float(test.reference.values.max())}


def _complete(limits: AxisLimits, before: Mapping[str, float] | None) -> tuple[AxisLimits, dict[str, float]]:
    """Complete the limits from the present test, and return its maxima."""
    if before is None:
        missing = [name for name in _NEEDED if name not in limits.given]
        if missing:
            raise MethodError(
                f"Without a test there is already, a search needs limits of {', '.join(_NEEDED)}; "
                f"{', '.join(missing)} {'are' if len(missing) > 1 else 'is'} missing: give them."
            )
        return limits, {name: limits.given[name] for name in _NEEDED}
    taken = {name: before[name] for name in ("stroke", "torque", "rms_torque") if name not in limits.given}
    return replace(limits, **taken), dict(before)


def _floor(
    loop: ClosedLoop, values: Mapping[str, float], noise: Noise, goal: Goal, limits: AxisLimits, samples: int,
    sample_time: float, cutoff: float,
) -> Floor | None:  # fmt: skip
    """Lower bound of a goal; white noise of equal size replaces a first record's."""
    known = noise.left is None
    size = 1.0 if noise.left is None else float(np.sqrt(np.mean(noise.left**2)))
    asked = goal if goal.weights else Goal("stiffness", {"stiffness": 1.0})
    try:
        floor = least_deviation(
            loop, values, noise if known else Noise(force=size), asked, limits, samples=samples,
            sample_time=sample_time, cutoff=cutoff,
        )  # fmt: skip
    except MethodError:
        return None
    return floor if known and goal.weights else replace(floor, deviation=math.nan)


def _draw(
    values: Mapping[str, float], free: Sequence[Parameter], covariance: FloatArray | None, count: int, seed: int
) -> list[dict[str, float]]:
    """Draw joints from the interval, within the parameters' bounds, if known."""
    if covariance is None:
        return []
    rng = np.random.default_rng([seed, 1])
    moved = rng.multivariate_normal(np.zeros(len(free)), covariance, size=count, method="eigh")
    drawn = []
    for row in moved:
        one = dict(values)
        for p, by in zip(free, map(float, row), strict=True):
            least = _LEAST * values[p.name] if p.quantity in (Quantity.INERTIA, Quantity.STIFFNESS) else p.lower
            one[p.name] = min(max(values[p.name] + by, least), p.upper)
        drawn.append(one)
    return drawn


_LINES = 120  # frequencies
_STEP = 1e-6  # relative, of the differences by which P is differentiated
_PARAMETERS = ("motor_inertia", "motor_viscous", "stiffness", "damping", "load_inertia", "load_viscous")
_STEPS = 400  # of the search for the powers
_LEFT = 0.1  # of a signal that is injected, at least
_CLOSE = 0.08  # of the logarithm of a frequency
_OF_ALL = 0.02  # of the power: frequencies with less matter little

Complexes: TypeAlias = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The least deviation over all motions, and the optimal force powers.

    Attributes:
        hertz, power: (frequencies,) of the force that acts, and its mean square at each.
        sensitivity: (frequencies,) size of S: so much of a signal that is injected is left of it in the force.
    """

    deviation: float
    hertz: FloatArray
    power: FloatArray
    sensitivity: FloatArray

    @property
    def lines(self) -> tuple[tuple[float, float], ...]:
        """Dominant frequencies, Hz, with amplitudes to inject relative to the largest.

        Neighbouring frequencies are merged. The reference has to compensate for the loop.
        """
        left = np.where(self.sensitivity > _LEFT, self.power, 0.0)
        found = []
        while left.max() > _OF_ALL * np.sum(self.power):
            strongest = self.hertz[int(np.argmax(left))]
            near = np.abs(np.log(self.hertz / strongest)) < _CLOSE
            middle = float(np.exp(np.average(np.log(self.hertz[near]), weights=left[near])))
            found.append((middle, math.sqrt(float(np.sum(left[near] / self.sensitivity[near] ** 2)))))
            left = np.where(near, 0.0, left)
        found.sort()
        largest = max((size for _, size in found), default=1.0)
        return tuple((f, size / largest) for f, size in found)


def least_deviation(
    loop: ClosedLoop,
    values: Mapping[str, float],
    noise: Noise,
    goal: Goal,
    limits: AxisLimits,
    *,
    samples: int,
    sample_time: float,
    cutoff: float,
) -> Floor:
    """Lower bound of a goal's standard deviation for tests of a flexible joint.

    A sliding flexible joint is linear, so information adds up over frequencies. With P the response of the motor's
    position to the force on it, H the controller's torque per position, S = 1 / (1 + P H exp(-s d)) and F the force,
    the torque's derivative by a parameter is ``-H S dP/dp F``, and the information is::

        M = N sum_f |F(f)|^2 Re(g* g') / s(f),       g = H S dP/dp

    with N samples and the noise's spectrum s(f): of the log ``log^2``, of a force ``force^2 |H P S|^2``. The variance
    of a combination w, ``w' M^-1 w``, is convex in the powers ``|F|^2``. Constraints are the torque's mean square and
    half of the stroke. The bound is optimistic: friction is known, the joint never sticks, all frequencies up to the
    cut-off are free, and torque peaks are not limited. Coulomb friction takes ``(Fc1 + Fc2)^2`` of the mean square
    torque, which holds for a moving axis, not for one that rests or rings about a stop.

    Args:
        loop: joint and controller.
        values: every parameter of the joint by name.
        noise: of the log, or of a force; not that of a first record.
        goal: a linear parameter, or a combination of them.
        limits: of torque (rms) and stroke.
        samples: of the test.
        sample_time: of its log, s.
        cutoff: of the filter, Hz.
    """
    power = limits.rms_torque or limits.torque
    if not isinstance(loop.joint, FlexibleJoint) or any(name not in values for name in _PARAMETERS):
        raise MethodError("The bound is that of a flexible joint with symmetric friction and a linear spring.")
    if power is None or not goal.weights.keys() <= set(_PARAMETERS) or not goal.weights:
        raise MethodError(
            f"A bound needs the torque limited, and a goal of {', '.join(_PARAMETERS)}; received {goal.name}."
        )
    if noise.left is not None:
        raise MethodError("A bound needs the noise as white noise of the log or of a force; state it.")
    hertz = np.geomspace(limits.lowest, cutoff, _LINES)
    law = loop.controller.law(sample_time)
    s = 2j * math.pi * hertz
    H = -law.feedback(hertz)
    P = _position(values, s)
    S = 1 / (1 + P * H * np.exp(-s * (law.delay + 0.5 * law.period)))
    slopes = np.array([_slope(values, name, s) for name in _PARAMETERS])
    g = H * S * slopes
    spectrum = noise.log**2 + noise.force**2 * np.abs(H * P * S) ** 2
    information = samples * np.real(np.conj(g)[:, np.newaxis] * g[np.newaxis]) / spectrum  # (parameters, parameters, f)
    friction = values["motor_coulomb"] + values["load_coulomb"]
    if power <= friction:
        raise MethodError(
            f"A torque of {power:g} does not move the joint against a friction of {friction:g}; allow more."
        )
    most, square = power**2 - friction**2, np.abs(P) ** 2
    allowed = np.vstack([np.full(hertz.size, 1 / most), square / (0.5 * limits.given.get("stroke", math.inf)) ** 2])
    w = np.array([goal.weights.get(name, 0.0) for name in _PARAMETERS])
    variance, found = _least_variance(information, allowed, w)
    return Floor(math.sqrt(variance), hertz, found, np.abs(S))


def _position(values: Mapping[str, float], s: Complexes) -> Complexes:
    """Return the motor's position per force on it, sliding."""
    spring = values["stiffness"] + values["damping"] * s
    motor = values["motor_inertia"] * s**2 + values["motor_viscous"] * s + spring
    load = values["load_inertia"] * s**2 + values["load_viscous"] * s + spring
    return np.asarray(load / (motor * load - spring**2))


def _slope(values: Mapping[str, float], name: str, s: Complexes) -> Complexes:
    step = _STEP * (abs(values[name]) or 1.0)
    high, low = (_position({**values, name: values[name] + by}, s) for by in (step, -step))
    return (high - low) / (2 * step)


def _least_variance(information: FloatArray, allowed: FloatArray, w: FloatArray) -> tuple[float, FloatArray]:
    """Minimise ``w' M^-1 w`` over powers with sums, by the rows of `allowed`, up to 1.

    S. D. Silvey's multiplicative rule: scale each power by the root of its gain, then normalise to the active
    constraint.
    """
    sizes = np.sqrt(np.maximum(np.diag(np.sum(information, axis=2)), 1e-300))
    information = information / np.outer(sizes, sizes)[:, :, np.newaxis]
    w = w / sizes
    power = np.full(information.shape[2], 1.0)
    best, kept = math.inf, power
    price = np.array([1.0, 0.0])
    for _ in range(_STEPS):
        power = power / max(float(np.max(allowed @ power)), 1e-300)
        M = information @ power
        solved = np.linalg.lstsq(M, w, rcond=1e-14)[0]
        variance = float(w @ solved)
        if variance < best:
            best, kept = variance, power
        gain = np.einsum("i,ijf,j->f", solved, information, solved)
        used = allowed @ power
        # What binds costs; the price moves until both are used up, or one is not needed.
        price = np.maximum(price * np.exp(0.5 * (used - 1.0)), 1e-6)
        price = price / price.sum()
        power = power * np.sqrt(np.maximum(gain, 0.0) / np.maximum(price @ allowed, 1e-300))
    return best, kept
