"""Apache Parquet: numeric columns, read by row groups."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import (
    PIECES,
    Block,
    Table,
    join_tables,
    require_one_length,
    require_size,
    require_unique_names,
)

_GROUP = 65536  # rows that are written together
_BATCH = 65536  # rows that are decoded together
_WIDEST = 1000  # columns of a column of lists
_SCALARS = b"jointid.scalars"
_UNITS = (b"units", b"unit")
_TEXT, _CONTAINER = 2**24, 2**20  # bytes and items of one entry of a file's description
_ANY_LENGTH = "its rows are lists of any length"

Arrow: TypeAlias = Any
"""An object of pyarrow, which has no types."""


@dataclass(frozen=True, slots=True)
class Parquet:
    """Parquet: columns of numbers, booleans or instants; null is NaN.

    Structure members are "structure.member", lists of one length "name[0]", "name[1]", ... Instants are seconds since
    the first one of the first such column. Column metadata "unit" or "units" is the unit. Text and ragged lists are
    skipped.
    """

    name: ClassVar[str] = "Parquet"
    suffixes: ClassVar[tuple[str, ...]] = (".parquet", ".pq")

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        with _open(path) as file:
            require_size(path, _count_values(file))
            parts = list(_read_parts(path, file))
        if not parts:
            raise RecordError(f"{path.name} holds no row of numbers; log or copy it again.")
        passed = parts[-1].passed
        late = passed.keys() - parts[0].passed.keys()  # lists that were of one length at first
        whole = join_tables(parts)
        kept = {name: values for name, values in whole.columns.items() if name.rpartition("[")[0] not in late}
        return replace(whole, columns=kept, passed=passed)

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many."""
        with _open(path) as file:
            require_size(path, _count_values(file), PIECES)
            parts = list[Table]()
            for part in _read_parts(path, file):
                parts.append(part)
                while sum(each.rows for each in parts) >= rows:
                    whole = join_tables(parts)
                    yield _to_block(whole.cut(0, rows))
                    parts = [whole.cut(rows, whole.rows)] if whole.rows > rows else []
            if parts:
                yield _to_block(join_tables(parts))

    def write(self, path: Path, table: Table) -> None:
        """Write float64 columns with checksums; units and scalars are metadata."""
        require_one_length(table, self.name)
        refused = [
            name for name in table.columns if name != name.encode("utf-8", "replace").decode("utf-8") or not name
        ]
        if refused:
            raise RecordError(f"{refused[0]!r} cannot name a column of Parquet, which is text; rename it.")
        arrow = extra("pyarrow", "logs", "Writing Parquet")
        parquet = extra("pyarrow.parquet", "logs", "Writing Parquet")
        fields = [
            arrow.field(name, arrow.float64(), metadata={"unit": table.units[name]} if name in table.units else None)
            for name in table.columns
        ]
        scalars = {name: repr(value) for name, value in table.scalars.items()}  # NaN has no place in JSON
        metadata = {_SCALARS: json.dumps(scalars)} if scalars else None
        arrays = [arrow.array(values) for values in table.columns.values()]
        made = arrow.Table.from_arrays(arrays, schema=arrow.schema(fields, metadata=metadata))
        with path.open("wb") as file:
            parquet.write_table(
                made, file, row_group_size=_GROUP, write_page_checksum=True, use_dictionary=False, compression="zstd"
            )


def _to_block(table: Table) -> Block:
    return Block(table.rows, partial(table.cut, 0))


@contextmanager
def _open(path: Path) -> Iterator[Arrow]:
    parquet = extra("pyarrow.parquet", "logs", f"Reading {path.name}")
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
        yield file


def _count_values(file: Arrow) -> int:
    """Number of declared values; a list column has several per row."""
    about = file.metadata
    groups = (about.row_group(index) for index in range(about.num_row_groups))
    held = sum(group.column(index).num_values for group in groups for index in range(about.num_columns))
    return int(max(held, about.num_rows * about.num_columns))


