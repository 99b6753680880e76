"""The answer of an estimate in a line: the value that was asked for, and whether to rely on it.

What was asked for is the stiffness of a flexible joint, the inertia of a rigid one, and all parameters of a robot. One
rule says whether to rely on it: nothing that was checked moves it out of its interval. A residual that is coloured or
repeats is in the interval already, and a fault of the loop that moves a friction leaves the inertia what it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from jointid.common.messages import Message
from jointid.common.text import in_words, join, number
from jointid.estimation.result.parts import EstimatedParameter, show_value
from jointid.estimation.result.robot import KNOWN
from jointid.estimation.result.verdict import (
    AGAINST_EVERY_VALUE,
    POOR_FIT,
    Reason,
    Status,
    StiffnessBound,
    Subject,
    Verdict,
)

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate

_ASKED = ("stiffness", "inertia", "load_inertia", "motor_inertia", "inertia@1")  # the first that is free is the answer
_MEASURED = "the motion was measured under control: what disturbs it biases these values; identify by DIDIM"
_OF_MECHANICS = (Reason.SPRING_NOT_LINEAR, Reason.LOAD_NOT_RIGID, Reason.FRICTION_NOT_AS_MODELLED)
_OF_SPRING = ("stiffness", "damping")
_OF_VALUES = (Subject.BOUNDS, Subject.AGREEMENT, Subject.DRIFT, Subject.ENCODERS)  # speak against what they name
_WIDE = 0.5  # of the value: a wider 2-sigma interval says its order of magnitude only
SLIGHT = 1e-3
"""Share of a value that no decision depends on; the log of a simulator without noise shows smaller faults."""


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


def answer_of(estimate: Estimate) -> Answer:
    """Return the first line of an estimate."""
    if estimate.robot is not None:
        return Answer(_count_known(estimate), _judge(estimate, None))
    asked = _find_asked(estimate)
    return Answer(_tell(estimate, asked), _judge(estimate, asked))


# The value


def _find_asked(estimate: Estimate) -> EstimatedParameter:
    """Return the parameter that was asked for; of records that have an inertia each the first one's."""
    rows = estimate.params
    asked = [rows[name] for name in _ASKED if name in rows]
    found = [row for row in asked if row.free or row.value is None or row.at_bound is not None]
    return next(iter([*found, *(row for row in rows.rows if row.free), *rows.rows]))


def _tell(estimate: Estimate, asked: EstimatedParameter) -> Message:
    """Return a value with its interval, unit and mode; of a refused one its bound, the softest admissible one."""
    words = in_words(asked.name).capitalize()
    if asked.value is None:
        return _refuse(estimate, asked, f"{words} not determined by this record")
    mode = estimate.frequencies.get("free_free")
    value, fixed, _ = show_value(asked).partition(" (fixed)")
    words += f" {value} {asked.unit}{fixed}{', at its bound' if asked.at_bound is not None else ''}"
    return _found(Found.VALUE, words + ("" if mode is None else f", mode {number(mode, 3)} Hz"), asked, mode_hz=mode)


def _refuse(estimate: Estimate, asked: EstimatedParameter, words: str) -> Message:
    stated = told_bounds(estimate)
    bounds = [(b.stiffness, b.frequency, b.share) for b in stated if b.stiffness and b.frequency]
    if not bounds:
        return _found(Found.NOT_DETERMINED, words, asked)
    least, mode, _ = min(bounds)
    words += f": at least {number(float(f'{least:.2e}'), 3)} {asked.unit}, mode above {number(mode, 2)} Hz"
    if len(bounds) < len(stated):
        shares = [share for _, _, share in bounds]
        words += f", for a load of {100 * min(shares):.0f} to {100 * max(shares):.0f} % of the inertia"
    return _found(Found.LOWER_BOUND, words, asked, lower_bound=least)


def told_bounds(estimate: Estimate) -> tuple[StiffnessBound, ...]:
    """Return the bounds of a refused stiffness; none where loop or model are not those of the torque they come from."""
    loop = loop_verdict(estimate)
    wrong = estimate.fit.filtered_error > POOR_FIT or (loop is not None and loop.status is Status.FAILED)
    return () if wrong else estimate.checks.bounds


