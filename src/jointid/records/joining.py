"""A record in several files: their columns, each with the clock of its file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.clock import Clock, find_stamps, fit_clock
from jointid.records.formats import Table, read_table
from jointid.records.resampling import Resampling

_TOGETHER = 0.5  # of the shorter file, that two files cover together at least
_SAME = 1e-6  # of a sample time


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

    A column whose name an earlier file has is called "file: name". Files that cover the same instants have one clock;
    the clocks of others are moved by their offsets.

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
    tables = [read_table(path, **options) for path in paths]
    clocks = [_find_clock(table, time, time_unit, sample_time) for table in tables]
    apart = [k for k in range(1, len(tables)) if not _share_clock(tables[0], clocks[0], tables[k], clocks[k])]
    if apart and not offsets:
        raise RecordError(
            f"{tables[0].source} and {tables[apart[0]].source} have no clock in common; give record.offsets: the "
            "seconds to add to the clock of each file."
        )
    joined, kept = Table(source=" and ".join(table.source for table in tables)), dict[str, FloatArray]()
    for path, table, own, offset in zip(paths, tables, clocks, offsets or [0.0] * len(tables), strict=True):
        name, stamps = Path(path).stem, own.stamps + offset
        time = next((n for n, one in kept.items() if _is_same(one, stamps, own.sample_time)), f"time of {name}")
        if time not in kept:
            kept[time] = stamps
            joined.add(time, stamps.copy(), "s")
        for column, values in table.columns.items():
            renamed = f"{name}: {column}" if column in joined.columns else column
            joined.add(renamed, values, table.units.get(column, ""), time)
        joined.passed |= {f"{name}: {column}": why for column, why in table.passed.items()}
    return joined.require_numbers()


def choose_resampling(table: Table) -> Resampling | None:
    """Return how the columns of several clocks come to the fastest of them; None for a single clock."""
    clocks = sorted(set(table.clocks.values()))
    periods = [float(np.median(np.diff(table.columns[name]))) for name in clocks]
    return Resampling(min(periods), "linear") if len(clocks) > 1 else None


def _find_clock(table: Table, time: str | None, time_unit: str | None, sample_time: float | None) -> Clock:
    own = set(table.clocks.values())
    if len(own) > 1:
        raise RecordError(f"{table.source} has {len(own)} clocks; join files of one clock each.")
    named = next(iter(own), None) if time not in table.columns else time
    stated = None if named else sample_time
    return fit_clock(*find_stamps(table, named, time_unit, stated), stated, resampled=True)


def _share_clock(first: Table, one: Clock, second: Table, other: Clock) -> bool:
    """Test whether two files overlap in time and agree in their common channels, each perhaps from its own 0."""
    both = min(one.stamps[-1], other.stamps[-1]) - max(one.stamps[0], other.stamps[0])
    shorter = min(np.ptp(one.stamps), np.ptp(other.stamps))
    if not (one.column and other.column and both >= _TOGETHER * shorter):
        return False
    common = [name for name in first.columns if name in second.columns and name not in (one.column, other.column)]
    from_zero = all(abs(clock.stamps[0]) <= clock.sample_time for clock in (one, other))
    return not from_zero or all(np.array_equal(first.columns[n], second.columns[n], equal_nan=True) for n in common)


def _is_same(stamps: FloatArray, other: FloatArray, period: float) -> bool:
    return stamps.size == other.size and bool(np.all(np.abs(stamps - other) <= _SAME * period))
