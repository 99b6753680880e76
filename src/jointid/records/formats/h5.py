"""Read datasets as columns, by slices: common to HDF5 files and MAT files of version 7.3.

Only what is in the file itself is read: external and soft links are not followed, and datasets that are put together
from other files (virtual, or with external storage) are passed over. What a dataset declares is known before any of its
numbers is in memory.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.isolated import read_parts
from jointid.records.formats.table import Table
from jointid.records.formats.untrusted import PIECES, explain_damage, format_size, require_size, require_unique_names

SIGNATURE = b"\x89HDF\r\n\x1a\n"
REMEDY = "log or copy it again"
NUMBERS = "fiub"
"""Kinds of NumPy's types that are real numbers."""

_CHUNK = 2**30  # bytes that are decompressed at once; h5py's own are a mebibyte
_WIDEST = 1000  # columns of a matrix; one that is wider is a picture
_MEMBERS = 100_000  # of all groups of a file
_UNITS = ("units", "unit", "Units", "Unit", "UNITS")

Member: TypeAlias = Any
"""A group or a dataset of h5py, which has no types."""


class DatasetColumns(NamedTuple):
    """A dataset that gives columns.

    Attributes:
        place: its path in the file.
        names: of the columns.
        rows: of each.
        fields: of the columns in a dataset of records, else empty.
        turned: True if the samples run along the second dimension.
        unit: of all of them, None without one.
        unit_at: name of the attribute with the unit, where that is a text of no fixed length.
    """

    place: str
    names: tuple[str, ...]
    rows: int
    fields: tuple[str, ...] = ()
    turned: bool = False
    unit: str | None = None
    unit_at: str = ""

    def values(self, file: Member, first: int, last: int) -> list[FloatArray]:
        """Return the rows from the first up to the last of every column."""
        dataset = file[self.place]
        if self.fields:
            records = dataset.fields(list(self.fields))[first:last]
            return [records[name].astype(np.float64) for name in self.fields]
        if dataset.ndim == 1:
            return [dataset[first:last].astype(np.float64)]
        matrix = dataset[:, first:last].T if self.turned else dataset[first:last, :]
        return list(np.ascontiguousarray(matrix.T, dtype=np.float64))


@dataclass(slots=True)
class Contents:
    """Datasets of a file and their shapes, without their numbers; filled while the file is walked through."""

    signals: list[DatasetColumns] = field(default_factory=list)
    scalars: dict[str, float] = field(default_factory=dict)
    passed: dict[str, str] = field(default_factory=dict)
    format: str = "HDF5"

    @property
    def numbers(self) -> int:
        """Count of numbers in all columns."""
        return sum(signal.rows * len(signal.names) for signal in self.signals)

    @property
    def rows(self) -> int:
        """Of the longest column."""
        return max((signal.rows for signal in self.signals), default=0)

    def take(self, dataset: Member, name: str, *, matlab: bool = False) -> None:
        """Note a dataset; what holds no numbers is left out, and numbers that cannot be columns are noted as such.

        A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side. A dataset of
        records gives "name.field".

        Args:
            dataset: of h5py.
            name: what its columns are called.
            matlab: True if MATLAB wrote it: rows and columns the other way round, complex numbers as records, and
                every single number as a vector.
        """
        shape, dtype = dataset.shape, dataset.dtype
        fields = tuple(field for field in dtype.names or () if dtype[field].kind in NUMBERS)
        if shape is None or not (dtype.kind in NUMBERS or (fields and len(shape) == 1 and not matlab)):
            return
        why = refusal_reason(dataset) or _shape_refusal(shape)
        if why is not None:
            self.passed[name] = why
        elif fields:
            names = tuple(f"{name}.{field}" for field in fields)
            self.signals.append(DatasetColumns(dataset.name, names, shape[0], fields))
        elif not shape or (math.prod(shape) == 1 and (matlab or len(shape) > 1)):
            self.scalars[name] = float(np.asarray(dataset[()]).item())
        else:
            self.signals.append(_dataset_columns(dataset, name, matlab))

    def table(self, file: Member, name: str, first: int, last: int) -> Table:
        """Return rows of all columns that are so long."""
        columns: dict[str, FloatArray] = {}
        units: dict[str, str] = {}
        for signal in self.signals:
            if signal.rows > first:
                columns.update(zip(signal.names, signal.values(file, first, min(last, signal.rows)), strict=True))
            if signal.unit is not None:
                units.update(dict.fromkeys(signal.names, signal.unit))
        return Table(columns, self.scalars, name, units, self.passed)


Scan: TypeAlias = Callable[[Member], Contents]
"""Function that lists the contents of an open file under the names of its format."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Neighbouring rows of an open file; a `Block`."""

    path: Path
    file: Member
    contents: Contents
    first: int
    rows: int

    def table(self, rows: int | None = None) -> Table:
        """Read all, or the first so many."""
        count = self.rows if rows is None else min(rows, self.rows)
        with explain_damage(self.path, self.contents.format, REMEDY):
            return self.contents.table(self.file, self.path.name, self.first, self.first + count)


