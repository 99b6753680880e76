"""A sum of problems that share parameters is a problem, too.

A parameter of a member is one that all members share, or that plus a number that is known (a mass that was added to the
load, say), or its own. The residuals stand one after the other, each through a filter of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models.parameters import Parameter
from jointid.solvers.bounds import Bounds
from jointid.solvers.problem import Problem

_Member = TypeVar("_Member", bound=Problem)


@dataclass(frozen=True, slots=True, eq=False)
class SumProblem(Generic[_Member]):
    """Several problems in one, which share parameters.

    Attributes:
        problems: the members.
        free: the parameters that are identified: those that are shared, then those of each member, called
            ``name@number`` with the number of the member, from 1.
        places: for each member, where each of its free parameters stands among those, (its free,).
        added: for each member, what is known to come on top of each, (its free,).
        weights: for each member, the taps of the filter its rows go through, (taps,).
    """

    problems: tuple[_Member, ...]
    free: tuple[Parameter, ...]
    places: tuple[NDArray[np.intp], ...]
    added: tuple[FloatArray, ...]
    weights: tuple[FloatArray, ...]

    def of_member(self, x: FloatArray, number: int) -> FloatArray:
        """Return the free parameters of one member, numbered from 0, in its own order."""
        return np.asarray(x[self.places[number]] + self.added[number])

    def vector(self, found: Sequence[FloatArray]) -> FloatArray:
        """Return the parameters that the members' own come from: means of those that are shared, within bounds."""
        total, count = np.zeros(len(self.free)), np.zeros(len(self.free))
        for place, added, own in zip(self.places, self.added, found, strict=True):
            np.add.at(total, place, own - added)
            np.add.at(count, place, 1.0)
        return Bounds.of(self.free).clip(total / count)

    def weighing(self, weights: Sequence[FloatArray]) -> SumProblem[_Member]:
        """Return the same problem with other weights; they are made relative to their mean.

        The residual keeps the unit of the members' that way.
        """
        mean = math.sqrt(sum(float(taps[0]) ** -2 for taps in weights) / len(weights))
        return replace(self, weights=tuple(mean * taps for taps in weights))

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residuals, one member after the other, (rows,)."""
        members = enumerate(zip(self.problems, self.weights, strict=True))
        return np.concatenate([filter_rows(taps, p.residual(self.of_member(x, k))) for k, (p, taps) in members])

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        errors, slopes = [], []
        for k, (problem, taps) in enumerate(zip(self.problems, self.weights, strict=True)):
            error, J = problem.linearised(self.of_member(x, k))
            errors.append(filter_rows(taps, error))
            slopes.append(np.zeros((error.size, len(self.free))))
            slopes[-1][:, self.places[k]] = filter_rows(taps, J)
        return np.concatenate(errors), np.concatenate(slopes)


def filter_rows(taps: FloatArray, columns: FloatArray) -> FloatArray:
    """Return signals, (rows,) or (rows, columns), through a filter; before the first row there was nothing."""
    found = taps[0] * columns
    for lag, tap in enumerate(taps[1:], 1):
        found[lag:] += tap * columns[:-lag]
    return np.asarray(found)
