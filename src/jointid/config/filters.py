"""The tables of a controller's filters: of the velocity, and of the torque."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal

from pydantic import Field

from jointid.config import messages
from jointid.config.messages import Says
from jointid.config.table import Table, refusal
from jointid.config.values import Coefficients, Count, NotNegative, Number, Positive
from jointid.models.controllers import DigitalFilter, Filter, FirstOrder, MovingAverage, Notch, SecondOrder, as_filter

FILTERS: Mapping[str, type[Any]] = {
    "digital": DigitalFilter,
    "moving_average": MovingAverage,
    "first_order": FirstOrder,
    "second_order": SecondOrder,
    "notch": Notch,
}
"""What a filter's table becomes, by its kind."""


class FilterTable(Table):
    """[controller.velocity_filter], and each of torque_filters: a filter; a bare list is a numerator."""

    shorthand = "numerator"

    kind: Literal["digital", "moving_average", "first_order", "second_order", "notch"] | None = Field(
        None, description="which filter"
    )
    numerator: Coefficients | None = Field(None, description="of digital: b0, b1, ... in powers of 1/z")
    denominator: Coefficients | None = Field(None, description="of digital: a0, a1, ... in powers of 1/z")
    samples: Count | None = Field(None, description="of moving_average: so many, of which the mean is taken")
    time_constant: NotNegative | None = Field(None, description="of first_order: of its pole [s]")
    frequency: Positive | None = Field(None, description="of second_order its poles', of notch its centre [Hz]")
    damping: Positive | None = Field(None, description="of second_order: of its poles")
    numerator_frequency: Positive | None = Field(None, description="of second_order: its zeros' [Hz]")
    numerator_damping: Number | None = Field(None, description="of second_order: of its zeros")
    bandwidth: Positive | None = Field(None, description="of notch: its width [Hz]")
    depth: NotNegative | None = Field(None, description="of notch: what it leaves at its centre, as a share")

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
        given = {k: tuple(value) if isinstance(value, list) else value for k, value in self.given("kind").items()}
        made: Filter = FILTERS[self.kind or "digital"](**given)
        return made.numerator if isinstance(made, DigitalFilter) and len(self.given()) == 1 else made


FilterTables = Annotated[list[FilterTable], Says("a list of filters, each a table or the list of a numerator")]


def filters(tables: list[FilterTable]) -> tuple[Filter, ...]:
    """Return the filters of a row."""
    return tuple(as_filter(table.filter()) for table in tables)
