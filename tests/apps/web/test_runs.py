"""Identifications of the page: each a process that may crash, be cancelled or be cut off by the end of the page."""

import asyncio
import json
import os
import signal
import time
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.web import folder as folder_module
from jointid.apps.web.folder import Draft
from jointid.apps.web.routes import build_application
from tests.apps.web.asking import ADDRESS, LAW, TOKEN, UNITS, Asker, TestClient
from tests.apps.web.conftest import TRUTH
from tests.rigid_axis import run as command

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


def test_from_a_log_to_files_that_repeat_the_answer(asker: Asker, log: bytes, tmp_path: Path) -> None:
    run, client = asker.identify(log, **{"joint.name": "<b>axis</b>"}), asker.client
    assert asker.ended(run) == "done"
    page = client.get(f"/runs/{run.path.name}")
    assert "<b>axis</b>" not in page.text and 'sandbox=""' in page.text
    answer = client.get(f"/runs/{run.path.name}/answer.json").json()
    for name, value in TRUTH.items():
        assert answer["parameters"][name]["value"] == pytest.approx(value, rel=0.02), name
    assert {*run.files} == {"joint.toml", "joint.estimate.json", "answer.json", "report.html", "log.csv"}
    assert command("identify", run.path / "joint.toml", "--json", tmp_path / "again.json", "-q", "--again") == 0
    again = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    assert (again["parameters"], again["data"]) == (answer["parameters"], answer["data"])
    report = client.get(f"/runs/{run.path.name}/report.html")
    policy = report.headers["content-security-policy"]
    assert policy.startswith("sandbox; default-src 'none'")
    assert not {"script-src", "connect-src"} & {*policy.split()}
    kept = client.get(f"/runs/{run.path.name}/report.html?download")
    assert kept.headers["content-disposition"].startswith("attachment") and kept.content == report.content
    assert client.get(f"/runs/{run.path.name}/_progress.txt").status_code == 404


def test_a_controller_that_nobody_knows_is_learned(client: TestClient, asker: Asker, log: bytes) -> None:
    short = b"\n".join(log.splitlines()[:2501])  # the search takes longer on all of it
    run = asker.identify(short, **{"controller.law": "learn"})
    assert asker.ended(run) == "done"
    answer = client.get(f"/runs/{run.path.name}/answer.json").json()
    assert answer["parameters"]["inertia"]["value"] == pytest.approx(TRUTH["inertia"], rel=0.02)
    text = client.get(f"/runs/{run.path.name}/joint.toml").text
    assert 'law = "cascade"' in text
    assert "P-P" in asker.get(f"/runs/{run.path.name}")


def test_a_process_that_is_killed_leaves_the_page_up(
    client: TestClient, asker: Asker, log: bytes, processes: list[Process]
) -> None:
    run = asker.identify(log)
    begun(asker, run, processes)
    os.kill(processes[-1].pid, signal.SIGKILL)
    assert asker.ended(run) == "refused"
    assert client.get(f"/runs/{run.path.name}/answer.json").status_code == 404
    following = asker.identify(log)
    assert following.path.name == "2"
    begun(asker, following, processes)


def test_what_the_record_does_not_allow_is_said_in_its_sentence(asker: Asker, log: bytes) -> None:
    run = asker.identify(log, **{"record.channels.torque.sign": "-1"})
    assert asker.ended(run) == "refused"
    page = asker.get(f"/runs/{run.path.name}")
    assert "It could not be identified" in page
    assert asker.page.jobs.state(run)["sentence"].splitlines()[0] in page
    assert "Traceback" not in page


def test_cancelling_ends_the_process(asker: Asker, log: bytes, processes: list[Process]) -> None:
    run = asker.identify(log)
    begun(asker, run, processes)
    assert "Cancelled" in asker.post(f"/runs/{run.path.name}")[1]
    assert asker.page.jobs.state(run)["state"] == "cancelled"
    assert not alive(processes[-1].pid)
    assert not run.has("answer.json")  # it did not run to its end


def test_one_identification_runs_at_a_time(asker: Asker, log: bytes) -> None:
    run = asker.identify(log)
    code, page = asker.post("/joint", LAW)
    assert code == 422
    assert "still running" in page
    assert [one.path.name for one in asker.page.runs] == ["1"]
    asker.post(f"/runs/{run.path.name}")
    assert asker.post("/joint", LAW)[0] == 200
    assert [one.path.name for one in asker.page.runs] == ["2", "1"]


def test_an_identification_that_takes_too_long_is_stopped(
    asker: Asker, log: bytes, processes: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_module, "IDENTIFYING", 1)
    run = asker.identify(log)
    assert asker.ended(run) == "refused"
    assert "1 s of processor" in asker.page.jobs.state(run)["sentence"]
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
        asker.post(f"/runs/{run.path.name}")
    (run.path / "_run.json").unlink()  # as a page that is killed leaves it
    with TestClient(build_application(folder, "new"), base_url="http://127.0.0.1:8765/new/") as client:
        assert "log.csv" in client.get("/channels").text
        assert "stopped before this had ended" in client.get("/runs/1").text
        assert client.get(f"http://127.0.0.1:8765/{TOKEN}/").status_code == 403


def test_a_record_that_takes_too_much_memory_is_refused_in_a_sentence(
    asker: Asker, log: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert asker.send("log.csv", log)[0] == 200
    monkeypatch.setattr(folder_module, "MEMORY", 2 * 2**30)
    slow = '[record]\nresample = {method = "linear", sample_time = 1e-7}'
    assert asker.post("/channels", {**UNITS, "extra": slow})[0] == 422
