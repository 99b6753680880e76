"""Steps of the torque that no reference asks for, on signals made for it."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.diagnostics.faults.forces import find_steps
from jointid.diagnostics.faults.record import find_plain_cause
from jointid.records.record import Channel, Record
from jointid.simulation.excitation import trapezoids
from jointid.uncertainty.verdict import Reason

T = 1e-3
REFERENCE = trapezoids((0.5, 1.0), 4.0, 1.0, T, rest=0.5, duration=8.0)
MOVES = np.abs(np.gradient(REFERENCE)) > 1e-2 * np.max(np.abs(np.gradient(REFERENCE)))


def logged(torque: FloatArray, reference: FloatArray = REFERENCE) -> Record:
    noise = 1e-3 * np.random.default_rng(2).standard_normal(torque.size)
    return Record(torque=Channel(torque + noise, "N m", T), reference=Channel(reference, "rad", T))


def switched(*, while_it_moves: bool) -> FloatArray:
    """A torque that is switched on and off every 20 to 60 samples, at any time or only while the axis moves."""
    at = np.cumsum(np.random.default_rng(1).integers(20, 60, 150))
    on = np.zeros(REFERENCE.size)
    on[[i for i in at if i < on.size and (MOVES[i] or not while_it_moves)]] = 1.0
    return np.cumsum(on) % 2


def test_a_signal_that_is_switched_while_the_axis_rests_too_is_an_injected_one() -> None:
    assert 0.1 < np.mean(MOVES) < 0.9
    message = find_plain_cause(logged(switched(while_it_moves=False)))
    assert message is not None and message.code is Reason.CAUSE_FOUND
    assert message.values["causes"][0]["cause"] == "injected"
    assert message.values["causes"][0]["value"] == 150


def test_steps_of_a_torque_that_rests_with_the_reference_are_the_drive_s_own() -> None:
    assert find_steps(logged(switched(while_it_moves=True))) is None


def test_steps_of_a_coarse_log_are_its_rounding() -> None:
    slow = np.cumsum(np.random.default_rng(3).standard_normal(REFERENCE.size)) / 100
    record = logged(slow)
    assert record.torque is not None
    step = float(np.std(slow)) / 8
    coarse = Channel(np.round(record.torque.values / step) * step, "N m", T)
    assert find_steps(record.with_channels({"torque": coarse})) is None


@pytest.mark.parametrize(("seconds", "found"), [(1.5, True), (3.5, False)])
def test_only_the_time_since_the_first_motion_counts(seconds: float, found: bool) -> None:
    still, moving = np.zeros(4000), REFERENCE[np.argmax(MOVES) :][: round(seconds / T)]
    reference = np.concatenate([still, moving - moving[0]])
    message = find_plain_cause(logged(np.sin(np.arange(reference.size) / 300), reference))
    assert (message is not None) is found
    if message is not None:
        assert message.code is Reason.RECORD_TOO_SHORT
        assert message.values["seconds"] == pytest.approx(seconds, abs=0.01)
