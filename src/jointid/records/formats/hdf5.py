"""HDF5: each numeric dataset is a column; also MAT files of version 7.3.

Declared sizes are checked before any numbers are in memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
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
    Table,
    describe_skips,
    format_size,
    require_size,
    require_unique_names,
)

SIGNATURE = b"\x89HDF\r\n\x1a\n"

_CHUNK = 2**30  # bytes that are decompressed at once; h5py's own are a mebibyte
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

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        with open_contents(path, _scan) as contents:
            return contents.read()


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

    def values(self, dataset: Member) -> list[FloatArray]:
        """Read each column."""
        if self.fields:
            records = dataset.fields(list(self.fields))[:]
            return [records[name].astype(np.float64) for name in self.fields]
        channels = np.moveaxis(dataset[:], self.along, -1).reshape(len(self.names), -1)
        return list(np.ascontiguousarray(channels, dtype=np.float64))


@dataclass(slots=True)
class Contents:
    """An open file: its datasets and their shapes, filled during the scan.

    Attributes:
        file: of h5py.
        scalars, passed: see `Table`.
        seen: how many datasets, groups and references there were.
    """

    path: Path
    file: Member
    signals: list[DatasetColumns] = field(default_factory=list)
    scalars: dict[str, float] = field(default_factory=dict)
    passed: dict[str, str] = field(default_factory=dict)
    seen: int = 0

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

    def read(self) -> Table:
        """Read every column."""
        columns: dict[str, FloatArray] = {}
        units: dict[str, str] = {}
        for signal in self.signals:
            columns.update(zip(signal.names, signal.values(self.file[signal.place]), strict=True))
            if signal.unit is not None:
                units.update(dict.fromkeys(signal.names, signal.unit))
        return Table(columns, self.scalars, self.path.name, units, self.passed)


@contextmanager
def open_contents(path: Path, scan: Callable[[Contents], None]) -> Iterator[Contents]:
    """Open a file with the layout of its columns.

    Args:
        path: the file.
        scan: lists the content by the format's names.
    """
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    with h5py.File(path, "r") as file:
        contents = Contents(path, file)
        scan(contents)
        signals = contents.signals
        if not (signals or contents.scalars):
            raise RecordError(
                f"{path.name} holds no numbers{describe_skips(contents.passed)}; expected datasets of one or two "
                "dimensions."
            )
        require_unique_names(path, [name for signal in signals for name in signal.names])
        numbers = sum(signal.rows * len(signal.names) for signal in signals)
        require_size(path, numbers)
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
