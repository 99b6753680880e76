"""A log as a folder of several files: texts that share a clock, or a LeRobot data set."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats.csv import Csv
from jointid.records.formats.parquet import Parquet
from jointid.records.formats.table import (
    STAMP_NAME,
    Table,
    join_tables,
    require_file,
    require_size,
    require_unique_names,
)

_INFO, _DATA, _JOINTS = "meta/info.json", "data/*/*.parquet", "joint_list.txt"
_LARGEST = 2**20  # bytes of a list of names
_BAGS = (".mcap", ".db3", ".zstd")


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder of one record: the columns of each text are "file/column", with the clock of their file.

    Files without a clock, and those with nothing beside it, are passed over. Where joint_list.txt names the joints,
    "positions[0]" is "positions/joint". A folder with meta/info.json is a LeRobot data set: its Parquet files one
    behind the other, "observation.state[0]" called "observation.state.joint".
    """

    name: ClassVar[str] = "folder of files"
    suffixes: ClassVar[tuple[str, ...]] = ()

    def fits(self, path: Path) -> bool:
        """Whether a folder holds such a record, and no bag."""
        if (path / _INFO).is_file():
            return True
        return path.is_dir() and bool(_find_files(path, ".csv")) and not _find_files(path, *_BAGS)

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        return _read_data_set(path) if (path / _INFO).is_file() else _read_texts(path)


def _find_files(path: Path, *suffixes: str) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.suffix.lower() in suffixes and not file.is_dir())


def _read_texts(path: Path) -> Table:
    columns, clocks = dict[str, FloatArray](), dict[str, str]()
    units, passed = dict[str, str](), dict[str, str]()
    joints = _read_joints(path / _JOINTS)
    files, size = _find_files(path, ".csv"), 0
    require_unique_names(path, [file.stem for file in files])
    for file in files:
        require_file(file)
        table = Csv().read(file)
        found = [*set(table.clocks.values()), *filter(STAMP_NAME.fullmatch, table.columns)]
        named = {name: f"{file.stem}/{_name(name, joints)}" for name in table.columns}
        passed |= {f"{file.stem}/{name}": why for name, why in table.passed.items()}
        if not found or len(table.columns) == 1:
            passed |= dict.fromkeys(named.values(), "its file has no channel" if found else "its file has no clock")
            continue
        columns |= {named[name]: values for name, values in table.columns.items()}
        units |= {named[name]: unit for name, unit in table.units.items()}
        clocks |= {named[name]: named[found[0]] for name in table.columns if name != found[0]}
        size += sum(values.size for values in table.columns.values())
        require_size(path, size)
    if not columns:
        raise RecordError(f"{path.name} holds no text with a column of time and one of numbers; name the file itself.")
    return Table(columns, {}, path.name, units, passed, clocks)


def _read_joints(file: Path) -> list[str]:
    if not file.is_file() or file.stat().st_size > _LARGEST:
        return []
    lines = map(str.strip, file.read_text(encoding="utf-8", errors="replace").splitlines())
    names = [line for line in lines if line]
    return names if len(set(names)) == len(names) else []


def _name(column: str, joints: list[str]) -> str:
    """Return the name of a column, an element of a list by its joint."""
    head, bracket, place = column.removesuffix("]").rpartition("[")
    return f"{head}/{joints[int(place)]}" if bracket and place.isdecimal() and int(place) < len(joints) else column


def _read_data_set(path: Path) -> Table:
    files = sorted(file for file in path.glob(_DATA) if not file.is_dir())
    if not files:
        raise RecordError(f"{path.name} is a LeRobot data set without a file {_DATA}; copy its folder data too.")
    tables, size = [], 0
    for file in files:
        require_file(file)
        tables.append(Parquet().read(file))
        size += sum(values.size for values in tables[-1].columns.values())
        require_size(path, size)
    whole = join_tables(tables)
    names = dict(_feature_names(path / _INFO))
    return replace(
        whole,
        columns={names.get(name, name): values for name, values in whole.columns.items()},
        units={names.get(name, name): unit for name, unit in whole.units.items()},
        source=path.name,
    )


def _feature_names(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the elements of a data set's features with the names that its description gives them."""
    if file.stat().st_size > _LARGEST:
        return
    try:
        said: Any = json.loads(file.read_text(encoding="utf-8"))
        features = dict(said["features"]).items()
    except (ValueError, KeyError, TypeError, RecursionError):
        raise RecordError(f"{file.name} describes no features; copy the data set again.") from None
    for feature, about in features:
        names = about.get("names") if isinstance(about, dict) else None
        if isinstance(names, dict) and len(names) == 1:  # such as {"motors": [...]}
            (names,) = names.values()
        if isinstance(names, list) and all(isinstance(name, str) for name in names) and len(set(names)) == len(names):
            yield from ((f"{feature}[{k}]", f"{feature}.{name}") for k, name in enumerate(names))
