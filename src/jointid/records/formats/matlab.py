"""MATLAB's MAT files: versions 4 to 7, and version 7.3, which is HDF5 within; the first bytes tell which.

Of versions 4 to 7 the matrices of real numbers are found here, without trusting any length in the file. SciPy reads
these files too. Of 300 plain files with one to four bytes changed it (version 1.17) ended the process over 12 and made
numbers of 58 that are refused here; and in a process of its own it takes 0.3 s for a file that takes 10 ms here. The
layouts are those of "MAT-File Format" (The MathWorks). Version 4 is a list of headers with their numbers. From version
5 on, a file is a list of elements, each a tag (type, length) and its data; an array is an element whose data are
elements.

Version 7.3 is HDF5 as MATLAB lays it out. Before the HDF5 stand 512 bytes: a text, the version 0x0200 and "IM". Every
variable is a dataset, a structure a group, with its class in the attribute MATLAB_class; rows and columns are stored
the other way round. The fields of an array of structures, and cells, are references into the group "#refs#". (Layout:
as MATLAB's own files have it; the description that comes with MATLAB says only that it is HDF5.)
"""

from __future__ import annotations

import io
import math
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.hdf5 import PACKING, SIGNATURE, Contents, Member, open_contents, refusal_reason
from jointid.records.formats.table import (
    PIECES,
    Block,
    Holds,
    NotStreamedError,
    Table,
    explain_damage,
    require_size,
    require_unique_names,
    split_rows,
)

_VARIABLE = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)
_LONGEST_NAME = 63
_KEYWORD = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|"
    "return|spmd|switch|try|while"
)

_HEADER = 128  # bytes, of versions 5 to 7
_MARKS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version and byte order, at the end of the header
_TAG = 8  # bytes that begin an element
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE, _NUMERIC = 2, range(6, 16)  # classes of arrays
_COMPLEX = 0x800
_NUMBERS_4 = ("f8", "f4", "i4", "i2", "u2", "u1")

