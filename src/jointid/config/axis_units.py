"""Units of an axis: torque constant, gain from a controller's output to torque, and numbers as the drive has them.

The torque constant is given once, below [joint], for the torque's channel and the controller. A drive's own parameters
are known by its profile.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from jointid.common import units
from jointid.common.errors import Fault, JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.transmission import SIDES
from jointid.common.units import Kind
from jointid.config.declaration import TIMES, fault_at, keys_of
from jointid.config.quantities import OUTPUTS, in_controller_units, is_quantity, list_units, misfit, output_of
from jointid.config.rules import Declaration, torque_unit
from jointid.models.controllers import Cascade, Controller, ServoController, declared_unit, numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import Joint
from jointid.records.drives import Drive, load_profile, profile_names

_AGREES = 1e-3  # of a gain: one that is written with four digits is the torque constant
_TIMES = {gain: time for time, (gain, _) in TIMES.items()}


def with_constant(drive: Drive, constant: float | None, text: object) -> Drive:
    """Return a drive with a torque constant, which its unit says to be per A or V; a plain number is per A."""
    if constant is None:
        return drive
    return replace(drive, torque_per_volt=constant) if _per(text) == "V" else replace(drive, torque_constant=constant)


def _per(text: object) -> str:
    return "V" if isinstance(text, str) and "V" in text else "A"


def texts_with_units(raw: Any, before: str = "") -> Iterator[tuple[str, str]]:
    """Yield the texts of numbers that are given with a unit, each after the path of its key."""
    if isinstance(raw, str) and is_quantity(raw):
        yield before, raw
    below = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    for key, value in below:
        yield from texts_with_units(value, f"{before}.{key}" if before else str(key))


def unit_faults(said: Declaration) -> Iterator[Fault]:
    """Yield numbers of joint and controller in units of another motion or output."""
    constant = said.raw["joint"].get("torque_constant")
    if isinstance(constant, str):
        declared = "N/A or N/V" if said.kind_of("motor") == "prismatic" else "N m/A or N m/V"
        if fault := misfit(constant, declared):
            yield said.fault(("joint", "torque_constant"), fault, "unit")
            return
    yield from _channel_faults(said, constant)
    faults = list(_misfits(said))
    yield from faults
    if not faults:
        try:
            controller_gain(said)
        except JointFileError as error:
            yield from error.faults


def _channel_faults(said: Declaration, constant: object) -> Iterator[Fault]:
    """Yield contradictions between the torque constant and the torque's channel."""
    torque, per, unit = said.columns.get("torque"), _per(constant), torque_unit(said)
    if torque is None or constant is None:
        return
    place = ("record", "channels", "torque")
    if unit in ("A", "V") and unit != per:
        rest = f" is in {unit}, but joint.torque_constant is per {per}; expected both in one unit: give the constant "
        yield said.fault(place, f'{rest}of what is logged, as torque_constant = "0.72 N m/{unit}".', "unit")
    known = said.drive.torque_constant or said.drive.torque_per_volt or 1.0
    if torque.gain != 1.0 and torque.unit in TORQUE_UNIT.values() and abs(torque.gain / known - 1) > _AGREES:
        rest = f" is {torque.gain:g} to {torque.unit}, but joint.torque_constant is {known:g}; expected the same: "
        yield said.fault((*place, "gain"), f'{rest}leave gain out and give unit = "{per}", or correct the wrong one.')


def _misfits(said: Declaration) -> Iterator[Fault]:
    """Yield numbers in units of the other kind of motion, and those of two outputs."""
    outputs, kind = dict[str, str](), said.kind_of(said.law_side)
    for name, text, declared in _numbers(said):
        if fault := misfit(text, declared, kind):
            yield said.fault(("controller", name), fault, "unit")
        elif output := output_of(text, declared, kind):
            outputs.setdefault(output, f'{name} = "{text}"')
    if len(outputs) > 1:
        rest = f" has {' and '.join(outputs.values())}: outputs in {' and '.join(outputs)}; take them to one unit."
        yield said.fault(("controller",), rest, "unit")


def _numbers(said: Declaration) -> Iterator[tuple[str, str, str]]:
    """Yield a law's numbers that have a unit: their key, their text, and the unit of their declaration."""
    given, kind = said.raw.get("controller", {}), None if said.law is None else type(said.law)
    for one in keys_of(kind).values() if kind is not None else ():
        if one.type is float and isinstance(given.get(one.name), str):
            yield one.name, given[one.name], one.setting.unit


