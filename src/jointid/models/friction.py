"""Friction laws: lines over the velocity, with own coefficients in each direction, in pieces or with more.

Forwards ``Fv+ v + Fc+``, backwards ``Fv- v - Fc-``. Being piecewise linear in velocity lets the simulation be exact;
being linear in its parameters lets a regression estimate them (`columns`). At standstill the Coulomb force is a set:
any force within its bounds keeps the mass at rest.

A law states which parameters its coefficients are (`coefficients`), and the `terms` that it has beside its lines, whose
parameters no regression takes; everything else follows from these. One in pieces has other lines at low speed
(`bands`). One whose terms are numbers of a smooth law is simulated in steps (`stepped`). To add one, write its class
below, and its name in `FRICTIONS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

Directions: TypeAlias = tuple[float, float, float, float]
"""Viscous coefficient forwards and backwards, Coulomb force forwards and backwards (both positive)."""

Part: TypeAlias = Literal["viscous", "coulomb"]
Direction: TypeAlias = Literal["forwards", "backwards"]

PARTS: tuple[Part, ...] = ("viscous", "coulomb")
DIRECTIONS: tuple[Direction, ...] = ("forwards", "backwards")

_QUANTITY: Mapping[Part, Quantity] = {"viscous": Quantity.VISCOUS, "coulomb": Quantity.FORCE}

# exp(-x^2) by straight lines between these points, and 0 above: within 0.0042 of it (found by linear programming).
KNOTS = (
    (0.0, 1.0), (0.148, 0.9822), (0.338, 0.8961), (0.575, 0.7206), (0.982, 0.3774), (1.247, 0.207), (1.514, 0.0973),
    (1.836, 0.0308), (2.375, 0.0),
)  # fmt: skip
_SLOWEST = 1e-12  # of a Stribeck speed, in the joint's unit
_SPEEDS = (0.02, 0.08)  # of the largest speed: where a search for a Stribeck speed begins
_CHANGE = 0.3  # of the Coulomb friction: what a change of it towards standstill begins with
_SHORTEST = 1e-12  # displacement over which friction winds up, in the joint's unit
_DISTANCES = (3e-4, 3e-3)  # of the travel: where a search for that begins
_MOST = 0.9  # of the torque through the spring: a friction that grows by all of it lets nothing through
_LOSS = 0.03  # of the torque through the spring: where a search for a friction that grows with it begins
_WARMED = 0.2  # of the friction, lost at the end: where a search for a change with time begins


def low_speed_share(ratio: FloatArray) -> FloatArray:
    """Return ``exp(-x^2)`` by its straight lines, at speeds over that of Stribeck's law, of any shape."""
    at, share = np.array(KNOTS).T
    return np.asarray(np.interp(np.abs(ratio), at, share))


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One parameter of a friction law, and where it acts.

    Attributes:
        name: of the parameter, after the side's prefix. A name that ends in a direction is the other direction's on the
            far side of a gear that reverses the motion.
        symbol: of the parameter, before the side's index. sign: after it.
        part: "viscous" or "coulomb".
        directions: in which it acts, "forwards", "backwards" or both.
    """

    name: str
    symbol: str
    part: Part
    directions: tuple[Direction, ...] = DIRECTIONS
    sign: str = ""


class Band(NamedTuple):
    """A range of speed with one line of friction in each direction."""

    low: float
    high: float
    directions: Directions


@dataclass(frozen=True, slots=True)
class MotionSize:
    """Size of the motion in a record, for starting values of a friction law.

    Attributes:
        speed: the largest, m/s or rad/s.
        travel: between the ends, m or rad.
        duration: s.
        viscous, coulomb: the lines of the friction that fit it best, means over the directions.
    """

    speed: float
    travel: float
    duration: float
    viscous: float
    coulomb: float


class SmoothFriction(NamedTuple):
    """Numbers of a smooth friction law on one side, beside its lines.

    Attributes:
        presliding: the displacement over which the Coulomb force winds up, m or rad; 0 of one that sticks.
        viscous_drift: by how much the viscous coefficient grows per second.
        coulomb_drift: by how much the Coulomb force grows per second.
        per_torque: the share of a torque that the Coulomb force grows by: on the load's side of the spring's, on the
            motor's of the motor's.
    """

    presliding: float = 0.0
    viscous_drift: float = 0.0
    coulomb_drift: float = 0.0
    per_torque: float = 0.0


class Term(NamedTuple):
    """What a friction law has beside its lines.

    Attributes:
        adds: in words. instead: what its lines are, where only lines are written.
        parameters: name, symbol, quantity, lower and upper bound of each; the names begin with the side's prefix.
        numbers: which of `SmoothFriction` they are; none of a law in pieces.
        starts: returns values of the parameters from which a search may begin.
        of_load: whether it is on the load's side of a flexible joint alone.
    """

    adds: str
    instead: str
    parameters: tuple[tuple[str, str, Quantity, float, float], ...]
    numbers: tuple[str, ...]
    starts: Callable[[MotionSize], list[tuple[float, ...]]]
    of_load: bool = False

    def acts(self, prefix: str) -> bool:
        """Whether it is on the side of that prefix."""
        return not (self.of_load and prefix == "motor_")


def _start_stribeck(motion: MotionSize) -> list[tuple[float, ...]]:
    """A rise and a fall below a few speeds."""
    return [(sign * _CHANGE * motion.coulomb, share * motion.speed) for share in _SPEEDS for sign in (1.0, -1.0)]


def _start_winding(motion: MotionSize) -> list[tuple[float, ...]]:
    """A few parts of the travel."""
    return [(share * motion.travel,) for share in _DISTANCES]


def _start_drift(motion: MotionSize) -> list[tuple[float, ...]]:
    """A fall by a part of both."""
    return [tuple(-_WARMED * size / motion.duration for size in (motion.viscous, motion.coulomb))]


_STRIBECK = Term(
    "the change of friction towards standstill", "what it is above low speed",
    (
        ("stribeck_force", "FS", Quantity.FORCE, -math.inf, math.inf),
        ("stribeck_speed", "vS", Quantity.VELOCITY, _SLOWEST, math.inf),
    ),
    (), _start_stribeck,
)  # fmt: skip
_WINDING = Term(
    "the displacement over which friction winds up", "the Coulomb force that it winds up to",
    (("presliding_distance", "s", Quantity.POSITION, _SHORTEST, math.inf),), ("presliding",), _start_winding,
)  # fmt: skip
_PER_TORQUE = Term(
    "the friction that grows with the gear's torque", "what it is without one",
    (("friction_per_torque", "mu", Quantity.RATIO, 0.0, _MOST),), ("per_torque",), lambda motion: [(_LOSS,)], True,
)  # fmt: skip
_DRIFT = Term(
    "the change of friction with time", "what it is at the first sample",
    (
        ("viscous_drift", "dFv", Quantity.VISCOUS_DRIFT, -math.inf, math.inf),
        ("coulomb_drift", "dFc", Quantity.FORCE_DRIFT, -math.inf, math.inf),
    ),
    ("viscous_drift", "coulomb_drift"), _start_drift,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Friction:
    """A friction law; frozen, so that a joint can be a key.

    Attributes:
        name: in the joint file, the JSON answers and on the command line.
        label: on the web page.
        contrast: name of the law that it is compared with, and whose lines it has where it `adds` anything to lines.
        coefficients: its parameters, in their order; each part has at most one in each direction.
        terms: what it has beside its lines.
    """

    in_json = "name"
    name: ClassVar[str]
    label: ClassVar[str]
    contrast: ClassVar[str] = "symmetric"
    coefficients: ClassVar[tuple[Coefficient, ...]] = (
        Coefficient("viscous", "Fv", "viscous"), Coefficient("coulomb", "Fc", "coulomb"),
    )  # fmt: skip
    terms: ClassVar[tuple[Term, ...]] = ()
    stepped: ClassVar[bool] = False
    """True if it is smooth, so that the simulation goes in steps of a stated error."""
    softens: ClassVar[bool] = False
    """True if without it a spring is found that is much too soft."""
    follows_time: ClassVar[bool] = False
    """Whether it changes with the time since the first sample, which each window of a long log would begin anew."""
    adds: ClassVar[str] = ""
    """What it has beside its lines, in words; "" of lines alone."""
    instead: ClassVar[str] = ""
    """What its lines are, where only lines are written, in words."""

    def __init_subclass__(cls) -> None:
        cls.adds = ", and ".join(term.adds for term in cls.terms)
        cls.instead = ", ".join(term.instead for term in cls.terms)
        cls.stepped = any(term.numbers for term in cls.terms)
        cls.softens, cls.follows_time = _WINDING in cls.terms, _DRIFT in cls.terms

    def coefficient_name(self, part: Part, direction: Direction) -> str | None:
        """Return the name of a coefficient; None if the law has none, so that it is 0."""
        return next((c.name for c in self.coefficients if c.part == part and direction in c.directions), None)

    def depends_on_direction(self, part: Part) -> bool:
        """Return True if the forwards and backwards coefficients of this part are different parameters."""
        return self.coefficient_name(part, "forwards") != self.coefficient_name(part, "backwards")

    @property
    def offset_identifiable(self) -> bool:
        """True if an offset is identifiable beside this law.

        A constant force adds to Fc+ and subtracts from Fc- alike: beside two Coulomb parameters it is not.
        """
        return len(self.constant()) < len(DIRECTIONS)

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return the law's parameters, with `prefix` before the names and `index` after the symbols."""
        lines = (
            Parameter(f"{prefix}{c.name}", f"{c.symbol}{index}{c.sign}", _QUANTITY[c.part], lower=0.0)
            for c in self.coefficients
        )
        beside = (
            Parameter(f"{prefix}{name}", f"{symbol}{index}", quantity, lower=lower, upper=upper)
            for term in self.terms
            if term.acts(prefix)
            for name, symbol, quantity, lower, upper in term.parameters
        )
        return (*lines, *beside)

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return the regressor of the law's parameters, shape (samples, parameters)."""
        columns = []
        for one in self.coefficients:
            moving, sign = np.ones(velocity.shape, dtype=np.bool_), np.sign(velocity)
            if len(one.directions) == 1:
                moving = velocity > 0 if one.directions == ("forwards",) else velocity < 0
            columns.append((velocity if one.part == "viscous" else sign) * moving)
        return np.stack(columns).T

    def directions(self, values: Mapping[str, float], prefix: str = "") -> Directions:
        """Return the coefficients for both directions of motion."""
        one, other, forwards, backwards = (values[prefix + name] if name else 0.0 for name in _slots(self))
        return one, other, forwards, backwards

    @property
    def lines(self) -> Friction:
        """The law of one line in each direction that this one is, or adds to."""
        return FRICTIONS[self.contrast]() if self.adds else self

    @property
    def linear(self) -> bool:
        """True if the law is one line in each direction, and so linear in its parameters."""
        return not self.adds

    def smooth(self, values: Mapping[str, float], prefix: str = "") -> SmoothFriction:
        """Return the numbers of the smooth law beside the lines."""
        found: dict[str, float] = {}
        for term in self.terms:
            if term.acts(prefix):
                found |= {n: values[f"{prefix}{p[0]}"] for n, p in zip(term.numbers, term.parameters, strict=False)}
        return SmoothFriction(**found)

    def drag(self, values: Mapping[str, float], velocity: float, load: float, prefix: str = "") -> float:
        """Return the friction of steady motion, of a mass that the spring drives against a constant load; 0 at rest.

        One that grows with the torque T is in balance with it: ``T = load + F + mu |T| sign(v)``.
        """
        own, share = float(self.force(values, np.array(velocity), prefix)), self.smooth(values, prefix).per_torque
        if velocity == 0.0 or share == 0.0:
            return own
        return (load + own) / (1.0 - share * math.copysign(1.0, velocity) * math.copysign(1.0, load + own)) - load

    def bands(self, values: Mapping[str, float], prefix: str = "") -> tuple[Band, ...]:
        """Return the law by the speed, the slowest band first, without a gap; the last has no end."""
        return (Band(0.0, math.inf, self.directions(values, prefix)),)

    def force(self, values: Mapping[str, float], velocity: FloatArray, prefix: str = "") -> FloatArray:
        """Return the friction of steady motion at velocities, of any shape; 0 at rest."""
        bands = self.bands(values, prefix)
        at = np.searchsorted([band.high for band in bands[:-1]], np.abs(velocity))
        viscous, viscous_back, coulomb, coulomb_back = np.array([band.directions for band in bands]).T[:, at]
        forwards = velocity > 0
        held = np.sign(velocity) * np.where(forwards, coulomb, coulomb_back)
        return np.asarray(np.where(forwards, viscous, viscous_back) * velocity + held)

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield starting values of the parameters beside the lines."""
        beside = [term for term in self.terms if term.acts(prefix)]
        names = [f"{prefix}{name}" for term in beside for name, *_ in term.parameters]
        for values in product(*(term.starts(motion) for term in beside)):
            yield dict(zip(names, (value for one in values for value in one), strict=True))

    def mean(self, part: Part, prefix: str = "") -> dict[str, float]:
        """Return the weights, by parameter, whose sum is the mean of a part over both directions."""
        return {f"{prefix}{c.name}": 0.5 * len(c.directions) for c in self.coefficients if c.part == part}

    def constant(self, prefix: str = "") -> dict[str, float]:
        """Return the weights, by parameter, whose sum is the constant force in the law; none where it has none."""
        half = {"forwards": 0.5, "backwards": -0.5}
        one_way = [c for c in self.coefficients if c.part == "coulomb" and len(c.directions) == 1]
        return {f"{prefix}{c.name}": half[c.directions[0]] for c in one_way}


@cache
def _slots(law: Friction) -> tuple[str | None, ...]:
    """Return the names of a law's coefficients, in the order of `Directions`; every simulation asks for them."""
    return tuple(law.coefficient_name(part, direction) for part in PARTS for direction in DIRECTIONS)


