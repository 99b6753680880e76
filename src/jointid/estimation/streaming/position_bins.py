"""Where the axis was: what every visit to a place errs alike is no noise, and no longer record averages it away.

A window's residual, summed over its rows at one place, is a draw of its own; where nothing repeats, these draws have no
mean. With the sum s_cw of place c in window w, and n_cw rows, over all windows::

    z_c^2 = (sum_w s_cw)^2 / sum_w s_cw^2        chi-square, together, of as many degrees as there are places
    rms^2 = 1/n sum_c n_c ((sum_w s_cw)^2 - sum_w s_cw^2) / (n_c^2 - sum_w n_cw^2)

the latter from products of different windows only, as in `repeatable`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.uncertainty.jackknife import Sums
from jointid.uncertainty.position_dependent_error import Repeatable, cells

_PLACES = 6  # stretches of the travel: what a place errs, its neighbourhood errs alike (`repeatable`)
_AROUND = 64  # stretches after which places are taken to come again: an axis may turn for ever
_VISITS = 8  # windows, that a place must be visited in to say anything


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
    """What windows say at one place.

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
        """Return what one window says; see `Sums.of`."""
        total = float(error.sum())
        return cls(Sums.of(error, J, measured), total, total * total, 1, float(error.size) ** 2)

    def __add__(self, other: Place) -> Place:
        """Return what other windows say, too."""
        return Place(
            self.sums + other.sums, self.total + other.total, self.squares + other.squares, self.visits + other.visits,
            self.pairs + other.pairs,
        )  # fmt: skip


def repeats(places: Iterable[Place], square: float, unit: str) -> Repeatable:
    """Return what of the residual repeats with the motion.

    Args:
        places: over all windows.
        square: of the residual, over all rows.
        unit: of the residual.
    """
    from scipy.special import chdtrc

    every = list(places)
    rows = sum(p.sums.rows for p in every)
    known = [p for p in every if p.visits >= _VISITS and p.squares > 0]
    p_value = float(chdtrc(len(known), sum(p.total**2 / p.squares for p in known))) if known else None
    again = [p for p in known if p.sums.rows**2 > p.pairs]
    repeated = sum(p.sums.rows * (p.total**2 - p.squares) / (p.sums.rows**2 - p.pairs) for p in again) / max(rows, 1)
    return Repeatable(
        rms=math.sqrt(max(repeated, 0.0)),
        share=min(max(repeated, 0.0) * rows / square, 1.0) if square > 0 else 0.0,
        correlation=None,
        p_value=p_value,
        unit=unit,
    )
