"""Search for the cause of a misfit between record and declared drive.

Sensitivities show small deviations of one number (`search`). For large ones each mistake is corrected in turn
(`changes`), the joint is identified again, and the causes are ranked by residual. Of each case the best start is
followed for a few steps, then as long as a step promises a part of what it lacks to be as good as the best. A flexible
joint begins as it was identified, if nearly right; else as rigid, far below its resonance, then with a mode.

The search assumes one mistake. A number may absorb much of two: so the residual of a cause must be about that of free
linear responses to the reference (`model_free`), and the likeliest fault beside it may not be an impossible one.
Otherwise something else is wrong. Two mistakes that one number absorbs completely are reported as that number.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import FaultsError, JointidError, RecordError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.parallel import in_threads
from jointid.common.text import number
from jointid.diagnostics import model_free
from jointid.diagnostics.changes import NOTCH_DEPTH, Case, Cause, is_small, list_changes
from jointid.diagnostics.score import LEVEL, SolvedLoop
from jointid.diagnostics.search import MORE, is_gross
from jointid.diagnostics.suspects import Finding
from jointid.estimation.identify import identify_record, part_of
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.parameters import DELAYS, OF_LOG
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import POOR_FIT, Reason
from jointid.estimation.rigid_starts import rigid_starts
from jointid.estimation.spring_search import frequencies_to_try, rigid_cutoff, start_with_mode
from jointid.models.controllers import numbers_of
from jointid.models.controllers.filters import as_filter
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.checks import still_faults
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import DELAY
from jointid.simulation.start import INITIAL
from jointid.solvers.solve import LevenbergMarquardt, solve

_ENOUGH, _SECONDS = 20_000, 4.0  # periods, and s, of a record's beginning that shows a gross mistake
_FITS = 0.15  # of the torque: largest residual of a right model
_CLEARLY = 0.3  # of the declared error: such a residual is convincing if no model fits
_LEAVES, _LEAVES_BY_TIME = 0.85, 0.6  # of the declared error, at most: a wrong sample time spoils all of a fit
# Times the residual of free responses: a cause that leaves more is not all that is wrong
_MORE, _MORE_OF_POSITION = 1.15, 1.4
_FAR_MORE = 2.0  # times the same: the cause of a doubtful estimate with such a residual is searched for
_AS_GOOD, _NOTCH = 1.1, 1.01  # times the least error: it may be the cause, too; a notch, of more numbers, is no better
_NO_RESPONSE = 0.3  # of the torque: so much that is no response to the reference says more than how a search ended
_UNRELATED = 0.95  # of the torque: so much that is no response to the reference is another signal's
_SUSPICIOUS = 0.1  # of the torque: the cause of such a residual is searched for, or of no response said
_FEW, _TO_ITS_END = 5, 40  # evaluations of the parts of a descent
_LITTLE, _PROMISED = 0.01, 0.25  # of the squares, and of what a case lacks to the best: a step that is worth it
_ASTRAY = 3.0  # times the torque: a loop with such a residual runs away
_BEHIND, _HOPELESS = 2.5, 0.6  # times the least error; of the torque: a case, and a race, with more is given up
_ROUGHLY, _SWINGS = 0.05, 10.0  # of the torque: what a rigid model of a flexible joint adds; periods of its cut-off
_FASTEST = 5e-4  # s of a period: a faster law is as fast as the log, or counts or holds samples, or waits for the end
_NEAR = (0.5, 1.0, 2.0)  # times the number of the rigid joint, which is approximate
_VANISHES = 1e-2  # of the least start of a number: its part of the law is gone there, and with it its derivative
_LIGHTEST = 0.01  # of the rigid joint: inertia of a motor; a lighter one chatters in its loop
_CUT, _OFTEN = 0.95, 0.1  # of the largest torque, and of the samples: a limit may cut so many
_INERTIAS = (1.0, 1.3, 1.6, 2.0, 2.5, 3.2, 4.0)  # times a start's, which is too small where a limit cuts
_APART, _SHARES = 2, (0.35, 0.65)  # one of so many frequencies is tried; of the load in the inertia of a flexible joint

FAILS = (JointidError, np.linalg.LinAlgError)  # raised where a record does not allow a fit or a check


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
    """

    declared_error: float
    explanations: tuple[Cause, ...] = ()
    nearest: Cause | None = None
    unexplained: float = 0.0
    plain: Message | None = None

    @property
    def found(self) -> bool:
        """True if there is a cause to report, even the nearest only."""
        return bool(self.explanations or self.nearest or self.plain or self.unexplained > _UNRELATED)

    @property
    def message(self) -> Message:
        """The causes in a sentence, under the code of the likeliest one."""
        if self.plain is not None:
            return self.plain
        declared = None if math.isinf(self.declared_error) else self.declared_error
        left = "with the drive as declared the loop cannot be simulated"
        if declared is not None:
            left = f"as declared {number(100 * declared, 2)} % of the torque is not explained"
        if self.explanations:
            best = self.explanations[0]
            clause = ", or ".join(one.words for one in self.explanations)
            words = f"{clause}: with this put right {number(100 * best.left, 2)} % of the torque is left; {left}"
            causes = [{"cause": one.name, "value": one.value, "error": one.left} for one in self.explanations]
            return Message(Reason.CAUSE_FOUND, words, {"causes": causes, "declared_error": declared}, clause)
        clause = "the drive as declared does not fit, and none of the usual causes alone explains it"
        values: dict[str, object] = {}
        if self.nearest is not None:
            values = {"nearest": self.nearest.name, "error": self.nearest.left}
            clause += f": the nearest is that {self.nearest.words}, which leaves {number(100 * self.nearest.left, 2)} %"
        if self.unexplained > _SUSPICIOUS:
            said = f"{number(100 * self.unexplained, 2)} % of the torque is no response to the reference"
            remedy = "check which column is the torque, and declare a signal that is injected (channel injected)"
            clause, left, values = f"{clause}; {said}", f"{left}; {remedy}", {**values, "remedy": remedy}
            if self.unexplained > _UNRELATED and self.nearest is None:
                causes = [{"cause": "torque_column", "value": None, "error": self.unexplained}]
                return Message(Reason.CAUSE_FOUND, f"{said}: {remedy}", {"causes": causes, "remedy": remedy}, said)
        return Message(Reason.NO_CAUSE_FOUND, f"{clause}; {left}", values, clause)


