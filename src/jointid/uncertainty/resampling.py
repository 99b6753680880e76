"""Resampling of an estimate's rows: group jackknife and block bootstrap.

**Jackknife.** A Gauss-Newton step needs only J'J, J'e and e'e of each group of rows. Rows with correlated errors form a
group; groups are independent. Leaving out each group gives::

    d_g = -(A - A_g)^-1 (b - b_g)        V = (G - 1) / G  sum_g (d_g - mean)(d_g - mean)'

with A = sum_g J_g'J_g and b = sum_g J_g'e_g, 0 at the estimate. It holds for any correlation and variance within a
group and is conservative for few groups. Directions that a single group determines, and those after the first G - 1,
get the intervals of a white residual. Columns are scaled first, since J's condition number is squared.

**Bootstrap.** Rows are drawn in overlapping blocks of time (moving blocks, Kunsch 1989) or by cells of position,
direction and speed, which keeps repeatable errors. With w the number of times each row was drawn::

    one step   dx = -(J' diag(w) J)^-1 J' diag(w) r,  less the same with w = 1, which is 0 at a minimum
    refitted   x minimises sum w r(x)^2

One step is linear and needs no simulation; its intervals can be asymmetric. A refit includes the nonlinearity.
Parameters that rest on few rows, as the initial state, are missing from many resamples, and keep their value there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, follow, ignore_progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import in_words, interval, number
from jointid.uncertainty.covariance import Covariance, bandwidth, covariance_of, larger

_SINGULAR = 1e-12  # of the largest: a direction of the scaled parameters that nothing determines
_ALONE = 0.9  # of the information in a direction: the group is as good as alone
_FEWEST = 8  # blocks: fewer cannot say how far the parts of a record differ
_LOST = 0.05  # of the information on a direction: a resample that has less of it is not asked
BANDWIDTHS = 3  # times the bandwidth of the autocorrelation is a block of time long


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Sums over rows for a least-squares estimate.

    Attributes:
        A: (free, free) J'J. b: (free,) J'e. square: e'e. size: y'y of the filtered torque that e is left of.
    """

    A: FloatArray
    b: FloatArray
    square: float
    size: float
    rows: int

    @classmethod
    def of(cls, error: FloatArray, J: FloatArray, measured: FloatArray) -> Sums:
        """Sum rows: residual, (rows,), derivatives, (rows, free), and measured, (rows,)."""
        return cls(J.T @ J, J.T @ error, float(error @ error), float(measured @ measured), error.size)

    @property
    def relative_error(self) -> float:
        """Norm of the residual relative to the measured signal; 0 without one."""
        return float(np.sqrt(self.square / self.size)) if self.size > 0 else 0.0

    def __add__(self, other: Sums) -> Sums:
        """Return those of the rows of both."""
        square, size, rows = self.square + other.square, self.size + other.size, self.rows + other.rows
        return Sums(self.A + other.A, self.b + other.b, square, size, rows)

    def of_some(self, at: NDArray[np.intp]) -> Sums:
        """Return the sums of some of the parameters."""
        return replace(self, A=self.A[np.ix_(at, at)], b=self.b[at])

    def shift(self, step: FloatArray) -> Sums:
        """Update the sums for a step of the parameters, to first order."""
        square = self.square + float(2 * self.b @ step + step @ self.A @ step)
        return Sums(self.A, self.b + self.A @ step, max(square, 0.0), self.size, self.rows)


def total(groups: Sequence[Sums]) -> Sums:
    """Add the sums of all groups."""
    return sum(groups[1:], start=groups[0])


def step_of(sums: Sums, room: Bounds) -> FloatArray:
    """Minimise ``||e + J s||^2`` within bounds on the step, (free,)."""
    from scipy.optimize import lsq_linear

    R = root_of(sums)
    scale = scale_of(sums.A)
    columns = R / scale
    target = -np.linalg.lstsq(columns.T, sums.b / scale, rcond=None)[0]
    found = lsq_linear(columns, target, (room.lower * scale, room.upper * scale), method="bvls")
    return room.clip(found.x / scale)


