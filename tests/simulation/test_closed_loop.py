"""The closed loop: clocks, delays, saturation, injected signals, initial states, failures."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.problems.simulated import torque_problem
from jointid.models.controllers import PD, Cascade, shift_start
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.paper.twin import TABLE_2
from jointid.records.record import Channel, Injection, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome, require_success
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate, simulated_record
from tests.estimates import identify
from tests.frozen.cases import other_law
from tests.simulation.differences import sensitivities

T = 1e-3
RIGID = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
FLEXIBLE = dict(TABLE_2)
EMPS = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, limit=10.0)
REFERENCE = trapezoids((0.05, 0.1), 1.0, 0.05, T, rest=0.15)


def record(
    reference: np.ndarray = REFERENCE,
    period: float = T,
    timing: Timing = Timing.HELD,
    commanded: Timing = Timing.HELD,
    **more: object,
) -> Record:
    torque = Channel(np.zeros(reference.size), "N", period, timing)
    return Record(torque=torque, reference=Channel(reference, "m", period, commanded), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3, 2.3e-3])
def test_a_delay_is_a_later_torque(delay: float) -> None:
    """A delayed law equals an undelayed one on a four times finer clock, where 0.4 ms and 2.3 ms are no fractions."""
    fine = 1e-4
    fast = StateSpaceController(A=[], B={}, C=[], D={"reference": 4000.0}, period=T, delay=delay)
    loop = ClosedLoop(RigidJoint("prismatic"), fast)
    position = simulate(loop, prepare(loop, record()), RIGID).motor_position
    torque = np.repeat(4000.0 * REFERENCE, 10)
    shift = round(delay / fine)
    held = np.concatenate([np.full(shift, torque[0]), torque])[: torque.size]
    feed = StateSpaceController(A=[], B={}, C=[], D={"reference": 1.0}, period=fine)
    exact = ClosedLoop(RigidJoint("prismatic"), feed)
    expected = simulate(exact, prepare(exact, record(held, fine)), RIGID).motor_position[::10]
    assert np.max(np.abs(position - expected)) <= 1e-9 * np.ptp(expected)


@pytest.mark.parametrize(("at", "in_torque"), [("before_limit", True), ("after_limit", True), ("after_limit", False)])
def test_an_injected_signal_acts_and_is_logged_as_declared(at: str, in_torque: bool) -> None:
    known = pulses(REFERENCE.size, T, 60.0, 0.02, 0.2, seed=3)
    loop = ClosedLoop(RigidJoint("prismatic"), EMPS)
    driven = record(injected=Injection(Channel(known, "N", T), at, in_torque))  # type: ignore[arg-type]
    run = simulate(loop, prepare(loop, driven), RIGID)
    quiet = simulate(loop, prepare(loop, record()), RIGID)
    moved = run.motor_position - quiet.motor_position
    assert np.max(np.abs(moved)) > 1e-5
    acting = run.torque if in_torque else run.torque + known
    expected = RIGID["inertia"] * run.motor.acceleration + RIGID["viscous"] * run.motor.velocity
    expected += RIGID["coulomb"] * np.sign(run.motor.velocity) + RIGID["offset"]
    slides = run.motor.velocity != 0
    assert np.max(np.abs(acting - expected)[slides]) <= 1e-9 * np.max(np.abs(acting))


def test_the_log_may_be_slower_or_faster_than_the_loop() -> None:
    fast = replace(EMPS, period=2.5e-4)
    loop = ClosedLoop(RigidJoint("prismatic"), fast)
    slow = simulate(loop, prepare(loop, record()), RIGID)  # log of 1 ms
    reference = np.repeat(REFERENCE, 4)
    same = simulate(loop, prepare(loop, record(reference, 2.5e-4)), RIGID)  # every period logged
    fine = simulate(loop, prepare(loop, record(np.repeat(REFERENCE, 8), 1.25e-4)), RIGID)  # twice a period
    assert np.array_equal(slow.torque, same.torque[::4])
    assert np.array_equal(slow.motor_position, same.motor_position[::4])
    assert np.allclose(fine.torque[::2], same.torque, rtol=0, atol=1e-9)
    assert np.array_equal(fine.torque[::2], fine.torque[1::2])
    assert np.allclose(fine.motor_position[::2], same.motor_position, rtol=0, atol=1e-12)
    between = 0.5 * (same.motor_position[:-1] + same.motor_position[1:])
    assert np.max(np.abs(fine.motor_position[1:-1:2] - between)) < 1e-6


@pytest.mark.parametrize(("loops", "logged"), [(4, 1), (1, 1), (1, 2)], ids=["slower", "as fast", "faster"])
def test_an_averaged_log_is_the_mean_over_its_sample_time_before(loops: int, logged: int) -> None:
    """Of a loop that has so many periods in a millisecond, and a log of so many samples."""
    loop = ClosedLoop(RigidJoint("prismatic"), replace(EMPS, period=T / loops))
    every = simulate(loop, prepare(loop, record(np.repeat(REFERENCE, loops), T / loops)), RIGID).torque
    averaged = record(np.repeat(REFERENCE, logged), T / logged, Timing.AVERAGED)
    shown = simulate(loop, prepare(loop, averaged), RIGID).torque
    means = np.repeat(every, 4 // loops).reshape(-1, 4 // logged).mean(axis=1)
    assert np.allclose(shown[1:], means[:-1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("delay", [0.5e-3, 1.25e-3])
def test_a_measured_torque_is_averaged_over_the_parts_it_acts_in(delay: float) -> None:
    late = replace(EMPS, position_gain=100.0, delay=delay)
    loop = ClosedLoop(RigidJoint("prismatic"), late)
    command = simulate(loop, prepare(loop, record()), RIGID).torque
    fine = 1000
    acting = np.concatenate([np.full(round(delay / T * fine), command[0]), np.repeat(command, fine)])
    measured = simulate(loop, prepare(loop, record(tap=Tap.MEASURED)), RIGID).torque
    assert np.allclose(measured, acting[: command.size * fine : fine], rtol=0, atol=1e-9)
    averaged = simulate(loop, prepare(loop, record(timing=Timing.AVERAGED, tap=Tap.MEASURED)), RIGID).torque
    means = acting[: command.size * fine].reshape(-1, fine).mean(axis=1)
    assert np.allclose(averaged[1:], means[:-1], rtol=0, atol=1e-9)


def test_a_reference_slower_than_the_loop_is_interpolated_or_held_as_declared() -> None:
    smooth = 0.05 * np.sin(2 * np.pi * 1.5 * np.arange(4000) * T / 4)
    fast = replace(EMPS, period=T / 4)
    loop = ClosedLoop(RigidJoint("prismatic"), fast)
    exact = simulate(loop, prepare(loop, record(smooth, T / 4)), RIGID).torque[::4]
    errors = {}
    for commanded in (Timing.SAMPLED, Timing.HELD):
        shown = simulate(loop, prepare(loop, record(smooth[::4], commanded=commanded)), RIGID).torque
        errors[commanded] = float(np.max(np.abs(shown - exact)[20:]) / np.max(np.abs(exact)))
    assert errors[Timing.SAMPLED] < 0.01 < 0.1 < errors[Timing.HELD]


def test_a_log_that_ends_within_a_period_is_simulated_to_its_last_whole_one() -> None:
    slow = Cascade(
        position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, limit=10.0, period=2 * T
    )
    loop = ClosedLoop(RigidJoint("prismatic"), slow)
    run = simulate(loop, prepare(loop, record(REFERENCE[:3001])), RIGID)
    assert run.torque.size == run.motor_position.size == run.motor.velocity.size == 3000


def test_candidates_fail_with_a_status_and_finite_numbers() -> None:
    loop = ClosedLoop(RigidJoint("prismatic"), EMPS)
    experiment = prepare(loop, record())
    for change, outcome in (({"inertia": 0.02}, Outcome.DIVERGED), ({"viscous": math.nan}, Outcome.INVALID)):
        unlimited = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=160.18, velocity_gain=243.45, gain=35.15))
        run = simulate(unlimited, prepare(unlimited, record()), RIGID | change)
        assert run.outcome is outcome
        assert np.all(np.isfinite(run.torque))
        assert np.all(np.isfinite(run.motor.acceleration))
        with pytest.raises(MethodError, match="stopped after"):
            require_success(run)
    negative = simulate(loop, experiment, RIGID | {"viscous": -30.0})  # odd, but it can be simulated
    assert negative.outcome is Outcome.FINISHED


def test_units_of_mass_length_and_time_do_not_matter() -> None:
    """The same axis in grams, millimetres and minutes: every bound in the engine must be free of scale."""
    mass, length, time = 1e3, 1e3, 1 / 60
    force = mass * length / time**2
    units = {"inertia": mass, "viscous": force * time / length, "coulomb": force, "offset": force}
    other = {name: value * units[name] for name, value in RIGID.items()}
    loop = ClosedLoop(RigidJoint("prismatic"), EMPS)
    run = simulate(loop, prepare(loop, record()), RIGID)
    law = Cascade(
        position_gain=160.18 / time,
        velocity_gain=243.45 * time / length,
        velocity_filter=(0.5, 0.5),
        gain=35.15 * force,
        limit=10.0,
    )
    scaled = ClosedLoop(RigidJoint("prismatic"), law)
    again = simulate(scaled, prepare(scaled, record(REFERENCE * length, T * time)), other)
    assert again.events == run.events
    assert np.max(np.abs(again.torque / force - run.torque)) <= 1e-9 * np.max(np.abs(run.torque))


def test_a_simulated_record_is_what_was_simulated() -> None:
    loop = ClosedLoop(FlexibleJoint("prismatic"), EMPS)
    made = simulated_record(loop, REFERENCE, FLEXIBLE, sample_time=T, encoder_step=1e-6)
    run = simulate(loop, prepare(loop, made), FLEXIBLE)
    assert made.channels == ("torque", "reference", "motor_position", "load_position")
    assert np.array_equal(made.torque.values, run.torque)
    counts = made.motor_position.values / 1e-6
    assert np.max(np.abs(counts - np.round(counts))) < 1e-6
    assert np.max(np.abs(made.motor_position.values - run.motor_position)) <= 0.5e-6 + 1e-12


@pytest.mark.parametrize(("position_gain", "delay"), [(160.18, 0.0), (100.0, 1.3e-3)])
def test_a_record_that_begins_in_motion_begins_without_a_kick(position_gain: float, delay: float) -> None:
    """What the law remembers, what acted before the first sample, and the load follow the motor's first velocity."""
    speed, friction = 0.08, 202.0 * 0.08 + 20.4 - 3.16
    law = replace(EMPS, position_gain=position_gain, delay=delay)
    late = (friction / (35.15 * 243.45) + speed) / position_gain  # steady tracking error of the law
    loop, driven = ClosedLoop(FlexibleJoint("prismatic"), law), record(speed * np.arange(800) * T)
    run = simulate(loop, prepare(loop, driven), FLEXIBLE, Initial(-late, speed))
    assert np.max(np.abs(run.torque - friction)) <= 1e-7 * friction
    stopped = simulate(loop, prepare(loop, driven), FLEXIBLE)
    assert np.max(np.abs(stopped.torque - friction)) > 5.0


