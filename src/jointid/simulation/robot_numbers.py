"""The numbers of a robot as its simulations read them, and the places of parameters among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter
from jointid.models.friction import BESIDE, KNOTS, Friction
from jointid.models.robots.robot import JointSpring, Robot
from jointid.models.springs import Spring
from jointid.simulation.kernels.tables import HIGH, IntArray, Plant
from jointid.simulation.plant import (
    IMAGINARY,
    AnyArray,
    Blocks,
    assemble,
    is_possible,
    lower_mass,
    lower_spring,
    slope,
)

Bools: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RobotNumbers:
    """The numbers of a candidate, as the kernel reads them.

    Attributes:
        inertials: (n, 10) of the links. rotors: (n,) the mass that each motor drives.
        masses: (masses, MassNumbers) of the links, then of the rotors of flexible joints.
        springs: (n, SPRING_NUMBERS); 0 for rigid joints.
        laws: (n,) of each joint the friction of both sides, and the spring of one that has it.
        beside: (n, 2) position and velocity of each flexible joint's link at the first sample, beside where steady
            motion has it; or (0, 2). log: (1, 1) s, by which the log shows torques late; or (0, 1). Both are read where
            the record prescribes the motors' motion (`drive_side`), and nowhere else.
        delays: (n, 1) s, by which each motor's torque acts later than its law puts it out; or (0, 1), those of the
            laws.
    """

    inertials: FloatArray
    rotors: IntArray
    masses: FloatArray
    springs: FloatArray
    laws: tuple[tuple[Friction, Spring | None], ...]
    beside: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    log: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))
    delays: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))

    @classmethod
    def of(cls, robot: Robot) -> RobotNumbers:
        """Return those of a robot."""
        joints, n = robot.joints, len(robot.links)
        flexible = [i for i, joint in enumerate(joints) if joint.spring is not None]
        rotors, springs = np.arange(n), np.zeros((n, len(SPRING_NUMBERS)))
        rotors[flexible] = n + np.arange(len(flexible))
        masses = np.zeros((n + len(flexible), len(MassNumbers)))
        for i, joint in enumerate(joints):
            values, law = joint.values, joint.law
            if joint.spring is None:
                masses[i] = _mass_row(law, values, "", joint.rotor_inertia)
                continue
            masses[rotors[i]] = _mass_row(law, values, "motor_", joint.rotor_inertia)
            masses[i] = _mass_row(law, values | {"offset": 0.0}, "load_", 0.0)
            springs[i] = [values.get(name, 0.0) for name in SPRING_NUMBERS]
        laws = tuple((joint.law, None if joint.spring is None else joint.spring.law) for joint in joints)
        return cls(robot.inertials, rotors, masses, springs, laws)

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """The law of every mass: of the links, then of the rotors behind springs."""
        return tuple(law for law, _ in self.laws) + tuple(law for law, spring in self.laws if spring is not None)

    @property
    def plant(self) -> Plant:
        """Masses and springs as the kernels read them."""
        masses = [mass_of(row, law) for row, law in zip(self.masses, self.frictions, strict=True)]
        flexible = [int(i) for i in np.flatnonzero(self.flexible)]
        springs = [spring_of(self.springs[i], self.laws[i][1]) for i in flexible]
        carriers = np.full(len(masses), -1)
        carriers[flexible] = np.arange(len(flexible))
        pairs = [(i, int(self.rotors[i])) for i in flexible]
        return assemble(masses, springs, np.zeros((0, 5)), pairs, self.rotors.tolist(), carriers.tolist())

    @property
    def count(self) -> int:
        """Number of masses."""
        return len(self.masses)

    @property
    def motors(self) -> list[int]:
        """The mass that each motor drives."""
        return [int(row) for row in self.rotors]

    straight: ClassVar[bool] = False
    """Whether its simulation is that of lines alone."""

    def carrying(self, payload: Sequence[float]) -> RobotNumbers:
        """Return the robot with a payload on its last link, (10,); or ()."""
        if not payload:
            return self
        inertials = self.inertials.copy()
        inertials[-1] += payload
        return replace(self, inertials=inertials)

    def with_heavy_motors(self, heavy: float) -> RobotNumbers:
        """Return the robot with motors so heavy that they follow a prescribed motion."""
        masses = self.masses.copy()
        masses[self.rotors] = 0.0
        masses[self.rotors, 0] = heavy
        return replace(self, masses=masses)

    def not_zero(self) -> tuple[list[NumberPlace], FloatArray]:
        """Return the places of the numbers that are not 0, and the numbers; of a rise its share has the speed."""
        places = [
            NumberPlace(of, int(row), int(column))
            for of in (NumberOf.LINK, NumberOf.MASS, NumberOf.SPRING)
            for row, column in np.argwhere(self.arrays[of] != 0.0)
            if of is not NumberOf.MASS or column != MassNumbers.SPEED
        ]
        return places, np.array([place.read(self) for place in places])

    def neighbours(self, place: NumberPlace, share: float) -> tuple[RobotNumbers, RobotNumbers, float] | None:
        """Return the numbers with less and more of one, and the difference; None of what is no number of a robot."""
        if place.is_of_record:
            return None
        value = place.read(self)
        step = share * (abs(value) or 1.0)
        low, high = (with_values(self, (place,), np.array([value + by])) for by in (-step, step))
        return low, high, 2.0 * step

    def blocks(self, places: Sequence[Any]) -> Blocks:
        """Return the derivatives of the plant's numbers by parameters, by a complex step: rational functions."""
        spring, found = len(self.masses) - 1 + np.cumsum(self.flexible), list[tuple[int, int, FloatArray]]()
        for c, place in enumerate(places):
            if place.of not in (NumberOf.MASS, NumberOf.SPRING):
                continue
            row = self.arrays[place.of][place.row].astype(np.complex128)
            row[place.column] += 1j * IMAGINARY
            if place.of is NumberOf.MASS:
                found.append((c, place.row, slope(mass_of(row, self.frictions[place.row]))[:, :HIGH]))
            else:
                found.append((c, int(spring[place.row]), slope(spring_of(row, self.laws[place.row][1]))))
        return found

    @staticmethod
    def links(places: Sequence[Any]) -> list[tuple[int, int, int]]:
        """Return the parameters that are numbers of links: which, of which link, in which column."""
        return [(c, place.row, place.column) for c, place in enumerate(places) if place.of is NumberOf.LINK]

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Arrays with the numbers of parameters, in the order of `NumberOf`."""
        return self.inertials, self.masses, self.springs, self.beside, self.log, self.delays

    @property
    def sliding(self) -> Bools:
        """True for masses with Coulomb friction, (masses,)."""
        return np.asarray(self.masses[:, 2] + self.masses[:, 6] > 0.0)

    @property
    def flexible(self) -> Bools:
        """Which joints are flexible, (n,)."""
        return np.asarray(self.rotors >= self.rotors.size)

    def possible(self, duration: float) -> bool:
        """Return True if all numbers are physically possible for that many seconds.

        Rotors behind springs have an inertia, friction that rises has a speed, a hysteresis slips, pieces of a spring
        follow each other, friction per torque is below 1, and Coulomb friction that drifts stays above 0.
        """
        unsigned = [MassNumbers.VISCOUS, MassNumbers.COULOMB, MassNumbers.FORWARDS, MassNumbers.BACKWARDS]
        late, held = np.append(self.delays, 0.0), self.springs[self.flexible, 0]
        return (
            all(bool(np.all(np.isfinite(values))) for values in self.arrays)
            and min(float(np.min(self.masses[:, unsigned])), float(np.min(late))) >= 0.0
            and bool(np.max(late) <= duration)
            and bool(np.all(held > 0.0))
            and is_possible(self.plant, duration, self.rotors.size)
        )


class MassNumbers(IntEnum):
    """The numbers of a mass: of its rotor and of its friction, whatever its law."""

    INERTIA = 0
    VISCOUS = 1
    COULOMB = 2
    OFFSET = 3
    FORWARDS = 4
    """What viscous friction has more forwards."""
    BACKWARDS = 5
    RISE = 6
    """What Coulomb friction rises by towards standstill."""
    SPEED = 7
    PRESLIDING = 8
    VISCOUS_DRIFT = 9
    COULOMB_DRIFT = 10
    PER_TORQUE = 11


_DRIFTS = MassNumbers.VISCOUS_DRIFT, MassNumbers.COULOMB_DRIFT
_BESIDE_LINES = {name: MassNumbers(MassNumbers.RISE + i) for i, name in enumerate(BESIDE)}
SPRING_NUMBERS = (
    "stiffness", "damping", "gap", "stiffness_2", "stiffness_3", "torque_1", "torque_2", "cubic_stiffness",
    "hysteresis_stiffness", "hysteresis_torque",
)  # fmt: skip
"""The numbers of a spring, whatever its law, by the names of a joint's parameters."""


