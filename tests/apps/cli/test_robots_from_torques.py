"""A robot file with controllers: simulated, and identified from torques and references alone, by the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli.app import app
from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.models.robots.dynamics import inverse_dynamics
from jointid.models.robots.inertial import MassProperties
from jointid.output.export import export
from tests.estimation.robots.twin import with_payload
from tests.robots_plants import Twin, six, two

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")

HEAD = """
[robot]
model = "robot.xml"
[record]
file = "references.csv"
sample_time = 0.001
[record.channels]
torque = { column = "tau{axis}" }
reference = { column = "r{axis}" }
"""


def run(*words: str | Path) -> None:
    app([str(word) for word in words], result_action="return_value")


def write_files(place: Path, twin: Twin, seconds: float, multisine: float = 0.0, heavier: float = 1.0) -> None:
    """Write the robot's model, its file with controllers and friction, and references in the place of a record."""
    links = tuple(replace(link, inertial=heavier * link.inertial) for link in twin.robot.links)
    rigid = tuple(replace(joint, spring=None) for joint in twin.robot.joints)
    model = replace(twin.robot, links=links, joints=rigid)
    (place / "robot.xml").write_text(export(model, "mjcf").text, encoding="utf-8")
    text = HEAD
    for joint, controller in zip(twin.robot.joints, twin.loop().controllers, strict=True):
        numbers = [f"{name} = {float(getattr(joint, name))!r}" for name in ("rotor_inertia", "viscous", "coulomb")]
        text += f'[[joints]]\nname = "{joint.name}"\n' + "\n".join(numbers) + "\n"
        if joint.spring is not None:
            own = [
                f"{key} = {float(getattr(joint.spring, key))!r}"
                for key in ("stiffness", "damping", "viscous", "coulomb")
            ]
            text += "[joints.spring]\n" + "\n".join(own) + "\n"
        given = {key: float(getattr(controller, key)) for key in ("position_gain", "derivative_gain")}
        gains = "".join(f"{key} = {value!r}\n" for key, value in given.items())
        text += f'[joints.controller]\nlaw = "pd"\n{gains}'
    (place / "robot.toml").write_text(text, encoding="utf-8")
    for name, seed in (("references.csv", 1), ("others.csv", 4)):
        columns = [r.reference.values for r in twin.records(seconds, seed, multisine=multisine) if r.reference]
        header = ",".join(f"r{k}" for k in range(1, len(columns) + 1))
        np.savetxt(place / name, np.column_stack(columns), fmt="%.12g", delimiter=",", header=header, comments="")


def logged(place: Path, name: str, sigma: float, seed: int) -> Path:
    """Add noise to the torques of a simulated file, as a share of each one's rms."""
    path = place / name
    header = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    rng = np.random.default_rng(seed)
    for k, column in enumerate(header):
        if column.startswith("tau"):
            table[:, k] += sigma * np.std(table[:, k]) * rng.normal(size=len(table))
    np.savetxt(path, table, fmt="%.12g", delimiter=",", header=",".join(header), comments="")
    return path


def needed(robot: ji.Robot) -> np.ndarray:
    """Return the torques of random motions, (motions, n), friction apart."""
    q, v, a = np.random.default_rng(2).normal(size=(3, 50, len(robot)))
    return inverse_dynamics(robot.tree, robot.inertials, q, v, a) + robot.of_joints("rotor_inertia") * a


