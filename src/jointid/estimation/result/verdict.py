"""Checks of an estimate, and the rule for relying on its value.

The asked value is the stiffness of a flexible joint, the inertia of a rigid one, and all parameters of a robot. One
rule decides whether to rely on it: no failed check moves it by more than two deviations. These already cover a
residual that is coloured or repeats, and a fault of the loop that moves a friction does not change the inertia.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.document import Documented
from jointid.common.messages import Message
from jointid.common.text import in_words, interval, join, number
from jointid.uncertainty.covariance import INTERVAL
from jointid.uncertainty.model_tests import Whiteness
from jointid.uncertainty.position_dependent_error import Repeatable

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate, EstimatedParameter

POOR_FIT = 0.15
"""Share of the filtered torque that a right model leaves at most: the EMPS axis leaves 0.045, the paper's 0.08."""

SLIGHT = 1e-3
"""Share of a value that no decision depends on; the log of a simulator without noise shows smaller faults."""

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


HELD = (
    Subject.WHITENESS, Subject.IDENTIFIABILITY, Subject.INSTRUMENTS, Subject.STIFFNESS, Reason.RESIDUAL_REPEATS,
)  # fmt: skip
"""Questions, and a reason, whose failure moves no value out of its interval, which holds it."""
OF_MECHANICS = (Reason.SPRING_NOT_LINEAR, Reason.LOAD_NOT_RIGID, Reason.FRICTION_NOT_AS_MODELLED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Message):
    """A statement that answers one of the questions about an estimate.

    Attributes:
        name: the question.
        passed: True if passed, False if failed, None if nothing could be tested.
    """

    name: Subject
    passed: bool | None

    def moves(self, row: EstimatedParameter, *, stated: bool = True) -> float:
        """How far a failure moves a value, in its deviations.

        It is the change that the check states, if it states any and that is a guide. Otherwise it is infinite for what
        the check names, by parameter or axis, or for every value.
        """
        values, of = self.values, (row.name, row.axis)
        if self.passed is not False or {self.name, self.code} & {*HELD}:
            return 0.0
        if not (stated and values.get("changes")):
            return math.inf if {*(values.get("parameters") or values.get("axes") or of)} & {*of} else 0.0
        # Such a spring has no one stiffness, and such a friction is taken for one: corrections are of first order only.
        if self.code in OF_MECHANICS and row.name in ("stiffness", "damping"):
            return math.inf
        width = max(row.stderr or 0.0, SLIGHT / INTERVAL * abs(row.value or 0.0))
        return float(values["changes"].get(row.name, 0.0)) / (width or math.ulp(0.0))


def check_of(
    name: Subject, passed: bool | None, code: Reason, said: str, values: Mapping[str, object] = {}, remedy: str = ""
) -> Check:
    """Check of one statement: failed with `code` and a `remedy`, passed, or not tested (None)."""
    codes = {True: Reason.PASSED, False: code, None: Reason.NOT_TESTED}
    more = {"remedy": remedy} if remedy and passed is False else {}
    return Check(codes[passed], said, {**values, **more}, name=name, passed=passed)


def checks_of(name: Subject, passed: bool | None, *said: Message) -> tuple[Check, ...]:
    """Return the statements that answer a question, the most important one first."""
    return tuple(Check(one.code, one.words, one.values, one.clause, name=name, passed=passed) for one in said)


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """The softest admissible spring at one load share.

    Attributes:
        share: of the load in the inertia.
        stiffness: K12 is above it, with 95 % confidence; None if the record gives no bound at this share.
        frequency: free-free, Hz, at that stiffness.
    """

    share: float
    stiffness: float | None
    frequency: float | None


Widening: TypeAlias = tuple[Mapping[str, float], str]
"""How something may move the parameters together, by name, as one deviation; and a warning, or nothing."""


Checked: TypeAlias = tuple[tuple[Check, ...], Sequence[Widening], Documented | None]
"""The results of checks: which replace those of the method on the same questions, what widens, and the diagnosis."""


