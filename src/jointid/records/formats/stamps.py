"""Instants written as text: ISO 8601 and its neighbours with a date, and times of day.

They count in nanoseconds, since a float keeps too few digits of a date, and become seconds from the first one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from jointid.common.arrays import FloatArray

_DATE = (
    r"(?:(?P<y>\d{4})(?P<s>[-/.]?)(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})"
    r"|(?P<a>\d{1,2})[-/.](?P<b>\d{1,2})[-/.](?P<c>\d{4}))"
)
_CLOCK = (
    r"\d{1,3}:[0-5]?\d:(?:[0-5]?\d|60)(?:[.,]\d{1,12}|:\d{3})?|[0-5]?\d:[0-5]?\d[.,]\d{1,12}|\d{6}(?:[.,]\d{1,12})?"
)
_STAMP = re.compile(
    rf"(?:{_DATE}(?:[Tt]|[\s,_;-]\s*))?(?P<clock>{_CLOCK})(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
    r"\s*(?P<zone>[Zz]|UTC|[+-]\d\d(?::?\d\d)?)?",
    re.ASCII,
)
_DAY_ALONE = re.compile(_DATE, re.ASCII)
_SECOND, _DAY, _HOUR = 10**9, 86400 * 10**9, 3600 * 10**9


def is_stamp(cell: str) -> bool:
    """Test for an instant: a date with a time, or a time of day."""
    return _match(cell) is not None


def is_date(cell: str) -> bool:
    """Test for a date without a time."""
    return not cell.isdecimal() and _DAY_ALONE.fullmatch(cell) is not None


@dataclass(frozen=True, slots=True)
class Stamps:
    """A column of instants, counted from `origin` [ns].

    Attributes:
        period: after which the instants begin again [ns], as at midnight; 0 with a date.
        day_first: whether "1/2/2026" is in February.
    """

    origin: int
    period: int
    day_first: bool

    @classmethod
    def of(cls, cells: Sequence[str]) -> Stamps:
        """Return the column that begins with these cells; at least one is filled.

        Day and month are in the order that gives the record the shorter duration.

        Raises:
            ValueError: a cell is no instant.
        """
        spans, begin = list[tuple[float, Stamps]](), next(filter(None, cells))
        found = _match(begin)
        if found is None or not found["c"]:  # the order does not matter
            return cls(*_read(begin, True), True)
        for day_first in (True, False):
            try:
                made = cls(*_read(begin, day_first), day_first)
                spans.append((float(np.nanmax(made.seconds(cells)) - np.nanmin(made.seconds(cells))), made))
            except ValueError:  # there is no such month
                continue
        if not spans:
            raise ValueError
        return min(spans, key=lambda one: one[0])[1]

    def seconds(self, cells: Sequence[str]) -> FloatArray:
        """Return the seconds since the origin, shape (cells,); NaN for empty cells.

        Raises:
            ValueError: a cell is no instant.
        """
        seconds = np.full(len(cells), np.nan)
        added, earliest = 0, self.origin
        for place, cell in enumerate(cells):
            if not cell:
                continue
            count, period = _read(cell, self.day_first)
            if period != self.period:
                raise ValueError(cell)
            if period and count + added < earliest:
                added += period
            earliest = count + added - period // 2
            seconds[place] = (count + added - self.origin) / _SECOND
        return seconds


def _match(cell: str) -> re.Match[str] | None:
    found = _STAMP.fullmatch(cell) if ":" in cell or "T" in cell else None
    if found is None or (":" not in found["clock"] and not found["y"]):  # six digits are a time behind a date alone
        return None
    return None if found["clock"].count(":") == 1 and (found["y"] or found["c"]) else found


def _read(cell: str, day_first: bool) -> tuple[int, int]:
    """Return the nanoseconds of an instant, from midnight or from the year 1, and its period."""
    found = _match(cell)
    if found is None:
        raise ValueError(cell)
    clock = found["clock"]
    is_minutes = clock.count(":") == 1
    if ":" not in clock:
        clock = f"{clock[:2]}:{clock[2:4]}:{clock[4:]}"
    hour, minute, second, *fraction = re.split("[:.,]", f"0:{clock}" if is_minutes else clock)
    hours = int(hour) % 12 + 12 * (found["half"] in "pP") if found["half"] else int(hour)
    count = (hours * 3600 + int(minute) * 60 + int(second)) * _SECOND
    count += int((fraction[0] if fraction else "")[:9].ljust(9, "0"))
    if (zone := found["zone"]) and zone[0] in "+-":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        count -= (1 if zone[0] == "+" else -1) * (int(digits[:2]) * 3600 + int(digits[2:]) * 60) * _SECOND
    year, month, day = found["y"] or found["c"], found["m"] or found["b"], found["d"] or found["a"]
    if not year:
        return count, _HOUR if is_minutes else _DAY
    if found["c"] and not day_first:
        day, month = month, day
    return count + date(int(year), int(month), int(day)).toordinal() * _DAY, 0
