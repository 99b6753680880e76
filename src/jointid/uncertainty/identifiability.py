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

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parameters import ADDED, Parameter, Quantity
from jointid.common.text import in_words, interval, join
from jointid.uncertainty.covariance import INTERVAL, ROUNDING, Covariance

INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_PART = 1e-3  # of a combination of unit columns: a smaller term is rounding
_SURROUNDING = (Quantity.POSITION, Quantity.VELOCITY)  # of the initial state, no part of the answer


class Limitation(StrEnum):
    """Limits of a record's information."""

    INSEPARABLE = "inseparable"
    NOT_SIGNIFICANT = "not_significant"
    UNDETERMINED = "undetermined"
    FORCE_IN_LOOP = "force_in_loop"


@dataclass(frozen=True, slots=True)
class Combination:
    """A weighted sum of parameters.

    Attributes:
        quantity: of a sum of both sides, the parameter's name without its side: "viscous_forwards".
    """

    name: str
    formula: str
    unit: str
    weights: Mapping[str, float]
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
    return Combination(parameter.name.replace("_", " "), parameter.symbol, unit, {parameter.name: 1.0})


def sums_of(parameters: Sequence[Parameter], units: Mapping[str, str]) -> tuple[Combination, ...]:
    """Sums over both sides: inertias, and frictions by kind and direction."""
    known, found = {p.name: p for p in parameters}, list[Combination]()
    for name, motor in known.items():
        side, _, quantity = name.partition("_")
        load = known.get(f"load_{quantity}")
        if side == "motor" and load is not None and motor.quantity in ADDED:
            said, formula = f"total {quantity.replace('_', ' ')}", f"{motor.symbol} + {load.symbol}"
            found.append(Combination(said, formula, units[name], {name: 1.0, load.name: 1.0}, quantity))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Known:
    """A combination of parameters, its value, standard error, and possible shift as one deviation."""

    combination: Combination
    value: float
    std: float
    lack_of_fit: float = 0.0


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Accuracy of parameters and their combinations.

    Attributes:
        physical: sums of both sides.
        limitations: parameters that are known only together, and positive ones whose 2-sigma interval holds 0; empty
            for a good record.
        undetermined: names of parameters that the record determines only in combinations with others.
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
    norms, unseen, limitations = column_norms(J), find_unseen(J), list[Message]()
    own = [i for i, p in enumerate(parameters) if p.quantity not in _SURROUNDING]
    apart = [i for i in own if np.all(np.abs(unseen[:, i]) <= _PART)]

    def assess(combination: Combination) -> Known:
        weights = combination.vector(parameters)
        return Known(combination, float(weights @ x), covariance.std_of(weights))

    def is_seen(combination: Combination) -> bool:
        weights = combination.vector(parameters) / norms
        return bool(np.all(np.abs(unseen @ weights) <= _PART * np.linalg.norm(weights)))

    for vector in unseen:
        parts = {parameters[i].name: float(vector[i] / norms[i]) for i in own if abs(vector[i]) > _PART}
        if parts:
            limitations.append(_describe_unseen(parts, units, assess))
    each = {i: assess(single(parameters[i], units[parameters[i].name])) for i in apart}
    for i, j in combinations(apart, 2):
        if abs(correlation := float(covariance.correlation[i, j])) > INSEPARABLE:
            limitations.append(_describe_pair(each[i], each[j], correlation, assess))
    for i, one in each.items():
        if parameters[i].lower >= 0 and one.value <= INTERVAL * one.std:
            said = f"{in_words(parameters[i].name)} is not significant: its interval contains 0"
            values = {"parameter": parameters[i].name, "value": one.value, "std": one.std}
            limitations.append(Message(Limitation.NOT_SIGNIFICANT, said, values))
    seen = filter(is_seen, sums_of([parameters[i] for i in own], units))
    undetermined = tuple(parameters[i].name for i in own if i not in apart)
    return Identifiability(tuple(map(assess, seen)), tuple(limitations), undetermined)


