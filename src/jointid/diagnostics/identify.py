"""`identify`: estimate and checks from one record, several, or a long log.

What the record does not exclude widens the intervals: faults, and undeclared elements (a filter of velocity or torque,
a delay, a loss of the gear). One of size s changes the torque by ``s c``, and the estimate by ``s (J' J)^-1 J' c``, J
the columns of its parameters. The score test of c beside J gives s with its deviation. Without a record the element is
as likely as none, and s is normal with half of the usual size as its root mean square, none included.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.parallel import in_threads, one_thread
from jointid.common.parameters import Parameter
from jointid.common.text import in_words, join, number
from jointid.diagnostics.analysis import rebuild_problem
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.diagnosis import AxisDiagnosis, Diagnosis, diagnose_joint, diagnose_robot
from jointid.diagnostics.explain import FAILS, Causes, begin_records, explain_misfit
from jointid.diagnostics.model_free import Agreement, find_broken_part, find_lost_samples, find_too_short
from jointid.diagnostics.score import score
from jointid.diagnostics.search import TOLERANCE, find_part_of_loop
from jointid.diagnostics.suspects import DELAY, FAULTS, TORQUE_FILTER, VELOCITY_FILTER, Fault, FaultSignature, Finding
from jointid.estimation.descent import descend
from jointid.estimation.force_in_loop import MATTERS, TOLD
from jointid.estimation.identify import fit as fit_records
from jointid.estimation.identify import windows_of
from jointid.estimation.methods import Method
from jointid.estimation.problems.inverse_model import decimate_each
from jointid.estimation.problems.simulated import ClosedLoopProblem, LoopLog, loop_log
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.estimation.result.verdict import SLIGHT, Check, Checked, Reason, Subject, Widening, assemble, checks_of
from jointid.estimation.robots.simulated import IdentifiedRobot, solve_again
from jointid.models.controllers import FirstOrder
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.chunks import InMemory, Log
from jointid.records.record import Record, takes_record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.derivatives import respond_to_laws
from jointid.simulation.simulate import Run
from jointid.uncertainty.covariance import INTERVAL, Influence
from jointid.uncertainty.position_dependent_error import cells

_fail = partial(checks_of, Subject.LOOP, False)
_PERIODS = 100_000  # of controller or log, of all joints, of which most checks take less than 20 s of processor
_PART = "checks read the first {:.3g} s of the record: jointid diagnose reads all"
LATER = {"later": True}  # values of a check that was left out on request, and is made up for by `check_later`


@one_thread
@takes_record
def identify(
    record: Record | Sequence[Record] | Sequence[Sequence[Record]] | Log | InMemory,
    model: ClosedLoop | Joint | Sequence[ClosedLoop] | Robot | RobotLoop,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: Mapping[str, Any] | None = None,
    windows: float | Literal[False] | None = None,
    checks: bool | Literal["whole"] = True,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Identify a joint, or a robot, from what its drives logged.

    Args:
        record: a record; or several of one joint, each with the torque and what its controller reads, in one fit; or
            the log of a joint file, `load(path).log()`, that is read in chunks, identified in windows in bounded
            memory. Of a robot the records, or logs, of its joints, on one clock; or the records of several logs, in one
            fit, which is not checked.
        model: the loop (joint and controller), or the joint alone when the controller is not known. For several records
            a loop, or one for each record: of one joint under different gains. A `robots.Robot` alone, or
            a `robots.RobotLoop` with its controllers.
        method: `DIDIM`, `IDIM` or `DriveSideFit` with its settings; by default DIDIM when the controller is known, even
            where the record has a motor position, which is then not read; otherwise IDIM. A log is identified by DIDIM,
            several records also by IDIM where they share all parameters. A robot likewise.
        filtering: see `Filtering`; its defaults follow the sample time.
        parameters: changes to the joint's parameters by name: fixed values, starts, bounds; for several records, of the
            joint without anything added. Of a robot values and bounds of friction, as "joint1.viscous".
        several: how several records of one joint belong together. "added_inertia": for each record the known inertia
            added to the load, kg or kg m2. "own": for each record names of parameters of its own, as of friction that a
            load changes. "free": names of identified numbers around the joint: "drive_gain", which needs an
            added inertia, "position_gain", "log_delay", ...
        windows: seconds of the windows of a log. With it records in memory are identified in windows, too, of a joint
            or robot by DIDIM. Those that may take too much memory at once are identified in windows without it, of
            which one is checked. False identifies them at once.
        checks: whether to check controller, log and model: of one record, by a DIDIM that ends at the least squares.
            Without them, the verdict on the loop says so. They simulate 100,000 periods of controllers or logs from the
            first motion on, mostly for less than 20 s of processor; "whole" ones simulate all.
        progress: called with each step in a sentence.

    Raises:
        RecordError: the record lacks a channel the method needs, or shows nothing (a constant torque or reference), or
            cannot be in the units it is said to be in; or a chunk of a log cannot be read.
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
        >>> round(ji.identify(record, loop)["inertia"].value, 6)
        30.0
    """
    streamed = windows_of(record, model, method, several) if windows is None else None
    asked = streamed if windows is None or windows is False else windows
    fit = fit_records(
        record, model, method, filtering=filtering, parameters=parameters, several=several, windows=asked,
        progress=progress,
    )  # fmt: skip
    checked = fit
    if streamed is not None:
        said = f"the record is long, and is identified in windows of {streamed:.3g} s, of which one is checked"
        progress(said)
        fit, checked = fit.warn(said), fit.window or fit
    if not checked.records or (fit.robot is None and checked.problem is None):
        broken = find_broken_part(checked.records[0]) if len(checked.records) == 1 else None
        return assemble(fit if broken is None else fit.warn(broken.words))
    if not checks:
        return replace(assemble(fit, _untested("not checked", LATER)), x=checked.x)
    return assemble(fit, *run_checks(checked, progress, whole=checks == "whole"))


