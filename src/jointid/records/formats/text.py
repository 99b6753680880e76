"""Text as numbered content lines, and detection of delimiter and decimal mark."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from jointid.common.errors import RecordError
from jointid.records.formats.stamps import is_date, is_stamp

_COMMENTS = ("#", "%", "//")
_HEAD = 65536  # bytes
_LONGEST = 2_500_000  # characters of a line: more than the widest table has
_SPREADSHEET = "sep="  # "sep=;" is a note from one spreadsheet program to another

BLANKS = " "
"""The delimiter that stands for any run of blanks."""

COMMA_BLANK = ", "
"""The delimiter beside decimal commas that is a comma with a blank behind it."""

_DELIMITERS = (";", "\t", "|", ",", BLANKS)  # of dialects that read a file alike, the first is taken
_SAMPLE = 200  # lines that decide, from the end of the file, where the data is
_COMMA_AND_BLANK = re.compile(r",[ \t]+")
_LIST = re.compile(r'(?:^|(?<=[,;\t|]))("?)\[([-+\d.eEnaifNAIF,;\s]+)\]\1(?=$|[,;\t|])')  # a cell
_SEPARATOR = re.compile(r"\s*,\s*|\s+")
_SPLIT_NUMBER = re.compile(r"[\d\s.,;'|+-]*[.,;'|][\d\s.,;'|+-]*", re.ASCII)  # a cell cut at the wrong mark
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


def is_gzip(path: Path) -> bool:
    """Test for a text packed by gzip."""
    return path.suffix.lower() == ".gz"


def open_text(path: Path) -> IO[bytes]:
    """Open the bytes of a text, unpacked."""
    return gzip.open(path) if is_gzip(path) else path.open("rb")  # type: ignore[return-value]


def is_remark(text: str) -> bool:
    """Test for a comment."""
    return text.lstrip().startswith((*_COMMENTS, _SPREADSHEET))


def exceeds(path: Path, size: int) -> bool:
    """Test for a text of more than `size` bytes, unpacked."""
    if not is_gzip(path):
        return path.stat().st_size > size
    with open_text(path) as file:
        left = size
        while left >= 0 and (part := file.read(2**20)):
            left -= len(part)
    return left < 0


def read_bytes(path: Path, most: int) -> bytes:
    """Read the bytes of a text, unpacked; refuse more than `most`."""
    with open_text(path) as file:
        raw = file.read(most + 1)
    if len(raw) > most:
        raise RecordError(f"{path.name} has more than {most} bytes of text; cut it into shorter files.")
    return raw


def read_lines(path: Path) -> TextFile:
    """Read a file in UTF-8, UTF-16 with byte order mark, or Latin-1."""
    with open_text(path) as file:
        raw = file.read()
    text = decode(path, raw)
    # str.splitlines would also split at form feeds and other marks that occur inside names.
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    filled = ((number, line) for number, line in enumerate(every, start=1) if line and not line.isspace())
    return build_text(path.name, list(open_lists(_line(path, number, line) for number, line in filled)))


def decode(path: Path, raw: bytes) -> str:
    """Decode UTF-8, UTF-16 with byte order mark, or Latin-1."""
    try:
        wide = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = raw.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if "\0" in text:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    return text


def open_lists(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines with lists of numbers in cells opened: "[1, 2]" below "q" becomes two cells below q[0] and q[1].

    Loggers write so where a row holds the values of all joints. The line above the first such row names the columns.
    """
    above, listed, opened = None, False, False
    for line in lines:
        mark, lists = _find_lists(line.text)
        if lists:
            if above is not None and not (listed or opened):
                bare = _LIST.sub("", line.text)
                places = [_LIST.sub("", line.text[: match.start()]).count(mark) for match in _LIST.finditer(line.text)]
                names = above.text.split(mark)
                if len(names) == bare.count(mark) + 1:
                    for place, cells in zip(places, lists, strict=True):
                        names[place] = mark.join(f"{names[place].strip()}[{k}]" for k in range(len(cells)))
                    above, opened = Line(above.number, mark.join(names)), True
            each = iter(lists)
            line = Line(line.number, _LIST.sub(lambda _, mark=mark: mark.join(next(each)), line.text))  # type: ignore[misc]  # noqa: B023, PLW2901
        if above is not None:
            yield above
        above, listed = line, bool(lists)
    if above is not None:
        yield above


