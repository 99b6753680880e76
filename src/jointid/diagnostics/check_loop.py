"""Search for faults of the closed loop and the log of an estimate, the likeliest first.

Each fault of `fault_tests` is tested alone. Faults of loop and log are one family, with a family-wise error of 5 %;
faults of the mechanics are another, with a tenth of that. The fault with the largest statistic is named, with those
that are nearly as likely by the likelihood ratio. The problem is solved again with the fault corrected, which shows its
effect on the parameters, and the remaining faults are tested again.

Where the declared law makes the logged torque of a logged motor position, faults of law and log that it excludes are
not named.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message
from jointid.common.parameters import Quantity, unit_of
from jointid.common.text import number
from jointid.diagnostics.fault_tests import (
    RARER,
    compute_signatures,
    fit_whitener,
    rank_tests,
    score_signatures,
    strength_of,
)
from jointid.diagnostics.faults.fault import FaultSignature, FaultTest, Hint
from jointid.diagnostics.faults.findings import AxisFaults, Finding, OtherLaw, ParameterShift
from jointid.diagnostics.faults.forces import OFFSET, free_number
from jointid.diagnostics.faults.numbers import DELAY, LOG_DELAY, LOG_GAIN
from jointid.diagnostics.faults.other_laws import (
    AVERAGED,
    INTERPOLATIONS,
    LATE,
    MEASURED_VELOCITY,
    OTHER_LAWS,
    PERIOD,
    PRESENT_SAMPLE,
    TIMES_FASTER,
    Refit,
    faster_laws,
    late_interpolations,
    other_interpolations,
    prepare_anew,
    refit,
    refit_late_references,
    refit_other_laws,
    runs_at_the_logs_rate,
    screen_mean,
)
from jointid.diagnostics.faults.registry import FAULTS
from jointid.diagnostics.faults.springs import SECOND_MODE
from jointid.diagnostics.faults.trials import solve_with_fault
from jointid.diagnostics.model_free import LawOnPosition, excludes
from jointid.estimation.descent import descend
from jointid.estimation.methods.force_in_loop import find_force, simulate_with_force
from jointid.estimation.problems.base import surrounding
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.controllers.servo_base import DiagramController
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, frictions_beside, springs_beside
from jointid.models.springs import ElasticLoad
from jointid.records.record import Record
from jointid.uncertainty.covariance import robust
from jointid.uncertainty.position_dependent_error import Cells, cells, widen
from jointid.uncertainty.verdict import Reason

_RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
_SAME_EFFECT = 0.8  # of the statistic: the robust deviations of two forms of one effect rank them no closer
_HALF = 0.5  # of the size by one step that must remain when the problem is solved again
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_SIGNIFICANT = 0.05  # a fault with a larger p-value explains nothing
_EXCLUDED = 2.0  # deviations: a law so far away is excluded
_INTERVAL = 2.0  # deviations: half an interval
_BETWEEN_RATES = 0.2  # of what a faster law changes: so much less is still a rate next to it
_AT_LEAST = 0.6  # of what half of the log's period changes, by one step: less shows that the drive is not that fast
_REACH = 2.0  # times the same is what any faster drive changes
_MATTERS = 1.5  # deviations: a faster drive that moves no parameter so far by one step is not searched for
_TIMES_UNDECIDED = (2, 8)  # without evidence for any: higher rates change hardly more
_FORCES = 32  # independent ones: the deviation of what they show is known to an eighth
_AT_MOST = 0.5  # of a declared number: what a larger change of it shows is seen at this one
_LARGEST_SHARE = 0.5  # of the load on a spring of its own
_TOLERANCE = 1e-6  # of the refinement with a fault corrected: far below a deviation


@dataclass(frozen=True, slots=True)
class LoopTests:
    """Settings of the check of a loop.

    Attributes:
        level: largest share of records without a fault in which one is found.
        most: faults named at most, one after another.
        faults: names of those to test; all that the record allows when None.
    """

    level: float = 0.05
    most: int = 3
    faults: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not (0 < self.level < 1 and self.most >= 1):
            raise MethodError(
                f"A check has a level between 0 and 1 and names at least 1 fault; received {self.level} and "
                f"{self.most}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class SearchState:
    """A solved problem between two tests.

    `corrected` are faults taken off the torque, for which the problem has no parameter; `named` are not tested again;
    `identified` are the parameters, by name, as they are beside the last fault, where that has its own law.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()
    identified: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _Proof:
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
        return excludes(self.record, self.loop, law.controller, reference=law.reference)