@one_thread
def check_later(estimate: Estimate, record: Any, progress: Progress = ignore_progress) -> Estimate:
    """Check an estimate of one record afterwards, without a search."""
    part, settings, x = estimate.robot, estimate.settings, estimate.x
    estimate = replace(estimate, checks=tuple(one for one in estimate.checks if one.values != LATER))
    if part is not None:
        solved = solve_again(part, record, settings.filtering) if settings.simulates else None
        fit = replace(estimate, records=tuple(record), solved=solved)
    else:
        found = {} if x is None else dict(zip(estimate.free, x.tolist(), strict=True))
        rows = tuple(replace(row, value=found.get(row.name, row.value)) for row in estimate.rows)  # refused ones, too
        problem, x = rebuild_problem(replace(estimate, rows=rows), record)
        fit = replace(estimate, problem=problem, x=x, records=(record,))
    return assemble(fit, *run_checks(fit, progress))


def _untested(why: str, values: Mapping[str, object] | None = None) -> tuple[Check, ...]:
    return checks_of(Subject.LOOP, None, Message(Reason.NOT_TESTED, why, values or {}))


def run_checks(fit: Estimate, progress: Progress = ignore_progress, *, whole: bool = False) -> Checked:
    """Results of a fit's checks; none without simulated loop or single record.

    Checks that the record does not allow are left out. The verdict on the loop states an exception, or the cause of a
    misfit, for which sensitivities are misleading.
    """
    try:
        if fit.robot is not None:
            return _check_robot(fit, fit.robot, progress, whole)
        if fit.records and fit.problem is not None and fit.x is not None:
            return _check_joint(fit, fit.problem, fit.x, progress, whole)
    except Exception as error:  # an estimate is worth more than any check of it
        said = f"a check failed, which is a fault of jointid ({type(error).__name__}: {error})"
        return checks_of(Subject.LOOP, None, Message(Reason.CHECK_FAILED, said)), (), None
    return (), (), None


def begin_checked(records: Sequence[Record], controllers: Sequence[Any]) -> Sequence[Record]:
    """The part of a log that its checks read: of a long one its beginning."""
    step = min(channel.sample_time for record in records for _, channel in record.items())
    period = min([getattr(one, "period", None) or step for one in controllers], default=step)
    return begin_records(records, _PERIODS / len(records) * min(period, step))


