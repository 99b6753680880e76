"""Covariances of influences: the textbook's for white errors, right for coloured ones, wide for what repeats."""

import numpy as np
import pytest
from scipy.signal import lfilter

from jointid.uncertainty.covariance import Covariance, Influence, covariance_of, larger, white
from tests.estimation.motions import low_passed

ROWS, RUNS = 600, 200


def test_white_errors_give_the_textbook_s_deviations() -> None:
    """With Z = c J the estimate is that of least squares, and so is its covariance."""
    random = np.random.default_rng(0)
    W = random.normal(size=(20_000, 3)) * [1.0, 1e4, 1e-3]
    error = 0.3 * random.standard_normal(20_000)
    expected = 0.3 * np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    found = Influence(W, error).by_time()
    assert found.std == pytest.approx(expected, rel=0.05)
    assert white(W, error).std == pytest.approx(expected, rel=0.05)
    assert Influence(W, error, 3.0 * W).by_time().std == pytest.approx(found.std)


def test_correlated_errors_give_wider_ones_that_cover() -> None:
    random = np.random.default_rng(1)
    slow = np.sin(np.arange(2000) / 40.0)
    W = np.column_stack([np.ones(2000), slow])
    inside = naive = 0
    for _ in range(300):
        error = low_passed(random, 2000)
        x, *_ = np.linalg.lstsq(W, error, rcond=None)
        residual = error - W @ x
        robust = Influence(W, residual).by_time().std
        white = np.sqrt(np.diag(np.linalg.inv(W.T @ W)) * residual.var())
        inside += int(np.sum(np.abs(x) <= 2 * robust))
        naive += int(np.sum(np.abs(x) <= 2 * white))
    assert 0.92 <= inside / 600 <= 0.98
    assert naive / 600 <= 0.75


def test_rows_of_two_equations_share_their_instants() -> None:
    """One exact equation beside a noisy one: the noise must not be averaged over both."""
    random = np.random.default_rng(3)
    W1, W2 = random.normal(size=(2, 4000, 1))
    error = np.concatenate([random.standard_normal(4000), np.zeros(4000)])
    W = np.concatenate([W1, W2])
    found = Influence(W, error, equations=2).by_time().std
    expected = np.sqrt(np.sum(W1**2)) / np.sum(W**2)
    assert found == pytest.approx([expected], rel=0.06)


def test_a_block_left_out_is_what_a_fit_without_it_leaves() -> None:
    """Blocks of different lengths, scattered, whose numbers neither begin at 0 nor follow one another."""
    random = np.random.default_rng(5)
    J, told = random.standard_normal((120, 3)), random.standard_normal(120)
    block = random.choice([3, 4, 9, 17], size=120, p=[0.1, 0.2, 0.3, 0.4])
    error = told - J @ np.linalg.lstsq(J, told)[0]
    found = Influence(J, error).residual_left_out(block)
    for one in np.unique(block):
        out = block == one
        kept = np.linalg.lstsq(J[~out], told[~out])[0]
        np.testing.assert_allclose(found[out], told[out] - J[out] @ kept, atol=1e-12)


def test_the_larger_of_two_is_above_both_and_no_larger_than_needed() -> None:
    random = np.random.default_rng(7)
    A, B = (m @ m.T for m in random.normal(size=(2, 3, 3)) * [[1.0], [1e4], [1e-3]])
    both = larger(covariance_of(A), covariance_of(B))
    scale = np.outer(both.std, both.std)
    for one in (A, B):
        assert np.min(np.linalg.eigvalsh((both.matrix - one) / scale)) >= -1e-9
    same = larger(covariance_of(A), covariance_of(0.5 * A))
    assert same.matrix == pytest.approx(A, rel=1e-6)
    apart = larger(Covariance(np.array([3.0, 1.0]), np.eye(2)), Covariance(np.array([1.0, 2.0]), np.eye(2)))
    assert apart.std == pytest.approx([3.0, 2.0])


def ringing(random: np.random.Generator, size: int) -> np.ndarray:
    """Return noise that rings at a sixteenth of the sampling frequency for longer than the bandwidth."""
    noise = random.standard_normal(size + 300)
    return np.asarray(lfilter([1.0], [1.0, -2 * 0.97 * np.cos(np.pi / 8), 0.97**2], noise)[300:])