# The order of the questions


def explain_misfit(
    estimate: Estimate, record: Record, findings: Sequence[Finding] | None, progress: Progress = ignore_progress
) -> Sequence[Causes | None]:
    """Causes of a misfit; None without one, empty without a search.

    A large misfit without a cause is reported as well, so that no other test is blamed. `findings`: None if unchecked.
    """
    asked, loop, error, rows = record.reference, estimate.settings.loop, estimate.fit.filtered_error, estimate.rows
    assert loop is not None and asked is not None
    every = findings or ()
    gross = [one for one in every if is_gross(one.test, estimate.data.sample_time)]
    poor = bool(gross) or error > _SUSPICIOUS
    if not poor and loop.joint.model == "flexible" and any(p.value is None for p in rows):
        # Far below its resonance a flexible joint is rigid: its spring causes no misfit there, and no other gain.
        rigid = _list_rigid_starts(Case(record, loop, estimate.settings.filtering))
        for one in _race([rigid], _ROUGHLY):
            tests = SolvedLoop(one.problem, one.x).tests
            gains = (test for test in tests if test.p_value <= LEVEL and test.fault.measure != "ms")
            poor = one.error > _SUSPICIOUS or any(is_gross(test, estimate.data.sample_time) for test in gains)
    if not poor and findings is not None and not findings:
        return ()
    fits = [f.left for f in every if f.left is not None and (len(every) == 1 or f.law or f.value is None)]
    problem = torque_problem(record, loop, estimate.settings.filtering, loop.joint.parameters)
    responses = 0.0 if poor and not fits else model_free.find_unexplained_share(problem, asked.values)
    # A spring that is refused ends at bounds as a rule, whether or not anything is wrong.
    strained = all(p.value is not None for p in rows) and any(p.of_joint and p.at_bound is not None for p in rows)
    if not (poor or strained or model_free.find_steps(record) or error > _FAR_MORE * responses > 0):
        return ()
    if fits and fits[0] <= (MORE * responses or _FITS) and all(one.test.fault.measure == "ms" for one in gross):
        return ()  # with that corrected nothing more is wrong; a factor that is gross may be another quantity's
    causes = find_causes(record, loop, estimate, progress=progress)
    return (causes if causes.found or error > POOR_FIT else None,)


