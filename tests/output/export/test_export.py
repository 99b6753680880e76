"""The verb and the command: which language, which side, whose answer; the joint file, which is read again by us."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import jointid as ji
from jointid.config import loads
from jointid.output import json as answers
from jointid.output.export.joint_model import JointModel
from jointid.paper.twin import JOINT_FILE, TABLE_2, twin
from tests.output.export.models import model, with_parameter
from tests.rigid_axis import run

ROOT = Path(__file__).resolve().parents[3]
HOSTILE = 'run"\n[joint]\nkind = "revolute" \x07 \u2028 \\'
RIGID = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A joint file of the twin and an estimate of it."""
    text = (
        JOINT_FILE
        + "\n[parameters]   # as the makers say\nload_inertia = { start = 30.0, upper = 60.0 }\noffset = -3.0\n"
    )
    (tmp_path / "joint.toml").write_text(text, encoding="utf-8")
    ji.write(twin().record, tmp_path / "record.csv")
    file = ji.load(tmp_path / "joint.toml")
    key = answers.key_of(file, [tmp_path / "record.csv"], None, (), None)
    found = model(file.joint, TABLE_2 | {"offset": -3.0}, HOSTILE)
    answers.keep(tmp_path / "joint.estimate.json", key, found)
    return tmp_path


def exported(folder: Path, out: str, *words: object) -> int:
    return run("export", folder / "joint.toml", "--out", folder / out, *words)


def test_the_joint_file_keeps_its_text_and_gives_the_values_back(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exported(folder, "filled.toml") == 0
    assert "nothing of the joint is lost in joint-file" in capsys.readouterr().out
    text = (folder / "filled.toml").read_text(encoding="utf-8")
    assert "# never reached" in text
    file = ji.load(folder / "filled.toml")
    assert file.axis.values() == TABLE_2 | {"offset": -3.0}
    found = file.parameters
    assert all(found[name].free for name in TABLE_2 if name != "offset")
    assert not found["offset"].free  # as it was
    assert found["load_inertia"].upper == 60.0
    assert "# ZZ1 motor_inertia: 70.200 ± 0.020 kg" in text
    assert "# record run" in text
    plain = ji.load(folder / "joint.toml")
    assert replace(file, parameters={}, path=plain.path) == replace(plain, parameters={})


def test_an_interval_holds_what_the_model_lacks() -> None:
    file = loads(JOINT_FILE)
    lacking = with_parameter(model(file.joint, TABLE_2), "motor_inertia", lack_of_fit=0.1)
    assert "motor_inertia: 70.20 ± 0.20 kg" in ji.export(lacking, "joint-file", file=file).text


def test_fixed_values_are_kept_and_paths_lead_to_the_same_record(folder: Path) -> None:
    (folder / "below").mkdir()
    assert exported(folder, "below/fixed", "--set", "export.values=fixed", "--format", "joint-file") == 0
    (folder / "below" / "fixed").rename(folder / "below" / "fixed.toml")
    file = ji.load(folder / "below" / "fixed.toml")
    assert not any(parameter.free for parameter in file.parameters.values())
    assert file.axis.values() == TABLE_2 | {"offset": -3.0}
    assert file.source.file == "../record.csv"


def test_what_a_joint_file_cannot_have_is_left_out_and_said(folder: Path) -> None:
    file = ji.load(folder / "joint.toml")
    values: dict[str, float | None] = {**TABLE_2, "stiffness": None, "motor_viscous": -4.0}
    made = ji.export(model(file.joint, values), "joint-file", file=file)
    assert len(made.lost) == 2
    again = loads(made.text)
    assert set(again.parameters) == {*TABLE_2} - {"stiffness", "motor_viscous"}
    with pytest.raises(ji.MethodError):
        ji.export(model(file.joint, values), "mjcf")


def test_a_joint_file_that_was_made_by_a_program_is_written_whole() -> None:
    file = loads(JOINT_FILE)
    made = ji.export(model(file.joint, TABLE_2), "joint-file", file=file)
    assert loads(made.text).axis.values() == TABLE_2
    geared = loads(JOINT_FILE.replace("[record]", "[transmission]\nratio = 3.0\n\n[record]", 1))
    for told, asked in (
        (model(file.joint, TABLE_2), {}),
        (model(file.joint, TABLE_2), {"file": file, "values": "kept"}),
        (model(ji.RigidJoint("prismatic"), RIGID), {"file": file}),
        (model(geared.joint, TABLE_2), {"file": geared, "side": "motor"}),
    ):
        with pytest.raises(ji.MethodError):
            ji.export(told, "joint-file", **asked)


@pytest.mark.parametrize("out", ["a.toml", "a.mat", "a.xml", "a.urdf"])
def test_the_same_estimate_gives_the_same_bytes_which_say_where_they_come_from(folder: Path, out: str) -> None:
    assert exported(folder, out) == 0
    first = (folder / out).read_bytes()
    assert exported(folder, out) == 0
    assert (folder / out).read_bytes() == first
    for words in (b"5f1c", b"jointid.Estimate/2", ji.__version__.encode(), b"run"):
        assert words in first
    assert b"\x07" not in first or out == "a.mat"


@pytest.mark.parametrize(
    "words",
    [
        ("a.pdf",), ("a.mat", "--set", "export.timestep=1e-4"), ("a.xml", "--set", "export.side=x"), ("nowhere/a.xml",),
        ("joint.estimate.json",), ("a.xml", "--format", "word"), ("a.xml", "--set", "export.timestep=abc"),
        ("a.mat", "--set", "export.period=abc"), ("a.mat", "--set", "export.delay=[1]"),
        ("a.xml", "--set", "export.name=5"),
    ],
)  # fmt: skip
def test_mistakes_are_refused(folder: Path, words: tuple[object, ...]) -> None:
    before = (folder / "joint.estimate.json").read_bytes()
    assert exported(folder, *words) == 2
    assert (folder / "joint.estimate.json").read_bytes() == before


def test_to_the_other_side_and_back_nothing_changes() -> None:
    gear = ji.Transmission(load="revolute", ratio=100.0, sign=-1)
    joint = ji.FlexibleJoint(
        "revolute", ji.friction.Friction("asymmetric"), gravity=ji.Gravity("link"), transmission=gear
    )
    values = {p.name: 1.0 + i for i, p in enumerate(joint.parameters)}
    here = JointModel.of(model(joint, values), "axis")
    back = here.on("motor").on("load")
    assert back.values == pytest.approx(values, rel=1e-12)
    assert here.on("motor").gravity == replace(ji.Gravity("link"), angle=-0.01)
    assert here.on("motor").values["motor_coulomb_forwards"] == pytest.approx(values["motor_coulomb_backwards"] / 100)
    assert (here.gear, here.on("motor").gear) == (-100.0, 1.0)


@pytest.mark.slow
def test_exporting_text_needs_no_simulation_and_no_optional_package() -> None:
    program = (
        "import sys; from tests.output.export.models import model; import jointid as ji; "
        f"told = model(ji.RigidJoint('prismatic'), {RIGID}); "
        "[ji.export(told, name) for name in ('state-space', 'mjcf', 'urdf')]; "
        "print([m for m in ('numba', 'matplotlib', 'control', 'mujoco') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert found.stdout.strip() == "[]"
