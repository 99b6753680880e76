"""Logs that are too long for memory: identified in windows, and tested for drift.

An ordinary identification of one window gives the start. Then least squares over all windows, each with a beginning of
its own (`problems.log_windows`), in two or three passes: time grows with the length of the record, memory with that of
a window. Noise that is averaged over a day leaves next to nothing, and what the model lacks stays: unless the residual
is seen not to repeat with the motion (`repeats`), the deviations are the larger, in every direction, of what leaving
out windows says and what leaving out places says (`uncertainty.resampling`).

What a method does in windows is a `Windowed`: DIDIM of a joint here, the inverse model of a joint and a robot
in `windowed`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from typing import Protocol

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter, adjust_parameters
from jointid.common.text import join
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Method, default_method
from jointid.estimation.problems.closed_loop import initial_of
from jointid.estimation.problems.log_windows import (
    FEW,
    NO_MOTION,
    InverseWindow,
    LogProblem,
    LoopWindow,
    Member,
    NotSimulatedError,
    Pass,
    Places,
    Seen,
    Weighted,
    Windowing,
    WindowModel,
    compress,
    measure_settling,
    moves,
    repeats,
    window_problem,
)
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem, several
from jointid.estimation.result.agreement import Segment, drift
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import (
    build_params,
    build_rows,
    find_active_bounds,
    find_lost,
    list_loop_channels,
    poor_fit,
    warn_of_bounds,
    warn_of_limit,
)
from jointid.estimation.result.estimate import fingerprint
from jointid.estimation.result.parts import Checks, Data, Fit, RecordFit, Settings, Windows
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import Chunk, InMemory, LongRecord, cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Solution, Status, Step, Watch, solve
from jointid.uncertainty.covariance import FOR_MEASURED_MOTION, Covariance, covariance_of, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.resampling import Sums, left_out, scale_of, step_of

_STARTS = 5  # windows that are tried to start from
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_ROUNDING = 1e-6  # of the torque
_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_TOLD = 1e-4  # of the torque: less is never told
_GROUPS = 3  # for each parameter, parts of windows whose scatter tells the deviations


class Windowed(Protocol):
    """A method, as it identifies in windows."""

    @property
    def loops(self) -> Sequence[ClosedLoop]:
        """Of each axis whose controller is simulated."""

    @property
    def filtering(self) -> Filtering:
        """As far as it is known before a window is identified."""

    @property
    def weighted(self) -> Weighted:
        """See `LogProblem`."""

    def fit(self, records: Sequence[Record], progress: Progress) -> FitResult:
        """Return the fit of one window by itself."""

    def pose(self, records: Sequence[Record], fit: FitResult) -> tuple[WindowModel, FloatArray]:
        """Return the model of all windows, and where its search starts."""

    def answer(self, solved: Solved) -> FitResult:
        """Return parameters, system and settings of the fit of all windows."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A window by itself: its records, its fit, and the model of all windows with where the search starts."""

    records: Sequence[Record]
    fit: FitResult
    model: WindowModel
    x: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The solution of all windows.

    Attributes:
        starts: of each log.
        problem: of all.
        x: (free,) the estimate. covariance: of its errors. basis: of that, in words.
        lost: names of parameters that are not determined. held: of those at a bound.
        errors: (equations,) share of the filtered torque that is left.
        found: by the last pass. segments: what each of several records says by itself; of one record of its segments.
        repeatable: what of the residual repeats with the motion.
        stop, converged: how the search ended.
    """

    starts: Sequence[Start]
    problem: LogProblem
    x: FloatArray
    covariance: Covariance
    basis: str
    lost: tuple[str, ...]
    held: tuple[str, ...]
    errors: FloatArray
    found: Pass
    segments: Sequence[Segment]
    repeatable: Repeatable
    stop: str
    converged: bool

    @property
    def deviations(self) -> dict[str, float]:
        """Of the free parameters, by name."""
        return dict(zip((p.name for p in self.problem.free), map(float, self.covariance.std), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class LoopWindows:
    """DIDIM of a joint in windows.

    Attributes:
        loop: joint and controller.
        method: how a window is identified.
        filtering: as declared.
        changes: to the parameters of a window.
        layout, own: of several records, of which this is one; None of one.
    """

    loop: ClosedLoop
    method: DIDIM
    filtering: Filtering
    changes: Mapping[str, Parameter]
    layout: RecordLayout | None = None
    own: Sequence[Sequence[str]] | None = None
    weighted: Weighted = "records"

    @classmethod
    def of(
        cls,
        loop: ClosedLoop,
        method: Method | None,
        filtering: Filtering | None,
        changes: Mapping[str, Parameter] | None,
    ) -> LoopWindows:
        """Return the windows of a record under this loop.

        Raises:
            MethodError: it is not identified in windows.
        """
        chosen = method or default_method(loop)()
        if not isinstance(chosen, DIDIM):
            raise MethodError("A long record is identified by simulating its loop; give the method didim.")
        if loop.joint.friction.follows_time:
            raise MethodError(
                f"{loop.joint.friction.name.capitalize()} friction changes with the time from the first sample, and "
                'each window would begin it anew; identify the record whole, or with friction = "symmetric", whose '
                "windows show the drift."
            )
        return cls(loop, chosen, filtering or Filtering(), changes or {})

    @classmethod
    def of_several(
        cls,
        layout: RecordLayout,
        own: Sequence[Sequence[str]] | None,
        method: Method | None,
        filtering: Filtering | None,
        parameters: Mapping[str, Parameter] | None,
    ) -> list[LoopWindows]:
        """Return the windows of each of several records.

        Raises:
            MethodError: they are not identified in windows.
        """
        if layout.free:
            raise MethodError(f"{join(layout.free)} of several records is identified from all rows at once.")
        changes = (layout.changes(parameters or {}, k, acting=True) for k in range(len(layout.loops)))
        each = (cls.of(loop, method, filtering, one) for loop, one in zip(layout.loops, changes, strict=True))
        return [replace(one, layout=layout, own=own) for one in each]

    @property
    def loops(self) -> Sequence[ClosedLoop]:
        """The one."""
        return (self.loop,)

    def fit(self, records: Sequence[Record], progress: Progress) -> FitResult:
        """Return the fit of a window."""
        return identify_record(
            records[0], self.loop, self.method, filtering=self.filtering, parameters=self.changes, progress=progress
        )

    def pose(self, records: Sequence[Record], fit: FitResult) -> tuple[WindowModel, FloatArray]:
        """Return the loop, and the values of a window."""
        wanted = adjust_parameters(self.loop.joint.parameters, self.changes)
        window = window_problem(records[0], self.loop, self.filtering, wanted, self.method.free)
        return LoopWindow(window), window.vector({p.name: p.value for p in fit.params.rows if p.value is not None})

    def answer(self, solved: Solved) -> FitResult:
        """Return parameters and settings."""
        each = [start.model.problem for start in solved.starts if isinstance(start.model, LoopWindow)]
        window, x = each[0], solved.x
        std = solved.deviations
        records: tuple[RecordFit, ...] = ()
        if self.layout is None:
            params = build_params(
                window, x, std, solved.covariance.correlation, solved.basis, solved.lost, solved.held, fixed=False
            )
        else:
            both = RecordsProblem.of(self.layout, several(each, self.own, self.layout.added))
            whole = build_params(both, x, std, solved.covariance.correlation, solved.basis, solved.lost, solved.held)
            rows = dict(zip([p.name for p in both.parameters], whole.rows, strict=True))
            own = tuple(tuple(rows[p.name] for p in both.of_record(k) if "@" in p.name) for k in range(len(each)))
            params = replace(whole, rows=tuple(row for name, row in rows.items() if "@" not in name), own=own)
            records = tuple(self._record(k, solved, both) for k in range(len(each)))
        loop = window.loop_at(x[solved.problem.members[0].at])
        first, sample_time = solved.starts[0].records[0], window.sample_time
        assert first.torque is not None
        return FitResult(
            params=params,
            fit=solved.starts[0].fit.fit,
            checks=Checks(),
            data=Data(
                record="",
                channels=list_loop_channels(loop, first),
                sample_time=sample_time,
                torque_unit=first.torque.unit,
                records=records,
            ),
            settings=Settings(
                "didim",
                "DIDIM in windows",
                system=window.joint,
                loop=loop,
                filtering=window.filtering,
                delay=loop.controller.law(sample_time).delay,
                weighting="" if self.layout is None else "each record's rows by the level of its residual",
            ),
        )

    def _record(self, number: int, solved: Solved, both: RecordsProblem) -> RecordFit:
        """Return one of several records."""
        assert self.layout is not None
        start, member = solved.starts[number], solved.problem.members[number]
        model, source = start.model, member.log[0]
        assert isinstance(model, LoopWindow) and isinstance(source, InMemory)
        record = source.record
        assert record.torque is not None
        own = model.problem.values(solved.x[member.at] + member.added)
        names = {p.name for p in self.loop.joint.parameters}
        said = solved.segments[number] if solved.segments else None
        square, size, rows = solved.found.sizes[number, 0]
        free = [p for p in both.of_record(number) if said is not None and p.name in said.values]
        alone = () if said is None else build_rows(free, said.values, said.std, self.layout.unit, names)
        return RecordFit(
            name=source.name,
            fingerprint=fingerprint(record.torque.values),
            loop=model.problem.loop,
            channels=list_loop_channels(model.problem.loop, record),
            added_inertia=sum(self.layout.added[number].values()),
            alone=alone,
            values={name: own[name] for name in names},
            initial=initial_of(own),
            level=math.sqrt(square / max(rows, 1)),
            repeatable=replace(solved.repeatable, rms=solved.problem.sigma[number, 0] * solved.repeatable.rms),
            sample_time=model.problem.sample_time,
            filtering=model.problem.filtering,
            rows=int(rows),
            measured=np.zeros(0),
            predicted=np.zeros(0),
            relative_error=math.nan,
            filtered_error=math.sqrt(square / size) if size > 0 else 0.0,
            alone_error=math.nan,
        )


def identify_log(
    logs: Sequence[Sequence[LongRecord]], each: Sequence[Windowed], settings: Windowing, progress: Progress
) -> FitResult:
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
        _start(Member.of(log, _NONE).pieces(length, 2 * settling), one, progress)
        for log, one in zip(logs, each, strict=True)
    ]
    known, warnings = starts[0], list[str]()
    seen = _look(known)
    keep = seen.keep
    length, settling = samples(settings.length, math.lcm(keep, *periods)), samples(settings.length / 20, keep)
    if settings.settling is not None:
        settling = samples(settings.settling, keep)
    else:
        needed = max(samples(_measure_settling(one) * sample_time, keep) for one in starts)
        settling = min(needed, length // (2 * keep) * keep)
        progress(Detail(f"a window forgets how it began in {needed * sample_time:g} s"))
        if needed > settling:
            warnings.append(
                f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
            )
    problem, x = _pose(logs, each, starts, seen, length, settling, progress)
    end = solve(problem, StreamingGaussNewton(), x)
    assert isinstance(end, LogSolution)
    return _answer(problem, each[0], starts, end, warnings)


@dataclass(frozen=True, slots=True)
class _Nothing:
    """A model before there is one."""

    free: tuple[Parameter, ...] = ()
    motion_measured: bool = False

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return None."""
        del records, x
        return None


