"""The joint file as a whole, and its tables of the joint and of how it is identified.

What may stand there, and what it becomes. What a key is when it is left out is the default of the object the table
becomes; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import NullableSchema, WithDefaultSchema

from jointid.common import messages, units
from jointid.common.messages import Says
from jointid.common.settings import settings_of
from jointid.common.transmission import Transmission
from jointid.config.keys import Bound, Flag, LengthUnit, Natural, Number, Positive, Size, Text, keys_from
from jointid.config.schema_controller import ControllerTable
from jointid.config.schema_record import DriveTable, RecordTable, RunTable, TogetherTable
from jointid.config.table import Table, accept_by, refusal
from jointid.estimation.methods.registry import Method, MethodName, method_of, methods
from jointid.models.disturbances import Drift, Effect, PositionHarmonics
from jointid.models.friction import FRICTIONS, friction_named
from jointid.models.gravity import Counterbalance, Gravity
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.parameters import Kind
from jointid.records.signals.filtering import Filtering

EFFECTS = ("harmonics", "period", "drift")
"""The keys of [method] that say the effects of a method that has any."""

FILTERINGS: Mapping[str, Callable[[], Filtering]] = {
    "default": Filtering,
    "published": Filtering.published,
    "as-printed": Filtering.as_printed,
}
"""The presets of [filtering]."""


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
        return Gravity(self.load, self.counterbalance.build(), angle)


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


@keys_from(Filtering)
class FilteringTable(Table):
    """[filtering]: how torque and columns are filtered, position and decimation each with its cut-off."""

    preset: Literal["default", "published", "as-printed"] | None = Field(
        None, description="all of it at once, in place of the other keys"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the keys beside a preset."""
        if self.preset is not None:
            for key, value in self.given("preset").items():
                yield key, messages.beside_preset(value, self.preset)

    def build(self) -> Any:
        """Return the filtering."""
        return super().build() if self.preset is None else FILTERINGS[self.preset]()


@keys_from(*methods())
class MethodTable(Table):
    """[method]: how the joint is identified; some keys are for a rigid joint only, others for a flexible one."""

    name: MethodName | None = Field(
        None, description="by which method; without it didim if the record has what it needs, else idim"
    )
    preset: Literal["paper"] | None = Field(
        None, description="all settings of didim at once as the paper has them, in place of the others but frequency"
    )
    harmonics: Natural = Field(0, description="of idim: harmonics of the force over the motor position")
    period: Positive | None = Field(
        None,
        description="of idim: of the first harmonic, on the side that is reported; without it searched for [m or rad]",
    )
    drift: Literal["force", "viscous", "both"] | None = Field(
        None, description="of idim: what changes linearly in time"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a period of no harmonics."""
        if self.period is not None and self.harmonics == 0:
            yield "period", f" is {self.period:g}, but there are no harmonics; add harmonics = 1, or leave it out."

    def beside_preset(self) -> dict[str, Any]:
        """Return the values that the preset sets too; the paper knew its frequency, and another joint has another."""
        return {} if self.preset is None else self.given("name", "preset", "frequency")

    def effects(self) -> tuple[Effect, ...]:
        """Return the further columns of a regression."""
        ripple = (PositionHarmonics(self.period, self.harmonics),) if self.harmonics else ()
        return (*ripple, *(() if self.drift is None else (Drift(self.drift),)))

    def method(self, name: str, model: str) -> Method:
        """Return the method of that name with these settings, for a joint of that model."""
        made: Any = method_of(name, model)
        given = self.settings("name", "preset", *EFFECTS)
        for one in settings_of(made):
            if one.setting.none and given.get(one.name) == one.setting.none:
                given[one.name] = None
        if has_effects(made):
            given["effects"] = self.effects()
        method: Method = made.paper(**given) if self.preset == "paper" else made(**given)
        return method


def has_effects(method: type[Method]) -> bool:
    """True if a method takes effects, whose keys are `EFFECTS`."""
    made: Any = method
    return "effects" in {field.name for field in fields(made)}


def keys_of(method: type[Method]) -> tuple[str, ...]:
    """Return the keys of [method], beside its name, that a method has."""
    settings = tuple(one.name for one in settings_of(method))
    return (*settings, *(EFFECTS if has_effects(method) else ()), *(("preset",) if hasattr(method, "paper") else ()))


class ParameterTable(Table):
    """[parameters.inertia] and its like: one parameter; a bare number is a value."""

    shorthand = "value"

    value: Number | None = Field(None, description="what the parameter is fixed at")
    start: Number | None = Field(None, description="where the search begins")
    lower: Bound | None = Field(None, description="lower bound")
    upper: Bound | None = Field(None, description="upper bound")
    free: Flag | None = Field(None, description="whether the parameter is identified")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield what contradicts itself."""
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            yield "lower", f" is {self.lower:g}; expected less than upper = {self.upper:g}: exchange them."
        if self.value is not None and self.free:
            yield "free", f" is true beside value = {self.value:g}, which would fix it; write start = {self.value:g}."
        if self.value is not None and self.start is not None:
            yield "start", " stands beside value; keep value to fix the parameter, or start to identify it."
        if self.value is None and self.free is False:
            yield "value", " is missing; a parameter that is not free needs the value that it keeps: add it."


class FileTable(Table):
    """A joint file."""

    decided_by: ClassVar = {"controller": "law"}

    joint: JointTable = Field(description="what is identified")
    transmission: TransmissionTable | None = Field(None, description="what lies between motor and load")
    gravity: GravityTable | None = Field(None, description="what its load weighs, if that matters")
    record: RecordTable = Field(default_factory=RecordTable, description="the file of the record, and its channels")
    drive: DriveTable = Field(default_factory=DriveTable, description="whose traces they are, and its own units")
    controller: ControllerTable | None = Field(None, description="the controller's law, if it is known")
    filtering: FilteringTable = Field(default_factory=FilteringTable, description="how signals are filtered")
    method: MethodTable = Field(default_factory=MethodTable, description="how the joint is identified")
    parameters: dict[str, ParameterTable] = Field(
        default_factory=dict, description="what is known of the parameters, by name"
    )
    records: Annotated[list[RunTable], Says("one [[records]] table for each record")] = Field(
        default_factory=list, description="records that are identified together"
    )
    together: TogetherTable = Field(
        default_factory=TogetherTable, description="how several records are identified together"
    )


class _WithoutNull(GenerateJsonSchema):
    """TOML has no null: what has no default is left out."""

    def nullable_schema(self, schema: NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: WithDefaultSchema) -> JsonSchemaValue:
        described = super().default_schema(schema)
        return {key: value for key, value in described.items() if (key, value) != ("default", None)}


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of the joint file, for documentation and forms."""
    return FileTable.model_json_schema(schema_generator=_WithoutNull)
