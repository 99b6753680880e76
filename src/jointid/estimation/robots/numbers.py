"""The parameters of a robot that torques can tell: friction, rotors, springs, and base parameters of the links.

Of the ten numbers of a link some act on no torque, and others only together. A numerical QR decomposition of the
equations at random motions keeps each column that the ones before it do not span [M. Gautier: Numerical calculation of
the base inertial parameters of robots, Journal of Robotic Systems 8, 1991]; what is not kept is grouped with what is,
and set to 0: the torques are the same. Friction, springs and rotors come first, so that these are kept. The rotor of a
rigid joint is then grouped with its link, that of a flexible one stands alone [Spong 1987].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter, Quantity
from jointid.models.robots.base_parameters import group_columns
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.simulation.robot_sensitivities import NumberOf, NumberPlace, with_values
from jointid.simulation.robots import LoopTree, MassMotion, RobotNumbers

_MOTIONS = 300  # random ones, at each of which every joint has an equation
_FELT = 1e-10  # of the largest column: what is smaller is rounding, and would be independent of all others
_OF_MASS = ("rotor_inertia", "viscous", "coulomb", "offset")
_OF_SPRING = ("stiffness", "damping")
_QUANTITIES = {
    "rotor_inertia": Quantity.INERTIA,
    "viscous": Quantity.VISCOUS,
    "coulomb": Quantity.FORCE,
    "offset": Quantity.FORCE,
    "stiffness": Quantity.STIFFNESS,
    "damping": Quantity.VISCOUS,
}


@dataclass(frozen=True, slots=True, eq=False)
class RobotParameters:
    """What is identified of a robot, and where it stands among its numbers.

    Attributes:
        parameters: names, quantities and bounds; of those on a logarithmic scale bounds of the logarithm.
        places: of them. logarithmic: (parameters,) whether a search works on the logarithm.
        base: the robot's numbers with 0 wherever one is grouped with others.
        dropped: the places of what was grouped, or acts on nothing.
        grouping: (parameters, dropped) what each of the dropped adds to each parameter.
    """

    parameters: tuple[Parameter, ...]
    places: tuple[NumberPlace, ...]
    logarithmic: NDArray[np.bool_]
    base: RobotNumbers
    dropped: tuple[NumberPlace, ...]
    grouping: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def group(self, numbers: RobotNumbers) -> FloatArray:
        """Return the parameters of a robot with these numbers, each with what is grouped with it, (parameters,)."""
        kept, dropped = (np.array([p.read(numbers) for p in places]) for places in (self.places, self.dropped))
        return np.asarray(kept + self.grouping @ dropped)

    def values(self, x: FloatArray) -> FloatArray:
        """Return the parameters from what is searched, (parameters,)."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, x, 0.0)), x)

    def searched(self, values: FloatArray) -> FloatArray:
        """Return what is searched from the parameters, (parameters,)."""
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)

    def numbers(self, values: FloatArray) -> RobotNumbers:
        """Return the candidate with these parameters."""
        return with_values(self.base, self.places, values)


def robot_parameters(robot: Robot, *, offsets: bool = True, logarithmic: bool = False) -> RobotParameters:
    """Return the parameters of a robot that its torques can tell on a motion that excites all.

    Args:
        robot: whose joints are rigid or flexible.
        offsets: whether a constant torque of each motor is one of them; else it keeps the robot's.
        logarithmic: whether the rotors and springs of flexible joints are searched on a logarithmic scale.
    """
    numbers = RobotNumbers.of(robot)
    places = _ordered(numbers, offsets)
    kept, sums = group_columns(_random_columns(robot, numbers, places))
    base = with_values(numbers, places, np.zeros(len(places)))
    logs = [logarithmic and _positive(place, numbers) for place in places]
    parameters = [_named(place, robot, numbers, log) for place, log in zip(places, logs, strict=True)]
    dropped = [i for i in range(len(places)) if i not in kept]
    return RobotParameters(
        tuple(parameters[i] for i in kept),
        tuple(places[i] for i in kept),
        np.array([logs[i] for i in kept], dtype=np.bool_),
        base,
        tuple(places[i] for i in dropped),
        sums[:, dropped],
    )


