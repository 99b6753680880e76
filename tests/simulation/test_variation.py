"""Derivatives of simulations with smooth laws, against differences of runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.simulation.closed_loop import Initial, simulate
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import Case, prismatic, rotary
from tests.simulation.differences import error_beside_differences
from tests.smooth_laws import LAWS, with_law

_STEP = 3e-6


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("make", [prismatic, pytest.param(rotary, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_differences_of_runs(make: Callable[[int], Case], law: str) -> None:
    case = make(1)
    loop, values = with_law(case, law)
    experiment = prepare(loop, case.clean)
    speed = 0.2 * float(np.ptp(simulate(case.loop, experiment, case.truth).motor_velocity))
    begin = Initial(position=float(experiment.inputs[0, 0]), velocity=speed, wound_up=1.0)
    own = [p.name for p in loop.joint.parameters]
    of_law = [name for name, value in numbers_of(loop.controller).items() if value and np.isfinite(value)]
    names = [*own, "initial_position", "initial_velocity", *of_law]
    found = simulate_sensitivities(loop, experiment, values, names, begin, positions=True)
    columns = found.torque, found.motor_position, found.load_position
    for i, name in enumerate(names):
        now = values.get(name) or numbers_of(loop.controller).get(name) or speed
        step = _STEP * (abs(now) or 1e-3)
        own = tuple(column[:, i] for column in columns)
        assert error_beside_differences(own, loop, case.clean, values, name, (step,), begin) <= 5e-3, name


@pytest.mark.parametrize("law", ["load-dependent", "asymmetric-load-dependent", "presliding-load-dependent"])
def test_friction_that_follows_the_torque_of_a_rigid_joint_has_derivatives(law: str) -> None:
    case = prismatic(1)
    joint = RigidJoint("prismatic", FRICTIONS[law]())
    loop = ClosedLoop(joint, with_numbers(case.loop.controller, {"delay": 1.5e-4}))
    sides = {name.removeprefix("motor_"): value for name, value in case.truth.items()}
    values = {p.name: sides.get(p.name, sides.get(p.name.rpartition("_")[0], 0.15)) for p in joint.parameters}
    values |= {"presliding_distance": 1e-3} if law.startswith("presliding") else {}
    experiment, names = prepare(loop, case.clean), [*values, "position_gain", "delay"]
    found = simulate_sensitivities(loop, experiment, values, names)
    for i, name in enumerate(names):
        step = _STEP * (abs(values.get(name) or numbers_of(loop.controller)[name]))
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error <= 2e-3, name


def test_a_delay_moves_no_edge_of_a_torque_that_goes_on() -> None:
    case = prismatic(1)
    controller = with_numbers(case.loop.controller, {"integral_gain": 5.0})
    plain = replace(case.loop, controller=controller)
    drifting, values = with_law(replace(case, loop=plain), "drifting")
    values = {name: value if name in case.truth else 0.0 for name, value in values.items()}
    begin = Initial(velocity=0.1, torque=71.7)
    exact, found = (
        simulate_sensitivities(loop, prepare(loop, case.clean), values, ["delay"], begin).torque
        for loop in (plain, drifting)
    )
    assert np.linalg.norm(found - exact) <= 1e-5 * np.linalg.norm(exact)


def test_a_slider_without_stiffness_has_a_derivative_by_it() -> None:
    case = prismatic(1)
    loop, values = with_law(case, "hysteretic")
    experiment, name, columns = prepare(loop, case.clean), "hysteresis_stiffness", []
    for stiffness in (0.0, 1e-5 * values["stiffness"]):
        columns.append(simulate_sensitivities(loop, experiment, values | {name: stiffness}, [name]).torque)
    assert np.linalg.norm(columns[1] - columns[0]) <= 1e-3 * np.linalg.norm(columns[1])


@pytest.mark.parametrize("share", [1e-4, 1e-5])
def test_friction_that_winds_up_within_a_sample_is_followed(share: float) -> None:
    case = prismatic(1)
    loop, values = with_law(case, "presliding")
    experiment = prepare(loop, case.clean)
    length = share * float(np.ptp(case.clean.reference.values))  # type: ignore[union-attr]
    values = values | {"motor_presliding_distance": length, "load_presliding_distance": 0.7 * length}
    found = simulate_sensitivities(loop, experiment, values, list(values))
    for i, name in enumerate(values):
        step = _STEP * (abs(values[name]) or 1e-3)
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error <= 5e-3, name


@pytest.mark.parametrize("law", ["none", "drifting"])
@pytest.mark.parametrize("make", [prismatic, rotary])
def test_a_limit_that_acts_and_a_delay_are_followed(make: Callable[[int], Case], law: str) -> None:
    case = make(1)
    loop, values = with_law(case, law) if law != "none" else (case.loop, case.truth)
    peak = float(np.abs(simulate(loop, prepare(loop, case.clean), values).torque).max())
    gain = numbers_of(loop.controller)["gain"]
    controller = with_numbers(loop.controller, {"limit": 0.65 * peak / gain, "delay": 1.5e-4})
    loop = replace(loop, controller=controller)
    experiment = prepare(loop, case.clean)
    run = simulate(loop, experiment, values)
    assert run.at_limit > 0.001
    names = ["stiffness", "limit", "delay", "position_gain"]
    found = simulate_sensitivities(loop, experiment, values, names)
    for i, name in enumerate(names):
        step = _STEP * (values.get(name) or numbers_of(controller)[name])
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error <= 1e-3, name
