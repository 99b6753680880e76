"""Verdicts: one question each about an estimate, with status and coded reasons; and the estimate with its verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from jointid.common.document import Documented
from jointid.common.messages import Message
from jointid.common.text import join, number
from jointid.uncertainty.residual_tests import ResidualReport

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate

POOR_FIT = 0.15
"""Share of the filtered torque that a right model leaves at most: the EMPS axis leaves 0.045, the paper's 0.08."""


class Subject(StrEnum):
    """The question."""

    SOLVER = "solver"
    FIT = "fit"
    WHITENESS = "whiteness"
    REPEATABLE = "repeatable residual"
    IDENTIFIABILITY = "identifiability"
    BOUNDS = "bounds"
    AGREEMENT = "agreement"
    DRIFT = "drift"
    ENCODERS = "encoders"
    STIFFNESS = "stiffness"
    LOOP = "loop"
    SCALE = "scale"


class Status(StrEnum):
    """The answer to a question; passed is always the good side."""

    PASSED = "passed"
    FAILED = "failed"
    UNKNOWN = "unknown"


class Reason(StrEnum):
    """Reasons for a verdict, as codes."""

    PASSED = "passed"
    SEARCH_ENDED = "search_ended"
    TORQUE_UNEXPLAINED = "torque_unexplained"
    RESIDUAL_COLOURED = "residual_coloured"
    RESIDUAL_REPEATS = "residual_repeats"
    RESIDUAL_FOLLOWS_MOTION = "residual_follows_motion"
    ONLY_SUMS = "only_sums"
    AT_BOUND = "at_bound"
    FRICTION_NEGATIVE = "friction_negative"
    STIFFNESS_NOT_SHOWN = "stiffness_not_shown"
    LOOP_AS_DECLARED = "loop_as_declared"
    LOOP_NOT_AS_DECLARED = "loop_not_as_declared"
    SPRING_NOT_LINEAR = "spring_not_linear"
    FORCE_FOLLOWS_POSITION = "force_follows_position"
    LOAD_NOT_RIGID = "load_not_rigid"
    FRICTION_NOT_AS_MODELLED = "friction_not_as_modelled"
    MISFIT_IN_PART = "misfit_in_part"
    CAUSE_FOUND = "cause_found"
    NO_CAUSE_FOUND = "no_cause_found"
    RECORD_TOO_SHORT = "record_too_short"
    HARDLY_MOVES = "hardly_moves"
    NOT_TESTED = "not_tested"
    CHECK_FAILED = "check_failed"
    MOTION_MEASURED = "motion_measured"
    SCALE_DECLARED = "scale_declared"
    SCALE_KNOWN = "scale_known"
    RECORDS_DISAGREE = "records_disagree"
    DRIFTS = "drifts"
    ENCODER_LAG = "encoder_lag"
    WIDE_INTERVAL = "wide_interval"
    NO_INTERVAL = "no_interval"


AGAINST_EVERY_VALUE = (
    Reason.SEARCH_ENDED,
    Reason.TORQUE_UNEXPLAINED,
    Reason.CAUSE_FOUND,
    Reason.RESIDUAL_FOLLOWS_MOTION,
    Reason.FRICTION_NEGATIVE,
)
"""Reasons of a failed check, but that of the loop, that speak against every value of the estimate."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question.

    Attributes:
        reasons: why, at least one; a limitation of the record is a reason, too, with a code of its own.
    """

    in_json = "good said"
    subject: Subject
    status: Status
    reasons: tuple[Message, ...]

    @classmethod
    def of(cls, subject: Subject, good: bool | None, *reasons: Message) -> Verdict:
        """Return the verdict of a test that passed, failed, or (None) was impossible."""
        status = Status.UNKNOWN if good is None else Status.PASSED if good else Status.FAILED
        return cls(subject, status, reasons)

    @property
    def good(self) -> bool | None:
        """True if passed, False if failed, None if undecided."""
        return None if self.status is Status.UNKNOWN else self.status is Status.PASSED

    @property
    def said(self) -> str:
        """The reasons as one sentence."""
        return "; ".join(reason.words for reason in self.reasons)


def verdict_of(
    subject: Subject, good: bool | None, code: Reason, said: str, values: Mapping[str, object] | None = None
) -> Verdict:
    """Return a verdict with one reason: the code, or that it passed; `good` is None where nothing could be tested."""
    return Verdict.of(subject, good, Message(Reason.PASSED if good else code, said, values or {}))