def test_a_fast_loop_with_a_slow_position_gain_has_not_gone_far() -> None:
    """Its gain within a period is nearly all the velocity's: 16000 / s beside 10 / s."""
    reference = trapezoids((0.05, 0.1), 1.0, 0.05, 1e-3, rest=0.15)
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=10.0, velocity_gain=3e3, period=62.5e-6))
    run = simulate(loop, prepare(loop, Record(reference=Channel(reference, "m", 1e-3))), RIGID)
    assert run.outcome is Outcome.FINISHED
    assert np.ptp(run.motor_position) > 0.9 * np.ptp(reference)


SLOW = Cascade(
    position_gain=60.0, velocity_gain=6e3, position_period=4 * T, position_offset=2 * T, velocity_feedforward=0.5
)
AT_REST = np.concatenate([np.zeros(12), trapezoids((0.1, 0.2), 2.0, 0.1, T, duration=2.0)])


def after(cut: float, law: Cascade = SLOW) -> Record:
    """What remains of a log from so many samples on, while nothing moves: as if its first refresh had been there."""
    loop = ClosedLoop(RigidJoint("prismatic"), law)
    whole = Record(reference=Channel(AT_REST, "m", T))
    torque = simulate(loop, prepare(loop, whole), RIGID | {"offset": 0.0}).torque
    first = math.ceil(cut)
    kept = (Channel(AT_REST[first:], "m", T), Channel(torque[first:], "N", T, Timing.HELD))
    return Record(reference=kept[0], torque=kept[1], begin=cut * T)


