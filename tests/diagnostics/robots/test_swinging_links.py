"""How much stiffer a robot's spring may be, behind a link a part of which swings on a spring of its own."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint
from jointid.models.springs import ElasticLoad

LAW = ji.controller.PD(position_gain=1200.0, derivative_gain=60.0)
JOINT = ji.FlexibleJoint("revolute")
STIFFNESS = 4500.0
TRUE = {
    "motor_inertia": 0.8, "motor_viscous": 1.8, "motor_coulomb": 2.8, "stiffness": STIFFNESS, "damping": 3.6,
    "load_inertia": 0.85, "load_viscous": 1.2, "load_coulomb": 1.2, "offset": 0.0,
}  # fmt: skip


def logged(share):
    """Return the log of a joint, with noise of 2 %, a share of whose load swings at 2.3 times the first mode."""
    draw, t = np.random.default_rng(1), np.arange(3000) * 1e-3
    hertz, grow = 3.0 + np.arange(24) * 1.35, np.clip(t / 0.6, 0.0, 1.0)
    waves = np.sin(2 * np.pi * np.outer(t, hertz) + draw.uniform(0.0, 2 * np.pi, hertz.size)) @ (hertz[0] / hertz)
    reference = 0.8 * np.sin(np.pi * t) * grow**3 + 0.004 * waves / np.std(waves) * grow**2
    values = {**TRUE, **ElasticLoad().start(TRUE, share, 2.3), "stiffness": STIFFNESS} if share else TRUE
    joint = replace(JOINT, spring=ElasticLoad()) if share else JOINT
    record = ji.simulated_record(ji.ClosedLoop(joint, LAW), reference, values, sample_time=1e-3)
    noise = 0.02 * np.std(record.torque.values) * draw.standard_normal(t.size)
    torque = replace(record.torque, values=record.torque.values + noise)
    return replace(record, torque=torque, motor_position=None, load_position=None)


def identified(record):
    """Return the stiffness of a robot of one joint, and what its check says of the link."""
    link = Link("link", -1, "revolute", np.array([0.0, 0.0, 1.0]), np.eye(3), np.zeros(3), np.zeros(10))
    robot = Robot((link,), (RobotJoint("joint", 1.0, 0.0, 0.0, spring=JointSpring(1.0)),), np.array([0.0, 0.0, -9.81]))
    found = ji.identify([record], ji.robots.RobotLoop(robot, (LAW,)), ji.DIDIM())
    (said,) = found.checks.diagnosis.assumed
    assert any(said.words in verdict.said for verdict in found.checks.verdicts)
    return found.params["joint.stiffness"].value, said


def test_a_spring_that_came_out_too_soft_may_be_as_much_stiffer_as_it_is():
    stiffness, said = identified(logged(0.5))
    assert stiffness < 0.93 * STIFFNESS
    assert said.words.startswith("joint: that the load is rigid is assumed: if 50 % of it swings at ")
    assert stiffness * (1.0 + said.values["stiffer"]) == pytest.approx(STIFFNESS, rel=0.03)


@pytest.mark.slow
def test_a_robot_of_one_joint_says_what_the_joint_says():
    record = logged(0.0)
    alone = ji.identify(record, ji.ClosedLoop(JOINT, LAW)).checks.diagnosis.axes[0].faults.assumed
    said = identified(record)[1]
    assert said.values["stiffer"] == pytest.approx(alone.values["stiffer"], rel=0.1)
    assert said.values["second_mode"] == pytest.approx(alone.values["second_mode"], rel=0.1)