@dataclass(frozen=True, slots=True, eq=False)
class _TestResults:
    """Residual and columns of a state, (rows, ...), fault signatures and their tests, the likeliest first.

    `where` and `by_forces` are arguments of `score_signatures`, simulated once and on demand. `excluded` are the
    significant tests of faults that the motor position excludes.
    """

    residual: FloatArray
    own: FloatArray
    signatures: tuple[FaultSignature, ...]
    tests: tuple[FaultTest, ...]
    where: Callable[[], Cells]
    by_forces: Callable[[], list[FloatArray]]
    excluded: tuple[FaultTest, ...] = ()


def search_faults(
    problem: ClosedLoopProblem,
    x: FloatArray,
    settings: LoopTests | None = None,
    std: Mapping[str, float] | None = None,
    record: Record | None = None,
    shown: Sequence[DriveNumber] = (),
    law: LawOnPosition | None = None,
) -> tuple[AxisFaults, SearchState]:
    """Return the faults of a loop and its log, and the problem with these faults corrected.

    Args:
        problem: with the identified parameters free; those are not tested.
        x: (free,) its solution.
        settings: see `LoopTests`.
        std: standard errors of the joint's parameters by name, in which shifts are given; autocorrelation-robust ones
            when None.
        record: of the problem; without it a drive that runs faster than the log is not searched for.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
        law: what the declared law leaves of the torque along the record's motor position; None without one.

    Raises:
        MethodError: a fault asked for cannot be tested in this record.
    """
    settings, known = settings or LoopTests(), std or {}
    state = beginning = SearchState(problem, np.asarray(x, dtype=np.float64))
    findings: list[Finding] = []
    others: list[_OtherLawTest] = []
    faster: list[_OtherLawTest] = []
    first: _TestResults | None = None
    first_law: _OtherLawTest | None = None
    proof = _Proof(record, problem.loop) if record is not None and law is not None and law.holds else None
    while len(findings) < settings.most:
        found = _search_shapes(state, _run_tests(state, settings, proof), settings)
        if np.linalg.norm(found.residual) <= _ROUNDING * np.linalg.norm(problem.filter(problem.measured)):
            first, others = first or found, []
            break
        others = _without_excluded(_test_other_laws(state, found, settings, known, record), proof)
        if first is None:
            first = found
            faster = _without_excluded(_test_faster_laws(state, found, settings, known, record), proof)
        laws = others if findings else [*others, *faster]
        stated = _choose_law([one for one in laws if one.explains(found.tests, settings.level)])
        if stated is None and (not found.tests or found.tests[0].p_value > settings.level):
            break
        if not findings:  # a rigid joint's DIDIM ends near the least squares, not on them
            state = replace(state, x=descend(problem, state.x, _TOLERANCE).x)
        if stated is not None:
            first_law = first_law or stated
            alike = [one for one in laws if one is not stated and one.possible and one.as_likely([stated])]
            findings.append(_find_other_law(state, stated, found, settings.level, known, alike))
            named = (*state.named, *(part.name for one in (stated, *alike) for part in one.refit.law.parts))
            state = replace(state, problem=stated.refit.problem, x=stated.refit.x, named=named)
            others = []
            continue
        after, others = _accept_fault(state, found), []
        findings.append(_make_finding(state, after, found, settings.level, known))
        state = after
    open_ones: list[Finding] = []
    open_laws = (PRESENT_SAMPLE, *INTERPOLATIONS.values())
    if possible := [one for one in others if one.possible and one.test.fault in open_laws]:
        solved = state if findings else replace(state, x=descend(problem, state.x, _TOLERANCE).x)
        open_ones += [_find_other_law(solved, one, found, settings.level, known) for one in possible]
    if first is not None and (rates := _list_rates_left_open(faster, first, findings, first_law)):
        solved = replace(beginning, x=descend(problem, beginning.x, _TOLERANCE).x)
        open_ones += [_find_other_law(solved, one, first, settings.level, known) for one in rates]
    moving = [one for one in open_ones if any(abs(by.sigmas) > _INTERVAL for by in one.changes.values())]
    undecided = max(moving, key=_size_of_change, default=None)
    joint = problem.loop.joint
    units = {p.name: joint.unit(p) for p in joint.parameters}
    motion = {"torque": Quantity.FORCE, "position": Quantity.POSITION, "velocity": Quantity.VELOCITY}
    units |= {name: unit_of(quantity, joint.kind, units[OFFSET.name]) for name, quantity in motion.items()}
    check = AxisFaults(
        tuple(findings),
        () if first is None else first.tests,
        settings.level,
        symbols={p.name: p.symbol for p in joint.parameters},
        units=units,
        side=None if joint.transmission is None else joint.transmission.side,
        undecided=undecided,
        law=numbers_of(problem.loop.controller),
        shown={one.number: one for one in shown},
        laws=list_laws(joint),
        assumed=None if first is None or findings else _bound_second_mode(beginning, first, known),
        excluded=() if findings else found.excluded,
        lacking={} if findings else _measure_lacking(state, found),
        suspected=_suspect_mechanics(state, found, settings.level, known),
    )
    return check, state