_NAME_73 = "a MAT file of version 7.3"
_HEADER_73 = 512  # bytes before the HDF5
_VERSION_73 = 0x0200
_NUMERIC_73 = {"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))}
_ELEMENTS = 10_000  # of an array of structures
_DEEPEST = 64  # structures within structures


@dataclass(frozen=True, slots=True)
class Matlab:
    """MAT files: vectors are columns, 1 x 1 arrays scalars; a structure's field is called "structure.field".

    A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side. What is not a
    real number (text, cells, objects, complex arrays) is passed over.

    Attributes:
        version: of what is written, "7" or "7.3"; a file is read whichever it has.

    Raises:
        RecordError: there is no such version.
    """

    version: Literal["7", "7.3"] = "7"

    name: ClassVar[str] = "MAT"
    suffixes: ClassVar[tuple[str, ...]] = (".mat",)
    holds: ClassVar[Holds] = Holds.SCALARS | Holds.LENGTHS

    def __post_init__(self) -> None:
        if self.version not in ("7", "7.3"):
            raise RecordError(f'A MAT file is written in version "7" or "7.3"; got {self.version!r}.')

    def read(self, path: Path) -> Table:
        """Read every numeric variable of the file; see `Format.read`."""
        if _is_hdf5(path):
            with open_contents(path, _NAME_73, _scan) as contents:
                return contents.read(0, contents.rows)
        raw = path.read_bytes()
        with explain_damage(path, "a MAT file", "save it again with -v7 in MATLAB"):
            found = list(_find_arrays(path, raw))
        scalars = {name: float(array.item()) for name, array in found if array.size == 1}
        pairs = [column for name, array in found if array.size > 1 for column in _split_columns(name, array)]
        require_unique_names(path, [name for name, _ in pairs] + [name for name, array in found if array.size == 1])
        columns = dict(pairs)
        if not (columns or scalars):
            raise RecordError(f"{path.name} holds no array of real numbers; save the signals as numeric variables.")
        return Table(columns, scalars, path.name)

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
        if self.version == "7.3":
            _write_73(path, variables)
            return
        from scipy.io import savemat

        # Compressed variables carry a checksum: a damaged file is noticed, not read as other numbers.
        savemat(path, variables, do_compression=True, oned_as="column")

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many, of version 7.3."""
        if not _is_hdf5(path):
            raise NotStreamedError(
                f"{path.name} is a MAT file of version 7 or older, which cannot be read in chunks; save it with -v7.3 "
                "in MATLAB, or convert it."
            )
        with open_contents(path, _NAME_73, _scan, PIECES) as contents:
            yield from split_rows(contents.rows, rows, contents.read)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return a name as that of a variable; see `Format.legal_name`."""
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "column"
        plain = plain if plain[0].isalpha() and not _KEYWORD.fullmatch(plain) else f"x{plain}"
        return name if _VARIABLE.fullmatch(name) and not _KEYWORD.fullmatch(name) else plain[:_LONGEST_NAME]


def _is_hdf5(path: Path) -> bool:
    """True if a file is of version 7.3."""
    with path.open("rb") as file:
        head = file.read(_HEADER_73 + len(SIGNATURE))
    return any(head.startswith(SIGNATURE, offset) for offset in (0, _HEADER_73))


def _split_columns(name: str, array: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield a vector as one column, a matrix as one column per signal."""
    if 1 in array.shape:
        yield name, array.ravel()
        return
    samples_first = array if array.shape[0] >= array.shape[1] else array.T
    for index, column in enumerate(samples_first.T):
        yield f"{name}[{index}]", column


def _quote(names: list[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _find_arrays(path: Path, raw: bytes) -> Iterator[tuple[str, FloatArray]]:
    """Yield the path and the values, shape (rows, columns), of every matrix of real numbers.

    A path is "name", "structure.field" or "structures[0].field". Text, cells, objects, complex, sparse and empty
    arrays are passed over, and those of more than two dimensions.

    Raises:
        ValueError: these are not the bytes of a MAT file, or they are damaged.
    """
    order = _MARKS.get(raw[_HEADER - 4 : _HEADER])
    if order is None:
        yield from _read_version_4(raw)
        return
    for element in _split_elements(memoryview(raw)[_HEADER:], order):
        array = _decompress(path, element, order) if element.type == _COMPRESSED else element
        if array.type == _MATRIX:
            yield from _read_matrix(array.data, order)


def _read_version_4(raw: bytes) -> Iterator[tuple[str, FloatArray]]:
    """Yield the matrices of a file of version 4; its type is machine, 0, precision and kind in decimal digits."""
    order, at = ("<", 0) if int.from_bytes(raw[:4], "little") < 1000 else (">", 0)
    while at < len(raw):
        if len(raw) - at < 20:
            raise ValueError("a header is cut off")
        digits, rows, columns, is_complex, length = struct.unpack_from(order + "5i", raw, at)
        precision, kind = divmod(digits % 1000, 10)
        if digits // 1000 != (order == ">") or precision >= len(_NUMBERS_4) or min(rows, columns, length) < 0:
            raise ValueError("no header of a matrix stands where one is expected")
        number = np.dtype(order + _NUMBERS_4[precision])
        start, count = at + 20 + length, rows * columns
        at = start + count * number.itemsize * (2 if is_complex else 1)
        if at > len(raw):
            raise ValueError("a matrix is longer than the file")
        if kind == 0 and count and not is_complex:
            name = raw[start - length : start].split(b"\0")[0].decode("latin-1")
            values = np.frombuffer(raw, number, count, start).astype(np.float64)
            yield name, values.reshape((rows, columns), order="F")


class _Element(NamedTuple):
    type: int
    data: memoryview


def _decompress(path: Path, element: _Element, order: str) -> _Element:
    """Return the one element in a compressed one, unpacked as far as it says that it goes."""
    try:
        head = zlib.decompressobj().decompress(element.data, _TAG)
        _, size = struct.unpack(order + "II", head)
        require_size(path, size // 8)
        unpacking = zlib.decompressobj()
        data = unpacking.decompress(element.data, _TAG + size + _TAG)
    except zlib.error as error:
        raise ValueError("a compressed element is damaged") from error
    if not unpacking.eof:
        raise ValueError("a compressed element is longer than it says, or cut off")
    (inner,) = _split_elements(memoryview(data), order)
    return inner


def _split_elements(data: memoryview, order: str) -> Iterator[_Element]:
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError("the tag of an element is cut off")
        kind, size = struct.unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # data of up to four bytes stand in the tag itself
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
        end = start + size
        if end > len(data) or (start == at + 4 and size > 4):
            raise ValueError("an element is longer than what holds it")
        yield _Element(kind, data[start:end])
        at = end if kind == _COMPRESSED else end + (at - end) % 8


def _read_matrix(data: memoryview, order: str, path: str | None = None) -> Iterator[tuple[str, FloatArray]]:
    """Yield the matrices of real numbers in an array; without a `path` it goes by its own name."""
    if not data:
        return
    flags, *parts = _split_elements(data, order)
    bits, *_ = map(int, _decode_numbers(flags, order))
    is_structure = bits & 0xFF == _STRUCTURE
    if not is_structure and (bits & 0xFF not in _NUMERIC or bits & _COMPLEX):
        return
    dimensions, name, *content = parts
    shape = [int(length) for length in _decode_numbers(dimensions, order)]
    path = bytes(name.data).decode("latin-1") if path is None else path
    if not path:  # only MATLAB's own workspace of functions has no name
        return
    if is_structure:
        yield from _read_structure(content, order, path, math.prod(shape))
        return
    values = _decode_numbers(content[0], order).astype(np.float64, copy=False) if content else np.empty(0)
    if values.size != math.prod(shape) or min(shape) < 0:
        raise ValueError(f"{path} has {values.size} values in a shape of {shape}")
    if values.size and len(shape) == 2:
        yield path, values.reshape(shape, order="F")


def _read_structure(content: list[_Element], order: str, path: str, count: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield the matrices of real numbers in the fields of `count` structures."""
    width, names, *values = content
    length, *_ = map(int, _decode_numbers(width, order))
    joined = bytes(names.data)
    starts = range(0, len(joined), length)
    keys = [joined[at : at + length].split(b"\0")[0].decode("latin-1") for at in starts]
    if len(values) != count * len(keys) or any(value.type != _MATRIX for value in values):
        raise ValueError(f"{path} has {len(values)} values for {count} structures of {len(keys)} fields")
    for index in range(count if keys else 0):
        prefix = path if count == 1 else f"{path}[{index}]"
        for key, value in zip(keys, values[index * len(keys) :], strict=False):
            yield from _read_matrix(value.data, order, f"{prefix}.{key}")


def _decode_numbers(element: _Element, order: str) -> np.ndarray[tuple[int], np.dtype[Any]]:
    if element.type not in _NUMBERS:
        raise ValueError(f"an element of type {element.type} stands where numbers are expected")
    return np.frombuffer(element.data, np.dtype(order + _NUMBERS[element.type]))


def _scan(contents: Contents) -> None:
    """List a file of version 7.3: "name", "structure.field", "structures[0].field"."""
    for name, member in contents.members(contents.file, ""):
        if not name.startswith("#"):
            _note_variable(contents, name, member, 0)


def _note_variable(contents: Contents, path: str, member: Member, deep: int) -> None:
    """Note a variable, or all that is in a structure."""
    h5py = extra("h5py", "logs", "Reading MAT files of version 7.3")
    if isinstance(member, h5py.Dataset):
        if _matlab_class(member) in _NUMERIC_73 and "MATLAB_empty" not in member.attrs:
            contents.take(member, path, matlab=True)
        return
    if not isinstance(member, h5py.Group) or "MATLAB_sparse" in member.attrs or deep >= _DEEPEST:
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
    """Return the class of a variable, "" without one."""
    key = "MATLAB_class"
    if key not in member.attrs or member.attrs.get_id(key).dtype.kind != "S":  # MATLAB's have a fixed length
        return ""
    return bytes(member.attrs[key]).decode("ascii", "replace")


def _write_73(path: Path, variables: Mapping[str, Any]) -> None:
    h5py = extra("h5py", "logs", "Writing MAT files of version 7.3")
    image = io.BytesIO()  # a disk that is full ends the process inside the library
    with h5py.File(image, "w", userblock_size=_HEADER_73) as file:
        for name, values in variables.items():
            matrix = np.asarray(values, dtype=np.float64).reshape(1, -1)  # n x 1, stored the other way round
            dataset = file.create_dataset(name, data=matrix, **(PACKING if matrix.size > 1 else {}))
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    text = b"MATLAB 7.3 MAT-file, written by jointid, HDF5 schema 1.00 ."
    image.seek(0)
    image.write(text.ljust(116) + bytes(8) + struct.pack("<H", _VERSION_73) + b"IM")
    path.write_bytes(image.getbuffer())
