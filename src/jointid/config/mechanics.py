"""[joint] and [gravity]: what is identified, what its load weighs, and what the tables become."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from jointid.common.transmission import Transmission
from jointid.config.generate import keys_from
from jointid.config.table import Table, accept_by, refusal
from jointid.config.values import Text
from jointid.models.friction import FRICTIONS, friction_named
from jointid.models.gravity import Counterbalance, Gravity
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint


class JointTable(Table):
    """[joint]: what is identified."""

    kind: Literal["prismatic", "revolute"] = Field(description="how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] = Field("rigid", description="one inertia, or two joined by a spring")
    friction: Annotated[Text, accept_by(friction_named)] = Field(
        "symmetric", description="the friction's law", json_schema_extra={"enum": list(FRICTIONS)}
    )
    name: Text | None = Field(None, description="what reports call the joint")

    def joint(
        self, torque_unit: str | None, transmission: Transmission | None = None, gravity: GravityTable | None = None
    ) -> Joint:
        """Return the joint; `torque_unit` is "A" or "V" for a torque in the drive's units."""
        made = FlexibleJoint if self.model == "flexible" else RigidJoint
        kind = self.kind if transmission is None else transmission.kind
        weight = None if gravity is None else gravity.gravity(transmission)
        return made(kind, friction_named(self.friction), torque_unit, transmission=transmission, gravity=weight)


@keys_from(Counterbalance)
class CounterbalanceTable(Table):
    """[gravity.counterbalance]: what a known counterbalance takes off the load, on the side that is reported."""


@keys_from(Gravity, types={"counterbalance": (CounterbalanceTable, CounterbalanceTable)})
class GravityTable(Table):
    """[gravity]: what the load weighs."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that there is no such gravity."""
        if refused := refusal(self.gravity):
            yield "angle", refused

    def gravity(self, transmission: Transmission | None = None) -> Gravity:
        """Return the gravity, as a joint has it on its side of the transmission."""
        angle = self.angle if transmission is None else self.angle * transmission.torque("load")
        return Gravity(self.load, Counterbalance(**self.counterbalance.given()), angle)
