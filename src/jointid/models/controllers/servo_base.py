"""Common base of the controllers: clocks, limits, feed-forward, torque filters, and their numbers by name.

What follows a law's output is, in this order: what is added from the reference, ``acceleration_feedforward d2r/dt2 +
viscous_feedforward dr/dt + coulomb_feedforward sign(dr/dt) + constant_feedforward``; what is injected before the limit;
the torque's filters, before its limit or after it. All differences are backward ones.

The numbers a controller is made of can be freed, differentiated by, and written to a file. That of a part has a name
with a point: ``velocity_filter.time_constant``, ``torque_filters.0.frequency``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.settings import check_settings, documented, setting
from jointid.models.controllers.block_diagram import BlockSignal, Diagram
from jointid.models.controllers.filters import Filter, as_filter
from jointid.models.controllers.sampled import CONSTANT, DIRECTION, INJECTED, REFERENCE, SampledLaw, referred

Interpolation = Literal["hold", "linear", "cubic"]

_NOT_FREE = ("period", "position_period", "position_offset", "ratio")  # a law at another rate is another law


class Controller(Protocol):
    """The interface of a controller in a closed loop."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the record's channels the law reads, beside the motor position."""

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form; `sample_time` is the log's, used when the law has no period of its own."""


@documented
@dataclass(frozen=True, slots=True)
class ServoController:
    """What every law has beside its gains; all its numbers but the ratio are on its own side of a transmission."""

    gain: float = setting(
        1.0,
        "torque per controller unit: what takes the output to N, N m, A or V",
        above=0,
        negative="turn the torque round, with sign = -1 on its channel",
    )
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
        "how a reference that is slower than the controller is filled in, cubic through two commands with the slopes "
        "of their neighbours; without it a held channel is held, and lines are drawn through any other",
    )
    reference_delay: float = setting(
        0.0,
        "by which the whole law sees the reference later; a drive that moves to a command within one command period "
        "is that much late",
        unit="s",
        at_least=0,
    )
    ratio: float = setting(
        1.0,
        "of a transmission between the joint and the law: the law sees so many times the joint's positions, and its "
        "torque is so many times as large on the joint; negative where they count in opposite directions",
        nonzero=True,
    )

    def __post_init__(self) -> None:
        check_settings(self)


@documented
@dataclass(frozen=True, slots=True, kw_only=True)
class DiagramController(ServoController):
    """Common base of laws made of a `Diagram`: velocity from position, feed-forward, and torque filters."""

    velocity_filter: Filter | Sequence[float] = setting(
        (1.0,),
        "filter of the velocity, the backward difference of the position; a list is a numerator, [0.5, 0.5] the mean "
        "of two samples",
    )
    torque_filters: tuple[Filter, ...] = setting(
        (), "filters of the torque, one after the other, evaluated every period"
    )
    filters_at: Literal["before_limit", "after_limit"] = setting(
        "before_limit", "on which side of the torque's limit its filters stand"
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
    torque_feedforward_delay: float = setting(
        0.0, "by which these four feed-forwards see the reference later", unit="s", at_least=0
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "torque_filters", tuple(self.torque_filters))
        check_settings(self)

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


def numbers_of(controller: Controller) -> dict[str, float]:
    """Return a controller's numbers that can be parameters: gains, limits, delays, and those of its filters."""
    return dict(_numbers(controller, ""))


def _numbers(owner: object, before: str) -> Iterator[tuple[str, float]]:
    if not is_dataclass(owner):
        return
    for field in fields(owner):
        value, name = getattr(owner, field.name), before + field.name
        if field.name in _NOT_FREE or isinstance(value, bool):
            continue
        if isinstance(value, float) or (isinstance(value, int) and "float" in str(field.type)):
            yield name, float(value)
        elif isinstance(value, tuple):
            for place, part in enumerate(value):
                yield from _numbers(part, f"{name}.{place}.")
        else:
            yield from _numbers(value, f"{name}.")


def number(controller: Controller, name: str) -> float:
    """Return one of a controller's numbers.

    Raises:
        MethodError: it has no number of that name; the sentence lists those it has.
    """
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
