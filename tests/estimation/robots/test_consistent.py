"""Bodies near a prior that fit an estimate, and a payload from two records."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.diagnostics.validation import validate
from jointid.estimation.parameters import mass_matrix_at
from jointid.estimation.robots.bodies import consistent_robot
from jointid.models.robots.inertial import from_log_cholesky, is_physical, log_cholesky, pseudo_inertia
from jointid.models.robots.robot import Robot
from jointid.output.export import export
from jointid.records.signals.filtering import Filtering
from tests.estimates import errors_of_bodies
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.twin import COULOMB, ROTORS, arm, hide_spring, identified, records_of
from tests.models.robots.trees import random_body
from tests.robots_plants import Twin, six, two

ARM = arm()


def wrong_model() -> Robot:
    """Return the arm with masses that are up to a third off, and rotors of half the inertia."""
    factors = np.random.default_rng(5).uniform(0.7, 1.3, 6)
    links = tuple(replace(link, inertial=f * link.inertial) for link, f in zip(ARM.links, factors, strict=True))
    joints = tuple(replace(joint, rotor_inertia=0.5 * joint.rotor_inertia) for joint in ARM.joints)
    return replace(ARM, links=links, joints=joints)


def test_log_cholesky_parameters_say_the_same_and_have_these_derivatives() -> None:
    body = random_body(np.random.default_rng(8))
    theta = log_cholesky(pseudo_inertia(body))
    found, slopes = from_log_cholesky(theta)
    assert found == pytest.approx(body, rel=1e-12)
    assert theta[7:] == pytest.approx(body[1:4] / body[0], rel=1e-12)
    for k, step in enumerate(1e-6 * np.eye(10)):
        difference = (from_log_cholesky(theta + step)[0] - from_log_cholesky(theta - step)[0]) / 2e-6
        assert slopes[:, k] == pytest.approx(difference, abs=1e-8)


def test_bodies_fit_the_estimate_and_can_be() -> None:
    estimate = identified(wrong_model(), records_of(ARM, 2, noise=0.5))
    found = consistent_robot(estimate)
    assert all(is_physical(link.inertial) for link in found.robot.links)
    assert found.misfit < 1.0
    part = estimate.require_robot()
    values, true = (part.parameters_of(robot) for robot in (found.robot, ARM))
    assert np.abs((values - true) / estimate.covariance_of(part.names).std)[part.parameters.inertial].max() < 5
    # The rotors of joints 1 and 2 are told only with their links.
    assert found.robot.of_joints("rotor_inertia")[2:] == pytest.approx(ROTORS[2:], rel=0.05)
    assert found.robot.of_joints("coulomb") == pytest.approx(COULOMB, rel=0.03)


@pytest.mark.slow
def test_bodies_that_do_not_fit_are_not_exported() -> None:
    estimate = identified(ARM, records_of(ARM, 2, noise=0.1))
    part = estimate.require_robot()
    shift = np.zeros(len(part.values))
    place = part.names.index("joint6.rotor_inertia")
    shift[place] = -2.0 * part.values[place]  # no rotor has a negative inertia
    spoilt = replace(estimate, robot=replace(part, values=part.values + shift))
    assert consistent_robot(spoilt).worst[0] == "joint6.rotor_inertia"
    with pytest.raises(MethodError, match=r"5\d\d standard deviations off"):
        export(spoilt, "urdf")


@pytest.mark.parametrize(
    "twin",
    [two(), *(pytest.param(six(flexible), marks=pytest.mark.slow) for flexible in (False, True))],
    ids=["two", "six", "six flexible"],
)
def test_bodies_fit_an_estimate_from_torques_alone(twin: Twin) -> None:
    """Of a model a third off they predict another record as the estimate does, springs and all."""
    seconds, multisine = (5.0, 0.004) if any(twin.robot.flexible) else (8.0, 0.0)
    asked = (twin.records(seconds, seed, multisine=multisine) for seed in (1, 4))
    records, other = (recorded(twin.loop(), each, 0.02)[0] for each in asked)
    factors = np.random.default_rng(5).uniform(0.7, 1.3, len(twin.robot))
    links = tuple(replace(link, inertial=k * link.inertial) for link, k in zip(twin.robot.links, factors, strict=True))
    model = replace(twin.robot, links=links)
    estimate = identified(replace(twin.loop(), robot=model), records)
    found = consistent_robot(estimate)
    assert found.misfit < 0.2
    assert all(is_physical(link.inertial) for link in found.robot.links)
    held_out = validate(estimate, other)
    left = errors_of_bodies(estimate, found.robot, other)
    assert left == pytest.approx([a.filtered_error for a in held_out.axes], rel=0.05)
    assert held_out.filtered_error < held_out.nominal_error
    for mine, truth in zip(found.robot.joints, twin.robot.joints, strict=True):
        if mine.spring is not None and truth.spring is not None:
            assert mine.spring.stiffness == pytest.approx(truth.spring.stiffness, rel=0.05)
    hidden = hide_spring(estimate, "joint2")
    with pytest.raises(MethodError, match="does not show the spring of joint2, so it does not separate motor and link"):
        consistent_robot(hidden)


def test_idim_gives_a_robot_without_springs_the_friction_of_both_sides() -> None:
    twin = two((10.0, 14.0))
    records, _ = recorded(twin.loop(), twin.records(8.0), 0.01)
    found = consistent_robot(identified(twin.robot, records, filtering=Filtering(cutoff=4.0))).robot
    assert not any(found.flexible)
    for one, truth in zip(found.joints, twin.robot.joints, strict=True):
        assert one.viscous == pytest.approx(truth.viscous + truth.spring.viscous, rel=0.05)


@pytest.mark.slow
def test_noise_that_gives_no_bodies_still_gives_a_robot_that_can_be_simulated() -> None:
    estimate = identified(arm(3), records_of(arm(3), 4, noise=15.0))
    part = estimate.require_robot()
    spread = estimate.covariance_of(part.names).std
    found = consistent_robot(replace(estimate, robot=replace(part, values=part.values - 3 * spread)))
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, 3))
    links = found.robot.tree, found.robot.inertials
    assert min(np.linalg.eigvalsh(mass_matrix_at(*links, q))[0] for q in poses) > 0.0
    assert np.all(found.robot.of_joints("viscous") >= 0)
