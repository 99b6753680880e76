"""Files of arrays and columns: NPY, NPZ, MAT, HDF5, Parquet and TDMS.

MAT of version 7.3 is HDF5: every variable is a dataset and every structure a group, with its class in the attribute
MATLAB_class; arrays are transposed. Cells and the fields of arrays of structures are references to the group "#refs#".
The layout was read from files that MATLAB wrote.
"""

from __future__ import annotations

import logging
import math
import os
import re
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import Table, find_columns, require_room, to_numbers

_HEADER = 2**20  # characters of the header of a NumPy array, for the widest table
_VARIABLE = re.compile(r"(?!end$|for$|global$|if$)[A-Za-z]\w{0,62}", re.ASCII)  # MATLAB name, no likely keyword
_HDF5, _HEADER_73 = b"\x89HDF\r\n\x1a\n", 512  # the signature, and the bytes of MATLAB's own header before it
# Declared numbers that were never written take time to read but no space in the file. Deflate expands a byte to at most
# 1032, each of which may be a number.
_PACKED_MOST, _ANY_FILE = 10_000, 2**27  # most bytes of declared numbers: per byte of a file, and in any file
_CHUNK = 2**30  # most bytes of a decompressed chunk; h5py's default is a mebibyte
_MEMBERS = 100_000  # datasets and groups of a file
_UNITS = ("units", "unit", "Units", "Unit", "UNITS")
_IN_BYTES = ("DECIMAL", "FLOAT16")  # numbers that Parquet stores as bytes
_GROUP = 65536  # rows of Parquet that are written or decoded together
_LONGEST_LIST = 1000  # columns of a column of lists
_PARQUET_UNITS = (b"units", b"unit")
_TEXT, _CONTAINER = 2**24, 2**20  # bytes and items of one metadata entry
_NAMELESS = "Untitled"  # LabVIEW's name of an unnamed group
_TDMS_UNITS = ("unit_string", "unit", "units", "Unit")
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNSET = np.datetime64("1904-01-02")  # LabVIEW's epoch, the value of unset instants, is the day before