def assemble(
    fit: Estimate,
    checks: tuple[Check, ...] = (),
    widenings: Sequence[Widening] = (),
    diagnosis: Documented | None = None,
) -> Estimate:
    """Add checks to an estimate, and remove undetermined values.

    Args:
        fit: the result of the method.
        checks: which replace those of the method on the same questions.
        widenings: of the intervals.
        diagnosis: of loop, log and residual, axis by axis; None if it was not made.
    """
    undetermined, rows = {name for one in fit.about(Subject.SCALE) for name in one.values["undetermined"]}, []
    undetermined |= {*fit.known.undetermined} if fit.known else set()

    def shift(weights: Mapping[str, float]) -> float:
        """Largest shift of a weighted sum of parameters."""
        return max((abs(sum(w * by.get(n, 0.0) for n, w in weights.items())) for by, _ in widenings), default=0.0)

    for p in fit.rows:
        wide = shift({p.name: 1.0}) if p.stderr else 0.0
        lost = p.name in undetermined
        rows.append(replace(p, value=None, stderr=None) if lost else replace(p, lack_of_fit=max(p.lack_of_fit, wide)))
    sums = [replace(s, lack_of_fit=shift(s.combination.weights)) for s in (fit.known.physical if fit.known else ())]
    return judged(
        replace(
            fit,
            rows=tuple(rows),
            known=fit.known and replace(fit.known, physical=tuple(sums)),
            checks=_replace(fit.checks, checks),
            warnings=(*fit.warnings, *(warning for _, warning in widenings if warning)),
            diagnosis=diagnosis,
            problem=None, x=None, records=(), solved=None, shifts=(), window=None,
        )
    )  # fmt: skip


def judged(estimate: Estimate) -> Estimate:
    """Add checks of the estimate's numbers; others than solver and fit stay."""
    given = [one for one in estimate.checks if one.name not in (Subject.SOLVER, Subject.FIT)]
    return replace(estimate, checks=_replace([*_check_numbers(estimate)], given))


