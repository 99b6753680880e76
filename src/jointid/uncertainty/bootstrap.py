"""Bootstrap of an estimate: its parts drawn again and again, with replacement.

The rows of the residual are drawn in blocks: stretches of time that may overlap, which keep their autocorrelation
(moving blocks, Kunsch 1989), or all the rows of one cell of position, direction and speed at once, which keeps what
repeats there. For every resample, with w the number of times each row was drawn::

    one step   dx = -(J' diag(w) J)^-1 J' diag(w) r,  less the same with w = 1, which is 0 at a minimum
    refitted   x minimises sum w r(x)^2

One step is a problem as linear as the covariance takes it to be, and costs no simulation; it differs from a sandwich in
that the information is drawn too, and that its intervals need not be symmetric. A refit sees the bend. What rests on
few rows, as the initial state does on the first, is missing from many resamples, and is then kept by the one step: no
bootstrap tells its deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Table
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.models.parameters import Parameter
from jointid.solvers.solve import Problem, Variable, solve
from jointid.solvers.trust_region import TrustRegion
from jointid.uncertainty.combination import Combination
from jointid.uncertainty.covariance import bandwidth

Refit: TypeAlias = Callable[[FloatArray], FloatArray]
"""From the number of times each row was drawn, (rows,), to the estimate, (free,)."""

_FEWEST = 8  # blocks: fewer cannot say how far the parts of a record differ
_LOST = 0.05  # of the information on a direction: a resample that has less of it is not asked
_PER_BANDWIDTH = 3  # times the bandwidth of the autocorrelation is a block of time long


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
        how: what was drawn, in words.
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

    def of(self, combination: Combination) -> tuple[float, float, tuple[float, float]]:
        """Return value, standard deviation and percentile interval of a weighted sum of the parameters.

        Raises:
            MethodError: one of those it weighs was not estimated.
        """
        weights = combination.vector(self.parameters)
        drawn = self.draws @ weights
        low, high = np.quantile(drawn, [0.5 - 0.5 * self.level, 0.5 + 0.5 * self.level])
        return float(weights @ self.estimate), float(np.std(drawn, ddof=1)), (float(low), float(high))

    def document(self, *, details: bool = False) -> Document:
        """Return the table; there are no further details."""
        del details
        rows = tuple(
            (p.symbol, number(float(value)), number(float(std), 2), number(float(low)), number(float(high)))
            for p, value, std, (low, high) in zip(self.parameters, self.estimate, self.std, self.intervals, strict=True)
        )
        header = ("symbol", "value", "sigma", f"{100 * self.level:.4g} % from", "to")
        return Document(f"{len(self.draws)} draws of {self.blocks} blocks: {self.how}", (Table(header, rows),))


def time_bootstrap(
    parameters: Sequence[Parameter],
    x: FloatArray,
    residual: FloatArray,
    J: FloatArray,
    settings: Bootstrapping | None = None,
    refit: Refit | None = None,
) -> Bootstrap:
    """Return the bootstrap over moving blocks of time.

    Args:
        parameters: the free ones.
        x: (free,) the estimate.
        residual: (rows,) of it, in the order of time.
        J: (rows, free), its derivatives.
        settings: see `Bootstrapping`.
        refit: estimates from a resample; one linear step when None.

    A block is three bandwidths of the autocorrelation long (`uncertainty.bandwidth`).

    Raises:
        MethodError: the record is too short.
    """
    rows = residual.size
    length = _PER_BANDWIDTH * bandwidth(rows)
    starts = rows - length + 1
    _require(starts, rows // length)
    how = f"moving blocks of {length} rows in time"

    def weights(random: np.random.Generator) -> FloatArray:
        begin = random.integers(starts, size=-(-rows // length))
        change = np.zeros(rows + 1)
        np.add.at(change, begin, 1.0)
        np.add.at(change, begin + length, -1.0)
        return np.asarray(np.cumsum(change)[:-1])

    return _drawn(parameters, x, residual, J, weights, rows // length, how, settings, refit)


def cell_bootstrap(
    parameters: Sequence[Parameter],
    x: FloatArray,
    residual: FloatArray,
    J: FloatArray,
    labels: NDArray[np.intp],
    settings: Bootstrapping | None = None,
    refit: Refit | None = None,
) -> Bootstrap:
    """Return the bootstrap over groups of rows that err together, such as `Cells.stretch` or `Cells.label`.

    Args:
        parameters: the free ones.
        x: (free,) the estimate.
        residual: (rows,) of it.
        J: (rows, free), its derivatives.
        labels: (rows,) the number of each row's group.
        settings: see `Bootstrapping`.
        refit: estimates from a resample; one linear step when None.

    Raises:
        MethodError: there are too few groups.
    """
    groups, member = np.unique(labels, return_inverse=True)
    _require(groups.size, groups.size)
    how = "cells of position, direction and speed, all visits together"

    def weights(random: np.random.Generator) -> FloatArray:
        times = np.bincount(random.integers(groups.size, size=groups.size), minlength=groups.size)
        return np.asarray(times[member.reshape(-1)], dtype=np.float64)

    return _drawn(parameters, x, residual, J, weights, groups.size, how, settings, refit)


def refitted(problem: Problem, x: FloatArray, evaluations: int = 30, tolerance: float = 1e-8) -> Refit:
    """Return the full refit of a problem to a resample, from an estimate, within the bounds.

    Args:
        problem: that was solved.
        x: (free,) where each refit starts.
        evaluations: at most, of one refit.
        tolerance: relative, on the sum of squares and on the parameters.
    """
    solver = TrustRegion(tolerance, evaluations, eager=False)

    def refit(weights: FloatArray) -> FloatArray:
        return solve(_Weighted(problem, np.sqrt(weights)), solver, x).x

    return refit


@dataclass(frozen=True, slots=True, eq=False)
class _Weighted:
    """A problem with every row multiplied, (rows,)."""

    problem: Problem
    by: FloatArray

    @property
    def free(self) -> tuple[Variable, ...]:
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.by * self.problem.residual(x))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, J = self.problem.linearised(x)
        return self.by * residual, self.by[:, np.newaxis] * J


def _require(choices: int, blocks: int) -> None:
    if min(choices, blocks) < _FEWEST:
        raise MethodError(
            f"A bootstrap draws from {_FEWEST} blocks or more; this record has {max(blocks, 0)}: use a longer one."
        )


def _drawn(
    parameters: Sequence[Parameter],
    x: FloatArray,
    residual: FloatArray,
    J: FloatArray,
    weights: Callable[[np.random.Generator], FloatArray],
    blocks: int,
    how: str,
    settings: Bootstrapping | None,
    refit: Refit | None,
) -> Bootstrap:
    settings = settings or Bootstrapping()
    random = np.random.default_rng(settings.seed)
    estimate = refit or _one_step(x, residual, J)
    draws = np.array([estimate(weights(random)) for _ in range(settings.draws)])
    said = f"{how}; {'one linear step' if refit is None else 'refitted'} each"
    return Bootstrap(tuple(parameters), np.array(x, dtype=np.float64), draws, settings.level, blocks, said)


def _one_step(x: FloatArray, residual: FloatArray, J: FloatArray) -> Refit:
    """Return one Gauss-Newton step on a resample, about the one on the record.

    The columns are made orthogonal first: the normal equations of parameters that are hardly told apart lose half the
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
