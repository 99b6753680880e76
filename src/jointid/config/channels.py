"""How the channels of a joint file fit the rest of it: their units and sides to joint, transmission and drive.

Each part has the function that says what is at fault and the one that makes use of what is not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from jointid.common import messages, units
from jointid.common.transmission import Side
from jointid.config.gearing import TransmissionTable, kind_of
from jointid.config.record_table import ChannelTable
from jointid.models.parameters import TORQUE_UNIT, Kind
from jointid.records.columns import known_units
from jointid.records.drives.drive import Drive


def channel_faults(
    channels: Mapping[str, ChannelTable],
    kinds: Collection[Kind],
    transmission: TransmissionTable | None,
    drive: Drive | None,
) -> Iterator[str]:
    """Yield channels without a column, or with settings or units that are not theirs, and torques that differ.

    Args:
        channels: that are right in themselves.
        kinds: that the joint may be of, which is the load's where there is a transmission.
        transmission: between motor and load.
        drive: whose units they may be in, if it is right.
    """
    for name, table in channels.items():
        if table.column is None and drive is not None and drive.traces is None:
            yield (
                f"record.channels.{name}.column is missing; expected text in quotes (name of the column in the "
                "record's file): add it, or give drive.profile."
            )
        yield from (f"record.channels.{fault}" for fault in table.to_column().misplaced_faults(name))
        yield from _unit_faults(name, table, kinds, transmission, drive)
    if "injected" in channels:
        both = ("injected", "torque")
        pairs = {tuple(_si_unit(name, channels, kind, transmission, drive) for name in both) for kind in kinds}
        pair = pairs.pop() if len(pairs) == 1 else (None, None)
        # A force on one side of a screw and a torque on the other are both in SI.
        if None not in pair and len({unit in TORQUE_UNIT.values() or unit for unit in pair}) > 1:
            yield f"record.channels.injected is in {pair[0]}, but the torque in {pair[1]}: give both in one unit."


def _unit_faults(
    name: str,
    table: ChannelTable,
    kinds: Collection[Kind],
    transmission: TransmissionTable | None,
    drive: Drive | None,
) -> Iterator[str]:
    """Yield a unit that a joint of none of these kinds can have, or for which a number of the drive is missing."""
    side = _side(name, table, drive)
    moving = [kind_of(side, kind, transmission) for kind in kinds]
    known = tuple(dict.fromkeys(unit for kind in moving for unit in known_units(name, kind)))
    stated = table.to_column().stated_unit(known)
    if stated is None:
        return
    if stated not in known:
        where = "unit is" if table.unit is not None else "column names the unit"
        yield f'record.channels.{name}.{where} "{stated}"{_misfit(name, stated, known, kinds, moving)}'
    elif drive is not None and len(set(moving)) == 1:
        lack = _lacking(name, stated, moving[0], transmission, drive)
        yield from () if lack is None else (f'record.channels.{name} is in "{stated}", {lack}.',)


def torque_unit(
    channels: Mapping[str, ChannelTable], kind: Kind, transmission: TransmissionTable | None, drive: Drive
) -> str | None:
    """Return "A" or "V" for a torque in the drive's own units, None for one in N or N m."""
    unit = _si_unit("torque", channels, kind, transmission, drive)
    return None if unit in TORQUE_UNIT.values() else unit


def list_channels(channels: Collection[str], drive: Drive | None) -> tuple[str, ...]:
    """Return the names of the channels that the file declares, or that the drive's profile may find."""
    profile = None if drive is None else drive.traces
    return tuple(dict.fromkeys([*channels, *(() if profile is None else profile.channels)]))


def _si_unit(
    channel: str,
    channels: Mapping[str, ChannelTable],
    kind: Kind,
    transmission: TransmissionTable | None,
    drive: Drive | None,
) -> str | None:
    """Return the unit in which a channel is logged, made SI; None if it cannot be."""
    table = channels.get(channel)
    moving = kind_of(_side(channel, table, drive), kind, transmission)
    known = known_units(channel, moving)
    stated = table.to_column().stated_unit(known) if table else None
    if stated is None and channel == "injected":
        torque = _si_unit("torque", channels, kind, transmission, drive)
        return torque if torque is None or torque in known else known[0]
    if stated is None:
        return known[0]
    if stated not in known or _lacking(channel, stated, moving, transmission, drive or Drive()):
        return None
    return (drive or Drive()).resolve_unit(units.unit(stated), moving).si


def _side(channel: str, table: ChannelTable | None, drive: Drive | None) -> Side:
    """Return the side of a transmission on which a channel is measured."""
    declared = None if table is None else table.to_column()
    return (drive or Drive()).side(channel, declared)


def _lacking(channel: str, unit: str, kind: Kind, transmission: TransmissionTable | None, drive: Drive) -> str | None:
    """Return the end of the sentence on a unit for which a number of the drive is missing."""
    try:
        geared = transmission is not None and transmission.geared
        drive.resolve_unit(units.unit(unit), kind, of_load=channel == "load_position", geared=geared)
    except units.UnitError as error:
        return str(error)
    return None


def _misfit(channel: str, unit: str, known: Collection[str], kinds: Collection[Kind], moving: Collection[Kind]) -> str:
    """Return the end of the sentence on a unit that a channel cannot have; its side may move otherwise than a joint."""
    expected = f"expected one of {', '.join(known)}"
    try:
        dimension = units.unit(unit).dimension
    except units.UnitError:
        otherwise = "give one of them, and the gain that takes the column to it"
        return f", which is not known; {expected}: {messages.suggest(unit, known, otherwise)}"
    fitting = [kind for kind in TORQUE_UNIT if kind not in kinds and unit in known_units(channel, kind)]
    remedy = "".join(f', or set joint.kind = "{kind}"' for kind in fitting)
    if set(moving) != set(kinds) and any(unit in known_units(channel, kind) for kind in kinds):
        remedy = ', or set side = "load"'
    return f", a unit of {dimension}; {expected}: give one of them{remedy}."
