"""ROS 2 bags: joint states, references, other messages by their own definition, clocks, and hostile bytes."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jointid.common.errors import RecordError
from jointid.records.formats import read_table
from jointid.records.formats.messages import decode_message, message_types
from tests.records.logged import LOGGED, bag

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
DEFINED = """\
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
control_like/Gain[] gains   # one for each joint
uint8[] raw
bool on
float32 LIMIT=2.5
float32[2] pair
"""
MAGIC = b"\x89MCAP0\r\n"
GAIN = "float64 position_gain\nint16 step"


def write_bag(folder: Path, topics: dict[str, tuple[str, list[tuple[int, Any]]]], store: Any = STORE) -> Path:
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (kind, messages) in topics.items():
            link = writer.add_connection(topic, kind, typestore=store)
            for stamp, message in messages:
                writer.write(link, stamp, store.serialize_cdr(message, kind))
    return folder


def header(stamp: int) -> Any:
    return T["std_msgs/msg/Header"](stamp=T["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), frame_id="é")


def state(stamp: int, **fields: Any) -> Any:
    names = list(fields)
    return T["sensor_msgs/msg/JointState"](
        header=header(stamp), name=names, position=np.array(list(fields.values())), velocity=np.empty(0),
        effort=np.empty(0),
    )  # fmt: skip


def test_references_of_every_kind_have_a_clock_each(tmp_path: Path) -> None:
    dimension = T["std_msgs/msg/MultiArrayDimension"](label="é", size=2, stride=2)
    layout = T["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=0)
    point = T["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=np.array([1.0, 2.0]), velocities=np.array([3.0]), accelerations=np.empty(0), effort=np.empty(0),
        time_from_start=T["builtin_interfaces/msg/Duration"](sec=-1, nanosec=500_000_000),
    )  # fmt: skip
    second = 10**9
    path = write_bag(
        tmp_path / "bag",
        {
            "/one": ("std_msgs/msg/Float64", [(k * second, T["std_msgs/msg/Float64"](data=k / 3)) for k in (3, 1, 2)]),
            "/many": (
                "std_msgs/msg/Float64MultiArray",
                [(5, T["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.array([7.0, 8.0])))],
            ),
            "/point": ("trajectory_msgs/msg/JointTrajectoryPoint", [(second, point)]),
            "/text": ("std_msgs/msg/String", [(1, T["std_msgs/msg/String"](data="x"))]),
        },
    )
    found = {name: values.tolist() for name, values in read_table(path).columns.items()}
    assert found == {
        "/one/time": [1, 2, 3], "/one": [1 / 3, 2 / 3, 1], "/many/time": [5e-9], "/many[0]": [7], "/many[1]": [8],
        "/point/time": [1], "/point/positions[0]": [1], "/point/positions[1]": [2], "/point/velocities[0]": [3],
        "/point/time_from_start": [-0.5],
    }  # fmt: skip


def test_dates_begin_with_the_bag_and_a_joint_that_is_missing_is_nan(tmp_path: Path) -> None:
    begin = 1_700_000_000_000_000_000
    states = [state(begin + 7, a=1.0), state(begin + 10**9 + 7, a=2.0, b=5.0), state(begin + 2 * 10**9 + 7, b=6.0)]
    path = write_bag(
        tmp_path / "bag",
        {
            "/js": ("sensor_msgs/msg/JointState", [(begin + k * 10**9 + 99, s) for k, s in enumerate(states)]),
            "/goal": ("std_msgs/msg/Float64", [(begin, T["std_msgs/msg/Float64"](data=1.0))]),
        },
    )
    columns = read_table(path).columns
    np.testing.assert_array_equal(columns["/js/time"], [7e-9, 1 + 7e-9, 2 + 7e-9])
    np.testing.assert_array_equal(columns["/js/a/position"], [1, 2, np.nan])
    np.testing.assert_array_equal(columns["/js/b/position"], [np.nan, 5, 6])
    assert columns["/goal/time"].tolist() == [0]
    assert "/js/a/velocity" not in columns


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_messages_are_read_by_the_definition_in_the_bag(plugin: StoragePlugin, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(GAIN, "control_like/msg/Gain"))
    store.register(get_types_from_msg(DEFINED, "control_like/msg/State"))
    point = T["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=np.array([1.0, 2.0]), velocities=np.array([9.0]), accelerations=np.empty(0), effort=np.empty(0),
        time_from_start=T["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
    )  # fmt: skip
    gain = store.types["control_like/msg/Gain"]
    message = store.types["control_like/msg/State"](
        header=header(10**9), joint_names=["a", "b"], desired=point,
        gains=[gain(position_gain=1.5, step=-3), gain(position_gain=2.5, step=4)],
        raw=np.arange(5, dtype=np.uint8), on=True, pair=np.array([0.5, 0.25], dtype=np.float32),
    )  # fmt: skip
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        link = writer.add_connection("/c", "control_like/msg/State", typestore=store)
        writer.write(link, 1, store.serialize_cdr(message, "control_like/msg/State"))
    found = {name: values.item() for name, values in read_table(tmp_path / "bag").columns.items()}
    assert found == {
        "/c/time": 1, "/c/desired/a/positions": 1, "/c/desired/b/positions": 2, "/c/desired/velocities[0]": 9,
        "/c/desired/time_from_start": 0, "/c/a/position_gain": 1.5, "/c/a/step": -3, "/c/b/position_gain": 2.5,
        "/c/b/step": 4, "/c/on": 1,
        "/c/a/pair": 0.5, "/c/b/pair": 0.25,
    }  # fmt: skip


def test_a_folder_is_read_in_the_order_of_its_files(tmp_path: Path) -> None:
    for number, value in ((10, 3.0), (9, 2.0)):
        bag_of_one = write_bag(
            tmp_path / f"bag{number}",
            {"/goal": ("std_msgs/msg/Float64", [(number, T["std_msgs/msg/Float64"](data=value))])},
        )
        (tmp_path / "all").mkdir(exist_ok=True)
        next(bag_of_one.glob("*.mcap")).rename(tmp_path / "all" / f"bag_{number}.mcap")
    assert read_table(tmp_path / "all").columns["/goal"].tolist() == [2, 3]
    assert read_table(f"{tmp_path / 'all'}/").columns["/goal"].tolist() == [2, 3]
    (tmp_path / "none").mkdir()
    with pytest.raises(RecordError, match=r"is a folder without an \.mcap or \.db3 file"):
        read_table(tmp_path / "none")


@pytest.mark.parametrize("name", ["run #1 50%.db3", "run%20.MCAP"])
def test_a_file_of_a_bag_can_have_any_name(name: str, tmp_path: Path) -> None:
    made = tmp_path / f"run{Path(name).suffix.lower()}"
    bag(made)
    assert "/goal" in read_table(made.rename(tmp_path / name)).columns


def test_a_topic_that_cannot_be_read_is_told_and_the_others_are_read(tmp_path: Path) -> None:
    bag(tmp_path / "run.db3")
    with sqlite3.connect(tmp_path / "run.db3") as base:
        base.execute("UPDATE topics SET type = 'my_msgs/msg/Own' WHERE name = '/goal'")
    base.close()
    table = read_table(tmp_path / "run.db3")
    assert table.passed == {"/goal": "the bag has no definition of my_msgs/msg/Own"}
    assert "/joint_states/elbow/position" in table.columns


def test_a_topic_of_two_kinds_is_told_and_not_mixed(tmp_path: Path) -> None:
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for kind in ("std_msgs/msg/Float64", "std_msgs/msg/Float32"):
            link = writer.add_connection("/goal", kind, typestore=STORE)
            for stamp in (10**9, 2 * 10**9):
                writer.write(link, stamp, STORE.serialize_cdr(T[kind](data=1.0), kind))
        link = writer.add_connection("/other", "std_msgs/msg/Float64", typestore=STORE)
        writer.write(link, 10**9, STORE.serialize_cdr(T["std_msgs/msg/Float64"](data=1.0), "std_msgs/msg/Float64"))
    table = read_table(tmp_path / "run")
    assert table.passed == {"/goal": "its messages are of more than one kind"}
    assert list(table.columns) == ["/other/time", "/other"]


# Hostile bytes
# -------------


@pytest.mark.parametrize(
    ("definition", "data"),
    [
        ("my/A[] a", b"\xff\xff\xff\xff"),
        ("A a", b""),
        ("A[] a", struct.pack("<I", 2**31)),
        ("float64[] a", struct.pack("<I", 2**31)),
        ("float64[1000000000000] a", b""),
        ("string s", struct.pack("<I", 2**31)),
        ("B[100000] b\n" + "=" * 80 + "\nMSG: my/B\nC[100000] c\n" + "=" * 80 + "\nMSG: my/C\nfloat64[0] x", b""),
    ],
)
def test_no_definition_makes_a_message_larger_than_its_bytes(definition: str, data: bytes) -> None:
    with pytest.raises(ValueError, match=r"the message|messages within messages"):
        decode_message("my/msg/A", b"\x00\x01\x00\x00" + data, message_types("my/msg/A", definition))


def test_a_definition_is_never_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in ("__import__('os').mkdir('owned')", "x=__import__('os').mkdir('owned')", "x import os"):
        types = message_types("my/msg/A", f"float64 data\nfloat64 {line}\n")
        assert all(name.isidentifier() for fields in types.values() for _, name, _ in fields)
    assert not message_types("my/msg/A'); import os; ('", "float64 data")
    assert not list(tmp_path.iterdir())


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def whole_file(content: bytes) -> bytes:
    """Return an MCAP file without an index: its header, some records, and the footer."""
    head = record(1, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))
    return MAGIC + head + content + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def chunk(size: int, compression: bytes, packed: bytes, check: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, size, check) + struct.pack("<I", len(compression)) + compression
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        record(1, b"")[:-1],
        struct.pack("<BQ", 5, 2**62),
        chunk(2**40, b"", b""),
        chunk(8, b"rot13", b"x" * 8),
        chunk(4, b"", struct.pack("<BH", 5, 1) + b"x", zlib.crc32(b"other")),
        record(5, struct.pack("<HIQQ", 9, 0, 0, 0)),
        record(4, struct.pack("<HHI", 1, 0, 2**31)),
    ],
)
def test_no_length_in_an_mcap_file_is_trusted(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole_file(content))
    with pytest.raises(RecordError, match=r"run\.mcap (cannot be read as ROS 2 bag|holds no topic)"):
        read_table(path)
    path.write_bytes(whole_file(content)[: -len(MAGIC)])
    with pytest.raises(RecordError, match=r"run\.mcap cannot be read as (a )?ROS 2 bag"):
        read_table(path)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_does_not_unpack_to_more_than_it_says(compression: str, tmp_path: Path) -> None:
    if compression == "lz4":
        from lz4.frame import compress
    else:
        from sys import version_info

        if version_info >= (3, 14):
            from compression.zstd import compress
        else:
            from backports.zstd import compress
    path = tmp_path / "run.mcap"
    inside = (
        record(3, struct.pack("<H", 1) + b"".join(struct.pack("<I", len(t)) + t for t in (b"std_msgs/msg/Float64",
               b"ros2msg", b"float64 data")))
        + record(4, struct.pack("<HHI", 1, 1, 2) + b"/q" + struct.pack("<I", 3) + b"cdr" + struct.pack("<I", 0))
        + record(5, struct.pack("<HIQQ", 1, 0, 5, 5) + b"\x00\x01\x00\x00" + struct.pack("<d", 2.5))
    )  # fmt: skip
    packed = compress(inside)
    path.write_bytes(whole_file(chunk(len(inside), compression.encode(), packed, zlib.crc32(inside))))
    assert read_table(path).columns["/q"].tolist() == [2.5]
    path.write_bytes(whole_file(chunk(10, compression.encode(), compress(bytes(2**26)))))
    with pytest.raises(RecordError, match="damaged"):
        read_table(path)


def test_a_view_instead_of_a_table_is_not_asked(tmp_path: Path) -> None:
    path = tmp_path / "run.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
        )
    base.close()
    with pytest.raises(RecordError, match=r"run\.db3 has a view 'messages' whose content is computed"):
        read_table(path)


@pytest.mark.parametrize(
    "extra",
    [
        "CREATE TABLE more(a, data BLOB AS (zeroblob(a)))",
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END",
    ],
)
def test_a_database_that_computes_is_refused(extra: str, tmp_path: Path) -> None:
    """A column of a kilobyte can be computed to hold gigabytes."""
    path = tmp_path / "run.db3"
    LOGGED["db3"].write(path)
    assert read_table(path).columns
    with sqlite3.connect(path) as base:
        base.execute(extra)
    base.close()
    with pytest.raises(RecordError, match=r"run\.db3 has a (table 'more'|trigger 't') whose content is computed"):
        read_table(path)


def test_a_bag_of_thousands_of_topics_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "run.db3"
    LOGGED["db3"].write(path)
    with sqlite3.connect(path) as base:
        base.executemany(
            "INSERT INTO topics VALUES(?, ?, 'std_msgs/msg/Float64', 'cdr', '', '')",
            ((number, f"/topic{number}") for number in range(10, 30_010)),
        )
    base.close()
    with pytest.raises(RecordError, match=r"run\.db3 has 30002 topics \(at most 2000 are read\)"):
        read_table(path)


def test_a_bag_without_numbers_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {"/text": ("std_msgs/msg/String", [(1, T["std_msgs/msg/String"](data="x"))])})
    with pytest.raises(RecordError, match="bag holds no topic of numbers"):
        read_table(path)


def test_a_topic_with_too_many_parts_or_two_joints_of_one_name_is_told(tmp_path: Path) -> None:
    twice = T["sensor_msgs/msg/JointState"](
        header=header(1), name=["a", "a"], position=np.array([1.0, 2.0]), velocity=np.empty(0), effort=np.empty(0)
    )
    pose = T["geometry_msgs/msg/Pose"](
        T["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    poses = T["geometry_msgs/msg/PoseArray"](header(1), [pose] * 3000)
    path = write_bag(
        tmp_path / "bag",
        {
            "/twice": ("sensor_msgs/msg/JointState", [(1, twice), (2, twice)]),
            "/poses": ("geometry_msgs/msg/PoseArray", [(1, poses)]),
            "/one": ("sensor_msgs/msg/JointState", [(1, state(1, a=5.0))]),
        },
    )
    table = read_table(path)
    assert list(table.columns) == ["/one/time", "/one/a/position"]
    assert table.passed == {
        "/twice": "a message of it has two numbers called '/twice/a/position'",
        "/poses": "a message of it has more than 20000 parts",
    }
