"""Delays of a robot's torques that are identified with it, on twins whose truth is known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.parameters import with_delays
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record
from jointid.simulation.synthesis import simulate
from tests.robots_plants import Twin, two

LATE = {0: 1.3e-3, 1: 2.9e-3}  # s, no multiples of the sample time of 1 ms


def logged(twin: Twin, noise: float, encoder: float = 0.0, multisine: float = 0.0) -> tuple[Record, ...]:
    """Return what the drives log of torques that act late, in finer steps than an identification takes."""
    driven, rng = twin.records(5.0, multisine=multisine), np.random.default_rng(3)
    run = simulate(with_delays(twin.loop(), LATE), driven, steps=4)
    torque = run.torque + noise * np.std(run.torque, axis=0) * rng.normal(size=run.torque.shape)
    moved = run.motor_position + encoder * rng.normal(size=run.torque.shape)
    return replace(run, torque=torque, motor_position=moved).records(driven)


@cache
def twin_logged() -> tuple[RobotLoop, tuple[Record, ...]]:
    return two().loop(), logged(two(), 0.02, 1e-5)


def assert_found(estimate: ji.Estimate, *joints: int) -> None:
    for j in joints:
        found = estimate[f"joint{j + 1}.delay"]
        assert (found.unit, found.of_joint, found.axis) == ("s", False, f"joint{j + 1}")
        assert abs(found.value - LATE[j]) < min(3e-4, 3 * found.stderr)
        assert found.stderr < 1.5e-4


def test_delays_are_found_from_what_is_declared() -> None:
    loop, records = twin_logged()
    estimate = ji.identify(records, with_delays(loop, {0: 2e-3, 1: 2e-3}), DIDIM(free=("delay",)), checks=False)
    assert_found(estimate, 0, 1)
    assert estimate["joint1.delay"].nominal == 2e-3


@pytest.mark.slow
def test_delays_are_found_where_none_is_declared() -> None:
    loop, records = twin_logged()
    estimate = ji.identify(records, loop, DIDIM(free=("delay",)))
    assert_found(estimate, 0, 1)
    viscous = estimate["joint1.viscous"]
    assert viscous.value == pytest.approx(3.0, abs=3 * (viscous.stderr or 0.0))
    assert [law.delay for law in estimate.require_robot().setup.controllers] == [  # type: ignore[union-attr]
        estimate[f"joint{j}.delay"].value for j in (1, 2)
    ]
    wrong = ji.identify(records, loop, checks=False)
    assert max(wrong.fit.axis_errors.values()) > 1.2 * max(estimate.fit.axis_errors.values())


def test_one_joint_s_delay_beside_one_that_is_declared() -> None:
    loop, records = twin_logged()
    stated = with_delays(loop, {0: 1.3e-3, 1: 2e-3})
    estimate = ji.identify(records, stated, DIDIM(free=("joint2.delay",)), checks=False)
    assert "joint1.delay" not in estimate.values
    assert_found(estimate, 1)


@pytest.mark.slow
def test_delays_from_positions_alone() -> None:
    loop, records = twin_logged()
    found = ji.identify(records, loop, DIDIM(free=("delay",), outputs=("motor_position",)))
    for j, late in LATE.items():
        one = found[f"joint{j + 1}.delay"]
        assert abs((one.value or 0.0) - late) < min(3e-4, 3 * (one.stderr or 0.0))


@pytest.mark.slow
def test_delays_of_flexible_joints() -> None:
    twin = two((12.0, 18.0))
    estimate = ji.identify(logged(twin, 0.02, multisine=0.004), twin.loop(), DIDIM(free=("delay",)), checks=False)
    assert_found(estimate, 0, 1)
    for joint in twin.robot.joints:
        found = estimate[f"{joint.name}.stiffness"]
        assert found.value == pytest.approx(joint.spring.stiffness, abs=3 * (found.stderr or 0.0))


@pytest.mark.slow
def test_a_delay_that_the_record_does_not_tell_is_refused() -> None:
    """In noise of eight times the torque."""
    records = logged(two(), 8.0)
    with pytest.raises(MethodError):
        ji.identify(records, with_delays(two().loop(), LATE), DIDIM(free=("delay",)), checks=False)
