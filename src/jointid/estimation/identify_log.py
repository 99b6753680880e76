"""Logs that are too long for memory: identified in windows, and tested for drift.

An ordinary identification of one window gives the start. Then least squares over all windows, each with a beginning of
its own (`problems.log_windows`), in two or three passes: time grows with the length of the record, memory with that of
a window. Noise that is averaged over a day leaves next to nothing, and what the model lacks stays: unless the residual
is seen not to repeat with the motion (`repeats`), the deviations are the larger, in every direction, of what leaving
out windows says and what leaving out places says (`uncertainty.resampling`).

What a method does in windows is a `Windowed`; `windowed` has them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import join
from jointid.estimation.problems.log_windows import (
    FEW,
    NO_MOTION,
    LogProblem,
    Member,
    NotSimulatedError,
    Pass,
    Places,
    Seen,
    Weighted,
    Windowing,
    WindowModel,
    compress,
    moves,
    repeats,
)
from jointid.estimation.problems.several_records import RecordsProblem
from jointid.estimation.result.agreement import Segment, drift
from jointid.estimation.result.build_result import find_active_bounds, find_lost, warn_of_limit
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.judge import negative_friction
from jointid.estimation.result.parts import Checks, Data, Fit, Params, RecordFit, Settings, Windows
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import Chunk, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import Covariance, covariance_of, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.resampling import Sums, left_out, scale_of, step_of

_STARTS = 5  # windows that are tried to start from
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_ROUNDING = 1e-6  # of the torque
_GROUPS = 3  # for each parameter, parts of windows whose scatter tells the deviations
_SPARSE, _SPARSE_PASSES = 16, 3  # of so many windows, one is read in a first pass; and such passes at most
_PASSES = 12  # at most
_SETTLED = 0.3  # deviations: a step of less is the last, which is taken, too; what is left after it is far less


@dataclass(frozen=True, slots=True, eq=False)
class Windowed:
    """A method, as it identifies in windows.

    Attributes:
        fit: a window by itself.
        pose: from a window and its fit to the model of all windows, and where its search starts.
        answer: what all windows say.
        filtering: as far as it is known before a window is identified.
        weighted: see `LogProblem`.
        loops: of each axis whose controller is simulated.
        together: of several records, from the start of each to the sum of their problems; None of one.
    """

    fit: Callable[[Sequence[Record], Progress], Estimate]
    pose: Callable[[Sequence[Record], Estimate], tuple[WindowModel, FloatArray]]
    answer: Callable[[Solved], Told]
    filtering: Filtering
    weighted: Weighted = "none"
    loops: Sequence[ClosedLoop] = ()
    together: Callable[[Sequence[Start]], RecordsProblem] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A window by itself: its records, its fit, and the model of all windows with where the search starts."""

    records: Sequence[Record]
    fit: Estimate
    model: WindowModel
    x: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The solution of all windows.

    Attributes:
        starts: of each log.
        problem: of all.
        x: (free,) the estimate. covariance: of its errors.
        lost: names of parameters that are not determined. held: of those at a bound.
        errors: (equations,) share of the filtered torque that is left.
        found: by the last pass. segments: what each of several records says by itself; of one record of its segments.
    """

    starts: Sequence[Start]
    problem: LogProblem
    x: FloatArray
    covariance: Covariance
    lost: tuple[str, ...]
    held: tuple[str, ...]
    errors: FloatArray
    found: Pass
    segments: Sequence[Segment]


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """The sums of all windows.

    Attributes:
        params, settings, robot, records: of the estimate.
        negative: joints of a robot whose friction comes out negative.
        by_logarithm: whether a parameter is searched for by its logarithm, whose changes are none of it.
    """

    params: Params
    settings: Settings
    robot: IdentifiedRobot | None = None
    records: tuple[RecordFit, ...] = ()
    negative: Sequence[str] = ()
    by_logarithm: bool = False


def identify_log(
    logs: Sequence[Sequence[LongRecord]], each: Sequence[Windowed], settings: Windowing, progress: Progress
) -> Estimate:
    """Return the estimate of a joint or a robot from long logs, in bounded memory.

    See `jointid.identify`. An interrupt of the last passes ends them, and the estimate is of what was read.

    Args:
        logs: of each axis.
        each: what is done with each log.
        settings: of the windows.
        progress: receives the steps.
    """
    sample_time = logs[0][0].sample_time
    periods = [
        Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
        for one in each
        for loop in one.loops
    ]

    def samples(seconds: float, unit: int) -> int:
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # Whole rows, so that all windows keep the same samples, and whole periods of a controller that is slower than the
    # log: the law's first is at a window's first sample.
    keep = each[0].filtering.resolve(sample_time).decimation or 1
    length, settling = samples(settings.length, math.lcm(keep, *periods)), samples(settings.length / 20, keep)
    starts = [
        _start(zip(*(source.chunks(length, 2 * settling) for source in log), strict=False), one, progress)
        for log, one in zip(logs, each, strict=True)
    ]
    warnings = list[str]()
    seen = _look(starts[0])
    keep = seen.keep
    length, settling = samples(settings.length, math.lcm(keep, *periods)), samples(settings.length / 20, keep)
    if settings.settling is not None:
        settling = samples(settings.settling, keep)
    else:
        needed = max(samples(one.model.settling(one.records, one.x) * sample_time, keep) for one in starts)
        settling = min(needed, length // (2 * keep) * keep)
        progress(Detail(f"a window forgets how it began in {needed * sample_time:g} s"))
        if needed > settling:
            warnings.append(
                f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
            )
    problem, x = _pose(logs, each[0], starts, seen, length, settling, progress)
    return _answer(each[0], starts, stream(problem, x), warnings)


def _start(pieces: Iterable[Sequence[Chunk]], method: Windowed, progress: Progress) -> Start:
    """Return a window that identifies the system.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    refusal: RecordError | MethodError | None = None
    moving = ([one.record for one in piece] for piece in pieces if any(moves(one.record) for one in piece))
    for records in islice(moving, _STARTS):
        progress(f"starting from the window that begins at {records[0].begin:g} s")
        try:
            found = method.fit(records, progress)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.params.rows if p.of_joint and p.value is None]
        if not lost:
            return Start(records, found, *method.pose(records, found))
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal or MethodError(NO_MOTION)


