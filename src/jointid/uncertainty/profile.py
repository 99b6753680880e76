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
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.common.text import number
from jointid.solvers.solve import Counted, LevenbergMarquardt, Problem, solve
from jointid.uncertainty.covariance import COVERED, ROUNDING, Covariance, covariance_of
from jointid.uncertainty.identifiability import Combination

_Point: TypeAlias = tuple[float, float, FloatArray]  # a value of the quantity, the least cost there, the parameters

_HELD = 100.0  # times stiffer than the criterion is c held: it then yields by 1e-4 of its distance
_TINY = 1e-30  # of a complex step, which no digit of a real value has


@dataclass(frozen=True, slots=True, eq=False)
class ProfileInterval:
    """Rise of the criterion with one quantity held away from its estimate.

    Attributes:
        name, formula, unit: of the quantity.
        estimate: of it.
        points: (points,) its values, in increasing order, the estimate among them.
        rise: (points,) of the sum of squares over the lowest found.
        threshold: the rise at which the interval ends.
        interval: its ends; None on a side where the criterion stays below the threshold up to the bound, or as far as
            was searched.
        improved: True if a fit went below the estimate, which then was not the minimum.
        evaluations: of the criterion, with or without derivatives.
    """

    in_json = "points rise reached"
    name: str
    formula: str
    unit: str
    estimate: float
    points: FloatArray
    rise: FloatArray
    threshold: float
    interval: tuple[float | None, float | None]
    improved: bool
    evaluations: int

    @property
    def reached(self) -> tuple[float, float]:
        """The last value on each side."""
        return float(self.points[0]), float(self.points[-1])

    @property
    def bounded(self) -> bool:
        """True if the record bounds the quantity on both sides."""
        return None not in self.interval

    def __str__(self) -> str:
        """Return the interval in a sentence."""
        ends = [
            number(end, 4) if end is not None else f"{word} (searched to {number(last, 4)})"
            for end, last, word in zip(self.interval, self.reached, ("no lower end", "no upper end"), strict=True)
        ]
        lower = "; the estimate was not the minimum" if self.improved else ""
        return (
            f"{self.formula} = {number(self.estimate)} {self.unit}, {100 * COVERED:.4g} % profile interval "
            f"{' to '.join(ends)} ({self.evaluations} evaluations{lower})"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Reparametrised:
    """A problem in other parameters.

    Attributes:
        problem: in its own. free: the others.
        turn: from their values, (free,), real or complex, to the free ones of the problem.
    """

    problem: Problem
    free: tuple[Parameter, ...]
    turn: Callable[[Any], Any]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual, (rows,), and derivatives, (rows, free); those of `turn` by complex steps."""
        error, J = self.problem.linearise(self.turn(x))
        if not np.isfinite(np.vdot(J, J)):
            # The derivatives of a diverging loop overflow when they are squared; there is no way down from it.
            return error, np.zeros((error.size, x.size))
        turns = [np.imag(self.turn(x + 1j * _TINY * step)) / _TINY for step in np.eye(x.size)]
        return error, J @ np.array(turns).T


def by_compliance(problem: Problem, least: float) -> Reparametrised:
    """Express a problem's stiffness as the compliance 1/K, nearly linear when stiff.

    An unidentifiable stiffness has no upper bound; its compliance has 0 in its interval. Compliances below `least`
    are not simulated.
    """
    at, stiff = next((i, p) for i, p in enumerate(problem.free) if p.quantity is Quantity.STIFFNESS)
    lower, upper = max(1.0 / stiff.upper, least), 1.0 / stiff.lower if stiff.lower > 0 else math.inf
    own = Parameter("compliance", f"1/{stiff.symbol}", Quantity.COMPLIANCE, lower=lower, upper=upper)
    free = (*problem.free[:at], own, *problem.free[at + 1 :])
    return Reparametrised(problem, free, lambda x: np.where(np.arange(x.size) == at, 1.0 / x[at], x))


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

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, J = self.problem.linearise(x)
        row = self.stiffness * (self.weights @ x - self.value)
        return np.append(residual, row), np.vstack([J, self.stiffness * self.weights])


def profile(
    problem: Problem,
    x: FloatArray,
    combination: Combination,
    covariance: Covariance,
) -> ProfileInterval:
    """Profile a parameter or a weighted sum about an estimate.

    Args:
        problem: the solved problem.
        x: (free,) the estimate.
        combination: the quantity.
        covariance: of the free parameters.
    """
    from scipy.special import stdtrit

    counted, weights, bounds = Counted(problem), combination.vector(problem.free), Bounds.of(problem.free)
    residual, J = counted.linearise(x)
    direction, flat = _least_rise(J, weights)
    half = float(stdtrit(max(residual.size - x.size, 1), 0.5 + 0.5 * COVERED)) * covariance.std_of(weights)
    threshold = half**2 / flat if flat else 0.0

    def fit(value: float, start: FloatArray) -> _Point:
        end = solve(_Held(counted, weights, _HELD / math.sqrt(flat or 1.0), value), LevenbergMarquardt(1e-8, 30), start)
        error = end.residual[:-1]
        return float(weights @ end.x), float(error @ error), end.x

    centre = float(weights @ x), float(residual @ residual), x
    found, own = [centre], weights != 0
    for sign in (-1.0, 1.0) if threshold else ():
        furthest = np.where(weights * sign > 0, bounds.upper, bounds.lower)
        limit = float(np.sum(weights[own] * furthest[own]))
        found += _follow(fit, centre, direction, sign * half, limit, threshold, 14)  # at most, on each side
    values, costs = np.array(sorted(point[:2] for point in found)).T
    best = int(np.argmin(costs))
    rise = costs - costs[best]
    return ProfileInterval(
        combination.name, combination.formula, combination.unit, centre[0], values, rise, threshold,
        (_crossing(values[best::-1], rise[best::-1], threshold), _crossing(values[best:], rise[best:], threshold)),
        bool(centre[1] - costs[best] > 1e-3 * threshold), counted.evaluations,
    )  # fmt: skip


def _least_rise(J: FloatArray, weights: FloatArray) -> tuple[FloatArray, float]:
    """Slope of all parameters by the quantity; ``w'(J'J)^-1 w``, 0 if undetermined."""
    norms = column_norms(J)
    _, sizes, directions = np.linalg.svd(J / norms, full_matrices=False)
    seen = sizes > ROUNDING * sizes[0]
    along = directions @ (weights / norms)
    if np.linalg.norm(along[~seen]) > ROUNDING * np.linalg.norm(along):
        return weights, 0.0
    flat = float(np.sum((along[seen] / sizes[seen]) ** 2))
    return np.asarray(directions[seen].T @ (along[seen] / sizes[seen] ** 2) / norms / flat), flat


def _follow(
    fit: Callable[[float, FloatArray], _Point],
    centre: _Point,
    direction: FloatArray,
    half: float,
    limit: float,
    threshold: float,
    most: int,
) -> list[_Point]:
    """Profile one side to the threshold, the limit or `most` points.

    The root of the rise over the threshold is nearly linear in the quantity, which predicts the next point. Of a linear
    problem the end is `half` away, and `direction` is the change of the parameters per unit of the quantity.
    """
    from scipy.optimize import root_scalar

    found, begin, nearer = [centre], centre[0], min if half > 0 else max
    roots = {begin: -1.0}

    def root_at(value: float) -> float:
        """Root of the rise relative to the threshold, less 1, at `value`."""
        if value not in roots:
            (near, _, x), *others = sorted(found, key=lambda point: abs(point[0] - value))
            apart = near - others[0][0] if others else 0.0
            slope = (x - others[0][2]) / apart if apart else direction
            found.append(fit(value, x + (value - near) * slope))
            risen = max(found[-1][1] - min(cost for _, cost, _ in found), 0.0)
            roots[value] = math.sqrt(risen / threshold) - 1.0
        return roots[value]

    way, outside, risen = 0.5 * half, begin, -1.0  # of the way to where a linear problem would end
    while risen < 0.0 and len(found) <= most and abs(limit - found[-1][0]) > 1e-3 * abs(way):
        inside, outside = outside, nearer(begin + way, limit)
        risen = root_at(outside)
        way *= min(max(1.05 / max(risen + 1.0, 1e-9), 1.5), 3.0)  # just beyond the threshold
    if risen > 0.5 and len(found) <= most:  # too far away to interpolate
        narrow = 0.02 * abs(outside - begin)  # of the way from the estimate to an end: so near the end is known
        root_scalar(root_at, bracket=(inside, outside), method="brentq", xtol=narrow, maxiter=most + 1 - len(found))
    return found[1:]


def _crossing(values: FloatArray, rise: FloatArray, threshold: float) -> float | None:
    """Interpolate the quantity at the threshold; None if the rise stays below."""
    above = np.flatnonzero(rise >= threshold)
    if threshold == 0.0 or not above.size:
        return None
    i = int(above[0])
    roots = np.sqrt(np.maximum(rise[i - 1 : i + 1], 0.0))
    share = (math.sqrt(threshold) - roots[0]) / (roots[1] - roots[0])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))


def profile_compliance(
    problem: Problem,
    x: FloatArray,
    covariance: Covariance,
    unit: Callable[[Parameter], str],
) -> ProfileInterval:
    """Profile 1/K12, nearly linear for a stiff joint; arguments as of `profile`."""
    at = [p.quantity for p in problem.free].index(Quantity.STIFFNESS)
    by = by_compliance(problem, 1e-4 / float(x[at]))  # of the compliance: a smaller one is negligible
    turn = np.where(np.arange(x.size) == at, -1.0 / x[at] ** 2, 1.0)  # of 1/K by K
    wanted = Combination("compliance", "1/K12", unit(by.free[at]), {"compliance": 1.0})
    turned = covariance_of(covariance.matrix * np.outer(turn, turn))
    return profile(by, by.turn(x), wanted, turned)
