"""One short run as every format's own library writes it, for tests that read any of them."""

import inspect
import json
import shutil
import struct
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROWS = 300
TIME = np.arange(ROWS) / 1000
POSITION = np.sin(8 * TIME)
TORQUE = np.cos(8 * TIME) + np.arange(ROWS) / 7


class Logged(NamedTuple):
    """How one format is written, and what its columns of time, position and torque are then called."""

    suffix: str
    write: Callable[[Path], None]
    names: tuple[str, str, str]


def csv(path: Path) -> None:
    np.savetxt(path, np.column_stack([TIME, POSITION, TORQUE]), "%.17g", ",", header="t,q,tau", comments="")


def mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"t": TIME[:, None], "q": POSITION[:, None], "tau": TORQUE[:, None]}, do_compression=True)


def npy(path: Path) -> None:
    rows = np.zeros(ROWS, dtype=[("t", "<f8"), ("q", "<f8"), ("tau", "<f8")])
    rows["t"], rows["q"], rows["tau"] = TIME, POSITION, TORQUE
    np.save(path, rows, allow_pickle=False)


def npz(path: Path) -> None:
    np.savez_compressed(path, t=TIME, q=POSITION[None], tau=TORQUE, kp=2.5, state=np.array(["idle", "run"]))


def jsonl(path: Path) -> None:
    records = zip(TIME.tolist(), POSITION.tolist(), TORQUE.tolist(), strict=True)
    path.write_text(
        "".join(json.dumps({"t": t, "q": [q, 0], "i": {"tau": i}}) + "\n" for t, q, i in records), encoding="utf-8"
    )


def hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["t"] = TIME
        position = file.create_dataset("axis/q", data=POSITION, chunks=(64,), compression="gzip", fletcher32=True)
        position.attrs["units"] = "rad"
        file["axis/tau"] = TORQUE
        file["axis/tau"].attrs["unit"] = np.bytes_("N·m".encode())
        file["kp"] = 2.5


def matlab_dataset(group: Any, name: str, values: Any, kind: str = "double") -> Any:
    """Return a variable as MATLAB lays it out: columns and rows exchanged, its class as a text of fixed length."""
    made = group.create_dataset(name, data=np.atleast_2d(np.asarray(values)).T if np.ndim(values) == 2 else values)
    made.attrs["MATLAB_class"] = np.bytes_(kind)
    return made


def matlab_header(path: Path) -> None:
    """Write what MATLAB puts before the HDF5: 116 bytes of text, 8 of a place, the version and the order of bytes."""
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Mar  4 10:12:13 2024 HDF5 schema 1.00 ."
    with path.open("r+b") as file:
        file.write(text.ljust(116) + bytes(8) + struct.pack("<H", 0x0200) + b"IM")


def mat73(path: Path) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        matlab_dataset(file, "t", TIME[:, None])
        rec = file.create_group("rec")
        rec.attrs["MATLAB_class"] = np.bytes_("struct")
        matlab_dataset(rec, "q", POSITION[:, None])
        matlab_dataset(rec, "tau", TORQUE[None, :])
        matlab_dataset(file, "kp", np.array([[2.5]]))
    matlab_header(path)


def parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field("t", pa.float64()), pa.field("q", pa.float64(), metadata={"unit": "rad"}), ("tau", pa.float64())]
    made = pa.table([TIME, POSITION, TORQUE], schema=pa.schema(fields))
    pq.write_table(made, path, row_group_size=100, write_page_checksum=True)


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, RootObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for first in range(0, ROWS, 100):
            part = slice(first, first + 100)
            position = ChannelObject("axis", "q", POSITION[part], {"unit_string": "rad", "wf_increment": 1e-3})
            torque = ChannelObject("axis", "tau", TORQUE[part], {"unit_string": "N m", "wf_increment": 1e-3})
            writer.write_segment([RootObject({"kp": 2.5, "operator": "nobody"}), position, torque])


def write_bag(
    folder: Path,
    topics: Mapping[str, tuple[str, Iterable[tuple[int, Any]]]],
    definitions: Mapping[str, str] | None = None,
    plugin: str = "MCAP",
) -> Path:
    """Write a bag: by topic the type, and instants in ns with messages, or functions of the types that make them."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in (definitions or {}).items():
        store.register(get_types_from_msg(text, name))
    with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        for topic, (kind, messages) in topics.items():
            link = writer.add_connection(topic, kind, typestore=store)
            for stamp, message in messages:
                made = message(store.types) if inspect.isfunction(message) else message
                writer.write(link, stamp, store.serialize_cdr(made, kind))
    return folder


def stamped(types: Any, nanoseconds: int) -> Any:
    """Return a header of this instant."""
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9)), "é")


def bag(path: Path) -> None:
    """Write the one file of a bag, with joint states and a reference that comes less often."""
    begin, none = 1_700_000_000_000_000_000, np.empty(0)

    def state(row: int) -> Callable[[Any], Any]:
        position, effort = np.array([POSITION[row], 0.0]), np.array([TORQUE[row], np.nan])
        return lambda types: types["sensor_msgs/msg/JointState"](
            stamped(types, begin + row * 1_000_000), ["elbow", "wrist"], position, none, effort
        )

    def goal(row: int) -> Callable[[Any], Any]:
        return lambda types: types["std_msgs/msg/Float64"](data=float(row))

    states = [(begin + row * 1_000_000 + 400_000, state(row)) for row in range(ROWS)]
    goals = [(begin + row * 1_000_000 + 500_000, goal(row)) for row in range(0, ROWS, 10)]
    topics = {"/joint_states": ("sensor_msgs/msg/JointState", states), "/goal": ("std_msgs/msg/Float64", goals)}
    folder = write_bag(path.with_suffix(""), topics, plugin="SQLITE3" if path.suffix == ".db3" else "MCAP")
    (made,) = folder.glob(f"*{path.suffix}")
    shutil.move(made, path)
    shutil.rmtree(folder)


def topics(folder: Path, numbers: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Write a bag's folder with topics of numbers, each with its stamps in seconds."""

    def number(value: float) -> Callable[[Any], Any]:
        return lambda types: types["std_msgs/msg/Float64"](data=value)

    made = {}
    for topic, (stamps, values) in numbers.items():
        instants = np.round(1e9 * stamps).astype(int).tolist()
        made[topic] = "std_msgs/msg/Float64", list(zip(instants, map(number, values.tolist()), strict=True))
    write_bag(folder, made)


JOINT_STATES = ("/joint_states/time", "/joint_states/elbow/position", "/joint_states/elbow/effort")
LOGGED: Mapping[str, Logged] = {
    "csv": Logged(".csv", csv, ("t", "q", "tau")),
    "mat": Logged(".mat", mat, ("t", "q", "tau")),
    "npy": Logged(".npy", npy, ("t", "q", "tau")),
    "npz": Logged(".npz", npz, ("t", "q", "tau")),
    "jsonl": Logged(".jsonl", jsonl, ("t", "q[0]", "i.tau")),
    "hdf5": Logged(".h5", hdf5, ("t", "axis/q", "axis/tau")),
    "mat73": Logged(".mat", mat73, ("t", "rec.q", "rec.tau")),
    "parquet": Logged(".parquet", parquet, ("t", "q", "tau")),
    "tdms": Logged(".tdms", tdms, ("axis/time", "axis/q", "axis/tau")),
    "mcap": Logged(".mcap", bag, JOINT_STATES),
    "db3": Logged(".db3", bag, JOINT_STATES),
}
"""By format, with what writes it."""
