"""Identifiability: which parameters and combinations a record determines.

From torque alone the sum of two frictions is often known, but not each of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms, triangle
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parameters import ADDED, Parameter, Quantity
from jointid.common.text import in_words, interval, join, number
from jointid.uncertainty.covariance import Covariance

_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_WELL, _POORLY = 0.1, 0.5  # of its parameters' size: a combination's 2 sigma
_ROUNDING = 1e-9  # of the largest singular value: a combination that the torque does not contain
_PART = 1e-3  # of a combination of unit columns: a smaller term is rounding
_SURROUNDING = (Quantity.POSITION, Quantity.VELOCITY)  # of the initial state, no part of the answer


class Kind(StrEnum):
    """Origin of a combination."""

    ASKED = "asked"
    SINGLE = "single"
    SUM = "sum"
    DIFFERENCE = "difference"


class Limitation(StrEnum):
    """Limits of what a record determines."""

    INSEPARABLE = "inseparable"
    NOT_SIGNIFICANT = "not_significant"
    UNDETERMINED = "undetermined"


@dataclass(frozen=True, slots=True)
class Combination:
    """A weighted sum of parameters.

    Attributes:
        kind: a parameter by itself; the sum or difference of both sides; or what somebody asked for.
        quantity: of a sum or difference of both sides, the parameter's name without its side: "viscous_forwards".
    """

    name: str
    formula: str
    unit: str
    weights: Mapping[str, float]
    kind: Kind = Kind.ASKED
    quantity: str = ""

    def vector(self, parameters: Sequence[Parameter]) -> FloatArray:
        """Return the weights in the order of the parameters, (parameters,)."""
        names = [p.name for p in parameters]
        missing = [name for name in self.weights if name not in names]
        if missing:
            raise MethodError(f"{self.name} needs {', '.join(missing)} free; free are {', '.join(names)}.")
        return np.array([self.weights.get(name, 0.0) for name in names])


def single(parameter: Parameter, unit: str) -> Combination:
    """Return a parameter by itself."""
    return Combination(parameter.name.replace("_", " "), parameter.symbol, unit, {parameter.name: 1.0}, Kind.SINGLE)


def physical(parameters: Sequence[Parameter], units: Mapping[str, str]) -> tuple[Combination, ...]:
    """Physically meaningful combinations of both sides of a joint.

    These are sum and difference of the frictions, by kind and direction, and the total inertia; none for a rigid joint.
    """
    known = {p.name: p for p in parameters}
    found = []
    for name, motor in known.items():
        side, _, quantity = name.partition("_")
        load = known.get(f"load_{quantity}")
        if side != "motor" or load is None or motor.quantity not in ADDED:
            continue
        words = quantity.replace("_", " ")
        pairs = [(f"total {words}", "+", 1.0, Kind.SUM)]
        if motor.quantity is not Quantity.INERTIA:
            pairs.append((f"difference of {words}, motor less load", "-", -1.0, Kind.DIFFERENCE))
        for said, sign, weight, kind in pairs:
            formula, weights = f"{motor.symbol} {sign} {load.symbol}", {name: 1.0, load.name: weight}
            found.append(Combination(said, formula, units[name], weights, kind, quantity))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Known:
    """A combination of parameters, its value and its accuracy.

    Attributes:
        relative: standard deviation over the size of what is combined, a ratio.
    """

    in_json = "verdict"
    combination: Combination
    value: float
    std: float
    relative: float

    @property
    def interval(self) -> tuple[float, float]:
        """Two standard deviations about the value."""
        return self.value - 2 * self.std, self.value + 2 * self.std

    @property
    def verdict(self) -> str:
        """Grade: "well" for 2 sigma up to 10 % of the terms, "poorly" up to 50 %, else "not"."""
        return "well" if 2 * self.relative <= _WELL else "poorly" if 2 * self.relative <= _POORLY else "not"


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Accuracy of parameters and their combinations.

    Attributes:
        physical: sums and differences with a meaning of their own.
        limitations: parameters that are known only together, and what must be positive and whose 2-sigma interval
            holds 0; none of a good record.
        undetermined: names of parameters of which the record determines only combinations with others.
    """

    physical: tuple[Known, ...]
    limitations: tuple[Message, ...]
    undetermined: tuple[str, ...] = ()


