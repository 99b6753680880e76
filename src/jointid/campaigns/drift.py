"""Series of a joint by day, and tests for significant changes.

For runs ``y_i`` with standard deviations ``s_i``, each shape ``c`` of change, a step before any of the runs or a trend
over the days, is fitted by weighted least squares,

    y_i = a + b c_i + e_i,    var(e_i) = k (s_i^2 + r^2),

``r^2`` the excess of the robust scatter between runs over the stated one, ``k`` the remaining variance, at least 1, and
``s_i`` at least the median one. ``b`` over its deviation is Student's with two degrees of freedom less than runs. The
p-value of the best shape is multiplied by the number of shapes (Bonferroni, conservative). Runs have to scatter
independently. Over all quantities of all joints, Holm's procedure (Scand. J. Statist. 6, 1979) bounds the chance of any
false alarm.

Limits: a step needs three runs on either side. Temporary changes, as by a warm week, and common changes, as by
temperature, are reported. Outliers are left out and reported elsewhere.
"""

from __future__ import annotations

import datetime
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.campaigns.run import Outcome, Row
from jointid.common.arrays import FloatArray

FALSE_ALARM = 0.01
"""Probability that any joint of a fleet without drift is reported."""

_SIDE = 3  # fewest runs on either side of a step


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """The best-fitting change of a joint's quantity over its runs.

    Attributes:
        series: the runs without outliers.
        kind: a step or a trend.
        since: day of the first run after a step; for a trend, of the first run.
        before, after: levels before and after, in SI units; for a trend, at the first and last run.
        std: standard deviation of their difference.
        p_value: probability of so large a change of any shape without drift.
        significant: whether it is reported; see `judge`.
    """

    series: Series
    kind: Literal["step", "trend"]
    since: str
    before: float
    after: float
    std: float
    p_value: float
    significant: bool = False

    @property
    def change_percent(self) -> float:
        """The change as a percentage of the level before."""
        return 100 * (self.after - self.before) / self.before if self.before else float("inf")


def best_change(series: Series) -> Change | None:
    """Fit the best change of a series; None with too few runs.

    Example:
        >>> import numpy as np
        >>> from jointid.campaigns.drift import Series, best_change
        >>> days, noise = np.arange(20.0), np.random.default_rng(1).standard_normal(20)
        >>> values = np.where(days < 12, 100.0, 90.0) + noise
        >>> labels = tuple("abcdefghijklmnopqrst")
        >>> found = best_change(Series("axis 1", (), "stiffness", "N/m", days, values, np.ones(20), labels))
        >>> found.kind, found.since, round(found.change_percent), found.p_value < 1e-6
        ('step', 'm', -10, True)
    """
    from scipy.special import stdtr

    kept = series.without_outlying()
    if not kept.enough:
        return None
    runs = kept.days.size
    steps = [np.arange(runs) >= first for first in range(_SIDE, runs - _SIDE + 1)]
    span = kept.days[-1] - kept.days[0]
    trend = [(kept.days - kept.days[0]) / span] if span > 0 else []
    shapes = np.array([*steps, *trend], dtype=np.float64)
    slopes, levels, stds = _fit(kept, shapes)
    freedom = kept.values.size - 2
    best = int(np.argmax(np.abs(slopes) / stds))
    p_value = min(1.0, shapes.shape[0] * 2 * float(stdtr(freedom, -abs(slopes[best]) / stds[best])))
    shape, slope = shapes[best], float(slopes[best])
    is_step = best < kept.values.size - 2 * _SIDE + 1
    since = int(np.argmax(shape > 0)) if is_step else 0
    before, after = (float(levels[best] + slope * end) for end in (shape[0], shape[-1]))
    return Change(kept, "step" if is_step else "trend", kept.labels[since], before, after, float(stds[best]), p_value)


def judge(series: Iterable[Series], false_alarm: float = FALSE_ALARM) -> tuple[Change, ...]:
    """Best change of every series by p-value, tested by Holm's procedure."""
    found = sorted((one for each in series if (one := best_change(each)) is not None), key=lambda one: one.p_value)
    named = 0
    while named < len(found) and found[named].p_value <= false_alarm / (len(found) - named):
        named += 1
    return tuple(replace(one, significant=k < named) for k, one in enumerate(found))