def read_npy(path: Path, rows: int | None) -> Iterator[Table]:
    """Read a record array, or a matrix with samples along the longer side."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of Python's parser about a damaged header
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
        # Into a file NumPy writes by C, which does not report a full disk on the last bytes.
        np.save(SimpleNamespace(write=file.write), array, allow_pickle=False)


def read_npz(path: Path) -> Table:
    """Read every array; skip objects, which would be pickles."""
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
    """Read every variable of real numbers; structures give "structure.field"."""
    with path.open("rb") as raw:
        head = raw.read(_HEADER_73 + len(_HDF5))
    if head.startswith(_HDF5) or head.startswith(_HDF5, _HEADER_73):
        return read_hdf5(path, matlab=True)
    from scipy.io.matlab import MatReadWarning, loadmat

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Duplicate variable name|Unreadable variable")
        warnings.filterwarnings("ignore", 'Duplicate variable name "None"')  # SciPy's name of all MATLAB objects
        try:
            variables = loadmat(path)
        except MatReadWarning as warning:
            raise RecordError(f"{path.name} has two variables of one name; rename one of them.") from warning
    table = Table(source=path.name)
    for name, value in variables.items():
        if not name.startswith("__"):  # SciPy's entries
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

    # Compressed variables have checksums, which reveal a damaged file.
    savemat(path, dict(table.columns), do_compression=True, oned_as="column")


def read_hdf5(path: Path, *, matlab: bool = False) -> Table:
    """Read every dataset of numbers by its path, without external links."""
    h5py = extra("h5py", "logs", f"Reading {path.name}")
    table, seen, bearable = Table(source=path.name), 0, _ANY_FILE + _PACKED_MOST * path.stat().st_size

    def visit(name: str | bytes, member: Any) -> None:
        nonlocal seen
        if (seen := seen + 1) > _MEMBERS:
            raise RecordError(f"{path.name} has more than {_MEMBERS} datasets and groups; log fewer.")
        called = os.fsencode(name).decode("utf-8", "replace")  # a damaged name comes as bytes
        if not isinstance(member, h5py.Dataset) or (matlab and called.startswith("#")):
            return
        called = called.replace("/", ".") if matlab else called
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
        file.visititems(visit)  # each once, without links
        return table


def _refuse(h5py: Any, dataset: Any) -> str:
    """Return the reason to skip a dataset; empty for a usable one."""
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
    """Return the text of an attribute; empty for other kinds."""
    held = member.attrs.get_id(key) if key in member.attrs else None
    if held is None or math.prod(held.shape or ()) != 1 or held.dtype.kind not in "OS":
        return ""
    text = np.asarray(member.attrs[key]).ravel()[0]
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).strip()


def read_parquet(path: Path, rows: int | None) -> Iterator[Table]:
    """Read columns of numbers, booleans or instants; null is NaN.

    Lists give "name[0]", members "name.member". Instants count from the first one of their first column.
    """
    parquet = extra("pyarrow.parquet", "logs", f"Reading {path.name}")
    begin = list[np.datetime64]()
    # Neither mapped nor buffered in advance: memory holds little but the decoded data.
    with (
        path.open("rb") as raw,
        parquet.ParquetFile(
            raw,
            buffer_size=2**20,
            pre_buffer=False,
            thrift_string_size_limit=_TEXT,
            thrift_container_size_limit=_CONTAINER,
            page_checksum_verification=True,
        ) as file,
    ):
        about, leaves = file.metadata, [file.schema.column(index) for index in range(len(file.schema))]
        groups = [about.row_group(index) for index in range(about.num_row_groups)]
        held = sum(group.column(index).num_values for group in groups for index in range(about.num_columns))
        require_room(path.name, 0 if rows else max(held, about.num_rows * about.num_columns))
        # Texts are not decoded, since their size is unbounded.
        wanted = [
            leaf.path
            for leaf in leaves
            if not leaf.physical_type.endswith("BYTE_ARRAY") or leaf.logical_type.type in _IN_BYTES
        ]
        passed = {leaf.path: "it holds text" for leaf in leaves if leaf.path not in wanted}
        for batch in file.iter_batches(rows or _GROUP, columns=wanted, use_threads=False):
            table = Table(source=path.name, passed=passed)
            for field, array in zip(batch.schema, batch.columns, strict=True):
                _take_array(table, field.name, array, begin)
                unit = next(
                    (field.metadata[key] for key in _PARQUET_UNITS if key in (field.metadata or {})), b""
                ).decode()
                table.units |= {field.name: unit.strip()} if unit.strip() and field.name in table.columns else {}
            yield table.require_numbers()


def _take_array(table: Table, name: str, array: Any, begin: list[np.datetime64]) -> None:
    """Add the columns of an array; `begin` is the file's first instant."""
    arrow, compute = extra("pyarrow", "logs", "Reading Parquet"), extra("pyarrow.compute", "logs", "Reading Parquet")
    types, kind = arrow.types, array.type
    if types.is_map(kind) or types.is_null(kind):
        table.passed[name] = "it holds pairs, or nothing"
    elif types.is_dictionary(kind):
        _take_array(table, name, array.dictionary_decode(), begin)
    elif types.is_struct(kind):
        for index, member in enumerate(array.flatten()):
            _take_array(table, f"{name}.{kind.field(index).name}", member, begin)
    elif hasattr(kind, "value_type"):
        flat, sizes = array.flatten(), set(compute.list_value_length(array).to_pylist())
        size = len(flat) // len(array)
        if sizes != {size} or not 0 < size <= _LONGEST_LIST:
            table.passed[name] = "its lists are empty, too long or of several lengths"
            return
        for index in range(size):
            _take_array(table, f"{name}[{index}]", flat[index::size], begin)
    elif types.is_temporal(kind):
        if types.is_time(kind):  # of the day
            count = array.cast("int32" if types.is_time32(kind) else "int64")
            array = count.cast("int64").cast(arrow.duration(kind.unit))
        instants = array.to_numpy(zero_copy_only=False)
        if instants.dtype.kind == "M" and not begin:
            begin.extend(instants[~np.isnat(instants)][:1])
        table.add(name, to_numbers(instants, np.array(begin)), "s")
    else:
        numbers = array.cast("float64", safe=False).fill_null(np.nan).to_numpy(zero_copy_only=False)
        table.add(name, np.array(numbers))


