"""Does the joint stay what it is? Each segment of a long record by itself, and whether they agree.

A segment is a number of windows that follow each other. What it says alone is one Gauss-Newton step from what all of
them say, which is near. Its deviations come from how its windows differ, in units of what a window of it tells: so
measured, windows scatter alike in all segments, and from all of them together that is known well enough to test by
(from its own twenty windows for four parameters, one steady joint in four would be called drifting). That the segments
agree is tested as for records of their own (`agreement`), and a straight line through them tells how fast what
they say changes: a gear that warms up, a bearing that runs dry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.estimation.result.agreement import Agreement, Alone, agreement
from jointid.models.parameters import Parameter
from jointid.solvers.bounds import Bounds
from jointid.uncertainty.covariance import covariance_of
from jointid.uncertainty.jackknife import scale_of, step_of, total

if TYPE_CHECKING:
    from jointid.estimation.problems.log_windows import Window

_MOST = 24  # segments
_WINDOWS = 3  # in a segment at least, for each parameter
_SINGULAR = 1e-12  # of the largest: a direction that a segment does not tell
_TOLD = 1.0 - 1e-6  # of a parameter that lies in the directions that it tells
_HOUR = 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """The estimate from one part of a long log by itself.

    Attributes:
        begin, end: seconds from the first sample of the record.
        windows: in it.
        values: of the free parameters, by name, but for those that it does not tell, as friction backwards in hours
            that only go forwards; std: their standard deviations.
        filtered_error: what the joint of the whole record leaves of its filtered torque; a ratio.
    """

    begin: float
    end: float
    windows: int
    values: Mapping[str, float]
    std: Mapping[str, float]
    filtered_error: float


@dataclass(frozen=True, slots=True)
class Trend:
    """The straight line through what the segments say of a parameter.

    Attributes:
        name: of the parameter. per_hour: its change, in its unit. std: of that.
    """

    name: str
    per_hour: float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class DriftTest:
    """The test whether the parameters stay the same from the beginning of a long log to its end.

    Attributes:
        segments: in the order of time; none where the record is too short for two.
        agreement: whether they agree; None without them.
        trends: of the parameters that two segments tell, in their order.
    """

    segments: tuple[Segment, ...]
    agreement: Agreement | None
    trends: tuple[Trend, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters that change by more than their intervals allow."""
        return () if self.agreement is None else tuple(p.name for p in self.agreement.parameters if p.differs)


def drift(windows: Sequence[Window], x: FloatArray, free: Sequence[Parameter], units: Mapping[str, str]) -> DriftTest:
    """Return what the segments of a record say, and whether they agree.

    Args:
        windows: in the order of time, at x.
        x: (free,) what all of them say.
        free: the parameters.
        units: of the parameters, by name.
    """
    count = min(_MOST, len(windows) // (_WINDOWS * len(free)))
    if count < 2:
        return DriftTest((), None, ())
    names = [p.name for p in free]
    parts = [[windows[i] for i in part] for part in np.array_split(np.arange(len(windows)), count)]
    fits = [_Fit.of(part, x) for part in parts]
    scatter = _pooled(fits, [len(part) for part in parts])
    segments, alone = [], []
    for part, fit in zip(parts, fits, strict=True):
        own = np.flatnonzero(fit.told)
        covariance = covariance_of((fit.back @ scatter @ fit.back.T)[np.ix_(own, own)], 0)
        values = {names[i]: float(fit.values[i]) for i in own}
        std = dict(zip(values, map(float, covariance.std), strict=True))
        error = total([w.sums for w in part]).relative_error
        segments.append(Segment(part[0].begin, part[-1].end, len(part), values, std, error))
        alone.append(Alone(values, covariance))
    judged = agreement(alone, {name: units[name] for name in names})
    trends = tuple(_trend(scatter.name, segments) for scatter in judged.parameters)
    return DriftTest(tuple(segments), judged, trends)


def _pooled(fits: Sequence[_Fit], windows: Sequence[int]) -> FloatArray:
    """Return how the windows of all segments scatter, (free, free), in units of what a window tells.

    Args:
        fits: of the segments.
        windows: of each.
    """
    free, count = fits[0].values.size, sum(windows)
    degrees = count - len(fits)
    # By a covariance that is itself an estimate, a chi-square comes out so much too large (Hotelling).
    scatter = sum(np.where(np.outer(fit.told, fit.told), fit.scatter, 0.0) for fit in fits) / count
    scatter *= degrees / (degrees - free - 1)
    told = sum(fit.told * number for fit, number in zip(fits, windows, strict=True))
    share = np.sqrt(count / np.maximum(told, 1))  # what is not told does not scatter
    return np.asarray(np.outer(share, share) * scatter)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One segment, fitted.

    Attributes:
        values: (free,) where its windows agree.
        back: (free, free) the inverse root of its J'J, symmetric where every column of J has the length 1.
        scatter: (free, free) of its windows' scores, sum of the products, in units of what a window tells.
        told: (free,) whether it tells a parameter.
    """

    values: FloatArray
    back: FloatArray
    scatter: FloatArray
    told: NDArray[np.bool_]

    @classmethod
    def of(cls, windows: Sequence[Window], x: FloatArray) -> _Fit:
        """Return the fit of some windows, a step from x."""
        sums = total([w.sums for w in windows])
        step = step_of(sums, Bounds.none(x.size))
        scale = scale_of(sums.A)
        values, vectors = np.linalg.eigh(sums.A / np.outer(scale, scale))
        kept = values > _SINGULAR * values[-1]
        roots = np.where(kept, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
        back = (vectors * roots) @ vectors.T / scale[:, np.newaxis]
        # A window takes part in what it is compared with, one that tells much more than one that tells little.
        apart = [np.eye(x.size) - back.T @ w.sums.A @ back for w in windows]
        own = [back.T @ w.sums.moved(step).b for w in windows]
        scores = np.array([np.linalg.lstsq(a, b, rcond=1e-6)[0] for a, b in zip(apart, own, strict=True)])
        told = np.sum(vectors[:, kept] ** 2, axis=1) > _TOLD
        return cls(x + step, back, (len(windows) - 1) * scores.T @ scores, told)


def _trend(name: str, segments: Sequence[Segment]) -> Trend:
    """Return the weighted least-squares line through the segments that tell a parameter."""
    telling = [s for s in segments if name in s.values]
    hours = np.array([0.5 * (s.begin + s.end) for s in telling]) / _HOUR
    values, std = np.array([s.values[name] for s in telling]), np.array([s.std[name] for s in telling])
    weights = 1.0 / np.maximum(std, np.finfo(float).tiny) ** 2
    centred = hours - weights @ hours / weights.sum()
    power = float(weights @ centred**2)
    return Trend(name, float(weights @ (centred * values)) / power, 1.0 / math.sqrt(power))
