"""The joint file as a whole, and its tables of the joint, of its controller and of how it is identified.

The tables define the allowed keys and values, and build the objects. The default of a key is that of the object; a
test compares the two.
"""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, replace
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias, Union, get_args

from pydantic import Field, PrivateAttr, ValidationError, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import NullableSchema, WithDefaultSchema

from jointid.common import messages, units
from jointid.common.errors import Fault, JointidError, MethodError
from jointid.common.messages import Says
from jointid.common.settings import settings_of
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind
from jointid.config.quantities import Stated
from jointid.config.schema_record import ChannelTable, DriveTable, RecordTable, RunTable, TogetherTable
from jointid.config.table import (
    CONTRADICTION,
    Bound,
    Flag,
    LengthUnit,
    Matrix,
    Natural,
    Number,
    Numbers,
    Place,
    Positive,
    Size,
    Table,
    Text,
    Typed,
    accept_by,
    annotation_of,
    fault_at,
    faults_of,
    keys_from,
    keys_of_kinds,
    refusal,
    with_keys,
    with_unit,
)
from jointid.estimation.methods.registry import ROBOT, Method, MethodName, method_of, methods
from jointid.models.controllers import (
    FILTERS,
    LAWS,
    Controller,
    DigitalFilter,
    Filter,
    StateSpaceController,
    as_filter,
)
from jointid.models.disturbances import Drift, Effect
from jointid.models.friction import FRICTIONS, find_friction
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.limits import AxisLimits
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.models.springs import SPRINGS, LinearSpring, find_spring
from jointid.records.drives import Drive
from jointid.records.record import CHANNELS
from jointid.records.signals.filtering import Filtering

KINDS: tuple[Kind, ...] = get_args(Kind)

EFFECTS = ("harmonics", "period", "drift")
"""The keys of [method] for the effects of a regression."""

FILTERINGS: Mapping[str, Callable[[], Filtering]] = {
    "default": Filtering,
    "published": Filtering.published,
    "as-printed": Filtering.as_in_paper,
}
"""The presets of [filtering]."""


CONSTANT = "N/A, N m/A, N/V or N m/V"


