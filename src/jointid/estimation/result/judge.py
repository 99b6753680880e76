"""The verdicts of an estimate, one question each, of a joint and of a robot alike; and the estimate with its checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from jointid.common.document import Documented
from jointid.common.messages import Message
from jointid.common.text import join, number
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import POOR_FIT, Reason, Status, Subject, Verdict, skip_test, verdict_of
from jointid.uncertainty.residual_tests import ResidualReport


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
    subjects = {v.subject for v in checked.verdicts}
    own = tuple(v for v in fit.checks.verdicts if v.subject not in subjects)
    warnings = (widening.warning for widening in checked.widenings if widening.warning)
    checks = replace(
        fit.checks,
        verdicts=(*own, *checked.verdicts),
        warnings=(*fit.checks.warnings, *warnings),
        diagnosis=checked.diagnosis,
    )
    found = Estimate(replace(fit.params, rows=tuple(rows)), fit.fit, checks, fit.data, fit.settings, fit.robot)
    return judged(found)


def judged(estimate: Estimate) -> Estimate:
    """Return an estimate with its verdicts; one that it has already stands, but those on solver and fit."""
    found = {verdict.subject: verdict for verdict in _of_parts(estimate)}
    given = {v.subject: v for v in estimate.checks.verdicts if v.subject not in (Subject.SOLVER, Subject.FIT)}
    return replace(estimate, checks=replace(estimate.checks, verdicts=tuple((found | given).values())))


def _of_parts(estimate: Estimate) -> Iterator[Verdict]:
    fit, checks = estimate.fit, estimate.checks
    yield verdict_of(Subject.SOLVER, fit.converged, Reason.SEARCH_ENDED, fit.stop)
    errors = fit.axis_errors or {"": fit.filtered_error}
    worst = max(errors, key=lambda axis: errors[axis])
    said = f"{number(100 * errors[worst], 2)} % of the {estimate.signal}{' of ' * bool(worst)}{worst} is not explained"
    explained = errors[worst] <= POOR_FIT  # an error that is no number is not
    code = Reason.TORQUE_EXPLAINED if explained else Reason.TORQUE_UNEXPLAINED
    yield verdict_of(Subject.FIT, explained, code, said, {"remaining": errors[worst]})
    if fit.residuals is not None:
        yield from _of_residual(fit.residuals)
    if checks.known is not None and checks.known.limitations:
        yield Verdict(Subject.IDENTIFIABILITY, Status.FAILED, checks.known.limitations)
    elif checks.known is not None:
        said = "every parameter is distinguished from 0 and from the others"
        yield verdict_of(Subject.IDENTIFIABILITY, True, Reason.ALL_DETERMINED, said)
    touched = [p.name for p in estimate.params.rows if p.at_bound is not None]
    said, code = "no parameter is held by a bound", Reason.NONE_AT_BOUND
    if touched:
        said, code = f"{join(touched)} at a bound, where the record is not followed", Reason.AT_BOUND
    yield verdict_of(Subject.BOUNDS, not touched, code, said, {"parameters": touched} if touched else None)
    for subject, compared, codes in (
        (Subject.AGREEMENT, checks.agreement, (Reason.RECORDS_AGREE, Reason.RECORDS_DISAGREE)),
        (Subject.DRIFT, checks.drift, (Reason.NO_DRIFT, Reason.DRIFTS)),
    ):
        if compared is not None and compared.p_value is not None:
            differ = {"parameters": [*compared.names]}
            yield verdict_of(subject, not compared.differs, codes[compared.differs], str(compared), differ)
    if checks.encoder_lag is not None:
        lag = f"{number(1e3 * checks.encoder_lag.lag, 2)} ms"
        said = f"{checks.encoder_lag.late} seems {lag} late, which hides the spring"
        hidden = {"parameters": ["stiffness", "damping"], "lag": checks.encoder_lag.lag}
        yield verdict_of(Subject.ENCODERS, False, Reason.ENCODER_LAG, said, hidden)
    if estimate.robot is not None and estimate.robot.springs:
        yield springs_verdict([str(spring) for spring in estimate.robot.springs if not spring.shown])


def _of_residual(report: ResidualReport) -> Iterator[Verdict]:
    """Yield the verdicts on whiteness and on the repeatable part of the residual."""
    white, repeats = report.whiteness, report.repeatable
    if white is None:
        yield verdict_of(Subject.WHITENESS, None, Reason.TOO_FEW_ROWS, "too few rows to say")
    else:
        code = Reason.RESIDUAL_WHITE if white.white else Reason.RESIDUAL_COLOURED
        values = {"statistic": white.statistic, "lags": white.lags, "p_value": white.p_value}
        yield verdict_of(Subject.WHITENESS, white.white, code, str(white), values)
    if repeats is None:
        yield skip_test(Subject.REPEATABLE, "not examined")
    elif repeats.p_value is None:
        yield verdict_of(Subject.REPEATABLE, None, Reason.NO_PLACE_REVISITED, str(repeats))
    else:
        code = Reason.RESIDUAL_REPEATS if repeats.significant else Reason.NOTHING_REPEATS
        sizes = {"rms": repeats.rms, "share": repeats.share, "p_value": repeats.p_value}
        yield verdict_of(Subject.REPEATABLE, not repeats.significant, code, str(repeats), sizes)


def negative_friction(axes: Sequence[str]) -> tuple[Verdict, ...]:
    """Return the verdict on axes whose friction is negative by more than its interval; none without any."""
    if not axes:
        return ()
    said = f"the friction of {join(axes)} is negative: check the signs of torque, motor position and gear"
    return (verdict_of(Subject.BOUNDS, False, Reason.FRICTION_NEGATIVE, said, {"parameters": [*axes]}),)


def springs_verdict(refused: Sequence[str], shown: str = "the record shows every spring") -> Verdict:
    """Return the verdict on springs; `refused` has a sentence for each reason or spring that is not shown."""
    if not refused:
        return verdict_of(Subject.STIFFNESS, True, Reason.STIFFNESS_SHOWN, shown)
    reasons = tuple(Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in refused)
    return Verdict(Subject.STIFFNESS, Status.FAILED, reasons)
