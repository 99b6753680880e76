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

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Parameter, adjust_parameters
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem, several
from jointid.estimation.result.agreement import Agreement, Alone, compare_records
from jointid.estimation.result.build_result import (
    build_estimate,
    build_params,
    build_rows,
    find_active_bounds,
    list_loop_channels,
)
from jointid.estimation.result.estimate import Estimate, fingerprint, relative_error
from jointid.estimation.result.parts import Checks, EstimatedParameter, RecordFit, Settings
from jointid.records.checks import find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.identifiability import find_separable
from jointid.uncertainty.position_dependent_error import Uncertainty, cells, uncertainty

_SOLVER = LevenbergMarquardt(evaluations=100)
_NOTHING_LEFT = 1e-6  # of the torque: a residual below it is rounding, and no level
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
    alone = []
    for k, record in enumerate(records):
        progress(f"record {k + 1}, {record.name}, by itself")
        changes = layout.changes(parameters, k, acting=False)
        fit = identify_record(record, layout.loops[k], method, filtering, changes, progress)
        alone.append(BySelf.of(record, fit, layout, k))
    starts = fill_starts([one.values for one in alone], [p.name for p in alone[0].problem.parameters])
    problems = [one.together(parameters) for one in alone]
    whole = several(problems, layout).weighing([1.0 / one.level for one in alone])
    gain = _gain(layout, starts)
    progress(f"{len(records)} records together, {len(whole.free)} parameters")
    begin = [
        problem.vector(one.acting(start, gain)) for problem, one, start in zip(problems, alone, starts, strict=True)
    ]
    end = solve(whole, _SOLVER, whole.join(begin))
    progress(Detail(end.message))
    simulations = sum(one.fit.fit.simulations for one in alone) + (end.evaluations + 3) * len(records)
    return _build_result(whole, end, alone, simulations)


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


