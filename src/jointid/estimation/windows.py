"""A log of a joint that is too long for memory: its loop, simulated in windows of which sums are kept.

An ordinary identification of one window gives the start. Least squares over all windows follows: a pass reads every
window once and keeps of each what `Sums` holds, so that time grows with the length of the record, and memory by a
kilobyte for each window.

A window begins in the middle of a motion. It begins where the law, turned round, puts the motor for the torque that was
logged, at the speed of the reference; what of that is wrong the loop forgets within the settling time, of which nothing
is counted, at either end: the zero-phase filter looks both ways. Neighbouring windows overlap by twice the settling
time, so that the rows that count follow each other without a gap.

Noise that is averaged over a day leaves next to nothing, and what the model lacks stays. What every visit to a place
errs alike no longer record averages away: sums are kept of each place, too. The deviations are the larger, in every
direction, of what leaving out windows says and what leaving out places says (`uncertainty.resampling`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress, follow
from jointid.common.parameters import Bounds, Parameter
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.estimation.result.agreement import Window, drift
from jointid.estimation.result.estimate import Estimate, Windows, build_estimate, rows_of_problem, warn_of_limit
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop
from jointid.records.chunks import LongRecord
from jointid.records.record import Record
from jointid.simulation.controller_torque import seen_position
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome
from jointid.solvers.solve import LevenbergMarquardt, Step, damped_step, solve
from jointid.uncertainty.covariance import Covariance, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import cells
from jointid.uncertainty.resampling import Sums, left_out, rows_of, total

_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_RINGS = 10.0  # periods of its cut-off that the zero-phase filter rings
_PLACES = 6  # stretches of the travel: what a place errs, its neighbourhood errs alike (`position_dependent_error`)
_AROUND = 64  # stretches after which places are taken to come again: an axis may turn for ever
_RESTING = 0.02  # of the largest speed: below it a row has no direction
_STARTS = 5  # windows that are tried to start from
_TRAVEL = 0.5  # of the most that one of them moves: those with less are tried last
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_PASSES = 12  # at most
_WORTH = 0.1  # of the noise of a row, squared: a step that promises less moves no parameter by a third of a deviation
_ROUNDING = 1e-6  # of the torque: a residual as good as none

NO_MOTION = "In no window of this record does the axis move; give another record."

Places: TypeAlias = Callable[[FloatArray, FloatArray], NDArray[np.intp]]
"""From positions and velocities, (rows,) each, to the number of each row's stretch of the travel, (rows,)."""

FitRecord: TypeAlias = Callable[[ClosedLoop, Record, Mapping[str, Parameter]], Estimate]
"""From a loop, a record and changes to the parameters to the estimate of the record."""


def places_of(position: FloatArray, velocity: FloatArray) -> Places:
    """Return stretches of the travel, by direction and class of speed, of the motion in one window, (samples,) each."""
    speeds = cells(position, velocity).speeds
    origin, width = float(position.min()), (float(np.ptp(position)) or 1.0) / _PLACES
    resting = _RESTING * float(np.max(np.abs(velocity)))

    def label(position: FloatArray, velocity: FloatArray) -> NDArray[np.intp]:
        moving = np.abs(velocity) > resting
        kind = np.argmin(np.abs(np.abs(velocity)[:, np.newaxis] - speeds), axis=1)
        family = np.where(moving, np.sign(velocity), 0.0).astype(np.intp) + 1
        place = np.floor((position - origin) / width).astype(np.intp) % _AROUND
        return np.asarray((family * speeds.size + np.where(moving, kind, 0)) * _AROUND + place, dtype=np.intp)

    return label


def travel(record: Record) -> float:
    """Return how far the axis is asked to move in a window, or what is injected varies, in sum."""
    asked = record.motor_position if record.reference is None else record.reference
    asked = asked if record.injected is None else record.injected.channel
    return 0.0 if asked is None else float(np.sum(np.abs(np.diff(asked.values))))


