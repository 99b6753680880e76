"""Nothing finished is lost or made twice: killed workers and clients, poison, torn lines, full disks."""

import contextlib
import errno
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pytest

from jointid.campaigns.campaign import Case
from jointid.campaigns.run import Outcome, Row, Store, local_processes, open_store, run_case
from jointid.common.errors import RecordError
from jointid.common.files import digest
from tests.campaigns.conftest import FLEET
from tests.campaigns.work import POISON, SLOW, TWO, carry, cases, ends, last_workers, results, run_all
from tests.losses.runs import COUNT, SEED
from tests.rigid_axis import JOINT

ONE = partial(local_processes, count=1)
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "results.jsonl"


@pytest.mark.slow
def test_a_poisonous_case_is_set_aside_and_named_and_no_other_is_blamed(path: Path, log: Path) -> None:
    made = run_all(path, log, 12, TWO, {3: POISON})
    assert made[Outcome.SET_ASIDE] == 1 and made[Outcome.IDENTIFIED] == 11
    aside = [row.joint for row in results(path, log, 12, {3: POISON}) if row.outcome is Outcome.SET_ASIDE]
    assert aside == ["axis 3"]
    assert len(set(ends(log))) == 11


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_result(path: Path, log: Path) -> None:
    killed = threading.Event()

    def kill_one() -> None:
        while not ends(log):
            time.sleep(0.01)
        os.kill(last_workers(log)[-1], signal.SIGKILL)
        killed.set()

    killer = threading.Thread(target=kill_one)
    killer.start()
    made = run_all(path, log, 40, TWO)
    killer.join()
    assert killed.is_set()
    assert made[Outcome.IDENTIFIED] == 40


