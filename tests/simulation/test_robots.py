"""A robot in its loops: against an adaptive integrator with the same events, one joint's exact simulation, algebra."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel
from jointid.models.controllers import PD, PID, Cascade, Controller
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint, Tree
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import Initial, Outcome
from jointid.simulation.kernels.engine import (
    COULOMB,
    COULOMB_BACK,
    FREE,
    HIGH,
    LENGTH,
    SPRING,
    STATE,
    accelerate,
    settle,
)
from jointid.simulation.loop_input import prepare
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import RobotLoop, RobotRun, add_feed_forward, begin, motion_at, prepare_robot, run_robot
from jointid.simulation.synthesis import simulate
from tests.robots_plants import Twin, inertial, serial, seven, six, two
from tests.simulation.robot_oracle import simulate_pd


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
        assert record.reference is not None
        values = record.reference.values
        at = np.minimum(np.arange(round(values.size / times)) * times, values.size - 1)
        played = np.interp(at, np.arange(values.size), values)
        made.append(replace(record, reference=replace(record.reference, values=played)))
    return tuple(made)


@pytest.mark.parametrize(
    "name", [name if "six" in name else pytest.param(name, marks=pytest.mark.slow) for name in TWINS]
)
def test_error_and_order_against_an_adaptive_reference_with_the_same_events(name: str) -> None:
    """At 1 ms below 1e-4 of the torque's peak, as promised, and falling with the fourth power of the step.

    Laws of friction are compared with those of one joint in `test_robot_laws`.
    """
    twin, duration = TWINS[name]
    loop = twin.loop()
    records = faster(twin.records(5.0 * duration), 8.0)
    experiment, numbers = prepare_robot(loop, records), RobotNumbers.of(loop.robot)
    gains = np.array([[c.position_gain, c.derivative_gain] for c in loop.controllers])  # type: ignore[attr-defined]
    start = begin(experiment, numbers).places
    exact, _ = simulate_pd(experiment.tree, numbers, gains, experiment.references, 1e-3, start)
    peak = np.max(np.abs(exact), axis=0)
    runs = {steps: run_robot(experiment, numbers, steps=steps) for steps in (1, 2, 4)}
    errors = {steps: float(np.max(np.abs(run.command.T - exact) / peak)) for steps, run in runs.items()}
    assert runs[1].events > 5
    assert errors[1] < 1e-4
    assert errors[4] < 1e-7
    floor = 1e-12  # of rounding, and of the events' tolerances
    assert errors[2] < errors[1] / 12 + floor
    assert errors[4] < errors[2] / 12 + floor


def single(flexible: bool) -> tuple[Robot, dict[str, float]]:
    """Return a joint as a robot of one about an upright axis, and as a joint's values."""
    spring = JointSpring(900.0, 1.5, 0.6, 0.9) if flexible else None
    body = inertial(2.0, (0.1, 0.0, 0.0), (0.02, 0.02, 0.08))
    joint = RobotJoint("one", 0.3, 1.1, 1.7, spring=spring)
    robot = serial([(0.0, 0.0, 1.0)], [(0.0, 0.0, 0.0)], [np.eye(3)], [body], [joint])
    if not flexible:
        return robot, {"inertia": 0.4, "viscous": 1.1, "coulomb": 1.7, "offset": 0.0}
    motor = {"motor_inertia": 0.3, "motor_viscous": 1.1, "motor_coulomb": 1.7, "stiffness": 900.0, "damping": 1.5}
    return robot, motor | {"load_inertia": 0.1, "load_viscous": 0.6, "load_coulomb": 0.9, "offset": 0.0}


LAWS: dict[str, Controller] = {
    "PD": PD(position_gain=600.0, derivative_gain=30.0),
    "PID at its limit": PID(position_gain=600.0, derivative_gain=30.0, integral_gain=900.0, limit=9.0),
    "cascade of two rates, late": Cascade(
        position_gain=20.0, velocity_gain=20.0, integral_gain=8.0, position_period=4e-3, delay=1.3e-3
    ),
}


