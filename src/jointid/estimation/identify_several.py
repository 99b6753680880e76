"""Several records of one joint: identified in one fit, from where each of them ends by itself.

The fit of each record by itself is its start. Bounded least squares over all of them follows, each record's rows
divided by the level of its residual: records of different noise, length or cut-off count for what they are worth.

Rows of different records do not err together in time; a place errs alike in all of them, where anything repeats with
the motion (`position_dependent_error`). What a record says alone is one Gauss-Newton step from the common solution.
Where the records disagree by more than their intervals allow, the answer says so and widens what they share
(`result.agreement`). What moves a record's own solution, beside noise (`uncertainty_of_least_error`), moves the common
one as far as the record weighs in it, and widens that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.estimation.identify_log import Start, build_answer, describe_record, pose
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.base import adjust_parameters
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.log_windows import Solved, stream
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem
from jointid.estimation.result.agreement import Alone, compare_records
from jointid.estimation.result.build_result import find_active_bounds
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.result.parts import Checks, RecordFit
from jointid.estimation.windowed import loop_model
from jointid.records.chunks import Chunk
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Tally
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.identifiability import find_separable
from jointid.uncertainty.position_dependent_error import Cells, cells, uncertainty
from jointid.uncertainty.resampling import Sums, step_of

_ROUNDING = 1e-8  # of a value


def identify_several(
    records: Sequence[Record],
    layout: RecordLayout,
    method: Method | None,
    filtering: Filtering,
    parameters: Mapping[str, Parameter],
    progress: Progress,
) -> Estimate:
    """Return the fit of one joint to several records in one fit; see `jointid.identify`."""
    alone = list[Estimate]()
    for k, (record, loop) in enumerate(zip(records, layout.loops, strict=True)):
        progress(f"record {k + 1}, {record.name}, by itself")
        changes = layout.changes(parameters, k, acting=False)
        alone.append(identify_record(record, loop, method, filtering, changes, progress))
    own, values = [_solved(one)[0] for one in alone], [_told(one) for one in alone]
    starts = fill_starts(values, [p.name for p in own[0].parameters])
    gain = _gain(layout, starts)
    problems = [_share(problem, layout, parameters, k) for k, problem in enumerate(own)]
    begin = [problem.vector(_act(start, layout, gain)) for problem, start in zip(problems, starts, strict=True)]
    begun = [
        Start([record], fit, loop_model(problem, whole=True), x)
        for record, fit, problem, x in zip(records, alone, problems, begin, strict=True)
    ]
    problem, x, together = pose(begun, [partial(_whole, one) for one in records], [one.name for one in records], layout)
    progress(f"{len(records)} records together, {x.size} parameters")
    simulated = Tally(sum(one.fit.simulations for one in alone) + len(records))
    solved = stream(replace(problem, kept=True, progress=progress, tally=simulated), x)
    progress(Detail(solved.stop))
    assert together is not None
    return _judge(together, solved, records, alone)


def _whole(record: Record, *_: int) -> list[list[Chunk]]:
    """Return a record as its only window."""
    return [[Chunk(0, record, last=True)]]


def require_distinct(records: Sequence[Record]) -> None:
    """Raise a `MethodError` if a record is there twice."""
    seen: dict[str, int] = {}
    for number, record in enumerate(records, 1):
        mark = fingerprint(record.torque.values) if record.torque is not None else str(number)
        if mark in seen:
            raise MethodError(
                f"Records {seen[mark]} and {number} are the same record, which is no second one: name another file."
            )
        seen[mark] = number


def fill_starts(each: Sequence[Mapping[str, float]], names: Sequence[str]) -> list[dict[str, float]]:
    """Return the values each record starts from, by name; one that it does not tell is another record's.

    Raises:
        MethodError: no record tells one of these names.
    """
    anywhere = {name: value for values in reversed(each) for name, value in values.items()}
    if lost := [name for name in names if name not in anywhere]:
        raise MethodError(
            f"No record by itself tells {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [{**anywhere, **values} for values in each]


def _solved(fit: Estimate) -> tuple[ClosedLoopProblem, FloatArray]:
    assert fit.problem is not None and fit.x is not None
    return fit.problem, fit.x


def _told(fit: Estimate) -> dict[str, float]:
    """Return every parameter that a record tells by itself, by name, the fixed ones too."""
    (problem, x), told = _solved(fit), {p.name for p in fit.params.rows if p.value is not None}
    return {name: value for name, value in problem.values(x).items() if name in told}


def _act(values: Mapping[str, float], layout: RecordLayout, gain: float) -> dict[str, float]:
    """Return values in terms of the acting torque, `gain` times the logged one."""
    own = {p.name for p in layout.joint.parameters}
    return {n: gain * v if n in own else v for n, v in values.items()} | {"drive_gain": gain}


def _share(
    problem: ClosedLoopProblem, layout: RecordLayout, parameters: Mapping[str, Parameter], number: int
) -> ClosedLoopProblem:
    """Return the problem of a record as one of all records; the gain of the drive may be free."""
    joint = problem.joint.parameters
    own = adjust_parameters(joint, layout.changes(parameters, number, acting=True))
    return replace(problem, parameters=(*own, *problem.parameters[len(joint) :])).freeing(*layout.free)


def _gain(layout: RecordLayout, starts: Sequence[Mapping[str, float]]) -> float:
    """Return a start of the drive gain: the slope of the added values over those of separate fits."""
    name = next((name for more in layout.added for name in more), None)
    if "drive_gain" not in layout.free or name is None:
        return 1.0
    added = np.array([more.get(name, 0.0) for more in layout.added])
    found = np.array([values[name] for values in starts])
    change = found - found.mean()
    slope = float(change @ added) / (float(change @ change) or 1.0)
    return slope if slope > 0 else 1.0


def _judge(together: RecordsProblem, solved: Solved, records: Sequence[Record], fits: Sequence[Estimate]) -> Estimate:
    """Return the fit of all records, with what each says alone."""
    layout, x, found, sigma = together.layout, solved.x, solved.found, solved.problem.sigma[:, 0]
    members = zip(together.problems, together.places, together.added, strict=True)
    own = [problem.simulate(x[at] + more) for problem, at, more in members]
    seen = [(run.motor_position[one.at], run.motor_velocity[one.at]) for run, one in zip(own, found.seen, strict=True)]
    error = np.concatenate([one.error[0] / size for one, size in zip(found.seen, sigma, strict=True)])
    J = np.concatenate([one.J[0] / size for one, size in zip(found.seen, sigma, strict=True)])
    ends = np.cumsum([one.at.size for one in found.seen])
    influence = Influence(J, error, series=[one.at.size for one in found.seen])
    known = uncertainty(influence, cells(*(np.concatenate(each) for each in zip(*seen, strict=True))))
    gain = dict(zip((p.name for p in together.free), x, strict=True)).get("drive_gain", 1.0)
    alone, shares, moved = list[Alone](), list[RecordFit](), np.zeros(x.size)
    for k, (one, fit) in enumerate(zip(found.seen, fits, strict=True)):
        # The gain is not told by a record alone.
        at = [i for i in together.places[k] if together.free[i].name != "drive_gain"]
        free, slopes = [together.free[i] for i in at], one.J[0][:, at]
        names = [p.name for p in _solved(fit)[0].free]
        shifts = [_act(dict(zip(names, shift, strict=True)), layout, gain) for shift in fit.shifts]
        steps = [np.array([by.get(p.name.partition("@")[0], 0.0) for p in free]) for by in shifts]
        answer = influence.matrix[:, ends[k] - one.at.size : ends[k]] / sigma[k]
        moved += np.sqrt(sum((answer @ slopes @ step) ** 2 for step in steps))  # they may err alike, or against others
        alone.append(_step_alone(free, x[at], one.error[0], slopes, cells(*seen[k]), steps))
        shares.append(describe_record(together, k, records[k], solved, alone[-1]))
    if np.any(moved):
        known = known.widened_by(moved)
    # The inertia that tells the gain is not compared.
    gained = {name for more in layout.added for name in more} if "drive_gain" in layout.free else set()
    compared = compare_records(alone, {n: unit for n, unit in together.units.items() if n not in gained})
    covariance = compared.widen(known.covariance, [p.name for p in together.free])
    repeats = [str(known.repeatable)] if known.repeatable.significant else []
    of_records = [f"record {k}: {said}" for k, fit in enumerate(fits, 1) for said in fit.checks.warnings]
    checks = Checks(agreement=compared, warnings=(*map(str, known.warnings), *repeats, *of_records))
    return build_answer(fits[0], records, solved, covariance, together, shares, checks)


def _step_alone(
    free: Sequence[Parameter],
    x: FloatArray,
    error: FloatArray,
    J: FloatArray,
    where: Cells,
    shifts: Sequence[FloatArray],
) -> Alone:
    """Return the solution of one record alone, one step from the common x, (free,).

    Args:
        free: its parameters.
        x: their common values.
        error: (rows,) its filtered error there.
        J: (rows, free) its derivatives.
        where: its rows' cells.
        shifts: (free,) each, of its solution beside noise.
    """
    step = step_of(Sums.of(error, J, error), Bounds.of(free).shift_to(x))
    left, values = error + J @ step, x + step
    found = uncertainty(Influence(J, left), where)
    for shift in shifts:
        found = found.widened_by(shift)
    # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
    std, held = np.maximum(found.covariance.std, _ROUNDING * np.abs(values)), find_active_bounds(free, values, left, J)
    told = [i for i, apart in enumerate(find_separable(J)) if apart and std[i] > 0 and free[i].name not in held]
    correlation = found.covariance.correlation[np.ix_(told, told)]
    return Alone({free[i].name: float(values[i]) for i in told}, Covariance(std[told], correlation))
