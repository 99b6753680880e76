"""Criteria with known answers, which the tests of everything that judges an estimate share."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter, Quantity


def parameters(*names: str, lower: float = -math.inf, quantity: Quantity = Quantity.VISCOUS) -> tuple[Parameter, ...]:
    """Return free parameters whose symbols are their names in capitals."""
    return tuple(Parameter(name, name.upper(), quantity, lower=lower) for name in names)


@dataclass
class Toy:
    """``y - model(x)``, with the derivatives of the model.

    Attributes:
        free: the parameters.
        measured: (rows,) y.
        model: of the parameters, (rows,).
        derivatives: of the model, (rows, free).
        asked: how often it was evaluated.
    """

    free: tuple[Parameter, ...]
    measured: FloatArray
    model: Callable[[FloatArray], FloatArray]
    derivatives: Callable[[FloatArray], FloatArray]
    asked: list[int] = field(default_factory=list)

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives."""
        self.asked.append(1)
        return self.measured - self.model(x), -self.derivatives(x)


def linear(free: tuple[Parameter, ...], A: FloatArray, y: FloatArray) -> Toy:
    """Return ``y - A x``."""
    return Toy(free, y, lambda x: np.asarray(A @ x), lambda _: A)


def solved(A: FloatArray, y: FloatArray) -> FloatArray:
    """Return the least-squares solution."""
    return np.asarray(np.linalg.lstsq(A, y, rcond=None)[0])