def write_parquet(path: Path, table: Table) -> None:
    """Write float64 columns with checksums; their units are metadata."""
    arrow, parquet = extra("pyarrow", "logs", "Writing Parquet"), extra("pyarrow.parquet", "logs", "Writing Parquet")
    stated = {name: {"unit": unit} for name, unit in table.units.items()}
    schema = arrow.schema([arrow.field(name, arrow.float64(), metadata=stated.get(name)) for name in table.columns])
    made = arrow.Table.from_arrays([arrow.array(values) for values in table.columns.values()], schema=schema)
    with path.open("wb") as file:
        parquet.write_table(
            made, file, row_group_size=_GROUP, write_page_checksum=True, use_dictionary=False, compression="zstd"
        )


def read_tdms(path: Path) -> Table:
    """Read channels of numbers as "group/channel", without a group "Untitled".

    "unit_string" is the unit. A waveform (wf_increment) gets
    a time column "group/time" if shared by the group, else "group/channel/time". Instants and wf_start_time become
    seconds since the first in the file. Text is skipped.
    """
    nptdms = extra("nptdms", "logs", f"Reading {path.name}")
    # Errors are reported below, not in a log.
    extra("nptdms.log", "logs", "Reading TDMS").log_manager.set_level(logging.CRITICAL)
    table = Table(source=path.name)
    # An open file, not its path: an index file beside it may belong to another file.
    with path.open("rb") as raw:
        file = nptdms.TdmsFile.open(raw)
        if file.file_status.incomplete_final_segment:
            raise RecordError(f"{path.name} ends in the middle of its data; log or copy it again.")
        every = [channel for group in file.groups() for channel in group.channels()]
        require_room(path.name, sum(map(len, every)))
        begins = dict[str, np.datetime64]()
        for one in filter(len, every):  # the first instant of a waveform, or of instants
            begin = one.read_data(0, 1)[0] if np.dtype(one.dtype).kind == "M" else one.properties.get(_START)
            begins |= {one.path: begin} if isinstance(begin, np.datetime64) and begin >= _UNSET else {}
        first = min(begins.values(), default=None)
        late = {path: float((begin - first) / np.timedelta64(1, "s")) for path, begin in begins.items()}
        for group in file.groups():
            _take_group(table, group, late)
    return table


def _take_group(table: Table, group: Any, late: dict[str, float]) -> None:
    prefix = "" if group.name == _NAMELESS else f"{group.name}/"
    waves = dict[str, FloatArray]()
    for channel in group.channels():
        step, offset = (float(channel.properties.get(key, 0.0)) for key in (_STEP, _OFFSET))
        if len(channel) and step > 0:
            waves[channel.name] = np.asarray(late.get(channel.path, 0.0) + offset + np.arange(len(channel)) * step)
    is_common = len({times.tobytes() for times in waves.values()}) == 1 and "time" not in waves
    if is_common:
        table.add(f"{prefix}time", next(iter(waves.values())), "s")
    for channel in group.channels():
        name, kind = f"{prefix}{channel.name}", np.dtype(channel.dtype).kind
        if not len(channel) or kind not in "fiubM":
            table.passed[name] = "it holds no numbers"
            continue
        values, begin = channel.read_data(), late.get(channel.path, 0.0) if kind == "M" else 0.0
        if values.size != len(channel):
            raise ValueError(f"{values.size} numbers where {len(channel)} are declared")
        unit = "s" if kind == "M" else str(next(filter(None, map(channel.properties.get, _TDMS_UNITS)), "")).strip()
        clock = "" if channel.name not in waves else f"{prefix}time" if is_common else f"{name}/time"
        table.add(name, to_numbers(values, values[:1]) + begin, unit, clock)
        if clock and not is_common:
            table.add(clock, waves[channel.name], "s")