def explain_failure(
    error: JointidError, record: Record, loop: ClosedLoop | None, progress: Progress, free: Sequence[str] = ()
) -> JointidError:
    """Error of a failed identification, with or replaced by its cause, whose code it has."""
    if record.remarks and not isinstance(error, FaultsError):
        error = type(error)("; ".join((str(error).removesuffix("."), *record.remarks)) + ".")
    causes = None
    if loop is not None and all(getattr(record, one) for one in loop.channels) and not any(still_faults(record)):
        with contextlib.suppress(*FAILS):  # the error of the identification counts
            causes = find_causes(part_of(record), loop, progress=progress, free=free)
    if causes is None or not (causes.found or causes.unexplained > _NO_RESPONSE):
        error.code = "unreadable" if isinstance(error, RecordError) else "not_identified"
        return error
    named, words = causes.explanations, f"{causes.message.words}."
    if isinstance(error, FaultsError):  # of the record: each a thing of its own to put right
        error = type(error)((f"{words} {error.faults[0]}", *error.faults[1:]))
    else:  # how the search ended is an effect of the cause, and nothing to act on
        error = type(error)(words if named or causes.plain else f"{words} {error}")
    error.code = named[0].name if named else str(causes.message.code)
    return error


# The search


def find_causes(
    record: Record,
    loop: ClosedLoop,
    estimate: Estimate | None = None,
    *,
    progress: Progress = ignore_progress,
    free: Sequence[str] = (),
) -> Causes:
    """Search for the cause of a misfit between record and declared drive.

    Args:
        record: with torque and reference.
        loop: as declared.
        estimate: under it; gives filter, start, error, and free numbers outside the joint.
        progress: called with each step.
        free: names of those numbers without an estimate.
    """
    left = math.inf if estimate is None else estimate.fit.filtered_error
    if (plain := model_free.find_plain_cause(record)) is not None:
        return Causes(left, plain=plain)
    filtering = Filtering()
    if estimate is not None:
        filtering, names = estimate.settings.filtering, {*numbers_of(loop.controller), *OF_LOG}
        free = [row.name for row in estimate.rows if row.name in names and not row.of_joint]
    declared = Case(record, loop, filtering, beside=tuple(one for one in free if one not in INITIAL))
    declared = replace(declared, filtering=filtering.resolve(declared.torque.sample_time, loop.joint.model))
    posed = _pose(declared, loop)
    responses = 0.0 if posed is None else model_free.find_unexplained_share(posed, declared.reference.values)
    if responses > _UNRELATED and not loop.joint.forces:  # those of the position answer no reference
        return Causes(left, unexplained=responses)
    seconds = max(_SECONDS, _ENOUGH * max(declared.period, min(declared.torque.sample_time, _FASTEST)))
    declared, *_ = tried = list_cases(replace(declared, record=begin_records([record], seconds)[0]))
    progress(f"searching for the cause: {len(tried)} are corrected in turn, and the joint identified again")
    flexible = loop.joint.model == "flexible"  # and rigid far below its resonance
    solved: dict[str, Any] = {} if estimate is None else {row.name: row.value for row in estimate.rows}
    known = list[Iterator[Fit]]()
    if posed is not None and flexible and left <= _SUSPICIOUS and None not in solved.values():  # nearly right
        begin = Fit(declared, posed, posed.vector(solved))
        known = [_list_flexible_starts(replace(begin, case=one), begin) for one in tried]
    fits = _race(known or [_list_rigid_starts(one) for one in tried], 0.0 if known else _ROUGHLY * flexible)
    if flexible:
        near = [one for one in fits if one.error <= max(_BEHIND * fits[0].error, fits[0].error + _ROUGHLY)]
        fits = near if known else _race([_list_flexible_starts(one) for one in near])
        fits = sorted([*fits, *_race([_list_flexible_starts(one, fits[0]) for one in fits])], key=lambda one: one.error)
    as_declared = [fit for fit in fits if fit.case.change is None]
    left = min((left, *(fit.error for fit in as_declared)))
    for fit in fits[:1]:
        responses = model_free.find_unexplained_share(fit.problem, fit.case.reference.values) or responses
    candidates = [
        replace(cause, left=fit.error)
        for fit in fits
        if fit.case.change is not None
        for cause in fit.case.change.say(fit.number, declared)
    ]
    best = min(candidates, key=lambda one: one.left, default=None)
    if not flexible or best is None or best.left > _MORE * responses or best.name == "position_gain":  # without a lag
        with contextlib.suppress(*FAILS):
            moved = replace(declared.record, motor_position=declared.record.reference, load_position=None)
            one = identify_record(moved, loop.joint, DriveSideFit() if flexible else IDIM(), declared.filtering)
            words = "the channel given as the reference is the motor's position"
            candidates.append(Cause("reference_is_position", words, left=one.fit.filtered_error))
    if isinstance(loop.joint, RigidJoint):
        least = min((one.left for one in candidates), default=math.inf)
        for fit in as_declared if least > _FAR_MORE * responses else ():
            bends = replace(fit.case, loop=replace(fit.case.loop, joint=loop.joint.flexible))
            for bent in _race([_list_flexible_starts(replace(fit, case=bends))]):
                mode = loop.joint.flexible.frequencies(bent.problem.values(bent.x))["free_free"]
                words = f'the joint is flexible (model = "flexible"), with a mode near {number(mode, 2)} Hz'
                candidates += [Cause("flexible", words, mode, bent.error)] * (bent.error * _FAR_MORE <= least)
    candidates.sort(key=lambda one: one.left * (_NOTCH if one.name == "notch" else 1.0))
    explaining = _explaining(candidates, left, declared, None not in solved.values())
    best = explaining[0] if explaining else None
    # In a loop that rings for long, responses as short as these leave much, too.
    most = responses * (_MORE_OF_POSITION if best is not None and best.name == "reference_is_position" else _MORE)
    more = best and best.left > min(most or _FITS, _FITS)
    for fit in [one for one in fits if best and not more and one.error == best.left and one.case.change][:1]:
        likeliest = SolvedLoop(fit.problem, fit.x).tests[:1]
        more = any(one.p_value <= LEVEL and not one.possible for one in likeliest)
    return Causes(left, () if more else explaining, best if more else None, responses)


