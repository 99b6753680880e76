"""Profile likelihood: how far one quantity can go while everything else makes the best of it.

An interval from a covariance is that of a problem that is linear. Where the criterion bends, or a bound is near, the
quantity c is held at one value after the other, all parameters are fitted again, and the interval ends where the sum
of squares has risen by::

    t^2 V / (w' (J' J)^-1 w)

with t the quantile of Student's distribution at the level asked for, w the weights of c in the parameters, J the
sensitivities at the estimate and V the variance of c in the covariance that is to be believed. For a white residual
V = s^2 w' (J' J)^-1 w and this is the likelihood ratio, ``t^2 s^2``; for any other the ratio of the two variances
scales it, so that a linear problem gives exactly the interval of that covariance.

c is held by one more row, ``rho (w' x - c)``, not exactly: where that fit ends is exactly the best one at *its* c,
which is what is noted, and bounds on the parameters stay what they are.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.solvers.solve import Bounds, Counted, Problem, Variable, solve
from jointid.solvers.trust_region import TrustRegion
from jointid.uncertainty.combination import Combination
from jointid.uncertainty.covariance import Covariance, robust

_HELD = 100.0  # times stiffer than the criterion is c held: it then yields by 1e-4 of its distance
_FIRST = 0.5  # of the way to where a linear problem would end
_BEYOND = 1.05  # of the threshold's root, aimed at
_FAR = 1.5  # times the threshold's root: a point beyond is not used to interpolate unless nothing nearer is found
_NARROW = 0.02  # of the way from the estimate: a bracket this narrow needs no more points
_UNSEEN = 1e-9  # of the largest: a normalised singular value whose direction leaves no trace in the residual
_IMPROVED = 1e-3  # of the threshold: a fit so much below the estimate says that it was no minimum


@dataclass(frozen=True, slots=True)
class Profiling:
    """Settings of a profile.

    Attributes:
        level: of the interval; 0.9545 is that of 2 sigma.
        points: at most, on each side.
        evaluations: at most, of one fit.
        tolerance: relative, of a fit, on the sum of squares and on the parameters.
    """

    level: float = 0.9545
    points: int = 14
    evaluations: int = 30
    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        if not 0 < self.level < 1 or min(self.points, self.evaluations) < 1 or self.tolerance <= 0:
            raise MethodError(
                "A profile needs a level between 0 and 1, 1 or more points and evaluations and a positive tolerance; "
                f"received {self.level}, {self.points}, {self.evaluations} and {self.tolerance}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """How the criterion rises as one quantity is held away from its estimate.

    Attributes:
        name, formula, unit: of the quantity.
        estimate: of it.
        level: of the interval.
        points: (points,) its values, in increasing order, the estimate among them.
        rise: (points,) of the sum of squares over the lowest found.
        parameters: (points, free) the best at each.
        threshold: the rise at which the interval ends.
        interval: its ends; None on a side where the criterion stays below the threshold up to the bound, or as far as
            was searched.
        reached: the last value on each side.
        improved: whether a fit went below the estimate, which then was not the minimum.
        evaluations: of the criterion, with or without derivatives.
    """

    name: str
    formula: str
    unit: str
    estimate: float
    level: float
    points: FloatArray
    rise: FloatArray
    parameters: FloatArray
    threshold: float
    interval: tuple[float | None, float | None]
    reached: tuple[float, float]
    improved: bool
    evaluations: int

    @property
    def bounded(self) -> bool:
        """Whether the record bounds the quantity on both sides."""
        return None not in self.interval

    def __str__(self) -> str:
        """Return the interval in a sentence."""
        lower = "; the estimate was not the minimum" if self.improved else ""
        return (
            f"{self.formula} = {number(self.estimate)} {self.unit}, {100 * self.level:.4g} % profile interval "
            f"{self._ends()} ({self.evaluations} evaluations{lower})"
        )

    def _ends(self) -> str:
        low, high = (number(end, 4) for end in self.interval)
        first, last = (number(value, 4) for value in self.reached)
        return {
            (True, True): f"{low} to {high}",
            (False, True): f"below {high}, without an end down to {first}",
            (True, False): f"above {low}, without an end up to {last}",
            (False, False): f"without an end from {first} to {last}",
        }[self.interval[0] is not None, self.interval[1] is not None]


@dataclass(slots=True, eq=False)
class _Point:
    value: float
    cost: float
    x: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """A problem with one more row, which holds a quantity near a value."""

    problem: Problem
    weights: FloatArray
    row: float
    value: float

    @property
    def free(self) -> tuple[Variable, ...]:
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        return np.append(self.problem.residual(x), self._held(x))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, J = self.problem.linearised(x)
        return np.append(residual, self._held(x)), np.vstack([J, self.row * self.weights])

    def _held(self, x: FloatArray) -> float:
        return float(self.row * (self.weights @ x - self.value))


@dataclass(frozen=True, slots=True)
class _Walk:
    """The fits of one profile."""

    problem: Counted
    weights: FloatArray
    row: float
    settings: Profiling

    def fitted(self, x: FloatArray, value: float) -> _Point:
        """Return the best fit near a value of the quantity, from a start that may be outside the bounds."""
        solver = TrustRegion(self.settings.tolerance, self.settings.evaluations, eager=False)
        end = solve(_Held(self.problem, self.weights, self.row, value), solver, x)
        error = end.residual[:-1]
        return _Point(float(self.weights @ end.x), float(error @ error), end.x)

    def reach(self, sign: float) -> float:
        """Return how far the parameters' bounds let the quantity go on one side, which may be infinity."""
        bounds = Bounds.of(self.problem.free)
        up = np.where(self.weights * sign > 0, bounds.upper, bounds.lower)
        used = self.weights != 0
        return float(np.sum(self.weights[used] * up[used]))


