"""Files of ROS 2 bags, and their messages (CDR), decoded by their definitions.

Definitions are interpreted, not compiled to code. Every length is checked against the available bytes and a budget.
(CDR version 1 of the Object Management Group, aligned from the end of the four-byte header.)
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import quote

import numpy as np

from jointid.common.errors import RecordError

_NUMBERS = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_TIME = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_NAMING = ("name", "names", "joint_names", "interface_names")
_OF_ITS_OWN = ("data", "values")  # fields that go by the name of what holds them
_BUDGET = 20_000  # values and parts of one message
_DEEPEST = 16
_MOTORS = 64  # messages of an array without names; more are no motors of a robot
_WIDEST = 256  # columns of an array without names; a longer one is a picture, or a scan

Value: TypeAlias = Any
"""A number, an array, a list of texts, a message (a dictionary) or a list of them; None for text."""


class SkippedTopicError(ValueError):
    """A valid message without columns of numbers; the text says why."""


class Field(NamedTuple):
    """A message field: type, name and length (None: one value, -1: any number)."""

    type: str
    name: str
    length: int | None


Definition: TypeAlias = tuple[Field, ...]


def decode_message(name: str, data: bytes, known: Mapping[str, Definition]) -> dict[str, Value]:
    """Decode a message of type `name`, "package/msg/Type".

    Raises:
        ValueError: invalid bytes.
        SkippedTopicError: too many parts.
        KeyError: an unknown type.
    """
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("the message is not plain CDR")
    return _Decoder(known, data[4:], "<" if data[1] else ">").message(name, 0)


class _Decoder:
    """The bytes of one message, read from front to back."""

    def __init__(self, known: Mapping[str, Definition], data: bytes, order: str) -> None:
        self.known, self.data, self.order = known, data, order
        self.at, self.budget = 0, _BUDGET

    def message(self, name: str, deep: int) -> dict[str, Value]:
        if deep > _DEEPEST:
            raise ValueError("messages within messages without end")
        fields = self.known[name]
        if not fields:
            self.take(1, 1)  # a message without fields is a byte long
        return {field.name: self.member(field, deep) for field in fields}

    def member(self, field: Field, deep: int) -> Value:
        kind, length = field.type, field.length
        if length is None:
            return self.value(kind, deep)
        count = int(self.number("u4")) if length < 0 else length
        if kind in _NUMBERS:
            size = np.dtype(_NUMBERS[kind]).itemsize
            start = self.take(count * size, size) if count else self.at
            return np.frombuffer(self.data, self.order + _NUMBERS[kind], count, start)
        if count > len(self.data) - self.at:  # each is a byte long at least
            raise ValueError("the message is shorter than it says")
        self.spend(count)
        return [self.value(kind, deep) for _ in range(count)]

    def value(self, kind: str, deep: int) -> Value:
        self.spend(1)
        if kind in _NUMBERS:
            return float(self.number(_NUMBERS[kind]))
        if kind == "string":
            count = int(self.number("u4"))
            start = self.take(count, 1)
            return self.data[start : start + max(count - 1, 0)].decode("utf-8", "replace")
        if kind in _TIME:
            return Instant(int(self.number("i4")) * 10**9 + int(self.number("u4")))
        return self.message(kind, deep + 1)

    def number(self, kind: str) -> Any:
        size = int(kind[1:])
        return np.frombuffer(self.data, self.order + kind, 1, self.take(size, size))[0]

    def take(self, count: int, size: int) -> int:
        """Skip alignment and `count` items of `size` bytes; return their offset."""
        start = self.at + -self.at % size
        if start + count > len(self.data):
            raise ValueError("the message is shorter than it says")
        self.at = start + count
        return start

    def spend(self, count: int) -> None:
        self.budget -= count
        if self.budget < 0:
            raise SkippedTopicError(f"a message of it has more than {_BUDGET} parts")


class Instant(int):
    """A time or a duration in nanoseconds."""


def header_stamp(message: Mapping[str, Value]) -> int | None:
    """Header stamp [ns]; None if missing or 0."""
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    return stamp if isinstance(stamp, Instant) and stamp else None


def flatten_numbers(
    message: Mapping[str, Value], path: str, names: list[str] | None = None
) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by path.

    Arrays as long as the list of joint names beside or above them use these, "path/joint/field"; others use indices,
    "path/field[0]", as do arrays of messages, "path/field[0]/inner". Bytes, long arrays and text are skipped.
    `names` are joint names of the parent message.
    """
    lists = [value for key in _NAMING if isinstance(value := message.get(key), list) and value]
    own = [value for value in lists if all(isinstance(text, str) for text in value)]
    names = own[0] if own else names
    for key, value in message.items():
        inner = "" if key in _OF_ITS_OWN else f"/{key}"
        if isinstance(value, Instant):
            yield f"{path}{inner}", value / 1e9
        elif isinstance(value, float):
            yield f"{path}{inner}", value
        elif isinstance(value, dict) and key not in ("header", "layout"):
            yield from flatten_numbers(value, f"{path}{inner}", names)
        elif isinstance(value, np.ndarray) and value.dtype.itemsize > 1 and value.size <= _WIDEST:
            named = names is not None and len(names) == value.size
            places = (
                [f"{path}/{name}{inner}" for name in names or ()]
                if named
                else [f"{path}{inner}[{index}]" for index in range(value.size)]
            )
            yield from zip(places, value.tolist(), strict=True)
        elif names and isinstance(value, list) and len(value) == len(names) and isinstance(value[0], dict):
            for name, part in zip(names, value, strict=True):
                yield from flatten_numbers(part, f"{path}/{name}")
        elif isinstance(value, list) and 0 < len(value) <= _MOTORS and isinstance(value[0], dict):
            for index, part in enumerate(value):
                yield from flatten_numbers(part, f"{path}{inner}[{index}]")


