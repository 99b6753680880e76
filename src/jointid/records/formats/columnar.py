"""Apache Parquet and National Instruments' TDMS: columns with their units, and clocks of waveforms."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import Table, require_room, to_numbers

_IN_BYTES = ("DECIMAL", "FLOAT16")  # numbers that Parquet keeps as bytes
_GROUP = 65536  # rows of Parquet that are written, and decoded, together
_LONGEST_LIST = 1000  # columns of a column of lists
_UNITS = (b"units", b"unit")
_TEXT, _CONTAINER = 2**24, 2**20  # bytes and items of one entry of a file's description
_NAMELESS = "Untitled"  # what LabVIEW calls a group that has no name
_TDMS_UNITS = ("unit_string", "unit", "units", "Unit")
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNSET = np.datetime64("1904-01-02")  # LabVIEW counts from the day before; an instant nobody set is that


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
        about, leaves = file.metadata, [file.schema.column(index) for index in range(len(file.schema))]
        groups = [about.row_group(index) for index in range(about.num_row_groups)]
        held = sum(group.column(index).num_values for group in groups for index in range(about.num_columns))
        require_room(path.name, 0 if rows else max(held, about.num_rows * about.num_columns))
        # Texts are not decoded: they may be of any size.
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
                unit = next((field.metadata[key] for key in _UNITS if key in (field.metadata or {})), b"").decode()
                table.units |= {field.name: unit.strip()} if unit.strip() and field.name in table.columns else {}
            yield table.require_numbers()


def _take_array(table: Table, name: str, array: Any, begin: list[np.datetime64]) -> None:
    """Add the columns of an array; `begin` is the first instant of the file, once there is one."""
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
    """Read every channel of numbers as "group/channel", or "channel" of the group "Untitled".

    "unit_string" is the unit. A waveform (wf_increment) gets
    a time column "group/time" if shared by the group, else "group/channel/time". Instants and wf_start_time are seconds
    since the first in the file. Text is skipped.
    """
    nptdms = extra("nptdms", "logs", f"Reading {path.name}")
    # What is wrong with a file is said here, once, and not on the side.
    extra("nptdms.log", "logs", "Reading TDMS").log_manager.set_level(logging.CRITICAL)
    table = Table(source=path.name)
    # An open file, not its path: an index beside it, which may be of another file, is then left alone.
    with path.open("rb") as raw:
        file = nptdms.TdmsFile.open(raw)
        if file.file_status.incomplete_final_segment:
            raise RecordError(f"{path.name} ends in the middle of its data; log or copy it again.")
        every = [channel for group in file.groups() for channel in group.channels()]
        require_room(path.name, sum(map(len, every)))
        begins = {channel.path: begin for channel in every if (begin := _find_begin(channel)) is not None}
        first = min(begins.values(), default=None)
        late = {path: float((begin - first) / np.timedelta64(1, "s")) for path, begin in begins.items()}
        for group in file.groups():
            _take_group(table, group, late)
    return table


def _find_begin(channel: Any) -> np.datetime64 | None:
    """Return the first instant of a waveform, or of a channel of instants."""
    if not len(channel):
        return None
    begin = channel.read_data(0, 1)[0] if np.dtype(channel.dtype).kind == "M" else channel.properties.get(_START)
    return begin if isinstance(begin, np.datetime64) and begin >= _UNSET else None


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
