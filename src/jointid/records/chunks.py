"""Long records in overlapping chunks, in which filters and simulations settle."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from jointid.common.errors import RecordError
from jointid.records.clock import Cut, is_same_rate
from jointid.records.columns import Column, as_columns
from jointid.records.drives import Drive
from jointid.records.formats import Table, read_blocks
from jointid.records.formats.table import join_tables
from jointid.records.reading import RecordReader
from jointid.records.record import Record

_LOOK = 1000  # rows that determine the sample time
_ONE_CLOCK = "has one uniform clock; log all channels at one rate, and leave resample, start, stop and part out"


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A part of a long record.

    Attributes:
        number: of the chunk, from 0.
        record: its samples; `begin` is in seconds from the first sample of the log.
        last: True for the last chunk.
    """

    number: int
    record: Record
    last: bool


@dataclass(frozen=True, slots=True)
class Log:
    """A record in a file, read on demand.

    Attributes:
        path: the file, of a format with consecutive rows; MAT files of version 7 and ROS 2 bags have none.
        columns, settings: see `jointid.records.reading`. All channels have one sample time.
        options: of the format's reader.

    Raises:
        RecordError: a column has a separate sample time or time column, or resampling is set.
    """

    path: str | os.PathLike[str]
    columns: Mapping[str, str | Column] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own = any(c.sample_time or c.time for c in as_columns(self.columns).values())
        cut = self.settings.get("cut", Cut())
        if own or self.settings.get("resample") is not None or cut != Cut(leave_out=cut.leave_out):
            raise RecordError(f"A record that is read in chunks {_ONE_CLOCK}.")

    @property
    def name(self) -> str:
        """The given name, or the file's without suffix."""
        return str(self.settings.get("name") or Path(self.path).stem)

    @property
    def sample_time(self) -> float:
        """Sample time of all channels, from the first rows [s]."""
        for _, table, _ in self._tables(_LOOK, 0):
            return _require_one_rate(self._reader.build_record(table, self.name))
        raise RecordError(f"{Path(self.path).name} holds no sample; log or copy it again.")

    def chunks(self, length: int, overlap: int) -> Iterator[Chunk]:
        """Yield the chunks.

        A remainder shorter than the overlap belongs to the chunk before it.

        Args:
            length: samples between the starts of chunks.
            overlap: further samples, `length` at most.
        """
        reader, sample_time, zero = self._reader, self.sample_time, 0.0
        for number, table, last in self._tables(length, overlap):
            try:
                record = reader.build_record(table, self.name)
                if record.resampled is not None or not is_same_rate(_require_one_rate(record), sample_time):
                    raise RecordError(f"its clock jitters, or has other steps than {sample_time:g} s; it {_ONE_CLOCK}.")
            except RecordError as error:
                raise RecordError(
                    [f"{Path(self.path).name}, rows from {number * length + 1} on: {fault}" for fault in error.faults]
                ) from None
            channels = {name: replace(channel, sample_time=sample_time) for name, channel in record.items()}
            zero = zero if number else record.zero
            record, left_out = record.with_channels(channels), self.settings.get("cut", Cut()).leave_out
            record = replace(record, begin=number * length * sample_time, zero=zero, left_out=left_out)
            yield Chunk(number, record, last)

    @property
    def _reader(self) -> RecordReader:
        return RecordReader(self.columns, **{"drive": Drive(), **self.settings, "cut": Cut()})

    def _tables(self, length: int, overlap: int) -> Iterator[tuple[int, Table, bool]]:
        """Yield number, table and end flag of each chunk."""
        held: tuple[int, Table] | None = None
        for number, table in enumerate(read_blocks(self.path, length, **self.options)):
            rest = number > 0 and table.rows < overlap
            if held is not None:
                begin = {name: values[:overlap] for name, values in table.columns.items() if overlap}
                yield held[0], join_tables([held[1], replace(table, columns=begin)]) if begin else held[1], rest
            held = None if rest else (number, table)
        if held is not None:
            yield *held, True


@dataclass(frozen=True, slots=True, eq=False)
class InMemory:
    """A record in memory, to be read in chunks."""

    record: Record

    @property
    def name(self) -> str:
        """Name of the record."""
        return self.record.name

    @property
    def sample_time(self) -> float:
        """Sample time of the channels [s]."""
        return _require_one_rate(self.record)

    def chunks(self, length: int, overlap: int) -> Iterator[Chunk]:
        """Yield the chunks; see `Log.chunks`."""
        samples = min(len(channel) for _, channel in self.record.items())
        firsts = range(0, max(samples - max(overlap, 1), 0) + 1, length)
        for number, first in enumerate(firsts):
            part = cut(self.record, first, min(first + length + overlap, samples))
            yield Chunk(number, part, first == firsts[-1])


LongRecord: TypeAlias = Log | InMemory
"""A record that can be read in chunks."""


def begin_together(records: Sequence[Record]) -> tuple[Record, ...]:
    """Cut records of one log to their latest beginning.

    Raises:
        RecordError: they do not overlap, or a channel has no sample near that beginning.
    """
    latest, made = max(record.begin for record in records), list[Record]()
    for record in records:
        late, periods = latest - record.begin, [channel.sample_time for _, channel in record.items()]
        off = max(abs(late - round(late / period) * period) for period in periods)
        if late <= 0.5 * min(periods):
            made.append(record)
            continue
        if late > record.duration - 2 * max(periods) or off > 0.5 * min(periods):
            raise RecordError(
                f"The channels of another joint begin {late:g} s later, by their own clocks, where these are not cut; "
                "give resample, or log all joints by one clock."
            )
        parts = {n: replace(c, values=c.values[round(late / c.sample_time) :]) for n, c in record.items()}
        made.append(replace(record.with_channels(parts), begin=latest))
    return tuple(made)


def _require_one_rate(record: Record) -> float:
    first, *others = [channel.sample_time for _, channel in record.items()]
    if not all(is_same_rate(time, first) for time in others):
        raise RecordError(f"A record that is read in chunks {_ONE_CLOCK}; got {[first, *others]} s.")
    return first


def cut(record: Record, first: int, end: int) -> Record:
    """Return a range of samples of a record with one sample rate."""
    begin = record.begin + first * _require_one_rate(record)
    parts = {name: replace(channel, values=channel.values[first:end]) for name, channel in record.items()}
    return replace(record.with_channels(parts), begin=begin)
