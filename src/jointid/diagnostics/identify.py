"""The verb `identify`: one record, several, or a log too long for memory in; an estimate and its checks out."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import Parameter
from jointid.common.text import join, number
from jointid.diagnostics.diagnose import diagnose_joint, diagnose_robot
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.faults.fault import FaultTest
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.faults.numbers import DELAY
from jointid.diagnostics.faults.record import find_lost_samples, find_too_short
from jointid.diagnostics.find_causes import explain_misfit, find_gross_cause, find_law_causes
from jointid.diagnostics.law_tests import has_unstated_delay
from jointid.diagnostics.model_free import Agreement, compare_law, judge_law
from jointid.diagnostics.search_state import INTERVAL
from jointid.diagnostics.undeclared import widen_for_undeclared
from jointid.diagnostics.unmodelled_motion import PredictedResidual, predict_residual
from jointid.estimation.identify import fit as fit_records
from jointid.estimation.identify import windows_of
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.problems.several_records import SeveralRecords
from jointid.estimation.result.answer import SLIGHT, Trust
from jointid.estimation.result.assemble import CheckResults, Widening, assemble
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.judge import judge
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.verdict import Reason, Status, Subject, Verdict, skip_test

_TOLD = 1.0  # deviations: what a suspected fault moves further is said
_OF_RECORD = (JointidError, np.linalg.LinAlgError)  # raised where the record does not allow a check


@one_thread()
def identify(
    record: Record | Sequence[Record] | Sequence[Sequence[Record]] | LongRecord,
    model: ClosedLoop | DriveSide | Joint | Sequence[ClosedLoop] | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: SeveralRecords | None = None,
    windows: Windowing | Literal[False] | None = None,
    checks: bool = True,
    shown: Sequence[DriveNumber] = (),
    unchecked: Callable[[Estimate], None] | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Identify a joint, or a robot, from what its drives logged.

    Args:
        record: a record; or several of one joint, each with the torque and what its controller reads, in one fit; or a
            `Log` that is read in chunks, identified in windows in bounded memory. Of a robot the records of its joints,
            on one clock; or those of several logs, in one fit, which is not checked.
        model: the loop (joint and controller), or the joint alone when the controller is not known; `DriveSide` to
            prescribe the motor's motion and simulate the load. For several records a loop, or one for each record: of
            one joint under different gains. A `Robot` alone, a `RobotLoop` with its controllers, or a `RobotDriveSide`
            along the motors' motion.
        method: `DIDIM`, `IDIM` or `DriveSideFit` with its settings; by default DIDIM when the controller is known, even
            where the record has a motor position, which is then not read; that of a `DriveSide`; otherwise IDIM.
            Several records and a log are identified by DIDIM. A robot likewise.
        filtering: see `Filtering`; its defaults follow the sample time.
        parameters: changes to the joint's parameters by name: fixed values, starts, bounds; for several records, of the
            joint without anything added. Of a robot values and bounds of friction, as "joint1.viscous".
        several: what the records share, and what was added to the load; see `SeveralRecords`.
        windows: of a log; see `Windowing`. With it records in memory are identified in windows, too: of a joint by
            DIDIM or IDIM, several, or a robot's. Records that may take too much memory at once are identified in
            windows without it, of which one is checked. False identifies all of them at once.
        checks: whether to check controller and log, what else may cause a misfit, and what the model lacks: of one
            record, by a DIDIM that ends at the least squares. The checks of a rigid joint take several times as
            long as its identification.
            Without them, the verdict on the loop says so. Those of a robot are made by `diagnose`.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
        unchecked: called with the estimate before its checks.
        progress: called with each step in a sentence.

    Raises:
        RecordError: the record lacks a channel the method needs; the sentence says which, and which method does not;
            or it shows nothing (a constant torque or reference), or cannot be in the units it is said to be in; or a
            chunk of a log cannot be read.
        MethodError: the method does not fit the model, the record does not determine the parameters, or it gives an
            inertia that is not positive; records are one only, or one twice, or the lists about them are not as long.

    A parameter that comes out outside its bounds is kept at the bound, and the others identified anew.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> round(ji.identify(record, loop).params["inertia"].value, 6)
        30.0

        Two records, the second with 10 kg on the load and a friction of its own:

        >>> heavier = ji.simulated_record(loop, reference, truth | {"inertia": 40.0, "coulomb": 18.0}, sample_time=1e-3)
        >>> shared = ji.SeveralRecords(added_inertia=(0.0, 10.0), own=((), ("coulomb",)))
        >>> both = ji.identify([record, heavier], loop, several=shared)
        >>> round(both.params["inertia"].value, 4), round(both.params["coulomb@2"].value, 4)
        (30.0, 18.0)

        A minute, in windows of six seconds:

        >>> reference = ji.excitation.trapezoids((0.1, 0.2), 2.0, 0.1, 1e-3, duration=60.0)
        >>> minute = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> estimate = ji.identify(minute, loop, windows=ji.Windowing(length=6.0))
        >>> round(estimate.params["inertia"].value, 3), estimate.data.windows.count
        (30.0, 10)
    """
    streamed = windows_of(record, model, method, several) if windows is None else None
    if windows is False and not isinstance(record, Record | Sequence):
        raise MethodError(
            "A log that is read in chunks is identified in windows; received windows=False: read the record whole, or "
            "leave windows out."
        )
    fit_one = partial(fit_records, filtering=filtering, parameters=parameters, progress=progress)
    said = ""
    if streamed is not None:
        said = f"the record is long, and is identified in windows of {streamed.length:.3g} s, of which one is checked"
        progress(said)
    fit = fit_one(record, model, method, several=several, windows=streamed or windows or None)
    checked = fit
    if streamed is not None:
        fit = fit.warn(said)
        checked = fit.window or fit
    of_joint = checked.record is not None and checked.problem is not None
    if not (fit.robot is not None or of_joint) or fit.data.records:
        return assemble(fit)
    if not checks:
        return assemble(fit, _left_out("not checked: the checks were left out"))
    if unchecked is not None:
        unchecked(assemble(fit, _left_out("not checked yet")))
    failures: list[Message] = []
    found = run_checks(checked, progress, shown)
    with _contained("an undeclared delay", failures):  # the first estimate stands
        if (freed := _free_unstated_delay(fit, method, found)) is not None:
            progress("the torque acts within a sample after its log: the delay is identified, too")
            wider = fit_one(record, model, freed)
            wider = wider.warn(*filter(None, (said, _DELAY_SAID)))
            fit, found = wider, run_checks(wider, progress, shown)
    found = _with_failures(found, failures)
    return assemble(fit, found)


