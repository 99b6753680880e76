"""Controllers by name: what engineers set, drawn as a `Diagram` and lowered to one `SampledLaw`.

Evaluated every period T on the sampled position q and reference r; the output is held, and acts after a computing
delay that may be a fraction of a period. With v the filtered backward difference of q, and e = r - q::

    Cascade   w = kp e + velocity_feedforward dr/dt, every position_period, within velocity_limit
              u = kv (w - v + ki I),  I the sum of T (w - v)
    PID       u = kp e + ki I + kd (dr/dt - v),  I the sum of T e
    PD        the same without I

All sums are those of earlier periods, all differences backward ones. What is around all of them is in `diagram`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from jointid.common.errors import MethodError
from jointid.models.controllers.block_diagram import BlockSignal, Diagram
from jointid.models.controllers.sampled import POSITION, REFERENCE_VELOCITY, SampledLaw
from jointid.models.controllers.servo_base import Controller, DiagramController

_WHOLE = 1e-6  # how near to a whole number of periods a slower loop's must be
_DRIFT = 1e-2  # of a period: how far clocks may drift apart before an instant is taken for the next one
_SLOWEST = 64  # periods in a cycle at most


@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade(DiagramController):
    """A position loop around a velocity loop: P-P, or P-PI where `ki` is not 0 (the module's equations).

    Attributes:
        kp: position gain in 1/s.
        kv: velocity gain in controller units per m/s (rad/s).
        ki: integral gain of the velocity loop in 1/s, the inverse of its integral time; 0 for a proportional one.
        anti_windup: what becomes of the integral while the torque is at its limit: "hold" stops it where it would push
            further, "track" takes from it what the limit cut off, "none" lets it run.
        velocity_feedforward: share of the reference's velocity that is added to the velocity command.
        velocity_feedforward_delay: seconds by which it sees the reference later.
        reference_velocity: of the feed-forward: "difference" of the reference, or a "channel" of its own.
        velocity_limit: of the velocity command, m/s (rad/s).
        position_period: of the position loop, a multiple of `period`; the same when None.
        position_offset: seconds from the first sample of the record's file to the position loop's next evaluation,
            which is at the controller's instant there, or at the next one.
        velocity_filter, torque_filters, filters_at, ..., gain, limit, period, delay, ...: see `DiagramController` and
            `ServoController`.
    """

    kp: float
    kv: float
    ki: float = 0.0
    anti_windup: Literal["hold", "track", "none"] = "hold"
    velocity_feedforward: float = 0.0
    velocity_feedforward_delay: float = 0.0
    reference_velocity: Literal["difference", "channel"] = "difference"
    velocity_limit: float = math.inf
    position_period: float | None = None
    position_offset: float = 0.0

    def __post_init__(self) -> None:
        shares = {
            "velocity_feedforward": self.velocity_feedforward,
            "velocity_feedforward_delay": self.velocity_feedforward_delay,
            "position_offset": self.position_offset,
        }
        self._check(kp=self.kp, kv=self.kv, ki=self.ki, **shares)
        if not self.velocity_limit > 0:
            raise MethodError(f"A velocity limit is positive; received {self.velocity_limit}.")
        _one_of("anti_windup", self.anti_windup, ("hold", "track", "none"))
        _one_of("reference_velocity", self.reference_velocity, ("difference", "channel"))

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when that is a channel."""
        return ("reference", "reference_velocity") if self.reference_velocity == "channel" else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        diagram = self._diagram(self.period or sample_time)
        position = diagram.input(POSITION)
        command = diagram.held((self._reference(diagram) - position) * self.kp + self._fed(diagram))
        if self.velocity_limit < math.inf:
            command, _ = diagram.limited(command, self.velocity_limit)
        slip = command - self._velocity(diagram, position)
        controlled = slip * self.kv
        if self.ki:
            state, integral = diagram.state()
            controlled = controlled + integral * (self.kv * self.ki)
        output, limit = self._torque(diagram, controlled)
        if self.ki:
            into = slip * diagram.period
            if self.limit < math.inf:
                into = _with_anti_windup(diagram, into, limit, self.anti_windup, self.kv * self.ki * self.gain)
            diagram.follow(state, integral + into)
        return self._lower(diagram, output, limit)

    def _diagram(self, period: float) -> Diagram:
        phases = (self.position_period or period) / period
        whole = abs(phases - round(phases)) <= _WHOLE * phases
        if not (whole and 1 <= round(phases) <= _SLOWEST):
            raise MethodError(
                f"The position loop's period is a multiple of the controller's, up to {_SLOWEST} times; received "
                f"{self.position_period or period:g} s beside {period:g} s: correct one of them."
            )
        first = math.ceil(self.position_offset / period - _DRIFT)
        return Diagram(period, round(phases), first % round(phases))

    def _fed(self, diagram: Diagram) -> BlockSignal:
        if not self.velocity_feedforward:
            return BlockSignal({})
        if self.reference_velocity == "channel":
            late = self.reference_delay + self.velocity_feedforward_delay
            return diagram.delayed(diagram.input(REFERENCE_VELOCITY), late) * self.velocity_feedforward
        reference = diagram.delayed(self._reference(diagram), self.velocity_feedforward_delay)
        return diagram.difference(reference, slow=True) * self.velocity_feedforward


@dataclass(frozen=True, slots=True, kw_only=True)
class PD(DiagramController):
    """``u = kp (reference - position) + kd (reference velocity - velocity)`` (the module's equations).

    The reference's velocity is the same filtered difference, of the reference, or the record's own channel, or none
    (damping on the position only).

    Attributes:
        kp: controller units per m (rad).
        kd: controller units per m/s (rad/s).
        reference_velocity: "difference", "channel" or "none".
        velocity_filter, torque_filters, filters_at, ..., gain, limit, period, delay, ...: see `DiagramController` and
            `ServoController`.
    """

    kp: float
    kd: float
    reference_velocity: Literal["difference", "channel", "none"] = "difference"

    def __post_init__(self) -> None:
        self._check(kp=self.kp, kd=self.kd)
        _one_of("reference_velocity", self.reference_velocity, ("difference", "channel", "none"))

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when that is a channel."""
        return ("reference", "reference_velocity") if self.reference_velocity == "channel" else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        diagram = Diagram(self.period or sample_time)
        _, controlled = self._controlled(diagram)
        output, limit = self._torque(diagram, controlled)
        return self._lower(diagram, output, limit)

    def _controlled(self, diagram: Diagram) -> tuple[BlockSignal, BlockSignal]:
        """Return the position error and the output, without an integral."""
        reference, position = self._reference(diagram), diagram.input(POSITION)
        error = reference - position
        if self.reference_velocity == "difference":
            return error, error * self.kp + self._velocity(diagram, error) * self.kd
        controlled = error * self.kp - self._velocity(diagram, position) * self.kd
        if self.reference_velocity == "channel":
            velocity = diagram.delayed(diagram.input(REFERENCE_VELOCITY), self.reference_delay)
            controlled = controlled + velocity * self.kd
        return error, controlled


@dataclass(frozen=True, slots=True, kw_only=True)
class PID(PD):
    """``u = kp e + ki (sum of T e) + kd (reference velocity - velocity)`` (the module's equations).

    Attributes:
        ki: controller units per m s (rad s).
        anti_windup: see `Cascade`.
        kp, kd, reference_velocity: see `PD`.
        velocity_filter, torque_filters, filters_at, ..., gain, limit, period, delay, ...: see `DiagramController` and
            `ServoController`.
    """

    ki: float
    anti_windup: Literal["hold", "track", "none"] = "hold"

    def __post_init__(self) -> None:
        PD.__post_init__(self)
        self._check(ki=self.ki)
        _one_of("anti_windup", self.anti_windup, ("hold", "track", "none"))

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        diagram = Diagram(self.period or sample_time)
        error, controlled = self._controlled(diagram)
        state, integral = diagram.state()
        output, limit = self._torque(diagram, controlled + integral * self.ki)
        into = error * diagram.period
        if self.limit < math.inf and self.ki:
            into = _with_anti_windup(diagram, into, limit, self.anti_windup, self.ki * self.gain)
        diagram.follow(state, integral + into)
        return self._lower(diagram, output, limit)


def shift_start(controller: Controller, seconds: float) -> Controller:
    """Return a controller as it is for a log that begins so many seconds later: a slower loop in it keeps its instants.

    Only a `Cascade` with a position loop of its own has any. Negative: for a log that begins earlier.
    """
    if not (seconds and isinstance(controller, Cascade) and controller.position_period):
        return controller
    cycle = controller.position_period
    offset = (controller.position_offset - seconds) % cycle
    rounding = min(offset, cycle - offset) < _WHOLE * cycle  # of what is a whole cycle
    return replace(controller, position_offset=0.0 if rounding else float(f"{offset:.12g}"))


def _with_anti_windup(diagram: Diagram, into: BlockSignal, limit: int, anti_windup: str, weight: float) -> BlockSignal:
    """Return an integral's increment in a period, with its anti-windup; `weight` takes the integral to torque."""
    if anti_windup == "hold":
        return diagram.gated(into, limit)
    # An integral of no weight has no share in what was cut off.
    return into + diagram.excess(limit) * (1.0 / weight) if anti_windup == "track" and weight else into


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        expected = ", ".join(f'"{one}"' for one in known)
        raise MethodError(f'A controller\'s {name} is one of {expected}; got "{value}".')
