"""Logs as robots write them: several files in a folder, lists in cells, motors in messages, pickles."""

import csv
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from scipy.interpolate import CubicSpline

import jointid as ji
from jointid.config import loads
from jointid.config.loading import describe_log
from jointid.records.formats import read_table
from jointid.records.inspection import recognise
from tests.records.logged import stamped, write_bag

T = 0.005
TIME = np.arange(240) * T
MOTION = np.column_stack([0.4 * np.sin(5 * TIME), 0.3 * np.cos(4 * TIME) - 0.3])  # rad, of two joints
COMMAND = MOTION + 0.01 * np.column_stack([np.cos(5 * TIME), np.sin(4 * TIME)])
TORQUE = np.column_stack([2.0 * np.cos(5 * TIME), -1.5 * np.sin(4 * TIME)])  # N m
JOINTS = ("hip", "knee")


def sage(folder: Path, *, named: bool = True) -> Path:
    """Write a motion as SAGE does: a list of all joints in each cell, the commands in a file of their own."""
    folder.mkdir()
    rows = {
        "control": (
            ["type", "timestamp", "positions"],
            (["CONTROL", t, q.tolist()] for t, q in zip(TIME, COMMAND, strict=True)),
        ),
        "state_motor": (
            ["type", "timestamp", "positions", "velocities", "torques"],
            (
                ["STATE_MOTOR", t, q.tolist(), [0.0, 0.0], tau.tolist()]
                for t, q, tau in zip(TIME[::2], MOTION[::2], TORQUE[::2], strict=True)
            ),
        ),
        "event": (["type", "timestamp", "event"], [["EVENT", 0.0, "MOTION_START"], ["EVENT", TIME[-1], "MOTION_END"]]),
    }
    for name, (head, lines) in rows.items():
        with (folder / f"{name}.csv").open("w", newline="") as file:
            csv.writer(file).writerows([head, *lines])
    if named:
        (folder / "joint_list.txt").write_text("\n".join(JOINTS) + "\n")
    return folder


