"""Search for the cause of a misfit between a record and the declared drive.

Sensitivities show small deviations of one number (`check_loop`). For a large one, as a torque that is ten times too
large, the best fit among sensitivities is any number. So each fault is corrected in turn (`Fault.correct`), the joint
is identified again, and the causes are ranked by the residual: the right one has the residual of the right model.

The search assumes one mistake. A free number may absorb much of two: so the residual of a cause must be about that of
free linear responses to the reference (`model_free`), which assume no drive. If that of the best cause is clearly
larger, something else is wrong, and the message says so. Two mistakes that one number absorbs completely are reported
as that number.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.errors import FaultsError, JointidError, RecordError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Explanation, Fault, FaultTest, Hypothesis, Measure
from jointid.diagnostics.faults.forces import find_steps
from jointid.diagnostics.hypothesis_fits import (
    ASTRAY,
    MORE,
    Fit,
    descend,
    fit_below_resonance,
    fit_flexible,
    fit_rigid,
    pose,
    start_at,
)
from jointid.diagnostics.model_free import MEMORY, compare_law, excludes, find_unexplained_share
from jointid.diagnostics.samples import (
    find_broken_part,
    find_plain_cause,
    find_standstill,
)
from jointid.diagnostics.suspects import FAULTS
from jointid.estimation.identify import WINDOW, windows_of
from jointid.estimation.problems.base import DRIVE_AND_LOG, INITIAL
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import POOR_FIT, Reason
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.checks import still_faults
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

_SECONDS = 20.0  # of the processor, for the search
_FITS = 0.15  # of the torque: largest residual of a right model
_CLEARLY = 0.3  # of the declared error: such a residual is convincing if no model fits
_MORE_OF_A_LAW = 1.3  # times the residual of free linear responses: under a law with less nothing more is wrong
_FAR_MORE = 2.0  # times the same: the cause of a doubtful estimate with such a residual is searched for
_AS_GOOD = 1.1  # times the least error: such a cause may be the right one, too
_NO_RESPONSE = 0.1  # of the torque: so much that is no response to the reference may be another signal's
_NAMED = 3
_SUSPICIOUS = 0.1  # of the torque: the cause of such a residual is searched for, whatever sensitivities show
_MUCH_LARGER = 0.25  # of a declared number: the cause of such a fault is searched for
_MUCH_LATER = 0.5  # periods
_POOR_START = 0.05  # of the torque: a rigid joint that leaves more far below its resonance has a cause to be searched


@dataclass(frozen=True, slots=True)
class Causes:
    """Causes of a misfit between a record and the declared drive.

    Attributes:
        declared_error: residual share of the filtered torque with the declared drive; infinite if its loop cannot be
            simulated.
        explanations: at most three causes that this record cannot distinguish, the likeliest first.
        nearest: the cause that explains most, if something else is wrong; else None.
        unexplained: share of the torque that is no linear response to the reference; 0 if not computed.
        plain: a cause visible in the samples, or a motor at rest; else None.
        missed: titles of the faults that the time did not last for.
    """

    declared_error: float
    explanations: tuple[Explanation, ...] = ()
    nearest: Explanation | None = None
    unexplained: float = 0.0
    plain: Message | None = None
    missed: tuple[str, ...] = ()

    @property
    def found(self) -> bool:
        """True if there is a cause to report, if only the nearest one."""
        return bool(self.explanations or self.nearest or self.plain)

    @property
    def is_clear(self) -> bool:
        """True if a cause leaves far less than the drive as declared, or shows in the samples."""
        first = self.explanations[:1]
        return self.plain is not None or any(one.error <= _CLEARLY * min(self.declared_error, 1.0) for one in first)

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
        if self.missed:
            left += f"; in {_SECONDS:g} s of processor these were not tried: {', '.join(self.missed)}"
        if self.explanations:
            best = self.explanations[0]
            clause = ", or ".join(one.words for one in self.explanations)
            words = f"{clause}: with this put right {number(100 * best.error, 2)} % of the torque is left; {left}"
            causes = [{"cause": one.fault.name, "value": one.value, "error": one.error} for one in self.explanations]
            declared = None if math.isinf(self.declared_error) else self.declared_error
            return Message(Reason.CAUSE_FOUND, words, {"causes": causes, "declared_error": declared}, clause)
        clause = "the drive as declared does not fit, and none of the usual causes alone explains it"
        values: dict[str, object] = {}
        if self.nearest is not None:
            values = {"nearest": self.nearest.fault.name, "error": self.nearest.error}
            clause += (
                f": the nearest is that {self.nearest.words}, which leaves {number(100 * self.nearest.error, 2)} %"
            )
        if self.unexplained > _NO_RESPONSE:
            clause += f"; {number(100 * self.unexplained, 2)} % of the torque is no response to the reference: check "
            clause += "which column is the torque, and declare a signal that is injected (channel injected)"
        return Message(Reason.NO_CAUSE_FOUND, f"{clause}; {left}", values, clause)


def find_causes(
    record: Record,
    loop: ClosedLoop,
    estimate: Estimate | None = None,
    *,
    progress: Progress = ignore_progress,
    free: Sequence[str] = (),
) -> Causes:
    """Search for the cause of a misfit between a record and the declared drive.

    Args:
        record: with torque and reference.
        loop: as declared.
        estimate: of the joint under it, if there is one: its filter is used, and its error if smaller.
        progress: called with each step.
        free: names of what is identified beside the joint, as the delay; that of the estimate where there is one.

    Raises:
        RecordError: a channel of the loop is missing, or the torque is 0 in every sample.
    """
    record.require(loop.channels, "The search for a cause")
    assert record.torque is not None
    if not np.any(record.torque.values):
        raise RecordError("The torque is 0 in every sample, which no cause explains; check which column it is.")
    declared = math.inf if estimate is None else estimate.fit.filtered_error
    plain = find_plain_cause(record) or find_standstill(record, loop)
    if plain is not None:
        return Causes(declared, plain=plain)
    asked = Filtering() if estimate is None else estimate.settings.filtering
    filtering = asked.resolve(record.torque.sample_time, loop.joint.model)
    tried = list_hypotheses(record, loop, filtering, free if estimate is None else _found_beside(estimate, loop))
    progress(f"searching for the cause: {len(tried)} are corrected in turn, and the joint identified again")

    until = time.process_time() + _SECONDS
    flexible = isinstance(loop.joint, FlexibleJoint)
    fits = fit_flexible(tried, loop, until) if flexible else fit_rigid(tried, loop.joint, until=until)
    begun = {fit.hypothesis.fault for fit in fits}
    missed = [one.fault.title for one in tried if one.fault not in begun and one.fault is not None]
    missed = list(dict.fromkeys(missed)) if time.process_time() > until else []
    declared = min((declared, *(fit.error for fit in fits if fit.hypothesis.fault is None)))
    if fits and fits[0].hypothesis.fault is not None:  # its number counts, not that its search found the better end
        declared = min(declared, _declared_from(fits[0], tried[0]))
    tellings = [
        tuple(Explanation(cause, words, by, error) for cause, words, by in fault.explain(value, loop))
        for fault, value, error in sorted(_judge_faults(tried[0], fits), key=lambda one: one[2])
    ]
    explaining = _explaining(tellings, declared, loop, record.torque.sample_time)
    left = _fit_free_responses(tried[0], fits)
    best = explaining[0] if explaining else None
    # In a loop that rings for long, responses as short as these leave much, too.
    more = best and best.error > (min(best.fault.more_than_responses * left, _FITS) if left > 0 else _FITS)
    return Causes(declared, () if more else explaining, best if more else None, left, missed=tuple(missed))


def list_hypotheses(
    record: Record, loop: ClosedLoop, filtering: Filtering, free: Sequence[str] = ()
) -> tuple[Hypothesis, ...]:
    """Return the declared drive, and a hypothesis for every fault that this record and controller can have.

    A torque that is computed from the controller has no faults of its own. Where the declared law makes the logged
    torque of the logged motor position, a correction of law or log must make it, too.
    """
    declared = Hypothesis(None, record, (loop,), filtering, beside=tuple(one for one in free if one not in INITIAL))
    corrected = (
        replace(one, fault=one.fault or f) for f in FAULTS if f.correct is not None for one in f.correct(declared)
    )
    possible = (one for one in corrected if not record.computed or one.record.torque is record.torque)
    law = compare_law(record, loop)
    if law is not None and law.holds:
        possible = (one for one in possible if not _is_excluded(one, record, loop))
    wanted = [one for one in possible if one.free not in declared.beside]
    return (declared, *sorted(wanted, key=lambda one: len(one.loops)))  # the cheapest first


def _is_excluded(corrected: Hypothesis, record: Record, loop: ClosedLoop) -> bool:
    """Test whether the motor position excludes a correction."""
    if corrected.record is record:
        return all(excludes(record, loop, one.controller) for one in corrected.loops)
    law = compare_law(corrected.record, corrected.loops[0])
    return law is not None and not law.holds


def _found_beside(estimate: Estimate, loop: ClosedLoop) -> tuple[str, ...]:
    """Return the names of the numbers of law and log that an estimate found beside the joint."""
    names = {*numbers_of(loop.controller), *DRIVE_AND_LOG}
    return tuple(row.name for row in estimate.params.rows if row.name in names and not row.of_joint)


def _judge_faults(declared: Hypothesis, fits: Sequence[Fit]) -> list[tuple[Fault, float | None, float]]:
    """Return the causes, each with its number and the residual share of the torque with it corrected."""
    found = [(one.hypothesis.fault, one.number, one.error) for one in fits if one.hypothesis.fault is not None]
    for fault in FAULTS:
        least = min((error for _, _, error in found), default=math.inf)
        judged = None if fault.judge is None else fault.judge(declared, fits[0] if fits else None, least)
        found += [] if judged is None else [(fault, *judged)]
    return found


def _declared_from(best: Fit, declared: Hypothesis) -> float:
    """Return the residual of the declared drive from the solution of another one: its own start may have failed."""
    problem = pose(declared, replace(declared.loops[0], joint=best.problem.joint))
    if problem is None:
        return math.inf
    start = start_at(declared, problem, problem.vector(best.values))
    end = descend(start, MORE) if start.error < ASTRAY else None
    return math.inf if end is None else end.error


def _explaining(
    tellings: Sequence[tuple[Explanation, ...]], declared: float, loop: ClosedLoop, period: float
) -> tuple[Explanation, ...]:
    """Return the causes with the smallest residuals; none if they explain too little.

    Small changes of a number are attributed to an unmodelled friction or to noise.
    """

    def is_small(one: Explanation) -> bool:
        return one.fault.negligible is not None and one.fault.negligible(one.value, loop, period)

    if not tellings or is_small(tellings[0][0]):
        return ()
    least = tellings[0][0].error
    if least > tellings[0][0].fault.must_leave * declared or least > max(_FITS, _CLEARLY * min(declared, 1.0)):
        return ()
    found: dict[Fault, Explanation] = {}
    for one in (one for each in tellings if each[0].error <= _AS_GOOD * least for one in each):
        if not is_small(one):
            found.setdefault(one.fault, one)
    return tuple(found.values())[:_NAMED]


def _fit_free_responses(declared: Hypothesis, fits: Sequence[Fit]) -> float:
    """Return the share of the torque that is no linear response to the reference, under the best hypothesis."""
    hypothesis = fits[0].hypothesis if fits else declared
    problem = fits[0].problem if fits else pose(declared, declared.loops[0])
    assert hypothesis.record.reference is not None
    # With samples that are wrongly taken to be far apart the loop seems to remember few of them.
    memory = MEMORY * (max(hypothesis.factor or 1.0, 1.0) if hypothesis.free is None else 1.0)
    return 0.0 if problem is None else find_unexplained_share(problem, hypothesis.record.reference.values, memory)


def find_gross_cause(
    estimate: Estimate,
    record: Record,
    progress: Progress = ignore_progress,
    *,
    local: bool = False,
) -> Causes | None:
    """Return the causes of a gross misfit, for which no sensitivity is a guide; None where it is none.

    A spring may be refused for a cause that shows far below its resonance, however small the misfit is. A misfit that
    is `local` in time has only causes that the samples show: what acts all the time does not explain a part of it.
    """
    loop, filtering, left = estimate.settings.loop, estimate.settings.filtering, estimate.fit.filtered_error
    assert loop is not None
    if (plain := find_broken_part(record)) is not None:
        return Causes(left, plain=plain)
    if local:
        return None
    poor = left > _SUSPICIOUS
    if not poor and isinstance(loop.joint, FlexibleJoint) and any(p.value is None for p in estimate.params.rows):
        rigid = fit_below_resonance([Hypothesis(None, record, (loop,), filtering)], loop.joint)
        poor = min((fit.error for fit in rigid), default=0.0) >= _POOR_START
    return find_causes(record, loop, estimate, progress=progress) if poor else None


def explain_misfit(
    estimate: Estimate,
    record: Record,
    faults: Sequence[FaultTest] | None,
    progress: Progress = ignore_progress,
    left: float | None = None,
    known: Causes | None = None,
) -> Causes | None:
    """Return the causes of a misfit between an estimate and its record; None if it fits or no cause comes near.

    A large misfit without a cause is reported as well, so that no other test is blamed for it. `faults` are those of
    the loop check, None if the loop could not be checked. `left` is the residual share of the torque under the law that
    it found for the controller. `known` are the causes that `find_gross_cause` found. The others are as `find_causes`
    has them.
    """
    loop, error = estimate.settings.loop, estimate.fit.filtered_error
    assert loop is not None
    if (still := find_standstill(record, loop)) is not None:
        return Causes(error, plain=still)
    # A spring that is refused ends at bounds as a rule, whether or not anything is wrong.
    refused = any(p.value is None for p in estimate.params.rows)
    if refused and known is not None and known.explanations:
        return known
    gross = any(_is_gross(one, estimate.data.sample_time) for one in faults or ())
    if not (error > _SUSPICIOUS or gross):
        strained = not refused and any(p.of_joint and p.at_bound is not None for p in estimate.params.rows)
        doubted = faults is None or len(faults) > 0
        if not doubted or not (
            strained or find_steps(record) or error > _FAR_MORE * _response_error(estimate, record) > 0
        ):
            return None
    if left is not None and not gross and left <= _MORE_OF_A_LAW * _response_error(estimate, record):
        return None  # under that law nothing more is wrong
    causes = known or find_causes(record, loop, estimate, progress=progress)
    return causes if causes.found or error > POOR_FIT else None


def _is_gross(one: FaultTest, period: float) -> bool:
    """Return whether a fault is too large for a sensitivity to be a guide."""
    if one.fault.measure is Measure.TIME:
        return abs(one.size) > _MUCH_LATER * period
    return abs(one.size) > _MUCH_LARGER * abs(one.declared) > 0


def _response_error(estimate: Estimate, record: Record) -> float:
    """Return the residual share of free linear responses for the record of an estimate; 0 if that is too short."""
    loop = estimate.settings.loop
    assert loop is not None and record.reference is not None
    problem = torque_problem(record, loop, estimate.settings.filtering, loop.joint.parameters)
    return find_unexplained_share(problem, record.reference.values)


def find_failure_causes(
    record: Record,
    loop: ClosedLoop | None,
    free: Sequence[str] = (),
    progress: Progress = ignore_progress,
) -> Causes | None:
    """Return the causes of a failed identification, of a long record by a part of it; see `find_causes`.

    None without a loop, or where the search fails.
    """
    if loop is None or any(getattr(record, name) is None for name in loop.channels) or any(still_faults(record)):
        return None
    try:
        # As much of it as the memory holds.
        part = record if windows_of(record, loop, None) is None else cut(record, 0, WINDOW)
        return find_causes(part, loop, progress=progress, free=free)
    except (JointidError, np.linalg.LinAlgError):  # the error of the identification counts
        return None


def explain_failure(
    error: JointidError,
    record: Record,
    loop: ClosedLoop | None,
    progress: Progress = ignore_progress,
    free: Sequence[str] = (),
) -> JointidError:
    """Return the error of a failed identification, with its cause before it or in its place.

    It is returned with the remarks on the record if no cause is found.
    """
    if record.remarks and not isinstance(error, FaultsError):
        error = type(error)("; ".join((str(error).removesuffix("."), *record.remarks)) + ".")
    causes = find_failure_causes(record, loop, free, progress)
    if causes is None or not causes.found:
        return error
    words = f"{causes.message.words}."
    if isinstance(error, FaultsError):  # of the record: each a thing of its own to put right
        return type(error)((f"{words} {error.faults[0]}", *error.faults[1:]))
    # How the search ended is an effect of the cause, and nothing to act on.
    return type(error)(words if causes.explanations or causes.plain else f"{words} {error}")
