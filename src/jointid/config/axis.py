"""One axis of a file: joint, columns, drive, controller, units and records.

The torque constant is declared once, in [joint], for the torque channel and the controller.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import Fault, JointFileError, JointidError, MethodError
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.text import join
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, UnitError
from jointid.config.declaration import Place, fault_at, locate, output_of, to_si
from jointid.config.tables import Source, Values, make_method
from jointid.estimation.methods import METHODS, Method, method_of
from jointid.models.controllers import Cascade, Controller, declared_unit, numbers_of
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.limits import AxisLimits
from jointid.models.springs import Spring
from jointid.records.checks import check_record
from jointid.records.clock import Cut
from jointid.records.columns import Column, unit_in_name
from jointid.records.drives import Drive, Frame
from jointid.records.formats import Table as RecordedTable
from jointid.records.reading import RecordReader
from jointid.records.record import Record, known_units
from jointid.records.writing import columns_to_write

_AGREES = 1e-3  # relative tolerance of a declared gain, which may be rounded to four digits


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisUnits:
    """Units of an axis's numbers in a file.

    Attributes:
        kind: motion of the load.
        gear: transmission between motor and load.
        drive: with the torque constant.
        torque: unit of the joint's torque: "A", "V", or None for N or N m.
        side: side of the transmission to which the controller's numbers refer.
    """

    kind: Kind = "revolute"
    gear: Transmission | None = None
    drive: Drive = field(default_factory=Drive)
    torque: str | None = None
    side: Side = "motor"

    def kind_of(self, side: Side) -> Kind:
        """Return the kind of motion of a side."""
        return self.kind if self.gear is None else self.gear.kind_of(side)

    @property
    def constant(self) -> float | None:
        """Motor torque per ampere or volt of controller output; None if unknown."""
        return self.drive.torque_constant or self.drive.torque_per_volt

    @property
    def plain_gain(self) -> float:
        """Gain of a controller whose numbers are given without a unit."""
        return 1.0 if self.constant is None else self.constant * self._through

    @property
    def _through(self) -> float:
        """Torque on the controller's side per motor torque."""
        return 1.0 if self.gear is None or self.side == "motor" else abs(self.gear.motor_per_load)

    def find_torque_unit(self, column: Column | None) -> str | None:
        """Return the torque channel's unit if it is "A" or "V", else None."""
        kind = self.kind_of(self.drive.side("torque", column))
        known = known_units("torque", kind)
        stated = None if column is None else column.stated_unit(known)
        if stated not in known:
            return None
        with contextlib.suppress(UnitError):  # the record is refused for it
            unit = self.drive.resolve_unit(units.unit(stated), kind).si
            return None if unit in TORQUE_UNIT.values() else unit
        return None

    def gain(self, law: Controller, given: float | None, texts: Mapping[str, str]) -> tuple[float, str]:
        """Return a controller's gain from output to torque, and its output unit.

        `texts` are its numbers given with a unit, by path of the key.

        Raises:
            JointFileError: the gain is unknown, or the numbers imply different outputs.
        """
        found, kind = dict[str, str](), self.kind_of(self.side)
        for name in (one for one in texts if one in numbers_of(law)):
            if output := output_of(texts[name], declared_unit(law, name), kind):
                found.setdefault(output, name)
        if len(found) > 1:
            rest = f" has outputs in {' and '.join(found)}, as {join(list(found.values()))} say; use one unit."
            raise JointFileError(fault_at(("controller",), rest, "unit"))
        if not found:
            plain = "A" if self.drive.torque_constant else "V" if self.drive.torque_per_volt else ""
            return given or self.plain_gain, plain if given in (None, self.plain_gain) else ""
        ((output, name),) = found.items()
        known = self._torque_per(output)
        if given is None and known is None:
            rest = f" is of an output in {output}; expected its factor to the torque: give the joint a "
            rest += "torque_constant, or the drive its rated_torque."
            raise JointFileError(fault_at(("controller", name), rest, "unit"))
        if given is not None and known is not None and abs(given / known - 1) > _AGREES:
            rest = f" is {given:g}, but {name} makes it {known:.6g}; leave the wrong one out."
            raise JointFileError(fault_at(("controller", "gain"), rest))
        return given or known or 1.0, output

    def _torque_per(self, output: str) -> float | None:
        """Return the torque per unit of an output; None if unknown."""
        with contextlib.suppress(UnitError):  # a share of an undeclared rated torque
            unit = self.drive.resolve_unit(units.unit(output), self.kind_of("motor"))
            fits = unit.si in TORQUE_UNIT.values() if self.torque is None else unit.si == self.torque
            return unit.factor * self._through if fits else None
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One axis of a file: its joint, columns, drive and controller.

    Attributes:
        name: of the joint.
        joint: the model; its torque has the channel's unit, A or V, or is N m or N.
        columns: columns of the channels; the drive's profile finds the others.
        controller: controller referred to the joint through its transmission; None if unknown.
        drive: profile of the traces, and the drive's units.
        source: the file of the record.
        parameters: changed parameters by name, for `identify`.
        limits: test limits of the axis; see `jointid.design`.
        needed: channels that the method reads.
        units: units of the controller's numbers in the file.
    """

    name: str | None
    joint: Joint
    columns: Mapping[str, Column]
    controller: Controller | None = None
    drive: Drive = field(default_factory=Drive)
    source: Source = field(default_factory=Source)
    parameters: Mapping[str, Parameter] = field(default_factory=dict, compare=False)
    limits: AxisLimits = field(default_factory=AxisLimits)
    needed: Collection[str] = field(default=(), compare=False, repr=False)
    units: AxisUnits = field(default_factory=AxisUnits, compare=False, repr=False)

    @property
    def loop(self) -> ClosedLoop | None:
        """The joint with its controller; None without a controller."""
        return None if self.controller is None else ClosedLoop(self.joint, self.controller)

    @property
    def computes_torque(self) -> bool:
        """True if the torque is computed from controller and motor position."""
        logged = "torque" in self.columns or self.drive.traces is not None or self.source.torque == "logged"
        return self.source.torque == "from_controller" or (not logged and self.controller is not None)

    def read_record(self, table: RecordedTable, name: str, *, driving: bool = False) -> Record:
        """Return this axis's record from a table of columns; see `File.record`."""
        columns = self._driving_columns(table.columns) if driving else self.channels
        record = RecordReader(columns, **self.reading).build_record(table, name)
        if driving:
            record.require(("reference",), "a simulation")
            return record
        controller, torque = self.controller, record.torque
        limit = controller.law(torque.sample_time).limit if controller is not None and torque is not None else None
        gear = self.joint.transmission
        check_record(record, limit=limit, side=None if gear is None else gear.side)
        if isinstance(controller, Cascade) and 0.0 < controller.integral_gain * record.duration < 1.0:
            said = f"integral_time is {1 / controller.integral_gain:.3g} s, longer than the record: is it in ms?"
            record = replace(record, remarks=(*record.remarks, said))
        return record

    def _driving_columns(self, there: Collection[str]) -> dict[str, Column]:
        seen = ("torque", "motor_position", "load_position")
        columns = {name: replace(c, optional=True) if name in seen else c for name, c in self.channels.items()}
        added = [one for one in (f"{self.name}.injected", "injected") if one in there]
        if added and "injected" not in columns and self.drive.traces is None:  # present in a designed test
            columns["injected"] = self.column_like("torque", added[0])
        return columns

    def column_like(self, channel: str, name: str) -> Column:
        """Return an undeclared column, with unit and side of a channel."""
        like = self.columns.get(channel, Column())
        unit = like.stated_unit(known_units(channel, self.units.kind_of("motor")))
        return replace(like, column=name, unit=unit, optional=False, timing=None, tap=None, sample_time=None)

    def with_columns_of(self, test: Record, prefix: str = "") -> Axis:
        """Return the axis with the channels and clock of a designed test.

        An undeclared column has the unit of the motor position or of the torque.
        """
        columns, like = dict(self.columns), {"reference": "motor_position", "injected": "torque"}
        for name in test.channels:
            if name not in columns and self.drive.traces is None:
                columns[name] = self.column_like(like.get(name, ""), prefix + name)
        own_clock = self.source.sample_time in (None, next(iter(test.items()))[1].sample_time)
        source = self.source if own_clock else replace(self.source, sample_time=None)
        return replace(self, columns=columns, source=source)

    def columns_to_write(self, record: Record) -> dict[str, FloatArray]:
        """Return the columns that `File.write` writes, by name."""
        source, frame = self.source, Frame(self.drive, self.joint.kind, self.joint.transmission)
        return columns_to_write(record, self.columns, frame, source.time, source.time_unit, source.sample_time)

    @property
    def channels(self) -> dict[str, Column]:
        """Channels to read: needed ones, and optional others."""
        needed = {*self.needed, "injected"}
        if self.computes_torque and self.controller is not None:
            needed |= {"motor_position", *self.controller.channels}
        columns = {n: c if n in needed else replace(c, optional=True) for n, c in self.columns.items()}
        if self.drive.traces is not None:  # let the profile find needed channels that the file does not declare
            unsought = {"injected", "torque"} if self.computes_torque else {"injected"}
            columns |= {n: Column() for n in needed - unsought if n not in columns}
        return columns

    @property
    def reading(self) -> dict[str, Any]:
        """Arguments of `RecordReader` except the columns, of one record."""
        if (source := self.source).parts:
            raise MethodError("record.parts are several tests, and this takes one; give record.start and record.stop.")
        clock = {"time": source.time, "time_unit": source.time_unit, "sample_time": source.sample_time}
        joint = {"drive": self.drive, "kind": self.joint.kind, "transmission": self.joint.transmission}
        cut = Cut(source.start, source.stop, source.part, source.leave_out)
        return {**clock, **joint, "resample": source.resample, "cut": cut}

    def values(self) -> dict[str, float]:
        """Return the joint's parameter values for a simulation: fixed and initial values.

        Raises:
            MethodError: a parameter has no value.
        """
        parameters = [self.parameters.get(p.name, p) for p in self.joint.parameters]
        missing = [p.name for p in parameters if p.start is None]
        if missing:
            raise MethodError(
                f"This needs a value of every parameter; without one: {', '.join(missing)}. Give each a value or a "
                "start in [parameters]; jointid simulate --identified takes them from a record."
            )
        return {p.name: float(p.start) for p in parameters if p.start is not None}


