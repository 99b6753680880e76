"""Inspect a file: size, unit, clock, range, sparkline per channel."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.charts import MEASURED, Charted, band, label, line, panels
from jointid.common.document import Block, Document, Documented, Listing, Paragraph, Table
from jointid.common.text import number, pluralise, show
from jointid.records.columns import unit_in_name
from jointid.records.formats import format_of, read_table
from jointid.records.formats.table import STAMP_NAME
from jointid.records.recognition import Recognised, recognise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TIME = re.compile(rf"(?:.*[/._ ])?{STAMP_NAME.pattern}", re.IGNORECASE)
_LEVELS = "▁▂▃▄▅▆▇█"
_SPARKLINE = 24  # characters
_ROUNDING = 1e-3  # per cent of jitter; what is less is of the clock's digits
_MOSTLY = 0.05  # of the steps of a clock, that may repeat a stamp or run backward
_STEPS, _PARTS = re.compile(r"[/.]"), 32  # what parts a path, and how often at most
_CLOCKS = 100  # of a file, among which those of other columns are sought
_LONGEST = 60  # characters of a name in the table
_LISTED = 1000  # channels; who has more of them reads them by a program
_DRAWN = 90  # channels; more would be illegible
_ACROSS = 3  # of their panels
_TITLE = 40  # characters of the title of one
_STRETCHES = 1024  # that are kept at most, of equal length; a power of two


@dataclass(frozen=True, slots=True)
class InspectedChannel:
    """One column of a file.

    Attributes:
        name: as the file has it.
        unit: that the file or the name states, None without one; it need not be one that is known here.
        outline: its numbers in short.
        time: the column that is taken for its clock, None where none is recognised; of a clock its own name.
        sample_time: mean time between its samples in seconds, None without a clock.
        jitter: largest deviation of a step of the clock from that, as a share of it; None without a clock.
    """

    name: str
    unit: str | None
    outline: Outline
    time: str | None = None
    sample_time: float | None = None
    jitter: float | None = None

    @property
    def is_time(self) -> bool:
        """True if the channel is a clock itself."""
        return self.time == self.name


@dataclass(frozen=True, slots=True)
class Inspection(Charted, Documented):
    """Contents of a file.

    Attributes:
        file: its name.
        format: what it is.
        size: bytes; of a folder those of all its files.
        channels: its columns.
        scalars: its single numbers.
        passed: what looks like a column and is not read, and why.
        recognised: whose log it is; None where no profile of a drive has its names.
    """

    file: str
    format: str
    size: int
    channels: tuple[InspectedChannel, ...]
    scalars: Mapping[str, float]
    passed: Mapping[str, str]
    recognised: Recognised | None = None

    def to_document(self, *, details: bool = False) -> Document:
        """Table of channels, scalars, skipped content and clocks.

        Only the first 1,000 channels are listed.
        """
        del details
        header = ("channel", "rows", "unit", "sample time", "min", "max", "NaN", "picture")
        rows = tuple(map(_table_row, self.channels[:_LISTED]))
        blocks: list[Block] = [Table(header, rows, words=(0, 2, 7))] if rows else []
        if more := len(self.channels) - len(rows):
            blocks.append(Paragraph(f"and {pluralise(more, 'more channel')}, which --json lists, too"))
        if self.scalars:
            numbers = ", ".join(f"{show(n)} {v:.6g}" for n, v in self.scalars.items())
            blocks.append(Paragraph(f"single numbers: {numbers}"))
        if self.passed:
            blocks.append(Listing(tuple(f"not read: {show(name)} ({show(why)})" for name, why in self.passed.items())))
        title = f"{show(self.file)}: {self.format}, {self.size} bytes, {len(self.channels)} channels"
        if self.recognised is not None:
            blocks.append(Paragraph(show(self.recognised.sentence)))
        return Document(title, (*blocks, Listing(tuple(self.clocks()))))

    def draw(self) -> Figure:
        """Draw the range of each channel over time.

        Only the first 90 channels are drawn, as the title says.
        """
        every = [channel for channel in self.channels if not channel.is_time] or list(self.channels)
        drawn = every[:_DRAWN]
        count = f"{len(drawn)} of {len(every)} channels" if len(drawn) < len(every) else f"{len(drawn)} channels"
        across = min(_ACROSS, max(len(drawn), 1))
        figure, places = panels([170] * len(drawn), across, title=f"{show(self.file)}: {count}")
        for axes, channel in zip(places, drawn, strict=True):
            outline = channel.outline
            seconds = channel.sample_time if np.isfinite(channel.sample_time or np.nan) else None
            rows = (np.arange(outline.low.size) + 0.5 * (outline.length > 1)) * outline.length
            place = np.asarray(rows * (seconds or 1.0), dtype=np.float64)
            name = show(channel.name)
            short = name if len(name) <= _TITLE else f"...{name[3 - _TITLE :]}"
            band(axes, place, outline.low, outline.high, MEASURED)
            line(axes, place, (outline.low + outline.high) / 2, MEASURED, "", 1.0)
            title = f"{short} [{show(channel.unit)}]" if channel.unit else short
            label(axes, "time [s]" if seconds else "row", "", title)
        return figure

    def clocks(self) -> list[str]:
        """Return a sentence on each clock."""
        said, timed = list[str](), Counter(channel.time for channel in self.channels)
        for clock in self.channels:
            if clock.is_time and clock.sample_time is not None and clock.jitter is not None:
                stalls = clock.outline.stalls
                back = f"; {pluralise(stalls, 'stamp')} repeated or earlier" if stalls else ""
                said.append(
                    f"{show(clock.name)} is the time of {pluralise(timed[clock.name] - 1, 'channel')}: a sample every "
                    f"{clock.sample_time:.6g} s, the steps within {max(100 * clock.jitter, _ROUNDING):.2g} % of that"
                    f"{back}."
                )
        return said or ["No channel is recognised as time; give the joint file a sample_time, or the column's name."]


def inspect(path: str | os.PathLike[str], **options: object) -> Inspection:
    """Inspect a file of any format.

    A clock is a rising column in a unit of time whose name ends in t, time, timestamp or stamp. Other columns take the
    clock of their format, or the clock of their length that shares the longest path prefix.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        options: of the format's reader; see `jointid.records.formats.TextOptions`.

    Raises:
        RecordError: the file is missing or cannot be read.
    """
    path = Path(path)
    table = read_table(path, **options)
    outlines, declared = {name: draw_outline(values) for name, values in table.columns.items()}, table.clocks
    of_time = units.units_of("time")
    stated = {name: unit for name in outlines if (unit := table.units.get(name) or unit_in_name(name, of_time))}
    clocks = {
        name: outline
        for name, outline in outlines.items()
        if (_TIME.fullmatch(name) or name in declared.values())
        and (name not in stated or units.normalise_unit(stated[name]) in of_time)
        and outline.step > 0
        and outline.stalls <= _MOSTLY * (outline.rows - 1)
    }
    channels = []
    for name, outline in outlines.items():
        channel = InspectedChannel(name, stated.get(name), outline)
        clock = name if name in clocks else declared.get(name) or _find_clock(name, outline.rows, clocks)
        if clock is not None and clock in clocks:
            seconds = units.unit(units.normalise_unit(stated.get(clock) or "s")).factor
            step, jitter = clocks[clock].step, clocks[clock].jitter
            channel = replace(channel, time=clock, sample_time=step * seconds, jitter=jitter)
        channels.append(channel)
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    recognised = recognise(tuple(outlines))
    return Inspection(path.name, format_of(path).name, size, tuple(channels), table.scalars, table.passed, recognised)


def _find_clock(name: str, rows: int, clocks: Mapping[str, Outline]) -> str | None:
    """Find the clock of so many rows whose path begins most like a column's; None if missing or ambiguous."""
    if len(clocks) > _CLOCKS:
        return None
    parts = _STEPS.split(name, _PARTS)
    shared = {
        clock: len(
            list(takewhile(lambda pair: pair[0] == pair[1], zip(parts, _STEPS.split(clock, _PARTS), strict=False)))
        )
        for clock, outline in clocks.items()
        if outline.rows == rows
    }
    nearest = [clock for clock, count in shared.items() if count == max(shared.values())]
    return nearest[0] if len(nearest) == 1 else None


