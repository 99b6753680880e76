"""The base of every problem of one record: its parameters by name and as a vector, and what it is measured against.

A sum of problems that share parameters is a problem, too. A parameter of a member is one that all members share, or
that plus a number that is known (a mass that was added to the load, say), or its own. The residuals stand one after the
other, each through a filter of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Bounds, Problem

_Member = TypeVar("_Member", bound=Problem)

FAILED = 1e3  # times the measured signal: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RecordProblem:
    """A record and a model of it: free parameters in, the filtered error out; the base of a `solvers.solve.Problem`.

    Attributes:
        parameters: all of the joint, then of what surrounds it.
        measured: (samples,) what is reproduced, raw.
        filtering: resolved.
    """

    parameters: tuple[Parameter, ...]
    measured: FloatArray
    filtering: Filtering

    if TYPE_CHECKING:

        @property
        def joint(self) -> Joint:
            """What is identified."""

        @property
        def sample_time(self) -> float:
            """Of the measured signal, seconds."""

        def filtered(self, columns: FloatArray) -> FloatArray:
            """Return signals, (samples,) or (samples, columns), through the problem's own filter, decimated."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """Those of them that belong to the joint; they come first."""
        own = {p.name for p in self.joint.parameters}
        return tuple(p for p in self.free if p.name in own)

    @property
    def units(self) -> dict[str, str]:
        """Of every parameter, by name."""
        return {p.name: self.joint.unit(p) for p in self.parameters}

    @property
    def size(self) -> float:
        """Norm of the filtered signal: what a residual is measured against."""
        return float(np.linalg.norm(self.filtered(self.measured)))

    def filtered_error(self, error: FloatArray) -> float:
        """Return the norm of a filtered error, (rows,), over that of the filtered signal, a ratio."""
        return float(np.linalg.norm(error) / self.size)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found.get(p.name, float(p.start or 0.0)) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order; one that is not there starts as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

    def changed(self, changes: Mapping[str, Parameter]) -> Self:
        """Return the problem with the parameters of these names replaced; others are not added."""
        return replace(self, parameters=tuple(changes.get(p.name, p) for p in self.parameters))

    def keeping(self, values: Mapping[str, float]) -> Self:
        """Return the problem with parameters fixed at these values, by name; others are not added."""
        return self.changed({p.name: p.fixed(values[p.name]) for p in self.parameters if p.name in values})

    def all_free(self) -> Self:
        """Return the problem with every parameter free, so that every derivative is there."""
        return self.changed({p.name: replace(p, free=True) for p in self.parameters})


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