@dataclass(frozen=True, slots=True)
class SymmetricFriction(Friction):
    """Viscous and Coulomb friction, the same in both directions: ``Fv v + Fc sign(v)``, (1) and (2) of the paper."""

    name = "symmetric"
    label = "the same in both directions"
    contrast = "asymmetric"


@dataclass(frozen=True, slots=True)
class AsymmetricFriction(Friction):
    """Viscous and Coulomb friction, different in the two directions.

    A constant offset adds to Fc+ and subtracts from Fc- alike, so it cannot be identified beside this law.
    """

    name = "asymmetric"
    label = "different in the two directions"
    coefficients = (
        Coefficient("viscous_forwards", "Fv", "viscous", ("forwards",), "+"),
        Coefficient("coulomb_forwards", "Fc", "coulomb", ("forwards",), "+"),
        Coefficient("viscous_backwards", "Fv", "viscous", ("backwards",), "-"),
        Coefficient("coulomb_backwards", "Fc", "coulomb", ("backwards",), "-"),
    )


@dataclass(frozen=True, slots=True)
class StribeckFriction(Friction):
    """Symmetric friction that is another towards standstill: ``(Fc + FS exp(-(v / vS)^2)) sign(v) + Fv v``.

    Positive FS is Stribeck's rise (H. Olsson et al., Friction models and friction compensation, European Journal of
    Control 4, 1998), negative FS a friction that is smaller there, as before a contact slides. At rest it holds up to
    Fc + FS. The exponential is taken by straight lines, within 0.5 % of FS, so that the simulation stays exact.
    """

    name = "stribeck"
    label = "the same, another at low speed"
    terms = (_STRIBECK,)

    def bands(self, values: Mapping[str, float], prefix: str = "") -> tuple[Band, ...]:
        """Return a band between each two of the points of the exponential, and one above the last."""
        viscous, viscous_back, coulomb, coulomb_back = self.directions(values, prefix)
        change, speed = values[f"{prefix}stribeck_force"], values[f"{prefix}stribeck_speed"]
        speed = speed or (math.nan if change else 1.0)  # below no speed there is no change
        found = []
        for (low, more), (high, less) in pairwise(KNOTS):
            slope = (less - more) / (high - low)
            steeper, higher = change * slope / speed, change * (more - slope * low)
            line = viscous + steeper, viscous_back + steeper, coulomb + higher, coulomb_back + higher
            found.append(Band(low * speed, high * speed, line))
        return (*found, Band(found[-1].high, math.inf, (viscous, viscous_back, coulomb, coulomb_back)))


