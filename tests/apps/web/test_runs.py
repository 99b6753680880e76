"""Identifications of the page: each a process that may crash, be cancelled or be cut off by the end of the page."""

from __future__ import annotations

import asyncio
import io
import json
import os
import re
import signal
import time
import zipfile
from asyncio.subprocess import Process
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.cli import main
from jointid.apps.web.application import build_application
from jointid.apps.web.folder import Draft, Limits
from jointid.config import loads
from tests.apps.web.asking import ADDRESS, LAW, TOKEN, UNITS, Asker
from tests.apps.web.conftest import TRUTH
from tests.apps.web.testclient import TestClient

pytestmark = pytest.mark.slow


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> list[Process]:
    """The processes that the page has started, the latest at the end."""
    started = []
    start = asyncio.create_subprocess_exec

    async def start_and_note(*words: str, **options: Any) -> Process:
        started.append(await start(*words, **options))
        return started[-1]

    monkeypatch.setattr(asyncio, "create_subprocess_exec", start_and_note)
    return started


def begun(asker: Asker, run: Draft, processes: list[Process]) -> None:
    """Wait until the process of an identification works."""
    for _ in range(1200):
        if run.has("_answer.txt") and processes and processes[-1].returncode is None:
            time.sleep(0.5)
            return
        assert asker.page.jobs.is_running(run)
        time.sleep(0.05)
    raise AssertionError(asker.page.jobs.state(run))


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, log: bytes) -> Iterator[tuple[Asker, Draft]]:
    """An identification that ended."""
    folder = tmp_path_factory.mktemp("finished")
    limits = Limits(upload=2_000_000)
    with TestClient(build_application(folder, TOKEN, limits=limits), base_url=ADDRESS) as client:
        asker = Asker(client)
        run = asker.identify(log, **{"joint.name": "<b>axis</b>"})
        assert asker.ended(run) == "done"
        yield asker, run


def test_from_a_log_to_files_that_repeat_the_answer(finished: tuple[Asker, Draft], log: bytes, tmp_path: Path) -> None:
    asker, run = finished
    client = asker.client
    page = client.get(f"/runs/{run.name}")
    assert "<b>axis</b>" not in page.text
    answer = client.get(f"/runs/{run.name}/answer.json").json()
    for name, value in TRUTH.items():
        assert answer["parameters"][name]["value"] == pytest.approx(value, rel=0.02), name
    archive = zipfile.ZipFile(io.BytesIO(client.get(f"/runs/{run.name}/all.zip").content))
    files = {"joint.toml", "answer.json", "report.html", "log.csv"}
    assert set(archive.namelist()) == files
    assert archive.read("log.csv") == log
    assert answer["data"]["record"] == "log"
    assert loads(archive.read("joint.toml").decode()).source.file == "log.csv"
    report = archive.read("report.html").decode()
    carried = json.loads(re.findall(r'id="jointid-answer">(.*?)</script>', report, re.DOTALL)[0])
    assert carried["record_file"] == "log.csv"
    assert carried["joint_file"] == archive.read("joint.toml").decode()
    archive.extractall(tmp_path / "out")
    for folder in (tmp_path / "out", run.path):  # either as it is
        with pytest.raises(SystemExit) as end:
            main(["identify", str(folder / "joint.toml"), "--json", str(tmp_path / "again.json"), "-q"])
        assert end.value.code == 0
        again = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
        assert again["parameters"] == answer["parameters"]
        assert again["data"] == answer["data"]


def test_the_report_is_shown_in_a_sandbox(finished: tuple[Asker, Draft]) -> None:
    asker, run = finished
    client = asker.client
    answer = client.get(f"/runs/{run.name}/report.html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox;")
    assert "script-src" not in policy  # and so 'none', the default, as the next
    assert "connect-src" not in policy
    assert "default-src 'none'" in policy
    assert 'sandbox=""' in client.get(f"/runs/{run.name}").text
    kept = client.get(f"/runs/{run.name}/report.html?download")
    assert kept.headers["content-disposition"].startswith("attachment")
    assert kept.content == answer.content