@pytest.mark.parametrize("cut", [0, 1, 3, 6])
def test_a_position_loop_keeps_its_instants_where_a_log_begins_later(cut: int) -> None:
    """Simulated, differentiated and identified: the law of the whole log, whatever was cut off."""
    loop, record, values = ClosedLoop(RigidJoint("prismatic"), SLOW), after(cut), RIGID | {"offset": 0.0}
    run = simulate(loop, prepare(loop, record), values)
    size = float(np.max(np.abs(record.torque.values)))
    np.testing.assert_allclose(run.torque, record.torque.values, atol=1e-9 * size)
    missed = simulate(loop, prepare(loop, replace(record, begin=record.begin + T)), values)
    assert np.max(np.abs(missed.torque - record.torque.values)) > 0.01 * size

    slope = sensitivities(loop, prepare(loop, record), values, ("position_gain",)).torque[:, 0]
    low, high = (after(cut, replace(SLOW, position_gain=SLOW.position_gain + by)).torque for by in (-1e-3, 1e-3))
    difference = (high.values - low.values) / 2e-3
    np.testing.assert_allclose(slope, difference, atol=1e-4 * np.max(np.abs(difference)))

    wrong = ClosedLoop(RigidJoint("prismatic"), replace(SLOW, position_gain=1.02 * SLOW.position_gain))
    found = identify(record, wrong, DIDIM(free=("position_gain",)))
    assert found["position_gain"].value == pytest.approx(SLOW.position_gain, rel=1e-5)
    assert found["inertia"].value == pytest.approx(RIGID["inertia"], rel=1e-5)


