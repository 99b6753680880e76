"""[record], [drive], [[records]] and [together]: files, the columns of their channels, and the drive's own units."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from jointid.common.settings import add_settings_to_docstring, declare, setting, settings_of
from jointid.common.units import units_of
from jointid.config.table import Flag, Table, Text, accept_by, keys_from, refusal
from jointid.records.clock import CLOCK_TOLERANCE
from jointid.records.columns import Column
from jointid.records.drives import Drive
from jointid.records.formats import Table as RecordedTable
from jointid.records.formats import check_options, format_of, read_table
from jointid.records.joining import choose_resampling, join_files
from jointid.records.record import Channel, Injection
from jointid.records.resampling import Resampling

OPTIONS = ("delimiter", "decimal", "header")
"""The keys of [record] that are options of the format's reader."""

Delimiter = Annotated[Text, accept_by(lambda mark: check_options(delimiter=mark))]


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Source:
    """The file of the record, and how it is read; see `jointid.records.reading`."""

    file: str | None = setting(None, "path of the record, from the joint file's folder", accept=format_of)
    time: str | None = setting(
        None, "name of the time column; without it, and without a sample time, the column called t or time"
    )
    time_unit: str | None = setting(
        None, "unit of the time column; without it the one in its name, as in Time [ms], or s", choices=units_of("time")
    )
    sample_time: float | None = setting(
        None, "time between samples, where there is no time column; beside one the two must agree", unit="s", above=0
    )
    clock_tolerance: float = setting(
        CLOCK_TOLERANCE,
        "largest jitter of the time stamps that is not remarked on, as a share of the sample time",
        at_least=0,
    )
    start: float | None = setting(None, "first instant to read, of the log's own clock", unit="s")
    stop: float | None = setting(None, "last instant to read, of the log's own clock", unit="s")
    torque: Literal["logged", "from_controller"] | None = setting(
        None,
        "whether the torque is a channel of the record, or what the controller outputs for the motor position; without "
        "it logged, or for DIDIM from the controller where no torque channel is declared",
    )
    part: int | None = setting(
        None, "which part between jumps of the clock to read, counted from 1; 0 takes the longest", at_least=0
    )
    options: Mapping[str, Any] = field(default_factory=dict)  # of the format's reader
    resample: Resampling | None = setting(
        None,
        "to which uniform clock all channels are brought, and how; without it a clock that is not uniform is refused",
    )
    files: tuple[str, ...] = setting(
        (),
        "paths of a record in several files, such as positions and torques apart; they are joined on their clocks, and "
        "a column whose name an earlier file has is called FILE: NAME",
    )
    offsets: tuple[float, ...] = setting(
        (),
        "what to add to the clock of each of the files, where they do not share one",
        unit="s",
    )

    @property
    def first(self) -> str | None:
        """Path of the record, or of its first file."""
        return self.files[0] if self.files else self.file

    def read(self, path: str | os.PathLike[str], folder: Path) -> RecordedTable:
        """Read the table of a record; the path of the first file stands for all of them."""
        if not self.files or Path(path) != folder / self.files[0]:
            return read_table(path, **self.options)
        paths = [folder / file for file in self.files]
        return join_files(
            paths,
            offsets=self.offsets,
            time=self.time,
            time_unit=self.time_unit,
            sample_time=self.sample_time,
            **self.options,
        )

    def reading(self, table: RecordedTable) -> dict[str, Any]:
        """Return how a table is read, where it was joined: every column has its clock."""
        if not (self.files and table.clocks):
            return {}
        joined = {"time": None, "time_unit": None, "sample_time": None}
        return joined if self.resample else joined | {"resample": choose_resampling(table)}


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Run:
    """One of several records that are identified together."""

    file: str = field(metadata=declare("path of the record, from the joint file's folder", accept=format_of))
    added_inertia: float = setting(
        0.0,
        "what is known to have been added to the load, as it is there, beyond what is shared",
        unit="kg or kg m2",
        at_least=0,
    )
    own: tuple[str, ...] = setting(
        (),
        "names of parameters of this record's own, which the others do not share; the motor's state at the first "
        "sample always is",
    )
    controller: Mapping[str, float] = field(
        default_factory=dict,
        metadata=declare("numbers of the controller that were others in this record, by the keys of [controller]"),
    )


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Together:
    """How several records are identified together."""

    free: tuple[str, ...] = setting((), "names of what surrounds the joint and is identified too")
    weighting: Literal["spectrum", "level"] = setting(
        "spectrum", "what of their record's residual the rows are weighed by"
    )


