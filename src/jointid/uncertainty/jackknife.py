"""Least squares from sums over groups of rows, which need no more memory than a few numbers for each group.

A residual e and its derivatives J enter a Gauss-Newton step, and the covariance of where it ends, by J'J, J'e and e'e
alone. Rows that may err together are summed into a group; groups err independently of each other. What leaving out one
group after the other does to the estimate then says how far it may be off (the jackknife)::

    d_g = -(A - A_g)^-1 (b - b_g)        V = (G - 1) / G  sum_g (d_g - mean)(d_g - mean)'

with A = sum_g J_g'J_g and b = sum_g J_g'e_g, 0 where the estimate is. It holds whatever the correlation and the size of
the errors within a group are, and errs towards intervals that are too wide where there are few groups. What one group
tells alone nothing is left to be compared with, and no more directions than G - 1 scatter at all: there the intervals
are no narrower than those of a white residual. The square of J's condition number must stay within the digits of a
number: columns are scaled to one length first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.bounds import Bounds
from jointid.uncertainty.covariance import Covariance, covariance_of, larger

_SINGULAR = 1e-12  # of the largest: a direction of the scaled parameters that nothing tells
_ALONE = 0.9  # of what is told in a direction: the group is as good as alone


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """What of some rows a least-squares estimate needs.

    Attributes:
        A: (free, free) J'J. b: (free,) J'e. square: e'e. size: y'y of the filtered torque that e is left of.
        rows: how many there are.
    """

    A: FloatArray
    b: FloatArray
    square: float
    size: float
    rows: int

    @classmethod
    def of(cls, error: FloatArray, J: FloatArray, measured: FloatArray) -> Sums:
        """Return those of rows: a residual, (rows,), its derivatives, (rows, free), and what was measured, (rows,)."""
        return cls(J.T @ J, J.T @ error, float(error @ error), float(measured @ measured), error.size)

    @property
    def relative_error(self) -> float:
        """Norm of the residual over that of what was measured; 0 of nothing."""
        return float(np.sqrt(self.square / self.size)) if self.size > 0 else 0.0

    def __add__(self, other: Sums) -> Sums:
        """Return those of the rows of both."""
        return Sums(
            self.A + other.A, self.b + other.b, self.square + other.square, self.size + other.size,
            self.rows + other.rows,
        )  # fmt: skip

    def moved(self, step: FloatArray) -> Sums:
        """Return them as they are after a step of the parameters, to first order."""
        square = self.square + float(2 * self.b @ step + step @ self.A @ step)
        return Sums(self.A, self.b + self.A @ step, max(square, 0.0), self.size, self.rows)


def total(groups: Sequence[Sums]) -> Sums:
    """Return the sums over all groups, of which there is one or more."""
    return Sums(
        np.sum([g.A for g in groups], axis=0), np.sum([g.b for g in groups], axis=0), sum(g.square for g in groups),
        sum(g.size for g in groups), sum(g.rows for g in groups),
    )  # fmt: skip


def step_of(sums: Sums, room: Bounds) -> FloatArray:
    """Return the step that minimises ``||e + J s||^2`` within bounds on it, (free,)."""
    from scipy.optimize import lsq_linear

    R = root_of(sums)
    scale = scale_of(sums.A)
    columns = R / scale
    target = -np.linalg.lstsq(columns.T, sums.b / scale, rcond=None)[0]
    found = lsq_linear(columns, target, (room.lower * scale, room.upper * scale), method="bvls")
    return room.clip(found.x / scale)


def root_of(sums: Sums) -> FloatArray:
    """Return what stands for the derivatives of all rows, (told directions, free): R with R'R = J'J."""
    scale = scale_of(sums.A)
    values, vectors = np.linalg.eigh(sums.A / np.outer(scale, scale))
    kept = values > _SINGULAR * values[-1]
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T * scale)


def left_out(groups: Sequence[Sums]) -> Covariance:
    """Return the covariance of an estimate whose rows err together within each of two or more groups."""
    whole = total(groups)
    scale = scale_of(whole.A)
    outer = np.outer(scale, scale)
    steps = np.array(
        [-np.linalg.pinv((whole.A - g.A) / outer, hermitian=True) @ ((whole.b - g.b) / scale) for g in groups]
    )
    apart = steps - steps.mean(axis=0)
    found = covariance_of((len(groups) - 1) / len(groups) * apart.T @ apart, 0)
    values, vectors = np.linalg.eigh(whole.A / outer)
    kept = values > _SINGULAR * values[-1]
    back = vectors[:, kept] / np.sqrt(values[kept])
    most = max(float(np.linalg.eigvalsh(back.T @ (g.A / outer) @ back)[-1]) for g in groups)
    if most > _ALONE or len(groups) <= scale.size:
        white = covariance_of(whole.square / max(whole.rows - scale.size, 1) * back @ back.T, 0)
        found = larger(white, found)
    return Covariance(found.std / scale, found.correlation, 0)


def scale_of(A: FloatArray) -> FloatArray:
    """Return the lengths of the columns of J, of which A is J'J, and 1 for a column of zeros."""
    norms = np.sqrt(np.diag(A))
    return np.where(norms > 0, norms, 1.0)
