"""ROS 2 bags, a folder or a file (MCAP or SQLite), with one clock per topic.

The library rosbags reads the files and parses the definitions of messages. It would compile these to Python code and
run it, so messages (CDR version 1 of the Object Management Group) are decoded here, by interpretation. Every length is
checked against the available bytes, and every message against a budget.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from array import array
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import quote

import numpy as np

from jointid.common.errors import RecordError, extra
from jointid.records.formats.table import Found, Table, require_room

SUFFIXES = (".mcap", ".db3")
"""Endings of the files of a bag."""

_NUMBERS = {
    "bool": "B", "byte": "B", "octet": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_SIZES = {code: struct.calcsize("=" + code) for code in _NUMBERS.values()}
_TIME = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_NAMING = ("name", "names", "joint_names", "interface_names")
_OF_ITS_OWN = ("data", "values")  # fields that go by the name of what holds them
_BUDGET, _DEEPEST = 20_000, 16  # fields of one message, messages within messages
_MOTORS = 64  # messages of an array without names; more are no motors of a robot
_WIDEST_ARRAY, _WIDEST_TOPIC = 256, 1000  # columns of an array without names (a longer one is a picture), of a topic
_TOPICS = 2000  # of a file; the library compares each with all
_DATE = 2**58  # nanoseconds, nine years: a later stamp is a date, one before counts from some beginning
_SQLITE = b"SQLite format 3\0"
_COMPUTED = re.compile(r"\bAS\b", re.IGNORECASE)  # of a column that is generated, and of a table by a query
_DIGITS = re.compile(r"(\d+)")

Value: TypeAlias = Any
"""A number, an array, an instant (int, in nanoseconds), a text, a message (dict) or a list of messages or texts."""

Types: TypeAlias = Mapping[str, Any]
"""Definitions of messages as rosbags parses them, by the names of their types."""


def read_bag(path: Path) -> Table:
    """Read every topic of numbers: columns, and the clock "/topic/time".

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
    found, topics, count = Found(path), dict[str, _Topic](), 0
    for name, kind, types, logged, data in (message for file in files for message in _read_messages(file)):
        if name not in found.passed:
            topic = topics.setdefault(name, _Topic(name, kind))
            try:
                if topic.kind != kind:
                    raise ValueError("its messages are of more than one kind")
                count += topic.take(types, logged, data)
            except KeyError:
                found.passed[name] = f"the bag has no definition of {kind}"
            except ValueError as error:
                found.passed[name] = str(error)
            require_room(path.name, count)
    read = {name: topic.columns() for name, topic in topics.items() if name not in found.passed}
    dates = [stamps.min() for stamps, columns in read.values() if columns and stamps.min() >= _DATE]
    for name, (stamps, columns) in read.items():
        if columns:
            zero = min(dates) if stamps.min() >= _DATE else 0
            found.add(f"{name}/time", (stamps - zero) / 1e9, "s")
        for column, values in columns.items():
            found.add(column, values, clock=f"{name}/time")
    return found.table()


@dataclass(slots=True)
class _Topic:
    """The messages of one topic, as growing columns."""

    name: str
    kind: str
    logged: array[int] = field(default_factory=lambda: array("q"))
    stamped: array[int] = field(default_factory=lambda: array("q"))
    numbers: dict[str, array[float]] = field(default_factory=dict)

    def take(self, types: Types, time: int, data: bytes) -> int:
        """Add a message, and return how many numbers it may have; see `decode_message`."""
        fields, row = decode_message(self.kind, data, types), len(self.logged)
        self.logged.append(time)
        header = fields.get("header")
        stamp = header.get("stamp") if isinstance(header, dict) else None
        if isinstance(stamp, int) and stamp:
            self.stamped.append(stamp)
        for path, value in _flatten(fields, self.name):
            column = self.numbers.setdefault(path, array("d"))
            column.extend([np.nan] * (row - len(column)))  # of the messages before, which had no such number
            if len(column) > row or len(self.numbers) > _WIDEST_TOPIC:
                raise ValueError(f"it has more than {_WIDEST_TOPIC} numbers, or two in a message called {path!r}")
            column.append(value)
        return len(self.numbers) + 1

    def columns(self) -> tuple[np.ndarray[Any, np.dtype[np.int64]], dict[str, np.ndarray[Any, np.dtype[np.float64]]]]:
        """Return the stamps in nanoseconds, in their order, and the columns."""
        stamps = np.array(self.stamped if len(self.stamped) == len(self.logged) else self.logged, dtype=np.int64)
        order = np.argsort(np.array(self.logged, dtype=np.int64), kind="stable")
        columns = {}
        for name, values in self.numbers.items():
            values.extend([np.nan] * (len(self.logged) - len(values)))
            columns[name] = np.array(values, dtype=np.float64)[order]
        return stamps[order], {name: values for name, values in columns.items() if not np.isnan(values).all()}


def decode_message(name: str, data: bytes, types: Types) -> dict[str, Value]:
    """Decode a message of type `name`, "package/msg/Type".

    Raises:
        ValueError: invalid bytes, or too many parts.
        KeyError: an unknown type.
    """
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("a message of it is not plain CDR")
    return _Decoder(types, data[4:], "<" if data[1] else ">").message(name, 0)


