"""Springs in an estimate of a robot, and its parameters as sums of a robot's numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from jointid.common.arrays import FloatArray
from jointid.common.text import interval
from jointid.models.robots.robot import Robot
from jointid.uncertainty.covariance import Covariance

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

    @property
    def refused(self) -> SpringVerdict:
        """The same spring, not shown."""
        return replace(self, shown=False, stiffness=None, deviation=None)

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
