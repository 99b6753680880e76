"""Goals of a test: a parameter, a combination, or all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.errors import MethodError
from jointid.diagnostics.intervals import weights_of
from jointid.planning.predict import PredictedTest

ALL = "all"
"""The goal beside those that name a quantity: the volume of the intervals (D-optimal)."""

_TINY = 1e-30
_ZERO = 1e-9  # of a value: what is less is rounding, and no scale


@dataclass(frozen=True, slots=True)
class Goal:
    """Goal of a test.

    Attributes:
        weights: of the parameters, by name, where it is one or a combination of them; else none.
    """

    name: str
    weights: Mapping[str, float]

    def score(self, test: PredictedTest) -> float:
        """Logarithmic objective of a test; lower is better, differences are relative.

        If the goal is all parameters, deviations are scaled by the values, and offsets do not count beside others.
        """
        covariance, names, values = test.covariance, test.joint, test.values
        own = [i for i, name in enumerate(names) if (name in self.weights if self.weights else "offset" not in name)]
        own = own or [*range(len(names))]
        if not np.all(np.isfinite(covariance.std[own])):
            return math.inf
        std = covariance.std[own]
        matrix = np.outer(std, std) * covariance.correlation[np.ix_(own, own)]
        if self.weights:
            w = np.array([self.weights[names[i]] for i in own])
            return 0.5 * math.log(max(float(w @ matrix @ w), _TINY))
        size = np.array([abs(values[names[i]]) if abs(values[names[i]]) > _ZERO else 1.0 for i in own])
        found = np.maximum(np.linalg.eigvalsh(matrix / np.outer(size, size)), _TINY)
        return 0.5 * float(np.mean(np.log(found)))


def parse_goal(name: str, units: Mapping[str, str]) -> Goal:
    """Parse a goal: the name of a free parameter, a sum or a difference of them, or "all"; `units` are of these."""
    if name == ALL:
        return Goal(name, {})
    weights = weights_of(name)
    unknown = [one for one in weights if one not in units]
    if unknown:
        raise MethodError(
            f'The goal "{name}" names {", ".join(unknown)}, which is no free parameter here; choose from '
            f'{", ".join(units)}, a sum or a difference of them, or "{ALL}".'
        )
    several = sorted({units[one] for one in weights})
    if len(several) > 1:
        raise MethodError(f'The goal "{name}" adds {" and ".join(several)}; only what has one unit can be added.')
    return Goal(name, weights)
