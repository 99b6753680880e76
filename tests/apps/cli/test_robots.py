"""The commands with a robot file: identify, validate, export."""

import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
import jointid.diagnostics.identify as verb
from jointid.config import File, load
from jointid.controller_id.structures import Structure
from jointid.models.robots.inertial import MassProperties
from tests.estimation.robots.twin import arm, records_of, with_payload
from tests.learned_once import find_law
from tests.rigid_axis import call as run

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")

HEAD = """
[robot]
model = "arm.xml"
[record]
file = "one.csv"
sample_time = 0.002
[record.channels]
torque = { column = "tau{axis}" }
motor_position = { column = "q{axis}" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("robot"), arm(3))


def write_robot(place: Path, truth: ji.robots.Robot) -> Path:
    """Write records of a robot, and its file, whose nominal links are a fifth too heavy."""
    count = range(1, len(truth) + 1)
    links = tuple(replace(link, inertial=1.2 * link.inertial) for link in truth.links)
    joints = tuple(replace(joint, offset=0.0) for joint in truth.joints)
    (place / "arm.xml").write_text(ji.export(replace(truth, links=links, joints=joints), "mjcf").text, encoding="utf-8")
    text = HEAD + "".join(f'[[joints]]\nname = "joint{k}"\n' for k in count)
    (place / "robot.toml").write_text(text, encoding="utf-8")
    carrying = with_payload(truth, MassProperties(3.0, np.array([0.02, -0.03, 0.08]), 0.01 * np.eye(3)).inertial)
    for name, seed, robot in (("one.csv", 2, truth), ("two.csv", 9, truth), ("loaded.csv", 12, carrying)):
        records = records_of(robot, seed, noise=0.2)
        columns = [channel.values for r in records for channel in (r.torque, r.motor_position) if channel is not None]
        header = ",".join(f"tau{k},q{k}" for k in count)
        np.savetxt(place / name, np.column_stack(columns), fmt="%.9g", delimiter=",", header=header, comments="")
    return place


@pytest.mark.slow
def test_an_estimate_is_taken_by_every_command(folder: Path, tmp_path: Path) -> None:
    joint, found, other = folder / "robot.toml", tmp_path / "found.json", tmp_path / "other.json"
    figure = tmp_path / "torque.svg"
    for record, kept in (("one.csv", found), ("two.csv", other)):
        run("identify", joint, "--record", folder / record, "--json", kept, "--details", "--figure", figure)
    assert all(f"joint{k}" in figure.read_text(encoding="utf-8") for k in range(1, 4))
    answer = json.loads(found.read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Estimate/2" and len(answer["parameters"]) == 25
    assert answer["parameters"]["joint2.viscous"]["value"] == pytest.approx(8.0, rel=0.01)
    run("validate", joint, "--record", folder / "two.csv", "--json", tmp_path / "seen.json")
    seen = json.loads((tmp_path / "seen.json").read_text("utf-8"))
    assert seen["answer"]["code"] == "predicted" and all(one["nominal_error"] for one in seen["axes"])
    run("compare", found, other, "--json", tmp_path / "compared.json")
    rows = {row["name"]: row for row in json.loads((tmp_path / "compared.json").read_text("utf-8"))["rows"]}
    assert rows["joint2.viscous"]["p_value"] > 0.01
    run("diagnose", joint, "--json", tmp_path / "cause.json")
    answer = json.loads((tmp_path / "cause.json").read_text(encoding="utf-8"))
    assert answer["explained"] and answer["as_declared"] is None
    run("export", joint, "--out", tmp_path / "saved.urdf")
    run("export", joint, "--again", "--out", tmp_path / "anew.urdf")
    assert (tmp_path / "saved.urdf").read_text("utf-8") == (tmp_path / "anew.urdf").read_text("utf-8")


@pytest.mark.slow
def test_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search = Mock(side_effect=verb.fit_records)
    monkeypatch.setattr(verb, "fit_records", search)
    folder = tmp_path / "robot"
    folder.mkdir()
    write_robot(folder, arm(2))
    page, other = tmp_path / "arm.html", folder / "two.csv"
    places = ("--html", page, "--json", tmp_path / "found.json")
    run("identify", folder / "robot.toml", "--no-checks")
    run("report", folder / "robot.toml", "--held-out", other, *places)
    run("diagnose", folder / "robot.toml")
    assert search.call_count == 1
    text = page.read_text(encoding="utf-8")
    assert "Content-Security-Policy" in text
    assert f"--held-out {other.name}" in text and "Its SHA-256" in text
    answer = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    check = answer["checks"][0]
    assert answer["schema"] == "jointid.Report/2" and check["nominal_error"] > check["filtered_error"]
    assert answer["estimate"]["parameters"] and answer["diagnosis"]["axes"] and answer["record_file"] == "one.csv"


@pytest.mark.slow
def test_payload(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_robot(tmp_path, arm())
    joint, found = folder / "robot.toml", tmp_path / "found.json"
    records = "--without", folder / "one.csv", "--with", folder / "loaded.csv"
    run("payload", joint, *records, "--json", found)
    said = " ".join(capsys.readouterr().out.split())
    assert re.match(r"The payload weighs 3\.0\d* ± [\d.]+ kg, 2 sigma, with its centre at \(.*\) m of link6\. ", said)
    answer = json.loads(found.read_text(encoding="utf-8"))
    mass = answer["rows"]["mass"]
    assert answer["link"] == "link6" and mass["unit"] == "kg"
    assert mass["value"] == pytest.approx(3.0, rel=0.01)
    run("payload", joint, *records[2:], "--json", found)  # the file's own record is without
    alone = json.loads(found.read_text(encoding="utf-8"))["rows"]["mass"]
    assert (alone["value"], alone["std"]) == pytest.approx((mass["value"], mass["std"]), rel=1e-3)
    (kept := folder / "kept.toml").write_text(joint.read_text("utf-8") + "parameters.viscous.value = 3.0\n", "utf-8")
    for file, *more in ((kept,), (joint, "--axis", "joint1"), (joint, "--record", folder / "one.csv")):
        with pytest.raises(ji.MethodError):
            run("payload", file, *records, *more)


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "--record", "a.csv", "--record", "b.csv", "--figure", "a.png"),
        ("simulate", "--identified", "--axis", "none"),
        ("tune",),
        ("diagnose", "--laws"),
        ("validate",),
        ("report", "--held-out", "nope.csv", "--html", "page.html"),
    ],
)
def test_what_a_robot_has_not_is_refused_before_it_identifies(
    words: tuple[str, ...], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(File, "identify", None)
    with pytest.raises(ji.JointidError):
        run(words[0], folder / "robot.toml", *words[1:])


TRUTH = {"inertia": 0.8, "viscous": 2.0, "coulomb": 1.5, "offset": 0.3}
GAINS = {"position_gain": 20.0, "velocity_gain": 12.0}
MODEL = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body><joint name="base" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.8 0.8 0.8"/>
<body><joint name="wrist" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body>
</worldbody></mujoco>"""
CONTROLLER = '[joints.controller]\nlaw = "cascade"\nposition_gain = 20.0\nvelocity_gain = 12.0\n'
ROBOT = HEAD.replace("one.csv", "log.csv").replace("0.002", "0.001") + 'reference = { column = "r{axis}" }\n'
ROBOT += "".join(f'[[joints]]\nname = "{name}"\n{CONTROLLER}' for name in ("base", "wrist"))


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


