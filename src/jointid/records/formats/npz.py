"""NumPy archives (.npz): arrays by name, never objects. Each is unpacked only if it is as large as it declares."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats.arrays import find_columns, to_numbers
from jointid.records.formats.npy import HEADER_ERRORS, read_header
from jointid.records.formats.table import (
    WIDEST,
    Table,
    describe_skips,
    format_size,
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
                array = _read_array(path, archive, member) if name != member.filename else "it is no array"
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


def _read_array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, Any] | str:
    """Return an array, or why it is none; what it declares is checked before it is unpacked."""
    with archive.open(member) as file:
        try:
            shape, by_column, dtype = read_header(file)
        except HEADER_ERRORS:
            return "its header is no array's"
        if dtype.hasobject:
            return "it holds objects"
        if not all(type(size) is int and size >= 0 for size in shape):
            return "its header is no array's"
        require_size(path, math.prod(shape))
        size = math.prod(shape) * dtype.itemsize
        if size > member.file_size:
            return f"it declares {format_size(size)} and holds {format_size(member.file_size)}"
        content = file.read(size)
    array = np.frombuffer(content, dtype=dtype) if size else np.empty(0, dtype=dtype)
    return array.reshape(shape, order="F" if by_column else "C")