def _free_unstated_delay(fit: Estimate, method: Method | None, found: CheckResults) -> Method | None:
    """Return the method with an unstated delay of the torque free, where it leaves a doubt; None elsewhere."""
    settings = DIDIM() if method is None else method
    if not isinstance(found.diagnosis, Diagnosis) or fit.problem is None or not isinstance(settings, DIDIM):
        return None
    (axis,) = found.diagnosis.axes
    doubted = assemble(fit, found).answer.trust.code is not Trust.RELIABLE
    if not (doubted and has_unstated_delay(axis.faults, axis.law, fit.problem)):
        return None
    return replace(settings, free=(*settings.free, DELAY.name), near=True)


_DELAY_SAID = (
    "the torque acts within a sample after its log, and no delay is declared: it is identified with the joint. Declare "
    'it, or set undeclared = "none" in [controller]'
)


def _left_out(why: str) -> CheckResults:
    return CheckResults((skip_test(Subject.LOOP, why),))


def run_checks(
    fit: Estimate,
    progress: Progress = ignore_progress,
    shown: Sequence[DriveNumber] = (),
) -> CheckResults:
    """Return the results of the checks of a fit; none without a simulated loop, or for several records.

    An exception in a check loses neither the estimate nor the other checks: the verdict on the loop states it.

    A parameter that is not identifiable leaves the loop unchecked. If a cause explains a misfit (`find_causes`), it is
    the verdict, because sensitivities mislead then. If the residual of a flexible joint follows its motion with the
    faults corrected, the verdict on repeatable errors says so (`unmodelled_motion`).

    Args:
        fit: the result of a method.
        progress: called with each step in a sentence.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
    """
    failures: list[Message] = []
    found = CheckResults()
    with _contained("controller and log", failures, ()):
        if fit.robot is not None:
            found = _check_robot(fit, fit.robot, progress, failures)
        else:
            found = _check_joint(fit, progress, shown, failures)
    return _with_failures(found, failures)