def _all_but(*kept: str) -> list[str]:
    return [one.name for one in settings_of(Column) if one.name not in kept]


_OF_ONE = ("tap", "at", "in_torque")  # settings of a column that one channel alone has


@keys_from(Column, without=_OF_ONE, types={"column": (Text, None)})
class ChannelTable(Table):
    """[record.channels.reference] and its like: the column of one channel."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a clock that is given twice."""
        if self.time is not None and self.sample_time is not None:
            yield "time", f' is "{self.time}" beside sample_time = {self.sample_time:g}; keep one of them.'


@keys_from(Column, without=_all_but("tap"))
class TorqueTable(ChannelTable):
    """[record.channels.torque]."""


@keys_from(Column, without=_all_but("at", "in_torque"))
class InjectedTable(ChannelTable):
    """[record.channels.injected]: a known signal added to the controller's output."""

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an impossible injection."""
        yield from super().faults()
        any_signal = Channel(np.zeros(1), "N", 1.0)
        if refused := refusal(lambda: Injection(any_signal, self.build().at, self.in_torque)):
            yield "in_torque", refused


class ChannelsTable(Table):
    """[record.channels]: where the record's channels are found."""

    torque: TorqueTable | None = Field(None, description="motor torque or force")
    reference: ChannelTable | None = Field(None, description="commanded position, motor side")
    reference_velocity: ChannelTable | None = Field(None, description="commanded velocity")
    motor_position: ChannelTable | None = Field(None, description="motor encoder")
    load_position: ChannelTable | None = Field(None, description="load encoder")
    injected: InjectedTable | None = Field(None, description="known signal added to the controller's output")


@keys_from(Resampling)
class ResampleTable(Table):
    """record.resample: to which uniform clock all channels are brought, and how."""


@keys_from(Source, types={"resample": (ResampleTable, None)})
class RecordTable(Table):
    """[record]: the file of the record, and how it is read."""

    delimiter: Delimiter | None = Field(
        None, description='character between the cells of a text file; " " is any run of blanks; without it found'
    )
    decimal: Literal[".", ","] | None = Field(None, description="decimal mark of a text file; without it found")
    header: Flag | None = Field(
        None, description="whether a line above the numbers of a text file names the columns; without it found"
    )
    channels: ChannelsTable = Field(default_factory=ChannelsTable, description="where the channels are found")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the fault of an option that the file's format does not have."""
        if self.file is not None and self.files:
            yield "files", f' stands beside file = "{self.file}"; keep one of them.'
        for file in self.files or ():
            if refused := refusal(partial(format_of, file, **self.options())):
                yield "files", refused
        if self.offsets and len(self.offsets) != len(self.files or ()):
            said = f"{len(self.offsets)} numbers for {len(self.files or ())} files"
            yield "offsets", f" has {said}; give one for each file, or none."
        if self.file is not None and (refused := refusal(partial(format_of, self.file, **self.options()))):
            yield "file", refused

    def options(self) -> dict[str, Any]:
        """Return the options of the format's reader that are given."""
        return {key: value for key, value in self.given_values().items() if key in OPTIONS}

    def build(self) -> Source:
        """Return the file of the record, and how it is read."""
        options = self.options()
        resample = None if self.resample is None else self.resample.build()
        return Source(**self.given_values("channels", "resample", *options), resample=resample, options=options)


@keys_from(Drive, without=("torque_constant", "torque_per_volt"))
class DriveTable(Table):
    """[drive]: whose traces the record is made of, and the numbers behind the drive's own units."""

    ambiguous: ClassVar = {
        "torque_constant": " is said once, for torque and controller: write it below [joint], as "
        'torque_constant = "0.72 N m/A".'
    }


@keys_from(Run)
class RunTable(Table):
    """[[records]]: one of several records that are identified together, and what is known to differ in it."""


@keys_from(Together)
class TogetherTable(Table):
    """[together]: how several records are identified together."""
