"""Clocks of a table: sample time and deviation of time stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise
from jointid.records.columns import finite_faults, format_instant, unit_fault, unit_in_name
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
_NEAR = 0.05  # of a mean period over stamps with jumps or gaps
_LATEST = 1e30  # of a time stamp, in any unit; above, the square of a step has no end
_JUMP = 0.5  # of the sample time: a step this far from it is a jump, with samples missing or doubled
_BRIDGED = 3  # samples missing in a row that resampling bridges by default
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
    stamps: FloatArray = field(default_factory=lambda: np.zeros(0))
    column: str = ""
    jitter: float = 0.0
    first: float = 0.0

    def over(self, samples: int) -> Clock:
        """Return the clock with stamps for so many samples."""
        if self.column:
            return self
        return replace(self, stamps=np.asarray(self.first + np.arange(samples) * self.sample_time, dtype=np.float64))

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
        return np.asarray(float(self.stamps[0]) + float(np.mean(times)) + _mean_step(self.stamps) * centred)


def _mean_step(stamps: FloatArray) -> float:
    """Slope of the straight line through stamps [s]."""
    centred = np.arange(stamps.size) - 0.5 * (stamps.size - 1)
    return float(centred @ (stamps - stamps[0]) / (float(centred @ centred) or 1.0))


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
    if sample_time is not None and not 0 < sample_time < np.inf:
        raise RecordError(f"The sample time is a positive number of seconds; got {sample_time:g}.")
    if sample_time is not None and time is None:
        return Clock(sample_time)
    column, known = _find_time_column(table, time), units.units_of("time")
    named, unit = unit_in_name(column, known), _find_time_unit(table, column, time_unit)
    if time_unit is not None and named is not None and named != time_unit:
        raise RecordError(
            f'The time column "{column}" names its unit, and time_unit is "{time_unit}"; leave time_unit out, or '
            "rename the column."
        )
    if unit not in known:
        raise RecordError(unit_fault(f'time (column "{column}")', unit, known))
    stamps = table.columns[column] * units.unit(unit).factor
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


def _find_time_column(table: Table, time: str | None) -> str:
    if time is not None:
        if time not in table.columns:
            why = table.explain_missing([time])
            raise RecordError(f'{table.source} has no time column "{time}"{why}; it has {table.list_columns()}.')
        return time
    names = [name for name in table.columns if TIME_NAME.fullmatch(name)]
    if len(names) != 1:
        several = ", ".join(f'"{name}"' for name in names)
        why = table.explain_missing(name for name in table.passed if TIME_NAME.fullmatch(name))
        fact = f"more than one time column ({several})" if names else f'no column called "t" or "time"{why}'
        raise RecordError(f"{table.source} has {fact}; give sample_time, or the name of the time column as time.")
    return names[0]


def _find_time_unit(table: Table, column: str, time_unit: str | None) -> str:
    """Return the unit of a time column as it is given, else known in its name or of the file, else as stated there."""
    known = units.units_of("time")
    named, stated = unit_in_name(column, known), units.normalise_unit(table.units.get(column, ""))
    # "time [hh:mm:ss]" was counted in seconds.
    return time_unit or next((one for one in (named, stated) if one in known), named or stated or "s")


def cut_table(
    table: Table, time: str | None, time_unit: str | None, sample_time: float | None, cut: Cut, *, repaired: bool
) -> tuple[Table, list[str]]:
    """Leave out repeated whole rows and samples outside of a cut; return remarks on the former.

    Each column is cut by its clock. Rows are left out only if `repaired`, and where every repeated stamp is of one.

    Raises:
        RecordError: a cut has no clock, or leaves fewer than two samples.
    """
    common = time or next((name for name in table.columns if TIME_NAME.fullmatch(name)), None)
    if sample_time is not None and time is None:
        common = None
    own = own_clocks(table, time)
    if cut != Cut() and common is None and sample_time is None and not own:
        raise RecordError(
            f"start, stop and part cut {table.source} by its clock, and no time column was found; name it as time, or "
            "give sample_time."
        )
    columns, remarks = dict(table.columns), list[str]()
    own |= {clock: clock for clock in own.values()}  # a time column is cut with the columns that it stamps
    for clock in dict.fromkeys([common, *own.values()]):
        stamps = table.columns.get(clock) if clock else np.asarray(np.arange(table.rows) * (sample_time or math.nan))
        if stamps is None or stamps.size < 2 or not np.isfinite(stamps).all():
            continue
        names = [
            name
            for name, values in columns.items()
            if (own.get(name) or common) == clock and values.size == stamps.size
        ]
        if clock in columns and clock not in names:
            names.append(clock)
        kept = np.ones(stamps.size, dtype=bool)
        again = np.flatnonzero(np.diff(stamps) == 0) + 1
        if (
            repaired
            and again.size
            and all(np.array_equal(columns[name][again], columns[name][again - 1], equal_nan=True) for name in names)
        ):
            kept[again] = False
            remarks.append(
                f"{table.source} repeats {pluralise(again.size, 'whole row')}, the first after sample {again[0] - 1}"
                f"{format_instant(stamps, int(again[0]))}: left out"
            )
        kept[kept] = cut.find_rows(stamps[kept], seconds_of(table, clock, time_unit), clock or "the clock")
        columns |= {name: columns[name][kept] for name in names}
    return (table if not remarks and cut == Cut() else replace(table, columns=columns)), remarks


def own_clocks(table: Table, time: str | None) -> dict[str, str]:
    """Return the time column of each column that has its own; none where one is named for a file of one clock."""
    one_named = time is not None and len(set(table.clocks.values())) == 1
    return {} if one_named else dict(table.clocks)


def seconds_of(table: Table, clock: str | None, time_unit: str | None) -> float:
    """Return the seconds of a time column's unit; 1 without a column or a known unit."""
    unit = "s" if clock is None else _find_time_unit(table, clock, time_unit)
    return units.unit(unit).factor if unit in units.units_of("time") else 1.0