def _find_lists(text: str) -> tuple[str, list[list[str]]]:
    """Return the delimiter of a line and the numbers in each of its lists; none where something else is in brackets."""
    found = list(_LIST.finditer(text)) if "[" in text else []
    if not found:
        return ",", []
    first = found[0]
    mark = (text[first.start() - 1] if first.start() else text[first.end() : first.end() + 1]) or ","
    lists = [_SEPARATOR.split(match[2].strip()) for match in found]
    return mark, lists if all(is_number(cell) and mark not in cell for cells in lists for cell in cells) else []


def build_text(name: str, filled: list[Line]) -> TextFile:
    """Build a text from non-empty lines."""
    lines = [line for line in filled if not is_remark(line.text)]
    above = [line for line in filled if not lines or line.number < lines[0].number][-1:]
    comments = [Line(n, line.lstrip(" \t#%/")) for n, line in above if not line.startswith(_SPREADSHEET)]
    return TextFile(name, lines, comments[0] if comments else None)


def stream_lines(path: Path) -> Iterator[Line]:
    """Yield the non-empty lines of a file of any length, including comments.

    The beginning determines the encoding.
    """
    with open_text(path) as raw:
        head = raw.read(_HEAD)
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        beginning = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        encoding, beginning = "latin-1", head.decode("latin-1")
    if "\0" in beginning:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    with (
        open_text(path) as raw,
        io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file,
    ):
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


class Kind(Enum):
    """Kind of the cells of a column."""

    NUMBER = "numbers"
    STAMP = "instants"
    DATE = "dates without a time"
    WORD = "words"


