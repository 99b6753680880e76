"""Delimited text: any delimiter and decimal mark, names, comments or preamble.

Every dialect is tried on the last lines. The one that gives most rows of one kind is chosen.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, filterfalse, islice
from pathlib import Path
from typing import IO, Any, Literal, NamedTuple

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.text import pluralise, short
from jointid.common.units import UnitError, normalise_unit, unit
from jointid.records.formats.scope import is_scope, read_scope
from jointid.records.formats.stamps import Stamps, find_stamps, is_stamp
from jointid.records.formats.table import TIME_NAME, Table, require_room

_BLANKS = " "  # any run of blanks
_COMMA_BLANK = ", "  # comma and blank, beside decimal commas
_DELIMITERS = (_COMMA_BLANK, ";", "\t", "|", ",", _BLANKS)  # in order of preference
_DELIMITER = re.compile(r"[^\w\r\n\".+-]")  # no part of a number, name or line end
_REMARKS = ("#", "%", "//", "sep=")  # "sep=;" is a note between spreadsheet programs
_BEGINNING = 2**20  # characters that determine the dialect
_CELLS = 2**19  # cells of a block
_LONGEST = 2_500_000  # characters of a line: more than the widest table has
_SAMPLE = 200  # last lines, on which dialects are tried
_FILLED = 1000  # cells that determine a column's kind
_EXPONENT_OR_WORD = r"(?:e[+-]?\d+)?|nan|inf|infinity)"
_NUMBERS = {
    ".": re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
    # Digits must follow a decimal comma, so that "1, 2" is never one number.
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?" + _EXPONENT_OR_WORD, re.ASCII | re.IGNORECASE),
}
# Part of a number that was split at the wrong mark; not a date.
_SPLIT_NUMBER = re.compile(r"(?!\d\d?\.\d\d?\.\d{4}$)[\d\s.,;'|+-]*[.,;'|][\d\s.,;'|+-]*", re.ASCII)
_SEPARATOR = re.compile(r"\s*,\s*|\s+")  # of numbers in a list in a cell
_NO_UNIT = ("", "-")
_OTHER_UNITS = frozenset({
    "µV", "uV", "kV", "µA", "uA", "kA", "W", "kW", "VA", "MHz", "°C", "degC", "C", "K", "bar", "Pa", "J", "dB", "ppm",
    "m/s²", "m/s^2", "m/s2", "rad/s²", "rad/s2", "LU", "Inkr", "Inkr.", "Arms", "Aeff", "A_eff", "A rms", "Apk", "Vrms",
})  # fmt: skip
_UNSURE = ((",", "n"), (".", "nn"))  # the two readings of "1,5": decimal mark and column kinds
_NOWHERE = "\x1f"  # delimiter of cells that are already split
_RUN = ("=", "+", "-", "@")  # first characters of formulas in spreadsheet programs


def _check_delimiter(mark: object) -> None:
    if not _DELIMITER.fullmatch(str(mark)):
        raise RecordError(f'The delimiter is one character, such as ";"; got {mark!r}.')


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class TextOptions:
    """Options of delimited text."""

    delimiter: str | None = setting(
        None,
        'character between the cells of a text file; " " is any run of blanks; without it found',
        accept=_check_delimiter,
    )
    decimal: Literal[".", ","] | None = setting(None, "decimal mark of a text file; without it found")
    header: bool | None = setting(
        None,
        "whether a line above the numbers of a text file names the columns; by default it does if it has one cell "
        "for each column, none of them a number",
    )

    def __post_init__(self) -> None:
        check_settings(self, RecordError)


class Dialect(NamedTuple):
    """Rules for splitting and reading lines.

    Attributes:
        delimiter: a character, `_BLANKS` or `_COMMA_BLANK`.
        decimal: the decimal mark.
        kinds: a letter for each column: number, list of numbers, time or word.
        rows: number of sample lines that are rows of these kinds.
    """

    delimiter: str
    decimal: str
    kinds: str = ""
    rows: int = 0

    def split(self, line: str) -> list[str]:
        """Split a line into stripped cells; an unclosed quote makes one cell."""
        cells = [line]
        if self.delimiter == _COMMA_BLANK:
            return [cell.strip(' \t"') for cell in re.split(r",[ \t]+", line)]
        if '"' in line:
            with suppress(csv.Error):
                cells = next(csv.reader([line.strip(" ")], delimiter=self.delimiter, skipinitialspace=True))
        else:
            cells = line.split(None if self.delimiter == _BLANKS else self.delimiter)
        return [cell.strip() for cell in cells]

    def kind(self, cell: str) -> str:
        """Return the letter of a cell, "e" if it is empty."""
        if not cell or _NUMBERS[self.decimal].fullmatch(cell):
            return "n" if cell else "e"
        if cell[0] == "[" and cell[-1] == "]":
            return "l" if all(map(_NUMBERS["."].fullmatch, _SEPARATOR.split(cell[1:-1].strip()))) else "w"
        return "t" if is_stamp(cell) else "w"

    def kinds_of(self, line: str) -> str:
        """Return the letters of a line's cells."""
        return "".join(map(self.kind, self.split(line)))

    def is_row(self, line: str) -> bool:
        """Test for a row: each filled cell has its column's kind."""
        found = self.kinds_of(line)
        known = [(one, kind) for one, kind in zip(found, self.kinds, strict=False) if kind != "w" and one != "e"]
        return len(found) == len(self.kinds) and bool(known) and all(one == kind for one, kind in known)

    def with_points(self, text: str) -> str:
        """Write decimal points, with invalid marks for points beside decimal commas."""
        return text if self.decimal == "." else text.replace(".", "?").replace(",", ".")


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a file's rows.

    Attributes:
        closed: whether the rows end with a delimiter.
        stamps: formats of the columns of instants, by name, found in the first rows.
        passed: see `Table`.
    """

    path: Path
    dialect: Dialect
    names: Sequence[str]
    closed: bool
    passed: dict[str, str]
    stamps: dict[str, Stamps] = field(default_factory=dict)

    def read(self, lines: Sequence[str]) -> Table:
        """Parse rows."""
        dialect, kinds, width = self.dialect, self.dialect.kinds[: len(self.names)], len(self.names)
        texts = [line.rstrip(_BLANKS).removesuffix(dialect.delimiter) for line in lines] if self.closed else lines
        if dialect.decimal == "." or not set(kinds) - set("nw"):  # points in instants are kept
            with suppress(ValueError, TypeError):
                return self._load([dialect.with_points(text) for text in texts], dialect.delimiter, kinds)
        # Slow path for quotes, empty cells, kinds that differ from the end of the file, and faults.
        rows = list(map(dialect.split, texts))
        if all(len(row) == width for row in rows):
            columns = zip(*rows, strict=True)
            kinds = "".join(_commonest(map(dialect.kind, islice(filter(None, one), _FILLED))) for one in columns)
            with suppress(ValueError):
                every = (zip(row, kinds, strict=True) for row in rows)
                cells = ([dialect.with_points(c) or "nan" if kind == "n" else c for c, kind in row] for row in every)
                return self._load(list(map(_NOWHERE.join, cells)), _NOWHERE, kinds)
        like = dialect._replace(kinds=kinds)
        line = next((line for line, text in zip(lines, texts, strict=True) if not like.is_row(text)), lines[0])
        number = next(number for number, one in number_lines(self.path) if one == line)
        raise RecordError(
            f'{self.path.name}: line {number} has "{short(line)}", which is no row of '
            f"{pluralise(width, 'column')} like the others; mend or delete that line."
        )

    def _load(self, texts: Sequence[str], mark: str, kinds: str) -> Table:
        """Return the table of rows with decimal points; another width or kind is a ValueError."""
        cells = {k: list[str]() for k, kind in enumerate(kinds) if kind in "lt"}
        converters: dict[int | str, Callable[[str], float]] = {
            k: partial(_keep, cells.get(k)) for k, kind in enumerate(kinds) if kind != "n"
        }
        values = np.loadtxt(
            texts, delimiter=None if mark == _BLANKS else mark, comments=None, converters=converters or None, ndmin=2
        )
        table = Table(source=self.path.name, passed=self.passed)
        for k, (name, kind, column) in enumerate(zip(self.names, kinds, values.T, strict=True)):
            if kind == "n":
                table.add(name, column.copy())
            elif kind == "w":
                table.passed[name] = "it holds text"
            elif kind == "l":
                if not all(cell.startswith("[") for cell in cells[k]):
                    raise ValueError(name)
                try:
                    lists = np.array([_SEPARATOR.split(cell[1:-1].strip()) for cell in cells[k]], dtype=np.float64)
                except ValueError:
                    if mark != _NOWHERE:  # the slow path decides
                        raise
                    table.passed[name] = "its lists are empty, of several lengths, or hold text"
                    continue
                for place, numbers in enumerate(lists.T):
                    table.add(f"{name}[{place}]", numbers.copy())
            else:
                try:
                    stamps = self.stamps.get(name) or find_stamps(cells[k])
                    table.add(name, stamps.seconds(cells[k]), "s")
                except ValueError:
                    if mark != _NOWHERE:
                        raise
                    table.passed[name] = "its instants are of several kinds"
                    continue
                self.stamps[name] = stamps
        clock = [name for name in self.stamps if name in table.columns]
        if len(clock) == 1 and not any(map(TIME_NAME.fullmatch, table.columns)):
            # A single column of instants is the clock, whatever its name.
            table.clocks |= dict.fromkeys((name for name in table.columns if name not in clock), clock[0])
        return table.require_numbers()


def _keep(cells: list[str] | None, cell: str) -> float:
    """Store a cell that is not a number; return NaN."""
    if cells is not None:
        cells.append(cell.strip())
    return math.nan


def read_text(path: Path, rows: int | None, **options: Any) -> Iterator[Table]:
    """Read delimited text (CSV, TSV) in UTF-8, UTF-16 or Latin-1.

    The line above the first row of numbers, possibly a comment, names the columns; a line of units between them
    is joined to the names ("torque [N m]"). Unnamed columns are numbered from "1". Empty cells are NaN. The first MiB
    determines the dialect. UTF-16 needs a byte order mark. An export of TwinCAT Scope is recognised by its header.
    """
    said, beginning, size = TextOptions(**options), list[str](), 0
    lines = (line for _, line in number_lines(path) if line and not line.isspace())
    while size < _BEGINNING and (line := next(lines, None)) is not None:
        beginning.append(line)
        size += len(line)
    if said.header is not False and is_scope([*filterfalse(_is_remark, beginning)]):
        if rows is not None:
            raise RecordError(f"{path.name} is an export of TwinCAT Scope, which is read whole; convert it to NPY.")
        yield read_scope(path, [*filterfalse(_is_remark, chain(beginning, lines))], said.decimal)
        return
    layout, start = _find_layout(path, beginning, said)
    content = filterfalse(_is_remark, chain(beginning[start:], lines))
    while block := list(islice(content, rows or max(_CELLS // len(layout.names), 1))):
        yield layout.read(block)


def open_text(path: Path) -> IO[bytes]:
    """Open the bytes of a text, which may be compressed by gzip."""
    return gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb")  # type: ignore[return-value]


def number_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield numbered lines of a file in UTF-8, UTF-16 or Latin-1."""
    with open_text(path) as raw:
        head = raw.read(_BEGINNING)
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        encoding, text = "latin-1", head.decode("latin-1")
    if "\0" in text:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    with open_text(path) as raw, io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file:
        # Not by iteration: a single line may not fit into memory.
        for number, line in enumerate(iter(lambda: file.readline(_LONGEST + 2), ""), start=1):
            if len(line) > _LONGEST:
                raise RecordError(
                    f"{path.name}: line {number} has more than {_LONGEST} characters; write a row for each sample."
                )
            yield number, line.rstrip("\n")


