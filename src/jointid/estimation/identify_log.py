"""Logs that are too long for memory: identified in windows, and tested for drift.

An ordinary identification of one window gives the start. Then least squares over all windows, each with a beginning of
its own (`problems.log_windows`), in two or three passes: time grows with the length of the record, memory with that of
a window. Noise that is averaged over a day leaves next to nothing, and what the model lacks stays: the deviations are
the larger, in every direction, of what leaving out windows says and what leaving out places says.

What a method does in windows is a `Windowed`; `windowed` has the models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import islice
from typing import NamedTuple, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Parameter
from jointid.common.text import join
from jointid.estimation.problems.log_windows import (
    NO_MOTION,
    LogProblem,
    Member,
    NotSimulatedError,
    Pieces,
    Seen,
    Solved,
    WindowModel,
    compress,
    places_of,
    sizes_of,
    stream,
)
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem, several
from jointid.estimation.result.agreement import Alone, drift
from jointid.estimation.result.build_result import (
    build_estimate,
    build_params,
    build_rows,
    find_active_bounds,
    list_loop_channels,
    warn_of_limit,
)
from jointid.estimation.result.estimate import Estimate, fingerprint, relative_error
from jointid.estimation.result.parts import Checks, Params, RecordFit, Windows
from jointid.estimation.result.verdict import negative_friction
from jointid.estimation.robots.simulated import IdentifiedRobot
from jointid.estimation.windowed import (
    model_of_windows,
    moves,
    travel,
)
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import Chunk, InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.identifiability import identifiability

_STARTS = 5  # windows that are tried to start from
_TRAVEL = 0.5  # of the most that one of them moves: those with less are tried last
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_GROUPS = 3  # for each parameter, parts of windows whose scatter tells the deviations
_COMPARED = 16  # windows at least in which the nominal robot is compared, where there are as many


class Windowed(NamedTuple):
    """A method, as it identifies a window by itself, of a model with changes to its parameters."""

    fit: Callable[[Sequence[Record], Progress], Estimate]
    model: object
    known: Mapping[str, Parameter]


class Start(NamedTuple):
    """A window by itself: its records, its fit, and the model of all windows with where the search starts."""

    records: Sequence[Record]
    fit: Estimate
    model: WindowModel
    x: FloatArray

    def look(self) -> Seen:
        """Return its rows."""
        seen = self.model.look(self.records, self.x)
        assert seen is not None
        return seen


def identify_log(
    logs: Sequence[Sequence[LongRecord]],
    each: Sequence[Windowed],
    loops: Sequence[ClosedLoop],
    filtering: Filtering,
    window: float,
    progress: Progress,
    layout: RecordLayout | None = None,
) -> Estimate:
    """Return the estimate of a joint or a robot from long logs, in bounded memory; see `jointid.identify`.

    Args:
        logs: of each axis.
        each: what is done with each log; one for all of a robot's.
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
    starts = [_start(_cut(log, length, overlap), one, progress) for log, one in zip(logs, each, strict=False)]
    first, warnings = starts[0], list[str]()
    keep = first.look().keep
    length = samples(window, math.lcm(keep, *periods))
    needed = max(keep * -(-one.model.settling(one.records, one.x) // keep) for one in starts)
    settling = min(needed, length // (2 * keep) * keep)
    progress(Detail(f"a window forgets how it began in {needed * sample_time:g} s"))
    if needed > settling:
        warnings.append(
            f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
        )
    pieces, names = (
        [partial(_cut, log) for log in logs],
        [join(list(dict.fromkeys(one.name for one in log))) for log in logs],
    )
    problem, x, together = pose(starts, pieces, names, layout)
    problem = replace(problem, length=length, settling=settling, progress=progress)
    if together is None:  # of a record in memory, with many parameters
        count = sum(1 for one in pieces for _ in one(length, 2 * settling, 1))
        problem = replace(problem, parts=max(math.ceil(_GROUPS * x.size / max(count, 1)), 1))
    solved = stream(problem, x)
    found, covariance = solved.found, solved.found.covariance()
    spans = [[w for w in found.windows if w.record == number] for number in range(len(logs))]
    units = {row.name: row.unit for row in first.fit.params.rows} if together is None else together.units
    changes = drift(found.windows, solved.x, problem.free, units, spans if len(spans) > 1 else None, problem.parts)
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    checks, shares = Checks(warnings=(*warnings, *warn_of_limit(at_limit))), list[RecordFit]()
    if layout is not None and together is not None:
        if changes is not None:
            checks = replace(checks, agreement=replace(changes, segments=()))
            covariance = changes.widen(covariance, [p.name for p in problem.free])
        for k, log in enumerate(logs):
            said = None if changes is None else changes.segments[k]
            std = np.array([] if said is None else [*said.std.values()], dtype=np.float64)
            alone = Alone({} if said is None else said.values, Covariance(std, np.eye(std.size)))
            shares.append(describe_record(together, k, cast("InMemory", log[0]).record, solved, alone))
    # Of what is searched for by its logarithm, the changes are none of the parameter.
    elif len(spans) == 1 and np.all(first.model.physical(solved.x)[1] == 1.0):
        checks = replace(checks, drift=changes)
    made = build_answer(first.fit, first.records, solved, covariance, together, shares, checks)
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


def pose(
    starts: Sequence[Start], pieces: Sequence[Pieces], names: Sequence[str], layout: RecordLayout | None
) -> tuple[LogProblem, FloatArray, RecordsProblem | None]:
    """Return the problem of logs, where its search starts, and the parameters of a joint's loops.

    Args:
        starts: of each log, or one of all.
        pieces: of each log.
        names: of each log.
        layout: of several records of a joint.
    """
    first, seen = starts[0], [one.look() for one in starts]
    models, whole = [one.model for one in starts] * (len(pieces) // len(starts)), np.arange(first.x.size)
    free, x, at, added = first.model.free, first.x, (whole,) * len(pieces), (np.zeros(whole.size),) * len(pieces)
    loops, together = [one.problem for one in models if one.problem is not None], None
    if loops:
        together = several(loops, layout or RecordLayout((loops[0].loop,), ({},), ((),)))
        free, x = together.free, together.join([one.x for one in starts])
        at, added = together.places, together.added
    members = tuple(map(Member, names, pieces, models, at, added))
    sigma = np.ones((len(pieces), len(seen[0].error)))
    weighted = sigma.size > 1 and (bool(loops) or first.fit.robot is not None)
    if weighted:  # but not a joint's inverse model: the equation of its load has no torque
        sigma[:] = sizes_of(seen)
    places = tuple(places_of(position, velocity) for position, velocity in seen[0].motion)
    return LogProblem(members, free, 1, 0, places, sigma, weighted), x, together


def _cut(log: Sequence[LongRecord], length: int, overlap: int, every: int = 1) -> Iterable[Sequence[Chunk]]:
    """Yield the windows of a log, a chunk for each axis."""
    return zip(*(source.chunks(length, overlap, every) for source in log), strict=False)


def _start(pieces: Iterable[Sequence[Chunk]], method: Windowed, progress: Progress) -> Start:
    """Return a window that identifies the system.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    refusal: RecordError | MethodError = MethodError(NO_MOTION)
    first = list(islice(filter(moves, ([one.record for one in piece] for piece in pieces)), _STARTS))
    enough = _TRAVEL * max(map(travel, first), default=0.0)
    for records in sorted(first, key=lambda one: travel(one) < enough):
        progress(f"starting from the window that begins at {records[0].begin:g} s")
        try:
            found = method.fit(records, progress)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.params.rows if p.of_joint and p.value is None]
        if not lost:
            return Start(records, found, *model_of_windows(method.model, records, found, method.known))
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal


# The answer, of windows and of several records


def build_answer(
    began: Estimate,
    records: Sequence[Record],
    solved: Solved,
    covariance: Covariance,
    together: RecordsProblem | None,
    shares: Sequence[RecordFit],
    checks: Checks,
) -> Estimate:
    """Return the estimate of all pieces.

    Args:
        began: the estimate of the first of them by itself.
        records: of which it is.
        solved: the solution.
        covariance: of the errors of x.
        together: the parameters of a joint's loops; None of another model.
        shares: several records.
        checks: what is known of the pieces.
    """
    problem, found, x = solved.problem, solved.found, solved.x
    model, errors, names = problem.members[0].model, found.relative_errors(), [p.name for p in problem.free]
    residual, slopes = compress(found.sums)
    held = find_active_bounds(problem.free, x, residual, slopes)
    settings, robot, axes = began.settings, began.robot, tuple[str, ...]()
    if together is not None:
        params, own = build_params(together, x, covariance, held), problem.members[0]
        loop = together.problems[0].loop_at(x[own.at] + own.added)
        delay = loop.controller.law(together.problems[0].sample_time).delay
        settings = replace(settings, loop=loop, delay=delay)
    else:
        values, slope = model.physical(x)
        covariance = replace(covariance, std=covariance.std * slope)
        params = _table(began.params, names, values, covariance, held)
    if robot is not None:
        axes, robot = robot.model.names, _robot(robot, model, solved, covariance)
        checks = replace(checks, verdicts=negative_friction(robot.driving))
    elif len(problem.members) == 1:
        units = {row.name: row.unit for row in params.rows}
        checks = replace(checks, known=identifiability(problem.free, units, x, slopes, covariance))
    raw = [seen.torques for seen in found.seen if seen.torques is not None]
    left, size, rows = found.sizes.sum(axis=(0, 1))
    made = build_estimate(
        records,
        params,
        (
            np.concatenate([np.zeros(0), *(one for one, _ in raw)]),
            np.concatenate([np.zeros(0), *(two for _, two in raw)]),
        ),
        float(np.sqrt(np.mean(errors**2))) if axes else math.sqrt(left / size),
        int(rows),
        (solved.stop, solved.converged),
        problem.tally.evaluations if began.fit.simulations else 0,
        settings,
        dict.fromkeys(name for share in shares for name in share.channels) or began.data.channels,
        checks,
    )
    data = replace(made.data, record=join([member.name for member in problem.members]), records=tuple(shares))
    if together is not None:
        data = replace(data, torque_unit=together.layout.torque_unit)
    fit = replace(made.fit, axis_errors=dict(zip(axes, map(float, errors), strict=False)))
    return replace(made, fit=fit, data=data, robot=robot, records=())


def describe_record(together: RecordsProblem, number: int, record: Record, solved: Solved, alone: Alone) -> RecordFit:
    """Return one of several records, numbered from 0.

    Args:
        together: the parameters of all.
        number: of the record.
        record: itself.
        solved: the solution of all.
        alone: what it says by itself.
    """
    assert record.torque is not None
    std = dict(zip(alone.values, map(float, alone.covariance.std), strict=True))
    told = [p for p in together.free if p.name in alone.values]
    square, size, rows = solved.found.sizes[number, 0]
    raw, borders = [seen.torques for seen in solved.found.seen], together.problems[number].filtering.borders
    torques = raw[number] if raw else None
    return RecordFit(
        record.name,
        fingerprint(record.torque.values),
        list_loop_channels(together.layout.loops[number], record),
        sum(together.layout.added[number].values()),
        build_rows(told, alone.values, std, together.layout.unit, {p.name for p in together.joint.parameters}),
        math.sqrt(square / max(rows, 1)),
        int(rows),
        math.nan if torques is None else relative_error(*torques, borders),
        math.sqrt(square / size) if size > 0 else 0.0,
    )


def _table(
    window: Params,
    names: Sequence[str],
    values: FloatArray,
    covariance: Covariance,
    held: Collection[str],
) -> Params:
    """Return the table of a window with the values of all; what a bound held in the window may be free in all."""
    found = {name: (float(x), float(std)) for name, x, std in zip(names, values, covariance.std, strict=True)}
    rows = tuple(
        replace(
            row, value=found[row.name][0], stderr=found[row.name][1], free=True,
            at_bound=found[row.name][0] if row.name in held else None,
        )
        if row.name in found and row.value is not None
        else row
        for row in window.rows
        if row.name in found or row.of_joint
    )  # fmt: skip
    return Params(rows, tuple(names), covariance.correlation)


def _robot(part: IdentifiedRobot, model: WindowModel, solved: Solved, covariance: Covariance) -> IdentifiedRobot:
    """Return the robot of a window with the values of all, and what the nominal one leaves in some of them."""
    at, values, nominal = (
        [part.names.index(p.name) for p in solved.problem.free],
        part.values.copy(),
        part.nominal.copy(),
    )
    values[at] = model.physical(solved.x)[0]
    std, correlation, errors = np.zeros(values.size), np.eye(values.size), np.full(len(part.model), np.inf)
    std[at], correlation[np.ix_(at, at)] = covariance.std, covariance.correlation
    assert model.nominal is not None
    x = model.nominal(solved.x, solved.found.sums)
    if model.searched is None:
        nominal[at] = x
    with suppress(NotSimulatedError):
        for every in (max(solved.found.count // _COMPARED, 1), 1):  # where all that are taken rest, all
            if (found := solved.problem.pass_over(x, every)).count:
                errors = found.relative_errors()
                break
    whole = Covariance(std, correlation)
    return replace(part, values=values, covariance=whole, nominal=nominal, nominal_errors=errors)