def read(path: Path, scan: Scan, name: str) -> Table:
    """Read every column of a file.

    Args:
        path: the file.
        scan: how its columns are found and called.
        name: of its format.

    Raises:
        RecordError: the file is damaged, holds no numbers, or more than are read at once.
    """
    with _open(path, name) as file, explain_damage(path, name, REMEDY):
        contents = _require_numbers(path, scan(file))
        contents.signals = _read_units(path, contents.signals)
        require_size(path, contents.numbers)
        return contents.table(file, path.name, 0, contents.rows)


def blocks(path: Path, rows: int, scan: Scan, name: str) -> Iterator[Rows]:
    """Yield so many rows of a file after so many."""
    with _open(path, name) as file:
        with explain_damage(path, name, REMEDY):
            contents = _require_numbers(path, scan(file))
            contents.signals = _read_units(path, contents.signals)
            contents.format = name
        require_size(path, contents.numbers, PIECES)
        for first in range(0, contents.rows, rows):
            yield Rows(path, file, contents, first, min(rows, contents.rows - first))


@contextmanager
def _open(path: Path, name: str) -> Iterator[Member]:
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    path.open("rb").close()  # what cannot be opened is said by the system, not by the library
    with explain_damage(path, name, REMEDY):
        file = h5py.File(path, "r")
    try:
        yield file
    finally:
        file.close()


def _require_numbers(path: Path, contents: Contents) -> Contents:
    """Return the contents; raise if there are none, or two columns have one name."""
    if not (contents.signals or contents.scalars):
        passed = "; ".join(f"{name!r}: {why}" for name, why in list(contents.passed.items())[:3])
        said = f" ({passed})" if passed else ""
        raise RecordError(f"{path.name} holds no numbers{said}; expected datasets of one or two dimensions.")
    require_unique_names(path, [name for signal in contents.signals for name in signal.names])
    return contents


def list_members(group: Member, contents: Contents, path: str, seen: list[int]) -> Iterator[tuple[str, Member]]:
    """Yield the name and the object of every member that is in the file itself; others are noted as passed over.

    Args:
        group: whose members they are.
        contents: where they are noted.
        path: of the group, for the notes, with the mark that ends it.
        seen: how many members there were so far.
    """
    h5py = extra("h5py", "logs", "HDF5")
    for name in group:
        count_member(group, seen)
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.HardLink):
            yield name, group[name]
        else:
            other = "another file" if isinstance(link, h5py.ExternalLink) else "another place"
            contents.passed[f"{path}{name}"] = f"a link to {other}, which is not followed"


def count_member(member: Member, seen: list[int]) -> None:
    """Count a dataset or group, or a reference to one; raise a `RecordError` at more than any log has."""
    seen[0] += 1
    if seen[0] > _MEMBERS:
        raise RecordError(
            f"{Path(member.file.filename).name} has more than {_MEMBERS} datasets and groups; log fewer channels."
        )


def refusal_reason(dataset: Member) -> str | None:
    """Return the reason to refuse a dataset: its numbers are in other files, or its chunks are too large; or None."""
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


def _shape_refusal(shape: tuple[int, ...]) -> str | None:
    """Return the reason why an array of this shape gives no columns, or None."""
    if 0 in shape:
        return "it is empty"
    if len(shape) > 2:
        return f"it has {len(shape)} dimensions"
    if len(shape) == 2 and min(shape) > _WIDEST:
        return f"it is a matrix of {shape[0]} x {shape[1]}"
    return None


def _dataset_columns(dataset: Member, name: str, matlab: bool) -> DatasetColumns:
    """Return the columns of a vector or a matrix."""
    shape = dataset.shape
    unit, unit_at = _unit(dataset)
    signal = DatasetColumns(dataset.name, (name,), shape[0], unit=unit, unit_at=unit_at)
    if len(shape) == 1:
        return signal
    # Of a square matrix the samples are its rows, which MATLAB stores as columns.
    turned = shape[1] > shape[0] or (matlab and shape[1] == shape[0])
    rows, width = (shape[1], shape[0]) if turned else shape
    names = (name,) if width == 1 else tuple(f"{name}[{index}]" for index in range(width))
    return signal._replace(names=names, rows=rows, turned=turned)


def _unit(dataset: Member) -> tuple[str | None, str]:
    """Return the unit that a dataset states, or the name of the attribute if its text has no fixed length."""
    for key in _UNITS:
        if key not in dataset.attrs or math.prod(dataset.attrs.get_id(key).shape or ()) != 1:
            continue
        kind = dataset.attrs.get_id(key).dtype
        if kind.kind == "O":
            return None, key
        if kind.kind == "S":
            text = np.asarray(dataset.attrs[key]).ravel()[0].decode("utf-8", "replace").strip()
            return text or None, ""
    return None, ""


def _read_units(path: Path, signals: list[DatasetColumns]) -> list[DatasetColumns]:
    """Return the signals with their units; texts of no fixed length are read by another process.

    Where such a text is stored, a damaged file can keep the library going round in a circle.
    """
    asked = [(signal.place, signal.unit_at) for signal in signals if signal.unit_at]
    if not asked:
        return signals
    texts = iter(json.loads(b"".join(read_parts("hdf5_texts", path, json.dumps(asked)))))
    return [signal._replace(unit=next(texts) or None) if signal.unit_at else signal for signal in signals]