def identifiability(
    parameters: Sequence[Parameter],
    units: Mapping[str, str],
    x: FloatArray,
    J: FloatArray,
    covariance: Covariance,
) -> Identifiability:
    """Assess parameters and their combinations.

    Args:
        parameters: the free ones, in order.
        units: by name; not needed for the initial state.
        x: (free,) their values.
        J: (rows, free), the sensitivities of the residual or of the prediction.
        covariance: of the estimate.
    """
    own = [i for i, p in enumerate(parameters) if p.quantity not in _SURROUNDING]
    joint = [parameters[i] for i in own]
    spread = Covariance(covariance.std[own], covariance.correlation[np.ix_(own, own)], covariance.bandwidth)
    scale = np.where(x == 0.0, covariance.std, np.abs(x))
    scale = np.where(scale > 0, scale, 1.0)

    def assess(combination: Combination) -> Known:
        weights = combination.vector(parameters)
        std = covariance.std_of(weights)
        return Known(combination, float(weights @ x), std, std / float(np.linalg.norm(weights * scale)))

    norms, unseen, separable = column_norms(J), find_unseen(J), find_separable(J)

    def is_seen(combination: Combination) -> bool:
        weights = combination.vector(parameters) / norms
        return bool(np.all(np.abs(unseen @ weights) <= _PART * np.linalg.norm(weights)))

    each = [assess(single(p, units[p.name])) for p in joint]
    apart = [k for k, i in enumerate(own) if separable[i]]
    limitations = []
    for vector in unseen:
        parts = {p.name: float(vector[i] / norms[i]) for p, i in zip(joint, own, strict=True) if abs(vector[i]) > _PART}
        limitations += [_describe_together(joint, parts, units, assess)] if parts else []
    limitations += [
        _describe_pair(joint, each, spread, i, j)
        for i, j in combinations(apart, 2)
        if abs(spread.correlation[i, j]) > _INSEPARABLE
    ]
    for p, one in ((joint[k], each[k]) for k in apart):
        if p.lower >= 0 and one.interval[0] <= 0.0:
            said = f"{p.symbol} is not significant: its interval holds 0"
            values = {"parameter": p.name, "value": one.value, "std": one.std}
            limitations.append(Message(Limitation.NOT_SIGNIFICANT, said, values))
    return Identifiability(
        tuple(assess(one) for one in physical(joint, units) if is_seen(one)),
        tuple(limitations),
        tuple(p.name for k, p in enumerate(joint) if k not in apart),
    )


def find_unseen(J: FloatArray) -> FloatArray:
    """Return the combinations of parameters that change no row of the sensitivities, (combinations, free).

    A record that moves in one direction does not separate Coulomb friction from a constant force, for example.

    Args:
        J: (rows, free), the sensitivities; the combinations are those of its unit columns, each of as few as possible.
    """
    from scipy.linalg import qr, solve_triangular

    _, sizes, vectors = np.linalg.svd(triangle(J / column_norms(J)))
    unseen = vectors[np.sum(sizes > _ROUNDING * sizes[0]) :]
    if len(unseen) < 2:
        return unseen
    # Any rotation of them is as good: with pivots, each begins at a column that no other has.
    _, R, order = qr(unseen, mode="economic", pivoting=True)
    found = np.empty_like(unseen)
    found[:, order] = solve_triangular(R[:, : len(unseen)], R)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def find_separable(J: FloatArray) -> NDArray[np.bool_]:
    """Return a mask of the parameters that the record separates, (free,); see `find_unseen`."""
    return np.asarray(np.all(np.abs(find_unseen(J)) <= _PART, axis=0))


def _describe_together(
    parameters: Sequence[Parameter],
    unseen: Mapping[str, float],
    units: Mapping[str, str],
    assess: Callable[[Combination], Known],
) -> Message:
    """Message on parameters whose changes in these proportions change nothing in the record."""
    names = [p.name for p in parameters if p.name in unseen]
    listed = join([in_words(name) for name in names])
    values: dict[str, object] = {"parameters": names}
    if len(names) == 1:
        return Message(Limitation.UNDETERMINED, f"this record does not determine {listed}", values)
    said = f"this record does not separate {listed}"
    first, second = names[:2]
    weight = -unseen[first] / unseen[second]
    if len(names) == 2 and units[first] == units[second] and math.isclose(abs(weight), 1.0, rel_tol=_PART):
        kind = Kind.SUM if weight > 0 else Kind.DIFFERENCE
        known = assess(Combination(f"{kind} of {listed}", "", units[first], {first: 1.0, second: weight}, kind))
        said += f": their {kind} is {interval(known.value, 2 * known.std)} {units[first]}"
        values |= {"weight": weight, "value": known.value, "std": known.std, "unit": units[first]}
    if any(name.endswith("friction_per_torque") for name in names):
        said += (
            ": where the torque never brakes, a share of it scales them all; identify records with other known loads"
        )
        said += " in one fit, or brake harder"
    return Message(Limitation.UNDETERMINED, f"{said}; fix one of them, or record another motion", values)


def _describe_pair(
    parameters: Sequence[Parameter], each: Sequence[Known], spread: Covariance, i: int, j: int
) -> Message:
    """Message on two parameters that are known only together."""
    first, second = parameters[i], parameters[j]
    correlation, unit = float(spread.correlation[i, j]), each[i].combination.unit
    weights = np.zeros(len(parameters))
    weights[i] = 1.0
    alike = each[i].combination.unit == each[j].combination.unit
    # Of two in the same unit the plain sum or difference is given, of others the combination that is known best.
    weights[j] = -math.copysign(1.0 if alike else spread.std[i] / spread.std[j], correlation)
    value, std = float(weights @ [known.value for known in each]), spread.std_of(weights)
    pair = f"{in_words(first.name)} and {in_words(second.name)}"
    if alike:
        clause = f"use the {'sum' if correlation < 0 else 'difference'} of {pair}, {interval(value, 2 * std)} {unit}"
    else:
        clause = f"use {pair} only together: what one gains the other makes up for"
    widths = " and ".join(f"± {number(2 * known.std, 2)} {known.combination.unit}" for known in (each[i], each[j]))
    said = f"{clause}; apart they are known to {widths} (correlation {correlation:+.3f})"
    values = {"parameters": [first.name, second.name], "weight": float(weights[j]), "value": value, "std": std}
    values |= {"unit": unit, "correlation": correlation}
    return Message(Limitation.INSEPARABLE, said, values, clause)