def test_a_client_that_is_interrupted_ends_at_once_and_keeps_what_there_is(
    path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep, kinds, began = Store.add, dict.fromkeys(range(1, 8), SLOW), time.monotonic()

    def add(store: Store, row: Row) -> None:
        keep(store, row)
        raise KeyboardInterrupt

    monkeypatch.setattr(Store, "add", add)
    with pytest.raises(KeyboardInterrupt):
        run_all(path, log, 8, TWO, kinds)
    assert time.monotonic() - began < 8 * 2
    assert len(results(path, log, 8, kinds)) == 1


def test_a_torn_line_is_made_again(path: Path, log: Path) -> None:
    run_all(path, log, 4, ONE)
    path.write_bytes(path.read_bytes()[:-40])
    assert len(results(path, log, 4)) == 3
    made = run_all(path, log, 4, ONE)
    assert sum(made.values()) == 1
    assert len(results(path, log, 4)) == 4
    assert len(ends(log)) == 5


def test_two_clients_are_not_at_work_on_one_file(path: Path) -> None:
    with open_store(path), pytest.raises(RecordError), open_store(path):
        pass
    with open_store(path):
        pass


def test_a_full_disk_keeps_what_is_finished(path: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_all(path, log, 2, ONE)
    before = path.read_bytes()

    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with open_store(path) as store:
        monkeypatch.setattr(os, "write", refuse)
        with pytest.raises(RecordError):
            store.add(carry(next(cases(1, log))))
    assert path.read_bytes() == before


@pytest.mark.hostile
def test_a_client_that_is_killed_loses_nothing_and_makes_nothing_twice(path: Path, log: Path) -> None:
    """`JOINTID_ATTACKS=100` kills it that many times."""
    count, dice, finished = 60 * COUNT, random.Random(SEED), set[str]()
    command = [sys.executable, "-m", "tests.campaigns.work", str(path), str(log), str(count)]
    for _ in range(COUNT):
        before = len(ends(log))
        with subprocess.Popen(command, cwd=ROOT, start_new_session=True) as client:
            began = time.monotonic()
            while len(ends(log)) == before and time.monotonic() - began < 60 and client.poll() is None:
                time.sleep(0.01)
            time.sleep(dice.uniform(0.0, 0.2))
            client.kill()
        now = {row.content_hash for row in results(path, log, count)}
        assert finished <= now, "a result was lost"
        assert not finished & set(ends(log)[before:]), "a finished case was made again"
        finished = now
        wait_for_silence(log)
    subprocess.run(command, cwd=ROOT, check=True)
    assert len(results(path, log, count)) == count


def wait_for_silence(log: Path) -> None:
    """Wait until the workers of a client that was killed have ended, which they are to do by themselves."""
    for _ in range(100):
        before = len(ends(log))
        time.sleep(0.1)
        if len(ends(log)) == before:
            return
    pytest.fail("the workers of a killed client go on")


@pytest.mark.hostile
@pytest.mark.skipif(sys.platform != "linux", reason="children are looked up")
def test_an_end_while_the_first_worker_starts_leaves_no_traceback_and_no_folder(place: Path) -> None:
    """Ctrl-C of a terminal, which all processes receive, SIGTERM, kill -9 of the client and of all of them."""
    (place / "campaign.toml").write_text(FLEET)
    (place / "temporary").mkdir()
    command = [sys.executable, "-c", "from jointid.apps.cli import main; main()", "campaign", "campaign.toml", "-q"]
    dice = random.Random(f"first worker{SEED}")
    for turn in range(max(COUNT // 2, 4)):
        with subprocess.Popen(
            [*command, "--out", f"{turn}.jsonl"], cwd=place, start_new_session=True, stderr=subprocess.PIPE,
            env={**os.environ, "TMPDIR": str(place / "temporary")},
        ) as client:  # fmt: skip
            while "spawn_main" not in children_of(client.pid) and client.poll() is None:
                time.sleep(0.01)
            time.sleep(0.02 + dice.uniform(0.0, 2.0))
            kill, send = ENDS[turn % len(ENDS)]
            send(client.pid, kill)
            said = client.stderr.read().decode()  # which ends with the last process
        assert "Traceback" not in said, said
        assert client.returncode in (0, -kill, 128 + kill), said
        assert not any((place / "temporary").iterdir())


ENDS = ((signal.SIGKILL, os.killpg), (signal.SIGINT, os.killpg), (signal.SIGTERM, os.kill), (signal.SIGKILL, os.kill))


def children_of(process: int) -> str:
    """Return what a process's children were started with."""
    said = ""
    with contextlib.suppress(OSError):  # one has ended
        for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
            said += Path(f"/proc/{child}/cmdline").read_text()
    return said


ROW = asdict(Row("a" * 64, "axis", "a.npy", "", (), Outcome.IDENTIFIED, "Found."))
EDITED = [
    ("error_percent", "x"), ("error_percent", float("inf")), ("changes", [1]), ("outcome", []), ("joint", 3),
    ("found", {"inertia": {"value": float("nan"), "std": 1.0, "unit": "kg"}}),
]  # fmt: skip
FOREIGN = [
    *(f"{json.dumps(ROW | {key: value})}\n" for key, value in EDITED),
    json.dumps(ROW | {"error_percent": 0}).replace('"error_percent": 0', f'"error_percent": 1{"0" * 400}') + "\n",
    f"{json.dumps([ROW])}\n", "[" * 100_000, "t,q\n1,2\n", "[joint]", '{"fit": 1}', '{"fit": 1}\n', "{\n",
    '{"row": 1}\n{"changes"',
]  # fmt: skip


@pytest.mark.parametrize("text", FOREIGN)
def test_another_file_is_refused_and_stays_as_it_is(tmp_path: Path, text: str) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text(text)
    with pytest.raises(RecordError), open_store(path):
        pass
    assert path.read_text() == text


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
@pytest.mark.parametrize("made", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_pipe_or_a_device_ends_no_campaign(tmp_path: Path, made: Callable[[Path], None]) -> None:
    record, path = tmp_path / "run.csv", tmp_path / "results.jsonl"
    for one in (record, path):
        made(one)
    with pytest.raises(RecordError):
        digest(record)
    assert run_case(Case("axis", JOINT, str(record), "")).outcome is Outcome.REFUSED
    with pytest.raises(RecordError), open_store(path):
        pass
