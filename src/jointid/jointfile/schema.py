"""Every table and key of the joint file, what may stand there, and what each table becomes.

What a key is when it is left out is the default of the object the table becomes; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import NullableSchema, WithDefaultSchema

from jointid.data.checks import CLOCK_TOLERANCE
from jointid.data.columns import Column
from jointid.data.drive import Drive
from jointid.data.formats import Csv, format_of
from jointid.data.profiles import profile_named, profile_names
from jointid.data.record import Channel, Injection
from jointid.data.signals import Filtering
from jointid.data.transmission import Side, Transmission
from jointid.estimation.didim import DIDIM
from jointid.estimation.drive_side import DriveSideFit
from jointid.estimation.flexible import FlexibleDIDIM
from jointid.estimation.identify import Method
from jointid.estimation.idim import IDIM
from jointid.estimation.open_loop import OpenLoopFit
from jointid.jointfile import wording
from jointid.jointfile.gearing import TransmissionTable
from jointid.jointfile.laws import ControllerTable
from jointid.jointfile.table import Table, accepted, refusal
from jointid.jointfile.values import (
    Borders,
    Bound,
    ColumnGain,
    ControllerNumbers,
    Count,
    Flag,
    Names,
    Natural,
    NotNegative,
    Number,
    Positive,
    Sign,
    Text,
    TimeUnit,
)
from jointid.jointfile.wording import Says
from jointid.model.effects import Drift, Effect, PositionHarmonics
from jointid.model.gravity import Counterbalance, Gravity
from jointid.model.joints import FRICTIONS, FlexibleJoint, Joint, RigidJoint, friction_named

OF_IDIM = ("estimator", "harmonics", "period", "drift")
"""The keys of [method] that are IDIM's."""

OPTIONS = ("delimiter", "decimal", "header")
"""The keys of [record] that are options of the format's reader."""

Delimiter = Annotated[Text, accepted(lambda mark: Csv(delimiter=mark))]
RecordFile = Annotated[Text, accepted(format_of)]

FILTERINGS: Mapping[str, Callable[[], Filtering]] = {
    "default": Filtering,
    "published": Filtering.published,
    "as-printed": Filtering.as_printed,
}
"""The presets of [filtering]."""

DIDIMS: Mapping[str, type[DIDIM] | type[FlexibleDIDIM]] = {"rigid": DIDIM, "flexible": FlexibleDIDIM}
"""What [method] becomes with the name "didim", by the joint's model."""


CLOSINGS: Mapping[str, type[DriveSideFit] | type[OpenLoopFit]] = {"drive_side": DriveSideFit, "open_loop": OpenLoopFit}
"""What [method] becomes with the other names that simulate, by the name; neither needs the controller."""


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


class ChannelTable(Table):
    """[record.channels.reference] and its like: the column of one channel."""

    column: Text | None = Field(None, description="name of the column in the record's file")
    unit: Text | None = Field(None, description="unit of gain x column")
    gain: ColumnGain = Field(1.0, description="what takes the column to the unit")
    sign: Sign = Field(1, description="-1 turns the channel round")
    timing: Literal["sampled", "held", "averaged"] | None = Field(None, description="what one value stands for")
    sample_time: Positive | None = Field(None, description="own time between samples [s]")
    side: Side | None = Field(None, description="of the transmission, on which it is measured")
    wrap: Positive | None = Field(None, description="where the column wraps round, in its own numbers")
    update_time: Positive | None = Field(None, description="time between refreshes, if longer [s]")
    optional: Flag = Field(False, description="whether a record may lack this column")

    def declared(self) -> Column:
        """Return the column that is declared."""
        return Column(**self.given())


class TorqueTable(ChannelTable):
    """[record.channels.torque]."""

    tap: Literal["command", "filtered", "measured"] | None = Field(None, description="where the torque was logged")


class InjectedTable(ChannelTable):
    """[record.channels.injected]: a known signal added to the controller's output."""

    at: Literal["before_limit", "after_limit"] = Field("after_limit", description="where the signal is added")
    in_torque: Flag = Field(True, description="whether the logged torque contains the signal")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that no such injection exists."""
        any_signal = Channel(np.zeros(1), "N", 1.0)
        if refused := refusal(lambda: Injection(any_signal, self.declared().at, self.in_torque)):
            yield "in_torque", refused


class ChannelsTable(Table):
    """[record.channels]: where the record's channels are found."""

    torque: TorqueTable | None = Field(None, description="motor torque or force")
    reference: ChannelTable | None = Field(None, description="commanded position, motor side")
    reference_velocity: ChannelTable | None = Field(None, description="commanded velocity")
    motor_position: ChannelTable | None = Field(None, description="motor encoder")
    load_position: ChannelTable | None = Field(None, description="load encoder")
    injected: InjectedTable | None = Field(None, description="known signal added to the controller's output")


