"""Files of a designed test: columns, units, sides, the record of the file, and drives that inject nothing."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.config import load, loads
from jointid.records.formats import read_table
from tests.models.robots.trees import inverse_dynamics
from tests.rigid_axis import run
from tests.robots_plants import six, two

JOINT = """
[[joints]]
name = "{name}"
torque_constant = 0.1
transmission = {{ ratio = {ratio} }}
limits = {{ lower = -0.9, upper = 0.9, speed = 1.5, acceleration = 5.0 }}
"""
ROBOT = """
[robot]
model = "arm.xml"
[record]
file = "log.csv"
time = "t"
[record.channels]
torque = { column = "i{axis}", unit = "A", timing = "sampled" }
motor_position = { column = "q{axis}", unit = "deg" }
""" + "".join(JOINT.format(name=name, ratio=ratio) for name, ratio in (("joint1", 100.0), ("joint2", 50.0)))
FRICTION = np.array([6.0, 2.5])  # N m of load, that the file does not state
NOISE = np.array([0.05, 0.03])


def played(robot: ji.robots.Robot, q: np.ndarray, seed: int) -> np.ndarray:
    """Return what the motors give for a motion, N m of load, with friction that no file states, and noise."""
    v = np.gradient(q, 1e-3, axis=0)
    torque = inverse_dynamics(robot.tree, robot.inertials, q, v, np.gradient(v, 1e-3, axis=0))
    torque += FRICTION * np.sign(v) + np.array([2.0, 1.0]) * v
    return np.asarray(torque + NOISE * np.random.default_rng(seed).normal(size=q.shape))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot file, its model and its record."""
    folder = tmp_path_factory.mktemp("arm")
    joints = tuple(replace(one, rotor_inertia=0.0, viscous=0.0, coulomb=0.0) for one in two().robot.joints)
    (folder / "arm.xml").write_text(ji.export(replace(two().robot, joints=joints), "mjcf").text, encoding="utf-8")
    (folder / "robot.toml").write_text(ROBOT, encoding="utf-8")
    robot: ji.robots.Robot = load(folder / "robot.toml").robot
    t = np.arange(3000) * 1e-3
    q = np.column_stack([0.5 * np.sin(2.1 * t) + 0.2 * np.sin(5.3 * t), 0.5 * np.sin(3.2 * t) - 0.2 * np.cos(4.4 * t)])
    ratios = np.array([100.0, 50.0])
    current, turned = played(robot, q, 1) / (ratios * 0.1), np.degrees(q * ratios)
    table = np.column_stack([t, current, turned])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,i1,i2,q1,q2", comments="")
    return folder


def test_a_robot_is_planned_from_the_record_of_its_file_and_played_in_its_units(folder: Path, tmp_path: Path) -> None:
    out, answer = tmp_path / "out", tmp_path / "a.json"
    assert run("design", folder / "robot.toml", "-q", "--search-time", "0.5", "--out", out, "--json", answer) == 0
    told = json.loads(answer.read_text(encoding="utf-8"))
    columns = read_table(out / "test.csv").columns
    assert list(columns) == ["t", "joint1.reference", "joint2.reference"]
    ratios = np.array([100.0, 50.0])
    q = np.radians(np.column_stack([columns["joint1.reference"], columns["joint2.reference"]])) / ratios
    assert 0.5 < np.abs(q).max() < 0.9, "degrees of the motor"
    robot: ji.robots.Robot = load(folder / "robot.toml").robot
    peaks = np.abs(played(robot, q, 2)).max(axis=0)
    stated = np.array([axis["reached"]["torque"] for axis in told["axes"]])
    assert np.all(np.abs(np.log(peaks / stated)) < math.log(1.1)), "friction is in the predicted torque"
    assert "present" in told["tests"], "the file's own record is used"


JOINT_FILE = """
[joint]
kind = "revolute"
torque_constant = 0.5
[transmission]
ratio = 20.0
[record.channels]
torque = { column = "current", unit = "A" }
reference = { column = "demand", unit = "deg" }
[controller]
law = "cascade"
position_gain = 40.0
velocity_gain = 2.0
"""


@pytest.mark.slow
def test_a_joints_test_is_in_the_words_of_its_file(tmp_path: Path) -> None:
    file = loads(JOINT_FILE)
    assert file.loop is not None
    values = {"inertia": 2.0, "viscous": 4.0, "coulomb": 1.0, "offset": 0.0}
    limits = ji.AxisLimits(stroke=1.0, speed=2.0, acceleration=10.0, torque=60.0)
    asked = {"values": values, "noise": {"log": 0.05}, "limits": limits, "duration": 3.0, "sample_time": 1e-3}
    found = file.lay_out(ji.design(file.loop, injection=False, search_time=0.5, **asked))
    (record,) = found.records()
    assert record.injected is None and "on the torque" not in found.description, "the drive adds nothing"
    found.write(tmp_path)
    columns, reference = read_table(tmp_path / "test.csv").columns, record.reference
    assert reference is not None and list(columns) == ["t", "demand"]
    np.testing.assert_allclose(columns["demand"], np.degrees(20.0 * reference.values), atol=1e-9)
    again = file.record(tmp_path / "test.csv", driving=True).reference
    np.testing.assert_allclose(again.values, reference.values, atol=1e-12)
    both = file.lay_out(ji.design(file.loop, search_time=1.0, **asked))
    assert both.records()[0].injected is not None, "with a signal it tells more"
    assert "trajectory.yaml" not in both.files()
    both.write(tmp_path)
    columns = read_table(tmp_path / "test.csv").columns
    injected = both.records()[0].injected
    np.testing.assert_allclose(columns["injected"], injected.channel.values / 10.0, atol=1e-9)
    known = "[parameters]\n" + "".join(f"{name} = {{ start = {value} }}\n" for name, value in values.items())
    (tmp_path / "joint.toml").write_text(JOINT_FILE + known, encoding="utf-8")
    played = ("--record", tmp_path / "test.csv", "--out", tmp_path / "played.csv")
    assert run("simulate", tmp_path / "joint.toml", *played) == 0
    peak = np.abs(read_table(tmp_path / "played.csv").columns["current"]).max()
    assert 10.0 * peak == pytest.approx(both.axes[0].reached["torque"], rel=0.05), "A of the motor"


def test_a_motion_is_written_as_robots_play_it() -> None:
    twin, period = six(), 2e-3
    joints = (*twin.robot.joints[:-1], replace(twin.robot.joints[-1], coupling={"joint5": 0.5}))
    robot = replace(twin.robot, joints=joints)
    q = twin.home + 0.3 * np.sin(np.outer(period * np.arange(1000), np.arange(1, 7)))
    driven = [ji.Record(reference=ji.Channel(one, "rad", period)) for one in (q @ robot.coupling.T).T.copy()]
    found = ji.design(robot, limits=[ji.AxisLimits()] * 6, noise=[0.1] * 6, motion=driven)
    lines = found.files()["trajectory.yaml"].decode().splitlines()
    assert json.loads(lines[0].removeprefix("joint_names: ")) == list(robot.names)
    rows = np.array([json.loads(one.removeprefix("- positions: ")) for one in lines if one.startswith("- positions")])
    ends = [re.findall(r"\d+", one) for one in lines if "time_from_start" in one]
    at = np.array([int(seconds) + 1e-9 * int(rest) for seconds, rest in ends])
    np.testing.assert_allclose(rows, twin.home + 0.3 * np.sin(np.outer(at, np.arange(1, 7))), atol=1e-3)
    assert at[-1] == pytest.approx(1.998) and 50 < len(at) < 1000
