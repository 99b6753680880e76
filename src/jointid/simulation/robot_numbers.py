"""The numbers of a robot as its simulations read them, and the places of parameters among them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import JointSpring, Robot
from jointid.simulation.kernels.drive import IntArray
from jointid.simulation.kernels.robot_loop import Bodies

Bools: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RobotNumbers:
    """The numbers of a candidate, as the kernel reads them.

    Attributes:
        inertials: (n, 10) of the links. rotors: (n,) the mass that each motor drives.
        masses: (masses, 8) of the links, then of the rotors of flexible joints: inertia of the rotor (0 for the link of
            a flexible joint), viscous, Coulomb and constant friction, what viscous friction has more forwards, and
            backwards, what Coulomb friction rises by towards standstill, and the speed below which it does (0 of one
            that does not).
        springs: (n, 2) stiffness and damping; 0 for rigid joints.
        beside: (n, 2) position and velocity of each flexible joint's link at the first sample, beside where steady
            motion has it; or (0, 2). log: (1, 1) s, by which the log shows torques late; or (0, 1). Both are read where
            the record prescribes the motors' motion (`robot_drive_side`), and nowhere else.
    """

    inertials: FloatArray
    rotors: IntArray
    masses: FloatArray
    springs: FloatArray
    beside: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    log: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))

    @classmethod
    def of(cls, robot: Robot) -> RobotNumbers:
        """Return those of a robot."""
        joints, n = robot.joints, len(robot.links)
        flexible = [i for i, joint in enumerate(joints) if joint.spring is not None]
        rotors, springs = np.arange(n), np.zeros((n, 2))
        rotors[flexible] = n + np.arange(len(flexible))
        masses = np.zeros((n + len(flexible), 8))
        for i, joint in enumerate(joints):
            viscous = (0.0, joint.viscous, joint.viscous_back) if joint.asymmetric else (joint.viscous, 0.0, 0.0)
            rise = joint.stribeck_force, joint.stribeck_speed or 0.0
            masses[rotors[i]] = joint.rotor_inertia, viscous[0], *joint.coulomb_both, *viscous[1:], *rise
            if joint.spring is not None:
                springs[i] = joint.spring.stiffness, joint.spring.damping
                masses[i, 1:3] = joint.spring.viscous, joint.spring.coulomb
        return cls(robot.inertials, rotors, masses, springs)

    @property
    def bodies(self) -> Bodies:
        """What the kernels read."""
        return Bodies(self.inertials, self.rotors, self.masses, self.springs)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """What parameters are numbers of, in the order of `NumberOf`."""
        return self.inertials, self.masses, self.springs, self.beside, self.log

    @property
    def sliding(self) -> Bools:
        """Which masses have Coulomb friction, (masses,), so that they may rest."""
        return np.asarray(self.masses[:, 2] + self.masses[:, 6] > 0.0)

    @property
    def flexible(self) -> Bools:
        """Which joints are flexible, (n,)."""
        return np.asarray(self.rotors >= self.rotors.size)

    @property
    def possible(self) -> bool:
        """True if rotors have an inertia, rising friction has a speed, none is negative, and all are numbers."""
        finite = all(bool(np.all(np.isfinite(values))) for values in self.arrays)
        turning, held = self.masses[self.rotors.size :, 0], self.springs[self.flexible, 0]
        least = min(float(np.min(self.masses[:, [1, 2, 4, 5, 6, 7]])), float(np.min(self.springs)))
        risen = self.masses[:, 7][self.masses[:, 6] > 0.0]
        return finite and least >= 0.0 and bool(np.all(turning > 0.0) and np.all(held > 0.0) and np.all(risen > 0.0))


class NumberOf(IntEnum):
    """What a parameter is a number of: a row of `RobotNumbers`."""

    LINK = 0
    MASS = 1
    SPRING = 2
    BESIDE = 3
    LOG = 4


@dataclass(frozen=True, slots=True)
class NumberPlace:
    """The place of a parameter among a candidate's numbers.

    Attributes:
        of: whose rows. row: which. column: of it.
    """

    of: NumberOf
    row: int
    column: int

    @property
    def is_friction(self) -> bool:
        """Whether it is a friction, a constant torque, or a spring's damping: no inertia and no stiffness."""
        return self.of in (NumberOf.MASS, NumberOf.SPRING) and self.column != 0

    @property
    def is_positive(self) -> bool:
        """Whether it is of no robot below 0: friction, a stiffness, a damping."""
        return self.of is NumberOf.SPRING or (self.of is NumberOf.MASS and self.column != 3)

    @property
    def is_of_record(self) -> bool:
        """Whether it is of the record and how it begins, not of the robot."""
        return self.of in (NumberOf.BESIDE, NumberOf.LOG)

    def read(self, numbers: RobotNumbers) -> float:
        """Return the number."""
        return float(numbers.arrays[self.of][self.row, self.column])


