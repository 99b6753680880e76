"""Repeatable part of a residual, and intervals that cover it.

A position-dependent friction, a screw's pitch or a nonlinear spring leaves a residual that repeats at the same place,
direction and speed. A longer record does not average it away.

**Measured** from products of different visits only, so that noise does not contribute: with the sums s_cb of the
residual and the counts n_cb of the rows of cell c in block b of time, n_c rows of the cell in all, n of the record::

    rms^2 = 1/n  sum_c n_c  (sum_bb' s_cb s_cb') / (sum_bb' n_cb n_cb')      b, b' two blocks apart, or more

**Tested** by turning the signs of blocks of time at random (wild bootstrap, Liu 1988), valid for any autocorrelation
within a block, a fortieth of the record, and unequal accuracy.

**Covered**, if it is significant, by a second covariance (`by_place`) with scores summed over all visits to a cell, and
Bartlett weights over neighbouring cells of the same direction and speed (Conley 1999). The larger of both counts in
every direction (`larger`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.uncertainty.covariance import LEVEL, ROUNDING, Covariance, Influence, bandwidth, bartlett_sum, larger

RESTING = 0.02  # of the largest speed: below it a row has no direction

IntArray = NDArray[np.intp]

_POSITIONS = 24  # cells along the travel
_LAGS = bandwidth(_POSITIONS)  # cells along the travel, on each side, that err together with one
_SPEEDS = 3  # classes
_FLIPS = 999


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cell of position, direction and speed of each row.

    Attributes:
        label: (rows,) the number of the row's cell.
        position: (rows,) the number of the cell along the travel, from 0.
        family: (rows,) the number of the row's direction and class of speed.
        speeds: (classes,) mean speed of each class.
    """

    label: IntArray
    position: IntArray
    family: IntArray
    speeds: FloatArray

    @property
    def stretch(self) -> IntArray:
        """Index of each row's stretch of neighbouring cells of one family, (rows,)."""
        return np.asarray(self.family * _POSITIONS + self.position // (_LAGS + 1))


@dataclass(frozen=True, slots=True)
class Repeatable:
    """Part of a residual that repeats at equal place, direction and speed.

    Attributes:
        rms: of that part, in the residual's unit; 0 where the products of different visits are negative on the whole.
        share: its share of the residual's mean square.
        p_value: probability of as large a share without repetition; None if the record is too short or visits no
            place twice.
    """

    rms: float
    share: float
    p_value: float | None

    @property
    def significant(self) -> bool:
        """True if the repeating part is significant at 5 %."""
        return self.p_value is not None and self.p_value <= LEVEL

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        if self.p_value is None:
            return "whether the residual repeats with the motion cannot be said: no place is visited at two times"
        if not self.significant:
            return f"no part of the residual repeats with the motion beyond chance (p = {self.p_value:.2g})"
        return (
            f"{100 * self.share:.0f} % of the residual's mean square repeat with position, direction and speed "
            f"(p = {self.p_value:.2g}): the model lacks something that is not noise"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariances of the errors of an estimate.

    Attributes:
        covariance: robust against autocorrelation, and widened where the residual repeats with the motion.
        warnings: limits of the deviations, for the reader.
        shifts: (parameters,) each, of the estimate, for which the deviations were widened.
    """

    covariance: Covariance
    repeatable: Repeatable
    warnings: tuple[Message, ...] = ()
    shifts: tuple[FloatArray, ...] = ()

    def widened_by(self, shift: FloatArray) -> Uncertainty:
        """Widen the deviations for a shift of the estimate, (parameters,)."""
        covariance = replace(self.covariance, std=np.hypot(self.covariance.std, shift))
        return replace(self, covariance=covariance, shifts=(*self.shifts, shift))


def cells(position: FloatArray, velocity: FloatArray) -> Cells:
    """Assign rows to cells of position, direction and class of speed.

    Args:
        position: (rows,) of the motor, simulated or measured.
        velocity: (rows,).
    """
    speed = np.abs(velocity)
    moving = speed > RESTING * np.max(speed, initial=0.0)
    kind, means = _classify_speeds(speed, moving)
    direction = np.where(moving, np.sign(velocity), 0.0).astype(np.intp) + 1
    family = direction * _SPEEDS + np.where(moving, kind, 0)
    travel = float(np.ptp(position)) or 1.0
    place = np.minimum((position - position.min()) / travel * _POSITIONS, _POSITIONS - 1).astype(np.intp)
    _, label = np.unique(family * _POSITIONS + place, return_inverse=True)
    return Cells(label.reshape(-1), place, family, means)


def _classify_speeds(speed: FloatArray, moving: NDArray[np.bool_]) -> tuple[IntArray, FloatArray]:
    """Classify speeds by one-dimensional k-means, weighted by distance; return classes and means."""
    if not np.any(moving):
        return np.zeros(speed.size, dtype=np.intp), np.zeros(_SPEEDS)
    # Every metre counts the same, not every second, so that ramps and slow ways do not crowd the others out.
    travelled = np.cumsum(np.sort(speed[moving]))
    middle = np.searchsorted(travelled, (np.arange(_SPEEDS) + 0.5) / _SPEEDS * travelled[-1])
    means = np.sort(speed[moving])[middle]
    kind = np.zeros(speed.size, dtype=np.intp)
    for _ in range(50):
        kind = np.searchsorted(0.5 * (means[1:] + means[:-1]), speed)
        chosen = [speed[moving & (kind == i)] for i in range(_SPEEDS)]
        after = np.array([g @ g / g.sum() if g.size else mean for g, mean in zip(chosen, means, strict=True)])
        if np.array_equal(after, means):
            break
        means = after
    return kind, means


def repeatable(error: FloatArray, where: Cells) -> Repeatable:
    """Measure the repeatable part of a residual.

    Args:
        error: (rows,) the residual, in the order of time.
        where: its rows' cells.
    """
    rows = error.size
    length = max(-(-rows // 40), 3 * bandwidth(rows))  # of time, at most
    block = np.arange(rows) // length
    blocks = int(block[-1]) + 1
    shape = (int(where.label.max()) + 1, blocks)
    sums, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(sums, (where.label, block), error)
    np.add.at(counts, (where.label, block), 1.0)
    # Neighbouring blocks are left out: a visit that their border cuts would be correlated with itself.
    apart = np.abs(np.subtract.outer(np.arange(blocks), np.arange(blocks))) > 1
    pairs = np.einsum("cb,bd,cd->c", counts, 1.0 * apart, counts)
    visited = counts.sum(axis=1)
    weight = np.where(pairs > 0, visited / np.where(pairs > 0, pairs, 1.0), 0.0) / rows
    products = apart * (sums.T @ (weight[:, np.newaxis] * sums))
    square, total = float(products.sum()), float(error @ error) / rows
    p_value = None
    if blocks >= 6 and np.any(pairs > 0):  # of them, to say anything
        signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(_FLIPS, blocks))
        others = np.sum((signs @ products) * signs, axis=1)
        as_large = others >= square - ROUNDING * np.abs(products).sum()  # signs may leave every product as it is
        p_value = float(1 + np.sum(as_large)) / (_FLIPS + 1)
    share = min(max(square, 0.0) / total, 1.0) if total > 0 else 0.0
    return Repeatable(float(np.sqrt(max(square, 0.0))), share, p_value)


def by_place(influence: Influence, where: Cells) -> Covariance:
    """Covariance for errors shared by all visits to a cell.

    Smoother errors are covered too little. On the EMPS motion, in simulations, 95 % of the 2-sigma intervals hold the
    truth at a length of half a cell, 88-96 % at two and 80-98 % at four.
    """
    scores = influence.columns * influence.residual_left_out(where.stretch)[:, np.newaxis]
    sums = np.zeros((_POSITIONS, int(where.family.max()) + 1, scores.shape[1]))
    np.add.at(sums, (where.position, where.family), scores)
    return influence.covariance(bartlett_sum(sums, _LAGS))


def uncertainty(influence: Influence, where: Cells, covariance: Covariance | None = None) -> Uncertainty:
    """Covariance of an estimate's errors, including repeatable ones.

    Args:
        influence: the equations of the estimate, and their residual.
        where: the rows' cells.
        covariance: of what does not repeat; the robust one when None.
    """
    verdict, known = repeatable(influence.error, where), covariance or influence.robust()
    return Uncertainty(larger(known, by_place(influence, where)) if verdict.significant else known, verdict)