def find_unseen(J: FloatArray) -> FloatArray:
    """Combinations of parameters that change no row of J, (combinations, free).

    A record that moves in one direction does not separate Coulomb friction from a constant force, for example.

    Args:
        J: (rows, free), the sensitivities; the combinations are those of its unit columns, each of as few as possible.
    """
    from scipy.linalg import qr, solve_triangular

    _, sizes, vectors = np.linalg.svd(np.linalg.qr(J / column_norms(J), mode="r"))
    unseen = vectors[np.sum(sizes > ROUNDING * sizes[0]) :]
    if len(unseen) < 2:
        return unseen
    # Any rotation of them is as good: with pivots, each begins at a column that no other has.
    _, R, order = qr(unseen, mode="economic", pivoting=True)
    found = np.empty_like(unseen)
    found[:, order] = solve_triangular(R[:, : len(unseen)], R)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def conditioning(W: FloatArray, values: FloatArray) -> dict[str, float]:
    """Return the condition numbers of a regressor, (rows, parameters), at estimates, (parameters,).

    They are of the "raw" columns, where they depend on the units; of columns "normalised" to norm 1; and of columns
    "scaled" by the estimates, which are what each parameter contributes to the torque.
    """
    norms = np.linalg.norm(W, axis=0)
    R, scale = np.asarray(np.linalg.qr(W / norms, mode="r")), np.where(values == 0.0, 1.0, np.abs(values))
    factors = {"raw": norms, "normalised": 1.0, "scaled": norms * scale}
    return {name: float(np.linalg.cond(R * by)) for name, by in factors.items()}


def find_separable(J: FloatArray) -> NDArray[np.bool_]:
    """Mask of the parameters that the record separates, (free,)."""
    return np.asarray(np.all(np.abs(find_unseen(J)) <= _PART, axis=0))


def _describe_unseen(
    unseen: Mapping[str, float], units: Mapping[str, str], assess: Callable[[Combination], Known]
) -> Message:
    """Message on parameters that the record does not determine or separate."""
    names, values = list(unseen), dict[str, object](parameters=list(unseen))
    listed = join([in_words(name) for name in names])
    said = f"this record does not {'determine' if len(names) == 1 else 'separate'} {listed}"
    weight = -unseen[names[0]] / unseen[names[-1]]
    if len(names) == 2 and units[names[0]] == units[names[1]] and math.isclose(abs(weight), 1.0, rel_tol=_PART):
        clause, more = _sum_of(names, weight, units[names[0]], assess)
        said, values = f"{said}: their {clause}", values | more
    return Message(Limitation.UNDETERMINED, f"{said}; fix one of them, or record another motion", values)


def _describe_pair(first: Known, second: Known, correlation: float, assess: Callable[[Combination], Known]) -> Message:
    """Message on two parameters that are known only together."""
    units = [one.combination.unit for one in (first, second)]
    names = [next(iter(one.combination.weights)) for one in (first, second)]
    # Of two in the same unit the plain sum or difference is given, of others the combination that is known best.
    weight = -math.copysign(1.0 if units[0] == units[1] else first.std / second.std, correlation)
    _, values = _sum_of(names, weight, units[0], assess)
    clause = f"use {join([in_words(name) for name in names])} only together"
    words = f"{clause} (correlation {correlation:+.3f})"
    return Message(Limitation.INSEPARABLE, words, values | {"parameters": names, "correlation": correlation}, clause)


def _sum_of(
    names: Sequence[str], weight: float, unit: str, assess: Callable[[Combination], Known]
) -> tuple[str, dict[str, object]]:
    """Sum or difference of two parameters: its interval, as text and values."""
    kind = "sum" if weight > 0 else "difference"
    known = assess(Combination(kind, "", unit, {names[0]: 1.0, names[1]: weight}))
    values = {"weight": weight, "value": known.value, "std": known.std, "unit": unit}
    return f"{kind} is {interval(known.value, INTERVAL * known.std)} {unit}", values