@pytest.mark.parametrize("flexible", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_a_robot_of_one_joint_is_that_joint(name: str, flexible: bool) -> None:
    robot, values = single(flexible)
    t = np.arange(1500) * 1e-3
    x = np.clip(t / 0.3, 0, 1)
    # A rest, so that the joint sticks: at the beginning, and in the middle.
    reference = 0.6 * np.sin(2 * np.pi * 1.5 * np.minimum(t, 0.9)) * x**3 * (10 - 15 * x + 6 * x * x)
    record = Record(reference=Channel(reference, "rad", 1e-3))
    joint = FlexibleJoint("revolute") if flexible else RigidJoint("revolute")
    loop = ClosedLoop(joint, LAWS[name])
    found = simulate(RobotLoop(robot, (LAWS[name],)), [record], steps=8)
    begun = Initial(float(found.motor_position[0, 0]), 0.0, 0.0)
    exact = simulate(loop, prepare(loop, record), values, begun)
    peak = float(np.max(np.abs(exact.torque)))
    assert found.outcome is Outcome.FINISHED
    assert np.max(np.abs(found.torque[:, 0] - exact.torque)) < 2e-8 * peak
    assert np.max(np.abs(found.motor_position[:, 0] - exact.motor_position)) < 1e-9
    assert found.events == exact.events
    accelerations = exact.motor.acceleration, found.motion.acceleration[:, -1]
    assert accelerations[0][:-2] == pytest.approx(accelerations[1][:-2], abs=1e-5 * peak / 0.3)


def test_a_joint_at_rest_stays_where_it_is_while_the_others_move() -> None:
    twin = six()
    records = list(twin.records(3.0))
    for j in (1, 4):
        held = records[j].reference
        assert held is not None
        records[j] = Record(reference=Channel(np.full(len(held), held.values[0]), "rad", 1e-3))
    loop = twin.loop()
    # Friction large enough for what the other joints do to these two.
    numbers = RobotNumbers.of(loop.robot)
    masses = numbers.masses.copy()
    masses[[1, 4], 2] = 80.0
    run = simulate(loop, records, replace(numbers, masses=masses))
    assert run.outcome is Outcome.FINISHED
    assert np.all(run.link_position[:, [1, 4]] == run.link_position[0, [1, 4]])
    assert np.all(run.motion.direction[:, [1, 4]] == 0)
    assert np.ptp(run.link_position[:, [0, 2, 3, 5]], axis=0).min() > 0.2


def test_no_mass_slides_against_its_friction() -> None:
    """Where several events lie in one step, the earliest is taken, however they seemed from the ends of the step."""
    twin = six(True)
    records = twin.records(10.0, sample_time=5e-3, multisine=0.003)
    run = run_robot(prepare_robot(twin.loop(4.0), records), RobotNumbers.of(twin.robot), keep=True, steps=1)
    assert run.outcome is Outcome.FINISHED
    assert run.events > 500
    n = len(run.start)
    speeds, modes = (run.tape[:, STATE + i * n : STATE + (i + 1) * n] for i in (1, 4))
    assert np.min(speeds * np.where(modes == FREE, 0.0, modes)) >= 0.0
    assert np.all(run.tape[1:, LENGTH] > 0.0)


def held_against_the_reference(loop: RobotLoop, records: tuple[Record, ...], worst: float) -> RobotRun:
    """Return a run at one step a part, of which the torque is that near to the adaptive reference's, of its peak."""
    experiment, numbers = prepare_robot(loop, records), RobotNumbers.of(loop.robot)
    gains = np.array([[c.position_gain, c.derivative_gain] for c in loop.controllers])  # type: ignore[attr-defined]
    began, clock = begin(experiment, numbers), experiment.clock
    exact, _ = simulate_pd(
        experiment.tree, numbers, gains, experiment.references, float(np.sum(clock.lengths)), began.places,
        began.speeds, tuple(clock.every.tolist()), tuple(each.law.delay for each in experiment.experiments),
    )  # fmt: skip
    run = run_robot(experiment, numbers, steps=1, keep=True)
    assert run.outcome is Outcome.FINISHED
    assert np.max(np.abs(run.command.T - exact) / np.max(np.abs(exact), axis=0)) < worst
    return run


@pytest.mark.slow
def test_controllers_of_other_periods_and_delays() -> None:
    """The second controller acts every third period of the first, whose torque comes late; the log is slower still."""
    twin = two((None, 16.0))
    laws = tuple(
        replace(law, period=period, delay=delay)  # type: ignore[type-var]
        for law, period, delay in zip(twin.loop().controllers, (1e-3, 3e-3), (4e-4, 1.3e-3), strict=True)
    )
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
    twin, periods, delays = two(), (1e-3, 3e-3), (4e-4, 1.3e-3)
    laws = tuple(
        replace(law, period=period, delay=delay)  # type: ignore[type-var]
        for law, period, delay in zip(twin.loop().controllers, periods, delays, strict=True)
    )
    clock = prepare_robot(RobotLoop(twin.robot, laws), twin.records(0.1)).clock
    at = clock.sample_time * np.arange(clock.samples)
    begins = np.cumsum(clock.lengths) - clock.lengths
    for begun, period, delay in zip(clock.torque_index, periods, delays, strict=True):
        step, part = np.divmod(begun, clock.lengths.size)
        expected = np.floor(at / period + 1e-6) * period + delay
        acts = step * np.sum(clock.lengths) + begins[part]
        np.testing.assert_allclose(acts[:-3], expected[:-3], rtol=0, atol=1e-9)  # what is in the record


@pytest.mark.slow
@pytest.mark.parametrize("twin", [two(), TWINS["coupled and flexible"][0]], ids=["rigid", "flexible"])
def test_a_record_that_begins_while_the_robot_moves(twin: Twin) -> None:
    """It moves on as its references do: another start is another motion for as long as the loop remembers."""
    whole = twin.records(6.0)
    late = tuple(
        replace(one, reference=replace(one.reference, values=one.reference.values[2500:2900]))
        for one in whole
        if one.reference
    )
    run = held_against_the_reference(replace(twin.loop(), in_motion=True), late, 1e-4)
    assert np.min(np.abs(motion_at(run, np.zeros(1, np.int64)).velocity)) > 0.05
    uncut = simulate(twin.loop(), whole).torque[2500:2900]
    from_rest = simulate(twin.loop(), late).torque
    wrong = [float(np.max(np.abs(torque - uncut))) for torque in (run.torque, from_rest)]
    assert wrong[0] < 0.1 * wrong[1]


def brute_force(M: FloatArray, force: FloatArray, coulomb: FloatArray) -> FloatArray:
    """Return the accelerations from rest that are consistent with friction, by trying all modes."""
    best, least = np.zeros(force.size), 0.0
    for choice in itertools.product((0.0, 1.0, -1.0), repeat=force.size):
        modes = np.array(choice)
        free, a = modes != 0, np.zeros(force.size)
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (force - modes * coulomb)[free])
        value = 0.5 * a @ M @ a - force @ a + coulomb @ np.abs(a)
        if value < least:
            best, least = a, value
    return best


