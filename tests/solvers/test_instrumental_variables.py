"""Instrumental variables where the columns are noisy: least squares is biased, and the closed form is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from jointid.common.parameters import Parameter, Quantity
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.regression import InstrumentalSolution, InstrumentalVariables
from jointid.solvers.solve import Status, solve

Array = np.ndarray
TRUTH = np.array([2.0, -3.0])
RANDOM = np.random.default_rng(1)
KNOWN = RANDOM.standard_normal((400, 2))
ERROR = RANDOM.standard_normal((400, 2))
MEASURED = KNOWN + 0.5 * ERROR  # what disturbs the columns ...
Y = KNOWN @ TRUTH + 0.3 * ERROR[:, 0]  # ... disturbs the measurement, too
IV = np.linalg.solve(KNOWN.T @ MEASURED, KNOWN.T @ Y)


@dataclass(frozen=True)
class NoisyColumns:
    upper: float = np.inf
    seen: float = 1.0

    @property
    def free(self) -> tuple[Parameter, ...]:
        return (
            Parameter("a", "a", Quantity.RATIO, upper=self.upper),
            Parameter("b", "b", Quantity.RATIO),
        )

    def residual(self, x: Array) -> Array:
        return self.linearise(x)[0]

    def linearise(self, x: Array) -> tuple[Array, Array]:
        return Y - MEASURED @ x, -MEASURED

    def instruments(self, x: Array) -> Array:
        return -self.seen * KNOWN


def deviations(Z: Array, J: Array, error: Array) -> Array:
    return np.full(Z.shape[1], 1e-6)


def solver(iterations: int = 25, **given: bool) -> InstrumentalVariables:
    kept, signed = (np.full(2, given.get(name, False)) for name in ("kept", "signed"))
    return InstrumentalVariables(deviations, kept, signed, iterations)


def found(problem: NoisyColumns, by: InstrumentalVariables, start: Array) -> InstrumentalSolution:
    end = solve(problem, by, start)
    assert isinstance(end, InstrumentalSolution)
    return end


def test_the_closed_form_is_met_where_least_squares_is_biased() -> None:
    biased = solve(NoisyColumns(), LevenbergMarquardt(1e-10), np.zeros(2))
    assert abs(biased.x[0] - TRUTH[0]) > 0.2
    end = found(NoisyColumns(), solver(), biased.x)
    assert end.x == pytest.approx(IV, rel=1e-12)
    assert end.x == pytest.approx(TRUTH, abs=0.15)
    assert end.status is Status.STEP
    assert end.evaluations == len(end.trace) + 1 == 3
    assert np.abs(end.instruments.T @ end.residual).max() < 1e-9


def test_a_bound_that_holds_leaves_the_other_equation() -> None:
    end = found(NoisyColumns(upper=1.0), solver(), np.array([0.5, 0.0]))
    assert end.x[0] == 1.0
    assert list(end.moving) == [False, True]
    assert KNOWN[:, 1] @ end.residual == pytest.approx(0.0, abs=1e-9)


def test_a_parameter_that_keeps_its_sign_goes_there_in_short_steps() -> None:
    end = found(NoisyColumns(), solver(signed=True), np.array([0.5, -1.0]))
    assert end.trace[0].x == pytest.approx([0.5, -1.0], rel=0.31)
    assert end.x == pytest.approx(IV, rel=1e-6)


def test_what_cannot_be_solved_is_said() -> None:
    assert found(NoisyColumns(), solver(iterations=1), np.zeros(2)).status is Status.EVALUATION_LIMIT
    unseen = found(NoisyColumns(seen=0.0), solver(), np.ones(2))
    assert unseen.status is Status.NOT_EVALUABLE
    assert list(unseen.x) == [1.0, 1.0]
    assert found(NoisyColumns(), solver(kept=True), np.ones(2)).status is Status.NOT_EVALUABLE
