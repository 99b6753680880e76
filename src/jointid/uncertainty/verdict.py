"""Verdicts: one question each about an identification, a status, and coded reasons for it.

There is no single success. A search may end well on a model that does not fit; a good fit may leave a stiffness
unknown. Each question keeps its own answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from jointid.common.messages import Message, joined
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.residual_tests import ResidualReport

_POOR = 0.15  # of the filtered torque: the EMPS axis leaves 0.045, the paper's 0.08


class Subject(StrEnum):
    """The question."""

    SOLVER = "solver"
    FIT = "fit"
    WHITENESS = "whiteness"
    REPEATABLE = "repeatable residual"
    IDENTIFIABILITY = "identifiability"
    BOUNDS = "bounds"
    STIFFNESS = "stiffness"
    LOOP = "loop"


class Status(StrEnum):
    """The answer to a question; passed is always the good side."""

    PASSED = "passed"
    FAILED = "failed"
    UNKNOWN = "unknown"

    @classmethod
    def of(cls, good: bool | None) -> Status:
        """Return the status of a test that passed, did not, or (None) was not possible."""
        return cls.UNKNOWN if good is None else cls.PASSED if good else cls.FAILED


class Reason(StrEnum):
    """Why a verdict is what it is."""

    SEARCH_ENDED = "search_ended"
    TORQUE_EXPLAINED = "torque_explained"
    TORQUE_UNEXPLAINED = "torque_unexplained"
    RESIDUAL_WHITE = "residual_white"
    RESIDUAL_COLOURED = "residual_coloured"
    TOO_FEW_ROWS = "too_few_rows"
    RESIDUAL_REPEATS = "residual_repeats"
    NOTHING_REPEATS = "nothing_repeats"
    NO_PLACE_REVISITED = "no_place_revisited"
    ALL_DETERMINED = "all_determined"
    ONLY_SUMS = "only_sums"
    NONE_AT_BOUND = "none_at_bound"
    AT_BOUND = "at_bound"
    STIFFNESS_SHOWN = "stiffness_shown"
    STIFFNESS_NOT_SHOWN = "stiffness_not_shown"
    LOOP_AS_DECLARED = "loop_as_declared"
    LOOP_NOT_AS_DECLARED = "loop_not_as_declared"
    NOT_TESTED = "not_tested"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question.

    Attributes:
        subject: the question.
        status: the answer.
        reasons: why, at least one; a limitation of the record is a reason, too, with a code of its own.
    """

    subject: Subject
    status: Status
    reasons: tuple[Message, ...]

    @property
    def good(self) -> bool | None:
        """True if it passed, False if not, None where it cannot be said."""
        return None if self.status is Status.UNKNOWN else self.status is Status.PASSED

    @property
    def said(self) -> str:
        """The reasons as one sentence."""
        return joined(self.reasons)

    def __str__(self) -> str:
        """Return the verdict as lines of a table: question, yes or no, reasons."""
        mark = {True: "yes", False: "no", None: "?"}[self.good]
        return f"{self.subject:20} {mark:4} " + f",\n{'':26}".join(map(str, self.reasons))


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """The softest spring a record allows at one load share.

    Attributes:
        share: of the load in the inertia.
        stiffness: K12 is above it, with 95 % confidence; None where the record bounds nothing at this share.
        frequency: free-free, Hz, at that stiffness.
    """

    share: float
    stiffness: float | None
    frequency: float | None


def solver_verdict(stop: str, converged: bool) -> Verdict:
    """Return whether the search converged; `stop` says how it ended."""
    return Verdict(Subject.SOLVER, Status.of(converged), (Message(Reason.SEARCH_ENDED, stop),))


def fit_verdict(report: ResidualReport) -> Verdict:
    """Return whether the model explains as much of the torque as a right one does."""
    said, values = f"{100 * report.relative:.2f} % of the filtered torque remains", {"remaining": report.relative}
    if report.relative <= _POOR:
        return Verdict(Subject.FIT, Status.PASSED, (Message(Reason.TORQUE_EXPLAINED, said, values),))
    said += ", more than a right model leaves"
    return Verdict(Subject.FIT, Status.FAILED, (Message(Reason.TORQUE_UNEXPLAINED, said, values),))


def residual_verdicts(report: ResidualReport) -> tuple[Verdict, ...]:
    """Return whether the residual is white, and whether it repeats with the motion."""
    return _whiteness(report), _repeatable(report)


def _whiteness(report: ResidualReport) -> Verdict:
    white = report.whiteness
    if white is None:
        return _unknown(Subject.WHITENESS, Reason.TOO_FEW_ROWS, "too few rows to say")
    code = Reason.RESIDUAL_WHITE if white.white else Reason.RESIDUAL_COLOURED
    values = {"statistic": white.statistic, "lags": white.lags, "p_value": white.p_value}
    return Verdict(Subject.WHITENESS, Status.of(white.white), (Message(code, str(white), values),))


def _repeatable(report: ResidualReport) -> Verdict:
    repeats = report.repeatable
    if repeats is None:
        return _unknown(Subject.REPEATABLE, Reason.NOT_TESTED, "not looked at")
    if repeats.p_value is None:
        return _unknown(Subject.REPEATABLE, Reason.NO_PLACE_REVISITED, str(repeats))
    code = Reason.RESIDUAL_REPEATS if repeats.significant else Reason.NOTHING_REPEATS
    values = {"rms": repeats.rms, "unit": repeats.unit, "share": repeats.share, "p_value": repeats.p_value}
    return Verdict(Subject.REPEATABLE, Status.of(not repeats.significant), (Message(code, str(repeats), values),))


def identifiability_verdict(known: Identifiability) -> Verdict:
    """Return whether the record determines every parameter."""
    if known.limitations:
        return Verdict(Subject.IDENTIFIABILITY, Status.FAILED, known.limitations)
    said = "every parameter is told from 0 and from the others"
    return Verdict(Subject.IDENTIFIABILITY, Status.PASSED, (Message(Reason.ALL_DETERMINED, said),))


def only_sums_verdict() -> Verdict:
    """Return that of a joint whose stiffness is refused, only the sums of both sides are determined."""
    said = "only the sums of both sides are told, not how they divide"
    return Verdict(Subject.IDENTIFIABILITY, Status.FAILED, (Message(Reason.ONLY_SUMS, said),))


def bounds_verdict(touched: Sequence[str]) -> Verdict:
    """Return whether a parameter is held by a bound."""
    if not touched:
        said = "no parameter is held by a bound"
        return Verdict(Subject.BOUNDS, Status.PASSED, (Message(Reason.NONE_AT_BOUND, said),))
    said = f"{', '.join(touched)} at a bound, where it does not follow the record"
    return Verdict(Subject.BOUNDS, Status.FAILED, (Message(Reason.AT_BOUND, said, {"parameters": list(touched)}),))


def not_tested(subject: Subject, why: str) -> Verdict:
    """Return that a question was not looked at, and why."""
    return _unknown(subject, Reason.NOT_TESTED, why)


def _unknown(subject: Subject, code: Reason, said: str) -> Verdict:
    return Verdict(subject, Status.UNKNOWN, (Message(code, said),))
