"""A problem over pieces: whole records in memory, or the windows of long logs, whose normal equations are summed.

What a piece says at a candidate, `Seen`, is a model's (`estimation.windowed`): a loop or a robot that is simulated.
Several records are logs of one problem, which share parameters.

A window begins in the middle of a motion. It begins where the law, turned round, puts the motor for the torque that was
logged, at the speed of the reference; what of that is wrong the loop forgets within the settling time, of which nothing
is counted, at either end: the zero-phase filter looks both ways. Neighbouring windows overlap by twice the settling
time, so that the rows that count follow each other without a gap.

What every visit to a place errs alike is no noise, and no longer record averages it away: sums are kept of each place,
too, so that what leaving out places says is known beside what leaving out windows says (`uncertainty.resampling`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress, follow, ignore_progress
from jointid.common.parameters import Bounds, Parameter
from jointid.records.chunks import Chunk
from jointid.records.record import Channel, Record
from jointid.solvers.solve import Tally
from jointid.uncertainty.covariance import Covariance, larger, rising_scores
from jointid.uncertainty.position_dependent_error import cells
from jointid.uncertainty.resampling import Sums, left_out, scale_of, step_of, total

if TYPE_CHECKING:
    from jointid.estimation.problems.closed_loop import ClosedLoopProblem

_PLACES = 6  # stretches of the travel: what a place errs, its neighbourhood errs alike (`position_dependent_error`)
_EQUATION = 2**20  # numbers of the places of one equation
_BANDS = np.geomspace(1e-4, 1.0, 96)  # of the Nyquist frequency: up to these a bias by a force in the loop is sought
_ROUNDING = 1e-6  # of the torque: a residual as good as none
_RESTING = 0.02  # of the largest speed: below it a row has no direction
_AROUND = 64  # stretches after which places are taken to come again: an axis may turn for ever
_FEW = 8  # windows: with fewer a part of a log says too little
_SPARSE, _SPARSE_PASSES = 16, 3  # of so many windows, one is read in a first pass; and such passes at most
_PASSES = 12  # at most
_SETTLED = 0.3  # deviations: a step of less is the last, which is taken, too; what is left after it is far less
_FLAT = 1e-6  # of the level: by less a step does not lead uphill

NO_MOTION = "In no window of this record does the axis move; give another record."


Places: TypeAlias = Callable[[FloatArray, FloatArray], NDArray[np.intp]]
"""From positions and velocities, (rows,) each, to the number of each row's stretch of the travel, (rows,)."""

Pieces: TypeAlias = Callable[[int, int, int], Iterable[Sequence[Chunk]]]
"""The pieces of a log, a chunk for each axis, by their length and overlap in samples, and one of so many."""


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


def commanded(record: Record) -> Channel | None:
    """Return the reference, or without one the motor position."""
    return record.motor_position if record.reference is None else record.reference


def travel(records: Sequence[Record]) -> float:
    """Return how far the axes are asked to move in a window, or what is injected varies, in sum."""
    asked = [commanded(one) if one.injected is None else one.injected.channel for one in records]
    return sum(float(np.sum(np.abs(np.diff(one.values)))) for one in asked if one is not None)


def moves(records: Sequence[Record]) -> bool:
    """Test whether a window has a motion or something injected, and no brake that holds a joint at a torque of 0."""
    braked = any(one.torque is not None and not np.any(one.torque.values) for one in records)
    return not braked and (travel(records) > 0 or any(one.injected is not None for one in records))