@contextlib.contextmanager
def _contained(check: str, failures: list[Message], known: tuple[type[Exception], ...] = _OF_RECORD) -> Iterator[None]:
    """Let no exception leave a check; one that does not say what the record lacks is added to the failures."""
    try:
        yield
    except known:
        pass
    except Exception as error:  # an estimate is worth more than any check of it
        said = f"the check of {check} failed, which is a fault of jointid ({type(error).__name__}: {error})"
        failures.append(Message(Reason.CHECK_FAILED, said))


def _with_failures(found: CheckResults, failures: Sequence[Message]) -> CheckResults:
    """Return results whose verdict on the loop states the failed checks; it is unknown unless it failed."""
    if not failures:
        return found
    loop = next((one for one in found.verdicts if one.subject is Subject.LOOP), None)
    failed = loop is not None and loop.status is Status.FAILED
    known = () if loop is None else loop.reasons
    reasons = (*known, *failures) if failed else (*failures, *known)
    verdict = Verdict(Subject.LOOP, Status.FAILED if failed else Status.UNKNOWN, reasons)
    others = tuple(one for one in found.verdicts if one.subject is not Subject.LOOP)
    return replace(found, verdicts=(*others, verdict))


def _check_joint(
    fit: Estimate,
    progress: Progress,
    shown: Sequence[DriveNumber],
    failures: list[Message],
) -> CheckResults:
    """Return the checks of a joint's fit; see `run_checks`."""
    record, problem, x = fit.record, fit.problem, fit.x
    if record is None or problem is None or x is None:
        return CheckResults()
    gross = None
    with _contained("gross causes", failures):
        gross = find_gross_cause(assemble(fit), record, progress, shown)
    if gross is not None and gross.is_clear:
        return CheckResults((Verdict(Subject.LOOP, Status.FAILED, (gross.message,)),))
    progress("checking loop and log")
    found = check = state = rest = None
    whole = all(p.value is not None for p in fit.params.rows)
    verdict = skip_test(Subject.LOOP, "not checked")
    with _contained("faults of loop and log", failures):
        try:
            if not whole:
                verdict = check_without_joint(record, problem.loop_at(x))
            else:
                found, state = diagnose_joint(fit, record, (problem, x), shown=shown)
                check = found.axes[0].faults
                verdict = Verdict(Subject.LOOP, check.status, check.reasons)
        except _OF_RECORD as error:
            verdict = skip_test(Subject.LOOP, f"not checked: {error}")
    if state is not None and isinstance(state.problem.joint, FlexibleJoint):
        with _contained("a residual that follows the motion", failures):
            rest = predict_residual(state.problem, state.x)
    findings = () if check is None else check.findings
    faults = None if check is None else tuple(finding.test for finding in findings)
    left = next((finding.left for finding in findings if finding.left is not None), None)
    causes = None
    with _contained("causes of a misfit", failures):
        causes = explain_misfit(assemble(fit), record, faults, progress, shown, left, gross)
    if causes is not None:
        return CheckResults((Verdict(Subject.LOOP, Status.FAILED, (causes.message,)),), diagnosis=found)
    with _contained("the law along the motor position", failures):
        verdict = _judge_by_position(record, problem.loop, shown, verdict, faults or ())
    short = find_too_short(record) if whole else None  # what is refused is not relied on
    if short is not None:
        verdict = Verdict(Subject.LOOP, Status.FAILED, (short,))
    widenings = [] if check is None else widen_for_faults(check, problem.values(x))
    if found is not None:
        with _contained("undeclared elements", failures):
            widenings += _widen_for_undeclared(fit, found)
    if rest is None or not rest.follows or state is None:
        return CheckResults((verdict,), tuple(widenings), found)
    with _contained("a residual that follows the motion", failures):  # the verdict stands, however wide it is
        widenings.append(widen_for_rest(state.problem, state.x, rest))
    follows = rest.verdict
    before = next((one for one in judge(fit) if one.subject is follows.subject), None)
    kept = before.reasons if before is not None and before.status is Status.FAILED else ()
    follows = replace(follows, reasons=(*follows.reasons, *kept))
    return CheckResults((follows, verdict), tuple(widenings), found)


