"""Find the delimiter and the decimal mark of delimited text from its lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BLANKS = " "
"""The delimiter that stands for any run of blanks."""

_DELIMITERS = (";", "\t", "|", ",", BLANKS)  # of dialects that read a file alike, the first is taken
_SAMPLE = 200  # lines that decide, from the end of the file, where the data is
_EXPONENT_OR_WORD = r"(?:e[+-]?\d+)?|nan|inf|infinity)"
_NUMBERS = {
    ".": re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
    # Digits must follow a decimal comma, so that "1, 2" is never a number and a blank.
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
}


def is_number(cell: str) -> bool:
    """True if a cell is one number, with a decimal point or comma, NaN and infinity included."""
    return any(pattern.fullmatch(cell) for pattern in _NUMBERS.values())


@dataclass(frozen=True, slots=True)
class Dialect:
    """Delimiter and decimal mark of a text.

    Attributes:
        delimiter: one character; `BLANKS` is any run of blanks.
        decimal: "." or ",".
    """

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Return the cells of a line, without the blanks and quotes around them."""
        if '"' in line:
            reader = csv.reader([line.strip(" ")], delimiter=self.delimiter, skipinitialspace=True)
            return [cell.strip() for cell in next(reader)]
        if self.delimiter == BLANKS:
            return line.split()
        return [cell.strip() for cell in line.split(self.delimiter)]

    def number(self, cell: str) -> float:
        """Return the value of a cell, NaN if it is empty.

        Raises:
            ValueError: the cell holds something else.
        """
        if not cell:
            return np.nan
        if not _NUMBERS[self.decimal].fullmatch(cell):
            raise ValueError(cell)
        return float(cell.replace(self.decimal, "."))

    def width(self, line: str) -> int:
        """Return the count of cells in a row of numbers; 0 for a line that is no such row."""
        if self.delimiter == self.decimal and '"' not in line:
            return 0  # only quotes keep a decimal comma and a delimiting comma apart
        cells = self.split(line)
        is_row = any(cells) and all(not cell or _NUMBERS[self.decimal].fullmatch(cell) for cell in cells)
        return len(cells) if is_row else 0


@dataclass(frozen=True, slots=True)
class Fit:
    """Rows of numbers that a dialect finds in a sample of lines, and their commonest width."""

    dialect: Dialect
    rows: int
    width: int

    def first_row(self, lines: Sequence[str]) -> int:
        """Return the index of the first row of numbers of this width."""
        return next(i for i, line in enumerate(lines) if self.dialect.width(line) == self.width)


def sniff(lines: Sequence[str], delimiter: str | None, decimal: str | None) -> list[Fit]:
    """Return the readings of `lines` that no other beats; none if there is no row of numbers.

    There are two where the lines are like "1,5": two whole numbers, or one number with a decimal comma (the
    second reading).

    Args:
        lines: lines that are neither empty nor comments; the last of them decide.
        delimiter: the delimiter, where it is known.
        decimal: the decimal mark, where it is known.
    """
    fits: list[Fit] = []
    for mark in (delimiter,) if delimiter else _DELIMITERS:
        for point in (decimal,) if decimal else (".", ","):
            dialect = Dialect(mark, point)
            widths = Counter(width for line in lines[-_SAMPLE:] if (width := dialect.width(line)))
            fits.extend(Fit(dialect, rows, width) for width, rows in widths.most_common(1))
    if not fits:
        return []
    best = max(fits, key=lambda fit: (fit.rows, fit.width > 1))
    pairs = [fit for fit in fits if fit.width == 2 and fit.dialect.delimiter == ","]
    singles = [fit for fit in fits if fit.width == 1 and fit.dialect.decimal == ","]
    if pairs and singles and best.rows == singles[0].rows:
        return [pairs[0], singles[0]]
    # A drive that stands still at the end logs whole numbers there: the decimal mark shows further up.
    twins = [f for f in fits if f.rows == best.rows and f.dialect.delimiter == best.dialect.delimiter]
    marked = [line for line in lines if "." in line or "," in line] if len(twins) > 1 else []
    return [max(twins, key=lambda fit: sum(fit.dialect.width(line) == fit.width for line in marked))]
