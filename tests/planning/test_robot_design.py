"""The motion that tells most of a robot: its limits, its intervals beside those that are found, and its springs."""

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.estimation.robots.didim import search_robot
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint, RobotLoop
from jointid.planning import search as search_module
from jointid.planning.design import design
from jointid.planning.designed import Design
from jointid.planning.robots import RobotModel, _read_first, find_modes
from jointid.planning.search import complete, search
from jointid.records.record import Channel, Record
from jointid.simulation.synthesis import add_feed_forward, simulate
from tests.estimation.robots.twin import identified, logged, torque_of
from tests.models.robots.trees import inverse_dynamics
from tests.robots_plants import inertial, two


@pytest.fixture(autouse=True)
def count_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let fifty trials take a second: as many on a slow machine as on a fast one."""
    ticks = itertools.count()
    monkeypatch.setattr(search_module, "search", partial(search, clock=lambda: 0.01 * next(ticks)))


LIMITS = (
    AxisLimits(lower=-0.8, upper=1.2, speed=1.5, acceleration=6.0, torque=60.0),
    AxisLimits(lower=-1.0, upper=1.0, speed=2.0, acceleration=8.0, torque=20.0),
)
T = 2e-3


def measured(q: FloatArray, noise: FloatArray, seed: int) -> tuple[Record, ...]:
    """Return what two rigid joints log along a motion, with white noise."""
    robot = two().robot
    v = np.gradient(q, T, axis=0)
    torque = torque_of(robot, q, v, np.gradient(v, T, axis=0))
    return logged(robot, q, torque + noise * np.random.default_rng(seed).normal(size=q.shape), T)


def references(robot: Robot, q: FloatArray, sample_time: float = T) -> tuple[Record, ...]:
    """Return a motion of the joints as references of motors that are not coupled."""
    return tuple(
        Record(reference=Channel(one, robot.position_unit(k), sample_time)) for k, one in enumerate(q.T.copy())
    )


def stds(found: Design) -> FloatArray:
    """Return the predicted deviations."""
    return np.array(list(found.proposed.std.values()))


def reference_of(found: Design) -> FloatArray:
    """Return the references, (samples, n)."""
    return np.column_stack([one.reference.values for one in found.records() if one.reference is not None])


def test_a_motion_keeps_every_limit_and_begins_at_rest() -> None:
    found = design(two().robot, limits=LIMITS, duration=8.0, sample_time=T, search_time=0.4)
    q = reference_of(found)
    v, a = np.gradient(q, T, axis=0), np.gradient(np.gradient(q, T, axis=0), T, axis=0)
    for k, one in enumerate(LIMITS):
        assert one.lower < q[:, k].min() and q[:, k].max() < one.upper
        assert np.abs(v[:, k]).max() < (one.speed or 0.0) and np.abs(a[:, k]).max() < (one.acceleration or 0.0)
        assert np.abs(found.proposed.torques[k]).max() < (one.torque or 0.0)
    assert not found.passed
    assert np.abs(v[0]).max() < 2e-3 and np.abs(a[2]).max() < 0.2, "begins at rest"
    assert np.abs(q[-1] - q[0]).max() < 2e-3, "and ends where it began"
    weak = replace(LIMITS[0], torque=20.0)
    tight = design(two().robot, limits=(weak, LIMITS[1]), duration=8.0, sample_time=T, search_time=0.4)
    assert np.abs(tight.proposed.torques[0]).max() < 20.0 < np.abs(found.proposed.torques[0]).max()


def test_what_didim_will_report_is_predicted() -> None:
    loop, noise = two().loop(), np.array([0.4, 0.2])
    found = design(loop, limits=LIMITS, duration=6.0, sample_time=1e-3, search_time=0.4, noise=noise)
    driven, rng = found.records(), np.random.default_rng(5)
    drives = []
    for k, one in enumerate(simulate(loop, driven).records(driven)):
        values = one.torque.values + noise[k] * rng.normal(size=len(one.torque))
        drives.append(replace(one, torque=replace(one.torque, values=values)))
    fit = search_robot(loop, drives)
    assert fit.parameters.names == found.proposed.joint
    # Runs scatter as predicted (-0.002 in the logarithm), and report 0.12 to 0.76 more: the covariance of a fit takes
    # the larger of two estimates.
    assert -0.1 < np.mean(np.log(fit.covariance.std / stds(found))) < 1.0
    assert np.abs((fit.values - list(found.proposed.values.values())) / stds(found)).max() < 4.5


def test_a_first_record_says_its_noise_and_what_its_motion_tells() -> None:
    t = np.arange(4000) * T
    q = np.column_stack([0.4 * np.sin(1.5 * t), 0.3 * np.sin(2.3 * t)])
    noise = np.array([0.4, 0.2])
    records = measured(q, noise, 1)
    estimate = identified(two().robot, records)
    np.testing.assert_allclose(_read_first(estimate, records)[1], noise, rtol=0.15)
    found = design(estimate, records, limits=LIMITS, search_time=1.0)
    assert found.present is not None and np.mean(np.log(stds(found) / list(found.present.std.values()))) < np.log(0.5)
    wide, needed = (AxisLimits(), AxisLimits(speed=2.0)), RobotModel.needed
    taken = complete(wide, two().robot.names, needed, needed, found.present.reached)
    assert taken[0].upper == pytest.approx(0.4, rel=0.01) and taken[1].speed == 2.0


def played() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and accelerations of two joints, which turn round."""
    t = np.arange(2000) * T
    q = np.column_stack([0.4 * np.sin(1.5 * t), 0.3 * np.sin(2.3 * t)])
    v = np.gradient(q, T, axis=0)
    return q, v, np.gradient(v, T, axis=0)


