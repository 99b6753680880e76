"""Instants written as text: ISO 8601, similar dates, times of day.

They are counted in nanoseconds, since floats have too few digits for dates, and become seconds from the first one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import date
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray

_DATE = (
    r"(?:(?P<y>\d{4})(?P<s>[-/.]?)(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})"
    r"|(?P<a>\d{1,2})[-/.](?P<b>\d{1,2})[-/.](?P<c>\d{4}))"
)
_STAMP = re.compile(
    rf"(?:{_DATE}(?:[Tt]|[\s,_;-]\s*))?"
    r"(?:(?P<hour>\d{1,3}):)?(?P<minute>[0-5]?\d):(?P<second>[0-5]?\d|60)(?:(?:[.,]|:(?=\d{3}$))(?P<part>\d{1,12}))?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?\s*(?:[Zz]|UTC|(?P<sign>[+-])(?P<east>\d\d):?(?P<minutes>\d\d)?)?",
    re.ASCII,
)
_COMPACT = re.compile(r"(?<=\dT)(\d\d)(\d\d)(\d\d)", re.ASCII)
_EPOCH = date(1970, 1, 1).toordinal()
_SECOND, _DAY, _HOUR = 10**9, 86400 * 10**9, 3600 * 10**9


def is_stamp(cell: str) -> bool:
    """Test for an instant: a date with time, or a time."""
    return _match(cell) is not None


class Stamps(NamedTuple):
    """A column of instants.

    Attributes:
        origin: zero of the seconds [ns].
        period: period after which instants repeat [ns], such as a day; 0 with a date.
        day_first: whether "1/2/2026" is in February.
    """

    origin: int
    period: int
    day_first: bool

    def seconds(self, cells: Sequence[str]) -> FloatArray:
        """Return the seconds since the origin, shape (cells,); NaN for empty cells.

        Raises:
            ValueError: a cell is not an instant.
        """
        read = [_read(cell, self.day_first) for cell in cells if cell]
        if any(period != self.period for _, period in read):
            raise ValueError("some have a date, and some have none")
        counts = np.array([count for count, _ in read])
        steps = np.diff(counts, prepend=self.origin)
        steps[0] = -self.period * (steps[0] < 0)  # later blocks may start in another period
        begun_again = np.cumsum(2 * steps < -self.period) if self.period else 0
        seconds = np.full(len(cells), np.nan)
        seconds[[bool(cell) for cell in cells]] = (counts - self.origin + begun_again * self.period) / _SECOND
        return seconds


def find_stamps(cells: Sequence[str]) -> Stamps:
    """Determine the format of a column of instants from its first cells.

    Day and month are in the order that gives the shorter duration. A cell that is no instant is a ValueError.
    """
    spans, begin = list[tuple[float, Stamps]](), next(filter(None, cells), "")
    for day_first in (True, False):
        with suppress(ValueError):  # the month may be invalid
            made = Stamps(*_read(begin, day_first), day_first)
            seconds = made.seconds(cells)
            spans.append((float(np.nanmax(seconds) - np.nanmin(seconds)), made))
    if not spans:
        raise ValueError(begin)
    return min(spans, key=lambda one: one[0])[1]


def _match(cell: str) -> re.Match[str] | None:
    text = _COMPACT.sub(r"\1:\2:\3", cell) if "T" in cell else cell
    found = _STAMP.fullmatch(text) if ":" in text else None
    if found is None or found["hour"]:
        return found
    return found if found["part"] and not (found["y"] or found["c"]) else None  # minutes, as "59:59.5"


def _read(cell: str, day_first: bool) -> tuple[int, int]:
    """Return the nanoseconds of an instant, and its period."""
    found = _match(cell)
    if found is None:
        raise ValueError(cell)
    hour = int(found["hour"] or 0)
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"] in "pP")
    minutes = 60 * hour + int(found["minute"])
    if found["sign"]:
        minutes -= int(f"{found['sign']}1") * (60 * int(found["east"]) + int(found["minutes"] or 0))
    count = (60 * minutes + int(found["second"])) * _SECOND + int(f"{found['part'] or '':0<9.9}")
    year, month, day = found["y"] or found["c"], found["m"] or found["b"], found["d"] or found["a"]
    if not year:
        return count, _DAY if found["hour"] else _HOUR
    if found["c"] and not day_first:
        day, month = month, day
    return count + (date(int(year), int(month), int(day)).toordinal() - _EPOCH) * _DAY, 0