@compile_kernel
def settled(
    tree: Tree, M: FloatArray, force: FloatArray, coulomb: FloatArray, modes: FloatArray, a: FloatArray
) -> None:
    """Fill the accelerations of links that stand still, as the engine does."""
    n = len(M)
    mass, spring, none, still = np.zeros((n, HIGH + 1)), np.zeros((0, SPRING)), np.zeros((0, 5)), np.zeros(n)
    pairs, carriers = np.zeros((0, 2), dtype=np.uint64), np.full(n, -1)
    held, grip, L = np.zeros(n), np.zeros(n), np.zeros((n, n))
    mass[:, COULOMB] = coulomb
    mass[:, COULOMB_BACK] = coulomb
    for _ in range(1000):
        accelerate(
            mass, spring, none, pairs, carriers, tree, M, L, still, still, modes, force, 0.0, still, still,
            still, a, held, grip, still[:0],
        )  # fmt: skip
        if not settle(mass, modes, still, a, held, grip, True):
            break


def test_masses_that_stand_still_are_decided_together() -> None:
    rng, n = np.random.default_rng(3), 4
    rested = slid = 0
    for _ in range(200):
        root = rng.normal(size=(n, n))
        M, force, coulomb = root @ root.T + 0.05 * np.eye(n), 3 * rng.normal(size=n), rng.uniform(0.2, 3.0, n)
        modes, a = rng.choice([-1.0, 0.0, 1.0], n), np.empty(n)
        settled(six().robot.tree, M, force, coulomb, modes, a)
        assert a == pytest.approx(brute_force(M, force, coulomb), abs=1e-9)
        rested, slid = rested + int(np.sum(modes == 0)), slid + int(np.sum(modes != 0))
    assert rested > 100
    assert slid > 100


@pytest.mark.parametrize("twin", [six(), seven(), seven(flexible=True)], ids=["six", "seven", "seven flexible"])
def test_a_robot_begins_where_its_controllers_hold_its_weight(twin: Twin) -> None:
    records = tuple(Record(reference=Channel(np.full(300, q), "rad", 1e-3)) for q in twin.home)
    loop = twin.loop()
    numbers = RobotNumbers.of(loop.robot)
    masses = numbers.masses.copy()
    masses[:, 2] = 0.0  # nothing but the controllers hold it
    run = simulate(loop, records, replace(numbers, masses=masses))
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
    numbers = RobotNumbers.of(loop.robot)

    def outcome(loop: RobotLoop, numbers: RobotNumbers | None = None) -> Outcome:
        return simulate(loop, records, numbers).outcome

    assert outcome(loop) is Outcome.FINISHED
    negative = numbers.inertials.copy()
    negative[1, 7] = -3.0
    assert outcome(loop, replace(numbers, inertials=negative)) is Outcome.NOT_POSITIVE
    for column, value in ((1, -0.1), (2, -0.1), (0, np.nan)):
        masses = numbers.masses.copy()
        masses[1, column] = value
        assert outcome(loop, replace(numbers, masses=masses)) is Outcome.INVALID
    wild = RobotLoop(twin.robot, tuple(PD(position_gain=1e6, derivative_gain=0.0) for _ in range(2)))
    run = simulate(wild, records)
    assert run.outcome is Outcome.DIVERGED
    assert np.all(np.isfinite(run.torque))
    assert simulate(loop, records, steps=65).outcome is Outcome.FINISHED  # as many as are asked for
    stiff = RobotNumbers.of(two((None, 16.0)).robot)
    assert outcome(loop, replace(stiff, springs=1e8 * stiff.springs)) is Outcome.TOO_STIFF
