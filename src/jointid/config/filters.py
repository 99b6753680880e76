"""The tables of a controller's filters: of the velocity, and of the torque."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, fields
from typing import Annotated, Literal

from pydantic import Field

from jointid.common import messages
from jointid.common.messages import Says
from jointid.config.generate import keys_of_kinds
from jointid.config.table import Table, refusal
from jointid.models.controllers import FILTERS, DigitalFilter, Filter, as_filter


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
