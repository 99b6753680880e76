"""Search parameters of n axes, and of a joint's surroundings.

The surroundings of a joint may be as unknown as the joint itself: its first state, its loop, its log. A problem
fixes these at the values of the record and the joint file, unless they are made free (`surrounding`). Each is a
further `Parameter`:

- ``initial_position``, ``initial_velocity`` of the motor at the first sample;
- ``initial_torque`` there of a controller with an integral, which carries friction and gravity;
- any number of the controller, by its own name: ``position_gain``, ``velocity_gain``, ``derivative_gain``,
  ``delay``, ``limit``, and those of its filters, as ``velocity_filter.time_constant`` or
  ``torque_filters.0.frequency``;
- ``log_gain``: the torque in the log, over the output of the law;
- ``log_delay``: delay of the torque channel behind its stamps.

Of the ten numbers of a robot's link some affect no torque, and others only in sums. A numerical QR decomposition of
the equations at random motions keeps each column that the ones before it do not span [M. Gautier: Numerical calculation
of the base inertial parameters of robots, Journal of Robotic Systems 8, 1991]; the others are grouped with kept ones,
and set to 0: the torques are the same. Friction, springs and rotors come first, so that these are kept. The rotor
of a rigid joint is then grouped with its link, that of a flexible one stands alone [Spong 1987].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import no_choice
from jointid.common.parameters import TORQUE_UNIT, Parameter, Quantity, unit_of
from jointid.models.controllers import LONGEST_DELAY, Controller, numbers_of, with_numbers
from jointid.models.joints import Joint
from jointid.models.robots.base_parameters import (
    INERTIAL_ORDER,
    formula_of,
    group_columns,
    name_of,
    name_sum,
    standard_symbols,
    symbol_of,
)
from jointid.models.robots.inertial import SYMBOLS, UNITS
from jointid.models.robots.robot import Robot, RobotLoop, Tree
from jointid.simulation.derivatives import columns_of
from jointid.simulation.plant import DELAY, Numbers, Place, law_places
from jointid.simulation.simulate import MassMotion
from jointid.simulation.start import INITIAL

INITIAL_STATE = (
    Parameter(INITIAL[0], "q(0)", Quantity.POSITION),
    Parameter(INITIAL[1], "v(0)", Quantity.VELOCITY),
)
"""The motor's state at the first sample; an axis may already move when the log begins."""

DELAYS = (0.0, 0.003, 0.006, 0.009)
"""Seconds, of drives and their buses: where the search for a delay begins."""

LOG_DELAY = Parameter("log_delay", "d log", Quantity.TIME, free=False, start=0.0)

OF_LOG = {
    "log_gain": Parameter("log_gain", "g log", Quantity.RATIO, free=False, start=1.0, lower=1e-3),
    "log_delay": LOG_DELAY,
}
"""What lies between the torque of a controller and the log's, by name."""

INITIAL_TORQUE = Parameter(INITIAL[2], "u(0)", Quantity.FORCE)
"""What a controller with an integral puts out at the first sample: what friction and gravity asked for until then."""

_BESIDE_LAW = {p.name: p for p in INITIAL_STATE} | OF_LOG
_ROOM = 1e-3  # below what a law cannot have: a derivative by differences also evaluates outside the value
_SMALL = 1e-6  # relative: how near a search comes to what a law cannot have


def adjust_parameters(parameters: Iterable[Parameter], changes: Mapping[str, Parameter]) -> tuple[Parameter, ...]:
    """Replace the parameters named in `changes`."""
    parameters = tuple(parameters)
    names = [parameter.name for parameter in parameters]
    for name, change in changes.items():
        if name not in names or not isinstance(change, Parameter):
            raise MethodError(
                f"This model has the parameters {', '.join(names)}; received {name} = {change!r}: change its own, by "
                "fix(value) or dataclasses.replace."
            )
    return tuple(changes.get(parameter.name, parameter) for parameter in parameters)


