"""Units of an axis: torque constant, gain from a controller's output to torque, and numbers as the drive has them.

The torque constant is given once, below [joint], for the torque's channel and the controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from jointid.common import units
from jointid.common.errors import JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import join
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, UnitError
from jointid.config.declaration import OUTPUTS, fault_at, in_controller_units, list_units, output_of
from jointid.config.tables import INVERSES
from jointid.models.controllers import Controller, ServoController, declared_unit, numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.records.columns import Column, known_units
from jointid.records.drives import Drive

_AGREES = 1e-3  # of a gain: one that is written with four digits is the torque constant


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
    def _constants(self) -> Mapping[str, float | None]:
        return {"A": self.drive.torque_constant, "V": self.drive.torque_per_volt}

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
        if not outputs:
            return given or (1.0 if self.constant is None else self.constant * self._through)
        ((output, name),) = outputs.items()
        known = self._torque_per(output)
        if given is None and known is None:
            rest = f" is of an output in {output}; expected what takes it to the torque: give the joint a "
            rest += "torque_constant, or the drive its rated_torque."
            raise JointFileError(fault_at(("controller", name), rest, "unit"))
        if given is not None and known is not None and abs(given / known - 1) > _AGREES:
            rest = f" is {given:g}, but {name} makes it {known:.6g}; leave the wrong one out."
            raise JointFileError(fault_at(("controller", "gain"), rest))
        return given or known or 1.0

    def _outputs(self, law: Any) -> dict[str, str]:
        """Return the units of a controller's output, each with a number that says it."""
        found, kind = dict[str, str](), self.kind_of(self.side)
        for name in (one for one in self.texts if one in numbers_of(law)):
            if output := output_of(self.texts[name], declared_unit(law, name), kind):
                found.setdefault(output, name)
        return found

    def _torque_per(self, output: str) -> float | None:
        """Return the torque per unit of an output; None where nothing but a gain can say it."""
        if output in self._constants:
            constant = self._constants[output]
            if self.constant is None and self.torque == output:  # parameters are per ampere or volt
                constant = 1.0
        elif self.torque is not None:
            constant = None
        elif output == "%":
            try:
                constant = self.drive.resolve_unit(units.unit("%"), self.kind_of("motor")).factor
            except UnitError:
                constant = None
        else:
            constant = 1.0
        return None if constant is None else constant * self._through

    def numbers(self, learned: Controller, declared: Controller | None) -> tuple[DriveNumber, ...]:
        """Return how the drive shows the numbers of a learned law, in the units of the file or of its output.

        Args:
            learned: the law, on the joint's side or on that of the declared one.
            declared: the controller of the joint file, whose side, gain and units are the drive's.
        """
        if not isinstance(declared, ServoController) or not isinstance(learned, ServoController):
            return ()
        return tuple(filter(None, (self._number(name, learned, declared) for name in numbers_of(learned))))

    def _number(self, name: str, learned: Any, declared: Any) -> DriveNumber | None:
        """Return a number of a learned law as the drive shows it; None if its unit is unknown."""
        known = numbers_of(declared) if type(declared) is type(learned) else {}
        value = known.get(name) if name.partition(".")[0] in self.keys else None
        owner, point, last = name.rpartition(".")
        other, _, unit, product = INVERSES.get(last, ("", "", "", 1.0))
        other = f"{owner}{point}{other}"
        if other in self.texts or other in self.keys:
            unit = self._stated_unit(other) or unit
            there = DriveNumber(name, other, unit, product / units.parse_unit(unit).factor, inverse=True)
            return replace(there, declared=there.of(value)) if value else there
        measured, kind = declared_unit(learned, name), self.kind_of(self.side)
        candidates, speaks = list_units(measured, kind), in_controller_units(measured)
        if not candidates:  # a share, say
            return None if value is None else DriveNumber(name, name, "", 1.0, declared=value)
        plain = candidates[0]
        if speaks:
            plain = dict(zip(OUTPUTS[kind], candidates, strict=True)).get(self._output_unit(declared) or "", "")
        if not (unit := self._stated_unit(name) or plain):
            return None
        one = next(v for c in candidates if (v := units.convert(1.0, unit, c)) is not None)
        power = 0 if "rad" not in measured else -1 if speaks else 1  # of a position in the unit
        factor = abs(declared.ratio / learned.ratio) ** power / one
        if speaks:
            factor *= abs(learned.gain * learned.ratio) / abs(declared.gain * declared.ratio)
        return DriveNumber(name, name, unit, factor, declared=None if value is None else value / one)

    def _stated_unit(self, key: str) -> str:
        """Return the unit with which the file gives a key; empty without one."""
        return units.parse_quantity(self.texts[key])[1] if key in self.texts else ""

    def _output_unit(self, declared: Any) -> str | None:
        """Return the unit of a controller's output: as a number with a unit says, else by its gain."""
        output, gain = next(iter(self._outputs(declared)), None), getattr(declared, "gain", 1.0)
        if output is None and gain == 1.0:
            return self.torque or TORQUE_UNIT[self.kind_of(self.side)]
        fits = (unit for unit, c in self._constants.items() if c and abs(gain / (c * self._through) - 1.0) <= _AGREES)
        return output or next(fits, None)