def test_a_controller_that_nobody_knows_is_learned(client: TestClient, asker: Asker, log: bytes) -> None:
    short = b"\n".join(log.splitlines()[:2501])  # the search takes longer on all of it
    run = asker.identify(short, **{"controller.law": "learn"})
    assert asker.ended(run) == "done"
    answer = client.get(f"/runs/{run.name}/answer.json").json()
    assert answer["parameters"]["inertia"]["value"] == pytest.approx(TRUTH["inertia"], rel=0.02)
    text = client.get(f"/runs/{run.name}/joint.toml").text
    assert 'law = "cascade"' in text
    assert "P-P" in asker.get(f"/runs/{run.name}")


def test_a_process_that_is_killed_leaves_the_page_up(
    client: TestClient, asker: Asker, log: bytes, processes: list[Process]
) -> None:
    run = asker.identify(log)
    begun(asker, run, processes)
    os.kill(processes[-1].pid, signal.SIGKILL)
    assert asker.ended(run) == "refused"
    assert "signal 9" in asker.get(f"/runs/{run.name}")
    assert client.get(f"/runs/{run.name}/answer.json").status_code == 404
    following = asker.identify(log)
    assert following.name == "2"
    begun(asker, following, processes)


def test_what_the_record_does_not_allow_is_said_in_its_sentence(asker: Asker, log: bytes) -> None:
    run = asker.identify(log, **{"record.channels.torque.sign": "-1"})
    assert asker.ended(run) == "refused"
    page = asker.get(f"/runs/{run.name}")
    assert "It could not be identified" in page
    assert asker.page.jobs.state(run)["sentence"].splitlines()[0] in page
    assert "Traceback" not in page


def test_cancelling_ends_the_process(asker: Asker, log: bytes, processes: list[Process]) -> None:
    run = asker.identify(log)
    begun(asker, run, processes)
    assert "You cancelled it" in asker.post(f"/runs/{run.name}/cancel")[1]
    assert asker.page.jobs.state(run)["state"] == "cancelled"
    assert not alive(processes[-1].pid)
    assert not run.has("answer.json")  # it did not run to its end


def test_one_identification_runs_at_a_time(asker: Asker, log: bytes) -> None:
    run = asker.identify(log)
    code, page = asker.post("/joint", LAW)
    assert code == 422
    assert "Identification 1 is still running; wait for its end or cancel it" in page
    assert [one.name for one in asker.folder.runs] == ["1"]
    asker.post(f"/runs/{run.name}/cancel")
    assert asker.post("/joint", LAW)[0] == 200
    assert [one.name for one in asker.folder.runs] == ["2", "1"]


def test_an_identification_that_takes_too_long_is_stopped(folder: Path, log: bytes, processes: list[Process]) -> None:
    hasty = build_application(folder, TOKEN, limits=Limits(seconds=0.5))
    with TestClient(hasty, base_url=ADDRESS) as client:
        asker = Asker(client)
        run = asker.identify(log)
        assert asker.ended(run) == "refused"
        assert "took longer than" in asker.page.jobs.state(run)["sentence"]
        assert not alive(processes[-1].pid)


def test_the_end_of_the_page_ends_what_runs(folder: Path, log: bytes, processes: list[Process]) -> None:
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        asker = Asker(client)
        run = asker.identify(log)
        begun(asker, run, processes)
    assert not alive(processes[-1].pid)
    assert asker.page.jobs.state(run)["state"] == "cancelled"


def test_a_page_that_is_started_again_finds_everything_under_its_new_token(folder: Path, log: bytes) -> None:
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        asker = Asker(client)
        run = asker.identify(log)
        asker.post(f"/runs/{run.name}/cancel")
    (run.path / "_run.json").unlink()  # as a page that is killed leaves it
    with TestClient(build_application(folder, "new"), base_url="http://127.0.0.1:8765/new/") as client:
        assert "log.csv" in client.get("/").text
        assert "stopped before this had ended" in client.get("/runs/1").text
        assert client.get(f"http://127.0.0.1:8765/{TOKEN}/").status_code == 403


def test_a_record_that_takes_too_much_memory_is_refused_in_a_sentence(folder: Path, log: bytes) -> None:
    small = build_application(folder, TOKEN, limits=Limits(memory=100 * 2**20))
    with TestClient(small, base_url=ADDRESS) as client:
        asker = Asker(client)
        assert asker.send("log.csv", log)[0] == 200
        asker.post("/draft/joint", {"extra": '[record]\nresample = {method = "linear", sample_time = 1e-7}'})
        code, said = asker.post("/channels", UNITS)
        assert code == 422
        assert "jointid identify --window" in said
