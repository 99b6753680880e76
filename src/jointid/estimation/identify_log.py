"""A log that is too long for memory: identified in windows, and tested for drift.

An ordinary identification of one window gives the start. Then least squares over all windows, each with a beginning of
its own (`problems.log_windows`), in two or three passes: time grows with the length of the record, memory with that of
a window. Noise that is averaged over a day leaves next to nothing, and what the model lacks stays: unless the residual
is seen not to repeat with the motion (`repeats`), the deviations are the larger, in every direction, of what leaving
out windows says and what leaving out places says (`uncertainty.resampling`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Parameter, adjust_parameters
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Method, default_method
from jointid.estimation.problems.log_windows import (
    FEW,
    NO_MOTION,
    LogProblem,
    NotSimulatedError,
    Pass,
    Places,
    Windowing,
    compress,
    measure_settling,
    motion,
    moves,
    repeats,
    window_problem,
)
from jointid.estimation.result.agreement import drift
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import (
    build_params,
    find_active_bounds,
    find_lost,
    list_loop_channels,
    name_deviations,
    poor_fit,
    warn_of_bounds,
    warn_of_limit,
)
from jointid.estimation.result.parts import Checks, Data, Fit, Settings, Windows
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Solution, Status, Step, Watch, solve
from jointid.uncertainty.covariance import Covariance, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import Repeatable
from jointid.uncertainty.resampling import Sums, left_out, step_of

_STARTS = 5  # windows that are tried to start from
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_ROUNDING = 1e-6  # of the torque


def identify_log(
    source: LongRecord,
    loop: ClosedLoop,
    settings: Windowing,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    progress: Progress,
) -> FitResult:
    """Return the estimate of a joint from a long log, torque and reference only, in bounded memory.

    See `jointid.identify`. An interrupt of the last passes ends them, and the estimate is of what was read.
    """
    chosen = method or default_method(loop)()
    if not isinstance(chosen, DIDIM):
        raise MethodError("A long record is identified by simulating its loop; give the method didim.")
    if loop.joint.friction.follows_time:
        raise MethodError(
            f"{loop.joint.friction.name.capitalize()} friction changes with the time from the first sample, and each "
            'window would begin it anew; identify the record whole, or with friction = "symmetric", whose windows show '
            "the drift."
        )
    filtering, wanted = filtering or Filtering(), adjust_parameters(loop.joint.parameters, parameters or {})
    sample_time = source.sample_time
    keep = filtering.resolve(sample_time, loop.joint.model).decimation or 1

    def samples(seconds: float, unit: int = keep) -> int:  # whole rows, so that all windows keep the same samples
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # And whole periods of a controller that is slower than the log: the law's first is at a window's first sample.
    slower = Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
    length = samples(settings.length, math.lcm(keep, slower))
    settling = samples(settings.settling or settings.length / 20)
    moving = (piece.record for piece in source.chunks(length, 2 * settling) if moves(piece.record))
    record, known = _start(moving, loop, chosen, filtering, wanted, progress)
    window = window_problem(record, loop, filtering, wanted, chosen.free)
    start, warnings = window.vector(known), list[str]()
    if settings.settling is None:
        needed = samples(measure_settling(window, record, start) * sample_time)
        settling = min(needed, length // (2 * keep) * keep)
        progress(Detail(f"a window forgets how it began in {needed * sample_time:g} s"))
        if needed > settling:
            warnings.append(
                f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
            )
    problem = LogProblem(source, window, length, settling, Places.of(*motion(window)), progress)
    end = solve(problem, StreamingGaussNewton(), start)
    assert isinstance(end, LogSolution)
    return _answer(problem, record, end, warnings)


def _start(
    windows: Iterable[Record],
    loop: ClosedLoop,
    method: Method,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    progress: Progress,
) -> tuple[Record, dict[str, float]]:
    """Return a window that identifies the joint, and its values.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    changes = {p.name: p for p in parameters}
    refusal: RecordError | MethodError | None = None
    for record in islice(windows, _STARTS):
        progress(f"starting from the window that begins at {record.begin:g} s")
        try:
            found = identify_record(record, loop, method, filtering=filtering, parameters=changes, progress=progress)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.params.rows if p.of_joint and p.value is None]
        if not lost:
            return record, {p.name: p.value for p in found.params.rows if p.value is not None}
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal or MethodError(NO_MOTION)


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
    """The last pass that a step was taken from: where, over one window in how many, and the residual's mean square."""

    x: FloatArray
    every: int
    level: float
    found: Pass