def lerobot(folder: Path, *, fps: int = 30, episodes: int = 2) -> Path:
    """Write a data set as LeRobot does: episodes in one Parquet file, the names of the joints in meta/info.json."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    rows = TIME.size
    lists = pa.list_(pa.float32())
    made = {
        "observation.state": pa.array(np.tile(MOTION, (episodes, 1)).tolist(), lists),
        "action": pa.array(np.tile(COMMAND, (episodes, 1)).tolist(), lists),
        "timestamp": pa.array(np.tile(np.arange(rows) / fps, episodes).astype(np.float32)),
        "episode_index": np.repeat(np.arange(episodes), rows),
    }
    pq.write_table(pa.table(made), folder / "data" / "chunk-000" / "file-000.parquet")
    names = [f"{joint}.pos" for joint in JOINTS]
    features = {
        "observation.state": {"names": {"motors": names}},
        "action": {"names": names},
        "timestamp": {"names": None},
    }
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": fps, "features": features}))
    return folder


def test_a_folder_of_texts_is_one_record(tmp_path: Path) -> None:
    table = read_table(sage(tmp_path / "run"))
    np.testing.assert_allclose(table.columns["control/positions/knee"], COMMAND[:, 1])
    np.testing.assert_allclose(table.columns["state_motor/torques/hip"], TORQUE[::2, 0])
    assert table.clocks["control/positions/hip"] == "control/timestamp"
    assert table.clocks["state_motor/positions/hip"] == "state_motor/timestamp"
    assert "event/timestamp" in table.passed
    unnamed = read_table(sage(tmp_path / "other", named=False))
    (tmp_path / "run" / "joint_list.txt").write_text("hip\nhip\n")
    assert read_table(tmp_path / "run").columns.keys() == unnamed.columns.keys()
    np.testing.assert_array_equal(
        unnamed.columns["state_motor/positions[1]"], table.columns["state_motor/positions/knee"]
    )


def test_a_data_set_of_lerobot_has_its_joints_names(tmp_path: Path) -> None:
    table = read_table(lerobot(tmp_path / "set"))
    np.testing.assert_allclose(table.columns["action.knee.pos"][: TIME.size], COMMAND[:, 1], atol=1e-6)
    assert table.columns["observation.state.hip.pos"].size == 2 * TIME.size
    alone = read_table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    np.testing.assert_array_equal(alone.columns["action[1]"], table.columns["action.knee.pos"])
    info = tmp_path / "set" / "meta" / "info.json"
    info.write_text(json.dumps({"features": {"action": {"names": ["j", "j"]}}}))
    np.testing.assert_array_equal(read_table(tmp_path / "set").columns["action[1]"], alone.columns["action[1]"])
    info.write_text("[]")
    with pytest.raises(ji.RecordError):
        read_table(tmp_path / "set")


KP, KD = 40.0, 1.5
CONTROLLER_TYPE = "control_msgs/msg/JointTrajectoryControllerState"
CONTROLLER_STATE = (
    "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint reference\n"
    "trajectory_msgs/JointTrajectoryPoint feedback\ntrajectory_msgs/JointTrajectoryPoint desired\n"
)


def ros2(path: Path) -> Path:
    """Write joint states, and the state of a joint trajectory controller with its older fields beside the newer."""
    stamps = (1_700_000_000 * 10**9 + np.round(TIME * 1e9).astype(np.int64)).tolist()

    def joints(row: int) -> Any:
        return lambda types: types["sensor_msgs/msg/JointState"](
            stamped(types, stamps[row]), list(JOINTS), MOTION[row].copy(), np.zeros(2), TORQUE[row].copy()
        )

    def state(row: int) -> Any:
        def make(types: Any) -> Any:
            none, zero = np.empty(0), types["builtin_interfaces/msg/Duration"](0, 0)
            point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
            points = [point(one[row].copy(), none, none, none, zero) for one in (COMMAND, MOTION, COMMAND)]
            return types[CONTROLLER_TYPE](stamped(types, stamps[row]), list(JOINTS), *points)

        return make

    made = {
        "/joint_states": ("sensor_msgs/msg/JointState", [(at, joints(row)) for row, at in enumerate(stamps)]),
        "/leg/controller_state": (CONTROLLER_TYPE, [(at, state(row)) for row, at in enumerate(stamps)]),
    }
    return write_bag(path, made, {CONTROLLER_TYPE: CONTROLLER_STATE})


def table(path: Path, columns: dict[str, Any]) -> Path:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.12g", ",", header=",".join(columns), comments="")
    return path


def mit(path: Path) -> Path:
    columns: dict[str, Any] = {"timestamp": TIME}
    for k in range(2):
        columns |= {
            f"q_{k}": MOTION[:, k],
            f"dq_{k}": 0 * TIME,
            f"tauEst_{k}": TORQUE[:, k],
            f"q_des_{k}": COMMAND[:, k],
        }
        columns |= {f"kp_{k}": 0 * TIME + KP, f"kd_{k}": 0 * TIME + KD}
    return table(path.with_suffix(".csv"), columns)


def unitree_json(path: Path) -> Path:
    rows = [
        {
            "t": t,
            "motor_state": [{"q": q, "tau_est": tau} for q, tau in zip(qs, taus, strict=True)],
            "motor_cmd": [{"q": q, "kp": KP, "kd": KD} for q in commands],
        }
        for t, qs, taus, commands in zip(TIME, MOTION.tolist(), TORQUE.tolist(), COMMAND.tolist(), strict=True)
    ]
    path.with_suffix(".jsonl").write_text("\n".join(map(json.dumps, rows)))
    return path.with_suffix(".jsonl")


def pace(path: Path) -> Path:
    np.savez(path.with_suffix(".npz"), time=TIME, dof_pos=MOTION, des_dof_pos=COMMAND)
    return path.with_suffix(".npz")


LOGS: dict[str, Any] = {
    "unitree_json": unitree_json, "mit": mit, "pace": pace, "sage": sage, "ros2": ros2
}  # fmt: skip
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
URDF = f"""<robot name="leg"><link name="base"/><link name="thigh">{BODY}</link><link name="shank">{BODY}</link>
<joint name="hip" type="continuous"><parent link="base"/><child link="thigh"/></joint>
<joint name="knee" type="continuous"><parent link="thigh"/><child link="shank"/></joint></robot>"""


def compared(record: ji.Record, joint: int, name: str) -> None:
    """Compare the channels of a joint at the record's own instants, which a log with several clocks begins later."""
    steps = (3e-4, 1e-3)  # of straight lines between samples of 5 and 10 ms
    made = {"motor_position": MOTION, "reference": COMMAND} | ({} if name == "pace" else {"torque": TORQUE})
    for channel, found in record.items():
        if channel not in made:
            continue
        exact = CubicSpline(TIME, made[channel][:, joint])(record.begin + found.time)
        np.testing.assert_allclose(found.values, exact, atol=steps[channel == "torque"], err_msg=channel)


