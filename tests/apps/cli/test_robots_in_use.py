"""A UR5-like arm in MuJoCo: identified once by the command, and used by all others from the file that was kept."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli.app import app
from jointid.estimation.robots.consistent import mass_matrix_at
from jointid.models.robots.robot import Robot
from tests.estimation.robots.twin import SAMPLE_TIME, motion
from tests.public_arms import real_arm, urdf_of

mujoco = pytest.importorskip("mujoco", reason="plays the arm, which is not installed")

HEAD = f"""
[robot]
model = "arm.urdf"
[record]
file = "first.csv"
sample_time = {SAMPLE_TIME}
[record.channels]
torque = {{ column = "tau{{axis}}" }}
motor_position = {{ column = "q{{axis}}" }}
reference = {{ column = "r{{axis}}" }}
"""


def run(*words: str | Path) -> None:
    app([str(word) for word in words], result_action="return_value")


def write_record(path: Path, arm: Robot, gains: np.ndarray, seed: int) -> None:
    """Write what an arm logs that MuJoCo moves along eight harmonics, from where it hangs in its controllers."""
    from tests.robots_mujoco import simulate_by_mujoco

    t, settling = np.arange(4500) * SAMPLE_TIME, 500
    references = motion(seed)[0][: t.size] * (1.0 - np.exp(-(t**3)))[:, np.newaxis]
    played = np.concatenate([np.tile(references[0], (settling, 1)), references])
    logged = simulate_by_mujoco(arm, gains, played, SAMPLE_TIME, references[0], 2e-4)
    torques, positions = (one[settling:] for one in logged)
    torques += 0.003 * torques.std(axis=0) * np.random.default_rng(seed).normal(size=torques.shape)
    names = [f"{one}{k}" for one in ("tau", "q", "r") for k in range(1, 7)]
    np.savetxt(path, np.hstack([torques, positions, references]), "%.12g", ",", header=",".join(names), comments="")


def torque_in_mujoco(path: Path, *parts: np.ndarray) -> np.ndarray:
    """Return the torques, (samples, n), that MuJoCo's inverse dynamics gives of a file."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.dof_solimp[:, :2] = 0.9999  # hard friction
    data, found = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*parts, strict=True):
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found)


@pytest.mark.slow
def test_an_arm_is_identified_once_and_used_by_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(urdf_of("ur5"), "utf-8")
    model = ji.robots.load_robot(str(tmp_path / "arm.urdf"))
    arm = real_arm(model, 11)
    gains = np.outer(np.diag(mass_matrix_at(arm, np.zeros(6))) + arm.of_joints("rotor_inertia"), (40.0**2, 40.0))
    text = HEAD
    for name, (position, derivative) in zip(arm.names, gains.tolist(), strict=True):
        text += f'[[joints]]\nname = "{name}"\n[joints.controller]\nlaw = "pd"\n'
        text += f"position_gain = {position}\nderivative_gain = {derivative}\n"
    robot, kept, first, other = (tmp_path / name for name in ("robot.toml", "kept.json", "first.csv", "other.csv"))
    robot.write_text(text, "utf-8")
    held_out = tmp_path / "held_out.json"
    for path, seed, found in ((first, 1, kept), (other, 2, held_out)):
        write_record(path, arm, gains, seed)
        run("identify", robot, "--record", path, "--json", found)
    file = ji.load(robot)
    estimate = ji.load_estimate(kept, file)
    q, v, a = (one[::50] for one in motion(3))
    torque = estimate.torque(q, v, a)

    moving = np.abs(v) > 0.15  # MuJoCo's friction is soft below

    def share_off(values: np.ndarray) -> float:
        each = np.linalg.norm((values - torque) * moving, axis=0) / np.linalg.norm(torque, axis=0)
        return float(each.max())

    assert share_off(ji.load_estimate(held_out, file).torque(q, v, a)) < 2e-3

    simulated, validated, page = (tmp_path / name for name in ("simulated.csv", "validated.json", "report.html"))
    run("simulate", robot, "--estimate", kept, "--record", other, "--out", simulated)
    read = [np.genfromtxt(path, delimiter=",", names=True) for path in (simulated, other)]
    ours, theirs = (np.column_stack([one[f"tau{k}"] for k in range(1, 7)]) for one in read)
    assert np.all(np.std(ours - theirs, axis=0) < 0.03 * np.std(theirs, axis=0))
    at = np.column_stack([read[0][f"q{k}"] for k in range(1, 7)])
    speed = np.gradient(at, SAMPLE_TIME, axis=0)
    asked = estimate.torque(at, speed, np.gradient(speed, SAMPLE_TIME, axis=0))[2:-2]
    mean = 0.5 * (ours[2:-2] + ours[1:-3])  # a torque is held until the next sample
    assert np.all(np.median(np.abs(mean - asked), axis=0) < 1e-4 * ours.std(axis=0))

    run("validate", robot, "--estimate", kept, "--record", other, "--json", validated)
    assert json.loads(validated.read_text("utf-8"))["answer"]["code"] == "predicted"
    run("report", robot, "--estimate", kept, "--held-out", other, "--html", page)
    capsys.readouterr()
    run("compare", page, held_out, "--json", tmp_path / "compared.json")
    said = capsys.readouterr().out
    assert said.startswith("None of 58 quantities changed significantly") and re.search(r"^Izz1 +3\.", said, re.M)
    names = [row["name"] for row in json.loads((tmp_path / "compared.json").read_text("utf-8"))["rows"]]
    assert any(" with " in name for name in names) and not any("e-" in name for name in names)

    def export(ending: str) -> tuple[Path, list[str]]:
        path = tmp_path / f"found.{ending}"
        run("export", robot, "--estimate", kept, "--out", path)
        return path, re.findall("^lost in \\w+: (.*)$", capsys.readouterr().out, re.M)

    offsets = np.array([estimate.values[f"{name}.offset"] for name in arm.names])
    found, lost = export("xml")
    assert lost == ["the constant parts of the motors' torques"]
    assert share_off(torque_in_mujoco(found, q, v, a) + offsets) < 2e-4
    rotors = ji.robots.load_robot(str(found)).of_joints("rotor_inertia")
    found, lost = export("urdf")
    assert lost == ["the constant parts of the motors' torques", "the rotors' inertias"]
    assert share_off(torque_in_mujoco(found, q, v, a) + offsets + rotors * a) < 2e-4
