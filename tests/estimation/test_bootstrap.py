"""Bootstraps: the textbook's deviations where they are known, what repeats kept together, seeded."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.uncertainty.covariance import sandwich, white
from jointid.uncertainty.identifiability import Combination
from jointid.uncertainty.position_dependent_error import by_place, cells
from jointid.uncertainty.profile import refit_with_weights
from jointid.uncertainty.resampling import Bootstrapping, bootstrap_estimate
from tests.estimation.linear import linear, parameters, solved
from tests.estimation.motions import NAMES, TRUTH, columns, field, motion
from tests.text import unwrapped

FREE = parameters(*NAMES)
POSITION, VELOCITY, ACCELERATION = motion()
W = columns(VELOCITY, ACCELERATION)


def fitted(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = solved(W, W @ TRUTH + error)
    return x, W @ TRUTH + error - W @ x


def test_white_noise_gives_the_textbook_s_deviations() -> None:
    x, residual = fitted(np.random.default_rng(1).standard_normal(len(W)))
    found = bootstrap_estimate(FREE, x, residual, -W)
    assert found.std == pytest.approx(white(W, residual).std, rel=0.15)
    assert found.correlation == pytest.approx(white(W, residual).correlation, abs=0.1)
    assert np.mean(found.draws, axis=0) == pytest.approx(x, abs=0.2 * float(np.max(found.std)))
    z = (found.intervals - x[:, np.newaxis]) / found.std[:, np.newaxis]
    assert z == pytest.approx(np.tile([-2.0, 2.0], (4, 1)), abs=0.35)


def test_correlated_noise_gives_those_of_the_sandwich() -> None:
    random = np.random.default_rng(2)
    x, residual = fitted(np.convolve(random.standard_normal(len(W) + 4), np.ones(5) / np.sqrt(5.0), "valid"))
    found = bootstrap_estimate(FREE, x, residual, -W)
    assert found.std == pytest.approx(sandwich(W, W, residual).std, rel=0.2)
    assert np.all(found.std > 1.5 * white(W, residual).std)


def test_what_repeats_is_drawn_together() -> None:
    """Blocks of time tear the visits of a cell apart and find too little; cells do not."""
    random = np.random.default_rng(3)
    where = cells(POSITION, VELOCITY)
    error = 0.2 * random.standard_normal(len(W))
    for family in np.unique(where.family):
        error += (where.family == family) * field(random, POSITION, 0.004)
    x, residual = fitted(error)
    of_time = bootstrap_estimate(FREE, x, residual, -W)
    of_cells = bootstrap_estimate(FREE, x, residual, -W, where.stretch)
    assert np.all(of_cells.std[1:] > 1.3 * of_time.std[1:])
    assert of_cells.std == pytest.approx(by_place(W, W, residual, where).std, rel=0.35)
    assert of_cells.blocks == np.unique(where.stretch).size
    assert "all visits together" in unwrapped(str(of_cells))


def test_a_refit_of_a_linear_problem_is_one_step() -> None:
    x, residual = fitted(np.random.default_rng(4).standard_normal(len(W)))
    settings = Bootstrapping(draws=5, seed=7)
    toy = linear(FREE, W, W @ TRUTH + np.random.default_rng(4).standard_normal(len(W)))
    one = bootstrap_estimate(FREE, x, residual, -W, settings=settings)
    full = bootstrap_estimate(FREE, x, residual, -W, settings=settings, refit=partial(refit_with_weights, toy, x))
    assert full.draws == pytest.approx(one.draws, rel=1e-6)
    assert "refitted each" in str(full)


def test_a_seed_is_a_seed() -> None:
    x, residual = fitted(np.random.default_rng(5).standard_normal(len(W)))
    first, second, third = (
        bootstrap_estimate(FREE, x, residual, -W, settings=Bootstrapping(draws=20, seed=seed)).draws
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, second)
    assert not np.array_equal(first, third)


def test_a_sum_has_its_own_interval() -> None:
    x, residual = fitted(np.random.default_rng(6).standard_normal(len(W)))
    found = bootstrap_estimate(FREE, x, residual, -W)
    total = Combination("both", "VISCOUS + COULOMB / 0.08", "", {"viscous": 1.0, "coulomb": 12.0})
    std = np.std(found.draws @ total.vector(FREE), ddof=1)
    assert std == pytest.approx(white(W, residual).std_of(total.vector(FREE)), rel=0.15)
    assert std < found.std[1]


def test_nearly_parallel_columns_are_no_obstacle() -> None:
    random = np.random.default_rng(7)
    A = random.normal(size=(2000, 2)) * [1.0, 1e6]
    A[:, 1] = 1e6 * A[:, 0] + 1e-4 * A[:, 1]
    y = A @ [2.0, 1e-6] + random.standard_normal(2000)
    x = solved(A / [1.0, 1e6], y) / [1.0, 1e6]
    found = bootstrap_estimate(parameters("a", "b"), x, y - A @ x, -A)
    assert found.std == pytest.approx(white(A, y - A @ x).std, rel=0.15)


def test_what_rests_on_the_first_rows_alone_does_not_run_away() -> None:
    first = 1.0 * (np.arange(len(W)) < 10)
    A = np.column_stack([W, first])
    y = A @ [*TRUTH, 5.0] + np.random.default_rng(9).standard_normal(len(W))
    x = solved(A, y)
    found = bootstrap_estimate(parameters(*NAMES, "kick"), x, y - A @ x, -A)
    assert found.std[:4] == pytest.approx(white(A, y - A @ x).std[:4], rel=0.15)
    assert found.std[4] <= 1.0


def test_an_estimate_that_is_no_minimum_is_still_the_centre() -> None:
    x, residual = fitted(np.random.default_rng(10).standard_normal(len(W)))
    off = 3.0 * white(W, residual).std
    found = bootstrap_estimate(FREE, x + off, residual - W @ off, -W)
    assert np.mean(found.draws, axis=0) == pytest.approx(x + off, abs=0.3 * float(np.max(found.std)))
    assert np.abs(np.mean(found.draws, axis=0) - x - off) / found.std == pytest.approx(np.zeros(4), abs=0.3)


def test_a_short_record_is_refused() -> None:
    x, residual = fitted(np.random.default_rng(8).standard_normal(len(W)))
    with pytest.raises(MethodError, match="8 blocks or more; this record has 5"):
        bootstrap_estimate(FREE, x, residual[:60], -W[:60])
    with pytest.raises(MethodError, match="this record has 2"):
        bootstrap_estimate(FREE, x, residual, -W, np.arange(len(W)) % 2)


@pytest.mark.parametrize("wrong", [{"draws": 1}, {"level": 0.0}, {"seed": -1}])
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(MethodError, match="A bootstrap needs"):
        Bootstrapping(**wrong)  # type: ignore[arg-type]