@dataclass(frozen=True, slots=True)
class Cut:
    """The rows of a table to read: from `start` to `stop` of the log's own clock [s], of these a part between jumps."""

    start: float | None = None
    stop: float | None = None
    part: int | None = None

    def find_rows(self, stamps: FloatArray, seconds: float, clock: str) -> NDArray[np.bool_]:
        """Return which of the rows of a clock are read, (samples,).

        Raises:
            RecordError: fewer than two are.
        """
        kept, times = np.ones(stamps.size, dtype=bool), stamps * seconds
        for bound, outside in ((self.start, times < (self.start or 0.0)), (self.stop, times > (self.stop or 0.0))):
            kept &= ~outside if bound is not None else True
        if (self.start, self.stop) != (None, None) and np.count_nonzero(kept) < 2:
            raise RecordError(
                f"start and stop leave {np.count_nonzero(kept)} samples of {clock}, which goes from "
                f"{times.min():.10g} to {times.max():.10g} s; give two instants between these."
            )
        if self.part is not None:
            rows = np.flatnonzero(kept)
            parts = find_parts(stamps[rows])
            if self.part > len(parts):
                raise RecordError(
                    f'part is {self.part}, but the time column "{clock}" has {pluralise(len(parts), "part")} between '
                    f"its jumps; give one of 1 to {len(parts)}, or 0 for the longest."
                )
            lengths = [end - first for first, end in parts]
            first, end = parts[self.part - 1 if self.part else int(np.argmax(lengths))]
            kept[rows[:first]] = kept[rows[end:]] = False
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
        repeats=int(np.count_nonzero(steps == 0)),
        backward=int(np.count_nonzero(steps < 0)),
    )


@np.errstate(over="ignore", invalid="ignore")
def clock_faults(stamps: FloatArray, tolerance: float | None = CLOCK_TOLERANCE, name: str = "The time") -> list[str]:
    """Faults of a clock: backward stamps and jumps.

    The sample time is the median step. A step off by more than half a sample time is a jump, otherwise jitter.

    Args:
        stamps: time stamps [s], (samples,).
        tolerance: largest jitter, as a share of the sample time, if above a half; None for stamps that are resampled,
            which may jump.
        name: of the clock, in sentences.
    """
    if stamps.size < 2:
        return [f"{name} has a single stamp, which tells no sample time; give sample_time."]
    if faults := finite_faults(name, stamps):
        return faults
    steps = np.diff(stamps)
    largest, sample_time = float(np.max(np.abs(stamps))), float(np.median(steps))
    if largest > _LATEST or 0 < sample_time < 1 / _LATEST:
        return [
            f"{name} goes to {largest:.3g} s in steps of {sample_time:.3g} s, which is no time; name another time "
            "column, or give its unit."
        ]
    if sample_time <= 0:
        mean = _mean_step(stamps)
        given = f" = {mean:.6g}" if mean > 0 else ""
        return [
            f"{name} does not run forward: {np.count_nonzero(steps == 0)} of its {stamps.size} stamps repeat, and "
            f"{np.count_nonzero(steps < 0)} step back; name another time column, or give sample_time{given} without "
            "time if the samples are uniform."
        ]
    if tolerance is None:
        return []
    error = np.abs(steps / sample_time - 1)
    jumped = error > max(_JUMP, tolerance)
    if jumped.any():
        first = int(np.argmax(jumped))
        step, lost = float(steps[first]), round(float(steps[first]) / sample_time) - 1
        late = f"leaves out {pluralise(lost, 'sample')}" if lost > 0 else "steps early"
        found = f"{'runs backward' if step < 0 else late} (a step of {step:g} s, expected {sample_time:g} s)"
        parts = find_parts(stamps)
        begin, end = max(parts, key=lambda part: part[1] - part[0])
        remedies = [f"part = {parts.index((begin, end)) + 1} (samples {begin} to {end - 1}, the longest)"]
        if np.all(steps[jumped] > 0) and round(float(steps.max()) / sample_time) <= 1 + _BRIDGED:
            remedies.append(f'resample = {{ sample_time = {sample_time:.6g}, method = "cubic" }}')
        if stamps[-1] <= stamps[0] or abs((stamps[-1] - stamps[0]) / (steps.size * sample_time) - 1) <= _NEAR:
            remedies.append(f"sample_time = {sample_time:.6g} without time if only the stamps are wrong")
        faults.append(
            f"{name} jumps {pluralise(int(jumped.sum()), 'time')}: after sample {first}"
            f"{format_instant(stamps, first)} it {found if step else 'repeats its stamp'}; give "
            f"{', or '.join(remedies)}."
        )
    return faults