def _fit(series: Series, shapes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slope, level and slope deviation of each shape, (shapes,) each."""
    unstated = max(series.scatter**2 - float(np.median(series.stds)) ** 2, 0.0)
    # Bound the weights by that of the median deviation: a run with an understated deviation would dominate the fit
    # and hide the scatter of the others.
    weights = 1.0 / (np.maximum(series.stds, np.median(series.stds)) ** 2 + unstated)
    share = weights / weights.sum()
    y = series.values - float(share @ series.values)
    means = shapes @ share
    centred = shapes - means[:, None]
    information = centred**2 @ weights
    slopes = centred @ (weights * y) / information
    left = y - slopes[:, None] * centred
    excess = np.maximum((left**2 @ weights) / (series.values.size - 2), 1.0)
    return slopes, float(share @ series.values) - slopes * means, np.sqrt(excess / information)


_FRICTIONS = ("coulomb", "viscous")
_TO_SIGMA = 1.4826  # from the median of absolute deviations, for a normal distribution
_WINDOW = 5  # runs of a running median, which preserves steps
_OUT = 6.0  # deviations from that median: with normal scatter one run in thousands is an outlier by chance
_FEWEST = 8  # runs that a test needs


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A quantity of a joint over its runs.

    Attributes:
        changes: to the joint file, common to these runs.
        quantity, unit: a parameter, or a sum of parameters.
        days: (runs,) in days since the year 1, or indices of the runs if a day is unknown.
        values: (runs,) in SI units.
        stds: (runs,) stated standard deviations.
        labels: (runs,) days, or paths of the records.
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
        """True if there are enough runs to test."""
        return self.values.size >= _FEWEST

    @property
    def scatter(self) -> float:
        """Robust standard deviation between runs, without slow changes."""
        return _TO_SIGMA / math.sqrt(2.0) * float(np.median(np.abs(np.diff(self.values))))

    @property
    def outlying(self) -> FloatArray:
        """(runs,) deviations of outliers from neighbouring runs; else 0."""
        if not self.enough:
            return np.zeros(self.values.size)
        half = _WINDOW // 2
        at = np.clip(np.arange(self.values.size), half, self.values.size - 1 - half)
        off = self.values - np.asarray(np.median(self.values[at[:, None] + np.arange(-half, half + 1)], axis=1))
        scale = np.maximum(self.stds, _TO_SIGMA * float(np.median(np.abs(off))))
        scale = np.maximum(scale, self.scatter)
        return np.where(np.abs(off) > _OUT * scale, off / scale, 0.0)

    def without_outlying(self) -> Series:
        """Return the series without outliers."""
        kept = self.outlying == 0
        labels = tuple(label for label, keep in zip(self.labels, kept, strict=True) if keep)
        return replace(self, days=self.days[kept], values=self.values[kept], stds=self.stds[kept], labels=labels)


@dataclass(frozen=True, slots=True)
class Loss:
    """A joint or quantity without a value in its last runs.

    Attributes:
        joint: its name.
        changes: to the joint file, common to its runs.
        quantity: empty if the joint has no answer at all.
        last: day or record of the last run with a value; empty if there is none.
        runs: number of runs since then.
        sentence: why the last run has no value.
    """

    joint: str
    changes: tuple[str, ...]
    quantity: str
    last: str
    runs: int
    sentence: str


def losses_of(rows: Sequence[Row]) -> Iterator[Loss]:
    """Yield joints and quantities without a value in recent runs."""
    for (joint, changes), runs in _by_joint(rows).items():
        answered = [row.outcome is Outcome.IDENTIFIED for row in runs]
        since = _runs_since(answered)
        if since >= _SIDE:
            yield Loss(joint, changes, "", _label(runs[-since - 1]) if any(answered) else "", since, runs[-1].sentence)
            continue
        kept = [row for row, done in zip(runs, answered, strict=True) if done]
        for quantity in select_quantities(list(dict.fromkeys(name for row in kept for name in row.found))):
            known = [one is not None and one.value is not None for one in (row.found.get(quantity) for row in kept)]
            if any(known) and (since := _runs_since(known)) >= _SIDE:
                yield Loss(joint, changes, quantity, _label(kept[-since - 1]), since, kept[-1].sentence)


def _runs_since(known: Sequence[bool]) -> int:
    """Count the trailing False values."""
    return next((k for k, one in enumerate(reversed(known)) if one), len(known))


def name_series(joint: str, changes: Sequence[str]) -> str:
    """Return the name of a joint with the changes of its file."""
    return f"{joint} ({'; '.join(changes)})" if changes else joint


def _label(row: Row) -> str:
    return row.day or row.record


def _by_joint(rows: Sequence[Row]) -> dict[tuple[str, tuple[str, ...]], list[Row]]:
    """Return runs by joint and settings, in order."""
    joints = defaultdict[tuple[str, tuple[str, ...]], list[Row]](list)
    for row in sorted(rows, key=lambda row: row.place):
        joints[row.joint, row.changes].append(row)
    return joints


def select_quantities(names: Sequence[str]) -> tuple[str, ...]:
    """Quantities monitored for drift: stiffness, and sums of frictions of both sides.

    Example:
        >>> from jointid.campaigns.drift import select_quantities
        >>> select_quantities(["inertia", "stiffness", "motor_coulomb", "load_coulomb", "total_coulomb", "viscous"])
        ('stiffness', 'total_coulomb', 'viscous')
    """
    summed = {name.removeprefix("total_") for name in names if name.startswith("total_")}
    return tuple(
        name
        for name in names
        if name.rpartition(".")[2] == "stiffness"
        or (
            any(friction in name for friction in _FRICTIONS)
            and name.removeprefix("motor_").removeprefix("load_") not in summed
        )
    )


def series_of(rows: Sequence[Row]) -> Iterator[Series]:
    """Yield the monitored series, joint by joint."""
    for (joint, changes), runs in _by_joint([row for row in rows if row.outcome is Outcome.IDENTIFIED]).items():
        names = list(dict.fromkeys(name for row in runs for name in row.found))
        for quantity in select_quantities(names):
            known = [(row, one) for row in runs if (one := row.found.get(quantity)) is not None]
            found = [(row, one.value, one.std, one.unit) for row, one in known if one.value is not None and one.std]
            if not found:
                continue
            try:
                days = [float(datetime.date.fromisoformat(row.day).toordinal()) for row, *_ in found]
            except ValueError:  # a day is missing or invalid
                days = [float(k) for k in range(len(found))]
            values, stds = np.array([(value, std) for _, value, std, _ in found], np.float64).T
            labels = tuple(_label(row) for row, *_ in found)
            yield Series(joint, changes, quantity, found[0][3], np.array(days, np.float64), values, stds, labels)
