"""Identifications of the page: each a process that may crash, be cancelled, or belong to somebody else."""

from __future__ import annotations

import asyncio
import io
import json
import os
import signal
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from starlette.concurrency import run_in_threadpool

from jointid.apps.cli.app import main
from jointid.apps.web.application import application
from jointid.apps.web.jobs import Jobs
from jointid.apps.web.limits import Limits
from jointid.apps.web.sessions import PageError, Run, write_json
from tests.apps.web.asking import LAW, ORIGIN, Asker, ended, running
from tests.apps.web.conftest import TRUTH
from tests.apps.web.testclient import TestClient

pytestmark = pytest.mark.slow


def process(client: TestClient, run: Run) -> int:
    """Return the process of an identification that runs."""
    jobs = client.app.state.desk.jobs  # type: ignore[attr-defined]
    return int(jobs._jobs[run.folder].process.pid)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_from_a_log_to_files_that_repeat_the_answer(
    client: TestClient, asker: Asker, log: bytes, tmp_path: Path
) -> None:
    run = asker.identify(log, **{"joint.name": "<b>axis</b>"})
    assert ended(run) == "done", run.status
    page = client.get(f"/runs/{run.number}")
    assert "<b>axis</b>" not in page.text
    answer = client.get(f"/runs/{run.number}/answer.json").json()
    for name, value in TRUTH.items():
        assert answer["parameters"][name]["value"] == pytest.approx(value, rel=0.02), name
    archive = zipfile.ZipFile(io.BytesIO(client.get(f"/runs/{run.number}/all.zip").content))
    assert set(archive.namelist()) == {"joint.toml", "answer.json", "answer.txt", "report.html", "log.csv"}
    assert archive.read("log.csv") == log
    archive.extractall(tmp_path / "out")
    with pytest.raises(SystemExit) as end:
        main(["identify", str(tmp_path / "out" / "joint.toml"), "--json", str(tmp_path / "again.json"), "-q"])
    assert end.value.code == 0
    again = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    assert again["parameters"] == answer["parameters"]
    assert again["record"] == answer["record"]


