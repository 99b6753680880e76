"""National Instruments' TDMS: channels in groups, with properties."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.arrays import REAL, skip_reason
from jointid.records.formats.table import (
    Table,
    require_size,
    require_unique_names,
)

_READ = REAL + "M"  # kinds of NumPy's types of channels that are read
_NAMELESS = "Untitled"  # what LabVIEW calls a group that has no name
_UNITS = ("unit_string", "unit", "units", "Unit")
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNSET = np.datetime64("1904-01-02")  # LabVIEW counts from the day before; an instant nobody set is that

Nptdms: TypeAlias = Any
"""An object of npTDMS, which has no types."""


@dataclass(frozen=True, slots=True)
class Tdms:
    """TDMS: columns "group/channel", or "channel" for the group "Untitled".

    Numeric properties of the file and its groups are scalars; "unit_string" is the unit. A waveform (wf_increment) gets
    a time column "group/time" if shared by the group, else "group/channel/time". Instants and wf_start_time are seconds
    since the first in the file. Text is skipped.
    """

    name: ClassVar[str] = "TDMS"
    suffixes: ClassVar[tuple[str, ...]] = (".tdms",)

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        with _open(path) as contents:
            require_size(path, sum(channel.rows for channel in contents.channels))
            return contents.read()


class _Channel(NamedTuple):
    """A channel or computed waveform time, `late` seconds after the file's first."""

    name: str
    rows: int
    channel: Nptdms
    unit: str = ""
    clock: str = ""
    is_time: bool = False
    late: float = 0.0

    def values(self) -> FloatArray:
        """Read every number."""
        if self.is_time:
            step, offset = (float(self.channel.properties.get(key, 0.0)) for key in (_STEP, _OFFSET))
            return np.asarray(self.late + offset + np.arange(self.rows) * step)
        values = self.channel.read_data()
        if values.size != self.rows:
            raise ValueError(f"{values.size} numbers where {self.rows} are declared")
        if values.dtype.kind == "M":
            return np.asarray((values - values[0]) / np.timedelta64(1, "ns") / 1e9 + self.late, dtype=np.float64)
        return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Contents:
    """An open file."""

    path: Path
    channels: list[_Channel]
    scalars: dict[str, float]
    passed: dict[str, str]

    def read(self) -> Table:
        """Read every column."""
        columns = {c.name: c.values() for c in self.channels}
        units = {c.name: c.unit for c in self.channels if c.unit}
        clocks = {c.name: c.clock for c in self.channels if c.clock}
        return Table(columns, self.scalars, self.path.name, units, self.passed, clocks)


@contextmanager
def _open(path: Path) -> Iterator[_Contents]:
    nptdms = extra("nptdms", "logs", f"Reading {path.name}")
    # What is wrong with a file is said here, once, and not on the side.
    extra("nptdms.log", "logs", "Reading TDMS").log_manager.set_level(logging.CRITICAL)
    # An open file, not its path: an index beside it, which may be of another file, is then left alone.
    with path.open("rb") as raw:
        file = nptdms.TdmsFile.open(raw)
        if file.file_status.incomplete_final_segment:
            raise RecordError(f"{path.name} ends in the middle of its data; log or copy it again.")
        owners = {"": file.properties} | {f"{group.name}/": group.properties for group in file.groups()}
        scalars = {
            f"{prefix}{name}": float(value)
            for prefix, properties in owners.items()
            for name, value in properties.items()
            if isinstance(value, int | float | np.number) and not isinstance(value, bool)
        }
        passed = {
            f"{group.name}/{channel.name}": skip_reason(np.dtype(channel.dtype)) or "it is empty"
            for group in file.groups()
            for channel in group.channels()
            if not (len(channel) and np.dtype(channel.dtype).kind in _READ)
        }
        contents = _Contents(path, list(_list_channels(file)), scalars, passed)
        require_unique_names(path, [channel.name for channel in contents.channels])
        if not contents.channels:
            raise RecordError(f"{path.name} holds no channel of numbers; log the signals as numbers.")
        yield contents


def _list_channels(file: Nptdms) -> Iterator[_Channel]:
    every = [channel for group in file.groups() for channel in group.channels() if len(channel)]
    begins = {}  # the first instant of a waveform, or of a channel of instants
    for channel in every:
        is_instants = np.dtype(channel.dtype).kind == "M"
        begin = channel.read_data(0, 1)[0] if is_instants else channel.properties.get(_START)
        if isinstance(begin, np.datetime64) and begin >= _UNSET:
            begins[channel.path] = begin
    late = {path: float((begin - min(begins.values())) / np.timedelta64(1, "s")) for path, begin in begins.items()}
    for group in file.groups():
        prefix = "" if group.name == _NAMELESS else f"{group.name}/"
        channels = [
            _Channel(
                f"{prefix}{channel.name}", len(channel), channel, _read_unit(channel), late=late.get(channel.path, 0.0)
            )
            for channel in group.channels()
            if len(channel) and np.dtype(channel.dtype).kind in _READ
        ]
        timed = [c for c in channels if float(c.channel.properties.get(_STEP, 0.0)) > 0]
        clocks = {(c.rows, c.channel.properties[_STEP], c.channel.properties.get(_OFFSET, 0.0), c.late) for c in timed}
        names = {channel.name for channel in group.channels()}
        is_common = len(clocks) == 1 and "time" not in names
        if is_common:
            yield timed[0]._replace(name=f"{prefix}time", unit="s", is_time=True)
        for channel in channels:
            clock = (f"{prefix}time" if is_common else f"{channel.name}/time") if channel in timed else ""
            yield channel._replace(clock=clock)
            if clock and not is_common:
                yield channel._replace(name=clock, unit="s", is_time=True)


def _read_unit(channel: Nptdms) -> str:
    """Unit that a property states, empty without one."""
    if np.dtype(channel.dtype).kind == "M":
        return "s"
    found = (channel.properties.get(key) for key in _UNITS)
    return next((unit.strip() for unit in found if isinstance(unit, str) and unit.strip()), "")
