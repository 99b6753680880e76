"""What a record tells, and what it does not: the combinations of parameters that are known, best first.

From torque alone two frictions are often known by their sum and hardly apart, and a table of single parameters hides
both. The sensitivities J of the residual, each multiplied by its parameter and freed of what the initial state can
take over, have singular vectors that are combinations whose errors are uncorrelated as far as a white residual goes,
from the best determined to the worst. Each is written with the fewest terms that are nearly as well known, and gets
its interval from the whole covariance, as do the sums that have a meaning of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.messages import Message
from jointid.common.text import aligned, number
from jointid.models.parameters import Parameter, Quantity
from jointid.uncertainty.combination import Combination, Kind, physical, single
from jointid.uncertainty.covariance import Covariance

_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_NEARLY = 1.25  # times the deviation of a combination: what leaving its small terms out may make of it
_WELL, _POORLY = 0.1, 0.5  # of its parameters' size: a combination's 2 sigma
_SURROUNDING = (Quantity.POSITION, Quantity.VELOCITY)  # of the initial state, no part of the answer


class Limitation(StrEnum):
    """What a record does not determine."""

    INSEPARABLE = "inseparable"
    NOT_SIGNIFICANT = "not_significant"


@dataclass(frozen=True, slots=True)
class Known:
    """A combination of parameters, its value, and how well it is known.

    Attributes:
        combination: see there.
        value: of it.
        std: standard deviation.
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
        """How well it is known, in a word: 2 sigma up to 10 % of what is combined, up to 50 %, or more."""
        return "well" if 2 * self.relative <= _WELL else "poorly" if 2 * self.relative <= _POORLY else "not"


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What a record tells of the parameters of a joint.

    Attributes:
        parameters: by themselves, those of the initial state left out.
        physical: sums and differences with a meaning of their own.
        directions: the combinations of the sensitivities' singular vectors, the best known first.
        condition: of the sensitivities scaled by the parameters: the largest over the smallest singular value.
        undetermined: names of what must be positive and is not told from 0: the 2-sigma interval holds it.
        limitations: pairs that are known only together, and what is not told from 0; none of a good record.
    """

    parameters: tuple[Known, ...]
    physical: tuple[Known, ...]
    directions: tuple[Known, ...]
    condition: float
    undetermined: tuple[str, ...]
    limitations: tuple[Message, ...]

    def __str__(self) -> str:
        """Return tables and sentences."""
        header, right = ("combination", "value", "2 sigma", "unit", "known"), (False, True, True, False, False)
        parts = [
            aligned(header, [_row(known) for known in group], right)
            for group in (self.physical, self.directions)
            if group
        ]
        said = f"condition number {self.condition:.3g}, of the sensitivities scaled by the parameters"
        return "\n\n".join([*parts, "\n".join([said, *map(str, self.limitations)])])


def identifiability(
    parameters: Sequence[Parameter],
    units: Mapping[str, str],
    x: FloatArray,
    J: FloatArray,
    covariance: Covariance,
) -> Identifiability:
    """Return what is known of the parameters, and of their combinations.

    Args:
        parameters: the free ones, in the order of what follows.
        units: of them, by name; those of the initial state are not needed.
        x: (free,) their values.
        J: (rows, free), the sensitivities of the residual or of the prediction.
        covariance: of the estimate, to be believed.
    """
    own = [i for i, p in enumerate(parameters) if p.quantity not in _SURROUNDING]
    joint = [parameters[i] for i in own]
    scale = np.where(x == 0.0, covariance.std, np.abs(x))
    scale = np.where(scale > 0, scale, 1.0)

    def known(combination: Combination) -> Known:
        weights = combination.vector(parameters)
        std = covariance.std_of(weights)
        return Known(combination, float(weights @ x), std, std / float(np.linalg.norm(weights * scale)))

    each = tuple(known(single(p, units[p.name])) for p in joint)
    vectors, condition = _directions(J, own, scale)
    directions = [known(_readable(vector, joint, units, scale[own], _chosen(covariance, own))) for vector in vectors]
    undetermined = tuple(p.name for p, one in zip(joint, each, strict=True) if p.lower >= 0 and one.interval[0] <= 0.0)
    lost = [_not_significant(p, one) for p, one in zip(joint, each, strict=True) if p.name in undetermined]
    return Identifiability(
        each,
        tuple(known(combination) for combination in physical(joint, units)),
        tuple(sorted(directions, key=lambda one: one.relative)),
        condition,
        undetermined,
        (*_inseparable(joint, each, _chosen(covariance, own)), *lost),
    )


def _directions(J: FloatArray, own: Sequence[int], scale: FloatArray) -> tuple[FloatArray, float]:
    """Return the right singular vectors of the scaled sensitivities, the rest projected off, and their condition."""
    rest = np.delete(J, own, axis=1)
    Q, _ = np.linalg.qr(rest / column_norms(rest))
    columns = (J * scale)[:, own]
    R = np.linalg.qr(columns - Q @ (Q.T @ columns), mode="r")
    _, sizes, vectors = np.linalg.svd(R)
    return vectors, float(sizes[0] / sizes[-1]) if sizes[-1] > 0 else math.inf


def _chosen(covariance: Covariance, own: Sequence[int]) -> Covariance:
    return Covariance(covariance.std[list(own)], covariance.correlation[np.ix_(own, own)], covariance.bandwidth)


def _readable(
    vector: FloatArray, parameters: Sequence[Parameter], units: Mapping[str, str], scale: FloatArray, spread: Covariance
) -> Combination:
    """Return a direction in scaled parameters as a sum led by its largest term, which gives it its unit.

    Terms are added, the largest first, until the sum is nearly as well known as the whole.
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
    terms = [(float(kept[i]), parameters[i].symbol) for i in order[:count]]
    said = f"led by {leading.name.replace('_', ' ')}"
    weighed = {parameters[i].name: float(kept[i]) for i in order[:count]}
    return Combination(said, _formula(terms), units[leading.name], weighed, Kind.DIRECTION)


