"""Logs as robots write them: several files in a folder, lists in cells, motors in messages, pickles."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.records.formats import read_table

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
    assert table.passed["event/timestamp"] == "its file has no channel"
    unnamed = read_table(sage(tmp_path / "other", named=False))
    np.testing.assert_array_equal(
        unnamed.columns["state_motor/positions[1]"], table.columns["state_motor/positions/knee"]
    )


def test_a_folder_without_a_clock_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "positions.csv").write_text("a,b\n1,2\n3,4\n")
    with pytest.raises(RecordError, match="holds no text with a column of time and one of numbers; name the file"):
        read_table(tmp_path / "run")


@pytest.mark.parametrize("row", ['0.5;"[1.0, -2e-3]";7', "0.5;[1.0 -2e-3];7", "0.5;[1.0,-2e-3];7"])
def test_a_list_in_a_cell_is_a_column_for_each_number(tmp_path: Path, row: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t;q;n\n" + f"{row}\n" * 3)
    columns = read_table(path).columns
    assert {name: values[0] for name, values in columns.items()} == {"t": 0.5, "q[0]": 1.0, "q[1]": -2e-3, "n": 7.0}


def test_lists_of_two_lengths_are_refused_with_the_line(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text('t,q\n0.1,"[1, 2]"\n0.2,"[1, 2]"\n0.3,"[1]"\n')
    with pytest.raises(RecordError, match="line 4, the last, has 2 cells for 3 columns"):
        read_table(path)


def test_a_data_set_of_lerobot_has_its_joints_names(tmp_path: Path) -> None:
    table = read_table(lerobot(tmp_path / "set"))
    np.testing.assert_allclose(table.columns["action.knee.pos"][: TIME.size], COMMAND[:, 1], atol=1e-6)
    assert table.columns["observation.state.hip.pos"].size == 2 * TIME.size
    alone = read_table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    np.testing.assert_array_equal(alone.columns["action[1]"], table.columns["action.knee.pos"])
    (tmp_path / "set" / "meta" / "info.json").write_text("[]")
    with pytest.raises(RecordError, match=r"info\.json describes no features"):
        read_table(tmp_path / "set")


def test_the_motors_in_a_record_of_json_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    rows = [
        {"t": t, "motor_state": [{"q": q, "tau_est": 1.0} for q in both]}
        for t, both in zip(TIME, MOTION.tolist(), strict=True)
    ]
    path.write_text("\n".join(map(json.dumps, rows)))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["motor_state[1].q"], MOTION[:, 1])


@pytest.mark.parametrize(("name", "package"), [("chirp.pt", "torch"), ("run.pkl", "pickle")])
def test_a_pickle_is_refused_with_the_lines_that_convert_it(tmp_path: Path, name: str, package: str) -> None:
    (tmp_path / name).write_bytes(b"cos\nsystem\n(S'touch ran'\ntR.")
    with pytest.raises(RecordError) as error:
        read_table(tmp_path / name)
    said, loads, saves = error.value.faults
    assert said.startswith(f"{name} is a pickle, which runs code when it is loaded, and is not read")
    assert loads == f"import numpy, {package}"
    assert saves.startswith(f'numpy.savez("{Path(name).stem}.npz", **{package}.load(')
    assert not Path("ran").exists()