@dataclass(frozen=True, slots=True)
class AsymmetricStribeckFriction(StribeckFriction):
    """Viscous and Coulomb friction that differ between the directions, and alike are others towards standstill."""

    name = "asymmetric-stribeck"
    label = "different, another at low speed"
    contrast = "asymmetric"
    coefficients = AsymmetricFriction.coefficients


@dataclass(frozen=True, slots=True)
class PreslidingFriction(Friction):
    """Symmetric friction whose Coulomb force winds up over a displacement after each reversal, as P. R. Dahl's.

    ``dF/dx = (Fc / s) (1 - F sign(v) / Fc)``, Solid friction damping of mechanical vibrations, AIAA Journal 14, 1976:
    a spring of ``2 Fc / s`` right behind a reversal, half of that where it is not wound up, and Coulomb's force a few
    ``s`` further. Nothing sticks: a joint that stands under a load creeps until that spring carries it.
    """

    name = "presliding"
    label = "the same, wound up at reversals"
    terms: ClassVar[tuple[Term, ...]] = (_WINDING,)


@dataclass(frozen=True, slots=True)
class LoadDependentFriction(Friction):
    """Symmetric friction that grows with the torque through the gear: ``(Fc + mu |T|) sign(v) + Fv v``.

    Of a flexible joint T is the torque of spring and damper, and the friction is the load's, ``Fc2 + mu |T12|``. Of a
    rigid one T is the motor's torque, since no motion tells its rotor from what the gear drives. A gear that drives
    passes on ``1 - mu`` of the torque, one that brakes takes ``1 + mu`` of it (P. Hamon, M. Gautier and P. Garrec:
    Dynamic identification of robots with a dry friction model depending on load and velocity, IROS 2010). Valid where
    the share is well below 1.
    """

    name = "load-dependent"
    label = "the same, more under load"
    terms = (_PER_TORQUE,)


