"""Bootstrap of an estimate: its parts drawn again and again, with replacement.

The rows of the residual are drawn in blocks: stretches of time that may overlap, which keep their autocorrelation
(moving blocks, Kunsch 1989), or all the rows of one cell of position, direction and speed at once, which keeps what
repeats there. For every resample, with w the number of times each row was drawn::

    one step   dx = -(J' diag(w) J)^-1 J' diag(w) r,  less the same with w = 1, which is 0 at a minimum
    refitted   x minimises sum w r(x)^2

One step is a problem as linear as the covariance takes it to be, and costs no simulation; it differs from a sandwich in
that the information is drawn too, and that its intervals need not be symmetric. A refit sees the bend. What rests on
few rows, as the initial state does on the first, is missing from many resamples, and is then kept by the one step: no
bootstrap gives its deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Table
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.text import number
from jointid.solvers.solve import Problem
from jointid.uncertainty.covariance import bandwidth
from jointid.uncertainty.profile import refit

_FEWEST = 8  # blocks: fewer cannot say how far the parts of a record differ
_LOST = 0.05  # of the information on a direction: a resample that has less of it is not asked
_PER_BANDWIDTH = 3  # times the bandwidth of the autocorrelation is a block of time long
_EVALUATIONS, _TOLERANCE = 30, 1e-8  # of one refit


@dataclass(frozen=True, slots=True)
class Bootstrapping:
    """Settings of a bootstrap.

    Attributes:
        draws: resamples.
        level: of the percentile intervals; 0.9545 is that of 2 sigma.
        seed: of the draws.
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
        parameters: that were estimated.
        estimate: (free,) from the record itself.
        draws: (draws, free) from its resamples.
        level: of the intervals.
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

    def document(self, *, details: bool = False) -> Document:
        """Return the table; there are no further details."""
        del details
        rows = tuple(
            (p.symbol, number(float(value)), number(float(std), 2), number(float(low)), number(float(high)))
            for p, value, std, (low, high) in zip(self.parameters, self.estimate, self.std, self.intervals, strict=True)
        )
        header = ("symbol", "value", "sigma", f"{100 * self.level:.4g} % from", "to")
        return Document(f"{len(self.draws)} draws of {self.blocks} blocks: {self.how}", (Table(header, rows),))


def bootstrap_estimate(
    parameters: Sequence[Parameter],
    x: FloatArray,
    residual: FloatArray,
    J: FloatArray,
    labels: NDArray[np.intp] | None = None,
    settings: Bootstrapping | None = None,
    problem: Problem | None = None,
) -> Bootstrap:
    """Return the bootstrap over moving blocks of time, or over groups of rows that err together.

    Args:
        parameters: the free ones.
        x: (free,) the estimate.
        residual: (rows,) of it, in the order of time.
        J: (rows, free), its derivatives.
        labels: (rows,) the number of each row's group, such as `Cells.stretch` or `Cells.label`; None for blocks of
            time, three bandwidths of the autocorrelation long (`covariance.bandwidth`).
        settings: see `Bootstrapping`.
        problem: that was solved, to be fitted again to every resample, within its bounds; one linear step when None.

    Raises:
        MethodError: the record is too short, or there are too few groups.
    """
    settings = settings or Bootstrapping()
    random = np.random.default_rng(settings.seed)
    if labels is None:
        blocks, how, draw = _draw_in_time(residual.size, random)
    else:
        blocks, how, draw = _draw_groups(labels, random)
    step = _one_step(x, residual, J)

    def estimate(weights: FloatArray) -> FloatArray:
        if problem is None:
            return step(weights)
        root = np.sqrt(weights)
        changed = (lambda rows, _: root * rows), (lambda columns: root[:, np.newaxis] * columns)
        return refit(problem, x, *changed, _TOLERANCE, _EVALUATIONS).x

    draws = np.array([estimate(draw()) for _ in range(settings.draws)])
    said = f"{how}; {'one linear step' if problem is None else 'refitted'} each"
    return Bootstrap(tuple(parameters), np.array(x, dtype=np.float64), draws, settings.level, blocks, said)


def _draw_in_time(rows: int, random: np.random.Generator) -> tuple[int, str, Callable[[], FloatArray]]:
    """Return how many blocks are drawn, which, and what draws: the number of times each row was drawn, (rows,)."""
    length = _PER_BANDWIDTH * bandwidth(rows)
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
    """Return one Gauss-Newton step on a resample, about the one on the record.

    The columns are made orthogonal first: the normal equations of parameters that are nearly collinear lose half the
    digits. In these the record's own information is the identity, and what a resample has lost of it is seen.
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