def _mass_row(law: Friction, values: Mapping[str, float], prefix: str, inertia: float) -> FloatArray:
    """Return the numbers of a mass: a Coulomb friction of two sizes is one of their mean and a constant friction.

    The viscous friction of a link is one of both directions unless these differ: `JointSpring` has one.
    """
    row = np.zeros(len(MassNumbers))
    forwards, backwards, coulomb, coulomb_back = law.directions(values, prefix)
    one = not law.two_ways or (prefix == "load_" and forwards == backwards)
    row[: MassNumbers.RISE] = (
        inertia, forwards if one else 0.0, 0.5 * (coulomb + coulomb_back),
        values["offset"] + 0.5 * (coulomb - coulomb_back), 0.0 if one else forwards, 0.0 if one else backwards,
    )  # fmt: skip
    row[MassNumbers.RISE :] = [law.beside(values, prefix)[name] for name in BESIDE]
    return row


def friction_values(row: AnyArray) -> dict[str, Any]:
    """Return the numbers of a mass by the names of any law of friction; the offset stands apart."""
    viscous, coulomb = row[MassNumbers.VISCOUS], row[MassNumbers.COULOMB]
    found = dict(zip(BESIDE, row[MassNumbers.RISE :], strict=True)) | {"viscous": viscous}
    found |= dict.fromkeys(("coulomb", "coulomb_forwards", "coulomb_backwards"), coulomb)
    found["viscous_forwards"] = viscous + row[MassNumbers.FORWARDS]
    return found | {"viscous_backwards": viscous + row[MassNumbers.BACKWARDS]}


