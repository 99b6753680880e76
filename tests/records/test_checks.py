"""Bad records are told apart and named; good ones, the real ones among them, pass."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.records.checks import check_record, scale_faults
from jointid.records.record import Channel, Injection, Record, Tap

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
    return Record(**{**parts, **changes})


SLOW = channel(POSITION[::200], sample_time=0.2)
STILL = channel(np.full(2000, 0.25))
TURNS = channel(300 * TIME, "rad")  # a revolute joint may turn for ever
STEP = np.where(TIME < 1, 0.0, 0.1)  # 100 m/s between two samples
LAGGING = np.where(TIME < 1, 0.0, 0.1 * (1 - np.exp(-20 * (TIME - 1))))
NOISE = np.random.default_rng(1).normal(size=2000)


@pytest.mark.parametrize(
    ("record", "limit"),
    [
        (good(), 10.0), (good(), 5.1), (good(torque=channel(np.clip(TORQUE, -4.0, 4.0), "N")), 4.0),
        (good(tap=Tap.MEASURED), 4.9), (Record(reference=channel(POSITION)), 5.1),
        (good(reference_velocity=None, reference=SLOW), None), (good(load_position=SLOW), None),
        (good(reference=STILL, injected=Injection(channel(TORQUE, "N"))), None), (Record(motor_position=STILL), None),
        (Record(reference=channel(STEP), motor_position=channel(LAGGING)), None),
        (Record(reference=TURNS, motor_position=TURNS), None),
        (Record(reference=channel(POSITION), motor_position=channel(1e-3 * NOISE)), None),
        (good(motor_position=channel(POSITION[::2], sample_time=2 * RATE)), None),
    ],
)  # fmt: skip
def test_a_sound_record_has_no_fault(record: Record, limit: float | None) -> None:
    check_record(record, limit=limit)


@pytest.mark.parametrize(
    ("record", "limit"),
    [
        (good(torque=channel(TORQUE[::200], "N", 0.2)), None), (good(torque=None, motor_position=SLOW), None),
        (good(torque=channel(np.full(2000, 3.0), "N")), None), (good(reference=STILL), None),
        (good(torque=channel(np.clip(TORQUE, -3.0, 3.0), "N")), 3.0), (good(), 4.9),
        (good(motor_position=channel(0.3 - POSITION)), None),
        (good(reference_velocity=channel(6e4 * 0.6 * np.cos(6 * TIME), "m/s")), None),
        (Record(reference=channel(1e3 * POSITION)), None), (Record(reference=channel(1e6 * POSITION, "rad")), None),
        (Record(reference=channel(np.where(TIME < 1, np.nan, POSITION))), None),
    ],
)  # fmt: skip
def test_each_fault_of_a_record_is_found(record: Record, limit: float | None) -> None:
    with pytest.raises(RecordError) as error:
        check_record(record, limit=limit)
    assert len(error.value.faults) == 1


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
    assert scale_faults(record) == []
    other = replace(record, torque=channel(-record.torque.values, "N m"))
    assert len(scale_faults(other)) == 1, "no servo drives its joint away"


@pytest.mark.parametrize("frequency", [0.5, 1.5])
@pytest.mark.parametrize("scale", [1 / (2 * np.pi), 1 / 3])
def test_a_wrong_unit_or_gear_is_no_droop(scale: float, frequency: float) -> None:
    """The torque of one sine is in the span of deviation, rate and constant, whatever the joint does."""
    asked = 0.8 * np.sin(2 * np.pi * frequency * TIME)
    speed = np.gradient(asked, RATE)
    torque = 0.05 * np.gradient(speed, RATE) + 4.0 * np.sin(asked) + 0.1 * speed
    torque += 0.002 * torque.std() * np.random.default_rng(0).standard_normal(2000)
    record = Record(
        reference=channel(asked, "rad"), motor_position=channel(scale * asked, "rad"), torque=channel(torque, "N m")
    )
    assert len(scale_faults(record)) == 1


@pytest.mark.parametrize("factor", [1e-3, 100.0, 180 / np.pi, 1 / (2 * np.pi), 98.6])
def test_a_wrong_unit_is_a_fault(factor: float) -> None:
    record = Record(reference=channel(POSITION, "rad"), motor_position=channel(factor * np.roll(POSITION, 3), "rad"))
    assert len(scale_faults(record)) == 1
