"""Tables of a campaign file: fleet and sweep."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from jointid.common.messages import Says, either
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.config.table import Table, Text, flatten_keys, keys_from

PLACEHOLDERS = {"joint": r"[^/]+", "day": r"\d{4}-?\d{2}-?\d{2}"}
"""Placeholders of a part of a path, with the pattern that each matches."""
PLACEHOLDER = re.compile(r"\{(\w*)\}|(\*)|(\?)")


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Fleet:
    """Joints and their records."""

    joint: str | None = setting(
        None, "path of the joint file, with {joint} in it where each joint has its own; from this file"
    )
    records: str | None = setting(
        None,
        "path of the records, with {joint} where the joint's name stands, {day} where a date does, and *; "
        "without it the record that the joint file names",
    )
    table: str | None = setting(
        None, "path of a table of joints, .csv or .parquet; joint and records then serve rows that do not say them"
    )


def unknown_placeholders(key: str, pattern: str, known: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield unknown placeholders of a pattern: key and rest of a sentence."""
    for found in PLACEHOLDER.finditer(pattern):
        if found[1] is not None and found[1] not in known:
            expected = either(f"{{{name}}}" for name in known)
            yield key, f" has {{{found[1]}}} in it; expected {expected}: correct it."


@keys_from(Fleet)
class FleetTable(Table):
    """[fleet]: joints and their records."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield missing joint files and unknown placeholders."""
        if self.joint is None and self.table is None:
            yield "joint", self.lacks("joint")
        for key, known in (("joint", ("joint",)), ("records", tuple(PLACEHOLDERS))):
            yield from unknown_placeholders(key, getattr(self, key) or "", known)


class CampaignTable(Table):
    """A campaign file."""

    name: Text | None = Field(None, description="what reports call the campaign")
    fleet: FleetTable = Field(description="joints, and the records that were logged of them")
    sweep: Annotated[dict[str, Annotated[list[Any], Says("a list of values")]], BeforeValidator(flatten_keys)] = Field(
        default_factory=dict, description="keys of the joint file, each with its values; every combination is a case"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield invalid sweep values."""
        for key, values in self.sweep.items():
            if not values or not all(isinstance(value, str | int | float) for value in values):
                yield "sweep", f": {key} is no list of values; expected one or more texts, numbers, true or false."
