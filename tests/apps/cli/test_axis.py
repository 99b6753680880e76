"""One joint of a robot file, taken alone by --axis: what the commands of a joint file do with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import JointFileError, MethodError
from jointid.config import load
from jointid.controller_id.structures import Structure
from tests.learned_once import find_law
from tests.rigid_axis import call as run

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")

TRUTH = {"inertia": 0.8, "viscous": 2.0, "coulomb": 1.5, "offset": 0.3}
GAINS = {"position_gain": 20.0, "velocity_gain": 12.0}
MODEL = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body><joint name="base" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.8 0.8 0.8"/>
<body><joint name="wrist" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body>
</worldbody></mujoco>"""
ROBOT = """
[robot]
model = "arm.xml"
[record]
file = "log.csv"
sample_time = 0.001
[record.channels]
torque = { column = "tau{axis}" }
reference = { column = "r{axis}" }
motor_position = { column = "q{axis}" }
[[joints]]
name = "base"
[joints.controller]
law = "cascade"
position_gain = 20.0
velocity_gain = 12.0
[[joints]]
name = "wrist"
[joints.controller]
law = "cascade"
position_gain = 20.0
velocity_gain = 12.0
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot whose first joint moved while the second rested."""
    place = tmp_path_factory.mktemp("axis")
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), ji.controller.Cascade(**GAINS))
    reference = ji.excitation.trapezoids((0.5, 1.0, 2.0), 8.0, 1.0, 1e-3, duration=6.0)
    record = ji.simulated_record(loop, reference, TRUTH, sample_time=1e-3)
    assert record.torque and record.reference and record.motor_position
    moved = np.column_stack([one.values for one in (record.torque, record.reference, record.motor_position)])
    columns = np.hstack([moved, np.zeros_like(moved)])
    np.savetxt(place / "log.csv", columns, "%.12g", ",", header="tau1,r1,q1,tau2,r2,q2", comments="")
    (place / "arm.xml").write_text(MODEL, encoding="utf-8")
    (place / "robot.toml").write_text(ROBOT, encoding="utf-8")
    return place / "robot.toml"


def test_commands_of_one_joint(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    find_law(monkeypatch, Structure(), {"position_gain": 18.0, "velocity_gain": 13.0})
    found = tmp_path / "found.json"
    axis, by_torque = ("--axis", "base"), ("--set", "method.name=didim")
    run("identify", robot, *axis, *by_torque, "--json", found)
    answer = json.loads(found.read_text(encoding="utf-8"))["parameters"]
    values = {name: row["value"] for name, row in answer.items()}
    assert {name: values[name] for name in TRUTH} == pytest.approx(TRUTH, rel=1e-6)
    assert run("diagnose", robot, *axis) == 0
    run("learn-controller", robot, *axis)
    printed = capsys.readouterr().out
    assert "position_gain = 20.00000" in printed and "velocity_gain = 1" in printed
    run("tune", robot, *axis)
    run("simulate", robot, *axis, "--estimate", found, "--out", tmp_path / "base.csv")
    assert "tau1" in (tmp_path / "base.csv").read_text(encoding="utf-8").partition("\n")[0]


def test_the_method_of_one_joint_is_set_as_of_a_joint_file(robot: Path) -> None:
    didim = load(robot, ["method.name=didim", "method.tolerance=1e-3"], axis="base").method
    assert didim == ji.DIDIM(tolerance=1e-3)
    changed = ['joints.1.method={name="idim",estimator="ols"}']
    assert load(robot, changed, axis="base").method == ji.IDIM(estimator="ols")
    assert load(robot, changed).method == ji.IDIM()
    assert load(robot, ["joint.friction=asymmetric"], axis="base").joint.friction.name == "asymmetric"
    with pytest.raises(JointFileError, match=r"joints\.1\.method\.frequency"):
        load(robot, ["method.frequency=30.0"], axis="base")
    with pytest.raises(JointFileError, match=r"method\.fixed"):
        load(robot, ["method.fixed={a=1.0}"], axis="base")


@pytest.mark.slow
def test_a_report_of_one_joint_is_repeated_for_that_joint(robot: Path, tmp_path: Path) -> None:
    run("report", robot, "--axis", "base", "--html", tmp_path / "report.html", "--no-profiles", "--no-tuning")
    assert "--record log.csv --axis base" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_joint_that_is_not_there(robot: Path) -> None:
    with pytest.raises(MethodError, match='The axis is "elbow"; expected "base" or "wrist"'):
        run("tune", robot, "--axis", "elbow")
    with pytest.raises(MethodError, match=r"takes one joint, .*; name one of its joints by --axis\."):
        run("tune", robot)
    with pytest.raises(MethodError, match=r"--write is for a joint file; write the learned \[controller\]"):
        run("learn-controller", robot, "--axis", "base", "--write", robot.parent / "new.toml")
