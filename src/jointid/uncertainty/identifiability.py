"""Identifiability: which parameters and combinations a record determines.

From torque alone the sum of two frictions is often known, but not each of them. The singular vectors of the scaled
sensitivities J, without the initial state, are combinations with uncorrelated errors for a white residual. Each is
simplified to the fewest terms that are nearly as well known; its interval uses the whole covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parameters import ADDED, Parameter, Quantity
from jointid.common.text import in_words, interval, number
from jointid.uncertainty.covariance import Covariance

_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_NEARLY = 1.25  # times the deviation of a combination: what leaving its small terms out may make of it
_WELL, _POORLY = 0.1, 0.5  # of its parameters' size: a combination's 2 sigma
_SURROUNDING = (Quantity.POSITION, Quantity.VELOCITY)  # of the initial state, no part of the answer


class Kind(StrEnum):
    """Origin of a combination."""

    ASKED = "asked"
    SINGLE = "single"
    SUM = "sum"
    DIFFERENCE = "difference"
    DIRECTION = "direction"


class Limitation(StrEnum):
    """Limits of what a record determines."""

    INSEPARABLE = "inseparable"
    NOT_SIGNIFICANT = "not_significant"


@dataclass(frozen=True, slots=True)
class Combination:
    """A weighted sum of parameters.

    Attributes:
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
        parameters: by themselves, those of the initial state left out.
        physical: sums and differences with a meaning of their own.
        directions: the combinations of the sensitivities' singular vectors, the best known first.
        condition: of the sensitivities scaled by the parameters: the largest over the smallest singular value.
        limitations: pairs that are known only together, and what must be positive and whose 2-sigma interval holds 0;
            none of a good record.
    """

    parameters: tuple[Known, ...]
    physical: tuple[Known, ...]
    directions: tuple[Known, ...]
    condition: float
    limitations: tuple[Message, ...]


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

    each = tuple(assess(single(p, units[p.name])) for p in joint)
    vectors, condition = _find_directions(J, own, scale)
    directions = [assess(_simplify(vector, joint, units, scale[own], spread)) for vector in vectors]
    pairs = [(i, j) for i in range(len(joint)) for j in range(i + 1, len(joint))]
    limitations = [
        _describe_pair(joint, each, spread, i, j) for i, j in pairs if abs(spread.correlation[i, j]) > _INSEPARABLE
    ]
    for p, one in zip(joint, each, strict=True):
        if p.lower >= 0 and one.interval[0] <= 0.0:
            said = f"{p.symbol} is not significant: its interval holds 0"
            values = {"parameter": p.name, "value": one.value, "std": one.std}
            limitations.append(Message(Limitation.NOT_SIGNIFICANT, said, values))
    return Identifiability(
        each,
        tuple(assess(combination) for combination in physical(joint, units)),
        tuple(sorted(directions, key=lambda one: one.relative)),
        condition,
        tuple(limitations),
    )


def _find_directions(J: FloatArray, own: Sequence[int], scale: FloatArray) -> tuple[FloatArray, float]:
    """Singular vectors of the scaled sensitivities without the rest, and condition."""
    rest = np.delete(J, own, axis=1)
    Q, _ = np.linalg.qr(rest / column_norms(rest))
    columns = (J * scale)[:, own]
    R = np.linalg.qr(columns - Q @ (Q.T @ columns), mode="r")
    _, sizes, vectors = np.linalg.svd(R)
    return vectors, float(sizes[0] / sizes[-1]) if sizes[-1] > 0 else math.inf


def _simplify(
    vector: FloatArray, parameters: Sequence[Parameter], units: Mapping[str, str], scale: FloatArray, spread: Covariance
) -> Combination:
    """Write a direction as a sum led by its largest term, which sets the unit.

    Terms are added by size until the sum is nearly as well known as the whole.
    """
    order = np.argsort(-np.abs(vector))
    weights = vector / scale
    whole = spread.std_of(weights)
    for count in range(1, order.size + 1):
        kept = np.zeros_like(weights)
        kept[order[:count]] = weights[order[:count]]
        share = float(np.linalg.norm(vector[order[:count]]))
        if spread.std_of(kept) / share <= _NEARLY * whole:
            break
    leading = parameters[order[0]]
    kept = kept / weights[order[0]]
    said = f"led by {leading.name.replace('_', ' ')}"
    terms = [(float(kept[i]), parameters[i]) for i in order[:count]]
    formula = _write_sum([(weight, p.symbol) for weight, p in terms])
    return Combination(said, formula, units[leading.name], {p.name: weight for weight, p in terms}, Kind.DIRECTION)


def _write_sum(terms: Sequence[tuple[float, str]]) -> str:
    """Format ``A + 0.5 B - 2 C``; the first weight is 1."""
    text = terms[0][1]
    for weight, symbol in terms[1:]:
        times = "" if number(abs(weight), 3) == number(1.0, 3) else f"{number(abs(weight), 3)} "
        text += f" {'-' if weight < 0 else '+'} {times}{symbol}"
    return text


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