def _check_joint(fit: Estimate, problem: ClosedLoopProblem, x: FloatArray, progress: Progress, all_of: bool) -> Checked:
    """Return the checks of a joint's fit; see `run_checks`."""
    record, found, searched, said = fit.records[0], None, list[Causes | None](), list[Widening]()
    broken = find_broken_part(record)
    if not all_of and (part := begin_checked([record], [problem.loop.controller])[0]) is not record:
        broken = broken or find_part_of_loop(problem, x, record)
        problem = replace(problem, logs=(loop_log(problem.loop, [part], problem.joint.model, problem.filtering),))
        x, record = descend(problem, x, TOLERANCE).x, part
        fit = replace(fit, problem=problem, x=x)
        said = [({}, _PART.format(part.duration))]
    if broken is not None:
        return _fail(broken), said, None
    progress("checking loop and log")

    def explain(findings: Sequence[Finding] | None) -> bool:
        if not searched and find_part_of_loop(problem, x, record) is None:  # what acts all the time explains no part
            with contextlib.suppress(*FAILS):
                searched.extend(explain_misfit(assemble(fit), record, findings, progress))
        return any(searched)

    whole = all(p.value is not None for p in fit.rows)
    try:
        if whole or not explain(None):
            found = diagnose_joint(fit, record, problem, x, **({"explain": explain} if whole else {"most": 1}))
            loop = checks_of(Subject.LOOP, found.axes[0].faults.as_declared, *found.axes[0].faults.reasons)
    except FAILS as error:
        loop = _untested(f"not checked: {error}")
    faults = None if found is None or not whole else found.axes[0].faults
    apart = find_part_of_loop(problem, x, record) if faults is None else faults.part
    if apart is not None:
        return _fail(apart), said, found if whole else None
    named = None if faults is None or (faults.explained is not None and not faults.findings) else faults.findings
    if explain(named):
        return _fail(*(one.message for one in searched if one is not None)), said, found if whole else None
    law = None if found is None else found.axes[0].law
    if found is not None and not whole:  # what the joint lacks may be the spring that is not identified
        seen = found.axes[0].faults
        lacking = any(one.test.fault.reason is not Reason.LOOP_NOT_AS_DECLARED for one in seen.findings)
        if lacking or seen.explained is not None or seen.part is not None:
            why = "not checked, because the joint is not fully identified; identify it as rigid"
            found, loop = None, _untested(why) if law is None else checks_of(Subject.LOOP, law.holds, law.agreement)
    # Friction, play and spring of the joint have no part in what the motor position shows of the law.
    of_joint = all(fault.of_model for one in named or () for fault in (one.test.fault, *one.test.alike))
    if of_joint and law is not None and law.agreement.code in (Agreement.DIFFERS, Agreement.SCALED):
        loop = _fail(law.agreement, *(one for one in loop if one.passed is False))
    if record.injected is not None and record.reference is not None:  # it moves the joint, too
        path = replace(record.reference, values=problem.simulate(x).motor_position, sample_time=problem.sample_time)
        record = replace(record, reference=path, injected=None)
    if whole and (short := find_too_short(record)) is not None:  # what is refused is not relied on
        loop = _fail(short)
    if found is not None:
        said[:0] = widen_for_faults(found.axes[0], {row.name: row for row in fit.rows})
        with contextlib.suppress(*FAILS):
            said[:0] = widen_for_undeclared(fit, found)
    return loop, said, found


def _check_robot(fit: Estimate, part: IdentifiedRobot, progress: Progress, all_of: bool) -> Checked:
    """Check a robot's fit: simulated controllers, and the residual of each joint."""
    if len(fit.records) != len(part.model):
        return _untested("not checked: several records were identified in one fit"), (), None
    progress("checking controllers and torques")
    controllers, tested = getattr(part.setup, "controllers", ()), fit
    try:
        if (begun := fit.records if all_of else begin_checked(fit.records, controllers)) is not fit.records:
            tested = replace(fit, solved=fit.solved and solve_again(part, begun, fit.settings.filtering))
        found = diagnose_robot(tested, begun)
    except (*FAILS, ValueError) as error:  # as of an axis that rests at first
        return (_untested(f"not checked: {error}"), (), None) if all_of else _check_robot(fit, part, progress, True)
    rest = [] if found.cause is None else [Message(Reason.CAUSE_FOUND, found.cause.words)]
    if bad := [joint.name for joint in found.axes if not joint.explained]:
        left = f"what the model leaves of the torque of {join(bad)} is no noise"
        rest.append(Message(Reason.RESIDUAL_FOLLOWS_MOTION, left, {"axes": bad}))
    rest += found.name_faults(of_model=True) if rest else ()
    checks = checks_of(Subject.REPEATABLE, not rest, *(rest or [Message(Reason.PASSED, "what is left is noise")]))
    failed = [*filter(None, map(find_lost_samples, fit.records))][:1] or found.name_faults(of_model=False)
    unseen = [joint.name for joint in found.axes if joint.law_holds is None]
    if failed:
        checks += _fail(*failed)
    elif controllers and unseen:
        why = f"the controller of {join(unseen)} was not checked, which needs a logged torque, position and reference"
        checks += _untested(why, {"axes": unseen} if len(unseen) < len(found.axes) else None)
    elif controllers:
        good = "the declared controllers make the logged torques of the positions"
        checks += checks_of(Subject.LOOP, True, Message(Reason.LOOP_AS_DECLARED, good))
    said: list[Widening] = [({}, _PART.format(begun[0].duration))] * (tested is not fit)
    with contextlib.suppress(*FAILS):
        said[:0] = widen_for_undeclared(tested, found)
    return checks, said, found


