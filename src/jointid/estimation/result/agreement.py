"""Test of agreement of several records, or of segments of one.

With the estimates x_k of K records and their covariances V_k, the common value is their generalised least squares. The
differences from it, weighted by the covariances, are chi-square if they agree (Wald; Cochran 1954)::

    Q = sum_k (x_k - x)' V_k^-1 (x_k - x)        of (K - 1) p degrees of freedom

jointly over p parameters, and of K - 1 for each by itself. If the joint p-value is below 5 %, parameters with single
p-values below 5 % disagree (Fisher's protected comparisons). A parameter with less than 5 % over p always disagrees
(Bonferroni). At most one in ten sets of agreeing records is then reported as disagreeing. The variance between runs is
that of DerSimonian and Laird (1986)::

    t^2 = max(0, (Q - (K - 1)) / (sum w - sum w^2 / sum w)),        w = 1 / V_k

It widens the deviation of the common value by ``t^2 sum w^2 / (sum w)^2``. From two records it is one number squared:
as uncertain as its own size. The records' errors are taken to be independent; errors that repeat in both of them (the
same friction at the same place) make them agree too well, and are not tested here.

A segment is a number of consecutive windows of a long record. Its own estimate is one Gauss-Newton step from the common
one. Its deviations come from the scatter of its windows, in units of a window's information. In these units windows
scatter alike in all segments, so that all segments together determine the scatter for the test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter
from jointid.common.text import number
from jointid.uncertainty.covariance import LEVEL, Covariance, Sums, covariance_of, determine, total


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """Estimate from one record, or one part of a long log, alone.

    Attributes:
        values: of the free parameters, by name, without undetermined ones, as friction backwards in hours of
            forward motion; covariance: of these, in that order.
        name: of the record or part.
        filtered_error: of its filtered torque, under the common joint; a ratio.
    """

    in_json = "std -covariance"
    values: Mapping[str, float]
    covariance: Covariance
    name: str = ""
    filtered_error: float = math.nan

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the values, by name."""
        return dict(zip(self.values, map(float, self.covariance.std), strict=True))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Difference of one parameter between records, or segments of one.

    Attributes:
        name, unit: of the parameter.
        p_value: probability of as large a difference of agreeing records.
        between: standard deviation between the runs, 0 if their own intervals explain the difference.
        differs: whether it disagrees, allowing for how many parameters were tested.
        widening: variance between records, added to that of the common value; 0 where the records agree.
    """

    name: str
    unit: str
    p_value: float
    between: float
    differs: bool
    widening: float


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Sums of one window of a long log.

    Attributes:
        begin, end: seconds from the first sample of the record, of what counts.
        sums: over its rows.
        at_limit: share of its periods in which the controller was at its limit.
    """

    begin: float
    end: float
    sums: Sums
    at_limit: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """Whether records agree, or the segments of a long one.

    Attributes:
        parameters: one by one.
        p_value: of all of them jointly; None if nothing was compared.
        parts: the records, or the segments in the order of time, each by itself.
        of: "records" or "segments".
    """

    in_json = "differs"
    parameters: tuple[Scatter, ...]
    p_value: float | None
    parts: tuple[Alone, ...] = ()
    of: str = "records"

    @property
    def differs(self) -> bool:
        """Whether the records differ significantly, jointly or in one parameter."""
        return any(p.differs for p in self.parameters) or (self.p_value is not None and self.p_value <= LEVEL)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters that differ by more than their intervals allow."""
        return tuple(p.name for p in self.parameters if p.differs)

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        if not self.differs or self.p_value is None:
            return f"the {self.of} agree within their intervals"
        off = [f"{p.name} by {number(p.between, 2)} {p.unit} rms" for p in self.parameters if p.differs]
        said = "; ".join(off) or "only all parameters together"
        return f"the {self.of} disagree by more than their intervals allow (p = {self.p_value:.2g}): {said}"


def compare_records(records: Sequence[Alone], units: Mapping[str, str], of: str = "records") -> Agreement:
    """Test whether records agree in their common parameters.

    Args:
        records: the estimate of each by itself, without its undetermined parameters.
        units: of the parameters, by name; those that are compared.
        of: "records" or "segments".
    """
    from scipy.special import chdtrc

    shared = [name for name in units if sum(name in r.values for r in records) > 1]
    if not shared:
        return Agreement((), None, tuple(records), of)
    p_value = float(chdtrc(*_jointly(records, shared)[::-1]))
    level, found = LEVEL if p_value <= LEVEL else LEVEL / len(shared), list[Scatter]()
    for name in shared:
        std = [r.covariance.std[[*r.values].index(name)] for r in records if name in r.values]
        weights = 1.0 / np.array(std) ** 2
        total, (statistic, degrees) = float(weights.sum()), _jointly(records, [name])
        apart = 2.0 * float(np.sum(np.triu(np.outer(weights, weights), 1))) / total  # sum w - sum w^2 / sum w, exactly
        between, own = math.sqrt(max(statistic - degrees, 0.0) / apart), float(chdtrc(degrees, statistic))
        widening = between**2 * float(weights @ weights) / total**2 if own <= level else 0.0
        found.append(Scatter(name, units[name], own, between, own <= level, widening))
    return Agreement(tuple(found), p_value, tuple(records), of)


def _jointly(records: Sequence[Alone], names: Sequence[str]) -> tuple[float, int]:
    """Return Q over several parameters, and its degrees of freedom."""
    rows, sought = [], []
    for values, covariance in ((one.values, one.covariance) for one in records):
        own = [name for name in names if name in values]
        if not own:
            continue
        at = [[*values].index(name) for name in own]
        sizes, directions = np.linalg.eigh(covariance.correlation[np.ix_(at, at)])
        whiten = (directions / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1]))).T / covariance.std[at]
        rows.append(whiten @ [[float(one == name) for name in names] for one in own])
        sought.append(whiten @ [values[name] for name in own])
    A, b = np.vstack(rows), np.concatenate(sought)
    scale = np.linalg.norm(A, axis=0)
    left = b - A / scale @ np.linalg.lstsq(A / scale, b, rcond=None)[0]
    return float(left @ left), b.size - len(names)


# The segments of a long record


def drift(
    windows: Sequence[Window], x: FloatArray, free: Sequence[Parameter], units: Mapping[str, str]
) -> Agreement | None:
    """Test whether a record's segments, of windows in order, agree; None if too short."""
    count = min(24, len(windows) // (3 * len(free)))  # three windows for each parameter or more
    if count < 2:
        return None
    names, fits, alone = [p.name for p in free], list[tuple[FloatArray, FloatArray, NDArray[np.bool_]]](), list[Alone]()
    parts = [[windows[i] for i in part] for part in np.array_split(np.arange(len(windows)), count)]
    # How the windows of all segments scatter, in units of what a window determines.
    scatter, stated = np.zeros((x.size, x.size)), np.zeros(x.size)
    for part in parts:
        sums = total([w.sums for w in part])
        scale, values, vectors = determine(sums.A)
        back = vectors / np.sqrt(values) @ vectors.T / scale[:, np.newaxis]  # a root of the inverse
        determined = np.sum(vectors**2, axis=1) > 1.0 - 1e-6
        step = -back @ (back.T @ sums.b)
        fits.append((x + step, back, determined))
        # A window takes part in what it is compared with, an informative one more than others.
        apart = [np.eye(x.size) - back.T @ w.sums.A @ back for w in part]
        own = [back.T @ w.sums.shift(step).b for w in part]
        scores = np.array([np.linalg.lstsq(a, b, rcond=1e-6)[0] for a, b in zip(apart, own, strict=True)]) * determined
        scatter += (len(part) - 1) * scores.T @ scores
        stated += len(part) * determined  # a parameter that is not determined does not scatter
    # By a covariance that is itself an estimate, a chi-square comes out so much too large (Hotelling).
    degrees, root = len(windows) - count, np.sqrt(np.maximum(stated, 1.0))
    scatter *= degrees / (degrees - x.size - 1) / np.outer(root, root)
    for part, (values, back, determined) in zip(parts, fits, strict=True):
        at = np.flatnonzero(determined)
        covariance = covariance_of((back @ scatter @ back.T)[np.ix_(at, at)])
        when = f"{part[0].begin / 3600:.2f} to {part[-1].end / 3600:.2f} h"
        error = total([w.sums for w in part]).relative_error
        alone.append(Alone({names[i]: float(values[i]) for i in at}, covariance, when, error))
    return compare_records(alone, {name: units[name] for name in names}, "segments")