class NotSimulatedError(MethodError):
    """A window whose loop could not be simulated to its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The rows of one piece at a candidate; equations share their instants.

    Attributes:
        error, measured: (equations, rows) residual, and what it is left of. J: (equations, rows, free) its derivatives.
        at: (rows,) samples of the piece. samples: of the piece. keep: from one row to the next.
        motion: of each equation position and velocity at all samples, from which its places are told.
        at_limit: share of the periods in which the controller was at its limit.
        torques: (samples,) each, raw, of a joint that is simulated: measured and predicted.
    """

    error: FloatArray
    J: FloatArray
    measured: FloatArray
    at: NDArray[np.intp]
    samples: int
    keep: int
    motion: Sequence[tuple[FloatArray, FloatArray]]
    at_limit: float = 0.0
    torques: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The model that is compared with pieces.

    Attributes:
        free: the parameters that are identified.
        look: from the records of a piece, of each axis, and x, (free,), to its rows; None where it does not move, and
            `NotSimulatedError` where it cannot be simulated.
        settling: from the same to how many samples a piece takes to forget how it began.
        motion_measured: whether the regressor has a measured motion, and so a bias by disturbances.
        problem: of a joint's loop.
    """

    free: tuple[Parameter, ...]
    look: Callable[[Sequence[Record], FloatArray], Seen | None]
    settling: Callable[[Sequence[Record], FloatArray], int]
    motion_measured: bool = False
    problem: ClosedLoopProblem | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """One log of a problem.

    Attributes:
        name: of the log.
        pieces: of it.
        model: of its pieces.
        at: (its free,) places of the model's parameters among those of the problem.
        added: (its free,) what is known on top of them.
    """

    name: str
    pieces: Pieces
    model: Model
    at: NDArray[np.intp]
    added: FloatArray

    def values(self, x: FloatArray) -> FloatArray:
        """Return its own parameters, (its free,), of the problem's."""
        return np.asarray(x[self.at] + self.added)

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a piece at the problem's parameters, with derivatives by all of these."""
        seen = self.model.look(records, self.values(x))
        if seen is None:
            return None
        J = np.zeros((*seen.error.shape, x.size))
        J[..., self.at] = seen.J
        return replace(seen, J=J)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Sums of one piece, or of a part of one.

    Attributes:
        begin, end: seconds from the first sample of the record, of what counts.
        sums: over its rows.
        at_limit: share of its periods in which the controller was at its limit.
        record: the number of its log.
    """

    begin: float
    end: float
    sums: Sums
    at_limit: float
    record: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """Sums of one pass over the pieces.

    Attributes:
        windows: in the order of time, log after log. places: over all of them, by the place's number.
        still: pieces in which nothing was asked of the axis, and which are left out.
        sizes: (logs, equations, 3) squares of residual and of what it is left of, not weighted, and rows.
        scores: (bands, free) of the derivatives with the residual, summed up to each band of frequency; 0 where the
            motion is not measured.
        count: of pieces that are in the sums.
        seen: their rows, where they are kept.
    """

    windows: tuple[Window, ...]
    places: Mapping[int, Sums]
    still: int
    sizes: FloatArray
    scores: FloatArray
    count: int
    seen: tuple[Seen, ...] = ()

    @property
    def sums(self) -> Sums:
        """Over all pieces.

        Raises:
            MethodError: there is none, because in no piece does the axis move.
        """
        if not self.windows:
            raise MethodError(NO_MOTION)
        return total([w.sums for w in self.windows])

    @property
    def is_exact(self) -> bool:
        """True if the residual is as good as none."""
        return self.sums.square <= _ROUNDING**2 * self.sums.size

    def relative_errors(self) -> FloatArray:
        """Return the share of each equation that is left, (equations,)."""
        left, size, _ = self.sizes.sum(axis=0).T
        return np.asarray(np.sqrt(left / np.where(size > 0, size, np.inf)))

    def shift(self, step: FloatArray) -> Pass:
        """Return the pass after a small step of the parameters, to first order."""
        windows = tuple(replace(w, sums=w.sums.shift(step)) for w in self.windows)
        places = {at: sums.shift(step) for at, sums in self.places.items()}
        seen = tuple(replace(one, error=one.error + one.J @ step) for one in self.seen)
        return replace(self, windows=windows, places=places, seen=seen)

    def covariance(self) -> Covariance:
        """Return the covariance of the estimate: the larger of leaving out windows, and of leaving out places.

        Along a measured motion it is widened for a force in the loop; see `Influence.widen_for_motion`.

        Raises:
            MethodError: one window says nothing of how windows differ.
        """
        if self.count < 2:
            raise MethodError(
                "A long record has two windows or more, in which the axis moves; this one has "
                f"{self.count}: give a shorter window, or leave windows out."
            )
        found = left_out([w.sums for w in self.windows])
        if len(self.places) > 1:
            found = larger(found, left_out([*self.places.values()]))
        scale = scale_of(self.sums.A)
        bias = np.linalg.pinv(self.sums.A / np.outer(scale, scale), hermitian=True) @ (self.scores / scale).T
        return replace(found, std=np.hypot(found.std, np.max(np.abs(bias), axis=1) / scale))


@dataclass(frozen=True, slots=True, eq=False)
class PiecesProblem:
    """Logs, piece by piece: a problem whose rows are summed as they are read.

    Attributes:
        logs: one for each record, or one of all of a robot's joints.
        free: the parameters that are identified.
        places: that repeat, of each equation.
        sigma: (logs, equations) size of the residual, by which its rows are divided; 1 where they are not weighted.
        weighted: whether each pass weighs the next.
        length: samples that count in a window.
        settling: samples at either end of a window that are simulated and not counted.
        parts: of a window, whose sums are kept apart.
        kept: whether a pass keeps its rows: those of whole records in memory.
        progress: receives the progress of a pass.
        tally: of pieces that were simulated, each with its derivatives.
    """

    logs: tuple[Log, ...]
    free: tuple[Parameter, ...]
    places: tuple[Places, ...]
    sigma: FloatArray
    weighted: bool = False
    length: int = 1
    settling: int = 0
    parts: int = 1
    kept: bool = False
    progress: Progress = ignore_progress
    tally: Tally = field(default_factory=Tally)

    def weigh(self, sizes: FloatArray) -> PiecesProblem:
        """Return the problem weighted by what is left, (logs, equations, 3); see `Pass`."""
        if not self.weighted:
            return self
        squares, size, rows = np.moveaxis(sizes, 2, 0)
        sigma = np.sqrt(np.maximum(squares, _ROUNDING**2 * np.max(size)) / np.maximum(rows, 1))
        return replace(self, sigma=np.where(rows > 0, sigma, self.sigma))

    def pass_over(self, x: FloatArray, every: int = 1) -> Pass:
        """Pass over one piece in so many.

        Raises:
            NotSimulatedError: a window cannot be simulated.
        """
        windows, places, kept, still, count = list[Window](), dict[int, Sums](), list[Seen](), 0, 0
        sizes, scores = np.zeros((*self.sigma.shape, 3)), np.zeros((_BANDS.size, x.size))
        pieces: Iterable[tuple[int, Sequence[Chunk]]] = (
            (number, piece)
            for number, log in enumerate(self.logs)
            for piece in log.pieces(self.length, 2 * self.settling, every)
        )
        for number, piece in follow(pieces, self.progress, "passing over the log", math.inf, "windows"):
            log, records = self.logs[number], [one.record for one in piece]
            try:
                seen = log.look(records, x) if self.kept or moves(records) else None
            except RecordError:
                if not (piece[0].number and piece[0].last):  # a last one may be too short for filters
                    raise
                continue
            if seen is None:
                still += 1
                continue
            self.tally.evaluations += 1
            kept += [seen] if self.kept else []
            counted = (seen.at >= self.settling) & (seen.at < seen.samples - self.settling)
            at = seen.at[counted]
            if not at.size:
                continue
            sizes[number] += sizes_of(seen, counted)
            sigma = self.sigma[number, :, np.newaxis]
            error, measured = seen.error[:, counted] / sigma, seen.measured[:, counted] / sigma
            J = seen.J[:, counted] / sigma[..., np.newaxis]
            label = np.array(
                [
                    where(position[at], velocity[at]) + equation * _EQUATION
                    for equation, (where, (position, velocity)) in enumerate(zip(self.places, seen.motion, strict=True))
                ]
            )
            for place in map(int, np.unique(label)):
                sums = Sums.of(*(rows[label == place] for rows in (error, J, measured)))
                places[place] = places[place] + sums if place in places else sums
            assert records[0].torque is not None
            step = records[0].torque.sample_time
            for rows in np.array_split(np.arange(at.size), min(self.parts, at.size)):
                sums = Sums.of(*(np.concatenate(each[:, rows]) for each in (error, J, measured)))
                begin, end = (records[0].begin + one * step for one in (at[rows[0]], at[rows[-1]] + seen.keep))
                windows.append(Window(begin, end, sums, seen.at_limit, number))
            count += 1
            if log.model.motion_measured:
                scores += rising_scores(J, error, _BANDS)
        return Pass(tuple(windows), places, still, sizes, scores, count, tuple(kept))

    def _pass_unless_uphill(self, x: FloatArray, every: int, last: tuple[FloatArray, int, Pass] | None) -> Pass | None:
        """Return a pass; None where the last step led uphill, or to what cannot be simulated."""
        try:
            found = self.pass_over(x, every)
        except NotSimulatedError:
            if last is None:
                raise
            return None
        if last is None or last[1] != every or not found.windows or found.is_exact:
            return found
        level, before = (
            np.sum(one.sizes[..., 0] / self.sigma**2) / np.sum(one.sizes[..., 2]) for one in (found, last[2])
        )
        return None if level > (1.0 + _FLAT) * before else found


def sizes_of(seen: Seen, counted: NDArray[np.bool_] | slice = slice(None)) -> FloatArray:
    """Return squares of residual and of what it is left of, and the number of rows, (equations, 3)."""
    squares = [np.sum(rows[:, counted] ** 2, axis=1) for rows in (seen.error, seen.measured)]
    return np.array([*squares, np.full(len(seen.error), seen.at[counted].size)]).T


class Solved(NamedTuple):
    """The solution of all pieces: the problem as the last pass weighed it, x, (free,), and that pass there.

    `passes` went over the whole log; `stop` says why the last ended, `converged` whether that is a good end.
    """

    problem: PiecesProblem
    x: FloatArray
    found: Pass
    passes: int
    stop: str
    converged: bool


def stream(problem: PiecesProblem, x: FloatArray) -> Solved:
    """Solve by Gauss-Newton in as few passes over a log as there can be.

    A pass reads every piece once, and keeps of each what `Sums` holds: memory does not grow with what is read but by a
    kilobyte for each window. Of the first passes one window in sixteen is enough, at a sixteenth of the cost: a start
    from one window is far off in the deviations of all of them. A pass over the whole that moves the parameters by less
    than 0.3 of their deviations is the last. A solver of `solvers` would read the
    log for each step that it halves and once more for its last.

    Raises:
        NotSimulatedError: a window cannot be simulated at the start.
        MethodError: in no window does the axis move.
    """
    bounds, every, whole = Bounds.of(problem.free), 1 if problem.kept else _SPARSE, 0
    last: tuple[FloatArray, int, Pass] | None = None  # where the last step was taken from, of one window in how many
    for number in range(1, _PASSES + 1):
        found, whole = problem._pass_unless_uphill(x, every, last), whole + (every == 1)
        if found is None:
            x = 0.5 * (x + last[0]) if last is not None else x
            continue
        if every > 1 and found.count < _FEW:
            every = 1
            continue
        sums = found.sums
        step = step_of(sums, bounds.shift_to(x))
        far = math.sqrt(float(step @ sums.A @ step) * sums.rows / sums.square) if sums.square > 0 else 0.0
        # Where nothing is left, nothing is a deviation.
        if every == 1 and (far < _SETTLED or found.is_exact):
            stop = f"converged: the last pass moved the parameters by {far:.2g} deviations (limit {_SETTLED:g})"
            return Solved(problem, x + step, found.shift(step), whole, stop, True)
        last, x, problem = (x, every, found), x + step, problem.weigh(found.sizes)
        problem.progress(Detail(f"{found.count} windows move the parameters by {far:.2g} deviations"))
        if number >= _SPARSE_PASSES or far < 1.0:
            every = 1
    assert last is not None
    stop = "not converged: the last passes led uphill, or still moved the parameters"
    return Solved(problem, last[0], last[2], whole, stop, False)
