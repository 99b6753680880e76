"""Signals: filters without phase, decimation that keeps both sides alike, torque at the right instants."""

import numpy as np
import pytest
from scipy.signal import cheby1, sosfiltfilt

from jointid.records.record import Channel, Timing
from jointid.records.signals.filtering import Filtering, differentiate_twice, lowpass, settle, window_torque
from jointid.simulation.excitation import pulses, trapezoids

T = 1e-3


def test_a_lowpass_has_no_phase_and_squares_the_attenuation() -> None:
    time = np.arange(4000) * T
    slow, edge = np.sin(2 * np.pi * 3.0 * time), np.sin(2 * np.pi * 50.0 * time)
    assert np.max(np.abs(lowpass(slow, 50.0, T) - slow)[200:-200]) < 1e-4
    at_edge = lowpass(edge, 50.0, T)[500:-500]
    assert np.max(np.abs(at_edge - 0.5 * edge[500:-500])) < 2e-3  # 3 dB twice


@pytest.mark.parametrize(("samples", "columns"), [(25, 1), (64, 7), (5131, 17)])
@pytest.mark.parametrize("cutoff", [5.0, 60.0, 200.0])
def test_decimation_is_by_scipy_s_filter_and_keeps_the_last_sample(samples: int, columns: int, cutoff: float) -> None:
    """On a random walk, whose ends are far apart, with columns of very different sizes."""
    filtering = Filtering(cutoff=cutoff).resolve(T)
    rng = np.random.default_rng(3)
    values = np.cumsum(rng.standard_normal((samples, columns)), axis=0) * 10.0 ** rng.uniform(-9, 9, columns)
    sections = cheby1(8, 0.05, 2 * filtering.cutoff * T, output="sos")
    expected = sosfiltfilt(sections, values, axis=0, padlen=24)[:: -(filtering.decimation or 1)][::-1]
    turned, alone = (filtering.decimate(each, T) for each in (np.asfortranarray(values), values[:, -1]))
    size = np.max(np.abs(expected), axis=0)
    for found in (filtering.decimate(values, T), turned):
        assert found.shape == expected.shape
        assert np.max(np.abs(found - expected) / size) < 1e-11
    assert np.max(np.abs(alone - expected[:, -1])) < 1e-11 * size[-1]


def test_the_default_decimation_leaves_the_cutoff_inside() -> None:
    assert Filtering(cutoff=60.0).resolve(T).decimation == 6  # not the paper's 12
    assert Filtering().resolve(T) == Filtering(100.0, 40.0, 10, (50, 50))
    assert Filtering().resolve(T / 8).cutoff == 320.0


@pytest.mark.parametrize("timing", list(Timing))
def test_a_delayed_torque_acts_later(timing: Timing) -> None:
    """On a smooth torque every timing, with a fractional delay, gives the torque that acted at the instant."""
    period, delay = 1e-4, 3.7e-4
    time = np.arange(2000) * period

    def torque(t: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(2 * np.pi * 5.0 * t))

    stamped = {
        Timing.SAMPLED: torque(time),
        Timing.HELD: torque(time + period / 2),  # the middle of what it is held for
        Timing.AVERAGED: torque(time - period / 2),
    }[timing]
    found = window_torque(Channel(stamped, "N", period, timing), delay)
    assert np.max(np.abs(found - torque(time - delay))[20:-20]) < 1e-5


def test_a_filtered_axis_at_rest_has_no_direction() -> None:
    """What the filter leaves of a motion is rounding after some hundred samples, of either sign."""
    position = np.minimum(np.arange(2000) * 1e-4, 0.03)[:, np.newaxis] * [1.0, -1.0]
    velocity = differentiate_twice(lowpass(position, 60.0, 1e-3), 1e-3)[0]
    still = velocity[800:1600]
    assert np.any(still > 0.0) and np.any(still < 0.0) and np.max(np.abs(still)) < 1e-9
    settled = settle(velocity)
    assert not np.any(settled[800:1600])
    assert np.all(settled[10:250, 0] == velocity[10:250, 0])
    assert np.all(np.isnan(settle(np.array([np.nan, 1.0]))) == [True, False])


def test_trapezoids_move_as_they_say() -> None:
    motion = trapezoids((0.1, 0.3), 2.0, 0.2, T, rest=0.25)
    speed = np.diff(motion) / T
    assert motion[0] == 0.0
    assert np.max(motion) == pytest.approx(0.2)
    assert np.max(np.abs(np.diff(speed) / T)) == pytest.approx(2.0, rel=1e-2)
    assert np.max(speed) == pytest.approx(0.3, rel=1e-2)
    assert np.sum(np.isclose(speed, 0.1, rtol=1e-6)) == pytest.approx((0.2 / 0.1 - 0.1 / 2.0) / T, abs=3)
    assert np.sum(speed == 0.0) == pytest.approx(4 * 250, abs=8)
    assert trapezoids((0.1,), 2.0, 0.2, T, duration=7.0).size == 7000


def test_pulses_are_seeded_and_as_wide_as_they_say() -> None:
    signal = pulses(24000, T, 150.0, 0.02, 0.4, seed=5)
    assert np.array_equal(signal, pulses(24000, T, 150.0, 0.02, 0.4, seed=5))
    assert not np.array_equal(signal, pulses(24000, T, 150.0, 0.02, 0.4, seed=6))
    edges = np.flatnonzero(np.diff(np.abs(signal)))
    assert set(np.diff(edges)[::2]) == {20}
    assert abs(len(edges) / 2 - 60) < 12
    assert set(np.unique(signal)) == {-150.0, 0.0, 150.0}
