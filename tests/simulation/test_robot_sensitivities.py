"""Derivatives of a robot's torques by variation, against central differences of whole runs."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import PID, Cascade
from jointid.models.robots.robot import RobotLoop
from jointid.records.chunks import cut
from jointid.records.record import Channel, Tap, Timing
from jointid.simulation.derivatives import differentiate
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import DELAY, Numbers, Place
from jointid.simulation.simulate import run_loop
from tests.robots_plants import all_places, six, two
from tests.simulation.differences import differences
from tests.simulation.test_robots import COUPLED, apart, changed, faster

LATE = tuple(
    Cascade(position_gain=20.0, velocity_gain=kv, integral_gain=8.0, position_period=2e-3, delay=1.3e-3)
    for kv in (60.0, 16.0)
)
LIMITED = tuple(
    PID(position_gain=kp, derivative_gain=kd, integral_gain=4 * kp, limit=limit)
    for kp, kd, limit in ((2000.0, 110.0, 18.0), (800.0, 34.0, 5.0))
)


@pytest.mark.parametrize(
    ("loop", "steps", "worst"),
    [
        (two().loop(), 1, 2e-3),
        (two((10.0, 14.0)).loop(), 4, 5e-3),
        pytest.param(RobotLoop(two((10.0, 14.0)).robot, LATE), 4, 5e-3, marks=pytest.mark.slow),
        (RobotLoop(two().robot, LIMITED), 4, 5e-3),
        (six().loop(), 1, 2e-3),
        (changed(two((None, 12.0)), *COUPLED).loop(), 4, 5e-3),
        pytest.param(RobotLoop(two((None, 12.0)).robot, apart(two())), 4, 5e-3, marks=pytest.mark.slow),
        (replace(two((None, 12.0)).loop(), in_motion=True), 4, 5e-3),
    ],
    ids=[
        "two rigid", "two flexible", "late cascades of two rates", "at their limits", "six rigid",
        "motors coupled", "clocks that differ", "in motion",
    ],
)  # fmt: skip
def test_variation_is_the_derivative_of_the_run(loop: RobotLoop, steps: int, worst: float) -> None:
    """The instants of events move with the parameters, and those in which limits act: all is in the derivative."""
    twin = six() if len(loop.controllers) == 6 else two()
    records = faster(twin.records(4.8), 8.0)
    if loop.in_motion:
        records = tuple(cut(one, 100, 600) for one in records)
    experiment, numbers = prepare(loop, records), Numbers.of(loop.robot)
    places = all_places(numbers)
    if len(loop.controllers) == 6:
        places = places[::7]
    run = run_loop(experiment, numbers, keep=True, steps=steps)
    assert run.events > 2
    if any(isinstance(law, PID) for law in loop.controllers):
        assert 0.01 < np.mean(run.excess != 0.0) < 0.99
    expected = differences(experiment, numbers, places, 2 * steps)
    found = np.stack(differentiate(run, places)[0], axis=1)
    sizes = np.linalg.norm(expected, axis=(0, 1))
    error = np.linalg.norm(found - expected, axis=(0, 1))
    felt = sizes > 1e-6 * np.max(sizes)
    assert np.max(error[felt] / sizes[felt]) < worst
    assert np.all(error[~felt] < 1e-5 * np.max(sizes))


@pytest.mark.parametrize(
    ("loop", "averaged"),
    [
        (two().loop(), False),
        (two().loop(), True),
        (two((10.0, 14.0)).loop(), False),
        (changed(two((None, 12.0)), *COUPLED).loop(), False),
        (RobotLoop(two((None, 12.0)).robot, apart(two())), False),
    ],
    ids=["rigid", "torques averaged", "flexible", "motors coupled", "clocks that differ"],
)
def test_variation_by_delays_is_the_derivative_of_the_run(loop: RobotLoop, averaged: bool) -> None:
    """Edges of the torques move, and with them those at which a joint comes loose."""
    records = faster(two().records(4.8), 8.0)
    if averaged:
        shown = Channel(np.ones(len(records[0].reference or ())), "N m", 1e-3, Timing.AVERAGED)
        records = tuple(replace(one, torque=shown, tap=Tap.MEASURED) for one in records)
    experiment, places = prepare(loop, records), tuple(Place(j, DELAY) for j in range(2))
    numbers = Numbers.of(loop.robot).with_values(places, [1.3e-3, 2.9e-3])
    run = run_loop(experiment, numbers, keep=True, steps=2)
    assert run.events > 2
    found = np.stack(differentiate(run, places)[0], axis=1)
    expected = differences(experiment, numbers, places, 4)
    assert np.all(np.linalg.norm(found - expected, axis=(0, 1)) < 5e-3 * np.linalg.norm(expected, axis=(0, 1)))
