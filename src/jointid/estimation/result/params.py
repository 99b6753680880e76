"""Identified parameters, on the side they are identified on and on the other side of a transmission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.refer import OtherSide
from jointid.uncertainty.identifiability import Known
from jointid.uncertainty.verdict import StiffnessBound


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One line of the table.

    Attributes:
        name, symbol, unit: what it is.
        value: the estimate; None when it is refused.
        stderr: its standard error; None for a parameter that was kept fixed, or refused.
        free: whether it was identified.
        identifiable: whether the record determines it; a fixed parameter does not say.
        lower_bound: what the record supports when the value is refused.
        of_joint: False for what surrounds the joint (the initial state).
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    free: bool
    identifiable: bool
    lower_bound: float | None = None
    of_joint: bool = True

    @property
    def interval(self) -> tuple[float, float] | None:
        """Lower and upper end of the value with two standard errors; None where there is no standard error."""
        if self.value is None or self.stderr is None:
            return None
        return self.value - 2 * self.stderr, self.value + 2 * self.stderr


@dataclass(frozen=True, slots=True, eq=False)
class Params(Sequence[EstimatedParameter]):
    """The parameters of an estimate: a sequence, and by name or symbol: ``params["stiffness"]``, ``params["K12"]``.

    Attributes:
        rows: in the order of the model, then those of what surrounds it.
        names: of the free parameters, in the order of `correlation`; ``name@2`` is the second record's own.
        correlation: of the errors of the free parameters, all of them, or the joint's, which come first; empty where it
            is not known.
        basis: how the standard errors were obtained, in a sentence.
        own: of several records, the parameters that are each record's own, by their plain names.
    """

    rows: tuple[EstimatedParameter, ...]
    names: tuple[str, ...]
    correlation: FloatArray
    basis: str
    own: tuple[tuple[EstimatedParameter, ...], ...] = ()

    @overload
    def __getitem__(self, at: str | int) -> EstimatedParameter: ...

    @overload
    def __getitem__(self, at: slice) -> tuple[EstimatedParameter, ...]: ...

    def __getitem__(self, at: str | int | slice) -> EstimatedParameter | tuple[EstimatedParameter, ...]:
        """Return a parameter by its name or symbol, ``name@2`` the second record's own, or by its place."""
        if not isinstance(at, str):
            return self.rows[at]
        plain, _, record = at.partition("@")
        for parameter in self.own[int(record) - 1] if record else self.rows:
            if plain in (parameter.name, parameter.symbol):
                return parameter
        raise KeyError(at)

    def __len__(self) -> int:
        """Number of parameters, without the records' own."""
        return len(self.rows)

    @property
    def stderr(self) -> FloatArray:
        """Standard errors of the free parameters, (free,), in the order of `names`; NaN of a refused one."""
        return np.array([np.nan if (s := self[name].stderr) is None else s for name in self.names])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors of the free parameters as far as their correlation is known, in that order."""
        stderr = self.stderr[: len(self.correlation)]
        return np.asarray(self.correlation * np.outer(stderr, stderr))

    def correlation_of(self, names: Sequence[str]) -> FloatArray:
        """Return the correlation of the errors of some free parameters, (names, names); none where it is not known."""
        at = [self.names.index(name) for name in names]
        known = max(at, default=0) < len(self.correlation)
        return np.asarray(self.correlation[np.ix_(at, at)] if known else np.eye(len(at)))

    def total(self, names: Sequence[str]) -> tuple[float, float]:
        """Return a sum of parameters, by name or symbol, and its standard error, with their correlation."""
        found = [self[name] for name in names]
        uncertain = [p for p in found if p.stderr is not None]
        stderr = np.array([p.stderr for p in uncertain], dtype=np.float64)
        together = self.correlation_of([p.name for p in uncertain])
        total = sum(p.value for p in found if p.value is not None)
        return total, float(np.sqrt(max(float(stderr @ together @ stderr), 0.0)))


def on_other_side(parameters: Sequence[EstimatedParameter], side: OtherSide | None) -> tuple[EstimatedParameter, ...]:
    """Return parameters as they are on the other side of a transmission, in the same order; none without one."""
    if side is None:
        return ()
    here = {p.name: p for p in parameters}
    return tuple(_refer(p, here.get(side.name(p.name), p), side) for p in parameters)


def _refer(p: EstimatedParameter, here: EstimatedParameter, side: OtherSide) -> EstimatedParameter:
    """Return a parameter with the values that another one, the same but for the direction, has on this side."""
    factor = side.factor(p.name, p.unit)

    def scaled(value: float | None) -> float | None:
        return None if value is None else factor * value + 0.0  # of 0 there is no negative

    return replace(
        here,
        name=p.name,
        symbol=p.symbol,
        unit=side.unit(p.unit),
        value=scaled(here.value),
        stderr=None if here.stderr is None else abs(factor) * here.stderr,
        lower_bound=scaled(here.lower_bound),
    )


def known_on_other_side(known: Sequence[Known], side: OtherSide | None) -> tuple[Known, ...]:
    """Return the sums and differences of one unit as they are on the other side, in the same order; none without."""
    if side is None:
        return ()
    here = {frozenset(k.combination.weights.items()): k for k in known}
    found = []
    for k in known:
        weights = k.combination.weights
        same = here.get(frozenset((side.name(name), weight) for name, weight in weights.items()), k)
        factor = side.factor(next(iter(weights)), k.combination.unit)
        there = replace(k.combination, unit=side.unit(k.combination.unit))
        found.append(Known(there, factor * same.value, abs(factor) * same.std, same.relative))
    return tuple(found)


def bounds_on_other_side(bounds: Sequence[StiffnessBound], side: OtherSide | None) -> tuple[StiffnessBound, ...]:
    """Return bounds of a stiffness as they are on the other side, in the same order; none without one."""
    if side is None:
        return ()
    factor = side.ratio**2
    return tuple(replace(b, stiffness=None if b.stiffness is None else factor * b.stiffness) for b in bounds)
