"""Friction that is another at low speed: against a slow reference, the plain joint, and differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.models.friction import StribeckFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.simulation.closed_loop import Initial, simulate, simulate_torque
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import Case, prismatic, rotary
from tests.simulation.differences import error_beside_differences
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Plant, random_case
from tests.simulation.oracle import simulate as reference
from tests.simulation.test_springs import pieces_of

# Rigid; and with two masses: without a delay, with one of 0.9, of 1.5 and of 2.5 periods.
SEEDS = (0, 2, 12, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 9)))


def slowly_other(plant: Plant, speeds: tuple[float, float], sign: float) -> Plant:
    """A friction that rises, or falls, towards standstill on both sides."""
    changes = [sign * 0.5 * min(fc) for fc in (plant.fc1, plant.fc2)]
    points = [
        ((0.0, change), (0.02 * speed, 0.8 * change), (0.1 * speed, 0.2 * change), (0.3 * speed, 0.0))
        for change, speed in zip(changes, speeds, strict=True)
    ]
    return replace(plant, more1=points[0], more2=() if plant.inertia2 is None else points[1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_agrees_with_a_reference_that_locates_every_event(seed: int, sign: float) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    n = 200
    w, post = w[:n], post[:n]
    _, _, own, _ = run(plant, law, w, post, T, delay, before, x0)
    plant = slowly_other(plant, tuple(np.max(np.abs(own[:, [1, 3]]), axis=0)), sign)
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0)
    expected = reference(plant, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 4
    np.testing.assert_allclose(u, expected.u, rtol=0, atol=1e-10 * np.abs(expected.u).max())
    np.testing.assert_allclose(x[:, : expected.x.shape[1]], expected.x, rtol=0, atol=1e-10 * np.abs(expected.x).max())


def test_beside_a_spring_in_pieces_it_agrees_with_the_reference() -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(2)
    w, post = w[:200], post[:200]
    _, _, own, _ = run(plant, law, w, post, T, delay, before, x0)
    plant = slowly_other(plant, tuple(np.max(np.abs(own[:, [1, 3]]), axis=0)), 1.0)
    plant = pieces_of(plant, "backlash", float(np.max(np.abs(own[:, 2] - own[:, 0]))))
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0)
    expected = reference(plant, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 40
    np.testing.assert_allclose(u, expected.u, rtol=0, atol=1e-10 * np.abs(expected.u).max())
    np.testing.assert_allclose(x, expected.x, rtol=0, atol=1e-10 * np.abs(expected.x).max())


RISES = {"stribeck_force": 0.4, "stribeck_speed": 0.05}  # of the Coulomb friction, and of the largest speed
FALLS = {"stribeck_force": -0.4, "stribeck_speed": 0.05}


def slow(case: Case, shares: dict[str, float]) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with another friction towards standstill."""
    joint = case.loop.joint
    own = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    values = dict(case.truth)
    for prefix in ("motor_", "load_") if isinstance(joint, FlexibleJoint) else ("",):
        values[f"{prefix}stribeck_force"] = shares["stribeck_force"] * values[f"{prefix}coulomb"]
        values[f"{prefix}stribeck_speed"] = shares["stribeck_speed"] * float(np.max(np.abs(own.motor_velocity)))
    return replace(case.loop, joint=replace(joint, friction=StribeckFriction())), values


def rigid(case: Case) -> Case:
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    return replace(case, loop=replace(case.loop, joint=joint.rigid), truth=joint.rigid_sums(case.truth))


def stiff(case: Case) -> Case:
    return case


@pytest.mark.parametrize("model", [rigid, stiff])
@pytest.mark.parametrize("make", [prismatic, rotary])
@pytest.mark.parametrize("shares", [RISES, FALLS])
def test_derivatives_agree_with_central_differences(make: Callable, model: Callable, shares: dict[str, float]) -> None:
    case = model(make(1))
    loop, values = slow(case, shares)
    experiment, names = prepare(loop, case.clean), [p.name for p in loop.joint.parameters]
    found = simulate_sensitivities(loop, experiment, values, names)
    assert np.array_equal(found.response.torque, simulate_torque(loop, experiment, values).torque)
    for i, name in enumerate(names):
        step = 1e-5 * max(abs(values[name]), 1e-3)
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error < 3e-4, name


def test_the_derivatives_by_the_first_velocity_follow_the_drag_at_it() -> None:
    case = prismatic(1)
    loop, values = slow(case, RISES)
    experiment, speed = prepare(loop, case.clean), 1.2 * values["motor_stribeck_speed"]
    found = simulate_sensitivities(loop, experiment, values, ["initial_velocity"], Initial(velocity=speed)).torque[:, 0]
    step = 1e-4 * speed
    low, high = (simulate_torque(loop, experiment, values, Initial(velocity=speed + by)).torque for by in (-step, step))
    expected = (high - low) / (2 * step)
    assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)
