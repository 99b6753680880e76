"""From a file to a record: channels, units, the clock, two rates, and all faults in one error."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.records.columns import Column
from jointid.records.reading import read
from jointid.records.record import InjectionPoint, Tap, Timing

NAN = float("nan")
RATE = 1e-3
TIME = np.arange(200) * RATE
POSITION = 0.1 * np.sin(30 * TIME)
TORQUE = 2.0 * np.cos(30 * TIME)

Saved = Callable[..., Path]


def faults_of(path: Path, *columns: Any, **how: Any) -> tuple[str, ...]:
    with pytest.raises(RecordError) as error:
        read(path, *columns, **{"kind": "prismatic", **how})
    return error.value.faults


def test_gain_sign_and_unit_take_a_column_to_si(saved: Saved) -> None:
    path = saved(i=TORQUE, r=POSITION, v=POSITION)
    record = read(
        path,
        {
            "torque": Column("i", unit="mNm", gain=3.0, sign=-1, tap=Tap.MEASURED, timing=Timing.AVERAGED),
            "reference": Column("r", unit="deg"),
            "load_position": Column("v", unit="mrad", optional=True),
            "motor_position": Column("absent", optional=True),
        },
        sample_time=2e-3,
        kind="revolute",
        name="first",
    )
    assert record.channels == ("torque", "reference", "load_position")
    assert (record.name, record.tap, record.torque.timing) == ("first", Tap.MEASURED, Timing.AVERAGED)
    assert (record.reference.timing, record.reference.source) == (Timing.SAMPLED, "run.mat: r")
    assert (record.torque.unit, record.reference.unit, record.duration) == ("N m", "rad", 200 * 2e-3)
    np.testing.assert_allclose(record.torque.values, -3e-3 * TORQUE, rtol=1e-15)
    np.testing.assert_allclose(record.reference.values, np.deg2rad(POSITION), rtol=1e-15)


@pytest.mark.parametrize(
    ("heading", "how", "unit", "factor"),
    [
        ("q [mm]", {}, "m", 1e-3),
        ("q (um)", {}, "m", 1e-6),
        ("q (filtered)", {}, "m", 1.0),
        ("q (A)", {}, "m", 1.0),
        ("q [mm]", {"unit": "m"}, "m", 1.0),
        ("q [clicks]", {"gain": 1e-5}, "m", 1e-5),
        ("q[0]", {}, "m", 1.0),
    ],
)
def test_a_unit_in_the_name_counts_unless_another_is_stated(
    heading: str, how: dict[str, Any], unit: str, factor: float, saved: Saved
) -> None:
    path = saved(".csv", **{"t": TIME, heading: POSITION})
    channel = read(path, {"reference": Column(heading, **how)}, kind="prismatic").reference
    assert channel.unit == unit
    np.testing.assert_allclose(channel.values, POSITION * factor, rtol=1e-15)


@pytest.mark.parametrize(
    ("heading", "values", "how"),
    [
        ("t", TIME, {}),
        ("Time", TIME, {}),
        ("time [ms]", TIME * 1e3, {}),
        ("T (us)", TIME * 1e6, {}),
        ("t", TIME * 1e3, {"time_unit": "ms"}),
        ("clock", TIME + 17, {"time": "clock"}),
        ("ticks [ms]", TIME * 1e3, {"time": "ticks [ms]", "sample_time": 1e-3}),
        ("t", TIME, {"sample_time": 1e-3}),
    ],
)
def test_the_sample_time_comes_from_the_time_column_or_is_given(
    heading: str, values: np.ndarray, how: dict[str, Any], saved: Saved
) -> None:
    record = read(saved(".csv", **{heading: values, "q": POSITION}), reference="q", **how)
    assert record.reference.sample_time == 1e-3


@pytest.mark.parametrize(
    ("columns", "how"),
    [
        ({"x": TIME}, {}), ({"t": TIME, "Time": TIME}, {}), ({"t": TIME}, {"time": "clock"}),
        ({"t": TIME}, {"time": "t", "sample_time": 2e-3}), ({"t": TIME}, {"sample_time": 0.0}),
        ({"t": TIME}, {"time": "t", "sample_time": NAN}), ({"t": TIME}, {"time_unit": "mm"}),
        ({"t [ms]": TIME}, {"time_unit": "s"}), ({"t": TIME[::-1]}, {}), ({"t": np.zeros(200)}, {}),
        ({"t": np.delete(np.arange(201) * RATE, 50)}, {}), ({"t": TIME[:150]}, {}),
        ({"t": np.append(TIME[:-1], NAN)}, {}), ({"t": np.append(TIME[:100], TIME[:100])}, {}),
    ],
)  # fmt: skip
def test_a_clock_that_cannot_be_is_refused(columns: dict[str, Any], how: dict[str, Any], saved: Saved) -> None:
    path = saved(".csv" if "t [ms]" in columns else ".mat", **columns, q=POSITION)
    assert len(faults_of(path, {"reference": "q"}, **how)) == 1


def test_all_faults_of_a_step_are_reported_at_once(saved: Saved) -> None:
    gap = POSITION.copy()
    gap[[70, 90]] = NAN
    path = saved(t=np.append(TIME[:-1], 1.0), u=TIME, q=gap, v=POSITION)
    columns = {"torque": "i", "reference": "q", "load_position": Column("v", unit="rad")}
    assert len(faults_of(path, columns)) == 2
    assert len(faults_of(path, {"reference": Column("q", time="u"), "load_position": "v", "motor_position": "v"})) == 2


@pytest.mark.parametrize(
    ("columns", "how"),
    [
        ({"speed": "q"}, {}), ({"reference": "q"}, {"kind": "screw"}),
        ({"reference": Column("none", optional=True)}, {}),
        ({"injected": Column("q", at=InjectionPoint.BEFORE_LIMIT, in_torque=False)}, {}),
    ],
)  # fmt: skip
def test_what_is_asked_for_must_make_sense(columns: dict[str, Any], how: dict[str, Any], saved: Saved) -> None:
    assert len(faults_of(saved(t=TIME, q=POSITION), columns, **how)) == 1


def test_an_injected_signal_is_in_the_unit_of_the_torque(saved: Saved) -> None:
    path = saved(t=TIME, v=TORQUE, p=POSITION)
    injected = Column("p", at=InjectionPoint.BEFORE_LIMIT)
    record = read(path, {"torque": Column("v", unit="mV"), "injected": injected}, kind="prismatic")
    assert record.injected.at is InjectionPoint.BEFORE_LIMIT
    assert record.injected.channel.unit == "V"
    assert record.injected.channel.timing is Timing.HELD
    np.testing.assert_allclose(record.injected.channel.values, POSITION * 1e-3, rtol=1e-15)
