"""ROS 2 bags, a folder or a file (MCAP or SQLite), with one clock per topic."""

from __future__ import annotations

import re
import sqlite3
import struct
import tempfile
from array import array
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError, extra
from jointid.records.formats.messages import (
    Layout,
    SkippedTopicError,
    Topic,
    decode_message,
    find_layout,
    flatten_numbers,
    header_stamp,
    read_messages,
)
from jointid.records.formats.table import (
    Holds,
    Table,
    describe_skips,
    explain_damage,
    require_place,
    require_size,
    require_unique_names,
)

_DATE = 2**58  # nanoseconds, nine years: a later stamp is a date, one before counts from some beginning
_WIDEST = 1000  # columns of one topic
_REMEDY = "record it again, or rebuild it with ros2 bag reindex"
_DIGITS = re.compile(r"(\d+)")
_JOINT = re.compile(r"(/.+)/([^/]+)/(position|velocity|effort)")
_FIELDS = ("position", "velocity", "effort")
_VERSION = 9  # of the bag's format
_FLOAT64_HEAD = b"\x00\x01\x00\x00"  # of a message in little-endian CDR
TRAJECTORY = "/joint_trajectory_controller/joint_trajectory"
"""Topic on which ROS 2 control takes a trajectory."""
_CLOCKS = ("t", "time")
_ROUNDING = 1e-14
_NINE_YEARS = 2.0**28  # seconds; a later stamp is read as a date

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
    holds: ClassVar[Holds] = Holds.LENGTHS | Holds.CLOCKS

    def read(self, path: Path) -> Table:
        """Read every topic of numbers; see `Format.read`."""
        extra("rosbags", "logs", "Reading ROS 2 bags")
        reading = _BagTable(path)
        for file in list_files(path):
            with explain_damage(file, self.name, _REMEDY):
                for topic, time, data in read_messages(file):
                    reading.take(topic, time, data)
        return reading.table()

    def write(self, path: Path, table: Table) -> None:
        """Write a bag: a folder, or one file by its suffix.

        Columns "/topic/joint/position", "velocity" and "effort" beside a "/topic/time" in whole nanoseconds, up to
        rounding, become joint states. Other columns become topics of std_msgs/Float64, stamped by "column/time" or the
        table's time.
        """
        require_place(table, "A ROS 2 bag", self.holds)
        rosbag2 = extra("rosbags.rosbag2", "logs", "Writing ROS 2 bags")
        typesys = extra("rosbags.typesys", "logs", "Writing ROS 2 bags")
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        joints = list(_find_joint_states(table))
        taken = {name for group in joints for name in (*group.columns.values(), f"{group.topic}/time")}
        clocks = _find_clocks(table, taken)
        storage = rosbag2.StoragePlugin.SQLITE3 if path.suffix.lower() == ".db3" else rosbag2.StoragePlugin.MCAP

        def fill(folder: Path) -> None:
            with rosbag2.Writer(folder, version=_VERSION, storage_plugin=storage) as writer:
                for group in joints:
                    _write_joints(writer, store, table, group)
                for name, values in table.columns.items():
                    if name in taken or name in clocks.values():
                        continue
                    link = writer.add_connection(name, "std_msgs/msg/Float64", typestore=store)
                    clock = table.columns.get(clocks.get(name, ""))
                    stamps = _to_nanoseconds(clock) if clock is not None else None
                    for stamp, value in zip(
                        _common_stamps(table, values.size) if stamps is None else stamps, values, strict=True
                    ):
                        writer.write(link, int(stamp), _FLOAT64_HEAD + struct.pack("<d", value))

        _place_file(path, fill)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return any non-empty name; see `Format.legal_name`."""
        return name.encode("utf-8", "replace").decode("utf-8") or "_"


def write_trajectory(
    path: Path,
    names: tuple[str, ...],
    time: FloatArray,
    positions: FloatArray,
    velocities: FloatArray,
    accelerations: FloatArray,
) -> None:
    """Write a bag with one trajectory_msgs/JointTrajectory, on the topic of ROS 2 control.

    Args:
        path: a folder, or one file by its suffix.
        names: of the joints.
        time: (points,) s, from the start.
        positions: (points, joints).
        velocities: likewise.
        accelerations: likewise.

    Raises:
        ExtraError: rosbags is not installed.
    """
    rosbag2 = extra("rosbags.rosbag2", "logs", "Writing ROS 2 bags")
    typesys = extra("rosbags.typesys", "logs", "Writing ROS 2 bags")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kinds, kind = store.types, "trajectory_msgs/msg/JointTrajectory"
    rows = zip(np.round(1e9 * time).astype(np.int64).tolist(), positions, velocities, accelerations, strict=True)
    points = [
        kinds[f"{kind}Point"](q, v, a, np.empty(0), kinds["builtin_interfaces/msg/Duration"](*divmod(at, 10**9)))
        for at, q, v, a in rows
    ]
    header = kinds["std_msgs/msg/Header"](stamp=kinds["builtin_interfaces/msg/Time"](0, 0), frame_id="")
    storage = rosbag2.StoragePlugin.SQLITE3 if path.suffix.lower() == ".db3" else rosbag2.StoragePlugin.MCAP

    def fill(folder: Path) -> None:
        with rosbag2.Writer(folder, version=_VERSION, storage_plugin=storage) as writer:
            link = writer.add_connection(TRAJECTORY, kind, typestore=store)
            writer.write(link, 0, store.serialize_cdr(kinds[kind](header, list(names), points), kind))

    _place_file(path, fill)


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
    layout: Layout | None = None
    alike: array[float] = field(default_factory=lambda: array("d"))  # values of messages of this layout, at the end

    def take(self, time: int, data: bytes) -> int:
        """Add a message, and return the number of values.

        One that is laid out as the message before is read at once.

        Raises:
            ValueError: invalid bytes.
            KeyError: an unknown type.
            SkippedTopicError: too many parts, or duplicate names.
        """
        if self.layout is not None and self.layout.fits(data):
            values, begun = self.layout.read(data)
            self.alike.extend(values)
            self.logged.append(time)
            if begun:
                self.stamped.append(begun)
            return len(values) + 1
        self._divide()
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
        self.layout = find_layout(self.topic.type, data, self.topic.types, self.topic.name)
        return len(self.columns) + 1

    def _divide(self) -> None:
        """Put the values of equal messages into the columns of the first of them."""
        if self.layout is not None and self.alike:
            rows = np.frombuffer(self.alike).reshape(-1, len(self.layout.paths))
            for path, values in zip(self.layout.paths, rows.T, strict=True):
                self.columns[path].frombytes(values.tobytes())
        self.layout, self.alike = None, array("d")

    def table(self) -> tuple[Stamps, dict[str, FloatArray]]:
        """Return the stamps in nanoseconds, in their order, and the columns."""
        self._divide()
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


class _Joints(NamedTuple):
    """A topic of joint states: its clock [ns], and columns by joint and field."""

    topic: str
    stamps: Stamps
    columns: dict[tuple[str, str], str]


def _place_file(path: Path, fill: Callable[[Path], None]) -> None:
    """Create a bag's folder, or one file for a path with suffix."""
    try:
        if not path.suffix:
            fill(path)
            return
        with tempfile.TemporaryDirectory(dir=path.absolute().parent) as folder:
            fill(Path(folder) / "bag")
            (made,) = (Path(folder) / "bag").glob(f"*{path.suffix.lower()}")
            made.replace(path)
    except sqlite3.Error as error:
        raise OSError(str(error)) from error


