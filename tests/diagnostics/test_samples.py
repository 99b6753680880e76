"""What the samples of a record show: steps, too little motion, lost samples, an axis that hardly moves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.diagnostics.model_free import (
    find_lost_samples,
    find_parts_off,
    find_plain_cause,
    find_standstill,
    find_steps,
)
from jointid.estimation.result.verdict import Reason
from jointid.records.record import Channel, Record
from studies.healthy import drive
from studies.mechanics import lose
from tests.rigid_axis import LOOP, TRUTH
from tests.rigid_axis import REFERENCE as SHORT_MOVES

T = 1e-3
REFERENCE = ji.excitation.trapezoids((0.5, 1.0), 4.0, 1.0, T, rest=0.5, duration=8.0)
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
    assert [(one["cause"], one["value"]) for one in message.values["causes"]] == [("injected", 150)]


def test_steps_that_rest_with_the_reference_and_those_of_a_coarse_log_are_no_signal() -> None:
    assert find_steps(logged(switched(while_it_moves=True))) is None
    slow = np.cumsum(np.random.default_rng(3).standard_normal(REFERENCE.size)) / 100
    record, step = logged(slow), float(np.std(slow)) / 8
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


def moved(reference: FloatArray) -> ji.Record:
    return ji.simulated_record(LOOP, reference, TRUTH, sample_time=1e-3).without("motor_position")


def without(record: ji.Record, first: int, count: int) -> ji.Record:
    rows = np.arange(first, first + count)
    return record.with_channels({n: replace(c, values=np.delete(c.values, rows)) for n, c in record.items()})


@pytest.mark.parametrize("count", [1, 4, 12])
def test_an_identification_names_the_place_and_the_number(count: int) -> None:
    whole = moved(SHORT_MOVES)
    speed = np.abs(np.diff(whole.reference.values))
    first = int(np.flatnonzero(speed > 0.9 * speed.max())[20])  # at full speed
    found = ji.identify(without(whole, first, count), LOOP)
    assert f"samples are missing in the record: about {count} at {1e-3 * first:.3g}"[:-1] in found.answer.trust.words
    assert "samples are missing" not in str(ji.identify(whole, LOOP).answer)


def test_a_reference_that_is_held_coarse_or_stepped_lacks_no_samples() -> None:
    held = np.repeat(SHORT_MOVES[::4], 4)[: SHORT_MOVES.size]
    coarse = 1e-5 * np.round(SHORT_MOVES / 1e-5)
    stepped = 0.01 * np.sign(np.sin(2 * np.pi * 0.7e-3 * np.arange(4000)))
    noisy = SHORT_MOVES + 2e-6 * np.random.default_rng(1).standard_normal(SHORT_MOVES.size)
    for one in (SHORT_MOVES, held, coarse, stepped, noisy):
        assert find_lost_samples(moved(one)) is None


def test_most_losses_of_a_motion_are_found() -> None:
    whole = moved(SHORT_MOVES)
    assert sum(find_lost_samples(lose(whole, seed)) is not None for seed in range(20)) >= 16
    for first in range(100, 3600, 120):  # 30 gaps of one sample, of which some are at rest
        whole = without(whole, first, 1)
    message = find_lost_samples(whole)
    assert message is not None and message.values["causes"][0]["value"] > 20


def zeroed(record: ji.Record) -> ji.Record:
    jump = 0.03 * (np.arange(len(record.reference)) >= 500)
    positions = {n: replace(getattr(record, n), values=getattr(record, n).values - jump) for n in POSITIONS}
    return record.with_channels(positions)


def commanded(record: ji.Record) -> ji.Record:
    values = record.reference.values
    return record.with_channels({"reference": replace(record.reference, values=0.1 * np.round(10 * values))})


POSITIONS = ("reference", "motor_position")
STEPS = 0.02 * np.sign(np.sin(2 * np.pi * 0.7e-3 * np.arange(4000)))


@pytest.mark.parametrize(("edit", "cause"), [(zeroed, "new_zero"), (commanded, "profiled_steps"), (None, None)])
def test_a_new_zero_and_steps_that_a_drive_makes_smooth_are_named(edit: Any, cause: str | None) -> None:
    for reference in (SHORT_MOVES, *((STEPS,) if edit is None else ())):
        whole = ji.simulated_record(LOOP, reference, TRUTH, sample_time=1e-3)
        found = find_plain_cause(whole if edit is None else edit(whole))
        assert (None if found is None else found.values["causes"][0]["cause"]) == cause
        if edit is zeroed:  # IDIM simulates no loop
            assert "a new zero was set there" in " ".join(ji.identify(zeroed(whole), LOOP.joint).warnings)


@pytest.mark.slow
def test_a_motion_one_way_is_not_relied_on_beside_an_injected_signal_that_does_not_turn_it() -> None:
    axis = drive(9128, 4.0, "white force")
    assert Reason.RECORD_TOO_SHORT in [one.code for one in ji.identify(axis.record, axis.loop).checks]


@pytest.mark.parametrize("steps", [0.4, 6])  # of an encoder: the friction holds it, or hardly lets it go
def test_an_axis_that_moves_by_a_few_steps_of_its_encoder_hardly_moves(steps: float) -> None:
    record = ji.simulated_record(LOOP, SHORT_MOVES, TRUTH, sample_time=1e-3)
    motor = record.motor_position
    step = np.ptp(motor.values) / steps
    values = motor.values[0] + step * np.round((motor.values - motor.values[0]) / step)
    message = find_standstill(record.with_channels({"motor_position": replace(motor, values=values)}))
    assert message is not None and message.code is Reason.HARDLY_MOVES
    assert find_standstill(record) is None


def test_parts_in_which_the_drive_is_off_are_named_with_their_times() -> None:
    loop = ji.ClosedLoop(
        ji.RigidJoint("revolute", gravity=ji.Gravity("link")), ji.controller.PD(position_gain=60.0, derivative_gain=1.2)
    )
    truth = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0, "gravity_cos": 1.5, "gravity_sin": 0.0}
    reference = 0.8 * np.sin(4.0 * np.arange(8000) * T) * np.sin(0.9 * np.arange(8000) * T + 0.1)
    record = ji.simulated_record(loop, reference, truth, sample_time=T)
    assert find_parts_off(record) is None
    torque, position = record.torque.values.copy(), record.motor_position.values.copy()
    torque[:1500], position[:1500] = 0.0, position[1500]
    values = {"torque": torque, "motor_position": position}
    off = record.with_channels({n: replace(getattr(record, n), values=one) for n, one in values.items()})
    message = find_parts_off(off)
    assert message is not None and message.values["causes"][0]["cause"] == "drive_off"
    ((begin, end),) = message.values["parts"]
    assert begin == 0.0 and abs(end - 1.5) <= 0.25
