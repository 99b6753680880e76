"""Friction laws: lines over the velocity, with own coefficients in each direction, in pieces or with more.

Forwards ``Fv+ v + Fc+``, backwards ``Fv- v - Fc-``. Being piecewise linear in velocity lets the simulation be exact;
being linear in its parameters lets a regression estimate them (`columns`). At standstill the Coulomb force is a set:
any force within its bounds keeps the mass at rest.

A law states which parameters its coefficients are (`coefficients`); everything else follows from that table. One in
pieces has other lines at low speed (`bands`), of parameters that no regression takes. One that is no line at any speed
says so (`stepped`) and what it has beside its lines (`smooth`): it is simulated in steps. To add one, write its class
below, and its name in `FRICTIONS`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.models.smooth import SmoothFriction

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


@dataclass(frozen=True, slots=True)
class Friction:
    """A friction law; frozen, so that a joint can be a key.

    Attributes:
        name: in the joint file, the JSON answers and on the command line.
        label: on the web page.
        contrast: name of the law that it is compared with, and whose lines it has where it `adds` anything to lines.
        coefficients: its parameters, in their order; each part has at most one in each direction.
    """

    in_json = "name"
    name: ClassVar[str]
    label: ClassVar[str]
    contrast: ClassVar[str] = "symmetric"
    coefficients: ClassVar[tuple[Coefficient, ...]] = (
        Coefficient("viscous", "Fv", "viscous"), Coefficient("coulomb", "Fc", "coulomb"),
    )  # fmt: skip
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
        """Return the law's parameters, with `prefix` before the names and `index` after Fv and Fc."""
        return tuple(
            Parameter(f"{prefix}{c.name}", f"{c.symbol}{index}{c.sign}", _QUANTITY[c.part], lower=0.0)
            for c in self.coefficients
        )

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
        return SmoothFriction()

    def drag(self, values: Mapping[str, float], velocity: float, load: float, prefix: str = "") -> float:
        """Return the friction of steady motion, of a mass that the spring drives against a constant load; 0 at rest."""
        return float(self.force(values, np.array(velocity), prefix))

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
        yield {}

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
    adds, instead = "the change of friction towards standstill", "what it is above low speed"

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return Fv and Fc, then the change towards standstill and the speed below which it is."""
        return (
            *Friction.parameters(self, prefix, index),
            Parameter(f"{prefix}stribeck_force", f"FS{index}", Quantity.FORCE),
            Parameter(f"{prefix}stribeck_speed", f"vS{index}", Quantity.VELOCITY, lower=_SLOWEST),
        )

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

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield a rise and a fall below a few speeds."""
        change = _CHANGE * motion.coulomb
        for share in _SPEEDS:
            for sign in (1.0, -1.0):
                yield {f"{prefix}stribeck_force": sign * change, f"{prefix}stribeck_speed": share * motion.speed}


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
    stepped = True
    label = "the same, wound up at reversals"
    softens = True
    adds, instead = "the displacement over which friction winds up", "the Coulomb force that it winds up to"

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return Fv and Fc, then the displacement over which Fc winds up."""
        distance = Parameter(f"{prefix}presliding_distance", f"s{index}", Quantity.POSITION, lower=_SHORTEST)
        return (*Friction.parameters(self, prefix, index), distance)

    def smooth(self, values: Mapping[str, float], prefix: str = "") -> SmoothFriction:
        """Return the displacement."""
        return SmoothFriction(presliding=values[f"{prefix}presliding_distance"])

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield a few parts of the travel."""
        for share in _DISTANCES:
            yield {f"{prefix}presliding_distance": share * motion.travel}


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
    stepped = True
    label = "the same, more under load"
    adds, instead = "the friction that grows with the gear's torque", "what it is without one"

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return Fv and Fc, and the share of the torque; of a flexible joint on the load side."""
        own = Friction.parameters(self, prefix, index)
        share = Parameter(f"{prefix}friction_per_torque", f"mu{index}", Quantity.RATIO, lower=0.0, upper=_MOST)
        return own if prefix == "motor_" else (*own, share)

    def smooth(self, values: Mapping[str, float], prefix: str = "") -> SmoothFriction:
        """Return the share; of a flexible joint on the load side."""
        return SmoothFriction(per_torque=0.0 if prefix == "motor_" else values[f"{prefix}friction_per_torque"])

    def drag(self, values: Mapping[str, float], velocity: float, load: float, prefix: str = "") -> float:
        """Return the friction that is in balance with the torque it grows with: ``T = load + F + mu |T| sign(v)``."""
        own = float(self.force(values, np.array(velocity), prefix))
        if velocity == 0.0:
            return own
        share = values[f"{prefix}friction_per_torque"] * math.copysign(1.0, velocity)
        return (load + own) / (1.0 - share * math.copysign(1.0, load + own)) - load

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield a small share."""
        yield {} if prefix == "motor_" else {f"{prefix}friction_per_torque": _LOSS}


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
    adds = f"{PreslidingFriction.adds}, and {LoadDependentFriction.adds}"
    instead = f"{PreslidingFriction.instead}, {LoadDependentFriction.instead}"

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return Fv, Fc and the displacement over which it winds up, then the share of `LoadDependentFriction`."""
        own = Friction.parameters(self, prefix, index)
        wound, loaded = PreslidingFriction(), LoadDependentFriction()
        return (*wound.parameters(prefix, index), *loaded.parameters(prefix, index)[len(own) :])

    def smooth(self, values: Mapping[str, float], prefix: str = "") -> SmoothFriction:
        """Return the displacement, and the share of `LoadDependentFriction`."""
        loaded = LoadDependentFriction().smooth(values, prefix)
        return PreslidingFriction().smooth(values, prefix)._replace(per_torque=loaded.per_torque)

    def drag(self, values: Mapping[str, float], velocity: float, load: float, prefix: str = "") -> float:
        """Return the friction where it is wound up, as of `LoadDependentFriction`."""
        return LoadDependentFriction().drag(values, velocity, load, prefix)

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield a few parts of the travel, each with a small share."""
        for wound in PreslidingFriction().starts(motion, prefix):
            for loaded in LoadDependentFriction().starts(motion, prefix):
                yield wound | loaded


@dataclass(frozen=True, slots=True)
class DriftingFriction(Friction):
    """Symmetric friction that changes steadily with time, as oil grows warm: ``(Fv + dFv t) v + (Fc + dFc t) sign(v)``.

    The time counts from the first sample. A change that goes on for much longer than a record is nearly steady in it.
    """

    name = "drifting"
    stepped = True
    label = "the same, changing with time"
    follows_time = True
    adds, instead = "the change of friction with time", "what it is at the first sample"

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Return Fv and Fc, then by how much each grows per second."""
        viscous = Parameter(f"{prefix}viscous_drift", f"dFv{index}", Quantity.VISCOUS_DRIFT)
        coulomb = Parameter(f"{prefix}coulomb_drift", f"dFc{index}", Quantity.FORCE_DRIFT)
        return (*Friction.parameters(self, prefix, index), viscous, coulomb)

    def smooth(self, values: Mapping[str, float], prefix: str = "") -> SmoothFriction:
        """Return the changes per second."""
        viscous, coulomb = (values[f"{prefix}{part}_drift"] for part in PARTS)
        return SmoothFriction(viscous_drift=viscous, coulomb_drift=coulomb)

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield a fall by a part of both."""
        fallen = {"viscous": motion.viscous, "coulomb": motion.coulomb}
        yield {f"{prefix}{part}_drift": -_WARMED * size / motion.duration for part, size in fallen.items()}


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
