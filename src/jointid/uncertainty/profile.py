"""Profile likelihood: interval of a quantity with all other parameters refitted.

For nonlinear problems or near bounds, the quantity c is held at successive values, and the interval ends where the sum
of squares has risen by::

    t^2 V / (w' (J' J)^-1 w)

with t the quantile of Student's distribution, w the weights of c in the parameters, J the sensitivities at the estimate
and V the variance of c in the reported covariance. For a white residual this is the likelihood ratio, ``t^2 s^2``. For
a linear problem it gives the interval of that covariance.

A further row, ``rho (w' x - c)``, holds c approximately; each fit is the exact optimum at its own c.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.common.text import number
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Problem, solve
from jointid.uncertainty.covariance import Covariance, covariance_of, robust
from jointid.uncertainty.identifiability import Combination

_HELD = 100.0  # times stiffer than the criterion is c held: it then yields by 1e-4 of its distance
_FIRST = 0.5  # of the way to where a linear problem would end
_BEYOND = 1.05  # of the threshold's root, aimed at
_FAR = 1.5  # times the threshold's root: a point above is not used to interpolate unless nothing nearer is found
_NARROW = 0.02  # of the way from the estimate: a bracket this narrow needs no more points
_UNSEEN = 1e-9  # of the largest: a normalised singular value whose direction leaves no trace in the residual
_IMPROVED = 1e-3  # of the threshold: a fit so much below the estimate says that it was no minimum
_PARABOLA = 0.1  # of the threshold: so much may the rise differ; the end of the interval then does by half as much
_LEAST = 1e-4  # of the compliance: a smaller one is negligible


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
class ProfileInterval:
    """Rise of the criterion as one quantity is held away from its estimate.

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
        improved: True if a fit went below the estimate, which then was not the minimum.
        evaluations: of the criterion, with or without derivatives.
    """

    in_json = "points rise"
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
        """True if the record bounds the quantity on both sides."""
        return None not in self.interval

    def __str__(self) -> str:
        """Return the interval in a sentence."""
        low, high = (number(end, 4) for end in self.interval)
        first, last = (number(value, 4) for value in self.reached)
        ends = {
            (True, True): f"{low} to {high}",
            (False, True): f"below {high}, without an end down to {first}",
            (True, False): f"above {low}, without an end up to {last}",
            (False, False): f"without an end from {first} to {last}",
        }[self.interval[0] is not None, self.interval[1] is not None]
        lower = "; the estimate was not the minimum" if self.improved else ""
        return (
            f"{self.formula} = {number(self.estimate)} {self.unit}, {100 * self.level:.4g} % profile interval "
            f"{ends} ({self.evaluations} evaluations{lower})"
        )


@dataclass(frozen=True, slots=True)
class ByCompliance:
    """A problem parametrised by the compliance 1/K, nearly linear for stiff joints.

    An unidentifiable stiffness has no upper bound; its compliance has 0 in its interval.

    Attributes:
        problem: with one free parameter that is a stiffness.
        least: the compliance that is as good as none: nothing stiffer is simulated.
    """

    problem: Problem
    least: float

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters, the compliance in the place of the stiffness."""
        found = list(self.problem.free)
        stiff = found[self._at]
        lower = max(1.0 / stiff.upper, self.least)
        upper = 1.0 / stiff.lower if stiff.lower > 0 else math.inf
        start = None if stiff.start is None else 1.0 / stiff.start
        symbol = f"1/{stiff.symbol}"
        found[self._at] = Parameter("compliance", symbol, Quantity.COMPLIANCE, start=start, lower=lower, upper=upper)
        return tuple(found)

    def exchange(self, x: FloatArray) -> FloatArray:
        """Exchange stiffness and compliance in a parameter vector."""
        found = np.array(x, dtype=np.float64)
        found[self._at] = 1.0 / found[self._at]
        return found

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        return self.problem.residual(self.exchange(x))

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual, (rows,), and derivatives, (rows, free)."""
        residual, J = self.problem.linearise(self.exchange(x))
        J = J.copy()
        J[:, self._at] *= -1.0 / x[self._at] ** 2
        return residual, J

    @property
    def _at(self) -> int:
        return [p.quantity for p in self.problem.free].index(Quantity.STIFFNESS)


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """A problem with a further row, ``stiffness (weights' x - value)``."""

    problem: Problem
    weights: FloatArray
    stiffness: float
    value: float

    @property
    def free(self) -> tuple[Parameter, ...]:
        return self.problem.free

    def _row(self, x: FloatArray) -> float:
        return self.stiffness * float(self.weights @ x - self.value)

    def residual(self, x: FloatArray) -> FloatArray:
        return np.append(self.problem.residual(x), self._row(x))

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, J = self.problem.linearise(x)
        return np.append(residual, self._row(x)), np.vstack([J, self.stiffness * self.weights])


@dataclass(slots=True, eq=False)
class _Point:
    value: float
    cost: float
    x: FloatArray


def profile(
    problem: Problem,
    x: FloatArray,
    combination: Combination,
    covariance: Covariance | None = None,
    settings: Profiling | None = None,
) -> ProfileInterval:
    """Profile a parameter or a weighted sum about an estimate.

    Args:
        problem: the solved problem.
        x: (free,) the estimate.
        combination: the quantity.
        covariance: of the free parameters; autocorrelation-robust when None.
        settings: see `Profiling`.
    """
    settings, counted = settings or Profiling(), Counted(problem)
    weights = combination.vector(problem.free)
    residual, J = counted.linearise(x)
    std = (covariance or robust(J, J, residual)).std_of(weights)
    direction, flat = _least_rise(J, weights)
    centre = _Point(float(weights @ x), float(residual @ residual), np.array(x, dtype=np.float64))
    found, threshold = [centre], 0.0
    if flat is not None and std > 0.0:
        quantile = _quantile(settings, residual.size - x.size)
        threshold, stiffness = quantile**2 * std**2 / flat, _HELD / math.sqrt(flat)

        solver = LevenbergMarquardt(settings.tolerance, settings.evaluations)

        def fit(start: FloatArray, value: float) -> _Point:
            found = solve(_Held(counted, weights, stiffness, value), solver, start)
            error = found.residual[:-1]
            return _Point(float(weights @ found.x), float(error @ error), found.x)

        bounds, used = Bounds.of(problem.free), weights != 0
        for sign in (-1.0, 1.0):
            furthest = np.where(weights * sign > 0, bounds.upper, bounds.lower)
            limit = float(np.sum(weights[used] * furthest[used]))
            step = sign * _FIRST * quantile * std
            found += _follow(fit, centre, limit, step, direction, threshold, settings.points)
    found.sort(key=lambda point: point.value)
    lowest = min(found, key=lambda point: point.cost)
    values, best = np.array([point.value for point in found]), found.index(lowest)
    rise = np.array([point.cost - lowest.cost for point in found])
    interval: tuple[float | None, float | None] = (None, None)  # nothing of it is seen in the residual
    if threshold > 0.0:
        interval = (
            _crossing(values[best::-1], rise[best::-1], threshold),
            _crossing(values[best:], rise[best:], threshold),
        )
    elif flat is not None and std == 0.0:  # it is known without error
        interval = (centre.value, centre.value)
    return ProfileInterval(
        combination.name,
        combination.formula,
        combination.unit,
        centre.value,
        settings.level,
        values,
        rise,
        np.array([point.x for point in found]),
        threshold,
        interval,
        (float(values[0]), float(values[-1])),
        centre.cost - lowest.cost > _IMPROVED * threshold,
        counted.evaluations,
    )


def is_parabola(
    problem: Problem,
    x: FloatArray,
    combination: Combination,
    covariance: Covariance,
    settings: Profiling | None = None,
) -> bool:
    """Test whether the criterion is parabolic, within a tenth, over an interval.

    The covariance's interval then holds. A bound in the interval or an invisible quantity gives False. Arguments as for
    `profile`.
    """
    weights = combination.vector(problem.free)
    residual, J = problem.linearise(x)
    std = covariance.std_of(weights)
    direction, flat = _least_rise(J, weights)
    if flat is None or std == 0.0:
        return False
    quantile = _quantile(settings or Profiling(), residual.size - x.size)
    threshold, lowest, bounds = quantile**2 * std**2 / flat, float(residual @ residual), Bounds.of(problem.free)
    for sign in (-1.0, 1.0):
        there = x + sign * quantile * std * direction
        if np.any(there < bounds.lower) or np.any(there > bounds.upper):
            return False
        error = problem.residual(there)
        if not abs(float(error @ error) - lowest - threshold) <= _PARABOLA * threshold:
            return False
    return True


def profile_compliance(
    problem: Problem,
    x: FloatArray,
    covariance: Covariance,
    unit: Callable[[Parameter], str],
    settings: Profiling | None = None,
) -> ProfileInterval:
    """Profile 1/K12, in which a stiff joint is nearly linear.

    Args:
        problem: the solved problem, its stiffness free.
        x: (free,) the estimate.
        covariance: of the free parameters.
        unit: returns that of a parameter; a joint's `unit`.
        settings: see `Profiling`.
    """
    at = [p.quantity for p in problem.free].index(Quantity.STIFFNESS)
    turn = np.eye(x.size)
    turn[at, at] = -1.0 / float(x[at]) ** 2  # of 1/K by K
    turned = covariance_of(turn @ covariance.matrix @ turn.T, covariance.bandwidth)
    by = ByCompliance(problem, _LEAST / float(x[at]))
    wanted = Combination("compliance", "1/K12", unit(by.free[at]), {"compliance": 1.0})
    return profile(by, by.exchange(x), wanted, turned, settings)


def _quantile(settings: Profiling, degrees: int) -> float:
    """Return that of Student's distribution of so many degrees of freedom, of a two-sided interval."""
    from scipy.special import stdtrit

    return float(stdtrit(max(degrees, 1), 0.5 + 0.5 * settings.level))


def _least_rise(J: FloatArray, weights: FloatArray) -> tuple[FloatArray, float | None]:
    """Change of all parameters per unit of the quantity, and ``w' (J' J)^-1 w``, if visible."""
    norms = column_norms(J)
    _, sizes, directions = np.linalg.svd(J / norms, full_matrices=False)
    seen = sizes > _UNSEEN * sizes[0]
    along = directions @ (weights / norms)
    if np.linalg.norm(along[~seen]) > _UNSEEN * np.linalg.norm(along):
        return weights, None
    flat = float(np.sum((along[seen] / sizes[seen]) ** 2))
    follows = directions[seen].T @ (along[seen] / sizes[seen] ** 2) / norms / flat
    return np.asarray(follows), flat


def _follow(
    fit: Callable[[FloatArray, float], _Point],
    centre: _Point,
    limit: float,
    step: float,
    direction: FloatArray,
    threshold: float,
    most: int,
) -> list[_Point]:
    """Profile one side, to the threshold, the bound or `most` points.

    The root of the rise over the threshold is nearly linear in the quantity, which predicts the next point.

    `step` leads to the first point, negative on the lower side; `direction`, (free,), is the change of the parameters
    per unit of the quantity, and `limit` its extreme value within their bounds.
    """
    sign, step, found, lowest = math.copysign(1.0, step), abs(step), [centre], centre.cost

    def root(point: _Point) -> float:
        return math.sqrt(max(point.cost - lowest, 0.0) / threshold)

    while len(found) <= most:
        outwards = sorted(found, key=lambda point: abs(point.value - centre.value))
        passed = next((i for i, point in enumerate(outwards) if i > 0 and root(point) >= 1), None)
        inside = outwards[-1 if passed is None else passed - 1]
        if passed is None:
            target = inside.value + sign * step
            target = min(target, limit) if sign > 0 else max(target, limit)
        else:
            outside = outwards[passed]
            narrow = abs(outside.value - inside.value) <= _NARROW * abs(outside.value - centre.value)
            if narrow or root(outside) <= _FAR:
                break
            target = 0.5 * (inside.value + outside.value)
        point = fit(inside.x + (target - inside.value) * direction, target)
        found.append(point)
        lowest = min(lowest, point.cost)
        if passed is not None:
            continue
        if sign * (limit - point.value) <= 1e-3 * step:  # held by the bounds
            break
        went = point.value - inside.value
        if abs(went) <= 1e-6 * step:
            step *= 2
            continue
        slope = (root(point) - root(inside)) / abs(went)
        wanted = (_BEYOND - root(point)) / slope if slope > 0 else math.inf
        step, direction = min(max(wanted, 0.5 * step), 2 * step), (point.x - inside.x) / went
    return found[1:]


def _crossing(values: FloatArray, rise: FloatArray, threshold: float) -> float | None:
    """Interpolate where the rise crosses the threshold; None if it does not."""
    above = np.flatnonzero(rise >= threshold)
    if not above.size:
        return None
    i = int(above[0])
    roots = np.sqrt(np.maximum(rise[i - 1 : i + 1], 0.0))
    share = (math.sqrt(threshold) - roots[0]) / (roots[1] - roots[0])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))