@pytest.mark.parametrize("name", LOGS)
def test_a_log_is_recognised_and_read_by_the_file_that_is_written(name: str, tmp_path: Path) -> None:
    """By a joint file, and by a robot file whose joints the log names or numbers."""
    path = LOGS[name](tmp_path / "run")
    found = ji.inspect(path)
    assert found.recognised.profile.name == name.removesuffix("_json")
    axis = "knee" if name in ("sage", "ros2") else "2"
    idim = '\n[method]\nname = "idim"\n'
    if name == "pace":  # which logs no torque: the law, which no file states, stands for it
        text = describe_log(found, path.name, "2", {})
        assert 'torque = "from_controller"' in text
        compared(loads(text + LAW, tmp_path).record(), 1, name)
        return
    alone = describe_log(found, path.name, axis, {}) + idim
    file = loads(alone, tmp_path)
    compared(file.record(), 1, name)
    (tmp_path / "robot.urdf").write_text(URDF)
    tables = tomllib.loads(alone) | {"robot": {"model": "robot.urdf"}, "joints": [{"name": joint} for joint in JOINTS]}
    del tables["joint"]
    tables["drive"] = {"profile": tables["drive"]["profile"]}
    for number, record in enumerate(loads(tomlkit.dumps(tables), tmp_path).record()):
        compared(record, number, name)


@pytest.mark.parametrize(
    ("columns", "profile"),
    [
        (("t", "q", "tau"), None),
        (("t", "q_0", "tau_0", "q_1", "tau_1"), None),
        (("t", "q", "tau", "q_des"), "mit"),
        (("t", "q", "tauEst"), "mit"),
    ],
)
def test_names_of_any_log_are_nobodys(columns: tuple[str, ...], profile: str | None) -> None:
    found = recognise(columns)
    assert (None if found is None else found.profile.name) == profile


LAW = '[controller]\nlaw = "pd"\nposition_gain = "40 N m/rad"\nderivative_gain = "1.5 N m s/rad"\n'


def test_a_data_set_needs_its_unit(tmp_path: Path) -> None:
    lerobot(tmp_path / "set")
    drive = ji.Drive("lerobot", joint="knee")
    with pytest.raises(ji.RecordError) as error:
        ji.read(tmp_path / "set", drive=drive, part=2)
    assert len(error.value.faults) == 2
    columns = {name: ji.Column(unit="deg") for name in ("reference", "motor_position")}
    record = ji.read(tmp_path / "set", columns, drive=drive, part=2)
    np.testing.assert_allclose(np.degrees(record.motor_position.values), MOTION[:, 1], atol=1e-6)
