"""Bounds on a vector of parameters: which are at one, and what a step may do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Lower and upper bounds, each (parameters,)."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Bounds:
        """Return the bounds of parameters, in their order."""
        return cls(np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters]))

    @classmethod
    def none(cls, size: int) -> Bounds:
        """Return no bounds on so many parameters."""
        anywhere = np.full(size, np.inf)
        return cls(-anywhere, anywhere)

    def clip(self, x: FloatArray) -> FloatArray:
        """Return the nearest point within the bounds."""
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def reached(self, x: FloatArray, gap: float | FloatArray = 0.0) -> NDArray[np.bool_]:
        """Return which parameters are at a bound, or nearer to one than `gap`."""
        return np.asarray((x <= self.lower + gap) | (x >= self.upper - gap))

    def blocked(self, x: FloatArray, step: FloatArray) -> NDArray[np.bool_]:
        """Return which parameters are at a bound that a step would lead beyond."""
        return np.asarray(((x <= self.lower) & (step < 0)) | ((x >= self.upper) & (step > 0)))

    def around(self, x: FloatArray) -> Bounds:
        """Return the bounds on a step from a point."""
        return Bounds(self.lower - x, self.upper - x)

    def in_units(self, unit: FloatArray) -> Bounds:
        """Return the bounds on parameters that are divided by positive units."""
        return Bounds(self.lower / unit, self.upper / unit)
