"""[joint] and [gravity]: what is identified, what its load weighs, and what the tables become."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from jointid.config.table import Table, accepted, refusal
from jointid.config.values import Number, Text
from jointid.models.friction import FRICTIONS, friction_named
from jointid.models.gravity import Counterbalance, Gravity
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.transmission import Transmission


class JointTable(Table):
    """[joint]: what is identified."""

    kind: Literal["prismatic", "revolute"] = Field(description="how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] = Field("rigid", description="one inertia, or two joined by a spring")
    friction: Annotated[Text, accepted(friction_named)] = Field(
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


class CounterbalanceTable(Table):
    """[gravity.counterbalance]: what a known counterbalance takes off the load, on the side that is reported."""

    constant: Number = Field(0.0, description="wherever the joint is [N or N m]")
    cos: Number = Field(0.0, description="times the cosine of the link's angle [N m]")
    sin: Number = Field(0.0, description="times the sine of the link's angle [N m]")
    rate: Number = Field(0.0, description="times the position, of a spring or a cylinder [N/m or N m/rad]")


class GravityTable(Table):
    """[gravity]: what the load weighs."""

    load: Literal["constant", "link"] = Field(description="a vertical axis, or a body that turns in a vertical plane")
    angle: Number = Field(1.0, description="of the link, per unit of the joint's position")
    counterbalance: CounterbalanceTable = Field(
        default_factory=CounterbalanceTable, description="the known part that something else carries"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that there is no such gravity."""
        if refused := refusal(self.gravity):
            yield "angle", refused

    def gravity(self, transmission: Transmission | None = None) -> Gravity:
        """Return the gravity, as a joint has it on its side of the transmission."""
        angle = self.angle if transmission is None else self.angle * transmission.torque("load")
        return Gravity(self.load, Counterbalance(**self.counterbalance.given()), angle)
