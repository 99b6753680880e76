"""Bad records are told apart and named; good ones, the real ones among them, pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.records.checks import (
    check_record,
    find_record_warnings,
    limit_faults,
    scale_faults,
    still_faults,
)
from jointid.records.columns import Column
from jointid.records.reading import read
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap

RATE = 1e-3
TIME = np.arange(2000) * RATE
POSITION = 0.1 * np.sin(6 * TIME)
TORQUE = 5.0 * np.cos(6 * TIME)


def channel(values: np.ndarray, unit: str = "m", sample_time: float = RATE) -> Channel:
    return Channel(values, unit, sample_time)


def good(**changes: Channel | Injection | Tap | None) -> Record:
    parts = {
        "torque": channel(TORQUE, "N"),
        "reference": channel(POSITION),
        "motor_position": channel(np.roll(POSITION, 2)),
        "reference_velocity": channel(np.gradient(POSITION, RATE), "m/s"),
    }
    return Record(**{**parts, **changes})  # type: ignore[arg-type]


def only(faults: list[str]) -> str:
    assert len(faults) == 1, faults
    assert faults[0].endswith(".")
    assert "\n" not in faults[0]
    return faults[0]


def test_a_good_record_has_no_fault() -> None:
    check_record(good(), limit=10.0)


def test_a_slow_channel_beside_a_fast_torque_is_no_fault() -> None:
    slow = channel(POSITION[::200], sample_time=0.2)
    for name in ("reference", "load_position"):
        record = good(reference_velocity=None, **{name: slow})
        check_record(record)
        assert not [text for text in find_record_warnings(record, record.channels) if "samples a second" in text]
    for bad in (good(torque=channel(TORQUE[::200], "N", 0.2)), good(torque=None, motor_position=slow)):
        with pytest.raises(RecordError, match="a sample every"):
            check_record(bad)


def test_stillness_is_named() -> None:
    still = channel(np.full(2000, 0.25))
    assert "torque is 3 N in every sample" in only(still_faults(good(torque=channel(np.full(2000, 3.0), "N"))))
    assert "reference stays at 0.25 m" in only(still_faults(good(reference=still)))
    pulses = Injection(channel(TORQUE, "N"))
    assert still_faults(good(reference=still, injected=pulses)) == []
    assert still_faults(Record(motor_position=still)) == []


def test_a_torque_at_its_limit_for_most_of_the_time_is_named() -> None:
    held = np.clip(TORQUE, -3.0, 3.0)
    fault = only(limit_faults(good(torque=channel(held, "N")), 3.0))
    share = np.mean(np.abs(held) >= 0.999 * 3.0)
    assert f"at its limit of 3 N in {share:.1%} of the samples (at most 50.0% expected)" in fault
    assert limit_faults(good(torque=channel(np.clip(TORQUE, -4.0, 4.0), "N")), 4.0) == []
    assert limit_faults(good(), 5.1) == []
    assert limit_faults(Record(reference=channel(POSITION)), 5.1) == []


def test_a_command_beyond_its_limit_is_named_but_not_a_measured_torque() -> None:
    assert "reaches 5 N, above the controller's limit of 4.9 N" in only(limit_faults(good(), 4.9))
    assert limit_faults(good(tap=Tap.MEASURED), 4.9) == []


def drooped(stiffness: float, frequencies: tuple[float, ...]) -> Record:
    """Return the record of a servo of this stiffness under a load of 4 N m, with inertia and friction."""
    asked = 0.8 * sum(np.sin(2 * np.pi * f * np.arange(4000) * RATE) for f in frequencies) / len(frequencies)
    rate, moved, speed, torque = np.gradient(asked, RATE), np.zeros(4000), 0.0, np.zeros(4000)
    for k in range(4000):
        torque[k] = stiffness * (asked[k] - moved[k]) + 0.1 * (rate[k] - speed)
        speed += RATE * (torque[k] - 4.0 * np.sin(moved[k]) - 0.1 * speed) / 0.05
        moved[k + 1 : k + 2] = moved[k] + RATE * speed
    noise = 0.002 * torque.std() * np.random.default_rng(1).standard_normal(4000)
    return Record(
        reference=channel(asked, "rad"), motor_position=channel(moved, "rad"), torque=channel(torque + noise, "N m")
    )


@pytest.mark.parametrize(("stiffness", "frequencies"), [(1.5, (0.4,)), (1.8, (0.4,)), (1.8, (0.3, 0.7))])
def test_a_servo_that_a_load_pulls_off_its_reference_is_healthy(
    stiffness: float, frequencies: tuple[float, ...]
) -> None:
    """Also where the ratio is that of a gear 1:3: the load is not linear, and the torque is of the deviation."""
    record = drooped(stiffness, frequencies)
    assert record.torque is not None
    assert scale_faults(record) == []
    other = replace(record, torque=channel(-record.torque.values, "N m"))
    assert "times reference" in only(scale_faults(other)), "no servo drives its joint away"


@pytest.mark.parametrize("frequency", [0.5, 1.5])
@pytest.mark.parametrize(("scale", "said"), [(1 / (2 * np.pi), "in rev and read as rad"), (1 / 3, "check units")])
def test_a_wrong_unit_or_gear_is_no_droop(scale: float, said: str, frequency: float) -> None:
    """The torque of one sine is in the span of deviation, rate and constant, whatever the joint does."""
    asked = 0.8 * np.sin(2 * np.pi * frequency * TIME)
    speed = np.gradient(asked, RATE)
    torque = 0.05 * np.gradient(speed, RATE) + 4.0 * np.sin(asked) + 0.1 * speed
    torque += 0.002 * torque.std() * np.random.default_rng(0).standard_normal(2000)
    record = Record(
        reference=channel(asked, "rad"), motor_position=channel(scale * asked, "rad"), torque=channel(torque, "N m")
    )
    assert said in only(scale_faults(record))


@pytest.mark.parametrize(
    ("factor", "unit", "part"),
    [
        (1e3, "m", "motor_position were in mm"), (1e-3, "m", "reference were in mm"), (100.0, "m", "were in cm"),
        (180 / np.pi, "rad", "motor_position were in deg"), (1 / (2 * np.pi), "rad", "motor_position were in rev"),
        (np.pi / 180, "rad", "reference were in deg"), (98.6, "rad", "transmission.ratio"),
        (0.07, "rad", "transmission.ratio"),
    ],
)  # fmt: skip
def test_a_wrong_unit_is_named(factor: float, unit: str, part: str) -> None:
    record = Record(reference=channel(POSITION, unit), motor_position=channel(factor * np.roll(POSITION, 3), unit))
    assert part in only([fault for fault in scale_faults(record) if "times" in fault])


def test_opposite_signs_are_named() -> None:
    fault = only(scale_faults(good(motor_position=channel(0.3 - POSITION))))
    assert fault == "motor_position runs against reference; give one of them sign = -1."
    two = scale_faults(good(motor_position=channel(-1e3 * POSITION)))
    assert len([fault for fault in two if "runs against" in fault or "1000 times" in fault]) == 2


def test_a_velocity_in_another_unit_is_named() -> None:
    velocity = channel(6e4 * 0.6 * np.cos(6 * TIME), "m/s")
    assert "as if reference_velocity were in mm/min" in only(scale_faults(good(reference_velocity=velocity)))


@pytest.mark.parametrize(("scale", "unit", "sample_time"), [(1e3, "m", RATE), (2e4, "m", 1.0), (1e6, "rad", RATE)])
def test_a_motion_that_no_joint_makes_is_named(scale: float, unit: str, sample_time: float) -> None:
    only(scale_faults(Record(reference=channel(scale * POSITION, unit, sample_time))))


def test_what_a_joint_does_raises_no_alarm() -> None:
    step = np.where(TIME < 1, 0.0, 0.1)  # 100 m/s between two samples
    lagging = np.where(TIME < 1, 0.0, 0.1 * (1 - np.exp(-20 * (TIME - 1))))
    assert scale_faults(Record(reference=channel(step), motor_position=channel(lagging))) == []
    turns = channel(300 * TIME, "rad")  # a revolute joint may turn for ever
    assert scale_faults(Record(reference=turns, motor_position=turns)) == []
    unrelated = np.random.default_rng(1).normal(size=2000)
    assert scale_faults(Record(reference=channel(POSITION), motor_position=channel(1e-3 * unrelated))) == []
    stands = Record(reference=channel(np.full(7, 0.1)), motor_position=channel(np.full(7, -0.3)))
    assert scale_faults(stands) == []
    half = channel(POSITION[::2], sample_time=2 * RATE)
    assert scale_faults(good(motor_position=half)) == []
    assert scale_faults(Record(reference=channel(np.zeros(1)), motor_position=channel(np.ones(1)))) == []


def test_the_real_records_have_no_fault(data_dir: Path) -> None:
    emps = {"torque": Column("vir", unit="V"), "reference": "qg", "motor_position": "qm"}
    check_record(read(data_dir / "emps" / "DATA_EMPS.mat", emps, kind="prismatic"), limit=10.0)
    pulses = emps | {"injected": Column("pulses_N", gain=5.07 / 5, at=InjectionPoint.BEFORE_LIMIT)}
    check_record(read(data_dir / "emps" / "DATA_EMPS_PULSES.mat", pulses, kind="prismatic"), limit=10.0)
    for axis in range(6):
        columns = {
            "torque": f"rec.act_torque_rel_nm[{axis}]",
            "reference": Column(f"rec.ref_pos_deg[{axis}]", unit="deg"),
            "motor_position": Column(f"rec.act_pos_mot_deg[{axis}]", unit="deg"),
        }
        check_record(read(data_dir / "kr300" / "rec_A.mat", columns, time="rec.time_cont", kind="revolute"))
