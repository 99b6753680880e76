"""The tables of a joint file: the record, the joint, its controller and how it is identified.

Each declares the keys of its own beside the settings of the object that it describes, and builds that object.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, replace
from functools import partial
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from jointid.common import messages, units
from jointid.common.errors import Fault, JointidError, MethodError
from jointid.common.settings import Declared, Setting, setting, settings_of
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, units_of
from jointid.config.quantities import Stated
from jointid.config.source import Run, Source, Together
from jointid.config.table import CONTRADICTION, Place, Reader, Table, fault_at, merge_settings, part, refusal, required
from jointid.estimation.methods.registry import ROBOT, Method, MethodName, method_of, methods
from jointid.models.controllers import FILTERS, LAWS, Controller, DigitalFilter, Filter, StateSpaceController, as_filter
from jointid.models.disturbances import Drift, Effect
from jointid.models.friction import FRICTIONS, find_friction
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.limits import AxisLimits
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.models.springs import SPRINGS, LinearSpring, find_spring
from jointid.records.columns import Column
from jointid.records.drives import Drive
from jointid.records.formats import TextOptions, format_of
from jointid.records.record import CHANNELS, Channel, Injection
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


_OF_ONE = ("tap", "at", "in_torque")  # settings of a column that one channel alone has


class ChannelTable(Table):
    """[record.channels.reference] and its like: the column of one channel."""

    of = (Column,)
    without: ClassVar[Collection[str]] = _OF_ONE

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a clock that is given twice."""
        if self.time is not None and self.sample_time is not None:
            yield "time", f' is "{self.time}" beside sample_time = {self.sample_time:g}; keep one of them.'


class TorqueTable(ChannelTable):
    """[record.channels.torque]."""

    without = ("at", "in_torque")


class InjectedTable(ChannelTable):
    """[record.channels.injected]: a known signal added to the controller's output."""

    without = ("tap",)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an impossible injection."""
        yield from super().faults()
        any_signal = Channel(np.zeros(1), "N", 1.0)
        if refused := refusal(lambda: Injection(any_signal, self.build().at, self.in_torque)):
            yield "in_torque", refused


class ChannelsTable(Table):
    """[record.channels]: where the record's channels are found."""

    tolerant = True

    torque: TorqueTable | None = setting(None, "motor torque or force")
    reference: ChannelTable | None = setting(None, "commanded position, motor side")
    reference_velocity: ChannelTable | None = setting(None, "commanded velocity")
    motor_position: ChannelTable | None = setting(None, "motor encoder")
    load_position: ChannelTable | None = setting(None, "load encoder")
    injected: InjectedTable | None = setting(None, "known signal added to the controller's output")

    def build(self) -> dict[str, Column]:
        """Return the columns of the channels."""
        return self.settings()


class RecordTable(Table):
    """[record]: the file of the record, and how it is read."""

    of = (Source,)
    tolerant = True

    delimiter: str | None = setting(
        None,
        'character between the cells of a text file; " " is any run of blanks; without it found',
        accept=lambda mark: TextOptions(delimiter=mark),
    )
    decimal: Literal[".", ","] | None = setting(None, "decimal mark of a text file; without it found")
    header: bool | None = setting(
        None, "whether a line above the numbers of a text file names the columns; without it found"
    )
    channels: ChannelsTable = part(ChannelsTable, "where the channels are found")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an option that the file's format does not have."""
        if self.file is not None and self.files:
            yield "files", f' stands beside file = "{self.file}"; keep one of them.'
        for file in self.files or ():
            if refused := refusal(partial(format_of, file, **self.options())):
                yield "files", refused
        if self.offsets and len(self.offsets) != len(self.files or ()):
            said = f"{len(self.offsets)} numbers for {len(self.files or ())} files"
            yield "offsets", f" has {said}; give one for each file, or none."
        if self.file is not None and (refused := refusal(partial(format_of, self.file, **self.options()))):
            yield "file", refused

    def options(self) -> dict[str, Any]:
        """Return the options of the format's reader that are given."""
        return {key: value for key, value in self.given.items() if key in _OPTIONS}

    def build(self) -> Source:
        """Return the file of the record, and how it is read."""
        options = self.options()
        return Source(**self.settings("channels", *options), options=options)