def profile(
    problem: Problem,
    x: FloatArray,
    combination: Combination,
    covariance: Covariance | None = None,
    settings: Profiling | None = None,
) -> Profile:
    """Return the profile of a parameter, or of a weighted sum of parameters, about an estimate.

    Args:
        problem: that was solved.
        x: (free,) where.
        combination: the quantity; `ByCompliance` turns a stiffness into a compliance first.
        covariance: of the free parameters, to be believed; autocorrelation-robust when None.
        settings: see `Profiling`.

    Raises:
        MethodError: the combination is of parameters that are not free.
    """
    from scipy.stats import t as student

    settings = settings or Profiling()
    weights = combination.vector(problem.free)
    counted = Counted(problem)
    residual, J = counted.linearised(x)
    covariance = covariance or robust(J, J, residual)
    direction, flat = _least_rise(J, weights)
    std = covariance.std_of(weights)
    if flat is None or std == 0.0:
        return _alone(combination, settings, x, weights, seen=flat is not None)
    quantile = float(student.ppf(0.5 + 0.5 * settings.level, max(residual.size - x.size, 1)))
    threshold = quantile**2 * std**2 / flat
    walk = _Walk(counted, weights, _HELD / math.sqrt(flat), settings)
    centre = _Point(float(weights @ x), float(residual @ residual), np.array(x, dtype=np.float64))
    step = _FIRST * quantile * std
    below = _side(walk, centre, -1.0, step, direction, threshold)
    above = _side(walk, centre, 1.0, step, direction, threshold)
    found = sorted([*below, centre, *above], key=lambda point: point.value)
    lowest = min(found, key=lambda point: point.cost)
    rise = np.array([point.cost - lowest.cost for point in found])
    values, best = np.array([point.value for point in found]), found.index(lowest)
    return Profile(
        combination.name,
        combination.formula,
        combination.unit,
        centre.value,
        settings.level,
        values,
        rise,
        np.array([point.x for point in found]),
        threshold,
        (
            _crossing(values[best::-1], rise[best::-1], threshold),
            _crossing(values[best:], rise[best:], threshold),
        ),
        (float(values[0]), float(values[-1])),
        centre.cost - lowest.cost > _IMPROVED * threshold,
        counted.evaluations,
    )


