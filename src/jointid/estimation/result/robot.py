"""The robot-only content of an estimate: the nominal robot, and parameters as sums of its numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from jointid.common.arrays import FloatArray
from jointid.common.text import interval
from jointid.models.robots.robot import Robot
from jointid.uncertainty.covariance import Covariance

if TYPE_CHECKING:
    from jointid.simulation.robot_drive_side import RobotDriveSide
    from jointid.simulation.robots import RobotLoop

KNOWN = 0.1
"""Relative standard error of a parameter that counts as known."""

_TWO = 2.0  # standard deviations


@dataclass(frozen=True, slots=True)
class SpringVerdict:
    """Whether the records show the spring of a joint.

    Attributes:
        joint: its name.
        shown: whether they do.
        stiffness: N m/rad or N/m; None where it is refused. deviation: of it, one standard deviation.
        at_least: the stiffness that it has at least, two standard deviations of its compliance away.
        unit: of these, N m/rad or N/m.
    """

    joint: str
    shown: bool
    stiffness: float | None
    deviation: float | None
    at_least: float
    unit: str = "N m/rad"

    def __str__(self) -> str:
        if self.stiffness is None or self.deviation is None:
            least = f"{self.at_least:.3g} {self.unit}"
            return f"{self.joint}: the records do not show a spring; its stiffness is at least {least}"
        return f"{self.joint}: stiffness {interval(self.stiffness, _TWO * self.deviation)} {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """The parameters of an estimate as sums of a robot's own numbers.

    Attributes:
        values: (parameters,) as they were identified. covariance: of these.
        of_standard: (parameters, 11 n) what inertial parameters, link by link, then rotors add to each.
        of_others: (parameters, others) what all else adds: friction, offsets, springs.
        others: (others,) about what these are. least: (others,) below which none of them is.
        robot: makes a robot of inertial parameters, (n, 10), rotors, (n,), and the others.
    """

    values: FloatArray
    covariance: Covariance
    of_standard: FloatArray
    of_others: FloatArray
    others: FloatArray
    least: FloatArray
    robot: Callable[[FloatArray, FloatArray, FloatArray], Robot]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IdentifiedRobot(ABC):
    """The robot-only content of an estimate.

    Attributes:
        setup: the nominal robot at the start of the identification: alone, under its controllers, or along the
            motion of its motors.
        names: (parameters,) in the order of all arrays.
        values: (parameters,) in SI units; that of a refused parameter is not to be used.
        covariance: of the values; 0 for a fixed parameter.
        nominal: (parameters,) of the nominal robot.
        nominal_errors: (n,) share of each joint's filtered torque that the nominal robot leaves, with friction as
            identified or fitted beside it; infinite where it cannot be simulated.
        formulas: (parameters,) the sums of standard parameters; the symbol of a parameter that is no sum.
        springs: a verdict for each flexible joint.
    """

    in_json = "nominal nominal_errors log_delay -setup -covariance -parameters -base"
    setup: Robot | RobotLoop | RobotDriveSide
    names: tuple[str, ...]
    values: FloatArray
    covariance: Covariance
    nominal: FloatArray
    nominal_errors: FloatArray
    formulas: tuple[str, ...]
    springs: tuple[SpringVerdict, ...] = ()

    @property
    def model(self) -> Robot:
        """The nominal robot."""
        return self.setup if isinstance(self.setup, Robot) else self.setup.robot

    @property
    def log_delay(self) -> float | None:
        """Seconds by which the log shows torques late; None where the method does not say."""
        return None

    @property
    def has_controllers(self) -> bool:
        """True if the robot was identified under its controllers."""
        return hasattr(self.setup, "controllers")

    @property
    @abstractmethod
    def of_standard(self) -> FloatArray:
        """Weights in each parameter of the links' inertial parameters, then of the rotors, (parameters, 11 n)."""

    @abstractmethod
    def sums(self, prior: Robot) -> Sums:
        """Return the parameters as sums of the numbers of a robot of this tree."""

    @abstractmethod
    def regressor(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the columns of the motors' torques in a motion without deflection, (samples, n, parameters).

        Args:
            q: (samples, n) positions of the joints, rad or m.
            v: (samples, n) their velocities.
            a: (samples, n) their accelerations.

        Raises:
            MethodError: a friction is not linear in its parameters.
        """

    @abstractmethod
    def robot(self) -> Robot:
        """Return the robot that was identified, for a simulation: the same torques.

        What is grouped stands in the parameter that is kept, so that its links need not be bodies.

        Raises:
            MethodError: a rotor's inertia, with what is grouped with it, was found negative.
        """

    @abstractmethod
    def parameters_of(self, robot: Robot) -> FloatArray | None:
        """Return the same parameters of a known robot; None where it has others."""
