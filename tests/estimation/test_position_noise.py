"""The default cut-off follows the noise of the positions, and not the sampling frequency."""

import numpy as np
import pytest

import jointid as ji
from jointid.records.record import Channel, Record, Tap
from jointid.records.signals.filtering import find_noise_limit

TRUE = {"inertia": 0.8, "viscous": 5.0, "coulomb": 4.0}
FREQUENCIES, AMPLITUDES = np.array([0.31, 0.83, 1.9, 3.1]), np.array([0.9, 0.4, 0.15, 0.04])


def moved(rate: float, step: float, noise: float, duration: float = 10.0) -> tuple[Record, np.ndarray]:
    """Return a record of a joint along a sum of sines from textbook equations, and its true position."""
    rng, t = np.random.default_rng(3), np.arange(round(rate * duration)) / rate
    phase = 2 * np.pi * np.outer(t, FREQUENCIES) + np.array([0.3, 1.1, 2.5, 4.0])
    w = 2 * np.pi * FREQUENCIES
    q, v, a = np.sin(phase) @ AMPLITUDES, np.cos(phase) @ (AMPLITUDES * w), -np.sin(phase) @ (AMPLITUDES * w**2)
    torque = TRUE["inertia"] * a + TRUE["viscous"] * v + TRUE["coulomb"] * np.sign(v)
    torque = torque + noise * rng.standard_normal(t.size)
    seen = np.round(q / step) * step if step else q
    return Record(
        torque=Channel(torque, "N m", 1 / rate, "sampled"), motor_position=Channel(seen, "rad", 1 / rate),
        tap=Tap.MEASURED,
    ), q  # fmt: skip


@pytest.mark.parametrize(("rate", "step", "noise"), [(5000.0, 1e-4, 0.3), (1000.0, 2e-5, 1.0), (10000.0, 1e-4, 0.3)])
@pytest.mark.parametrize(
    "method",
    [ji.IDIM(), pytest.param(ji.DriveSideFit(log_delay=0.0), marks=pytest.mark.slow)],
    ids=["idim", "drive_side"],
)
def test_default_is_as_good_as_the_best_by_hand(rate, step, noise, method):
    record, _ = moved(rate, step, noise)
    joint = ji.RigidJoint("revolute")
    found = ji.identify(record, joint, method)
    for name, true in TRUE.items():
        assert found[name].value == pytest.approx(true, rel=0.02), name
    by_hand = [ji.identify(record, joint, method, filtering=ji.Filtering(cutoff=hertz)) for hertz in (8.0, 15.0, 30.0)]
    for name, true in TRUE.items():
        best = min(abs(one[name].value - true) for one in by_hand)
        assert abs(found[name].value - true) <= best + 0.02 * true, name


def test_stated_cutoff_is_obeyed_and_too_wide_one_said():
    record, _ = moved(5000.0, 1e-4, 0.3)
    found = ji.identify(record, ji.RigidJoint("revolute"), ji.IDIM(), filtering=ji.Filtering(cutoff=200.0))
    assert found.settings.filtering.cutoff == 200.0
    assert any("lower filtering.cutoff" in one for one in found.warnings)


def test_limit_does_not_follow_the_rate_and_good_positions_have_none():
    limits = []
    for rate in (2000.0, 5000.0, 10000.0):
        record, exact = moved(rate, 1e-4, 0.0)
        limits.append(find_noise_limit([record.motor_position.values], 1 / rate))
        assert find_noise_limit([exact], 1 / rate) > 0.04 * rate
    assert max(limits) < 2 * min(limits)
    assert 8.0 < min(limits) < 80.0
    still = np.zeros(5000)
    assert find_noise_limit([still], 1e-3) == np.inf
    assert find_noise_limit([record.motor_position.values, np.zeros_like(exact)], 1e-4) == limits[-1]