def test_a_record_that_begins_between_two_samples_of_the_file_takes_the_next_instant() -> None:
    """Evaluated at 2, 6, ... ms after the file's first sample; the record's instants are at 2.5, 3.5, ... ms."""
    assert shift_start(SLOW, 2.5 * T) == replace(SLOW, position_offset=3.5 * T)
    for off_grid, first in ((3.5, 4), (3.001, 3), (3.1, 4), (0.0, 0)):
        law, on_grid = (replace(SLOW, position_offset=at * T).law(T) for at in (off_grid, first))
        np.testing.assert_array_equal(law.A, on_grid.A)
        np.testing.assert_array_equal(law.B, on_grid.B)


@pytest.mark.parametrize("later", [0, 1, 2, 3, 7])
def test_a_learned_offset_is_counted_from_the_file(later: int) -> None:
    """What a record that begins later shows, and what its file is told, lead to each other, on any grid."""
    slow = replace(SLOW, period=4 * T, position_period=16 * T, position_offset=8 * T)
    for learned in (SLOW, slow):
        declared = shift_start(learned, -later * T)
        cycle = learned.position_period or T
        assert declared.position_offset == pytest.approx((learned.position_offset + later * T) % cycle, abs=1e-15)
        assert shift_start(declared, later * T) == learned
    law = PD(position_gain=1.0, derivative_gain=1.0)
    assert shift_start(law, later * T) == law


def test_a_motor_that_slips_for_a_moment_stops_before_it_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within one period it comes loose, stops 0.2 ms later, and comes loose again; the load stops in between.

    The velocity after it is that of the equations of motion, integrated by scipy's DOP853 from event to event.
    """
    given: list[Any] = []
    monkeypatch.setattr(ji, "identify", lambda *parts: given.extend(parts))
    other_law("friction", "asymmetric", "flexible", 0)
    logged, loop = given
    problem = torque_problem(logged, loop, Filtering(), loop.joint.parameters)
    values = {
        "motor_inertia": 14.7935, "motor_viscous": 1e-9, "motor_coulomb": 14.6017, "stiffness": 232355.0,
        "damping": 85.7, "load_inertia": 15.5531, "load_viscous": 20.5558, "load_coulomb": 10.3805, "offset": 9.434,
        "initial_position": 0.0001525, "initial_velocity": 0.0, "initial_torque": 0.4679,
    }  # fmt: skip
    run = problem.simulate(problem.vector(values))
    assert run.motor_velocity[1986] == 0.0
    assert run.motor_velocity[1987] == pytest.approx(-8.8937e-7, rel=1e-3)
