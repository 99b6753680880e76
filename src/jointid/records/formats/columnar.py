"""Apache Parquet and National Instruments' TDMS: columns with their units, and clocks of waveforms."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import Found, Table, require_columns, require_room, to_numbers

_GROUP = 65536  # rows of Parquet that are written, and decoded, together
_LONGEST_LIST = 1000  # columns of a column of lists
_UNITS = (b"units", b"unit")
_TEXT, _CONTAINER = 2**24, 2**20  # bytes and items of one entry of a file's description
_NAMELESS = "Untitled"  # what LabVIEW calls a group that has no name
_TDMS_UNITS = ("unit_string", "unit", "units", "Unit")
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNSET = np.datetime64("1904-01-02")  # LabVIEW counts from the day before; an instant nobody set is that

Arrow: TypeAlias = Any
"""An object of pyarrow, which has no types."""

Nptdms: TypeAlias = Any
"""An object of npTDMS, which has no types."""


def read_parquet(path: Path, rows: int | None) -> Iterator[Table]:
    """Read every column of numbers, booleans or instants; null is NaN, a list "name[0]", a member "name.member".

    Instants count from the first one of the file's first column of them.
    """
    parquet = extra("pyarrow.parquet", "logs", f"Reading {path.name}")
    begin = list[np.datetime64]()
    # Not mapped, and read as it is asked for: memory holds what is decoded, and little else.
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
        about, wanted = file.metadata, [field for field in file.schema_arrow if _may_be_numbers(field.type)]
        groups = [about.row_group(index) for index in range(about.num_row_groups)]
        held = sum(group.column(index).num_values for group in groups for index in range(about.num_columns))
        require_room(path.name, 0 if rows else max(held, about.num_rows * about.num_columns))
        passed = {field.name: f"it holds {field.type}" for field in file.schema_arrow if field not in wanted}
        for batch in file.iter_batches(rows or _GROUP, columns=[field.name for field in wanted], use_threads=False):
            found = Found(path, passed=passed)
            for field, array in zip(wanted, batch.columns, strict=True):
                _take_array(found, field.name, array, begin)
                unit = next((field.metadata[key] for key in _UNITS if key in (field.metadata or {})), b"").decode()
                found.units |= {field.name: unit.strip()} if unit.strip() and field.name in found.columns else {}
            yield found.table()


def _may_be_numbers(kind: Arrow) -> bool:
    types = extra("pyarrow.types", "logs", "Reading Parquet")
    if types.is_struct(kind):
        return any(_may_be_numbers(kind.field(index).type) for index in range(kind.num_fields))
    if types.is_dictionary(kind) or types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind):
        return _may_be_numbers(kind.value_type)
    return bool(types.is_primitive(kind) or types.is_decimal(kind))


def _take_array(found: Found, name: str, array: Arrow, begin: list[np.datetime64]) -> None:
    """Add the columns of an array; `begin` is the first instant of the file, once there is one."""
    types, kind = extra("pyarrow.types", "logs", "Reading Parquet"), array.type
    if types.is_dictionary(kind):
        _take_array(found, name, array.dictionary_decode(), begin)
    elif types.is_struct(kind):
        for index, member in enumerate(array.flatten()):
            _take_array(found, f"{name}.{kind.field(index).name}", member, begin)
    elif hasattr(kind, "value_type"):
        flat, size = _to_floats(array.flatten()), len(array.flatten()) // len(array)
        sizes = [size] if types.is_fixed_size_list(kind) else array.value_lengths().unique().to_pylist()
        if array.null_count or sizes != [size] or not 0 < size <= _LONGEST_LIST:
            found.passed[name] = "its lists are empty, too long or of several lengths"
            return
        for index, column in enumerate(flat.reshape(-1, size).T):
            found.add(f"{name}[{index}]", np.ascontiguousarray(column))
    elif types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind):
        values = array.cast("int32" if types.is_time32(kind) else "int64").fill_null(0).to_numpy(zero_copy_only=False)
        instants = values.astype(f"M8[{kind.unit}]" if types.is_timestamp(kind) else f"m8[{kind.unit}]")
        instants[array.is_null().to_numpy(zero_copy_only=False)] = "NaT"
        if types.is_timestamp(kind) and not begin:
            begin.extend(instants[~np.isnat(instants)][:1])
        found.add(name, to_numbers(instants, np.array(begin) if begin else None), "s")
    elif _may_be_numbers(kind):
        found.add(name, _to_floats(array))
    else:
        found.passed[name] = f"it holds {kind}"


def _to_floats(array: Arrow) -> FloatArray:
    array = array.cast("float64", safe=False).fill_null(math.nan)
    return np.array(array.to_numpy(zero_copy_only=False), dtype=np.float64)


def write_parquet(path: Path, table: Table) -> None:
    """Write float64 columns with checksums; their units are metadata."""
    require_columns(table, "Parquet")
    arrow = extra("pyarrow", "logs", "Writing Parquet")
    parquet = extra("pyarrow.parquet", "logs", "Writing Parquet")
    stated = {name: {"unit": unit} for name, unit in table.units.items()}
    schema = arrow.schema([arrow.field(name, arrow.float64(), metadata=stated.get(name)) for name in table.columns])
    made = arrow.Table.from_arrays([arrow.array(values) for values in table.columns.values()], schema=schema)
    with path.open("wb") as file:
        parquet.write_table(
            made, file, row_group_size=_GROUP, write_page_checksum=True, use_dictionary=False, compression="zstd"
        )


def read_tdms(path: Path) -> Table:
    """Read every channel of numbers as "group/channel", or "channel" of the group "Untitled".

    Numeric properties of the file and its groups are scalars; "unit_string" is the unit. A waveform (wf_increment) gets
    a time column "group/time" if shared by the group, else "group/channel/time". Instants and wf_start_time are seconds
    since the first in the file. Text is skipped.
    """
    nptdms = extra("nptdms", "logs", f"Reading {path.name}")
    # What is wrong with a file is said here, once, and not on the side.
    extra("nptdms.log", "logs", "Reading TDMS").log_manager.set_level(logging.CRITICAL)
    # An open file, not its path: an index beside it, which may be of another file, is then left alone.
    with path.open("rb") as raw:
        file = nptdms.TdmsFile.open(raw)
        if file.file_status.incomplete_final_segment:
            raise RecordError(f"{path.name} ends in the middle of its data; log or copy it again.")
        every = [channel for group in file.groups() for channel in group.channels()]
        require_room(path.name, sum(len(channel) for channel in every))
        found = Found(path)
        for prefix, properties in [("", file.properties), *((f"{one.name}/", one.properties) for one in file.groups())]:
            numbers = {n: v for n, v in properties.items() if isinstance(v, int | float | np.number)}
            found.scalars |= {f"{prefix}{n}": float(v) for n, v in numbers.items() if not isinstance(v, bool)}
        begins = {channel.path: begin for channel in every if (begin := _find_begin(channel)) is not None}
        first = min(begins.values(), default=None)
        late = {path: float((begin - first) / np.timedelta64(1, "s")) for path, begin in begins.items()}
        for group in file.groups():
            _take_group(found, group, late)
        return found.table()


def _find_begin(channel: Nptdms) -> np.datetime64 | None:
    """Return the first instant of a waveform, or of a channel of instants."""
    if not len(channel):
        return None
    is_instants = np.dtype(channel.dtype).kind == "M"
    begin = channel.read_data(0, 1)[0] if is_instants else channel.properties.get(_START)
    return begin if isinstance(begin, np.datetime64) and begin >= _UNSET else None


def _take_group(found: Found, group: Nptdms, late: dict[str, float]) -> None:
    prefix = "" if group.name == _NAMELESS else f"{group.name}/"
    waves: dict[str, FloatArray] = {}
    for channel in group.channels():
        step, offset = (float(channel.properties.get(key, 0.0)) for key in (_STEP, _OFFSET))
        if len(channel) and step > 0:
            waves[channel.name] = np.asarray(late.get(channel.path, 0.0) + offset + np.arange(len(channel)) * step)
    is_common = len({times.tobytes() for times in waves.values()}) == 1 and "time" not in waves
    if is_common:
        found.add(f"{prefix}time", next(iter(waves.values())), "s")
    for channel in group.channels():
        name, kind = f"{prefix}{channel.name}", np.dtype(channel.dtype).kind
        if not len(channel) or kind not in "fiubM":
            found.passed[name] = "it holds no numbers"
            continue
        values, begin = channel.read_data(), late.get(channel.path, 0.0) if kind == "M" else 0.0
        if values.size != len(channel):
            raise ValueError(f"{values.size} numbers where {len(channel)} are declared")
        unit = "s" if kind == "M" else str(next(filter(None, map(channel.properties.get, _TDMS_UNITS)), "")).strip()
        clock = "" if channel.name not in waves else f"{prefix}time" if is_common else f"{name}/time"
        found.add(name, to_numbers(values, values[:1]) + begin, unit, clock)
        if clock and not is_common:
            found.add(clock, waves[channel.name], "s")
