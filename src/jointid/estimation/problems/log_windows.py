"""The windows of long logs as one problem, which streams its normal equations: memory does not grow with the log.

What a window says at a candidate, `Seen`, is a model's (`estimation.windowed`): a loop that is simulated, or the
inverse model of a joint or a robot. Everything else is the same for all of them. Several records are members of one
problem, which share parameters as in `RecordsProblem`.

A window begins in the middle of a motion. It begins where the law, turned round, puts the motor for the torque that was
logged, at the speed of the reference; what of that is wrong the loop forgets within the settling time, of which nothing
is counted, at either end: the zero-phase filter looks both ways. Neighbouring windows overlap by twice the settling
time, so that the rows that count follow each other without a gap. How long it takes is measured:
0.3 s in the paper's stiff loop, seconds in a slow one with an integral.

What every visit to a place errs alike is no noise, and no longer record averages it away. A window's residual, summed
over its rows at one place, is a draw of its own; where nothing repeats, these draws have no mean. With the sum s_cw of
place c in window w, and n_cw rows, over all windows::

    z_c^2 = (sum_w s_cw)^2 / sum_w s_cw^2        chi-square, together, of as many degrees as there are places
    rms^2 = 1/n sum_c n_c ((sum_w s_cw)^2 - sum_w s_cw^2) / (n_c^2 - sum_w n_cw^2)

the latter from products of different windows only, as in `uncertainty.position_dependent_error`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Progress, follow, ignore_progress
from jointid.common.parameters import Parameter
from jointid.records.chunks import Chunk, LongRecord
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Tally
from jointid.uncertainty.covariance import rising_scores
from jointid.uncertainty.position_dependent_error import Repeatable, cells
from jointid.uncertainty.resampling import Sums, root_of, total

if TYPE_CHECKING:
    from jointid.estimation.identify_log import Solved
    from jointid.estimation.result.estimate import Estimate

FEW = 8
"""Windows: with fewer a part of a log says too little."""

_RINGS = 10.0  # periods of its cut-off that the zero-phase filter rings
_PLACES = 6  # stretches of the travel: what a place errs, its neighbourhood errs alike (`position_dependent_error`)
_EQUATION = 2**20  # numbers of the places of one equation
_BANDS = np.geomspace(1e-4, 1.0, 96)  # of the Nyquist frequency: up to these a bias by a force in the loop is sought
_ROUNDING = 1e-6  # of the torque: a residual as good as none
_AROUND = 64  # stretches after which places are taken to come again: an axis may turn for ever
VISITS = 8
"""Windows that a place must be visited in to say anything."""

NO_MOTION = "In no window of this record does the axis move; give another record."


@dataclass(frozen=True, slots=True)
class Windowing:
    """How a log that is too long for memory is cut into windows.

    Attributes:
        length: seconds of a window that are fitted.
        settling: seconds before and after each window that are simulated and not fitted; None measures how long the
            loop takes to forget its initial state.

    Raises:
        MethodError: a length that is not positive and finite, or a settling time above half of it.
    """

    length: float = 60.0
    settling: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.length < math.inf:
            raise MethodError(f"A window lasts a finite time; received {self.length:g} s.")
        if self.settling is not None and not 0.0 < self.settling <= 0.5 * self.length:
            raise MethodError(
                f"The settling time is more than 0 and at most half a window of {self.length:g} s; received "
                f"{self.settling:g} s. Without it, it is measured."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Stretches of the travel, by direction and class of speed.

    Attributes:
        origin, width: of the stretches, in the reference's unit.
        speeds: (classes,) mean speed of each class; resting: the speed below which there is no direction.
    """

    origin: float
    width: float
    speeds: FloatArray
    resting: float

    @classmethod
    def of(cls, position: FloatArray, velocity: FloatArray) -> Places:
        """Return those of the motion in one window, (samples,) each."""
        speeds = cells(position, velocity).speeds
        travel, fastest = float(np.ptp(position)) or 1.0, float(np.max(np.abs(velocity)))
        return cls(float(position.min()), travel / _PLACES, speeds, 0.02 * fastest)

    def label(self, position: FloatArray, velocity: FloatArray) -> NDArray[np.intp]:
        """Return the number of each row's stretch, (rows,)."""
        moving = np.abs(velocity) > self.resting
        kind = np.argmin(np.abs(np.abs(velocity)[:, np.newaxis] - self.speeds), axis=1)
        family = np.where(moving, np.sign(velocity), 0.0).astype(np.intp) + 1
        place = np.floor((position - self.origin) / self.width).astype(np.intp) % _AROUND
        return np.asarray((family * self.speeds.size + np.where(moving, kind, 0)) * _AROUND + place, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Sums of windows at one place.

    Attributes:
        sums: over the rows. total: of the residual. squares: sum of the squares of the windows' totals.
        visits: windows. pairs: sum of the squares of the windows' rows.
    """

    sums: Sums
    total: float
    squares: float
    visits: int
    pairs: float

    @classmethod
    def of(cls, error: FloatArray, J: FloatArray, measured: FloatArray) -> Place:
        """Return the sums of one window; see `Sums.of`."""
        total = float(error.sum())
        return cls(Sums.of(error, J, measured), total, total * total, 1, float(error.size) ** 2)

    def __add__(self, other: Place) -> Place:
        """Add the sums of other windows."""
        return Place(
            self.sums + other.sums, self.total + other.total, self.squares + other.squares, self.visits + other.visits,
            self.pairs + other.pairs,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The rows of one window at a candidate; equations share their instants.

    Attributes:
        error, measured: (equations, rows) residual, and what it is left of. J: (equations, rows, free) its derivatives.
        at: (rows,) samples of the window. samples: of the window. keep: from one row to the next.
        motion: of each equation position and velocity at all samples, from which its places are told.
        at_limit: share of the periods in which the controller was at its limit.
    """

    error: FloatArray
    J: FloatArray
    measured: FloatArray
    at: NDArray[np.intp]
    samples: int
    keep: int
    motion: Sequence[tuple[FloatArray, FloatArray]]
    at_limit: float = 0.0


class WindowModel(Protocol):
    """The model that is compared with one window."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""

    @property
    def motion_measured(self) -> bool:
        """Whether the regressor has a measured motion, and so a bias by disturbances."""

    def settling(self, records: Sequence[Record], x: FloatArray) -> int:
        """Return how many samples a window takes to forget how it began."""

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a window, of a record for each axis; None where it does not move.

        Raises:
            NotSimulatedError: the window cannot be simulated.
        """

    def tell(self, window: Estimate, solved: Solved) -> Estimate:
        """Return the fit of a window with the parameters, settings and robot of all windows."""


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One log of a problem.

    Attributes:
        log: of each axis.
        model: of its windows.
        at: (its free,) places of the model's parameters among those of the problem.
        added: (its free,) what is known on top of them.
    """

    log: tuple[LongRecord, ...]
    model: WindowModel
    at: NDArray[np.intp]
    added: FloatArray

    def pieces(self, length: int, overlap: int, every: int = 1) -> Iterable[tuple[Chunk, ...]]:
        """Yield the windows, a chunk for each axis."""
        return zip(*(source.chunks(length, overlap, every) for source in self.log), strict=False)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Sums of one window, or of a part of one.

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
    """Sums of one pass over the windows.

    Attributes:
        windows: in the order of time, log after log. places: over all of them, by the place's number.
        still: windows in which nothing was asked of the axis, and which are left out.
        sizes: (logs, equations, 3) squares of residual and of what it is left of, not weighted, and rows.
        scores: (bands, free) of the derivatives with the residual, summed up to each band of frequency.
        count: of windows that are in the sums.
    """

    windows: tuple[Window, ...]
    places: Mapping[int, Place]
    still: int
    sizes: FloatArray
    scores: FloatArray
    count: int

    @property
    def sums(self) -> Sums:
        """Over all windows.

        Raises:
            MethodError: there is none, because in no window does the axis move.
        """
        if not self.windows:
            raise MethodError(NO_MOTION)
        return total([w.sums for w in self.windows])

    def level(self, sigma: FloatArray) -> float:
        """Return the mean square of the residual in units of `sigma`, (logs, equations)."""
        return float(np.sum(self.sizes[..., 0] / sigma**2) / np.sum(self.sizes[..., 2]))

    def relative_errors(self) -> FloatArray:
        """Return the share of each equation that is left, (equations,)."""
        left, size, _ = self.sizes.sum(axis=0).T
        return np.asarray(np.sqrt(left / np.where(size > 0, size, np.inf)))

    @property
    def total_error(self) -> float:
        """The share of all equations' torque that is left."""
        left, size, _ = self.sizes.sum(axis=(0, 1))
        return math.sqrt(left / size) if size > 0 else 0.0

    def shift(self, step: FloatArray) -> Pass:
        """Return the pass after a small step of the parameters, to first order."""
        windows = tuple(replace(w, sums=w.sums.shift(step)) for w in self.windows)
        places = {at: replace(place, sums=place.sums.shift(step)) for at, place in self.places.items()}
        return replace(self, windows=windows, places=places)


class NotSimulatedError(MethodError):
    """A window whose loop could not be simulated to its end."""

    @classmethod
    def of(cls, record: Record, why: str) -> NotSimulatedError:
        """Return the error of a window."""
        return cls(
            f"The window that begins at {record.begin:.0f} s cannot be simulated, because {why}; check the controller "
            "and the start, or begin from another window."
        )


@dataclass(frozen=True, slots=True, eq=False)
class LogProblem:
    """Long logs, window by window: a problem whose rows are summed as they are read.

    Attributes:
        members: the logs.
        free: the parameters that are identified.
        length: samples that count in a window.
        settling: samples at either end of a window that are simulated and not counted.
        places: that repeat, of each equation.
        sigma: (logs, equations) size of the residual, by which its rows are divided; 1 where they are not weighted.
        weighted: whether each pass weighs the next.
        parts: of a window, whose sums are kept apart.
        progress: receives the progress of a pass.
        tally: of windows that were simulated, each with its derivatives.
    """

    members: tuple[Member, ...]
    free: tuple[Parameter, ...]
    length: int
    settling: int
    places: tuple[Places, ...]
    sigma: FloatArray
    weighted: bool = False
    parts: int = 1
    progress: Progress = ignore_progress
    tally: Tally = field(default_factory=Tally)

    def reweigh(self, found: Pass) -> LogProblem:
        """Return the problem weighted by what a pass left."""
        if not self.weighted:
            return self
        squares, size, rows = np.moveaxis(found.sizes, 2, 0)
        sigma = np.sqrt(np.maximum(squares, _ROUNDING**2 * np.max(size)) / np.maximum(rows, 1))
        return replace(self, sigma=np.where(rows > 0, sigma, self.sigma))

    def pass_over(self, x: FloatArray, every: int = 1) -> Pass:
        """Pass over one window in so many.

        Raises:
            RecordError: a piece of the record cannot be read.
            NotSimulatedError: a window cannot be simulated with these parameters.
        """
        windows: list[Window] = []
        places: dict[int, Place] = {}
        sizes, scores = np.zeros((*self.sigma.shape, 3)), np.zeros((_BANDS.size, x.size))
        still, count = 0, 0
        pieces: Iterable[tuple[int, tuple[Chunk, ...]]] = (
            (number, piece)
            for number, member in enumerate(self.members)
            for piece in member.pieces(self.length, 2 * self.settling, every)
        )
        for number, piece in follow(pieces, self.progress, "passing over the log", math.inf, "windows"):
            member, records = self.members[number], [one.record for one in piece]
            try:
                seen = member.model.look(records, x[member.at] + member.added)
            except RecordError:
                if not (piece[0].number and piece[0].last):  # a last one may be too short for filters
                    raise
                continue
            if seen is None:
                still += 1
                continue
            self.tally.evaluations += 1
            counted = (seen.at >= self.settling) & (seen.at < seen.samples - self.settling)
            if not counted.any():
                continue
            found, there, own, rising = self._sum(seen, counted, number, records[0])
            sizes[number] += own
            scores += rising
            for place, said in there.items():
                places[place] = places[place] + said if place in places else said
            windows += found
            count += 1
        return Pass(tuple(windows), places, still, sizes, scores, count)

    def _sum(
        self, seen: Seen, counted: NDArray[np.bool_], number: int, record: Record
    ) -> tuple[list[Window], dict[int, Place], FloatArray, FloatArray]:
        """Return the sums of a window, of each place by its number, its sizes, and its scores by frequency."""
        member, at = self.members[number], seen.at[counted]
        error, measured = seen.error[:, counted], seen.measured[:, counted]
        sizes = np.array([np.sum(error**2, axis=1), np.sum(measured**2, axis=1), np.full(len(error), at.size)]).T
        sigma = self.sigma[number, :, np.newaxis]
        error, measured = error / sigma, measured / sigma
        J = np.zeros((*error.shape, len(self.free)))
        J[..., member.at] = seen.J[:, counted] / sigma[..., np.newaxis]
        label = np.array(
            [
                places.label(position[at], velocity[at]) + equation * _EQUATION
                for equation, (places, (position, velocity)) in enumerate(zip(self.places, seen.motion, strict=True))
            ]
        )
        there = {
            int(one): Place.of(error[these], J[these], measured[these])
            for one in np.unique(label)
            for these in [label == one]
        }
        windows, step = [], member.log[0].sample_time
        for rows in np.array_split(np.arange(at.size), min(self.parts, at.size)):
            sums = Sums.of(error[:, rows].ravel(), J[:, rows].reshape(-1, len(self.free)), measured[:, rows].ravel())
            begin, end = (record.begin + one * step for one in (at[rows[0]], at[rows[-1]] + seen.keep))
            windows.append(Window(begin, end, sums, seen.at_limit, number))
        rising = np.zeros((_BANDS.size, len(self.free)))
        if member.model.motion_measured:
            rising = rising_scores(J, error, _BANDS)
        return windows, there, sizes, rising


def is_braked(records: Sequence[Record]) -> bool:
    """Test whether the torque of a joint is 0 throughout a window, as while its brake holds it."""
    return any(record.torque is not None and not np.any(record.torque.values) for record in records)


def ringing(filtering: Filtering, sample_time: float) -> int:
    """Return how many samples a resolved filtering rings."""
    assert filtering.cutoff is not None
    return math.ceil(_RINGS / (filtering.cutoff * sample_time))


def moves(record: Record) -> bool:
    """Test whether the reference, or without one the motor, moves in a window."""
    asked = commanded(record)
    return record.injected is not None or (asked is not None and float(np.ptp(asked.values)) > 0)


def commanded(record: Record) -> Channel | None:
    """Return the reference, or without one the motor position."""
    return record.motor_position if record.reference is None else record.reference


def travel(records: Sequence[Record]) -> float:
    """Return how far the axes are asked to move in a window, or what is injected varies, in sum."""
    asked = [commanded(one) if one.injected is None else one.injected.channel for one in records]
    return sum(float(np.sum(np.abs(np.diff(one.values)))) for one in asked if one is not None)


def compress(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Return a residual and its derivatives in as few rows as have these sums, (free + 1,) and (free + 1, free).

    The last row is what no parameter explains; rows of directions that nothing determines are 0.
    """
    R = root_of(sums)
    explained = np.linalg.lstsq(R.T, sums.b, rcond=None)[0]
    rest = math.sqrt(max(sums.square - float(explained @ explained), 0.0))
    directions, free = R.shape
    residual, J = np.zeros(free + 1), np.zeros((free + 1, free))
    residual[:directions], J[:directions] = explained, R
    residual[-1] = rest
    return residual, J


def repeats(places: Iterable[Place], square: float) -> Repeatable:
    """Return the repeatable part of the residual; where nothing is left at all, nothing does.

    Args:
        places: over all windows.
        square: of the residual, over all rows.
    """
    from scipy.special import chdtrc

    every = list(places)
    rows = sum(p.sums.rows for p in every)
    visited = [p for p in every if p.visits >= VISITS]
    known, p_value = [p for p in visited if p.squares > 0], 1.0 if visited else None
    if known:
        p_value = float(chdtrc(len(known), sum(p.total**2 / p.squares for p in known)))
    again = [p for p in known if p.sums.rows**2 > p.pairs]
    repeated = sum(p.sums.rows * (p.total**2 - p.squares) / (p.sums.rows**2 - p.pairs) for p in again) / max(rows, 1)
    share = min(max(repeated, 0.0) * rows / square, 1.0) if square > 0 else 0.0
    return Repeatable(math.sqrt(max(repeated, 0.0)), share, p_value)
