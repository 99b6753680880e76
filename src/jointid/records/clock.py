"""Clocks of a table: sample time and deviation of time stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise
from jointid.records.columns import unit_fault, unit_in_name
from jointid.records.formats import Table
from jointid.records.formats.table import TIME_NAME
from jointid.records.record import Irregularity

CLOCK_TOLERANCE = 0.05
"""Largest jitter of a time stamp step, as a share of the sample time.

A twentieth of a sample is well below the half sample by which a held and an averaged torque differ, and well
above the jitter of good loggers (0.004 % in EMPS) and of stamps rounded to a microsecond at 10 kHz (1 %).
"""

# Clocks of drives and computers differ by 0.01 %; a wrong rate is wrong by far more.
_RATE_TOLERANCE = 1e-3
_LATEST = 1e30  # of a time stamp, in any unit; above, the square of a step has no end
_JUMP = 0.5  # of the sample time: a step this far from it is a jump, with samples missing or doubled
_GAP = 1.75  # sample times from which on a step leaves out samples: two stamps 30 % early and late are 1.6 apart


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """The stamps of a channel.

    Attributes:
        sample_time: mean time between them [s].
        stamps: (samples,) [s].
        column: name of the time column; empty if there is none.
        jitter: largest deviation of a step from the sample time, as a share of it; 0 within the tolerance.
        first: instant of the first row of the file [s].
    """

    sample_time: float
    stamps: FloatArray
    column: str = ""
    jitter: float = 0.0
    first: float = 0.0

    def over(self, samples: int) -> Clock:
        """Return the clock of a column's first samples."""
        return self if self.column else replace(self, stamps=self.stamps[:samples])

    def pick(self, rows: NDArray[np.bool_]) -> Clock:
        """Return the clock of some rows, (samples,), at the distance of the first two."""
        first, second = np.flatnonzero(rows)[:2]
        return replace(self, stamps=self.stamps[rows], sample_time=float(second - first) * self.sample_time)

    @property
    def beginning(self) -> float:
        """Instant of the first sample [s], by the straight line through the stamps."""
        return float(self.straightened()[0])

    def straightened(self) -> FloatArray:
        """Return the straight line through the stamps [s], (samples,)."""
        times, centred = self.stamps - self.stamps[0], np.arange(self.stamps.size) - 0.5 * (self.stamps.size - 1)
        slope = float(centred @ times / (float(centred @ centred) or 1.0))
        return np.asarray(float(self.stamps[0]) + float(np.mean(times)) + slope * centred)


def uniform_clock(sample_time: float, samples: int, first: float = 0.0) -> Clock:
    """Return the clock of samples without stamps, from `first` on [s]."""
    if not 0 < sample_time < np.inf:
        raise RecordError(f"The sample time is a positive number of seconds; got {sample_time:g}.")
    return Clock(sample_time, np.asarray(first + np.arange(samples) * sample_time, dtype=np.float64), first=first)


def find_clock(
    table: Table, time: str | None, time_unit: str | None, sample_time: float | None, tolerance: float | None
) -> Clock:
    """Determine a table's clock.

    Args:
        table: of the samples.
        time: name of the time column; None takes the only one called t or time.
        time_unit: None takes the unit in the name, or else s.
        sample_time: seconds; without `time` it alone counts.
        tolerance: largest jitter that is not remarked on, as a share of the sample time; None for stamps that are
            resampled.

    Raises:
        RecordError: there is none, or it is at fault.
    """
    if sample_time is not None and time is None:
        return uniform_clock(sample_time, table.rows)
    names = [name for name in table.columns if name == time or (time is None and TIME_NAME.fullmatch(name))]
    if len(names) != 1:
        why = table.explain_missing([time] if time else (one for one in table.passed if TIME_NAME.fullmatch(one)))
        called = f'"{time}"' if time else 'that alone is called "t" or "time"'
        raise RecordError(
            f"{table.source} has no time column {called}{why}; it has {table.list_columns()}: give sample_time, or the "
            "name of the time column as time."
        )
    (column,) = names
    stamps = table.columns[column] * seconds_of(table, column, time_unit)
    if faults := clock_faults(stamps, tolerance, f'The time column "{column}"'):
        raise RecordError(faults)
    first, count = float(stamps[1] - stamps[0]), stamps.size - 1
    jitter = float(np.max(np.abs(np.diff(stamps) * count / (stamps[-1] - stamps[0]) - 1))) if tolerance else 0.0
    if tolerance is None or jitter > tolerance:
        period = measure_irregularity(stamps).sample_time
    elif np.array_equal(stamps[0] + np.arange(stamps.size) * first, stamps):
        period = first  # stamps that were computed give their sample time back to the last bit
    else:  # the mean over the record is better than any one step; its thirteenth digit is rounding
        period = float(f"{(stamps[-1] - stamps[0]) / count:.12g}")
    if sample_time is not None and not is_same_rate(sample_time, period):
        raise RecordError(
            f'The sample time is given as {sample_time:g} s, and column "{column}" has {period:g} s; '
            "mend one, or leave sample_time or time out."
        )
    jitter = jitter if jitter > (tolerance or 0.0) else 0.0
    return Clock(sample_time or period, stamps, column, jitter, float(stamps[0]))


