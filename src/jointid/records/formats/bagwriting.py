"""Write a table as a ROS 2 bag: joint states where the columns are named like them, single numbers elsewhere."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.errors import RecordError, extra
from jointid.records.formats.messages import encode_float64
from jointid.records.formats.table import Table

_JOINT = re.compile(r"(/.+)/([^/]+)/(position|velocity|effort)")
_FIELDS = ("position", "velocity", "effort")
_VERSION = 9  # of the bag's format
_CLOCKS = ("t", "time")
_ROUNDING = 1e-14
_NINE_YEARS = 2.0**28  # seconds; a stamp beyond is read as a date

Stamps = NDArray[np.int64]


class _Joints(NamedTuple):
    """A topic of joint states: its clock in nanoseconds, and the columns by joint and field."""

    topic: str
    stamps: Stamps
    columns: dict[tuple[str, str], str]


def write_bag(path: Path, table: Table) -> None:
    """Write a bag: a folder, or one file by its suffix.

    Columns "/topic/joint/position", "velocity" and "effort" beside a "/topic/time" of whole nanoseconds, which may be
    off by rounding, become joint states. Every other column becomes a topic of std_msgs/Float64, stamped by
    "column/time" or else by the table's time; a bag has no other way to keep numbers by name.

    Raises:
        RecordError: the folder is already there, or two topics would have one name.
    """
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
                    writer.write(link, int(stamp), encode_float64(value))

    _place_file(path, fill)


def _place_file(path: Path, fill: Callable[[Path], None]) -> None:
    """Make a bag's folder, or only the file in it where the path has a suffix."""
    if not path.suffix:
        if path.exists():
            raise RecordError(f"{path} is already there, and a bag is not written over; name another folder.")
        fill(path)
        return
    with tempfile.TemporaryDirectory(dir=path.absolute().parent) as folder:
        fill(Path(folder) / "bag")
        (made,) = (Path(folder) / "bag").glob(f"*{path.suffix.lower()}")
        shutil.move(made, path)


def _find_joint_states(table: Table) -> Iterator[_Joints]:
    """Yield the topics of joint states, whose columns are as long as their clock."""
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
    """Return the name of its clock for every column that has one."""
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
    """Return instants in whole nanoseconds, None if they differ from that by more than rounding."""
    if not (np.isfinite(clock).all() and clock.min() >= 0 and clock.max() < _NINE_YEARS):
        return None
    stamps = np.round(clock * 1e9).astype(np.int64)
    return stamps if np.allclose(stamps / 1e9, clock, rtol=_ROUNDING, atol=0.0) else None


def _common_stamps(table: Table, size: int) -> Stamps:
    """Return the table's time in whole nanoseconds, rounded; without one so many nanoseconds after the other."""
    for name, values in table.columns.items():
        is_clock = name.partition(" ")[0].lower() in _CLOCKS and values.size == size
        if is_clock and np.isfinite(values).all() and values.min() >= 0 and values.max() < _NINE_YEARS:
            stamps = np.round(values * 1e9).astype(np.int64)
            if np.all(np.diff(stamps) > 0):
                return stamps
    return np.arange(size)


def _write_joints(writer: Any, store: Any, table: Table, group: _Joints) -> None:
    """Write a topic of joint states; a joint without one of the fields others have is NaN in it."""
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