def _bound_second_mode(state: SearchState, found: _TestResults, known: Mapping[str, float]) -> Message | None:
    """Return how much stiffer a spring is behind which a part of the load swings; None where that is in its interval.

    Of each mode that was tried, the part of the load is the largest within two deviations of its test, up to half.
    """
    shapes = [one for one in found.signatures if one.fault is SECOND_MODE and one.shape]
    if not shapes:
        return None
    joint, values, whiten = state.problem.joint, state.problem.values(state.x), fit_whitener(found.residual)
    assert isinstance(joint, FlexibleJoint)
    own, error = whiten(found.own), whiten(found.residual)
    left = error - own @ np.linalg.lstsq(own, error, rcond=None)[0]
    first, bounds = joint.frequencies(values)["free_free"], []
    for one in shapes:
        column = whiten(one.column)
        alone = (column - own @ np.linalg.lstsq(own, column, rcond=None)[0])[:, np.newaxis]
        size = float(alone[:, 0] @ left) / float(alone[:, 0] @ alone[:, 0])
        share = min(max(size, 0.0) + _INTERVAL * float(robust(alone, alone, left).std[0]), _LARGEST_SHARE)
        if not share > 0.0:  # a record without noise excludes all of it
            continue
        start = ElasticLoad().start(values, share, (one.shape or 0.0) / first)
        bounds.append((start["stiffness"] / values["stiffness"] - 1.0, share, one.shape))
    if not bounds:
        return None
    more, share, mode = max(bounds)
    if more * values["stiffness"] <= _INTERVAL * known.get("stiffness", math.inf):
        return None
    symbol = next(p.symbol for p in joint.parameters if p.name == "stiffness")
    said = (
        f"that the load is rigid is assumed: if {number(100 * share, 2)} % of it swings at {number(mode, 2)} Hz, which "
    )
    said += f"this record does not exclude, {symbol} is {number(100 * more, 2)} % larger"
    return Message(Reason.LOAD_NOT_RIGID, said, {"swinging_share": share, "second_mode": mode, "stiffer": more})


