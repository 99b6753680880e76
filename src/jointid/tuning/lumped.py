"""The whole joint's inertia, friction and constant force, with what an estimate knows of their errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jointid.estimation.result.estimate import Estimate
from jointid.models.friction import PARTS


@dataclass(frozen=True, slots=True)
class LumpedParameter:
    """A weighted sum of parameters, both sides of a joint together.

    Attributes:
        formula: in symbols. value: in SI on the joint's side. std: None where nothing of it was free.
    """

    formula: str
    value: float
    std: float | None


def lumped_parameters(estimate: Estimate) -> dict[str, LumpedParameter]:
    """Return inertia, viscous and Coulomb friction and the constant force of the whole joint, by those names.

    Of friction that differs with the direction viscous and Coulomb friction are the means of both directions, and half
    the difference of the Coulomb forces belongs to the constant.
    """
    sides = ("motor_", "load_") if estimate.settings.joint.model == "flexible" else ("",)
    law = estimate.settings.joint.friction
    friction: dict[str, dict[str, float]] = {
        part: {n: w for side in sides for n, w in law.mean(part, side).items()} for part in PARTS
    }
    constant: dict[str, float] = {n: w for side in sides for n, w in law.constant(side).items()}
    names = {p.name for p in estimate.params}
    constant |= {name: 1.0 for name in ("offset", "gravity_constant") if name in names}
    wanted = {"inertia": {f"{side}inertia": 1.0 for side in sides}, **friction, "constant": constant}
    return {name: _total(estimate, weights) for name, weights in wanted.items()}


def _total(estimate: Estimate, weights: Mapping[str, float]) -> LumpedParameter:
    if not weights:  # the law has no such friction
        return LumpedParameter("0", 0.0, None)
    formula = _formula(estimate, weights)
    if estimate.checks.bounds:
        return _of_sums(estimate, weights, formula)
    free = [p.name for p in estimate.params if p.free]
    value = sum(weight * estimate.values[name] for name, weight in weights.items())
    spread = {name: weight * std for name, weight in weights.items() if (std := estimate[name].stderr)}
    if not spread:
        return LumpedParameter(formula, value, None)
    square = 0.0
    for one, size in spread.items():
        for other, its in spread.items():
            i, j = free.index(one), free.index(other)
            known = max(i, j) < len(estimate.params.correlation)
            square += size * its * (float(estimate.params.correlation[i, j]) if known else float(i == j))
    return LumpedParameter(formula, value, math.sqrt(max(square, 0.0)))


def _of_sums(estimate: Estimate, weights: Mapping[str, float], formula: str) -> LumpedParameter:
    """Return a sum where only those of both sides are told; what their errors have in common is not kept: no less."""
    assert estimate.checks.known is not None
    value, std = 0.0, 0.0
    for known in estimate.checks.known.physical:
        weight = weights.get(next(iter(known.combination.weights)))
        if weight is not None:
            value, std = value + weight * known.value, std + abs(weight) * known.std
    for name, weight in weights.items():
        if name in estimate.values:  # what both sides have in common, and what was fixed
            value, std = value + weight * estimate.values[name], std + abs(weight) * (estimate[name].stderr or 0.0)
    return LumpedParameter(formula, value, std or None)


def _formula(estimate: Estimate, weights: Mapping[str, float]) -> str:
    """Return the sum in symbols, with a mean written as one."""
    kept = {name: w for name, w in weights.items() if estimate[name].free or estimate.values.get(name)} or weights
    halves = all(abs(w) == 0.5 for w in kept.values())
    terms = [
        ("- " if w < 0 else "+ ") + ("" if halves or abs(w) == 1 else f"{abs(w):g} ") + estimate[name].symbol
        for name, w in kept.items()
    ]
    joined = " ".join(terms).removeprefix("+ ")
    return f"({joined})/2" if halves else joined
