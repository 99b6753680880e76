"""Several records and robot files on the page: the answers are those of the command."""

import json
from pathlib import Path

import pytest

from tests.apps.cli.test_robots import HEAD, write_robot
from tests.apps.web.asking import UNITS, Asker, code_of
from tests.estimation.robots.twin import arm
from tests.rigid_axis import run as command

ROBOT = HEAD + '[[joints]]\nname = "joint1"\n[[joints]]\nname = "joint2"\n'


def send(asker: Asker, files: dict[str, bytes]) -> str:
    """Send files, and return the step that follows."""
    answer = asker.client.post("/record", files=[("file", one) for one in files.items()])
    return str(answer.url.path.rsplit("/", 1)[1]) if (code := code_of(answer)) == 200 else str(code)


@pytest.mark.slow
def test_files_that_do_not_belong_together_are_refused_and_not_kept(asker: Asker, log: bytes) -> None:
    for files in (
        {"arm.xml": b"<robot/>", "a.csv": log},
        {"a.toml": b"", "b.toml": b"", "a.csv": log},
        {"r.toml": ROBOT.encode()},
        {"r.toml": ROBOT.encode(), "a.csv": log},
        {"a.toml": b"[joint]"},
        {"dir/a.csv": log, "a.csv": log},
    ):
        assert send(asker, files) == "422", files.keys()
    assert not asker.kept


@pytest.mark.slow
def test_what_was_said_of_a_record_stays_for_one_with_the_same_columns(asker: Asker, log: bytes) -> None:
    assert send(asker, {"one.csv": log, "two.csv": log}) == "channels"
    assert asker.post("/channels", UNITS)[0] == 200
    assert asker.page.now.records == ["one.csv", "two.csv"]
    assert send(asker, {"again.csv": log}) == "channels"  # another log with the same columns
    assert asker.page.now.texts["record.channels.torque.unit"] == "N"
    assert asker.page.now.records == ["again.csv"]
    assert send(asker, {"other.csv": log.replace(b"torque", b"force", 1)}) == "channels"
    assert "record.channels.torque.unit" not in asker.page.now.texts


@pytest.mark.slow
def test_a_mistake_in_the_text_is_refused_and_stays_to_be_mended(asker: Asker, log: bytes) -> None:
    assert send(asker, {"r.toml": ROBOT.encode(), "arm.xml": b"<robot/>", "one.csv": log}) == "joint"
    for text in ("[robot", "record = [1", "a = " + "[" * 400 + "]" * 400):
        assert asker.post("/joint", {"extra": text})[0] == 422
        assert text in asker.get("/joint")
    assert send(asker, {"one.csv": log}) == "channels"
    assert "robot" not in asker.page.now.texts.get("extra", "")
    for text in ("record = 5", "[a", "record.channels = 4", "record.knid = 1"):
        for step in ("/joint", "/channels"):
            assert asker.post(step, {**UNITS, "extra": text})[0] == 422, (step, text)
            assert 'aria-invalid="true"' in asker.post(step, {"extra": text})[1], "beside the further lines"
    assert asker.post("/channels", {**UNITS, "extra": ""})[0] == 200


@pytest.mark.slow
def test_a_robot_is_identified_as_by_the_command(asker: Asker, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
    place = write_robot(tmp_path, arm(2))
    files = {name: (place / name).read_bytes() for name in ("robot.toml", "arm.xml", "one.csv")}
    assert send(asker, files) == "joint"
    assert 'column = "tau{axis}"' in asker.get("/joint")
    asker.post("/joint", {"extra": files["robot.toml"].decode().replace("joint2", "joint9")})
    assert asker.ended(asker.page.runs[0]) == "refused"
    assert "joint9" in asker.get("/runs/1")
    asker.post("/joint", {"extra": files["robot.toml"].decode()})
    run = asker.page.runs[0]
    assert asker.ended(run) == "done"
    assert command("identify", run.path / run.file, "--json", tmp_path / "again.json", "-q", "--again") == 0
    page, again = run.json("answer.json"), json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    assert page["parameters"] == again["parameters"]
    assert page["answer"]["found"]["words"].partition(" ")[0] in asker.get(f"/runs/{run.path.name}")
    assert {*run.files} == {"robot.toml", "robot.estimate.json", "arm.xml", "one.csv", "report.html", "answer.json"}
