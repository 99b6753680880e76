"""The verdicts that the parts of an estimate lead to: one question each, of a joint and of a robot alike."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from jointid.common.messages import Message
from jointid.common.text import join, number
from jointid.estimation.result.verdict import POOR_FIT, Reason, Status, Subject, Verdict, skip_test, verdict_of
from jointid.uncertainty.residual_tests import ResidualReport

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate


def judge(estimate: Estimate) -> tuple[Verdict, ...]:
    """Return the verdicts of an estimate; one that it has already stands, but those on solver and fit."""
    found = {verdict.subject: verdict for verdict in _of_parts(estimate)}
    given = {v.subject: v for v in estimate.checks.verdicts if v.subject not in (Subject.SOLVER, Subject.FIT)}
    return tuple((found | given).values())


def _of_parts(estimate: Estimate) -> Iterator[Verdict]:
    fit, checks = estimate.fit, estimate.checks
    yield verdict_of(Subject.SOLVER, fit.converged, Reason.SEARCH_ENDED, fit.stop)
    yield _of_fit(estimate)
    if fit.residuals is not None:
        yield from _of_residual(fit.residuals)
    if checks.known is not None and checks.known.limitations:
        yield Verdict(Subject.IDENTIFIABILITY, Status.FAILED, checks.known.limitations)
    elif checks.known is not None:
        said = "every parameter is distinguished from 0 and from the others"
        yield verdict_of(Subject.IDENTIFIABILITY, True, Reason.ALL_DETERMINED, said)
    yield _of_bounds([p.name for p in estimate.params.rows if p.at_bound is not None])
    if checks.agreement is not None and checks.agreement.p_value is not None:
        code = Reason.RECORDS_DISAGREE if checks.agreement.differs else Reason.RECORDS_AGREE
        differ = {"parameters": [one.name for one in checks.agreement.parameters if one.differs]}
        yield verdict_of(Subject.AGREEMENT, not checks.agreement.differs, code, str(checks.agreement), differ)
    if checks.drift is not None and checks.drift.agreement is not None and checks.drift.agreement.p_value is not None:
        drifts = checks.drift.agreement.differs
        code, differ = Reason.DRIFTS if drifts else Reason.NO_DRIFT, {"parameters": [*checks.drift.names]}
        units = {p.name: p.unit for p in estimate.params.rows}
        yield verdict_of(Subject.DRIFT, not drifts, code, checks.drift.describe(units), differ)
    if checks.encoder_lag is not None:
        lag = f"{number(1e3 * checks.encoder_lag.lag, 2)} ms"
        said = f"{checks.encoder_lag.late} seems {lag} late, which hides the spring"
        hidden = {"parameters": ["stiffness", "damping"], "lag": checks.encoder_lag.lag}
        yield verdict_of(Subject.ENCODERS, False, Reason.ENCODER_LAG, said, hidden)
    if estimate.robot is not None and estimate.robot.springs:
        yield springs_verdict([str(spring) for spring in estimate.robot.springs if not spring.shown])


def _of_fit(estimate: Estimate) -> Verdict:
    """Return the verdict on the share of the filtered torque of each axis that remains."""
    errors = estimate.fit.axis_errors or {"": estimate.fit.filtered_error}
    worst = max(errors, key=lambda axis: errors[axis])
    of = f" of {worst}" if worst else ""
    said = f"{number(100 * errors[worst], 2)} % of the {estimate.signal}{of} is not explained"
    if errors[worst] <= POOR_FIT:  # an error that is no number is not
        return verdict_of(Subject.FIT, True, Reason.TORQUE_EXPLAINED, said, {"remaining": errors[worst]})
    return verdict_of(Subject.FIT, False, Reason.TORQUE_UNEXPLAINED, said, {"remaining": errors[worst]})


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


def _of_bounds(touched: Sequence[str]) -> Verdict:
    if not touched:
        return verdict_of(Subject.BOUNDS, True, Reason.NONE_AT_BOUND, "no parameter is held by a bound")
    said = f"{join(touched)} at a bound, where the record is not followed"
    return verdict_of(Subject.BOUNDS, False, Reason.AT_BOUND, said, {"parameters": [*touched]})


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
