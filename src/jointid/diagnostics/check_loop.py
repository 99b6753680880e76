"""The check of an answer's loop: is it as declared, and what is wrong with this record?"""

from __future__ import annotations

from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.diagnostics.loop_check import LoopCheck
from jointid.diagnostics.misspecification_tests import LoopTests, find_faults
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.problems.nuisance_parameters import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Record
from jointid.uncertainty.verdict import Status, Subject, Verdict, not_tested


def check_loop(estimate: Estimate, record: Record, settings: LoopTests | None = None) -> LoopCheck:
    """Return whether the loop and the log of a record are as declared, and what is not.

    Args:
        estimate: by DIDIM, of this record; what was identified beside the joint is not suspected.
        record: that it was identified from.
        settings: see `LoopTests`.

    Raises:
        MethodError: the estimate did not simulate a loop, is of another record, or refuses a parameter.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> record = axis.record.without("motor_position", "load_position")
        >>> estimate = ji.identify(record, axis.loop, ji.FlexibleDIDIM(frequency=30.0))
        >>> ji.check_loop(estimate, record).as_declared
        True
    """
    if estimate.settings.loop is None:
        raise MethodError("IDIM simulates no loop, so there is none to check; identify with DIDIM and the controller.")
    problem = torque_problem(
        record, estimate.settings.loop, estimate.settings.filtering, estimate.settings.joint.parameters
    )
    if len(problem.measured) != len(estimate.fit.measured) or (problem.measured != estimate.fit.measured).any():
        raise MethodError(
            f"The estimate was identified from {estimate.data.record}, and {record.name} has another torque; give the "
            "record it was identified from."
        )
    values = {}
    for p in estimate.params:
        if p.value is None:
            raise MethodError(
                f"The estimate gives no {p.name}, so its loop cannot be simulated; identify a joint whose parameters "
                "this record determines."
            )
        values[p.name] = p.value
    freed = [p.name for p in estimate.params if not p.of_joint and p.name not in INITIAL]
    free = {p.name for p in estimate.params if p.free}
    kept = tuple(p if p.name in free else p.fixed(values[p.name]) for p in problem.parameters)
    solved = replace(problem, parameters=kept).freeing(*freed)
    return find_faults(solved, solved.vector(values), settings)


def add_loop_verdict(estimate: Estimate, record: Record) -> Estimate:
    """Return an estimate with one more verdict: whether its loop and its log are as declared.

    An estimate that simulated no loop, or refuses a parameter, comes back with the verdict that it was not looked at,
    or as it is.

    Args:
        estimate: of the record.
        record: that it was identified from.
    """
    return add_loop_check(estimate, record)[0]


def add_loop_check(estimate: Estimate, record: Record) -> tuple[Estimate, LoopCheck | None]:
    """Return an estimate as `with_loop_verdict` does, and the check; None where there was none."""
    if estimate.settings.loop is None:
        return estimate, None
    if any(p.value is None for p in estimate.params):
        verdict = not_tested(Subject.LOOP, "not looked at, since the joint is not known; identify it as rigid")
        return estimate.amended(checks={"verdicts": (*estimate.checks.verdicts, verdict)}), None
    check = check_loop(estimate, record)
    verdict = Verdict(Subject.LOOP, Status.of(check.as_declared), check.reasons)
    return estimate.amended(checks={"verdicts": (*estimate.checks.verdicts, verdict)}), check