_NONE = _Nothing()


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


def _measure_settling(start: Start) -> int:
    """Return how many samples a window takes to forget how it began, see `measure_settling`."""
    if isinstance(start.model, LoopWindow):
        return measure_settling(start.model.problem, start.records[0], start.x)
    if isinstance(start.model, InverseWindow):
        return start.model.ringing
    whole = _look(start)
    first = whole.samples // (4 * whole.keep) * whole.keep
    later = start.model.look([cut(record, first, whole.samples) for record in start.records], start.x)
    if later is None:
        return first
    return _settled_after(whole, later, first)


def _pose(
    logs: Sequence[Sequence[LongRecord]],
    each: Sequence[Windowed],
    starts: Sequence[Start],
    seen: Seen,
    length: int,
    settling: int,
    progress: Progress,
) -> tuple[LogProblem, FloatArray]:
    """Return the problem of all logs, and where its search starts."""
    free, x = starts[0].model.free, starts[0].x
    members = tuple(Member.of(log, starts[0].model) for log in logs)
    first = each[0]
    layout = first.layout if isinstance(first, LoopWindows) else None
    if layout is not None and isinstance(first, LoopWindows):
        models = [one.model for one in starts if isinstance(one.model, LoopWindow)]
        criterion = several([one.problem for one in models], first.own, layout.added)
        free, x = criterion.free, criterion.vector([one.x for one in starts])
        parts = zip(logs, models, criterion.places, criterion.added, strict=True)
        members = tuple(Member(tuple(log), model, at, added) for log, model, at, added in parts)
    weighted = each[0].weighted if len(logs) > 1 or len(seen.error) > 1 else "none"
    sigma = np.ones((len(logs), len(seen.error)))
    if weighted != "none":
        looks = [seen] * len(logs) if layout is None else [_look(one) for one in starts]
        least = _ROUNDING * float(np.sqrt(np.mean(seen.measured**2)))
        sigma = np.array([np.maximum(np.sqrt(np.mean(one.error**2, axis=1)), least) for one in looks])
    divided = 1
    if layout is None and not isinstance(starts[0].model, LoopWindow):  # of a record in memory, with many parameters
        windows = sum(1 for member in members for _ in member.pieces(length, 2 * settling))
        divided = max(math.ceil(_GROUPS * x.size / max(windows, 1)), 1)
    places = tuple(Places.of(position, velocity) for position, velocity in seen.motion)
    return LogProblem(members, free, length, settling, places, sigma, weighted, divided, progress), x


