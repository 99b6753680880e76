"""A record in several files: their columns by one clock."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.clock import find_clock
from jointid.records.formats import Table, read_table
from jointid.records.formats.table import Found
from jointid.records.resampling import Resampling

_TOGETHER = 0.5  # of the shorter file, that two files cover together at least
_SAME = 1e-6  # of a sample time


@dataclass(frozen=True, slots=True)
class _Part:
    """One file: its table, the instants of its columns [s], and its sample time [s]."""

    name: str
    table: Table
    stamps: FloatArray
    period: float
    time: str

    @property
    def channels(self) -> Mapping[str, FloatArray]:
        """Columns that move, of the length of the clock."""
        every = ((n, v) for n, v in self.table.columns.items() if n != self.time and v.size == self.stamps.size)
        return {name: values for name, values in every if np.isfinite(values).all() and np.ptp(values) > 0}


def join_files(
    paths: Sequence[str | os.PathLike[str]],
    *,
    offsets: Sequence[float] = (),
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
    **options: object,
) -> Table:
    """Read several files as one table, each column with the clock of its file.

    A column whose name an earlier file has is called "file: name". Files that cover the same instants are joined on
    their stamps; the clocks of others are moved by their offsets.

    Args:
        paths: of the files.
        offsets: seconds to add to the clock of each file; without them all share one clock.
        time: name of the time column of each file; see `jointid.records.reading.read`.
        time_unit: of the time columns.
        sample_time: of files without a time column.
        options: of the format's reader.

    Raises:
        RecordError: a file cannot be read or has no clock, or the files have no clock in common.
    """
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        raise RecordError("The files of a record have one name each; two are called alike: rename one of them.")
    if offsets and len(offsets) != len(paths):
        raise RecordError(f"There are {len(offsets)} offsets for {len(paths)} files; give one for each file, or none.")
    parts = [
        _read_part(name, read_table(path, **options), time, time_unit, sample_time)
        for name, path in zip(names, paths, strict=True)
    ]
    for part in () if offsets else parts[1:]:
        _require_common_clock(parts[0], part)
    moved = zip(parts, offsets or [0.0] * len(parts), strict=True)
    return _join([replace(part, stamps=part.stamps + offset) for part, offset in moved])


def choose_resampling(table: Table) -> Resampling | None:
    """Return how the columns of several clocks come to the fastest of them; None for a single clock."""
    clocks = sorted(set(table.clocks.values()))
    if len(clocks) < 2:
        return None
    return Resampling(min(float(np.median(np.diff(table.columns[name]))) for name in clocks), "linear")


def _read_part(name: str, table: Table, time: str | None, time_unit: str | None, sample_time: float | None) -> _Part:
    own = set(table.clocks.values())
    if len(own) > 1:
        raise RecordError(f"{table.source} has {len(own)} clocks; join files of one clock each.")
    named = next(iter(own), None) if time not in table.columns else time
    clock = find_clock(table, named, time_unit, None if named else sample_time, None)
    assert clock.sample_time is not None
    stamps = np.arange(table.rows) * clock.sample_time if clock.stamps is None else clock.stamps
    return _Part(name, table, np.asarray(stamps, dtype=np.float64), clock.sample_time, clock.column)


def _require_common_clock(first: _Part, part: _Part) -> None:
    """Refuse two files whose clocks have different beginnings, as far as stamps and a channel of both tell."""
    both = min(first.stamps[-1], part.stamps[-1]) - max(first.stamps[0], part.stamps[0])
    shorter = min(one.stamps[-1] - one.stamps[0] for one in (first, part))
    shared = bool(first.time and part.time) and both >= _TOGETHER * shorter
    common = [name for name in part.channels if name in first.channels]
    own_zero = all(abs(one.stamps[0]) <= one.period for one in (first, part))
    equal = any(np.array_equal(first.channels[name], part.channels[name]) for name in common)
    if shared and (not (own_zero and common) or (equal and _is_same(first.stamps, part))):
        return
    fact = "count from 0 each, and differ in a channel that both hold" if shared else "have no clock in common"
    raise RecordError(
        f"{first.table.source} and {part.table.source} {fact}; give record.offsets: the seconds to add to the clock of "
        "each file."
    )


def _join(parts: Sequence[_Part]) -> Table:
    """Return all columns in one table; files of equal instants have one clock."""
    found, kept = Found(Path()), dict[str, FloatArray]()
    for part in parts:
        clock = next((name for name, stamps in kept.items() if _is_same(stamps, part)), f"time of {part.name}")
        if clock not in kept:
            kept[clock] = part.stamps
            found.add(clock, part.stamps.copy(), "s")
        for name, values in part.table.columns.items():
            own = f"{part.name}: {name}" if name in found.columns else name
            found.add(own, values, part.table.units.get(name, ""), clock)
        for name, why in part.table.passed.items():
            found.passed[f"{part.name}: {name}" if name in found.passed else name] = why
    return replace(found.table(), source=" and ".join(part.table.source for part in parts))


def _is_same(stamps: FloatArray, part: _Part) -> bool:
    return stamps.size == part.stamps.size and bool(np.all(np.abs(stamps - part.stamps) <= _SAME * part.period))
