"""Verdicts: one question each about an identification, with status and coded reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from jointid.common.messages import Message
from jointid.common.text import join
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.residual_tests import ResidualReport

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
    STIFFNESS = "stiffness"
    LOOP = "loop"
    SCALE = "scale"


class Status(StrEnum):
    """The answer to a question; passed is always the good side."""

    PASSED = "passed"
    FAILED = "failed"
    UNKNOWN = "unknown"

    @classmethod
    def of(cls, good: bool | None) -> Status:
        """Status of a test that passed, failed, or (None) was impossible."""
        return cls.UNKNOWN if good is None else cls.PASSED if good else cls.FAILED


class Reason(StrEnum):
    """Reasons for a verdict, as codes."""

    SEARCH_ENDED = "search_ended"
    TORQUE_EXPLAINED = "torque_explained"
    TORQUE_UNEXPLAINED = "torque_unexplained"
    RESIDUAL_WHITE = "residual_white"
    RESIDUAL_COLOURED = "residual_coloured"
    TOO_FEW_ROWS = "too_few_rows"
    RESIDUAL_REPEATS = "residual_repeats"
    NOTHING_REPEATS = "nothing_repeats"
    NO_PLACE_REVISITED = "no_place_revisited"
    RESIDUAL_FOLLOWS_MOTION = "residual_follows_motion"
    ALL_DETERMINED = "all_determined"
    ONLY_SUMS = "only_sums"
    NONE_AT_BOUND = "none_at_bound"
    AT_BOUND = "at_bound"
    FRICTION_NEGATIVE = "friction_negative"
    STIFFNESS_SHOWN = "stiffness_shown"
    STIFFNESS_NOT_SHOWN = "stiffness_not_shown"
    LOOP_AS_DECLARED = "loop_as_declared"
    LOOP_NOT_AS_DECLARED = "loop_not_as_declared"
    SPRING_NOT_LINEAR = "spring_not_linear"
    FORCE_FOLLOWS_POSITION = "force_follows_position"
    LOAD_NOT_RIGID = "load_not_rigid"
    FRICTION_NOT_AS_MODELLED = "friction_not_as_modelled"
    LAW_UNDECIDED = "law_undecided"
    CAUSE_FOUND = "cause_found"
    NO_CAUSE_FOUND = "no_cause_found"
    RECORD_TOO_SHORT = "record_too_short"
    HARDLY_MOVES = "hardly_moves"
    NOT_TESTED = "not_tested"
    CHECK_FAILED = "check_failed"
    MOTION_MEASURED = "motion_measured"
    SCALE_DECLARED = "scale_declared"
    SCALE_KNOWN = "scale_known"


MOTION_MEASURED = (
    "the motion was measured under control: what disturbs it biases these values; identify by DIDIM, or with the "
    "reference as instrument"
)
"""The warning of a method that takes a measured motion as free of the error, where no instrument tests that."""


AGAINST_EVERY_VALUE = (Reason.CAUSE_FOUND, Reason.RESIDUAL_FOLLOWS_MOTION, Reason.FRICTION_NEGATIVE)
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

    @property
    def good(self) -> bool | None:
        """True if passed, False if failed, None if undecided."""
        return None if self.status is Status.UNKNOWN else self.status is Status.PASSED

    @property
    def said(self) -> str:
        """The reasons as one sentence."""
        return "; ".join(reason.words for reason in self.reasons)


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


def solver_verdict(stop: str, converged: bool) -> Verdict:
    """Return the verdict on the search's end; `stop` says how it ended."""
    return _judge(Subject.SOLVER, converged, Reason.SEARCH_ENDED, stop)


def fit_verdict(errors: Mapping[str, float]) -> Verdict:
    """Verdict on the share of the filtered torque of each axis that remains; a joint alone has the name ""."""
    worst = max(errors, key=lambda axis: errors[axis])
    of = f" of {worst}" if worst else ""
    said = f"{100 * errors[worst]:.2f} % of the filtered torque{of} remains"
    values = {"remaining": dict(errors) if worst else errors[worst]}
    if errors[worst] <= POOR_FIT:
        return _judge(Subject.FIT, True, Reason.TORQUE_EXPLAINED, said, values)
    said += ", more than a right model leaves"
    return _judge(Subject.FIT, False, Reason.TORQUE_UNEXPLAINED, said, values)