def values_of_joint(numbers: RobotNumbers, joint: int) -> dict[str, float]:
    """Return the numbers of friction and spring of a joint by the names of its parameters; the offset stands apart."""
    motor, link = numbers.masses[numbers.rotors[joint]], numbers.masses[joint]
    if not numbers.flexible[joint]:
        return {name: float(value) for name, value in friction_values(motor).items()}
    found = {f"motor_{name}": value for name, value in friction_values(motor).items()}
    found |= {f"load_{name}": value for name, value in friction_values(link).items()}
    found["load_coulomb_forwards"] += link[MassNumbers.OFFSET]
    found["load_coulomb_backwards"] -= link[MassNumbers.OFFSET]
    found |= dict(zip(SPRING_NUMBERS, numbers.springs[joint], strict=True))
    return {name: float(value) for name, value in found.items()}


def law_places(numbers: RobotNumbers) -> list[tuple[NumberPlace, Parameter]]:
    """Return the nonlinear numbers of the laws by joint: of the motors, the springs and the links.

    Each with its parameter in the law. A side of a joint whose friction rises below no speed has no rise.
    """
    found = []
    for i, (friction, spring) in enumerate(numbers.laws):
        sides = ((int(numbers.rotors[i]), "motor_"), (i, "load_")) if spring is not None else ((i, ""),)
        for row, prefix in sides:
            for p in friction.parameters(prefix):
                column = _BESIDE_LINES.get(p.name.removeprefix(prefix))
                rises = (
                    column not in (MassNumbers.RISE, MassNumbers.SPEED) or numbers.masses[row, MassNumbers.SPEED] > 0.0
                )
                found += [] if column is None or not rises else [(NumberPlace(NumberOf.MASS, row, column), p)]
        for p in () if spring is None else spring.parameters:
            at = SPRING_NUMBERS.index(p.name)
            found += [] if at < 2 else [(NumberPlace(NumberOf.SPRING, i, at), p)]
    return found