def stribeck_share(masses: FloatArray, speeds: FloatArray) -> FloatArray:
    """Return the share of its rise that a friction has at a speed, as masses and speeds broadcast.

    ``exp(-(v / vS)^2)``, as of one joint (`models.friction.StribeckFriction`).
    """
    below = masses[..., 7]
    return np.where(below > 0.0, np.exp(-((speeds / np.where(below > 0.0, below, 1.0)) ** 2)), 0.0)


def robot_with(robot: Robot, numbers: RobotNumbers) -> Robot:
    """Return a robot with other numbers; names, places, gravity and coupling stay.

    A Coulomb friction that is another backwards is one of both directions and an offset.

    Raises:
        MethodError: a rotor's inertia, with what is grouped with it, is negative.
    """
    joints = []
    for i, joint in enumerate(robot.joints):
        own, link = numbers.masses[numbers.rotors[i]], numbers.masses[i]
        spring = None
        if numbers.flexible[i]:
            spring = JointSpring(*map(float, (*numbers.springs[i], link[1], link[2])))
        inertia, viscous, coulomb, offset, forwards, backwards, rise, below = map(float, own)
        joints.append(
            replace(
                joint,
                rotor_inertia=inertia,
                viscous=viscous + forwards,
                coulomb=coulomb,
                offset=offset,
                viscous_backwards=viscous + backwards if joint.asymmetric else None,
                coulomb_backwards=None,
                stribeck_force=rise,
                stribeck_speed=below or None,
                spring=spring,
            )
        )
    return replace(robot.with_inertials(numbers.inertials), joints=tuple(joints))


def with_values(numbers: RobotNumbers, places: tuple[NumberPlace, ...], values: FloatArray) -> RobotNumbers:
    """Return a candidate with other numbers in these places."""
    inertials, masses, springs, beside, log = arrays = tuple(one.copy() for one in numbers.arrays)
    for place, value in zip(places, values, strict=True):
        arrays[place.of][place.row, place.column] = value
    return replace(numbers, inertials=inertials, masses=masses, springs=springs, beside=beside, log=log)


def all_places(numbers: RobotNumbers) -> tuple[NumberPlace, ...]:
    """Return the places of every number that a robot has: masses, then springs, then links."""
    n = numbers.rotors.size
    masses = [
        NumberPlace(NumberOf.MASS, row, column)
        for row in range(len(numbers.masses))
        for column in (*((0, 2, 3, 4, 5) if np.any(numbers.masses[row, 4:6]) else range(4)), 6)
        if (row in numbers.rotors or column in (1, 2)) and (column != 6 or numbers.masses[row, 7] > 0.0)
    ]
    springs = [
        NumberPlace(NumberOf.SPRING, int(i), column) for i in np.flatnonzero(numbers.flexible) for column in (0, 1)
    ]
    links = [NumberPlace(NumberOf.LINK, row, column) for row in range(n) for column in range(10)]
    return (*masses, *springs, *links)