def build_axis(own: Values, kind: Kind, given: Mapping[str, Any]) -> tuple[Axis, Method]:
    """Build an axis and its method from tables of `read_tables`; refuse contradictions.

    `kind` is the load's motion, `given` the keys of [method]; the method's name is chosen if absent.
    """
    at, source, drive, stated = own["at"], own["source"], own["drive"], own["controller"]
    through = own["transmission"]
    gear = None if through is None else _make(at("transmission"), Transmission, load=kind, **through)
    columns = {name: Frame(drive, kind, gear).find_side(name, one) for name, one in own["channels"].items()}
    if own["torque_constant"] is not None:
        per_volt = "V" in own["texts"].get(at("joint", "torque_constant"), "A")[0]
        name = "torque_per_volt" if per_volt else "torque_constant"
        drive = _make(at("drive"), replace, drive, **{name: own["torque_constant"]})
    units = AxisUnits(kind=kind, gear=gear, drive=drive)
    units = replace(units, torque=units.find_torque_unit(columns.get("torque")))
    controller: Any = None
    if stated is not None:
        controller, side, gain = stated
        units = replace(units, side=side)
        below, ratio = at("controller"), {} if gear is None else {"ratio": gear.torque(side)}
        texts = {place[len(below) :]: text for place, (text, _) in own["texts"].items() if place[: len(below)] == below}
        gain, output = _make(at(), units.gain, controller, gain, {".".join(map(str, k)): t for k, t in texts.items()})
        controller = replace(controller, gain=gain, output=output, **ratio)
    joint = _build_joint(own, kind, gear, units.torque)
    axis = Axis(
        name=own["name"],
        joint=joint,
        columns=columns,
        controller=controller,
        drive=drive,
        source=source,
        parameters=_change_parameters(joint, own["parameters"], at("parameters")),
        limits=own["limits"],
        units=units,
    )
    name, model = given.get("name") or _choose_method(axis, own["model"]), own["model"]
    method: Method = _make(at(), make_method, name, given, model)
    if faults := [*_check_units(own, axis), *_check_torque(axis), *_check_runs(own, axis)]:
        raise JointFileError(faults)
    return replace(axis, needed=method.channels(model, controller)), method


