"""[record] and [drive]: the file of the record, the columns of its channels, whose traces they are, its own units."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from jointid.config.table import Table, accepted, refusal
from jointid.config.values import ColumnGain, Count, Flag, Natural, NotNegative, Positive, Sign, Text, TimeUnit
from jointid.models.transmission import Side
from jointid.records.columns import Column
from jointid.records.drives.drive import Drive
from jointid.records.drives.profiles import load_profile, profile_names
from jointid.records.formats import Csv, format_of
from jointid.records.record import Channel, Injection
from jointid.records.time_base.resampling import Resampling
from jointid.records.time_base.uniformity import CLOCK_TOLERANCE

OPTIONS = ("delimiter", "decimal", "header")
"""The keys of [record] that are options of the format's reader."""

Delimiter = Annotated[Text, accepted(lambda mark: Csv(delimiter=mark))]
RecordFile = Annotated[Text, accepted(format_of)]


class ChannelTable(Table):
    """[record.channels.reference] and its like: the column of one channel."""

    column: Text | None = Field(None, description="name of the column in the record's file")
    unit: Text | None = Field(None, description="unit of gain x column")
    gain: ColumnGain = Field(1.0, description="what takes the column to the unit")
    sign: Sign = Field(1, description="-1 turns the channel round")
    timing: Literal["sampled", "held", "averaged"] | None = Field(None, description="what one value stands for")
    sample_time: Positive | None = Field(None, description="own time between samples [s]")
    time: Text | None = Field(None, description="name of its own time column")
    side: Side | None = Field(None, description="of the transmission, on which it is measured")
    wrap: Positive | None = Field(None, description="where the column wraps round, in its own numbers")
    update_time: Positive | None = Field(None, description="time between refreshes, if longer [s]")
    optional: Flag = Field(False, description="whether a record may lack this column")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a clock that is told twice."""
        if self.time is not None and self.sample_time is not None:
            yield "time", f' is "{self.time}" beside sample_time = {self.sample_time:g}; keep one of them.'

    def declared(self) -> Column:
        """Return the column that is declared."""
        return Column(**self.given())


class TorqueTable(ChannelTable):
    """[record.channels.torque]."""

    tap: Literal["command", "filtered", "measured"] | None = Field(None, description="where the torque was logged")


class InjectedTable(ChannelTable):
    """[record.channels.injected]: a known signal added to the controller's output."""

    at: Literal["before_limit", "after_limit"] = Field("after_limit", description="where the signal is added")
    in_torque: Flag = Field(True, description="whether the logged torque contains the signal")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that no such injection exists."""
        yield from super().faults()
        any_signal = Channel(np.zeros(1), "N", 1.0)
        if refused := refusal(lambda: Injection(any_signal, self.declared().at, self.in_torque)):
            yield "in_torque", refused


class ChannelsTable(Table):
    """[record.channels]: where the record's channels are found."""

    torque: TorqueTable | None = Field(None, description="motor torque or force")
    reference: ChannelTable | None = Field(None, description="commanded position, motor side")
    reference_velocity: ChannelTable | None = Field(None, description="commanded velocity")
    motor_position: ChannelTable | None = Field(None, description="motor encoder")
    load_position: ChannelTable | None = Field(None, description="load encoder")
    injected: InjectedTable | None = Field(None, description="known signal added to the controller's output")


class ResampleTable(Table):
    """record.resample: to which uniform clock all channels are brought, and how."""

    sample_time: Positive = Field(description="time between samples of the record [s]")
    method: Literal["hold", "linear", "cubic"] = Field(description="how sampled channels are taken between samples")
    held: Literal["hold", "linear", "cubic"] = Field("hold", description="how held channels are")
    longest_gap: Natural = Field(3, description="samples that may be missing in a row")

    def resampling(self) -> Resampling:
        """Return how channels are resampled."""
        return Resampling(**self.given())


class RecordTable(Table):
    """[record]: the file of the record, and how it is read."""

    file: RecordFile | None = Field(None, description="path of the record, from the joint file's folder")
    time: Text | None = Field(None, description="name of the time column")
    time_unit: TimeUnit | None = Field(None, description="unit of the time column")
    sample_time: Positive | None = Field(None, description="time between samples [s]")
    clock_tolerance: NotNegative = Field(CLOCK_TOLERANCE, description="largest jitter, as a share of the sample time")
    resample: ResampleTable | None = Field(None, description="what is done about a clock that is not uniform")
    delimiter: Delimiter | None = Field(None, description="character between the cells of a text file")
    decimal: Literal[".", ","] | None = Field(None, description="decimal mark of a text file")
    header: Flag | None = Field(None, description="whether a text file names its columns")
    channels: ChannelsTable = Field(default_factory=ChannelsTable, description="where the channels are found")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the file's format has no such option."""
        if self.file is not None and (refused := refusal(partial(format_of, self.file, **self.options()))):
            yield "file", refused

    def options(self) -> dict[str, Any]:
        """Return the options of the format's reader that are given."""
        return {key: value for key, value in self.given().items() if key in OPTIONS}


class DriveTable(Table):
    """[drive]: whose traces the record is made of, and the numbers behind the drive's own units."""

    profile: Annotated[Text, accepted(load_profile)] | None = Field(
        None,
        description="whose names, units, timing and tap the channels have",
        json_schema_extra={"enum": list(profile_names())},
    )
    axis: Count | None = Field(None, description="which axis, where a trace has several")
    rated_torque: Positive | None = Field(None, description="what per mille and per cent of a torque are of [N m or N]")
    rated_current: Positive | None = Field(None, description="the same as a current, beside the torque constant [A]")
    torque_constant: Positive | None = Field(None, description="torque per current [N m/A or N/A]")
    counts_per_turn: Positive | None = Field(None, description="of a revolute joint's encoder [counts]")
    counts_per_metre: Positive | None = Field(None, description="of a prismatic joint's encoder [counts]")
    load_counts_per_turn: Positive | None = Field(
        None, description="of the load's encoder, if it is another one [counts]"
    )
    load_counts_per_metre: Positive | None = Field(
        None, description="of the load's encoder, if it is another one that moves straight [counts]"
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield that the numbers contradict each other."""
        if refused := refusal(self.drive):
            yield "", refused

    def drive(self) -> Drive:
        """Return what is known of the drive."""
        return Drive(**self.given())
