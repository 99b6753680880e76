"""Inspect a file: size, unit, clock, range and a sparkline of every channel, in bounded memory."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jointid.common import units
from jointid.common.document import Block, Document, Documented, Listing, Paragraph, Table
from jointid.common.text import number, shown
from jointid.records.columns import unit_in_name
from jointid.records.files.outline import Outline, OutlineBuilder
from jointid.records.formats import format_of, read_tables

_ROWS = 65536  # that are in memory at once, where the format allows it
_TIME = re.compile(r"(?:.*[/._ ])?(?:t|time|timestamp|stamp)\s*(?:[\[(].*[\])])?", re.IGNORECASE)
_LEVELS = "▁▂▃▄▅▆▇█"
_SPARKLINE = 24  # characters
_ROUNDING = 1e-3  # per cent of jitter; what is less is of the clock's digits
_LONGEST = 60  # characters of a name in the table


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
class Inspection(Documented):
    """Contents of a file.

    Attributes:
        file: its name.
        format: what it is.
        size: bytes; of a folder those of all its files.
        channels: its columns.
        scalars: its single numbers.
        passed: what looks like a column and is not read, and why.
    """

    file: str
    format: str
    size: int
    channels: tuple[InspectedChannel, ...]
    scalars: Mapping[str, float]
    passed: Mapping[str, str]

    def document(self, *, details: bool = False) -> Document:
        """Return the table of the channels, single numbers, what is not read, and the clocks; all of it always."""
        del details
        header = ("channel", "rows", "unit", "sample time", "min", "max", "NaN", "picture")
        rows = tuple(map(_table_row, self.channels))
        blocks: list[Block] = [Table(header, rows, words=(0, 2, 7))] if rows else []
        if self.scalars:
            numbers = ", ".join(f"{shown(n)} {v:.6g}" for n, v in self.scalars.items())
            blocks.append(Paragraph(f"single numbers: {numbers}"))
        if self.passed:
            blocks.append(
                Listing(tuple(f"not read: {shown(name)} ({shown(why)})" for name, why in self.passed.items()))
            )
        title = f"{shown(self.file)}: {self.format}, {self.size} bytes, {len(self.channels)} channels"
        return Document(title, (*blocks, Listing(tuple(self.clocks()))))

    def clocks(self) -> list[str]:
        """Return a sentence on each clock."""
        said = []
        for clock in self.channels:
            if clock.is_time and clock.sample_time is not None and clock.jitter is not None:
                count = sum(channel.time == clock.name for channel in self.channels) - 1
                said.append(
                    f"{shown(clock.name)} is the time of {count} channel{'' if count == 1 else 's'}: a sample every "
                    f"{clock.sample_time:.6g} s, the steps within {max(100 * clock.jitter, _ROUNDING):.2g} % of that."
                )
        return said or ["No channel is recognised as time; give the joint file a sample_time, or the column's name."]


def inspect(path: str | os.PathLike[str], **options: object) -> Inspection:
    """Inspect a file of any format.

    A clock is a column whose name ends in t, time, timestamp or stamp, whose unit is one of time, and whose numbers
    only rise. A column belongs to the clock that its format gives it, or else to that of its length whose name has the
    longest beginning, up to a "/" or ".", in common with it. Where the format allows it, the file is read in chunks,
    and memory does not grow with it.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        options: of the format's reader; see `jointid.records.formats.Csv`.

    Raises:
        RecordError: there is no such file, or it cannot be read; the sentence says why.
    """
    path = Path(path)
    outlining: dict[str, OutlineBuilder] = {}
    stated, told = dict[str, str](), dict[str, str]()
    scalars, passed = dict[str, float](), dict[str, str]()
    for table in read_tables(path, _ROWS, **options):
        for name, values in table.columns.items():
            outlining.setdefault(name, OutlineBuilder()).take(values)
        stated.update(table.units)
        told.update(table.clocks)
        scalars, passed = dict(table.scalars), dict(table.passed)
    outlines = {name: made.build() for name, made in outlining.items()}
    known = units.units_of("time")
    channels = []
    clocks = {name: o for name, o in outlines.items() if _is_clock(name, o, _unit(name, stated))}
    for name, outline in outlines.items():
        clock = name if name in clocks else told.get(name) or _find_clock(name, outline, clocks)
        clock = clock if clock in clocks else None
        seconds = math.nan if clock is None else _seconds(_unit(clock, stated), known)
        if clock is None:
            channels.append(InspectedChannel(name, _unit(name, stated), outline))
        else:
            step, jitter = clocks[clock].step, clocks[clock].jitter
            channels.append(InspectedChannel(name, _unit(name, stated), outline, clock, step * seconds, jitter))
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    return Inspection(path.name, format_of(path).name, size, tuple(channels), scalars, passed)


def _unit(name: str, stated: Mapping[str, str]) -> str | None:
    return stated.get(name) or unit_in_name(name, units.units_of("time"))


def _seconds(unit: str | None, known: tuple[str, ...]) -> float:
    name = units.spelled(unit or "s")
    return units.unit(name).factor if name in known else math.nan


def _is_clock(name: str, outline: Outline, unit: str | None) -> bool:
    of_time = unit is None or units.spelled(unit) in units.units_of("time")
    return bool(_TIME.fullmatch(name)) and of_time and outline.rises and outline.rows > 1


def _find_clock(name: str, outline: Outline, clocks: Mapping[str, Outline]) -> str | None:
    """Return the clock of a column; None where there is none of its length that is nearest."""
    alike = {clock: _count_shared_parts(name, clock) for clock, other in clocks.items() if other.rows == outline.rows}
    best = [clock for clock, length in alike.items() if length == max(alike.values())]
    return best[0] if len(best) == 1 else None


def _count_shared_parts(name: str, clock: str) -> int:
    """Return how many parts two paths have in common; a clock "name/time" has all of the name's."""
    pairs = zip(re.split(r"[/.]", name), re.split(r"[/.]", clock), strict=False)
    return next((i for i, (one, other) in enumerate(pairs) if one != other), len(re.split(r"[/.]", name)))


def _table_row(channel: InspectedChannel) -> tuple[str, ...]:
    outline = channel.outline
    name = shown(channel.name)
    return (
        name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}...",
        str(outline.rows),
        shown(channel.unit or "-"),
        "-" if channel.sample_time is None else f"{channel.sample_time:.6g} s",
        number(outline.minimum),
        number(outline.maximum),
        str(outline.missing),
        "time" if channel.is_time else draw_sparkline(outline),
    )


def draw_sparkline(outline: Outline) -> str:
    """Return a line of blocks: of each stretch of a channel the number that is farthest from the channel's middle."""
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
