"""Find the cause where a record does not fit the drive that was declared.

A sensitivity says what a small deviation of one number would change (`check_loop`). A torque that is ten times too
large, or a sample time that is twice as long, is no small deviation, and what fits it best among sensitivities is any
number, not the right one. So each cause is put right in turn (`Fault.correct`), the joint is identified again under it,
and the causes are ranked by the error that is left: the right one leaves what the right model leaves.

It looks for one mistake. Of two at once a number that is free may make up for much of both: so a cause must leave about
what is left by free linear responses to the reference (`linear_response`), which assume no drive at all. Where the best
one leaves clearly more, more than one thing is wrong, and that is said instead. Two that one number makes up for wholly
are told as that one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeAlias

import numpy as np

from jointid.common.document import Document, Documented, Listing, Table
from jointid.common.errors import FaultsError, JointidError, RecordError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Explanation, Fault, FaultTest, Hypothesis, Measure
from jointid.diagnostics.faults.forces import find_steps
from jointid.diagnostics.faults.motion import find_lost_motion, find_plain_cause, find_standstill
from jointid.diagnostics.faults.registry import FAULTS
from jointid.diagnostics.hypothesis_fits import ASTRAY, MORE, Fit, descend, fit_flexible, fit_rigid, pose, start_at
from jointid.diagnostics.linear_response import MEMORY, find_unexplained_share
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.verdict import POOR_FIT, Reason

_EXPLAINS = 0.85  # of the declared error: what the nearest cause leaves at most
_FITS = 0.15  # of the torque: what a right model leaves at most
_CLEARLY = 0.3  # of the declared error: so little says enough where no model fits
_MORE_OF_A_LAW = 1.3  # times what free linear responses leave: a law that leaves no more is all that is wrong
_FAR_MORE = 2.0  # times the same: an estimate that leaves so much, and is doubted, is looked at
_AS_GOOD = 1.1  # times the least error: such a cause may be the right one, too
_NOTHING_OF_IT = 0.8  # of the torque: a joint that is moved leaves less, whatever else moves it
_NO_RESPONSE = 0.1  # of the torque: so much that is no response to the reference may be another signal's
_NAMED = 3
_SUSPICIOUS = 0.1  # of the torque: where so much is left, a cause is looked for, whatever sensitivities show
_MUCH_LARGER = 0.25  # of a declared number: a fault so large is looked at
_MUCH_LATER = 0.5  # periods


_Found: TypeAlias = tuple[Fault, float | None, float]
"""A cause, its number, and the share of the torque that is left with it put right."""


@dataclass(frozen=True, slots=True)
class Causes(Documented):
    """What explains a record that does not fit the declared drive.

    Attributes:
        declared_error: share of the filtered torque that is left as the drive is declared; infinite where its loop
            cannot be simulated.
        explanations: the likeliest first, three at most, which this record cannot tell apart; none where nothing that
            was tried explains it.
        nearest: the single causes that explain most, two at most, where more than one thing is wrong; else none.
        unexplained: share of the torque that free linear responses to the reference leave; 0 where it was not asked.
        tried: what was left by each cause that was put right, the least first.
        plain: what the samples show, or a motor at rest, where nothing else explains the record; else None.
    """

    declared_error: float
    explanations: tuple[Explanation, ...]
    tried: tuple[Explanation, ...]
    nearest: tuple[Explanation, ...] = ()
    unexplained: float = 0.0
    plain: Message | None = None

    @property
    def found(self) -> bool:
        """True if there is a cause to tell, be it the nearest one only."""
        return bool(self.explanations or self.nearest or self.plain)

    @property
    def message(self) -> Message:
        """The causes in a sentence, under the code of the likeliest one."""
        if self.plain is not None:
            return self.plain
        left = (
            "with the drive as declared the loop cannot be simulated"
            if math.isinf(self.declared_error)
            else f"as declared {number(100 * self.declared_error, 2)} % of the torque is not explained"
        )
        if self.nearest:
            first = self.nearest[0]
            nearest = "the nearest is that" if len(self.nearest) == 1 else "the nearest are that"
            clause = f"none of the usual causes alone explains it, so more than one thing may be wrong: {nearest} "
            clause += ", and that ".join(one.words for one in self.nearest)
            words = f"{clause}; the first still leaves {number(100 * first.error, 2)} % of the torque, of which "
            words += f"{number(100 * self.unexplained, 2)} % is no response to the reference; {left}"
            values = {"tried": self._names, "nearest": [one.fault.name for one in self.nearest], "error": first.error}
            return Message(Reason.NO_CAUSE_FOUND, words, values, clause)
        if not self.explanations:
            clause = "the drive as declared does not fit, and none of the usual causes explains it"
            words = f"{left}, and none of the usual causes explains it ("
            words += f"{', '.join(one.fault.title for one in self.tried)})"
            if self.unexplained > _NO_RESPONSE:
                other = f"; {number(100 * self.unexplained, 2)} % of the torque is no response to the reference: "
                other += (
                    "check which column is the torque, and of which axis"
                    if self.unexplained > _NOTHING_OF_IT
                    else ("if a signal is injected, declare it (channel injected)")
                )
                clause, words = clause + other, words + other
            return Message(Reason.NO_CAUSE_FOUND, words, {"tried": self._names}, clause)
        best = self.explanations[0]
        clause = ", or ".join(one.words for one in self.explanations)
        clause += f", or {best.fault.doubt}" if best.fault.doubt else ""
        words = f"{clause}: with this put right {number(100 * best.error, 2)} % of the torque is left; {left}"
        values = {
            "causes": [{"cause": one.fault.name, "value": one.value, "error": one.error} for one in self.explanations],
            "declared_error": None if math.isinf(self.declared_error) else self.declared_error,
        }
        return Message(Reason.CAUSE_FOUND, words, values, clause)

    @property
    def _names(self) -> list[str]:
        return [one.fault.name for one in self.tried]

    def document(self, *, details: bool = False) -> Document:
        """Return the causes, and the table of all that were tried; there are no further details."""
        del details
        rows = tuple((one.words, f"{number(100 * one.error, 2)} %") for one in self.tried)
        return Document("Cause", (Listing((str(self.message),)), Table(("put right", "torque left"), rows)))


def find_causes(
    record: Record,
    loop: ClosedLoop,
    estimate: Estimate | None = None,
    *,
    shown: Sequence[DriveNumber] = (),
    progress: Progress = ignore_progress,
) -> Causes:
    """Find what explains a record that does not fit the declared drive.

    Args:
        record: with torque and reference.
        loop: as it is declared.
        estimate: of the joint under it, whose filter is used, and whose error if it is smaller; not every mistake
            leaves one.
        shown: how the drive shows the numbers of its controller, as `jointid.config.JointFile.drive_numbers` has it;
            without it they are told in SI.
        progress: is told.

    Raises:
        RecordError: a channel of the loop is missing, or the torque is 0 in every sample.
    """
    record.require(loop.channels, "The search for a cause")
    assert record.torque is not None
    if not np.any(record.torque.values):
        raise RecordError("The torque is 0 in every sample, which no cause explains; check which column it is.")
    plain = find_plain_cause(record) or find_standstill(record, loop)
    if plain is not None:
        return Causes(math.inf if estimate is None else estimate.fit.filtered_error, (), (), plain=plain)
    model = loop.joint.model
    asked = Filtering() if estimate is None else estimate.settings.filtering
    filtering = asked.resolve(record.torque.sample_time, model)
    tried = list_hypotheses(record, loop, filtering)
    progress(f"looking for the cause: {len(tried)} are put right in turn, and the joint identified again")
    fits = fit_flexible(tried, loop) if isinstance(loop.joint, FlexibleJoint) else fit_rigid(tried, loop.joint)
    found = _judge_faults(tried[0], fits, loop)
    declared = min((f.error for f in fits if f.hypothesis.fault is None), default=math.inf)
    if estimate is not None:
        declared = min(declared, estimate.fit.filtered_error)
    if fits and fits[0].hypothesis.fault is not None:  # its number counts, not that its search found the better end
        declared = min(declared, _declared_from(fits[0], tried[0]))
    tellings = [explain(*one, loop, shown) for one in sorted(found, key=lambda one: one[2])]
    once = {one.fault: one for tellings_of in reversed(tellings) for one in tellings_of[:1]}
    tried_out = tuple(sorted(once.values(), key=lambda one: one.error))
    explaining = _explaining(tellings, declared, loop, record.torque.sample_time)
    left = _unexplained(fits[0]) if fits else 0.0
    if explaining:
        best = explaining[0]
        # In a loop that rings for long, responses as short as these leave much, too.
        if best.error > (min(best.fault.more_than_responses * left, _FITS) if left > 0 else _FITS):
            others = (one for one in tried_out if one.fault is not best.fault)
            return Causes(declared, (), tried_out, (best, *_near(others, declared)), left)
        return Causes(declared, explaining, tried_out, unexplained=left)
    left = left or _left_as_declared(tried[0])
    return Causes(declared, (), tried_out, unexplained=left, plain=find_lost_motion(record, loop, left))


def list_hypotheses(record: Record, loop: ClosedLoop, filtering: Filtering) -> tuple[Hypothesis, ...]:
    """Return the drive as it is declared, and every fault that this record and controller can have corrected.

    Args:
        record: with torque and reference.
        loop: as it is declared.
        filtering: resolved.
    """
    declared = Hypothesis(None, record, (loop,), filtering)
    corrected = (replace(one, fault=f) for f in FAULTS if f.correct is not None for one in f.correct(declared))
    return (declared, *corrected)


def _judge_faults(declared: Hypothesis, fits: Sequence[Fit], loop: ClosedLoop) -> list[_Found]:
    """Return what is left with each fault corrected."""
    found: list[_Found] = []
    for fit in fits:
        fault = fit.hypothesis.fault
        if fault is not None:
            better = fit if fault.refine is None else fault.refine(fit, loop)
            found.append((fault, better.number, better.error))
    for fault in FAULTS:
        least = min((error for _, _, error in found), default=math.inf)
        judged = None if fault.judge is None else fault.judge(declared, fits[0] if fits else None, least)
        if judged is not None:
            found.append((fault, *judged))
    return found


def explain(
    fault: Fault, value: float | None, error: float, loop: ClosedLoop, shown: Iterable[DriveNumber] = ()
) -> tuple[Explanation, ...]:
    """Return the causes that a corrected fault stands for; numbers are shown as the drive has them."""
    meanings = fault.explain(value, loop, {one.number: one for one in shown})
    return tuple(Explanation(cause, words, by, error) for cause, words, by in meanings)


def _near(others: Iterable[Explanation], declared: float) -> tuple[Explanation, ...]:
    """Return the first of other causes, where it takes away something of what is left as declared."""
    return tuple(one for one in islice(others, 1) if one.error <= _EXPLAINS * declared)


def _unexplained(fit: Fit) -> float:
    """Return what free linear responses to the reference leave of the torque under a hypothesis."""
    assert fit.hypothesis.record.reference is not None
    # With samples that are wrongly taken to be far apart the loop seems to remember few of them.
    memory = MEMORY * max(fit.hypothesis.factor or 1.0, 1.0)
    return find_unexplained_share(fit.problem, fit.hypothesis.record.reference.values, memory)


def _left_as_declared(declared: Hypothesis) -> float:
    """Return what free linear responses to the reference leave of the torque as it is declared."""
    problem, reference = pose(declared, declared.loops[0]), declared.record.reference
    return 0.0 if problem is None or reference is None else find_unexplained_share(problem, reference.values)


def explain_misfit(
    estimate: Estimate,
    record: Record,
    faults: Sequence[FaultTest] | None,
    progress: Progress = ignore_progress,
    shown: Sequence[DriveNumber] = (),
    left: float | None = None,
) -> Causes | None:
    """Return what explains that a record does not fit its estimate; None where it fits, or nothing comes near.

    That no usual cause explains it is told where the estimate leaves much, so that none is blamed in its place.

    Args:
        estimate: by DIDIM, of the record.
        record: that it was identified from.
        faults: that the loop check found; None where the loop could not be checked.
        progress: is told.
        shown: see `find_causes`.
        left: share of the torque that is left under the law that the loop check found for the controller, where it did.
    """
    loop = estimate.settings.loop
    assert loop is not None
    if (still := find_standstill(record, loop)) is not None:
        return Causes(estimate.fit.filtered_error, (), (), plain=still)
    unchecked, faults = faults is None, faults or ()
    poor = estimate.fit.filtered_error > _SUSPICIOUS
    gross = any(_is_gross(fault, estimate.data.sample_time) for fault in faults)
    # A spring that is refused ends at bounds as a rule, whether or not anything is wrong.
    refused = any(p.value is None for p in estimate.params.rows)
    strained = not refused and any(p.of_joint and p.at_bound is not None for p in estimate.params.rows)
    if not (poor or gross or ((unchecked or faults) and (strained or _is_doubtful(estimate, record, loop)))):
        return None
    if left is not None and not gross and left <= _MORE_OF_A_LAW * _left_by_a_response(estimate, record, loop):
        return None  # under that law nothing more is wrong
    causes = find_causes(record, loop, estimate, shown=shown, progress=progress)
    return causes if causes.found or estimate.fit.filtered_error > POOR_FIT else None


def _is_doubtful(estimate: Estimate, record: Record, loop: ClosedLoop) -> bool:
    """Whether an estimate leaves far more of the torque than free linear responses do, or the torque makes steps."""
    if find_steps(record) is not None:
        return True
    return estimate.fit.filtered_error > _FAR_MORE * _left_by_a_response(estimate, record, loop) > 0


def _left_by_a_response(estimate: Estimate, record: Record, loop: ClosedLoop) -> float:
    """Return what free linear responses to the reference leave of the torque that an estimate is of."""
    assert record.reference is not None
    problem = torque_problem(record, loop, estimate.settings.filtering, loop.joint.parameters)
    return find_unexplained_share(problem, record.reference.values)


def _is_gross(test: FaultTest, period: float) -> bool:
    """Whether a fault is so large that its sensitivity is no guide to it."""
    if test.fault.measure is Measure.TIME:
        return abs(test.size) > _MUCH_LATER * period
    return abs(test.size) > _MUCH_LARGER * abs(test.declared) > 0


def explain_failure(
    error: JointidError,
    record: Record,
    loop: ClosedLoop | None,
    progress: Progress = ignore_progress,
    shown: Sequence[DriveNumber] = (),
) -> JointidError:
    """Return the error of an identification that failed, with the cause in its place, or before it, where one is found.

    Args:
        error: that was raised.
        record: that cannot be identified.
        loop: as it is declared; without one there is no cause to find.
        progress: is told.
        shown: see `find_causes`.
    """
    if loop is None or any(getattr(record, name) is None for name in loop.channels):
        return error
    try:
        causes = find_causes(record, loop, shown=shown, progress=progress)
    except (JointidError, np.linalg.LinAlgError):  # what was raised first is what is to be told
        return error
    if not causes.found:
        return error
    words = f"{causes.message.words}."
    if isinstance(error, FaultsError):  # of the record: each a thing of its own to put right
        return type(error)((f"{words} {error.faults[0]}", *error.faults[1:]))
    # How the search ended is an effect of the cause, and nothing to act on.
    return type(error)(words if causes.explanations or causes.plain else f"{words} {error}")


def _explaining(
    tellings: Sequence[tuple[Explanation, ...]], declared: float, loop: ClosedLoop, period: float
) -> tuple[Explanation, ...]:
    """Return what explains the record: nothing, or the best of what was tried and what leaves as little.

    Numbers that have to change by little are taken for a friction, or a noise, that no model has.
    """
    if not tellings or _is_small(tellings[0][0], loop, period):
        return ()
    least = tellings[0][0].error
    if least > tellings[0][0].fault.must_leave * declared or least > max(_FITS, _CLEARLY * min(declared, 1.0)):
        return ()
    found: dict[Fault, Explanation] = {}
    for one in (one for each in tellings if each[0].error <= _AS_GOOD * least for one in each):
        if not _is_small(one, loop, period):
            found.setdefault(one.fault, one)
    return tuple(found.values())[:_NAMED]


def _is_small(one: Explanation, loop: ClosedLoop, period: float) -> bool:
    """Whether a cause is a number that differs little from what is declared."""
    return one.fault.negligible is not None and one.fault.negligible(one.value, loop, period)


def _declared_from(best: Fit, declared: Hypothesis) -> float:
    """Return what the declared drive leaves where the search begins at another one's end: a start may have failed."""
    problem = pose(declared, replace(declared.loops[0], joint=best.problem.joint))
    if problem is None:
        return math.inf
    start = start_at(declared, problem, problem.vector(best.values))
    end = descend(start, MORE) if start.error < ASTRAY else None
    return math.inf if end is None else end.error
