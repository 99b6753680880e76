"""Several records of one joint: identified in one fit, after each was identified by itself.

Two steps. Each record by itself gives a start, the level of its residual, and what it says alone. Then bounded least
squares over all of them with the exact Jacobian, each record's rows divided by its level: records of different noise,
length or cut-off count for what they are worth.

Rows of different records do not err together in time; a place errs alike in all of them, where anything repeats with
the motion (`position_dependent_error`). Where the records, each by itself, disagree by more than their intervals allow,
the answer says so and widens what they share (`result.agreement`). What moves a record's own solution, beside noise
(`uncertainty_of_least_error`), moves the common one as far as the record weighs in it, and widens that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress, ignore_progress
from jointid.common.parameters import Parameter, adjust_parameters
from jointid.estimation.descent import History
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.force_in_loop import uncertainty_of_least_error
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.base import INITIAL, INITIAL_STATE, INITIAL_TORQUE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of, torque_problem
from jointid.estimation.problems.several_records import (
    RecordLayout,
    RecordsProblem,
    SeveralRecords,
    several,
)
from jointid.estimation.record_warnings import record_warnings
from jointid.estimation.result.agreement import Agreement, Alone, compare_records
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import (
    NOT_CONVERGED,
    build_fit,
    build_params,
    build_rows,
    find_active_bounds,
    find_lost,
    list_loop_channels,
    name_deviations,
    poor_fit,
    warn_of_bounds,
    warn_of_inseparable,
    warn_of_lost,
)
from jointid.estimation.result.estimate import fingerprint, relative_error
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Params, RecordFit, Settings
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.bounded_least_squares import TrustRegion
from jointid.solvers.regression import projection
from jointid.solvers.solve import Solution, solve
from jointid.uncertainty.covariance import Covariance, covariance_of
from jointid.uncertainty.identifiability import find_separable
from jointid.uncertainty.position_dependent_error import Repeatable, Uncertainty, cells, uncertainty

SOLVER = TrustRegion(1e-10, evaluations=100)
"""Of one record, and of several together."""

_NOTHING_LEFT = 1e-6  # of the torque: a residual below it is rounding, and no level
_ROUNDING = 1e-8  # of a value
_MOVED = "what a random force in the loop, or what the model lacks, moves of each record's own solution"


def identify_several(
    records: Sequence[Record],
    loops: ClosedLoop | Sequence[ClosedLoop],
    settings: SeveralRecords,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    progress: Progress,
) -> FitResult:
    """Return the fit of one joint to several records in one fit; see `jointid.identify`."""
    if isinstance(method, IDIM):
        raise MethodError("Records are identified together by simulating their loops; IDIM does not, so use DIDIM.")
    layout, given = RecordLayout.of(len(records), loops, settings), parameters or {}
    require_distinct(records)
    fits = []
    for k, record in enumerate(records):
        progress(f"record {k + 1}, {record.name}, by itself")
        changes = layout.changes(given, k, acting=False)
        fits.append(
            identify_record(record, layout.loops[k], method, filtering=filtering, parameters=changes, progress=progress)
        )
    found = list(zip(records, fits, strict=True))
    problems, per_log = (
        [
            _problem(record, fit, layout=layout, number=k, parameters=given, acting=acting)
            for k, (record, fit) in enumerate(found)
        ]
        for acting in (True, False)
    )
    alone = [by_itself(problem, values) for problem, values in zip(per_log, starts(fits), strict=True)]
    criterion = several(problems, settings.own, layout.added).weighing([1.0 / one.level for one in alone])
    gain = _gain(layout, alone)
    progress(f"{len(records)} records together, {len(criterion.free)} parameters")
    begin = [problem.vector(one.acting(gain)) for problem, one in zip(problems, alone, strict=True)]
    end = solve(criterion, SOLVER, criterion.vector(begin))
    progress(Detail(end.message))
    used = sum(fit.simulations for fit in fits) + sum(one.simulations for one in alone)
    simulations = used + (end.evaluations + 2) * len(records)
    about = tuple(
        f"record {number}: {said}"
        for number, (record, fit) in enumerate(found, 1)
        for said in record_warnings(record, fit)
    )
    solved = _Solved(records, RecordsProblem.of(layout, criterion), end, alone)
    return _build_result(solved, simulations, about)


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


def _problem(
    record: Record,
    fit: FitResult,
    *,
    layout: RecordLayout,
    number: int,
    parameters: Mapping[str, Parameter],
    acting: bool,
) -> ClosedLoopProblem:
    """Return a record's problem, the motor at its first sample resting or moving as its own identification found it.

    Per torque that is `acting`, the gain of the drive may be free; else it is kept at 1.
    """
    loop, free = layout.loops[number], [name for name in layout.free if acting or name != "drive_gain"]
    found = {p.name: p for p in fit.params.rows}
    state = tuple(
        replace(p, start=found[p.name].value, free=found[p.name].free)
        for p in (*INITIAL_STATE, INITIAL_TORQUE)
        if p.name in found
    )
    known = adjust_parameters(loop.joint.parameters, layout.changes(parameters, number, acting=acting))
    return torque_problem(record, loop, fit.settings.filtering, known, state).freeing(*free)


# Each record by itself


@dataclass(frozen=True, slots=True, eq=False)
class BySelf:
    """One record fitted by itself.

    It is fitted as it will be with the others, by bounded least squares with the exact Jacobian, from what its own
    identification found; only the gain of its drive, which no record tells alone, is kept at 1.

    Attributes:
        problem: what was solved, per torque of the log.
        end: its solution, in rows that are weighted.
        error: (rows,) its residual, not weighted.
        level: rms of the residual over its degrees of freedom.
        uncertainty: of the solution, see `uncertainty_of_least_error`.
        repeatable: what of the residual repeats with the motion.
        simulations: that this took.
    """

    problem: ClosedLoopProblem
    end: Solution
    error: FloatArray
    level: float
    uncertainty: Uncertainty
    repeatable: Repeatable
    simulations: int

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, the fixed ones too."""
        return self.problem.values(self.end.x)

    @property
    def filtered_error(self) -> float:
        """Residual share of the filtered torque."""
        return self.problem.filtered_error(self.error)

    @property
    def together(self) -> tuple[str, ...]:
        """Parameters that this record shows only together; see `find_separable`."""
        apart = find_separable(self.end.jacobian)
        return tuple(p.name for p, separable in zip(self.problem.free, apart, strict=True) if not separable)

    def acting(self, gain: float) -> dict[str, float]:
        """Return the values in terms of the acting torque, `gain` times the logged one."""
        own = {p.name for p in self.problem.joint.parameters}
        return {n: gain * v if n in own else v for n, v in self.values.items()} | {"drive_gain": gain}