def _is_remark(line: str) -> bool:
    return line.lstrip().startswith(_REMARKS)


def _find_layout(path: Path, beginning: Sequence[str], options: TextOptions) -> tuple[Layout, int]:
    """Return a file's layout and the index of its first row."""
    lines = [*filterfalse(_is_remark, beginning)]
    dialect = _choose_dialect(path.name, lines, options)
    first = next(place for place, line in enumerate(lines) if dialect.is_row(line))
    start, mark = beginning.index(lines[first]), dialect.delimiter
    above = lines[max(first - 2, 0) : first] or [line for line in beginning[:start][-1:] if not line.startswith("sep=")]
    # If all rows end with the delimiter, the empty last cell is a column only if named.
    rows = lines[first:]
    closed = mark != _BLANKS and all(row.rstrip(_BLANKS).endswith(mark) for row in rows[:-1] or rows)
    names = _find_names(path.name, above, dialect, closed, options.header)
    if unnamed := closed and not names[-1]:
        names.pop()
    require_room(path.name, 0, len(names))
    names = [name or str(place) for place, name in enumerate(names, start=1)]
    passed = {name: f"the name of {count} columns" for name, count in Counter(names).items() if count > 1}
    names = [f"column {i}: {name}" if name in passed else name for i, name in enumerate(names, start=1)]
    return Layout(path, dialect, names, unnamed, passed), start


