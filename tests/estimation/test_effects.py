"""Ripple and drift: columns beside inertia and friction, known truths and the real axis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.diagnostics.validation import validate
from jointid.estimation.methods.idim import IDIM
from jointid.models.disturbances import Drift, effect_columns
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.position_forces import Motion, PositionHarmonics
from jointid.output import json as answers
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER

T = 1e-3
LOOP = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
TRUTH = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
MOTION = trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, T, duration=12.0)
PITCH = 0.0123


def rippled(seed: int = 0, shift: float = 0.0) -> Record:
    """Return a record whose torque has two harmonics of `PITCH`, a drift of force and of friction, and noise."""
    noise = np.random.default_rng(seed).standard_normal(MOTION.size)
    made = simulated_record(LOOP, MOTION, TRUTH, sample_time=T, torque_noise=noise)
    assert made.motor_position is not None
    assert made.torque is not None
    # What a held torque does is seen half a period later than its stamp.
    position = made.motor_position.values + 0.5 * T * np.gradient(made.motor_position.values, T)
    phase, time = 2 * np.pi * (position + shift) / PITCH, (np.arange(MOTION.size) + 0.5) * T
    extra = 2.0 * np.cos(phase) - 1.0 * np.sin(2 * phase) + (0.3 + 4.0 * np.gradient(position, T)) * time
    return replace(made, torque=replace(made.torque, values=made.torque.values + extra))


EXPECTED = {
    "harmonic_1_cosine": 2.0, "harmonic_1_sine": 0.0, "harmonic_2_cosine": 0.0, "harmonic_2_sine": -1.0,
    "force_drift": 0.3, "viscous_drift": 4.0,
}  # fmt: skip


@pytest.mark.parametrize("estimator", ["ols", "iv"])
def test_ripple_and_drift_are_found(estimator: str) -> None:
    effects = (PositionHarmonics(PITCH, 2), Drift("both"))
    estimate = identify(rippled(), LOOP, IDIM(estimator, effects))  # type: ignore[arg-type]
    for name, value in (TRUTH | EXPECTED).items():
        found = estimate[name]
        assert abs(float(found.value or 0.0) - value) <= 3.5 * float(found.stderr or 0.0), name
    assert estimate["viscous_drift"].unit == "N s/m per s"
    assert (estimate["b_2"].unit, estimate["df"].unit) == ("N", "N/s")
    without = identify(rippled(), LOOP, IDIM(estimator))  # type: ignore[arg-type]
    assert without.fit.filtered_error > 2 * estimate.fit.filtered_error


def test_beside_asymmetric_friction() -> None:
    joint = RigidJoint("prismatic", friction=AsymmetricFriction())
    estimate = identify(rippled(), joint, IDIM(effects=(PositionHarmonics(PITCH, 2), Drift("both"))))
    assert abs(estimate.values["harmonic_1_cosine"] - 2.0) <= 0.1
    forwards, backwards = (estimate[f"coulomb_{word}"] for word in ("forwards", "backwards"))
    half = (float(forwards.value or 0.0) - float(backwards.value or 0.0)) / 2
    assert abs(half - TRUTH["offset"]) <= 1.75 * np.hypot(forwards.stderr or 0.0, backwards.stderr or 0.0)


@pytest.mark.slow
def test_a_cross_test_evaluates_the_effects(tmp_path: Path) -> None:
    effects = (PositionHarmonics(PITCH, 2), Drift("both"))
    estimate = identify(rippled(1), LOOP, IDIM(effects=effects))
    assert validate(estimate, rippled(1)).filtered_error == pytest.approx(estimate.fit.filtered_error, rel=1e-3)
    other = validate(estimate, rippled(2)).filtered_error
    assert other == pytest.approx(estimate.fit.filtered_error, rel=0.1)
    assert validate(estimate, rippled(2, shift=PITCH / 2)).filtered_error > 2 * other
    answers.write(answers.to_dict(estimate), tmp_path / "out.json")
    back = answers.load_estimate(tmp_path / "out.json", LOOP.joint).identified
    assert back == estimate.identified


def test_columns_stand_in_the_equation_of_their_side() -> None:
    random = np.random.default_rng(0)
    motor, load = (Motion(*random.normal(size=(3, 20))) for _ in range(2))
    effects = (PositionHarmonics(0.3), PositionHarmonics(0.7, 2, "load"), Drift("viscous", "load"))
    columns = effect_columns(effects, motor, load, 0.1, 2)
    assert columns.shape == (2, 20, 7)
    assert columns[0, :, :2] == pytest.approx(effects[0].columns(motor, np.zeros(20)))
    assert columns[1, :, 6] == pytest.approx(0.1 * np.arange(20) * load.velocity)
    assert not columns[0, :, 2:].any()
    assert not columns[1, :, :2].any()
    assert len({p.name for effect in effects for p in effect.parameters}) == 7


@pytest.mark.slow
def test_the_real_axis_has_a_ripple_of_half_a_screw_turn_that_does_not_carry_over(
    emps: Record, emps_pulses: Record
) -> None:
    """As large in both records, but its phase is another one: the incremental encoder's zero has moved."""
    joint = RigidJoint("prismatic", friction=AsymmetricFriction())
    plain = identify(emps, joint, IDIM())
    found = [identify(record, joint, IDIM(effects=(PositionHarmonics(2.5e-3),))) for record in (emps, emps_pulses)]
    assert [round(float(np.hypot(e.values["harmonic_1_cosine"], e.values["harmonic_1_sine"])), 1) for e in found] == [
        0.9, 0.8,
    ]  # fmt: skip
    assert found[0].fit.filtered_error < 0.95 * plain.fit.filtered_error
    assert validate(found[0], emps_pulses).filtered_error > validate(plain, emps_pulses).filtered_error