def begin_records(records: Sequence[Record], seconds: float) -> Sequence[Record]:
    """The beginning of one log, from its first motion on; itself if a part of it moves one way, or is no shorter."""
    asked = [one for one in (record.reference or record.motor_position for record in records) if one is not None]
    seconds += min((one.sample_time * int(np.argmax(one.values != one.values[0])) for one in asked), default=math.inf)
    if seconds >= records[0].duration:
        return records
    parts = []
    for record in records:
        begun = ((name, one, math.ceil(seconds / one.sample_time)) for name, one in record.items())
        parts.append(record.with_channels({name: replace(one, values=one.values[:size]) for name, one, size in begun}))
    return records if any(map(model_free.find_too_short, parts)) else parts


def list_cases(declared: Case) -> list[Case]:
    """The declared drive, and a case for each possible mistake.

    A torque that is computed from the controller has no mistakes of its own. If the declared law reproduces the logged
    torque from the logged motor position, a corrected law or log must, too.
    """
    record, loop = declared.record, declared.loop
    law, found = model_free.compare_law(record, loop), list[Case]()
    for change in list_changes(declared):
        for case in change.correct(declared):
            excluded = case.free in declared.beside or (record.computed and case.record.torque is not record.torque)
            if law is not None and law.holds and case.record is record:
                excluded |= all(model_free.excludes(record, loop, one.controller) for one in case.loops)
            elif law is not None and law.holds:
                excluded |= not getattr(model_free.compare_law(case.record, case.loop), "holds", True)
            found += [] if excluded else [replace(case, change=change)]
    return [declared, *sorted(found, key=lambda one: len(one.starts))]  # the cheapest first