def _measure_lacking(state: SearchState, found: _TestResults) -> dict[str, float]:
    """Return the largest shift of each parameter by the excluded faults.

    They are not in loop or log, so the joint has what looks like them, and its model has not.
    """
    own, shapes = _stack_columns(state, found.own), {(one.fault, one.shape): one.column for one in found.signatures}
    moved = [one.size * np.linalg.pinv(own) @ shapes[one.fault, one.shape] for one in found.excluded]
    names = [p.name for p in state.problem.free_joint]
    return {name: float(max(abs(by[k]) for by in moved)) for k, name in enumerate(names)} if moved else {}


def _suspect_mechanics(
    state: SearchState, found: _TestResults, level: float, known: Mapping[str, float]
) -> Finding | None:
    """Return the likeliest fault of the mechanics if it is significant at the level of those of the loop.

    The p-values of the mechanics are those of a tenth of the level: such a fault is not named.
    """
    first = next((one for one in found.tests if one.fault.mechanical), None)
    if first is None or not level < first.p_value <= RARER * level:
        return None
    alone = replace(found, tests=(first,))
    return _make_finding(state, _accept_fault(state, alone), alone, level, known)


def list_laws(joint: Joint, *, linear: bool = False) -> tuple[str, ...]:
    """Return the names of springs and frictions that can replace those of a joint; linear frictions where asked for."""
    even = joint.friction.offset_identifiable
    laws = [law for law in frictions_beside(joint) if (linear or not law.linear) and law != joint.friction]
    springs = springs_beside(joint) if isinstance(joint, FlexibleJoint) else ()
    return (*(law.name for law in laws if even or not law.offset_identifiable), *(law.name for law in springs))


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


def _run_tests(state: SearchState, settings: LoopTests, proof: _Proof | None) -> _TestResults:
    residual, own, signatures = compute_signatures(state.problem, state.x)
    known = {a.fault.name: a.fault for a in signatures}
    searched = (one.name for one in FAULTS if one.applies is not None and one.applies(state.problem.joint))
    laws = (*(one.name for one in OTHER_LAWS), *searched)
    wrong = [name for name in settings.faults or () if name not in (*known, *state.named, *laws)]
    if wrong:
        choice = ", ".join((*known, *laws))
        raise MethodError(f"No fault called {', '.join(wrong)} can be tested in this record; choose from {choice}.")
    controller = state.problem.loop.controller
    declared = {
        fault: surrounding(name, controller).start or 0.0 if fault.declared is None else fault.declared
        for name, fault in known.items()
        if not {name, fault.kin} & {*state.named} and (settings.faults is None or name in settings.faults)
    }
    where, by_forces = cache(lambda: _assign_cells(state)), cache(lambda: _simulate_forces(state))
    columns, excluded = _stack_columns(state, own), list[FaultTest]()
    while True:
        tests = rank_tests(score_signatures(residual, columns, signatures, declared, where, by_forces), settings.level)
        likely = [one for one in tests if one.p_value <= settings.level] if proof is not None else []
        found = [one for one in likely if proof is not None and proof.excludes(one)]
        if not found:
            break
        excluded += found
        gone = {one.fault for one in found}
        declared = {fault: value for fault, value in declared.items() if fault not in gone}
    return _TestResults(residual, own, signatures, tests, where, by_forces, tuple(excluded))