@dataclass(frozen=True, slots=True)
class AsymmetricLoadDependentFriction(LoadDependentFriction):
    """Friction that differs between the directions, and in both grows alike with the torque through the gear."""

    name = "asymmetric-load-dependent"
    label = "different, more under load"
    contrast = "asymmetric"
    coefficients = AsymmetricFriction.coefficients


@dataclass(frozen=True, slots=True)
class WoundLoadDependentFriction(PreslidingFriction):
    """Friction of both kinds: ``(Fc + mu |T|) z``, where z winds up over a displacement.

    The efficiency of a gear in P. R. Dahl's form: what is lost of the torque builds up behind a reversal as friction
    does. Of such an efficiency that differs by the direction of power the difference, ``mu' T z^2``, is a torque in
    proportion to the gear's wherever the load slides: as a load of other inertia and friction, from which no torque
    tells it.
    """

    name = "presliding-load-dependent"
    label = "wound up, more under load"
    terms = (_WINDING, _PER_TORQUE)


@dataclass(frozen=True, slots=True)
class DriftingFriction(Friction):
    """Symmetric friction that changes steadily with time, as oil grows warm: ``(Fv + dFv t) v + (Fc + dFc t) sign(v)``.

    The time counts from the first sample. A change that goes on for much longer than a record is nearly steady in it.
    """

    name = "drifting"
    label = "the same, changing with time"
    terms = (_DRIFT,)


FRICTIONS: Mapping[str, type[Friction]] = {
    law.name: law
    for law in (
        SymmetricFriction, AsymmetricFriction, StribeckFriction, AsymmetricStribeckFriction, PreslidingFriction,
        LoadDependentFriction, AsymmetricLoadDependentFriction, WoundLoadDependentFriction, DriftingFriction,
    )
}  # fmt: skip
"""Every friction law by its name in the joint file."""


def find_friction(name: str) -> Friction:
    """Return the friction law of that name.

    Raises:
        MethodError: the law is not known.
    """
    if name not in FRICTIONS:
        raise MethodError(f'Friction "{name}" is not known; use {", ".join(FRICTIONS)}.')
    return FRICTIONS[name]()
