"""NumPy archives (.npz): arrays by name, never objects."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats.arrays import find_columns, to_numbers
from jointid.records.formats.npy import HEADER
from jointid.records.formats.table import (
    WIDEST,
    Table,
    describe_skips,
    require_size,
    require_unique_names,
)

_SUFFIX = ".npy"


@dataclass(frozen=True, slots=True)
class Npz:
    """NumPy's .npz: vectors are columns, single numbers scalars, by the names of their arrays.

    A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side. A record array gives
    "name.field". Text, objects and complex numbers are passed over.
    """

    name: ClassVar[str] = "NPZ"
    suffixes: ClassVar[tuple[str, ...]] = (".npz",)

    def read(self, path: Path) -> Table:
        """Read every array; see `Format.read`."""
        columns, scalars, passed = dict[str, FloatArray](), dict[str, float](), dict[str, str]()
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            require_unique_names(path, [member.filename for member in members])
            require_size(path, sum(member.file_size for member in members) // 8)
            if len(members) > WIDEST:
                raise RecordError(f"{path.name} has {len(members)} arrays (at most {WIDEST} are read); log fewer.")
            for member in members:
                name = member.filename.removesuffix(_SUFFIX)
                array = _read_array(archive, member) if name != member.filename else "it is no array"
                if isinstance(array, str):
                    passed[name] = array
                elif array.size == 1 and not array.dtype.names and array.dtype.kind in "fiub":
                    scalars[name] = float(to_numbers(array).item())
                else:
                    find_columns(name, array, columns, passed)
        require_size(path, sum(values.size for values in columns.values()))
        if not (columns or scalars):
            raise RecordError(f"{path.name} holds no numbers{describe_skips(passed)}; save the signals as arrays.")
        return Table(columns, scalars, path.name, passed=passed)


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, Any] | str:
    """Return an array, or why it is none."""
    try:
        with archive.open(member) as file:
            array: np.ndarray[Any, Any] = np.lib.format.read_array(file, allow_pickle=False, max_header_size=HEADER)
    except ValueError:
        return "it holds objects, or less than it declares"
    return array
