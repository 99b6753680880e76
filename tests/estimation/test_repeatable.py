"""What repeats with the motion: measured, tested, and covered; noise is not called repeatable."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import Uncertainty, by_place, cells, repeatable, uncertainty
from tests.estimation.motions import columns, field, low_passed, motion

POSITION, VELOCITY, ACCELERATION = motion()
W = columns(VELOCITY, ACCELERATION)
WHERE = cells(POSITION, VELOCITY)


def fitted(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = np.linalg.lstsq(W, error, rcond=None)[0]
    return x, error - W @ x


def test_the_cells_part_directions_and_the_three_speeds() -> None:
    assert WHERE.speeds == pytest.approx([0.042, 0.083, 0.125], rel=0.1)
    for label in np.unique(WHERE.label):
        rows = WHERE.label == label
        assert np.ptp(POSITION[rows]) <= 0.2 / 24 + 1e-9
        directions = set(np.sign(VELOCITY[rows]))
        assert len(directions) == 1 or np.max(np.abs(VELOCITY[rows])) <= 0.02 * 0.125
    cruising = np.abs(np.abs(VELOCITY)[:, np.newaxis] - [0.042, 0.083, 0.125]) < 1e-4
    kinds = [set(WHERE.family[cruising[:, i] & (VELOCITY > 0)]) for i in range(3)]
    assert [len(kind) for kind in kinds] == [1, 1, 1]
    assert len(set.union(*kinds)) == 3


def test_the_repeatable_part_is_measured() -> None:
    """A known function of the place beside noise: its size, its share and its return come out."""
    random = np.random.default_rng(1)
    known = np.sin(2 * np.pi * POSITION / 0.1) * np.where(VELOCITY > 0, 2.0, 1.0)
    noise = 1.5 * random.standard_normal(known.size)
    found = repeatable(known + noise, WHERE)
    assert found.rms == pytest.approx(float(np.sqrt(np.mean(known**2))), rel=0.05)
    assert found.share == pytest.approx(found.rms**2 / np.mean((known + noise) ** 2))
    assert found.p_value == 0.001
    alone = repeatable(noise, WHERE)
    assert alone.rms < 0.15
    assert not alone.significant


@pytest.mark.parametrize("kind", ["white", "coloured", "louder when accelerating"])
def test_noise_is_not_called_repeatable(kind: str) -> None:
    random = np.random.default_rng(2)
    loud = 1.0 + 4.0 * (np.abs(ACCELERATION) > 0.1)
    found = []
    for _ in range(400):
        noise = low_passed(random, len(W)) if kind == "coloured" else random.standard_normal(len(W))
        found.append(repeatable(fitted(noise * loud if kind.startswith("louder") else noise)[1], WHERE).significant)
    assert np.mean(found) <= 0.05 + 2 * np.sqrt(0.05 * 0.95 / 400)


def test_half_the_noise_s_size_is_found() -> None:
    """The test has power: a function of the place half as large as the noise is always seen."""
    random = np.random.default_rng(3)
    for _ in range(20):
        error = random.standard_normal(len(W)) + 0.5 * field(random, POSITION, 0.01)
        assert repeatable(fitted(error)[1], WHERE).significant


def test_a_short_record_is_not_judged() -> None:
    once = slice(0, 150)
    where = cells(POSITION[once], VELOCITY[once])
    verdict = repeatable(np.random.default_rng(4).standard_normal(150), where)
    assert verdict.p_value is None
    assert not verdict.significant


def of_many(draw: str, runs: int, seed: int) -> tuple[np.ndarray, np.ndarray, list[Uncertainty]]:
    """Return how often robust and widened 2-sigma intervals held the truth, and what was found."""
    random = np.random.default_rng(seed)
    robust, widened, found = np.zeros(4), np.zeros(4), []
    for _ in range(runs):
        error = low_passed(random, len(W)) if draw == "coloured" else random.standard_normal(len(W))
        if draw == "place":
            for family in np.unique(WHERE.family):
                error += (WHERE.family == family) * field(random, POSITION, 0.004)
        x, residual = fitted(error)
        found.append(uncertainty(Influence(W, residual), WHERE))
        robust += np.abs(x) <= 2 * Influence(W, residual).robust().std
        widened += np.abs(x) <= 2 * found[-1].covariance.std
    return robust / runs, widened / runs, found


@pytest.mark.slow
def test_the_widening_does_not_spoil_the_coverage_of_noise() -> None:
    robust, widened, found = of_many("coloured", 240, 5)
    assert np.all((widened >= 0.92) & (widened <= 0.985))
    assert np.all(np.abs(widened - robust) <= 0.02)
    assert np.mean([one.repeatable.significant for one in found]) <= 0.08


@pytest.mark.slow
def test_the_widening_covers_what_repeats() -> None:
    robust, widened, found = of_many("place", 120, 6)
    assert np.all(widened >= 0.90)
    assert np.all(robust <= 0.88)
    assert all(one.repeatable.significant for one in found)


def test_by_place_is_the_textbook_s_for_noise() -> None:
    random = np.random.default_rng(8)
    squares = []
    for _ in range(100):
        squares.append(by_place(Influence(W, fitted(random.standard_normal(len(W)))[1]), WHERE).std ** 2)
    expected = np.diag(np.linalg.inv(W.T @ W))
    assert np.mean(squares, axis=0) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("seed", range(4))
def test_signs_that_change_nothing_count_whatever_rounding_says(seed: int) -> None:
    """One place that three blocks of time visit: a quarter of all draws leave its products as they are."""
    rows = np.arange(400)
    where = replace(WHERE, label=np.where(np.isin(rows // 18, (0, 5, 11)), 0, rows + 1))
    p_value = repeatable(1.0 + np.random.default_rng(seed).standard_normal(rows.size), where).p_value
    assert p_value is not None and p_value > 0.2
