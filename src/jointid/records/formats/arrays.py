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
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import Table, find_columns, require_room, to_numbers

_HEADER = 2**20  # characters of the header of a NumPy array, for the widest table
_VARIABLE = re.compile(r"(?!end$|for$|global$|if$)[A-Za-z]\w{0,62}", re.ASCII)  # of MATLAB; no word that a log may have
_HDF5, _HEADER_73 = b"\x89HDF\r\n\x1a\n", 512  # the signature, and the bytes of MATLAB's own header before it
# Numbers that are declared and were never written take time to read, and no room in the file. Packed by deflate, a byte
# stands for 1032 at most, and each of these may be a number.
_PACKED_MOST, _ANY_FILE = 10_000, 2**27  # bytes of numbers that a byte of a file, and any file, may declare
_CHUNK = 2**30  # bytes that are decompressed at once; h5py's own are a mebibyte
_MEMBERS = 100_000  # datasets and groups of a file
_UNITS = ("units", "unit", "Units", "Unit", "UNITS")


def read_npy(path: Path, rows: int | None) -> Iterator[Table]:
    """Read a record array, or a matrix whose longer side are the samples; instants count from the first row."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what Python's parser says of a damaged header on the side
        array: np.ndarray[Any, Any] = np.lib.format.open_memmap(path, mode="r", max_header_size=_HEADER)
    passed: dict[str, str] = {}
    views = find_columns("", array, passed)
    total = max((view.size for view in views.values()), default=1)
    require_room(path.name, 0 if rows else total * len(views), len(views))
    for first in range(0, total, rows or total):
        table = Table(source=path.name, passed=passed)
        for name, view in views.items():
            table.add(name, to_numbers(view[first : first + (rows or total)], view[:1]))
        yield table.require_numbers()


def write_npy(path: Path, table: Table) -> None:
    """Write a record array of float64 fields."""
    array = np.empty(table.rows, dtype=[(name, "<f8") for name in table.columns])
    for name, values in table.columns.items():
        array[name] = values
    with path.open("wb") as file:
        # Into a file NumPy writes by C, and does not hear that the disk was full when the last bytes went out.
        np.save(SimpleNamespace(write=file.write), array, allow_pickle=False)


def read_npz(path: Path) -> Table:
    """Read every array; objects, which would be pickles, are passed over."""
    table = Table(source=path.name)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        require_room(path.name, sum(member.file_size for member in members) // 8, len(members))
        for member in members:
            name, array = member.filename.removesuffix(".npy"), None
            with suppress(ValueError), archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False, max_header_size=_HEADER)
            if array is None:
                table.passed[name] = "it is no array, holds objects, or less than it declares"
            else:
                table.take(name, array)
    return table


def read_mat(path: Path) -> Table:
    """Read every variable of real numbers; structures give "structure.field" or "structures[0].field"."""
    with path.open("rb") as raw:
        head = raw.read(_HEADER_73 + len(_HDF5))
    if head.startswith(_HDF5) or head.startswith(_HDF5, _HEADER_73):
        return read_hdf5(path, matlab=True)
    from scipy.io.matlab import MatReadWarning, loadmat

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Duplicate variable name|Unreadable variable")
        warnings.filterwarnings("ignore", 'Duplicate variable name "None"')  # SciPy's name of every object of MATLAB
        try:
            variables = loadmat(path)
        except MatReadWarning as warning:
            raise RecordError(f"{path.name} has two variables of one name; rename one of them.") from warning
    table = Table(source=path.name)
    for name, value in variables.items():
        if not name.startswith("__"):  # as SciPy's own do
            _take_variable(table, name, value)
    return table


def _take_variable(table: Table, path: str, value: Any) -> None:
    if type(value) is not np.ndarray or value.dtype.kind == "O":  # MATLAB's objects are subclasses
        table.passed[path] = "a cell array, a sparse matrix or an object of MATLAB"
    elif value.dtype.names is None:
        table.take(path, value)
    else:
        for index, element in enumerate(value.ravel(order="F")):
            for field in value.dtype.names:
                inner = f"{path}.{field}" if value.size == 1 else f"{path}[{index}].{field}"
                _take_variable(table, inner, element[field])


def write_mat(path: Path, table: Table) -> None:
    """Write columns as n x 1 variables of version 7."""
    refused = ", ".join(f'"{name}"' for name in table.columns if not _VARIABLE.fullmatch(name))
    if refused:
        raise RecordError(
            f"{refused} cannot name a MATLAB variable (a letter, then letters, digits and _, at most 63 in all, no "
            "keyword); rename the columns, or write a .csv file."
        )
    from scipy.io import savemat

    # Compressed variables carry a checksum: a damaged file is noticed, not read as other numbers.
    savemat(path, dict(table.columns), do_compression=True, oned_as="column")


def read_hdf5(path: Path, *, matlab: bool = False) -> Table:
    """Read every dataset of numbers by its path; what another file or place holds is not followed."""
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    table, seen, bearable = Table(source=path.name), 0, _ANY_FILE + _PACKED_MOST * path.stat().st_size

    def visit(name: str, member: Any) -> None:
        nonlocal seen
        seen += 1
        if seen > _MEMBERS:
            raise RecordError(f"{path.name} has more than {_MEMBERS} datasets and groups; log fewer.")
        if not isinstance(member, h5py.Dataset) or (matlab and name.startswith("#")):
            return
        called = name.replace("/", ".") if matlab else name
        if why := _refuse(h5py, member):
            table.passed[called] = why
            return
        numbers = max(member.size * len(member.dtype.names or " "), member.nbytes // 8)
        require_room(path.name, table.numbers + numbers)
        if 8 * numbers > bearable:
            raise RecordError(f"{path.name} declares numbers that were never written; log or copy it again.")
        unit = next((text for key in _UNITS if (text := _text_of(member, key))), "")
        array = np.asarray(member[()])
        table.take(called, array.T if matlab else array, unit)

    with h5py.File(path, "r") as file:
        file.visititems(visit)  # each once, and no link to another place
        return table


def _refuse(h5py: Any, dataset: Any) -> str:
    """Reason to pass over a dataset: no numbers, numbers in another file, or too large chunks."""
    properties, kind = dataset.id.get_create_plist(), _text_of(dataset, "MATLAB_class")
    packed = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
    if dataset.shape is None or dataset.size == 0 or "MATLAB_empty" in dataset.attrs:
        return "it is empty"
    if kind in ("char", "cell") or dataset.dtype.kind == "O":
        return "it holds text, cells, or an array of structures"
    if dataset.dtype.names in (("real", "imag"), ("r", "i")) or "MATLAB_sparse" in dataset.parent.attrs:
        return "it holds complex numbers, or a sparse matrix"
    if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
        return "its numbers are in another file"
    if packed > _CHUNK:
        return f"its chunks are declared as {packed / 2**30:.3g} GiB each"
    return ""


def _text_of(member: Any, key: str) -> str:
    """Return a text that an attribute holds; none of other kinds, which may be of any size."""
    if key not in member.attrs or math.prod(member.attrs.get_id(key).shape or ()) != 1:
        return ""
    if member.attrs.get_id(key).dtype.kind not in "OS":
        return ""
    text = np.asarray(member.attrs[key]).ravel()[0]
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).strip()
