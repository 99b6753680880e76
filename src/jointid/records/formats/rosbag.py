"""ROS 2 bags: a folder, or one of its files, MCAP or SQLite; every topic of numbers with a clock of its own."""

from __future__ import annotations

import json
import re
import struct
from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats import bagwriting
from jointid.records.formats.bagwriting import Stamps
from jointid.records.formats.isolated import read_parts
from jointid.records.formats.messages import Field, SkippedTopicError, Types, flatten_numbers, header_stamp
from jointid.records.formats.table import Holds, Table
from jointid.records.formats.untrusted import explain_damage, require_size, require_unique_names

_DATE = 2**58  # nanoseconds, nine years: a stamp beyond is a date, one before counts from some beginning
_WIDEST = 1000  # columns of one topic
_HEAD = struct.Struct("<IqI")  # of a message in a batch: its topic, its time, its length
_REMEDY = "record it again, or rebuild it with ros2 bag reindex"
_DIGITS = re.compile(r"(\d+)")


class Topic(NamedTuple):
    """A topic as a bag declares it.

    Attributes:
        name: of the topic.
        type: name of its message type.
        encoding: of the messages; only "cdr" is read.
        types: definitions of its message type and of those it needs.
    """

    name: str
    type: str
    encoding: str
    types: Types


class Message(NamedTuple):
    """One message: its topic, the time of the log in nanoseconds, and its bytes."""

    topic: Topic
    time: int
    data: bytes


