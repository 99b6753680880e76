"""Common base of the controllers: clocks, limits, feed-forward and torque filters.

That is, in this order: what is added from the reference, ``acceleration_feedforward d2r/dt2 + viscous_feedforward dr/dt
+ coulomb_feedforward sign(dr/dt) + constant_feedforward``; what is injected before the limit; the torque's filters,
before its limit or after it. All differences are backward ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from jointid.common.errors import MethodError
from jointid.models.controllers.block_diagram import BlockSignal, Diagram
from jointid.models.controllers.filters import Filter, as_filter
from jointid.models.controllers.sampled import CONSTANT, DIRECTION, INJECTED, REFERENCE, SampledLaw, referred

Interpolation = Literal["hold", "linear", "cubic"]


class Controller(Protocol):
    """The interface of a controller in a closed loop."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the record's channels the law reads, beside the motor position."""

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form; `sample_time` is the log's, used when the law has no period of its own."""


@dataclass(frozen=True, slots=True)
class ServoController:
    """Settings that every law has beside its gains.

    Attributes:
        gain: torque per controller unit.
        limit: of the output, in controller units.
        period: of the controller in seconds; the log's sample time when None.
        delay: seconds from the sampled position to the torque that follows from it.
        interpolation: how a reference that is commanded, and logged, slower than the period is filled in: "hold",
            "linear" or "cubic" (Catmull-Rom, a cubic through two commands with the slopes of their neighbours). None
            holds a channel that is declared held and draws lines through any other.
        reference_delay: seconds by which the law sees the reference later; a drive that moves to a command within one
            command period is that much late.
        ratio: of a transmission between the joint and the law: the law sees so many times the joint's positions, and
            what it puts out is so many times as large on the joint; negative where they count in opposite directions.
            All other numbers are the law's, on its own side.
    """

    gain: float = 1.0
    limit: float = math.inf
    period: float | None = None
    delay: float = 0.0
    interpolation: Interpolation | None = None
    reference_delay: float = 0.0
    ratio: float = 1.0

    def _check(self, **gains: float) -> None:
        gains |= {"delay": self.delay, "reference_delay": self.reference_delay}
        faults = [f"{name} = {value}" for name, value in gains.items() if not 0 <= value < math.inf]
        faults += [f"gain = {self.gain}"] * (not (math.isfinite(self.gain) and self.gain > 0))
        faults += [f"limit = {self.limit}"] * (not self.limit > 0)
        faults += [f"period = {self.period}"] * (self.period is not None and not 0 < self.period < math.inf)
        if faults:
            raise MethodError(
                f"A controller's gains and delays are zero or positive numbers, its gain, limits and periods positive; "
                f"received {', '.join(faults)}."
            )
        if not (math.isfinite(self.ratio) and self.ratio != 0):
            raise MethodError(f"The ratio between a joint and its controller is a number but 0; received {self.ratio}.")
        if self.interpolation not in (None, "hold", "linear", "cubic"):
            raise MethodError(
                f'A reference is filled in by "hold", "linear" or "cubic"; received "{self.interpolation}".'
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagramController(ServoController):
    """Common base of laws made of a `Diagram`: velocity from position, feed-forward, and torque filters.

    Attributes:
        velocity_filter: of the backward difference of the position: a `Filter`, or the numerator of one; ``(0.5, 0.5)``
            is the mean of two samples, the law of the EMPS benchmark.
        torque_filters: one after the other, evaluated every period.
        filters_at: "before_limit" or "after_limit".
        acceleration_feedforward: controller units per m/s2 (rad/s2).
        viscous_feedforward: controller units per m/s (rad/s).
        coulomb_feedforward, constant_feedforward: controller units.
        torque_feedforward_delay: seconds by which all four see the reference later.
    """

    velocity_filter: Filter | Sequence[float] = (1.0,)
    torque_filters: tuple[Filter, ...] = ()
    filters_at: Literal["before_limit", "after_limit"] = "before_limit"
    acceleration_feedforward: float = 0.0
    viscous_feedforward: float = 0.0
    coulomb_feedforward: float = 0.0
    constant_feedforward: float = 0.0
    torque_feedforward_delay: float = 0.0

    def _check(self, **gains: float) -> None:
        ServoController._check(
            self,
            **gains,
            acceleration_feedforward=self.acceleration_feedforward,
            viscous_feedforward=self.viscous_feedforward,
            coulomb_feedforward=self.coulomb_feedforward,
            torque_feedforward_delay=self.torque_feedforward_delay,
        )
        if not math.isfinite(self.constant_feedforward):
            raise MethodError(f"A constant feed-forward is a number; received {self.constant_feedforward}.")
        if self.filters_at not in ("before_limit", "after_limit"):
            raise MethodError(f'The filters stand "before_limit" or "after_limit"; received "{self.filters_at}".')
        object.__setattr__(self, "torque_filters", tuple(self.torque_filters))

    def _velocity(self, diagram: Diagram, position: BlockSignal) -> BlockSignal:
        """Return the filtered backward difference, ``H(z) (1 - z^-1) / T``, in as few states as it has."""
        b, a = as_filter(self.velocity_filter).coefficients(diagram.period)
        return diagram.filtered(position, tuple(np.convolve(b, [1.0, -1.0]) / diagram.period), a)

    def _reference(self, diagram: Diagram) -> BlockSignal:
        return diagram.delayed(diagram.input(REFERENCE), self.reference_delay)

    def _torque(self, diagram: Diagram, controlled: BlockSignal) -> tuple[int, int]:
        """Draw what follows a controller's output, in controller units; return which element acts, and the limit's."""
        torque = (controlled + self._feedforward(diagram)) * self.gain + diagram.input(INJECTED)
        late = self.filters_at == "after_limit"
        if not late:
            torque = self._filtered(diagram, torque)
        torque, limit = diagram.limited(torque, self.limit * self.gain, of_torque=True)
        if not (late and self.torque_filters):
            return limit, limit
        return diagram.limited(self._filtered(diagram, torque), of_torque=True)[1], limit

    def _lower(self, diagram: Diagram, output: int, limit: int) -> SampledLaw:
        """Return the law that was drawn, with the elements that `_torque` named, as its joint sees it."""
        return referred(diagram.law(output=output, tap=limit, delay=self.delay), self.ratio)

    def _filtered(self, diagram: Diagram, torque: BlockSignal) -> BlockSignal:
        for one in self.torque_filters:
            torque = diagram.filtered(torque, *one.coefficients(diagram.period))
        return torque

    def _feedforward(self, diagram: Diagram) -> BlockSignal:
        total = diagram.input(CONSTANT) * self.constant_feedforward if self.constant_feedforward else BlockSignal({})
        late = self.reference_delay + self.torque_feedforward_delay
        if self.acceleration_feedforward or self.viscous_feedforward:
            velocity = diagram.difference(diagram.delayed(diagram.input(REFERENCE), late))
            total = total + velocity * self.viscous_feedforward
            if self.acceleration_feedforward:
                total = total + diagram.difference(velocity) * self.acceleration_feedforward
        if self.coulomb_feedforward:
            total = total + diagram.delayed(diagram.input(DIRECTION), late) * self.coulomb_feedforward
        return total
