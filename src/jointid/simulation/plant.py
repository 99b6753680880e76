"""Numbers of a joint or robot by name, and their kernel plant.

A joint alone is a robot of one axis without a tree. The names are those of a joint's parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count, pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.models.friction import BESIDE, PARTS, Friction
from jointid.models.joints import Joint, RigidJoint
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.models.springs import Spring
from jointid.simulation import kernels
from jointid.simulation.kernels import BEGIN, HIGH, MASS, Plant, Seeds

Rows: TypeAlias = list[list[Any]]
Bools: TypeAlias = NDArray[np.bool_]

LOAD_STATE = ("initial_load_position", "initial_load_velocity")
"""The state of a load at the first sample, beside where steady motion has it."""
DELAY, LOG_DELAY = "delay", "log_delay"
"""Seconds by which a motor's torque acts later than its law puts it out, and by which a log shows torques late."""
OF_RECORD = (DELAY, LOG_DELAY, *LOAD_STATE)
"""Numbers of a record and how it begins, or of the drives, not of the robot."""

HEAVY = 1e18
"""Inertia of a motor that is moved: what acts on one of 1e3 N m moves it by 1e-12 rad in a minute."""
_IMAGINARY = 1e-30  # a complex step: its square is nothing beside any value
_THIN = 1e-300  # m or rad: the width of a piece of none, in which a joint would never get on
_WAYS = {"forwards": 1.0, "backwards": -1.0}