def needed(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return the torques of links, rotors and friction by direction, of motors that are not coupled."""
    torque = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    torque += robot.of_joints("rotor_inertia") * a + robot.of_joints("offset")
    for k, joint in enumerate(robot.joints):
        viscous, viscous_back, _, back = joint.law.directions(joint.values, "")
        torque[:, k] += np.where(v[:, k] < 0, viscous_back, viscous) * v[:, k]
        torque[:, k] += np.where(v[:, k] < 0, -back, joint.coulomb)
    return torque


def test_the_predicted_torque_is_the_friction_of_each_direction_too() -> None:
    robot, (q, v, a) = two().robot, played()
    first, second = robot.joints
    joints = replace(first, viscous_backwards=25.0), replace(second, coulomb_backwards=12.0)
    robot = replace(robot, joints=joints)
    found = design(robot, limits=LIMITS, duration=4.0, sample_time=T, motion=references(robot, q))
    np.testing.assert_allclose(found.proposed.torques.T, needed(robot, q, v, a), atol=1e-6)
    about = found.proposed.values
    assert about["joint1.viscous_forwards"] == pytest.approx(first.viscous)
    assert about["joint1.viscous_backwards"] == pytest.approx(25.0)
    assert about["joint2.coulomb"] == pytest.approx(0.5 * (second.coulomb + 12.0))  # of both, beside an offset


def test_the_predicted_torque_has_the_weight_that_is_grouped_with_an_offset() -> None:
    links = (
        Link("slide", -1, "prismatic", inertial=inertial(10.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))),
        Link("hand", 0, axis=np.array([0.0, 1.0, 0.0]), inertial=inertial(2.0, (0.03, 0.0, 0.15), (0.02, 0.02, 0.004))),
    )
    robot, (q, v, a) = Robot(links, (RobotJoint("lift", 5.0, 20.0, 30.0), RobotJoint("wrist", 0.3, 1.2, 1.5))), played()
    found = design(robot, limits=LIMITS, duration=4.0, sample_time=T, motion=references(robot, q))
    np.testing.assert_allclose(found.proposed.torques.T, needed(robot, q, v, a), atol=1e-6)
    assert found.proposed.values["lift.offset"] == pytest.approx(12.0 * 9.81), "of what it lifts, without its rotor"


@pytest.mark.parametrize(("factor", "hertz"), [(0.0, 11.1), (1.0, 12.5), (2.0, 14.2)])
def test_the_mode_of_a_coupled_joint_is_that_with_the_other_shafts_held(factor: float, hertz: float) -> None:
    robot = two().robot
    first, second = robot.joints
    coupled = {"joint1": factor} if factor else {}
    joints = replace(first, spring=JointSpring(2000.0)), replace(second, coupling=coupled)
    assert find_modes(replace(robot, joints=joints), np.array([[0.4, -0.3]]))["joint1"] == pytest.approx(
        hertz, abs=0.05
    )


def test_slow_controllers_are_predicted_with_their_feed_forward() -> None:
    loop, t = two().loop(slower=8.0), np.arange(4000) * 1e-3
    q = np.column_stack([0.4 * (1 - np.cos(3.0 * t)), 0.3 * (1 - np.cos(4.6 * t))])
    asked = {
        "duration": 4.0,
        "sample_time": 1e-3,
        "loop": loop,
        "noise": (0.4, 0.2),
        "motion": references(loop.robot, q, 1e-3),
    }
    bare = design(loop.robot, limits=LIMITS, **asked)
    fed = design(loop.robot, limits=LIMITS, feed_forward="inverse-model", **asked)
    swings = [np.ptp(simulate(loop, one).motor_position) for one in (bare.records(), q_fed(loop, q))]
    assert swings[0] > 1.1 * swings[1], "without it they overshoot"
    assert np.mean(np.log(stds(fed) / stds(bare))) > 0.3, "and would tell more of a motion that will not be made"


def arm(stiffness: float) -> RobotLoop:
    """Return one link on a spring under a PD controller."""
    twin = two()
    link = replace(twin.robot.links[1], parent=-1)
    spring = JointSpring(stiffness, 1.0, 0.5, 0.5)
    joint = replace(twin.robot.joints[1], viscous=0.7, coulomb=1.0, spring=spring, coupling={})
    return RobotLoop(replace(twin.robot, links=(link,), joints=(joint,)), twin.loop().controllers[1:])


def test_the_intervals_of_a_spring_that_was_guessed_hold_over_the_guess() -> None:
    guess, truth = arm(600.0), arm(900.0)
    t = 1e-3 * np.arange(2500)
    ripple = 2e-3 * sum(np.sin(2 * np.pi * hertz * t + hertz) for hertz in (6.0, 9.0, 12.0))
    q = (0.3 * np.sin(1.6 * np.pi * t) + ripple) * np.sin(0.4 * np.pi * t) ** 2
    asked = {"limits": LIMITS[1:], "noise": (0.05,), "motion": references(guess.robot, q[:, np.newaxis], 1e-3)}
    found = design(guess, within=40.0, **asked)
    played = design(truth, **asked)
    assert found.proposed.std["joint2.stiffness"] < played.proposed.std["joint2.stiffness"] / 1.3, "of the guess itself"
    worst = np.array(list(found.tests["at worst"].std.values()))
    assert np.all(worst > stds(played) / 1.3)
    assert found.axes[0].reached["torque"] > played.axes[0].reached["torque"]


def q_fed(loop: RobotLoop, q: FloatArray) -> tuple[Record, ...]:
    """Return references of two motors with the feed-forward of the inverse model."""
    return add_feed_forward(loop, tuple(Record(reference=Channel(one, "rad", 1e-3)) for one in q.T.copy()))


def test_limits_of_the_model_complete_those_that_are_given() -> None:
    robot = two().robot
    links = tuple(replace(link, limits=AxisLimits(lower=-0.3, upper=0.2, speed=0.7)) for link in robot.links)
    asked = {"duration": 4.0, "sample_time": T, "search_time": 0.2}
    found = design(replace(robot, links=links), limits=(AxisLimits(speed=0.5), AxisLimits(upper=0.1)), **asked)
    q = reference_of(found)
    assert np.all(q > -0.3) and np.all(q < [0.2, 0.1])
    assert np.all(np.abs(np.gradient(q, T, axis=0)).max(axis=0) < [0.5, 0.7])
