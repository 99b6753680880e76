"""Files of arrays: NumPy's NPY and NPZ, MATLAB's MAT of every version, and HDF5.

MAT of version 7.3 is HDF5 as MATLAB lays it out: every variable is a dataset, a structure a group, with its class in
the attribute MATLAB_class; rows and columns are stored the other way round. The fields of an array of structures, and
cells, are references into the group "#refs#". (Layout: as MATLAB's own files have it.)
"""

from __future__ import annotations

import math
import re
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np

from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import (
    Found,
    Table,
    find_columns,
    require_columns,
    require_size,
    require_width,
    to_numbers,
)

_HEADER = 2**16  # characters of the header of a NumPy array, for more than a thousand columns
_REST = 2**8  # characters of it beside the names of the columns
_VARIABLE = re.compile(
    r"(?!(?:break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|"
    r"return|spmd|switch|try|while)$)[A-Za-z]\w{0,62}",
    re.ASCII,
)
_OF_SCIPY = ("__header__", "__version__", "__globals__", "__function_workspace__")
_HDF5, _HEADER_73 = b"\x89HDF\r\n\x1a\n", 512  # the signature, and the bytes of MATLAB's own header before it
_CHUNK = 2**30  # bytes that are decompressed at once; h5py's own are a mebibyte
# Numbers that are declared and were never written take time to read, and no room in the file. Packed by deflate, a byte
# stands for 1032 at most, and each of these may be a number.
_PACKED_MOST, _ANY_FILE = 10_000, 2**27  # bytes of numbers that a byte of a file, and any file, may declare
_MEMBERS, _ELEMENTS = 100_000, 10_000  # datasets and groups of a file, elements of an array of structures
_DEEPEST = 64  # structures within structures
_UNITS = ("units", "unit", "Units", "Unit", "UNITS")
_NO_NUMBERS = {"char": "it holds text", "cell": "a cell array"}  # by MATLAB's classes

Member: TypeAlias = Any
"""A group or a dataset of h5py, which has no types."""


def read_npy(path: Path) -> Table:
    """Read a record array, or a matrix whose longer side are the samples."""
    views, passed = _map_columns(path)
    require_size(path, sum(view.size for view in views.values()))
    return _read_rows(path, views, passed, 0, max(view.size for view in views.values()))


def read_npy_blocks(path: Path, rows: int) -> Iterator[Table]:
    """Yield so many rows after so many; instants count from that of the file's first row."""
    views, passed = _map_columns(path)
    total = max(view.size for view in views.values())
    for first in range(0, total, rows):
        yield _read_rows(path, views, passed, first, rows)


def _map_columns(path: Path) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what Python's parser says of a damaged header on the side
        array: np.ndarray[Any, Any] = np.lib.format.open_memmap(path, mode="r", max_header_size=_HEADER)
    passed: dict[str, str] = {}
    views = find_columns("", array, passed)
    if not views:
        raise RecordError(
            f"{path.name} holds {array.dtype} of shape {array.shape}; expected a record array of numbers, or a matrix "
            "of numbers whose longer side are the samples."
        )
    require_width(path, len(views))
    return views, passed


def _read_rows(
    path: Path, views: dict[str, np.ndarray[Any, Any]], passed: dict[str, str], first: int, count: int
) -> Table:
    found = Found(path, passed=passed)
    for name, view in views.items():
        found.add(name, to_numbers(view[first : first + count], view[:1]))
    return found.table()


def write_npy(path: Path, table: Table) -> None:
    """Write a record array of float64 fields."""
    require_columns(table, "NPY")
    array = np.empty(table.rows, dtype=[(name, "<f8") for name in table.columns])
    if (size := len(repr(array.dtype.descr))) > _HEADER - _REST:
        raise RecordError(
            f"The names of {len(table.columns)} columns take {size} characters, and at most {_HEADER - _REST} are read "
            "from a .npy file; choose columns, or write a .parquet file."
        )
    for name, values in table.columns.items():
        array[name] = values
    with path.open("wb") as file:
        # Into a file NumPy writes by C, and does not hear that the disk was full when the last bytes went out.
        np.save(SimpleNamespace(write=file.write), array, allow_pickle=False)


