"""The friction of a robot's motors as sums: the numbers of each motor's law, and what each is multiplied with.

A Coulomb friction that is another backwards is one of both directions and an offset, the same torques also at rest. One
that rises towards standstill has its rise as a number; the speed below which it does is taken as given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.friction import low_speed_share
from jointid.models.robots.names import name_of, symbol_of
from jointid.models.robots.robot import Robot, RobotJoint


class Friction(StrEnum):
    """The numbers that a motor's friction may have."""

    VISCOUS = "viscous"
    FORWARDS = "viscous_forwards"
    BACKWARDS = "viscous_backwards"
    COULOMB = "coulomb"
    RISE = "stribeck_force"
    OFFSET = "offset"


@dataclass(frozen=True, slots=True)
class FrictionTerm:
    """One number of one motor's friction.

    Attributes:
        joint: its place. number: which.
    """

    joint: int
    number: Friction

    @property
    def symbol(self) -> str:
        """The symbol with the joint's number from 1: "Fc2", "Fv2+"."""
        return symbol_of(self.number, self.joint)

    def name(self, robot: Robot) -> str:
        """Return the name with that of the joint: "elbow.coulomb"."""
        return name_of(self.number, robot.joints[self.joint].name)

    def unit(self, robot: Robot) -> str:
        """Return its unit, SI."""
        torque = robot.torque_unit(self.joint)
        return f"{torque} s/{robot.position_unit(self.joint)}" if self.number.startswith("viscous") else torque

    def value(self, joint: RobotJoint) -> float:
        """Return the number of a joint's motor, the link's side apart."""
        _, _, coulomb, coulomb_back = joint.law.directions(joint.motor)
        sums = {Friction.OFFSET: joint.constant_torque, Friction.COULOMB: 0.5 * (coulomb + coulomb_back)}
        return sums.get(self.number, joint.motor[self.number])

    def column(self, v: FloatArray, joint: RobotJoint) -> FloatArray:
        """Return its regressor column at speeds of the motor, (samples,)."""
        if self.number is Friction.RISE:
            return np.asarray(np.sign(v) * low_speed_share(v / joint.motor["stribeck_speed"]))
        return {
            Friction.VISCOUS: v,
            Friction.FORWARDS: np.maximum(v, 0.0),
            Friction.BACKWARDS: np.minimum(v, 0.0),
            Friction.COULOMB: np.sign(v),
            Friction.OFFSET: np.ones_like(v),
        }[self.number]


def friction_terms(robot: Robot) -> tuple[FrictionTerm, ...]:
    """Return the numbers of all motors' friction, joint by joint: of each viscous and Coulomb friction, and an offset.

    Viscous friction has two numbers where the model says that it is another backwards, and a Coulomb friction that
    rises towards standstill has its rise.

    Raises:
        MethodError: a law is not linear in its parameters.
    """
    robot.require_linear("IDIM of a robot takes", 'identify the robot by "didim"')
    found = []
    for k, joint in enumerate(robot.joints):
        viscous = (Friction.FORWARDS, Friction.BACKWARDS) if joint.asymmetric else (Friction.VISCOUS,)
        rise = () if joint.law.linear else (Friction.RISE,)
        found += [FrictionTerm(k, one) for one in (*viscous, Friction.COULOMB, *rise, Friction.OFFSET)]
    return tuple(found)


def offset_indices(robot: Robot) -> list[int]:
    """Return the indices of the offsets among `friction_terms`, one for each joint."""
    return [i for i, term in enumerate(friction_terms(robot)) if term.number is Friction.OFFSET]


def friction_columns(robot: Robot, v: FloatArray) -> FloatArray:
    """Return the columns of the motors' friction, (samples, n, terms), at velocities of the joints, (samples, n)."""
    turning, terms = v @ robot.coupling.T, friction_terms(robot)
    found = np.zeros((*v.shape, len(terms)))
    for i, term in enumerate(terms):
        found[:, term.joint, i] = term.column(turning[:, term.joint], robot.joints[term.joint])
    return found


def friction_values(robot: Robot) -> FloatArray:
    """Return the numbers of the motors' friction, (terms,)."""
    return np.array([term.value(robot.joints[term.joint]) for term in friction_terms(robot)])


def joint_with_friction(joint: RobotJoint, numbers: dict[Friction, float]) -> RobotJoint:
    """Return a joint whose motor has the numbers of `friction_terms`; the spring and the inertia stay."""
    forwards, coulomb = numbers.get(Friction.FORWARDS), numbers[Friction.COULOMB]
    viscous = numbers[Friction.VISCOUS] if forwards is None else forwards
    backwards = numbers.get(Friction.BACKWARDS)
    found = {
        "viscous": viscous, "viscous_forwards": viscous, "viscous_backwards": backwards, "coulomb": coulomb,
        "coulomb_forwards": coulomb, "coulomb_backwards": coulomb, "stribeck_force": numbers.get(Friction.RISE),
    }  # fmt: skip
    own = {name: found.get(name.removeprefix("motor_"), value) for name, value in joint.numbers.items()}
    return replace(
        joint,
        viscous=viscous,
        viscous_backwards=backwards,
        coulomb=coulomb,
        coulomb_backwards=None,
        stribeck_force=0.0 if "stribeck_force" in own else numbers.get(Friction.RISE, 0.0),
        offset=numbers[Friction.OFFSET],
        numbers={name: value for name, value in own.items() if value is not None},
    )
