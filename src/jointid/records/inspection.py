"""Inspect a file: size, unit, clock, range and drive profile."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Table, Text
from jointid.common.text import join, number, pluralise, short, show
from jointid.records.columns import unit_in_name
from jointid.records.drives import Place, Profile, Spoken, index_columns, load_profile, place_of, profile_names
from jointid.records.formats import format_of, read_table
from jointid.records.formats.table import STAMP_NAME
from jointid.records.record import CHANNELS

_LAST = "generic"  # tried last: other profiles have its names, too
_PLAIN = re.compile(r"(?:.*[./])?(?:q|tau)_?\d*\s*(?:[\[(].*)?", re.IGNORECASE)  # names common to all logs
_MOST = 64  # axes of a log


@dataclass(frozen=True, slots=True)
class LoggedAxis:
    """An axis of a log.

    Attributes:
        place: its number or name in the profile's column names; empty for a single axis.
        channels: column of each channel.
    """

    in_json = "name -place"
    place: Place
    channels: Mapping[str, str]

    @property
    def name(self) -> str:
        """Name of the joint, or a default with its number."""
        return str(self.place.get("joint", f"joint{self.place.get('axis', 1)}"))


@dataclass(frozen=True, slots=True)
class Recognised:
    """The drive profile of a file, and the axes found.

    Attributes:
        profile: of the drive.
        axes: sorted by number, or in the order of the file.
    """

    in_json = "sentence -profile"
    profile: Profile
    axes: tuple[LoggedAxis, ...]

    @property
    def sentence(self) -> str:
        """The recognised log in a sentence."""
        channels = join([name for name in CHANNELS if any(name in axis.channels for axis in self.axes)])
        return (
            f'The columns are those of profile "{self.profile.name}" ({self.profile.title}): '
            f"{pluralise(len(self.axes), 'axis', 'axes')} with {channels}."
        )


def recognise(columns: tuple[str, ...]) -> Recognised | None:
    """Find the profile with the most matching columns, or None.

    A match needs a position and one more column, of which one has another name than "q" and "tau". The generic profile
    comes last.
    """
    spoken, best, most = index_columns(columns), None, 1
    for name in sorted(profile_names(), key=lambda one: (one == _LAST, one)):
        if name != _LAST or best is None:
            profile = load_profile(name)
            axes = tuple(_find_axes(profile, columns, spoken))
            names = [column for axis in axes for column in axis.channels.values()]
            if len(names) > most and not all(map(_PLAIN.fullmatch, names)):
                best, most = Recognised(profile, axes), len(names)
    return best


def _find_axes(profile: Profile, columns: tuple[str, ...], spoken: Spoken) -> Iterator[LoggedAxis]:
    """Yield axes with their own position; each column belongs to one axis."""
    known = [name for signals in profile.channels.values() for one in signals for name in one.names]
    every = (re.escape(name).replace(r"\{joint\}", r"([^/]+)") for name in known if "{joint}" in name)
    patterns = [re.compile(f"(?:.*[./])?{one}", re.IGNORECASE) for one in every]
    found = (next(filter(None, (one.fullmatch(name) for one in patterns)), None) for name in columns)
    joints = dict.fromkeys(match[1] for match in found if match)
    taken = set[str]()
    for place in (place_of(), *map(place_of, range(1, _MOST + 1)), *(place_of(joint=name) for name in joints)):
        free = {channel: set(profile.find(channel, spoken, place)) - taken for channel in profile.channels}
        channels = {channel: names.pop() for channel, names in free.items() if len(names) == 1}
        if "motor_position" in channels or "reference" in channels:
            taken.update(channels.values())
            yield LoggedAxis(place, channels)


_TIME = re.compile(rf"(?:.*[/._ ])?{STAMP_NAME.pattern}", re.IGNORECASE)
_MOSTLY = 0.05  # largest share of steps of a clock that repeat a stamp or run backward
_LISTED = 1000  # channels; more are for programs
_LONGEST = 60  # characters of a name in the table


@dataclass(frozen=True, slots=True, eq=False)
class InspectedChannel:
    """One column of a file.

    Attributes:
        name: in the file.
        unit: stated by the file or the name, known or not; None without one.
        values: (samples,), NaN in rows without a number.
        time: its clock's column, its own name for a clock; None if none is recognised.
        sample_time: mean step of its clock in seconds; None without a clock.
    """

    in_json = "rows minimum maximum missing"
    name: str
    unit: str | None
    values: FloatArray
    time: str | None = None
    sample_time: float | None = None

    @property
    def rows(self) -> int:
        """Number of values, NaN included."""
        return self.values.size

    @property
    def missing(self) -> int:
        """Number of NaN values."""
        return int(np.count_nonzero(np.isnan(self.values)))

    @property
    def minimum(self) -> float | None:
        """Smallest number; None if all are NaN."""
        return float(np.fmin.reduce(self.values)) if self.missing < self.rows else None

    @property
    def maximum(self) -> float | None:
        """Largest number; None if all are NaN."""
        return float(np.fmax.reduce(self.values)) if self.missing < self.rows else None

    @property
    def stalls(self) -> int:
        """Number of values that do not exceed the preceding one."""
        return int(np.count_nonzero(~(self.values[1:] > self.values[:-1])))


@dataclass(frozen=True, slots=True)
class Inspection(Documented):
    """Contents of a file.

    Attributes:
        file: its name.
        format: name of its format.
        channels: its columns.
        passed: skipped columns, with the reasons.
        recognised: drive profile with its column names; None if there is none.
    """

    file: str
    format: str
    channels: tuple[InspectedChannel, ...]
    passed: Mapping[str, str]
    recognised: Recognised | None = None

    def to_document(self, *, details: bool = False) -> Document:
        """Return a table of channels, skipped content and the recognised profile."""
        del details
        header = ("channel", "rows", "unit", "sample time", "min", "max", "NaN")
        rows = tuple(
            (
                short(one.name, _LONGEST),
                str(one.rows),
                show(one.unit or "-"),
                "-" if one.sample_time is None else f"{one.sample_time:.6g} s",
                number(one.minimum),
                number(one.maximum),
                str(one.missing),
            )
            for one in self.channels[:_LISTED]
        )
        more = len(self.channels) - len(rows)
        said = [f"{pluralise(more, 'more channel')}, which --json lists"] if more else []
        said += [f"not read: {show(name)} ({show(why)})" for name, why in self.passed.items()]
        bare = [show(one.name) for one in self.channels if not one.unit and one.time != one.name]
        asked = f"Which unit has {short(', '.join(bare), 2 * _LONGEST)}? Without one a channel is read in SI units."
        said += [show(self.recognised.sentence)] if self.recognised else [asked] * bool(bare)
        title = f"{show(self.file)}: {self.format}, {len(self.channels)} channels"
        blocks: list[Block] = [Table(header, rows, words=(0, 2))] if rows else []
        if not any(channel.time == channel.name for channel in self.channels):
            said.append("No channel is recognised as time; give the joint file a sample_time, or the column's name.")
        return Document(title, (*blocks, Text("\n".join(said), "list")))


def inspect(path: str | os.PathLike[str], **options: object) -> Inspection:
    """Inspect a file of any format.

    A clock is a rising column in a unit of time whose name ends in t, time, timestamp or stamp. Other columns take the
    clock of their format, or the only one of their length.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        options: of the format's reader; see `jointid.records.formats.TextOptions`.

    Raises:
        RecordError: the file is missing or cannot be read.
    """
    table, path, of_time = read_table(path, **options), Path(path), units.units_of("time")
    found, clocks = dict[str, InspectedChannel](), dict[str, InspectedChannel]()
    for name, values in table.columns.items():
        channel = InspectedChannel(name, table.units.get(name) or unit_in_name(name, units.units_of()), values)
        is_named = _TIME.fullmatch(name) or name in table.clocks.values()
        unit = units.normalise_unit(channel.unit or "s")
        step = float(values[-1] - values[0]) / max(values.size - 1, 1)
        if is_named and unit in of_time and channel.stalls <= _MOSTLY * (values.size - 1) and step > 0:
            channel = clocks[name] = replace(channel, time=name, sample_time=step * units.unit(unit).factor)
        found[name] = channel
    for name, channel in found.items():
        alike = [one for one, clock in clocks.items() if clock.rows == channel.rows]
        time = name if name in clocks else table.clocks.get(name) or (alike[0] if len(alike) == 1 else "")
        if time in clocks:
            found[name] = replace(channel, time=time, sample_time=clocks[time].sample_time)
    return Inspection(path.name, format_of(path).name, tuple(found.values()), table.passed, recognise(tuple(found)))
