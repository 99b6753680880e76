"""The tables of [controller], one for each law; the key `law` decides which it is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field

from jointid.config.filters import FilterTable, FilterTables, filters
from jointid.config.table import Table, refusal
from jointid.config.values import (
    Limit,
    LoopGain,
    Matrix,
    NotNegative,
    Number,
    Numbers,
    OutputGain,
    Positive,
)
from jointid.models.controllers import PD, PID, Cascade, Controller, StateSpaceController
from jointid.models.transmission import Side, Transmission

AntiWindup = Literal["hold", "track", "none"]
ReferenceVelocity = Literal["difference", "channel", "none"]


class LawTable(Table):
    """What all laws have beside their gains."""

    law: str = Field(description="the controller's law")
    gain: OutputGain = Field(1.0, description="torque per controller unit")
    limit: Limit | None = Field(None, description="limit of the output [controller units]")
    period: Positive | None = Field(None, description="period of the controller [s]")
    delay: NotNegative = Field(0.0, description="from the sampled position to the torque [s]")
    interpolation: Literal["hold", "linear", "cubic"] | None = Field(
        None, description="how a reference that is slower than the controller is filled in"
    )
    side: Side = Field("motor", description="of the transmission, whose positions and torque its numbers are in")

    @abstractmethod
    def controller(self) -> Controller:
        """Return the controller, on its own side."""

    def referred(self, transmission: Transmission | None) -> Controller:
        """Return the controller as a joint sees it through its transmission."""
        made = self.controller()
        if transmission is None:
            return made
        seen: Controller = replace(made, ratio=transmission.torque(self.side))  # type: ignore[type-var]
        return seen

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that there is no such law; what depends on the period is seen where the file has one."""
        period = self.period
        if refused := refusal(lambda: self.controller() if period is None else self.controller().law(period)):
            yield "", refused


class DrawnTable(LawTable):
    """What those laws have that difference the position."""

    reference_delay: NotNegative = Field(0.0, description="by which the law sees the reference later [s]")
    velocity_filter: FilterTable | None = Field(
        None, description="filter of the velocity, the difference of the position"
    )
    torque_filters: FilterTables = Field([], description="filters of the torque, one after the other")
    filters_at: Literal["before_limit", "after_limit"] = Field(
        "before_limit", description="on which side of the torque's limit its filters stand"
    )
    acceleration_feedforward: NotNegative = Field(
        0.0, description="times the reference's acceleration [controller units per m/s2 or rad/s2]"
    )
    viscous_feedforward: NotNegative = Field(
        0.0, description="times the reference's velocity [controller units per m/s or rad/s]"
    )
    coulomb_feedforward: NotNegative = Field(
        0.0, description="in the direction in which the reference moves [controller units]"
    )
    constant_feedforward: Number = Field(0.0, description="always added [controller units]")
    torque_feedforward_delay: NotNegative = Field(
        0.0, description="by which the feed-forwards of the torque see the reference later [s]"
    )

    def settings(self) -> dict[str, Any]:
        """Return what the law is made of."""
        found = self.given("law", "side", "velocity_filter", "torque_filters")
        if self.velocity_filter is not None:
            found["velocity_filter"] = self.velocity_filter.filter()
        return found | ({"torque_filters": filters(self.torque_filters)} if self.torque_filters else {})


class CascadeTable(DrawnTable):
    """[controller] with law = "cascade": ``u = kv (w - v + ki I)``, ``w = kp (reference - position)`` and more."""

    law: Literal["cascade"] = Field(description="the controller's law")
    kp: LoopGain = Field(description="position gain [1/s]")
    kv: LoopGain = Field(description="velocity gain [controller units per m/s or rad/s]")
    ki: LoopGain = Field(0.0, description="integral gain of the velocity loop [1/s]")
    anti_windup: AntiWindup = Field("hold", description="what becomes of the integral at the limit")
    velocity_feedforward: NotNegative = Field(0.0, description="share of the reference's velocity")
    velocity_feedforward_delay: NotNegative = Field(
        0.0, description="by which the velocity feed-forward sees the reference later [s]"
    )
    reference_velocity: Literal["difference", "channel"] = Field(
        "difference", description="where the reference's velocity comes from"
    )
    velocity_limit: Limit | None = Field(None, description="limit of the velocity command [m/s or rad/s]")
    position_period: Positive | None = Field(None, description="period of the position loop [s]")
    position_offset: NotNegative = Field(
        0.0, description="from the record's first sample to the position loop's next evaluation [s]"
    )

    def controller(self) -> Cascade:
        """Return the controller."""
        return Cascade(**self.settings())


class PDTable(DrawnTable):
    """[controller] with law = "pd": ``u = kp (reference - position) + kd (reference velocity - velocity)``."""

    law: Literal["pd"] = Field(description="the controller's law")
    kp: LoopGain = Field(description="position gain [controller units per m or rad]")
    kd: LoopGain = Field(description="velocity gain [controller units per m/s or rad/s]")
    reference_velocity: ReferenceVelocity = Field("difference", description="where the reference's velocity comes from")

    def controller(self) -> PD:
        """Return the controller."""
        return PD(**self.settings())


class PIDTable(DrawnTable):
    """[controller] with law = "pid": that of "pd" with an integral of the position error."""

    law: Literal["pid"] = Field(description="the controller's law")
    kp: LoopGain = Field(description="position gain [controller units per m or rad]")
    ki: LoopGain = Field(description="integral gain [controller units per m s or rad s]")
    kd: LoopGain = Field(description="velocity gain [controller units per m/s or rad/s]")
    anti_windup: AntiWindup = Field("hold", description="what becomes of the integral at the limit")
    reference_velocity: ReferenceVelocity = Field("difference", description="where the reference's velocity comes from")

    def controller(self) -> PID:
        """Return the controller."""
        return PID(**self.settings())


class InputColumns(Table):
    """[controller.B]: the column of each input; one that is left out is 0."""

    reference: Numbers | None = Field(None, description="of the reference")
    reference_velocity: Numbers | None = Field(None, description="of the reference's velocity")
    position: Numbers | None = Field(None, description="of the motor position")
    excess: Numbers | None = Field(None, description="of what the limit cut off")


class InputGains(Table):
    """[controller.D]: the direct gain of each input; one that is left out is 0."""

    reference: Number | None = Field(None, description="of the reference")
    reference_velocity: Number | None = Field(None, description="of the reference's velocity")
    position: Number | None = Field(None, description="of the motor position, usually negative")


class StateSpaceTable(LawTable):
    """[controller] with law = "state_space": any discrete linear law."""

    law: Literal["state_space"] = Field(description="the controller's law")
    A: Matrix = Field(description="how the states go on: n rows of n numbers")
    B: InputColumns = Field(description="how each input moves the states: n numbers")
    C: Numbers = Field(description="output row: n numbers")
    D: InputGains = Field(description="direct gain of each input: a number")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the shapes do not fit."""
        if len({len(row) for row in self.A}) > 1:
            lengths = ", ".join(str(len(row)) for row in self.A)
            yield "A", f" has rows of {lengths} numbers; expected rows of one length: complete them."
        else:
            yield from super().faults()

    def controller(self) -> StateSpaceController:
        """Return the controller."""
        return StateSpaceController(B=self.B.given(), D=self.D.given(), **self.given("law", "side", "B", "D"))


LAWS: tuple[type[LawTable], ...] = (CascadeTable, PDTable, PIDTable, StateSpaceTable)
"""The tables of the laws there are."""

ControllerTable: TypeAlias = Annotated[CascadeTable | PDTable | PIDTable | StateSpaceTable, Field(discriminator="law")]