class Place(NamedTuple):
    """The place of a parameter among numbers.

    Attributes:
        axis: of a joint, or of a link. name: as of a joint alone, see `Numbers`; of a link's number its symbol.
    """

    axis: int
    name: str

    @property
    def of_link(self) -> bool:
        """Whether it is an inertial parameter of a link."""
        return self.name in SYMBOLS

    @property
    def column(self) -> int:
        """Of a link's inertial parameters."""
        return SYMBOLS.index(self.name)

    @property
    def side(self) -> str:
        """Prefix of the name: "motor_", "load_", or "" if on neither side."""
        side, _, own = self.name.partition("_")
        return f"{side}_" if own and side in ("motor", "load") else ""

    @property
    def own(self) -> str:
        """Its name without the side."""
        return self.name.removeprefix(self.side)


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """The numbers of a candidate, a joint or a robot.

    Attributes:
        joints: (n,) with their laws.
        values: (n,) numbers of each by name. In a robot the Coulomb friction of a joint's side is the mean of both
            directions, and half of their difference is part of "offset" or "load_offset", unless it winds up; a
            link moves behind the spring. Others are not read, but for numbers of a record or drives, see `OF_RECORD`.
        inertials: (n, 10) of a robot's links; (0, 10) of a joint.
        heavy: inertia of motors without friction that follow a prescribed motion; 0 for the real motors.
        rows: masses per axis: motor, load, swinging part; robots' links precede flexible rotors.
    """

    joints: tuple[Joint, ...]
    values: tuple[Mapping[str, Any], ...]
    inertials: FloatArray = field(default_factory=lambda: np.zeros((0, 10)))
    heavy: float = 0.0
    rows: list[list[int]] = field(init=False)

    def __post_init__(self) -> None:
        rows = [list(range(len(self.joints[0].sides) + int(self.values[0].get("swinging_share", 0.0) > 0.0)))]
        if len(self.inertials):
            rotors = count(len(self.joints))
            rows = [[next(rotors), i] if len(joint.sides) > 1 else [i] for i, joint in enumerate(self.joints)]
        object.__setattr__(self, "rows", rows)

    @classmethod
    def of_joint(cls, joint: Joint, values: Mapping[str, Any]) -> Numbers:
        """Numbers of a joint.

        Raises:
            MethodError: a parameter has no value.
        """
        if missing := [name for name in names_of(joint) if name not in values]:
            raise MethodError(
                f"A simulation needs a value for every parameter; {', '.join(missing)} has none: give one."
            )
        return cls((joint,), (values,))

    @classmethod
    def of(cls, robot: Robot) -> Numbers:
        """Numbers of a robot."""
        joints = robot.joints
        return cls(tuple(joint.model for joint in joints), tuple(map(_values_of, joints)), robot.inertials)

    def __getitem__(self, place: Place) -> Any:
        """Return the number in a place."""
        if place.of_link:
            return float(self.inertials[place.axis, place.column])
        return self.values[place.axis][place.name]

    def __contains__(self, place: Place) -> bool:
        """True for a number of robot or joint, not record or controller."""
        own = place.own in ("viscous", "coulomb", "offset") or place.name in names_of(self.joints[place.axis])
        return place.of_link or (own and place.name in self.values[place.axis])

    @property
    def sides(self) -> list[tuple[int, str]]:
        """Axis and side of each mass in order, without swinging parts."""
        each = [(own[0], i, joint.sides[0]) for i, (own, joint) in enumerate(zip(self.rows, self.joints, strict=True))]
        each += [(own[1], i, "load_") for i, own in enumerate(self.rows) if len(own) > 1]
        return [(i, side) for _, i, side in sorted(each)]

    @property
    def count(self) -> int:
        """Number of masses."""
        return sum(map(len, self.rows))

    @property
    def motors(self) -> list[int]:
        """The mass that each motor drives."""
        return [own[0] for own in self.rows]

    @property
    def flexible(self) -> Bools:
        """Which joints are flexible, (n,)."""
        return np.array([len(joint.sides) > 1 for joint in self.joints], dtype=np.bool_)

    @property
    def straight(self) -> bool:
        """True for a piecewise linear joint without prescribed motion: exact simulation."""
        return not len(self.inertials) and self.joints[0].straight and not self.heavy

    @property
    def plant(self) -> Plant:
        """Masses and springs as the kernels read them."""
        rows, pairs = self.rows, [pair for own in self.rows for pair in pairwise(own)]
        lowered = [lower_joint(*one) for one in zip(self.joints, self.values, strict=True)]
        masses = {
            row: mass for own, (of, _) in zip(rows, lowered, strict=True) for row, mass in zip(own, of, strict=True)
        }
        springs = [spring for _, of in lowered for spring in of]
        behind, motors = {two: s for s, (_, two) in enumerate(pairs)}, np.array(self.motors, dtype=np.uint64)
        carriers = np.array([behind.get(row, -1) for row in range(len(masses))])
        whole, pieces = _stack([masses[row] for row in range(len(masses))], HIGH + 1), _stack(springs, MASS)
        for row, spring in zip(pieces, springs, strict=True):
            row[len(spring) :, BEGIN] = math.inf
        tied, places = np.array(pairs, dtype=np.uint64).reshape(-1, 2), self.joints[0].places(self.values[0])
        plant = Plant(whole, pieces, places, tied, motors, carriers)
        if self.heavy:
            plant.masses[motors, :, :HIGH], plant.masses[motors, :, HIGH] = 0.0, math.inf
            plant.masses[motors, :, kernels.INERTIA] = self.heavy
        return plant

    def possible(self, plant: Plant, duration: float) -> bool:
        """Test for physical masses, springs and friction over a duration, s.

        Masses are positive, stiffness, damping and friction at rest are not negative, and bands and pieces rise. The
        rotor's inertia of a link may be negative, as only their sum is identifiable. No friction of a robot is
        negative in any part, its springs have a stiffness, and its delays end before the record.
        """
        # Lists: arrays of so few numbers take longer than a joint's simulation of a second.
        masses, springs, links = plant.masses.tolist(), plant.springs.tolist(), len(self.inertials)
        whole = [number for bands in masses for band in bands for number in band[:HIGH]]
        whole += [number for pieces in springs for one in pieces for number in one[:BEGIN] + one[BEGIN + 1 :]]
        if not all(map(math.isfinite, (*whole, *plant.places.flat, *self.inertials.flat))):
            return False
        for i, bands in enumerate(masses):
            rest, last = bands[0], bands[-1]
            inertia, _, _, _, grip, grip_back, *_ = rest
            drift, share, winds = rest[kernels.COULOMB_DRIFT], rest[kernels.PER_TORQUE], rest[kernels.WINDING]
            faded = min(grip, grip_back) + min(drift, 0.0) * duration
            cone = grip + grip_back >= 0.0 and (drift >= 0.0 or faded >= 0.0)
            mass = (i < links or inertia > 0.0) and winds >= 0.0 and 0.0 <= share < 1.0
            unsigned = not links or min(last[kernels.VISCOUS : kernels.COULOMB_BACK + 1]) >= 0.0
            if not (cone and mass and unsigned and all(a[HIGH] <= b[HIGH] for a, b in pairwise(bands))):
                return False
        for pieces in springs:
            least = min(min(*one[:2], one[kernels.SLIPS], one[kernels.WINDING]) for one in pieces)
            if least < 0.0 or not all(a[BEGIN] <= b[BEGIN] for a, b in pairwise(pieces)):
                return False
        late = [own.get(DELAY, 0.0) for own in self.values]
        held = [own.get("stiffness", 1.0) for own in self.values]
        return not links or bool(min(held) > 0.0 and min(late) >= 0.0 and max(late) <= duration)

    def carrying(self, payload: Sequence[float]) -> Numbers:
        """The robot with a payload on its last link, (10,); or ()."""
        if not payload:
            return self
        inertials = self.inertials.copy()
        inertials[-1] += payload
        return replace(self, inertials=inertials)

    def with_values(self, places: Sequence[Place], values: Sequence[float] | FloatArray) -> Numbers:
        """Return a candidate with other numbers in these places."""
        found, inertials = [dict(own) for own in self.values], self.inertials.copy()
        for place, value in zip(places, values, strict=True):
            if place.of_link:
                inertials[place.axis, place.column] = value
            else:
                found[place.axis][place.name] = float(value)
        return replace(self, values=tuple(found), inertials=inertials)

    def with_record(self, other: Numbers, names: Sequence[str] = OF_RECORD) -> Numbers:
        """Candidate with the record's and drives' numbers of another."""
        each = zip(self.values, other.values, strict=True)
        beside = [{**own, **{name: of[name] for name in names if name in of}} for own, of in each]
        return replace(self, values=tuple(beside))

    def not_zero(self) -> list[Place]:
        """Places of nonzero numbers; a Stribeck term has its force only."""
        links = [Place(int(axis), SYMBOLS[column]) for axis, column in np.argwhere(self.inertials)]
        own = [Place(i, name) for i, values in enumerate(self.values) for name, value in values.items() if value]
        return links + [place for place in own if place in self and place.own != "stribeck_speed"]

    def seeds(self, plant: Plant, places: Sequence[Place]) -> Seeds:
        """Derivatives of the plant's numbers by parameters, by a complex step.

        Args:
            plant: of these numbers.
            places: of the parameters; the plant does not depend on those of a first state or a controller.
        """
        found, behind = list[tuple[int, int, int, int, float]](), np.cumsum([0, *(len(own) - 1 for own in self.rows)])
        behind += len(plant.masses)
        for c, place in enumerate(places):
            if place.of_link or place not in self:
                continue
            joint, values = self.joints[place.axis], self.values[place.axis]
            moved = {**values, place.name: complex(values[place.name], _IMAGINARY)}
            masses, springs = lower_joint(joint, moved)
            blocks: list[tuple[int, Any]] = [*zip(self.rows[place.axis], map(np.array, masses), strict=True)]
            blocks = blocks[1:] if self.heavy else blocks
            blocks += enumerate(map(np.array, springs), int(behind[place.axis]))
            blocks += enumerate(joint.places(moved)[:, np.newaxis, : kernels.WAVE], int(behind[-1]))
            for row, block in blocks:
                slopes = np.imag(block)[:, :HIGH] / _IMAGINARY
                found += [(row, int(band), int(k), c, float(slopes[band, k])) for band, k in np.argwhere(slopes)]
        found.sort()
        rows, bands = int(behind[-1]) + len(plant.places), max(plant.masses.shape[1], plant.springs.shape[1])
        begin = np.searchsorted(
            [row * bands + band for row, band, *_ in found],
            bands * np.arange(rows)[:, np.newaxis] + np.arange(bands + 1),
        )
        numbers, columns = (np.array([one[i] for one in found], dtype=np.int64) for i in (2, 3))
        links = [(c, place.axis, place.column) for c, place in enumerate(places) if place.of_link]
        delays = [(c, place.axis) for c, place in enumerate(places) if place.name == DELAY]
        of_links, of_delays = np.array(links, np.int64).reshape(-1, 3), np.array(delays, np.int64).reshape(-1, 2)
        return Seeds(begin, numbers, columns, np.array([one[4] for one in found]), of_links, of_delays)


