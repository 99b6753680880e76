"""HDF5: each numeric dataset is a column; also MAT files of version 7.3.

Declared sizes are checked before any numbers are in memory.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.arrays import REAL as NUMBERS
from jointid.records.formats.arrays import find_sides, skip_reason
from jointid.records.formats.table import (
    PIECES,
    WHOLE,
    Block,
    Holds,
    Table,
    describe_skips,
    explain_damage,
    format_size,
    require_size,
    require_unique_names,
    split_rows,
)

SIGNATURE = b"\x89HDF\r\n\x1a\n"
PACKING = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
"""Datasets are written packed and with a checksum, so that damage is noticed."""

_REMEDY = "log or copy it again"
_PACKED = 16384  # numbers that are compressed together
_CHUNK = 2**30  # bytes that are decompressed at once; h5py's own are a mebibyte
_USUAL_CACHE = 2**20  # bytes of a dataset's chunks that the library keeps
_CACHES = 2**29  # bytes of chunks that are kept of all datasets: a quarter of what reading a file may take
_CACHE_SLOTS, _CACHE_ORDER = 521, 0.75  # the library's own
# Numbers that are declared and were never written take time to read, and no room in the file. Packed by deflate, a byte
# stands for 1032 at most, and each of these may be a number.
_PACKED_MOST, _ANY_FILE = 10_000, 2**29  # bytes of numbers that a byte of a file, and any file, may declare
_MEMBERS = 100_000  # of all groups of a file
_UNITS = ("units", "unit", "Units", "Unit", "UNITS")

Member: TypeAlias = Any
"""A group or a dataset of h5py, which has no types."""


@dataclass(frozen=True, slots=True)
class Hdf5:
    """HDF5: one-dimensional datasets are columns "group/dataset", single numbers scalars.

    A matrix gives columns "name[0]", "name[1]", ... with samples along the longer side; sides of one number do not
    count. A dataset of records gives "name.field". The attribute "units" or "unit" is the unit. External and soft
    links, virtual or external storage, text, complex numbers and arrays of more dimensions are passed over.
    """

    name: ClassVar[str] = "HDF5"
    suffixes: ClassVar[tuple[str, ...]] = (".h5", ".hdf5", ".hdf")
    holds: ClassVar[Holds] = Holds.SCALARS | Holds.UNITS | Holds.LENGTHS

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        with open_contents(path, self.name, _scan) as contents:
            return contents.read(0, contents.rows)

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many."""
        with open_contents(path, self.name, _scan, PIECES) as contents:
            yield from split_rows(contents.rows, rows, contents.read)

    def write(self, path: Path, table: Table) -> None:
        """Write a compressed dataset with checksum and attribute "units" per column."""
        names = [*table.columns, *table.scalars]
        for name in names:
            if name != self.legal_name(name, names):
                raise RecordError(
                    f'{name!r} cannot name a dataset of HDF5: a name is a path, such as "group/dataset", without '
                    "empty parts, and no other name begins with it; rename the column."
                )
        twice = [name for name in table.scalars if name in table.columns]
        if twice:
            raise RecordError(f"{twice[0]!r} names a column and a scalar; HDF5 holds one dataset per name.")
        h5py = extra("h5py", "logs", "Writing HDF5")
        # In memory: a disk that is full ends the process inside the library.
        image = io.BytesIO()
        with h5py.File(image, "w", track_order=True) as file:
            for name, values in table.columns.items():
                chunks = (min(values.size, _PACKED),)
                dataset = file.create_dataset(name, data=values, chunks=chunks, **PACKING)
                if name in table.units:
                    dataset.attrs["units"] = table.units[name]
            for name, value in table.scalars.items():
                file[name] = value
        path.write_bytes(image.getbuffer())

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return a name as a path that no other extends; see `Format.legal_name`."""
        paths = [
            "/".join(part.replace("\0", "_") for part in each.split("/") if part not in ("", ".", "..")) or "_"
            for each in (name, *others)
        ]
        is_group = any(other.startswith(f"{paths[0]}/") for other in paths[1:])
        return f"{paths[0]}/value" if is_group else paths[0]


def _scan(contents: Contents) -> None:
    h5py = extra("h5py", "logs", "Reading HDF5")
    entered = set()

    def walk(group: Member, path: str) -> None:
        """List a group; a recursive one is entered once."""
        address = h5py.h5o.get_info(group.id).addr
        if address in entered:
            return
        entered.add(address)
        for name, member in contents.members(group, path):
            if isinstance(member, h5py.Dataset):
                contents.take(member, f"{path}{name}")
            elif isinstance(member, h5py.Group):
                walk(member, f"{path}{name}/")

    walk(contents.file, "")


class DatasetColumns(NamedTuple):
    """A dataset that gives columns.

    Attributes:
        fields: of the columns in a dataset of records, else empty.
        along: the dimension along which the samples run.
        unit: of all of them, None without one.
    """

    place: str
    names: tuple[str, ...]
    rows: int
    fields: tuple[str, ...] = ()
    along: int = 0
    unit: str | None = None

    def values(self, dataset: Member, first: int, last: int) -> list[FloatArray]:
        """Read rows `first` to `last` of each column."""
        if self.fields:
            records = dataset.fields(list(self.fields))[first:last]
            return [records[name].astype(np.float64) for name in self.fields]
        part = dataset[(slice(None),) * self.along + (slice(first, last),)]
        channels = np.moveaxis(part, self.along, -1).reshape(len(self.names), -1)
        return list(np.ascontiguousarray(channels, dtype=np.float64))


@dataclass(slots=True)
class Contents:
    """An open file: its datasets and their shapes, filled during the scan.

    Attributes:
        file: of h5py.
        scalars, passed: see `Table`.
        seen: how many datasets, groups and references there were.
        kept: datasets that stay open, by their place, with a cache for a chunk that several blocks are cut of.
    """

    path: Path
    format: str
    file: Member
    signals: list[DatasetColumns] = field(default_factory=list)
    scalars: dict[str, float] = field(default_factory=dict)
    passed: dict[str, str] = field(default_factory=dict)
    seen: int = 0
    kept: dict[str, Member] = field(default_factory=dict)
    caches: int = 0

    @property
    def rows(self) -> int:
        """Of the longest column."""
        return max((signal.rows for signal in self.signals), default=0)

    def members(self, group: Member, path: str) -> Iterator[tuple[str, Member]]:
        """Yield name and object of local members; note skipped ones.

        `path` is the group's prefix in the notes.
        """
        h5py = extra("h5py", "logs", "HDF5")
        for name in group:
            self.count_member()
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.HardLink):
                yield name, group[name]
            else:
                other = "another file" if isinstance(link, h5py.ExternalLink) else "another place"
                self.passed[f"{path}{name}"] = f"a link to {other}, which is not followed"

    def count_member(self) -> None:
        """Count a member; refuse implausibly many."""
        self.seen += 1
        if self.seen > _MEMBERS:
            raise RecordError(f"{self.path.name} has more than {_MEMBERS} datasets and groups; log fewer channels.")

    def take(self, dataset: Member, name: str, *, matlab: bool = False) -> None:
        """Register a dataset; note numbers that cannot be columns.

        `matlab` marks MATLAB's layout: transposed, complex numbers as records, single numbers as vectors.
        """
        shape, dtype = dataset.shape, dataset.dtype
        fields = tuple(field for field in dtype.names or () if dtype[field].kind in NUMBERS)
        if shape is None:
            self.passed[name] = "it is empty"
            return
        sides = find_sides(shape, square_turned=matlab)
        is_read = dtype.kind in NUMBERS or (fields and len(shape) == 1 and not matlab)
        why = refusal_reason(dataset) if is_read else _name_kind(dtype)
        if why is not None or isinstance(sides, str):
            self.passed[name] = why or str(sides)
        elif fields:
            names = tuple(f"{name}.{field}" for field in fields)
            self.signals.append(DatasetColumns(dataset.name, names, shape[0], fields))
        elif not shape or (math.prod(shape) == 1 and (matlab or len(shape) > 1)):
            self.scalars[name] = float(np.asarray(dataset[()]).item())
        else:
            along = [place for place, size in enumerate(shape) if size != 1]
            place = along[sides.turned] if len(along) > sides.turned else 0
            self.signals.append(
                DatasetColumns(dataset.name, sides.names(name), sides.rows, along=place, unit=_unit(dataset))
            )

    def read(self, first: int, count: int) -> Table:
        """Read `count` rows from `first` on, of sufficiently long columns."""
        columns: dict[str, FloatArray] = {}
        units: dict[str, str] = {}
        with explain_damage(self.path, self.format, _REMEDY):
            for signal in self.signals:
                if signal.rows > first:
                    values = signal.values(self._open(signal), first, min(first + count, signal.rows))
                    columns.update(zip(signal.names, values, strict=True))
                if signal.unit is not None:
                    units.update(dict.fromkeys(signal.names, signal.unit))
            return Table(columns, self.scalars, self.path.name, units, self.passed)

    def _open(self, signal: DatasetColumns) -> Member:
        """Open a dataset, with a cache for large chunks while memory permits.

        The default cache of a mebibyte would inflate a larger chunk again for every block.
        """
        if signal.place in self.kept:
            return self.kept[signal.place]
        dataset = self.file[signal.place]
        room = math.prod(dataset.chunks) * dataset.dtype.itemsize if dataset.chunks else 0
        for place, size in enumerate(dataset.chunks or ()):  # the chunks at one sample
            room *= 1 if place == signal.along else math.ceil(dataset.shape[place] / size)
        if room <= _USUAL_CACHE or self.caches + room > _CACHES:
            return dataset
        dataset.id.close()  # one that is open keeps the cache that it has
        h5py = extra("h5py", "logs", "HDF5")
        access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
        access.set_chunk_cache(_CACHE_SLOTS, room, _CACHE_ORDER)
        self.kept[signal.place] = h5py.Dataset(h5py.h5d.open(self.file.id, signal.place.encode(), access))
        self.caches += room
        return self.kept[signal.place]


@contextmanager
def open_contents(path: Path, name: str, scan: Callable[[Contents], None], limit: int = WHOLE) -> Iterator[Contents]:
    """Open a file with the layout of its columns.

    Args:
        path: the file.
        name: of its format.
        scan: lists the content by the format's names.
        limit: bytes of numbers that it may declare.
    """
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    path.open("rb").close()  # what cannot be opened is said by the system, not by the library
    with explain_damage(path, name, _REMEDY):
        file = h5py.File(path, "r")
    with file:
        contents = Contents(path, name, file)
        with explain_damage(path, name, _REMEDY):
            scan(contents)
            signals = contents.signals
            if not (signals or contents.scalars):
                raise RecordError(
                    f"{path.name} holds no numbers{describe_skips(contents.passed)}; expected datasets of one or two "
                    "dimensions."
                )
            require_unique_names(path, [name for signal in signals for name in signal.names])
        numbers = sum(signal.rows * len(signal.names) for signal in signals)
        require_size(path, numbers, limit)
        declared = 8 * numbers
        size = path.stat().st_size
        if declared > _ANY_FILE + _PACKED_MOST * size:
            raise RecordError(
                f"{path.name} declares {format_size(declared)} of numbers and has only {format_size(size)}: nearly all "
                "of them were never written; log or copy it again, or cut its datasets to what was logged."
            )
        yield contents


def refusal_reason(dataset: Member) -> str | None:
    """Reason to refuse a dataset: external numbers or too large chunks; else None."""
    h5py = extra("h5py", "logs", "HDF5")
    properties = dataset.id.get_create_plist()
    if properties.get_layout() == h5py.h5d.VIRTUAL:
        return "a virtual dataset, whose numbers are elsewhere"
    if properties.get_external_count():
        return "its numbers are in another file"
    packed = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize if dataset.chunks else 0
    if packed > _CHUNK:
        return f"its chunks are declared as {format_size(packed)} each"
    return None


def _name_kind(dtype: np.dtype[Any]) -> str:
    """Return the kind of a dataset without numbers; text of any length is an object of h5py."""
    h5py = extra("h5py", "logs", "HDF5")
    if h5py.check_string_dtype(dtype) is not None:
        return "it holds text"
    if dtype.kind == "c" or dtype.names in (("real", "imag"), ("r", "i")):
        return "it holds complex numbers"
    return skip_reason(dtype) or "it holds no numbers"


def _unit(dataset: Member) -> str | None:
    for key in _UNITS:
        if key not in dataset.attrs or math.prod(dataset.attrs.get_id(key).shape or ()) != 1:
            continue
        kind = dataset.attrs.get_id(key).dtype.kind
        text = np.asarray(dataset.attrs[key]).ravel()[0] if kind in "OS" else ""
        if isinstance(text, bytes):
            text = text.decode("utf-8", "replace")
        if isinstance(text, str) and text.strip():
            return text.strip()
        if kind in "OS":
            return None
    return None
