"""The answer of an estimate in a line: the value that was asked for, and whether to rely on it.

What was asked for is the stiffness of a flexible joint, the inertia of a rigid one. A check that fails speaks against
it only where it would move it: a residual that is coloured, or repeats, is in the interval already, and a fault of the
loop that moves a friction leaves the inertia what it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from jointid.common.messages import Message
from jointid.common.text import in_words, interval, join, number, round_to
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts, show_value
from jointid.estimation.result.robot import KNOWN
from jointid.models.joints import FlexibleJoint
from jointid.uncertainty.verdict import (
    AGAINST_EVERY_VALUE,
    MOTION_MEASURED,
    POOR_FIT,
    Reason,
    Status,
    StiffnessBound,
    Subject,
    Verdict,
)

_ASKED = ("stiffness", "inertia", "load_inertia", "motor_inertia")  # the first of them that is free is the answer
_OF_MECHANICS = (Reason.SPRING_NOT_LINEAR, Reason.LOAD_NOT_RIGID, Reason.FRICTION_NOT_AS_MODELLED)
_OF_SPRING = ("stiffness", "damping")  # what the difference of both encoders tells
_IF_CONTROLLER = "You can rely on it if the controller is as declared, which was not checked"
_IF_SCALE = "You can rely on it if the scale of the controller's gains is right, which positions do not show"
SLIGHT = 1e-3
"""Share of a value that no decision depends on; the log of a simulator without noise shows smaller faults."""
_WIDE = 0.5  # of the value: a wider 2-sigma interval says its order of magnitude only


class Found(StrEnum):
    """Kinds of value in an answer."""

    VALUE = "value"
    LOWER_BOUND = "lower_bound"
    NOT_DETERMINED = "not_determined"
    PARAMETERS = "parameters"


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
        found: the value with its 2-sigma interval, of code `Found`; values: ``parameter``, ``value``, ``two_sigma``,
            ``unit``, ``mode_hz`` (free-free) and ``lower_bound``, None where there is none.
        trust: whether to rely on it, of code `Trust`; values: ``reasons``, the codes of what speaks against it, and
            ``parameters``, those that a fault moves out of their intervals.
    """

    found: Message
    trust: Message

    @property
    def reliable(self) -> bool:
        """True if nothing that was checked speaks against the value."""
        return self.trust.code in (Trust.RELIABLE, Trust.PARTLY)

    def __str__(self) -> str:
        """Return the line: ``Inertia 94.90 ± 0.92 kg. You can rely on it.``."""
        return f"{self.found}. {self.trust}."


def answer_of(estimate: EstimateParts) -> Answer:
    """Return the first line of an estimate."""
    if estimate.robot is not None:
        return Answer(_known_of_robot(estimate), _trust_of_robot(estimate))
    rows, of_records = estimate.params.rows, estimate.params.own
    free = [
        row
        for name in _ASKED
        for row in rows
        if row.name == name and (row.free or row.value is None or row.at_bound is not None)
    ]
    own = [row for rows_of in of_records[:1] for row in rows_of if row.name == "inertia" and row.free]
    if own and not free:  # each record has its own inertia: the first one's is reported
        asked = replace(own[0], name="inertia@1")
    else:
        asked = next(iter([*free, *(row for row in rows if row.free), *rows]))
    if asked.value is None:
        return Answer(_undetermined_message(estimate, asked), _refusal_message(estimate))
    assert asked.value is not None
    shown = _with_pieces(estimate, asked, _with_unit(asked) + (", at its bound" if asked.at_bound is not None else ""))
    mode = estimate.frequencies.get("free_free")
    words = f"{_in_words(asked.name)} {shown}" + ("" if mode is None else f", mode {number(mode, 3)} Hz")
    return Answer(Message(Found.VALUE, words, _values(asked, mode)), _trust(estimate, asked))


def _with_pieces(estimate: EstimateParts, asked: EstimatedParameter, shown: str) -> str:
    """Return a shown stiffness with what else a spring in pieces is made of."""
    joint = estimate.settings.joint
    if asked.name != "stiffness" or not isinstance(joint, FlexibleJoint):
        return shown
    rows = {row.name: row for row in estimate.params.rows}
    others = {p.name: _with_unit(rows[p.name]) for p in joint.spring.parameters[1:-1] if p.name in rows}
    return joint.spring.describe({asked.name: shown, **others})


def _with_unit(row: EstimatedParameter) -> str:
    value, fixed, _ = show_value(row).partition(" (fixed)")
    return f"{value} {row.unit}{fixed}" if row.value is not None or row.lower_bound is not None else value