@lru_cache(maxsize=64)
def names_of(joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's parameters."""
    return tuple(p.name for p in joint.parameters)


# From the numbers of a joint to its plant


def lower_joint(joint: Joint, values: Mapping[str, Any]) -> tuple[list[Rows], list[Rows]]:
    """Masses of a joint, motor first, and the springs between neighbours."""
    friction, constant = joint.friction, joint.gravity_constant(values)
    if isinstance(joint, RigidJoint):
        return [_lower_mass(values["inertia"], values["offset"] + constant, friction, values, "")], []
    beside, load = joint.spring.beside(values), values.get("load_inertia", 0.0)
    share, stiffness, damping = (beside[f"swinging_{word}"] for word in ("share", "stiffness", "damping"))
    swings, whole = np.real(share) > 0.0, load
    if np.real(share) < 0.0:
        load = math.nan
    elif swings or stiffness + damping == 0.0:
        load = (1.0 - share) * load  # a share that is just beginning moves with the load on its spring
    masses = [
        _lower_mass(values["motor_inertia"], values["offset"], friction, values, "motor_"),
        _lower_mass(load, values.get("load_offset", 0.0) + constant, friction, values, "load_"),
    ]
    springs = [_lower_spring(joint.spring, values)]
    if swings:
        masses.append([[share * whole, *[0.0] * (HIGH - 1), math.inf]])
        springs.append(_lower_spring(Spring(), {"stiffness": stiffness, "damping": damping}))
    return masses, springs


def _lower_mass(inertia: Any, offset: Any, law: Friction, values: Mapping[str, Any], side: str) -> Rows:
    """Mass per friction band, (bands, MASS + 1); complex for complex values."""
    beside = law.numbers(values, side)
    return [[inertia, offset, *lines, *beside, high] for high, lines in law.bands(values, side)]


def _lower_spring(law: Spring, values: Mapping[str, Any]) -> Rows:
    """Spring per piece, (pieces, MASS); complex for complex values."""
    own = law.beside(values)
    cubic, slider, slips = (own[name] for name in ("cubic_stiffness", "hysteresis_stiffness", "hysteresis_torque"))
    slides = slider / slips if slips != 0.0 else (math.nan if slider != 0.0 else 0.0)
    rows = []
    for i, piece in enumerate(law.pieces(values)):
        held, begin = piece.torque - piece.stiffness * piece.deflection, piece.deflection + i * _THIN
        row = [piece.stiffness, piece.damping, cubic, slips, held, begin, *[0.0] * (MASS - BEGIN - 1)]
        row[kernels.WINDING] = slides
        rows.append(row)
    return rows


def _stack(each: Sequence[Rows], width: int) -> FloatArray:
    """Stack arrays of rows, padded with each last row."""
    size = max(map(len, each), default=1)
    return np.array([one + one[-1:] * (size - len(one)) for one in each]).reshape(-1, size, width)


# A robot and its numbers


def _values_of(joint: RobotJoint) -> dict[str, float]:
    """Numbers of a robot's joint; one viscous friction per link by default."""
    values, model = joint.values, joint.model
    found = {name: values[name] for name in names_of(model) if name != "load_inertia"}
    winds = any(term.winds for term in model.friction.terms())  # what an offset does not
    for side in model.sides if model.friction.two_ways and not winds else ():
        forwards, backwards = (found.pop(f"{side}coulomb_{way}") for way in _WAYS)
        offset = "load_offset" if side == "load_" else "offset"
        found[f"{side}coulomb"] = 0.5 * (forwards + backwards)
        found[offset] = found.get(offset, 0.0) + 0.5 * (forwards - backwards)
        if side == "load_" and joint.friction is None and found[f"{side}viscous_forwards"] == values["load_viscous"]:
            found["load_viscous"], _ = (found.pop(f"{side}viscous_{way}") for way in _WAYS)
    return found


def values_of_joint(numbers: Numbers, axis: int) -> dict[str, float]:
    """Numbers of a joint under all laws' names, common and per direction."""
    found = dict(numbers.values[axis])
    for side in numbers.joints[axis].sides:
        shift = found.get("load_offset", 0.0) if side == "load_" else 0.0
        for way, sign in _WAYS.items():
            for name, by in (("viscous", 0.0), ("coulomb", sign * shift)):
                found.setdefault(f"{side}{name}_{way}", found.get(f"{side}{name}", 0.0) + by)
        found |= {f"{side}{name}": found.get(f"{side}{name}", found[f"{side}{name}_forwards"]) for name in PARTS}
    return found


def law_places(numbers: Numbers) -> Iterator[tuple[Place, Parameter]]:
    """Yield nonlinear numbers of laws by joint: motors, links, springs.

    Each comes with its parameter in the law. A Stribeck force counts only with a positive Stribeck speed.
    """
    for i, joint in enumerate(numbers.joints):
        for side in joint.sides:
            rises = numbers.values[i].get(f"{side}stribeck_speed", 0.0) > 0.0
            for p in joint.friction.parameters(side):
                own = p.name.removeprefix(side)
                if own in BESIDE and (rises or not own.startswith("stribeck")):
                    yield Place(i, p.name), p
        for spring in joint.springs:
            yield from ((Place(i, p.name), p) for p in spring.parameters[1:-1])


def robot_with(robot: Robot, numbers: Numbers) -> Robot:
    """Return a robot with other numbers; names, places, gravity and coupling stay.

    Asymmetric Coulomb friction that does not wind up becomes its mean and an offset.

    Raises:
        MethodError: a rotor's inertia, with what is grouped with it, is negative.
    """
    joints = []
    for i, joint in enumerate(robot.joints):
        values, motor = values_of_joint(numbers, i), numbers.joints[i].sides[0]
        of_link = (f"load_{name}_{way}" for name in PARTS for way in _WAYS)
        names = [*joint.numbers, *(name for name in of_link if name in numbers.values[i])]
        stated = joint.numbers.keys() & {"stribeck_force", "motor_stribeck_force"}
        own: dict[str, Any] = {name: values[f"{motor}{name}"] for name in ("viscous", "coulomb")}
        behind: dict[str, Any] = {
            name: values.get(name, values.get(f"load_{name}")) for name in ("stiffness", "damping", *own)
        }
        joints.append(
            replace(
                joint,
                **own,
                rotor_inertia=values[f"{motor}inertia"],
                offset=values["offset"],
                viscous_backwards=values[f"{motor}viscous_backwards"] if joint.law.two_ways else None,
                coulomb_backwards=numbers.values[i].get(f"{motor}coulomb_backwards"),
                stribeck_force=0.0 if stated else values.get(f"{motor}stribeck_force", 0.0),
                stribeck_speed=values.get(f"{motor}stribeck_speed") or None,
                spring=joint.spring and replace(joint.spring, **behind),
                numbers={name: values[name] for name in names},
            )
        )
    return replace(robot.with_inertials(numbers.inertials), joints=tuple(joints))
