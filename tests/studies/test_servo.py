"""The axis under a servo drive of today is identified from its log alone, as surely as was foretold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.records.drives import Drive
from jointid.records.reading import read
from jointid.simulation.closed_loop import simulate
from jointid.simulation.loop_input import prepare
from studies.servo import FILTERING, LOG, RATED, SERVO, servo_twin
from tests.estimates import identify


def test_the_log_is_slow_and_coarse_beside_the_loop() -> None:
    axis = servo_twin()
    experiment = prepare(axis.loop, axis.record)
    assert experiment.every == 16
    assert experiment.law.phases == 8
    assert axis.record.torque is not None
    assert np.allclose(axis.record.torque.values % (RATED / 1000), 0.0)
    run = simulate(axis.loop, experiment, axis.truth)
    assert run.torque.size == axis.record.torque.values.size == round(24.0 / LOG)
    assert SERVO.velocity_feedforward == 1.0
    reference = axis.record.reference
    assert reference is not None
    assert np.std(run.motor_position - reference.values) < 5e-5  # the feed-forward tracks: 4.0e-5, without it 8.3e-4


@pytest.mark.slow
def test_it_is_found_without_a_start() -> None:
    axis = servo_twin(seed=3)
    estimate = identify(axis.record, axis.loop, filtering=FILTERING)
    assert estimate.fit.converged
    for name, value in axis.truth.items():
        assert abs(estimate.values[name] - value) <= 4 * float(estimate[name].stderr or 0.0), name
    assert estimate["initial_torque"].free


def test_the_log_is_read_in_per_mille(tmp_path: Path) -> None:
    axis = servo_twin()
    force, reference, known = axis.record.torque, axis.record.reference, axis.record.injected
    assert force is not None
    assert reference is not None
    assert known is not None
    columns = [1000 * force.values / RATED, 1e3 * reference.values, known.channel.values]
    lines = [",".join(f"{value:.17g}" for value in row) for row in zip(*columns, strict=True)]
    path = tmp_path / "trace.csv"
    path.write_text("\n".join(["force [permille],x [mm],pulses [N]", *lines]), encoding="utf-8")
    names = {"torque": "force [permille]", "reference": "x [mm]", "injected": "pulses [N]"}
    record = read(path, names, sample_time=LOG, drive=Drive(rated_torque=RATED), kind="prismatic")
    assert record.torque is not None
    assert np.allclose(record.torque.values, force.values, rtol=1e-12)
    seen, meant = (prepare(axis.loop, r).feedforward for r in (record, axis.record))
    assert np.allclose(seen, meant, rtol=1e-9, atol=1e-9 * np.max(np.abs(meant)))