def _make(place: Place, make: Callable[..., Any], *arguments: Any, **given: Any) -> Any:
    """Call a function, and locate its faults at a place."""
    try:
        return make(*arguments, **given)
    except JointidError as error:
        raise locate(error, place) from error


def _build_joint(own: Values, kind: Kind, gear: Transmission | None, unit: str | None) -> Joint:
    """Build the joint; its torque has the channel's unit, A or V."""
    weight, place = own["gravity"], own["at"]("joint")
    if weight is not None and gear is not None:
        weight = replace(weight, angle=weight.angle * gear.torque("load"))
    moving, friction = kind if gear is None else gear.kind, Friction(own["friction"])
    forces = (moving, friction, unit, gear, weight, own["ripple"])
    if own["model"] == "flexible":
        made: Joint = _make(place, FlexibleJoint, *forces, Spring(own["spring"] or "linear"))
    elif own["spring"] not in (None, "linear"):
        rest = f' is "{own["spring"]}", but a rigid joint has no spring; set joint.model = "flexible".'
        raise JointFileError(fault_at((*place, "spring"), rest))
    else:
        made = _make(place, RigidJoint, *forces)
    return made


def _choose_method(axis: Axis, model: str) -> str:
    """Return the first default method with all its channels, else DIDIM.

    DIDIM comes first, even with a motor position, which it does not read. It reports missing channels.
    """
    law, found = axis.controller, {*axis.columns}
    found |= {*(() if axis.drive.traces is None else axis.drive.traces.channels)}
    if "motor_position" in axis.columns and axis.computes_torque:
        found.add("torque")
    for method in map(method_of, METHODS):
        ready = {*method.channels(model, law)} <= found and (law is not None or method.simulates != "loop")
        if {ClosedLoop, Joint} & {*method.default_for} and ready:
            return method.name
    return "didim"