def _table_row(channel: InspectedChannel) -> tuple[str, ...]:
    outline = channel.outline
    name = show(channel.name)
    return (
        name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}...",
        str(outline.rows),
        show(channel.unit or "-"),
        "-" if channel.sample_time is None else f"{channel.sample_time:.6g} s",
        number(outline.minimum),
        number(outline.maximum),
        str(outline.missing),
        "time" if channel.is_time else draw_sparkline(outline),
    )


def draw_sparkline(outline: Outline) -> str:
    """Draw the extreme value of each stretch as a line of blocks."""
    if outline.minimum is None or outline.maximum is None or not math.isfinite(outline.maximum - outline.minimum):
        return ""
    middle, span = (outline.minimum + outline.maximum) / 2, outline.maximum - outline.minimum
    marks = []
    for low, high in outline.stretches(_SPARKLINE):
        if not math.isfinite(low):
            marks.append(" ")
            continue
        far = high if high - middle >= middle - low else low
        marks.append(_LEVELS[min(int((far - outline.minimum) / span * len(_LEVELS)), 7)] if span else _LEVELS[0])
    return "".join(marks)


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A summarised signal.

    Attributes:
        rows: how many numbers it has, NaN included.
        missing: how many of them are NaN.
        minimum, maximum: of the others; None where all are missing.
        stalls: numbers that are not larger than the one before.
        step: mean difference between neighbours.
        jitter: largest deviation of such a difference from the mean, as a share of it; NaN where the mean is 0.
        low, high: smallest and largest of every stretch, shape (stretches,); NaN where all of it is missing.
        length: numbers of a stretch; the last one may have fewer.
    """

    rows: int
    missing: int
    minimum: float | None
    maximum: float | None
    stalls: int
    step: float
    jitter: float
    low: FloatArray
    high: FloatArray
    length: int

    def stretches(self, count: int) -> list[tuple[float, float]]:
        """Range of at most `count` stretches."""
        count = min(count, self.low.size)
        starts = np.arange(count) * self.low.size // count
        low, high = np.fmin.reduceat(self.low, starts), np.fmax.reduceat(self.high, starts)
        return list(zip(low.tolist(), high.tolist(), strict=True))


def draw_outline(values: FloatArray) -> Outline:
    """Summarise a signal, shape (samples,), of one number or more."""
    with np.errstate(invalid="ignore", over="ignore"):  # infinite numbers have no difference
        steps = np.diff(values)
    step = float(values[-1] - values[0]) / steps.size if steps.size else 0.0
    jitter = float(max(steps.max() - step, step - steps.min()) / step) if step else math.nan
    length = 1
    while values.size > _STRETCHES * length:
        length *= 2
    starts, missing = np.arange(0, values.size, length), int(np.count_nonzero(np.isnan(values)))
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    there = missing < values.size
    return Outline(
        values.size,
        missing,
        float(np.fmin.reduce(low)) if there else None,
        float(np.fmax.reduce(high)) if there else None,
        int(np.count_nonzero(~(steps > 0))),
        step,
        jitter,
        low,
        high,
        length,
    )
