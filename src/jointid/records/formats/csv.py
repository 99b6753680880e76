"""Delimited text: any delimiter and decimal mark, names, comments or preamble.

Every dialect is tried on the last lines of the file. The one that parses most of them as rows of one width is chosen.
Ambiguous files are refused with the option that resolves it.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise, short
from jointid.common.units import UnitError, normalise_unit, unit
from jointid.records.formats.scope import find_scope, read_scope
from jointid.records.formats.stamps import Stamps, is_stamp
from jointid.records.formats.table import (
    TIME_NAME,
    WIDEST,
    Block,
    Table,
    join_tables,
    require_no_scalars,
    require_one_length,
)
from jointid.records.formats.text import (
    BLANKS,
    COMMA_BLANK,
    Dialect,
    Fit,
    Kind,
    Line,
    TextFile,
    build_text,
    exceeds,
    is_number,
    is_remark,
    kinds_of,
    open_lists,
    point_rows,
    read_lines,
    sniff,
    stream_lines,
)

_WORDY = re.compile(r"[A-Za-z_:/#]|\d-\d|\.\d*\.")  # what numbers alone, but for exponents and NaN, do not contain
_LONGEST_NAME = 1000  # characters
_BRACKETED = re.compile(r"\[(.*)\]|\((.*)\)")
_NO_UNIT = ("", "-")
_OTHER_UNITS = frozenset({
    "V", "mV", "µV", "uV", "kV", "mA", "µA", "uA", "kA", "W", "kW", "VA", "Hz", "kHz", "MHz", "°C", "degC", "C", "K",
    "bar", "Pa", "J", "g", "kg", "dB", "ppm", "m/s²", "m/s^2", "m/s2", "rad/s²", "rad/s2",
    "LU", "Inkr", "Inkr.", "Arms", "Aeff", "A_eff", "A rms", "Apk", "Vrms",
})  # fmt: skip
_LONG, _LONG_BLOCK = 2**25, 100_000  # bytes of a file that is read in blocks of so many rows
_BEGINNING = 1000  # lines, that tell how those of a long file are written
_RUN = ("=", "+", "-", "@")  # with these a cell begins that a spreadsheet program takes for a formula
_DELIMITER = re.compile(r"[^\w\r\n\".+-]")  # anything but a part of a number, of a name, of a line end


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a file's rows from content line `start` on.

    Attributes:
        closed: whether the rows end with a delimiter.
        numbers: places of the columns that hold numbers; None for all of them.
        stamps: the columns that hold instants, by place.
        passed: see `Table`.
    """

    file: str
    dialect: Dialect
    names: Sequence[str]
    start: int
    closed: bool
    numbers: Sequence[int] | None = None
    stamps: Mapping[int, Stamps] = field(default_factory=dict)
    passed: Mapping[str, str] = field(default_factory=dict)

    def read(self, lines: Sequence[Line], ends: bool, count: int) -> Table:
        """Parse the first `count` lines, which may include the end of the file."""
        rows = [self.open_row(row) for row in lines[:count]] if self.closed else lines[:count]
        if self.numbers is not None:
            return self._read_cells(rows, ends)
        mark = None if self.dialect.delimiter == BLANKS else self.dialect.delimiter
        try:
            plain = point_rows(rows, self.dialect.decimal)
            values = np.loadtxt(plain, dtype=np.float64, delimiter=mark, comments=None, ndmin=2)
        except (ValueError, TypeError):  # quotes, an empty cell or a fault: only the slow way can tell
            return self._read_cells(rows, ends)
        return Table(dict(zip(self.names, values.T, strict=True)), source=self.file, passed=self.passed)

    def _read_cells(self, rows: Sequence[Line], ends: bool) -> Table:
        """Parse cell by cell."""
        numbers = range(len(self.names)) if self.numbers is None else self.numbers
        values, instants = np.empty((len(rows), len(numbers))), {place: list[str]() for place in self.stamps}
        for index, row in enumerate(rows):
            cells = self._split_row(row, ends and row is rows[-1])
            values[index] = [self._parse_number(row, place, cells[place]) for place in numbers]
            for place, found in instants.items():
                found.append(cells[place])
        columns = {place: values[:, index] for index, place in enumerate(numbers)}
        for place, found in instants.items():
            columns[place] = self._parse_stamps(rows, place, found)
        read = {self.names[place]: columns[place] for place in sorted(columns)}
        clock = [self.names[place] for place in self.stamps]
        return Table(
            read,
            source=self.file,
            units=dict.fromkeys(clock, "s"),
            passed=self.passed,
            # A single column of instants is the clock, whatever its name.
            clocks={}
            if len(clock) != 1 or any(map(TIME_NAME.fullmatch, read))
            else dict.fromkeys((name for name in read if name not in clock), clock[0]),
        )

    def _split_row(self, line: Line, last: bool) -> list[str]:
        """Split one row; raise the sentence on its fault."""
        file, names = self.file, self.names
        try:
            cells = self.dialect.split(line.text)
        except csv.Error as error:
            raise RecordError(
                f"{file}: line {line.number} cannot be split into cells ({error}); mend or delete that line."
            ) from None
        if len(cells) != len(names):
            place = f"line {line.number}, the last," if last else f"line {line.number}"
            remedy = "the file was cut off or ends in a remark; delete" if last else "mend or delete"
            raise RecordError(
                f"{file}: {place} has {pluralise(len(cells), 'cell')} for {pluralise(len(names), 'column')}; {remedy} "
                "that line."
            )
        return cells

    def _parse_number(self, line: Line, place: int, cell: str) -> float:
        try:
            return self.dialect.number(cell)
        except ValueError:
            raise self._fault(line, place, cell, "a number") from None

    def _parse_stamps(self, rows: Sequence[Line], place: int, cells: Sequence[str]) -> FloatArray:
        stamps = self.stamps[place]
        try:
            return stamps.seconds(cells)
        except ValueError:
            for row, cell in zip(rows, cells, strict=True):
                try:
                    stamps.seconds([cell])
                except ValueError:
                    raise self._fault(row, place, cell, "an instant as in the rows above") from None
            raise

    def _fault(self, line: Line, place: int, cell: str, expected: str) -> RecordError:
        return RecordError(
            f'{self.file}: line {line.number}, column "{self.names[place]}" holds "{short(cell)}", which is not '
            f"{expected}; mend it or leave the cell empty."
        )

    def following(self, first: Line, before: Line) -> Layout:
        """Return the layout of the block from `first` on, whose times of day go on from the block from `before` on."""
        later = dict(self.stamps)
        for place, stamps in self.stamps.items():
            cells = [self._split_row(self.open_row(row), last=False)[place] for row in (before, first)]
            if stamps.period and all(map(is_stamp, cells)):
                later[place] = stamps.after(cells[1], float(stamps.seconds(cells[:1])[0]))
        return replace(self, stamps=later)

    def open_row(self, row: Line) -> Line:
        """Leave out the delimiter at the end of a row."""
        text = row.text.rstrip(BLANKS).removesuffix(self.dialect.delimiter) if self.closed else row.text
        return Line(row.number, text)