def _search_shapes(state: SearchState, found: _TestResults, settings: LoopTests) -> _TestResults:
    """Return the tests, with those of faults whose shape is searched for replaced."""
    whiten = fit_whitener(found.residual)
    for fault in FAULTS:
        asked = settings.faults is None or fault.name in settings.faults
        if fault.search is None or not asked or fault.name in state.named:
            continue
        test = next((one for one in found.tests if one.fault == fault), None)
        first = next((one.fault for one in found.tests[:1] if one.p_value <= settings.level), None)
        hint = Hint(found.residual, _stack_columns(state, found.own), whiten, test, settings.level, first)
        signatures = fault.search(state.problem, state.x, hint)
        if signatures:
            better = _test_signature(state, found, *signatures)
            tests = rank_tests((better, *(one for one in found.tests if one is not test)), settings.level)
            found = replace(found, signatures=(*found.signatures, *signatures), tests=tests)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _OtherLawTest:
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
        return self.likelihood >= max((one.strength**2 for one in tests), default=0.0) - _RIVAL

    def rivals(self, found: _TestResults) -> bool:
        """Whether the record does not exclude it, and no fault is far likelier."""
        stated = (one.strength**2 for one in found.tests if one.p_value <= _SIGNIFICANT)
        return self.possible and self.likelihood >= max(stated, default=0.0) - _RIVAL

    def as_likely(self, others: Sequence[_OtherLawTest]) -> bool:
        """Whether none of others is far likelier.

        The residuals are compared by the variance of the likeliest law's test: each law has its own spectrum of the
        noise in its test, so two likelihoods differ even where two laws leave the same residual.
        """
        best = max(others, key=lambda one: one.likelihood)
        if self.likelihood >= best.likelihood - _RIVAL:
            return True
        return best.gain > 0 and (best.gain - self.gain) * best.likelihood <= _RIVAL * best.gain


def _choose_law(explaining: Sequence[_OtherLawTest]) -> _OtherLawTest | None:
    """Return the likeliest law; of those that differ in what they make of the reference the one that leaves least.

    Many of these are alike: of those that leave nearly as little the plainest comes first in the list.
    """
    likeliest = max(explaining, key=lambda one: one.likelihood, default=None)
    if likeliest is None or not likeliest.of_reference:
        return likeliest
    likely = [one for one in explaining if one.of_reference and one.as_likely([likeliest])]
    best = max(likely, key=lambda one: one.gain)
    return next(one for one in likely if (best.gain - one.gain) * best.likelihood <= _RIVAL * best.gain)


def _test_other_laws(
    state: SearchState, found: _TestResults, settings: LoopTests, known: Mapping[str, float], record: Record | None
) -> list[_OtherLawTest]:
    """Return the tests of the other laws of the controller, as far as the settings name them."""
    tests = _test_interpolations(state, found, settings, known, record)
    wrong = settings.faults is not None or any(one.p_value <= settings.level for one in found.tests)
    laws = (PRESENT_SAMPLE, *((MEASURED_VELOCITY,) if wrong else ()))
    names = {one.name for one in laws}
    asked = names & set(settings.faults or names)
    for refitted in refit_other_laws(state.problem, state.x, asked - {*state.named}):
        tests += _judge_law(state, found, refitted)
    return tests


def _test_interpolations(
    state: SearchState, found: _TestResults, settings: LoopTests, known: Mapping[str, float], record: Record | None
) -> list[_OtherLawTest]:
    """Return the tests of undeclared interpolations that may matter."""
    if record is None:
        return []
    problem = state.problem
    tests: list[_OtherLawTest] = []
    for law in other_interpolations(problem, record):
        if law.fault.name in state.named or not (settings.faults is None or law.fault.name in settings.faults):
            continue
        try:
            other = prepare_anew(problem, law, record)
            if _screen_law(state, found, law, other, known) is None:
                continue
            refitted = refit(problem, state.x, law, other, state.x)
        except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable under it is not that of the record
            continue
        tests += _judge_law(state, found, refitted)
    return tests + _test_late_references(state, found, settings, record)