def root_of(sums: Sums) -> FloatArray:
    """Return R with R'R = J'J, (determined directions, free)."""
    scale, sizes, vectors = _determine(sums.A)
    return np.asarray((vectors * np.sqrt(sizes)).T * scale)


def left_out(groups: Sequence[Sums]) -> Covariance:
    """Jackknife covariance over two or more groups."""
    whole = total(groups)
    scale, sizes, vectors = _determine(whole.A)
    outer = np.outer(scale, scale)
    steps = np.array(
        [-np.linalg.pinv((whole.A - g.A) / outer, hermitian=True) @ ((whole.b - g.b) / scale) for g in groups]
    )
    apart = steps - steps.mean(axis=0)
    found = covariance_of((len(groups) - 1) / len(groups) * apart.T @ apart, 0)
    back = vectors / np.sqrt(sizes)
    most = max(float(np.linalg.eigvalsh(back.T @ (g.A / outer) @ back)[-1]) for g in groups)
    if most > _ALONE or len(groups) <= scale.size:
        white = covariance_of(whole.square / max(whole.rows - scale.size, 1) * back @ back.T, 0)
        found = larger(white, found)
    return Covariance(found.std / scale, found.correlation, 0)


def _determine(A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Column norms, and eigenvalues and vectors of the scaled A above rounding."""
    scale = scale_of(A)
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    kept = values > _SINGULAR * values[-1]
    return scale, values[kept], vectors[:, kept]


def scale_of(A: FloatArray) -> FloatArray:
    """Column norms of J from A = J'J, with 1 for zero columns."""
    norms = np.sqrt(np.diag(A))
    return np.where(norms > 0, norms, 1.0)


@dataclass(frozen=True, slots=True)
class Bootstrapping:
    """Settings of a bootstrap.

    Attributes:
        level: of the percentile intervals; 0.9545 is that of 2 sigma.
    """

    draws: int = 1000
    level: float = 0.9545
    seed: int = 0

    def __post_init__(self) -> None:
        if self.draws < 2 or not 0 < self.level < 1 or self.seed < 0:
            raise MethodError(
                "A bootstrap needs 2 or more draws, a level between 0 and 1 and a seed of 0 or more; received "
                f"{self.draws}, {self.level} and {self.seed}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Bootstrap(Documented):
    """Estimates from resamples of a record.

    Attributes:
        estimate: (free,) from the record itself.
        draws: (draws, free) from its resamples.
        blocks: the rows were drawn in so many different ones.
        how: the parts that were drawn, in words.
    """

    parameters: tuple[Parameter, ...]
    estimate: FloatArray
    draws: FloatArray
    level: float
    blocks: int
    how: str

    @property
    def std(self) -> FloatArray:
        """Standard deviations, (free,)."""
        return np.asarray(np.std(self.draws, axis=0, ddof=1))

    @property
    def correlation(self) -> FloatArray:
        """Of the parameters' errors, (free, free)."""
        return np.asarray(np.corrcoef(self.draws, rowvar=False).reshape(len(self.parameters), -1))

    @property
    def intervals(self) -> FloatArray:
        """Percentile intervals, (free, 2)."""
        return np.asarray(np.quantile(self.draws, [0.5 - 0.5 * self.level, 0.5 + 0.5 * self.level], axis=0).T)

    def to_document(self, *, details: bool = False) -> Document:
        """Table of the intervals."""
        del details
        rows = tuple(
            (in_words(p.name), interval(float(value), float(std)), number(float(low)), number(float(high)), p.symbol)
            for p, value, std, (low, high) in zip(self.parameters, self.estimate, self.std, self.intervals, strict=True)
        )
        header = ("parameter", "value ± sigma", f"{100 * self.level:.4g} % from", "to", "symbol")
        return Document(
            f"{len(self.draws)} draws of {self.blocks} blocks: {self.how}", (Table(header, rows, words=(0, 4)),)
        )


def bootstrap_estimate(
    parameters: Sequence[Parameter],
    x: FloatArray,
    residual: FloatArray,
    J: FloatArray,
    labels: NDArray[np.intp] | None = None,
    settings: Bootstrapping | None = None,
    refit: Callable[[FloatArray], FloatArray] | None = None,
    progress: Progress = ignore_progress,
) -> Bootstrap:
    """Bootstrap over moving blocks of time, or over groups of rows.

    Args:
        parameters: the free ones.
        x: (free,) the estimate.
        residual: (rows,) of it, in the order of time.
        J: (rows, free), its derivatives.
        labels: (rows,) group of each row, such as `Cells.stretch` or `Cells.label`; None for blocks of time, three
            bandwidths long (`covariance.bandwidth`).
        settings: see `Bootstrapping`.
        refit: fits a resample, weights (rows,) in, estimate (free,) out; one linear step when None.
        progress: receives the number of draws.
    """
    settings = settings or Bootstrapping()
    random = np.random.default_rng(settings.seed)
    if labels is None:
        blocks, how, draw = _draw_in_time(residual.size, random)
    else:
        blocks, how, draw = _draw_groups(labels, random)
    estimate = refit or _one_step(x, residual, J)
    rounds = follow(range(settings.draws), progress, "bootstrapping", settings.draws, "draws")
    draws = np.array([estimate(draw()) for _ in rounds])
    said = f"{how}; {'one linear step' if refit is None else 'refitted'} each"
    return Bootstrap(tuple(parameters), np.array(x, dtype=np.float64), draws, settings.level, blocks, said)


def _draw_in_time(rows: int, random: np.random.Generator) -> tuple[int, str, Callable[[], FloatArray]]:
    """Return number and description of the blocks, and a function that draws weights, (rows,)."""
    length = BANDWIDTHS * bandwidth(rows)
    starts = rows - length + 1
    _require(starts, rows // length)

    def draw() -> FloatArray:
        begin = random.integers(starts, size=-(-rows // length))
        change = np.zeros(rows + 1)
        np.add.at(change, begin, 1.0)
        np.add.at(change, begin + length, -1.0)
        return np.asarray(np.cumsum(change)[:-1])

    return rows // length, f"moving blocks of {length} rows in time", draw


def _draw_groups(labels: NDArray[np.intp], random: np.random.Generator) -> tuple[int, str, Callable[[], FloatArray]]:
    groups, member = np.unique(labels, return_inverse=True)
    _require(groups.size, groups.size)

    def draw() -> FloatArray:
        times = np.bincount(random.integers(groups.size, size=groups.size), minlength=groups.size)
        return np.asarray(times[member.reshape(-1)], dtype=np.float64)

    return groups.size, "cells of position, direction and speed, all visits together", draw


def _require(choices: int, blocks: int) -> None:
    if min(choices, blocks) < _FEWEST:
        raise MethodError(
            f"A bootstrap draws from {_FEWEST} blocks or more; this record has {max(blocks, 0)}: use a longer one."
        )


def _one_step(x: FloatArray, residual: FloatArray, J: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the Gauss-Newton step on a resample, relative to the record.

    Columns are orthogonalised first, since normal equations lose half the digits of nearly collinear parameters. The
    information is then the identity, so that a loss in a resample shows.
    """
    Q, R = np.linalg.qr(J)
    norms = column_norms(R)
    back = np.linalg.pinv(R / norms) / norms[:, np.newaxis]
    whole = Q.T @ residual

    def step(weights: FloatArray) -> FloatArray:
        weighted = weights[:, np.newaxis] * Q
        drawn = np.linalg.lstsq(weighted.T @ Q, weighted.T @ residual, rcond=_LOST)[0]
        return np.asarray(x - back @ (drawn - whole))

    return step
