"""Laws that a drive may run instead of the declared one, with the same settings.

An integral sums the errors of earlier periods, or also that of the present one; manuals seldom say which. With the
present one a PI of 1 kHz and 20 ms is 5 % stiffer, and a stiffness that is identified under the other law is wrong by
6 % without a worse fit. A law whose velocity comes from a sensor or an observer is the same half a period earlier.

Without a declared period that of the log is used. A faster drive reacts earlier, by up to half a sample of the log, and
the identified joint is another one. A drive that is faster than its reference holds it, draws lines through it, or
cubics. It may also see its reference late, or average it over a time, which makes it later by half of that; so the time
follows from the delay that fits.

Each law is screened first: one simulation under it at the same joint shows what it changes. Two laws are distinguished
by a J test (Davidson and MacKinnon, Econometrica 49, 1981): the joint is identified again under the other law, and the
residual is regressed on the change of the fit. The coefficient is 0 under the declared law and 1 under the other one. A
record may exclude neither. So all laws that it allows are compared, and the likeliest is chosen; of equals the
plainest. One that moves a parameter out of its interval without being excluded is undecided.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, FaultTest
from jointid.diagnostics.faults.findings import AxisFaults, Finding, OtherLaw
from jointid.diagnostics.faults.numbers import DELAY, LOG_DELAY, LOG_GAIN, REFERENCE_DELAY
from jointid.diagnostics.faults.words import state_periods
from jointid.diagnostics.model_free import LawOnPosition, excludes
from jointid.diagnostics.search_state import INTERVAL, RIVAL, Tested
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import PD, PID, Cascade, Controller, numbers_of, with_numbers, with_present_sample
from jointid.models.controllers.servo_base import DiagramController, Interpolation
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.resampling import default_interpolation

TIMES_FASTER = (2, 4, 8)
"""Than the log: at these rates a drive may run whose period is not declared."""
_UNDECIDED = (2, 8)  # without evidence for any: higher rates change hardly more
_SLOWER = 1.5  # times the controller's period: a reference of such a sample time is filled in
_SOLVED = 1e-6  # far below a deviation
_WAYS: tuple[Interpolation, ...] = ("hold", "linear", "cubic")
_SCREENED = 4  # samples of the log: of a mean that shows whether the reference is late
_PASSES = 3  # in which the time of a delay or a mean is found
_NEARLY = 0.5  # periods
_HALF_A_PERIOD_EARLIER = (1.5, -0.5)  # of a difference of positions, which is the velocity half a period ago
_EXCLUDED = 2.0  # deviations: a law so far away is excluded
_BETWEEN_RATES = 0.2  # of what a faster law changes: so much less is still a rate next to it
_AT_LEAST = 0.6  # of a change, by one step: less shows that the drive runs no such law
_REACH = 2.0  # times what half of the log's period changes any faster drive changes
_MATTERS = 1.5  # deviations: a law that moves no parameter so far by one step is not searched for
_AT_MOST = 0.5  # of a declared number: what a larger change of it shows is seen at this one


# What may be other


_DONE: dict[Interpolation, str] = {"hold": "held", "linear": "interpolated by lines", "cubic": "interpolated by cubics"}
PRESENT_SAMPLE = Fault("present_sample", "integral that takes in the present sample",
                       "an integral that takes in the present sample")  # fmt: skip
MEASURED_VELOCITY = Fault("measured_velocity", "velocity that is no difference of positions")
PERIOD = Fault("period", "period of the controller", "the period of the controller")
INTERPOLATIONS: dict[Interpolation, Fault] = {
    way: Fault(f"{name}_reference", f"reference {_DONE[way]} between its samples")
    for way, name in zip(_WAYS, ("held", "linear", "cubic"), strict=True)
}
AVERAGED = Fault("averaged_reference", "reference averaged by the drive", "an averaged reference")
LATE = REFERENCE_DELAY
_OF_REFERENCE = (LATE, AVERAGED, *INTERPOLATIONS.values())
OTHER_LAWS = tuple(one.name for one in (PRESENT_SAMPLE, MEASURED_VELOCITY, PERIOD, *_OF_REFERENCE))
"""Their names."""
_OPEN = (PRESENT_SAMPLE, PERIOD, *INTERPOLATIONS.values())  # those that are said where a record does not exclude them


class Refit(NamedTuple):
    """A solved problem under another law, and (free,) its solution."""

    law: OtherLaw
    problem: ClosedLoopProblem
    x: FloatArray


class Family(NamedTuple):
    """Laws of one kind.

    Attributes:
        fault: that they are.
        screen: one of them: what it changes shows whether the record can tell.
        solve: yields them with the problem solved again, given whether the screen is evident.
        evident: whether they are searched for only then.
    """

    fault: Fault
    screen: Any
    solve: Callable[[bool], Iterator[Refit]]
    evident: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Variants:
    """The laws that a drive may run in the place of that of a solved problem.

    Attributes:
        problem: of a joint's loop.
        x: (free,) its solution.
        record: whose reference the controller reads.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    record: Record

    @property
    def _law(self) -> Any:
        return self.problem.loop.controller

    @property
    def _period(self) -> float:
        return float(self.problem.experiment.law.period)

    def every(self) -> Iterator[Family]:
        """Yield what a drive may do with its reference, with position and velocity, and at which rate.

        The plainest of each kind comes first. Cubics matter to a law that differentiates the reference: from lines it
        gets the velocity half a sample late.
        """
        law, log = self._law, self.problem.sample_time
        for one in list_other_ways(law, self.record, self._period):
            filled = replace(law, interpolation=one)
            yield self._alone(OtherLaw(INTERPOLATIONS[one], say_way(one), f'interpolation = "{one}"', filled))
        if numbers_of(law).keys() & {p.name for p in self.problem.free}:
            return  # a free number may stand for any law
        if isinstance(law, DiagramController) and not law.reference_average:
            screen = replace(law, reference_average=_SCREENED * log)
            yield Family(AVERAGED, screen, lambda _: self._solve_late(), evident=True)
        for other in list_feedback_laws(law, self._period):
            yield self._alone(other)._replace(evident=other.fault != PRESENT_SAMPLE)
        if not isinstance(law, DiagramController) or law.period is not None:
            return
        assert self.record.reference is not None
        used, least = law.interpolation or default_interpolation(self.record.reference), log / TIMES_FASTER[0]
        ways = [None, *list_other_ways(replace(law, period=least), self.record, least)]
        for way in ways if _differentiates_reference(law) else [one for one in ways if one != "cubic"]:
            there = law if way is None else replace(law, interpolation=way)
            more = "" if way is None else f", with its reference {_DONE[way]}"
            laws = partial(self._solve_rates, there, more, way or used)
            yield Family(PERIOD, replace(there, period=least), laws, evident=way == "hold")  # no usual guess

    def _refit(self, law: OtherLaw, start: FloatArray | None = None) -> Refit:
        other = self.problem.under(law.controller, self.record)
        return Refit(law, other, descend(other, self.x if start is None else start, _SOLVED).x)

    def _alone(self, law: OtherLaw) -> Family:
        return Family(law.fault, law.controller, lambda _: iter([self._refit(law)]))

    def _solve_rates(self, law: Any, other: str, way: Interpolation, evident: bool) -> Iterator[Refit]:
        start = self.x
        for times in TIMES_FASTER if evident else _UNDECIDED:
            period = self.problem.sample_time / times
            words, remedy = state_periods([period])
            declared = f'{remedy}, and interpolation = "{way}"'
            faster = OtherLaw(PERIOD, words + other, declared, replace(law, period=period), 1 / period)
            refit = self._refit(faster, start)
            start = refit.x
            yield refit

    def _solve_late(self) -> Iterator[Refit]:
        """Yield the averaged reference, then the delayed one."""
        declared = self._law.reference_delay
        delayed = self.search_time(LATE, declared)
        late = time_of(delayed.law) - declared
        yield self.search_time(AVERAGED, 2 * late + self._period, delayed.x)
        yield delayed

    def search_time(self, way: Fault, time: float, start: FloatArray | None = None) -> Refit:
        """Return the delay, or the mean, of the reference that leaves it neither late nor early, from a first time."""
        times, least = (2.0, 2 * self._period) if way is AVERAGED else (1.0, self._law.reference_delay)
        for left in range(_PASSES, 0, -1):
            law = self._time_reference(way, max(time, least))
            refit = self._refit(law, start)
            start, step = refit.x, _find_delay_step(refit.problem, refit.x)
            time = time_of(law) + times * step
            if abs(step) < _NEARLY * self._period or left == 1 or time < least:
                break
        return refit

    def _time_reference(self, way: Fault, time: float) -> OtherLaw:
        if way is AVERAGED:
            mean = self._period * round(time / self._period)
            averaged = replace(self._law, reference_average=mean)
            return OtherLaw(AVERAGED, say_mean(mean), f"reference_average = {mean:.6g}", averaged)
        words = f"the law sees the reference {number(1e3 * time, 3)} ms late"
        return OtherLaw(LATE, words, f"reference_delay = {time:.4g}", replace(self._law, reference_delay=time))