def _judge_by_position(
    record: Record, loop: ClosedLoop, shown: Sequence[DriveNumber], verdict: Verdict, named: Sequence[FaultTest]
) -> Verdict:
    """Return the verdict on a loop with the number of its law that the motor position shows to be another one.

    Faults of loop and log that were found stand. Friction, play and spring of the joint have no part in it.
    """
    of_loop = any(not fault.of_model for one in named for fault in (one.fault, *one.alike))
    found = None if of_loop else find_law_causes(record, loop, shown)
    if found is None:
        return verdict
    others = verdict.reasons if verdict.status is Status.FAILED else ()
    return Verdict(Subject.LOOP, Status.FAILED, (found.message, *others))


def check_without_joint(record: Record, loop: ClosedLoop) -> Verdict:
    """Return the verdict on a loop whose joint is not fully identified: that of the motor position, where logged."""
    law = compare_law(record, loop)
    if law is None:
        return skip_test(Subject.LOOP, "not checked, because the joint is not fully identified; identify it as rigid")
    judged = judge_law(law, record)
    return Verdict(Subject.LOOP, Status.PASSED if judged.code is Agreement.HOLDS else Status.FAILED, (judged,))


def _check_robot(fit: Estimate, part: IdentifiedRobot, progress: Progress, failures: list[Message]) -> CheckResults:
    """Return the checks of a robot's fit: the controllers that it simulated, and the residual of each joint."""
    if len(fit.records) > len(part.model):
        return CheckResults((skip_test(Subject.LOOP, "not checked: several records were identified in one fit"),))
    progress("checking controllers and torques")
    try:
        found = diagnose_robot(fit, fit.records)
    except _OF_RECORD as error:  # no check ends an identification
        return CheckResults((skip_test(Subject.LOOP, f"not checked: {error}"),))
    residual = Verdict(
        Subject.REPEATABLE,
        Status.PASSED,
        (Message(Reason.NOTHING_REPEATS, "what the model leaves is noise, or little"),),
    )
    bad = [joint.name for joint in found.axes if not joint.explained]
    if bad or found.cause:
        causes = [Message(Reason.CAUSE_FOUND, str(found.cause))] if found.cause else []
        rest = [f"what the model leaves of the torque of {join(bad)} is no noise"] if bad else []
        follows = [Message(Reason.RESIDUAL_FOLLOWS_MOTION, one) for one in rest]
        of_model = found.name_faults(of_model=True)
        residual = Verdict(Subject.REPEATABLE, Status.FAILED, (*causes, *follows, *of_model))
    none = "no motor position and reference of a declared controller were logged"
    if any(record.computed for record in fit.records):
        none = "the torque is that of the declared controllers"
    loop = skip_test(Subject.LOOP, found.untested_clause or none, found.untested)
    if all(joint.law_holds for joint in found.axes):
        said = found.describe_laws(holds=True)
        loop = Verdict(Subject.LOOP, Status.PASSED, (Message(Reason.LOOP_AS_DECLARED, said),))
    elif wrong := found.describe_laws(holds=False):
        said = "; ".join(filter(None, (wrong, found.untested_clause)))
        shown: list[Message] = []
        with _contained("the laws along the motor positions", failures):
            shown = _numbers_by_position(part, fit.records, found)
        loop = Verdict(Subject.LOOP, Status.FAILED, (Message(Reason.LOOP_NOT_AS_DECLARED, said), *shown))
    if of_logs := found.name_faults(of_model=False):
        loop = Verdict(Subject.LOOP, Status.FAILED, (*of_logs, *(loop.reasons if loop.status is Status.FAILED else ())))
    elif possible := found.undecided:
        loop = Verdict(
            Subject.LOOP, loop.status if loop.status is Status.FAILED else Status.UNKNOWN, (*possible, *loop.reasons)
        )
    lost = next(filter(None, map(find_lost_samples, fit.records)), None)
    if lost is not None:
        loop = Verdict(Subject.LOOP, Status.FAILED, (lost,))
    tested = part.has_controllers or of_logs or lost is not None
    wider: list[Widening] = []
    with _contained("undeclared elements", failures):
        wider = _widen_for_undeclared(fit, found)
    return CheckResults((residual, loop) if tested else (residual,), tuple(wider), diagnosis=found)