class RecordTable(Table):
    """[record]: the file of the record, and how it is read."""

    file: RecordFile | None = Field(None, description="path of the record, from the joint file's folder")
    time: Text | None = Field(None, description="name of the time column")
    time_unit: TimeUnit | None = Field(None, description="unit of the time column")
    sample_time: Positive | None = Field(None, description="time between samples [s]")
    clock_tolerance: NotNegative = Field(CLOCK_TOLERANCE, description="largest jitter, as a share of the sample time")
    delimiter: Delimiter | None = Field(None, description="character between the cells of a text file")
    decimal: Literal[".", ","] | None = Field(None, description="decimal mark of a text file")
    header: Flag | None = Field(None, description="whether a text file names its columns")
    channels: ChannelsTable = Field(default_factory=ChannelsTable, description="where the channels are found")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the file's format has no such option."""
        if self.file is not None and (refused := refusal(partial(format_of, self.file, **self.options()))):
            yield "file", refused

    def options(self) -> dict[str, Any]:
        """Return the options of the format's reader that are given."""
        return {key: value for key, value in self.given().items() if key in OPTIONS}


class DriveTable(Table):
    """[drive]: whose traces the record is made of, and the numbers behind the drive's own units."""

    profile: Annotated[Text, accepted(profile_named)] | None = Field(
        None, description="of the traces", json_schema_extra={"enum": list(profile_names())}
    )
    axis: Count | None = Field(None, description="which one, where a trace has several")
    rated_torque: Positive | None = Field(None, description="what per mille are of [N m or N]")
    rated_current: Positive | None = Field(None, description="likewise, as a current [A]")
    torque_constant: Positive | None = Field(None, description="torque per current [N m/A or N/A]")
    counts_per_turn: Positive | None = Field(None, description="of the encoder, revolute")
    counts_per_metre: Positive | None = Field(None, description="of the encoder, prismatic")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the numbers contradict each other."""
        if refused := refusal(self.drive):
            yield "", refused

    def drive(self) -> Drive:
        """Return what is known of the drive."""
        return Drive(**self.given())


class FilteringTable(Table):
    """[filtering]: how torque and columns are filtered, position and decimation each with its cut-off."""

    preset: Literal["default", "published", "as-printed"] | None = Field(None, description="all of it at once")
    position_cutoff: Positive | None = Field(None, description="of the low-pass on measured positions [Hz]")
    cutoff: Positive | None = Field(None, description="of the decimation filter on torque and columns [Hz]")
    decimation: Count | None = Field(None, description="one sample is kept in so many")
    borders: Borders = Field([50, 50], description="samples dropped at the start and at the end")
    timing: Literal["respected", "as_sampled"] = Field("respected", description="how a held torque is read")
    aliasing: Literal["refused", "warned"] = Field("refused", description="what becomes of a decimation that aliases")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the keys beside a preset."""
        if self.preset is not None:
            for key, value in self.given("preset").items():
                yield key, wording.beside_preset(value, self.preset)

    def filtering(self) -> Filtering:
        """Return the filtering."""
        if self.preset is not None:
            return FILTERINGS[self.preset]()
        given = self.given()
        return Filtering(**given | ({"borders": tuple(given["borders"])} if "borders" in given else {}))


