"""Several records of one joint: identified in one fit, after each was identified by itself.

Two steps. Each record by itself gives a start, the level and the spectrum of its residual, and what it says alone. Then
bounded least squares over all of them with the exact Jacobian, each record's rows through the filter that makes its own
residual white and of level 1: records of different noise, length or cut-off count for what they are worth, and so does
what is seen at frequencies where a record's noise is small. A disturbance in the loop of the paper's twin leaves the
difference of two load inertias, or the gain of a drive, two thirds of the deviation it has under equal weights.

What repeats with the motion is not noise, and to weigh it away is to believe the model where it is wrong: the EMPS axis
would have 245 N s/m of viscous friction for 210. Where the residual of any record repeats, rows are weighted by their
record's level alone.

Rows of different records do not err together in time; a place errs alike in all of them, where anything repeats with
the motion (`repeatable`). Where the records, each by itself, disagree by more than their intervals allow, the answer
says so and widens what they share (`scatter`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.cross_axis import record_warnings
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE, INITIAL_TORQUE
from jointid.estimation.problems.several_records import several
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.several_records.per_record_fit import SOLVER, BySelf, by_itself, starts, whitened
from jointid.estimation.several_records.record_layout import Arrangement
from jointid.estimation.several_records.settings import SeveralRecords, Weighting
from jointid.estimation.several_records.summarise import concluded
from jointid.models.parameters import Parameter, adjusted
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.solve import solve


def identify_several(
    records: Sequence[Record],
    loops: ClosedLoop | Sequence[ClosedLoop],
    settings: SeveralRecords,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    progress: Progress,
) -> Estimate:
    """Return the estimate of one joint from several records in one fit; see `jointid.identify`."""
    if isinstance(method, IDIM):
        raise MethodError("Records are identified together by simulating their loops; IDIM does not, so use DIDIM.")
    chosen = Arrangement.of(len(records), loops, settings.added_inertia, settings.own, settings.free)
    _require_different(records)
    estimates = []
    for k, record in enumerate(records):
        progress(f"record {k + 1}, {record.name}, by itself")
        changes = chosen.changes(parameters or {}, k, acting=False)
        estimates.append(
            identify_record(record, chosen.loops[k], method, filtering=filtering, parameters=changes, progress=progress)
        )
    begin = zip(records, starts(estimates), estimates, strict=True)
    alone, problems = [], []
    for k, (record, values, estimate) in enumerate(begin):
        known = chosen.changes(parameters or {}, k, acting=True)
        problems.append(_problem(record, estimate, chosen.loops[k], known, chosen.free))
        changes = chosen.changes(parameters or {}, k, acting=False)
        surrounding = [name for name in chosen.free if name != "drive_gain"]
        alone.append(by_itself(_problem(record, estimate, chosen.loops[k], changes, surrounding), values))
    alone, how = _weighed(alone, settings.weighting)
    criterion = several(problems, settings.own, chosen.added).weighing([one.weights for one in alone])
    gain = _gain(chosen, alone)
    progress(f"{len(records)} records together, {len(criterion.free)} parameters")
    found = [problem.vector(one.acting(gain)) for problem, one in zip(problems, alone, strict=True)]
    end = solve(criterion, SOLVER, criterion.vector(found))
    progress(end.message)
    simulations = sum(estimate.fit.simulations for estimate in estimates) + sum(one.simulations for one in alone)
    found_together = concluded(records, chosen, criterion, end, alone, simulations, how)
    about = [
        f"record {number}: {said}"
        for number, (record, estimate) in enumerate(zip(records, estimates, strict=True), 1)
        for said in record_warnings(record, estimate)
    ]
    return found_together.amended(checks={"warnings": (*found_together.checks.warnings, *about)})


def _require_different(records: Sequence[Record]) -> None:
    seen: dict[str, int] = {}
    for number, record in enumerate(records, 1):
        mark = fingerprint(record.torque.values) if record.torque is not None else str(number)
        if mark in seen:
            raise MethodError(
                f"Records {seen[mark]} and {number} are the same record, which is no second one: name another file."
            )
        seen[mark] = number


def _problem(
    record: Record, estimate: Estimate, loop: ClosedLoop, changes: Mapping[str, Parameter], free: Sequence[str]
) -> ClosedLoopProblem:
    """Return a record's problem, the motor at its first sample resting or moving as its own identification found it."""
    found = {p.name: p for p in estimate.params}
    state = tuple(
        replace(p, start=found[p.name].value, free=found[p.name].free)
        for p in (*INITIAL_STATE, INITIAL_TORQUE)
        if p.name in found
    )
    known = adjusted(loop.joint.parameters, changes)
    return torque_problem(record, loop, estimate.settings.filtering, known, state).freeing(*free)


def _weighed(alone: list[BySelf], weighting: Weighting) -> tuple[list[BySelf], str]:
    """Return the records with the weights of their rows, and these in words."""
    if weighting == "level":
        return alone, "each record's rows by the level of its residual"
    if any(one.repeatable.significant for one in alone):
        return alone, "each record's rows by the level of its residual alone, because it repeats with the motion"
    return [whitened(one) for one in alone], "each record's rows by the spectrum of its residual"


def _gain(chosen: Arrangement, alone: Sequence[BySelf]) -> float:
    """Return where the gain of the drive starts: what was added, over what the records by themselves differ by."""
    name = next((name for more in chosen.added for name in more), None)
    if "drive_gain" not in chosen.free or name is None:
        return 1.0
    added = np.array([more.get(name, 0.0) for more in chosen.added])
    found = np.array([one.values[name] for one in alone])
    change = found - found.mean()
    slope = float(change @ added) / (float(change @ change) or 1.0)
    return slope if slope > 0 else 1.0