def _count_known(estimate: Estimate) -> Message:
    """Return the number of known parameters of a robot, and its largest error."""
    asked = [row for row in estimate.params.rows if row.free and row.of_joint]
    known = [row for row in asked if row.value and row.stderr is not None and row.stderr < KNOWN * abs(row.value)]
    left = estimate.fit.axis_errors
    worst = max(left, key=lambda axis: left[axis])
    words = f"{len(known)} of {len(asked)} parameters known to a tenth, {number(100 * left[worst], 3)} % of the torque "
    more = {"known": len(known), "asked": len(asked), "worst": worst}
    return _found(Found.PARAMETERS, f"{words}of {worst} not explained", None, **more)


def _found(code: Found, words: str, row: EstimatedParameter | None, **more: object) -> Message:
    values = dict.fromkeys(("parameter", "value", "two_sigma", "unit", "mode_hz", "lower_bound"))
    if row is not None:
        two_sigma = None if row.deviation is None else 2 * row.deviation
        more = {"parameter": row.name, "value": row.value, "two_sigma": two_sigma, "unit": row.unit} | more
    return Message(code, words, values | more)


# Whether to rely on it


def _judge(estimate: Estimate, asked: EstimatedParameter | None) -> Message:
    """Return the trust in a value; in all values of a robot where none is asked for."""
    loop, failed = loop_verdict(estimate), [v for v in estimate.checks.verdicts if v.status is Status.FAILED]
    against, rows = [*_of_loop(estimate, asked), *_of_others(estimate, asked)], list[EstimatedParameter]()
    refused = asked is not None and asked.value is None
    if refused:
        against = [*loop.reasons[:1]] if loop is not None and loop in failed else []
    moved = [row for row in estimate.params.rows if row.name in _moved_out(estimate)]
    if against:
        code, words = Trust.NOT_YET, f"Do not rely on it yet: {'; '.join(one.brief for one in against[:2])}"
    elif asked is not None and refused:
        remedy = "Identify the joint as rigid, or record" if asked.name == "stiffness" else "Record"
        code, words = Trust.REFUSED, f"{remedy} a motion that shows it"
    elif moved and loop is not None and asked is not None:
        code, rows, against = Trust.PARTLY, moved, [loop.reasons[0]]
        words = f"You can rely on it, but not on {join([in_words(row.name) for row in rows])}: {against[0].brief}"
    elif against := [v.reasons[0] for v in failed if v.subject is Subject.STIFFNESS]:
        code, rows = Trust.PARTLY, [row for row in estimate.params.rows if row.value is None]
        words = "You can rely on it, but not on joints whose spring the record does not show"
    elif asked is not None and not asked.free:
        code, words = Trust.NOT_CHECKED, "It was declared, not identified"
    elif words := _name_unchecked(estimate, loop):
        code, against = Trust.NOT_CHECKED, [Message(Reason.MOTION_MEASURED, _MEASURED)] * estimate.motion_measured
    else:
        within = ": what is wrong with loop or log moves it by less than its interval" if loop in failed else ""
        code, words = Trust.RELIABLE, f"You can rely on it{within}"
    reasons = [str(one.code) for one in against]
    return Message(code, words, {"reasons": reasons, "parameters": [row.name for row in rows]})


def _name_unchecked(estimate: Estimate, loop: Verdict | None) -> str:
    """Return the conditions of an answer that were not checked; "" if nothing."""
    if estimate.motion_measured or loop is None:  # another record has the same bias where the motion was measured
        left = f"{number(100 * estimate.fit.filtered_error, 2)} % of the {estimate.signal} is not explained"
        remedy = _MEASURED if estimate.motion_measured else "validate it on another record"
        return f"Checked by its fit only ({left}): {remedy}"
    if loop.status is Status.UNKNOWN:
        axes = loop.reasons[0].values.get("axes", ())
        which = f"controller of {join(axes)}" if axes else "controller"
        return f"You can rely on it if the {which} is as declared, which was not checked"
    if any(v.subject is Subject.SCALE and v.status is Status.UNKNOWN for v in estimate.checks.verdicts):
        return "You can rely on it if the scale of the controller's gains is right, which positions do not show"
    return ""


