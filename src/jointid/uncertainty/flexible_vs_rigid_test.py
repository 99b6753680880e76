"""Flexible against rigid: a test where what is tested lies on a boundary.

A rigid joint is a flexible one whose compliance is 0, and no compliance is negative: the gain of the larger model is 0
in about half of all records that are really rigid, load share and damping mean nothing there, and the quantiles of the
usual likelihood-ratio test are wrong. So the distribution is made, not looked up. About the rigid fit the residual is::

    r + J a + E b,   b >= 0

with J its derivatives by the rigid parameters and E by the extra ones at the boundary (the compliance at a load
share, say). The statistic is what the cone of the b takes off the sum of squares, over the variance of what is left;
where the share is not known, several E are tried and the best counts, in every draw as in the record.

The draws are the larger model's residual with the signs of whole blocks turned at random (a wild bootstrap, Liu 1988).
That keeps the autocorrelation, and keeps the loud rows where they are, at the reversals and pulses in which a flexible
joint shows too. Moving the blocks about, as is more usual, would not. Where the cells of the motion are given, whole
stretches of them are turned as well, all visits together, and the less certain of the two answers counts: an error that
repeats with the motion must not be taken for a spring. Nothing is simulated.

E is best taken with the whole friction on the motor's side. With a share of it on the load's, a compliance also makes
the friction lag behind at reversals, as real ones do without any spring: on EMPS, which shows no mode, that direction
takes 7 % off the sum of squares (p < 0.001), the compliance alone 0.3-1.7 % (p > 0.01 over place).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.uncertainty.covariance import bandwidth, residual_left_out
from jointid.uncertainty.position_dependent_error import Cells

_PER_BANDWIDTH = 3  # times the bandwidth of the autocorrelation is a block of time long
_MOST = 8  # extra directions: their faces are all tried
_SINGULAR = 1e-10  # of its length: what remains of a direction that the rigid parameters make up


@dataclass(frozen=True, slots=True)
class BoundarySettings:
    """Settings of the test.

    Attributes:
        draws: of the signs.
        level: below which the larger model is believed.
        seed: of the draws.
    """

    draws: int = 1999
    level: float = 0.01
    seed: int = 0

    def __post_init__(self) -> None:
        if self.draws < 1 or not 0 < self.level < 1 or self.seed < 0:
            raise MethodError(
                "A test at a boundary needs 1 or more draws, a level between 0 and 1 and a seed of 0 or more; received "
                f"{self.draws}, {self.level} and {self.seed}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryTest:
    """Whether a record asks for the larger model.

    Attributes:
        statistic: what the extra directions take off the sum of squares, over the variance of what is left.
        p_value: how often as much is found where the smaller model is true.
        over: whose signs gave that: blocks of "time", or of "place".
        draws: (draws,) the statistic in them.
        extra: the best amounts of the extra directions, 0 or more.
        alternative: the number of the alternative that is best, from 0.
        gained: share of the sum of squares.
        level: below which the larger model is believed.
    """

    statistic: float
    p_value: float
    over: str
    draws: FloatArray
    extra: FloatArray
    alternative: int
    gained: float
    level: float

    @property
    def significant(self) -> bool:
        """Whether the record asks for the larger model."""
        return self.p_value <= self.level

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        verdict = "asks for" if self.significant else "does not ask for"
        how = f"p = {self.p_value:.2g} by {self.draws.size} draws of the residual's signs over {self.over}"
        return (
            f"the record {verdict} the flexible model: it takes {100 * self.gained:.2g} % off the sum of squares "
            f"(statistic {number(self.statistic, 3)}, {how})"
        )


def flexible_against_rigid(
    residual: FloatArray,
    J: FloatArray,
    extra: Sequence[FloatArray],
    where: Cells | None = None,
    fitted: float | None = None,
    settings: BoundarySettings | None = None,
) -> BoundaryTest:
    """Test whether extra directions, which only count forwards, explain more than chance would.

    Args:
        residual: (rows,) of the rigid fit, in the order of time.
        J: (rows, rigid), its derivatives by the rigid parameters.
        extra: alternatives, each (rows, directions): its derivatives by what is 0 at the boundary and positive beyond.
        where: the rows' cells, so that what repeats with the motion is provided for.
        fitted: sum of squares of a flexible fit, where one was made: it takes the place of the linear one.
        settings: see `BoundarySettings`.

    Raises:
        MethodError: there is no alternative, one has too many directions, or it does nothing the rigid parameters
            do not.
    """
    settings = settings or BoundarySettings()
    Q, cones = _cones(J, extra)
    rows = residual.size
    degrees = max(rows - J.shape[1] - max(cone.size for cone in cones), 1)
    rigid = float(residual @ residual - np.sum((Q.T @ residual) ** 2))
    gains = [cone.gain(-(cone.columns.T @ residual)[np.newaxis]) for cone in cones]
    best = int(np.argmax([float(gain[0]) for gain, _ in gains]))
    gain, amounts = float(gains[best][0][0]), gains[best][1][0]
    found = gain if fitted is None else max(rigid - fitted, 0.0)
    statistic = found / max((rigid - found) / degrees, 1e-300)
    columns = np.hstack([J, extra[best]])
    left = residual + cones[best].columns @ amounts - Q @ (Q.T @ residual)
    answers = []
    for over, blocks in _blocks(rows, where):
        draws = _draws(left, columns, Q, cones, blocks, degrees, settings)
        answers.append((float(1 + np.sum(draws >= statistic)) / (settings.draws + 1), over, draws))
    p_value, over, draws = max(answers, key=lambda answer: answer[0])
    share = found / rigid if rigid > 0 else 0.0
    return BoundaryTest(statistic, p_value, over, draws, amounts, best, share, settings.level)


@dataclass(frozen=True, slots=True, eq=False)
class _Cone:
    """The extra directions of one alternative, freed of the rigid parameters, and how to project on their cone."""

    columns: FloatArray

    @property
    def size(self) -> int:
        return int(self.columns.shape[1])

    def gain(self, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the best amounts take off the sum of squares, (draws,), and those amounts, (draws, size).

        `pull` is -E' e of each draw. The best is among the least squares on the faces of the cone, those of which
        that have no negative amount: all of them are tried.
        """
        G = self.columns.T @ self.columns
        gains, amounts = np.zeros(len(pull)), np.zeros_like(pull)
        for count in range(1, self.size + 1):
            for face in itertools.combinations(range(self.size), count):
                at = list(face)
                solved = np.linalg.lstsq(G[np.ix_(at, at)], pull[:, at].T, rcond=None)[0].T
                gain = np.sum(solved * pull[:, at], axis=1)
                better = np.all(solved >= 0, axis=1) & (gain > gains)
                gains = np.where(better, gain, gains)
                inside = np.zeros_like(pull)
                inside[:, at] = solved
                amounts = np.where(better[:, np.newaxis], inside, amounts)
        return gains, amounts


