"""ROS 2 bags: joint states, references, other messages by their own definition, clocks, and hostile bytes."""

import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jointid.common.errors import RecordError
from jointid.records.formats import read_table
from jointid.records.formats.bags import Walk, message_types
from tests.records.logged import bag, stamped, write_bag

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
GAIN = "float64 position_gain\nint16 step"


def header(stamp: int) -> Any:
    return stamped(T, stamp)


def state(stamp: int, **fields: Any) -> Any:
    names = list(fields)
    return T["sensor_msgs/msg/JointState"](
        header=header(stamp), name=names, position=np.array(list(fields.values())), velocity=np.empty(0),
        effort=np.full(len(names), np.nan),
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
    columns, passed = (table := read_table(path)).columns, table.passed
    np.testing.assert_array_equal(columns["/js/time"], [7e-9, 1 + 7e-9, 2 + 7e-9])
    np.testing.assert_array_equal(columns["/js/a/position"], [1, 2, np.nan])
    np.testing.assert_array_equal(columns["/js/b/position"], [np.nan, 5, 6])
    assert columns["/goal/time"].tolist() == [0]
    assert "/js/a/velocity" not in columns and passed["/js/a/effort"] == "it holds no number"


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
    definitions = {"control_like/msg/Gain": GAIN, "control_like/msg/State": DEFINED}
    write_bag(tmp_path / "bag", {"/c": ("control_like/msg/State", [(1, message)])}, definitions, plugin.name)
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
    with pytest.raises(RecordError):
        read_table(tmp_path / "none")


def test_a_topic_that_cannot_be_read_is_told_and_the_others_are_read(tmp_path: Path) -> None:
    bag(tmp_path / "run.db3")
    with sqlite3.connect(tmp_path / "run.db3") as base:
        base.execute("UPDATE topics SET type = 'my_msgs/msg/Own' WHERE name = '/goal'")
    base.close()
    table = read_table(tmp_path / "run.db3")
    assert "/goal" in table.passed and "/goal" not in table.columns
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
    assert list(table.passed) == ["/goal"]
    assert list(table.columns) == ["/other/time", "/other"]


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
    with pytest.raises(ValueError, match="a message of it"):
        Walk(message_types("my/msg/A", definition), b"\x00\x01\x00\x00" + data).message("my/msg/A", 0)


def test_a_definition_is_never_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in ("__import__('os').mkdir('owned')", "x=__import__('os').mkdir('owned')", "x import os"):
        types = message_types("my/msg/A", f"float64 data\nfloat64 {line}\n")
        assert all(name.isidentifier() for _, fields in types.values() for name, _ in fields)
    assert message_types("my/msg/A'); import os; ('", "float64 data") == message_types("my/msg/A", "")
    assert not list(tmp_path.iterdir())
