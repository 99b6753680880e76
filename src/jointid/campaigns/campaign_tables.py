"""Tables of a campaign file: fleets, simulated runs, bootstraps, starts, sweeps."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from jointid.common.messages import Says, either
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.common.text import join
from jointid.config.table import Table, Text, flatten_keys, keys_from

KINDS = ("fleet", "monte_carlo", "bootstrap", "multistart")
"""Tables of which a campaign has one."""
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
        "path or URL of the records, with {joint} where the joint's name stands, {day} where a date does, and *; "
        "without it the record that the joint file names",
    )
    table: str | None = setting(
        None, "path of a table of joints, .csv or .parquet; joint and records then serve rows that do not say them"
    )


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """Simulated runs of one joint with noise."""

    joint: str = field(metadata=declare("path of the joint file, from this file"))
    runs: int = field(metadata=declare("how many", at_least=1))
    record: str | None = setting(
        None, "path of the record whose reference is followed; without it the one that the joint file names"
    )
    seed: int = setting(1, "of the first run; the others follow", at_least=0)
    noise_force: float = setting(
        0.0, "standard deviation of a white force on the motor, inside the loop", unit="N or N m", at_least=0
    )
    noise_log: float = setting(
        0.0, "standard deviation of white noise on the logged torque", unit="N or N m", at_least=0
    )
    values: Mapping[str, float] = field(
        default_factory=dict,
        metadata=declare("truth by parameter; of others the values and starts of the joint file are true"),
    )


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Bootstrap:
    """Runs of one record with its residual resampled in blocks of time.

    The explained torque stays. Valid if the residual is independent of the motion and the other channels are exact.
    """

    joint: str = field(metadata=declare("path of the joint file, from this file"))
    runs: int = field(metadata=declare("how many", at_least=1))
    record: str | None = setting(None, "path of the record; without it the one that the joint file names")
    seed: int = setting(1, "of the first run; the others follow", at_least=0)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Multistart:
    """Searches of one record from random starts around the joint file's."""

    joint: str = field(metadata=declare("path of the joint file, which gives free parameters a start; from this file"))
    runs: int = field(metadata=declare("how many", at_least=1))
    record: str | None = setting(None, "path of the record; without it the one that the joint file names")
    seed: int = setting(1, "of the first run; the others follow", at_least=0)
    spread: float = setting(3.0, "largest factor, or its inverse, by which a start is changed", above=1)


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


@keys_from(MonteCarlo)
class MonteCarloTable(Table):
    """[monte_carlo]: simulated runs of one joint with noise."""


@keys_from(Bootstrap)
class BootstrapTable(Table):
    """[bootstrap]: runs of one record with a resampled residual."""


@keys_from(Multistart)
class MultistartTable(Table):
    """[multistart]: searches of one record from many starts."""


class CampaignTable(Table):
    """A campaign file."""

    name: Text | None = Field(None, description="what reports call the campaign")
    fleet: FleetTable | None = Field(None, description="joints, and the records that were logged of them")
    monte_carlo: MonteCarloTable | None = Field(None, description="runs that are simulated")
    bootstrap: BootstrapTable | None = Field(None, description="runs of one record whose error is drawn anew")
    multistart: MultistartTable | None = Field(None, description="searches of one record from many starts")
    sweep: Annotated[dict[str, Annotated[list[Any], Says("a list of values")]], BeforeValidator(flatten_keys)] = Field(
        default_factory=dict, description="keys of the joint file, each with its values; every combination is a case"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a missing or ambiguous task, and invalid sweep values."""
        if sum(getattr(self, kind) is not None for kind in KINDS) != 1:
            yield "", f"A campaign has one of the tables {join([f'[{kind}]' for kind in KINDS])}; write one of them."
        for key, values in self.sweep.items():
            if not values or not all(isinstance(value, str | int | float) for value in values):
                yield "sweep", f": {key} is no list of values; expected one or more texts, numbers, true or false."
