"""Robots that MuJoCo moved: the same torques as ours, and what is identified from them."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo, of the extra robots, makes the independent data")

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.robots.didim import RobotFit, search_robot
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import run_loop
from jointid.simulation.start import begin
from tests.estimation.robots.test_rigid_robots import deviations
from tests.robots_mujoco import simulate_by_mujoco
from tests.robots_plants import Twin, assert_springs, six, two


def moved(twin: Twin, records: tuple[Record, ...], step: float = 1e-4) -> tuple[FloatArray, FloatArray]:
    """Return the torques by MuJoCo and by jointid, (samples, n) each."""
    loop = twin.loop()
    experiment, numbers = prepare(loop, records), Numbers.of(twin.robot)
    gains = np.array([[c.position_gain, c.derivative_gain] for c in loop.controllers])  # type: ignore[attr-defined]
    start = begin(experiment, numbers).places
    theirs, _ = simulate_by_mujoco(twin.robot, gains, experiment.references, 1e-3, start, step)
    return theirs, run_loop(experiment, numbers).torque


def logged(records: tuple[Record, ...], torques: FloatArray, noise: float, seed: int = 0) -> tuple[Record, ...]:
    """Return the records with torques, and noise that is a share of their deviations."""
    torques = torques + noise * np.std(torques, axis=0) * np.random.default_rng(seed).normal(size=torques.shape)
    channels = [Channel(column, "N m", 1e-3, Timing.HELD) for column in torques.T]
    return tuple(record.with_channels({"torque": one}) for record, one in zip(records, channels, strict=True))


@pytest.mark.parametrize("twin", [six(), two((None, 16.0)), six(True)], ids=["six", "one flexible", "six flexible"])
def test_the_same_torques(twin: Twin) -> None:
    """To what MuJoCo's step of the first order and its soft friction leave."""
    theirs, ours = moved(twin, twin.records(2.0), step=1e-4)
    assert np.max(np.std(theirs - ours, axis=0) / np.std(ours, axis=0)) < 2e-3


@pytest.mark.slow
def test_a_rigid_robot_is_identified_from_torques_by_mujoco() -> None:
    """Of six draws of the noise one has 53 of the 58 parameters within two deviations, the others 57 or 58."""
    twin = six()
    records = twin.records(10.0)
    theirs, _ = moved(twin, records)
    fits = [search_robot(twin.loop(), logged(records, theirs, 0.02, seed)) for seed in range(6)]
    inside = [np.sum(np.abs(deviations(fit, twin)) <= 2) for fit in fits]
    assert all(fit.converged and len(fit.values) == 58 for fit in fits)
    assert np.median(inside) >= 57 and np.mean(inside) >= 0.95 * 58


@pytest.mark.slow
def test_springs_are_identified_from_torques_by_mujoco() -> None:
    twin = two((12.0, 18.0))
    records = twin.records(6.0, multisine=0.004)
    # A step of the first order puts damping of its size into springs: at 0.1 ms four deviations of the friction.
    theirs, _ = moved(twin, records, step=2e-5)
    found = search_robot(
        twin.loop(), logged(records, theirs, 0.02), None, DIDIM(frequencies={"joint1": 15, "joint2": 15})
    )
    off = np.abs(deviations(found, twin))
    assert np.max(off) < 3.5  # of one draw of the noise, whose errors go together
    assert np.mean(off < 2) > 0.75
    assert_springs(found, twin, 0.1, 3.0)


@pytest.mark.slow
def test_intervals_hold_when_the_error_of_mujoco_is_counted() -> None:
    """That error is what is found of its torques without noise; beside it two deviations hold the truth."""
    twin = two((12.0, 18.0))
    records = twin.records(6.0, multisine=0.004)
    theirs, _ = moved(twin, records, step=2e-5)

    def identified(noise: float, seed: int) -> RobotFit:
        made = logged(records, theirs, noise, seed)
        return search_robot(twin.loop(), made)

    clean = identified(1e-7, 0)
    truth = clean.parameters.group(Numbers.of(twin.robot))
    own, inside, counted = np.abs(clean.values - truth), [], []
    for seed in range(6):
        fit = identified(0.02, seed)
        off, two_sigma = np.abs(fit.values - truth), 2 * fit.covariance.std
        inside.append(off < two_sigma)
        counted.append(off < two_sigma + own)
    assert np.mean(inside) > 0.91
    assert np.mean(counted) > 0.95
