"""Rules between the tables of a file: generators of the faults of one axis.

What a record or a method refuses by itself is no rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from jointid.common.errors import Fault
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.units import UnitError
from jointid.config.declaration import fault_at
from jointid.config.quantities import to_si
from jointid.config.tables import FileTable
from jointid.records.columns import known_units

if TYPE_CHECKING:
    from jointid.config.axis import Axis


def find_faults(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield what the tables of an axis do not agree on."""
    yield from _check_units(file, number, axis)
    yield from _check_torque(file, number, axis)
    parameters = {parameter.name for parameter in axis.joint.parameters}
    for at, run in enumerate(file.records):
        if unknown := set(run.own) - parameters:
            rest = f" has {', '.join(sorted(unknown))}; expected some of {', '.join(sorted(parameters))}: correct it."
            yield fault_at(("records", at, "own"), rest, "unknown")


def _check_units(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield numbers in units of another motion."""
    units, joint = axis.units, axis.joint
    constant, limits = file.place(number, "joint", "torque_constant"), file.place(number, "limits")
    kinds = {file.place(number, "controller"): units.kind_of(units.side), limits: joint.kind}
    for place, (text, declared) in file.texts.items():
        table = next((table for table in kinds if place[: len(table)] == table), None)
        kind = None if table is None else kinds[table]
        expected = declared
        if place == constant:
            expected = "N/A or N/V" if units.kind_of("motor") == "prismatic" else "N m/A or N m/V"
        elif kind is None:
            continue
        elif table == limits and "torque" in str(place[-1]):
            expected = units.torque or TORQUE_UNIT[kind]
        try:
            to_si(text, expected, kind)
        except UnitError as error:
            yield fault_at(place, str(error), "unit")


def _check_torque(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield a torque, or an injected signal, in a unit that the other tables contradict."""
    units, channels = axis.units, ("record", "channels")
    for name, column in axis.columns.items():
        known = known_units(name, units.kind_of(axis.drive.side(name, column)))
        if named := column.doubled_unit(known):
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
