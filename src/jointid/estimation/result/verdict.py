"""Verdicts: one question each about an identification, with status and coded reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from jointid.common.messages import Message
from jointid.common.text import join

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
    RECORDS_AGREE = "records_agree"
    RECORDS_DISAGREE = "records_disagree"
    NO_DRIFT = "no_drift"
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
        said += "so a common factor of its gains is invisible: gains 10 % too large make every parameter 10 % too large"
    if lost:
        said += f"; {join(lost)} includes what the integral held at the first sample"
    values = {"parameters": [*known], "undetermined": [*lost]}
    return verdict_of(Subject.SCALE, True if known else None, code, said, values)


def skip_test(subject: Subject, why: str, axes: Sequence[str] = ()) -> Verdict:
    """Verdict for a question that was not tested, or not for some axes, with the reason."""
    return verdict_of(subject, None, Reason.NOT_TESTED, why, {"axes": list(axes)} if axes else None)


def verdict_of(
    subject: Subject, good: bool | None, code: Reason, said: str, values: Mapping[str, object] | None = None
) -> Verdict:
    """Return a verdict with one reason; `good` is None where nothing could be tested."""
    return Verdict(subject, Status.of(good), (Message(code, said, values or {}),))