def _undetermined_message(estimate: EstimateParts, asked: EstimatedParameter) -> Message:
    """Return the bound of a refused value, for a stiffness the softest admissible one."""
    words = f"{_in_words(asked.name)} not determined by this record"
    stated = told_bounds(estimate)
    bounds = [(b.stiffness, b.frequency, b.share) for b in stated if b.stiffness and b.frequency]
    if not bounds:
        return Message(Found.NOT_DETERMINED, words, _values(asked, None))
    least, mode, _ = min(bounds)
    words += f": at least {number(round_to(least), 3)} {asked.unit}, mode above {number(mode, 2)} Hz"
    if len(bounds) < len(stated):
        shares = [share for _, _, share in bounds]
        words += f", for a load of {100 * min(shares):.0f} to {100 * max(shares):.0f} % of the inertia"
    return Message(Found.LOWER_BOUND, words, _values(asked, mode) | {"lower_bound": least})


def told_bounds(estimate: EstimateParts) -> tuple[StiffnessBound, ...]:
    """Return the bounds of a refused stiffness; none where loop or model are not those of the torque they come from."""
    loop = loop_verdict(estimate)
    wrong = estimate.fit.filtered_error > POOR_FIT or (loop is not None and loop.status is Status.FAILED)
    return () if wrong else estimate.checks.bounds


def _values(asked: EstimatedParameter | None, mode: float | None) -> dict[str, Any]:
    deviation = None if asked is None else asked.deviation
    return {
        "parameter": None if asked is None else asked.name,
        "value": None if asked is None else asked.value,
        "two_sigma": None if deviation is None else 2 * deviation,
        "unit": None if asked is None else asked.unit,
        "mode_hz": mode,
        "lower_bound": None,
    }


def _refusal_message(estimate: EstimateParts) -> Message:
    """Return the reliable combinations beside a refused value."""
    loop, known = loop_verdict(estimate), estimate.checks.known
    if loop is not None and loop.status is Status.FAILED:
        return _not_yet([loop.reasons[0]])
    flexible = isinstance(estimate.settings.joint, FlexibleJoint)
    words = (
        "Identify the joint as rigid, or record a motion that shows it" if flexible else "Record a motion that shows it"
    )
    for one in () if known is None else known.physical:
        if one.combination.quantity == "inertia":
            words += f"; the whole inertia is {interval(one.value, 2 * one.std)} {one.combination.unit}"
            if loop is not None and loop.status is Status.UNKNOWN:
                words += " if the controller is as declared, which was not checked"
    return Message(Trust.REFUSED, words, {"reasons": [], "parameters": []})


def _trust(estimate: EstimateParts, asked: EstimatedParameter) -> Message:
    """Return the trust in a value, with the reasons against it."""
    against = _reasons_against(estimate, asked)
    if against:
        return _not_yet(against)
    moved = [row for row in estimate.params.rows if row.name in _moved_out(estimate)]
    if moved:
        names, fault = join([in_words(row.name) for row in moved]), loop_verdict(estimate)
        assert fault is not None
        words = f"You can rely on it, but not on {names}: {fault.reasons[0].brief}"
        return Message(
            Trust.PARTLY,
            words,
            {"reasons": [str(fault.reasons[0].code)], "parameters": [row.name for row in moved]},
        )
    values: dict[str, Any] = {"reasons": [], "parameters": []}
    if not asked.free:
        return Message(Trust.NOT_CHECKED, "It was declared, not identified", values)
    if all(verdict.subject is Subject.SCALE for verdict in estimate.checks.verdicts):
        return _fit_only(estimate)
    loop = loop_verdict(estimate)
    unchecked = estimate.settings.loop is not None and (loop is None or loop.status is Status.UNKNOWN)
    if unchecked or _scale_is_declared(estimate):
        return Message(Trust.NOT_CHECKED, _IF_CONTROLLER if unchecked else _IF_SCALE, values)
    words = "You can rely on it"
    if loop is not None and loop.status is Status.FAILED:
        words += ": what is wrong with loop or log moves it by less than its interval"
    return Message(Trust.RELIABLE, words, values)


def _fit_only(estimate: EstimateParts) -> Message:
    left = f"{number(100 * estimate.fit.filtered_error, 2)} % of the {estimate.signal} is not explained"
    reasons, words = list[str](), f"Checked by its fit only ({left}): validate it on another record"
    if estimate.motion_measured:  # another record has the same bias
        reasons, words = [str(Reason.MOTION_MEASURED)], f"Checked by its fit only ({left}): {MOTION_MEASURED}"
    return Message(Trust.NOT_CHECKED, words, {"reasons": reasons, "parameters": []})


def _not_yet(against: list[Message]) -> Message:
    words = "; ".join(one.brief for one in against[:2])
    values = {"reasons": [str(one.code) for one in against], "parameters": []}
    return Message(Trust.NOT_YET, f"Do not rely on it yet: {words}", values)


