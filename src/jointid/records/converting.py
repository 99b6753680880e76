"""Convert a file from one format to another, and list what was renamed or had no place."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.text import counted, shown
from jointid.records.formats import Format, Holds, Table, format_of, read_tables, write_table
from jointid.records.formats.table import join_tables
from jointid.records.formats.untrusted import require_size

_ROWS = 2**18  # that are read at once
_LISTED = 20


@dataclass(frozen=True, slots=True)
class Conversion:
    """Result of a conversion.

    Attributes:
        source, target: names of the files.
        formats: of the two.
        columns: name in the source -> name in the target.
        notes: sentences on what is not as it was.
    """

    source: str
    target: str
    formats: tuple[str, str]
    columns: Mapping[str, str]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        formats = f"{shown(self.source)} ({self.formats[0]}) -> {shown(self.target)} ({self.formats[1]})"
        kept = f"{formats}: {counted(len(self.columns), 'column')}."
        return "\n".join([kept, *(self.notes or ("Nothing was lost.",))])


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    columns: Sequence[str] | None = None,
    *,
    reading: Mapping[str, Any] | None = None,
    writing: Mapping[str, Any] | None = None,
) -> Conversion:
    """Write the columns of a file into a file of another format, each number to the last bit.

    A name that the target cannot have is changed as little as possible. Where all columns need one length, shorter ones
    are filled up with NaN at their end. Single numbers and units that have no place are left out. All of it is told.

    Args:
        source: the file that is read.
        target: the file that is written; its suffix tells the format. One that is there is replaced.
        columns: names of those that are taken, in this order; None takes all. From a file that is read in chunks only
            these need memory.
        reading: options of the source's format; see `jointid.records.formats.Csv`.
        writing: options of the target's; see `jointid.records.formats.Matlab`.

    Raises:
        RecordError: source and target are one file, the source cannot be read or has no such column, or the target
            cannot be written.
    """
    source, target = Path(source), Path(target)
    if target.exists() and source.exists() and source.samefile(target):
        raise RecordError(f"{target} is the file that is read, and is not written over; name another one.")
    writer = format_of(target, **(writing or {}))
    table = _read_columns(source, columns, reading or {})
    names = _choose_names(list(table.columns), writer)
    notes = [
        f'Renamed for {writer.name}: "{shown(old)}" is "{shown(new)}".' for old, new in names.items() if old != new
    ]
    write_table(target, _fit_table(_rename_columns(table, names), writer, notes), **(writing or {}))
    return Conversion(source.name, target.name, (format_of(source).name, writer.name), names, tuple(notes))


def _read_columns(source: Path, columns: Sequence[str] | None, options: Mapping[str, Any]) -> Table:
    parts: list[Table] = []
    numbers = 0
    for table in read_tables(source, _ROWS, **options):
        wanted = parts[0].columns if parts else table.columns if columns is None else columns
        # Behind its end a short column is in no table; that it is in none at all shows in the first.
        part = table.take([name for name in wanted if name in table.columns or not parts])
        numbers += sum(values.size for values in part.columns.values())
        parts.append(part)
        require_size(source, numbers)
    if not (parts and parts[0].columns):
        raise RecordError(f"{source.name} has no column; there is nothing to convert.")
    return join_tables(parts)


def _choose_names(names: list[str], writer: Format) -> dict[str, str]:
    """Return what every column is called in the target; no two have one name."""
    made = {name: name for name in names if writer.legal_name(name, names) == name}
    taken = set(made)
    for name in names:
        if name not in made:
            new = wanted = writer.legal_name(name, names)
            count = 1
            while new in taken:
                count += 1
                end = f"_{count}"
                new = writer.legal_name(f"{wanted}{end}")
                if not new.endswith(end):  # cut off: it is as long as a name may be
                    new = writer.legal_name(f"{wanted[: -len(end)]}{end}")
            made[name] = new
            taken.add(new)
    return {name: made[name] for name in names}


def _fit_table(table: Table, writer: Format, notes: list[str]) -> Table:
    """Return what the target can hold of a table; what it cannot is noted."""
    sizes = {values.size for values in table.columns.values()}
    if len(sizes) > 1 and Holds.LENGTHS not in writer.holds:
        short = [name for name, values in table.columns.items() if values.size < max(sizes)]
        notes.append(
            f"Filled up with NaN at the end, as {writer.name} has columns of one length: {_list_names(short)}."
        )
        filled = {
            name: np.concatenate([values, np.full(max(sizes) - values.size, np.nan)])
            for name, values in table.columns.items()
        }
        table = replace(table, columns=filled)
    if table.scalars and Holds.SCALARS not in writer.holds:
        left = [f"{name} = {value!r}" for name, value in table.scalars.items()]
        notes.append(f"Left out, as {writer.name} has no place for single numbers: {_list_names(left)}.")
        table = replace(table, scalars={})
    if table.units and Holds.UNITS not in writer.holds:
        left = [f"{name} in {unit}" for name, unit in table.units.items()]
        notes.append(f"Left out, as {writer.name} has no place for units: {_list_names(left)}.")
        table = replace(table, units={})
    if table.clocks and Holds.CLOCKS not in writer.holds:
        told = [f"{name}: {time}" for name, time in table.clocks.items()]
        notes.append(f"For the joint file, as {writer.name} does not say whose time a column is: {_list_names(told)}.")
    notes += [f"Not read: {shown(name)} ({shown(why)})." for name, why in table.passed.items()]
    return table


def _rename_columns(table: Table, names: Mapping[str, str]) -> Table:
    columns = {names[name]: values for name, values in table.columns.items()}
    units = {names[name]: unit for name, unit in table.units.items()}
    clocks = {names[name]: names[time] for name, time in table.clocks.items() if {name, time} <= names.keys()}
    return replace(table, columns=columns, units=units, clocks=clocks)


def _list_names(texts: list[str]) -> str:
    rest = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(map(shown, texts[:_LISTED])) + rest
