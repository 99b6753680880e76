"""Flexible against rigid: chance is called chance as often as it should be, a spring is found, its opposite is not."""

import numpy as np
import pytest

from jointid.common.messages import Message
from jointid.uncertainty.model_tests import flexible_against_rigid
from jointid.uncertainty.position_dependent_error import Cells, cells
from tests.estimation.linear import solved
from tests.estimation.motions import columns, field, low_passed, motion

POSITION, VELOCITY, ACCELERATION = motion()
W = columns(VELOCITY, ACCELERATION)
WHERE = cells(POSITION, VELOCITY)
SMOOTH = np.convolve(ACCELERATION, np.ones(9) / 9, "same")
BEND = np.gradient(np.gradient(SMOOTH))
BEND = -(BEND / np.linalg.norm(BEND))[:, np.newaxis]  # of the residual: a compliance adds to the prediction
SLOPE = np.gradient(SMOOTH)[:, np.newaxis] / np.linalg.norm(np.gradient(SMOOTH))


def quick(residual: np.ndarray, extra: list[np.ndarray], where: Cells | None = None) -> Message:
    return flexible_against_rigid(residual, -W, extra, where, draws=399)


def left(error: np.ndarray) -> np.ndarray:
    return np.asarray(error - W @ solved(W, error))


def noise(random: np.random.Generator, kind: str) -> np.ndarray:
    if kind == "coloured":
        return low_passed(random, len(W))
    return random.standard_normal(len(W) + 4)[4:] * (
        1.0 + 6.0 * (np.abs(BEND[:, 0]) > 0.1 * np.abs(BEND).max()) if kind == "loud" else 1.0
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["coloured", "white", "loud"])
def test_chance_is_found_significant_as_often_as_the_level_says(kind: str) -> None:
    random = np.random.default_rng(1)
    tests = [quick(left(noise(random, kind)), [BEND]) for _ in range(400)]
    allowed = 2.5 * np.sqrt(0.05 * 0.95 / 400)
    assert np.mean([test.values["p_value"] <= 0.05 for test in tests]) == pytest.approx(0.05, abs=allowed)
    assert np.mean([test.values["statistic"] == 0 for test in tests]) == pytest.approx(0.5, abs=0.08)  # on the boundary
    assert all(test.values["p_value"] == 1.0 for test in tests if test.values["statistic"] == 0)


def test_a_spring_is_found() -> None:
    error = noise(np.random.default_rng(3), "white") - 6.0 * BEND[:, 0]
    found = flexible_against_rigid(left(error), -W, [BEND], WHERE)
    assert found.code == "flexible"
    both = np.hstack([W, -BEND])
    taken = np.sum(left(error) ** 2) - np.sum((error - both @ solved(both, error)) ** 2)
    assert found.values["gained"] == pytest.approx(taken / np.sum(left(error) ** 2))
    expected = taken / ((np.sum(left(error) ** 2) - taken) / (len(W) - 5))
    assert found.values["statistic"] == pytest.approx(expected)


def test_a_negative_compliance_is_no_spring() -> None:
    error = noise(np.random.default_rng(4), "white") + 6.0 * BEND[:, 0]
    found = flexible_against_rigid(left(error), -W, [BEND])
    assert found.values["statistic"] == 0.0
    assert found.values["p_value"] == 1.0


def test_a_direction_is_projected_on_as_by_nnls() -> None:
    from scipy.optimize import nnls

    random = np.random.default_rng(5)
    for E in (BEND, SLOPE, 0.7 * BEND + SLOPE):
        beside = E - W @ solved(W, E)
        for _ in range(10):
            residual = left(random.standard_normal(len(W)) + beside @ random.normal(size=1))
            found = flexible_against_rigid(residual, -W, [E], draws=1)
            _, norm = nnls(-beside, residual)
            assert found.values["gained"] == pytest.approx(1 - norm**2 / (residual @ residual), abs=1e-9)


@pytest.mark.slow
def test_the_best_of_several_shares_counts_in_the_draws_too() -> None:
    random = np.random.default_rng(6)
    shares = [BEND, BEND + 0.5 * SLOPE, BEND - 0.5 * SLOPE, -SLOPE]
    tests = [quick(left(noise(random, "white")), shares) for _ in range(300)]
    assert np.mean([test.values["p_value"] <= 0.05 for test in tests]) <= 0.05 + 2.5 * np.sqrt(0.05 * 0.95 / 300)
    single = flexible_against_rigid(left(noise(random, "white") + 9.0 * SLOPE[:, 0]), -W, shares)
    assert single.code == "flexible"


@pytest.mark.slow
def test_what_repeats_with_the_motion_is_not_taken_for_a_spring() -> None:
    """Two functions of the place that have nothing to do with each other: over time one seems to explain the other."""
    random = np.random.default_rng(7)

    def of_the_place() -> np.ndarray:
        families = np.unique(WHERE.family)
        return np.sum([(WHERE.family == family) * field(random, POSITION, 0.004) for family in families], axis=0)

    of_time = of_place = 0
    for _ in range(100):
        direction, error = of_the_place()[:, np.newaxis], 0.3 * random.standard_normal(len(W)) + of_the_place()
        of_time += quick(left(error), [direction]).values["p_value"] <= 0.05
        of_place += quick(left(error), [direction], WHERE).values["p_value"] <= 0.05
    assert of_time >= 18
    assert of_place <= 11