def _formula(terms: Sequence[tuple[float, str]]) -> str:
    """Return ``A + 0.5 B - 2 C``; the first term has the weight 1."""
    first, *others = terms
    written = [f"{'-' if weight < 0 else '+'} {_times(abs(weight))}{symbol}" for weight, symbol in others]
    return " ".join([first[1], *written])


def _times(weight: float) -> str:
    return "" if number(weight, 3) == number(1.0, 3) else f"{number(weight, 3)} "


def _inseparable(parameters: Sequence[Parameter], each: Sequence[Known], spread: Covariance) -> tuple[Message, ...]:
    """Return a message for every two parameters that are known only together."""
    return tuple(
        _together(parameters, each, spread, i, j)
        for i in range(len(parameters))
        for j in range(i + 1, len(parameters))
        if abs(spread.correlation[i, j]) > _INSEPARABLE
    )


def _together(parameters: Sequence[Parameter], each: Sequence[Known], spread: Covariance, i: int, j: int) -> Message:
    first, second = parameters[i], parameters[j]
    correlation, unit = float(spread.correlation[i, j]), each[i].combination.unit
    weights = np.zeros(len(parameters))
    weights[i] = 1.0
    alike = each[i].combination.unit == each[j].combination.unit
    # Of two that are measured alike the plain sum or difference is told, of others what is known best.
    weights[j] = -math.copysign(1.0 if alike else spread.std[i] / spread.std[j], correlation)
    value, std = float(weights @ [known.value for known in each]), spread.std_of(weights)
    if alike:
        by = "sum" if correlation < 0 else "difference"
        what = f"their {by}: {number(value, 4)} +- {number(2 * std, 2)} {unit}"
    else:
        formula = _formula([(1.0, first.symbol), (float(weights[j]), second.symbol)])
        what = f"{formula}: {number(value, 4)} +- {number(2 * std, 2)} {unit}"
    apart = f"apart {first.symbol} only to +- {number(2 * each[i].std, 2)}"
    other = f"{second.symbol} to +- {number(2 * each[j].std, 2)}{'' if alike else f' {each[j].combination.unit}'}"
    said = f"{first.symbol} and {second.symbol} are known by {what}; {apart}, {other} (correlation {correlation:+.3f})"
    values = {"parameters": [first.name, second.name], "weight": float(weights[j]), "value": value, "std": std}
    return Message(Limitation.INSEPARABLE, said, values | {"unit": unit, "correlation": correlation})


def _not_significant(p: Parameter, known: Known) -> Message:
    said = f"{p.symbol} is not told from 0: its interval holds it"
    return Message(Limitation.NOT_SIGNIFICANT, said, {"parameter": p.name, "value": known.value, "std": known.std})


def _row(known: Known) -> tuple[str, ...]:
    c = known.combination
    return c.formula, number(known.value), number(2 * known.std, 2), c.unit, known.verdict