@dataclass(frozen=True, slots=True, eq=False)
class BySelf:
    """One record fitted by itself, per torque of its log.

    Attributes:
        record: what it was fitted to. fit: of it.
        layout: of all records. number: of this one, from 0.
        problem: what was solved. x: (free,) its solution.
        residual: (rows,) there. slopes: (rows, free) its derivatives.
    """

    record: Record
    fit: Estimate
    layout: RecordLayout
    number: int
    problem: ClosedLoopProblem
    x: FloatArray
    residual: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, record: Record, fit: Estimate, layout: RecordLayout, number: int) -> BySelf:
        """Return a record's own fit, evaluated once more at its end."""
        assert fit.problem is not None and fit.x is not None
        return cls(record, fit, layout, number, fit.problem, fit.x, *fit.problem.linearise(fit.x))

    @property
    def values(self) -> dict[str, float]:
        """Every parameter that it tells, by name, the fixed ones too."""
        told = {p.name for p in self.fit.params.rows if p.value is not None}
        return {name: value for name, value in self.problem.values(self.x).items() if name in told}

    @property
    def level(self) -> float:
        """Rms of the residual over its degrees of freedom."""
        level = float(np.linalg.norm(self.residual)) / math.sqrt(max(self.residual.size - self.x.size, 1))
        signal = self.problem.filter(self.problem.measured)
        return max(level, _NOTHING_LEFT * float(np.sqrt(np.mean(signal**2))))

    def acting(self, values: Mapping[str, float], gain: float) -> dict[str, float]:
        """Return values in terms of the acting torque, `gain` times the logged one."""
        own = {p.name for p in self.problem.joint.parameters}
        return {n: gain * v if n in own else v for n, v in values.items()} | {"drive_gain": gain}

    def together(self, parameters: Mapping[str, Parameter]) -> ClosedLoopProblem:
        """Return the problem as one of all records; the gain of the drive may be free."""
        joint = self.problem.joint.parameters
        own = adjust_parameters(joint, self.layout.changes(parameters, self.number, acting=True))
        around = self.problem.parameters[len(joint) :]
        return replace(self.problem, parameters=(*own, *around)).freeing(*self.layout.free)

    def rows(self, gain: float) -> tuple[EstimatedParameter, ...]:
        """Return its estimate per unit torque, without the added inertia."""
        more, free = self.layout.added[self.number], self.problem.free
        acting, own = self.acting(self.values, gain), {p.name for p in self.problem.joint.parameters}
        told = {p.name: p for p in self.fit.params.rows if p.free and p.value is not None and p.stderr is not None}
        values = {p.name: acting[p.name] - more.get(p.name, 0.0) for p in free if p.name in told}
        std = {name: (gain if name in own else 1.0) * (told[name].stderr or 0.0) for name in values}
        return build_rows([p for p in free if p.name in told], values, std, self.layout.unit, own)

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Parameters that this record shows only together; see `find_separable`."""
        apart = find_separable(self.slopes)
        return tuple(p.name for p, separable in zip(self.problem.free, apart, strict=True) if not separable)


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


# All of them


def _build_result(problem: RecordsProblem, end: Solution, alone: Sequence[BySelf], simulations: int) -> Estimate:
    """Return the fit of all records."""
    layout, gain = problem.layout, problem.values(end.x).get("drive_gain", 1.0)
    judged, compared = _judge_together(problem, end, alone, gain), _compare(problem, alone, gain)
    covariance = compared.widen(judged.covariance, [p.name for p in problem.free])
    torques = [one.torque(problem.of_member(end.x, k)) for k, one in enumerate(problem.problems)]
    predicted = np.concatenate(torques)
    shares = tuple(_record_fit(problem, one, gain, torque) for one, torque in zip(alone, torques, strict=True))
    error = problem.filter(problem.measured - predicted)
    held = find_active_bounds(problem.free, end.x, end.residual, end.jacobian)
    said = (
        f"record {k}: {warning}"
        for k, one in enumerate(alone, 1)
        for warning in find_record_warnings(one.record, one.fit.data.channels)
    )
    repeats = [str(judged.repeatable)] if judged.repeatable.significant else []
    found = build_estimate(
        [one.record for one in alone],
        build_params(problem, end.x, covariance, held),
        (problem.measured, predicted),
        problem.filtered_error(error),
        error.size,
        (end.message, end.converged),
        simulations,
        Settings("didim", "DIDIM by least squares", problem.joint, layout.loops[0], problem.filtering),
        dict.fromkeys(name for share in shares for name in share.channels),
        Checks(agreement=compared, warnings=(*map(str, judged.warnings), *repeats, *said)),
    )
    return replace(found, data=replace(found.data, records=shares, torque_unit=layout.torque_unit))


def _judge_together(problem: RecordsProblem, end: Solution, alone: Sequence[BySelf], gain: float) -> Uncertainty:
    """Return the uncertainty before the records are compared.

    What moves a record's own solution moves the common one as far as the record weighs in it. Records may err alike or
    against each other, so the sizes add up.
    """
    J, moved = end.jacobian, np.zeros(end.x.size)
    runs = [one.simulate(problem.of_member(end.x, k)) for k, one in enumerate(problem.problems)]
    at = [one.kept for one in problem.problems]
    position, velocity = (
        np.concatenate([getattr(run, name)[rows] for run, rows in zip(runs, at, strict=True)])
        for name in ("motor_position", "motor_velocity")
    )
    rows = [one.size for one in at]
    influence = Influence(J, end.residual, series=rows)
    known = uncertainty(influence, cells(position, velocity))
    ends = np.cumsum(rows)[:-1]
    answers = np.split(influence.matrix, ends, axis=1)
    for k, (one, slopes, answer) in enumerate(zip(alone, np.split(J, ends), answers, strict=True)):
        steps = np.zeros_like(moved)
        for shift in one.fit.shifts:
            by = one.acting(dict(zip((p.name for p in one.problem.free), shift, strict=True)), gain)
            its = [by.get(p.name, 0.0) if p.name != "drive_gain" else 0.0 for p in problem.problems[k].free]
            steps = np.hypot(steps, answer @ (slopes[:, problem.places[k]] @ np.array(its)))
        moved += steps
    return known.widened_by(moved) if np.any(moved) else known


def _compare(problem: RecordsProblem, alone: Sequence[BySelf], gain: float) -> Agreement:
    """Test whether the estimates from single records agree.

    Per torque that acts, by the gain that was found. The inertia that tells the gain is not compared.
    """
    layout, each = problem.layout, list[Alone]()
    stated = {"drive_gain", *(name for more in layout.added for name in more)} if "drive_gain" in layout.free else set()
    units = {p.name: layout.unit(p) for p in problem.free if "@" not in p.name and p.name not in stated}
    for k, one in enumerate(alone):
        compared = units.keys() & {p.name for p in problem.of_record(k)} - {*one.inseparable}
        rows = [row for row in one.rows(gain) if row.name in compared and (row.stderr or 0.0) > 0]
        rows = [row for row in rows if one.fit.params[row.name].at_bound is None]
        values = {row.name: row.value or 0.0 for row in rows}
        # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
        std = np.array([max(row.stderr or 0.0, _ROUNDING * abs(row.value or 0.0)) for row in rows])
        each.append(Alone(values, Covariance(std, one.fit.params.correlation_of([*values]))))
    return compare_records(each, units)


def _record_fit(problem: RecordsProblem, one: BySelf, gain: float, torque: FloatArray) -> RecordFit:
    """Return the estimate from one record, and the fit of the common model, its torque (samples,), to it."""
    own = problem.problems[one.number]
    error = own.filter(own.measured - torque)
    errors = (
        relative_error(own.measured, torque, own.filtering.borders),
        own.filtered_error(error),
        own.filtered_error(one.residual),
    )
    return describe_record(problem, one.number, one.record, one.rows(gain), one.level, error.size, errors)


def describe_record(
    together: RecordsProblem,
    number: int,
    record: Record,
    alone: tuple[EstimatedParameter, ...],
    level: float,
    rows: int,
    errors: tuple[float, float, float],
) -> RecordFit:
    """Return one of several records.

    Args:
        together: the problem of all.
        number: of the record, from 0.
        record: itself.
        alone: what it says by itself.
        level: of its residual.
        rows: of its filtered torque.
        errors: of the common model, raw and filtered, and of the record by itself.
    """
    assert record.torque is not None
    return RecordFit(
        record.name,
        fingerprint(record.torque.values),
        list_loop_channels(together.layout.loops[number], record),
        sum(together.layout.added[number].values()),
        alone,
        level,
        rows,
        *errors,
        resampled=record.resampled,
    )