def _known_of_robot(estimate: EstimateParts) -> Message:
    """Return the number of known parameters of a robot, and its largest error."""
    asked = [row for row in estimate.params.rows if row.free and row.of_joint]
    known = [row for row in asked if row.value and row.stderr is not None and row.stderr < KNOWN * abs(row.value)]
    left = estimate.fit.axis_errors
    worst = max(left, key=lambda axis: left[axis])
    words = (
        f"{len(known)} of {len(asked)} parameters known to a tenth, {number(100 * left[worst], 3)} % of the torque of "
    )
    words += f"{worst} not explained"
    values = _values(None, None) | {"known": len(known), "asked": len(asked), "worst": worst}
    return Message(Found.PARAMETERS, words, values)


_NAMED = (Reason.CAUSE_FOUND, Reason.LOOP_NOT_AS_DECLARED)  # what is wrong is said before its effects


def _trust_of_robot(estimate: EstimateParts) -> Message:
    """Return whether to rely on the estimate of a robot."""
    verdicts = estimate.checks.verdicts
    of_springs = [v for v in verdicts if v.subject is Subject.STIFFNESS]
    failed = [v.reasons[0] for v in verdicts if v.status is Status.FAILED and v.subject is not Subject.STIFFNESS]
    against = [one for one in failed if one.code is not Reason.AT_BOUND]  # that speaks against one parameter
    if against:
        return _not_yet(sorted(against, key=lambda one: one.code not in _NAMED))
    values: dict[str, Any] = {"reasons": [], "parameters": []}
    refused = [row.name for row in estimate.params.rows if row.value is None]
    if any(v.status is Status.FAILED for v in of_springs):
        words = "You can rely on it, but not on joints whose spring the record does not show"
        return Message(Trust.PARTLY, words, {"reasons": [str(Reason.STIFFNESS_NOT_SHOWN)], "parameters": refused})
    if not estimate.require_robot().has_controllers or estimate.motion_measured:
        return _fit_only(estimate)
    loop = loop_verdict(estimate)
    if loop is None or loop.status is Status.UNKNOWN:
        untested = () if loop is None else loop.reasons[0].values.get("axes", ())
        which = f"controller of {join(untested)} is" if untested else "controllers are"
        words = f"You can rely on it if the {which} as declared, which was not checked"
        return Message(Trust.NOT_CHECKED, words, values)
    if _scale_is_declared(estimate):
        return Message(Trust.NOT_CHECKED, _IF_SCALE, values)
    return Message(Trust.RELIABLE, "You can rely on it", values)


def _scale_is_declared(estimate: EstimateParts) -> bool:
    """Test whether the declared gains alone tell the scale of the torque."""
    return any(v.subject is Subject.SCALE and v.status is Status.UNKNOWN for v in estimate.checks.verdicts)


class Against(StrEnum):
    """Reasons against a value that are not of a verdict."""

    NOT_CONVERGED = "not_converged"
    TORQUE_UNEXPLAINED = "torque_unexplained"
    AT_BOUND = "at_bound"
    HELD = "others_at_bound"
    RECORDS_DISAGREE = "records_disagree"
    DRIFTS = "drifts"
    WIDE = "wide_interval"
    NO_INTERVAL = "no_interval"
    ONLY_TOGETHER = "only_together"
    INTERRUPTED = "interrupted"
    ENCODER_LAG = "encoder_lag"


def _reasons_against(estimate: EstimateParts, asked: EstimatedParameter) -> list[Message]:
    """Return the reasons against a value, causes before effects."""
    loop = loop_verdict(estimate)
    found = list(_effects(estimate, asked))
    for reason in () if loop is None else loop.reasons:
        by = reason.values["changes"].get(asked.name, 0.0) if reason.code is Reason.LAW_UNDECIDED else 0.0
        if asked.value is not None and asked.stderr and _leaves_interval(asked, by):
            words = f"it would be {number(asked.value + by, 4)} {asked.unit} if {reason.values['condition']}, "
            words += "which this record does not exclude; see the drive's manual"
            found.append(replace(reason, clause=words))
    if loop is None or loop.status is not Status.FAILED:
        return found
    # A second fault was found beside the first one, corrected; another law that is not excluded is none.
    faults = [loop.reasons[0], *(one for one in loop.reasons[1:2] if "suspect" in one.values)]
    held = [in_words(row.name) for row in estimate.params.rows if row.of_joint and row.at_bound is not None]
    if held:  # what is wrong is made up for by parameters: by how much a fault moves the others says little then
        words = f"{join(held)} {'end' if len(held) > 1 else 'ends'} at a bound"
        found = [*found, Message(Against.HELD, words)]
        return [*faults, *found]
    # Such a spring has no one stiffness, and such a friction is taken for one: corrections are of first order only.
    mechanics = [one for one in loop.reasons if one.code in _OF_MECHANICS and asked.name in _OF_SPRING]
    gross = not any("changes" in reason.values for reason in loop.reasons)
    unexplained = any(one.code is Against.TORQUE_UNEXPLAINED for one in found)
    if gross or unexplained or asked.name in _moved_out(estimate):
        return [*faults, *found]
    return [*mechanics, *found]


