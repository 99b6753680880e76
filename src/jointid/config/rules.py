"""Rules between the tables of a file: functions of one axis, each of which yields faults.

Their places are those of a joint file. What a record or a method refuses by itself is no rule.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from jointid.common.errors import Fault, JointidError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.units import UnitError
from jointid.config.declaration import fault_at
from jointid.config.quantities import to_si
from jointid.config.tables import FileTable
from jointid.models.controllers import numbers_of, with_numbers
from jointid.records.columns import known_units

if TYPE_CHECKING:
    from jointid.config.axis import Axis


def check_units(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield numbers in units of another motion."""
    units, joint = axis.units, axis.joint
    kinds = {"controller": units.kind_of(units.side), "limits": joint.kind}
    for place, (text, declared) in file.texts.items():
        keys = place if file.robot is None else place[2:] if place[:2] == ("joints", number) else ("",)
        kind = kinds.get(str(keys[0]))
        expected = declared
        if keys[-1] == "torque_constant":
            expected = "N/A or N/V" if units.kind_of("motor") == "prismatic" else "N m/A or N m/V"
            keys = ("joint", "torque_constant")
        elif kind is None:
            continue
        elif keys[0] == "limits" and "torque" in str(keys[-1]):
            expected = units.torque or TORQUE_UNIT[kind]
        try:
            to_si(text, expected, kind)
        except UnitError as error:
            yield fault_at(keys, str(error), "unit")


def check_columns(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield units that a column's name contradicts, and an injected signal in another unit than the torque."""
    for name, column in axis.columns.items():
        place = ("record", "channels", name, "unit")
        known = known_units(name, axis.units.kind_of(axis.drive.side(name, column)))
        if named := column.doubled_unit(known):
            rest = f' is "{column.unit}", but its column names "{named}": leave unit out, or rename the column.'
            yield fault_at(place, rest, "unit")
        other = axis.units.find_torque_unit(column)
        if name == "injected" and column.stated_unit(known) and other != axis.units.torque:
            rest = f" is {other or 'a torque'}, but the torque's {axis.units.torque or 'one'}; give both in one unit."
            yield fault_at(place, rest, "unit")


def check_torque(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield a torque that is logged and computed, and one in another unit than the torque constant is per."""
    if "torque" in axis.columns and axis.source.torque == "from_controller":
        yield fault_at(("record", "torque"), ' is "from_controller" beside a torque channel; keep one of them.')
    per = "A" if axis.drive.torque_constant is not None else "V"
    if axis.units.constant is not None and axis.units.torque not in (None, per):
        rest = f" is in {axis.units.torque}, but joint.torque_constant is per {per}; give the constant of what is "
        yield fault_at(("record", "channels", "torque"), f'{rest}logged, as "0.72 N m/{axis.units.torque}".', "unit")


def check_records(file: FileTable, number: int, axis: Axis) -> Iterator[Fault]:
    """Yield unknown parameters and impossible controller numbers of the records."""
    parameters = {parameter.name for parameter in axis.joint.parameters}
    known = {*numbers_of(axis.controller), "period"} if axis.controller is not None else set[str]()
    for at, run in enumerate(file.records):
        if unknown := set(run.own) - parameters:
            rest = f" has {', '.join(sorted(unknown))}; expected some of {', '.join(sorted(parameters))}: correct it."
            yield fault_at(("records", at, "own"), rest, "unknown")
        if unknown := run.controller.keys() - known:
            rest = f" has {', '.join(sorted(unknown))}; expected numbers of [controller], {', '.join(sorted(known))}."
            yield fault_at(("records", at, "controller"), rest)
        elif axis.controller is not None:
            try:
                with_numbers(axis.controller, run.controller)
            except JointidError as error:
                yield fault_at(("records", at, "controller"), f": {error}")


RULES: tuple[Callable[[FileTable, int, Axis], Iterator[Fault]], ...] = (
    check_units,
    check_columns,
    check_torque,
    check_records,
)
"""What the tables of a file have to agree on."""
