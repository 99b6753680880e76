"""File formats; a new one needs functions and a row of `FORMATS`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

from jointid.common.errors import JointidError, RecordError
from jointid.common.files import beside
from jointid.records.formats import arrays, bags, json, text
from jointid.records.formats.table import Table, join_tables
from jointid.records.formats.text import TextOptions

__all__ = ["FORMATS", "Format", "Table", "TextOptions", "format_of", "read_blocks", "read_table", "write_table"]


@dataclass(frozen=True, slots=True)
class Format:
    """A file format and its functions.

    Attributes:
        suffixes: file name endings, in lower case, with the dot.
        read: reads a whole file; None if `blocks` does.
        blocks: reads blocks of rows, for formats with consecutive rows.
        write: writes a table, which reading restores.
        is_text: whether files may be compressed by gzip.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path], Table] | None = None
    blocks: Callable[..., Iterator[Table]] | None = None
    write: Callable[..., None] | None = None
    is_text: bool = False


_TEXT = Format("CSV", (".csv", ".txt", ".tsv", ".dat"), None, text.read_text, text.write_text, True)
_FOLDER = Format("folder of files", (), bags.read_folder)
_BAG = Format("ROS 2 bag", bags.SUFFIXES, bags.read_bag)

FORMATS: tuple[Format, ...] = (
    _TEXT,
    Format("MAT", (".mat",), arrays.read_mat, write=arrays.write_mat),
    Format("NPY", (".npy",), None, arrays.read_npy, arrays.write_npy),
    Format("NPZ", (".npz",), arrays.read_npz),
    Format("JSON lines", (".jsonl", ".ndjson"), json.read_json, is_text=True),
    Format("HDF5", (".h5", ".hdf5", ".hdf"), arrays.read_hdf5),
    Format("Parquet", (".parquet", ".pq"), None, arrays.read_parquet, arrays.write_parquet),
    Format("TDMS", (".tdms",), arrays.read_tdms),
    _FOLDER,
    _BAG,
)
"""All formats."""


def format_of(path: str | os.PathLike[str], **options: object) -> Format:
    """Return the format for a suffix or a folder.

    Raises:
        RecordError: the suffix, or an option for the format, is unknown, or the path is none.
    """
    if not hasattr(path, "__fspath__") and str not in type(path).__mro__:
        given = type(path).__name__
        raise RecordError(f"Give the path of a record, not a {given}; arrays make ji.Record(torque=ji.Channel(...)).")
    is_folder = os.fspath(path).endswith(("/", os.sep)) or os.path.isdir(path)  # noqa: PTH112 - which of a path that cannot be says no
    path = Path(path)
    packed, suffix = path.suffix.lower() == ".gz", Path(path.name.lower().removesuffix(".gz")).suffix
    possible = [one for one in FORMATS if suffix in one.suffixes and (one.is_text or not packed)]
    if is_folder or not path.suffix:
        possible = [_FOLDER if is_folder and bags.is_record(path) else _BAG]
    if not possible:
        known = "; ".join(f"{entry.name}: {', '.join(entry.suffixes)}" for entry in FORMATS if entry.suffixes)
        raise RecordError(
            f'{path.name} has the suffix "{suffix}", which names no known format ({known}; texts with .gz, too; a '
            "pickle would run code); convert or unpack it."
        )
    found = possible[0]
    known_options = [option.name for option in fields(TextOptions)] if found is _TEXT else []
    if unknown := sorted(set(options) - set(known_options)):
        listed = ", ".join(known_options) or "none"
        raise RecordError(f"Reading {found.name} has no option {', '.join(unknown)}; it has: {listed}.")
    TextOptions(**options)  # type: ignore[arg-type]
    return found


def read_table(path: str | os.PathLike[str], **options: object) -> Table:
    """Read all numbers of a file; `options` as of `TextOptions`.

    Raises:
        RecordError: the file is missing or cannot be read.
    """
    reader, path = format_of(path, **options), Path(path)
    with _explain_failure(path, reader):
        if reader.read is not None:
            return reader.read(path).require_numbers()
        assert reader.blocks is not None
        return join_tables(reader.blocks(path, None, **options))


def read_blocks(path: str | os.PathLike[str], rows: int, **options: object) -> Iterator[Table]:
    """Yield blocks of rows, in bounded memory.

    Short columns are absent from blocks after their end.

    Raises:
        RecordError: see `read_table`; or the format has no consecutive rows.
    """
    reader, path = format_of(path, **options), Path(path)
    if reader.blocks is None:
        streamed = ", ".join(entry.name for entry in FORMATS if entry.blocks is not None)
        raise RecordError(f"{reader.name} cannot be read in chunks; convert {path.name} to one of {streamed}.")
    with _explain_failure(path, reader):
        yield from reader.blocks(path, rows, **options)


@contextmanager
def _explain_failure(path: Path, reader: Format) -> Iterator[None]:
    """Refuse an empty path, and convert reading errors of any library."""
    try:
        if not (path.stat().st_size and path.is_file()) and not path.is_dir():
            raise RecordError(f"{path.name} is empty, a pipe or a device; log or copy it again, to a file.")
        yield
    except JointidError:
        raise
    except Exception as error:
        said = (
            f"{path.name} cannot be read as {reader.name}: it is damaged, cut off or of another format; log or copy it "
            "again, or convert it to CSV or NPY by what wrote it."
        )
        if isinstance(error, MemoryError):
            said = f"{path.name} takes more memory than there is; log fewer channels, or cut it into shorter files."
        if isinstance(error, OSError) and error.errno:  # of the system; a library's own has no number
            said = f"{path} cannot be opened ({os.strerror(error.errno).lower()}); check the path."
        raise RecordError(said) from error


def write_table(path: str | os.PathLike[str], table: Table, **options: object) -> None:
    """Write a table as CSV, MAT (version 7), NPY or Parquet.

    Raises:
        RecordError: the format is another one or cannot hold the table, or the system reports an error.
    """
    path, writer = Path(path), format_of(path, **options)
    if writer.write is None or path.suffix.lower() == ".gz":
        written = ", ".join(entry.name for entry in FORMATS if entry.write is not None)
        raise RecordError(f"{path.name} is of a format that is read alone; write one of {written}.")
    is_even = len({values.size for values in table.columns.values()}) == 1
    if not is_even and writer.write is not arrays.write_mat:
        lengths = ", ".join(f"{name} {values.size}" for name, values in table.columns.items())
        raise RecordError(f"{writer.name} holds columns of one length; got {lengths or 'no column'}: leave some out.")
    with beside(path) as fresh:
        writer.write(fresh, table, **options)