def _ordered(numbers: RobotNumbers, offsets: bool) -> tuple[NumberPlace, ...]:
    """Return all places, those first that are to be kept."""
    n, masses = numbers.rotors.size, range(len(numbers.masses))
    friction = [NumberPlace(NumberOf.MASS, row, column) for column in (1, 2) for row in masses]
    constant = [NumberPlace(NumberOf.MASS, int(row), 3) for row in numbers.rotors] if offsets else []
    springs = [
        NumberPlace(NumberOf.SPRING, int(i), column) for column in (0, 1) for i in np.flatnonzero(numbers.flexible)
    ]
    rotors = [NumberPlace(NumberOf.MASS, int(row), 0) for row in numbers.rotors]
    links = [NumberPlace(NumberOf.LINK, row, column) for row in range(n) for column in range(len(SYMBOLS))]
    return (*friction, *constant, *springs, *rotors, *links)


def columns_of(
    tree: LoopTree, numbers: RobotNumbers, places: tuple[NumberPlace, ...], motion: MassMotion
) -> FloatArray:
    """Return the derivatives of all masses' equations by the parameters, (samples, masses, parameters).

    At a known motion, so these are the regressor's columns; its product with the parameters is the motors' torques,
    and 0 for the links of flexible joints.

    Args:
        tree: parents, kinds, axes, rotations, origins, gravity.
        numbers: of which only the rotors are read.
        places: of the parameters.
        motion: of all masses.
    """
    from jointid.models.robots.dynamics import regressor_of

    samples, masses = motion.position.shape
    n, rotors = numbers.rotors.size, numbers.rotors
    q, v, a = (
        np.ascontiguousarray(values[:, :n]) for values in (motion.position, motion.velocity, motion.acceleration)
    )
    of_links = regressor_of(*tree, q, v, a)
    out = np.zeros((samples, masses, len(places)))
    of_mass = motion.acceleration, motion.velocity, motion.direction, np.ones((samples, masses))
    picked = [(c, place) for c, place in enumerate(places) if place.of is NumberOf.LINK]
    if picked:
        at = [len(SYMBOLS) * place.row + place.column for _, place in picked]
        out[:, :n, [c for c, _ in picked]] = of_links[:, :, at]
    for c, place in enumerate(places):
        if place.of is NumberOf.MASS:
            out[:, place.row, c] = of_mass[place.column][:, place.row]
        elif place.of is NumberOf.SPRING:
            moved = motion.position if place.column == 0 else motion.velocity
            stretch = moved[:, rotors[place.row]] - moved[:, place.row]
            out[:, rotors[place.row], c], out[:, place.row, c] = stretch, -stretch
    return out


def _random_columns(robot: Robot, numbers: RobotNumbers, places: tuple[NumberPlace, ...]) -> FloatArray:
    """Return the columns at random motions, (rows, parameters), 0 where they are rounding."""
    random, shape = np.random.default_rng(0), (_MOTIONS, len(numbers.masses))
    velocity = 2.0 * random.normal(size=shape)
    motion = MassMotion(
        random.uniform(-math.pi, math.pi, shape), velocity, 5.0 * random.normal(size=shape), np.sign(velocity)
    )
    columns = columns_of((*robot.tree, robot.gravity), numbers, places, motion)
    rows = columns.reshape(-1, len(places))
    sizes = np.linalg.norm(rows, axis=0)
    return np.where(sizes > _FELT * np.max(sizes), rows, 0.0)


def _positive(place: NumberPlace, numbers: RobotNumbers) -> bool:
    """Return True of a number without which a flexible joint is none: its rotor's inertia, its stiffness."""
    rotor = place.of is NumberOf.MASS and place.column == 0 and place.row >= numbers.rotors.size
    return rotor or (place.of is NumberOf.SPRING and place.column == 0)


def _named(place: NumberPlace, robot: Robot, numbers: RobotNumbers, logarithmic: bool) -> Parameter:
    if place.of is NumberOf.LINK:
        name, symbol = f"{robot.links[place.row].name}.{SYMBOLS[place.column]}", SYMBOLS[place.column]
        quantity = Quantity.INERTIA if place.column >= 4 else Quantity.RATIO
        return Parameter(name, symbol, quantity)
    if place.of is NumberOf.SPRING:
        joint, symbol = place.row, _OF_SPRING[place.column]
        name = symbol
    else:
        joint = int(np.flatnonzero(numbers.rotors == place.row)[0]) if place.row in numbers.rotors else place.row
        symbol = _OF_MASS[place.column]
        name = symbol if place.row == numbers.rotors[joint] else f"link_{symbol}"
    lower = 0.0 if symbol in ("viscous", "coulomb", "damping") else -math.inf
    if _positive(place, numbers) and not logarithmic:
        lower = 1e-12
    return Parameter(f"{robot.joints[joint].name}.{name}", symbol, _QUANTITIES[symbol], lower=lower)