def _least_rise(J: FloatArray, weights: FloatArray) -> tuple[FloatArray, float | None]:
    """Return how all parameters follow per unit of the quantity, and ``w' (J' J)^-1 w``; None if nothing shows it."""
    norms = column_norms(J)
    _, sizes, directions = np.linalg.svd(J / norms, full_matrices=False)
    seen = sizes > _UNSEEN * sizes[0]
    along = directions @ (weights / norms)
    if np.linalg.norm(along[~seen]) > _UNSEEN * np.linalg.norm(along):
        return weights, None
    flat = float(np.sum((along[seen] / sizes[seen]) ** 2))
    follows = directions[seen].T @ (along[seen] / sizes[seen] ** 2) / norms / flat
    return np.asarray(follows), flat


def _alone(combination: Combination, settings: Profiling, x: FloatArray, weights: FloatArray, seen: bool) -> Profile:
    """Return the profile of what is not searched: it leaves no trace in the residual, or is known without error."""
    value = float(weights @ x)
    interval = (value, value) if seen else (None, None)
    return Profile(
        combination.name, combination.formula, combination.unit, value, settings.level, np.array([value]),
        np.zeros(1), np.array([x]), 0.0, interval, (value, value), False, 1,
    )  # fmt: skip


def _side(
    walk: _Walk, centre: _Point, sign: float, step: float, direction: FloatArray, threshold: float
) -> list[_Point]:
    """Return points on one side of the estimate, out to the threshold, the bound or the last one allowed.

    The root of the rise over the threshold is nearly linear in the quantity: it says how far to go.
    """
    end, found = walk.reach(sign), [centre]
    lowest = centre.cost
    while len(found) <= walk.settings.points:
        inside, outside = _bracket(found, lowest, threshold)
        if outside is None:
            target = inside.value + sign * step
            target = min(target, end) if sign > 0 else max(target, end)
        elif _close(inside, outside, centre, lowest, threshold):
            break
        else:
            target = 0.5 * (inside.value + outside.value)
        point = walk.fitted(inside.x + (target - inside.value) * direction, target)
        found.append(point)
        lowest = min(lowest, point.cost)
        if outside is None:
            if sign * (end - point.value) <= 1e-3 * step:  # held by the bounds
                break
            step, direction = _next(inside, point, lowest, threshold, step, direction)
    return found[1:]


def _root(point: _Point, lowest: float, threshold: float) -> float:
    return math.sqrt(max(point.cost - lowest, 0.0) / threshold)


def _bracket(found: list[_Point], lowest: float, threshold: float) -> tuple[_Point, _Point | None]:
    """Return the last point below the threshold and the first above it, going outwards."""
    outwards = sorted(found, key=lambda point: abs(point.value - found[0].value))
    for before, after in itertools.pairwise(outwards):
        if _root(after, lowest, threshold) >= 1:
            return before, after
    return outwards[-1], None


def _close(inside: _Point, outside: _Point, centre: _Point, lowest: float, threshold: float) -> bool:
    """Whether the interval's end is known well enough between two points."""
    narrow = abs(outside.value - inside.value) <= _NARROW * abs(outside.value - centre.value)
    return narrow or _root(outside, lowest, threshold) <= _FAR


def _next(
    before: _Point, point: _Point, lowest: float, threshold: float, step: float, direction: FloatArray
) -> tuple[float, FloatArray]:
    """Return the next step, and how the other parameters follow, by the last two points."""
    went = point.value - before.value
    if abs(went) <= 1e-6 * step:
        return 2 * step, direction
    slope = (_root(point, lowest, threshold) - _root(before, lowest, threshold)) / abs(went)
    wanted = (_BEYOND - _root(point, lowest, threshold)) / slope if slope > 0 else math.inf
    return min(max(wanted, 0.5 * step), 2 * step), (point.x - before.x) / went


def _crossing(values: FloatArray, rise: FloatArray, threshold: float) -> float | None:
    """Return where the rise passes the threshold, going outwards; None if it does not."""
    above = np.flatnonzero(rise >= threshold)
    if not above.size:
        return None
    i = int(above[0])
    roots = np.sqrt(np.maximum(rise[i - 1 : i + 1], 0.0))
    share = (math.sqrt(threshold) - roots[0]) / (roots[1] - roots[0])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))