def read_npz(path: Path) -> Table:
    """Read every array; objects, which would be pickles, are passed over."""
    found = Found(path)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        require_width(path, len(members))
        require_size(path, sum(member.file_size for member in members) // 8)
        for member in members:
            name = member.filename.removesuffix(".npy")
            try:
                with archive.open(member) as file:
                    array = np.lib.format.read_array(file, allow_pickle=False, max_header_size=_HEADER)
            except ValueError:
                found.passed[name] = "it is no array, holds objects, or less than it declares"
            else:
                found.take(name, array)
    return found.table()


def read_mat(path: Path) -> Table:
    """Read every variable of real numbers; structures give "structure.field" or "structures[0].field"."""
    with path.open("rb") as raw:
        head = raw.read(_HEADER_73 + len(_HDF5))
    if head.startswith(_HDF5) or head.startswith(_HDF5, _HEADER_73):
        return _read_contents(path, matlab=True)
    from scipy.io.matlab import MatReadWarning, loadmat

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Duplicate variable name|Unreadable variable")
        warnings.filterwarnings("ignore", 'Duplicate variable name "None"')  # SciPy's name of every object of MATLAB
        try:
            variables = loadmat(path)
        except MatReadWarning as warning:
            raise RecordError(f"{path.name} has two variables of one name; rename one of them.") from warning
    found = Found(path)
    for name, value in variables.items():
        if name not in _OF_SCIPY:
            _take_variable(found, name, value)
    return found.table()


def _take_variable(found: Found, path: str, value: Any) -> None:
    if type(value) is not np.ndarray:  # MATLAB's objects are subclasses
        found.passed[path] = "a sparse matrix" if hasattr(value, "tocsr") else "an object of MATLAB"
    elif value.dtype.names is not None:
        for index, element in enumerate(value.ravel(order="F")):
            for field in value.dtype.names:
                _take_variable(
                    found, f"{path}.{field}" if value.size == 1 else f"{path}[{index}].{field}", element[field]
                )
    elif value.dtype.kind == "O":
        found.passed[path] = "a cell array"
    else:
        found.take(path, value)


def write_mat(path: Path, table: Table) -> None:
    """Write columns as n x 1 variables of version 7; a column of one sample is read as a scalar."""
    refused = ", ".join(f'"{name}"' for name in table.columns if not _VARIABLE.fullmatch(name))
    if refused:
        raise RecordError(
            f"{refused} cannot name a MATLAB variable (a letter, then letters, digits and _, at most 63 in all, no "
            "keyword); rename the columns, or write a .csv file."
        )
    from scipy.io import savemat

    # Compressed variables carry a checksum: a damaged file is noticed, not read as other numbers.
    savemat(path, dict(table.columns), do_compression=True, oned_as="column")


def read_hdf5(path: Path) -> Table:
    """Read every dataset of numbers by its path; what another file or place holds is not followed."""
    return _read_contents(path, matlab=False)


def _read_contents(path: Path, *, matlab: bool) -> Table:
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    with h5py.File(path, "r") as file:
        found = Found(path)
        _Walk(h5py, found, matlab).enter("", file, 0)
        return found.table()


class _Walk:
    """A walk through the groups of a file, each entered once."""

    def __init__(self, h5py: Any, found: Found, matlab: bool) -> None:
        self.h5py, self.found, self.matlab = h5py, found, matlab
        self.entered: set[Any] = set()
        self.seen = 0

    def enter(self, path: str, group: Member, deep: int) -> None:
        """Take the members of a group."""
        address = self.h5py.h5o.get_info(group.id).addr
        if address in self.entered or deep > _DEEPEST:
            return
        self.entered.add(address)
        mark = "." if self.matlab else "/"
        for name in group:
            below = f"{path}{mark}{name}" if path else name
            if not isinstance(group.get(name, getlink=True), self.h5py.HardLink):
                self.found.passed[below] = "a link to another file or place, which is not followed"
            elif not (self.matlab and name.startswith("#")):
                self.visit(path, name, group[name], deep)

    def visit(self, above: str, name: str, member: Member, deep: int) -> None:
        """Take a dataset, the members of a group, or what an array of structures refers to."""
        self.seen += 1
        if self.seen > _MEMBERS:
            raise RecordError(f"{self.found.path.name} has more than {_MEMBERS} datasets and groups; log fewer.")
        path = f"{above}{'.' if self.matlab else '/'}{name}" if above else name
        kind = _text_of(member, "MATLAB_class") if self.matlab else ""
        if isinstance(member, self.h5py.Group):
            if "MATLAB_sparse" in member.attrs:
                self.found.passed[path] = "a sparse matrix"
            else:
                self.enter(path, member, deep + 1)
        elif not isinstance(member, self.h5py.Dataset):
            return
        elif self.matlab and kind != "cell" and self.h5py.check_ref_dtype(member.dtype) is self.h5py.Reference:
            if member.size > _ELEMENTS or self._refuse(member) or deep > _DEEPEST:
                self.found.passed[path] = f"an array of {member.size} structures"
                return
            for index, reference in enumerate(member[()].ravel()):
                if reference:
                    self.visit(f"{above}[{index}]", name, member.file[reference], deep + 1)
        elif why := _NO_NUMBERS.get(kind) or (
            "it is empty" if "MATLAB_empty" in member.attrs else self._refuse(member)
        ):
            self.found.passed[path] = why
        else:
            self.take(path, member)

    def take(self, path: str, dataset: Member) -> None:
        """Read a dataset whose declared size is bearable."""
        path_of_file, numbers = self.found.path, dataset.size * len(dataset.dtype.names or " ")
        require_size(path_of_file, self.found.numbers + numbers)
        if 8 * numbers > _ANY_FILE + _PACKED_MOST * path_of_file.stat().st_size:
            raise RecordError(f"{path_of_file.name} declares numbers that were never written; log or copy it again.")
        unit = next((text for key in _UNITS if (text := _text_of(dataset, key))), "")
        array = dataset[()]
        if self.matlab and array.size > 1:
            for name, view in find_columns(path, array, self.found.passed, square_turned=True).items():
                self.found.add(name, to_numbers(view), unit)
        else:
            self.found.take(path, np.asarray(array), unit)

    def _refuse(self, dataset: Member) -> str:
        """Reason to pass over a dataset: no numbers, numbers in another file, or too large chunks."""
        h5py, properties = self.h5py, dataset.id.get_create_plist()
        if dataset.shape is None or dataset.size == 0:
            return "it is empty"
        if h5py.check_string_dtype(dataset.dtype) is not None:
            return "it holds text"
        if dataset.dtype.kind == "c" or dataset.dtype.names in (("real", "imag"), ("r", "i")):
            return "it holds complex numbers"
        if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
            return "its numbers are in another file"
        packed = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
        return f"its chunks are declared as {packed / 2**30:.3g} GiB each" if packed > _CHUNK else ""


def _text_of(member: Member, key: str) -> str:
    """Return a text that an attribute holds; none of other kinds, which may be of any size."""
    if key not in member.attrs or math.prod(member.attrs.get_id(key).shape or ()) != 1:
        return ""
    if member.attrs.get_id(key).dtype.kind not in "OS":
        return ""
    text = np.asarray(member.attrs[key]).ravel()[0]
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).strip()