@pytest.mark.slow
def test_rigid_joints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_files(tmp_path, two(), 4.0)
    joint, truth = tmp_path / "robot.toml", two().robot.joints
    for name, of in (("one.csv", "references.csv"), ("two.csv", "others.csv")):
        run("simulate", joint, "--record", tmp_path / of, "--out", tmp_path / name)
        logged(tmp_path, name, 0.01, 3)
    # The model that it is held beside is a fifth too heavy.
    write_files(tmp_path, two(), 4.0, heavier=1.2)
    one, two_ = tmp_path / "one.csv", tmp_path / "two.csv"
    run("identify", joint, "--record", one, "--json", tmp_path / "found.json")
    answer = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Estimate/2" and answer["fit"]["converged"]
    units = {name: row["unit"] for name, row in answer["parameters"].items()}
    assert units["mx2"] == "kg m" and units["Iyy2"] == "kg m2"
    for one_joint in truth:
        for word in ("viscous", "coulomb"):
            row = answer["parameters"][f"{one_joint.name}.{word}"]
            assert abs(row["value"] - getattr(one_joint, word)) < 4 * row["stderr"], (one_joint.name, word)
    # A model without friction is no opponent: it has the friction that was found.
    lines = joint.read_text(encoding="utf-8").splitlines()
    lines = [f"{line.split()[0]} = 0.0" if line.startswith(("viscous", "coulomb")) else line for line in lines]
    bare = tmp_path / "bare.toml"
    bare.write_text("\n".join(lines), encoding="utf-8")
    run("identify", bare, "--record", one, "--json", tmp_path / "bare.json")
    bare_answer = json.loads((tmp_path / "bare.json").read_text(encoding="utf-8"))
    assert bare_answer["robot"]["nominal_errors"] == pytest.approx(answer["robot"]["nominal_errors"], rel=1e-3)
    run("validate", joint, "--set", 'record.file="one.csv"', "--record", two_)
    said = " ".join(capsys.readouterr().out.split())
    assert "The estimate predicts this record better than the nominal model" in said
    run("export", joint, "--set", 'record.file="one.csv"', "--out", tmp_path / "found.xml")
    assert "the mass matrix is positive in 1000 random poses" in " ".join(capsys.readouterr().out.split())
    found, true = (needed(ji.robots.load_robot(tmp_path / "found.xml")), needed(two().robot))
    assert np.all(np.linalg.norm(found - true, axis=0) < 0.02 * np.linalg.norm(true, axis=0))


def test_a_joint_without_gains_falls_and_that_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_files(tmp_path, two(), 2.0)
    joint, found = tmp_path / "robot.toml", tmp_path / "found.json"
    run("simulate", joint, "--json", found)
    assert "does not follow" not in capsys.readouterr().out
    answer = json.loads(found.read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Simulation/2" and answer["outcome"] == "finished"
    assert answer["samples"] == 2000 and len(answer["peak_torque"]) == 2 and answer["strays"] == {}
    lines = joint.read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("position_gain"))
    last = next(i for i, line in enumerate(lines) if i > first and line.startswith("position_gain"))
    lines[last : last + 2] = ["position_gain = 0.0", "derivative_gain = 0.0"]
    joint.write_text("\n".join(lines), encoding="utf-8")
    run("simulate", joint, "--json", found)
    assert "joint2 does not follow its reference: it gets " in capsys.readouterr().out
    assert list(json.loads(found.read_text(encoding="utf-8"))["strays"]) == ["joint2"]


@pytest.mark.slow
def test_a_test_is_planned_and_played(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_files(tmp_path, two(), 3.0)
    joint, out = tmp_path / "robot.toml", tmp_path / "test"
    with pytest.raises(RecordError, match="torque"):  # no limits, so that a first record is asked, which has no torque
        run("design", joint, "--search-time", "1")
    limits = "limits = { lower = -1.0, upper = 1.0, speed = 2.0, torque = 60.0 }\n"
    text = joint.read_text(encoding="utf-8").replace("[[joints]]\n", f"[[joints]]\n{limits}")
    joint.write_text(text, encoding="utf-8")
    run("design", joint, "--search-time", "0.3", "--duration", "4", "--out", out, "--json", tmp_path / "a.json")
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Design/2" and "1 % of each joint" in answer["noise"]
    assert answer["axes"][0]["reached"]["upper"] < 1.0 and not answer["passed"]
    run("simulate", joint, "--record", out / "test.csv", "--out", tmp_path / "log.csv")
    run("design", joint, "--motion", out / "test.csv", "--record", tmp_path / "log.csv", "--json", tmp_path / "b.json")
    assert "residual" in json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["noise"]
    fast = np.array([0.4, 0.3]) * (1 - np.cos(np.outer(1e-3 * np.arange(4000), [3.0, 4.6])))
    np.savetxt(tmp_path / "fast.csv", fast, delimiter=",", header="r1,r2", comments="")
    asked = ("--motion", tmp_path / "fast.csv", "--within", "60")
    run("design", joint, *asked, "--json", tmp_path / "b.json")
    wide = json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))
    worst, own = wide["tests"]["at worst"]["std"], wide["tests"]["proposed"]["std"]
    assert max(worst[name] / std for name, std in own.items()) > 1.05