@dataclass(frozen=True, slots=True)
class StreamingGaussNewton:
    """Gauss-Newton in as few passes over a log as there can be: a solver of `LogProblem`.

    A pass reads every window once, and keeps of each what `Sums` holds: memory does not grow with what is read but by a
    kilobyte for each window. Of the first passes one window in sixteen is enough, at a sixteenth of the cost: a start
    from one window is far off in the deviations of all of them. A pass over the whole that moves the parameters by less
    than 0.3 of their deviations is the last. `solvers.gauss_newton` has no such passes, and would read the log for each
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
            if every > 1 and len(found.windows) < FEW:
                every = 1
                continue
            sums = found.sums
            level = sums.square / sums.rows
            trace.append(Step(x, math.sqrt(sums.square), problem.tally.evaluations))
            watch(trace[-1])
            step = step_of(sums, bounds.shift_to(x))
            far = math.sqrt(float(step @ sums.A @ step) / level) if level > 0 else 0.0
            if not found.ended:
                stop = f"interrupted after {len(found.windows)} windows ({found.windows[-1].end / 3600:.3g} h)"
                return end(x + step, found.shift(step), Status.INTERRUPTED, stop, whole)
            # Where nothing is left, nothing is a deviation.
            if every == 1 and (far < self.tolerance or level <= _rounding(sums)):
                stop = f"the last pass moved the parameters by {far:.2g} deviations (limit {self.tolerance:g})"
                return end(x + step, found.shift(step), Status.STEP, f"converged: {stop}", whole)
            before, x = _Before(x, every, level, found), x + step
            problem.progress(Detail(f"{len(found.windows)} windows move the parameters by {far:.2g} deviations"))
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
        if every > 1 or len(found.windows) < FEW:
            raise KeyboardInterrupt
        return found
    if before is not None and before.every == every and found.windows:
        sums = found.sums
        return None if sums.square / sums.rows > max(before.level, _rounding(sums)) else found
    return found


def _answer(problem: LogProblem, first: Record, end: LogSolution, warnings: list[str]) -> FitResult:
    """Return the estimate that the last pass makes."""
    assert first.torque is not None
    found, window, sample_time = end.found, problem.window, problem.window.sample_time
    sums, unit = found.sums, first.torque.unit
    repeated = repeats(found.places.values(), sums.square, unit)
    covariance, intervals = _covariance(found, repeated)
    loop = window.loop_at(end.x)
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    held = find_active_bounds(problem.free, end.x, end.residual, end.jacobian)
    lost = find_lost(problem.free, end.x, covariance.std)
    std = name_deviations(window, covariance)
    return FitResult(
        params=build_params(window, end.x, std, covariance.correlation, intervals, lost, held, fixed=False),
        fit=Fit(
            measured=np.zeros(0),
            predicted=np.zeros(0),
            borders=(0, 0),
            relative_error=math.nan,
            rows=sums.rows,
            filtered_error=sums.relative_error,
            at_limit=at_limit,
            passes=end.passes,
            simulations=end.evaluations,
            stop=end.message,
            converged=end.converged,
            interrupted=not found.ended,
        ),
        checks=Checks(
            known=identifiability(problem.free, window.units, end.x, end.jacobian, covariance),
            repeatable=repeated,
            drift=drift(found.windows, end.x, problem.free, window.units),
            warnings=(*warnings, *warn_of_bounds(held), *warn_of_limit(at_limit), *poor_fit(sums.relative_error)),
        ),
        data=Data(
            torque_unit=unit,
            record=problem.source.name,
            channels=list_loop_channels(loop, first),
            sample_time=sample_time,
            windows=Windows(
                length=problem.length * sample_time,
                settling=problem.settling * sample_time,
                count=len(found.windows),
                still=found.still,
                duration=found.windows[-1].end - found.windows[0].begin,
            ),
        ),
        settings=Settings(
            "didim",
            "DIDIM in windows",
            system=window.joint,
            loop=loop,
            filtering=window.filtering,
            delay=loop.controller.law(sample_time).delay,
        ),
    )


def _covariance(found: Pass, repeated: Repeatable) -> tuple[Covariance, str]:
    """Return the covariance of the estimate, and what it is, in a sentence.

    Raises:
        MethodError: one window says nothing of how windows differ.
    """
    windows, places = [w.sums for w in found.windows], [p.sums for p in found.places.values()]
    if len(windows) < 2:
        raise MethodError(
            "A long record has two windows or more, in which the axis moves; this one has "
            f"{len(windows)}: give a shorter window, or use identify."
        )
    covariance, said = left_out(windows), f"from leaving out each of {len(windows)} windows"
    if (repeated.significant or repeated.p_value is None) and len(places) > 1:  # what cannot be excluded is covered
        covariance = larger(covariance, left_out(places))
        said += f", or each of {len(places)} places by direction and speed: the larger in every direction"
    return covariance, said
