"""Find the cause where a record does not fit the drive that was declared.

A sensitivity says what a small deviation of one number would change (`check_loop`). A torque that is ten times too
large, or a sample time that is twice as long, is no small deviation, and what fits it best among sensitivities is any
number, not the right one. So each cause is put right in turn (`hypotheses`), the joint is identified again under it,
and the causes are ranked by the error that is left: the right one leaves what the right model leaves.

It looks for one mistake. Of two at once a number that is free may make up for much of both: so a cause must leave about
what is left by free linear responses to the reference (`linear_response`), which assume no drive at all. Where the best
one leaves clearly more, more than one thing is wrong, and that is said instead. Two that one number makes up for wholly
are told as that one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import TypeAlias

import numpy as np

from jointid.common.errors import FaultsError, JointidError, RecordError
from jointid.common.messages import Progress, silent
from jointid.diagnostics.cause_words import Explanation, tell
from jointid.diagnostics.causes import Causes
from jointid.diagnostics.fault_tests import FaultTest
from jointid.diagnostics.hypotheses import Cause, Hypothesis, known_factors, list_hypotheses
from jointid.diagnostics.hypothesis_fits import (
    ASTRAY,
    FIRST,
    MORE,
    Fit,
    descend,
    fit_flexible,
    fit_rigid,
    follow,
    pose,
    start_at,
)
from jointid.diagnostics.linear_response import MEMORY, find_unexplained_share
from jointid.diagnostics.plain_causes import find_plain_cause, find_steps
from jointid.diagnostics.standstill import find_lost_motion, find_standstill
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit, grid_starts
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.problems.prescribed import motion_problem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.uncertainty.verdict import POOR_FIT

_EXPLAINS = 0.85  # of the declared error: what a cause must at least take away to be one
_EXPLAINS_BY_TIME = 0.6  # of the same, for a sample time that is wrong by a factor: that spoils all of a fit
_FITS = 0.15  # of the torque: what a right model leaves at most
_CLEARLY = 0.3  # of the declared error: so little says enough where no model fits
_MORE_IS_WRONG = 1.15  # times what free linear responses leave: who leaves more is not all that is wrong
_MORE_OF_A_LAW = 1.3  # times the same: a law that the loop check found, and leaves no more, is all that is wrong
_MORE_OF_A_MOTION = 2.0  # times the same, of a motion given as a reference: its response is the controller's, too
_FAR_MORE = 2.0  # times the same: an estimate that leaves so much, and is doubted, is looked at
_AS_GOOD = 1.1  # times the least error: such a cause may be the right one, too
_FLEXIBLE = 2.0  # times: what a mode takes away; of a friction that no model has its parameters take a third at most
_NAMED = 3
_RENAMED = 1.5  # times: a factor that is found so near to a known one may be that one
_HARDLY_MORE = 1.03  # times the error that a factor leaves: a known one that leaves no more is as good
_SUSPICIOUS = 0.1  # of the torque: where so much is left, a cause is looked for, whatever sensitivities show
_MUCH_LARGER = 0.25  # of a declared number: a fault so large is looked at
_MUCH_LATER = 0.5  # periods
_HARDLY = 0.1  # periods: a filter or a delay that is off by less is none
_SMALL = math.log(1.5)  # a number that is off by less is no such mistake: `check_loop` tells it, and its interval


_Found: TypeAlias = tuple[Cause, float | None, float]
"""A cause, its number, and the share of the torque that is left with it put right."""


def find_causes(
    record: Record,
    loop: ClosedLoop,
    estimate: Estimate | None = None,
    *,
    shown: Sequence[DriveNumber] = (),
    progress: Progress = silent,
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
    known = [_with_known_factor(fit, loop) for fit in fits]
    found: list[_Found] = [(f.hypothesis.cause, f.number, f.error) for f in known if f.hypothesis.cause]
    position = _position_as_reference(record, loop, filtering, fits[0] if fits else None)
    if position is not None:
        found.append((Cause.REFERENCE_IS_POSITION, None, position))
    if isinstance(loop.joint, RigidJoint) and (spring := _as_flexible(tried[0], found)) is not None:
        found.append(spring)
    declared = min((f.error for f in fits if f.hypothesis.cause is None), default=math.inf)
    if estimate is not None:
        declared = min(declared, estimate.fit.filtered_error)
    if fits and fits[0].hypothesis.cause is not None:  # its number counts, not that its search found the better end
        declared = min(declared, _declared_from(fits[0], tried[0]))
    tellings = [tell(cause, value, error, loop, shown) for cause, value, error in sorted(found, key=lambda one: one[2])]
    once = {one.cause: one for tellings_of in reversed(tellings) for one in tellings_of[:1]}
    tried_out = tuple(sorted(once.values(), key=lambda one: one.error))
    explaining = _explaining(tellings, declared, loop, record.torque.sample_time)
    left = _unexplained(fits[0]) if fits else 0.0
    moved = bool(explaining) and explaining[0].cause is Cause.REFERENCE_IS_POSITION
    by_response = (_MORE_OF_A_MOTION if moved else _MORE_IS_WRONG) * left
    # In a loop that rings for long, responses as short as these leave much, too.
    if explaining and explaining[0].error > (min(by_response, _FITS) if left > 0 else _FITS):
        others = (one for one in tried_out if one.cause is not explaining[0].cause)
        return Causes(declared, (), tried_out, (explaining[0], *_near(others, declared)), left)
    if explaining:
        return Causes(declared, explaining, tried_out, unexplained=left)
    left = left or _left_as_declared(tried[0])
    return Causes(declared, (), tried_out, unexplained=left, plain=find_lost_motion(record, loop, left))


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
    progress: Progress = silent,
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
    refused = any(p.value is None for p in estimate.params)
    strained = not refused and any(p.of_joint and p.at_bound is not None for p in estimate.params)
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


def _is_gross(fault: FaultTest, period: float) -> bool:
    """Whether a fault is so large that its sensitivity is no guide to it."""
    if fault.name.endswith("delay"):
        return abs(fault.size) > _MUCH_LATER * period
    scale = 1.0 if fault.name == "log_gain" else abs(fault.declared)
    return scale > 0 and abs(fault.size) > _MUCH_LARGER * scale


def explain_failure(
    error: JointidError,
    record: Record,
    loop: ClosedLoop | None,
    progress: Progress = silent,
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
    if tellings[0][0].cause is Cause.SAMPLE_TIME and least > _EXPLAINS_BY_TIME * declared:
        return ()
    if least > _EXPLAINS * declared or least > max(_FITS, _CLEARLY * min(declared, 1.0)):
        return ()
    found: dict[Cause, Explanation] = {}
    for one in (one for each in tellings if each[0].error <= _AS_GOOD * least for one in each):
        if not _is_small(one, loop, period):
            found.setdefault(one.cause, one)
    return tuple(found.values())[:_NAMED]


def _is_small(one: Explanation, loop: ClosedLoop, period: float) -> bool:
    """Whether a cause is a number that differs little from what is declared."""
    numbers = numbers_of(loop.controller)
    filtering = getattr(loop.controller, "velocity_filter", (1.0,))
    if one.cause is Cause.VELOCITY_FILTER and isinstance(filtering, tuple) and filtering != (1.0,):
        return False  # a first order in the place of taps is no small change
    if one.value is not None and one.cause in _OF_A_TIME:
        return abs(one.value - numbers.get(_OF_A_TIME[one.cause], 0.0)) < _HARDLY * period
    if one.value is None or one.cause not in _OF_A_NUMBER:
        return False
    declared = numbers.get(_OF_A_NUMBER[one.cause], 0.0) if _OF_A_NUMBER[one.cause] else 1.0
    return one.value > 0 < declared and abs(math.log(one.value / declared)) < _SMALL


_OF_A_NUMBER = {
    Cause.TORQUE_SCALE: "",  # told as a factor
    Cause.LAW_GAIN: "",
    Cause.REFERENCE_SCALE: "",
    Cause.POSITION_GAIN: "position_gain",
    Cause.DERIVATIVE_GAIN: "derivative_gain",
    Cause.INTEGRAL: "integral_gain",
}
_OF_A_TIME = {
    Cause.VELOCITY_FILTER: "velocity_filter.time_constant",
    Cause.TORQUE_FILTER: "",  # one more than those that are declared
    Cause.DELAY: "delay",
    Cause.REFERENCE_DELAY: "reference_delay",
}


def _as_flexible(declared: Hypothesis, found: Sequence[_Found]) -> _Found | None:
    """Return the mode that explains a record of a rigid joint clearly better than any other cause; else None.

    Its further parameters make up for a part of other causes, so as good as they is not enough.
    """
    rigid = declared.loops[0].joint
    assert isinstance(rigid, RigidJoint)
    loop = replace(declared.loops[0], joint=rigid.flexible)
    try:
        best = next(iter(fit_flexible((replace(declared, loops=(loop,)),), loop)), None)
    except (JointidError, np.linalg.LinAlgError):  # the other causes stand
        return None
    if best is None or best.error * _FLEXIBLE > min((error for _, _, error in found), default=math.inf):
        return None
    values = best.values
    if not all(values[name] > 0 for name in ("motor_inertia", "load_inertia", "stiffness")):
        return None
    return Cause.FLEXIBLE, FlexibleJoint.frequencies(values)["free_free"], best.error


def _with_known_factor(fit: Fit, loop: ClosedLoop) -> Fit:
    """Return the fit of a factor on the loop's gain with a known one, where that leaves hardly more.

    What no model has, as a ripple, moves a factor that is free; 75 is then 57.3, which an angle in degrees makes.
    """
    if fit.hypothesis.cause is not Cause.LAW_GAIN or fit.number is None:
        return fit
    declared = numbers_of(loop.controller)["gain"]
    near = sorted((abs(math.log(factor * declared / fit.number)), factor) for factor in known_factors(loop))
    for far, factor in near:
        if far > math.log(_RENAMED):
            break
        held = fit.problem.keeping({"gain": factor * declared})
        end = descend(replace(fit, problem=held, x=held.vector(fit.values)), FIRST)
        if end is not None and end.error <= _HARDLY_MORE * fit.error:
            return end
    return fit


def _declared_from(best: Fit, declared: Hypothesis) -> float:
    """Return what the declared drive leaves where the search begins at another one's end: a start may have failed."""
    problem = pose(declared, replace(declared.loops[0], joint=best.problem.joint))
    if problem is None:
        return math.inf
    start = start_at(declared, problem, problem.vector(best.values))
    end = descend(start, MORE) if start.error < ASTRAY else None
    return math.inf if end is None else end.error


