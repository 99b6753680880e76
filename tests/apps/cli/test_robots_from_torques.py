"""A robot file with controllers: simulated, and identified from torques and references alone, by the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.output.export import export
from tests.rigid_axis import call as run
from tests.robots_plants import Twin, two

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


def write_files(place: Path, twin: Twin, seconds: float) -> None:
    """Write the robot's model, its file with controllers and friction, and references in the place of a record."""
    rigid = tuple(replace(joint, spring=None) for joint in twin.robot.joints)
    model = replace(twin.robot, joints=rigid)
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
        columns = [r.reference.values for r in twin.records(seconds, seed) if r.reference]
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
