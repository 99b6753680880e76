"""What logging does to a signal, undone or refused: wraps, slow refreshes, rounding."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jointid as ji
from jointid.common.errors import RecordError
from jointid.records.checks import find_encoder_step, find_record_warnings
from jointid.records.clock import Cut, cut_table
from jointid.records.columns import Column, find_wrap, unwrap, wrap_faults
from jointid.records.drives import Drive
from jointid.records.formats import Table, write_table
from jointid.records.reading import read
from jointid.records.record import Channel, Record, Timing
from jointid.records.resampling import Resampling, find_refreshes, update_interval

T = 1e-3
TIME = np.arange(1000) * T
MOTION = 3000.0 * np.sin(5 * TIME) + 40_000 * TIME
TORQUE = np.cos(7 * TIME) + 0.3 * np.sin(31 * TIME)


def saved(path: Path, **columns: np.ndarray) -> Path:
    write_table(path, Table({"t": TIME, **columns}))
    return path


@given(st.integers(200, 100_000), st.integers(-10_000, 10_000))
def test_a_position_that_wraps_is_the_one_that_does_not(wrap: int, start: int) -> None:
    whole = np.round(MOTION) + start
    again = unwrap(np.mod(whole, wrap), wrap)
    assert wrap_faults("q", np.mod(whole, wrap), wrap) == []
    np.testing.assert_array_equal(again - again[0], whole - whole[0])


DEGREES = np.degrees(7.0 * np.sin(3 * TIME) + 4.0 * TIME + 0.2)


@pytest.mark.parametrize(
    ("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0), ("counts", 4096.0), ("counts", 65536.0), ("deg", 360.0 / 50)]
)
@pytest.mark.parametrize("channel", ["reference", "motor_position", "load_position"])
def test_a_wrap_that_is_not_declared_is_found(tmp_path: Path, channel: str, unit: str, turn: float) -> None:
    gear = 50.0 if turn == 7.2 else 1.0
    whole = DEGREES / 360 * turn * gear
    wrapped = np.mod(np.round(whole) if unit == "counts" else whole, turn)
    path = saved(tmp_path / "run.csv", q=wrapped)
    drive = Drive(counts_per_turn=turn, load_counts_per_turn=turn) if unit == "counts" else Drive()
    record = read(path, {channel: Column("q", unit=unit)}, drive=drive)
    found = getattr(record, channel).values
    np.testing.assert_allclose(found - found[0], np.radians(DEGREES - DEGREES[0]), atol=2 * np.pi / turn)
    assert np.abs(np.diff(found)).max() < 0.03
    (said,) = record.remarks
    jumps = np.count_nonzero(np.abs(np.diff(wrapped)) > 0.5 * turn)
    assert f'{channel} (column "q") jumps {jumps} times by {turn:.10g} against its motion' in said
    assert f"unwrapped as with wrap = {turn:.10g}" in said
    kept = read(path, {channel: Column("q", unit=unit, wrap=1e9)}, drive=drive)
    assert kept.remarks == ()
    assert np.abs(np.diff(getattr(kept, channel).values)).max() > 0.1


def test_a_reference_is_unwrapped_where_its_motor_says_so(tmp_path: Path) -> None:
    saw, motor = np.mod(7.0 * TIME, 0.8), 7.0 * TIME
    columns = {"reference": "r", "motor_position": "q"}

    def said(**logged: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        path = saved(tmp_path / f"{len(logged)}.csv", **logged)
        record = read(path, {name: column for name, column in columns.items() if column in logged})
        assert record.reference is not None
        position = record.motor_position or record.reference
        return record.reference.values, position.values, record.remarks

    reference, position, (remark,) = said(r=saw, q=motor)
    np.testing.assert_allclose(reference, motor, atol=1e-9)
    reference, _, remarks = said(r=saw, q=np.convolve(saw, np.full(30, 1 / 30.0))[: saw.size])
    assert (remarks, reference.max() < 0.8) == ((), True)  # a saw tooth, which the motor follows
    reference, _, (remark,) = said(r=saw)
    assert reference.max() < 0.8
    assert "if it wraps, give its channel wrap = 0.8" in remark
    reference, position, remarks = said(r=np.mod(motor, 0.8), q=np.mod(motor - 0.01, 0.8))
    np.testing.assert_allclose(reference - position, 0.01, atol=1e-9)  # of one turn, though they begin in two
    assert len(remarks) == 2


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3, 0.1])
def test_steps_and_noise_are_no_wraps(noise: float) -> None:
    random = np.random.default_rng(3)
    for values in (np.sign(np.sin(20 * TIME)), np.abs(np.mod(TIME, 0.2) - 0.1), np.zeros(TIME.size)):
        assert find_wrap(values + noise * random.standard_normal(TIME.size)) is None
    assert find_wrap(np.array([1.0])) is None
    assert find_wrap(np.array([-1e308, 1e308, np.nan, 0.0])) is None


def test_whole_rows_that_are_repeated_are_left_out(tmp_path: Path) -> None:
    rows = np.repeat(np.arange(1000), np.where(np.isin(np.arange(1000), [100, 700]), 2, 1))
    path = tmp_path / "run.csv"
    write_table(path, Table({"t": TIME[rows], "q": MOTION[rows]}))
    record = read(path, {"motor_position": "q"})
    np.testing.assert_allclose(record.motor_position.values, MOTION, rtol=1e-6)
    (said,) = record.remarks
    assert said == "run.csv repeats 2 whole rows, the first after sample 100 (t = 0.1 s): left out"
    assert said in find_record_warnings(record, ("motor_position",))
    moved = MOTION[rows] + np.arange(rows.size)  # the stamps are repeated, and not the rows
    write_table(path, Table({"t": TIME[rows], "q": moved}))
    with pytest.raises(RecordError, match=r"jumps 2 times: after sample 100 .* it repeats its stamp"):
        read(path, {"motor_position": "q"})
    np.testing.assert_allclose(
        read(path, {"motor_position": "q"}, sample_time=T).motor_position.values, moved, rtol=1e-6
    )


BROKEN = {
    "a gap": np.delete(TIME, range(300, 340)),
    "a lost sample": np.delete(TIME, 300),
    "a clock that starts again": np.concatenate([TIME[:300], TIME[:660]]),
    "two gaps": np.delete(TIME, [*range(300, 340), *range(800, 900)]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_the_remedies_that_a_broken_clock_names_work(tmp_path: Path, name: str) -> None:
    stamps = BROKEN[name]
    path = tmp_path / "run.csv"
    write_table(path, Table({"t": stamps, "q": np.sin(stamps), "i": np.cos(stamps)}))
    columns = {"motor_position": "q", "torque": "i"}
    with pytest.raises(RecordError) as error:
        read(path, columns)
    (said,) = error.value.faults
    part, first, last = map(int, re.search(r"give part = (\d+) \(samples (\d+) to (\d+)", said).groups())
    for chosen in (part, 0):
        record = read(path, columns, part=chosen)
        np.testing.assert_allclose(record.motor_position.values, np.sin(stamps[first : last + 1]), atol=1e-6)
    assert ("resample = { sample_time = 0.001" in said) == (name == "a lost sample")
    if name == "a lost sample":
        record = read(path, columns, resample=Resampling(T, "cubic"))
        np.testing.assert_allclose(record.motor_position.values, np.sin(TIME), atol=1e-5)
    if "or sample_time = 0.001 without time" in said:
        assert read(path, columns, sample_time=T).motor_position.values.size == stamps.size
    with pytest.raises(RecordError, match=r'part is 7, but the time column "t" has [23] parts .* 0 for the longest'):
        read(path, columns, part=7)


def test_a_record_is_cut_by_its_own_clock(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    write_table(path, Table({"t [ms]": 5e3 + 1e3 * TIME, "q": MOTION}))
    record = read(path, {"motor_position": "q"}, start=5.1, stop=5.3)
    np.testing.assert_allclose(record.motor_position.values, MOTION[100:301], rtol=1e-6)
    record = read(path, {"motor_position": "q"}, sample_time=T, start=0.1)
    np.testing.assert_allclose(record.motor_position.values, MOTION[100:], rtol=1e-6)
    with pytest.raises(RecordError, match=r"start and stop leave 0 samples of t \[ms\], which goes from 5 to 5.999 s"):
        read(path, {"motor_position": "q"}, start=0.1, stop=0.3)


def slow(every: int, phase: int) -> np.ndarray:
    """Return the torque as a log shows it that is refreshed at samples phase, phase + every, ..."""
    index = (np.arange(TIME.size) - phase) // every * every + phase
    return np.cos(7 * index * T) + 0.3 * np.sin(31 * index * T)


@pytest.mark.parametrize("phase", [0, 1, 3])
def test_a_slow_column_is_picked_at_its_refreshes(tmp_path: Path, phase: int) -> None:
    path = saved(tmp_path / "run.csv", i=slow(4, phase), q=MOTION)
    record = read(
        path, {"torque": Column("i", update_time=4 * T), "motor_position": Column("q", unit="um")}, kind="prismatic"
    )
    assert record.torque is not None
    assert record.motor_position is not None
    assert (record.torque.sample_time, record.torque.timing) == (4 * T, Timing.HELD)
    assert record.motor_position.sample_time == T
    np.testing.assert_allclose(record.torque.values, TORQUE[phase::4])
    assert record.begin == pytest.approx(phase * T)
    np.testing.assert_allclose(record.motor_position.values, MOTION[phase:] * 1e-6)


def test_two_slow_columns_begin_together(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.csv", i=slow(4, 3), r=slow(2, 1))
    record = read(
        path, {"torque": Column("i", update_time=4 * T), "reference": Column("r", update_time=2 * T)}, kind="prismatic"
    )
    assert record.torque is not None
    assert record.reference is not None
    np.testing.assert_allclose(record.torque.values, TORQUE[3::4])
    np.testing.assert_allclose(record.reference.values, TORQUE[3::2])
    assert record.begin == pytest.approx(3 * T)
    path = saved(tmp_path / "run.csv", i=slow(4, 3), r=slow(2, 0))
    record = read(
        path, {"torque": Column("i", update_time=4 * T), "reference": Column("r", update_time=2 * T)}, kind="prismatic"
    )
    assert record.resampled is not None and record.resampled.sample_time == pytest.approx(2 * T)


@pytest.mark.parametrize(("stated", "remedy"), [(2, "update_time = 0.004"), (8, "leave it out")])
def test_another_rhythm_than_the_stated_one_is_refused(stated: int, remedy: str) -> None:
    with pytest.raises(RecordError, match=remedy):
        find_refreshes("torque", slow(4, 0), T, stated * T)


def test_a_rhythm_and_a_rounding_are_found() -> None:
    assert update_interval(slow(4, 1)) == 4
    assert update_interval(TORQUE) == 1
    assert update_interval(np.zeros(100)) == 1
    for values, step in ((np.round(MOTION / 37) * 37e-6, 37e-6), (np.round(TORQUE, 1), 0.1)):
        assert find_encoder_step(Channel(values, "m", T)) == pytest.approx(step)
    assert find_encoder_step(Channel(TORQUE, "N", T)) is None


def notes(**values: np.ndarray) -> tuple[str, ...]:
    channels: dict[str, Any] = {
        name: Channel(array, "N m" if name == "torque" else "rad", T) for name, array in values.items()
    }
    record = Record(**channels)
    return find_record_warnings(record, record.channels)


def test_what_rounding_and_refreshing_do_is_said() -> None:
    assert notes(torque=TORQUE, motor_position=MOTION) == ()
    assert notes(torque=np.round(TORQUE, 2)) == ()
    (rounded,) = notes(torque=np.round(TORQUE, 1))
    assert "steps of 0.1 N m, 13.1% of its rms about its mean: rounding alone leaves 3.8% of it" in rounded
    (late,) = notes(torque=slow(4, 0))
    assert "changes only every 4 samples" in late
    assert "update_time = 0.004" in late
    (coarse,) = notes(motor_position=np.round(MOTION / 10) * 10)
    assert "steps of 10 rad, of which it passes" in coarse
    assert notes(motor_position=np.round(MOTION)) == ()


def test_an_encoder_that_is_late_is_found() -> None:
    smooth = np.sin(5 * TIME) + 0.3 * np.sin(13 * TIME)
    late = np.interp(TIME - 3e-3, TIME, smooth)
    (said,) = notes(motor_position=smooth, load_position=late)
    assert "99% of the difference" in said
    assert "as if load_position were 3 ms later than motor_position" in said
    (said,) = notes(motor_position=late, load_position=smooth)
    assert "motor_position were 3 ms later" in said
    spring = smooth - 1e-3 * np.gradient(np.gradient(smooth, T), T)
    assert notes(motor_position=smooth, load_position=spring) == ()


def test_the_load_encoder_of_the_kr300_is_late(data_dir: Path) -> None:
    for name in ("rec_A", "rec_B"):
        for axis in (1, 2, 3):
            record = read(data_dir / "kr300" / f"{name}.mat", drive=Drive("kuka", axis=axis), kind="revolute")
            (said,) = find_record_warnings(record, record.channels)
            share, lag = (float(text) for text in re.findall(r"(\d+)%.* were ([\d.]+) ms later", said)[0])
            assert share >= 94
            assert 2.7 <= lag <= 3.2


def test_a_joint_is_identified_from_a_slow_torque(tmp_path: Path) -> None:
    """The log has a sample each period of the loop, and shows every fourth torque four times, from its second on."""
    loop = ji.ClosedLoop(
        ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0, period=T)
    )
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=T)
    truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    made = ji.simulated_record(loop, reference, truth, sample_time=T)
    assert made.torque is not None
    assert made.reference is not None
    torque = made.torque.values
    shown = torque[np.maximum((np.arange(torque.size) - 1) // 4 * 4 + 1, 0)]
    write_table(tmp_path / "run.mat", Table({"r": made.reference.values, "i": shown}))
    columns = {"torque": Column("i", update_time=4 * T), "reference": Column("r")}
    record = read(tmp_path / "run.mat", columns, sample_time=T, kind="prismatic")
    estimate = ji.identify(record, loop, filtering=ji.Filtering(cutoff=20.0))
    assert estimate["inertia"].value == pytest.approx(30.0, rel=1e-4)
    assert estimate["coulomb"].value == pytest.approx(15.0, rel=1e-3)


def test_a_second_clock_is_not_cut_by_the_first() -> None:
    """A counter repeats one value beside a clock of its own: no whole row repeats, so none is left out."""
    counter = np.array([0.0, 1.0, 1.0, 2.0])
    values = np.arange(4.0)
    columns = {"date": values, "counter": counter, "torque": values}
    one = Table(columns, clocks={"counter": "date", "torque": "date"})
    for time in ("counter", "date"):
        cut, remarks = cut_table(one, time, None, None, Cut(), repaired=True)
        assert not remarks and {name: column.size for name, column in cut.columns.items()} == dict.fromkeys(columns, 4)
    two = Table(columns | {"late": 10 + values}, clocks={"torque": "late", "counter": "date"})
    cut, _ = cut_table(two, "date", None, None, Cut(start=2.0), repaired=True)
    assert {name: column.size for name, column in cut.columns.items()} == {
        "date": 2, "counter": 2, "torque": 4, "late": 4,
    }  # fmt: skip
