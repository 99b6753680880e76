"""Units of an axis: torque constant, gain from a controller's output to torque, and numbers as the drive has them.

The torque constant is given once, below [joint], for the torque's channel and the controller. A drive's own parameters
are known by its profile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from jointid.common import units
from jointid.common.errors import JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import join
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, UnitError
from jointid.config.declaration import fault_at
from jointid.config.quantities import OUTPUTS, in_controller_units, list_units, output_of
from jointid.models.controllers import Cascade, Controller, ServoController, declared_unit, numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.records.columns import Column, known_units
from jointid.records.drives import Drive

_AGREES = 1e-3  # of a gain: one that is written with four digits is the torque constant
_TIMES = {"integral_gain": "integral_time", "derivative_gain": "derivative_time"}


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisUnits:
    """Units in which a file gives the numbers of an axis.

    Attributes:
        kind: how the load moves.
        gear: between motor and load.
        drive: with the torque constant.
        torque: unit of the torque's channel as the joint has it: "A", "V", or None for N or N m.
        side: of the controller's numbers.
        keys: of [controller] that the file gives, and the gains that they say in other words.
        texts: of numbers of the controller that are given with a unit, by the path of their key.
    """

    kind: Kind = "revolute"
    gear: Transmission | None = None
    drive: Drive = field(default_factory=Drive)
    torque: str | None = None
    side: Side = "motor"
    keys: frozenset[str] = frozenset()
    texts: Mapping[str, str] = field(default_factory=dict)

    def kind_of(self, side: Side) -> Kind:
        """Return the kind of motion of a side."""
        return self.kind if self.gear is None else self.gear.kind_of(side)

    @property
    def constant(self) -> float | None:
        """The torque constant: torque per plain number of a controller on the motor's side."""
        return self.drive.torque_constant or self.drive.torque_per_volt

    @property
    def _through(self) -> float:
        """The torque on the controller's side per torque of the motor."""
        return 1.0 if self.gear is None or self.side == "motor" else abs(self.gear.motor_per_load)

    def find_torque_unit(self, column: Column | None) -> str | None:
        """Return the unit of the torque's channel for `torque`; None also for one that is not known."""
        kind = self.kind_of(self.drive.side("torque", column))
        known = known_units("torque", kind)
        stated = None if column is None else column.stated_unit(known)
        if stated not in known:
            return None
        try:
            unit = self.drive.resolve_unit(units.unit(stated), kind).si
        except UnitError:  # the record is refused for it
            return None
        return None if unit in TORQUE_UNIT.values() else unit

    def gain(self, law: Controller) -> float:
        """Return the gain from a controller's output to torque on its side.

        Raises:
            JointFileError: it is not known, or its numbers are of different outputs.
        """
        given: float | None = getattr(law, "gain", 1.0) if "gain" in self.keys else None
        outputs = self._outputs(law)
        if len(outputs) > 1:
            rest = f" has outputs in {' and '.join(outputs)}, as {join(list(outputs.values()))} say; use one unit."
            raise JointFileError(fault_at(("controller",), rest, "unit"))
        for output, name in outputs.items():
            known = self._torque_per_output(output, name, given is not None)
            if given is not None and known is not None and abs(given / known - 1) > _AGREES:
                rest = f" is {given:g}, but {name} makes it {known:.6g}; leave the wrong one out."
                raise JointFileError(fault_at(("controller", "gain"), rest))
            return given or known or 1.0
        return given or (1.0 if self.constant is None else self.constant * self._through)

    def _outputs(self, law: Any) -> dict[str, str]:
        """Return the units of a controller's output, each with a number that says it."""
        found, kind = dict[str, str](), self.kind_of(self.side)
        for name in (one for one in self.texts if one in numbers_of(law)):
            if output := output_of(self.texts[name], declared_unit(law, name), kind):
                found.setdefault(output, name)
        return found

    def _torque_per_output(self, output: str, name: str, gain_is_given: bool) -> float | None:
        """Return the torque per unit of the output; None where only the given gain defines it."""
        constants = {"A": self.drive.torque_constant, "V": self.drive.torque_per_volt}
        if output not in constants and self.torque is None:
            try:
                return self._through * (self._share() if output == "%" else 1.0)
            except UnitError as error:
                raise JointFileError(fault_at(("controller", name), f" is {error}.", "unit")) from None
        if output in constants and (constant := constants[output]) is not None:
            return constant * self._through
        if output in constants and self.constant is None and (self.torque == output or gain_is_given):
            return self._through if self.torque == output else None
        rest = f" is of an output in {output}; expected what takes it to the torque: give the joint "
        unit = output if output in constants else self.torque
        raise JointFileError(fault_at(("controller", name), f'{rest}torque_constant = "0.72 N m/{unit}".', "unit"))

    def _share(self) -> float:
        """Return the torque of 1 % of the rated torque, on the motor's side."""
        return self.drive.resolve_unit(units.unit("%"), self.kind_of("motor")).factor

    def numbers(self, learned: Controller, declared: Controller | None) -> tuple[DriveNumber, ...]:
        """Return how the drive shows the numbers of a learned law.

        Args:
            learned: the law, on the joint's side or on that of the declared one.
            declared: the controller of the joint file, whose side, gain and units are the drive's; gains that it does
                not give have stand-ins.
        """
        if not isinstance(declared, ServoController) or not isinstance(learned, ServoController):
            return ()
        return tuple(one for name in numbers_of(learned) for one in self._number(name, learned, declared))

    def _number(self, name: str, learned: Any, declared: Any) -> Iterator[DriveNumber]:
        """Yield a number of a learned law as the drive shows it; nothing if its unit is unknown.

        It is a time instead of a gain where that is declared, and of a cascade where nothing is.
        """
        known = numbers_of(declared) if type(declared) is type(learned) else {}
        value = known.get(name) if name.partition(".")[0] in self.keys else None
        owner, _, last = name.rpartition(".")
        time, cutoff = _TIMES.get(name), f"{owner}.cutoff"
        alone = type(learned) is Cascade
        there = None
        if time is not None and (time in self.keys or (alone and name not in self.keys)):
            unit = self._unit(time, "ms")
            factor, per = 1.0 / units.parse_unit(unit).factor, "" if alone else "position_gain"
            there = DriveNumber(name, self._label(time), unit, factor, name == "integral_gain", per=per)
        elif last == "time_constant" and cutoff in self.texts:
            unit = self._unit(cutoff, "Hz")
            there = DriveNumber(name, cutoff, unit, 0.5 / math.pi / units.parse_unit(unit).factor, inverse=True)
        if there is not None:
            yield replace(there, declared=there.of(value, known)) if value else there
        else:
            yield from self._plain(name, learned, declared, value)

    def _plain(self, name: str, learned: Any, declared: Any, value: float | None) -> Iterator[DriveNumber]:
        """Yield a number that is shown as it is, in another unit."""
        measured, kind = declared_unit(learned, name), self.kind_of(self.side)
        candidates, speaks = list_units(measured, kind), in_controller_units(measured)
        if not candidates:  # a share, say
            if value is not None:
                yield DriveNumber(name, self._label(name), "", 1.0, declared=value)
            return
        of_outputs = dict(zip(OUTPUTS[kind], candidates, strict=True)) if speaks else {}
        unit = self._unit(name, of_outputs.get(self._output_unit(declared) or "", "") if speaks else candidates[0])
        one = next((v for c in candidates if unit and (v := units.convert(1.0, unit, c)) is not None), None)
        if one is None:
            return
        power = 0 if "rad" not in measured else -1 if speaks else 1  # of a position in the unit
        factor = abs(declared.ratio / learned.ratio) ** power / one
        if speaks:
            factor *= abs(learned.gain * learned.ratio) / abs(declared.gain * declared.ratio)
        yield DriveNumber(name, self._label(name), unit, factor, declared=None if value is None else value / one)

    def _output_unit(self, declared: Any) -> str | None:
        """Return the unit of a controller's output: as a number with a unit says, else by its gain."""
        output, gain = next(iter(self._outputs(declared)), None), getattr(declared, "gain", 1.0)
        if output is None and gain == 1.0:
            return self.torque or TORQUE_UNIT[self.kind_of(self.side)]
        constants = {"A": self.drive.torque_constant, "V": self.drive.torque_per_volt}
        fits = (unit for unit, c in constants.items() if c and abs(gain / (c * self._through) - 1.0) <= _AGREES)
        return output or next(fits, None)

    def _gains(self) -> Mapping[str, tuple[str, tuple[str, ...]]]:
        """Names and units of the drive's own parameters, by the key that they are."""
        traces = self.drive.traces
        return {} if traces is None else {gain.key: (gain.name, gain.units) for gain in traces.gains}

    def _label(self, name: str) -> str:
        """Return the label of a number: the drive's name, if known, and its key."""
        gains = self._gains()
        return f"{gains[name][0]} {name}" if name in gains else name

    def _unit(self, name: str, plain: str) -> str:
        """Return the unit in which the drive shows a number: the joint file's, the profile's, or a plain one."""
        if name in self.texts:
            return units.parse_quantity(self.texts[name])[1]
        choices = self._gains().get(name, ("", ()))[1]
        if not plain:
            return choices[0] if len(choices) == 1 else ""
        return next((unit for unit in choices if units.convert(1.0, unit, plain) is not None), plain)
