"""Profiles: the textbook's interval where the problem is linear, the right one where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from jointid.common.parameters import Parameter, Quantity
from jointid.uncertainty.covariance import Influence, white
from jointid.uncertainty.identifiability import Combination, single
from jointid.uncertainty.profile import by_compliance, profile
from tests.estimation.linear import Toy, linear, parameters, solved

ROWS = 60


def line(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    A = random.normal(size=(ROWS, 3)) * [1.0, 1e-3, 50.0]
    A[:, 1] += 0.9995e-3 * A[:, 0]
    return A, A @ [3.0, 2000.0, -0.1] + 0.4 * random.standard_normal(ROWS)


@pytest.mark.parametrize("which", [0, 1, 2, "sum"])
def test_a_linear_problem_has_the_textbook_s_interval(which: int | str) -> None:
    A, y = line()
    free = parameters("a", "b", "c")
    x = solved(A, y)
    asked = Combination("sum", "A + B", "", {"a": 1.0, "b": 1e-3}) if which == "sum" else single(free[int(which)], "")
    weights = asked.vector(free)
    toy = linear(free, A, y)
    found = profile(toy, x, asked, white(A, y - A @ x))
    s2 = np.sum((y - A @ x) ** 2) / (ROWS - 3)
    half = stats.t.ppf(0.5 + 0.9545 / 2, ROWS - 3) * np.sqrt(s2 * weights @ np.linalg.inv(A.T @ A) @ weights)
    assert found.bounded
    assert found.interval == pytest.approx((weights @ x - half, weights @ x + half), rel=1e-6, abs=1e-6 * half)
    assert found.evaluations == len(toy.asked)
    assert not found.improved
    assert np.all(np.diff(found.points) > 0)
    expected = (found.points - found.estimate) ** 2 / (weights @ np.linalg.inv(A.T @ A) @ weights)
    assert found.rise == pytest.approx(expected, rel=1e-5, abs=1e-9)


def test_another_covariance_scales_the_threshold() -> None:
    A, y = line(1)
    free, x = parameters("a", "b", "c"), solved(A, y)
    by_lags = Influence(A, y - A @ x).by_time()
    found = profile(linear(free, A, y), x, single(free[2], ""), by_lags)
    half = stats.t.ppf(0.5 + 0.9545 / 2, ROWS - 3) * by_lags.std[2]
    assert found.interval == pytest.approx((x[2] - half, x[2] + half), rel=1e-6)


def decay(seed: int) -> Toy:
    """Return ``a exp(-b t)``, little of which is left to tell b from larger ones."""
    time = np.linspace(0.0, 4.0, 80)
    random = np.random.default_rng(seed)
    free = (*parameters("a"), *parameters("b", lower=0.0))
    return Toy(
        free,
        5.0 * np.exp(-0.8 * time) + 0.7 * random.standard_normal(time.size),
        lambda x: x[0] * np.exp(-x[1] * time),
        lambda x: np.column_stack([np.exp(-x[1] * time), -x[0] * time * np.exp(-x[1] * time)]),
    )


def minimum(toy: Toy, start: np.ndarray) -> np.ndarray:
    from scipy.optimize import least_squares

    error, slopes = (lambda x, k=k: toy.linearise(x)[k] for k in (0, 1))
    return np.asarray(least_squares(error, start, slopes, xtol=1e-14, ftol=1e-14).x)


def test_a_bent_problem_is_profiled_as_by_hand() -> None:
    toy = decay(2)
    x = minimum(toy, np.array([5.0, 0.8]))
    residual, J = toy.linearise(x)
    toy.asked.clear()
    found = profile(toy, x, single(toy.free[1], "1/s"), white(J, residual))
    assert found.evaluations == len(toy.asked)
    time = np.linspace(0.0, 4.0, 80)
    grid = np.linspace(0.3, 2.5, 20001)
    shapes = np.exp(-grid[:, np.newaxis] * time)
    best = shapes @ toy.measured / np.sum(shapes**2, axis=1)
    rise = np.sum((toy.measured - best[:, np.newaxis] * shapes) ** 2, axis=1) - residual @ residual
    inside = grid[rise <= found.threshold]
    assert found.interval == pytest.approx((inside[0], inside[-1]), rel=0.01)
    low, high = found.interval
    assert high - x[1] > 1.1 * (x[1] - low)  # which no symmetric interval is


def test_a_bound_within_the_interval_leaves_it_open() -> None:
    A, y = line(3)
    free = tuple(replace(p, lower=low) for p, low in zip(parameters("a", "b", "c"), (-9.0, -9e9, -9.0), strict=True))
    x = solved(A, y)
    std = white(A, y - A @ x).std
    held = (replace(free[0], lower=x[0] - std[0]), *free[1:])
    found = profile(linear(held, A, y), x, single(held[0], ""), white(A, y - A @ x))
    assert found.interval[0] is None
    assert found.interval[1] is not None
    assert not found.bounded
    assert found.reached[0] == pytest.approx(x[0] - std[0], abs=1e-3 * std[0])


def test_what_leaves_no_trace_has_no_ends() -> None:
    A, y = line(4)
    A[:, 1] = 2e-3 * A[:, 0]
    free = parameters("a", "b", "c")
    x = solved(A, y)
    assert profile(linear(free, A, y), x, single(free[0], ""), white(A, y - A @ x)).interval == (None, None)
    together = Combination("both", "A + 0.002 B", "", {"a": 1.0, "b": 2e-3})
    assert profile(linear(free, A, y), x, together, white(A, y - A @ x)).bounded


def test_candidates_that_cannot_be_simulated_end_the_interval() -> None:
    """They come back large and finite, at any parameter: the end is where they begin."""
    A, y = line(6)
    x = solved(A, y)
    std = white(A, y - A @ x).std
    limit = x[2] + 0.8 * std[2]
    toy = linear(parameters("a", "b", "c"), A, y)
    failing = replace(toy, model=lambda x: A @ x if x[2] <= limit else np.full(ROWS, 1e6))
    found = profile(failing, x, single(toy.free[2], ""), white(A, y - A @ x))
    assert found.interval[1] == pytest.approx(limit, abs=0.05 * std[2])
    assert found.interval[0] == pytest.approx(x[2] - 2.046 * std[2], abs=0.01 * std[2])


def test_a_wrong_minimum_is_noticed() -> None:
    A, y = line(5)
    free = parameters("a", "b", "c")
    x = solved(A, y)
    off = x + 0.7 * white(A, y - A @ x).std * np.eye(3)[2]
    found = profile(linear(free, A, y), off, single(free[2], ""), white(A, y - A @ x))
    assert found.improved
    right = profile(linear(free, A, y), x, single(free[2], ""), white(A, y - A @ x))
    assert found.interval == pytest.approx(right.interval, rel=0.6)


def spring(stiffness: float, noise: float, seed: int = 0) -> Toy:
    """Return a deflection under a known load, ``a + load / K``."""
    random = np.random.default_rng(seed)
    load = np.linspace(-1.0, 1.0, 200)
    free = (*parameters("a"), Parameter("stiffness", "K12", Quantity.STIFFNESS, lower=0.0))
    return Toy(
        free,
        0.3 + load / stiffness + noise * random.standard_normal(load.size),
        lambda x: x[0] + load / x[1],
        lambda x: np.column_stack([np.ones_like(load), -load / x[1] ** 2]),
    )


def test_a_stiffness_that_is_seen_is_bounded_by_its_compliance() -> None:
    toy = spring(2.0, 0.1)
    x = minimum(toy, np.array([0.0, 1.0]))
    by = by_compliance(toy, 1e-4)
    assert [p.name for p in by.free] == ["a", "compliance"]
    assert by.free[1].symbol == "1/K12"
    there = by.turn(x)
    assert by.turn(there) == pytest.approx(x)
    residual, J = by.linearise(there)
    step = 1e-6 * np.eye(2)[1]
    slope = (by.linearise(there + step)[0] - by.linearise(there - step)[0]) / 2e-6
    assert J[:, 1] == pytest.approx(slope, abs=1e-7)
    assert residual == pytest.approx(toy.linearise(x)[0])
    found = profile(by, there, single(by.free[1], "m/N"), white(J, residual))
    low, high = found.interval
    assert low < 0.5 < high
    assert high - there[1] == pytest.approx(there[1] - low, rel=1e-4)  # in the compliance it is linear


def test_a_stiffness_that_is_not_seen_has_a_lower_bound_only() -> None:
    toy = spring(1e3, 0.1, seed=3)
    by = by_compliance(toy, 1e-6)
    start = np.array([0.3, 1e-3])
    error, J = by.linearise(start)
    found = profile(by, start, single(by.free[1], "m/N"), white(J, error))
    assert found.interval[0] is None
    assert 0.005 < found.interval[1] < 0.08
    assert found.reached[0] <= 1e-5