@dataclass(frozen=True, slots=True)
class RosBag:
    """A bag of ROS 2: every topic of numbers gives its columns and "/topic/time", its clock.

    Joint states are called "/topic/joint/position", and so velocity and effort; single numbers "/topic", arrays
    "/topic[0]"; fields of other messages by their path, where the bag holds their definition. A clock is the stamp in
    the messages' header or, without one, the time of the log: seconds, of dates since the first one of the bag.
    Where a message lacks a number it is NaN. A file without a suffix is a folder with a bag in it.
    """

    name: ClassVar[str] = "ROS 2 bag"
    suffixes: ClassVar[tuple[str, ...]] = (".mcap", ".db3")
    holds: ClassVar[Holds] = Holds.LENGTHS | Holds.CLOCKS

    def read(self, path: Path) -> Table:
        """Read every topic of numbers; see `Format.read`."""
        extra("rosbags", "logs", "Reading ROS 2 bags")
        reading = _BagTable(path)
        for file in list_files(path):
            with explain_damage(file, self.name, _REMEDY):
                for message in read_messages(file):
                    reading.take(message)
        return reading.table()

    def write(self, path: Path, table: Table) -> None:
        """Write joint states as such, and every other column as a topic of single numbers; see `bagwriting`."""
        if table.scalars:
            raise RecordError(
                f"A ROS 2 bag has no place for the scalars {', '.join(table.scalars)}; write a .mat file."
            )
        bagwriting.write_bag(path, table)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return the name, which can be any text but none; see `Format.legal_name`."""
        return name.encode("utf-8", "replace").decode("utf-8") or "_"


def list_files(path: Path) -> list[Path]:
    """Return the files of a bag in their order.

    Raises:
        RecordError: the folder has no such file.
    """
    if not path.is_dir():
        return [path]
    found = [file for file in path.iterdir() if file.suffix.lower() in RosBag.suffixes and file.is_file()]
    if not found:
        packed = any(file.name.endswith(".zstd") for file in path.iterdir())
        remedy = "unpack its .zstd files first" if packed else "name the folder of a bag, or a file"
        raise RecordError(f"{path} is a folder without an .mcap or .db3 file; {remedy}.")
    return sorted(found, key=lambda file: [int(p) if p.isdigit() else p for p in _DIGITS.split(file.name)])


def read_messages(file: Path) -> Iterator[Message]:
    """Yield the messages of one file of a bag; the library that reads it runs in a process of its own."""
    parts = read_parts("bag", file)
    topics = [
        Topic(name, kind, encoding, Types({key: tuple(Field(*each) for each in own) for key, own in types.items()}))
        for name, kind, encoding, types in json.loads(next(parts))
    ]
    for batch in parts:
        at = 0
        while at < len(batch):
            number, time, length = _HEAD.unpack_from(batch, at)
            at += _HEAD.size + length
            yield Message(topics[number], time, batch[at - length : at])


@dataclass(slots=True)
class _Series:
    """The messages of one topic, as columns that grow."""

    topic: Topic
    logged: array[int] = field(default_factory=lambda: array("q"))
    stamped: array[int] = field(default_factory=lambda: array("q"))
    columns: dict[str, array[float]] = field(default_factory=dict)

    def take(self, message: Message) -> int:
        """Add a message; return how many numbers it added.

        Raises:
            ValueError: its bytes are no such message.
            KeyError: the definition of a type is not there.
            PassedOverError: it has too many parts, or two numbers of one name.
        """
        fields = self.topic.types.decode(self.topic.type, message.data)
        stamp, row = header_stamp(fields), len(self.logged)
        self.logged.append(message.time)
        if stamp is not None:
            self.stamped.append(stamp)
        for path, value in flatten_numbers(fields, self.topic.name):
            column = self.columns.setdefault(path, array("d"))
            column.extend([np.nan] * (row - len(column)))  # of the messages before, which had no such number
            if len(column) > row:
                raise SkippedTopicError(f"a message of it has two numbers called {path!r}")
            column.append(value)
        if len(self.columns) > _WIDEST:
            raise RecordError(f"The topic {self.topic.name!r} has more than {_WIDEST} numbers; record without it.")
        return len(self.columns) + 1

    def table(self) -> tuple[Stamps, dict[str, FloatArray]]:
        """Return the stamps in nanoseconds, in their order, and the columns."""
        stamps: Stamps = np.array(
            self.stamped if len(self.stamped) == len(self.logged) else self.logged, dtype=np.int64
        )
        order = np.argsort(np.array(self.logged, dtype=np.int64), kind="stable")
        columns = {}
        for name, values in self.columns.items():
            values.extend([np.nan] * (len(self.logged) - len(values)))
            column = np.array(values, dtype=np.float64)[order]
            if not np.isnan(column).all():
                columns[name] = column
        return stamps[order], columns


class _BagTable:
    """Builder of a table from the messages of a bag."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.series: dict[str, _Series] = {}
        self.passed: dict[str, str] = {}
        self.numbers = 0

    def take(self, message: Message) -> None:
        """Add a message; a topic that cannot be read is passed over from its first one on."""
        topic = message.topic
        if topic.name in self.passed:
            return
        if topic.encoding != "cdr":
            self.passed[topic.name] = f"its messages are in {topic.encoding}, not in CDR"
            return
        series = self.series.setdefault(topic.name, _Series(topic))
        try:
            if series.topic != topic:
                raise SkippedTopicError("its messages are of more than one kind")
            self.numbers += series.take(message)
        except KeyError:
            del self.series[topic.name]
            self.passed[topic.name] = f"the bag has no definition of {topic.type}"
        except SkippedTopicError as error:
            del self.series[topic.name]
            self.passed[topic.name] = str(error)
        require_size(self.path, self.numbers)

    def table(self) -> Table:
        """Return the table of all topics."""
        found = {series.topic.name: series.table() for series in self.series.values() if series.logged}
        found = {name: (stamps, columns) for name, (stamps, columns) in found.items() if columns}
        if not found:
            passed = "; ".join(f"{name!r}: {why}" for name, why in list(self.passed.items())[:3])
            said = f" ({passed})" if passed else ""
            raise RecordError(f"{self.path.name} holds no topic of numbers{said}; record a topic of joint states.")
        dates = [int(stamps.min()) for stamps, _ in found.values() if stamps.min() >= _DATE]
        pairs, units, clocks = list[tuple[str, FloatArray]](), dict[str, str](), dict[str, str]()
        for name, (stamps, columns) in found.items():
            zero = min(dates) if stamps.min() >= _DATE else 0
            pairs += [(f"{name}/time", (stamps - zero) / 1e9), *columns.items()]
            units[f"{name}/time"] = "s"
            clocks |= dict.fromkeys(columns, f"{name}/time")
        require_unique_names(self.path, [name for name, _ in pairs])
        return Table(dict(pairs), {}, self.path.name, units, self.passed, clocks)
