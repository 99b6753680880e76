"""Tests of other laws of a controller, and what the motor position excludes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.faults.fault import FaultSignature, FaultTest
from jointid.diagnostics.faults.findings import AxisFaults, OtherLaw
from jointid.diagnostics.faults.numbers import DELAY, LOG_DELAY, LOG_GAIN
from jointid.diagnostics.faults.other_laws import (
    AVERAGED,
    FILTERED,
    INTERPOLATIONS,
    LATE,
    MEASURED_VELOCITY,
    PERIOD,
    PRESENT_SAMPLE,
    TIMES_FASTER,
    Refit,
    faster_laws,
    other_interpolations,
    prepare_anew,
    refit,
    refit_late_references,
    refit_other_laws,
    runs_at_the_logs_rate,
    screen_mean,
)
from jointid.diagnostics.model_free import LawOnPosition, excludes
from jointid.diagnostics.search_state import (
    RIVAL,
    SIGNIFICANT,
    LoopTests,
    SearchState,
    TestResults,
    stack_columns,
    test_signature,
)
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.controllers.servo_base import DiagramController
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.uncertainty.covariance import Influence

_EXCLUDED = 2.0  # deviations: a law so far away is excluded
_BETWEEN_RATES = 0.2  # of what a faster law changes: so much less is still a rate next to it
_AT_LEAST = 0.6  # of what half of the log's period changes, by one step: less shows that the drive is not that fast
_REACH = 2.0  # times the same is what any faster drive changes
_MATTERS = 1.5  # deviations: a faster drive that moves no parameter so far by one step is not searched for
_TIMES_UNDECIDED = (2, 8)  # without evidence for any: higher rates change hardly more
_AT_MOST = 0.5  # of a declared number: what a larger change of it shows is seen at this one


@dataclass(frozen=True, slots=True, eq=False)
class OtherLawTest:
    """Solution under another law, and its test: size 0 is the declared law, size 1 the other one.

    Attributes:
        gain: decrease of the squared norm of the residual from the declared law to this one.
    """

    refit: Refit
    test: FaultTest
    gain: float

    @property
    def of_reference(self) -> bool:
        """Test whether the other law answers the reference differently."""
        return self.test.fault in (LATE, AVERAGED, *INTERPOLATIONS.values())

    @property
    def possible(self) -> bool:
        """Whether the record does not exclude the other law, or a rate near it."""
        roughly = _BETWEEN_RATES if self.test.fault is PERIOD else 0.0
        return 1 - self.test.size <= max(_EXCLUDED * self.test.std, roughly)

    @property
    def likelihood(self) -> float:
        """Twice the logarithm of the likelihood ratio to the declared law."""
        return (2 * self.test.size - 1) / self.test.std**2

    def explains(self, tests: Sequence[FaultTest], level: float) -> bool:
        """Whether the record excludes the declared law, and no fault explains it better."""
        test = self.test
        if not self.possible or test.size <= 0 or test.p_value > level:
            return False
        return self.likelihood >= max((one.strength**2 for one in tests), default=0.0) - RIVAL

    def rivals(self, found: TestResults) -> bool:
        """Whether the record does not exclude it, and no fault is far likelier."""
        stated = (one.strength**2 for one in found.tests if one.p_value <= SIGNIFICANT)
        return self.possible and self.likelihood >= max(stated, default=0.0) - RIVAL

    def as_likely(self, others: Sequence[OtherLawTest]) -> bool:
        """Whether none of others is far likelier.

        The residuals are compared by the variance of the likeliest law's test: each law has its own spectrum of the
        noise in its test, so two likelihoods differ even where two laws leave the same residual.
        """
        best = max(others, key=lambda one: one.likelihood)
        if self.likelihood >= best.likelihood - RIVAL:
            return True
        return best.gain > 0 and (best.gain - self.gain) * best.likelihood <= RIVAL * best.gain


def choose_law(explaining: Sequence[OtherLawTest]) -> OtherLawTest | None:
    """Return the likeliest law; of those that differ in what they make of the reference the one that leaves least.

    None if no law of the reference leaves less than the declared one, however likely the tests of them make it. Many
    of these are alike: of those that leave nearly as little the plainest comes first in the list.
    """
    likeliest = max(explaining, key=lambda one: one.likelihood, default=None)
    if likeliest is None or not likeliest.of_reference:
        return likeliest
    likely = [one for one in explaining if one.of_reference and one.as_likely([likeliest])]
    best = max(likely, key=lambda one: one.gain)
    if best.gain <= 0:
        return None
    return next(one for one in likely if (best.gain - one.gain) * best.likelihood <= RIVAL * best.gain)


def test_other_laws(
    state: SearchState, found: TestResults, settings: LoopTests, known: Mapping[str, float], record: Record | None
) -> list[OtherLawTest]:
    """Return the tests of the other laws of the controller."""
    tests = test_interpolations(state, found, settings, known, record)
    wrong = any(one.p_value <= settings.level for one in found.tests)
    laws = (PRESENT_SAMPLE, *((MEASURED_VELOCITY, FILTERED) if wrong else ()))
    for refitted in refit_other_laws(state.problem, state.x, {one.name for one in laws} - {*state.named}):
        tests += _judge_law(state, found, refitted)
    return tests


def test_interpolations(
    state: SearchState,
    found: TestResults,
    settings: LoopTests,
    known: Mapping[str, float],
    record: Record | None,
    *,
    begin: Callable[[ClosedLoopProblem], FloatArray] | None = None,
) -> list[OtherLawTest]:
    """Return the tests of undeclared interpolations that may matter.

    Of an estimate that is far off all of them are tested, from where `begin` says; see `refit`.
    """
    if record is None:
        return []
    problem = state.problem
    tests: list[OtherLawTest] = []
    for law in other_interpolations(problem, record):
        if law.fault.name in state.named:
            continue
        try:
            other = prepare_anew(problem, law, record)
            if begin is None and _screen_law(state, found, law, other, known) is None:
                continue
            refitted = refit(problem, state.x, law, other, state.x if begin is None else begin(other))
        except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable under it is not that of the record
            continue
        tests += _judge_law(state, found, refitted)
    return tests + _test_late_references(state, found, settings, record)


def _test_late_references(
    state: SearchState, found: TestResults, settings: LoopTests, record: Record
) -> list[OtherLawTest]:
    """Return the tests of a reference that is delayed or averaged.

    One simulation of a short mean decides whether there is evidence: all of these are late, or early.
    """
    problem, screened = state.problem, screen_mean(state.problem)
    names = {LATE.name, AVERAGED.name, *(one.name for one in INTERPOLATIONS.values())}
    if screened is None or names & {*state.named}:
        return []
    try:
        moved = found.residual - prepare_anew(problem, screened, record).residual(state.x)
        step = test_signature(state, found, FaultSignature(AVERAGED, moved, raw=np.zeros(0)))
    except JointidError:
        return []
    if not step.p_value <= settings.level:
        return []
    refits: list[Refit] = []
    with contextlib.suppress(JointidError, np.linalg.LinAlgError):
        refits += refit_late_references(problem, state.x, record)
    return [test for one in refits for test in _judge_law(state, found, one)]


def test_faster_laws(
    state: SearchState, found: TestResults, settings: LoopTests, known: Mapping[str, float], record: Record | None
) -> list[OtherLawTest]:
    """Return the tests of laws that run faster than the log, if no period is declared and they may matter.

    One simulation at half of the log's period decides that: a faster drive changes at most twice as much.
    """
    problem = state.problem
    if record is None or not runs_at_the_logs_rate(problem):
        return []
    try:
        steps = [
            _screen_law(state, found, law, prepare_anew(problem, law, record), known)
            for law in faster_laws(problem, record, TIMES_FASTER[0])
        ]
    except JointidError:  # no law of that period
        return []
    if not any(steps):
        return []
    evident = any(step is not None and step.size > 0 and step.p_value <= settings.level for step in steps)
    tests: list[OtherLawTest] = []
    start = state.x
    for times in TIMES_FASTER if evident else _TIMES_UNDECIDED:
        here: list[OtherLawTest] = []
        for law, step in zip(faster_laws(problem, record, times), steps, strict=True):
            held = getattr(law.controller, "interpolation", None) == "hold"
            if step is None or (held and not evident):  # a held reference is no usual guess
                continue
            try:
                refitted = refit(problem, state.x, law, prepare_anew(problem, law, record), start)
            except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable under it is not that of the record
                continue
            start = refitted.x
            here += _judge_law(state, found, refitted)
        if not any(one.possible for one in here):
            break
        tests += (one for one in here if one.possible and one.as_likely(here))
    return tests


def without_excluded(tests: list[OtherLawTest], proof: Proof | None) -> list[OtherLawTest]:
    """Return the tests of the laws that the motor position does not exclude."""
    return [one for one in tests if proof is None or not proof.excludes_law(one.refit.law)]


def _judge_law(state: SearchState, found: TestResults, other: Refit) -> tuple[OtherLawTest, ...]:
    """Return the test of another law; none where it changes nothing."""
    test = test_signature(state, found, other.signature)
    left = other.problem.residual(other.x)
    return (OtherLawTest(other, test, float(found.residual @ found.residual - left @ left)),) if test.std > 0 else ()


def _screen_law(
    state: SearchState, found: TestResults, law: OtherLaw, other: ClosedLoopProblem, known: Mapping[str, float]
) -> FaultTest | None:
    """Test the effect of another law at the same parameters; None without one."""
    moved = found.residual - other.residual(state.x)
    step = test_signature(state, found, FaultSignature(law.fault, moved, raw=np.zeros(0)))
    return step if may_matter(state, found, step, moved, known) else None


def may_matter(
    state: SearchState, found: TestResults, step: FaultTest, moved: FloatArray, known: Mapping[str, float]
) -> bool:
    """Whether another law is not excluded, and either is evident or would shift a parameter.

    `step` is the test of the change of the torque, `moved`, (rows,), by it or by half of the log's period.
    """
    if not step.std > 0 or step.size + 3 * step.std < _AT_LEAST:
        return False
    best = max((one.strength**2 for one in found.tests if one.p_value <= SIGNIFICANT), default=0.0)
    if _REACH * step.strength**2 < best - RIVAL:
        return False
    if step.size > 0 and step.p_value <= SIGNIFICANT:
        return True
    own = stack_columns(state, found.own)
    by = np.linalg.lstsq(own, moved, rcond=None)[0]
    std = Influence(own, found.residual).robust().std
    names = [p.name for p in state.problem.free_joint]
    return any(_REACH * abs(by[k]) > _MATTERS * known.get(name, float(std[k])) for k, name in enumerate(names))


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
        if (declared := numbers_of(controller).get(test.name)) is None or test.fault.value is not None:
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