def surrounding(name: str, controller: Controller, period: float | None = None) -> Parameter:
    """Named free parameter from its declared value, within the law's bounds.

    Args:
        name: of a part of the first state, the log, or a number of the controller.
        controller: whose numbers.
        period: of the controller, s; without it frequencies and delays have no upper bound.

    Raises:
        MethodError: nothing around a joint has that name; the sentence lists the names.
    """
    if name in _BESIDE_LAW:
        return replace(_BESIDE_LAW[name], free=True)
    numbers = numbers_of(controller)
    if name not in numbers:
        known = ", ".join((*_BESIDE_LAW, *numbers))
        raise MethodError(f'Nothing around this joint is called "{name}"; what can be freed is {known}.')
    value, symbol = numbers[name], name.rpartition(".")[2]
    if not math.isfinite(value):
        raise MethodError(f"The {name} of this controller is {value}, where no search can begin; declare a finite one.")
    if symbol in ("integral_gain", "time_constant") and value == 0.0:
        raise MethodError(f"The {name} of this controller is 0, so it has no such part; declare a start above 0.")
    lower, upper = {"constant_feedforward": -math.inf, "numerator_damping": -1.0 + _SMALL}.get(symbol, 0.0), math.inf
    if symbol in ("gain", "limit", "velocity_limit", "frequency", "bandwidth", "damping", "numerator_frequency"):
        lower = _SMALL * value
    if period is not None and symbol.endswith("frequency"):
        upper = max((0.5 - _ROOM) / period, value)
    elif period is not None and symbol == "reference_delay":
        upper = max((1.0 - _ROOM) * LONGEST_DELAY * period, value)
    quantity = Quantity.TIME if symbol.endswith(("delay", "time_constant")) else Quantity.GAIN
    return Parameter(name, symbol, quantity, start=value, lower=lower, upper=upper)


def log_delay(known: float | None, sample_time: float, *, stated: bool = True) -> Parameter:
    """The log's delay, s: fixed if known, else free within twenty samples.

    It counts from when the torque acts. If the torque's timing is not stated, a known delay is free within two
    samples: an averaged torque acts one sooner than a held one.
    """
    late, start = sample_time * (20.0 if known is None else 2.0), known or 0.0
    free = replace(LOG_DELAY, free=True, start=start, lower=start - late, upper=start + late)
    return free if known is None or not stated else free.fix(known)


def of_law(name: str) -> bool:
    """Test whether a surrounding parameter belongs to the controller."""
    return name not in INITIAL and name not in OF_LOG


# The parameters of n axes

