"""The checks of a fit: controller and log, causes of a misfit, unmodelled motion, and wider intervals."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.text import join
from jointid.diagnostics.diagnose import diagnose_joint, diagnose_robot
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.faults.record import find_too_short
from jointid.diagnostics.find_causes import explain_misfit
from jointid.diagnostics.unmodelled_motion import PredictedResidual, predict_residual
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.assemble import CheckResults, FitResult, Widening, assemble
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import FlexibleJoint
from jointid.uncertainty.verdict import Reason, Status, Subject, Verdict, skip_test


def run_checks(fit: FitResult, progress: Progress = ignore_progress, shown: Sequence[DriveNumber] = ()) -> CheckResults:
    """Return the results of the checks of a fit; none without a simulated loop, or for several records.

    A parameter that is not identifiable leaves the loop unchecked. If a cause explains a misfit (`find_causes`), it is
    the verdict, because sensitivities mislead then. If the residual of a flexible joint follows its motion with the
    faults corrected, the verdict on repeatable errors says so (`unmodelled_motion`).

    Args:
        fit: the result of a method.
        progress: called with each step in a sentence.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
    """
    if fit.robot is not None:
        return _check_robot(fit, fit.robot, progress)
    record, problem, x = fit.record, fit.problem, fit.x
    if record is None or problem is None or x is None:
        return CheckResults()
    progress("checking loop and log")
    found = check = state = rest = None
    verdict = skip_test(Subject.LOOP, "not checked, because the joint is not fully identified; identify it as rigid")
    whole = all(p.value is not None for p in fit.params.rows)
    if whole:
        try:
            # DIDIM is told of torque and reference alone: its checks do not read the motor's position either.
            found, state = diagnose_joint(fit, record.without("motor_position"), (problem, x), shown=shown)
            check = found.axes[0].faults
            verdict = Verdict(Subject.LOOP, check.status, check.reasons)
            if isinstance(state.problem.joint, FlexibleJoint):
                with contextlib.suppress(np.linalg.LinAlgError):  # the tests stand
                    rest = predict_residual(state.problem, state.x)
        except (JointidError, np.linalg.LinAlgError) as error:  # no check ends an identification
            verdict = skip_test(Subject.LOOP, f"not checked: {error}")
    findings = () if check is None else check.findings
    faults = None if check is None else tuple(finding.test for finding in findings)
    left = next((finding.left for finding in findings if finding.left is not None), None)
    try:
        causes = explain_misfit(assemble(fit), record, faults, progress, shown, left)
    except (JointidError, np.linalg.LinAlgError):  # nor does the search for a cause
        causes = None
    if causes is not None:
        return CheckResults((Verdict(Subject.LOOP, Status.FAILED, (causes.message,)),), diagnosis=found)
    short = find_too_short(record) if whole else None  # what is refused is not relied on
    if short is not None:
        verdict = Verdict(Subject.LOOP, Status.FAILED, (short,))
    widenings = [] if check is None else widen_for_faults(check)
    if rest is None or not rest.follows or state is None:
        return CheckResults((verdict,), tuple(widenings), found)
    with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # the verdict stands, however wide it is
        widenings.append(widen_for_rest(state.problem, state.x, rest))
    follows = rest.verdict
    before = next((one for one in fit.checks.verdicts if one.subject is follows.subject), None)
    kept = before.reasons if before is not None and before.status is Status.FAILED else ()
    follows = replace(follows, reasons=(*follows.reasons, *kept))
    return CheckResults((follows, verdict), tuple(widenings), found)


def _check_robot(fit: FitResult, part: IdentifiedRobot, progress: Progress) -> CheckResults:
    """Return the checks of a robot's fit: the controllers that it simulated, and the residual of each joint."""
    if len(fit.records) > len(part.model):
        return CheckResults((skip_test(Subject.LOOP, "not checked: several records were identified in one fit"),))
    progress("checking controllers and torques")
    try:
        found = diagnose_robot(fit, fit.records)
    except (JointidError, np.linalg.LinAlgError) as error:  # no check ends an identification
        return CheckResults((skip_test(Subject.LOOP, f"not checked: {error}"),))
    residual = Verdict(
        Subject.REPEATABLE,
        Status.PASSED,
        (Message(Reason.NOTHING_REPEATS, "what the model leaves is noise, or little"),),
    )
    if bad := [joint.name for joint in found.axes if not joint.explained]:
        said = f"what the model leaves of the torque of {join(bad)} is no noise"
        residual = Verdict(Subject.REPEATABLE, Status.FAILED, (Message(Reason.RESIDUAL_FOLLOWS_MOTION, said),))
    none = "no motor position and reference of a declared controller were logged"
    loop = skip_test(Subject.LOOP, found.untested_clause or none, found.untested)
    if found.as_declared:
        said = "the declared controllers make the logged torques of the logged positions"
        loop = Verdict(Subject.LOOP, Status.PASSED, (Message(Reason.LOOP_AS_DECLARED, said),))
    elif found.as_declared is False:
        wrong = join([joint.name for joint in found.axes if joint.law_holds is False])
        said = f"the declared controller of {wrong} does not make the logged torque of the logged positions"
        said = "; ".join(filter(None, (said, found.untested_clause)))
        loop = Verdict(Subject.LOOP, Status.FAILED, (Message(Reason.LOOP_NOT_AS_DECLARED, said),))
    return CheckResults((residual, loop) if part.has_controllers else (residual,), diagnosis=found)


def widen_for_faults(check: AxisFaults) -> list[Widening]:
    """Return the shifts of parameters by the faults of the mechanics that a check found; none without any.

    Faults of loop and log widen no interval: they are corrected, or not.
    """
    found = [one for one in check.findings if one.test.fault.mechanical]
    moved: dict[str, float] = {}
    for finding in found:
        for name, change in finding.changes.items():
            moved[name] = math.hypot(moved.get(name, 0.0), change.by)
    return [Widening(moved, "what the joint has and its model has not")] if found else []


def widen_for_rest(problem: ClosedLoopProblem, x: FloatArray, rest: PredictedResidual) -> Widening:
    """Return the largest shift of each parameter by a residual that follows the motion.

    A part of the torque of that norm, with the shape that shifts a parameter most, shifts it by its norm times the
    deviation of the parameter under unit noise (the inequality of Cauchy and Schwarz). The part that the parameters
    have absorbed is assumed as large as the residual one.
    """
    # The largest shift is two deviations.
    moved = worst_shift(problem, x, 0.5 * rest.share * problem.size)
    return Widening(moved, "a part of the torque that follows the motion and is not in the model")


def worst_shift(problem: ClosedLoopProblem, x: FloatArray, size: float) -> dict[str, float]:
    """Return the largest shift of each free parameter, by name, by a part of the filtered torque of a given norm."""
    slopes = problem.linearise(x)[1]
    sizes = column_norms(slopes)  # of parameters in units of their own
    # Rows of the pseudo-inverse: their norms are the deviations under unit noise, and never the root of a rounding.
    spread = np.linalg.norm(np.linalg.pinv(slopes / sizes, rcond=1e-8), axis=1) / sizes
    return {p.name: size * float(by) for p, by in zip(problem.free, spread, strict=True)}
