"""Springs in pieces: against a slow reference, against the plain joint, and their derivatives against differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.springs import Backlash, Spring, ThreePieceSpring
from jointid.simulation.closed_loop import Simulation, simulate, simulate_torque
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import Case, prismatic, rotary
from tests.simulation.differences import error_beside_differences
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Plant, random_case
from tests.simulation.oracle import simulate as reference

# Of those with two masses: without a delay, with one of 0.9, of 1.5 and of 2.5 periods.
SEEDS = (1, 2, 9, 12)


def sprung(case: Case, spring: Spring, values: dict[str, float]) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with another spring."""
    assert isinstance(case.loop.joint, FlexibleJoint)
    return replace(case.loop, joint=replace(case.loop.joint, spring=spring)), case.truth | values


def wound(case: Case) -> float:
    """The largest deflection of the drive's own spring."""
    found = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    assert found.load_position is not None
    return float(np.max(np.abs(found.motor_position - found.load_position)))


def of_three(case: Case, softer: float, stiffer: float) -> tuple[ClosedLoop, dict[str, float]]:
    K, most = case.truth["stiffness"], wound(case)
    torques = {"torque_1": 0.3 * K * most, "torque_2": 0.6 * K * most}
    stiffnesses = {"stiffness": softer * K, "stiffness_2": K, "stiffness_3": stiffer * K}
    return sprung(case, ThreePieceSpring(), torques | stiffnesses)


def gapped(case: Case) -> tuple[ClosedLoop, dict[str, float]]:
    return sprung(case, Backlash(), {"gap": 0.5 * wound(case)})


def pieces_of(plant: Plant, spring: str, most: float) -> Plant:
    K, F = plant.stiffness, plant.damping
    if spring == "backlash":
        return replace(plant, pieces=((0.0, 0.0, 0.0, 0.0), (0.25 * most, 0.0, K, F)))
    first, second = 0.3 * most, 0.7 * most
    torque = 0.6 * K * first
    then = (second, torque + K * (second - first), 1.5 * K, F)
    return replace(plant, pieces=((0.0, 0.0, 0.6 * K, F), (first, torque, K, F), then))


@pytest.mark.parametrize("spring", ["three-piece", "backlash"])
@pytest.mark.parametrize("seed", [SEEDS[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[1:])])
def test_agrees_with_a_reference_that_locates_every_event(seed: int, spring: str) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    n = 150 if seed == SEEDS[0] else len(w)
    w, post = w[:n], post[:n]
    _, _, own, _ = run(plant, law, w, post, T, delay, before, x0)
    plant = pieces_of(plant, spring, float(np.max(np.abs(own[:, 2] - own[:, 0]))))
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0)
    expected = reference(plant, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 4
    np.testing.assert_allclose(u, expected.u, rtol=0, atol=1e-10 * np.abs(expected.u).max())
    np.testing.assert_allclose(x, expected.x, rtol=0, atol=1e-10 * np.abs(expected.x).max())


@pytest.mark.parametrize("make", [prismatic, rotary])
def test_a_spring_of_equal_stiffnesses_is_linear(make: Callable[[int], Case]) -> None:
    case = make(0)
    experiment = prepare(case.loop, case.clean)
    expected = simulate(case.loop, experiment, case.truth)
    loop, values = of_three(case, 1.0, 1.0)
    found = simulate(loop, experiment, values)
    assert found.events > expected.events  # it came over its edges
    np.testing.assert_allclose(found.torque, expected.torque, rtol=0, atol=1e-9 * np.abs(expected.torque).max())
    names = [p.name for p in case.loop.joint.parameters if p.name != "stiffness"]
    own = simulate_sensitivities(case.loop, experiment, case.truth, names).torque
    pieced = simulate_sensitivities(loop, experiment, values, names).torque
    assert np.linalg.norm(pieced - own) < 1e-9 * np.linalg.norm(own)


@pytest.mark.parametrize("make", [prismatic, rotary])
@pytest.mark.parametrize("spring", [of_three, gapped])
def test_derivatives_agree_with_central_differences(make: Callable[[int], Case], spring: Callable) -> None:
    case = make(1)
    loop, values = spring(case, *((0.6, 1.4) if spring is of_three else ()))
    experiment, names = prepare(loop, case.clean), [p.name for p in loop.joint.parameters]
    found = simulate_sensitivities(loop, experiment, values, names)
    assert np.array_equal(found.response.torque, simulate_torque(loop, experiment, values).torque)
    for i, name in enumerate(names):
        step = 1e-5 * max(abs(values[name]), 1e-3)
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error < 3e-3, name


def balance(found: Simulation, loop: ClosedLoop, values: dict[str, float]) -> np.ndarray:
    """What the load's equation leaves, over the largest torque of the spring."""
    joint, load = loop.joint, found.load
    assert isinstance(joint, FlexibleJoint)
    assert load is not None
    deflection, slip = load.position - found.motor.position, load.velocity - found.motor.velocity
    spring = joint.spring.torque(values, deflection, slip)
    friction = values["load_viscous"] * load.velocity + values["load_coulomb"] * np.sign(load.velocity)
    left = values["load_inertia"] * load.acceleration + friction + spring
    return np.asarray(left[load.velocity != 0] / np.abs(spring).max())


@pytest.mark.parametrize("spring", [of_three, gapped])
def test_the_motion_obeys_the_equation_of_the_load(spring: Callable) -> None:
    case = prismatic(2)
    loop, values = spring(case, *((0.6, 1.4) if spring is of_three else ()))
    found = simulate(loop, prepare(loop, case.clean), values)
    assert np.abs(balance(found, loop, values)).max() < 1e-9
