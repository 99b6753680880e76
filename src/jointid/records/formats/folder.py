"""A log as a folder of several files: texts that share a clock, or a LeRobot data set."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from jointid.common.errors import RecordError
from jointid.records.formats.columnar import read_parquet
from jointid.records.formats.table import STAMP_NAME, Found, Table, join_tables, require_file, require_size
from jointid.records.formats.text import read_text

_INFO, _DATA, _JOINTS = "meta/info.json", "data/*/*.parquet", "joint_list.txt"
_LARGEST = 2**20  # bytes of a list of names
_BAGS = (".mcap", ".db3", ".zstd")


def is_record(path: Path) -> bool:
    """Whether a folder holds a record of several files, and no bag."""
    if (path / _INFO).is_file():
        return True
    return path.is_dir() and bool(_find_files(path, ".csv")) and not _find_files(path, *_BAGS)


def read_folder(path: Path) -> Table:
    """Read the columns of each text as "file/column", with the clock of their file; or a LeRobot data set.

    Files without a clock, and those with nothing beside it, are passed over. Where joint_list.txt names the joints,
    "positions[0]" is "positions/joint". Of a data set the Parquet files are joined one behind the other,
    "observation.state[0]" is called "observation.state.joint".
    """
    return _read_data_set(path) if (path / _INFO).is_file() else _read_texts(path)


def _find_files(path: Path, *suffixes: str) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.suffix.lower() in suffixes and not file.is_dir())


def _read_texts(path: Path) -> Table:
    whole, joints = Found(path), _read_joints(path / _JOINTS)
    for file in _find_files(path, ".csv"):
        require_file(file)
        table = read_text(file)
        named = {name: f"{file.stem}/{_name(name, joints)}" for name in table.columns}
        whole.passed |= {f"{file.stem}/{name}": why for name, why in table.passed.items()}
        clock = next(iter([*set(table.clocks.values()), *filter(STAMP_NAME.fullmatch, table.columns)]), None)
        if clock is None or len(table.columns) == 1:
            whole.passed |= dict.fromkeys(
                named.values(), "its file has no channel" if clock else "its file has no clock"
            )
            continue
        for name, values in table.columns.items():
            whole.add(named[name], values, table.units.get(name, ""), named[clock] if name != clock else "")
    if not whole.columns:
        raise RecordError(f"{path.name} holds no text with a column of time and one of numbers; name the file itself.")
    return whole.table()


def _read_joints(file: Path) -> list[str]:
    if not file.is_file() or file.stat().st_size > _LARGEST:
        return []
    names = list(filter(None, map(str.strip, file.read_text(encoding="utf-8", errors="replace").splitlines())))
    return names if len(set(names)) == len(names) else []


def _name(column: str, joints: list[str]) -> str:
    """Return the name of a column, an element of a list by its joint."""
    head, bracket, place = column.removesuffix("]").rpartition("[")
    return f"{head}/{joints[int(place)]}" if bracket and place.isdecimal() and int(place) < len(joints) else column


def _read_data_set(path: Path) -> Table:
    files = sorted(file for file in path.glob(_DATA) if not file.is_dir())
    if not files:
        raise RecordError(f"{path.name} is a LeRobot data set without a file {_DATA}; copy its folder data too.")
    tables, size = list[Table](), 0
    for file in files:
        require_file(file)
        tables.append(read_parquet(file))
        size += sum(values.size for values in tables[-1].columns.values())
        require_size(path, size)
    whole, names = join_tables(tables), dict(_feature_names(path / _INFO))
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
