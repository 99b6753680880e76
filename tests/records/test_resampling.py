"""Clocks that are not uniform: told in numbers, resampled only when asked, exactly as far as the method is exact."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jointid as ji
from jointid.common.errors import RecordError
from jointid.records.clock import Clock, fit_line
from jointid.records.record import Channel, Timing
from jointid.records.resampling import Resampling, Signal, resample_together
from tests.records.logged import topics

T = 1e-3
LATE = T * 0.3 * np.random.default_rng(3).random(400)
STAMPS = np.arange(400) * T + LATE

Saved = Callable[..., Path]


def read(path: Path, how: Resampling | None, **channels: Any) -> ji.Record:
    return ji.read(path, channels or {"motor_position": "q"}, resample=how, kind="prismatic")


def values(record: ji.Record, name: str = "motor_position") -> np.ndarray:
    return dict(record.items())[name].values


def test_the_deviations_are_those_from_the_line_of_least_squares() -> None:
    line = np.polynomial.Polynomial.fit(np.arange(400), STAMPS, 1)
    period, off, left_out = fit_line(STAMPS)
    np.testing.assert_allclose(off, STAMPS - line(np.arange(400)), atol=1e-12)
    assert (period, left_out.any()) == (pytest.approx(line.convert().coef[1], rel=1e-9), False)
    period, off, _ = fit_line(1e9 + np.arange(1000) * T)
    assert np.abs(off).max() < 2e-7 and period == pytest.approx(T, rel=1e-9)  # the last digit of seconds since 1970
    stamps = np.delete(np.arange(100) * T, [20, 21, 22, 50])
    stamps[80], stamps[90] = stamps[79], stamps[88]
    _, _, left_out = fit_line(stamps)  # one after a repeated stamp, and one after a step back
    assert (np.count_nonzero(left_out), left_out.max()) == (4, 3)


@pytest.mark.parametrize(("method", "degree"), [("hold", 0), ("linear", 1), ("cubic", 3)])
def test_a_method_is_exact_for_its_degree_and_for_no_higher(saved: Saved, method: Any, degree: int) -> None:
    for power in range(5):
        record = read(saved(t=STAMPS, q=(5 * STAMPS - 1) ** power), Resampling(T, method))
        grid = record.begin + np.arange(len(values(record))) * T + STAMPS[0]
        error = np.abs(values(record) - (5 * grid - 1) ** power).max()
        assert (error < 1e-14) == (power <= degree), (method, power, error)


def test_a_held_channel_gives_each_of_its_values_once(saved: Saved) -> None:
    """Stamps that are late by up to 0.3 of a sample: an instant at 0.3 has its own sample behind it, not the next."""
    steps = np.random.default_rng(1).standard_normal(400)
    record = read(saved(t=STAMPS, i=steps), Resampling(T, "cubic"), torque="i")
    np.testing.assert_array_equal(values(record, "torque"), steps[: len(values(record, "torque"))])
    assert len(values(record, "torque")) >= 399


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 1.0, 1.7, 4.0]))
def test_the_means_of_an_average_add_up(seed: int, ratio: float) -> None:
    """The integral over the new periods is that over the old ones, at any rate."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(60) * T + 0.3 * T * rng.random(60)
    means = rng.standard_normal(60)
    one = Signal(Channel(means, "N", T, Timing.AVERAGED), Clock(T, stamps, "t"))
    channels, begin, _ = resample_together({"torque": one}, Resampling(ratio * T, "linear"))
    found = channels["torque"]
    first = begin + stamps[0] - ratio * T
    last = first + len(found) * ratio * T
    edges = np.concatenate([[0.0], np.cumsum(means[1:] * np.diff(stamps))])
    whole = np.interp(last, stamps, edges) - np.interp(first, stamps, edges)
    assert found.values.sum() * ratio * T == pytest.approx(whole, abs=1e-12)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.parametrize("channel", ["motor_position", "reference"])
def test_a_position_tells_whether_its_samples_follow_their_stamps(saved: Saved, channel: str, noise: float) -> None:
    """x(t) = sin 9 t, at stamps that jitter by 15 % of a period: at these instants, or at uniform ones."""
    random = np.random.default_rng(4)
    uniform = np.arange(3000) * T
    stamps = uniform + random.uniform(-0.15, 0.15, uniform.size) * T
    added = noise * random.standard_normal(uniform.size)
    for taken in (stamps, uniform):
        path = saved(t=stamps, q=np.sin(9 * taken) + added, i=np.cos(9 * taken))
        record = read(path, None, torque="i", **{channel: "q"})
        assert len(record.remarks) == 2  # one on the unit, which is not given
        assert (record.resampled is not None) is (taken is stamps)
        found = values(record, channel)
        begin, every = (record.begin + stamps[0], record.resampled.sample_time) if record.resampled else (0.0, T)
        np.testing.assert_allclose(found, np.sin(9 * (begin + np.arange(found.size) * every)), atol=6 * noise + 1e-6)