_OPTIONS = ("delimiter", "decimal", "header")  # of the format's reader


class DriveTable(Table):
    """[drive]: whose traces the record is made of, and the numbers behind the drive's own units."""

    of = (Drive,)
    without = ("torque_constant", "torque_per_volt")
    ambiguous: ClassVar = {
        "torque_constant": " is said once, for torque and controller: write it below [joint], as "
        'torque_constant = "0.72 N m/A".'
    }


class RunTable(Table):
    """[[records]]: one of several records that are identified together, and what is known to differ in it."""

    of = (Run,)


class TogetherTable(Table):
    """[together]: how several records are identified together."""

    of = (Together,)


class JointTable(Table):
    """[joint]: what is identified."""

    kind: Kind = required("how the joint moves: m and N, or rad and N m")
    model: Literal["rigid", "flexible"] = setting("rigid", "one inertia, or two joined by a spring")
    friction: str = setting("symmetric", "the friction's law", accept=find_friction, choices=tuple(FRICTIONS))
    spring: str = setting("linear", "the spring's law, of a flexible joint", accept=find_spring, choices=tuple(SPRINGS))
    name: str | None = setting(None, "what reports call the joint")
    torque_constant: float | None = setting(
        None,
        "of the motor or its amplifier, on the motor's side: takes a torque in A or V, and the output of a "
        "controller in A or V, to N m or N; a plain number is per A",
        unit="N/A, N m/A, N/V or N m/V",
        above=0,
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


class GravityTable(Table):
    """[gravity]: what the load weighs."""

    of = (Gravity,)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an impossible gravity."""
        if refused := refusal(self.gravity):
            yield "angle", refused

    def gravity(self, transmission: Transmission | None = None) -> Gravity:
        """Return the gravity, as a joint has it on its side of the transmission."""
        angle = self.angle if transmission is None else self.angle * transmission.torque("load")
        return Gravity(**self.settings("angle"), angle=angle)


class RippleTable(Table):
    """[ripple]: a force that comes back with the position, simulated and identified with the joint."""

    of = (PositionHarmonics,)

    period: float = required(
        "of the first harmonic, such as the pitch of a screw or of the motor's slots, on the side that is reported "
        "[m or rad]",
        above=0,
    )


class TransmissionTable(Table):
    """[transmission]: what lies between motor and load, without loss."""

    of = (Transmission,)
    without = ("load",)

    lead: float | None = setting(
        None,
        "how far a prismatic load goes in one turn of the motor: of a screw, a rack or a belt; the motor is revolute "
        "then, and a plain number is in lead_unit",
        unit="m",
        above=0,
    )
    lead_unit: str = setting("m", "unit of the lead", choices=units_of("length"))

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of a missing or double ratio and lead."""
        if self.ratio is None and self.lead is None:
            yield "", " has neither ratio nor lead; expected one of them: add it."
        elif self.ratio is not None and self.lead is not None:
            yield "lead", f" is {self.lead:g} beside ratio = {self.ratio:g}; expected one of them: leave one out."
        elif "lead_unit" in self.given and (self.lead is None or isinstance(self.lead, Stated)):
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


class FilteringTable(Table):
    """[filtering]: how torque and columns are filtered, position and decimation each with its cut-off."""

    of = (Filtering,)

    preset: Literal["default", "published", "as-printed"] | None = setting(
        None, "all of it at once, in place of the other keys"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the keys beside a preset."""
        if self.preset is not None:
            for key in self.settings("preset"):
                yield key, " is set by the preset, too: leave one of them out."

    def build(self) -> Any:
        """Return the filtering."""
        return super().build() if self.preset is None else FILTERINGS[self.preset]()


class MethodTable(Table):
    """[method]: how the joint, or the robot, is identified; some keys are for one of them only."""

    of = tuple(methods())

    name: MethodName | None = setting(
        None,
        "by which method; without it that of a joint is didim if the record has what it needs, else idim; "
        "that of a robot is didim without a motor_position, drive_side with one and a spring, else idim",
    )
    harmonics: int = setting(0, "of idim: harmonics of the force over the motor position", at_least=0)
    period: float | None = setting(
        None,
        "of idim: of the first harmonic, on the side that is reported; needed beside harmonics [m or rad]",
        above=0,
    )
    drift: Literal["force", "viscous", "both"] | None = setting(None, "of idim: what changes linearly in time")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a period of no harmonics, and harmonics of no period."""
        if self.period is None and self.harmonics > 0:
            yield "period", " is missing; expected a positive number (of the first harmonic, in m or rad)."
        if self.period is not None and self.harmonics == 0:
            yield "period", f" is {self.period:g}, but there are no harmonics; add harmonics = 1, or leave it out."

    def effects(self) -> tuple[Effect, ...]:
        """Return the further columns of a regression."""
        ripple = () if self.period is None else (PositionHarmonics(self.period, self.harmonics),)
        return (*ripple, *(() if self.drift is None else (Drift(self.drift),)))

    def method(self, name: str) -> Method:
        """Return the method of that name with these settings."""
        made: Any = method_of(name)
        given = self.settings("name", *EFFECTS)
        for one in settings_of(made):
            if one.setting.none and given.get(one.name) == one.setting.none:
                given[one.name] = None
        if has_effects(made):
            given["effects"] = self.effects()
        method: Method = made(**given)
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
    return (*settings, *(EFFECTS if has_effects(method) else ()))


class FilterTable(Table):
    """[controller.velocity_filter], and each of torque_filters: a filter; a bare list is a numerator."""

    shorthand = "numerator"

    kind: Literal[*FILTERS] | None = setting(  # type: ignore[valid-type]
        None, "which filter; it may be left out where the other keys are those of one kind alone"
    )
    cutoff: float | None = setting(
        None,
        "of first_order: 1 / (2 pi time_constant), in place of it; of second_order: its frequency",
        unit="Hz",
        above=0,
    )

    @classmethod
    def declare(cls) -> dict[str, Declared]:
        """Return the keys of all kinds, each optional."""
        of_kinds: dict[str, list[Declared]] = {}
        kinds: Mapping[str, Any] = FILTERS
        for kind, owner in kinds.items():
            for one in settings_of(owner):
                described = replace(one.setting, help=f"of {kind}: {one.setting.help}")
                optional = replace(one, setting=described, default=None, optional=True)
                of_kinds.setdefault(one.name, []).append(optional)
        return {**super().declare(), **{name: merge_settings(same) for name, same in of_kinds.items()}}

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield missing keys, keys of another kind of filter, and an impossible filter."""
        meant = self._meant()
        if self.kind is None and len(meant) > 1:
            yield "kind", messages.missing(messages.either(meant), "which filter")
            return
        kind = meant[0]
        known = fields(FILTERS[kind])
        given, names = self._settings_of_kind(kind), [field.name for field in known]
        foreign = [key for key in given if key not in names]
        for key in foreign:
            yield key, messages.describe_unknown_name(key, names)
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
        return made.numerator if isinstance(made, DigitalFilter) and len(self.given) == 1 else made


_CUTOFFS = {"first_order": "time_constant", "second_order": "frequency"}
"""The setting of each kind of filter that a cut-off frequency gives."""

_MEANT_ONE = {
    "kp": "velocity_gain for the Kp of a speed loop, position_gain for the kp of a position controller",
    "kv": "position_gain for the Kv of a position loop, velocity_gain for the kv of the paper",
    "ki": 'integral_gain, or integral_time = "6 ms" for a Tn',
    "kd": 'derivative_gain, or derivative_time = "2 ms" for a Td',
    **dict.fromkeys(("tn", "ti"), 'integral_time = "6 ms"'),
    **dict.fromkeys(("td", "tv"), 'derivative_time = "2 ms"'),
}

AMBIGUOUS: Mapping[str, str] = {
    spelt: f" is another number on each drive; expected {meant}: write the one that is meant."
    for name, meant in _MEANT_ONE.items()
    for spelt in (name, name.capitalize(), name.upper())
}
"""Names of gains with another meaning on each drive, with the rest of the sentence."""


class LawTable(Table):
    """[controller]: which law it is, and the side of its numbers."""

    decided_by = "law"
    ambiguous = AMBIGUOUS

    law: str = required("the controller's law", choices=tuple(LAWS))
    side: Side = setting("motor", "of the transmission, in whose positions and torque the law's numbers are")

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

    without = ("ratio",)
    variants: ClassVar = {}

    @classmethod
    def declare(cls) -> dict[str, Declared]:
        """Return the keys of the law, with the times that say its gains."""
        found = {**super().declare()}
        for name, kind in (("velocity_filter", FilterTable), ("torque_filters", tuple[FilterTable, ...])):
            found[name] = replace(found[name], type=kind)
        expected = "a list of filters, each a table or the list of a numerator"
        filters = found["torque_filters"]
        found["torque_filters"] = replace(filters, setting=replace(filters.setting, expected=expected))
        for (law, time), meaning in _MEANT.items():
            if LAWS[law] in cls.of:
                gain = found[TIMES[time][0]]
                found[time] = Declared(time, float, True, None, Setting(meaning, unit="s", above=0))
                found[gain.name] = replace(gain, default=None if gain.required else gain.default)
        return found

    def settings(self, *without: str) -> dict[str, Any]:
        """Return the settings of the law."""
        found = super().settings("law", "side", "velocity_filter", "torque_filters", *without)
        for time, (gain, made) in TIMES.items():
            if time in found:
                found[gain] = made(found.pop(time), found["position_gain"] if self.law != "cascade" else 1.0)
        if "velocity_filter" in self.given:
            found["velocity_filter"] = self.velocity_filter.filter()
        if "torque_filters" in self.given:
            found["torque_filters"] = tuple(as_filter(one.filter()) for one in self.torque_filters)
        return found

    def controller(self) -> Controller:
        """Return the controller."""
        made: Controller = LAWS[self.law](**self.settings())
        return made

    @classmethod
    def find_missing(cls, given: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield required gains that are given neither as a gain nor as a time, and other missing keys."""
        yield from super().find_missing(given)
        (law,) = cls.of
        needed = {one.name for one in settings_of(law) if one.required}
        for time, (gain, _) in TIMES.items():
            if time in cls.declared() and gain in needed and not {time, gain} & set(given):
                yield gain, cls.lacks(gain).removesuffix(": add it.") + f": add it, or {time}."

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield gains given twice, also as a time."""
        twice = [(time, gain) for time, (gain, _) in TIMES.items() if {time, gain} <= set(self.given)]
        for time, gain in twice:
            yield time, f" = {getattr(self, time):g} s stands beside {gain}, which says the same: leave one out."
        if not twice:
            yield from super().faults()


class StateSpaceTable(LawTable):
    """[controller] with law = "state_space": any discrete linear law."""

    of = (StateSpaceController,)
    without = ("ratio", "reference_delay")
    variants: ClassVar = {}

    A: tuple[tuple[float, ...], ...] = required(
        "how the states go on: n rows of n numbers", expected="a list of rows, each a list of numbers"
    )
    B: Mapping[str, tuple[float, ...]] = required(
        "how each input moves the states: n numbers for reference, reference_velocity, position and excess, which is "
        "what the limit cut off; one that is left out is 0",
        expected="a table of lists of numbers",
    )
    C: tuple[float, ...] = required("output row: n numbers", expected="a list of numbers")
    D: Mapping[str, float] = required(
        "direct gain of each input: a number for reference, reference_velocity and position, usually negative; one "
        "that is left out is 0",
        expected="a table of numbers",
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield faults of the shapes."""
        if len({len(row) for row in self.A}) > 1:
            lengths = ", ".join(str(len(row)) for row in self.A)
            yield "A", f" has rows of {lengths} numbers; expected rows of one length: complete them."
        else:
            yield from super().faults()

    def controller(self) -> StateSpaceController:
        """Return the controller."""
        return StateSpaceController(**self.settings("law", "side"))


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


def _table_of_law(law: type[Controller]) -> type[LawTable]:
    """Return the table of a law."""
    if law is StateSpaceController:
        return StateSpaceTable
    return type(f"{law.__name__}Table", (BlockDiagramTable,), {"of": (law,), "__module__": __name__})


LawTable.variants = {word: _table_of_law(law) for word, law in LAWS.items()}


class ParameterTable(Table):
    """[parameters.inertia] and its like: one parameter; a bare number is a value."""

    shorthand = "value"

    value: float | None = setting(None, "what the parameter is fixed at")
    start: float | None = setting(None, "where the search begins")
    lower: float | None = setting(None, "lower bound", infinite=True, expected="a number, inf or -inf")
    upper: float | None = setting(None, "upper bound", infinite=True, expected="a number, inf or -inf")
    free: bool | None = setting(None, "whether the parameter is identified")

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


class LimitsTable(Table):
    """[limits]: what the axis may do in a test that is planned, on the side that is reported."""

    of = (AxisLimits,)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an empty band of frequencies or range of positions."""
        if refused := refusal(self.build):
            yield "highest" if "frequency" in refused else "upper", refused


class FileTable(Table):
    """A joint file."""

    tolerant = True

    joint: JointTable = required("what is identified")
    transmission: TransmissionTable | None = setting(None, "what lies between motor and load")
    gravity: GravityTable | None = setting(None, "what its load weighs, if that matters")
    ripple: RippleTable | None = setting(None, "a force that comes back with the position, if there is one")
    record: RecordTable = part(RecordTable, "the file of the record, and its channels")
    drive: DriveTable = part(DriveTable, "whose traces they are, and its own units")
    controller: LawTable | None = setting(None, "the controller's law, if it is known")
    filtering: FilteringTable = part(FilteringTable, "how signals are filtered")
    method: MethodTable = part(MethodTable, "how the joint is identified")
    parameters: Mapping[str, ParameterTable] = part(dict, "what is known of the parameters, by name")
    records: tuple[RunTable, ...] = setting(
        (), "records that are identified together", expected="one [[records]] table for each record"
    )
    together: TogetherTable = part(TogetherTable, "how several records are identified together")
    limits: LimitsTable = part(LimitsTable, "what the axis may do in a test that is planned")

    wrong: Collection[Place] = ()
    _axis: int | None = None  # in a robot file, from 0
    _own: Collection[str] = ()  # channels and tables that the axis says itself

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> tuple[FileTable, list[Fault]]:
        """Return the file without the parts that are wrong, and the faults of these parts.

        The parts that are left can still be checked against each other.
        """
        reader = Reader()
        table = reader.read(cls, raw)
        table.wrong = reader.wrong
        if table.is_wrong("joint"):
            table.joint = JointTable({"kind": "revolute"})
        return table, reader.faults

    def as_axis(self, number: int, own: Collection[str]) -> FileTable:
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
        return part in self.wrong

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
        return self.record.channels.given

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
        wrong = [str(at[2]) for at in self.wrong if at[:2] == ("record", "channels") and len(at) > 2]
        computed = ["torque"] if self.computes_torque else []
        found = [*self.channels, *wrong, *(drive.traces.channels if drive.traces else ()), *computed]
        return tuple(dict.fromkeys(found))
