"""What logging does to a signal, undone or refused: wraps, slow refreshes, rounding."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jointid as ji
from jointid.records.checks import find_encoder_lag, find_encoder_step, find_record_warnings
from jointid.records.columns import Column, find_wrap, unwrap
from jointid.records.record import Channel, Record, Timing
from jointid.records.resampling import Resampling, update_interval

Saved = Callable[..., Path]
T = 1e-3
TIME = np.arange(1000) * T
MOTION = 3000.0 * np.sin(5 * TIME) + 40_000 * TIME
TORQUE = np.cos(7 * TIME) + 0.3 * np.sin(31 * TIME)


@given(st.integers(200, 100_000), st.integers(-10_000, 10_000))
def test_a_position_that_wraps_is_the_one_that_does_not(wrap: int, start: int) -> None:
    whole = np.round(MOTION) + start
    again = unwrap(np.mod(whole, wrap), wrap)
    np.testing.assert_array_equal(again - again[0], whole - whole[0])


DEGREES = np.degrees(7.0 * np.sin(3 * TIME) + 4.0 * TIME + 0.2)


@pytest.mark.parametrize(
    ("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0), ("counts", 4096.0), ("counts", 65536.0), ("deg", 360.0 / 50)]
)
@pytest.mark.parametrize("channel", ["reference", "motor_position", "load_position"])
def test_a_wrap_that_is_not_declared_is_found(saved: Saved, channel: str, unit: str, turn: float) -> None:
    gear = 50.0 if turn == 7.2 else 1.0
    whole = DEGREES / 360 * turn * gear
    wrapped = np.mod(np.round(whole) if unit == "counts" else whole, turn)
    path = saved(".csv", t=TIME, q=wrapped)
    drive = ji.Drive(counts_per_turn=turn, load_counts_per_turn=turn) if unit == "counts" else ji.Drive()
    record = ji.read(path, {channel: Column("q", unit=unit)}, drive=drive)
    found = getattr(record, channel).values
    np.testing.assert_allclose(found - found[0], np.radians(DEGREES - DEGREES[0]), atol=2 * np.pi / turn)
    assert np.abs(np.diff(found)).max() < 0.03
    assert len(record.remarks) == 1
    kept = ji.read(path, {channel: Column("q", unit=unit, wrap=1e9)}, drive=drive)
    assert kept.remarks == ()
    assert np.abs(np.diff(getattr(kept, channel).values)).max() > 0.1
    with pytest.raises(ji.RecordError):
        ji.read(path, {channel: Column("q", unit=unit, wrap=0.5 * turn)}, drive=drive)


def test_a_reference_is_unwrapped_where_its_motor_says_so(saved: Saved) -> None:
    saw, motor = np.mod(7.0 * TIME, 0.8), 7.0 * TIME
    columns = {"reference": "r", "motor_position": "q"}

    def logged(remarks: int, **values: np.ndarray) -> list[np.ndarray]:
        path = saved(".csv", t=TIME, **values)
        record = ji.read(path, {name: column for name, column in columns.items() if column in values})
        assert len(record.remarks) == 1 + remarks  # no unit is given
        return [channel.values for _, channel in record.items()]

    reference, _ = logged(1, r=saw, q=motor)
    np.testing.assert_allclose(reference, motor, atol=1e-9)
    reference, _ = logged(0, r=saw, q=np.convolve(saw, np.full(30, 1 / 30.0))[: saw.size])
    assert reference.max() < 0.8  # a saw tooth, which the motor follows
    (reference,) = logged(0, r=saw)
    assert reference.max() < 0.8
    reference, position = logged(2, r=np.mod(motor, 0.8), q=np.mod(motor - 0.01, 0.8))
    np.testing.assert_allclose(reference - position, 0.01, atol=1e-9)  # of one turn, though they begin in two


@pytest.mark.parametrize(("size", "bit"), [(2**16, False), (2**8, False), (2**11, True), (2**16, True)])
def test_whole_numbers_that_lost_their_sign_have_it_again(saved: Saved, size: int, bit: bool) -> None:
    torque = np.round(0.4 * size * np.sin(20 * TIME) + 2 * np.sin(700 * TIME))
    lost = np.where(torque < 0, size / 2 - torque if bit else size + torque, torque)
    path = saved(".csv", t=TIME, i=lost, up=np.abs(torque), half=lost + 0.5)
    for column in ("i", Column("i", wrap=size)) if not bit else ("i",):
        record = ji.read(path, {"torque": column})
        np.testing.assert_array_equal(record.torque.values, torque)
    for column in ("up", "half"):
        assert len(ji.read(path, {"torque": column}).remarks) == 1


@pytest.mark.parametrize(("mean", "lost"), [(0.0, True), (1.3, False), (0.31, True), (3.0, False)])
def test_a_torque_without_its_sign_is_told_from_one_of_one_sign(mean: float, lost: bool) -> None:
    torque = mean + np.tile(TORQUE, 4) + 0.02 * np.random.default_rng(2).standard_normal(4 * TIME.size)
    signed = (torque, np.maximum(torque, 0.0), np.round(np.maximum(torque, 0.0), 1))
    for values, told in ((np.abs(torque), lost), (-np.abs(torque), lost), *((one, False) for one in signed)):
        said = find_record_warnings(Record(torque=Channel(values, "N m", T, Timing.HELD)), ("torque",))
        assert len(said) == told


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3, 0.1])
def test_steps_and_noise_are_no_wraps(noise: float) -> None:
    random = np.random.default_rng(3)
    for values in (np.sign(np.sin(20 * TIME)), np.abs(np.mod(TIME, 0.2) - 0.1), np.zeros(TIME.size)):
        assert find_wrap(values + noise * random.standard_normal(TIME.size), 2 * np.pi) is None
    assert find_wrap(np.array([1.0]), 1.0) is None
    assert find_wrap(np.array([-1e308, 1e308, np.nan, 0.0]), 1.0) is None


def test_whole_rows_that_are_repeated_are_left_out(saved: Saved) -> None:
    rows = np.repeat(np.arange(1000), np.where(np.isin(np.arange(1000), [100, 700]), 2, 1))
    path = saved(".csv", t=TIME[rows], q=MOTION[rows])
    record = ji.read(path, {"motor_position": "q"})
    np.testing.assert_allclose(record.motor_position.values, MOTION, rtol=1e-6)
    _, said = record.remarks
    assert said in find_record_warnings(record, ("motor_position",))
    moved = MOTION[rows] + np.arange(rows.size)  # the stamps are repeated, and not the rows
    saved(".csv", t=TIME[rows], q=moved)
    with pytest.raises(ji.RecordError):
        ji.read(path, {"motor_position": "q"})
    alone = ji.read(path, {"motor_position": "q"}, sample_time=T)
    np.testing.assert_allclose(alone.motor_position.values, moved, rtol=1e-6)


@pytest.mark.parametrize(
    ("stamps", "longest"),
    [
        (np.delete(TIME, range(300, 340)), (300, 960)), (np.delete(TIME, 300), (300, 999)),
        (np.concatenate([TIME[:300], TIME[:660]]), (300, 960)),
        (np.delete(TIME, [*range(300, 340), *range(800, 900)]), (300, 760)),
    ],
)  # fmt: skip
def test_remedies_of_a_broken_clock_work(saved: Saved, stamps: np.ndarray, longest: tuple[int, int]) -> None:
    path = saved(".csv", t=stamps, q=np.sin(stamps), i=np.cos(stamps))
    columns = {"motor_position": "q", "torque": "i"}
    with pytest.raises(ji.RecordError):
        ji.read(path, columns)
    for part in (2, 0):
        record = ji.read(path, columns, part=part)
        np.testing.assert_allclose(record.motor_position.values, np.sin(stamps[slice(*longest)]), atol=1e-6)
    if stamps.size == TIME.size - 1:
        record = ji.read(path, columns, resample=Resampling(T, "cubic"))
        np.testing.assert_allclose(record.motor_position.values, np.sin(TIME), atol=1e-5)
    assert ji.read(path, columns, sample_time=T).motor_position.values.size == stamps.size
    with pytest.raises(ji.RecordError):
        ji.read(path, columns, part=7)


def test_stamps_of_a_32_bit_float_offer_no_rate(saved: Saved) -> None:
    path = saved(".csv", t=(1.66e9 + TIME).astype(np.float32).astype(np.float64), q=MOTION)
    with pytest.raises(ji.RecordError) as refused:
        ji.read(path, {"motor_position": "q"})
    assert "sample_time" in str(refused.value) and "sample_time = 0" not in str(refused.value)


def test_nanoseconds_beside_a_column_of_seconds_are_a_clock(saved: Saved) -> None:
    stamps = 17.3 + 0.01 * np.arange(300)
    path = saved(".csv", sec=np.floor(stamps), nanosec=np.round(1e9 * np.mod(stamps, 1.0)), q=stamps)
    record = ji.read(path, {"motor_position": "q"}, time="nanosec", time_unit="ns")
    assert (len(record.motor_position), record.motor_position.sample_time) == (300, pytest.approx(0.01))


def test_a_record_is_cut_by_its_own_clock(saved: Saved) -> None:
    path = saved(".csv", **{"t [ms]": 5e3 + 1e3 * TIME, "q": MOTION})
    record = ji.read(path, {"motor_position": "q"}, start=5.1, stop=5.3)
    np.testing.assert_allclose(record.motor_position.values, MOTION[100:301], rtol=1e-6)
    record = ji.read(path, {"motor_position": "q"}, sample_time=T, start=0.1)
    np.testing.assert_allclose(record.motor_position.values, MOTION[100:], rtol=1e-6)
    for wrong in ({"start": 0.1, "stop": 0.3}, {"leave_out": ((7.0, 8.0),)}, {"leave_out": ((5.0, 9.0),)}):
        with pytest.raises(ji.RecordError):
            ji.read(path, {"motor_position": "q"}, **wrong)
    record = ji.read(path, {"motor_position": "q"}, leave_out=((5.0, 5.1), (5.2, 5.25)))
    np.testing.assert_allclose(record.motor_position.values, MOTION[100:], rtol=1e-6)  # an end is not read
    assert np.flatnonzero(record.counts(300, T) == 0.0).tolist() == list(range(100, 150))


def slow(every: int, phase: int) -> np.ndarray:
    """Return the torque as a log shows it that is refreshed at samples phase, phase + every, ..."""
    index = (np.arange(TIME.size) - phase) // every * every + phase
    return np.cos(7 * index * T) + 0.3 * np.sin(31 * index * T)


@pytest.mark.parametrize("phase", [0, 1, 3])
def test_a_slow_column_is_picked_at_its_refreshes(saved: Saved, phase: int) -> None:
    path = saved(".csv", t=TIME, i=slow(4, phase), q=MOTION)
    record = ji.read(
        path, {"torque": Column("i", sample_time=4 * T), "motor_position": Column("q", unit="um")}, kind="prismatic"
    )
    assert (record.torque.sample_time, record.torque.timing) == (4 * T, Timing.HELD)
    assert record.motor_position.sample_time == T
    np.testing.assert_allclose(record.torque.values, TORQUE[phase::4])
    assert record.begin == pytest.approx(phase * T)
    np.testing.assert_allclose(record.motor_position.values, MOTION[phase:] * 1e-6)


def test_two_slow_columns_begin_together(saved: Saved) -> None:
    columns = {"torque": Column("i", sample_time=4 * T), "reference": Column("r", sample_time=2 * T)}
    record = ji.read(saved(".csv", t=TIME, i=slow(4, 3), r=slow(2, 1)), columns, kind="prismatic")
    np.testing.assert_allclose(record.torque.values, TORQUE[3::4])
    np.testing.assert_allclose(record.reference.values, TORQUE[3::2])
    assert record.begin == pytest.approx(3 * T)
    other = ji.read(saved(".csv", t=TIME, i=slow(4, 3), r=slow(2, 0)), columns, kind="prismatic")
    assert other.resampled is not None and other.resampled.sample_time == pytest.approx(2 * T)


def test_another_rhythm_than_the_stated_one_is_refused(saved: Saved) -> None:
    path = saved(".csv", t=TIME, i=slow(4, 0))
    for stated in (3 * T, 3.5 * T, 8 * T):
        with pytest.raises(ji.RecordError):
            ji.read(path, {"torque": Column("i", sample_time=stated)})


def test_a_rhythm_and_a_rounding_are_found() -> None:
    assert update_interval(slow(4, 1)) == 4
    assert update_interval(TORQUE) == 1
    assert update_interval(np.zeros(100)) == 1
    for values, step in ((np.round(MOTION / 37) * 37e-6, 37e-6), (np.round(TORQUE, 1), 0.1)):
        assert find_encoder_step(Channel(values, "m", T)) == pytest.approx(step)
    assert find_encoder_step(Channel(TORQUE, "N", T)) is None


def test_a_torque_that_repeats_its_values_is_said() -> None:
    steady, repeated = (Record(torque=Channel(values, "N m", T)) for values in (TORQUE, slow(4, 0)))
    assert find_record_warnings(steady, ("torque",)) == ()
    assert "sample_time = 0.004" in find_record_warnings(repeated, ("torque",))[0]


def test_an_encoder_that_is_late_is_found() -> None:
    smooth = np.sin(5 * TIME) + 0.3 * np.sin(13 * TIME)
    spring = smooth - 1e-3 * np.gradient(np.gradient(smooth, T), T)
    motor, late, bent = (Channel(one, "rad", T) for one in (smooth, np.interp(TIME - 3e-3, TIME, smooth), spring))
    assert find_encoder_lag(Record(motor_position=motor, load_position=bent)) is None
    for load, first in ((late, motor), (motor, late)):
        lag = find_encoder_lag(Record(motor_position=first, load_position=load))
        assert lag == ("load_position" if load is late else "motor_position", pytest.approx(3e-3, rel=0.02))


@pytest.mark.parametrize("name", ["Zeit [ms]", "cycle (ms)"])
def test_a_sample_time_that_the_stamps_of_the_file_contradict_is_refused(saved: Saved, name: str) -> None:
    exact, coarse = 1e3 * TIME, np.floor(1e3 * TIME / 50) * 50
    for stamps in (exact, coarse):
        path = saved(".csv", **{name: stamps, "q": MOTION})
        for wrong in (0.5, 1.2, 4.889):
            with pytest.raises(ji.RecordError, match="sample_time is"):
                ji.read(path, {"motor_position": "q"}, sample_time=wrong * T)
        assert ji.read(path, {"motor_position": "q"}, sample_time=1.01 * T).motor_position is not None