def _test_late_references(
    state: SearchState, found: _TestResults, settings: LoopTests, record: Record
) -> list[_OtherLawTest]:
    """Return the tests of a reference that is interpolated late, delayed or averaged.

    One simulation of a short mean decides whether there is evidence: all of these are late, or early.
    """
    problem, screened = state.problem, screen_mean(state.problem)
    names = {LATE.name, AVERAGED.name, *(one.name for one in INTERPOLATIONS.values())}
    if screened is None or names & {*state.named} or not (settings.faults is None or names & {*settings.faults}):
        return []
    try:
        moved = found.residual - prepare_anew(problem, screened, record).residual(state.x)
        step = _test_signature(state, found, FaultSignature(AVERAGED, moved, raw=np.zeros(0)))
    except JointidError:
        return []
    if not step.p_value <= settings.level:
        return []
    refits: list[Refit] = []
    for law in late_interpolations(problem.loop.controller, record, problem.experiment.law.period):
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):
            refits.append(refit(problem, state.x, law, prepare_anew(problem, law, record), state.x))
    with contextlib.suppress(JointidError, np.linalg.LinAlgError):
        refits += refit_late_references(problem, state.x, record)
    wanted = names if settings.faults is None else {*settings.faults}
    return [test for one in refits if one.law.fault.name in wanted for test in _judge_law(state, found, one)]


def _test_faster_laws(
    state: SearchState, found: _TestResults, settings: LoopTests, known: Mapping[str, float], record: Record | None
) -> list[_OtherLawTest]:
    """Return the tests of laws that run faster than the log, if no period is declared and they may matter.

    One simulation at half of the log's period decides that: a faster drive changes at most twice as much.
    """
    problem, asked = state.problem, settings.faults is None or PERIOD.name in settings.faults
    if record is None or not (asked and runs_at_the_logs_rate(problem)):
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
    tests: list[_OtherLawTest] = []
    start = state.x
    for times in TIMES_FASTER if evident else _TIMES_UNDECIDED:
        here: list[_OtherLawTest] = []
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


def _without_excluded(tests: list[_OtherLawTest], proof: _Proof | None) -> list[_OtherLawTest]:
    return [one for one in tests if proof is None or not proof.excludes_law(one.refit.law)]


def _judge_law(state: SearchState, found: _TestResults, other: Refit) -> tuple[_OtherLawTest, ...]:
    """Return the test of another law; none where it changes nothing."""
    test = _test_signature(state, found, other.signature)
    left = other.problem.residual(other.x)
    return (_OtherLawTest(other, test, float(found.residual @ found.residual - left @ left)),) if test.std > 0 else ()


def _screen_law(
    state: SearchState, found: _TestResults, law: OtherLaw, other: ClosedLoopProblem, known: Mapping[str, float]
) -> FaultTest | None:
    """Test the effect of another law at the same parameters; None without one."""
    moved = found.residual - other.residual(state.x)
    step = _test_signature(state, found, FaultSignature(law.fault, moved, raw=np.zeros(0)))
    return step if _may_matter(state, found, step, moved, known) else None


def _may_matter(
    state: SearchState, found: _TestResults, step: FaultTest, moved: FloatArray, known: Mapping[str, float]
) -> bool:
    """Whether another law is not excluded, and either is evident or would shift a parameter.

    `step` is the test of the change of the torque, `moved`, (rows,), by it or by half of the log's period.
    """
    if not step.std > 0 or step.size + 3 * step.std < _AT_LEAST:
        return False
    best = max((one.strength**2 for one in found.tests if one.p_value <= _SIGNIFICANT), default=0.0)
    if _REACH * step.strength**2 < best - _RIVAL:
        return False
    if step.size > 0 and step.p_value <= _SIGNIFICANT:
        return True
    own = _stack_columns(state, found.own)
    by = np.linalg.lstsq(own, moved, rcond=None)[0]
    std = robust(own, own, found.residual).std
    names = [p.name for p in state.problem.free_joint]
    return any(_REACH * abs(by[k]) > _MATTERS * known.get(name, float(std[k])) for k, name in enumerate(names))