def _replace(checks: Sequence[Check], by: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks, those on the questions of others replaced by these."""
    return (*(one for one in checks if one.name not in [other.name for other in by]), *by)


def _check_numbers(estimate: Estimate) -> Iterator[Check]:
    fit, known, agreement = estimate.fit, estimate.known, estimate.agreement
    yield check_of(Subject.SOLVER, fit.converged, Reason.SEARCH_ENDED, fit.stop, {}, "give a start in [parameters]")
    errors = fit.axis_errors or {"": fit.filtered_error}
    worst = max(errors, key=lambda axis: errors[axis])
    said = f"{number(100 * errors[worst], 2)} % of the {estimate.signal}{' of ' * bool(worst)}{worst} is not explained"
    poor = [axis for axis, error in errors.items() if not error <= POOR_FIT]  # as an error that is no number
    values = {"remaining": errors[worst]} | ({"axes": poor} if fit.axis_errors else {})
    yield check_of(Subject.FIT, not poor, Reason.TORQUE_UNEXPLAINED, said, values)
    if known is not None:
        good = Message(Reason.PASSED, "every parameter is distinguished from 0 and from the others")
        yield from checks_of(Subject.IDENTIFIABILITY, not known.limitations, *(known.limitations or (good,)))
    yield _check_bounds(estimate)
    if agreement is not None and agreement.p_value is not None:
        name, code, remedy = Subject.AGREEMENT, Reason.RECORDS_DISAGREE, "leave out the record that differs (--details)"
        if estimate.data.windows is not None:
            name, code, remedy = Subject.DRIFT, Reason.DRIFTS, "take shorter windows, or a part with drifting friction"
        yield check_of(name, not agreement.differs, code, str(agreement), {"parameters": [*agreement.names]}, remedy)
    springs = [row for row in estimate.rows if row.axis and row.name.endswith(".stiffness") and row.free]
    if springs:
        said = "{0.axis}: the records do not show a spring; its stiffness is at least {0.lower_bound:.3g} {0.unit}"
        yield from springs_checks([said.format(row) for row in springs if row.value is None])


def _check_bounds(estimate: Estimate) -> Check:
    """Check for parameters at a bound, and axes with driving friction."""
    rows = {row.name: row for row in estimate.rows if row.value is not None}
    driving = dict[str, None]()
    for axis in dict.fromkeys(row.axis for row in estimate.rows if row.axis):
        for sums in _DRIVING:
            names = [name for name in (f"{axis}.{part}" for part in sums) if name in rows]
            spread = estimate.covariance_of(names).std_of(np.ones(len(names))) if names else 0.0
            if sum(rows[name].value or 0.0 for name in names) < -INTERVAL * spread:
                driving[axis] = None
    if driving:
        said, remedy = f"the friction of {join([*driving])} is negative", "check the signs of torque, position and gear"
        return check_of(Subject.BOUNDS, False, Reason.FRICTION_NEGATIVE, said, {"axes": [*driving]}, remedy)
    touched = [row.name for row in estimate.rows if row.at_bound is not None]
    said = f"{join([*map(in_words, touched)] or ['no parameter'])} at a bound"
    return check_of(Subject.BOUNDS, not touched, Reason.AT_BOUND, said, {"parameters": touched} if touched else {})


def residual_checks(white: Whiteness | None, repeats: Repeatable) -> tuple[Check, Check]:
    """Checks of whiteness (None: too few rows) and of the repeatable residual."""
    coloured = check_of(Subject.WHITENESS, None, Reason.NOT_TESTED, "too few rows to say")
    if white is not None:
        coloured = check_of(Subject.WHITENESS, white.white, Reason.RESIDUAL_COLOURED, str(white), asdict(white))
    once = None if repeats.p_value is None else not repeats.significant
    return coloured, check_of(Subject.REPEATABLE, once, Reason.RESIDUAL_REPEATS, str(repeats), asdict(repeats))


def springs_checks(refused: Sequence[str], shown: str = "the record shows every spring") -> tuple[Check, ...]:
    """Checks of springs; `refused` has a sentence per reason or spring."""
    if not refused:
        return (check_of(Subject.STIFFNESS, True, Reason.PASSED, shown),)
    return checks_of(Subject.STIFFNESS, False, *(Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in refused))


def scale_check(known: Sequence[str], lost: Sequence[str] = (), *, identified: bool = False) -> Check:
    """Check of the scale of a torque computed from the controller.

    Args:
        known: fixed parameters other than 0, which determine it.
        lost: parameters that the unknown content of an integral leaves without an interval.
        identified: whether the gain is free.
    """
    said = "so a common factor of its gains is invisible: gains 10 % too large make every parameter 10 % too large"
    if known:
        said = f"and {join(known)} tells its scale{', which the free gain takes up' if identified else ': free gain'}"
    said = f"the torque is computed from the declared controller and the motor position, {said}"
    if lost:
        said += f"; {join(lost)} includes what the integral held at the first sample"
    code = Reason.SCALE_KNOWN if known else Reason.SCALE_DECLARED
    values = {"parameters": [*known], "undetermined": [*lost]}
    return Check(code, said, values, name=Subject.SCALE, passed=True if known else None)


# Whether to rely on the answer

_ASKED = ("stiffness", "inertia", "load_inertia", "motor_inertia", "inertia@1")  # the first that is free is the answer
_WIDE = 0.5  # of the value: a wider 2-sigma interval says its order of magnitude only
_KNOWN = 0.1  # relative standard error of a robot's parameter that counts as known


class Trust(StrEnum):
    """Whether to rely on an answer."""

    RELIABLE = "reliable"
    PARTLY = "reliable_but_not_all_parameters"
    NOT_YET = "not_reliable_yet"
    NOT_CHECKED = "not_checked"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Answer:
    """The first line of a result.

    Attributes:
        found: the value with its 2-sigma interval, of code "value", "lower_bound" or "not_determined", or "parameters"
            of a robot; values: ``parameter``, ``value``, ``two_sigma``, ``unit``, ``mode_hz`` (free-free) and
            ``lower_bound``, None without one.
        trust: whether to rely on it, of code `Trust`; values: ``reasons``, the codes of the objections, and
            ``parameters``, those that a fault moves out of their intervals.
    """

    found: Message
    trust: Message

    @property
    def reliable(self) -> bool:
        """True if nothing that was checked speaks against the value."""
        return self.trust.code in (Trust.RELIABLE, Trust.PARTLY)

    def __str__(self) -> str:
        """The line ``Inertia 94.90 ± 0.92 kg. You can rely on it.``."""
        return f"{self.found}. {self.trust}."


def answer_of(estimate: Estimate) -> Answer:
    """Return the first line of an estimate."""
    if estimate.robot is not None:
        return Answer(_count_known(estimate), _rely_on(estimate, None))
    rows = estimate.parameters
    asked = [rows[name] for name in _ASKED if name in rows]
    found = [row for row in asked if row.free or row.value is None or row.at_bound is not None]
    first = next(iter([*found, *(row for row in estimate.rows if row.free), *estimate.rows]))
    return Answer(_tell(estimate, first), _rely_on(estimate, first))


def _tell(estimate: Estimate, asked: EstimatedParameter) -> Message:
    """Value with interval, unit and mode; for a refused one, its bound."""
    mode, least, code = estimate.frequencies.get("free_free"), None, "value"
    words = f"{in_words(asked.name).capitalize()} {asked} {asked.unit}"
    if asked.unit == "N/m" and asked.value and asked.deviation and asked.value >= 1e6:
        words += f" ({interval(1e-6 * asked.value, 1e-6 * INTERVAL * asked.deviation)} N/µm)"
    if asked.value is None:
        stated, code = told_bounds(estimate), "not_determined"
        words = f"{in_words(asked.name).capitalize()} not determined by this record"
        if bounds := [(b.stiffness, b.frequency, b.share) for b in stated if b.stiffness and b.frequency]:
            (least, hertz, _), code = min(bounds), "lower_bound"
            words += f": at least {number(float(f'{least:.2e}'), 3)} {asked.unit}, mode above {number(hertz, 2)} Hz"
        if least is not None and len(bounds) < len(stated):
            shares = [f"{100 * share:.0f}" for _, _, share in bounds]  # a share between two of them may have no bound
            words += f", for a load of {join(shares)} % of the inertia"
    elif mode is not None:
        words += f", mode {number(mode, 3)} Hz"
    two_sigma = None if asked.deviation is None else INTERVAL * asked.deviation
    values = {"parameter": asked.name, "value": asked.value, "two_sigma": two_sigma, "unit": asked.unit}
    return Message(code, words, values | {"mode_hz": mode, "lower_bound": least})


def told_bounds(estimate: Estimate) -> tuple[StiffnessBound, ...]:
    """Bounds of a refused stiffness; none if loop or model are wrong."""
    wrong = estimate.fit.filtered_error > POOR_FIT or _failed(estimate, Subject.LOOP)
    return () if wrong else estimate.bounds


def _count_known(estimate: Estimate) -> Message:
    """Number of known parameters of a robot, and its largest error."""
    asked = [row for row in estimate.rows if row.free and row.of_joint]
    known = [row for row in asked if row.value and row.stderr is not None and row.stderr < _KNOWN * abs(row.value)]
    left = estimate.fit.axis_errors
    worst = max(left, key=lambda axis: left[axis])
    words = f"{len(known)} of {len(asked)} parameters known to a tenth, {number(100 * left[worst], 3)} % of the torque "
    none = dict.fromkeys(("parameter", "value", "two_sigma", "unit", "mode_hz", "lower_bound"))
    values = none | {"known": len(known), "asked": len(asked), "worst": worst}
    return Message("parameters", f"{words}of {worst} not explained", values)


def _rely_on(estimate: Estimate, asked: EstimatedParameter | None, axis: str = "") -> Message:
    """Trust in a value, in all values of a robot, or in those of an axis of it."""
    springs, against = _failed(estimate, Subject.STIFFNESS), [*_speak_against(estimate, asked, axis)]
    rows = [row for row in estimate.rows if axis in ("", row.axis)]
    apart = [(row.name, one) for row in rows if row.at_bound is None for one in doubts_of(estimate, row)[:1]]
    code, moved = Trust.NOT_CHECKED, list[str]()
    if against:
        code, words = Trust.NOT_YET, f"Do not rely on it yet: {against[0].brief}"
    elif asked is not None and asked.value is None:
        remedy = 'Identify with model = "rigid", or record stronger ramps or pulses on the torque'
        remedy = remedy if asked.name == "stiffness" else "Record a motion that shows it"
        code, against = Trust.REFUSED, [one for one in estimate.about(Subject.LOOP) if one.passed is None]
        words = f"{remedy}{'; loop and log were not checked' if against else ''}"
    elif apart:
        code, moved, against = Trust.PARTLY, [name for name, _ in apart], [apart[0][1]]
        words = f"You can rely on it, but not on {join([*map(in_words, moved)])}: {against[0].brief}"
    elif springs and (refused := [row.name for row in rows if row.value is None]):
        code, moved, against = Trust.PARTLY, refused, springs[:1]
        words = "You can rely on it, but not on joints whose spring the record does not show"
    elif asked is not None and not asked.free:
        words = "It was declared, not identified"
    elif unchecked := _name_unchecked(estimate, axis):
        words, against = unchecked, [Message(Reason.MOTION_MEASURED, "")] * estimate.motion_measured
    else:
        within = ": what was found wrong moves it by less than its interval"
        code, words = Trust.RELIABLE, f"You can rely on it{within if _failed(estimate, Subject.LOOP) else ''}"
    return Message(code, words, {"reasons": [*dict.fromkeys(str(one.code) for one in against)], "parameters": moved})


def trust_in_axis(estimate: Estimate, axis: str) -> Trust:
    """Trust in the values of one joint of a robot."""
    return Trust(_rely_on(estimate, None, axis).code)


def _failed(estimate: Estimate, name: Subject) -> list[Message]:
    """Return the statements that failed of a question."""
    return [one for one in estimate.about(name) if one.passed is False]


def _name_unchecked(estimate: Estimate, axis: str) -> str:
    """Unchecked conditions of an answer, or of that of an axis; "" if there are none."""
    whole = estimate.about(Subject.LOOP)
    loop = [one for one in whole if axis in ("", *one.values.get("axes", (axis,)))]
    if estimate.motion_measured or not whole:  # another record has the same bias where the motion was measured
        remedy = "validate it on another record"
        if estimate.motion_measured:
            remedy = "the motion was measured under control: what disturbs it biases these values; identify by DIDIM"
        left = f"{number(100 * estimate.fit.filtered_error, 2)} % of the {estimate.signal} is not explained"
        rate = f", with a sample time of {1e3 * estimate.data.sample_time:.4g} ms as stated" * estimate.motion_measured
        return f"Checked by its fit only ({left}){rate}: {remedy}"
    if loop and loop[0].passed is None:
        axes = loop[0].values.get("axes", ())
        which = f"controller of {join(axes)}" if axes else "controller"
        return f"You can rely on it if the {which} is as declared, which was not checked"
    if any(one.passed is None for one in estimate.about(Subject.SCALE)):
        return "You can rely on it if the scale of the controller's gains is right, which positions do not show"
    return ""


def doubts_of(estimate: Estimate, row: EstimatedParameter) -> list[Check]:
    """Failed checks that move a value by more than two deviations, alone or together, those of the loop first.

    If a parameter is held at a bound, or the torque is not explained, others compensate for faults of loop and log: the
    changes that these state are then no guide.
    """
    stated = estimate.fit.filtered_error <= POOR_FIT
    stated &= not any(one.of_joint and one.at_bound is not None for one in estimate.rows)
    moved = [(one, by) for one in estimate.checks if (by := one.moves(row, stated=stated))]
    moved.sort(key=lambda one: one[0].name != Subject.LOOP)
    alone = [one for one, by in moved if abs(by) > INTERVAL]
    return alone or [one for one, _ in moved if abs(sum(by for _, by in moved)) > INTERVAL]


def _speak_against(estimate: Estimate, asked: EstimatedParameter | None, axis: str) -> Iterator[Message]:
    """Yield the reasons against a value, or against all values of an axis, or of any."""
    if asked is None:
        for one in [axis] if axis else [*estimate.fit.axis_errors]:
            each = [doubts_of(estimate, row) for row in estimate.rows if row.axis == one]
            yield from (check for check in each[0] if all(check in other for other in each)) if each else ()
        return
    doubts = doubts_of(estimate, asked)
    if asked.value is None:
        yield from (one for one in doubts if one.name == Subject.LOOP)
        return
    first = _failed(estimate, Subject.LOOP)[: any(one.name == Subject.LOOP for one in doubts)]  # others are beside it
    yield from (*first, *(one for one in doubts if one not in first))
    if not asked.free or asked.at_bound is not None:
        return
    value, deviation = asked.value, asked.deviation
    if deviation is None or not math.isfinite(value + deviation):
        yield Message(Reason.NO_INTERVAL, "its interval is not known")
    elif INTERVAL * deviation > _WIDE * abs(value):
        share = f"to {number(100 * INTERVAL * deviation / abs(value), 2)} % only" if value else "not even by its sign"
        yield Message(Reason.WIDE_INTERVAL, f"it is known {share}")
