"""Clocks of a table: stamps, sample time and jitter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise
from jointid.records.columns import unit_fault, unit_in_name
from jointid.records.formats import Table
from jointid.records.formats.table import STAMP_NAME, TIME_NAME
from jointid.records.record import Spans

# Clocks of drives and computers differ by 0.01 %; a wrong rate is wrong by far more.
_RATE_TOLERANCE = 1e-3
_LATEST = 1e30  # largest time stamp in any unit; the square of a larger step overflows
# Tolerated deviation of a step, as a share of the sample time: well below the half sample by which a held and an
# averaged torque differ, and well above the jitter of good loggers (0.004 % in EMPS) and of stamps rounded to a
# microsecond at 10 kHz (1 %).
CLOCK_TOLERANCE = 0.05
_JUMP = 0.5  # sample times: a step with a larger deviation is a jump, with samples missing or doubled
_LISTED = 8  # most parts between jumps that are listed
_GAP = 1.75  # sample times: a longer step skips samples (two stamps 30 % early and late are 1.6 apart)


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """The stamps of a channel.

    Attributes:
        sample_time: mean step [s].
        stamps: (samples,) [s].
        column: name of the time column; empty if there is none.
        jitter: largest deviation of a step from the sample time, as a share of it; 0 within the tolerance.
        first: stamp of the file's first row [s].
    """

    sample_time: float
    stamps: FloatArray
    column: str = ""
    jitter: float = 0.0
    first: float = 0.0


def find_stamps(
    table: Table, time: str | None, time_unit: str | None, sample_time: float | None
) -> tuple[str, FloatArray]:
    """Return a table's time column, empty if none, and its stamps [s].

    Args:
        table: of the samples.
        time: name of the time column; None takes the only one called t or time, else timestamp, stamp or Zeit.
        time_unit: None takes the unit in the name, or s.
        sample_time: seconds; it defines the clock if `time` is None.

    Raises:
        RecordError: there is no clock, or its unit is unknown.
    """
    if sample_time is not None and time is None:
        _require_rate(table, sample_time)
        return "", np.asarray(np.arange(table.rows) * sample_time, dtype=np.float64)
    usual = ([name for name in table.columns if one.fullmatch(name)] for one in (TIME_NAME, STAMP_NAME))
    names = next(filter(None, usual), []) if time is None else [time] if time in table.columns else []
    if len(names) != 1:
        why = table.explain_missing([time] if time else (one for one in table.passed if TIME_NAME.fullmatch(one)))
        called = f'"{time}"' if time else 'that alone is called "t" or "time"'
        raise RecordError(
            f"{table.source} has no time column {called}{why}; it has {table.list_columns()}: give sample_time, or the "
            "name of the time column as time."
        )
    (column,) = names
    stamps = table.columns[column] * seconds_of(table, column, time_unit)
    # A column of nanoseconds beside one of whole seconds restarts every second.
    return column, np.unwrap(stamps, period=1.0) if np.all((stamps >= 0.0) & (stamps < 1.0)) else stamps


def _require_rate(table: Table, sample_time: float) -> None:
    """Refuse a sample time that rising stamps in the file, with their unit, contradict by more than two steps."""
    known = units.units_of("time")
    for name in table.columns:
        if (unit_in_name(name, known) or units.normalise_unit(table.units.get(name, ""))) in known:
            steps = np.diff(table.columns[name]) * seconds_of(table, name, None)
            lasts = float(np.sum(steps))
            off = abs(steps.size * sample_time - lasts)
            if lasts > 0 and np.all(steps >= 0) and off > 2 * float(np.max(steps)) + CLOCK_TOLERANCE * lasts:
                raise RecordError(
                    f'sample_time is {sample_time:g} s, and column "{name}" has {lasts / steps.size:.4g} s: leave '
                    f'sample_time out, and give time = "{name}".'
                )


def fit_clock(column: str, stamps: FloatArray, sample_time: float | None, *, resampled: bool = False) -> Clock:
    """Check stamps and return their clock.

    Args:
        column: name of the time column; empty if the stamps are multiples of `sample_time`.
        stamps: (samples,) [s].
        sample_time: declared one [s], if any.
        resampled: whether the samples are to be resampled, so that stamps may jump.

    Raises:
        RecordError: the stamps run backward, repeat, jump, or contradict the sample time.
    """
    if not column and sample_time is not None:
        return Clock(sample_time, stamps, first=float(stamps[0]))
    _require_forward(stamps, f'The time column "{column}"', jumps=resampled)
    first, count = float(stamps[1] - stamps[0]), stamps.size - 1
    jitter = 0.0 if resampled else float(np.max(np.abs(np.diff(stamps) * count / (stamps[-1] - stamps[0]) - 1)))
    jitter = jitter if jitter > CLOCK_TOLERANCE else 0.0
    if resampled or jitter:
        period = fit_line(stamps)[0]
    elif np.array_equal(stamps[0] + np.arange(stamps.size) * first, stamps):
        period = first  # computed stamps reproduce their sample time exactly
    else:  # the mean over the record is better than any one step; its thirteenth digit is rounding
        period = float(f"{(stamps[-1] - stamps[0]) / count:.12g}")
    if sample_time is not None and not is_same_rate(sample_time, period):
        raise RecordError(
            f'The sample time is given as {sample_time:g} s, and column "{column}" has {period:g} s; '
            "mend one, or leave sample_time or time out."
        )
    return Clock(sample_time or period, stamps, column, jitter, float(stamps[0]))


def seconds_of(table: Table, column: str, time_unit: str | None) -> float:
    """Return the factor from a time column's unit to seconds.

    Raises:
        RecordError: the unit (given, in the name, of the file) is unknown, or contradicts the one in the name.
    """
    known = units.units_of("time")
    named, stated = unit_in_name(column, known), units.normalise_unit(table.units.get(column, ""))
    # "time [hh:mm:ss]" was counted in seconds.
    unit = time_unit or next((one for one in (named, stated) if one in known), named or stated or "s")
    if unit not in known or (named is not None and time_unit not in (None, named)):
        raise RecordError(f'time (column "{column}") {unit_fault(unit, known)}.')
    return units.unit(unit).factor


@dataclass(frozen=True, slots=True)
class Cut:
    """Rows to read, by the log's clock [s] and part between jumps."""

    start: float | None = None
    stop: float | None = None
    part: int | None = None
    leave_out: Spans = ()

    def __post_init__(self) -> None:
        require_spans(self.leave_out)

    def find_rows(self, times: FloatArray, clock: str) -> NDArray[np.bool_]:
        """Return the rows to read, (samples,).

        Raises:
            RecordError: fewer than two remain, the part does not exist, or a span is outside the clock.
        """
        first = -math.inf if self.start is None else self.start
        last = math.inf if self.stop is None else self.stop
        kept = counted = (times >= first) & (times <= last)
        for begin, end in self.leave_out:
            outside, read = (times < begin) | (times >= end), times[kept]
            counted = counted & outside
            if read.size and (begin <= read[0] or end > read[-1]):
                kept = kept & outside  # spans at an end are not read at all
        rows = np.flatnonzero(kept)
        parts = _find_parts(times[rows]) if self.part is not None else [(0, rows.size)]
        left, (lowest, highest) = int(np.count_nonzero(counted)), (times.min(), times.max())
        missed = any(begin > highest or end <= lowest for begin, end in self.leave_out)
        if missed or left < 2 or self.part not in (None, *range(len(parts) + 1)):
            raise RecordError(
                f"start, stop and leave_out leave {pluralise(left, 'sample')} of {clock or 'the clock'}, which goes "
                f"from {lowest:.10g} to {highest:.10g} s, with {pluralise(len(parts), 'part')} between jumps; "
                "give two instants in there, and a part of these or 0 for the longest."
            )
        begin, end = parts[self.part - 1] if self.part else max(parts, key=lambda one: one[1] - one[0])
        kept[rows[:begin]] = kept[rows[end:]] = False
        return kept