def moves(record: Record) -> bool:
    """Test whether a window has a motion or something injected, and no brake that holds the joint at a torque of 0."""
    braked = record.torque is not None and not np.any(record.torque.values)
    return not braked and (travel(record) > 0 or record.injected is not None)


def begin_window(like: ClosedLoopProblem, record: Record, disturbed: float = 0.0) -> ClosedLoopProblem:
    """Return the problem of a window that is like another one's, with its own state at the first sample.

    Args:
        like: the problem of another window.
        record: the window.
        disturbed: by how much its beginning is to be wrong, as a share of the window's torque and speed.
    """
    assert record.torque is not None
    experiment = prepare(like.loop, record)
    measured = record.torque.values[: experiment.clock.samples]
    problem = like.with_log(measured=measured[:, np.newaxis], experiment=experiment, seen=(None,))
    # What an integral holds is one constant along the log, and no window's own.
    seen = None if experiment.axis.law.integrates else seen_position(record, like.loop)
    torque = float(problem.filter(measured)[0])  # a single sample has all of the noise
    inputs, period = experiment.axis.inputs, experiment.axis.law.period
    velocity = float(inputs[1, REFERENCE] - inputs[0, REFERENCE]) / period
    torque += disturbed * float(np.std(measured))
    velocity += disturbed * float(np.std(np.diff(inputs[:, REFERENCE]))) / period
    position = beginning_position(problem, velocity, torque)
    if seen is not None and record.motor_position is not None:
        shown = seen.torque(record.motor_position.values)[: experiment.clock.samples]
        problem = problem.with_log(seen=(seen,), measured=shown[:, np.newaxis])
    return problem.keeping({"initial_position": position, "initial_velocity": velocity, "initial_torque": torque})


def settling(like: ClosedLoopProblem, record: Record, x: FloatArray) -> int:
    """Return how many samples a window takes to forget how it began.

    A beginning that is off by the window's whole torque and speed, as no window's is, must show in no later sample of
    the torque by more than a hundredth; the filter looks at what lies beside a window.
    """
    other = begin_window(like, record, disturbed=1.0)
    apart = np.abs(like.torque(x) - other.torque(x)) > _FORGOTTEN * float(np.std(like.measured))
    remembers = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    assert like.filtering.cutoff is not None
    return remembers + math.ceil(_RINGS / (like.filtering.cutoff * like.sample_time))


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """Sums of one pass over the windows.

    Attributes:
        windows: in the order of time. places: over all of them, by the place's number.
        still: windows in which nothing was asked of the axis, and which are left out.
        stopped: what stopped the simulation of a window, in a sentence; empty where none was.
    """

    windows: tuple[Window, ...]
    places: Mapping[int, Sums]
    still: int
    stopped: str

    @property
    def sums(self) -> Sums:
        """Over all windows.

        Raises:
            MethodError: there is none, because in no window does the axis move.
        """
        if not self.windows:
            raise MethodError(NO_MOTION)
        return total([w.sums for w in self.windows])

    def shift(self, step: FloatArray) -> Pass:
        """Return the pass after a small step of the parameters, to first order."""
        windows = tuple(replace(w, sums=w.sums.shift(step)) for w in self.windows)
        return replace(self, windows=windows, places={at: sums.shift(step) for at, sums in self.places.items()})

    def covariance(self) -> Covariance:
        """Return the covariance of the estimate: the larger of leaving out windows, and of leaving out places.

        Raises:
            MethodError: one window says nothing of how windows differ.
        """
        if len(self.windows) < 2:
            raise MethodError(
                "A long record has two windows or more, in which the axis moves; this one has "
                f"{len(self.windows)}: give a shorter window, or leave windows out."
            )
        found = left_out([w.sums for w in self.windows])
        return larger(found, left_out([*self.places.values()])) if len(self.places) > 1 else found