@dataclass(frozen=True, slots=True)
class Dialect:
    """Delimiter, a character or `BLANKS`, and decimal mark."""

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Split a line into cells, without blanks and quotes."""
        if self.delimiter == COMMA_BLANK:
            return [cell.strip(' \t"') for cell in _COMMA_AND_BLANK.split(line)]
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

    def kind_of(self, cell: str) -> Kind:
        """Return the kind of a filled cell."""
        if _NUMBERS[self.decimal].fullmatch(cell):
            return Kind.NUMBER
        return Kind.STAMP if is_stamp(cell) else Kind.DATE if is_date(cell) else Kind.WORD

    def width(self, line: str) -> int:
        """Number of cells in a row of numbers; 0 for other lines."""
        if self.delimiter == self.decimal and '"' not in line:
            return 0  # only quotes keep a decimal comma and a delimiting comma apart
        cells = self.split(line)
        is_row = any(cells) and all(not cell or _NUMBERS[self.decimal].fullmatch(cell) for cell in cells)
        return len(cells) if is_row else 0


@dataclass(frozen=True, slots=True)
class Fit:
    """Rows under a dialect, and their commonest width.

    Attributes:
        kinds: of the columns, where not all of them hold numbers.
    """

    dialect: Dialect
    rows: int
    width: int
    kinds: tuple[Kind, ...] | None = None

    def first_row(self, lines: Sequence[str]) -> int:
        """Return the index of the first row of this width."""
        return next(i for i, line in enumerate(lines) if self.is_row(line))

    def is_row(self, line: str) -> bool:
        """Test for a row: its cells hold what their columns do, or nothing."""
        if self.kinds is None:
            return self.dialect.width(line) == self.width
        cells = self.dialect.split(line)
        known = [(c, k) for c, k in zip(cells, self.kinds, strict=False) if k is not Kind.WORD and c]
        return len(cells) == self.width and bool(known) and all(self.dialect.kind_of(c) is k for c, k in known)


def sniff(lines: Sequence[str], delimiter: str | None, decimal: str | None) -> list[Fit]:
    """Return the best dialects for `lines`; two if ambiguous, none without numbers.

    "1,5" is ambiguous: two integers, or a decimal comma (second). The last lines decide.
    """
    fits: list[Fit] = []
    dialects = [Dialect(m, p) for m in ((delimiter,) if delimiter else _DELIMITERS) for p in (decimal or ".,")]
    if delimiter is None and decimal != ".":
        dialects.append(Dialect(COMMA_BLANK, ","))
    for dialect in dialects:
        widths = Counter(width for line in lines[-_SAMPLE:] if (width := dialect.width(line)))
        fits.extend(Fit(dialect, rows, width) for width, rows in widths.most_common(1))
    best = _prefer_blanks(fits, max(fits, key=lambda fit: (fit.rows, fit.width > 1), default=None))
    if best is None or 2 * best.rows < len(lines[-_SAMPLE:]):
        mixed = [fit for dialect in dialects for fit in _fit_cells(lines[-_SAMPLE:], dialect)]
        chosen = _prefer_blanks(mixed, max(mixed, key=_count_read, default=None))
        if chosen is not None and (best is None or chosen.rows > 2 * best.rows):
            return [chosen]
    if best is None:
        return []
    if best.dialect.delimiter == COMMA_BLANK:
        return [best]
    pairs = [fit for fit in fits if fit.width == 2 and fit.dialect.delimiter == ","]
    singles = [fit for fit in fits if fit.width == 1 and fit.dialect.decimal == ","]
    if pairs and singles and best.rows == singles[0].rows:
        return [pairs[0], singles[0]]
    # A drive that stands still at the end logs whole numbers there: the decimal mark shows further up.
    twins = [f for f in fits if f.rows == best.rows and f.dialect.delimiter == best.dialect.delimiter]
    marked = [line for line in lines if "." in line or "," in line] if len(twins) > 1 else []
    return [max(twins, key=lambda fit: sum(fit.dialect.width(line) == fit.width for line in marked))]


def _prefer_blanks(fits: Sequence[Fit], best: Fit | None) -> Fit | None:
    """Prefer fewer columns between ", ": the commas without a blank behind them are decimal marks."""
    spaced = next((fit for fit in fits if fit.dialect.delimiter == COMMA_BLANK), None)
    return spaced if spaced and best and spaced.rows == best.rows and 1 < spaced.width < best.width else best


def _count_read(fit: Fit) -> int:
    return fit.rows * sum(kind in (Kind.NUMBER, Kind.STAMP) for kind in fit.kinds or ())


def _fit_cells(lines: Sequence[str], dialect: Dialect) -> Iterator[Fit]:
    """Yield the fit of rows that also hold instants or words."""
    if dialect.delimiter == dialect.decimal or not lines:
        return
    try:
        split = [dialect.split(line) for line in lines]
    except csv.Error:
        return
    width, _ = Counter(map(len, split)).most_common(1)[0]
    alike = [cells for cells in split if len(cells) == width]
    kinds = kinds_of(dialect, alike, width)
    words = {cell for cells in alike for cell, kind in zip(cells, kinds, strict=True) if kind is Kind.WORD}
    cut = any(_SPLIT_NUMBER.fullmatch(cell) and dialect.kind_of(cell) is Kind.WORD for cell in words)
    if width < 2 or Kind.NUMBER not in kinds or cut:
        return
    fit = Fit(dialect, 0, width, kinds)
    if rows := sum(map(fit.is_row, lines)):
        yield replace(fit, rows=rows)


def kinds_of(dialect: Dialect, rows: Sequence[Sequence[str]], width: int) -> tuple[Kind, ...]:
    """Return the commonest kind of each column's filled cells; numbers for an empty column."""
    kinds = []
    for column in range(width):
        found = Counter(dialect.kind_of(cells[column]) for cells in rows if cells[column])
        kinds.append(max(Kind, key=lambda kind: found[kind]))
    return tuple(kinds)