@pytest.mark.parametrize("late", [0.0, 3.0])
@pytest.mark.parametrize("follows", [False, True])
def test_two_clocks_that_jitter_begin_together_and_each_position_is_judged_by_its_own(
    tmp_path: Path, late: float, follows: bool
) -> None:
    """Two topics at 4 kHz whose stamps jitter by 15 us: the first stamps were apart by more than the tolerance."""
    pytest.importorskip("rosbags")
    period, random = 2.5e-4, np.random.default_rng(4)
    uniform = 1.0 + np.arange(3000) * period
    first, second = (uniform + 15e-6 * random.uniform(-1.0, 1.0, uniform.size) for _ in range(2))
    first[0], second[0] = uniform[0] + 15e-6, uniform[0] - 15e-6
    first, second = (np.round(1e9 * one) / 1e9 for one in (first, second + late * period))
    taken = first if follows else uniform
    topics(tmp_path / "run", {"/q": (first, np.sin(9 * taken)), "/r": (second, np.sin(9 * (uniform + late * period)))})
    channels = {"motor_position": "/q", "reference": "/r"}
    record = ji.read(tmp_path / "run", channels, kind="prismatic")
    assert (record.resampled is not None) is follows
    apart = values(record)[:2900] - values(record, "reference")[:2900]
    # Uniform samples are not moved by their stamps.
    assert np.abs(apart[10:-10]).max() < 9 * (2e-6 if follows else 1e-12)


REFUSED: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "a long gap": (np.delete(STAMPS, range(100, 104)), {}), "a lower rate": (STAMPS, {"sample_time": 2e-3}),
    "a step back": (STAMPS[[*range(50), 48, *range(51, 400)]], {}), "standing still": (np.zeros(400), {}),
    "a repeat": (STAMPS[[*range(50), 49, *range(51, 400)]], {}), "too many samples": (STAMPS, {"sample_time": 1e-12}),
    "no number": (np.where(np.arange(400) == 7, np.nan, STAMPS), {}),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_made_up_is_refused(saved: Saved, name: str) -> None:
    stamps, how = REFUSED[name]
    with pytest.raises(RecordError):
        read(saved(t=stamps, q=np.arange(stamps.size)), Resampling(**{"sample_time": T, "method": "cubic", **how}))


def test_channels_of_two_clocks_keep_their_rates_until_they_are_brought_to_one(saved: Saved) -> None:
    slow, fast = np.arange(101) * 4e-3, np.arange(401) * 1e-3
    path = saved(ts=slow, tf=fast, i=np.cos(slow), q=fast**3)
    columns = {"torque": ji.Column("i", time="ts"), "motor_position": ji.Column("q", time="tf")}
    apart, one = read(path, None, **columns), read(path, Resampling(T, "cubic"), **columns)
    assert apart.resampled is None
    assert [c.sample_time for _, c in apart.items()] == [4e-3, 1e-3]
    assert {c.sample_time for _, c in one.items()} == {T}
    np.testing.assert_array_equal(values(one, "torque"), np.cos(slow)[np.arange(401) // 4])
    np.testing.assert_allclose(values(one), fast**3, atol=1e-12)


def test_clocks_that_begin_apart_are_resampled_to_what_both_cover(saved: Saved) -> None:
    one, other = np.arange(300) * T, 0.0125 + np.arange(300) * T
    path = saved(ta=one, tb=other, i=np.cos(one), q=other)
    columns = {"torque": ji.Column("i", time="ta"), "motor_position": ji.Column("q", time="tb")}
    unasked, record = (read(path, how, **columns) for how in (None, Resampling(T, "linear")))
    np.testing.assert_array_equal(values(unasked), values(record))
    assert len(unasked.remarks) == 2
    assert record.begin == pytest.approx(0.013)
    np.testing.assert_allclose(values(record)[0], 0.013)
    assert len(values(record)) == 287  # to the end of the one that ends first: nothing is extrapolated


def _sparse(path: Path, every: int = 4, phase: int = 0, *, drop: tuple[int, ...] = ()) -> None:
    """Write torque and position in every row, and a reference in some."""
    t = np.arange(1000) * 1e-3
    rows = [row for row in range(phase, t.size, every) if row not in drop]
    cells = [f"{np.sin(5 * t[k]):.9f}" if k in rows else "" for k in range(t.size)]
    lines = [f"{t[k]:.3f},{np.cos(5 * t[k]):.9f},{np.sin(5 * t[k]):.9f},{cells[k]}" for k in range(t.size)]
    path.write_text("\n".join(["t,tau,q,r", *lines]), encoding="utf-8")


SPARSE = {"torque": "tau", "motor_position": "q", "reference": "r"}


@pytest.mark.parametrize(("every", "phase"), [(4, 0), (4, 3), (2, 1), (10, 5)])
@pytest.mark.parametrize("stated", [False, True])
def test_a_channel_that_is_empty_between_has_its_own_rate(tmp_path: Path, every: int, phase: int, stated: bool) -> None:
    _sparse(tmp_path / "run.csv", every, phase)
    column = ji.Column("r", sample_time=every * 1e-3 if stated else None)
    record = ji.read(tmp_path / "run.csv", {**SPARSE, "reference": column}, time="t")
    assert record.reference.sample_time == pytest.approx(every * 1e-3)
    assert record.motor_position.sample_time == pytest.approx(1e-3)
    assert record.begin == pytest.approx(phase * 1e-3, abs=1e-9)
    for channel in (record.reference, record.motor_position):
        np.testing.assert_allclose(channel.values, np.sin(5 * (record.begin + channel.time)), atol=1e-7)
    assert len(record.remarks) == 1 + (not stated)