def controller_gain(said: Declaration) -> float:
    """Return the gain from the controller's output to torque on its side.

    Raises:
        JointFileError: it is not known, or is given twice and differs.
    """
    law, drive = said.law, said.drive
    if law is None:
        return 1.0
    given: float | None = getattr(law, "gain", 1.0) if "gain" in said.raw["controller"] else None
    through = 1.0 if said.gear is None or said.law_side == "motor" else abs(said.gear.motor_per_load)
    kind = said.kind_of(said.law_side)
    found = ((output_of(text, declared, kind), name, text) for name, text, declared in _numbers(said))
    unit, name, text = next((one for one in found if one[0]), (None, "", ""))
    constant = drive.torque_constant or drive.torque_per_volt
    if unit is None:
        known = None if constant is None else constant * through
        speaks_torque = given is not None and (given == 1.0 or _is_share(said, given / through))
    else:
        try:
            known, speaks_torque = _torque_per_output(said, unit, through, given is not None), False
        except units.UnitError as error:
            raise JointFileError(said.fault(("controller", name), f' = "{text}" is {error}.', "unit")) from None
    if given is None:
        return 1.0 if known is None else known
    if known is None or speaks_torque or abs(given / known - 1) <= _AGREES:
        return given
    source = f'controller.{name} = "{text}"' if name else "joint.torque_constant"
    rest = f" is {given:g}, but {source} makes it {known:.6g}; expected the same, or gain = 1 and plain numbers of a "
    raise JointFileError(
        said.fault(("controller", "gain"), f"{rest}controller that speaks N or N m: leave the wrong one out.")
    )


def _torque_per_output(said: Declaration, unit: str, through: float, gain_is_given: bool) -> float | None:
    """Return the torque per unit of the output; None where only the given gain defines it.

    Raises:
        UnitError: nothing takes the output to a torque; the end of the sentence.
    """
    torque = torque_unit(said)
    constants = {"A": said.drive.torque_constant, "V": said.drive.torque_per_volt}
    if unit in constants:
        constant = constants[unit]
        if constant is not None:
            return constant * through
        if not any(constants.values()) and (torque == unit or gain_is_given):
            return through if torque == unit else None
        raise units.UnitError(
            f"an output in {unit}; expected what takes it to a torque: give the joint torque_constant = "
            f'"0.72 N m/{unit}"'
        )
    if torque in ("A", "V"):
        raise units.UnitError(
            f"a torque or a share of it, but the torque's channel is in {torque}; expected what takes it to a torque: "
            f'give the joint torque_constant = "0.72 N m/{torque}"'
        )
    return _share(said) * through if unit == "%" else 1.0


def _share(said: Declaration) -> float:
    """Return the torque of 1 % of the rated torque, on the motor's side."""
    return said.drive.resolve_unit(units.unit("%"), said.kind_of("motor")).factor


def _is_share(said: Declaration, gain: float) -> bool:
    """Return True for the gain of a controller that gives out a share of the rated torque."""
    try:
        return abs(gain / _share(said) - 1) <= _AGREES
    except units.UnitError:
        return False


# Numbers of a controller as the drive shows them


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
    gear, ratio = joint.transmission, getattr(declared, "ratio", 1.0)
    sides = [] if gear is None else [gear.kind_of(side) for side in SIDES if gear.torque(side) == ratio]
    kind = sides[0] if sides else joint.kind
    gains = () if drive.traces is None else drive.traces.gains
    profile = {gain.key: (gain.name, gain.units) for gain in gains}
    output = _output_unit(declared, stated, joint, drive, kind)
    shown = _Shown(learned, declared, keys, stated, kind, output, profile)
    return tuple(one for name in numbers_of(learned) for one in shown.number(name))


def _output_unit(declared: Any, stated: Mapping[str, str], joint: Joint, drive: Drive, kind: Kind) -> str | None:
    """Return the unit of a controller's output: as a number with a unit says, else by its gain."""
    for name in stated.keys() & numbers_of(declared).keys():
        if output := output_of(stated[name], declared_unit(declared, name), kind):
            return output
    gain, gear = getattr(declared, "gain", 1.0), joint.transmission
    if gain == 1.0:
        return joint.torque_unit or TORQUE_UNIT[kind]
    through = 1.0 if gear is None else abs(gear.torque("motor") / declared.ratio)
    constants = {"A": drive.torque_constant, "V": drive.torque_per_volt}
    fits = (unit for unit, c in constants.items() if c is not None and abs(gain / (c * through) - 1.0) <= _AGREES)
    return next(fits, None)


