"""Intervals where nobody stated whether the torque is held or sampled, for a plant simulated by the study."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.problems.regression import Rows, solve_rows
from studies.unknown_timing import ARM, TRUE, logged
from tests.robots_plants import two


@pytest.mark.slow
def test_intervals_hold_the_truth_whichever_the_timing_was():
    inside, errors = [], []
    for rate in (30.0, 50.0, 100.0):
        for held in (True, False):
            for seed in range(4):
                found = ji.identify(logged(rate, held, seed)[0], ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
                inside += [abs(found[name].value - true) <= 2 * found[name].stderr for name, true in TRUE.items()]
                errors.append(abs(found["coulomb"].value / TRUE["coulomb"] - 1))
                assert any("held or sampled" in one for one in found.warnings)
    assert np.mean(inside) >= 0.85
    assert np.sqrt(np.mean(np.square(errors))) < 0.015  # 4 % with the rows about reversals


@pytest.mark.slow
def test_intervals_of_a_robot_hold_the_truth():
    inside = []
    for held in (True, False):
        for seed in range(4):
            found = ji.identify(logged(50.0, held, seed, arm=True), ARM, ji.IDIM(), checks=False)
            part = found.require_robot()
            away = np.abs(part.values - part.parameters_of(ARM))
            inside += [*(away <= 2 * found.covariance_of(part.names).std)]
            assert any("held or sampled" in one for one in found.warnings)
    assert np.mean(inside) >= 0.85


def test_weights_are_those_of_the_noise_beside_the_change_of_reading():
    W, rng = np.random.default_rng(1).standard_normal((800, 2)), np.random.default_rng(2)
    early = np.r_[rng.standard_normal(400) + W[:400, 0], np.zeros(400)]
    Y = W @ [1.0, 2.0] + np.repeat([0.01, 0.3], 400) * rng.standard_normal(800)
    found = solve_rows(Rows(Y, W, ("a", "b"), 2, 2, (), early), "weighted", {})
    assert found.covariance.std[1] < 1e-3  # 0.017 by the residual midway, which contains half of the change


@pytest.mark.parametrize("samples", [2, -3])
def test_intervals_cover_a_log_that_is_late(samples):
    record = logged(200.0, True, 1)[0]
    late = replace(record, torque=replace(record.torque, values=np.roll(record.torque.values, samples)))
    found = ji.identify(late, ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    assert all(abs(found[name].value - true) <= 2 * found[name].stderr for name, true in TRUE.items())


@pytest.mark.parametrize("late", [None, pytest.param(0.0, marks=pytest.mark.slow)])
def test_on_the_drive_side_the_delay_makes_up_for_the_timing(late):
    """Of a torque that was sampled half a sample, which moves friction and inertia where the delay is kept."""
    joint, inside, kept = ji.RigidJoint("revolute"), [], []
    for rate in (50.0, 100.0, 200.0):
        for seed in range(4):
            record = logged(rate, False, seed)[0]
            found = ji.identify(record, joint, ji.DriveSideFit(late), checks=False)
            inside += [abs(found[name].value - true) <= 2 * found[name].stderr for name, true in TRUE.items()]
            # It counts from a held torque, of which a sampled one is half a sample late.
            for delay in (0.0, 0.5 / rate):
                assert abs(found["log_delay"].value - delay) <= 3 * found["log_delay"].stderr
            assert any("log_delay, which makes up for" in one for one in found.warnings)
            stated = replace(record, torque=replace(record.torque, stated=True))
            wrong = ji.identify(stated, joint, ji.DriveSideFit(0.0), checks=False)
            kept += [abs(wrong[name].value - true) <= 2 * wrong[name].stderr for name, true in TRUE.items()]
            assert wrong["log_delay"].value == 0.0 and not wrong["log_delay"].free
    assert np.mean(inside) >= 0.85
    assert np.mean(kept) < 0.6


@pytest.mark.parametrize("robot", [False, True], ids=["joint", "robot"])
def test_held_and_sampled_are_one_to_didim(robot):
    """A controller's output at its stamp is its output until the next one."""
    if robot:
        twin = two()
        loop, asked = twin.loop(), twin.records(2.0, sample_time=5e-3)
        records = ji.simulate(loop, asked).records(asked)
    else:
        joint = ji.RigidJoint("revolute")
        loop = ji.ClosedLoop(joint, ji.controller.Cascade(position_gain=10.0, velocity_gain=1.0))
        reference = ji.excitation.trapezoids((0.4, 0.8), acceleration=4.0, travel=0.6, sample_time=0.01)
        records = [ji.simulated_record(loop, reference, TRUE | {"offset": 0.0}, sample_time=0.01)]
    noise = np.random.default_rng(1)
    noisy = [noise.standard_normal(len(one.torque)) * 0.02 * one.torque.values.std() for one in records]
    values = []
    for timing, stated in (("held", False), ("sampled", True)):
        torques = [
            replace(one.torque, values=one.torque.values + more, timing=timing, stated=stated)
            for one, more in zip(records, noisy, strict=True)
        ]
        read = [replace(one, torque=torque) for one, torque in zip(records, torques, strict=True)]
        found = ji.identify(read if robot else read[0], loop, checks=False)
        assert not any("held or sampled" in one for one in found.warnings)
        values.append([row.value for row in found.rows])
    assert values[0] == values[1]


def _sine() -> ji.Record:
    """Return a rigid axis with negligible Coulomb friction on one sine, its torque sampled."""
    w, period = 2 * np.pi, 0.02
    t, rng = period * np.arange(1000), np.random.default_rng(3)
    torque = -TRUE["inertia"] * w**2 * np.sin(w * t) + TRUE["viscous"] * w * np.cos(w * t)
    torque = torque + 0.01 * rng.standard_normal(len(t))
    return ji.Record(
        torque=ji.Channel(torque, "N m", period, "held", stated=False),
        motor_position=ji.Channel(np.sin(w * t), "rad", period),
    )


def test_one_sine_covers_both_readings_and_says_so():
    found = ji.identify(_sine(), ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    half = 0.01 * TRUE["inertia"] * (2 * np.pi) ** 2  # half a sample moves Fv by that
    assert any("held or sampled" in one for one in found.warnings)
    assert abs(found["viscous"].value - TRUE["viscous"]) <= 2 * found["viscous"].stderr
    assert 0.3 * half < found["viscous"].stderr < 3 * half
    joint, value = found.settings.joint, found["viscous"].value
    for bound in {"upper": value - 0.1 * half}, {"lower": value + 0.1 * half}:  # midway lies beyond one of them
        kept = ji.identify(_sine(), joint, parameters={"viscous": replace(joint.parameters[1], **bound)}, checks=False)
        assert [kept["viscous"].at_bound] == [*bound.values()]


def test_intervals_are_not_wider_than_the_timing_asks():
    """A record that tells the timing well widens little."""
    record = logged(200.0, False, 1, noise=0.002)[0]
    stated = replace(record, torque=replace(record.torque, timing="sampled", stated=True))
    free, told = (ji.identify(one, ji.RigidJoint("revolute"), ji.IDIM(), checks=False) for one in (record, stated))
    for name in TRUE:
        assert told[name].stderr <= free[name].stderr < 5 * told[name].stderr, name
