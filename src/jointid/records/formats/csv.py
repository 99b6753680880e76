"""Delimited text: any delimiter and decimal mark, names, comments or preamble.

Every dialect is tried on the last lines of the file. The one that parses most of them as rows of one width is chosen.
Ambiguous files are refused with the option that resolves it.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import ClassVar

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.text import pluralise, short
from jointid.common.units import UnitError, unit
from jointid.records.formats.scope import find_scope, read_scope
from jointid.records.formats.table import WIDEST, Block, Holds, NotStreamedError, Table, join_tables, require_place
from jointid.records.formats.text import (
    BLANKS,
    Dialect,
    Fit,
    Line,
    TextFile,
    build_text,
    is_comment,
    is_number,
    point_rows,
    read_lines,
    sniff,
    stream_lines,
)

_LONGEST_NAME = 1000  # characters
_BRACKETED = re.compile(r"\[(.*)\]|\((.*)\)")
_NO_UNIT = ("", "-")
_LONG, _LONG_BLOCK = 2**26, 100_000  # bytes of a file that is read in blocks of so many rows
_BEGINNING = 1000  # lines, that tell how those of a long file are written
_RUN = ("=", "+", "-", "@")  # with these a cell begins that a spreadsheet program takes for a formula
_DELIMITER = re.compile(r"[^\w\r\n\".+-]")  # anything but a part of a number, of a name, of a line end


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a file's rows from content line `start` on.

    `closed` marks rows that end with a delimiter.
    """

    file: str
    dialect: Dialect
    names: Sequence[str]
    start: int
    closed: bool

    def read(self, lines: Sequence[Line], ends: bool, count: int) -> Table:
        """Parse the first `count` lines, which may include the end of the file."""
        rows = lines[:count]
        if self.closed:
            rows = [Line(i, row.rstrip(BLANKS).removesuffix(self.dialect.delimiter)) for i, row in rows]
        mark = None if self.dialect.delimiter == BLANKS else self.dialect.delimiter
        try:
            plain = point_rows(rows, self.dialect.decimal)
            values = np.loadtxt(plain, dtype=np.float64, delimiter=mark, comments=None, ndmin=2)
        except ValueError:  # quotes, an empty cell or a fault: only the slow way can tell
            values = np.array([self._parse_row(row, ends and row is rows[-1]) for row in rows])
        return Table(dict(zip(self.names, values.T, strict=True)), source=self.file)

    def _parse_row(self, line: Line, last: bool) -> list[float]:
        """Parse one row; raise the sentence on its fault."""
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
        values = []
        for name, cell in zip(names, cells, strict=True):
            try:
                values.append(self.dialect.number(cell))
            except ValueError:
                raise RecordError(
                    f'{file}: line {line.number}, column "{name}" holds "{short(cell)}", which is not a number; '
                    "mend it or leave the cell empty."
                ) from None
        return values


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
    holds: ClassVar[Holds] = Holds.NOTHING

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
        if path.stat().st_size > _LONG:
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
        require_place(table, "Delimited text", self.holds)
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
        lines = stream_lines(path)
        text = build_text(path.name, list(islice(lines, _BEGINNING)))
        if find_scope(text) is not None:
            raise NotStreamedError(
                f"{path.name} is an export of TwinCAT Scope, whose rows are no instants: it cannot be read in chunks; "
                "convert it to NPY."
            )
        layout = self._layout(text)
        found = chain(text.lines[layout.start :], (line for line in lines if not is_comment(line.text)))
        block = list(islice(found, rows))
        while block:
            following = list(islice(found, rows))
            yield Block(len(block), partial(layout.read, block, not following))
            block = following

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return a single-line name that is not a number; see `Format.legal_name`."""
        plain = "".join(c if c.isprintable() else "_" for c in name).strip() or "column"
        return f"column {plain}" if is_number(plain) and not name.isdecimal() else plain

    def _layout(self, text: TextFile) -> Layout:
        try:
            fit = self._fit(text)
            dialect, width = fit.dialect, fit.width
            start = fit.first_row([line.text for line in text.lines])
            rows = text.lines[start:]
            # Where all rows end with the delimiter, their empty last cell is a column only if it has a name.
            closed = dialect.delimiter != BLANKS and all(
                row.text.rstrip(BLANKS).endswith(dialect.delimiter) for row in rows[:-1] or rows
            )
            header = self._names(text, start, fit, closed)
        except csv.Error as error:
            raise RecordError(f"{text.name} cannot be split into cells ({error}); is it delimited text?") from error
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
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise RecordError(
                f'{text.name} has more than one column called "{twice[0]}"; rename them, or give '
                "header = false to call the columns by their numbers."
            )
        return Layout(text.name, dialect, names, start, unnamed)

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
        return several if len(several.dialect.split(above.text)) == several.width else single

    def _names(self, text: TextFile, start: int, fit: Fit, closed: bool) -> list[str] | None:
        """Cells of the header; None without one."""
        above = text.above(start)
        if above is None or self.header is False:
            if self.header:
                raise RecordError(f"{text.name} has no line above the numbers; leave header = true out.")
            return None
        names = fit.dialect.split(above.text)
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
        unit(text)
    except UnitError:
        return False
    return True


def _write_header(table: Table, delimiter: str) -> list[str]:
    """Header lines; empty for numbered columns."""
    names = ["" if name == str(i) else name for i, name in enumerate(table.columns, start=1)]
    if not any(names):
        return []
    special = [is_comment(name) or any(mark in name for mark in f',;|"\t{delimiter}') for name in names]
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
