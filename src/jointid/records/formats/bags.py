"""Logs of several files: ROS 2 bags, folders, LeRobot data sets.

A bag is a folder or a file (MCAP or SQLite), with one clock per topic. The library rosbags reads the files and parses
the message definitions. It would compile these to Python code and run it, so messages (CDR version 1 of the Object
Management Group) are interpreted here instead. Messages with equal lengths and joint names have their numbers at the
same bytes, and are read by the layout of the first one. Every length is checked against the available bytes, and every
message against a budget.
"""

from __future__ import annotations

import json
import re
import sqlite3
import struct
from array import array
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import quote

import numpy as np

from jointid.common.errors import RecordError, extra
from jointid.records.formats.arrays import read_parquet
from jointid.records.formats.table import STAMP_NAME, Table, join_tables, require_room
from jointid.records.formats.text import read_text

SUFFIXES = (".mcap", ".db3")
"""Endings of the files of a bag."""

_NUMBERS = {
    "bool": "B", "byte": "B", "octet": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_SIZES = {kind: struct.calcsize("=" + code) for kind, code in _NUMBERS.items()}
_INSTANT = "iI"  # seconds and nanoseconds
_TIME = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_NAMING = ("name", "names", "joint_names", "interface_names")
_OF_ITS_OWN = ("data", "values")  # fields that are named by their parent
_BUDGET, _DEEPEST = 20_000, 16  # fields of one message, levels of nested messages
_MOTORS = 64  # messages of an array without names; more are no motors of a robot
_WIDEST_ARRAY, _WIDEST_TOPIC = 256, 1000  # columns of an array without names (a longer one is a picture), of a topic
_TOPICS = 2000  # of a file; the library compares each with all
_RECENT = 8  # message layouts that are kept
_HEADER = 4  # bytes before a message: its encoding
_DATE = 2**58  # nanoseconds, nine years: later stamps are dates, earlier ones are relative
_SQLITE = b"SQLite format 3\0"
_COMPUTED = re.compile(r"\bAS\b", re.IGNORECASE)  # in the SQL of generated columns and of tables from queries
_DIGITS = re.compile(r"(\d+)")

Place: TypeAlias = tuple[int, str]
"""First byte of a number, instant or text in a message, and its `struct` code."""

Node: TypeAlias = Any
"""A field of a message: a place, a message (dict of nodes), or a list of nodes."""

Types: TypeAlias = Mapping[str, Any]
"""Message definitions parsed by rosbags, by type name."""

_INFO, _DATA, _JOINTS = "meta/info.json", "data/*/*.parquet", "joint_list.txt"
_ELEMENT = re.compile(r"(.*)\[(\d+)\]")
_LARGEST = 2**20  # bytes of a list of names


def read_bag(path: Path) -> Table:
    """Read the numbers of all topics, each with a clock "/topic/time".

    Joint states are "/topic/joint/position", likewise velocity and effort; single numbers "/topic", arrays "/topic[0]",
    other fields their path, if the bag has the definition. The clock is the header stamp or else the log time, in
    seconds; dates count from the first of the bag. Missing numbers are NaN.
    """
    extra("rosbags", "logs", "Reading ROS 2 bags")
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()]
        files.sort(key=lambda file: [int(p) if p.isdigit() else p for p in _DIGITS.split(file.name)])
    if not files:
        raise RecordError(f"{path.name} is a folder without an .mcap or .db3 file; unpack .zstd files, or name a file.")
    table, topics, count = Table(source=path.name), dict[str, _Topic](), 0
    for name, kind, types, logged, data in (message for file in files for message in _read_messages(file)):
        if name not in table.passed:
            try:
                topic = topics.setdefault(name, _Topic(kind))
                if topic.kind != kind:
                    raise ValueError("its messages are of more than one kind")
                topic.add(name, types, logged, data)
            except ValueError as error:
                table.passed[name] = str(error)
            count += len(topics[name].names) + 1
            require_room(path.name, count)
    read = {name: topic.columns() for name, topic in topics.items() if name not in table.passed}
    dates = [stamps.min() for stamps, columns in read.values() if columns and stamps.min() >= _DATE]
    for name, (stamps, columns) in read.items():
        if columns:
            zero = min(dates) if stamps.min() >= _DATE else 0
            table.add(f"{name}/time", (stamps - zero) / 1e9, "s")
        table.passed |= {column: "it holds no number" for column, values in columns.items() if np.isnan(values).all()}
        for column, values in columns.items():
            if column not in table.passed:
                table.add(column, values, clock=f"{name}/time")
    return table