_SCALED = ("motor_inertia", "stiffness")  # what a search may take on a logarithmic scale


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Parameters of a robot or a joint, and their places.

    Attributes:
        parameters: names, quantities and bounds; of those on a logarithmic scale bounds of the logarithm. Those with a
            fixed value are the last of a robot.
        places: of the parameters. logarithmic: (parameters,) whether a search uses the logarithm.
        base: the numbers, with 0 for those that are grouped with others.
        dropped: the places of numbers that were grouped, or have no effect.
        grouping: (parameters, dropped) share of each dropped number in each parameter.
    """

    parameters: tuple[Parameter, ...]
    places: tuple[Place, ...]
    logarithmic: NDArray[np.bool_]
    base: Numbers
    dropped: tuple[Place, ...]
    grouping: FloatArray

    @classmethod
    def of_joint(cls, joint: Joint, parameters: Iterable[Parameter]) -> Parameters:
        """Parameters of a joint, then of its surroundings; none is grouped."""
        parameters = tuple(parameters)
        count, numbers = len(parameters), Numbers.of_joint(joint, {p.name: p.start or 0.0 for p in parameters})
        places = tuple(Place(0, p.name) for p in parameters)
        return cls(parameters, places, np.zeros(count, dtype=np.bool_), numbers, (), np.zeros((count, 0)))

    def __iter__(self) -> Iterator[Parameter]:
        """Iterate over the parameters, fixed ones too."""
        return iter(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are searched."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def keys(self) -> tuple[Place, ...]:
        """Their places."""
        return tuple(place for p, place in zip(self.parameters, self.places, strict=True) if p.free)

    @property
    def _searched(self) -> NDArray[np.bool_]:
        return np.array([p.free for p in self.parameters], dtype=np.bool_)

    @property
    def inertial(self) -> NDArray[np.bool_]:
        """Mask of inertias and their sums, (parameters,)."""
        return np.array([standard_index(one, len(self.base.joints)) is not None for one in self.places], dtype=np.bool_)

    def columns(
        self, robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray, numbers: Numbers | None = None
    ) -> FloatArray:
        """Columns of motor torques without deflection, (samples, n, parameters).

        The joints' positions, velocities and accelerations are (samples, n) each. Speeds below which a friction rises
        are those of `numbers`, or of `base`.
        """
        numbers, n = numbers or self.base, len(robot)
        moved = np.zeros((3, len(q), numbers.count))
        moved[:, :, :n] = moved[:, :, numbers.motors] = np.stack([q, v, a]) @ robot.coupling.T
        motion = MassMotion(moved[0], moved[1], moved[2], np.sign(moved[1]))
        found = np.zeros((*v.shape, len(self.places)))
        # What acts on a link acts through its spring on the motor.
        each = columns_of(robot.tree, numbers, self.places, motion, range(numbers.count))
        for (axis, _), (own, columns) in zip(numbers.sides, each, strict=True):
            found[:, axis, own] += columns
        return found

    def add(self, *more: tuple[Parameter, Place]) -> Parameters:
        """Return these and more parameters, with which nothing is grouped."""
        alone = np.zeros((len(more), len(self.dropped)))
        found = replace(
            self,
            parameters=(*self.parameters, *(one for one, _ in more)),
            places=(*self.places, *(place for _, place in more)),
            logarithmic=np.append(self.logarithmic, np.zeros(len(more), dtype=np.bool_)),
            grouping=np.vstack([self.grouping, alone]),
        )
        return found.select(np.argsort(~found._searched, kind="stable").tolist())  # the fixed ones last

    @property
    def of_standard(self) -> FloatArray:
        """Weights of links' inertial parameters, then rotors', (parameters, 11 n)."""
        found = np.zeros((len(self.places), 11 * len(self.base.inertials)))
        both = np.hstack([np.eye(len(self.places)), self.grouping])
        for place, column in zip((*self.places, *self.dropped), both.T, strict=True):
            if (i := standard_index(place, len(self.base.joints))) is not None:
                found[:, i] = column
        return found

    def units(self, robot: Robot) -> list[str]:
        """Return the units of the parameters."""
        found = list[str]()
        for p, place in zip(self.parameters, self.places, strict=True):
            kind = "revolute" if place.name == LOG_DELAY.name else robot.links[place.axis].kind
            found.append(UNITS[place.column] if place.of_link else unit_of(p.quantity, kind, TORQUE_UNIT[kind]))
        return found

    def formulas(self, robot: Robot) -> tuple[str, ...]:
        """Sums that the parameters stand for, as text; else their symbols.

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
        """Parameters of a robot with these numbers, including grouped ones, (parameters,).

        Those of the record, not of the robot, are as in `base`.
        """
        numbers = numbers.with_record(self.base)
        kept, dropped = (np.array([numbers[p] for p in places]) for places in (self.places, self.dropped))
        return np.asarray(kept + self.grouping @ dropped)

    def fill(self, free: FloatArray) -> FloatArray:
        """Return the parameters, (parameters,), from those that are free, (free,)."""
        found = np.array([p.start or 0.0 for p in self.parameters])
        found[self._searched] = free
        return found

    def values(self, x: FloatArray) -> FloatArray:
        """Convert search variables, (free,), to all parameters, (parameters,)."""
        found, logs = self.fill(x), self.logarithmic
        found[logs] = np.exp(found[logs])
        return found

    def scales(self, x: FloatArray) -> FloatArray:
        """Derivatives of the free parameters by the search variables, (free,)."""
        return np.where(self.logarithmic, self.values(x), 1.0)[self._searched]

    def to_search_variables(self, values: FloatArray) -> FloatArray:
        """Convert parameters, (parameters,), to search variables, (free,)."""
        logs = self.logarithmic
        return np.where(logs, np.log(np.where(logs, values, 1.0)), values)[self._searched]

    def without_logarithms(self) -> Parameters:
        """Return these parameters, each searched by its value."""
        pairs = zip(self.parameters, self.logarithmic, strict=True)
        plain = (replace(p, lower=math.exp(p.lower), upper=math.exp(p.upper)) if log else p for p, log in pairs)
        return replace(self, parameters=tuple(plain), logarithmic=np.zeros_like(self.logarithmic))

    def reach(self, values: FloatArray) -> FloatArray:
        """Step limit of each free parameter from these values, (free,)."""
        reach = np.where(self.logarithmic, math.log(3.0), np.inf)
        of_laws = {place for place, _ in law_places(self.base)}
        for c, place in enumerate(self.places):
            damping = place.name == "damping"
            if place.name == DELAY:
                reach[c] = 2e-3  # s of a step: a delay by at most so much
            elif (place in of_laws or damping) and values[c] != 0.0:
                reach[c] = (5.0 if damping else 2.0) * abs(values[c])  # of where the step begins
        return reach[self._searched]

    def numbers(self, values: FloatArray) -> Numbers:
        """Return the candidate with these parameters."""
        return self.base.with_values(self.places, values)

    def select(self, kept: Sequence[int]) -> Parameters:
        """Return some of the parameters."""
        return replace(
            self,
            parameters=tuple(self.parameters[i] for i in kept),
            places=tuple(self.places[i] for i in kept),
            logarithmic=self.logarithmic[kept],
            grouping=self.grouping[kept],
        )


