"""A payload weighed two ways, on an arm of six joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.payload import (
    Payload,
    both_records,
    identify_payload,
    payload_of_both_records,
    payload_of_torques,
)
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Robot
from jointid.output import json as answers
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.test_robot_drive_side import logged
from tests.estimation.robots.twin import arm, identified, records_of, with_payload
from tests.robots_plants import six, two

ARM = arm()
BODY = MassProperties(3.0, np.array([0.02, -0.03, 0.08]), np.diag([0.02, 0.015, 0.01]))
TRUTH = np.array([3.0, 0.02, -0.03, 0.08, 0.02, 0.015, 0.01, 0.0, 0.0, 0.0])


def pair(seed: int, noise: float = 0.2, loaded: Robot | None = None) -> tuple[Sequence[Record], Sequence[Record]]:
    """Return the records without and with the payload."""
    return records_of(ARM, seed, noise), records_of(loaded or with_payload(ARM, BODY.inertial), seed + 100, noise)


def test_a_payload_is_weighed_within_a_percent_both_ways() -> None:
    found = identify_payload(ARM, *pair(11))
    assert found.rows["mass"]["value"] == pytest.approx(3.0, rel=0.01)
    assert found.rows["mass"]["by_difference"] == pytest.approx(3.0, rel=0.01)
    assert found.rows["mass"]["verdict"] == "known"
    assert found.rows["inertia yz"]["verdict"] == "not significant"
    assert found.agrees
    said = found.summary()
    assert "The difference of two estimates says the same." in " ".join(said.split())
    assert max(map(len, said.splitlines())) <= 100
    answer = answers.to_dict(found)
    assert answer["schema"] == "jointid.Payload/2" and answer["agrees"] is True


@pytest.mark.slow
def test_two_deviations_hold_the_payload() -> None:
    inside = []
    for seed in range(20, 26):
        found = identify_payload(ARM, *pair(seed, noise=0.5))
        for way in (found.payload, found.difference):
            values, std = way.properties
            inside.append(np.abs(values - TRUTH) < 2 * std)
    assert np.mean(inside) > 0.88


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
def test_a_payload_is_weighed_from_torques_and_references_alone() -> None:
    found = by_torques(1)
    for way in ("value", "by_difference"):
        assert found.rows["mass"][way] == pytest.approx(3.0, rel=0.01)
    assert found.agrees
    assert found.rows["mass"]["std"] < found.rows["mass"]["by_difference_std"]
    inside = [
        np.abs(values - TRUTH) < 2 * std for values, std in (found.payload.properties, found.difference.properties)
    ]
    assert np.mean(inside) > 0.8


@pytest.mark.slow
def test_two_deviations_hold_the_payload_from_torques() -> None:
    found = [by_torques(seed, noise=0.03) for seed in range(20, 32, 2)]
    ways = [way.properties for one in found for way in (one.payload, one.difference)]
    assert np.mean([np.abs(values - TRUTH) < 2 * std for values, std in ways]) > 0.88


@pytest.mark.slow
def test_friction_that_changed_is_said_from_torques_too() -> None:
    found = by_torques(3, noise=0.01, warmer=0.7)
    assert found.rows["mass"]["by_difference"] == pytest.approx(3.0, rel=0.01)
    assert not found.agrees


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
    found = identify_payload(RobotDriveSide(twin.robot), one, other)
    for way in ("value", "by_difference"):
        assert found.rows["mass"][way] == pytest.approx(3.0, rel=0.01)
    values, std = found.payload.properties
    assert np.mean(np.abs(values - TRUTH) < 2 * std) > 0.7
    assert "the difference of two estimates, each with its own friction" in " ".join(found.summary().split())


def test_what_is_not_told_of_a_payload_is_said() -> None:
    twin = two()
    one, other = (recorded(twin.loop(), twin.records(4.0, seed=k), 0.01)[0] for k in (1, 2))
    with pytest.raises(MethodError, match=r"does not tell all of a payload: my, .* expected joints that turn and tilt"):
        identify_payload(twin.loop(), one, other)
    estimate = identified(twin.loop(), one)
    for same_friction in (True, False):  # of few rows, too
        with pytest.raises(MethodError, match="does not tell all of a payload"):
            payload_of_torques(estimate, estimate, same_friction=same_friction)
    with pytest.raises(MethodError, match="by didim, and the record with it is identified by idim; expected one"):
        identify_payload(twin.robot, estimate, other)
    part = replace(estimate.require_robot(), springs=(SpringVerdict("elbow", False, None, None, 10.0),))
    hidden = replace(estimate, robot=part)
    with pytest.raises(MethodError, match=r"does not show the spring of elbow, .* leave this spring out"):
        payload_of_torques(estimate, hidden, same_friction=True)
    with pytest.raises(MethodError, match="The search did not settle on the record with it"):
        payload_of_torques(estimate, replace(estimate, fit=replace(estimate.fit, converged=False)), same_friction=True)


@pytest.mark.slow
def test_friction_that_changed_beside_the_payload_is_said() -> None:
    """By both records at once one friction is both robots', by the difference each has its own."""
    joints = tuple(replace(joint, coulomb=0.7 * joint.coulomb) for joint in ARM.joints)
    warm = with_payload(replace(ARM, joints=joints), BODY.inertial)
    found = identify_payload(ARM, *pair(13, noise=0.05, loaded=warm))
    assert found.rows["mass"]["by_difference"] == pytest.approx(3.0, rel=0.01)
    assert not found.agrees
    assert "something beside the payload changed between the records" in " ".join(found.summary().split())


def unstated(records: Sequence[Record]) -> list[Record]:
    """Return the records without a statement on the timing of the torques."""
    return [replace(one, torque=replace(one.torque, stated=False)) for one in records if one.torque is not None]


@pytest.mark.slow
def test_an_unstated_timing_is_said_of_a_payload_and_widens_it() -> None:
    """The twin has less noise than half a sample changes."""
    records = pair(30, noise=0.05)
    of_stated, of_unstated = payload_of_both_records(ARM, *records), identify_payload(ARM, *map(unstated, records))
    assert of_unstated.agrees
    assert np.max(of_unstated.payload.properties[1] / of_stated.properties[1]) > 1.5
    assert any("with it: it is not stated whether the torque is held" in said for said in of_unstated.warnings)
    assert "it is read as sampled" in " ".join(of_unstated.summary().split())


def test_both_records_are_used_whole() -> None:
    empty, loaded = pair(30)
    short = [
        Record(**{name: replace(channel, values=channel.values[: len(channel) // 2]) for name, channel in one.items()})
        for one in loaded
    ]
    sizes = [both_records(ARM, logs, Filtering(cutoff=5.0)).Y.size for logs in ((empty, loaded), (empty, short))]
    assert sizes[1] > 0.7 * sizes[0]
