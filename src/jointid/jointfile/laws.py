"""The tables of [controller], one for each law; the key `law` decides which it is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field

from jointid.jointfile.table import Table, refusal
from jointid.jointfile.values import (
    Coefficients,
    Limit,
    LoopGain,
    Matrix,
    NotNegative,
    Number,
    Numbers,
    OutputGain,
    Positive,
)
from jointid.model.controllers import PD, Cascade, Controller, DigitalFilter, StateSpaceController


class FilterTable(Table):
    """[controller.velocity_filter]: a digital filter; a bare list is its numerator."""

    shorthand = "numerator"

    numerator: Coefficients = Field(description="b0, b1, ...")
    denominator: Coefficients = Field([1.0], description="a0, a1, ...")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that there is no such filter."""
        if refused := refusal(lambda: DigitalFilter(tuple(self.numerator), tuple(self.denominator))):
            yield "denominator", refused

    def filter(self) -> DigitalFilter | tuple[float, ...]:
        """Return the filter, or the numerator alone where no denominator is given."""
        whole = DigitalFilter(tuple(self.numerator), tuple(self.denominator))
        return whole if "denominator" in self.model_fields_set else whole.numerator


class LawTable(Table):
    """What all laws have beside their gains."""

    law: str = Field(description="the controller's law")
    gain: OutputGain = Field(1.0, description="torque per controller unit")
    limit: Limit | None = Field(None, description="limit of the output [controller units]")
    period: Positive | None = Field(None, description="period of the controller [s]")
    delay: NotNegative = Field(0.0, description="from the sampled position to the torque [s]")

    @abstractmethod
    def controller(self) -> Controller:
        """Return the controller."""


class DifferenceTable(LawTable):
    """What those laws have that difference the position."""

    velocity_filter: FilterTable | None = Field(None, description="filter of the difference")

    def settings(self) -> dict[str, Any]:
        """Return what the law is made of."""
        filtered = {} if self.velocity_filter is None else {"velocity_filter": self.velocity_filter.filter()}
        return self.given("law", "velocity_filter") | filtered


class CascadeTable(DifferenceTable):
    """[controller] with law = "cascade": ``u = kv (kp (reference - position) - velocity)``."""

    law: Literal["cascade"] = Field(description="the controller's law")
    kp: LoopGain = Field(description="position gain [1/s]")
    kv: LoopGain = Field(description="velocity gain [controller units per m/s or rad/s]")

    def controller(self) -> Cascade:
        """Return the controller."""
        return Cascade(**self.settings())


class PDTable(DifferenceTable):
    """[controller] with law = "pd": ``u = kp (reference - position) + kd (reference velocity - velocity)``."""

    law: Literal["pd"] = Field(description="the controller's law")
    kp: LoopGain = Field(description="position gain [controller units per m or rad]")
    kd: LoopGain = Field(description="velocity gain [controller units per m/s or rad/s]")
    reference_velocity: Literal["difference", "channel", "none"] = Field(
        "difference", description="where the reference's velocity comes from"
    )

    def controller(self) -> PD:
        """Return the controller."""
        return PD(**self.settings())


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
    A: Matrix = Field(description="n rows of n numbers")
    B: InputColumns = Field(description="for each input, n numbers")
    C: Numbers = Field(description="n numbers")
    D: InputGains = Field(description="for each input, a number")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the shapes do not fit."""
        if len({len(row) for row in self.A}) > 1:
            lengths = ", ".join(str(len(row)) for row in self.A)
            yield "A", f" has rows of {lengths} numbers; expected rows of one length: complete them."
        elif refused := refusal(self.controller):
            yield "", refused

    def controller(self) -> StateSpaceController:
        """Return the controller."""
        return StateSpaceController(B=self.B.given(), D=self.D.given(), **self.given("law", "B", "D"))


LAWS: tuple[type[LawTable], ...] = (CascadeTable, PDTable, StateSpaceTable)
"""The tables of the laws there are."""

ControllerTable: TypeAlias = Annotated[CascadeTable | PDTable | StateSpaceTable, Field(discriminator="law")]