@dataclass(slots=True)
class _Decoder:
    """Decoder state: first instant and list lengths.

    Attributes:
        begins: the first instant of each column of instants, as its whole number.
        origin: the first instant of the column of instants that comes first, in ns; None before there is one.
        passed: what is not read, and why.
        sizes: length of the lists of each column of lists, as its first batch has them.
        read: those of them that are read.
    """

    begins: dict[str, int] = field(default_factory=dict)
    origin: int | None = None
    passed: dict[str, str] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    read: set[str] = field(default_factory=set)

    def columns(self, name: str, array: Arrow) -> Iterator[tuple[str, FloatArray]]:
        """Yield the columns of an Arrow array."""
        types = extra("pyarrow.types", "logs", "Reading Parquet")
        kind = array.type
        if types.is_dictionary(kind):
            yield from self.columns(name, array.dictionary_decode())
        elif types.is_struct(kind):
            flat = array.flatten()
            for index in range(kind.num_fields):
                yield from self.columns(f"{name}.{kind.field(index).name}", flat[index])
        elif _is_list(kind) and types.is_floating(kind.value_type) | types.is_integer(kind.value_type):
            sizes = {array.type.list_size} if types.is_fixed_size_list(kind) else set(array.value_lengths().to_pylist())
            size = self.sizes.setdefault(name, next(iter(sizes), 0))
            if array.null_count or sizes != {size} or not 0 < size <= _WIDEST:
                fixed = "its lists are missing in some rows, or too long"
                reason = fixed if types.is_fixed_size_list(kind) else _ANY_LENGTH
                self.passed[name] = "its lists are empty" if sizes == {0} else reason
                if name not in self.read:
                    return
                matrix = np.full((len(array), size), np.nan)  # blocks before this one are read already
            elif name in self.passed and name not in self.read:
                return
            else:
                self.read.add(name)
                matrix = _to_floats(array.flatten()).reshape(-1, size)
            yield from ((f"{name}[{index}]", column) for index, column in enumerate(matrix.T))
        elif types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind):
            yield name, self._instants(name, array)
        elif types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind) or types.is_decimal(kind):
            yield name, _to_floats(array)
        else:
            self.passed[name] = _skip_reason(kind)

    def _instants(self, name: str, array: Arrow) -> FloatArray:
        """Convert instants to seconds since the first, or durations to seconds."""
        arrow = extra("pyarrow", "logs", "Reading Parquet")
        types = extra("pyarrow.types", "logs", "Reading Parquet")
        unit = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[array.type.unit]
        missing = array.is_null().to_numpy(zero_copy_only=False)
        whole = array.cast(arrow.int32() if types.is_time32(array.type) else arrow.int64())
        counts = whole.fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
        if types.is_timestamp(array.type) and not missing.all():
            begin = self.begins.setdefault(name, int(counts[~missing][0]))
            here = begin * (10**9 // unit)
            self.origin = here if self.origin is None else self.origin
            return np.where(missing, np.nan, (counts - begin) / unit + (here - self.origin) / 1e9)
        return np.where(missing, np.nan, counts / unit)


def _to_floats(array: Arrow) -> FloatArray:
    arrow = extra("pyarrow", "logs", "Reading Parquet")
    kind = array.type
    if not extra("pyarrow.types", "logs", "Reading Parquet").is_floating(kind):
        array = array.cast(arrow.float64(), safe=False)
    values = array.fill_null(math.nan) if array.null_count else array
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64)


def _read_parts(path: Path, file: Arrow) -> Iterator[Table]:
    schema = file.schema_arrow
    ragged = _find_ragged(file)
    passed = {entry.name: _skip_reason(entry.type) for entry in schema if not _may_be_numbers(entry.type)}
    decoding = _Decoder(passed=passed | dict.fromkeys(ragged, _ANY_LENGTH))
    require_unique_names(path, list(schema.names))
    stated = {entry.name: (entry.metadata or {}) for entry in schema}
    texts = {name: (each.get(_UNITS[0]) or each.get(_UNITS[1]) or b"") for name, each in stated.items()}
    units = {name: unit for name, text in texts.items() if (unit := text.decode("utf-8", "replace").strip())}
    kept = json.loads((schema.metadata or {}).get(_SCALARS, "{}"))
    scalars = {str(name): float(text) for name, text in kept.items()}
    wanted = [entry.name for entry in schema if _may_be_numbers(entry.type) and entry.name not in ragged]
    units |= {entry.name: "s" for entry in schema if str(entry.type).startswith(("timestamp", "duration", "time"))}
    for batch in file.iter_batches(batch_size=_BATCH, columns=wanted, use_threads=False):
        pairs = [pair for name in batch.schema.names for pair in decoding.columns(name, batch.column(name))]
        require_unique_names(path, [name for name, _ in pairs])
        if batch.num_rows and not pairs:
            raise RecordError(f"{path.name} holds no column of numbers; log the signals as numbers.")
        if batch.num_rows:
            yield Table(dict(pairs), scalars, path.name, units, decoding.passed)


def _is_list(kind: Arrow) -> bool:
    types = extra("pyarrow.types", "logs", "Reading Parquet")
    return bool(types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind))


def _find_ragged(file: Arrow) -> set[str]:
    """Names of columns of lists that are too long or not of one length, by the file's own count, undecoded."""
    about, sizes = file.metadata, dict[str, set[float]]()
    for group in (about.row_group(index) for index in range(about.num_row_groups)):
        for column in (group.column(index) for index in range(about.num_columns)):
            name, inner, _ = str(column.path_in_schema).partition(".list.")
            if inner and group.num_rows:
                sizes.setdefault(name, set()).add(column.num_values / group.num_rows)
    return {name for name, found in sizes.items() if len(found) > 1 or max(found) > _WIDEST or max(found) % 1}


def _skip_reason(kind: Arrow) -> str:
    return "it holds text" if "string" in str(kind) else f"it holds {str(kind).partition('<')[0]}"


def _may_be_numbers(kind: Arrow) -> bool:
    """Test whether a column may hold numbers of bounded size."""
    types = extra("pyarrow.types", "logs", "Reading Parquet")
    if types.is_struct(kind):
        return any(_may_be_numbers(kind.field(index).type) for index in range(kind.num_fields))
    if types.is_dictionary(kind) or _is_list(kind):
        return _may_be_numbers(kind.value_type)
    return bool(types.is_primitive(kind) or types.is_decimal(kind))
