"""Weighted sums of parameters: what a record often knows better than the parameters themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.parameters import Parameter, Quantity
from jointid.solvers.solve import Problem, Variable


class Kind(StrEnum):
    """What a combination is."""

    ASKED = "asked"
    SINGLE = "single"
    SUM = "sum"
    DIFFERENCE = "difference"
    DIRECTION = "direction"


@dataclass(frozen=True, slots=True)
class Combination:
    """A weighted sum of parameters.

    Attributes:
        name: in words.
        formula: in symbols.
        unit: of the sum.
        weights: of the parameters, by name.
        kind: a parameter by itself; the sum or difference of both sides; a direction of the sensitivities' singular
            vectors; or what somebody asked for.
        quantity: of a sum or difference of both sides, the parameter's name without its side: "viscous_forwards".
    """

    name: str
    formula: str
    unit: str
    weights: Mapping[str, float]
    kind: Kind = Kind.ASKED
    quantity: str = ""

    def vector(self, parameters: Sequence[Variable]) -> FloatArray:
        """Return the weights in the order of the parameters, (parameters,).

        Raises:
            MethodError: one of those it weighs is not among them.
        """
        names = [p.name for p in parameters]
        missing = [name for name in self.weights if name not in names]
        if missing:
            raise MethodError(f"{self.name} needs {', '.join(missing)} free; free are {', '.join(names)}.")
        return np.array([self.weights.get(name, 0.0) for name in names])


def single(parameter: Parameter, unit: str) -> Combination:
    """Return a parameter by itself."""
    return Combination(parameter.name.replace("_", " "), parameter.symbol, unit, {parameter.name: 1.0}, Kind.SINGLE)


def physical(parameters: Sequence[Parameter], units: Mapping[str, str]) -> tuple[Combination, ...]:
    """Return the combinations of both sides of a joint that have a meaning of their own.

    Sum and difference of the frictions, viscous and Coulomb, in each direction where they are told apart; and the
    whole inertia. A rigid joint has none.

    Args:
        parameters: the free ones.
        units: by name.
    """
    known = {p.name: p for p in parameters}
    found = []
    for name, motor in known.items():
        side, _, quantity = name.partition("_")
        load = known.get(f"load_{quantity}")
        if side != "motor" or load is None:
            continue
        words, unit = quantity.replace("_", " "), units[name]
        weights = {name: 1.0, load.name: 1.0}
        found.append(
            Combination(f"total {words}", f"{motor.symbol} + {load.symbol}", unit, weights, Kind.SUM, quantity)
        )
        if motor.quantity is not Quantity.INERTIA:
            weights = {name: 1.0, load.name: -1.0}
            formula = f"{motor.symbol} - {load.symbol}"
            found.append(
                Combination(
                    f"difference of {words}, motor less load", formula, unit, weights, Kind.DIFFERENCE, quantity
                )
            )
    return tuple(found)


class _JointProblem(Problem, Protocol):
    @property
    def free(self) -> tuple[Parameter, ...]: ...


@dataclass(frozen=True, slots=True)
class ByCompliance:
    """A problem whose stiffness is searched as the compliance 1/K, in which a nearly rigid joint is nearly linear.

    A stiffness that a record does not show has no upper bound, which a search meets as a plain without an end; its
    compliance merely has 0 in its interval.

    Attributes:
        problem: with one free parameter that is a stiffness.
        least: the compliance that is as good as none: nothing stiffer is simulated.
    """

    problem: _JointProblem
    least: float

    def __post_init__(self) -> None:
        stiff = [p.name for p in self.problem.free if p.quantity is Quantity.STIFFNESS]
        if len(stiff) != 1 or not (math.isfinite(self.least) and self.least > 0):
            raise MethodError(
                "A compliance takes the place of the one free stiffness, and is at least a positive number; received "
                f"{len(stiff)} stiffnesses and {self.least}."
            )

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

    def exchanged(self, x: FloatArray) -> FloatArray:
        """Return parameters with the compliance for the stiffness, or the other way round."""
        found = np.array(x, dtype=np.float64)
        found[self._at] = 1.0 / found[self._at]
        return found

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        return self.problem.residual(self.exchanged(x))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        residual, J = self.problem.linearised(self.exchanged(x))
        J = J.copy()
        J[:, self._at] *= -1.0 / x[self._at] ** 2
        return residual, J

    @property
    def _at(self) -> int:
        return [p.quantity for p in self.problem.free].index(Quantity.STIFFNESS)
