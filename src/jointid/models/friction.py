"""Friction laws: lines over velocity for each direction, and additional terms.

Being linear in the parameters of its lines lets a regression estimate them (`Friction.columns`). At standstill the
Coulomb force is a set: any force within its bounds keeps the mass at rest. To add a term, write its row in `_TERMS`,
and for a state of friction its rate, which that row names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

Directions: TypeAlias = tuple[float, float, float, float]
"""Viscous coefficient forwards and backwards, Coulomb force forwards and backwards (both positive)."""

Part: TypeAlias = Literal["viscous", "coulomb"]

PARTS: tuple[Part, ...] = ("viscous", "coulomb")

# exp(-x^2) by straight lines between these points, and 0 above: within 0.0042 of it (found by linear programming).
KNOTS = (
    (0.0, 1.0), (0.148, 0.9822), (0.338, 0.8961), (0.575, 0.7206), (0.982, 0.3774), (1.247, 0.207), (1.514, 0.0973),
    (1.836, 0.0308), (2.375, 0.0),
)  # fmt: skip
_LINES = 6  # numbers of a mass before those of its terms
_LEAST = 1e-12  # of a Stribeck speed, and of a displacement over which friction winds up, in the joint's unit
_SPEEDS = (0.02, 0.08)  # of the largest speed: where a search for a Stribeck speed begins
_CHANGE = 0.3  # of the Coulomb friction: what a change of it towards standstill begins with
_DISTANCES = (3e-4, 3e-3)  # of the travel: where a search for what winds up begins
_MOST = 0.9  # of the torque through the spring: a friction that grows by all of it lets nothing through
_LOSS = 0.03  # of the torque through the spring: where a search for a friction that grows with it begins
_WARMED = 0.2  # of the friction, lost at the end: where a search for a change with time begins


class Coefficient(NamedTuple):
    """One parameter of a law's lines.

    Attributes:
        name: after the side's prefix. A name that ends in a direction is the other direction's on the far side of a
            gear that reverses the motion.
        symbol: before the side's index.
        part: "viscous" or "coulomb". way: 1 or -1, the direction in which it acts; 0 of both.
    """

    name: str
    symbol: str
    part: Part
    way: int


_ONE_WAY = Coefficient("viscous", "Fv", "viscous", 0), Coefficient("coulomb", "Fc", "coulomb", 0)
_TWO_WAYS = tuple(
    one._replace(name=f"{one.name}_{direction}", way=way)
    for direction, way in (("forwards", 1), ("backwards", -1))
    for one in _ONE_WAY
)


class MotionSize(NamedTuple):
    """Size of a record's motion, for starting values of a friction law.

    Attributes:
        speed: the largest, m/s or rad/s.
        travel: between the ends, m or rad.
        duration: s.
        viscous, coulomb: of the best-fitting lines, means over the directions.
    """

    speed: float
    travel: float
    duration: float
    viscous: float
    coulomb: float


class Term(NamedTuple):
    """Numbers of a friction law beside its lines.

    Attributes:
        adds: the term in words. instead: its lines in words, for exports of lines only.
        parameters: name, symbol, quantity, lower and upper bound of each; the names begin with the side's prefix.
        starts: returns start values of the parameters.
        of_load: whether it acts on the load side of a flexible joint only.
        winds: of a Coulomb force that winds up, ``winds(numbers, i, way, v, w)``: rate of the share w that acts, -1 to
            1, and partial of the rate by w, at a velocity v in the direction `way`. ``numbers[i, WINDING]`` is one over
            the first parameter; the others follow. Kernels compile it for complex numbers: use `way`, not ``abs(v)``.
    """

    adds: str
    instead: str
    parameters: tuple[tuple[str, str, Quantity, float, float], ...]
    starts: Callable[[MotionSize], list[tuple[float, ...]]]
    of_load: bool = False
    winds: Callable[..., tuple[Any, Any]] | None = None


def _dahl(numbers: NDArray[Any], i: int, way: float, v: Any, w: Any) -> tuple[Any, Any]:
    rate = numbers[i, WINDING] * v
    return rate * (1.0 - way * w), -way * rate


_TERMS: Mapping[str, Term] = {
    "stribeck": Term(
        "the change of friction towards standstill", "what it is above low speed",
        (
            ("stribeck_force", "FS", Quantity.FORCE, -math.inf, math.inf),
            ("stribeck_speed", "vS", Quantity.VELOCITY, _LEAST, math.inf),
        ),
        lambda size: [(sign * _CHANGE * size.coulomb, share * size.speed) for share in _SPEEDS for sign in (1.0, -1.0)],
    ),
    "presliding": Term(
        "the displacement over which friction winds up", "the Coulomb force that it winds up to",
        (("presliding_distance", "s", Quantity.POSITION, _LEAST, math.inf),),
        lambda size: [(share * size.travel,) for share in _DISTANCES], winds=_dahl,
    ),
    "drifting": Term(
        "the change of friction with time", "what it is at the first sample",
        (
            ("viscous_drift", "dFv", Quantity.VISCOUS_DRIFT, -math.inf, math.inf),
            ("coulomb_drift", "dFc", Quantity.FORCE_DRIFT, -math.inf, math.inf),
        ),
        lambda size: [(-_WARMED * size.viscous / size.duration, -_WARMED * size.coulomb / size.duration)],
    ),
    "load-dependent": Term(
        "the friction that grows with the gear's torque", "what it is without one",
        (("friction_per_torque", "mu", Quantity.RATIO, 0.0, _MOST),), lambda size: [(_LOSS,)], True,
    ),
}  # fmt: skip
BESIDE = tuple(name for term in _TERMS.values() for name, *_ in term.parameters)
"""The numbers that a law may have beside its lines, by their names without a side's prefix."""
_FORCES = [term for word, term in _TERMS.items() if not (term.winds or word == "stribeck")]
COLUMNS = {own[0]: i for i, own in enumerate((own for term in _FORCES for own in term.parameters), _LINES)}
"""Of these in a mass's numbers (`simulation.kernels`); a Stribeck term is in the lines."""
WINDS = [term.winds for term in _TERMS.values() if term.winds]
LAW, WINDING = _LINES + len(COLUMNS), _LINES + len(COLUMNS) + 1
"""Columns of which of `WINDS` it is, and of the first of its numbers."""
WIDTH = WINDING + max(len(term.parameters) for term in _TERMS.values() if term.winds)


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction law by its joined names, such as "asymmetric-stribeck"; immutable and hashable.

    The friction ``Fv v + Fc sign(v)`` is "symmetric", (1) and (2) of the paper. "presliding" takes no "stribeck":

    - "asymmetric": ``Fv+ v + Fc+`` forwards, ``Fv- v - Fc-`` backwards. A constant offset adds to Fc+ and subtracts
      from Fc- alike, so it cannot be identified beside this law.
    - "stribeck": ``Fc + FS exp(-(v / vS)^2)`` takes Fc's place. Positive FS is Stribeck's rise (H. Olsson et al.,
      Friction models and friction compensation, European Journal of Control 4, 1998), negative FS a friction that is
      smaller towards standstill, as before a contact slides. At rest it holds up to Fc + FS. The exponential is taken
      by straight lines, within 0.5 % of FS.
    - "presliding": the Coulomb force F winds up over a displacement after each reversal, ``dF/dx = (Fc / s) (1 - F
      sign(v) / Fc)`` (P. R. Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14, 1976): a spring of
      ``2 Fc / s`` right behind a reversal, half of that where it is not wound up, and Coulomb's force a few ``s``
      further. Nothing sticks: a joint that stands under a load creeps until that spring carries it.
    - "drifting": ``(Fv + dFv t) v + (Fc + dFc t) sign(v)``, as oil grows warm. The time counts from the first sample. A
      change that goes on for much longer than a record is nearly steady in it.
    - "load-dependent": ``Fc + mu |T|`` takes Fc's place. Of a flexible joint T is the torque of spring and damper, and
      the friction is the load's. Of a rigid one T is the motor's torque, since no motion distinguishes its rotor from
      the load. A gear that drives passes on ``1 - mu`` of the torque, one that brakes takes ``1 + mu`` of it (P.
      Hamon, M. Gautier and P. Garrec: Dynamic identification of robots with a dry friction model depending on load and
      velocity, IROS 2010). Valid where the share is well below 1.

    Raises:
        MethodError: there is no such law.
    """

    name: str = "symmetric"

    def __post_init__(self) -> None:
        whole = "-".join(word for word in ("asymmetric", *_TERMS) if word in str(self.name)) or "symmetric"
        winding = sum(term.winds is not None for word, term in _TERMS.items() if word in whole)
        if self.name != whole or winding + ("stribeck" in whole) > 1:  # lines that wind up jump from band to band
            raise MethodError(f'Friction "{self.name}" is not known; use {", ".join(FRICTIONS)}.')

    @property
    def two_ways(self) -> bool:
        """True if the lines differ with the direction: no offset is identifiable beside two Coulomb forces."""
        return self.name.startswith("asymmetric")

    def terms(self, prefix: str = "") -> list[Term]:
        """Terms of the law beside its lines; on the motor side without those of a load."""
        own = (term for word, term in _TERMS.items() if word in self.name)
        return [term for term in own if not (term.of_load and prefix == "motor_")]

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The parameters of its lines, in their order."""
        return _TWO_WAYS if self.two_ways else _ONE_WAY

    @property
    def adds(self) -> str:
        """Terms of the law in words; "" of lines alone."""
        return ", and ".join(term.adds for term in self.terms())

    @property
    def instead(self) -> str:
        """Lines of the law in words, for where only lines are written."""
        return ", ".join(term.instead for term in self.terms())

    @property
    def stepped(self) -> bool:
        """True if a simulation has more than lines over the speed."""
        return any(term is not _TERMS["stribeck"] for term in self.terms())

    @property
    def linear(self) -> bool:
        """True if linear in the parameters: one line per direction."""
        return not self.terms()

    @property
    def lines(self) -> Friction:
        """The law without additional terms: one line per direction."""
        return Friction("asymmetric" if self.two_ways else "symmetric")

    def parameters(self, prefix: str = "", index: str = "") -> tuple[Parameter, ...]:
        """Parameters of the law, `prefix` before names and `index` after symbols."""
        quantity = {"viscous": Quantity.VISCOUS, "coulomb": Quantity.FORCE}
        lines = (
            Parameter(f"{prefix}{c.name}", f"{c.symbol}{index}{('', '+', '-')[c.way]}", quantity[c.part], lower=0.0)
            for c in self.coefficients
        )
        beside = (
            Parameter(f"{prefix}{name}", f"{symbol}{index}", what, lower=lower, upper=upper)
            for term in self.terms(prefix)
            for name, symbol, what, lower, upper in term.parameters
        )
        return (*lines, *beside)

    def columns(self, velocity: FloatArray) -> FloatArray:
        """Return the regressor of the law's lines, shape (samples, parameters)."""
        sign, columns = np.sign(velocity), []
        for one in self.coefficients:
            moving = (sign == one.way) | (one.way == 0)
            columns.append((velocity if one.part == "viscous" else sign) * moving)
        return np.stack(columns).T

    def directions(self, values: Mapping[str, float], prefix: str = "") -> Directions:
        """Coefficients of both directions; a value without direction holds for both."""
        if not self.two_ways:
            viscous, coulomb = values[f"{prefix}viscous"], values[f"{prefix}coulomb"]
            return viscous, viscous, coulomb, coulomb
        names = ((f"{prefix}{one.name}", f"{prefix}{one.part}") for one in _TWO_WAYS)
        forwards, held, backwards, held_back = (values[own if own in values else both] for own, both in names)
        return forwards, backwards, held, held_back

    def numbers(self, values: Mapping[str, Any], prefix: str = "") -> list[Any]:
        """Numbers of a mass behind its lines; 0 for absent terms."""
        law, winding, others = 0, [0.0] * (WIDTH - WINDING), dict.fromkeys(COLUMNS, 0.0)
        for term in self.terms(prefix):
            own = {name: values[f"{prefix}{name}"] for name, *_ in term.parameters}
            if term.winds:
                law, winding[: len(own)] = WINDS.index(term.winds), own.values()
            others |= own
        winding[0] = 1.0 / winding[0] if winding[0] != 0.0 else 0.0
        return [*(others[name] for name in COLUMNS), law, *winding]

    def bands(self, values: Mapping[str, float], prefix: str = "") -> list[tuple[float, Directions]]:
        """Bands of speed, slowest first: upper end (the last infinite) and lines.

        A Stribeck term has a band between neighbouring points of its exponential.
        """
        viscous, viscous_back, coulomb, coulomb_back = whole = self.directions(values, prefix)
        found: list[tuple[float, Directions]] = []
        names = f"{prefix}stribeck_force", f"{prefix}stribeck_speed"
        change, speed = (values[name] for name in names) if _TERMS["stribeck"] in self.terms() else (0.0, 0.0)
        if change or speed:  # below no speed there is no change
            speed = speed or math.nan
            for (low, more), (high, less) in pairwise(KNOTS):
                slope = (less - more) / (high - low)
                steeper, higher = change * slope / speed, change * (more - slope * low)
                line = viscous + steeper, viscous_back + steeper, coulomb + higher, coulomb_back + higher
                found.append((high * speed, line))
        return [*found, (math.inf, whole)]

    def drag(self, values: Mapping[str, float], velocity: float, load: float, prefix: str = "") -> float:
        """Friction in steady motion against a constant load; 0 at rest.

        Load-dependent friction is in balance with the torque T: ``T = load + F + mu |T| sign(v)``.
        """
        if velocity == 0.0:
            return 0.0
        bands, way = self.bands(values, prefix), math.copysign(1.0, velocity)
        lines = next((lines for high, lines in bands if abs(velocity) <= high), bands[-1][1])
        viscous, coulomb = lines[::2] if way > 0.0 else lines[1::2]
        own = viscous * velocity + way * coulomb
        share = way * self.numbers(values, prefix)[COLUMNS["friction_per_torque"] - _LINES]
        return own if share == 0.0 else (load + own) / (1.0 - share * math.copysign(1.0, load + own)) - load

    def starts(self, motion: MotionSize, prefix: str = "") -> Iterator[dict[str, float]]:
        """Yield starting values of the parameters beside the lines."""
        terms = self.terms(prefix)
        names = [f"{prefix}{name}" for term in terms for name, *_ in term.parameters]
        for values in product(*(term.starts(motion) for term in terms)):
            yield dict(zip(names, (value for one in values for value in one), strict=True))

    def mean(self, part: Part, prefix: str = "") -> dict[str, float]:
        """Weights of parameters for a part's mean over both directions."""
        return {f"{prefix}{c.name}": 0.5 if c.way else 1.0 for c in self.coefficients if c.part == part}

    def constant(self, prefix: str = "") -> dict[str, float]:
        """Weights of parameters for the constant force in the law, if any."""
        return {f"{prefix}{c.name}": 0.5 * c.way for c in self.coefficients if c.part == "coulomb" and c.way}


FRICTIONS: Mapping[str, Friction] = {
    name: Friction(name)
    for name in (
        "symmetric", "asymmetric", "stribeck", "asymmetric-stribeck", "presliding", "load-dependent",
        "asymmetric-load-dependent", "presliding-load-dependent", "drifting",
    )
}  # fmt: skip
"""The friction laws that joint files declare and comparisons try, by their names."""