@dataclass(slots=True)
class _Topic:
    """The messages of one topic.

    Attributes:
        names: of all numbers, in order; the empty name is that of header stamps.
        logged: log times in nanoseconds.
        recent: message layouts: definitions and size, readers of fixed bytes and of numbers, and their target lists.
        numbers: row indices and numbers of messages, by paths with codes.
    """

    kind: str
    names: dict[str, None] = field(default_factory=dict)
    logged: list[int] = field(default_factory=list)
    recent: deque[tuple[Any, ...]] = field(default_factory=lambda: deque(maxlen=_RECENT))
    numbers: dict[tuple[tuple[str, str], ...], tuple[list[int], array[float]]] = field(default_factory=dict)

    def add(self, name: str, types: Types, time: int, data: bytes) -> None:
        """Add a message of the topic of this name."""
        alike = (one for one in self.recent if one[0] == (id(types), len(data)) and one[1].unpack_from(data) == one[2])
        if (layout := next(alike, None)) is None:
            walk = Walk(types, data)
            message = walk.message(self.kind, 0)
            found = list(walk.find(message, name))
            match message:
                case {"header": {"stamp": (_, str(code)) as stamp}} if code == _INSTANT:
                    found.append(("", stamp))
            found.sort(key=lambda one: one[1])
            paths = tuple((path, code) for path, (_, code) in found)
            self.names |= dict.fromkeys(path for path, _ in paths)
            if len(self.names) > _WIDEST_TOPIC or len(dict(paths)) < len(paths):
                raise ValueError(f"it has more than {_WIDEST_TOPIC} numbers, or two of one name in a message")
            fixed, reader = walk.pick(sorted(walk.fixed)), walk.pick(place for _, place in found)
            target = self.numbers.setdefault(paths, ([], array("d")))
            layout = ((id(types), len(data)), fixed, fixed.unpack_from(data), reader, *target)
            self.recent.appendleft(layout)
        *_, reader, rows, numbers = layout
        rows.append(len(self.logged))
        numbers.extend(reader.unpack_from(data))
        self.logged.append(time)

    def columns(self) -> tuple[np.ndarray[Any, np.dtype[np.int64]], dict[str, np.ndarray[Any, np.dtype[np.float64]]]]:
        """Return the sorted stamps in nanoseconds, and the columns."""
        logged = np.array(self.logged, dtype=np.int64)
        stamped, order = np.zeros_like(logged), np.argsort(logged, kind="stable")
        columns = {name: np.full(logged.size, np.nan) for name in self.names if name}
        for paths, (rows, numbers) in self.numbers.items():
            values = iter(np.frombuffer(numbers).reshape(len(rows), -1).T)
            for path, code in paths:
                column = next(values)
                if code == _INSTANT:
                    instants = column.astype(np.int64) * 10**9 + next(values).astype(np.int64)
                    if not path:
                        stamped[rows] = instants
                        continue
                    column = instants / 1e9
                columns[path][rows] = column
        stamps = stamped if stamped.all() else logged
        return stamps[order], {n: values[order] for n, values in columns.items()}


class Walk:
    """A sequential parser of one message, aligned from its header's end.

    Attributes:
        fixed: places of the lengths and names that define its layout.

    Raises:
        ValueError: invalid bytes, an unknown type, or too many parts.
    """

    def __init__(self, types: Types, data: bytes) -> None:
        if len(data) < _HEADER or data[0] != 0 or data[1] not in (0, 1):
            raise ValueError("a message of it is not plain CDR")
        self.types, self.data, self.order = types, data, "<" if data[1] else ">"
        self.at, self.budget, self.fixed = _HEADER, _BUDGET, [(0, f"{_HEADER}s")]

    def message(self, kind: str, deep: int) -> dict[str, Node]:
        """Walk through a message of a type, "package/msg/Type"."""
        if kind not in self.types or deep > _DEEPEST:
            raise ValueError(f"a message of it has no definition of {kind}, or messages within messages without end")
        _, fields = self.types[kind]
        if not fields:
            self.skip(1, 1)  # a message without fields is a byte long
        return {key: self.member(shape.name, described, deep) for key, (shape, described) in fields}

    def member(self, shape: str, described: Any, deep: int) -> Node:
        """Walk through a field: a value (BASE, NAME), ARRAY or SEQUENCE."""
        if shape in ("BASE", "NAME"):
            return self.value(described[0] if shape == "BASE" else described, deep)
        (inner, kind), length = described
        kind = kind[0] if inner.name == "BASE" else kind
        count, size = length if shape == "ARRAY" else self.length(), _SIZES.get(kind, 1)
        if kind in _SIZES and (size == 1 or count > _WIDEST_ARRAY):  # bytes, or a picture
            self.skip(size if count else 1, size * count)  # empty sequences are not aligned
            return []
        if count > len(self.data) - self.at:  # each is a byte long at least
            raise ValueError("a message of it is shorter than it says")
        return [self.value(kind, deep) for _ in range(count)]

    def value(self, kind: str, deep: int) -> Node:
        """Walk through a value: number, text, instant or message."""
        if kind in _SIZES:
            return self.skip(_SIZES[kind], _SIZES[kind]), _NUMBERS[kind]
        if kind == "string":
            count = self.length()
            return self.skip(1, count), f"{count}s"
        return (self.skip(4, 8), _INSTANT) if kind in _TIME else self.message(kind, deep + 1)

    def length(self) -> int:
        """Read the length of a text or sequence, which distinguishes layouts."""
        self.fixed.append((self.skip(4, 4), "I"))
        return int(struct.unpack_from(f"{self.order}I", self.data, self.at - 4)[0])

    def skip(self, size: int, length: int) -> int:
        """Skip alignment to a size, then `length` bytes; return their start."""
        self.budget -= 1
        start = self.at + (_HEADER - self.at) % size
        self.at = start + length
        if self.at > len(self.data) or self.budget < 0:
            raise ValueError(f"a message of it is shorter than it says, or has more than {_BUDGET} parts")
        return start

    def pick(self, places: Iterable[Place]) -> struct.Struct:
        """Build the `struct` that reads places, in byte order."""
        text, at = self.order, 0
        for start, code in places:
            text += f"{start - at}x{code}"
            at = start + struct.calcsize("=" + code)
        return struct.Struct(text)

    def find(self, message: Mapping[str, Node], path: str, names: Sequence[str] = ()) -> Iterator[tuple[str, Place]]:
        """Yield the numbers of a message by path.

        Arrays as long as the list of joint names beside or above them use these, "path/joint/field"; others use
        indices, "path/field[0]", as do arrays of messages, "path/field[0]/inner". Bytes, long arrays and text are
        skipped.
        """
        for naming in _NAMING:
            match message.get(naming):
                case [(int(), str(code)), *_] as texts if code.endswith("s"):
                    self.fixed += texts
                    read = self.pick(texts).unpack_from(self.data)
                    names = [text.rstrip(b"\0").decode("utf-8", "replace") for text in read]
                    break
        for key, node in message.items():
            inner = path if key in _OF_ITS_OWN else f"{path}/{key}"
            match node:
                case (int(), str(code)):
                    if not code.endswith("s"):
                        yield inner, node
                case dict() if key not in ("header", "layout"):
                    yield from self.find(node, inner, names)
                case [first, *_] if len(node) in (len(names), *range(_MOTORS + 1)) or type(first) is tuple:
                    is_named = len(node) == len(names)
                    for k, one in enumerate(node):
                        part = one if type(one) is dict else {key if is_named else "data": one}
                        yield from self.find(part, f"{path}/{names[k]}" if is_named else f"{inner}[{k}]")


