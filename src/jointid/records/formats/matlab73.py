"""MAT files of version 7.3: HDF5 as MATLAB lays it out.

Before the HDF5 stand 512 bytes: a text, the version 0x0200 and "IM". Every variable is a dataset, a structure a group,
with its class in the attribute MATLAB_class; rows and columns are stored the other way round. The fields of an array of
structures, and cells, are references into the group "#refs#". (Layout: as MATLAB's own files have it; the description
that comes with MATLAB says only that it is HDF5.)
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import extra
from jointid.records.formats import h5
from jointid.records.formats.table import Table

HEADER = 512
"""Bytes before the HDF5."""

_NAME = "a MAT file of version 7.3"
_VERSION = 0x0200
_NUMERIC = {"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))}
_ELEMENTS = 10_000  # of an array of structures
_DEEPEST = 64  # structures within structures


def scan(file: h5.Member) -> h5.Contents:
    """List the contents of a file: "name", "structure.field", "structures[0].field"."""
    contents = h5.Contents()
    seen = [0]
    for name, member in h5.list_members(file, contents, "", seen):
        if not name.startswith("#"):
            _note_variable(file, name, member, contents, seen, 0)
    return contents


def _note_variable(
    file: h5.Member, path: str, member: h5.Member, contents: h5.Contents, seen: list[int], deep: int
) -> None:
    """Note a variable, or all that is in a structure."""
    h5py = extra("h5py", "logs", "Reading MAT files of version 7.3")
    kind = _matlab_class(member)
    if isinstance(member, h5py.Group):
        if "MATLAB_sparse" in member.attrs or deep >= _DEEPEST:
            return
        for name, field in h5.list_members(member, contents, f"{path}.", seen):
            if _is_array_of_structures(field):
                _note_elements(file, path, name, field, contents, seen, deep)
            else:
                _note_variable(file, f"{path}.{name}", field, contents, seen, deep + 1)
    elif isinstance(member, h5py.Dataset) and kind in _NUMERIC and "MATLAB_empty" not in member.attrs:
        contents.take(member, path, matlab=True)


def _is_array_of_structures(field: h5.Member) -> bool:
    """True if a field of a structure holds a reference for every element, and is no cell."""
    h5py = extra("h5py", "logs", "Reading MAT files of version 7.3")
    is_references = isinstance(field, h5py.Dataset) and h5py.check_ref_dtype(field.dtype) is h5py.Reference
    return is_references and _matlab_class(field) != "cell"


def _note_elements(
    file: h5.Member, path: str, name: str, field: h5.Member, contents: h5.Contents, seen: list[int], deep: int
) -> None:
    """Note one field of an array of structures."""
    if field.size > _ELEMENTS or h5.refusal_reason(field) is not None or deep >= _DEEPEST:
        contents.passed[f"{path}.{name}"] = f"an array of {field.size} structures"
        return
    for index, reference in enumerate(field[()].ravel(order="C")):
        h5.count_member(field, seen)
        if reference:
            _note_variable(file, f"{path}[{index}].{name}", file[reference], contents, seen, deep + 1)


def _matlab_class(member: h5.Member) -> str:
    """Return the class of a variable, "" without one."""
    key = "MATLAB_class"
    if key not in member.attrs or member.attrs.get_id(key).dtype.kind != "S":  # MATLAB's have a fixed length
        return ""
    return bytes(member.attrs[key]).decode("ascii", "replace")


def write(path: Path, table: Table) -> None:
    """Write columns as n x 1, scalars as 1 x 1 variables of class double."""
    h5py = extra("h5py", "logs", "Writing MAT files of version 7.3")
    variables: Mapping[str, FloatArray | float] = {**table.columns, **table.scalars}
    with h5py.File(path, "w", userblock_size=HEADER) as file:
        for name, values in variables.items():
            matrix = np.asarray(values, dtype=np.float64).reshape(1, -1)  # n x 1, stored the other way round
            packed = (
                {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
                if matrix.size > 1
                else {}
            )
            dataset = file.create_dataset(name, data=matrix, **packed)
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    text = b"MATLAB 7.3 MAT-file, written by jointid, HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(text.ljust(116) + bytes(8) + struct.pack("<H", _VERSION) + b"IM")


def read(path: Path) -> Table:
    """Read every numeric variable; see `Format.read`."""
    return h5.read(path, scan, _NAME)


def blocks(path: Path, rows: int) -> Iterator[h5.Rows]:
    """Yield so many rows after so many."""
    return h5.blocks(path, rows, scan, _NAME)
