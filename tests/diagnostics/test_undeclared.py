"""Intervals beside a filter that the drive has and its controller does not declare, of joints and robots."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.controller import FirstOrder
from jointid.diagnostics.axis_torques import torques_of_loop
from jointid.diagnostics.identify import expect_size, list_undeclared, widen_for_undeclared
from jointid.diagnostics.suspects import FAULTS
from jointid.estimation.identify import fit
from jointid.records.record import Tap
from jointid.simulation.derivatives import respond_to_laws
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import run_loop
from tests.estimates import faults_of
from tests.robots_plants import two

LAW = ji.controller.Cascade(position_gain=40.0, velocity_gain=3.0, period=1.25e-4)
JOINT = ji.FlexibleJoint("revolute")
TRUE = {
    "motor_inertia": 0.012, "motor_viscous": 0.2, "motor_coulomb": 0.25, "stiffness": 900.0, "damping": 0.25,
    "load_inertia": 0.03, "load_viscous": 0.5, "load_coulomb": 0.35, "offset": 0.05,
}  # fmt: skip
DECLARED = {"velocity_filter": (0.5, 0.5), "torque_filters": (FirstOrder(2e-4),), "delay": 1.25e-4}
LOSSY = ji.ClosedLoop(replace(JOINT, friction=ji.friction.Friction("load-dependent")), replace(LAW, **DECLARED))
LOSS = SimpleNamespace(test=SimpleNamespace(fault=FAULTS["load_dependent_friction"], alike=()))


def logged(hidden=0.0, seed=0, noise=0.03, given=None, truth=TRUE):
    """Return the log of the axis, with noise, under a cascade with a velocity filter of `hidden` s, or of another."""
    reference = ji.excitation.trapezoids((0.5, 1.0, 2.0), 20.0, 1.0, 1e-3, duration=4.0)
    pulses = ji.excitation.pulses(reference.size, 1e-3, height=6.0, width=0.01, every=0.2, seed=0)
    loop = ji.ClosedLoop(JOINT, replace(LAW, velocity_filter=FirstOrder(hidden) if hidden else (1.0,)))
    known = None if given else pulses
    record = ji.simulated_record(given or loop, reference, truth, sample_time=1e-3, injected=known)
    noise = noise * np.std(record.torque.values) * np.random.default_rng(seed).standard_normal(reference.size)
    torque = replace(record.torque, values=record.torque.values + noise)
    return replace(record, torque=torque, motor_position=None, load_position=None)


def widened(record, law=LAW, *suspected):
    """Return error, deviation, and the widened one of each parameter of the axis, and the widening."""
    found = fit(record, ji.ClosedLoop(JOINT, law), ji.DIDIM(frequency=50.0))
    axis = SimpleNamespace(faults=SimpleNamespace(findings=(), suspected=suspected))
    diagnosis = SimpleNamespace(torques=torques_of_loop(found.problem, found.x), axes=[axis])
    wider, rows = [*widen_for_undeclared(found, diagnosis)], {row.name: row for row in found.rows if row.name in TRUE}
    moved = {name: max((abs(by[name]) for by, _ in wider), default=0.0) for name in rows}
    return {
        name: (abs(row.value - TRUE[name]), row.stderr, np.hypot(row.stderr, moved[name])) for name, row in rows.items()
    }, wider


@pytest.mark.slow
def test_an_interval_holds_a_spring_that_is_hardly_seen_not_to_be_linear():
    declared = ji.ClosedLoop(JOINT, replace(LAW, undeclared="none", period=None))
    cubic = replace(declared, joint=replace(JOINT, spring=ji.spring.Spring("cubic")))
    row = ji.identify(logged(0.0, 4, 0.02, cubic, TRUE | {"cubic_stiffness": 4.46e8}), declared)["stiffness"]
    assert abs(row.value - TRUE["stiffness"]) < 2 * row.deviation


@pytest.mark.slow
@pytest.mark.parametrize(("log", "law", "what"), [
    (lambda: logged(0.5e-3), LAW, "velocity filter of up to"),
    (lambda: logged(0.0, 0, 0.005, LOSSY, TRUE | {"load_friction_per_torque": 0.1}), LOSSY.controller, "load's torque"),
])  # fmt: skip
def test_intervals_hold_what_a_hidden_filter_and_a_loss_of_the_gear_move(log, law, what, monkeypatch):
    found, wider = widened(record := log(), law)
    assert max(error / std for error, std, _ in found.values()) > 3
    assert all(error < 2 * wide for error, _, wide in found.values())
    assert any(what in one and "coulomb by" in one for _, one in wider)
    assert widened(record, replace(law, undeclared="none"))[1] == []
    assert widened(record, law, LOSS)[1] == (without := [one for one in wider if "load's torque" not in one[1]])
    monkeypatch.setattr("jointid.diagnostics.identify.Friction", Mock(side_effect=ji.JointidError("")))
    assert widened(record, law)[1] == without


@pytest.mark.parametrize(("size", "std", "expected"), [  # those between by integration over all sizes
    (0.0, 1e4, 0.5), (3.0, 0.01, 1.0), (-0.3, 0.1, 0.035), (0.1, 0.05, 0.0649), (0.3, 0.1, 0.2977), (0.2, 0.0, 0.2),
])  # fmt: skip
def test_an_element_is_as_large_as_the_record_shows_it_and_as_likely_as_none_without_one(size, std, expected):
    assert expect_size(size, std, 0.5) == pytest.approx(expected, rel=0.01)


def test_what_the_record_excludes_widens_nothing():
    assert all(wide < 1.3 * std for _, std, wide in widened(logged())[0].values())


def test_a_signal_that_is_added_to_the_output_is_as_late_as_that():
    problem = fit(record := logged(), ji.ClosedLoop(JOINT, LAW), ji.DIDIM(frequency=50.0)).problem
    x, late = problem.vector(TRUE), replace(LAW, delay=6e-5)
    (run,), (own,) = problem.run(x), problem.log.experiment.axes
    changed = problem.under(late, record).torque(x) - problem.torque(x)
    (found,), _ = respond_to_laws(run, [(0, replace(own, law=own.law_of(late)))])
    assert np.linalg.norm(problem.filter(found[:, 0] - changed)) < 0.2 * np.linalg.norm(problem.filter(changed))


@pytest.mark.slow
def test_an_injected_signal_of_another_size_is_named():
    record = logged()
    channel = replace(record.injected.channel, values=1.1 * record.injected.channel.values)
    wrong = replace(record, injected=replace(record.injected, channel=channel))
    estimate = ji.identify(wrong, ji.ClosedLoop(JOINT, LAW), ji.DIDIM(frequency=50.0), checks=False)
    (found,) = faults_of(estimate, wrong, most=1).findings
    assert found.test.name == "injected_gain"
    assert 1.1 * (1.0 + found.test.size) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("name", DECLARED)
def test_what_is_declared_is_not_tried(name):
    names = {fault.name for fault, *_ in list_undeclared(replace(LAW, **{name: DECLARED[name]}), 1e-3)}
    assert names == {"velocity_filter", "torque_filter", "delay"} - {name.replace("filters", "filter")}


@pytest.mark.parametrize(
    "other", [{"velocity_filter": FirstOrder(4e-4)}, {"torque_filters": (FirstOrder(4e-4),)}, {"delay": 5e-5}]
)
@pytest.mark.parametrize(("tap", "period"), [*((one, 0.0) for one in Tap), (Tap.COMMAND, 2e-3)])
def test_a_robot_responds_to_another_law_as_its_simulation_does(other, tap, period):
    twin = two()
    driven = [replace(one, tap=tap) for one in twin.records(1.5)]
    first, second = twin.loop().controllers
    loop = replace(twin.loop(), controllers=(first, replace(second, period=period or second.period)))
    experiment, numbers = prepare(loop, driven), Numbers.of(twin.robot)
    run = run_loop(experiment, numbers, keep=True)
    for joint, own in enumerate(experiment.axes):
        law = replace(loop.controllers[joint], **other)
        laws = [law if k == joint else one for k, one in enumerate(loop.controllers)]
        changed = run_loop(prepare(replace(loop, controllers=tuple(laws)), driven), numbers).torque - run.torque
        found, (direct,) = respond_to_laws(run, [(joint, replace(own, law=own.law_of(law)))])
        found = np.column_stack(found)
        found[:, joint] += direct
        least = 0.2 if period else 0.1  # what is held longer hunts about its rest
        assert np.all(np.linalg.norm(found - changed, axis=0) < least * np.linalg.norm(changed, axis=0))


@pytest.mark.slow
def test_intervals_of_a_robot_allow_for_a_hidden_filter():
    twin, draw, logs = two(), np.random.default_rng(0), {}
    first, second = twin.loop().controllers
    driven = twin.records(6.0)
    for hidden in (0.0, 1e-3):
        laws = first, replace(second, velocity_filter=FirstOrder(hidden) if hidden else (1.0,))
        made = ji.simulate(ji.robots.RobotLoop(twin.robot, laws), driven).records(driven)
        noise = [0.01 * np.std(one.torque.values) * draw.standard_normal(one.torque.values.size) for one in made]
        logs[hidden] = tuple(
            replace(one, torque=replace(one.torque, values=one.torque.values + more), motor_position=None)
            for one, more in zip(made, noise, strict=True)
        )
    plain, found = (ji.identify(one, twin.loop(), ji.DIDIM()) for one in logs.values())
    assert not any("undeclared" in one for one in plain.warnings)
    assert any("undeclared" in one and "velocity filter" in one for one in found.warnings)
    wider = {row.name: row.deviation / row.stderr for row in found.rows if row.stderr}
    assert wider["joint2.viscous"] > 1.2 > wider["joint1.coulomb"]
