"""HDF5 files: every dataset of numbers is a column, called by its path."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from jointid.common.errors import RecordError, extra
from jointid.records.formats import h5
from jointid.records.formats.table import Holds, Table

_CHUNK = 16384  # numbers that are compressed together


@dataclass(frozen=True, slots=True)
class Hdf5:
    """HDF5: a dataset of one dimension is a column, called "group/dataset"; single numbers are scalars.

    A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side. A dataset of records
    gives "name.field". The attribute "units" or "unit" of a dataset is the unit of its columns. Links are not followed,
    nor what is stored in other files; text, complex numbers and arrays of more dimensions are passed over.
    """

    name: ClassVar[str] = "HDF5"
    suffixes: ClassVar[tuple[str, ...]] = (".h5", ".hdf5", ".hdf")
    holds: ClassVar[Holds] = Holds.SCALARS | Holds.UNITS | Holds.LENGTHS

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        return h5.read(path, _scan, self.name)

    def blocks(self, path: Path, rows: int) -> Iterator[h5.Rows]:
        """Yield so many rows after so many."""
        return h5.blocks(path, rows, _scan, self.name)

    def write(self, path: Path, table: Table) -> None:
        """Write a compressed dataset with a checksum for each column, its unit as its attribute "units"."""
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
        with h5py.File(path, "w", track_order=True) as file:
            for name, values in table.columns.items():
                dataset = file.create_dataset(
                    name,
                    data=values,
                    chunks=(min(values.size, _CHUNK),),
                    compression="gzip",
                    compression_opts=1,
                    shuffle=True,
                    fletcher32=True,
                )
                if name in table.units:
                    dataset.attrs["units"] = table.units[name]
            for name, value in table.scalars.items():
                file[name] = value

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return a name as a path, which no other goes on from; see `Format.legal_name`."""
        paths = [
            "/".join(part.replace("\0", "_") for part in each.split("/") if part not in ("", ".", "..")) or "_"
            for each in (name, *others)
        ]
        is_group = any(other.startswith(f"{paths[0]}/") for other in paths[1:])
        return f"{paths[0]}/value" if is_group else paths[0]


def _scan(file: h5.Member) -> h5.Contents:
    contents, groups = h5.Contents(), {_address(file)}
    _walk(file, "", contents, groups, [0])
    return contents


def _walk(group: h5.Member, path: str, contents: h5.Contents, groups: set[int], seen: list[int]) -> None:
    """Note what a group holds; one that holds itself is entered once."""
    h5py = extra("h5py", "logs", "Reading HDF5")
    for name, member in h5.list_members(group, contents, path, seen):
        full = f"{path}{name}"
        if isinstance(member, h5py.Dataset):
            contents.take(member, full)
        elif isinstance(member, h5py.Group) and _address(member) not in groups:
            groups.add(_address(member))
            _walk(member, f"{full}/", contents, groups, seen)


def _address(group: h5.Member) -> int:
    h5py = extra("h5py", "logs", "Reading HDF5")
    return int(h5py.h5o.get_info(group.id).addr)