class JointTable(Table):
    """[joint]: what is identified."""

    kind: units.Kind = Field(description="how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] = Field("rigid", description="one inertia, or two joined by a spring")
    friction: Annotated[Text, accept_by(find_friction)] = Field(
        "symmetric", description="the friction's law", json_schema_extra={"enum": list(FRICTIONS)}
    )
    spring: Annotated[Text, accept_by(find_spring)] = Field(
        "linear", description="the spring's law, of a flexible joint", json_schema_extra={"enum": list(SPRINGS)}
    )
    name: Text | None = Field(None, description="what reports call the joint")
    torque_constant: with_unit(Positive, CONSTANT) | None = Field(  # type: ignore[valid-type]
        None,
        description="of the motor or its amplifier, on the motor's side: takes a torque in A or V, and the output of a "
        f"controller in A or V, to N m or N; a plain number is per A [{CONSTANT}]",
    )

    def drive(self, drive: Drive) -> Drive:
        """Return a drive with the torque constant."""
        if self.torque_constant is None:
            return drive
        constant = float(self.torque_constant)
        if self.torque_per == "V":
            return replace(drive, torque_per_volt=constant)
        return replace(drive, torque_constant=constant)

    @property
    def torque_per(self) -> str:
        """Denominator of the torque constant: A or V."""
        text = self.torque_constant.text if isinstance(self.torque_constant, Stated) else "1 N/A"
        return "V" if "V" in text else "A"

    def joint(
        self,
        torque_unit: str | None,
        transmission: Transmission | None = None,
        gravity: GravityTable | None = None,
        ripple: RippleTable | None = None,
    ) -> Joint:
        """Return the joint; `torque_unit` is "A" or "V" for a torque in the drive's units."""
        kind = self.kind if transmission is None else transmission.kind
        weight = None if gravity is None else gravity.gravity(transmission)
        common = (
            kind, find_friction(self.friction), torque_unit, transmission, weight,
            None if ripple is None else ripple.build(),
        )  # fmt: skip
        return FlexibleJoint(*common, find_spring(self.spring)) if self.model == "flexible" else RigidJoint(*common)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the faults of a spring in a rigid joint, or of an impossible friction."""
        if self.model == "rigid" and self.spring != LinearSpring.name:
            yield "spring", f' is "{self.spring}", but a rigid joint has no spring; set joint.model = "flexible".'
            return
        try:
            self.joint(None)
        except MethodError as error:
            yield "friction", f": {error}"


@keys_from(Counterbalance)
class CounterbalanceTable(Table):
    """[gravity.counterbalance]: what a known counterbalance takes off the load, on the side that is reported."""


@keys_from(Gravity, types={"counterbalance": (CounterbalanceTable, CounterbalanceTable)})
class GravityTable(Table):
    """[gravity]: what the load weighs."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an impossible gravity."""
        if refused := refusal(self.gravity):
            yield "angle", refused

    def gravity(self, transmission: Transmission | None = None) -> Gravity:
        """Return the gravity, as a joint has it on its side of the transmission."""
        angle = self.angle if transmission is None else self.angle * transmission.torque("load")
        return Gravity(self.load, self.counterbalance.build(), angle)


@keys_from(PositionHarmonics, without=("period",))
class RippleTable(Table):
    """[ripple]: a force that comes back with the position, simulated and identified with the joint."""

    period: Positive = Field(
        description="of the first harmonic, such as the pitch of a screw or of the motor's slots, on the side that is "
        "reported [m or rad]"
    )


@keys_from(Transmission, without=("load", "lead"))
class TransmissionTable(Table):
    """[transmission]: what lies between motor and load, without loss."""

    lead: with_unit(Size, "m") | None = Field(  # type: ignore[valid-type]
        None,
        description="how far a prismatic load goes in one turn of the motor: of a screw, a rack or a belt; the motor "
        "is revolute then [lead_unit]",
    )
    lead_unit: LengthUnit = Field("m", description="unit of the lead")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of a missing or double ratio and lead."""
        if self.ratio is None and self.lead is None:
            yield "", " has neither ratio nor lead; expected one of them: add it."
        elif self.ratio is not None and self.lead is not None:
            yield "lead", f" is {self.lead:g} beside ratio = {self.ratio:g}; expected one of them: leave one out."
        elif "lead_unit" in self.model_fields_set and (self.lead is None or isinstance(self.lead, Stated)):
            beside = "without a lead" if self.lead is None else f'beside a lead of "{self.lead.text}"'
            yield "lead_unit", f" is there {beside}: leave it out."

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
            for key, value in self.given_values("preset").items():
                yield key, messages.beside_preset(value, self.preset)

    def build(self) -> Any:
        """Return the filtering."""
        return super().build() if self.preset is None else FILTERINGS[self.preset]()


@keys_from(*methods())
class MethodTable(Table):
    """[method]: how the joint, or the robot, is identified; some keys are for one of them only."""

    name: MethodName | None = Field(
        None,
        description="by which method; without it that of a joint is didim if the record has what it needs, else idim; "
        "that of a robot is didim without a motor_position, drive_side with one and a spring, else idim",
    )
    preset: Literal["paper"] | None = Field(
        None, description="all settings of didim at once as the paper has them, in place of the others but frequency"
    )
    harmonics: Natural = Field(0, description="of idim: harmonics of the force over the motor position")
    period: Positive | None = Field(
        None,
        description="of idim: of the first harmonic, on the side that is reported; needed beside harmonics [m or rad]",
    )
    drift: Literal["force", "viscous", "both"] | None = Field(
        None, description="of idim: what changes linearly in time"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a period of no harmonics, and harmonics of no period."""
        if self.period is None and self.harmonics > 0:
            yield "period", " is missing; expected a positive number (of the first harmonic, in m or rad)."
        if self.period is not None and self.harmonics == 0:
            yield "period", f" is {self.period:g}, but there are no harmonics; add harmonics = 1, or leave it out."

    def beside_preset(self) -> dict[str, Any]:
        """Return the values that the preset sets too; the paper knew its frequency, and another joint has another."""
        return {} if self.preset is None else self.given_values("name", "preset", "frequency")

    def effects(self) -> tuple[Effect, ...]:
        """Return the further columns of a regression."""
        ripple = () if self.period is None else (PositionHarmonics(self.period, self.harmonics),)
        return (*ripple, *(() if self.drift is None else (Drift(self.drift),)))

    def method(self, name: str, model: str) -> Method:
        """Return the method with these settings.

        Args:
            name: of the method.
            model: of the joint, "rigid" or "flexible"; or "robot".
        """
        made: Any = method_of(name)
        given = self.settings("name", "preset", *EFFECTS)
        for one in settings_of(made):
            if one.setting.none and given.get(one.name) == one.setting.none:
                given[one.name] = None
        if has_effects(made):
            given["effects"] = self.effects()
        method: Method = made.paper(model, **given) if self.preset == "paper" else made(**given)
        return method


def has_effects(method: type[Method]) -> bool:
    """True if a method takes effects, whose keys are `EFFECTS`."""
    made: Any = method
    return "effects" in {field.name for field in fields(made)}


def keys_of(method: type[Method], system: str) -> tuple[str, ...]:
    """Return the keys of [method] for a method and a "rigid" or "flexible" joint or a "robot", without the name."""
    if system not in method.systems:
        return ()
    own = settings_of(method)
    settings = tuple(one.name for one in own if not one.setting.systems or system in one.setting.systems)
    if system in ROBOT:
        return settings
    return (*settings, *(EFFECTS if has_effects(method) else ()), *(("preset",) if hasattr(method, "paper") else ()))


_NO_KEYS = ("ratio",)  # which the transmission and `side` say


@keys_of_kinds(FILTERS)
class FilterTable(Table):
    """[controller.velocity_filter], and each of torque_filters: a filter; a bare list is a numerator."""

    shorthand = "numerator"

    kind: Literal[*FILTERS] | None = Field(  # type: ignore[valid-type]
        None, description="which filter; it may be left out where the other keys are those of one kind alone"
    )

    cutoff: with_unit(Positive, "Hz") | None = Field(  # type: ignore[valid-type]
        None,
        description="of first_order: 1 / (2 pi time_constant), in place of it; of second_order: its frequency [Hz]",
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield missing keys, keys of another kind of filter, and an impossible filter."""
        meant = self._meant()
        if self.kind is None and len(meant) > 1:
            yield "kind", messages.missing(messages.either(meant), "which filter")
            return
        kind = meant[0]
        known = fields(FILTERS[kind])
        given, names = self._settings_of_kind(kind), [field.name for field in known]
        if "cutoff" in given:
            twice = f" is {self.cutoff:g} Hz beside {_CUTOFFS.get(kind)}, which says the same: leave one out."
            yield "cutoff", twice if kind in _CUTOFFS else messages.foreign(kind, names)
            return
        foreign = [key for key in given if key not in names]
        for key in foreign:
            yield key, messages.foreign(kind, names)
        lacking = [f.name for f in known if (f.default is MISSING or f.name == "numerator") and f.name not in given]
        for key in lacking:
            yield key, self.lacks(key)
        if not foreign and not lacking and (refused := refusal(self.filter)):
            yield "denominator" if kind == "digital" else "", refused

    def _meant(self) -> list[str]:
        """Return the named kind of filter, or all kinds with the given keys."""
        if self.kind is not None:
            return [self.kind]
        found = []
        for kind, made in FILTERS.items():
            names = {one.name: one.default is MISSING for one in fields(made)}
            given = self._settings_of_kind(kind)
            if set(given) <= set(names) and all(name in given for name, needed in names.items() if needed):
                found.append(kind)
        return found or list(FILTERS)

    def _settings_of_kind(self, kind: str) -> dict[str, Any]:
        """Return the given settings, with a cut-off as the setting of that kind of filter."""
        given = self.settings("kind")
        name = _CUTOFFS.get(kind)
        if name is None or name in given or "cutoff" not in given:
            return given
        cutoff = given.pop("cutoff")
        return {name: 1.0 / (2.0 * math.pi * cutoff) if name == "time_constant" else cutoff} | given

    def filter(self) -> Filter | tuple[float, ...]:
        """Return the filter, or only the numerator if nothing else is given."""
        (kind,) = self._meant()
        made: Filter = FILTERS[kind](**self._settings_of_kind(kind))
        return made.numerator if isinstance(made, DigitalFilter) and len(self.given_values()) == 1 else made


_CUTOFFS = {"first_order": "time_constant", "second_order": "frequency"}
"""The setting of each kind of filter that a cut-off frequency gives."""

FilterTables = Annotated[list[FilterTable], Says("a list of filters, each a table or the list of a numerator")]


def filters(tables: list[FilterTable]) -> tuple[Filter, ...]:
    """Return the filters of a row."""
    return tuple(as_filter(table.filter()) for table in tables)


_MEANT_ONE = " is {} on many drives; expected {}: write the one that is meant."
_KP = _MEANT_ONE.format(
    "the gain of another loop", "velocity_gain for the Kp of a drive's speed loop, position_gain for the kp of the "
    "paper or of a position controller"
)  # fmt: skip
_KV = _MEANT_ONE.format(
    "the gain of another loop", "position_gain for the Kv of a drive's position loop, velocity_gain for the kv of the "
    "paper"
)  # fmt: skip
_KI = _MEANT_ONE.format("a gain on some and a time", 'integral_gain, or integral_time = "6 ms" for a Tn')
_KD = _MEANT_ONE.format("a gain on some and a time", 'derivative_gain, or derivative_time = "2 ms" for a Td')
_TN = ' is called integral_time here; write that, as integral_time = "6 ms".'
_TD = ' is called derivative_time here; write that, as derivative_time = "2 ms".'

AMBIGUOUS: Mapping[str, str] = {
    "kp": _KP, "Kp": _KP, "KP": _KP, "kv": _KV, "Kv": _KV, "KV": _KV, "ki": _KI, "Ki": _KI, "KI": _KI,
    "kd": _KD, "Kd": _KD, "KD": _KD, "Tn": _TN, "tn": _TN, "Ti": _TN, "ti": _TN, "Td": _TD, "td": _TD, "Tv": _TD,
}  # fmt: skip
"""Names of gains with another meaning on each drive, with the rest of the sentence."""


class LawTable(Table):
    """A law: which one it is, and the side of its numbers."""

    ambiguous: ClassVar = AMBIGUOUS

    law: str = Field(description="the controller's law")
    side: Side = Field("motor", description="of the transmission, in whose positions and torque the law's numbers are")

    @abstractmethod
    def controller(self) -> Controller:
        """Return the controller, on its own side."""

    def refer(self, transmission: Transmission | None, gain: float = 1.0) -> Controller:
        """Return the controller as a joint sees it through its transmission, its output in units of that gain."""
        made: Any = replace(self.controller(), gain=gain)  # type: ignore[type-var]
        seen: Controller = made if transmission is None else replace(made, ratio=transmission.torque(self.side))
        return seen

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an impossible law, checked at the period where there is one."""
        period = self.period
        if refused := refusal(lambda: self.controller() if period is None else self.controller().law(period)):
            yield "", refused


class BlockDiagramTable(LawTable):
    """A law with a block diagram, which may filter velocity and torque."""

    def settings(self, *without: str) -> dict[str, Any]:
        """Return the settings of the law."""
        found = super().settings("law", "side", "velocity_filter", "torque_filters", *without)
        for time, (gain, made) in TIMES.items():
            if time in found:
                found[gain] = made(found.pop(time), found["position_gain"] if self.law != "cascade" else 1.0)
        if self.velocity_filter is not None:
            found["velocity_filter"] = self.velocity_filter.filter()
        return found | ({"torque_filters": filters(self.torque_filters)} if self.torque_filters else {})

    def controller(self) -> Controller:
        """Return the controller."""
        made: Controller = LAWS[self.law](**self.settings())
        return made

    @classmethod
    def find_missing(cls, given: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield required gains that are given neither as a gain nor as a time."""
        for time, (gain, _) in TIMES.items():
            needed = time in cls.model_fields and cls.model_fields[gain].default is None
            if needed and not {time, gain} & set(given):
                yield gain, cls.lacks(gain).removesuffix(": add it.") + f": add it, or {time}."

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield missing gains, and gains given twice, also as a time."""
        wrong = [*self.find_missing(self.model_fields_set)]
        for time, (gain, _) in TIMES.items():
            if {time, gain} <= self.model_fields_set:
                said = f" = {getattr(self, time):g} s stands beside {gain}, which says the same: leave one out."
                wrong.append((time, said))
        yield from wrong or super().faults()


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
        """Yield faults of the shapes."""
        if len({len(row) for row in self.A}) > 1:
            lengths = ", ".join(str(len(row)) for row in self.A)
            yield "A", f" has rows of {lengths} numbers; expected rows of one length: complete them."
        else:
            yield from super().faults()

    def controller(self) -> StateSpaceController:
        """Return the controller."""
        return StateSpaceController(
            B=self.B.given_values(), D=self.D.given_values(), **self.given_values("law", "side", "B", "D")
        )


TIMES: Mapping[str, tuple[str, Callable[[float, float], float]]] = {
    "integral_time": ("integral_gain", lambda time, gain: gain / time),
    "derivative_time": ("derivative_gain", lambda time, gain: gain * time),
}
"""Gain of each time, with the function that computes it from the time and the proportional gain."""

_MEANT = {
    ("cascade", "integral_time"): "integral time Tn of the velocity loop, 1 over its integral gain",
    ("pd", "derivative_time"): "derivative time Td: derivative_gain = position_gain x derivative_time",
    ("pid", "derivative_time"): "derivative time Td: derivative_gain = position_gain x derivative_time",
    ("pid", "integral_time"): "integral time Ti: integral_gain = position_gain / integral_time",
}


def add_gains_of_times(keys: Iterable[str]) -> frozenset[str]:
    """Return keys of [controller], with the gain of each time: integral_gain for integral_time."""
    given = list(keys)
    return frozenset([*given, *(TIMES[key][0] for key in given if key in TIMES)])


def _table_of(word: str, law: Any) -> type[LawTable]:
    """Return the table of a law with a block diagram."""
    make: Any = create_model
    times: dict[str, Typed] = {}
    types: dict[str, Typed] = {"velocity_filter": (FilterTable, None), "torque_filters": (FilterTables, [])}
    for (of, time), meaning in _MEANT.items():
        if of == word:
            gain = TIMES[time][0]
            (declared,) = [one for one in settings_of(law) if one.name == gain]
            times[time] = (with_unit(Positive, "s") | None, Field(None, description=f"{meaning} [s]"))
            types |= {gain: (annotation_of(declared), None)} if declared.required else {}
    made: type[LawTable] = make(
        f"{law.__name__}Table",
        __base__=BlockDiagramTable,
        __module__=__name__,
        __doc__=f'[controller] with law = "{word}".',
        law=(Literal[word], Field(description="the controller's law")),
    )
    return with_keys(times)(keys_from(law, without=_NO_KEYS, types=types)(made))


LAW_TABLES: tuple[type[LawTable], ...] = tuple(
    StateSpaceTable if law is StateSpaceController else _table_of(word, law) for word, law in LAWS.items()
)
"""The tables of the laws there are."""

ControllerTable: TypeAlias = Annotated[Union[LAW_TABLES], Field(discriminator="law")]  # type: ignore[valid-type] # noqa: UP007


class ParameterTable(Table):
    """[parameters.inertia] and its like: one parameter; a bare number is a value."""

    shorthand = "value"

    value: Number | None = Field(None, description="what the parameter is fixed at")
    start: Number | None = Field(None, description="where the search begins")
    lower: Bound | None = Field(None, description="lower bound")
    upper: Bound | None = Field(None, description="upper bound")
    free: Flag | None = Field(None, description="whether the parameter is identified")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield contradictions between bounds, value, start and free."""
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            yield "lower", f" is {self.lower:g}; expected less than upper = {self.upper:g}: exchange them."
        if self.value is not None and self.free:
            yield "free", f" is true beside value = {self.value:g}, which would fix it; write start = {self.value:g}."
        if self.value is not None and self.start is not None:
            yield "start", " stands beside value; keep value to fix the parameter, or start to identify it."
        if self.value is None and self.free is False:
            yield "value", " is missing; a parameter that is not free needs the value that it keeps: add it."


@keys_from(AxisLimits)
class LimitsTable(Table):
    """[limits]: what the axis may do in a test that is planned, on the side that is reported."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an empty band of frequencies or range of positions."""
        if refused := refusal(self.build):
            yield "highest" if "frequency" in refused else "upper", refused


class FileTable(Table):
    """A joint file."""

    decided_by: ClassVar = {"controller": "law"}

    joint: JointTable = Field(description="what is identified")
    transmission: TransmissionTable | None = Field(None, description="what lies between motor and load")
    gravity: GravityTable | None = Field(None, description="what its load weighs, if that matters")
    ripple: RippleTable | None = Field(None, description="a force that comes back with the position, if there is one")
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
    limits: LimitsTable = Field(
        default_factory=LimitsTable, description="what the axis may do in a test that is planned"
    )
    _wrong: frozenset[Place] = PrivateAttr(default=frozenset())
    _axis: int | None = PrivateAttr(default=None)  # in a robot file, from 0
    _own: Collection[str] = PrivateAttr(default=())  # channels and tables that the axis says itself

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> tuple[Self, list[Fault]]:
        """Return the file without the parts that are wrong, and the faults of these parts.

        The parts that are left can still be checked against each other.

        Args:
            raw: the tables as `tomllib` reads them; they stay as they are.
        """
        kept, wrong, faults = copy.deepcopy(dict(raw)), set[Place](), list[Fault]()
        while True:
            try:
                table = cls.model_validate(kept)
            except ValidationError as error:
                found = faults_of(error)
                faults += [] if wrong else found  # later ones may follow from what is left out
                for part in {_part(fault.place) for fault in found}:
                    wrong.add(part)
                    _leave_out(kept, part)
            else:
                table._wrong = frozenset(wrong)
                return table, faults

    def as_axis(self, number: int, own: Collection[str]) -> Self:
        """Return the table with its faults placed in a robot file.

        Args:
            number: of the axis, from 0.
            own: channels, and [method], that stand below its [[joints]] table and are not shared.
        """
        self._axis, self._own = number, own
        return self

    def place(self, *keys: int | str) -> Place:
        """Return the place of a key in the file of this table."""
        if self._axis is None:
            return keys
        below = ("joints", self._axis)
        match keys:
            case ("joint", *rest):
                return (*below, *rest)
            case ("record", "channels", str() as name, *rest) if name in self._own:
                return (*below, "channels", name, *rest)
            case ("record" | "drive" | "filtering", *_):
                return keys
            case ("method", *_) if "method" not in self._own:
                return keys
        return (*below, *keys)

    def fault(self, place: Place, rest: str, code: str = CONTRADICTION) -> Fault:
        """Return a fault at a place of a joint file, in the file that this table was made from."""
        return fault_at(self.place(*place), rest, code)

    def is_wrong(self, *part: str) -> bool:
        """Return whether a part is in the file, but left out because it is wrong."""
        return part in self._wrong

    @property
    def kinds(self) -> Collection[Kind]:
        """Kinds that the joint may have: one if [joint] is right."""
        return KINDS if self.is_wrong("joint") else (self.joint.kind,)

    @property
    def model(self) -> str | None:
        """Model of the joint; None if [joint] is wrong."""
        return None if self.is_wrong("joint") else self.joint.model

    @property
    def geared(self) -> bool:
        """Whether there is a transmission, right or wrong."""
        return self.transmission is not None or self.is_wrong("transmission")

    def kind_of_side(self, side: str, kind: Kind) -> Kind:
        """Return the kind of motion of a side, for that kind of load: with a lead the motor turns."""
        lead = self.transmission is not None and self.transmission.lead is not None
        return "revolute" if lead and side == "motor" else kind

    @property
    def controlled(self) -> bool:
        """Whether there is a controller, right or wrong."""
        return self.controller is not None or self.is_wrong("controller")

    @property
    def channels(self) -> Mapping[str, ChannelTable]:
        """Channels that are right."""
        found: dict[str, ChannelTable] = self.record.channels.given_values()
        return found

    @property
    def computes_torque(self) -> bool:
        """Whether the torque is computed from the controller and the motor position."""
        channels, drive = self.record.channels, self.drive_of_joint
        named: str | None = self.record.torque
        if named is not None or channels.torque is not None or (drive is not None and drive.traces is not None):
            return named == "from_controller"
        return self.controlled and channels.motor_position is not None and self.method.name in (None, "didim")

    @property
    def drive_of_joint(self) -> Drive | None:
        """Drive with the torque constant of [joint]; None if it is wrong or contradicts the constant."""
        try:
            return None if self.is_wrong("drive") else self.joint.drive(self.drive.build())
        except JointidError:
            return None

    @property
    def channel_names(self) -> Collection[str]:
        """Names of all channels of the file, and of those that the drive's profile may find."""
        drive = self.drive_of_joint
        if drive is None:  # of a drive that is wrong nobody knows which channels its profile finds
            return CHANNELS
        wrong = [str(part[2]) for part in self._wrong if len(part) == _OF_CHANNEL]
        computed = ["torque"] if self.computes_torque else []
        found = [*self.channels, *wrong, *(drive.traces.channels if drive.traces else ()), *computed]
        return tuple(dict.fromkeys(found))


_OF_CHANNEL = len(("record", "channels", "torque"))
_STAND_IN: Mapping[str, Any] = {"joint": {"kind": "revolute"}}  # of a table that is needed


def _part(place: Place) -> Place:
    """Return the part of a joint file that is left out for a fault: a table, a channel or a parameter."""
    match place:
        case ("record", "channels", *_):
            return place[:_OF_CHANNEL]
        case ("record" | "parameters", *_):
            return place[:2]
        case _:
            return place[:1]


def _leave_out(tables: Any, part: Place) -> None:
    *above, key = part
    for name in above:
        tables = tables[name]
    tables.pop(key, None)
    if not above and key in _STAND_IN:
        tables[key] = _STAND_IN[str(key)]


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