@dataclass(frozen=True, slots=True, eq=False)
class WindowsProblem:
    """The windows of a log against the loop of a joint: a problem of `solvers.solve`, of as few rows as there can be.

    Attributes:
        like: the problem of the window that the search starts from.
        log: that is read.
        places: that repeat.
        length: samples that count in a window.
        settling: samples at either end of a window that are simulated and not counted.
        progress: receives the progress of a pass.
        passes: that were made, by their candidates.
    """

    like: ClosedLoopProblem
    log: LongRecord
    places: Places
    length: int
    settling: int
    progress: Progress
    passes: dict[bytes, Pass] = field(default_factory=dict)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return self.like.free

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rows with the sums of all windows: residual, (rows,), and derivatives, (rows, free)."""
        return rows_of(self.pass_over(x).sums)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual of these rows, (rows,)."""
        return self.linearise(x)[0]

    def pass_over(self, x: FloatArray) -> Pass:
        """Return the sums at a candidate, from a pass over all windows."""
        if (key := x.tobytes()) not in self.passes:
            self.passes[key] = self._pass_over(x)
        return self.passes[key]

    def _pass_over(self, x: FloatArray) -> Pass:
        windows, places, still, stopped = list[Window](), dict[int, Sums](), 0, ""
        chunks = self.log.chunks(self.length, 2 * self.settling)
        for chunk in follow(chunks, self.progress, "passing over the log", math.inf, "windows"):
            record = chunk.record
            try:
                if not moves(record):
                    still += 1
                    continue
                problem = begin_window(self.like, record)
                torque, run, slopes = problem.sensitivities(x)
                error, columns = problem.filter(problem.measured - torque), problem.filter(slopes)
            except RecordError:
                if not (chunk.number and chunk.last):  # a last one may be too short for filters
                    raise
                continue
            if run.outcome is not Outcome.FINISHED:
                stopped = f"the window that begins at {record.begin:.0f} s cannot be simulated, {run.outcome.value}"
            at, size = problem.kept, problem.measured.size
            counted = (at >= self.settling) & (at < size - self.settling)
            if not counted.any():
                continue
            at, keep = at[counted], problem.filtering.decimation or 1
            rows = error[counted], -columns[counted], problem.filter(problem.measured)[counted]
            label = self.places(*(one[at] for one in _commanded(problem)))
            for place in map(int, np.unique(label)):
                sums = Sums.of(*(one[label == place] for one in rows))
                places[place] = places[place] + sums if place in places else sums
            begin, end = (record.begin + one * problem.sample_time for one in (at[0], at[-1] + keep))
            windows.append(Window(begin, end, Sums.of(*rows), run.at_limit))
        return Pass(tuple(windows), places, still, stopped)


