"""Checks: answers to questions about an estimate, as coded statements; and the estimate with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.document import Documented
from jointid.common.messages import Message
from jointid.common.text import join, number
from jointid.uncertainty.model_tests import Whiteness
from jointid.uncertainty.position_dependent_error import Repeatable

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate

POOR_FIT = 0.15
"""Share of the filtered torque that a right model leaves at most: the EMPS axis leaves 0.045, the paper's 0.08."""

_TWO = 2.0  # standard deviations
_DRIVING = ("viscous",), ("viscous_forwards",), ("viscous_backwards",), ("coulomb",), ("coulomb", "stribeck_force")


class Subject(StrEnum):
    """The question."""

    SOLVER = "solver"
    FIT = "fit"
    WHITENESS = "whiteness"
    REPEATABLE = "repeatable residual"
    IDENTIFIABILITY = "identifiability"
    INSTRUMENTS = "instruments"
    BOUNDS = "bounds"
    AGREEMENT = "agreement"
    DRIFT = "drift"
    ENCODERS = "encoders"
    STIFFNESS = "stiffness"
    LOOP = "loop"
    SCALE = "scale"


class Reason(StrEnum):
    """Reasons for an answer, as codes."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Message):
    """A statement that answers a question about an estimate; a question may have several.

    Attributes:
        name: the question.
        passed: True on the good side, False where it failed, None where nothing could be tested.
    """

    name: Subject
    passed: bool | None


def check_of(
    name: Subject, passed: bool | None, code: Reason, said: str, values: Mapping[str, object] | None = None
) -> Check:
    """Return a check of one statement: the code, or that it passed, or None that nothing could be tested."""
    codes = {True: Reason.PASSED, False: code, None: Reason.NOT_TESTED}
    return Check(codes[passed], said, values or {}, name=name, passed=passed)


def checks_of(name: Subject, passed: bool | None, *said: Message) -> tuple[Check, ...]:
    """Return the statements that answer a question, the most important one first."""
    return tuple(Check(one.code, one.words, one.values, one.clause, name=name, passed=passed) for one in said)


def skip_test(name: Subject, why: str, axes: Sequence[str] = ()) -> Check:
    """Return the check of a question that was not tested, or not for some axes, with the reason."""
    return check_of(name, None, Reason.NOT_TESTED, why, {"axes": list(axes)} if axes else None)


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


Widening: TypeAlias = tuple[Mapping[str, float], str]
"""By how much something may move each parameter, by name, as one deviation; and a warning, or nothing."""


Checked: TypeAlias = tuple[tuple[Check, ...], Sequence[Widening], Documented | None]
"""The results of checks: which replace those of the method on the same questions, what widens, and the diagnosis."""


def assemble(
    fit: Estimate,
    checks: tuple[Check, ...] = (),
    widenings: Sequence[Widening] = (),
    diagnosis: Documented | None = None,
) -> Estimate:
    """Return an estimate as it is given back: with its checks, without the values that no record determines.

    Args:
        fit: the result of the method.
        checks: which replace those of the method on the same questions.
        widenings: of the intervals.
        diagnosis: of loop, log and residual, axis by axis; None where it was not made.
    """
    undetermined, rows = {*fit.undetermined, *(() if fit.known is None else fit.known.undetermined)}, []
    for p in fit.rows:
        wide = max((by.get(p.name, 0.0) for by, _ in widenings), default=0.0) if p.stderr else 0.0
        lost = p.name in undetermined
        rows.append(replace(p, value=None, stderr=None) if lost else replace(p, lack_of_fit=max(p.lack_of_fit, wide)))
    return judged(
        replace(
            fit,
            rows=tuple(rows),
            checks=_replace(fit.checks, checks),
            warnings=(*fit.warnings, *(warning for _, warning in widenings if warning)),
            diagnosis=diagnosis,
            problem=None, x=None, records=(), solved=None, undetermined=(), shifts=(), window=None,
        )
    )  # fmt: skip


def judged(estimate: Estimate) -> Estimate:
    """Return an estimate with what its own numbers answer; an answer that it has stands, but on solver and fit."""
    given = [one for one in estimate.checks if one.name not in (Subject.SOLVER, Subject.FIT)]
    return replace(estimate, checks=_replace([*_judge(estimate)], given))


def _replace(checks: Sequence[Check], by: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks, those on the questions of others replaced by these."""
    asked = {one.name for one in by}
    return (*(one for one in checks if one.name not in asked), *by)


def _judge(estimate: Estimate) -> Iterator[Check]:
    fit, known, agreement = estimate.fit, estimate.known, estimate.agreement
    yield check_of(Subject.SOLVER, fit.converged, Reason.SEARCH_ENDED, fit.stop)
    errors = fit.axis_errors or {"": fit.filtered_error}
    worst = max(errors, key=lambda axis: errors[axis])
    said = f"{number(100 * errors[worst], 2)} % of the {estimate.signal}{' of ' * bool(worst)}{worst} is not explained"
    explained = errors[worst] <= POOR_FIT  # an error that is no number is not
    yield check_of(Subject.FIT, explained, Reason.TORQUE_UNEXPLAINED, said, {"remaining": errors[worst]})
    if known is not None and known.limitations:
        yield from checks_of(Subject.IDENTIFIABILITY, False, *known.limitations)
    elif known is not None:
        said = "every parameter is distinguished from 0 and from the others"
        yield check_of(Subject.IDENTIFIABILITY, True, Reason.ONLY_SUMS, said)
    yield _judge_bounds(estimate)
    if agreement is not None and agreement.p_value is not None:
        name, code = Subject.AGREEMENT, Reason.RECORDS_DISAGREE
        if estimate.data.windows is not None:
            name, code = Subject.DRIFT, Reason.DRIFTS
        yield check_of(name, not agreement.differs, code, str(agreement), {"parameters": [*agreement.names]})
    springs = [row for row in estimate.rows if row.axis and row.name.endswith(".stiffness") and row.free]
    if springs:
        said = "{0.axis}: the records do not show a spring; its stiffness is at least {0.lower_bound:.3g} {0.unit}"
        yield from springs_checks([said.format(row) for row in springs if row.value is None])


def _judge_bounds(estimate: Estimate) -> Check:
    """Return the check on parameters at a bound, and on axes that their friction would drive."""
    rows = {row.name: row for row in estimate.rows if row.value is not None}
    driving = []
    for axis in dict.fromkeys(row.axis for row in estimate.rows if row.axis):
        for sums in _DRIVING:
            names = [name for name in (f"{axis}.{part}" for part in sums) if name in rows]
            spread = estimate.covariance_of(names).std_of(np.ones(len(names))) if names else 0.0
            if sum(rows[name].value or 0.0 for name in names) < -_TWO * spread:
                driving.append(axis)
    if driving:
        axes = [*dict.fromkeys(driving)]
        said = f"the friction of {join(axes)} is negative: check the signs of torque, motor position and gear"
        return check_of(Subject.BOUNDS, False, Reason.FRICTION_NEGATIVE, said, {"parameters": axes})
    touched = [row.name for row in estimate.rows if row.at_bound is not None]
    said = f"{join(touched or ['no parameter'])} at a bound, where the record is not followed"
    values = {"parameters": touched} if touched else None
    return check_of(Subject.BOUNDS, not touched, Reason.AT_BOUND, said, values)


def residual_checks(white: Whiteness | None, repeats: Repeatable) -> tuple[Check, Check]:
    """Return the checks on whiteness, None with too few rows, and on the repeatable part of the residual."""
    coloured = skip_test(Subject.WHITENESS, "too few rows to say")
    if white is not None:
        coloured = check_of(Subject.WHITENESS, white.white, Reason.RESIDUAL_COLOURED, str(white), asdict(white))
    once = None if repeats.p_value is None else not repeats.significant
    return coloured, check_of(Subject.REPEATABLE, once, Reason.RESIDUAL_REPEATS, str(repeats), asdict(repeats))


def springs_checks(refused: Sequence[str], shown: str = "the record shows every spring") -> tuple[Check, ...]:
    """Return the checks on springs; `refused` has a sentence for each reason or spring that is not shown."""
    if not refused:
        return (check_of(Subject.STIFFNESS, True, Reason.PASSED, shown),)
    return checks_of(Subject.STIFFNESS, False, *(Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in refused))


def scale_check(known: Sequence[str], lost: Sequence[str] = (), *, identified: bool = False) -> Check:
    """Return the check on the scale of a torque that is computed from the controller.

    Args:
        known: fixed parameters other than 0, which tell it.
        lost: parameters that the unknown content of an integral leaves without an interval.
        identified: whether the gain is free.
    """
    said = "so a common factor of its gains is invisible: gains 10 % too large make every parameter 10 % too large"
    if known:
        said = f"and {join(known)} tells its scale{', which the free gain takes up' if identified else ': free gain'}"
    said = f"the torque is computed from the declared controller and the motor position, {said}"
    if lost:
        said += f"; {join(lost)} includes what the integral held at the first sample"
    values, code = (
        {"parameters": [*known], "undetermined": [*lost]},
        Reason.SCALE_KNOWN if known else Reason.SCALE_DECLARED,
    )
    return Check(code, said, values, name=Subject.SCALE, passed=True if known else None)
