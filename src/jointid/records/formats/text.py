"""Text as numbered content lines, and detection of delimiter and decimal mark."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jointid.common.errors import RecordError

_COMMENTS = ("#", "%", "//")
_HEAD = 65536  # bytes
_LONGEST = 2_500_000  # characters of a line: more than the widest table has
_SPREADSHEET = "sep="  # "sep=;" is a note from one spreadsheet program to another

BLANKS = " "
"""The delimiter that stands for any run of blanks."""

_DELIMITERS = (";", "\t", "|", ",", BLANKS)  # of dialects that read a file alike, the first is taken
_SAMPLE = 200  # lines that decide, from the end of the file, where the data is
_EXPONENT_OR_WORD = r"(?:e[+-]?\d+)?|nan|inf|infinity)"
_NUMBERS = {
    ".": re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
    # Digits must follow a decimal comma, so that "1, 2" is never a number and a blank.
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
}


class Line(NamedTuple):
    """One line and its number in the file, from 1."""

    number: int
    text: str


@dataclass(frozen=True, slots=True)
class TextFile:
    """The content lines of a text, and the comment directly above."""

    name: str
    lines: list[Line]
    comment: Line | None

    def above(self, index: int) -> Line | None:
        """Return the line above `lines[index]`; above the first, the comment."""
        return self.lines[index - 1] if index else self.comment


def is_comment(text: str) -> bool:
    """Test for a comment."""
    return text.lstrip().startswith((*_COMMENTS, _SPREADSHEET))


def read_lines(path: Path) -> TextFile:
    """Read a file in UTF-8, UTF-16 with byte order mark, or Latin-1."""
    raw = path.read_bytes()
    try:
        wide = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = raw.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if "\0" in text:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    # str.splitlines would also split at form feeds and other marks that occur inside names.
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    filled = ((number, line) for number, line in enumerate(every, start=1) if line and not line.isspace())
    return build_text(path.name, [_line(path, number, line) for number, line in filled])


def build_text(name: str, filled: list[Line]) -> TextFile:
    """Build a text from non-empty lines."""
    lines = [line for line in filled if not is_comment(line.text)]
    above = [line for line in filled if not lines or line.number < lines[0].number][-1:]
    comments = [Line(n, line.lstrip(" \t#%/")) for n, line in above if not line.startswith(_SPREADSHEET)]
    return TextFile(name, lines, comments[0] if comments else None)


def stream_lines(path: Path) -> Iterator[Line]:
    """Yield the non-empty lines of a file of any length, including comments.

    The beginning determines the encoding.
    """
    with path.open("rb") as raw:
        head = raw.read(_HEAD)
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        beginning = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        encoding, beginning = "latin-1", head.decode("latin-1")
    if "\0" in beginning:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    with path.open(encoding=encoding, errors="replace") as file:
        # Not by iteration: a file may be one line that does not fit into memory.
        for number, line in enumerate(iter(lambda: file.readline(_LONGEST + 2), ""), start=1):
            text = line.rstrip("\n")
            if text and not text.isspace():
                yield _line(path, number, text)


def _line(path: Path, number: int, text: str) -> Line:
    """Return a line; refuse one too long for a table."""
    if len(text) > _LONGEST:
        raise RecordError(
            f"{path.name}: line {number} has more than {_LONGEST} characters; expected a row for each sample: is it a "
            "matrix that lies on its side, or no text?"
        )
    return Line(number, text)


def point_rows(rows: Sequence[Line], decimal: str) -> list[str]:
    """Convert decimal commas to points; a point beside them invalidates the number."""
    if decimal == ".":
        return [row.text for row in rows]
    return [row.text.replace(".", "?").replace(",", ".") for row in rows]


def is_number(cell: str) -> bool:
    """Test for one number, with point or comma, NaN or infinity."""
    return any(pattern.fullmatch(cell) for pattern in _NUMBERS.values())


@dataclass(frozen=True, slots=True)
class Dialect:
    """Delimiter, a character or `BLANKS`, and decimal mark."""

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Split a line into cells, without blanks and quotes."""
        if '"' in line:
            reader = csv.reader([line.strip(" ")], delimiter=self.delimiter, skipinitialspace=True)
            return [cell.strip() for cell in next(reader)]
        if self.delimiter == BLANKS:
            return line.split()
        return [cell.strip() for cell in line.split(self.delimiter)]

    def number(self, cell: str) -> float:
        """Parse a cell, NaN if empty."""
        if not cell:
            return np.nan
        if not _NUMBERS[self.decimal].fullmatch(cell):
            raise ValueError(cell)
        return float(cell.replace(self.decimal, "."))

    def width(self, line: str) -> int:
        """Number of cells in a row of numbers; 0 for other lines."""
        if self.delimiter == self.decimal and '"' not in line:
            return 0  # only quotes keep a decimal comma and a delimiting comma apart
        cells = self.split(line)
        is_row = any(cells) and all(not cell or _NUMBERS[self.decimal].fullmatch(cell) for cell in cells)
        return len(cells) if is_row else 0


@dataclass(frozen=True, slots=True)
class Fit:
    """Rows of numbers under a dialect, and their commonest width."""

    dialect: Dialect
    rows: int
    width: int

    def first_row(self, lines: Sequence[str]) -> int:
        """Return the index of the first row of numbers of this width."""
        return next(i for i, line in enumerate(lines) if self.dialect.width(line) == self.width)


def sniff(lines: Sequence[str], delimiter: str | None, decimal: str | None) -> list[Fit]:
    """Return the best dialects for `lines`; two if ambiguous, none without numbers.

    "1,5" is ambiguous: two integers, or a decimal comma (second). The last lines decide.
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
