"""Deviations by the spectrum in bands: noise that is loudest where a fit takes most of it away."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from jointid.common.arrays import FloatArray
from jointid.uncertainty.covariance import by_spectrum, prewhiten, robust, sandwich, stationary
from jointid.uncertainty.spectral import spectral_covariance

ROWS, RUNS = 600, 200


def slow_columns(rows: int) -> FloatArray:
    """Return an offset, and columns of the slowest frequencies: what friction and inertia are on a short record."""
    turn = 2 * np.pi * np.arange(rows) / rows
    return np.column_stack([np.ones(rows), np.sign(np.sin(2.3 * turn)), np.cos(2.3 * turn), np.sin(0.7 * turn)])


def slow_noise(random: np.random.Generator, rows: int) -> FloatArray:
    """Return noise that is correlated over a fiftieth of the record."""
    return np.asarray(lfilter([1.0], [1.0, -0.9], random.standard_normal(rows + 200))[200:])


def test_an_offset_under_slow_noise_is_held() -> None:
    random, W = np.random.default_rng(11), slow_columns(ROWS)
    inverse, inside = np.linalg.pinv(W), {by_spectrum: np.zeros(4), stationary: np.zeros(4)}
    for _ in range(RUNS):
        error = slow_noise(random, ROWS)
        x = inverse @ error
        for of in inside:
            inside[of] += np.abs(x) <= 2 * of(W, W, error - W @ x).std
    assert np.all(inside[by_spectrum] / RUNS >= 0.88)
    assert inside[by_spectrum].mean() / RUNS >= 0.92
    assert inside[stationary].mean() / RUNS < 0.9


@pytest.mark.parametrize("instruments", [False, True])
def test_what_the_fit_took_of_a_band_is_given_back(instruments: bool) -> None:
    """The covariance is right on the average over many residuals of white noise, of short records, too."""
    random, J = np.random.default_rng(12), slow_columns(120)
    Z = J + 0.3 * random.standard_normal(J.shape) if instruments else J
    A = np.linalg.solve(Z.T @ J, Z.T)
    found = []
    for _ in range(RUNS):
        noise = random.standard_normal(120)
        found.append(spectral_covariance(A.T, J, noise - J @ (A @ noise), [slice(0, 120)])[0])
    assert np.diag(np.mean(found, axis=0)) == pytest.approx(np.diag(A @ A.T), rel=0.1)


@pytest.mark.parametrize("instruments", [False, True])
def test_influences_may_be_given_as_instruments_and_a_spread(instruments: bool) -> None:
    """Two records, one of an odd number of samples, and other quantities asked for."""
    random, J = np.random.default_rng(14), slow_columns(301)
    Z = J + 0.3 * random.standard_normal(J.shape) if instruments else J
    spread, error, parts = np.linalg.inv(Z.T @ J), random.standard_normal(301), [slice(0, 150), slice(150, 301)]
    asked = Z @ random.standard_normal((4, 2))
    for wanted in (None, asked):
        plain = spectral_covariance(Z @ spread.T, J, error, parts, wanted)
        for one, other in zip(spectral_covariance(Z, J, error, parts, wanted, spread), plain, strict=True):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-15)


def test_few_frequencies_are_known_as_students_quantile_says() -> None:
    """An offset is told by one band of four frequencies, less what is lost to it; a fast column by many."""
    random = np.random.default_rng(13)
    J = np.column_stack([np.ones(4000), random.standard_normal(4000)])
    A = np.linalg.pinv(J)
    noise = random.standard_normal(4000)
    _, (slow, fast) = spectral_covariance(A.T, J, noise - J @ (A @ noise), [slice(0, 4000)])
    assert slow == pytest.approx(1.26, abs=0.03)  # Student's of six degrees of freedom, over two
    assert 1.0 < fast < 1.01


def test_nothing_left_has_no_deviation() -> None:
    J = slow_columns(200)
    covariance, factor = spectral_covariance(np.linalg.pinv(J).T, J, np.zeros(200), [slice(0, 200)])
    assert not np.any(covariance)
    assert np.all(factor == 1.0)


@pytest.mark.parametrize("equations", [1, 2])
def test_noise_of_a_difference_is_not_counted_at_low_frequencies(equations: int) -> None:
    """Position noise that a controller differentiates: a short kernel takes its fast part for a slow one."""
    random, rows = np.random.default_rng(14), ROWS // equations
    W = np.vstack([(1.0 + k) * slow_columns(rows) for k in range(equations)])
    inverse, runs, errors, found, smeared = np.linalg.pinv(W), 60, [], [], []
    for _ in range(runs):
        error = np.concatenate([np.diff(random.standard_normal(rows + 1)) for _ in range(equations)])
        x = inverse @ error
        left = error - W @ x
        errors.append(x)
        found.append(robust(W, W, left, equations=equations).std)
        smeared.append(sandwich(W, W, left, equations).std)
    smooth = [0, 2, 3]  # what jumps sees fast noise, too
    ratio = (
        np.sqrt(np.mean(np.square(each), axis=0) / np.mean(np.square(errors), axis=0)) for each in (found, smeared)
    )
    whitened, before = (each[smooth] for each in ratio)
    assert np.all((whitened > 0.85) & (whitened < 0.8 * before))


def test_a_residual_that_does_not_grow_with_the_frequency_stays_as_it_is() -> None:
    random, W = np.random.default_rng(15), slow_columns(ROWS)
    error = random.standard_normal(ROWS)
    assert all(after is before for after, before in zip(prewhiten(W, W, error), (W, W, error), strict=True))


def test_prewhitened_equations_have_the_same_estimate() -> None:
    random, J = np.random.default_rng(16), slow_columns(ROWS)
    Z, error = J + 0.3 * random.standard_normal(J.shape), np.diff(random.standard_normal(ROWS + 1))
    other, slopes, white = prewhiten(Z, J, error, [ROWS // 3, ROWS - ROWS // 3])
    assert other.T @ slopes == pytest.approx(Z.T @ J, rel=1e-9, abs=1e-9)
    assert other.T @ white == pytest.approx(Z.T @ error, rel=1e-9, abs=1e-9)
    assert abs(white[1:] @ white[:-1]) < 0.1 * (white @ white) < -0.1 / 0.4 * (error[1:] @ error[:-1])
