"""Least squares from sums over groups: the same step, and what leaving out a group really does."""

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Bounds
from jointid.estimation.pieces import places_of
from jointid.solvers.solve import damped_step
from jointid.uncertainty.covariance import Sums, left_out, rows_of, total

ANYWHERE = Bounds(np.full(3, -np.inf), np.full(3, np.inf))


def drawn(seed: int, groups: int = 12, rows: int = 30) -> list[tuple[FloatArray, FloatArray]]:
    """Return residuals and derivatives of groups, badly scaled, with a common error in each group."""
    random = np.random.default_rng(seed)
    scales = np.array([1.0, 1e4, 1e-3])
    return [
        (random.standard_normal(rows) + random.standard_normal(), random.standard_normal((rows, 3)) * scales)
        for _ in range(groups)
    ]


def summed(parts: list[tuple[FloatArray, FloatArray]]) -> list[Sums]:
    return [Sums.of(error, J, error) for error, J in parts]


def test_a_step_is_that_of_least_squares() -> None:
    parts = drawn(1)
    error, J = np.concatenate([e for e, _ in parts]), np.vstack([J for _, J in parts])
    expected = -np.linalg.lstsq(J, error, rcond=None)[0]
    np.testing.assert_allclose(damped_step(*rows_of(total(summed(parts))), ANYWHERE), expected, rtol=1e-9)
    least = np.array([-np.inf, -np.inf, expected[2] + abs(expected[2])])
    bounded = damped_step(*rows_of(total(summed(parts))), Bounds(least, ANYWHERE.upper))
    others = -np.linalg.lstsq(J[:, :2], error + J[:, 2] * least[2], rcond=None)[0]
    np.testing.assert_allclose(bounded, [*others, least[2]], rtol=1e-9)


def test_sums_move_with_the_parameters() -> None:
    (error, J), step = drawn(2)[0], np.array([0.3, 2e-5, -40.0])
    moved, anew = Sums.of(error, J, error).shift(step), Sums.of(error + J @ step, J, error)
    np.testing.assert_allclose(moved.b, anew.b)
    assert moved.square == pytest.approx(anew.square)


def test_leaving_out_groups_is_the_jackknife() -> None:
    parts = drawn(3)
    sums = summed(parts)
    step = damped_step(*rows_of(total(sums)), ANYWHERE)
    covariance = left_out([s.shift(step) for s in sums])
    found = []
    for k in range(len(parts)):
        rest = [part for i, part in enumerate(parts) if i != k]
        error, J = np.concatenate([e for e, _ in rest]), np.vstack([J for _, J in rest])
        found.append(-np.linalg.lstsq(J, error, rcond=None)[0])
    apart = np.array(found) - np.mean(found, axis=0)
    np.testing.assert_allclose(covariance.matrix, 11 / 12 * apart.T @ apart, rtol=1e-6)


def test_what_one_group_tells_alone_is_no_better_known_than_by_its_own_noise() -> None:
    """Leaving it out leaves nothing that could differ: nothing is known from that, and not everything."""
    random, parts = np.random.default_rng(4), drawn(4)
    rows = [(random.standard_normal(30), J * [1.0, 1.0, float(i == 5)]) for i, (_, J) in enumerate(parts)]
    sums = summed(rows)
    step = damped_step(*rows_of(total(sums)), ANYWHERE)
    covariance = left_out([s.shift(step) for s in sums])
    assert covariance.std[2] == pytest.approx(1.0 / np.linalg.norm(rows[5][1][:, 2]), rel=0.2)


def test_two_groups_do_not_tell_three_parameters_exactly() -> None:
    parts = [(np.random.default_rng(i).standard_normal(30), J) for i, (_, J) in enumerate(drawn(6, groups=2))]
    sums, J = summed(parts), np.vstack([J for _, J in parts])
    step = damped_step(*rows_of(total(sums)), ANYWHERE)
    covariance = left_out([s.shift(step) for s in sums])
    white = np.linalg.inv(J.T @ J)
    for seed in range(20):
        weights = np.random.default_rng(seed).standard_normal(3) / covariance.std
        assert covariance.std_of(weights) > 0.7 * np.sqrt(weights @ white @ weights)


def test_intervals_hold_where_a_group_errs_together() -> None:
    held = []
    for seed in range(200):
        sums = summed(drawn(seed, groups=20))
        step = damped_step(*rows_of(total(sums)), ANYWHERE)
        held.append(np.abs(step) <= 2.09 * left_out([s.shift(step) for s in sums]).std)  # Student's, 19 degrees
    assert 0.90 <= np.mean(held) <= 0.99


def test_places_do_not_grow_with_the_way() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    label = places_of(np.sin(time), np.cos(time))
    far = label(50.0 * time, np.full(time.size, 50.0))
    assert np.unique(far).size <= 64
    there, back = label(np.zeros(2), np.array([1.0, -1.0]))
    assert there != back