def test_a_payload_is_weighed_by_didim(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, payload = six(), MassProperties(3.0, np.array([0.02, -0.03, 0.08]), 0.01 * np.eye(3)).inertial
    joint = tmp_path / "robot.toml"
    for twin, of, name in (
        (replace(truth, robot=with_payload(truth.robot, payload)), "others.csv", "with.csv"),
        (truth, "references.csv", "without.csv"),
    ):
        write_files(tmp_path, twin, 2.5)
        run("simulate", joint, "--record", tmp_path / of, "--out", tmp_path / name)
        logged(tmp_path, name, 0.01, 3)
    records = ("--without", tmp_path / "without.csv", "--with", tmp_path / "with.csv")
    capsys.readouterr()
    run("payload", joint, *records, "--json", tmp_path / "found.json", "--quiet")
    answer = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Payload/2"
    mass = answer["rows"]["mass"]
    assert abs(mass["value"] - 3.0) < 4 * mass["std"] < 0.02
    assert f"The payload weighs {mass['value']:.4f}" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_controllers_are_judged_beside_the_feed_forward_that_the_file_computes(tmp_path: Path) -> None:
    write_files(tmp_path, two(), 2.0)
    joint, one, page = tmp_path / "robot.toml", tmp_path / "one.csv", tmp_path / "page.html"
    text = joint.read_text(encoding="utf-8").replace("[robot]", '[robot]\nfeed_forward = "gravity"', 1)
    text = text.replace("[record.channels]", '[record.channels]\nmotor_position = { column = "q{axis}" }')
    joint.write_text(text, encoding="utf-8")
    run("simulate", joint, "--out", one)
    run("diagnose", joint, "--record", one, "--json", tmp_path / "said.json")
    said = json.loads((tmp_path / "said.json").read_text(encoding="utf-8"))["diagnosis"]
    assert said["method"] == "idim" and said["as_declared"] is True
    run("report", joint, "--record", one, "--html", page, "--json", tmp_path / "report.json")
    told = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert told["diagnosis"]["as_declared"] is True


def measured_alone(tmp_path: Path) -> Twin:
    """Write records with motor positions of a twin, and its file with springs and without controllers."""
    twin = two((12.0, 18.0))
    write_files(tmp_path, twin, 3.0, multisine=0.004)
    joint = tmp_path / "robot.toml"
    text = joint.read_text(encoding="utf-8")
    measured = text.replace("[record.channels]", '[record.channels]\nmotor_position = { column = "q{axis}" }')
    joint.write_text(measured, encoding="utf-8")
    for name, of in (("one.csv", "references.csv"), ("two.csv", "others.csv")):
        run("simulate", joint, "--record", tmp_path / of, "--out", tmp_path / name)
        logged(tmp_path, name, 0.01, 7)
    alone = measured.replace('reference = { column = "r{axis}" }\n', "")
    alone = "\n".join(
        line
        for line in alone.splitlines()
        if not line.startswith(("[joints.controller]", "law", "position_gain", "deriv"))
    )
    joint.write_text(alone, encoding="utf-8")
    return twin


@pytest.mark.slow
def test_the_drive_side_of_flexible_joints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With motor positions in the file, and springs, and no controllers at all once the records are there."""
    twin, joint = measured_alone(tmp_path), tmp_path / "robot.toml"
    capsys.readouterr()
    one, two_, found = tmp_path / "one.csv", tmp_path / "two.csv", tmp_path / "found.json"
    near = "method.frequencies={joint1=13.0,joint2=20.0}"
    run("identify", joint, "--record", one, "--set", near, "--json", found)
    printed = " ".join(capsys.readouterr().out.split())
    assert "drive side of a robot, from motor torques and motor positions, of springs, rotors and links" in printed
    answer = json.loads(found.read_text(encoding="utf-8"))
    for one_joint in twin.robot.joints:
        assert one_joint.spring is not None
        row = answer["parameters"][f"{one_joint.name}.stiffness"]
        assert row["value"] == pytest.approx(one_joint.spring.stiffness, rel=0.02)
    run("validate", joint, "--set", 'record.file="one.csv"', "--set", near, "--record", two_)
    assert "nominal model" in capsys.readouterr().out
    capsys.readouterr()
    stated = "record.channels.torque.timing=held"
    run("identify", joint, "--record", one, "--set", near, "--set", "method.log_delay=0.0", "--set", stated)
    assert "log_delay" not in capsys.readouterr().out
    with pytest.raises(MethodError, match="This robot does not tell all of a payload"):
        run("payload", joint, "--without", one, "--with", two_)
    with pytest.raises(JointFileError, match='iterations is not for the method "drive_side": leave it out, or use'):
        run("identify", joint, "--record", one, "--set", "method.iterations=3")
    with pytest.raises(MethodError, match="under its controllers; without one: joint1, joint2"):
        run("design", joint, "--record", one)