def _look(start: Start) -> Seen:
    """Return the rows of a window by itself."""
    seen = start.model.look(start.records, start.x)
    assert seen is not None
    return seen


def _pose(
    logs: Sequence[Sequence[LongRecord]],
    method: Windowed,
    starts: Sequence[Start],
    seen: Seen,
    length: int,
    settling: int,
    progress: Progress,
) -> tuple[LogProblem, FloatArray]:
    """Return the problem of all logs, and where its search starts."""
    models = [one.model for one in starts] if method.together else [starts[0].model] * len(logs)
    free: tuple[Parameter, ...] = models[0].free
    x, at, added = starts[0].x, [np.arange(len(free), dtype=np.intp)] * len(logs), [np.zeros(len(free))] * len(logs)
    if method.together is not None:
        whole = method.together(starts)
        free, x = whole.free, whole.join([one.x for one in starts])
        at, added = list(whole.places), list(whole.added)
    parts = zip(logs, models, at, added, strict=True)
    members = tuple(Member(tuple(log), model, where, known) for log, model, where, known in parts)
    weighted = method.weighted if len(logs) > 1 or len(seen.error) > 1 else "none"
    sigma = np.ones((len(logs), len(seen.error)))
    if weighted != "none":
        looks = [seen] * len(logs) if method.together is None else [_look(one) for one in starts]
        least = _ROUNDING * float(np.sqrt(np.mean(seen.measured**2)))
        sigma = np.array([np.maximum(np.sqrt(np.mean(one.error**2, axis=1)), least) for one in looks])
    divided = 1
    if method.weighted != "records":  # of a record in memory, with many parameters
        windows = sum(1 for member in members for _ in member.pieces(length, 2 * settling))
        divided = max(math.ceil(_GROUPS * x.size / max(windows, 1)), 1)
    places = tuple(Places.of(position, velocity) for position, velocity in seen.motion)
    return LogProblem(members, free, length, settling, places, sigma, weighted, divided, progress), x


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """The end of the passes over a log.

    Attributes:
        problem: as the last pass weighed it.
        x: (free,) the estimate.
        found: by the last pass, as it is at the end. passes: over the whole log.
        stop: why it ended. converged: whether that is a good end.
    """

    problem: LogProblem
    x: FloatArray
    found: Pass
    passes: int
    stop: str
    converged: bool