def robot_parameters(
    robot: Robot, *, offsets: bool = True, logarithmic: bool = False, whole: bool = True
) -> Parameters:
    """Parameters of a robot that are identifiable with sufficient excitation.

    The links' parameters are grouped with friction, springs and rotors, all linear. Nonlinear parameters of the laws
    are not grouped.

    Args:
        robot: with rigid or flexible joints, and any laws.
        offsets: whether a constant torque of each motor is a parameter; else it has the robot's value.
        logarithmic: whether the rotors and springs of flexible joints are searched on a logarithmic scale.
        whole: whether all numbers of the laws are parameters. Else the equations are linear in them: they have the
            Stribeck force, but the Stribeck speed is the robot's.
    """
    numbers = Numbers.of(robot)
    places = _order_parameters(numbers, offsets, rising=not whole)
    kept, sums = group_columns(_random_columns(robot, numbers, places))
    dropped = [i for i in range(len(places)) if i not in kept]
    found = Parameters(
        (),
        tuple(places[i] for i in kept),
        np.array([logarithmic and places[i].name in _SCALED for i in kept], dtype=np.bool_),
        numbers.with_values(places, np.zeros(len(places))),
        tuple(places[i] for i in dropped),
        sums[:, dropped],
    )
    columns = zip(found.places, found.logarithmic.tolist(), found.of_standard, strict=True)
    found = replace(found, parameters=tuple(_name_parameter(robot, *one) for one in columns))
    return found.add(*_of_laws(robot, numbers)) if whole else found


def find_free_delays(loop: RobotLoop, free: Sequence[str]) -> tuple[int, ...]:
    """Indices of joints whose torque delay is free, by `DIDIM.free`.

    Raises:
        MethodError: a name is of something else.
    """
    names = [name_of(DELAY, joint.name) for joint in loop.robot.joints]
    for one in free:
        if one not in (DELAY, *names):
            raise MethodError(f"A name in DIDIM.free of a robot{no_choice(one, (DELAY, *names))}")
    return tuple(j for j, name in enumerate(names) if DELAY in free or name in free)


def add_delays(parameters: Parameters, loop: RobotLoop, free: Sequence[int]) -> Parameters:
    """Add the delays of some joints' torques, starting from their controllers' delays.

    Raises:
        MethodError: a controller has no delay.
    """
    more = list[tuple[Parameter, Place]]()
    for j in free:
        name = name_of(DELAY, loop.robot.joints[j].name)
        own = replace(surrounding(DELAY, loop.controllers[j]), name=name, symbol=symbol_of(DELAY, j))
        more.append((own, Place(j, DELAY)))
    return begin_delays(parameters.add(*more), loop)


def begin_delays(parameters: Parameters, loop: RobotLoop) -> Parameters:
    """Start the free delays of parameters from those of the controllers."""
    stated = {p: numbers_of(loop.controllers[p.axis])[DELAY] for p in parameters.places if p.name == DELAY}
    return replace(parameters, base=parameters.base.with_values([*stated], [*stated.values()]))


def with_delays(loop: RobotLoop, delays: Mapping[int, float]) -> RobotLoop:
    """Return a loop whose torques act by other delays, s, by joint."""
    laws = enumerate(loop.controllers)
    return replace(
        loop, controllers=tuple(with_numbers(one, {DELAY: delays[j]}) if j in delays else one for j, one in laws)
    )


def name_in_robot(joint: str, name: str) -> str:
    """Name of a joint's parameter in a robot, as "elbow.link_coulomb" for "load_coulomb"."""
    place = Place(0, name)
    return name_of(f"link_{place.own}" if place.side == "load_" else place.own, joint)


def _of_laws(robot: Robot, numbers: Numbers) -> Iterator[tuple[Parameter, Place]]:
    """Yield the nonlinear parameters of laws, as a joint's identification takes them."""
    for place, p in law_places(numbers):
        name = name_in_robot(robot.joints[place.axis].name, p.name)
        yield replace(p, name=name, symbol=symbol_of(name.partition(".")[2], place.axis)), place


def standard_index(place: Place, links: int) -> int | None:
    """Index among standard parameters, links then rotors; None without inertia."""
    if place.of_link:
        return len(SYMBOLS) * place.axis + place.column
    return len(SYMBOLS) * links + place.axis if place.own == "inertia" else None


