"""Named controllers, drawn as a `Diagram` and lowered to one `SampledLaw`.

Evaluated every period T on the sampled position q and reference r; the output is held, and acts after a computing
delay, possibly fractional. With v the filtered backward difference of q, e = r - q, and kp, kv, ki, kd the position,
velocity, integral and derivative gain::

    Cascade   w = kp e + velocity_feedforward dr/dt, every position_period, within velocity_limit
              u = kv (w - v + ki I),  I the sum of T (w - v)
    PID       u = kp e + ki I + kd (dr/dt - v),  I the sum of T e
    PD        the same without I

Sums cover earlier periods; differences are backward. `servo_base` has the common parts. A `StateSpaceController`
represents other laws.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.models.controllers.sampled import (
    INJECTED,
    INPUTS,
    LIMIT,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    SampledLaw,
    refer,
)
from jointid.models.controllers.servo_base import BlockSignal, Controller, Diagram, DiagramController, ServoController

_WHOLE = 1e-6  # how near to a whole number of periods a slower loop's must be
_DRIFT = 1e-2  # of a period: how far clocks may drift apart before an instant is taken for the next one
_SLOWEST = 64  # periods in a cycle at most
_COLUMNS = {"reference": REFERENCE, "reference_velocity": REFERENCE_VELOCITY, "position": POSITION}

AntiWindup: TypeAlias = Literal["hold", "track", "none"]

_ANTI_WINDUP = (
    "what becomes of the integral at the limit: it stops where it would push further; loses what was cut off; runs on"
)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade(DiagramController):
    """A position loop around a velocity loop: P-P, or P-PI with `integral_gain`."""

    gains: ClassVar = ("position_gain", "velocity_gain", "integral_gain")  # in this order, in every law
    nested: ClassVar = True  # the position gain acts on what goes into the velocity loop, not on the output
    position_gain: float = field(metadata=declare("position gain, Kv of a drive", unit="1/s", at_least=0))
    velocity_gain: float = field(
        metadata=declare("velocity gain, Kp of a drive", unit="controller units per m/s or rad/s", at_least=0)
    )
    integral_gain: float = field(
        default=0.0,
        metadata=declare(
            "integral gain of the velocity loop, the inverse of its integral time", unit="1/s", at_least=0
        ),
    )
    anti_windup: AntiWindup = setting("hold", _ANTI_WINDUP)
    velocity_feedforward: float = setting(
        0.0, "share of the reference's velocity that is added to the velocity command", at_least=0
    )
    reference_velocity: Literal["difference", "channel"] = setting(
        "difference", "whether that velocity is the reference's difference, or a channel of its own"
    )
    velocity_limit: float = setting(
        math.inf, "limit of the velocity command, both ways", unit="m/s or rad/s", above=0, infinite=True
    )
    position_period: float | None = setting(
        None,
        "period of the position loop, a multiple of the controller's up to 64 times; without it the same",
        unit="s",
        above=0,
    )
    position_offset: float = setting(
        0.0,
        "time from the first sample of the record's file, also if that is cut, to the position loop's next "
        "evaluation; it is rounded up to a period of the controller",
        unit="s",
        at_least=0,
    )

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        period = self.period or sample_time
        phases = (self.position_period or period) / period
        whole = abs(phases - round(phases)) <= _WHOLE * phases
        if not (whole and 1 <= round(phases) <= _SLOWEST):
            raise MethodError(
                f"The position loop's period is a multiple of the controller's, up to {_SLOWEST} times; received "
                f"{self.position_period or period:g} s beside {period:g} s: correct one of them."
            )
        first = math.ceil(self.position_offset / period - _DRIFT)
        diagram = Diagram(period, round(phases), first % round(phases))
        position = diagram.input(POSITION)
        command = diagram.hold((self._reference(diagram) - position) * self.position_gain + self._feed_forward(diagram))
        if self.velocity_limit < math.inf:
            command, _ = diagram.limit(command, self.velocity_limit)
        slip = command - self._velocity(diagram, position)
        integral = (slip, self.velocity_gain * self.integral_gain, self.anti_windup) if self.integral_gain else None
        return self._lower(diagram, slip * self.velocity_gain, integral)

    def _feed_forward(self, diagram: Diagram) -> BlockSignal:
        if not self.velocity_feedforward:
            return BlockSignal({})
        if self.reference_velocity == "channel":
            late = diagram.delay(diagram.input(REFERENCE_VELOCITY), self.reference_delay)
            return late * self.velocity_feedforward
        return diagram.difference(self._reference(diagram), slow=True) * self.velocity_feedforward


@add_settings_to_docstring
@dataclass(frozen=True, slots=True, kw_only=True)
class PD(DiagramController):
    """``u = kp (reference - position) + kd (reference velocity - velocity)`` (the module's equations).

    The reference velocity is the filtered difference of the reference, the record's own channel, or none (damping on
    the position only).
    """

    gains: ClassVar[tuple[str, ...]] = ("position_gain", "derivative_gain")
    nested: ClassVar = False
    position_gain: float = field(metadata=declare("position gain", unit="controller units per m or rad", at_least=0))
    derivative_gain: float = field(
        metadata=declare("velocity gain", unit="controller units per m/s or rad/s", at_least=0)
    )
    reference_velocity: Literal["difference", "channel", "none"] = setting(
        "difference", "whether the reference's velocity is its difference, a channel of its own, or not used"
    )

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        diagram = Diagram(self.period or sample_time)
        return self._lower(diagram, self._draw_feedback(diagram)[1])

    def _draw_feedback(self, diagram: Diagram) -> tuple[BlockSignal, BlockSignal]:
        """Position error and output without an integral."""
        reference, position = self._reference(diagram), diagram.input(POSITION)
        error = reference - position
        if self.reference_velocity == "difference":
            return error, error * self.position_gain + self._velocity(diagram, error) * self.derivative_gain
        controlled = error * self.position_gain - self._velocity(diagram, position) * self.derivative_gain
        if self.reference_velocity == "channel":
            velocity = diagram.delay(diagram.input(REFERENCE_VELOCITY), self.reference_delay)
            controlled = controlled + velocity * self.derivative_gain
        return error, controlled


@add_settings_to_docstring
@dataclass(frozen=True, slots=True, kw_only=True)
class PID(PD):
    """``u = kp e + ki (sum of T e) + kd (reference velocity - velocity)`` (the module's equations)."""

    gains: ClassVar = ("position_gain", "derivative_gain", "integral_gain")
    integral_gain: float = field(
        metadata=declare("integral gain", unit="controller units per m s or rad s", at_least=0)
    )
    anti_windup: AntiWindup = setting("hold", _ANTI_WINDUP)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        diagram = Diagram(self.period or sample_time)
        error, controlled = self._draw_feedback(diagram)
        integral = (error, self.integral_gain, self.anti_windup) if self.integral_gain else None
        return self._lower(diagram, controlled, integral)


def shift_start(controller: Controller, seconds: float) -> Controller:
    """Adapt a controller to a log that begins `seconds` later (or earlier).

    Only the phase of a `Cascade`'s slower position loop changes.
    """
    if not (seconds and isinstance(controller, Cascade) and controller.position_period):
        return controller
    cycle = controller.position_period
    offset = (controller.position_offset - seconds) % cycle
    rounding = min(offset, cycle - offset) < _WHOLE * cycle  # of what is a whole cycle
    return replace(controller, position_offset=0.0 if rounding else float(f"{offset:.12g}"))


def with_present_sample(controller: Cascade | PID, period: float) -> Cascade | PID:
    """Return the controller with an integral that includes the present sample.

    Backward Euler's sum ``I + T e`` adds ``ki T`` to the proportional gain.

    Args:
        controller: with an integral.
        period: of the controller, s.
    """
    step = controller.integral_gain * period
    if isinstance(controller, PID):
        return replace(controller, position_gain=controller.position_gain + step)
    return replace(
        controller,
        velocity_gain=controller.velocity_gain * (1 + step),
        integral_gain=controller.integral_gain / (1 + step),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpaceController(ServoController):
    """Any discrete linear law with a limit, in controller units.

    It is::

        u = C z + D inputs,  z+ = A z + B (inputs, excess),  out = clip(u, -limit, limit),  excess = out - u

    Attributes:
        A: (nz, nz). C: (nz,).
        B: name of an input to its column (nz,); inputs are "reference", "reference_velocity", "position", "excess".
        D: name of an input to its direct gain; "position" feeds back negatively, so its gain is usually < 0.
        gain, limit, period, delay, interpolation, reference_average, ratio: see `ServoController`.
    """

    A: ArrayLike
    B: dict[str, ArrayLike]
    C: ArrayLike
    D: dict[str, float]

    def __post_init__(self) -> None:
        ServoController.__post_init__(self)
        order = np.size(self.C)
        shapes = {"A": np.shape(self.A), **{f"B.{name}": np.shape(column) for name, column in self.B.items()}}
        wrong = [
            f"{name} {shape}"
            for name, shape in shapes.items()
            if shape != ((order, order) if name == "A" else (order,)) and not (order == 0 and np.prod(shape) == 0)
        ]
        unknown = (set(self.B) - {*_COLUMNS, "excess"}) | (set(self.D) - set(_COLUMNS))
        if wrong or unknown:
            raise MethodError(
                f"A state-space law with {order} states (the length of C) needs A ({order}, {order}) and each column "
                f"of B ({order},), for the inputs {', '.join(_COLUMNS)}, excess; received "
                f"{', '.join([*wrong, *unknown])}."
            )
        if self.reference_delay:
            raise MethodError("A state-space law has the delay of its reference in its matrices; leave it out.")

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when the law uses it."""
        uses = "reference_velocity" in self.B or "reference_velocity" in self.D
        return ("reference", "reference_velocity") if uses else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        order = np.size(self.C)
        B, D = np.zeros((1, order, INPUTS)), np.zeros((1, 1, INPUTS))
        for name, at in _COLUMNS.items():
            B[0, :, at] = np.asarray(self.B.get(name, 0.0), dtype=np.float64)
            D[0, 0, at] = self.D.get(name, 0.0) * self.gain
        D[0, 0, INJECTED] = 1.0
        C = np.reshape(np.array(self.C, dtype=np.float64), (1, 1, order)) * self.gain
        # What the limit cut off is fed back in controller units.
        F = np.reshape(np.array(self.B.get("excess", np.zeros(order)), dtype=np.float64), (1, order, 1)) / self.gain
        law = SampledLaw(
            np.reshape(np.array(self.A, dtype=np.float64), (1, order, order)), B, C, D, np.zeros((1, 1, 1)), F,
            np.array([self.limit * self.gain]), np.array([LIMIT]), np.array([True]), 0,
            self.period or sample_time, self.delay,
        )  # fmt: skip
        return refer(law, self.ratio)


LAWS: Mapping[str, type[Any]] = {"cascade": Cascade, "pd": PD, "pid": PID}
"""The class of each law, by the word for it in a joint file."""
