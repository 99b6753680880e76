"""Parts of a robot, and what is computed of a robot alone: `ji.robots.Link(...)`."""

from jointid.config.robot_model import load_robot
from jointid.estimation.robots.consistent import consistent_robot
from jointid.models.robots.robot import JointSpring, Link, RobotJoint
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop, add_feed_forward

__all__ = [
    "JointSpring", "Link", "RobotDriveSide", "RobotJoint", "RobotLoop", "add_feed_forward", "consistent_robot",
    "load_robot",
]  # fmt: skip
