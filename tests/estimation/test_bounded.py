"""The way down a criterion, where the lowest point within bounds is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from jointid.common.progress import silent
from jointid.models.parameters import Parameter, Quantity
from jointid.solvers.levenberg_marquardt import descend


@dataclass(frozen=True)
class Curved:
    """Rosenbrock's valley as residuals, with bounds; and columns of sizes 1e12 apart."""

    lower: float = -np.inf
    upper: float = np.inf

    @property
    def free(self) -> tuple[Parameter, ...]:
        return (
            Parameter("x", "x", Quantity.FORCE, lower=self.lower, upper=self.upper),
            Parameter("y", "y", Quantity.FORCE),
        )

    def residual(self, x: np.ndarray) -> np.ndarray:
        return self.linearised(x)[0]

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = x[0], x[1] * 1e12
        return np.array([10 * (b - a * a), 1 - a]), np.array([[-20 * a, 1e13], [-1.0, 0.0]])


def test_a_curved_valley_is_followed_to_its_end() -> None:
    end = descend(Curved(), [np.array([-1.2, 1e-12])], 1e-10, silent)
    assert end.converged
    assert end.x == pytest.approx([1.0, 1e-12], rel=1e-6)
    assert end.evaluations < 40
    assert all(after <= before for before, after in zip(end.norms, end.norms[1:], strict=False))


def test_a_bound_that_holds_is_reached_exactly() -> None:
    end = descend(Curved(upper=0.5), [np.array([-1.2, 1e-12])], 1e-10, silent)
    assert end.x[0] == 0.5
    assert end.x[1] == pytest.approx(0.25e-12, rel=1e-6)
    assert end.converged


def test_several_starts_say_how_many_agree() -> None:
    end = descend(Curved(), [np.array([-1.2, 1e-12]), np.array([2.0, 4e-12])], 1e-10, silent)
    assert "(2 of 2 starts end there)" in end.stop


@dataclass(frozen=True)
class Cliff(Curved):
    """A criterion that cannot be evaluated, and is large, before its lowest point."""

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if x[0] > 0.0:
            return np.full(2, 1e6), np.zeros((2, 2))
        return super().linearised(x)


def test_a_cliff_is_no_minimum() -> None:
    end = descend(Cliff(), [np.array([-1.2, 1e-12])], 1e-10, silent)
    assert not end.converged
    assert "not converged" in end.stop
    assert end.x[0] <= 0.0
