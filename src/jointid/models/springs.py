"""Springs of a flexible joint: in pieces between which the torque goes on where it was, and with terms beside them.

A law states the pieces of one side of its torque over the deflection; the other side is the same, turned round::

    torque(e) = sign(e) (T + K (|e| - e0))      from the deflection e0, where the piece begins with the torque T

Makers of strain-wave gears state three: K1 up to the torque T1, K2 up to T2, then K3 (Harmonic Drive SE, Engineering
data, torsional stiffness). Backlash is a first piece without any stiffness. A smooth spring says so (`stepped`), and
has other parameters beside its line. To add a law, write its class below, and its name in `SPRINGS`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

_SHARES = (0.1, 0.3)  # of the largest wind-up, from which a search for another piece begins
_GAPS = (0.1, 0.3, 0.6, 0.8)  # of it, for half the gap
_NEWTON = 50  # steps to the deflection of a smooth spring
_LEAST = 1e-12  # torque at which a slider slips
_PARTS, _TIMES = (0.2, 0.5), (1.7, 3.0)  # of the load that swings at so many times the first mode, at a start
_WHOLE = 0.99  # of a load: the part behind the first spring has some inertia
_SOFTER, _STIFFER = 0.7, 1.3  # first and last piece at the start of a search, over the linear spring's stiffness


class Piece(NamedTuple):
    """One piece of a spring: the deflection and the torque it begins at, its stiffness, and the damping beside it."""

    deflection: float
    torque: float
    stiffness: float
    damping: float


@dataclass(frozen=True, slots=True)
class Spring:
    """The law of a joint's spring, linear unless overridden; frozen, so that a joint can be a key.

    Each has the parameters ``stiffness``, of its first piece that has one, and ``damping``, of the damper beside it.

    Attributes:
        name: in the joint file and the JSON answers.
        label: on the web page.
        symbol: of its stiffness.
        own: its parameters between stiffness and damping.
        words: the spring in words, with its parameters in braces.
        adds: what a smooth spring has beside its line, in words. instead: what its line is, where only that is written.
        stepped: whether it is smooth.
    """

    in_json = "name"
    name: ClassVar[str]
    label: ClassVar[str]
    symbol: ClassVar[str] = "K12"
    own: ClassVar[tuple[Parameter, ...]] = ()
    words: ClassVar[str] = "{stiffness}"
    adds: ClassVar[str] = ""
    instead: ClassVar[str] = ""
    stepped: ClassVar[bool] = False

    @property
    def linear(self) -> bool:
        """True if the spring is one piece."""
        return not self.own

    @property
    def lines(self) -> Spring:
        """The linear spring that this one is, or is another than."""
        return self if self.linear else LinearSpring()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness first, damping last."""
        first = Parameter("stiffness", self.symbol, Quantity.STIFFNESS, lower=0.0)
        return (first, *self.own, Parameter("damping", "F12", Quantity.VISCOUS, lower=0.0))

    def pieces(self, values: Mapping[str, float]) -> tuple[Piece, ...]:
        """Return the pieces of one side, by rising deflection; the first begins at 0, with no torque."""
        return (Piece(0.0, 0.0, values["stiffness"], values["damping"]),)

    def beside(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the numbers of the smooth laws by their names; 0 of those that this one has not."""
        own = {p.name for p in self.own} if self.stepped else set()
        return {name: values[name] if name in own else 0.0 for name in _BESIDE}

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield values of all but the damping from which a search may begin, beside those with a linear spring.

        Args:
            linear: values of the joint with the linear spring that fits best.
            windup: the largest deflection of that.
        """
        yield {"stiffness": linear["stiffness"]}

    def describe(self, shown: Mapping[str, str]) -> str:
        """Return the spring in words, from what is shown of all its parameters but the damping."""
        return self.words.format(**{name: text.removesuffix(" 1") for name, text in shown.items()})  # a share's unit

    def deflection(self, values: Mapping[str, float], torque: float) -> float:
        """Return the deflection under a constant torque; 0 under none."""
        size, found = abs(torque), 0.0
        if size == 0.0:
            return 0.0
        for piece in self.pieces(values):
            if size >= piece.torque:
                found = piece.deflection + ((size - piece.torque) / piece.stiffness if piece.stiffness > 0.0 else 0.0)
        return math.copysign(found, torque)

    def torque(self, values: Mapping[str, float], deflection: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the torque of spring and damper, (samples,), at deflections and their rates, (samples,)."""
        pieces, size = self.pieces(values), np.abs(deflection)
        at = np.searchsorted([piece.deflection for piece in pieces[1:]], size, side="right")
        begin, torque, stiffness, damping = np.array(pieces).T[:, at]
        return np.asarray(np.sign(deflection) * (torque + stiffness * (size - begin)) + damping * velocity)


@dataclass(frozen=True, slots=True)
class LinearSpring(Spring):
    """A spring whose torque is ``K12 e``, (2) of the paper."""

    name = "linear"
    label = "linear"


@dataclass(frozen=True, slots=True)
class PiecewiseSpring(Spring):
    """A spring in pieces, each with a stiffness, that end at given torques; its damper acts in all of them."""

    symbol = "K1"

    @property
    def count(self) -> int:
        """Number of its pieces."""
        return len(self.own) // 2 + 1

    def pieces(self, values: Mapping[str, float]) -> tuple[Piece, ...]:
        """Return the pieces; one without a stiffness never ends."""
        found, deflection, before = [], 0.0, 0.0
        for i in range(1, self.count + 1):
            stiffness = values["stiffness" if i == 1 else f"stiffness_{i}"]
            found.append(Piece(deflection, before, stiffness, values["damping"]))
            if i < self.count:
                torque = values[f"torque_{i}"]
                deflection = deflection + (torque - before) / stiffness if stiffness else math.inf
                before = torque
        return tuple(found)

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield a stiffening and a softening spring, in equal parts of the largest torque."""
        stiffness, names = linear["stiffness"], [p.name for p in self.parameters[:-1]]
        torques = [stiffness * windup * i / self.count for i in range(1, self.count)]
        for shares in ((_SOFTER, _STIFFER), (_STIFFER, _SOFTER)):
            yield dict(zip(names, [*(stiffness * np.linspace(*shares, self.count)), *torques], strict=True))


def _pieces(count: int) -> tuple[Parameter, ...]:
    """Return the parameters of the pieces: K2, K3, ..., then T1, T2, ..."""
    then = (Parameter(f"stiffness_{i}", f"K{i}", Quantity.STIFFNESS, lower=0.0) for i in range(2, count + 1))
    return (*then, *(Parameter(f"torque_{i}", f"T{i}", Quantity.FORCE, lower=0.0) for i in range(1, count)))


@dataclass(frozen=True, slots=True)
class TwoPieceSpring(PiecewiseSpring):
    """A spring of stiffness K1 up to the torque T1, and K2 above."""

    name = "two-piece"
    label = "of two stiffnesses"
    own = _pieces(2)
    words = "{stiffness} up to {torque_1}, {stiffness_2} above"


@dataclass(frozen=True, slots=True)
class ThreePieceSpring(PiecewiseSpring):
    """A spring of stiffness K1 up to the torque T1, K2 up to T2, and K3 above: a strain-wave gear's."""

    name = "three-piece"
    label = "of three stiffnesses"
    own = _pieces(3)
    words = "{stiffness} up to {torque_1}, {stiffness_2} up to {torque_2}, {stiffness_3} above"


@dataclass(frozen=True, slots=True)
class Backlash(Spring):
    """A linear spring behind a gap: it carries no torque, and nothing damps, until half the gap is taken up.

    ``torque = K12 (|e| - gap / 2) sign(e) + F12 e'`` where ``|e| > gap / 2``, else 0. The gap is that between the
    flanks, from one contact to the other.
    """

    name = "backlash"
    label = "linear, behind a gap"
    own = (Parameter("gap", "gap", Quantity.POSITION, lower=0.0),)
    words = "{stiffness} behind a gap of {gap}"

    def pieces(self, values: Mapping[str, float]) -> tuple[Piece, ...]:
        """Return the gap and the spring behind it."""
        return Piece(0.0, 0.0, 0.0, 0.0), Piece(0.5 * values["gap"], 0.0, values["stiffness"], values["damping"])

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield gaps of a part of the deflection; the spring alone is stiffer by that."""
        for share in _GAPS:
            yield {"stiffness": linear["stiffness"] / (1 - share), "gap": 2 * share * windup}


@dataclass(frozen=True, slots=True)
class CubicSpring(Spring):
    """A spring that grows stiffer, or softer, smoothly: ``K12 e + K3 e^3`` (the spring of G. Duffing's oscillator).

    A softening one pulls less and less above the deflection of ``(K12 / 3 |K3|)^0.5``: valid below that.
    """

    name = "cubic"
    stepped = True
    label = "stiffer as it winds up"
    own = (Parameter("cubic_stiffness", "K3", Quantity.CUBIC_STIFFNESS),)
    words = "{stiffness}, and {cubic_stiffness} times the cube of the deflection"
    adds, instead = "the cube in the spring's torque", "its stiffness for small deflections"

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield a stiffening and a softening spring, for the largest deflection."""
        stiffness = linear["stiffness"]
        for first, last in ((_SOFTER, _STIFFER), (_STIFFER, _SOFTER)):
            yield {"stiffness": first * stiffness, "cubic_stiffness": (last - first) * stiffness / windup**2}

    def deflection(self, values: Mapping[str, float], torque: float) -> float:
        """Return the deflection under a constant torque: the smallest; of a softening spring none holds too much."""
        stiffness, cubic, found = values["stiffness"], values["cubic_stiffness"], 0.0
        for _ in range(_NEWTON):
            slope = stiffness + 3.0 * cubic * found**2
            found -= ((stiffness + cubic * found**2) * found - torque) / slope if slope > 0.0 else 0.0
        return found

    def torque(self, values: Mapping[str, float], deflection: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the torque of spring and damper, (samples,), at deflections and their rates, (samples,)."""
        rising = values["stiffness"] + values["cubic_stiffness"] * deflection**2
        return np.asarray(rising * deflection + values["damping"] * velocity)


@dataclass(frozen=True, slots=True)
class HystereticSpring(Spring):
    """A linear spring beside one that slips: the torque on the way up is another than on the way down.

    ``K12 e + h``, where h winds up from each reversal with the stiffness Kh to the limit Th, as friction inside a gear
    does: ``dh/de = Kh (1 - h sign(e') / Th)``, P. R. Dahl's form of the slider of W. D. Iwan (A distributed-element
    model for hysteresis, Journal of Applied Mechanics 33, 1966). The stiffness is ``K12 + Kh`` where nothing is wound
    up, and up to ``K12 + 2 Kh`` right behind a reversal.
    """

    name = "hysteretic"
    stepped = True
    label = "linear, with hysteresis"
    own = (
        Parameter("hysteresis_stiffness", "Kh", Quantity.STIFFNESS, lower=0.0),
        Parameter("hysteresis_torque", "Th", Quantity.FORCE, lower=_LEAST),
    )
    words = "{stiffness}, beside {hysteresis_stiffness} that slips at {hysteresis_torque}"
    adds, instead = "the slider beside the spring", "the stiffness where that slips"

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield sliders that slip at parts of the largest deflection."""
        slider = (1.0 - _SOFTER) * linear["stiffness"]
        for share in _SHARES:
            limit = share * slider * windup
            yield {
                "stiffness": _SOFTER * linear["stiffness"], "hysteresis_stiffness": slider, "hysteresis_torque": limit
            }  # fmt: skip


@dataclass(frozen=True, slots=True)
class ElasticLoad(Spring):
    """A linear spring, and a part of the load on a second one: three masses, with a second elastic mode.

    The load's inertia ZZ2 is all of it. A share r3 of that swings on K23 and F23, without friction; the load's friction
    is on the rest, right behind K12. Two masses in its place are as stiff as both springs,
    ``1/K12 + r3^2/K23``, as long as the motion is slow beside the second mode.
    """

    name = "elastic-load"
    stepped = True
    label = "linear, and the load elastic"
    own = (
        Parameter("swinging_share", "r3", Quantity.RATIO, lower=0.0, upper=_WHOLE),
        Parameter("swinging_stiffness", "K23", Quantity.STIFFNESS, lower=0.0),
        Parameter("swinging_damping", "F23", Quantity.VISCOUS, lower=0.0),
    )
    words = "{stiffness}, and a share of {swinging_share} of the load on {swinging_stiffness}"
    adds, instead = "the part of the load that swings on a spring of its own", "the whole load on the first spring"

    def starts(self, linear: Mapping[str, float], windup: float) -> Iterator[dict[str, float]]:
        """Yield parts of the load that swing at a few times the first mode."""
        for share, times in product(_PARTS, _TIMES):
            yield self.start(linear, share, times)

    def start(self, linear: Mapping[str, float], share: float, times: float) -> dict[str, float]:
        """Return a swinging part with a multiple of the first mode's frequency; both springs as stiff together."""
        stiffness, load = linear["stiffness"], linear["load_inertia"]
        first = stiffness * (1 / linear["motor_inertia"] + 1 / load)  # rad2/s2
        second = share * (1 - share) * load * times**2 * first
        left = 1 / stiffness - share**2 / second
        swings = {"swinging_share": share, "swinging_stiffness": second}
        swings["swinging_damping"] = linear["damping"] * second / stiffness
        return {"stiffness": 1 / left if left > 0.0 else _STIFFER * stiffness} | swings


_BESIDE = tuple(p.name for law in (CubicSpring, HystereticSpring, ElasticLoad) for p in law.own)

SPRINGS: Mapping[str, type[Spring]] = {
    law.name: law
    for law in (
        LinearSpring, TwoPieceSpring, ThreePieceSpring, Backlash, CubicSpring, HystereticSpring, ElasticLoad,
    )
}  # fmt: skip
"""Every law of a spring by its name in the joint file."""


def find_spring(name: str) -> Spring:
    """Return the law of a spring of that name.

    Raises:
        MethodError: it is not known.
    """
    if name not in SPRINGS:
        raise MethodError(f'Spring "{name}" is not known; use {", ".join(SPRINGS)}.')
    return SPRINGS[name]()