def apply_constraints(parameters: Parameters, known: Mapping[str, Parameter]) -> Parameters:
    """Fix parameters, moving them to the end, and tighten others' bounds.

    Unknown names are ignored; the value of a fixed parameter is its start.
    """
    changed = list[Parameter]()
    for one in parameters.parameters:
        stated = known.get(one.name, one)
        if not stated.free and stated.start is not None:
            changed.append(one.fix(stated.start))
        else:
            changed.append(replace(one, lower=max(one.lower, stated.lower), upper=min(one.upper, stated.upper)))
    searched = parameters.logarithmic & [p.free for p in changed]
    found = replace(parameters, parameters=tuple(changed), logarithmic=searched)
    return found.add()  # with the fixed ones last


def require_friction(robot: Robot, stated: Mapping[str, Parameter]) -> None:
    """Refuse starts, and values or bounds except of friction and offsets."""
    if not stated:
        return
    own, beside = robot_parameters(robot), [p.name for p, _ in _of_laws(robot, Numbers.of(robot))]
    lines = ("viscous", "coulomb", "stribeck_force", "offset")
    pairs = zip(own.names, own.places, strict=True)
    known = [name for name, place in pairs if name in beside or place.own.startswith(lines)]
    for name, one in stated.items():
        if name not in known or not (name in beside or not one.free or one.start is None):
            raise MethodError(
                f"{name} has a value, bounds or a start to keep; expected a value or bounds of friction or a constant "
                f"torque, {', '.join(known)}: state one of them, or leave it out."
            )


def mass_matrix_at(tree: Tree, inertials: FloatArray, pose: FloatArray) -> FloatArray:
    """Mass matrix of a robot's links, (n, n), at a pose of its shafts, (n,)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n, still = pose.size, np.zeros(pose.size)
    M = np.empty((n, n))
    equations_of_motion(tree, inertials, pose, still, still, np.empty((n, ROOM)), M, np.empty(n), False)
    return M


def _order_parameters(numbers: Numbers, offsets: bool, rising: bool) -> tuple[Place, ...]:
    """Order the places of linear parameters by priority; `rising` adds Stribeck forces."""

    def of_masses(*names: str) -> list[Place]:
        found = (Place(i, f"{side}{name}") for i, side in numbers.sides for name in names)
        return [place for place in found if place in numbers]

    friction = [p for one in ("viscous", "coulomb") for p in of_masses(one, f"{one}_forwards", f"{one}_backwards")]
    if rising:
        rises = {place for place, _ in law_places(numbers)}
        friction += [place for place in of_masses("stribeck_force") if place in rises]
    # A Coulomb friction of two sizes is one of both directions and an offset, where it does not wind up.
    two = {place.axis for place in of_masses("coulomb") if numbers.joints[place.axis].friction.two_ways}
    constant = [Place(i, "offset") for i in range(len(numbers.joints)) if offsets or i in two]
    flexible = np.flatnonzero(numbers.flexible).tolist()
    springs = [Place(i, name) for name in ("stiffness", "damping") for i in flexible]
    rotors = [Place(i, f"{joint.sides[0]}inertia") for i, joint in enumerate(numbers.joints)]
    bodies = [Place(i, SYMBOLS[column]) for i in range(len(numbers.joints)) for column in INERTIAL_ORDER]
    return (*friction, *constant, *springs, *rotors, *bodies)


def _random_columns(robot: Robot, numbers: Numbers, places: tuple[Place, ...]) -> FloatArray:
    """Columns at random motions, (rows, parameters), with rounding set to 0."""
    random, shape = np.random.default_rng(0), (300, numbers.count)
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
    return np.where(sizes > 1e-10 * np.max(sizes), every, 0.0)


def _name_parameter(robot: Robot, place: Place, logarithmic: bool, weights: FloatArray) -> Parameter:
    """Parameter of a place, or of a sum with these weights."""
    at = standard_index(place, len(robot))
    name, symbol, _ = ("", "", 0) if at is None else name_sum(robot, weights, at)
    if place.of_link:
        return Parameter(name, symbol, Quantity.INERTIA if place.column >= 4 else Quantity.RATIO)
    joint, own = robot.joints[place.axis], place.own
    alone = {p.name: p for p in joint.model.parameters}
    like = alone.get(place.name) or alone[f"{place.name}_forwards"]
    name = name or name_in_robot(joint.name, place.name)
    lower = 0.0 if own == "stribeck_force" else like.lower
    lower = -math.inf if logarithmic or place.name == "inertia" else lower
    return Parameter(name, symbol or symbol_of(name.partition(".")[2], place.axis), like.quantity, lower=lower)