def skip_test(subject: Subject, why: str, axes: Sequence[str] = ()) -> Verdict:
    """Verdict for a question that was not tested, or not for some axes, with the reason."""
    return verdict_of(subject, None, Reason.NOT_TESTED, why, {"axes": list(axes)} if axes else None)


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """The softest admissible spring at one load share.

    Attributes:
        share: of the load in the inertia.
        stiffness: K12 is above it, with 95 % confidence; None where the record bounds nothing at this share.
        frequency: free-free, Hz, at that stiffness.
    """

    share: float
    stiffness: float | None
    frequency: float | None


@dataclass(frozen=True, slots=True)
class SpringVerdict:
    """Whether the records show the spring of a robot's joint.

    Attributes:
        joint: its name.
        shown: whether they do.
        stiffness: N m/rad or N/m; None where it is refused. deviation: of it, one standard deviation.
        at_least: the stiffness that it has at least, two standard deviations of its compliance away.
        unit: of these, N m/rad or N/m.
    """

    joint: str
    shown: bool
    stiffness: float | None
    deviation: float | None
    at_least: float
    unit: str = "N m/rad"


@dataclass(frozen=True, slots=True)
class Widening:
    """A reason for wider intervals.

    Attributes:
        by: how much it may move each parameter, by name, as one deviation.
        warning: of the estimate; none where it is empty.
    """

    by: Mapping[str, float]
    warning: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CheckResults:
    """The results of the checks of a fit.

    Attributes:
        verdicts: which replace those of the method on the same subjects.
        widenings: of the intervals.
        diagnosis: of loop, log and residual, axis by axis; None where it could not be made.
    """

    verdicts: tuple[Verdict, ...] = ()
    widenings: tuple[Widening, ...] = ()
    diagnosis: Documented | None = None


def assemble(fit: Estimate, checked: CheckResults | None = None) -> Estimate:
    """Return an estimate as it is given back: with its checks, without the values that no record determines.

    Args:
        fit: the result of the method.
        checked: the results of the checks, see `jointid.diagnostics.identify.run_checks`.
    """
    checked, known = checked or CheckResults(), fit.checks.known
    undetermined, rows = {*fit.undetermined, *(() if known is None else known.undetermined)}, []
    for p in fit.params.rows:
        wide = max((w.by.get(p.name, 0.0) for w in checked.widenings), default=0.0) if p.stderr else 0.0
        lost = p.name in undetermined
        rows.append(replace(p, value=None, stderr=None) if lost else replace(p, lack_of_fit=max(p.lack_of_fit, wide)))
    every = {verdict.subject: verdict for verdict in (*fit.checks.verdicts, *checked.verdicts)}
    warnings = (widening.warning for widening in checked.widenings if widening.warning)
    checks = replace(
        fit.checks,
        verdicts=tuple(every.values()),
        warnings=(*fit.checks.warnings, *warnings),
        diagnosis=checked.diagnosis,
    )
    params = replace(fit.params, rows=tuple(rows))
    return judged(type(fit)(params, fit.fit, checks, fit.data, fit.settings, fit.robot))


def judged(estimate: Estimate) -> Estimate:
    """Return an estimate with its verdicts; one that it has already stands, but those on solver and fit."""
    found = {verdict.subject: verdict for verdict in _judge(estimate)}
    given = {v.subject: v for v in estimate.checks.verdicts if v.subject not in (Subject.SOLVER, Subject.FIT)}
    return replace(estimate, checks=replace(estimate.checks, verdicts=tuple((found | given).values())))