def seconds_of(table: Table, column: str, time_unit: str | None) -> float:
    """Return the seconds of a time column's unit: as given, else known in its name or of the file, else as stated.

    Raises:
        RecordError: the unit is unknown, or contradicts the one in the column's name.
    """
    known = units.units_of("time")
    named, stated = unit_in_name(column, known), units.normalise_unit(table.units.get(column, ""))
    # "time [hh:mm:ss]" was counted in seconds.
    unit = time_unit or next((one for one in (named, stated) if one in known), named or stated or "s")
    if unit not in known or (named is not None and time_unit not in (None, named)):
        raise RecordError(unit_fault(f'time (column "{column}")', unit, known))
    return units.unit(unit).factor


def cut_table(
    table: Table, time: str | None, time_unit: str | None, sample_time: float | None, cut: Cut, *, repaired: bool
) -> tuple[Table, list[str]]:
    """Leave out repeated whole rows and samples outside of a cut; return remarks on the former.

    Each column is cut by its clock. Rows are left out only if `repaired`, and where every repeated stamp is of one.

    Raises:
        RecordError: a cut has no clock, or leaves fewer than two samples.
    """
    columns, remarks, own = dict(table.columns), list[str](), own_clocks(table, time)
    common = time or next((name for name in table.columns if TIME_NAME.fullmatch(name)), None)
    common = None if sample_time is not None and time is None else common
    if cut != Cut() and common is None and sample_time is None and not own:
        raise RecordError(
            f"start, stop and part cut {table.source} by its clock, and no time column was found; name it as time, or "
            "give sample_time."
        )
    own |= {clock: clock for clock in own.values()}  # a time column is cut with the columns that it stamps
    for clock in dict.fromkeys([common, *own.values()]):
        stamps = columns.get(clock) if clock else np.asarray(np.arange(table.rows) * (sample_time or math.nan))
        if stamps is None or stamps.size < 2 or not np.isfinite(stamps).all():
            continue
        names = [n for n, one in columns.items() if own.get(n, common) == clock and one.size == stamps.size]
        names += [clock] if clock and clock not in names else []
        kept, again = np.ones(stamps.size, dtype=bool), np.flatnonzero(np.diff(stamps) == 0) + 1
        repeats = all(np.array_equal(columns[n][again], columns[n][again - 1], equal_nan=True) for n in names)
        if repaired and again.size and repeats:
            kept[again] = False
            remarks.append(
                f"{table.source} repeats {pluralise(again.size, 'whole row')}, the first after sample {again[0] - 1}: "
                "left out"
            )
        if cut != Cut():
            seconds = seconds_of(table, clock, time_unit) if clock else 1.0
            kept[kept] = cut.find_rows(stamps[kept] * seconds, clock or "the clock")
        columns |= {name: columns[name][kept] for name in names}
    return (table if not remarks and cut == Cut() else replace(table, columns=columns)), remarks


def own_clocks(table: Table, time: str | None) -> dict[str, str]:
    """Return the time column of each column that has its own; none where one is named for a file of one clock."""
    one_named = time is not None and len(set(table.clocks.values())) == 1
    return {} if one_named else dict(table.clocks)