def _test_signature(state: SearchState, found: _TestResults, *of_law: FaultSignature) -> FaultTest:
    """Return the test of another law, in one shape or several, beside the faults."""
    own, signatures = _stack_columns(state, found.own), [*found.signatures, *of_law]
    declared = {of_law[0].fault: 0.0}
    test = score_signatures(found.residual, own, signatures, declared, found.where, found.by_forces)[0]
    return replace(test, p_value=min((len(found.tests) + len(OTHER_LAWS)) * test.p_value, 1.0))


def _list_rates_left_open(
    faster: Sequence[_OtherLawTest], first: _TestResults, findings: Sequence[Finding], law: _OtherLawTest | None
) -> list[_OtherLawTest]:
    """Return the faster laws that neither a fault nor another rate excludes.

    There are none if a rate was found that already shifts the requested parameter out of its interval.
    """
    found = next((one for one in findings if one.test.fault is PERIOD), None)
    if found is not None and _size_of_change(found)[0] > _INTERVAL:
        return []
    stated = [*faster, *([] if law is None else [law])]
    return [
        one for one in faster
        if one.rivals(first) and one.as_likely(stated) and (found is None or 1 / one.refit.law.rate != found.value)
    ]  # fmt: skip


def _find_other_law(
    state: SearchState,
    other: _OtherLawTest,
    found: _TestResults,
    level: float,
    known: Mapping[str, float],
    alike: Sequence[_OtherLawTest] = (),
) -> Finding:
    """Return another law as a finding, with its shifts and equally likely laws."""
    least = other.test.strength**2 - _RIVAL
    rivals = tuple(s for s in found.tests if s.p_value <= level and s.strength**2 > least)
    problem, x = other.refit.problem, other.refit.x
    left = float(np.linalg.norm(problem.residual(x))) / problem.size
    law, changes = other.refit.law, _compute_shifts(state, problem.values(x), found, known)
    others = tuple(one.refit.law for one in sorted(alike, key=lambda one: -one.likelihood))
    return Finding(other.test, 1 / law.rate if law.rate else None, rivals, changes, law, left, others)


def _size_of_change(finding: Finding) -> tuple[float, float]:
    """Return the shift of stiffness or inertia, and the largest of any parameter, in deviations."""
    sizes = {name: abs(change.sigmas) for name, change in finding.changes.items()}
    return sizes.get("stiffness", sizes.get("inertia", 0.0)), max(sizes.values(), default=0.0)


def _stack_columns(state: SearchState, own: FloatArray) -> FloatArray:
    return np.column_stack([own, *(a.column for a in state.corrected)])


def _assign_cells(state: SearchState) -> Cells:
    """Return the cell of position, direction and speed of each row."""
    run = state.problem.simulate(state.x)
    motion = state.problem.filter(np.column_stack([run.motor_position, run.motor_velocity]))
    return cells(motion[:, 0], motion[:, 1])


def _simulate_forces(state: SearchState) -> list[FloatArray]:
    """Return the residuals, (rows,), of random forces and noise like those of the record; none without a force."""
    problem, run = state.problem, state.problem.simulate(state.x)
    force = find_force(problem, state.x, run, problem.measured - run.torque)
    if force is None:
        return []
    random = np.random.default_rng(1)
    return [
        problem.filter(one - run.torque + force.noise * random.standard_normal(one.size))
        for one in simulate_with_force(problem, state.x, force, _FORCES, (1.0,))
    ]


