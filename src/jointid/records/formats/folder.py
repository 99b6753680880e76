"""A log as a folder of several files: texts that share a clock, or a LeRobot data set."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from jointid.common.errors import RecordError
from jointid.records.formats.columnar import read_parquet
from jointid.records.formats.table import STAMP_NAME, Table, join_tables
from jointid.records.formats.text import read_text

_INFO, _DATA, _JOINTS = "meta/info.json", "data/*/*.parquet", "joint_list.txt"
_ELEMENT = re.compile(r"(.*)\[(\d+)\]")
_LARGEST = 2**20  # bytes of a list of names
_BAGS = (".mcap", ".db3", ".zstd")


def is_record(path: Path) -> bool:
    """Whether a folder holds a record of several files, and no bag."""
    try:
        suffixes = {file.suffix.lower() for file in path.iterdir()} if path.is_dir() else set()
        return (path / _INFO).is_file() or (".csv" in suffixes and suffixes.isdisjoint(_BAGS))
    except OSError:  # one that may not be looked into
        return False


def read_folder(path: Path) -> Table:
    """Read the columns of each text as "file/column", with the clock of their file; or a LeRobot data set.

    Files without a clock, and those with nothing beside it, are passed over. Where joint_list.txt names the joints,
    "positions[0]" is "positions/joint". Of a data set the Parquet files are joined one behind the other,
    "observation.state[0]" is called "observation.state.joint".
    """
    if (path / _INFO).is_file():
        return _read_data_set(path)
    whole = Table(source=path.name)
    joints = [line.strip() for line in _read_names(path / _JOINTS).split("\n") if line.strip()]
    for file in sorted(one for one in path.iterdir() if one.suffix.lower() == ".csv" and one.is_file()):
        table = join_tables(read_text(file, None))
        named = {name: f"{file.stem}/{_rename(name, '/', joints)}" for name in table.columns}
        whole.passed |= {f"{file.stem}/{name}": why for name, why in table.passed.items()}
        clock = next(iter([*set(table.clocks.values()), *filter(STAMP_NAME.fullmatch, table.columns)]), None)
        if clock is None or len(table.columns) == 1:
            whole.passed |= dict.fromkeys(named.values(), "its file has no clock, or nothing beside it")
            continue
        for name, values in table.columns.items():
            whole.add(named[name], values, table.units.get(name, ""), named[clock] if name != clock else "")
    return whole


def _read_names(file: Path) -> str:
    if not file.is_file():
        return ""
    with file.open("rb") as raw:
        return raw.read(_LARGEST).decode("utf-8", "replace")


def _rename(column: str, mark: str, joints: Any) -> str:
    """Return the name of a column, an element of a list by its joint, where the joints have names of their own."""
    if type(joints) is dict and len(joints) == 1:  # such as {"motors": [...]}
        (joints,) = joints.values()
    element, names = _ELEMENT.fullmatch(column), joints if type(joints) is list else []
    if element is None or not len(set(map(str, names))) == len(names) > int(element[2]):
        return column
    return f"{element[1]}{mark}{names[int(element[2])]}"


def _read_data_set(path: Path) -> Table:
    files = sorted(path.glob(_DATA))
    if not files:
        raise RecordError(f"{path.name} is a LeRobot data set without a file {_DATA}; copy its folder data too.")
    whole = join_tables(table for file in files for table in read_parquet(file, None))
    features, table = json.loads(_read_names(path / _INFO))["features"], Table(source=path.name, passed=whole.passed)
    for name, values in whole.columns.items():
        joints = features.get(name.partition("[")[0], {}).get("names")
        table.add(_rename(name, ".", joints), values, whole.units.get(name, ""))
    return table
