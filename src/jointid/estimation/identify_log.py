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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import islice
from typing import cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import join
from jointid.estimation.identify_several import describe_record
from jointid.estimation.problems.log_windows import (
    FEW,
    NO_MOTION,
    LogProblem,
    Member,
    NotSimulatedError,
    Pass,
    Places,
    Seen,
    Windowing,
    WindowModel,
    compress,
    moves,
    repeats,
    travel,
)
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem, several
from jointid.estimation.result.agreement import Segment, drift
from jointid.estimation.result.build_result import (
    build_params,
    build_rows,
    find_active_bounds,
    warn_of_limit,
)
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.judge import negative_friction
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, RecordFit, Windows
from jointid.estimation.windowed import LoopWindow, pose
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import Chunk, InMemory, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.resampling import Sums, left_out, scale_of, step_of

_STARTS = 5  # windows that are tried to start from
_TRAVEL = 0.5  # of the most that one of them moves: those with less are tried last
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
        model: of the joint or robot.
        filtering: as far as it is known before a window is identified.
        known: changes to the parameters.
    """

    fit: Callable[[Sequence[Record], Progress], Estimate]
    model: object
    filtering: Filtering
    known: Mapping[str, Parameter]

    @property
    def loops(self) -> Sequence[ClosedLoop]:
        """Of each axis whose controller is simulated."""
        if isinstance(self.model, RobotLoop):
            return self.model.loops
        return (self.model,) if isinstance(self.model, ClosedLoop) else ()


@dataclass(frozen=True, slots=True, eq=False)
class Start:
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


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The solution of all windows.

    Attributes:
        problem: of all, as the last pass weighed it.
        x: (free,) the estimate. found: by the last pass, as it is at the end.
        passes: over the whole log. stop: why the last ended. converged: whether that is a good end.
        covariance: of the errors of x.
        held: names of parameters at a bound.
        together: of several records, the sum of their problems; None of one.
    """

    problem: LogProblem
    x: FloatArray
    found: Pass
    passes: int
    stop: str
    converged: bool
    covariance: Covariance = field(default_factory=lambda: Covariance(np.zeros(0), np.zeros((0, 0))))
    held: tuple[str, ...] = ()
    together: RecordsProblem | None = None


