"""Open-loop identification where the truth is known: recovery, intervals, drift, and where it must not converge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.paper.twin import TABLE_2, twin
from jointid.records.record import Timing
from jointid.simulation.prescribed import simulate_open_loop
from jointid.uncertainty.verdict import MOTION_MEASURED

T = 1e-3
JOINT = ji.FlexibleJoint("prismatic")
TRUTH = TABLE_2 | {"load_coulomb": 25.0}
AROUND = {"initial_position": 0.1, "initial_velocity": 0.0, "log_delay": T}
FILTERING = ji.Filtering(cutoff=60.0)
FIT = ji.OpenLoopFit(frequency=24.0)


def record(noise: float = 0.0, seed: int = 0, drift: float = 0.0) -> ji.Record:
    rng, t = np.random.default_rng(1), np.arange(12000) * T
    tones = {0.5: 60, 1: 60, 2: 40, 3: 40, 5: 40, 8: 40, 13: 40, 19: 40, 24: 40, 29: 40, 37: 40}
    force = np.sum([a * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f, a in tones.items()], axis=0)
    torque = ji.Channel(force * np.minimum(1, t / 0.2), "N", T, Timing.HELD)
    position = simulate_open_loop(JOINT, torque, TRUTH | AROUND).position
    shown = position + noise * np.random.default_rng(seed).standard_normal(t.size) + drift * t**2
    return ji.Record(torque=torque, motor_position=ji.Channel(shown, "m", T), name="open loop")


@pytest.fixture(scope="module")
def exact() -> ji.Estimate:
    return ji.identify(record(), ji.OpenLoop(JOINT), FIT, filtering=FILTERING)


def test_a_record_without_noise_gives_the_truth(exact: ji.Estimate) -> None:
    for name, value in (TRUTH | {"log_delay": T}).items():
        assert exact[name].value == pytest.approx(value, rel=1e-5), name
    assert exact.fit.converged
    assert exact.fit.filtered_error < 1e-8


def test_it_says_what_it_compares_and_that_drift_is_left_out(exact: ji.Estimate) -> None:
    assert exact.fit.compared == "position"
    assert "position error" in str(exact)
    assert "torque error" not in str(exact)
    assert any("1.8 Hz are drift" in warning for warning in exact.checks.warnings)


def test_drift_of_the_position_does_not_matter(exact: ji.Estimate) -> None:
    found = ji.identify(record(drift=1e-4), ji.OpenLoop(JOINT), FIT, filtering=FILTERING)  # 14 mm in 12 s
    for name in ("motor_inertia", "stiffness", "load_inertia"):
        assert found[name].value == pytest.approx(TRUTH[name], rel=1e-3), name


def test_noise_of_the_encoder_leaves_the_truth_in_the_intervals() -> None:
    found = ji.identify(record(noise=2e-6, seed=3), ji.OpenLoop(JOINT), FIT, filtering=FILTERING)
    for name in ("motor_inertia", "motor_coulomb", "stiffness", "load_inertia", "load_coulomb"):
        line = found[name]
        assert line.stderr is not None
        assert abs(line.value - TRUTH[name]) < 3 * line.stderr, name
        assert line.stderr < 0.01 * line.value, name


@pytest.mark.slow
def test_a_record_with_a_reference_has_wider_intervals_for_a_force_in_its_loop() -> None:
    """The torque of loop L30 answers to a disturbance, so it is no free input."""
    made = twin("L30", seed=1).record
    alone, controlled = (
        ji.identify(one, ji.OpenLoop(JOINT), FIT, filtering=FILTERING) for one in (made.without("reference"), made)
    )
    for name in ("motor_inertia", "stiffness", "load_inertia"):
        narrow, wide = alone[name], controlled[name]
        assert wide.value == narrow.value
        assert wide.stderr is not None and narrow.stderr is not None
        assert wide.stderr > 1.1 * narrow.stderr, name
        assert abs(wide.value - TRUTH[name]) < 2 * wide.stderr, name
    assert MOTION_MEASURED in controlled.checks.warnings and MOTION_MEASURED not in alone.checks.warnings
    assert "under control" in controlled.sentence


def test_an_inertia_whose_interval_holds_0_is_said_to_be_unknown() -> None:
    """A light rigid joint, moved slowly and measured coarsely; with a fine encoder its inertia is told."""
    joint, truth = ji.RigidJoint("prismatic"), {"inertia": 0.02, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    t = np.arange(6000) * T
    force = (40 * np.sin(2 * np.pi * t) + 30 * np.sin(2 * np.pi * 2.3 * t)) * np.minimum(1, t / 0.2)
    torque = ji.Channel(force, "N", T, Timing.HELD)
    position = simulate_open_loop(joint, torque, truth | AROUND | {"log_delay": 0.0}).position
    random = np.random.default_rng(2).standard_normal(t.size)
    for noise, told in ((1e-7, True), (1e-2, False)):
        made = ji.Record(torque=torque, motor_position=ji.Channel(position + noise * random, "m", T))
        found = ji.identify(made, ji.OpenLoop(joint), ji.OpenLoopFit(log_delay=0.0))
        assert found["inertia"].identifiable is told
        assert found["viscous"].identifiable
        assert ("inertia is not identifiable from this record: its interval holds 0" in found.checks.warnings) != told


def test_a_search_that_cannot_begin_claims_nothing() -> None:
    """From far too light a joint without friction the motor leaves, and no derivative says what to change."""
    light = {
        p.name: replace(p, start=0.01 if "inertia" in p.name else 0.0)
        for p in JOINT.parameters
        if p.name.endswith(("inertia", "viscous", "coulomb"))
    }
    found = ji.identify(record(), ji.OpenLoop(JOINT), FIT, filtering=FILTERING, parameters=light)
    assert not found.fit.converged
    assert [p.stderr for p in found.params.rows if p.free] == [None] * 10
    assert not any(p.identifiable for p in found.params.rows)
    said = found.checks.warnings
    assert "with these values nothing can be simulated, so nothing is known of them; give other starts" in said
    assert "motor_viscous is at its bound, where it does not follow the record" in said
    assert not any("stiffness is at its bound" in text for text in said)


def test_what_is_missing_is_named() -> None:
    made = record()
    with pytest.raises(ji.RecordError, match="needs motor_position"):
        ji.identify(made.without("motor_position"), ji.OpenLoop(JOINT))
    assert made.motor_position is not None
    slow = replace(made.motor_position, values=made.motor_position.values[::2], sample_time=2 * T)
    with pytest.raises(ji.RecordError, match="Open-loop identification needs a sampled"):
        ji.identify(replace(made, motor_position=slow), ji.OpenLoop(JOINT))
    with pytest.raises(ji.MethodError, match="positive"):
        ji.OpenLoopFit(highpass=0.0)
