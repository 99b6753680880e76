"""DIDIM of robots of rigid joints, on twins: what comes back, how fast it settles, its intervals, its refusals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.parameters import robot_parameters
from jointid.estimation.robots.didim import RobotFit, search_robot
from jointid.models.robots.robot import RobotLoop
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, robot_with
from jointid.simulation.simulate import run_loop
from jointid.simulation.synthesis import simulate
from tests.robots_plants import Twin, seven, six, two
from tests.simulation.test_robots import COUPLED, ONE_WAY, RISING, changed


def recorded(
    loop: RobotLoop, records: Sequence[Record], noise: float = 0.0, seed: int = 0
) -> tuple[tuple[Record, ...], np.ndarray]:
    """Return what the drives would have logged, the noise a share of each torque's deviation; and the noise alone."""
    run = simulate(loop, records)
    added = noise * np.std(run.torque, axis=0) * np.random.default_rng(seed).normal(size=run.torque.shape)
    return replace(run, torque=run.torque + added).records(records), added


def deviations(fit: RobotFit, twin: Twin) -> np.ndarray:
    """Return the errors of all parameters in their standard deviations."""
    return np.asarray((fit.values - fit.parameters.group(Numbers.of(twin.robot))) / fit.covariance.std)


@pytest.mark.parametrize(("twin", "count"), [(two(), 13), (six(), 58), (seven(), 69)], ids=["two", "six", "seven"])
def test_base_parameters_move_the_robot_as_all_do(twin: Twin, count: int) -> None:
    parameters, numbers = robot_parameters(twin.robot), Numbers.of(twin.robot)
    assert len(parameters.names) == count
    assert len(set(parameters.names)) == count
    experiment = prepare(twin.loop(), twin.records(1.0))
    whole = run_loop(experiment, numbers)
    based = run_loop(experiment, parameters.numbers(parameters.group(numbers)))
    assert np.max(np.abs(whole.command - based.command)) < 1e-9 * np.max(np.abs(whole.command))


@pytest.mark.parametrize(
    ("twin", "slower"),
    [(two(), 1.0), (two(), 4.0), pytest.param(six(), 4.0, marks=pytest.mark.slow)],
    ids=["two", "slow", "slow six"],
)
def test_parameters_come_back_exactly_without_noise(twin: Twin, slower: float) -> None:
    """Under a loop four times slower, too, whose motion is far from the commanded one."""
    loop = twin.loop(slower)
    records, _ = recorded(loop, twin.records(6.0))
    fit = search_robot(loop, records)
    truth = fit.parameters.group(Numbers.of(twin.robot))
    assert fit.converged
    assert fit.iterations <= (8 if slower == 1 else 20)
    assert np.max(fit.relative_error) < 1e-6
    assert fit.values == pytest.approx(truth, abs=2e-5 * np.max(np.abs(truth)))


@pytest.mark.parametrize("what", [
    "motors coupled", "friction another backwards", "clocks that differ", "in motion",
    pytest.param("rising friction", marks=pytest.mark.slow),
])  # fmt: skip
def test_they_come_back_of_what_robots_may_have(what: str) -> None:
    changes = {"motors coupled": COUPLED, "friction another backwards": ONE_WAY, "rising friction": RISING}
    twin = changed(two(), *changes[what]) if what in changes else two()
    loop, records = twin.loop(), twin.records(6.0)
    if what == "clocks that differ":
        first, second = loop.controllers
        loop = replace(loop, controllers=(replace(first, delay=4e-4), replace(second, period=2e-3)))  # type: ignore[type-var]
    if what == "in motion":
        loop = replace(loop, in_motion=True)
        records = tuple(cut(one, 2000, 6000) for one in records)
    records, _ = recorded(loop, records)
    fit = search_robot(loop, records)
    truth = fit.parameters.group(Numbers.of(twin.robot))
    assert fit.converged
    assert np.max(fit.relative_error) < 1e-6
    assert fit.values == pytest.approx(truth, abs=2e-5 * np.max(np.abs(truth)))
    assert ("joint1.viscous_backwards" in fit.parameters.names) == (what == "friction another backwards")
    again = simulate(replace(loop, robot=robot_with(twin.robot, fit.problem.numbers(fit.x))), records)
    assert again.torque == pytest.approx(fit.runs[0].torque, abs=1e-8)


@pytest.mark.slow
def test_noise_floor_and_intervals() -> None:
    """The error left is the noise, joint by joint, and two deviations hold the truth."""
    twin = two()
    loop, inside = twin.loop(), []
    for seed in range(4):
        records, noise = recorded(loop, twin.records(6.0, seed=seed + 1), 0.03, seed)
        fit = search_robot(loop, records)
        assert fit.converged
        assert fit.iterations <= 6
        expected = np.std(noise, axis=0) * np.sqrt(2 * 40.0 * 1e-3)  # of white noise below the cut-off of 40 Hz
        assert fit.problem.sigma[:, 0] == pytest.approx(expected, rel=0.15)
        inside.append(np.abs(deviations(fit, twin)) < 2)
    assert np.mean(inside) > 0.85


def test_friction_is_never_let_below_nothing() -> None:
    """Of a robot without Coulomb friction none is found, and the column stays that of the velocity's direction."""
    twin = two()
    joints = tuple(replace(joint, coulomb=0.0) for joint in twin.robot.joints)
    loop = RobotLoop(replace(twin.robot, joints=joints), twin.loop().controllers)
    records, _ = recorded(loop, twin.records(6.0), 0.03)
    fit = search_robot(loop, records)
    for name in ("joint1.coulomb", "joint2.coulomb"):
        value, deviation = fit.value(name)
        assert 0.0 <= value < 3 * deviation
    bare = tuple(record.without("motor_position") for record in records)
    assert np.array_equal(search_robot(loop, bare).values, fit.values), "positions are not read"
    run = simulate(loop, records)
    assert np.array_equal(run.motion.direction, np.sign(run.motion.velocity))