def mass_of(row: AnyArray, law: Friction) -> AnyArray:
    """Return a mass as the kernels read it, from its numbers; complex of complex ones."""
    rises = law.linear or law.stepped or row[MassNumbers.SPEED] != 0.0
    inertia, offset = row[MassNumbers.INERTIA], row[MassNumbers.OFFSET]
    return lower_mass(inertia, offset, law if rises else law.lines, friction_values(row))


def spring_of(row: AnyArray, law: Spring | None) -> AnyArray:
    """Return a spring as the kernels read it, from its numbers; complex of complex ones."""
    assert law is not None
    return lower_spring(law, dict(zip(SPRING_NUMBERS, row, strict=True)))


class NumberOf(IntEnum):
    """Owner of a parameter: an array of `RobotNumbers`."""

    LINK = 0
    MASS = 1
    SPRING = 2
    BESIDE = 3
    LOG = 4
    DELAY = 5


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
    def is_positive(self) -> bool:
        """Whether it is of no robot below 0: friction, a stiffness, a damping, a delay."""
        signed = MassNumbers.OFFSET, MassNumbers.RISE, *_DRIFTS
        if self.of is NumberOf.SPRING:
            return self.column != SPRING_NUMBERS.index("cubic_stiffness")
        return self.of is NumberOf.DELAY or (self.of is NumberOf.MASS and self.column not in signed)

    @property
    def is_of_record(self) -> bool:
        """Whether it is of the record and how it begins, or of the drives, not of the robot."""
        return self.of in (NumberOf.BESIDE, NumberOf.LOG, NumberOf.DELAY)

    def read(self, numbers: RobotNumbers) -> float:
        """Return the number."""
        return float(numbers.arrays[self.of][self.row, self.column])


def stribeck_share(masses: FloatArray, speeds: FloatArray) -> FloatArray:
    """Return the share of its rise that a friction has at a speed, as masses and speeds broadcast.

    As of one joint, by straight lines (`models.friction`).
    """
    below = masses[..., MassNumbers.SPEED]
    ratio = np.abs(speeds) / np.where(below > 0.0, below, 1.0)
    return np.where(below > 0.0, np.interp(ratio, *np.transpose(KNOTS)), 0.0)


def robot_with(robot: Robot, numbers: RobotNumbers) -> Robot:
    """Return a robot with other numbers; names, places, gravity and coupling stay.

    A Coulomb friction that is another backwards is one of both directions and an offset.

    Raises:
        MethodError: a rotor's inertia, with what is grouped with it, is negative.
    """
    joints = []
    for i, joint in enumerate(robot.joints):
        own, link, spring = numbers.masses[numbers.rotors[i]], numbers.masses[i], None
        if numbers.flexible[i]:
            stiffness, damping = map(float, numbers.springs[i, :2])
            viscous, coulomb = (float(link[column]) for column in (MassNumbers.VISCOUS, MassNumbers.COULOMB))
            spring = JointSpring(stiffness, damping, viscous, coulomb, numbers.laws[i][1] or Spring())
        found = values_of_joint(numbers, i)
        stated = joint.numbers.keys() & {"stribeck_force", "motor_stribeck_force"}
        inertia, viscous, coulomb, offset, forwards, backwards, rise, below = map(float, own[: MassNumbers.PRESLIDING])
        joints.append(
            replace(
                joint,
                rotor_inertia=inertia,
                viscous=viscous + forwards,
                coulomb=coulomb,
                offset=offset,
                viscous_backwards=viscous + backwards if joint.asymmetric else None,
                coulomb_backwards=None,
                stribeck_force=0.0 if stated else rise,
                stribeck_speed=below or None,
                spring=spring,
                numbers={name: found[name] for name in joint.numbers},
            )
        )
    return replace(robot.with_inertials(numbers.inertials), joints=tuple(joints))


def with_values(numbers: RobotNumbers, places: tuple[NumberPlace, ...], values: FloatArray) -> RobotNumbers:
    """Return a candidate with other numbers in these places."""
    inertials, masses, springs, beside, log, delays = arrays = tuple(one.copy() for one in numbers.arrays)
    for place, value in zip(places, values, strict=True):
        arrays[place.of][place.row, place.column] = value
    return replace(numbers, inertials=inertials, masses=masses, springs=springs, beside=beside, log=log, delays=delays)
