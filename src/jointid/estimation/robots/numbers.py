"""The parameters of a robot that torques can tell: friction, rotors, springs, and base parameters of the links.

Of the ten numbers of a link some act on no torque, and others only together. A numerical QR decomposition of the
equations at random motions keeps each column that the ones before it do not span [M. Gautier: Numerical calculation of
the base inertial parameters of robots, Journal of Robotic Systems 8, 1991]; what is not kept is grouped with what is,
and set to 0: the torques are the same. Friction, springs and rotors come first, so that these are kept. The rotor of a
rigid joint is then grouped with its link, that of a flexible one stands alone [Spong 1987].
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import no_choice
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.base import DELAY, surrounding
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.robots.base_parameters import (
    INERTIAL_ORDER,
    formula_of,
    group_columns,
    inverse_columns,
    name_sum,
    standard_symbols,
)
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.names import inertial_symbol, name_of, symbol_of
from jointid.models.robots.robot import Robot
from jointid.simulation.derivatives import columns_of, mass_column
from jointid.simulation.loop_input import RobotLoop
from jointid.simulation.plant import LOAD_STATE, Numbers, Place, law_places
from jointid.simulation.simulate import MassMotion

_MOTIONS = 300  # random ones, at each of which every joint has an equation
_FELT = 1e-10  # of the largest column: what is smaller is rounding, and would be independent of all others
_REACH, _FACTOR = math.log(3.0), 2.0  # of a step: of a parameter on a logarithmic scale, and over the start of a law's
_LATE = 2e-3  # s of a step: a delay by at most so much
_DAMPED = 5.0  # of a step: a spring's damping by at most so many times what it begins with
_INERTIAS = ("inertia", "motor_inertia")
"""Names of a rotor's inertia."""
_LINES = ("viscous", "viscous_forwards", "viscous_backwards", "coulomb", "stribeck_force")
"""Names of a friction that multiplies a column of its motion, without the side."""
_QUANTITIES = {
    "inertia": Quantity.INERTIA,
    "viscous": Quantity.VISCOUS,
    "viscous_forwards": Quantity.VISCOUS,
    "viscous_backwards": Quantity.VISCOUS,
    "coulomb": Quantity.FORCE,
    "offset": Quantity.FORCE,
    "stribeck_force": Quantity.FORCE,
    "stiffness": Quantity.STIFFNESS,
    "damping": Quantity.VISCOUS,
}