# What widens the intervals

_USUAL = 1e-3  # s: time constant of a filter, at most; or two periods of the controller
_LOSS, _MOST_LOST = FAULTS["load_dependent_friction"], 0.15  # of the torque through a gear


class Element(NamedTuple):
    """Undeclared element: half its usual size, and controller with it (not a loss)."""

    fault: Fault
    half: float
    controller: Any = None
    axis: int = 0


def list_undeclared(controller: Any, sample_time: float, axis: int = 0) -> Iterator[Element]:
    """Yield usual elements that a controller does not declare; `sample_time` in s."""
    if getattr(controller, "undeclared", "none") == "none":
        return
    period = controller.period or sample_time
    half = max(0.5 * _USUAL, period)
    if controller.velocity_filter == (1.0,):
        yield Element(VELOCITY_FILTER, half, replace(controller, velocity_filter=FirstOrder(half)), axis)
    if not controller.torque_filters:
        yield Element(TORQUE_FILTER, half, replace(controller, torque_filters=(FirstOrder(half),)), axis)
    if not controller.delay:
        yield Element(DELAY, 0.5 * period, replace(controller, delay=0.5 * period), axis)


def widen_for_undeclared(fit: Estimate, found: Diagnosis) -> Iterator[Widening]:
    """Yield parameter shifts by undeclared elements that are not excluded or named."""
    torques, part = found.torques, fit.robot
    assert torques is not None  # of a diagnosis with axes
    scales: FloatArray | float = 1.0
    if fit.problem is not None and fit.x is not None:
        names, log, (run,) = [p.name for p in fit.problem.free], fit.problem.log, fit.problem.run(fit.x)
    elif part is not None and hasattr(part.setup, "controllers") and fit.solved is not None:
        names, log, (run,) = [*part.parameters.names], fit.solved.problem.log, fit.solved.runs
        scales = np.where(part.parameters.logarithmic, part.values[: len(part.parameters.places)], 1.0)
    else:
        return
    tried, known = list[Element](), set[str]()
    for k, (driven, axis) in enumerate(zip(run.experiment.axes, found.axes, strict=False)):
        each = (*axis.faults.findings, *axis.faults.suspected)  # which widen by themselves
        known = {*names, *(one.name for f in each for one in (f.test.fault, *f.test.alike))}
        elements = list_undeclared(driven.controller, fit.data.sample_time, k)
        tried += [one for one in elements if one.fault.name not in known]
    rows = {row.name: row for row in fit.rows if row.stderr}
    solve = Influence(torques.stack(torques.own), torques.stack(torques.error)).matrix
    changes = [*zip(tried, _respond(log, run, tried) if tried else (), strict=True)]
    if fit.problem is not None and fit.x is not None and _LOSS.name not in known:
        with contextlib.suppress(*FAILS):  # the other elements are held without it, too
            changes += _lose(fit.problem, fit.x)
    sizes = in_threads(lambda one: _size_of(torques, *one), changes)
    for (element, change), size in zip(changes, sizes, strict=True):
        by = scales * (solve @ torques.stack(change)) * size / element.half
        moved = {name: float(one) for name, one in zip(names, by, strict=True) if name in rows}
        if any(abs(one) > MATTERS * (rows[name].stderr or 0.0) for name, one in moved.items()):
            most = f"{number(200 * size, 2)} %" if element.fault is _LOSS else f"{number(2e3 * size, 2)} ms"
            what = f"an undeclared {element.fault.title} of up to {most}"
            yield _widening(what, moved, rows, '. Declare it, or set undeclared = "none" in [controller]')


