"""Goals of a test: a parameter, a combination, or all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics.intervals import weights_of

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

    def score(self, covariance: FloatArray, names: Sequence[str], values: Mapping[str, float]) -> float:
        """Logarithmic objective; lower is better, differences are relative. Offsets do not count beside others.

        Args:
            covariance: (parameters, parameters).
            names: of the parameters, in their order.
            values: of them, the scale of deviations if the goal is all of them.
        """
        if self.weights:
            asked = [i for i, name in enumerate(names) if name in self.weights]
            w, own = np.array([self.weights[names[i]] for i in asked]), covariance[np.ix_(asked, asked)]
            return 0.5 * math.log(max(float(w @ own @ w), _TINY)) if np.all(np.isfinite(own)) else math.inf
        if not np.all(np.isfinite(covariance)):
            return math.inf
        size = np.array([abs(values[name]) if abs(values[name]) > _ZERO else 1.0 for name in names])
        kept = [i for i, name in enumerate(names) if "offset" not in name] or [*range(len(names))]
        relative = (covariance / np.outer(size, size))[np.ix_(kept, kept)]
        found = np.maximum(np.linalg.eigvalsh(relative), _TINY)
        return 0.5 * float(np.mean(np.log(found)))


def parse_goal(name: str, units: Mapping[str, str]) -> Goal:
    """Parse a goal.

    Args:
        name: of a parameter, a sum or a difference such as "motor_viscous - load_viscous", or "all".
        units: of the free parameters, by name.
    """
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
