"""Covariances: the textbook's for white errors, honest for correlated ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from jointid.uncertainty.covariance import (
    Covariance,
    band_deviations,
    by_spectrum,
    covariance_of,
    larger,
    residual_left_out,
    robust,
    sandwich,
    stationary,
    white,
)


def low_passed(random: np.random.Generator, size: int) -> np.ndarray:
    return np.convolve(random.standard_normal(size + 4), np.ones(5) / np.sqrt(5.0), "valid")


def test_white_errors_give_the_textbook_s_deviations() -> None:
    random = np.random.default_rng(0)
    W = random.normal(size=(20_000, 3)) * [1.0, 1e4, 1e-3]
    error = 0.3 * random.standard_normal(20_000)
    found = sandwich(W, W, error)
    expected = 0.3 * np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    assert found.std == pytest.approx(expected, rel=0.05)


def test_correlated_errors_give_wider_ones_that_cover() -> None:
    random = np.random.default_rng(1)
    slow = np.sin(np.arange(2000) / 40.0)
    W = np.column_stack([np.ones(2000), slow])
    inside = naive = 0
    for _ in range(300):
        error = low_passed(random, 2000)
        x, *_ = np.linalg.lstsq(W, error, rcond=None)
        residual = error - W @ x
        robust = sandwich(W, W, residual).std
        white = np.sqrt(np.diag(np.linalg.inv(W.T @ W)) * residual.var())
        inside += int(np.sum(np.abs(x) <= 2 * robust))
        naive += int(np.sum(np.abs(x) <= 2 * white))
    assert 0.92 <= inside / 600 <= 0.98
    assert naive / 600 <= 0.75


def test_instruments_are_not_the_sensitivities() -> None:
    """With Z = c J the estimate is that of least squares, and so is its covariance."""
    random = np.random.default_rng(2)
    J = random.normal(size=(5000, 2))
    error = random.standard_normal(5000)
    same, scaled = sandwich(J, J, error), sandwich(3.0 * J, J, error)
    assert scaled.std == pytest.approx(same.std)
    weak = sandwich(J + 3.0 * random.normal(size=J.shape), J, error)
    assert np.all(weak.std > 2.0 * same.std)


def test_rows_of_two_equations_share_their_instants() -> None:
    """One exact equation beside a noisy one: the noise must not be averaged over both."""
    random = np.random.default_rng(3)
    W1, W2 = random.normal(size=(2, 4000, 1))
    error = np.concatenate([random.standard_normal(4000), np.zeros(4000)])
    W = np.concatenate([W1, W2])
    found = sandwich(W, W, error, equations=2).std
    expected = np.sqrt(np.sum(W1**2)) / np.sum(W**2)
    assert found == pytest.approx([expected], rel=0.06)


def test_a_block_left_out_is_what_a_fit_without_it_leaves() -> None:
    """Blocks of different lengths, scattered, whose numbers neither begin at 0 nor follow one another."""
    random = np.random.default_rng(5)
    J, told = random.standard_normal((120, 3)), random.standard_normal(120)
    block = random.choice([3, 4, 9, 17], size=120, p=[0.1, 0.2, 0.3, 0.4])
    error = told - J @ np.linalg.lstsq(J, told)[0]
    found = residual_left_out(J, J, error, np.linalg.inv(J.T @ J), block)
    for one in np.unique(block):
        out = block == one
        kept = np.linalg.lstsq(J[~out], told[~out])[0]
        np.testing.assert_allclose(found[out], told[out] - J[out] @ kept, atol=1e-12)


def test_the_white_covariance_is_the_textbook_s_even_where_columns_are_nearly_parallel() -> None:
    random = np.random.default_rng(4)
    W = random.normal(size=(3000, 2))
    W[:, 1] = W[:, 0] + 1e-4 * W[:, 1]
    W *= [1.0, 1e5]
    error = 0.5 * random.standard_normal(3000)
    found = white(W, error)
    s2 = error @ error / 2998
    assert found.matrix == pytest.approx(s2 * np.linalg.inv(W.T @ W), rel=1e-5)
    assert found.correlation[0, 1] < -0.999
    assert found.bandwidth == 0


def test_the_deviation_of_a_sum_takes_the_correlation_in() -> None:
    found = covariance_of(np.array([[4.0, -5.7], [-5.7, 9.0]]), 3)
    assert found.std_of(np.array([1.0, 1.0])) == pytest.approx(np.sqrt(4.0 + 9.0 - 11.4))
    assert found.std_of(np.array([0.0, 2.0])) == pytest.approx(6.0)


def test_the_larger_of_two_is_above_both_and_no_larger_than_needed() -> None:
    random = np.random.default_rng(7)
    A, B = (m @ m.T for m in random.normal(size=(2, 3, 3)) * [[1.0], [1e4], [1e-3]])
    both = larger(covariance_of(A, 4), covariance_of(B, 0))
    scale = np.outer(both.std, both.std)
    for one in (A, B):
        assert np.min(np.linalg.eigvalsh((both.matrix - one) / scale)) >= -1e-9
    assert both.bandwidth == 4
    same = larger(covariance_of(A, 0), covariance_of(0.5 * A, 0))
    assert same.matrix == pytest.approx(A, rel=1e-6)
    apart = larger(Covariance(np.array([3.0, 1.0]), np.eye(2), 0), Covariance(np.array([1.0, 2.0]), np.eye(2), 0))
    assert apart.std == pytest.approx([3.0, 2.0])


def ringing(random: np.random.Generator, size: int) -> np.ndarray:
    """Return noise that rings at a sixteenth of the sampling frequency for longer than the bandwidth."""
    noise = random.standard_normal(size + 300)
    return np.asarray(lfilter([1.0], [1.0, -2 * 0.97 * np.cos(np.pi / 8), 0.97**2], noise)[300:])


def test_the_spectrum_sees_a_ringing_that_the_bandwidth_does_not() -> None:
    random = np.random.default_rng(6)
    W = np.column_stack([ringing(random, 2000), np.ones(2000)])
    inside = {"sandwich": 0, "by_spectrum": 0, "robust": 0}
    for _ in range(200):
        error = ringing(random, 2000)
        x = np.linalg.lstsq(W, error, rcond=None)[0]
        residual = error - W @ x
        for name, covariance in (("sandwich", sandwich), ("by_spectrum", by_spectrum), ("robust", robust)):
            inside[name] += abs(x[0]) <= 2 * covariance(W, W, residual).std[0]
    assert inside["sandwich"] / 200 <= 0.8
    assert inside["by_spectrum"] / 200 >= 0.9
    assert inside["robust"] >= inside["by_spectrum"]


def test_a_loud_stretch_is_seen_by_the_sandwich_alone() -> None:
    """A parameter that is told where it is loud: stationarity is wrong, and the larger of both is still right."""
    random = np.random.default_rng(7)
    loud = np.arange(3000) % 300 < 30
    W = np.column_stack([random.standard_normal(3000) * loud, random.standard_normal(3000)])
    error = random.standard_normal(3000) * (1.0 + 9.0 * loud)
    expected = np.sqrt(np.sum(W[:, 0] ** 2 * 100.0)) / np.sum(W[:, 0] ** 2)
    assert by_spectrum(W, W, error).std[0] < 0.5 * expected
    assert robust(W, W, error).std[0] == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("rows", [3000, 3001])
def test_a_white_residual_s_spectrum_is_flat(rows: int) -> None:
    random = np.random.default_rng(8)
    W = random.normal(size=(rows, 3)) * [1.0, 1e4, 1e-3]
    W[:, 2] += 1e-3
    squares = [stationary(W, W, 0.3 * random.standard_normal(rows)).std ** 2 for _ in range(50)]
    expected = 0.09 * np.diag(np.linalg.inv(W.T @ W))
    assert np.mean(squares, axis=0) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("of", [sandwich, by_spectrum, robust])
def test_records_that_share_nothing_have_the_deviations_they_have_alone(of: Any) -> None:
    """Of unlike lengths and levels, one after the other: nothing is correlated across the border."""
    random = np.random.default_rng(9)
    W = [random.normal(size=(rows, 2)) + 1.0 for rows in (900, 2100)]
    errors = [low_passed(random, 900), 30.0 * low_passed(random, 2100)]
    errors[0][-20:] += 40.0
    errors[1][:20] += 400.0
    J = np.block([[W[0], np.zeros((900, 2))], [np.zeros((2100, 2)), W[1]]])
    error = np.concatenate(errors)
    alone = np.concatenate([of(w, w, e).std for w, e in zip(W, errors, strict=True)])
    together = of(J, J, error, series=[900, 2100])
    assert together.std == pytest.approx(alone, rel=1e-9)
    assert np.abs(together.correlation[:2, 2:]) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(of(J, J, error).correlation[:2, 2:])) > 1e-3


def test_two_records_of_one_parameter_halve_its_variance() -> None:
    random = np.random.default_rng(10)
    W = random.normal(size=(4000, 2))
    error = low_passed(random, 4000)
    first = robust(W[:2000], W[:2000], error[:2000])
    both = robust(W, W, error, series=[2000, 2000])
    assert both.std == pytest.approx(first.std / np.sqrt(2.0), rel=0.1)


def test_a_line_of_the_spectrum_that_fills_several_bands_counts_once() -> None:
    """All bands but that of the line hold so little of the residual that they have no frequency of their own."""
    random, size = np.random.default_rng(11), 4096
    line = np.sin(2 * np.pi * 200 * np.arange(size) / size)
    W = random.standard_normal((size, 2))
    error = 50.0 * line + random.standard_normal(size)
    error -= W @ np.linalg.lstsq(W, error, rcond=None)[0]
    spectra = [np.fft.rfft(one, axis=0) for one in (W, error)]
    scores = np.real(np.conj(spectra[0]) * spectra[1][:, np.newaxis]) * 2 / size
    influences = scores @ np.linalg.inv(W.T @ W)
    at = int(np.argmax(np.abs(spectra[1])))  # the line's band ends before it, the last one begins with it
    expected = np.sqrt(8 / 7 * (influences[:at].sum(axis=0) ** 2 + influences[at:].sum(axis=0) ** 2))
    assert band_deviations(W, W, error) == pytest.approx(expected, rel=1e-9)