def _of_loop(estimate: Estimate, asked: EstimatedParameter | None) -> Iterator[Message]:
    """Yield the faults of loop and log that move the value; all that is wrong where no value is asked for.

    Where a parameter is held at a bound, or the torque is not explained, others make up for what is wrong: how far it
    moves a value alone says little then.
    """
    loop = loop_verdict(estimate)
    if loop is None or loop.status is Status.PASSED:
        return
    if loop.status is Status.UNKNOWN:
        undecided = [reason for reason in loop.reasons if reason.code is Reason.LAW_UNDECIDED]
        if asked is None or asked.value is None or not asked.stderr:
            return
        for reason in undecided:
            by = reason.values["changes"].get(asked.name, 0.0)
            if _leaves_interval(asked, by):
                words = f"it would be {number(asked.value + by, 4)} {asked.unit} if {reason.values['condition']}, "
                yield replace(reason, clause=f"{words}which this record does not exclude; see the drive's manual")
        return
    held = any(row.of_joint and row.at_bound is not None for row in estimate.params.rows)
    gross = held or not any("changes" in reason.values for reason in loop.reasons)
    unexplained = not estimate.fit.filtered_error <= POOR_FIT
    if asked is None or gross or unexplained or asked.name in _moved_out(estimate):
        # A second fault was found beside the first one, corrected; another law that is not excluded is none.
        yield from [loop.reasons[0], *(one for one in loop.reasons[1:2] if "suspect" in one.values)]
    elif asked.name in _OF_SPRING:
        # Such a spring has no one stiffness, and such a friction is taken for one: corrections are of first order only.
        yield from (one for one in loop.reasons if one.code in _OF_MECHANICS)


def _of_others(estimate: Estimate, asked: EstimatedParameter | None) -> Iterator[Message]:
    """Yield the reasons of other failed checks against a value, and its interval if that is wide."""
    failed = [v for v in estimate.checks.verdicts if v.status is Status.FAILED and v.subject is not Subject.LOOP]
    for verdict in failed:
        name = asked.name if asked is not None and verdict.subject in _OF_VALUES else ""
        for reason in verdict.reasons:
            if reason.code in AGAINST_EVERY_VALUE or name in reason.values.get("parameters", ()):
                yield reason
    if asked is None or not asked.free or asked.at_bound is not None:
        return
    deviation = asked.deviation
    if asked.value is None or deviation is None or not math.isfinite(asked.value + deviation):
        yield Message(Reason.NO_INTERVAL, "its interval is not known")
    elif 2 * deviation > _WIDE * abs(asked.value):
        share = f"to {number(200 * deviation / abs(asked.value), 2)} % only" if asked.value else "not even by its sign"
        yield Message(Reason.WIDE_INTERVAL, f"it is known {share}")


# The verdict on controller and log


def loop_verdict(estimate: Estimate) -> Verdict | None:
    """Return the verdict on controller and log; None without one."""
    return next((v for v in estimate.checks.verdicts if v.subject is Subject.LOOP), None)


def moved_by_loop(estimate: Estimate, threshold: float = 0.0) -> Mapping[str, float]:
    """Return by how much the parameters change when the faults of loop and log that were found are corrected.

    Where none was found, it is by how much another law would change them that the record does not exclude.

    Args:
        estimate: with the verdict of its loop check, or no parameter is moved.
        threshold: standard errors by which a parameter must change at least.
    """
    loop = loop_verdict(estimate)
    reasons = () if loop is None else loop.reasons
    rows = {row.name: row.stderr or 0.0 for row in estimate.params.rows}
    total: dict[str, float] = {}
    for reason in [one for one in reasons if one.code != Reason.LAW_UNDECIDED] or reasons:
        for name, by in reason.values.get("changes", {}).items():
            total[name] = total.get(name, 0.0) + by
    return {name: by for name, by in total.items() if abs(by) > threshold * rows.get(name, 0.0)}


def _moved_out(estimate: Estimate) -> frozenset[str]:
    """Return the parameters that one fault of loop or log, or all of them together, moves out of their intervals."""
    loop, rows = loop_verdict(estimate), {row.name: row for row in estimate.params.rows}
    found = [one for one in (() if loop is None else loop.reasons) if one.code != Reason.LAW_UNDECIDED]
    each = [moved_by_loop(estimate), *(one.values.get("changes", {}) for one in found)]
    moved = [(name, by) for changes in each for name, by in changes.items()]
    return frozenset(name for name, by in moved if name not in rows or _leaves_interval(rows[name], by))


def _leaves_interval(row: EstimatedParameter, by: float) -> bool:
    """Test whether a change of a parameter is more than two standard errors, and not slight."""
    return abs(by) > max(2.0 * (row.stderr or 0.0), SLIGHT * abs(row.value or 0.0))
