"""Delimited text: any delimiter and decimal mark, names, comments or preamble.

Every dialect is tried on the last lines of the file. The one that parses most of them as rows of one width is chosen.
Ambiguous files are refused with the option that resolves it.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise, short
from jointid.common.units import UnitError, normalise_unit, unit
from jointid.records.formats.scope import find_scope, read_scope
from jointid.records.formats.stamps import Stamps, is_date, is_stamp
from jointid.records.formats.table import TIME_NAME, Table, join_tables, require_columns, require_size, require_width

_BLANKS = " "  # the delimiter that stands for any run of blanks
_COMMA_BLANK = ", "  # the delimiter beside decimal commas that is a comma with a blank behind it
_DELIMITERS = (";", "\t", "|", ",", _BLANKS)  # of dialects that read a file alike, the first is taken
_DELIMITER = re.compile(r"[^\w\r\n\".+-]")  # anything but a part of a number, of a name, of a line end
_REMARKS = ("#", "%", "//", "sep=")  # "sep=;" is a note from one spreadsheet program to another
_HEAD, _BEGINNING = 2**23, 2**20  # characters that tell how a file is written, which is read whole or in blocks
_CELLS = 2**21  # that are read together
_LONGEST = 2_500_000  # characters of a line: more than the widest table has
_SAMPLE, _SAMPLE_SIZE = 200, 2**20  # lines, and their characters, that decide, from the end, where the data is
_FILLED = 1000  # cells that tell what a column holds
_EXPONENT_OR_WORD = r"(?:e[+-]?\d+)?|nan|inf|infinity)"
_NUMBERS = {
    ".": re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
    # Digits must follow a decimal comma, so that "1, 2" is never a number and a blank.
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
}
_SPLIT_NUMBER = re.compile(r"[\d\s.,;'|+-]*[.,;'|][\d\s.,;'|+-]*", re.ASCII)  # a cell cut at the wrong mark
_SEPARATOR = re.compile(r"\s*,\s*|\s+")  # of the numbers of a list in a cell
_BRACKETED = re.compile(r"\[(.*)\]|\((.*)\)")
_NO_UNIT = ("", "-")
_OTHER_UNITS = frozenset({
    "V", "mV", "µV", "uV", "kV", "mA", "µA", "uA", "kA", "W", "kW", "VA", "Hz", "kHz", "MHz", "°C", "degC", "C", "K",
    "bar", "Pa", "J", "g", "kg", "dB", "ppm", "m/s²", "m/s^2", "m/s2", "rad/s²", "rad/s2",
    "LU", "Inkr", "Inkr.", "Arms", "Aeff", "A_eff", "A rms", "Apk", "Vrms",
})  # fmt: skip
_RUN = ("=", "+", "-", "@")  # with these a cell begins that a spreadsheet program takes for a formula


class Line(NamedTuple):
    """One line and its number in the file, from 1."""

    number: int
    text: str

    @property
    def is_remark(self) -> bool:
        """Whether it is a comment."""
        return self.text.lstrip().startswith(_REMARKS)


@dataclass(frozen=True, slots=True)
class TextOptions:
    """Options of delimited text.

    Attributes:
        delimiter: one character, " " for any run of blanks; None finds it.
        decimal: "." or ","; None finds it.
        header: True if the line above the first row holds names; None takes it as names if it has one cell
            per column and none of them is a number.
    """

    delimiter: str | None = None
    decimal: str | None = None
    header: bool | None = None

    def __post_init__(self) -> None:
        mark = self.delimiter
        if mark is not None and not (isinstance(mark, str) and _DELIMITER.fullmatch(mark)):
            raise RecordError(f'The delimiter is one character, such as ";"; got {mark!r}.')
        if self.decimal not in (None, ".", ","):
            raise RecordError(f'The decimal mark is "." or ","; got {self.decimal!r}.')
        if self.header not in (None, True, False):
            raise RecordError(f"header is true or false; got {self.header!r}.")


class Dialect(NamedTuple):
    """Delimiter, a character, `_BLANKS` or `_COMMA_BLANK`, and decimal mark."""

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Split a line into cells, without blanks and quotes; a quote without end makes one cell."""
        if self.delimiter == _COMMA_BLANK:
            return [cell.strip(' \t"') for cell in re.split(r",[ \t]+", line)]
        if '"' in line:
            try:
                cells = next(csv.reader([line.strip(" ")], delimiter=self.delimiter, skipinitialspace=True))
            except csv.Error:
                return [line]
            return [cell.strip() for cell in cells]
        return line.split() if self.delimiter == _BLANKS else [cell.strip() for cell in line.split(self.delimiter)]

    def kind(self, cell: str) -> str:
        """Return a letter for a cell: empty, number, list of numbers, instant (t), date or word."""
        if not cell:
            return "e"
        if _NUMBERS[self.decimal].fullmatch(cell):
            return "n"
        if cell[0] == "[" and cell[-1] == "]":
            return "l" if all(map(_NUMBERS["."].fullmatch, _SEPARATOR.split(cell[1:-1].strip()))) else "w"
        return "t" if is_stamp(cell) else "d" if is_date(cell) else "w"

    def kinds(self, line: str) -> str:
        """Return the letters of a line's cells."""
        if self.delimiter == self.decimal and '"' not in line:
            return "w"  # only quotes keep a decimal comma and a delimiting comma apart
        return "".join(map(self.kind, self.split(line)))

    def number(self, cell: str) -> float:
        """Parse a cell, NaN if empty."""
        if cell and not _NUMBERS[self.decimal].fullmatch(cell):
            raise ValueError(cell)
        return float(cell.replace(self.decimal, ".")) if cell else np.nan