@dataclass(frozen=True, slots=True)
class Csv:
    """Delimited text (CSV, TSV and their kin) in UTF-8, in UTF-16 with a byte order mark, or in Latin-1.

    The line above the first row of numbers names the columns, be it a comment; a line of units between them
    is joined to the names ("torque [N m]"). A column without a name is called by its number, from "1".
    Empty cells are NaN. The beginning determines the dialect of a file of more than 64 MB. An export of
    TwinCAT Scope is known by its header; see `jointid.records.formats.scope`.

    Attributes:
        delimiter: one character, " " for any run of blanks; None finds it.
        decimal: "." or ","; None finds it.
        header: True if the line above the first row holds names; None takes it as names if it has one cell
            per column and none of them is a number.
    """

    delimiter: str | None = None
    decimal: str | None = None
    header: bool | None = None

    name: ClassVar[str] = "CSV"
    suffixes: ClassVar[tuple[str, ...]] = (".csv", ".txt", ".tsv", ".dat")

    def __post_init__(self) -> None:
        mark = self.delimiter
        if mark is not None and (not isinstance(mark, str) or not _DELIMITER.fullmatch(mark)):
            raise RecordError(f'The delimiter is one character, such as ";"; got {mark!r}.')
        if self.decimal not in (None, ".", ","):
            raise RecordError(f'The decimal mark is "." or ","; got {self.decimal!r}.')
        if self.header not in (None, True, False):
            raise RecordError(f"header is true or false; got {self.header!r}.")

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        if exceeds(path, _LONG):
            beginning = build_text(path.name, list(islice(stream_lines(path), _BEGINNING)))
            if find_scope(beginning) is None:  # the text would take several times the memory of its numbers
                return join_tables([block.table() for block in self.blocks(path, _LONG_BLOCK)])
        text = read_lines(path)
        scope = None if self.header is False else find_scope(text)
        if scope is not None:
            return read_scope(text, scope, self.decimal)
        layout = self._layout(text)
        rows = text.lines[layout.start :]
        return layout.read(rows, True, len(rows))

    def write(self, path: Path, table: Table) -> None:
        """Write delimited UTF-8 with round-trip precision.

        Default delimiter and decimal mark are comma and point, or semicolon beside a decimal comma. Numbered columns
        have no header. Scalars are refused, and names that would read as numbers or spreadsheet formulas.
        """
        require_no_scalars(table, "Delimited text")
        require_one_length(table, "Delimited text")
        mark, point = self.delimiter or (";" if self.decimal == "," else ","), self.decimal or "."
        if mark == point:
            raise RecordError(
                'A comma cannot be both delimiter and decimal mark of what is written; give delimiter = ";".'
            )
        cells = ([repr(value).replace(".", point) for value in values.tolist()] for values in table.columns.values())
        rows = map(mark.join, zip(*cells, strict=True))
        path.write_text("\n".join([*_write_header(table, mark), *rows, ""]), encoding="utf-8", newline="\n")

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield blocks of `rows` rows; the first lines determine the dialect."""
        lines = open_lists(stream_lines(path))
        text = build_text(path.name, list(islice(lines, _BEGINNING)))
        if find_scope(text) is not None:
            raise RecordError(
                f"{path.name} is an export of TwinCAT Scope, whose rows are no instants: it cannot be read in chunks; "
                "convert it to NPY."
            )
        layout = self._layout(text)
        found = chain(text.lines[layout.start :], (line for line in lines if not is_remark(line.text)))
        block = list(islice(found, rows))
        while block:
            following = list(islice(found, rows))
            yield Block(len(block), partial(layout.read, block, not following))
            if following and layout.stamps:
                layout = layout.following(following[0], block[0])
            block = following

    def _layout(self, text: TextFile) -> Layout:
        fit = self._fit(text)
        dialect, width = fit.dialect, fit.width
        start = fit.first_row([line.text for line in text.lines])
        rows = text.lines[start:]
        # Where all rows end with the delimiter, their empty last cell is a column only if it has a name.
        closed = dialect.delimiter != BLANKS and all(
            row.text.rstrip(BLANKS).endswith(dialect.delimiter) for row in rows[:-1] or rows
        )
        header = self._names(text, start, fit, closed)
        unnamed = closed and (header is None or len(header) < width or not header[-1])
        width -= unnamed
        names = [name or str(i) for i, name in enumerate(header or [""] * width, start=1)][:width]
        if width > WIDEST:
            raise RecordError(
                f"{text.name} has {width} columns (at most {WIDEST} are read); is it a matrix that lies on its side? "
                "Write a row for each sample."
            )
        if (longest := max(names, key=len)) and len(longest) > _LONGEST_NAME:
            raise RecordError(
                f'{text.name} has a column name of {len(longest)} characters, "{short(longest)}"; expected at most '
                f"{_LONGEST_NAME}: name it shorter, or give header = false to call the columns by their numbers."
            )
        passed: dict[str, str] = {}
        names = _tell_apart(names, passed)
        return _sort_columns(Layout(text.name, dialect, names, start, unnamed, passed=passed), rows)

    def _fit(self, text: TextFile) -> Fit:
        """Choose the dialect, by the line of names if ambiguous."""
        lines = [line.text for line in text.lines]
        fits = sniff(lines, self.delimiter, self.decimal)
        if not fits:
            raise RecordError(
                f"{text.name} has no row of numbers; expected columns of numbers with a decimal point or a "
                "decimal comma, without thousands separators."
            )
        if len(fits) == 1:
            return fits[0]
        several, single = fits
        start = single.first_row(lines)
        above = text.above(start)
        if above is None:
            raise RecordError(
                f'{text.name} can be read in two ways: "{lines[start]}" is one number with a decimal comma, '
                'or two whole numbers; give decimal = "," or delimiter = ",".'
            )
        return several if len(_split_names(above.text, several)) == several.width else single

    def _names(self, text: TextFile, start: int, fit: Fit, closed: bool) -> list[str] | None:
        """Cells of the header; None without one."""
        above = text.above(start)
        if above is None or self.header is False:
            if self.header:
                raise RecordError(f"{text.name} has no line above the numbers; leave header = true out.")
            return None
        names = _split_names(above.text, fit)
        fits = len(names) == fit.width or (closed and len(names) == fit.width - 1)
        numbers = [name for name in names if is_number(name)]
        if self.header is None:
            if start == 0 and (numbers or not fits):
                return None  # a remark in a comment
            if numbers:
                raise RecordError(
                    f'{text.name}: line {above.number} ("{short(above.text)}") stands above the first row '
                    f'and holds the number "{numbers[0]}"; mend it if it is a row, give header = true if it '
                    "holds names, header = false if it is a remark."
                )
            if len(names) == 1 and not fits:
                return None  # the last line of a preamble
        if not fits:
            comma = fit.dialect.delimiter == "," and 2 * len(names) == fit.width
            advice = "export it with a decimal point or with semicolons" if comma else "mend it"
            raise RecordError(
                f"{text.name}: line {above.number} has {pluralise(len(names), 'name')} for "
                f"{pluralise(fit.width, 'column')}; {advice}, or give header = false to call the columns by "
                "their numbers."
            )
        return _add_units(fit.dialect.split(text.lines[start - 2].text), names) if start > 1 else names


def _split_names(text: str, fit: Fit) -> list[str]:
    """Split a line of names; a delimiter at its end is none."""
    spaced = fit.dialect.delimiter == COMMA_BLANK
    names = (replace(fit.dialect, delimiter=",") if spaced else fit.dialect).split(text)
    while len(names) > fit.width and not names[-1]:
        names.pop()
    return names


def _tell_apart(names: Sequence[str], passed: dict[str, str]) -> list[str]:
    """Call columns of one name by their numbers too, and note the name that they share."""
    places: dict[str, list[int]] = {}
    for number, name in enumerate(names, start=1):
        places.setdefault(name, []).append(number)
    for name, found in places.items():
        if len(found) > 1:
            passed[name] = f'the name of {len(found)} columns; they are "column {found[0]}: {name}" and so on'
    return [f"column {i}: {name}" if name in passed else name for i, name in enumerate(names, start=1)]


def _sort_columns(layout: Layout, rows: Sequence[Line]) -> Layout:
    """Find the columns of instants, and those of words, which are passed over."""
    if not any(_WORDY.search(row.text) for row in rows):
        return layout
    width, dialect = len(layout.names), layout.dialect
    try:
        split = [(row, dialect.split(layout.open_row(row).text)) for row in rows]
    except csv.Error:
        return layout  # the row at fault is named when it is read
    alike = [(row, cells) for row, cells in split if len(cells) == width]
    kinds = kinds_of(dialect, [cells for _, cells in alike], width)
    passed = dict(layout.passed)
    stamps = {}
    for place, kind in enumerate(kinds):
        filled = ((row.number, cells[place]) for row, cells in alike if cells[place])
        if kind is Kind.STAMP:
            try:
                stamps[place] = Stamps.of([cell for _, cell in filled if dialect.kind_of(cell) is kind])
            except ValueError:
                passed[layout.names[place]] = "its instants are not written alike"
        elif kind is not Kind.NUMBER:
            line, cell = next(each for each in filled if dialect.kind_of(each[1]) is kind)
            passed[layout.names[place]] = f'it holds {kind.value}, such as "{short(cell)}" in line {line}'
    numbers = [place for place, kind in enumerate(kinds) if kind is Kind.NUMBER]
    if len(numbers) == width:
        return layout
    return replace(layout, numbers=numbers, stamps=stamps, passed=passed)


def _add_units(over: list[str], names: list[str]) -> list[str]:
    """Join a line of units to the names above it."""
    units = [match[1] or match[2] if (match := _BRACKETED.fullmatch(cell)) else cell for cell in names]
    bare = [cell for cell in names if cell not in _NO_UNIT and not _BRACKETED.fullmatch(cell)]
    if len(over) != len(names) or not any(units) or not all(map(_is_unit, bare)):
        return names
    if len(names) == 1 and bare:
        return names  # under a remark, "m" alone is as well a name
    return [name if u in _NO_UNIT else f"{name} [{u}]" for name, u in zip(over, units, strict=True)]


def _is_unit(text: str) -> bool:
    try:
        unit(normalise_unit(text))
    except UnitError:
        return text in _OTHER_UNITS
    return True


def _write_header(table: Table, delimiter: str) -> list[str]:
    """Header lines; empty for numbered columns."""
    names = ["" if name == str(i) else name for i, name in enumerate(table.columns, start=1)]
    if not any(names):
        return []
    special = [is_remark(name) or any(mark in name for mark in f',;|"\t{delimiter}') for name in names]
    line = delimiter.join(
        f'"{n.replace(chr(34), chr(34) * 2)}"' if s else n for n, s in zip(names, special, strict=True)
    )
    run = [name for name in names if name.startswith(_RUN)]
    if run:
        raise RecordError(
            f"The column name {run[0]!r} begins with a mark by which spreadsheet programs know a formula, which they "
            "would run when they open the file; rename the column, or write a .npy or .mat file."
        )
    refused = [name for name in names if not name.isprintable() or name != name.strip() or is_number(name)]
    if refused:
        raise RecordError(
            f"The column name {refused[0]!r} would not be read back from delimited text: a name is "
            "printable, is no number and does not begin or end with a blank; rename the column."
        )
    return [line]