def _find_delay_step(problem: ClosedLoopProblem, x: FloatArray) -> float:
    """Return by how much later the reference would have to be, s, by one step beside all parameters."""
    wider = problem.freeing(LATE.name)
    residual, slopes = wider.linearise(wider.vector(problem.values(x)))
    sizes = column_norms(slopes)
    at = [p.name for p in wider.free].index(LATE.name)
    return float((np.linalg.lstsq(-slopes / sizes, residual, rcond=None)[0] / sizes)[at])


def list_feedback_laws(controller: Controller, period: float) -> Iterator[OtherLaw]:
    """Yield the laws that a drive may run under the same settings, at the same rate."""
    if isinstance(controller, Cascade | PID) and controller.integral_gain:
        other, gain = with_present_sample(controller, period), "position_gain"
        if isinstance(controller, Cascade):
            gain = "velocity_gain"
        remedy = f"{gain} {number(100 * (getattr(other, gain) / getattr(controller, gain) - 1), 2)} % larger"
        if isinstance(controller, Cascade):
            remedy += f" and the integral time {number(1e3 * period, 3)} ms longer"
        yield OtherLaw(PRESENT_SAMPLE, "the integral takes in the present sample, too", remedy, other)
    if getattr(controller, "velocity_filter", None) == (1.0,):
        words = "the velocity is measured or observed, half a period earlier than a difference of positions"
        earlier: Any = replace(cast("Any", controller), velocity_filter=_HALF_A_PERIOD_EARLIER)
        yield OtherLaw(MEASURED_VELOCITY, words, f"velocity_filter = {list(_HALF_A_PERIOD_EARLIER)}", earlier)


