"""A record in several files: joined on their clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.config import load
from jointid.records.joining import join_files
from jointid.records.record import Record

JOINT = """[joint]
kind = "revolute"
[record]
files = ["positions.csv", "torques.csv"]
[record.channels]
torque = { column = "tau", unit = "N m" }
motor_position = { column = "q", unit = "rad" }
[method]
name = "idim"
"""
RATE, BEGIN = 0.002, 0.3137


def angle(t: np.ndarray) -> np.ndarray:
    return np.sin(2 * t + 1.5 * np.sin(0.9 * t**1.3)) + 0.3 * np.cos(7.1 * t)


def moment(t: np.ndarray) -> np.ndarray:
    return np.cos(3 * t) + 0.2 * t


def write(path: Path, names: str, *columns: np.ndarray) -> None:
    np.savetxt(path, np.column_stack(columns), "%.12g", ",", header=names, comments="")


def files(folder: Path, *, epoch: float = 0.0, own: bool = False, stamped: bool = True) -> None:
    """Write positions at 500 Hz, and torques at 1 kHz that begin `BEGIN` later; `own` counts each from 0."""
    t = np.arange(3000) * RATE
    late = BEGIN + np.arange(5000) * RATE / 2
    clocks = [t + epoch, late + epoch - (BEGIN + epoch) * own]
    write(folder / "positions.csv", "t,q" if stamped else "q", *([clocks[0]] if stamped else []), angle(t))
    write(folder / "torques.csv", "t,tau" if stamped else "tau", *([clocks[1]] if stamped else []), moment(late))


def read_joint(folder: Path, text: str = JOINT) -> Record:
    (folder / "joint.toml").write_text(text)
    return load(folder / "joint.toml").record()


@pytest.mark.parametrize("case", ["clock", "epoch", "no stamps", "stated"])
def test_two_files_become_one_record(case: str, tmp_path: Path) -> None:
    files(tmp_path, epoch=1000.0 * (case == "epoch"), own=case == "stated", stamped=case != "no stamps")
    text = JOINT
    if case in ("stated", "no stamps"):
        text = text.replace("[record]", f"[record]\noffsets = [0, {BEGIN}]")
    if case == "no stamps":
        # Files of one rate: a common sample_time is what they have.
        late = BEGIN + np.arange(2600) * RATE
        write(tmp_path / "torques.csv", "tau", moment(late))
        text = text.replace("[record]", f"[record]\nsample_time = {RATE}")
    record = read_joint(tmp_path, text)
    assert record.torque is not None and record.motor_position is not None
    assert record.torque.sample_time == pytest.approx(RATE if case == "no stamps" else RATE / 2, rel=1e-9)
    assert len(record.torque) == len(record.motor_position) > 2500
    at = record.begin + record.motor_position.time
    np.testing.assert_allclose(record.motor_position.values, angle(at), atol=1e-4)  # lines between samples
    held = np.abs(record.torque.values - moment(at))
    assert held.max() < 3.5 * (record.torque.sample_time + 1e-4)  # held for a sample at most
    assert record.resampled is not None
    assert record.resampled.methods["torque"] == "hold" and record.resampled.methods["motor_position"] == "linear"


def test_files_of_one_clock_are_not_resampled(tmp_path: Path) -> None:
    t = np.arange(500) * RATE
    write(tmp_path / "positions.csv", "t,q", t, angle(t))
    write(tmp_path / "torques.csv", "t,tau", t, moment(t))
    (tmp_path / "joint.toml").write_text(JOINT)
    record = load(tmp_path / "joint.toml").record(tmp_path / ".." / tmp_path.name / "positions.csv")  # stands for both
    assert record.resampled is None and record.torque is not None
    np.testing.assert_allclose(record.torque.values, moment(t), rtol=1e-11)


@pytest.mark.parametrize("case", ["another epoch", "count from 0 each"])
def test_files_without_a_common_clock_ask_for_offsets(case: str, tmp_path: Path) -> None:
    t = np.arange(3000) * RATE
    write(tmp_path / "positions.csv", "t,q", t, angle(t))
    write(tmp_path / "equal.csv", "t,q", t, angle(t))
    assert join_files([tmp_path / "positions.csv", tmp_path / "equal.csv"]).rows == 3000
    late = t + 500.0 * (case == "another epoch")
    write(tmp_path / "torques.csv", "t,tau,q", late, moment(t), angle(t + BEGIN))
    with pytest.raises(RecordError, match=r"give record\.offsets"):
        read_joint(tmp_path)


ROBOT = """[robot]
model = "robot.xml"
[record]
files = ["positions.csv", "torques.csv", "references.csv"]
[record.channels]
torque = { column = "tau{axis}" }
motor_position = { column = "q{axis}" }
reference = { column = "r{axis}" }
[[joints]]
name = "one"
[[joints]]
name = "two"
"""
MODEL = """<mujoco><worldbody><body><joint name="one"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body><joint name="two"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""


