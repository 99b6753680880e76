"""Intervals where nobody stated whether the torque is held or sampled, for a plant simulated here."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.records.record import Channel, Record

TRUE = {"inertia": 0.05, "viscous": 0.4, "coulomb": 0.5}


def logged(rate: float, held: bool, count: int, seed: int, noise: float = 0.02) -> list[Record]:
    """Return records of joints under a PD law, by small steps; held: the law runs at the log's rate, else at each."""
    rng, period = np.random.default_rng(seed), 1 / rate
    parts = max(round(period / 2e-4), 10)
    step, size = period / parts, round(12 * rate)
    w = 2 * np.pi * rng.uniform(0.15, 0.022 * min(rate, 60.0), (4, count))
    a = 0.8 / w * rng.uniform(0.5, 1.5, (4, count))
    phase = rng.uniform(0, 6, (4, count))
    q, v = (a * np.sin(phase)).sum(0), (a * w * np.cos(phase)).sum(0)
    stiff = min(2 * np.pi * rate / 25, 40.0)
    kept = np.zeros((size, 2, count))
    for k in range(size):
        for part in range(parts):
            t = (k + part / parts) * period
            if part == 0 or not held:
                reference, rate_of = (a * np.sin(w * t + phase)).sum(0), (a * w * np.cos(w * t + phase)).sum(0)
                u = TRUE["inertia"] * (stiff**2 * (reference - q) + 1.4 * stiff * (rate_of - v)) + 0.4 * rate_of
            if part == 0:
                kept[k] = q, u
            free = v + step * (u - TRUE["viscous"] * v) / TRUE["inertia"]
            drop = step * TRUE["coulomb"] / TRUE["inertia"]
            v = np.sign(free) * np.maximum(np.abs(free) - drop, 0.0)
            q = q + step * v
    kept[:, 1] += noise * kept[:, 1].std(0) * rng.standard_normal((size, count))
    return [
        Record(
            torque=Channel(kept[:, 1, j], "N m", period, "held", stated=False),
            motor_position=Channel(kept[:, 0, j], "rad", period),
        )
        for j in range(count)
    ]


def test_intervals_hold_the_truth_whichever_the_timing_was():
    inside = []
    for rate in (30.0, 50.0, 100.0):
        for held in (True, False):
            for record in logged(rate, held, 4, int(rate)):
                found = ji.identify(record, ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
                inside += [abs(found[name].value - true) <= 2 * found[name].stderr for name, true in TRUE.items()]
                assert any("held or sampled" in one for one in found.checks.warnings)
    assert np.mean(inside) >= 0.85


@pytest.mark.parametrize("timing", ["held", "sampled"])
def test_stated_timing_is_obeyed(timing):
    record = logged(50.0, False, 1, 1)[0]
    stated = replace(record, torque=replace(record.torque, timing=timing, stated=True))
    found = ji.identify(stated, ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    assert not any("held or sampled" in one for one in found.checks.warnings)
