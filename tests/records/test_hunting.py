"""An axis that hunts at rest is told to; one that stands still, rings out, or is noisy, is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jointid.diagnostics.examine_record import Question, examine
from jointid.models.joints import RigidJoint
from jointid.records.checks import find_hunting, find_record_warnings
from jointid.records.record import Channel, Record
from studies.healthy import drive

T, STEPS = 1e-3, 20  # s, of the loop, and steps of the motion in one of its periods
COULOMB, INERTIA = 8.0, 3.0


def at_rest(sticking: float, integral_time: float, seconds: float = 6.0) -> Record:
    """A rigid axis under P-PI that moves 0.3 rad and then should stand still; its friction is larger at rest."""
    count = round(seconds / T)
    reference = 0.3 * np.clip(np.arange(count) * T / 0.5, 0.0, 1.0)
    torque = np.zeros(count)
    q = v = integral = last = 0.0
    for k in range(count):
        slip = 15.0 * (reference[k] - q) - (q - last) / T
        integral, last = integral + T * slip, q
        torque[k] = 60.0 * (slip + integral / integral_time)
        for _ in range(STEPS):
            if v == 0.0 and abs(torque[k]) < sticking * COULOMB:
                continue
            sense = math.copysign(1.0, v or torque[k])
            level = COULOMB * (1 + (sticking - 1) * math.exp(-((v / 0.02) ** 2)))
            after = v + T / STEPS * (torque[k] - sense * level) / INERTIA
            v = 0.0 if v * after < 0 else after
            q += T / STEPS * v
    torque += 0.2 * np.random.default_rng(1).standard_normal(count)
    return Record(torque=Channel(torque, "N m", T), reference=Channel(reference, "rad", T), name="run")


def test_a_limit_cycle_of_the_integral_in_friction_is_told() -> None:
    record = at_rest(sticking=1.6, integral_time=0.08)
    found = find_hunting(record)
    assert found is not None
    assert found.seen
    assert 0.7 * 1.6 * COULOMB < found.high < 1.3 * 1.6 * COULOMB
    assert -1.3 * 1.6 * COULOMB < found.low < -0.7 * 1.6 * COULOMB
    [warning] = find_record_warnings(record, ("torque", "reference"))
    assert warning.startswith("the axis hunts at rest (stick-slip)")
    assert f"every {found.period:.1f}" in warning
    assert find_record_warnings(record, ("torque",)) == ()


@pytest.mark.parametrize(("sticking", "integral_time"), [(1.0, 1e9), (1.6, 1e9), (1.0, 0.2)])
def test_an_axis_that_stands_still_does_not_hunt(sticking: float, integral_time: float) -> None:
    """Without an integral it sticks; without stiction the integral creeps to where it should be."""
    assert find_hunting(at_rest(sticking, integral_time)) is None


def test_what_rings_out_or_turns_fast_does_not_hunt() -> None:
    time = np.arange(4000) * T
    reference = 0.3 * np.clip(time / 0.5, 0.0, 1.0)
    for torque in (
        10 * np.sin(2 * math.pi * 2 * time) * np.exp(-time / 0.7),  # a soft spring after a stop
        10 * np.sin(2 * math.pi * 15 * time),  # a loop near its limit
        10 * np.random.default_rng(2).standard_normal(time.size),
        np.cumsum(np.full(time.size, 0.01)),  # an integral that winds up
    ):
        record = Record(torque=Channel(torque, "N m", T), reference=Channel(reference, "rad", T), name="run")
        assert find_hunting(record) is None


def test_a_log_too_slow_for_saw_teeth_is_told_so_and_no_hunting_is_said() -> None:
    """A load that varies at 10 Hz turns every few samples, as a saw tooth would."""
    time = np.arange(300) * 0.1
    load = np.random.default_rng(3).standard_normal(time.size)
    slow = Record(
        torque=Channel(5.0 * (load + 0.7 * np.roll(load, 1)), "N m", 0.1),
        reference=Channel(np.interp(time, (0.0, 3.0, 6.0), (0.0, 0.3, 0.0)), "rad", 0.1),
        name="slow",
    )
    found = find_hunting(slow)
    assert found is not None and not found.seen
    (rate,) = find_record_warnings(slow, ("torque", "reference"))
    assert rate.startswith("the record has 10 samples a second")
    said = [one for one in examine(slow, RigidJoint("revolute")).answers if one.question is Question.MOTION]
    assert said[0].good and "the log is too slow to see stick-slip at rest" in said[0].said[0]


@pytest.mark.slow
def test_no_healthy_drive_hunts() -> None:
    """Forty of all kinds of motion, loop and noise."""
    assert [seed for seed in range(300, 340) if find_hunting(drive(seed, 12.0).record) is not None] == []