@dataclass(frozen=True, slots=True, eq=False)
class RobotParameters:
    """The parameters of a robot, and their indices among its numbers.

    Attributes:
        parameters: names, quantities and bounds; of those on a logarithmic scale bounds of the logarithm.
        places: of them. logarithmic: (parameters,) whether a search works on the logarithm.
        base: the robot's numbers with 0 wherever one is grouped with others.
        dropped: the places of what was grouped, or acts on nothing.
        grouping: (parameters, dropped) what each of the dropped adds to each parameter.
        kept: the places of what has a fixed value, which `base` has. fixed: these parameters.
    """

    parameters: tuple[Parameter, ...]
    places: tuple[Place, ...]
    logarithmic: NDArray[np.bool_]
    base: Numbers
    dropped: tuple[Place, ...]
    grouping: FloatArray
    kept: tuple[Place, ...] = ()
    fixed: tuple[Parameter, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def of_robot(self) -> NDArray[np.bool_]:
        """Which are of the robot, and not of the record, (parameters,)."""
        return np.array([not place.of_record for place in self.places], dtype=np.bool_)

    @property
    def inertial(self) -> NDArray[np.bool_]:
        """Which are inertias, or sums of them, (parameters,)."""
        return np.array([standard_index(one, len(self.base.joints)) is not None for one in self.places], dtype=np.bool_)

    def columns(
        self, robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray, numbers: Numbers | None = None
    ) -> FloatArray:
        """Return the columns of the motors' torques in a motion without deflection, (samples, n, parameters).

        Args:
            robot: its tree, gravity and coupling are read.
            q: (samples, n) positions of the joints, rad or m.
            v: (samples, n) their velocities.
            a: (samples, n) their accelerations.
            numbers: with the speeds below which frictions rise; those of `base` without it.
        """
        numbers = numbers or self.base
        motor, behind = v @ robot.coupling.T, np.linalg.inv(robot.coupling)  # what acts on a link, on the motors
        links, places = inverse_columns(robot, q, v, a), (*self.places, *self.kept)
        found = np.zeros((*v.shape, len(places)))
        for k, place in enumerate(places):
            j = place.axis
            if place.of_link:
                found[:, :, k] = links[:, :, len(SYMBOLS) * j + place.column]
            elif place.own in (*_LINES, "inertia", "offset"):
                of_motor = place.side != "load_"
                speed = (motor if of_motor else v)[:, j]
                turns = links[:, j, len(SYMBOLS) * len(robot) + j]
                column = mass_column(place, numbers, q[:, j], speed, turns, np.sign(speed))
                found[:, :, k] = column[:, np.newaxis] * (np.eye(len(robot)) if of_motor else behind)[j]
        return found

    def add(self, *more: tuple[Parameter, Place]) -> RobotParameters:
        """Return these and more parameters, with which nothing is grouped."""
        alone = np.zeros((len(more), len(self.dropped)))
        return replace(
            self,
            parameters=(*self.parameters, *(one for one, _ in more)),
            places=(*self.places, *(place for _, place in more)),
            logarithmic=np.append(self.logarithmic, np.zeros(len(more), dtype=np.bool_)),
            grouping=np.vstack([self.grouping, alone]),
        )

    @property
    def of_standard(self) -> FloatArray:
        """Weights in each parameter of the links' inertial parameters, then of the rotors, (parameters, 11 n)."""
        found = np.zeros((len(self.places), 11 * len(self.base.inertials)))
        both = np.hstack([np.eye(len(self.places)), self.grouping])
        for place, column in zip((*self.places, *self.dropped), both.T, strict=True):
            if (i := standard_index(place, len(self.base.joints))) is not None:
                found[:, i] = column
        return found

    def formulas(self, robot: Robot) -> tuple[str, ...]:
        """Return the sums that the parameters stand for, as text; of one that stands alone its symbol.

        Only inertias are parts of sums.
        """
        symbols, found = standard_symbols(robot), list[str]()
        for one, place, row in zip(self.parameters, self.places, self.of_standard, strict=True):
            kept = standard_index(place, len(self.base.joints))
            if kept is None:
                found.append(formula_of(np.append(row, 1.0), row.size, (*symbols, one.symbol)))
            else:
                found.append(formula_of(row, name_sum(robot, row, kept)[2], symbols))
        return tuple(found)

    def group(self, numbers: Numbers) -> FloatArray:
        """Return the parameters of a robot with these numbers, each with what is grouped with it, (parameters,).

        Those that are of the record, not of the robot, are as in `base`.
        """
        numbers = numbers.with_record(self.base)
        kept, dropped = (np.array([numbers[p] for p in places]) for places in (self.places, self.dropped))
        return np.asarray(kept + self.grouping @ dropped)

    def group_all(self, numbers: Numbers) -> FloatArray:
        """Return `group`, then the numbers in the places of the fixed parameters."""
        return np.concatenate([self.group(numbers), [numbers[place] for place in self.kept]])

    def values(self, x: FloatArray) -> FloatArray:
        """Return the parameters from what is searched, (parameters,)."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, x, 0.0)), x)

    def scales(self, x: FloatArray) -> FloatArray:
        """Return the derivatives of the parameters by what is searched, (parameters,)."""
        return np.where(self.logarithmic, self.values(x), 1.0)

    def to_search_variables(self, values: FloatArray) -> FloatArray:
        """Convert parameters, (parameters,), to search variables."""
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)

    def reach(self, values: FloatArray) -> FloatArray:
        """Return how far one step of a search from these values may move each parameter, (parameters,)."""
        reach = np.where(self.logarithmic, _REACH, np.inf)
        of_laws = {place for place, _ in law_places(self.base)}
        for c, place in enumerate(self.places):
            damping = place.name == "damping"
            if place.name == DELAY:
                reach[c] = _LATE
            elif (place in of_laws or damping) and values[c] != 0.0:
                reach[c] = (_DAMPED if damping else _FACTOR) * abs(values[c])
        return reach

    def numbers(self, values: FloatArray) -> Numbers:
        """Return the candidate with these parameters."""
        return self.base.with_values(self.places, values)

    def select(self, kept: Sequence[int]) -> RobotParameters:
        """Return some of the parameters."""
        kept = list(kept)
        return replace(
            self,
            parameters=tuple(self.parameters[i] for i in kept),
            places=tuple(self.places[i] for i in kept),
            logarithmic=self.logarithmic[kept],
            grouping=self.grouping[kept],
        )

    def first_state(self, numbers: Numbers) -> RobotParameters:
        """Return those of the links' first state alone, of a robot with these numbers."""
        own = [i for i, place in enumerate(self.places) if place.name in LOAD_STATE]
        return replace(self.select(own), base=numbers)


def robot_parameters(
    robot: Robot, *, offsets: bool = True, logarithmic: bool = False, whole: bool = True
) -> RobotParameters:
    """Return the parameters of a robot that are identifiable with sufficient excitation.

    The links' parameters are grouped with friction, springs and rotors, all of lines; what the laws have beside lines
    stands alone.

    Args:
        robot: whose joints are rigid or flexible, with any law.
        offsets: whether a constant torque of each motor is one of them; else it keeps the robot's.
        logarithmic: whether the rotors and springs of flexible joints are searched on a logarithmic scale.
        whole: whether all numbers of the laws are parameters. Else the equations are linear in them: they have the rise
            of a friction towards standstill, but the speed below which it does is the robot's.
    """
    numbers = Numbers.of(robot)
    places = _order_parameters(numbers, offsets, rising=not whole)
    kept, sums = group_columns(_random_columns(robot, numbers, places))
    base = numbers.with_values(places, np.zeros(len(places)))
    logs = [logarithmic and _positive(place) for place in places]
    parameters = [_name_parameter(place, robot, log) for place, log in zip(places, logs, strict=True)]
    dropped = [i for i in range(len(places)) if i not in kept]
    found = RobotParameters(
        tuple(parameters[i] for i in kept),
        tuple(places[i] for i in kept),
        np.array([logs[i] for i in kept], dtype=np.bool_),
        base,
        tuple(places[i] for i in dropped),
        sums[:, dropped],
    )
    named = list(found.parameters)
    for row, (place, weights) in enumerate(zip(found.places, found.of_standard, strict=True)):
        if (at := standard_index(place, len(robot))) is not None:
            name, symbol, _ = name_sum(robot, weights, at)
            named[row] = replace(named[row], name=name, symbol=symbol)
    found = replace(found, parameters=tuple(named))
    return found.add(*_of_laws(robot, numbers)) if whole else found


def find_free_delays(loop: RobotLoop, free: Sequence[str]) -> tuple[int, ...]:
    """Return the joints whose torques have a free delay, by the names in `DIDIM.free`.

    Raises:
        MethodError: a name is of something else, or a controller has no delay.
    """
    names = [name_of(DELAY, joint.name) for joint in loop.robot.joints]
    for one in free:
        if one not in (DELAY, *names):
            raise MethodError(f"A name in DIDIM.free of a robot{no_choice(one, (DELAY, *names))}")
    found = tuple(j for j, name in enumerate(names) if DELAY in free or name in free)
    for j in found:
        if DELAY not in numbers_of(loop.controllers[j]):
            raise MethodError(
                f"The controller of {loop.robot.joints[j].name} has no delay that can be free; expected a field delay, "
                "in s: use a controller of jointid, or name the other joints in DIDIM.free."
            )
    return found


def add_delays(parameters: RobotParameters, loop: RobotLoop, free: Sequence[int]) -> RobotParameters:
    """Return parameters with the delays of some joints' torques, which begin at those of their controllers."""
    if not free:
        return parameters
    more = [
        (
            replace(
                surrounding(DELAY, loop.controllers[j]), name=name_of(DELAY, loop.robot.joints[j].name),
                symbol=symbol_of(DELAY, j),
            ),
            Place(j, DELAY),
        )
        for j in free
    ]  # fmt: skip
    return begin_delays(parameters.add(*more), loop)


def begin_delays(parameters: RobotParameters, loop: RobotLoop) -> RobotParameters:
    """Start the free delays of parameters from those of the controllers."""
    if not any(place.name == DELAY for place in parameters.places):
        return parameters
    stated = {Place(j, DELAY): numbers_of(one).get(DELAY, 0.0) for j, one in enumerate(loop.controllers)}
    return replace(parameters, base=parameters.base.with_values([*stated], [*stated.values()]))


def with_delays(loop: RobotLoop, delays: Mapping[int, float]) -> RobotLoop:
    """Return a loop whose torques act by other delays, s, by joint."""
    laws = enumerate(loop.controllers)
    return replace(
        loop, controllers=tuple(with_numbers(one, {DELAY: delays[j]}) if j in delays else one for j, one in laws)
    )


def name_in_robot(joint: str, name: str) -> str:
    """Return the name of a joint's parameter in a robot: of "elbow" "load_coulomb" is "elbow.link_coulomb"."""
    return name_of(_own_name(name), joint)


def _own_name(name: str) -> str:
    place = Place(0, name)
    return f"link_{place.own}" if place.side == "load_" else place.own


def _of_laws(robot: Robot, numbers: Numbers) -> Iterator[tuple[Parameter, Place]]:
    """Yield the parameters that laws have beside lines, as a joint's identification takes them."""
    for place, p in law_places(numbers):
        name = name_in_robot(robot.joints[place.axis].name, p.name)
        yield replace(p, name=name, symbol=symbol_of(name.partition(".")[2], place.axis)), place


def standard_index(place: Place, links: int) -> int | None:
    """Return the place among a robot's standard parameters, links then rotors; None of what is no inertia."""
    if place.of_link:
        return len(SYMBOLS) * place.axis + place.column
    return len(SYMBOLS) * links + place.axis if place.name in _INERTIAS else None


def apply_constraints(parameters: RobotParameters, known: Mapping[str, Parameter]) -> RobotParameters:
    """Set the fixed parameters apart and tighten the bounds of the others.

    Args:
        parameters: of a robot.
        known: by name; the value of a fixed parameter is its start. Unknown names are ignored.
    """
    bounded, kept, places, fixed = list[Parameter](), list[int](), list[Place](), list[Parameter]()
    base = parameters.base
    for i, (one, place) in enumerate(zip(parameters.parameters, parameters.places, strict=True)):
        stated = known.get(one.name, one)
        if not stated.free and stated.start is not None:
            base = base.with_values((place,), (stated.start,))
            places.append(place)
            fixed.append(one.fix(stated.start))
            continue
        kept.append(i)
        bounded.append(replace(one, lower=max(one.lower, stated.lower), upper=min(one.upper, stated.upper)))
    found = replace(parameters.select(kept), parameters=tuple(bounded), base=base)
    return replace(found, kept=tuple(places), fixed=tuple(fixed))


def require_friction(robot: Robot, stated: Mapping[str, Parameter]) -> None:
    """Refuse what is stated of another parameter than friction or a constant torque, and a start for a search."""
    if not stated:
        return
    own = robot_parameters(robot)
    beside = [p.name for p, _ in _of_laws(robot, Numbers.of(robot))]
    known = [
        one.name
        for one, place in zip(own.parameters, own.places, strict=True)
        if one.name in beside or place.own in (*_LINES, "offset")
    ]
    for name, one in stated.items():
        if name in known and (name in beside or not one.free or one.start is None):
            continue
        one_way = name.endswith((".coulomb_forwards", ".coulomb_backwards"))
        raise MethodError(
            f"{name} has a value, bounds or a start to keep, and the methods of a robot keep values and bounds of "
            f"friction and constant torques alone, {', '.join(known)}"
            f"{'; a Coulomb friction that differs by direction is its mean and a part of offset' if one_way else ''}: "
            "state one of them, or leave it out."
        )


def _order_parameters(numbers: Numbers, offsets: bool, rising: bool) -> tuple[Place, ...]:
    """Return the places of lines, those first that are to be kept; `rising` adds the rise towards standstill."""

    def of_masses(*names: str) -> list[Place]:
        found = (Place(i, f"{side}{name}") for i, side in numbers.sides for name in names)
        return [place for place in found if place in numbers]

    friction = of_masses("viscous", "viscous_forwards", "viscous_backwards") + of_masses("coulomb")
    if rising:
        rises = {place for place, _ in law_places(numbers)}
        friction += [place for place in of_masses("stribeck_force") if place in rises]
    # A Coulomb friction of two sizes is one of both directions and an offset.
    two = [offsets or joint.friction.two_ways for joint in numbers.joints]
    constant = [Place(i, "offset") for i, kept in enumerate(two) if kept]
    flexible = np.flatnonzero(numbers.flexible).tolist()
    springs = [Place(i, name) for name in ("stiffness", "damping") for i in flexible]
    rotors = [Place(i, f"{joint.sides[0]}inertia") for i, joint in enumerate(numbers.joints)]
    bodies = [Place(i, SYMBOLS[column]) for i in range(len(numbers.joints)) for column in INERTIAL_ORDER]
    return (*friction, *constant, *springs, *rotors, *bodies)


def _random_columns(robot: Robot, numbers: Numbers, places: tuple[Place, ...]) -> FloatArray:
    """Return the columns at random motions, (rows, parameters), 0 where they are rounding."""
    random, shape = np.random.default_rng(0), (_MOTIONS, numbers.count)
    velocity = 2.0 * random.normal(size=shape)
    for row, (i, side) in enumerate(numbers.sides):  # a third of the motions are slow enough to be there
        velocity[::3, row] *= 0.5 * numbers.values[i].get(f"{side}stribeck_speed", 0.0) or 1.0
    motion = MassMotion(
        random.uniform(-math.pi, math.pi, shape), velocity, 5.0 * random.normal(size=shape), np.sign(velocity)
    )
    columns = np.zeros((*shape, len(places)))
    for row, (acts, values) in enumerate(columns_of(robot.tree, numbers, places, motion, range(numbers.count))):
        columns[:, row, acts] = values
    every = columns.reshape(-1, len(places))
    sizes = np.linalg.norm(every, axis=0)
    return np.where(sizes > _FELT * np.max(sizes), every, 0.0)


def _positive(place: Place) -> bool:
    """Return True for the rotor's inertia of a flexible joint and for a stiffness, which must be positive."""
    return place.name in ("motor_inertia", "stiffness")


def _name_parameter(place: Place, robot: Robot, logarithmic: bool) -> Parameter:
    if place.of_link:
        symbol = inertial_symbol(place.name, place.axis)
        return Parameter(symbol, symbol, Quantity.INERTIA if place.column >= 4 else Quantity.RATIO)
    own = "rotor_inertia" if place.name in _INERTIAS else _own_name(place.name)
    quantity = _QUANTITIES[place.own]
    lower = 0.0 if place.own in ("coulomb", "stribeck_force") or quantity is Quantity.VISCOUS else -math.inf
    if _positive(place) and not logarithmic:
        lower = 1e-12
    return Parameter(name_of(own, robot.joints[place.axis].name), symbol_of(own, place.axis), quantity, lower=lower)
