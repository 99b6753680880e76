"""Common base of controllers: diagram, clocks, limits, feed-forward, filters, numbers.

A law is drawn of signals, filters, delays, limits and slower loops, and lowered to one `SampledLaw`. A `BlockSignal` is
a weighted sum of inputs, states and excesses, with weights for each phase of the cycle; a `Diagram` makes other blocks.

A law's output is followed by feed-forward, ``acceleration_feedforward d2r/dt2 + viscous_feedforward dr/dt +
coulomb_feedforward sign(dr/dt) + constant_feedforward``, injection before the limit, torque filters and the limit.
Differences are backward.

Numbers of a controller can be freed, differentiated by, and written to a file. Those of parts have dotted names:
``velocity_filter.time_constant``, ``torque_filters.0.frequency``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, check_settings, setting, settings_of
from jointid.common.text import pluralise
from jointid.models.controllers.filters import Filter, as_filter
from jointid.models.controllers.sampled import (
    CONSTANT,
    DIRECTION,
    INJECTED,
    INPUTS,
    LIMIT,
    REFERENCE,
    SampledLaw,
    refer,
)

Interpolation = Literal["hold", "linear", "cubic"]

_NOT_FREE = ("period", "position_period", "position_offset", "ratio", "reference_average")  # another law with another

CONTROLLER_UNITS = "controller units"
"""What a law gives out, where nothing says in which unit; its gain takes it to torque."""
_EITHER = re.compile(r"\bm(\S*| s) or rad\1(?!\S)")  # a unit on a straight or a turning axis

LONGEST_DELAY = 400
"""Periods by which a signal of the reference can be late: each is a state."""

Source: TypeAlias = tuple[str, int]
"""A state, an input or an excess: "z", "in" or "e", and which."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockSignal:
    """A weighted sum of sources, (phases,) weights each."""

    weights: dict[Source, FloatArray]

    def __add__(self, other: BlockSignal) -> BlockSignal:
        """Return the sum."""
        total = dict(self.weights)
        for source, weight in other.weights.items():
            total[source] = total[source] + weight if source in total else weight
        return BlockSignal(total)

    def __sub__(self, other: BlockSignal) -> BlockSignal:
        """Return the difference."""
        return self + other * -1.0

    def __mul__(self, factor: float | FloatArray) -> BlockSignal:
        """Return the signal times a number, or times one for each phase."""
        return BlockSignal({source: weight * factor for source, weight in self.weights.items()})


@dataclass(slots=True, eq=False)
class _Element:
    raw: BlockSignal
    limit: float
    gate: int
    of_torque: bool