def _choose_dialect(file: str, lines: Sequence[str], options: TextOptions) -> Dialect:
    """Choose the dialect with most rows; rows of numbers count double.

    "1,5" is ambiguous: two integers, or a decimal comma. A line of names decides, or an option must.
    """
    sample, marks = lines[-_SAMPLE:], (options.delimiter,) if options.delimiter else _DELIMITERS
    tried = [Dialect(mark, point) for mark in marks for point in options.decimal or ".,"]
    if not any('"' in line for line in sample):  # only quotes separate decimal and delimiting commas
        tried = [dialect for dialect in tried if dialect.delimiter != dialect.decimal]
    fits = [fit for dialect in tried if (fit := _fit(dialect, sample)) is not None]
    if not fits:
        raise RecordError(
            f"{file} has no row of numbers; expected columns of numbers with a decimal point or a decimal comma, "
            "without thousands separators."
        )
    best = max(fits, key=_rank)
    unsure = [next((f for f in fits if (f.decimal, f.kinds) == one), None) for one in _UNSURE]
    if best in unsure and None not in unsure:
        first = next(place for place, line in enumerate(lines) if best.is_row(line))
        if not first:
            raise RecordError(
                f'{file} can be read in two ways: "{lines[0]}" is one number with a decimal comma, or two whole '
                'numbers; give decimal = "," or delimiter = ",".'
            )
        best = unsure["," in lines[first - 1]] or best
    # At standstill, a drive may log whole numbers only: earlier lines then show the decimal mark.
    twins = [fit for fit in fits if (_rank(fit), fit.delimiter) == (_rank(best), best.delimiter)]
    marked = [line for line in lines if "." in line or "," in line] if len(twins) > 1 else []
    return max(twins, key=lambda fit: sum(map(fit.is_row, marked)))