def identify_log(
    logs: Sequence[Sequence[LongRecord]],
    each: Sequence[Windowed],
    settings: Windowing,
    progress: Progress,
    layout: RecordLayout | None = None,
) -> Estimate:
    """Return the estimate of a joint or a robot from long logs, in bounded memory; see `jointid.identify`.

    Args:
        logs: of each axis.
        each: what is done with each log; one for all of a robot's.
        settings: of the windows.
        progress: receives the steps.
        layout: of several records of a joint.
    """
    sample_time, method = logs[0][0].sample_time, each[0]
    periods = [
        Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
        for one in each
        for loop in one.loops
    ]

    def samples(seconds: float, unit: int) -> int:
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # Whole rows, so that all windows keep the same samples, and whole periods of a controller that is slower than the
    # log: the law's first is at a window's first sample.
    unit = math.lcm(method.filtering.resolve(sample_time).decimation or 1, *periods)
    length, overlap = samples(settings.length, unit), 2 * samples(settings.length / 20, unit)
    starts = [
        _start(zip(*(source.chunks(length, overlap) for source in log), strict=False), one, progress)
        for log, one in zip(logs, each, strict=False)
    ]
    warnings = list[str]()
    seen = starts[0].look()
    unit = math.lcm(seen.keep, *periods)
    length = samples(settings.length, unit)
    if settings.settling is not None:
        settling = samples(settings.settling, seen.keep)
    else:
        needed = max(samples(one.model.settling(one.records, one.x) * sample_time, seen.keep) for one in starts)
        settling = min(needed, length // (2 * seen.keep) * seen.keep)
        progress(Detail(f"a window forgets how it began in {needed * sample_time:g} s"))
        if needed > settling:
            warnings.append(
                f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
            )
    models = [starts[k if layout else 0].model for k in range(len(logs))]
    together: RecordsProblem | None = None
    free: tuple[Parameter, ...] = models[0].free
    x, at, added = starts[0].x, [np.arange(len(free), dtype=np.intp)] * len(logs), [np.zeros(len(free))] * len(logs)
    if layout is not None:
        together = several([one.problem for one in models if isinstance(one, LoopWindow)], layout)
        free, x = together.free, together.join([one.x for one in starts])
        at, added = list(together.places), list(together.added)
    parts = zip(logs, models, at, added, strict=True)
    members = tuple(Member(tuple(log), model, where, known) for log, model, where, known in parts)
    sigma = np.ones((len(logs), len(seen.error)))
    weighted = sigma.size > 1 and (isinstance(models[0], LoopWindow) or starts[0].fit.robot is not None)
    if weighted:  # but not a joint's inverse model: the equation of its load has no torque
        looks = [starts[k if layout else 0].look() for k in range(len(logs))]
        least = _ROUNDING * float(np.sqrt(np.mean(seen.measured**2)))
        sigma = np.array([np.maximum(np.sqrt(np.mean(one.error**2, axis=1)), least) for one in looks])
    divided = 1
    if not isinstance(models[0], LoopWindow):  # of a record in memory, with many parameters
        windows = sum(1 for member in members for _ in member.pieces(length, 2 * settling))
        divided = max(math.ceil(_GROUPS * x.size / max(windows, 1)), 1)
    places = tuple(Places.of(position, velocity) for position, velocity in seen.motion)
    problem = LogProblem(members, free, length, settling, places, sigma, weighted, divided, progress)
    return _answer(starts, replace(stream(problem, x), together=together), warnings)


def _start(pieces: Iterable[Sequence[Chunk]], method: Windowed, progress: Progress) -> Start:
    """Return a window that identifies the system.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    refusal: RecordError | MethodError | None = None
    moving = ([one.record for one in piece] for piece in pieces if any(moves(one.record) for one in piece))
    first = list(islice(moving, _STARTS))
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
            return Start(records, found, *pose(method.model, records, found, method.known))
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal or MethodError(NO_MOTION)


def stream(problem: LogProblem, start: FloatArray) -> Solved:
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
    before: tuple[FloatArray, int, Pass] | None = None
    for number in range(1, _PASSES + 1):
        found = _pass_unless_uphill(problem, x, every, before)
        whole += every == 1
        if found is None:
            assert before is not None
            x = 0.5 * (x + before[0])
            continue
        if every > 1 and found.count < FEW:
            every = 1
            continue
        sums = found.sums
        level = sums.square / sums.rows
        step = step_of(sums, bounds.shift_to(x))
        far = math.sqrt(float(step @ sums.A @ step) / level) if level > 0 else 0.0
        # Where nothing is left, nothing is a deviation.
        if every == 1 and (far < _SETTLED or level <= _rounding(sums)):
            stop = f"converged: the last pass moved the parameters by {far:.2g} deviations (limit {_SETTLED:g})"
            return Solved(problem, x + step, found.shift(step), whole, stop, True)
        before, x, problem = (x, every, found), x + step, problem.reweigh(found)
        problem.progress(Detail(f"{found.count} windows move the parameters by {far:.2g} deviations"))
        if number >= _SPARSE_PASSES or far < 1.0:
            every = 1
    assert before is not None
    stop = "not converged: the last passes led uphill, or still moved the parameters"
    return Solved(problem, before[0], before[2], whole, stop, False)


def _rounding(sums: Sums) -> float:
    """Return the mean square of a residual that is as good as none."""
    return _ROUNDING**2 * sums.size / sums.rows


def _pass_unless_uphill(
    problem: LogProblem, x: FloatArray, every: int, before: tuple[FloatArray, int, Pass] | None
) -> Pass | None:
    """Return a pass; None where a step led uphill, or to what cannot be simulated.

    Args:
        problem: of the log.
        x: its free parameters.
        every: one window in so many is read.
        before: where the last step was taken from, over one window in how many, and that pass.

    Raises:
        NotSimulatedError: a window cannot be simulated at the start.
    """
    try:
        found = problem.pass_over(x, every)
    except NotSimulatedError:
        if before is None:
            raise
        return None
    if before is None or before[1] != every or not found.windows:
        return found
    least = max(before[2].level(problem.sigma), _rounding(found.sums))
    return None if found.level(problem.sigma) > least else found


def _answer(starts: Sequence[Start], solved: Solved, warnings: list[str]) -> Estimate:
    """Return the estimate that the last pass makes."""
    problem, found, first, x = solved.problem, solved.found, starts[0], solved.x
    sums, torque, sample_time = found.sums, first.records[0].torque, problem.members[0].log[0].sample_time
    assert torque is not None
    repeated = repeats(found.places.values(), sums.square)
    covariance = _covariance(found, repeated)
    if any(member.model.motion_measured for member in problem.members):
        covariance = _widen_for_motion(covariance, found)
    of_rows = {row.name: row.unit for row in first.fit.params.rows}
    # A record's own parameter has the unit of the shared one.
    units = {p.name: of_rows[p.name.partition("@")[0]] for p in problem.free}
    spans = [[w for w in found.windows if w.record == number] for number in range(len(problem.members))]
    changes = drift(found.windows, x, problem.free, units, spans if len(spans) > 1 else None, problem.parts)
    segments = () if changes is None else changes.segments
    agreement = None if changes is None or solved.together is None else replace(changes, segments=())
    if agreement is not None:
        covariance = agreement.widen(covariance, [*units])
    residual, slopes = compress(sums)
    held = find_active_bounds(problem.free, x, residual, slopes)
    solved = replace(solved, covariance=covariance, held=held)
    told, errors = first.model.tell(first.fit, solved), found.relative_errors()
    records: tuple[RecordFit, ...] = ()
    if solved.together is not None:
        table = build_params(solved.together, x, covariance, held)
        told = replace(told, params=table)
        records = tuple(_tell_record(k, solved, segments) for k in range(len(starts)))
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    robot = told.robot
    names = [] if robot is None else robot.model.names
    axis_errors = dict(zip(names, map(float, errors), strict=False))
    # Of what is searched for by its logarithm, the changes are none of the parameter.
    plain = all(told.params[p.name].value == value for p, value in zip(problem.free, x, strict=True))
    return Estimate(
        params=told.params,
        fit=Fit(
            measured=np.zeros(0),
            predicted=np.zeros(0),
            borders=(0, 0),
            relative_error=math.nan,
            rows=int(found.sizes[..., 2].sum()),
            filtered_error=float(np.sqrt(np.mean(errors**2))) if names else float(found.total_error),
            passes=solved.passes,
            simulations=problem.tally.evaluations if first.fit.fit.simulations else 0,
            stop=solved.stop,
            converged=solved.converged,
            axis_errors=axis_errors,
        ),
        checks=Checks(
            verdicts=negative_friction(() if robot is None else robot.driving),
            known=None if names else identifiability(problem.free, units, x, slopes, covariance),
            repeatable=repeated if len(errors) == 1 and len(spans) == 1 else None,
            drift=changes if len(spans) == 1 and plain else None,
            agreement=agreement,
            warnings=(*warnings, *warn_of_limit(at_limit)),
        ),
        data=Data(
            record=join(list(dict.fromkeys(source.name for member in problem.members for source in member.log))),
            channels=first.fit.data.channels,
            sample_time=sample_time,
            torque_unit=first.fit.data.torque_unit,
            records=records,
            windows=Windows(
                length=problem.length * sample_time,
                settling=problem.settling * sample_time,
                count=found.count,
                still=found.still,
                duration=sum(span[-1].end - span[0].begin for span in spans if span),
            ),
        ),
        settings=told.settings,
        robot=robot,
        window=first.fit,
    )


def _tell_record(number: int, solved: Solved, segments: Sequence[Segment]) -> RecordFit:
    """Return one of several records, by a step of its windows from the common solution."""
    assert solved.together is not None
    together, source = solved.together, cast("InMemory", solved.problem.members[number].log[0])
    square, size, rows = solved.found.sizes[number, 0]
    alone: tuple[EstimatedParameter, ...] = ()
    if segments:
        said, own = segments[number], {p.name for p in together.joint.parameters}
        free = [p for p in together.of_record(number) if p.name in said.values]
        alone = build_rows(free, said.values, said.std, together.layout.unit, own)
    error = math.sqrt(square / size) if size > 0 else 0.0
    return describe_record(
        together, number, source.record, alone, math.sqrt(square / max(rows, 1)), int(rows), (math.nan, error, math.nan)
    )


def _widen_for_motion(covariance: Covariance, found: Pass) -> Covariance:
    """Widen the deviations along a measured motion for a force in the loop; see `Influence.widen_for_motion`."""
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