def _read_messages(file: Path) -> Iterator[tuple[str, str, Types, int, bytes]]:
    """Yield topic, type, definitions, log time [ns] and bytes of CDR messages."""
    from rosbags.rosbag2 import Reader

    with file.open("rb") as raw:
        is_database = raw.read(len(_SQLITE)) == _SQLITE
    if is_database:
        _require_plain(file)
    # The library inserts the path of a database into a URI unescaped.
    place = Path(quote(str(file.absolute()), safe="/:\\")) if is_database else file
    storage = Reader.STORAGE_PLUGINS[".db3" if is_database else ".mcap"](place)
    storage.open()
    with closing(storage):
        every: list[Any] = list(storage.connections)
        links = [link for link in every if link.ext.serialization_format == "cdr"]
        if len(links) > _TOPICS:
            raise RecordError(f"{file.name} has more than {_TOPICS} topics; record only those of the joint.")
        asked = {link.id: (link.msgtype, str(link.msgdef.data) * (link.msgdef.format.name == "MSG")) for link in links}
        for link, time, data in storage.messages(links):
            yield link.topic, link.msgtype, message_types(*asked[link.id]), time, data


def _require_plain(file: Path) -> None:
    """Refuse a database with computed content, whose size is unbounded."""
    place = f"file:{quote(str(file.absolute()), safe='/:')}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**26)
        for kind, made in base.execute("SELECT type, sql FROM sqlite_master WHERE sql IS NOT NULL"):
            if kind not in ("table", "index") or _COMPUTED.search(made):
                raise RecordError(f"{file.name} has a {kind} with computed content, which no bag has; record it again.")


@cache
def message_types(name: str, text: str) -> Types:
    """Return the definitions of a message type and its dependencies."""
    from rosbags.typesys import TypesysError, get_types_from_msg
    from rosbags.typesys.stores.ros2_humble import FIELDDEFS

    try:
        return {**FIELDDEFS, **(get_types_from_msg(text, name) if text.strip() else {})}
    except TypesysError:
        return FIELDDEFS


def is_record(path: Path) -> bool:
    """Test whether a folder holds a record in another format than a bag."""
    try:
        suffixes = {file.suffix.lower() for file in path.iterdir()} if path.is_dir() else set()
        return (path / _INFO).is_file() or (".csv" in suffixes and suffixes.isdisjoint((*SUFFIXES, ".zstd")))
    except OSError:  # no permission
        return False


def read_folder(path: Path) -> Table:
    """Read a folder of texts, as "file/column", or a LeRobot data set.

    Each file has its own clock; files without a clock or another column are skipped. If joint_list.txt names the
    joints, "positions[0]" becomes "positions/joint". A data set's Parquet files are concatenated, and
    "observation.state[0]" becomes "observation.state.joint".
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
    """Replace the index in a column's name by that joint's unique name."""
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
