"""[controller]: its filters, and a table for each law; the key `law` decides which it is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import MISSING, fields, replace
from typing import Annotated, Any, Literal, TypeAlias, Union

from pydantic import Field, create_model

from jointid.common import messages
from jointid.common.messages import Says
from jointid.common.transmission import Side, Transmission
from jointid.config.keys import Matrix, Number, Numbers, Typed, keys_from, keys_of_kinds
from jointid.config.table import Table, refusal
from jointid.models.controllers import (
    FILTERS,
    LAWS,
    Controller,
    DigitalFilter,
    Filter,
    StateSpaceController,
    as_filter,
)

_NO_KEYS = ("ratio",)  # which the transmission and `side` say


@keys_of_kinds(FILTERS)
class FilterTable(Table):
    """[controller.velocity_filter], and each of torque_filters: a filter; a bare list is a numerator."""

    shorthand = "numerator"

    kind: Literal[*FILTERS] | None = Field(  # type: ignore[valid-type]
        None, description="which filter; digital if it has nothing but a numerator and a denominator"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield what is missing, what is of another kind, and that there is no such filter."""
        kind = self.kind or "digital"
        known = fields(FILTERS[kind])
        given, names = self.given("kind"), [field.name for field in known]
        foreign = [key for key in given if key not in names]
        if foreign and self.kind is None:
            yield "kind", messages.missing(messages.either(FILTERS), "which filter")
            return
        for key in foreign:
            yield key, messages.foreign(kind, names)
        lacking = [f.name for f in known if (f.default is MISSING or f.name == "numerator") and f.name not in given]
        for key in lacking:
            yield key, self.lacks(key)
        if not foreign and not lacking and (refused := refusal(self.filter)):
            yield "denominator" if kind == "digital" else "", refused

    def filter(self) -> Filter | tuple[float, ...]:
        """Return the filter, or the numerator where that is all there is."""
        made: Filter = FILTERS[self.kind or "digital"](**self.settings("kind"))
        return made.numerator if isinstance(made, DigitalFilter) and len(self.given()) == 1 else made


FilterTables = Annotated[list[FilterTable], Says("a list of filters, each a table or the list of a numerator")]


def filters(tables: list[FilterTable]) -> tuple[Filter, ...]:
    """Return the filters of a row."""
    return tuple(as_filter(table.filter()) for table in tables)


class LawTable(Table):
    """A law: which one it is, and the side of its numbers."""

    law: str = Field(description="the controller's law")
    side: Side = Field("motor", description="of the transmission, in whose positions and torque the law's numbers are")

    @abstractmethod
    def controller(self) -> Controller:
        """Return the controller, on its own side."""

    def refer(self, transmission: Transmission | None) -> Controller:
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
    """A law that is drawn: it may filter velocity and torque."""

    def settings(self, *without: str) -> dict[str, Any]:
        """Return what the law is made of."""
        found = super().settings("law", "side", "velocity_filter", "torque_filters", *without)
        if self.velocity_filter is not None:
            found["velocity_filter"] = self.velocity_filter.filter()
        return found | ({"torque_filters": filters(self.torque_filters)} if self.torque_filters else {})

    def controller(self) -> Controller:
        """Return the controller."""
        made: Controller = LAWS[self.law](**self.settings())
        return made


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


@keys_from(StateSpaceController, without=(*_NO_KEYS, "reference_delay"))
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


def _table_of(word: str, law: type[Any]) -> type[LawTable]:
    """Return the table of a law that is drawn."""
    make: Any = create_model
    made: type[LawTable] = make(
        f"{law.__name__}Table",
        __base__=DrawnTable,
        __module__=__name__,
        __doc__=f'[controller] with law = "{word}".',
        law=(Literal[word], Field(description="the controller's law")),
    )
    types: dict[str, Typed] = {"velocity_filter": (FilterTable, None), "torque_filters": (FilterTables, [])}
    return keys_from(law, without=_NO_KEYS, types=types)(made)


LAW_TABLES: tuple[type[LawTable], ...] = tuple(
    StateSpaceTable if law is StateSpaceController else _table_of(word, law) for word, law in LAWS.items()
)
"""The tables of the laws there are."""

ControllerTable: TypeAlias = Annotated[Union[LAW_TABLES], Field(discriminator="law")]  # type: ignore[valid-type] # noqa: UP007