def _explaining(candidates: Sequence[Cause], left: float, declared: Case, tested: bool) -> tuple[Cause, ...]:
    """Causes with the smallest residuals; none if they explain too little."""
    if not candidates or is_small(best := candidates[0], declared, tested):
        return ()
    most = (_LEAVES_BY_TIME if best.name == "sample_time" else _LEAVES) * left
    if best.left > min(most, max(_FITS, _CLEARLY * min(left, 1.0))):
        return ()
    found: dict[str, Cause] = {}
    for one in (each for each in candidates if not is_small(each, declared, tested)):
        if one.left <= _AS_GOOD * best.left and (one is best or one.name != "notch"):
            found.setdefault(one.name, one)
    return tuple(found.values())[:3]


# The joint in each case


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Solution of a case: problem, parameters, and residual share of the torque."""

    case: Case
    problem: ClosedLoopProblem
    x: FloatArray
    error: float = math.inf

    @property
    def number(self) -> float | None:
        """The corrected number; None if the case has none."""
        if not self.case.free:
            return self.case.factor
        return (self.case.factor or 1.0) * self.problem.values(self.x)[self.case.free]

    def begin(self) -> Fit:
        """Return the start with its residual share."""
        with np.errstate(all="ignore"):  # a loop that runs away, or a torque that the filter removes
            left = np.linalg.norm(self.problem.residual(self.x)) / self.problem.size
        return replace(self, error=float(left) if math.isfinite(left) else math.inf)

    def restore_period(self) -> Fit:
        """Return the start under its controller at the period of its case."""
        law: Any = self.problem.loop.controller
        if (own := getattr(self.case.controller, "period", None)) == getattr(law, "period", None):
            return self
        return replace(self, problem=self.problem.under(replace(law, period=own), self.case.record))

    def descend(self, evaluations: int, worth: float = 0.0) -> Fit | None:
        """Return the fit after a limited descent; None if it fails."""
        try:
            with np.errstate(all="ignore"):
                solution = solve(self.problem, LevenbergMarquardt(1e-4, evaluations, worth=worth), self.x)
        except FAILS:  # a loop that runs away, or a part of the law that vanishes
            return None
        error = float(np.linalg.norm(solution.residual)) / self.problem.size
        return replace(self, x=solution.x, error=error) if error < _ASTRAY else None


def _race(starts: Sequence[Iterator[Fit]], loss: float = 0.0) -> list[Fit]:
    """Solutions of the cases, best first.

    The best start of each case is followed, and poor ones are dropped early. Cases within the share `loss` of the best
    are kept for a later race.
    """
    begun = itertools.chain.from_iterable(in_threads(list, starts))
    tried = _best_of_each(fit for fit in in_threads(Fit.begin, [*begun]) if fit.error < _ASTRAY)
    fits = _best_of_each(filter(None, in_threads(lambda fit: fit.descend(_FEW, _LITTLE), tried)))
    least = fits[0].error if fits else 0.0
    for k, fit in enumerate(fits if least < _HOPELESS or len(fits) == 1 else ()):
        goal = max(_AS_GOOD * least, least + loss)
        if fit.error <= max(_BEHIND * least, goal):
            lacks = 1.0 - (goal / (max(fit.error, goal) or 1.0)) ** 2
            end = fit.descend(_TO_ITS_END, max(_PROMISED * lacks, _LITTLE if loss else 0.0)) or fit
            own = end.restore_period() if end.error <= goal and not loss else end  # where its number is stated
            fits[k] = end if own is end else own.descend(_TO_ITS_END) or end
            least = min(least, fits[k].error)
    return _best_of_each(fits, lambda case: (id(case.change), id(case.record), id(case.loop)))


def _best_of_each(fits: Iterable[Fit], key: Callable[[Case], object] = id) -> list[Fit]:
    """Fit of each case with the least residual, the best first."""
    cases = dict[object, Fit]()
    for fit in sorted(fits, key=lambda fit: fit.error):
        cases.setdefault(key(fit.case), fit)
    return [*cases.values()]


def _list_rigid_starts(case: Case) -> Iterator[Fit]:
    """Yield starts by the inverted controller or exact tracking, at some delays."""
    size = np.abs(case.torque.values)
    cut = case.free == "limit" and np.mean(size > _CUT * np.max(size)) > _OFTEN
    for problem in filter(None, (_pose(case, loop, low=True) for loop in case.loops)):
        with contextlib.suppress(JointidError):
            for values in rigid_starts(problem, ignore_progress):
                values["inertia"] = abs(values["inertia"])
                values |= {p.name: min(max(values[p.name], p.lower), p.upper) for p in problem.free_joint}
                for by in _INERTIAS if cut else (1.0,):
                    start = values | {"inertia": by * values["inertia"]}
                    yield from _delayed(replace(case) if cut else case, problem, start)


def _list_flexible_starts(fit: Fit, best: Fit | None = None) -> Iterator[Fit]:
    """Yield starts near a fit's number and at others: with modes of its rigid joint, or the joint of the best fit."""
    case, values = fit.case, fit.problem.values(fit.x)
    known = case.free in case.numbers and values.get(case.free, 0.0) > _VANISHES * min(case.starts)
    near = [values[case.free] * by for by in _NEAR] if known else []
    case = case.at(case.free, (*near, *(case.starts if not near or len(case.starts) <= 10 else ())))
    values = values if best is None else best.problem.values(best.x)
    inertia = values["inertia"] if best is None else values["motor_inertia"] + values["load_inertia"]
    for posed in filter(None, (_pose(case, loop) for loop in case.loops)):
        motor = replace(posed.joint.parameters[0], lower=_LIGHTEST * inertia)
        problem = posed.replace_parameters({motor.name: motor})
        modes = frequencies_to_try(problem.axis.law, inertia, problem.sample_time)[::_APART]
        joints = (start_with_mode(problem, values, *one) for one in itertools.product(modes, _SHARES))
        for joint in joints if best is None else [values]:
            yield from _delayed(case, problem, joint)