_SQLITE = b"SQLite format 3\0"
_TOPICS = 2000  # of a file; the library compares each with all
_HIDDEN = (2, 3)  # how a table says that a column is generated


class Topic(NamedTuple):
    """A topic of a bag; `types` are the definitions of its message types."""

    name: str
    type: str
    encoding: str
    types: Mapping[str, Definition]


def read_messages(file: Path) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield topic, log time in nanoseconds and bytes of each message.

    The library would compile definitions to code; here they are only parsed.
    """
    from rosbags.rosbag2 import Reader

    with file.open("rb") as raw:
        is_database = raw.read(len(_SQLITE)) == _SQLITE
    if is_database:
        _require_plain_tables(file)
    # The library puts the path of a database into an address as it is.
    place = Path(quote(str(file.absolute()), safe="/:\\")) if is_database else file
    storage = Reader.STORAGE_PLUGINS[".db3" if is_database else ".mcap"](place)
    storage.open()
    with closing(storage):
        links: list[Any] = list(storage.connections)
        _require_few_topics(file, len(links))
        known: dict[tuple[str, str], Mapping[str, Definition]] = {}
        topics = {}
        for link in links:
            asked = (link.msgtype, str(link.msgdef.data) if link.msgdef.format.name == "MSG" else "")
            if asked not in known:
                known[asked] = message_types(*asked)
            topics[link.id] = Topic(link.topic, link.msgtype, link.ext.serialization_format, known[asked])
        for link, time, data in storage.messages(links):
            yield topics[link.id], time, data


def _require_few_topics(file: Path, count: int) -> None:
    if count > _TOPICS:
        raise RecordError(
            f"{file.name} has {count} topics (at most {_TOPICS} are read); record only the topics of the joint."
        )


def _require_plain_tables(file: Path) -> None:
    """Refuse a database with computed tables or too many topics."""
    place = f"file:{quote(str(file.absolute()), safe='/:')}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**26)
        for kind, name in base.execute("SELECT type, name FROM sqlite_master"):
            described = base.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)) if kind == "table" else ()
            if kind in ("view", "trigger") or any(hidden in _HIDDEN for (hidden,) in described):
                raise RecordError(
                    f"{file.name} has a {kind} {name!r} whose content is computed, which no bag has; record it again."
                )
        (count,) = base.execute("SELECT count(*) FROM (SELECT 1 FROM topics LIMIT 1000000)").fetchone()
        _require_few_topics(file, count)


def message_types(name: str, text: str) -> dict[str, Definition]:
    """Definitions of a message type and its dependencies, if known.

    An empty text selects ROS's own definition.
    """
    from rosbags.typesys import TypesysError, get_types_from_msg
    from rosbags.typesys.stores.ros2_humble import FIELDDEFS

    try:
        own = get_types_from_msg(text, name) if text.strip() else {}
    except TypesysError:
        own = {}
    found: dict[str, Definition] = {}
    wanted = [name]
    while wanted:
        kind = wanted.pop()
        definition = own.get(kind) or FIELDDEFS.get(kind)
        if definition is None or kind in found:
            continue
        found[kind] = tuple(_parse_member(key, *described) for key, described in definition[1])
        wanted += [field.type for field in found[kind] if "/" in field.type]
    return found


def _parse_member(name: str, shape: Any, described: Any) -> Field:
    if shape.name in ("BASE", "NAME"):
        return Field(described[0] if shape.name == "BASE" else described, name, None)
    (_, inner), length = described
    return Field(inner if isinstance(inner, str) else inner[0], name, length if shape.name == "ARRAY" else -1)
