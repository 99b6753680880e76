"""File formats, one file each: to add one, write its `Format` and name it in `FORMATS`."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from pathlib import Path

from jointid.common.errors import RecordError
from jointid.data.formats.csv import Csv
from jointid.data.formats.matlab import Matlab
from jointid.data.formats.table import Format, Table

__all__ = ["FORMATS", "Csv", "Format", "Matlab", "Table", "format_of", "read_table", "write_table"]

FORMATS: tuple[Format, ...] = (Csv(), Matlab())
"""Every format there is."""


def format_of(path: str | os.PathLike[str], **options: object) -> Format:
    """Return the format that the file's suffix names, with its reader set to `options`.

    Raises:
        RecordError: no format has this suffix, or the format has no such option; the sentence says which.
    """
    path = Path(path)
    for entry in FORMATS:
        if path.suffix.lower() in entry.suffixes:
            break
    else:
        known = "; ".join(f"{entry.name}: {', '.join(entry.suffixes)}" for entry in FORMATS)
        raise RecordError(f'{path.name} has the suffix "{path.suffix}", which names no known format ({known}).')
    known = ", ".join(option.name for option in fields(entry)) or "none"
    unknown = set(options) - {option.name for option in fields(entry)}
    if unknown:
        raise RecordError(f"Reading {entry.name} has no option {', '.join(sorted(unknown))}; it has: {known}.")
    return replace(entry, **options)


def read_table(path: str | os.PathLike[str], **options: object) -> Table:
    """Read all the numbers of a file, choosing the format by its suffix.

    Args:
        path: the file.
        options: options of the format's reader; see `Csv`.

    Raises:
        RecordError: there is no such file, or it cannot be read; the sentence says why.
    """
    path = Path(path)
    reader = format_of(path, **options)
    if path.is_dir():
        raise RecordError(f"{path} is a folder; name a file in it.")
    try:
        if path.stat().st_size == 0:
            raise RecordError(f"{path.name} is empty (0 bytes); log or copy it again.")
        return reader.read(path)
    except OSError as error:
        raise RecordError(f"{path} cannot be opened ({_reason(error)}); check the path.") from error


def write_table(path: str | os.PathLike[str], table: Table, **options: object) -> None:
    """Write `table`, choosing the format by the path's suffix; an existing file is replaced.

    Args:
        path: the file.
        table: what is written.
        options: with which the format will read it; see `Csv`.

    Raises:
        RecordError: no format has this suffix, it cannot hold the table, or the file cannot be written.
    """
    path = Path(path)
    writer = format_of(path, **options)
    try:
        writer.write(path, table)
    except OSError as error:
        raise RecordError(f"{path} cannot be written ({_reason(error)}); check the folder.") from error


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()
