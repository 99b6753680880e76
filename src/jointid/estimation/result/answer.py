"""The answer of an estimate in a line: the value that was asked for, and whether to rely on it.

What was asked for is the stiffness of a flexible joint, the inertia of a rigid one, and all parameters of a robot. One
rule says whether to rely on it: nothing that was checked moves it out of its interval. A residual that is coloured or
repeats is in the interval already, and a fault of the loop that moves a friction leaves the inertia what it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from jointid.common.messages import Message
from jointid.common.text import in_words, join, number
from jointid.estimation.result.parts import EstimatedParameter, show_value
from jointid.estimation.result.verdict import AGAINST_EVERY_VALUE, POOR_FIT, Check, Reason, StiffnessBound, Subject

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate

_ASKED = ("stiffness", "inertia", "load_inertia", "motor_inertia", "inertia@1")  # the first that is free is the answer
_OF_MECHANICS = (Reason.SPRING_NOT_LINEAR, Reason.LOAD_NOT_RIGID, Reason.FRICTION_NOT_AS_MODELLED)
_OF_SPRING = ("stiffness", "damping")
_OF_VALUES = (Subject.BOUNDS, Subject.AGREEMENT, Subject.DRIFT, Subject.ENCODERS)  # speak against what they name
_WIDE = 0.5  # of the value: a wider 2-sigma interval says its order of magnitude only
_KNOWN = 0.1  # relative standard error of a robot's parameter that counts as known
SLIGHT = 1e-3
"""Share of a value that no decision depends on; the log of a simulator without noise shows smaller faults."""


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
            ``lower_bound``, None where there is none.
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
    rows = estimate.parameters
    asked = [rows[name] for name in _ASKED if name in rows]
    found = [row for row in asked if row.free or row.value is None or row.at_bound is not None]
    first = next(iter([*found, *(row for row in estimate.rows if row.free), *estimate.rows]))
    return Answer(_tell(estimate, first), _judge(estimate, first))


# The value


def _tell(estimate: Estimate, asked: EstimatedParameter) -> Message:
    """Return a value with its interval, unit and mode; of a refused one its bound, the softest admissible one."""
    mode, least, code = estimate.frequencies.get("free_free"), None, "value"
    words = f"{in_words(asked.name).capitalize()} {show_value(asked)} {asked.unit}"
    if asked.value is None:
        stated, code = told_bounds(estimate), "not_determined"
        words = f"{in_words(asked.name).capitalize()} not determined by this record"
        if bounds := [(b.stiffness, b.frequency, b.share) for b in stated if b.stiffness and b.frequency]:
            (least, hertz, _), code = min(bounds), "lower_bound"
            words += f": at least {number(float(f'{least:.2e}'), 3)} {asked.unit}, mode above {number(hertz, 2)} Hz"
        if least is not None and len(bounds) < len(stated):
            shares = [share for _, _, share in bounds]
            words += f", for a load of {100 * min(shares):.0f} to {100 * max(shares):.0f} % of the inertia"
    elif mode is not None:
        words += f", mode {number(mode, 3)} Hz"
    two_sigma = None if asked.deviation is None else 2 * asked.deviation
    values = {"parameter": asked.name, "value": asked.value, "two_sigma": two_sigma, "unit": asked.unit}
    return Message(code, words, values | {"mode_hz": mode, "lower_bound": least})


def told_bounds(estimate: Estimate) -> tuple[StiffnessBound, ...]:
    """Return the bounds of a refused stiffness; none where loop or model are not those of the torque they come from."""
    wrong = estimate.fit.filtered_error > POOR_FIT or _failed(estimate, Subject.LOOP)
    return () if wrong else estimate.bounds


def _count_known(estimate: Estimate) -> Message:
    """Return the number of known parameters of a robot, and its largest error."""
    asked = [row for row in estimate.rows if row.free and row.of_joint]
    known = [row for row in asked if row.value and row.stderr is not None and row.stderr < _KNOWN * abs(row.value)]
    left = estimate.fit.axis_errors
    worst = max(left, key=lambda axis: left[axis])
    words = f"{len(known)} of {len(asked)} parameters known to a tenth, {number(100 * left[worst], 3)} % of the torque "
    none = dict.fromkeys(("parameter", "value", "two_sigma", "unit", "mode_hz", "lower_bound"))
    values = none | {"known": len(known), "asked": len(asked), "worst": worst}
    return Message("parameters", f"{words}of {worst} not explained", values)


# Whether to rely on it


def _judge(estimate: Estimate, asked: EstimatedParameter | None) -> Message:
    """Return the trust in a value; in all values of a robot where none is asked for."""
    refused, loop = asked is not None and asked.value is None, estimate.about(Subject.LOOP)
    against = [*_of_loop(estimate, asked), *([] if refused else _of_others(estimate, asked))]
    rows, springs = _moved_out(estimate), _failed(estimate, Subject.STIFFNESS)
    unchecked = _name_unchecked(estimate) if asked is None or asked.free else "It was declared, not identified"
    code, moved = Trust.NOT_CHECKED, list[str]()
    if against:
        code, words = Trust.NOT_YET, f"Do not rely on it yet: {'; '.join(one.brief for one in against[:2])}"
    elif asked is not None and refused:
        remedy = "Identify the joint as rigid, or record" if asked.name == "stiffness" else "Record"
        code, words = Trust.REFUSED, f"{remedy} a motion that shows it"
    elif rows and asked is not None:
        code, moved, against = Trust.PARTLY, rows, [*loop[:1]]
        words = f"You can rely on it, but not on {join([*map(in_words, rows)])}: {loop[0].brief}"
    elif springs:
        code, against, moved = Trust.PARTLY, springs[:1], [row.name for row in estimate.rows if row.value is None]
        words = "You can rely on it, but not on joints whose spring the record does not show"
    elif unchecked:
        words = unchecked
        if estimate.motion_measured and (asked is None or asked.free):
            against = [Message(Reason.MOTION_MEASURED, words)]
    else:
        within = ": what is wrong with loop or log moves it by less than its interval"
        code, words = Trust.RELIABLE, f"You can rely on it{within if _failed(estimate, Subject.LOOP) else ''}"
    return Message(code, words, {"reasons": [str(one.code) for one in against], "parameters": moved})


def _failed(estimate: Estimate, name: Subject) -> list[Message]:
    """Return the statements that failed of a question."""
    return [one for one in estimate.about(name) if one.passed is False]


def _name_unchecked(estimate: Estimate) -> str:
    """Return the conditions of an answer that were not checked; "" if nothing."""
    loop = estimate.about(Subject.LOOP)
    if estimate.motion_measured or not loop:  # another record has the same bias where the motion was measured
        remedy = "validate it on another record"
        if estimate.motion_measured:
            remedy = "the motion was measured under control: what disturbs it biases these values; identify by DIDIM"
        left = f"{number(100 * estimate.fit.filtered_error, 2)} % of the {estimate.signal} is not explained"
        return f"Checked by its fit only ({left}): {remedy}"
    if loop[0].passed is None:
        axes = loop[0].values.get("axes", ())
        which = f"controller of {join(axes)}" if axes else "controller"
        return f"You can rely on it if the {which} is as declared, which was not checked"
    if any(one.passed is None for one in estimate.about(Subject.SCALE)):
        return "You can rely on it if the scale of the controller's gains is right, which positions do not show"
    return ""


def _of_loop(estimate: Estimate, asked: EstimatedParameter | None) -> list[Message]:
    """Return the faults of loop and log that move the value; all that is wrong where no value is asked for.

    Where a parameter is held at a bound, or the torque is not explained, others make up for what is wrong: how far it
    moves a value alone says little then.
    """
    loop = _failed(estimate, Subject.LOOP)
    if not loop or (asked is not None and asked.value is None):
        return loop[:1]
    held = any(row.of_joint and row.at_bound is not None for row in estimate.rows)
    gross = held or not any("changes" in one.values for one in loop)
    unexplained = not estimate.fit.filtered_error <= POOR_FIT
    if asked is None or gross or unexplained or asked.name in _moved_out(estimate):
        # A second fault was found beside the first one, corrected.
        return [loop[0], *(one for one in loop[1:2] if "suspect" in one.values)]
    # Such a spring has no one stiffness, and such a friction is taken for one: corrections are of first order only.
    return [one for one in loop if asked.name in _OF_SPRING and one.code in _OF_MECHANICS]


def _of_others(estimate: Estimate, asked: EstimatedParameter | None) -> Iterator[Message]:
    """Yield the statements of other failed checks against a value, and its interval if that is wide."""
    for one in estimate.checks:
        if one.passed is False and one.name != Subject.LOOP:
            named = asked is not None and one.name in _OF_VALUES and asked.name in one.values.get("parameters", ())
            if named or one.code in AGAINST_EVERY_VALUE:
                yield one
    if asked is None or not asked.free or asked.at_bound is not None:
        return
    value, deviation = asked.value or 0.0, asked.deviation
    if deviation is None or not math.isfinite(value + deviation):
        yield Message(Reason.NO_INTERVAL, "its interval is not known")
    elif 2 * deviation > _WIDE * abs(value):
        share = f"to {number(200 * deviation / abs(value), 2)} % only" if value else "not even by its sign"
        yield Message(Reason.WIDE_INTERVAL, f"it is known {share}")


# By how much faults of loop and log move the parameters


def moved_by_loop(estimate: Estimate) -> dict[str, float]:
    """Return by how much the parameters change when the faults of loop and log that were found are corrected."""
    total = dict[str, float]()
    for name, by in _changes(estimate.about(Subject.LOOP)):
        total[name] = total.get(name, 0.0) + by
    return total


def _changes(found: tuple[Check, ...]) -> list[tuple[str, float]]:
    return [change for one in found for change in one.values.get("changes", {}).items()]


def _moved_out(estimate: Estimate) -> list[str]:
    """Return the parameters that a fault of loop or log, or all of them together, moves out of their intervals.

    They leave two standard errors, and by no slight change.
    """
    moved = dict[str, float]()
    for name, by in (*moved_by_loop(estimate).items(), *_changes(estimate.about(Subject.LOOP))):
        moved[name] = max(moved.get(name, 0.0), abs(by))
    within = {row.name: max(2.0 * (row.stderr or 0.0), SLIGHT * abs(row.value or 0.0)) for row in estimate.rows}
    return [name for name in within if moved.get(name, 0.0) > within[name]]
