"""Laws as drives draw them: signals, filters, delays, limits and slower loops, put together to one `SampledLaw`.

A `BlockSignal` is a weighted sum of inputs, states and excesses, with a weight for each phase of the cycle. Sums and
multiples of signals are signals; a `Diagram` makes the other blocks, and counts states and elements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.controllers.sampled import INPUTS, LIMIT, SampledLaw

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
    """A law being drawn.

    Attributes:
        period: seconds between evaluations.
        phases: how many of them make one of the slower loop's. first: which of them is the first of its cycle.
    """

    period: float
    phases: int = 1
    first: int = 0
    _next: list[BlockSignal] = field(default_factory=list)
    _elements: list[_Element] = field(default_factory=list)

    def input(self, column: int) -> BlockSignal:
        """Return an input of the law."""
        return BlockSignal({("in", column): np.ones(self.phases)})

    def filtered(
        self,
        signal: BlockSignal,
        numerator: Sequence[float],
        denominator: Sequence[float] = (1.0,),
        *,
        slow: bool = False,
    ) -> BlockSignal:
        """Return the signal through ``H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...)``, in observer form.

        A `slow` filter is evaluated, and its output valid, in the first phase of each cycle alone.
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
        return self.filtered(signal, [1.0, -1.0], slow=slow) * (1.0 / span)  # so the difference itself is exact

    def delayed(self, signal: BlockSignal, seconds: float) -> BlockSignal:
        """Return the signal later by any time: between two of its values it is taken as a straight line.

        Raises:
            MethodError: the time is of more than 400 periods.
        """
        if seconds == 0.0:
            return signal
        if seconds > LONGEST_DELAY * self.period:  # each period of it is a state
            raise MethodError(
                f"A delay of the reference is one of {LONGEST_DELAY} periods at most; received {seconds:g} s beside a "
                f"period of {self.period:g} s: correct one of them."
            )
        whole, part = divmod(seconds / self.period, 1.0)
        return self.filtered(signal, [0.0] * int(whole) + [1.0 - part, part])

    def state(self) -> tuple[int, BlockSignal]:
        """Return the number of a new state, and what it is; `follow` says what it becomes."""
        self._next.append(BlockSignal({}))
        number = len(self._next) - 1
        return number, BlockSignal({("z", number): np.ones(self.phases)})

    def follow(self, state: int, signal: BlockSignal) -> None:
        """Give a state its next value."""
        self._next[state] = signal

    def held(self, signal: BlockSignal) -> BlockSignal:
        """Hold the signal's value from the first phase of the cycle: the output of a slower loop."""
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

    def limited(
        self, signal: BlockSignal, limit: float = math.inf, *, of_torque: bool = False
    ) -> tuple[BlockSignal, int]:
        """Return the signal within its limit, and the number of the element that is."""
        return self._element(signal, limit, LIMIT, of_torque)

    def gated(self, signal: BlockSignal, watched: int) -> BlockSignal:
        """Return the signal, and 0 where it would push what a limit cuts further beyond."""
        return self._element(signal, math.inf, watched, self._elements[watched].of_torque)[0]

    def excess(self, element: int) -> BlockSignal:
        """Return the excess over a limit, negative above the upper one."""
        return BlockSignal({("e", element): np.ones(self.phases)})

    def _element(self, signal: BlockSignal, limit: float, gate: int, of_torque: bool) -> tuple[BlockSignal, int]:
        self._elements.append(_Element(signal, limit, gate, of_torque))
        number = len(self._elements) - 1
        return signal + self.excess(number), number

    def law(self, *, output: int, tap: int, delay: float) -> SampledLaw:
        """Return the law whose output and tap are the elements of these numbers, in the order they were made."""
        raws, gates = [e.raw for e in self._elements], [e.gate for e in self._elements]
        A, B, F = self._matrices(self._next)
        C, D, E = self._matrices(raws)
        return SampledLaw(
            A, B, C, D, E, F,
            np.array([e.limit for e in self._elements], dtype=np.float64),
            np.array(gates, dtype=np.int64),
            np.array([e.of_torque for e in self._elements], dtype=np.bool_),
            output, tap, self.period, delay,
        )  # fmt: skip

    def _matrices(self, signals: Sequence[BlockSignal]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the weights of states, inputs and excesses in signals, (phases, signals, sources) each."""
        sizes = {"z": len(self._next), "in": INPUTS, "e": len(self._elements)}
        made = {kind: np.zeros((self.phases, len(signals), size)) for kind, size in sizes.items()}
        for row, signal in enumerate(signals):
            for (kind, at), weight in signal.weights.items():
                made[kind][:, row, at] = weight
        return made["z"], made["in"], made["e"]