def stream(problem: LogProblem, start: FloatArray) -> Streamed:
    """Solve by Gauss-Newton in as few passes over a log as there can be.

    A pass reads every window once, and keeps of each what `Sums` holds: memory does not grow with what is read but by a
    kilobyte for each window. Of the first passes one window in sixteen is enough, at a sixteenth of the cost: a start
    from one window is far off in the deviations of all of them. A pass over the whole that moves the parameters by less
    than 0.3 of their deviations is the last. A solver of `solvers` has no such passes, and would read the log for each
    step that it halves and once more for its last.

    Raises:
        NotSimulatedError: a window cannot be simulated at the start.
        MethodError: in no window does the axis move.
    """
    bounds, x, every, whole = Bounds.of(problem.free), start, _SPARSE, 0
    before: _Before | None = None
    for number in range(1, _PASSES + 1):
        found = _pass_to_windows(problem, x, every, before)
        whole += every == 1
        if found is None:
            assert before is not None
            x = 0.5 * (x + before.x)
            continue
        if every > 1 and found.count < FEW:
            every = 1
            continue
        sums = found.sums
        level = sums.square / sums.rows
        step = step_of(sums, bounds.shift_to(x))
        far = math.sqrt(float(step @ sums.A @ step) / level) if level > 0 else 0.0
        if not found.ended:
            stop = f"interrupted after {found.count} windows ({found.windows[-1].end / 3600:.3g} h)"
            return Streamed(problem, x + step, found.shift(step), whole, stop, False)
        # Where nothing is left, nothing is a deviation.
        if every == 1 and (far < _SETTLED or level <= _rounding(sums)):
            stop = f"converged: the last pass moved the parameters by {far:.2g} deviations (limit {_SETTLED:g})"
            return Streamed(problem, x + step, found.shift(step), whole, stop, True)
        before, x, problem = _Before(x, every, found), x + step, problem.reweigh(found)
        problem.progress(Detail(f"{found.count} windows move the parameters by {far:.2g} deviations"))
        if number >= _SPARSE_PASSES or far < 1.0:
            every = 1
    assert before is not None
    stop = "not converged: the last passes led uphill, or still moved the parameters"
    return Streamed(problem, before.x, before.found, whole, stop, False)


@dataclass(frozen=True, slots=True, eq=False)
class _Before:
    """The last pass that a step was taken from: where, and over one window in how many."""

    x: FloatArray
    every: int
    found: Pass


def _rounding(sums: Sums) -> float:
    """Return the mean square of a residual that is as good as none."""
    return _ROUNDING**2 * sums.size / sums.rows


def _pass_to_windows(problem: LogProblem, x: FloatArray, every: int, before: _Before | None) -> Pass | None:
    """Return a pass; None where a step led uphill, or to what cannot be simulated.

    Raises:
        KeyboardInterrupt: it was interrupted, and says too little.
        NotSimulatedError: a window cannot be simulated at the start.
    """
    try:
        found = problem.pass_over(x, every)
    except NotSimulatedError:
        if before is None:
            raise
        return None
    if not found.ended:
        if every > 1 or found.count < FEW:
            raise KeyboardInterrupt
        return found
    if before is not None and before.every == every and found.windows:
        least = max(before.found.level(problem.sigma), _rounding(found.sums))
        return None if found.level(problem.sigma) > least else found
    return found


