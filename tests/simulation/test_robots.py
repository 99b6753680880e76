"""A robot in its loops: against an adaptive integrator with the same events, one joint's exact simulation, algebra."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.models.controllers import PD, PID, Controller
from jointid.models.robots.robot import RobotLoop
from jointid.records.chunks import cut
from jointid.records.record import Channel, Record
from jointid.simulation.kernels import FREE, LENGTH, STATE
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import Outcome, Run, motion_at, run_loop
from jointid.simulation.synthesis import add_feed_forward, simulate
from tests.robots_plants import Twin, seven, six, two, with_springs
from tests.simulation.reference import of_loop


def changed(twin: Twin, *joints: dict[str, Any]) -> Twin:
    """Return a twin with other numbers of its joints."""
    made = tuple(replace(joint, **own) for joint, own in zip(twin.robot.joints, joints, strict=True))
    return replace(twin, robot=replace(twin.robot, joints=made))


COUPLED: tuple[dict[str, Any], ...] = ({}, {"coupling": {"joint1": -0.4}})
# What a motor's friction rises by towards standstill, and below which speed.
RISING: tuple[dict[str, Any], ...] = (
    {"stribeck_force": 2.0, "stribeck_speed": 0.1},
    {"stribeck_force": 0.8, "stribeck_speed": 0.05},
)
ONE_WAY: tuple[dict[str, Any], ...] = ({"viscous_backwards": 6.0, "coulomb_backwards": 2.5}, {"viscous_backwards": 0.5})
TWINS = {
    "six joints, some flexible": (six((True, True, False, False, True, False)), 0.3),
    "two motors coupled": (changed(two(), *COUPLED), 1.0),
    "coupled and flexible": (changed(two((12.0, 18.0)), *COUPLED), 0.8),
}


def faster(records: tuple[Record, ...], times: float) -> tuple[Record, ...]:
    """Return references played back faster, so that a short record has reversals and stops."""
    made = []
    for record in records:
        values = record.reference.values
        at = np.minimum(np.arange(round(values.size / times)) * times, values.size - 1)
        played = np.interp(at, np.arange(values.size), values)
        made.append(replace(record, reference=replace(record.reference, values=played)))
    return tuple(made)


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_error_and_order_against_an_adaptive_reference_with_the_same_events(name: str) -> None:
    """At 1 ms below 1e-4 of the torque's peak, as promised, and falling with the fourth power of the step.

    Laws of friction are compared with those of one joint in `test_robot_laws`.
    """
    twin, duration = TWINS[name]
    loop = twin.loop()
    records = faster(twin.records(5.0 * duration), 8.0)
    experiment, numbers = prepare(loop, records), Numbers.of(loop.robot)
    exact = of_loop(experiment, numbers)[0].T
    peak = np.max(np.abs(exact), axis=0)
    runs = {steps: run_loop(experiment, numbers, steps=steps) for steps in (1, 2, 4)}
    errors = {steps: float(np.max(np.abs(run.command.T - exact) / peak)) for steps, run in runs.items()}
    assert runs[1].events > 5
    assert errors[1] < 1e-4
    assert errors[4] < 1e-7
    floor = 1e-12  # of rounding, and of the events' tolerances
    assert errors[2] < errors[1] / 12 + floor
    assert errors[4] < errors[2] / 12 + floor


def test_a_joint_at_rest_stays_where_it_is_while_the_others_move() -> None:
    twin = six()
    records = list(twin.records(3.0))
    for j in (1, 4):
        held = records[j].reference
        records[j] = Record(reference=Channel(np.full(len(held), held.values[0]), "rad", 1e-3))
    loop = twin.loop()
    # Friction large enough for what the other joints do to these two.
    numbers = Numbers.of(loop.robot)
    run = simulate(loop, records, numbers.with_values([Place(1, "coulomb"), Place(4, "coulomb")], [80.0, 80.0]))
    assert run.outcome is Outcome.FINISHED
    assert np.all(run.load_position[:, [1, 4]] == run.load_position[0, [1, 4]])
    assert np.all(run.motion.direction[:, [1, 4]] == 0)
    assert np.ptp(run.load_position[:, [0, 2, 3, 5]], axis=0).min() > 0.2


def test_no_mass_slides_against_its_friction() -> None:
    """Where several events lie in one step, the earliest is taken, however they seemed from the ends of the step."""
    twin = six(True)
    records = twin.records(10.0, sample_time=5e-3, multisine=0.003)
    run = run_loop(prepare(twin.loop(4.0), records), Numbers.of(twin.robot), keep=True, steps=1)
    assert run.outcome is Outcome.FINISHED
    assert run.events > 500
    n = run.numbers.count
    speeds, modes = (run.tape[:, STATE + i * n : STATE + (i + 1) * n] for i in (1, 4))
    assert np.min(speeds * np.where(modes == FREE, 0.0, modes)) >= 0.0
    assert np.all(run.tape[1:, LENGTH] > 0.0)


def held_against_the_reference(loop: RobotLoop, records: tuple[Record, ...], worst: float) -> Run:
    """Return a run at one step a part, of which the torque is that near to the adaptive reference's, of its peak."""
    experiment, numbers = prepare(loop, records), Numbers.of(loop.robot)
    exact = of_loop(experiment, numbers)[0].T
    run = run_loop(experiment, numbers, steps=1, keep=True)
    assert run.outcome is Outcome.FINISHED
    assert np.max(np.abs(run.command.T - exact) / np.max(np.abs(exact), axis=0)) < worst
    return run


APART = (1e-3, 3e-3), (4e-4, 1.3e-3)  # periods and delays of two controllers


def apart(twin: Twin) -> tuple[Controller, ...]:
    each = zip(twin.loop().controllers, *APART, strict=True)
    return tuple(replace(law, period=period, delay=delay) for law, period, delay in each)  # type: ignore[type-var]