def list_other_ways(controller: Any, record: Record, period: float) -> tuple[Interpolation, ...]:
    """Return the interpolations besides the one in use; none where one is declared."""
    assert record.reference is not None
    declared = getattr(controller, "interpolation", "none is possible")
    if declared is not None or record.reference.sample_time < _SLOWER * period:
        return ()
    used = default_interpolation(record.reference)
    return tuple(way for way in _WAYS if way != used)


def _differentiates_reference(controller: Any) -> bool:
    ahead = ("velocity_feedforward", "viscous_feedforward", "acceleration_feedforward")
    own = isinstance(controller, PD) and controller.reference_velocity == "difference"
    return own or any(getattr(controller, name, 0.0) for name in ahead)


def time_of(law: OtherLaw) -> float:
    """Return the time by which a drive delays or averages its reference, s."""
    controller: Any = law.controller
    return float(controller.reference_average if law.fault is AVERAGED else controller.reference_delay)


def say_way(way: Interpolation) -> str:
    """Return the clause on what a drive does between the samples of its reference."""
    return f"the reference is {_DONE[way]} between its samples"


def say_mean(mean: float) -> str:
    """Return the clause on a drive that averages its reference."""
    return f"the drive averages the reference over {number(1e3 * mean, 3)} ms"


# Their tests


