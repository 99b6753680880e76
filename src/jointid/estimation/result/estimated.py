"""One identified parameter, on the side it is identified on and on the other side of a transmission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from jointid.models.joints import Joint
from jointid.models.refer import OtherSide, other_side
from jointid.uncertainty.identifiability import Known
from jointid.uncertainty.verdict import StiffnessBound


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One line of the table.

    Attributes:
        name, symbol, unit: what it is.
        value: the estimate; None when it is refused.
        std: its standard deviation; None for a parameter that was kept fixed, or refused.
        free: whether it was identified.
        identifiable: whether the record determines it; a fixed parameter does not say.
        lower_bound: what the record supports when the value is refused.
        of_joint: False for what surrounds the joint (the initial state).
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    std: float | None
    free: bool
    identifiable: bool
    lower_bound: float | None = None
    of_joint: bool = True


class OnBothSides:
    """An answer whose parameters can be told on the other side of the joint's transmission, too."""

    __slots__ = ()

    if TYPE_CHECKING:  # every such answer is a frozen dataclass, and has these

        @property
        def joint(self) -> Joint:
            """The joint that was identified."""

        @property
        def torque_unit(self) -> str:
            """Of the record."""

        @property
        def parameters(self) -> tuple[EstimatedParameter, ...]:
            """What was identified, and what was kept fixed."""

    @property
    def other(self) -> OtherSide | None:
        """What takes these values to the other side of the transmission; None without one."""
        return other_side(self.joint.transmission, self.torque_unit)

    @property
    def other_side(self) -> tuple[EstimatedParameter, ...]:
        """The parameters on the other side of the transmission, in the same order; none without one."""
        return on_other_side(self.parameters, self.other)


def on_other_side(parameters: Sequence[EstimatedParameter], side: OtherSide | None) -> tuple[EstimatedParameter, ...]:
    """Return parameters as they are on the other side of a transmission, in the same order; none without one."""
    if side is None:
        return ()
    here = {p.name: p for p in parameters}
    return tuple(_moved(p, here.get(side.name(p.name), p), side) for p in parameters)


def _moved(p: EstimatedParameter, here: EstimatedParameter, side: OtherSide) -> EstimatedParameter:
    """Return a parameter with the values that another one, the same but for the direction, has on this side."""
    factor = side.factor(p.name, p.unit)

    def scaled(value: float | None) -> float | None:
        return None if value is None else factor * value + 0.0  # of 0 there is no negative

    return replace(
        here,
        name=p.name,
        symbol=p.symbol,
        unit=side.unit(p.unit),
        value=scaled(here.value),
        std=None if here.std is None else abs(factor) * here.std,
        lower_bound=scaled(here.lower_bound),
    )


def known_on_other_side(known: Sequence[Known], side: OtherSide | None) -> tuple[Known, ...]:
    """Return the sums and differences of one unit as they are on the other side, in the same order; none without."""
    if side is None:
        return ()
    here = {frozenset(k.combination.weights.items()): k for k in known}
    found = []
    for k in known:
        weights = k.combination.weights
        same = here.get(frozenset((side.name(name), weight) for name, weight in weights.items()), k)
        factor = side.factor(next(iter(weights)), k.combination.unit)
        there = replace(k.combination, unit=side.unit(k.combination.unit))
        found.append(Known(there, factor * same.value, abs(factor) * same.std, same.relative))
    return tuple(found)


def bounds_on_other_side(bounds: Sequence[StiffnessBound], side: OtherSide | None) -> tuple[StiffnessBound, ...]:
    """Return bounds of a stiffness as they are on the other side, in the same order; none without one."""
    if side is None:
        return ()
    factor = side.ratio**2
    return tuple(replace(b, stiffness=None if b.stiffness is None else factor * b.stiffness) for b in bounds)