@pytest.mark.slow
def test_controllers_of_other_periods_and_delays() -> None:
    """The second controller acts every third period of the first, whose torque comes late; the log is slower still."""
    twin = two((None, 16.0))
    laws = apart(twin)
    records = faster(twin.records(6.0), 6.0)
    slow = [replace(one, reference=replace(one.reference, sample_time=1e-3)) for one in records if one.reference]
    run = held_against_the_reference(RobotLoop(twin.robot, laws), tuple(slow), 1e-4)
    assert run.events > 5
    assert run.experiment.clock.every.tolist() == [1, 3]
    assert run.experiment.clock.lengths == pytest.approx([3e-4, 1e-4, 6e-4])
    assert run.torque.shape == (999, 2)
    assert np.array_equal(run.torque[3:6, 1], np.repeat(run.torque[3, 1], 3))


def test_a_torque_begins_to_act_a_delay_after_its_controller_s_instant() -> None:
    """The log shows the torque that was put out last, which a slow controller did some samples before."""
    twin = two()
    clock = prepare(RobotLoop(twin.robot, apart(twin)), twin.records(0.1)).clock
    at = clock.sample_time * np.arange(clock.samples)
    begins = np.cumsum(clock.lengths) - clock.lengths
    for begun, period, delay in zip(clock.torque_index, *APART, strict=True):
        step, part = np.divmod(begun, clock.lengths.size)
        expected = np.floor(at / period + 1e-6) * period + delay
        acts = step * np.sum(clock.lengths) + begins[part]
        np.testing.assert_allclose(acts[:-3], expected[:-3], rtol=0, atol=1e-9)  # what is in the record


@pytest.mark.slow
@pytest.mark.parametrize("twin", [two(), TWINS["coupled and flexible"][0]], ids=["rigid", "flexible"])
def test_a_record_that_begins_while_the_robot_moves(twin: Twin) -> None:
    """It moves on as its references do: another start is another motion for as long as the loop remembers."""
    whole = twin.records(6.0)
    late = tuple(cut(one, 2500, 2900) for one in whole)
    run = held_against_the_reference(replace(twin.loop(), in_motion=True), late, 1e-4)
    assert np.min(np.abs(motion_at(run, np.zeros(1, np.int64)).velocity)) > 0.05
    uncut = simulate(twin.loop(), whole).torque[2500:2900]
    from_rest = simulate(twin.loop(), late).torque
    wrong = [float(np.max(np.abs(torque - uncut))) for torque in (run.torque, from_rest)]
    assert wrong[0] < 0.1 * wrong[1]


@pytest.mark.parametrize("twin", [six(), seven(), seven(flexible=True)], ids=["six", "seven", "seven flexible"])
def test_a_robot_begins_where_its_controllers_hold_its_weight(twin: Twin) -> None:
    records = tuple(Record(reference=Channel(np.full(300, q), "rad", 1e-3)) for q in twin.home)
    loop = twin.loop()
    numbers = Numbers.of(loop.robot)
    friction = [Place(i, f"{side}coulomb") for i, side in numbers.sides]
    run = simulate(loop, records, numbers.with_values(friction, np.zeros(len(friction))))  # the controllers hold it
    assert np.max(np.abs(run.motor_velocity)) < 1e-9
    assert np.ptp(run.torque, axis=0).max() < 1e-8


def test_integrators_hold_the_weight_on_the_reference() -> None:
    twin = two()
    laws = tuple(PID(position_gain=800.0, derivative_gain=40.0, integral_gain=2000.0) for _ in range(2))
    records = tuple(Record(reference=Channel(np.full(300, q), "rad", 1e-3)) for q in twin.home)
    run = simulate(RobotLoop(twin.robot, laws), records)
    assert np.all(run.motor_position == twin.home)


@pytest.mark.parametrize("twin", [six(), changed(two(), {}, {"coupling": {"joint1": -2.0}})], ids=["six", "coupled"])
def test_a_feed_forward_of_the_inverse_model_tracks_better(twin: Twin) -> None:
    loop, records = twin.loop(), twin.records(3.0)
    assisted = add_feed_forward(loop, records)
    lag = []
    for driven in (records, assisted):
        run = simulate(loop, driven)
        references = np.column_stack([r.reference.values for r in records if r.reference])
        lag.append(float(np.sqrt(np.mean((references - run.motor_position) ** 2))))
    assert lag[1] < 0.5 * lag[0]  # what is left is of Coulomb friction


def test_outcomes() -> None:
    twin = two()
    loop, records = twin.loop(), twin.records(1.0)
    numbers = Numbers.of(loop.robot)

    def outcome(loop: RobotLoop, numbers: Numbers | None = None) -> Outcome:
        return simulate(loop, records, numbers).outcome

    assert outcome(loop) is Outcome.FINISHED
    assert outcome(loop, numbers.with_values([Place(1, "Iyy")], [-3.0])) is Outcome.NOT_POSITIVE
    for name, value in (("viscous", -0.1), ("coulomb", -0.1), ("inertia", np.nan)):
        assert outcome(loop, numbers.with_values([Place(1, name)], [value])) is Outcome.INVALID
    wild = RobotLoop(twin.robot, tuple(PD(position_gain=1e6, derivative_gain=0.0) for _ in range(2)))
    run = simulate(wild, records)
    assert run.outcome is Outcome.DIVERGED
    assert np.all(np.isfinite(run.torque))
    assert simulate(loop, records, steps=65).outcome is Outcome.FINISHED  # as many as are asked for
    stiff = Numbers.of(two((None, 16.0)).robot)
    assert outcome(loop, with_springs(stiff, 1e8)) is Outcome.TOO_STIFF