def _fit(dialect: Dialect, lines: Sequence[str]) -> Dialect | None:
    """Return a dialect with its column kinds and rows, or None."""
    every = {line: kinds for line in lines if "n" in (kinds := dialect.kinds_of(line))}
    if not every:
        return None
    width = Counter(map(len, every.values())).most_common(1)[0][0]
    alike = {line: kinds for line, kinds in every.items() if len(kinds) == width}
    fit = dialect._replace(kinds="".join(map(_commonest, zip(*alike.values(), strict=True))))
    cells = list(chain.from_iterable(map(dialect.split, alike)))
    if dialect.delimiter == _COMMA_BLANK and (width == 1 or not any("," in cell for cell in cells)):
        return None
    if "w" in fit.kinds and any(_SPLIT_NUMBER.fullmatch(c) and dialect.kind(c) == "w" for c in cells):
        return None
    rows = sum(map(fit.is_row, lines))
    return fit._replace(rows=rows) if rows and "n" in fit.kinds else None


def _rank(fit: Dialect) -> tuple[int, bool, int]:
    is_plain = not fit.kinds.strip("n")
    return fit.rows * (1 + is_plain), len(fit.kinds) > 1, 0 if is_plain else len(fit.kinds) - fit.kinds.count("w")


def _commonest(kinds: Iterable[str]) -> str:
    """Return the commonest kind of filled cells; numbers if all are empty."""
    count = Counter(kinds)
    return max("nltw", key=lambda kind: count[kind])