class _Decoder:
    """The bytes of one message, read from front to back, aligned from the end of its header."""

    def __init__(self, types: Types, data: bytes, order: str) -> None:
        self.types, self.data, self.order = types, data, order
        self.at, self.budget = 0, _BUDGET

    def message(self, name: str, deep: int) -> dict[str, Value]:
        if deep > _DEEPEST:
            raise ValueError("a message of it has messages within messages without end")
        _, fields = self.types[name]
        if not fields:
            self.take(1, 1)  # a message without fields is a byte long
        return {key: self.member(shape.name, described, deep) for key, (shape, described) in fields}

    def member(self, shape: str, described: Any, deep: int) -> Value:
        """Read a field: a value (BASE, NAME), so many of them (ARRAY), or any number (SEQUENCE)."""
        if shape in ("BASE", "NAME"):
            return self.value(described[0] if shape == "BASE" else described, deep)
        (_, inner), length = described
        kind = inner if isinstance(inner, str) else inner[0]
        count = length if shape == "ARRAY" else self.number("I")
        if kind in _NUMBERS:
            start = self.take(_SIZES[_NUMBERS[kind]] if count else 1, count)  # nothing is not aligned
            return np.frombuffer(self.data, self.order + _NUMBERS[kind], count, start)
        if count > len(self.data) - self.at:  # each is a byte long at least
            raise ValueError("a message of it is shorter than it says")
        return [self.value(kind, deep) for _ in range(count)]

    def value(self, kind: str, deep: int) -> Value:
        if kind in _NUMBERS:
            return float(self.number(_NUMBERS[kind]))
        if kind == "string":
            count = self.number("I")
            start = self.take(1, count)
            return self.data[start : start + max(count - 1, 0)].decode("utf-8", "replace")
        if kind in _TIME:
            return int(self.number("i")) * 10**9 + int(self.number("I"))
        return self.message(kind, deep + 1)

    def number(self, code: str) -> Any:
        return struct.unpack_from(self.order + code, self.data, self.take(_SIZES[code], 1))[0]

    def take(self, size: int, count: int) -> int:
        """Skip the alignment and `count` items; return their offset."""
        self.budget -= 1
        start = self.at + -self.at % size
        self.at = start + count * size
        if self.at > len(self.data) or self.budget < 0:
            raise ValueError(f"a message of it is shorter than it says, or has more than {_BUDGET} parts")
        return start


def _flatten(message: Mapping[str, Value], path: str, names: list[str] | None = None) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by path.

    Arrays as long as the list of joint names beside or above them use these, "path/joint/field"; others use indices,
    "path/field[0]", as do arrays of messages, "path/field[0]/inner". Bytes, long arrays and text are skipped.
    """
    own = (value for key in _NAMING if isinstance(value := message.get(key), list) and value)
    names = next((value for value in own if isinstance(value[0], str)), names) or []
    for key, value in message.items():
        inner = "" if key in _OF_ITS_OWN else f"/{key}"
        if isinstance(value, int | float):
            yield f"{path}{inner}", value / 1e9 if isinstance(value, int) else value
        elif isinstance(value, dict) and key not in ("header", "layout"):
            yield from _flatten(value, f"{path}{inner}", names)
        elif isinstance(value, np.ndarray) and value.dtype.itemsize > 1 and value.size <= _WIDEST_ARRAY:
            named = len(names) == value.size
            for k, one in enumerate(value.tolist()):
                yield f"{path}/{names[k]}{inner}" if named else f"{path}{inner}[{k}]", one
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            named = len(names) == len(value)
            for k, part in enumerate(value if named or len(value) <= _MOTORS else ()):
                yield from _flatten(part, f"{path}/{names[k]}" if named else f"{path}{inner}[{k}]")


def _read_messages(file: Path) -> Iterator[tuple[str, str, Types, int, bytes]]:
    """Yield topic, type, definitions, log time in nanoseconds and bytes of each message in CDR."""
    from rosbags.rosbag2 import Reader

    with file.open("rb") as raw:
        is_database = raw.read(len(_SQLITE)) == _SQLITE
    if is_database:
        _require_plain(file)
    # The library puts the path of a database into an address as it is.
    place = Path(quote(str(file.absolute()), safe="/:\\")) if is_database else file
    storage = Reader.STORAGE_PLUGINS[".db3" if is_database else ".mcap"](place)
    storage.open()
    with closing(storage):
        every: list[Any] = list(storage.connections)
        links = [link for link in every if link.ext.serialization_format == "cdr"]
        if len(links) > _TOPICS:
            raise RecordError(f"{file.name} has more than {_TOPICS} topics; record only those of the joint.")
        asked = {link.id: (link.msgtype, str(link.msgdef.data) * (link.msgdef.format.name == "MSG")) for link in links}
        known = {one: message_types(*one) for one in set(asked.values())}
        for link, time, data in storage.messages(links):
            yield link.topic, link.msgtype, known[asked[link.id]], time, data


def _require_plain(file: Path) -> None:
    """Refuse a database with computed tables, which could be of any size."""
    place = f"file:{quote(str(file.absolute()), safe='/:')}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**26)
        for kind, made in base.execute("SELECT type, sql FROM sqlite_master WHERE sql IS NOT NULL"):
            if kind not in ("table", "index") or _COMPUTED.search(made):
                raise RecordError(f"{file.name} has a {kind} with computed content, which no bag has; record it again.")


def message_types(name: str, text: str) -> Types:
    """Definitions of a message type and its dependencies, if known; an empty text selects ROS's own definition."""
    from rosbags.typesys import TypesysError, get_types_from_msg
    from rosbags.typesys.stores.ros2_humble import FIELDDEFS

    try:
        return {**FIELDDEFS, **(get_types_from_msg(text, name) if text.strip() else {})}
    except TypesysError:
        return FIELDDEFS
