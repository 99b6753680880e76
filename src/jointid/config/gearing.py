"""[transmission] and the sides it makes: on which a channel or the controller is, and how that side moves."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from pydantic import Field

from jointid.common import units
from jointid.common.transmission import Side, Transmission
from jointid.config.generate import keys_from
from jointid.config.table import Table
from jointid.config.values import LengthUnit, Size
from jointid.models.parameters import Kind


@keys_from(Transmission, without=("load", "lead"))
class TransmissionTable(Table):
    """[transmission]: what lies between motor and load, without loss."""

    lead: Size | None = Field(
        None,
        description="how far a prismatic load goes in one turn of the motor: of a screw, a rack or a belt; the motor "
        "is revolute then [lead_unit]",
    )
    lead_unit: LengthUnit = Field("m", description="unit of the lead")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that there is not one of ratio and lead."""
        if self.ratio is None and self.lead is None:
            yield "", " has neither ratio nor lead; expected one of them: add it."
        elif self.ratio is not None and self.lead is not None:
            yield "lead", f" is {self.lead:g} beside ratio = {self.ratio:g}; expected one of them: leave one out."
        elif self.lead is None and "lead_unit" in self.model_fields_set:
            yield "lead_unit", " is there without a lead: leave it out."

    @property
    def geared(self) -> bool:
        """True if motor and load move alike, but not by the same amount."""
        return self.ratio is not None and self.ratio != 1.0

    def transmission(self, kind: Kind) -> Transmission:
        """Return the transmission to a load of that kind."""
        lead = None if self.lead is None else self.lead * units.unit(self.lead_unit).factor
        return Transmission(load=kind, ratio=self.ratio, lead=lead, sign=self.sign, side=self.side)


def transmission_faults(transmission: TransmissionTable, kinds: Collection[Kind]) -> Iterator[str]:
    """Yield that a load of these kinds has no lead."""
    if transmission.lead is not None and "prismatic" not in kinds:
        yield (
            f"transmission.lead is {transmission.lead:g}, but the load is revolute; expected a ratio: give that, "
            'or set joint.kind = "prismatic".'
        )


def side_faults(named: Mapping[str, Side]) -> Iterator[str]:
    """Yield the sides that are named, by their table, where there is no transmission."""
    for table, side in named.items():
        yield f'{table}.side is "{side}", but nothing lies between motor and load: add [transmission], or leave it out.'


def kind_of(side: Side, kind: Kind, transmission: TransmissionTable | None) -> Kind:
    """Return how a side of a joint of that kind, which is its load's, moves: with a lead the motor turns."""
    return "revolute" if transmission and transmission.lead is not None and side == "motor" else kind