def _numbers_by_position(part: IdentifiedRobot, records: Sequence[Record], found: Diagnosis) -> list[Message]:
    """Return the numbers of refuted laws that the motor positions show to differ."""
    told = []
    for link, axis, record, law in zip(
        part.model.links, found.axes, records, getattr(part.setup, "controllers", ()), strict=False
    ):
        causes = None
        if axis.law_holds is False:
            with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # the verdict stands
                causes = find_law_causes(record, ClosedLoop(RigidJoint(link.kind), law))
        if causes is not None:
            said = causes.message
            told.append(replace(said, words=f"{axis.name}: {said}", clause=f"{axis.name}: {said.brief}"))
    return told


def _widen_for_undeclared(fit: Estimate, found: Diagnosis) -> list[Widening]:
    """Return the shifts by elements neither declared nor found as faults."""
    named = [
        {fault.name for finding in axis.faults.findings for fault in (finding.test.fault, *finding.test.alike)}
        for axis in found.axes
    ]
    return widen_for_undeclared(fit, found.torques, named)


def widen_for_faults(check: AxisFaults, values: Mapping[str, float]) -> list[Widening]:
    """Return the shifts of parameters by the faults that a check found or suspects; none without any.

    Faults of loop and log that move a parameter by more than a thousandth widen no interval: they are corrected, or
    not. Where they are excluded, the joint has what looks like them.

    Args:
        check: of loop and log.
        values: of the parameters, by name.
    """
    found = [one for one in check.findings if one.test.fault.mechanical]
    moved: dict[str, float] = {}
    for finding in found:
        for name, change in finding.changes.items():
            moved[name] = math.hypot(moved.get(name, 0.0), change.by)
    moved |= {name: 0.5 * by for name, by in check.lacking.items()}  # two deviations hold it
    wider = [Widening(moved)] if moved else []
    slight: dict[str, float] = {}
    for finding in filter(None, (*check.findings, check.undecided)):
        for name, change in finding.changes.items():
            out = not finding.test.fault.mechanical and abs(change.sigmas) > INTERVAL
            if out and abs(change.by) < SLIGHT * abs(values.get(name, 0.0)):
                slight[name] = math.hypot(slight.get(name, 0.0), 0.5 * change.by)
    if slight:
        wider.append(Widening(slight))
    if (suspect := check.suspected) is not None:
        title, shifts = suspect.test.title, {name: abs(one.by) for name, one in suspect.changes.items()}
        off = [
            f"{check.symbols[name]} by {number(shifts[name], 2)} {check.units[name]}".rstrip()
            for name, one in suspect.changes.items()
            if abs(one.sigmas) > _TOLD
        ]
        said = f"the record does not exclude this: {title} (p = {number(suspect.test.p_value, 2)}). It may move "
        wider.append(Widening(shifts, f"{said}{join(off)}, which the intervals hold" if off else ""))
    return wider


def widen_for_rest(problem: ClosedLoopProblem, x: FloatArray, rest: PredictedResidual) -> Widening:
    """Return the largest shift of each parameter by a residual that follows the motion.

    A part of the torque of that norm, with the shape that shifts a parameter most, shifts it by its norm times the
    deviation of the parameter under unit noise (the inequality of Cauchy and Schwarz). The part that the parameters
    have absorbed is assumed as large as the residual one.
    """
    # The largest shift is two deviations.
    moved = worst_shift(problem, x, 0.5 * rest.share * problem.size)
    return Widening(moved)


def worst_shift(problem: ClosedLoopProblem, x: FloatArray, size: float) -> dict[str, float]:
    """Return the largest shift of each free parameter, by name, by a part of the filtered torque of a given norm."""
    slopes = problem.linearise(x)[1]
    sizes = column_norms(slopes)  # of parameters in units of their own
    # Rows of the pseudo-inverse: their norms are the deviations under unit noise, and never the root of a rounding.
    spread = np.linalg.norm(np.linalg.pinv(slopes / sizes, rcond=1e-8), axis=1) / sizes
    return {p.name: size * float(by) for p, by in zip(problem.free, spread, strict=True)}