@dataclass(frozen=True, slots=True, eq=False)
class LawTest:
    """Solution under another law, and its test: size 0 is the declared law, size 1 the other one.

    Attributes:
        gain: decrease of the squared norm of the residual from the declared law to this one.
    """

    refit: Refit
    test: FaultTest
    gain: float

    @property
    def possible(self) -> bool:
        """Whether the record does not exclude the other law, or a rate near it."""
        roughly = _BETWEEN_RATES if self.test.fault is PERIOD else 0.0
        return 1 - self.test.size <= max(_EXCLUDED * self.test.std, roughly)

    @property
    def likelihood(self) -> float:
        """Twice the logarithm of the likelihood ratio to the declared law."""
        return (2 * self.test.size - 1) / self.test.std**2

    def explains(self, found: Tested) -> bool:
        """Whether the record excludes the declared law, and no fault explains it better."""
        test = self.test
        if not self.possible or test.size <= 0 or test.p_value > found.level:
            return False
        return self.likelihood >= max((one.strength**2 for one in found.tests), default=0.0) - RIVAL

    def as_likely(self, others: Sequence[LawTest]) -> bool:
        """Whether none of others is far likelier.

        The residuals are compared by the variance of the likeliest law's test: each law has its own spectrum of the
        noise in its test, so two likelihoods differ even where two laws leave the same residual.
        """
        best = max(others, key=lambda one: one.likelihood)
        if self.likelihood >= best.likelihood - RIVAL:
            return True
        return best.gain > 0 and (best.gain - self.gain) * best.likelihood <= RIVAL * best.gain


def choose_law(explaining: Sequence[LawTest]) -> LawTest | None:
    """Return the likeliest law; of those that differ in what they make of the reference the one that leaves least.

    None if no law of the reference leaves less than the declared one, however likely the tests of them make it. Many
    of these are alike: of those that leave nearly as little the plainest comes first in the list.
    """
    likeliest = max(explaining, key=lambda one: one.likelihood, default=None)
    if likeliest is None or likeliest.test.fault not in _OF_REFERENCE:
        return likeliest
    likely = [one for one in explaining if one.test.fault in _OF_REFERENCE and one.as_likely([likeliest])]
    best = max(likely, key=lambda one: one.gain)
    if best.gain <= 0:
        return None
    return next(one for one in likely if (best.gain - one.gain) * best.likelihood <= RIVAL * best.gain)


def _screen(found: Tested, family: Family) -> FaultTest | None:
    """Test by one simulation whether the record can tell the laws of a family; None where it cannot."""
    assert found.record is not None
    moved = found.residual - found.state.problem.under(family.screen, found.record).residual(found.state.x)
    step = found.test_law(family.fault, moved)
    matters = step.p_value <= found.level if family.evident else _may_matter(found, step, moved)
    return step if matters else None


def _may_matter(found: Tested, step: FaultTest, moved: FloatArray) -> bool:
    """Whether another law is not excluded, and either is evident or would shift a parameter."""
    if not step.std > 0 or step.size + 3 * step.std < _AT_LEAST:
        return False
    if _REACH * step.strength**2 < found.significant - RIVAL:
        return False
    if step.size > 0 and step.p_value <= found.level:
        return True
    by = np.linalg.lstsq(found.own, moved, rcond=None)[0]
    return any(_REACH * abs(one) > _MATTERS * std for one, std in zip(by, found.std.values(), strict=False))


def test_laws(found: Tested, proof: Proof | None) -> list[LawTest]:
    """Return the tests of other laws that are not named already, and that neither screen nor motor position excludes.

    Args:
        found: where they are tested.
        proof: what the motor position excludes.
    """
    if found.record is None:
        return []
    tests: list[LawTest] = []
    for family in Variants(found.state.problem, found.state.x, found.record).every():
        kin = _OF_REFERENCE if family.fault is AVERAGED else (family.fault,)
        if {one.name for one in kin} & {*found.state.named}:
            continue
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # an unstable loop is not that of the record
            step = _screen(found, family)
            if step is None:
                continue
            for refit in family.solve(step.size > 0 and step.p_value <= found.level):
                one = _judge(found, refit)
                if one is None or (one.test.fault is PERIOD and not one.possible):
                    break
                if proof is None or not proof.excludes_law(refit.law):
                    tests.append(one)
    return tests


