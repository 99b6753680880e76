"""The checks of a fit: controller and log, causes of a misfit, and what of the residual follows the motion."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.errors import JointidError
from jointid.common.messages import Progress, ignore_progress
from jointid.diagnostics.check_loop import SearchState, search_faults
from jointid.diagnostics.faults.motion import find_too_short
from jointid.diagnostics.find_causes import explain_misfit
from jointid.diagnostics.lack_of_fit import widen_for_faults, widen_for_rest
from jointid.diagnostics.unmodelled_motion import PredictedResidual, predict_residual
from jointid.estimation.result.assemble import CheckResults, FitResult, assemble
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import FlexibleJoint
from jointid.uncertainty.verdict import Status, Subject, Verdict, skip_test


def run_checks(fit: FitResult, progress: Progress = ignore_progress, shown: Sequence[DriveNumber] = ()) -> CheckResults:
    """Return the results of the checks of a fit; none where no loop was simulated, or of several records.

    A parameter that is not identifiable leaves the loop unchecked. Where the record does not fit, and a cause explains
    it (`find_causes`), the cause is the verdict: the sensitivities then mislead. Where the residual of a flexible joint
    follows its motion with the faults corrected, the verdict on what repeats says so (`unmodelled_motion`).

    Args:
        fit: the result of a method.
        progress: is told each step in a sentence.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
    """
    record, problem, x = fit.record, fit.problem, fit.x
    if record is None or problem is None or x is None:
        return CheckResults()
    progress("checking loop and log")
    check = state = rest = None
    verdict = skip_test(Subject.LOOP, "not checked, because the joint is not fully identified; identify it as rigid")
    whole = all(p.value is not None for p in fit.params.rows)
    if whole:
        try:
            std = {p.name: p.stderr for p in fit.params.rows if p.stderr is not None}
            check, state = search_faults(problem, x, std=std, record=record, shown=shown)
            verdict = Verdict(Subject.LOOP, check.status, check.reasons)
            rest = _predict_rest(state)
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
        return CheckResults((Verdict(Subject.LOOP, Status.FAILED, (causes.message,)),), loop=check)
    short = find_too_short(record) if whole else None  # what is refused is not relied on
    if short is not None:
        verdict = Verdict(Subject.LOOP, Status.FAILED, (short,))
    widenings = [] if check is None else widen_for_faults(check)
    if rest is None or not rest.follows or state is None:
        return CheckResults((verdict,), tuple(widenings), check)
    with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # the verdict stands, however wide it is
        widenings.append(widen_for_rest(state.problem, state.x, rest))
    return CheckResults((_follows(fit, rest), verdict), tuple(widenings), check)


def _follows(fit: FitResult, rest: PredictedResidual) -> Verdict:
    """Return the verdict that the residual follows the motion, before what the residual tests found."""
    follows = rest.verdict
    before = next((one for one in fit.checks.verdicts if one.subject is follows.subject), None)
    kept = before.reasons if before is not None and before.status is Status.FAILED else ()
    return replace(follows, reasons=(*follows.reasons, *kept))


def _predict_rest(state: SearchState) -> PredictedResidual | None:
    """Return how much of the residual of a flexible joint its motion predicts; None for a rigid one."""
    if not isinstance(state.problem.joint, FlexibleJoint):
        return None
    try:
        return predict_residual(state.problem, state.x)
    except np.linalg.LinAlgError:  # what the tests found stands
        return None