def _delayed(case: Case, problem: ClosedLoopProblem, values: dict[str, float]) -> Iterator[Fit]:
    """Yield a start, at several delays if free."""
    undeclared = any(p.name == DELAY and p.free and not p.start for p in problem.parameters)
    started = {p.name: p.start or 0.0 for p in problem.parameters if p.name in (case.free, *case.beside)}
    for late in ({DELAY: late} for late in DELAYS) if undeclared else ({},):
        yield Fit(case, problem, problem.vector({**values, **started, **late}))


def _pose(case: Case, loop: ClosedLoop, *, low: bool = False) -> ClosedLoopProblem | None:
    """Problem of a case with its number free, or None."""
    around = [one for one in case.beside if one in OF_LOG or one in numbers_of(loop.controller)]
    filtering, log = case.filtering, case.torque.sample_time
    law: Any = loop.controller
    filters = (as_filter(getattr(law, "velocity_filter", (1.0,))), *getattr(law, "torque_filters", ()))
    if case.period < (slower := log / math.ceil(log / _FASTEST)):
        with contextlib.suppress(JointidError):  # its filters and its position loop do not allow every period
            replace(law, period=slower).law(log)
            each = ([one.coefficients(period) for period in (slower, case.period)] for one in filters)
            if law.interpolation != "hold" and not any(one == other != ((1.0,), (1.0,)) for one, other in each):
                loop = replace(loop, controller=replace(law, period=slower))
    if low and isinstance(loop.joint, FlexibleJoint):
        loop = replace(loop, joint=loop.joint.rigid)
        around = [one for one in around if one != NOTCH_DEPTH]  # a free notch imitates the load's antiresonance
        filtering = Filtering(cutoff=rigid_cutoff(case.record, least=_SWINGS)).resolve(log)
    try:
        problem = torque_problem(case.record, loop, filtering, loop.joint.parameters)
        problem = problem.keeping({"initial_velocity": 0.0}).freeing(*around, *filter(None, [case.free]))
    except JointidError:
        return None
    own = ((p, p.start or 0.0) for p in problem.parameters if p.name == case.free and p.symbol != "frequency")
    return problem.replace_parameters({p.name: replace(p, lower=1e-4 * start, upper=1e4 * start) for p, start in own})