def _settled_after(whole: Seen, later: Seen, first: int) -> int:
    """Return the samples after which a window has forgotten how it began.

    Args:
        whole: of a window.
        later: of the same, but for its first samples.
        first: how many these are.
    """
    _, of_whole, of_later = np.intersect1d(whole.at - first, later.at, return_indices=True)
    apart = np.abs(whole.error[:, of_whole] - later.error[:, of_later])
    least = _TOLD * np.sqrt(np.mean(whole.measured**2, axis=1, keepdims=True))
    far = apart > np.maximum(_FORGOTTEN * np.max(apart, axis=1, keepdims=True), least)
    # What lies beside a window's end rings as long as what lies beside its beginning.
    rows = np.flatnonzero(np.any(far[:, later.at[of_later] < later.samples // 2], axis=0))
    return int(later.at[of_later][rows[-1]]) + later.keep if rows.size else later.keep


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LogSolution(Solution):
    """The end of the passes over a log; its residual and derivatives are in as few rows as have the same sums.

    Attributes:
        found: by the last pass, as it is at the end. passes: over the whole log.
    """

    found: Pass
    passes: int


@dataclass(frozen=True, slots=True, eq=False)
class _Before:
    """The last pass that a step was taken from: where, and over one window in how many."""

    x: FloatArray
    every: int
    found: Pass


@dataclass(frozen=True, slots=True)
class StreamingGaussNewton:
    """Gauss-Newton in as few passes over a log as there can be: a solver of `LogProblem`.

    A pass reads every window once, and keeps of each what `Sums` holds: memory does not grow with what is read but by a
    kilobyte for each window. Of the first passes one window in sixteen is enough, at a sixteenth of the cost: a start
    from one window is far off in the deviations of all of them. A pass over the whole that moves the parameters by less
    than 0.3 of their deviations is the last. A solver of `solvers` has no such passes, and would read the log for each
    step that it halves and once more for its last.

    Attributes:
        sparse: of so many windows, one is read in a first pass.
        sparse_passes, passes: at most.
        tolerance: of the last step, in deviations; it is taken, too, and what is left after it is far less.
    """

    sparse: int = 16
    sparse_passes: int = 3
    passes: int = 12
    tolerance: float = 0.3

    def solve(self, problem: LogProblem, start: FloatArray, watch: Watch) -> LogSolution:
        """Run the passes to their end.

        Raises:
            NotSimulatedError: a window cannot be simulated at the start.
            MethodError: in no window does the axis move.
        """
        bounds, trace, before_all = Bounds.of(problem.free), list[Step](), problem.tally.evaluations
        x, every, whole = start, self.sparse, 0
        before: _Before | None = None

        def end(x: FloatArray, found: Pass, status: Status, stop: str, passes: int) -> LogSolution:
            residual, J = compress(found.sums)
            used = problem.tally.evaluations - before_all
            return LogSolution(x, residual, J, status, stop, tuple(trace), used, found=found, passes=passes)

        for number in range(1, self.passes + 1):
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
            trace.append(Step(x, math.sqrt(sums.square), problem.tally.evaluations))
            watch(trace[-1])
            step = step_of(sums, bounds.shift_to(x))
            far = math.sqrt(float(step @ sums.A @ step) / level) if level > 0 else 0.0
            if not found.ended:
                stop = f"interrupted after {found.count} windows ({found.windows[-1].end / 3600:.3g} h)"
                return end(x + step, found.shift(step), Status.INTERRUPTED, stop, whole)
            # Where nothing is left, nothing is a deviation.
            if every == 1 and (far < self.tolerance or level <= _rounding(sums)):
                stop = f"the last pass moved the parameters by {far:.2g} deviations (limit {self.tolerance:g})"
                return end(x + step, found.shift(step), Status.STEP, f"converged: {stop}", whole)
            before, x, problem = _Before(x, every, found), x + step, problem.reweigh(found)
            problem.progress(Detail(f"{found.count} windows move the parameters by {far:.2g} deviations"))
            if number >= self.sparse_passes or far < 1.0:
                every = 1
        assert before is not None
        stop = "not converged: the last passes led uphill, or still moved the parameters"
        return end(before.x, before.found, Status.EVALUATION_LIMIT, stop, whole)


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


def _answer(
    problem: LogProblem, method: Windowed, starts: Sequence[Start], end: LogSolution, warnings: list[str]
) -> FitResult:
    """Return the estimate that the last pass makes."""
    first, found, sample_time = starts[0], end.found, problem.members[0].log[0].sample_time
    sums, torque = found.sums, first.records[0].torque
    assert torque is not None
    repeated = repeats(found.places.values(), sums.square, torque.unit)
    covariance, basis = _covariance(found, repeated)
    if any(member.model.motion_measured for member in problem.members):
        covariance, basis = _widen_for_motion(covariance, found), f"{basis}{FOR_MEASURED_MOTION}"
    of_rows = {row.name: row.unit for row in starts[0].fit.params.rows}
    # A record's own parameter has the unit of the shared one.
    units = {p.name: of_rows[p.name.partition("@")[0]] for p in problem.free}
    spans = [[w for w in found.windows if w.record == number] for number in range(len(problem.members))]
    changes = drift(found.windows, end.x, problem.free, units, spans if len(spans) > 1 else None, problem.parts)
    agreement = changes.agreement if len(spans) > 1 and len(found.sizes[0]) == 1 else None
    if agreement is not None:  # what records differ by is no noise of theirs
        more = {p.name: p.widening for p in agreement.parameters}
        covariance = covariance_of(covariance.matrix + np.diag([more.get(name, 0.0) for name in units]), 0)
    held = find_active_bounds(problem.free, end.x, end.residual, end.jacobian)
    lost, errors = find_lost(problem.free, end.x, covariance.std), found.relative_errors()
    solved = Solved(
        starts, problem, end.x, covariance, basis, lost, held, errors,
        found, changes.segments, repeated, end.message, end.converged,
    )  # fmt: skip
    made = method.answer(solved)
    # The changes of what is searched for by its logarithm are none of the parameter.
    by_logarithm = isinstance(made.robot, SimulatedRobot) and bool(np.any(made.robot.parameters.logarithmic))
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    names = [] if made.robot is None else made.robot.model.names
    error = float(np.sqrt(np.mean(errors**2))) if names else float(found.total_error)
    known = identifiability(problem.free, units, end.x, end.jacobian, covariance)
    return replace(
        made,
        fit=Fit(
            measured=np.zeros(0),
            predicted=np.zeros(0),
            borders=(0, 0),
            relative_error=math.nan,
            rows=int(found.sizes[..., 2].sum()),
            filtered_error=error,
            at_limit=at_limit,
            passes=end.passes,
            simulations=0 if isinstance(first.model, InverseWindow) else end.evaluations,
            stop=end.message,
            converged=end.converged,
            interrupted=not found.ended,
            axis_errors=dict(zip(names, map(float, errors), strict=False)),
        ),
        checks=replace(
            made.checks,
            known=None if names else known,
            repeatable=repeated if len(errors) == 1 and len(spans) == 1 else None,
            drift=changes if len(spans) == 1 and not by_logarithm else None,
            agreement=agreement,
            warnings=(
                *([str(agreement)] if agreement is not None and agreement.differs else []),
                *(one for one in made.checks.warnings if one not in poor_fit(first.fit.fit.filtered_error)),
                *warnings,
                *warn_of_bounds(held),
                *warn_of_limit(at_limit),
                *poor_fit(error),
            ),
        ),
        data=replace(
            made.data,
            fingerprint="",
            logs=(),
            record=join(list(dict.fromkeys(source.name for member in problem.members for source in member.log))),
            sample_time=sample_time,
            windows=Windows(
                length=problem.length * sample_time,
                settling=problem.settling * sample_time,
                count=found.count,
                still=found.still,
                duration=sum(span[-1].end - span[0].begin for span in spans if span),
            ),
        ),
        problem=None, x=None, record=None, solved=None,
    )  # fmt: skip


def _widen_for_motion(covariance: Covariance, found: Pass) -> Covariance:
    """Widen the deviations along a measured motion for a force in the loop; see `with_measured_motion`."""
    scale = scale_of(found.sums.A)
    bias = np.linalg.pinv(found.sums.A / np.outer(scale, scale), hermitian=True) @ (found.scores / scale).T
    return replace(covariance, std=np.hypot(covariance.std, np.max(np.abs(bias), axis=1) / scale))


def _covariance(found: Pass, repeated: Repeatable) -> tuple[Covariance, str]:
    """Return the covariance of the estimate, and what it is, in a sentence.

    Raises:
        MethodError: one window says nothing of how windows differ.
    """
    parts, places = [w.sums for w in found.windows], [p.sums for p in found.places.values()]
    if found.count < 2:
        raise MethodError(
            "A long record has two windows or more, in which the axis moves; this one has "
            f"{found.count}: give a shorter window, or leave windows out."
        )
    divided = "" if len(parts) == found.count else f"{len(parts)} parts of "
    covariance, said = left_out(parts), f"from leaving out each of {divided}{found.count} windows"
    if (repeated.significant or repeated.p_value is None) and len(places) > 1:  # what cannot be excluded is covered
        covariance = larger(covariance, left_out(places))
        said += f", or each of {len(places)} places by direction and speed: the larger in every direction"
    return covariance, said
