"""A log as a folder of several files: texts that share a clock, or a LeRobot data set."""

from __future__ import annotations

import json
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
    if (path / _INFO).is_file() or not path.is_dir():
        return (path / _INFO).is_file()
    suffixes = {file.suffix.lower() for file in path.iterdir()}
    return ".csv" in suffixes and suffixes.isdisjoint(_BAGS)


def read_folder(path: Path) -> Table:
    """Read the columns of each text as "file/column", with the clock of their file; or a LeRobot data set.

    Files without a clock, and those with nothing beside it, are passed over. Where joint_list.txt names the joints,
    "positions[0]" is "positions/joint". Of a data set the Parquet files are joined one behind the other,
    "observation.state[0]" is called "observation.state.joint".
    """
    if (path / _INFO).is_file():
        return _read_data_set(path)
    whole = Found(path)
    joints = _read_names(path / _JOINTS).split("\n") if (path / _JOINTS).is_file() else []
    names = [*filter(None, map(str.strip, joints))]
    ends = {f"[{k}]": f"/{name}" for k, name in enumerate(names)} if len(set(names)) == len(names) else {}
    for file in sorted(one for one in path.iterdir() if one.suffix.lower() == ".csv" and not one.is_dir()):
        require_file(file)
        table = read_text(file)
        named = {name: f"{file.stem}/{_rename(name, ends)}" for name in table.columns}
        whole.passed |= {f"{file.stem}/{name}": why for name, why in table.passed.items()}
        clock = next(iter([*set(table.clocks.values()), *filter(STAMP_NAME.fullmatch, table.columns)]), None)
        if clock is None or len(table.columns) == 1:
            why = "its file has no channel" if clock else "its file has no clock"
            whole.passed |= dict.fromkeys(named.values(), why)
            continue
        for name, values in table.columns.items():
            whole.add(named[name], values, table.units.get(name, ""), named[clock] if name != clock else "")
    return whole.table()


def _read_names(file: Path) -> str:
    with file.open("rb") as raw:
        return raw.read(_LARGEST).decode("utf-8", "replace")


def _rename(column: str, ends: dict[str, str]) -> str:
    """Return the name of a column, an element of a list by its joint."""
    head, bracket, place = column.rpartition("[")
    return head + ends.get(bracket + place, bracket + place)


def _read_data_set(path: Path) -> Table:
    tables, size = list[Table](), 0
    for file in sorted(path.glob(_DATA)):
        require_file(file)
        tables.append(read_parquet(file))
        size += sum(values.size for values in tables[-1].columns.values())
        require_size(path, size)
    if not tables:
        raise RecordError(f"{path.name} is a LeRobot data set without a file {_DATA}; copy its folder data too.")
    whole, features = join_tables(tables), json.loads(_read_names(path / _INFO))["features"]
    ends = {feature: _feature_ends(about) for feature, about in features.items()}
    called = {name: _rename(name, ends.get(name.partition("[")[0], {})) for name in whole.columns}
    return replace(
        whole,
        columns={called[name]: values for name, values in whole.columns.items()},
        units={called.get(name, name): unit for name, unit in whole.units.items()},
        source=path.name,
    )


def _feature_ends(about: Any) -> dict[str, str]:
    """Return the names of the elements of a feature, by their places."""
    names = about.get("names")
    if isinstance(names, dict) and len(names) == 1:  # such as {"motors": [...]}
        (names,) = names.values()
    unique = isinstance(names, list) and len(set(map(str, names))) == len(names)
    return {f"[{k}]": f".{name}" for k, name in enumerate(names)} if unique else {}