def _effects(estimate: EstimateParts, asked: EstimatedParameter) -> Iterator[Message]:
    fit, checks = estimate.fit, estimate.checks
    if fit.interrupted:
        yield Message(Against.INTERRUPTED, "it was interrupted, and is of the record's beginning only")
    elif not fit.converged:
        yield Message(Against.NOT_CONVERGED, "the search did not converge")
    if checks.encoder_lag is not None and asked.name in _OF_SPRING:
        lag = f"{number(1e3 * checks.encoder_lag.lag, 2)} ms"
        words = f"{checks.encoder_lag.late} seems {lag} late, which hides the spring"
        yield Message(Against.ENCODER_LAG, words, {"lag": checks.encoder_lag.lag})
    yield from (one for v in checks.verdicts for one in v.reasons if one.code in AGAINST_EVERY_VALUE)
    if not fit.filtered_error <= POOR_FIT:  # nor is it where the error is no number
        left = f"{number(100 * fit.filtered_error, 2)} % of the {estimate.signal} is not explained"
        yield Message(Against.TORQUE_UNEXPLAINED, left, {"remaining": fit.filtered_error})
    if asked.at_bound is not None:
        yield Message(Against.AT_BOUND, "at a bound it does not follow the record")
        return
    if checks.agreement is not None and any(p.differs and p.name == asked.name for p in checks.agreement.parameters):
        yield Message(Against.RECORDS_DISAGREE, "the records disagree in it by more than their intervals allow")
    drift = checks.drift
    if drift is not None and asked.name in drift.names:
        yield Message(Against.DRIFTS, "it changes along the record by more than its intervals allow")
    if not asked.free:
        return
    if not asked.identifiable:
        yield Message(Against.ONLY_TOGETHER, "the record determines it only together with others")
    deviation = asked.deviation
    if asked.value is None or deviation is None or not math.isfinite(asked.value + deviation):
        yield Message(Against.NO_INTERVAL, "its interval is not known")
    elif 2 * deviation > _WIDE * abs(asked.value):
        share = f"to {number(200 * deviation / abs(asked.value), 2)} % only" if asked.value else "not even by its sign"
        yield Message(Against.WIDE, f"it is known {share}")


def loop_verdict(estimate: EstimateParts) -> Verdict | None:
    """Return the verdict on controller and log; None without one."""
    return next((v for v in estimate.checks.verdicts if v.subject is Subject.LOOP), None)


def moved_by_loop(estimate: EstimateParts, threshold: float = 0.0) -> Mapping[str, float]:
    """Return by how much the parameters change when the faults of loop and log that were found are corrected.

    Where none was found, it is by how much another law would change them that the record does not exclude.

    Args:
        estimate: with the verdict of its loop check, or no parameter is moved.
        threshold: standard errors by which a parameter must change at least.
    """
    loop = loop_verdict(estimate)
    rows = {row.name: row.stderr or 0.0 for row in estimate.params.rows}
    total = sum_changes(() if loop is None else loop.reasons)
    return {name: by for name, by in total.items() if abs(by) > threshold * rows.get(name, 0.0)}


def _moved_out(estimate: EstimateParts) -> Mapping[str, float]:
    """Return the changes by `moved_by_loop` that leave an interval."""
    changes, rows = moved_by_loop(estimate), {row.name: row for row in estimate.params.rows}
    return {name: by for name, by in changes.items() if name not in rows or _leaves_interval(rows[name], by)}


def _leaves_interval(row: EstimatedParameter, by: float) -> bool:
    """Test whether a change of a parameter is more than two standard errors, and not slight."""
    return abs(by) > max(2.0 * (row.stderr or 0.0), SLIGHT * abs(row.value or 0.0))


def sum_changes(reasons: Sequence[Message]) -> dict[str, float]:
    """Return by how much the reasons of a loop check change each parameter; see `moved_by_loop`."""
    total: dict[str, float] = {}
    for reason in [one for one in reasons if one.code != Reason.LAW_UNDECIDED] or reasons:
        for name, by in reason.values.get("changes", {}).items():
            total[name] = total.get(name, 0.0) + by
    return total


def is_another_law(reasons: Sequence[Message]) -> bool:
    """Return True if nothing is wrong with the loop, but another law is not excluded: its changes are of an `if`."""
    return bool(reasons) and all(one.code == Reason.LAW_UNDECIDED for one in reasons)


def _in_words(name: str) -> str:
    plain, _, record = name.partition("@")
    return plain.replace("_", " ").capitalize() + (f" of record {record}" if record else "")