def _answer(method: Windowed, starts: Sequence[Start], end: Streamed, warnings: list[str]) -> Estimate:
    """Return the estimate that the last pass makes."""
    problem, found, first = end.problem, end.found, starts[0]
    sums, torque, sample_time = found.sums, first.records[0].torque, problem.members[0].log[0].sample_time
    assert torque is not None
    repeated = repeats(found.places.values(), sums.square, torque.unit)
    covariance = _covariance(found, repeated)
    if any(member.model.motion_measured for member in problem.members):
        covariance = _widen_for_motion(covariance, found)
    of_rows = {row.name: row.unit for row in first.fit.params.rows}
    # A record's own parameter has the unit of the shared one.
    units = {p.name: of_rows[p.name.partition("@")[0]] for p in problem.free}
    spans = [[w for w in found.windows if w.record == number] for number in range(len(problem.members))]
    changes = drift(found.windows, end.x, problem.free, units, spans if len(spans) > 1 else None, problem.parts)
    agreement = changes.agreement if len(spans) > 1 and len(found.sizes[0]) == 1 else None
    if agreement is not None:  # what records differ by is no noise of theirs
        more = {p.name: p.widening for p in agreement.parameters}
        covariance = covariance_of(covariance.matrix + np.diag([more.get(name, 0.0) for name in units]))
    residual, slopes = compress(sums)
    held = find_active_bounds(problem.free, end.x, residual, slopes)
    lost, errors = find_lost(problem.free, end.x, covariance.std), found.relative_errors()
    told = method.answer(Solved(starts, problem, end.x, covariance, lost, held, errors, found, changes.segments))
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    names = [] if told.robot is None else told.robot.model.names
    axis_errors = dict(zip(names, map(float, errors), strict=False))
    return Estimate(
        params=told.params,
        fit=Fit(
            measured=np.zeros(0),
            predicted=np.zeros(0),
            borders=(0, 0),
            relative_error=math.nan,
            rows=int(found.sizes[..., 2].sum()),
            filtered_error=float(np.sqrt(np.mean(errors**2))) if names else float(found.total_error),
            passes=end.passes,
            simulations=problem.tally.evaluations if first.model.simulates else 0,
            stop=end.stop,
            converged=end.converged,
            interrupted=not found.ended,
            axis_errors=axis_errors,
        ),
        checks=Checks(
            verdicts=negative_friction(told.negative),
            known=None if names else identifiability(problem.free, units, end.x, slopes, covariance),
            repeatable=repeated if len(errors) == 1 and len(spans) == 1 else None,
            drift=changes if len(spans) == 1 and not told.by_logarithm else None,
            agreement=agreement,
            warnings=(
                *warnings,
                *warn_of_limit(at_limit),
            ),
        ),
        data=Data(
            record=join(list(dict.fromkeys(source.name for member in problem.members for source in member.log))),
            channels=first.fit.data.channels,
            sample_time=sample_time,
            torque_unit=first.fit.data.torque_unit,
            records=told.records,
            windows=Windows(
                length=problem.length * sample_time,
                settling=problem.settling * sample_time,
                count=found.count,
                still=found.still,
                duration=sum(span[-1].end - span[0].begin for span in spans if span),
            ),
        ),
        settings=told.settings,
        robot=told.robot,
    )


def _widen_for_motion(covariance: Covariance, found: Pass) -> Covariance:
    """Widen the deviations along a measured motion for a force in the loop; see `with_measured_motion`."""
    scale = scale_of(found.sums.A)
    bias = np.linalg.pinv(found.sums.A / np.outer(scale, scale), hermitian=True) @ (found.scores / scale).T
    return replace(covariance, std=np.hypot(covariance.std, np.max(np.abs(bias), axis=1) / scale))


def _covariance(found: Pass, repeated: Repeatable) -> Covariance:
    """Return the covariance of the estimate.

    Raises:
        MethodError: one window says nothing of how windows differ.
    """
    parts, places = [w.sums for w in found.windows], [p.sums for p in found.places.values()]
    if found.count < 2:
        raise MethodError(
            "A long record has two windows or more, in which the axis moves; this one has "
            f"{found.count}: give a shorter window, or leave windows out."
        )
    covariance = left_out(parts)
    if (repeated.significant or repeated.p_value is None) and len(places) > 1:  # what cannot be excluded is covered
        covariance = larger(covariance, left_out(places))
    return covariance
