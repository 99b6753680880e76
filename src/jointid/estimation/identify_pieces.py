"""Several records of a joint in one fit, and logs that are too long for memory: one problem over their pieces.

An ordinary identification gives the start: of each record by itself, or of one window of a log. Least squares over all
pieces follows (`problems.pieces`); where they differ in noise, length or cut-off, each log's rows are divided by the
level of its residual, and count for what they are worth.

**Records in memory** keep their rows. Those of different records do not err together in time; a place errs alike in all
of them, where anything repeats with the motion (`position_dependent_error`). What a record says alone is one
Gauss-Newton step from the common solution. Where the records disagree by more than their intervals allow, the answer
says so and widens what they share (`result.agreement`). What moves a record's own solution, beside noise
(`uncertainty_of_least_error`), moves the common one as far as the record weighs in it, and widens that.

**Windows** keep sums: time grows with the length of the record, memory with that of a window. Noise that is averaged
over a day leaves next to nothing, and what the model lacks stays: the deviations are the larger, in every direction, of
what leaving out windows says and what leaving out places says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import islice
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import join
from jointid.estimation.problems.base import adjust_parameters
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.pieces import (
    NO_MOTION,
    Log,
    Model,
    NotSimulatedError,
    Pieces,
    PiecesProblem,
    Seen,
    Solved,
    moves,
    places_of,
    sizes_of,
    stream,
    travel,
)
from jointid.estimation.problems.several_records import RecordLayout, SharedParameters, share_parameters
from jointid.estimation.result.agreement import Alone, compare_records, drift
from jointid.estimation.result.build_result import (
    build_estimate,
    build_rows,
    find_active_bounds,
    list_loop_channels,
    warn_of_limit,
)
from jointid.estimation.result.estimate import Estimate, fingerprint, relative_error
from jointid.estimation.result.parts import Checks, Params, RecordFit, Windows
from jointid.estimation.result.verdict import negative_friction
from jointid.estimation.robots.simulated import IdentifiedRobot, nominal_numbers
from jointid.estimation.windowed import loop_model, model_of_windows
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import Chunk, InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import RobotLoop
from jointid.solvers.solve import Tally
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.identifiability import find_separable, identifiability
from jointid.uncertainty.position_dependent_error import Cells, cells, uncertainty
from jointid.uncertainty.resampling import Sums, root_of, step_of

_ROUNDING = 1e-8  # of a value
_STARTS = 5  # windows that are tried to start from
_TRAVEL = 0.5  # of the most that one of them moves: those with less are tried last
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_GROUPS = 3  # for each parameter, parts of windows whose scatter tells the deviations
_COMPARED = 16  # windows at least in which the nominal robot is compared, where there are as many

FitPiece: TypeAlias = Callable[[Any, Sequence[Record], Mapping[str, Parameter], Progress], Estimate]
"""From a model, the records of a piece and changes to the parameters to the estimate of the piece by itself."""


class Start(NamedTuple):
    """A piece by itself: its records, its fit, and the model of all pieces with where the search starts."""

    records: Sequence[Record]
    fit: Estimate
    model: Model
    x: FloatArray

    def look(self) -> Seen:
        """Return its rows."""
        seen = self.model.look(self.records, self.x)
        assert seen is not None
        return seen


# Several records in memory


def identify_records(
    records: Sequence[Record],
    layout: RecordLayout,
    known: Mapping[str, Parameter],
    fit: FitPiece,
    progress: Progress,
) -> Estimate:
    """Return the fit of one joint to several records in one fit; see `jointid.identify`.

    Args:
        records: of the joint.
        layout: how they belong together.
        known: changes to its parameters.
        fit: what identifies a record by itself.
        progress: receives the steps.
    """
    alone = list[Estimate]()
    for k, (record, loop) in enumerate(zip(records, layout.loops, strict=True)):
        progress(f"record {k + 1}, {record.name}, by itself")
        alone.append(fit(loop, [record], layout.changes(known, k, acting=False), progress))
    own = [_solved(one)[0] for one in alone]
    values = fill_starts([_told(one) for one in alone], [p.name for p in own[0].parameters])
    gain, starts = _gain(layout, values), list[Start]()
    for k, (record, one, problem) in enumerate(zip(records, alone, own, strict=True)):
        joint = problem.joint.parameters
        shared = adjust_parameters(joint, layout.changes(known, k, acting=True))
        acting = replace(problem, parameters=(*shared, *problem.parameters[len(joint) :])).freeing(*layout.free)
        x = acting.vector(_act(values[k], layout, gain))
        starts.append(Start([record], one, loop_model(acting, whole=True), x))
    pieces = [partial(_whole, record) for record in records]
    posed, x, together = pose(starts, pieces, [record.name for record in records], layout)
    assert together is not None
    progress(f"{len(records)} records together, {x.size} parameters")
    simulated = Tally(sum(one.fit.simulations for one in alone) + len(records))
    solved = stream(replace(posed, kept=True, progress=progress, tally=simulated), x)
    progress(Detail(solved.stop))
    return _judge(together, solved, records, alone, gain)


def _whole(record: Record, *_: int) -> list[list[Chunk]]:
    """Return a record as its only piece."""
    return [[Chunk(0, record, last=True)]]


def _solved(fit: Estimate) -> tuple[ClosedLoopProblem, FloatArray]:
    assert fit.problem is not None and fit.x is not None
    return fit.problem, fit.x


def _told(fit: Estimate) -> dict[str, float]:
    """Return every parameter that a record tells by itself, by name, the fixed ones too."""
    (problem, x), told = _solved(fit), {p.name for p in fit.params.rows if p.value is not None}
    return {name: value for name, value in problem.values(x).items() if name in told}


def require_distinct(records: Sequence[Record]) -> None:
    """Raise a `MethodError` if a record is there twice."""
    seen: dict[str, int] = {}
    for number, record in enumerate(records, 1):
        mark = fingerprint(record.torque.values) if record.torque is not None else str(number)
        if mark in seen:
            raise MethodError(f"Records {seen[mark]} and {number} are the same: name another file.")
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


def _act(values: Mapping[str, float], layout: RecordLayout, gain: float) -> dict[str, float]:
    """Return values in terms of the acting torque, `gain` times the logged one."""
    own = {p.name for p in layout.joint.parameters}
    return {n: gain * v if n in own else v for n, v in values.items()} | {"drive_gain": gain}


def _gain(layout: RecordLayout, starts: Sequence[Mapping[str, float]]) -> float:
    """Return a start of the drive gain: the slope of the added values over those of separate fits."""
    name = next(iter(layout.gaining), None)
    if not layout.scales or name is None:
        return 1.0
    added = np.array([more.get(name, 0.0) for more in layout.added])
    found = np.array([values[name] for values in starts])
    change = found - found.mean()
    slope = float(change @ added) / (float(change @ change) or 1.0)
    return slope if slope > 0 else 1.0


def _judge(
    together: SharedParameters, solved: Solved, records: Sequence[Record], fits: Sequence[Estimate], gain: float
) -> Estimate:
    """Return the fit of all records, with what each says alone."""
    layout, x, found, sigma = together.layout, solved.x, solved.found, solved.problem.sigma[:, 0]
    seen, names = found.seen, [p.name for p in together.free]
    runs = [_loop_of(log.model).simulate(log.values(x)) for log in solved.problem.logs]
    where = [(run.motor_position[one.at], run.motor_velocity[one.at]) for run, one in zip(runs, seen, strict=True)]
    error = np.concatenate([one.error[0] / size for one, size in zip(seen, sigma, strict=True)])
    J = np.concatenate([one.J[0] / size for one, size in zip(seen, sigma, strict=True)])
    influence = Influence(J, error, series=[one.at.size for one in seen])
    known = uncertainty(influence, cells(*(np.concatenate(each) for each in zip(*where, strict=True))))
    gain = dict(zip(names, x, strict=True)).get("drive_gain", gain)
    answers = np.split(influence.matrix, np.cumsum([one.at.size for one in seen])[:-1], axis=1)
    alone, moved = list[Alone](), np.zeros(x.size)
    for k, (one, fit) in enumerate(zip(seen, fits, strict=True)):
        # The gain is not told by a record alone.
        at = [i for i in together.places[k] if names[i] != "drive_gain"]
        free, slopes = [together.free[i] for i in at], one.J[0][:, at]
        own = [p.name for p in _solved(fit)[0].free]
        shifts = [_act(dict(zip(own, shift, strict=True)), layout, gain) for shift in fit.shifts]
        steps = [np.array([by.get(p.name.partition("@")[0], 0.0) for p in free]) for by in shifts]
        # They may err alike, or against others.
        moved += np.sqrt(sum((answers[k] / sigma[k] @ slopes @ step) ** 2 for step in steps))
        alone.append(_step_alone(free, x[at], one.error[0], slopes, cells(*where[k]), steps))
    if np.any(moved):
        known = known.widened_by(moved)
    # The inertia that tells the gain is not compared.
    gained = layout.gaining if layout.scales else set()
    units = {p.name: layout.unit(p) for p in together.parameters if p.name not in gained}
    compared = compare_records(alone, units)
    shares = [
        _describe_record(
            together, k, record, solved, one.values, dict(zip(one.values, one.covariance.std, strict=True))
        )
        for k, (record, one) in enumerate(zip(records, alone, strict=True))
    ]
    repeats = [str(known.repeatable)] if known.repeatable.significant else []
    of_records = [f"record {k}: {said}" for k, fit in enumerate(fits, 1) for said in fit.checks.warnings]
    checks = Checks(agreement=compared, warnings=(*map(str, known.warnings), *repeats, *of_records))
    return _build_answer(fits[0], records, solved, compared.widen(known.covariance, names), together, shares, checks)


def _loop_of(model: Model) -> ClosedLoopProblem:
    assert model.problem is not None
    return model.problem


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


# Windows of long logs


def identify_windows(
    logs: Sequence[Sequence[LongRecord]],
    models: Sequence[tuple[Any, Mapping[str, Parameter]]],
    fit: FitPiece,
    loops: Sequence[ClosedLoop],
    filtering: Filtering,
    window: float,
    progress: Progress,
    layout: RecordLayout | None = None,
) -> Estimate:
    """Return the estimate of a joint or a robot from long logs, in bounded memory; see `jointid.identify`.

    Args:
        logs: of each axis.
        models: with changes to their parameters, of each log; one for all of a robot's.
        fit: what identifies a window by itself.
        loops: whose controllers are simulated.
        filtering: as far as it is known before a window is identified.
        window: s of a window.
        progress: receives the steps.
        layout: of several records of a joint.
    """
    sample_time = logs[0][0].sample_time
    periods = [
        Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
        for loop in loops
    ]

    def samples(seconds: float, unit: int) -> int:
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # Whole rows, so that all windows keep the same samples, and whole periods of a controller that is slower than the
    # log: the law's first is at a window's first sample.
    unit = math.lcm(filtering.resolve(sample_time).decimation or 1, *periods)
    length, overlap = samples(window, unit), 2 * samples(window / 20, unit)
    starts = [
        _start(_cut(log, length, overlap), model, known, fit, progress)
        for log, (model, known) in zip(logs, models, strict=False)
    ]
    first, warnings = starts[0], list[str]()
    keep = first.look().keep
    length = samples(window, math.lcm(keep, *periods))
    needed = max(keep * -(-one.model.settling(one.records, one.x) // keep) for one in starts)
    settling = min(needed, length // (2 * keep) * keep)
    forgets = f"a window forgets how it began in {needed * sample_time:g} s"
    progress(Detail(forgets))
    if needed > settling:
        warnings.append(f"{forgets}; give longer windows")
    names = [join(list(dict.fromkeys(one.name for one in log))) for log in logs]
    pieces = [partial(_cut, log) for log in logs]
    problem, x, together = pose(starts, pieces, names, layout)
    problem = replace(problem, length=length, settling=settling, progress=progress)
    if first.model.problem is None:  # of a record in memory, with many parameters
        count = sum(1 for one in pieces for _ in one(length, 2 * settling, 1))
        problem = replace(problem, parts=max(math.ceil(_GROUPS * x.size / max(count, 1)), 1))
    solved = stream(problem, x)
    found, covariance = solved.found, solved.found.covariance()
    spans = [[w for w in found.windows if w.record == number] for number in range(len(logs))]
    units = {row.name: row.unit for row in first.fit.params.rows}
    if together is not None:
        units = {p.name: together.layout.unit(p) for p in together.parameters}
    changes = drift(found.windows, solved.x, problem.free, units, spans if len(spans) > 1 else None, problem.parts)
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    checks, shares = Checks(warnings=(*warnings, *warn_of_limit(at_limit))), list[RecordFit]()
    if together is not None:
        if changes is not None:
            checks = replace(checks, agreement=replace(changes, segments=()))
            covariance = changes.widen(covariance, [p.name for p in problem.free])
        for k, (log,) in enumerate(logs):
            said, std = ({}, {}) if changes is None else (changes.segments[k].values, changes.segments[k].std)
            shares.append(_describe_record(together, k, cast("InMemory", log).record, solved, said, std))
    # Of what is searched for by its logarithm, the changes are none of the parameter.
    elif len(spans) == 1 and (first.fit.robot is None or not np.any(first.fit.robot.parameters.logarithmic)):
        checks = replace(checks, drift=changes)
    made = _build_answer(first.fit, first.records, solved, covariance, together, shares, checks)
    windows = Windows(
        length=length * sample_time,
        settling=settling * sample_time,
        count=found.count,
        still=found.still,
        duration=sum(span[-1].end - span[0].begin for span in spans if span),
    )
    return replace(
        made,
        fit=replace(made.fit, passes=solved.passes),
        data=replace(made.data, fingerprint="", resampled=None, windows=windows),
        settings=replace(made.settings, variant=f"{made.settings.variant}, in windows"),
        window=first.fit,
    )


def _cut(log: Sequence[LongRecord], length: int, overlap: int, every: int = 1) -> Iterable[Sequence[Chunk]]:
    """Yield the windows of a log, a chunk for each axis."""
    return zip(*(source.chunks(length, overlap, every) for source in log), strict=False)


def _start(
    pieces: Iterable[Sequence[Chunk]], model: Any, known: Mapping[str, Parameter], fit: FitPiece, progress: Progress
) -> Start:
    """Return a window that identifies the system.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    refusal: RecordError | MethodError = MethodError(NO_MOTION)
    first = list(islice(filter(moves, ([one.record for one in piece] for piece in pieces)), _STARTS))
    enough = _TRAVEL * max(map(travel, first), default=0.0)
    for records in sorted(first, key=lambda one: travel(one) < enough):
        progress(f"starting from the window that begins at {records[0].begin:g} s")
        # The first window of all begins as the model says, any other in motion.
        moving = isinstance(model, RobotLoop) and records[0].begin > 0
        try:
            found = fit(replace(model, in_motion=True) if moving else model, records, known, progress)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.params.rows if p.of_joint and p.value is None]
        if not lost:
            return Start(records, found, *model_of_windows(model, records, found))
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal


# The problem and the answer, of both


def pose(
    starts: Sequence[Start], pieces: Sequence[Pieces], names: Sequence[str], layout: RecordLayout | None
) -> tuple[PiecesProblem, FloatArray, SharedParameters | None]:
    """Return the problem of logs, where its search starts, and what several records of a joint share.

    Args:
        starts: of each log, or one of all.
        pieces: of each log.
        names: of each log.
        layout: of several records of a joint.
    """
    first, seen, together = starts[0], [one.look() for one in starts], None
    free, x = first.model.free, first.x
    at, added = [np.arange(x.size)] * len(pieces), [np.zeros(x.size)] * len(pieces)
    if layout is not None:
        together = share_parameters([_loop_of(one.model) for one in starts], layout)
        free, x = together.free, together.join([one.x for one in starts])
        at, added = list(together.places), list(together.added)
    models = [one.model for one in starts] * (len(pieces) // len(starts))
    sizes = np.array([sizes_of(one) for one in seen])
    problem = PiecesProblem(
        tuple(map(Log, names, pieces, models, at, added)),
        free,
        tuple(places_of(position, velocity) for position, velocity in seen[0].motion),
        np.ones((len(pieces), sizes.shape[1])),
        weighted=len(pieces) * sizes.shape[1] > 1,
    )
    return problem.weigh(sizes), x, together


def _build_answer(
    began: Estimate,
    records: Sequence[Record],
    solved: Solved,
    covariance: Covariance,
    together: SharedParameters | None,
    shares: Sequence[RecordFit],
    checks: Checks,
) -> Estimate:
    """Return the estimate of all pieces.

    Args:
        began: the estimate of the first of them by itself.
        records: of which it is.
        solved: the solution.
        covariance: of the errors of x.
        together: what several records of a joint share; None of one log, or of a robot.
        shares: several records.
        checks: what is known of the pieces.
    """
    problem, found, x, log = solved.problem, solved.found, solved.x, solved.problem.logs[0]
    errors, sums, settings, robot = found.relative_errors(), found.sums, began.settings, began.robot
    values, J = x, root_of(sums)
    if robot is not None:
        values = robot.parameters.values(x)
        slopes = np.where(robot.parameters.logarithmic, values, 1.0)
        covariance = replace(covariance, std=covariance.std * slopes)
    held, axes = find_active_bounds(problem.free, x, np.array([math.sqrt(sums.square)]), J), tuple[str, ...]()
    if together is None:
        params = _table(began.params, problem.free, values, covariance, held)
    else:
        params = together.table(x, covariance, held)
    if log.model.problem is not None:
        loop = log.model.problem.loop_at(log.values(x))
        delay = loop.controller.law(log.model.problem.sample_time).delay
        settings = replace(settings, loop=loop, delay=delay)
    if robot is not None:
        axes, robot = robot.model.names, _robot(robot, solved, values, covariance)
        checks = replace(checks, verdicts=negative_friction(robot.driving))
    elif len(problem.logs) == 1:
        units = {row.name: row.unit for row in params.rows}
        checks = replace(checks, known=identifiability(problem.free, units, x, J, covariance))
    raw = [np.zeros((2, 0)), *(np.array(seen.torques) for seen in found.seen if seen.torques is not None)]
    measured, predicted = np.concatenate(raw, axis=1)
    left, size, rows = found.sizes.sum(axis=(0, 1))
    made = build_estimate(
        records,
        params,
        (measured, predicted),
        float(np.sqrt(np.mean(errors**2))) if axes else math.sqrt(left / size),
        int(rows),
        (solved.stop, solved.converged),
        problem.tally.evaluations if began.fit.simulations else 0,
        settings,
        dict.fromkeys(name for share in shares for name in share.channels) or began.data.channels,
        checks,
    )
    data = replace(made.data, record=join([one.name for one in problem.logs]), records=tuple(shares))
    if together is not None:
        data = replace(data, torque_unit=together.layout.torque_unit)
    fit = replace(made.fit, axis_errors=dict(zip(axes, map(float, errors), strict=False)))
    return replace(made, fit=fit, data=data, robot=robot, records=())


def _describe_record(
    together: SharedParameters,
    number: int,
    record: Record,
    solved: Solved,
    values: Mapping[str, float],
    std: Mapping[str, float],
) -> RecordFit:
    """Return one of several records, numbered from 0.

    Args:
        together: the parameters of all.
        number: of the record.
        record: itself.
        solved: the solution of all.
        values: what it says by itself, by name.
        std: standard deviations of these.
    """
    assert record.torque is not None
    layout, torques, borders = together.layout, None, _loop_of(solved.problem.logs[number].model).filtering.borders
    if solved.found.seen:
        torques = solved.found.seen[number].torques
    told = [p for p in together.free if p.name in values]
    square, size, rows = solved.found.sizes[number, 0]
    return RecordFit(
        record.name,
        fingerprint(record.torque.values),
        list_loop_channels(layout.loops[number], record),
        sum(layout.added[number].values()),
        build_rows(told, values, std, layout.unit, {p.name for p in layout.joint.parameters}),
        math.sqrt(square / max(rows, 1)),
        int(rows),
        math.nan if torques is None else relative_error(*torques, borders),
        math.sqrt(square / size) if size > 0 else 0.0,
    )


def _table(
    window: Params, free: Sequence[Parameter], values: FloatArray, covariance: Covariance, held: Collection[str]
) -> Params:
    """Return the table of a window with the values of all; what a bound held in the window may be free in all."""
    at = {p.name: i for i, p in enumerate(free)}
    rows = list(window.rows)
    for k, row in enumerate(rows):
        if row.name in at and row.value is not None:
            value = float(values[at[row.name]])
            std, bound = float(covariance.std[at[row.name]]), value if row.name in held else None
            rows[k] = replace(row, value=value, stderr=std, free=True, at_bound=bound)
    kept = tuple(row for row in rows if row.name in at or row.of_joint)
    return Params(kept, tuple(at), covariance.correlation)


def _robot(part: IdentifiedRobot, solved: Solved, found: FloatArray, covariance: Covariance) -> IdentifiedRobot:
    """Return the robot of a window with the values of all, and what the nominal one leaves in some of them."""
    parameters, at = part.parameters, [part.names.index(p.name) for p in solved.problem.free]
    values, errors = part.values.copy(), np.full(len(part.model), np.inf)
    values[at] = found
    std, correlation = np.zeros(values.size), np.eye(values.size)
    std[at], correlation[np.ix_(at, at)] = covariance.std, covariance.correlation
    masses = parameters.group(nominal_numbers(part.model, parameters.numbers(found)))
    # What is of the record is as it was found.
    x = parameters.to_search_variables(np.where(parameters.of_robot, masses, found))
    with suppress(NotSimulatedError):
        for every in (max(solved.found.count // _COMPARED, 1), 1):  # where all that are taken rest, all
            if (one := solved.problem.pass_over(x, every)).count:
                errors = one.relative_errors()
                break
    return replace(part, values=values, covariance=Covariance(std, correlation), nominal_errors=errors)
