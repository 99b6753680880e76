"""Series: a joint's quantity over its runs by day, with outliers."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.campaigns.rows import Outcome, Row
from jointid.common.arrays import FloatArray

_FRICTIONS = ("coulomb", "viscous")
_TO_SIGMA = 1.4826  # from the median of absolute deviations, for a normal distribution
_WINDOW = 5  # runs, of which the middle one is the level: a step stays a step
_OUT = 6.0  # deviations from that level: of normal scatter one run in thousands is out by chance
_FEWEST = 8
"""Runs of which something can be said."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A quantity of a joint over its runs.

    Attributes:
        changes: of the joint file, that these runs have in common.
        quantity, unit: a parameter, or a sum of some.
        days: (runs,) in days since the year 1, or the number of the run where a day is not known.
        values: (runs,) in SI units.
        stds: (runs,) stated standard deviations.
        labels: (runs,) day of each, or its record's address.
    """

    joint: str
    changes: tuple[str, ...]
    quantity: str
    unit: str
    days: FloatArray
    values: FloatArray
    stds: FloatArray
    labels: tuple[str, ...]

    @property
    def enough(self) -> bool:
        """True if there are runs enough to say something of."""
        return self.values.size >= _FEWEST

    @property
    def scatter(self) -> float:
        """Robust standard deviation between runs, without slow changes."""
        return _TO_SIGMA / math.sqrt(2.0) * float(np.median(np.abs(np.diff(self.values))))

    @property
    def scatter_over_stated(self) -> float:
        """Scatter from run to run over the stated standard deviation."""
        return self.scatter / float(np.median(self.stds))

    @property
    def outlying(self) -> FloatArray:
        """(runs,) deviations of outliers from neighbouring runs; else 0."""
        if not self.enough:
            return np.zeros(self.values.size)
        off = self.values - _running_median(self.values)
        scale = np.maximum(self.stds, _TO_SIGMA * float(np.median(np.abs(off))))
        scale = np.maximum(scale, self.scatter)
        return np.where(np.abs(off) > _OUT * scale, off / scale, 0.0)

    def without_outlying(self) -> Series:
        """Return the series without outliers."""
        kept = self.outlying == 0
        return Series(
            self.joint, self.changes, self.quantity, self.unit, self.days[kept], self.values[kept], self.stds[kept],
            tuple(label for label, keep in zip(self.labels, kept, strict=True) if keep),
        )  # fmt: skip


def list_monitored(names: Sequence[str]) -> tuple[str, ...]:
    """Quantities monitored for drift: stiffness, and sums of frictions of both sides.

    Example:
        >>> from jointid.campaigns.series import watched
        >>> watched(["inertia", "stiffness", "motor_coulomb", "load_coulomb", "total_coulomb", "viscous"])
        ('stiffness', 'total_coulomb', 'viscous')
    """
    summed = {name.removeprefix("total_") for name in names if name.startswith("total_")}
    return tuple(
        name
        for name in names
        if name == "stiffness"
        or (
            any(friction in name for friction in _FRICTIONS)
            and name.removeprefix("motor_").removeprefix("load_") not in summed
        )
    )


def series_of(rows: Sequence[Row]) -> Iterator[Series]:
    """Yield the monitored series, joint by joint."""
    joints: dict[tuple[str, tuple[str, ...]], list[Row]] = {}
    for row in rows:
        if row.outcome is Outcome.IDENTIFIED:
            joints.setdefault((row.joint, row.changes), []).append(row)
    for (joint, changes), runs in joints.items():
        runs.sort(key=lambda row: row.place)
        names = list(dict.fromkeys(name for row in runs for name in row.found))
        for quantity in list_monitored(names):
            yield from _series(joint, changes, quantity, runs)


def _series(joint: str, changes: tuple[str, ...], quantity: str, runs: Sequence[Row]) -> Iterator[Series]:
    known = [(row, one) for row in runs if (one := row.found.get(quantity)) is not None and one.value is not None]
    found = [(row, one.value, one.std, one.unit) for row, one in known if one.std]
    if not found:
        return
    days = [_ordinal(row.day) for row, *_ in found]
    if None in days:
        days = [float(k) for k in range(len(found))]
    values, stds = np.array([(value, std) for _, value, std, _ in found], np.float64).T
    labels = tuple(row.day or row.record for row, *_ in found)
    yield Series(joint, changes, quantity, found[0][3], np.array(days, np.float64), values, stds, labels)


def _ordinal(day: str) -> float | None:
    """Day as an ordinal; None if missing or invalid."""
    try:
        return float(datetime.date.fromisoformat(day).toordinal())
    except ValueError:
        return None


def _running_median(values: FloatArray) -> FloatArray:
    """Median over neighbouring runs, (runs,)."""
    half = _WINDOW // 2
    at = np.clip(np.arange(values.size), half, values.size - 1 - half)
    return np.asarray(np.median(values[at[:, None] + np.arange(-half, half + 1)], axis=1))