@dataclass(frozen=True, slots=True)
class _Shown:
    """A learned law beside the controller of a joint file, with its given keys and units.

    Attributes:
        learned: the law.
        declared: the file's controller; gains that are not said have stand-ins.
        keys: settings of it that the file gives.
        stated: texts of numbers with their units, by the path of their key.
        kind: how the controller's side moves.
        output: the unit of the controller's output; None where it is not known.
        profile: names and units of the drive's own parameters, by the key that they are.
    """

    learned: Any
    declared: Any
    keys: Collection[str]
    stated: Mapping[str, str]
    kind: Kind
    output: str | None
    profile: Mapping[str, tuple[str, tuple[str, ...]]]

    def number(self, name: str) -> Iterator[DriveNumber]:
        """Yield a number as the drive shows it; nothing if its unit is unknown."""
        known = numbers_of(self.declared) if type(self.declared) is type(self.learned) else {}
        declared = known.get(name) if name.partition(".")[0] in self.keys else None
        owner, _, last = name.rpartition(".")
        there = None
        if (time := self._time(name)) is not None:
            unit, per = self._unit(time, "ms"), "" if isinstance(self.learned, Cascade) else "position_gain"
            second = 1.0 / units.parse_unit(unit).factor
            there = DriveNumber(name, self._label(time), unit, second, name == "integral_gain", per=per)
        elif last == "time_constant" and (cutoff := f"{owner}.cutoff") in self.stated:
            unit = self._unit(cutoff, "Hz")
            there = DriveNumber(name, cutoff, unit, 0.5 / math.pi / units.parse_unit(unit).factor, inverse=True)
        if there is not None:
            yield replace(there, declared=there.of(declared, known)) if declared else there
        else:
            yield from self._plain(name, declared)

    def _plain(self, name: str, declared: float | None) -> Iterator[DriveNumber]:
        """Yield a number that is shown as it is, in another unit."""
        measured = declared_unit(self.learned, name)
        candidates, speaks = list_units(measured, self.kind), in_controller_units(measured)
        if not candidates:  # a share, say
            if declared is not None:
                yield DriveNumber(name, self._label(name), "", 1.0, declared=declared)
            return
        of_outputs = dict(zip(OUTPUTS[self.kind], candidates, strict=True)) if speaks else {}
        unit = self._unit(name, of_outputs.get(self.output or "", "") if speaks else candidates[0])
        one = next((v for c in candidates if unit and (v := units.convert(1.0, unit, c)) is not None), None)
        if one is None:
            return
        power = 0 if "rad" not in measured else -1 if speaks else 1  # of a position in the unit
        factor = abs(self.declared.ratio / self.learned.ratio) ** power / one
        if speaks:
            factor *= abs(self.learned.gain * self.learned.ratio) / abs(self.declared.gain * self.declared.ratio)
        yield DriveNumber(
            name, self._label(name), unit, factor, declared=None if declared is None else declared / one
        )  # fmt: skip

    def _time(self, name: str) -> str | None:
        """Return the key of a time shown instead of a gain; None for the gain.

        Of a cascade it is the time where nothing is declared; of the other laws, which have both, where it is declared.
        """
        time = _TIMES.get(name)
        by_itself = isinstance(self.learned, Cascade) and name not in self.keys
        return time if time in self.keys or by_itself else None

    def _label(self, key: str) -> str:
        """Return the label of a number: the drive's name, if known, and its key."""
        return f"{self.profile[key][0]} {key}" if key in self.profile else key

    def _unit(self, key: str, plain: str) -> str:
        """Return the unit in which the drive shows a number: the joint file's, the profile's, or a plain one."""
        if key in self.stated:
            return units.parse_quantity(self.stated[key])[1]
        choices = self.profile.get(key, ("", ()))[1]
        if not plain:
            return choices[0] if len(choices) == 1 else ""
        return next((unit for unit in choices if units.convert(1.0, unit, plain) is not None), plain)


# Gains by the names and in the units of a drive's parameters


def table_at(raw: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a table of an unchecked file, or an empty one."""
    below = raw.get(key)
    return below if isinstance(below, dict) else {}


def translate_gains(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the tables of a joint file with a drive's gains under the file's own keys.

    A plain number is in the parameter's unit, as the drive shows it; a time of 0, which turns an integral off, is left
    out.

    Args:
        raw: the tables as `tomllib` reads them; they stay as they are.

    Raises:
        JointFileError: a gain is given by both names, or needs its unit.
    """
    profile, controller = table_at(raw, "drive").get("profile"), table_at(raw, "controller")
    if profile not in profile_names() or not controller:
        return raw
    found, faults = dict(controller), list[Fault]()
    for gain in load_profile(profile).gains:
        if gain.name not in controller:
            continue
        value, place = found.pop(gain.name), ("controller", gain.name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if gain.key in found:
            rest = f" is {gain.key}, which stands beside it; expected one of them: leave one out."
            faults.append(fault_at(place, rest, ""))
        elif number and len(gain.units) > 1:
            listed = " or ".join(f'"{value} {unit}"' for unit in gain.units)
            rest = f" is {value}, in a unit that the drive may have set; expected {listed}: add the unit."
            faults.append(fault_at(place, rest, "unit"))
        elif not (number and value == 0 and gain.key.endswith("_time")):
            found[gain.key] = f"{value!r} {gain.units[0]}" if number else value
    if faults:
        raise JointFileError(faults)
    return {**raw, "controller": found}


def keys_of_controller(raw: Mapping[str, Any]) -> set[str]:
    """Return the keys of [controller], with a drive's parameters under the file's own keys."""
    profile, controller = table_at(raw, "drive").get("profile"), table_at(raw, "controller")
    gains = load_profile(profile).gains if profile in profile_names() else ()
    return {*controller, *(gain.key for gain in gains if gain.name in controller)}
