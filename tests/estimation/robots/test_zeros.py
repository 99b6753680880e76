"""Encoder zeros that are not the model's, searched by their effect on the residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.diagnostics.identify import identify
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.robots.zeros import find_zeros
from jointid.models.robots.dynamics import inverse_dynamics
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from tests.estimation.robots.twin import arm, records_of

ARM = arm()


def shifted(records: list[Record], zeros: dict[int, float]) -> list[Record]:
    """Return records whose positions count from these places of the joints."""
    found = list(records)
    for joint, zero in zeros.items():
        channel = records[joint].motor_position
        assert channel is not None
        moved = replace(channel, values=channel.values - zero)
        found[joint] = replace(records[joint], motor_position=moved)
    return found


@pytest.mark.parametrize(
    ("joints", "zeros"),
    [(4, {1: -1.6}), *(pytest.param(6, zeros, marks=pytest.mark.slow) for zeros in ({2: 0.1}, {1: 2.5, 3: -0.7}))],
    ids=str,
)
def test_zeros_are_found_with_their_errors(joints: int, zeros: dict[int, float]) -> None:
    robot = arm(joints)
    records = shifted(list(records_of(robot, 2, noise=0.1)), zeros)
    found = {one.joint: one for one in find_zeros(robot, [records], Filtering())}
    assert set(found) == {robot.names[k] for k in zeros}
    for k, zero in zeros.items():
        one = found[robot.names[k]]
        assert abs(one.zero - zero) < 3.0 * one.stderr and one.stderr < 0.02
        assert one.residual < 0.8 * one.residual_without


@pytest.mark.slow
def test_a_zero_is_suspected_by_the_estimate_and_can_be_declared() -> None:
    records = shifted(list(records_of(ARM, 2, noise=0.1)), {1: -1.6})
    estimate = identify(records, ARM, IDIM())
    assert "the torques fit an encoder of joint2 that reads 0 where" in estimate.sentence
    declared = identify(records, ARM.turn(np.array([0.0, -1.6, 0.0, 0.0, 0.0, 0.0])), IDIM())
    assert max(declared.fit.axis_errors.values()) < 0.1 * max(estimate.fit.axis_errors.values())
    assert "encoder" not in declared.sentence


def test_right_zeros_are_left_alone() -> None:
    robot = arm(4)
    assert find_zeros(robot, [records_of(robot, 2, noise=0.1)], Filtering()) == ()


def test_a_turned_robot_moves_as_the_robot_at_shifted_positions() -> None:
    sliding = replace(ARM.links[2], kind="prismatic")
    robot = replace(ARM, links=(*ARM.links[:2], sliding, *ARM.links[3:]))
    random = np.random.default_rng(1)
    zeros, (q, v, a) = random.normal(size=6), random.normal(size=(3, 5, 6))
    turned = robot.turn(zeros)
    expected = inverse_dynamics(robot.tree, robot.inertials, q + zeros, v, a)
    assert inverse_dynamics(turned.tree, turned.inertials, q, v, a) == pytest.approx(expected, rel=1e-9, abs=1e-9)