@pytest.mark.slow
def test_the_spectrum_sees_a_ringing_that_the_bandwidth_does_not() -> None:
    random = np.random.default_rng(6)
    W = np.column_stack([ringing(random, 2000), np.ones(2000)])
    inside = {"by_time": 0, "by_spectrum": 0, "robust": 0}
    for _ in range(200):
        error = ringing(random, 2000)
        x = np.linalg.lstsq(W, error, rcond=None)[0]
        residual = error - W @ x
        for name in inside:
            inside[name] += abs(x[0]) <= 2 * getattr(Influence(W, residual), name)().std[0]
    assert inside["by_time"] / 200 <= 0.8
    assert inside["by_spectrum"] / 200 >= 0.9
    assert inside["robust"] >= inside["by_spectrum"]


def test_a_loud_stretch_is_seen_by_the_sandwich_alone() -> None:
    """A parameter that is told where it is loud: stationarity is wrong, and the larger of both is still right."""
    random = np.random.default_rng(7)
    loud = np.arange(3000) % 300 < 30
    W = np.column_stack([random.standard_normal(3000) * loud, random.standard_normal(3000)])
    error = random.standard_normal(3000) * (1.0 + 9.0 * loud)
    expected = np.sqrt(np.sum(W[:, 0] ** 2 * 100.0)) / np.sum(W[:, 0] ** 2)
    assert Influence(W, error).by_spectrum().std[0] < 0.5 * expected
    assert Influence(W, error).robust().std[0] == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("rows", [3000, 3001])
def test_a_white_residual_s_spectrum_is_flat(rows: int) -> None:
    random = np.random.default_rng(8)
    W = random.normal(size=(rows, 3)) * [1.0, 1e4, 1e-3]
    W[:, 2] += 1e-3
    squares = [Influence(W, 0.3 * random.standard_normal(rows)).stationary().std ** 2 for _ in range(50)]
    expected = 0.09 * np.diag(np.linalg.inv(W.T @ W))
    assert np.mean(squares, axis=0) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("of", ["by_time", "by_spectrum", "robust"])
def test_records_that_share_nothing_have_the_deviations_they_have_alone(of: str) -> None:
    """Of unlike lengths and levels, one after the other: nothing is correlated across the border."""
    random = np.random.default_rng(9)
    W = [random.normal(size=(rows, 2)) + 1.0 for rows in (900, 2100)]
    errors = [low_passed(random, 900), 30.0 * low_passed(random, 2100)]
    errors[0][-20:] += 40.0
    errors[1][:20] += 400.0
    J = np.block([[W[0], np.zeros((900, 2))], [np.zeros((2100, 2)), W[1]]])
    error = np.concatenate(errors)
    alone = np.concatenate([getattr(Influence(w, e), of)().std for w, e in zip(W, errors, strict=True)])
    together = getattr(Influence(J, error, series=[900, 2100]), of)()
    assert together.std == pytest.approx(alone, rel=1e-9)
    assert np.abs(together.correlation[:2, 2:]) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(getattr(Influence(J, error), of)().correlation[:2, 2:])) > 1e-3


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
    none = Covariance(np.zeros(2), np.eye(2))
    assert Influence(W, error).widen_for_bands(none).std == pytest.approx(expected, rel=1e-9)


def test_bands_see_a_gain_that_falls_with_frequency() -> None:
    rng = np.random.default_rng(0)
    J = rng.standard_normal((4000, 1))
    spectrum = np.fft.rfft(J[:, 0])
    error = np.fft.irfft(spectrum * np.linspace(0.05, -0.05, spectrum.size), 4000)
    error -= J[:, 0] * (J[:, 0] @ error) / (J[:, 0] @ J[:, 0])
    influence = Influence(J, error)
    by_rows = influence.by_time()
    assert influence.widen_for_bands(by_rows).std[0] > 5 * by_rows.std[0]


