"""Spring laws between motor and load: a line, or lines in pieces, and further terms.

To add a term, write its row in `_TERMS`: its parameters between stiffness and damping, their start values and texts.
`Spring.pieces` has the pieces of the line, and the plant of a simulation the other terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity

_SHARES = (0.1, 0.3)  # of the largest wind-up, from which a search for another piece begins
_GAPS = (0.1, 0.3, 0.6, 0.8)  # of it, for half the gap
_NEWTON = 50  # steps to the deflection of a smooth spring, in each piece
_LEAST = 1e-12  # torque at which a slider slips
_PARTS, _TIMES = (0.2, 0.5), (1.7, 3.0)  # of the load that swings at so many times the first mode, at a start
_WHOLE = 0.99  # of a load: the part behind the first spring has some inertia
_SOFTER, _STIFFER = 0.7, 1.3  # first and last piece at the start of a search, over the linear spring's stiffness
_BENT = ((_SOFTER, _STIFFER), (_STIFFER, _SOFTER))  # a stiffening spring, and a softening one

Values: TypeAlias = Mapping[str, float]
Starts: TypeAlias = Callable[[Values, float], Iterator[dict[str, float]]]


class Piece(NamedTuple):
    """One piece of a spring: initial deflection and torque, stiffness and damping."""

    deflection: float
    torque: float
    stiffness: float
    damping: float


def _start_pieces(count: int, linear: Values, windup: float) -> Iterator[dict[str, float]]:
    """Yield start values: stiffening and softening springs with equal torque ranges."""
    stiffness, names = linear["stiffness"], ["stiffness", *(p.name for p in _pieces(count))]
    torques = [stiffness * windup * i / count for i in range(1, count)]
    for shares in _BENT:
        yield dict(zip(names, [*(stiffness * np.linspace(*shares, count)), *torques], strict=True))


def _pieces(count: int) -> tuple[Parameter, ...]:
    """Parameters of the pieces: K2, K3, ..., then T1, T2, ..."""
    then = (Parameter(f"stiffness_{i}", f"K{i}", Quantity.STIFFNESS, lower=0.0) for i in range(2, count + 1))
    return (*then, *(Parameter(f"torque_{i}", f"T{i}", Quantity.FORCE, lower=0.0) for i in range(1, count)))


def _start_cubic(linear: Values, windup: float) -> Iterator[dict[str, float]]:
    """Yield a stiffening and a softening spring, for the largest deflection."""
    stiffness = linear["stiffness"]
    for first, last in _BENT:
        yield {"stiffness": first * stiffness, "cubic_stiffness": (last - first) * stiffness / windup**2}


def _start_slider(linear: Values, windup: float) -> Iterator[dict[str, float]]:
    """Yield sliders that slip at parts of the largest deflection."""
    stiffness, slider = linear["stiffness"], (1.0 - _SOFTER) * linear["stiffness"]
    for share in _SHARES:
        limit = share * slider * windup
        yield {"stiffness": _SOFTER * stiffness, "hysteresis_stiffness": slider, "hysteresis_torque": limit}


def swinging_part(linear: Values, share: float, times: float) -> dict[str, float]:
    """Swinging part at a multiple of the first mode; total stiffness kept, in each piece."""
    stiffness, load = linear["stiffness"], linear["load_inertia"]
    first = stiffness * (1 / linear["motor_inertia"] + 1 / load)  # rad2/s2
    second = share * (1 - share) * load * times**2 * first
    left = {name: 1 / linear[name] - share**2 / second for name in linear if name.startswith("stiffness")}
    swings = {"swinging_share": share, "swinging_stiffness": second}
    swings["swinging_damping"] = linear["damping"] * second / stiffness
    return {name: 1 / one if one > 0.0 else _STIFFER * linear[name] for name, one in left.items()} | swings


class _Term(NamedTuple):
    """A row of the table of springs.

    Attributes:
        own: parameters between stiffness and damping.
        words: what follows the stiffness in words, with parameters in braces.
        starts: see `Spring.starts`.
        adds: of a term beside the lines, that in words. instead: the lines in words, for exports of lines only.
    """

    own: tuple[Parameter, ...]
    words: str
    starts: Starts
    adds: str = ""
    instead: str = ""


_TERMS: Mapping[str, _Term] = {
    "two-piece": _Term(_pieces(2), " up to {torque_1}, {stiffness_2} above", partial(_start_pieces, 2)),
    "three-piece": _Term(
        _pieces(3), " up to {torque_1}, {stiffness_2} up to {torque_2}, {stiffness_3} above", partial(_start_pieces, 3)
    ),
    "backlash": _Term(
        (Parameter("gap", "gap", Quantity.POSITION, lower=0.0),), " behind a gap of {gap}",
        lambda linear, windup: (
            {"stiffness": linear["stiffness"] / (1 - share), "gap": 2 * share * windup} for share in _GAPS
        ),
    ),
    "cubic": _Term(
        (Parameter("cubic_stiffness", "K3", Quantity.CUBIC_STIFFNESS),),
        ", and {cubic_stiffness} times the cube of the deflection", _start_cubic,
        "the cube in the spring's torque", "its stiffness for small deflections",
    ),
    "hysteretic": _Term(
        (
            Parameter("hysteresis_stiffness", "Kh", Quantity.STIFFNESS, lower=0.0),
            Parameter("hysteresis_torque", "Th", Quantity.FORCE, lower=_LEAST),
        ),
        ", beside {hysteresis_stiffness} that slips at {hysteresis_torque}", _start_slider,
        "the slider beside the spring", "the stiffness where that slips",
    ),
    "elastic-load": _Term(
        (
            Parameter("swinging_share", "r3", Quantity.RATIO, lower=0.0, upper=_WHOLE),
            Parameter("swinging_stiffness", "K23", Quantity.STIFFNESS, lower=0.0),
            Parameter("swinging_damping", "F23", Quantity.VISCOUS, lower=0.0),
        ),
        ", and a share of {swinging_share} of the load on {swinging_stiffness}",
        lambda linear, windup: (swinging_part(linear, share, times) for share, times in product(_PARTS, _TIMES)),
        "the part of the load that swings on a spring of its own", "the whole load on the first spring",
    ),
}  # fmt: skip
_BESIDE = tuple(p.name for term in _TERMS.values() if term.adds for p in term.own)


@dataclass(frozen=True, slots=True)
class Spring:
    """Spring law by its joined names, such as "backlash-cubic-hysteretic"; immutable and hashable.

    Each has a ``stiffness``, of its first piece with one, and a parallel ``damping``. Terms add up; one may be pieces.

    - "linear": ``K12 e``, (2) of the paper.
    - "two-piece": K1 up to the torque T1, and K2 above. "three-piece": K1 up to T1, K2 up to T2, and K3 above, as of a
      strain-wave gear. The damper acts in all pieces.
    - "backlash": a linear spring behind a gap between the flanks. It carries no torque, and nothing damps, until half
      the gap is taken up: ``K12 (|e| - gap / 2) sign(e) + F12 e'`` where ``|e| > gap / 2``, else 0.
    - "cubic": ``K12 e + K3 e^3``, the spring of G. Duffing's oscillator. A softening one pulls less and less above the
      deflection of ``(K12 / 3 |K3|)^0.5``: valid below that.
    - "hysteretic": ``K12 e + h``, where h winds up from each reversal with the stiffness Kh to the limit Th, as
      friction inside a gear does: ``dh/de = Kh (1 - h sign(e') / Th)``, P. R. Dahl's form of the slider of W. D. Iwan
      (A distributed-element model for hysteresis, Journal of Applied Mechanics 33, 1966). The stiffness is ``K12 + Kh``
      where nothing is wound up, and up to ``K12 + 2 Kh`` right behind a reversal.
    - "elastic-load": a linear spring, and a share r3 of the load's inertia ZZ2 on a second one, K23 and F23, without
      friction: three masses, with a second elastic mode. The load's friction is on the rest, right behind K12. Two
      masses in its place are as stiff as both springs, ``1/K12 + r3^2/K23``, in motion slow beside the second mode.

    Raises:
        MethodError: there is no such law.
    """

    name: str = "linear"

    def __post_init__(self) -> None:
        whole = "-".join(word for word in _TERMS if word in str(self.name)) or "linear"
        if self.name != whole or sum(not term.adds for term in self._terms) > 1:
            raise MethodError(f'Spring "{self.name}" is not known; use {", ".join(SPRINGS)}, joined by "-" in order.')

    @property
    def _terms(self) -> list[_Term]:
        return [term for word, term in _TERMS.items() if word in self.name]

    @property
    def linear(self) -> bool:
        """True if the spring is one line."""
        return self.name == "linear"

    @property
    def in_pieces(self) -> Spring:
        """The spring without terms beside its lines."""
        return Spring(next((word for word, term in _TERMS.items() if word in self.name and not term.adds), "linear"))

    @property
    def adds(self) -> str:
        """Terms beside its lines, in words; "" of lines alone."""
        return ", and ".join(term.adds for term in self._terms if term.adds)

    @property
    def instead(self) -> str:
        """Lines of the law in words, for exports of lines only."""
        one = ", ".join(term.instead for term in self._terms if term.adds)
        return one if self.in_pieces.linear else "the spring of the lines"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness first, damping last."""
        first = Parameter("stiffness", "K1" if "piece" in self.name else "K12", Quantity.STIFFNESS, lower=0.0)
        own = (p for term in self._terms for p in term.own)
        return (first, *own, Parameter("damping", "F12", Quantity.VISCOUS, lower=0.0))

    def pieces(self, values: Values) -> tuple[Piece, ...]:
        """Pieces of one side by deflection; a piece without stiffness never ends."""
        whole = Piece(0.0, 0.0, values["stiffness"], values["damping"])
        if "backlash" in self.name:
            return Piece(0.0, 0.0, 0.0, 0.0), whole._replace(deflection=0.5 * values["gap"])
        found = [whole]
        for i in range(2, 4 if "three-piece" in self.name else 3 if "two-piece" in self.name else 2):
            (begin, torque, stiffness, damping), ends = found[-1], values[f"torque_{i - 1}"]
            end = begin + (ends - torque) / stiffness if stiffness else math.inf
            found.append(Piece(end, ends, values[f"stiffness_{i}"], damping))
        return tuple(found)

    def beside(self, values: Values) -> dict[str, float]:
        """Numbers of smooth terms by name; 0 for those of other laws."""
        own = {p.name for term in self._terms for p in term.own}
        return {name: values[name] if name in own else 0.0 for name in _BESIDE}

    def starts(self, linear: Values, windup: float) -> Iterator[dict[str, float]]:
        """Yield start values of a search, of all parameters except the damping.

        Args:
            linear: values of the joint with the linear spring that fits best.
            windup: the largest deflection of that spring.
        """
        found = [{"stiffness": linear["stiffness"]}]
        for term in self._terms:
            found = [one | start for one in found for start in term.starts({**linear, **one}, windup)]
        return iter(found)

    def describe(self, shown: Mapping[str, str]) -> str:
        """Spring in words; `shown` has the text of all parameters except damping."""
        units = {name: text.removesuffix(" 1") for name, text in shown.items()}  # a share's unit
        return "".join(["{stiffness}", *(term.words for term in self._terms)]).format(**units)

    def deflection(self, values: Values, torque: float) -> float:
        """Smallest deflection under a constant torque, if the spring can hold it."""
        if self.linear:
            return torque / values["stiffness"] if values["stiffness"] > 0.0 else 0.0
        size, cubic, found, pieces = abs(torque), self.beside(values)["cubic_stiffness"], 0.0, self.pieces(values)
        for piece in pieces:
            if size > 0.0 and size >= piece.torque:
                found = piece.deflection + ((size - piece.torque) / piece.stiffness if piece.stiffness > 0.0 else 0.0)
        ends = [*(piece.deflection for piece in pieces[1:]), math.inf]
        for (begin, held, stiffness, _), end in zip(pieces, ends, strict=True) if cubic and size else ():
            # Below a softening spring's maximum, or where a stiffening cube alone holds twice the torque.
            most = (2.0 * size / cubic) ** (1 / 3) if cubic > 0.0 else abs(stiffness / (3.0 * cubic)) ** 0.5
            found, high = begin, max(begin, min(end, most))
            for _ in range(_NEWTON):  # which nears the solution from one side, after the first step
                slope = stiffness + 3.0 * cubic * found**2
                left = held + stiffness * (found - begin) + cubic * found**2 * found - size
                found = min(max(found - left / slope, begin), high) if slope > 0.0 else high
            if found < high or end == math.inf:
                break
        return math.copysign(found, torque)

    def torque(self, values: Values, deflection: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torque of spring and damper, (samples,), at deflections and their rates."""
        pieces, size = self.pieces(values), np.abs(deflection)
        at = np.searchsorted([piece.deflection for piece in pieces[1:]], size, side="right")
        begin, torque, stiffness, damping = np.array(pieces).T[:, at]
        lines = np.sign(deflection) * (torque + stiffness * (size - begin)) + damping * velocity
        return np.asarray(lines + self.beside(values)["cubic_stiffness"] * deflection**3)


SPRINGS: Mapping[str, Spring] = {name: Spring(name) for name in ("linear", *_TERMS)}
"""The spring laws that comparisons try, by their names."""