def _lose(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[tuple[Element, FloatArray]]:
    """Yield an undeclared loss of a flexible joint's gear, and the response to half of it, (1, rows)."""
    joint: Any = problem.joint
    denied = getattr(problem.loop.controller, "undeclared", "none") == "none"
    if denied or joint.model != "flexible" or joint.friction != Friction():
        return
    other = problem.with_joint(replace(joint, friction=Friction("load-dependent")))
    slopes = dict(zip((p.name for p in other.free), other.linearise(other.vector(problem.values(x)))[1].T, strict=True))
    yield Element(_LOSS, 0.5 * _MOST_LOST), -0.5 * _MOST_LOST * slopes["load_friction_per_torque"][np.newaxis]


def _respond(log: LoopLog, run: Run, tried: Sequence[Element]) -> list[FloatArray]:
    """First-order changes of filtered torques along a run, by element, (n, rows)."""
    each = run.experiment.axes
    others = [(one.axis, replace(each[one.axis], law=each[one.axis].law_of(one.controller))) for one in tried]
    found, direct = respond_to_laws(run, others)
    for c, (one, own) in enumerate(zip(tried, direct, strict=True)):
        if not any(log.seen) or log.seen[one.axis] is None:  # else the declared law shows the position
            found[one.axis][:, c] += own
    return list(np.moveaxis(decimate_each(log, found).reshape(len(each), -1, len(others)), 2, 0))


def _size_of(torques: AxisTorques, element: Element, change: FloatArray) -> float:
    """Expected size of an element by its test alone."""
    axis, own = element.axis, torques.own[element.axis]
    signature = FaultSignature(replace(element.fault, one_sided=True), change[axis] / element.half)
    (test,) = score(
        torques.error[axis], own[:, np.any(own, axis=0)], [signature], {signature.fault: 0.0},
        cells(torques.position[axis], torques.velocity[axis]), widened=1.0,
    )  # fmt: skip
    return expect_size(test.size, test.std, element.half)


def expect_size(size: float, std: float, half: float) -> float:
    """Root mean square of an element's size given its test; `half` without one."""
    size, error, usual = max(size, 0.0), std**2 or np.finfo(float).tiny, 2.0 * half**2
    kept = usual / (usual + error)
    none = math.exp(-0.5 * kept * size**2 / error) * math.sqrt(1.0 + usual / error)  # how likely, beside an element
    return min(math.sqrt(((kept * size) ** 2 + kept * error) / (1.0 + none)), 2.0 * half)


def widen_for_faults(axis: AxisDiagnosis, rows: Mapping[str, EstimatedParameter]) -> Iterator[Widening]:
    """Yield parameter shifts by faults that a diagnosis found or suspects.

    A number of loop or log that moves a parameter so much that it is not relied on widens no interval: it is corrected.
    Another law widens it, and so does a number beside a residual that repeats.
    """
    for finding in axis.faults.findings:
        every = finding.test.fault.mechanical or finding.law is not None or axis.repeats
        moved = {
            name: change.by
            for name, change in finding.changes.items()
            if every or abs(change.sigmas) <= INTERVAL or abs(change.by) < SLIGHT * abs(rows[name].value or 0.0)
        }
        yield moved, ""
    for suspect in axis.faults.suspected:
        what = f"what looks like a {suspect.test.fault.title} (p = {number(suspect.test.p_value, 2)})"
        if suspect.law is not None:
            what = f"that {suspect.law.words}, which this record does not exclude,"
        yield _widening(what, {name: one.by for name, one in suspect.changes.items()}, rows, "")


def _widening(what: str, by: Mapping[str, float], rows: Mapping[str, EstimatedParameter], remedy: str) -> Widening:
    """Parameter shifts as one deviation each, and a sentence on large ones."""
    off = [
        f"{in_words(name)} by {number(2 * abs(by[name]), 2)} {row.unit}".rstrip()
        for name, row in rows.items()
        if row.stderr and abs(by.get(name, 0.0)) > TOLD * row.stderr
    ]
    return dict(by), f"{what} may move {join(off)}, which the intervals hold{remedy}" if off else ""
