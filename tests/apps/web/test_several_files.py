"""Several records, joint files and robot files on the page: the answers are those of the command."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.cli import main
from jointid.apps.web.folder import Run
from jointid.apps.web.form import fill_in_form, make_joint_file, make_reading_tables, make_robot_file, make_tables
from jointid.common.errors import JointFileError
from jointid.config import file_of, loads
from jointid.models.robots.robot import Robot
from jointid.output.export import export
from tests.apps.cli.test_robots import HEAD, write_robot
from tests.apps.web.asking import LAW, UNITS, Asker, ended
from tests.estimation.robots.twin import arm

JOINT = """
records = [{ file = "logs/one.csv" }, { file = "two.csv", added_inertia = 2.5 }]
[joint]
kind = "prismatic"
[record.channels]
torque = { column = "torque", unit = "N" }
reference = { column = "reference", unit = "m" }
[controller]
law = "cascade"
position_gain = 60.0
velocity_gain = 500.0
[together]
weighting = "level"
"""
ROBOT = HEAD + '[[joints]]\nname = "joint1"\n[[joints]]\nname = "joint2"\n'


def test_a_joint_file_of_several_records_comes_through_the_form() -> None:
    made = fill_in_form(JOINT)
    assert not made["robot"]
    assert made["draft"]["controller.position_gain"] == "60.0"
    file = loads(make_joint_file(made["draft"], ["one.csv", "two.csv"]))
    assert [(run.file, run.added_inertia) for run in file.runs] == [("one.csv", 0.0), ("two.csv", 2.5)]
    assert file.together == loads(JOINT).together
    tables = make_reading_tables(made["draft"], ["one.csv", "two.csv"])
    assert file_of(tables).axis.columns["torque"].unit == "N"


def test_every_record_that_is_sent_is_one_of_several() -> None:
    draft = fill_in_form(JOINT)["draft"]
    tables = make_tables(draft, ["one.csv", "two.csv", "three.csv"])
    assert [row["file"] for row in tables["records"]] == ["one.csv", "two.csv", "three.csv"]
    alone = {key: text for key, text in draft.items() if key != "extra"}
    assert make_tables(alone, ["a.csv", "b.csv"])["records"] == [{"file": "a.csv"}, {"file": "b.csv"}]
    assert "file" not in make_tables(alone, ["a.csv", "b.csv"])["record"]
    joined = alone | {"extra": '[record]\nfiles = ["x/a.csv", "b.csv"]'}
    assert loads(make_joint_file(joined, ["a.csv", "b.csv"])).source.first == "a.csv"


def write_model(robot: Robot, folder: Path) -> Path:
    path = folder / "arm.xml"
    path.write_text(export(robot, "mjcf").text, encoding="utf-8")
    return path


def test_a_robot_file_names_files_that_were_sent(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    write_model(arm(2), tmp_path)
    sent = ["one.csv", "arm.xml", "two.csv"]
    draft = fill_in_form(ROBOT)["draft"]
    assert loads(make_robot_file(draft, sent, tmp_path), tmp_path).source.file == "one.csv"
    other = {"extra": ROBOT.replace("one.csv", "logs/one.csv")}
    assert loads(make_robot_file(other, sent[:2], tmp_path), tmp_path).source.file == "one.csv"
    listed = f'{ROBOT}\n[[records]]\nfile = "logs/two.csv"\npayload_mass = 2.0\n'
    found = loads(make_robot_file({"extra": listed}, sent, tmp_path), tmp_path)
    assert [run.file for run in found.runs] == ["two.csv", "one.csv"]
    for path in ("/etc/passwd", "../robot.xml", "C:\\\\other.xml"):
        with pytest.raises(JointFileError, match=r"^robot\.model is .* which was not sent"):
            make_robot_file({"extra": ROBOT.replace("arm.xml", path)}, sent, tmp_path)
        several = f'{ROBOT}\n[[records]]\nfile = "one.csv"\n[[records]]\nfile = "{path}"\n'
        with pytest.raises(JointFileError, match=r"records\.2\.file is .* which was not sent"):
            make_robot_file({"extra": several}, sent, tmp_path)
    with pytest.raises(JointFileError, match="joints"):
        make_robot_file({"extra": ROBOT.replace("joint2", "joint3")}, sent, tmp_path)


def send(asker: Asker, files: dict[str, bytes], to: str = "/record") -> str:
    answer = asker.client.post(to, files=[("file", one) for one in files.items()])
    return str(answer.url.path.rsplit("/", 1)[1]) if answer.status_code == 200 else answer.text


@pytest.mark.slow
def test_files_that_do_not_belong_together_are_refused_and_not_kept(asker: Asker, log: bytes) -> None:
    assert "send the robot file" in send(asker, {"arm.xml": b"<robot/>", "a.csv": log})
    assert "Expected one joint file" in send(asker, {"a.toml": b"", "b.toml": b"", "a.csv": log})
    assert "is a robot file" in send(asker, {"r.toml": ROBOT.encode()})
    assert "came without its record" in send(asker, {"a.toml": b"[joint]"})
    assert "Two files are called a.csv" in asker.client.post("/record", files=[("file", ("a.csv", log))] * 2).text
    assert not asker.kept


@pytest.mark.slow
def test_what_was_said_of_a_record_stays_for_one_with_the_same_columns(asker: Asker, log: bytes) -> None:
    assert send(asker, {"one.csv": log, "two.csv": log}) == "channels"
    assert asker.post("/channels", UNITS)[0] == 200
    assert asker.folder.sent == ["one.csv", "two.csv"]
    assert send(asker, {"again.csv": log}) == "channels"  # another log with the same columns
    assert asker.folder.draft["record.channels.torque.unit"] == "N"


def answer_of(run: Run, folder: Path, *words: str) -> tuple[Any, Any]:
    """Return the answers of the page and of the command in the folder of the run."""
    with pytest.raises(SystemExit) as end:
        main(["identify", str(run.folder / run.file), *words, "--json", str(folder / "again.json"), "-q"])
    assert end.value.code == 0
    page = json.loads((run.folder / "answer.json").read_text(encoding="utf-8"))
    return page, json.loads((folder / "again.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_several_records_are_identified_as_by_the_command(asker: Asker, log: bytes, tmp_path: Path) -> None:
    other = b"\n".join(log.split(b"\n")[:6000]) + b"\n"  # a shorter one, as the same record is refused
    assert send(asker, {"one.csv": log, "two.csv": other}) == "channels"
    assert asker.post("/channels", UNITS)[0] == 200
    asker.post("/joint", LAW)
    run = asker.folder.runs[0]
    assert ended(run) == "done", run.status
    page, command = answer_of(run, tmp_path)
    assert page["parameters"] == command["parameters"]
    assert len(page["records"]) == 2
    assert run.status["sentence"] and not run.has("report.html")


@pytest.mark.slow
def test_a_robot_is_identified_as_by_the_command(asker: Asker, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    place = write_robot(tmp_path, arm(2))
    files = {name: (place / name).read_bytes() for name in ("robot.toml", "arm.xml", "one.csv")}
    assert send(asker, files) == "joint"
    assert 'column = "tau{axis}"' in asker.get("/joint")
    wrong = files["robot.toml"].decode().replace("joint2", "joint9")
    code, text = asker.post("/joint", {"extra": wrong})
    assert code == 422
    assert "joint9" in text
    assert not asker.folder.runs
    asker.post("/joint", {"extra": files["robot.toml"].decode()})
    run = asker.folder.runs[0]
    assert ended(run) == "done", run.status
    page, command = answer_of(run, tmp_path)
    assert page["parameters"] == command["parameters"]
    assert run.has("report.html")
    archive = zipfile.ZipFile(io.BytesIO(asker.client.get(f"/runs/{run.number}/all.zip").content))
    assert {"robot.toml", "arm.xml", "one.csv", "report.html", "answer.json"} <= set(archive.namelist())