def residual_verdicts(report: ResidualReport) -> tuple[Verdict, Verdict]:
    """Verdicts on whiteness and on the repeatable part of the residual."""
    white, repeats = report.whiteness, report.repeatable
    if white is None:
        noise = _judge(Subject.WHITENESS, None, Reason.TOO_FEW_ROWS, "too few rows to say")
    else:
        code = Reason.RESIDUAL_WHITE if white.white else Reason.RESIDUAL_COLOURED
        values = {"statistic": white.statistic, "lags": white.lags, "p_value": white.p_value}
        noise = _judge(Subject.WHITENESS, white.white, code, str(white), values)
    if repeats is None:
        return noise, skip_test(Subject.REPEATABLE, "not examined")
    if repeats.p_value is None:
        return noise, _judge(Subject.REPEATABLE, None, Reason.NO_PLACE_REVISITED, str(repeats))
    code = Reason.RESIDUAL_REPEATS if repeats.significant else Reason.NOTHING_REPEATS
    sizes = {"rms": repeats.rms, "unit": repeats.unit, "share": repeats.share, "p_value": repeats.p_value}
    return noise, _judge(Subject.REPEATABLE, not repeats.significant, code, str(repeats), sizes)


def identifiability_verdict(known: Identifiability) -> Verdict:
    """Verdict on whether the record determines every parameter."""
    if known.limitations:
        return Verdict(Subject.IDENTIFIABILITY, Status.FAILED, known.limitations)
    said = "every parameter is distinguished from 0 and from the others"
    return _judge(Subject.IDENTIFIABILITY, True, Reason.ALL_DETERMINED, said)


def bounds_verdict(touched: Sequence[str], negative: Sequence[str] = ()) -> Verdict:
    """Verdict on parameters at a bound; `negative` are axes whose friction is negative by more than its interval."""
    if negative:
        said = f"the friction of {join(negative)} is negative: check the signs of torque, motor position and gear"
        return _judge(Subject.BOUNDS, False, Reason.FRICTION_NEGATIVE, said, {"parameters": [*negative]})
    if not touched:
        return _judge(Subject.BOUNDS, True, Reason.NONE_AT_BOUND, "no parameter is held by a bound")
    said = f"{join(touched)} at a bound, where the record is not followed"
    return _judge(Subject.BOUNDS, False, Reason.AT_BOUND, said, {"parameters": [*touched]})


def springs_verdict(refused: Sequence[str], shown: str = "the record shows every spring") -> Verdict:
    """Verdict on springs; `refused` has a sentence for each reason or spring that the record does not show."""
    if not refused:
        return _judge(Subject.STIFFNESS, True, Reason.STIFFNESS_SHOWN, shown)
    reasons = tuple(Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in refused)
    return Verdict(Subject.STIFFNESS, Status.FAILED, reasons)


def scale_verdict(known: Sequence[str], lost: Sequence[str] = (), *, identified: bool = False) -> Verdict:
    """Verdict on the scale of a torque that is computed from the controller.

    Args:
        known: fixed parameters other than 0, which tell it.
        lost: parameters that the unknown content of an integral leaves without an interval.
        identified: whether the gain is free.
    """
    said = "the torque is computed from the declared controller and the motor position, "
    if known:
        code, said = Reason.SCALE_KNOWN, f"{said}and {join(known)} tells its scale"
        said += ", which the free gain takes up" if identified else ": free gain to identify it"
    else:
        code = Reason.SCALE_DECLARED
        said += "so gains 10 % too large make every parameter 10 % too large: check their units"
    if lost:
        said += f"; {join(lost)} includes what the integral held at the first sample"
    values = {"parameters": [*known], "undetermined": [*lost]}
    return _judge(Subject.SCALE, True if known else None, code, said, values)


def skip_test(subject: Subject, why: str, axes: Sequence[str] = ()) -> Verdict:
    """Verdict for a question that was not tested, or not for some axes, with the reason."""
    return _judge(subject, None, Reason.NOT_TESTED, why, {"axes": list(axes)} if axes else None)


def _judge(
    subject: Subject, good: bool | None, code: Reason, said: str, values: Mapping[str, object] | None = None
) -> Verdict:
    return Verdict(subject, Status.of(good), (Message(code, said, values or {}),))
