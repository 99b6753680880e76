"""Units of an axis: torque constant, and gain from a controller's output to torque.

The torque constant is given once, below [joint], for the torque's channel and the controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jointid.common import units
from jointid.common.errors import JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import join
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind, UnitError
from jointid.config.declaration import fault_at, output_of
from jointid.models.controllers import Controller, declared_unit, numbers_of
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
        """The torque constant: torque per plain number of a controller on the motor's side."""
        return self.drive.torque_constant or self.drive.torque_per_volt

    @property
    def plain_gain(self) -> float:
        """The gain of a controller whose numbers are given without a unit."""
        return 1.0 if self.constant is None else self.constant * self._through

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

    def gain(self, law: Controller, given: float | None, texts: Mapping[str, str]) -> tuple[float, str]:
        """Return the gain from a controller's output to torque on its side, given or known, and the output's unit.

        Args:
            law: the controller.
            given: the gain that the file gives.
            texts: of its numbers that are given with a unit, by the path of their key.

        Raises:
            JointFileError: it is not known, or its numbers are of different outputs.
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
            rest = f" is of an output in {output}; expected what takes it to the torque: give the joint a "
            rest += "torque_constant, or the drive its rated_torque."
            raise JointFileError(fault_at(("controller", name), rest, "unit"))
        if given is not None and known is not None and abs(given / known - 1) > _AGREES:
            rest = f" is {given:g}, but {name} makes it {known:.6g}; leave the wrong one out."
            raise JointFileError(fault_at(("controller", "gain"), rest))
        return given or known or 1.0, output

    def _torque_per(self, output: str) -> float | None:
        """Return the torque per unit of an output; None where nothing but a gain can say it."""
        try:
            unit = self.drive.resolve_unit(units.unit(output), self.kind_of("motor"))
        except UnitError:  # a share of a rated torque that is not there
            return None
        fits = unit.si in TORQUE_UNIT.values() if self.torque is None else unit.si == self.torque
        return unit.factor * self._through if fits else None
