"""Sums over groups of an estimate's rows, and the jackknife over them.

A Gauss-Newton step needs only J'J, J'e and e'e of each group of rows. Rows with correlated errors form a
group; groups are independent. Leaving out each group gives::

    d_g = -(A - A_g)^-1 (b - b_g)        V = (G - 1) / G  sum_g (d_g - mean)(d_g - mean)'

with A = sum_g J_g'J_g and b = sum_g J_g'e_g, 0 at the estimate. It holds for any correlation and variance within a
group and is conservative for few groups. Directions that a single group determines, and those after the first G - 1,
get the intervals of a white residual. Columns are scaled first, since J's condition number is squared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.uncertainty.covariance import Covariance, covariance_of, larger

_SINGULAR = 1e-12  # of the largest: a direction of the scaled parameters that nothing determines
_ALONE = 0.9  # of the information in a direction: the group is as good as alone


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

    def shift(self, step: FloatArray) -> Sums:
        """Update the sums for a step of the parameters, to first order."""
        square = self.square + float(2 * self.b @ step + step @ self.A @ step)
        return Sums(self.A, self.b + self.A @ step, max(square, 0.0), self.size, self.rows)


def total(groups: Sequence[Sums]) -> Sums:
    """Add the sums of all groups."""
    return sum(groups[1:], start=groups[0])


def rows_of(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Return the fewest rows with these sums: residual, (rows,), and derivatives, (rows, free)."""
    scale, sizes, vectors = _determine(sums.A)
    J = (vectors * np.sqrt(sizes)).T * scale
    error = vectors.T @ (sums.b / scale) / np.sqrt(sizes)
    rest = math.sqrt(max(sums.square - float(error @ error), 0.0))
    return np.append(error, rest), np.vstack([J, np.zeros(scale.size)])


def left_out(groups: Sequence[Sums]) -> Covariance:
    """Jackknife covariance over two or more groups."""
    whole = total(groups)
    scale, sizes, vectors = _determine(whole.A)
    outer = np.outer(scale, scale)
    steps = np.array(
        [-np.linalg.pinv((whole.A - g.A) / outer, hermitian=True) @ ((whole.b - g.b) / scale) for g in groups]
    )
    apart = steps - steps.mean(axis=0)
    found = covariance_of((len(groups) - 1) / len(groups) * apart.T @ apart)
    back = vectors / np.sqrt(sizes)
    most = max(float(np.linalg.eigvalsh(back.T @ (g.A / outer) @ back)[-1]) for g in groups)
    if most > _ALONE or len(groups) <= scale.size:
        white = covariance_of(whole.square / max(whole.rows - scale.size, 1) * back @ back.T)
        found = larger(white, found)
    return Covariance(found.std / scale, found.correlation)


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