def _find_names(file: str, above: Sequence[str], dialect: Dialect, closed: bool, header: bool | None) -> list[str]:
    """Return the column names above the rows, joined to units."""
    width = len(dialect.kinds)
    if header and not above:
        raise RecordError(f"{file} has no line above the numbers; leave header = true out.")
    if not above or header is False:
        return [""] * width
    is_remark = _is_remark(above[-1])
    split = Dialect(",", ".").split if dialect.delimiter == _COMMA_BLANK else dialect.split
    names = split(above[-1].lstrip(" \t#%/") if is_remark else above[-1])
    while len(names) > width and not names[-1]:
        names.pop()
    names += [""] * (closed and len(names) == width - 1)
    fits = len(names) == width
    has_number = any(one.fullmatch(name) for one in _NUMBERS.values() for name in names)
    if header is None and ((is_remark and (has_number or not fits)) or (len(names) == 1 != width and not has_number)):
        return [""] * width  # a remark, or the last line of a preamble
    if not fits or (header is None and has_number):
        raise RecordError(
            f'{file}: the line "{short(above[-1])}" does not name {pluralise(width, "column")}; put semicolons between '
            "decimal commas, or give header = true if it holds names, false if it is a remark."
        )
    over = dialect.split(above[-2]) if len(above) > 1 else []
    units = [cell[1:-1] if cell[:1] + cell[-1:] in ("[]", "()") else cell for cell in names]
    bare = [cell for cell, one in zip(names, units, strict=True) if cell == one and cell not in _NO_UNIT]
    # Below a remark, a single "m" may also be a name.
    if len(over) != width or not any(units) or not all(map(_is_unit, bare)) or (width == 1 and bare):
        return names
    return [name if one in _NO_UNIT else f"{name} [{one}]" for name, one in zip(over, units, strict=True)]


def _is_unit(text: str) -> bool:
    with suppress(UnitError):
        return bool(unit(normalise_unit(text)))
    return text in _OTHER_UNITS


def write_text(path: Path, table: Table, **options: Any) -> None:
    """Write delimited UTF-8 with round-trip precision.

    The default delimiter is a comma, or a semicolon beside a decimal comma. Numbered columns have no header. Names
    that would be read as numbers or spreadsheet formulas are refused.
    """
    said = TextOptions(**options)
    mark, point = said.delimiter or (";" if said.decimal == "," else ","), said.decimal or "."
    if mark == point:
        raise RecordError('A comma cannot be both delimiter and decimal mark of what is written; give delimiter = ";".')
    names = ["" if name == str(i) else name for i, name in enumerate(table.columns, start=1)]
    for name in filter(None, names):
        is_number = any(one.fullmatch(name) for one in _NUMBERS.values())
        is_cut = len(names) == 1 and ";" in name  # a single column would be split there
        if name.startswith((*_RUN, *_REMARKS)) or not name.isprintable() or name != name.strip() or is_number or is_cut:
            raise RecordError(
                f"The column name {name!r} would not be read back from delimited text, or be run by a spreadsheet: a "
                'name is printable, is no number, remark or formula and has no blank at its ends, nor ";" where alone; '
                "rename the column."
            )
    rows = zip(*([repr(v).replace(".", point) for v in one.tolist()] for one in table.columns.values()), strict=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter=mark, lineterminator="\n")
        writer.writerows([names, *rows] if any(names) else rows)
