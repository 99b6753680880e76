"""Channels and records referred from one side of a transmission to the other, and held against a joint's units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.models.joints import Joint
from jointid.models.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.models.transmission import SI_UNITS, Side, Transmission, usual_side
from jointid.records.record import CHANNELS, Channel, Injection, Record

_TORQUES = ("torque", "injected")


def refer_channel(transmission: Transmission, name: str, channel: Channel, side: Side) -> Channel:
    """Return a channel of that name as it is on the joint's side, from the side it was logged on."""
    return _refer(name, channel, transmission.position(side), transmission.kind)


def refer_to_drive(transmission: Transmission, record: Record, sides: Mapping[str, Side]) -> Record:
    """Return a record of the joint's side as a drive logs it: each channel on its own side, by name."""
    referred: dict[str, Any] = {}
    for name, channel in record.items():
        side = sides.get(name) or usual_side(name)
        back = _refer(name, channel, 1.0 / transmission.position(side), transmission.kind_of(side))
        referred[name] = back if name != "injected" else replace(_injection(record), channel=back)
    return replace(record, **referred)


def require_units(record: Record, joint: Joint) -> None:
    """Raise a `RecordError` if a record's channels are in units that are not the joint's."""
    position, force = POSITION_UNIT[joint.kind], joint.torque_unit or TORQUE_UNIT[joint.kind]
    expected = dict.fromkeys(CHANNELS, position)
    expected |= {"torque": force, "injected": force, "reference_velocity": f"{position}/s"}
    wrong = [f"{name} in {c.unit}, not {expected[name]}" for name, c in record.items() if c.unit != expected[name]]
    if wrong:
        raise RecordError(
            f"This {joint.kind} joint does not fit the record, which has {'; '.join(wrong)}: correct the joint's kind "
            "or torque_unit, or the units of the channels."
        )


def _refer(name: str, channel: Channel, position: float, kind: units.Kind) -> Channel:
    factor = 1.0 / position if name in _TORQUES else position
    unit = channel.unit if units.unit(channel.unit).dimension in ("current", "voltage") else _unit(name, kind)
    return replace(channel, values=channel.values * factor, unit=unit)


def _injection(record: Record) -> Injection:
    assert record.injected is not None
    return record.injected


def _unit(name: str, kind: units.Kind) -> str:
    """Return the SI unit of a channel of that name on a side that moves so."""
    position, torque = SI_UNITS[kind]
    return torque if name in _TORQUES else f"{position}/s" if name == "reference_velocity" else position