def _commanded(problem: ClosedLoopProblem) -> tuple[FloatArray, FloatArray]:
    """Return the reference of a window and its velocity, (samples,) each."""
    axis, clock = problem.axis, problem.log.experiment.clock
    position = axis.inputs[clock.log_index // clock.lengths.size, REFERENCE]
    return position, np.gradient(position, problem.sample_time)


def identify_windows(
    log: LongRecord,
    model: ClosedLoop,
    known: Mapping[str, Parameter],
    fit: FitRecord,
    window: float,
    progress: Progress,
) -> Estimate:
    """Return the estimate of a joint from a long log, in bounded memory; see `jointid.identify`.

    Args:
        log: that is read.
        model: the joint under its controller.
        known: changes to its parameters.
        fit: what identifies a window by itself.
        window: s of a window.
        progress: receives the steps.

    Raises:
        RecordError, MethodError: no window by itself identifies the joint, or one cannot be simulated.
    """
    sample_time = log.sample_time
    # Whole rows, so that all windows keep the same samples, and whole periods of a controller that is slower than the
    # log: the law's first is at a window's first sample.
    period = Fraction(model.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator

    def samples(seconds: float, unit: int) -> int:
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    first = (samples(window, period), 2 * samples(window / 20, period))
    record, began, like, x = _start(log, first, model, known, fit, progress)
    keep, needed = like.filtering.decimation or 1, settling(like, record, x)
    length, needed = samples(window, math.lcm(keep, period)), keep * -(-needed // keep)
    settled = min(needed, length // (2 * keep) * keep)
    forgets = f"a window forgets how it began in {needed * sample_time:g} s"
    progress(Detail(forgets))
    problem = WindowsProblem(like, log, places_of(*_commanded(like)), length, settled, progress)
    sums = problem.pass_over(x).sums

    def watch(step: Step) -> None:
        progress(Detail(f"pass {len(problem.passes)}: torque error {100 * step.norm / math.sqrt(sums.size):.4f} %"))

    enough = _ROUNDING * math.sqrt(sums.size)
    solution = solve(problem, LevenbergMarquardt(1e-8, _PASSES, None, _WORTH / sums.rows, enough), x, watch)
    found, x = problem.pass_over(solution.x), solution.x
    if found.stopped:
        raise MethodError(
            f"{found.stopped[:1].upper()}{found.stopped[1:]}: check the controller and the start, or begin from "
            "another window."
        )
    # What the last step promises is taken without another pass.
    step = damped_step(solution.residual, solution.jacobian, Bounds.of(problem.free).shift_to(x))
    found, x = found.shift(step), x + step
    covariance, sums, at = found.covariance(), found.sums, like.loop_at(x)
    changes = drift(found.windows, x, problem.free, like.units)
    left = np.array([math.sqrt(sums.square)])
    rows = rows_of_problem(like, x, covariance, left, solution.jacobian)
    made = build_estimate(
        [record],
        tuple(row for row in rows if row.of_joint or row.free),
        covariance.correlation,
        (np.zeros(0), np.zeros(0)),
        sums.relative_error,
        sums.rows,
        (solution.message, solution.converged),
        began.fit.simulations + len(problem.passes) * len(found.windows),
        replace(
            began.settings, variant=f"{began.settings.variant}, in windows", loop=at,
            delay=at.controller.law(sample_time).delay,
        ),
        began.data.channels,
        known=identifiability(problem.free, like.units, x, solution.jacobian, covariance),
        agreement=changes,
        warnings=(
            *([f"{forgets}; give longer windows"] if needed > settled else []),
            *warn_of_limit(float(np.mean([w.at_limit for w in found.windows]))),
        ),
    )  # fmt: skip
    span = Windows(
        length=length * sample_time,
        settling=settled * sample_time,
        count=len(found.windows),
        still=found.still,
        duration=found.windows[-1].end - found.windows[0].begin,
    )
    return replace(
        made,
        fit=replace(made.fit, passes=len(problem.passes)),
        data=replace(made.data, record=log.name, fingerprints=(), resampled=None, windows=span),
        window=began,
    )


def _start(
    log: LongRecord,
    cut: tuple[int, int],
    model: ClosedLoop,
    known: Mapping[str, Parameter],
    fit: FitRecord,
    progress: Progress,
) -> tuple[Record, Estimate, ClosedLoopProblem, FloatArray]:
    """Return a window that identifies the joint, its estimate, and the problem of windows like it with its solution.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    refusal: RecordError | MethodError = MethodError(NO_MOTION)
    first = list(islice(filter(moves, (chunk.record for chunk in log.chunks(*cut))), _STARTS))
    enough = _TRAVEL * max(map(travel, first), default=0.0)
    for record in sorted(first, key=lambda one: travel(one) < enough):
        progress(f"starting from the window that begins at {record.begin:g} s")
        try:
            found = fit(model, record, known)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.rows if p.of_joint and p.value is None]
        if not lost and found.problem is not None:
            like, rows = begin_window(found.problem, record), found.rows
            return record, found, like, like.vector({row.name: row.value for row in rows if row.value is not None})
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal
