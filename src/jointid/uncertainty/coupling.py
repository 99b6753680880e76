"""What other axes that move do to this one: how much of its residual follows them, against what follows by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray

_SHIFTS = 200  # of the other axes against the residual: enough for a 95 % quantile
_LEVEL = 0.95
_APART = 0.05  # of the record: shifts by less still see the same motion


@dataclass(frozen=True, slots=True)
class Coupling:
    """How much of a residual's variance follows the motion of other axes.

    Attributes:
        explained: share, 0 to 1.
        by_chance: share that is explained, in 95 of 100 cases, where there is no coupling.
    """

    explained: float
    by_chance: float

    @property
    def seen(self) -> bool:
        """Whether more is explained than by chance."""
        return self.explained > self.by_chance


def coupling(residual: FloatArray, motion: FloatArray) -> Coupling:
    """Return how much of a residual other axes' motion explains, by least squares.

    The residual is not white, so the usual F test does not hold. What is explained by chance is found by turning the
    motion round against the residual, which keeps the spectrum of both: the 95 % quantile over such shifts.

    Args:
        residual: (rows,) of the filtered torque.
        motion: (rows, columns) of the other axes, filtered alike.
    """
    left = residual - residual.mean()
    columns = motion - motion.mean(axis=0)
    size = np.linalg.norm(columns, axis=0)
    Q, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    Q = Q[:, s > s[:1].sum() * 1e-10]
    total = float(left @ left)
    if total == 0.0 or Q.shape[1] == 0:
        return Coupling(0.0, 1.0)
    apart = max(int(_APART * left.size), 1)
    shifts = np.unique(np.linspace(apart, left.size - apart, _SHIFTS).astype(np.int64))
    shares = [float(np.sum((Q.T @ np.roll(left, shift)) ** 2)) / total for shift in shifts]
    return Coupling(float(np.sum((Q.T @ left) ** 2)) / total, float(np.quantile(shares, _LEVEL)))
