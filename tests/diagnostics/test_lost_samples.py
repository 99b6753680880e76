"""Samples that a logger lost, and closed the gap: named with their places, in a record without stamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.diagnostics.faults.record import find_lost_samples
from studies.mechanics import lose

LOOP = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
TRUTH = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}


def moved(reference: FloatArray) -> ji.Record:
    return ji.simulated_record(LOOP, reference, TRUTH, sample_time=1e-3).without("motor_position")


def trapezoids() -> FloatArray:
    return ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)


def without(record: ji.Record, first: int, count: int) -> ji.Record:
    rows = np.arange(first, first + count)
    return record.with_channels({n: replace(c, values=np.delete(c.values, rows)) for n, c in record.items()})


@pytest.mark.parametrize("count", [1, 4, 12])
def test_an_identification_names_the_place_and_the_number(count: int) -> None:
    whole = moved(trapezoids())
    assert whole.reference is not None
    speed = np.abs(np.diff(whole.reference.values))
    first = int(np.flatnonzero(speed > 0.9 * speed.max())[20])  # at full speed
    found = ji.identify(without(whole, first, count), LOOP)
    assert f"samples are missing in the record: about {count} at {1e-3 * first:.3g}"[:-1] in found.answer.trust.words
    assert "samples are missing" not in str(ji.identify(whole, LOOP).answer)


def test_a_reference_that_is_held_coarse_or_stepped_lacks_no_samples() -> None:
    reference = trapezoids()
    held = np.repeat(reference[::4], 4)[: reference.size]
    coarse = 1e-5 * np.round(reference / 1e-5)
    stepped = 0.01 * np.sign(np.sin(2 * np.pi * 0.7e-3 * np.arange(4000)))
    noisy = reference + 2e-6 * np.random.default_rng(1).standard_normal(reference.size)
    for one in (reference, held, coarse, stepped, noisy):
        assert find_lost_samples(moved(one)) is None


def test_most_losses_of_a_motion_are_found() -> None:
    whole = moved(trapezoids())
    assert sum(find_lost_samples(lose(whole, seed)) is not None for seed in range(20)) >= 16