def _judge(found: Tested, refit: Refit) -> LawTest | None:
    """Return the test of another law; None where it changes nothing."""
    left = refit.problem.residual(refit.x)
    test = found.test_law(refit.law.fault, found.residual - left)
    return LawTest(refit, test, float(found.residual @ found.residual - left @ left)) if test.std > 0 else None


# What is said of them


def find_other_law(found: Tested, other: LawTest, alike: Sequence[LawTest] = ()) -> Finding:
    """Return another law as a finding, with its shifts and equally likely laws."""
    least = other.test.strength**2 - RIVAL
    rivals = tuple(s for s in found.tests if s.p_value <= found.level and s.strength**2 > least)
    law, problem, x = other.refit
    left = float(np.linalg.norm(problem.residual(x))) / problem.size
    others = tuple(one.refit.law for one in sorted(alike, key=lambda one: -one.likelihood))
    value = 1 / law.rate if law.rate else None
    return Finding(other.test, value, rivals, found.shifts_to(problem.values(x)), law, left, others)


def choose_undecided(open_ones: Sequence[Finding]) -> Finding | None:
    """Return the possible law that shifts a parameter farthest out of its interval; None without one."""
    moving = [one for one in open_ones if any(abs(by.sigmas) > INTERVAL for by in one.changes.values())]
    return max(moving, key=_size_of_change, default=None)


def _size_of_change(finding: Finding) -> tuple[float, float]:
    """Return the shift of stiffness or inertia, and the largest of any parameter, in deviations."""
    sizes = {name: abs(change.sigmas) for name, change in finding.changes.items()}
    return sizes.get("stiffness", sizes.get("inertia", 0.0)), max(sizes.values(), default=0.0)


def list_undecided(tests: Sequence[LawTest]) -> list[LawTest]:
    """Return the laws that the record does not exclude, of rates those that none other excludes."""
    return [
        one for one in tests if one.possible and one.test.fault in _OPEN
        and one.as_likely([other for other in tests if other.test.fault == one.test.fault])
    ]  # fmt: skip


# What the motor position excludes


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """A record whose declared law makes the logged torque of the logged motor position."""

    record: Record
    loop: ClosedLoop

    def excludes(self, test: FaultTest) -> bool:
        """Test whether the position excludes a fault of this size."""
        controller, size = self.loop.controller, test.size
        if test.fault is LOG_GAIN:
            return excludes(self.record, self.loop, controller, gain=size)
        if test.fault is LOG_DELAY:
            return excludes(self.record, self.loop, controller, late=size)
        if (declared := numbers_of(controller).get(test.name)) is None or test.name == "limit":
            return False
        most = _AT_MOST * abs(declared) or abs(size)
        with contextlib.suppress(JointidError):  # no law has such a number
            other = with_numbers(controller, {test.name: declared + max(-most, min(size, most))})
            return excludes(self.record, self.loop, other)
        return False

    def excludes_law(self, law: OtherLaw) -> bool:
        """Whether the drive does not run another law."""
        return excludes(self.record, self.loop, law.controller)


def has_unstated_delay(check: AxisFaults, law: LawOnPosition | None, problem: ClosedLoopProblem) -> bool:
    """Test for an undeclared delay below one sample.

    The law must make the logged torque of the motor position: then the delay is behind the log, and no fault of law or
    log looks like it.
    """
    controller = problem.loop.controller
    stated = not isinstance(controller, DiagramController) or controller.delay or controller.undeclared == "none"
    if stated or law is None or not law.holds or not check.findings:
        return False
    first = check.findings[0].test
    return first.fault is DELAY and 0.0 < first.size < problem.experiment.law.period
