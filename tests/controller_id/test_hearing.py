"""What a record tells of its law before any law: the frequencies that are louder than what no law explains."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.controller_id.loop_record import LoopRecord, prepare_loop_record
from jointid.controller_id.noise import band_means, band_power, band_widths
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.learned import LoopTwin, loop_twin
from tests.learned_once import run_law

SEEDS = (57, 134, 140, 160, 180, 500, 506, 512)


def against_the_truth(twin: LoopTwin) -> tuple[LoopRecord, FloatArray]:
    """The record, and how much louder each band of the torque is than what the true law leaves of it."""
    log = prepare_loop_record(twin.record)
    left = (log.torque - run_law(log, twin.structure, twin.numbers)) * log.kept
    return log, band_power(log.torque) / band_power(left)


@pytest.mark.parametrize("seed", SEEDS)
def test_without_a_law_as_much_is_heard_as_with_the_true_one(seed: int) -> None:
    """Position loops every 2 to 8 periods, a notch, feed-forwards: no law is named to what listens."""
    log, louder = against_the_truth(loop_twin(seed))
    informative, wide, error = band_means(log.informative), band_widths(log.informative.size), log.error
    clear = (louder > 8.0) & (error.power > 8.0 * error.variance * band_means(error.shape**2))
    assert wide[clear] @ informative[clear] > 0.9 * np.sum(wide[clear])


def test_noise_is_not_heard() -> None:
    """Where a loud noise covers the law's torque next to nothing is heard."""
    twin = loop_twin(134)
    torque = twin.record.torque
    size = 0.05 * np.std(torque.values)
    noise = size * np.random.default_rng(1).standard_normal(torque.values.size)
    noisy = replace(torque, values=torque.values + noise)
    informative = band_means(prepare_loop_record(replace(twin.record, torque=noisy)).informative)
    law = prepare_loop_record(twin.record).torque  # less what was added
    louder = band_power(law - law.mean()) / size**2
    assert np.mean(louder > 10.0) > 0.05 and np.mean(louder < 1.0) > 0.5
    assert np.mean(informative[louder > 10.0]) > 0.9
    assert np.mean(informative[louder < 1.0]) < 0.02


def test_a_long_record_needs_no_memory_for_all_columns_at_once() -> None:
    """Some two hundred of them, of eight bytes a sample: an hour's would fill a machine."""
    law, peaks = Cascade(position_gain=60.0, velocity_gain=500.0), []
    values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}
    for duration in (20.0, 60.0):
        reference = trapezoids([0.1, 0.3, 0.5], 2.0, 0.2, 1e-3, 0.1, duration)
        record = simulated_record(ClosedLoop(RigidJoint("prismatic"), law), reference, values, sample_time=1e-3)
        tracemalloc.start()
        samples = prepare_loop_record(record).samples
        peaks.append((samples, tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
    (few, low), (many, high) = peaks
    assert (high - low) / (many - few) < 1000  # bytes
