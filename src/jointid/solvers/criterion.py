"""What the estimator layer sees of a problem: free parameters in, a residual and its derivative out.

A closed loop, a prescribed motion, a prescribed torque, or several records together are the same to it, and so will
be one joint and a robot of many.
"""

from __future__ import annotations

from typing import Protocol

from jointid.common.arrays import FloatArray
from jointid.models.parameters import Parameter


class Criterion(Protocol):
    """A vector of free parameters in, the filtered, decimated residual (measured less predicted) out."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified, in the order of every vector and column."""

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,); large and finite where the candidate cannot be simulated."""

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