def _position_as_reference(record: Record, loop: ClosedLoop, filtering: Filtering, best: Fit | None) -> float | None:
    """Return what is left if the reference is the motor's position; None where that cannot be.

    A flexible joint's motion is prescribed then, and what it does at rest is not compared; what is left is brought to
    the measure of the other causes by what the best of them leaves in both.
    """
    assert record.reference is not None
    assert record.torque is not None
    moved = replace(record, motor_position=record.reference, load_position=None)
    joint, settings = loop.joint, DriveSideFit()
    try:
        if not isinstance(joint, FlexibleJoint):
            return identify_record(moved, joint, IDIM(), filtering=filtering).fit.filtered_error
        around = settings.surroundings(record.torque.sample_time)
        problem = motion_problem(moved, DriveSide(joint), filtering, joint.parameters, around)
        start = grid_starts(problem, settings)[0][0]
        solution = follow(problem, start, MORE)
    except (JointidError, np.linalg.LinAlgError):
        return None
    left = float(np.linalg.norm(solution.residual)) / problem.size
    if best is None or best.problem.measured.size != problem.measured.size:
        return left
    measured = best.problem.measured
    other, size = (problem.filtered(one) for one in (measured - best.problem.torque(best.x), measured))
    return left * best.error * float(np.linalg.norm(size) / np.linalg.norm(other))