@pytest.mark.slow
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
    run("simulate", robot, *axis, *by_torque, "--identified", "--out", tmp_path / "base.csv")
    assert "tau1" in (tmp_path / "base.csv").read_text(encoding="utf-8").partition("\n")[0]


def test_the_method_of_one_joint_is_set_as_of_a_joint_file(robot: Path) -> None:
    didim = load(robot, ["method.name=didim", "method.tolerance=1e-3"], axis="base").method
    assert didim == ji.DIDIM(tolerance=1e-3)
    changed = ['joints.1.method={name="idim",estimator="ols"}']
    assert load(robot, changed, axis="base").method == ji.IDIM(estimator="ols")
    assert load(robot, changed).method == ji.IDIM()
    assert load(robot, ["joint.friction=asymmetric"], axis="base").joint.friction.name == "asymmetric"
    with pytest.raises(ji.JointFileError, match=r"joints\.1\.method\.frequency"):
        load(robot, ["method.frequency=30.0"], axis="base")
    with pytest.raises(ji.JointFileError, match=r"method\.fixed"):
        load(robot, ["method.fixed={a=1.0}"], axis="base")


@pytest.mark.slow
def test_a_report_of_one_joint_is_repeated_for_that_joint(robot: Path, tmp_path: Path) -> None:
    run("report", robot, "--axis", "base", "--html", tmp_path / "report.html", "--no-profiles", "--no-tuning")
    assert "--record log.csv --axis base" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_joint_that_is_not_there(robot: Path) -> None:
    for words in (
        ("tune", "--axis", "elbow"),
        ("tune",),
        ("learn-controller", "--axis", "base", "--write", "new.toml"),
    ):
        with pytest.raises(ji.MethodError):
            run(words[0], robot, *words[1:])