def _judge(estimate: Estimate) -> Iterator[Verdict]:
    fit, checks = estimate.fit, estimate.checks
    yield verdict_of(Subject.SOLVER, fit.converged, Reason.SEARCH_ENDED, fit.stop)
    errors = fit.axis_errors or {"": fit.filtered_error}
    worst = max(errors, key=lambda axis: errors[axis])
    said = f"{number(100 * errors[worst], 2)} % of the {estimate.signal}{' of ' * bool(worst)}{worst} is not explained"
    explained = errors[worst] <= POOR_FIT  # an error that is no number is not
    yield verdict_of(Subject.FIT, explained, Reason.TORQUE_UNEXPLAINED, said, {"remaining": errors[worst]})
    if fit.residuals is not None:
        yield from _judge_residual(fit.residuals)
    if checks.known is not None and checks.known.limitations:
        yield Verdict.of(Subject.IDENTIFIABILITY, False, *checks.known.limitations)
    elif checks.known is not None:
        said = "every parameter is distinguished from 0 and from the others"
        yield verdict_of(Subject.IDENTIFIABILITY, True, Reason.ONLY_SUMS, said)
    touched = [p.name for p in estimate.params.rows if p.at_bound is not None]
    said = f"{join(touched or ['no parameter'])} at a bound, where the record is not followed"
    yield verdict_of(Subject.BOUNDS, not touched, Reason.AT_BOUND, said, {"parameters": touched} if touched else None)
    for subject, compared, code in (
        (Subject.AGREEMENT, checks.agreement, Reason.RECORDS_DISAGREE),
        (Subject.DRIFT, checks.drift, Reason.DRIFTS),
    ):
        if compared is not None and compared.p_value is not None:
            yield verdict_of(subject, not compared.differs, code, str(compared), {"parameters": [*compared.names]})
    if checks.encoder_lag is not None:
        lag = checks.encoder_lag.lag
        said = f"{checks.encoder_lag.late} seems {number(1e3 * lag, 2)} ms late, which hides the spring"
        hidden = {"parameters": ["stiffness", "damping"], "lag": lag}
        yield verdict_of(Subject.ENCODERS, False, Reason.ENCODER_LAG, said, hidden)
    if estimate.robot is not None and estimate.robot.springs:
        refused = [one for one in estimate.robot.springs if not one.shown]
        said = "{0.joint}: the records do not show a spring; its stiffness is at least {0.at_least:.3g} {0.unit}"
        yield springs_verdict([said.format(one) for one in refused])


def _judge_residual(report: ResidualReport) -> Iterator[Verdict]:
    """Yield the verdicts on whiteness and on the repeatable part of the residual."""
    white, repeats = report.whiteness, report.repeatable
    if white is None:
        yield skip_test(Subject.WHITENESS, "too few rows to say")
    else:
        values = {"statistic": white.statistic, "lags": white.lags, "p_value": white.p_value}
        yield verdict_of(Subject.WHITENESS, white.white, Reason.RESIDUAL_COLOURED, str(white), values)
    if repeats is None or repeats.p_value is None:
        yield skip_test(Subject.REPEATABLE, "not examined" if repeats is None else str(repeats))
    else:
        sizes = {"rms": repeats.rms, "share": repeats.share, "p_value": repeats.p_value}
        yield verdict_of(Subject.REPEATABLE, not repeats.significant, Reason.RESIDUAL_REPEATS, str(repeats), sizes)


def negative_friction(axes: Sequence[str]) -> tuple[Verdict, ...]:
    """Return the verdict on axes whose friction is negative by more than its interval; none without any."""
    if not axes:
        return ()
    said = f"the friction of {join(axes)} is negative: check the signs of torque, motor position and gear"
    return (verdict_of(Subject.BOUNDS, False, Reason.FRICTION_NEGATIVE, said, {"parameters": [*axes]}),)


def springs_verdict(refused: Sequence[str], shown: str = "the record shows every spring") -> Verdict:
    """Return the verdict on springs; `refused` has a sentence for each reason or spring that is not shown."""
    reasons = [Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in refused] or [Message(Reason.PASSED, shown)]
    return Verdict.of(Subject.STIFFNESS, not refused, *reasons)


def scale_verdict(known: Sequence[str], lost: Sequence[str] = (), *, identified: bool = False) -> Verdict:
    """Verdict on the scale of a torque that is computed from the controller.

    Args:
        known: fixed parameters other than 0, which tell it.
        lost: parameters that the unknown content of an integral leaves without an interval.
        identified: whether the gain is free.
    """
    code = Reason.SCALE_KNOWN if known else Reason.SCALE_DECLARED
    said = "so a common factor of its gains is invisible: gains 10 % too large make every parameter 10 % too large"
    if known:
        said = f"and {join(known)} tells its scale{', which the free gain takes up' if identified else ': free gain'}"
    said = f"the torque is computed from the declared controller and the motor position, {said}"
    if lost:
        said += f"; {join(lost)} includes what the integral held at the first sample"
    values = {"parameters": [*known], "undetermined": [*lost]}
    return Verdict.of(Subject.SCALE, True if known else None, Message(code, said, values))