def write_robot(folder: Path, *, begins: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """Write positions at 500 Hz, torques at 1 kHz and references at 250 Hz of two joints, each on a clock of its own.

    The clock of a file counts from its beginning.
    """
    (folder / "robot.xml").write_text(MODEL)
    offsets = f"[record]\noffsets = {list(begins)}" if any(begins) else "[record]"
    (folder / "robot.toml").write_text(ROBOT.replace("[record]", offsets))
    names = ("positions", "torques", "references")
    for name, rate, begin in zip(names, (RATE, RATE / 2, 2 * RATE), begins, strict=True):
        clock = np.arange(round(6.0 / rate)) * rate
        t = clock + begin
        signals = {
            "positions": {"q1": angle(t), "q2": -angle(t)},
            "torques": {"tau1": moment(t), "tau2": 2 * moment(t)},
            "references": {"r1": angle(t), "r2": -angle(t)},
        }[name]
        write(folder / f"{name}.csv", ",".join(["t", *signals]), clock, *signals.values())


@pytest.mark.parametrize("begins", [(0.0, 0.0, 0.0), (0.0, BEGIN, 0.121)])
def test_a_robot_s_record_in_three_files_has_one_clock(begins: tuple[float, float, float], tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    write_robot(tmp_path, begins=begins)
    one, two = load(tmp_path / "robot.toml").records()
    assert one.begin == two.begin
    for record, sign, factor in ((one, 1.0, 1.0), (two, -1.0, 2.0)):
        assert record.torque is not None and record.motor_position is not None and record.reference is not None
        assert record.torque.sample_time == pytest.approx(RATE / 2, rel=1e-6)
        assert len(record.torque) == len(record.motor_position) == len(record.reference) > 5000
        at = record.begin + record.torque.time
        np.testing.assert_allclose(record.motor_position.values, sign * angle(at), atol=2e-4)
        np.testing.assert_allclose(record.reference.values, sign * angle(at), atol=1e-3)
        assert np.abs(record.torque.values - factor * moment(at)).max() < 3.5 * factor * (RATE / 2 + 1e-4)


def test_joints_of_a_robot_cover_the_same_instants(tmp_path: Path) -> None:
    """Also where a file that begins later has a channel of one of them."""
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    write_robot(tmp_path)
    text = ROBOT.replace('"references.csv"', '"loads.csv"').replace('reference = { column = "r{axis}" }\n', "")
    own = '[joints.channels]\nload_position = { column = "load2" }\ntorque = { column = "tau2" }\n'
    (tmp_path / "robot.toml").write_text(text + own)
    t = 0.3 + np.arange(2000) * RATE
    write(tmp_path / "loads.csv", "t,load2", t, angle(t))
    one, two = load(tmp_path / "robot.toml").records()
    assert two.load_position is not None and one.torque is not None
    assert one.begin == two.begin == pytest.approx(0.3, abs=1e-9)
    at = one.begin + one.torque.time
    assert np.abs(one.torque.values - moment(at)).max() < 3.5 * (RATE / 2 + 1e-4)


@pytest.mark.parametrize("late", [0.3, 9.0])
def test_joints_of_files_of_their_own_begin_together(late: float, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    write_robot(tmp_path)
    text = ROBOT.replace('"positions.csv", "torques.csv", "references.csv"', '"one.csv", "two.csv"')
    text = text.replace('reference = { column = "r{axis}" }\n', "")
    (tmp_path / "robot.toml").write_text(text.replace("[record]", "[record]\noffsets = [0, 0]"))
    for number, (name, begin) in enumerate({"one": 0.0, "two": late}.items(), 1):
        t = begin + np.arange(3000) * RATE
        write(tmp_path / f"{name}.csv", f"t,q{number},tau{number}", t, angle(t), moment(t))
    if late > 6.0:
        with pytest.raises(RecordError, match="another joint begin 9 s later, by their own clocks"):
            load(tmp_path / "robot.toml").records()
        return
    for record in load(tmp_path / "robot.toml").records():
        assert record.begin == pytest.approx(late) and record.motor_position is not None
        at = record.begin + record.motor_position.time
        np.testing.assert_allclose(record.motor_position.values, angle(at), atol=1e-6)