@dataclass(slots=True, eq=False)
class Diagram:
    """A law under construction.

    Attributes:
        period: seconds between evaluations.
        phases: periods per period of the slower loop. first: index of the first period in its cycle.
    """

    period: float
    phases: int = 1
    first: int = 0
    _next: list[BlockSignal] = field(default_factory=list)
    _elements: list[_Element] = field(default_factory=list)

    def input(self, column: int) -> BlockSignal:
        """Return an input of the law."""
        return BlockSignal({("in", column): np.ones(self.phases)})

    def filter(
        self,
        signal: BlockSignal,
        numerator: Sequence[float],
        denominator: Sequence[float] = (1.0,),
        *,
        slow: bool = False,
    ) -> BlockSignal:
        """Filter by ``H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...)``, in observer form.

        A `slow` filter is evaluated, and its output valid, in the first phase of each cycle only.
        """
        order = max(len(numerator), len(denominator)) - 1
        b = np.pad(np.asarray(numerator, dtype=np.float64), (0, order + 1 - len(numerator))) / denominator[0]
        a = np.pad(np.asarray(denominator, dtype=np.float64), (0, order + 1 - len(denominator))) / denominator[0]
        memory = [self.state() for _ in range(order)]
        out: BlockSignal = signal * float(b[0])
        out = out + memory[0][1] if order else out
        for i, (at, state) in enumerate(memory):
            after = signal * float(b[i + 1]) - out * float(a[i + 1])
            if i + 1 < order:
                after = after + memory[i + 1][1]
            self._next[at] = self._in_first_phase(after, state) if slow else after
        return out

    def difference(self, signal: BlockSignal, *, slow: bool = False) -> BlockSignal:
        """Return the backward difference over a period, or a cycle, per second."""
        span = self.period * (self.phases if slow else 1)
        return self.filter(signal, [1.0, -1.0], slow=slow) * (1.0 / span)  # so the difference itself is exact

    def delay(self, signal: BlockSignal, seconds: float) -> BlockSignal:
        """Delay a signal by any time, with linear interpolation."""
        if seconds == 0.0:
            return signal
        if seconds > LONGEST_DELAY * self.period:  # each period of it is a state
            raise MethodError(
                f"A delay of the reference is one of {LONGEST_DELAY} periods at most; received {seconds:g} s beside a "
                f"period of {self.period:g} s: correct one of them."
            )
        whole, part = divmod(seconds / self.period, 1.0)
        return self.filter(signal, [0.0] * int(whole) + [1.0 - part, part])

    def state(self) -> tuple[int, BlockSignal]:
        """Add a state; return its index and signal. `follow` sets its update."""
        self._next.append(BlockSignal({}))
        number = len(self._next) - 1
        return number, BlockSignal({("z", number): np.ones(self.phases)})

    def follow(self, state: int, signal: BlockSignal) -> None:
        """Give a state its next value."""
        self._next[state] = signal

    def hold(self, signal: BlockSignal) -> BlockSignal:
        """Hold the value of the first phase over the cycle."""
        if self.phases == 1:
            return signal
        at, state = self.state()
        out = self._in_first_phase(signal, state)
        self._next[at] = out
        return out

    def _in_first_phase(self, signal: BlockSignal, otherwise: BlockSignal) -> BlockSignal:
        first: FloatArray = (np.arange(self.phases) == self.first).astype(np.float64)
        others: FloatArray = 1.0 - first
        return signal * first + otherwise * others

    def limit(
        self, signal: BlockSignal, limit: float = math.inf, *, of_torque: bool = False
    ) -> tuple[BlockSignal, int]:
        """Limit a signal; return it and its element's index."""
        return self._append(signal, limit, LIMIT, of_torque)

    def gate(self, signal: BlockSignal, watched: int) -> BlockSignal:
        """Zero a signal while it would push a limit further."""
        return self._append(signal, math.inf, watched, self._elements[watched].of_torque)[0]

    def excess(self, element: int) -> BlockSignal:
        """Return the excess over a limit, negative above the upper one."""
        return BlockSignal({("e", element): np.ones(self.phases)})

    def _append(self, signal: BlockSignal, limit: float, gate: int, of_torque: bool) -> tuple[BlockSignal, int]:
        self._elements.append(_Element(signal, limit, gate, of_torque))
        number = len(self._elements) - 1
        return signal + self.excess(number), number

    def law(self, *, output: int, delay: float) -> SampledLaw:
        """Build the law with the element that is its output."""
        raws, gates = [e.raw for e in self._elements], [e.gate for e in self._elements]
        A, B, F = self._matrices(self._next)
        C, D, E = self._matrices(raws)
        return SampledLaw(
            A, B, C, D, E, F,
            np.array([e.limit for e in self._elements], dtype=np.float64),
            np.array(gates, dtype=np.int64),
            np.array([e.of_torque for e in self._elements], dtype=np.bool_),
            output, self.period, delay,
        )  # fmt: skip

    def _matrices(self, signals: Sequence[BlockSignal]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights of states, inputs and excesses, (phases, signals, sources) each."""
        sizes = {"z": len(self._next), "in": INPUTS, "e": len(self._elements)}
        made = {kind: np.zeros((self.phases, len(signals), size)) for kind, size in sizes.items()}
        for row, signal in enumerate(signals):
            for (kind, at), weight in signal.weights.items():
                made[kind][:, row, at] = weight
        return made["z"], made["in"], made["e"]


class Controller(Protocol):
    """The interface of a controller in a closed loop."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the record's channels the law reads, beside the motor position."""

    def law(self, sample_time: float) -> SampledLaw:
        """State-space form; `sample_time` of the log is the default period."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class ServoController:
    """Common settings of laws, on the law's side except for the ratio.

    `output`, the unit of the output, is for reports; empty if unknown.
    """

    in_json = "-output"
    gain: float = setting(1.0, "torque per controller unit: what takes the output to N, N m, A or V", above=0)
    limit: float = setting(math.inf, "limit of the output, both ways", unit="controller units", above=0, infinite=True)
    period: float | None = setting(None, "period of the controller; without it that of the log", unit="s", above=0)
    delay: float = setting(
        0.0,
        "from the sampled position to the torque that follows from it; may be a fraction of a period",
        unit="s",
        at_least=0,
    )
    interpolation: Interpolation | None = setting(
        None,
        "how the drive interpolates a reference that is slower than the controller; cubic takes slopes from the "
        "neighbouring commands. By default a channel that is held or repeats its values is held, any other linear",
    )
    reference_average: float = setting(
        0.0,
        "time over which the drive averages the interpolated reference, as a jerk limit does; each value is the mean "
        "of the last ones",
        unit="s",
        at_least=0,
    )
    reference_delay: float = setting(
        0.0,
        "delay of the reference before the whole law; a drive that moves to a command within one command period has "
        "that period",
        unit="s",
        at_least=0,
    )
    ratio: float = setting(
        1.0,
        "ratio of a transmission between joint and law: it multiplies the positions on the way to the law, and the "
        "law's torque on the way to the joint; negative if they count in opposite directions",
        nonzero=True,
    )
    output: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        check_settings(self)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True, kw_only=True)
class DiagramController(ServoController):
    """Common base of diagram laws: velocity, feed-forward and torque filters."""

    velocity_filter: Filter | Sequence[float] = setting(
        (1.0,),
        "filter of the velocity, the backward difference of the position; a list is a numerator, [0.5, 0.5] the mean "
        "of two samples",
    )
    torque_filters: tuple[Filter, ...] = setting(
        (), "filters of the torque before its limit, one after the other, evaluated every period"
    )
    acceleration_feedforward: float = setting(
        0.0, "times the reference's acceleration", unit="controller units per m/s2 or rad/s2", at_least=0
    )
    viscous_feedforward: float = setting(
        0.0, "times the reference's velocity", unit="controller units per m/s or rad/s", at_least=0
    )
    coulomb_feedforward: float = setting(
        0.0, "times the direction in which the reference moves", unit="controller units", at_least=0
    )
    constant_feedforward: float = setting(0.0, "always added", unit="controller units")
    undeclared: Literal["possible", "none"] = setting(
        "possible",
        "whether the drive may have a filter, a delay or a loss beside what is declared, which intervals allow for",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "torque_filters", tuple(self.torque_filters))
        if isinstance(self.velocity_filter, Sequence):  # loops are hashed, and a list is not
            object.__setattr__(self, "velocity_filter", tuple(self.velocity_filter))
        check_settings(self)

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity if that is a channel."""
        channel = getattr(self, "reference_velocity", "") == "channel"
        return ("reference", "reference_velocity") if channel else ("reference",)

    def _velocity(self, diagram: Diagram, position: BlockSignal) -> BlockSignal:
        """Filtered backward difference, ``H(z) (1 - z^-1) / T``, in minimal states."""
        b, a = as_filter(self.velocity_filter).coefficients(diagram.period)
        return diagram.filter(position, tuple(np.convolve(b, [1.0, -1.0]) / diagram.period), a)

    def _reference(self, diagram: Diagram) -> BlockSignal:
        return diagram.delay(diagram.input(REFERENCE), self.reference_delay)

    def _lower(
        self, diagram: Diagram, controlled: BlockSignal, integral: tuple[BlockSignal, float, str] | None = None
    ) -> SampledLaw:
        """Add feed-forward, filters and limit, and build the joint-side law.

        Args:
            diagram: of the law.
            controlled: its output without the integral.
            integral: the summed signal, the gain of the sum, and its anti-windup at the limit.
        """
        summed, gain, anti_windup = integral or (BlockSignal({}), 0.0, "")
        state, total = diagram.state() if integral else (0, summed)
        torque = (controlled + total * gain + self._feedforward(diagram)) * self.gain + diagram.input(INJECTED)
        for one in self.torque_filters:
            torque = diagram.filter(torque, *one.coefficients(diagram.period))
        limit = diagram.limit(torque, self.limit * self.gain, of_torque=True)[1]
        into = summed * diagram.period
        if self.limit < math.inf and anti_windup == "hold":
            into = diagram.gate(into, limit)
        elif self.limit < math.inf and anti_windup == "track" and gain:  # one of no weight has no share in the excess
            into = into + diagram.excess(limit) * (1.0 / (gain * self.gain))
        if integral:
            diagram.follow(state, total + into)
        return refer(diagram.law(output=limit, delay=self.delay), self.ratio)

    def _feedforward(self, diagram: Diagram) -> BlockSignal:
        total = diagram.input(CONSTANT) * self.constant_feedforward if self.constant_feedforward else BlockSignal({})
        if self.acceleration_feedforward or self.viscous_feedforward:
            velocity = diagram.difference(self._reference(diagram))
            total = total + velocity * self.viscous_feedforward
            if self.acceleration_feedforward:
                total = total + diagram.difference(velocity) * self.acceleration_feedforward
        if self.coulomb_feedforward:
            total = total + diagram.delay(diagram.input(DIRECTION), self.reference_delay) * self.coulomb_feedforward
        return total


def numbers_of(controller: Controller) -> dict[str, float]:
    """Numbers of a controller and its filters that can be parameters."""
    return dict(_numbers(controller, ""))


def _numbers(owner: object, before: str) -> Iterator[tuple[str, float]]:
    if not is_dataclass(owner):
        return
    for one in fields(owner):
        value, name = getattr(owner, one.name), before + one.name
        if one.name in _NOT_FREE or isinstance(value, bool):
            continue
        if isinstance(value, float) or (isinstance(value, int) and "float" in str(one.type)):
            yield name, float(value)
        elif isinstance(value, tuple):
            for place, part in enumerate(value):
                yield from _numbers(part, f"{name}.{place}.")
        else:
            yield from _numbers(value, f"{name}.")


def unit_of_number(controller: Controller, name: str, position_unit: str, torque_unit: str) -> str:
    """Unit of a controller's number, empty without one.

    Args:
        controller: whose number.
        name: see `numbers_of`.
        position_unit: "m" or "rad".
        torque_unit: of the controller's output behind its gain; without a gain, of the output itself.
    """
    is_torque = getattr(controller, "gain", 1.0) == 1.0
    output = torque_unit if is_torque else getattr(controller, "output", "") or CONTROLLER_UNITS
    return _EITHER.sub(rf"{position_unit}\1", declared_unit(controller, name)).replace(CONTROLLER_UNITS, output)


def declared_unit(controller: Controller, name: str) -> str:
    """Declared units of a controller's number, for prismatic and revolute axes."""
    owner: Any = controller
    *path, last = name.split(".")
    for part in path:
        owner = owner[int(part)] if part.isdigit() else getattr(owner, part)
    kind: Any = type(owner)  # mypy does not take a type for something with a hash
    return next((one.unit for one in settings_of(kind) if one.name == last), "")


def number(controller: Controller, name: str) -> float:
    """Return one of a controller's numbers."""
    known = numbers_of(controller)
    if name not in known:
        raise MethodError(
            f'"{name}" is no parameter of the joint, no initial state and no number of this '
            f"{type(controller).__name__}, so it has no derivative; name one of {', '.join(known)}."
        )
    return known[name]


def with_numbers(controller: Controller, numbers: Mapping[str, float]) -> Controller:
    """Return a controller with other numbers, by the names of `numbers_of`."""
    changed: Any = controller
    for name, value in numbers.items():
        changed = _with(changed, name.split("."), value)
    return changed  # type: ignore[no-any-return]


def _with(owner: Any, path: list[str], value: float) -> Any:
    first, *rest = path
    if first.isdigit():
        parts = list(owner)
        parts[int(first)] = _with(parts[int(first)], rest, value)
        return tuple(parts)
    return replace(owner, **{first: _with(getattr(owner, first), rest, value) if rest else value})


def require_one_each(controllers: Sequence[object], joints: int) -> None:
    """Refuse controllers that are given and are not one for each joint.

    Raises:
        MethodError: there are more or fewer.
    """
    if controllers and len(controllers) != joints:
        raise MethodError(
            f"A model of {pluralise(joints, 'joint')} has as many controllers; received {len(controllers)}: give None "
            "for one that is not known."
        )