def _find_joint_states(table: Table) -> Iterator[_Joints]:
    """Yield topics of joint states with columns as long as their clock."""
    topics: dict[str, dict[tuple[str, str], str]] = {}
    for name in table.columns:
        if match := _JOINT.fullmatch(name):
            topics.setdefault(match[1], {})[match[2], match[3]] = name
    for topic, columns in topics.items():
        clock = table.columns.get(f"{topic}/time")
        alike = clock is not None and all(table.columns[name].size == clock.size for name in columns.values())
        stamps = _to_nanoseconds(clock) if clock is not None and alike else None
        if stamps is not None and not any(np.isnan(table.columns[name]).all() for name in columns.values()):
            yield _Joints(topic, stamps, columns)


def _find_clocks(table: Table, taken: set[str]) -> dict[str, str]:
    """Map columns to their clocks."""
    clocks = {}
    for name, values in table.columns.items():
        clock = f"{name}/time"
        if name in taken or clock not in table.columns:
            continue
        if table.columns[clock].size != values.size or _to_nanoseconds(table.columns[clock]) is None:
            raise RecordError(
                f'The column "{clock}" cannot be the clock of "{name}" in a ROS 2 bag, which counts whole nanoseconds '
                "for every number; rename it."
            )
        clocks[name] = clock
    return clocks


def _to_nanoseconds(clock: np.ndarray[Any, Any]) -> Stamps | None:
    """Convert instants to whole nanoseconds; None if they differ by more than rounding."""
    if not (np.isfinite(clock).all() and clock.min() >= 0 and clock.max() < _NINE_YEARS):
        return None
    stamps = np.round(clock * 1e9).astype(np.int64)
    return stamps if np.allclose(stamps / 1e9, clock, rtol=_ROUNDING, atol=0.0) else None


def _common_stamps(table: Table, size: int) -> Stamps:
    """The table's time [ns], or consecutive nanoseconds without one."""
    for name, values in table.columns.items():
        is_clock = name.partition(" ")[0].lower() in _CLOCKS and values.size == size
        if is_clock and np.isfinite(values).all() and values.min() >= 0 and values.max() < _NINE_YEARS:
            stamps = np.round(values * 1e9).astype(np.int64)
            if np.all(np.diff(stamps) > 0):
                return stamps
    return np.arange(size)


def _write_joints(writer: Any, store: Any, table: Table, group: _Joints) -> None:
    """Write a topic of joint states, with NaN for missing fields."""
    kinds = store.types
    names = list(dict.fromkeys(joint for joint, _ in group.columns))
    fields = {}
    for each in _FIELDS:
        present = [table.columns[c] if (c := group.columns.get((n, each))) else None for n in names]
        missing = np.full(group.stamps.size, np.nan)
        made = [missing if column is None else column for column in present]
        fields[each] = np.column_stack(made) if any(column is not None for column in present) else None
    link = writer.add_connection(group.topic, "sensor_msgs/msg/JointState", typestore=store)
    for row, stamp in enumerate(group.stamps.tolist()):
        time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
        values = {key: np.empty(0) if matrix is None else matrix[row] for key, matrix in fields.items()}
        message = kinds["sensor_msgs/msg/JointState"](
            header=kinds["std_msgs/msg/Header"](stamp=time, frame_id=""), name=names, **values
        )
        writer.write(link, stamp, store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
