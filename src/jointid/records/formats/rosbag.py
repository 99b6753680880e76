"""ROS 2 bags, a folder or a file (MCAP or SQLite), with one clock per topic."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.messages import (
    SkippedTopicError,
    Topic,
    decode_message,
    flatten_numbers,
    header_stamp,
    read_messages,
)
from jointid.records.formats.table import (
    Table,
    describe_skips,
    require_size,
    require_unique_names,
)

_DATE = 2**58  # nanoseconds, nine years: a later stamp is a date, one before counts from some beginning
_WIDEST = 1000  # columns of one topic
_DIGITS = re.compile(r"(\d+)")

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class RosBag:
    """A ROS 2 bag: each topic of numbers gives columns and the clock "/topic/time".

    Joint states are "/topic/joint/position", likewise velocity and effort; single numbers "/topic", arrays "/topic[0]",
    other fields their path, if the bag has the definition. The clock is the header stamp or else the log time, in
    seconds; dates count from the first of the bag. Missing numbers are NaN. A path without suffix is a folder.
    """

    name: ClassVar[str] = "ROS 2 bag"
    suffixes: ClassVar[tuple[str, ...]] = (".mcap", ".db3")

    def read(self, path: Path) -> Table:
        """Read every topic of numbers; see `Format.read`."""
        extra("rosbags", "logs", "Reading ROS 2 bags")
        reading = _BagTable(path)
        for file in list_files(path):
            for topic, time, data in read_messages(file):
                reading.take(topic, time, data)
        return reading.table()


def list_files(path: Path) -> list[Path]:
    """Files of a bag in order."""
    if not path.is_dir():
        return [path]
    found = [file for file in path.iterdir() if file.suffix.lower() in RosBag.suffixes and file.is_file()]
    if not found:
        packed = any(file.name.endswith(".zstd") for file in path.iterdir())
        remedy = "unpack its .zstd files first" if packed else "name the folder of a bag, or a file"
        raise RecordError(f"{path.name} is a folder without an .mcap or .db3 file; {remedy}.")
    return sorted(found, key=lambda file: [int(p) if p.isdigit() else p for p in _DIGITS.split(file.name)])


@dataclass(slots=True)
class _Series:
    """The messages of one topic, as growing columns."""

    topic: Topic
    logged: array[int] = field(default_factory=lambda: array("q"))
    stamped: array[int] = field(default_factory=lambda: array("q"))
    columns: dict[str, array[float]] = field(default_factory=dict)

    def take(self, time: int, data: bytes) -> int:
        """Add a message, and return the number of values.

        Raises:
            ValueError: invalid bytes.
            KeyError: an unknown type.
            SkippedTopicError: too many parts, or duplicate names.
        """
        fields = decode_message(self.topic.type, data, self.topic.types)
        stamp, row = header_stamp(fields), len(self.logged)
        self.logged.append(time)
        if stamp is not None:
            self.stamped.append(stamp)
        for path, value in flatten_numbers(fields, self.topic.name):
            column = self.columns.setdefault(path, array("d"))
            column.extend([np.nan] * (row - len(column)))  # of the messages before, which had no such number
            if len(column) > row:
                raise SkippedTopicError(f"a message of it has two numbers called {path!r}")
            column.append(value)
        if len(self.columns) > _WIDEST:
            raise SkippedTopicError(f"it has more than {_WIDEST} numbers")
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

    def take(self, topic: Topic, time: int, data: bytes) -> None:
        """Add a message; an unreadable topic is skipped from its first message on."""
        if topic.name in self.passed:
            return
        if topic.encoding != "cdr":
            self.passed[topic.name] = f"its messages are in {topic.encoding}, not in CDR"
            return
        series = self.series.setdefault(topic.name, _Series(topic))
        try:
            if series.topic != topic:
                raise SkippedTopicError("its messages are of more than one kind")
            self.numbers += series.take(time, data)
        except KeyError:
            del self.series[topic.name]
            self.passed[topic.name] = f"the bag has no definition of {topic.type}"
        except SkippedTopicError as error:
            del self.series[topic.name]
            self.passed[topic.name] = str(error)
        require_size(self.path, self.numbers)

    def table(self) -> Table:
        found = {series.topic.name: series.table() for series in self.series.values() if series.logged}
        found = {name: (stamps, columns) for name, (stamps, columns) in found.items() if columns}
        if not found:
            said = describe_skips(self.passed)
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
