"""The real bench of two motors and a shaft, its load encoder hidden: what torque and motor position say of it."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

import jointid as ji
from jointid.estimation.methods import drive_side
from tests.estimation.motorbench import JOINT, Bench

FILTERING = ji.Filtering(cutoff=150.0, position_cutoff=600.0)
PHYSICAL = ("motor_inertia", "stiffness", "load_inertia")


@pytest.fixture(scope="module")
def bench(data_dir: Path) -> Bench:
    return Bench.read(data_dir)


@pytest.fixture(scope="module")
def hidden(bench: Bench) -> ji.Estimate:
    return ji.identify(bench.record(), JOINT, ji.DriveSideFit(), filtering=FILTERING)


@pytest.fixture(scope="module")
def reference(bench: Bench) -> dict[str, float]:
    return bench.both_encoders("measured", FILTERING)


@pytest.mark.slow
def test_without_the_load_encoder_the_frequencies_are_there(hidden: ji.Estimate) -> None:
    found = ji.FlexibleJoint.frequencies(hidden.values)
    assert found["motor_locked"] == pytest.approx(54.0, abs=0.3)
    assert found["free_free"] == pytest.approx(76.1, abs=0.3)
    assert hidden.fit.converged
    assert hidden.fit.simulations < 150


@pytest.mark.slow
def test_stiffness_and_inertias_are_those_of_both_encoders(hidden: ji.Estimate, reference: dict[str, float]) -> None:
    assert ji.FlexibleJoint.frequencies(reference)["motor_locked"] == pytest.approx(54.0, abs=0.3)
    for name in PHYSICAL:
        line = hidden[name]
        assert line.value == pytest.approx(reference[name], rel=0.03), name
        assert abs(line.value - reference[name]) < 2 * line.stderr, name
        assert 2 * line.stderr < 0.06 * line.value, name  # widened for a force in the loop


def both(bench: Bench, rows: slice = slice(None)) -> ji.Record:
    """What a drive with two encoders logs, or a part of it."""
    part = Bench(bench.measured[rows], bench.command[rows], bench.motor[rows], bench.load[rows])
    record = part.record()
    return replace(record, load_position=ji.Channel(part.load, "rad", 4e-4))


def test_both_encoders_as_logged_give_the_stiffness_and_an_interval_that_holds_both_halves(bench: Bench) -> None:
    half = bench.motor.size // 2
    whole, *halves = (
        ji.identify(both(bench, rows), JOINT, ji.IDIM(), filtering=FILTERING)["stiffness"]
        for rows in (slice(None), slice(half), slice(half, None))
    )
    assert 549.0 < whole.value < 554.0
    assert 2 * whole.stderr < 0.01 * whole.value
    for one in halves:
        assert one.value is not None and abs(one.value - whole.value) < 2 * whole.stderr


@pytest.mark.slow
def test_the_command_comes_before_the_torque(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive_side, "is_followed", followed := Mock(side_effect=drive_side.is_followed))
    filtering = ji.Filtering(cutoff=200.0, position_cutoff=600.0)
    estimate = ji.identify(bench.record("command"), JOINT, ji.DriveSideFit(), filtering=filtering)
    # With the half period for which it is held, the command is 0.6 ms ahead of what the motor feels.
    assert estimate["log_delay"].value == pytest.approx(-0.4e-3, abs=0.05e-3)
    assert estimate["stiffness"].value == pytest.approx(565, rel=0.01) and followed.called  # else it may take minutes