def _accept_fault(state: SearchState, found: _TestResults) -> SearchState:
    """Return the state with the likeliest fault corrected, and the problem solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    suspect, problem = found.tests[0], state.problem
    signature = next(a for a in found.signatures if (a.fault, a.shape) == (suspect.fault, suspect.shape))
    fault = suspect.fault
    named = (*state.named, fault.name, *(one.name for one in suspect.alike), *filter(None, (fault.kin,)))
    if fault.mechanical and (end := solve_with_fault(problem, state.x, fault)):
        problem = replace(problem, measured=problem.measured - end.change)
        corrected = (*state.corrected, signature)
        return SearchState(problem, descend(problem, state.x, _TOLERANCE).x, corrected, named, end.values)
    if signature.raw is not None:
        problem = replace(problem, measured=problem.measured - suspect.size * signature.raw)
        return SearchState(problem, descend(problem, state.x, _TOLERANCE).x, (*state.corrected, signature), named)
    if fault.free is not None:
        wider, start = fault.free(problem, suspect)
    else:
        wider, start = free_number(problem, suspect.name, suspect.declared + suspect.size)
    held = SearchState(problem, state.x, (*state.corrected, signature), named)
    try:
        x = descend(wider, wider.vector(problem.values(state.x) | {suspect.name: start}), _TOLERANCE).x
        wider.linearise(x)
    except MethodError:  # the number goes to where its part of the law vanishes
        return held
    reached = wider.values(x)[suspect.name] - suspect.declared
    astray = fault.value is None and reached * suspect.size < _HALF * suspect.size**2
    if astray or np.linalg.norm(wider.residual(x)) > np.linalg.norm(found.residual):
        # A bound or another fault prevents the fit: the test stands, the joint stays as it is.
        return held
    return SearchState(wider, x, state.corrected, named)


def _make_finding(
    state: SearchState, after: SearchState, found: _TestResults, level: float, known: Mapping[str, float]
) -> Finding:
    suspect = found.tests[0]
    least = strength_of(suspect) ** 2 - _RIVAL
    rivals = tuple(s for s in found.tests[1:] if s.p_value <= level and strength_of(s) ** 2 > least)
    values = after.problem.values(after.x)
    changes = _compute_shifts(state, {**values, **after.identified}, found, known)
    for one in found.tests[1:]:  # another form of the same effect, which the record does not exclude
        of_kin = suspect.fault.kin and one.fault.kin == suspect.fault.kin and one.fault.mechanical
        if of_kin and one.p_value <= level and strength_of(one) > _SAME_EFFECT * strength_of(suspect):
            other = _accept_fault(state, replace(found, tests=(one,)))
            values_beside = {**other.problem.values(other.x), **other.identified}
            beside = _compute_shifts(state, values_beside, found, known)
            changes = {name: max(by, beside[name], key=lambda shift: abs(shift.by)) for name, by in changes.items()}
    free = [p.name for p in after.problem.free]
    if len(after.corrected) > len(state.corrected) or suspect.name not in free:
        whole = float(np.linalg.norm(after.problem.residual(after.x))) / after.problem.size
        return Finding(suspect, None, rivals, changes, left=whole if after.identified else None)
    value = values[suspect.name]
    if suspect.fault.value is not None:
        return Finding(suspect, suspect.fault.value(state.problem, value), rivals, changes)
    residual, slopes = after.problem.linearise(after.x)
    columns = _stack_columns(after, -slopes)
    covariance, _ = widen(robust(columns, columns, residual), columns, columns, residual, _assign_cells(after))
    refined_std = float(covariance.std[free.index(suspect.name)])
    return Finding(replace(suspect, size=value - suspect.declared, std=refined_std), value, rivals, changes)


def _compute_shifts(
    state: SearchState, values: Mapping[str, float], found: _TestResults, known: Mapping[str, float]
) -> dict[str, ParameterShift]:
    """Return the shifts of the joint's parameters from a state to other values."""
    own = _stack_columns(state, found.own)
    names = [p.name for p in state.problem.free_joint]
    by_itself = robust(own, own, found.residual).std[: len(names)]
    std = [known.get(name, float(one)) for name, one in zip(names, by_itself, strict=True)]
    moved = np.array([values[name] for name in names]) - state.x[: len(names)]
    return {
        name: ParameterShift(float(by), float(by / s) if s > 0 else 0.0)
        for name, by, s in zip(names, moved, std, strict=True)
    }