@dataclass(frozen=True, slots=True)
class Cut:
    """The rows of a table to read: from `start` to `stop` of the log's own clock [s], of these a part between jumps."""

    start: float | None = None
    stop: float | None = None
    part: int | None = None

    def find_rows(self, times: FloatArray, clock: str) -> NDArray[np.bool_]:
        """Return which of the rows of a clock [s] are read, (samples,).

        Raises:
            RecordError: fewer than two are, or there is no such part.
        """
        first = -math.inf if self.start is None else self.start
        last = math.inf if self.stop is None else self.stop
        kept = (times >= first) & (times <= last)
        rows = np.flatnonzero(kept)
        parts = find_parts(times[rows]) if self.part is not None else [(0, rows.size)]
        if rows.size < 2 or (self.part or 0) > len(parts):
            raise RecordError(
                f"start and stop leave {pluralise(rows.size, 'sample')} of {clock}, which goes from {times.min():.10g} "
                f"to {times.max():.10g} s, with {pluralise(len(parts), 'part')} between its jumps; give two instants "
                "in there, and a part of these or 0 for the longest."
            )
        begin, end = parts[self.part - 1] if self.part else max(parts, key=lambda one: one[1] - one[0])
        kept[rows[:begin]] = kept[rows[end:]] = False
        return kept


def find_parts(stamps: FloatArray) -> list[tuple[int, int]]:
    """First sample and end of each part between the jumps of stamps (samples,)."""
    steps = np.diff(stamps)
    typical = float(np.median(steps[steps > 0])) if np.any(steps > 0) else math.inf
    jumps = np.flatnonzero(np.abs(steps / typical - 1) > _JUMP) + 1
    return list(pairwise([0, *jumps.tolist(), stamps.size]))


def is_same_rate(sample_time: float, other: float) -> bool:
    """Return True if two sample times are equal within `_RATE_TOLERANCE`."""
    return abs(sample_time / other - 1) <= _RATE_TOLERANCE


def measure_irregularity(stamps: FloatArray) -> Irregularity:
    """Measure the deviation of stamps [s], (samples,), from a uniform clock.

    Repeated stamps do not count as samples, backward ones do.
    """
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    typical = float(np.median(forward)) if forward.size else 1.0
    skipped = np.where(steps >= _GAP * typical, np.maximum(np.round(steps / typical), 1), steps != 0)
    number = np.concatenate([[0.0], np.cumsum(skipped)])
    centred, times = number - number.mean(), stamps - stamps.mean()
    period = float(centred @ times / (centred @ centred))
    off = times - period * centred
    return Irregularity(
        sample_time=period,
        largest=float(np.abs(off).max()),
        rms=float(np.sqrt(np.mean(off**2))),
        gaps=int(np.count_nonzero(skipped > 1)),
        longest_gap=int(skipped.max()) - 1,
    )


@np.errstate(over="ignore", invalid="ignore")
def clock_faults(stamps: FloatArray, tolerance: float | None = CLOCK_TOLERANCE, name: str = "The time") -> list[str]:
    """Return the fault of a clock that repeats, runs backward or jumps.

    The sample time is the median step. A step off by more than half a sample time is a jump, otherwise jitter.

    Args:
        stamps: time stamps [s], (samples,).
        tolerance: largest jitter, as a share of the sample time, if above a half; None for stamps that are resampled,
            which may jump.
        name: of the clock, in sentences.
    """
    steps = np.diff(stamps)
    sample_time, largest = float(np.median(steps)) if steps.size else 0.0, float(np.max(np.abs(stamps), initial=0.0))
    if not (largest <= _LATEST and sample_time >= 1 / _LATEST):
        return [
            f"{name} does not run forward: of its {stamps.size} stamps {np.count_nonzero(~np.isfinite(stamps))} are no "
            f"numbers, {np.count_nonzero(steps == 0)} repeat, {np.count_nonzero(steps < 0)} step back, and the largest "
            f"is {largest:.3g} s; name another time column, give its unit, or give sample_time without time."
        ]
    jumps = np.flatnonzero(np.abs(steps / sample_time - 1) > max(_JUMP, tolerance or 0.0))
    if tolerance is None or not jumps.size:
        return []
    return [
        f"{name} jumps {pluralise(jumps.size, 'time')}, first after sample {jumps[0]} (t = {stamps[jumps[0]]:g} s) by "
        f"{steps[jumps[0]]:g} s (expected {sample_time:g} s); give part = 0 for the longest part between the jumps, "
        "or resample to bridge short gaps; if only the stamps are wrong, give sample_time without time."
    ]
