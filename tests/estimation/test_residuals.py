"""The residual's report: sizes and bands as by hand, and white noise through the filter called white."""

import numpy as np
import pytest

from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.model_tests import whiteness

FILTERING = Filtering(cutoff=60.0).resolve(1e-3)
STEP = 6e-3
SAMPLES = 24_000


def seen(signal: np.ndarray) -> np.ndarray:
    return FILTERING.decimate(signal, 1e-3)


@pytest.mark.parametrize(("loud", "scale"), [(False, 1.0), (True, 1e-129)])
def test_white_noise_through_the_filter_is_white(loud: bool, scale: float) -> None:
    """5 % of the time it is not, also where a tenth of the record is five times as loud."""
    random = np.random.default_rng(0)
    size = scale * (1.0 + 4.0 * (np.arange(SAMPLES) % 1000 < 100) * loud)
    tests = [whiteness(seen(size * random.standard_normal(SAMPLES)), STEP, 60.0) for _ in range(300)]
    found = [test.p_value for test in tests]
    assert np.mean(np.array(found) <= 0.05) == pytest.approx(0.05, abs=2.5 * np.sqrt(0.05 * 0.95 / 300))
    assert np.mean(found) == pytest.approx(0.5, abs=0.06)


def test_coloured_noise_and_a_tone_are_not_white() -> None:
    random = np.random.default_rng(2)
    white = random.standard_normal(SAMPLES)
    slow = np.convolve(white, np.ones(20) / np.sqrt(20.0), "same")
    tone = white + 0.3 * np.sin(2 * np.pi * 27.0 * 1e-3 * np.arange(SAMPLES))
    assert not any(whiteness(seen(noise), STEP, 60.0).white for noise in (slow, tone))


def test_a_residual_too_short_to_judge_is_not_judged() -> None:
    assert whiteness(np.random.default_rng(3).standard_normal(60), STEP, 60.0) is None
    assert whiteness(np.zeros(4000), STEP, 60.0) is None