def _cones(J: FloatArray, extra: Sequence[FloatArray]) -> tuple[FloatArray, list[_Cone]]:
    """Return an orthonormal basis of the rigid parameters' columns, and the cones beside it."""
    U, sizes, _ = np.linalg.svd(J / column_norms(J), full_matrices=False)
    Q = U[:, sizes > _SINGULAR * sizes[0]]
    cones = []
    for columns in extra:
        beside = columns - Q @ (Q.T @ columns)
        lengths = np.linalg.norm(columns, axis=0)
        if columns.shape[1] > _MOST or not np.all(np.linalg.norm(beside, axis=0) > _SINGULAR * lengths):
            raise MethodError(
                f"The extra directions of an alternative are {_MOST} at most, and each does what the rigid parameters "
                f"cannot; received {columns.shape[1]}, of which "
                f"{int(np.sum(np.linalg.norm(beside, axis=0) <= _SINGULAR * lengths))} can be made up of those."
            )
        cones.append(_Cone(beside))
    if not cones:
        raise MethodError("A test at a boundary needs an alternative; received none.")
    return Q, cones


def _blocks(rows: int, where: Cells | None) -> list[tuple[str, NDArray[np.intp]]]:
    """Return what the rows are divided into: the number of each row's block."""
    found = [("time", np.arange(rows) // (_PER_BANDWIDTH * bandwidth(rows)))]
    if where is not None:
        found.append(("place", np.unique(where.stretch, return_inverse=True)[1].reshape(-1)))
    return found


def _draws(
    left: FloatArray,
    columns: FloatArray,
    Q: FloatArray,
    cones: Sequence[_Cone],
    block: NDArray[np.intp],
    degrees: int,
    settings: BoundarySettings,
) -> FloatArray:
    """Return the statistic with the signs of the blocks turned, (draws,)."""
    count = int(block.max()) + 1
    columns = columns / column_norms(columns)
    spread = np.asarray(np.linalg.pinv(columns.T @ columns), dtype=np.float64)
    noise = residual_left_out(columns, columns, left, spread, block)
    signs = np.random.default_rng(settings.seed).choice([-1.0, 1.0], size=(settings.draws, count))

    def summed(matrix: FloatArray) -> FloatArray:
        """Return the matrix's products with every draw, from those with every block."""
        sums = np.zeros((count, matrix.shape[1]))
        np.add.at(sums, block, matrix * noise[:, np.newaxis])
        return np.asarray(signs @ sums)

    rigid = float(noise @ noise) - np.sum(summed(Q) ** 2, axis=1)
    gains = np.max([cone.gain(-summed(cone.columns))[0] for cone in cones], axis=0)
    return np.asarray(gains / np.maximum((rigid - gains) / degrees, 1e-300))
