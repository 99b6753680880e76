"""Instants written as text: ISO 8601 and its neighbours with a date, and times of day.

They count in nanoseconds, since a float keeps too few digits of a date, and become seconds from the first one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date

import numpy as np

from jointid.common.arrays import FloatArray

_DATE = (
    r"(?:(?P<y>\d{4})(?P<s>[-/.]?)(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})"
    r"|(?P<a>\d{1,2})[-/.](?P<b>\d{1,2})[-/.](?P<c>\d{4}))"
)
_CLOCK = (
    r"(?:(?P<H>\d{1,3}):(?P<M>[0-5]?\d):(?P<S>[0-5]?\d|60)(?:[.,](?P<F>\d{1,12})|:(?P<K>\d{3}))?"
    r"|(?P<N>[0-5]?\d):(?P<T>[0-5]?\d)[.,](?P<G>\d{1,12})|(?P<P>\d{6})(?:[.,](?P<Q>\d{1,12}))?)"
)
_HALF = r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
_ZONE = r"\s*(?P<zone>[Zz]|UTC|[+-]\d\d(?::?\d\d)?)?"
_STAMP = re.compile(rf"(?:{_DATE}(?:[Tt]|[\s,_;-]\s*))?{_CLOCK}{_HALF}{_ZONE}", re.ASCII)
_DAY_ALONE = re.compile(_DATE, re.ASCII)
_SECOND, _DAY, _HOUR = 10**9, 86400 * 10**9, 3600 * 10**9


def is_stamp(cell: str) -> bool:
    """Test for an instant: a date with a time, or a time of day."""
    found = _STAMP.fullmatch(cell) if ":" in cell or "T" in cell else None
    return bool(found and (found["P"] is None or found["y"]) and (found["N"] is None or not found["c"]))


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
        best: tuple[int, Stamps] | None = None
        for day_first in (True, False):
            made = cls(0, _period(next(filter(None, cells))), day_first)
            try:
                counts = [count for count in made._counts(cells) if count is not None]
            except ValueError:
                continue
            span = max(counts) - min(counts)
            if best is None or span < best[0]:
                best = span, replace(made, origin=counts[0])
        if best is None:
            raise ValueError
        return best[1]

    def seconds(self, cells: Sequence[str]) -> FloatArray:
        """Return the seconds since the origin, shape (cells,); NaN for empty cells.

        Raises:
            ValueError: a cell is no instant.
        """
        counts = self._counts(cells)
        return np.array([np.nan if count is None else (count - self.origin) / _SECOND for count in counts])

    def after(self, cell: str, start: float) -> Stamps:
        """Return the column for rows from this cell on, no earlier than `start` [s]."""
        count = _count(cell, self.day_first) - self.origin
        late = round(start * _SECOND) - count
        periods = -(-late // self.period) if self.period and late > 0 else 0
        return replace(self, origin=self.origin - periods * self.period)

    def _counts(self, cells: Sequence[str]) -> list[int | None]:
        counts: list[int | None] = []
        added, last = 0, None
        for cell in cells:
            if not cell:
                counts.append(None)
                continue
            if _period(cell) != self.period:
                raise ValueError(cell)
            count = _count(cell, self.day_first) + added
            if last is not None and self.period and count < last - self.period // 2:
                added, count = added + self.period, count + self.period
            counts.append(count)
            last = count
        return counts


def _period(cell: str) -> int:
    found = _STAMP.fullmatch(cell)
    if found is None:
        raise ValueError(cell)
    if found["y"] or found["c"]:
        return 0
    return _HOUR if found["N"] else _DAY


def _count(cell: str, day_first: bool) -> int:
    """Nanoseconds of an instant, from midnight or from the year 1."""
    found = _STAMP.fullmatch(cell)
    if found is None:
        raise ValueError(cell)
    if found["P"]:
        hour, minute, second = int(found["P"][:2]), int(found["P"][2:4]), int(found["P"][4:])
    elif found["N"]:
        hour, minute, second = 0, int(found["N"]), int(found["T"])
    else:
        hour, minute, second = int(found["H"]), int(found["M"]), int(found["S"])
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"] in "pP")
    fraction = found["F"] or found["K"] or found["G"] or found["Q"] or ""
    count = (hour * 3600 + minute * 60 + second) * _SECOND + int(fraction[:9].ljust(9, "0"))
    if (zone := found["zone"]) and zone[0] in "+-":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        count -= (1 if zone[0] == "+" else -1) * (int(digits[:2]) * 3600 + int(digits[2:]) * 60) * _SECOND
    if found["y"]:
        return count + date(int(found["y"]), int(found["m"]), int(found["d"])).toordinal() * _DAY
    if found["c"]:
        day, month = (found["a"], found["b"]) if day_first else (found["b"], found["a"])
        return count + date(int(found["c"]), int(month), int(day)).toordinal() * _DAY
    return count
