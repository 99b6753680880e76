"""Write a record so that reading restores it."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.transmission import Transmission
from jointid.records.clock import is_same_rate
from jointid.records.columns import Column, as_columns, unit_in_name
from jointid.records.drives import Drive, Frame
from jointid.records.formats import Table, write_table
from jointid.records.record import Record, instants, refer_channel, takes_record

_ONE = 1e-9  # relative tolerance of two channels that share a column


@takes_record
def write(
    record: Record,
    path: str | os.PathLike[str],
    columns: Mapping[str, str | Column] | None = None,
    *,
    drive: Drive | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
    kind: str = "revolute",
    transmission: Transmission | None = None,
    **options: object,
) -> None:
    """Write a record that `jointid.read` restores with the same arguments.

    Channels without a column are written in SI under their own names. The file does not contain the joint's kind, a
    torque unit A or V, and non-default settings of `Column`; reading needs them.

    Args:
        record: at least two samples, one rate; on its joint's side of the transmission.
        path: the file; its suffix selects the format. An existing file is replaced.
        columns: channel -> column name or `Column`.
        drive: factors for counts, shares of rated torque and ampere, and the profile of the traces.
        time: name of the time column; None is "t", or no column if the sample time is given.
        time_unit: unit of the time column; None takes the one in its name, or s.
        sample_time: time between samples for reading [s].
        kind: "revolute" or "prismatic".
        transmission: between motor and load; every channel is written on its own side.
        options: of the format's reader; see `jointid.records.formats.TextOptions`.

    Raises:
        RecordError: the channels differ in rate, have one sample or share a column, or the file cannot be restored
            or written.
    """
    frame = Frame(drive or Drive(), kind, transmission)
    write_columns(columns_to_write(record, columns or {}, frame, time, time_unit, sample_time), path, **options)


def write_columns(columns: Mapping[str, FloatArray], path: str | os.PathLike[str], **options: object) -> None:
    """Write columns by name; numbered ones in numerical order."""
    by_number = all(name.isdecimal() for name in columns)
    names = sorted(columns, key=int) if by_number else columns
    write_table(path, Table({name: columns[name] + 0.0 for name in names}), **options)  # of 0 no negative


def columns_to_write(
    record: Record,
    columns: Mapping[str, str | Column],
    frame: Frame,
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
) -> dict[str, FloatArray]:
    """Return the columns that `write` writes, by name; arguments as there."""
    named, given = dict[str, Column](), as_columns(columns)
    for name in record.channels:
        column = given.get(name)
        if frame.drive.traces is not None:
            tap = record.tap if name == "torque" and not (column and column.tap) else None
            column = frame.drive.traces.column(name, column, frame.drive.place, frame.kind_of(name, column), tap)
        named |= {name: column} if column is not None and column.column else {}
    if (gear := frame.transmission) is not None:
        sides = {name: frame.drive.side(name, named.get(name)) for name in record.channels}
        seen = {n: refer_channel(gear, n, channel, sides[n], back=True) for n, channel in record.items()}
        record = record.with_channels(seen)
    channels = dict(record.items())
    first, periods = next(iter(channels.values())), {channel.sample_time for channel in channels.values()}
    if len(first) < 2 or not all(is_same_rate(period, sample_time or first.sample_time) for period in periods):
        rates = ", ".join(f"{name} {channel.sample_time:g} s" for name, channel in channels.items())
        raise RecordError(
            f"A file holds two samples or more of one rate; got {rates}, {len(first)} samples, and a sample_time of "
            f"{sample_time} s: write each rate to a file of its own, or name a time column."
        )
    clocks = [time or "t"] if sample_time is None or time is not None else []
    clocks += [column.time for column in named.values() if column.time is not None]
    table = dict[str, FloatArray]()
    for name in clocks:
        unit = units.unit(time_unit or unit_in_name(name, units.units_of("time")) or "s")
        table[name] = instants(len(first), first.sample_time / unit.factor)
    for name, channel in channels.items():
        called, values = name, channel.values
        if name in named:
            column, unit = named[name], frame.unit_of(name, named)
            called = column.column
            if unit.si != channel.unit:
                raise RecordError(
                    f'{name} is in {channel.unit}, and its column "{called}" in {unit.name}; correct one of them.'
                )
            values = values / (column.sign * column.gain * unit.factor)
            if column.wrap is not None:  # the first value is kept, so that unwrapping restores the position
                values = values - column.wrap * np.round((values - values[0]) / column.wrap)
        if not np.allclose(table.setdefault(called, values), values, rtol=_ONE, atol=0.0):
            raise RecordError(
                f'{name} would share the column "{called}" with something else; give each channel, and the time, a '
                "column of its own."
            )
    return table