def test_deviations_along_a_measured_motion_hold_the_bias_of_a_force_that_moves_it() -> None:
    """An inertia of 2 that a reference moves slowly, and a force, as d / 2, at all frequencies."""
    rng, before, after = np.random.default_rng(0), [], []
    slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(4000)) * (np.arange(2001) < 100), 4000)
    for _ in range(50):
        d = 0.03 * rng.standard_normal(4000)
        J = (slow + d / 2)[:, np.newaxis]
        x = float(J[:, 0] @ (2 * slow)) / float(J[:, 0] @ J[:, 0])
        error = 2 * slow - J[:, 0] * x
        plain = (influence := Influence(J, error)).by_time()
        wide = influence.widen_for_motion(plain)
        before.append(abs(x - 2) / plain.std[0])
        after.append(abs(x - 2) / wide.std[0])
    assert np.mean(np.array(before) < 2) < 0.3
    assert np.mean(np.array(after) < 2) > 0.9


def test_noise_on_the_log_widens_deviations_along_a_measured_motion_by_a_third() -> None:
    rng, factors = np.random.default_rng(0), []
    for _ in range(50):
        J, error = rng.standard_normal((2000, 2)), rng.standard_normal(2000)
        error -= J @ np.linalg.lstsq(J, error, rcond=None)[0]
        influence = Influence(J, error)
        plain = influence.by_time()
        factors.append(influence.widen_for_motion(plain).std / plain.std)
    assert np.mean(factors) == pytest.approx(1.35, abs=0.05)


def slow_columns(rows: int) -> np.ndarray:
    """Return an offset, and columns of the slowest frequencies: what friction and inertia are on a short record."""
    turn = 2 * np.pi * np.arange(rows) / rows
    return np.column_stack([np.ones(rows), np.sign(np.sin(2.3 * turn)), np.cos(2.3 * turn), np.sin(0.7 * turn)])


def test_an_offset_under_slow_noise_is_held() -> None:
    random, W = np.random.default_rng(11), slow_columns(ROWS)
    inverse, inside = np.linalg.pinv(W), {"by_spectrum": np.zeros(4), "stationary": np.zeros(4)}
    for _ in range(RUNS):
        error = lfilter([1.0], [1.0, -0.9], random.standard_normal(ROWS + 200))[200:]  # over a fiftieth of the record
        x = inverse @ error
        for of in inside:
            inside[of] += np.abs(x) <= 2 * getattr(Influence(W, error - W @ x), of)().std
    assert np.all(inside["by_spectrum"] / RUNS >= 0.88)
    assert inside["by_spectrum"].mean() / RUNS >= 0.92
    assert inside["stationary"].mean() / RUNS < 0.9


@pytest.mark.parametrize("instruments", [False, True])
def test_what_the_fit_took_of_a_band_is_given_back(instruments: bool) -> None:
    """Two deviations hold 95 % of the errors by white noise, of short records, too."""
    random, J = np.random.default_rng(12), slow_columns(120)
    Z = J + 0.3 * random.standard_normal(J.shape) if instruments else J
    A = np.linalg.solve(Z.T @ J, Z.T)
    inside = []
    for _ in range(RUNS):
        noise = random.standard_normal(120)
        inside.append(np.abs(A @ noise) <= 2 * Influence(J, noise - J @ (A @ noise), Z).by_spectrum().std)
    assert 0.92 <= np.mean(inside) <= 0.98


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
        found.append(Influence(W, left, equations=equations).robust().std)
        smeared.append(Influence(W, left, equations=equations).by_time().std)
    smooth = [0, 2, 3]  # what jumps sees fast noise, too
    ratio = (np.sqrt(np.mean(np.square(std), axis=0) / np.mean(np.square(errors), axis=0)) for std in (found, smeared))
    whitened, before = (each[smooth] for each in ratio)
    assert np.all((whitened > 0.85) & (whitened < 0.8 * before))


def test_prewhitened_equations_have_the_same_estimate() -> None:
    random, J = np.random.default_rng(16), slow_columns(ROWS)
    Z, error = J + 0.3 * random.standard_normal(J.shape), np.diff(random.standard_normal(ROWS + 1))
    found = Influence(J, error, Z, series=[ROWS // 3, ROWS - ROWS // 3]).prewhiten()
    other, white = found.instruments, found.error
    assert pytest.approx(Z.T @ J, rel=1e-9, abs=1e-9) == other.T @ found.J
    assert other.T @ white == pytest.approx(Z.T @ error, rel=1e-9, abs=1e-9)
    assert abs(white[1:] @ white[:-1]) < 0.1 * (white @ white) < -0.1 / 0.4 * (error[1:] @ error[:-1])
