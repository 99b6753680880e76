"""Write a record to a file so that reading gives it back, by the same columns, units, signs and clock."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.transmission import Transmission
from jointid.records.clock import is_same_rate
from jointid.records.columns import Column, unit_in_name, unit_of_column
from jointid.records.drives.drive import Drive
from jointid.records.formats import Table, write_table
from jointid.records.record import Channel, Record, refer_to_drive

_ONE = 1e-9  # relative: two channels of one column differ by rounding alone


def write(
    record: Record,
    path: str | os.PathLike[str],
    columns: Mapping[str, str | Column] | None = None,
    *,
    drive: Drive | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
    kind: str = "prismatic",
    transmission: Transmission | None = None,
    **options: object,
) -> None:
    """Write a record to a file that `jointid.records.reading` gives back, told the same of it.

    A channel that neither `columns` nor the drive's profile has a name for is written in SI under its own. A record of
    which nothing is said comes back to the last bit, once reading is told what a table of numbers does not hold: the
    joint's kind, a torque in A or V, and what differs from the defaults of `Column`. The positions of other axes are
    not written.

    Args:
        record: its channels share one rate and have at least two samples; on its joint's side of the transmission.
        path: the file; its suffix tells the format. A file that is there is replaced.
        columns: channel -> its column, by name or as a `Column`.
        drive: the numbers behind counts, shares of a rated torque and ampere, and the profile of its traces.
        time: name of the time column; None is "t", or no column where the sample time is given.
        time_unit: unit of the time column; None takes the one in its name, or else s.
        sample_time: time between samples at which it will be read [s].
        kind: "prismatic" or "revolute".
        transmission: between motor and load; every channel is written as it is on its own side.
        options: with which the format will read it; see `jointid.records.formats.Csv`.

    Raises:
        RecordError: the channels differ in rate or have one sample, two of them have one column, the file would not be
            read back, or cannot be written.
    """
    wanted = {n: Column(c) if isinstance(c, str) else c for n, c in (columns or {}).items()}
    writing = _Writer(drive or Drive(), kind, transmission)
    named = writing.name_columns(record, wanted)
    if transmission is not None:
        sides = {name: writing.drive.side(name, named.get(name)) for name in record.channels}
        record = refer_to_drive(transmission, record, sides)
    channels = dict(record.items())
    table = _time_column(channels, time, time_unit, sample_time)
    for name, channel in channels.items():
        column = named[name].column if name in named else name
        values = writing.column_values(name, channel, named) if name in named else channel.values
        if not np.allclose(table.setdefault(column, values), values, rtol=_ONE, atol=0.0):
            both = [n for n, c in named.items() if c.column == column]
            raise RecordError(
                f'{" and ".join(both) if len(both) > 1 else name} would share the column "{column}" with something '
                "else; give each channel, and the time, a column of its own."
            )
    for named_column in named.values():
        if named_column.time is not None:
            table.setdefault(named_column.time, _stamps(next(iter(channels.values())), named_column.time, time_unit))
    by_number = all(name.isdecimal() for name in table)
    write_table(path, Table({n: table[n] for n in (sorted(table, key=int) if by_number else table)}), **options)


def _time_column(
    channels: Mapping[str, Channel], time: str | None, time_unit: str | None, sample_time: float | None
) -> dict[str, FloatArray]:
    """Return the time column, by its name; none where the sample time is all that is read."""
    if len({channel.sample_time for channel in channels.values()}) > 1:
        rates = ", ".join(f"{name} {channel.sample_time:g} s" for name, channel in channels.items())
        raise RecordError(f"A file holds channels of one rate; got {rates}: write each rate to a file of its own.")
    first = next(iter(channels.values()))
    if len(first) < 2:
        raise RecordError("A record of one sample has no time between samples; write two samples or more.")
    if sample_time is not None and not is_same_rate(first.sample_time, sample_time):
        raise RecordError(
            f"The record has a sample every {first.sample_time:g} s, and would be read at the sample_time of "
            f"{sample_time:g} s that is given; name a time column instead, or correct it."
        )
    if sample_time is not None and time is None:
        return {}
    name = time or "t"
    return {name: _stamps(first, name, time_unit)}


def _stamps(channel: Channel, name: str, time_unit: str | None) -> FloatArray:
    """Return a channel's instants in the unit of the time column of that name."""
    unit = units.unit(time_unit or unit_in_name(name, units.units_of("time")) or "s")
    return channel.time / unit.factor


@dataclass(frozen=True, slots=True)
class _Writer:
    """The drive whose log is written, and the kind and transmission of its joint."""

    drive: Drive
    kind: str
    transmission: Transmission | None

    def kind_of(self, name: str, column: Column | None) -> str:
        """Return how the side moves on which a channel is measured."""
        return self.kind if self.transmission is None else self.transmission.kind_of(self.drive.side(name, column))

    def name_columns(self, record: Record, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns that have a name, as declared or by the drive's profile."""
        traces = self.drive.traces
        found: dict[str, Column | None] = {name: wanted.get(name) for name in record.channels}
        if traces is not None:
            for name, column in found.items():
                tap = record.tap if name == "torque" and not (column and column.tap) else None
                found[name] = traces.column(name, column, self.drive.axis, self.kind_of(name, column), tap)
        return {name: column for name, column in found.items() if column is not None and column.column}

    def column_values(self, name: str, channel: Channel, columns: Mapping[str, Column]) -> FloatArray:
        """Return a channel, on its own side, in the numbers of its column."""
        column = columns[name]
        kind = self.kind_of(name, column)
        geared = self.transmission is not None and self.transmission.geared
        stated = units.unit(unit_of_column(name, columns, kind))
        unit = self.drive.resolve_unit(stated, kind, of_load=name == "load_position", geared=geared)
        if unit.si != channel.unit:
            raise RecordError(
                f'{name} is in {channel.unit}, and its column "{column.column}" in {stated.name}; correct one of them.'
            )
        values = channel.values / (column.sign * column.gain * unit.factor)
        if column.wrap is not None:  # it begins where it is, so that it comes back unwrapped as it was
            values = values - column.wrap * np.round((values - values[0]) / column.wrap)
        return np.asarray(values)
