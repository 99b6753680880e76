"""A robot and its parts, `ji.robots.Link(...)`, and what is computed of a robot alone."""

from jointid.config.robot_model import load_robot
from jointid.estimation.robots.bodies import consistent_robot, identify_payload
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint, RobotLoop
from jointid.simulation.synthesis import add_feed_forward

__all__ = [
    "JointSpring", "Link", "Robot", "RobotJoint", "RobotLoop", "add_feed_forward",
    "consistent_robot", "identify_payload", "load_robot",
]  # fmt: skip
