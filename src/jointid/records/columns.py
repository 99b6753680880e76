"""Columns of a table that become the channels of a record: name, unit, gain and sign."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.models.transmission import SIDES, Side
from jointid.records.record import InjectionPoint, Tap, Timing

_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a file that holds one channel: its values are `sign` x `gain` x column, in `unit`.

    Attributes:
        column: the column's name; "" leaves it to the drive's profile.
        unit: unit of the values. None takes the one in the column's name ("pos [mm]") if gain is 1; or else
            m, m/s and N, or rad, rad/s and N m, by the kind of the joint; for injected, the torque's unit.
        gain: what the column is multiplied by to be in `unit`, positive.
        sign: -1 turns the channel round.
        timing: what a value says about the time around its sample. None is held for torque and injected,
            sampled for positions and velocities.
        sample_time: this channel's own time between samples [s], where it differs from the record's.
        tap: where in the drive the torque was logged (torque only); None is the controller's output.
        at: where the known signal is added to the controller's output (injected only).
        in_torque: True if the logged torque contains the known signal (injected only).
        side: of the transmission, "motor" or "load"; None is the load's for load_position, the motor's for the others.
        wrap: where the column, in its own numbers, wraps round: 65536 for an encoder of 16 bits, 360 for an
            angle in degrees (positions only).
        update_time: time between refreshes [s] of a column that is logged more often than that; it becomes a
            channel of that sample time, from the first refresh on.
        optional: True to read a file without this column without this channel.
        time: name of this channel's own time column, where it has one.

    Raises:
        RecordError: gain, sample_time, wrap or update_time is not positive and finite, sign is not 1 or -1, there is
            no such side, or there are a sample time and a time column.
    """

    column: str = ""
    unit: str | None = None
    gain: float = 1.0
    sign: int = 1
    timing: Timing | None = None
    sample_time: float | None = None
    tap: Tap | None = None
    at: InjectionPoint = InjectionPoint.AFTER_LIMIT
    in_torque: bool = True
    side: Side | None = None
    wrap: float | None = None
    update_time: float | None = None
    optional: bool = False
    time: str | None = None

    def __post_init__(self) -> None:
        faults = []
        if not (math.isfinite(self.gain) and self.gain > 0):
            advice = "use sign = -1 to turn the channel round" if self.gain < 0 else "leave it out if it is 1"
            faults.append(f'The gain of column "{self.column}" is a positive number; got {self.gain:g}: {advice}.')
        if self.sign not in (1, -1):
            faults.append(f'The sign of column "{self.column}" is 1 or -1; got {self.sign}: use gain to scale it.')
        faults += period_faults(f'sample time of column "{self.column}"', self.sample_time)
        if self.sample_time is not None and self.time is not None:
            faults.append(
                f'Column "{self.column}" has a sample_time and a time column of its own; leave one of them out.'
            )
        faults += period_faults(f'update time of column "{self.column}"', self.update_time)
        if self.wrap is not None and not (math.isfinite(self.wrap) and self.wrap > 0):
            faults.append(
                f'The wrap of column "{self.column}" is a positive number; got {self.wrap:g}: give the value at which '
                "the encoder begins again, or leave it out."
            )
        if self.side not in (None, *SIDES):
            faults.append(f'The side of column "{self.column}" is "motor" or "load"; got "{self.side}": correct it.')
        if faults:
            raise RecordError(faults)
        object.__setattr__(self, "timing", None if self.timing is None else Timing(self.timing))
        object.__setattr__(self, "tap", None if self.tap is None else Tap(self.tap))
        object.__setattr__(self, "at", InjectionPoint(self.at))

    def stated_unit(self, known: tuple[str, ...]) -> str | None:
        """Return the unit of the values as far as it is stated, here or in the column's name."""
        # A gain takes the values from the unit in the name to another one.
        return self.unit if self.unit is not None or self.gain != 1 else unit_in_name(self.column, known)

    def misplaced_faults(self, channel: str) -> list[str]:
        """Return the faults of settings that belong to other channels than `channel`."""
        faults = []
        if channel != "torque" and self.tap is not None:
            faults.append(f"{channel} has tap = {self.tap}, which says where a torque was logged; leave it out.")
        if channel != "injected" and not (self.in_torque and self.at is InjectionPoint.AFTER_LIMIT):
            faults.append(f"{channel} has at or in_torque, which are for an injected signal; leave them out.")
        if self.wrap is not None and channel not in ("reference", "motor_position", "load_position"):
            faults.append(f"{channel} has a wrap of {self.wrap:g}, which is for a position; leave it out.")
        return faults


def unit_in_name(column: str, known: tuple[str, ...]) -> str | None:
    """Return the unit that a column's name ends with; one that is not known only if in square brackets."""
    match = _IN_BRACKETS.search(column)
    if match is None or match[1].isdigit():  # "phi[0]" is an element
        return None
    # "q [clicks]" is to be refused, not to be read as metres; "q (filtered)" has a remark.
    return match[1] if match[1] in known or column.rstrip().endswith("]") else None


def unit_fault(what: str, name: str, known: tuple[str, ...]) -> str:
    """Return the fault of a unit that is not among those known."""
    return f'{what} is in "{name}"; expected one of {", ".join(known)}: give its unit, and the gain to it.'


def known_units(channel: str, kind: str) -> tuple[str, ...]:
    """Return the units that a channel of a joint of this kind can have, SI first."""
    if channel in ("torque", "injected"):
        return units.units_of(*units.TORQUE_UNITS[kind])
    dimensions = units.VELOCITY_UNITS if channel == "reference_velocity" else units.POSITION_UNITS
    return units.units_of(*dimensions[kind])


def unit_of_column(channel: str, columns: Mapping[str, Column], kind: str) -> str:
    """Return the unit of a channel's values: as stated, or SI, of what is injected that of the torque."""
    known = known_units(channel, kind)
    default = known[0]
    if channel == "injected" and "torque" in columns:
        stated = columns["torque"].stated_unit(known)  # on another side of a transmission it may be no unit here
        default = stated if stated in known else default
    return columns[channel].stated_unit(known) or default


def period_faults(what: str, sample_time: float | None) -> list[str]:
    """Return the fault of a time between samples that is given and not positive and finite."""
    if sample_time is None or (math.isfinite(sample_time) and sample_time > 0):
        return []
    return [f"The {what} is a positive number of seconds; got {sample_time:g}."]
