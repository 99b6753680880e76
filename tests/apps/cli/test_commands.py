"""The program as a user meets it: its commands, what they write, and how they fail."""

import contextlib
import json
import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli.app import app
from jointid.apps.cli.demo import FIRST_DAY, _write_robot
from jointid.config import File, load
from jointid.paper.twin import TABLE_2
from jointid.records.formats import Table, write_table
from tests.joint_files import EXAMPLE as EMPS
from tests.rigid_axis import JOINT, TRUTH, run, write_axis

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    with contextlib.chdir(folder):
        assert run("demo", ".", "--quiet") == 0
    return folder


def test_the_demo_writes_a_folder_to_play_with(demo: Path) -> None:
    assert {path.name for path in demo.iterdir()} == {"record.csv", "joint.toml", "joint.estimate.json", "torque.png"}
    answer = json.loads((demo / "joint.estimate.json").read_text(encoding="utf-8"))
    for name, value in TABLE_2.items():
        found = answer["parameters"][name]
        assert abs(found["value"] - value) <= 3 * found["stderr"], name
    assert abs(answer["parameters"]["stiffness"]["value"] / 8e5 - 1) <= 0.01
    assert answer["data"]["channels"] == ["torque", "reference", "injected"]


@pytest.mark.slow
def test_identify_validate_simulate_on_the_real_axis(
    emps_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, pulses, joint = tmp_path / "out.json", emps_path.with_name("DATA_EMPS_PULSES.mat"), tmp_path / "joint.toml"
    joint.write_text(EMPS.read_text("utf-8").replace("DATA_EMPS.mat", str(emps_path)), "utf-8")
    assert run("identify", joint, "--json", out, "--figure", tmp_path / "t.svg", "-q") == 0
    answer = json.loads(out.read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Estimate/2"
    assert answer["data"]["channels"] == ["torque", "reference"]
    assert abs(answer["parameters"]["inertia"]["value"] - 95.0) <= 0.5
    assert answer["fit"]["relative_error"] <= 0.046
    assert (tmp_path / "t.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")

    check = tmp_path / "check.json"
    assert run("validate", joint, "--record", pulses, "--json", check, "-q") == 0
    cross = json.loads(check.read_text(encoding="utf-8"))
    assert (cross["schema"], cross["test"]) == ("jointid.Validation/2", "cross")
    assert cross["relative_error"] <= 0.055
    assert run("validate", joint, "--record", emps_path, "--json", check, "-q") == 0
    assert json.loads(check.read_text(encoding="utf-8"))["test"] == "direct"

    made, summary = tmp_path / "made.csv", tmp_path / "made.json"
    assert run("simulate", joint, "--identified", "--out", made, "--json", summary, "-q") == 0
    assert json.loads(summary.read_text(encoding="utf-8"))["outcome"] == "finished"
    capsys.readouterr()
    assert run("identify", joint, "--record", made, "--json", check, "-q") == 0  # it has the columns of EMPS itself
    again = json.loads(check.read_text(encoding="utf-8"))
    for name in ("inertia", "viscous", "coulomb", "offset"):
        assert abs(again["parameters"][name]["value"] / answer["parameters"][name]["value"] - 1) <= 1e-6, name
    assert again["fit"]["relative_error"] <= 1e-6


def test_what_is_simulated_from_a_late_beginning_counts_from_its_own(tmp_path: Path) -> None:
    """The record begins 2 ms after its file, at its first refresh; what is written begins with itself."""
    text = JOINT.replace("run.npy", "trace.csv").replace(" }", ", sample_time = 0.004 }").replace("100.0", "10.0")
    text += "position_period = 0.016\nposition_offset = 0.006\n[parameters]\n"
    text += "".join(f"{name} = {{ start = {value} }}\n" for name, value in TRUTH.items())
    slow = ji.excitation.trapezoids((0.1, 0.2), 2.0, 0.2, 4e-3, duration=16.0)
    samples = 4 * slow.size
    rows = np.maximum((np.arange(samples) - 2) // 4, 0)
    columns = {"t": np.arange(samples) * 1e-3, "reference": slow[rows], "torque": np.sin(0.3 * rows)}
    write_table(tmp_path / "trace.csv", Table(columns))
    joint, made, out = tmp_path / "joint.toml", tmp_path / "made.csv", tmp_path / "out.json"
    joint.write_text(text, encoding="utf-8")
    assert load(joint).record().begin == pytest.approx(2e-3)
    assert run("simulate", joint, "--out", made, "-q") == 0
    assert run("identify", joint, "--record", made, "--json", out, "-q") == 0
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found["fit"]["relative_error"] <= 1e-6
    assert abs(found["parameters"]["inertia"]["value"] / TRUTH["inertia"] - 1) <= 1e-6


@pytest.mark.parametrize(
    "words",
    [
        ("identify", EMPS, "--record", "nothing.mat"),
        ("identify", "nothing.toml"),
        ("identify",),
        ("identfy", EMPS),
        ("data", "inspect", "log.csv"),
        ("identify", EMPS, "--recrod", "x.mat"),
        ("identify", EMPS, "--set", "controller.law=casade"),
        ("identify", EMPS, "--set", "controller.law='P-PI'"),
        ("identify", "log.csv"),
        ("identify", EMPS, "--record", EMPS),
        ("identify", EMPS, "--set", "method.estimator=ols"),
        ("identify", EMPS, "--set", "method.frequency=30"),
        ("validate", EMPS),
        ("demo", EMPS / "inside"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(
    words: tuple[str | Path, ...], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*words) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("jointid: ") and "Traceback" not in said.err
    assert "id you mean" in said.err[:65] or not ({"identfy", "data"} & {*words} or "controller.law" in str(words))
    assert list(tmp_path.iterdir()) == []


def test_listed_records_alone_are_examined_and_planned_from(tmp_path: Path) -> None:
    joint = write_axis(tmp_path, JOINT.replace('file = "run.npy"\n', "") + '[[records]]\nfile = "run.npy"\n' * 2)
    assert run("diagnose", joint) == 0
    assert run("diagnose", joint, "--json", tmp_path / "found.json") == 2
    assert run("design", joint) == 2


@pytest.mark.parametrize(
    "words",
    [
        ("report", EMPS, "--held-out", "nope.csv"),
        ("design", EMPS, "--goal", "nope"),
        ("identify", EMPS, "--window", "6", "--figure", "torque.png"),
        ("report", "joint.toml", "-q"),  # of a record that only windows take
        ("design", "joint.toml", "-q"),
    ],
)
def test_what_cannot_succeed_is_refused_before_the_joint_is_identified(
    words: tuple[str | Path, ...], demo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(demo)
    monkeypatch.setattr(File, "identify", None)
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", 1000)
    assert run(*words) == 2


def test_a_failure_of_ours_is_a_sentence_and_exit_code_1(
    demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by design")

    monkeypatch.setattr("jointid.config.load", broken)
    assert run("identify", demo / "joint.toml") == 1
    said = capsys.readouterr().err
    assert "a fault of ours (ZeroDivisionError: by design)" in said
    assert "Traceback" not in said
    assert run("identify", demo / "joint.toml", "--debug") == 1
    assert "in broken" in capsys.readouterr().err, "the traceback"


def test_a_demo_that_is_interrupted_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ji, "twin", Mock(side_effect=KeyboardInterrupt), raising=False)
    assert run("demo", tmp_path / "new", "-q") == 130
    assert not [*tmp_path.iterdir()]


def test_every_command_is_documented(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("identify", "--help") == run("--version") == 0
    shown = capsys.readouterr().out
    assert "default: False" not in shown and "default: ()" not in shown and "\nnumpy " in shown
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert {*re.findall(r"^## `jointid ([a-z-]+)", page, re.MULTILINE)} == {one for one in app if one[0] != "-"}


@pytest.mark.slow
def test_a_robot_is_identified_from_torques_alone_beside_its_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "robot"
    assert run("demo", "--robot", place, "-q") == 0
    names = {"record.csv", "robot.toml", "robot.xml", "robot.estimate.json", "torque.png"}
    assert {path.name for path in place.iterdir()} == names
    for name in ("robot.toml", "robot.xml"):
        assert (place / name).read_bytes() == (ROOT / "examples" / "robot" / name).read_bytes()
    assert (place / "record.csv").read_text(encoding="utf-8").startswith("t,tau1,r1,tau2,r2\n")
    out = capsys.readouterr().out
    assert "repeatable residual" not in out and max(map(len, out.partition("\n\nWritten")[0].splitlines())) <= 80
    rows = re.findall(r"^(\w.*?)  +(-?[\d.e-]+) ± ([\d.e-]+)  \S.*? +(-?[\d.e-]+)$", out, re.MULTILINE)
    found = {name: tuple(map(float, numbers)) for name, *numbers in rows}
    assert len(found) == 18, "every parameter has its truth"
    assert all(abs(value - true) < 2 * interval for value, interval, true in found.values())
    value, interval, true = found["shoulder, stiffness"]
    assert true == 2560.0 and interval < 0.01 * value
    assert run("demo", "--robot", place, "-q") == 2, "it holds files"


def test_a_joint_without_gains_falls_and_that_is_said(tmp_path: Path) -> None:
    _write_robot(tmp_path)
    joint, found = tmp_path / "robot.toml", tmp_path / "found.json"
    text, strays = joint.read_text(encoding="utf-8"), []
    for gains in (("1000.0", "36.0"), ("0.0", "0.0")):
        joint.write_text(text.replace("1000.0", gains[0]).replace("36.0", gains[1]), encoding="utf-8")
        assert run("simulate", joint, "--json", found) == 0
        answer = json.loads(found.read_text(encoding="utf-8"))
        assert answer["schema"] == "jointid.Simulation/2" and answer["outcome"] == "finished"
        strays.append(list(answer["tracking_errors"]))
    assert strays == [[], ["elbow"]]


def test_a_fleet_is_made_by_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "fleet"
    assert run("demo", "--fleet", place, "-q") == 0
    assert len([*place.glob("logs/axis-00?/*.npy")]) == 4 * 9
    record = load(place / "joint.toml").record(place / "logs" / "axis-001" / f"{FIRST_DAY}.npy")
    assert record.torque is not None and record.torque.values.size == 8000
    said = capsys.readouterr()
    assert f"jointid campaign {place}/campaign.toml" in said.out and not said.err
    assert run("demo", "--fleet", "--robot", place) == 2
    assert "A demo is of a robot or of a fleet" in capsys.readouterr().err