def by_itself(problem: ClosedLoopProblem, values: Mapping[str, float]) -> BySelf:
    """Fit one record, all of its rows weighing the same.

    Args:
        problem: of the record.
        values: where to begin, by name.
    """
    end = solve(problem, SOLVER, problem.vector(values))
    level = float(np.linalg.norm(end.residual)) / math.sqrt(max(end.residual.size - end.x.size, 1))
    level = max(level, _nothing(problem))
    judged, used = _judge(problem, end)
    return BySelf(problem, end, end.residual, level, judged, judged.repeatable, used + end.evaluations)


def _nothing(problem: ClosedLoopProblem) -> float:
    """Return the level of a residual that is as good as none."""
    return _NOTHING_LEFT * float(np.sqrt(np.mean(problem.filter(problem.measured) ** 2)))


def _judge(problem: ClosedLoopProblem, end: Solution) -> tuple[Uncertainty, int]:
    """Return the uncertainty of a record's own solution, and the number of simulations."""
    history, run = History(ignore_progress), problem.simulate(end.x)
    known = uncertainty_of_least_error(problem, end.x, run, end.residual, -end.jacobian, history)
    return known, history.tally.evaluations + 1


def starts(fits: Sequence[FitResult]) -> list[dict[str, float]]:
    """Return the values each record starts from; one that it refused is another record's.

    Raises:
        MethodError: a parameter is refused by all of them.
    """
    every = [{p.name: p.value for p in e.params.rows if p.value is not None} for e in fits]
    anywhere = {name: value for each in reversed(every) for name, value in each.items()}
    lost = [p.name for p in fits[0].params.rows if p.name not in anywhere]
    if lost:
        raise MethodError(
            f"No record by itself tells {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [anywhere | each for each in every]


def _gain(layout: RecordLayout, alone: Sequence[BySelf]) -> float:
    """Return a start of the drive gain: the slope of the added values over those of separate fits."""
    name = next((name for more in layout.added for name in more), None)
    if "drive_gain" not in layout.free or name is None:
        return 1.0
    added = np.array([more.get(name, 0.0) for more in layout.added])
    found = np.array([one.values[name] for one in alone])
    change = found - found.mean()
    slope = float(change @ added) / (float(change @ change) or 1.0)
    return slope if slope > 0 else 1.0


# All of them


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Several records together, and each by itself, when they are solved."""

    records: Sequence[Record]
    problem: RecordsProblem
    end: Solution
    alone: Sequence[BySelf]

    def by_itself(self, number: int) -> tuple[EstimatedParameter, ...]:
        """Return the estimate from one record alone, per unit torque, without the added inertia."""
        one, layout = self.alone[number], self.problem.layout
        gain, own = self.problem.values(self.end.x).get("drive_gain", 1.0), {p.name for p in layout.joint.parameters}
        free, acting, more = one.problem.free, one.acting(gain), layout.added[number]
        values = {p.name: acting[p.name] - more.get(p.name, 0.0) for p in free}
        std = np.array([gain if p.name in own else 1.0 for p in free]) * one.uncertainty.covariance.std
        lost = {*find_lost(free, np.array(list(values.values())), std), *one.together}
        return build_rows(free, values, dict(zip(values, map(float, std), strict=True)), layout.unit, own, lost)


def _build_result(solved: _Solved, simulations: int, about: tuple[str, ...]) -> FitResult:
    """Return the fit of all records.

    Args:
        solved: the records together, and each by itself.
        simulations: that were run.
        about: warnings of the single records.
    """
    problem, end, layout = solved.problem, solved.end, solved.problem.layout
    judged, compared = _judge_together(solved), _compare(solved)
    names = [p.name for p in problem.free]
    # The variance between runs of what they do not agree in is added to that of their common value.
    more = {p.name: p.widening for p in compared.parameters}
    wider = judged.covariance.matrix + np.diag([more.get(name, 0.0) for name in names])
    covariance = covariance_of(wider, judged.covariance.bandwidth)
    shares = tuple(_record_fit(solved, k) for k in range(len(solved.records)))
    predicted = np.concatenate([share.predicted for share in shares])
    error = problem.filter(problem.measured - predicted)
    lost = find_lost(problem.free, end.x, covariance.std)
    basis = f"from the output sensitivities, {judged.basis}; no record's rows correlated with another's"
    held = find_active_bounds(problem.free, end.x, end.residual, end.jacobian)
    params = build_params(
        problem, end.x, name_deviations(problem, covariance), covariance.correlation, basis, lost, held
    )
    rows = dict(zip([p.name for p in problem.parameters], params.rows, strict=True))
    own = tuple(tuple(rows[p.name] for p in problem.of_record(k) if "@" in p.name) for k in range(len(solved.records)))
    shared = tuple(row for name, row in rows.items() if "@" not in name)
    return FitResult(
        params=Params(shared, params.names, params.correlation, basis, own),
        fit=build_fit(problem, predicted, error, end.message, converged=end.converged, simulations=simulations),
        checks=Checks(agreement=compared, warnings=(*_warn(solved, judged, compared, covariance, lost), *about)),
        data=Data(
            record=", ".join(record.name for record in solved.records),
            channels=tuple(dict.fromkeys(name for share in shares for name in share.channels)),
            sample_time=problem.sample_time,
            torque_unit=layout.torque_unit,
            records=shares,
        ),
        settings=Settings(
            "didim",
            "DIDIM by least squares",
            system=problem.joint,
            loop=layout.loops[0],
            filtering=problem.filtering,
            weighting="each record's rows by the level of its residual",
        ),
    )


def _judge_together(solved: _Solved) -> Uncertainty:
    """Return the uncertainty before the records are compared."""
    problem, end = solved.problem, solved.end
    each, criterion = problem.criterion.problems, problem.criterion
    runs = [p.simulate(criterion.of_member(end.x, k)) for k, p in enumerate(each)]
    positions = [run.motor_position[p.kept] for p, run in zip(each, runs, strict=True)]
    velocities = [run.motor_velocity[p.kept] for p, run in zip(each, runs, strict=True)]
    where = cells(np.concatenate(positions), np.concatenate(velocities))
    names, rows = [p.name for p in problem.free], [at.size for at in positions]
    known = uncertainty(end.jacobian, end.jacobian, end.residual, where, names, each[0].torque_unit, rows)
    moved = _moved_together(solved, np.cumsum(rows)[:-1])
    return known.widened_by(moved, _MOVED) if np.any(moved) else known


def _moved_together(solved: _Solved, ends: NDArray[np.intp]) -> FloatArray:
    """Return how far what moves the records by themselves may move the common solution, (free,).

    Each moves it as far as it weighs in it. Records may err alike or against each other, so the sizes add up.

    Args:
        solved: what was solved.
        ends: the first rows of the second record and of those that follow.
    """
    criterion, J = solved.problem.criterion, solved.end.jacobian
    gain = solved.problem.values(solved.end.x).get("drive_gain", 1.0)
    own = {p.name for p in solved.problem.layout.joint.parameters}
    answers, total = np.split(projection(J, J), ends, axis=1), np.zeros(J.shape[1])
    for k, (one, rows, answer) in enumerate(zip(solved.alone, np.split(J, ends), answers, strict=True)):
        steps = np.zeros_like(total)
        for shift in one.uncertainty.shifts:
            by = dict(zip((p.name for p in one.problem.free), shift, strict=True))
            its = [(gain if p.name in own else 1.0) * by.get(p.name, 0.0) for p in criterion.problems[k].free]
            steps = np.hypot(steps, answer @ (rows[:, criterion.places[k]] @ np.array(its)))
        total += steps
    return total


def _compare(solved: _Solved) -> Agreement:
    """Test whether the estimates from single records agree.

    Per torque that acts, by the gain that was found. The inertia that tells the gain is not compared.
    """
    layout = solved.problem.layout
    stated = {"drive_gain", *(name for more in layout.added for name in more)} if "drive_gain" in layout.free else set()
    units = {p.name: layout.unit(p) for p in solved.problem.free if "@" not in p.name and p.name not in stated}
    each = []
    for k, one in enumerate(solved.alone):
        known, free = one.uncertainty.covariance, one.problem.free
        held = find_active_bounds(free, one.end.x, one.end.residual, one.end.jacobian)
        compared = units.keys() & {p.name for p in solved.problem.of_record(k)} - {*held, *one.together}
        kept = [i for i, p in enumerate(free) if p.name in compared and known.std[i] > 0]
        rows = solved.by_itself(k)
        values = {rows[i].name: rows[i].value or 0.0 for i in kept}
        # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
        std = np.array([max(rows[i].stderr or 0.0, _ROUNDING * abs(values[rows[i].name])) for i in kept])
        each.append(Alone(values, Covariance(std, known.correlation[np.ix_(kept, kept)], known.bandwidth)))
    return compare_records(each, units)


def _record_fit(solved: _Solved, number: int) -> RecordFit:
    """Return the estimate from one record, and the fit of the common model to it."""
    problem, record, one = solved.problem.criterion.problems[number], solved.records[number], solved.alone[number]
    x = solved.problem.criterion.of_member(solved.end.x, number)
    values, predicted = problem.values(x), problem.torque(x)
    error = problem.filter(problem.measured - predicted)
    assert record.torque is not None
    return RecordFit(
        name=record.name,
        fingerprint=fingerprint(record.torque.values),
        resampled=record.resampled,
        loop=problem.loop,
        channels=list_loop_channels(problem.loop, record),
        added_inertia=sum(solved.problem.layout.added[number].values()),
        alone=solved.by_itself(number),
        values={p.name: values[p.name] for p in problem.joint.parameters},
        initial=initial_of(values),
        level=one.level,
        repeatable=one.repeatable,
        sample_time=problem.sample_time,
        filtering=problem.filtering,
        rows=error.size,
        measured=problem.measured,
        predicted=predicted,
        relative_error=relative_error(problem.measured, predicted, problem.filtering.borders),
        filtered_error=problem.filtered_error(error),
        alone_error=one.filtered_error,
    )


def _warn(
    solved: _Solved, judged: Uncertainty, compared: Agreement, covariance: Covariance, lost: Sequence[str]
) -> tuple[str, ...]:
    """Return the warnings, one sentence each."""
    free, end = solved.problem.free, solved.end
    stated = [i for i, p in enumerate(free) if p.name.partition("@")[0] not in INITIAL]
    return (
        *([] if end.converged else [NOT_CONVERGED]),
        *([str(compared)] if compared.differs else []),
        *warn_of_lost(lost, "these records"),
        *warn_of_bounds(find_active_bounds(free, end.x, end.residual, end.jacobian), "records"),
        *warn_of_inseparable([p.name for p in free], covariance.correlation, stated, "these records"),
        *map(str, judged.warnings),
        *([str(judged.repeatable)] if judged.repeatable.significant else []),
        *(f"record {k}: {said}" for k, one in enumerate(solved.alone, 1) for said in poor_fit(one.filtered_error)),
    )