def test_the_report_is_shown_in_a_sandbox(client: TestClient, asker: Asker, log: bytes) -> None:
    run = asker.identify(log)
    assert ended(run) == "done", run.status
    answer = client.get(f"/runs/{run.number}/report.html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy  # and so 'none', the default
    assert "default-src 'none'" in policy
    assert 'sandbox="allow-scripts' in client.get(f"/runs/{run.number}").text
    kept = client.get(f"/runs/{run.number}/report.html?download")
    assert kept.headers["content-disposition"].startswith("attachment")
    assert kept.content == answer.content
    events = client.get(f"/runs/{run.number}/events").text
    assert 'data: "identifying"' in events
    assert events.rstrip().endswith('event: state\ndata: "done"')
    later = client.get(f"/runs/{run.number}/events", headers={"last-event-id": "0"}).text
    assert "id: 0\n" not in later
    assert "id: 1\n" in later


def test_a_controller_that_nobody_knows_is_learned(client: TestClient, asker: Asker, log: bytes) -> None:
    run = asker.identify(log, **{"controller.law": "learn"})
    assert ended(run) == "done", run.status
    answer = client.get(f"/runs/{run.number}/answer.json").json()
    assert answer["parameters"]["inertia"]["value"] == pytest.approx(TRUTH["inertia"], rel=0.02)
    text = client.get(f"/runs/{run.number}/joint.toml").text
    assert 'law = "cascade"' in text
    assert "P-P" in asker.get(f"/runs/{run.number}")


def test_a_process_that_is_killed_leaves_the_page_up(client: TestClient, asker: Asker, log: bytes) -> None:
    run = asker.identify(log)
    running(run, "reading the record")
    os.kill(process(client, run), signal.SIGKILL)
    assert ended(run) == "failed"
    assert "signal 9" in asker.get(f"/runs/{run.number}")
    assert client.get(f"/runs/{run.number}/answer.json").status_code == 404
    following = asker.identify(log)
    assert following.number == run.number + 1
    running(following, "reading the record")


def test_what_the_record_does_not_allow_is_said_in_its_sentence(asker: Asker, log: bytes) -> None:
    run = asker.identify(log, **{"record.channels.torque.sign": "-1"})
    assert ended(run) == "refused"
    page = asker.get(f"/runs/{run.number}")
    assert "It could not be identified" in page
    assert run.status["sentence"]
    assert all(sentence in page for sentence in run.status["sentence"].splitlines())
    assert "Traceback" not in page


def test_cancelling_ends_the_process(client: TestClient, asker: Asker, log: bytes) -> None:
    run, second = asker.identify(log), asker.identify(log)
    running(run, "reading the record")
    pid = process(client, run)
    assert second.status["state"] == "queued"
    assert asker.post(f"/runs/{second.number}/cancel")[0] == 200
    assert "You cancelled it" in asker.post(f"/runs/{run.number}/cancel")[1]
    assert ended(run) == ended(second) == "cancelled"
    assert not alive(pid)
    assert not run.has("answer.json")  # it did not run to its end
    time.sleep(0.3)
    assert second.lines() == []  # it never began


def test_users_do_not_see_each_other(client: TestClient, asker: Asker, log: bytes, folder: Path) -> None:
    run = asker.identify(log)
    other = Asker(TestClient(client.app, base_url="http://127.0.0.1:8765"))
    paths = [f"/runs/{run.number}{rest}" for rest in ("", "/events", "/joint.toml", "/all.zip")]
    for path in [*paths, "/plot/0.svg"]:
        assert other.client.get(path).status_code == 404
    assert other.client.post(f"/runs/{run.number}/cancel", headers=ORIGIN).status_code == 404
    assert "log.csv" not in other.get("/")
    assert other.send("mine.csv", log)[0] == 200
    assert len(list(folder.iterdir())) == 2
    other.post("/forget")
    assert run.active
    assert "log.csv" in asker.get("/")
    token = next(iter(client.cookies.values()))
    assert all(token not in path.name for path in folder.iterdir())


def test_deleting_ends_what_runs_and_leaves_nothing(client: TestClient, asker: Asker, log: bytes, folder: Path) -> None:
    run = asker.identify(log)
    running(run, "reading the record")
    pid = process(client, run)
    code, said = asker.post("/forget")
    assert code == 200
    assert "Your data is deleted" in said
    assert list(folder.iterdir()) == []
    assert not alive(pid)
    assert "log.csv" not in asker.get("/")


def test_only_so_many_wait(asker: Asker, log: bytes, limits: Limits) -> None:
    for _ in range(limits.runs):
        asker.identify(log)
    code, said = asker.post("/joint", LAW)
    assert code == 422
    assert "waiting or running" in said
    assert len(asker.visitor.runs) == limits.runs


def test_nobody_takes_all_places_of_the_queue(folder: Path, log: bytes) -> None:
    with TestClient(application(folder, limits=Limits(waiting_each=2)), base_url="http://127.0.0.1:8765") as client:
        asker, other = Asker(client), Asker(TestClient(client.app, base_url="http://127.0.0.1:8765"))
        asker.identify(log)
        second = asker.identify(log)
        code, said = asker.post("/joint", LAW)
        assert code == 422
        assert "2 identifications of yours are waiting or running" in said
        other.identify(log)
        asker.post(f"/runs/{second.number}/cancel")
        asker.identify(log)


def test_the_end_of_the_page_ends_what_runs(folder: Path, log: bytes) -> None:
    with TestClient(application(folder), base_url="http://127.0.0.1:8765") as client:
        asker = Asker(client)
        run = asker.identify(log)
        running(run, "reading the record")
        pid = process(client, run)
    assert not alive(pid)


def test_a_page_that_begins_again_says_what_was_cut_off(folder: Path, log: bytes) -> None:
    with TestClient(application(folder), base_url="http://127.0.0.1:8765") as client:
        asker = Asker(client)
        run = asker.identify(log)
        visitor, cookies = asker.visitor, dict(client.cookies)
    write_json(run.folder / "run.json", {"state": "running", "sentence": ""})
    with TestClient(application(folder), base_url="http://127.0.0.1:8765", cookies=cookies) as client:
        assert "stopped before this had ended" in client.get("/runs/1").text
    os.utime(visitor.folder, (0, 0))
    with TestClient(application(folder), base_url="http://127.0.0.1:8765", cookies=cookies) as client:
        for _ in range(100):
            if not visitor.folder.exists():
                break
            time.sleep(0.05)
        assert not visitor.folder.exists()
        assert "log.csv" not in client.get("/").text


def test_two_tabs_of_one_visitor_take_turns(client: TestClient, asker: Asker, log: bytes) -> None:
    asker.send("log.csv", log)
    asker.get("/channels")
    tabs = [lambda: asker.send("one.csv", log), lambda: asker.send("two.csv", log), lambda: asker.post("/channels")]
    with ThreadPoolExecutor() as pool:
        codes = [each.result()[0] for each in [pool.submit(tab) for tab in tabs]]
    assert codes == [200, 200, 200]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux holds a process to a bound of its memory")
def test_a_record_that_takes_too_much_memory_is_refused_in_a_sentence(folder: Path, log: bytes) -> None:
    small = application(folder, limits=Limits(memory=200 * 2**20))
    with TestClient(small, base_url="http://127.0.0.1:8765") as client:
        asker = Asker(client)
        assert "too large for the memory" in asker.said("long.csv", b"1,2\n" * 1_000_000)
        assert asker.send("log.csv", log)[0] == 200
        asker.post("/draft", {"extra": '[record]\nresample = {method = "linear", sample_time = 1e-6}'})
        code, said = asker.post("/channels", {"record.channels.torque.unit@prismatic": "N"})
        assert code == 422
        assert "jointid identify --window" in said


def reading(client: TestClient) -> int:
    """Wait until a record is read, or made, and return the process."""
    jobs = client.app.state.desk.jobs  # type: ignore[attr-defined]
    for _ in range(600):
        if found := [one.pid for one in list(jobs._attended)]:
            return int(found[0])
        time.sleep(0.02)
    raise AssertionError("nothing is read")


def test_deleting_ends_what_is_read_and_nothing_comes_back(
    client: TestClient, asker: Asker, log: bytes, folder: Path
) -> None:
    asker.send("log.csv", log)
    visitor = asker.visitor
    with ThreadPoolExecutor() as pool:
        making = pool.submit(asker.post, "/example")
        pid = reading(client)
        waiting = pool.submit(asker.send, "late.csv", log)
        turn = client.app.state.desk._turns[visitor.folder]  # type: ignore[attr-defined]
        while not turn._waiters and not waiting.done():
            time.sleep(0.02)
        assert asker.post("/forget")[0] == 200
        assert not alive(pid)
        for overtaken in (making, waiting):
            code, said = overtaken.result()
            assert code == 422
            assert "Your data was deleted while this was done" in said
    with pytest.raises(PageError, match="was deleted"):
        visitor.save_draft({"extra": ""})
    with pytest.raises(FileNotFoundError):
        visitor.new_run(Limits())
    assert list(folder.iterdir()) == []


def test_the_end_of_the_page_ends_what_is_read(client: TestClient, asker: Asker, log: bytes) -> None:
    with ThreadPoolExecutor() as pool:
        making = pool.submit(asker.post, "/example")
        pid = reading(client)
        client.app.state.desk.jobs.close()  # type: ignore[attr-defined]
        assert "The page is being stopped" in making.result()[1]
    assert not alive(pid)
    assert "The page is being stopped" in asker.said("log.csv", log)
    with pytest.raises(PageError, match="is being stopped"):
        client.app.state.desk.jobs.submit(asker.visitor.new_run(Limits()))  # type: ignore[attr-defined]


def test_those_who_wait_to_be_read_keep_no_thread_and_are_only_so_many(tmp_path: Path) -> None:
    async def asked() -> None:
        jobs = Jobs(Limits(waiting=45))
        async with jobs._reading, jobs._reading:  # every place is taken
            waiting = [asyncio.create_task(jobs.attend("look", tmp_path)) for _ in range(47)]
            await asyncio.sleep(0)
            assert await asyncio.wait_for(run_in_threadpool(str, 5), 60) == "5"  # there are 40 threads
            with pytest.raises(PageError, match="47 records are being read or wait for it"):
                await jobs.attend("look", tmp_path)
            for one in waiting:
                one.cancel()
            await asyncio.gather(*waiting, return_exceptions=True)
        with pytest.raises(FileNotFoundError):  # and their places are free again
            await jobs.attend("look", tmp_path / "gone")

    asyncio.run(asked())