def require_spans(spans: Spans) -> None:
    """Refuse empty, reversed or overlapping time spans."""
    if not all(a < b for a, b in spans) or not all(one[1] <= other[0] for one, other in pairwise(spans)):
        said = [list(span) for span in spans]
        raise RecordError(f"{said} overlap or are not in order; expected [begin, end] of each in s, one after another.")


def _find_parts(stamps: FloatArray) -> list[tuple[int, int]]:
    """First sample and end of each part between jumps of stamps."""
    steps = np.diff(stamps)
    typical = float(np.median(steps[steps > 0])) if np.any(steps > 0) else math.inf
    jumps = np.flatnonzero(np.abs(steps / typical - 1) > _JUMP) + 1
    return list(pairwise([0, *jumps.tolist(), stamps.size]))


def is_same_rate(sample_time: float, other: float) -> bool:
    """Return True if two sample times are equal within `_RATE_TOLERANCE`."""
    return abs(sample_time / other - 1) <= _RATE_TOLERANCE


def fit_line(stamps: FloatArray) -> tuple[float, FloatArray, NDArray[np.int64]]:
    """Fit a uniform clock to stamps [s], (samples,).

    Returns the sample time, the deviations, and skipped samples of each step. Repeated stamps are not counted.
    """
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    typical = float(np.median(forward)) if forward.size else 1.0
    skipped = np.where(steps >= _GAP * typical, np.maximum(np.round(steps / typical), 1), steps != 0)
    number = np.concatenate([[0.0], np.cumsum(skipped)])
    centred, times = number - number.mean(), stamps - stamps.mean()
    period = float(centred @ times) / (float(centred @ centred) or 1.0)
    return period, times - period * centred, np.asarray(np.maximum(skipped - 1, 0), dtype=np.int64)


@np.errstate(all="ignore")
def _require_forward(stamps: FloatArray, name: str, *, jumps: bool) -> None:
    """Refuse stamps [s], (samples,), that do not run forward.

    The sample time is the median step. A deviation above half a sample time is a jump, allowed if `jumps`.
    """
    steps = np.diff(stamps)
    forward, largest = steps[steps > 0], float(np.max(np.abs(stamps), initial=0.0))
    sample_time = float(np.median(forward)) if forward.size else 0.0
    off = np.flatnonzero(~(np.abs(steps / sample_time - 1) <= _JUMP))
    if not (largest <= _LATEST and sample_time >= 1 / _LATEST) or (off.size and not jumps):
        at, spans = int(off[0]) if off.size else 0, [stamps[[a, b - 1]].tolist() for a, b in _find_parts(stamps)]
        tests = 1 < len(spans) <= _LISTED and np.all(np.diff(np.ravel(spans)) > 0)
        raise RecordError(
            f"{name} jumps {pluralise(off.size, 'time')}, repeats or does not run forward, first after sample {at} of "
            f"{stamps.size} (t = {stamps[at]:g} s; expected steps of {sample_time:g} s); give "
            f"{f'parts = {spans} for tests to be identified together, or ' if tests else ''}part = 0 for the longest "
            "part between the jumps, or resample to bridge short gaps; or name another time column, or its unit; if "
            "only the stamps are wrong, give sample_time without time."
        )
