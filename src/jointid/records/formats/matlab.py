"""MATLAB's MAT files: versions 4 to 7 by SciPy, and version 7.3, which is HDF5; the first bytes tell which.

Version 7.3 is HDF5 as MATLAB lays it out. Before the HDF5 stand 512 bytes: a text, the version 0x0200 and "IM". Every
variable is a dataset, a structure a group, with its class in the attribute MATLAB_class; rows and columns are stored
the other way round. The fields of an array of structures, and cells, are references into the group "#refs#". (Layout:
as MATLAB's own files have it; the description that comes with MATLAB says only that it is HDF5.)
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.arrays import REAL, find_columns, skip_reason
from jointid.records.formats.hdf5 import SIGNATURE, Contents, Member, open_contents, refusal_reason
from jointid.records.formats.table import (
    Table,
    describe_skips,
    require_unique_names,
)

_VARIABLE = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)
_KEYWORD = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|"
    "return|spmd|switch|try|while"
)

_HEADER_73 = 512  # bytes before the HDF5
_NUMERIC_73 = {"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))}
_CLASSES_73 = {"char": "it holds text", "cell": "a cell array"}
_ELEMENTS = 10_000  # of an array of structures
_DEEPEST = 64  # structures within structures
_OF_SCIPY = ("__header__", "__version__", "__globals__", "__function_workspace__")


@dataclass(frozen=True, slots=True)
class Matlab:
    """MAT files: vectors are columns, 1 x 1 arrays scalars; a structure's field is called "structure.field".

    A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side, and sides of one
    number do not count. What is not a real number (text, cells, objects, complex arrays) is passed over.
    """

    name: ClassVar[str] = "MAT"
    suffixes: ClassVar[tuple[str, ...]] = (".mat",)

    def read(self, path: Path) -> Table:
        """Read every numeric variable of the file; see `Format.read`."""
        if _is_hdf5(path):
            with open_contents(path, _scan) as contents:
                return contents.read()
        columns, scalars, passed = dict[str, FloatArray](), dict[str, float](), dict[str, str]()
        for name, array in _load_arrays(path):
            if isinstance(array, str):
                passed[name] = array
                continue
            found: dict[str, FloatArray] = {}
            if array.size == 1:
                found[name] = array
            else:
                find_columns(name, array, found, passed)
            require_unique_names(path, [*columns, *scalars, *found])
            columns |= found if array.size != 1 else {}
            scalars |= {name: float(array.item())} if array.size == 1 else {}
        if not (columns or scalars):
            raise RecordError(
                f"{path.name} holds no array of real numbers{describe_skips(passed)}; save the signals as numeric "
                "variables."
            )
        return Table(columns, scalars, path.name, passed=passed)

    def write(self, path: Path, table: Table) -> None:
        """Write columns as n x 1, scalars as 1 x 1 variables; a column of one sample is read as a scalar."""
        variables: dict[str, Any] = {**table.columns, **table.scalars}
        refused = [n for n in variables if not _VARIABLE.fullmatch(n) or _KEYWORD.fullmatch(n)]
        if refused:
            raise RecordError(
                f"{_quote(refused)} cannot name a MATLAB variable (a letter, then letters, digits and _, at "
                "most 63 in all, no keyword); rename the columns, or write a .csv file."
            )
        twice = [n for n in table.scalars if n in table.columns]
        if twice:
            raise RecordError(f"{_quote(twice)} names a column and a scalar; a MAT file holds one variable per name.")
        from scipy.io import savemat

        # Compressed variables carry a checksum: a damaged file is noticed, not read as other numbers.
        savemat(path, variables, do_compression=True, oned_as="column")


def _is_hdf5(path: Path) -> bool:
    """True if a file is of version 7.3."""
    with path.open("rb") as file:
        head = file.read(_HEADER_73 + len(SIGNATURE))
    return any(head.startswith(SIGNATURE, offset) for offset in (0, _HEADER_73))


def _quote(names: list[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _load_arrays(path: Path) -> list[tuple[str, FloatArray | str]]:
    """Return the path and the values of every array of real numbers, and of others why they are passed over."""
    from scipy.io.matlab import MatReadWarning, loadmat

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Duplicate variable name|Unreadable variable")
        warnings.filterwarnings("ignore", 'Duplicate variable name "None"')  # SciPy's name of every object of MATLAB
        try:
            variables = loadmat(path)
        except MatReadWarning as warning:
            raise RecordError(f"{path.name} has two variables of one name; rename one of them.") from warning
    named = ((name, value) for name, value in variables.items() if name not in _OF_SCIPY)
    return [pair for name, value in named for pair in _find_arrays(name, value)]


def _find_arrays(path: str, value: Any) -> Iterator[tuple[str, FloatArray | str]]:
    """Yield the arrays in a variable: "name", "structure.field" or "structures[0].field".

    Of text, cells, objects, and complex, sparse and empty arrays the reason to pass them over is yielded.
    """
    if type(value) is not np.ndarray:  # MATLAB's objects are subclasses
        yield path, "a sparse matrix" if hasattr(value, "tocsr") else "an object of MATLAB"
    elif value.dtype.names is not None:
        elements = value.ravel(order="F")
        for index, element in enumerate(elements):
            prefix = path if elements.size == 1 else f"{path}[{index}]"
            for field in value.dtype.names:
                yield from _find_arrays(f"{prefix}.{field}", element[field])
    elif value.dtype.kind not in REAL:
        yield path, "a cell array" if value.dtype.kind == "O" else skip_reason(value.dtype) or "it holds no numbers"
    else:
        yield path, value.astype(np.float64) if value.size else "it is empty"


def _scan(contents: Contents) -> None:
    """List a file of version 7.3: "name", "structure.field", "structures[0].field"."""
    for name, member in contents.members(contents.file, ""):
        if not name.startswith("#"):
            _note_variable(contents, name, member, 0)


def _note_variable(contents: Contents, path: str, member: Member, deep: int) -> None:
    h5py = extra("h5py", "logs", "Reading MAT files of version 7.3")
    if isinstance(member, h5py.Dataset):
        kind = _matlab_class(member)
        if "MATLAB_empty" in member.attrs:
            contents.passed[path] = "it is empty"
        elif kind in _NUMERIC_73:
            contents.take(member, path, matlab=True)
        else:
            contents.passed[path] = _CLASSES_73.get(kind, "an object of MATLAB")
        return
    if not isinstance(member, h5py.Group) or "MATLAB_sparse" in member.attrs or deep >= _DEEPEST:
        contents.passed[path] = "a structure that is too deep" if deep >= _DEEPEST else "a sparse matrix"
        return
    for name, field in contents.members(member, f"{path}."):
        is_references = isinstance(field, h5py.Dataset) and h5py.check_ref_dtype(field.dtype) is h5py.Reference
        if is_references and _matlab_class(field) != "cell":
            _note_elements(contents, path, name, field, deep)
        else:
            _note_variable(contents, f"{path}.{name}", field, deep + 1)


def _note_elements(contents: Contents, path: str, name: str, field: Member, deep: int) -> None:
    """Note one field of an array of structures: a reference for every element."""
    if field.size > _ELEMENTS or refusal_reason(field) is not None or deep >= _DEEPEST:
        contents.passed[f"{path}.{name}"] = f"an array of {field.size} structures"
        return
    for index, reference in enumerate(field[()].ravel(order="C")):
        contents.count_member()
        if reference:
            _note_variable(contents, f"{path}[{index}].{name}", contents.file[reference], deep + 1)


def _matlab_class(member: Member) -> str:
    key = "MATLAB_class"
    if key not in member.attrs or member.attrs.get_id(key).dtype.kind != "S":  # MATLAB's have a fixed length
        return ""
    return bytes(member.attrs[key]).decode("ascii", "replace")
