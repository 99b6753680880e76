"""A payload on an arm of six joints."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.robots.bodies import Payload, identify_payload, payload_difference
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Robot
from jointid.output import json as answers
from jointid.records.record import Record
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.test_robot_drive_side import logged
from tests.estimation.robots.twin import arm, hide_spring, identified, records_of, with_payload
from tests.robots_plants import six, two

ARM = arm()
BODY = MassProperties(3.0, np.array([0.02, -0.03, 0.08]), np.diag([0.02, 0.015, 0.01]))
TRUTH = np.array([3.0, 0.02, -0.03, 0.08, 0.02, 0.015, 0.01, 0.0, 0.0, 0.0])


def pair(seed: int, noise: float = 0.2, loaded: Robot | None = None) -> tuple[Sequence[Record], Sequence[Record]]:
    """Return the records without and with the payload."""
    return records_of(ARM, seed, noise), records_of(loaded or with_payload(ARM, BODY.inertial), seed + 100, noise)


def test_a_payload_is_weighed_within_a_percent() -> None:
    found = identify_payload(ARM, *pair(11))
    assert found.rows["mass"]["value"] == pytest.approx(3.0, rel=0.01)
    assert found.properties[1][0] < 0.02 and found.link == "link6"
    assert max(map(len, found.summary().splitlines())) <= 100
    assert answers.to_dict(found)["schema"] == "jointid.Payload/2"
    with pytest.raises(MethodError, match="mass comes out as"):
        identify_payload(ARM, *reversed(pair(11)))


@pytest.mark.slow
def test_two_deviations_hold_the_payload() -> None:
    ways = [identify_payload(ARM, *pair(seed, noise=0.5)).properties for seed in range(20, 26)]
    assert np.mean([np.abs(values - TRUTH) < 2 * std for values, std in ways]) > 0.88


def by_torques(seed: int, noise: float = 0.02, warmer: float = 1.0) -> Payload:
    """Weigh the payload on an arm of six joints from torques and references, its friction so many times as large."""
    twin = six()
    joints = tuple(replace(joint, coulomb=warmer * joint.coulomb) for joint in twin.robot.joints)
    loaded = replace(twin, robot=with_payload(replace(twin.robot, joints=joints), BODY.inertial))
    one, other = (
        recorded(each.loop(), each.records(10.0, seed=seed + k), noise, seed=seed + k)[0]
        for k, each in enumerate((twin, loaded))
    )
    return identify_payload(twin.loop(), one, other)


@pytest.mark.slow
def test_two_deviations_hold_the_payload_from_torques() -> None:
    ways = [by_torques(seed, noise=0.03).properties for seed in range(20, 32, 2)]
    assert np.mean([np.abs(values - TRUTH) < 2 * std for values, std in ways]) > 0.88


@pytest.mark.slow
def test_a_payload_is_weighed_where_friction_changed() -> None:
    joints = tuple(replace(joint, coulomb=0.7 * joint.coulomb) for joint in ARM.joints)
    warm = with_payload(replace(ARM, joints=joints), BODY.inertial)
    for found in (by_torques(3, noise=0.01, warmer=0.7), identify_payload(ARM, *pair(13, noise=0.05, loaded=warm))):
        assert found.rows["mass"]["value"] == pytest.approx(3.0, rel=0.01)


@pytest.mark.slow
def test_a_payload_on_a_flexible_robot_acts_behind_its_springs() -> None:
    twin = six(True)
    loaded = replace(twin, robot=with_payload(twin.robot, BODY.inertial))
    one, other = (
        recorded(each.loop(), each.records(5.0, seed=k, multisine=0.004), 0.02, seed=k)[0]
        for k, each in enumerate((twin, loaded), start=1)
    )
    found = identify_payload(twin.loop(), one, other)
    assert found.rows["mass"]["value"] == pytest.approx(3.0, rel=0.01)


@pytest.mark.slow
def test_a_payload_is_weighed_on_the_drive_side() -> None:
    """Also where one of the records begins in motion, and has parameters of its own."""
    twin = six((False, True, True, False, False, False))
    loaded = replace(twin, robot=with_payload(twin.robot, BODY.inertial))
    one, other = logged(twin, 5.0, seed=1), logged(loaded, 6.0, seed=2, first=1000)
    found = identify_payload(twin.robot, one, other, DriveSideFit())
    assert found.rows["mass"]["value"] == pytest.approx(3.0, rel=0.01)
    values, std = found.properties
    assert np.mean(np.abs(values - TRUTH) < 2 * std) > 0.7


def test_what_is_not_told_of_a_payload_is_said() -> None:
    twin = two()
    one, other = (recorded(twin.loop(), twin.records(4.0, seed=k), 0.01)[0] for k in (1, 2))
    with pytest.raises(MethodError, match="my, "):
        identify_payload(twin.loop(), one, other)
    estimate = identified(twin.loop(), one)
    for other in (
        estimate,
        hide_spring(estimate, "elbow"),
        replace(estimate, fit=replace(estimate.fit, converged=False)),
    ):
        with pytest.raises(MethodError):
            payload_difference(estimate, other)
    with pytest.raises(MethodError):
        identify_payload(twin.robot, estimate, one)


def unstated(records: Sequence[Record]) -> list[Record]:
    """Return the records without a statement on the timing of the torques."""
    return [replace(one, torque=replace(one.torque, stated=False)) for one in records if one.torque is not None]


@pytest.mark.slow
def test_two_deviations_hold_a_payload_of_unstated_timing() -> None:
    """The twin has less noise than half a sample changes."""
    found = identify_payload(ARM, *map(unstated, pair(30, noise=0.05)))
    values, std = found.properties
    assert np.mean(np.abs(values - TRUTH) < 2 * std) >= 0.8 and found.warnings