class Fit(NamedTuple):
    """How many lines are rows under a dialect, and the kinds of their columns."""

    dialect: Dialect
    kinds: str
    rows: int

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.kinds)

    def is_row(self, line: str) -> bool:
        """Test for a row: its cells hold what their columns do, or nothing."""
        return _is_row(self.dialect.kinds(line), self.kinds)


def _is_row(found: str, kinds: str) -> bool:
    known = [(one, kind) for one, kind in zip(found, kinds, strict=False) if kind not in "we" and one != "e"]
    return len(found) == len(kinds) and bool(known) and all(one == kind for one, kind in known)


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a file's rows.

    Attributes:
        closed: whether the rows end with a delimiter.
        stamps: how the columns of instants count, by place, as the first rows that are read have them.
        passed: see `Table`.
    """

    file: str
    dialect: Dialect
    names: Sequence[str]
    closed: bool
    stamps: dict[int, Stamps] = field(default_factory=dict)
    passed: Mapping[str, str] = field(default_factory=dict)

    def read(self, lines: Sequence[Line]) -> Table:
        """Parse rows."""
        mark, point = self.dialect
        texts = [line.text.rstrip(_BLANKS).removesuffix(mark) if self.closed else line.text for line in lines]
        try:
            # A point beside decimal commas makes no number.
            plain = texts if point == "." else [text.replace(".", "?").replace(",", ".") for text in texts]
            values = np.loadtxt(plain, delimiter=None if mark == _BLANKS else mark, comments=None, ndmin=2)
            return Table(dict(zip(self.names, values.T, strict=True)), source=self.file, passed=self.passed)
        except (ValueError, TypeError):  # words, quotes, an empty cell or a fault: only the slow way can tell
            rows = list(map(self.dialect.split, texts))
        for line, cells in zip(lines, rows, strict=True):
            if len(cells) != len(self.names):
                raise RecordError(
                    f"{self.file}: line {line.number} has {pluralise(len(cells), 'cell')} for "
                    f"{pluralise(len(self.names), 'column')}; mend or delete that line."
                )
        columns, passed = dict[str, FloatArray](), dict(self.passed)
        for place, (name, column) in enumerate(zip(self.names, zip(*rows, strict=True), strict=True)):
            found = self._parse(place, lines, column)
            if isinstance(found, str):
                passed[name] = found
            else:
                columns |= found
        if not columns:
            raise RecordError(f"{self.file} has no column of numbers; log the signals as numbers.")
        # A single column of instants is the clock, whatever its name.
        clock = [name for place, name in enumerate(self.names) if place in self.stamps and name in columns]
        is_clock = len(clock) == 1 and not any(map(TIME_NAME.fullmatch, columns))
        clocks = dict.fromkeys((name for name in columns if name not in clock), clock[0]) if is_clock else {}
        return Table(columns, {}, self.file, dict.fromkeys(clock, "s"), passed, clocks)

    def _parse(self, place: int, lines: Sequence[Line], cells: Sequence[str]) -> dict[str, FloatArray] | str:
        """Return the column of some cells, of lists "name[0]", "name[1]", ..., or why it is passed over."""
        name, dialect = self.names[place], self.dialect
        try:
            return {name: np.array([dialect.number(cell) for cell in cells])}
        except ValueError:
            kind = _commonest(map(dialect.kind, islice(filter(None, cells), _FILLED)))
        if kind in "dw":
            return f'it holds text, such as "{short(next(cell for cell in cells if dialect.kind(cell) == kind))}"'
        try:
            if kind == "t":
                if place not in self.stamps:
                    self.stamps[place] = Stamps.of(cells)
                return {name: self.stamps[place].seconds(cells)}
            if kind == "l" and all(dialect.kind(cell) == "l" for cell in cells):
                lists = np.array([_SEPARATOR.split(cell[1:-1].strip()) for cell in cells], dtype=np.float64)
                return {f"{name}[{k}]": column for k, column in enumerate(lists.T)}
        except ValueError:
            pass
        other = next((row for row, cell in enumerate(cells) if dialect.kind(cell) not in (kind, "e")), None)
        if other is None:
            return "its instants or its lists are not written alike"
        raise RecordError(
            f'{self.file}: line {lines[other].number}, column "{name}" holds "{short(cells[other])}", which is not '
            "like the other rows; mend it or leave the cell empty."
        )


def read_text(path: Path, **options: Any) -> Table:
    """Read delimited text (CSV, TSV and their kin) in UTF-8, in UTF-16 with a byte order mark, or in Latin-1.

    The line above the first row of numbers names the columns, be it a comment; a line of units between them
    is joined to the names ("torque [N m]"). A column without a name is called by its number, from "1".
    Empty cells are NaN. The first 8 MiB determine the dialect. An export of TwinCAT Scope is known by its header.
    """
    tables, size = list[Table](), 0
    for table in _read(path, None, TextOptions(**options)):
        tables.append(table)
        size += sum(values.size for values in table.columns.values())
        require_size(path, size)
    return join_tables(tables)


def read_text_blocks(path: Path, rows: int, **options: Any) -> Iterator[Table]:
    """Yield blocks of `rows` rows; the first lines determine the dialect."""
    return _read(path, rows, TextOptions(**options))


def _read(path: Path, rows: int | None, options: TextOptions) -> Iterator[Table]:
    head = _HEAD if rows is None else _BEGINNING
    lines = stream_lines(path, head)
    beginning = list(_take(lines, head))
    scope = None if options.header is False else find_scope([line.text for line in beginning if not line.is_remark])
    if scope is not None:
        if rows is not None:
            raise RecordError(f"{path.name} is an export of TwinCAT Scope, which is read whole; convert it to NPY.")
        yield read_scope(path, scope, [line for line in chain(beginning, lines) if not line.is_remark], options.decimal)
        return
    layout, start = _find_layout(path.name, beginning, options)
    content = (line for line in chain(beginning[start:], lines) if not line.is_remark)
    rows = rows or max(_CELLS // len(layout.names), 1)
    while block := list(islice(content, rows)):
        yield layout.read(block)


def open_text(path: Path) -> IO[bytes]:
    """Open the bytes of a text, which may be packed by gzip."""
    return gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb")  # type: ignore[return-value]


def find_encoding(path: Path, head: bytes) -> str:
    """Return the encoding of a text that begins so: UTF-8, UTF-16 with byte order mark, or Latin-1."""
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        encoding, text = "latin-1", head.decode("latin-1")
    if "\0" in text:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    return encoding


def stream_lines(path: Path, head: int) -> Iterator[Line]:
    """Yield the non-empty lines of a file of any length, comments too; so many bytes determine the encoding."""
    with open_text(path) as raw:
        encoding = find_encoding(path, raw.read(head))
    with open_text(path) as raw, io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file:
        # Not by iteration: a file may be one line that does not fit into memory.
        for number, line in enumerate(iter(lambda: file.readline(_LONGEST + 2), ""), start=1):
            if len(line) > _LONGEST:
                raise RecordError(
                    f"{path.name}: line {number} has more than {_LONGEST} characters; write a row for each sample."
                )
            if not line.isspace():
                yield Line(number, line.rstrip("\n"))


def _take(lines: Iterable[Line], characters: int) -> Iterator[Line]:
    """Yield lines of so many characters."""
    for line in lines:
        yield line
        characters -= len(line.text)
        if characters < 0:
            return


def _find_layout(file: str, beginning: Sequence[Line], options: TextOptions) -> tuple[Layout, int]:
    """Return the layout of a file, and the place of its first row."""
    content = [(place, line) for place, line in enumerate(beginning) if not line.is_remark]
    lines = [line for _, line in content]
    fit = _find_fit(file, lines, options)
    first = next(index for index, line in enumerate(lines) if fit.is_row(line.text))
    start, mark, rows = content[first][0], fit.dialect.delimiter, lines[first:]
    # Where all rows end with the delimiter, their empty last cell is a column only if it has a name.
    closed = mark != _BLANKS and all(row.text.rstrip(_BLANKS).endswith(mark) for row in rows[:-1] or rows)
    above = lines[max(first - 2, 0) : first]
    if not first and start and not beginning[start - 1].text.startswith("sep="):
        above = [beginning[start - 1]]
    named = _find_names(file, above, fit, closed, options.header)
    unnamed = closed and (named is None or len(named) < fit.width or not named[-1])
    width = fit.width - unnamed
    names = [name or str(i) for i, name in enumerate(named or [""] * width, start=1)][:width]
    require_width(Path(file), width)
    count = Counter(names)
    passed = {name: f"the name of {several} columns" for name, several in count.items() if several > 1}
    names = [f"column {i}: {name}" if name in passed else name for i, name in enumerate(names, start=1)]
    return Layout(file, fit.dialect, names, unnamed, passed=passed), start


def _find_fit(file: str, lines: Sequence[Line], options: TextOptions) -> Fit:
    """Choose the dialect, by the line of names if ambiguous.

    "1,5" is ambiguous: two integers, or a decimal comma. The last lines decide.
    """
    sample = list(_take(reversed(lines[-_SAMPLE:]), _SAMPLE_SIZE))[::-1]
    marks = (options.delimiter,) if options.delimiter else _DELIMITERS
    dialects = [Dialect(mark, point) for mark in marks for point in (options.decimal or ".,")]
    if options.delimiter is None and options.decimal != ".":
        dialects.append(Dialect(_COMMA_BLANK, ","))
    fits = [fit for dialect in dialects for fit in _fit(dialect, sample)]
    plain, mixed = ([fit for fit in fits if bool(fit.kinds.strip("n")) is other] for other in (False, True))
    best = _prefer_blanks(plain, max(plain, key=lambda fit: (fit.rows, fit.width > 1), default=None))
    if best is None or 2 * best.rows < len(sample):
        chosen = _prefer_blanks(mixed, max(mixed, key=lambda f: f.rows * len(f.kinds.strip("dwe")), default=None))
        if chosen is not None and (best is None or chosen.rows > 2 * best.rows):
            return chosen
    if best is None:
        raise RecordError(
            f"{file} has no row of numbers; expected columns of numbers with a decimal point or a decimal comma, "
            "without thousands separators."
        )
    pair = next((fit for fit in plain if fit.width == 2 and fit.dialect.delimiter == ","), None)
    single = next((fit for fit in plain if fit.width == 1 and fit.dialect.decimal == ","), None)
    if pair and single and best.rows == single.rows and best.dialect.delimiter != _COMMA_BLANK:
        first = next(index for index, line in enumerate(lines) if single.is_row(line.text))
        if first:
            return pair if len(_split_names(lines[first - 1].text, pair)) == pair.width else single
        raise RecordError(
            f'{file} can be read in two ways: "{lines[0].text}" is one number with a decimal comma, or two whole '
            'numbers; give decimal = "," or delimiter = ",".'
        )
    # A drive that stands still at the end logs whole numbers there: the decimal mark shows further up.
    twins = [f for f in plain if f.rows == best.rows and f.dialect.delimiter == best.dialect.delimiter]
    marked = [line.text for line in lines if "." in line.text or "," in line.text] if len(twins) > 1 else []
    return max(twins, key=lambda fit: sum(map(fit.is_row, marked)))


def _fit(dialect: Dialect, lines: Sequence[Line]) -> Iterator[Fit]:
    """Yield how a dialect reads lines: as rows of numbers alone, and as rows that also hold something else."""
    every = [dialect.kinds(line.text) for line in lines]
    numbers = Counter(len(kinds) for kinds in every if "n" in kinds and not kinds.strip("ne"))
    for width, rows in numbers.most_common(1):
        yield Fit(dialect, "n" * width, rows)
    width = Counter(map(len, every)).most_common(1)[0][0] if every else 0
    kinds = "".join(map(_commonest, zip(*(found for found in every if len(found) == width), strict=True)))
    rows = sum(_is_row(found, kinds) for found in every)
    if width < 2 or "n" not in kinds or not kinds.strip("n") or not rows:
        return
    alike = (dialect.split(line.text) for line, found in zip(lines, every, strict=True) if len(found) == width)
    words = {cell for cells in alike for cell, kind in zip(cells, kinds, strict=True) if kind == "w"}
    if not any(_SPLIT_NUMBER.fullmatch(cell) and dialect.kind(cell) == "w" for cell in words):
        yield Fit(dialect, kinds, rows)


def _commonest(kinds: Iterable[str]) -> str:
    """Return the commonest kind of filled cells; numbers for empty ones."""
    count = Counter(kinds)
    return max("nltdw", key=lambda kind: count[kind])


def _prefer_blanks(fits: Sequence[Fit], best: Fit | None) -> Fit | None:
    """Prefer fewer columns between ", ": the commas without a blank behind them are decimal marks."""
    spaced = next((fit for fit in fits if fit.dialect.delimiter == _COMMA_BLANK), None)
    return spaced if spaced and best and spaced.rows == best.rows and 1 < spaced.width < best.width else best


def _find_names(file: str, above: Sequence[Line], fit: Fit, closed: bool, header: bool | None) -> list[str] | None:
    """Cells of the last line above the rows, joined to those of the line over it; None without names."""
    if header and not above:
        raise RecordError(f"{file} has no line above the numbers; leave header = true out.")
    if not above or header is False:
        return None
    line, is_remark = above[-1], above[-1].is_remark
    names = _split_names(line.text.lstrip(" \t#%/") if is_remark else line.text, fit)
    fits = len(names) == fit.width or (closed and len(names) == fit.width - 1)
    number = next((name for name in names if any(one.fullmatch(name) for one in _NUMBERS.values())), None)
    if header is None and ((is_remark and number) or (not fits and (is_remark or (len(names) == 1 and not number)))):
        return None  # a remark, or the last line of a preamble
    if (header is None and number) or not fits:
        raise RecordError(
            f'{file}: line {line.number} ("{short(line.text)}") stands above the first row of '
            f"{pluralise(fit.width, 'column')} and does not name them; mend it, or give header = "
            f"{'true if it holds names, false if it is a remark' if fits else 'false'}."
        )
    return names if len(above) == 1 else _add_units(fit.dialect.split(above[-2].text), names)


def _split_names(text: str, fit: Fit) -> list[str]:
    """Split a line of names; a delimiter at its end is none."""
    spaced = fit.dialect.delimiter == _COMMA_BLANK
    names = (Dialect(",", ",") if spaced else fit.dialect).split(text)
    while len(names) > fit.width and not names[-1]:
        names.pop()
    return names


def _add_units(over: list[str], names: list[str]) -> list[str]:
    """Join a line of units to the names above it."""
    units = [match[1] or match[2] if (match := _BRACKETED.fullmatch(cell)) else cell for cell in names]
    bare = [cell for cell in names if cell not in _NO_UNIT and not _BRACKETED.fullmatch(cell)]
    # Under a remark, "m" alone is as well a name.
    if len(over) != len(names) or not any(units) or not all(map(_is_unit, bare)) or (len(names) == 1 and bare):
        return names
    return [name if u in _NO_UNIT else f"{name} [{u}]" for name, u in zip(over, units, strict=True)]


def _is_unit(text: str) -> bool:
    try:
        unit(normalise_unit(text))
    except UnitError:
        return text in _OTHER_UNITS
    return True


def write_text(path: Path, table: Table, **options: Any) -> None:
    """Write delimited UTF-8 with round-trip precision.

    Default delimiter and decimal mark are comma and point, or semicolon beside a decimal comma. Numbered columns
    have no header. Names that would read as numbers or spreadsheet formulas are refused.
    """
    require_columns(table, "Delimited text")
    said = TextOptions(**options)
    mark, point = said.delimiter or (";" if said.decimal == "," else ","), said.decimal or "."
    if mark == point:
        raise RecordError('A comma cannot be both delimiter and decimal mark of what is written; give delimiter = ";".')
    names = ["" if name == str(i) else name for i, name in enumerate(table.columns, start=1)]
    for name in names if any(names) else ():
        is_number = any(one.fullmatch(name) for one in _NUMBERS.values())
        if name.startswith(_RUN) or not name.isprintable() or name != name.strip() or is_number:
            raise RecordError(
                f"The column name {name!r} would not be read back from delimited text, or be run by a spreadsheet: a "
                "name is printable, is no number or formula and has no blank at its ends; rename the column."
            )
    special = re.compile(rf'[,;|"\t{re.escape(mark)}]')
    cells = ([repr(value).replace(".", point) for value in values.tolist()] for values in table.columns.values())
    heading = (
        '"{}"'.format(name.replace('"', '""')) if special.search(name) or name.startswith(_REMARKS) else name
        for name in names
    )
    rows = [*([mark.join(heading)] if any(names) else []), *map(mark.join, zip(*cells, strict=True)), ""]
    path.write_text("\n".join(rows), encoding="utf-8", newline="\n")
