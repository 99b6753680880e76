"""File formats: to add one, write its `Format` and name it in `FORMATS`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

from jointid.common.errors import JointidError, RecordError
from jointid.common.files import beside
from jointid.records.formats.csv import Csv
from jointid.records.formats.folder import Folder
from jointid.records.formats.hdf5 import Hdf5
from jointid.records.formats.json import Json
from jointid.records.formats.matlab import Matlab
from jointid.records.formats.npy import Npy
from jointid.records.formats.npz import Npz
from jointid.records.formats.parquet import Parquet
from jointid.records.formats.rosbag import RosBag
from jointid.records.formats.table import (
    Block,
    Format,
    Streamed,
    Table,
    Written,
    require_file,
)
from jointid.records.formats.tdms import Tdms
from jointid.records.formats.text import is_gzip

__all__ = [
    "FORMATS", "Block", "Csv", "Folder", "Format", "Hdf5", "Json", "Matlab", "Npy", "Npz", "Parquet", "RosBag",
    "Streamed", "Table", "Tdms", "format_of", "read_blocks", "read_table", "write_table",
]  # fmt: skip

FORMATS: tuple[Format, ...] = (Csv(), Matlab(), Npy(), Npz(), Json(), Hdf5(), Parquet(), Tdms(), Folder(), RosBag())
"""Every format there is."""

_PICKLES = (".pt", ".pth", ".pkl", ".pickle")
_TEXTS = (Csv, Json)  # that are read packed, too


def format_of(path: str | os.PathLike[str], **options: object) -> Format:
    """Return the format for a suffix, with reader options; a folder is a ROS 2 bag, or holds several files.

    Raises:
        RecordError: unknown suffix or option.
    """
    is_folder = os.fspath(path).endswith(("/", os.sep)) or os.path.isdir(path)  # noqa: PTH112 - which of a path that cannot be says no
    path = Path(path)
    packed = is_gzip(path) and not is_folder
    suffix = path.suffixes[-2] if packed and len(path.suffixes) > 1 else path.suffix
    if suffix.lower() in _PICKLES and not is_folder:
        raise RecordError(
            f"{path.name} is a pickle, which runs code when it is loaded, and is not read; convert it where it comes "
            "from, by numpy.savez."
        )
    for entry in FORMATS:
        if isinstance(entry, Folder) and is_folder and entry.fits(path):
            break
        if suffix.lower() in entry.suffixes and not is_folder and (not packed or isinstance(entry, _TEXTS)):
            break
        if isinstance(entry, RosBag) and (is_folder or not path.suffix):
            break
    else:
        known = "; ".join(f"{entry.name}: {', '.join(entry.suffixes)}" for entry in FORMATS if entry.suffixes)
        fact = f'has the suffix "{path.suffix}", which names no known format ({known})'
        if packed and suffix != path.suffix:
            fact = f'is packed by gzip, which is unpacked for texts alone; unpack it to "{path.stem}"'
        raise RecordError(f"{path.name} {fact}.")
    known = ", ".join(option.name for option in fields(entry)) or "none"
    unknown = set(options) - {option.name for option in fields(entry)}
    if unknown:
        raise RecordError(f"Reading {entry.name} has no option {', '.join(sorted(unknown))}; it has: {known}.")
    return replace(entry, **options)


def read_table(path: str | os.PathLike[str], **options: object) -> Table:
    """Read all numbers of a file; `options` are the format's, see `Csv`.

    Raises:
        RecordError: the file is missing or cannot be read.
    """
    path = Path(path)
    reader = format_of(path, **options)
    with _explain_failure(path, reader):
        require_file(path)
        return reader.read(path)


def read_blocks(path: str | os.PathLike[str], rows: int, **options: object) -> Iterator[Block]:
    """Yield blocks of `rows` rows in bounded memory, read on demand.

    Raises:
        RecordError: see `read_table`; or the format has no consecutive rows.
    """
    path = Path(path)
    reader = format_of(path, **options)
    if not isinstance(reader, Streamed):
        streamed = ", ".join(entry.name for entry in FORMATS if isinstance(entry, Streamed))
        raise RecordError(f"{reader.name} cannot be read in chunks; convert {path.name} to one of {streamed}.")

    def read(block: Block, count: int) -> Table:
        """Read a block outside of this generator."""
        with _explain_failure(path, reader):
            return block.table(count)

    with _explain_failure(path, reader):
        require_file(path)
        for block in reader.blocks(path, rows):
            yield Block(block.rows, partial(read, block))


@contextmanager
def _explain_failure(path: Path, reader: Format) -> Iterator[None]:
    """Say in a sentence why a file cannot be read, whatever the library of its format raises."""
    try:
        yield
    except JointidError:
        raise
    except MemoryError as error:
        raise RecordError(
            f"{path.name} takes more memory than there is; log fewer channels, or cut it into shorter files."
        ) from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno:  # of the system; a library's own has no number
            said = os.strerror(error.errno).lower()
            raise RecordError(f"{path} cannot be opened ({said}); check the path.") from error
        raise RecordError(
            f"{path.name} cannot be read as {reader.name}: it is damaged, cut off or of another format; log or copy it "
            "again, or convert it to CSV or NPY by what wrote it."
        ) from error


def write_table(path: str | os.PathLike[str], table: Table, **options: object) -> None:
    """Write a table as CSV, MAT (version 7), NPY or Parquet, as it is read with these `options`; replaces the file.

    Raises:
        RecordError: a suffix of no such format, a table that the format cannot hold, or an error of the system.
    """
    path = Path(path)
    writer = format_of(path, **options)
    if not isinstance(writer, Written) or is_gzip(path):
        written = ", ".join(entry.name for entry in FORMATS if isinstance(entry, Written))
        raise RecordError(f"{path.name} is of a format that is read alone; write one of {written}.")
    with beside(path) as fresh:
        writer.write(fresh, table)
