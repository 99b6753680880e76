"""Check that the closed loop and the log of an estimate are as declared."""

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
    """Test whether the loop and the log of a record are as declared, and name the faults.

    Args:
        estimate: by DIDIM, of this record; parameters identified beside the joint are not tested.
        record: that it was identified from.
        settings: see `LoopTests`.

    Raises:
        MethodError: the estimate did not simulate a loop, is of another record, or has a parameter that is not
            identifiable.

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
                "are identifiable from this record."
            )
        values[p.name] = p.value
    beside = [p.name for p in estimate.params if not p.of_joint and p.name not in INITIAL]
    free = {p.name for p in estimate.params if p.free}
    kept = tuple(p if p.name in free else p.fixed(values[p.name]) for p in problem.parameters)
    solved = replace(problem, parameters=kept).freeing(*beside)
    return find_faults(solved, solved.vector(values), settings)


def add_loop_verdict(estimate: Estimate, record: Record) -> Estimate:
    """Return an estimate with the verdict of its loop check added.

    An estimate that simulated no loop is returned as it is; one with a parameter that is not identifiable, with the
    verdict that the loop was not checked.

    Args:
        estimate: of the record.
        record: that it was identified from.
    """
    return add_loop_check(estimate, record)[0]


def add_loop_check(estimate: Estimate, record: Record) -> tuple[Estimate, LoopCheck | None]:
    """Return an estimate with the verdict of its loop check added, and the check; None where there is none."""
    if estimate.settings.loop is None:
        return estimate, None
    if any(p.value is None for p in estimate.params):
        verdict = not_tested(
            Subject.LOOP, "not checked, because the joint is not fully identified; identify it as rigid"
        )
        return estimate.amended(checks={"verdicts": (*estimate.checks.verdicts, verdict)}), None
    check = check_loop(estimate, record)
    verdict = Verdict(Subject.LOOP, Status.of(check.as_declared), check.reasons)
    return estimate.amended(checks={"verdicts": (*estimate.checks.verdicts, verdict)}), check