def _change_parameters(joint: Joint, stated: Mapping[str, Values], place: Place) -> dict[str, Parameter]:
    """Return the model's parameters with declared values and the tighter bounds."""
    known, changed, faults = {one.name: one for one in joint.parameters}, dict[str, Parameter](), list[Fault]()
    for name, one in stated.items():
        own = known.get(name)
        if own is None:
            rest = f" is no parameter of this joint; expected one of {', '.join(known)}: correct it, or leave it out."
            faults.append(fault_at((*place, name), rest, "unknown"))
            continue
        lower = own.lower if one["lower"] is None else max(one["lower"], own.lower)
        upper = own.upper if one["upper"] is None else min(one["upper"], own.upper)
        numbers = [number for number in (one["value"], one["start"]) if number is not None]
        fits = lower < upper and len(numbers) <= 1 and all(lower <= number <= upper for number in numbers)
        if not fits or not (own.free or one["value"] is not None):
            said = f" has {', '.join(f'{number:g}' for number in numbers) or 'bounds only'}; expected a value"
            said += f"{' or a start' if own.free else ''}, within {lower:g} to {upper:g}: correct it, or its bounds."
            faults.append(fault_at((*place, name), said))
        start = numbers[0] if numbers else own.start
        changed[name] = replace(own, free=own.free and one["value"] is None, start=start, lower=lower, upper=upper)
    if faults:
        raise JointFileError(faults)
    return changed


def _check_units(own: Values, axis: Axis) -> Iterator[Fault]:
    """Yield faults of units of another kind of motion."""
    units, at, texts = axis.units, own["at"], own["texts"]
    kinds = {at("controller"): units.kind_of(units.side), at("limits"): axis.joint.kind}
    for place, (text, declared) in texts.items():
        table = next((table for table in kinds if place[: len(table)] == table), None)
        kind = None if table is None else kinds[table]
        expected = declared
        if place == at("joint", "torque_constant"):
            expected = "N/A or N/V" if units.kind_of("motor") == "prismatic" else "N m/A or N m/V"
        elif kind is None:
            continue
        elif table == at("limits") and "torque" in str(place[-1]):
            expected = units.torque or TORQUE_UNIT[kind]
        try:
            to_si(text, expected, kind)
        except UnitError as error:
            slides = table == at("controller") and kind == "prismatic" and units.gear is None
            yield fault_at(place, f"{str(error)[:-1]}{', or give the lead of the transmission' * slides}.", "unit")


def _check_torque(axis: Axis) -> Iterator[Fault]:
    """Yield faults of torque and injected units that contradict other tables."""
    units, channels = axis.units, ("record", "channels")
    for name, column in axis.columns.items():
        known = known_units(name, units.kind_of(axis.drive.side(name, column)))
        named = None if column.unit is None or column.gain != 1 else unit_in_name(column.column, known)
        if named in known and named != column.stated_unit(known):
            rest = f' is "{column.unit}", but its column names "{named}": leave unit out, or rename the column.'
            yield fault_at((*channels, name, "unit"), rest, "unit")
        other = units.find_torque_unit(column)
        if name == "injected" and column.stated_unit(known) and other != units.torque:
            rest = f" is {other or 'a torque'}, but the torque's {units.torque or 'one'}; give both in one unit."
            yield fault_at((*channels, name, "unit"), rest, "unit")
    if "torque" in axis.columns and axis.source.torque == "from_controller":
        yield fault_at(("record", "torque"), ' is "from_controller" beside a torque channel; keep one of them.')
    per = "A" if axis.drive.torque_constant is not None else "V"
    if units.constant is not None and units.torque not in (None, per):
        rest = f" is in {units.torque}, but joint.torque_constant is per {per}; give the constant of what is logged."
        yield fault_at((*channels, "torque"), rest, "unit")


def _check_runs(own: Values, axis: Axis) -> Iterator[Fault]:
    """Yield faults of unknown parameters of individual records."""
    known = {parameter.name for parameter in axis.joint.parameters}
    for number, run in enumerate(own["records"]):
        if unknown := set(run.own) - known:
            rest = f" has {', '.join(sorted(unknown))}; expected some of {', '.join(sorted(known))}: correct it."
            yield fault_at(("records", number, "own"), rest, "unknown")