class MethodTable(Table):
    """[method]: how the joint is identified; some keys are for a rigid joint only, others for a flexible one."""

    name: Literal["didim", "idim", "drive_side", "open_loop"] | None = Field(None, description="the method")
    preset: Literal["paper"] | None = Field(None, description="all settings of DIDIM at once")
    form: Literal["residual", "paper"] = Field("residual", description="what each step solves")
    start: Literal["inversion", "regular", "given"] = Field("inversion", description="where the search begins")
    scaled_iterations: Natural = Field(2, description="first iterations under scaled controller gains")
    tolerance: Positive | None = Field(None, description="change to stop at, relative")
    step_tolerance: Positive = Field(1e-7, description="change of the parameters to stop at, relative")
    iterations: Count = Field(30, description="iterations at most")
    initial_state: Literal["free", "reference"] = Field("free", description="the motor at the first sample")
    free: Names = Field([], description="what surrounds the joint and is identified with it")
    minimiser: Literal["least-squares", "nelder-mead"] = Field(
        "least-squares", description="the way down the criterion"
    )
    frequency: Positive | None = Field(None, description="free-free, where the stiffness starts from [Hz]")
    rigid_cutoff: Positive | None = Field(None, description="of the rigid identification before [Hz]")
    simulations: Count = Field(6000, description="simulations of one descent at most")
    restarts: Natural = Field(3, description="restarts of Nelder-Mead at most")
    statistics: Literal["sensitivities", "inverse-model"] = Field("sensitivities", description="of the deviations")
    log_delay: Number | None = Field(None, description="how late the log shows the torque, estimated if left out [s]")
    current_lag: NotNegative | Literal["estimated"] = Field(0.0, description="time constant between log and torque [s]")
    instruments: Literal["tested", "always", "never"] = Field("tested", description="when they replace least squares")
    highpass: Positive | None = Field(None, description="below it the position is drift [Hz]")
    estimator: Literal["ols", "weighted", "robust", "iv"] = Field("ols", description="of IDIM")
    harmonics: Natural = Field(0, description="of the force over the motor position, for IDIM")
    period: Positive | None = Field(None, description="of the first harmonic [m or rad]")
    drift: Literal["force", "viscous", "both"] | None = Field(None, description="what changes with time, for IDIM")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a period of no harmonics."""
        if self.period is not None and self.harmonics == 0:
            yield "period", f" is {self.period:g}, but there are no harmonics; add harmonics = 1, or leave it out."

    def model_of(self, key: str) -> str | None:
        """Return the joint's model that a key is for, None where it is for both."""
        models = [model for model, made in DIDIMS.items() if key in {field.name for field in fields(made)}]
        return models[0] if len(models) == 1 else None

    def is_of(self, key: str, name: str) -> bool:
        """Whether a key is a setting of the method of that name."""
        made = [CLOSINGS[name]] if name in CLOSINGS else list(DIDIMS.values())
        return any(key in {field.name for field in fields(one)} for one in made)

    def of_closing(self, key: str) -> bool:
        """Whether a key is only for the methods that prescribe a motion or a torque."""
        return any(self.is_of(key, name) for name in CLOSINGS) and not self.is_of(key, "didim")

    def beside_preset(self) -> dict[str, Any]:
        """Return the values that the preset sets too; the paper knew its frequency, and another joint has another."""
        return {} if self.preset is None else self.given("name", "preset", "frequency")

    def effects(self) -> tuple[Effect, ...]:
        """Return the further columns of IDIM."""
        ripple = (PositionHarmonics(self.period, self.harmonics),) if self.harmonics else ()
        return (*ripple, *(() if self.drift is None else (Drift(self.drift),)))

    def method(self, name: str, model: str) -> Method:
        """Return the method of that name with these settings, for a joint of that model."""
        if name == "idim":
            return IDIM(self.estimator, self.effects())
        if name in CLOSINGS:
            lag = {"current_lag": None} if self.current_lag == "estimated" else {}
            return CLOSINGS[name](**self.given("name") | lag)
        made, given = DIDIMS[model], self.given("name", "preset")
        given |= {"free": tuple(given["free"])} if "free" in given else {}
        return made.paper(**given) if self.preset == "paper" else made(**given)


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


class RunTable(Table):
    """[[records]]: one of several records that are identified together, and what is known to differ in it."""

    file: RecordFile = Field(description="path of the record, from the joint file's folder")
    added_inertia: NotNegative = Field(
        0.0, description="known, on the load, beyond what is shared [kg or kg m2, load side]"
    )
    own: Names = Field([], description="names of parameters that the other records do not share")
    controller: ControllerNumbers = Field(
        default_factory=dict, description="numbers of the controller that were others, by key"
    )


class TogetherTable(Table):
    """[together]: how several records are identified together."""

    free: Names = Field([], description="names of what surrounds the joint and is identified too")
    weighting: Literal["spectrum", "level"] = Field("spectrum", description="of the rows, by their record's residual")


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
    together: TogetherTable = Field(default_factory=TogetherTable, description="how they are")


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
