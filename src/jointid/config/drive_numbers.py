"""The numbers of a controller as the drive shows them: units, names and values."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from jointid.common import units
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.transmission import SIDES
from jointid.common.units import Kind
from jointid.config.controller_gain import AGREES
from jointid.config.quantities import OUTPUTS, in_controller_units, list_units, output_of
from jointid.config.schema import TIMES
from jointid.models.controllers import Cascade, Controller, ServoController, declared_unit, numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import Joint
from jointid.records.drives import Drive

_TIMES = {gain: time for time, (gain, _) in TIMES.items()}


@dataclass(frozen=True, slots=True)
class _Said:
    """The controller of a joint file, with its given keys and units.

    Attributes:
        controller: as declared; gains that are not said have stand-ins.
        keys: settings of it that the file gives.
        stated: texts of numbers with their units, by the path of their key below [controller].
        kind: how the controller's side moves.
        output: the unit of the controller's output; None where it is not known.
        profile: names and units of the drive's own parameters, by the key that they are.
    """

    controller: Any
    keys: Collection[str]
    stated: Mapping[str, str]
    kind: Kind
    output: str | None
    profile: Mapping[str, tuple[str, tuple[str, ...]]]


def drive_numbers(
    learned: Controller,
    declared: Controller | None,
    keys: Collection[str],
    stated: Mapping[str, str],
    joint: Joint,
    drive: Drive,
) -> tuple[DriveNumber, ...]:
    """Return how the drive shows the numbers of a learned law.

    Args:
        learned: the law, on the joint's side or on that of the declared one.
        declared: the controller of the joint file, whose side, gain and units are the drive's.
        keys: settings of it that the file gives.
        stated: texts of numbers with their units, by the path of their key below [controller].
        joint: with its transmission.
        drive: its torque constant, and the profile with its parameters' names.
    """
    if not isinstance(declared, ServoController) or not isinstance(learned, ServoController):
        return ()
    kind = _kind(joint, getattr(declared, "ratio", 1.0))
    gains = () if drive.traces is None else drive.traces.gains
    profile = {gain.key: (gain.name, gain.units) for gain in gains}
    said = _Said(declared, keys, stated, kind, _output(declared, stated, joint, drive, kind), profile)
    return tuple(one for name in numbers_of(learned) for one in _convert_number(learned, name, said))


def _kind(joint: Joint, ratio: float) -> Kind:
    """Return the kind of motion of the controller's side, found by its ratio."""
    gear = joint.transmission
    if gear is None:
        return joint.kind
    return next((gear.kind_of(side) for side in SIDES if gear.torque(side) == ratio), joint.kind)


def _output(declared: Any, stated: Mapping[str, str], joint: Joint, drive: Drive, kind: Kind) -> str | None:
    """Return the unit of a controller's output: as a number with a unit says, else by its gain."""
    for name in stated.keys() & numbers_of(declared).keys():
        if output := output_of(stated[name], declared_unit(declared, name), kind):
            return output
    gain, gear = getattr(declared, "gain", 1.0), joint.transmission
    if gain == 1.0:
        return joint.torque_unit or TORQUE_UNIT[kind]
    through = 1.0 if gear is None else abs(gear.torque("motor") / declared.ratio)
    for constant, unit in ((drive.torque_constant, "A"), (drive.torque_per_volt, "V")):
        if constant is not None and abs(gain / (constant * through) - 1.0) <= AGREES:
            return unit
    return None


def _convert_number(learned: Any, name: str, said: _Said) -> Iterator[DriveNumber]:
    """Yield a number as the drive shows it; nothing if its unit is unknown."""
    known = numbers_of(said.controller) if type(said.controller) is type(learned) else {}
    declared = known.get(name) if name.partition(".")[0] in said.keys else None
    if (time := _time_of(learned, name, said)) is not None:
        unit, inverse = _unit_in_drive(time, "ms", said), name == "integral_gain"
        per = "" if isinstance(learned, Cascade) else "position_gain"
        second = 1.0 / units.parse_unit(unit).factor
        there = DriveNumber(name, _label(time, said), unit, second, inverse, per=per)
        yield replace(there, declared=there.of(declared, known)) if declared else there
        return
    if (cutoff := _cutoff_of(name)) in said.stated:
        unit = _unit_in_drive(cutoff, "Hz", said)
        there = DriveNumber(name, cutoff, unit, 0.5 / math.pi / units.parse_unit(unit).factor, inverse=True)
        yield replace(there, declared=there.of(declared, known)) if declared else there
        return
    measured = declared_unit(learned, name)
    candidates, speaks = list_units(measured, said.kind), in_controller_units(measured)
    if not candidates:  # a share, say
        if declared is not None:
            yield DriveNumber(name, _label(name, said), "", 1.0, declared=declared)
        return
    plain = dict(zip(OUTPUTS[said.kind], candidates, strict=True)).get(said.output or "") if speaks else candidates[0]
    unit = _unit_in_drive(name, plain or "", said)
    one = next((v for c in candidates if unit and (v := units.Quantity(1.0, unit).matching(c)) is not None), None)
    if one is None:
        return
    factor = abs(said.controller.ratio / learned.ratio) ** _power(measured) / one
    if speaks:
        factor *= abs(learned.gain * learned.ratio) / abs(said.controller.gain * said.controller.ratio)
    yield DriveNumber(name, _label(name, said), unit, factor, declared=None if declared is None else declared / one)


def _time_of(learned: Any, name: str, said: _Said) -> str | None:
    """Return the key of a time shown instead of a gain; None for the gain.

    Of a cascade it is the time where nothing is declared; of the other laws, which have both, where it is declared.
    """
    time = _TIMES.get(name)
    by_itself = isinstance(learned, Cascade) and name not in said.keys
    return time if time in said.keys or by_itself else None


def _cutoff_of(name: str) -> str:
    """Return the key of a filter's cut-off, shown instead of its time constant."""
    owner, _, last = name.rpartition(".")
    return f"{owner}.cutoff" if last == "time_constant" else ""


def _label(key: str, said: _Said) -> str:
    """Return the label of a number: the drive's name, if known, and its key."""
    return f"{said.profile[key][0]} {key}" if key in said.profile else key


def _unit_in_drive(key: str, plain: str, said: _Said) -> str:
    """Return the unit in which the drive shows a number: the joint file's, the profile's, or a plain one."""
    if (text := said.stated.get(key)) is not None:
        return units.parse_quantity(text).unit
    choices = said.profile.get(key, ("", ()))[1]
    if not plain:
        return choices[0] if len(choices) == 1 else ""
    return next((unit for unit in choices if units.Quantity(1.0, unit).matching(plain) is not None), plain)


def _power(measured: str) -> int:
    """Return the power of a position in the unit that a setting declares."""
    if "rad" not in measured:
        return 0
    return -1 if in_controller_units(measured) else 1
